"""Measures how readably the package is written, module by module, and keeps it from getting worse.

    python tests/contract/house.py [-v] [FOLDER]      prints totals, with -v the places too
    python tests/contract/house.py --write            renews house.json after an improvement

Each figure has a limit. Where a module is beyond it, its present figure stands in `house.json` and
may only fall; ``--write`` refuses to raise one. ``--moved OLD NEW`` with it takes over the figures
of a module that was renamed. A figure is a hint where to look, not the goal: cold readers decide.
"""

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
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
COMPREHENSIONS = (
    ast.ListComp,
    ast.SetComp,
    ast.DictComp,
    ast.GeneratorExp,
)
LOOPS = (
    ast.For,
    ast.AsyncFor,
    ast.While,
    ast.ExceptHandler,
    ast.IfExp,
)
CONDITIONS = (ast.Compare, ast.BoolOp)
ORDERS = (
    ast.Gt,
    ast.GtE,
    ast.Lt,
    ast.LtE,
)


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
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    tokens, code_lines = count_tokens(text, tree)
    nodes = list(ast.walk(tree))
    module = Module(
        name=name,
        tokens=tokens,
        code_lines=code_lines,
        lines=text.count("\n"),
        functions=count_kinds(nodes, FUNCTIONS),
        comprehensions=count_kinds(nodes, COMPREHENSIONS),
        conditional_expressions=count_kinds(nodes, (ast.IfExp,)),
    )
    module.places += skipped_formatting(text, tree)
    for node in nodes:
        module.places += broken_rules(node)
    return module


def count_kinds(nodes: Iterable[ast.AST], kinds: tuple[type[ast.AST], ...]) -> int:
    """How many nodes are of these kinds."""
    return sum(isinstance(node, kinds) for node in nodes)


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


def skipped_formatting(text: str, tree: ast.Module) -> Iterator[Place]:
    """``# fmt: skip`` behind a statement that is no table of numbers or words."""
    lines = text.splitlines()
    reported = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.stmt) or is_table(node):
            continue
        end = node.end_lineno or node.lineno
        if "# fmt: skip" in lines[end - 1] and end not in reported:
            reported.add(end)
            yield Place("fmt_skip", node.lineno, "# fmt: skip")


