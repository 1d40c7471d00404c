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
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.special import chdtri

from unbend.block.image_rays import (
    MINIMUM_ANGLE_RAD,
    ImageRays,
    Orientations,
    SortedRays,
    axes_across,
    sorted_rays,
)
from unbend.geodesy import enu_from_ecef, geodetic_of_ecef
from unbend.units import Array, Integers, Mask

# A bad tie point is anywhere within half a radian, and one in fifty is bad.
_LOG_BAD, _WIDTH_OF_BAD_RAD = np.log(0.02), 0.5
_NEAREST_SIGMAS = 3.0
_ROUNDS = 4  # of finding bad ones
_identity = lru_cache(1)(partial(sparse.identity, format="csr"))  # as large as the last one


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
    system: _System

    @property
    def sigma_factor(self) -> float:
        """Square root of chi-square over redundancy: 1 where the sigmas are right."""
        return float(np.sqrt(self.chi_square / self.redundancy)) if self.redundancy else np.nan

    @property
    def most_bad(self) -> float:
        """Share of the bad rays of the camera with most."""
        camera = self.orientations.camera[self.system.image].astype(str)
        _, of = np.unique(camera, return_inverse=True)
        return float(np.max(np.bincount(of, self.bad[self.system.order]) / np.bincount(of)))

    @property
    def geodetic(self) -> tuple[Array, Array, Array]:
        """(p,) latitude, longitude [rad] and ellipsoidal height [m] of the points."""
        return geodetic_of_ecef(*self.position_m.T)

    @cached_property
    def sigma_height_m(self) -> Array:
        """(p,) what the sigmas of stations and pixels predict for the heights of the points."""
        system = self.system
        up = enu_from_ecef(*self.geodetic[:2])[:, 2]
        step = np.einsum("pij,pj->pi", system.half_inverse, np.nan_to_num(up))
        along = _blocks(step[:, None, :], np.arange(self.point.size), self.point.size)
        by_stations = along @ system.Z
        variance = np.asarray(by_stations.multiply(by_stations).sum(1))[:, 0]
        variance = np.sum(step**2, axis=1) + variance
        return np.where(self.used, np.sqrt(variance), np.nan)

    def shared_errors(self, change: Array) -> tuple[Array, Array]:
        """Least-squares errors (k,) that many stations share, and their covariance (k, k).

        ``change`` (s, 6, k) is what a unit of each does to a station, by the axes of
        `Orientations.sigma`; the single errors of the stations are beside them. The covariance is
        that of the sigmas stated; of what nothing shows both are zero.
        """
        scaled = (change / self.orientations.sigma[:, :, None]).reshape(-1, change.shape[2])
        normal = scaled.T @ (scaled - self.system.factor.solve(scaled))
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        return inverse @ (scaled.T @ self.system.errors), inverse

    def likely_amounts(self, changes: Array, beside: Array) -> tuple[Array, Array]:
        """What the log likelihood gains (k,) by each change alone, and its amount: least squares.

        ``changes`` (r, 2, k) [rad] is what a unit of each adds to `misses`; ``beside`` (s, 6, b)
        are errors that stations share (`shared_errors`), estimated with each. Linear.
        """
        s, count = self.system, changes.shape[2]
        scaled = (beside / self.orientations.sigma[:, :, None]).reshape(s.J.shape[1], -1)
        own = (changes[s.order] / s.sigma[:, None, None]).reshape(2 * s.order.size, count)
        heights = np.zeros((s.Y.shape[0] - own.shape[0], count))
        D = np.concatenate([np.concatenate([own, heights]), s.J @ scaled], axis=1)
        free = D - s.Y @ (s.Y.T @ D)
        shared = s.J.T @ free
        normal = D.T @ free - shared.T @ s.factor.solve(shared)
        right = D.T @ s.residual - shared.T @ s.errors
        cross = normal[:count, count:]
        of_beside = cross @ np.linalg.pinv(normal[count:, count:], hermitian=True)
        whole = np.diag(normal)[:count]
        square = whole - np.sum(of_beside * cross, axis=1)
        right = right[:count] - of_beside @ right[count:]
        square = np.where(square > 1e-9 * whole, square, np.inf)
        return self.gain_of(right**2 / square), -right / square

    def gain_of(self, decrease: Array) -> Array:
        """What the log likelihood gains where chi-square decreases by a little."""
        return np.asarray(0.5 * decrease / np.fmax(1.0, self.sigma_factor) ** 2)

    def misses(self, o: Orientations, rays: ImageRays) -> Array:
        """(r, 2) what its points are missed by under other orientations or rays [rad]; 0 of bad."""
        good = np.isfinite(self.residual_rad[:, 0])
        line = self.position_m[np.searchsorted(self.point, rays.point)] - o.centre_m[rays.image]
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        seen = np.einsum("rij,rj->ri", o.camera_from_ecef[rays.image], line)
        across = axes_across(rays.direction)
        return np.where(good[:, None], -np.einsum("rij,rj->ri", across, seen), 0.0)

    def camera_rotation(self, camera: str) -> tuple[Array, Array]:
        """By what rotation vector [rad] a camera would have to be turned (`Orientations.turned`).

        In its own frame (3,), for the residuals to be least, with the covariance (3, 3).
        """
        return self.shared_errors(self.orientations.turns_of(camera))


