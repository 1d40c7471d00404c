"""Tables of sigma of the refraction angle, which rows of observations interpolate.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24), so that with the
state x of the profile, its covariance C and the gradients a = dN/dx

    sigma_R = tan(zeta) sqrt(v^T C v),   v = mean of a over the way - a_c.

That is tabulated finely, because sigma of N_c has the structure of the profile's knots; what the
sphere adds follows from traced rays (`sensitivity`) and is a smooth factor. `sigmas` explains what
is tabulated for rays behind a window.
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

# Between heights at which gradients are kept, linear between them: errs by 4e-4 of R over a way of
# 10 m.
_STEP_M = 12.5
# Nodes of camera height in a layer: sigma of N_c is some 15 % smaller between knots that hardly
# correlate, and a straight line over an eighth errs by 0.3 %.
_NODES_OF_LAYER = 8
_FINEST_M = 4.0  # between nodes of camera height
_WIDEST_M = 50.0
_MOST_CAMERA_NODES = 600

# Ways are even in their root [m^0.5]: 4 m apart at 50 m, 46 m at 6 km.
_WAY_STEP = 0.3
_COARSE_STEP = 10.0
_SHORTEST_M = 1.0  # of tabulated ways; the refraction over less is negligible
_INCIDENCE_STEP = 0.2  # of 1 / sqrt(cos z) at the ground
_STEEP_TANGENT = 0.05  # tan(zeta) of rays for which plane and sphere agree
LEVEL_COSINE = 0.03
"""Cosine of the ray's nadir angle at the ground below which no sigma is given: 1.7 degrees."""

_MOST_RAYS = 1500  # traced for the factors: 0.2 s

_REFRACTIVITY_STEP_M = 5.0
_TINY_SIGMA = 1e-30  # in the place of zero, by which nothing can be divided
_LOWEST_TARGET_M = -5000.0
_TRACED_CAMERAS_PER_WIDEST = 5  # at most, for each `_WIDEST_M` between the lowest and the highest


