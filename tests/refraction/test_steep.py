"""Many rays from one camera share moments of the air; each must be what it is by itself."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import profile_from_table
from unbend.geodesy import lambert_gravity
from unbend.refraction import bend, ray_table
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, OK
from unbend.units import ARCSEC, DEGREE

RADIUS = 6_371_000.0


def inversions():
    """A profile of 400 thin layers with sharp inversions and moisture between them."""
    h = np.concatenate([np.arange(-450.0, 12_000.0, 31.7), np.arange(12_000.0, 45_000.0, 1700.0)])
    t = np.maximum(292.0 - 6.5e-3 * h, 217.0)
    t = t + 9.0 / (1.0 + np.exp(-(h - 800.0) / 15.0)) + 2.0 * np.sin(h / 70.0) * (h < 5000.0)
    e = 1400.0 * np.exp(-(h + 450.0) / 2000.0) * (1.0 + 0.3 * np.sin(h / 110.0))
    p = 101_325.0 * np.exp(-h / 8200.0)
    return profile_from_table(h, t, p, e, gravity=lambert_gravity(0.9))


@pytest.fixture(scope="module", params=["us1976", "inversions"])
def table(request):
    profile = standard_atmosphere("us1976") if request.param == "us1976" else inversions()
    return ray_table(profile)


def rays(rng, h_c, count, steepest=84.0):
    zeta = rng.uniform(0.0, steepest, count) * DEGREE
    h_g = h_c - (h_c + 430.0) * 10.0 ** rng.uniform(-3.0, 0.0, count)
    return h_g, np.sin(zeta), np.cos(zeta), rng.uniform(6.335e6, 6.400e6, count)


def one_by_one(table, h_c, h_g, sine, cosine, radius):
    found = [
        bend(table, h_c, *ray[:3], radius=ray[3])
        for ray in zip(h_g, sine, cosine, radius, strict=True)
    ]
    return tuple(np.array(column) for column in zip(*found, strict=True))


@pytest.mark.parametrize("h_c", [10.0, 120.0, 1000.0, 3450.0, 10_000.0, 30_000.0])
def test_a_ray_among_many_is_the_ray_by_itself(table, h_c):
    given = rays(np.random.default_rng(int(h_c)), h_c, 300)
    together, status = bend(table, h_c, *given[:3], radius=given[3])
    alone, status_alone = one_by_one(table, h_c, *given)
    np.testing.assert_array_equal(status, status_alone)
    # Reached: 3e-10 arcsec.
    np.testing.assert_allclose(together / ARCSEC, alone / ARCSEC, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("degrees", [25.0, 45.0, 55.0])
@pytest.mark.parametrize("h_c", [20_000.0, 30_000.0])
def test_deep_targets_at_one_nadir_angle_have_moments_enough(table, h_c, degrees):
    """How far the series goes is chosen for all rays of a group: here by their depth alone."""
    zeta = np.full(100, degrees * DEGREE)
    h_g = np.random.default_rng(1).uniform(-400.0, 0.9 * h_c, 100)
    given = (h_g, np.sin(zeta), np.cos(zeta), np.full(100, RADIUS))
    together, _ = bend(table, h_c, *given[:3], radius=given[3])
    alone, _ = one_by_one(table, h_c, *given)
    # Reached: 1.2e-12 of the angle.
    np.testing.assert_allclose(together, alone, rtol=4e-12, atol=0.0)


@pytest.mark.parametrize("first", [40.0, 88.0])
def test_flat_rays_among_steep_ones_to_the_same_height(table, first):
    """Those that bend too much for the series are left out of it one by one."""
    zeta = np.append(np.linspace(40.0, 88.0, 99), first)[::-1] * DEGREE
    given = (np.full(100, 20.0), np.sin(zeta), np.cos(zeta), np.full(100, RADIUS))
    together, status = bend(table, 300.0, *given[:3], radius=given[3])
    alone, status_alone = one_by_one(table, 300.0, *given)
    np.testing.assert_array_equal(status, status_alone)
    np.testing.assert_allclose(together / ARCSEC, alone / ARCSEC, rtol=0.0, atol=1e-9)


def test_the_series_is_what_is_used(table):
    """The comparison above would be empty if all rays were integrated one by one."""
    from unbend.refraction.kernels.columns import LEFT, RayColumns
    from unbend.refraction.kernels.moments import bend_steep_rays

    h_g, sine, cosine, radius = rays(np.random.default_rng(5), 3450.0, 300, steepest=60.0)
    angle = np.empty(300)
    status = np.empty(300, np.uint8)
    bend_steep_rays(
        table.fine, RayColumns(np.full(300, 3450.0), h_g, sine, cosine, radius, h_g), angle, status
    )
    assert (status == OK).all()
    assert LEFT not in status


def test_many_rays_against_forty_digits(truth):
    table = ray_table(standard_atmosphere("us1976", index="gyer"))
    oracle = truth(40)
    rng = np.random.default_rng(1974)
    for h_c in (120.0, 3000.0, 10_000.0, 24_000.0):
        h_g, sine, cosine, _ = rays(rng, h_c, 200, steepest=80.0)
        found, _ = bend(table, h_c, h_g, sine, cosine, radius=RADIUS)
        for i in rng.integers(0, 200, 8):
            zeta = math.atan2(sine[i], cosine[i])
            expected = oracle.angle(h_c, float(h_g[i]), zeta)
            # Reached: 2e-11 arcsec.
            assert found[i] / ARCSEC == pytest.approx(expected, abs=1e-9), (h_c, h_g[i], zeta)


def theta_form(table, h_c, h_g, zeta):
    """R_c [arcsec] by Gyer's Eq. 11 and 12 as they stand, in 80-bit arithmetic, piece by piece."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    edge = table.edge_m.astype(np.longdouble)
    radius = np.longdouble(RADIUS)
    h_c = np.longdouble(h_c)
    h_g = np.longdouble(h_g)
    first, last = (int(np.searchsorted(table.edge_m, float(h), "right")) - 1 for h in (h_g, h_c))

    def index(i, h):
        u = (h - edge[i]) / (edge[i + 1] - edge[i])
        return 1 + sum(np.longdouble(c) * u**j for j, c in enumerate(table.coefficient[i]))

    k = index(last, h_c) * (radius + h_c) * np.sin(np.longdouble(zeta))
    theta = np.longdouble(0)
    for i in range(first, last + 1):
        low = max(h_g, edge[i])
        high = min(h_c, edge[i + 1])
        h = low + (high - low) * (nodes.astype(np.longdouble) + 1) / 2
        r = radius + h
        n = index(i, h)
        theta += np.sum(weights * k / (r * np.sqrt((n * r) ** 2 - k * k))) * (high - low) / 2
    ahead = (h_c - h_g) / (radius + h_g) + 2 * np.sin(theta / 2) ** 2  # r_c / r_g - cos(theta)
    chord = np.arctan2(np.sin(theta), ahead)
    return float((np.longdouble(zeta) - chord) * 648_000 / np.longdouble(np.pi))


