"""Tables of an ArduPilot log, binary or text -> channels, in UTC by the GNSS receivers."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import ROLE_COLUMNS, Channel, Source
from unbend.flight.clock import SECONDS_PER_WEEK, STRAY_ROWS, full_weeks, utc_of_gps
from unbend.ingest.boot_clock import (
    LOWEST_FIX,
    BootClock,
    Stamps,
    Timeline,
    UtcReadings,
    fit_clock,
    microseconds,
    nanoseconds,
    report_timeline,
)
from unbend.ingest.buffers import FileView, copy_rows, gather
from unbend.ingest.channel_builder import DecodedRows, channel_of, with_both_heights
from unbend.ingest.dataflash.dataflash_records import RecordWalker
from unbend.ingest.dataflash.record_definitions import HEADER
from unbend.ingest.dataflash.record_tables import INSTANCE_FIELDS
from unbend.ingest.field_maps import MAPS, MessageMap, extract, is_number, message_maps
from unbend.ingest.message_tables import PLACE, Table
from unbend.messages import Ledger
from unbend.units import Integers

RECEIVERS = ("GPS", "GPS2")


FIRST_WEEK = 1_721  # 2012-12-30: no log that defines its own records is older


_WEEKS = 1 << 13  # until 2137: the fit is by the median, which more than half of the rows decide


_OF_TIME = ("GMS", "GWk", "Status", "Week", "T")


STRAY_SHARE = 100  # rows of an instance for each row of one that is damage


MESSAGES: Mapping[str, MessageMap] = message_maps("dataflash")


def texts_of(message: str, field: str, table: Table) -> tuple[str, ...] | None:
    """What the autopilot says in each row of MSG, EV or ERR; None where no text is defined.

    >>> texts_of("ERR", "Subsys", {"Subsys": np.array([16], "u1"), "ECode": np.array([2], "u1")})
    ('ERR EKFCHECK 2',)
    """
    words = table.get(field)
    if words is None or words.dtype.kind != ("U" if message == "MSG" else "u"):
        return None
    if message == "MSG":
        return tuple(words.tolist())
    names = MAPS["dataflash_numbers"][message]
    codes = table["ECode"].tolist() if "ECode" in table else [""] * words.shape[0]
    said = [names.get(str(number), number) for number in words.tolist()]
    return tuple(f"{message} {word} {code}".strip() for word, code in zip(said, codes, strict=True))


# Accuracy and the ellipsoidal height come in a message of their own, at the time of the GPS row.
ACCURACY_MESSAGES = {"GPS": "GPA", "GPS2": "GPA2"}


ACCURACY = message_maps("dataflash_accuracy")["GPA"].columns


def instance_of(table: Table) -> NDArray[Any]:
    """The instance of each row, -1 without; integers only: I of PID messages is none."""
    for field in INSTANCE_FIELDS:
        if field in table and table[field].dtype.kind in "iu":
            return table[field]
    rows = len(next(iter(table.values()))) if table else 0
    return np.full(rows, -1, np.int8)


def stamps(data: FileView, walker: RecordWalker) -> Iterator[Stamps]:
    """The times of all records that begin with one, during the walk."""
    for block in walker.blocks():
        fields = [form.time_field for form in walker.definitions]
        timed = np.array([bool(field) for field in fields])
        old = np.array([field == "TimeMS" for field in fields])
        rows = timed[block.numbers]
        at = block.at[rows].astype(np.int64)
        if at.size:
            raw = data.array(block.base, block.end())
            time_us = microseconds(gather(raw, at + HEADER, 8).view("<u8"))
            if old.any():
                in_ms = old[block.numbers[rows]]
                time_us[in_ms] = gather(raw, at[in_ms] + HEADER, 4).view("<u4") * np.int64(1000)
            yield at + block.base, time_us * 1000


def clock_of(line: Timeline, tables: Mapping[str, Table], ledger: Ledger) -> tuple[BootClock, str]:
    """The clock of a log from the rows of its GNSS receivers, and where its UTC comes from."""
    report_timeline(line, ledger)
    sources: list[UtcReadings] = []
    for name in RECEIVERS:
        if name in tables:
            sources += _receiver_utc(line, tables[name], name, ledger)
    clock = fit_clock(line, sources, ledger, utc_of="GPS row with a fix and a week")
    if unknown := clock.utc_known.count(False):
        return clock, f"vehicle clock; UTC is unknown in {unknown} of {len(clock.fits)} boots"
    rows = sum(fit.rows for fit in clock.fits if fit is not None)
    return clock, f"vehicle clock, set to UTC by the median of {rows} GPS rows"


def _receiver_utc(line: Timeline, table: Table, name: str, ledger: Ledger) -> Iterator[UtcReadings]:
    """The UTC of each receiver of a message."""
    count = table[PLACE].size
    if absent := sorted({"GMS", "GWk", "Status"} - set(table)):
        what = f"{count} rows give no UTC: the log defines no field {', '.join(absent)}"
        ledger.loss("LOG-FIELDS", what, where=name, count=count)
        return
    usable = (table["GWk"] > 0) & (table["GWk"] < _WEEKS)
    usable &= (table["GMS"] >= 0) & (table["GMS"] < SECONDS_PER_WEEK * 1000)
    instance = instance_of(table)
    for which in np.unique(instance[usable]):
        of_instance = usable & (instance == which)
        rows = slice(None) if bool(of_instance.all()) else of_instance  # a long log is not copied
        label = f"{name}[{which}]" if which >= 0 else name
        places, fix, week = table[PLACE][rows], table["Status"][rows], table["GWk"][rows]
        boot_ns = nanoseconds(table["TimeUS"][rows])
        boot = line.boot_of(places)
        for number in np.unique(boot):  # a receiver rolls over in all rows of a boot or in none
            fixes = (boot == number) & (fix >= LOWEST_FIX)
            full, repaired = full_weeks(week[fixes], FIRST_WEEK)
            if repaired:
                where, before, after = f"{label}, boot {number}", week[fixes][0], full[0]
                ledger.warning(
                    "TIME-WEEK-ROLLOVER", where=where, count=repaired, week=before, full=after
                )
                week = week.astype(np.int64)
                week[fixes] = full
        utc_ns = utc_of_gps(week, table["GMS"][rows] / 1000.0)
        good = np.ones(places.shape, np.bool_)
        yield UtcReadings(f"rows of {label}", places, boot_ns, utc_ns, good, fix)


def wanted_fields() -> dict[str, Callable[[str], bool]]:
    """The messages that become channels or are needed for it, and which of their fields."""
    always = {"TimeUS", "TimeMS", *INSTANCE_FIELDS}
    fields = {
        name: always
        | {field for column in spec.columns for field in column.fields}
        | {spec.id_field, spec.text_field}
        | set(_OF_TIME if name in RECEIVERS else ())
        for name, spec in MESSAGES.items()
    }
    of_accuracy = always | {field for column in ACCURACY for field in column.fields}
    fields |= dict.fromkeys(ACCURACY_MESSAGES.values(), of_accuracy)
    fields["ERR"] |= {"ECode"}
    fields["PARM"] = {"TimeUS", "Name", "Value"}
    return {name: names.__contains__ for name, names in fields.items()}


def channels_of(
    tables: dict[str, Table], parameters: Mapping[str, float], clock: BootClock, ledger: Ledger
) -> tuple[Channel, ...]:
    """The channels of the messages that the field map knows; their tables are used up."""
    channels = []
    for message, spec in MESSAGES.items():
        for rows in _instances(message, spec, tables, clock, ledger):
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    return tuple(with_both_heights(channels, parameters, ledger, "PARM"))


def _instances(
    message: str, spec: MessageMap, tables: dict[str, Table], clock: BootClock, ledger: Ledger
) -> Iterator[DecodedRows]:
    """The rows of each instance of a message, whose table is used up: memory has its peak here."""
    if message not in tables:
        return
    table = tables.pop(message)
    time_ns = copy_rows(clock.utc(table[PLACE], nanoseconds(table["TimeUS"])))
    boot = copy_rows(clock.line.boot_of(table[PLACE]))
    good = clock.line.good(table[PLACE])
    accuracy = tables.pop(ACCURACY_MESSAGES.get(message, ""), None)
    if accuracy is not None:
        table = _join_accuracy(table, accuracy)
        spec = replace(spec, columns=spec.columns + ACCURACY)
    if spec.text_field:
        texts = texts_of(message, spec.text_field, table)
        if texts is None:
            what = f"its rows hold no text: the log defines no field {spec.text_field} for it"
            ledger.loss("LOG-FIELDS", what, where=message)
            return
        rows = DecodedRows(message, Source(message), time_ns, boot, {}, {"text": texts})
        yield rows if good.all() else rows.take(good)
        return
    named = table.get(spec.id_field)
    is_named = named is not None
    instance = instance_of(table) if named is None else named
    _report_fields(message, spec, table, ledger)
    table = dict(table)
    del accuracy, named, table[PLACE]
    values = extract(table, spec.columns, copy_rows, used_up=table)
    del table
    numbers, counts = np.unique(instance, return_counts=True)
    if not is_named and not spec.event:
        # a few rows beside a hundred times as many of another instance: a flipped bit
        stray = (counts <= STRAY_ROWS) & (counts * STRAY_SHARE <= counts.max(initial=0))
        if stray.any():
            count = int(counts[stray].sum())
            names = ", ".join(str(number) for number in numbers[stray].tolist()[:8])
            most, main = counts.max(), numbers[np.argmax(counts)]
            ledger.loss(
                "LOG-INSTANCE", where=message, count=count, names=names, most=most, instance=main
            )
        numbers = numbers[~stray]
    for which in numbers.tolist():
        label = str(which) if is_named or which >= 0 else None
        name = message if label is None else f"{message}[{label}]"
        rows = DecodedRows(name, Source(message, label), time_ns, boot, values)
        chosen = (instance == which) & good
        yield rows if chosen.all() else rows.take(chosen)


def _report_fields(message: str, spec: MessageMap, table: Table, ledger: Ledger) -> None:
    """Enter fields that hold no numbers, and columns of roles that have no field."""
    count = len(next(iter(table.values()))) if table else 0
    odd = {
        field: column.name
        for column in spec.columns
        for field in column.fields
        if field in table and not is_number(table[field])
    }
    if odd:
        what = f"{', '.join(sorted(odd))} of {count} rows hold no numbers, by their definition"
        ledger.loss("LOG-FIELDS", what, where=message, count=count)
    needed = {column for role in spec.roles for column in ROLE_COLUMNS[role]} - {"event_index"}
    if spec.attitude or spec.position:  # `channel_of` reports that these are absent
        needed -= {"q_w", "q_x", "q_y", "q_z", "lat_rad", "lon_rad"}
    needed |= {"h_msl_m"} if spec.position else set()
    known = {
        column.name for column in spec.columns
        if any(field in table and is_number(table[field]) for field in column.fields)
    }  # fmt: skip
    if absent := needed - set(odd.values()) - known:
        what = f"{count} rows have no {', '.join(sorted(absent))}: the log defines no field for it"
        ledger.loss("LOG-FIELDS", what, where=message, count=count)


def _join_accuracy(table: Table, other: Table) -> Table:
    """The table of fixes with the accuracy of equal instance and time, logged behind the fix."""
    fields = [field for spec in ACCURACY for field in spec.fields if field in other]
    if not fields or "TimeUS" not in other or not other[PLACE].size:
        return table
    key, other_key = _key(table), _key(other)
    if np.array_equal(key, other_key):  # one for one, as in all logs without damage
        return table | {field: other[field] for field in fields}
    places, other_places, n = table[PLACE], other[PLACE], key.shape[0]
    order = np.lexsort((np.concatenate([places, other_places]), np.concatenate([key, other_key])))
    is_other = order >= n
    at, count = np.flatnonzero(~is_other), np.cumsum(is_other)
    others = order[is_other] - n
    rows, pairs, apart = [], [], []
    for shift in (0, -1):  # of equal key the next behind a row, or that before
        nearest = count[at] + shift
        inside = (nearest >= 0) & (nearest < others.shape[0])
        row, match = order[at[inside]], others[nearest[inside]]
        same = key[row] == other_key[match]
        rows.append(row[same])
        pairs.append(match[same])
        apart.append(np.abs(places[row[same]] - other_places[match[same]]) - (shift << 40))
    row, match = np.concatenate(rows), np.concatenate(pairs)
    order = np.argsort(np.concatenate(apart), kind="stable")
    for column in (row, match):  # each row in one pair
        order = order[np.sort(np.unique(column[order], return_index=True)[1])]
    added = {field: np.full(places.shape, np.nan) for field in fields}
    for field, values in added.items():
        values[row[order]] = other[field][match[order]]
    return table | added


def _key(table: Table) -> Integers:
    # 2^52 us are 142 years: the instance fits above the time.
    instance = (instance_of(table).astype(np.int64) + 1 & 0x3FF) << 52
    return np.asarray(microseconds(table["TimeUS"]) + instance, np.int64)
