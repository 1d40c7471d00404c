"""Image points against Gyer's scalar equations and a brute-force rotation; special directions."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    correct_observations,
    ray_table,
    refraction_angle,
)
from unbend.refraction import status_codes as status
from unbend.refraction.image import ground_displacement, outgoing_rays, straight_reach
from unbend.refraction.kernels.columns import SPHERE_RADIUS, ObservationColumns
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
)
from unbend.refraction.window import refract_at_window
from unbend.units import DEGREE

RADIUS = 6_371_000.0
H_C = 3450.0
H_G = 450.0
PINHOLE = Camera(14_000, 10_600, 11_000.0, 11_000.0, 7012.4, 5291.7)
AIR = standard_atmosphere("us1976")
TABLE = ray_table(AIR)
OUTSIDE = float(AIR.refractivity(H_C))
CABIN = OUTSIDE + 6e-5

# East-north-up to camera (x right, y down, z forward): straight down, image top to the north.
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def looking(tilt_deg: float, azimuth_deg: float = 0.0, swing_deg: float = 0.0) -> np.ndarray:
    """Rotation of a camera tilted from the nadir towards an azimuth."""
    towards = Rotation.from_euler("z", azimuth_deg, degrees=True)
    tilt = Rotation.from_euler("x", -tilt_deg, degrees=True)
    swing = Rotation.from_euler("z", swing_deg, degrees=True)
    return swing.as_matrix() @ tilt.as_matrix() @ DOWN @ towards.as_matrix()


def exposures(
    rotation: np.ndarray, cabin: float = OUTSIDE, h_c: float = H_C, normal=(0.0, 0.0, 1.0)
) -> Exposures:
    return Exposures(
        usable=np.array([True]),
        rotation=rotation[None],
        latitude_rad=np.array([0.8]),
        height_m=np.array([h_c]),
        refractivity_outside=np.array([OUTSIDE]),
        refractivity_cabin=np.array([cabin]),
        window_normal=np.array([normal], float),
        principal_change_px=np.zeros(1),
        radius_m=RADIUS,
    )


def correct(
    x,
    y,
    rotation,
    *,
    h_g=H_G,
    cabin=OUTSIDE,
    camera=PINHOLE,
    h_c=H_C,
    normal=(0.0, 0.0, 1.0),
    **more,
):
    x = np.atleast_1d(np.asarray(x, float))
    y = np.atleast_1d(np.asarray(y, float))
    return correct_observations(
        x,
        y,
        np.broadcast_to(np.asarray(h_g, float), x.shape),
        np.zeros(x.shape, np.int64),
        exposures(rotation, cabin, h_c, normal),
        camera=camera,
        table=TABLE,
        **more,
    )


def gyer_scalar(x_px, y_px, rotation, cabin, *, radial_sign=1, about_principal_point=False):
    """Gyer 1996, Eq. 36-51 as they should read (reference/README.md, 3-6), with 30 digits.

    Photo axes x right, y up, the image at z = -f; M takes east-north-up to them.
    """
    f = mp.mpf(PINHOLE.fx_px)
    x_m = mp.mpf(x_px) - mp.mpf(PINHOLE.cx_px)
    y_m = -(mp.mpf(y_px) - mp.mpf(PINHOLE.cy_px))
    m = np.diag([1.0, -1.0, -1.0]) @ rotation
    c_x, c_y, big_f = (mp.mpf(float(v)) for v in m[:, 2])
    rho = mp.sqrt(x_m**2 + y_m**2)
    if rho > 0:  # Eq. 36, 37, 39
        zeta_f = mp.atan(rho / f)
        zeta_a = mp.asin((1 + mp.mpf(cabin)) / (1 + mp.mpf(OUTSIDE)) * mp.sin(zeta_f))
        x_cc = f * mp.tan(zeta_a) * x_m / rho
        y_cc = f * mp.tan(zeta_a) * y_m / rho
    else:
        x_cc = x_m
        y_cc = y_m
    # Eq. 40
    x_n = -f * c_x / big_f
    y_n = -f * c_y / big_f
    c = mp.sqrt(x_n**2 + y_n**2 + f**2)  # Eq. 44
    ray = mp.sqrt(f**2 + x_cc**2 + y_cc**2)
    zeta_c = mp.acos((f**2 + x_n * x_cc + y_n * y_cc) / (c * ray))  # Eq. 42
    r_c = mp.mpf(refraction_angle(AIR, H_C, H_G, float(zeta_c), RADIUS))
    if about_principal_point:
        x_n = y_n = mp.mpf(0)
        c = f
        zeta_c = mp.acos(f / ray)
    a = mp.sqrt((x_n - x_cc) ** 2 + (y_n - y_cc) ** 2)  # Eq. 43
    beta = mp.acos((x_n * (x_n - x_cc) + y_n * (y_n - y_cc)) / (c * a))  # Eq. 46
    delta_a = a - c * mp.sin(zeta_c - r_c) / mp.sin(beta + zeta_c - r_c)  # Eq. 45
    x_c = x_cc + radial_sign * (x_n - x_cc) / a * delta_a  # Eq. 50, with its sign turned
    y_c = y_cc + radial_sign * (y_n - y_cc) / a * delta_a  # Eq. 51
    return float(x_c - x_m), float(-(y_c - y_m))


POINTS = [(7512.4, 5291.7), (100.0, 200.0), (13_900.0, 10_500.0), (3000.0, 9000.0), (7012.4, 800.0)]


FARTHEST_NADIR_DEG = math.degrees(math.atan(10.0))  # its image lies 10 focal lengths away


@pytest.mark.parametrize("cabin", [OUTSIDE, CABIN], ids=["no window", "window"])
@pytest.mark.parametrize(("azimuth", "swing"), [(200, -90), (70, 20)])
@pytest.mark.parametrize("tilt", [0.0, 3.0, 45.0, 60.0, 75.0, 84.0, FARTHEST_NADIR_DEG])
def test_against_gyers_scalar_equations(tilt, azimuth, swing, cabin):
    rotation = looking(tilt, azimuth, swing)
    rng = np.random.default_rng(1996)
    x, y = np.concatenate([POINTS, rng.uniform(0.0, [14_000.0, 10_600.0], (12, 2))]).T
    rays = np.stack([(x - 7012.4) / 11_000.0, (y - 5291.7) / 11_000.0, np.ones(x.size)], axis=1)
    down = -(rays @ rotation)[:, 2] / np.linalg.norm(rays, axis=1)
    ground = down > math.cos(math.radians(88.0))  # grazing is at 88.3 degrees
    x = x[ground]
    y = y[ground]
    assert x.size >= 7
    found = correct(x, y, rotation, cabin=cabin)
    assert set(found.status.tolist()) == {OK}
    with mp.workdps(30):
        expected = np.array([gyer_scalar(*at, rotation, cabin) for at in zip(x, y, strict=True)])
    # Reached: 2e-12 px, of up to 17.
    np.testing.assert_allclose(found.dx_px, expected[:, 0], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found.dy_px, expected[:, 1], rtol=0.0, atol=1e-10)
    np.testing.assert_array_equal(found.x_corrected_px, x + found.dx_px)


@pytest.mark.parametrize(
    "mutant",
    [{"radial_sign": -1}, {"about_principal_point": True}],
    ids=["minus in Eq. 50, 51 as printed", "radial about the principal point"],
)
def test_the_scalar_equations_catch_mutants(mutant):
    rotation = looking(45, 200, -70)
    found = correct(*np.array(POINTS).T, rotation)
    with mp.workdps(30):
        wrong = np.array([gyer_scalar(*point, rotation, OUTSIDE, **mutant) for point in POINTS])
    miss = np.hypot(found.dx_px - wrong[:, 0], found.dy_px - wrong[:, 1])
    assert miss.min() > 0.1  # px, against a tolerance of 1e-10


def test_half_a_pixel_and_a_flipped_image_axis_are_seen():
    rotation = looking(30, 10)
    right = correct(*np.array(POINTS).T, rotation)
    shifted = replace(PINHOLE, cx_px=PINHOLE.cx_px + 0.5)
    half = correct(*np.array(POINTS).T, rotation, camera=shifted)
    assert np.abs(half.dx_px - right.dx_px).max() > 1e-6
    flipped = correct(*np.array(POINTS).T, np.diag([1.0, -1.0, 1.0]) @ rotation)
    assert np.nanmax(np.abs(flipped.dy_px - right.dy_px)) > 0.1


@pytest.mark.parametrize("tilt", [0.0, 20.0, 45.0, 60.0])
def test_against_a_brute_force_rotation(tilt):
    rng = np.random.default_rng(7)
    rotation = looking(tilt, 33.0, 12.0)
    x = rng.uniform(0.0, 14_000.0, 50)
    y = rng.uniform(0.0, 10_600.0, 50)
    found = correct(x, y, rotation)
    for i in range(50):
        ray = [(x[i] - PINHOLE.cx_px) / 11_000.0, (y[i] - PINHOLE.cy_px) / 11_000.0, 1.0]
        local = rotation.T @ (np.array(ray) / np.linalg.norm(ray))
        zeta = math.atan2(math.hypot(local[0], local[1]), -local[2])
        if found.status[i] != OK:
            assert zeta > math.radians(85.0)
            continue
        r_c = refraction_angle(AIR, H_C, H_G, zeta, RADIUS)
        axis = np.cross(local, [0.0, 0.0, -1.0])
        turned = Rotation.from_rotvec(r_c * axis / np.linalg.norm(axis)).apply(local)
        u, v, w = rotation @ turned
        assert found.x_corrected_px[i] == pytest.approx(11_000.0 * u / w + PINHOLE.cx_px, abs=1e-9)
        assert found.y_corrected_px[i] == pytest.approx(11_000.0 * v / w + PINHOLE.cy_px, abs=1e-9)
        assert found.zeta_c_rad[i] == pytest.approx(zeta, abs=1e-15)
        assert found.r_c_rad[i] == pytest.approx(r_c, rel=1e-12)


def test_distorted_pixels_go_out_as_distorted_pixels():
    camera = replace(
        PINHOLE, distortion=BrownConrady(k1=-0.018, k2=0.009, k3=-0.002, p1=1.5e-4, p2=-1e-4)
    )
    rotation = looking(30, 80)
    x, y = np.array(POINTS).T
    u, v, _ = camera.rays(x, y)
    ideal = correct(11_000.0 * u + 7012.4, 11_000.0 * v + 5291.7, rotation)
    expected = camera.project(
        (ideal.x_corrected_px - 7012.4) / 11_000.0, (ideal.y_corrected_px - 5291.7) / 11_000.0
    )
    found = correct(x, y, rotation, camera=camera)
    np.testing.assert_allclose(found.x_corrected_px, expected[0], rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(found.y_corrected_px, expected[1], rtol=0.0, atol=2e-9)


def test_exactly_at_the_nadir_nothing_moves():
    found = correct(PINHOLE.cx_px, PINHOLE.cy_px, DOWN)
    assert found.status.tolist() == [OK]
    for values in (found.dx_px, found.dy_px, found.r_c_rad, found.zeta_c_rad, found.shift_ground_m):
        assert values.tolist() == [0.0]


def test_beside_the_nadir_the_shift_is_small_and_even():
    offset = np.array([1e-9, 1e-6, 1e-3, 1.0])
    found = correct(PINHOLE.cx_px + offset, np.full(4, PINHOLE.cy_px), DOWN)
    assert np.all(np.isfinite(found.dx_px))
    # Radial and proportional near the nadir: R is k tan(zeta).
    ratio = found.dx_px / (PINHOLE.cx_px + offset - PINHOLE.cx_px)
    np.testing.assert_allclose(ratio[2:], ratio[-1], rtol=1e-5)
    assert -1e-4 < ratio[-1] < -1e-5


def test_the_axis_horizontal():
    """The image of the nadir is at infinity: Gyer's F = 0."""
    rotation = looking(90.0)
    np.testing.assert_allclose(rotation.T @ [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], atol=1e-15)
    y = PINHOLE.cy_px + 11_000.0 * np.tan(np.radians([3.0, 10.0, 20.0]))
    found = correct(np.full(3, PINHOLE.cx_px), y, rotation)
    assert found.status.tolist() == [OK, OK, OK]
    np.testing.assert_allclose(np.degrees(found.zeta_c_rad), [87.0, 80.0, 70.0], rtol=1e-12)
    assert np.all(found.dy_px > 0.0)  # down the image, towards the nadir
    below = np.radians([3.0, 10.0, 20.0]) + found.r_c_rad
    np.testing.assert_allclose(
        found.y_corrected_px, PINHOLE.cy_px + 11_000.0 * np.tan(below), atol=1e-9
    )
    assert np.abs(found.dx_px).max() < 1e-9


