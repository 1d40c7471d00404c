"""The kernel against 40-digit quadrature, an independent ODE, and itself where two forms meet."""

from __future__ import annotations

import math

import mpmath as mp
import numba
import numpy as np
import pytest
from scipy.integrate import trapezoid

from tests.physics.ray_on_sphere import ray_angle_sphere
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.messages import Ledger
from unbend.refraction import ray_table, refraction_angle
from unbend.units import ARCSEC, DEGREE

RADIUS = 6_371_000.0


@pytest.fixture(scope="module")
def us1976():
    return standard_atmosphere("us1976", index="gyer")


@pytest.fixture(scope="module")
def wiggly():
    """An adjusted profile with an inversion, humidity and a wavy lapse rate."""
    h = np.arange(300.0, 3300.0, 4.0)
    time_ns = (np.arange(h.size) * 10**9).astype(np.int64)
    t = 289.0 - 6.5e-3 * h + 6.0 / (1.0 + np.exp(-(h - 1400.0) / 40.0)) + 0.6 * np.sin(h / 90.0)
    rh = 0.5 + 0.3 * np.sin(h / 150.0)
    p = 98_000.0 * np.exp(-(h - 300.0) / 8400.0)
    used = np.zeros(h.size, np.uint8)
    samples = (
        SensorSamples(time_ns, h, v, used, name) for v, name in ((t, "T"), (p, "p"), (rh, "rh"))
    )
    return build_adjusted_profile(
        AirSamples(*samples), standard_atmosphere("us1976"), 47.0 * DEGREE, Ledger()
    ).profile


@pytest.mark.parametrize(
    ("h_c", "degrees", "arcsec"),
    [
        (10_000.0, 75.0, 61.778543),
        (10_000.0, 45.0, 16.378452),
        (3000.0, 45.0, 7.088778),
        (120.0, 45.0, 0.327323),
        (20_000.0, 85.0, 327.014637),
    ],
)
def test_the_reference_angles(us1976, h_c, degrees, arcsec):
    angle = refraction_angle(us1976, h_c, 0.0, degrees * DEGREE)
    assert angle / ARCSEC == pytest.approx(arcsec, abs=6e-7)  # 5e-7 of rounding


def test_random_rays_against_forty_digits(us1976, truth):
    # Reached: 3e-13 arcsec.
    rng = np.random.default_rng(1996)
    oracle = truth(40)
    for _ in range(60):
        h_c = float(10.0 ** rng.uniform(1.0, math.log10(30_000.0)))
        h_g = float(rng.uniform(-430.0, h_c))
        zeta = float(rng.uniform(0.0, 88.0)) * DEGREE
        if not reaches(h_c, h_g, zeta):
            continue
        angle = refraction_angle(us1976, h_c, h_g, zeta) / ARCSEC
        expected = oracle.angle(h_c, h_g, zeta, grazing=zeta > 80.0 * DEGREE)
        assert angle == pytest.approx(expected, abs=1e-11), (h_c, h_g, zeta / DEGREE)


def reaches(h_c, h_g, zeta):
    return (RADIUS + h_c) * math.sin(zeta) < (RADIUS + h_g) * (1.0 - 1e-6)


