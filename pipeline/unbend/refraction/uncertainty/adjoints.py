"""The adjoint of a ray: derivatives of R_c by the refractivity along it and by both its ends.

A small change of the air changes R_c by the sum of w_j dN_j; the adjoint gives the weights w.

With s = r_c sin zeta_c and nu = n / n_c the ray subtends at the earth's centre the angle (Gyer
1996, Eq. 1 and 12)

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
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.profile import Profile
from unbend.refraction.ray_table import cut
from unbend.units import Array, Mask, Rows

# Pieces of the profile on which refractivity and its perturbations are polynomials of degree 5 in
# height: N is reproduced to 1e-13 of itself, to 1e-12 across an inversion of 5 K in 350 m.
_PIECE_M = 500.0
_NODES = 6

# The excess (n r - k) / n_c = nu r - s [m] is zero where a ray is level. m has a pole where it is
# zero; down to this excess the derivatives are good to 1e-9.
LEVEL_GUARD_M = 1e-3
MOST_NODES_OF_PIECE = 20
_COARSE = np.polynomial.legendre.leggauss(4)
_FINE = np.polynomial.legendre.leggauss(MOST_NODES_OF_PIECE)
_COARSE_GRADING = 0.4  # up to this ln of the ratio of the excess at a piece's ends 4 nodes suffice
_LEAST_GRADING = 1e-9  # in the place of zero, by which nothing can be divided

# Rays over less height than this get a closed limit: here it and the traced dR/dh err by the same
# 6e-8.
_SHORT_M = 1e-4
_SHORT_GUARD_M = 1.0  # of the excess of short rays

_ANGLES = math.pi * (np.arange(_NODES) + 0.5) / _NODES
_CHEBYSHEV = np.cos(_ANGLES)  # nodes on -1 to 1
# Values at the nodes -> coefficients of Chebyshev polynomials.
_DEGREES = np.arange(_NODES)[:, None]
_TO_COEFFICIENTS = (2.0 / _NODES) * np.cos(_DEGREES * _ANGLES)
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
    """Rays (n,) with their refraction angles."""

    h_c: Array  # height of the camera [m]
    h_g: Array  # height of the target [m]
    zeta_c: Array  # nadir angle at the camera [rad]
    radius: Array  # of the sphere [m]
    r_c: Array  # refraction angle [rad]

    def rows(self, which: Rows) -> Rays:
        """The rays with the numbers ``which``."""
        return Rays(*(column[which] for column in self))


class _End(NamedTuple):
    """An end of each ray (n,), at the camera or at the target."""

    piece: Rows  # number of the piece that contains the end
    polynomials: Array  # (n, 6) Chebyshev polynomials there
    refractivity: Array


class _Nodes(NamedTuple):
    """Nodes of rays (n,) in the pieces (p,) of a profile."""

    height_m: Array  # (n, p, j)
    step_m: Array  # (n, p, j) weights of integrals over height
    is_inside: Mask  # (n, p, 1) whether a ray passes a piece
    least_excess: Array  # (n,) smallest excess at the ends of a ray in the pieces [m]


class _Integrals(NamedTuple):
    """Integrals along rays (n,), m as in the module's equations."""

    theta: Array  # angle subtended at the earth's centre [rad]
    by_s: Array  # of m dh, which is d(theta)/ds [1/m]
    moments: Array  # (n, p, 6) of m / n times each Chebyshev polynomial of each piece
    least_excess: Array  # smallest excess at the nodes and ends of a ray [m]


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

    weight: Array  # (n, p * 6) by N at all nodes; the derivative by the camera's N is included
    by_place: Array  # (n, 3) by h_c, h_g [rad/m] and zeta_c
    valid: Mask


def pieces_between(profile: Profile, low: float, high: float) -> Pieces:
    """The pieces of a profile that cover the heights from ``low`` to ``high`` [m]."""
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
    slope_of_6 = np.pad(slope, ((0, 0), (0, 1)))  # of one degree less: a last coefficient of 0
    return Pieces(
        edge_m=edge,
        height_m=height,
        coefficient=coefficient,
        slope=slope_of_6,
    )


