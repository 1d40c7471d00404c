"""The ray through a spherically stratified atmosphere, and its refraction angle at the camera.

Gyer 1996, Eq. 1-16, without his cancellations. A ray obeys n r sin(zeta) = k. The angle it
subtends at the centre of the earth is compared with that of the straight line that leaves the
camera in the same apparent direction; the difference is integrated directly (`_bend_difference`).
Near grazing, where that form has a singularity at the end of its interval, the subtended angle
itself is integrated with h = h_90 + s^2, which is smooth through the lowest point P_90
(`_bend_subtended`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.atmosphere.profile import Profile
from pipeline.errors import PhysicsError
from pipeline.refraction.kernels.pieces import cut
from pipeline.refraction.kernels.threads import in_blocks
from pipeline.refraction.published import PUBLISHED, Method
from pipeline.refraction.published.trace import trace
from pipeline.refraction.status import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
    STATUS_NAMES,
)

Array = NDArray[np.float64]

DEFAULT_RADIUS_M = 6_371_000.0

# Pieces of the profile on which n - 1 is a polynomial of degree 7 in height: at 500 m a
# troposphere is reproduced to 1e-13 of n - 1.
_PIECE_M = 500.0

# Three nodes over this height integrate the moments of the air to 1e-12, sharp inversions included.
_FINE_M = 62.5
_FINE_DEGREE = 5
_HINT_M = 125.0
_DEGREE = 7


@dataclass(frozen=True, eq=False)
class RayTable:
    """A profile's refractivity as polynomials, the form the ray kernel reads.

    ``edge_m`` is (m + 1,) heights [m]; ``coefficient`` is (m, 8): refractivity in piece i is the
    polynomial in u = (h - edge[i]) / (edge[i + 1] - edge[i]), lowest power first.
    """

    edge_m: Array
    coefficient: Array

    @cached_property
    def fine(self) -> tuple[Array, Array, NDArray[np.intp]]:
        """Intervals of at most 62.5 m, in which moments of the air are kept for many rays.

        Their edges [m], (k + 1,); refractivity in each as a polynomial of degree 5 in the share of
        it, (k, 6), lowest power first (1e-15 of n - 1 apart); and the number of the interval at
        every 125 m from the bottom, from where one is found in a step or two.
        """
        edge = cut(self.edge_m, _FINE_M)
        piece = np.searchsorted(self.edge_m, edge[:-1], side="right") - 1
        nodes = _chebyshev(_FINE_DEGREE)
        height = edge[:-1, None] + np.diff(edge)[:, None] * nodes
        u = (height - self.edge_m[piece, None]) / np.diff(self.edge_m)[piece, None]
        value = np.zeros(u.shape)
        for power in range(_DEGREE, -1, -1):
            value = value * u + self.coefficient[piece, power, None]
        marks = np.arange(edge[0], edge[-1], _HINT_M)
        hint = np.clip(np.searchsorted(edge, marks, side="right") - 1, 0, edge.size - 2)
        return edge, _polynomials(nodes, value), hint


def _chebyshev(degree: int) -> Array:
    """degree + 1 nodes between 0 and 1."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))


def _polynomials(nodes: Array, values: Array) -> Array:
    """(m, d + 1) coefficients, lowest power first, through (m, d + 1) values at the nodes."""
    vandermonde = np.vander(nodes, nodes.size, increasing=True)
    return np.ascontiguousarray(np.linalg.solve(vandermonde, values.T).T)


@dataclass(frozen=True, eq=False)
class PublishedRays:
    """A profile and the published method that bends rays in it, in the place of a `RayTable`."""

    profile: Profile
    method: Method


