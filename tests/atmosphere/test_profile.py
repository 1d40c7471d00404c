"""Eq. 52-53 against 40 digits and against the hydrostatic equation, and the profile's table."""

from __future__ import annotations

import math
import sys
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unbend.atmosphere import (
    pressure_gradient_layer,
    pressure_isothermal_layer,
    profile_from_table,
    profile_table,
    standard_atmosphere,
)
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.layers import Layers, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.errors import ConfigError, PhysicsError
from unbend.geodesy import lambert_gravity, normal_gravity
from unbend.messages import Ledger

GMR = 9.80665 * 28.9644 / 8314.32  # [K per geopotential metre]


def somigliana(latitude: float, h: float) -> float:
    """WGS84 normal gravity [m s-2] (NIMA TR8350.2, Eq. 4-1 and 4-3)."""
    a = 6_378_137.0
    f = 1.0 / 298.257223563
    e2 = 6.694379990141e-3
    m = 3.449786506841e-3
    s2 = math.sin(latitude) ** 2
    surface = 9.7803253359 * (1.0 + 1.931852652458e-3 * s2) / math.sqrt(1.0 - e2 * s2)
    return surface * (1.0 - 2.0 * (1.0 + f + m - 2.0 * f * s2) * h / a + 3.0 * (h / a) ** 2)


def geopotential(latitude: float, h: float) -> float:
    """Geopotential height [m'] by integrating normal gravity; Simpson is exact for a parabola."""
    middle = somigliana(latitude, 0.5 * h)
    return h * (somigliana(latitude, 0.0) + 4.0 * middle + somigliana(latitude, h)) / 6.0 / 9.80665


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 60.0, 75.0, 90.0])
def test_lambert_geopotential_against_integrated_normal_gravity(degrees):
    latitude = math.radians(degrees)
    gravity = lambert_gravity(latitude)
    for h in (500.0, 3000.0, 10_000.0):
        # Reached at 10 km: 0.03 m at the equator, 0.04 at 45, 0.097 at 75, 0.107 at the pole.
        miss = float(gravity.geopotential_height(h)) - geopotential(latitude, h)
        assert abs(miss) < (0.10 if degrees <= 75.0 else 0.11) * h / 10_000.0 + 1e-3


@pytest.mark.parametrize(
    ("degrees", "at_10_km", "at_25_km"), [(0, 1e-6, 2e-6), (45, 1e-6, 2e-6), (75, 1e-6, 2e-6)]
)
def test_layers_obey_the_hydrostatic_equation_under_wgs84_gravity(degrees, at_10_km, at_25_km):
    """dp/dh = -rho g through the temperatures of US 1976, up to 25 km."""
    latitude = math.radians(degrees)

    def temperature(h: float) -> float:
        H = geopotential(latitude, h)
        return float(np.interp(H, [0.0, 11e3, 20e3, 32e3], [288.15, 216.65, 216.65, 228.65]))

    def slope(h, log_p):
        return [-somigliana(latitude, h) * 28.9644 / (8314.32 * temperature(h))]

    profile = standard_atmosphere("us1976", latitude=latitude)
    h = 0.0
    log_p = math.log(101_325.0)
    for top, bound in ((1e4, at_10_km), (2.5e4, at_25_km)):
        solved = solve_ivp(slope, (h, top), [log_p], "DOP853", rtol=1e-11, atol=1e-13, max_step=500)
        h = top
        log_p = float(solved.y[0, -1])
        # All of it is Lambert's gravity: 0.06 m of geopotential height are worth 1e-5 of p.
        assert abs(math.log(profile.pressure(top).item()) - log_p) < bound


