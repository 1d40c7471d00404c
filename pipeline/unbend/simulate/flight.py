"""The flight: where the aircraft and its cabin are at any time, without error.

There is no wind. Heading, climb and speed are commanded in steps, smoothed, and integrated at
20 Hz. The truth is the spline through the result: position and attitude are smooth functions.
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
STAND_S = 60.0  # at rest before take-off, engines running
RAMP_S = 40.0  # from rest to `SPEED_M_S` at take-off, and back at landing
ROLL_M = 0.5 * SPEED_M_S * RAMP_S  # the distance covered meanwhile
AFTER_S = 12.0  # at rest after landing
CLIMB_RATE_M_S = 9.0
CABIN_HOLD_M = 1800.0  # above this height the cabin keeps the pressure of this height
STEP_S = 0.05  # of the integration
FIRST_LEG_M = 4000.0  # from the field eastwards, before the climb in circles
RUN_OUT_M = 700.0  # level flight before the first line, and behind the last line
LAST_LEG_M = 1500.0  # after the circles down
EAST_RAD = 0.5 * np.pi
TURN_SMOOTH = 40.0  # steps over which a roll into a turn is smooth
CLIMB_SMOOTH = 60.0  # the same of a climb
SLOWEST_M_S = 30.0  # least speed for a climb angle: none is steep near standstill
ANGLE_OF_ATTACK_RAD = np.radians(1.5)
VALVE_PA = 150.0  # range of pressure in which the cabin's valve closes: the truth has no kink

# Sensors are sampled at equal intervals; jitter keeps the exposures out of step with them.
JITTER_S = 0.043  # amplitude of the jitter; exposures of a line are 9 s apart
JITTER_STEP_RAD = 7.0  # step of its phase between successive exposures: 401 degrees


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
        """The state at other times (n,) [s], interpolated linearly."""
        values = {}
        for name, value in vars(self).items():
            values[name] = np.interp(time_s, self.time_s, value)
        return State(**values)

    def rows(self, chosen: slice) -> State:
        """The states of the ``chosen`` times."""
        values = {}
        for name, value in vars(self).items():
            values[name] = value[chosen]
        return State(**values)


@dataclass(frozen=True)
class _Wander:
    """A small smooth variation of an angle: a sum of sines with an amplitude near ``size_deg``."""

    size_deg: float
    periods_s: tuple[float, ...]
    phase: float

    def at(self, time_s: Array) -> Array:
        """The variation (n,) [rad] at times (n,) [s]."""
        waves = []
        for number, period_s in enumerate(self.periods_s, start=1):
            phase = self.phase * number
            waves.append(np.sin(2.0 * np.pi * time_s / period_s + phase))
        size_rad = np.radians(self.size_deg)
        sum_of_waves = np.sum(waves, axis=0)
        return np.asarray(size_rad * sum_of_waves / np.sqrt(len(waves)))


ROLL_WANDER = _Wander(
    size_deg=0.8,
    periods_s=(7.3, 11.9, 29.0),
    phase=0.4,
)
PITCH_WANDER = _Wander(
    size_deg=0.6,
    periods_s=(6.1, 13.7, 41.0),
    phase=1.3,
)
YAW_WANDER = _Wander(
    size_deg=0.7,
    periods_s=(9.7, 17.3, 37.0),
    phase=2.6,
)


@dataclass(frozen=True, eq=False)
class Flight:
    """The true flight as functions of the time since the log began [s]."""

    duration_s: float
    exposure_s: Array
    path: BSpline  # east, north, up above the field [m]
    heading: BSpline  # unwrapped, without `YAW_WANDER` [rad]
    airborne: BSpline  # 0 on the ground, 1 in the air

    def at(self, time_s: Array) -> State:
        """The true state at times (n,) [s]."""
        east, north, up = self.path(time_s).T
        lat, lon = geographic(east, north)
        velocity_east, velocity_north, climb = self.path.derivative()(time_s).T
        speed = np.hypot(velocity_east, velocity_north)
        climb_angle = np.arctan2(climb, np.maximum(speed, SLOWEST_M_S))
        heading = self.heading(time_s)
        turn_rate = self.heading.derivative()(time_s)
        bank = np.arctan(speed * turn_rate / STANDARD_GRAVITY)
        airborne = self.airborne(time_s)
        return State(
            time_s=time_s,
            lat_rad=lat,
            lon_rad=lon,
            h_msl_m=FIELD_HEIGHT_M + up,
            roll_rad=bank + airborne * ROLL_WANDER.at(time_s),
            pitch_rad=climb_angle + ANGLE_OF_ATTACK_RAD + airborne * PITCH_WANDER.at(time_s),
            yaw_rad=heading + airborne * YAW_WANDER.at(time_s),
            speed_m_s=speed,
            climb_m_s=climb,
            course_rad=heading,
        )


def geographic(east_m: Array, north_m: Array) -> tuple[Array, Array]:
    """Latitude and longitude [rad] of a place east and north of the field [m].

    Linear by definition. It is not an approximation: the true positions are its results.
    """
    e2 = WGS84_F * (2.0 - WGS84_F)
    w = 1.0 - e2 * np.sin(FIELD_LAT_RAD) ** 2
    meridian = WGS84_A * (1.0 - e2) / w**1.5 + FIELD_HEIGHT_M
    parallel = (WGS84_A / np.sqrt(w) + FIELD_HEIGHT_M) * np.cos(FIELD_LAT_RAD)
    lat_rad = FIELD_LAT_RAD + north_m / meridian
    lon_rad = FIELD_LON_RAD + east_m / parallel
    return lat_rad, lon_rad


def terrain_m(east_m: Array, north_m: Array) -> Array:
    """Height of the ground above sea level [m]: gentle hills, 350-700 m, flat at the field."""
    hills = (
        55.0
        + 80.0 * np.sin(east_m / 1900.0 + 0.6) * np.cos(north_m / 2300.0)
        + 45.0 * np.sin((east_m - 1.7 * north_m) / 1100.0 + 1.1)
    )
    from_field_m = np.hypot(east_m, north_m)
    share_of_hills = 1.0 - np.exp(-((from_field_m / 4000.0) ** 4))  # 0 at the field, 1 far away
    return np.asarray(FIELD_HEIGHT_M + share_of_hills * hills)


@dataclass(frozen=True)
class _Leg:
    """A straight (``turn_rad`` 0) or a turn: its length, and its angle (to the left negative)."""

    length_m: float
    turn_rad: float = 0.0


def _turn(radius_m: float, angle_rad: float) -> _Leg:
    """A turn through an angle, to the left negative."""
    return _Leg(radius_m * abs(angle_rad), angle_rad)


@dataclass(frozen=True)
class _Route:
    """All legs from take-off to landing; the other fields are distances along them [m]."""

    legs: list[_Leg]
    climb_end_m: float
    descent_start_m: float
    line_starts_m: list[float]

    @property
    def lengths_m(self) -> Array:
        """The length of each leg [m]."""
        return np.array([leg.length_m for leg in self.legs])


@dataclass(frozen=True)
class _Place:
    """The position of the aircraft relative to the field [m], and its heading from north."""

    east_m: float
    north_m: float
    heading_rad: float

    def after(self, leg: _Leg) -> _Place:
        """The place at the end of a leg."""
        heading = self.heading_rad
        if not leg.turn_rad:
            east = self.east_m + leg.length_m * np.sin(heading)
            north = self.north_m + leg.length_m * np.cos(heading)
            return _Place(east, north, heading)
        radius = leg.length_m / leg.turn_rad
        end_heading = heading + leg.turn_rad
        to_east = radius * (np.cos(heading) - np.cos(end_heading))
        to_north = radius * (np.sin(end_heading) - np.sin(heading))
        return _Place(self.east_m + to_east, self.north_m + to_north, end_heading)


def _length_m(legs: list[_Leg]) -> float:
    """The length of all legs together [m]."""
    return sum(leg.length_m for leg in legs)


def _route(lines: int, line_m: float, climb_m: float) -> _Route:
    """Plan the legs: climb from the field in circles, fly the lines, return and descend in circles.

    ``line_m``: the length of a line [m]. ``climb_m``: its height above the field [m].
    """
    circle = _turn(CIRCLE_RADIUS_M, -2.0 * np.pi)
    climb_path_m = climb_m * SPEED_M_S / CLIMB_RATE_M_S
    circles = max(0, round((climb_path_m - LEAD_IN_M) / circle.length_m))
    legs = [_Leg(FIRST_LEG_M)]
    legs += [circle] * circles
    legs.append(_Leg(LEAD_IN_M))
    climb_end_m = _length_m(legs) - RUN_OUT_M
    line_starts_m = []
    for line in range(lines):
        line_starts_m.append(_length_m(legs))
        legs.append(_Leg(line_m))
        if line < lines - 1:
            half_turn = np.pi if line % 2 else -np.pi
            legs.append(_turn(TURN_RADIUS_M, half_turn))
    legs.append(_Leg(RUN_OUT_M))
    descent_start_m = _length_m(legs)
    turns_left = lines % 2 == 0
    legs += _way_back(legs, side=-1.0 if turns_left else 1.0)
    legs += [circle] * circles
    legs.append(_Leg(LAST_LEG_M))
    return _Route(
        legs=legs,
        climb_end_m=climb_end_m,
        descent_start_m=descent_start_m,
        line_starts_m=line_starts_m,
    )


def _way_back(legs: list[_Leg], side: float) -> list[_Leg]:
    """The legs from the end of ``legs`` back to the field: a turn, and a straight to the field.

    ``side``: -1 to turn left, 1 to turn right. The straight is the tangent from the circle of the
    turn to the field. Raises PhysicsError if the field is within the circle.
    """
    place = _Place(0.0, 0.0, EAST_RAD)
    for leg in legs:
        place = place.after(leg)
    radius = CIRCLE_RADIUS_M
    centre_east = place.east_m + side * radius * np.cos(place.heading_rad)
    centre_north = place.north_m - side * radius * np.sin(place.heading_rad)
    distance = float(np.hypot(centre_east, centre_north))
    if distance <= radius:
        raise messages.path_too_near(distance_m=distance)
    straight = np.sqrt(distance**2 - radius**2)
    to_field = np.arctan2(-centre_east, -centre_north)  # direction from the centre to the field
    heading = to_field + side * np.arctan2(radius, straight)  # that of the tangent
    turn = side * (heading - place.heading_rad)
    angle = float(turn % (2.0 * np.pi))
    return [
        _turn(radius, side * angle),
        _Leg(float(straight)),
    ]


def fly(height_above_ground_m: float, lines: int, exposures_per_line: int) -> Flight:
    """Plan a survey (take-off, climb, lines, descent, landing), and integrate it over time."""
    line_m = EXPOSURE_SPACING_M * max(exposures_per_line - 1, 1) + 2.0 * LINE_MARGIN_M
    route = _route(lines, line_m, height_above_ground_m)
    total_m = float(route.lengths_m.sum())
    cruise_s = (total_m - 2.0 * ROLL_M) / SPEED_M_S
    duration_s = STAND_S + 2.0 * RAMP_S + cruise_s + AFTER_S
    time = np.arange(0.0, duration_s + STEP_S, STEP_S)

    airborne = _airborne(time, cruise_s)
    speed = airborne * SPEED_M_S
    distance = _integral(speed)
    heading = EAST_RAD + _integral(_turn_rate(route, distance, airborne))
    east = _integral(speed * np.sin(heading))
    north = _integral(speed * np.cos(heading))
    up = _height_profile(route, height_above_ground_m, distance, time)
    position = np.stack([east, north, up], axis=-1)
    return Flight(
        duration_s=float(time[-1]),
        exposure_s=_exposure_times(route, exposures_per_line, distance, time),
        path=make_interp_spline(time, position, k=5),
        heading=make_interp_spline(time, heading, k=5),
        airborne=make_interp_spline(time, airborne, k=3),
    )


def _airborne(time: Array, cruise_s: float) -> Array:
    """Speed at times [s] over the cruising speed: rises to 1 at take-off, falls to 0 at landing."""
    landing_s = STAND_S + RAMP_S + cruise_s
    taken_off = _smoothstep((time - STAND_S) / RAMP_S)
    landed = _smoothstep((time - landing_s) / RAMP_S)
    return taken_off - landed


def _height_profile(
    route: _Route, height_above_ground_m: float, distance: Array, time: Array
) -> Array:
    """Heights above the field [m] at times [s] with distances flown [m]: climb, cruise, descent.

    Waves of 4 m are added in the air.
    """
    climb_rate = _unit_rate(time, distance, 1.3 * ROLL_M, route.climb_end_m)
    descent_end_m = float(route.lengths_m.sum()) - ROLL_M - 500.0
    descent_rate = _unit_rate(time, distance, route.descent_start_m, descent_end_m)
    up = height_above_ground_m * _integral(climb_rate - descent_rate)
    waves = 4.0 * np.sin(2.0 * np.pi * time / 53.0)
    return np.asarray(up + waves * _smoothstep(up / 200.0))


def _turn_rate(route: _Route, distance: Array, airborne: Array) -> Array:
    """Turn rates [rad/s] at distances along the route [m], smoothed over time.

    ``airborne``: the speed over the cruising speed.
    """
    curvature = np.array([leg.turn_rad / leg.length_m for leg in route.legs])
    leg_edges = np.concatenate([[0.0], np.cumsum(route.lengths_m)])
    leg = np.searchsorted(leg_edges, distance, side="right") - 1
    leg = np.clip(leg, 0, len(route.legs) - 1)
    turn_rate = curvature[leg] * airborne * SPEED_M_S
    return np.asarray(gaussian_filter1d(turn_rate, TURN_SMOOTH))


def _exposure_times(
    route: _Route,
    exposures_per_line: int,
    distance: Array,
    time: Array,
) -> Array:
    """Times [s] of the exposures: equally spaced along each line, with a jitter.

    ``distance``: flown at each of the times [m]. The results are whole microseconds.
    """
    along_line = EXPOSURE_SPACING_M * np.arange(exposures_per_line)
    first_of_line = np.array(route.line_starts_m) + LINE_MARGIN_M
    shots = np.add.outer(first_of_line, along_line).ravel()
    exposure = np.interp(shots, distance, time)
    phase = JITTER_STEP_RAD * np.arange(len(shots))
    jitter = JITTER_S * np.sin(phase)
    return np.asarray(np.round(exposure + jitter, 6))


def _smoothstep(x: Array) -> Array:
    """0 below x = 0, 1 above x = 1, and between a rise with two continuous derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (10.0 + x * (6.0 * x - 15.0)))


