"""The methods of the papers, against formulas written out by hand and against mpmath."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.errors import PhysicsError
from unbend.geodesy import Gravity
from unbend.refraction import published as pub
from unbend.refraction import refraction_angle
from unbend.refraction.published import gyer
from unbend.refraction.published.column import density, mean
from unbend.refraction.ray import PublishedRays
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE
from unbend.units import ARCSEC, DEGREE

RADIUS = 6_378_000.0
DIAGONAL = 45.0 * DEGREE
URAD = 1e-6


@pytest.fixture(scope="module")
def ardc():
    return standard_atmosphere("ardc1959", index="gyer")


@pytest.fixture(scope="module")
def us1962():
    return standard_atmosphere("us1962", index="gyer")


def linear_air(lapse_per_km: float, index: str = "gyer", wet: float = 0.0) -> Profile:
    """One layer of air; with a huge effective radius height and geopotential are the same."""
    edge = np.array([-2000.0, 15_000.0])
    dry = standard_atmosphere("us1976", index=index)
    layers = stack_layers(
        edge,
        288.0 + lapse_per_km * 1e-3 * edge,
        np.array([wet, 0.0]),
        ("standard",),
        anchor=(0.0, 101_000.0),
    )
    return Profile(layers, Gravity(9.80665, 1e18), dry.index, "one layer")


def test_the_names_are_those_of_the_manual():
    assert list(pub.PUBLISHED) == [
        "plane",
        "plane_first_term",
        "plane_moist",
        "gyer1996",
        "saastamoinen1974",
        "saastamoinen1974_ican",
        "saastamoinen1974_quadratic",
        "saastamoinen1974_fitted",
        "saastamoinen1974_weather",
        "saastamoinen1974_series",
        "bertram1966",
        "bertram1966_from_ground",
        "bertram1966_curved",
        "manual",
    ]


@pytest.mark.parametrize("name", pub.PUBLISHED)
class TestEveryMethod:
    def test_broadcasts_and_keeps_the_shape(self, name, us1962):
        h_c = np.array([[3000.0], [6000.0], [8000.0]])
        zeta = np.array([20.0, 45.0]) * DEGREE
        r = pub.PUBLISHED[name](us1962, h_c, 0.0, zeta, RADIUS)
        assert r.shape == (3, 2)
        for i in range(3):
            for j in range(2):
                one = pub.PUBLISHED[name](us1962, h_c[i, 0], 0.0, zeta[j], RADIUS)
                assert one.shape == ()
                assert float(one) == pytest.approx(r[i, j], rel=1e-12)

    def test_is_nan_where_it_has_no_meaning(self, name, us1962):
        h_c = np.array([6000.0, 6000.0, 1000.0, np.nan, 6000.0, 6000.0])
        h_g = np.array([0.0, 0.0, 2000.0, 0.0, np.nan, 0.0])
        zeta = np.array([90.0, 120.0, 45.0, 45.0, 45.0, -1.0]) * DEGREE
        assert np.isnan(pub.PUBLISHED[name](us1962, h_c, h_g, zeta, RADIUS)).all()

    def test_a_bad_ray_does_not_disturb_the_others(self, name, us1962):
        r = pub.PUBLISHED[name](us1962, [6000.0, 6000.0], 0.0, [DIAGONAL, 2.0], RADIUS)
        alone = pub.PUBLISHED[name](us1962, 6000.0, 0.0, DIAGONAL, RADIUS)
        assert r[0] == pytest.approx(float(alone), rel=1e-12)
        assert np.isnan(r[1])

    def test_is_zero_at_the_nadir(self, name, us1962):
        assert float(pub.PUBLISHED[name](us1962, 6000.0, 0.0, 0.0, RADIUS)) == pytest.approx(
            0.0, abs=1e-20
        )

    # Percent of the spherical form at 45 degrees, 6 km above sea level: as measured, with room.
    def test_has_the_size_of_the_spherical_form(self, name, us1962):
        exact = refraction_angle(us1962, 6000.0, 0.0, DIAGONAL, RADIUS)
        assert float(pub.PUBLISHED[name](us1962, 6000.0, 0.0, DIAGONAL, RADIUS)) == pytest.approx(
            exact, rel=0.02
        )


def test_outside_the_profile_is_nan(us1962):
    looks_at_the_profile = set(pub.PUBLISHED) - {
        "manual",
        "saastamoinen1974_ican",
        "saastamoinen1974_quadratic",
        # These go on beyond 80.5 km without air.
        "bertram1966",
        "bertram1966_curved",
        "bertram1966_from_ground",
    }
    for name in sorted(looks_at_the_profile):
        r = pub.PUBLISHED[name](us1962, [95_000.0, 6000.0], [0.0, -6000.0], DIAGONAL, RADIUS)
        assert np.isnan(r).all(), name


def test_density_follows_the_gas_law():
    # US 1976, Table I: 0.41351 kg m-3 at 10 km.
    air = standard_atmosphere("us1976")
    assert density(air, 10_000.0) == pytest.approx(0.41351, abs=5e-6)
    # Moist air is lighter by 1 - 0.378 e/p.
    wet = linear_air(-6.5, wet=0.02)
    dry = linear_air(-6.5)
    t = wet.temperature(0.0)
    e = wet.vapour_pressure(0.0)
    by_hand = (101_000.0 - 0.378 * e) * 28.9644 / (8314.32 * t)
    assert density(wet, 0.0) == pytest.approx(float(by_hand), rel=1e-12)
    assert density(dry, 0.0) == pytest.approx(101_000.0 * 28.9644 / (8314.32 * 288.0), rel=1e-12)


def test_the_mean_over_a_column_has_a_closed_form():
    """rho dH = -dp / G: the mean density of a hydrostatic layer is its drop of pressure."""
    air = linear_air(-6.5)
    h_g = np.array([0.0, 123.4, 3000.0])
    h_c = np.array([10.0, 9000.0, 14_999.0])
    by_pressure = (air.pressure(h_g) - air.pressure(h_c)) / (9.80665 * (h_c - h_g))
    assert mean(air, density, h_g, h_c) == pytest.approx(by_pressure, rel=1e-11)
    # A column of no thickness has the density of its place.
    at = np.array([500.0])
    assert mean(air, density, at, at) == pytest.approx(density(air, at), rel=1e-15)


def plane_truth(profile: Profile, h_c: float, zeta: float, terms: int) -> float:
    """Eq. 22 with Eq. 23, by mpmath over the layers of the profile."""
    with mp.workdps(25):
        n_c = 1 + mp.mpf(float(profile.refractivity(h_c)))

        def integrand(h):
            n = 1 + mp.mpf(float(profile.refractivity(float(h))))
            u = (n * n - n_c * n_c) / (n_c * mp.cos(zeta)) ** 2
            series = [u / 2, -3 * u**2 / 8, 5 * u**3 / 16]
            return mp.fsum(series[:terms])

        kinks = [float(b) for b in profile.break_heights_m if 0.0 < b < h_c]
        total = mp.quad(integrand, [0, *kinks, h_c])
        return float(mp.cos(zeta) ** 2 * mp.tan(zeta) / h_c * total)


@pytest.mark.parametrize("degrees", [20.0, 60.0, 85.0])
@pytest.mark.parametrize("h_c", [3000.0, 13_000.0])
def test_plane_is_eq_22(ardc, h_c, degrees):
    zeta = degrees * DEGREE
    one = float(pub.plane_first_term(ardc, h_c, 0.0, zeta, RADIUS))
    three = float(pub.plane(ardc, h_c, 0.0, zeta, RADIUS))
    assert one == pytest.approx(plane_truth(ardc, h_c, zeta, 1), rel=1e-10)
    assert three == pytest.approx(plane_truth(ardc, h_c, zeta, 3), rel=1e-10)
    assert three < one


def test_plane_first_term_in_steps_goes_to_the_integral(ardc):
    exact = pub.plane_first_term(ardc, 10_000.0, 300.0, DIAGONAL, RADIUS)
    coarse = pub.plane_first_term(ardc, 10_000.0, 300.0, DIAGONAL, RADIUS, step=1000.0)
    fine = pub.plane_first_term(ardc, 10_000.0, 300.0, DIAGONAL, RADIUS, step=100.0)
    assert 1e-9 < abs(float(coarse / exact) - 1.0) < 1e-3
    assert float(fine) == pytest.approx(float(exact), rel=1e-6)


class TestGyer1996:
    def test_goes_to_the_converged_integral_with_its_step(self, ardc):
        zeta = np.array([30.0, 75.0, 85.0]) * DEGREE
        exact = refraction_angle(ardc, 24_000.0, 500.0, zeta, RADIUS)
        errors = [
            np.abs(pub.gyer1996(ardc, 24_000.0, 500.0, zeta, RADIUS, step=step) - exact) / ARCSEC
            for step in (1000.0, 100.0)
        ]
        assert errors[0].max() > 0.02
        assert errors[1].max() < 2e-3

    def test_sums_eq_31_by_hand(self, ardc):
        """Two intervals, written out."""
        zeta = 70.0 * DEGREE
        h = np.array([-1000.0, 0.0, 1000.0, 2000.0, 3000.0])
        r = RADIUS + h
        n = 1.0 + ardc.refractivity(h)
        k = n[3] * r[3] * math.sin(zeta)
        value = k / (r * np.sqrt(n * n * r * r - k * k))
        theta = 1000.0 / 24.0 * (
            -value[0] + 13 * value[1] + 13 * value[2] - value[3]
            - value[1] + 13 * value[2] + 13 * value[3] - value[4]
        )  # fmt: skip
        straight = math.atan2(r[1] * math.sin(theta), r[3] - r[1] * math.cos(theta))
        r_c = float(pub.gyer1996(ardc, 2000.0, 0.0, zeta, RADIUS))
        assert r_c == pytest.approx(zeta - straight, rel=3e-8)

    @pytest.mark.parametrize("rise", [1.0, 400.0, 1000.0, 1400.0])
    def test_heights_that_are_no_multiple_of_the_step(self, ardc, rise):
        r_c = pub.gyer1996(ardc, 300.0 + rise, 300.0, DIAGONAL, RADIUS)
        exact = refraction_angle(ardc, 300.0 + rise, 300.0, DIAGONAL, RADIUS)
        # Eq. 11 cancels: rounding errors of 1 count for RADIUS / rise.
        assert float(r_c) == pytest.approx(exact, rel=1e-4, abs=1e-9 / rise)

    def test_a_ray_level_at_the_ground_is_summed_in_thin_shells(self, ardc):
        n_c, n_g = 1.0 + ardc.refractivity([10_000.0, 0.0])
        zeta = math.asin(n_g * RADIUS / (n_c * (RADIUS + 10_000.0)))
        level = float(pub.gyer1996(ardc, 10_000.0, 0.0, zeta, RADIUS)) / ARCSEC
        near = refraction_angle(ardc, 10_000.0, 0.0, zeta - 1e-12, RADIUS) / ARCSEC
        assert level == pytest.approx(near, abs=1.6)
        assert level < near

    def test_a_ray_that_passes_under_the_ground_level_is_nan(self, ardc):
        assert np.isnan(pub.gyer1996(ardc, 10_000.0, 0.0, 88.0 * DEGREE, RADIUS))

    def test_no_height_difference_no_refraction(self, ardc):
        assert float(pub.gyer1996(ardc, 5000.0, 5000.0, DIAGONAL, RADIUS)) == 0.0

    def test_refuses_a_step_that_leads_nowhere(self, ardc):
        with pytest.raises(PhysicsError, match="METHOD-STEP"):
            pub.gyer1996(ardc, 5000.0, 0.0, DIAGONAL, RADIUS, step=0.0)


class TestSaastamoinen1974:
    def test_ican_formulas_are_eq_2_in_that_atmosphere(self):
        ican = standard_atmosphere("ican")
        h_c = np.array([200.0, 1000.0, 3000.0, 6000.0, 11_000.0, 11_001.0, 12_000.0, 20_000.0])
        for h_g in (-400.0, 0.0, 150.0):
            summed = pub.saastamoinen1974(ican, h_c, h_g, DIAGONAL, RADIUS) / URAD
            formula = pub.saastamoinen1974_ican(ican, h_c, h_g, DIAGONAL, RADIUS) / URAD
            assert formula == pytest.approx(summed, abs=0.2)

    def test_ican_formulas_meet_at_the_tropopause(self):
        r = pub.saastamoinen1974_ican(None, [11_000.0, 11_000.001], 0.0, DIAGONAL, RADIUS) / URAD
        assert r[0] == pytest.approx(r[1], abs=0.06)

    def test_ican_formulas_end_where_they_end(self):
        r = pub.saastamoinen1974_ican(
            None, [30_001.0, 12_000.0, 5000.0], [0.0, 11_500.0, 5000.0], DIAGONAL, RADIUS
        )
        assert np.isnan(r[:2]).all()
        assert r[2] == 0.0

    def test_eq_6(self, us1962):
        r = pub.saastamoinen1974_quadratic(us1962, 6000.0, 1000.0, DIAGONAL, RADIUS)
        assert float(r) / URAD == pytest.approx(13.0 * 5.0 * (1.0 - 0.02 * 13.0), rel=1e-12)
        h_c = np.arange(250.0, 9001.0, 250.0)
        summed = pub.saastamoinen1974(us1962, h_c, 0.0, DIAGONAL, RADIUS) / URAD
        formula = pub.saastamoinen1974_quadratic(us1962, h_c, 0.0, DIAGONAL, RADIUS) / URAD
        assert formula == pytest.approx(summed, abs=0.5)
        assert np.isnan(pub.saastamoinen1974_quadratic(us1962, 9001.0, 0.0, DIAGONAL, RADIUS))

    def test_eq_5_is_exact_in_an_index_of_second_order(self, monkeypatch):
        air = linear_air(-6.5)
        c_1 = -26e-9
        c_2 = 0.8e-12
        monkeypatch.setattr(
            Profile, "refractivity", lambda _, h: 277e-6 + c_1 * h + c_2 * np.asarray(h) ** 2
        )
        assert pub.quadratic_coefficients(air) == pytest.approx((c_1, c_2), rel=1e-9)
        h_c = 7000.0
        h_g = 900.0
        column = 277e-6 + c_1 * (h_c + h_g) / 2 + c_2 * (h_c**2 + h_c * h_g + h_g**2) / 3
        at_camera = 277e-6 + c_1 * h_c + c_2 * h_c**2
        r = pub.saastamoinen1974_fitted(air, h_c, h_g, DIAGONAL, RADIUS)
        assert float(r) == pytest.approx(column - at_camera, rel=1e-9)

    def test_a_parabola_needs_heights_inside_the_profile(self, us1962):
        with pytest.raises(PhysicsError, match="METHOD-SPAN"):
            pub.quadratic_coefficients(us1962, 5000.0, 4000.0)
        with pytest.raises(PhysicsError, match="METHOD-SPAN"):
            pub.saastamoinen1974_fitted(us1962, 1.0, 0.0, DIAGONAL, RADIUS, highest=2e5)

    def test_eq_7_misses_eq_2_by_its_constant(self):
        """With 34.163 for 34.11 Eq. 7 is Eq. 2: the gap is the constant times p / T."""
        air = linear_air(-6.5)
        for h_c in (120.0, 3000.0, 10_000.0):
            r = float(pub.saastamoinen1974_weather(air, h_c, 0.0, DIAGONAL, RADIUS)) / URAD
            p = float(air.pressure(h_c)) / 100.0
            t = float(air.temperature(h_c))
            mended = r - 2.316 * (34.1632 - 34.11) * p / t
            summed = float(pub.saastamoinen1974(air, h_c, 0.0, DIAGONAL, RADIUS)) / URAD
            # 2.316 * 34.163 = 79.12; 0.226 * 0.34837 * 1000 = 78.73: half a percent apart.
            assert mended == pytest.approx(summed * 79.122 / 78.732, rel=2e-4)

    @pytest.mark.parametrize(("metres", "percent"), [(120.0, 27.0), (3000.0, 1.0)])
    def test_eq_7_reads_high_near_the_ground(self, us1962, metres, percent):
        r = pub.saastamoinen1974_weather(us1962, metres, 0.0, DIAGONAL, RADIUS)
        exact = refraction_angle(us1962, metres, 0.0, DIAGONAL)
        assert 100.0 * (float(r) / exact - 1.0) == pytest.approx(percent, abs=0.6)

    @pytest.mark.parametrize("lapse", [-9.0, -6.5, 0.0, 5.0])
    def test_the_series_is_eq_7_expanded(self, lapse):
        """Eq. 7 with 34.1 in 40 digits, in air linear in temperature; and 39.6 for 39.49."""
        air = linear_air(lapse)
        for h_c in (120.0, 1000.0, 4000.0, 9000.0):
            with mp.workdps(40):
                t_0 = mp.mpf(288)
                p_0 = mp.mpf(1010)
                H = mp.mpf(h_c) / 1000
                t = t_0 + mp.mpf(lapse) * H
                g = mp.mpf("34.1")
                fall = mp.exp(-g * H / t_0) if lapse == 0.0 else (t / t_0) ** (-g / mp.mpf(lapse))
                eq_7 = float(p_0 * ((1 - fall) / H - g * fall / t) * mp.mpf("39.6") / (g / 2))
            r = pub.saastamoinen1974_series(air, h_c, 0.0, DIAGONAL, RADIUS) / URAD
            assert float(r) == pytest.approx(eq_7, rel=1e-9)

    def test_the_series_goes_over_into_eq_7_mended(self):
        """At low heights the two differ by 39.6 for 39.5, and by nothing that grows."""
        air = linear_air(-6.5)
        for h_c in (50.0, 500.0, 2000.0):
            p = float(air.pressure(h_c)) / 100.0
            t = float(air.temperature(h_c))
            weather = float(pub.saastamoinen1974_weather(air, h_c, 0.0, DIAGONAL, RADIUS)) / URAD
            mended = weather - 2.316 * (34.1632 - 34.11) * p / t
            series = float(pub.saastamoinen1974_series(air, h_c, 0.0, DIAGONAL, RADIUS)) / URAD
            assert series == pytest.approx(mended, rel=0.003)

    def test_eq_10_is_eq_7_plus_eq_9(self):
        outside = pub.weather_refraction(101_325.0, 47_200.0, 6000.0, 47_200.0, 249.0)
        inside = pub.weather_refraction(101_325.0, 47_200.0, 6000.0, 74_700.0, 278.0)
        step = pub.compartment(79.0e-6 * 472.0 / 249.0, 79.0e-6 * 747.0 / 278.0)
        assert float(inside - outside) == pytest.approx(float(step), rel=1e-4)


class TestBertram1966:
    def test_eq_9_is_printed_so(self, ardc):
        at = {h: float(pub.bertram1966(ardc, h, 0.0, DIAGONAL, RADIUS)) for h in (10_500.0, 1500.0)}
        raised = float(pub.bertram1966(ardc, 10_500.0, 1500.0, DIAGONAL, RADIUS))
        assert raised == pytest.approx(at[10_500.0] - 1500.0 / 10_500.0 * at[1500.0], rel=1e-12)
        # His example, from densities of three digits: 78.1 urad.
        assert raised / URAD == pytest.approx(78.1, abs=0.15)

    def test_eq_9_is_not_the_refraction_of_a_raised_ground(self, ardc):
        for h_c, h_g, percent in ((10_000.0, 2000.0, 25.0), (3000.0, 1000.0, 34.0)):
            exact = refraction_angle(ardc, h_c, h_g, DIAGONAL)
            printed = float(pub.bertram1966(ardc, h_c, h_g, DIAGONAL, RADIUS))
            assert 100.0 * (printed / exact - 1.0) == pytest.approx(percent, abs=1.0)
            started = float(pub.bertram1966_from_ground(ardc, h_c, h_g, DIAGONAL, RADIUS))
            assert started == pytest.approx(exact, rel=0.014)

    def test_started_at_the_ground_it_is_his_sum_at_sea_level(self, ardc):
        h_c = np.array([300.0, 500.0, 7321.0, 20_500.0, 41_000.0])
        a = pub.bertram1966(ardc, h_c, 0.0, DIAGONAL, RADIUS)
        assert pub.bertram1966_from_ground(ardc, h_c, 0.0, DIAGONAL, RADIUS) == pytest.approx(a)

    def test_it_is_continuous_at_his_entries(self, ardc):
        for entry in (500.0, 1500.0, 20_500.0, 23_500.0, 80_500.0):
            r = pub.bertram1966(ardc, [entry - 1e-3, entry, entry + 1e-3], 0.0, DIAGONAL, RADIUS)
            assert np.ptp(r) < 1e-5 * r[1]

    def test_nothing_is_added_beyond_80_5_km(self, ardc):
        r = pub.bertram1966(ardc, [80_500.0, 161_000.0], 0.0, DIAGONAL, RADIUS)
        assert r[1] == pytest.approx(r[0] / 2.0, rel=1e-12)
        # 2,340 / Z urad.
        assert r[0] / URAD * 80.5 == pytest.approx(2340.0, rel=0.005)
        # But the air up to there must be known.
        ican = standard_atmosphere("ican")
        assert np.isnan(pub.bertram1966(ican, 161_000.0, 0.0, DIAGONAL, RADIUS))

    def test_the_curved_term_as_printed_has_the_opposite_sign(self, ardc):
        ray = (ardc, 64_000.0, 0.0, DIAGONAL, RADIUS)
        flat = float(pub.bertram1966_from_ground(*ray))
        mended = float(pub.bertram1966_curved(*ray))
        printed = float(pub.bertram1966_curved(*ray, as_printed=True))
        assert mended - flat == pytest.approx(flat - printed, rel=1e-9)
        # "a correction of less than 1 %" at 64 km; the curvature raises R_c.
        assert 0.0 < mended / flat - 1.0 < 0.01
        assert abs(mended - refraction_angle(*ray)) < abs(flat - refraction_angle(*ray))

    def test_a_ground_below_the_sea(self, ardc):
        r = pub.bertram1966_from_ground(ardc, 3000.0, -430.0, DIAGONAL, RADIUS)
        assert float(r) == pytest.approx(refraction_angle(ardc, 3000.0, -430.0, DIAGONAL), rel=0.01)


class TestManual:
    def test_is_the_formula(self):
        r = pub.manual(None, 5000.0, 1000.0, 30.0 * DEGREE, RADIUS)
        k = 2410.0 * 5.0 / (25.0 - 30.0 + 250.0) - 2410.0 / (1.0 - 6.0 + 250.0) / 5.0
        assert float(r) == pytest.approx(k * 1e-6 * math.tan(30.0 * DEGREE), rel=1e-12)

    def test_reads_a_raised_ground_high(self, ardc):
        """10 km over 2 km: 33 % high; the fault is that of Bertram's Eq. 9."""
        r = float(pub.manual(ardc, 10_000.0, 2000.0, DIAGONAL, RADIUS))
        exact = refraction_angle(ardc, 10_000.0, 2000.0, DIAGONAL)
        assert r / exact == pytest.approx(1.33, abs=0.01)

    def test_is_a_fit_to_bertram(self):
        # Table 1 and 2 from 6.5 km: 61.9, 80.7, 93.3, 89.7, 59.7, 29.1 urad.
        h_c = np.array([6500.0, 10_500.0, 15_500.0, 20_500.0, 38_500.0, 80_500.0])
        printed = np.array([61.9, 80.7, 93.3, 89.7, 59.7, 29.1])
        r = pub.manual(None, h_c, 0.0, DIAGONAL, RADIUS) / URAD
        assert r == pytest.approx(printed, rel=0.07)


