"""Position and attitude at an instant, never through a gap."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.rotations import lengths, quaternion_products, rotation_vectors
from unbend.geodesy import principal_radii, wrapped
from unbend.units import Array, Mask, Rows

VELOCITY = ("v_north_m_s", "v_east_m_s", "v_down_m_s")
RATES = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
RATE_LAG_S = 0.1  # gyroscopes are filtered at 20 Hz; with it 10 Hz samples gain nothing in gusts

INSIDE = 0
OUTSIDE_CHANNEL = 1
GAP_IN_CHANNEL = 2

_SLOPE_GAP_S = 0.5  # between slopes of another channel, unless that is slower
_SHORTEST_S = 1e-9  # of an interval: what is divided by is never 0
_LEAST_PARALLEL_M = 1e4  # radius; nearer to a pole no bend in longitude is added


@dataclass(frozen=True)
class _BendLimits:
    """How far slopes may differ from the straight line between samples; else they contradict it."""

    over_interval: float  # by which they may always differ, over one interval
    per_s2: float  # the acceleration that an aircraft can have

    def allowed(self, interval_s: Array) -> Array:
        """The largest difference over intervals."""
        return np.asarray(self.over_interval + self.per_s2 * interval_s**2 / 2.0)


# Twice what aircraft of survey do.
_LIMITS_M = _BendLimits(over_interval=1.0, per_s2=20.0)
_LIMITS_RAD = _BendLimits(over_interval=0.02, per_s2=20.0)


@dataclass(frozen=True, eq=False)
class Bracket:
    """Neighbouring samples of instants: (m,) rows before and after, and the fraction between."""

    before: Rows
    after: Rows
    fraction: Array
    coverage: NDArray[np.uint8]  # INSIDE, or else the rest means nothing

    def rows(self, which: Mask) -> Bracket:
        """The samples on either side of some of the instants."""
        return Bracket(
            self.before[which], self.after[which], self.fraction[which], self.coverage[which]
        )


def bracket(channel: Channel, time_ns: TimeArray, max_gap_s: float) -> Bracket:
    """The samples on either side of (m,) instants.

    A gap is an interval longer than ``max_gap_s``, or one in which the vehicle restarted. An
    instant that a sample hits is never in a gap.
    """
    stamps = channel.time_ns
    if stamps.size == 0:
        nowhere = np.zeros(time_ns.shape, np.intp)
        coverage = np.full(time_ns.shape, OUTSIDE_CHANNEL, np.uint8)
        return Bracket(nowhere, nowhere, np.zeros(time_ns.shape), coverage)
    after = np.clip(np.searchsorted(stamps, time_ns, side="left"), 0, stamps.size - 1)
    is_hit = stamps[after] == time_ns
    before = np.where(is_hit, after, np.maximum(after - 1, 0))
    interval_ns = stamps[after] - stamps[before]
    restarted = channel.boot[after] != channel.boot[before]
    is_gap = (interval_ns > max_gap_s * 1e9) | restarted
    is_outside = (time_ns < stamps[0]) | (time_ns > stamps[-1])
    fraction = (time_ns - stamps[before]) / np.maximum(interval_ns, 1)
    fraction = np.where(is_hit, 0.0, fraction)
    coverage = np.full(time_ns.shape, INSIDE, np.uint8)
    coverage[is_gap & ~is_hit] = GAP_IN_CHANNEL
    coverage[is_outside] = OUTSIDE_CHANNEL  # whatever the interval at the end of the channel is
    return Bracket(before, after, fraction, coverage)


def nearest_rows(time_ns: TimeArray, stamps: TimeArray) -> Rows:
    """(m,) rows of the stamps nearest to instants; of equally near ones the later.

    ``stamps`` are one or more, in order.

    >>> nearest_rows(np.array([1, 8, 30]), np.array([5, 10])).tolist()
    [0, 1, 1]
    """
    last_row = stamps.size - 1
    rows_after = np.searchsorted(stamps, time_ns)
    after = np.minimum(rows_after, last_row)
    before = np.maximum(rows_after - 1, 0)
    to_before = time_ns - stamps[before]
    to_after = stamps[after] - time_ns
    return np.asarray(np.where(to_before < to_after, before, after))


def ns_to_nearest(time_ns: TimeArray, stamps: TimeArray) -> TimeArray:
    """(m,) nanoseconds from instants to the nearest of stamps, one or more, which are in order.

    >>> ns_to_nearest(np.array([1, 8, 30]), np.array([5, 10])).tolist()
    [4, 2, 20]
    """
    rows = nearest_rows(time_ns, stamps)
    apart_ns = time_ns - stamps[rows]
    return np.asarray(np.abs(apart_ns))


def interpolate(channel: Channel, column: str, time_ns: TimeArray, max_gap_s: float) -> Array:
    """A column at (m,) instants, linear in time; NaN outside the channel and in its gaps."""
    if column not in channel.columns or len(channel) == 0:
        return np.full(time_ns.shape, np.nan)
    samples = bracket(channel, time_ns, max_gap_s)
    values = channel[column]
    from_before = values[samples.before] * (1.0 - samples.fraction)
    # where an instant hits a sample, an unknown value behind that does no harm
    is_between = samples.fraction > 0.0
    from_after = np.where(is_between, values[samples.after], 0.0) * samples.fraction
    return np.where(samples.coverage == INSIDE, from_before + from_after, np.nan)


@dataclass(frozen=True, eq=False)
class Track:
    """Places at instants, (m,); NaN where ``coverage`` (by `bracket`) is not INSIDE.

    ``velocity_m_s`` (m, 2) north and east, the mean between the neighbouring samples; ``sigma_m``
    (m, 2) of the interpolation alone.
    """

    lat_rad: Array
    lon_rad: Array
    velocity_m_s: Array
    sigma_m: Array
    coverage: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes at instants, (m, 4) w, x, y, z with v_ned = R(q) v_body; NaN where there is none.

    ``rate_rad_s`` (m, 3) about the body's axes, the mean between the neighbouring samples;
    ``sigma_rad`` (m, 3) of the interpolation alone; ``coverage`` by `bracket`.
    """

    quaternion: Array
    rate_rad_s: Array
    sigma_rad: Array
    coverage: NDArray[np.uint8]


