"""Definitions of ROS 2 messages -> the steps in which their fields follow each other."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

# The kinds that mcap-ros2-support reads: byte unsigned, char signed, bool one byte.
KINDS: Mapping[str, str] = {
    "bool": "?", "byte": "u1", "char": "i1",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


MAX_DEPTH = 16  # the deepest message of ROS 2's own packages has 6


MAX_STEPS = 4096  # of a flattened message, with the insides of sequences; Imu has 37 numbers


MAX_COUNT = 1 << 31  # elements of an array: numpy has no larger items


_TIME = "int32 sec\nuint32 nanosec"


_BUILT_IN = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}


_FIELD = re.compile(r"^([\w/]+)(<=\d+)?(\[(?:<=)?\d*\])?\s+(\w+)(?:\s|$)")


_CONSTANT = re.compile(r"^\S+\s+\w+\s*=")


class SchemaError(ValueError):
    """A definition that cannot be understood."""


@dataclass(frozen=True)
class NumberField:
    """``count`` numbers of one kind under a name; ``array`` where the message has an array."""

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
    """As many elements as the message says; each consists of steps of its own."""

    path: str
    steps: tuple[MessageField, ...]


MessageField = NumberField | TextField | SequenceField


def steps_of(name: str, text: str) -> tuple[MessageField, ...]:
    """The steps of a message from the definitions that a log has of it; names are joined by dots.

    ``name``: of the message, ``sensor_msgs/msg/Imu``. ``text``: its definition, and those of the
    messages in it below lines of ``=`` and ``MSG: name``. Raises SchemaError.

    >>> steps_of("a/msg/B", "C c\\nstring s\\n===\\nMSG: a/C\\nfloat64[3] x")
    (NumberField(path='c.x', kind='f8', count=3, array=True), TextField(path='s'))
    """
    definitions = dict(_BUILT_IN)
    current = short(name)
    for part in re.split(r"^={3,}\s*$", text, flags=re.MULTILINE):
        title = re.search(r"^MSG:\s+(\S+)\s*$", part, flags=re.MULTILINE)
        if title:
            current = short(title.group(1))
            part = part.replace(title.group(0), "", 1)
        definitions[current] = part
    return tuple(_Flattener(definitions).message(short(name), "", 0))


def short(name: str) -> str:
    """The name of a message without the ``msg`` that ROS 2 puts into it.

    >>> short("sensor_msgs/msg/NavSatFix")
    'sensor_msgs/NavSatFix'
    """
    return name.replace("/msg/", "/")


@dataclass
class _Flattener:
    """Flattening; steps are counted before they are kept: some lines can nest millions of them."""

    definitions: Mapping[str, str]
    parsed: dict[str, list[tuple[str, str, str]]] = field(default_factory=dict)
    count: int = 0

    def message(self, name: str, prefix: str, depth: int) -> Iterator[MessageField]:
        if depth > MAX_DEPTH:
            raise SchemaError(f"{prefix.rstrip('.')} lies {depth} messages deep")
        if name not in self.parsed:
            self.parsed[name] = self.parse(name)
        for kind, array, member in self.parsed[name]:
            yield from self.field(kind, array, prefix + member, owner=name, depth=depth)

    def parse(self, name: str) -> list[tuple[str, str, str]]:
        """Kind, array and name of each field of a definition."""
        if name not in self.definitions:
            raise SchemaError(f"the definition of {name} is missing")
        fields = []
        for line in self.definitions[name].splitlines():
            text = line.split("#", 1)[0].strip()
            if not text or _CONSTANT.match(text):
                continue
            match = _FIELD.match(text)
            if not match:
                raise SchemaError(f"{text[:60]!r} of {name} is no field")
            kind, _, array, member = match.groups()
            fields.append((kind, array or "", member))
        # IDL knows no empty message: ROS 2 puts a byte there
        return fields or [("uint8", "", "structure_needs_at_least_one_member")]

    def counted(self, step: MessageField) -> MessageField:
        self.count += 1
        if self.count > MAX_STEPS:
            raise SchemaError(f"more than {MAX_STEPS} fields, at {step.path[:60]}")
        return step

    def field(
        self, kind: str, array: str, path: str, *, owner: str, depth: int
    ) -> Iterator[MessageField]:
        if kind == "wstring":
            raise SchemaError(f"{path} is a wstring, which is not read")
        fixed = int(array[1:-1]) if array[1:-1].isdigit() else 0
        if fixed >= MAX_COUNT or (fixed > MAX_STEPS and kind not in KINDS):
            raise SchemaError(f"{path[:60]} has {fixed} elements")
        if kind in KINDS:
            numbers = NumberField(path, KINDS[kind], fixed or 1, bool(fixed))
            yield self.counted(SequenceField(path, (numbers,)) if array and not fixed else numbers)
            return
        if kind == "string":
            if array and not fixed:
                yield self.counted(SequenceField(path, (TextField(path),)))
            elif fixed:
                yield from (self.counted(TextField(f"{path}.{k}")) for k in range(fixed))
            else:
                yield self.counted(TextField(path))
            return
        inner = short(kind) if "/" in kind else f"{owner.split('/')[0]}/{kind}"
        if array and not fixed:
            yield SequenceField(path, tuple(self.message(inner, f"{path}.", depth + 1)))
            return
        for k in range(fixed or 1):
            prefix = f"{path}.{k}." if fixed else f"{path}."
            yield from self.message(inner, prefix, depth + 1)
