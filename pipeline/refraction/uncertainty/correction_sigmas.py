"""Standard deviations of corrections, and what computes them beside the corrections."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.refraction.kernels.columns import (
    CameraConstants,
    ExposureColumns,
    ObservationColumns,
    TracedColumns,
)
from pipeline.refraction.kernels.sigma import propagate
from pipeline.refraction.uncertainty.air_sigma import AirMode, AirSigma
from pipeline.units import Array, Rows

Single = NDArray[np.float32]


PARTIALS = ("dx_ds_px", "dy_ds_px", "dx_dncc_px", "dy_dncc_px")
"""The columns of `Sigmas` that are derivatives."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """All that turns corrections into standard deviations; made by `uncertainty_of`.

    ``air`` : tables of sigma_R; ``stations`` (s, 19) columns `N` to `CABIN` of
    `pipeline.refraction.kernels.columns`; ``mode`` the leading mode of the air's covariance, None
    where that is not known.
    """

    air: AirSigma
    stations: Array
    mode: AirMode | None = None

    def with_scale(self, sigma: float) -> Uncertainty:
        """The same with another unit of the mode's parameter, in which its sigma is this."""
        if self.mode is None:
            return self
        tables = self.air.tables._replace(mode_sigma=sigma)
        air = replace(self.air, tables=tables)
        return replace(self, air=air, mode=replace(self.mode, sigma=sigma))


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Standard deviations of corrections, and derivatives; (n,) arrays, NaN where unknown.

    ``r_c_rad`` and ``air_*`` are common to the block: they must not be added to the weights of
    observations. ``station_*`` are common to an image, ``ground_*`` to a point, ``r_cc_rad`` and
    ``cabin_*`` (by the air behind the window) to a camera. dx and dy of one kind are fully
    correlated but for ``station_*`` and ``cabin_*``.

    ``dx_ds_px``, ``dy_ds_px`` are the derivatives of the corrected (or displaced) pixels by the
    parameter s of the air's leading mode; ``dx_dncc_px``, ``dy_dncc_px`` by the refractivity of the
    air behind a plane window, NaN without one.
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
        return cls(np.empty(n), *np.empty((len(fields(cls)) - 1, n), np.float32))

    @classmethod
    def unknown(cls, n: int) -> Sigmas:
        """Of n observations of which nothing is known."""
        made = cls.room(n)
        for values in made.columns().values():
            values.fill(np.nan)
        return made

    def columns(self) -> dict[str, Any]:
        """The arrays by their names."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def named(self) -> dict[str, Any]:
        """The arrays by the names of columns of tables."""
        return {n if n in PARTIALS else f"sigma_{n}": v for n, v in self.columns().items()}

    def rows(self, which: Rows | slice) -> Sigmas:
        """Some of the rows; those of a slice can be filled."""
        return Sigmas(**{name: values[which] for name, values in self.columns().items()})

    def put(self, rows: Rows, part: Sigmas) -> None:
        """Fill some rows in."""
        for name, values in self.columns().items():
            values[rows] = getattr(part, name)

    def fill(
        self,
        uncertainty: Uncertainty,
        observed: ObservationColumns,
        setup: tuple[CameraConstants, ExposureColumns],
        traced: TracedColumns,
    ) -> None:
        """Fill in the standard deviations of observations that have been traced to the ground."""
        camera, exposures = setup
        propagate(
            observed, (camera, exposures.rotation), traced,
            (uncertainty.stations, uncertainty.air.tables), tuple(self.columns().values()),
        )  # fmt: skip
