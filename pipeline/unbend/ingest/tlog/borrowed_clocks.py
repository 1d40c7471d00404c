"""Senders without a clock of their own: whether the clock of another component fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.timelines import microseconds
from unbend.ingest.tlog import messages
from unbend.ingest.tlog.clock_samples import MICROSECOND, READING, Readings
from unbend.ingest.tlog.sender_clocks import (
    CLOCK_FIELDS,
    MAX_DELAY_NS,
    MIN_DELAY_NS,
    Clocks,
    SenderClock,
    clock_field,
    fit_sender,
)
from unbend.ingest.tlog.senders import Sender, by_sender
from unbend.ingest.utc_evidence import FIRST_SET_US
from unbend.messages import Ledger
from unbend.units import Integers

IMAGE_UTC_FIELD = "time_utc"  # the field of images with the UTC of the camera


@dataclass(frozen=True)
class _SentTimes:
    """(n,) times that messages of a sender carry; times since boot wrap after ``wrap_ns``."""

    readings: Readings
    wrap_ns: int

    def late_by_utc(self, clock: SenderClock) -> TimeArray:
        """How long after the UTC that they carry messages were received [ns], by ``clock``.

        (m,) of the messages with UTC.
        """
        has_utc = self.readings["utc_ns"] > 0
        received_ns = self._received_ns(clock)
        return np.asarray((received_ns - self.readings["utc_ns"])[has_utc], np.int64)

    def late_by_boot(self, clock: SenderClock) -> TimeArray:
        """How long after their time since boot messages were received [ns], both by ``clock``.

        (m,) of the messages without UTC.
        """
        rows = (self.readings["utc_ns"] <= 0) & (self.readings["boot_ns"] > 0)
        of_boot = self.readings[rows]
        stamped_ns = clock.utc_of_boot(
            of_boot["place"],
            of_boot["host_us"] * MICROSECOND,
            of_boot["boot_ns"],
            self.wrap_ns,
        )
        received_ns = self._received_ns(clock)[rows]
        return np.asarray(received_ns - stamped_ns, np.int64)

    def _received_ns(self, clock: SenderClock) -> TimeArray:
        """(n,) UTC [ns] at which the messages were received, by ``clock``."""
        return clock.utc_of_host(self.readings["place"], self.readings["host_us"] * MICROSECOND)


def with_borrowed_clocks(clocks: Clocks, sent: Sequence[ColumnStore], ledger: Ledger) -> Clocks:
    """The clocks, with a new clock for each sender that cannot use that of another component.

    Its times show that: they do not fit the time at which its messages were received. The UTC that
    images carry is checked in the same way, and not used where it does not fit.
    """
    times_of: dict[Sender, list[_SentTimes]] = {}
    for store in sent:
        names = store.dtype["records"].names or ()
        field = clock_field(names)
        if not field:
            continue
        for block in store.blocks():
            for sender, rows in by_sender(block):
                # of a sender with a clock, only the UTC of images is checked
                if sender not in clocks.senders or IMAGE_UTC_FIELD in names:
                    times_of.setdefault(sender, []).append(_sent_times(block[rows], field))
    for sender, times in sorted(times_of.items()):
        clocks = _with_checked_clock(clocks, sender, times, ledger)
    return clocks


def _sent_times(rows: NDArray[Any], field: str) -> _SentTimes:
    """The times that messages carry; ``field``: the name of that with the time since boot.

    Some senders write Unix time into that field; such a time becomes 0, which means no time.
    """
    unit_ns, wrap_ns = CLOCK_FIELDS[field]
    raw = microseconds(rows["records"][field])
    readings = np.empty(rows.shape, READING)
    for name in ("place", "source", "host_us"):
        readings[name] = rows[name]
    readings["boot_ns"] = np.where(raw < FIRST_SET_US, raw * unit_ns, 0)
    readings["utc_ns"] = unix_us(rows["records"]) * MICROSECOND
    return _SentTimes(readings, wrap_ns)


def unix_us(records: NDArray[Any]) -> Integers:
    """The UTC that images carry [us]; 0 where they have none."""
    if IMAGE_UTC_FIELD not in (records.dtype.names or ()):
        return np.zeros(records.shape, np.int64)
    raw = microseconds(records[IMAGE_UTC_FIELD])
    return np.asarray(np.where(raw > FIRST_SET_US, raw, 0), np.int64)


def _with_checked_clock(
    clocks: Clocks, sender: Sender, times: Sequence[_SentTimes], ledger: Ledger
) -> Clocks:
    """Check the times of one sender by when its messages were received; returns the new clocks.

    First the UTC that its images carry, which is removed from ``times`` if it does not fit. Then,
    if the sender has no clock, its time since boot by the clock of another component: where that
    does not fit, the sender gets its own clock.
    """
    clock = clocks.clock_of(sender)
    late_by_utc_ns = np.concatenate([part.late_by_utc(clock) for part in times])
    if late_by_utc_ns.size and not _is_plausible(late_by_utc_ns):
        wrong_utc = messages.camera_utc_wrong(
            sender=str(sender),
            count=late_by_utc_ns.size,
            late_s=_median_s(late_by_utc_ns),
        )
        ledger.add(wrong_utc)
        clocks = replace(clocks, wrong_utc=clocks.wrong_utc | {sender})
        for part in times:  # their time since boot is checked instead
            part.readings["utc_ns"] = 0
    if sender in clocks.senders:
        return clocks
    return _with_lent_or_own_clock(clocks, sender, times, ledger)


def _with_lent_or_own_clock(
    clocks: Clocks, sender: Sender, times: Sequence[_SentTimes], ledger: Ledger
) -> Clocks:
    """The clocks, with a new clock for this sender if that of another component does not fit.

    They stay as they are if the sender has no time since boot to check, if no component of its
    system has a clock, and if the clock of the other component fits.
    """
    clock = clocks.clock_of(sender)
    late_ns = np.concatenate([part.late_by_boot(clock) for part in times])
    if not late_ns.size:
        return clocks
    lender = clocks.lender(sender)
    if lender is None:
        ledger.add(messages.no_clock_of_system(sender=str(sender), count=late_ns.size))
        return clocks
    is_borrowed = _is_plausible(late_ns)
    report = messages.clock_borrowed if is_borrowed else messages.clock_not_borrowed
    clock_report = report(
        sender=str(sender),
        count=late_ns.size,
        lender=lender.component,
        late_s=_median_s(late_ns),
    )
    ledger.add(clock_report)
    if is_borrowed:
        return clocks
    readings = np.concatenate([part.readings for part in times])
    timed_readings = readings[readings["boot_ns"] > 0]
    in_file_order = timed_readings[np.argsort(timed_readings["place"], kind="stable")]
    clock_of_sender = fit_sender(in_file_order, clock, sender, ledger)
    return replace(clocks, senders={**clocks.senders, sender: clock_of_sender})


def _is_plausible(late_ns: TimeArray) -> bool:
    """Whether the median delay of messages is possible on a link."""
    return bool(MIN_DELAY_NS <= np.median(late_ns) <= MAX_DELAY_NS)


def _median_s(late_ns: TimeArray) -> float:
    return float(np.median(late_ns)) / 1e9
