"""Heights of points from a table of the user's, checked, or by intersection."""

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from tempfile import TemporaryFile
from typing import IO

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from unbend.block.image_rays import ImageRays, Orientations
from unbend.block.intersection import PointHeights, point_heights
from unbend.config import Mission
from unbend.config.ground import ControlSection, PointTable
from unbend.flight.heights import HeightSystem, known_home_m
from unbend.flight.stations import Stations
from unbend.geodesy import GeoidGrid, ecef_of_geodetic
from unbend.messages import Kind, Ledger
from unbend.refraction.image import correct_observations
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.stages.flight_log import FlightLog
from unbend.stages.ground_heights import ComputedGround
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.block_frames import block_points
from unbend.stages.opened_inputs import ObjectPointTable, OpenedInputs
from unbend.tables.geodata.coordinate_systems import places_of
from unbend.tables.geodata.object_points import ObjectPoints, matching_rows
from unbend.tables.observations import Batch, Observations
from unbend.tables.text_columns import hashes_of, rows_among
from unbend.units import WGS84_A, Array, Integers

STEEPEST = 20.0  # flying heights: points farther away are seen at more than 87 deg
LOWEST_FLIGHT_M = 50.0  # above the points, that counts for it
CHECKED_ROWS = 100_000  # first rows whose points are compared with their stations
LIKELY_EXCHANGED = 0.1  # of the distance: exchanged coordinates that lie so much nearer
BATCH_ROWS = 250_000
ROWS_OF_A_FILE = 300_000  # whose rays are intersected at a time: 12 MB
MOST_FILES = 200
SAMPLED_SHARES = 10_000  # sigmas of a file that stand for all in the median
POOR_SIGMA = 0.05  # of the camera's height above a point: 5 % of it are 5 % of R

RAY = np.dtype([("point", "u8"), ("row", "i8"), ("station", "i8"), ("x", "f8"), ("y", "f8")])
"""A ray in a temporary file: hash of its point, row of the table, station, pixel."""


def with_object_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> Observations:
    """The observations with the object points of a table, or of the block, if any."""
    ground = mission.ground
    observations = inputs.observations
    if ground.height == "block":
        return replace(observations, points=block_points(mission, inputs, flight, ledger))
    if ground.points is None or inputs.object_points is None:
        return observations
    points = points_above_sea(
        inputs.object_points,
        ground.points,
        ground.reference,
        key="ground.height",
        heights=flight.heights,
        geoid=inputs.geoid,
        ledger=ledger,
    )
    return replace(observations, points=points)


def points_above_sea(
    table: ObjectPointTable,
    section: PointTable | ControlSection,
    reference: str,
    *,
    key: str,
    heights: HeightSystem,
    geoid: GeoidGrid | None,
    ledger: Ledger,
) -> ObjectPoints:
    """The points of a user's table above sea level, as ``section`` and ``reference`` state it."""
    value = table.columns
    x, y = ("x", "y") if "x" in value else ("longitude", "latitude")
    placed = places_of(
        section.crs,
        (value[x], value[y], value["height"]),
        heights=reference,
        geoid=geoid,
        where=table.where,
        key=f"{key}.crs",
    )
    places = ledger.take(placed)
    h = places.h_m
    if places.heights == "ellipsoid":
        h = h - heights.undulation(places.lat_rad, places.lon_rad)
    elif places.heights == "relative":
        h = h + known_home_m(heights)
    return ObjectPoints(table.name, places.lat_rad, places.lon_rad, h)


