"""Points from the rays of several images, the stations held: do the rays meet as the sigmas say?

How to use it::

    stations = orientations_of(stations_of_the_flight)         # or Orientations(...) directly
    rays = ImageRays(image, point, direction, sigma_rad)            # straight, corrected rays
    chosen = choose_tie_points(stations, rays)                 # up to 2,000 points, well spread
    found = intersect(stations, rays.of_points(chosen))
    found.log_likelihood, found.by_image.chi_square, found.by_camera.rotation_rad
    other = intersect(stations.assigned(event_of_image), rays.of_points(chosen))   # a hypothesis
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

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pipeline.flight.stations import Stations
from pipeline.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

MINIMUM_ANGLE_RAD = float(np.radians(3.0))
"""Least angle between two rays of a point that is used."""

UNKNOWN_SIGMAS = (3.0, 3.0, 6.0, np.radians(1.0), np.radians(1.0), np.radians(3.0))
"""East, north, up [m], tilts and yaw [rad] of a station that does not say: judgement."""

# A bad tie point is anywhere within half a radian, and one in fifty is bad.
_LOG_BAD, _WIDTH_OF_BAD_RAD = np.log(0.02), 0.5
_ROUNDS = 4  # of finding bad ones


@dataclass(frozen=True, eq=False)
class Orientations:
    """Exterior orientation of images; (s,) arrays, NaN centres where there is none.

    ``centre_m`` (s, 3) earth-centred (WGS84); ``camera_from_ecef`` and ``enu_from_ecef``
    (s, 3, 3); ``sigma`` (s, 6) of east, north, up [m] and of rotations about these axes [rad].
    """

    camera: NDArray[np.object_]
    centre_m: Array
    camera_from_ecef: Array
    enu_from_ecef: Array
    sigma: Array

    def assigned(self, row: Indices) -> Orientations:
        """Orientations of images (k,), each that of a row, or none for -1: a hypothesis."""
        centre = np.where(row[:, None] >= 0, self.centre_m[row], np.nan)
        return Orientations(
            self.camera[row], centre, self.camera_from_ecef[row], self.enu_from_ecef[row],
            self.sigma[row],
        )  # fmt: skip

    def turned(self, rotation: Array, camera: str) -> Orientations:
        """With one camera turned by a rotation vector [rad] in its own frame (mount angles)."""
        turn = Rotation.from_rotvec(rotation).as_matrix()
        own = (self.camera == camera)[:, None, None]
        return replace(
            self,
            camera_from_ecef=np.where(own, turn @ self.camera_from_ecef, self.camera_from_ecef),
        )


def orientations_of(
    stations: Stations, unknown_sigmas: tuple[float, ...] = UNKNOWN_SIGMAS
) -> Orientations:
    """Orientations of stations; a sigma that is not stated is ``unknown_sigmas``'.

    What is not ok is NaN. Heights of which only that above mean sea level is known count from
    there: rays meet as well.
    """
    lat, lon, h = stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m
    centre = ecef_of_geodetic(lat, lon, np.where(np.isfinite(h), h, stations.h_msl_m))
    axes = enu_from_ecef(lat, lon)
    usable = stations.ok & np.all(np.isfinite(stations.quaternion), axis=1)
    q = np.where(usable[:, None], stations.quaternion, [1.0, 0.0, 0.0, 0.0])
    tilt, horizontal = stations.sigma_tilt_rad, stations.sigma_horizontal_m
    sigma = np.stack(
        [horizontal, horizontal, stations.sigma_height_m, tilt, tilt, stations.sigma_yaw_rad],
        axis=1,
    )
    return Orientations(
        camera=stations.camera,
        centre_m=np.where(usable[:, None], centre, np.nan),
        camera_from_ecef=Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() @ axes,
        enu_from_ecef=axes,
        sigma=np.where(np.isfinite(sigma), sigma, unknown_sigmas),
    )


@dataclass(frozen=True, eq=False)
class ImageRays:
    """Straight rays (r,): row of the image, number of the point, direction in the camera.

    ``direction`` (r, 3) with the camera's x right, y down, z forward, unit length;
    ``sigma_rad`` (r,) or one: the pixel's, across the ray. ``height_m`` (r,) given height of the
    point above the ellipsoid, NaN where unknown, with ``sigma_height_m``.
    """

    image: Indices
    point: Indices
    direction: Array
    sigma_rad: float | Array
    height_m: Array | None = None
    sigma_height_m: float = 1.0

    def of_points(self, points: Indices) -> ImageRays:
        """The rays of some points."""
        keep = np.isin(self.point, points)
        sigma = np.broadcast_to(self.sigma_rad, keep.shape)[keep]
        height = None if self.height_m is None else self.height_m[keep]
        return ImageRays(
            self.image[keep], self.point[keep], self.direction[keep], sigma, height,
            self.sigma_height_m,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ResidualGroups:
    """Residuals of images, or of cameras: (g,) arrays.

    ``mean_rad`` (g, 2) and ``rms_rad`` of the rays along the image's x and y, measured minus
    intersected; ``chi_square`` and ``redundancy`` (its expectation, where the sigmas are right).
    For cameras they are of ``rotation_rad`` (g, 3): by what each camera would have to be turned
    (`Orientations.turned`) for the residuals, with ``sigma_rad`` (g, 3); NaN for images.
    """

    name: NDArray[np.object_]
    rays: Indices
    bad: Indices
    mean_rad: Array
    rms_rad: Array
    chi_square: Array
    redundancy: Indices
    rotation_rad: Array
    sigma_rad: Array


@dataclass(frozen=True, eq=False)
class Intersection:
    """Intersected points (p,) and the residuals of their rays (r,), in the order they came.

    ``position_m`` (p, 3) earth-centred, NaN where ``used`` is False: fewer than two good rays with
    a station, all within the minimum angle, or behind a camera. ``residual_rad`` (r, 2) measured
    minus intersected along the image's x and y; ``bad`` (r,) rays that contradict the others of
    their point by more than any station error can. ``chi_square`` has ``redundancy`` degrees of
    freedom; ``log_likelihood`` is natural, up to a constant of the rays given, with a common factor
    of all sigmas at its best (at least 1): too small sigmas do not feign certainty.
    """

    orientations: Orientations
    point: Indices
    position_m: Array
    angle_rad: Array
    used: Mask
    residual_rad: Array
    bad: Mask
    chi_square: float
    redundancy: int
    log_likelihood: float
    system: _System

    @property
    def sigma_factor(self) -> float:
        """Square root of chi-square over redundancy: 1 where the sigmas are right."""
        return float(np.sqrt(self.chi_square / self.redundancy)) if self.redundancy else np.nan

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
        variance = (
            np.sum(step**2, axis=1) + np.asarray(by_stations.multiply(by_stations).sum(1))[:, 0]
        )
        return np.where(self.used, np.sqrt(variance), np.nan)

    @cached_property
    def expected_rad(self) -> Array:
        """(r, 2) what the sigmas predict for the residuals: each over this has a sigma of 1."""
        system = self.system
        of_points = np.asarray(system.Y.multiply(system.Y).sum(1))[:, 0]
        W = system.J - system.Y @ system.Z
        of_stations = np.asarray(W.multiply(W).sum(1))[:, 0]
        rows = (1.0 - of_points + of_stations)[: 2 * system.order.size].reshape(-1, 2)
        expected = np.empty(rows.shape)
        expected[system.order] = np.sqrt(np.maximum(rows, 0.0)) * system.sigma[:, None]
        return np.where(np.isfinite(self.residual_rad), expected, np.nan)

    @cached_property
    def by_image(self) -> ResidualGroups:
        """Residuals of each image: its chi-square is of what they say of its station.

        The gradient J'Q y of the station's six errors has the covariance M M + M, M = J'Q J.
        """
        system = self.system
        images = self.orientations.camera.size
        M = system.M.tobsr((6, 6))
        row = np.repeat(np.arange(M.indptr.size - 1), np.diff(M.indptr))
        squared, own = np.zeros((2, images, 6, 6))
        np.add.at(squared, row, M.data @ np.swapaxes(M.data, 1, 2))
        own[row[row == M.indices]] = M.data[row == M.indices]
        value, vector = np.linalg.eigh(own)
        able = value > 1e-9 * np.maximum(value[:, -1:], 1e-30)
        half = vector * np.where(able, np.maximum(value, 1e-300) ** -0.5, 0.0)[:, None, :]
        seen = np.einsum("sji,sj->si", half, (system.J.T @ system.residual).reshape(images, 6))
        spread = np.swapaxes(half, 1, 2) @ squared @ half + np.eye(6)
        square = np.sum(seen * np.linalg.solve(spread, seen[..., None])[..., 0], axis=1)
        name = np.arange(images).astype(object)
        return self._grouped(name, system.image, square, np.sum(able, axis=1))

    @cached_property
    def by_camera(self) -> ResidualGroups:
        """Residuals of each camera, and by what it would have to be turned in its mount."""
        system, o = self.system, self.orientations
        name, group = np.unique(o.camera.astype(str), return_inverse=True)
        camera_from_enu = o.camera_from_ecef @ np.swapaxes(o.enu_from_ecef, 1, 2)
        rotation, sigma = np.full((2, name.size, 3), np.nan)
        square = np.zeros(name.size)
        for g in range(name.size):
            turn = np.zeros((o.camera.size, 6, 3))
            turn[:, 3:] = np.swapaxes(camera_from_enu, 1, 2) / o.sigma[:, 3:, None]
            turn = (turn * (group == g)[:, None, None]).reshape(-1, 3)
            normal = turn.T @ (turn - system.factor.solve(turn))
            inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
            right = turn.T @ system.errors
            rotation[g], sigma[g] = inverse @ right, np.sqrt(np.maximum(np.diag(inverse), 0.0))
            square[g] = right @ inverse @ right
        redundancy = np.full(name.size, 3)
        groups = self._grouped(name.astype(object), group[system.image], square, redundancy)
        return replace(groups, rotation_rad=rotation, sigma_rad=sigma)

    def _grouped(
        self, name: NDArray[np.object_], group: Indices, square: Array, redundancy: Indices
    ) -> ResidualGroups:
        residual, bad = self.residual_rad[self.system.order], self.bad[self.system.order]
        good = np.isfinite(residual[:, 0]) & ~bad
        each = partial(np.bincount, group[good], minlength=name.size)
        rays, unknown = each(), np.full((name.size, 3), np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.stack([each(residual[good, i]) / rays for i in (0, 1)], axis=1)
            rms = np.sqrt(each(np.sum(residual[good] ** 2, axis=1)) / (2 * rays))
        wrong = np.bincount(group[bad], minlength=name.size)
        return ResidualGroups(name, rays, wrong, mean, rms, square, redundancy, unknown, unknown)


@dataclass(frozen=True, eq=False)
class _System:
    """The residuals and their derivatives in units of the pixels' sigmas, rays sorted by point.

    Rows are two for each ray, then one for each point's given height.
    """

    order: Indices  # (r,) where the sorted rays stood
    image: Indices  # (r,)
    sigma: Array  # (r,) of the sorted rays [rad]
    half_inverse: Array  # (p, 3, 3) L^-1 of the points' normal equations L L'
    Y: sparse.csr_matrix  # A L'^-1: Q = I - Y Y'
    J: sparse.csr_matrix  # by the stations' errors in units of their sigmas
    Z: sparse.csr_matrix  # Y'J
    M: sparse.csr_matrix  # J'QJ
    residual: Array  # Q y
    factor: Any  # of I + M
    errors: Array  # of the stations at their most probable, in units of their sigmas


def _blocks(values: Array, column: Indices, columns: int) -> sparse.csr_matrix:
    """Sparse matrix of blocks (n, rows, width), one in each row of blocks."""
    count, rows, width = values.shape
    indices = np.repeat(column[:, None] * width + np.arange(width), rows, axis=0)
    start = np.arange(count * rows + 1) * width
    return sparse.csr_matrix(
        (values.ravel(), indices.ravel(), start), shape=(count * rows, columns * width)
    )


@dataclass(frozen=True, eq=False)
class _SortedRays:
    """Rays sorted by their points: (r, ...) arrays of what does not change while points move."""

    order: Indices
    image: Indices
    index: Indices  # which point
    start: Indices  # (p,) the first ray of each point
    sigma: Array
    oriented: Mask
    centre: Array  # (r, 3) from `origin`
    direction: Array  # (r, 3) earth-centred
    across: Array  # (r, 2, 3) unit vectors along the image's x and y, across the ray
    origin: Array
    height: Array  # (p,) given, NaN where unknown
    sigma_height: float

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """(p, ...) sums over the rays of each point."""
        return np.asarray(np.add.reduceat(values, self.start, axis=0))

    def positions(self, good: Mask) -> Array:
        """(p, 3) points by least squares of the angles across their good rays."""
        distance = np.ones(self.sigma.shape)
        square = np.swapaxes(self.across, 1, 2) @ self.across
        for _ in range(3):
            weight = np.where(good, (self.sigma * distance) ** -2.0, 0.0)
            normal = self.sums(weight[:, None, None] * square)
            size = np.trace(normal, axis1=1, axis2=2) + (self.sums(good * 1.0) < 2)
            normal += 1e-12 * size[:, None, None] * np.eye(3)
            right = self.sums(weight[:, None] * np.einsum("rij,rj->ri", square, self.centre))
            position = np.linalg.solve(normal, right[..., None])[..., 0]
            distance = np.linalg.norm(position[self.index] - self.centre, axis=1) + 1e-3
        return np.asarray(position, np.float64)

    def angles(self, good: Mask) -> Array:
        """(p,) largest angle [rad] between two good rays, by going twice to the farthest."""
        reference = self.direction[self.start[self.index]]
        for _ in range(2):
            cosine = np.where(good, np.sum(reference * self.direction, axis=1), 2.0)
            least = np.minimum.reduceat(cosine, self.start)
            farthest = np.flatnonzero(cosine == least[self.index])
            ray = farthest[np.searchsorted(self.index[farthest], np.arange(self.start.size))]
            reference = self.direction[ray][self.index]
        return np.where(least < 2.0, np.arccos(np.clip(least, -1.0, 1.0)), 0.0)

    def linearised(self, o: Orientations, position: Array, good: Mask) -> _System:
        """The system at some positions, of the good self."""
        points = self.start.size
        line = position[self.index] - self.centre
        distance = np.linalg.norm(line, axis=1) + 1e-3
        u = line / distance[:, None]
        # A rotation is linear up to the square of its angle, which is added to the pixel's sigma.
        enu, angles = o.enu_from_ecef[self.image], o.sigma[self.image, 3:] ** 2
        along = np.einsum("rij,rj->ri", enu, u) ** 2
        curved = np.sqrt(
            np.sum(angles * along, axis=1) * np.sum(angles * (1.0 - along), axis=1) / 8.0
        )
        sigma = np.hypot(self.sigma, curved)
        weight = np.where(good, 1.0 / sigma, 0.0)[:, None, None]
        A = weight * self.across / distance[:, None, None]
        turned = -np.cross(self.across, u[:, None, :])  # across @ [u]x
        J = np.concatenate([-A, weight * turned], axis=2)
        to_enu = np.swapaxes(enu, 1, 2)
        J = np.concatenate([J[..., :3] @ to_enu, J[..., 3:] @ to_enu], axis=2)
        J *= o.sigma[self.image, None, :]
        y = -np.einsum("rij,rj->ri", weight * self.across, u).ravel()
        lat, lon, h = geodetic_of_ecef(*(position + self.origin).T)
        known = np.isfinite(self.height) & (self.sums(good * 1) >= 2)
        up = np.where(known[:, None], enu_from_ecef(lat, lon)[:, 2] / self.sigma_height, 0.0)
        above = np.where(known, (self.height - h) / self.sigma_height, 0.0)
        normal = self.sums(np.swapaxes(A, 1, 2) @ A) + up[:, :, None] * up[:, None, :]
        trace = np.trace(normal, axis1=1, axis2=2)
        normal += (1e-12 * trace + (trace == 0.0))[:, None, None] * np.eye(3)
        half_inverse = np.linalg.inv(np.linalg.cholesky(normal))
        half = np.swapaxes(half_inverse, 1, 2)
        Y = sparse.vstack(
            [_blocks(A @ half[self.index], self.index, points),
             _blocks(up[:, None, :] @ half, np.arange(points), points)], format="csr",
        )  # fmt: skip
        J_rays = _blocks(J, self.image, o.camera.size)
        J_all = sparse.vstack([J_rays, sparse.csr_matrix((points, J_rays.shape[1]))], format="csr")
        y = np.append(y, above)
        Z = (Y.T @ J_all).tocsr()
        M = (J_all.T @ J_all - Z.T @ Z).tocsr()
        residual = y - Y @ (Y.T @ y)
        factor = splu((sparse.identity(M.shape[0]) + M).tocsc(), permc_spec="MMD_AT_PLUS_A",
                      diag_pivot_thresh=0.0, options={"SymmetricMode": True})  # fmt: skip
        errors = factor.solve(J_all.T @ residual)
        return _System(
            self.order, self.image, sigma, half_inverse, Y, J_all, Z, M, residual, factor, errors
        )


def _sorted(o: Orientations, rays: ImageRays) -> _SortedRays:
    order = np.lexsort((rays.image, rays.point))
    image, d = rays.image[order], np.nan_to_num(rays.direction[order])
    oriented = np.all(np.isfinite(o.centre_m[image]), axis=1) & np.any(d != 0.0, axis=1)
    _, start, index = np.unique(rays.point[order], return_index=True, return_inverse=True)
    x = np.array([1.0, 0.0, 0.0]) - d[:, :1] * d
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    rotation = o.camera_from_ecef[image]
    origin = o.centre_m[image][oriented].mean(axis=0) if np.any(oriented) else np.zeros(3)
    height = np.full(start.size, np.nan)
    if rays.height_m is not None:
        height = rays.height_m[order][start]
    return _SortedRays(
        order=order,
        image=image,
        index=index,
        start=start,
        sigma=np.broadcast_to(rays.sigma_rad, image.shape)[order].astype(np.float64),
        oriented=oriented,
        centre=np.where(oriented[:, None], o.centre_m[image] - origin, 0.0),
        direction=np.einsum("rji,rj->ri", rotation, d),
        across=np.stack([x, np.cross(d, x)], axis=1) @ rotation,
        origin=origin,
        height=height,
        sigma_height=rays.sigma_height_m,
    )


def intersect(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> Intersection:
    """Intersect the rays of each point with the stations held, and judge their residuals.

    All that changes the rays or the stations is a hypothesis whose ``log_likelihood`` may be
    compared with others of the same rays: another assignment (`Orientations.assigned`), mount
    (`turned`), focal length (other directions, and sigmas), time offset (other orientations). Rays
    of images without orientation count as bad ones. Linear in the errors of stations: where their
    attitude is not known to a degree, the square of its sigma is added to the pixel's.
    """
    o = orientations
    r = _sorted(o, rays)
    given = r.sums(np.ones(r.sigma.size, np.int64))
    bad, contradictions = np.zeros(r.sigma.shape, np.bool_), 0
    for last in range(_ROUNDS - 1, -1, -1):
        good = r.oriented & ~bad
        position = r.positions(good)
        line = position[r.index] - r.centre
        angle = r.angles(good)
        meet = (angle >= minimum_angle_rad) & (
            r.sums(good & (np.sum(line * r.direction, axis=1) <= 0.0)) == 0
        )
        good &= meet[r.index] & (r.sums(good * 1) >= 2)[r.index]
        system = r.linearised(o, position, good)
        count = r.sums(good * 1)
        e = system.residual - system.J @ system.errors + system.Y @ (system.Z @ system.errors)
        e_rays = e[: 2 * r.sigma.size].reshape(-1, 2)
        of_point, freedom = r.sums(np.sum(e_rays**2, axis=1)), np.maximum(2 * count - 3, 1)
        usual = of_point[count >= 2] / chi2.ppf(0.5, freedom[count >= 2])
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
    own = (system.J.T @ system.J).tobsr((6, 6)).data + np.eye(6)
    log_likelihood = -0.5 * (min(chi_square, redundancy) + excess + np.linalg.slogdet(own)[1].sum())
    width = np.log(_WIDTH_OF_BAD_RAD / np.median(r.sigma)) if r.sigma.size else 0.0
    log_likelihood += contradictions * _LOG_BAD - (possible - redundancy) * width
    back = np.argsort(r.order)
    held = system.residual[: 2 * r.sigma.size].reshape(-1, 2) * system.sigma[:, None]
    return Intersection(
        orientations=o,
        point=np.unique(rays.point),
        position_m=np.where(used[:, None], position + r.origin, np.nan),
        angle_rad=angle,
        used=used,
        residual_rad=np.where(good[:, None], held, np.nan)[back],
        bad=bad[back],
        chi_square=chi_square,
        redundancy=redundancy,
        log_likelihood=float(log_likelihood),
        system=system,
    )


def choose_tie_points(
    orientations: Orientations,
    rays: ImageRays,
    *,
    most: int = 2000,
    minimum_angle_rad: float = 1.5 * MINIMUM_ANGLE_RAD,
) -> Indices:
    """Numbers of up to ``most`` points that cover all images, seen under angles large enough.

    Each image is cut into cells, about one for each ray that is wanted of it; points of the widest
    angle in a cell come first, then the second ones of all cells, and so on.
    """
    r = _sorted(orientations, rays)
    points = np.unique(rays.point)
    if points.size == 0:
        return points
    angle = r.angles(r.oriented)
    angle[angle < minimum_angle_rad] = 0.0
    images = max(1, np.unique(rays.image).size)
    cells = int(np.clip(np.sqrt(2.0 * most / images), 1, 8))
    d = rays.direction[r.order, :2]
    low, high = np.nanmin(d, axis=0), np.nanmax(d, axis=0)
    place = np.floor(np.nan_to_num((d - low) / np.maximum(high - low, 1e-9)) * 0.999 * cells)
    cell = ((r.image * cells + place[:, 0]) * cells + place[:, 1]).astype(np.int64)
    by_cell = np.lexsort((-angle[r.index], cell))
    first = np.append(True, np.diff(cell[by_cell]) > 0)
    rank = np.empty(cell.size, np.int64)
    rank[by_cell] = np.arange(cell.size) - np.flatnonzero(first)[np.cumsum(first) - 1]
    best_rank = np.minimum.reduceat(rank, r.start)
    chosen = np.lexsort((-angle, best_rank))
    return np.sort(points[chosen[angle[chosen] > 0.0][:most]])
