"""Stretches of a flight in which other evidence contradicts a quantity, and their stations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import TimeArray
from unbend.flight.stations import Stations
from unbend.messages import Notes, fallback, loss
from unbend.units import Mask

POSITION, HEIGHT, ATTITUDE = "position", "height", "attitude"
SECOND = 1_000_000_000


@dataclass(frozen=True, order=True)
class Stretch:
    """From ``begin_ns`` to ``end_ns`` a quantity is suspect."""

    begin_ns: int
    end_ns: int
    quantity: str  # position, height or attitude
    reason: str  # the evidence, in plain words
    off_m: float = np.nan  # how far off it may be, NaN where unknown
    replaced_by: str = ""  # the channel whose samples replace the suspect ones

    def covers(self, time_ns: TimeArray) -> Mask:
        """Which instants lie in it."""
        return np.asarray((time_ns >= self.begin_ns) & (time_ns <= self.end_ns))

    @property
    def when(self) -> str:
        """From when to when, UTC."""
        begin, end = np.array([self.begin_ns, self.end_ns], "datetime64[ns]").astype("M8[s]")
        return f"{begin} to {end} UTC"

    def meets(self, other: Stretch) -> bool:
        """Whether the two have a time in common."""
        return self.begin_ns <= other.end_ns and other.begin_ns <= self.end_ns


def covered(stretches: Sequence[Stretch], time_ns: TimeArray) -> Mask:
    """Which instants lie in any of several stretches."""
    inside = np.zeros(time_ns.shape, np.bool_)
    for stretch in stretches:
        inside |= stretch.covers(time_ns)
    return inside


def merged(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Stretches of one quantity that touch, as one, with up to three of their reasons."""
    result: list[Stretch] = []
    for stretch in sorted(stretches):
        last = result[-1] if result else None
        if last is None or stretch.begin_ns > last.end_ns + SECOND:
            result.append(stretch)
            continue
        reasons = last.reason.split("; ")
        if stretch.reason not in reasons and len(reasons) < 3:
            reasons.append(stretch.reason)
        end, off_m = max(last.end_ns, stretch.end_ns), float(np.fmax(last.off_m, stretch.off_m))
        result[-1] = replace(last, end_ns=end, reason="; ".join(reasons), off_m=off_m)
    return result


def runs(time_ns: TimeArray, bad: Mask, seed: Mask, join_s: float = 1.0) -> list[tuple[int, int]]:
    """First and last row of each run of bad rows with a seed; ``join_s`` [s] apart they are one."""
    rows = np.flatnonzero(bad | seed)
    if not seed.any():
        return []
    cut = np.flatnonzero(np.diff(time_ns[rows]) > join_s * SECOND)
    first, last = rows[np.append(0, cut + 1)], rows[np.append(cut, rows.size - 1)]
    pairs = zip(first.tolist(), last.tolist(), strict=True)
    return [(a, b) for a, b in pairs if seed[a : b + 1].any()]


def beside(time_ns: TimeArray, a: int, b: int) -> tuple[int, int]:
    """The times of the rows before and after those from a to b [ns]."""
    return int(time_ns[max(a - 1, 0)]), int(time_ns[min(b + 1, time_ns.size - 1)])


def flag_suspect(
    stations: Stations, stretches: Sequence[Stretch], *, use_suspect: bool
) -> tuple[Stations, Notes]:
    """Mark stations in suspect stretches, usable with ``use_suspect``; note replaced samples."""
    notes, usable = [], stations.ok
    for stretch in stretches:
        rows = stretch.covers(stations.time_ns) & usable
        count, quantity = int(rows.sum()), stretch.quantity
        if count == 0:
            continue
        when = f"{count} exposures from {stretch.when}, the first {stations.image[np.argmax(rows)]}"
        if stretch.replaced_by:
            what = f"{when}: {quantity} from {stretch.replaced_by}, because {stretch.reason}"
            notes.append(fallback("STATIONS-STAND-IN", what, where=quantity, count=count))
            continue
        far = f", up to {stretch.off_m:.0f} m off" if np.isfinite(stretch.off_m) else ""
        what = f"{when}: {quantity} is suspect{far}: {stretch.reason}"
        notes.append(loss("STATIONS-SUSPECT", what, where=quantity, count=count))
        stations = stations.as_suspect(rows, stretch.reason, stretch.off_m, use=use_suspect)
    return stations, tuple(notes)