def rays_by(profile: Profile, method: str) -> RayTable | PublishedRays:
    """What `bend` reads, for one of `METHODS`.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = rays_by(standard_atmosphere("us1976"), "plane")
    >>> r_c, status = bend(air, 6000.0, 0.0, 0.6, 0.8)
    >>> (r_c * 1e6).round(2).item(), int(status)
    (44.25, 0)
    """
    if method == "spherical":
        return ray_table(profile)
    if method not in PUBLISHED:
        raise PhysicsError(
            "METHOD-NAME",
            f"no refraction method is called {method!r}",
            remedy=f"one of {', '.join(METHODS)}",
        )
    return PublishedRays(profile, PUBLISHED[method])


@lru_cache(maxsize=64)
def ray_table(profile: Profile) -> RayTable:
    """Tabulate the refractivity of a profile for the ray kernel (agreement 1e-13 of n - 1)."""
    edge = cut(profile.break_heights_m, _PIECE_M)
    nodes = _chebyshev(_DEGREE)
    heights = edge[:-1, None] + np.diff(edge)[:, None] * nodes
    # Nodes stay inside their piece, so each is evaluated in its own layer.
    return RayTable(edge, _polynomials(nodes, profile.refractivity(heights)))


def _bend_block(
    table: RayTable, rays: list[Array], distance: Array, r_c: Array, status: NDArray[np.uint8]
) -> None:
    """Angles and states of some rays: those that can share a table of moments, then the others."""
    # The compiled functions are imported with the first ray, not with the package.
    from pipeline.refraction.kernels.ray import bend_rays
    from pipeline.refraction.kernels.steep import LEFT, WORTH_A_TABLE, bend_steep_rays

    left = np.arange(r_c.size)
    if r_c.size > WORTH_A_TABLE:
        bend_steep_rays(*table.fine, *rays, r_c, status)
        left = np.flatnonzero(status == LEFT)
    if left.size:
        bend_rays(table.edge_m, table.coefficient, *rays, distance, left, r_c, status)


def bend(
    table: RayTable | PublishedRays,
    h_c: ArrayLike,
    h_g: ArrayLike,
    sin_zeta_c: ArrayLike,
    cos_zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    distance: ArrayLike = math.nan,
) -> tuple[Array, NDArray[np.uint8]]:
    """Refraction angles of rays, each with a status.

    Parameters
    ----------
    table : the profile, from `ray_table` or `rays_by`.
    h_c, h_g : heights of camera and target above sea level [m]; broadcast with the others.
    sin_zeta_c, cos_zeta_c : of the apparent nadir angle at the camera, 0 to 180 degrees. Both
        are asked for so that no arccosine loses digits near the nadir; that they belong to one
        angle is not checked.
    radius : of the sphere [m].
    distance : slant range to the target [m], NaN where unknown. Where a ray meets h_g twice, on
        both sides of its lowest point P_90, it decides which crossing is meant; without it the
        near one is taken and the status is ``beyond_grazing``.

    Returns
    -------
    r_c : refraction angle [rad], positive when the apparent ray is farther from the nadir than
        the straight one; NaN where ``status`` says there is none.
    status : codes of `pipeline.refraction.status`.

    Against 40-digit arithmetic 1e-9 arcsec, also near grazing; 1e-8 in ducts, 1e-7 through P_90.
    Rays from one height that follow each other are fastest: they share what the air between does.
    """
    if isinstance(table, PublishedRays):
        return trace(table.method, table.profile, h_c, h_g, sin_zeta_c, cos_zeta_c, radius)
    shape, (*flat, distances) = as_columns(h_c, h_g, sin_zeta_c, cos_zeta_c, radius, distance)
    r_c = np.empty(flat[0].shape)
    status = np.empty(flat[0].shape, np.uint8)

    def some(rows: slice) -> None:
        _bend_block(table, [a[rows] for a in flat], distances[rows], r_c[rows], status[rows])

    in_blocks(some, flat[0].size)
    return r_c.reshape(shape), status.reshape(shape)


