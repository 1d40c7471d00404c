"""The methods of the papers, against formulas written out by hand and against mpmath."""

import math
from math import inf, nan

import mpmath as mp
import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_close, assert_near
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.errors import PhysicsError
from unbend.geodesy import Gravity
from unbend.refraction import refraction_angle
from unbend.refraction.published import (
    PUBLISHED,
    bertram1966,
    bertram1966_curved,
    bertram1966_from_ground,
    compartment,
    gyer1996,
    manual,
    plane,
    plane_first_term,
    plane_moist,
    quadratic_coefficients,
    saastamoinen1974,
    saastamoinen1974_fitted,
    saastamoinen1974_ican,
    saastamoinen1974_quadratic,
    saastamoinen1974_series,
    saastamoinen1974_weather,
    weather_refraction,
)
from unbend.refraction.published.column import density, mean
from unbend.refraction.ray import PublishedRays
from unbend.refraction.status_codes import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE
from unbend.units import ARCSEC, DEGREE

RADIUS = 6_378_000.0
DIAGONAL = 45.0 * DEGREE
URAD = 1e-6


ARDC = standard_atmosphere("ardc1959", index="gyer")
US1962 = standard_atmosphere("us1962", index="gyer")


def linear_air(lapse_per_km, index="gyer", wet=0.0):
    """One layer of air; with a huge effective radius height and geopotential are the same."""
    edge_m = np.array([-2000.0, 15_000.0])
    temperature = 288.0 + lapse_per_km * 1e-3 * edge_m
    layers = stack_layers(
        edge_m,
        temperature,
        np.array([wet, 0.0]),
        ("standard",),
        anchor=(0.0, 101_000.0),
    )
    index_model = standard_atmosphere("us1976", index=index).index
    gravity = Gravity(9.80665, 1e18)
    return Profile(layers, gravity, index_model, "one layer")


def at_45(method, profile, h_c, h_g=0.0, **options):
    """Refraction [urad] at 45 degrees by a method."""
    r_c = method(
        profile,
        h_c,
        h_g,
        DIAGONAL,
        RADIUS,
        **options,
    )
    return r_c / URAD