@pytest.mark.parametrize(
    ("degrees", "at_10_km", "at_25_km"), [(0, 1e-6, 2e-6), (45, 1e-6, 2e-6), (75, 1e-6, 2e-6)]
)
def test_an_adjusted_moist_profile_obeys_it_too(degrees, at_10_km, at_25_km):
    """dp/dh = -rho g of its own temperature and vapour, up and from where it was measured.

    Under WGS84 normal gravity 1e-5 is asked for; under the profile's own, to 1e-9 (reached: 1e-14).
    """
    latitude = math.radians(degrees)
    profile = moist_profile(latitude)
    h = 400.0
    log_p = math.log(profile.pressure(400.0).item())
    for gravity, bounds in (
        (lambda z: somigliana(latitude, z), (at_10_km, at_25_km)),
        (lambda z: lambert(profile.gravity, z), (1e-9, 1e-9)),
    ):
        at = h
        found = log_p
        for top, bound in zip((1e4, 2.5e4), bounds, strict=True):
            found = integrated(profile, gravity, at, found, top)
            assert abs(math.log(profile.pressure(top).item()) - found) < bound
            at = top


def lambert(gravity, h: float) -> float:
    return gravity.g_phi * (gravity.r_phi / (gravity.r_phi + h)) ** 2


def integrated(profile, gravity, h: float, log_p: float, top: float) -> float:
    """ln p at the top by an integrator that is given T, e and g, and steps from kink to kink."""
    kinks = profile.break_heights_m
    stops = [h, *kinks[(kinks > h) & (kinks < top)], top]
    low = np.array(stops[:-1])
    high = np.array(stops[1:])
    # Two interior points of each layer: its T_M and e/p are straight lines in geopotential height.
    for a, b in zip(low, high, strict=True):
        z = np.array([a + 1e-6 * (b - a), b - 1e-6 * (b - a)])
        H = profile.gravity.geopotential_height(z)
        t = profile.temperature(z)
        e = profile.vapour_pressure(z)
        p = profile.pressure(z)
        t_m = t / (1.0 - 0.378 * e / p)
        v = e / p

        def slope(x, y, H=H, t_m=t_m, v=v):
            share = (float(profile.gravity.geopotential_height(x)) - H[0]) / (H[1] - H[0])
            ratio = v[0] + share * (v[1] - v[0])
            warm = (t_m[0] + share * (t_m[1] - t_m[0])) * (1.0 - 0.378 * ratio)
            density = 28.9644 / (8314.32 * warm) * (1.0 - 0.378 * ratio)
            return [-gravity(x) * density]

        solved = solve_ivp(slope, (a, b), [log_p], "DOP853", rtol=1e-11, atol=1e-13)
        log_p = float(solved.y[0, -1])
    return log_p


def test_gravity_counted_twice_would_be_seen():
    # reference/README.md, 9: g_phi in the exponent, on top of geopotential height.
    latitude = 0.0
    p = pressure_gradient_layer(101_325.0, 288.15, -0.0065, geopotential(latitude, 1e4))
    g_phi = lambert_gravity(latitude).g_phi
    twice = pressure_gradient_layer(
        101_325.0, 288.15, -0.0065, geopotential(latitude, 1e4), GMR * g_phi / 9.80665
    )
    assert abs(float(twice / p) - 1.0) > 1e-3


@pytest.mark.parametrize("rise", [-400.0, 37.0, 1000.0, 9000.0])
@pytest.mark.parametrize("lapse", [-6.5e-3, 3e-3, -1e-5, 1e-9, -1e-13, 1e-18, 1e-300])
def test_eq_52_against_forty_digits(lapse, rise):
    with mp.workdps(60):
        t = mp.mpf(250)
        L = mp.mpf(lapse)
        dH = mp.mpf(rise)
        expected = 500 * mp.exp(-mp.mpf(GMR) * mp.log1p(L * dH / t) / L)
    p = pressure_gradient_layer(500.0, 250.0, lapse, rise).item()
    assert p == pytest.approx(float(expected), rel=1e-14)


def test_eq_52_goes_over_into_eq_53():
    limit = pressure_isothermal_layer(500.0, 250.0, 8000.0).item()
    lapses = 10.0 ** np.arange(-16.0, -6.0)
    departures = pressure_gradient_layer(500.0, 250.0, lapses, 8000.0) / limit - 1.0
    # First order: + (GM/R) L dH^2 / (2 T^2).
    expected = GMR * lapses * 8000.0**2 / (2.0 * 250.0**2)
    np.testing.assert_allclose(departures, expected, rtol=1e-3, atol=3e-15)