class TestMoist:
    @pytest.mark.parametrize("index", ["gyer", "ciddor"])
    @pytest.mark.parametrize("wet", [0.0, 0.02])
    def test_is_the_plane_form(self, index, wet):
        """Closed form against the integral: 2e-4 (compressibility of Ciddor's air 1e-3)."""
        air = linear_air(-6.5, index, wet)
        h_c = np.array([1000.0, 3000.0, 9000.0])
        closed = pub.plane_moist(air, h_c, 0.0, DIAGONAL, RADIUS)
        integral = pub.plane_first_term(air, h_c, 0.0, DIAGONAL, RADIUS)
        assert closed == pytest.approx(integral, rel=5e-4 if index == "gyer" else 2e-3)

    def test_humidity_lowers_refraction_and_saastamoinen_doubles_it(self):
        wet = linear_air(-6.5, wet=0.03)
        dry = linear_air(-6.5)
        drop = [
            1.0
            - float(f(wet, 3000.0, 0.0, DIAGONAL, RADIUS) / f(dry, 3000.0, 0.0, DIAGONAL, RADIUS))
            for f in (pub.plane_moist, pub.plane_first_term)
        ]
        assert drop[0] == pytest.approx(drop[1], rel=0.02)
        # The layers hold T_M: at the same density profile Saastamoinen sees no change at all.
        same = pub.saastamoinen1974(wet, 3000.0, 0.0, DIAGONAL, RADIUS)
        assert float(same) == pytest.approx(
            float(pub.saastamoinen1974(dry, 3000.0, 0.0, DIAGONAL, RADIUS)), rel=1e-12
        )