def test_above_the_horizon_there_is_no_ground_but_there_are_targets():
    rotation = looking(90.0)
    x = [PINHOLE.cx_px] * 3
    y = [PINHOLE.cy_px, PINHOLE.cy_px - 900.0, PINHOLE.cy_px - 4000.0]
    found = correct(x, y, rotation)
    assert found.status.tolist() == [MISSES_GROUND] * 3
    assert np.isnan(found.x_corrected_px).all()
    found = correct(x[1:], y[1:], rotation, h_g=H_C + 800.0)
    assert found.status.tolist() == [OK, OK]
    assert np.all(found.dy_px > 0.0)
    assert np.all(found.r_c_rad > 0.0)


def test_beyond_grazing_carries_values():
    """1.7 deg under the horizon the ray to 1000 m would rise to that height again, farther off."""
    y = PINHOLE.cy_px + 11_000.0 * np.tan(np.radians([1.7, 2.5]))
    found = correct([PINHOLE.cx_px] * 2, y, looking(90.0), h_g=1000.0)
    assert found.status.tolist() == [BEYOND_GRAZING, OK]
    assert np.isfinite(found.x_corrected_px).all()
    assert np.all(found.dy_px > 5.0)


@pytest.mark.parametrize("rotation", [looking(0), looking(40, 90)])
def test_denser_cabin_air_moves_the_corrected_point_outward(rotation):
    x, y = np.array(POINTS).T
    with_window, without = (correct(x, y, rotation, cabin=n) for n in (CABIN, OUTSIDE))
    outward = (with_window.dx_px - without.dx_px) * (x - PINHOLE.cx_px) + (
        with_window.dy_px - without.dy_px
    ) * (y - PINHOLE.cy_px)
    assert np.all(outward > 0.0)
    assert np.all(with_window.r_cc_rad > 0.0)
    assert np.all(without.r_cc_rad == 0.0)