def test_inversions_against_eighty_bits():
    table = ray_table(inversions())
    rng = np.random.default_rng(1966)
    for h_c in (60.0, 840.0, 1000.0, 6000.0, 17_000.0):
        h_g, sine, cosine, _ = rays(rng, h_c, 120, steepest=82.0)
        found, _ = bend(table, h_c, h_g, sine, cosine, radius=RADIUS)
        for i in range(0, 120, 12):
            zeta = math.atan2(sine[i], cosine[i])
            alone, _ = bend(table, h_c, h_g[i], sine[i], cosine[i], radius=RADIUS)
            expected = theta_form(table, h_c, float(h_g[i]), zeta)
            # Reached: 4e-11 arcsec, of which the 80 bits are the larger part.
            assert found[i] / ARCSEC == pytest.approx(expected, abs=1e-9)
            assert alone / ARCSEC == pytest.approx(expected, abs=1e-9)


def test_nothing_jumps_where_layers_meet(table):
    """A hundredth of a millimetre on either side of boundaries, at both ends of the ray."""
    edges = table.edge_m[(table.edge_m > -400.0) & (table.edge_m < 14_000.0)][::7]
    step = 1e-5
    for degrees in (30.0, 80.0):
        sine = math.sin(degrees * DEGREE)
        cosine = math.cos(degrees * DEGREE)
        for h_c, h_g in ((edges, edges - 350.0), (edges + 350.0, edges)):
            below, at, above = (
                bend(table, h_c + d * (h_c is edges), h_g + d * (h_g is edges), sine, cosine)[0]
                for d in (-step, 0.0, step)
            )
            known = np.isfinite(below) & np.isfinite(above)
            assert known.sum() > 3
            # The slope may change at a boundary, the value not.
            jump = np.abs(above - 2.0 * at + below)[known]
            assert np.all(jump <= 1e-7 * np.abs(at[known]) + 1e-16)


