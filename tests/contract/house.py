"""Measures how readably the package is written, module by module, and keeps it from getting worse.

    python tests/contract/house.py [-v] [FOLDER]      prints totals, with -v the places too
    python tests/contract/house.py --write            renews house.json after an improvement

Each figure has a limit. Where a module is beyond it, its present figure stands in `house.json` and
may only fall; ``--write`` refuses to raise one. ``--moved OLD NEW`` with it takes over the figures
of a module that was renamed. A figure is a hint where to look, not the goal: cold readers decide.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import math
import subprocess
import sys
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
MAX_COGNITIVE_COMPLEXITY = 15  # beyond it a function is read twice
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

RUFF_RULES = "C901,D102,D103,D205,PLW2901,FBT,ANN401,PLR0912,PLR0913,PLR0915"
"""Rules of ruff that are counted, because the package does not fulfil them everywhere yet."""

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
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
CONDITIONS = (ast.Compare, ast.BoolOp)


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
    functions: int
    comprehensions: int
    conditional_expressions: int
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
    """All figures of a module but those of ruff."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    tokens, code_lines = count_tokens(text, tree)
    nodes = list(ast.walk(tree))
    module = Module(
        name=name,
        tokens=tokens,
        code_lines=code_lines,
        lines=text.count("\n"),
        functions=sum(isinstance(node, FUNCTIONS) for node in nodes),
        comprehensions=sum(isinstance(node, COMPREHENSIONS) for node in nodes),
        conditional_expressions=sum(isinstance(node, ast.IfExp) for node in nodes),
    )
    module.places += skipped_formatting(text, tree)
    for node in nodes:
        module.places += broken_rules(node)
    return module


