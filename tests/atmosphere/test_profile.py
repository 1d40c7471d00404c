"""Eq. 52-53 against 40 digits and against the hydrostatic equation, and the profile's table."""

import math
import sys

import mpmath as mp
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.atmosphere.flights import geopotential
from tests.atmosphere.values import HYDROSTATIC_K_PER_M
from tests.helpers import refused
from unbend.atmosphere import (
    pressure_gradient_layer,
    profile_from_table,
    profile_table,
    standard_atmosphere,
)
from unbend.atmosphere.layers import Layers, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.errors import ConfigError, PhysicsError
from unbend.geodesy import lambert_gravity, normal_gravity


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 60.0, 75.0, 90.0])
def test_lambert_geopotential_against_integrated_normal_gravity(degrees):
    """Reached at 10 km: 0.03 m at the equator, 0.04 at 45, 0.097 at 75, 0.107 at the pole."""
    latitude = math.radians(degrees)
    h = np.array([500.0, 3000.0, 10_000.0])
    misses = lambert_gravity(latitude).geopotential_height(h) - geopotential(latitude, h)
    at_10_km = 0.10 if degrees <= 75.0 else 0.11
    assert np.all(np.abs(misses) < at_10_km * h / 10_000.0 + 1e-3)


@pytest.mark.parametrize("rise", [-400.0, 37.0, 1000.0, 9000.0])
@pytest.mark.parametrize(
    "lapse",
    [
        -6.5e-3,
        3e-3,
        -1e-5,
        1e-9,
        -1e-13,
        1e-18,
        1e-300,
    ],
)
def test_eq_52_against_forty_digits(lapse, rise):
    with mp.workdps(60):
        lapse_mp = mp.mpf(lapse)
        warming = mp.log1p(lapse_mp * rise / 250)
        expected = 500 * mp.exp(-HYDROSTATIC_K_PER_M * warming / lapse_mp)
    p = pressure_gradient_layer(500.0, 250.0, lapse, rise)
    assert_allclose(p, float(expected), rtol=1e-14)


# The profile's table


MOIST = """
-400.0 297.0 0.016
400.0 293.0 0.014
1250.0 287.0 0.013
1350.0 291.5 0.005
3400.0 278.0 0.003
9000.0 240.0 1e-4
15000.0 215.0 0.0
21000.0 215.0 0.0
"""
"""Geopotential height [m'], virtual temperature [K] and e/p at edges."""


def moist():
    """An inversion under an isothermal layer, moist below 3 km, at 47 N."""
    edge, virtual, vapour = np.array(MOIST.split(), float).reshape(-1, 3).T
    layers = stack_layers(
        edge,
        virtual,
        vapour,
        ("measured",) * 7,
        anchor=(400.0, 96_500.0),
    )
    return Profile(layers, normal_gravity(math.radians(47.0)))


@pytest.fixture(
    params=[
        standard_atmosphere("us1976", latitude=0.8),
        standard_atmosphere("ican", latitude=0.8),
        moist(),
    ],
    ids=["us1976", "ican", "moist"],
)
def table(request):
    """The table of a profile, at its edges and between them."""
    edges = request.param.break_heights_m[:-1]
    h = np.append(edges, np.linspace(-300.0, 20_000.0, 300))
    return pd.DataFrame(profile_table(request.param, np.sort(h)))


def retrace(row):
    """Pressure [Pa] of a row of the profile's table from the other values of the row.

    With 40 digits: in double precision the power of Eq. 52 as it is written loses digits where the
    lapse rate is small (3e-7 of p at 1e-11 K/m), which is the user's arithmetic, not the table's.
    """
    rise = mp.mpf(row.geopotential_m) - row.geopotential_base_m
    t = mp.mpf(row.t_base_k)
    if row.equation == 53:
        return float(row.p_base_pa * mp.exp(-HYDROSTATIC_K_PER_M * rise / t))
    lapse = mp.mpf(row.lapse_k_per_m)
    return float(row.p_base_pa * (t / (t + lapse * rise)) ** (HYDROSTATIC_K_PER_M / lapse))


def test_every_pressure_recomputes_from_its_row(table):
    assert set(table.equation) == {52, 53}
    with mp.workdps(40):
        for row in table.itertuples():
            assert retrace(row) == pytest.approx(row.pressure_pa, rel=1e-12)


def test_every_row_explains_its_temperature_and_index(table):
    rise = table.geopotential_m - table.geopotential_base_m
    t_m = table.t_base_k + table.lapse_k_per_m * rise
    t, p, e = table[["temperature_k", "pressure_pa", "vapour_pressure_pa"]].to_numpy().T
    n = IndexModel("ciddor").refractivity(t, p, e)
    virtual = t / (1.0 - 0.378 * e / p)
    assert_allclose(table.virtual_temperature_k, t_m, rtol=1e-13, equal_nan=False)
    assert_allclose(virtual, t_m, rtol=1e-13, equal_nan=False)
    assert_allclose(table.refractivity, n, rtol=1e-13, equal_nan=False)


def test_the_table_refuses_heights_outside():
    with refused("PROFILE-RANGE", PhysicsError, what="99000"):
        profile_table(standard_atmosphere("ican"), np.array([0.0, 99_000.0]))


