"""Displaced observations: the way back to the last digit, and what the simulator sees."""

import math
from dataclasses import dataclass
from math import nan

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_near
from tests.refraction.images import (
    DISTORTED,
    DOWN,
    NO_EXPOSURES,
    PINHOLE,
    TILTED,
    corrected,
    displaced,
    exposure,
    looking,
)
from tests.refraction.rays import AIR, TABLE
from unbend.geodesy import euler_radius
from unbend.refraction.ray import rays_by
from unbend.refraction.status_codes import (
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
)

LATITUDE = 0.8


def seen_from(rotation=DOWN, h_c=3450.0, **options):
    """An exposure over the ellipsoid."""
    return exposure(AIR, rotation, h_c=h_c, radius_m=None, **options)


def both_ways(x, y, h_g, exposures, *, camera=PINHOLE, table=TABLE, **options):
    """Corrected observations, and these displaced again."""
    options |= {"camera": camera, "h_g": h_g}
    ideal = corrected(x, y, exposures, table, **options)
    seen = displaced(ideal.x_corrected_px, ideal.y_corrected_px, exposures, table, **options)
    return ideal, seen


FORMAT_PX = np.array([[14_000.0], [10_600.0]])


def random_pixels(seed, count):
    """(2, count) pixels over the format."""
    rng = np.random.default_rng(seed)
    return FORMAT_PX * rng.uniform(0.0, 1.0, (2, count))


def assert_pixels(corrections, x, y, atol=1e-9):
    assert_near(corrections.x_corrected_px, x, atol)
    assert_near(corrections.y_corrected_px, y, atol)


@dataclass(frozen=True)
class Scene:
    """A camera above its ground; window and lens as in `exposure`."""

    rotation: np.ndarray
    h_c: float
    h_g: float
    options: dict


WINDOW = {"cabin_excess": 6e-5, "normal": TILTED}
SCENES = {
    "nadir": Scene(looking(0.0), 3450.0, 450.0, {}),
    "tilted window": Scene(
        looking(0.0, 20.0),
        9000.0,
        100.0,
        WINDOW,
    ),
    "oblique": Scene(
        looking(45.0, 200.0, -70.0),
        9000.0,
        100.0,
        {"cabin_excess": 6e-5, "change_px": -4.0},
    ),
    "level": Scene(looking(90.0, 30.0, 5.0), 3450.0, 450.0, WINDOW),
    "upwards": Scene(
        looking(90.0),
        1000.0,
        4000.0,
        {"change_px": 2.0},
    ),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_there_and_back(scene):
    x, y = random_pixels(11, 300)
    setup = seen_from(scene.rotation, scene.h_c, **scene.options)

    ideal, seen = both_ways(
        x,
        y,
        scene.h_g,
        setup,
        camera=DISTORTED,
    )

    # Near the horizon two rays show points of one straight line: see below.
    is_single = np.abs(np.degrees(ideal.zeta_c_rad) - 88.372) > 0.01
    good = np.flatnonzero(np.isfinite(ideal.x_corrected_px) & is_single)
    assert good.size > 100
    ideal = ideal.rows(good)
    seen = seen.rows(good)
    assert np.hypot(ideal.dx_px, ideal.dy_px).max() > 0.4
    assert_array_equal(seen.status, ideal.status)
    assert_pixels(seen, x[good], y[good])
    assert_near(-seen.dx_px, ideal.dx_px, 2e-9)
    assert_near(-seen.dy_px, ideal.dy_px, 2e-9)
    for name in ("zeta_c_rad", "r_c_rad", "r_cc_rad", "shift_ground_m"):
        again = getattr(seen, name)
        assert_near(again, getattr(ideal, name), 2e-7, equal_nan=True)


RADIUS_M = float(euler_radius(LATITUDE, 0.0))
H_C = 3450.0
H_G = 450.0


def far_end(ideal):
    """Where the straight lines come up through the height of the ground again [m]."""
    along = (RADIUS_M + H_C) * np.cos(ideal.zeta_c_rad - ideal.r_c_rad)
    return along + np.sqrt(along**2 - (H_C - H_G) * (2.0 * RADIUS_M + H_C + H_G))


def level_pixels(degrees, tilt=90.0):
    """Rows of pixels at nadir angles, for a pinhole that looks north."""
    below_axis = np.radians(tilt - np.asarray(degrees))
    return PINHOLE.cy_px + 11_000.0 * np.tan(below_axis)


def test_beyond_grazing_survives():
    y = level_pixels([88.2, 88.35])
    ideal, seen = both_ways(7000.0, y, H_G, seen_from(looking(90.0)))
    assert ideal.status.tolist() == [BEYOND_GRAZING] * 2
    assert seen.status.tolist() == [BEYOND_GRAZING] * 2
    assert_pixels(seen, 7000.0, y)


WINDOWS = pytest.mark.parametrize(
    ("tilt", "window"),
    [
        (90.0, {}),
        (75.0, WINDOW | {"change_px": -4.0}),
    ],
    ids=["open", "window"],
)


@WINDOWS
def test_the_far_branch_survives(tilt, window):
    y = level_pixels(np.linspace(88.16, 88.37, 200), tilt)
    setup = seen_from(looking(tilt), **window)
    ideal, _ = both_ways(7000.0, y, H_G, setup, distance_m=1e7)
    far = np.flatnonzero(ideal.status == FAR_BRANCH)
    assert far.size > 180  # the window moves the others over the horizon
    y = y[far]
    distance = far_end(ideal.rows(far))

    ideal, seen = both_ways(7000.0, y, H_G, setup, distance_m=distance)

    assert (ideal.status == FAR_BRANCH).all()
    assert (seen.status == FAR_BRANCH).all()
    assert_near(seen.y_corrected_px, y, 1e-8)
    steep = np.degrees(ideal.zeta_c_rad) < 88.35
    assert_near(seen.y_corrected_px[steep], y[steep], 1e-9)
    near, _ = both_ways(7000.0, y, H_G, setup)
    moved = near.y_corrected_px - ideal.y_corrected_px
    assert np.abs(moved).min() > 2.0


@WINDOWS
def test_two_rays_for_one_straight_line_are_told_apart_by_distance(tilt, window):
    """Between the straight and the bent horizon the near crossing is the line's far one."""
    n_c, n_g = 1.0 + AIR.refractivity([H_C, H_G])
    sine_of_straight = (RADIUS_M + H_G) / (RADIUS_M + H_C)
    bent_horizon = math.asin(n_g / n_c * sine_of_straight)
    setup = seen_from(looking(tilt), **window)
    y = level_pixels(np.linspace(88.36, 88.40, 400), tilt)
    ideal, by_near_ray = both_ways(7000.0, y, H_G, setup)
    off_band = ideal.zeta_c_rad - (bent_horizon - math.radians(2e-3))
    band = np.flatnonzero(np.abs(np.degrees(off_band)) < 5e-4)
    assert band.size > 5
    y = y[band]
    ideal = ideal.rows(band)
    by_near_ray = by_near_ray.rows(band)
    straight = ideal.zeta_c_rad - ideal.r_c_rad
    assert np.all(straight < math.asin(sine_of_straight))
    assert (by_near_ray.status == BEYOND_GRAZING).all()
    x_near = by_near_ray.x_corrected_px
    y_near = by_near_ray.y_corrected_px
    assert np.all(np.abs(y_near - y) > 1.0)
    # Both are right: they end in the same ideal pixel.
    again = corrected(x_near, y_near, setup, TABLE, h_g=H_G)
    assert_near(again.y_corrected_px, ideal.y_corrected_px, 1e-8)

    ideal, seen = both_ways(
        7000.0,
        y,
        H_G,
        setup,
        distance_m=far_end(ideal),
    )

    assert (ideal.status == OK).all()
    assert (seen.status == OK).all()
    assert_near(seen.y_corrected_px, y, 1e-8)


def test_points_on_the_edge_of_the_format_come_back():
    x = np.array([0.0, 14_000.0, 7000.0, 7000.0])
    y = np.array([5000.0, 5000.0, 0.0, 10_600.0])
    setup = seen_from(cabin_excess=8e-5)
    ideal, seen = both_ways(x, y, H_G, setup, camera=DISTORTED)
    pixels = np.stack([ideal.x_corrected_px, ideal.y_corrected_px])
    inside = (pixels >= 0.0) & (pixels <= FORMAT_PX)
    # The window's part is the larger, and the correction goes outward.
    assert not inside.all(axis=0).any()
    assert (seen.status == OK).all()
    assert_pixels(seen, x, y)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([13_999.9, 14_009.0, 13_999.0], 5300.0),
        ([0.01, -9.0, 5.0], 5300.0),
        (7000.0, [10_599.99, 10_609.0, 10_595.0]),
        (7000.0, [0.01, -9.0, 5.0]),
    ],
    ids=["right", "left", "below", "above"],
)
def test_a_point_displaced_out_of_the_format_is_outside(x, y):
    seen = displaced(x, y, seen_from(h_c=8000.0), TABLE)
    assert seen.status.tolist() == [OUTSIDE_CAMERA, OUTSIDE_CAMERA, OK]
    assert np.isnan(seen.x_corrected_px).tolist() == [True, True, False]
    assert np.hypot(seen.dx_px, seen.dy_px)[2] > 0.1


