"""Tables of an ArduPilot log, binary or text -> its contents: a time for each row, channels."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import LAST_US, SECONDS_PER_WEEK
from unbend.ingest import boot_clock
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash.dataflash_channels import (
    ACCURACY,
    RECEIVERS,
    channels_of,
    clock_of,
    instance_of,
)
from unbend.ingest.dataflash.record_tables import INSTANCE_FIELDS, without_objects
from unbend.ingest.field_maps import is_number
from unbend.ingest.flight_log import Contents
from unbend.ingest.message_tables import PLACE, Table
from unbend.messages import Ledger
from unbend.units import Integers

# Fields that are used as they are logged, without a field map that checks that they are numbers.
_NUMBERS = {*INSTANCE_FIELDS, "TimeUS", "GMS", "GWk", "Week", "Status", "Value"} | {
    field for column in ACCURACY for field in column.fields
}


_TIMELESS = {"CAM", "MSG", "EV", "ERR", "PARM"}  # rows without a time until 2015


def contents_of(
    damage: DamagedBytes,
    counts: Mapping[str, int],
    line: boot_clock.Timeline,
    tables: dict[str, Table],
    ledger: Ledger,
    *,
    reread: Callable[[set[str]], dict[str, Table]],
) -> Contents:
    """The contents of a log, binary or text.

    ``damage``, ``counts``: bytes of no message, messages by type. ``tables``: the wanted fields,
    used up. ``reread``: reads all fields of some types, when they are asked for.
    """
    timed = timed_tables(tables, ledger)
    clock, time_base = clock_of(line, timed, ledger)

    def table(name: str, instance: str | None) -> Table:
        decoded = reread({name})
        return stamped(name, decoded[name], clock, instance) if name in decoded else {}

    lost = 0  # neither records nor lines carry a sequence number
    named, parameters = timed.get("PARM", {}), {}
    if {"Name", "Value"} <= named.keys():  # the last value of each
        parameters = dict(zip(named["Name"].tolist(), named["Value"].tolist(), strict=True))
    found = channels_of(timed, parameters, clock, ledger)
    return Contents(
        counts, found, damage.bad_bytes, lost, clock.line.boots, time_base, table,
        parameters,
    )  # fmt: skip


def timed_tables(tables: dict[str, Table], ledger: Ledger) -> dict[str, Table]:
    """The tables with a time since boot, without rows that lack it or columns of a wrong kind."""
    result, timeless = {}, {}
    old = not any("TimeUS" in table for table in tables.values())
    for name in list(tables):
        table = without_objects(tables.pop(name), name, ledger)
        count = table[PLACE].size
        odd = [
            field
            for field, column in table.items()
            if (field in _NUMBERS and not is_number(column))
            or (field == "Name" and column.ndim != 1)
        ]
        if odd:
            what = f"{', '.join(odd)} of {count} rows hold no numbers, by their definition"
            ledger.loss("LOG-FIELDS", what, where=name, count=count)
            table = {field: column for field, column in table.items() if field not in odd}
        table = with_time(name, table)
        time = table.get("TimeUS")
        if time is not None and is_number(time):
            rows = np.isfinite(time) if time.dtype.kind == "f" else slice(None)
            result[name] = {field: column[rows] for field, column in table.items()}
        elif old and name in _TIMELESS:
            timeless[name] = table
        else:
            what = f"{count} rows have no time: the log defines no field TimeUS"
            ledger.loss("LOG-FIELDS", what, where=name, count=count)
    if not timeless or not result:
        return result
    places = np.concatenate([table[PLACE] for table in result.values()])
    order = np.argsort(places, kind="stable")
    times = np.concatenate([boot_clock.microseconds(table["TimeUS"]) for table in result.values()])
    for name, table in timeless.items():
        row = np.searchsorted(places[order], table[PLACE]) - 1
        result[name] = table | {"TimeUS": times[order][np.maximum(row, 0)]}
        if name == "CAM":
            result[name] = exposures_by_last_fix(result[name], result.get("GPS", {}), ledger)
    return result


def with_time(name: str, columns: Table) -> Table:
    """A table with TimeUS; until 2015 that was TimeMS, in rows of receivers T."""
    time_ms = columns.get("T" if name in RECEIVERS else "TimeMS")
    if "TimeUS" in columns or time_ms is None or not is_number(time_ms):
        return columns
    time_us = np.minimum(boot_clock.microseconds(time_ms), LAST_US // 1000) * 1000
    columns = columns | {"TimeUS": time_us}
    if name in RECEIVERS:
        renamed = {"GMS": "TimeMS", "GWk": "Week"}
        columns |= {new: columns[old] for new, old in renamed.items() if old in columns}
    return columns


def exposures_by_last_fix(exposures: Table, receiver: Table, ledger: Ledger) -> Table:
    """Exposures with only the GPS time of the last fix: half an interval behind it."""
    time_us = exposures["TimeUS"].copy()
    fix_us, fix_ms = (np.empty(0, np.int64),) * 2
    if {"GMS", "GWk", "Status"} <= receiver.keys():
        fixes = receiver["Status"] >= boot_clock.LOWEST_FIX
        own_ms = _gps_ms(receiver["GWk"][fixes], receiver["GMS"][fixes])
        fix_ms, first = np.unique(own_ms, return_index=True)
        fix_us = boot_clock.microseconds(receiver["TimeUS"][fixes])[first]
    interval_s = float(np.median(np.diff(fix_ms))) / 1000.0 if fix_ms.size > 1 else np.nan
    known = np.zeros(time_us.shape, np.bool_)
    if {"GPSTime", "GPSWeek"} <= exposures.keys() and np.isfinite(interval_s):
        own_ms = _gps_ms(exposures["GPSWeek"], exposures["GPSTime"])
        row = np.minimum(np.searchsorted(fix_ms, own_ms), fix_ms.size - 1)
        known = fix_ms[row] == own_ms
        time_us[known] = fix_us[row[known]] + round(interval_s * 5e5)
    sigma_s = interval_s / np.sqrt(12.0)
    ledger.fallback(
        "EVENTS-FIX-TIME", where="CAM", count=time_us.size, known=int(known.sum()),
        half_s=interval_s / 2.0, sigma_s=sigma_s, unknown=int((~known).sum()),
    )  # fmt: skip
    return exposures | {"TimeUS": time_us, "sigma_time_s": np.full(time_us.shape, sigma_s)}


def _gps_ms(week: NDArray[Any], time_ms: NDArray[Any]) -> Integers:
    week_ms = np.asarray(week, np.int64) * (SECONDS_PER_WEEK * 1000)
    return np.asarray(week_ms + np.asarray(time_ms, np.int64), np.int64)


def stamped(name: str, table: Table, clock: boot_clock.BootClock, instance: str | None) -> Table:
    """A table with UTC and boot before its own columns; only an instance, where one is given."""
    timed, places = with_time(name, table), table.pop(PLACE)
    if "TimeUS" in timed and is_number(timed["TimeUS"]):
        time_ns = clock.utc(places, boot_clock.nanoseconds(timed["TimeUS"]))
        added: Table = {"time_ns": time_ns, "boot": clock.line.boot_of(places)}
        table = added | table
    if instance is None:
        return table
    rows = instance_of(table).astype(np.str_) == instance
    return {field: column[rows] for field, column in table.items()} if rows.any() else {}
