"""The lens in the air, with the figures of Meier. Expected values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import Camera, Exposures, correct_observations, ray_table
from unbend.refraction.camera.camera import LensInAir, is_absurd, principal_change

# A lens of 153 mm on pixels of 7.65 um, calibrated on the ground.
PITCH_MM = 0.00765
REFERENCE_PA = 101_325.0
REFERENCE_K = 293.15
# At 6 km in US 1976, and in a cabin kept at 701.2 hPa and 21.1 degC.
AT_6_KM = (47_217.6, 249.187)
IN_CABIN = (70_120.0, 294.26)


def lens(mm_per_hpa: float, mm_per_k: float) -> LensInAir:
    return LensInAir(
        153.0 / PITCH_MM,
        REFERENCE_PA,
        REFERENCE_K,
        mm_per_hpa / PITCH_MM / 100.0,
        mm_per_k / PITCH_MM,
    )


@pytest.mark.parametrize(
    ("mm_per_k", "in_the_open_mm"), [(3.1e-5, -0.036), (2.8e-4, -0.047)], ids=["least", "most"]
)
def test_meiers_figures_follow_from_one_pair_of_derivatives(mm_per_k, in_the_open_mm):
    """-0.020 mm behind a window: 312 hPa less; the cold of 6 km makes the rest."""
    mine = lens(6.4e-5, mm_per_k)
    behind_window = float(principal_change(mine, *IN_CABIN)) * PITCH_MM
    in_the_open = float(principal_change(mine, *AT_6_KM)) * PITCH_MM
    assert behind_window == pytest.approx(-0.020, abs=0.0005)
    assert in_the_open == pytest.approx(in_the_open_mm, abs=0.0005)
    assert 127.0 < -behind_window / 153.0 * 1e6 < 132.0
    assert 230.0 < -in_the_open / 153.0 * 1e6 < 311.0


def test_the_reference_changes_nothing_and_each_derivative_acts_alone():
    mine = LensInAir(20_000.0, 90_000.0, 280.0, px_per_pa=1e-4, px_per_k=-0.02)
    assert float(principal_change(mine, 90_000.0, 280.0)) == 0.0
    assert float(principal_change(mine, 80_000.0, 280.0)) == pytest.approx(-1.0)
    assert float(principal_change(mine, 90_000.0, 300.0)) == pytest.approx(-0.4)
    both = principal_change(mine, np.array([80_000.0, 90_000.0, math.nan]), 300.0)
    assert both[:2] == pytest.approx([-1.4, -0.4])
    assert np.isnan(both[2])


def test_more_than_one_percent_is_absurd():
    mine = LensInAir(20_000.0, REFERENCE_PA, REFERENCE_K, 0.0, 0.0)
    assert is_absurd(mine, [0.0, 199.0, -199.0, 201.0, -201.0, math.nan]).tolist() == [
        False,
        False,
        False,
        True,
        True,
        False,
    ]


def test_a_longer_principal_distance_puts_the_same_ray_farther_out():
    """By hand: u = 0.3 stands at 7000 + 11000 * 0.3 calibrated, 12 * 0.3 px farther in flight."""
    u = 0.3
    v = -0.2
    flown = np.array([7000.0 + 11_012.0 * u]), np.array([5300.0 + 11_012.0 * v])
    calibrated = np.array([7000.0 + 11_000.0 * u]), np.array([5300.0 + 11_000.0 * v])
    camera = Camera(14_000, 10_600, 11_000.0, 11_000.0, 7000.0, 5300.0)
    air = standard_atmosphere("us1976")

    def corrected(x, y, change_px):
        n = np.atleast_1d(air.refractivity(3000.0))
        exposures = Exposures(
            np.array([True]),
            np.diag([1.0, -1.0, -1.0])[None],
            np.zeros(1),
            np.array([3000.0]),
            n,
            n,
            principal_change_px=np.array([change_px]),
        )
        return correct_observations(
            x, y, np.zeros(1), np.zeros(1, np.int64), exposures, camera=camera, table=ray_table(air)
        )

    changed = corrected(*flown, 12.0)
    unchanged = corrected(*calibrated, 0.0)
    assert changed.x_corrected_px[0] == pytest.approx(unchanged.x_corrected_px[0], abs=1e-9)
    assert changed.y_corrected_px[0] == pytest.approx(unchanged.y_corrected_px[0], abs=1e-9)
    assert changed.dx_px[0] - unchanged.dx_px[0] == pytest.approx(-12.0 * u, abs=1e-9)
    assert changed.dy_px[0] - unchanged.dy_px[0] == pytest.approx(-12.0 * v, abs=1e-9)
    assert changed.r_c_rad[0] == pytest.approx(unchanged.r_c_rad[0], rel=1e-12)
