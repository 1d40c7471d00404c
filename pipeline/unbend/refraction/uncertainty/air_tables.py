"""Tables of sigma of the refraction angle, which rows of observations interpolate.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24), so that with the
state x of the profile, its covariance C and the gradients a = dN/dx

    sigma_R = tan(zeta) sqrt(v^T C v),   v = mean of a over the way - a_c.

That is tabulated finely, because sigma of N_c has the structure of the profile's knots; what the
sphere adds follows from traced rays (`sensitivity`) and is a smooth factor. What is tabulated for
rays behind a window stands in `sigmas`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.covariance import ProfileCovariance, air_jacobian
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.standard import standard_atmosphere
from unbend.refraction.kernels.columns import AirTables
from unbend.refraction.ray_table import cut
from unbend.refraction.uncertainty.sensitivity import sensitivity
from unbend.refraction.uncertainty.sigmas import AirMode, CovarianceRoot, cabin_errors
from unbend.units import Array

# Heights at which gradients are kept, linear between them: 4e-4 of R over a way of 10 m.
_STEP_M = 12.5
# A layer's share between nodes of camera height: sigma of N_c sags by some 15 % between knots that
# hardly correlate, and a straight line over an eighth errs by 0.3 %.
_PARTS_OF_A_LAYER = 8
_FINEST_M = 4.0  # between nodes of camera height
_WIDEST_M = 50.0
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
_NOTHING = 1e-30  # in the place of a sigma of zero, by which nothing can be divided
_LOWEST_TARGET_M = -5000.0
_CAMERAS_PER_WIDEST = 5  # heights of cameras at most, for rays that are traced


def air_sigma(
    profile: Profile,
    covariance: ProfileCovariance | None,
    camera_heights_m: tuple[float, float],
    ground_heights_m: tuple[float, float],
    *,
    largest_zeta_rad: float,
    radius: float,
    window_kinds: Sequence[int] = (),
    mode: AirMode | None = None,
) -> tuple[Array, AirTables]:
    """Tabulate sigma of R, and what the leading mode does, for the cameras and ground of a block.

    ``covariance`` is None where it is not known, ``mode`` its leading mode. Heights are the lowest
    and the highest above sea level [m], ``window_kinds`` those but for `OPEN` that are
    there, ``radius`` that of the sphere [m]. Nothing is seen beyond the nadir angle
    ``largest_zeta_rad``; beyond 1.7 degrees above level at the ground the tables end anyway.

    Returns the heights of cameras (c,) [m above sea level] that are tabulated, and the tables.

    Against `sensitivity` with the same covariance, cameras within 150 m: 1 % of sigma_R up to 75
    degrees, 2 % at 80, 3 % at 85, on ways of 100 m and more; 8 % at 85 degrees and 6 km where the
    ground may lie anywhere. dR/dzeta to 1 %.
    """
    root = None
    mode_sigma = np.nan
    if covariance is not None:
        root = CovarianceRoot.of(covariance).with_mode_first(mode)
    if mode is not None:
        mode_sigma = mode.sigma
    low, high = camera_heights_m
    top = min(ground_heights_m[1], high)
    lowest_ground = max(ground_heights_m[0], profile.bottom_m)
    bottom = min(lowest_ground, low - _SHORTEST_M)
    camera = _camera_nodes(profile, low, high)

    shortest = max(low - top, _SHORTEST_M)
    fine, coarse = _roots_of_ways(shortest, high - bottom)
    plane = _in_the_plane(profile, root, camera, fine**2, window_kinds)
    factors = _on_the_sphere(
        profile,
        root,
        camera_heights_m,
        coarse**2,
        least_cosine=_least_cosine(largest_zeta_rad, radius + high, radius + bottom),
        radius=radius,
    )
    heights = np.arange(bottom, high + _REFRACTIVITY_STEP_M, _REFRACTIVITY_STEP_M)
    heights = np.minimum(heights, profile.top_m)
    return camera, AirTables(
        way_first=float(fine[0]),
        way_step=_WAY_STEP,
        coarse_step=_COARSE_STEP,
        incidence_step=_INCIDENCE_STEP,
        factors=factors,
        ground_m=bottom,
        spacing_m=_REFRACTIVITY_STEP_M,
        refractivity=profile.refractivity(heights),
        mode_sigma=mode_sigma,
        **plane._asdict(),
    )


def _least_cosine(largest_zeta_rad: float, r_c: float, r_g: float) -> float:
    """Cosine of the nadir angle at the lowest ground of the ray with the largest one.

    Without refraction; at least `LEVEL_COSINE`.
    """
    zeta = min(largest_zeta_rad, 0.5 * np.pi)
    sine = np.sin(zeta) * r_c / r_g
    square_cosine = max(0.0, 1.0 - sine * sine)
    return max(LEVEL_COSINE, float(np.sqrt(square_cosine)))


def _roots_of_ways(shortest: float, longest: float) -> tuple[Array, Array]:
    """Roots of ways [m^0.5] between two [m] and beyond: fine for the plane, coarse for the sphere.

    Both begin with the shortest way.
    """
    first = np.sqrt(shortest)
    last = np.sqrt(longest)
    steps_between = np.ceil((last - first) / _WAY_STEP - 1)
    fine_steps = 2 + max(0, int(steps_between))
    fine = first + _WAY_STEP * np.arange(fine_steps)
    coarse_steps = 2 + int((fine[-1] - first) / _COARSE_STEP)
    coarse = first + _COARSE_STEP * np.arange(coarse_steps)
    return fine, coarse


def _camera_nodes(profile: Profile, low: float, high: float) -> Array:
    """(c,) heights of cameras to tabulate: each layer in eighths, its edges are knots of sigma."""
    breaks = profile.break_heights_m
    is_between = (breaks > low) & (breaks < high)
    highest = max(high, low + _FINEST_M)
    edges = np.concatenate([[low], breaks[is_between], [highest]])
    bottoms = edges[:-1]
    breaks_up_to = np.searchsorted(breaks, bottoms, side="right")
    layer = np.clip(breaks_up_to - 1, 0, None)
    thickness = np.diff(breaks)[layer]
    span = float(edges[-1] - edges[0])
    finest = max(_FINEST_M, span / _AT_MOST_CAMERA_NODES)
    widest = max(_WIDEST_M, finest)
    spacing = np.clip(thickness / _PARTS_OF_A_LAYER, finest, widest)
    return cut(edges, spacing)


class _PlaneTables(NamedTuple):
    """The tables of `AirTables` that follow from the plane form."""

    sigma: Array
    angle: Array
    behind: Array
    lean: Array
    mode: Array
    mode_lean: Array

    @classmethod
    def unknown(cls, cameras: int, ways: int, kinds: int) -> _PlaneTables:
        """For so many cameras, ways and kinds of windows, to be filled."""
        return cls(
            sigma=np.full((cameras, ways), np.nan),
            angle=np.full((cameras, ways), np.nan),
            behind=np.full((kinds, 2, cameras, ways), np.nan),
            lean=np.full((kinds, cameras), np.nan),
            mode=np.full((cameras, ways), np.nan),
            mode_lean=np.full((kinds, cameras), np.nan),
        )


def _in_the_plane(
    profile: Profile,
    root: CovarianceRoot | None,
    camera: Array,
    way: Array,
    kinds: Sequence[int],
) -> _PlaneTables:
    """The tables for ways (w,) [m]; the first column of ``root`` is the leading mode."""
    lowest, columns_at = columns_of_air(profile, root, camera[0] - way[-1], camera[-1])
    tables = _PlaneTables.unknown(camera.size, way.size, len(kinds))
    at_camera, integral_above = columns_at(camera)
    cabins = []
    if root is not None:
        cabins = [cabin_errors(profile, root, camera, kind) for kind in kinds]
    for row, height in enumerate(camera):
        reach = np.minimum(way, height - lowest)
        reach = np.maximum(reach, _SHORTEST_M)
        integral_below = columns_at(height - reach)[1]
        mean = (integral_above[row] - integral_below) / reach[:, None]
        tables.angle[row] = (mean[:, 0] - at_camera[row, 0]) / reach
        if root is None:
            continue
        errors = at_camera[row, 1:]
        by_air = (mean[:, 1:] - errors) / reach[:, None]
        tables.mode[row] = by_air[:, 0]
        tables.sigma[row] = _lengths(by_air[:, 1:])
        for kind, cabin in enumerate(cabins):
            _fill_behind_window(
                tables,
                kind,
                row,
                mean_errors=mean[:, 1:],
                errors=errors,
                errors_in_cabin=cabin[row],
            )
    return tables


def _fill_behind_window(
    tables: _PlaneTables,
    kind: int,
    row: int,
    *,
    mean_errors: Array,
    errors: Array,
    errors_in_cabin: Array,
) -> None:
    """Fill what a window of one kind adds at one camera, x and y as in `sigmas`.

    Errors of N are those of the mean over each way (w, 1 + r), at the camera and in the cabin
    (1 + r,); their first column is the mode's.
    """
    lean = errors - errors_in_cabin
    x = mean_errors[:, 1:] - errors_in_cabin[1:]
    y = lean[1:]
    sigma_y = float(np.linalg.norm(y))
    tables.mode_lean[kind, row] = lean[0]
    tables.lean[kind, row] = sigma_y
    tables.behind[kind, 0, row] = _lengths(x)
    tables.behind[kind, 1, row] = x @ y / max(sigma_y, _NOTHING)


def _lengths(rows: Array) -> Array:
    """The length of each row."""
    square = np.einsum("ij,ij->i", rows, rows)
    return np.asarray(np.sqrt(square))


def columns_of_air(
    profile: Profile, root: CovarianceRoot | None, low: float, high: float
) -> tuple[float, Callable[[Array], tuple[Array, Array]]]:
    """The lowest height, and a function of heights (n,).

    That returns N and its errors (n, 1 + r), linear between the heights kept, and their integrals
    from the lowest.
    """
    lowest = max(low, profile.bottom_m)
    even = np.arange(lowest, high + _STEP_M, _STEP_M)
    breaks = profile.break_heights_m
    is_between = (breaks > lowest) & (breaks < even[-1])
    h = np.concatenate([even, breaks[is_between]])
    h = np.unique(h)
    h = h[h <= profile.top_m]
    value = profile.refractivity(h)[:, None]
    if root is not None:
        errors = air_jacobian(profile, h, root.anchor_m) @ root.matrix
        value = np.column_stack([value, errors])
    thickness = np.diff(h)[:, None]
    slope = np.diff(value, axis=0) / thickness
    steps = 0.5 * thickness * (value[1:] + value[:-1])
    integral = np.zeros(value.shape)
    integral[1:] = np.cumsum(steps, axis=0)

    def columns_at(height: Array) -> tuple[Array, Array]:
        heights_up_to = np.searchsorted(h, height, side="right")
        i = np.clip(heights_up_to - 1, 0, h.size - 2)
        rise = np.clip(height - h[i], 0.0, None)[:, None]
        value_at = value[i] + slope[i] * rise
        mean_value = value[i] + 0.5 * rise * slope[i]
        integral_at = integral[i] + rise * mean_value
        return value_at, integral_at

    return float(h[0]), columns_at


def _on_the_sphere(
    profile: Profile,
    root: CovarianceRoot | None,
    camera_heights_m: tuple[float, float],
    way: Array,
    *,
    least_cosine: float,
    radius: float,
) -> Array:
    """(f, j, k, 3) factors that take the plane to the sphere.

    Those of sigma_R / tan(zeta) and of dR/dzeta cos^2(zeta), and what the sphere adds to the mode's
    R / (tan(zeta) way). That of dR/dzeta is geometry: it is taken from US 1976, whose R is nowhere
    zero; at 80 degrees it is 1.02 and at 85 degrees 1.09 in any air, within 0.01 (3 km).
    """
    largest_incidence = least_cosine**-0.5
    count = 2 + int((largest_incidence - 1.0) / _INCIDENCE_STEP)
    cosine = np.asarray((1.0 + _INCIDENCE_STEP * np.arange(count)) ** -2.0, np.float64)
    h_c, h_g, zeta = _rays_on_the_sphere(profile, camera_heights_m, way, cosine, radius)
    usual = sensitivity(standard_atmosphere("us1976"), h_c, h_g, zeta, radius)
    slope = usual.d_zeta_c * np.cos(zeta) ** 2
    slope /= slope[..., :1]
    if root is None:
        unknown = np.full(slope.shape, np.nan)
        return np.stack([unknown, slope, unknown], axis=-1)
    traced = sensitivity(
        profile,
        h_c,
        h_g,
        zeta,
        radius,
        anchor_height_m=root.anchor_m,
    )
    tangent = np.tan(zeta)[..., None]
    by_air = (traced.gradient @ root.matrix) / tangent
    sigma = np.linalg.norm(by_air[..., 1:], axis=-1)
    mode = by_air[..., 0] / (h_c - h_g)
    columns = [
        sigma / sigma[..., :1],
        slope,
        mode - mode[..., :1],
    ]
    return np.stack(columns, axis=-1)


def _rays_on_the_sphere(
    profile: Profile,
    camera_heights_m: tuple[float, float],
    way: Array,
    cosine: Array,
    radius: float,
) -> tuple[Array, Array, Array]:
    """h_c (f, 1, 1), h_g (f, j, 1) [m] and zeta_c (f, j, k) [rad] of some 1500 rays.

    ``way`` (j,) [m] are ways down, ``cosine`` (k,) those of nadir angles at the ground. The first
    angle is steep.
    """
    low, high = camera_heights_m
    most_cameras = 2 + (high - low) / _WIDEST_M * _CAMERAS_PER_WIDEST
    rays_of_camera = cosine.size * way.size
    cameras = int(np.clip(_MOST_RAYS // rays_of_camera, 2, most_cameras))
    h_c = np.linspace(low, high, cameras)[:, None, None]
    lowest = max(profile.bottom_m, _LOWEST_TARGET_M)
    down = np.maximum(way, _SHORTEST_M)[None, :, None]
    h_g = np.maximum(h_c - down, lowest)
    h_g = np.minimum(h_g, h_c - _SHORTEST_M)
    sine_at_ground = np.sqrt(1.0 - cosine * cosine)
    sine = sine_at_ground * (radius + h_g) / (radius + h_c)
    zeta = np.arcsin(np.minimum(sine, 1.0))
    zeta[..., 0] = np.arctan(_STEEPEST)
    return h_c, h_g, zeta