def is_table(node: ast.stmt) -> bool:
    """Whether a statement assigns a literal of a dozen constants or more."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    parts = list(ast.walk(node.value))
    constants = count_kinds(parts, (ast.Constant,))
    calls = count_kinds(parts, (ast.Call,))
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
    elif isinstance(node, ast.BinOp):
        yield from rules_of_product(node)
    elif isinstance(node, ast.Slice):
        yield from rules_of_slice(node)
    elif isinstance(node, ast.Compare):
        yield from rules_of_comparison(node)
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


def rules_of_loop(iterable: ast.expr) -> Iterator[Place]:
    """``for x in (xs if condition else ())``."""
    if isinstance(iterable, ast.IfExp):
        yield Place("conditional_loop", iterable.lineno, ast.unparse(iterable))


def rules_of_product(node: ast.BinOp) -> Iterator[Place]:
    """``"text" * condition``."""
    if not isinstance(node.op, ast.Mult):
        return
    for factor, condition in ((node.left, node.right), (node.right, node.left)):
        if is_sequence(factor) and is_condition(condition):
            yield Place("condition_times", node.lineno, ast.unparse(node))


def rules_of_slice(node: ast.Slice) -> Iterator[Place]:
    """``values[condition:]``."""
    for bound in (node.lower, node.upper, node.step):
        if bound is not None and holds_condition(bound):
            yield Place("slice_by_condition", bound.lineno, ast.unparse(node))
            return


def rules_of_comparison(node: ast.Compare) -> Iterator[Place]:
    """``condition <= condition``."""
    has_order = count_kinds(node.ops, ORDERS)
    sides = (node.left, *node.comparators)
    if has_order and any(map(is_condition, sides)):
        yield Place("implication_by_comparison", node.lineno, ast.unparse(node))


def rules_of_call(node: ast.Call) -> Iterator[Place]:
    """More arguments than a reader counts."""
    positional = len(node.args) - count_kinds(node.args, (ast.Starred,))
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
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.Not)
    return isinstance(node, CONDITIONS)


def holds_condition(node: ast.expr) -> bool:
    """Whether a condition is anywhere in an expression."""
    for part in ast.walk(node):
        if isinstance(part, ast.IfExp):
            return True
        if isinstance(part, ast.expr) and is_condition(part):
            return True
    return False


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
    return complexity_of_all(ast.iter_child_nodes(function), 0)


def complexity_of(node: ast.AST, nesting: int) -> int:
    """The part of one node and all in it, at a depth of nesting."""
    if isinstance(node, ast.If):
        return complexity_of_if(node, nesting)
    total = 0
    inner = nesting
    if isinstance(node, LOOPS):
        total = 1 + nesting
        inner = nesting + 1
    elif isinstance(node, COMPREHENSIONS):
        conditions = sum(len(generator.ifs) for generator in node.generators)
        total = len(node.generators) + conditions + nesting
        inner = nesting + 1
    elif isinstance(node, ast.BoolOp):
        total = 1
    elif isinstance(node, (*FUNCTIONS, ast.Lambda)):
        inner = nesting + 1
    return total + complexity_of_all(ast.iter_child_nodes(node), inner)


def complexity_of_all(nodes: Iterable[ast.AST], nesting: int) -> int:
    """The sum of several parts at one depth."""
    return sum(complexity_of(node, nesting) for node in nodes)


def complexity_of_if(node: ast.If, nesting: int) -> int:
    """``if`` with its ``elif`` and ``else``."""
    inner = nesting + 1
    total = 1 + nesting + complexity_of(node.test, nesting)
    total += complexity_of_all(node.body, inner)
    branches = node.orelse
    while len(branches) == 1 and isinstance(branches[0], ast.If):
        branch = branches[0]
        total += 1 + complexity_of(branch.test, nesting)
        total += complexity_of_all(branch.body, inner)
        branches = branch.orelse
    if branches:
        total += 1 + complexity_of_all(branches, inner)
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
    options = f"check --exit-zero --output-format json --extend-select {RUFF_RULES}"
    answer = subprocess.run(
        [sys.executable, "-m", "ruff", *options.split(), str(package)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    for violation in json.loads(answer.stdout):
        if violation["code"] in ("E501", "invalid-syntax"):
            continue
        name = Path(violation["filename"]).relative_to(package).as_posix()
        line = violation["location"]["row"]
        yield name, Place(violation["code"], line, violation["message"])


def read_ratchet(path: Path = RATCHET) -> dict[str, dict[str, float]]:
    """Module -> figure -> what it may be at most, where that is beyond the limit."""
    ratchet: dict[str, dict[str, float]] = json.loads(path.read_text("utf-8"))
    return ratchet


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


def totals(modules: dict[str, Module]) -> str:
    """Sums over the house, for people; none of them is bounded."""
    rooms: dict[str, list[Module]] = {}
    rules: Counter[str] = Counter()
    for name, module in modules.items():
        room, _, file = name.partition("/")
        if not file:
            room = "(base)"
        rooms.setdefault(room, []).append(module)
        rules.update(place.rule for place in module.places)
    lines = sum(module.lines for module in modules.values())
    functions = sum(module.functions for module in modules.values())
    rows = [
        row_of("all", list(modules.values())),
        f"{lines} lines, {functions} functions",
    ]
    rows += [row_of(room, members) for room, members in sorted(rooms.items())]
    rows += [f"  {rule}: {count}" for rule, count in sorted(rules.items())]
    return "\n".join(rows)


def row_of(room: str, modules: list[Module]) -> str:
    """The sums of a room."""
    tokens = sum(module.tokens for module in modules)
    code_lines = sum(module.code_lines for module in modules)
    density = tokens / max(code_lines, 1)
    return (
        f"  {room:12} {len(modules):3} modules {code_lines:6} lines of code "
        f"{tokens:7} tokens {density:6.2f} a line"
    )


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
    path.write_text(json.dumps(beyond, indent=1, sort_keys=True) + "\n", "utf-8")
    return []


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description="How readably the package is written")
    parser.add_argument("folder", nargs="?", type=Path, default=PACKAGE)
    parser.add_argument("-v", "--verbose", action="store_true", help="list the places")
    parser.add_argument("--write", action="store_true", help="renew house.json")
    parser.add_argument(
        "--moved",
        nargs=2,
        action="append",
        default=[],
        metavar=("OLD", "NEW"),
        help="with --write: a module that was renamed",
    )
    options = parser.parse_args()
    modules = measure(options.folder.resolve())
    print(totals(modules))
    if options.verbose:
        for module in modules.values():
            for place in sorted(module.places, key=lambda place: place.line):
                print(f"{module.name}:{place.line}: {place.rule}: {place.what}")
    if not options.write:
        return 0
    moved = {new: old for old, new in options.moved}
    worse = write_ratchet(modules, moved)
    print(*worse, sep="\n")
    return int(len(worse) > 0)


if __name__ == "__main__":
    sys.exit(main())
