"""Time since boot in a DataFlash log: power-ups, stamps that cannot be, and UTC by the receiver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import (
    BOOT_STEP_NS,
    LAST_US,
    SECONDS_PER_WEEK,
    Offset,
    fit_offset,
    fresh,
    full_weeks,
    report_fit,
    stray_stretches,
    utc_of_gps,
)
from pipeline.ingest.base import Table
from pipeline.ingest.build import LOWEST_FIX
from pipeline.ingest.dataflash_columns import Decoded
from pipeline.ingest.dataflash_fields import instance_of
from pipeline.ingest.dataflash_formats import HEADER
from pipeline.ingest.dataflash_records import Walker
from pipeline.ingest.window import Window
from pipeline.ledger import Ledger

RECEIVERS = ("GPS", "GPS2")
FIRST_WEEK = 1_773  # 2013-12-29: no log with the field TimeUS is older
_WEEKS = 1 << 13  # until 2137: the fit is by the median, which more than half of the rows decide

Stamps = tuple[NDArray[np.int64], TimeArray]
"""Places of records in the file, rising, and their times since boot [us]."""


def microseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields as int64 [us]; what no log can last is cut off at 142 years."""
    if raw.dtype.kind == "f":
        return np.asarray(np.nan_to_num(raw, nan=LAST_US).clip(0, LAST_US), np.int64)
    cut: NDArray[np.uint64] = np.minimum(raw, np.uint64(LAST_US), dtype=np.uint64)
    return cut.view(np.int64)


def stamps(data: Window, walker: Walker) -> Iterator[Stamps]:
    """The times of all records that begin with one, as they are walked through."""
    for part in walker.parts():
        timed = np.array([form.timed for form in walker.definitions], np.bool_)
        at = part.at[timed[part.numbers]].astype(np.int64)
        if at.size:
            raw = data.array(part.base, part.end())
            anywhere = np.ndarray((raw.shape[0] - 7,), "<u8", raw, strides=(1,))
            yield at + part.base, microseconds(anywhere[at + HEADER])


