"""Heights of points from a table of the user's: in the datum of the stations, and near them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pyarrow as pa

from pipeline.batch.plan import Plan
from pipeline.errors import InputError
from pipeline.flight.heights import HeightSystem, known_home_m
from pipeline.flight.stations import Stations
from pipeline.geodesy import ecef_of_geodetic
from pipeline.ledger import Ledger
from pipeline.stages.inputs import FlightLog, user_geoid
from pipeline.stages.multi_image.oriented_stations import block_points
from pipeline.tables.geodata.coordinate_systems import places_of
from pipeline.tables.geodata.object_points import ObjectPoints, matching_rows, read_object_points
from pipeline.tables.observations import Observations
from pipeline.units import WGS84_A

_STEEPEST = 20.0
"""Points farther away than this many flying heights are seen at more than 87 deg."""


def with_object_points(
    plan: Plan, observations: Observations, flight: FlightLog, ledger: Ledger
) -> Observations:
    """The observations with heights above sea level from the table of object points, if any.

    Or from the block that orients the images.
    """
    section, reference = plan.mission.ground.points, plan.mission.ground.reference
    if plan.mission.ground.height == "block":
        return replace(observations, points=block_points(plan, flight, ledger))
    if section is None:
        return observations
    points = read_points(
        plan, "object points", section.crs, section.columns.named, reference=reference,
        key="ground.height", heights=flight.heights, ledger=ledger,
    )  # fmt: skip
    return replace(observations, points=points)


def read_points(
    plan: Plan,
    role: str,
    crs: str,
    columns: Mapping[str, str],
    *,
    reference: str,
    key: str,
    heights: HeightSystem,
    ledger: Ledger,
) -> ObjectPoints:
    """The points of a table of the user's with heights above sea level.

    ``role`` is that of the input, ``columns``, ``crs`` and ``reference`` what the mission file
    states of it under ``key``. Refuses as `read_object_points` and `places_of`.
    """
    path = plan.input(role).path
    name, value = read_object_points(path, columns, key=f"{key}.columns")
    axes = ("x", "y") if "x" in value else ("longitude", "latitude")
    places = ledger.take(
        places_of(
            crs, (value[axes[0]], value[axes[1]], value["height"]), heights=reference,
            geoid=user_geoid(plan), where=str(path), key=f"{key}.crs",
        )
    )  # fmt: skip
    h = places.h_m
    if places.heights == "ellipsoid":
        h = h - heights.undulation(places.lat_rad, places.lon_rad)
    elif places.heights == "relative":
        h = h + known_home_m(heights)
    return ObjectPoints(name, places.lat_rad, places.lon_rad, h)


def check_object_points(observations: Observations, stations: Stations, ledger: Ledger) -> None:
    """Compare the places of object points with the stations that see them.

    Refuses (InputError) a table that has none of the points (POINTS-MISSING), and points that most
    stations cannot see because they lie below the horizon (POINTS-FAR); a loss where they are, in
    the median, seen at more than 87 deg from the nadir.
    """
    points = observations.points
    if points is None:
        return
    batch = next(observations.batches(100_000))
    _, row = points.heights(batch.point, batch.image)
    station = matching_rows(batch.image, pa.array(stations.image, pa.string()))
    if points.of_image is None and not bool((row >= 0).any()):
        raise InputError(
            "POINTS-MISSING",
            f"none of the points of {len(batch)} observations is in the table: these are "
            f"{batch.point[0]} ..., the table has {points.name[0]} ...",
            where="ground.height.points",
            remedy="write the names as in the observations, or name the column: "
            "ground.height.columns.point",
        )
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
    what = f"the object points lie {usual / 1000.0:.0f} km from the stations that see them, in the "
    what += "median"
    swapped = ecef_of_geodetic(lon, lat, h) - ecef_of_geodetic(*seen)
    exchanged = float(np.nanmedian(np.linalg.norm(swapped, axis=1)))
    if exchanged < 0.1 * usual:
        what += f"; with latitude and longitude exchanged {exchanged / 1000.0:.0f} km"
    if usual > horizon:
        raise InputError(
            "POINTS-FAR", f"{what}: behind their horizon", where="ground.height.points",
            remedy="name the columns, and state the system they are in: ground.height.columns, "
            "ground.height.crs",
        )  # fmt: skip
    ledger.loss("POINTS-FAR", what, where="ground.height.points", count=int(known.sum()))
