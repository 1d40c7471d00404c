"""How accurate a log's positions and attitudes are, by what the log itself reports."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.mount import is_of_gimbal
from unbend.flight.trajectory import RATES, VELOCITY, interpolate, with_slopes
from unbend.units import NANOSECONDS_PER_SECOND, Array

# An innovation whose ratio to its gate is 1 is five sigmas (EK3_POS_I_GATE 500 and its like) of
# what ArduPilot's filter takes for the noise of a measurement by default: EK3_POSNE_M_NSE,
# EK3_VELNE_M_NSE, EK3_ALT_M_NSE.
POSITION_GATE_M, VELOCITY_GATE_M_S, HEIGHT_GATE_M = 5.0 * 0.5, 5.0 * 0.5, 5.0 * 3.0

# The steady state of that filter (place, velocity, tilt; EK3_ACC_P_NSE 0.35 m/s2 and EK3_GYRO_P_NSE
# 0.015 rad/s in steps of 12 ms; fixes at 5 and 10 Hz) has 0.23 and 0.21 deg of tilt; innovations of
# velocity that last shift its place by 1.1 and 1.3 m for each m/s; its slowest pole forgets in 3.4
# and 2.9 s, of which the window takes three on both sides of an instant.
TILT_RAD, FILTER_TIME_S = float(np.radians(0.22)), 1.3
WINDOW_NS = 10 * NANOSECONDS_PER_SECOND

# What no innovation shows. Two flights of ArduPilot's simulator, each by itself and by all samples:
# 0.110 and 0.085 deg about a level axis, 0.38 and 0.33 deg about the vertical one.
LEAST_TILT_RAD, LEAST_YAW_RAD = np.radians([0.1, 0.36])
STEEPEST_DIP = 6.0  # tangent; nearer to a magnetic pole no compass is used

RANGE_ERROR_M = 3.0  # of a receiver without corrections, which its HDOP multiplies
DRIFT_M_S = 2.0  # of a filter without fixes


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
        own = any(name in channel.columns for name in ("sigma_h_m", "sigma_v_m", "hdop"))
        source = channel if own else self.receiver
        if source is None:
            return np.full(time_ns.shape, np.nan), np.full(time_ns.shape, np.nan)
        row = np.clip(np.searchsorted(source.time_ns, time_ns), 1, max(len(source) - 1, 1))
        row -= time_ns - source.time_ns[row - 1] < source.time_ns[row % len(source)] - time_ns
        drift = DRIFT_M_S * np.maximum(np.abs(time_ns - source.time_ns[row]) * 1e-9 - 1.0, 0.0)
        sigmas = []
        for name, ranges in (("sigma_h_m", 0.5**0.5), ("sigma_v_m", 1.5)):
            by_dop = ranges * RANGE_ERROR_M * source.get("hdop")
            reported = np.where(np.isfinite(source.get(name)), source.get(name), by_dop)
            sigmas.append(np.square(reported[row]) + np.square(drift))
        horizontal, vertical = sigmas
        if not own:
            of_velocity = VELOCITY_GATE_M_S * FILTER_TIME_S * self.innovation("velocity", time_ns)
            horizontal += np.square(POSITION_GATE_M * self.innovation("position", time_ns))
            horizontal += np.square(of_velocity)
            vertical += np.square(HEIGHT_GATE_M * self.innovation("height", time_ns))
        elif self.fused and (name := channel.height_column or "") in self.fused.columns:
            limit = self.fused.gap_limit_s()
            apart = channel[name] - interpolate(self.fused, name, channel.time_ns, limit)
            vertical += np.square(_about(channel.time_ns, apart, time_ns)[1])
        silent = ~np.isfinite(horizontal)
        if own and self.receiver is not None and channel is not self.receiver and silent.any():
            reports = {"sigma_h_m", "sigma_v_m", "hdop"}  # for a part of the time only
            columns = {k: v for k, v in channel.columns.items() if k not in reports}
            of_filter = self.positions(replace(channel, columns=columns), time_ns)
            horizontal = np.where(silent, np.square(of_filter[0]), horizontal)
            vertical = np.where(silent, np.square(of_filter[1]), vertical)
        return np.sqrt(horizontal), np.sqrt(vertical)

    def attitude(self, channel: Channel, time_ns: TimeArray, lat_rad: Array) -> tuple[Array, Array]:
        """(m,) sigmas of attitudes of a channel about a level and the vertical axis [rad].

        What the channel itself reports. Else the tilt of a filter grows with its innovations of
        velocity, as the sigma of unit weight does, and a compass shows it times the tangent of the
        field's dip (that of a dipole along the earth's axis, 2 tan(latitude)) as yaw.
        """
        names, limit = ("sigma_tilt_rad", "sigma_yaw_rad"), channel.gap_limit_s()
        if all(name in channel.columns for name in names):
            tilt, yaw = (interpolate(channel, name, time_ns, limit) for name in names)
            return tilt, yaw
        gates = np.full(time_ns.shape, 0.2)  # one sigma, where no innovations are logged
        if self.health is not None:
            gates = self.innovation("velocity", time_ns)
        tilt = np.hypot(LEAST_TILT_RAD, 5.0 * TILT_RAD * gates)
        dip = np.clip(2.0 * np.tan(np.abs(np.nan_to_num(lat_rad))), 0.0, STEEPEST_DIP)
        return tilt, np.hypot(LEAST_YAW_RAD, dip * tilt)

    def innovation(self, kind: str, time_ns: TimeArray) -> Array:
        """Rms of an innovation over its gate about instants; 0 where it is not logged."""
        values = None if self.health is None else self.health.columns.get(f"innovation_{kind}")
        if self.health is None or values is None:
            return np.zeros(time_ns.shape)
        mean, scatter = _about(self.health.time_ns, values, time_ns)
        return np.hypot(mean, scatter)


def _about(stamps: TimeArray, values: Array, time_ns: TimeArray) -> tuple[Array, Array]:
    """(m,) mean and standard deviation of known values within `WINDOW_NS` of instants.

    0 where there is none.
    """
    known = np.isfinite(values)
    stamps, values = stamps[known], values[known]
    middle = float(np.median(values)) if values.size else 0.0  # so that squares do not cancel
    first = np.searchsorted(stamps, time_ns - WINDOW_NS)
    last = np.searchsorted(stamps, time_ns + WINDOW_NS, side="right")
    sums = (np.append(0.0, np.cumsum((values - middle) ** power)) for power in (1, 2))
    mean, square = ((s[last] - s[first]) / np.maximum(last - first, 1) for s in sums)
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
    return np.where(last > first, middle + mean, 0.0), deviation


def with_accuracy(
    roles: Mapping[str, Channel], channels: Iterable[Channel]
) -> tuple[dict[str, Channel], LogAccuracy]:
    """The channels of the roles with velocities and body rates, and how accurate they are.

    They get the columns of other channels of the same sender; a gimbal does not, whose body rates
    are the aircraft's.
    """
    result, everything = dict(roles), tuple(channels)
    by_rank = sorted(everything, key=lambda channel: (channel.rank, channel.name))
    for role in {"position", "height", "attitude", "aircraft_attitude"} & roles.keys():
        if not is_of_gimbal(roles[role].source.message):
            slopes = RATES if "attitude" in role else VELOCITY
            result[role] = with_slopes(roles[role], by_rank, slopes)
    system = roles["position"].source.system if "position" in roles else None
    own = [channel for channel in by_rank if channel.source.system == system and len(channel)]
    receivers = [c for c in own if "height" in c.roles and {"sigma_h_m", "hdop"} & c.columns.keys()]
    health = [c for c in own if {"innovation_position", "innovation_velocity"} <= c.columns.keys()]
    fused = [c for c in own if "position" in c.roles and "height" not in c.roles]
    best = [next(iter(group), None) for group in (receivers, health, fused)]
    return result, LogAccuracy(*best)
