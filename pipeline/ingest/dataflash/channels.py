"""Tables of an ArduPilot log, binary or text -> channels in UTC."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Set
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import ROLE_COLUMNS, Channel, Source
from pipeline.flight.clock import STRAY_ROWS
from pipeline.ingest.ardupilot_heights import (
    HEIGHT_OPTION,
    selects_ellipsoid,
    with_ellipsoidal_heights,
    with_undulation,
)
from pipeline.ingest.boot_clock import microseconds
from pipeline.ingest.buffers import copy_rows
from pipeline.ingest.channel_builder import DecodedRows, channel_of
from pipeline.ingest.dataflash.columns import Decoded
from pipeline.ingest.dataflash.fields import (
    ACCURACY,
    ACCURACY_MESSAGE,
    INSTANCE_FIELDS,
    MESSAGES,
    instance_of,
)
from pipeline.ingest.dataflash.time import RECEIVERS, Clock
from pipeline.ingest.fields import FieldColumn, MessageMap, extract, is_number
from pipeline.ingest.log import Table
from pipeline.ledger import Ledger

_OF_TIME = ("GMS", "GWk", "Status")
# No sensor writes this few rows beside so many of another one: a bit of the instance was flipped.
STRAY_SHARE = 100


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
        for rows in _instances(message, spec, tables, clock, ledger):
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    if "PARM" in tables and heights_are_ellipsoidal(tables["PARM"].columns):
        return tuple(with_ellipsoidal_heights(channels, ledger, "PARM"))
    return tuple(with_undulation(channel) for channel in channels)


def _instances(
    message: str, spec: MessageMap, tables: dict[str, Decoded], clock: Clock, ledger: Ledger
) -> Iterator[DecodedRows]:
    """The rows of each instance of a message, whose table is used up: memory has its peak here."""
    if message not in tables:
        return
    decoded = tables.pop(message)
    table, columns = decoded.columns, spec.columns
    time_ns = copy_rows(clock.utc(table, decoded.places))
    boot = copy_rows(clock.line.boot_of(decoded.places))
    good = clock.line.good(decoded.places)
    if message == "GPS" and ACCURACY_MESSAGE in tables:
        table = _joined(decoded, tables.pop(ACCURACY_MESSAGE))
        columns += ACCURACY
    named = table.get(spec.id_field)
    instance = instance_of(table) if named is None else named
    values = extract(table, columns, copy_rows)
    odd = _report_odd(message, table, columns, ledger)
    _report_absent(message, spec, odd | set(values), instance.shape[0], ledger)
    del decoded, table
    numbers, counts = np.unique(instance, return_counts=True)
    if named is None and not spec.event:
        numbers = numbers[~_stray_instances(message, numbers, counts, ledger)]
    for which in numbers.tolist():
        label = str(which) if named is not None or which >= 0 else None
        name = message if label is None else f"{message}[{label}]"
        rows = DecodedRows(name, Source(message, label), time_ns, boot, values)
        chosen = (instance == which) & good
        yield rows if chosen.all() else rows.take(chosen)


def _report_absent(
    message: str, spec: MessageMap, known: Set[str], count: int, ledger: Ledger
) -> None:
    """Enter the roles for which the log defines no field: a name of one may be damaged."""
    needed = {column for role in spec.roles for column in ROLE_COLUMNS[role]} - {"event_index"}
    if spec.attitude or spec.position:  # without these it is no channel, and `channel_of` says so
        needed -= {"q_w", "q_x", "q_y", "q_z", "lat_rad", "lon_rad"}
    needed |= {"h_msl_m"} if spec.position else set()
    if absent := needed - known:
        what = f"{count} rows have no {', '.join(sorted(absent))}: the log defines no field for it"
        ledger.loss("LOG-FIELDS", what, where=message, count=count)


def _report_odd(
    message: str, table: Table, columns: tuple[FieldColumn, ...], ledger: Ledger
) -> set[str]:
    """Enter fields that hold no numbers where numbers are wanted: their definition is damaged.

    Returns the columns that they would be.
    """
    odd = {
        field: column.name
        for column in columns
        for field in column.fields
        if field in table and not is_number(table[field])
    }
    if odd:
        count = table[next(iter(odd))].shape[0]
        what = f"{', '.join(sorted(odd))} of {count} rows hold no numbers, by their definition"
        ledger.loss("LOG-FIELDS", what, where=message, count=count)
    return set(odd.values())


def _stray_instances(
    message: str, which: NDArray[Any], counts: NDArray[np.intp], ledger: Ledger
) -> NDArray[np.bool_]:
    """Instances that are none: a few rows, beside a hundred times as many of another."""
    stray = (counts <= STRAY_ROWS) & (counts * STRAY_SHARE <= counts.max())
    if stray.any():
        count = int(counts[stray].sum())
        names = ", ".join(str(number) for number in which[stray].tolist()[:8])
        ledger.loss(
            "LOG-INSTANCE",
            f"{count} rows are of instances ({names}) that no other row has, beside "
            f"{counts.max()} of instance {which[np.argmax(counts)]}: damage, they are not used",
            where=message,
            count=count,
        )
    return np.asarray(stray, np.bool_)


def heights_are_ellipsoidal(parameters: Table) -> bool:
    """Whether the autopilot was told to give heights above the ellipsoid."""
    if not {"Name", "Value"} <= set(parameters):
        return False
    values = parameters["Value"][parameters["Name"] == HEIGHT_OPTION]
    return bool(values.size) and selects_ellipsoid(float(values[-1]))


def _joined(decoded: Decoded, accuracy: Decoded) -> Table:
    """A table with the fields of another one, row by row of equal instance and time.

    Times repeat where the vehicle was restarted: then places in the file tell what belongs
    together. An autopilot writes the accuracy behind the fix.
    """
    table, other = decoded.columns, accuracy.columns
    fields = [field for spec in ACCURACY for field in spec.fields if field in other]
    if not fields or "TimeUS" not in other or not accuracy.places.size:
        return table
    key, other_key = _key(table), _key(other)
    if np.array_equal(key, other_key):  # one for one, as in all logs without damage
        return table | {field: other[field] for field in fields}
    row, match = _nearest(key, decoded.places, other_key, accuracy.places)
    added = {field: np.full(decoded.places.shape, np.nan) for field in fields}
    for field, column in added.items():
        column[row] = other[field][match]
    return table | added


def _key(table: Table) -> NDArray[np.int64]:
    # 2^52 us are 142 years: the instance fits above the time.
    instance = (instance_of(table).astype(np.int64) + 1 & 0x3FF) << 52
    return np.asarray(microseconds(table["TimeUS"]) + instance, np.int64)


def _nearest(
    key: NDArray[np.int64],
    places: NDArray[np.int64],
    other_key: NDArray[np.int64],
    other_places: NDArray[np.int64],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of rows of equal key, none in two: the next one behind a row, else the one before."""
    n = key.shape[0]
    order = np.lexsort((np.concatenate([places, other_places]), np.concatenate([key, other_key])))
    is_other = order >= n
    at = np.flatnonzero(~is_other)
    count = np.cumsum(is_other)
    others = order[is_other] - n
    rows, pairs, apart = [], [], []
    for shift in (0, -1):
        found = count[at] + shift
        inside = (found >= 0) & (found < others.shape[0])
        row, match = order[at[inside]], others[found[inside]]
        same = key[row] == other_key[match]
        rows.append(row[same])
        pairs.append(match[same])
        apart.append(np.abs(places[row[same]] - other_places[match[same]]) - (shift << 40))
    row, match = np.concatenate(rows), np.concatenate(pairs)
    order = np.argsort(np.concatenate(apart), kind="stable")
    for column in (row, match):
        order = order[np.sort(np.unique(column[order], return_index=True)[1])]
    return row[order], match[order]
