"""How accurate a log's positions and attitudes are, by what the log itself reports."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.interpolation import interpolate, nearest_rows, ns_to_nearest
from unbend.flight.mount import is_of_gimbal
from unbend.flight.trajectory import RATES, VELOCITY, with_slopes
from unbend.units import NANOSECONDS_PER_SECOND, Array

# An innovation whose ratio to its gate is 1 is five sigmas (EK3_POS_I_GATE 500 and its like) of
# what ArduPilot's filter takes for the noise of a measurement by default: EK3_POSNE_M_NSE,
# EK3_VELNE_M_NSE, EK3_ALT_M_NSE.
GATE_SIGMAS = 5.0
POSITION_GATE_M = GATE_SIGMAS * 0.5
VELOCITY_GATE_M_S = GATE_SIGMAS * 0.5
HEIGHT_GATE_M = GATE_SIGMAS * 3.0

# The steady state of that filter (place, velocity, tilt; EK3_ACC_P_NSE 0.35 m/s2 and EK3_GYRO_P_NSE
# 0.015 rad/s in steps of 12 ms; fixes at 5 and 10 Hz) has a sigma of the tilt of 0.23 and 0.21 deg;
# constant innovations of velocity shift its place by 1.1 and 1.3 m for each m/s; its slowest time
# constant is 3.4 and 2.9 s, and the window takes three of them on both sides of an instant.
TILT_RAD = float(np.radians(0.22))
FILTER_TIME_S = 1.3
WINDOW_NS = 10 * NANOSECONDS_PER_SECOND
ONE_SIGMA_OF_GATE = 0.2  # one of five sigmas: taken for the innovation if none is logged

# Errors that no innovation shows. Two flights of ArduPilot's simulator, each by itself and by all
# samples: 0.110 and 0.085 deg about a level axis, 0.38 and 0.33 deg about the vertical one.
LEAST_TILT_RAD = np.radians(0.1)
LEAST_YAW_RAD = np.radians(0.36)
LARGEST_DIP_TANGENT = 6.0  # of the magnetic field; nearer to a magnetic pole no compass is used

RANGE_ERROR_M = 3.0  # of a receiver without corrections; times HDOP and a factor it is a sigma
HORIZONTAL_RANGES = 0.5**0.5  # this factor for one horizontal axis
VERTICAL_RANGES = 1.5  # and for the height
DRIFT_M_S = 2.0  # of a filter without fixes
USUAL_INTERVAL_S = 1.0  # of fixes: a filter drifts only after a longer one

_REPORTS = ("sigma_h_m", "sigma_v_m", "hdop")  # columns in which a channel reports its accuracy


class PositionSigmas(NamedTuple):
    """(m,) sigmas of positions [m], of each horizontal axis and of the height."""

    horizontal_m: Array
    height_m: Array


class AttitudeSigmas(NamedTuple):
    """(m,) sigmas of attitudes [rad], about each level axis and about the vertical one."""

    tilt_rad: Array
    yaw_rad: Array


class _PositionVariances(NamedTuple):
    """(m,) variances of positions [m2], of each horizontal axis and of the height."""

    horizontal_m2: Array
    height_m2: Array


@dataclass(frozen=True, eq=False)
class LogAccuracy:
    """The channels by which a log shows the accuracy of its positions and attitudes.

    None where the log has no such channel. ``receiver`` has ``sigma_h_m`` and ``sigma_v_m``, or
    ``hdop``; so have ``spare_receivers``, which count where it is silent. ``health`` has the
    innovations of the filter over their gates, ``fused`` the heights of the filter.
    """

    receiver: Channel | None = None
    health: Channel | None = None
    fused: Channel | None = None
    spare_receivers: tuple[Channel, ...] = ()

    def positions(self, channel: Channel, time_ns: TimeArray) -> PositionSigmas:
        """(m,) sigmas of the positions of a channel at instants; NaN where unknown.

        They are those that the channel itself reports. For a filter that reports none, they combine
        those of its receiver and its own innovations.
        """
        if any(name in channel.columns for name in _REPORTS):
            variances = self._channel_variances(channel, time_ns)
        else:
            variances = self._filter_variances(time_ns)
        return PositionSigmas(
            horizontal_m=np.sqrt(variances.horizontal_m2),
            height_m=np.sqrt(variances.height_m2),
        )

    def _channel_variances(self, channel: Channel, time_ns: TimeArray) -> _PositionVariances:
        """(m,) variances that a channel reports of its own positions.

        That of the height includes its scatter about the filter's height. Where a channel other
        than ``receiver`` reports nothing, its variances are those of a filter.
        """
        reported = _reported_variances(channel, time_ns)
        horizontal_m2 = reported.horizontal_m2
        about_fused_m2 = self._variance_about_fused(channel, time_ns)
        height_m2 = reported.height_m2 + about_fused_m2
        has_no_horizontal = ~np.isfinite(horizontal_m2)
        has_no_height = ~np.isfinite(height_m2)
        has_other_receiver = self.receiver is not None and channel is not self.receiver
        if has_other_receiver and (has_no_horizontal | has_no_height).any():
            of_filter = self._filter_variances(time_ns)
            horizontal_m2 = np.where(has_no_horizontal, of_filter.horizontal_m2, horizontal_m2)
            height_m2 = np.where(has_no_height, of_filter.height_m2, height_m2)
        return _PositionVariances(horizontal_m2, height_m2)

    def _filter_variances(self, time_ns: TimeArray) -> _PositionVariances:
        """(m,) variances of a filter's positions: those of its receiver plus those by innovations.

        NaN without a receiver.
        """
        if self.receiver is None:
            unknown = np.full(time_ns.shape, np.nan)
            return _PositionVariances(unknown, unknown)
        receivers = (self.receiver, *self.spare_receivers)
        of_receivers = _variances_of_receivers(receivers, time_ns)
        gates_of_position = self.innovation("position", time_ns)
        gates_of_velocity = self.innovation("velocity", time_ns)
        gates_of_height = self.innovation("height", time_ns)
        by_position_m = POSITION_GATE_M * gates_of_position
        by_velocity_m = VELOCITY_GATE_M_S * FILTER_TIME_S * gates_of_velocity
        by_height_m = HEIGHT_GATE_M * gates_of_height
        horizontal_m2 = of_receivers.horizontal_m2 + np.square(by_position_m)
        horizontal_m2 = horizontal_m2 + np.square(by_velocity_m)
        height_m2 = of_receivers.height_m2 + np.square(by_height_m)
        return _PositionVariances(horizontal_m2, height_m2)

    def _variance_about_fused(self, channel: Channel, time_ns: TimeArray) -> Array:
        """(m,) variances [m2] of a channel's heights about those of the filter, near instants.

        The heights of the filter are smooth, as they drift slowly. 0 without heights of a filter.
        """
        name = channel.height_column
        if self.fused is None or name is None or name not in self.fused.columns:
            return np.zeros(time_ns.shape)
        gap_s = self.fused.gap_limit_s()
        fused_m = interpolate(self.fused, name, channel.time_ns, gap_s)
        apart_m = channel[name] - fused_m
        scatter = _scatter_about(channel.time_ns, apart_m, time_ns)
        return np.square(scatter.deviation)

    def attitude(
        self,
        channel: Channel,
        time_ns: TimeArray,
        lat_rad: Array,
    ) -> AttitudeSigmas:
        """(m,) sigmas of the attitudes of a channel at instants and latitudes.

        They are those that the channel itself reports; else those of a filter:

        * The tilt grows with the innovations of velocity, as the sigma of unit weight does.
        * The yaw has in addition, from the compass, the tilt times the tangent of the field's dip:
          2 tan(latitude), that of a dipole along the earth's axis.
        """
        if "sigma_tilt_rad" in channel.columns and "sigma_yaw_rad" in channel.columns:
            gap_s = channel.gap_limit_s()
            tilt = interpolate(channel, "sigma_tilt_rad", time_ns, gap_s)
            yaw = interpolate(channel, "sigma_yaw_rad", time_ns, gap_s)
            return AttitudeSigmas(tilt, yaw)
        gates = np.full(time_ns.shape, ONE_SIGMA_OF_GATE)
        if self.health is not None:
            gates = self.innovation("velocity", time_ns)
        tilt = np.hypot(LEAST_TILT_RAD, GATE_SIGMAS * TILT_RAD * gates)
        latitude = np.abs(np.nan_to_num(lat_rad))
        dipole = 2.0 * np.tan(latitude)
        dip = np.clip(dipole, 0.0, LARGEST_DIP_TANGENT)
        yaw = np.hypot(LEAST_YAW_RAD, dip * tilt)
        return AttitudeSigmas(tilt, yaw)

    def innovation(self, kind: str, time_ns: TimeArray) -> Array:
        """(m,) rms, near instants, of an innovation over its gate; 0 if it is not logged.

        ``kind`` : position, velocity or height.
        """
        column = f"innovation_{kind}"
        if self.health is None or column not in self.health.columns:
            return np.zeros(time_ns.shape)
        scatter = _scatter_about(self.health.time_ns, self.health[column], time_ns)
        return np.hypot(scatter.mean, scatter.deviation)


def _reported_variances(source: Channel, time_ns: TimeArray) -> _PositionVariances:
    """(m,) variances by the report of the sample nearest to each instant.

    They grow by a drift with the time beyond `USUAL_INTERVAL_S` from that sample.
    """
    row = nearest_rows(time_ns, source.time_ns)
    away_s = _seconds_to_nearest(source, time_ns)
    drifts_s = np.maximum(away_s - USUAL_INTERVAL_S, 0.0)
    drift_m2 = np.square(DRIFT_M_S * drifts_s)
    horizontal_m = _reported_sigma(source, "sigma_h_m", HORIZONTAL_RANGES)
    height_m = _reported_sigma(source, "sigma_v_m", VERTICAL_RANGES)
    return _PositionVariances(
        np.square(horizontal_m[row]) + drift_m2,
        np.square(height_m[row]) + drift_m2,
    )


def _variances_of_receivers(
    receivers: tuple[Channel, ...], time_ns: TimeArray
) -> _PositionVariances:
    """(m,) variances reported by the first receiver or, where it is silent, the nearest in time."""
    first = receivers[0]
    variances = _reported_variances(first, time_ns)
    away_s = _seconds_to_nearest(first, time_ns)
    for receiver in receivers[1:]:
        other_away_s = _seconds_to_nearest(receiver, time_ns)
        is_nearer = (away_s > USUAL_INTERVAL_S) & (other_away_s < away_s)
        other = _reported_variances(receiver, time_ns)
        horizontal_m2 = np.where(is_nearer, other.horizontal_m2, variances.horizontal_m2)
        height_m2 = np.where(is_nearer, other.height_m2, variances.height_m2)
        variances = _PositionVariances(horizontal_m2, height_m2)
        away_s = np.where(is_nearer, other_away_s, away_s)
    return variances


def _seconds_to_nearest(source: Channel, time_ns: TimeArray) -> Array:
    """(m,) seconds from instants to the nearest sample of a channel."""
    return np.asarray(ns_to_nearest(time_ns, source.time_ns) * 1e-9)


def _reported_sigma(source: Channel, column: str, ranges_per_hdop: float) -> Array:
    """(n,) sigmas [m] that a source reports in a column; where unknown, those by its HDOP.

    ``ranges_per_hdop`` : sigma over range error for an HDOP of 1.
    """
    metres_per_hdop = ranges_per_hdop * RANGE_ERROR_M
    by_hdop = metres_per_hdop * source.get("hdop")
    sigma = source.get(column)
    is_known = np.isfinite(sigma)
    return np.where(is_known, sigma, by_hdop)


class _Scatter(NamedTuple):
    """(m,) means and standard deviations of values near instants."""

    mean: Array
    deviation: Array


def _scatter_about(stamps: TimeArray, values: Array, time_ns: TimeArray) -> _Scatter:
    """Mean and standard deviation of the finite values within `WINDOW_NS` of each of (m,) instants.

    ``stamps`` (n,) : times of the ``values`` (n,), in rising order. Both are 0 without a value.
    """
    is_known = np.isfinite(values)
    known_ns = stamps[is_known]
    known_values = values[is_known]
    middle = 0.0
    if known_values.size:
        middle = float(np.median(known_values))
    departures = known_values - middle  # so that squares do not cancel
    first = np.searchsorted(known_ns, time_ns - WINDOW_NS)
    end = np.searchsorted(known_ns, time_ns + WINDOW_NS, side="right")
    count = np.maximum(end - first, 1)
    sums = np.append(0.0, np.cumsum(departures))
    square_sums = np.append(0.0, np.cumsum(departures**2))
    mean_departure = (sums[end] - sums[first]) / count
    mean_square = (square_sums[end] - square_sums[first]) / count
    variance = mean_square - mean_departure**2
    has_values = end > first
    return _Scatter(
        mean=np.where(has_values, middle + mean_departure, 0.0),
        deviation=np.sqrt(np.maximum(variance, 0.0)),
    )


def with_accuracy(
    roles: Mapping[str, Channel], channels: Iterable[Channel]
) -> tuple[dict[str, Channel], LogAccuracy]:
    """Add velocities and body rates to the channels of roles; returns them and the log's accuracy.

    A channel without velocities or rates gets those of another channel of the same sender
    (MAVLink's system). The attitude of a gimbal gets none, because the body rates of its sender are
    those of the aircraft. The accuracy is by the channels of the sender of the position.
    """
    by_rank = sorted(channels, key=lambda channel: (channel.rank, channel.name))
    result = dict(roles)
    for role in ("position", "height", "attitude", "aircraft_attitude"):
        channel = roles.get(role)
        if channel is not None and not is_of_gimbal(channel.source.message):
            slopes = RATES if "attitude" in role else VELOCITY
            result[role] = with_slopes(channel, by_rank, slopes)
    system = None
    if "position" in roles:
        system = roles["position"].source.system
    channels_of_sender: list[Channel] = []
    for channel in by_rank:
        if channel.source.system == system and len(channel):
            channels_of_sender.append(channel)
    return result, _accuracy_of_sender(channels_of_sender)


def _accuracy_of_sender(channels: list[Channel]) -> LogAccuracy:
    """The receivers, health and fused heights in the channels of one sender, best rank first."""

    def first(fits: Callable[[Channel], bool]) -> Channel | None:
        """The best channel that fits."""
        fitting = filter(fits, channels)
        return next(fitting, None)

    def is_receiver_with_accuracy(channel: Channel) -> bool:
        """Whether a channel is a receiver that reports its accuracy."""
        columns = channel.columns
        return "height" in channel.roles and ("sigma_h_m" in columns or "hdop" in columns)

    def has_innovations(channel: Channel) -> bool:
        """Whether a channel is the health of a filter."""
        columns = channel.columns
        return "innovation_position" in columns and "innovation_velocity" in columns

    def has_fused_heights(channel: Channel) -> bool:
        """Whether a channel is of a filter: its height is not measured, and not offered as role."""
        return "position" in channel.roles and "height" not in channel.roles

    receivers = [channel for channel in channels if is_receiver_with_accuracy(channel)]
    return LogAccuracy(
        receiver=receivers[0] if receivers else None,
        health=first(has_innovations),
        fused=first(has_fused_heights),
        spare_receivers=tuple(receivers[1:]),
    )
