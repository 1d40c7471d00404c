"""Messages of MAVLink by the dialect: names, checksums, layouts, and which are wanted."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from unbend.ingest.field_maps import MessageMap, message_maps
from unbend.ingest.tlog.sender_clocks import CLOCK_FIELDS

# By name of the message; a key with a dot behind that name is a second channel of the same message.
MESSAGES: Mapping[str, MessageMap] = message_maps("tlog")
# Fields with a text that belongs to each row, by message.
LABELS: Mapping[str, str] = {"CAMERA_IMAGE_CAPTURED": "file_url", "STATUSTEXT": "text"}

SYSTEM_TIME = "SYSTEM_TIME"
PARAM_VALUE = "PARAM_VALUE"


@dataclass(frozen=True)
class MessageDefinition:
    """One message of the dialect.

    crc_extra : the byte of the definition that checksums cover too.
    dtype : of its payload, with the fields in the order in which they are sent.
    fields : the names of the fields in the order of the definition.
    texts : the names of the fields that are text.
    instance_field : the name of the field by which sensors of one kind differ, or empty.
    """

    number: int
    name: str
    crc_extra: int
    dtype: np.dtype[Any]
    fields: tuple[str, ...]
    texts: frozenset[str]
    instance_field: str


@cache
def dialect() -> Mapping[int, MessageDefinition]:
    """The definitions of all messages of all dialects of the library, by message id."""
    from pymavlink.dialects.v20 import all as library

    definitions = [_definition(message_class) for message_class in library.mavlink_map.values()]
    return {definition.number: definition for definition in definitions}


def _definition(library_class: Any) -> MessageDefinition:
    """The definition of a message, from the class that the library has for it."""
    name = str(library_class.msgname)
    fields = tuple(library_class.fieldnames)
    texts = set()
    for field, kind in zip(fields, library_class.fieldtypes, strict=True):
        if kind == "char":
            texts.add(field)
    own_instance_field = MESSAGES[name].id_field if name in MESSAGES else ""
    return MessageDefinition(
        number=int(library_class.id),
        name=name,
        crc_extra=int(library_class.crc_extra),
        dtype=layout_of(library_class.unpacker.format, library_class.ordered_fieldnames),
        fields=fields,
        texts=frozenset(texts),
        instance_field=own_instance_field or library_class.instance_field or "",
    )


def crc_extras() -> dict[int, int]:
    """CRC_EXTRA by message id."""
    return {number: message.crc_extra for number, message in dialect().items()}


@cache
def message_of_name() -> Mapping[str, MessageDefinition]:
    """The definitions of all messages by name."""
    return {message.name: message for message in dialect().values()}


def name_of(number: int) -> str:
    """The name of the message with an id; UNKNOWN and the id if the dialect does not have it."""
    message = dialect().get(number)
    return f"UNKNOWN_{number}" if message is None else message.name


def message_of_key(key: str) -> str:
    """The name of the message that a key of `MESSAGES` reads."""
    return key.partition(".")[0]


def wanted_layouts() -> dict[int, np.dtype[Any]]:
    """The numpy types, by message id, of the payloads of wanted messages.

    They have only the fields that are read: those of channels, labels and clocks.
    """
    wanted = {
        SYSTEM_TIME: {"time_unix_usec"},
        PARAM_VALUE: {"param_id", "param_value"},
        "CAMERA_IMAGE_CAPTURED": {"capture_result", "time_utc"},
        "STATUSTEXT": {"id", "chunk_seq"},
    }
    for key, spec in MESSAGES.items():
        fields = {name.partition(".")[0] for name in spec.fields}  # of "q.0" the array q
        if key in LABELS:
            fields.add(LABELS[key])
        wanted.setdefault(message_of_key(key), set()).update(fields)
    result = {}
    for message in dialect().values():
        if message.name not in wanted:
            continue
        read_fields = {*wanted[message.name], message.instance_field, *CLOCK_FIELDS}
        names = [name for name in message.dtype.names or () if name in read_fields]
        result[message.number] = message.dtype[names]
    return result


def layout_of(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> layout_of("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    kinds = []
    for count, letter in re.findall(r"(\d*)([a-zA-Z])", layout):
        if letter == "s":
            kinds.append(f"S{count or 1}")
        else:
            kinds.append(f"{count}<{letter}")
    return np.dtype(list(zip(fields, kinds, strict=True)))
