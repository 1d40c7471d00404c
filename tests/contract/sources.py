"""The repository, its project file, and the syntax trees of the package."""

import ast
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pipeline" / "unbend"


def text_of(path):
    """The text of a file."""
    return path.read_text("utf-8")


PROJECT = tomllib.loads(text_of(ROOT / "pyproject.toml"))


@cache
def trees() -> dict[str, ast.Module]:
    """The syntax tree of every module, by its path in the package."""
    modules = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        modules[name] = ast.parse(text_of(path))
    return modules


def nodes() -> Iterator[tuple[str, ast.AST]]:
    """Every node of these trees, with the path of its module."""
    for name, tree in trees().items():
        for node in ast.walk(tree):
            yield name, node


def is_string(node: ast.AST):
    """Whether a node is a literal text."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def strings(tree: ast.Module):
    """Line and text of the strings that a module works with: no remark, no docstring."""
    idle = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if is_string(node) and id(node) not in idle:
            yield node.lineno, node.value