@pytest.mark.parametrize("below", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize("h_c", [50.0, 1000.0, 10_000.0, 25_000.0])
def test_near_grazing_against_forty_digits(us1976, truth, h_c, below):
    """``below`` degrees under the nadir angle at which the ray would just touch sea level."""
    n_c, n_g = (1.0 + float(us1976.refractivity(h)) for h in (h_c, 0.0))
    zeta = math.asin(n_g * RADIUS / (n_c * (RADIUS + h_c))) - below * DEGREE
    angle = refraction_angle(us1976, h_c, 0.0, zeta) / ARCSEC
    expected = truth(30).angle(h_c, 0.0, zeta, grazing=True)
    # Reached: 3e-11 arcsec.
    assert angle == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("h_c", [0.0, 1000.0, 5000.0])
@pytest.mark.parametrize("rise", [30.0, 12_000.0])
@pytest.mark.parametrize("degrees", [90.0, 90.01, 91.0, 95.0, 120.0, 170.0])
def test_targets_above_against_thirty_digits(us1976, truth, h_c, rise, degrees):
    zeta = degrees * DEGREE
    angle = refraction_angle(us1976, h_c, h_c + rise, zeta) / ARCSEC
    if degrees == 90.0:  # 90 deg in double precision is 6e-17 rad short of it
        expected = truth(50).through_lowest_point(h_c, h_c + rise, zeta)
    else:
        expected = truth(30).angle(h_c, h_c + rise, zeta, grazing=degrees < 92.0)
    # Reached: 7e-10 arcsec, level; 1e-11 from 91 deg.
    assert angle == pytest.approx(expected, abs=1e-9)


def test_a_target_two_kilometres_higher_at_95_degrees(us1976):
    # PHYSICS.md: 54 arcsec.
    angle = refraction_angle(us1976, 1000.0, 3000.0, 95.0 * DEGREE) / ARCSEC
    assert angle == pytest.approx(54.0, abs=0.5)


@pytest.mark.parametrize("h_c", [1000.0, 6000.0, 20_000.0])
@pytest.mark.parametrize("rise", [1.0, 500.0, 5000.0])
@pytest.mark.parametrize("degrees", [89.999, 89.99, 89.985, 89.6, 89.0])
def test_targets_above_through_the_lowest_point(us1976, truth, h_c, rise, degrees):
    zeta = degrees * DEGREE
    oracle = truth(30)
    turn = float(oracle.turning_height(h_c, zeta))
    if turn < -400.0:
        pytest.skip(f"this ray meets the ground: its lowest point would lie at {turn:.0f} m")
    angle = refraction_angle(us1976, h_c, h_c + rise, zeta) / ARCSEC
    expected = oracle.through_lowest_point(h_c, h_c + rise, zeta)
    # Reached: 8e-10 arcsec, and 1e-8 where the lowest point is 1 mm down: its height keeps
    # 4e-12 m. Thirty digits are good to 3e-11.
    assert angle == pytest.approx(expected, abs=1e-9 if degrees < 89.995 else 5e-8)


@pytest.mark.parametrize("degrees", [5.0, 30.0, 60.0, 80.0, 84.0])
@pytest.mark.parametrize("h_c", [150.0, 3000.0, 12_500.0, 28_000.0])
def test_us1976_against_an_independent_ode(us1976, h_c, degrees):
    angle = refraction_angle(us1976, h_c, -100.0, degrees * DEGREE)
    expected = ode(us1976, h_c, -100.0, degrees * DEGREE)
    # Reached: 9e-10 arcsec, all of it the ODE's, whose n = 1 + N keeps 2e-16: thirty digits are
    # 8e-12 from the angle.
    assert angle / ARCSEC == pytest.approx(expected / ARCSEC, abs=2e-9)


@pytest.mark.parametrize(
    ("h_c", "h_g", "degrees"),
    [
        (3200.0, 300.0, 20.0), (3200.0, 300.0, 60.0), (3200.0, 300.0, 84.0),
        (1425.0, 310.0, 75.0), (8000.0, 0.0, 80.0), (500.0, 2500.0, 100.0),
    ],
)  # fmt: skip
def test_a_wiggly_profile_against_an_independent_ode(wiggly, h_c, h_g, degrees):
    angle = refraction_angle(wiggly, h_c, h_g, degrees * DEGREE)
    expected = ode(wiggly, h_c, h_g, degrees * DEGREE)
    # Reached: 3e-10 arcsec.
    assert angle / ARCSEC == pytest.approx(expected / ARCSEC, abs=1e-9)


def ode(profile, h_c, h_g, zeta):
    return ray_angle_sphere(
        lambda h: 1.0 + float(profile.refractivity(h)),
        h_c,
        h_g,
        zeta,
        RADIUS,
        breaks=profile.break_heights_m.tolist(),
    )


def test_the_table_reproduces_the_profile(us1976, wiggly):
    for profile in (us1976, wiggly):
        table = ray_table(profile)
        h = np.linspace(-400.0, 30_000.0, 5003)
        piece = np.clip(np.searchsorted(table.edge_m, h, "right") - 1, 0, len(table.edge_m) - 2)
        u = (h - table.edge_m[piece]) / np.diff(table.edge_m)[piece]
        powers = u[:, None] ** np.arange(8)
        value = np.sum(table.coefficient[piece] * powers, axis=1)
        # Where layers meet, the two may differ by a step of the table's own making.
        np.testing.assert_allclose(value, profile.refractivity(h), rtol=2e-12)


def test_the_two_forms_agree_where_they_meet(us1976, wiggly):
    """The difference form and the subtended angle, both on either side of the guard."""
    from unbend.refraction.kernels.grazing import Ray, bend_by_subtended
    from unbend.refraction.kernels.ray import bend_by_difference

    @numba.njit(error_model="numpy")
    def both_forms(pieces, ray, h_g):
        return bend_by_difference(pieces, ray, h_g), bend_by_subtended(pieces, ray, h_g)

    worst = 0.0
    for profile in (us1976, wiggly):
        table = ray_table(profile)
        for h_c, h_g in ((3000.0, 0.0), (10_000.0, 350.0), (25_000.0, -200.0), (120.0, 0.0)):
            r_c = RADIUS + h_c
            r_g = RADIUS + h_g
            for part in (0.5, 0.6, 0.7):
                # q^2 = part * (r_c cos zeta)^2
                cos_c = math.sqrt((h_c - h_g) * (r_c + r_g) / (1.0 - part)) / r_c
                sin_c = math.sqrt((1.0 - cos_c) * (1.0 + cos_c))
                n_c = float(profile.refractivity(h_c))
                lift = (1.0 + n_c) * r_c * cos_c * cos_c / (1.0 + sin_c)
                ray = Ray(h_c, sin_c, cos_c, RADIUS, n_c, lift, (1.0 + n_c) * r_c * sin_c)
                one, two = both_forms(table.pieces, ray, h_g)
                worst = max(worst, abs(one - two) / ARCSEC)
    # Reached: 2e-10 arcsec at the guard, 0.5.
    assert worst < 1e-9, f"{worst:.2e} arcsec"


@pytest.mark.parametrize("part", [0.3, 0.4, 0.499, 0.501, 0.6])
@pytest.mark.parametrize(("h_c", "h_g"), [(3000.0, 2880.0), (950.0, 500.0), (500.0, 950.0)])
def test_about_the_guard_over_one_piece_of_the_table(us1976, truth, h_c, h_g, part):
    """q^2 at the lower end is ``part`` of that at the upper: few nodes for a steep integrand."""
    edge = ray_table(us1976).edge_m
    assert np.searchsorted(edge, h_c) == np.searchsorted(edge, h_g)
    low = min(h_c, h_g)
    high = max(h_c, h_g)
    q2 = (high - low) * (2.0 * RADIUS + low + high) / (1.0 - part)  # at the upper end
    if h_g < h_c:
        zeta = math.asin(math.sqrt(1.0 - q2 / (RADIUS + h_c) ** 2))
    else:
        zeta = math.pi - math.asin(math.sqrt(1.0 - q2 * part / (RADIUS + h_c) ** 2))
    angle = refraction_angle(us1976, h_c, h_g, zeta) / ARCSEC
    expected = truth(30).angle(h_c, h_g, zeta, grazing=True)
    # Reached: 4e-10 arcsec beside the guard, 0.5; a guard of 0.3 would leave 5e-7.
    assert angle == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("h_c", "below"), [(3000.0, 1e-2), (3000.0, 1e-4), (900.0, 1e-3)])
