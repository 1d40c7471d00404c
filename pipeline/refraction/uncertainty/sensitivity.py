"""Derivatives of the refraction angle by the air and by the places of camera and target.

A small change of the air moves R_c by sum of w_j dN_j: the adjoint of the ray gives the weights w
(`adjoint`), the layers' closed forms give dN (`pipeline.atmosphere.covariance`).
Both are derived, not differenced. With C the covariance of temperatures, ln p and e/p, and g the
gradient here, sigma of R_c is sqrt(g^T C g).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.atmosphere.covariance import air_jacobian
from pipeline.atmosphere.profile import Profile
from pipeline.refraction.ray import DEFAULT_RADIUS_M, as_columns, bend
from pipeline.refraction.ray_table import ray_table
from pipeline.refraction.status_codes import BEYOND_GRAZING, OK
from pipeline.refraction.uncertainty.adjoint import (
    Adjoints,
    Pieces,
    Rays,
    blocks_of,
    pieces_between,
    trace_adjoints,
)
from pipeline.units import Array, Mask, Rows


@dataclass(frozen=True, eq=False)
class RayWeights:
    """The change of R_c with refractivity: dR_c = weight @ dN.

    Parameters
    ----------
    height_m : (n,) heights [m above sea level], the same for all rays.
    weight : (..., n) derivative of R_c with respect to N at these heights [rad]. The camera's
        refractivity, interpolated between them, is included: N to N + c (1 + N) changes nothing.
    r_c : (...) refraction angle [rad].
    status : (...) codes of `pipeline.refraction.status_codes`.
    valid : (...) false where a weight is NaN.
    """

    height_m: Array
    weight: Array
    r_c: Array
    status: NDArray[np.uint8]
    valid: Mask


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of R_c; rows of rays that are not ``valid`` are NaN.

    Parameters
    ----------
    edge_height_m : (m + 1,) heights of the layers' edges [m above sea level].
    r_c : (...) refraction angle [rad].
    d_temperature : (..., m + 1) with respect to T_M at the edges [rad/K], e/p held, pressure
        following by hydrostatics from the anchor.
    d_vapour : (..., m + 1) with respect to e/p at the edges [rad], T_M held.
    d_log_pressure, d_pressure : (...) with respect to ln p [rad] and p [rad/Pa] at the anchor.
    d_h_c, d_h_g : (...) with respect to the heights of camera and target [rad/m], the air held.
    d_zeta_c : (...) with respect to the apparent nadir angle at the camera.
    status : (...) codes of `pipeline.refraction.status_codes`.
    valid : (...).

    `pipeline.atmosphere.covariance.air_jacobian` has the formulas from T_M to a thermometer's T.
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

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> ray = ray_weights(air, 6000.0, 0.0, 0.8)
    >>> one_percent_denser = ray.weight @ (0.01 * air.refractivity(ray.height_m))
    >>> (ray.r_c * 1e6).round(4).item(), (one_percent_denser * 1e6).round(4).item()
    (60.6689, 0.6065)
    """
    batch = _traced(profile, h_c, h_g, zeta_c, radius)
    weight = np.full((batch.status.size, batch.pieces.height_m.size), np.nan)
    valid = np.zeros(batch.status.size, dtype=bool)
    for rows, adjoints in batch.adjoints():
        weight[rows], valid[rows] = adjoints.weight, adjoints.valid
    shape = batch.shape
    return RayWeights(
        batch.pieces.height_m.reshape(-1),
        weight.reshape(*shape, weight.shape[1]),
        batch.r_c.reshape(shape),
        batch.status.reshape(shape),
        valid.reshape(shape),
    )


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

    Parameters
    ----------
    profile : the air, of m layers.
    h_c, h_g : heights of camera and target above sea level [m]; broadcast with the others.
    zeta_c : apparent nadir angle at the camera [rad], 0 to pi.
    radius : of the sphere [m].
    anchor_height_m : where pressure stays as it is when temperatures change [m above sea level].

    Valid for rays that have an angle and do not turn on their way, down to 1 mm of n r from being
    level (2e-7 deg at 10 km over sea level), where the derivatives become infinite. R_c is linear
    only in changes that move n r by less than its distance from there: 1 K moves it by some 6 m.
    Of two crossings of h_g the near one is meant. A camera or target where layers meet has the
    derivatives on the ray's side. Raises `PhysicsError` for an anchor outside the profile.

    Against differences in 30-digit arithmetic: 3e-10 of the largest derivative of a kind, 1e-9
    within 1 cm of level; dR_c/dzeta_c to 1e-15 beyond that.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> s = sensitivity(air, 6000.0, 0.0, [0.0, 0.8])
    >>> (s.d_temperature[1, :3] * 1e9).round(3).tolist(), (s.d_h_g * 1e9).round(4).tolist()
    ([0.0, -413.824, 58.604], [-0.0, -11.8448])
    """
    batch = _traced(profile, h_c, h_g, zeta_c, radius)
    air = air_jacobian(profile, batch.pieces.height_m.reshape(-1), anchor_height_m)
    edges = profile.layers.edge.size
    gradient = np.full((batch.status.size, air.shape[1]), np.nan)
    place = np.full((batch.status.size, 3), np.nan)
    valid = np.zeros(batch.status.size, dtype=bool)
    for rows, adjoints in batch.adjoints():
        gradient[rows] = adjoints.weight @ air
        place[rows] = np.stack([adjoints.d_h_c, adjoints.d_h_g, adjoints.d_zeta_c], axis=1)
        valid[rows] = adjoints.valid
    shape = batch.shape
    d_h_c, d_h_g, d_zeta_c = (column.reshape(shape) for column in place.T)
    d_log_pressure = gradient[:, edges].reshape(shape)
    return Sensitivity(
        edge_height_m=profile.break_heights_m,
        r_c=batch.r_c.reshape(shape),
        d_temperature=gradient[:, :edges].reshape(*shape, edges),
        d_vapour=gradient[:, edges + 1 :].reshape(*shape, edges),
        d_log_pressure=d_log_pressure,
        d_pressure=d_log_pressure / profile.pressure(anchor_height_m),
        d_h_c=d_h_c,
        d_h_g=d_h_g,
        d_zeta_c=d_zeta_c,
        status=batch.status.reshape(shape),
        valid=valid.reshape(shape),
    )


@dataclass(frozen=True, eq=False)
class _Batch:
    """Broadcast rays of a ``shape``; ``rays`` are those of ``rows`` that can be differentiated."""

    shape: tuple[int, ...]
    r_c: Array
    status: NDArray[np.uint8]
    rows: Rows
    rays: Rays
    pieces: Pieces

    def adjoints(self) -> Iterator[tuple[Rows, Adjoints]]:
        """Block by block: which rows, and their adjoints."""
        for block in blocks_of(self.rows.size, self.pieces):
            rows = self.rows[block]
            yield rows, trace_adjoints(self.pieces, self.rays[block])


def _traced(
    profile: Profile, h_c: ArrayLike, h_g: ArrayLike, zeta_c: ArrayLike, radius: ArrayLike
) -> _Batch:
    """The rays, with their refraction angles."""
    shape, (h_c, h_g, zeta_c, radius) = as_columns(h_c, h_g, zeta_c, radius)
    safe = np.where((zeta_c >= 0.0) & (zeta_c <= np.pi), zeta_c, np.nan)
    r_c, status = bend(ray_table(profile), h_c, h_g, np.sin(safe), np.cos(safe), radius=radius)
    turns = (h_g > h_c) & (np.cos(safe) > 0.0)
    rows = np.flatnonzero(np.isin(status, (OK, BEYOND_GRAZING)) & ~turns)
    # The steepest first: blocks of them need fewer nodes.
    rows = rows[np.argsort(-np.abs(np.cos(zeta_c[rows])), kind="stable")]
    rays = Rays(h_c, h_g, zeta_c, radius, r_c)[rows]
    heights = np.concatenate([rays.h_c, rays.h_g]) if rows.size else np.array([profile.bottom_m])
    pieces = pieces_between(profile, float(heights.min()), float(heights.max()))
    return _Batch(shape, r_c, status, rows, rays, pieces)
