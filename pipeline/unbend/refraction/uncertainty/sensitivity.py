"""Derivatives of the refraction angle by the air and by the places of camera and target.

The air enters by the adjoint of each ray (`adjoints`) and by the layers' closed forms of dN
(`unbend.atmosphere.covariance`). With C the covariance of temperatures, ln p and e/p, and g the
gradient here, sigma of R_c is sqrt(g^T C g).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.profile import Profile
from unbend.refraction.ray import DEFAULT_RADIUS_M, as_columns, bend
from unbend.refraction.ray_table import ray_table
from unbend.refraction.status_codes import BEYOND_GRAZING, OK
from unbend.refraction.uncertainty.adjoints import (
    MOST_STEPS_OF_PIECE,
    Pieces,
    Rays,
    pieces_between,
    trace_adjoints,
)
from unbend.units import Array, Mask, Rows

_BLOCK = 200_000  # quadrature nodes at a time: 10 MB of polynomials


class RayWeights(NamedTuple):
    """The change of R_c with refractivity: dR_c = weight @ dN.

    ``height_m`` (n,) heights [m above sea level], the same for all rays; ``weight`` (..., n) the
    derivative of R_c [rad] with respect to N there, NaN where not ``valid``. The camera's
    refractivity, interpolated between them, is included: N to N + c (1 + N) changes nothing.
    ``r_c`` [rad] and ``status`` as `bend` has them.
    """

    height_m: Array
    weight: Array
    r_c: Array
    status: NDArray[np.uint8]
    valid: Mask


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of R_c [rad] of rays (...); NaN where not ``valid``.

    By the air: ``d_temperature``, ``d_vapour`` (..., m + 1) with respect to T_M [1/K] and e/p at
    the layers' edges ``edge_height_m`` (m + 1,) [m above sea level], one held where the other
    changes, pressure following by hydrostatics from the anchor; ``d_log_pressure``, ``d_pressure``
    to ln p and p [1/Pa] at the anchor (from T_M to a thermometer's T: `air_jacobian`). The air
    held: ``d_h_c``, ``d_h_g`` with respect to the heights of camera and target [1/m], ``d_zeta_c``
    to the apparent nadir angle at the camera. ``r_c`` and ``status`` as `bend` has them.
    """

    edge_height_m: Array
    r_c: Array
    d_temperature: Array
    d_vapour: Array
    d_log_pressure: Array
    d_pressure: Array
    d_h_c: Array
    d_h_g: Array
    d_zeta_c: Array
    status: NDArray[np.uint8]
    valid: Mask

    @property
    def gradient(self) -> Array:
        """(..., 2m + 3) derivatives by the air, in the order of `ProfileCovariance.matrix`."""
        level = self.d_log_pressure[..., None]
        return np.concatenate([self.d_temperature, level, self.d_vapour], axis=-1)


def ray_weights(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
) -> RayWeights:
    """Derivatives of R_c with respect to refractivity along each ray.

    Arguments and validity are those of `sensitivity`. The array is rays times some 6 nodes per
    layer or per 500 m: for many rays take `sensitivity`, which keeps only the products.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> ray = ray_weights(air, 6000.0, 0.0, 0.8)
    >>> one_percent_denser = ray.weight @ (0.01 * air.refractivity(ray.height_m))
    >>> (ray.r_c * 1e6).round(4).item(), (one_percent_denser * 1e6).round(4).item()
    (60.6689, 0.6065)
    """

    def each_by_itself(height_m: Array) -> Array:
        return np.eye(height_m.size)

    weights, _ = _derivatives(profile, (h_c, h_g, zeta_c, radius), each_by_itself)
    return weights


def sensitivity(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    *,
    anchor_height_m: float = 0.0,
) -> Sensitivity:
    """Derivatives of R_c with respect to the air, the heights and the nadir angle.

    profile, h_c, h_g, zeta_c, radius : as for `refraction_angle`.
    anchor_height_m : where pressure stays as it is when temperatures change [m above sea level].

    Valid for rays that have an angle and do not turn on their way, down to 1 mm of n r from being
    level (2e-7 deg at 10 km over sea level), where the derivatives become infinite. R_c is linear
    only in changes that move n r by less than its distance from there: 1 K moves it by some 6 m.
    Of two crossings of h_g the near one is meant. A camera or target where layers meet has the
    derivatives on the ray's side. Raises `PhysicsError` for an anchor outside the profile.

    Against differences in 30-digit arithmetic: 3e-10 of the largest derivative of a kind, 1e-9
    within 1 cm of level; dR_c/dzeta_c to 1e-15 beyond that.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> s = sensitivity(air, 6000.0, 0.0, [0.0, 0.8])
    >>> (s.d_temperature[1, :3] * 1e9).round(3).tolist(), (s.d_h_g * 1e9).round(4).tolist()
    ([0.0, -413.824, 58.604], [-0.0, -11.8448])
    """
    air = partial(air_jacobian, profile, anchor_height_m=anchor_height_m)
    traced, by_place = _derivatives(profile, (h_c, h_g, zeta_c, radius), air)
    edges = profile.layers.edge.size
    d_log_pressure = traced.weight[..., edges]
    return Sensitivity(
        edge_height_m=profile.break_heights_m,
        r_c=traced.r_c,
        d_temperature=traced.weight[..., :edges],
        d_vapour=traced.weight[..., edges + 1 :],
        d_log_pressure=d_log_pressure,
        d_pressure=d_log_pressure / profile.pressure(anchor_height_m),
        d_h_c=by_place[..., 0],
        d_h_g=by_place[..., 1],
        d_zeta_c=by_place[..., 2],
        status=traced.status,
        valid=traced.valid,
    )


