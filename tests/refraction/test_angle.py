"""One angle in the units people use: each by hand from the radians."""

from __future__ import annotations

import math

import pytest

from unbend.refraction.angle import one_angle


def test_each_unit_is_that_of_its_key():
    angle = one_angle("us1976", 10_000.0, 500.0, 60.0, index="gyer", radius=6.378e6)
    assert angle["r_c_arcsec"] == pytest.approx(angle["r_c_rad"] * 180.0 * 3600.0 / math.pi)
    assert angle["r_c_urad"] == pytest.approx(angle["r_c_rad"] * 1e6)
    # On a plane: dH (tan zeta - tan(zeta - R)); the curvature of the earth adds 1 %.
    flat = 9500.0 * (math.tan(math.pi / 3) - math.tan(math.pi / 3 - angle["r_c_rad"]))
    assert angle["ground_m"] == pytest.approx(flat, rel=0.02)
    given = ("camera_height_m", "ground_height_m", "nadir_angle_deg", "radius_m", "distance_m")
    assert [angle[key] for key in given] == [10_000.0, 500.0, 60.0, 6.378e6, None]
    assert (angle["atmosphere"], angle["index"], angle["method"]) == ("us1976", "gyer", "spherical")
    assert angle["status"] == "ok"


def test_index_and_method_are_those_asked_for():
    default = one_angle("us1976", 6000.0, 0.0, 45.0)["r_c_rad"]
    gyer = one_angle("us1976", 6000.0, 0.0, 45.0, index="gyer")["r_c_rad"]
    plane = one_angle("us1976", 6000.0, 0.0, 45.0, method="plane")["r_c_rad"]
    # n - 1 at 0.55 um is 0.25 % above that at 0.589 um (Ciddor's dispersion).
    assert default / gyer == pytest.approx(1.0025, abs=0.001)
    assert 1e-5 < 1.0 - plane / default < 5e-3
