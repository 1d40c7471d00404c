"""Senders without a clock of their own: whether that of another component fits."""

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
    EARLIEST_NS,
    LATEST_NS,
    Clocks,
    SenderClock,
    clock_field,
    fit_sender,
)
from unbend.ingest.tlog.senders import Sender, by_sender
from unbend.ingest.utc_evidence import FIRST_SET_US
from unbend.messages import Ledger
from unbend.units import Integers

OWN_UTC = "time_utc"  # the field of images with the UTC of the camera


@dataclass(frozen=True)
class _SentTimes:
    """The times that some messages of a sender carry; those since boot wrap after ``turn_ns``."""

    readings: Readings
    turn_ns: int

    def late_by_utc(self, clock: SenderClock) -> TimeArray:
        """How long after their own UTC the messages with one were received [ns]."""
        has_utc = self.readings["utc_ns"] > 0
        received_ns = self._received_ns(clock)
        return np.asarray((received_ns - self.readings["utc_ns"])[has_utc], np.int64)

    def late_by_boot(self, clock: SenderClock) -> TimeArray:
        """How long after their time since boot, by ``clock``, messages were received [ns].

        Only of messages without UTC.
        """
        rows = (self.readings["utc_ns"] <= 0) & (self.readings["boot_ns"] > 0)
        of_boot = self.readings[rows]
        stamped_ns = clock.utc_of_boot(
            of_boot["place"],
            of_boot["host_us"] * MICROSECOND,
            of_boot["boot_ns"],
            self.turn_ns,
        )
        received_ns = self._received_ns(clock)[rows]
        return np.asarray(received_ns - stamped_ns, np.int64)

    def _received_ns(self, clock: SenderClock) -> TimeArray:
        """UTC at which the messages were received."""
        return clock.utc_of_host(self.readings["place"], self.readings["host_us"] * MICROSECOND)


def with_borrowed_clocks(clocks: Clocks, sent: Sequence[ColumnStore], ledger: Ledger) -> Clocks:
    """The clocks, with one for each sender whose times do not fit the clock it would borrow.

    The UTC that images carry is not used where it does not fit the time of their reception.
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
                if sender not in clocks.senders or OWN_UTC in names:
                    times_of.setdefault(sender, []).append(_sent_times(block[rows], field))
    for sender, times in sorted(times_of.items()):
        clocks = _with_checked_clock(clocks, sender, times, ledger)
    return clocks


def _sent_times(rows: NDArray[Any], field: str) -> _SentTimes:
    """The times of messages; ``field`` is that of the time since boot.

    Some senders write Unix time into that field; such a time counts as 0, which is none.
    """
    unit_ns, turn_ns = CLOCK_FIELDS[field]
    raw = microseconds(rows["records"][field])
    readings = np.empty(rows.shape, READING)
    for name in ("place", "source", "host_us"):
        readings[name] = rows[name]
    readings["boot_ns"] = np.where(raw < FIRST_SET_US, raw * unit_ns, 0)
    readings["utc_ns"] = unix_us(rows["records"]) * MICROSECOND
    return _SentTimes(readings, turn_ns)


def unix_us(records: NDArray[Any]) -> Integers:
    """The UTC that images carry [us]; 0 where they have none."""
    if OWN_UTC not in (records.dtype.names or ()):
        return np.zeros(records.shape, np.int64)
    raw = microseconds(records[OWN_UTC])
    return np.asarray(np.where(raw > FIRST_SET_US, raw, 0), np.int64)


def _with_checked_clock(
    clocks: Clocks, sender: Sender, times: Sequence[_SentTimes], ledger: Ledger
) -> Clocks:
    """The clocks after the times of one sender are checked by when its messages were received.

    First the UTC that its images carry; then, if the sender has no clock, its time since boot
    against the clock of another component. Where that does not fit, the sender gets its own clock.
    """
    clock = clocks.of(sender)
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
    """The clocks, with one for a sender without a clock if that of another component does not fit.

    The clocks as they are where no time since boot is to be checked, where no component of the
    system has a clock, and where the clock of the other component fits.
    """
    clock = clocks.of(sender)
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
    """Whether the median delay of messages is one that links have."""
    return bool(EARLIEST_NS <= np.median(late_ns) <= LATEST_NS)


def _median_s(late_ns: TimeArray) -> float:
    return float(np.median(late_ns)) / 1e9