@dataclass(frozen=True, eq=False)
class _System:
    """The residuals and their derivatives in units of the pixels' sigmas, rays sorted by point.

    Rows are two for each ray, then one for each point's given height.
    """

    order: Integers  # (r,) where the sorted rays stood
    image: Integers  # (r,)
    sigma: Array  # (r,) of the sorted rays [rad]
    half_inverse: Array  # (p, 3, 3) L^-1 of the points' normal equations L L'
    Y: sparse.csr_matrix  # A L'^-1: Q = I - Y Y'
    J: sparse.csr_matrix  # by the stations' errors in units of their sigmas
    JJ: sparse.csr_matrix  # J'J
    Z: sparse.csr_matrix  # Y'J
    M: sparse.csr_matrix  # J'QJ
    residual: Array  # Q y
    factor: Any  # of I + M
    errors: Array  # of the stations at their most probable, in units of their sigmas


def _blocks(values: Array, column: Integers, columns: int, empty: int = 0) -> sparse.csr_matrix:
    """Sparse matrix of blocks (n, rows, width), one in each row of blocks, above empty rows."""
    count, rows, width = values.shape
    indices = np.repeat(column[:, None] * width + np.arange(width), rows, axis=0)
    start = np.minimum(np.arange(count * rows + empty + 1), count * rows) * width
    return sparse.csr_matrix(
        (values.ravel(), indices.ravel(), start), shape=(count * rows + empty, columns * width)
    )


def linearised(r: SortedRays, o: Orientations, position: Array, good: Mask) -> _System:
    """The system at some positions, of the good rays."""
    points = r.start.size
    sigma, A, J_rays, y = r.derivatives(o, position, good)
    lat, lon, h = geodetic_of_ecef(*(position + r.origin).T)
    known = np.isfinite(r.height) & (r.sums(good * 1) >= 2)
    up = np.where(known[:, None], enu_from_ecef(lat, lon)[:, 2] / r.sigma_height, 0.0)
    above = np.where(known, (r.height - h) / r.sigma_height, 0.0)
    normal = r.sums(np.swapaxes(A, 1, 2) @ A) + up[:, :, None] * up[:, None, :]
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += (1e-12 * trace + (trace == 0.0))[:, None, None] * np.eye(3)
    half_inverse = np.linalg.inv(np.linalg.cholesky(normal))
    half = np.swapaxes(half_inverse, 1, 2)
    rows = [(A @ half[r.index]).reshape(-1, 1, 3), up[:, None, :] @ half]
    Y = _blocks(np.concatenate(rows), np.append(np.repeat(r.index, 2), np.arange(points)), points)
    J = _blocks(J_rays, r.image, o.camera.size, empty=points)
    y = np.append(y.ravel(), above)
    Y_t, J_t = Y.T.tocsr(), J.T.tocsr()  # matrices of one format are not converted again
    Z, JJ = Y_t @ J, J_t @ J
    M = JJ - Z.T.tocsr() @ Z
    residual = y - Y @ (Y_t @ y)
    factor = splu((_identity(M.shape[0]) + M).tocsc(), permc_spec="MMD_AT_PLUS_A",
                  diag_pivot_thresh=0.0, options={"SymmetricMode": True})  # fmt: skip
    errors = factor.solve(J_t @ residual)
    return _System(r.order, r.image, sigma, half_inverse, Y, J, JJ, Z, M, residual, factor, errors)


