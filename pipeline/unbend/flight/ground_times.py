"""When the aircraft was on the ground, and where it took off."""

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

GROUND_RISE_M = 20.0  # an aircraft at rest, this near the lowest height, is on the ground [m]
STILL_M_S = 1.0  # slower than this, over ten seconds, an aircraft is at rest [m/s]
WINDOW_S = 10.0  # over which an aircraft at rest does not move
SHORTEST_WINDOW_S = 5.0  # the same at the ends of a log
FEWEST_SAMPLES = 3  # with fewer, no times on the ground are determined
EXTREME_PERCENTILES = (0.5, 99.5)  # of heights: the lowest and the highest ones may be wrong
FLIES_ABOVE_HOME_M = 20.0  # higher above the take-off point an aircraft is in the air [m]

HOME_NOT_SET_M = 0.01  # heights above home and above the sea this near are equal: no home is set
AT_SEA_LEVEL_M = 20.0  # a log that comes so near to sea level may have taken off there [m]
_HOME_GAP_S = 5.0  # between heights above home
_MAV_LANDED_STATE_ON_GROUND = 1.0
_LANDED_BY_EVENT = {"EV LAND_COMPLETE": 1.0, "EV NOT_LANDED": 0.0}  # of ArduPilot's texts

_TAKEOFF_NS = (
    10 * NANOSECONDS_PER_SECOND
)  # the begin of a log, in which the aircraft may be at rest
_TAKEOFF_MOVE_M = 20.0  # receivers at rest wander by less in this time

_EARTH_M = 6.37e6  # only to notice that an aircraft moves: any radius will do


@dataclass(frozen=True, eq=False)
class GroundEvidence:
    """Evidence of a log for an aircraft on the ground or in the air, in addition to its motion.

    ``landed`` : channels in which the autopilot reports either. ``above_home`` : a channel with
    heights above the take-off point (``h_home_m``); None if there is none.
    """

    landed: tuple[Channel, ...] = ()
    above_home: Channel | None = None

    @classmethod
    def of(cls, channels: Iterable[Channel]) -> GroundEvidence:
        """The evidence in the channels of a log.

        ``above_home`` is the best position for which heights above the take-off are known.
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
        """(n,) the last report of the autopilot at times: 1 on the ground, 0 in the air.

        NaN before the first report, and where two channels contradict each other.
        """
        landed = np.full(time_ns.shape, np.nan)
        is_contradicted = np.zeros(time_ns.shape, np.bool_)
        for channel in self.landed:
            values = _landed_of(channel)
            if values is None:
                continue
            landed_by_channel = _last_values(channel, values, time_ns)
            is_contradicted |= np.abs(landed_by_channel - landed) > 0.0  # False where either is NaN
            is_unknown = np.isnan(landed)
            landed = np.where(is_unknown, landed_by_channel, landed)
        return np.where(is_contradicted, np.nan, landed)

    def flies(self, time_ns: TimeArray) -> Mask:
        """(n,) True where the log shows that the aircraft is in the air.

        By the report of the autopilot; where that is unknown, by the height above the take-off.
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


def _last_values(channel: Channel, values: Array, time_ns: TimeArray) -> Array:
    """(n,) values at the last sample of a channel at or before instants; NaN before the first.

    ``values`` : one for each sample of the channel.
    """
    samples_until = np.searchsorted(channel.time_ns, time_ns, side="right")
    last_row = np.maximum(samples_until - 1, 0)
    return np.where(samples_until > 0, values[last_row], np.nan)


def home_is_set(h_msl_m: Array, above_home_m: Array) -> Mask:
    """(n,) True where a height above home is really above the take-off point (home).

    Before home is set, autopilots log the height above the sea as both heights. If the two are
    equal in the whole log, the aircraft took off at sea level if its height comes near to 0; else
    home was not set at all.
    """
    are_equal = np.abs(h_msl_m - above_home_m) < HOME_NOT_SET_M
    is_set = np.isfinite(above_home_m) & ~are_equal
    if is_set.any() or not are_equal.any():
        return is_set
    nearest_to_sea_m = np.min(np.abs(h_msl_m[are_equal]))
    if nearest_to_sea_m < AT_SEA_LEVEL_M:
        return are_equal
    return is_set  # False everywhere


def _above_home(position: Channel, home: Channel | None) -> Array:
    """(n,) heights of a position above the take-off point [m]; NaN where unknown.

    They are those of the position itself, else follow from ``home``: a channel with the height of
    the take-off point above sea level.
    """
    h_msl_m = position.get("h_msl_m")
    above_home_m = position.get("h_home_m")
    if np.isfinite(above_home_m).any():
        is_set = home_is_set(h_msl_m, above_home_m)
        return np.where(is_set, above_home_m, np.nan)
    if home is None:
        return above_home_m
    home_m = _last_values(home, home["home_h_msl_m"], position.time_ns)
    return np.asarray(h_msl_m - home_m)


