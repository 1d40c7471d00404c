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
    MOST_NODES_OF_PIECE,
    Pieces,
    Rays,
    pieces_between,
    trace_adjoints,
)
from unbend.units import Array, Mask, Rows

_NODES_AT_ONCE = 200_000  # of the quadrature: 10 MB of polynomials


class RayWeights(NamedTuple):
    """The change of R_c of rays (...) with refractivity: dR_c = weight @ dN.

    The camera's refractivity is interpolated between the heights, and its derivative is included in
    the weights: a change from N to N + c (1 + N) does not change R_c.
    """

    height_m: Array  # (n,) heights [m above sea level], the same for all rays
    weight: Array  # (..., n) derivative of R_c [rad] with respect to N there, NaN where not valid
    r_c: Array  # refraction angle [rad], as from `bend`
    status: NDArray[np.uint8]  # as from `bend`
    valid: Mask


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of R_c [rad] of rays (...); NaN where not ``valid``.

    Of temperature and vapour at the edges of layers, each is the same while the other changes, and
    pressure follows by hydrostatics from the anchor. `air_jacobian` gives the step from T_M to the
    T of a thermometer. The air is the same while places and the nadir angle change.
    """

    edge_height_m: Array  # (m + 1,) edges of the layers [m above sea level]
    r_c: Array  # refraction angle [rad], as from `bend`
    d_temperature: Array  # (..., m + 1) by T_M at the edges [rad/K]
    d_vapour: Array  # (..., m + 1) by e/p at the edges [rad]
    d_log_pressure: Array  # by ln p at the anchor [rad]
    d_pressure: Array  # by p at the anchor [rad/Pa]
    d_h_c: Array  # by the height of the camera [rad/m]
    d_h_g: Array  # by the height of the target [rad/m]
    d_zeta_c: Array  # by the apparent nadir angle at the camera
    status: NDArray[np.uint8]  # as from `bend`
    valid: Mask

    @property
    def gradient(self) -> Array:
        """(..., 2m + 3) derivatives by the air, in the order of `ProfileCovariance.matrix`."""
        log_pressure = self.d_log_pressure[..., None]
        return np.concatenate([self.d_temperature, log_pressure, self.d_vapour], axis=-1)


def ray_weights(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
) -> RayWeights:
    """Derivatives of R_c with respect to refractivity along each ray.

    Arguments and validity are those of `sensitivity`. The array of weights is rays times some 6
    nodes per layer or per 500 m: for many rays use `sensitivity`, which keeps only the products.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> ray = ray_weights(air, 6000.0, 0.0, 0.8)
    >>> one_percent_denser = ray.weight @ (0.01 * air.refractivity(ray.height_m))
    >>> (ray.r_c * 1e6).round(4).item(), (one_percent_denser * 1e6).round(4).item()
    (60.6689, 0.6065)
    """

    def identity(height_m: Array) -> Array:
        return np.eye(height_m.size)  # dN at a height by N at that height alone

    weights, _ = _derivatives(profile, (h_c, h_g, zeta_c, radius), identity)
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
    If a ray crosses h_g twice, the derivatives are those of the near crossing. A camera or target
    where layers meet has the derivatives on the ray's side. Raises `PhysicsError` for an anchor
    outside the profile.

    Against differences in 30-digit arithmetic: 3e-10 of the largest derivative of a kind, 1e-9
    within 1 cm of level; dR_c/dzeta_c to 1e-15 beyond that.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> s = sensitivity(air, 6000.0, 0.0, [0.0, 0.8])
    >>> (s.d_temperature[1, :3] * 1e9).round(3).tolist(), (s.d_h_g * 1e9).round(4).tolist()
    ([0.0, -413.824, 58.604], [-0.0, -11.8448])
    """
    jacobian_at = partial(air_jacobian, profile, anchor_height_m=anchor_height_m)
    traced, by_place = _derivatives(profile, (h_c, h_g, zeta_c, radius), jacobian_at)
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
    profile: Profile, rays: tuple[ArrayLike, ...], jacobian_at: Callable[[Array], Array]
) -> tuple[RayWeights, Array]:
    """Derivatives of R_c by the air, and (..., 3) by h_c, h_g [rad/m] and zeta_c.

    ``rays`` are h_c, h_g, zeta_c and the radius, which broadcast. ``jacobian_at`` is a function of
    heights (n,) [m] that returns the derivatives (n, k) of N there by k quantities; the returned
    ``weight`` (..., k) is by these quantities.
    """
    shape, columns = as_columns(*rays)
    all_rays, status = _bent_rays(profile, columns)
    traced = _rays_to_trace(all_rays, status)
    pieces = _pieces_of_rays(profile, all_rays.rows(traced))
    height_m = pieces.height_m.reshape(-1)
    jacobian = jacobian_at(height_m)
    count = status.size
    gradient = np.full((count, jacobian.shape[1]), np.nan)
    by_place = np.full((count, 3), np.nan)
    valid = np.zeros(count, dtype=bool)
    for rows in _blocks(traced, pieces):
        adjoints = trace_adjoints(pieces, all_rays.rows(rows))
        gradient[rows] = adjoints.weight @ jacobian
        by_place[rows] = adjoints.by_place
        valid[rows] = adjoints.valid
    derivatives = RayWeights(
        height_m=height_m,
        weight=gradient.reshape(*shape, jacobian.shape[1]),
        r_c=all_rays.r_c.reshape(shape),
        status=status.reshape(shape),
        valid=valid.reshape(shape),
    )
    return derivatives, by_place.reshape(*shape, 3)


def _bent_rays(profile: Profile, columns: list[Array]) -> tuple[Rays, NDArray[np.uint8]]:
    """Rays with their refraction angles, and the status of each, as from `bend`.

    ``columns`` are h_c, h_g, zeta_c and the radius, each (n,).
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
    """The pieces of the profile that rays pass; the lowest piece if there are no rays."""
    low = profile.bottom_m
    high = profile.bottom_m
    if rays.h_c.size:
        heights = np.stack([rays.h_c, rays.h_g])
        low = float(heights.min())
        high = float(heights.max())
    return pieces_between(profile, low, high)


def _blocks(traced: Rows, pieces: Pieces) -> Iterator[Rows]:
    """The row numbers ``traced`` in blocks of rays with at most `_NODES_AT_ONCE` nodes together."""
    nodes_of_ray = len(pieces.height_m) * MOST_NODES_OF_PIECE
    rays_at_once = max(1, _NODES_AT_ONCE // nodes_of_ray)
    for first in range(0, traced.size, rays_at_once):
        yield traced[first : first + rays_at_once]


def _rays_to_trace(rays: Rays, status: NDArray[np.uint8]) -> Rows:
    """Row numbers of the rays that have an angle and do not turn on their way.

    Sorted by steepness, the steepest first: blocks of steep rays need fewer nodes.
    """
    has_angle = np.isin(status, (OK, BEYOND_GRAZING))
    turns = (rays.h_g > rays.h_c) & (np.cos(rays.zeta_c) > 0.0)
    traced = np.flatnonzero(has_angle & ~turns)
    steepness = np.abs(np.cos(rays.zeta_c[traced]))
    return traced[np.argsort(-steepness, kind="stable")]
