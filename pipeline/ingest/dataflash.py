"""ArduPilot DataFlash logs (.bin): records -> channels in UTC."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Array, Channel, Source, TimeArray
from pipeline.flight.clock import (
    Offset,
    boots_of,
    fit_offset,
    fresh,
    report_fit,
    stray_times,
    utc_of_gps,
)
from pipeline.ingest.base import Contents, report_damage
from pipeline.ingest.build import LOWEST_FIX, Rows, channel_of
from pipeline.ingest.dataflash_fields import (
    ACCURACY,
    ACCURACY_MESSAGE,
    INSTANCE_FIELDS,
    MESSAGES,
)
from pipeline.ingest.dataflash_records import (
    FMT_START,
    HEADER,
    Definition,
    Walk,
    byte_rows,
    gather,
    walk,
)
from pipeline.ingest.fields import extract
from pipeline.ledger import Ledger

Table = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class DataFlash:
    """The registry's line of this format."""

    name: str = "dataflash"
    title: str = "ArduPilot DataFlash"
    extensions: tuple[str, ...] = (".bin",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(FMT_START)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        data = path.read_bytes()
        found = walk(data)
        _report_damage(found, path, ledger)
        clock = _Clock.of(data, found, ledger)
        channels = _channels(data, found, clock, ledger)
        return Contents(
            _counts(found),
            channels,
            found.bad_bytes,
            0,  # records carry no sequence number
            len(clock.offsets),
            clock.words,
        )


DATAFLASH = DataFlash()


def _report_damage(found: Walk, path: Path, ledger: Ledger) -> None:
    report_damage(ledger, path.name, "record", found.bad_bytes, found.first_bad, found.cut_bytes)
    for refused in found.refused:
        ledger.loss(
            "LOG-BAD-FORMAT", f"an FMT record makes no sense: {refused}", where=path.name, count=1
        )


def _counts(found: Walk) -> dict[str, int]:
    numbers, counts = np.unique(found.numbers, return_counts=True)
    result: Counter[str] = Counter()
    for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
        result["FMT" if number < 0 else found.definitions[number].name] += count
    return dict(result)


def _timed(definition: Definition) -> bool:
    """Whether the records begin with their time, as all do since 2014."""
    fields = definition.dtype.fields
    return (
        fields is not None
        and "TimeUS" in fields
        and fields["TimeUS"][:2] == (np.dtype("<u8"), HEADER)
    )


def _microseconds(raw: NDArray[np.uint64]) -> TimeArray:
    """Time fields as int64; beyond 2^52 us (142 years) is damage, cut off so that ns fit too."""
    return np.minimum(raw, np.uint64(1 << 52)).view(np.int64)


def _fields(records: NDArray[Any], definition: Definition) -> Table:
    with np.errstate(invalid="ignore"):  # signalling NaNs occur in damaged records
        return {
            field: _microseconds(records[field])
            if field == "TimeUS"
            else records[field].astype(np.float64) / divisor
            for field, divisor in definition.divisors.items()
            if records.dtype[field].kind in "iuf"
        }


def _decode(data: bytes, found: Walk, name: str) -> tuple[Table, NDArray[np.int64]]:
    """All records of a name, whatever their definitions: fields, and places in the walk.

    Fields are float64 and divided as their format letter says; TimeUS stays int64.
    """
    tables, places = [], []
    for number, definition in enumerate(found.definitions):
        if definition.name != name or not _timed(definition):
            continue
        records, rows = gather(data, found, number)
        tables.append(_fields(records, definition))
        places.append(rows)
    if not tables:
        return {}, np.empty(0, np.int64)
    if len(tables) == 1:
        return tables[0], places[0]
    order = np.argsort(np.concatenate(places), kind="stable")
    missing = [np.full(rows.shape, np.nan) for rows in places]
    fields = {field for table in tables for field in table}
    merged = {
        field: np.concatenate(
            [table.get(field, gap) for table, gap in zip(tables, missing, strict=True)]
        )[order]
        for field in fields
    }
    return merged, np.concatenate(places)[order]


@dataclass(frozen=True)
class _Clock:
    """Time since boot -> UTC. ``boot`` and ``good`` speak of every record of the walk."""

    boot: NDArray[np.int16]
    good: NDArray[np.bool_]
    offsets: tuple[int, ...]
    words: str

    @classmethod
    def of(cls, data: bytes, found: Walk, ledger: Ledger) -> _Clock:
        boot, good = _boots(data, found, ledger)
        count = int(boot.max()) + 1 if boot.shape[0] else 1
        fits = [_fit_boot(data, found, boot, good, number) for number in range(count)]
        known = [fit for fit in fits if fit is not None]
        for number, fit in enumerate(fits):
            where = f"boot {number}"
            if fit is not None:
                report_fit(ledger, f"{fit.rows} GPS rows", fit.spread_ns, where, fit.rows)
            else:
                ledger.fallback(
                    "TIME-NO-UTC",
                    "no GPS row with a fix and a week: time counts from boot, as if in 1970; "
                    "events in this log can be used, matching by UTC is impossible",
                    where=where,
                )
        if len(known) == count:
            rows = sum(fit.rows for fit in known)
            words = f"vehicle clock, set to UTC by the median of {rows} GPS rows"
        else:
            words = f"vehicle clock; UTC is unknown in {count - len(known)} of {count} boots"
        return cls(boot, good, tuple(fit.offset_ns if fit else 0 for fit in fits), words)

    def utc(self, boot_us: TimeArray, places: NDArray[np.int64]) -> TimeArray:
        offsets = np.array(self.offsets, np.int64)
        return np.asarray(boot_us * 1000 + offsets[self.boot[places]], np.int64)


def _boots(data: bytes, found: Walk, ledger: Ledger) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """The boot of every record, and whether its time can be believed."""
    # definition -1: FMT records before FMT was defined
    timed = np.array([*(_timed(form) for form in found.definitions), False], np.bool_)
    rows = np.flatnonzero(timed[found.numbers])
    good = np.ones(found.offsets.shape, np.bool_)
    boot = np.zeros(found.offsets.shape, np.int16)
    if rows.shape[0] == 0:
        return boot, good
    # in place: a log has millions of records, and here lies the peak of memory
    time_ns = _microseconds(byte_rows(data, found.offsets[rows] + HEADER, 8).view("<u8")[:, 0])
    time_ns *= 1000
    stray = stray_times(time_ns)
    good[rows] = ~stray
    if stray.any():
        ledger.loss(
            "TIME-STRAY",
            f"{int(stray.sum())} records carry a time that fits none of their neighbours",
            where=f"first at byte {int(found.offsets[rows[stray][0]])}",
            count=int(stray.sum()),
        )
    boot_of = boots_of(time_ns[~stray])
    steady = np.zeros(found.offsets.shape, np.bool_)
    steady[rows[~stray]] = True
    nearest = np.cumsum(steady, dtype=np.int32) - 1
    return boot_of[np.maximum(nearest, 0, out=nearest)], good


def _fit_boot(
    data: bytes,
    found: Walk,
    boot: NDArray[np.int16],
    good: NDArray[np.bool_],
    number: int,
) -> Offset | None:
    for name in ("GPS", "GPS2"):
        table, places = _decode(data, found, name)
        if not {"GMS", "GWk", "Status"} <= set(table):
            continue
        usable = (table["GWk"] > 0) & (table["Status"] >= LOWEST_FIX)
        usable &= (boot[places] == number) & good[places]
        instance = _instance(table)
        for which in np.unique(instance[usable]):
            rows = usable & (instance == which)
            utc_ns = utc_of_gps(table["GWk"][rows], table["GMS"][rows] / 1000.0)
            moved = fresh(utc_ns)
            return fit_offset(utc_ns[moved], table["TimeUS"][rows][moved] * 1000)
    return None


def _instance(table: Table) -> Array:
    """The instance of each row, -1 where the message has none."""
    for field in INSTANCE_FIELDS:
        if field in table:
            return np.asarray(table[field], np.float64)
    return np.full(table["TimeUS"].shape, -1.0)


def _channels(data: bytes, found: Walk, clock: _Clock, ledger: Ledger) -> tuple[Channel, ...]:
    channels = []
    for message, spec in MESSAGES.items():
        table, places = _decode(data, found, message)
        if not table:
            continue
        if message == "GPS":
            accuracy, _ = _decode(data, found, ACCURACY_MESSAGE)
            table = _joined(table, accuracy)
        for rows in _instances(message, table, places, clock):
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    if _heights_are_ellipsoidal(data, found):
        ledger.note(
            "HEIGHT-ELLIPSOID",
            f"the parameter {HEIGHT_OPTION} says that GNSS heights are above the ellipsoid: so are "
            "all heights of this log",
        )
        channels = [_with_ellipsoidal_heights(channel) for channel in channels]
    return tuple(channels)


# AP_GPS.h, DriverOptions::HeightEllipsoid: the receiver's height goes through the filter as it is.
HEIGHT_OPTION = "GPS_DRV_OPTIONS"
_HEIGHT_ELLIPSOID = 1 << 4


def _heights_are_ellipsoidal(data: bytes, found: Walk) -> bool:
    """Whether the autopilot was told to give heights above the ellipsoid."""
    for number, definition in enumerate(found.definitions):
        names = definition.dtype.names or ()
        if definition.name != "PARM" or not {"Name", "Value"} <= set(names):
            continue
        records, _ = gather(data, found, number)
        values = records["Value"][records["Name"] == HEIGHT_OPTION.encode()]
        # Parameters are floats; a damaged one may hold anything.
        if values.size and 0.0 <= values[-1] < 2**15 and int(values[-1]) & _HEIGHT_ELLIPSOID:
            return True
    return False


def _with_ellipsoidal_heights(channel: Channel) -> Channel:
    if "h_msl_m" not in channel.columns:
        return channel
    columns = dict(channel.columns)
    return replace(channel, columns={"h_ellipsoid_m": columns.pop("h_msl_m")} | columns)


def _instances(
    message: str, table: Table, places: NDArray[np.int64], clock: _Clock
) -> Iterator[Rows]:
    spec = MESSAGES[message]
    columns = spec.columns + (ACCURACY if message == "GPS" else ())
    values = extract(table, columns)
    time_ns = clock.utc(table["TimeUS"], places)
    instance = _instance(table)
    for which in np.unique(instance):
        label = None if which < 0 else f"{which:.0f}"
        name = message if label is None else f"{message}[{label}]"
        rows = (instance == which) & clock.good[places]
        source = Source(message, label)
        yield Rows(name, source, time_ns, clock.boot[places], values).take(rows)


def _joined(table: Table, other: Table) -> Table:
    """A table with the fields of another one, row by row of equal instance and time."""
    fields = [field for spec in ACCURACY for field in spec.fields if field in other]
    if not fields or other["TimeUS"].shape[0] == 0:
        return table
    key, other_key = _key(table), _key(other)
    order = np.argsort(other_key, kind="stable")
    at = np.minimum(np.searchsorted(other_key[order], key), order.shape[0] - 1)
    match = order[at]
    same = other_key[match] == key
    return dict(table) | {field: np.where(same, other[field][match], np.nan) for field in fields}


def _key(table: Table) -> NDArray[np.int64]:
    # 2^56 us are 2000 years: the instance fits above the time.
    instance = (_instance(table).astype(np.int64) + 1) << 56
    return np.asarray(table["TimeUS"] + instance, np.int64)
