"""Sensors whose values never change although the aircraft moved: they are stuck, or never sent.

A real sensor changes in its last digit even at rest. Whether the flight moved, other sensors say:
a receiver cannot show that it is stuck itself.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence import messages
from unbend.flight.mount import is_of_gimbal
from unbend.geodesy import principal_radii, wrapped
from unbend.messages import Message, Notes
from unbend.units import Array

FEWEST_SAMPLES = 20  # fewer may be equal by chance
LEAST_WAY_M = 300.0  # between the farthest places of a flight that moves
LEAST_CLIMB_M = 50.0  # 600 Pa: a barometer at sea level that shows less is stuck
LEAST_CLIMB_OF_AIR_M = 300.0  # 2 K: less may hide in a layer of constant temperature
LEAST_PRESSURE_PA = 600.0  # 50 m at sea level
MOST_VALUES = (1.0, 99.0)  # percentiles: a few wrong samples are no motion
# Angles come back from quaternions with errors of 1e-15; logs have them to 1e-4 at best.
EQUAL_RAD = 1e-7
MOST_PITCH_RAD = float(np.radians(80.0))  # beyond, roll and yaw cannot be told apart
MOST_ROWS = 20_000  # of a long channel, evenly taken

_ANGLES = ("roll", "pitch", "yaw")


class _Motion(NamedTuple):
    """How far a flight moved, by each kind of sensor; 0 where no sensor shows it."""

    climb_m: float  # span of the heights
    way_m: float  # extent over the ground
    drop_pa: float  # span of the pressures

    @property
    def climb(self) -> str:
        """The climb in words."""
        return f"the heights span {self.climb_m:.0f} m"

    @property
    def way(self) -> str:
        """The way over the ground in words."""
        return f"the flight spans {self.way_m:.0f} m"

    @property
    def drop(self) -> str:
        """The change of the pressure in words."""
        return f"the pressure changes by {self.drop_pa:.0f} Pa"


def constant_sensors(roles: Mapping[str, Channel]) -> Notes:
    """A finding for each role whose values are all equal in a flight that moved.

    ``roles``: the channel of each, with plausible samples only.
    """
    height = roles.get("height")
    height_column = "" if height is None else height.height_column or ""
    motion = _Motion(
        climb_m=_span(roles, "height", height_column),
        way_m=_way(roles.get("position")),
        drop_pa=_span(roles, "pressure", "pressure_pa"),
    )
    notes: list[Message] = []
    if motion.climb_m >= LEAST_CLIMB_M:
        notes += _constant_column(roles, "pressure", "pressure_pa", motion.climb)
    if motion.climb_m >= LEAST_CLIMB_OF_AIR_M:
        notes += _constant_column(roles, "temperature", "temperature_k", motion.climb)
    if motion.drop_pa >= LEAST_PRESSURE_PA:
        notes += _constant_column(roles, "height", height_column, motion.drop)
    notes += _constant_position(roles, motion)
    if motion.way_m >= LEAST_WAY_M:
        notes += _constant_attitude(roles.get("attitude"), motion.way)
    elif motion.climb_m >= LEAST_CLIMB_M:
        notes += _constant_attitude(roles.get("attitude"), motion.climb)
    return tuple(notes)


def _constant_position(roles: Mapping[str, Channel], motion: _Motion) -> Notes:
    """A finding if latitude or longitude never changes, and the other one or a climb shows motion.

    A flight along a meridian changes its longitude in the last digits, too.
    """
    if motion.way_m >= LEAST_WAY_M:
        moved = motion.way
    elif motion.climb_m >= LEAST_CLIMB_M:
        moved = motion.climb
    elif motion.drop_pa >= LEAST_PRESSURE_PA:
        moved = motion.drop
    else:
        return ()
    latitude = _constant_column(roles, "position", "lat_rad", moved)
    longitude = _constant_column(roles, "position", "lon_rad", moved)
    return (*latitude, *longitude)


def _constant_column(roles: Mapping[str, Channel], role: str, column: str, moved: str) -> Notes:
    """A finding if all known values of a role's column are equal to the last digit."""
    known = _known(roles, role, column)
    if known.size < FEWEST_SAMPLES or not bool(np.all(known == known[0])):
        return ()
    value = float(known[0])
    if column.endswith("_rad"):
        what = f"{column.removesuffix('_rad')} = {np.degrees(value):.7f}°"
    else:
        what = f"{column} = {value:.8g}"
    return (_finding(roles[role], role, what, known.size, moved),)