def trace_adjoints(pieces: Pieces, rays: Rays) -> _Adjoints:
    """The adjoint of each ray, by Gauss-Legendre in each piece of the profile.

    Rays are not valid if they turn between their ends, or if their excess is anywhere on the way at
    most `LEVEL_GUARD_M`, or `_SHORT_GUARD_M` where camera and target have nearly one height.
    """
    camera = _end_of_rays(pieces, rays.h_c, rays.h_g)
    integrals = _integrals(pieces, rays, camera.refractivity)
    chord = _chord(rays, integrals.theta)
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    by_theta = r_g * chord.cos_beta / chord.length  # psi'
    weight = _weights_of_nodes(rays, integrals, by_theta, camera)

    slope_c = np.sum(pieces.slope[camera.piece] * camera.polynomials, axis=1)
    gradient_c = slope_c / (1.0 + camera.refractivity)  # N_c' / n_c
    d_zeta_c = 1.0 - by_theta * r_c * np.cos(rays.zeta_c) * integrals.by_s
    traced_by_place = (
        _by_camera_height(rays, gradient_c, d_zeta_c, chord),
        _by_target_height(pieces, rays, camera.refractivity, chord),
        d_zeta_c,
    )
    is_short = np.abs(rays.h_c - rays.h_g) < _SHORT_M
    guard_m = np.where(is_short, _SHORT_GUARD_M, LEVEL_GUARD_M)
    valid = integrals.least_excess > guard_m
    weight[~valid] = np.nan
    by_place = np.where(is_short, _limit_of_short_rays(rays, gradient_c), traced_by_place)
    by_place = np.where(valid, by_place, np.nan)
    return _Adjoints(weight, by_place.T, valid)


def _chord(rays: Rays, theta: Array) -> _Chord:
    """The chords of rays that subtend ``theta`` (n,) [rad] at the earth's centre."""
    fall = rays.h_c - rays.h_g
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    sagitta = 2.0 * np.sin(0.5 * theta) ** 2  # 1 - cos(theta)
    length = np.sqrt(fall * fall + 2.0 * r_c * r_g * sagitta)
    length[length == 0.0] = 1.0
    cos_beta = (fall - r_c * sagitta) / length
    return _Chord(length, cos_beta)


def _weights_of_nodes(rays: Rays, integrals: _Integrals, by_theta: Array, camera: _End) -> Array:
    """(n, p * 6) derivatives of R_c by N at the nodes of all pieces.

    They are psi' s times the integral of m (dN / n - dN_c / n_c); ``by_theta`` is psi', ``camera``
    the end of the rays there.
    """
    r_c = rays.radius + rays.h_c
    scale = by_theta * r_c * np.sin(rays.zeta_c)
    weight = (scale[:, None, None] * integrals.moments) @ _TO_COEFFICIENTS
    by_camera = scale * integrals.by_s / (1.0 + camera.refractivity)
    rows = np.arange(scale.size)
    by_polynomials = by_camera[:, None] * camera.polynomials
    weight[rows, camera.piece] -= by_polynomials @ _TO_COEFFICIENTS
    return weight.reshape(scale.size, -1)


def _by_camera_height(rays: Rays, gradient_c: Array, d_zeta_c: Array, chord: _Chord) -> Array:
    """dR_c/dh_c [rad/m]; ``gradient_c`` is N_c' / n_c, ``d_zeta_c`` is dR_c/dzeta_c."""
    r_c = rays.radius + rays.h_c
    tan_c = np.tan(rays.zeta_c)
    along_ray = tan_c * (d_zeta_c * (gradient_c + 1.0 / r_c) - gradient_c)
    return along_ray - np.sin(rays.r_c) / (chord.length * np.cos(rays.zeta_c))


def _limit_of_short_rays(rays: Rays, gradient_c: Array) -> tuple[Array, Array, Array]:
    """Derivatives of R_c by h_c, h_g and zeta_c of rays with nearly one height at both ends.

    Those of R_c = -tan(zeta_c) N' (h_c - h_g) / (2 n); ``gradient_c`` is N_c' / n_c.
    """
    fall = rays.h_c - rays.h_g
    tan_c = np.tan(rays.zeta_c)
    half = 0.5 * gradient_c
    by_h_c = -tan_c * half
    by_h_g = tan_c * half
    by_zeta_c = -(1.0 + tan_c * tan_c) * half * fall
    return by_h_c, by_h_g, by_zeta_c