def with_slopes(channel: Channel, donors: Iterable[Channel], names: tuple[str, ...]) -> Channel:
    """The channel with slopes (columns `VELOCITY` or `RATES`) of another channel of its sender.

    They are interpolated from the first of ``donors`` of the same sender that has them. A channel
    that has them itself, or finds no donor, is returned as it is.
    """
    if _has_columns(channel, names):
        return channel
    for donor in donors:
        if donor.source.system == channel.source.system and _has_columns(donor, names):
            gap_s = donor.gap_limit_s(_SLOPE_GAP_S)
            columns = dict(channel.columns)
            for name in names:
                columns[name] = interpolate(donor, name, channel.time_ns, gap_s)
            return replace(channel, columns=columns)
    return channel


def _has_columns(channel: Channel, names: tuple[str, ...]) -> bool:
    return all(name in channel.columns for name in names)


def track_at(channel: Channel, time_ns: TimeArray, max_gap_s: float) -> Track:
    """Places at (m,) instants, by a cubic through the neighbouring samples with their velocities.

    The straight part interpolates the normal vector of the ellipsoid; to it the bend of the cubic
    is added. Velocities are those logged (`VELOCITY`), else those of parabolas through three
    samples.

    Errors (rms) from samples of 1 Hz, against 10 Hz, in a simulator flight at 35 m/s with turns:

    * 0.04 m by the cubic with logged velocities,
    * 0.06 m by the cubic with those of parabolas,
    * 0.29 m along straight lines between the samples.
    """
    samples = bracket(channel, time_ns, max_gap_s)
    lat = channel["lat_rad"]
    lon = channel["lon_rad"]

    def metres(first: Rows, second: Rows) -> Array:
        north_radius_m, east_radius_m = principal_radii(lat[first])
        north_m = (lat[second] - lat[first]) * north_radius_m
        east_m = wrapped(lon[second] - lon[first]) * east_radius_m * np.cos(lat[first])
        return np.stack([north_m, east_m], axis=1)

    curve = _Curve(channel, VELOCITY[:2], metres, _LIMITS_M)
    bend_m = curve.between(samples).bend

    straight_lat, straight_lon = _along_normal_vectors(lat, lon, samples)
    meridian_m, prime_vertical_m = principal_radii(lat[samples.before])
    parallel_m = prime_vertical_m * np.cos(lat[samples.before])
    with np.errstate(invalid="ignore", divide="ignore"):
        lat_bend = bend_m[:, 0] / meridian_m
        lon_bend = np.where(parallel_m > _LEAST_PARALLEL_M, bend_m[:, 1] / parallel_m, 0.0)
    is_inside = samples.coverage == INSIDE
    return Track(
        lat_rad=np.where(is_inside, straight_lat + lat_bend, np.nan),
        lon_rad=np.where(is_inside, wrapped(straight_lon + lon_bend), np.nan),
        velocity_m_s=curve.rate(samples),
        sigma_m=curve.sigma(samples),
        coverage=samples.coverage,
    )