def _integral(values: Array) -> Array:
    """Integral of values at steps of `STEP_S` from the first one on, by the trapezoidal rule."""
    steps = 0.5 * STEP_S * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _unit_rate(time: Array, distance: Array, start_m: float, end_m: float) -> Array:
    """A rate [1/s] over time with the integral 1: constant on a stretch of the path, else 0.

    The stretch is from ``start_m`` to ``end_m`` of the ``distance`` flown [m]; its ends are smooth.
    """
    inside = (distance >= start_m) & (distance <= end_m)
    soft = gaussian_filter1d(inside.astype(np.float64), CLIMB_SMOOTH)
    step_s = time[1] - time[0]
    return np.asarray(soft / (soft.sum() * step_s))


@dataclass(frozen=True, eq=False)
class AirState:
    """True air at (n,) places, outside or in the cabin; ``n`` is the refractive index."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    humidity: Array
    n: Array


def cabin_air(air: TrueAir, h_msl_m: Array, time_s: Array) -> AirState:
    """The true air of the cabin (n,) at heights [m] and times [s].

    The pressure is ambient up to `CABIN_HOLD_M`, and above that near its value there, with slow
    swings. Temperature and humidity vary in time.
    """
    ambient = air.pressure_pa(h_msl_m)
    held = float(air.pressure_pa(np.array(CABIN_HOLD_M)))
    over_held = (ambient - held) / VALVE_PA
    closed = 1.0 / (1.0 + np.exp(np.clip(over_held, -60.0, 60.0)))
    slow_swing = 220.0 * np.sin(2.0 * np.pi * time_s / 310.0)
    fast_swing = 90.0 * np.sin(time_s / 14.0)
    swing = slow_swing + fast_swing
    pressure = held + VALVE_PA * np.logaddexp(0.0, over_held) + closed * swing
    slow_wave = 1.6 * np.sin(2.0 * np.pi * time_s / 830.0 + 0.7)
    fast_wave = 0.4 * np.sin(2.0 * np.pi * time_s / 121.0)
    temperature = 295.0 + slow_wave + fast_wave
    humidity = 0.30 + 0.03 * np.sin(2.0 * np.pi * time_s / 540.0)
    vapour = humidity * saturation_pressure_pa(temperature)
    return AirState(
        pressure_pa=pressure,
        temperature_k=temperature,
        vapour_pressure_pa=vapour,
        humidity=humidity,
        n=edlen_index(pressure, temperature, vapour),
    )