class TestTrace:
    """A published method in the place of the ray kernel: never a NaN without a status."""

    def rays(self, name, profile, h_c, h_g, degrees):
        zeta = np.radians(degrees)
        return PublishedRays(profile, pub.PUBLISHED[name]).bend(
            h_c, h_g, np.sin(zeta), np.cos(zeta), RADIUS
        )

    @pytest.mark.parametrize("name", pub.PUBLISHED)
    def test_gives_the_angles_of_the_method(self, name, us1962):
        r_c, status = self.rays(name, us1962, 6000.0, 100.0, np.array([1e-7, 30.0, 85.0]))
        direct = pub.PUBLISHED[name](us1962, 6000.0, 100.0, np.radians([1e-7, 30.0, 85.0]), RADIUS)
        assert status.tolist() == [OK] * 3
        assert r_c == pytest.approx(direct, rel=1e-12)

    @pytest.mark.parametrize("name", pub.PUBLISHED)
    def test_says_why_there_is_none(self, name, us1962):
        h_c = np.array([6000.0, 6000.0, np.nan, 6000.0, 6000.0])
        h_g = np.array([0.0, 7000.0, 0.0, np.nan, 0.0])
        r_c, status = self.rays(name, us1962, h_c, h_g, np.array([95.0, 45.0, 45.0, 45.0, np.nan]))
        assert np.isnan(r_c).all()
        assert status.tolist() == [
            MISSES_GROUND,
            OUTSIDE_PROFILE,
            BAD_MEASUREMENT,
            BAD_MEASUREMENT,
            BAD_MEASUREMENT,
        ]

    def test_heights_beyond_the_method(self, us1962):
        r_c, status = self.rays("saastamoinen1974_quadratic", us1962, 9500.0, 0.0, 45.0)
        assert np.isnan(r_c)
        assert int(status) == OUTSIDE_PROFILE

    def test_a_spherical_ray_that_passes_over_the_ground(self, us1962):
        _, status = self.rays("gyer1996", us1962, 10_000.0, 0.0, np.array([86.0, 88.0]))
        assert status.tolist() == [OK, MISSES_GROUND]

    @pytest.mark.parametrize("name", pub.PUBLISHED)
    def test_what_is_no_height_or_radius_never_reaches_the_method(self, name, us1962):
        h_c = np.array([np.inf, -np.inf, 6000.0, 6000.0, 6000.0, 6000.0, 6000.0, 6000.0, 6000.0])
        h_g = np.array([0.0, 0.0, np.inf, -np.inf, 0.0, 0.0, 0.0, 0.0, 0.0])
        radius = np.array([RADIUS] * 4 + [np.nan, np.inf, 0.0, -RADIUS, RADIUS])
        r_c, status = PublishedRays(us1962, pub.PUBLISHED[name]).bend(h_c, h_g, 0.6, 0.8, radius)
        assert status.tolist() == [BAD_MEASUREMENT] * 8 + [OK]
        assert np.isnan(r_c[:-1]).all()
        alone, _ = PublishedRays(us1962, pub.PUBLISHED[name]).bend(6000.0, 0.0, 0.6, 0.8, RADIUS)
        assert float(alone) == r_c[-1] > 0.0

    @pytest.mark.parametrize("name", pub.PUBLISHED)
    @pytest.mark.parametrize("h_c", [math.inf, -math.inf])
    def test_an_endless_height_is_refused(self, name, h_c, us1962):
        with pytest.raises(PhysicsError) as refusal:
            refraction_angle(us1962, h_c, 0.0, DIAGONAL, RADIUS, method=name)
        assert refusal.value.code == "RAY-BAD-MEASUREMENT"

    def test_the_spherical_ray_has_the_same_status(self, us1962):
        """One code, whichever method: a radius is a radius."""
        for radius in (math.nan, math.inf, 0.0, -1.0):
            for name in ("spherical", "plane", "gyer1996"):
                with pytest.raises(PhysicsError) as refusal:
                    refraction_angle(us1962, 6000.0, 0.0, DIAGONAL, radius, method=name)
                assert refusal.value.code == "RAY-BAD-MEASUREMENT"

    @pytest.mark.parametrize(("h_c", "h_g"), [(1e12, 0.0), (6000.0, -1e12), (1e300, -1e300)])
    def test_heights_outside_the_profile_cost_no_step(self, h_c, h_g, us1962, monkeypatch):
        """1e12 m would be a billion intervals of Eq. 31."""
        summed = []
        real = gyer._eq_31

        def counted(integrand, h, intervals, first):
            summed.append(float(intervals.count.max(initial=0.0)))
            few = replace(intervals, count=np.minimum(intervals.count, 100.0))
            return real(integrand, h, few, first)

        monkeypatch.setattr(gyer, "_eq_31", counted)
        r_c, status = PublishedRays(us1962, pub.gyer1996).bend(
            np.array([h_c, 6000.0]), np.array([h_g, 0.0]), 0.6, 0.8, RADIUS
        )
        assert status.tolist() == [OUTSIDE_PROFILE, OK]
        assert np.isnan(r_c[0])
        stepped = pub.plane_first_term(
            us1962, [h_c, 6000.0], [h_g, 0.0], DIAGONAL, RADIUS, step=1000.0
        )
        assert np.isnan(stepped).tolist() == [True, False]
        assert summed == [6.0, 0.0, 6.0]


@pytest.mark.parametrize("name", pub.PUBLISHED)
@pytest.mark.parametrize("endless", [math.inf, -math.inf])
def test_infinite_arguments_give_nan_without_a_warning(name, endless, us1962):
    for ray in ((endless, 0.0, DIAGONAL), (6000.0, endless, DIAGONAL), (6000.0, 0.0, endless)):
        assert np.isnan(pub.PUBLISHED[name](us1962, *ray, RADIUS)), ray