def test_the_apparent_ray_is_farther_from_the_nadir():
    found = correct(*np.array(POINTS).T, DOWN)
    x, y = np.array(POINTS).T - np.array([[PINHOLE.cx_px], [PINHOLE.cy_px]])
    assert np.all(found.dx_px * x + found.dy_px * y < 0.0)
    assert np.all(found.r_c_rad > 0.0)


def test_each_reason_in_its_place():
    x = np.array([7000.0, np.nan, 7000.0, 7000.0, -5.0, 7000.0, 7000.0, np.nan, 7000.0])
    y = np.full(9, 5000.0)
    h_g = np.array([450.0, 450.0, 450.0, np.nan, 450.0, -9000.0, 450.0, 450.0, np.nan])
    row = np.array([0, 0, -1, 0, 0, 0, 1, -1, -1])
    one = exposures(DOWN, CABIN)
    two = replace(
        one,
        **{
            name: np.repeat(getattr(one, name), 2, axis=0)
            for name in (
                "rotation",
                "latitude_rad",
                "height_m",
                "refractivity_outside",
                "refractivity_cabin",
            )
        },
        usable=np.array([True, False]),
    )
    found = correct_observations(x, y, h_g, row, two, camera=PINHOLE, table=TABLE)
    assert found.status.tolist() == [
        OK,
        BAD_MEASUREMENT,
        NO_STATION,
        NO_GROUND,
        OUTSIDE_CAMERA,
        OUTSIDE_PROFILE,
        NO_STATION,
        BAD_MEASUREMENT,
        NO_STATION,
    ]
    np.testing.assert_array_equal(np.isfinite(found.x_corrected_px), found.status == OK)


