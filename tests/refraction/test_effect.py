"""R in the air of a flight beside the standard."""

import math

import numpy as np
import pytest

from tests.refraction.comparing import assert_close
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.refraction import refraction_angle
from unbend.refraction.effect import effects_on_r

FLIGHT = standard_atmosphere("icao", index="gyer")
STANDARD = standard_atmosphere("us1962")


def test_the_factor_is_that_of_the_flight_over_the_standard():
    effects = effects_on_r(FLIGHT, STANDARD, None, 6000.0, 200.0)
    assert [effect.nadir_deg for effect in effects] == [45.0, 75.0]
    for effect in effects:
        zeta = math.radians(effect.nadir_deg)
        r_of_flight = refraction_angle(FLIGHT, 6000.0, 200.0, zeta)
        r_of_standard = refraction_angle(STANDARD, 6000.0, 200.0, zeta)
        assert_close(effect.factor, r_of_flight / r_of_standard, rtol=1e-14)
        assert effect.factor != 1.0
        assert_close(effect.r_c_rad, r_of_flight, rtol=1e-14)
        assert (effect.h_c_m, effect.h_g_m) == (6000.0, 200.0)
        assert math.isnan(effect.sigma_factor)


def test_sigma_of_the_factor_is_that_of_the_pressure():
    """Gyer's N, and R to two thousandths, are proportional to the pressure, known to 1 % here."""
    edges = FLIGHT.layers.edge.size
    variance = np.zeros(2 * edges + 1)
    variance[edges] = 0.01**2
    covariance = ProfileCovariance(FLIGHT, 0.0, np.diag(variance))
    for effect in effects_on_r(FLIGHT, STANDARD, covariance, 6000.0, 200.0):
        assert_close(effect.sigma_factor, 0.01 * effect.factor, rtol=2e-3)


@pytest.mark.parametrize(
    ("h_c", "h_g"),
    [
        (200.0, 6000.0),
        (200.0, 200.0),
        (201.0, 200.0),
    ],
)
def test_no_ray_looks_down_no_effect(h_c, h_g):
    assert effects_on_r(FLIGHT, STANDARD, None, h_c, h_g) == ()