def test_over_the_horizon_no_ray_shows_the_ground():
    y = level_pixels([88.0, 88.6, 90.5])
    setup = seen_from(looking(90.0))
    seen = displaced(7000.0, y, setup, TABLE, h_g=H_G)
    assert seen.status.tolist() == [OK, MISSES_GROUND, MISSES_GROUND]
    assert np.isfinite(seen.y_corrected_px).tolist() == [True, False, False]


def test_neighbours_do_not_matter():
    x, y = random_pixels(8, 50)
    x[7] = nan

    def displaced_rows(rows):
        return displaced(
            x[rows],
            y[rows],
            seen_from(),
            TABLE,
            camera=DISTORTED,
            h_g=H_G,
        )

    all_at_once = displaced_rows(slice(None))
    for i in (3, 7, 30):
        alone = displaced_rows(i)
        expected = all_at_once.x_corrected_px[i]
        assert_near(alone.x_corrected_px[0], expected, 1e-10, equal_nan=True)
        assert alone.status[0] == all_at_once.status[i]


@pytest.mark.parametrize("method", ["plane", "gyer1996"])
def test_a_published_method_goes_both_ways_too(method):
    x, y = random_pixels(6, 50)
    setup = seen_from(looking(20.0))
    table = rays_by(AIR, method)
    ideal, seen = both_ways(
        x,
        y,
        H_G,
        setup,
        camera=DISTORTED,
        table=table,
    )
    assert (ideal.status == OK).all()
    assert_pixels(seen, x, y)


def test_nothing_to_displace():
    nothing = np.empty(0)
    seen = displaced(nothing, nothing, seen_from(), TABLE)
    assert seen.x_corrected_px.shape == (0,)
    seen = displaced(1.0, 1.0, NO_EXPOSURES, TABLE, row=-1)
    assert seen.status.tolist() == [NO_STATION]
