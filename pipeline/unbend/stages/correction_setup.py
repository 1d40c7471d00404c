"""All that the correction of observations needs, and the interface of sources of ground heights.

A source of ground heights needs the whole setup: where a ray lands depends on camera and air.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Corrections, Exposures
from unbend.refraction.ray import PublishedRays
from unbend.refraction.ray_table import RayTable
from unbend.refraction.status_codes import NO_GROUND, OK
from unbend.refraction.uncertainty.sigmas import Uncertainty
from unbend.tables.observations import Batch
from unbend.tables.refraction_mark import Direction
from unbend.units import Array, Integers, Names


class GroundHeights(NamedTuple):
    """Heights of the points of a batch above sea level [m] and their sigmas; (n,), NaN if unknown.

    Only an elevation model gives ``status`` (n,), codes of `status_codes` that mark rays which miss
    the ground, and slant ranges ``distance_m`` (n,). ``implausible`` counts given heights below or
    above all land.
    """

    h_m: Array
    sigma_m: Array
    status: NDArray[np.uint8] | None = None
    implausible: int = 0
    distance_m: Array | None = None

    def with_ground_status(self, corrections: Corrections) -> Corrections:
        """The corrections, with a status of the ground that is not ok in place of ok or no_ground.

        Any other status of a correction stays: it records what failed before the ground.
        """
        if self.status is None:
            return corrections
        status_of_rays = corrections.status
        is_replaced = np.isin(status_of_rays, (OK, NO_GROUND))
        is_replaced &= self.status != OK
        status = np.where(is_replaced, self.status, status_of_rays)
        return replace(corrections, status=status.astype(np.uint8))


class Ground(Protocol):
    """A source of ground heights. Each source is a class; `correction_setup` chooses one."""

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest height above sea level that a point can have [m]."""

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """The heights of a batch; ``station`` (n,) is each row's station number, -1 without one.

        Rows without a station may get any height: it is not used.
        """


@dataclass(frozen=True, eq=False)
class CorrectionSetup:
    """Everything that a batch of observations is corrected with.

    ``images``, ``camera_names`` and ``profile_number`` (s,) are those of the exposures. A profile
    number is an index into ``rays`` and ``uncertainties`` (None: no standard deviations).
    """

    images: Names
    camera_names: Names
    exposures: Exposures
    ground: Ground
    cameras: Mapping[str, Camera]
    rays: tuple[RayTable | PublishedRays, ...]
    profile_number: Integers
    direction: Direction = "remove"
    uncertainties: tuple[Uncertainty | None, ...] = (None,)

    @property
    def computes_sigmas(self) -> bool:
        """Whether corrections get standard deviations."""
        return any(uncertainty is not None for uncertainty in self.uncertainties)

    @cached_property
    def camera_number(self) -> Integers:
        """(s + 1,) the position in ``cameras`` of each station's camera, -1 without a camera.

        The extra last entry is -1: observations without a station have the station number -1, which
        is the index of the last entry. An image without an exposure has a station without a camera.
        """
        number_of = {name: number for number, name in enumerate(self.cameras)}
        numbers = [number_of.get(name, -1) for name in self.camera_names]
        numbers.append(-1)
        return np.array(numbers, np.int64)

    def groups(self, station: Integers) -> Iterator[tuple[Integers, Camera, int]]:
        """Observations grouped by camera and profile: their rows, camera, and profile number.

        ``station`` (n,) is the number of each observation's station. Observations without a station
        or with a station without a camera are in no group.
        """
        camera_number = self.camera_number[station]
        for number, camera in enumerate(self.cameras.values()):
            rows = np.flatnonzero(camera_number == number)
            if rows.size == 0:
                continue
            if len(self.rays) == 1:
                yield rows, camera, 0
                continue
            profile_of_row = self.profile_number[station[rows]]
            for profile_number in np.unique(profile_of_row).tolist():
                in_profile = rows[profile_of_row == profile_number]
                yield in_profile, camera, profile_number

    def directions(self, x_px: Array, y_px: Array, station: Integers) -> tuple[Array, Array]:
        """(n, 3) unit vectors of pixels in the frames of their cameras, and (n,) pixel sizes [rad].

        A pixel without a camera has the vector NaN and the size 1.
        """
        direction = np.full((station.size, 3), np.nan)
        pixel_size_rad = np.ones(station.size)
        for rows, camera, _ in self.groups(station):
            u, v, _ = camera.rays(x_px[rows], y_px[rows])
            ones = np.ones(u.size)
            vectors = np.stack([u, v, ones], axis=1)
            direction[rows] = vectors
            pixel_size_rad[rows] = 1.0 / camera.fx_px
        length = np.linalg.norm(direction, axis=1)
        unit_vector = direction / length[:, None]
        return unit_vector, pixel_size_rad
