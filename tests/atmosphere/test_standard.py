"""Standard atmospheres against the tables that define them."""

import math

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.atmosphere.flights import DATA
from tests.helpers import refused
from unbend.atmosphere import standard_atmosphere
from unbend.errors import PhysicsError


def test_us1976_against_an_independent_implementation():
    """Above 79 km fluids gives the kinetic, the profile the molecular-scale temperature."""
    fluids = pytest.importorskip("fluids.atmosphere", reason="the fluids package is not installed")
    profile = standard_atmosphere("us1976")
    h = np.linspace(-1000.0, 78_000.0, 80)
    airs = [fluids.ATMOSPHERE_1976(height) for height in h.tolist()]
    assert_allclose(
        profile.temperature(h),
        [air.T for air in airs],
        rtol=1e-9,
    )
    assert_allclose(
        profile.pressure(h),
        [air.P for air in airs],
        rtol=1e-9,
    )


PRESSURES = pd.read_csv(DATA / "standard_atmospheres_pressures.csv")


@pytest.mark.parametrize(
    ("model", "name", "at_sea_k", "tropopause_k"),
    [
        ("US76", "us1976", 288.15, 216.65),
        ("US62", "us1962", 288.15, 216.65),
        ("ICAO93_ISO2533", "icao", 288.15, 216.65),
        ("ARDC59", "ardc1959", 288.16, 216.66),
        ("ICAN_Brunt", "ican", 288.0, 216.5),
    ],
)
def test_what_the_definitions_state(model, name, at_sea_k, tropopause_k):
    """Temperatures at the sea and at 11 km'; heights and pressures at the base of every layer.

    These were computed by another program; a temperature that is wrong shows in the pressure above
    it. The table prints height to 0.1 m; near the top of the profile that matters.
    """
    rows = PRESSURES[PRESSURES.model == model]
    assert len(rows) >= 3
    profile = standard_atmosphere(name)
    h = profile.gravity.height(rows.H_gpm.to_numpy(float))
    assert h == pytest.approx(rows.z_m_geometric_r0.to_numpy(), abs=0.06)
    hpa = profile.pressure(h) / 100.0
    assert_allclose(hpa, rows.p_hPa.to_numpy(), rtol=1e-6)
    tropopause = profile.gravity.height(11_000.0)
    assert profile.temperature(0.0) == pytest.approx(at_sea_k, abs=1e-9)
    assert profile.temperature(tropopause) == pytest.approx(tropopause_k, abs=1e-6)
    # Below the sea the lapse rate goes on.
    assert profile.bottom_m < -4990.0
    assert profile.temperature(-430.0) > at_sea_k + 2.7
    assert profile.pressure(-430.0) > 1.05 * profile.pressure(0.0)


@pytest.mark.parametrize(
    "quantity",
    [
        "temperature",
        "pressure",
        "refractivity",
    ],
)
def test_values_have_the_shape_of_heights_and_are_nan_outside(quantity):
    profile = standard_atmosphere("ican")
    value = getattr(profile, quantity)
    outside = [profile.bottom_m - 1.0, profile.top_m + 1.0, np.nan]
    assert np.isnan(value(outside)).all()
    assert value(0.0).shape == ()
    assert value(np.zeros((2, 3))).shape == (2, 3)
    assert value([]).shape == (0,)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"name": "us1967"}, "ATMOSPHERE-NAME"),
        ({"latitude": 47.0}, "ATMOSPHERE-LATITUDE"),
        ({"latitude": math.nan}, "ATMOSPHERE-LATITUDE"),
    ],
)
def test_unknown_name_and_degrees_for_radians_are_refused(options, code):
    with refused(code, PhysicsError):
        standard_atmosphere(**options)
