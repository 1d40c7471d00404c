"""When the aircraft stood on the ground."""

import numpy as np

from unbend.flight.channels import Channel
from unbend.units import Integers

# An aircraft that does not move, this near the lowest height of the log, is on the ground [m].
GROUND_RISE_M = 20.0
_EARTH_M = 6.37e6
STILL_M_S = 1.0  # slower than this, over ten seconds, an aircraft does not move [m/s]


def times_on_the_ground(height: Channel) -> Integers:
    """Times [Unix ns] at which the aircraft stood on the ground, increasing.

    It stands where it moves neither along nor up over ten seconds, near the lowest height of the
    log; so each landing and take-off of a log with several flights is seen.
    """
    column = height.height_column
    known = np.isfinite(height["lat_rad"] if column is None else height[column] + height["lat_rad"])
    if column is None or known.sum() < 3:
        return np.empty(0, np.int64)
    time_ns, h, lat = height.time_ns[known], height[column][known], height["lat_rad"][known]
    seconds = (time_ns - time_ns[0]) * 1e-9
    east = np.unwrap(height["lon_rad"][known]) * np.cos(lat[0])
    track = (lat * _EARTH_M, east * _EARTH_M, h)
    still = np.zeros(h.size, np.bool_)
    # The ten seconds before see the take-off, the ten seconds after the landing.
    for window_s in (-10.0, 10.0):
        other = np.clip(seconds + window_s, seconds[0], seconds[-1])
        moved = [np.interp(other, seconds, values) - values for values in track]
        lasted = np.abs(other - seconds)  # of a log that began in the air there is no half of it
        still |= (lasted >= 5.0) & (np.sqrt(np.sum(np.square(moved), axis=0)) < STILL_M_S * lasted)
    lowest = float(np.percentile(h, 0.5))
    return np.asarray(time_ns[still & (h < lowest + GROUND_RISE_M)])