def _along_normal_vectors(lat: Array, lon: Array, samples: Bracket) -> tuple[Array, Array]:
    """(m,) latitude and longitude [rad] of normal vectors interpolated between samples."""

    def normals(rows: Rows) -> Array:
        x = np.cos(lat[rows]) * np.cos(lon[rows])
        y = np.cos(lat[rows]) * np.sin(lon[rows])
        return np.stack([x, y, np.sin(lat[rows])])

    from_before = normals(samples.before) * (1.0 - samples.fraction)
    from_after = normals(samples.after) * samples.fraction
    x, y, z = from_before + from_after
    return np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)


@dataclass(frozen=True, eq=False)
class HeightBend:
    """How heights differ from linear ones at instants, (m,) arrays.

    ``metres_up`` is what to add to a linear height, ``sigma_m`` that of the interpolation alone.
    """

    metres_up: Array
    speed_down_m_s: Array
    sigma_m: Array


def no_bend(count: int) -> HeightBend:
    """The bend of (count,) heights that are taken as linear, and whose speed is not known."""
    return HeightBend(np.zeros(count), np.zeros(count), np.zeros(count))


def bend_of_heights(
    channel: Channel, column: str, time_ns: TimeArray, max_gap_s: float
) -> HeightBend:
    """How heights in a column curve between samples, by the cubic of `track_at`."""
    values = channel[column]
    samples = bracket(channel, time_ns, max_gap_s)

    def metres_down(first: Rows, second: Rows) -> Array:
        return (values[first] - values[second])[:, None]

    curve = _Curve(channel, VELOCITY[2:], metres_down, _LIMITS_M)
    bend_down = curve.between(samples).bend
    return HeightBend(
        metres_up=-bend_down[:, 0],
        speed_down_m_s=curve.rate(samples)[:, 0],
        sigma_m=curve.sigma(samples)[:, 0],
    )


def attitude_at(channel: Channel, time_ns: TimeArray, max_gap_s: float) -> Attitudes:
    """Attitudes at (m,) instants, by a cubic turn through the neighbouring samples.

    Rates about the body's axes are those logged (`RATES`), else those of parabolas through three
    samples; without either the turn is the shortest (slerp). The turn phi from the sample before
    obeys d phi / dt = J_r(phi)^-1 rate (Sola et al. 2018, A micro Lie theory, Eqs. 143-144), whose
    inverse Jacobian is expanded to the second order.

    Errors (rms) between samples of 2 Hz, in the turns of a simulator flight: by the cubic 0.26 deg
    in calm air and 0.9 deg in gusts, by slerp 1.4 deg.
    """
    all_samples = bracket(channel, time_ns, max_gap_s)
    unit = _unit_quaternions(channel)
    is_known = np.asarray(np.isfinite(unit).all(axis=1))
    between_known = is_known[all_samples.before] & is_known[all_samples.after]
    usable = (all_samples.coverage == INSIDE) & between_known
    # The rows of usable instants are filled in below.
    attitudes = Attitudes(
        quaternion=np.full((time_ns.size, 4), np.nan),
        rate_rad_s=np.full((time_ns.size, 3), np.nan),
        sigma_rad=np.full((time_ns.size, 3), np.nan),
        coverage=all_samples.coverage,
    )
    if not bool(usable.any()):
        return attitudes
    samples = all_samples.rows(usable)

    def turn(first: Rows, second: Rows) -> Array:
        inverse = unit[first] * [-1.0, -1.0, -1.0, 1.0]  # x, y, z, w
        return rotation_vectors(quaternion_products(inverse, unit[second]))

    curve = _Curve(
        channel,
        RATES,
        turn,
        _LIMITS_RAD,
        RATE_LAG_S,
    )
    step, bend = curve.between(samples)
    turned = step * samples.fraction[:, None] + bend
    quaternion = quaternion_products(unit[samples.before], _quaternions_of_vectors(turned))
    canonical = np.where(quaternion[:, 3:] < 0.0, -quaternion, quaternion)
    attitudes.quaternion[usable] = canonical[:, [3, 0, 1, 2]]  # w, x, y, z
    attitudes.rate_rad_s[usable] = curve.rate(samples)
    attitudes.sigma_rad[usable] = curve.sigma(samples)
    return attitudes


