"""Heights of object points: from a user's table, which is checked, or by intersection of rays."""

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
from unbend.flight.heights import HeightSystem, required_home_m
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
from unbend.tables.name_hashes import hashes_of, rows_among
from unbend.tables.observations import Batch, Observations
from unbend.units import WGS84_A, Array, Integers

FARTHEST_IN_HEIGHTS = 20.0  # flying heights: farther points are seen at more than 87 deg
LOWEST_FLIGHT_M = 50.0  # above the points: a lower flight counts as one of this height
CHECKED_ROWS = 100_000  # of the observations: the first, with points compared with their stations
LIKELY_EXCHANGED = 0.1  # of the distances: coordinates are likely exchanged if that leaves less
BATCH_ROWS = 250_000
ROWS_OF_A_FILE = 300_000  # about as many rays are intersected at a time: 12 MB
MOST_FILES = 200  # temporary files that are open together
SAMPLED_SHARES = 10_000  # sigmas of each file that count in the median
POOR_SIGMA = 0.05  # of the camera's height above a point: 5 % of it are 5 % of R

RAY = np.dtype([("point", "u8"), ("row", "i8"), ("station", "i8"), ("x", "f8"), ("y", "f8")])
"""A ray in a temporary file: hash of its point, row of the table, station, pixel."""


