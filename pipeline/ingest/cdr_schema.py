"""ROS 2 message definitions as text -> what lies where in a CDR message.

A definition is flattened into steps: runs of numbers whose layout is fixed once the place of the
first is known, and texts and sequences, whose length stands in the message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

# The kinds that mcap-ros2-support reads: byte unsigned, char signed, bool one byte.
KINDS: Mapping[str, str] = {
    "bool": "?", "byte": "u1", "char": "i1",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip

MAX_DEPTH = 16  # the deepest message of ROS 2's own packages has 6
MAX_STEPS = 4096  # of a flattened message; sensor_msgs/Imu has 37 numbers

_TIME = "int32 sec\nuint32 nanosec"
_BUILT_IN = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}
_FIELD = re.compile(r"^([\w/]+)(<=\d+)?(\[(?:<=)?\d*\])?\s+(\w+)(?:\s|$)")
_CONSTANT = re.compile(r"^\S+\s+\w+\s*=")


class SchemaError(ValueError):
    """A definition that cannot be understood."""


@dataclass(frozen=True)
class Numbers:
    """``count`` numbers of one kind under a name; ``array`` where the message has an array."""

    path: str
    kind: str
    count: int = 1
    array: bool = False


@dataclass(frozen=True)
class Text:
    """A text under a name."""

    path: str


@dataclass(frozen=True)
class Sequence:
    """As many elements as the message says; each consists of steps of its own."""

    path: str
    steps: tuple[Step, ...]


Step = Numbers | Text | Sequence


def steps_of(name: str, text: str) -> tuple[Step, ...]:
    """The steps of a message from the definitions that a log has of it.

    Parameters
    ----------
    name : of the message, ``sensor_msgs/msg/Imu``.
    text : its definition, and those of the messages in it below lines of ``=`` and ``MSG: name``.

    Raises SchemaError. Names are joined by dots.

    >>> steps_of("a/msg/B", "C c\\nstring s\\n===\\nMSG: a/C\\nfloat64[3] x")
    (Numbers(path='c.x', kind='f8', count=3, array=True), Text(path='s'))
    """
    definitions = dict(_BUILT_IN)
    current = short(name)
    for part in re.split(r"^={3,}\s*$", text, flags=re.MULTILINE):
        found = re.search(r"^MSG:\s+(\S+)\s*$", part, flags=re.MULTILINE)
        if found:
            current = short(found.group(1))
            part = part.replace(found.group(0), "", 1)
        definitions[current] = part
    steps = tuple(_flat(short(name), "", definitions, 0))
    if len(steps) > MAX_STEPS:
        raise SchemaError(f"{len(steps)} fields; the limit is {MAX_STEPS}")
    return steps


def short(name: str) -> str:
    """The name of a message without the ``msg`` that ROS 2 puts into it.

    >>> short("sensor_msgs/msg/NavSatFix")
    'sensor_msgs/NavSatFix'
    """
    return name.replace("/msg/", "/")


def _flat(name: str, prefix: str, definitions: Mapping[str, str], depth: int) -> Iterator[Step]:
    if depth > MAX_DEPTH:
        raise SchemaError(f"{prefix.rstrip('.')} lies {depth} messages deep")
    if name not in definitions:
        raise SchemaError(f"the definition of {name} is missing")
    empty = True
    for line in definitions[name].splitlines():
        line = line.split("#", 1)[0].strip()
        if not line or _CONSTANT.match(line):
            continue
        found = _FIELD.match(line)
        if not found:
            raise SchemaError(f"{line[:60]!r} of {name} is no field")
        empty = False
        kind, _, array, field = found.groups()
        yield from _field(kind, array or "", prefix + field, name, definitions, depth)
    if empty:  # IDL knows no empty message: ROS 2 puts a byte there
        yield Numbers(f"{prefix}structure_needs_at_least_one_member", "u1")


def _field(
    kind: str, array: str, path: str, owner: str, definitions: Mapping[str, str], depth: int
) -> Iterator[Step]:
    if kind == "wstring":
        raise SchemaError(f"{path} is a wstring, which is not read")
    fixed = int(array[1:-1]) if array[1:-1].isdigit() else 0
    if kind in KINDS:
        one = Numbers(path, KINDS[kind], fixed or 1, bool(fixed))
        yield Sequence(path, (one,)) if array and not fixed else one
        return
    if kind == "string":
        if array and not fixed:
            yield Sequence(path, (Text(path),))
        elif fixed:
            yield from (Text(f"{path}.{k}") for k in range(min(fixed, MAX_STEPS + 1)))
        else:
            yield Text(path)
        return
    inner = short(kind) if "/" in kind else f"{owner.split('/')[0]}/{kind}"
    if array and not fixed:
        yield Sequence(path, tuple(_flat(inner, f"{path}.", definitions, depth + 1)))
        return
    if fixed > MAX_STEPS:
        raise SchemaError(f"{path} has {fixed} elements; the limit is {MAX_STEPS}")
    for k in range(fixed or 1):
        prefix = f"{path}.{k}." if fixed else f"{path}."
        yield from _flat(inner, prefix, definitions, depth + 1)
