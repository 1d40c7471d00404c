"""The text of a mission file: YAML of plain values, and the lines of its keys."""

import re
from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from unbend.config import messages
from unbend.config.likely_meant import comma_in_words
from unbend.config.mission_file import Mission
from unbend.config.other_files import MISSION_ENDINGS, other_file
from unbend.errors import ConfigError

Place = tuple[str | int, ...]
"""The place of a value: the keys that lead to it, and for lists the numbers of items, from 0."""

TODO = "TODO"
"""The value of a key in a mission file that the user still has to write: an open question."""

PROBLEMS = {
    "mapping values are not allowed here": (
        "there is a colon at a place where it is not allowed: put quotes around the text, or check "
        "the indentation"
    ),
    "found character '\\t' that cannot start any token": (
        "there is a tab: YAML is indented by spaces"
    ),
    "could not find expected ':'": "here or above, there is a key without a colon",
    "expected <block end>": "the indentation differs from that of the lines above",
    "expected ',' or": "a bracket or a brace is not closed, or a comma is missing",
    "could not determine a constructor": "tags (!) are not allowed",
    "found undefined alias": "an alias (*) has no anchor (&); put quotes around a text with *",
    "expected alphabetic or numeric character": "put quotes around a text that begins with * or &",
    "found unknown escape character": (
        "in double quotes a backslash begins an escape: write / or single quotes"
    ),
    "found character": "put quotes around a text that begins with this character",
    "expected a single document": (
        "there are several documents (---); a mission file must have one"
    ),
}
"""Beginnings of problems that the YAML parser reports, and plain words for them."""

MOST_BRACKETS = 50  # inside each other; a mission file has five at most

MOST_BYTES = 500_000
"""Of a mission file, which has some kB: the YAML parser takes 2 s for half a megabyte."""

MOST_VALUES = 1_000_000
"""Values of a file with its aliases written out: a campaign of thousands of missions has fewer."""

_BEFORE_QUOTES = (
    "expected ',' or",
    "expected <block end>",
    "mapping values are not allowed here",
)
"""Beginnings of problems that a text with brackets but without quotes may cause."""

_WITH_BRACKETS = re.compile(
    r"""(?P<before>[^\s,:{}\[\]"']*)[\[{][^\s,{}\[\]"']*[\]}](?P<behind>[^\s,:{}\[\]"']*)"""
)

_REPLACED_TYPES = ("bool", "int", "float", "timestamp")
"""Types of scalars that YAML 1.1 reads differently; rules of YAML 1.2 replace them below."""


_OWN_WORDS = ("the key ", "a key ", "a number ", "an alias ", "aliases ", "too many brackets ")
"""Beginnings of problems in our own words, from `MissionLoader` and `_expanded_size`."""

_YAML_ERRORS = (
    yaml.YAMLError,
    ValueError,
    RecursionError,  # brackets in brackets, and an alias that contains itself
    LookupError,  # this and the next are caused by tags (!!bool x, !!timestamp x)
    AttributeError,
    TypeError,
    ArithmeticError,
)
"""Errors that reading a text as YAML may raise."""


class MissionLoader(yaml.SafeLoader):
    """YAML 1.2 scalars (1e-6 is a number, no, on and 1:30 are words) and no repeated keys."""

    def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
        """Refuse more than `MOST_BRACKETS` brackets inside each other.

        The time to read them grows with the square of their number.
        """
        if self.flow_level >= MOST_BRACKETS:
            raise yaml.scanner.ScannerError(
                problem="too many brackets are inside each other", problem_mark=self.get_mark()
            )
        super().fetch_flow_collection_start(kind)

    def construct_mapping(
        self,
        node: yaml.MappingNode,
        deep: bool = False,  # noqa: FBT001, FBT002
    ) -> dict[Any, Any]:
        """The mapping of a node; refuses keys that are not words, and repeated keys."""
        _refuse_decimal_comma(node)
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(
                    problem="a key must be a word", problem_mark=key.start_mark
                )
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"the key {key.value!r} occurs twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _whole_number(loader: MissionLoader, node: yaml.ScalarNode) -> int:
    """The whole number of a node; refuses more than 4300 digits, which Python does not convert."""
    try:
        return int(loader.construct_yaml_int(node))
    except (ValueError, LookupError):
        raise yaml.constructor.ConstructorError(
            problem="a number has too many digits, or is not a number", problem_mark=node.start_mark
        ) from None


