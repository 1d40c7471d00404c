"""Position and attitude interpolated at an instant, but not over gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.interpolation import INSIDE, Bracket, bracket, interpolate
from unbend.flight.rotations import lengths, quaternion_products, rotation_vectors
from unbend.geodesy import principal_radii, wrapped
from unbend.units import Array, Rows

VELOCITY = ("v_north_m_s", "v_east_m_s", "v_down_m_s")
RATES = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
RATE_LAG_S = 0.1  # gyroscopes are filtered at 20 Hz; with it 10 Hz samples gain nothing in gusts

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])  # signs of the inverse of a rotation x, y, z, w
_SLOPE_GAP_S = 0.5  # the largest between slopes of another channel, unless that is slower
_SHORTEST_S = 1e-9  # the least length of an interval, so that nothing is divided by 0
_LEAST_PARALLEL_M = 1e4  # radius; nearer to a pole no bend in longitude is added


@dataclass(frozen=True)
class _BendLimits:
    """How much slope times interval may differ from the step; beyond that slopes are not used."""

    constant: float  # [m] or [rad]
    acceleration: float  # that an aircraft can have [m/s2] or [rad/s2]

    def allowed(self, interval_s: Array) -> Array:
        """The largest difference over intervals [s]."""
        by_acceleration = self.acceleration * interval_s**2 / 2.0
        return np.asarray(self.constant + by_acceleration)


# Twice what survey aircraft do.
_LIMITS_M = _BendLimits(constant=1.0, acceleration=20.0)
_LIMITS_RAD = _BendLimits(constant=0.02, acceleration=20.0)


@dataclass(frozen=True, eq=False)
class Track:
    """Places at (m,) instants; NaN where ``coverage`` (as in `Bracket`) is not INSIDE.

    ``velocity_m_s`` (m, 2) north and east, the mean between the neighbouring samples; ``sigma_m``
    (m, 2) north and east, of the interpolation alone.
    """

    lat_rad: Array
    lon_rad: Array
    velocity_m_s: Array
    sigma_m: Array
    coverage: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes at (m,) instants, w, x, y, z with v_ned = R(q) v_body; NaN where unknown.

    ``rate_rad_s`` (m, 3) about the body's axes, the mean between the neighbouring samples;
    ``sigma_rad`` (m, 3) of the interpolation alone; ``coverage`` as in `Bracket`.
    """

    quaternion: Array
    rate_rad_s: Array
    sigma_rad: Array
    coverage: NDArray[np.uint8]


def with_slopes(
    channel: Channel,
    donors: Iterable[Channel],
    names: tuple[str, ...],
) -> Channel:
    """Add columns of slopes (``names``: `VELOCITY` or `RATES`) from another channel.

    They are interpolated from the first of ``donors`` that has them and is of the same MAVLink
    system. A channel that has them itself, or finds no donor, is returned unchanged.
    """
    if _has_columns(channel, names):
        return channel
    for donor in donors:
        has_same_sender = donor.source.system == channel.source.system
        if has_same_sender and _has_columns(donor, names):
            gap_s = donor.gap_limit_s(_SLOPE_GAP_S)
            columns = dict(channel.columns)
            for name in names:
                columns[name] = interpolate(donor, name, channel.time_ns, gap_s)
            return replace(channel, columns=columns)
    return channel


def _has_columns(channel: Channel, names: tuple[str, ...]) -> bool:
    """Whether a channel has all of these columns."""
    return all(name in channel.columns for name in names)


