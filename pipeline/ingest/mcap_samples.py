"""Messages of a topic as they are read: times and columns in SI, block by block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Source, TimeArray
from pipeline.flight.clock import LAST_US, UNIX_NS_FROM, UNIX_US_FROM
from pipeline.ingest.build import Rows
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.mcap_fields import CAPTURE_UTC_FIELD, LABELS, UTC_FIELD, finished
from pipeline.ingest.mcap_time import BootClock, stamps
from pipeline.ingest.store import Store
from pipeline.ledger import Ledger

Columns = Mapping[str, NDArray[Any]]
STAMP = "stamp_ns"  # the column in which a decoder of objects puts the time it found


@dataclass
class Samples:
    """What was read of one topic.

    ``stamp_ns`` are the messages' own times, 0 without; ``log_ns`` the recorder's with the row of
    the first, only where they are needed; ``utc_us`` UTC beside time since boot.
    """

    name: str
    schema: str
    spec: MessageMap
    since_boot: bool = False
    stamp_ns: Store = field(default_factory=lambda: Store("i8"))
    log_ns: list[tuple[int, TimeArray]] = field(default_factory=list)
    utc_us: Store = field(default_factory=lambda: Store("i8"))
    columns: dict[str, Store] = field(default_factory=dict)
    labels: dict[str, list[str]] = field(default_factory=dict)

    def add(self, columns: Columns, log_ns: TimeArray) -> None:
        """The next messages, as decoded."""
        before, count = len(self.stamp_ns), log_ns.shape[0]
        stamp_ns, since_boot = own_times(columns, self.spec.time_field, count)
        self.since_boot |= since_boot
        self.stamp_ns.add(stamp_ns)
        if self.since_boot or not bool(stamp_ns.all()):
            self.log_ns.append((before, log_ns))
        utc = columns.get(UTC_FIELD if self.spec.position else CAPTURE_UTC_FIELD)
        if utc is not None and utc.dtype.kind in "iu":
            self.utc_us.add(np.minimum(utc, LAST_US).astype(np.int64))
        numbers = {name: part for name, part in columns.items() if part.dtype.kind in "biuf"}
        self._keep(finished(self.schema, extract(numbers, self.spec.columns)), before, count)
        if self.spec.event:
            for name, paths in LABELS.items():
                path = next((path for path in paths.split() if path in columns), None)
                texts = [""] * count if path is None else columns[path].tolist()
                if path is not None or name in self.labels:
                    self.labels.setdefault(name, [""] * before).extend(texts)

    def _keep(self, values: Columns, before: int, count: int) -> None:
        """A column takes memory when it has its first value; where it lacks one, it is NaN."""
        needed = self.spec.position or self.spec.attitude
        for name, column in values.items():
            if name not in self.columns and (needed or bool(np.isfinite(column).any())):
                self.columns[name] = Store("f8")
                self.columns[name].add(np.broadcast_to(np.nan, before))
        for name, store in self.columns.items():
            store.add(values.get(name, np.broadcast_to(np.nan, count)))

    def clock_readings(self) -> tuple[TimeArray, TimeArray] | None:
        """UTC and time since boot [ns] of GNSS messages that have both."""
        if not (self.spec.position and self.since_boot and len(self.utc_us)):
            return None
        utc_us, boot_ns = (
            np.concatenate([*store.blocks()]) for store in (self.utc_us, self.stamp_ns)
        )
        return utc_us * 1000, boot_ns

    def rows(self, clock: BootClock, ledger: Ledger) -> tuple[Rows, int]:
        """All of it, which is handed over, and how many messages had no time of their own.

        In the order of the file, never of log_time: a recorder whose clock was set back would
        shuffle two parts of the flight into each other.
        """
        stamp_ns = self.stamp_ns.whole()
        log_ns = np.zeros(stamp_ns.shape, np.int64)
        for first, part in self.log_ns:
            log_ns[first : first + part.shape[0]] = part
        self.log_ns.clear()
        time_ns, boot, count = times_of(
            stamp_ns, log_ns, clock, ledger, self.name, since_boot=self.since_boot
        )
        if self.since_boot and not self.spec.position and len(self.utc_us):
            utc_us = self.utc_us.whole()
            time_ns = np.where(utc_us > UNIX_US_FROM, utc_us * 1000, time_ns)
        columns = {name: store.whole() for name, store in self.columns.items()}
        labels = {name: tuple(texts) for name, texts in self.labels.items()}
        return Rows(self.name, Source(self.schema), time_ns, boot, columns, labels), count


def own_times(columns: Columns, time_field: str, count: int) -> tuple[TimeArray, bool]:
    """The times [ns] that messages say, 0 without, and whether they count from a boot."""
    if STAMP in columns or not columns:
        return columns.get(STAMP, np.zeros(count, np.int64)), False
    return stamps(columns, time_field)


def times_of(
    stamp_ns: TimeArray, log_ns: TimeArray, clock: BootClock, ledger: Ledger, where: str,
    *, since_boot: bool,
) -> tuple[TimeArray, NDArray[np.int16], int]:  # fmt: skip
    """UTC [ns], boot, and how many messages have no time of their own: it is the recorder's."""
    if since_boot:
        return *clock.utc(stamp_ns, log_ns, where), 0
    none = stamp_ns == 0
    count = int(np.count_nonzero(none))
    if count:
        ledger.fallback(
            "TIME-LOG-TIME",
            f"{count} messages have no header.stamp: the recorder's time is used",
            where=where,
            count=count,
        )
        stamp_ns[none] = log_ns[none]
    if bool(np.any(stamp_ns < UNIX_NS_FROM)):
        ledger.fallback(
            "TIME-NO-UTC",
            "time stamps before 2001 are no UTC (simulated time?): events in this log can be "
            "used, matching by UTC is impossible",
            where=where,
        )
    return stamp_ns, np.zeros(stamp_ns.shape, np.int16), count
