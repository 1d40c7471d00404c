"""Time since boot in a DataFlash log: power-ups, stamps that cannot be, and UTC by the receiver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import SECONDS_PER_WEEK, full_weeks, utc_of_gps
from pipeline.ingest.boot_clock import (
    LOWEST_FIX,
    BootClock,
    Stamps,
    Timeline,
    UtcReadings,
    fit_boot_clock,
    microseconds,
    report_timeline,
)
from pipeline.ingest.buffers import FileView, gather
from pipeline.ingest.dataflash.columns import Decoded
from pipeline.ingest.dataflash.fields import instance_of
from pipeline.ingest.dataflash.formats import HEADER
from pipeline.ingest.dataflash.records import Walker
from pipeline.ingest.log import Table
from pipeline.ledger import Ledger

RECEIVERS = ("GPS", "GPS2")
FIRST_WEEK = 1_773  # 2013-12-29: no log with the field TimeUS is older
_WEEKS = 1 << 13  # until 2137: the fit is by the median, which more than half of the rows decide


def stamps(data: FileView, walker: Walker) -> Iterator[Stamps]:
    """The times of all records that begin with one, as they are walked through."""
    for part in walker.parts():
        timed = np.array([form.timed for form in walker.definitions], np.bool_)
        at = part.at[timed[part.numbers]].astype(np.int64)
        if at.size:
            raw = data.array(part.base, part.end())
            time_us = microseconds(gather(raw, at + HEADER, 8).view("<u8"))
            yield at + part.base, time_us * 1000


@dataclass(frozen=True)
class Clock:
    """Time since boot -> UTC, of tables; ``words`` say where it comes from."""

    boots: BootClock
    words: str

    @property
    def line(self) -> Timeline:
        return self.boots.line

    def utc(self, table: Table, places: NDArray[np.int64]) -> TimeArray:
        """The UTC of rows with the field TimeUS."""
        time_ns = microseconds(table["TimeUS"])  # a new array: memory has its peak here
        time_ns *= 1000
        time_ns += self.boots.offsets[self.line.boot_of(places)]
        return time_ns


def clock_of(line: Timeline, tables: Mapping[str, Decoded], ledger: Ledger) -> Clock:
    """The clock of a log from the rows of its GNSS receivers, one offset for each boot."""
    report_timeline(line, ledger)
    told = [one for name in RECEIVERS for one in _told(line, tables.get(name), name, ledger)]
    boots = fit_boot_clock(line, told, ledger)
    for number, known in enumerate(boots.utc_known):
        if not known:
            ledger.fallback(
                "TIME-NO-UTC",
                "no GPS row with a fix and a week: time counts from boot, as if in 1970; "
                "events in this log can be used, matching by UTC is impossible",
                where=f"boot {number}",
            )
    rows = sum(fit.rows for fit in boots.fits if fit is not None)
    words = f"vehicle clock, set to UTC by the median of {rows} GPS rows"
    if unknown := boots.utc_known.count(False):
        words = f"vehicle clock; UTC is unknown in {unknown} of {len(boots.utc_known)} boots"
    return Clock(boots, words)


def _told(
    line: Timeline, decoded: Decoded | None, name: str, ledger: Ledger
) -> Iterator[UtcReadings]:
    """What each receiver of a message says of UTC."""
    if decoded is None:
        return
    if absent := sorted({"GMS", "GWk", "Status"} - set(decoded.columns)):
        what = f"{decoded.places.size} rows give no UTC: the log defines no field"
        ledger.loss(
            "LOG-FIELDS", f"{what} {', '.join(absent)}", where=name, count=decoded.places.size
        )
        return
    table = decoded.columns
    usable = (table["GWk"] > 0) & (table["GWk"] < _WEEKS)
    usable &= (table["GMS"] >= 0) & (table["GMS"] < SECONDS_PER_WEEK * 1000)
    instance = instance_of(table)
    for which in np.unique(instance[usable]):
        mine = usable & (instance == which)
        rows = slice(None) if bool(mine.all()) else mine  # a long log is not copied
        label = f"{name}[{which}]" if which >= 0 else name
        places, fix = decoded.places[rows], table["Status"][rows]
        boot_ns = microseconds(table["TimeUS"][rows])
        boot_ns *= 1000
        week = _weeks(table["GWk"][rows], fix, line.boot_of(places), label, ledger)
        utc_ns = utc_of_gps(week, table["GMS"][rows] / 1000.0)
        good = np.ones(places.shape, np.bool_)
        yield UtcReadings(f"rows of {label}", places, boot_ns, utc_ns, good, fix)


def _weeks(
    week: NDArray[Any], fix: NDArray[Any], boot: NDArray[np.int16], label: str, ledger: Ledger
) -> NDArray[Any]:
    """Full weeks of a receiver, which counts modulo 1024 in all rows of a boot or in none."""
    for number in np.unique(boot):
        rows = (boot == number) & (fix >= LOWEST_FIX)
        full, repaired = full_weeks(week[rows], FIRST_WEEK)
        if repaired:
            ledger.warning(
                "TIME-WEEK-ROLLOVER",
                f"{repaired} GPS rows say week {int(week[rows][0])}, before logs of this kind "
                f"existed: the receiver counts modulo 1024, taken as {int(full[0])}",
                where=f"{label}, boot {number}",
                count=repaired,
            )
            week = week.astype(np.int64)
            week[rows] = full
    return week