@pytest.mark.parametrize("change", [np.inf, -np.inf, np.nan, -11_000.0, -12_000.0])
def test_a_lens_that_cannot_be_has_a_status(change):
    one = replace(exposures(DOWN), principal_change_px=np.array([change]))
    found = correct_observations(
        np.array([7000.0]),
        np.array([5000.0]),
        np.array([H_G]),
        np.zeros(1, np.int64),
        one,
        camera=PINHOLE,
        table=TABLE,
    )
    assert found.status.tolist() == [OUTSIDE_CAMERA]
    assert np.isnan([found.x_corrected_px[0], found.dx_px[0], found.r_c_rad[0]]).all()


def test_no_stations_at_all():
    none = Exposures(
        *(
            np.empty(0, bool),
            np.empty((0, 3, 3)),
            *(np.empty(0) for _ in range(4)),
            np.empty((0, 3)),
            np.empty(0),
        )
    )
    found = correct_observations(
        np.array([1.0]),
        np.array([1.0]),
        np.array([0.0]),
        np.array([-1]),
        none,
        camera=PINHOLE,
        table=TABLE,
    )
    assert found.status.tolist() == [NO_STATION]


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 90.0, 200.0])
def test_the_radius_is_eulers_in_the_azimuth_of_the_ray(azimuth):
    """GRS 80 at 0.8 rad by hand: 1/R = cos^2 A / M + sin^2 A / N."""
    a = 6_378_137.0
    e2 = 0.006694380
    sine = math.sin(0.8)
    prime_vertical = a / math.sqrt(1.0 - e2 * sine**2)
    meridian = a * (1.0 - e2) / (1.0 - e2 * sine**2) ** 1.5
    free = replace(exposures(looking(45, azimuth)), radius_m=None)
    h_g = np.array([H_G])
    row = np.zeros(1, np.int64)
    direction = free.rotation[0].T @ np.array([0.0, 0.0, 1.0])
    to_ray = math.atan2(direction[0], direction[1])
    expected = 1.0 / (math.cos(to_ray) ** 2 / meridian + math.sin(to_ray) ** 2 / prime_vertical)
    centre = np.array([PINHOLE.cx_px]), np.array([PINHOLE.cy_px])
    observed = ObservationColumns(*centre, h_g, h_g, row)
    rays, _, status = outgoing_rays(observed, PINHOLE.constants, free.columns)
    assert status.tolist() == [OK]
    assert rays[SPHERE_RADIUS, 0] == pytest.approx(expected, rel=1e-7)


