"""Samples of a source that replace those of another in a suspect stretch."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.flight.evidence.sources import Difference, SourcePath, is_receiver, moved
from pipeline.flight.evidence.stretches import ATTITUDE, HEIGHT, SECOND, Stretch
from pipeline.units import Array

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