def intersect(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> Intersection:
    """Intersect the rays of each point with the stations held, and judge their residuals.

    All that changes the rays or the stations is a hypothesis whose ``log_likelihood`` may be
    compared with others of the same rays: another assignment (`Orientations.assigned`), mount
    (`turned`), focal length or time offset. Rays of images without orientation count as bad ones.
    Linear in the errors of stations: where their attitude is not known to a degree, the square of
    its sigma is added to the pixel's.
    """
    o = orientations
    r = sorted_rays(o, rays)
    given = r.sums(np.ones(r.sigma.size, np.int64))
    bad, contradictions = np.zeros(r.sigma.shape, np.bool_), 0
    for last in range(_ROUNDS - 1, -1, -1):
        good = r.oriented & ~bad
        position = r.positions(good)
        line = position[r.index] - r.centre
        angle = r.angles(good)
        # Behind a camera, or nearer than its place is known, there is no point.
        near = np.sum(line * r.direction, axis=1) <= _NEAREST_SIGMAS * o.sigma[r.image, 0]
        meet = (angle >= minimum_angle_rad) & (r.sums(good & near) == 0)
        good &= meet[r.index] & (r.sums(good * 1) >= 2)[r.index]
        system = linearised(r, o, position, good)
        count = r.sums(good * 1)
        e = system.residual - system.J @ system.errors + system.Y @ (system.Z @ system.errors)
        e_rays = e[: 2 * r.sigma.size].reshape(-1, 2)
        of_point, freedom = r.sums(np.sum(e_rays**2, axis=1)), np.maximum(2 * count - 3, 1)
        usual = of_point[count >= 2] / chdtri(freedom[count >= 2], 0.5)  # the median
        factor = max(1.0, float(np.median(usual))) if usual.size else 1.0
        # What chi-square loses without a ray, or a pair, against what bad ones are improbable by.
        half = system.Y.data[: 6 * r.sigma.size].reshape(-1, 2, 3)
        free = (1.0 + 1e-9) * np.eye(2) - half @ np.swapaxes(half, 1, 2)
        gain = np.sum(e_rays * np.linalg.solve(free, e_rays[..., None])[..., 0], axis=1)
        gain = np.where(count[r.index] > 2, gain, of_point[r.index]) / factor
        lost = np.where(count > 2, 2, 1)[r.index]
        price = 2.0 * (lost * np.log(_WIDTH_OF_BAD_RAD / np.median(r.sigma)) - _LOG_BAD)
        wrong = good & (gain > price) & (gain == np.maximum.reduceat(gain, r.start)[r.index])
        if last == 0 or not np.any(wrong):
            break
        contradictions += int(np.sum(r.sums(wrong * 1) > 0))
        bad |= wrong
    used, heights = count >= 2, np.isfinite(r.height)
    redundancy = int(np.sum((2 * count - 3 + heights)[used]))
    possible = int(np.sum((2 * given - 3 + heights)[given >= 2]))
    chi_square = float(e @ e + system.errors @ system.errors)
    excess = redundancy * np.log(max(1.0, chi_square / max(1, redundancy)))
    own = system.JJ.tobsr((6, 6)).data + np.eye(6)
    width = np.log(_WIDTH_OF_BAD_RAD / np.median(r.sigma)) if r.sigma.size else 0.0
    misfit = 0.5 * (min(chi_square, redundancy) + excess)
    misfit += (possible - redundancy) * width - contradictions * _LOG_BAD
    back = np.argsort(r.order)
    held = system.residual[: 2 * r.sigma.size].reshape(-1, 2) * system.sigma[:, None]
    return Intersection(
        o, np.unique(rays.point), np.where(used[:, None], position + r.origin, np.nan), angle, used,
        residual_rad=np.where(good[:, None], held, np.nan)[back], bad=bad[back],
        chi_square=chi_square, redundancy=redundancy, misfit=float(misfit),
        log_likelihood=float(-misfit - 0.5 * np.linalg.slogdet(own)[1].sum()), system=system,
    )  # fmt: skip


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
    r, points = sorted_rays(orientations, rays), np.unique(rays.point)
    good, position = r.oriented, r.positions(r.oriented)
    count, angle = r.sums(good * 1), r.angles(good)
    _, A, J, y = r.derivatives(orientations, position, good)
    weight = np.linalg.inv(np.eye(2) + J @ np.swapaxes(J, 1, 2))
    right = np.swapaxes(A, 1, 2) @ weight
    normal = r.sums(right @ A)
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += (1e-12 * trace + (trace == 0.0))[:, None, None] * np.eye(3)
    step = np.linalg.solve(normal, r.sums(right @ y[..., None]))[..., 0]
    position = position + step
    miss = y - np.einsum("rij,rj->ri", A, step[r.index])
    square = r.sums(np.einsum("ri,rij,rj->r", miss, weight, miss))
    factor = np.sqrt(square / np.maximum(2 * count - 3, 1))
    lat, lon, h = geodetic_of_ecef(*(position + r.origin).T)
    up = enu_from_ecef(lat, lon)[:, 2]
    variance = np.sum(up * np.linalg.solve(normal, up[..., None])[..., 0], axis=1)
    line = position[r.index] - r.centre
    behind = r.sums(good & (np.sum(line * r.direction, axis=1) <= 0.0)) > 0
    few = count < 2
    narrow = ~few & ((angle < minimum_angle_rad) | behind)
    apart = ~few & ~narrow & (factor > LARGEST_MISS)
    unknown = few | narrow | apart
    return PointHeights(
        h_m=np.where(unknown, np.nan, h),
        sigma_m=np.where(unknown, np.nan, np.sqrt(variance) * np.maximum(1.0, factor)),
        position_m=np.where(unknown[:, None], np.nan, position + r.origin),
        index=np.searchsorted(points, rays.point), few=few, narrow=narrow, apart=apart,
    )  # fmt: skip