def _derivatives(
    profile: Profile, rays: tuple[ArrayLike, ...], air_of: Callable[[Array], Array]
) -> tuple[RayWeights, Array]:
    """Derivatives of R_c by the air, and (..., 3) by h_c, h_g [rad/m] and zeta_c.

    ``rays`` are h_c, h_g, zeta_c and the radius, which broadcast. ``air_of`` takes heights (n,) [m]
    to the derivatives of N there by k quantities, (n, k): the ``weight`` returned is (..., k).
    """
    shape, columns = as_columns(*rays)
    every_ray, status = _bent_rays(profile, columns)
    traced = _rays_to_trace(every_ray, status)
    pieces = _pieces_of_rays(profile, every_ray.rows(traced))
    height_m = pieces.height_m.reshape(-1)
    air = air_of(height_m)
    count = status.size
    gradient = np.full((count, air.shape[1]), np.nan)
    by_place = np.full((count, 3), np.nan)
    valid = np.zeros(count, dtype=bool)
    for rows in _blocks(traced, pieces):
        adjoints = trace_adjoints(pieces, every_ray.rows(rows))
        gradient[rows] = adjoints.weight @ air
        by_place[rows] = adjoints.by_place
        valid[rows] = adjoints.valid
    derivatives = RayWeights(
        height_m=height_m,
        weight=gradient.reshape(*shape, air.shape[1]),
        r_c=every_ray.r_c.reshape(shape),
        status=status.reshape(shape),
        valid=valid.reshape(shape),
    )
    return derivatives, by_place.reshape(*shape, 3)


def _bent_rays(profile: Profile, columns: list[Array]) -> tuple[Rays, NDArray[np.uint8]]:
    """Rays with their refraction angles, and the status of each, as `bend` has it.

    ``columns`` are h_c, h_g, zeta_c and the radius (n,).
    """
    rays = Rays(
        h_c=columns[0],
        h_g=columns[1],
        zeta_c=columns[2],
        radius=columns[3],
        r_c=np.full(columns[0].shape, np.nan),
    )
    is_angle = (rays.zeta_c >= 0.0) & (rays.zeta_c <= np.pi)
    zeta = np.where(is_angle, rays.zeta_c, np.nan)
    r_c, status = bend(
        ray_table(profile),
        rays.h_c,
        rays.h_g,
        np.sin(zeta),
        np.cos(zeta),
        radius=rays.radius,
    )
    return rays._replace(r_c=r_c), status


def _pieces_of_rays(profile: Profile, rays: Rays) -> Pieces:
    """The pieces of the profile that rays pass; the lowest one if there are no rays."""
    low = profile.bottom_m
    high = profile.bottom_m
    if rays.h_c.size:
        heights = np.stack([rays.h_c, rays.h_g])
        low = float(heights.min())
        high = float(heights.max())
    return pieces_between(profile, low, high)


def _blocks(traced: Rows, pieces: Pieces) -> Iterator[Rows]:
    """Blocks of rays that are traced at a time."""
    nodes_of_ray = len(pieces.height_m) * MOST_STEPS_OF_PIECE
    rays_at_once = max(1, _BLOCK // nodes_of_ray)
    for first in range(0, traced.size, rays_at_once):
        yield traced[first : first + rays_at_once]


def _rays_to_trace(rays: Rays, status: NDArray[np.uint8]) -> Rows:
    """The rays that have an angle and do not turn on their way.

    The steepest are first: blocks of them need fewer nodes.
    """
    has_angle = np.isin(status, (OK, BEYOND_GRAZING))
    turns = (rays.h_g > rays.h_c) & (np.cos(rays.zeta_c) > 0.0)
    traced = np.flatnonzero(has_angle & ~turns)
    steepness = np.abs(np.cos(rays.zeta_c[traced]))
    return traced[np.argsort(-steepness, kind="stable")]
