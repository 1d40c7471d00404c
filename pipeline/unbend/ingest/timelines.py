"""Power-ups (boots) of a vehicle in a log, by the times since boot of its records, for all formats.

A place in a log is a byte or the number of a message: places rise.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight import clock
from unbend.flight.channels import TimeArray
from unbend.ingest import messages
from unbend.ingest.limits import check_boots
from unbend.messages import Ledger
from unbend.units import Integers, Mask, Rows, whole_numbers

_FEWEST_RECORDS = 10  # in a stretch with sensors; parameters and texts alone make shorter ones

# Places of records in the log, rising, and their times since boot [ns].
Stamps = tuple[Integers, TimeArray]


def place_of_boot(where: str, number: int) -> str:
    """A power-up in words; ``where`` names the vehicle, and is empty in a log of one vehicle.

    >>> place_of_boot("system 1", 0), place_of_boot("", 2)
    ('system 1, boot 0', 'boot 2')
    """
    return f"{where}, boot {number}".removeprefix(", ")


class Silences(NamedTuple):
    """Gaps of more than 1 s in a log.

    after : (n,) index of the stretch of the `Timeline` that follows the silence.
    length_ns : (n,) how long the silence is [ns].
    """

    after: Rows
    length_ns: TimeArray


@dataclass(frozen=True)
class Timeline:
    """The (n,) stretches of a log, in its order: records without a jump of their time by 1 s."""

    first: Integers  # place of the first record
    begin: TimeArray  # time since boot of the first record [ns]
    end: TimeArray  # that of the last record [ns]
    length: Integers  # number of records
    stray: Mask  # whether the stretch is a glitch of the stamps
    boot: NDArray[np.int16]  # number of the power-up, from 0

    @property
    def boots(self) -> int:
        """How many power-ups there are, at least 1."""
        if not self.boot.size:
            return 1
        return int(self.boot.max()) + 1

    def boot_of(self, places: Integers) -> NDArray[np.int16]:
        """The power-ups to which the records at (n,) places belong, from 0."""
        if self.boots == 1:
            return np.zeros(places.shape, np.int16)
        return np.asarray(self.boot[self._stretch(places)], np.int16)

    def good(self, places: Integers) -> Mask:
        """(n,) False for records, by their places, that belong to a stray stretch."""
        if not self.stray.any():
            return np.ones(places.shape, np.bool_)
        return np.asarray(~self.stray[self._stretch(places)], np.bool_)

    def silences(self) -> Silences:
        """The silences between successive stretches that are not stray."""
        steady = np.flatnonzero(~self.stray)
        begin_ns = self.begin[steady]
        end_ns = self.end[steady]
        silence_ns = begin_ns[1:] - end_ns[:-1]
        is_long = silence_ns > clock.BOOT_STEP_NS
        after = steady[1:]
        return Silences(
            after=after[is_long],
            length_ns=silence_ns[is_long],
        )

    def _stretch(self, places: Integers) -> Rows:
        """(n,) the index of the stretch of each record, by its place; 0 before all stretches."""
        return np.maximum(np.searchsorted(self.first, places, side="right") - 1, 0)


def microseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields [us] of any type as a new int64 array, limited to `LAST_US`, longer than any log.

    NaN becomes `LAST_US` too. Numbers below 0 become 0 if they are floats, else `LAST_US`.

    >>> microseconds(np.array([7, 2**64 - 1], np.uint64)).tolist() == [7, 2**52]
    True
    """
    if raw.dtype.kind == "f":
        without_nan = np.where(np.isnan(raw), float(clock.LAST_US), raw.astype(np.float64))
        return whole_numbers(without_nan, 0, clock.LAST_US)
    unsigned = raw.astype(np.uint64, copy=False)  # numbers below 0 become huge
    last_us = np.uint64(clock.LAST_US)
    cut_us = np.minimum(unsigned, last_us)
    return np.asarray(cut_us.view(np.int64), np.int64)


def nanoseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields [us] as a new array [ns], limited as by `microseconds`."""
    time_ns = microseconds(raw)
    time_ns *= 1000
    return time_ns


class _Stretch(NamedTuple):
    """Successive records without a jump of the time since boot.

    first : place of the first record; begin, end : its time and that of the last one [ns];
    length : number of records.
    """

    first: int
    begin: int
    end: int
    length: int


def _stretches_of(places: Integers, time_ns: TimeArray) -> list[_Stretch]:
    """Cut (n,) records, n >= 1, into stretches where the time jumps by more than 1 s."""
    cuts = np.flatnonzero(np.abs(np.diff(time_ns)) > clock.BOOT_STEP_NS) + 1
    starts = np.append(0, cuts)
    stops = np.append(cuts, time_ns.shape[0])
    columns = (
        places[starts],
        time_ns[starts],
        time_ns[stops - 1],
        stops - starts,
    )
    stretches = []
    for row in np.stack(columns, axis=1).tolist():
        stretches.append(_Stretch(*row))
    return stretches


def _continues(last: _Stretch, following: _Stretch) -> bool:
    """Whether the time since boot jumps by at most 1 s from one stretch to the next."""
    step_ns = following.begin - last.end
    return abs(step_ns) <= clock.BOOT_STEP_NS


def timeline(blocks: Iterable[Stamps]) -> Timeline:
    """Find power-ups and stray stamps in the times since boot of a log.

    ``blocks`` are all records in the order of the log. A step back by more than 1 s is a power-up,
    unless it is to or from a stray stretch.

    >>> time_ns = np.array([5, 6, 7, 8, 9, 2, 3, 4, 5, 6]) * 10**9
    >>> timeline([(np.arange(10), time_ns)]).boot_of(np.array([4, 5]))
    array([0, 1], dtype=int16)
    """
    stretches: list[_Stretch] = []
    for places, time_ns in blocks:
        if not places.shape[0]:
            continue
        new_stretches = _stretches_of(places, time_ns)
        if stretches and _continues(stretches[-1], new_stretches[0]):
            last = stretches[-1]
            continuation = new_stretches[0]
            stretches[-1] = last._replace(
                end=continuation.end,
                length=last.length + continuation.length,
            )
            new_stretches = new_stretches[1:]
        stretches += new_stretches
    begin = np.array([stretch.begin for stretch in stretches], np.int64)
    end = np.array([stretch.end for stretch in stretches], np.int64)
    length = np.array([stretch.length for stretch in stretches], np.int64)
    stray = clock.stray_stretches(
        begin,
        end,
        length,
    )
    boots = _boots(begin, end, stray)
    check_boots(int(boots.max(initial=0)) + 1, records=int(length.sum()))
    return Timeline(
        first=np.array([stretch.first for stretch in stretches], np.int64),
        begin=begin,
        end=end,
        length=length,
        stray=stray,
        boot=boots.astype(np.int16),
    )


def _boots(begin: TimeArray, end: TimeArray, stray: Mask) -> Integers:
    """The boot of each of (n,) stretches; a stray one has that of the stretch before it."""
    if not begin.size:
        return np.empty(0, np.int64)
    steady = ~stray
    steps_ns = begin[steady][1:] - end[steady][:-1]
    steps_back = steps_ns < -clock.BOOT_STEP_NS
    boot_of_steady = np.append(0, np.cumsum(steps_back))
    last_steady = np.maximum(np.cumsum(steady) - 1, 0)  # 0 for stray ones before all others
    return np.asarray(boot_of_steady[last_steady], np.int64)


def report_timeline(line: Timeline, ledger: Ledger) -> None:
    """Report the stray stamps of a log, and the silences between its records of sensors.

    The places of the log must be bytes: the reports name them.
    """
    if line.stray.any():
        stray_records = messages.stray_records(
            byte=int(line.first[line.stray][0]),
            count=int(line.length[line.stray].sum()),
        )
        ledger.add(stray_records)
    # Shorter stretches are of parameters and texts, logged before and after the sensors.
    with_sensors = np.flatnonzero(~line.stray & (line.length >= _FEWEST_RECORDS))
    if not with_sensors.size:
        return
    silences = line.silences()
    begins_behind_first = silences.after > with_sensors[0]
    ends_before_last = silences.after <= with_sensors[-1]
    is_between = begins_behind_first & ends_before_last
    if not is_between.any():
        return
    first_after = silences.after[is_between][0]
    silent_ns = silences.length_ns[is_between].sum()
    nothing_logged = messages.nothing_logged(
        byte=int(line.first[first_after]),
        count=int(np.count_nonzero(is_between)),
        seconds=float(silent_ns) / 1e9,
    )
    ledger.add(nothing_logged)