def test_a_tilted_window_bends_about_its_own_normal():
    normal = np.array([0.0, math.sin(0.3), math.cos(0.3)])
    # The ray along the normal passes straight.
    y = PINHOLE.cy_px + 11_000.0 * math.tan(0.3)
    found = correct(PINHOLE.cx_px, y, DOWN, cabin=CABIN, normal=normal)
    plain = correct(PINHOLE.cx_px, y, DOWN)
    assert found.r_cc_rad[0] == pytest.approx(0.0, abs=1e-16)
    assert found.y_corrected_px[0] == pytest.approx(plain.y_corrected_px[0], abs=1e-9)
    assert correct(PINHOLE.cx_px, y, DOWN, cabin=CABIN).r_cc_rad[0] > 1e-5


@pytest.mark.parametrize("cabin", [CABIN, OUTSIDE - 6e-5])
@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 63.8, 64.2, 80.0, 120.0])
def test_any_window_bends_a_ray_as_snell_has_it(tilt_deg, cabin):
    """From straight through to total reflection, and from behind; `refract_at_window` is tested
    with 40 digits."""
    normal = np.array([0.0, math.sin(tilt_deg * DEGREE), math.cos(tilt_deg * DEGREE)])
    # Up the middle of the image, to rays 25.7 degrees aside, which graze a window of 64.
    y = np.concatenate([np.linspace(0.0, 10_600.0, 9), np.linspace(0.0, 200.0, 80)])
    found = correct(np.full(y.size, PINHOLE.cx_px), y, DOWN, cabin=cabin, normal=normal)
    ray = np.stack([np.zeros(y.size), (y - PINHOLE.cy_px) / PINHOLE.fy_px, np.ones(y.size)], 1)
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    change, r_cc = refract_at_window(ray, cabin, OUTSIDE, normal)
    np.testing.assert_allclose(found.r_cc_rad, r_cc, rtol=1e-11, atol=1e-17)
    np.testing.assert_array_equal(found.status == OUTSIDE_CAMERA, np.isnan(r_cc))
    # Outside the window the nadir angle is that of the bent ray; near total reflection to 6e-15.
    outside = np.arctan2(np.hypot(*(ray + change)[:, :2].T), (ray + change)[:, 2])
    np.testing.assert_allclose(found.zeta_c_rad, outside, rtol=0.0, atol=1e-14)


