"""Which dates a survey can have: not the zero of a clock, and not the future."""

import time

import numpy as np

from unbend.flight.channels import TimeArray
from unbend.units import NANOSECONDS_PER_SECOND, UNIX_NS_OF_GPS_EPOCH, Mask

DAY_NS = 86_400 * NANOSECONDS_PER_SECOND
# 2026-11-01: this release cannot run earlier, even if the clock of a computer is behind.
RELEASED_NS = 1_793_491_200 * NANOSECONDS_PER_SECOND
# 1900-01-01: no aerial survey is older; earlier dates are typing errors.
OLDEST_SURVEY_NS = -2_208_988_800 * NANOSECONDS_PER_SECOND
# A clock that was not set counts from one of these, and for less than a day.
ZEROS_OF_CLOCKS_NS = (0, UNIX_NS_OF_GPS_EPOCH)


def latest_ns() -> int:
    """The latest possible date [Unix ns] of a file that is read now.

    That is a day after the present time of this computer or, if its clock is behind, a day after
    the release.
    """
    return max(time.time_ns(), RELEASED_NS) + DAY_NS


def can_be_flown(time_ns: TimeArray) -> Mask:
    """(n,) True for times [Unix ns] at which a survey can have been flown.

    Films of any age are measured today. Impossible are only times before 1900, the future, and the
    first day of a clock that was not set (1970-01-01, 1980-01-06).

    >>> in_1956, of_unset_clock = -433_000_000 * 10**9, 3_600 * 10**9
    >>> can_be_flown(np.array([in_1956, of_unset_clock, 2_300_000_000 * 10**9])).tolist()
    [True, False, False]
    """
    possible = (time_ns >= OLDEST_SURVEY_NS) & (time_ns <= latest_ns())
    for zero_ns in ZEROS_OF_CLOCKS_NS:
        possible &= (time_ns < zero_ns) | (time_ns >= zero_ns + DAY_NS)
    return np.asarray(possible, np.bool_)
