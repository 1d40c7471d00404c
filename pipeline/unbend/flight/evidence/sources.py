"""Sources of position and height: steps that no vehicle makes, differences, replacements."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.stretches import ATTITUDE, HEIGHT, POSITION, SECOND, Run, Stretch, runs
from unbend.flight.trajectory import interpolate
from unbend.geodesy import wrapped
from unbend.units import Array, Mask, Rows

# A step from sample to sample that is noise, beyond what velocity and neighbours explain [m].
NOISE_STEP_M = {POSITION: 3.0, HEIGHT: 5.0}
# A difference of two sources that is noise, beyond lag and offset [m].
NOISE_MISFIT_M = {POSITION: 2.0, HEIGHT: 4.0}
WORST_ACCURACY_M = 5.0  # a receiver that reports worse is not used [m]
SEVERAL_USUAL_ACCURACIES = 3.0  # a report of so many times the median is not used

_SEVERAL = 6.0  # a difference of so many times the usual one is no noise
_RADIUS_M = 6_371_000.0  # for differences of metres: any radius will do
_SIGMA_OF_MEDIAN = 1.48  # of absolute differences of normal errors
_SOURCE_GAP_S = 2.0  # between samples of a source that is compared

# Steps.
_LONGEST_STEP_S = 10.0  # over a longer interval a vehicle may have gone anywhere
_LIKELY_M_S2 = 4.0  # of a vehicle: what it moves otherwise within an interval is no step
_RETURNS_WITHIN = 0.1  # of a step: a source that comes as near has returned
_MOST_STEPS = 1_000
_NEIGHBOURS = 3  # speeds on either side of which, with a sample's own, the median counts

# Lag of a source behind another, by differences along the track.
_SLOWEST_M_S = 2.0  # slower samples show no lag, nor those of less than a third of usual speeds
_FAST_SHARE = 0.1  # of the square of the 95th percentile of speeds
_FEWEST_FAST = 20
_LAG_PARTS = 20  # of the flight, whose lags are tried where the median one does not fit
_LONGEST_LAG_S = 0.3  # of receivers; a constant offset seems to be one along a line
_PART_OF_FLIGHT = 0.1  # in which two sources agree: no chance, whatever the rest is like

# Heights of a barometer.
_SLOPE_M = -8434.5  # dh / d ln p at 288.15 K
_FEWEST_PRESSURES = 30
_SPAN_OF_PARABOLA_M = 300.0  # of a flight: over less, noise would bend it
_LEAST_SCATTER_M = 1.0


@dataclass(frozen=True, eq=False)
class SourcePath:
    """One source of positions or heights, and what it says against itself.

    ``stepped_m`` (n, 2) north and east, or (n, 1) up, is how far its own steps have carried it from
    where it was before and is later.
    """

    channel: Channel
    stepped_m: Array
    good: Mask  # (n,) where it has not stepped away and reports a useful accuracy
    part: Rows  # (n,) number of what lies between restarts and steps that do not return
    step_ns: TimeArray  # of all steps
    lasting_ns: TimeArray  # of those that do not return
    fastest_m_s: float  # the worst step


def is_receiver(channel: Channel) -> bool:
    """Whether a channel is a GNSS receiver, which gives both positions and heights."""
    return {POSITION, HEIGHT} <= set(channel.roles)


def sigma_column(quantity: str) -> str:
    """The column in which a source reports the accuracy of a quantity."""
    return "sigma_v_m" if quantity == HEIGHT else "sigma_h_m"


def places_of(channel: Channel, quantity: str) -> Array:
    """(n, 2) latitude and longitude [rad], unwrapped, or (n, 1) height [m] above any surface."""
    if quantity == HEIGHT:
        return channel[channel.height_column or "h_msl_m"][:, None]
    return np.stack([channel["lat_rad"], np.unwrap(channel["lon_rad"])], axis=1)


def moves_of(channel: Channel, quantity: str) -> Array:
    """(n - 1, k) metres from each place of a channel to the next."""
    places = places_of(channel, quantity)
    changes = np.diff(places, axis=0)
    if quantity == HEIGHT:
        return changes
    return metres(changes, places[1:, 0])


def with_places(channel: Channel, quantity: str) -> Channel:
    """The samples of a channel whose place is known; none where it gives none."""
    if quantity == HEIGHT and channel.height_column is None:
        return channel.rows(np.zeros(len(channel), np.bool_))
    known = np.asarray(np.isfinite(places_of(channel, quantity)).all(axis=1))
    return channel if known.all() else channel.rows(known)


def metres(change: Array, lat_rad: Array) -> Array:
    """(n, 2) metres north and east of (n, 2) changes of latitude and longitude [rad]."""
    east = wrapped(change[:, 1]) * np.cos(lat_rad)
    return _RADIUS_M * np.stack([change[:, 0], east], axis=1)


def velocity_at(channels: Iterable[Channel], quantity: str, time_ns: TimeArray) -> Array:
    """(n, 2) north and east or (n, 1) up [m/s] from the first channel that has it; NaN without."""
    names = ("v_down_m_s",) if quantity == HEIGHT else ("v_north_m_s", "v_east_m_s")
    sign = -1.0 if quantity == HEIGHT else 1.0
    for channel in channels:
        if len(channel) > 1 and all(name in channel.columns for name in names):
            gap_s = channel.gap_limit_s(_SOURCE_GAP_S)
            components = [interpolate(channel, name, time_ns, gap_s) for name in names]
            return np.stack(components, axis=1) * sign
    return np.full((time_ns.size, len(names)), np.nan)


def source_path(channel: Channel, quantity: str, channels: Iterable[Channel]) -> SourcePath:
    """A source with the steps that no vehicle makes, whatever happens between them.

    A step is what neither the velocity (of the first of ``channels`` that has one) nor the speed of
    neighbouring samples explains: more than 3 m, 5 m in height, and several times what is usual.
    From the one that leaves to the one that returns the source is away; one without return parts
    the channel.
    """
    channel = with_places(channel, quantity)
    time_ns = channel.time_ns
    seconds = np.diff(time_ns) * 1e-9
    unexplained = _unexplained_moves(channel, quantity, channels)
    size = np.linalg.norm(unexplained, axis=1)
    noise_m = max(NOISE_STEP_M[quantity], _SEVERAL * float(np.percentile(size, 95.0)))
    limit_m = noise_m + 0.5 * _LIKELY_M_S2 * seconds**2
    before_step = np.flatnonzero(size > limit_m)
    if before_step.size > _MOST_STEPS:  # a channel that always steps is noise
        before_step = before_step[:0]
    fastest_m_s = 0.0
    if before_step.size:
        fastest_m_s = float((size[before_step] / seconds[before_step]).max())
    steps = _own_steps(channel, unexplained, before_step, noise_m)
    good = np.asarray(~steps.stepped_m.any(axis=1))
    sigma = channel.columns.get(sigma_column(quantity))
    if sigma is not None and np.isfinite(sigma).any():
        usual_m = float(np.nanmedian(sigma))
        good &= ~(sigma > max(WORST_ACCURACY_M, SEVERAL_USUAL_ACCURACIES * usual_m))
    return SourcePath(
        channel,
        steps.stepped_m,
        good,
        steps.part,
        step_ns=time_ns[before_step + 1],
        lasting_ns=time_ns[steps.lasting_rows],
        fastest_m_s=fastest_m_s,
    )


def _unexplained_moves(channel: Channel, quantity: str, channels: Iterable[Channel]) -> Array:
    """(n - 1, k) metres from sample to sample that neither velocity nor neighbours explain."""
    seconds = np.diff(channel.time_ns)[:, None] * 1e-9
    speed = moves_of(channel, quantity) / seconds
    padding = ((_NEIGHBOURS, _NEIGHBOURS), (0, 0))
    around = sliding_window_view(np.pad(speed, padding, mode="edge"), 2 * _NEIGHBOURS + 1, axis=0)
    median = np.partition(around, _NEIGHBOURS, axis=-1)[..., _NEIGHBOURS]
    beyond_neighbours = speed - median
    velocity = velocity_at(channels, quantity, channel.time_ns)
    beyond_velocity = speed - 0.5 * (velocity[1:] + velocity[:-1])
    by_velocity = np.linalg.norm(beyond_velocity, axis=1) < np.linalg.norm(
        beyond_neighbours, axis=1
    )
    unexplained = seconds * np.where(by_velocity[:, None], beyond_velocity, beyond_neighbours)
    restarted = np.diff(channel.boot) != 0
    unexplained[restarted | (seconds[:, 0] > _LONGEST_STEP_S)] = 0.0
    return unexplained


class _OwnSteps(NamedTuple):
    """What the steps of a source do to it: how far it is away, its parts, steps without return."""

    stepped_m: Array
    part: Rows
    lasting_rows: list[int]


def _own_steps(
    channel: Channel, unexplained: Array, before_step: Rows, noise_m: float
) -> _OwnSteps:
    """Pair the steps of a source that leave with those that return."""
    time_ns = channel.time_ns
    near_step = np.zeros(time_ns.size - 1, np.bool_)
    for row in before_step:  # a receiver smooths a step: what is left of it lies beside
        near_step |= np.abs(time_ns[1:] - time_ns[row + 1]) <= SECOND
    carried = np.cumsum(np.where(near_step[:, None], unexplained, 0.0), axis=0)
    carried = np.concatenate([np.zeros((1, carried.shape[1])), carried])
    # Between two steps a source stands at one level.
    edges = [0, *(before_step + 1).tolist(), time_ns.size]
    levels = [np.median(carried[begin:end], axis=0) for begin, end in pairwise(edges)]
    stepped_m = np.zeros_like(carried)
    part = channel.boot.astype(np.intp)
    lasting_rows: list[int] = []
    base = levels[0]
    level = 1
    while level < len(levels):
        step_m = float(np.linalg.norm(levels[level] - base))
        if step_m <= noise_m:
            level += 1
            continue
        begin = edges[level]
        back = _return_of(levels, level, base, noise_m + _RETURNS_WITHIN * step_m)
        if back is None:
            base = levels[level]
            lasting_rows.append(begin)
            part[begin:] += int(part.max()) + 1
            level += 1
        else:
            end = edges[back]
            stepped_m[begin:end] = carried[begin:end] - base
            level = back
    return _OwnSteps(stepped_m, part, lasting_rows)


def _return_of(levels: list[Array], away: int, base: Array, tolerance_m: float) -> int | None:
    """The first level after one that is away, at which a source is back at its base."""
    for later in range(away + 1, len(levels)):
        if np.linalg.norm(levels[later] - base) < tolerance_m:
            return later
    return None


@dataclass(frozen=True, eq=False)
class Difference:
    """How far a source is from another, at the times of the other.

    NaN where either is missing, or the other's accuracy is poor.
    """

    other: SourcePath
    apart_m: Array  # (n, k) from the other less its own steps and its constant lag ``lag_s``
    off_m: Array  # (n,) beyond the usual offset
    lag_s: float
    limit_m: float  # the largest ``off_m`` that is noise
    scatter_m: float  # its standard deviation

    @property
    def apart(self) -> list[Run]:
        """Rows of the other in which the two differ by more than noise."""
        with np.errstate(invalid="ignore"):
            is_half_off = self.off_m > 0.5 * self.limit_m
            is_off = self.off_m > self.limit_m
        return runs(self.other.channel.time_ns, is_half_off, is_off)


def source_difference(
    mine: Channel,
    other: SourcePath,
    quantity: str,
    velocity: Array,
    *,
    steady_until_ns: int | None = None,
) -> Difference:
    """How far ``mine`` is from another source; ``velocity`` (n, k) [m/s] at the times of that.

    The usual offset is the median, or that of a tenth of the flight or more in which the two agree:
    positions, and heights of receivers, near 0; other heights before ``steady_until_ns``, when
    ``mine`` stepped and did not return.
    """
    noise_m = NOISE_MISFIT_M[quantity]
    are_receivers = is_receiver(mine) and is_receiver(other.channel)
    near_zero = quantity == POSITION or are_receivers
    velocity = np.nan_to_num(velocity)
    apart_m = _apart_without_lag(mine, other, quantity)
    known = np.isfinite(apart_m).all(axis=1) & other.good
    lag = _constant_lag(apart_m, velocity, known, noise_m, may_part=near_zero)
    apart_m -= lag.seconds * velocity
    is_reported = other.good | other.stepped_m.any(axis=1)
    apart_m[~is_reported] = np.nan
    if near_zero:
        agree = np.linalg.norm(apart_m, axis=1) < noise_m
    elif steady_until_ns is not None:
        agree = other.channel.time_ns < steady_until_ns
    else:
        agree = np.zeros(known.shape, np.bool_)
    off_m, settled = _off_usual(apart_m, other.part, lag.shown_by, agree, noise_m)
    scatter_m = 0.0
    if settled.any():
        scatter_m = _SIGMA_OF_MEDIAN * float(np.median(off_m[settled]))
    return Difference(
        other,
        apart_m,
        off_m,
        lag_s=lag.seconds,
        limit_m=max(noise_m, _SEVERAL * scatter_m),
        scatter_m=scatter_m,
    )


def _apart_without_lag(mine: Channel, other: SourcePath, quantity: str) -> Array:
    """(n, k) metres from another source, less its own steps, to ``mine`` at its times."""
    other_places = places_of(other.channel, quantity)
    columns = dict(zip("xy", places_of(mine, quantity).T, strict=False))
    placed = replace(mine, columns=columns, labels={})
    gap_s = mine.gap_limit_s(_SOURCE_GAP_S)
    time_ns = other.channel.time_ns
    own = np.stack([interpolate(placed, name, time_ns, gap_s) for name in columns], axis=1)
    apart_m = own - other_places
    if quantity != HEIGHT:
        apart_m = metres(own - other_places, other_places[:, 0])
    return np.asarray(apart_m + other.stepped_m)


class _Lag(NamedTuple):
    """By how many seconds a source is behind another, and the (n,) samples that show it."""

    seconds: float
    shown_by: Mask


def _constant_lag(
    apart_m: Array, velocity: Array, known: Mask, noise_m: float, *, may_part: bool
) -> _Lag:
    """The lag that differences along the track show, the median; 0 where too few are fast.

    ``may_part`` where two sources may agree in a part of the flight only.
    """
    square_speed = np.sum(velocity**2, axis=1)
    usual_square = float(np.percentile(square_speed, 95.0))
    fast = known & (square_speed > max(_SLOWEST_M_S**2, _FAST_SHARE * usual_square))
    if np.count_nonzero(fast) < _FEWEST_FAST:
        return _Lag(0.0, known)
    lags = np.sum(apart_m * velocity, axis=1)[fast] / square_speed[fast]
    median_s = float(np.median(lags))
    scatter_m = np.median(np.abs(lags - median_s)) * np.sqrt(np.median(square_speed))
    if may_part and scatter_m > noise_m:
        return _Lag(_lag_of_a_part(lags, apart_m[fast], velocity[fast]), fast)
    return _Lag(median_s, fast)


def _lag_of_a_part(lags: Array, apart_m: Array, velocity: Array) -> float:
    """The lag [s] with which the nearest tenth of (f, k) differences is nearest.

    Tried are the median of all (f,) lags and that of each twentieth of the flight: two sources may
    agree in a part of it only.
    """

    def distance_of_nearest(lag_s: float) -> float:
        left_m = np.linalg.norm(apart_m - lag_s * velocity, axis=1)
        return float(np.percentile(left_m, 100.0 * _PART_OF_FLIGHT))

    tried = [float(np.median(lags))]
    for part in np.array_split(lags, _LAG_PARTS):
        lag_s = float(np.median(part))
        if abs(lag_s) < _LONGEST_LAG_S:
            tried.append(lag_s)
    return min(tried, key=distance_of_nearest)


def _off_usual(
    apart_m: Array, part: Rows, known: Mask, agree: Mask, noise_m: float
) -> tuple[Array, Mask]:
    """(n,) metres beyond the usual offset, and which samples that offset rests on.

    Each part has its own: heights above home have a new home after a restart.
    """
    off_m = np.full(part.size, np.nan)
    settled = np.zeros(part.size, np.bool_)
    for number in np.unique(part):
        in_part = part == number
        usable = in_part & known
        if not usable.any():
            usable = in_part & np.isfinite(apart_m).all(axis=1)
        if not usable.any():
            continue
        usable, offset_m = _usual_offset(apart_m, usable, agree, noise_m)
        off_m[in_part] = np.linalg.norm(apart_m[in_part] - offset_m, axis=1)
        settled |= usable & known
    return off_m, settled


def _usual_offset(apart_m: Array, usable: Mask, agree: Mask, noise_m: float) -> tuple[Mask, Array]:
    """The median difference of usable rows, or of those that agree if they tell another; and which.

    Those that agree count where they are a tenth or more.
    """
    offset_m = np.median(apart_m[usable], axis=0)
    agreeing = usable & agree
    if np.count_nonzero(agreeing) > _PART_OF_FLIGHT * np.count_nonzero(usable):
        usual_m = np.median(apart_m[agreeing], axis=0)
        if np.linalg.norm(usual_m - offset_m) > noise_m:
            return agreeing, usual_m
    return usable, offset_m


def moved(channel: Channel, rows: Mask, by_m: Array, height_column: str | None) -> dict[str, Array]:
    """Columns of some rows of a channel, moved by (2,) metres north and east or (1,) up."""
    if by_m.size == 1:
        height = channel[channel.height_column or "h_msl_m"][rows] + by_m[0]
        unknown = np.full(height.shape, np.nan)
        columns = dict.fromkeys(("h_msl_m", "h_ellipsoid_m", "h_home_m", "h_gnss_m"), unknown)
        columns[height_column or "h_msl_m"] = height
        return columns
    lat = channel["lat_rad"][rows]
    lon = channel["lon_rad"][rows]
    north, east = by_m / _RADIUS_M
    return {"lat_rad": lat + north, "lon_rad": lon + east / np.cos(lat)}


def height_of_pressure(barometer: Channel, height: Channel) -> Channel | None:
    """A barometer as a source of heights, by the flight's own relation of height and ln p.

    A parabola, fitted twice without outliers, or a line of standard air where the flight spans
    under 300 m. None for one that gives no heights.
    """
    column = height.height_column
    if column is None or "pressure_pa" not in barometer.columns:
        return None
    gap_s = height.gap_limit_s(_SOURCE_GAP_S)
    height_m = interpolate(height, column, barometer.time_ns, gap_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_p = np.log(barometer["pressure_pa"])
    usable = np.isfinite(height_m) & np.isfinite(log_p)
    if np.count_nonzero(usable) < _FEWEST_PRESSURES:
        return None
    of_pressure = _height_by_log_p(log_p, height_m, usable)
    usable &= _is_near(height_m, of_pressure)
    of_pressure = _height_by_log_p(log_p, height_m, usable)
    return replace(barometer, columns={"h_msl_m": of_pressure}, roles=(), labels={})


def _height_by_log_p(log_p: Array, height_m: Array, usable: Mask) -> Array:
    """(n,) heights of pressures by a parabola, or a line of standard air, through usable rows."""
    if float(np.ptp(height_m[usable])) > _SPAN_OF_PARABOLA_M:
        fit = np.polynomial.Polynomial.fit(log_p[usable], height_m[usable], 2)
        return np.asarray(fit(log_p))
    at_unit_pressure = float(np.median(height_m[usable] - _SLOPE_M * log_p[usable]))
    return at_unit_pressure + _SLOPE_M * log_p


def _is_near(height_m: Array, of_pressure: Array) -> Mask:
    """Which heights are within three sigma of those of the pressure."""
    off_m = np.abs(height_m - of_pressure)
    three_sigma_m = 3.0 * _SIGMA_OF_MEDIAN * float(np.nanmedian(off_m))
    return np.asarray(off_m < max(three_sigma_m, _LEAST_SCATTER_M))


LONGEST_COAST_S = 2.0  # a filter without a receiver for longer is no longer known to be right [s]
BESIDE_S = 10.0  # a source that replaces another agrees with it for so long before and after [s]
LONGEST_REPLACED_S = 60  # that a filter without its receiver, or a barometer, replaces one [s]
# Half the acceleration by which a filter drifts whose vertical is 0.25 degrees wrong [m/s2].
LARGEST_DRIFT_M_S2 = 0.02
_FEWEST_BESIDE = 5  # samples before and after that agree
_MOST_AGREE = 90.0  # percentile of them that is within the noise


@dataclass(frozen=True, eq=False)
class Sources:
    """The source that plays the role of a quantity, and its difference from each other one."""

    quantity: str
    own: SourcePath
    differences: tuple[Difference, ...]
    barometers: tuple[str, ...] = ()  # those compared, first the one of the role of the pressure


@dataclass(frozen=True, eq=False)
class Replacement:
    """A source that replaces a suspect one, and how far the two are apart before and after."""

    difference: Difference
    before_m: Array
    after_m: Array

    @property
    def channel(self) -> Channel:
        """That of the source which replaces."""
        return self.difference.other.channel

    @property
    def offset_m(self) -> Array:
        """The mean of the offsets before and after."""
        return 0.5 * (self.before_m + self.after_m)

    @property
    def spread_m(self) -> float:
        """Half the difference of these, and the usual difference of the two sources."""
        change_m = float(np.linalg.norm(self.after_m - self.before_m))
        return float(np.hypot(0.5 * change_m, self.difference.scatter_m))


def replacement_for(sources: Sources, stretch: Stretch) -> Replacement | None:
    """The source that replaces a suspect one where it is plain who is wrong.

    Who is wrong has steps of its own, a poor accuracy or no fix: the source itself, or, where that
    is a filter, one of several receivers. The replacement has none of these, and agrees for 10 s
    before and after. A filter or a barometer replaces a receiver for at most 60 s.
    """
    wide = replace(stretch, begin_ns=stretch.begin_ns - SECOND, end_ns=stretch.end_ns + SECOND)
    paths = [sources.own, *(each.other for each in sources.differences)]
    receivers = [path for path in paths if is_receiver(path.channel)]
    if not any(_fails(path, wide) for path in receivers):
        return None
    is_long = stretch.end_ns - stretch.begin_ns > LONGEST_REPLACED_S * SECOND
    only_receivers = is_long or not is_receiver(sources.own.channel)
    for each in sources.differences:
        if only_receivers and not is_receiver(each.other.channel):
            continue
        if _fails(each.other, wide):
            continue
        replacement = _if_agrees_beside(each, wide)
        if replacement is not None:
            return replacement
    return None


def _fails(path: SourcePath, stretch: Stretch) -> bool:
    """Whether a source is silent, steps or reports a poor accuracy in a stretch."""
    rows = stretch.covers(path.channel.time_ns)
    stamps = path.channel.time_ns[rows]
    gaps_ns = np.diff(stamps, prepend=stretch.begin_ns, append=stretch.end_ns)
    is_silent = bool(gaps_ns.max() > LONGEST_COAST_S * SECOND)
    return is_silent or not path.good[rows].all() or bool(stretch.covers(path.step_ns).any())


def _if_agrees_beside(difference: Difference, stretch: Stretch) -> Replacement | None:
    """The replacement by a source that agrees for 10 s before and after a stretch."""
    margin_ns = int(BESIDE_S * SECOND)
    before = replace(stretch, begin_ns=stretch.begin_ns - margin_ns, end_ns=stretch.begin_ns)
    after = replace(stretch, begin_ns=stretch.end_ns, end_ns=stretch.end_ns + margin_ns)
    offsets = []
    for side in (before, after):
        rows = side.covers(difference.other.channel.time_ns) & np.isfinite(difference.off_m)
        if np.count_nonzero(rows) < _FEWEST_BESIDE:
            return None
        if np.percentile(difference.off_m[rows], _MOST_AGREE) >= difference.limit_m:
            return None
        offsets.append(np.median(difference.apart_m[rows], axis=0))
    return Replacement(difference, before_m=offsets[0], after_m=offsets[1])


def drifted(own: SourcePath, replacement: Replacement, stretch: Stretch) -> list[Stretch]:
    """A filter that left its replacement without a step has a wrong vertical: a suspect attitude.

    A quarter of a degree of tilt carries a coasting filter 0.02 m/s² t² away.
    """
    difference = replacement.difference
    time_ns = replacement.channel.time_ns
    stepped = np.interp(time_ns, own.channel.time_ns, own.stepped_m.any(axis=1))
    drifts = stretch.covers(time_ns) & (stepped == 0.0)
    off_m = np.where(drifts, np.nan_to_num(difference.off_m), 0.0)
    worst = int(np.argmax(off_m))
    after_s = (int(time_ns[worst]) - stretch.begin_ns) / SECOND
    if off_m[worst] < max(difference.limit_m, LARGEST_DRIFT_M_S2 * after_s**2):
        return []
    reason = (
        f"{own.channel.name} drifts {off_m[worst]:.0f} m in {after_s:.0f} s, as with a wrong "
        "vertical"
    )
    return [replace(stretch, quantity=ATTITUDE, reason=reason, off_m=np.nan)]


def with_replaced(channel: Channel, replacement: Replacement, stretch: Stretch) -> Channel:
    """The channel with the samples of another source in a stretch, its lag and offset taken out.

    Of the offsets before and after the mean counts; half their difference and the usual difference
    of the two go into the standard deviation, with the source's own.
    """
    other = replacement.channel
    time_ns = other.time_ns - round(replacement.difference.lag_s * 1e9)
    inside = stretch.covers(time_ns)
    keep = ~stretch.covers(channel.time_ns)
    unknown = np.full(np.count_nonzero(inside), np.nan)
    fill = {name: values[inside] for name, values in other.columns.items()}
    fill |= moved(other, inside, replacement.offset_m, channel.height_column)
    sigma = sigma_column(stretch.quantity)
    own_sigma_m = np.nan_to_num(fill.get(sigma, unknown))
    fill[sigma] = np.hypot(own_sigma_m, replacement.spread_m)

    joined_ns, rows = np.unique(
        np.concatenate([channel.time_ns[keep], time_ns[inside]]), return_index=True
    )
    columns: dict[str, Array] = {}
    for name in (*channel.columns, sigma):
        both = np.concatenate([channel.get(name)[keep], fill.get(name, unknown)])
        columns[name] = both[rows]
    boot = np.concatenate([channel.boot[keep], other.boot[inside]])[rows]
    return replace(channel, time_ns=joined_ns, boot=boot, columns=columns, labels={}, rejected={})
