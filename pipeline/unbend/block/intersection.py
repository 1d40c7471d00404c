"""Points from the rays of several images, the stations held: do the rays meet as the sigmas say?

How to use it::

    stations = orientations_of(stations_of_the_flight)         # or Orientations(...) directly
    rays = ImageRays(image, point, direction, sigma_rad)            # straight, corrected rays
    found = intersect(stations, rays)
    found.log_likelihood, found.sigma_factor, found.camera_rotation("nadir")
    other = intersect(stations.assigned(event_of_image), rays)   # a hypothesis
    found.log_likelihood - other.log_likelihood                # its likelihood ratio

There is no bundle adjustment: stations stay, points are intersected by least squares.
Errors of a station are shared by all rays of its image, and a point passes them on to the rays of
others. Both are in the covariance of the residuals: with residuals y = A dx + J p + e (points,
station errors in units of their sigmas, pixels in units of theirs), Q the projection that takes the
points out, residuals Q y have the covariance Q (I + J J') Q. The likelihood is the normal one of y
with p integrated over and the points at their best; its quadratic form needs a sparse factorisation
of I + J'Q J (the reduced normal equations, by which a bundle adjustment would step).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from unbend.block.image_rays import (
    MINIMUM_ANGLE_RAD,
    ImageRays,
    Orientations,
    SortedRays,
    axes_across,
    sorted_rays,
)
from unbend.block.linear_system import (
    ReducedSystem,
    block_matrix,
    heights_and_verticals,
    linearised,
    with_ridge,
)
from unbend.geodesy import geodetic_of_ecef
from unbend.units import Array, Integers, Mask

LOG_BAD = np.log(0.02)  # one tie point in fifty is bad ...
WIDTH_OF_BAD_RAD = 0.5  # ... and anywhere within half a radian
NEAREST_SIGMAS = 3.0  # of a station's place: no point is nearer
MAX_SEARCHES = 3  # for bad rays: without one, others stand out
MIN_SHARE_LEFT = 1e-9  # of a change: less than this beside others is what those do already


@dataclass(frozen=True, eq=False)
class Intersection:
    """Intersected points (p,) and the residuals of their rays (r,), in the order they came.

    ``position_m`` (p, 3) earth-centred, NaN where ``used`` is False: fewer than two good rays with
    a station, all within the minimum angle, or behind a camera. ``residual_rad`` (r, 2) measured
    minus intersected along the image's x and y; ``bad`` (r,) rays that contradict the others of
    their point by more than any station error can. ``chi_square`` has ``redundancy`` degrees of
    freedom; ``log_likelihood`` is natural, up to a constant of the rays given, with a common factor
    of all sigmas at its best (at least 1): too small sigmas do not make it too certain. Rays that
    meet exactly are more likely by ``misfit``.
    """

    orientations: Orientations
    point: Integers
    position_m: Array
    angle_rad: Array
    used: Mask
    residual_rad: Array
    bad: Mask
    chi_square: float
    redundancy: int
    log_likelihood: float
    misfit: float
    system: ReducedSystem

    @property
    def sigma_factor(self) -> float:
        """Square root of chi-square over redundancy: 1 where the sigmas are right."""
        if self.redundancy == 0:
            return np.nan
        return float(np.sqrt(self.chi_square / self.redundancy))

    @property
    def most_bad(self) -> float:
        """Share of the bad rays of the camera with most."""
        camera_of_ray = self.orientations.camera[self.system.image].astype(str)
        _, camera = np.unique(camera_of_ray, return_inverse=True)
        bad_rays = np.bincount(camera, self.bad[self.system.order])
        return float(np.max(bad_rays / np.bincount(camera)))

    @property
    def geodetic(self) -> tuple[Array, Array, Array]:
        """(p,) latitude, longitude [rad] and ellipsoidal height [m] of the points."""
        return geodetic_of_ecef(*self.position_m.T)

    @property
    def flying_height_m(self) -> float:
        """Median height of the stations above the points [m]; mirrored rays meet above them."""
        if not self.used.any():
            return np.inf
        middle_m = self.position_m[self.used].mean(axis=0)
        line = self.orientations.centre_m - middle_m
        up = self.orientations.enu_from_ecef[:, 2]
        height = np.sum(line * up, axis=1)
        return float(np.nanmedian(height))

    @cached_property
    def sigma_height_m(self) -> Array:
        """(p,) what the sigmas of stations and pixels predict for the heights of the points."""
        _, up = heights_and_verticals(self.position_m)
        up = np.nan_to_num(up)
        # half_inverse is L^-1 of a point's normal equations N = L L': (L^-1 up)^2 = up' N^-1 up.
        step = np.einsum("pij,pj->pi", self.system.half_inverse, up)
        points = self.point.size
        step_of_points = block_matrix(step[:, None, :], np.arange(points), points)
        # Z carries errors of the stations to the points, in units of L^-1.
        by_stations = step_of_points @ self.system.Z
        squares = by_stations.multiply(by_stations)
        station_variance = np.asarray(squares.sum(1))[:, 0]
        variance = np.sum(step**2, axis=1) + station_variance
        return np.where(self.used, np.sqrt(variance), np.nan)

    def shared_errors(self, change: Array) -> tuple[Array, Array]:
        """Least-squares errors (k,) that many stations share, and their covariance (k, k).

        ``change`` (s, 6, k) is what a unit of each does to a station, by the axes of
        `Orientations.sigma`; the single errors of the stations are beside them. The covariance is
        that of the sigmas stated; of what nothing shows both are zero.
        """
        scaled = self.in_sigmas(change)
        free = scaled - self.system.factor.solve(scaled)
        normal = scaled.T @ free
        covariance = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        right = scaled.T @ self.system.errors
        return covariance @ right, covariance

    def likely_amounts(self, changes: Array, beside: Array) -> tuple[Array, Array]:
        """What the log likelihood gains (k,) by each change alone, and its amount: least squares.

        ``changes`` (r, 2, k) [rad] is what a unit of each adds to `misses`; ``beside`` (s, 6, b)
        are errors that stations share (`shared_errors`), estimated with each. Linear.
        """
        system = self.system
        count = changes.shape[2]
        of_shared = system.J @ self.in_sigmas(beside)
        design = np.concatenate([self.of_changes(changes), of_shared], axis=1)
        # Normal equations with the points and the single errors of stations taken out.
        free = design - system.Y @ (system.Y.T @ design)
        by_stations = system.J.T @ free
        normal = design.T @ free - by_stations.T @ system.factor.solve(by_stations)
        right = design.T @ system.residual - by_stations.T @ system.errors

        # Each change alone, with the shared errors taken out as well.
        cross = normal[:count, count:]
        shared_covariance = np.linalg.pinv(normal[count:, count:], hermitian=True)
        to_shared = cross @ shared_covariance
        whole = np.diag(normal)[:count]
        square = whole - np.sum(to_shared * cross, axis=1)
        square = np.where(square > MIN_SHARE_LEFT * whole, square, np.inf)
        right = right[:count] - to_shared @ right[count:]
        return self.gain_of(right**2 / square), -right / square

    def of_changes(self, changes: Array) -> Array:
        """Changes (r, 2, k) [rad] of misses in the rows of the system, in sigmas."""
        system = self.system
        count = changes.shape[2]
        in_sigmas = changes[system.order] / system.sigma[:, None, None]
        of_rays = in_sigmas.reshape(2 * system.order.size, count)
        heights = system.Y.shape[0] - of_rays.shape[0]
        of_heights = np.zeros((heights, count))
        return np.concatenate([of_rays, of_heights])

    def in_sigmas(self, change: Array) -> Array:
        """Changes (s, 6, k) of stations as columns (6 s, k), in units of their sigmas."""
        in_sigmas = change / self.orientations.sigma[:, :, None]
        return np.asarray(in_sigmas.reshape(self.orientations.sigma.size, change.shape[2]))

    def gain_of(self, decrease: Array) -> Array:
        """What the log likelihood gains where chi-square decreases by a little."""
        factor = np.fmax(1.0, self.sigma_factor)
        return np.asarray(0.5 * decrease / factor**2)

    def misses(self, orientations: Orientations, rays: ImageRays) -> Array:
        """(r, 2) what its points are missed by under other orientations or rays [rad]; 0 of bad."""
        good = np.isfinite(self.residual_rad[:, 0])
        row = np.searchsorted(self.point, rays.point)
        line = self.position_m[row] - orientations.centre_m[rays.image]
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        camera_from_ecef = orientations.camera_from_ecef[rays.image]
        in_camera = np.einsum("rij,rj->ri", camera_from_ecef, line)
        miss = -np.einsum("rij,rj->ri", axes_across(rays.direction), in_camera)
        return np.where(good[:, None], miss, 0.0)

    def camera_rotation(self, camera: str) -> tuple[Array, Array]:
        """By what rotation vector [rad] a camera would have to be turned (`Orientations.turned`).

        In its own frame (3,), for the residuals to be least, with the covariance (3, 3).
        """
        return self.shared_errors(self.orientations.turns_of(camera))


@dataclass(frozen=True, eq=False)
class PointFit:
    """Points at the best positions for some good rays, and the system there.

    ``good`` (r,) leaves out the rays of points that are not fitted; ``count`` (p,) are the others.
    """

    position: Array  # (p, 3) from the origin of the sorted rays
    angle: Array  # (p,) largest between two rays [rad]
    good: Mask
    count: Integers
    system: ReducedSystem


def intersect(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> Intersection:
    """Intersect the rays of each point with the stations held, and judge their residuals.

    All that changes the rays or the stations is a hypothesis whose ``log_likelihood`` may be
    compared with others of the same rays: another assignment (`Orientations.assigned`), mount
    (`turned`), focal length or time offset. Rays of images without orientation count as bad ones.
    Linear in the errors of stations. What the second order of an attitude's error makes, about the
    square of its sigma [rad], is added in quadrature to the sigma of a ray; it matters from about a
    degree.
    """
    by_point = sorted_rays(orientations, rays)
    bad = np.zeros(by_point.sigma.shape, np.bool_)
    contradicted_points = 0  # in all rounds
    fit = fitted_points(by_point, orientations, by_point.oriented, minimum_angle_rad)
    for _ in range(MAX_SEARCHES):
        contradicting = contradicting_rays(by_point, fit)
        if not np.any(contradicting):
            break
        contradicted_points += int(np.sum(by_point.sums(contradicting * 1) > 0))
        bad |= contradicting
        fit = fitted_points(by_point, orientations, by_point.oriented & ~bad, minimum_angle_rad)

    system = fit.system
    has_height = np.isfinite(by_point.height)
    redundancy = redundancy_of(fit.count, has_height)
    chi_square = float(system.remaining @ system.remaining + system.errors @ system.errors)
    misfit = misfit_of(chi_square, redundancy)
    given = by_point.sums(np.ones(by_point.sigma.size, np.int64))
    lost = redundancy_of(given, has_height) - redundancy
    misfit += lost * log_width_of_bad(by_point) - contradicted_points * LOG_BAD
    as_given = np.argsort(by_point.order)
    used = fit.count >= 2
    return Intersection(
        orientations=orientations,
        point=np.unique(rays.point),
        position_m=np.where(used[:, None], fit.position + by_point.origin, np.nan),
        angle_rad=fit.angle,
        used=used,
        residual_rad=np.where(fit.good[:, None], system.residual_rad, np.nan)[as_given],
        bad=bad[as_given],
        chi_square=chi_square,
        redundancy=redundancy,
        log_likelihood=float(-misfit - 0.5 * log_determinant_of_images(system)),
        misfit=float(misfit),
        system=system,
    )


def redundancy_of(count: Integers, has_height: Mask) -> int:
    """Degrees of freedom of points with a number of rays (p,), of which two determine one."""
    of_points = 2 * count - 3 + has_height
    return int(np.sum(of_points[count >= 2]))


def misfit_of(chi_square: float, redundancy: int) -> float:
    """By how much exact rays are more likely; all sigmas may have a factor of 1 or more."""
    factor_squared = max(1.0, chi_square / max(1, redundancy))
    excess = redundancy * np.log(factor_squared)
    return float(0.5 * (min(chi_square, redundancy) + excess))


def log_determinant_of_images(system: ReducedSystem) -> float:
    """Sum over the images of log det (I + J'J), each by itself."""
    blocks = system.JJ.tobsr((6, 6)).data
    _, log_determinant = np.linalg.slogdet(blocks + np.eye(6))
    return float(log_determinant.sum())


def fitted_points(
    by_point: SortedRays, orientations: Orientations, good: Mask, minimum_angle_rad: float
) -> PointFit:
    """Points where good rays meet best.

    Not of rays that are all within the minimum angle, nor of those that meet behind a camera or
    nearer to it than its place is known.
    """
    position = by_point.positions(good)
    angle = by_point.angles(good)
    line = position[by_point.index] - by_point.centre
    ahead = np.sum(line * by_point.direction, axis=1)
    too_near = ahead <= NEAREST_SIGMAS * orientations.sigma[by_point.image, 0]
    meet = (angle >= minimum_angle_rad) & (by_point.sums(good & too_near) == 0)
    meet &= by_point.sums(good * 1) >= 2
    good = good & meet[by_point.index]
    return PointFit(
        position=position,
        angle=angle,
        good=good,
        count=by_point.sums(good * 1),
        system=linearised(by_point, orientations, position, good),
    )


def contradicting_rays(by_point: SortedRays, fit: PointFit) -> Mask:
    """(r,) of each point the ray that contradicts the others most, if it is a bad one.

    It is, if chi-square loses more without it than a bad one is improbable by; of two rays both
    are.
    """
    of_point = by_point.index
    remaining = fit.system.of_rays(fit.system.remaining)
    square_of_point = by_point.sums(np.sum(remaining**2, axis=1))
    enough = fit.count >= 2
    freedom = np.maximum(2 * fit.count - 3, 1)
    over_median = square_of_point[enough] / chdtri(freedom[enough], 0.5)
    usual = 1.0
    if over_median.size:
        usual = max(usual, float(np.median(over_median)))

    half = fit.system.Y.data[: 6 * by_point.sigma.size].reshape(-1, 2, 3)
    free = (1.0 + 1e-9) * np.eye(2) - half @ np.swapaxes(half, 1, 2)
    without_ray = np.linalg.solve(free, remaining[..., None])[..., 0]
    loss = np.sum(remaining * without_ray, axis=1)
    has_others = fit.count > 2
    loss = np.where(has_others[of_point], loss, square_of_point[of_point]) / usual
    freedom_lost = np.where(has_others, 2, 1)[of_point]
    price = 2.0 * (freedom_lost * log_width_of_bad(by_point) - LOG_BAD)
    largest_of_point = np.maximum.reduceat(loss, by_point.start)[of_point]
    return np.asarray(fit.good & (loss > price) & (loss == largest_of_point), np.bool_)


def log_width_of_bad(by_point: SortedRays) -> float:
    """How much wider than its sigma a bad ray may lie, as a natural logarithm."""
    if by_point.sigma.size == 0:
        return 0.0
    usual_sigma = np.median(by_point.sigma)
    return float(np.log(WIDTH_OF_BAD_RAD / usual_sigma))


LARGEST_MISS = 6.0
"""A point has no height whose rays miss it by more than this many times what their sigmas say."""


@dataclass(frozen=True, eq=False)
class PointHeights:
    """Heights of points above the ellipsoid [m] and their standard deviations, (p,) each.

    NaN where ``few`` (fewer than two rays with a station), ``narrow`` (all within the minimum
    angle, or behind a camera) or ``apart`` (the rays miss each other) says why. ``index`` (r,) is
    the point of each ray in the order they came; ``position_m`` (p, 3) is earth-centred.
    """

    h_m: Array
    sigma_m: Array
    position_m: Array
    index: Integers
    few: Mask
    narrow: Mask
    apart: Mask


def point_heights(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> PointHeights:
    """The heights at which the rays of each point meet best.

    Least squares under the covariance that the sigmas of pixels and stations give each ray, each of
    another image. ``sigma_m`` is what these sigmas give the height, enlarged where the rays miss by
    more than they say. The time goes with the number of rays.
    """
    by_point = sorted_rays(orientations, rays)
    good = by_point.oriented
    count = by_point.sums(good * 1)
    best = points_with_stations(by_point, orientations, good)
    position_m = best.position + by_point.origin
    h_m, up = heights_and_verticals(position_m)
    factor = np.sqrt(best.chi_square / np.maximum(2 * count - 3, 1))
    few = count < 2
    is_narrow = by_point.angles(good) < minimum_angle_rad
    narrow = ~few & (is_narrow | meet_behind(by_point, best.position, good))
    apart = ~few & ~narrow & (factor > LARGEST_MISS)
    unknown = few | narrow | apart
    sigma_m = np.sqrt(best.variance_along(up)) * np.maximum(1.0, factor)
    return PointHeights(
        h_m=np.where(unknown, np.nan, h_m),
        sigma_m=np.where(unknown, np.nan, sigma_m),
        position_m=np.where(unknown[:, None], np.nan, position_m),
        index=np.searchsorted(np.unique(rays.point), rays.point),
        few=few,
        narrow=narrow,
        apart=apart,
    )


def meet_behind(by_point: SortedRays, position: Array, good: Mask) -> Mask:
    """(p,) points behind the camera of a good ray."""
    line = position[by_point.index] - by_point.centre
    is_behind = np.sum(line * by_point.direction, axis=1) <= 0.0
    return np.asarray(by_point.sums(good & is_behind) > 0, np.bool_)


@dataclass(frozen=True, eq=False)
class WeightedPoints:
    """Points (p,) by rays weighted with the errors of pixels and stations together."""

    position: Array  # (p, 3) from the origin of the sorted rays
    normal: Array  # (p, 3, 3) inverse covariance
    chi_square: Array

    def variance_along(self, axis: Array) -> Array:
        """(p,) variances along unit vectors (p, 3)."""
        spread = np.linalg.solve(self.normal, axis[..., None])[..., 0]
        variance = np.sum(axis * spread, axis=1)
        return np.asarray(variance, np.float64)


def points_with_stations(
    by_point: SortedRays, orientations: Orientations, good: Mask
) -> WeightedPoints:
    """One step of least squares from the positions that pixels alone give."""
    position = by_point.positions(good)
    misses = by_point.misses(orientations, position, good)
    A = misses.point_derivatives
    J = misses.station_derivatives
    covariance = np.eye(2) + J @ np.swapaxes(J, 1, 2)
    weight = np.linalg.inv(covariance)
    A_weighted = np.swapaxes(A, 1, 2) @ weight
    normal = with_ridge(by_point.sums(A_weighted @ A))
    right = by_point.sums(A_weighted @ misses.miss[..., None])
    step = np.linalg.solve(normal, right)[..., 0]
    by_step = np.einsum("rij,rj->ri", A, step[by_point.index])
    miss = misses.miss - by_step
    square_of_rays = np.einsum("ri,rij,rj->r", miss, weight, miss)
    chi_square = by_point.sums(square_of_rays)
    return WeightedPoints(position=position + step, normal=normal, chi_square=chi_square)