def track_at(channel: Channel, time_ns: TimeArray, max_gap_s: float) -> Track:
    """Places at (m,) instants, by a cubic through the neighbouring samples with their velocities.

    The straight part interpolates the normal vector of the ellipsoid; the bend of the cubic is
    added to it. Velocities are those logged (`VELOCITY`), else those of parabolas through three
    samples.

    Errors (rms) from samples of 1 Hz, against 10 Hz, in a simulator flight at 35 m/s with turns:

    * 0.04 m by the cubic with logged velocities,
    * 0.06 m by the cubic with those of parabolas,
    * 0.29 m along straight lines between the samples.
    """
    samples = bracket(channel, time_ns, max_gap_s)
    lat = channel["lat_rad"]
    lon = channel["lon_rad"]

    def north_east_m(first: Rows, second: Rows) -> Array:
        """(m, 2) metres from samples to other samples of the channel."""
        meridian_m, prime_vertical_m = principal_radii(lat[first])
        north_rad = lat[second] - lat[first]
        east_rad = wrapped(lon[second] - lon[first])
        north_m = north_rad * meridian_m
        east_m = east_rad * prime_vertical_m * np.cos(lat[first])
        return np.stack([north_m, east_m], axis=1)

    curve = _Curve(channel, VELOCITY[:2], north_east_m, _LIMITS_M)
    bend_m = curve.between(samples).bend

    straight_lat, straight_lon = _along_normal_vectors(lat, lon, samples)
    lat_bend, lon_bend = _bend_in_radians(bend_m, lat[samples.before])
    bent_lat = straight_lat + lat_bend
    bent_lon = wrapped(straight_lon + lon_bend)
    is_inside = samples.coverage == INSIDE
    return Track(
        lat_rad=np.where(is_inside, bent_lat, np.nan),
        lon_rad=np.where(is_inside, bent_lon, np.nan),
        velocity_m_s=curve.rate(samples),
        sigma_m=curve.sigma(samples),
        coverage=samples.coverage,
    )


def _bend_in_radians(bend_m: Array, lat_rad: Array) -> tuple[Array, Array]:
    """(m,) changes of latitude and of longitude [rad] by (m, 2) metres north and east.

    Near a pole the change of longitude is 0.
    """
    meridian_m, prime_vertical_m = principal_radii(lat_rad)
    parallel_m = prime_vertical_m * np.cos(lat_rad)
    is_off_pole = parallel_m > _LEAST_PARALLEL_M
    with np.errstate(invalid="ignore", divide="ignore"):
        lat_bend = bend_m[:, 0] / meridian_m
        lon_bend = bend_m[:, 1] / parallel_m
    return lat_bend, np.where(is_off_pole, lon_bend, 0.0)


def _along_normal_vectors(
    lat: Array,
    lon: Array,
    samples: Bracket,
) -> tuple[Array, Array]:
    """(m,) latitudes and longitudes [rad] of normal vectors interpolated between samples.

    ``lat``, ``lon``: (n,) [rad] of all samples of the channel.
    """

    def normals(rows: Rows) -> Array:
        """(3, m) normal vectors of the ellipsoid at samples."""
        equatorial = np.cos(lat[rows])
        x = equatorial * np.cos(lon[rows])
        y = equatorial * np.sin(lon[rows])
        z = np.sin(lat[rows])
        return np.stack([x, y, z])

    from_before = normals(samples.before) * (1.0 - samples.fraction)
    from_after = normals(samples.after) * samples.fraction
    x, y, z = from_before + from_after
    latitude = np.arctan2(z, np.hypot(x, y))
    longitude = np.arctan2(y, x)
    return latitude, longitude


@dataclass(frozen=True, eq=False)
class HeightBend:
    """How heights at (m,) instants differ from heights interpolated linearly.

    ``metres_up`` is to be added to the linear height; ``sigma_m`` is of the interpolation alone.
    """

    metres_up: Array
    speed_down_m_s: Array
    sigma_m: Array


def no_bend(count: int) -> HeightBend:
    """No correction of ``count`` linear heights; their unknown speed and sigma are taken as 0."""
    return HeightBend(
        metres_up=np.zeros(count),
        speed_down_m_s=np.zeros(count),
        sigma_m=np.zeros(count),
    )