def _refused_tag(loader: MissionLoader, node: yaml.Node) -> None:
    """Refuse (ConstructorError) a value with a tag of YAML that no key allows."""
    loader.construct_undefined(node)


MissionLoader.add_constructor("tag:yaml.org,2002:int", _whole_number)
for _name in ("timestamp", "binary", "set", "omap", "pairs"):
    MissionLoader.add_constructor(f"tag:yaml.org,2002:{_name}", _refused_tag)
MissionLoader.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if tag.rsplit(":", 1)[1] not in _REPLACED_TYPES]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
MissionLoader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|false|False)$"), list("tTfF")
)
# A leading zero is left to the next rule: YAML 1.1 would read 0100 as 64.
MissionLoader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789")
)
MissionLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$|^[-+]?\.(?:inf|Inf|INF)$"
        r"|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)


def _refuse_decimal_comma(node: yaml.MappingNode) -> None:
    """Refuse a number with a decimal comma in braces, as {k1: -0,018}.

    There a comma separates keys: YAML reads k1: -0 and a key 018 without a value.
    """
    for (key, value), (next_key, next_value) in pairwise(node.value):
        if not all(
            isinstance(part, yaml.ScalarNode) for part in (key, value, next_key, next_value)
        ):
            continue
        is_without_value = next_value.value == "" and next_value.style is None
        touches = next_key.start_mark.index == value.end_mark.index + 1  # no blank after the comma
        if not (is_without_value and touches):
            continue
        comma = comma_in_words(f"{value.value},{next_key.value}")
        if comma:
            raise yaml.constructor.ConstructorError(
                problem=f"the key {key.value!r}: {comma}", problem_mark=key.start_mark
            )


def read_yaml(path: Path) -> tuple[dict[str, Any], yaml.Node]:
    """The values of a file by section, and its root node, which has the lines of the keys.

    Refuses (ConfigError) any file that is not YAML with keys.
    """
    text = _text_of(path)
    try:
        loader = MissionLoader(text)
        node = loader.get_single_node()
        if node is not None:
            _expanded_size(node, {}, set())
        values = None if node is None else loader.construct_document(node)
    except _YAML_ERRORS as error:
        raise refusal_of_text(error, path, text.splitlines()) from None
    if node is None or not isinstance(values, dict):
        required = [name for name, field in Mission.model_fields.items() if field.is_required()]
        raise messages.config_empty(path=path, required=", ".join(required))
    return values, node


