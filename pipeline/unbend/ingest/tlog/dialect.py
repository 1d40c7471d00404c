"""Messages of MAVLink by the dialect: names, checksums, layouts, and which are wanted."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from unbend.ingest.field_maps import MessageMap, message_maps
from unbend.ingest.tlog.sender_clocks import CLOCK_FIELDS

# A key with a dot is a second channel out of the same message.
MESSAGES: Mapping[str, MessageMap] = message_maps("tlog")


# Messages with a text that belongs to each row.
LABELS: Mapping[str, str] = {"CAMERA_IMAGE_CAPTURED": "file_url", "STATUSTEXT": "text"}


SYSTEM_TIME, PARAM_VALUE = "SYSTEM_TIME", "PARAM_VALUE"


@dataclass(frozen=True)
class Message:
    """One message: ``dtype`` as on the wire, ``fields`` as defined, those of ``texts`` are char."""

    number: int
    name: str
    crc_extra: int
    dtype: np.dtype[Any]
    fields: tuple[str, ...]
    texts: frozenset[str]
    instance_field: str


@cache
def dialect() -> Mapping[int, Message]:
    """The library's union of all dialects, by number."""
    from pymavlink.dialects.v20 import all as library

    messages = {}
    for number, definition in library.mavlink_map.items():
        kinds = zip(definition.fieldnames, definition.fieldtypes, strict=True)
        name, names = str(definition.msgname), tuple(definition.fieldnames)
        layout = layout_of(definition.unpacker.format, definition.ordered_fieldnames)
        texts = frozenset(field for field, kind in kinds if kind == "char")
        own = MESSAGES[name].id_field if name in MESSAGES else ""
        instance = own or definition.instance_field or ""
        messages[int(number)] = Message(
            int(number), name, int(definition.crc_extra), layout, names, texts, instance
        )
    return messages


def crc_extras() -> dict[int, int]:
    """CRC_EXTRA by message id."""
    return {number: message.crc_extra for number, message in dialect().items()}


@cache
def message_of_name() -> Mapping[str, Message]:
    """The same by name."""
    return {message.name: message for message in dialect().values()}


def name_of(number: int) -> str:
    """The name of a message, made up where the dialect does not know it."""
    known = dialect().get(number)
    return f"UNKNOWN_{number}" if known is None else known.name


def wanted_layouts() -> dict[int, np.dtype[Any]]:
    """The layouts, by number, of the fields that channels and clocks are made of."""
    wanted = {
        SYSTEM_TIME: {"time_unix_usec"},
        PARAM_VALUE: {"param_id", "param_value"},
        "CAMERA_IMAGE_CAPTURED": {"capture_result", "time_utc"},
        "STATUSTEXT": {"id", "chunk_seq"},
    }
    for key, spec in MESSAGES.items():
        fields = {name.partition(".")[0] for column in spec.columns for name in column.fields}
        wanted.setdefault(key.partition(".")[0], set()).update(fields, {LABELS.get(key, "")})
    result = {}
    for message in (m for m in dialect().values() if m.name in wanted):
        kept = wanted[message.name] | {message.instance_field, *CLOCK_FIELDS}
        names = message.dtype.names or ()
        result[message.number] = message.dtype[[name for name in names if name in kept]]
    return result


def layout_of(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> layout_of("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    items = re.findall(r"(\d*)([a-zA-Z])", layout)
    kinds = [f"S{count or 1}" if kind == "s" else f"{count}<{kind}" for count, kind in items]
    return np.dtype(list(zip(fields, kinds, strict=True)))
