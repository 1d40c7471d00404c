"""Messages of pymavlink's dialect: names, checksums, layouts and instance fields by id."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Message:
    """One message of the dialect.

    ``dtype`` of the payload in the order of the wire; ``fields`` in the order of the definition;
    ``texts`` those of them that are char arrays; ``instance_field`` or "".
    """

    number: int
    name: str
    crc_extra: int
    dtype: np.dtype[Any]
    fields: tuple[str, ...]
    texts: frozenset[str]
    instance_field: str


@dataclass(frozen=True)
class Dialect:
    """Messages by number, and numbers by name."""

    messages: Mapping[int, Message]
    numbers: Mapping[str, int]

    @property
    def extras(self) -> dict[int, int]:
        return {number: message.crc_extra for number, message in self.messages.items()}

    def name(self, number: int) -> str:
        """The name of a message, made up where the dialect does not know it."""
        known = self.messages.get(number)
        return f"UNKNOWN_{number}" if known is None else known.name

    def layouts(self, wanted: Mapping[str, Iterable[str]]) -> dict[int, np.dtype[Any]]:
        """The layouts of messages with only the wanted fields at their places, by number."""
        result = {}
        for name, fields in wanted.items():
            number = self.numbers.get(name)
            if number is not None:
                dtype, kept = self.messages[number].dtype, set(fields)
                where: Mapping[str, Any] = dtype.fields or {}
                names = [field for field in dtype.names or () if field in kept]
                result[number] = np.dtype(
                    {
                        "names": names,
                        "formats": [where[field][0] for field in names],
                        "offsets": [where[field][1] for field in names],
                        "itemsize": dtype.itemsize,
                    }
                )
        return result


@cache
def dialect() -> Dialect:
    """The library's union of all dialects."""
    from pymavlink.dialects.v20 import all as library

    messages = {}
    for number, definition in library.mavlink_map.items():
        texts = (
            field
            for field, kind in zip(definition.fieldnames, definition.fieldtypes, strict=True)
            if kind == "char"
        )
        messages[int(number)] = Message(
            int(number),
            str(definition.msgname),
            int(definition.crc_extra),
            layout_of(definition.unpacker.format, definition.ordered_fieldnames),
            tuple(definition.fieldnames),
            frozenset(texts),
            definition.instance_field or "",
        )
    return Dialect(messages, {message.name: number for number, message in messages.items()})


def layout_of(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> layout_of("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    kinds: list[tuple[str, str] | tuple[str, str, int]] = []
    items = re.findall(r"(\d*)([a-zA-Z])", layout)
    for field, (count, letter) in zip(fields, items, strict=True):
        if letter == "s":
            kinds.append((field, f"S{count or 1}"))
        elif count:
            kinds.append((field, f"<{letter}", int(count)))
        else:
            kinds.append((field, f"<{letter}"))
    return np.dtype(kinds)
