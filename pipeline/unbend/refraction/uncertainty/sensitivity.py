"""Derivatives of the refraction angle by the air and by the places of camera and target.

A small change of the air moves R_c by sum of w_j dN_j: the adjoint of the ray gives the weights w,
the layers' closed forms dN (`unbend.atmosphere.covariance`). With C the covariance of
temperatures, ln p and e/p, and g the gradient here, sigma of R_c is sqrt(g^T C g).

With s = r_c sin zeta_c and nu = n / n_c the ray subtends (Gyer 1996, Eq. 1 and 12)

    theta = integral over h of s / (r sqrt(nu^2 r^2 - s^2)),   R_c = zeta_c - psi(theta, r_c, r_g),

psi the nadir angle of the chord (Eq. 10). Only nu enters, so that exactly

    dR_c = psi' s * integral of m(h) [dN(h) / n(h) - dN_c / n_c] dh,
    m = nu^2 r / (nu^2 r^2 - s^2)^(3/2),   psi' = d psi / d theta = r_g cos(beta) / chord,

beta the chord's angle at the target. The change of R_c with the place of the camera and of the
target follows from shifts along the ray, which leave it where it is; nothing is differenced:

    dR_c/dzeta_c = 1 - psi' r_c cos(zeta_c) * integral of m dh,
    dR_c/dh_g = -sin(beta - z_g) / (chord cos z_g),   z_g the ray's angle at the target,
    dR_c/dh_c = -tan(zeta_c) N_c' / n_c - sin(R_c) / (chord cos zeta_c)
                + tan(zeta_c) (N_c' / n_c + 1 / r_c) dR_c/dzeta_c.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.profile import Profile
from unbend.refraction.ray import DEFAULT_RADIUS_M, as_columns, bend
from unbend.refraction.ray_table import cut, ray_table
from unbend.refraction.status_codes import BEYOND_GRAZING, OK
from unbend.units import Array, Mask, Rows

# Pieces of the profile on which refractivity and its perturbations are polynomials of degree 5 in
# height: N is reproduced to 1e-13 of itself, to 1e-12 across an inversion of 5 K in 350 m.
_PIECE_M = 500.0
_NODES = 6

# (n r - k) / n_c [m], the excess, is a ray's distance from being level. m has a pole where it is
# zero; down to this excess the derivatives are good to 1e-9.
LEVEL_GUARD_M = 1e-3
_COARSE = np.polynomial.legendre.leggauss(4)
_FINE = np.polynomial.legendre.leggauss(20)
_COARSE_GRADING = 0.4  # ln of the ratio of the excess at the ends of a piece: up to it 4 nodes do
_LEAST_GRADING = 1e-9  # no division by zero

_BLOCK = 200_000  # quadrature nodes at a time: 10 MB of polynomials
# Rays shorter than this in height follow their closed limit: both err by 6e-8 in dR/dh.
_SHORT_M = 1e-4
_SHORT_GUARD_M = 1.0  # of the excess of short rays

_ANGLES = math.pi * (np.arange(_NODES) + 0.5) / _NODES
_CHEBYSHEV = np.cos(_ANGLES)  # nodes on -1 to 1
# Values at the nodes -> coefficients of Chebyshev polynomials.
_TO_COEFFICIENTS = (2.0 / _NODES) * np.cos(np.arange(_NODES)[:, None] * _ANGLES)
_TO_COEFFICIENTS[0] *= 0.5


class Pieces(NamedTuple):
    """A profile cut at its layers and every 500 m, with its refractivity as polynomials.

    ``edge_m`` (p + 1,) heights [m]; ``height_m`` (p, 6) nodes; ``coefficient`` (p, 6) of Chebyshev
    polynomials of N; ``slope`` (p, 6) those of its derivative with height [1/m].
    """

    edge_m: Array
    height_m: Array
    coefficient: Array
    slope: Array


class Rays(NamedTuple):
    """Rays (n,)."""

    h_c: Array  # height of the camera [m]
    h_g: Array  # height of the target [m]
    zeta_c: Array  # nadir angle at the camera [rad]
    radius: Array  # of the sphere [m]
    r_c: Array  # refraction angle [rad]

    def rows(self, which: Rows) -> Rays:
        """Some of the rays."""
        return Rays(*(column[which] for column in self))


class _Integrals(NamedTuple):
    """Integrals along rays (n,), m as in the module's equations."""

    theta: Array  # angle subtended at the earth's centre [rad]
    by_s: Array  # of m dh, which is d(theta)/ds [1/m]
    moments: Array  # (n, p, 6) of m / n times each Chebyshev polynomial of each piece
    least_excess: Array  # smallest excess that a node or an end has [m]


