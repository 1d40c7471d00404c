"""Tables of an ArduPilot log, binary or text -> its contents: a time for each row, channels."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import LAST_US, SECONDS_PER_WEEK
from unbend.ingest.boot_clock import BootClock
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash import messages
from unbend.ingest.dataflash.dataflash_channels import (
    ACCURACY_FIELDS,
    DROP_COUNTERS,
    RECEIVERS,
    channels_of,
    clock_of,
    instance_of,
)
from unbend.ingest.dataflash.record_tables import INSTANCE_FIELDS, without_objects
from unbend.ingest.field_maps import is_number
from unbend.ingest.flight_log import Contents
from unbend.ingest.message_tables import PLACE, Table, take_rows
from unbend.ingest.timelines import Timeline, microseconds, nanoseconds
from unbend.ingest.utc_evidence import Witness
from unbend.ingest.utc_readings import LOWEST_FIX
from unbend.messages import Ledger
from unbend.units import Integers, whole_numbers

# Fields that are used as logged: no field map checks that they are numbers.
_NUMBERS = {
    "TimeUS",
    "GMS",
    "GWk",
    "Week",
    "Status",
    "Value",
    *INSTANCE_FIELDS,
    *ACCURACY_FIELDS,
}

_LAST_WEEK = 1 << 13  # GPS weeks, until 2137
_MS_PER_WEEK = SECONDS_PER_WEEK * 1000
_NO_COUNT = 1 << 31  # no logger drops so many messages: such a count is damaged, or was negative
_TIMELESS = {"CAM", "MSG", "EV", "ERR", "PARM"}  # rows without a time until 2015


def contents_of(
    damage: DamagedBytes,
    counts: Mapping[str, int],
    line: Timeline,
    tables: dict[str, Table],
    ledger: Ledger,
    *,
    reread: Callable[[set[str]], dict[str, Table]],
    witnesses: Sequence[Witness] = (),
) -> Contents:
    """The contents of a log, binary or text.

    ``damage``: the bytes of no message. ``counts``: messages by type. ``line``: the power-ups.
    ``tables``: the wanted fields by type; they are removed, so that no table is in memory twice.
    ``reread``: reads all fields of some types when `Log.message` needs them. ``witnesses``: other
    clocks that know the date.
    """
    timed = timed_tables(tables, ledger)
    # Clock, parameters and drops come first: `channels_of` removes the tables.
    clock, time_base = clock_of(line, timed, ledger, witnesses)
    parameters = _last_values(timed.get("PARM", {}))
    dropped = 0
    for name in DROP_COUNTERS:
        dropped += _dropped_messages(name, timed, clock, ledger)

    def table(name: str, instance: str | None) -> Table:
        decoded = reread({name})
        if name not in decoded:
            return {}
        return stamped(name, decoded[name], clock, instance)

    return Contents(
        messages=counts,
        channels=channels_of(timed, parameters, clock, ledger),
        bad_bytes=damage.bad_bytes,
        # as counted by the logger: neither records nor lines have a sequence number
        lost_messages=dropped,
        boots=clock.line.boots,
        time_base=time_base,
        table=table,
        parameters=parameters,
        utc_sigma_s=clock.sigma_s,
        clocks=clock.assessments,
    )


def _dropped_messages(
    name: str,
    tables: Mapping[str, Table],
    clock: BootClock,
    ledger: Ledger,
) -> int:
    """How many messages a logger dropped by its own count, which is reported.

    The count begins at 0 at each power-up, and each time the logger is started again.
    """
    table = tables.get(name, {})
    if "Dp" not in table or not is_number(table["Dp"]):
        return 0
    boot = clock.line.boot_of(table[PLACE])
    is_good = clock.line.good(table[PLACE])
    dropped = 0
    for number in np.unique(boot).tolist():
        of_boot = is_good & (boot == number)
        counts = whole_numbers(table["Dp"][of_boot], -1, _NO_COUNT)
        is_count = (counts >= 0) & (counts < _NO_COUNT)
        dropped += _sum_of_rises(counts[is_count])
    if dropped:
        ledger.add(messages.dropped_by_logger(message=name, count=dropped))
    return dropped


def _sum_of_rises(counts: Integers) -> int:
    """The total of a counter that begins at 0, and restarts from 0 where its value falls."""
    before = np.zeros_like(counts)
    before[1:] = counts[:-1]
    has_restarted = counts < before
    before[has_restarted] = 0
    rises = counts - before
    return int(rises.sum())


def _last_values(rows: Table) -> dict[str, float]:
    """The last logged value of each parameter; empty if ``rows`` lack the name or the value."""
    if "Name" not in rows or "Value" not in rows:
        return {}
    names = rows["Name"].tolist()
    values = rows["Value"].tolist()
    return dict(zip(names, values, strict=True))


def timed_tables(tables: dict[str, Table], ledger: Ledger) -> dict[str, Table]:
    """The tables with a time since boot in each row; all are removed from ``tables``.

    Columns of a wrong kind and tables without times are left out and reported; rows without a time
    are left out. Old logs have no time in rows of `_TIMELESS` messages: these get the time of the
    record before.
    """
    timed: dict[str, Table] = {}
    timeless: dict[str, Table] = {}
    is_old = not any("TimeUS" in table for table in tables.values())
    for name in list(tables):
        table = without_objects(tables.pop(name), name, ledger)
        table = with_time(name, _without_odd_fields(name, table, ledger))
        time = table.get("TimeUS")
        if time is not None and is_number(time):
            timed[name] = _rows_with_time(table)
        elif is_old and name in _TIMELESS:
            timeless[name] = table
        else:
            count = table[PLACE].size
            ledger.add(messages.no_time_field(message=name, count=count))
    if timeless and timed:  # without any timed row there is no time to take over
        _add_timeless(timed, timeless, ledger)
    return timed


def _without_odd_fields(name: str, table: Table, ledger: Ledger) -> Table:
    """The table without fields that should be numbers or names and are not; these are reported."""
    odd_fields = []
    good_columns = {}
    for field, column in table.items():
        lacks_numbers = field in _NUMBERS and not is_number(column)
        lacks_names = field == "Name" and column.ndim != 1
        if lacks_numbers or lacks_names:
            odd_fields.append(field)
        else:
            good_columns[field] = column
    if odd_fields:
        count = table[PLACE].size
        odd = messages.fields_not_numbers(message=name, count=count, fields=odd_fields)
        ledger.add(odd)
    return good_columns


def _rows_with_time(table: Table) -> Table:
    """The rows of a table with a known time; one of the definitions of a message may lack it."""
    time = table["TimeUS"]
    if time.dtype.kind != "f":
        return table
    return take_rows(table, np.isfinite(time))


def _add_timeless(
    timed: dict[str, Table],
    timeless: Mapping[str, Table],
    ledger: Ledger,
) -> None:
    """Add the timeless tables to ``timed``; a row gets the time of the timed record before it.

    Rows before all timed records get the time of the first one. Exposures (CAM) get the time of
    the last fix.
    """
    places = np.concatenate([table[PLACE] for table in timed.values()])
    times_us = np.concatenate([microseconds(table["TimeUS"]) for table in timed.values()])
    order = np.argsort(places, kind="stable")
    places = places[order]
    times_us = times_us[order]
    receiver = timed.get("GPS", {})
    for name, table in timeless.items():
        before = np.searchsorted(places, table[PLACE]) - 1
        time_us = times_us[np.maximum(before, 0)]
        timed[name] = table | {"TimeUS": time_us}
        if name == "CAM":
            timed[name] = exposures_by_last_fix(timed[name], receiver, ledger)


def with_time(name: str, columns: Table) -> Table:
    """The table of a message with its time since boot in TimeUS [us], and GPS time in GMS and GWk.

    Logs until 2015 have no TimeUS. Their time since boot is TimeMS [ms]; but in rows of receivers
    it is T [ms], and TimeMS and Week are the GPS time. A table with neither is returned as it is.
    """
    is_receiver = name in RECEIVERS
    time_ms = columns.get("T" if is_receiver else "TimeMS")
    if "TimeUS" in columns or time_ms is None or not is_number(time_ms):
        return columns
    columns = dict(columns)
    possible_ms = np.minimum(microseconds(time_ms), LAST_US // 1000)
    columns["TimeUS"] = possible_ms * 1000
    if is_receiver and "TimeMS" in columns:
        columns["GMS"] = columns["TimeMS"]
    if is_receiver and "Week" in columns:
        columns["GWk"] = columns["Week"]
    return columns


class _Fixes(NamedTuple):
    """The fixes of a receiver: their GPS times [ms], rising, and times since boot [us]."""

    gps_ms: Integers
    time_us: Integers

    @property
    def interval_s(self) -> float:
        """The median time between two fixes [s]; NaN for fewer than two."""
        if self.gps_ms.size < 2:
            return float("nan")
        return float(np.median(np.diff(self.gps_ms))) / 1000.0


def _fixes_of(receiver: Table) -> _Fixes:
    """The fixes in a table of GPS rows; none if the table lacks the GPS time or the status."""
    if not {"GMS", "GWk", "Status"} <= receiver.keys():
        nothing = np.empty(0, np.int64)
        return _Fixes(nothing, nothing)
    has_fix = receiver["Status"] >= LOWEST_FIX
    rows = take_rows(receiver, has_fix)
    gps_ms = _gps_ms(rows["GWk"], rows["GMS"])
    time_us = microseconds(rows["TimeUS"])
    distinct_ms, first_rows = np.unique(gps_ms, return_index=True)
    return _Fixes(distinct_ms, time_us[first_rows])


def exposures_by_last_fix(exposures: Table, receiver: Table, ledger: Ledger) -> Table:
    """Give exposures a time (TimeUS) and its sigma by the GPS time of the last fix before each.

    Old logs have no other time of an exposure. The time is that of the fix plus half the interval
    between fixes; the sigma is NaN if the interval is unknown. An exposure with a fix that is not
    in the log keeps its TimeUS, the time of the record before it.
    """
    time_us = exposures["TimeUS"].copy()
    fixes = _fixes_of(receiver)
    interval_s = fixes.interval_s
    is_timed = np.zeros(time_us.shape, np.bool_)
    has_gps_time = {"GPSTime", "GPSWeek"} <= exposures.keys()
    if has_gps_time and np.isfinite(interval_s):
        last_fix_ms = _gps_ms(exposures["GPSWeek"], exposures["GPSTime"])
        not_before = np.searchsorted(fixes.gps_ms, last_fix_ms)
        row = np.minimum(not_before, fixes.gps_ms.size - 1)
        is_timed = fixes.gps_ms[row] == last_fix_ms  # True if this fix is in the log
        half_interval_us = round(interval_s / 2.0 * 1e6)
        time_us[is_timed] = fixes.time_us[row[is_timed]] + half_interval_us
    sigma_s = interval_s / np.sqrt(12.0)  # of a uniform distribution over the interval
    ledger.add(
        messages.exposures_timed_by_fix(
            count=time_us.size,
            known=int(np.count_nonzero(is_timed)),
            unknown=int(np.count_nonzero(~is_timed)),
            half_interval_s=interval_s / 2.0,
            sigma_s=float(sigma_s),
        )
    )
    return exposures | {
        "TimeUS": time_us,
        "sigma_time_s": np.full(time_us.shape, sigma_s),
    }


def _gps_ms(week: NDArray[Any], time_ms: NDArray[Any]) -> Integers:
    """(n,) GPS time [ms] since 1980 from (n,) weeks and times within the week [ms].

    Both are limited to possible values.
    """
    week_begin_ms = whole_numbers(week, 0, _LAST_WEEK) * _MS_PER_WEEK
    within_week_ms = whole_numbers(time_ms, -1, _MS_PER_WEEK)
    return np.asarray(week_begin_ms + within_week_ms, np.int64)


def stamped(
    name: str,
    table: Table,
    clock: BootClock,
    instance: str | None,
) -> Table:
    """The table of a message for the user: the columns UTC and boot, then the logged columns.

    ``instance``: only the rows of this instance; the table is empty if there are none. None: all.
    """
    places = table[PLACE]
    time_us = with_time(name, table).get("TimeUS")
    logged = dict(table)
    del logged[PLACE]
    time_columns: Table = {}
    if time_us is not None and is_number(time_us):
        time_columns["time_ns"] = clock.utc(places, nanoseconds(time_us))
        time_columns["boot"] = clock.line.boot_of(places)
    whole = time_columns | logged
    if instance is None:
        return whole

    rows = instance_of(table).astype(np.str_) == instance
    if not rows.any():
        return {}
    return take_rows(whole, rows)