def as_columns(*values: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    """The shape that values broadcast to, and each as a column that compiled functions take.

    A broadcast view is not to be written to, which they ask about: it becomes a copy.
    """
    arrays = [np.asarray(a, np.float64) for a in values]
    shape = np.broadcast_shapes(*(a.shape for a in arrays))

    def column(a: Array) -> Array:
        if a.shape == shape and a.flags.c_contiguous and a.flags.writeable:
            return a.reshape(-1)
        return np.array(np.broadcast_to(a, shape)).reshape(-1)

    return shape, [column(a) for a in arrays]


METHODS: tuple[str, ...] = ("spherical", *PUBLISHED)


def refraction_angle(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    method: str = "spherical",
    distance: ArrayLike = math.nan,
) -> Any:
    """Refraction angle R_c at the camera [rad].

    Parameters
    ----------
    profile : the air, from `standard_atmosphere` or a mission.
    h_c, h_g : heights of camera and target above sea level [m]; ``h_g`` may lie above ``h_c``.
    zeta_c : apparent nadir angle [rad], 0 to pi.
    radius : of the sphere [m].
    method : one of `METHODS`; all but ``spherical`` are those of `pipeline.refraction.published`.
    distance : slant range [m], which says which of two crossings is meant; see `bend`.

    Arguments broadcast. Scalars give a float and raise `PhysicsError` where there is no angle;
    arrays give NaN there (`bend` tells why for each).

    Source: Gyer 1996, Eq. 1, 11, 12 and 15 in a form free of cancellation.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> round(refraction_angle(air, 10000.0, 0.0, 45.0 * DEGREE) / ARCSEC, 6)
    16.378452
    """
    r_c, status = _bent(profile, h_c, h_g, zeta_c, radius, method, distance)
    if r_c.ndim:
        return r_c
    _refuse_no_angle(int(status), profile, method, h_c, h_g, zeta_c)
    return float(r_c)


def angle_and_status(
    profile: Profile,
    h_c: float,
    h_g: float,
    zeta_c: float,
    radius: float = DEFAULT_RADIUS_M,
    method: str = "spherical",
    distance: float = math.nan,
) -> tuple[float, int]:
    """One angle as `refraction_angle` has it [rad], and which crossing it is for, as a status."""
    r_c, status = _bent(profile, h_c, h_g, zeta_c, radius, method, distance)
    _refuse_no_angle(int(status), profile, method, h_c, h_g, zeta_c)
    return float(r_c), int(status)


def _bent(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike,
    method: str,
    distance: ArrayLike,
) -> tuple[Array, NDArray[np.uint8]]:
    """`bend` of nadir angles [rad], which are none below 0 and above pi."""
    zeta = np.asarray(zeta_c, dtype=np.float64)
    in_range = (zeta >= 0.0) & (zeta <= math.pi)
    safe = np.where(in_range, zeta, np.nan)
    return bend(rays_by(profile, method), h_c, h_g, np.sin(safe), np.cos(safe), radius, distance)


def _refuse_no_angle(
    status: int, profile: Profile, method: str, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike
) -> None:
    """Raise `PhysicsError` where the status of a ray says that it has no angle, and tell why."""
    if status in (OK, BEYOND_GRAZING, FAR_BRANCH):
        return
    what = {
        BAD_MEASUREMENT: "the heights and the nadir angle (0 to 180 degrees) must be numbers",
        OUTSIDE_PROFILE: f"the profile ({profile.bottom_m:.0f} to {profile.top_m:.0f} m) "
        f"or the method ({method}) does not cover the heights",
        MISSES_GROUND: "the ray never reaches the target's height",
    }[status]
    raise PhysicsError(
        f"RAY-{STATUS_NAMES[status].upper().replace('_', '-')}",
        what,
        where=f"h_c = {h_c!r} m, h_g = {h_g!r} m, zeta_c = {np.degrees(zeta_c):.6f} deg",
        remedy="check heights and nadir angle (inside the package angles are radians)",
    )
