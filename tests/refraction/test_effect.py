"""R in the air of a flight beside the standard."""

from __future__ import annotations

import math

import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import refraction_angle
from unbend.refraction.effect import effects_on_r


def test_the_factor_is_that_of_the_flight_over_the_standard():
    cold = standard_atmosphere("icao", index="gyer")
    standard = standard_atmosphere("us1962")
    effects = effects_on_r(cold, standard, None, 6000.0, 200.0)
    assert [e.nadir_deg for e in effects] == [45.0, 75.0]
    for effect in effects:
        zeta = math.radians(effect.nadir_deg)
        r, theirs = (refraction_angle(air, 6000.0, 200.0, zeta) for air in (cold, standard))
        assert effect.factor == pytest.approx(r / theirs, rel=1e-14)
        assert effect.factor != 1.0
    assert effects_on_r(cold, standard, None, 200.0, 6000.0) == ()
