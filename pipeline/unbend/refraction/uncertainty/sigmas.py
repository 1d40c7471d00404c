"""Standard deviations of corrections, and what errors of the air do to rays behind windows.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24); with the state x of
the profile a ray errs by tan(zeta) times v = mean of a over the way - a_c, a = dN/dx.

Behind a plane window N_c also turns the ray there, by tan(theta) (dN_cc - dN_c) away from the
window's normal, theta the ray's angle to it (Gyer 1996, Eq. 36). Where the normal is vertical N_c
cancels, and the remaining error is tan(zeta) times

    x = mean of a over the way - a_cc,

a_cc = dN_cc/dx the response of the air in the cabin. Where the normal leans, y = a_c - a_cc remains
too, in proportion to the lean; the tables (`air_tables`) contain sigma of x, the covariance of x
and y over sigma of y, and sigma of y. The sphere changes x by less than 2 % up to 80 degrees and by
4 % at 85; that is neglected.

Of the leading mode of the covariance (`leading_mode`) the tables contain v and y themselves, with
their signs; the sphere adds to v, and a ray turns by v as part of R and by y at the window.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.covariance import ProfileCovariance, air_jacobian, log_pressure_jacobian
from unbend.atmosphere.profile import Profile
from unbend.refraction.kernels.columns import AirTables
from unbend.refraction.window import SCHEDULE_PRESSURE_PA, SCHEDULE_TEMPERATURE_K
from unbend.units import Array, Integers, Rows

# Kinds of windows.
OPEN = 0  # no window that bends rays
SEALED = 1  # plane, with air behind it that does not depend on that outside
SCHEDULED = 2  # plane, with Gyer's cabin schedule, where the cabin has the pressure outside
FOLLOWING = 3  # an opening: N behind it less N outside does not depend on the air outside

_LOG_PRESSURE_STEP = 1e-3  # in ln p, of the central differences
_SMALLEST_EIGENVALUE = 1e-12  # of the largest: smaller ones are rounding


def cabin_response(profile: Profile, h: Array, kind: int) -> Array:
    """(n,) derivative of N in the cabin by ln p outside, for cameras at heights ``h`` (n,) [m].

    ``kind`` is that of the window. Zero except for `SCHEDULED`, where the pressure in the cabin is
    that outside and the temperature 21.1 degC; central differences, good to 1e-6 of the value.
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
    """(n,) kinds of plane windows at cameras in air of the pressure ``pressure_pa`` (n,) outside.

    `SCHEDULED` where the cabin follows Gyer's schedule (``scheduled``) and the pressure outside is
    above `SCHEDULE_PRESSURE_PA`, so that the cabin has it too; else, and for NaN, `SEALED`.
    """
    with np.errstate(invalid="ignore"):
        has_outside_pressure = scheduled & (pressure_pa > SCHEDULE_PRESSURE_PA)
    return np.where(has_outside_pressure, SCHEDULED, SEALED)


@dataclass(frozen=True, eq=False)
class AirMode:
    """The leading mode of the air's covariance: one parameter s of an adjustment.

    ``state`` (2k + 1,) is what one sigma of s adds to the quantities of `ProfileCovariance.matrix`.
    The unit of s, and of ``sigma``, is the refraction: s = 0.01 turns rays by 1 % of it, on the
    average. ``variance_share`` is the share that the mode has in the variance, by the air, of the
    rays from which the mode is computed.
    """

    state: Array
    sigma: float
    variance_share: float


@dataclass(frozen=True, eq=False)
class CovarianceRoot:
    """A root of the covariance C of the air: ``matrix`` is L with L L^T = C.

    ``anchor_m`` [m] is the height to which the pressure of the covariance refers.
    """

    matrix: Array
    anchor_m: float

    @classmethod
    def of(cls, covariance: ProfileCovariance) -> CovarianceRoot:
        """The root by eigenvalues of the correlation; eigenvalues of rounding size are omitted."""
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
        """This root with a further, first column: the state of one sigma of the leading mode.

        The column is zero without a mode.
        """
        first = np.zeros(len(self.matrix))
        if mode is not None:
            first = mode.state
        with_first = np.column_stack([first, self.matrix])
        return replace(self, matrix=with_first)


def window_errors(profile: Profile, root: CovarianceRoot, h: Array, kind: int) -> Array:
    """(n, r) changes of y = a_c / n_c - a_cc by the columns of ``root``, each one sigma.

    For cameras at heights ``h`` (n,) [m] behind windows of one ``kind``. The products of the rows
    are the covariances of y.
    """
    air = air_jacobian(profile, h, root.anchor_m)
    n = 1.0 + profile.refractivity(h)
    outside = (air / n[:, None]) @ root.matrix
    cabin = cabin_errors(profile, root, h, kind)
    return np.asarray(outside - cabin)


def cabin_errors(profile: Profile, root: CovarianceRoot, h: Array, kind: int) -> Array:
    """(n, r) changes of N in the cabin by the columns of ``root``, each one sigma.

    For cameras at heights ``h`` (n,) [m] behind windows of one ``kind``. Behind an opening N
    changes as outside; that the air there is some percent thinner is neglected.
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


Single = NDArray[np.float32]

PARTIALS = ("dx_ds_px", "dy_ds_px", "dx_dncc_px", "dy_dncc_px")
"""The columns of `Sigmas` that are derivatives."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Tables from which the standard deviations of corrections follow; made by `uncertainty_of`.

    ``tables`` of sigma_R; ``stations`` (s, 19), columns `REFRACTIVITY` to `LENS_SIGMAS` of
    `unbend.refraction.kernels.columns`; ``mode`` the leading mode of the air's covariance, None
    where the covariance is not known.
    """

    tables: AirTables
    stations: Array
    mode: AirMode | None = None

    def with_scale(self, sigma: float) -> Uncertainty:
        """The same uncertainty with another unit of the mode's parameter s.

        ``sigma`` is one sigma of the mode in the new unit. Without a mode it is returned unchanged.
        """
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
    correlated, except ``station_*`` and ``cabin_*``. The derivatives are those of the corrected (or
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
    def allocate(cls, n: int) -> Sigmas:
        """Arrays for n observations, not initialized."""
        singles = np.empty((len(cls._fields) - 1, n), np.float32)
        return cls(np.empty(n), *singles)

    @classmethod
    def unknown(cls, n: int) -> Sigmas:
        """Arrays of NaN for n observations."""
        sigmas = cls.allocate(n)
        for values in sigmas:
            values.fill(np.nan)
        return sigmas

    @classmethod
    def column_names(cls) -> list[str]:
        """The names of the arrays as columns of tables, in the order of the fields."""
        names = []
        for field in cls._fields:
            names.append(field if field in PARTIALS else f"sigma_{field}")
        return names

    def named(self) -> dict[str, Any]:
        """The arrays by their names in tables, `column_names`."""
        return dict(zip(self.column_names(), self, strict=True))

    def rows(self, which: Rows | slice) -> Sigmas:
        """The rows with the numbers ``which``, or of a slice: a slice gives views, to be filled."""
        return Sigmas._make(values[which] for values in self)

    def put(self, rows: Rows, part: Sigmas) -> None:
        """Set the rows with the numbers ``rows`` to the values of ``part``, in place."""
        for name, values in self._asdict().items():
            values[rows] = getattr(part, name)