def test_the_table_as_a_frame():
    profile = standard_atmosphere()
    frame = profile.to_pandas([0.0, 1000.0])
    assert frame.pressure_pa.round(1).tolist() == [101325.0, 89876.3]
    edges = profile.to_pandas()
    assert len(edges) == profile.layers.edge.size
    # Each layer at its base, and the top of the last.
    assert_allclose(edges.h_base_m[:-1], edges.h_m[:-1], rtol=1e-14)


# How profiles are made


def test_the_anchor_holds():
    layers = stack_layers(
        np.array([0.0, 3000.0, 12_000.0]),
        np.array([290.0, 275.0, 215.0]),
        np.zeros(3),
        ("", ""),
        anchor=(4321.0, 61_234.5),
    )
    profile = Profile(layers, lambert_gravity(0.7))
    h = profile.gravity.height(4321.0)
    assert_allclose(profile.pressure(h), 61_234.5, rtol=1e-14)


def test_profile_from_table_passes_through_it():
    source = standard_atmosphere("us1976", latitude=0.6, index="gyer")
    levels = [0.0, 500.0, 2500.0, 7000.0, 11_000.0, 16_000.0, 20_000.0]
    h = source.gravity.height(levels)
    table = profile_from_table(
        h,
        source.temperature(h),
        source.pressure(h),
        gravity=normal_gravity(0.6),
        index=IndexModel("gyer"),
    )
    dense = np.linspace(h[0], h[-1], 999)
    limits = {"temperature": 1e-13, "pressure": 1e-12, "refractivity": 1e-12}
    for name, limit in limits.items():
        expected = getattr(source, name)(dense)
        assert_allclose(getattr(table, name)(dense), expected, rtol=limit)


def test_profile_from_table_is_hydrostatic_at_the_level_of_its_pressures():
    h = np.array([100.0, 1100.0, 3000.0])
    t = np.array([290.0, 284.0, 270.0])
    p = np.array([1.0e5, 8.9e4, 7.0e4])
    e = np.array([1500.0, 900.0, 200.0])
    table = profile_from_table(h, t, p, e, gravity=lambert_gravity(0.6))
    assert_allclose(table.temperature(h), t, rtol=1e-12)
    profile_p = table.pressure(h)
    assert_allclose(table.vapour_pressure(h) / profile_p, e / p, rtol=1e-12)
    # This table is 0.5 % off hydrostatic balance: the pressures straddle it, without a jump.
    ratio = profile_p / p
    assert np.median(ratio) == pytest.approx(1.0, abs=1e-12)
    assert np.ptp(ratio) < 8e-3
    below, above = table.pressure([1100.0 - 1e-4, 1100.0 + 1e-4])
    assert 0.0 < below / above - 1.0 < 5e-8


@pytest.mark.parametrize(
    "change",
    [
        {"edge": [0.0, 1.0]},
        {"edge": [1.0, 0.0, 2.0]},
        {"temperature": [280.0, -1.0]},
        {"temperature": [280.0, np.nan]},
        {"pressure": [1e5, 0.0]},
    ],
    ids=["an edge missing", "falling edges", "below 0 K", "no number", "no pressure"],
)
def test_impossible_layers_are_refused(change):
    columns = {
        "edge": [0.0, 1.0, 2.0],
        "temperature": [280.0, 280.0],
        "pressure": [1e5, 1e5],
    }
    arrays = {name: np.array(column) for name, column in (columns | change).items()}
    zeros = np.zeros(2)
    with pytest.raises(ValueError, match=r"layers|temperatures"):
        Layers(
            **arrays,
            lapse=zeros,
            vapour=zeros,
            vapour_slope=zeros,
            source=("", ""),
        )


# How profiles are shown


def test_a_profile_says_its_name_heights_and_the_air_at_sea_level():
    """US 1976, Table I: 288.15 K and 1013.25 hPa at sea level."""
    profile = standard_atmosphere("us1976")
    text = repr(profile)
    assert text.startswith("<Profile us1976: ")
    assert "at 0 m 288.15 K, 1013.25 hPa" in text
    assert len(text) < 120
    page = profile._repr_html_()
    assert page.count("<tr") == 1 + len(profile.break_heights_m)
    assert "us1976" in page
    assert "refractivity" in page


def test_a_profile_is_plotted_over_height_and_beside_another():
    profile = standard_atmosphere("us1976")
    heights = np.array([0.0, 5000.0, 11_000.0])
    axes = profile.plot(heights)
    assert len(axes) == 4
    standard_atmosphere("icao").plot(heights, axes)
    at_5_km = []
    for axis in axes:
        line, _ = axis.lines
        assert_array_equal(line.get_ydata(), heights)
        at_5_km.append(line.get_xdata()[1])
    # Table I: 255.676 K and 540.48 hPa at 5 km.
    assert at_5_km[0] == pytest.approx(255.676, abs=1e-3)
    assert at_5_km[1] == pytest.approx(540.48, abs=0.01)
    default_h = profile.plot()[0].lines[0].get_ydata()
    assert default_h.min() == profile.bottom_m
    assert default_h.max() == 12_000.0


def test_a_plot_without_matplotlib_is_refused_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with refused("PLOT-MATPLOTLIB", ConfigError) as caught:
        standard_atmosphere("us1976").plot()
    assert caught.value.remedy == "pip install matplotlib"
