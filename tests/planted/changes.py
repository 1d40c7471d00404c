"""The changes of a source that may be drawn as bugs: mutation operators.

Left out is what no test has to notice: docstrings, messages' texts, annotations, decorators,
raised errors, logging, and numbers that only divide work or time (size of a buffer, of a batch,
patience) or style a figure. Exchanges of a text with a number are left out too: they raise at
once, and would say nothing about the tests.
"""

import ast
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ARITHMETIC = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
}
COMPARISONS: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">=")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}
NAMES_OF_REMOVED_CALLS = """
    abs fabs absolute cos sin tan sqrt radians degrees deg2rad rad2deg
    sorted exp log floor ceil round unwrap
"""
REMOVED_CALLS = set(NAMES_OF_REMOVED_CALLS.split())
EXCHANGED_CALLS = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
    "cos": "sin",
    "sin": "cos",
}
EXCHANGED_UNITS = {
    "m": "km",
    "km": "m",
    "ft": "m",
    "cm": "m",
    "mm": "m",
    "Pa": "hPa",
    "hPa": "Pa",
    "mbar": "Pa",
    "K": "°C",
    "°C": "K",
    "rad": "deg",
    "deg": "rad",
    "s": "ms",
    "ms": "s",
    "us": "ms",
    "ns": "us",
    "px": "mm",
    "um": "nm",
    "nm": "um",
}
# The exchange of arguments changes nothing, or raises at once.
NOT_EXCHANGED = {
    "hypot",
    "min",
    "max",
    "minimum",
    "maximum",
    "fmin",
    "fmax",
    "logical_and",
    "logical_or",
    "isclose",
    "allclose",
    "array_equal",
    "intersect1d",
    "union1d",
    "isinstance",
    "issubclass",
    "getattr",
    "hasattr",
    "setattr",
    "partial",
    "open",
}
ONLY_STYLE = {
    "alpha",
    "color",
    "dpi",
    "figsize",
    "fontsize",
    "frameon",
    "labelsize",
    "linewidth",
    "loc",
    "lw",
    "markersize",
    "ms",
    "pad",
    "rasterized",
    "s",
    "stacklevel",
    "width",
    "zorder",
    "maxsize",
}
ONLY_DIVIDES_WORK = re.compile(
    r"BYTES|BUFFER|CHUNK|BATCH|BLOCK_ROWS|ROWS_AT|ROWS_OF_A_FILE|TOGETHER|THREADS|WORKERS|"
    r"PATIENCE|TIMEOUT|RETR|WAIT|CACHE|PER_PART|GROUP_ROWS|CAPACITY|UNUSED_FOR|COMPILED_WITHIN"
)
LOGGING = {"debug", "info", "warning", "error", "exception", "log", "warn"}


@dataclass(frozen=True)
class Change:
    """One change of a source: the bytes from `start` to `end` become `after`."""

    kind: str
    line: int
    start: int
    end: int
    after: str


class Source:
    """A module's text, with the place of each node in its bytes."""

    def __init__(self, path: Path):
        self.path = path
        self.content = path.read_bytes()
        self.tree = ast.parse(self.content)
        self.line_starts = [0]
        for line in self.content.splitlines(keepends=True):
            self.line_starts.append(self.line_starts[-1] + len(line))

    def span(self, node: ast.expr) -> tuple[int, int]:
        """First byte of a node and the first byte after it."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = self.line_starts[node.lineno - 1] + node.col_offset
        end = self.line_starts[node.end_lineno - 1] + node.end_col_offset
        return start, end

    def text(self, node: ast.expr) -> str:
        start, end = self.span(node)
        return self.content[start:end].decode("utf-8")

    def replaced(self, kind: str, node: ast.expr, after: str) -> Change:
        """The change that puts another text in the place of a node."""
        return Change(kind, node.lineno, *self.span(node), after)

    def operator(
        self, kind: str, left: ast.expr, right: ast.expr, before: str, after: str
    ) -> Iterator[Change]:
        """The change of the operator that stands between two nodes."""
        start = self.span(left)[1]
        between = self.content[start : self.span(right)[0]].decode("utf-8")
        place = re.search(re.escape(before), re.sub(r"#.*", lambda c: " " * len(c[0]), between))
        if place:
            first = start + len(between[: place.start()].encode("utf-8"))
            line = self.content.count(b"\n", 0, first) + 1
            yield Change(kind, line, first, first + len(before), after)

    def exchanged(self, kind: str, first: ast.expr, second: ast.expr) -> Iterator[Change]:
        """The change that puts two nodes each in the other's place."""
        if may_be_exchanged(first, second):
            start, middle = self.span(first)
            next_start, end = self.span(second)
            between = self.content[middle:next_start].decode("utf-8")
            after = self.text(second) + between + self.text(first)
            yield Change(kind, first.lineno, start, end, after)


