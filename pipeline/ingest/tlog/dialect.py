"""What is needed of pymavlink's dialect: names, checksums, layouts and instance fields by id."""

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
        """Where the wanted fields of these messages are, by number, as far as it knows them."""
        return {
            self.numbers[name]: _only(self.messages[self.numbers[name]].dtype, set(fields))
            for name, fields in wanted.items()
            if name in self.numbers
        }


def _only(dtype: np.dtype[Any], fields: set[str]) -> np.dtype[Any]:
    """A layout without the other fields; what is left stays where it is."""
    names = [name for name in dtype.names or () if name in fields]
    where: Mapping[str, Any] = dtype.fields or {}
    return np.dtype(
        {
            "names": names,
            "formats": [where[name][0] for name in names],
            "offsets": [where[name][1] for name in names],
            "itemsize": dtype.itemsize,
        }
    )


@cache
def dialect() -> Dialect:
    """The library's union of all dialects."""
    from pymavlink.dialects.v20 import all as library

    messages = {}
    for number, found in library.mavlink_map.items():
        texts = (
            field
            for field, kind in zip(found.fieldnames, found.fieldtypes, strict=True)
            if kind == "char"
        )
        messages[int(number)] = Message(
            int(number),
            str(found.msgname),
            int(found.crc_extra),
            layout_of(found.unpacker.format, found.ordered_fieldnames),
            tuple(found.fieldnames),
            frozenset(texts),
            found.instance_field or "",
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