def test_near_grazing_through_many_kinks(wiggly, h_c, below):
    """Against 25-digit quadrature of the kernel's own polynomials, piece by piece (Eq. 12)."""
    h_g = 312.0
    table = ray_table(wiggly)
    edge = table.edge_m
    h_0, h_1 = (float(edge[np.searchsorted(edge, h)]) for h in (h_g, h_c))

    def n(i: int, h: mp.mpf) -> mp.mpf:
        u = (h - mp.mpf(edge[i])) / (mp.mpf(edge[i + 1]) - mp.mpf(edge[i]))
        return 1 + mp.fsum(mp.mpf(c) * u**j for j, c in enumerate(table.coefficient[i]))

    first, last = (int(np.searchsorted(edge, h)) for h in (h_0, h_1))
    # The camera stands on a boundary; the kernel reads the piece above it.
    zeta = (
        math.asin(float(n(first, h_0) * (RADIUS + h_0) / (n(last, h_1) * (RADIUS + h_1))))
        - below * DEGREE
    )
    with mp.workdps(25):
        k = n(last, mp.mpf(h_1)) * (RADIUS + mp.mpf(h_1)) * mp.sin(mp.mpf(zeta))
        theta = mp.mpf(0)
        for i in range(first, last):
            low = mp.mpf(edge[i])
            high = mp.mpf(edge[i + 1])
            shift = low - mp.mpf(h_0) + mp.mpf("1e-3")  # h = h_0 - 1 mm + s^2

            def integrand(s, i=i):
                h = mp.mpf(h_0) - mp.mpf("1e-3") + s * s
                r = RADIUS + h
                return 2 * s * k / (r * mp.sqrt((n(i, h) * r) ** 2 - k**2))

            theta += mp.quad(integrand, [mp.sqrt(shift), mp.sqrt(shift + high - low)])
        r_c = RADIUS + mp.mpf(h_1)
        r_g = RADIUS + mp.mpf(h_0)
        chord = mp.atan2(r_g * mp.sin(theta), r_c - r_g * mp.cos(theta))
        expected = float((mp.mpf(zeta) - chord) * 648_000 / mp.pi)
    angle = refraction_angle(wiggly, h_1, h_0, zeta) / ARCSEC
    # Reached: 1e-12 arcsec.
    assert angle == pytest.approx(expected, abs=1e-9)


