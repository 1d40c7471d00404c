"""What the covariance of the air makes of a refraction angle, in tables that a row looks up.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24), so that with the
state x of the profile, its covariance C and the gradients a = dN/dx

    sigma_R = tan(zeta) sqrt(v^T C v),   v = mean of a over the way - a_c.

That is tabulated finely, because sigma of N_c has the structure of the profile's knots; what the
sphere adds follows from traced rays (`pipeline.refraction.sensitivity`) and is a smooth factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.jacobian import air_jacobian
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.standard import standard_atmosphere
from pipeline.refraction.sensitivity import Sensitivity, sensitivity

Array = NDArray[np.float64]

# Heights at which gradients are kept, linear between them: 4e-4 of R over a way of 10 m.
_STEP_M = 12.5
# A layer's share between nodes of camera height: sigma of N_c sags by some 15 % between knots that
# hardly know of each other, and a straight line over an eighth errs by 0.3 %.
_PARTS_OF_A_LAYER = 8
_FINEST_M, _WIDEST_M = 4.0, 50.0
_AT_MOST_CAMERA_NODES = 600

# Ways are even in their root [m^0.5]: 4 m apart at 50 m, 46 m at 6 km.
_WAY_STEP = 0.3
_COARSE_STEP = 10.0
_SHORTEST_M = 1.0  # the limit of a short way; nearer there is no refraction to speak of
_INCIDENCE_STEP = 0.2  # of 1 / sqrt(cos z) at the ground
_STEEPEST = 0.05  # a tangent where the plane and the sphere are one
LEVEL_COSINE = 0.03
"""Cosine of the ray's nadir angle at the ground below which no sigma is given: 1.7 degrees."""

_MOST_RAYS = 1500  # traced for the factors: 0.2 s

_REFRACTIVITY_STEP_M = 5.0


@dataclass(frozen=True, eq=False)
class AirSigma:
    """Tables of sigma_R and dR/dzeta over camera height, way down to the target, and incidence.

    Parameters
    ----------
    camera_m : (c,) heights of cameras [m above sea level].
    way_first : root of the first way [m^0.5], ``way_step`` before the next.
    sigma, angle : (c, w) sigma_R / (tan(zeta) way) and R / (tan(zeta) way) in the plane [rad/m].
    coarse_step, incidence_step : spacing of the factors in the root of the way and in
        1 / sqrt(cos z) at the ground, from 1.
    factors : (f, j, k, 2) what the sphere multiplies sigma_R and dR/dzeta by, at even heights
        from the lowest camera to the highest.
    ground_m, refractivity : lowest height [m] and (n,) N above it, every 5 m.

    ``sigma`` is NaN throughout without a covariance.
    """

    camera_m: Array
    way_first: float
    sigma: Array
    angle: Array
    factors: Array
    ground_m: float
    refractivity: Array
    way_step: float = _WAY_STEP
    coarse_step: float = _COARSE_STEP
    incidence_step: float = _INCIDENCE_STEP
    refractivity_step_m: float = _REFRACTIVITY_STEP_M


