"""Numbers of the package's structure: files, lines, functions, parameters, names.

    python tests/contract/house.py [-v] [FOLDER]

``-v`` lists the private functions with one caller and those with more than five positional
parameters. A private function with one caller is one whose name is used exactly once in its module.
"""

from __future__ import annotations

import ast
import io
import re
import statistics
import sys
import tokenize
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "pipeline" / "unbend"
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip
IMPORTS_LEDGER = re.compile(
    r"^(?:from unbend\.ledger|import unbend\.ledger|from unbend import .*\bledger\b)", re.M
)


@dataclass
class House:
    """What was counted; places are ``file:line:name``."""

    files: int = 0
    lines: int = 0
    lines_of_code: int = 0
    lengths: list[int] = field(default_factory=list)
    private_functions: int = 0
    with_one_caller: list[str] = field(default_factory=list)
    parameters: dict[str, int] = field(default_factory=dict)
    positional: dict[str, int] = field(default_factory=dict)
    importing_ledger: int = 0
    modules_in: Counter[str] = field(default_factory=Counter)
    modules_called: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    classes_called: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    @property
    def median_length(self) -> float:
        return statistics.median(self.lengths)

    @property
    def p95_length(self) -> int:
        return sorted(self.lengths)[int(0.95 * len(self.lengths))]

    @property
    def many_positional(self) -> list[str]:
        return sorted(place for place, count in self.positional.items() if count > 5)


def measure(package: Path = PACKAGE) -> House:
    house = House()
    for path in sorted(package.rglob("*.py")):
        _measure_module(path, path.relative_to(package).as_posix(), house)
    return house


def _measure_module(path: Path, name: str, house: House) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    house.files += 1
    house.lines += text.count("\n")
    house.lines_of_code += _lines_of_code(text, tree)
    house.importing_ledger += bool(IMPORTS_LEDGER.search(text))
    folder = name.rpartition("/")[0] or "."
    house.modules_in[folder] += 1
    house.modules_called[path.stem].append(name)
    used = Counter(
        node.id if isinstance(node, ast.Name) else node.attr
        for node in ast.walk(tree)
        if isinstance(node, (ast.Name, ast.Attribute))
    )
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            house.classes_called[node.name].append(name)
    for node in ast.walk(tree):
        if not isinstance(node, FUNCTIONS):
            continue
        place = f"{name}:{node.lineno}:{node.name}"
        arguments = [*node.args.posonlyargs, *node.args.args]
        own = arguments[:1] and arguments[0].arg in ("self", "cls")
        house.lengths.append((node.end_lineno or node.lineno) - node.lineno + 1)
        house.positional[place] = len(arguments) - bool(own)
        house.parameters[place] = house.positional[place] + len(node.args.kwonlyargs)
        if node.name.startswith("_") and not node.name.startswith("__"):
            house.private_functions += 1
            if used[node.name] == 1:
                house.with_one_caller.append(place)


def _lines_of_code(text: str, tree: ast.Module) -> int:
    """Lines that hold something other than remarks and docstrings."""
    docstrings: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and node.body:
            first = node.body[0]
            value = first.value if isinstance(first, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                docstrings.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - docstrings)


def report(house: House) -> str:
    widest = max(house.parameters, key=house.parameters.__getitem__)
    lines = [
        f"files {house.files}, lines {house.lines}, lines of code {house.lines_of_code}",
        f"functions {len(house.lengths)}: median {house.median_length:g} lines, 95th percentile "
        f"{house.p95_length}, longest {max(house.lengths)}",
        f"private functions {house.private_functions}, with one caller "
        f"{len(house.with_one_caller)}",
        f"largest number of parameters {house.parameters[widest]} ({widest}); functions with more "
        f"than five positional ones {len(house.many_positional)}",
        f"modules that import the ledger {house.importing_ledger}",
    ]
    lines += [f"  {folder}: {count} modules" for folder, count in sorted(house.modules_in.items())]
    return "\n".join(lines)


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "-v"]
    counted = measure(Path(words[0]) if words else PACKAGE)
    print(report(counted))
    if "-v" in sys.argv:
        print("with one caller:", *counted.with_one_caller, sep="\n  ")
        print("more than five positional:", *counted.many_positional, sep="\n  ")