def test_splitting_the_layers_changes_nothing(us1976):
    from unbend.atmosphere.layers import stack_layers
    from unbend.atmosphere.profile import Profile

    old = us1976.layers.edge
    edge = np.union1d(old[old <= 50_000.0], np.arange(-4900.0, 32_000.0, 170.0))
    height = us1976.gravity.height(edge)
    layers = stack_layers(
        edge,
        us1976.temperature(height),
        np.zeros(edge.size),
        ("",) * (edge.size - 1),
        anchor=(0.0, 101_325.0),
        constant=us1976.constant,
    )
    split = Profile(layers, us1976.gravity, us1976.index, "split", us1976.constant)
    rng = np.random.default_rng(3)
    h_c = rng.uniform(10.0, 30_000.0, 400)
    h_g = rng.uniform(-400.0, h_c)
    zeta = rng.uniform(0.0, 85.0, 400) * DEGREE
    one, two = (refraction_angle(p, h_c, h_g, zeta) / ARCSEC for p in (us1976, split))
    np.testing.assert_array_equal(np.isnan(one), np.isnan(two))
    # Reached: 5e-11 arcsec.
    np.testing.assert_allclose(one, two, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    "mutate",
    [
        pytest.param(lambda a: -a, id="sign"),
        pytest.param(lambda a: a * (1.0 + 1e-7), id="scale by 1e-7"),
    ],
)
def test_the_reference_angles_catch_mutants(us1976, mutate):
    angle = mutate(refraction_angle(us1976, 20_000.0, 0.0, 85.0 * DEGREE)) / ARCSEC
    assert abs(angle - 327.014637) > 6e-7


def test_the_plane_integral_is_a_good_approximation_below_60_degrees(us1976):
    """R = tan z * integral of (N - N_c) dh / (h_c - h_g): PHYSICS.md, S and B, first order."""
    h = np.linspace(0.0, 3000.0, 3001)
    n = us1976.refractivity(h)
    plane = trapezoid(n - n[-1], h) / 3000.0 / ARCSEC
    for degrees in (20.0, 45.0, 60.0):
        angle = refraction_angle(us1976, 3000.0, 0.0, degrees * DEGREE) / ARCSEC
        assert angle == pytest.approx(plane * math.tan(degrees * DEGREE), rel=3e-3)
