"""What an exporter may draw on: a run as it was, rebuilt from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.series.profile_series import ProfileSeries
from pipeline.errors import ConfigError
from pipeline.flight.stations import Stations
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures
from pipeline.refraction.ray import PublishedRays, RayTable
from pipeline.tables.pixels import PixelSystem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExportCamera:
    """A camera in COLMAP's pixels, and whether a window bends its rays."""

    camera: Camera
    has_window: bool


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A finished run: its stations, air, cameras and where its observations are.

    ``ground_m`` (s,) is the ground that images are computed for, above sea level [m], NaN where
    there is none. ``exposures`` has the rows of ``stations``. ``parts`` are the Parquet files of
    the observations, in order, with coordinates in the system ``pixels``; ``metadata`` goes into
    every file that is written. ``rays`` are those of the profiles of ``air``.
    """

    mission: str
    stations: Stations
    exposures: Exposures
    air: ProfileSeries
    rays: tuple[RayTable | PublishedRays, ...]
    method: str
    cameras: Mapping[str, ExportCamera]
    ground_m: Array
    pixels: PixelSystem
    parts: tuple[Path, ...]
    metadata: Mapping[str, str]

    def rows_of(self, camera: str) -> NDArray[np.int64]:
        """(n,) the stations of a camera that can be used, in the order of time in the table."""
        mine = (self.stations.camera == camera) & self.exposures.usable
        return np.flatnonzero(mine).astype(np.int64)


@dataclass(frozen=True)
class ExportOptions:
    """What the user may choose: nodes of the lattice, and one ground height [m] for all images."""

    columns: int = 21
    rows: int = 15
    ground_height_m: float | None = None

    def __post_init__(self) -> None:
        ground = self.ground_height_m
        if ground is not None and not -600.0 <= ground <= 10_000.0:
            raise ConfigError(
                "EXPORT-GROUND",
                f"{ground:g} m is no ground height (-600 to 10000 m)",
                where="--ground-height",
                remedy="give it in metres above sea level",
            )