def air_sigma(
    profile: Profile,
    covariance: ProfileCovariance | None,
    camera_heights_m: tuple[float, float],
    ground_heights_m: tuple[float, float],
    largest_zeta_rad: float,
    radius: float,
) -> AirSigma:
    """Tabulate sigma of R for the cameras and the ground of a block.

    Parameters
    ----------
    profile, covariance : the air, and how well it is known; None where that is not known.
    camera_heights_m, ground_heights_m : lowest and highest, above sea level [m].
    largest_zeta_rad : nadir angle beyond which nothing is seen; beyond 1.7 degrees above level at
        the ground the tables end anyway.
    radius : of the sphere [m].

    Against `sensitivity` with the same covariance, cameras within 150 m: 1 % of sigma_R up to 75
    degrees, 2 % at 80, 3 % at 85, on ways of 100 m and more; 8 % at 85 degrees and 6 km where the
    ground may lie anywhere. dR/dzeta to 1 %.
    """
    root = None if covariance is None else root_of(covariance.matrix)
    low, high = camera_heights_m
    top = min(ground_heights_m[1], high)
    bottom = min(max(ground_heights_m[0], profile.bottom_m), low - _SHORTEST_M)
    camera = _camera_nodes(profile, low, high)
    first, last = np.sqrt(max(low - top, _SHORTEST_M)), np.sqrt(high - bottom)
    ways = first + _WAY_STEP * np.arange(2 + max(0, int(np.ceil((last - first) / _WAY_STEP - 1))))
    anchor = 0.0 if covariance is None else covariance.anchor_height_m
    sigma, angle = _in_the_plane(profile, root, anchor, camera, ways**2)
    coarse = first + _COARSE_STEP * np.arange(2 + int((ways[-1] - first) / _COARSE_STEP))
    factors = _on_the_sphere(
        profile, root, anchor, low, high, coarse**2,
        _least_cosine(high, bottom, largest_zeta_rad, radius), radius,
    )  # fmt: skip
    heights = np.arange(bottom, high + _REFRACTIVITY_STEP_M, _REFRACTIVITY_STEP_M)
    heights = np.minimum(heights, profile.top_m)
    return AirSigma(
        camera, float(first), sigma, angle, factors, bottom, profile.refractivity(heights)
    )


def gradient_of(found: Sensitivity) -> Array:
    """(..., 2k + 1) derivatives of R_c in the order of `ProfileCovariance.matrix`."""
    level = found.d_log_pressure[..., None]
    return np.concatenate([found.d_temperature, level, found.d_vapour], axis=-1)


