"""Replacing a source of position or height by another one where it is clear that it is wrong."""

from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence.source_differences import Difference
from unbend.flight.evidence.sources import EARTH_RADIUS_M, SourcePath, is_receiver, sigma_column
from unbend.flight.evidence.stretches import ATTITUDE, SECOND, Stretch
from unbend.units import Array, Mask

LONGEST_COAST_S = 2.0  # without a receiver for longer, a filter may be wrong [s]
BESIDE_S = 10.0  # a source that replaces another agrees with it for so long before and after [s]
LONGEST_REPLACED_S = 60  # for longer, only a receiver replaces a source [s]
# Half the acceleration of the drift of a filter with a vertical that is 0.25 degrees wrong [m/s2].
LEAST_DRIFT_M_S2 = 0.02
_FEWEST_BESIDE = 5  # samples before, and as many after, in which two sources are compared
_HEIGHTS = ("h_msl_m", "h_ellipsoid_m", "h_home_m", "h_gnss_m")
_AGREEING_PERCENT = 90.0  # two sources agree if so many samples differ by no more than noise


@dataclass(frozen=True, eq=False)
class Sources:
    """The source that plays the role of a quantity, and its difference from each other source.

    ``barometers`` : names of the barometers among the other sources; the first has the role of the
    pressure.
    """

    quantity: str
    of_role: SourcePath
    differences: tuple[Difference, ...]
    barometers: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Replacement:
    """A source that replaces a suspect one, and the offset of the two before and after it.

    An offset is the place by the suspect source minus that by the replacement.
    """

    difference: Difference
    before_m: Array  # (k,) offset
    after_m: Array  # (k,) offset

    @property
    def channel(self) -> Channel:
        """The channel of the source that replaces the suspect one."""
        return self.difference.other.channel

    @property
    def offset_m(self) -> Array:
        """(k,) mean of the offsets before and after."""
        return 0.5 * (self.before_m + self.after_m)

    @property
    def spread_m(self) -> float:
        """Sigma of the replaced places: half the change of the offset, and the usual scatter."""
        change_m = self.after_m - self.before_m
        half_m = 0.5 * float(np.linalg.norm(change_m))
        return float(np.hypot(half_m, self.difference.scatter_m))


def replacement_for(sources: Sources, stretch: Stretch) -> Replacement | None:
    """The source that replaces the suspect one in a stretch; None if it is not clear what is wrong.

    It is clear if a receiver fails (`_fails`) in the stretch, or within a second of it. The
    replacement must not fail there, and must agree with the suspect source for 10 s before and
    after. A receiver may replace any source; a filter or a barometer only a receiver, and for at
    most 60 s.
    """
    wide = replace(
        stretch,
        begin_ns=stretch.begin_ns - SECOND,
        end_ns=stretch.end_ns + SECOND,
    )
    other_paths = [difference.other for difference in sources.differences]
    paths = [sources.of_role, *other_paths]
    receivers = [path for path in paths if is_receiver(path.channel)]
    if not any(_fails(path, wide) for path in receivers):
        return None
    is_long = stretch.end_ns - stretch.begin_ns > LONGEST_REPLACED_S * SECOND
    must_be_receiver = is_long or not is_receiver(sources.of_role.channel)
    for difference in sources.differences:
        if must_be_receiver and not is_receiver(difference.other.channel):
            continue
        if _fails(difference.other, wide):
            continue
        replacement = _if_agrees_beside(difference, wide)
        if replacement is not None:
            return replacement
    return None


def _fails(path: SourcePath, stretch: Stretch) -> bool:
    """Whether a source is silent, steps or reports a poor accuracy in a stretch."""
    rows = stretch.covers(path.channel.time_ns)
    stamps = path.channel.time_ns[rows]
    gaps_ns = np.diff(stamps, prepend=stretch.begin_ns, append=stretch.end_ns)
    is_silent = bool(gaps_ns.max() > LONGEST_COAST_S * SECOND)
    steps = bool(stretch.covers(path.step_ns).any())
    return is_silent or steps or not path.good[rows].all()


def _if_agrees_beside(difference: Difference, stretch: Stretch) -> Replacement | None:
    """The replacement by the other source of a difference, if both agree beside a stretch.

    They must agree for 10 s before and for 10 s after it; else None.
    """
    margin_ns = int(BESIDE_S * SECOND)
    before = replace(
        stretch,
        begin_ns=stretch.begin_ns - margin_ns,
        end_ns=stretch.begin_ns,
    )
    after = replace(
        stretch,
        begin_ns=stretch.end_ns,
        end_ns=stretch.end_ns + margin_ns,
    )
    before_m = _agreed_offset(difference, before)
    after_m = _agreed_offset(difference, after)
    if before_m is None or after_m is None:
        return None
    return Replacement(difference, before_m=before_m, after_m=after_m)


