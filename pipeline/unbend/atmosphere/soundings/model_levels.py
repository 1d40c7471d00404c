"""The pressures and heights of ECMWF's 137 model levels.

They lie between half levels of pressure a + b p_s over a surface pressure p_s;
`data/ecmwf_l137.csv` has a and b of ECMWF's L137 definition (a to six decimals, b to nine digits as
in its GRIB files).
"""

import math
from functools import cache

import numpy as np

from unbend.atmosphere.climate_tables import rows_of
from unbend.units import HYDROSTATIC_CONSTANT, Array

MODEL_LEVELS = 137  # of ERA5 and of ECMWF's forecasts since 2013


@cache
def level_coefficients() -> Array:
    """(2, 138): a [Pa] and b of the half levels."""
    coefficients = []
    for row in rows_of("ecmwf_l137.csv"):
        a_pa = float(row["a_pa"])
        b = float(row["b"])
        coefficients.append([a_pa, b])
    return np.array(coefficients).T


def half_levels(surface_pa: Array) -> Array:
    """(n, 138) pressures [Pa] of the half levels over surface pressures (n,) or (n, 1) [Pa].

    >>> half_levels(np.array([101325.0]))[0, [1, 100, 136, 137]].round(2).tolist()
    [2.0, 60016.68, 101084.87, 101325.0]
    """
    a, b = level_coefficients()
    column = np.reshape(surface_pa, (-1, 1))
    return np.asarray(a + b * column)


def level_pressures(half: Array) -> Array:
    """(n, l) pressures [Pa] of model levels between half levels (n, l + 1)."""
    upper = half[:, :-1]
    lower = half[:, 1:]
    return np.asarray(0.5 * (lower + upper))


def level_heights(
    half: Array,
    virtual: Array,
    surface: Array,
) -> Array:
    """(n, l) geopotential heights [m'] of model levels, from the ground ``surface`` (n,) up.

    ``half`` (n, l + 1) pressures of the half levels about them, ``virtual`` T_M [K] on them. By the
    hydrostatic equation in the model's own form (IFS documentation CY41R2, part III, Eq. 2.21 to
    2.23); against an integrated column 1e-4 of p up to 30 km.
    """
    upper = half[:, :-1]
    lower = half[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = np.log(lower / upper)
        difference = np.diff(half, axis=1)
        alpha = 1.0 - upper / difference * fall
    ends_at_no_pressure = half[:, 0] <= 0.0  # the uppermost layer
    alpha[ends_at_no_pressure, 0] = math.log(2.0)
    fall[ends_at_no_pressure, 0] = 0.0
    thickness = virtual * fall / HYDROSTATIC_CONSTANT
    from_ground_up = np.cumsum(thickness[:, ::-1], axis=1)
    below = from_ground_up[:, ::-1] - thickness
    in_layer = alpha * virtual / HYDROSTATIC_CONSTANT
    return np.asarray(surface[:, None] + below + in_layer)
