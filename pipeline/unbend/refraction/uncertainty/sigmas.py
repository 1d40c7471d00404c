"""Sigma of the refraction angle from the covariance of the air, in tables that rows interpolate.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24), so that with the
state x of the profile, its covariance C and the gradients a = dN/dx

    sigma_R = tan(zeta) sqrt(v^T C v),   v = mean of a over the way - a_c.

That is tabulated finely, because sigma of N_c has the structure of the profile's knots; what the
sphere adds follows from traced rays (`sensitivity`) and is a smooth factor.

Behind a plane window N_c also turns the ray there, by tan(theta) (dN_cc - dN_c) away from the
window's normal, theta the ray's angle to it (Gyer 1996, Eq. 36). Where the normal is vertical N_c
cancels, and what is left is tan(zeta) times

    x = mean of a over the way - a_cc,

a_cc = dN_cc/dx the response of the air in the cabin. Elsewhere y = a_c - a_cc remains by as much as
the normal leans; the tables hold sigma of x, how x and y go together, and sigma of y. The sphere
changes x by less than 1 % up to 80 degrees and by 4 % at 85, and is left out there.

Of the leading mode of C (`leading_mode`) they hold v and y themselves, with their signs; the sphere
adds to v, and a ray turns by R's part and that of y at the window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.covariance import ProfileCovariance, air_jacobian, log_pressure_jacobian
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.standard import standard_atmosphere
from unbend.refraction.kernels.columns import AirTables
from unbend.refraction.ray_table import cut
from unbend.refraction.uncertainty.sensitivity import sensitivity
from unbend.refraction.window import SCHEDULE_PRESSURE_PA, SCHEDULE_TEMPERATURE_K
from unbend.units import Array, Integers, Rows

# Kinds of windows.
OPEN = 0  # none that bends
SEALED = 1  # plane, with air behind it that does not depend on that outside
SCHEDULED = 2  # with Gyer's schedule where the cabin is as thin as the air outside
FOLLOWING = 3  # an opening: the air differs from that outside by what does not depend on it

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
_LOG_PRESSURE_STEP = 1e-3  # of differences
_SMALLEST_EIGENVALUE = 1e-12  # of the largest: smaller ones are rounding
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

    # Roots of the ways from cameras to targets: fine in the plane, coarse on the sphere.
    first = np.sqrt(max(low - top, _SHORTEST_M))
    last = np.sqrt(high - bottom)
    steps_between = np.ceil((last - first) / _WAY_STEP - 1)
    fine_steps = 2 + max(0, int(steps_between))
    ways = first + _WAY_STEP * np.arange(fine_steps)
    coarse_steps = 2 + int((ways[-1] - first) / _COARSE_STEP)
    coarse = first + _COARSE_STEP * np.arange(coarse_steps)

    plane = _in_the_plane(profile, root, camera, ways**2, window_kinds)
    # The largest nadir angle at the lowest ground in sight.
    zeta = min(largest_zeta_rad, 0.5 * np.pi)
    sine = np.sin(zeta) * (radius + high) / (radius + bottom)
    square_cosine = max(0.0, 1.0 - sine * sine)
    cosine = float(np.sqrt(square_cosine))
    factors = _on_the_sphere(
        profile,
        root,
        camera_heights_m,
        coarse**2,
        least_cosine=max(LEVEL_COSINE, cosine),
        radius=radius,
    )
    heights = np.arange(bottom, high + _REFRACTIVITY_STEP_M, _REFRACTIVITY_STEP_M)
    heights = np.minimum(heights, profile.top_m)
    return camera, AirTables(
        way_first=float(first),
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


def cabin_response(profile: Profile, h: Array, kind: int) -> Array:
    """(n,) change of N in the cabin with ln p outside, at heights of cameras (n,) [m].

    Zero but for `SCHEDULED`, where the pressure in the cabin is that outside and its temperature
    21.1 degC; central differences, good to 1e-6 of it.
    """
    if kind != SCHEDULED:
        return np.zeros(h.shape)
    refractivity = profile.index.refractivity
    p = profile.pressure(h)
    higher_p = (1.0 + _LOG_PRESSURE_STEP) * p
    lower_p = (1.0 - _LOG_PRESSURE_STEP) * p
    denser = refractivity(SCHEDULE_TEMPERATURE_K, higher_p, 0.0)
    thinner = refractivity(SCHEDULE_TEMPERATURE_K, lower_p, 0.0)
    return np.asarray((denser - thinner) / (2.0 * _LOG_PRESSURE_STEP))


def window_kind_of(pressure_pa: Array, *, scheduled: bool) -> Integers:
    """(n,) the kind from behind a plane window at cameras in outside air of ``pressure_pa``."""
    with np.errstate(invalid="ignore"):
        thin = scheduled & (pressure_pa > SCHEDULE_PRESSURE_PA)
    return np.where(thin, SCHEDULED, SEALED)


@dataclass(frozen=True, eq=False)
class AirMode:
    """The leading mode of the air's covariance: one parameter s of an adjustment.

    ``state`` (2k + 1,) is what one sigma of s adds to the quantities of `ProfileCovariance.matrix`.
    The unit of s, and of ``sigma``, is the refraction: s = 0.01 turns rays by 1 % of it, on the
    average. ``variance_share`` is that of the variance that the air gives the rays it is found of.
    """

    state: Array
    sigma: float
    variance_share: float


@dataclass(frozen=True, eq=False)
class CovarianceRoot:
    """A covariance as ``matrix`` L, L L^T = C, and the ``anchor_m`` [m] its pressure refers to."""

    matrix: Array
    anchor_m: float

    @classmethod
    def of(cls, covariance: ProfileCovariance) -> CovarianceRoot:
        """By eigenvalues; those that rounding left below zero are zero."""
        variance = np.maximum(np.diag(covariance.matrix), 0.0)
        sigma = np.sqrt(variance)
        scale = np.where(sigma > 0.0, sigma, 1.0)
        correlation = covariance.matrix / np.outer(scale, scale)
        value, vector = np.linalg.eigh(correlation)
        is_kept = value > _SMALLEST_EIGENVALUE * value[-1]
        root_of_value = np.sqrt(value[is_kept])
        matrix = sigma[:, None] * vector[:, is_kept] * root_of_value
        return cls(np.asarray(matrix), covariance.anchor_height_m)

    def with_mode_first(self, mode: AirMode | None) -> CovarianceRoot:
        """The same with what one sigma of the leading mode adds as a further, first column."""
        first = np.zeros(len(self.matrix))
        if mode is not None:
            first = mode.state
        with_first = np.column_stack([first, self.matrix])
        return replace(self, matrix=with_first)


def window_errors(profile: Profile, root: CovarianceRoot, h: Array, kind: int) -> Array:
    """(n, r) rows whose products are the covariances of y at cameras of heights ``h`` (n,) [m]."""
    air = air_jacobian(profile, h, root.anchor_m)
    n = 1.0 + profile.refractivity(h)
    outside = (air / n[:, None]) @ root.matrix
    cabin = _cabin_errors(profile, root, h, kind)
    return np.asarray(outside - cabin)


def _cabin_errors(profile: Profile, root: CovarianceRoot, h: Array, kind: int) -> Array:
    """(n, r) what the errors of the air do to the cabin's N.

    To that of an opening what they do outside, but for some percent by which it is thinner.
    """
    if kind == FOLLOWING:
        air = air_jacobian(profile, h, root.anchor_m)
        return np.asarray(air @ root.matrix)
    response = cabin_response(profile, h, kind)[:, None]
    by_temperature = log_pressure_jacobian(profile, h, root.anchor_m)
    edges = by_temperature.shape[1]
    of_temperatures = by_temperature @ root.matrix[:edges]
    of_anchor = root.matrix[edges]
    return np.asarray(response * (of_temperatures + of_anchor))


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
    lowest_target = camera[0] - way[-1]
    lowest, columns_at = columns_of_air(profile, root, lowest_target, camera[-1])
    tables = _PlaneTables.unknown(camera.size, way.size, len(kinds))
    at_camera, integral_above = columns_at(camera)
    cabins = []
    if root is not None:
        cabins = [_cabin_errors(profile, root, camera, kind) for kind in kinds]
    for row, height in enumerate(camera):
        reach = np.minimum(way, height - lowest)
        reach = np.maximum(reach, _SHORTEST_M)
        _, integral_below = columns_at(height - reach)
        mean = (integral_above[row] - integral_below) / reach[:, None]
        mean_n = mean[:, 0]
        tables.angle[row] = (mean_n - at_camera[row, 0]) / reach
        if root is None:
            continue
        errors_at_camera = at_camera[row, 1:]
        mean_errors = mean[:, 1:]
        by_air = (mean_errors - errors_at_camera) / reach[:, None]
        tables.mode[row] = by_air[:, 0]
        tables.sigma[row] = _lengths(by_air[:, 1:])
        for k, cabin in enumerate(cabins):
            # The first column is the mode's. x and y as in the equations of this module.
            lean = errors_at_camera - cabin[row]
            x = mean_errors[:, 1:] - cabin[row, 1:]
            y = lean[1:]
            sigma_y = np.linalg.norm(y)
            tables.mode_lean[k, row] = lean[0]
            tables.lean[k, row] = sigma_y
            tables.behind[k, 0, row] = _lengths(x)
            tables.behind[k, 1, row] = x @ y / max(sigma_y, _NOTHING)
    return tables


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
    """(f, j, k, 3) factors that take sigma_R / tan(zeta) and dR/dzeta cos^2(zeta) to the sphere,
    and what it adds to the mode's R / (tan(zeta) way).

    That of dR/dzeta is geometry: it is taken from US 1976, whose R is nowhere zero; at 80 degrees
    it is 1.02 and at 85 degrees 1.09 in any air, within 0.01 (3 km).
    """
    low, high = camera_heights_m
    largest_incidence = least_cosine**-0.5
    count = 2 + int((largest_incidence - 1.0) / _INCIDENCE_STEP)
    cosine = (1.0 + _INCIDENCE_STEP * np.arange(count)) ** -2.0
    most_cameras = 2 + (high - low) / _WIDEST_M * _CAMERAS_PER_WIDEST
    rays_of_camera = count * way.size
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
    us1976 = standard_atmosphere("us1976")
    usual = sensitivity(us1976, h_c, h_g, zeta, radius)
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


Single = NDArray[np.float32]

PARTIALS = ("dx_ds_px", "dy_ds_px", "dx_dncc_px", "dy_dncc_px")
"""The columns of `Sigmas` that are derivatives."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """All that turns corrections into standard deviations; made by `uncertainty_of`.

    ``tables`` of sigma_R; ``stations`` (s, 19) columns `REFRACTIVITY` to `LENS_SIGMAS` of
    `unbend.refraction.kernels.columns`; ``mode`` the leading mode of the air's covariance, None
    where that is not known.
    """

    tables: AirTables
    stations: Array
    mode: AirMode | None = None

    def with_scale(self, sigma: float) -> Uncertainty:
        """The same with another unit of the mode's parameter, in which its sigma is this."""
        if self.mode is None:
            return self
        tables = self.tables._replace(mode_sigma=sigma)
        mode = replace(self.mode, sigma=sigma)
        return replace(self, tables=tables, mode=mode)


