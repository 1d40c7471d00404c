"""Gyer's tables of refraction angles against the converged integral."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import unbend
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.refractive_index import refractivity_gyer
from unbend.refraction import refraction_angle
from unbend.refraction.window import refract_at_window
from unbend.units import ARCSEC, DEGREE

DATA = Path(unbend.__file__).parent / "refraction" / "data"
GYER_RADIUS_M = 6_378_000.0


def table(name: str) -> list[dict[str, float]]:
    with (DATA / name).open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def ardc1959():
    return standard_atmosphere("ardc1959", index="gyer")


def tables_3_4(profile) -> tuple[np.ndarray, np.ndarray]:
    rows = table("gyer1996_tables3_4.csv")
    h_c, h_g, zeta, printed = (
        np.array([row[key] for row in rows])
        for key in ("h_c_km", "h_g_km", "zeta_c_deg", "r_c_arcsec")
    )
    r_c = refraction_angle(profile, h_c * 1e3, h_g * 1e3, zeta * DEGREE, radius=GYER_RADIUS_M)
    return r_c / ARCSEC, printed


def test_tables_3_and_4(ardc1959):
    """Gyer 1996, Tables 3 and 4, carry the error of a 1 km step: reference/README.md, 2."""
    exact, printed = tables_3_4(ardc1959)
    assert exact.shape == (440,)
    near = np.abs(exact.round(2) - printed) <= 0.02 + 1e-9
    # Reached: 85.9 % in printed digits (83.2 % before our own value is rounded).
    assert near.mean() >= 0.84
    # The worst entry, h_c = 25 km, h_g = 0, 85 deg: printed 465.69, true 457.86.
    worst = np.abs(exact - printed).argmax()
    assert printed[worst] == 465.69
    assert exact[worst] == pytest.approx(457.86, abs=0.006)


def test_the_tables_know_their_atmosphere():
    exact, printed = tables_3_4(standard_atmosphere("us1976", index="gyer"))
    assert (np.abs(exact - printed) <= 0.02).mean() < 0.8


def test_the_tables_catch_a_flipped_sign_and_hectopascals(ardc1959):
    exact, printed = tables_3_4(ardc1959)
    for mutant in (-exact, 0.01 * exact, exact * 206_264.8 / 206_265.8 * 1.01):
        assert (np.abs(mutant - printed) <= 0.02).mean() < 0.3


def test_table_7(ardc1959):
    """Gyer 1996, Table 7: zeta_c = zeta_f = 45 deg, 294.26 K in the cabin."""
    ray = np.array([[math.sqrt(0.5), 0.0, math.sqrt(0.5)]])
    for row in table("gyer1996_table7.csv"):
        h_c = row["h_c_km"] * 1e3
        outside = float(ardc1959.refractivity(h_c))
        assert outside * 1e6 == pytest.approx(row["n_c_minus_1_e6"], abs=0.0151)
        # 701.2 mbar above 3 km, the pressure outside below.
        pressure = max(701.2e2, float(ardc1959.pressure(h_c)))
        cabin = float(refractivity_gyer(294.26, pressure))
        assert cabin * 1e6 == pytest.approx(row["n_cc_minus_1_e6"], abs=0.0151)
        r_cc = float(refract_at_window(ray, cabin, outside)[1][0]) / ARCSEC
        assert r_cc == pytest.approx(row["r_cc_arcsec"], abs=0.01)
        r_c = refraction_angle(ardc1959, h_c, 0.0, 45.0 * DEGREE, GYER_RADIUS_M) / ARCSEC
        assert r_c == pytest.approx(row["r_c_arcsec"], abs=0.012)
        assert r_c - r_cc == pytest.approx(row["r_c_minus_r_cc_arcsec"], abs=0.02)


@pytest.mark.parametrize(
    ("metres", "degrees", "arcsec"), [(120, 45, 0.33), (10_000, 45, 16.4), (10_000, 85, 212.0)]
)
def test_the_sizes_the_manual_states(metres, degrees, arcsec):
    """PHYSICS.md, "How big it is"."""
    angle = refraction_angle(standard_atmosphere(), metres, 0.0, degrees * DEGREE) / ARCSEC
    assert angle == pytest.approx(arcsec, rel=0.01)