def _chebyshev(u: Array) -> Array:
    """(6, ...) Chebyshev polynomials at u, from -1 to 1 in a piece."""
    polynomials = np.polynomial.chebyshev.chebvander(u, _NODES - 1)
    basis = np.asarray(polynomials, np.float64)
    return np.moveaxis(basis, -1, 0)


def _end_of_rays(pieces: Pieces, h: Array, other_end: Array) -> _End:
    """The end of each ray at the height ``h`` (n,) [m].

    Where pieces meet, the piece is that on the side of ``other_end`` (n,) [m], the height of the
    ray's other end.
    """
    edge = pieces.edge_m
    below = np.searchsorted(edge, h, side="left") - 1
    above = np.searchsorted(edge, h, side="right") - 1
    towards_other = np.where(other_end < h, below, above)
    piece = np.clip(towards_other, 0, edge.size - 2)
    low = edge[piece]
    high = edge[piece + 1]
    u = 2.0 * (h - low) / (high - low) - 1.0
    polynomials = _chebyshev(u).T
    return _End(
        piece=piece,
        polynomials=polynomials,
        refractivity=np.sum(pieces.coefficient[piece] * polynomials, axis=1),
    )


def _lift(rays: Rays) -> Array:
    """r_c (1 - sin zeta_c) (n,) [m], the excess at the camera, without cancellation."""
    r_c = rays.radius + rays.h_c
    cos_c = np.cos(rays.zeta_c)
    return r_c * cos_c * cos_c / (1.0 + np.sin(rays.zeta_c))


def _air_at(pieces: Pieces, rays: Rays, big_n_c: Array, h: Array) -> _Air:
    """The air at heights ``h`` (n, p, j) [m] of rays in each piece; the excess does not cancel.

    ``big_n_c`` (n,) is N at the camera:
    nu r - s = r (N - N_c) / n_c + (h - h_c) + r_c (1 - sin zeta_c).
    """
    low = pieces.edge_m[:-1, None]
    high = pieces.edge_m[1:, None]
    u = 2.0 * (h - low) / (high - low) - 1.0
    u = np.clip(u, -1.0, 1.0)
    basis = _chebyshev(u)
    refractivity = np.einsum("pa,abpj->bpj", pieces.coefficient, basis)
    h_c = rays.h_c[:, None, None]
    radius = rays.radius[:, None, None]
    big_n_c = big_n_c[:, None, None]
    lift = _lift(rays)[:, None, None]
    by_air = (radius + h) * (refractivity - big_n_c) / (1.0 + big_n_c)
    excess = by_air + (h - h_c) + lift
    return _Air(excess, refractivity, basis)


def _graded_nodes(pieces: Pieces, rays: Rays, big_n_c: Array) -> _Nodes:
    """Nodes of Gauss-Legendre in x at which the excess grows by equal ratios in each piece.

    That undoes the pole of m where the excess is zero: h = h_0 + scale (exp(grading x) - 1), x from
    0 to 1 in each piece, grading the logarithm of the ratio of the excess at its ends. ``big_n_c``
    (n,) is N at the camera.
    """
    ends = _ends_in_pieces(pieces, rays)
    width = np.diff(ends)
    is_inside = width > 0.0
    excess = _air_at(pieces, rays, big_n_c, ends).excess
    excess = np.where(is_inside, excess, np.inf)
    least = excess.min(axis=(1, 2))
    grading = _grading(excess, least)
    steepest = np.abs(grading).max(initial=0.0)
    nodes, weights = _COARSE if steepest < _COARSE_GRADING else _FINE
    x = 0.5 + 0.5 * nodes
    w = 0.5 * weights
    scale = width / np.expm1(grading)
    return _Nodes(
        height_m=ends[..., :1] + scale * np.expm1(grading * x),
        step_m=scale * grading * np.exp(grading * x) * w,  # dh/dx times the weight
        is_inside=is_inside,
        least_excess=least,
    )


