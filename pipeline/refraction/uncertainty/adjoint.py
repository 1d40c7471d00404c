"""The adjoint of a ray: the derivative of its refraction angle by refractivity along the way.

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
from dataclasses import dataclass

import numpy as np

from pipeline.atmosphere.profile import Profile
from pipeline.refraction.ray_table import cut
from pipeline.units import Array, Mask, Rows

# Pieces of the profile on which refractivity and its perturbations are polynomials of degree 5 in
# height: N is reproduced to 1e-13 of itself, to 1e-12 across an inversion of 5 K in 350 m.
_PIECE_M = 500.0
_NODES = 6

# (n r - k) / n_c [m], the excess, is a ray's distance from being level. m has a pole where it is
# zero; down to this excess the derivatives are good to 1e-9.
LEVEL_GUARD_M = 1e-3
_COARSE, _FINE = (np.polynomial.legendre.leggauss(count) for count in (4, 20))
_COARSE_GRADING = 0.4  # ln of the ratio of the excess at the ends of a piece

_BLOCK = 200_000  # quadrature nodes at a time: 10 MB of polynomials
# Rays shorter than this in height follow their closed limit: both err by 6e-8 in dR/dh.
_SHORT_M = 1e-4

_ANGLES = math.pi * (np.arange(_NODES) + 0.5) / _NODES
_CHEBYSHEV = np.cos(_ANGLES)  # nodes on -1 to 1
# Values at the nodes -> coefficients of Chebyshev polynomials.
_TO_COEFFICIENTS = (2.0 / _NODES) * np.cos(np.arange(_NODES)[:, None] * _ANGLES)
_TO_COEFFICIENTS[0] *= 0.5


@dataclass(frozen=True, eq=False)
class Pieces:
    """A profile cut at its layers and every 500 m, with its refractivity as polynomials.

    ``edge_m`` (p + 1,) heights [m]; ``height_m`` (p, 6) nodes; ``coefficient`` (p, 6) of Chebyshev
    polynomials of N; ``slope`` (p, 6) those of its derivative with height [1/m].
    """

    edge_m: Array
    height_m: Array
    coefficient: Array
    slope: Array


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays as vectors of one length: heights [m], nadir angle at the camera [rad], radius [m], and
    the refraction angle [rad]."""

    h_c: Array
    h_g: Array
    zeta_c: Array
    radius: Array
    r_c: Array

    def __getitem__(self, which: Rows | slice) -> Rays:
        return Rays(*(a[which] for a in (self.h_c, self.h_g, self.zeta_c, self.radius, self.r_c)))


@dataclass(frozen=True, eq=False)
class Adjoints:
    """Derivatives of R_c of rays; NaN where not ``valid``.

    Parameters
    ----------
    weight : (rays, nodes) with respect to N at the nodes of `Pieces`, the camera's share included.
    d_zeta_c : (rays,) with respect to the apparent nadir angle.
    d_h_c, d_h_g : (rays,) with respect to the heights of camera and target [rad/m].
    valid : (rays,).
    """

    weight: Array
    d_zeta_c: Array
    d_h_c: Array
    d_h_g: Array
    valid: Mask


def pieces_between(profile: Profile, low: float, high: float) -> Pieces:
    """The pieces of a profile that heights from ``low`` to ``high`` [m] fall in."""
    edge = cut(profile.break_heights_m, _PIECE_M)
    first = int(np.clip(np.searchsorted(edge, low, side="left") - 1, 0, edge.size - 2))
    last = int(np.clip(np.searchsorted(edge, high, side="right"), first + 1, edge.size - 1))
    edge = edge[first : last + 1]
    half = 0.5 * np.diff(edge)[:, None]
    height = edge[:-1, None] + half * (1.0 + _CHEBYSHEV)
    coefficient = profile.refractivity(height) @ _TO_COEFFICIENTS.T
    slope = np.polynomial.chebyshev.chebder(coefficient, axis=1) / half
    return Pieces(edge, height, coefficient, np.pad(slope, ((0, 0), (0, 1))))