@dataclass(frozen=True)
class Timeline:
    """Stretches of a log in which time runs on: where each begins, its boot, and is it stray."""

    first: NDArray[np.int64]
    stray: NDArray[np.bool_]
    boot: NDArray[np.int16]

    @property
    def boots(self) -> int:
        return int(self.boot.max()) + 1 if self.boot.size else 1

    def boot_of(self, places: NDArray[np.int64]) -> NDArray[np.int16]:
        """The power-up to which records belong, from 0."""
        if self.boots == 1:
            return np.zeros(places.shape, np.int16)
        return np.asarray(self.boot[self._stretch(places)], np.int16)

    def good(self, places: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether the stamps of records can be believed."""
        if not self.stray.any():
            return np.ones(places.shape, np.bool_)
        return np.asarray(~self.stray[self._stretch(places)], np.bool_)

    def _stretch(self, places: NDArray[np.int64]) -> NDArray[np.intp]:
        return np.maximum(np.searchsorted(self.first, places, side="right") - 1, 0)


def timeline(blocks: Iterable[Stamps], ledger: Ledger) -> Timeline:
    """Power-ups and stray stamps, from all stamps of a log in the order of the file."""
    first: list[int] = []
    begin: list[int] = []
    end: list[int] = []
    length: list[int] = []
    for places, time_us in blocks:
        time_ns = time_us * 1000
        cuts = np.flatnonzero(np.abs(np.diff(time_ns)) > BOOT_STEP_NS) + 1
        starts = np.append(0, cuts)
        stops = np.append(cuts, time_ns.shape[0])
        lengths = (stops - starts).tolist()
        lasts = time_ns[stops - 1].tolist()
        if end and abs(int(time_ns[0]) - end[-1]) <= BOOT_STEP_NS:  # goes on from the block before
            end[-1] = lasts.pop(0)
            length[-1] += lengths.pop(0)
            starts = starts[1:]
        first += places[starts].tolist()
        begin += time_ns[starts].tolist()
        end += lasts
        length += lengths
    return _judged(np.array([first, begin, end, length], np.int64), ledger)


def _judged(stretches: NDArray[np.int64], ledger: Ledger) -> Timeline:
    first, begin, end, length = stretches
    stray = stray_stretches(begin, end, length)
    steady = ~stray
    back = begin[steady][1:] - end[steady][:-1] < -BOOT_STEP_NS
    boot_of_steady = np.append(0, np.cumsum(back)).astype(np.int16)
    boot = boot_of_steady[np.maximum(np.cumsum(steady) - 1, 0)] if first.size else np.empty(0, "i2")
    if stray.any():
        count = int(length[stray].sum())
        ledger.loss(
            "TIME-STRAY",
            f"{count} records carry a time that fits none of their neighbours",
            where=f"first at byte {int(first[stray][0])}",
            count=count,
        )
    silence = begin[steady][1:] - end[steady][:-1]
    gaps = np.flatnonzero(silence > BOOT_STEP_NS)
    if gaps.size:
        ledger.warning(
            "LOG-GAP",
            f"nothing at all was logged {gaps.size} times for more than 1 s, "
            f"{silence[gaps].sum() / 1e9:.1f} s together: the logger stopped, or bytes are missing",
            where=f"first before byte {int(first[steady][gaps[0] + 1])}",
            count=int(gaps.size),
        )
    return Timeline(first, stray, boot)


@dataclass(frozen=True)
class Clock:
    """Time since boot -> UTC: an offset [ns] for each boot, 0 where UTC is unknown."""

    line: Timeline
    offsets: tuple[int, ...]
    words: str

    def utc(self, table: Table, places: NDArray[np.int64]) -> TimeArray:
        """The UTC of rows with the field TimeUS."""
        time_ns = microseconds(table["TimeUS"])  # a new array: memory has its peak here
        time_ns *= 1000
        time_ns += np.array(self.offsets, np.int64)[self.line.boot_of(places)]
        return time_ns


def clock_of(line: Timeline, tables: Mapping[str, Decoded], ledger: Ledger) -> Clock:
    """The clock of a log from the rows of its GNSS receivers, one offset for each boot."""
    fits = [_fit_boot(line, tables, number, ledger) for number in range(line.boots)]
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
    if len(known) == len(fits):
        rows = sum(fit.rows for fit in known)
        words = f"vehicle clock, set to UTC by the median of {rows} GPS rows"
    else:
        words = f"vehicle clock; UTC is unknown in {len(fits) - len(known)} of {len(fits)} boots"
    return Clock(line, tuple(fit.offset_ns if fit else 0 for fit in fits), words)


def _fit_boot(
    line: Timeline, tables: Mapping[str, Decoded], number: int, ledger: Ledger
) -> Offset | None:
    for name in RECEIVERS:
        if name not in tables or not {"GMS", "GWk", "Status"} <= set(tables[name].columns):
            continue
        table, places = tables[name].columns, tables[name].places
        usable = (table["GWk"] > 0) & (table["GWk"] < _WEEKS) & (table["Status"] >= LOWEST_FIX)
        usable &= (table["GMS"] >= 0) & (table["GMS"] < SECONDS_PER_WEEK * 1000)
        usable &= (line.boot_of(places) == number) & line.good(places)
        instance = instance_of(table)
        for which in np.unique(instance[usable]):
            rows = usable & (instance == which)
            week, repaired = full_weeks(table["GWk"][rows], FIRST_WEEK)
            if repaired:
                ledger.warning(
                    "TIME-WEEK-ROLLOVER",
                    f"{repaired} GPS rows say week {int(table['GWk'][rows][0])}, before logs of "
                    f"this kind existed: the receiver counts modulo 1024, taken as {int(week[0])}",
                    where=f"{name}, boot {number}",
                    count=repaired,
                )
            utc_ns = utc_of_gps(week, table["GMS"][rows] / 1000.0)
            moved = fresh(utc_ns)
            return fit_offset(utc_ns[moved], microseconds(table["TimeUS"][rows][moved]) * 1000)
    return None
