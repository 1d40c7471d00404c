"""Heights of the observed points, batch by batch, from any source of a mission file."""

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
    """Heights that are given: one for all points, or a column of the observations.

    constant_m : the one height; None where there is a column.
    offset_m : (s,) what to add at each station to have heights above sea level: minus the
        undulation for ellipsoidal heights, the take-off's height for relative ones.
    sigma_m : the standard deviation of all heights, where the mission file states one.
    """

    constant_m: float | None
    offset_m: Array
    sigma_m: float | None = None

    def heights(
        self, batch: Batch, station: Integers, setup: CorrectionSetup | None = None
    ) -> GroundHeights:
        """(n,) heights above sea level [m], NaN where implausible; counts the implausible ones."""
        given = batch.ground
        if given is None:
            given = np.full(len(batch), self.constant_m, dtype=np.float64)
        plausible = plausible_heights(given)
        # A station of -1 is no station: it takes the last offset, NaN, which then counts as 0. The
        # height is of no use, because such an observation gets the status no_station.
        offset = np.append(self.offset_m, np.nan)[station]
        h_m = plausible + np.where(station < 0, 0.0, offset)
        is_implausible = np.isfinite(given) & np.isnan(plausible)
        return GroundHeights(
            h_m,
            sigmas_given(batch, self.sigma_m),
            implausible=int(np.count_nonzero(is_implausible)),
        )

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and highest height above sea level [m]: of the constant, or of all land."""
        if self.constant_m is None:
            return LOWEST_GROUND_M, HIGHEST_GROUND_M
        offset = self.offset_m[np.isfinite(self.offset_m)]
        if offset.size == 0:
            offset = np.zeros(1)
        return self.constant_m + float(offset.min()), self.constant_m + float(offset.max())


@dataclass(frozen=True, eq=False)
class SlantRangeGround:
    """Heights at which the slant ranges end; ``sigma_m`` as for `GivenGround`."""

    sigma_m: float | None = None
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m] of the ends of the chords; NaN without a distance."""
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
        return GroundHeights(plausible_heights(h_g), sigmas_given(batch, self.sigma_m))


@dataclass(frozen=True, eq=False)
class ComputedGround:
    """Heights that were computed before the correction.

    of_rows : (2, rows) heights above sea level, and below them their sigmas [m], of all rows of the
        observation table.
    """

    of_rows: Array
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m]; NaN if none was computed or it is implausible."""
        h_m, sigma_m = np.array(self.of_rows[:, batch.rows])
        return GroundHeights(plausible_heights(h_m), sigma_m)


def sigmas_given(batch: Batch, sigma_m: float | None) -> Array:
    """(n,) standard deviations [m] of ground heights: a batch's column, or ``sigma_m`` for all.

    NaN where neither is known.
    """
    if batch.ground_sigma is not None:
        return batch.ground_sigma
    return np.full(len(batch), np.nan if sigma_m is None else sigma_m)


def plausible_heights(height_m: Array) -> Array:
    """Heights [m] with NaN for those below -600 and above 10,000 m."""
    plausible = (height_m >= LOWEST_GROUND_M) & (height_m <= HIGHEST_GROUND_M)
    return np.where(plausible, height_m, np.nan)


LARGEST_SLOPE_FACTOR = 20.0  # an error of the model counts so often where a ray grazes a slope


class Landings(NamedTuple):
    """Where rays meet an elevation model, (n,) each.

    error_factor : error of the height over the error of the model that causes it.
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
    sigma_m : standard deviation of the heights of the model. The height at which a ray lands is
        less certain on slopes that fall away from the camera: by 1 / (1 + tan slope tan zeta), with
        a negative slope, at most 20 times.
    """

    model: ElevationModel
    places: tuple[Array, Array]
    sigma_m: float | None = None
    limits: tuple[float, float] = (LOWEST_GROUND_M, HIGHEST_GROUND_M)

    def heights(self, batch: Batch, station: Integers, setup: CorrectionSetup) -> GroundHeights:
        """(n,) heights above sea level [m], and the status of rays that land nowhere."""
        landings = self.landings(batch.x_px, batch.y_px, station, setup)
        slope_factor = np.minimum(landings.error_factor, LARGEST_SLOPE_FACTOR)
        return GroundHeights(
            landings.h_m,
            sigmas_given(batch, self.sigma_m) * slope_factor,
            landings.status.astype(np.uint8),
            distance_m=landings.distance_m,
        )

    def landings(
        self, x_px: Array, y_px: Array, station: Integers, setup: CorrectionSetup
    ) -> Landings:
        """Where the rays of pixels meet the model."""
        columns = np.full((len(Landings._fields), station.size), np.nan)
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
    """The elevation model above sea level, None where the mission file names none."""
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
    """The setup with the heights of the elevation model as ground, if the mission has one.

    ``sigma_m`` is the standard deviation of these heights. Refuses (DEM-OUTSIDE) a model that lies
    under no station; a loss if it lies under some but not all.
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
