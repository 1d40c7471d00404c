"""Measures how readably the package is written, module by module, and keeps it from getting worse.

    python tests/contract/house.py             prints the places where a rule is broken
    python tests/contract/house.py --write     renews house.json, after an improvement

Each figure has a limit. Where a module is beyond it, its present figure stands in `house.json` and
may only fall. A figure is a hint where to look, not the goal: cold readers decide. The linter
forbids what it knows itself (`select` in pyproject.toml).
"""

import argparse
import ast
import io
import json
import math
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parents[2] / "pipeline" / "unbend"
RATCHET = Path(__file__).with_name("house.json")

MAX_TOKENS_A_LINE = 9.0  # the best codebases of the field have 6 to 8
MAX_TOKENS_OF_FORMULAS = 11.0  # skyfield, pvlib: a formula fills its line
MAX_LOCAL_NAMES = 15  # beyond it a reader keeps a list
MAX_MODULE_LINES = 500
MAX_POSITIONAL = 5  # more arguments are passed by name
MAX_UNPACKED = 3  # more values are a type with named fields

FORMULAS = (
    "block/alignment.py",
    "block/calibration_fit.py",
    "block/image_rays.py",
    "block/intersection.py",
    "refraction/camera/",
    "refraction/kernels/",
    "refraction/published/",
    "refraction/uncertainty/adjoints.py",
    "atmosphere/refractive_index.py",
    "atmosphere/standard.py",
    "atmosphere/estimate/hypotheses.py",
    "geodesy.py",
    "simulate/optics.py",
)
"""Modules of kernels and published formulas, which may be denser."""

ALIASES = {"np", "pd", "pa", "pq", "pc"}
"""Short names of modules that everybody knows."""

EMPTY_NAMES = {
    "found", "mine", "one", "some", "of", "at", "on", "it", "own", "thing", "things", "stuff",
    "told", "said", "ours", "theirs", "whatever",
}  # fmt: skip
"""Local names that do not say what they hold."""

NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)


class Place(NamedTuple):
    """Where a rule is broken."""

    rule: str
    line: int
    what: str


@dataclass
class Module:
    """What was measured of one module."""

    name: str
    tokens: int
    code_lines: int
    lines: int
    places: list[Place] = field(default_factory=list)

    @property
    def tokens_a_line(self) -> float:
        """Tokens a line of code; docstrings and comments do not count."""
        if self.code_lines == 0:
            return 0.0
        return round(self.tokens / self.code_lines, 2)

    def figures(self) -> dict[str, float]:
        """What may not grow: density, length, and how often each rule is broken."""
        counts = Counter(place.rule for place in self.places)
        return {"tokens_a_line": self.tokens_a_line, "lines": self.lines, **counts}


def limit_of(figure: str, module: str) -> float:
    """What a figure of a module may be without an entry in the ratchet."""
    if figure == "tokens_a_line":
        is_formula = module.startswith(FORMULAS)
        return MAX_TOKENS_OF_FORMULAS if is_formula else MAX_TOKENS_A_LINE
    if figure == "lines":
        is_list = module.endswith("messages.py")  # of a room's messages: looked up, not read
        return math.inf if is_list else MAX_MODULE_LINES
    return 0


# ---------------------------------------------------------------------- measuring one module


def measure_module(path: Path, name: str) -> Module:
    """All figures of a module."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    tokens, code_lines = count_tokens(text, tree)
    module = Module(
        name=name,
        tokens=tokens,
        code_lines=code_lines,
        lines=text.count("\n"),
    )
    for node in ast.walk(tree):
        module.places += broken_rules(node)
    return module


def docstring_lines(tree: ast.Module) -> set[int]:
    """Numbers of the lines that docstrings take."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, DOCUMENTED):
            continue
        if ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            end = docstring.end_lineno or docstring.lineno
            lines.update(range(docstring.lineno, end + 1))
    return lines


def count_tokens(text: str, tree: ast.Module) -> tuple[int, int]:
    """Tokens, and lines that hold any; neither of comments nor of docstrings."""
    documented = docstring_lines(tree)
    tokens = 0
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in NO_CODE or token.start[0] in documented:
            continue
        tokens += 1
        lines.update(range(token.start[0], token.end[0] + 1))
    return tokens, len(lines)


# ---------------------------------------------------------------------- rules of single nodes


