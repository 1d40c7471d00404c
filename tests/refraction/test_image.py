"""Image points against Gyer's scalar equations; special directions; what has no correction."""

import math
from dataclasses import replace
from math import inf, nan

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import (
    DISTORTED,
    DOWN,
    NO_EXPOSURES,
    PINHOLE,
    RADIUS,
    corrected,
    displaced,
    exposure,
    looking,
    together,
)
from tests.refraction.rays import AIR, TABLE
from tests.refraction.straight_lines import metres_apart
from unbend.geodesy import euler_radius
from unbend.refraction import refraction_angle, status_codes
from unbend.refraction.image import ground_displacement, outgoing_rays, straight_reach
from unbend.refraction.kernels.columns import SPHERE_RADIUS, ObservationColumns
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    FAR_BRANCH,
    MISSES_GROUND,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
    STATUS_NAMES,
)
from unbend.refraction.window import refract_at_window

H_C = 3450.0
H_G = 450.0
F_PX = PINHOLE.fx_px
OUTSIDE = float(AIR.refractivity(H_C))
CABIN_EXCESS = 6e-5
WITHOUT_AND_WITH_WINDOW = pytest.mark.parametrize(
    "excess",
    [0.0, CABIN_EXCESS],
    ids=["no window", "window"],
)


def gyer_scalar(x_px, y_px, rotation, cabin):
    """dx and dy [px], zeta_c and R_c [rad]: Gyer 1996, Eq. 36-51 as they should read.

    See reference/README.md, 3-6. Photo axes x right, y up, the image at z = -f; M takes
    east-north-up to them.
    """
    f = mp.mpf(F_PX)
    x_m = mp.mpf(x_px) - PINHOLE.cx_px
    y_m = PINHOLE.cy_px - mp.mpf(y_px)
    m = DOWN @ rotation
    c_x, c_y, big_f = map(mp.mpf, m[:, 2])
    rho = mp.sqrt(x_m**2 + y_m**2)
    # Eq. 36, 37, 39
    zeta_f = mp.atan(rho / f)
    n_cabin = 1 + mp.mpf(cabin)
    n_outside = 1 + mp.mpf(OUTSIDE)
    zeta_a = mp.asin(n_cabin / n_outside * mp.sin(zeta_f))
    outward = f * mp.tan(zeta_a) / rho
    x_cc = x_m * outward
    y_cc = y_m * outward
    # Eq. 40
    x_n = -f * c_x / big_f
    y_n = -f * c_y / big_f
    c = mp.sqrt(x_n**2 + y_n**2 + f**2)  # Eq. 44
    ray = mp.sqrt(f**2 + x_cc**2 + y_cc**2)
    zeta_c = mp.acos((f**2 + x_n * x_cc + y_n * y_cc) / (c * ray))  # Eq. 42
    r_c = refraction_angle(AIR, H_C, H_G, float(zeta_c), RADIUS)
    x_a = x_n - x_cc
    y_a = y_n - y_cc
    a = mp.sqrt(x_a**2 + y_a**2)  # Eq. 43
    beta = mp.acos((x_n * x_a + y_n * y_a) / (c * a))  # Eq. 46
    straight = zeta_c - mp.mpf(r_c)
    delta_a = a - c * mp.sin(straight) / mp.sin(beta + straight)  # Eq. 45
    x_c = x_cc + x_a / a * delta_a  # Eq. 50, with its sign turned
    y_c = y_cc + y_a / a * delta_a  # Eq. 51
    return x_c - x_m, y_m - y_c, zeta_c, r_c


X_PX = [7512.4, 100.0, 13_900.0, 3000.0, 7012.4]
Y_PX = [5291.7, 200.0, 10_500.0, 9000.0, 800.0]


def rays_of(x, y):
    """Unit vectors (n, 3) of pixels in the camera's frame."""
    u = (x - PINHOLE.cx_px) / F_PX
    v = (y - PINHOLE.cy_px) / F_PX
    rays = np.stack([u, v, np.ones(x.size)], axis=1)
    return rays / np.linalg.norm(rays, axis=1)[:, None]


FARTHEST_NADIR_DEG = math.degrees(math.atan(10.0))  # its image is 10 focal lengths away