class _Air(NamedTuple):
    """The air at heights (n, p, j) in the pieces of a profile."""

    excess: Array  # nu r - s [m]
    refractivity: Array
    basis: Array  # (6, n, p, j) Chebyshev polynomials


class _Chord(NamedTuple):
    """The chord from the camera to the target of rays (n,)."""

    length: Array  # [m]; 1 where camera and target coincide
    cos_beta: Array  # of its angle at the target


class _Adjoints(NamedTuple):
    """Derivatives of R_c of rays (n,), NaN where they are not valid."""

    weight: Array  # (n, nodes) by N at the nodes, the share of the camera's N included
    by_place: Array  # (n, 3) by h_c, h_g [rad/m] and zeta_c
    valid: Mask


def pieces_between(profile: Profile, low: float, high: float) -> Pieces:
    """The pieces of a profile that heights from ``low`` to ``high`` [m] fall in."""
    edge = cut(profile.break_heights_m, _PIECE_M)
    edges_below = np.searchsorted(edge, low, side="left")
    edges_up_to = np.searchsorted(edge, high, side="right")
    first = int(np.clip(edges_below - 1, 0, edge.size - 2))
    last = int(np.clip(edges_up_to, first + 1, edge.size - 1))
    edge = edge[first : last + 1]
    half = 0.5 * np.diff(edge)[:, None]
    height = edge[:-1, None] + half * (1.0 + _CHEBYSHEV)
    coefficient = profile.refractivity(height) @ _TO_COEFFICIENTS.T
    slope = np.polynomial.chebyshev.chebder(coefficient, axis=1) / half
    return Pieces(
        edge_m=edge,
        height_m=height,
        coefficient=coefficient,
        slope=np.pad(slope, ((0, 0), (0, 1))),
    )


def trace_adjoints(pieces: Pieces, rays: Rays) -> _Adjoints:
    """The adjoint of each ray, by Gauss-Legendre in each piece of the profile.

    Not valid are rays that turn between their ends, or come within `LEVEL_GUARD_M` of being level
    on their way; within `_SHORT_GUARD_M` where camera and target have nearly one height.
    """
    camera, at_camera = _piece_at(pieces, rays.h_c, rays.h_g)
    n_c = np.sum(pieces.coefficient[camera] * at_camera, axis=1)
    integrals = _integrals(pieces, rays, n_c)
    chord = _chord(rays, integrals.theta)
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    by_theta = r_g * chord.cos_beta / chord.length  # psi'

    # psi' s times the integral of m (dN / n - dN_c / n_c).
    scale = by_theta * r_c * np.sin(rays.zeta_c)
    weight = (scale[:, None, None] * integrals.moments) @ _TO_COEFFICIENTS
    by_camera = scale * integrals.by_s / (1.0 + n_c)
    rows = np.arange(camera.size)
    weight[rows, camera] -= by_camera[:, None] * at_camera @ _TO_COEFFICIENTS
    weight = weight.reshape(camera.size, -1)

    gradient_c = np.sum(pieces.slope[camera] * at_camera, axis=1) / (1.0 + n_c)  # N_c' / n_c
    d_zeta_c = 1.0 - by_theta * r_c * np.cos(rays.zeta_c) * integrals.by_s
    by_place = (
        _by_camera_height(rays, gradient_c, d_zeta_c, chord),
        _by_target_height(pieces, rays, n_c, chord),
        d_zeta_c,
    )
    is_short = np.abs(rays.h_c - rays.h_g) < _SHORT_M
    guard_m = np.where(is_short, _SHORT_GUARD_M, LEVEL_GUARD_M)
    valid = integrals.least_excess > guard_m
    weight[~valid] = np.nan
    by_place = np.where(is_short, _limit_of_short_rays(rays, gradient_c), by_place)
    by_place = np.where(valid, by_place, np.nan)
    return _Adjoints(weight, by_place.T, valid)


