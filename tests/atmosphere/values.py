"""Values that the package is compared with, computed apart from it."""

import math

import numpy as np
import pytest

from tests.atmosphere.flights import geopotential
from unbend.simulate.true_air import saturation_pressure_pa

HYDROSTATIC_K_PER_M = 9.80665 * 28.9644 / 8314.32


def metres(geopotential_m, degrees):
    """The height above the sea of a geopotential height [m'] at a latitude, in normal gravity."""
    h = geopotential_m
    for _ in range(6):  # each takes 99.5 % of what is left
        h += geopotential_m - float(geopotential(math.radians(degrees), h))
    return h


def saturated_pa(celsius):
    """Saturation pressure over water (Sonntag 1990)."""
    return float(saturation_pressure_pa(np.array(celsius + 273.15)))


def saturated(celsius, share=1.0):
    """Share of saturation as the package may state it: Sonntag and Davis differ by 0.5 %."""
    return pytest.approx(share * saturated_pa(celsius), rel=0.01, nan_ok=math.isnan(celsius))