def docstring_lines(tree: ast.Module) -> set[int]:
    """Numbers of the lines that docstrings take."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            lines.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
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


def skipped_formatting(text: str, tree: ast.Module) -> Iterator[Place]:
    """``# fmt: skip`` behind a statement that is no table of numbers or words."""
    skipped = {
        number for number, line in enumerate(text.splitlines(), start=1) if "# fmt: skip" in line
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and node.end_lineno in skipped and not is_table(node):
            skipped.discard(node.end_lineno)
            yield Place("fmt_skip", node.lineno, "# fmt: skip")


def is_table(node: ast.stmt) -> bool:
    """Whether a statement assigns a literal of a dozen constants or more."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    parts = list(ast.walk(node.value))
    constants = sum(isinstance(part, ast.Constant) for part in parts)
    calls = sum(isinstance(part, ast.Call) for part in parts)
    return constants >= 12 and calls <= 2


# ---------------------------------------------------------------------- rules of single nodes


def broken_rules(node: ast.AST) -> Iterator[Place]:
    """Rules of the house that one node of the syntax tree breaks."""
    if isinstance(node, ast.Assign):
        yield from rules_of_assignment(node)
    elif isinstance(node, ast.For | ast.comprehension):
        yield from rules_of_unpacking(node.target)
        yield from rules_of_loop(node.iter)
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.IfExp | ast.BoolOp):
        yield Place("expression_statement", node.lineno, ast.unparse(node))
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        if is_condition(node.left) and is_sequence(node.right):
            yield Place("condition_times", node.lineno, ast.unparse(node))
        if is_condition(node.right) and is_sequence(node.left):
            yield Place("condition_times", node.lineno, ast.unparse(node))
    elif isinstance(node, ast.Slice):
        bounds = [bound for bound in (node.lower, node.upper, node.step) if bound is not None]
        if any(holds_condition(bound) for bound in bounds):
            yield Place("slice_by_condition", bounds[0].lineno, ast.unparse(node))
    elif isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        ordered = any(isinstance(op, ast.Gt | ast.GtE | ast.Lt | ast.LtE) for op in node.ops)
        if ordered and any(is_condition(side) for side in sides):
            yield Place("implication_by_comparison", node.lineno, ast.unparse(node))
    elif isinstance(node, ast.Call):
        positional = [word for word in node.args if not isinstance(word, ast.Starred)]
        if len(positional) > MAX_POSITIONAL:
            yield Place("positional_arguments", node.lineno, ast.unparse(node.func))
    elif isinstance(node, ast.Import | ast.ImportFrom):
        yield from rules_of_import(node)
    elif isinstance(node, FUNCTIONS):
        yield from rules_of_function(node)


def rules_of_assignment(node: ast.Assign) -> Iterator[Place]:
    """Unrelated values in one assignment; too many values unpacked."""
    target = node.targets[0]
    yield from rules_of_unpacking(target)
    if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
        written = {ast.unparse(part) for part in target.elts}
        read = {ast.unparse(part) for part in node.value.elts}
        if not read <= written:  # an exchange of values is one thought
            yield Place("parallel_assignment", node.lineno, ast.unparse(target))


def rules_of_unpacking(target: ast.expr) -> Iterator[Place]:
    """A tuple of four and more wants a type with named fields."""
    if isinstance(target, ast.Tuple) and len(target.elts) > MAX_UNPACKED:
        yield Place("long_unpacking", target.lineno, ast.unparse(target))


def rules_of_loop(iterable: ast.expr) -> Iterator[Place]:
    """``for x in (xs if condition else ())``."""
    if isinstance(iterable, ast.IfExp):
        yield Place("conditional_loop", iterable.lineno, ast.unparse(iterable))


def rules_of_import(node: ast.Import | ast.ImportFrom) -> Iterator[Place]:
    """Modules stand under their own names; a few aliases are known to everybody."""
    for name in node.names:
        if name.asname is None or name.asname in ALIASES:
            continue
        is_module = isinstance(node, ast.Import) or name.name.islower()
        if is_module:
            yield Place("alias", node.lineno, f"{name.name} as {name.asname}")


def rules_of_function(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[Place]:
    """Local names and cognitive complexity."""
    names = local_names(node)
    if len(names) > MAX_LOCAL_NAMES:
        yield Place("local_names", node.lineno, f"{node.name}: {len(names)} names")
    for name in sorted(names & EMPTY_NAMES):
        yield Place("empty_name", node.lineno, f"{node.name}: {name}")
    complexity = cognitive_complexity(node)
    if complexity > MAX_COGNITIVE_COMPLEXITY:
        yield Place("complexity", node.lineno, f"{node.name}: {complexity}")


def is_condition(node: ast.expr) -> bool:
    """Whether an expression is a comparison, ``and``, ``or`` or ``not``."""
    return isinstance(node, CONDITIONS) or (
        isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
    )


def holds_condition(node: ast.expr) -> bool:
    """Whether a condition stands anywhere in an expression."""
    return any(
        isinstance(part, ast.expr) and (is_condition(part) or isinstance(part, ast.IfExp))
        for part in ast.walk(node)
    )


def is_sequence(node: ast.expr) -> bool:
    """Whether an expression is a literal text or list."""
    is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_text or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple)


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


def cognitive_complexity(function: ast.AST) -> int:
    """Campbell's cognitive complexity (SonarSource 2018); comprehensions count as loops.

    Each break of the straight reading counts 1, and 1 more for each structure that it is nested
    in; ``elif``, ``else`` and a chain of ``and`` or ``or`` count 1.
    """
    return sum(complexity_of(child, 0) for child in ast.iter_child_nodes(function))


def complexity_of(node: ast.AST, nesting: int) -> int:
    """The part of one node and all in it, at a depth of nesting."""
    if isinstance(node, ast.If):
        return complexity_of_if(node, nesting)
    own = 0
    inner = nesting
    if isinstance(node, ast.For | ast.AsyncFor | ast.While | ast.ExceptHandler | ast.IfExp):
        own = 1 + nesting
        inner = nesting + 1
    elif isinstance(node, COMPREHENSIONS):
        conditions = sum(len(generator.ifs) for generator in node.generators)
        own = len(node.generators) + conditions + nesting
        inner = nesting + 1
    elif isinstance(node, ast.BoolOp):
        own = 1
    elif isinstance(node, (*FUNCTIONS, ast.Lambda)):
        inner = nesting + 1
    return own + sum(complexity_of(child, inner) for child in ast.iter_child_nodes(node))


def complexity_of_if(node: ast.If, nesting: int) -> int:
    """``if`` with its ``elif`` and ``else``."""
    total = 1 + nesting + complexity_of(node.test, nesting)
    total += sum(complexity_of(child, nesting + 1) for child in node.body)
    rest = node.orelse
    while len(rest) == 1 and isinstance(rest[0], ast.If):
        branch = rest[0]
        total += 1 + complexity_of(branch.test, nesting)
        total += sum(complexity_of(child, nesting + 1) for child in branch.body)
        rest = branch.orelse
    if rest:
        total += 1 + sum(complexity_of(child, nesting + 1) for child in rest)
    return total


# ---------------------------------------------------------------------- the whole house


def measure(package: Path = PACKAGE) -> dict[str, Module]:
    """All modules below a folder, by their path in it."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        modules[name] = measure_module(path, name)
    for name, place in broken_rules_of_ruff(package):
        modules[name].places.append(place)
    return modules


def broken_rules_of_ruff(package: Path) -> Iterator[tuple[str, Place]]:
    """Module and place of each violation of `RUFF_RULES`."""
    command = [sys.executable, "-m", "ruff", "check", "--exit-zero", "--output-format", "json"]
    command += ["--extend-select", RUFF_RULES, str(package)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    for violation in json.loads(answer.stdout):
        if violation["code"] in ("E501", "invalid-syntax"):
            continue
        name = Path(violation["filename"]).relative_to(package).as_posix()
        line = violation["location"]["row"]
        yield name, Place(violation["code"], line, violation["message"])


def read_ratchet(path: Path = RATCHET) -> dict[str, dict[str, float]]:
    """Module -> figure -> what it may be at most, where that is beyond the limit."""
    ratchet: dict[str, dict[str, float]] = json.loads(path.read_text(encoding="utf-8"))
    return ratchet


def beyond_limits(modules: Iterable[Module]) -> dict[str, dict[str, float]]:
    """The figures that are beyond their limits."""
    beyond: dict[str, dict[str, float]] = {}
    for module in modules:
        figures = {
            name: value
            for name, value in sorted(module.figures().items())
            if value > limit_of(name, module.name)
        }
        if figures:
            beyond[module.name] = figures
    return beyond


def worse_than(
    ratchet: dict[str, dict[str, float]], beyond: dict[str, dict[str, float]]
) -> list[str]:
    """What is beyond its limit and beyond what the ratchet allows, one line each."""
    worse = []
    for name, figures in beyond.items():
        for figure, value in figures.items():
            most = ratchet.get(name, {}).get(figure, limit_of(figure, name))
            if value > most:
                worse.append(f"{name}: {figure} is {value:g}, at most {most:g}")
    return worse


def totals(modules: dict[str, Module]) -> str:
    """Sums over the house, for people; none of them is bounded."""
    tokens = sum(module.tokens for module in modules.values())
    code_lines = sum(module.code_lines for module in modules.values())
    lines = sum(module.lines for module in modules.values())
    rows = [
        f"{len(modules)} modules, {lines} lines, {code_lines} lines of code, {tokens} tokens: "
        f"{tokens / code_lines:.2f} tokens a line",
        f"{sum(module.functions for module in modules.values())} functions",
    ]
    rooms: dict[str, list[Module]] = {}
    for module in modules.values():
        room = module.name.partition("/")[0] if "/" in module.name else "(base)"
        rooms.setdefault(room, []).append(module)
    for room, members in sorted(rooms.items()):
        room_tokens = sum(module.tokens for module in members)
        room_lines = sum(module.code_lines for module in members)
        density = room_tokens / max(room_lines, 1)
        rows.append(
            f"  {room:12} {len(members):3} modules {room_lines:6} lines of code "
            f"{room_tokens:7} tokens {density:6.2f} a line"
        )
    rules = Counter(place.rule for module in modules.values() for place in module.places)
    rows += [f"  {rule}: {count}" for rule, count in sorted(rules.items())]
    return "\n".join(rows)


def write_ratchet(
    modules: dict[str, Module], moved: dict[str, str], path: Path = RATCHET
) -> list[str]:
    """Write what is beyond the limits now, unless something is worse; returns what is worse.

    ``moved``: new name of a module -> its name before.
    """
    ratchet = read_ratchet(path) if path.exists() else None
    beyond = beyond_limits(modules.values())
    if ratchet is not None:
        for new, old in moved.items():
            ratchet.setdefault(new, {}).update(ratchet.get(old, {}))
        worse = worse_than(ratchet, beyond)
        if worse:
            return worse
    path.write_text(json.dumps(beyond, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return []


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description="How readably the package is written")
    parser.add_argument("folder", nargs="?", type=Path, default=PACKAGE)
    parser.add_argument("-v", "--verbose", action="store_true", help="list the places")
    parser.add_argument("--write", action="store_true", help="renew house.json")
    parser.add_argument(
        "--moved", nargs=2, action="append", default=[], metavar=("OLD", "NEW"),
        help="with --write: a module that was renamed",
    )  # fmt: skip
    options = parser.parse_args()
    modules = measure(options.folder.resolve())
    print(totals(modules))
    if options.verbose:
        for module in modules.values():
            for place in sorted(module.places, key=lambda place: place.line):
                print(f"{module.name}:{place.line}: {place.rule}: {place.what}")
    if options.write:
        worse = write_ratchet(modules, {new: old for old, new in options.moved})
        print(*worse, sep="\n")
        return 1 if worse else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