class Sigmas(NamedTuple):
    """Standard deviations of corrections, and derivatives; (n,) arrays, NaN where unknown.

    ``r_c_rad`` and ``air_*`` are common to the block: they must not be added to the weights of
    observations. ``station_*`` are common to an image, ``ground_*`` to a point, ``r_cc_rad`` and
    ``cabin_*`` (by the air behind the window) to a camera. dx and dy of one kind are fully
    correlated but for ``station_*`` and ``cabin_*``. The derivatives are those of the corrected (or
    displaced) pixels: ``dx_ds_px``, ``dy_ds_px`` by the parameter s of the air's leading mode,
    ``dx_dncc_px``, ``dy_dncc_px`` by the refractivity behind a plane window, NaN without one.
    """

    r_c_rad: Array
    air_dx_px: Single
    air_dy_px: Single
    station_dx_px: Single
    station_dy_px: Single
    ground_dx_px: Single
    ground_dy_px: Single
    r_cc_rad: Single
    cabin_dx_px: Single
    cabin_dy_px: Single
    dx_ds_px: Single
    dy_ds_px: Single
    dx_dncc_px: Single
    dy_dncc_px: Single

    @classmethod
    def room(cls, n: int) -> Sigmas:
        """For n observations, to be filled."""
        singles = np.empty((len(cls._fields) - 1, n), np.float32)
        return cls(np.empty(n), *singles)

    @classmethod
    def unknown(cls, n: int) -> Sigmas:
        """Of n observations of which nothing is known."""
        nothing = cls.room(n)
        for values in nothing:
            values.fill(np.nan)
        return nothing

    def named(self) -> dict[str, Any]:
        """The arrays by the names of columns of tables."""
        columns = {}
        for name, values in self._asdict().items():
            column = name if name in PARTIALS else f"sigma_{name}"
            columns[column] = values
        return columns

    def rows(self, which: Rows | slice) -> Sigmas:
        """Some of the rows; those of a slice can be filled."""
        return Sigmas._make(values[which] for values in self)

    def put(self, rows: Rows, part: Sigmas) -> None:
        """Fill some rows in."""
        for name, values in self._asdict().items():
            values[rows] = getattr(part, name)
