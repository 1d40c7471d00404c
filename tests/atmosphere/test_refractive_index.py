"""The refractive index against published values and against an independent formula."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import unbend
from unbend.atmosphere import refractive_index as air
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

# t [C], RH [%], p [kPa], wavelength [nm] -> (n - 1) 1e9 of Ciddor's equation at 450 ppm of CO2.
# Rows 1-9: Ciddor (1996), Appl. Opt. 35, 1566, and the NIST Engineering Metrology Toolbox.
CIDDOR = [
    (20, 0, 101.325, 633, 271_800),
    (20, 0, 60, 633, 160_924),
    (20, 0, 120, 633, 321_916),
    (50, 0, 100, 633, 243_285),
    (5, 0, 100, 633, 282_756),
    (-40, 0, 100, 633, 337_580),
    (50, 100, 120, 633, 287_924),
    (40, 75, 120, 633, 299_418),
    (20, 100, 100, 633, 267_394),
    (40, 100, 110, 1700, 270_247),
    (20, 0, 101.325, 1700, 268_479),
    (40, 100, 110, 300, 289_000),
    (20, 0, 101.325, 300, 286_581),
    (-40, 0, 120, 300, 427_233),
]


def worst_ciddor_miss() -> float:
    """Largest departure from the published check values, in units of 1e-9 of n."""
    misses = []
    for celsius, humidity, kpa, nanometres, published in CIDDOR:
        t = celsius + 273.15
        p = kpa * 1e3
        e = air.vapour_pressure(humidity / 100.0, t, p)
        n = air.refractivity_ciddor(t, p, e, wavelength_m=nanometres * 1e-9)
        misses.append(abs(float(n) * 1e9 - published))
    return max(misses)


def test_ciddor_check_values_to_a_part_in_a_thousand_million():
    # Reached: 0.75 of the last printed digit.
    assert worst_ciddor_miss() <= 1.0


@pytest.mark.parametrize("factor", [0.01, 1.0001], ids=["hPa for Pa", "pressure off by 1e-4"])
def test_the_check_values_catch_a_wrong_pressure(monkeypatch, factor):
    right = air.refractivity_ciddor
    monkeypatch.setattr(
        air, "refractivity_ciddor", lambda t, p, e, **kw: right(t, p * factor, e, **kw)
    )
    assert worst_ciddor_miss() > 10.0


def test_ciddor_agrees_with_the_modified_edlen_equation():
    # Independent formula (Birch and Downs 1994). Reached: 4.7e-8 in n, at 250 K.
    rng = np.random.default_rng(5)
    t = rng.uniform(250.0, 310.0, 300)
    p = rng.uniform(3e4, 1.05e5, 300)
    e = rng.uniform(0.0, 0.8, 300) * saturation_pressure_pa(t)
    for micrometres in (0.45, 0.55, 0.65):
        ours = refractivity_ciddor(t, p, e, wavelength_m=micrometres * 1e-6)
        theirs = edlen_index(p, t, e, micrometres) - 1.0
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=5e-8)


def test_dispersion_has_the_size_the_manual_states():
    # Against 0.589 um: +1.22 % of n - 1 at 0.45 um, -0.30 % at 0.65 um.
    at = {
        um: float(refractivity_ciddor(288.15, 101_325.0, wavelength_m=um * 1e-6))
        for um in (0.45, 0.589, 0.65)
    }
    assert 100.0 * (at[0.45] / at[0.589] - 1.0) == pytest.approx(1.22, abs=0.01)
    assert 100.0 * (at[0.65] / at[0.589] - 1.0) == pytest.approx(-0.30, abs=0.01)


def test_more_carbon_dioxide_refracts_more():
    more = refractivity_ciddor(288.15, 101_325.0, co2_ppm=1450.0)
    less = refractivity_ciddor(288.15, 101_325.0, co2_ppm=450.0)
    assert 0.0 < float(more / less - 1.0) < 1e-3


def test_vapour_lowers_the_index_in_both_formulas():
    dry = refractivity_gyer(300.0, 1e5, 0.0)
    moist = refractivity_gyer(300.0, 1e5, 3000.0)
    assert float(dry - moist) == pytest.approx(11.036e-6 * 30.0 / 300.0, rel=1e-9)
    dry = refractivity_ciddor(300.0, 1e5, 0.0)
    moist = refractivity_ciddor(300.0, 1e5, 3000.0)
    assert 0.9e-6 < float(dry - moist) < 1.3e-6


def test_gyer_eq_13_against_his_table_2():
    with (PRINTED / "gyer1996_table2.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    for row in rows:
        n = refractivity_gyer(row["temperature_k"], row["pressure_mbar"] * 100.0)
        # T and p are printed to 0.005, so Eq. 13 of them is uncertain by about 0.01e-6.
        assert float(n) * 1e6 == pytest.approx(row["refractivity_n_minus_1_e6"], abs=0.012)


@pytest.mark.parametrize(
    ("celsius", "steam_table_pa"), [(0.01, 611.66), (10.0, 1228.2), (20.0, 2339.3), (40.0, 7384.9)]
)
def test_saturation_pressure_agrees_with_steam_tables(celsius, steam_table_pa):
    # IAPWS-IF97 saturation pressures.
    assert float(saturation_vapour_pressure(celsius + 273.15)) == pytest.approx(
        steam_table_pa, rel=4e-4
    )


def test_saturation_over_supercooled_water_agrees_with_sonntag():
    t = np.linspace(233.15, 323.15, 91)
    np.testing.assert_allclose(saturation_vapour_pressure(t), saturation_pressure_pa(t), rtol=4e-3)


def test_humidity_is_a_fraction_of_saturation():
    half = vapour_pressure(0.5, 293.15, 101_325.0)
    assert float(vapour_pressure(1.0, 293.15, 101_325.0) / half) == pytest.approx(2.0, rel=1e-14)
    # Enhancement factor of water over 1 atm at 20 C: 1.0040 (Hyland 1975).
    assert float(half) == pytest.approx(0.5 * 1.0040 * 2339.3, rel=2e-4)


def test_virtual_temperature_gives_the_density_of_moist_air():
    t = 300.0
    p = 1e5
    e = 3000.0
    molar_gas_constant = 8.314462618
    m_dry = 28.9644e-3
    m_water = 18.01528e-3
    density = ((p - e) * m_dry + e * m_water) / (molar_gas_constant * t)
    as_dry = p * m_dry / (molar_gas_constant * float(virtual_temperature(t, p, e)))
    assert as_dry == pytest.approx(density, rel=1e-5)


@pytest.mark.parametrize("metres", [0.55, 550.0, 0.1e-6, float("nan")])
def test_a_wavelength_in_the_wrong_unit_is_refused(metres):
    with pytest.raises(PhysicsError) as refusal:
        refractivity_ciddor(288.15, 101_325.0, wavelength_m=metres)
    assert refusal.value.code == "AIR-WAVELENGTH"


def test_an_unknown_index_is_refused():
    with pytest.raises(PhysicsError) as refusal:
        IndexModel("edlen")
    assert refusal.value.code == "AIR-INDEX"
    assert "ciddor" in refusal.value.remedy
