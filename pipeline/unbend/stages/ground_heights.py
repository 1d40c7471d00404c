"""Sources of the heights of observed points: one class for each kind, read batch by batch."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M, HeightSystem
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.status_codes import OK
from unbend.refraction.target_heights import target_heights
from unbend.refraction.terrain_heights import terrain_heights
from unbend.stages import messages
from unbend.stages.correction_setup import CorrectionSetup, GroundHeights
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.observations import Batch
from unbend.units import Array, Integers


@dataclass(frozen=True, eq=False)
class GivenGround:
    """Stated heights: one for all points, or a column of the observations.

    constant_m : the height of all points [m]; None if there is a column.
    offset_m : (s,) added at each station [m] to get heights above sea level: minus the undulation
        for ellipsoidal heights, the height of the take-off for relative heights.
    sigma_m : the standard deviation of all heights [m]; None if the mission file states none.
    """

    constant_m: float | None
    offset_m: Array
    sigma_m: float | None = None

    def heights(
        self, batch: Batch, station: Integers, setup: CorrectionSetup | None = None
    ) -> GroundHeights:
        """(n,) heights above sea level [m], NaN where the stated ones are unknown or implausible.

        The result also has the count of the implausible ones.
        """
        stated_m = batch.ground
        if stated_m is None:
            stated_m = np.full(len(batch), self.constant_m, dtype=np.float64)
        plausible = plausible_heights(stated_m)
        # The station -1 (no station) gets the last offset, NaN, which is replaced by 0. The height
        # is not used, because such an observation gets the status no_station.
        offset = np.append(self.offset_m, np.nan)[station]
        h_m = plausible + np.where(station < 0, 0.0, offset)
        is_implausible = np.isfinite(stated_m) & np.isnan(plausible)
        return GroundHeights(
            h_m,
            sigmas_of_heights(batch, self.sigma_m),
            implausible=int(np.count_nonzero(is_implausible)),
        )

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and highest height above sea level [m]: of the constant at any station.

        With a column they are the limits of all land.
        """
        if self.constant_m is None:
            return LOWEST_GROUND_M, HIGHEST_GROUND_M
        offset = self.offset_m[np.isfinite(self.offset_m)]
        if offset.size == 0:
            offset = np.zeros(1)  # no station has a known offset
        return self.constant_m + float(offset.min()), self.constant_m + float(offset.max())


@dataclass(frozen=True, eq=False)
class SlantRangeGround:
    """Heights at which the slant ranges of the observations end.

    ``sigma_m`` is the standard deviation of all heights [m], None if the mission file states none.
    """

    sigma_m: float | None = None
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m] where slant ranges end; NaN without a slant range."""
        h_g = np.full(len(batch), np.nan)
        if batch.distance_m is not None:
            for rows, camera, profile in setup.groups(station):
                h_g[rows] = target_heights(
                    batch.x_px[rows],
                    batch.y_px[rows],
                    batch.distance_m[rows],
                    station[rows],
                    setup.exposures,
                    camera=camera,
                    table=setup.rays[profile],
                    ideal=setup.direction == "apply",
                )
        return GroundHeights(plausible_heights(h_g), sigmas_of_heights(batch, self.sigma_m))


@dataclass(frozen=True, eq=False)
class ComputedGround:
    """Heights that were computed before the correction.

    h_and_sigma_m : (2, rows) for all rows of the observation table: heights above sea level, and
        their sigmas [m].
    """

    h_and_sigma_m: Array
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m]; NaN if none was computed or it is implausible."""
        h_m, sigma_m = np.array(self.h_and_sigma_m[:, batch.rows])
        return GroundHeights(plausible_heights(h_m), sigma_m)


def sigmas_of_heights(batch: Batch, sigma_m: float | None) -> Array:
    """(n,) standard deviations [m] of ground heights: the column of a batch, else ``sigma_m``.

    NaN if neither is known.
    """
    if batch.ground_sigma is not None:
        return batch.ground_sigma
    return np.full(len(batch), np.nan if sigma_m is None else sigma_m)


