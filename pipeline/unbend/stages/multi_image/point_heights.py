"""Heights of points from a table of the user's, checked, or by intersection."""

from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from tempfile import TemporaryFile

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from unbend.block.image_rays import ImageRays, Orientations
from unbend.block.intersection import PointHeights, point_heights
from unbend.config import Mission
from unbend.config.ground import ControlSection
from unbend.config.ground import PointTable as PointTableSection
from unbend.errors import InputError, MissionError
from unbend.flight.heights import HeightSystem, known_home_m
from unbend.flight.stations import Stations
from unbend.geodesy import GeoidGrid, ecef_of_geodetic
from unbend.messages import Entry, Kind, Ledger
from unbend.refraction.image import correct_observations
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.stages.ground_heights import ComputedGround
from unbend.stages.inputs import FlightLog
from unbend.stages.multi_image.oriented_stations import block_points
from unbend.stages.opened_inputs import OpenedInputs, PointTable
from unbend.tables.geodata.coordinate_systems import places_of
from unbend.tables.geodata.object_points import ObjectPoints, matching_rows
from unbend.tables.observations import Observations
from unbend.tables.text_columns import hashes_of, rows_among
from unbend.units import WGS84_A, Array

_STEEPEST = 20.0
"""Points farther away than this many flying heights are seen at more than 87 deg."""


def with_object_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> Observations:
    """The observations with the object points of a table, or of the block, if any."""
    ground, observations = mission.ground, inputs.observations
    if ground.height == "block":
        return replace(observations, points=block_points(mission, inputs, flight, ledger))
    if ground.points is None or inputs.object_points is None:
        return observations
    points = points_above_sea(
        inputs.object_points, ground.points, ground.reference, key="ground.height",
        heights=flight.heights, geoid=inputs.geoid, ledger=ledger,
    )  # fmt: skip
    return replace(observations, points=points)


