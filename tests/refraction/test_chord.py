"""Heights by slant range, against chords of 30-digit rays and against the angles themselves."""

import math
from math import inf, nan

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction.comparing import assert_near
from tests.refraction.exact_rays import ExactRays
from tests.refraction.images import DISTORTED, DOWN, RADIUS, TILTED, corrected, exposure, looking
from tests.refraction.rays import AIR, TABLE
from unbend.refraction import height_at_distance
from unbend.refraction.ray import rays_by
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)
from unbend.refraction.target_heights import target_heights


def heights(h_c, degrees, distance, table=TABLE):
    zeta = np.radians(degrees)
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    return height_at_distance(table, h_c, sine, cosine, distance, radius=RADIUS)


def assert_end_of_chord(h_c, h, degrees, beyond=False):
    """The height at the length of an exact chord is that of its end."""
    chord = ExactRays(30).crossing(h_c, h, math.radians(degrees), beyond=beyond)
    h_g, status = heights(h_c, degrees, chord.distance_m)
    assert status == OK
    assert_near(h_g, float(h), 1e-6)


@pytest.mark.parametrize(
    ("h_c", "h", "degrees"),
    [
        (3000.0, 0.0, 0.0),
        (3000.0, 450.0, 45.0),
        (10_000.0, -200.0, 75.0),
        (10_000.0, 500.0, 85.0),
        (5000.0, 1500.0, 88.2),
        (1000.0, 3000.0, 95.0),
        (1000.0, 3000.0, 90.0),
        (1000.0, 8000.0, 135.0),
    ],
)
def test_against_thirty_digits(h_c, h, degrees):
    assert_end_of_chord(h_c, h, degrees)


@pytest.mark.parametrize("above", [1e-6, 1e-3, 1.0, 500.0])
@pytest.mark.parametrize("beyond", [False, True])
def test_through_the_lowest_point(above, beyond):
    turning_m = ExactRays(30).turning_height(5000.0, math.radians(88.2))
    assert_end_of_chord(5000.0, turning_m + above, 88.2, beyond)


@pytest.mark.parametrize("h", [5000.0, 9000.0])
def test_far_beyond_it_the_ray_rises_over_the_camera(h):
    assert_end_of_chord(5000.0, h, 88.2, beyond=True)


@pytest.mark.parametrize(
    ("h_c", "degrees", "distance", "expected"),
    [
        (3000.0, 10.0, nan, BAD_MEASUREMENT),
        (3000.0, 10.0, 0.0, BAD_MEASUREMENT),
        (3000.0, 10.0, -5.0, BAD_MEASUREMENT),
        (3000.0, 89.0, inf, BAD_MEASUREMENT),
        (3000.0, nan, 100.0, BAD_MEASUREMENT),
        (3000.0, 100.0, 5e6, OUTSIDE_PROFILE),
        (3000.0, 10.0, 3e4, OUTSIDE_PROFILE),
        (99_000.0, 10.0, 3000.0, OUTSIDE_PROFILE),
        # P_90 is near -1000 m, 280 km away: under all land there is no far side.
        (5000.0, 87.5, 500_000.0, MISSES_GROUND),
    ],
)
def test_what_has_no_end_has_a_reason(h_c, degrees, distance, expected):
    h_g, status = heights(h_c, degrees, distance)
    assert status == expected
    assert np.isnan(h_g)


def test_a_published_method_has_its_own_height():
    ray = (6000.0, 50.0, 8000.0)
    by_plane, status = heights(*ray, rays_by(AIR, "plane"))
    exact, _ = heights(*ray)
    assert status == OK
    # The plane first term is good to 1e-3 of 1.2e-5 rad here; the chord is 8 km long.
    assert_near(by_plane, exact, 1e-3)
    assert by_plane != exact


