"""Standard atmospheres against the tables that define them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import unbend
from unbend.atmosphere import standard_atmosphere, standard_names
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.standard import ATMOSPHERES, AtmosphereModel, known_names
from unbend.config.atmosphere import AtmosphereSection
from unbend.errors import PhysicsError
from unbend.geodesy import normal_gravity

DATA = Path(__file__).resolve().parents[1] / "data"
PRINTED = Path(unbend.__file__).parent / "refraction" / "data"

# US Standard Atmosphere 1976, Table I: geometric height [m], T [K], p [mbar] as printed.
US1976 = [
    (0, 288.150, 1.01325e3), (1000, 281.651, 8.9876e2), (2000, 275.154, 7.9501e2),
    (5000, 255.676, 5.4048e2), (8000, 236.215, 3.5651e2), (10000, 223.252, 2.6499e2),
    (11000, 216.774, 2.2699e2), (20000, 216.650, 5.5293e1),
    (25000, 221.552, 2.5492e1), (30000, 226.509, 1.1970e1), (40000, 250.350, 2.8714e0),
    (50000, 270.650, 7.9779e-1), (60000, 247.021, 2.1958e-1), (70000, 219.585, 5.2209e-2),
]  # fmt: skip

MODEL_NAMES = {
    "US76": "us1976",
    "US62": "us1962",
    "ICAO93_ISO2533": "icao",
    "ARDC59": "ardc1959",
    "ICAN_Brunt": "ican",
}


@pytest.mark.parametrize(("h", "kelvin", "mbar"), US1976)
def test_us1976_against_its_table(h, kelvin, mbar):
    profile = standard_atmosphere("us1976")
    assert profile.temperature(h).item() == pytest.approx(kelvin, abs=5.1e-4)
    # Half a unit of the fifth digit, as printed.
    assert profile.pressure(h).item() / 100.0 == pytest.approx(mbar, rel=6e-5)


def test_us1976_against_an_independent_implementation():
    fluids = pytest.importorskip("fluids.atmosphere", reason="the fluids package is not installed")
    profile = standard_atmosphere("us1976")
    # Above 79 km fluids gives the kinetic, the profile the molecular-scale temperature.
    for h in np.linspace(-1000.0, 78_000.0, 80):
        other = fluids.ATMOSPHERE_1976(float(h))
        assert profile.temperature(h).item() == pytest.approx(other.T, rel=1e-9)
        assert profile.pressure(h).item() == pytest.approx(other.P, rel=1e-9)


def test_ardc1959_is_the_profile_of_gyer_table_2():
    profile = standard_atmosphere("ardc1959", index="gyer")
    with (PRINTED / "gyer1996_table2.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert len(rows) == 28
    unit = 0.01 * (1.0 + 1e-9)
    for row in rows:
        h = row["h_km"] * 1e3
        # reference/README.md, 1: p at -1 km computes as 1139.31, printed 1139.30. Rounding of our
        # own value adds half a unit.
        assert round(profile.temperature(h).item(), 2) == pytest.approx(
            row["temperature_k"], abs=unit
        )
        assert round(profile.pressure(h).item() / 100.0, 2) == pytest.approx(
            row["pressure_mbar"], abs=0.02 if h < 0.0 else unit
        )
        assert round(profile.refractivity(h).item() * 1e6, 2) == pytest.approx(
            row["refractivity_n_minus_1_e6"], abs=unit
        )


def test_us1976_is_not_the_profile_of_gyer_table_2():
    profile = standard_atmosphere("us1976")
    assert abs(profile.temperature(26_000.0).item() - 219.34) > 3.0


@pytest.mark.parametrize("name", sorted(MODEL_NAMES))
def test_heights_and_pressures_at_the_base_of_every_layer(name):
    """Computed by another program; a temperature that is wrong shows in the pressure above it."""
    with (DATA / "standard_atmospheres_pressures.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == name]
    profile = standard_atmosphere(MODEL_NAMES[name])
    assert len(rows) >= 3
    for row in rows:
        h = float(profile.gravity.height(float(row["H_gpm"])))
        # The table prints height to 0.1 m; near the top of the profile that matters.
        assert h == pytest.approx(float(row["z_m_geometric_r0"]), abs=0.06)
        assert profile.pressure(h).item() / 100.0 == pytest.approx(float(row["p_hPa"]), rel=1e-6)


# Temperatures [K] that the definitions state: at the sea and at the tropopause, [m'].
DEFINED = {
    "us1976": (288.15, 11_000.0, 216.65), "us1962": (288.15, 11_000.0, 216.65),
    "icao": (288.15, 11_000.0, 216.65), "ardc1959": (288.16, 11_000.0, 216.66),
    "ican": (288.0, 11_000.0, 216.5),
}  # fmt: skip


@pytest.mark.parametrize("name", DEFINED)
def test_temperatures_of_the_definitions(name):
    at_sea, tropopause, kelvin = DEFINED[name]
    profile = standard_atmosphere(name)
    assert float(profile.temperature(0.0)) == pytest.approx(at_sea, abs=1e-9)
    h = float(profile.gravity.height(tropopause))
    assert float(profile.temperature(h)) == pytest.approx(kelvin, abs=1e-6)


@pytest.mark.parametrize("name", standard_names()[:5])
def test_below_the_sea_the_lapse_rate_goes_on(name):
    profile = standard_atmosphere(name)
    assert profile.bottom_m < -4990.0
    assert profile.temperature(-430.0).item() > profile.temperature(0.0).item() + 2.7
    assert profile.pressure(-430.0).item() > profile.pressure(0.0).item() * 1.05


def test_outside_the_profile_is_nan():
    profile = standard_atmosphere("ican")
    h = [profile.bottom_m - 1.0, profile.top_m + 1.0, np.nan]
    for values in (profile.temperature(h), profile.pressure(h), profile.refractivity(h)):
        assert np.isnan(values).all()


def test_heights_have_any_shape():
    profile = standard_atmosphere()
    assert profile.temperature(0.0).shape == ()
    assert profile.pressure(np.zeros((2, 3))).shape == (2, 3)
    assert profile.refractivity([]).shape == (0,)


def test_latitude_moves_the_layers_by_metres():
    # Ignoring latitude costs +27 m at the equator and -22 m at 75 deg, in 10 km.
    own = standard_atmosphere()
    for degrees, metres in ((0.0, 27.0), (75.0, -22.0)):
        placed = standard_atmosphere(latitude=np.radians(degrees))
        difference = own.gravity.geopotential_height(1e4) - placed.gravity.geopotential_height(1e4)
        assert float(difference) == pytest.approx(metres, abs=1.0)


def test_unknown_name_and_degrees_for_radians_are_refused():
    with pytest.raises(PhysicsError) as refusal:
        standard_atmosphere("us1967")
    assert refusal.value.code == "ATMOSPHERE-NAME"
    with pytest.raises(PhysicsError) as refusal:
        standard_atmosphere(latitude=47.0)
    assert refusal.value.code == "ATMOSPHERE-LATITUDE"
    with pytest.raises(PhysicsError):
        standard_atmosphere(latitude=float("nan"))


def test_an_atmosphere_costs_one_function_and_a_line(monkeypatch, unbend):
    """A new entry of the registry is a name for standards, climatologies, missions and commands."""

    def isothermal(place, index):
        edge = np.array([-5000.0, 30_000.0])
        layers = stack_layers(
            edge, np.full(2, 260.0), np.zeros(2), ("standard",), anchor=(0.0, 1e5)
        )
        return Profile(layers, place.gravity or normal_gravity(0.0), index, "isothermal260")

    model = AtmosphereModel(isothermal, "a test", has_humidity=False)
    monkeypatch.setitem(ATMOSPHERES, "isothermal260", model)
    assert "isothermal260" in known_names()
    assert float(standard_atmosphere("isothermal260").temperature(7000.0)) == 260.0
    made = climatology("isothermal260", latitude_rad=0.8, month=7.0)
    assert (made.origin, made.has_humidity) == ("a test", False)
    # Its distance from the Supplements (293.8 K at the sea) is part of its spread.
    usual = climatology(latitude_rad=0.8, month=7.0)
    difference_k = float(usual.profile.temperature(0.0)) - 260.0
    expected_k = math.hypot(usual.spread.sigma_temperature(0.0), difference_k)
    assert made.spread.sigma_temperature(0.0) == pytest.approx(expected_k, abs=0.5)
    section = AtmosphereSection(standard="isothermal260", climatology="isothermal260")
    assert section.standard == "isothermal260"
    shown = unbend("profile", "--atmosphere", "isothermal260", "--step", "10000")
    assert shown.code == 0
    refused = unbend("profile", "--atmosphere", "isothermal", "--step", "10000")
    assert "isothermal260" in "".join(refused.text.split())
