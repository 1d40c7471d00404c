"""Many rays from one camera share moments of the air; each must be what it is by itself."""

import math

import numpy as np
import pytest

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.exact_rays import ExactRays
from tests.refraction.images import RADIUS
from tests.refraction.rays import TABLE, bent
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import profile_from_table
from unbend.geodesy import lambert_gravity
from unbend.refraction import ray_table
from unbend.refraction.kernels.columns import RayColumns
from unbend.refraction.kernels.moments import bend_steep_rays
from unbend.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, OK
from unbend.units import ARCSEC, DEGREE


def inversions():
    """A profile of 400 thin layers with sharp inversions and moisture between them."""
    low = np.arange(-450.0, 12_000.0, 31.7)
    high = np.arange(12_000.0, 45_000.0, 1700.0)
    h = np.append(low, high)
    t = np.maximum(292.0 - 6.5e-3 * h, 217.0)
    t += 9.0 / (1.0 + np.exp(-(h - 800.0) / 15.0))
    t += 2.0 * np.sin(h / 70.0) * (h < 5000.0)
    e = 1400.0 * np.exp(-(h + 450.0) / 2000.0)
    e *= 1.0 + 0.3 * np.sin(h / 110.0)
    p = 101_325.0 * np.exp(-h / 8200.0)
    return profile_from_table(
        h,
        t,
        p,
        e,
        gravity=lambert_gravity(0.9),
    )


@pytest.fixture(scope="module", params=["us1976", "inversions"])
def table(request):
    if request.param == "inversions":
        return ray_table(inversions())
    return ray_table(standard_atmosphere("us1976"))


def assert_each_as_alone(
    table,
    h_c,
    h_g,
    zeta,
    radius,
    *,
    rtol=0.0,
    atol=1e-9 * ARCSEC,
):
    """Rays (n,) bend together as one by one."""
    rays = np.broadcast_arrays(h_c, h_g, zeta, radius)
    together, status = bent(table, *rays)
    for i in range(together.size):
        alone, status_alone = bent(table, *(values[i] for values in rays))
        assert status[i] == status_alone
        assert_close(
            together[i],
            alone,
            rtol=rtol,
            atol=atol,
            equal_nan=True,
        )


def heights_below(rng, h_c, count):
    """Heights from a thousandth of the way down to the bottom of all land."""
    share = 10.0 ** rng.uniform(-3.0, 0.0, count)
    return h_c - (h_c + 430.0) * share


@pytest.mark.parametrize("h_c", [10.0, 120.0, 1000.0, 3450.0, 10_000.0, 30_000.0])
def test_a_ray_among_many_is_the_ray_by_itself(table, h_c):
    rng = np.random.default_rng(int(h_c))
    zeta = rng.uniform(0.0, 84.0, 200) * DEGREE
    h_g = heights_below(rng, h_c, 200)
    radius = rng.uniform(6.335e6, 6.400e6, 200)
    # Reached: 3e-10 arcsec.
    assert_each_as_alone(table, h_c, h_g, zeta, radius)


@pytest.mark.parametrize("degrees", [25.0, 45.0, 55.0])
@pytest.mark.parametrize("h_c", [20_000.0, 30_000.0])
def test_deep_targets_at_one_nadir_angle_have_moments_enough(table, h_c, degrees):
    """How far the series goes is chosen for all rays of a group: here by their depth alone."""
    h_g = np.random.default_rng(1).uniform(-400.0, 0.9 * h_c, 100)
    zeta = degrees * DEGREE
    # Reached: 1.2e-12 of the angle.
    assert_each_as_alone(table, h_c, h_g, zeta, RADIUS, rtol=4e-12, atol=0.0)


@pytest.mark.parametrize("first", [40.0, 88.0])
def test_flat_rays_among_steep_ones_to_the_same_height(table, first):
    """Those that bend too much for the series are left out of it one by one."""
    degrees = np.append(np.linspace(40.0, 88.0, 99), first)
    zeta = degrees[::-1] * DEGREE
    assert_each_as_alone(table, 300.0, 20.0, zeta, RADIUS)