def _constant_attitude(attitude: Channel | None, moved: str) -> Notes:
    """A finding if an angle of the aircraft never changes. A gimbal may hold an angle."""
    if attitude is None or is_of_gimbal(attitude.source.message):
        return ()
    angles = _angles_of(attitude)
    if angles.shape[0] < FEWEST_SAMPLES:
        return ()
    stuck = []
    for name, angle_rad in zip(_ANGLES, angles.T, strict=True):
        from_first_rad = np.abs(wrapped(angle_rad - angle_rad[0]))
        if bool(np.all(from_first_rad < EQUAL_RAD)):
            stuck.append(f"{name} = {np.degrees(angle_rad[0]):.2f}°")
    if not stuck:
        return ()
    what = ", ".join(stuck)
    return (_finding(attitude, "attitude", what, len(attitude), moved),)


def _angles_of(attitude: Channel) -> Array:
    """(m, 3) roll, pitch and yaw [rad] of known attitudes, of a long channel evenly chosen ones."""
    step = -(-len(attitude) // MOST_ROWS)
    w = attitude["q_w"][::step]
    x = attitude["q_x"][::step]
    y = attitude["q_y"][::step]
    z = attitude["q_z"][::step]
    # The elements of the rotation matrix that the angles follow from.
    r_32 = 2.0 * (w * x + y * z)
    r_33 = 1.0 - 2.0 * (x**2 + y**2)
    r_31 = 2.0 * (z * x - w * y)
    r_21 = 2.0 * (w * z + x * y)
    r_11 = 1.0 - 2.0 * (y**2 + z**2)
    roll = np.arctan2(r_32, r_33)
    pitch = np.arcsin(np.clip(-r_31, -1.0, 1.0))
    yaw = np.arctan2(r_21, r_11)
    angles = np.stack([roll, pitch, yaw], axis=1)
    return np.asarray(angles[np.abs(pitch) < MOST_PITCH_RAD])


def _finding(channel: Channel, role: str, what: str, count: int, moved: str) -> Message:
    """The finding of a channel in a role."""
    return messages.sensor_constant(
        channel=channel.name, role=role, what=what, count=count, moved=moved
    )


def _known(roles: Mapping[str, Channel], role: str, column: str) -> Array:
    """The known values of a column of a role's channel; empty without the role or the column."""
    channel = roles.get(role)
    if channel is None or column not in channel.columns:
        return np.empty(0)
    values = channel[column]
    return np.asarray(values[np.isfinite(values)])


def _span(roles: Mapping[str, Channel], role: str, column: str) -> float:
    """The highest minus the lowest value of a column of a role's channel; 0 without any."""
    return _spread(_known(roles, role, column))


def _spread(values: Array) -> float:
    """The highest minus the lowest of values, without single wrong ones; 0 without any."""
    if not values.size:
        return 0.0
    lowest, highest = np.percentile(values, MOST_VALUES)
    return float(highest - lowest)


def _way(position: Channel | None) -> float:
    """The extent of a flight over the ground [m], north or east; 0 without positions."""
    if position is None:
        return 0.0
    lat_rad = position["lat_rad"]
    lon_rad = position["lon_rad"]
    known = np.isfinite(lat_rad + lon_rad)
    if not known.any():
        return 0.0
    known_lat_rad = lat_rad[known]
    known_lon_rad = lon_rad[known]
    latitude_rad = float(np.median(known_lat_rad))
    meridian_m, prime_vertical_m = principal_radii(latitude_rad)
    north_m = _spread(known_lat_rad) * meridian_m
    from_first_rad = wrapped(known_lon_rad - known_lon_rad[0])
    parallel_m = prime_vertical_m * np.cos(latitude_rad)
    east_m = _spread(from_first_rad) * parallel_m
    return max(float(north_m), float(east_m))
