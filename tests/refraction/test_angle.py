"""One angle in the units people use: each by hand from the radians."""

import math

import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_close, assert_near
from unbend.errors import PhysicsError
from unbend.refraction.angle import one_angle


def test_each_unit_is_that_of_its_key():
    angle = one_angle("us1976", 10_000.0, 500.0, 60.0, index="gyer", radius=6.378e6)
    r_c = angle["r_c_rad"]
    assert angle["r_c_arcsec"] == pytest.approx(r_c * 180.0 * 3600.0 / math.pi)
    assert angle["r_c_urad"] == pytest.approx(r_c * 1e6)
    # On a plane: dH (tan zeta - tan(zeta - R)); the curvature of the earth adds 1 %.
    flat = 9500.0 * (math.tan(math.pi / 3) - math.tan(math.pi / 3 - r_c))
    assert_close(angle["ground_m"], flat, rtol=0.02)
    inputs = {
        "status": "ok",
        "atmosphere": "us1976",
        "index": "gyer",
        "method": "spherical",
        "camera_height_m": 10_000.0,
        "ground_height_m": 500.0,
        "nadir_angle_deg": 60.0,
        "distance_m": None,
        "radius_m": 6.378e6,
    }
    assert {key: angle[key] for key in inputs} == inputs


def test_index_and_method_are_those_asked_for():
    ray = ("us1976", 6000.0, 0.0, 45.0)
    default = one_angle(*ray)["r_c_rad"]
    gyer = one_angle(*ray, index="gyer")["r_c_rad"]
    plane = one_angle(*ray, method="plane")["r_c_rad"]
    # n - 1 at 0.55 um is 0.25 % above that at 0.589 um (Ciddor's dispersion).
    assert_near(default / gyer, 1.0025, 0.001)
    assert 1e-5 < 1.0 - plane / default < 5e-3


@pytest.mark.parametrize("distance", [0.0, -1.0, math.inf, math.nan])
def test_what_is_no_slant_range_is_refused(distance):
    with refused("ANGLE-DISTANCE", PhysicsError):
        one_angle("us1976", 3000.0, 2800.0, 89.0, distance=distance)