@WITHOUT_AND_WITH_WINDOW
@pytest.mark.parametrize(
    ("azimuth", "swing"),
    [
        (200, -90),
        (70, 20),
    ],
)
@pytest.mark.parametrize("tilt", [0.0, 3.0, 45.0, 60.0, 75.0, 84.0, FARTHEST_NADIR_DEG])
def test_against_gyers_scalar_equations(tilt, azimuth, swing, excess):
    rotation = looking(tilt, azimuth, swing)
    rng = np.random.default_rng(1996)
    random_x, random_y = rng.uniform(0.0, [14_000.0, 10_600.0], (12, 2)).T
    x = np.append(X_PX, random_x)
    y = np.append(Y_PX, random_y)
    rays = rays_of(x, y)
    nadir_deg = np.degrees(np.arccos(-rays @ rotation[:, 2]))
    ground = nadir_deg < 88.0  # grazing is at 88.3 degrees
    x = x[ground]
    y = y[ground]
    assert x.size >= 7

    setup = exposure(AIR, rotation, cabin_excess=excess)
    corrections = corrected(x, y, setup, TABLE, h_g=H_G)

    assert (corrections.status == OK).all()
    rows = []
    with mp.workdps(30):
        for pixel in zip(x, y, strict=True):
            exact = gyer_scalar(*pixel, rotation, OUTSIDE + excess)
            rows.append([float(value) for value in exact])
    dx, dy, zeta_c, r_c = np.transpose(rows)
    # Reached: 2e-12 px, of up to 17.
    assert_near(corrections.dx_px, dx, 1e-10)
    assert_near(corrections.dy_px, dy, 1e-10)
    assert_near(corrections.zeta_c_rad, zeta_c, 1e-15)
    assert_close(corrections.r_c_rad, r_c, rtol=1e-12)
    assert_array_equal(corrections.x_corrected_px, x + corrections.dx_px)
    assert_array_equal(corrections.y_corrected_px, y + corrections.dy_px)


def test_exactly_at_the_nadir_nothing_moves():
    nadir = (PINHOLE.cx_px, PINHOLE.cy_px)
    corrections = corrected(*nadir, exposure(AIR), TABLE)
    assert corrections.status.tolist() == [OK]
    for name in ("dx_px", "dy_px", "r_c_rad", "zeta_c_rad", "shift_ground_m"):
        assert getattr(corrections, name).tolist() == [0.0], name


def test_beside_the_nadir_the_shift_is_proportional():
    x = PINHOLE.cx_px + np.array([1e-9, 1e-6, 1e-3, 1.0])
    corrections = corrected(x, PINHOLE.cy_px, exposure(AIR), TABLE)
    assert np.isfinite(corrections.dx_px).all()
    # R is k tan(zeta).
    ratio = corrections.dx_px / (x - PINHOLE.cx_px)
    assert_close(ratio[2:], ratio[-1], rtol=1e-5)
    assert -1e-4 < ratio[-1] < -1e-5


LEVEL = exposure(AIR, looking(90.0))


def rows_below_the_horizon(degrees):
    """Pixels of a level camera."""
    return PINHOLE.cy_px + F_PX * np.tan(np.radians(degrees))


def test_the_axis_horizontal():
    """The image of the nadir is at infinity: Gyer's F = 0."""
    degrees = np.array([3.0, 10.0, 20.0])
    y = rows_below_the_horizon(degrees)
    corrections = corrected(PINHOLE.cx_px, y, LEVEL, TABLE, h_g=H_G)
    assert corrections.status.tolist() == [OK] * 3
    zeta_deg = np.degrees(corrections.zeta_c_rad)
    assert_close(zeta_deg, 90.0 - degrees, rtol=1e-12)
    straight_deg = degrees + np.degrees(corrections.r_c_rad)
    expected = rows_below_the_horizon(straight_deg)
    assert_near(corrections.y_corrected_px, expected, 1e-9)
    assert np.abs(corrections.dx_px).max() < 1e-9


def test_above_the_horizon_there_is_no_ground_but_there_are_targets():
    y = rows_below_the_horizon([0.0, -5.0, -20.0])
    corrections = corrected(
        PINHOLE.cx_px,
        y,
        LEVEL,
        TABLE,
        h_g=H_G,
    )
    assert corrections.status.tolist() == [MISSES_GROUND] * 3
    assert np.isnan(corrections.x_corrected_px).all()
    corrections = corrected(
        PINHOLE.cx_px,
        y[1:],
        LEVEL,
        TABLE,
        h_g=H_C + 800.0,
    )
    assert corrections.status.tolist() == [OK, OK]
    assert (corrections.dy_px > 0.0).all()
    assert (corrections.r_c_rad > 0.0).all()


