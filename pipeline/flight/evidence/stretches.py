"""Stretches of a flight in which other evidence contradicts a quantity: stations, replacements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.flight.channels import Channel, TimeArray
from pipeline.flight.evidence.sources import Difference, SourcePath, is_receiver, moved
from pipeline.flight.stations import Stations
from pipeline.ledger import Notes, fallback, loss
from pipeline.units import Array, Mask

POSITION, HEIGHT, ATTITUDE = "position", "height", "attitude"
SECOND = 1_000_000_000


@dataclass(frozen=True, order=True)
class Stretch:
    """From ``begin_ns`` to ``end_ns`` a quantity is suspect.

    ``quantity`` is position, height or attitude; ``reason`` the evidence, in plain words; ``off_m``
    how far off it may be [m], NaN where that is unknown; ``replaced_by`` the channel whose samples
    replace the suspect ones, or empty.
    """

    begin_ns: int
    end_ns: int
    quantity: str
    reason: str
    off_m: float = np.nan
    replaced_by: str = ""

    def covers(self, time_ns: TimeArray) -> Mask:
        """Which instants lie in it."""
        return np.asarray((time_ns >= self.begin_ns) & (time_ns <= self.end_ns))

    @property
    def when(self) -> str:
        """From when to when, UTC."""
        begin, end = (
            np.datetime64(t, "ns").astype("datetime64[s]") for t in (self.begin_ns, self.end_ns)
        )
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
    """Mark the stations in suspect stretches, and note those whose samples were replaced.

    With ``use_suspect`` they stay usable; the loss is entered all the same.
    """
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


LONGEST_COAST_S = 2.0  # a filter without a receiver for longer is no longer known to be right [s]
BESIDE_S = 10.0  # a source that replaces another agrees with it for so long before and after [s]
# A filter without its receiver, or a barometer, replaces a receiver for no longer [s].
LONGEST_REPLACED_S = 60
# Half the acceleration by which a filter drifts whose vertical is 0.25 degrees wrong [m/s2].
LARGEST_DRIFT_M_S2 = 0.02


@dataclass(frozen=True, eq=False)
class Sources:
    """The source that plays the role of a quantity, and its difference from each other one.

    ``barometers`` names those compared, first the one that plays the role of the pressure.
    """

    quantity: str
    own: SourcePath
    differences: tuple[Difference, ...]
    barometers: tuple[str, ...] = ()


def replacement_for(sources: Sources, stretch: Stretch) -> tuple[Difference, list[Array]] | None:
    """The source that replaces a suspect one where it is plain who is wrong, and two offsets.

    Who is wrong has steps of its own, a poor accuracy or no fix: the source itself, or, where that
    is a filter, one of several receivers. The replacement has none of these from 10 s before to
    10 s after, and agrees before and after, where its offsets are taken. A filter or a barometer
    replaces a receiver for at most 60 s.
    """
    own, long = sources.own, stretch.end_ns - stretch.begin_ns > LONGEST_REPLACED_S * SECOND
    wide = replace(stretch, begin_ns=stretch.begin_ns - SECOND, end_ns=stretch.end_ns + SECOND)

    def fails(track: SourcePath) -> bool:
        rows = wide.covers(track.channel.time_ns)
        silent = bool(np.diff(track.channel.time_ns[rows], prepend=wide.begin_ns,
                              append=wide.end_ns).max() > LONGEST_COAST_S * SECOND)  # fmt: skip
        return silent or not track.good[rows].all() or bool(wide.covers(track.step_ns).any())

    paths = [own, *(d.other for d in sources.differences)]
    if not any(fails(path) for path in paths if is_receiver(path.channel)):
        return None
    for d in sources.differences:
        channel = d.other.channel
        if fails(d.other) or (not is_receiver(channel) and (long or not is_receiver(own.channel))):
            continue
        margin = int(BESIDE_S * SECOND)
        before = replace(wide, begin_ns=wide.begin_ns - margin, end_ns=wide.begin_ns)
        after = replace(wide, begin_ns=wide.end_ns, end_ns=wide.end_ns + margin)
        known = np.isfinite(d.off_m)
        sides = [side.covers(channel.time_ns) & known for side in (before, after)]
        if all(
            np.count_nonzero(side) > 4 and np.percentile(d.off_m[side], 90.0) < d.limit_m
            for side in sides
        ):
            return d, [np.median(d.apart_m[side], axis=0) for side in sides]
    return None


def drifted(own: SourcePath, d: Difference, stretch: Stretch) -> list[Stretch]:
    """A filter that left its replacement without a step has a wrong vertical: a suspect attitude.

    A quarter of a degree of tilt carries a coasting filter 0.02 m/s² t² away.
    """
    time_ns = d.other.channel.time_ns
    stepped = np.interp(time_ns, own.channel.time_ns, own.stepped_m.any(axis=1))
    off = np.where(stretch.covers(time_ns) & (stepped == 0.0), np.nan_to_num(d.off_m), 0.0)
    worst = int(np.argmax(off))
    t = (int(time_ns[worst]) - stretch.begin_ns) / SECOND
    if off[worst] < max(d.limit_m, LARGEST_DRIFT_M_S2 * t**2):
        return []
    reason = f"{own.channel.name} drifts {off[worst]:.0f} m in {t:.0f} s, as with a wrong vertical"
    return [replace(stretch, quantity=ATTITUDE, reason=reason, off_m=np.nan)]


def with_replaced(
    channel: Channel, d: Difference, stretch: Stretch, offsets: list[Array]
) -> Channel:
    """The channel with the samples of another source in a stretch, its lag and offset taken out.

    The offset is the mean of those before and after; half their difference and the usual
    difference of the two go into the standard deviation, with the source's own.
    """
    other, sigma = d.other.channel, "sigma_v_m" if stretch.quantity == HEIGHT else "sigma_h_m"
    time_ns = other.time_ns - round(d.lag_s * 1e9)
    inside, keep = stretch.covers(time_ns), ~stretch.covers(channel.time_ns)
    spread = np.hypot(0.5 * float(np.linalg.norm(offsets[1] - offsets[0])), d.scatter_m)
    fill = {name: values[inside] for name, values in other.columns.items()}
    fill |= moved(other, inside, 0.5 * (offsets[0] + offsets[1]), channel.height_column)
    unknown = np.full(np.count_nonzero(inside), np.nan)
    fill[sigma] = np.hypot(np.nan_to_num(fill.get(sigma, unknown)), spread)
    joined, rows = np.unique(
        np.concatenate([channel.time_ns[keep], time_ns[inside]]), return_index=True
    )

    def column(name: str) -> Array:
        mine = channel.get(name)[keep]
        return np.concatenate([mine, fill.get(name, unknown)])[rows]

    boot = np.concatenate([channel.boot[keep], other.boot[inside]])[rows]
    columns = {name: column(name) for name in (*channel.columns, sigma)}
    return replace(channel, time_ns=joined, boot=boot, columns=columns, labels={})