def may_be_exchanged(first: ast.expr, second: ast.expr) -> bool:
    """Whether two different values are there that may be of one type, and not both texts."""
    literal = (ast.JoinedStr, ast.Dict, ast.List, ast.Set, ast.Lambda, ast.DictComp, ast.ListComp)
    for node in (first, second):
        if isinstance(node, literal):
            return False
        if isinstance(node, ast.Constant) and not isinstance(node.value, (int, float)):
            return False
        if isinstance(node, ast.Attribute) and ast.unparse(node).startswith(("np.", "pa.")):
            return False  # a type
    return ast.dump(first) != ast.dump(second)


def is_a_text(node: ast.expr) -> bool:
    """Whether a node is a literal text."""
    if isinstance(node, ast.JoinedStr):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def called_name(node: ast.Call) -> str:
    """The last word of what is called: `cos` of `np.cos`."""
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


def is_left_out(node: ast.AST) -> bool:
    """Whether nothing inside a node is changed."""
    if isinstance(node, (ast.Raise, ast.JoinedStr, ast.Assert)):
        return True
    if isinstance(node, ast.Call):
        return called_name(node) in LOGGING or called_name(node).endswith("Error")
    if isinstance(node, ast.keyword):
        return node.arg in ONLY_STYLE or node.arg == "description"
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    if isinstance(node, (ast.Assign, ast.AnnAssign)):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [target.id for target in targets if isinstance(target, ast.Name)]
        return any(name == "__all__" or ONLY_DIVIDES_WORK.search(name) for name in names)
    return False


def changed_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below a node in which a change is a bug."""
    for field, value in ast.iter_fields(node):
        if field in {"annotation", "returns", "decorator_list", "type_params"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not is_left_out(child):
                yield child
                yield from changed_nodes(child)


def changes_of_constant(source: Source, node: ast.Constant) -> Iterator[Change]:
    """Another number, the other truth value, another unit."""
    value = node.value
    if isinstance(value, bool):
        yield source.replaced("truth value", node, str(not value))
    elif isinstance(value, (int, float)):
        others = [2 * value, 10 * value, -value, value + 1]
        for other in others:
            if other != value:
                yield source.replaced("number", node, repr(other))
    elif isinstance(value, str) and value in EXCHANGED_UNITS:
        yield source.replaced("unit", node, repr(EXCHANGED_UNITS[value]))


def changes_of_call(source: Source, node: ast.Call) -> Iterator[Change]:
    """A call left out, of a sister function, or with exchanged arguments."""
    name = called_name(node)
    if name in REMOVED_CALLS and node.args:
        yield source.replaced("removed call", node, f"({source.text(node.args[0])})")
    if name in EXCHANGED_CALLS:
        called = source.text(node.func)
        sister = called[: -len(name)] + EXCHANGED_CALLS[name]
        yield source.replaced("sister function", node.func, sister)
    if name in NOT_EXCHANGED:
        return
    for first, second in itertools.pairwise(node.args):
        if not isinstance(first, ast.Starred) and not isinstance(second, ast.Starred):
            yield from source.exchanged("arguments", first, second)
    named = [keyword for keyword in node.keywords if keyword.arg]
    for keyword, following in itertools.pairwise(named):
        if keyword.arg not in ONLY_STYLE and following.arg not in ONLY_STYLE:
            yield from source.exchanged("keyword values", keyword.value, following.value)


def changes_of_operator(source: Source, node: ast.AST) -> Iterator[Change]:
    """Another operator of arithmetic, comparison or logic; a sign or a `not` left out."""
    if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        is_text = any(map(is_a_text, (node.left, node.right)))
        if not is_text:
            before, after = ARITHMETIC[type(node.op)]
            yield from source.operator("arithmetic", node.left, node.right, before, after)
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        before, others = COMPARISONS[type(node.ops[0])]
        for after in others:
            right = node.comparators[0]
            yield from source.operator("comparison", node.left, right, before, after)
    elif isinstance(node, ast.BoolOp):
        before, after = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in itertools.pairwise(node.values):
            yield from source.operator("and/or", left, right, before, after)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        kind = "sign" if isinstance(node.op, ast.USub) else "removed not"
        yield source.replaced(kind, node, f"({source.text(node.operand)})")
    elif isinstance(node, ast.Dict):
        pairs = zip(node.keys, node.keys[1:], node.values, node.values[1:], strict=False)
        for key, next_key, value, next_value in pairs:
            if key is not None and next_key is not None:
                yield from source.exchanged("dictionary values", value, next_value)


def changes_of(source: Source) -> Iterator[Change]:
    """All changes of a module that may be drawn."""
    for node in changed_nodes(source.tree):
        if isinstance(node, ast.Constant):
            yield from changes_of_constant(source, node)
        elif isinstance(node, ast.Call):
            yield from changes_of_call(source, node)
        else:
            yield from changes_of_operator(source, node)
