"""Sensors with constant values although the aircraft moved: they are stuck, or never sent.

A real sensor changes in its last digit even at rest. Other sensors show whether the flight moved:
a receiver cannot show that it is stuck itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence import messages
from unbend.flight.mount import is_of_gimbal
from unbend.geodesy import principal_radii, wrapped
from unbend.messages import Notes
from unbend.units import Array

FEWEST_SAMPLES = 20  # fewer may be equal by chance
LEAST_WAY_M = 300.0  # between the farthest places of a flight that moved
LEAST_CLIMB_M = 50.0  # 600 Pa at sea level: a barometer that does not show it is stuck
LEAST_CLIMB_OF_AIR_M = 300.0  # 2 K: a layer of constant temperature may be thinner than this
LEAST_PRESSURE_PA = 600.0  # 50 m at sea level
EXTREME_PERCENTILES = (1.0, 99.0)  # between these, as a few samples may be wrong
# Angles from quaternions have errors of 1e-15; logs have them to 1e-4 at best.
EQUAL_RAD = 1e-7
MOST_PITCH_RAD = float(np.radians(80.0))  # beyond, roll and yaw are not distinct
MOST_ROWS = 20_000  # of a long channel about so many rows are used

_ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class _Motion:
    """How far a flight went over the ground, how much it climbed, and its change of pressure.

    The methods describe each in words; the text is empty if the motion is too small to count.
    """

    way_m: float
    climb_m: float
    drop_pa: float

    @classmethod
    def of(cls, roles: Mapping[str, Channel]) -> "_Motion":
        """The motion that the channels of a flight show."""
        return cls(
            way_m=_way(roles.get("position")),
            climb_m=_spread(_known(roles, "height", _height_column(roles))),
            drop_pa=_spread(_known(roles, "pressure", "pressure_pa")),
        )

    def way(self) -> str:
        """The way over the ground in words; "" below `LEAST_WAY_M`."""
        if self.way_m < LEAST_WAY_M:
            return ""
        return f"the flight spans {self.way_m:.0f} m"

    def climb(self, least_m: float) -> str:
        """The climb in words; "" below ``least_m``."""
        if self.climb_m < least_m:
            return ""
        return f"the heights span {self.climb_m:.0f} m"

    def drop(self) -> str:
        """The change of pressure in words; "" below `LEAST_PRESSURE_PA`."""
        if self.drop_pa < LEAST_PRESSURE_PA:
            return ""
        return f"the pressure changes by {self.drop_pa:.0f} Pa"


def constant_sensors(roles: Mapping[str, Channel]) -> Notes:
    """A finding for each role with values that are all equal in a flight that moved.

    ``roles``: the channel of each, with plausible samples only.
    """
    motion = _Motion.of(roles)
    climb = motion.climb(LEAST_CLIMB_M)
    climb_of_air = motion.climb(LEAST_CLIMB_OF_AIR_M)
    drop = motion.drop()
    moved = motion.way() or climb  # where the way is long, one of latitude and longitude changes
    return (
        *_constant_column(roles, "pressure", "pressure_pa", climb),
        *_constant_column(roles, "temperature", "temperature_k", climb_of_air),
        *_constant_column(roles, "height", _height_column(roles), drop),
        *_constant_column(roles, "position", "lat_rad", moved or drop),
        *_constant_column(roles, "position", "lon_rad", moved or drop),
        *_constant_attitude(roles.get("attitude"), moved),
    )


def _height_column(roles: Mapping[str, Channel]) -> str:
    """The name of the column with the heights of a flight; "" without any."""
    height = roles.get("height")
    if height is None:
        return ""
    return height.height_column or ""


def _constant_column(roles: Mapping[str, Channel], role: str, column: str, moved: str) -> Notes:
    """A finding if all known values of a role's column are equal to the last digit.

    ``moved`` : the motion of the flight in words; no finding if it is "".
    """
    known_values = _known(roles, role, column)
    if (
        not moved
        or known_values.size < FEWEST_SAMPLES
        or not bool(np.all(known_values == known_values[0]))
    ):
        return ()
    finding = messages.sensor_constant(
        channel=roles[role].name,
        role=role,
        what=_value_in_words(column, float(known_values[0])),
        count=known_values.size,
        moved=moved,
    )
    return (finding,)


def _value_in_words(column: str, value: float) -> str:
    """A value as a message quotes it: angles in degrees, the rest in the column's unit."""
    if column.endswith("_rad"):
        angle = column.removesuffix("_rad")
        return f"{angle} = {np.degrees(value):.7f}°"
    return f"{column} = {value:.8g}"


def _constant_attitude(attitude: Channel | None, moved: str) -> Notes:
    """A finding if an attitude angle of the aircraft is constant; a gimbal may keep an angle.

    ``moved`` : the motion of the flight in words; no finding if it is "".
    """
    if not moved or attitude is None or is_of_gimbal(attitude.source.message):
        return ()
    angles = _angles_of(attitude)
    if angles.shape[0] < FEWEST_SAMPLES:
        return ()
    stuck = []
    for name, angle_rad in zip(_ANGLES, angles.T, strict=True):
        from_first_rad = wrapped(angle_rad - angle_rad[0])
        if np.abs(from_first_rad).max() < EQUAL_RAD:
            first_deg = np.degrees(angle_rad[0])
            stuck.append(f"{name} = {first_deg:.2f}°")
    if not stuck:
        return ()
    finding = messages.sensor_constant(
        channel=attitude.name,
        role="attitude",
        what=", ".join(stuck),
        count=len(attitude),
        moved=moved,
    )
    return (finding,)


def _angles_of(attitude: Channel) -> Array:
    """(m, 3) roll, pitch and yaw [rad] of known attitudes with a pitch up to `MOST_PITCH_RAD`.

    Of a long channel every k-th row is used.
    """
    step = -(-len(attitude) // MOST_ROWS)  # rounded up
    w = attitude["q_w"][::step]
    x = attitude["q_x"][::step]
    y = attitude["q_y"][::step]
    z = attitude["q_z"][::step]
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x**2 + y**2))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))
    angles = np.stack([roll, pitch, yaw], axis=1)
    return np.asarray(angles[np.abs(pitch) < MOST_PITCH_RAD])


def _known(roles: Mapping[str, Channel], role: str, column: str) -> Array:
    """The known values of a column of a role's channel; empty without the role or the column."""
    channel = roles.get(role)
    if channel is None or column not in channel.columns:
        return np.empty(0)
    values = channel[column]
    return np.asarray(values[np.isfinite(values)])


def _spread(values: Array) -> float:
    """The range of values between `EXTREME_PERCENTILES`; 0 without any."""
    if not values.size:
        return 0.0
    lowest, highest = np.percentile(values, EXTREME_PERCENTILES)
    return float(highest - lowest)


def _way(position: Channel | None) -> float:
    """The extent of a flight over the ground [m], the larger of north and east; 0 if unknown."""
    if position is None:
        return 0.0
    lat_rad = position["lat_rad"]
    lon_rad = position["lon_rad"]
    is_known = np.isfinite(lat_rad + lon_rad)
    if not is_known.any():
        return 0.0
    meridian_m, prime_vertical_m = principal_radii(float(np.median(lat_rad[is_known])))
    north_m = _spread(lat_rad[is_known]) * meridian_m
    from_first_rad = wrapped(lon_rad[is_known] - lon_rad[is_known][0])
    east_m = _spread(from_first_rad) * prime_vertical_m * np.cos(np.median(lat_rad[is_known]))
    return max(float(north_m), float(east_m))
