"""Standard deviations of corrections, and what errors of the air do to rays behind windows.

In the plane R = tan(zeta) (mean of N over the way - N_c) (Gyer 1996, Eq. 24); with the state x of
the profile a ray errs by tan(zeta) times v = mean of a over the way - a_c, a = dN/dx.

Behind a plane window N_c also turns the ray there, by tan(theta) (dN_cc - dN_c) away from the
window's normal, theta the ray's angle to it (Gyer 1996, Eq. 36). Where the normal is vertical N_c
cancels, and what is left is tan(zeta) times

    x = mean of a over the way - a_cc,

a_cc = dN_cc/dx the response of the air in the cabin. Elsewhere y = a_c - a_cc remains by as much as
the normal leans; the tables (`air_tables`) hold sigma of x, how x and y go together, and sigma of
y. The sphere changes x by less than 1 % up to 80 degrees and by 4 % at 85, and is left out there.

Of the leading mode of the covariance (`leading_mode`) they hold v and y themselves, with their
signs; the sphere adds to v, and a ray turns by R's part and that of y at the window.
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
OPEN = 0  # none that bends
SEALED = 1  # plane, with air behind it that does not depend on that outside
SCHEDULED = 2  # with Gyer's schedule where the cabin is as thin as the air outside
FOLLOWING = 3  # an opening: the air differs from that outside by what does not depend on it

_LOG_PRESSURE_STEP = 1e-3  # of differences
_SMALLEST_EIGENVALUE = 1e-12  # of the largest: smaller ones are rounding


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
    cabin = cabin_errors(profile, root, h, kind)
    return np.asarray(outside - cabin)


def cabin_errors(profile: Profile, root: CovarianceRoot, h: Array, kind: int) -> Array:
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

    @classmethod
    def column_names(cls) -> list[str]:
        """The names of columns of tables, in the order of the fields."""
        names = []
        for field in cls._fields:
            names.append(field if field in PARTIALS else f"sigma_{field}")
        return names

    def named(self) -> dict[str, Any]:
        """The arrays by the names of columns of tables."""
        return dict(zip(self.column_names(), self, strict=True))

    def rows(self, which: Rows | slice) -> Sigmas:
        """Some of the rows; those of a slice can be filled."""
        return Sigmas._make(values[which] for values in self)

    def put(self, rows: Rows, part: Sigmas) -> None:
        """Fill some rows in."""
        for name, values in self._asdict().items():
            values[rows] = getattr(part, name)