def _unit_quaternions(channel: Channel) -> Array:
    """(n, 4) attitudes of a channel x, y, z, w of length 1; not finite where there is none."""
    stored = np.stack([channel[name] for name in ("q_x", "q_y", "q_z", "q_w")], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(stored / lengths(stored)[:, None])


def _quaternions_of_vectors(vectors: Array) -> Array:
    """(m, 4) unit quaternions x, y, z, w of (m, 3) rotation vectors [rad]."""
    angle = lengths(vectors)[:, None]
    half_sine_over_angle = np.sinc(angle / (2.0 * np.pi)) / 2.0
    return np.concatenate([half_sine_over_angle * vectors, np.cos(angle / 2.0)], axis=1)


class _CurvePieces(NamedTuple):
    """(m, k) steps from the sample before an instant to the one after it, and the bend at it.

    The curve at an instant is the fraction of the step, plus the bend.
    """

    step: Array
    bend: Array


@dataclass(frozen=True, eq=False)
class _Curve:
    """Cubics through neighbouring samples of a channel.

    Slopes at samples are those of columns, or of the parabola through the sample and both its
    neighbours. They contradict the samples where they differ from the straight line by more than
    ``limits`` allow.
    """

    channel: Channel
    slopes: tuple[str, ...]  # columns [per s]
    difference: Callable[[Rows, Rows], Array]  # (m, k) of the samples of two arrays of rows
    limits: _BendLimits
    lag_s: float = 0.0  # of the slopes: over shorter intervals the samples alone are better

    def _seconds(self, first: Rows, second: Rows) -> Array:
        """(m, 1) [s] between rows; NaN where the vehicle restarted."""
        one_boot = self.channel.boot[first] == self.channel.boot[second]
        apart_s = (self.channel.time_ns[second] - self.channel.time_ns[first]) * 1e-9
        return np.where(one_boot, apart_s, np.nan)[:, None]

    def rate(self, samples: Bracket) -> Array:
        """(m, k) mean slope between the samples about an instant, or beside one that it hits.

        0 where that is unknown: between two boots, and of a single sample.
        """
        last = len(self.channel) - 1
        first = np.clip(samples.before, 0, max(last - 1, 0))
        second = np.minimum(np.maximum(samples.after, first + 1), last)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.nan_to_num(self.difference(first, second) / self._seconds(first, second))

    def between(self, samples: Bracket) -> _CurvePieces:
        """The step between the samples about each instant, and the bend of the cubic at it.

        The bend is 0 where the slopes contradict the samples.
        """
        step = self.difference(samples.before, samples.after)
        interval_s = np.maximum(self._seconds(samples.before, samples.after), _SHORTEST_S)
        with np.errstate(invalid="ignore", divide="ignore"):
            begin, end = self._end_slopes(samples, step, interval_s)
            is_turn = step.shape[1] == 3  # steps of places have two components, of heights one
            if is_turn:
                end = _in_frame_of_begin(end, step)
            allowed = self.limits.allowed(interval_s[:, 0])
            is_credible = lengths(begin - step) <= allowed
            is_credible &= lengths(end - step) <= allowed
            u = samples.fraction[:, None]
            # The cubic of Hermite less its straight line.
            bend = u * (1.0 - u) * ((1.0 - u) * (begin - step) - u * (end - step))
            # Slopes that lag say less of short intervals.
            bend *= interval_s**2 / (interval_s**2 + self.lag_s**2)
        return _CurvePieces(step, np.where(is_credible[:, None], bend, 0.0))

    def _end_slopes(self, samples: Bracket, step: Array, interval_s: Array) -> tuple[Array, Array]:
        """(m, k) slopes, over the whole interval, at its begin and at its end.

        By columns where the channel has them, else by parabolas.
        """
        before = samples.before
        after = samples.after
        columns = self.channel.columns
        if all(name in columns for name in self.slopes):
            slopes = np.stack([columns[name] for name in self.slopes], axis=1)
            return slopes[before] * interval_s, slopes[after] * interval_s
        earlier = np.maximum(before - 1, 0)
        later = np.minimum(after + 1, len(self.channel) - 1)
        begin = self._parabola(step, interval_s, earlier, before)
        end = self._parabola(step, interval_s, after, later)
        return begin, end

    def _parabola(
        self,
        step: Array,
        interval_s: Array,
        first: Rows,
        second: Rows,
    ) -> Array:
        """(m, k) slope of a parabola, over the whole interval, where that meets a neighbouring one.

        The neighbouring interval lies between the rows ``first`` and ``second``. Where that is too
        long, or there is none, the slope is the step of the interval.
        """
        beside_s = self._seconds(first, second)
        step_beside = self.difference(first, second)
        slope_beside = step_beside / beside_s
        slope_inside = step / interval_s
        weighted_sum = slope_beside * interval_s + slope_inside * beside_s
        slope = weighted_sum / (interval_s + beside_s)
        is_near = (beside_s > 0.0) & (beside_s < _NEAR_INTERVALS * interval_s)
        return np.where(is_near, slope * interval_s, step)

    def sigma(self, samples: Bracket) -> Array:
        """(m, k) sigma of the curve between samples, from how well it predicts samples themselves.

        Each of the four samples about an instant is predicted from its two neighbours, over twice
        the interval; errors grow with the interval, and from the samples to the middle of it.
        """
        last = len(self.channel) - 1
        before = samples.before
        after = samples.after
        four_rows = np.stack([before - 1, before, after, after + 1])
        # The first and the last sample have no neighbours on both sides: those beside them count.
        four_rows = np.clip(four_rows, min(1, last), max(last - 1, 0))
        # Each sample is predicted once, however many instants it is near to.
        is_used = np.zeros(last + 1, np.bool_)
        is_used[four_rows] = True
        squares = self._squared_misfits(np.flatnonzero(is_used))
        number_of_row = np.cumsum(is_used) - 1
        four_numbers = number_of_row[four_rows]
        is_known = np.isfinite(squares.sum(axis=1))[:, None]
        sum_of_squares = np.where(is_known, squares, 0.0)[four_numbers].sum(axis=0)
        count = is_known[four_numbers].sum(axis=0)
        misfit = np.sqrt(sum_of_squares / np.maximum(count, 1.0))
        u = samples.fraction[:, None]
        # Half the misfit over twice the interval in the middle, nothing at the samples.
        return np.asarray(2.0 * u * (1.0 - u) * misfit)

    def _squared_misfits(self, rows: Rows) -> Array:
        """(s, k) squared differences of samples from the curve between their neighbours."""
        last = len(self.channel) - 1
        left = np.maximum(rows - 1, 0)
        right = np.minimum(rows + 1, last)
        whole_s = np.maximum(self._seconds(left, right), _SHORTEST_S)
        fraction = self._seconds(left, rows) / whole_s
        inside = np.full(rows.shape, INSIDE, np.uint8)
        step, bend = self.between(Bracket(left, right, fraction[:, 0], inside))
        predicted = step * fraction
        return np.square(self.difference(left, rows) - predicted - bend)


_NEAR_INTERVALS = 3.0  # a neighbour that is farther away, in intervals, is no part of a parabola


def _in_frame_of_begin(rate: Array, turn: Array) -> Array:
    """(m, 3) how the vector of a turn changes at its end, by the rate about the axes of the body.

    That is J_r(turn)^-1 rate, to the second order of the turn (Sola et al. 2018, Eq. 144).
    """
    across = np.cross(turn, rate)
    return np.asarray(rate + across / 2.0 + np.cross(turn, across) / 12.0)
