"""Rays intersected with the stations held: the truth is a block simulated with numpy alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies
from scipy.spatial.transform import Rotation

from tests.block.simulated_block import simulate_block, unit
from unbend.block.image_rays import (
    UNKNOWN_SIGMAS,
    ImageRays,
    orientations_of,
    sorted_rays,
)
from unbend.block.intersection import intersect, point_heights
from unbend.flight.stations import STATION_OK, empty_stations


def rms(values):
    return np.sqrt(np.nanmean(np.square(values)))


def intersected(block):
    return intersect(block.orientations, block.rays)


def log_likelihood(orientations, rays):
    return intersect(orientations, rays).log_likelihood


def assigned_log_likelihood(block, rows):
    """Of the rays, where images have the stations of these rows."""
    return log_likelihood(block.orientations.assigned(np.asarray(rows)), block.rays)


def turned_log_likelihood(block, angle_rad):
    """Of the rays, where the camera is turned about its y axis."""
    turn = np.array([0.0, angle_rad, 0.0])
    return log_likelihood(block.orientations.turned(turn, "camera0"), block.rays)


def height_errors_m(block, points):
    return points.geodetic[2] - block.point_h[points.point]


PIXELS_DECIDE = {"pixel_rad": 0.003}
POSITIONS_DECIDE = {"sigma": (2.0, 2.0, 3.0, 0.0005, 0.0005, 0.001)}
ATTITUDES_DECIDE = {
    "sigma": (0.02, 0.02, 0.03, 0.005, 0.005, 0.02),
    "height": 300.0,
    "base": 90.0,
}


@pytest.mark.parametrize(
    "options",
    [
        {},
        POSITIONS_DECIDE,
        ATTITUDES_DECIDE,
        PIXELS_DECIDE,
        {
            "cameras": (0.0, 0.5),
            "points": 900,
        },
        {
            "lines": 1,
            "each": 6,
            "points": 60,
        },
    ],
)
def test_residuals_are_as_large_as_the_sigmas_say(options):
    """Chi-square of all, of cameras, and each height: against their sigmas."""
    of_all = []
    of_cameras = []
    of_heights = []
    for seed in range(12):
        block = simulate_block(seed, **options)
        points = intersected(block)
        of_all.append(points.chi_square / points.redundancy)
        for name in np.unique(block.camera):
            turn, covariance = points.camera_rotation(name)
            of_cameras.append(turn @ np.linalg.pinv(covariance) @ turn / 3.0)
        over_sigma = height_errors_m(block, points) / points.sigma_height_m
        of_heights.append(rms(over_sigma))
        assert points.bad.mean() < 0.004
    assert 0.7 <= np.sqrt(np.mean(of_all)) <= 1.2
    assert 0.6 <= np.sqrt(np.mean(of_cameras)) <= 1.35  # 36 to 72 numbers
    assert 0.7 <= np.mean(of_heights) <= 1.2


def test_without_errors_points_are_exact():
    block = simulate_block(1, errors=False, pixel_rad=1e-12)
    points = intersected(block)
    latitude, _, height_m = points.geodetic
    assert np.nanmax(np.abs(height_errors_m(block, points))) < 1e-5
    assert np.nanmax(np.abs(points.residual_rad)) < 1e-9
    assert latitude[points.used] == pytest.approx(np.radians(47.0), abs=1e-3)
    assert np.isnan(height_m[~points.used]).all()
    assert not points.used.all()
    assert points.flying_height_m == pytest.approx(970.0, abs=10.0)  # above 0 to 60 m


def test_the_likelihood_ratio_of_a_mount_angle_is_honest():
    """Twice the gain of the best angle over the true one is chi-square of one degree of freedom.

    Errors of a station are those of all its rays: taken for those of single rays, the gain is
    larger by the rays of an image.
    """
    gains = []
    estimates = []
    step = 2e-4
    for seed in range(25):
        block = simulate_block(100 + seed, points=300)
        points = intersected(block)
        middle = points.log_likelihood
        low = turned_log_likelihood(block, -step)
        high = turned_log_likelihood(block, step)
        slope = (high - low) / (2 * step)
        curve = (high - 2 * middle + low) / step**2
        assert curve < 0.0
        gains.append(-(slope**2) / curve)
        turn, covariance = points.camera_rotation("camera0")
        estimates.append(turn / np.sqrt(np.diag(covariance)))
    assert 0.4 < np.mean(gains) < 1.8  # 25 numbers: 1.0 +- 0.28
    assert 0.7 < rms(np.array(estimates)) < 1.3


def test_a_turned_camera_is_found_and_mended():
    block = simulate_block(
        7,
        cameras=(0.0, 0.5),
        points=900,
    )
    wrong = block.orientations.turned(np.array([0.004, -0.012, 0.01]), "camera1")
    points = intersect(wrong, block.rays)
    turn, covariance = points.camera_rotation("camera1")
    assert turn @ np.linalg.inv(covariance) @ turn > 100.0
    off_rad = np.abs(turn - [-0.004, 0.012, -0.01])
    sigma_rad = np.sqrt(np.diag(covariance))
    assert (off_rad < 4.0 * sigma_rad + 1e-4).all()
    mended = wrong.turned(turn, "camera1")
    assert log_likelihood(mended, block.rays) - points.log_likelihood > 10.0


def test_a_shift_by_one_event_is_far_less_likely():
    block = simulate_block(3)
    right = intersected(block).log_likelihood
    assert assigned_log_likelihood(block, range(36)) == right
    for shift in (-5, -1, 1, 2, 5):
        rows = np.arange(36) + shift
        rows[(rows < 0) | (rows > 35)] = -1
        assert right - assigned_log_likelihood(block, rows) > 100.0


def test_images_without_an_event_have_no_residuals():
    block = simulate_block(3)
    rows = np.array(
        [
            -1,
            -1,
            -1,
            *range(3, 36),
        ]
    )
    points = intersect(block.orientations.assigned(rows), block.rays)
    assert np.isnan(points.residual_rad[block.image < 3]).all()
    assert 0.8 < points.sigma_factor < 1.2
    assert points.log_likelihood < intersected(block).log_likelihood


def scaled(rays, factor):
    """The rays of a camera whose principal distance is larger by a factor, from the same pixels."""
    direction = unit(rays.direction / [factor, factor, 1.0])
    return replace(
        rays,
        direction=direction,
        sigma_rad=rays.sigma_rad / factor,
    )


def test_given_heights_tell_the_principal_distance():
    """It scales heights above ground, which rays alone hardly see over flat land."""
    block = simulate_block(5)
    height_m = block.point_h[block.point]
    rays = replace(
        block.rays,
        height_m=height_m,
        sigma_height_m=1.0,
    )
    points = intersect(block.orientations, rays)
    assert 0.8 < points.sigma_factor < 1.2
    for factor in (0.98, 1.02):
        other = log_likelihood(block.orientations, scaled(rays, factor))
        assert points.log_likelihood - other > 100.0
    lifted = replace(rays, height_m=height_m + 30.0)
    assert points.log_likelihood - log_likelihood(block.orientations, lifted) > 50.0


def test_bad_tie_points_are_found_and_cost_little():
    """What is wrong with points is wrong under every hypothesis: a shift stays less likely."""
    clean = simulate_block(6)
    rng = np.random.default_rng(0)
    several = np.flatnonzero(np.bincount(clean.point)[clean.point] >= 3)
    wrong = rng.choice(several, 40, replace=False)
    direction = clean.direction.copy()
    direction[wrong] += rng.normal(0.0, 0.05, (40, 3))
    block = replace(clean, direction=unit(direction))

    points = intersected(block)

    assert np.mean(points.bad[wrong]) >= 0.9
    assert np.mean(np.delete(points.bad, wrong)) < 0.04  # of two rays both
    assert 0.8 < points.sigma_factor < 1.25
    clean_rms_m = rms(height_errors_m(clean, intersected(clean)))
    assert rms(height_errors_m(block, points)) < 1.3 * clean_rms_m
    shifted = assigned_log_likelihood(block, [*range(1, 36), -1])
    assert points.log_likelihood - shifted > 100.0


def test_sigmas_that_are_too_small_do_not_feign_certainty():
    honest = simulate_block(9)
    feigned = replace(
        honest,
        sigma=honest.sigma / 3.0,
        pixel_rad=honest.pixel_rad / 3.0,
    )

    def log_ratio(block):
        return abs(intersected(block).log_likelihood - turned_log_likelihood(block, 0.002))

    assert intersected(feigned).sigma_factor > 2.0
    assert log_ratio(feigned) < 2.0 * log_ratio(honest) + 5.0


def test_rays_nearly_parallel_or_behind_are_not_used():
    block = simulate_block(10, points=200)
    narrow = intersect(block.orientations, block.rays, minimum_angle_rad=1.3)
    assert not narrow.used.any()
    assert narrow.redundancy == 0
    assert np.isnan(narrow.sigma_factor)
    wide = intersected(block)
    assert (wide.angle_rad[wide.used] >= np.radians(3.0)).all()
    assert narrow.log_likelihood < wide.log_likelihood
    backward = replace(block, direction=-block.direction)
    assert not intersected(backward).used.any()


@pytest.mark.parametrize("options", [{}, POSITIONS_DECIDE, PIXELS_DECIDE])
def test_heights_of_single_points_err_by_their_sigmas(options):
    """Sigmas are enlarged where the rays miss by more, and never made smaller."""
    errors = []
    for seed in range(40, 46):
        block = simulate_block(seed, **options)
        heights = point_heights(block.orientations, block.rays)
        numbers = np.unique(block.point)
        errors.append((heights.h_m - block.point_h[numbers]) / heights.sigma_m)
        assert np.array_equal(numbers[heights.index], block.point)
    errors = np.concatenate(errors)
    assert np.isfinite(errors).mean() > 0.9
    assert 0.6 <= rms(errors) <= 1.1


def test_points_without_a_height_say_why():
    """One has a single ray, one rays of one image alone, and of one the rays do not meet."""
    block = simulate_block(13, errors=False, pixel_rad=1e-9)
    direction = block.direction.copy()
    image = block.image.copy()
    of_few = block.point[0]
    of_narrow = block.point[block.point != of_few][0]
    of_apart = 300
    rows = np.flatnonzero(block.point == of_narrow)
    image[rows] = image[rows[0]]
    direction[rows] = direction[rows[0]]
    direction[np.argmax(block.point == of_apart)] += [0.0, 0.2, 0.0]
    kept = np.append(0, np.flatnonzero(block.point != of_few))
    rays = ImageRays(
        image[kept],
        block.point[kept],
        unit(direction)[kept],
        1e-4,
    )
    orientations = replace(block.orientations, sigma=np.full((36, 6), 1e-5))

    heights = point_heights(orientations, rays)

    numbers = np.unique(rays.point)
    point_of_reason = {
        "few": of_few,
        "narrow": of_narrow,
        "apart": of_apart,
    }
    for reason, number in point_of_reason.items():
        row = np.searchsorted(numbers, number)
        reasons = [name for name in point_of_reason if getattr(heights, name)[row]]
        assert reasons == [reason]
        assert np.isnan(heights.h_m[row])
        assert np.isnan(heights.sigma_m[row])
    off_m = heights.h_m - block.point_h[numbers]
    assert np.nanmax(np.abs(off_m)) < 1e-4


def test_stations_become_orientations():
    """Through latitude, longitude, height and quaternion: as computed by hand.

    The first has no position, the second only a height above the sea and one that is stated as
    exact.
    """
    block = simulate_block(12)
    by_hand = block.orientations
    row = np.arange(36)
    is_exact = row == 1
    rotation = Rotation.from_matrix(block.camera_from_enu)
    stations = replace(
        empty_stations(block.camera, block.camera, STATION_OK),
        lat_rad=block.lat,
        lon_rad=block.lon,
        h_msl_m=np.where(is_exact, block.h, 0.0),
        h_ellipsoid_m=np.where(is_exact, np.nan, block.h),
        quaternion=rotation.as_quat(scalar_first=True),
        sigma_height_m=np.where(is_exact, 0.0, np.nan),
        sigma_tilt_rad=np.full(36, 0.002),
        status=np.where(row == 0, "in_gap", STATION_OK).astype(object),
    )

    oriented = orientations_of(stations)

    assert np.isnan(oriented.centre_m[0]).all()
    np.testing.assert_allclose(oriented.centre_m[1:], by_hand.centre_m[1:], atol=1e-6)
    attitude = oriented.camera_from_ecef[1:]
    np.testing.assert_allclose(attitude, by_hand.camera_from_ecef[1:], atol=1e-9)
    assert oriented.sigma[0].tolist() == [
        3.0,
        3.0,
        6.0,
        0.002,
        0.002,
        UNKNOWN_SIGMAS[5],
    ]
    assert oriented.sigma[1, 2] == 1e-3


@settings(max_examples=15)
@given(strategies.integers(0, 49), strategies.floats(-3.0, 3.0))
def test_longitude_order_and_names_do_not_matter(seed, longitude):
    """The block carried around the earth, with its rays in another order: the same residuals."""
    block = simulate_block(
        seed,
        lines=2,
        each=5,
        points=80,
    )
    logged = block.orientations
    around = Rotation.from_euler("z", longitude).as_matrix().T
    moved = replace(
        logged,
        centre_m=logged.centre_m @ around,
        camera_from_ecef=logged.camera_from_ecef @ around,
        enu_from_ecef=logged.enu_from_ecef @ around,
    )
    order = np.random.default_rng(seed).permutation(block.image.size)
    reordered = ImageRays(
        block.image[order],
        7 * block.point[order],
        block.direction[order],
        1e-4,
    )

    points = intersected(block)
    other = intersect(moved, reordered)

    assert other.log_likelihood == pytest.approx(points.log_likelihood, abs=1e-3)
    np.testing.assert_allclose(other.residual_rad, points.residual_rad[order], atol=1e-8)
    np.testing.assert_allclose(other.geodetic[2], points.geodetic[2], atol=1e-4)


def test_nothing_oriented_is_no_intersection():
    block = simulate_block(
        2,
        lines=1,
        each=4,
        points=50,
    )
    points = intersect(block.orientations.assigned(np.full(4, -1)), block.rays)
    assert not points.used.any()
    assert np.isfinite(points.log_likelihood)
    assert points.log_likelihood < intersected(block).log_likelihood


def test_the_square_of_an_attitudes_error_counts_to_the_sigma_of_a_ray():
    """A turn by d moves a ray v to the side by d x v + (d . v) d / 2, besides d^2.

    Of the last term the standard deviation is s^2 / 2 along each axis, for d of s about each axis.
    """
    sigma_rad = 0.2
    turn = np.random.default_rng(3).normal(0.0, sigma_rad, (200_000, 3))
    to_the_side = 0.5 * turn[:, 2:] * turn[:, :2]  # of a ray along z
    block = simulate_block(
        0,
        lines=1,
        each=6,
        points=20,
    )
    sigma = block.sigma.copy()
    sigma[:, 3:] = sigma_rad
    oriented = replace(block.orientations, sigma=sigma)
    in_order = sorted_rays(oriented, block.rays)
    good = np.ones(in_order.sigma.shape, bool)

    misses = in_order.misses(oriented, in_order.positions(good), good)

    expected = np.hypot(block.pixel_rad, sigma_rad**2 / 2.0)
    assert misses.sigma == pytest.approx(expected, rel=1e-4)
    assert misses.sigma == pytest.approx(to_the_side.std(), rel=0.02)
