"""The pressures and heights of ECMWF's 137 model levels, from the top down.

A level is between two half levels, of pressure a + b p_s over a surface pressure p_s.
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
    """(2, 138): a [Pa] and b of the half levels, from the top down."""
    coefficients = []
    for row in rows_of("ecmwf_l137.csv"):
        a_pa = float(row["a_pa"])
        b = float(row["b"])
        coefficients.append([a_pa, b])
    return np.array(coefficients).T


def half_levels(surface_pa: Array) -> Array:
    """(n, 138) pressures [Pa] of the half levels, from the top down, over n places.

    ``surface_pa``: surface pressures (n,) or (n, 1) [Pa].

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
    """(n, l) geopotential heights [m'] of l model levels, from the top down, over n places.

    half : (n, l + 1) pressures [Pa] of the half levels, from the top down to the surface.
    virtual : (n, l) virtual temperatures of the levels [K].
    surface : (n,) geopotential heights of the ground [m'].

    By the hydrostatic equation in the form of the model (IFS documentation CY41R2, part III, Eq.
    2.21 to 2.23); agrees with an integrated column to 1e-4 of p up to 30 km.
    """
    upper = half[:, :-1]
    lower = half[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(lower / upper)
        difference = np.diff(half, axis=1)
        alpha = 1.0 - upper / difference * log_ratio
    # The uppermost layer of the model ends at the pressure 0: its thickness is infinite, and no
    # level above needs it.
    ends_at_no_pressure = half[:, 0] <= 0.0
    alpha[ends_at_no_pressure, 0] = math.log(2.0)
    log_ratio[ends_at_no_pressure, 0] = 0.0
    thickness = virtual * log_ratio / HYDROSTATIC_CONSTANT
    tops_from_ground_up = np.cumsum(thickness[:, ::-1], axis=1)
    bases = tops_from_ground_up[:, ::-1] - thickness  # of the layers, above the ground
    in_layer = alpha * virtual / HYDROSTATIC_CONSTANT
    return np.asarray(surface[:, None] + bases + in_layer)
