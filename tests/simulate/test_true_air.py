"""The true air against published figures and against the equations it claims to solve."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from unbend.simulate.true_air import (
    edlen_index,
    normal_gravity,
    relative_humidity,
    temperature_k,
    true_air,
    vapour_pressure_pa,
)

LATITUDE = np.radians(47.4)


def test_normal_gravity_at_equator_pole_and_aloft():
    assert normal_gravity(0.0, 0.0) == pytest.approx(9.7803253359, rel=1e-10)
    assert normal_gravity(np.pi / 2.0, 0.0) == pytest.approx(9.8321849378, rel=1e-10)
    fall = normal_gravity(np.pi / 4.0, 0.0) - normal_gravity(np.pi / 4.0, 1000.0)
    assert fall == pytest.approx(3.086e-3, rel=1e-3)  # the free-air gradient, 0.3086 mGal/m


def test_pressure_obeys_the_hydrostatic_equation():
    air = true_air(LATITUDE)
    h = np.linspace(-80.0, 30_000.0, 400)
    slope = (air.pressure_pa(h + 0.5) - air.pressure_pa(h - 0.5)) / 1.0
    p = air.pressure_pa(h)
    t = temperature_k(h)
    e = vapour_pressure_pa(h)
    # molar masses [kg/kmol]
    dry = (p - e) * 28.9644
    vapour = e * 28.9644 * 0.622
    density = (dry + vapour) / (8314.32 * t)
    gravity = np.array([normal_gravity(LATITUDE, x) for x in h])
    assert_allclose(slope, -density * gravity, rtol=2e-6)
    assert float(air.pressure_pa(np.array(450.0))) == pytest.approx(96_850.0, rel=1e-12)


def test_index_and_its_slope_belong_together():
    air = true_air(LATITUDE)
    h = np.linspace(-50.0, 12_000.0, 997)
    direct = edlen_index(air.pressure_pa(h), temperature_k(h), vapour_pressure_pa(h))
    assert_allclose(
        air.n(h),
        direct,
        rtol=0.0,
        atol=2e-14,
    )
    slope = (air.n(h + 1.0) - air.n(h - 1.0)) / 2.0
    assert_allclose(
        air.dn_dh(h),
        slope,
        rtol=0.0,
        atol=3e-12,
    )


def test_the_air_is_no_standard():
    h = np.array([450.0, 1000.0, 2000.0, 3450.0])
    warmer = temperature_k(h) - (288.15 - 6.5e-3 * h)
    assert np.all(warmer > 3.0)
    assert temperature_k(np.array(1480.0)) - temperature_k(np.array(1220.0)) > 3.0
    assert relative_humidity(np.array(2000.0)) < 0.5 * relative_humidity(np.array(900.0))