@pytest.mark.parametrize("method", ["plane", "gyer1996"])
def test_a_published_method_says_why_there_is_no_height(method):
    """Rows that end at once were bad measurements beside one that needs more rounds."""
    rays = rays_by(AIR, method)
    table = [
        # h_c, nadir angle [deg], distance, status
        (6000.0, 50.0, 8000.0, OK),
        (6000.0, 50.0, 1e6, OUTSIDE_PROFILE),
        (6000.0, 50.0, nan, BAD_MEASUREMENT),
        (6000.0, 50.0, 0.0, BAD_MEASUREMENT),
        (nan, 50.0, 8000.0, BAD_MEASUREMENT),
        (6000.0, 0.0, nan, BAD_MEASUREMENT),
        (9000.0, 80.0, 30_000.0, OK),
    ]
    h_c, nadir_deg, distance, expected = np.array(table).T

    together, status = heights(h_c, nadir_deg, distance, rays)

    assert status.tolist() == expected.tolist()
    assert_array_equal(np.isfinite(together), expected == OK)
    for i, (*row, _) in enumerate(table):
        alone, status_alone = heights(*row, rays)
        assert_array_equal(alone, together[i])
        assert status_alone == status[i]


def test_arguments_broadcast():
    h_c = np.array([[3000.0], [4000.0]])
    distance = np.array([100.0, 200.0, 300.0])
    h_g, status = heights(h_c, 20.0, distance)
    assert h_g.shape == (2, 3)
    assert status.shape == (2, 3)
    alone, _ = heights(4000.0, 20.0, 300.0)
    assert h_g[1, 2] == alone
    nothing = np.empty(0)
    h_g, _ = heights(nothing, nothing, nothing)
    assert h_g.shape == (0,)


def heights_of_image(x, y, distance, setup, *, row=0, ideal=False):
    columns = np.broadcast_arrays(x, y, distance, row)
    return target_heights(
        *map(np.array, columns),
        setup,
        camera=DISTORTED,
        table=TABLE,
        ideal=ideal,
    )


@pytest.mark.parametrize("rotation", [DOWN, looking(90.0)], ids=["down", "level"])
def test_targets_of_an_image_and_of_its_ideal_pixels(rotation):
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 14_000.0, 200)
    y = rng.uniform(5800.0, 10_600.0, 200)
    setup = exposure(
        AIR,
        rotation,
        cabin_excess=6e-5,
        normal=TILTED,
        change_px=-3.0,
    )

    curved = heights_of_image(x, y, 3200.0, setup)
    assert np.isfinite(curved).all()
    assert np.ptp(curved) > 100.0
    corrections = corrected(
        x,
        y,
        setup,
        TABLE,
        camera=DISTORTED,
        h_g=curved,
        distance_m=3200.0,
    )
    assert set(corrections.status.tolist()) <= {OK, FAR_BRANCH}
    x_ideal = corrections.x_corrected_px
    y_ideal = corrections.y_corrected_px
    straight = heights_of_image(x_ideal, y_ideal, 3200.0, setup, ideal=True)
    assert_near(straight, curved, 1e-6)
    uncorrected = heights_of_image(x, y, 3200.0, setup, ideal=True)
    assert np.abs(uncorrected - curved).max() > 1e-2


def test_an_observation_that_lacks_something_has_no_height():
    x = np.array([7000.0, nan, 7000.0, -900.0, 7000.0])
    distance = np.array([nan, 3000.0, 3000.0, 3000.0, 9e6])
    row = np.array([0, 0, -1, 0, 0])
    setup = exposure(AIR)
    curved = heights_of_image(x, 5000.0, distance, setup, row=row)
    assert np.isnan(curved).all()
    # A straight line goes on outside the air.
    straight = heights_of_image(
        x,
        5000.0,
        distance,
        setup,
        row=row,
        ideal=True,
    )
    assert np.isnan(straight).tolist() == [True, True, True, True, False]


@pytest.mark.parametrize("changed", [{"cabin_excess": 1e-4}, {"change_px": 20.0}])
def test_ideal_pixels_have_neither_window_nor_lens(changed):
    """Of a straight chord the cabin and the air in the lens change nothing, of a ray they do."""

    def height(setup, **options):
        return heights_of_image(
            [12_000.0],
            [9000.0],
            [3500.0],
            setup,
            **options,
        )

    plain = exposure(AIR)
    other = exposure(AIR, **changed)
    assert height(other, ideal=True) == height(plain, ideal=True)
    assert abs(height(other) - height(plain)) > 0.05