def _chord(rays: Rays, theta: Array) -> _Chord:
    """The chords of rays that subtend ``theta`` (n,) [rad]."""
    fall = rays.h_c - rays.h_g
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    sagitta = 2.0 * np.sin(0.5 * theta) ** 2
    length = np.sqrt(fall * fall + 2.0 * r_c * r_g * sagitta)
    length[length == 0.0] = 1.0
    cos_beta = (fall - r_c * sagitta) / length
    return _Chord(length, cos_beta)


def _by_camera_height(rays: Rays, gradient_c: Array, d_zeta_c: Array, chord: _Chord) -> Array:
    """dR_c/dh_c [rad/m]; ``gradient_c`` is N_c' / n_c, ``d_zeta_c`` is dR_c/dzeta_c."""
    r_c = rays.radius + rays.h_c
    tan_c = np.tan(rays.zeta_c)
    along_ray = tan_c * (d_zeta_c * (gradient_c + 1.0 / r_c) - gradient_c)
    return along_ray - np.sin(rays.r_c) / (chord.length * np.cos(rays.zeta_c))


def _limit_of_short_rays(rays: Rays, gradient_c: Array) -> tuple[Array, Array, Array]:
    """Derivatives by h_c, h_g and zeta_c of R_c = -tan(zeta_c) N' (h_c - h_g) / (2 n)."""
    fall = rays.h_c - rays.h_g
    tan_c = np.tan(rays.zeta_c)
    half = 0.5 * gradient_c
    return -tan_c * half, tan_c * half, -(1.0 + tan_c * tan_c) * half * fall


def _basis(u: Array) -> Array:
    """(6, ...) Chebyshev polynomials at u."""
    polynomials = np.polynomial.chebyshev.chebvander(u, _NODES - 1)
    basis = np.asarray(polynomials, np.float64)
    return np.moveaxis(basis, -1, 0)


def _piece_at(pieces: Pieces, h: Array, other_end: Array) -> tuple[Rows, Array]:
    """The piece that holds the end ``h`` of a ray, and the polynomials (rays, 6) there.

    Where pieces meet, it is that on the side of the ray's other end.
    """
    edge = pieces.edge_m
    below = np.searchsorted(edge, h, side="left") - 1
    above = np.searchsorted(edge, h, side="right") - 1
    towards_other = np.where(other_end < h, below, above)
    piece = np.clip(towards_other, 0, edge.size - 2)
    low = edge[piece]
    high = edge[piece + 1]
    u = 2.0 * (h - low) / (high - low) - 1.0
    return piece, _basis(u).T


def _lift(rays: Rays) -> Array:
    """r_c (1 - sin zeta_c) [m]."""
    r_c = rays.radius + rays.h_c
    cos_c = np.cos(rays.zeta_c)
    return r_c * cos_c * cos_c / (1.0 + np.sin(rays.zeta_c))