def test_landing_points_lie_on_the_sphere():
    rng = np.random.default_rng(9)
    ray = rng.normal(size=(200, 3))
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    h_c = rng.uniform(0.0, 9000.0, 200)
    h_g = rng.uniform(0.0, 9000.0, 200)
    point = ray * straight_reach(h_c, h_g, -ray[:, 2], radius=RADIUS, far=False)[:, None]
    hit = np.isfinite(point[:, 0])
    assert hit.sum() > 80
    # Every ray upwards reaches a higher target, none a lower one.
    up = ray[:, 2] > 0.0
    np.testing.assert_array_equal(hit[up], (h_g >= h_c)[up])
    centre = np.stack([np.zeros(200), np.zeros(200), -(RADIUS + h_c)], axis=1)
    distance = np.linalg.norm(point - centre, axis=1)
    np.testing.assert_allclose(distance[hit], (RADIUS + h_g)[hit], rtol=1e-15 * 4)


def test_a_target_at_the_cameras_height_is_at_the_camera():
    ray = np.array([[0.6, 0.0, -0.8], [0.6, 0.0, 0.8], [1.0, 0.0, 0.0]])
    assert not straight_reach(500.0, 500.0, -ray[:, 2], radius=RADIUS, far=False).any()


def test_metres_on_the_ground():
    # Flat earth, small angles: h R / cos^2(zeta).
    metres = ground_displacement(120.0, 0.0, math.radians(45.0), 1e-6, RADIUS)
    assert metres == pytest.approx(120.0 * 1e-6 * 2.0, rel=1e-4)
    found = correct(*np.array(POINTS).T, looking(20))
    for i in range(len(POINTS)):
        metres = ground_displacement(
            H_C, H_G, float(found.zeta_c_rad[i]), float(found.r_c_rad[i]), RADIUS
        )
        assert found.shift_ground_m[i] == pytest.approx(metres, rel=1e-6)


def test_over_the_horizon_there_are_no_metres_and_a_good_status():
    """From 10 km the sea's straight horizon is at asin(6371 / 6381) = 86.792 degrees."""
    horizon = math.degrees(math.asin(RADIUS / (RADIUS + 10_000.0)))
    assert horizon == pytest.approx(86.7919, abs=1e-4)
    below = np.radians(90.0 - np.array([horizon - 0.005, horizon + 0.005, 86.9]))
    found = correct_observations(
        np.full(3, PINHOLE.cx_px),
        PINHOLE.cy_px + 11_000.0 * np.tan(below),
        np.zeros(3),
        np.zeros(3, np.int64),
        exposures(looking(90.0), h_c=10_000.0),
        camera=PINHOLE,
        table=TABLE,
    )
    assert found.status.tolist() == [OK] * 3
    assert np.isfinite(found.y_corrected_px).all()
    assert np.isnan(found.shift_ground_m).tolist() == [False, True, True]
    for i in range(3):
        metres = ground_displacement(
            10_000.0, 0.0, float(found.zeta_c_rad[i]), float(found.r_c_rad[i]), RADIUS
        )
        assert math.isnan(metres) == (i > 0)