def retrace(row: dict[str, float]) -> float:
    """Pressure [Pa] of a row of the profile's table from what stands in the row.

    With 40 digits: in double precision the power of Eq. 52 as it is written loses digits where the
    lapse rate is small (3e-7 of p at 1e-11 K/m), which is the user's arithmetic, not the table's.
    """
    rise = mp.mpf(row["geopotential_m"]) - mp.mpf(row["geopotential_base_m"])
    t = mp.mpf(row["t_base_k"])
    lapse = mp.mpf(row["lapse_k_per_m"])
    if row["equation"] == 53:
        return float(row["p_base_pa"] * mp.exp(-GMR * rise / t))
    return float(row["p_base_pa"] * (t / (t + lapse * rise)) ** (GMR / lapse))


def rows_of(profile: Profile, h: np.ndarray) -> list[dict[str, float]]:
    table = profile_table(profile, h)
    return [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]


@pytest.fixture(scope="module")
def moist() -> Profile:
    """An adjusted profile with an inversion and humidity, at 47 N."""
    return moist_profile(math.radians(47.0))


def moist_profile(latitude: float) -> Profile:
    """What a climb through an inversion leaves, with a hygrometer."""
    h = np.arange(400.0, 3400.0, 5.0)
    time_ns = (np.arange(h.size) * 10**9).astype(np.int64)
    t = 291.0 - 6.8e-3 * (h - 400.0) + 5.0 / (1.0 + np.exp(-(h - 1300.0) / 60.0))
    rh = np.where(h < 1300.0, 0.7, 0.25)
    fall = 0.0341632 * 5.0 / (0.5 * (t[1:] + t[:-1]))  # dp/p over 5 m
    p = 96_500.0 * np.exp(-np.concatenate([[0.0], np.cumsum(fall)]))
    everything = np.zeros(h.size, np.uint8)

    def samples(value, name):
        return SensorSamples(time_ns, h, value, everything, name)

    adjusted = build_adjusted_profile(
        AirSamples(samples(t, "T"), samples(p, "p"), samples(rh, "rh")),
        standard_atmosphere("us1976"),
        latitude,
        Ledger(),
    )
    assert adjusted.basis == "thermometer"
    return adjusted.profile


@pytest.fixture(params=["us1976", "ican", "moist"])
def profile(request) -> Profile:
    if request.param == "moist":
        return request.getfixturevalue("moist")
    return standard_atmosphere(request.param, latitude=0.8)


def test_every_pressure_recomputes_from_its_row(profile):
    h = np.sort(np.concatenate([profile.break_heights_m, np.linspace(-400.0, 20_000.0, 500)]))
    rows = rows_of(profile, h)
    assert {int(row["equation"]) for row in rows} >= {52}
    with mp.workdps(40):
        for row in rows:
            assert retrace(row) == pytest.approx(row["pressure_pa"], rel=1e-12)


def test_every_row_explains_its_temperature_and_index(profile):
    index = profile.index
    for row in rows_of(profile, np.linspace(-300.0, 15_000.0, 300)):
        rise = row["geopotential_m"] - row["geopotential_base_m"]
        t_m = row["t_base_k"] + row["lapse_k_per_m"] * rise
        assert row["virtual_temperature_k"] == pytest.approx(t_m, rel=1e-13)
        e = row["vapour_pressure_pa"]
        p = row["pressure_pa"]
        t = row["temperature_k"]
        assert t / (1.0 - 0.378 * e / p) == pytest.approx(t_m, rel=1e-13)
        assert row["refractivity"] == pytest.approx(float(index.refractivity(t, p, e)), rel=1e-13)


