"""Ground heights where the rays meet an elevation model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.batch.plan import Plan
from pipeline.config.sections import HIGHEST_GROUND_M, LOWEST_GROUND_M
from pipeline.errors import MissionError
from pipeline.flight.heights import HeightSystem
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.kernels.landing import terrain_heights
from pipeline.refraction.status_codes import OK
from pipeline.stages.correction import CorrectionSetup
from pipeline.stages.ground.ground_heights import GroundHeights, sigmas_given
from pipeline.tables.geodata.elevation import ElevationModel, open_elevation
from pipeline.tables.observations import Batch

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_LARGEST_FACTOR = 20.0  # of an error of the model's height, where a ray grazes a slope


@dataclass(frozen=True, eq=False)
class TerrainGround:
    """Heights where rays from ``places`` (s,), latitude and longitude [rad], first meet a model.

    ``sigma_m`` is that of the model's heights; that of a landing is larger on slopes that fall away
    from the camera: by 1 / (1 + tan slope tan zeta), 20 at most.
    """

    model: ElevationModel
    places: tuple[Array, Array]
    sigma_m: float | None = None
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Rows, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m], with the reason where there is none."""
        h_m, factor, distance = np.full((3, len(batch)), np.nan)
        status = np.full(len(batch), OK, np.uint8)
        for rows, camera, profile in setup.groups(station):
            h_m[rows], factor[rows], distance[rows], status[rows] = terrain_heights(
                batch.x_px[rows],
                batch.y_px[rows],
                station[rows],
                setup.exposures,
                self.places,
                camera=camera,
                table=setup.rays[profile],
                terrain=self.model,
                ideal=setup.direction == "apply",
            )
        sigma = sigmas_given(batch, self.sigma_m) * np.minimum(factor, _LARGEST_FACTOR)
        return GroundHeights(h_m, sigma, status, distance_m=distance)


def with_terrain(
    plan: Plan, setup: CorrectionSetup, stations: Stations, heights: HeightSystem, ledger: Ledger
) -> CorrectionSetup:
    """The setup with heights of the elevation model, where the mission file names one.

    Refuses (MissionError DEM-OUTSIDE) a model that lies under no station; a loss where it lies
    under some.
    """
    section = plan.mission.ground.model
    if section is None:
        return setup
    paths = [plan.input(f"elevation model {i + 1}").path for i in range(len(section.paths))]
    model = ledger.take(
        open_elevation(
            paths, section.crs, reference=plan.mission.ground.reference,
            undulation=heights.undulation,
        )
    )  # fmt: skip
    lat, lon = stations.lat_rad, stations.lon_rad
    outside = ~model.covers(lat[stations.ok], lon[stations.ok])
    count, placed = int(outside.sum()), int(stations.ok.sum())
    what = f"{count} of {placed} stations lie outside the elevation model"
    if count and count == placed:
        first = np.flatnonzero(stations.ok)[0]
        row, column = (float(a[0]) for a in model.nodes(lat[[first]], lon[[first]]))
        raise MissionError(
            "DEM-OUTSIDE",
            f"{what}, which has {model.size[0]} rows and {model.size[1]} columns: the first, at "
            f"{np.degrees(lat[first]):.4f}, {np.degrees(lon[first]):.4f}, would be in row "
            f"{row:.0f}, column {column:.0f}",
            where=str(paths[0]),
            remedy="check ground.height.dem, and ground.height.crs where the file has none",
        )
    if count:
        ledger.loss("DEM-OUTSIDE", what, where=str(paths[0]), count=count)
    sigma_m = plan.mission.ground.sigma_m
    return replace(setup, ground=TerrainGround(model, (lat, lon), sigma_m))