def second_crossing(h_c: float, h_g: float, zeta: float) -> tuple[float, float]:
    """East and up [m] of where a straight line leaves a sphere again, by its quadratic equation."""
    with mp.workdps(30):
        r_c = mp.mpf(RADIUS) + h_c
        r_g = mp.mpf(RADIUS) + h_g
        c = mp.cos(zeta)
        s = r_c * c + mp.sqrt((r_c * c) ** 2 - (r_c**2 - r_g**2))
        return s * mp.sin(zeta), -s * c


def test_metres_at_the_far_crossing():
    zeta = math.radians(88.4)
    r_c = 0.004
    first, second = (second_crossing(3000.0, 1000.0, angle) for angle in (zeta, zeta - r_c))
    by_hand = float(mp.hypot(first[0] - second[0], first[1] - second[1]))
    found = ground_displacement(3000.0, 1000.0, zeta, r_c, RADIUS, far=True)
    assert found == pytest.approx(by_hand, rel=1e-9)
    assert ground_displacement(3000.0, 1000.0, zeta, r_c, RADIUS) < 0.5 * found


def test_mixed_exposures_keep_their_slant_ranges_and_heights():
    """Rays that meet their ground twice; every row another distance, near or far."""
    rows = np.arange(60)
    two = replace(
        exposures(looking(89.0)),
        usable=np.ones(2, bool),
        rotation=np.stack([looking(88.6), looking(88.8, 40.0)]),
        latitude_rad=np.full(2, 0.8),
        height_m=np.full(2, H_C),
        refractivity_outside=np.full(2, OUTSIDE),
        refractivity_cabin=np.full(2, CABIN),
        window_normal=np.tile([0.0, 0.0, 1.0], (2, 1)),
        principal_change_px=np.array([2.0, -3.0]),
    )
    x = 6000.0 + 30.0 * rows
    y = np.full(60, PINHOLE.cy_px)
    h_g = 2900.0 + 5.0 * rows
    row = rows % 2
    distance = np.where(rows % 3 == 0, 30e3, 300e3)

    def corrected(at):
        return correct_observations(
            x[at],
            y[at],
            h_g[at],
            row[at],
            two,
            camera=PINHOLE,
            table=TABLE,
            distance_m=distance[at],
        )

    together = corrected(rows)
    alone = [corrected(np.array([i])) for i in rows]
    assert {OK, FAR_BRANCH} <= set(together.status.tolist())
    for name in ("status", "dx_px", "dy_px", "r_c_rad", "r_cc_rad", "shift_ground_m"):
        expected = np.concatenate([getattr(one, name) for one in alone])
        np.testing.assert_array_equal(getattr(together, name), expected, err_msg=name)


def test_a_given_radius_is_that_of_every_ray():
    fixed = replace(exposures(looking(45)), radius_m=6_500_000.0)
    centre = np.array([PINHOLE.cx_px, 100.0])
    row = np.zeros(2, np.int64)
    observed = ObservationColumns(centre, centre, np.zeros(2), np.zeros(2), row)
    rays, _, _ = outgoing_rays(observed, PINHOLE.constants, fixed.columns)
    np.testing.assert_allclose(rays[SPHERE_RADIUS], 6_500_000.0, rtol=1e-14)


def test_a_camera_outside_the_profile_has_that_status():
    above = replace(exposures(looking(0)), refractivity_outside=np.array([np.nan]))
    corrections = correct_observations(
        np.array([100.0]),
        np.array([200.0]),
        np.array([H_G]),
        np.zeros(1, np.int64),
        above,
        camera=PINHOLE,
        table=TABLE,
    )
    assert corrections.status.tolist() == [OUTSIDE_PROFILE]


def test_every_status_has_its_own_name():
    names = (
        "OK",
        "NO_STATION",
        "NO_GROUND",
        "BAD_MEASUREMENT",
        "OUTSIDE_CAMERA",
        "MISSES_GROUND",
        "BEYOND_GRAZING",
        "OUTSIDE_PROFILE",
        "FAR_BRANCH",
    )
    assert [status.STATUS_NAMES[getattr(status, name)] for name in names] == [
        name.lower() for name in names
    ]