def test_moist_profile_is_moist_where_it_should_be(moist):
    e = moist.vapour_pressure([800.0, 3000.0, 9000.0])
    assert e[0] > 1000.0 > e[1] > e[2] >= 0.0
    assert {"measured", "relaxed", "standard"} == set(moist.layers.source)


def test_continuous_where_layers_meet(profile):
    inner = profile.layers.edge[1:-1]
    below, above = (profile.gravity.height(inner + d) for d in (-1e-5, 1e-5))
    for values in (profile.temperature, profile.pressure, profile.refractivity):
        step = values(above) / values(below) - 1.0
        # Twice 1e-5 m' of the steepest gradient in hand (0.3 K/m of the inversion) is 2e-8.
        assert np.abs(step).max() < 3e-8


def test_pressure_falls_everywhere(profile):
    h = np.linspace(profile.bottom_m, min(profile.top_m, 50e3), 4000)
    assert np.all(np.diff(profile.pressure(h)) < 0.0)
    assert np.all(profile.refractivity(h) > 0.0)


def test_splitting_a_layer_changes_nothing():
    gravity = lambert_gravity(0.7)
    edge = np.array([0.0, 3000.0, 12_000.0])
    t = np.array([290.0, 275.0, 215.0])
    fine = np.linspace(0.0, 12_000.0, 49)
    whole, split = (
        Profile(
            stack_layers(e, k, np.zeros(e.size), ("",) * (e.size - 1), anchor=(1000.0, 9e4)),
            gravity,
        )
        for e, k in ((edge, t), (fine, np.interp(fine, edge, t)))
    )
    h = np.linspace(0.0, 11_900.0, 777)
    np.testing.assert_allclose(split.pressure(h), whole.pressure(h), rtol=1e-13)


def test_the_anchor_holds():
    edge = np.array([0.0, 3000.0, 12_000.0])
    layers = stack_layers(
        edge, np.array([290.0, 275.0, 215.0]), np.zeros(3), ("", ""), anchor=(4321.0, 61_234.5)
    )
    profile = Profile(layers, lambert_gravity(0.7))
    h = profile.gravity.height(4321.0)
    assert profile.pressure(h).item() == pytest.approx(61_234.5, rel=1e-14)


def test_profile_from_table_passes_through_it():
    gravity = normal_gravity(0.6)
    source = standard_atmosphere("us1976", latitude=0.6, index="gyer")
    h = gravity.height(np.array([0.0, 500.0, 2500.0, 7000.0, 11_000.0, 16_000.0, 20_000.0]))
    table = profile_from_table(
        h, source.temperature(h), source.pressure(h), gravity=gravity, index=IndexModel("gyer")
    )
    dense = np.linspace(h[0], h[-1], 999)
    np.testing.assert_allclose(table.temperature(dense), source.temperature(dense), rtol=1e-13)
    np.testing.assert_allclose(table.pressure(dense), source.pressure(dense), rtol=1e-12)
    np.testing.assert_allclose(table.refractivity(dense), source.refractivity(dense), rtol=1e-12)


def test_profile_from_table_is_hydrostatic_at_the_level_of_its_pressures():
    gravity = lambert_gravity(0.6)
    h = np.array([100.0, 1100.0, 3000.0])
    p = np.array([1.0e5, 8.9e4, 7.0e4])
    e = np.array([1500.0, 900.0, 200.0])
    table = profile_from_table(h, [290.0, 284.0, 270.0], p, e, gravity=gravity)
    np.testing.assert_allclose(table.temperature(h), [290.0, 284.0, 270.0], rtol=1e-12)
    np.testing.assert_allclose(table.vapour_pressure(h) / table.pressure(h), e / p, rtol=1e-12)
    # This table is 0.5 % off hydrostatic balance: the pressures straddle it, without a jump.
    ratio = table.pressure(h) / p
    assert np.median(ratio) == pytest.approx(1.0, abs=1e-12)
    assert np.ptp(ratio) < 8e-3
    above, below = (float(table.pressure(1100.0 + d)) for d in (1e-4, -1e-4))
    assert 0.0 < below / above - 1.0 < 5e-8