def with_object_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> Observations:
    """The observations, with the object points of the block or of the user's table.

    Unchanged if the mission takes ground heights from neither.
    """
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
    """The points of a user's table, with heights above sea level.

    ``section`` states the coordinate system of the table, ``reference`` the zero of its heights;
    ``key`` is the key of the section, for refusals.
    """
    columns = table.columns
    if "x" in columns:
        coordinates = (columns["x"], columns["y"], columns["height"])
    else:
        coordinates = (columns["longitude"], columns["latitude"], columns["height"])
    placed = places_of(
        section.crs,
        coordinates,
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
        h = h + required_home_m(heights)
    return ObjectPoints(table.name, places.lat_rad, places.lon_rad, h)


def check_object_points(observations: Observations, stations: Stations, ledger: Ledger) -> None:
    """Compare the places of object points with the stations that see them.

    Refuses a user's table that has none of the observed points (POINTS-MISSING). A block may have
    none, because an unknown point gets the usual height of its image. Refuses points at a median
    distance beyond the horizon (POINTS-FAR); a loss if they are nearer, but seen at more than 87
    deg from the nadir.
    """
    points = observations.points
    if points is None:
        return
    where = "ground.height.points"
    batch = next(observations.batches(CHECKED_ROWS))
    _, row = points.heights(batch.point, batch.image)  # rows of points, -1 for an unknown point
    # Only a block has heights ``of_image``.
    if points.of_image is None and not bool((row >= 0).any()):
        raise messages.no_point_in_table(
            where=where, total=len(batch), point=str(batch.point[0]), first=str(points.name[0])
        )
    station = matching_rows(batch.image, pa.array(stations.image, pa.string()))
    has_both = (row >= 0) & (station >= 0)  # a known point and a station
    seen = seen_points(points, stations, row[has_both], station[has_both])
    is_known = np.isfinite(seen.distance_m)
    if not bool(is_known.any()):
        return
    median_m = float(np.median(seen.distance_m[is_known]))
    is_near = median_m < FARTHEST_IN_HEIGHTS * np.median(seen.above_m[is_known])
    if is_near:
        return
    likely_cause = ""
    exchanged_m = float(np.nanmedian(seen.distance_exchanged_m))
    if exchanged_m < LIKELY_EXCHANGED * median_m:
        likely_cause = f"; with latitude and longitude exchanged {exchanged_m / 1000.0:.0f} km"
    horizon_m = float(np.median(np.sqrt(2.0 * WGS84_A * seen.above_m[is_known])))
    if median_m > horizon_m:
        raise messages.points_beyond_horizon(where=where, km=median_m / 1000.0, other=likely_cause)
    count = int(is_known.sum())
    ledger.add(
        messages.points_far(where=where, count=count, km=median_m / 1000.0, other=likely_cause)
    )


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Pairs of an object point and a station that sees it, (n,) [m].

    distance_m : from station to point; NaN if a place is unknown.
    distance_exchanged_m : the same with latitude and longitude of the point exchanged.
    above_m : absolute difference of the heights of station and point, at least 50 m.
    """

    distance_m: Array
    distance_exchanged_m: Array
    above_m: Array


def seen_points(
    points: ObjectPoints, stations: Stations, row: Integers, station: Integers
) -> SeenPoints:
    """How far each point is from the station that sees it, for n pairs of a point and a station.

    ``row`` (n,) are rows of ``points``, ``station`` (n,) rows of ``stations``.
    """
    latitude = points.lat_rad[row]
    longitude = points.lon_rad[row]
    h = points.h_m[row]
    station_h = stations.h_msl_m[station]
    centre = ecef_of_geodetic(stations.lat_rad[station], stations.lon_rad[station], station_h)
    line = ecef_of_geodetic(latitude, longitude, h) - centre
    line_exchanged = ecef_of_geodetic(longitude, latitude, h) - centre
    return SeenPoints(
        distance_m=np.linalg.norm(line, axis=1),
        distance_exchanged_m=np.linalg.norm(line_exchanged, axis=1),
        above_m=np.maximum(np.abs(station_h - h), LOWEST_FLIGHT_M),
    )


def with_intersected_heights(
    mission: Mission,
    observations: Observations,
    setup: CorrectionSetup,
    stations: Stations,
    ledger: Ledger,
) -> CorrectionSetup:
    """The setup with intersected ground heights and their sigmas, if the mission asks for them.

    The rays of one point may be anywhere in a long table. Therefore the rays are first divided, by
    the hash of their point, among temporary files of some 300,000 rays (40 bytes each), so that all
    rays of a point are in one file; then file after file is intersected (`heights_of_rays`). The
    heights go into a temporary file too (16 bytes a row of the table). A sample of the observations
    needs one file, because only rows with a point of the sample are read.

    A point has no height (NaN) if its rays do not meet; refuses (GROUND-INTERSECTED) a mission in
    which no point has a height.
    """
    if mission.ground.height != "intersected":
        return setup
    with TemporaryFile() as file_of_heights:  # the map of its memory outlives the closed file
        heights = np.memmap(file_of_heights, np.float64, "w+", shape=(2, observations.rows))
    heights[:] = np.nan  # heights[0] will be heights above sea level [m], heights[1] their sigmas
    orientations = orientations_of_mission(mission, stations)
    counts: Counter[str] = Counter()
    shares = []
    with ExitStack() as stack:
        number_of_files = 1
        if observations.sample is None:
            number_of_files = min(MOST_FILES, 1 + observations.rows // ROWS_OF_A_FILE)
        files_of_rays = [stack.enter_context(TemporaryFile()) for _ in range(number_of_files)]
        write_rays(batches_with_points(observations), setup, files_of_rays)
        for file in files_of_rays:
            file.seek(0)
            rays = np.frombuffer(file.read(), RAY)
            if rays.size == 0:
                continue
            h_msl, points = heights_of_rays(rays, setup, stations, orientations)
            sigma_m = points.sigma_m[points.index]
            heights[:, rays["row"]] = h_msl, sigma_m
            counts += counts_of_points(points)
            shares.append(sigma_shares(sigma_m, stations.h_msl_m[rays["station"]] - h_msl))
    report_intersected(counts, shares, ledger)
    return replace(setup, ground=ComputedGround(heights))


def counts_of_points(points: PointHeights) -> Counter[str]:
    """How many points there are, and how many have no height for each reason.

    The reasons are ``few``, ``narrow`` and ``apart`` of `PointHeights`.
    """
    return Counter(
        points=points.h_m.size,
        few=int(points.few.sum()),
        narrow=int(points.narrow.sum()),
        apart=int(points.apart.sum()),
    )


def sigma_shares(sigma_m: Array, above_m: Array) -> Array:
    """Sigmas of heights as shares of the camera's height above the point: a sample of the known.

    ``sigma_m`` and ``above_m`` are (n,), one for each ray. At most about 10,000 are returned,
    evenly spaced, for a median over all files.
    """
    with np.errstate(invalid="ignore"):
        share = sigma_m / np.abs(above_m)
    step = max(1, share.size // SAMPLED_SHARES)
    return share[np.isfinite(share)][::step]


def batches_with_points(observations: Observations) -> Iterable[Batch]:
    """The observations in batches, with all rays of each point that matters.

    For a sample it is one batch of all rows of the table that show a point of the sample: the
    sampled rows alone have too few rays of each point.
    """
    if observations.sample is None:
        return observations.batches(BATCH_ROWS)
    sampled_hashes = np.unique(hashes_of(observations.sampled(points=True).point))
    return [observations.rows_of_points(lambda hashes: rows_among(hashes, sampled_hashes))]


def write_rays(
    batches: Iterable[Batch], setup: CorrectionSetup, files: Sequence[IO[bytes]]
) -> None:
    """Write the rays of observations into ``files``, as records of `RAY`.

    All rays of one point go into the same file. Observations without a point, a pixel or a station
    are left out.
    """
    images = pa.array(setup.images, pa.string())
    for batch in batches:
        rows = batch.rows
        rays = np.empty(len(batch), RAY)
        rays["point"] = pd.util.hash_pandas_object(batch.point.to_pandas(), index=False)
        rays["row"] = np.r_[rows] if isinstance(rows, slice) else rows
        rays["station"] = matching_rows(batch.image, images)
        rays["x"] = batch.x_px
        rays["y"] = batch.y_px
        is_named = batch.point.is_valid().to_numpy(zero_copy_only=False)
        is_measured = np.isfinite(rays["x"] + rays["y"])
        rays = rays[is_named & (rays["station"] >= 0) & is_measured]
        file_number = rays["point"] % np.uint64(len(files))
        for number in np.unique(file_number):
            files[number].write(rays[file_number == number].tobytes())


def report_intersected(counts: Counter[str], shares: list[Array], ledger: Ledger) -> None:
    """Add to the ledger how many points have a height, and how uncertain the heights are.

    A note; a loss if the median share is over 5 %; refuses (GROUND-INTERSECTED) if no point has a
    height. ``counts`` is the sum of `counts_of_points`, ``shares`` the `sigma_shares` of each file.
    """
    known_points = counts["points"] - counts["few"] - counts["narrow"] - counts["apart"]
    if known_points == 0:
        raise messages.no_height_intersected(
            where="ground.height",
            known=known_points,
            points=counts["points"],
            few=counts["few"],
            narrow=counts["narrow"],
            apart=counts["apart"],
        )
    median_share = float(np.median(np.concatenate(shares)))
    ledger.add(
        messages.heights_intersected(
            kind=Kind.LOSS if median_share > POOR_SIGMA else Kind.NOTE,
            where="ground.height",
            count=known_points,
            points=counts["points"],
            few=counts["few"],
            narrow=counts["narrow"],
            apart=counts["apart"],
            percent=100.0 * median_share,
        )
    )


def heights_of_rays(
    rays: NDArray[np.void], setup: CorrectionSetup, stations: Stations, orientations: Orientations
) -> tuple[Array, PointHeights]:
    """(n,) height above sea level of the point of each ray, and the intersected points.

    Measured rays are bent by air and window. Therefore they are intersected twice: as measured,
    for approximate heights with which refraction is removed from the pixels; then without
    refraction. If the mission applies refraction, its pixels have none yet, and the first
    intersection is the result. ``rays`` (n,) are records of `RAY`.
    """
    station = rays["station"]
    x_px = rays["x"]
    y_px = rays["y"]
    undulation = np.nan_to_num(stations.h_ellipsoid_m - stations.h_msl_m)[station]

    def intersected(pixel_x: Array, pixel_y: Array) -> tuple[Array, PointHeights]:
        """Heights above sea level (n,) and points, by the rays through some pixels."""
        direction, sigma_rad = setup.directions(pixel_x, pixel_y, station)
        image_rays = ImageRays(station, rays["point"], direction, sigma_rad)
        points = point_heights(orientations, image_rays)  # above the ellipsoid
        ray_count = np.maximum(np.bincount(points.index), 1)
        mean_undulation = np.bincount(points.index, undulation) / ray_count
        return (points.h_m - mean_undulation)[points.index], points

    as_measured = intersected(x_px, y_px)
    if setup.direction != "remove":
        return as_measured
    h_msl, _ = as_measured
    straight_x, straight_y = straight_pixels(x_px, y_px, h_msl, station, setup)
    return intersected(straight_x, straight_y)


def straight_pixels(
    x_px: Array, y_px: Array, h_msl: Array, station: Integers, setup: CorrectionSetup
) -> tuple[Array, Array]:
    """(n,) x and y [px] without refraction, for rays to points at heights ``h_msl`` (n,) [m]."""
    straight_x = x_px.copy()
    straight_y = y_px.copy()
    for rows, camera, profile in setup.groups(station):
        corrected = correct_observations(
            x_px[rows],
            y_px[rows],
            h_msl[rows],
            station[rows],
            setup.exposures,
            camera=camera,
            table=setup.rays[profile],
        )
        straight_x[rows] = corrected.x_corrected_px
        straight_y[rows] = corrected.y_corrected_px
    return straight_x, straight_y