def _landed_of(channel: Channel) -> Array | None:
    """(n,) reports of a channel: 1 on the ground, 0 in the air, NaN unknown.

    None if the channel has no such column, and no such event among its texts.
    """
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
    """(n,) by the last landing event of an autopilot's texts: 1 landed, 0 not.

    NaN before the first such event. None if there is none.
    """
    landed = np.full(len(channel), np.nan)
    last_event = np.nan
    for row, text in enumerate(channel.labels.get("text", ())):
        for line in text.splitlines():
            last_event = _LANDED_BY_EVENT.get(line, last_event)
        landed[row] = last_event
    return None if np.isnan(last_event) else landed


NOTHING_SAID = GroundEvidence()


def times_on_the_ground(height: Channel, evidence: GroundEvidence = NOTHING_SAID) -> Integers:
    """The times of samples of ``height`` [Unix ns] at which the aircraft is on the ground.

    Three conditions must be met:

    * The aircraft moves neither horizontally nor vertically over ten seconds.
    * It is near the lowest height of the log, or the autopilot reports that it has landed. In a log
      of constant height, which may be that of a hover, only the autopilot counts.
    * The log does not show that it flies (`GroundEvidence.flies`).
    """
    column = height.height_column
    if column is None:
        return np.empty(0, np.int64)
    sum_of_all = height[column] + height["lat_rad"] + height["lon_rad"]  # NaN if one is NaN
    is_known = np.isfinite(sum_of_all)
    if np.count_nonzero(is_known) < FEWEST_SAMPLES:
        return np.empty(0, np.int64)
    time_ns = height.time_ns[is_known]
    height_m = height[column][is_known]
    lat_rad = height["lat_rad"][is_known]
    lon_rad = height["lon_rad"][is_known]
    is_at_rest = _is_at_rest(time_ns, height_m, lat_rad, lon_rad)
    lowest, highest = np.percentile(height_m, EXTREME_PERCENTILES).tolist()
    is_low = height_m < lowest + GROUND_RISE_M
    if highest < lowest + GROUND_RISE_M:  # the height is constant
        is_low[:] = False
    reports_landed = evidence.landed_at(time_ns) == 1.0
    is_on_ground = is_at_rest & (is_low | reports_landed) & ~evidence.flies(time_ns)
    return np.asarray(time_ns[is_on_ground])


def _is_at_rest(time_ns: Integers, height_m: Array, lat_rad: Array, lon_rad: Array) -> Mask:
    """(n,) True where an aircraft does not move over the ten seconds before or after a sample."""
    seconds = (time_ns - time_ns[0]) * 1e-9
    track = [
        lat_rad * _EARTH_M,
        np.unwrap(lon_rad) * np.cos(lat_rad[0]) * _EARTH_M,
        height_m,
    ]
    # Before a take-off it was at rest until then; after a landing it is at rest from then on.
    is_still_before = _moves_little(track, seconds, -WINDOW_S)
    is_still_after = _moves_little(track, seconds, WINDOW_S)
    return is_still_before | is_still_after


def _moves_little(track: list[Array], seconds: Array, window_s: float) -> Mask:
    """(n,) True where a track moves more slowly than `STILL_M_S` over a window from each sample.

    ``track``: (n,) metres along each of three axes; ``seconds``: (n,) times; ``window_s``: negative
    for the time before a sample.
    """
    other = np.clip(seconds + window_s, seconds[0], seconds[-1])
    moved = [np.interp(other, seconds, values) - values for values in track]
    square = np.sum(np.square(moved), axis=0)
    distance = np.sqrt(square)
    interval = np.abs(other - seconds)  # shorter than the window near the ends of the log
    is_long = interval >= SHORTEST_WINDOW_S
    is_slow = distance < STILL_M_S * interval
    return np.asarray(is_long & is_slow)


@dataclass(frozen=True, eq=False)
class Takeoff:
    """The place where a log begins, with the height of the take-off."""

    lat_rad: float
    lon_rad: float
    h_msl_m: float
    stands: bool = True  # the aircraft is at rest when the log begins, and at this height


class LoggedPath(NamedTuple):
    """(n,) times [Unix ns], latitudes, longitudes [rad], heights above sea level [m] of a log."""

    time_ns: TimeArray
    latitude_rad: Array
    longitude_rad: Array
    h_msl_m: Array


def takeoff_of(
    path: LoggedPath, home_m: float | None, evidence: GroundEvidence = NOTHING_SAID
) -> Takeoff | None:
    """The place where a log begins, with the height of the take-off; None if it is unknown.

    ``home_m`` : height of the take-off above sea level [m]; None if unknown. Then the height is
    that at which the log begins, if the aircraft is at rest there. It is not if it moves by more
    than receivers wander, or flies (as in a hover) by the ``evidence`` of the log.
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
    """The extent of places [m]: horizontal or vertical, whichever is larger."""
    north_m = float(np.ptp(lat_rad)) * _EARTH_M
    east_m = float(np.ptp(lon_rad)) * math.cos(lat_rad[0]) * _EARTH_M
    up_m = float(np.ptp(height_m))
    return max(math.hypot(north_m, east_m), up_m)