def _air_at(pieces: Pieces, rays: Rays, n_c: Array, h: Array) -> _Air:
    """The air at heights ``h`` (n, p, j) [m] in each piece, the excess without cancellation.

    nu r - s = r (N - N_c) / n_c + (h - h_c) + r_c (1 - sin zeta_c).
    """
    low = pieces.edge_m[:-1, None]
    high = pieces.edge_m[1:, None]
    u = np.clip(2.0 * (h - low) / (high - low) - 1.0, -1.0, 1.0)
    basis = _basis(u)
    refractivity = np.einsum("pa,abpj->bpj", pieces.coefficient, basis)
    h_c = rays.h_c[:, None, None]
    radius = rays.radius[:, None, None]
    n_c = n_c[:, None, None]
    lift = _lift(rays)[:, None, None]
    by_air = (radius + h) * (refractivity - n_c) / (1.0 + n_c)
    excess = by_air + (h - h_c) + lift
    return _Air(excess, refractivity, basis)


def _integrals(pieces: Pieces, rays: Rays, n_c: Array) -> _Integrals:
    """The `_Integrals` along rays, by nodes at which the excess grows by equal ratios.

    That undoes the pole of m where the excess is zero: h = h_0 + scale (exp(grading x) - 1), x from
    0 to 1 in each piece, grading the logarithm of the ratio of the excess at its ends.
    """
    ends = _ends_in_pieces(pieces, rays)
    width = np.diff(ends)
    is_inside = width > 0.0
    excess_at_ends = np.where(is_inside, _air_at(pieces, rays, n_c, ends).excess, np.inf)
    least_at_ends = excess_at_ends.min(axis=(1, 2))
    grading = _grading(excess_at_ends, least_at_ends)
    steepest = np.abs(grading).max(initial=0.0)
    nodes, weights = _COARSE if steepest < _COARSE_GRADING else _FINE
    x = 0.5 + 0.5 * nodes
    w = 0.5 * weights
    scale = width / np.expm1(grading)
    h = ends[..., :1] + scale * np.expm1(grading * x)
    step = scale * grading * np.exp(grading * x) * w  # weight times dh/dx

    air = _air_at(pieces, rays, n_c, h)
    excess_inside = np.where(is_inside, air.excess, np.inf)
    least = np.minimum(least_at_ends, excess_inside.min(axis=(1, 2)))
    does_not_turn = (least > 0.0)[:, None, None]
    excess = np.where(is_inside & does_not_turn, air.excess, 1.0)
    r_c = rays.radius + rays.h_c
    s = (r_c * np.sin(rays.zeta_c))[:, None, None]
    n_c = n_c[:, None, None]
    nu = 1.0 + (air.refractivity - n_c) / (1.0 + n_c)
    root = np.sqrt(excess * (excess + 2.0 * s))  # sqrt(nu^2 r^2 - s^2)
    r = (excess + s) / nu
    theta_step = step * s / (r * root)
    m_step = step * nu * nu * r / root**3
    m_over_n = m_step / (1.0 + air.refractivity)
    return _Integrals(
        theta=np.sum(theta_step, axis=(1, 2)),
        by_s=m_step.sum(axis=(1, 2)),
        moments=np.einsum("abpj,bpj->bpa", air.basis, m_over_n),
        least_excess=least,
    )


def _ends_in_pieces(pieces: Pieces, rays: Rays) -> Array:
    """(n, p, 2) heights [m] between which a ray is in each piece; equal where it is not there."""
    low = np.minimum(rays.h_c, rays.h_g)[:, None]
    high = np.maximum(rays.h_c, rays.h_g)[:, None]
    lower_end = np.clip(pieces.edge_m[:-1], low, high)
    upper_end = np.clip(pieces.edge_m[1:], low, high)
    return np.stack([lower_end, upper_end], axis=2)


def _grading(excess_at_ends: Array, least: Array) -> Array:
    """(n, p, 1) logarithm of the ratio of the excess at the ends of each piece, never zero.

    ``excess_at_ends`` (n, p, 2), infinite where a ray does not pass; ``least`` (n,) of a ray.
    """
    turns = (least <= 0.0)[:, None, None]
    has_none = ~np.isfinite(excess_at_ends) | turns
    excess = np.where(has_none, 1.0, excess_at_ends)
    grading = np.diff(np.log(excess))
    grading[np.abs(grading) < _LEAST_GRADING] = _LEAST_GRADING
    return np.asarray(grading)


