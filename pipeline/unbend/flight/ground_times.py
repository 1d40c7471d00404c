"""When the aircraft stood on the ground."""

import numpy as np

from unbend.flight.channels import Channel
from unbend.units import Array, Integers, Mask

GROUND_RISE_M = 20.0  # an aircraft that stands, this near the lowest height, is on the ground [m]
STILL_M_S = 1.0  # slower than this, over ten seconds, an aircraft does not move [m/s]
WINDOW_S = 10.0
SHORTEST_WINDOW_S = 5.0  # at the ends of a log
FEWEST_SAMPLES = 3
LOWEST_PERCENTILE = 0.5  # of heights: the lowest ones may be wrong

_EARTH_M = 6.37e6  # only to notice that an aircraft moves: any radius will do


def times_on_the_ground(height: Channel) -> Integers:
    """Times [Unix ns] at which the aircraft stood on the ground, increasing.

    It stands where it moves neither along nor up over ten seconds, near the lowest height of the
    log; so each landing and take-off of a log with several flights is seen.
    """
    column = height.height_column
    if column is None:
        return np.empty(0, np.int64)
    known = np.isfinite(height[column] + height["lat_rad"] + height["lon_rad"])
    if np.count_nonzero(known) < FEWEST_SAMPLES:
        return np.empty(0, np.int64)
    time_ns = height.time_ns[known]
    height_m = height[column][known]
    lat_rad = height["lat_rad"][known]
    lon_rad = np.unwrap(height["lon_rad"][known])
    seconds = (time_ns - time_ns[0]) * 1e-9
    north_m = lat_rad * _EARTH_M
    east_m = lon_rad * np.cos(lat_rad[0]) * _EARTH_M
    track = [north_m, east_m, height_m]
    # Until it takes off it stood still before, and from the landing on it stands still afterwards.
    stood_still = _moves_little(track, seconds, -WINDOW_S)
    will_stand_still = _moves_little(track, seconds, WINDOW_S)
    still = stood_still | will_stand_still
    lowest = float(np.percentile(height_m, LOWEST_PERCENTILE))
    return np.asarray(time_ns[still & (height_m < lowest + GROUND_RISE_M)])


def _moves_little(track: list[Array], seconds: Array, window_s: float) -> Mask:
    """(n,) whether a track moves by less than `STILL_M_S` from each sample to a window away."""
    other = np.clip(seconds + window_s, seconds[0], seconds[-1])
    moved = [np.interp(other, seconds, values) - values for values in track]
    distance = np.sqrt(np.sum(np.square(moved), axis=0))
    lasted = np.abs(other - seconds)  # of a log that began in the air there is no half of it
    return np.asarray((lasted >= SHORTEST_WINDOW_S) & (distance < STILL_M_S * lasted))