def test_rays_of_several_cameras_in_any_order(table):
    """Those of one camera that follow each other share moments; mixed ones do not."""
    rng = np.random.default_rng(11)
    h_c = np.repeat([6000.0, 500.0, 2500.0], 100)
    h_g = h_c - rng.uniform(1.0, 480.0, 300)
    zeta = rng.uniform(0.0, 64.0, 300) * DEGREE
    grouped = np.stack([h_c, h_g, zeta])
    assert_each_as_alone(table, *grouped, RADIUS)
    mixed = rng.permutation(grouped, axis=1)
    assert_each_as_alone(table, *mixed, RADIUS)


def test_radii_far_from_each_other_do_not_share(table):
    radius = np.tile([1.0e6, RADIUS], 50)
    assert_each_as_alone(table, 3000.0, 200.0, 0.64, radius)


def test_the_series_is_what_is_used(table):
    """The comparisons above would be empty if all rays were integrated one by one."""
    rng = np.random.default_rng(5)
    zeta = rng.uniform(0.0, 60.0, 300) * DEGREE
    rays = RayColumns(
        h_c=np.full(300, 3450.0),
        h_g=heights_below(rng, 3450.0, 300),
        sin_c=np.sin(zeta),
        cos_c=np.cos(zeta),
        r_e=np.full(300, RADIUS),
        distance=np.full(300, np.nan),
    )
    status = np.empty(300, np.uint8)
    bend_steep_rays(
        table.fine,
        rays,
        np.empty(300),
        status,
    )
    assert (status == OK).all()


@pytest.mark.parametrize("degrees", [30.0, 80.0])
@pytest.mark.parametrize("end", ["camera", "target"])
def test_nothing_jumps_where_layers_meet(table, end, degrees):
    """A hundredth of a millimetre on either side of boundaries."""
    edges = table.edge_m
    inside = (edges > -400.0) & (edges < 14_000.0)
    edge = edges[inside][::7]
    beside = edge + np.array([[-1e-5], [0.0], [1e-5]])
    zeta = degrees * DEGREE
    if end == "camera":
        r_c, _ = bent(table, beside, edge - 350.0, zeta)
    else:
        r_c, _ = bent(table, edge + 350.0, beside, zeta)
    has_angle = np.isfinite(r_c[[0, 2]]).all(axis=0)
    assert has_angle.sum() > 3
    # The slope may change at a boundary, the value not.
    below, at_edge, above = r_c[:, has_angle]
    jump = np.abs(above - 2.0 * at_edge + below)
    assert np.all(jump <= 1e-7 * np.abs(at_edge) + 1e-16)


@pytest.mark.parametrize(
    ("h_c", "h_g", "degrees"),
    [
        (1000.0, 990.0, 89.4),
        (1000.0, 700.0, 89.2),
        (6000.0, 5000.0, 88.6),
        (300.0, 299.9, 89.7),
    ],
)
def test_the_slant_range_says_which_crossing_is_meant(h_c, h_g, degrees):
    exact = ExactRays(40)
    zeta = degrees * DEGREE
    ray = (h_c, h_g, zeta)
    near = exact.crossing(*ray)
    far = exact.crossing(*ray, beyond=True)
    assert far.distance_m > 1.5 * near.distance_m
    distance = [
        math.nan,
        near.distance_m * 1.05,
        far.distance_m * 0.95,
    ]

    r_c, status = bent(TABLE, *ray, distance=distance)

    assert status.tolist() == [BEYOND_GRAZING, OK, FAR_BRANCH]
    expected = [near.r_c_arcsec, near.r_c_arcsec, far.r_c_arcsec]
    # Reached: 2e-9 arcsec; the lowest point keeps 1e-13 m of its height.
    assert_near(r_c / ARCSEC, expected, 1e-7)


def test_a_slant_range_changes_nothing_where_there_is_one_crossing(table):
    ray = (table, 3000.0, 100.0, 0.64)
    plain, _ = bent(*ray)
    ranged, status = bent(*ray, distance=1e6)
    assert plain == ranged
    assert status == OK
