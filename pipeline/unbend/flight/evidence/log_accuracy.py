"""How accurate a log's positions and attitudes are, by what the log itself reports."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.mount import is_of_gimbal
from unbend.flight.trajectory import RATES, VELOCITY, interpolate, with_slopes
from unbend.units import NANOSECONDS_PER_SECOND, Array, Rows

# An innovation whose ratio to its gate is 1 is five sigmas (EK3_POS_I_GATE 500 and its like) of
# what ArduPilot's filter takes for the noise of a measurement by default: EK3_POSNE_M_NSE,
# EK3_VELNE_M_NSE, EK3_ALT_M_NSE.
GATE_SIGMAS = 5.0
POSITION_GATE_M = GATE_SIGMAS * 0.5
VELOCITY_GATE_M_S = GATE_SIGMAS * 0.5
HEIGHT_GATE_M = GATE_SIGMAS * 3.0

# The steady state of that filter (place, velocity, tilt; EK3_ACC_P_NSE 0.35 m/s2 and EK3_GYRO_P_NSE
# 0.015 rad/s in steps of 12 ms; fixes at 5 and 10 Hz) has 0.23 and 0.21 deg of tilt; innovations of
# velocity that last shift its place by 1.1 and 1.3 m for each m/s; its slowest pole forgets in 3.4
# and 2.9 s, of which the window takes three on both sides of an instant.
TILT_RAD = float(np.radians(0.22))
FILTER_TIME_S = 1.3
WINDOW_NS = 10 * NANOSECONDS_PER_SECOND
ONE_SIGMA_OF_GATE = 0.2  # taken for the innovation where none is logged

# What no innovation shows. Two flights of ArduPilot's simulator, each by itself and by all samples:
# 0.110 and 0.085 deg about a level axis, 0.38 and 0.33 deg about the vertical one.
LEAST_TILT_RAD = np.radians(0.1)
LEAST_YAW_RAD = np.radians(0.36)
STEEPEST_DIP = 6.0  # tangent; nearer to a magnetic pole no compass is used

RANGE_ERROR_M = 3.0  # of a receiver without corrections, which its HDOP multiplies
HORIZONTAL_RANGES = 0.5**0.5  # range errors for each HDOP, of one horizontal axis
VERTICAL_RANGES = 1.5
DRIFT_M_S = 2.0  # of a filter without fixes
USUAL_INTERVAL_S = 1.0  # of fixes: a filter drifts only after a longer one

_REPORTS = ("sigma_h_m", "sigma_v_m", "hdop")  # what a channel says of its own accuracy


@dataclass(frozen=True, eq=False)
class LogAccuracy:
    """What a log says about the accuracy of its positions and attitudes; None where nothing.

    ``receiver`` has ``sigma_h_m`` and ``sigma_v_m``, or ``hdop``; ``health`` the innovations of the
    filter over their gates; ``fused`` the heights of the filter.
    """

    receiver: Channel | None = None
    health: Channel | None = None
    fused: Channel | None = None

    def positions(self, channel: Channel, time_ns: TimeArray) -> tuple[Array, Array]:
        """(m,) sigmas of positions of a channel, per horizontal axis and of heights [m].

        What the channel itself reports; in height with the scatter about that of the filter, which
        drifts slowly. A filter that reports nothing has the sigmas of its receiver and its own
        innovations; where fixes are more than 1 s apart, it drifts away from the last.
        """
        reports_itself = any(name in channel.columns for name in _REPORTS)
        source = channel if reports_itself else self.receiver
        if source is None:
            unknown = np.full(time_ns.shape, np.nan)
            return unknown, unknown
        horizontal, vertical = _reported_variances(source, time_ns)
        if not reports_itself:
            of_position = POSITION_GATE_M * self.innovation("position", time_ns)
            of_velocity = VELOCITY_GATE_M_S * FILTER_TIME_S * self.innovation("velocity", time_ns)
            of_height = HEIGHT_GATE_M * self.innovation("height", time_ns)
            horizontal = horizontal + np.square(of_position) + np.square(of_velocity)
            vertical = vertical + np.square(of_height)
        else:
            vertical = vertical + self._variance_about_fused(channel, time_ns)
        silent = ~np.isfinite(horizontal)
        is_receiver = self.receiver is None or channel is self.receiver
        if reports_itself and not is_receiver and silent.any():  # for a part of the time only
            columns = {k: v for k, v in channel.columns.items() if k not in _REPORTS}
            sigma_h, sigma_v = self.positions(replace(channel, columns=columns), time_ns)
            horizontal = np.where(silent, np.square(sigma_h), horizontal)
            vertical = np.where(silent, np.square(sigma_v), vertical)
        return np.sqrt(horizontal), np.sqrt(vertical)

    def _variance_about_fused(self, channel: Channel, time_ns: TimeArray) -> Array:
        """(m,) scatter of a channel's heights about those of the filter, which drifts slowly."""
        name = channel.height_column
        if self.fused is None or name is None or name not in self.fused.columns:
            return np.zeros(time_ns.shape)
        gap_s = self.fused.gap_limit_s()
        apart = channel[name] - interpolate(self.fused, name, channel.time_ns, gap_s)
        _, deviation = _about(channel.time_ns, apart, time_ns)
        return np.square(deviation)

    def attitude(self, channel: Channel, time_ns: TimeArray, lat_rad: Array) -> tuple[Array, Array]:
        """(m,) sigmas of attitudes of a channel about a level and the vertical axis [rad].

        What the channel itself reports. Else the tilt of a filter grows with its innovations of
        velocity, as the sigma of unit weight does, and a compass shows it times the tangent of the
        field's dip (that of a dipole along the earth's axis, 2 tan(latitude)) as yaw.
        """
        if "sigma_tilt_rad" in channel.columns and "sigma_yaw_rad" in channel.columns:
            gap_s = channel.gap_limit_s()
            tilt = interpolate(channel, "sigma_tilt_rad", time_ns, gap_s)
            yaw = interpolate(channel, "sigma_yaw_rad", time_ns, gap_s)
            return tilt, yaw
        gates = np.full(time_ns.shape, ONE_SIGMA_OF_GATE)
        if self.health is not None:
            gates = self.innovation("velocity", time_ns)
        tilt = np.hypot(LEAST_TILT_RAD, GATE_SIGMAS * TILT_RAD * gates)
        latitude = np.abs(np.nan_to_num(lat_rad))
        dip = np.clip(2.0 * np.tan(latitude), 0.0, STEEPEST_DIP)
        return tilt, np.hypot(LEAST_YAW_RAD, dip * tilt)

    def innovation(self, kind: str, time_ns: TimeArray) -> Array:
        """Rms of an innovation over its gate about instants; 0 where it is not logged."""
        column = f"innovation_{kind}"
        if self.health is None or column not in self.health.columns:
            return np.zeros(time_ns.shape)
        mean, scatter = _about(self.health.time_ns, self.health[column], time_ns)
        return np.hypot(mean, scatter)


