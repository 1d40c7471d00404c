"""NRLMSIS 2.1 through the package pymsis: temperature only, because it knows no water."""

from __future__ import annotations

import math

import numpy as np

from pipeline.atmosphere.climate_tables import hydrostatic_profile
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.refractive_index import IndexModel
from pipeline.errors import PhysicsError
from pipeline.geodesy import Gravity
from pipeline.units import DEGREE

MSIS = "nrlmsis2.1"
MSIS_ORIGIN = "NRLMSIS 2.1 (Emmert et al. 2022), temperature only"

_TOP_M, _STEP_M = 80_000.0, 500.0
_TEMPERATURE = 10  # column of pymsis.Variable.TEMPERATURE
# Solar flux and geomagnetic index do not reach below 80 km: given, so that nothing is downloaded.
_SOLAR_FLUX, _GEOMAGNETIC = 150.0, 4.0


def msis_profile(
    latitude_rad: float,
    longitude_rad: float,
    month: float,
    surface_pa: float,
    index: IndexModel | None,
    gravity: Gravity,
) -> Profile:
    """The dry profile of NRLMSIS 2.1 at a place and season, at noon UTC.

    ``month`` : 1.0 is mid-January; ``surface_pa`` : pressure at sea level [Pa], which the model's
    temperatures are put on. Valid to 80 km. Source: Emmert et al. 2022, NRLMSIS 2.1,
    doi:10.1029/2022JA030896. Raises ``PhysicsError`` where pymsis is not installed.
    """
    try:
        import pymsis
    except ImportError:
        raise PhysicsError(
            "ATMOSPHERE-MSIS",
            "NRLMSIS 2.1 needs the package pymsis, which is not installed",
            remedy='pip install "unbend[msis]", or take another climatology',
        ) from None
    day = math.floor(((month - 1.0) % 12.0) / 12.0 * 365.25) + 14
    date = np.datetime64("2001-01-01T12:00") + np.timedelta64(day % 365, "D")
    h = np.arange(0.0, _TOP_M + 1.0, _STEP_M)
    answer = pymsis.calculate(
        date,
        longitude_rad / DEGREE,
        latitude_rad / DEGREE,
        h / 1000.0,
        f107s=[_SOLAR_FLUX],
        f107as=[_SOLAR_FLUX],
        aps=[[_GEOMAGNETIC] * 7],
        version=2.1,
    )
    t = np.asarray(answer, dtype=np.float64).reshape(h.size, -1)[:, _TEMPERATURE]
    edge = gravity.geopotential_height(h)
    return hydrostatic_profile(edge, t, np.zeros_like, surface_pa, gravity, index, MSIS)
