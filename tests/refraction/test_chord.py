"""Heights by slant range, against chords of 30-digit rays and against the angles themselves."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    bend,
    correct_observations,
    ray_table,
)
from unbend.refraction.ray import rays_by
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)
from unbend.refraction.target_heights import height_at_distance, target_heights

RADIUS = 6_371_000.0
AIR = standard_atmosphere("us1976", index="gyer")
TABLE = ray_table(AIR)


def heights(h_c, degrees, distance, table=TABLE):
    zeta = np.radians(degrees)
    return height_at_distance(table, h_c, np.sin(zeta), np.cos(zeta), distance, radius=RADIUS)


def chord_of(truth, h_c, h, degrees, beyond=False) -> float:
    """Straight distance [m] to where a ray has height h, with 30 digits (Gyer 1996, Eq. 12)."""
    with mp.workdps(30):
        h_c = mp.mpf(h_c)
        h = mp.mpf(h)
        zeta = mp.mpf(float(np.radians(degrees)))
        low, high = sorted((h_c, h))
        if not beyond:
            theta = truth.subtended(float(h_c), low, high, zeta, degrees > 88)
        else:
            turn = truth.turning_height(float(h_c), float(zeta))
            theta = truth.subtended(float(h_c), turn, h_c, zeta, True)
            theta += truth.subtended(float(h_c), turn, h, zeta, True)
        square = (h_c - h) ** 2
        square += 4 * (RADIUS + h_c) * (RADIUS + h) * mp.sin(theta / 2) ** 2
        return float(mp.sqrt(square))


@pytest.mark.parametrize(
    ("h_c", "h", "degrees"),
    [
        (3000.0, 0.0, 0.0), (3000.0, 450.0, 45.0), (10_000.0, -200.0, 75.0),
        (10_000.0, 500.0, 85.0), (5000.0, 1500.0, 88.2), (1000.0, 3000.0, 95.0),
        (1000.0, 3000.0, 90.0), (1000.0, 8000.0, 135.0),
    ],
)  # fmt: skip
def test_against_thirty_digits(truth, h_c, h, degrees):
    distance = chord_of(truth(30), h_c, h, degrees)
    found, status = heights(h_c, degrees, distance)
    assert status == OK
    assert float(found) == pytest.approx(h, abs=1e-6)
    # The ray, not the straight line: a slip of the refraction angle would show.
    r_c, _ = bend(TABLE, h_c, h, math.sin(math.radians(degrees)), math.cos(math.radians(degrees)))
    if degrees > 0.0:
        straight = h_c + distance * (
            distance - 2 * (RADIUS + h_c) * np.cos(np.radians(degrees))
        ) / (2 * RADIUS)
        assert abs(straight - h) > 1e-2
        assert float(r_c) > 0.0


@pytest.mark.parametrize("above", [1e-6, 1e-3, 1.0, 500.0])
@pytest.mark.parametrize("beyond", [False, True])
def test_through_the_lowest_point(truth, above, beyond):
    exact = truth(30)
    h = exact.turning_height(5000.0, math.radians(88.2)) + above
    distance = chord_of(exact, 5000.0, h, 88.2, beyond)
    found, status = heights(5000.0, 88.2, distance)
    assert status == OK
    assert float(found) == pytest.approx(float(h), abs=1e-6)


@pytest.mark.parametrize("h", [5000.0, 9000.0])
def test_far_beyond_it_the_ray_rises_over_the_camera(truth, h):
    found, status = heights(5000.0, 88.2, chord_of(truth(30), 5000.0, h, 88.2, True))
    assert status == OK
    assert float(found) == pytest.approx(h, abs=1e-6)


def test_the_angle_at_that_height_gives_the_distance_back():
    rng = np.random.default_rng(3)
    h_c = rng.uniform(100.0, 12_000.0, 500)
    degrees = rng.uniform(0.0, 85.0, 500)
    distance = rng.uniform(0.1, 1.0, 500) * h_c / np.cos(np.radians(degrees))
    found, status = heights(h_c, degrees, distance)
    assert set(status.tolist()) == {OK}
    zeta = np.radians(degrees)
    r_c, _ = bend(TABLE, h_c, found, np.sin(zeta), np.cos(zeta), radius=RADIUS)
    # Law of sines in the triangle camera, target, centre of the earth.
    central = np.arcsin((RADIUS + h_c) / (RADIUS + found) * np.sin(zeta - r_c)) - (zeta - r_c)
    across = 4.0 * (RADIUS + h_c) * (RADIUS + found) * np.sin(0.5 * central) ** 2
    back = np.sqrt((h_c - found) ** 2 + across)
    np.testing.assert_allclose(back, distance, rtol=0.0, atol=1e-5)


def test_what_has_no_end_has_a_reason():
    zeta = np.array([10.0, 10.0, 10.0, 100.0, 89.0, np.nan, 10.0, 10.0])
    distance = np.array([np.nan, 0.0, -5.0, 5e6, np.inf, 100.0, 3e4, 3000.0])
    h_c = np.array([3000.0] * 7 + [99_000.0])
    found, status = heights(h_c, zeta, distance)
    assert status.tolist() == [BAD_MEASUREMENT] * 3 + [
        OUTSIDE_PROFILE,
        BAD_MEASUREMENT,
        BAD_MEASUREMENT,
        OUTSIDE_PROFILE,
        OUTSIDE_PROFILE,
    ]
    assert np.isnan(found).all()


def test_under_all_land_there_is_no_far_side():
    # From 5000 m at 87.5 degrees P_90 lies near -1000 m, 280 km away.
    found, status = heights(5000.0, 87.5, np.array([50_000.0, 500_000.0]))
    assert status.tolist() == [OK, MISSES_GROUND]
    assert 2000.0 < found[0] < 5000.0


def test_no_bending_in_a_published_method_beyond_its_own():
    found, status = heights(6000.0, 50.0, 8000.0, rays_by(AIR, "plane"))
    exact, _ = heights(6000.0, 50.0, 8000.0)
    assert status == OK
    # The plane first term is good to 1e-3 of 1.2e-5 rad here; the chord is 8 km long.
    assert float(found) == pytest.approx(float(exact), abs=1e-3)
    assert float(found) != float(exact)


def test_arguments_broadcast():
    found, status = heights(np.array([[3000.0], [4000.0]]), 20.0, np.array([100.0, 200.0, 300.0]))
    assert found.shape == status.shape == (2, 3)
    assert float(found[1, 2]) == float(heights(4000.0, 20.0, 300.0)[0])
    assert heights(np.empty(0), np.empty(0), np.empty(0))[0].shape == (0,)


# Images.

LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
DOWN = np.diag([1.0, -1.0, -1.0])
CAMERA = Camera(
    14_000, 10_600, 11_000.0, 11_000.0, 7012.4, 5291.7, BrownConrady(k1=-0.018, p1=1.5e-4)
)


def seen_from(rotation, h_c=3450.0, cabin=6e-5, change=-3.0) -> Exposures:
    outside = float(AIR.refractivity(h_c))
    normal = np.array([[0.0, math.sin(0.3), math.cos(0.3)]])
    return Exposures(
        np.array([True]),
        rotation[None],
        np.array([0.8]),
        np.array([h_c]),
        np.array([outside]),
        np.array([outside + cabin]),
        normal,
        np.array([change]),
    )


@pytest.mark.parametrize("rotation", [DOWN, LEVEL], ids=["down", "level"])
def test_targets_of_an_image_and_of_its_ideal_pixels(rotation):
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 14_000.0, 200)
    y = rng.uniform(5800.0, 10_600.0, 200)
    distance = np.full(200, 3200.0)
    first = np.zeros(200, np.int64)
    exposures = seen_from(rotation)
    found = target_heights(x, y, distance, first, exposures, camera=CAMERA, table=TABLE)
    assert np.isfinite(found).all()
    assert np.ptp(found) > 100.0
    corrected = correct_observations(
        x, y, found, first, exposures, camera=CAMERA, table=TABLE, distance_m=distance
    )
    assert set(corrected.status.tolist()) <= {OK, FAR_BRANCH}
    straight = target_heights(
        corrected.x_corrected_px,
        corrected.y_corrected_px,
        distance,
        first,
        exposures,
        camera=CAMERA,
        table=TABLE,
        ideal=True,
    )
    np.testing.assert_allclose(straight, found, rtol=0.0, atol=1e-6)
    uncorrected = target_heights(
        x, y, distance, first, exposures, camera=CAMERA, table=TABLE, ideal=True
    )
    assert np.abs(uncorrected - found).max() > 1e-2


def test_an_observation_that_lacks_something_has_no_height():
    x = np.array([7000.0, np.nan, 7000.0, -900.0, 7000.0])
    y = np.full(5, 5000.0)
    first = np.array([0, 0, -1, 0, 0])
    distance = np.array([np.nan, 3000.0, 3000.0, 3000.0, 9e6])
    for ideal in (False, True):
        found = target_heights(
            x, y, distance, first, seen_from(DOWN), camera=CAMERA, table=TABLE, ideal=ideal
        )
        assert np.isnan(found[:4]).all(), ideal
    assert np.isnan(
        target_heights(x, y, distance, first, seen_from(DOWN), camera=CAMERA, table=TABLE)[4]
    )


def test_ideal_pixels_have_neither_window_nor_lens():
    """Of a straight chord the cabin and the air in the lens change nothing, of a ray they do."""
    n = np.atleast_1d(AIR.refractivity(3000.0))
    table = ray_table(AIR)
    down = np.diag([1.0, -1.0, -1.0])[None]
    place = (np.array([True]), down, np.array([0.8]), np.array([3000.0]))
    pixel = (np.array([12_000.0]), np.array([9000.0]), np.array([3500.0]), np.zeros(1, np.int64))

    def height(cabin, change_px, ideal):
        exposures = Exposures(*place, n, n + cabin, principal_change_px=np.array([change_px]))
        return float(target_heights(*pixel, exposures, camera=CAMERA, table=table, ideal=ideal)[0])

    for cabin, change_px in ((1e-4, 0.0), (0.0, 20.0)):
        assert height(cabin, change_px, True) == height(0.0, 0.0, True)
        assert abs(height(cabin, change_px, False) - height(0.0, 0.0, False)) > 0.05
