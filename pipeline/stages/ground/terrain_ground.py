"""Ground heights where the rays meet an elevation model."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.batch.plan import Plan
from pipeline.config.sections import HIGHEST_GROUND_M, LOWEST_GROUND_M
from pipeline.errors import MissionError
from pipeline.flight.heights import HeightSystem
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.landing import terrain_heights
from pipeline.refraction.status_codes import OK
from pipeline.stages.correction import CorrectionSetup
from pipeline.stages.ground.ground_heights import GroundHeights, sigmas_given
from pipeline.tables.geodata.elevation import ElevationModel, open_elevation
from pipeline.tables.observations import Batch
from pipeline.units import Array

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
        h_m, factor, distance, status = self.landings(batch.x_px, batch.y_px, station, setup)
        sigma = sigmas_given(batch, self.sigma_m) * np.minimum(factor, _LARGEST_FACTOR)
        return GroundHeights(h_m, sigma, status.astype(np.uint8), distance_m=distance)

    def landings(self, x_px: Array, y_px: Array, station: Rows, setup: CorrectionSetup) -> Array:
        """(4, n) height [m], its error over the model's, slant range [m] and status of pixels."""
        found = np.full((4, station.size), np.nan)
        found[3] = OK
        for rows, camera, profile in setup.groups(station):
            found[:, rows] = terrain_heights(
                x_px[rows],
                y_px[rows],
                station[rows],
                setup.exposures,
                self.places,
                camera=camera,
                table=setup.rays[profile],
                terrain=self.model,
                ideal=setup.direction == "apply",
            )
        return found


def elevation_of_mission(
    plan: Plan, heights: HeightSystem, ledger: Ledger
) -> ElevationModel | None:
    """The elevation model that the mission file names, if any."""
    section, reference = plan.mission.ground.model, plan.mission.ground.reference
    if section is None:
        return None
    paths = [plan.input(f"elevation model {i + 1}").path for i in range(len(section.paths))]
    undulation = heights.undulation
    opened = open_elevation(paths, section.crs, reference=reference, undulation=undulation)
    return ledger.take(opened)


def with_terrain(
    setup: CorrectionSetup,
    model: ElevationModel | None,
    stations: Stations,
    sigma_m: float | None,
    ledger: Ledger,
) -> CorrectionSetup:
    """The setup with heights of the elevation model, where there is one; ``sigma_m`` are its.

    Refuses (MissionError DEM-OUTSIDE) a model that lies under no station; a loss where it lies
    under some.
    """
    if model is None:
        return setup
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
            where=model.name,
            remedy="check ground.height.dem, and ground.height.crs where the file has none",
        )
    if count:
        ledger.loss("DEM-OUTSIDE", what, where=model.name, count=count)
    return replace(setup, ground=TerrainGround(model, (lat, lon), sigma_m))
