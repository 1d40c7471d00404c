"""The text of a mission file: YAML of plain values, and the lines of its keys."""

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import yaml

from unbend.config import messages
from unbend.config.mission_file import Mission

Place = tuple[str | int, ...]
"""What leads to a value: keys of mappings, and for lists the numbers of their items, from 0."""

TODO = "TODO"
"""What stands in a mission file for a question that is still open."""

PROBLEMS = {
    "mapping values are not allowed here": (
        "there is a colon where none can stand: put quotes around the text, or check the "
        "indentation"
    ),
    "found character '\\t' that cannot start any token": (
        "there is a tab: YAML is indented by spaces"
    ),
    "could not find expected ':'": "a key without a colon stands here or above",
    "expected <block end>": "the indentation differs from that of the lines above",
    "expected ',' or": "a bracket or a brace is not closed, or a comma is missing",
    "could not determine a constructor": "tags (!) are not taken",
    "found undefined alias": "an alias (*) has no anchor (&)",
    "expected a single document": ("there are several documents (---); a mission file is one"),
}
"""Beginnings of what the YAML parser says, and the same in plain words."""

MOST_BRACKETS = 50  # a mission file has five within each other at most

MOST_VALUES = 1_000_000
"""Values of a file with its aliases written out: a campaign of thousands of missions has fewer."""

_REPLACED_TYPES = ("bool", "int", "float", "timestamp")
"""Scalars that YAML 1.1 reads otherwise than a mission file means them; dates stay words."""


_OWN_WORDS = ("the key ", "a key ", "a number ", "an alias ", "aliases ", "brackets ")
"""Beginnings of the problems that `MissionLoader` and `_expanded_size` state."""

_YAML_ERRORS = (
    yaml.YAMLError,
    ValueError,
    RecursionError,  # brackets in brackets, and an alias that holds itself
    LookupError,  # these are of tags (!!bool x, !!timestamp x)
    AttributeError,
    TypeError,
    ArithmeticError,
)
"""What reading a text as YAML raises."""


class MissionLoader(yaml.SafeLoader):
    """YAML 1.2 scalars (1e-6 is a number, no, on and 1:30 are words) and no repeated keys."""

    def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
        """Refuse brackets within many others: the time to read them grows with their square."""
        if self.flow_level >= MOST_BRACKETS:
            raise yaml.scanner.ScannerError(
                problem="brackets stand within too many others", problem_mark=self.get_mark()
            )
        super().fetch_flow_collection_start(kind)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping whose keys are words, each once."""
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(
                    problem="a key must be a word", problem_mark=key.start_mark
                )
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"the key {key.value!r} stands here twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _whole_number(loader: MissionLoader, node: yaml.ScalarNode) -> int:
    """A whole number; Python takes none of more than 4300 digits."""
    try:
        return int(loader.construct_yaml_int(node))
    except (ValueError, LookupError):
        raise yaml.constructor.ConstructorError(
            problem="a number has too many digits, or is none", problem_mark=node.start_mark
        ) from None


def _refused_tag(loader: MissionLoader, node: yaml.Node) -> None:
    """The refusal of a value with a tag of YAML that no key takes."""
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


def read_yaml(path: Path) -> tuple[dict[str, Any], yaml.Node]:
    """The sections of a file, and its nodes, which know their lines; refuses what is not YAML."""
    text = _text_of(path)
    try:
        loader = MissionLoader(text)
        node = loader.get_single_node()
        if node is not None:
            _expanded_size(node, {}, set())
        values = None if node is None else loader.construct_document(node)
    except _YAML_ERRORS as error:
        mark = getattr(error, "problem_mark", None)
        where = str(path) if mark is None else f"{path}:{mark.line + 1}"
        raise messages.config_yaml(where=where, problem=problem_of(error)) from None
    if node is None or not isinstance(values, dict):
        required = [name for name, field in Mission.model_fields.items() if field.is_required()]
        raise messages.config_empty(path=path, required=", ".join(required))
    return values, node


def _text_of(path: Path) -> str:
    """The text of a mission file; refuses what is no file, or no text."""
    try:
        # Reading a pipe might never end; a name that is too long raises here.
        is_other = path.exists() and not (path.is_file() or path.is_dir())
    except OSError as error:
        raise messages.config_unreadable(path=path, problem=str(error.strerror)) from None
    if is_other:
        problem = "it is a pipe or a device, not a file"
        raise messages.config_unreadable(path=path, problem=problem)
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise messages.config_missing(path=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise messages.config_unreadable(path=path, problem=str(error)) from None


def _expanded_size(node: yaml.Node, sizes: dict[int, int], around: set[int]) -> int:
    """How many values a node holds where each alias (*) is written out.

    Raises ConstructorError for an alias inside what it stands for, and for more values than
    `MOST_VALUES`. ``sizes`` are those known by the ids of nodes, ``around`` the nodes around it.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in sizes:
        return sizes[id(node)]
    if id(node) in around:
        raise yaml.constructor.ConstructorError(
            problem="an alias (*) stands inside the section or list that it repeats",
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
    """The keys and values of a section, or the items of a list."""
    if isinstance(node, yaml.SequenceNode):
        yield from node.value
    elif isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield key
            yield value


def problem_of(error: Exception) -> str:
    """What the parser found, in plain words."""
    problem = str(getattr(error, "problem", None) or error)
    if problem.startswith(_OWN_WORDS):
        return problem  # in the words of `MissionLoader`
    for beginning, words in PROBLEMS.items():
        if problem.startswith(beginning):
            return words
    return "here the text is no YAML"  # a problem that has no words of ours


def open_questions(values: object) -> list[Place]:
    """The places of a mission file where `TODO` stands; what aliases repeat counts once."""
    questions: list[Place] = []
    walked: set[int] = set()
    left: list[tuple[Place, Any]] = [((), values)]
    while left:
        place, value = left.pop()
        if value == TODO:
            questions.append(place)
        if not isinstance(value, dict | list):
            continue
        if id(value) in walked:  # an alias repeats this section or list
            continue
        walked.add(id(value))
        items = value.items() if isinstance(value, dict) else enumerate(value)
        inner = [((*place, key), item) for key, item in items]
        left += reversed(inner)  # the last one is taken first: in the order of the file
    return questions


def line_of(node: yaml.Node, place: Place) -> int:
    """The line of the last key of a place; of the last one that is there, if others are missing.

    An item of a list has no key: its line is that of the list's key.
    """
    line = int(node.start_mark.line) + 1
    for key in place:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
            continue
        pair = _pair_of(node, key)
        if pair is None:
            break
        key_node, node = pair
        line = int(key_node.start_mark.line) + 1
    return line


def _pair_of(node: yaml.Node, key: str | int) -> tuple[yaml.Node, yaml.Node] | None:
    """The nodes of a key of a mapping and of its value; None without the key."""
    if not isinstance(node, yaml.MappingNode):
        return None
    for key_node, value_node in node.value:
        if key_node.value == key:
            return key_node, value_node
    return None


def has_place(values: object, place: Place) -> bool:
    """Whether a place is in the values of a file."""
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
