"""Ground heights where the rays meet an elevation model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

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
from pipeline.geodesy import geodetic_of_ecef
from pipeline.ledger import Ledger, finding
from pipeline.refraction.landing import terrain_heights
from pipeline.refraction.status_codes import OK
from pipeline.stages.correction import CorrectionSetup
from pipeline.stages.ground.ground_heights import GroundHeights, sigmas_given
from pipeline.stages.multi_image.tie_point_checks import FEWEST_TIE_POINTS
from pipeline.tables.geodata.elevation import ElevationModel, open_elevation
from pipeline.tables.observations import Batch, Observations
from pipeline.tables.tie_points import MOST_TIE_POINTS, draw_tie_points, tie_rays

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

# A model of this ground leaves less of the points' relief than one height does, whatever their
# sigma; a model that is turned or of another place leaves its own relief in addition.
_WORSE_THAN_FLAT = 1.1
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

    def height(self, lat_rad: float, lon_rad: float) -> float:
        """Height of the model above sea level [m] at one place."""
        row, column = self.model.nodes(np.array([lat_rad]), np.array([lon_rad]))
        return float(self.model.heights(row, column)[0])

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

    That is what a hillshade, feet, another vertical datum, holes filled with a number, and rows or
    axes in another order look like.
    """
    if not isinstance(setup.ground, TerrainGround):
        return
    model = setup.ground.model
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
    met_m = points.h_m[points.index] - undulation
    known = np.isfinite(model_m - met_m)
    count = np.unique(points.index[known]).size
    if count < FEWEST_TIE_POINTS:
        return
    off, met_m = (model_m - met_m)[known], met_m[known]
    above = float(np.median(stations.h_msl_m[rays.image][known] - model_m[known]))
    sigma = orientations.sigma[rays.image, 2][known]
    shared = np.hypot(np.median(sigma), setup.ground.sigma_m or 0.0)
    single = float(np.median(points.sigma_m[points.index][known]))
    middle, far = float(np.median(off)), float(np.quantile(np.abs(off), 0.9))
    limits = max(0.01 * above, 4.0 * shared), max(0.03 * above, 4.0 * float(shared + single))
    left, relief, what = _spread(off), _spread(met_m), ""
    if abs(middle) > limits[0] or far > limits[1]:
        what = f"{abs(middle):.0f} m too {'high' if middle > 0 else 'low'} in the median, and "
        what += f"{far:.0f} m or more off in a tenth: expected within {limits[0]:.0f} and "
        what += f"{limits[1]:.0f} m"
    elif left > max(_WORSE_THAN_FLAT * relief, 0.002 * above):
        what = f"off by {left:.0f} m or more in a tenth, where one height for all would be by "
        what += f"{relief:.0f} m"
    elif left > max(0.2 * relief, 0.002 * above):
        lat, lon, _ = geodetic_of_ecef(*points.position_m[np.isfinite(points.h_m)].T)
        h_m = points.h_m[np.isfinite(points.h_m)]
        row, column = model.nodes(lat, lon)
        turned = min(
            _spread(model.heights(*other) - h_m) for other in _other_ways(row, column, model)
        )
        if turned < 0.5 * left:
            what = f"off by {left:.0f} m or more in a tenth, and by {turned:.0f} m with its rows "
            what += "or columns in another order"
    if what:
        ledger.add(
            finding(
                "DEM-TIES",
                f"where rays of {count} tie points meet, the elevation model is {what}; likely "
                "upside down, mirrored or of another place, no model of heights, heights in feet "
                "(the unit of the band) or from another zero (ground.reference; the undulation is "
                f"{np.nanmedian(undulation):.0f} m), or holes that hold a number",
                where="ground.height.dem",
                count=int(known.sum()),
            )
        )


def _spread(values: Array) -> float:
    """What a tenth of the values is away from their median at least; infinite without any."""
    values = values[np.isfinite(values)]
    if values.size < FEWEST_TIE_POINTS:
        return np.inf
    return float(np.quantile(np.abs(values - np.median(values)), 0.9))


def _other_ways(row: Array, column: Array, model: ElevationModel) -> Iterator[tuple[Array, Array]]:
    """Where nodes would be in a model whose rows or columns are reversed or exchanged."""
    size = np.array(model.size)[:, None]
    for exchanged, *reversed_axes in list(product((False, True), repeat=3))[1:]:
        at = np.array([column, row] if exchanged else [row, column])
        yield tuple(np.where(np.array(reversed_axes)[:, None], size - 1 - at, at))


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