def plausible_heights(height_m: Array) -> Array:
    """Heights [m] with NaN for those below -600 and above 10,000 m."""
    plausible = (height_m >= LOWEST_GROUND_M) & (height_m <= HIGHEST_GROUND_M)
    return np.where(plausible, height_m, np.nan)


LARGEST_SLOPE_FACTOR = 20.0  # limit of `Landings.error_factor`, which grows where rays graze slopes


class Landings(NamedTuple):
    """Where rays meet an elevation model, (n,) each.

    h_m : height above sea level; NaN where a ray does not meet the model.
    error_factor : the error of ``h_m`` divided by the error of the model that causes it.
    distance_m : slant range.
    status : codes of `status_codes`.
    """

    h_m: Array
    error_factor: Array
    distance_m: Array
    status: Array


@dataclass(frozen=True, eq=False)
class TerrainGround:
    """Heights where rays first meet an elevation model.

    places : (s,) latitudes and longitudes of the stations [rad].
    sigma_m : standard deviation of the heights of the model [m]; None if the mission file states
        none. The height where a ray lands has this sigma times 1 / (1 + tan slope tan zeta), at
        most 20: it is less certain on slopes that fall away from the camera (slope < 0).
    """

    model: ElevationModel
    places: tuple[Array, Array]
    sigma_m: float | None = None
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m], slant ranges, and the status of rays that miss it."""
        landings = self.landings(batch.x_px, batch.y_px, station, setup)
        slope_factor = np.minimum(landings.error_factor, LARGEST_SLOPE_FACTOR)
        return GroundHeights(
            landings.h_m,
            sigmas_of_heights(batch, self.sigma_m) * slope_factor,
            landings.status.astype(np.uint8),
            distance_m=landings.distance_m,
        )

    def landings(
        self, x_px: Array, y_px: Array, station: Integers, setup: CorrectionSetup
    ) -> Landings:
        """Where the rays of pixels meet the model; NaN for pixels without a camera.

        ``station`` (n,) is the number of each pixel's station, -1 without one.
        """
        columns = np.full((len(Landings._fields), station.size), np.nan)  # a row for each field
        columns[Landings._fields.index("status")] = OK
        for rows, camera, profile in setup.groups(station):
            columns[:, rows] = terrain_heights(
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
        return Landings(*columns)


def elevation_of_mission(
    inputs: OpenedInputs, heights: HeightSystem, ledger: Ledger
) -> ElevationModel | None:
    """The elevation model of a mission, above sea level; None if the mission file names none."""
    if inputs.elevation is None:
        return None
    return ledger.take(inputs.elevation(undulation=heights.undulation))


def with_terrain(
    setup: CorrectionSetup,
    model: ElevationModel | None,
    stations: Stations,
    sigma_m: float | None,
    ledger: Ledger,
) -> CorrectionSetup:
    """The setup with the elevation model as source of ground heights, if the mission has one.

    ``sigma_m`` is the standard deviation of the model's heights [m]. Refuses (DEM-OUTSIDE) a model
    that has no station in its area; a loss if only some stations are outside.
    """
    if model is None:
        return setup
    latitude = stations.lat_rad
    longitude = stations.lon_rad
    ok = stations.ok
    outside = ~model.covers(latitude[ok], longitude[ok])
    count = int(outside.sum())
    total = int(ok.sum())
    if count and count == total:
        first = np.flatnonzero(ok)[:1]
        row, column = model.nodes(latitude[first], longitude[first])
        raise messages.no_station_on_model(
            where=model.name,
            count=count,
            rows=model.size[0],
            columns=model.size[1],
            north=float(np.degrees(latitude[first[0]])),
            east=float(np.degrees(longitude[first[0]])),
            row=float(row[0]),
            column=float(column[0]),
        )
    if count:
        ledger.add(messages.stations_off_model(where=model.name, count=count, total=total))
    return replace(setup, ground=TerrainGround(model, (latitude, longitude), sigma_m))