def bend_of_heights(
    channel: Channel, column: str, time_ns: TimeArray, max_gap_s: float
) -> HeightBend:
    """How the heights in a column bend between samples, by the cubic of `track_at`."""
    values = channel[column]
    samples = bracket(channel, time_ns, max_gap_s)

    def metres_down(first: Rows, second: Rows) -> Array:
        down_m = values[first] - values[second]
        return down_m[:, None]

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
    obeys d phi / dt = J_r(phi)^-1 rate (Sola et al. 2018, A micro Lie theory, Eqs. 143-144); the
    inverse Jacobian is expanded to the second order.

    Errors (rms) between samples of 2 Hz, in the turns of a simulator flight: by the cubic 0.26 deg
    in calm air and 0.9 deg in gusts, by slerp 1.4 deg.
    """
    bracket_of_all = bracket(channel, time_ns, max_gap_s)
    unit = _unit_quaternions(channel)
    is_known = np.asarray(np.isfinite(unit).all(axis=1))
    between_known = is_known[bracket_of_all.before] & is_known[bracket_of_all.after]
    is_inside = bracket_of_all.coverage == INSIDE
    usable = is_inside & between_known
    # The rows of usable instants are filled in below.
    instants = time_ns.size
    attitudes = Attitudes(
        quaternion=np.full((instants, 4), np.nan),
        rate_rad_s=np.full((instants, 3), np.nan),
        sigma_rad=np.full((instants, 3), np.nan),
        coverage=bracket_of_all.coverage,
    )
    if not bool(usable.any()):
        return attitudes
    samples = bracket_of_all.rows(usable)

    def turn(first: Rows, second: Rows) -> Array:
        """(m, 3) rotation vectors [rad], in body axes, from samples to other samples."""
        inverse = unit[first] * _CONJUGATE
        from_first = quaternion_products(inverse, unit[second])
        return rotation_vectors(from_first)

    curve = _Curve(
        channel,
        RATES,
        turn,
        _LIMITS_RAD,
        RATE_LAG_S,
    )
    step, bend = curve.between(samples)
    turned = step * samples.fraction[:, None] + bend
    turn_from_before = _quaternions_of_vectors(turned)
    quaternion = quaternion_products(unit[samples.before], turn_from_before)
    attitudes.quaternion[usable] = _canonical(quaternion)
    attitudes.rate_rad_s[usable] = curve.rate(samples)
    attitudes.sigma_rad[usable] = curve.sigma(samples)
    return attitudes


def _canonical(quaternion: Array) -> Array:
    """(m, 4) quaternions w, x, y, z with w >= 0, from quaternions x, y, z, w."""
    has_negative_w = quaternion[:, 3:] < 0.0
    canonical = np.where(has_negative_w, -quaternion, quaternion)
    return canonical[:, [3, 0, 1, 2]]


def _unit_quaternions(channel: Channel) -> Array:
    """(n, 4) attitudes of a channel, x, y, z, w of length 1; NaN or inf where unknown or zero."""
    components = [
        channel["q_x"],
        channel["q_y"],
        channel["q_z"],
        channel["q_w"],
    ]
    stored = np.stack(components, axis=1)
    length = lengths(stored)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(stored / length)


def _quaternions_of_vectors(vectors: Array) -> Array:
    """(m, 4) unit quaternions x, y, z, w of (m, 3) rotation vectors [rad]."""
    angle = lengths(vectors)[:, None]
    half_sine_over_angle = np.sinc(angle / (2.0 * np.pi)) / 2.0
    vector_part = half_sine_over_angle * vectors
    scalar_part = np.cos(angle / 2.0)
    return np.concatenate([vector_part, scalar_part], axis=1)


class _CurvePieces(NamedTuple):
    """The two parts of a curve at (m,) instants; (m, k) of k components.

    ``step``: from the sample before an instant to the sample after it. From the sample before to
    the instant the curve goes ``fraction`` times the step, plus the ``bend``.
    """

    step: Array
    bend: Array


@dataclass(frozen=True, eq=False)
class _Curve:
    """Cubics through the samples of a channel: places (k = 2), heights (1) or attitudes (3).

    Slopes at samples are those of columns, or of the parabola through the sample and both its
    neighbours. They are not used where they differ from the straight line by more than ``limits``.
    """

    channel: Channel
    slopes: tuple[str, ...]  # names of k columns [per s]; used if the channel has them
    difference: Callable[[Rows, Rows], Array]  # (m, k) from samples in rows to those in others
    limits: _BendLimits
    lag_s: float = 0.0  # of the slopes: over shorter intervals they are hardly used

    def _seconds(self, first: Rows, second: Rows) -> Array:
        """(m, 1) seconds from rows to other rows; NaN where the vehicle restarted between them."""
        boot = self.channel.boot
        stamps = self.channel.time_ns
        is_same_boot = boot[first] == boot[second]
        apart_s = (stamps[second] - stamps[first]) * 1e-9
        seconds = np.where(is_same_boot, apart_s, np.nan)
        return seconds[:, None]

    def rate(self, samples: Bracket) -> Array:
        """(m, k) mean slope [per s] between the samples before and after an instant.

        At the time of a sample that to the next sample, or from the last but one to the last. 0
        where it is unknown: between two boots, and with a single sample.
        """
        last = len(self.channel) - 1
        last_but_one = max(last - 1, 0)
        first = np.clip(samples.before, 0, last_but_one)
        second = np.maximum(samples.after, first + 1)
        second = np.minimum(second, last)
        with np.errstate(invalid="ignore", divide="ignore"):
            difference = self.difference(first, second)
            slope = difference / self._seconds(first, second)
        return np.nan_to_num(slope)

    def between(self, samples: Bracket) -> _CurvePieces:
        """The step of the curve about each instant, and its bend; 0 where slopes are not used."""
        step = self.difference(samples.before, samples.after)
        apart_s = self._seconds(samples.before, samples.after)
        interval_s = np.maximum(apart_s, _SHORTEST_S)
        with np.errstate(invalid="ignore", divide="ignore"):
            begin, end = self._end_slopes(samples, step, interval_s)
            is_turn = step.shape[1] == 3  # steps of places have two components, of heights one
            if is_turn:
                end = _in_frame_of_begin(end, step)
            begin_beyond = begin - step
            end_beyond = end - step
            allowed = self.limits.allowed(interval_s[:, 0])
            is_credible = lengths(begin_beyond) <= allowed
            is_credible &= lengths(end_beyond) <= allowed
            u = samples.fraction[:, None]
            # Hermite's cubic minus its straight line.
            departure = (1.0 - u) * begin_beyond - u * end_beyond
            bend = u * (1.0 - u) * departure
            # Slopes that lag describe short intervals less well.
            square_s2 = interval_s**2
            bend *= square_s2 / (square_s2 + self.lag_s**2)
        credible_bend = np.where(is_credible[:, None], bend, 0.0)
        return _CurvePieces(step, credible_bend)

    def _end_slopes(
        self,
        samples: Bracket,
        step: Array,
        interval_s: Array,
    ) -> tuple[Array, Array]:
        """(m, k) slopes at the begin and at the end of each interval, times its length."""
        before = samples.before
        after = samples.after
        if _has_columns(self.channel, self.slopes):
            columns = [self.channel[name] for name in self.slopes]
            slopes = np.stack(columns, axis=1)
            return slopes[before] * interval_s, slopes[after] * interval_s
        last = len(self.channel) - 1
        earlier = np.maximum(before - 1, 0)
        later = np.minimum(after + 1, last)
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
        """(m, k) slopes of parabolas where intervals meet a neighbouring one, times their length.

        The neighbouring interval is from row ``first`` to row ``second``. If it is too long, or
        there is none, the result is the ``step`` of the interval itself.
        """
        neighbour_s = self._seconds(first, second)
        neighbour_step = self.difference(first, second)
        neighbour_slope = neighbour_step / neighbour_s
        own_slope = step / interval_s
        # At the middle one of three samples; the shorter interval weighs more.
        weighted_sum = neighbour_slope * interval_s + own_slope * neighbour_s
        slope = weighted_sum / (interval_s + neighbour_s)
        longest_s = _NEAR_INTERVALS * interval_s
        is_near = (neighbour_s > 0.0) & (neighbour_s < longest_s)
        return np.where(is_near, slope * interval_s, step)

    def sigma(self, samples: Bracket) -> Array:
        """(m, k) sigma of the curve at instants, from how well such curves predict samples.

        Each of the four samples about an instant is predicted from its two neighbours, over twice
        the usual interval. Errors grow with the interval, and from its ends to its middle.
        """
        four_rows = self._four_rows(samples)
        # Each sample is predicted once, however many instants it is near to.
        is_used = np.zeros(len(self.channel), np.bool_)
        is_used[four_rows] = True
        squares = self._squared_misfits(np.flatnonzero(is_used))
        place_in_squares = np.cumsum(is_used) - 1  # of each row that is used
        four_places = place_in_squares[four_rows]
        sums = squares.sum(axis=1)
        is_known = np.isfinite(sums)[:, None]
        known_squares = np.where(is_known, squares, 0.0)
        sum_of_squares = known_squares[four_places].sum(axis=0)
        count = is_known[four_places].sum(axis=0)
        mean_square = sum_of_squares / np.maximum(count, 1.0)
        misfit = np.sqrt(mean_square)
        u = samples.fraction[:, None]
        # Half the misfit over twice the interval in the middle, nothing at the samples.
        return np.asarray(2.0 * u * (1.0 - u) * misfit)

    def _four_rows(self, samples: Bracket) -> Rows:
        """(4, m) rows of the samples about each instant with misfits that give the sigma there.

        They are the two before it and the two after it. A misfit needs a neighbour on both sides:
        the second sample stands in for the first, and the last but one for the last.
        """
        last = len(self.channel) - 1
        before = samples.before
        after = samples.after
        four_rows = np.stack([before - 1, before, after, after + 1])
        first_inner = min(1, last)
        last_inner = max(last - 1, 0)
        return np.clip(four_rows, first_inner, last_inner)

    def _squared_misfits(self, rows: Rows) -> Array:
        """(s, k) squared distances of samples in (s,) rows from the curve between their neighbours.

        The first and the last sample are their own neighbour on the side where they have none.
        """
        last = len(self.channel) - 1
        left = np.maximum(rows - 1, 0)
        right = np.minimum(rows + 1, last)
        whole_s = np.maximum(self._seconds(left, right), _SHORTEST_S)
        fraction = self._seconds(left, rows) / whole_s
        neighbours = Bracket(
            before=left,
            after=right,
            fraction=fraction[:, 0],
            coverage=np.full(rows.shape, INSIDE, np.uint8),
        )
        step, bend = self.between(neighbours)
        straight_part = step * fraction
        measured = self.difference(left, rows)
        return np.square(measured - straight_part - bend)


_NEAR_INTERVALS = 3.0  # a neighbouring interval longer than so many own ones gives no parabola


def _in_frame_of_begin(rate: Array, turn: Array) -> Array:
    """(m, 3) rate of change of a rotation vector ``turn``, from the body's ``rate`` at its end.

    That is J_r(turn)^-1 rate, to the second order of the turn (Sola et al. 2018, Eq. 144). Both are
    (m, 3), and ``rate`` is about the body's axes as they are after the turn.
    """
    across = np.cross(turn, rate)
    across_twice = np.cross(turn, across)
    return np.asarray(rate + across / 2.0 + across_twice / 12.0)