def _agreed_offset(difference: Difference, stretch: Stretch) -> Array | None:
    """(k,) median difference [m] of two sources in a stretch in which they agree.

    None if they do not agree there, or have fewer than five samples to compare.
    """
    rows = stretch.covers(difference.other.channel.time_ns)
    rows &= np.isfinite(difference.off_m)
    if np.count_nonzero(rows) < _FEWEST_BESIDE:
        return None
    share_of_limit = difference.off_m / difference.limit_m
    largest_share = np.percentile(share_of_limit[rows], _AGREEING_PERCENT)
    if largest_share >= 1.0:
        return None
    offset_m: Array = np.median(difference.apart_m[rows], axis=0)
    return offset_m


def attitude_drifts(
    filter_path: SourcePath, replacement: Replacement, stretch: Stretch
) -> list[Stretch]:
    """The same stretch as one of suspect attitude, if the filter drifted in it; else empty.

    A filter that moves away from its replacement without a step has a wrong vertical: with a
    quarter of a degree of tilt, a filter without a receiver is 0.02 m/s² t² away after the time t.
    It drifted if the sample that is farthest off is at least as far away, and farther than noise.
    Samples at which the filter has stepped away do not count.
    """
    difference = replacement.difference
    time_ns = replacement.channel.time_ns
    has_stepped = filter_path.stepped_m.any(axis=1)
    # 0 between two samples of the filter that both have not stepped away.
    stepped_share = np.interp(time_ns, filter_path.channel.time_ns, has_stepped)
    may_drift = stretch.covers(time_ns) & (stepped_share == 0.0)
    known_off_m = np.nan_to_num(difference.off_m)
    off_m = np.where(may_drift, known_off_m, 0.0)
    worst = int(np.argmax(off_m))
    after_s = (int(time_ns[worst]) - stretch.begin_ns) / SECOND
    noise_m = float(difference.limit_m[worst])
    least_m = max(noise_m, LEAST_DRIFT_M_S2 * after_s**2)
    if off_m[worst] < least_m:
        return []
    reason = (
        f"{filter_path.channel.name} drifts {off_m[worst]:.0f} m in {after_s:.0f} s, as with a "
        "wrong vertical"
    )
    suspect_attitude = replace(
        stretch,
        quantity=ATTITUDE,
        reason=reason,
        off_m=np.nan,
    )
    return [suspect_attitude]


def with_replaced(channel: Channel, replacement: Replacement, stretch: Stretch) -> Channel:
    """The channel with its samples in a stretch replaced by those of the replacement.

    The lag and the offset of the replacement are taken out. Columns that it does not have are NaN
    in these samples.
    """
    other = replacement.channel
    other_ns = other.time_ns - round(replacement.difference.lag_s * 1e9)
    inside = stretch.covers(other_ns)
    outside = ~stretch.covers(channel.time_ns)
    sigma = sigma_column(stretch.quantity)
    filling = _filling_columns(replacement, inside, sigma, channel.height_column)
    unknown = np.full(np.count_nonzero(inside), np.nan)

    both_ns = np.concatenate([channel.time_ns[outside], other_ns[inside]])
    time_ns, rows = np.unique(both_ns, return_index=True)
    columns: dict[str, Array] = {}
    for name in (*channel.columns, sigma):  # sigma may be among the columns or not
        filled = filling.get(name, unknown)
        both = np.concatenate([channel.get(name)[outside], filled])
        columns[name] = both[rows]
    both_boots = np.concatenate([channel.boot[outside], other.boot[inside]])
    return replace(
        channel,
        time_ns=time_ns,
        boot=both_boots[rows],
        columns=columns,
        labels={},
        rejected={},
    )


def _filling_columns(
    replacement: Replacement, inside: Mask, sigma: str, height_column: str | None
) -> dict[str, Array]:
    """The columns of the samples ``inside`` (n,) of a replacement, with the offset added.

    ``sigma`` : name of the column for the standard deviations, which are those that the source
    itself reports, with `Replacement.spread_m` added in quadrature. ``height_column`` : that of the
    replaced channel.
    """
    other = replacement.channel
    columns = {name: values[inside] for name, values in other.columns.items()}
    columns |= moved_columns(other, inside, replacement.offset_m, height_column)
    unknown = np.full(np.count_nonzero(inside), np.nan)
    reported_m = np.nan_to_num(columns.get(sigma, unknown))
    columns[sigma] = np.hypot(reported_m, replacement.spread_m)
    return columns


def moved_columns(
    channel: Channel, rows: Mask, by_m: Array, into_column: str | None
) -> dict[str, Array]:
    """The columns of place in some rows of a channel, moved by (2,) metres north, east or (1,) up.

    Heights are read from the channel's own height column and returned as ``into_column``, the
    height column of the channel that they replace; the other kinds of height become NaN.
    """
    is_height = by_m.size == 1
    if is_height:
        height = channel[channel.height_column or "h_msl_m"]
        height_m = height[rows] + by_m[0]
        unknown = np.full(height_m.shape, np.nan)
        columns = dict.fromkeys(_HEIGHTS, unknown)
        columns[into_column or "h_msl_m"] = height_m
        return columns
    lat = channel["lat_rad"][rows]
    lon = channel["lon_rad"][rows]
    north, east = by_m / EARTH_RADIUS_M
    return {
        "lat_rad": lat + north,
        "lon_rad": lon + east / np.cos(lat),
    }