def _text_of(path: Path) -> str:
    """The text of a mission file; refuses (ConfigError) other files, and those without text."""
    try:
        # Reading a pipe might never end; a name that is too long raises here.
        is_device = path.exists() and not (path.is_file() or path.is_dir())
    except OSError as error:
        raise messages.config_unreadable(path=path, problem=str(error.strerror)) from None
    if is_device:
        problem = "it is a pipe or a device, not a file"
        raise messages.config_unreadable(path=path, problem=problem)
    refuse_other_file(path)
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise messages.config_too_large(path=path, size=size, most=MOST_BYTES)
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise messages.config_missing(path=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise messages.config_unreadable(path=path, problem=str(error)) from None


def refuse_other_file(path: Path) -> None:
    """Refuse (CONFIG-UNREADABLE) a path that cannot be a mission file, as a log or a folder.

    Files with the ending of a mission file pass.
    """
    if path.suffix.lower() in MISSION_ENDINGS and path.is_file():
        return
    other = other_file(path)
    if other is not None:
        raise messages.config_other_file(path=path, what=other.what, remedy=other.remedy)


def _expanded_size(node: yaml.Node, sizes: dict[int, int], around: set[int]) -> int:
    """How many values a node contains if each alias (*) is written out.

    Raises ConstructorError for an alias inside the node that it repeats, and for more than
    `MOST_VALUES`. ``sizes`` (results so far) and ``around`` (nodes around this one) have nodes by
    their ``id``; both are changed.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in sizes:
        return sizes[id(node)]
    if id(node) in around:
        raise yaml.constructor.ConstructorError(
            problem="an alias (*) is inside the section or list that it repeats",
            problem_mark=node.start_mark,
        )
    around.add(id(node))
    total = 1
    for inner in _nodes_in(node):
        total += _expanded_size(inner, sizes, around)
    around.discard(id(node))
    if total > MOST_VALUES:
        raise yaml.constructor.ConstructorError(
            problem=f"aliases (*) repeat their sections to more than {MOST_VALUES} values",
            problem_mark=node.start_mark,
        )
    sizes[id(node)] = total
    return total


def _nodes_in(node: yaml.Node) -> Iterator[yaml.Node]:
    """The nodes of keys and values of a section, or of the items of a list."""
    if isinstance(node, yaml.SequenceNode):
        yield from node.value
    elif isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield key
            yield value


def refusal_of_text(error: Exception, path: Path, lines: Sequence[str]) -> ConfigError:
    """The refusal of a text that is not YAML, with its line if the parser states it.

    ``lines`` are those of the text.
    """
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return messages.config_yaml(where=str(path), problem=problem_of(error, ""))
    # The parser may stop behind the last line, or behind a last line that is empty.
    line = lines[mark.line] if mark.line < len(lines) else ""
    where = f"{path}:{mark.line + 1}"
    return messages.config_yaml(where=where, problem=problem_of(error, line))


def problem_of(error: Exception, line: str) -> str:
    """The problem of the parser in plain words; ``line`` is the text where it stopped."""
    problem = str(getattr(error, "problem", None) or error)
    if problem.startswith(_OWN_WORDS):
        return problem  # in the words of `MissionLoader`
    unquoted = text_without_quotes(line)
    if unquoted and problem.startswith(_BEFORE_QUOTES):
        return f'put quotes around a text with brackets or braces: "{unquoted}"'
    for beginning, words in PROBLEMS.items():
        if problem.startswith(beginning):
            return words
    return "here the text is not YAML"  # a problem that `PROBLEMS` does not list


def text_without_quotes(line: str) -> str:
    """The first text in a line that has brackets or braces inside, but no quotes; else "".

    >>> text_without_quotes("nadir: {channel: CAM[0], image: x}")
    'CAM[0]'
    >>> text_without_quotes("image: {index:05d}.jpg"), text_without_quotes("at: [0, 1]")
    ('{index:05d}.jpg', '')
    """
    for text in _WITH_BRACKETS.finditer(line.partition(" #")[0]):
        if text["before"] or text["behind"]:
            return text[0]
    return ""


def open_questions(values: object) -> list[Place]:
    """The places with the value `TODO`, in the order of the file.

    In a section or list that aliases repeat, they count once.
    """
    questions: list[Place] = []
    walked: set[int] = set()
    unvisited: list[tuple[Place, Any]] = [((), values)]
    while unvisited:
        place, value = unvisited.pop()
        if value == TODO:
            questions.append(place)
        if not isinstance(value, dict | list):
            continue
        if id(value) in walked:  # an alias repeats this section or list
            continue
        walked.add(id(value))
        items = value.items() if isinstance(value, dict) else enumerate(value)
        inner = [((*place, key), item) for key, item in items]
        unvisited += reversed(inner)  # the last entry is taken first
    return questions


def line_of(node: yaml.Node, place: Place) -> int:
    """The number of the line (from 1) of the last key of a place that is in the file.

    ``node`` is the root of the file. An item of a list has no key: its line is that of the list.
    """
    line = int(node.start_mark.line) + 1
    for key in place:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
            continue
        pair = _nodes_of_key(node, key)
        if pair is None:
            break
        key_node, node = pair
        line = int(key_node.start_mark.line) + 1
    return line


def _nodes_of_key(node: yaml.Node, key: str | int) -> tuple[yaml.Node, yaml.Node] | None:
    """The node of a key in a mapping, and that of its value; None without this key."""
    if not isinstance(node, yaml.MappingNode):
        return None
    for key_node, value_node in node.value:
        if key_node.value == key:
            return key_node, value_node
    return None


def has_place(values: object, place: Place) -> bool:
    """Whether the values of a file have something at a place, null included."""
    value: Any = values
    for key in place:
        if isinstance(value, dict):
            keys: Collection[object] = value
        elif isinstance(value, list):
            keys = range(len(value))
        else:
            return False
        if key not in keys:
            return False
        value = value[key]
    return True
