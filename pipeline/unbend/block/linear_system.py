"""Misses of rays at their points and errors of stations in one linear system without the points.

In units of the sigmas the residuals are y = A dx + J p + e, with the changes of the points dx, the
errors of the stations p and those of the pixels e. Q = I - Y Y' takes the points out; the stations'
most probable errors solve (I + J'Q J) p = J'Q y, the reduced normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from unbend.block.image_rays import RIDGE, Orientations, RayMisses, SortedRays
from unbend.geodesy import enu_from_ecef, geodetic_of_ecef
from unbend.units import Array, Integers, Mask


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """Residuals and their derivatives in units of the pixels' sigmas, with the points taken out.

    The rows are two for each ray, sorted by point, then one for the given height of each point.
    """

    order: Integers  # (r,) row of the sorted rays in `ImageRays`
    image: Integers  # (r,) row of the image in `Orientations`
    sigma: Array  # (r,) of the sorted rays [rad]
    half_inverse: Array  # (p, 3, 3) L^-1 of the points' normal equations L L'
    Y: sparse.csr_matrix  # A L'^-1: Q = I - Y Y'
    J: sparse.csr_matrix  # derivatives by the stations' errors in units of their sigmas
    JJ: sparse.csr_matrix  # J'J
    Z: sparse.csr_matrix  # Y'J
    residual: Array  # Q y: the points at their best, the stations without errors
    factor: Any  # factorisation of I + J'QJ
    errors: Array  # most probable errors of the stations, in units of their sigmas

    @cached_property
    def remaining(self) -> Array:
        """The residuals after the most probable errors of the stations are subtracted."""
        by_stations = self.J @ self.errors
        by_points = self.Y @ (self.Z @ self.errors)  # which move with the stations
        return np.asarray(self.residual - by_stations + by_points, np.float64)

    @property
    def residual_rad(self) -> Array:
        """(r, 2) the residuals of the rays [rad], errors of the stations included."""
        return self.of_rays(self.residual) * self.sigma[:, None]

    def of_rays(self, residual: Array) -> Array:
        """(r, 2) the part of residuals that belongs to rays, without that of given heights."""
        rows = 2 * self.sigma.size
        return residual[:rows].reshape(-1, 2)


def block_matrix(
    values: Array,
    column: Integers,
    columns: int,
    *,
    empty: int = 0,
) -> sparse.csr_matrix:
    """Sparse matrix with one block in each row of blocks.

    ``values`` (n, rows, width) are the blocks, ``column`` (n,) the column of blocks of each, and
    ``columns`` the number of these. Below them are ``empty`` rows of zeros.
    """
    count, rows, width = values.shape
    filled = count * rows
    total = filled + empty
    column_of_block = column[:, None] * width + np.arange(width)
    indices = np.repeat(column_of_block, rows, axis=0)
    start = np.minimum(np.arange(total + 1), filled) * width  # of each row in ``values``
    return sparse.csr_matrix(
        (values.ravel(), indices.ravel(), start),
        shape=(total, columns * width),
    )


@lru_cache(1)  # one flight needs the same size again and again
def identity(size: int) -> sparse.csr_matrix:
    """The sparse identity matrix."""
    return sparse.identity(size, format="csr")


def with_ridge(normal: Array) -> Array:
    """Normal equations (p, 3, 3) with a small diagonal added, so that they have a solution.

    Without it those of parallel rays, and of points without rays, are singular.
    """
    trace = np.trace(normal, axis1=1, axis2=2)
    ridge = RIDGE * trace + (trace == 0.0)
    return np.asarray(normal + ridge[:, None, None] * np.eye(3), np.float64)


def heights_and_verticals(position_m: Array) -> tuple[Array, Array]:
    """Heights above the ellipsoid (n,) and upward unit vectors (n, 3) of positions (n, 3) [m]."""
    lat, lon, h_m = geodetic_of_ecef(*position_m.T)
    return h_m, enu_from_ecef(lat, lon)[:, 2]


@dataclass(frozen=True, eq=False)
class HeightMisses:
    """Given heights minus heights of the points, in sigmas; zeros where no height counts."""

    miss: Array  # (p,)
    point_derivatives: Array  # (p, 3) derivatives by the position of the point [m]


def height_misses(by_point: SortedRays, position: Array, good: Mask) -> HeightMisses:
    """Misses of given heights at positions (p, 3), given minus ``origin`` [m].

    Heights count for points that two or more good rays see.
    """
    seen_twice = by_point.sums(good * 1) >= 2
    counts = np.isfinite(by_point.height) & seen_twice
    h_m, up = heights_and_verticals(position + by_point.origin)
    above = (by_point.height - h_m) / by_point.sigma_height
    return HeightMisses(
        miss=np.where(counts, above, 0.0),
        point_derivatives=np.where(counts[:, None], up / by_point.sigma_height, 0.0),
    )


def linearised(
    by_point: SortedRays, orientations: Orientations, position: Array, good: Mask
) -> ReducedSystem:
    """The linearised system of the good rays and given heights, with the points taken out.

    ``position`` (p, 3): of the points, less the ``origin`` of ``by_point`` [m]. The result has the
    corrections of the stations that solve the system.
    """
    points = by_point.start.size
    rays = by_point.misses(orientations, position, good)
    heights = height_misses(by_point, position, good)
    half_inverse = half_inverses(by_point, rays, heights)
    Y = orthogonal_rows(by_point, rays, heights, half_inverse)
    J = block_matrix(
        rays.station_derivatives, by_point.image, orientations.camera.size, empty=points
    )
    y = np.append(rays.miss.ravel(), heights.miss)
    Y_t = Y.T.tocsr()  # transposes are CSC: converted once, not in each product
    J_t = J.T.tocsr()
    Z = Y_t @ J
    JJ = J_t @ J
    M = JJ - Z.T.tocsr() @ Z  # J'QJ
    residual = y - Y @ (Y_t @ y)
    reduced_normal = identity(M.shape[0]) + M
    factor = splu(
        reduced_normal.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return ReducedSystem(
        order=by_point.order,
        image=by_point.image,
        sigma=rays.sigma,
        half_inverse=half_inverse,
        Y=Y,
        J=J,
        JJ=JJ,
        Z=Z,
        residual=residual,
        factor=factor,
        errors=factor.solve(J_t @ residual),
    )


def half_inverses(by_point: SortedRays, rays: RayMisses, heights: HeightMisses) -> Array:
    """(p, 3, 3) L^-1, with L L' the normal equations A'A of each point (Cholesky)."""
    A = rays.point_derivatives
    up = heights.point_derivatives
    of_rays = by_point.sums(np.swapaxes(A, 1, 2) @ A)
    of_heights = up[:, :, None] * up[:, None, :]
    half = np.linalg.cholesky(with_ridge(of_rays + of_heights))
    return np.asarray(np.linalg.inv(half), np.float64)


def orthogonal_rows(
    by_point: SortedRays, rays: RayMisses, heights: HeightMisses, half_inverse: Array
) -> sparse.csr_matrix:
    """Y = A L'^-1, the derivatives by the points, transformed to orthonormal columns."""
    points = by_point.start.size
    half = np.swapaxes(half_inverse, 1, 2)
    of_rays = rays.point_derivatives @ half[by_point.index]
    of_heights = heights.point_derivatives[:, None, :] @ half
    rows = np.concatenate([of_rays.reshape(-1, 1, 3), of_heights])
    point_of_ray_row = np.repeat(by_point.index, 2)
    point_of_row = np.append(point_of_ray_row, np.arange(points))
    return block_matrix(rows, point_of_row, points)
