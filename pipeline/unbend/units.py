"""Constants, each with its source, and the usual arrays. All in the package is SI and radians."""

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Names = NDArray[np.object_]
Rows = NDArray[np.intp]  # as numpy's functions return row numbers

ARCSEC = math.pi / 648_000.0  # [rad]
DEGREE = math.pi / 180.0  # [rad]
MICRORADIAN = 1e-6  # [rad]
PPM = 1e-6  # parts per million
METRES_OF_A_FOOT = 0.3048  # the international foot
AngleUnit = Literal["deg", "rad", "grad"]
RADIANS: Mapping[AngleUnit, float] = {"deg": DEGREE, "rad": 1.0, "grad": math.pi / 200.0}
HECTOPASCAL = 100.0  # [Pa]
ZERO_CELSIUS_K = 273.15  # [K]
NANOSECONDS_PER_SECOND = 1_000_000_000

# US Standard Atmosphere 1976, table 2 and p. 2-4. The 1976 gas constant is kept on purpose: the
# model's tables are defined by it, not by the CODATA value.
STANDARD_GRAVITY = 9.80665  # G [m2 s-2 m'-1]; also g0 [m s-2]
GAS_CONSTANT_1976 = 8314.32  # R* [J kmol-1 K-1]
MOLAR_MASS_AIR = 28.9644  # M0 [kg kmol-1]
HYDROSTATIC_CONSTANT = STANDARD_GRAVITY * MOLAR_MASS_AIR / GAS_CONSTANT_1976  # [K/m']

# Ratio of the molar masses of water and dry air enters Tv = T / (1 - 0.378 e / p).
VAPOUR_DEFICIT = 0.378

WGS84_A = 6_378_137.0  # [m]
WGS84_F = 1.0 / 298.257223563

LARGEST_NUMBER = 1e12  # of what is measured, in any unit; times and identifiers may be larger
LARGEST_HEIGHT_M = 100_000.0  # no aircraft is as high; 2**32 - 1 stands for an unknown height
LARGEST_EXACT = 2.0**53  # of the whole numbers that a float64 holds without a gap
MOST_FLAGS = (1 << 32) - 1  # of a field: it has 32 bits at most
UNIX_NS_OF_GPS_EPOCH = 315_964_800 * NANOSECONDS_PER_SECOND  # 1980-01-06T00:00:00Z


def round_step(least: float) -> float:
    """The smallest number of the form 1, 2 or 5 times 10**k that is not below ``least`` (> 0).

    >>> [round_step(x) for x in (0.03, 1.0, 2.1, 70.0)]
    [0.05, 1.0, 5.0, 100.0]
    """
    power = math.floor(math.log10(least))
    steps = (float(f"{f}e{power}") for f in (1, 2, 5, 10))
    return next(step for step in steps if step >= least * (1.0 - 1e-9))


def whole_numbers(values: NDArray[Any], lowest: int, highest: int) -> Integers:
    """Numbers of any type as int64: fractions cut off, limited to a range; NaN becomes ``lowest``.

    The limits must be within 2**62 of 0. Numbers are limited before they are converted: numpy turns
    a number that does not fit into 64 bits into any other.

    >>> whole_numbers(np.array([np.nan, -1e300, 7.9, np.inf]), 0, 9).tolist()
    [0, 0, 7, 9]
    >>> whole_numbers(np.array([7, 2**64 - 1], np.uint64), 0, 9).tolist()
    [7, 9]
    """
    kind = values.dtype.kind
    if kind == "u":
        limited = np.minimum(values, np.uint64(highest))
        whole = limited.astype(np.int64)
    elif kind in "bi":
        whole = values.astype(np.int64)
    else:
        with np.errstate(invalid="ignore"):  # signalling NaNs
            numbers = np.asarray(values, np.float64)
        filled = np.where(np.isnan(numbers), lowest, numbers)
        limited = filled.clip(lowest, highest)
        whole = limited.astype(np.int64)
    return np.asarray(whole.clip(lowest, highest))


def measured(values: Array, largest: float = LARGEST_NUMBER) -> Array:
    """A copy of numbers with NaN in place of those beyond +-``largest``, and of infinite ones.

    Nothing that is measured is as large: such numbers stand for unknown values, and their squares
    may overflow.

    >>> measured(np.array([1.5, np.inf, -1e308])).tolist()
    [1.5, nan, nan]
    """
    is_measured = np.abs(values) <= largest
    return np.where(is_measured, values, np.nan)


def exact_integers(values: Array) -> Integers:
    """Whole numbers as int64; raises ValueError for a fraction and for a number beyond +-2**53.

    >>> exact_integers(np.array([7.0, -1.0])).tolist()
    [7, -1]
    """
    is_whole = values == np.floor(values)
    is_exact = is_whole & (np.abs(values) <= LARGEST_EXACT)
    if not bool(is_exact.all()):
        first = values[~is_exact][0]
        raise ValueError(f"{first} is not a whole number of at most 2**53")
    return values.astype(np.int64)


def evenly_spaced(count: int, most: int) -> Integers:
    """At most ``most`` row numbers of ``count`` rows, evenly spaced, with the first and the last.

    >>> evenly_spaced(9, 3).tolist(), evenly_spaced(2, 3).tolist(), evenly_spaced(0, 3).tolist()
    ([0, 4, 8], [0, 1], [])
    """
    last = max(count - 1, 0)
    places = np.linspace(0, last, min(count, most))
    return np.unique(places.round().astype(np.int64))
