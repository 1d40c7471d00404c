"""Points from the rays of several images with fixed stations, and a test of the residuals.

How to use it::

    stations = orientations_of(stations_of_the_flight)         # or Orientations(...) directly
    rays = ImageRays(image, point, direction, sigma_rad)            # straight, corrected rays
    stated = intersect(stations, rays)
    stated.log_likelihood, stated.sigma_factor, stated.camera_rotation("nadir")
    other = intersect(stations.assigned(event_of_image), rays)  # a hypothesis
    stated.log_likelihood - other.log_likelihood               # logarithm of the likelihood ratio

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

LOG_BAD = np.log(0.02)  # prior: one tie point in fifty is bad ...
WIDTH_OF_BAD_RAD = 0.5  # ... and its ray is anywhere within half a radian
NEAREST_SIGMAS = 3.0  # sigmas of a station's position: no point is nearer to the station
MAX_SEARCHES = 3  # for bad rays: without one of them, others stand out
MIN_SHARE_LEFT = 1e-9  # of a change that shared errors do not explain: less is rounding


@dataclass(frozen=True, eq=False)
class Intersection:
    """Intersected points (p,) and the residuals of their rays (r,), in the order of `ImageRays`.

    A point is ``used`` if it has two good rays with a station, not all within the minimum angle,
    and is in front of the cameras. ``log_likelihood`` is a natural logarithm, up to a constant of
    the given rays. All sigmas are multiplied by the factor of at least 1 that makes it largest: so
    sigmas that are too small do not make it too certain.
    """

    orientations: Orientations
    point: Integers  # (p,) numbers of the points, ascending
    position_m: Array  # (p, 3) earth-centred, NaN for points that are not used
    angle_rad: Array  # (p,) largest angle between two rays
    used: Mask  # (p,)
    residual_rad: Array  # (r, 2) measured minus intersected along the image's x and y, or NaN
    bad: Mask  # (r,) rays that contradict the others of their point more than station errors can
    chi_square: float
    redundancy: int  # degrees of freedom of ``chi_square``
    log_likelihood: float
    misfit: float  # log likelihood of rays that meet exactly, minus that of these rays
    system: ReducedSystem

    @property
    def sigma_factor(self) -> float:
        """Square root of chi-square over redundancy: about 1 if the sigmas are right, or NaN."""
        if self.redundancy == 0:
            return np.nan
        return float(np.sqrt(self.chi_square / self.redundancy))

    @property
    def largest_bad_share(self) -> float:
        """Share of bad rays among the rays of a camera: the largest of all cameras."""
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
        """Median height of the stations above the mean of the used points [m].

        Negative if mirrored rays meet above the stations; infinite without points.
        """
        if not self.used.any():
            return np.inf
        middle_m = self.position_m[self.used].mean(axis=0)
        line = self.orientations.centre_m - middle_m
        up = self.orientations.enu_from_ecef[:, 2]
        height = np.sum(line * up, axis=1)
        return float(np.nanmedian(height))

    @cached_property
    def sigma_height_m(self) -> Array:
        """(p,) sigma of the height of each point [m], from the sigmas of stations and pixels.

        NaN for points that are not used.
        """
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
        """Estimates (k,) of errors that many stations share, and their covariance (k, k).

        ``change`` (s, 6, k) is the change of each station by a unit of each error, along the axes
        of `Orientations.sigma`. The errors are fitted by least squares together with the errors of
        each station. The covariance follows from the stated sigmas; estimate and covariance are
        zero for an error that no ray shows.
        """
        scaled = self.station_changes_in_sigmas(change)
        free = scaled - self.system.factor.solve(scaled)
        normal = scaled.T @ free
        covariance = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        right = scaled.T @ self.system.errors
        return covariance @ right, covariance

    def likely_amounts(self, changes: Array, shared: Array) -> tuple[Array, Array]:
        """Gain of the log likelihood (k,) by each of k changes alone, and its best amount (k,).

        Linear least squares. ``changes`` (r, 2, k) [rad] is what a unit of each adds to `misses`.
        ``shared`` (s, 6, b) are errors that stations share, as in `shared_errors`; they are
        estimated together with each change.
        """
        system = self.system
        count = changes.shape[2]
        of_shared = system.J @ self.station_changes_in_sigmas(shared)
        design = np.concatenate([self.ray_changes_in_sigmas(changes), of_shared], axis=1)
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

    def ray_changes_in_sigmas(self, changes: Array) -> Array:
        """Changes (r, 2, k) [rad] of misses, divided by sigmas, in the rows of the system.

        The rows of given heights have zeros.
        """
        system = self.system
        count = changes.shape[2]
        in_sigmas = changes[system.order] / system.sigma[:, None, None]
        of_rays = in_sigmas.reshape(2 * system.order.size, count)
        heights = system.Y.shape[0] - of_rays.shape[0]
        of_heights = np.zeros((heights, count))
        return np.concatenate([of_rays, of_heights])

    def station_changes_in_sigmas(self, change: Array) -> Array:
        """Changes (s, 6, k) of stations divided by their sigmas, as columns (6 s, k)."""
        in_sigmas = change / self.orientations.sigma[:, :, None]
        return np.asarray(in_sigmas.reshape(self.orientations.sigma.size, change.shape[2]))

    def gain_of(self, decrease: Array) -> Array:
        """Gain of the log likelihood if chi-square decreases by a small amount."""
        factor = np.fmax(1.0, self.sigma_factor)
        return np.asarray(0.5 * decrease / factor**2)

    def misses(self, orientations: Orientations, rays: ImageRays) -> Array:
        """(r, 2) misses [rad] of these points under other orientations and rays.

        A miss is ray minus direction to the point, along the image's x and y. ``rays`` are the same
        image points in the same order, for example with another camera. 0 for rays without a
        residual: bad ones, and those of points that are not used.
        """
        good = np.isfinite(self.residual_rad[:, 0])
        row = np.searchsorted(self.point, rays.point)
        line = self.position_m[row] - orientations.centre_m[rays.image]
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        camera_from_ecef = orientations.camera_from_ecef[rays.image]
        in_camera = np.einsum("rij,rj->ri", camera_from_ecef, line)
        miss = -np.einsum("rij,rj->ri", axes_across(rays.direction), in_camera)
        return np.where(good[:, None], miss, 0.0)

    def camera_rotation(self, camera: str) -> tuple[Array, Array]:
        """The rotation vector (3,) [rad] of a camera that makes the residuals least.

        In the frame of the camera, as `Orientations.turned` takes it; with its covariance (3, 3).
        """
        return self.shared_errors(self.orientations.turns_of(camera))


@dataclass(frozen=True, eq=False)
class PointFit:
    """Points at their best positions for the good rays, and the linear system there."""

    position: Array  # (p, 3) minus the origin of the sorted rays [m]
    angle: Array  # (p,) largest between two rays [rad]
    good: Mask  # (r,) good rays of points that are fitted, in the order of the sorted rays
    count: Integers  # (p,) number of these rays: 0 for a point that is not fitted
    system: ReducedSystem


def intersect(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> Intersection:
    """Intersect the rays of each point with fixed stations, and test their residuals.

    Two hypotheses about the same image points may be compared by ``log_likelihood``: another
    assignment (`Orientations.assigned`), mount (`Orientations.turned`), focal length or time
    offset. Rays of images without orientation count as bad ones. Linear in the errors of stations;
    the second order of an attitude's error, about the square of its sigma [rad], is added in
    quadrature to the sigma of a ray, and matters from about a degree.
    """
    by_point = sorted_rays(orientations, rays)
    bad = np.zeros(by_point.sigma.shape, np.bool_)
    contradicted_points = 0  # sum over all searches
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
    given_count = by_point.sums(np.ones(by_point.sigma.size, np.int64))
    lost = redundancy_of(given_count, has_height) - redundancy
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
    """Degrees of freedom of points with ``count`` (p,) rays; 0 for points with fewer than two.

    A ray gives two equations, a given height one; a point has three unknowns.
    """
    of_points = 2 * count - 3 + has_height
    return int(np.sum(of_points[count >= 2]))


def misfit_of(chi_square: float, redundancy: int) -> float:
    """Log likelihood of rays that meet exactly, minus that of rays with this chi-square.

    For the latter all sigmas have the likeliest common factor of at least 1.
    """
    factor_squared = max(1.0, chi_square / max(1, redundancy))
    excess = redundancy * np.log(factor_squared)
    return float(0.5 * (min(chi_square, redundancy) + excess))


def log_determinant_of_images(system: ReducedSystem) -> float:
    """Sum over the images of log det (I + J'J), with the 6 x 6 block of each image."""
    blocks = system.JJ.tobsr((6, 6)).data
    _, log_determinant = np.linalg.slogdet(blocks + np.eye(6))
    return float(log_determinant.sum())


def fitted_points(
    by_point: SortedRays, orientations: Orientations, good: Mask, minimum_angle_rad: float
) -> PointFit:
    """Fit each point to its good rays.

    Not fitted are points with fewer than two good rays, with all of them within the minimum angle,
    behind a camera, or nearer to a station than `NEAREST_SIGMAS` of its position.
    """
    position = by_point.positions(good)
    angle = by_point.angles(good)
    line = position[by_point.index] - by_point.centre
    ahead = np.sum(line * by_point.direction, axis=1)
    too_near = ahead <= NEAREST_SIGMAS * orientations.sigma[by_point.image, 0]
    is_fitted = (angle >= minimum_angle_rad) & (by_point.sums(good & too_near) == 0)
    is_fitted &= by_point.sums(good * 1) >= 2
    good = good & is_fitted[by_point.index]
    return PointFit(
        position=position,
        angle=angle,
        good=good,
        count=by_point.sums(good * 1),
        system=linearised(by_point, orientations, position, good),
    )


def contradicting_rays(by_point: SortedRays, fit: PointFit) -> Mask:
    """(r,) the ray of each point that contradicts the others most, if it is a bad one.

    It is bad if chi-square decreases without it by more than the price of a bad ray (`LOG_BAD`,
    `WIDTH_OF_BAD_RAD`). Decreases are divided by the usual chi-square of a point over its expected
    median, if that is above 1. Of a point with two rays both are bad, or none.
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
    free = (1.0 + 1e-9) * np.eye(2) - half @ np.swapaxes(half, 1, 2)  # 1e-9: never singular
    without_ray = np.linalg.solve(free, remaining[..., None])[..., 0]
    loss = np.sum(remaining * without_ray, axis=1)  # of chi-square without the ray
    has_others = fit.count > 2
    loss = np.where(has_others[of_point], loss, square_of_point[of_point]) / usual
    freedom_lost = np.where(has_others, 2, 1)[of_point]
    price = 2.0 * (freedom_lost * log_width_of_bad(by_point) - LOG_BAD)
    largest_of_point = np.maximum.reduceat(loss, by_point.start)[of_point]
    return np.asarray(fit.good & (loss > price) & (loss == largest_of_point), np.bool_)


def log_width_of_bad(by_point: SortedRays) -> float:
    """Logarithm of the width of bad rays over the median sigma of the rays."""
    if by_point.sigma.size == 0:
        return 0.0
    usual_sigma = np.median(by_point.sigma)
    return float(np.log(WIDTH_OF_BAD_RAD / usual_sigma))


LARGEST_MISS = 6.0
"""A point has no height if its rays miss it by more than so many sigmas (root mean square)."""


@dataclass(frozen=True, eq=False)
class PointHeights:
    """Heights of points above the ellipsoid; NaN for points that are few, narrow or apart."""

    h_m: Array  # (p,)
    sigma_m: Array  # (p,) standard deviations of ``h_m``
    position_m: Array  # (p, 3) earth-centred
    index: Integers  # (r,) row of the point of each ray, in the order of `ImageRays`
    few: Mask  # (p,) fewer than two rays with a station
    narrow: Mask  # (p,) all rays within the minimum angle, or the point behind a camera
    apart: Mask  # (p,) the rays miss the point by more than `LARGEST_MISS`


def point_heights(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> PointHeights:
    """The heights at which the rays of each point meet best.

    Least squares with the covariance of each ray that follows from the sigmas of pixel and station;
    the rays of a point are taken as independent. ``sigma_m`` follows from these sigmas, and is
    enlarged if the rays miss by more. The time grows with the number of rays.
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
    """(p,) whether a point is behind the camera of a good ray."""
    line = position[by_point.index] - by_point.centre
    is_behind = np.sum(line * by_point.direction, axis=1) <= 0.0
    return np.asarray(by_point.sums(good & is_behind) > 0, np.bool_)


@dataclass(frozen=True, eq=False)
class WeightedPoints:
    """Points (p,) by rays weighted with the errors of pixels and stations together."""

    position: Array  # (p, 3) minus the origin of the sorted rays [m]
    normal: Array  # (p, 3, 3) inverse covariance [1/m^2]
    chi_square: Array  # (p,)

    def variance_along(self, axis: Array) -> Array:
        """(p,) variances [m^2] of the points along unit vectors (p, 3)."""
        spread = np.linalg.solve(self.normal, axis[..., None])[..., 0]
        variance = np.sum(axis * spread, axis=1)
        return np.asarray(variance, np.float64)


def points_with_stations(
    by_point: SortedRays, orientations: Orientations, good: Mask
) -> WeightedPoints:
    """Points by one step of least squares, from the positions without errors of stations."""
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
