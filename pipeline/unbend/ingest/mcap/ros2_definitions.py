"""Definitions of ROS 2 messages -> the steps in which their fields follow each other."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

# The kinds that mcap-ros2-support reads: byte unsigned, char signed, bool one byte.
KINDS: Mapping[str, str] = {
    "bool": "?",
    "byte": "u1",
    "char": "i1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}

MAX_DEPTH = 16  # the deepest message of ROS 2's own packages has 6
MAX_STEPS = 4096  # of a flattened message, with the insides of sequences; Imu has 37 numbers
MAX_COUNT = 1 << 31  # elements of an array: numpy has no larger items
_SHOWN_LETTERS = 60  # of a damaged definition, in the ledger

_TIME = "int32 sec\nuint32 nanosec"
_BUILT_IN = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}
_FIELD = re.compile(r"^(?P<kind>[\w/]+)(<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>\w+)(?:\s|$)")
_CONSTANT = re.compile(r"^\S+\s+\w+\s*=")
_SEPARATOR = re.compile(r"^={3,}\s*$", flags=re.MULTILINE)
_TITLE = re.compile(r"^MSG:\s+(\S+)\s*$", flags=re.MULTILINE)


class SchemaError(ValueError):
    """A definition that cannot be understood."""


@dataclass(frozen=True)
class NumberField:
    """``count`` numbers of one ``kind``, a numpy type.

    ``array`` is False for a single number only: an array may have one number too.
    """

    path: str
    kind: str
    count: int = 1
    array: bool = False


@dataclass(frozen=True)
class TextField:
    """A field with a text; ``path`` as of `steps_of`."""

    path: str


@dataclass(frozen=True)
class SequenceField:
    """An array with another number of elements in each message, which the message states.

    ``steps``: the fields of one element, in their order.
    """

    path: str
    steps: tuple[MessageField, ...]


MessageField = NumberField | TextField | SequenceField


def steps_of(name: str, text: str) -> tuple[MessageField, ...]:
    """The fields of a message in their order, those of messages inside it flattened: its steps.

    The path of a step is the names that lead to it, joined by dots.

    ``name``: of the message, such as ``sensor_msgs/msg/Imu``. ``text``: its definition in the log;
    those of the messages inside it follow, each below a line of ``=`` and ``MSG: name``. Raises
    SchemaError.

    >>> steps_of("a/msg/B", "C c\\nstring s\\n===\\nMSG: a/C\\nfloat64[3] x")
    (NumberField(path='c.x', kind='f8', count=3, array=True), TextField(path='s'))
    """
    definitions = dict(_BUILT_IN)
    current = short_name(name)  # of the first part, which has no title
    for part in _SEPARATOR.split(text):
        title = _TITLE.search(part)
        definition = part
        if title:
            current = short_name(title.group(1))
            definition = part.replace(title.group(0), "", 1)
        definitions[current] = definition
    flattener = _Flattener(definitions)
    return tuple(flattener.steps_of_message(short_name(name), prefix="", depth=0))


def short_name(name: str) -> str:
    """The name of a message without the ``msg`` that ROS 2 puts into it.

    >>> short_name("sensor_msgs/msg/NavSatFix")
    'sensor_msgs/NavSatFix'
    """
    return name.replace("/msg/", "/")


class _DeclaredField(NamedTuple):
    """A field as a definition declares it.

    ``array``: its brackets and what is in them, such as ``[3]``, ``[]`` or ``[<=3]``; "" without.
    """

    kind: str
    array: str
    name: str

    @property
    def fixed_size(self) -> int:
        """The number of elements of an array of fixed size; 0 for any other field."""
        size = self.array[1:-1]
        return int(size) if size.isdigit() else 0

    @property
    def is_sequence(self) -> bool:
        """Whether it is an array, and each message states how many elements that has."""
        return bool(self.array) and not self.fixed_size


# The byte that ROS 2 puts into a message without fields, as IDL has no such messages.
_FIELD_OF_EMPTY_MESSAGE = _DeclaredField("uint8", "", "structure_needs_at_least_one_member")


@dataclass
class _Flattener:
    """Turns the definitions of a message, and of the messages inside it, into steps.

    definitions : the text of each definition, by short name.
    parsed : the fields of the definitions read so far, by short name.
    step_count : of the steps so far. Each is counted when it is made, because a definition of a few
        lines can nest millions of steps.
    """

    definitions: Mapping[str, str]
    parsed: dict[str, list[_DeclaredField]] = field(default_factory=dict)
    step_count: int = 0

    def steps_of_message(self, name: str, prefix: str, depth: int) -> Iterator[MessageField]:
        """The steps of a message; their paths begin with ``prefix``.

        ``depth``: how many messages are around it, 0 for the message of a topic.
        """
        if depth > MAX_DEPTH:
            raise SchemaError(f"{prefix.rstrip('.')} is {depth} messages deep")
        if name not in self.parsed:
            self.parsed[name] = self.parse(name)
        package = name.split("/")[0]
        for declared in self.parsed[name]:
            yield from self.steps_of_field(declared, prefix + declared.name, package, depth)

    def parse(self, name: str) -> list[_DeclaredField]:
        """The fields that the definition of a message declares, without its constants."""
        if name not in self.definitions:
            raise SchemaError(f"the definition of {name} is missing")
        fields = []
        for line in self.definitions[name].splitlines():
            text = line.split("#", 1)[0].strip()
            if not text or _CONSTANT.match(text):
                continue
            match = _FIELD.match(text)
            if not match:
                raise SchemaError(f"{text[:_SHOWN_LETTERS]!r} of {name} is not a field")
            fields.append(_DeclaredField(match["kind"], match["array"] or "", match["name"]))
        return fields or [_FIELD_OF_EMPTY_MESSAGE]

    def counted(self, step: MessageField) -> MessageField:
        """Count a step and return it; SchemaError if there are too many."""
        self.step_count += 1
        if self.step_count > MAX_STEPS:
            raise SchemaError(f"more than {MAX_STEPS} fields, at {step.path[:_SHOWN_LETTERS]}")
        return step

    def steps_of_field(
        self, declared: _DeclaredField, path: str, package: str, depth: int
    ) -> Iterator[MessageField]:
        """The steps of one field, which has this path.

        ``package``: that of the message that declares the field, for a kind that is named without
        one. ``depth``: how many messages are around the message that declares the field.
        """
        kind = declared.kind
        size = declared.fixed_size
        if kind == "wstring":
            raise SchemaError(f"{path} is a wstring, which cannot be read")
        max_size = MAX_COUNT - 1 if kind in KINDS else MAX_STEPS  # numbers together are one step
        if size > max_size:
            raise SchemaError(f"{path[:_SHOWN_LETTERS]} has {size} elements")
        if kind in KINDS:
            numbers = NumberField(path, KINDS[kind], size or 1, array=size > 0)
            if declared.is_sequence:
                yield self.counted(SequenceField(path, (numbers,)))
            else:
                yield self.counted(numbers)
        elif kind == "string":
            yield from self.steps_of_texts(declared, path)
        else:
            inner = short_name(kind) if "/" in kind else f"{package}/{kind}"
            yield from self.steps_of_messages(inner, declared, path, depth + 1)

    def steps_of_texts(self, declared: _DeclaredField, path: str) -> Iterator[MessageField]:
        """The steps of a field with a text, or with an array or sequence of texts."""
        if declared.is_sequence:
            yield self.counted(SequenceField(path, (TextField(path),)))
        elif declared.fixed_size:
            for index in range(declared.fixed_size):
                yield self.counted(TextField(f"{path}.{index}"))
        else:
            yield self.counted(TextField(path))

    def steps_of_messages(
        self, name: str, declared: _DeclaredField, path: str, depth: int
    ) -> Iterator[MessageField]:
        """The steps of a field with a message, or with an array or sequence of messages.

        ``name``: of the message in the field, with package. ``depth``: of that message.
        """
        if declared.is_sequence:
            yield SequenceField(path, tuple(self.steps_of_message(name, f"{path}.", depth)))
        elif declared.fixed_size:
            for index in range(declared.fixed_size):
                yield from self.steps_of_message(name, f"{path}.{index}.", depth)
        else:
            yield from self.steps_of_message(name, f"{path}.", depth)