def _reported_variances(source: Channel, time_ns: TimeArray) -> tuple[Array, Array]:
    """(m,) variances by the nearest sample's report, horizontal per axis and vertical [m2].

    Where that is far away, a filter has drifted since.
    """
    row = _nearest_row(source, time_ns)
    away_s = np.abs(time_ns - source.time_ns[row]) * 1e-9
    drift_m = DRIFT_M_S * np.maximum(away_s - USUAL_INTERVAL_S, 0.0)
    of_drift = np.square(drift_m)

    def reported(name: str, ranges: float) -> Array:
        by_dop = ranges * RANGE_ERROR_M * source.get("hdop")
        stated = source.get(name)
        return np.where(np.isfinite(stated), stated, by_dop)

    horizontal = np.square(reported("sigma_h_m", HORIZONTAL_RANGES)[row]) + of_drift
    vertical = np.square(reported("sigma_v_m", VERTICAL_RANGES)[row]) + of_drift
    return horizontal, vertical


def _nearest_row(channel: Channel, time_ns: TimeArray) -> Rows:
    """(m,) rows of the samples nearest to instants; of equally near ones the later."""
    after = np.clip(np.searchsorted(channel.time_ns, time_ns), 1, max(len(channel) - 1, 1))
    to_before = time_ns - channel.time_ns[after - 1]
    to_after = channel.time_ns[after % len(channel)] - time_ns
    return np.asarray(np.where(to_before < to_after, after - 1, after))


def _about(stamps: TimeArray, values: Array, time_ns: TimeArray) -> tuple[Array, Array]:
    """(m,) mean and standard deviation of known values within `WINDOW_NS` of instants.

    0 where there is none.
    """
    known = np.isfinite(values)
    stamps = stamps[known]
    values = values[known]
    middle = float(np.median(values)) if values.size else 0.0
    departures = values - middle  # so that squares do not cancel
    first = np.searchsorted(stamps, time_ns - WINDOW_NS)
    last = np.searchsorted(stamps, time_ns + WINDOW_NS, side="right")
    count = np.maximum(last - first, 1)
    sums = np.append(0.0, np.cumsum(departures))
    square_sums = np.append(0.0, np.cumsum(departures**2))
    mean = (sums[last] - sums[first]) / count
    mean_square = (square_sums[last] - square_sums[first]) / count
    deviation = np.sqrt(np.maximum(mean_square - mean**2, 0.0))
    return np.where(last > first, middle + mean, 0.0), deviation


def with_accuracy(
    roles: Mapping[str, Channel], channels: Iterable[Channel]
) -> tuple[dict[str, Channel], LogAccuracy]:
    """The channels of the roles with velocities and body rates, and how accurate they are.

    They get the columns of other channels of the same sender; a gimbal does not, whose body rates
    are the aircraft's.
    """
    by_rank = sorted(channels, key=lambda channel: (channel.rank, channel.name))
    result = dict(roles)
    for role in ("position", "height", "attitude", "aircraft_attitude"):
        channel = roles.get(role)
        if channel is not None and not is_of_gimbal(channel.source.message):
            slopes = RATES if "attitude" in role else VELOCITY
            result[role] = with_slopes(channel, by_rank, slopes)
    system = roles["position"].source.system if "position" in roles else None
    own = [channel for channel in by_rank if channel.source.system == system and len(channel)]
    return result, _accuracy_of_sender(own)


def _accuracy_of_sender(channels: list[Channel]) -> LogAccuracy:
    """The best receiver, health and fused heights among the channels of one sender."""

    def first(fits: Callable[[Channel], bool]) -> Channel | None:
        return next((channel for channel in channels if fits(channel)), None)

    def is_receiver(channel: Channel) -> bool:
        columns = channel.columns
        return "height" in channel.roles and ("sigma_h_m" in columns or "hdop" in columns)

    def has_innovations(channel: Channel) -> bool:
        columns = channel.columns
        return "innovation_position" in columns and "innovation_velocity" in columns

    def is_fused(channel: Channel) -> bool:
        return "position" in channel.roles and "height" not in channel.roles

    return LogAccuracy(
        receiver=first(is_receiver), health=first(has_innovations), fused=first(is_fused)
    )