def test_the_table_refuses_heights_outside():
    profile = standard_atmosphere("ican")
    with pytest.raises(PhysicsError) as refusal:
        profile_table(profile, np.array([0.0, 99_000.0]))
    assert refusal.value.code == "PROFILE-RANGE"
    assert "99000" in refusal.value.what


def test_the_table_as_a_frame():
    frame = standard_atmosphere().to_pandas([0.0, 1000.0])
    assert frame["pressure_pa"].round(1).tolist() == [101325.0, 89876.3]
    assert len(standard_atmosphere().to_pandas()) == standard_atmosphere().layers.edge.size


@pytest.mark.parametrize(
    ("edge", "temperature", "pressure"),
    [
        ([0.0, 1.0], [280.0, 280.0], [1e5, 1e5]),
        ([1.0, 0.0, 2.0], [280.0, 280.0], [1e5, 1e5]),
        ([0.0, 1.0, 2.0], [280.0, -1.0], [1e5, 1e5]),
        ([0.0, 1.0, 2.0], [280.0, np.nan], [1e5, 1e5]),
        ([0.0, 1.0, 2.0], [280.0, 280.0], [1e5, 0.0]),
    ],
)
def test_impossible_layers_are_refused(edge, temperature, pressure):
    n = len(temperature)
    with pytest.raises(ValueError, match=r"layers|temperatures"):
        Layers(
            np.array(edge),
            np.array(temperature),
            np.zeros(n),
            np.array(pressure),
            np.zeros(n),
            np.zeros(n),
            ("",) * n,
        )


def test_layers_of_the_moist_profile_are_thin_where_it_was_measured(moist):
    measured = [
        high - low
        for (low, high), source in zip(
            pairwise(moist.layers.edge), moist.layers.source, strict=True
        )
        if source == "measured"
    ]
    assert len(measured) > 50
    assert max(measured) < 60.0


@pytest.mark.parametrize("degrees", [0.0, 45.0, 75.0])
def test_layers_solve_the_hydrostatic_equation_exactly(degrees):
    """The same under the profile's own gravity, so that nothing but Eq. 52-53 is tested."""
    gravity = normal_gravity(math.radians(degrees))
    profile = standard_atmosphere("us1976", latitude=math.radians(degrees))

    def slope(h, log_p):
        g = gravity.g_phi * (gravity.r_phi / (gravity.r_phi + h)) ** 2
        H = gravity.g_phi * gravity.r_phi * h / (gravity.r_phi + h) / 9.80665
        t = float(np.interp(H, [0.0, 11e3, 20e3, 32e3], [288.15, 216.65, 216.65, 228.65]))
        return [-g * 28.9644 / (8314.32 * t)]

    h = 0.0
    log_p = math.log(101_325.0)
    for top in [*profile.break_heights_m[(profile.break_heights_m > 0.0)][:2], 25_000.0]:
        solved = solve_ivp(slope, (h, top), [log_p], "DOP853", rtol=1e-12, atol=1e-14, max_step=500)
        h = float(top)
        log_p = float(solved.y[0, -1])
        # Reached: 1e-11.
        assert abs(math.log(profile.pressure(h).item()) - log_p) < 1e-10


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
    for axis in axes:
        assert len(axis.lines) == 2
        np.testing.assert_array_equal(axis.lines[0].get_ydata(), heights)
    # Table I: 255.676 K and 540.48 hPa at 5 km.
    assert axes[0].lines[0].get_xdata()[1] == pytest.approx(255.676, abs=1e-3)
    assert axes[1].lines[0].get_xdata()[1] == pytest.approx(540.48, abs=0.01)
    usual = profile.plot()[0].lines[0].get_ydata()
    assert (usual.min(), usual.max()) == (profile.bottom_m, 12_000.0)


def test_a_plot_without_matplotlib_is_refused_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ConfigError, match="PLOT-MATPLOTLIB") as caught:
        standard_atmosphere("us1976").plot()
    assert caught.value.remedy == "pip install matplotlib"