def air_sigma_tables(
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

    covariance : of the profile's layers, None where it is not known: then sigmas are NaN.
    camera_heights_m, ground_heights_m : the lowest and the highest, above sea level [m].
    largest_zeta_rad : nadir angle beyond which no camera sees. The tables end at 1.7 degrees from
        level at the ground in any case.
    radius : of the sphere [m].
    window_kinds : all kinds of windows in the block except `OPEN`.
    mode : the leading mode of the covariance, None where that is not known.

    Returns the tabulated heights of cameras (c,) [m above sea level], and the tables.

    Against `sensitivity` with the same covariance, cameras within 150 m: 1 % of sigma_R up to 75
    degrees, 2 % at 80, 3 % at 85, on ways of 100 m and more; 8 % at 85 degrees and 6 km where the
    ground may be anywhere. dR/dzeta to 1 %.
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
    camera_m = _camera_nodes(profile, low, high)

    shortest = max(low - top, _SHORTEST_M)
    fine, coarse = _roots_of_ways(shortest, high - bottom)
    plane = _plane_tables(profile, root, camera_m, fine**2, window_kinds)
    factors = _sphere_factors(
        profile,
        root,
        camera_heights_m,
        coarse**2,
        least_cosine=_least_cosine(largest_zeta_rad, radius + high, radius + bottom),
        radius=radius,
    )
    heights = np.arange(bottom, high + _REFRACTIVITY_STEP_M, _REFRACTIVITY_STEP_M)
    heights = np.minimum(heights, profile.top_m)
    return camera_m, AirTables(
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
    """Cosine of a straight ray's nadir angle at the lowest ground; at least `LEVEL_COSINE`.

    The ray leaves the highest camera, ``r_c`` [m] from the earth's centre, at the nadir angle
    ``largest_zeta_rad``; the ground is ``r_g`` [m] from there.
    """
    zeta = min(largest_zeta_rad, 0.5 * np.pi)
    sine = np.sin(zeta) * r_c / r_g
    square_cosine = max(0.0, 1.0 - sine * sine)
    return max(LEVEL_COSINE, float(np.sqrt(square_cosine)))


def _roots_of_ways(shortest: float, longest: float) -> tuple[Array, Array]:
    """Square roots of ways [m^0.5] from ``shortest`` to at least ``longest`` [m], evenly spaced.

    Fine roots for the tables of the plane, coarse ones for the factors of the sphere.
    """
    first = np.sqrt(shortest)
    last = np.sqrt(longest)
    # At least the two roots between which values are interpolated, and up to the last way.
    roots_between = np.ceil((last - first) / _WAY_STEP - 1)
    fine_count = 2 + max(0, int(roots_between))
    fine = first + _WAY_STEP * np.arange(fine_count)
    coarse_count = 2 + int((fine[-1] - first) / _COARSE_STEP)
    coarse = first + _COARSE_STEP * np.arange(coarse_count)
    return fine, coarse


def _camera_nodes(profile: Profile, low: float, high: float) -> Array:
    """(c,) heights [m] of cameras to tabulate, from ``low`` to ``high`` [m].

    Each layer of the profile is cut in eighths, within limits: sigma has its knots at the edges of
    layers.
    """
    breaks = profile.break_heights_m
    is_between = (breaks > low) & (breaks < high)
    highest = max(high, low + _FINEST_M)
    edges = np.concatenate([[low], breaks[is_between], [highest]])
    bottoms = edges[:-1]
    breaks_up_to = np.searchsorted(breaks, bottoms, side="right")
    layer = np.clip(breaks_up_to - 1, 0, None)
    thickness = np.diff(breaks)[layer]
    span = float(edges[-1] - edges[0])
    finest = max(_FINEST_M, span / _MOST_CAMERA_NODES)
    widest = max(_WIDEST_M, finest)
    spacing = np.clip(thickness / _NODES_OF_LAYER, finest, widest)
    return cut(edges, spacing)


class _PlaneTables(NamedTuple):
    """The tables of `AirTables` that follow from the plane form; the fields are those of that."""

    sigma: Array
    angle: Array
    behind: Array
    lean: Array
    mode: Array
    mode_lean: Array

    @classmethod
    def unknown(cls, cameras: int, ways: int, kinds: int) -> _PlaneTables:
        """Tables of NaN, for these numbers of cameras, ways and kinds of windows."""
        return cls(
            sigma=np.full((cameras, ways), np.nan),
            angle=np.full((cameras, ways), np.nan),
            behind=np.full((kinds, 2, cameras, ways), np.nan),
            lean=np.full((kinds, cameras), np.nan),
            mode=np.full((cameras, ways), np.nan),
            mode_lean=np.full((kinds, cameras), np.nan),
        )


def _plane_tables(
    profile: Profile,
    root: CovarianceRoot | None,
    camera_m: Array,
    way_m: Array,
    kinds: Sequence[int],
) -> _PlaneTables:
    """The tables for cameras at heights (c,) [m], ways down (w,) [m] and kinds of windows.

    The first column of ``root`` is the leading mode; None leaves all but ``angle`` NaN. A way that
    ends below the profile is cut there.
    """
    lowest, columns_at = columns_of_air(profile, root, camera_m[0] - way_m[-1], camera_m[-1])
    tables = _PlaneTables.unknown(camera_m.size, way_m.size, len(kinds))
    at_camera, integral_to_camera = columns_at(camera_m)
    errors_in_cabins = []
    if root is not None:
        errors_in_cabins = [cabin_errors(profile, root, camera_m, kind) for kind in kinds]
    for row, height in enumerate(camera_m):
        way_in_profile = np.minimum(way_m, height - lowest)
        way_in_profile = np.maximum(way_in_profile, _SHORTEST_M)
        integral_to_target = columns_at(height - way_in_profile)[1]
        mean = (integral_to_camera[row] - integral_to_target) / way_in_profile[:, None]
        tables.angle[row] = (mean[:, 0] - at_camera[row, 0]) / way_in_profile
        if root is None:
            continue
        errors = at_camera[row, 1:]
        by_air = (mean[:, 1:] - errors) / way_in_profile[:, None]
        tables.mode[row] = by_air[:, 0]
        tables.sigma[row] = _row_lengths(by_air[:, 1:])
        for kind_row in range(len(kinds)):
            _fill_behind_window(
                tables,
                kind_row,
                row,
                mean_errors=mean[:, 1:],
                errors=errors,
                errors_in_cabin=errors_in_cabins[kind_row][row],
            )
    return tables


def _fill_behind_window(
    tables: _PlaneTables,
    kind_row: int,
    row: int,
    *,
    mean_errors: Array,
    errors: Array,
    errors_in_cabin: Array,
) -> None:
    """Fill ``behind``, ``lean`` and ``mode_lean`` for one kind of window and one camera.

    ``kind_row`` and ``row`` are their rows in the tables; x and y as in `sigmas`. Errors of N are
    those of the mean over each way (w, 1 + r), at the camera and in the cabin (1 + r,); their first
    column is that of the leading mode, the others are those of the covariance's root.
    """
    lean = errors - errors_in_cabin
    x = mean_errors[:, 1:] - errors_in_cabin[1:]
    y = lean[1:]
    sigma_y = float(np.linalg.norm(y))
    tables.mode_lean[kind_row, row] = lean[0]
    tables.lean[kind_row, row] = sigma_y
    tables.behind[kind_row, 0, row] = _row_lengths(x)
    tables.behind[kind_row, 1, row] = x @ y / max(sigma_y, _TINY_SIGMA)


def _row_lengths(rows: Array) -> Array:
    """The Euclidean length of each row of a matrix."""
    square = np.einsum("ij,ij->i", rows, rows)
    return np.asarray(np.sqrt(square))


def columns_of_air(
    profile: Profile, root: CovarianceRoot | None, low: float, high: float
) -> tuple[float, Callable[[Array], tuple[Array, Array]]]:
    """N and its errors as a function of height, from ``low`` to ``high`` [m] within the profile.

    Returns the lowest height [m], and a function of heights (n,) [m]. That function returns two
    arrays (n, 1 + r): N and its change by each of the r columns of ``root``, linear between heights
    that are 12.5 m apart or less, and the integrals of these from the lowest height. Without a root
    there is N alone.
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


def _sphere_factors(
    profile: Profile,
    root: CovarianceRoot | None,
    camera_heights_m: tuple[float, float],
    way_m: Array,
    *,
    least_cosine: float,
    radius: float,
) -> Array:
    """(f, j, k, 3) ``factors`` of `AirTables`, which convert values of the plane to the sphere.

    They are factors of sigma_R / tan(zeta) and of dR/dzeta cos^2(zeta), and a summand of the mode's
    R / (tan(zeta) way). The factor of dR/dzeta is geometry: it is taken from US 1976, where R is
    nowhere zero; at 80 degrees it is 1.02 and at 85 degrees 1.09 in any air, within 0.01 (3 km).
    ``way_m`` (j,) [m] are ways down, ``least_cosine`` is that of the nadir angle at the ground.
    """
    largest_incidence = least_cosine**-0.5
    count = 2 + int((largest_incidence - 1.0) / _INCIDENCE_STEP)
    cosine = np.asarray((1.0 + _INCIDENCE_STEP * np.arange(count)) ** -2.0, np.float64)
    h_c, h_g, zeta = _rays_for_factors(profile, camera_heights_m, way_m, cosine, radius)
    in_us1976 = sensitivity(standard_atmosphere("us1976"), h_c, h_g, zeta, radius)
    angle_slope = in_us1976.d_zeta_c * np.cos(zeta) ** 2
    angle_factor = angle_slope / angle_slope[..., :1]  # the first angle is steep: as in the plane
    if root is None:
        unknown = np.full(angle_factor.shape, np.nan)
        return np.stack([unknown, angle_factor, unknown], axis=-1)
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
    return np.stack([sigma / sigma[..., :1], angle_factor, mode - mode[..., :1]], axis=-1)


def _rays_for_factors(
    profile: Profile,
    camera_heights_m: tuple[float, float],
    way_m: Array,
    cosine: Array,
    radius: float,
) -> tuple[Array, Array, Array]:
    """h_c (f, 1, 1), h_g (f, j, 1) [m] and zeta_c (f, j, k) [rad] of some 1500 rays.

    ``way_m`` (j,) [m] are ways down, ``cosine`` (k,) those of nadir angles at the ground. The first
    nadir angle of each camera and way is replaced by a steep one, for which plane and sphere agree.
    """
    low, high = camera_heights_m
    most_cameras = 2 + (high - low) / _WIDEST_M * _TRACED_CAMERAS_PER_WIDEST
    rays_of_camera = cosine.size * way_m.size
    cameras = int(np.clip(_MOST_RAYS // rays_of_camera, 2, most_cameras))
    h_c = np.linspace(low, high, cameras)[:, None, None]
    lowest = max(profile.bottom_m, _LOWEST_TARGET_M)
    down = np.maximum(way_m, _SHORTEST_M)[None, :, None]
    h_g = np.maximum(h_c - down, lowest)
    h_g = np.minimum(h_g, h_c - _SHORTEST_M)
    sine_at_ground = np.sqrt(1.0 - cosine * cosine)
    sine = sine_at_ground * (radius + h_g) / (radius + h_c)
    zeta = np.arcsin(np.minimum(sine, 1.0))
    zeta[..., 0] = np.arctan(_STEEP_TANGENT)
    return h_c, h_g, zeta