@pytest.mark.parametrize(
    ("function", "camera", "radius_m"),
    [
        (corrected, PINHOLE, RADIUS),
        (displaced, DISTORTED, None),
    ],
    ids=["corrected", "displaced"],
)
def test_each_reason_in_its_place(function, camera, radius_m):
    good = exposure(AIR, cabin_excess=CABIN_EXCESS, radius_m=radius_m)
    unusable = replace(good, usable=np.array([False]))
    without_attitude = replace(unusable, rotation=np.full((1, 3, 3), nan))
    outside_the_profile = replace(good, refractivity_outside=np.array([nan]))
    exposures = together(good, unusable, without_attitude, outside_the_profile)
    table = [
        # x, height of the ground, row of the exposure, status
        (7000.0, 450.0, 0, OK),
        (nan, 450.0, 0, BAD_MEASUREMENT),
        (inf, 450.0, 0, BAD_MEASUREMENT),
        (7000.0, 450.0, -1, NO_STATION),
        (7000.0, nan, 0, NO_GROUND),
        (7000.0, inf, 0, NO_GROUND),
        (-5.0, 450.0, 0, OUTSIDE_CAMERA),
        (1e7, 450.0, 0, OUTSIDE_CAMERA),
        (7000.0, -9000.0, 0, OUTSIDE_PROFILE),
        (7000.0, 450.0, 1, NO_STATION),
        (7000.0, 450.0, 2, NO_STATION),
        (nan, 450.0, -1, BAD_MEASUREMENT),
        (7000.0, nan, -1, NO_STATION),
        (7000.0, 450.0, 3, OUTSIDE_PROFILE),
    ]
    x, h_g, row, expected = np.array(table).T

    corrections = function(
        x,
        5000.0,
        exposures,
        TABLE,
        camera=camera,
        h_g=h_g,
        row=row,
    )

    assert corrections.status.tolist() == expected.tolist()
    for name in ("x_corrected_px", "dy_px", "r_c_rad", "shift_ground_m"):
        is_known = np.isfinite(getattr(corrections, name))
        assert_array_equal(is_known, expected == OK, err_msg=name)


def test_no_stations_at_all():
    exposures = replace(
        NO_EXPOSURES,
        window_normal=np.empty((0, 3)),
        principal_change_px=np.empty(0),
    )
    corrections = corrected(1.0, 1.0, exposures, TABLE, row=-1)
    assert corrections.status.tolist() == [NO_STATION]


@pytest.mark.parametrize("change", [inf, -inf, nan, -11_000.0, -12_000.0])
def test_a_lens_that_cannot_be_has_a_status(change):
    setup = exposure(AIR, change_px=change)
    corrections = corrected(7000.0, 5000.0, setup, TABLE)
    assert corrections.status.tolist() == [OUTSIDE_CAMERA]
    for name in ("x_corrected_px", "dx_px", "r_c_rad"):
        assert np.isnan(getattr(corrections, name)).all(), name


def radius_along_the_axis(rotation, radius_m):
    setup = exposure(AIR, rotation, radius_m=radius_m)
    height = np.array([H_G])
    x = np.array([PINHOLE.cx_px])
    y = np.array([PINHOLE.cy_px])
    row = np.zeros(1, np.int64)
    observed = ObservationColumns(x, y, height, height, row)
    rays, _, status = outgoing_rays(observed, PINHOLE.constants, setup.columns)
    assert status.tolist() == [OK]
    return rays[SPHERE_RADIUS, 0]


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 90.0, 200.0])
def test_the_radius_is_eulers_in_the_azimuth_of_the_ray(azimuth):
    rotation = looking(45, azimuth)
    east, north, _ = rotation[2]
    to_ray = math.atan2(east, north)
    radius_m = radius_along_the_axis(rotation, None)
    assert_close(radius_m, euler_radius(0.8, to_ray), rtol=1e-14)


def test_a_given_radius_is_that_of_every_ray():
    radius_m = radius_along_the_axis(looking(45), 6.5e6)
    assert_close(radius_m, 6.5e6, rtol=1e-14)


@pytest.mark.parametrize("excess", [CABIN_EXCESS, -6e-5])
@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 63.8, 64.2, 80.0, 120.0])
def test_any_window_bends_a_ray_as_snell_has_it(tilt_deg, excess):
    """From straight through to total reflection, and from behind; `refract_at_window` is tested
    with 40 digits."""
    tilt = math.radians(tilt_deg)
    normal = (0.0, math.sin(tilt), math.cos(tilt))
    setup = exposure(AIR, cabin_excess=excess, normal=normal)
    # Up the middle of the image, to rays 25.7 degrees aside, which graze a window of 64.
    all_over = np.linspace(0.0, 10_600.0, 9)
    grazing = np.linspace(0.0, 200.0, 80)
    y = np.append(all_over, grazing)
    x = np.full(y.size, PINHOLE.cx_px)

    corrections = corrected(x, y, setup, TABLE, h_g=H_G)

    ray = rays_of(x, y)
    inside = OUTSIDE + excess
    change, r_cc = refract_at_window(ray, inside, OUTSIDE, np.array(normal))
    assert_close(
        corrections.r_cc_rad,
        r_cc,
        rtol=1e-11,
        atol=1e-17,
        equal_nan=True,
    )
    assert_array_equal(corrections.status == OUTSIDE_CAMERA, np.isnan(r_cc))
    # Outside the window the nadir angle is that of the bent ray; near total reflection to 6e-15.
    x_out, y_out, z_out = (ray + change).T
    zeta_c = np.arctan2(np.hypot(x_out, y_out), z_out)
    assert_near(corrections.zeta_c_rad, zeta_c, 1e-14, equal_nan=True)


