"""Ground heights where the rays meet an elevation model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.batch.plan import Plan
from pipeline.block.image_rays import UNKNOWN_SIGMAS, orientations_of, straightened
from pipeline.block.point_heights import point_heights
from pipeline.config.sections import HIGHEST_GROUND_M, LOWEST_GROUND_M
from pipeline.errors import MissionError
from pipeline.flight.heights import HeightSystem
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger, finding
from pipeline.refraction.kernels.landing import terrain_heights
from pipeline.refraction.status_codes import OK
from pipeline.stages.correction import CorrectionSetup
from pipeline.stages.ground.ground_heights import GroundHeights, sigmas_given
from pipeline.stages.multi_image.tie_point_checks import FEWEST_TIE_POINTS
from pipeline.tables.geodata.elevation import ElevationModel, open_elevation
from pipeline.tables.observations import Batch, Observations
from pipeline.tables.tie_points import MOST_TIE_POINTS, draw_tie_points, tie_rays

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


def compare_terrain(
    observations: Observations, setup: CorrectionSetup, stations: Stations, ledger: Ledger
) -> None:
    """A finding where rays of tie points meet far from the elevation model.

    That is what a hillshade, feet, another vertical datum or holes filled with a number look like.
    """
    if not isinstance(setup.ground, TerrainGround):
        return
    ties = draw_tie_points(observations, MOST_TIE_POINTS)
    rays = tie_rays(ties, stations.image, stations.camera, setup.cameras)
    orientations = orientations_of(stations, UNKNOWN_SIGMAS)
    rays = rays if setup.direction == "apply" else straightened(orientations, rays)
    points = point_heights(orientations, replace(rays, height_m=None))
    row_of = {name: row for row, name in enumerate(stations.image.tolist())}
    image = np.array([row_of.get(name, -1) for name in ties.images], np.int64)[ties.image]
    landed = setup.ground.landings(ties.x_px, ties.y_px, image, setup)[0]
    # Rays of points, by point and image in both tables.
    at = pd.Series(landed, pd.MultiIndex.from_arrays([ties.point, image]))
    model_m = at.reindex(pd.MultiIndex.from_arrays([rays.point, rays.image])).to_numpy()
    undulation = (stations.h_ellipsoid_m - stations.h_msl_m)[rays.image]
    off = model_m + undulation - points.h_m[points.index]
    known = np.isfinite(off)
    if np.unique(points.index[known]).size < FEWEST_TIE_POINTS:
        return
    above = float(np.median(stations.h_msl_m[rays.image][known] - model_m[known]))
    sigma = orientations.sigma[rays.image, 2][known]
    shared = np.hypot(np.median(sigma), setup.ground.sigma_m or 0.0)
    single = float(np.median(points.sigma_m[points.index][known]))
    middle, far = float(np.median(off[known])), float(np.quantile(np.abs(off[known]), 0.9))
    limits = max(0.01 * above, 4.0 * shared), max(0.03 * above, 4.0 * float(shared + single))
    if abs(middle) <= limits[0] and far <= limits[1]:
        return
    ledger.add(
        finding(
            "DEM-TIES",
            f"where rays of {np.unique(points.index[known]).size} tie points meet, the elevation "
            f"model is {abs(middle):.0f} m too {'high' if middle > 0 else 'low'} in the median, "
            f"and {far:.0f} m or more off in a tenth: expected within {limits[0]:.0f} and "
            f"{limits[1]:.0f} m; likely no model of heights, heights in feet (the unit of the "
            f"band) or from another zero (ground.reference; the undulation is "
            f"{np.nanmedian(undulation):.0f} m), holes that hold a number, or another place",
            where="ground.height.dem",
            count=int(known.sum()),
        )
    )


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