def points_above_sea(
    table: PointTable,
    section: PointTableSection | ControlSection,
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
    places = ledger.take(places_of(
        section.crs, (value[x], value[y], value["height"]), heights=reference,
        geoid=geoid, where=table.where, key=f"{key}.crs",
    ))  # fmt: skip
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
    batch = next(observations.batches(100_000))
    _, row = points.heights(batch.point, batch.image)
    station = matching_rows(batch.image, pa.array(stations.image, pa.string()))
    where = "ground.height.points"
    if points.of_image is None and not bool((row >= 0).any()):
        raise InputError.of(
            "POINTS-MISSING/table", where, total=len(batch), point=batch.point[0],
            first=points.name[0],
        )  # fmt: skip
    both = (row >= 0) & (station >= 0)
    row, station = row[both], station[both]
    lat, lon, h = points.lat_rad[row], points.lon_rad[row], points.h_m[row]
    seen = stations.lat_rad[station], stations.lon_rad[station], stations.h_msl_m[station]
    apart = ecef_of_geodetic(lat, lon, h) - ecef_of_geodetic(*seen)
    distance, above = np.linalg.norm(apart, axis=1), np.maximum(np.abs(seen[2] - h), 50.0)
    known = np.isfinite(distance)
    if not bool(known.any()):
        return
    usual = float(np.median(distance[known]))
    horizon = float(np.median(np.sqrt(2.0 * WGS84_A * above[known])))
    if usual < _STEEPEST * np.median(above[known]):
        return
    swapped = ecef_of_geodetic(lon, lat, h) - ecef_of_geodetic(*seen)
    exchanged, other = float(np.nanmedian(np.linalg.norm(swapped, axis=1))), ""
    if exchanged < 0.1 * usual:
        other = f"; with latitude and longitude exchanged {exchanged / 1000.0:.0f} km"
    if usual > horizon:
        raise InputError.of("POINTS-FAR", where, km=usual / 1000.0, other=other)
    count = int(known.sum())
    ledger.loss("POINTS-FAR/steep", where=where, count=count, km=usual / 1000.0, other=other)


_RAY = np.dtype([("point", "u8"), ("row", "i8"), ("station", "i8"), ("x", "f8"), ("y", "f8")])
_ROWS_OF_A_FILE, _MOST_FILES, _BATCH_ROWS = 300_000, 200, 250_000

_POOR = 0.05
"""Sigma of a height, in heights of the camera above it, in the median: 5 % are 5 % of R."""


def with_intersected_heights(
    mission: Mission, observations: Observations, setup: CorrectionSetup, stations: Stations,
    ledger: Ledger,
) -> CorrectionSetup:  # fmt: skip
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
    count, parts = min(_MOST_FILES, 1 + observations.rows // _ROWS_OF_A_FILE), None
    if observations.sample is not None:
        wanted = np.unique(hashes_of(observations.sampled(points=True).point))
        parts, count = [observations.of_points(lambda hashes: rows_among(hashes, wanted))], 1
    images = pa.array(setup.images, pa.string())
    orientations = orientations_of_mission(mission, stations)
    counts: Counter[str] = Counter()
    shares = []
    with ExitStack() as stack:
        files = [stack.enter_context(TemporaryFile()) for _ in range(count)]
        for batch in parts or observations.batches(_BATCH_ROWS):
            part = np.empty(len(batch), _RAY)
            part["point"] = pd.util.hash_pandas_object(batch.point.to_pandas(), index=False)
            rows = batch.rows
            part["row"] = np.r_[rows] if isinstance(rows, slice) else rows
            part["station"] = matching_rows(batch.image, images)
            part["x"], part["y"] = batch.x_px, batch.y_px
            named = batch.point.is_valid().to_numpy(zero_copy_only=False)
            part = part[named & (part["station"] >= 0) & np.isfinite(part["x"] + part["y"])]
            of_file = part["point"] % np.uint64(count)
            for number in np.unique(of_file):
                files[number].write(part[of_file == number].tobytes())
        for file in files:
            file.seek(0)
            rays = np.frombuffer(file.read(), _RAY)
            if rays.size == 0:
                continue
            h_msl, found = _heights_of(rays, setup, stations, orientations)
            heights[:, rays["row"]] = h_msl, found.sigma_m[found.index]
            counts["points"] += found.h_m.size
            for why in ("few", "narrow", "apart"):
                counts[why] += int(getattr(found, why).sum())
            with np.errstate(invalid="ignore"):
                above = stations.h_msl_m[rays["station"]] - h_msl
                share = found.sigma_m[found.index] / np.abs(above)
            shares.append(share[np.isfinite(share)][:: max(1, rays.size // 10_000)])
    known = counts["points"] - counts["few"] - counts["narrow"] - counts["apart"]
    share = float(np.median(np.concatenate(shares))) if known else np.nan
    what = (
        f"{known} of {counts['points']} points have a height by the intersection of their rays; "
        f"{counts['few']} have fewer than two rays, {counts['narrow']} only rays within 3 deg of "
        f"each other, and of {counts['apart']} the rays do not meet"
    )
    if known == 0:
        raise MissionError.of("GROUND-INTERSECTED", "ground.height", what=what)
    what += f"; sigma of a height is {100.0 * share:.2g} % of the height above it, in the median"
    kind = Kind.LOSS if share > _POOR else Kind.NOTE
    ledger.add(Entry(kind, "GROUND-INTERSECTED", what, "ground.height", known))
    return replace(setup, ground=ComputedGround(heights))


def _heights_of(
    rays: NDArray[np.void], setup: CorrectionSetup, stations: Stations, orientations: Orientations
) -> tuple[Array, PointHeights]:
    """(n,) heights of points above sea level; a first intersection says how rays are bent."""
    x, y, station = (rays[name] for name in ("x", "y", "station"))
    undulation = np.nan_to_num(stations.h_ellipsoid_m - stations.h_msl_m)[station]
    h_msl = np.full(rays.size, np.nan)
    for bent in (False, setup.direction == "remove"):
        seen_x, seen_y = x.copy(), y.copy()
        for rows, camera, profile in setup.groups(station) if bent else ():
            corrected = correct_observations(
                x[rows], y[rows], h_msl[rows], station[rows], setup.exposures, camera=camera,
                table=setup.rays[profile],
            )  # fmt: skip
            seen_x[rows], seen_y[rows] = corrected.x_corrected_px, corrected.y_corrected_px
        direction, sigma = setup.directions(seen_x, seen_y, station)
        found = point_heights(orientations, ImageRays(station, rays["point"], direction, sigma))
        number = np.maximum(np.bincount(found.index), 1)
        h_msl = (found.h_m - np.bincount(found.index, undulation) / number)[found.index]
    return h_msl, found