def _by_target_height(pieces: Pieces, rays: Rays, n_c: Array, chord: _Chord) -> Array:
    """dR_c/dh_g [rad/m] = -sin(beta - z_g) / (chord cos z_g).

    beta - z_g comes from sin(beta) - sin(z_g), and that without cancellation from
    r_g sin(beta) = r_c sin(zeta_c - R_c) and n_g r_g sin(z_g) = n_c r_c sin(zeta_c).
    """
    target, at_target = _piece_at(pieces, rays.h_g, rays.h_c)
    n_g = np.sum(pieces.coefficient[target] * at_target, axis=1)
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    s = r_c * np.sin(rays.zeta_c)
    by_air = r_g * (n_g - n_c) / (1.0 + n_c)
    fall = rays.h_c - rays.h_g
    excess = np.maximum(by_air - fall + _lift(rays), LEVEL_GUARD_M)
    down = np.copysign(1.0, np.cos(rays.zeta_c))
    cos_g = down * np.sqrt(excess * (excess + 2.0 * s)) / (excess + s)
    half = 0.5 * rays.r_c
    turned = 2.0 * r_c * np.cos(rays.zeta_c - half) * np.sin(half)
    sine_difference = (s * (n_g - n_c) / (1.0 + n_g) - turned) / r_g
    cosine_sum = chord.cos_beta + cos_g
    beta_less_z_g = 2.0 * np.arctan2(sine_difference * down, cosine_sum * down)
    return np.asarray(-np.sin(beta_less_z_g) / (chord.length * cos_g))


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
    shape, (h_c, h_g, zeta_c, radius) = as_columns(*rays)
    is_angle = (zeta_c >= 0.0) & (zeta_c <= np.pi)
    safe = np.where(is_angle, zeta_c, np.nan)
    r_c, status = bend(ray_table(profile), h_c, h_g, np.sin(safe), np.cos(safe), radius=radius)
    every_ray = Rays(h_c, h_g, zeta_c, radius, r_c)
    traced = _rays_to_trace(every_ray, status)
    low = profile.bottom_m
    high = profile.bottom_m
    if traced.size:
        heights = np.stack([h_c, h_g])[:, traced]
        low = float(heights.min())
        high = float(heights.max())
    pieces = pieces_between(profile, low, high)
    height_m = pieces.height_m.reshape(-1)
    air = air_of(height_m)
    gradient = np.full((h_c.size, air.shape[1]), np.nan)
    by_place = np.full((h_c.size, 3), np.nan)
    valid = np.zeros(h_c.size, dtype=bool)
    pieces_of_ray = height_m.size // _NODES
    nodes_of_ray = pieces_of_ray * _FINE[0].size
    rays_at_once = max(1, _BLOCK // nodes_of_ray)
    for first in range(0, traced.size, rays_at_once):
        rows = traced[first : first + rays_at_once]
        adjoints = trace_adjoints(pieces, every_ray.rows(rows))
        gradient[rows] = adjoints.weight @ air
        by_place[rows] = adjoints.by_place
        valid[rows] = adjoints.valid
    derivatives = RayWeights(
        height_m=height_m,
        weight=gradient.reshape(*shape, air.shape[1]),
        r_c=r_c.reshape(shape),
        status=status.reshape(shape),
        valid=valid.reshape(shape),
    )
    return derivatives, by_place.reshape(*shape, 3)


def _rays_to_trace(rays: Rays, status: NDArray[np.uint8]) -> Rows:
    """The rays that have an angle and do not turn on their way.

    The steepest are first: blocks of them need fewer nodes.
    """
    has_angle = np.isin(status, (OK, BEYOND_GRAZING))
    turns = (rays.h_g > rays.h_c) & (np.cos(rays.zeta_c) > 0.0)
    traced = np.flatnonzero(has_angle & ~turns)
    steepness = np.abs(np.cos(rays.zeta_c[traced]))
    return traced[np.argsort(-steepness, kind="stable")]