def check_object_points(observations: Observations, stations: Stations, ledger: Ledger) -> None:
    """Compare the places of object points with the stations that see them.

    Refuses (InputError) a table without any of the points (POINTS-MISSING), and points below the
    horizon (POINTS-FAR); a loss where the median one is seen at more than 87 deg from the nadir.
    """
    points = observations.points
    if points is None:
        return
    where = "ground.height.points"
    batch = next(observations.batches(CHECKED_ROWS))
    _, row = points.heights(batch.point, batch.image)
    if points.of_image is None and not bool((row >= 0).any()):
        raise messages.no_point_in_table(
            where=where, total=len(batch), point=str(batch.point[0]), first=str(points.name[0])
        )
    station = matching_rows(batch.image, pa.array(stations.image, pa.string()))
    both = (row >= 0) & (station >= 0)
    seen = seen_points(points, stations, row[both], station[both])
    known = np.isfinite(seen.distance_m)
    if not bool(known.any()):
        return
    usual_m = float(np.median(seen.distance_m[known]))
    if usual_m < STEEPEST * np.median(seen.above_m[known]):
        return
    other = ""
    exchanged_m = float(np.nanmedian(seen.distance_exchanged_m))
    if exchanged_m < LIKELY_EXCHANGED * usual_m:
        other = f"; with latitude and longitude exchanged {exchanged_m / 1000.0:.0f} km"
    horizon_m = float(np.median(np.sqrt(2.0 * WGS84_A * seen.above_m[known])))
    if usual_m > horizon_m:
        raise messages.points_beyond_horizon(where=where, km=usual_m / 1000.0, other=other)
    count = int(known.sum())
    ledger.add(messages.points_far(where=where, count=count, km=usual_m / 1000.0, other=other))


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Object points beside the stations that see them, (n,) [m].

    ``distance_exchanged_m`` with latitude and longitude of the points exchanged; ``above_m`` is the
    height of a station above its point, at least 50 m.
    """

    distance_m: Array
    distance_exchanged_m: Array
    above_m: Array


def seen_points(
    points: ObjectPoints, stations: Stations, row: Integers, station: Integers
) -> SeenPoints:
    """Rows (n,) of object points beside those of stations."""
    latitude = points.lat_rad[row]
    longitude = points.lon_rad[row]
    h = points.h_m[row]
    station_h = stations.h_msl_m[station]
    centre = ecef_of_geodetic(stations.lat_rad[station], stations.lon_rad[station], station_h)
    apart = ecef_of_geodetic(latitude, longitude, h) - centre
    exchanged = ecef_of_geodetic(longitude, latitude, h) - centre
    return SeenPoints(
        np.linalg.norm(apart, axis=1),
        np.linalg.norm(exchanged, axis=1),
        np.maximum(np.abs(station_h - h), LOWEST_FLIGHT_M),
    )


def with_intersected_heights(
    mission: Mission,
    observations: Observations,
    setup: CorrectionSetup,
    stations: Stations,
    ledger: Ledger,
) -> CorrectionSetup:
    """The setup with intersected ground heights and their sigmas, where the mission file says so.

    The rays of a point may lie anywhere in a table of any length: its rows are divided by the hash
    of their points into temporary files of some 300,000 rows, which are intersected one after the
    other, by rays without refraction of air and window. Heights lie in a temporary file too (16
    bytes a row, the rays 40). A rehearsal takes the points of its rows alone. Refuses (MissionError
    GROUND-INTERSECTED) where no point has a height; those without one are NaN.
    """
    if mission.ground.height != "intersected":
        return setup
    with TemporaryFile() as file:  # the map keeps it
        heights = np.memmap(file, np.float64, "w+", shape=(2, observations.rows))
    heights[:] = np.nan
    orientations = orientations_of_mission(mission, stations)
    counts: Counter[str] = Counter()
    shares = []
    with ExitStack() as stack:
        count = 1 if observations.sample else 1 + observations.rows // ROWS_OF_A_FILE
        files = [stack.enter_context(TemporaryFile()) for _ in range(min(MOST_FILES, count))]
        write_rays(batches_with_points(observations), setup, files)
        for file in files:
            file.seek(0)
            rays = np.frombuffer(file.read(), RAY)
            if rays.size == 0:
                continue
            h_msl, found = heights_of_rays(rays, setup, stations, orientations)
            sigma_m = found.sigma_m[found.index]
            heights[:, rays["row"]] = h_msl, sigma_m
            counts["points"] += found.h_m.size
            counts["few"] += int(found.few.sum())
            counts["narrow"] += int(found.narrow.sum())
            counts["apart"] += int(found.apart.sum())
            with np.errstate(invalid="ignore"):
                share = sigma_m / np.abs(stations.h_msl_m[rays["station"]] - h_msl)
            step = max(1, rays.size // SAMPLED_SHARES)
            shares.append(share[np.isfinite(share)][::step])
    report_intersected(counts, shares, ledger)
    return replace(setup, ground=ComputedGround(heights))


def batches_with_points(observations: Observations) -> Iterable[Batch]:
    """The observations in batches; of a sample all that show one of its points."""
    if observations.sample is None:
        return observations.batches(BATCH_ROWS)
    wanted = np.unique(hashes_of(observations.sampled(points=True).point))
    return [observations.of_points(lambda hashes: rows_among(hashes, wanted))]


def write_rays(
    batches: Iterable[Batch], setup: CorrectionSetup, files: Sequence[IO[bytes]]
) -> None:
    """Write the rays of observations with a station, all of a point into one of the files."""
    images = pa.array(setup.images, pa.string())
    for batch in batches:
        rows = batch.rows
        rays = np.empty(len(batch), RAY)
        rays["point"] = pd.util.hash_pandas_object(batch.point.to_pandas(), index=False)
        rays["row"] = np.r_[rows] if isinstance(rows, slice) else rows
        rays["station"] = matching_rows(batch.image, images)
        rays["x"] = batch.x_px
        rays["y"] = batch.y_px
        named = batch.point.is_valid().to_numpy(zero_copy_only=False)
        measured = np.isfinite(rays["x"] + rays["y"])
        rays = rays[named & (rays["station"] >= 0) & measured]
        of_file = rays["point"] % np.uint64(len(files))
        for number in np.unique(of_file):
            files[number].write(rays[of_file == number].tobytes())


def report_intersected(counts: Counter[str], shares: list[Array], ledger: Ledger) -> None:
    """How many points have a height; refuses (GROUND-INTERSECTED) if none has.

    ``shares`` : sigmas of heights, in heights of the camera above them.
    """
    known = counts["points"] - counts["few"] - counts["narrow"] - counts["apart"]
    if known == 0:
        raise messages.no_height_intersected(
            where="ground.height",
            known=known,
            points=counts["points"],
            few=counts["few"],
            narrow=counts["narrow"],
            apart=counts["apart"],
        )
    share = float(np.median(np.concatenate(shares)))
    ledger.add(
        messages.heights_intersected(
            kind=Kind.LOSS if share > POOR_SIGMA else Kind.NOTE,
            where="ground.height",
            count=known,
            points=counts["points"],
            few=counts["few"],
            narrow=counts["narrow"],
            apart=counts["apart"],
            percent=100.0 * share,
        )
    )


def heights_of_rays(
    rays: NDArray[np.void], setup: CorrectionSetup, stations: Stations, orientations: Orientations
) -> tuple[Array, PointHeights]:
    """(n,) heights of points above sea level; a first intersection says how rays are bent."""
    x = rays["x"]
    y = rays["y"]
    station = rays["station"]
    undulation = np.nan_to_num(stations.h_ellipsoid_m - stations.h_msl_m)[station]
    h_msl = np.full(rays.size, np.nan)
    for bent in (False, setup.direction == "remove"):
        seen_x = x.copy()
        seen_y = y.copy()
        for rows, camera, profile in setup.groups(station) if bent else ():
            corrected = correct_observations(
                x[rows],
                y[rows],
                h_msl[rows],
                station[rows],
                setup.exposures,
                camera=camera,
                table=setup.rays[profile],
            )
            seen_x[rows] = corrected.x_corrected_px
            seen_y[rows] = corrected.y_corrected_px
        direction, sigma = setup.directions(seen_x, seen_y, station)
        found = point_heights(orientations, ImageRays(station, rays["point"], direction, sigma))
        number = np.maximum(np.bincount(found.index), 1)
        mean_undulation = np.bincount(found.index, undulation) / number
        h_msl = (found.h_m - mean_undulation)[found.index]
    return h_msl, found
