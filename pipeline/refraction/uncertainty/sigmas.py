"""Standard deviations of corrections, and what computes them beside the corrections."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.refraction.uncertainty.air_sigma import AirSigma

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """All that turns corrections into standard deviations; made by `uncertainty_of`.

    ``air`` : tables of sigma_R; ``stations`` (s, 16) columns of `_sigma_kernel`.
    """

    air: AirSigma
    stations: Array


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Standard deviations of corrections; (n,) arrays, NaN where unknown.

    ``r_c_rad`` and ``air_*`` are common to the block: they must not be added to the weights of
    observations. ``station_*`` are common to an image, ``ground_*`` to a point. dx and dy of one
    kind are fully correlated but for ``station_*``.
    """

    r_c_rad: Array
    air_dx_px: Single
    air_dy_px: Single
    station_dx_px: Single
    station_dy_px: Single
    ground_dx_px: Single
    ground_dy_px: Single

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

    def rows(self, which: NDArray[np.intp]) -> Sigmas:
        """Some of the rows."""
        return Sigmas(**{name: values[which] for name, values in self.columns().items()})

    def put(self, rows: NDArray[np.intp], part: Sigmas) -> None:
        """Fill some rows in."""
        for name, values in self.columns().items():
            values[rows] = getattr(part, name)

    def fill(self, rows: slice, uncertainty: Uncertainty, solved: Solved) -> None:
        """Fill the rows in that a block of observations has been solved for."""
        # The compiled functions are imported with the first ray, not with the package.
        from pipeline.refraction.kernels.sigma import spread_out

        air, k = uncertainty.air, solved
        columns = [values[rows] for values in self.columns().values()]
        spread_out(
            k.h_g, k.sigma_h_g, k.exposure, k.camera, k.rotation, k.rays, k.r_c, k.status,
            uncertainty.stations,
            (air.way_first, air.way_step, air.coarse_step, air.incidence_step, air.sigma, air.angle,
             air.factors, air.behind, air.lean),
            (air.ground_m, air.refractivity_step_m, air.refractivity), *columns,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solved:
    """A block of observations with its rays and angles, as the kernels of the image have them."""

    h_g: Array
    sigma_h_g: Array
    exposure: NDArray[np.int64]
    camera: tuple[float, ...]
    rotation: Array
    rays: Array
    r_c: Array
    status: NDArray[np.uint8]
