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
_SHOWN = 60  # letters of a damaged definition, in the ledger

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
    """``count`` numbers of one ``kind``, a numpy type; ``array`` says whether they are an array.

    An array of one number is not the same as a single number.
    """

    path: str
    kind: str
    count: int = 1
    array: bool = False


@dataclass(frozen=True)
class TextField:
    """A text under a name."""

    path: str


@dataclass(frozen=True)
class SequenceField:
    """A sequence: each message says how many elements it has; ``steps`` are those of an element."""

    path: str
    steps: tuple[MessageField, ...]


MessageField = NumberField | TextField | SequenceField


def steps_of(name: str, text: str) -> tuple[MessageField, ...]:
    """The steps of a message, from the definitions that a log has of it.

    The path of a step is the names that lead to it, joined by dots.

    ``name``: of the message, ``sensor_msgs/msg/Imu``. ``text``: its definition, and those of the
    messages in it below lines of ``=`` and ``MSG: name``. Raises SchemaError.

    >>> steps_of("a/msg/B", "C c\\nstring s\\n===\\nMSG: a/C\\nfloat64[3] x")
    (NumberField(path='c.x', kind='f8', count=3, array=True), TextField(path='s'))
    """
    definitions = dict(_BUILT_IN)
    current = short(name)  # of the first part, which has no title
    for part in _SEPARATOR.split(text):
        title = _TITLE.search(part)
        definition = part
        if title:
            current = short(title.group(1))
            definition = part.replace(title.group(0), "", 1)
        definitions[current] = definition
    flattener = _Flattener(definitions)
    return tuple(flattener.message(short(name), prefix="", depth=0))


def short(name: str) -> str:
    """The name of a message without the ``msg`` that ROS 2 puts into it.

    >>> short("sensor_msgs/msg/NavSatFix")
    'sensor_msgs/NavSatFix'
    """
    return name.replace("/msg/", "/")


class _Declared(NamedTuple):
    """A field as a definition declares it: its kind, array and name."""

    kind: str
    array: str
    name: str

    @property
    def fixed_size(self) -> int:
        """How many elements an array has that has as many in each message; 0 for other fields."""
        size = self.array[1:-1]
        return int(size) if size.isdigit() else 0

    @property
    def is_sequence(self) -> bool:
        """Whether each message says how many elements it has."""
        return bool(self.array) and not self.fixed_size


# The field of a message without fields: IDL knows no such message, and ROS 2 puts a byte there.
_OF_EMPTY_MESSAGE = _Declared("uint8", "", "structure_needs_at_least_one_member")


@dataclass
class _Flattener:
    """Turns the definitions of a message, and of the messages inside it, into steps.

    ``count`` counts the steps so far, and each is counted when it is made: a definition of a few
    lines can nest millions of steps. ``parsed`` are the fields of definitions read so far.
    """

    definitions: Mapping[str, str]
    parsed: dict[str, list[_Declared]] = field(default_factory=dict)
    count: int = 0

    def message(self, name: str, prefix: str, depth: int) -> Iterator[MessageField]:
        """The steps of a message; their paths begin with ``prefix``.

        ``depth``: how many messages it lies inside of.
        """
        if depth > MAX_DEPTH:
            raise SchemaError(f"{prefix.rstrip('.')} is {depth} messages deep")
        if name not in self.parsed:
            self.parsed[name] = self.parse(name)
        package = name.split("/")[0]
        for declared in self.parsed[name]:
            yield from self.field(declared, prefix + declared.name, package, depth)

    def parse(self, name: str) -> list[_Declared]:
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
                raise SchemaError(f"{text[:_SHOWN]!r} of {name} is not a field")
            fields.append(_Declared(match["kind"], match["array"] or "", match["name"]))
        return fields or [_OF_EMPTY_MESSAGE]

    def counted(self, step: MessageField) -> MessageField:
        """Count a step and return it; SchemaError if there are too many."""
        self.count += 1
        if self.count > MAX_STEPS:
            raise SchemaError(f"more than {MAX_STEPS} fields, at {step.path[:_SHOWN]}")
        return step

    def field(
        self, declared: _Declared, path: str, package: str, depth: int
    ) -> Iterator[MessageField]:
        """The steps of one field. ``package`` is that of the message that declares it.

        The kind of a message is taken from that package if it is named without one.
        """
        kind = declared.kind
        size = declared.fixed_size
        if kind == "wstring":
            raise SchemaError(f"{path} is a wstring, which cannot be read")
        most = MAX_COUNT - 1 if kind in KINDS else MAX_STEPS  # an array of numbers is one step
        if size > most:
            raise SchemaError(f"{path[:_SHOWN]} has {size} elements")
        if kind in KINDS:
            numbers = NumberField(path, KINDS[kind], size or 1, array=size > 0)
            if declared.is_sequence:
                yield self.counted(SequenceField(path, (numbers,)))
            else:
                yield self.counted(numbers)
        elif kind == "string":
            yield from self.texts(declared, path)
        else:
            inner = short(kind) if "/" in kind else f"{package}/{kind}"
            yield from self.messages(inner, declared, path, depth + 1)

    def texts(self, declared: _Declared, path: str) -> Iterator[MessageField]:
        """The steps of a text, or of several."""
        if declared.is_sequence:
            yield self.counted(SequenceField(path, (TextField(path),)))
        elif declared.fixed_size:
            for k in range(declared.fixed_size):
                yield self.counted(TextField(f"{path}.{k}"))
        else:
            yield self.counted(TextField(path))

    def messages(
        self, name: str, declared: _Declared, path: str, depth: int
    ) -> Iterator[MessageField]:
        """The steps of a message inside a message, or of several."""
        if declared.is_sequence:
            yield SequenceField(path, tuple(self.message(name, f"{path}.", depth)))
        elif declared.fixed_size:
            for k in range(declared.fixed_size):
                yield from self.message(name, f"{path}.{k}.", depth)
        else:
            yield from self.message(name, f"{path}.", depth)