def root_of(matrix: Array) -> Array:
    """L with L L^T the covariance; eigenvalues that rounding left below zero are zero."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    value, vector = np.linalg.eigh(matrix / np.outer(safe, safe))
    kept = value > 1e-12 * value[-1]
    return np.asarray(scale[:, None] * vector[:, kept] * np.sqrt(value[kept]))


def _camera_nodes(profile: Profile, low: float, high: float) -> Array:
    """Heights of cameras [m]: each layer in eighths, because its edges are knots of sigma."""
    breaks = profile.break_heights_m
    inside = breaks[(breaks > low) & (breaks < high)]
    edges = np.concatenate([[low], inside, [max(high, low + _FINEST_M)]])
    layer = np.diff(breaks)[np.clip(np.searchsorted(breaks, edges[:-1], side="right") - 1, 0, None)]
    finest = max(_FINEST_M, float(edges[-1] - edges[0]) / _AT_MOST_CAMERA_NODES)
    step = np.clip(layer / _PARTS_OF_A_LAYER, finest, max(_WIDEST_M, finest))
    parts = np.maximum(1, np.ceil(np.diff(edges) / step)).astype(int)
    nodes = [
        np.linspace(a, b, count, endpoint=False)
        for a, b, count in zip(edges[:-1], edges[1:], parts, strict=True)
    ]
    return np.concatenate([*nodes, edges[-1:]])


def _in_the_plane(
    profile: Profile, root: Array | None, anchor_m: float, camera: Array, way: Array
) -> tuple[Array, Array]:
    """sigma_R and R over tan(zeta) and the way [rad/m], for cameras (c,) and ways (w,) [m]."""
    lowest = max(float(camera[0] - way[-1]), profile.bottom_m)
    breaks = profile.break_heights_m
    even = np.arange(lowest, camera[-1] + _STEP_M, _STEP_M)
    h = np.unique(np.concatenate([even, breaks[(breaks > lowest) & (breaks < even[-1])]]))
    h = h[h <= profile.top_m]
    kept = profile.refractivity(h)[:, None]
    if root is not None:
        air = air_jacobian(profile, h, anchor_m)
        state = np.column_stack([air.d_temperature, air.d_log_pressure, air.d_vapour])
        kept = np.column_stack([kept, state @ root])
    thickness = np.diff(h)
    steps = 0.5 * thickness[:, None] * (kept[1:] + kept[:-1])
    column = np.concatenate([np.zeros((1, kept.shape[1])), np.cumsum(steps, axis=0)])
    slope = np.diff(kept, axis=0) / thickness[:, None]

    def at(height: Array) -> tuple[Array, Array]:
        """Gradients at heights, and their integrals from the lowest up."""
        i = np.clip(np.searchsorted(h, height, side="right") - 1, 0, h.size - 2)
        rise = np.clip(height - h[i], 0.0, None)[:, None]
        return kept[i] + slope[i] * rise, column[i] + rise * (kept[i] + 0.5 * rise * slope[i])

    sigma = np.full((camera.size, way.size), np.nan)
    angle = np.empty(sigma.shape)
    at_camera, above = at(camera)
    for row, height in enumerate(camera):
        reach = np.maximum(np.minimum(way, height - lowest), _SHORTEST_M)[:, None]
        mean = (above[row] - at(height - reach[:, 0])[1]) / reach - at_camera[row]
        angle[row] = mean[:, 0] / reach[:, 0]
        if root is not None:
            sigma[row] = np.sqrt(np.einsum("ij,ij->i", mean[:, 1:], mean[:, 1:])) / reach[:, 0]
    return sigma, angle


def _least_cosine(high: float, bottom: float, zeta: float, radius: float) -> float:
    """Cosine of the largest nadir angle at the lowest ground that is looked at."""
    sine = np.sin(min(zeta, 0.5 * np.pi)) * (radius + high) / (radius + bottom)
    return max(LEVEL_COSINE, float(np.sqrt(max(0.0, 1.0 - sine * sine))))


def _on_the_sphere(
    profile: Profile,
    root: Array | None,
    anchor_m: float,
    low: float,
    high: float,
    way: Array,
    least: float,
    radius: float,
) -> Array:
    """(f, j, k, 2) factors that take sigma_R / tan(zeta) and dR/dzeta cos^2(zeta) to the sphere.

    That of dR/dzeta is geometry: it is taken from US 1976, whose R is nowhere zero; at 80 degrees
    it is 1.02 and at 85 degrees 1.09 in any air, within 0.01 (3 km).
    """
    count = 2 + int((least**-0.5 - 1.0) / _INCIDENCE_STEP)
    cosine = (1.0 + _INCIDENCE_STEP * np.arange(count)) ** -2.0
    cameras = int(np.clip(_MOST_RAYS // (count * way.size), 2, 2 + (high - low) / _WIDEST_M * 5))
    h_c = np.linspace(low, high, cameras)[:, None, None]
    lowest = max(profile.bottom_m, -5000.0)
    h_g = np.maximum(h_c - np.maximum(way, _SHORTEST_M)[None, :, None], lowest)
    h_g = np.minimum(h_g, h_c - _SHORTEST_M)
    sine = np.sqrt(1.0 - cosine * cosine) * (radius + h_g) / (radius + h_c)
    zeta = np.arcsin(np.minimum(sine, 1.0))
    zeta[..., 0] = np.arctan(_STEEPEST)
    usual = sensitivity(standard_atmosphere("us1976"), h_c, h_g, zeta, radius)
    slope = usual.d_zeta_c * np.cos(zeta) ** 2
    slope /= slope[..., :1]
    if root is None:
        return np.stack([np.full(slope.shape, np.nan), slope], axis=-1)
    found = sensitivity(profile, h_c, h_g, zeta, radius, anchor_m)
    spread = np.linalg.norm(gradient_of(found) @ root, axis=-1)
    sigma = spread / np.tan(zeta)
    return np.stack([sigma / sigma[..., :1], slope], axis=-1)