def _integrals(pieces: Pieces, rays: Rays, big_n_c: Array) -> _Integrals:
    """The `_Integrals` along rays; ``big_n_c`` (n,) is N at the camera.

    Those of a ray that turns are meaningless: its ``least_excess`` is not positive.
    """
    nodes = _graded_nodes(pieces, rays, big_n_c)
    air = _air_at(pieces, rays, big_n_c, nodes.height_m)
    excess_inside = np.where(nodes.is_inside, air.excess, np.inf)
    least = np.minimum(nodes.least_excess, excess_inside.min(axis=(1, 2)))
    does_not_turn = (least > 0.0)[:, None, None]
    excess = np.where(nodes.is_inside & does_not_turn, air.excess, 1.0)
    r_c = rays.radius + rays.h_c
    s = (r_c * np.sin(rays.zeta_c))[:, None, None]
    big_n_c = big_n_c[:, None, None]
    nu = 1.0 + (air.refractivity - big_n_c) / (1.0 + big_n_c)
    root = np.sqrt(excess * (excess + 2.0 * s))  # sqrt(nu^2 r^2 - s^2)
    r = (excess + s) / nu
    theta_step = nodes.step_m * s / (r * root)
    m_step = nodes.step_m * nu * nu * r / root**3
    m_over_n = m_step / (1.0 + air.refractivity)
    return _Integrals(
        theta=np.sum(theta_step, axis=(1, 2)),
        by_s=m_step.sum(axis=(1, 2)),
        moments=np.einsum("abpj,bpj->bpa", air.basis, m_over_n),
        least_excess=least,
    )


def _ends_in_pieces(pieces: Pieces, rays: Rays) -> Array:
    """(n, p, 2) lowest and highest height [m] of a ray in each piece; equal if it is not there."""
    low = np.minimum(rays.h_c, rays.h_g)[:, None]
    high = np.maximum(rays.h_c, rays.h_g)[:, None]
    lower_end = np.clip(pieces.edge_m[:-1], low, high)
    upper_end = np.clip(pieces.edge_m[1:], low, high)
    return np.stack([lower_end, upper_end], axis=2)


def _grading(excess_at_ends: Array, least: Array) -> Array:
    """(n, p, 1) logarithm of the ratio of the excess at the ends of each piece, not zero.

    ``excess_at_ends`` (n, p, 2) is infinite where a ray does not pass a piece; ``least`` (n,) is
    the smallest of a ray. Pieces that a ray does not pass, and rays that turn, get a tiny value.
    """
    turns = (least <= 0.0)[:, None, None]
    has_no_logarithm = ~np.isfinite(excess_at_ends) | turns
    excess = np.where(has_no_logarithm, 1.0, excess_at_ends)
    grading = np.diff(np.log(excess))
    grading[np.abs(grading) < _LEAST_GRADING] = _LEAST_GRADING
    return np.asarray(grading)


def _by_target_height(pieces: Pieces, rays: Rays, big_n_c: Array, chord: _Chord) -> Array:
    """dR_c/dh_g [rad/m] = -sin(beta - z_g) / (chord cos z_g); ``big_n_c`` (n,) is N at the camera.

    beta - z_g comes from sin(beta) - sin(z_g), and that without cancellation from
    r_g sin(beta) = r_c sin(zeta_c - R_c) and n_g r_g sin(z_g) = n_c r_c sin(zeta_c).
    """
    big_n_g = _end_of_rays(pieces, rays.h_g, rays.h_c).refractivity
    r_c = rays.radius + rays.h_c
    r_g = rays.radius + rays.h_g
    s = r_c * np.sin(rays.zeta_c)
    by_air = r_g * (big_n_g - big_n_c) / (1.0 + big_n_c)
    fall = rays.h_c - rays.h_g
    excess = np.maximum(by_air - fall + _lift(rays), LEVEL_GUARD_M)
    down = np.copysign(1.0, np.cos(rays.zeta_c))  # 1 for rays downwards, -1 upwards
    root = np.sqrt(excess * (excess + 2.0 * s))
    cos_g = down * root / (excess + s)
    half = 0.5 * rays.r_c  # R_c / 2
    # r_c (sin(zeta_c) - sin(zeta_c - R_c)), without a difference of near numbers.
    sine_change = 2.0 * r_c * np.cos(rays.zeta_c - half) * np.sin(half)
    sine_difference = (s * (big_n_g - big_n_c) / (1.0 + big_n_g) - sine_change) / r_g
    cosine_sum = chord.cos_beta + cos_g
    beta_less_z_g = 2.0 * np.arctan2(sine_difference * down, cosine_sum * down)
    return np.asarray(-np.sin(beta_less_z_g) / (chord.length * cos_g))
