"""The flight: where the aircraft and its cabin are at any time, without error.

No wind; heading, climb and speed are commanded in steps, smoothed, and integrated once at 20 Hz;
the truth is the spline through that, so position and attitude are continuous functions of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from unbend.simulate import messages
from unbend.simulate.true_air import FIELD_HEIGHT_M, TrueAir, edlen_index, saturation_pressure_pa
from unbend.units import STANDARD_GRAVITY, WGS84_A, WGS84_F, Array

FIELD_LAT_RAD = float(np.radians(47.4))
FIELD_LON_RAD = float(np.radians(8.5))
UNDULATION_M = 47.6

SPEED_M_S = 70.0
TURN_RADIUS_M = 850.0  # lines 1700 m apart, 30 deg of bank
CIRCLE_RADIUS_M = 1500.0
LEAD_IN_M = 6000.0  # from the field to the first line: the last of the climb
EXPOSURE_SPACING_M = 620.0  # 60 % forward overlap of the nadir camera
LINE_MARGIN_M = 400.0  # wings level before the first exposure of a line
STAND_S = 60.0  # engines running before take-off
RAMP_S = 40.0  # take-off and landing roll
AFTER_S = 12.0
CLIMB_RATE_M_S = 9.0
CABIN_HOLD_M = 1800.0
_STEP_S = 0.05


@dataclass(frozen=True, eq=False)
class State:
    """The aircraft at times (n,): radians, metres, metres per second."""

    time_s: Array
    lat_rad: Array
    lon_rad: Array
    h_msl_m: Array
    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array
    speed_m_s: Array
    climb_m_s: Array
    course_rad: Array

    def between(self, time_s: Array) -> State:
        """At other times (n,), linear between these."""
        rows = {name: np.interp(time_s, self.time_s, row) for name, row in vars(self).items()}
        return State(**rows)

    def rows(self, which: slice) -> State:
        """Some of the times."""
        return State(*(row[which] for row in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Flight:
    """The true flight as functions of the time since the log began [s]."""

    duration_s: float
    exposure_s: Array
    path: BSpline  # east, north, up above the field [m]
    heading: BSpline  # unwrapped, before the wander [rad]
    airborne: BSpline  # 0 on the ground, 1 in the air

    def at(self, time_s: Array) -> State:
        """The true state at times (n,) [s]."""
        east, north, up = np.moveaxis(self.path(time_s), -1, 0)
        velocity = np.moveaxis(self.path.derivative()(time_s), -1, 0)
        lat, lon = geographic(east, north)
        ground_speed = np.hypot(velocity[0], velocity[1])
        heading = self.heading(time_s)
        rate = self.heading.derivative()(time_s)
        gate = self.airborne(time_s)
        climb = np.arctan2(velocity[2], np.maximum(ground_speed, 30.0))
        roll = np.arctan(ground_speed * rate / STANDARD_GRAVITY)
        roll += gate * _wander(time_s, 0.8, (7.3, 11.9, 29.0), 0.4)
        pitch = climb + np.radians(1.5) + gate * _wander(time_s, 0.6, (6.1, 13.7, 41.0), 1.3)
        yaw = heading + gate * _wander(time_s, 0.7, (9.7, 17.3, 37.0), 2.6)
        place = lat, lon, FIELD_HEIGHT_M + up
        return State(time_s, *place, roll, pitch, yaw, ground_speed, velocity[2], heading)


def _wander(time_s: Array, size_deg: float, periods_s: tuple[float, ...], phase: float) -> Array:
    """A smooth sum of sines (n,) [rad], about size_deg from peak to mean."""
    waves = [np.sin(2.0 * np.pi * time_s / p + phase * (i + 1)) for i, p in enumerate(periods_s)]
    return np.asarray(np.radians(size_deg) * np.sum(waves, axis=0) / np.sqrt(len(periods_s)))


def geographic(east_m: Array, north_m: Array) -> tuple[Array, Array]:
    """Latitude and longitude [rad] of a place east and north of the field [m].

    A map of its own, linear by definition: exact, since everything is made from its result.
    """
    e2 = WGS84_F * (2.0 - WGS84_F)
    w = 1.0 - e2 * np.sin(FIELD_LAT_RAD) ** 2
    meridian = WGS84_A * (1.0 - e2) / w**1.5 + FIELD_HEIGHT_M
    parallel = (WGS84_A / np.sqrt(w) + FIELD_HEIGHT_M) * np.cos(FIELD_LAT_RAD)
    return FIELD_LAT_RAD + north_m / meridian, FIELD_LON_RAD + east_m / parallel


def terrain_m(east_m: Array, north_m: Array) -> Array:
    """Height of the ground above sea level [m]: gentle hills, 350-700 m, flat at the field."""
    hills = (
        55.0
        + 80.0 * np.sin(east_m / 1900.0 + 0.6) * np.cos(north_m / 2300.0)
        + 45.0 * np.sin((east_m - 1.7 * north_m) / 1100.0 + 1.1)
    )
    away = 1.0 - np.exp(-((np.hypot(east_m, north_m) / 4000.0) ** 4))
    return np.asarray(FIELD_HEIGHT_M + away * hills)


@dataclass(frozen=True)
class _Leg:
    """A straight or a turn: how far, and through which angle (left is negative)."""

    length_m: float
    turn_rad: float = 0.0


def _turn(radius_m: float, angle_rad: float) -> _Leg:
    return _Leg(radius_m * abs(angle_rad), angle_rad)


def _legs(
    lines: int, line_m: float, climb_m: float
) -> tuple[list[_Leg], float, float, list[float]]:
    """The whole path, where the climb ends and the descent begins [m], and where lines begin."""
    circle = _turn(CIRCLE_RADIUS_M, -2.0 * np.pi)
    circles = max(0, round((climb_m * SPEED_M_S / CLIMB_RATE_M_S - LEAD_IN_M) / circle.length_m))
    legs = [_Leg(4000.0), *[circle] * circles, _Leg(LEAD_IN_M)]
    climb_end = sum(leg.length_m for leg in legs) - 700.0
    starts = []
    for line in range(lines):
        starts.append(sum(leg.length_m for leg in legs))
        legs.append(_Leg(line_m))
        if line < lines - 1:
            legs.append(_turn(TURN_RADIUS_M, np.pi if line % 2 else -np.pi))
    legs.append(_Leg(700.0))
    descent_start = sum(leg.length_m for leg in legs)

    # Back to the field, by a turn about a centre and a straight that touches its circle.
    x, y, psi = 0.0, 0.0, 0.5 * np.pi  # east, north and heading; the legs begin eastwards
    for leg in legs:
        if leg.turn_rad:
            radius = leg.length_m / leg.turn_rad
            x += radius * (np.cos(psi) - np.cos(psi + leg.turn_rad))
            y += radius * (np.sin(psi + leg.turn_rad) - np.sin(psi))
            psi += leg.turn_rad
        else:
            x, y = x + leg.length_m * np.sin(psi), y + leg.length_m * np.cos(psi)
    side = -1.0 if lines % 2 == 0 else 1.0  # to the left after an even number of lines
    radius = CIRCLE_RADIUS_M
    centre = np.array([x + side * radius * np.cos(psi), y - side * radius * np.sin(psi)])
    distance = float(np.hypot(*centre))
    if distance <= radius:
        raise messages.path_too_near(distance_m=distance)
    straight = np.sqrt(distance**2 - radius**2)
    heading = np.arctan2(-centre[0], -centre[1]) + side * np.arctan2(radius, straight)
    angle = float((side * (heading - psi)) % (2.0 * np.pi))
    legs += [_turn(radius, side * angle), _Leg(float(straight)), *[circle] * circles, _Leg(1500.0)]
    return legs, climb_end, descent_start, starts


def fly(height_above_ground_m: float, lines: int, exposures_per_line: int) -> Flight:
    """Plan and integrate a survey: climb from the field, lines, descent, landing."""
    line_m = EXPOSURE_SPACING_M * max(exposures_per_line - 1, 1) + 2.0 * LINE_MARGIN_M
    legs, climb_end, descent_start, starts = _legs(lines, line_m, height_above_ground_m)
    lengths = np.array([leg.length_m for leg in legs])
    total_m = float(lengths.sum())
    roll_m = 0.5 * SPEED_M_S * RAMP_S
    cruise_s = (total_m - 2.0 * roll_m) / SPEED_M_S
    duration = STAND_S + 2.0 * RAMP_S + cruise_s + AFTER_S
    time = np.arange(0.0, duration + _STEP_S, _STEP_S)

    landing = STAND_S + RAMP_S + cruise_s
    gate = _smoothstep((time - STAND_S) / RAMP_S) - _smoothstep((time - landing) / RAMP_S)
    distance = _integral(gate * SPEED_M_S)
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    curvature = np.array([leg.turn_rad / leg.length_m for leg in legs])
    leg = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, len(legs) - 1)
    heading = 0.5 * np.pi + _integral(gaussian_filter1d(curvature[leg] * gate * SPEED_M_S, 40.0))

    rate = _share(time, distance, 1.3 * roll_m, climb_end) - _share(
        time, distance, descent_start, total_m - roll_m - 500.0
    )
    up = height_above_ground_m * _integral(rate)
    up += 4.0 * np.sin(2.0 * np.pi * time / 53.0) * _smoothstep(up / 200.0)
    east = _integral(gate * SPEED_M_S * np.sin(heading))
    north = _integral(gate * SPEED_M_S * np.cos(heading))
    along = EXPOSURE_SPACING_M * np.arange(exposures_per_line)
    shots = np.add.outer(np.array(starts) + LINE_MARGIN_M, along).ravel()
    # The camera's clock ticks in whole microseconds, and never in step with the other sensors.
    exposure = np.interp(shots, distance, time) + 0.043 * np.sin(7.0 * np.arange(len(shots)))
    return Flight(
        float(time[-1]),
        np.round(exposure, 6),
        make_interp_spline(time, np.stack([east, north, up], axis=-1), k=5),
        make_interp_spline(time, heading, k=5),
        make_interp_spline(time, gate, k=3),
    )


def _smoothstep(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (10.0 + x * (6.0 * x - 15.0)))


def _integral(values: Array) -> Array:
    steps = 0.5 * _STEP_S * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _share(time: Array, distance: Array, start_m: float, end_m: float) -> Array:
    """A rate [1/s] whose integral is one, spread over a stretch of the path, with soft ends."""
    inside = ((distance >= start_m) & (distance <= end_m)).astype(np.float64)
    soft = gaussian_filter1d(inside, 60.0)
    return np.asarray(soft / (soft.sum() * (time[1] - time[0])))


@dataclass(frozen=True, eq=False)
class AirState:
    """True air outside and in the cabin at times (n,)."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    humidity: Array
    n: Array