def test_the_order_of_the_cameras_does_not_matter(table):
    rng = np.random.default_rng(11)
    h_c = np.repeat([500.0, 6000.0, 2500.0], 100)
    h_g = h_c - rng.uniform(1.0, 480.0, 300)
    sine = rng.uniform(0.0, 0.9, 300)
    cosine = np.sqrt(1.0 - sine * sine)
    order = rng.permutation(300)
    grouped, _ = bend(table, h_c, h_g, sine, cosine, radius=RADIUS)
    mixed, _ = bend(table, h_c[order], h_g[order], sine[order], cosine[order], radius=RADIUS)
    np.testing.assert_allclose(grouped[order] / ARCSEC, mixed / ARCSEC, rtol=0.0, atol=1e-9)


def test_radii_far_from_each_other_do_not_share(table):
    radius = np.where(np.arange(100) % 2, 6.371e6, 1.0e6)
    together, _ = bend(table, 3000.0, 200.0, 0.6, 0.8, radius=radius)
    alone = [bend(table, 3000.0, 200.0, 0.6, 0.8, radius=r)[0] for r in radius]
    np.testing.assert_allclose(together / ARCSEC, np.array(alone) / ARCSEC, rtol=0.0, atol=1e-9)


FAR = [(1000.0, 990.0, 89.4), (1000.0, 700.0, 89.2), (6000.0, 5000.0, 88.6), (300.0, 299.9, 89.7)]


@pytest.mark.parametrize(("h_c", "h_g", "degrees"), FAR)
def test_the_slant_range_says_which_crossing_is_meant(truth, h_c, h_g, degrees):
    oracle = truth(40)
    zeta = degrees * DEGREE
    table = ray_table(standard_atmosphere("us1976", index="gyer"))
    turn = oracle.turning_height(h_c, zeta)
    assert -430.0 < turn < h_g
    with mp.workdps(40):
        angle = mp.mpf(zeta)
        near = oracle.subtended(h_c, mp.mpf(h_g), mp.mpf(h_c), angle, True)
        far = 2 * oracle.subtended(h_c, turn, mp.mpf(h_c), angle, True) - near
        expected = [oracle.chord(h_c, h_g, angle, theta) for theta in (near, far)]
        spread = 4 * (RADIUS + mp.mpf(h_c)) * (RADIUS + mp.mpf(h_g))
        ranges = [
            float(mp.sqrt((mp.mpf(h_c) - mp.mpf(h_g)) ** 2 + spread * mp.sin(theta / 2) ** 2))
            for theta in (near, far)
        ]
    assert ranges[1] > 1.5 * ranges[0]
    given = [math.nan, ranges[0] * 1.05, ranges[1] * 0.95]
    found, status = bend(
        table, h_c, h_g, math.sin(zeta), math.cos(zeta), radius=RADIUS, distance=given
    )
    assert status.tolist() == [BEYOND_GRAZING, OK, FAR_BRANCH]
    wanted = [expected[0], expected[0], expected[1]]
    # Reached: 2e-9 arcsec; the lowest point keeps 1e-13 m of its height.
    np.testing.assert_allclose(found / ARCSEC, wanted, rtol=0.0, atol=1e-7)


def test_a_slant_range_changes_nothing_where_there_is_one_crossing(table):
    plain = bend(table, 3000.0, 100.0, 0.6, 0.8, radius=RADIUS)
    ranged = bend(table, 3000.0, 100.0, 0.6, 0.8, radius=RADIUS, distance=1e6)
    assert plain[0] == ranged[0]
    assert ranged[1] == OK