def test_the_names_are_those_of_the_manual():
    assert list(PUBLISHED) == [
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


# Camera and ground [m], nadir angle [deg], radius of the earth [m].
GOOD_RAY = {"h_c": 6000.0, "h_g": 0.0, "degrees": 45.0, "radius": RADIUS}


def rays_with(changes):
    """Columns of the good ray with each of these changes, and at their end of itself."""
    rows = []
    for name, value, *_ in changes:
        rows.append([*(GOOD_RAY | {name: value}).values()])
    rows.append([*GOOD_RAY.values()])
    return np.array(rows).T


BAD_HEIGHTS = [
    ("h_c", nan, BAD_MEASUREMENT),
    ("h_c", inf, BAD_MEASUREMENT),
    ("h_c", -inf, BAD_MEASUREMENT),
    ("h_g", nan, BAD_MEASUREMENT),
    ("h_g", inf, BAD_MEASUREMENT),
    ("h_g", -inf, BAD_MEASUREMENT),
    ("h_g", 7000.0, OUTSIDE_PROFILE),  # over the camera
]
EVERY_METHOD = pytest.mark.parametrize("method", PUBLISHED.values(), ids=PUBLISHED)


@EVERY_METHOD
def test_every_method_broadcasts_and_keeps_the_shape(method):
    heights = np.array([[3000.0], [6000.0], [8000.0]])
    angles = np.array([0.0, 20.0, 45.0]) * DEGREE
    together = method(US1962, heights, 0.0, angles, RADIUS)
    assert together.shape == (3, 3)
    assert_near(together[:, 0], 0.0, 1e-20)
    for i, h_c in enumerate(heights[:, 0]):
        for j, zeta in enumerate(angles):
            alone = method(US1962, h_c, 0.0, zeta, RADIUS)
            assert alone.shape == ()
            assert_close(alone, together[i, j], rtol=1e-12)


@EVERY_METHOD
def test_every_method_is_nan_where_it_has_no_meaning_and_there_alone(method):
    changes = [*BAD_HEIGHTS]
    changes += [("degrees", value) for value in (90.0, 120.0, -1.0, inf, -inf)]
    h_c, h_g, degrees, _ = rays_with(changes)
    r_c = method(US1962, h_c, h_g, degrees * DEGREE, RADIUS)
    assert np.isnan(r_c[:-1]).all()
    alone = method(US1962, 6000.0, 0.0, DIAGONAL, RADIUS)
    assert_close(r_c[-1], alone, rtol=1e-12)


@EVERY_METHOD
def test_every_method_has_the_size_of_the_spherical_form(method):
    """At 45 degrees, 6 km above sea level: as measured, with room."""
    exact = at_45(refraction_angle, US1962, 6000.0)
    printed = at_45(method, US1962, 6000.0)
    assert_close(printed, exact, rtol=0.02)


@pytest.mark.parametrize("name", sorted(set(PUBLISHED) - {"saastamoinen1974_weather"}))
def test_no_height_difference_no_refraction(name):
    r = at_45(PUBLISHED[name], US1962, 5000.0, 5000.0)
    assert_near(r, 0.0, 1e-9)


READ_THE_PROFILE = set(PUBLISHED) - {
    "manual",
    "saastamoinen1974_ican",
    "saastamoinen1974_quadratic",
    # These go on beyond 80.5 km without air.
    "bertram1966",
    "bertram1966_curved",
    "bertram1966_from_ground",
}


@pytest.mark.parametrize("name", sorted(READ_THE_PROFILE))
def test_outside_the_profile_is_nan(name):
    too_high = at_45(PUBLISHED[name], US1962, [95_000.0])
    too_low = at_45(PUBLISHED[name], US1962, [6000.0], [-6000.0])
    assert np.isnan([too_high, too_low]).all()


@pytest.mark.parametrize("wet", [0.0, 0.02])
def test_moist_air_is_lighter(wet):
    """By 1 - 0.378 e / p."""
    air = linear_air(-6.5, wet=wet)
    t = air.temperature(0.0)
    e = air.vapour_pressure(0.0)
    by_hand = (101_000.0 - 0.378 * e) * 28.9644 / (8314.32 * t)
    assert_close(density(air, 0.0), by_hand, rtol=1e-12)


def test_the_mean_over_a_column_has_a_closed_form():
    """rho dH = -dp / G: the mean density of a hydrostatic layer is its drop of pressure."""
    air = linear_air(-6.5)
    h_g = np.array([0.0, 123.4, 3000.0])
    h_c = np.array([10.0, 9000.0, 14_999.0])
    drop = air.pressure(h_g) - air.pressure(h_c)
    by_pressure = drop / (9.80665 * (h_c - h_g))
    assert_close(mean(air, density, h_g, h_c), by_pressure, rtol=1e-11)
    # A column of no thickness has the density of its place.
    place = np.array([500.0])
    assert_close(mean(air, density, place, place), density(air, place), rtol=1e-15)


def plane_truth(profile, h_c, zeta, terms):
    """Eq. 22 with Eq. 23, by mpmath over the layers of the profile."""

    def index(h):
        return 1 + mp.mpf(float(profile.refractivity(float(h))))

    with mp.workdps(25):
        n_c = index(h_c)
        unit = (n_c * mp.cos(zeta)) ** 2

        def integrand(h):
            u = (index(h) ** 2 - n_c**2) / unit
            series = [u / 2, -3 * u**2 / 8, 5 * u**3 / 16]
            return mp.fsum(series[:terms])

        kinks = [h for h in profile.break_heights_m.tolist() if 0.0 < h < h_c]
        total = mp.quad(integrand, [0, *kinks, h_c])
        return float(mp.cos(zeta) ** 2 * mp.tan(zeta) / h_c * total)


@pytest.mark.parametrize("degrees", [20.0, 60.0, 85.0])
@pytest.mark.parametrize("h_c", [3000.0, 13_000.0])
def test_plane_is_eq_22(h_c, degrees):
    zeta = degrees * DEGREE
    first_term = plane_first_term(ARDC, h_c, 0.0, zeta, RADIUS)
    assert_close(first_term, plane_truth(ARDC, h_c, zeta, 1), rtol=1e-10)
    three_terms = plane(ARDC, h_c, 0.0, zeta, RADIUS)
    assert_close(three_terms, plane_truth(ARDC, h_c, zeta, 3), rtol=1e-10)


def test_plane_first_term_in_steps_goes_to_the_integral():
    exact = at_45(plane_first_term, ARDC, 10_000.0, 300.0)
    coarse = at_45(
        plane_first_term,
        ARDC,
        10_000.0,
        300.0,
        step=1000.0,
    )
    fine = at_45(
        plane_first_term,
        ARDC,
        10_000.0,
        300.0,
        step=100.0,
    )
    assert 1e-9 < abs(coarse / exact - 1.0) < 1e-3
    assert_close(fine, exact, rtol=1e-6)


def test_gyer_goes_to_the_converged_integral_with_its_step():
    zeta = np.array([30.0, 75.0, 85.0]) * DEGREE
    ray = (ARDC, 24_000.0, 500.0, zeta, RADIUS)
    exact = refraction_angle(*ray)

    def largest_error(step):
        return np.abs(gyer1996(*ray, step=step) - exact).max() / ARCSEC

    assert largest_error(1000.0) > 0.02
    assert largest_error(100.0) < 2e-3


def test_sums_eq_31_by_hand():
    """Two intervals, written out."""
    zeta = 70.0 * DEGREE
    h = np.array([-1000.0, 0.0, 1000.0, 2000.0, 3000.0])
    r = RADIUS + h
    n = 1.0 + ARDC.refractivity(h)
    k = n[3] * r[3] * math.sin(zeta)
    value = k / (r * np.sqrt(n * n * r * r - k * k))
    lower = -value[0] + 13 * value[1] + 13 * value[2] - value[3]
    upper = -value[1] + 13 * value[2] + 13 * value[3] - value[4]
    theta = 1000.0 / 24.0 * (lower + upper)
    across = r[1] * math.sin(theta)
    down = r[3] - r[1] * math.cos(theta)
    straight = math.atan2(across, down)
    r_c = gyer1996(ARDC, 2000.0, 0.0, zeta, RADIUS)
    assert_close(r_c, zeta - straight, rtol=3e-8)


@pytest.mark.parametrize("rise", [1.0, 400.0, 1000.0, 1400.0])
def test_gyer_with_heights_that_are_no_multiple_of_the_step(rise):
    r_c = at_45(gyer1996, ARDC, 300.0 + rise, 300.0)
    exact = at_45(refraction_angle, ARDC, 300.0 + rise, 300.0)
    # Eq. 11 cancels: rounding errors of 1 count for RADIUS / rise.
    assert r_c == pytest.approx(exact, rel=1e-4, abs=1e-3 / rise)


def test_gyer_sums_a_ray_level_at_the_ground_in_thin_shells():
    h_c = 10_000.0
    n_c, n_g = 1.0 + ARDC.refractivity([h_c, 0.0])
    touching = math.asin(n_g * RADIUS / (n_c * (RADIUS + h_c)))

    def arcsec(method, zeta):
        return method(ARDC, h_c, 0.0, zeta, RADIUS) / ARCSEC

    level = arcsec(gyer1996, touching)
    near = arcsec(refraction_angle, touching - 1e-12)
    assert_near(level, near, 1.6)
    assert level < near


def test_gyer_refuses_a_step_that_leads_nowhere():
    with refused("METHOD-STEP", PhysicsError):
        at_45(gyer1996, ARDC, 5000.0, step=0.0)


class Parabola(Profile):
    """A profile whose index is a parabola."""

    c_1 = -26e-9
    c_2 = 0.8e-12

    def refractivity(self, h):
        return self.of_powers(h, np.square(h))

    def of_powers(self, height, square):
        return 277e-6 + self.c_1 * height + self.c_2 * square


@pytest.mark.parametrize("h_g", [-400.0, 0.0, 150.0])
def test_ican_formulas_are_eq_2_in_that_atmosphere(h_g):
    ican = standard_atmosphere("ican")
    h_c = [
        200.0,
        1000.0,
        3000.0,
        6000.0,
        11_000.0,
        11_001.0,
        12_000.0,
        20_000.0,
    ]
    summed = at_45(saastamoinen1974, ican, h_c, h_g)
    formula = at_45(saastamoinen1974_ican, ican, h_c, h_g)
    assert_near(formula, summed, 0.2)


def test_ican_formulas_meet_at_the_tropopause():
    h_c = [11_000.0, 11_000.001]
    below, above = at_45(saastamoinen1974_ican, None, h_c)
    assert_near(below, above, 0.06)


def test_saastamoinen_eq_6():
    r = at_45(saastamoinen1974_quadratic, US1962, 6000.0, 1000.0)
    assert_close(r, 13.0 * 5.0 * (1.0 - 0.02 * 13.0), rtol=1e-12)
    h_c = np.arange(250.0, 9001.0, 250.0)
    summed = at_45(saastamoinen1974, US1962, h_c)
    formula = at_45(saastamoinen1974_quadratic, US1962, h_c)
    assert_near(formula, summed, 0.5)


def test_saastamoinen_eq_5_is_exact_in_an_index_of_second_order():
    air = Parabola(**vars(linear_air(-6.5)))
    fitted = quadratic_coefficients(air)
    assert_close(fitted, (air.c_1, air.c_2), rtol=1e-9)
    h_c = 7000.0
    h_g = 900.0
    r = at_45(saastamoinen1974_fitted, air, h_c, h_g) * URAD
    mean_height = (h_c + h_g) / 2
    mean_square = (h_c**2 + h_c * h_g + h_g**2) / 3
    mean_n = air.of_powers(mean_height, mean_square)
    assert_close(r, mean_n - air.refractivity(h_c), rtol=1e-9)


def test_saastamoinens_parabola_needs_heights_inside_the_profile():
    with refused("METHOD-SPAN", PhysicsError):
        quadratic_coefficients(US1962, 5000.0, 4000.0)
    with refused("METHOD-SPAN", PhysicsError):
        at_45(saastamoinen1974_fitted, US1962, 1.0, highest=2e5)


@pytest.mark.parametrize("h_c", [120.0, 3000.0, 10_000.0])
def test_saastamoinen_eq_7_misses_eq_2_by_its_constant(h_c):
    """With 34.163 for 34.11 Eq. 7 is Eq. 2: the gap is the constant times p / T."""
    air = linear_air(-6.5)
    p_hpa = air.pressure(h_c) / 100.0
    t = air.temperature(h_c)
    r = at_45(saastamoinen1974_weather, air, h_c)
    mended = r - 2.316 * (34.1632 - 34.11) * p_hpa / t
    summed = at_45(saastamoinen1974, air, h_c)
    # 2.316 * 34.163 = 79.12; 0.226 * 0.34837 * 1000 = 78.73: half a percent apart.
    assert_close(mended, summed * 79.122 / 78.732, rtol=2e-4)


@pytest.mark.parametrize("h_c", [120.0, 1000.0, 4000.0, 9000.0])
@pytest.mark.parametrize("lapse", [-9.0, -6.5, 0.0, 5.0])
def test_saastamoinens_series_is_eq_7_expanded(lapse, h_c):
    """Eq. 7 with 34.1 in 40 digits, in air linear in temperature; and 39.6 for 39.49."""
    with mp.workdps(40):
        t_0 = mp.mpf(288)
        rise_km = mp.mpf(h_c) / 1000
        per_km = mp.mpf(lapse) + mp.mpf("1e-20")  # no division by zero in isothermal air
        t = t_0 + per_km * rise_km
        g = mp.mpf("34.1")
        fall = (t / t_0) ** (-g / per_km)
        excess = (1 - fall) / rise_km - g * fall / t
        eq_7 = float(1010 * excess * mp.mpf("39.6") / (g / 2))
    air = linear_air(lapse)
    series = at_45(saastamoinen1974_series, air, h_c)
    assert_close(series, eq_7, rtol=1e-9)


def test_saastamoinen_eq_10_is_eq_7_plus_eq_9():
    rays = (101_325.0, 47_200.0, 6000.0)
    outside = weather_refraction(*rays, 47_200.0, 249.0)
    inside = weather_refraction(*rays, 74_700.0, 278.0)
    n_outside = 79.0e-6 * 472.0 / 249.0
    n_inside = 79.0e-6 * 747.0 / 278.0
    step = compartment(n_outside, n_inside)
    assert_close(inside - outside, step, rtol=1e-4)


def test_bertram_eq_9_is_printed_so():
    high = at_45(bertram1966, ARDC, 10_500.0)
    low = at_45(bertram1966, ARDC, 1500.0)
    raised = at_45(bertram1966, ARDC, 10_500.0, 1500.0)
    assert_close(raised, high - 1500.0 / 10_500.0 * low, rtol=1e-12)
    # His example, from densities of three digits: 78.1 urad.
    assert_near(raised, 78.1, 0.15)


@pytest.mark.parametrize(
    ("h_c", "h_g", "percent", "within"),
    [
        (10_000.0, 2000.0, 25.0, 0.014),
        (3000.0, 1000.0, 34.0, 0.014),
        (3000.0, -430.0, -16.3, 0.01),  # a ground below the sea
    ],
)
def test_bertram_eq_9_is_not_the_refraction_over_another_ground(h_c, h_g, percent, within):
    exact = at_45(refraction_angle, ARDC, h_c, h_g)
    printed = at_45(bertram1966, ARDC, h_c, h_g)
    excess = printed / exact - 1.0
    assert_near(100.0 * excess, percent, 1.0)
    started_at_ground = at_45(bertram1966_from_ground, ARDC, h_c, h_g)
    assert_close(started_at_ground, exact, rtol=within)


def test_bertram_started_at_the_ground_is_his_sum_at_sea_level():
    h_c = [300.0, 500.0, 7321.0, 20_500.0, 41_000.0]
    from_sea_level = at_45(bertram1966, ARDC, h_c)
    from_ground = at_45(bertram1966_from_ground, ARDC, h_c)
    assert_close(from_ground, from_sea_level, rtol=1e-6)


@pytest.mark.parametrize("entry", [500.0, 1500.0, 20_500.0, 23_500.0, 80_500.0])
def test_bertram_is_continuous_at_his_entries(entry):
    h_c = entry + np.array([-1e-3, 0.0, 1e-3])
    r = at_45(bertram1966, ARDC, h_c)
    assert np.ptp(r) < 1e-5 * r[1]


def test_bertram_adds_nothing_beyond_80_5_km():
    h_c = [80_500.0, 161_000.0]
    at_end, twice_as_high = at_45(bertram1966, ARDC, h_c)
    assert_close(twice_as_high, at_end / 2.0, rtol=1e-12)
    # 2,340 / Z urad.
    assert_close(at_end * 80.5, 2340.0, rtol=0.005)
    # But the air up to there must be known.
    ican = standard_atmosphere("ican")
    assert np.isnan(at_45(bertram1966, ican, 161_000.0))


def test_bertrams_curved_term_as_printed_has_the_opposite_sign():
    ray = (ARDC, 64_000.0)
    flat = at_45(bertram1966_from_ground, *ray)
    mended = at_45(bertram1966_curved, *ray)
    printed = at_45(bertram1966_curved, *ray, as_printed=True)
    exact = at_45(refraction_angle, *ray)
    assert_close(mended - flat, flat - printed, rtol=1e-9)
    # "a correction of less than 1 %" at 64 km; the curvature raises R_c.
    assert 0.0 < mended / flat - 1.0 < 0.01
    assert abs(mended - exact) < abs(flat - exact)


def test_manual_is_the_formula():
    zeta = 30.0 * DEGREE
    r = manual(None, 5000.0, 1000.0, zeta, RADIUS)
    k = 2410.0 * 5.0 / (25.0 - 30.0 + 250.0) - 2410.0 / (1.0 - 6.0 + 250.0) / 5.0
    assert_close(r, k * URAD * math.tan(zeta), rtol=1e-12)


def test_manual_is_a_fit_to_bertram():
    printed = [  # h_c, R [urad] in Table 1 and 2 from 6.5 km
        (6500.0, 61.9),
        (10_500.0, 80.7),
        (15_500.0, 93.3),
        (20_500.0, 89.7),
        (38_500.0, 59.7),
        (80_500.0, 29.1),
    ]
    for h_c, r in printed:
        assert_close(at_45(manual, None, h_c), r, rtol=0.07)


@pytest.mark.parametrize(
    ("index", "within"),
    [
        ("gyer", 5e-4),
        ("ciddor", 2e-3),
    ],
)
@pytest.mark.parametrize("wet", [0.0, 0.02])
def test_plane_moist_is_the_plane_form(index, within, wet):
    """Closed form against the integral: 2e-4 (compressibility of Ciddor's air 1e-3)."""
    air = linear_air(-6.5, index, wet)
    h_c = np.array([1000.0, 3000.0, 9000.0])
    integral = at_45(plane_first_term, air, h_c)
    closed_form = at_45(plane_moist, air, h_c)
    assert_close(closed_form, integral, rtol=within)


def test_humidity_lowers_refraction_and_saastamoinen_does_not_see_it():
    wet = linear_air(-6.5, wet=0.03)
    dry = linear_air(-6.5)

    def ratio(method):
        return at_45(method, wet, 3000.0) / at_45(method, dry, 3000.0)

    drop = 1.0 - ratio(plane_moist)
    drop_of_integral = 1.0 - ratio(plane_first_term)
    assert_close(drop, drop_of_integral, rtol=0.02)
    # The layers hold T_M: at the same density profile Saastamoinen sees no change at all.
    assert_close(ratio(saastamoinen1974), 1.0, rtol=1e-12)


class AskedSeldom(Profile):
    """A profile that refuses to be asked for the index more than 200 times."""

    def refractivity(self, h):
        times = vars(self).get("asked", 0) + 1
        vars(self)["asked"] = times  # a frozen dataclass
        assert times <= 200
        return super().refractivity(h)


RAYS_WITHOUT_ANGLE = [
    *BAD_HEIGHTS,
    ("degrees", 95.0, MISSES_GROUND),
    ("degrees", nan, BAD_MEASUREMENT),
    ("radius", nan, BAD_MEASUREMENT),
    ("radius", inf, BAD_MEASUREMENT),
    ("radius", 0.0, BAD_MEASUREMENT),
    ("radius", -RADIUS, BAD_MEASUREMENT),
]


def bent_by(method, h_c, h_g, zeta, radius=RADIUS):
    """A published method in the place of the ray kernel: never a NaN without a status."""
    rays = PublishedRays(US1962, method)
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    return rays.bend(h_c, h_g, sine, cosine, radius)


@EVERY_METHOD
def test_rays_by_a_method_have_its_angles(method):
    zeta = np.radians([1e-7, 30.0, 85.0])
    r_c, status = bent_by(method, 6000.0, 100.0, zeta)
    assert status.tolist() == [OK] * 3
    expected = method(US1962, 6000.0, 100.0, zeta, RADIUS)
    assert_close(r_c, expected, rtol=1e-12)


@EVERY_METHOD
def test_rays_by_a_method_say_why_there_is_no_angle(method):
    h_c, h_g, degrees, radius = rays_with(RAYS_WITHOUT_ANGLE)
    zeta = np.radians(degrees)

    r_c, status = bent_by(method, h_c, h_g, zeta, radius)

    reasons = [reason for _, _, reason in RAYS_WITHOUT_ANGLE]
    assert status.tolist() == [*reasons, OK]
    assert np.isnan(r_c[:-1]).all()
    alone, _ = bent_by(method, 6000.0, 0.0, zeta[-1])
    assert alone == r_c[-1]


@pytest.mark.parametrize(
    ("method", "h_c", "h_g", "beyond"),
    [
        (saastamoinen1974_ican, 30_000.0, 0.0, {"h_c": 30_001.0}),
        (saastamoinen1974_ican, 12_000.0, 11_000.0, {"h_g": 11_500.0}),
        (saastamoinen1974_quadratic, 9000.0, 0.0, {"h_c": 9001.0}),
        (saastamoinen1974_fitted, 9000.0, 0.0, {"h_c": 9001.0}),
        (bertram1966, 3000.0, -1000.0, {"h_g": -1001.0}),
        (manual, 0.1, -10.0, {"h_c": 0.0}),
        (manual, 80_500.0, 0.0, {"h_c": 80_501.0}),
        (manual, 3000.0, -1000.0, {"h_g": -1001.0}),
    ],
)
def test_a_method_ends_where_it_ends(method, h_c, h_g, beyond):
    ray = {"h_c": h_c, "h_g": h_g, "zeta": 0.64}
    inside, status = bent_by(method, **ray)
    assert np.isfinite(inside)
    assert status == OK
    outside, status = bent_by(method, **(ray | beyond))
    assert np.isnan(outside)
    assert status == OUTSIDE_PROFILE


def test_a_spherical_ray_by_gyer_passes_over_the_ground():
    zeta = np.radians([86.0, 88.0])
    _, status = bent_by(gyer1996, 10_000.0, 0.0, zeta)
    assert status.tolist() == [OK, MISSES_GROUND]


@pytest.mark.parametrize(
    ("h_c", "h_g"),
    [
        (1e12, 0.0),
        (6000.0, -1e12),
        (1e300, -1e300),
    ],
)
def test_heights_outside_the_profile_cost_no_step(h_c, h_g):
    """1e12 m would be a billion intervals of Eq. 31."""
    heights = ([h_c, 6000.0], [h_g, 0.0])
    air = AskedSeldom(**vars(US1962))
    rays = PublishedRays(air, gyer1996)
    _, status = rays.bend(*heights, 0.6, 0.8, RADIUS)
    assert status.tolist() == [OUTSIDE_PROFILE, OK]
    stepped = at_45(plane_first_term, air, *heights, step=1000.0)
    assert np.isnan(stepped).tolist() == [True, False]
