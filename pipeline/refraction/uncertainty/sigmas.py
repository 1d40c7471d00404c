"""Standard deviations of corrections, and what computes them beside the corrections."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.refraction.kernels.columns import (
    CameraConstants,
    ExposureColumns,
    ObservationColumns,
    TracedColumns,
)
from pipeline.refraction.uncertainty.air_sigma import AirSigma

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """All that turns corrections into standard deviations; made by `uncertainty_of`.

    ``air`` : tables of sigma_R; ``stations`` (s, 19) columns `N` to `CABIN` of
    `pipeline.refraction.kernels.columns`.
    """

    air: AirSigma
    stations: Array


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Standard deviations of corrections; (n,) arrays, NaN where unknown.

    ``r_c_rad`` and ``air_*`` are common to the block: they must not be added to the weights of
    observations. ``station_*`` are common to an image, ``ground_*`` to a point, ``r_cc_rad`` and
    ``cabin_*`` (by the air behind the window) to a camera. dx and dy of one kind are fully
    correlated but for ``station_*`` and ``cabin_*``.
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

    def rows(self, which: NDArray[np.intp] | slice) -> Sigmas:
        """Some of the rows; those of a slice can be filled."""
        return Sigmas(**{name: values[which] for name, values in self.columns().items()})

    def put(self, rows: NDArray[np.intp], part: Sigmas) -> None:
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
        # The compiled functions are imported with the first ray, not with the package.
        from pipeline.refraction.kernels.sigma import propagate

        camera, exposures = setup
        propagate(
            observed, (camera, exposures.rotation), traced,
            (uncertainty.stations, uncertainty.air.tables), tuple(self.columns().values()),
        )  # fmt: skip
