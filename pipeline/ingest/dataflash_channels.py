"""Tables of an ArduPilot log, binary or text -> channels in UTC."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Channel, Source
from pipeline.ingest.base import Table
from pipeline.ingest.build import Rows, channel_of
from pipeline.ingest.dataflash_columns import Decoded
from pipeline.ingest.dataflash_fields import (
    ACCURACY,
    ACCURACY_MESSAGE,
    INSTANCE_FIELDS,
    MESSAGES,
    instance_of,
)
from pipeline.ingest.dataflash_time import RECEIVERS, Clock, microseconds
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.heights import HEIGHT_OPTION, says_ellipsoid, with_ellipsoidal_heights
from pipeline.ledger import Ledger

_OF_TIME = ("GMS", "GWk", "Status")


def wanted() -> dict[str, Callable[[str], bool]]:
    """The messages that become channels or are needed for it, and which of their fields."""
    always = {"TimeUS", *INSTANCE_FIELDS}
    fields = {
        name: always
        | {field for column in spec.columns for field in column.fields}
        | {spec.id_field}
        | set(_OF_TIME if name in RECEIVERS else ())
        for name, spec in MESSAGES.items()
    }
    fields[ACCURACY_MESSAGE] = always | {field for column in ACCURACY for field in column.fields}
    fields["PARM"] = {"TimeUS", "Name", "Value"}
    return {name: some.__contains__ for name, some in fields.items()}


def channels_of(tables: dict[str, Decoded], clock: Clock, ledger: Ledger) -> tuple[Channel, ...]:
    """The channels of the messages that the field map knows; their tables are used up."""
    channels = []
    for message, spec in MESSAGES.items():
        for rows in _instances(message, spec, tables, clock):
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(_with_undulation(channel))
    if "PARM" in tables and heights_are_ellipsoidal(tables["PARM"].columns):
        channels = with_ellipsoidal_heights(channels, ledger, "PARM")
    return tuple(channels)


def _instances(
    message: str, spec: MessageMap, tables: dict[str, Decoded], clock: Clock
) -> Iterator[Rows]:
    """The rows of each instance of a message, whose table is used up: memory has its peak here."""
    if message not in tables:
        return
    decoded = tables.pop(message)
    table, columns = decoded.columns, spec.columns
    time_ns, boot = clock.utc(table, decoded.places), clock.line.boot_of(decoded.places)
    good = clock.line.good(decoded.places)
    if message == "GPS" and ACCURACY_MESSAGE in tables:
        table = _joined(table, tables.pop(ACCURACY_MESSAGE).columns)
        columns += ACCURACY
    named = table.get(spec.id_field)
    instance = instance_of(table) if named is None else named
    values = extract(table, columns)
    del decoded, table
    for which in np.unique(instance):
        label = str(which) if named is not None else f"{which}" if which >= 0 else None
        name = message if label is None else f"{message}[{label}]"
        rows = Rows(name, Source(message, label), time_ns, boot, values)
        chosen = (instance == which) & good
        yield rows if chosen.all() else rows.take(chosen)


def heights_are_ellipsoidal(parameters: Table) -> bool:
    """Whether the autopilot was told to give heights above the ellipsoid."""
    if not {"Name", "Value"} <= set(parameters):
        return False
    values = parameters["Value"][parameters["Name"] == HEIGHT_OPTION]
    return bool(values.size) and says_ellipsoid(float(values[-1]))


def _with_undulation(channel: Channel) -> Channel:
    """The channel with heights above the ellipsoid, where the receiver gave the undulation."""
    columns = dict(channel.columns)
    undulation = columns.pop("undulation_m", None)
    if undulation is None:
        return channel
    if "h_msl_m" in columns and "h_ellipsoid_m" not in columns:
        columns["h_ellipsoid_m"] = columns["h_msl_m"] + undulation
    return replace(channel, columns=columns)


def _joined(table: Table, other: Table) -> Table:
    """A table with the fields of another one, row by row of equal instance and time."""
    fields = [field for spec in ACCURACY for field in spec.fields if field in other]
    if not fields or "TimeUS" not in other:
        return table
    key, other_key = _key(table), _key(other)
    order = np.argsort(other_key, kind="stable")
    at = np.minimum(np.searchsorted(other_key[order], key), order.shape[0] - 1)
    match = order[at]
    same = other_key[match] == key
    return table | {field: np.where(same, other[field][match], np.nan) for field in fields}


def _key(table: Table) -> NDArray[np.int64]:
    # 2^56 us are 2000 years: the instance fits above the time.
    instance = (instance_of(table).astype(np.int64) + 1) << 56
    return np.asarray(microseconds(table["TimeUS"]) + instance, np.int64)
