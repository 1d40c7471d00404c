"""Stretches of a flight in which evidence contradicts a quantity, and the stations in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.flight.channels import TimeArray
from unbend.flight.evidence.messages import another_source_stands_in, stations_suspect
from unbend.flight.stations import Stations
from unbend.messages import Message, Notes
from unbend.units import NANOSECONDS_PER_SECOND, Mask

POSITION = "position"
HEIGHT = "height"
ATTITUDE = "attitude"

SECOND = NANOSECONDS_PER_SECOND

_MOST_REASONS = 3  # that a stretch joined from several keeps


@dataclass(frozen=True, order=True)
class Stretch:
    """A time from ``begin_ns`` to ``end_ns`` in which a quantity is suspect."""

    begin_ns: int
    end_ns: int
    quantity: str  # position, height or attitude
    reason: str  # the evidence, in plain words
    off_m: float = np.nan  # how far off the quantity may be; NaN if unknown
    replaced_by: str = ""  # name of the channel that replaces the suspect samples; "" if none does

    def covers(self, time_ns: TimeArray) -> Mask:
        """(n,) True for instants within the stretch, its ends included."""
        return np.asarray((time_ns >= self.begin_ns) & (time_ns <= self.end_ns))

    @property
    def when(self) -> str:
        """The begin and the end as text, UTC."""
        ends = np.array([self.begin_ns, self.end_ns], "datetime64[ns]").astype("datetime64[s]")
        return f"{ends[0]} to {ends[1]} UTC"

    def meets(self, other: Stretch) -> bool:
        """Whether two stretches have a time in common."""
        return self.begin_ns <= other.end_ns and other.begin_ns <= self.end_ns


def in_any_stretch(stretches: Sequence[Stretch], time_ns: TimeArray) -> Mask:
    """(n,) True for instants in at least one of the stretches."""
    inside = np.zeros(time_ns.shape, np.bool_)
    for stretch in stretches:
        inside |= stretch.covers(time_ns)
    return inside


def joined_stretches(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Join stretches of one quantity that overlap or are up to a second apart.

    A joined stretch keeps up to three of the reasons. The result is in the order of time.
    """
    result: list[Stretch] = []
    for stretch in sorted(stretches):
        if result and stretch.begin_ns <= result[-1].end_ns + SECOND:
            result[-1] = _joined(result[-1], stretch)
        else:
            result.append(stretch)
    return result


def _joined(first: Stretch, second: Stretch) -> Stretch:
    """One stretch for two of the same quantity; the second begins at the same time or later.

    Its ``off_m`` is the larger of both.
    """
    reasons = first.reason.split("; ")
    if second.reason not in reasons and len(reasons) < _MOST_REASONS:
        reasons.append(second.reason)
    return replace(
        first,
        end_ns=max(first.end_ns, second.end_ns),
        reason="; ".join(reasons),
        off_m=float(np.fmax(first.off_m, second.off_m)),
    )


class Run(NamedTuple):
    """Successive rows of a channel: row numbers of the first and of the last one."""

    first: int
    last: int

    @property
    def rows(self) -> slice:
        """The rows as a slice, to index an array."""
        return slice(self.first, self.last + 1)  # a slice ends before its stop


def runs(
    time_ns: TimeArray, may_be_bad: Mask, is_surely_bad: Mask, join_s: float = 1.0
) -> list[Run]:
    """The runs of rows that may be bad and contain at least one row that is surely bad.

    All arrays are (n,). Rows that may be bad and are at most ``join_s`` [s] apart belong to one
    run, with all rows between them.
    """
    if not is_surely_bad.any():
        return []
    rows = np.flatnonzero(may_be_bad | is_surely_bad)
    ends = np.flatnonzero(np.diff(time_ns[rows]) > join_s * SECOND)  # places in ``rows``
    first_rows = rows[np.append(0, ends + 1)]
    last_rows = rows[np.append(ends, rows.size - 1)]
    bad_runs: list[Run] = []
    for first, last in zip(first_rows.tolist(), last_rows.tolist(), strict=True):
        run = Run(first, last)
        if is_surely_bad[run.rows].any():
            bad_runs.append(run)
    return bad_runs


def stretch_of_run(
    time_ns: TimeArray, run: Run, quantity: str, reason: str, off_m: float = np.nan
) -> Stretch:
    """The stretch from the time of the row before a run to that of the row after it."""
    before = max(run.first - 1, 0)
    after = min(run.last + 1, time_ns.size - 1)
    return Stretch(int(time_ns[before]), int(time_ns[after]), quantity, reason, off_m)


def flag_suspect(
    stations: Stations, stretches: Sequence[Stretch], *, use_suspect: bool
) -> tuple[Stations, Notes]:
    """Mark the usable stations in suspect stretches as suspect; a message reports each stretch.

    With ``use_suspect`` they stay usable. If another source has replaced the samples in a stretch,
    its stations are only reported. A station in several stretches is marked for each of them.
    """
    notes: list[Message] = []
    usable = stations.ok  # before any stretch has made one suspect
    for stretch in stretches:
        rows = stretch.covers(stations.time_ns) & usable
        count = int(np.count_nonzero(rows))
        if count == 0:
            continue
        first = stations.image[np.argmax(rows)]
        if stretch.replaced_by:
            stand_in = another_source_stands_in(
                count=count,
                when=stretch.when,
                first=first,
                quantity=stretch.quantity,
                source=stretch.replaced_by,
                reason=stretch.reason,
            )
            notes.append(stand_in)
            continue
        suspect = stations_suspect(
            count=count,
            when=stretch.when,
            first=first,
            quantity=stretch.quantity,
            off_m=stretch.off_m if np.isfinite(stretch.off_m) else None,
            reason=stretch.reason,
        )
        notes.append(suspect)
        stations = stations.as_suspect(rows, stretch.reason, stretch.off_m, use=use_suspect)
    return stations, tuple(notes)
