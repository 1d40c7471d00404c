"""The refractive index against published values and against an independent formula."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import unbend
from tests.helpers import refused
from unbend.atmosphere.refractive_index import (
    IndexModel,
    refractivity_ciddor,
    refractivity_gyer,
    saturation_vapour_pressure,
    vapour_pressure,
    virtual_temperature,
)
from unbend.errors import PhysicsError
from unbend.simulate.true_air import edlen_index, saturation_pressure_pa

PRINTED = Path(unbend.__file__).parent / "refraction" / "data"

COLUMNS = ["temperature_k", "pressure_mbar", "refractivity_n_minus_1_e6"]

# t [C], RH [%], p [kPa], wavelength [nm] -> (n - 1) 1e9 of Ciddor's equation at 450 ppm of CO2.
# Rows 1-9: Ciddor (1996), Appl. Opt. 35, 1566, and the NIST Engineering Metrology Toolbox.
CIDDOR = """
20 0 101.325 633 271800
20 0 60 633 160924
20 0 120 633 321916
50 0 100 633 243285
5 0 100 633 282756
-40 0 100 633 337580
50 100 120 633 287924
40 75 120 633 299418
20 100 100 633 267394
40 100 110 1700 270247
20 0 101.325 1700 268479
40 100 110 300 289000
20 0 101.325 300 286581
-40 0 120 300 427233
"""


@pytest.mark.parametrize("row", CIDDOR.strip().splitlines())
def test_ciddor_check_values_to_a_part_in_a_thousand_million(row):
    """Reached: 0.75 of the last printed digit."""
    celsius, percent, kpa, nanometres, published = map(float, row.split())
    t = celsius + 273.15
    p = 1e3 * kpa
    e = vapour_pressure(percent / 100.0, t, p)
    n = refractivity_ciddor(t, p, e, wavelength_m=nanometres * 1e-9)
    assert 1e9 * n == pytest.approx(published, abs=1.0)


@pytest.mark.parametrize("micrometres", [0.45, 0.55, 0.65])
def test_ciddor_agrees_with_the_modified_edlen_equation(micrometres):
    """Independent formula (Birch and Downs 1994). Reached: 4.7e-8 in n, at 250 K."""
    rng = np.random.default_rng(5)
    t = rng.uniform(250.0, 310.0, 300)
    p = rng.uniform(3e4, 1.05e5, 300)
    e = rng.uniform(0.0, 0.8, 300) * saturation_pressure_pa(t)
    ciddor = refractivity_ciddor(t, p, e, wavelength_m=micrometres * 1e-6)
    edlen = edlen_index(p, t, e, micrometres) - 1.0
    assert ciddor == pytest.approx(edlen, abs=5e-8)


def test_carbon_dioxide_refracts_by_its_share():
    """Ciddor, Eq. 2: 0.534e-6 for each ppm more than 450."""
    at_450 = refractivity_ciddor(288.15, 101_325.0, co2_ppm=450.0)
    at_1450 = refractivity_ciddor(288.15, 101_325.0, co2_ppm=1450.0)
    assert_allclose(at_1450 / at_450 - 1.0, 0.534e-3, rtol=1e-9)


def test_vapour_lowers_the_index_of_gyer():
    dry = refractivity_gyer(300.0, 1e5, 0.0)
    moist = refractivity_gyer(300.0, 1e5, 3000.0)
    assert_allclose(dry - moist, 11.036e-6 * 30.0 / 300.0, rtol=1e-9)


def test_gyer_eq_13_against_his_table_2():
    table = pd.read_csv(PRINTED / "gyer1996_table2.csv")
    t, mbar, n = table[COLUMNS].to_numpy().T
    # T and p are printed to 0.005, so Eq. 13 of them is uncertain by about 0.01e-6.
    computed = refractivity_gyer(t, 100.0 * mbar)
    assert 1e6 * computed == pytest.approx(n, abs=0.012)


@pytest.mark.parametrize(
    ("celsius", "steam_table_pa"), {0.01: 611.66, 10.0: 1228.2, 20.0: 2339.3, 40.0: 7384.9}.items()
)
def test_saturation_pressure_agrees_with_steam_tables(celsius, steam_table_pa):
    """IAPWS-IF97 saturation pressures."""
    saturated = saturation_vapour_pressure(celsius + 273.15)
    assert_allclose(saturated, steam_table_pa, rtol=4e-4)


def test_saturation_over_supercooled_water_agrees_with_sonntag():
    t = np.linspace(233.15, 323.15, 91)
    assert_allclose(saturation_vapour_pressure(t), saturation_pressure_pa(t), rtol=4e-3)


def test_humidity_is_a_fraction_of_saturation():
    half = vapour_pressure(0.5, 293.15, 101_325.0)
    saturated = vapour_pressure(1.0, 293.15, 101_325.0)
    assert_allclose(saturated / half, 2.0, rtol=1e-14)
    # Enhancement factor of water over 1 atm at 20 C: 1.0040 (Hyland 1975).
    assert_allclose(half, 0.5 * 1.0040 * 2339.3, rtol=2e-4)


def test_virtual_temperature_gives_the_density_of_moist_air():
    t = 300.0
    p = 1e5
    e = 3000.0
    molar_mass_dry = 28.9644
    molar_mass_water = 18.01528
    density = ((p - e) * molar_mass_dry + e * molar_mass_water) / t
    as_dry = p * molar_mass_dry / virtual_temperature(t, p, e)
    assert_allclose(as_dry, density, rtol=1e-5)


@pytest.mark.parametrize("metres", [0.55, 550.0, 0.1e-6, float("nan")])
def test_a_wavelength_in_the_wrong_unit_is_refused(metres):
    with refused("AIR-WAVELENGTH", PhysicsError):
        refractivity_ciddor(288.15, 101_325.0, wavelength_m=metres)


def test_an_unknown_index_is_refused():
    with refused("AIR-INDEX", PhysicsError, remedy="ciddor"):
        IndexModel("edlen")
