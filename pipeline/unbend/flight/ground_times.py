"""When the aircraft stood on the ground, and where it took off."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.interpolation import interpolate
from unbend.geodesy import longitudes_near
from unbend.units import NANOSECONDS_PER_SECOND, Array, Integers, Mask

GROUND_RISE_M = 20.0  # an aircraft that stands, this near the lowest height, is on the ground [m]
STILL_M_S = 1.0  # slower than this, over ten seconds, an aircraft does not move [m/s]
WINDOW_S = 10.0
SHORTEST_WINDOW_S = 5.0  # at the ends of a log
FEWEST_SAMPLES = 3
EXTREME_PERCENTILES = (0.5, 99.5)  # of heights: the lowest and the highest ones may be wrong
FLIES_ABOVE_HOME_M = 20.0  # higher above the take-off it does not stand where it took off [m]

HOME_NOT_SET_M = 0.01  # where a height above home is that above the sea, home is not set [m]
AT_SEA_LEVEL_M = 20.0  # a log that comes so near to sea level may have taken off there [m]
_HOME_GAP_S = 5.0  # between heights above home
_MAV_LANDED_STATE_ON_GROUND = 1.0
_LANDED_BY_EVENT = {"EV LAND_COMPLETE": 1.0, "EV NOT_LANDED": 0.0}  # of ArduPilot's texts

_TAKEOFF_NS = 10 * NANOSECONDS_PER_SECOND  # from the begin of a log, in which it stands or moves
_TAKEOFF_MOVE_M = 20.0  # by which receivers wander meanwhile

_EARTH_M = 6.37e6  # only to notice that an aircraft moves: any radius will do


@dataclass(frozen=True, eq=False)
class GroundEvidence:
    """What a log says of whether the aircraft stands on the ground, beside its own motion.

    ``landed`` : channels in which the autopilot says so. ``above_home`` : one with heights above
    the take-off; None without.
    """

    landed: tuple[Channel, ...] = ()
    above_home: Channel | None = None

    @classmethod
    def of(cls, channels: Iterable[Channel]) -> GroundEvidence:
        """The evidence among the channels of a log.

        ``above_home`` is the best position whose heights above the take-off are known.
        """
        filled = [channel for channel in channels if len(channel)]
        landed = [channel for channel in filled if _landed_of(channel) is not None]
        homes = [channel for channel in filled if "home_h_msl_m" in channel.columns]
        home = homes[0] if homes else None
        positions = [channel for channel in filled if "position" in channel.roles]
        for position in sorted(positions, key=lambda channel: channel.rank):
            above_home_m = _above_home(position, home)
            if np.isfinite(above_home_m).any():
                columns = dict(position.columns)
                columns["h_home_m"] = above_home_m
                above_home = replace(position, columns=columns, labels={})
                return cls(tuple(landed), above_home)
        return cls(tuple(landed))

    def landed_at(self, time_ns: TimeArray) -> Array:
        """(n,) 1 where the autopilot last said that it stands, 0 that it flies; NaN before that.

        NaN also where two channels contradict each other.
        """
        landed = np.full(time_ns.shape, np.nan)
        is_contradicted = np.zeros(time_ns.shape, np.bool_)
        for channel in self.landed:
            values = _landed_of(channel)
            if values is None:
                continue
            landed_by_channel = _last_said(channel, values, time_ns)
            is_contradicted |= np.abs(landed_by_channel - landed) > 0.0  # False where one is NaN
            is_unsaid = np.isnan(landed)
            landed = np.where(is_unsaid, landed_by_channel, landed)
        return np.where(is_contradicted, np.nan, landed)

    def flies(self, time_ns: TimeArray) -> Mask:
        """(n,) where the log says that the aircraft is in the air.

        By the autopilot; where that says nothing, by the height above the take-off.
        """
        landed = self.landed_at(time_ns)
        is_high = np.zeros(time_ns.shape, np.bool_)
        if self.above_home is not None:
            gap_s = self.above_home.gap_limit_s(_HOME_GAP_S)
            above_home_m = interpolate(self.above_home, "h_home_m", time_ns, gap_s)
            is_high = above_home_m > FLIES_ABOVE_HOME_M
        says_landed = landed == 1.0
        says_flying = landed == 0.0
        return np.asarray(says_flying | (is_high & ~says_landed))


def _last_said(channel: Channel, values: Array, time_ns: TimeArray) -> Array:
    """(n,) the values of a channel last before instants; NaN before the first."""
    samples_before = np.searchsorted(channel.time_ns, time_ns, side="right")
    last_row = np.maximum(samples_before - 1, 0)
    return np.where(samples_before > 0, values[last_row], np.nan)


def home_is_set(h_msl_m: Array, above_home_m: Array) -> Mask:
    """(n,) where heights above home count from the take-off.

    Before home is set, an autopilot gives the height above the sea for both. Where the two never
    differ, the aircraft took off at sea level, if it comes near to it; else home was never set.
    """
    are_equal = np.abs(h_msl_m - above_home_m) < HOME_NOT_SET_M
    is_set = np.isfinite(above_home_m) & ~are_equal
    if is_set.any() or not are_equal.any():
        return is_set
    nearest_to_sea_m = np.min(np.abs(h_msl_m[are_equal]))
    if nearest_to_sea_m < AT_SEA_LEVEL_M:
        return are_equal
    return is_set  # nowhere


def _above_home(position: Channel, home: Channel | None) -> Array:
    """(n,) heights of a position above the take-off [m]; NaN where that is unknown.

    ``home`` : a channel with the height of the take-off, for positions without heights above it.
    """
    h_msl_m = position.get("h_msl_m")
    above_home_m = position.get("h_home_m")
    if np.isfinite(above_home_m).any():
        is_set = home_is_set(h_msl_m, above_home_m)
        return np.where(is_set, above_home_m, np.nan)
    if home is None:
        return above_home_m
    home_m = _last_said(home, home["home_h_msl_m"], position.time_ns)
    return np.asarray(h_msl_m - home_m)


def _landed_of(channel: Channel) -> Array | None:
    """(n,) 1 where a channel says that the aircraft stands, 0 that it flies; None if it is mute."""
    columns = channel.columns
    if "landed" in columns:
        return columns["landed"]
    if "landed_state" in columns:
        state = columns["landed_state"]
        landed = (state == _MAV_LANDED_STATE_ON_GROUND).astype(np.float64)
        return np.where(np.isfinite(state), landed, np.nan)
    if "flying" in columns:
        return 1.0 - columns["flying"]
    return _landed_by_texts(channel)


def _landed_by_texts(channel: Channel) -> Array | None:
    """(n,) what the last event of an autopilot's texts says: 1 landed, 0 not; NaN before the first.

    None if there is no such event.
    """
    landed = np.full(len(channel), np.nan)
    last_said = np.nan
    for row, text in enumerate(channel.labels.get("text", ())):
        for line in text.splitlines():
            last_said = _LANDED_BY_EVENT.get(line, last_said)
        landed[row] = last_said
    return None if np.isnan(last_said) else landed


NOTHING_SAID = GroundEvidence()


def times_on_the_ground(height: Channel, evidence: GroundEvidence = NOTHING_SAID) -> Integers:
    """Times [Unix ns] at which the aircraft stood on the ground, increasing.

    Those are the times at which all of this holds:

    * The aircraft moves neither along nor up over ten seconds.
    * It is near the lowest height of the log, or the autopilot says that it has landed. In a log
      that never rises, which may be one of a hover, only the autopilot counts.
    * Nothing in the log says that it flies.
    """
    column = height.height_column
    if column is None:
        return np.empty(0, np.int64)
    sum_of_all = height[column] + height["lat_rad"] + height["lon_rad"]
    is_known = np.isfinite(sum_of_all)
    if np.count_nonzero(is_known) < FEWEST_SAMPLES:
        return np.empty(0, np.int64)
    time_ns = height.time_ns[is_known]
    height_m = height[column][is_known]
    lat_rad = height["lat_rad"][is_known]
    lon_rad = height["lon_rad"][is_known]
    still = _stands_still(time_ns, height_m, lat_rad, lon_rad)
    lowest, highest = np.percentile(height_m, EXTREME_PERCENTILES).tolist()
    is_low = height_m < lowest + GROUND_RISE_M
    if highest < lowest + GROUND_RISE_M:  # the log never rises
        is_low[:] = False
    says_landed = evidence.landed_at(time_ns) == 1.0
    is_on_ground = still & (is_low | says_landed) & ~evidence.flies(time_ns)
    return np.asarray(time_ns[is_on_ground])


def _stands_still(time_ns: Integers, height_m: Array, lat_rad: Array, lon_rad: Array) -> Mask:
    """(n,) whether an aircraft moves neither along nor up over ten seconds."""
    seconds = (time_ns - time_ns[0]) * 1e-9
    track = [
        lat_rad * _EARTH_M,
        np.unwrap(lon_rad) * np.cos(lat_rad[0]) * _EARTH_M,
        height_m,
    ]
    # An aircraft that takes off stood still before; one that has landed stands still afterwards.
    stood_still = _moves_little(track, seconds, -WINDOW_S)
    will_stand_still = _moves_little(track, seconds, WINDOW_S)
    return stood_still | will_stand_still


def _moves_little(track: list[Array], seconds: Array, window_s: float) -> Mask:
    """(n,) whether a track moves by less than `STILL_M_S` from each sample to a window away."""
    other = np.clip(seconds + window_s, seconds[0], seconds[-1])
    moved = [np.interp(other, seconds, values) - values for values in track]
    square = np.sum(np.square(moved), axis=0)
    distance = np.sqrt(square)
    lasted = np.abs(other - seconds)  # less than the window near the begin or the end of the log
    is_long = lasted >= SHORTEST_WINDOW_S
    is_slow = distance < STILL_M_S * lasted
    return np.asarray(is_long & is_slow)


@dataclass(frozen=True, eq=False)
class Takeoff:
    """Where the log begins."""

    lat_rad: float
    lon_rad: float
    h_msl_m: float
    stands: bool = True  # the aircraft still stands there, at this height


class LoggedPath(NamedTuple):
    """(n,) times [Unix ns], latitudes, longitudes [rad], heights above sea level [m] of a log."""

    time_ns: TimeArray
    latitude_rad: Array
    longitude_rad: Array
    h_msl_m: Array


def takeoff_of(
    path: LoggedPath, home_m: float | None, evidence: GroundEvidence = NOTHING_SAID
) -> Takeoff | None:
    """Where a log begins; ``home_m`` is the height of the take-off [m], if known.

    The height is ``home_m``, else the one at which the log begins. None if no place is known; also
    if ``home_m`` is unknown and the aircraft moves when the log begins, or flies (as in a hover) by
    the ``evidence`` of the log.
    """
    sum_of_all = path.latitude_rad + path.longitude_rad + path.h_msl_m
    is_known = np.isfinite(sum_of_all)
    if not is_known.any():
        return None
    begin_ns = path.time_ns[is_known][0]
    is_at_begin = is_known & (path.time_ns <= begin_ns + _TAKEOFF_NS)
    time_ns = path.time_ns[is_at_begin]
    lat_rad = path.latitude_rad[is_at_begin]
    lon_rad = path.longitude_rad[is_at_begin]
    lon_rad = longitudes_near(lon_rad, lon_rad[0])
    height_m = path.h_msl_m[is_at_begin]
    moved_m = _extent_m(lat_rad, lon_rad, height_m)
    flies = bool(evidence.flies(time_ns).any())
    stands = moved_m <= _TAKEOFF_MOVE_M and not flies
    if home_m is None and not stands:
        return None
    logged_m = float(np.median(height_m))
    takeoff_m = logged_m if home_m is None else home_m
    is_at_takeoff_height = abs(logged_m - takeoff_m) <= _TAKEOFF_MOVE_M
    return Takeoff(
        lat_rad=float(lat_rad[0]),
        lon_rad=float(lon_rad[0]),
        h_msl_m=takeoff_m,
        stands=stands and is_at_takeoff_height,
    )


def _extent_m(lat_rad: Array, lon_rad: Array, height_m: Array) -> float:
    """By how much places differ, along or up."""
    north_m = float(np.ptp(lat_rad)) * _EARTH_M
    east_m = float(np.ptp(lon_rad)) * math.cos(lat_rad[0]) * _EARTH_M
    up_m = float(np.ptp(height_m))
    return max(math.hypot(north_m, east_m), up_m)