def blocks_of(count: int, pieces: Pieces) -> list[slice]:
    """Slices of ``count`` rays that keep the work on each within some tens of megabytes."""
    size = max(1, _BLOCK // (pieces.height_m.shape[0] * _FINE[0].size))
    return [slice(first, first + size) for first in range(0, count, size)]


def trace_adjoints(pieces: Pieces, rays: Rays) -> Adjoints:
    """The adjoint of each ray, by Gauss-Legendre in each piece of the profile.

    Rays must not turn between their ends. Not valid are those that come within `LEVEL_GUARD_M` of
    being level on their way.
    """
    camera, at_camera = _at(pieces, rays.h_c, rays.h_g)
    n_c = np.sum(pieces.coefficient[camera] * at_camera, axis=1)
    way = _integrals(pieces, rays, n_c)
    short = np.abs(rays.h_c - rays.h_g) < _SHORT_M
    valid = way.least > np.where(short, 1e4 * _SHORT_M, LEVEL_GUARD_M)

    # Length of the chord, one where camera and target coincide, and cos(beta).
    r_c, r_g = rays.radius + rays.h_c, rays.radius + rays.h_g
    fall, sagitta = rays.h_c - rays.h_g, 2.0 * np.sin(0.5 * way.theta) ** 2
    chord = np.sqrt(fall * fall + 2.0 * r_c * r_g * sagitta)
    chord[chord == 0.0] = 1.0
    cos_beta = (fall - r_c * sagitta) / chord
    by_theta = r_g * cos_beta / chord
    scale = by_theta * r_c * np.sin(rays.zeta_c)
    weight = (scale[:, None, None] * way.moments) @ _TO_COEFFICIENTS
    share = scale * way.by_s / (1.0 + n_c)
    weight[np.arange(camera.size), camera] -= share[:, None] * at_camera @ _TO_COEFFICIENTS
    weight = weight.reshape(camera.size, -1)
    weight[~valid] = np.nan

    d_zeta_c = 1.0 - by_theta * r_c * np.cos(rays.zeta_c) * way.by_s
    bend_c = np.sum(pieces.slope[camera] * at_camera, axis=1) / (1.0 + n_c)
    tan_c = np.tan(rays.zeta_c)
    d_h_c = tan_c * (d_zeta_c * (bend_c + 1.0 / r_c) - bend_c)
    d_h_c = d_h_c - np.sin(rays.r_c) / (chord * np.cos(rays.zeta_c))
    d_h_g = _by_target_height(pieces, rays, n_c, chord, cos_beta)
    # In the limit of a short ray R_c = -tan(zeta_c) N' (h_c - h_g) / (2 n).
    half = 0.5 * bend_c
    limit = -(1.0 + tan_c * tan_c) * half * fall, -tan_c * half, tan_c * half
    d_zeta_c, d_h_c, d_h_g = (
        np.where(valid, np.where(short, a, b), np.nan)
        for a, b in zip(limit, (d_zeta_c, d_h_c, d_h_g), strict=True)
    )
    return Adjoints(weight, d_zeta_c, d_h_c, d_h_g, valid)


@dataclass(frozen=True, eq=False)
class _Way:
    """Integrals along rays: ``theta``, ``by_s`` of m dh = d theta / d s, ``moments`` (rays, p, 6)
    of m / n with the Chebyshev polynomials of each piece; ``least`` excess met [m]."""

    theta: Array
    by_s: Array
    moments: Array
    least: Array


def _basis(u: Array) -> Array:
    """(6, ...) Chebyshev polynomials at u."""
    basis = np.empty((_NODES, *u.shape))
    basis[0], basis[1] = 1.0, u
    for a in range(2, _NODES):
        basis[a] = 2.0 * u * basis[a - 1] - basis[a - 2]
    return basis


def _at(pieces: Pieces, h: Array, other: Array) -> tuple[Rows, Array]:
    """The piece that holds h, on the side of ``other``, and the polynomials (rays, 6) there."""
    edge = pieces.edge_m
    below = np.searchsorted(edge, h, side="left") - 1
    above = np.searchsorted(edge, h, side="right") - 1
    i = np.clip(np.where(other < h, below, above), 0, edge.size - 2)
    u = 2.0 * (h - edge[i]) / (edge[i + 1] - edge[i]) - 1.0
    return i, _basis(u).T


def _lift(rays: Rays) -> Array:
    """r_c (1 - sin zeta_c) [m]."""
    cos_c = np.cos(rays.zeta_c)
    return (rays.radius + rays.h_c) * cos_c * cos_c / (1.0 + np.sin(rays.zeta_c))


def _excess(pieces: Pieces, rays: Rays, n_c: Array, h: Array) -> tuple[Array, Array, Array]:
    """nu r - s [m] without cancellation, N and the polynomials, at ``h`` (rays, p, j)."""
    low, high = pieces.edge_m[:-1, None], pieces.edge_m[1:, None]
    basis = _basis(np.clip(2.0 * (h - low) / (high - low) - 1.0, -1.0, 1.0))
    n = np.einsum("pa,abpj->bpj", pieces.coefficient, basis)
    h_c, radius, n_c, lift = (a[:, None, None] for a in (rays.h_c, rays.radius, n_c, _lift(rays)))
    return (radius + h) * (n - n_c) / (1.0 + n_c) + (h - h_c) + lift, n, basis


def _integrals(pieces: Pieces, rays: Rays, n_c: Array) -> _Way:
    """Integrals with nodes at steps of equal ratio of the excess, which undoes the pole of m."""
    low = np.minimum(rays.h_c, rays.h_g)[:, None]
    high = np.maximum(rays.h_c, rays.h_g)[:, None]
    ends = np.stack([np.clip(e, low, high) for e in (pieces.edge_m[:-1], pieces.edge_m[1:])], 2)
    width = np.diff(ends)
    inside = width > 0.0
    excess = np.where(inside, _excess(pieces, rays, n_c, ends)[0], np.inf)
    least = excess.min(axis=(1, 2))
    excess[~np.isfinite(excess) | (least <= 0.0)[:, None, None]] = 1.0
    grading = np.diff(np.log(excess))
    grading[np.abs(grading) < 1e-9] = 1e-9
    x, w = _COARSE if np.abs(grading).max(initial=0.0) < _COARSE_GRADING else _FINE
    x, w = 0.5 + 0.5 * x, 0.5 * w
    scale = width / np.expm1(grading)
    excess, n, basis = _excess(pieces, rays, n_c, ends[..., :1] + scale * np.expm1(grading * x))
    step = scale * grading * np.exp(grading * x) * w
    least = np.minimum(least, np.where(inside, excess, np.inf).min(axis=(1, 2)))
    excess = np.where(inside & (least > 0.0)[:, None, None], excess, 1.0)

    s = ((rays.radius + rays.h_c) * np.sin(rays.zeta_c))[:, None, None]
    nu = 1.0 + (n - n_c[:, None, None]) / (1.0 + n_c[:, None, None])
    root = np.sqrt(excess * (excess + 2.0 * s))
    r = (excess + s) / nu
    density = step * nu * nu * r / root**3
    return _Way(
        np.sum(step * s / (r * root), axis=(1, 2)),
        density.sum(axis=(1, 2)),
        np.einsum("abpj,bpj->bpa", basis, density / (1.0 + n)),
        least,
    )


def _by_target_height(
    pieces: Pieces, rays: Rays, n_c: Array, chord: Array, cos_beta: Array
) -> Array:
    """dR_c/dh_g, with sin(beta) - sin(z_g) from r_g sin(beta) = r_c sin(zeta_c - R_c)."""
    target, at_target = _at(pieces, rays.h_g, rays.h_c)
    n_g = np.sum(pieces.coefficient[target] * at_target, axis=1)
    r_c, r_g = rays.radius + rays.h_c, rays.radius + rays.h_g
    s = r_c * np.sin(rays.zeta_c)
    excess = r_g * (n_g - n_c) / (1.0 + n_c) - (rays.h_c - rays.h_g) + _lift(rays)
    excess = np.maximum(excess, LEVEL_GUARD_M)
    down = np.copysign(1.0, np.cos(rays.zeta_c))
    cos_g = down * np.sqrt(excess * (excess + 2.0 * s)) / (excess + s)
    half = 0.5 * rays.r_c
    turned = 2.0 * r_c * np.cos(rays.zeta_c - half) * np.sin(half)
    sines = (s * (n_g - n_c) / (1.0 + n_g) - turned) / r_g
    bend_g = 2.0 * np.arctan2(sines * down, (cos_beta + cos_g) * down)
    return np.asarray(-np.sin(bend_g) / (chord * cos_g))
