"""Rays intersected with the stations held: the truth is a block simulated with numpy alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend.block.image_rays import (
    UNKNOWN_SIGMAS,
    ImageRays,
    Orientations,
    orientations_of,
    sorted_rays,
)
from unbend.block.intersection import Intersection, intersect, point_heights
from unbend.flight.stations import STATION_OK, empty_stations


@pytest.fixture(scope="module")
def make(simulated_block):
    """A simulated block, its orientations and rays."""

    def made(seed: int, **options):
        block = simulated_block.simulate_block(np.random.default_rng(seed), **options)
        frames = simulated_block.axes(block.lat, block.lon)
        centre = simulated_block.ecef(block.lat, block.lon, block.h)
        orientations = Orientations(
            block.camera, centre, block.camera_from_enu @ frames, frames, block.sigma
        )
        return (
            block,
            orientations,
            ImageRays(block.image, block.point, block.direction, block.pixel_rad),
        )

    return made


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def between(value: float) -> bool:
    return 0.7 <= value <= 1.2


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sigma": (2.0, 2.0, 3.0, 0.0005, 0.0005, 0.001)},  # position decides
        {"sigma": (0.02, 0.02, 0.03, 0.005, 0.005, 0.02), "height": 300.0, "base": 90.0},
        {"pixel_rad": 0.003},  # pixels decide
        {"cameras": (0.0, 0.5), "points": 900},
        {"lines": 1, "each": 6, "points": 60},
    ],
)
def test_residuals_are_as_large_as_the_sigmas_say(make, options):
    """Chi-square of all, of cameras, and each height: against their sigmas."""
    ratio = []
    camera = []
    height = []
    for seed in range(12):
        block, orientations, rays = make(seed, **options)
        found = intersect(orientations, rays)
        ratio.append(found.chi_square / found.redundancy)
        for name in np.unique(orientations.camera):
            turn, covariance = found.camera_rotation(name)
            camera.append(turn @ np.linalg.pinv(covariance) @ turn / 3.0)
        off = found.geodetic[2] - block.point_h[found.point]
        height.append(rms(off / found.sigma_height_m))
        assert found.bad.mean() < 0.004
    assert between(np.sqrt(np.mean(ratio))), np.mean(ratio)
    assert 0.6 <= np.sqrt(np.mean(camera)) <= 1.35, np.mean(camera)  # 36 to 72 numbers
    assert between(np.mean(height)), np.mean(height)


def test_without_errors_points_are_exact(make):
    block, orientations, rays = make(1, errors=False, pixel_rad=1e-12)
    found = intersect(orientations, rays)
    lat, _, h = found.geodetic
    assert np.nanmax(np.abs(h - block.point_h[found.point])) < 1e-5
    assert np.nanmax(np.abs(found.residual_rad)) < 1e-9
    assert np.all(np.abs(lat[found.used] - np.radians(47.0)) < 1e-3)
    assert np.isnan(h[~found.used]).all()
    assert (~found.used).any()


def test_the_likelihood_ratio_of_a_mount_angle_is_honest(make):
    """Twice the gain of the best angle over the true one is chi-square of one degree of freedom.

    Errors of a station are those of all its rays: taken for those of single rays, the gain is
    larger by the rays of an image.
    """
    gains = []
    estimates = []
    step = 2e-4
    for seed in range(25):
        _, orientations, rays = make(100 + seed, points=300)

        def likelihood(angle: float, orientations=orientations, rays=rays) -> float:
            turned = orientations.turned(np.array([0.0, angle, 0.0]), "camera0")
            return intersect(turned, rays).log_likelihood

        low = likelihood(-step)
        middle = likelihood(0.0)
        high = likelihood(step)
        slope = (high - low) / (2 * step)
        curve = (high - 2 * middle + low) / step**2
        assert curve < 0.0
        gains.append(-(slope**2) / curve)
        turn, covariance = intersect(orientations, rays).camera_rotation("camera0")
        estimates.append(turn / np.sqrt(np.diag(covariance)))
    assert 0.4 < np.mean(gains) < 1.8, np.mean(gains)  # 25 numbers: 1.0 +- 0.28
    assert 0.7 < rms(np.array(estimates)) < 1.3


def test_a_turned_camera_is_found_and_mended(make):
    _, orientations, rays = make(7, cameras=(0.0, 0.5), points=900)
    wrong = orientations.turned(np.array([0.004, -0.012, 0.01]), "camera1")
    turn, covariance = intersect(wrong, rays).camera_rotation("camera1")
    assert turn @ np.linalg.inv(covariance) @ turn > 100.0
    right = turn - [-0.004, 0.012, -0.01]
    assert np.all(np.abs(right) < 4.0 * np.sqrt(np.diag(covariance)) + 1e-4)
    mended = wrong.turned(turn, "camera1")
    gain = intersect(mended, rays).log_likelihood - intersect(wrong, rays).log_likelihood
    assert gain > 10.0


def likelihood(orientations: Orientations, rays: ImageRays) -> float:
    return intersect(orientations, rays).log_likelihood


def test_a_shift_by_one_event_is_far_less_likely(make):
    _, orientations, rays = make(3)
    events = np.arange(36)
    right = likelihood(orientations.assigned(events), rays)
    assert right == likelihood(orientations, rays)
    for shift in (-5, -1, 1, 2, 5):
        row = events + shift
        shifted = orientations.assigned(np.where((row >= 0) & (row < 36), row, -1))
        assert right - likelihood(shifted, rays) > 100.0
    lost = orientations.assigned(np.where(events < 3, -1, events))
    found = intersect(lost, rays)
    assert np.isnan(found.residual_rad[rays.image < 3]).all()
    assert 0.8 < found.sigma_factor < 1.2
    assert found.log_likelihood < right


def test_swapped_cameras_are_far_less_likely(make):
    _, orientations, rays = make(4, cameras=(-0.3, 0.3), points=900)
    half = orientations.camera.size // 2
    swapped = orientations.assigned(np.roll(np.arange(2 * half), half))
    assert likelihood(orientations, rays) - likelihood(swapped, rays) > 100.0


def scaled(rays: ImageRays, factor: float) -> ImageRays:
    """The rays of a camera whose principal distance is larger by a factor, from the same pixels."""
    d = rays.direction / [factor, factor, 1.0]
    return replace(
        rays,
        direction=d / np.linalg.norm(d, axis=1, keepdims=True),
        sigma_rad=rays.sigma_rad / factor,
    )


def test_given_heights_tell_the_principal_distance(make):
    """It scales heights above ground, which rays alone hardly see over flat land."""
    block, orientations, rays = make(5)
    known = replace(rays, height_m=block.point_h[rays.point], sigma_height_m=1.0)
    right = likelihood(orientations, known)
    for factor in (0.98, 1.02):
        assert right - likelihood(orientations, scaled(known, factor)) > 100.0
    lifted = replace(known, height_m=known.height_m + 30.0)
    assert right - likelihood(orientations, lifted) > 50.0
    found = intersect(orientations, known)
    assert 0.8 < found.sigma_factor < 1.2


def test_bad_tie_points_are_found_and_cost_little(make):
    block, orientations, rays = make(6)
    clean = intersect(orientations, rays)
    rng = np.random.default_rng(0)
    several = np.flatnonzero(np.bincount(rays.point, minlength=600)[rays.point] >= 3)
    wrong = rng.choice(several, 40, replace=False)
    direction = rays.direction.copy()
    direction[wrong] += rng.normal(0.0, 0.05, (40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = intersect(orientations, replace(rays, direction=direction))
    assert np.mean(found.bad[wrong]) >= 0.9
    assert np.mean(np.delete(found.bad, wrong)) < 0.04  # of two rays both
    assert 0.8 < found.sigma_factor < 1.25
    heights = [x.geodetic[2] - block.point_h[x.point] for x in (clean, found)]
    assert rms(heights[1]) < 1.3 * rms(heights[0])
    # What is wrong with points is wrong under every hypothesis: a shift stays far less likely.
    shifted = orientations.assigned(np.append(np.arange(1, 36), -1))
    assert found.log_likelihood - likelihood(shifted, replace(rays, direction=direction)) > 100.0


def test_sigmas_that_are_too_small_do_not_feign_certainty(make):
    _, orientations, rays = make(9)
    feigned = replace(orientations, sigma=orientations.sigma / 3.0)
    fine = replace(rays, sigma_rad=rays.sigma_rad / 3.0)
    turned = np.array([0.0, 0.002, 0.0])

    def ratio(o: Orientations, r: ImageRays) -> float:
        return likelihood(o, r) - likelihood(o.turned(turned, "camera0"), r)

    assert intersect(feigned, fine).sigma_factor > 2.0
    assert abs(ratio(feigned, fine)) < 2.0 * abs(ratio(orientations, rays)) + 5.0


def test_rays_nearly_parallel_or_behind_are_not_used(make):
    _, orientations, rays = make(10, points=200)
    narrow = intersect(orientations, rays, minimum_angle_rad=1.3)
    assert not narrow.used.any()
    assert narrow.redundancy == 0
    assert np.isnan(narrow.sigma_factor)
    wide = intersect(orientations, rays)
    assert np.all(wide.angle_rad[wide.used] >= np.radians(3.0))
    d = [rays.direction[rays.point == point] for point in wide.point]
    assert narrow.log_likelihood < wide.log_likelihood
    behind = intersect(orientations, replace(rays, direction=-rays.direction))
    assert not behind.used.any()
    assert len(d) == wide.point.size


@pytest.mark.parametrize(
    "options",
    [{}, {"sigma": (2.0, 2.0, 3.0, 0.0005, 0.0005, 0.001)}, {"pixel_rad": 0.003}],
)
def test_heights_of_single_points_err_by_their_sigmas(make, options):
    errors = []
    for seed in range(6):
        block, orientations, rays = make(40 + seed, **options)
        found = point_heights(orientations, rays)
        point = np.unique(rays.point)
        errors.append((found.h_m - block.point_h[point]) / found.sigma_m)
        assert (found.index == np.searchsorted(point, rays.point)).all()
    errors = np.concatenate(errors)
    assert np.isfinite(errors).mean() > 0.9
    # Sigmas are enlarged where the rays miss by more, and never made smaller.
    assert 0.6 <= rms(errors) <= 1.1, rms(errors)


def test_points_without_a_height_say_why(make):
    block, orientations, rays = make(13, errors=False, pixel_rad=1e-9)
    first = rays.point == rays.point[0]
    narrow = np.flatnonzero(rays.point == rays.point[np.argmax(~first)])
    apart = np.flatnonzero(rays.point == 300)
    direction = rays.direction.copy()
    image = rays.image.copy()
    image[narrow], direction[narrow] = image[narrow[0]], direction[narrow[0]]  # one image, one ray
    direction[apart[0]] += [0.0, 0.2, 0.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    keep = ~first | (np.arange(first.size) == np.argmax(first))
    made = ImageRays(image[keep], rays.point[keep], direction[keep], 1e-4)
    exact = replace(orientations, sigma=np.full_like(orientations.sigma, 1e-5))
    found = point_heights(exact, made)
    points = np.unique(made.point)
    number = dict(
        zip(
            ("few", "narrow", "apart"),
            np.searchsorted(points, [rays.point[0], rays.point[narrow[0]], 300]),
            strict=True,
        )
    )
    for why, p in number.items():
        assert getattr(found, why)[p], why
        assert np.isnan(found.h_m[p] + found.sigma_m[p])
        assert sum(getattr(found, other)[p] for other in number) == 1
    known = np.isfinite(found.h_m)
    assert np.abs(found.h_m - block.point_h[points])[known].max() < 1e-4


def test_stations_become_orientations(make, simulated_block):
    """Through latitude, longitude, height and quaternion: as computed by hand."""
    block, by_hand, _ = make(12)
    from scipy.spatial.transform import Rotation

    count = block.lat.size
    stations = empty_stations(np.arange(count).astype(str).astype(object), block.camera, STATION_OK)
    q = Rotation.from_matrix(block.camera_from_enu).as_quat()[:, [3, 0, 1, 2]]
    status = stations.status.copy()
    status[5] = "in_gap"
    stations = replace(
        stations,
        lat_rad=block.lat,
        lon_rad=block.lon,
        h_ellipsoid_m=block.h,
        quaternion=q,
        sigma_tilt_rad=np.full(count, 0.002),
        status=status,
    )
    got = orientations_of(stations)
    known = np.arange(count) != 5
    np.testing.assert_allclose(got.centre_m[known], by_hand.centre_m[known], atol=1e-6)
    np.testing.assert_allclose(
        got.camera_from_ecef[known], by_hand.camera_from_ecef[known], atol=1e-9
    )
    assert np.isnan(got.centre_m[5]).all()
    assert got.sigma[0].tolist() == [3.0, 3.0, 6.0, 0.002, 0.002, UNKNOWN_SIGMAS[5]]


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(-3.0, 3.0))
def test_longitude_order_and_names_do_not_matter(make, seed, longitude):
    """The block carried around the earth, with its rays in another order: the same residuals."""
    _, orientations, rays = make(seed % 50, lines=2, each=5, points=80)
    found = intersect(orientations, rays)
    c = np.cos(longitude)
    s = np.sin(longitude)
    around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = replace(
        orientations,
        centre_m=orientations.centre_m @ around.T,
        camera_from_ecef=orientations.camera_from_ecef @ around.T,
        enu_from_ecef=orientations.enu_from_ecef @ around.T,
    )
    order = np.random.default_rng(seed).permutation(rays.image.size)
    other = intersect(
        moved, ImageRays(rays.image[order], 7 * rays.point[order], rays.direction[order], 1e-4)
    )
    assert other.log_likelihood == pytest.approx(found.log_likelihood, abs=1e-3)
    np.testing.assert_allclose(other.residual_rad, found.residual_rad[order], atol=1e-8)
    np.testing.assert_allclose(other.geodetic[2], found.geodetic[2], atol=1e-4)


def test_nothing_oriented_is_no_intersection(make) -> None:
    _, orientations, rays = make(2, lines=1, each=4, points=50)
    found: Intersection = intersect(orientations.assigned(np.full(4, -1)), rays)
    assert not found.used.any()
    assert np.isfinite(found.log_likelihood)
    assert found.log_likelihood < likelihood(orientations, rays)


def test_the_square_of_an_attitudes_error_counts_to_the_sigma_of_a_ray(make):
    """A turn by d moves a ray v to the side by d x v + (d . v) d / 2, besides d^2: of the last
    term the standard deviation is s^2 / 2 along each axis, for d of s about each axis.
    """
    sigma_rad = 0.2
    pixel_rad = 1e-4
    turn = np.random.default_rng(3).normal(0.0, sigma_rad, (200_000, 3))
    ray = np.array([0.0, 0.0, 1.0])
    to_the_side = 0.5 * (turn @ ray)[:, None] * turn
    drawn = to_the_side[:, :2].std()
    _, orientations, rays = make(0, lines=1, each=6, points=20)
    sigma = orientations.sigma.copy()
    sigma[:, 3:] = sigma_rad
    oriented = replace(orientations, sigma=sigma)
    in_order = sorted_rays(oriented, replace(rays, sigma_rad=pixel_rad))
    good = np.ones(in_order.sigma.shape, bool)
    misses = in_order.misses(oriented, in_order.positions(good), good)
    assert misses.sigma == pytest.approx(np.hypot(pixel_rad, sigma_rad**2 / 2.0), rel=1e-4)
    assert misses.sigma == pytest.approx(drawn, rel=0.02)
