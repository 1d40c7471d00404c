"""The leading mode of the air's covariance: what most of the air's error does to a block, by one s.

The errors of the air move all rays of a block together. With L L^T the covariance of the air's
state x, and E the matrix of what its columns do to rays that stand for the block (towards the nadir
and across, through the window), the first right singular vector u of E is the direction L u in
which one parameter explains most of their variance,

    x(s) = x + (s / sigma) L u,   variance_share = |E u|^2 / |E|^2.

That does not depend on the units of x, nor on air that no ray of the block passes. The unit of s is
the refraction: sigma^2 = |E u|^2 / |R|^2 over the rays, and a positive s turns them by more of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.profile import Profile
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures
from pipeline.refraction.ray import DEFAULT_RADIUS_M
from pipeline.refraction.uncertainty.air_sigma import OPEN, AirMode, CovarianceRoot, window_errors
from pipeline.refraction.uncertainty.sensitivity import sensitivity
from pipeline.units import Array, Integers, Mask

_MOST_EXPOSURES, _ACROSS = 24, 5  # and rays in five rows and columns of an image
_LARGEST_ZETA = np.radians(88.0)


@dataclass(frozen=True, eq=False)
class WindowRays:
    """Rays (n,) at cameras of heights ``h_c`` [m] and their nadir angles ``zeta_c`` [rad].

    ``kind`` (n,) is that of the window, `OPEN`, `SEALED` or `SCHEDULED`; ``towards``, ``across``
    how far a ray turns to the nadir and square to that per unit of dN_c - dN_cc (`window_turn`).
    """

    h_c: Array
    zeta_c: Array
    kind: Integers
    towards: Array
    across: Array


def window_turn(direction: Array, down: Array, normal: Array) -> tuple[Array, Array]:
    """How far rays turn towards the nadir, and across, per unit of dN_c - dN_cc at a plane window.

    (n, 3) unit vectors of the rays, the nadir and the window's normal in one frame. With n sin of
    the angle to the normal kept (Gyer 1996, Eq. 36) a ray d turns by normal / (normal . d) - d.

    >>> ray, down = np.array([[0.6, 0.0, 0.8]]), np.array([[0.0, 0.0, 1.0]])
    >>> [float(side[0].round(12)) for side in window_turn(ray, down, down)]  # tan(zeta)
    [0.75, 0.0]
    """
    cosine = np.einsum("ij,ij->i", down, direction)
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    safe = np.where(sine > 0.0, sine, 1.0)[:, None]
    to_nadir = (down - cosine[:, None] * direction) / safe
    out = np.einsum("ij,ij->i", normal, direction)
    towards = np.einsum("ij,ij->i", normal, to_nadir) / out
    across = np.einsum("ij,ij->i", normal, np.cross(direction, to_nadir)) / out
    return towards, across


def rays_of_exposures(
    exposures: Exposures, cameras: Sequence[tuple[Camera, Mask]], kinds: Integers
) -> WindowRays:
    """Rays evenly spread over the images of at most 24 exposures; those below the horizon.

    ``cameras`` each with the mask (s,) of its exposures, ``kinds`` (s,) of their windows. The
    directions are those before the window, which turns them by less than 1e-3.
    """
    side = (np.arange(_ACROSS) + 0.5) / _ACROSS
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    usable = np.flatnonzero(exposures.usable)
    drawn = usable[np.linspace(0, usable.size - 1, min(usable.size, _MOST_EXPOSURES)).astype(int)]
    rows, directions = [np.empty(0, np.int64)], [np.empty((0, 3))]
    for camera, exposed in cameras:
        u, v, covered = camera.rays(x * camera.width_px, y * camera.height_px)
        ray = np.stack([u, v, np.ones(u.size)], axis=1)[covered]
        of_camera = drawn[exposed[drawn]]
        rows.append(np.repeat(of_camera, len(ray)))
        directions.append(np.tile(ray / np.linalg.norm(ray, axis=1)[:, None], (of_camera.size, 1)))
    row, direction = np.concatenate(rows), np.concatenate(directions)
    down = -exposures.rotation[row, :, 2]
    zeta = np.arccos(np.clip(np.einsum("ij,ij->i", down, direction), -1.0, 1.0))
    below = zeta < _LARGEST_ZETA
    row, direction, down, zeta = row[below], direction[below], down[below], zeta[below]
    turns = window_turn(direction, down, exposures.normals[row])
    return WindowRays(exposures.height_m[row], zeta, kinds[row], *turns)


def leading_mode(
    profile: Profile,
    covariance: ProfileCovariance,
    rays: WindowRays,
    h_g: Array | float,
    *,
    radius: float = DEFAULT_RADIUS_M,
) -> AirMode | None:
    """The direction in the state of the air that explains most of what its errors do to rays.

    Parameters
    ----------
    rays : n rays that stand for all of a block.
    h_g : height or heights (n,) of their targets [m above sea level].
    radius : of the sphere [m].

    The error of a ray is that of R, and behind a plane window that of R - R_cc, in the ray's
    vertical plane and across it. None where no ray has an angle, or nothing is uncertain.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976")
    >>> variance = np.zeros(2 * air.layers.edge.size + 1)
    >>> variance[air.layers.edge.size] = 0.001**2  # of ln p
    >>> covariance = ProfileCovariance(air, 0.0, np.diag(variance))
    >>> zeta = np.array([0.2, 0.6, 1.0])
    >>> rays = WindowRays(3000.0 + 0.0 * zeta, zeta, np.zeros(3, np.int64), 0.0 * zeta, 0.0 * zeta)
    >>> mode = leading_mode(air, covariance, rays, 0.0)
    >>> mode.sigma, round(mode.variance_share, 6)
    (0.000999998, 1.0)
    >>> mode.state[air.layers.edge.size].round(6).item()  # more pressure, more refraction
    0.001
    """
    traced = sensitivity(
        profile, rays.h_c, h_g, rays.zeta_c, radius, anchor_height_m=covariance.anchor_height_m
    )
    good = traced.valid & (np.abs(traced.r_c) > 0.0)
    if not bool(good.any()):
        return None
    root = CovarianceRoot.of(covariance)
    turns = np.zeros((good.size, root.matrix.shape[1]))
    for kind in np.unique(rays.kind):
        if kind != OPEN:
            rows = rays.kind == kind
            turns[rows] = window_errors(profile, root, rays.h_c[rows], int(kind))
    seen_through = ((1.0 - traced.d_zeta_c) * rays.towards)[:, None] * turns
    along = (traced.gradient @ root.matrix + seen_through)[good]
    across = (rays.across[:, None] * turns)[good]
    _, length, direction = np.linalg.svd(np.concatenate([along, across]), full_matrices=False)
    if not np.any(length > 0.0):
        return None
    r = traced.r_c[good]
    u = direction[0] * (np.sign(r @ along @ direction[0]) or 1.0)
    # Six digits, as in the manifest, which then has it exactly.
    sigma = float(f"{length[0] / np.linalg.norm(r):.6g}")
    return AirMode(root.matrix @ u, sigma, float(length[0] ** 2 / np.sum(length**2)))