def cabin_air(air: TrueAir, h_msl_m: Array, time_s: Array) -> AirState:
    """The true air of the cabin: ambient up to 1800 m, held there above, never quite constant."""
    ambient = air.pressure_pa(h_msl_m)
    held = float(air.pressure_pa(np.array(CABIN_HOLD_M)))
    soft = 150.0  # [Pa]: the valve closes gradually, so that the truth has no kink
    pressure = held + soft * np.logaddexp(0.0, (ambient - held) / soft)
    closed = 1.0 / (1.0 + np.exp(np.clip((ambient - held) / soft, -60.0, 60.0)))
    wave = 220.0 * np.sin(2.0 * np.pi * time_s / 310.0) + 90.0 * np.sin(time_s / 14.0)
    pressure = pressure + closed * wave
    temperature = 295.0 + 1.6 * np.sin(2.0 * np.pi * time_s / 830.0 + 0.7)
    temperature = temperature + 0.4 * np.sin(2.0 * np.pi * time_s / 121.0)
    humidity = 0.30 + 0.03 * np.sin(2.0 * np.pi * time_s / 540.0)
    vapour = humidity * saturation_pressure_pa(temperature)
    n = edlen_index(pressure, temperature, vapour)
    return AirState(pressure, temperature, vapour, humidity, n)