def test_landing_points_lie_on_the_sphere():
    rng = np.random.default_rng(9)
    ray = rng.normal(size=(200, 3))
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    h_c, h_g = rng.uniform(0.0, 9000.0, (2, 200))
    reach = straight_reach(
        h_c,
        h_g,
        -ray[:, 2],
        radius=RADIUS,
        far=False,
    )
    hit = np.isfinite(reach)
    assert hit.sum() > 80
    # Every ray upwards reaches a higher target, none a lower one.
    up = ray[:, 2] > 0.0
    assert_array_equal(hit[up], (h_g >= h_c)[up])
    point = ray * reach[:, None]
    point[:, 2] += RADIUS + h_c
    from_centre = np.linalg.norm(point, axis=1)
    assert_close(from_centre[hit], RADIUS + h_g[hit], rtol=4e-15)


def test_a_target_at_the_cameras_height_is_at_the_camera():
    cos_nadir = [0.8, -0.8, 0.0]
    reach = straight_reach(500.0, 500.0, cos_nadir, radius=RADIUS, far=False)
    assert not reach.any()


@WITHOUT_AND_WITH_WINDOW
def test_metres_on_the_ground(excess):
    """From the straight ray in the cabin to the straight ray that ends at the target."""
    x = PINHOLE.cx_px + np.array([50.0, 500.0, 6900.0])
    setup = exposure(AIR, cabin_excess=excess)

    corrections = corrected(
        x,
        PINHOLE.cy_px,
        setup,
        TABLE,
        h_g=H_G,
    )

    measured = np.arctan((x - PINHOLE.cx_px) / F_PX)
    straight = corrections.zeta_c_rad - corrections.r_c_rad
    for i in range(3):
        expected = metres_apart(H_C, H_G, measured[i], straight[i])
        assert_close(corrections.shift_ground_m[i], expected, rtol=1e-6)


@pytest.mark.parametrize("far", [False, True])
def test_metres_at_either_crossing(far):
    zeta = math.radians(88.4)
    r_c = 0.004
    heights = (3000.0, 1000.0)
    metres = ground_displacement(
        *heights,
        zeta,
        r_c,
        RADIUS,
        far=far,
    )
    expected = metres_apart(*heights, zeta, zeta - r_c, far)
    assert_close(metres, expected, rtol=1e-9)


def test_over_the_horizon_there_are_no_metres_and_a_good_status():
    """From 10 km the sea's straight horizon is at asin(6371 / 6381) = 86.792 degrees."""
    horizon = math.degrees(math.asin(6371.0 / 6381.0))
    nadir_deg = np.array([horizon - 0.005, horizon + 0.005, 86.9])
    setup = exposure(AIR, looking(90.0), h_c=10_000.0)
    y = rows_below_the_horizon(90.0 - nadir_deg)

    corrections = corrected(PINHOLE.cx_px, y, setup, TABLE)

    assert corrections.status.tolist() == [OK] * 3
    assert np.isfinite(corrections.y_corrected_px).all()
    assert np.isnan(corrections.shift_ground_m).tolist() == [False, True, True]


def test_mixed_exposures_keep_their_slant_ranges_and_heights():
    """Rays that meet their ground twice; every row another distance, near or far."""
    number = np.arange(60)
    north = exposure(
        AIR,
        looking(88.6),
        cabin_excess=CABIN_EXCESS,
        change_px=2.0,
    )
    aside = exposure(
        AIR,
        looking(88.8, 40.0),
        cabin_excess=CABIN_EXCESS,
        change_px=-3.0,
    )
    exposures = together(north, aside)

    def corrected_rows(number):
        return corrected(
            6000.0 + 30.0 * number,
            PINHOLE.cy_px,
            exposures,
            TABLE,
            h_g=2900.0 + 5.0 * number,
            row=number % 2,
            distance_m=np.where(number % 3 == 0, 30e3, 300e3),
        )

    mixed = corrected_rows(number)
    alone = [corrected_rows(number[i : i + 1]) for i in number]
    assert {OK, FAR_BRANCH} <= set(mixed.status.tolist())
    for name in ("status", "dx_px", "dy_px", "r_c_rad", "r_cc_rad", "shift_ground_m"):
        expected = np.concatenate([getattr(row, name) for row in alone])
        assert_array_equal(getattr(mixed, name), expected, err_msg=name)


def test_every_status_has_its_own_name():
    codes = [getattr(status_codes, name.upper()) for name in STATUS_NAMES]
    assert codes == list(range(10))
