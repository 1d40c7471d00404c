"""R in the air of a flight beside the standard."""

from __future__ import annotations

import math

import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import refraction_angle
from unbend.refraction.effect import Effect, effects_on_r


def test_the_factor_is_that_of_the_flight_over_the_standard():
    cold, standard = standard_atmosphere("icao", index="gyer"), standard_atmosphere("us1962")
    effects = effects_on_r(cold, standard, None, 6000.0, 200.0)
    assert [e.nadir_deg for e in effects] == [45.0, 75.0]
    for effect in effects:
        zeta = math.radians(effect.nadir_deg)
        r, theirs = (refraction_angle(air, 6000.0, 200.0, zeta) for air in (cold, standard))
        assert effect.factor == pytest.approx(r / theirs, rel=1e-14)
        assert effect.factor != 1.0
    assert effects_on_r(cold, standard, None, 200.0, 6000.0) == ()


def test_the_row_of_the_manifest():
    """10 urad for 8 in the standard, sigma 0.4: 2.0626 and 1.6501 arcsec, factor 1.25 +- 0.05."""
    row = Effect(45.0, 6000.04, 200.0, 10e-6, 8e-6, 0.4e-6).row()
    assert row == {
        "nadir_angle_deg": 45.0, "h_c_m": 6000.0, "h_g_m": 200.0, "r_c_arcsec": 2.0626,
        "standard_arcsec": 1.6501, "sigma_arcsec": 0.0825, "factor": 1.25, "sigma_factor": 0.05,
    }  # fmt: skip
    unknown = Effect(45.0, 6000.0, 200.0, 10e-6, 8e-6).row()
    assert unknown["sigma_arcsec"] is unknown["sigma_factor"] is None