def broken_rules(node: ast.AST) -> Iterator[Place]:
    """Rules of the house that one node of the syntax tree breaks."""
    if isinstance(node, ast.Assign):
        yield from rules_of_assignment(node)
    elif isinstance(node, ast.For | ast.comprehension):
        yield from rules_of_unpacking(node.target)
    elif isinstance(node, ast.Call):
        yield from rules_of_call(node)
    elif isinstance(node, ast.Import | ast.ImportFrom):
        yield from rules_of_import(node)
    elif isinstance(node, FUNCTIONS):
        yield from rules_of_function(node)


def rules_of_assignment(node: ast.Assign) -> Iterator[Place]:
    """Unrelated values in one assignment; too many values unpacked."""
    target = node.targets[0]
    yield from rules_of_unpacking(target)
    if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
        written = set(map(ast.unparse, target.elts))
        read = set(map(ast.unparse, node.value.elts))
        if not read <= written:  # an exchange of values is one thought
            yield Place("parallel_assignment", node.lineno, ast.unparse(target))


def rules_of_unpacking(target: ast.expr) -> Iterator[Place]:
    """A tuple of four and more wants a type with named fields."""
    if isinstance(target, ast.Tuple) and len(target.elts) > MAX_UNPACKED:
        yield Place("long_unpacking", target.lineno, ast.unparse(target))


def rules_of_call(node: ast.Call) -> Iterator[Place]:
    """More arguments than a reader counts."""
    positional = sum(not isinstance(argument, ast.Starred) for argument in node.args)
    if positional > MAX_POSITIONAL:
        yield Place("positional_arguments", node.lineno, ast.unparse(node.func))


def rules_of_import(node: ast.Import | ast.ImportFrom) -> Iterator[Place]:
    """Modules stand under their own names; a few aliases are known to everybody."""
    for name in node.names:
        if name.asname is None or name.asname in ALIASES:
            continue
        is_module = isinstance(node, ast.Import) or name.name.islower()
        if is_module:
            yield Place("alias", node.lineno, f"{name.name} as {name.asname}")


def rules_of_function(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[Place]:
    """Local names: how many, and what they tell."""
    names = local_names(node)
    if len(names) > MAX_LOCAL_NAMES:
        yield Place("local_names", node.lineno, f"{node.name}: {len(names)} names")
    for name in sorted(names & EMPTY_NAMES):
        yield Place("empty_name", node.lineno, f"{node.name}: {name}")


# ---------------------------------------------------------------------- functions


def own_nodes(function: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a function without those of functions and classes within it."""
    for child in ast.iter_child_nodes(function):
        yield child
        if not isinstance(child, (*FUNCTIONS, ast.ClassDef, ast.Lambda)):
            yield from own_nodes(child)


def local_names(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """The names that a function gives values to, beside its parameters."""
    names: set[str] = set()
    for node in own_nodes(function):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names


# ---------------------------------------------------------------------- the whole house


def measure(package: Path = PACKAGE) -> dict[str, Module]:
    """All modules below a folder, by their path in it."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        modules[name] = measure_module(path, name)
    return modules


def read_ratchet() -> dict[str, dict[str, float]]:
    """Module -> figure -> what it may be at most, where that is beyond the limit."""
    return json.loads(RATCHET.read_text("utf-8"))


def beyond_limits(modules: Iterable[Module]) -> dict[str, dict[str, float]]:
    """The figures that are beyond their limits."""
    beyond: dict[str, dict[str, float]] = {}
    for module in modules:
        for figure, value in sorted(module.figures().items()):
            if value > limit_of(figure, module.name):
                beyond.setdefault(module.name, {})[figure] = value
    return beyond


def worse_than(
    ratchet: dict[str, dict[str, float]], beyond: dict[str, dict[str, float]]
) -> list[str]:
    """What is beyond its limit and beyond what the ratchet allows, one line each."""
    worse = []
    for name, figures in beyond.items():
        before = ratchet.get(name, {})
        for figure, value in figures.items():
            most = before.get(figure, limit_of(figure, name))
            if value > most:
                worse.append(f"{name}: {figure} is {value:g}, at most {most:g}")
    return worse


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description="How readably the package is written")
    parser.add_argument("--write", action="store_true", help="renew house.json")
    options = parser.parse_args()
    modules = measure()
    for module in modules.values():
        for place in module.places:
            print(f"{module.name}:{place.line}: {place.rule}: {place.what}")
    if options.write:
        beyond = beyond_limits(modules.values())
        if worse := worse_than(read_ratchet(), beyond):
            raise SystemExit("\n".join(worse))
        RATCHET.write_text(json.dumps(beyond, indent=1, sort_keys=True) + "\n", "utf-8")


if __name__ == "__main__":
    main()
