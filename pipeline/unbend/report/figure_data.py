"""The data of the report's figures that are not in the manifest: exposures, track and air."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.air_samples import AirSamples
from unbend.flight.ground_times import LoggedPath
from unbend.flight.stations import NO_TIME, SUSPECT, UNMATCHED, Stations
from unbend.geodesy import longitudes_near
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import FlightAir
from unbend.refraction.kernels.columns import TILE
from unbend.report.air_curves import AirCurves, air_curves
from unbend.tables.exports.footprints import ground_corners
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.geodata.map_grids import MapGrid, utm_grid
from unbend.units import DEGREE, Array, Integers, Names, evenly_spaced

Limits = tuple[float, float, float, float]
"""West, east, south, north [deg]."""

MAX_EXPOSURES = 1500  # drawn of all, and as many again of those that are not ok
MAX_FOOTPRINTS = 250
MAX_TRACK_POINTS = 800

RELIEF_NODES = 220  # along the longer side of the relief
RELIEF_MARGIN_DEG = 2e-4  # 22 m: also a single place gets a relief
METRES_A_DEGREE = 111_200.0  # of a great circle
LEAST_SLOPE = 1e-3  # that gets the full contrast: a plain stays grey
MAX_TILES = 300  # of the elevation model: each takes some milliseconds to read and decode

WIDEST_GRID_DEG = 6.0  # of a map with a metric grid: the width of a UTM zone
LONGEST_GAP = 5.0  # times the median time between exposures: a longer gap ends a strip

STATES = ("ok", "suspect", "unusable")
"""States of exposures in the figures."""

HEIGHT_MARGIN = 0.05  # above and below the heights of a flight, as a share of their range
MIN_HEIGHT_RANGE_M = 10.0  # for the margin


@dataclass(frozen=True, eq=False)
class FlightTimes:
    """Coordinates of a figure of heights over time: seconds after ``begin_ns``, up to ``span``.

    ``of_exposures`` (n,) [s] are NaN for exposures without a time, ``of_track`` (m,) [s] are those
    of the track. If nothing has a time, ``begin_ns`` [Unix ns] is None, and the coordinates are
    numbers of exposures instead. ``heights_m`` is the range of heights above sea level, None if no
    height is known.
    """

    is_utc: bool
    begin_ns: int | None
    of_exposures: Array
    of_track: Array
    span: float
    heights_m: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Flown:
    """The data of the map, the heights and the air of a page; large flights are thinned.

    Longitudes do not jump at the 180th meridian.

    exposures : columns (n,) time_ns, lat_deg, lon_deg, h_msl_m, image, camera, status, ground_m,
        and shown_as: ok, suspect or unusable.
    counts : state of `STATES` -> the number of all exposures, drawn or not.
    track : columns (m,) time_ns, lat_deg, lon_deg, h_msl_m.
    footprints : camera -> corners (k, 4, 2), longitude and latitude [deg].
    footprint_count : of the exposures with a footprint, drawn or not.
    limits_deg : of all places; None without any.
    relief : its limits, and the light (rows, columns) from -1 to 1, NaN where unknown.
    air : the curves of the air.
    from_boot : whether times count from a boot, without UTC.
    grid : the metric grid of the map, None on a large map.
    """

    exposures: Mapping[str, NDArray[Any]]
    counts: Mapping[str, int]
    track: Mapping[str, NDArray[Any]]
    footprints: Mapping[str, Array]
    footprint_count: int
    limits_deg: Limits | None
    relief: tuple[Limits, Array] | None
    air: AirCurves
    from_boot: bool = False
    grid: MapGrid | None = None

    @cached_property
    def time(self) -> FlightTimes:
        """The coordinates of the figure of heights over time."""
        time_ns = self.exposures["time_ns"]
        is_timed = time_ns != NO_TIME
        timed_ns = np.concatenate([time_ns[is_timed], self.track["time_ns"]])
        if timed_ns.size:
            begin_ns = int(timed_ns.min())
            of_exposures = np.where(is_timed, (time_ns - begin_ns) * 1e-9, np.nan)
            of_track = (self.track["time_ns"] - begin_ns) * 1e-9
            span = (timed_ns.max() - begin_ns) * 1e-9
        else:
            begin_ns = None
            of_exposures = np.arange(time_ns.size, dtype=np.float64)
            of_track = self.track["time_ns"] * 1e-9
            span = time_ns.size - 1.0
        return FlightTimes(
            is_utc=not self.from_boot,
            begin_ns=begin_ns,
            of_exposures=of_exposures,
            of_track=of_track,
            span=max(span, 1.0),
            heights_m=self.heights(),
        )

    def heights(self) -> tuple[float, float] | None:
        """The range of heights above sea level [m] of exposures, ground and track, with a margin.

        None if no height is known.
        """
        heights = np.concatenate(
            [self.exposures["h_msl_m"], self.exposures["ground_m"], self.track["h_msl_m"]]
        )
        known_heights = heights[np.isfinite(heights)]
        if not known_heights.size:
            return None
        margin = HEIGHT_MARGIN * max(float(np.ptp(known_heights)), MIN_HEIGHT_RANGE_M)
        return float(known_heights.min()) - margin, float(known_heights.max()) + margin


@dataclass(frozen=True, eq=False)
class CameraTrack:
    """The exposures of a camera in the order of time, as columns (n,) with NaN between strips."""

    lon_deg: Array
    lat_deg: Array
    h_msl_m: Array
    time: Array  # as `FlightTimes.of_exposures`


def track_of_camera(flown: Flown, camera: str) -> CameraTrack:
    """The exposures of a camera as a line with a gap after each strip; unusable ones are left out.

    A strip ends with a gap of more than `LONGEST_GAP` times the median time between exposures.
    """
    exposures = flown.exposures
    is_shown = (exposures["camera"] == camera) & (exposures["shown_as"] != "unusable")
    rows = np.flatnonzero(is_shown & np.isfinite(exposures["lat_deg"]))
    rows = rows[np.argsort(exposures["time_ns"][rows], kind="stable")]
    gaps = np.diff(exposures["time_ns"][rows]).astype(np.float64)
    first_of_strips = np.zeros(0, np.int64)
    if gaps.size:
        first_of_strips = np.flatnonzero(gaps > LONGEST_GAP * np.median(gaps)) + 1

    def in_strips(column: Array) -> Array:
        """Values of the exposures, with NaN before each strip but the first."""
        return np.insert(column[rows].astype(np.float64), first_of_strips, np.nan)

    return CameraTrack(
        lon_deg=in_strips(exposures["lon_deg"]),
        lat_deg=in_strips(exposures["lat_deg"]),
        h_msl_m=in_strips(exposures["h_msl_m"]),
        time=in_strips(flown.time.of_exposures),
    )


def flown_of(
    stations: Stations,
    air: FlightAir,
    samples: AirSamples,
    track: LoggedPath,
    *,
    cameras: Mapping[str, Camera],
    ground_m: Array,
    radius_m: float | None,
    terrain: ElevationModel | None,
) -> Flown:
    """The data of a page's figures from the stations, the air and the track of a flight.

    ground_m : (s,) height of the ground below each station [m]; NaN is replaced by the median.
    radius_m : of the earth, for footprints, or None; see `ground_corners`.
    terrain : the elevation model for the relief, or None.
    """
    if np.isfinite(ground_m).any():
        ground_m = np.where(np.isfinite(ground_m), ground_m, np.nanmedian(ground_m))
    shown_as = states_of(stations)
    path = thinned(track, MAX_TRACK_POINTS)
    lon_deg, path_lon_deg = continuous_longitudes(stations.lon_rad, path.longitude_rad)
    lat_deg = stations.lat_rad / DEGREE
    path_lat_deg = path.latitude_rad / DEGREE
    with_footprint = np.flatnonzero(stations.ok & np.isfinite(ground_m))
    drawn = with_footprint[evenly_spaced(with_footprint.size, MAX_FOOTPRINTS)]
    corners = ground_corners(stations.rows(drawn), cameras, ground_m[drawn], radius_m)
    limits = limits_of_places(
        np.concatenate([lon_deg, path_lon_deg, corners[..., 0].ravel()]),
        np.concatenate([lat_deg, path_lat_deg, corners[..., 1].ravel()]),
    )
    relief = None
    grid = None
    if limits is not None:
        grid = metric_grid(limits)
        if terrain is not None:
            relief = relief_of(terrain, limits)
    rows = rows_shown(shown_as)
    return Flown(
        exposures={
            "image": stations.image[rows],
            "camera": stations.camera[rows],
            "time_ns": stations.time_ns[rows],
            "lat_deg": lat_deg[rows],
            "lon_deg": lon_deg[rows],
            "h_msl_m": stations.h_msl_m[rows],
            "ground_m": ground_m[rows],
            "status": stations.status[rows],
            "shown_as": shown_as[rows],
        },
        counts=counts_of_states(stations, shown_as),
        track={
            "time_ns": path.time_ns,
            "lat_deg": path_lat_deg,
            "lon_deg": path_lon_deg,
            "h_msl_m": path.h_msl_m,
        },
        footprints=by_camera(corners, stations.camera[drawn], cameras),
        footprint_count=int(with_footprint.size),
        limits_deg=limits,
        relief=relief,
        air=air_curves(air, samples, np.concatenate([stations.h_msl_m, ground_m])),
        from_boot=bool(stations.from_boot.any()),
        grid=grid,
    )


def states_of(stations: Stations) -> Names:
    """(s,) the state of each station in the figures: ok, suspect or unusable."""
    is_suspect = stations.status == SUSPECT
    ok_or_unusable = np.where(stations.ok, "ok", "unusable")
    return np.where(is_suspect, "suspect", ok_or_unusable)


def counts_of_states(stations: Stations, shown_as: Names) -> dict[str, int]:
    """The number of exposures in each state; images without an exposure do not count."""
    is_exposed = stations.status != UNMATCHED
    counts = {}
    for state in STATES:
        counts[state] = int(np.count_nonzero(is_exposed & (shown_as == state)))
    return counts


def rows_shown(shown_as: Names) -> Integers:
    """Indices of the exposures to draw: some of all, and some of those that are not ok.

    ``shown_as`` (s,) are their states; the indices are in increasing order.
    """
    flagged = np.flatnonzero(shown_as != "ok")
    some_of_all = evenly_spaced(shown_as.size, MAX_EXPOSURES)
    some_flagged = flagged[evenly_spaced(flagged.size, MAX_EXPOSURES)]
    return np.union1d(some_of_all, some_flagged).astype(np.int64)


def thinned(track: LoggedPath, most: int) -> LoggedPath:
    """At most ``most`` points of a track, evenly spaced in their order."""
    rows = evenly_spaced(track.time_ns.size, most)
    return LoggedPath(
        time_ns=track.time_ns[rows],
        latitude_rad=track.latitude_rad[rows],
        longitude_rad=track.longitude_rad[rows],
        h_msl_m=track.h_msl_m[rows],
    )


def continuous_longitudes(stations_rad: Array, track_rad: Array) -> tuple[Array, Array]:
    """Longitudes of stations and of the track in degrees, without a jump at the 180th meridian.

    They are within half a turn of the first known one, so they can exceed 180 degrees.
    """
    lon_rad = np.concatenate([stations_rad, track_rad])
    known_rad = lon_rad[np.isfinite(lon_rad)]
    if known_rad.size:
        lon_rad = longitudes_near(lon_rad, known_rad[0])
    lon_deg = lon_rad / DEGREE
    return lon_deg[: stations_rad.size], lon_deg[stations_rad.size :]


def limits_of_places(lon_deg: Array, lat_deg: Array) -> Limits | None:
    """The limits [deg] of places (n,), without those that are NaN; None without any."""
    is_known = np.isfinite(lon_deg) & np.isfinite(lat_deg)
    if not is_known.any():
        return None
    lon = lon_deg[is_known]
    lat = lat_deg[is_known]
    west = float(lon.min())
    east = float(lon.max())
    south = float(lat.min())
    north = float(lat.max())
    return west, east, south, north


def by_camera(corners: Array, camera_of_image: Names, cameras: Iterable[str]) -> dict[str, Array]:
    """Camera -> its footprints (k, 4, 2); those with an unknown corner are left out.

    ``corners`` (n, 4, 2) and ``camera_of_image`` (n,) are those of images.
    """
    is_whole = np.isfinite(corners).all(axis=(1, 2))
    footprints = {}
    for name in cameras:
        footprints[name] = corners[is_whole & (camera_of_image == name)]
    return footprints


def metric_grid(limits_deg: Limits) -> MapGrid | None:
    """The UTM grid of the middle of a map; None near the poles, and for a map wider than a zone."""
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    if max(east - west, north - south) > WIDEST_GRID_DEG:
        return None
    lon_deg = 0.5 * (west + east)
    lat_deg = 0.5 * (south + north)
    return utm_grid(lat_deg, (lon_deg + 180.0) % 360.0 - 180.0)


def relief_of(terrain: ElevationModel, limits_deg: Limits) -> tuple[Limits, Array] | None:
    """The limits of a map with a margin, and the light (rows, columns) on the terrain there.

    None if the model has no heights there, or is so fine that reading it would take longer than the
    run.
    """
    west = limits_deg[0] - RELIEF_MARGIN_DEG
    east = limits_deg[1] + RELIEF_MARGIN_DEG
    south = limits_deg[2] - RELIEF_MARGIN_DEG
    north = limits_deg[3] + RELIEF_MARGIN_DEG
    limits = (west, east, south, north)
    metres_a_degree_east = METRES_A_DEGREE * np.cos(np.radians(0.5 * (south + north)))
    width_m = (east - west) * metres_a_degree_east
    height_m = (north - south) * METRES_A_DEGREE
    longer_m = max(width_m, height_m)
    columns = max(2, round(RELIEF_NODES * width_m / longer_m))
    rows = max(2, round(RELIEF_NODES * height_m / longer_m))
    heights = heights_of_map(terrain, limits, (rows, columns))
    if heights is None:
        return None
    light = light_on(heights, height_m / rows, width_m / columns)
    if light is None:
        return None
    return limits, light


def light_on(heights_m: Array, row_m: float, column_m: float) -> Array | None:
    """Light from the north-west, -1 (shade) to 1, on heights (rows, columns); None if unknown.

    ``row_m`` and ``column_m`` are the distances of rows and columns. Slopes are exaggerated so that
    the steepest tenth of the terrain has nearly the full contrast.
    """
    down, right = np.gradient(heights_m, row_m, column_m)  # rise to the south and to the east
    steepness = np.hypot(down, right)
    if not np.isfinite(steepness).any():
        return None
    steep = max(float(np.nanpercentile(steepness, 90)), LEAST_SLOPE)
    return np.asarray(np.tanh((down + right) / steep))


def heights_of_map(
    terrain: ElevationModel, limits_deg: Limits, shape: tuple[int, int]
) -> Array | None:
    """Heights (rows, columns) of a model at the centres of the cells of a map, from the north-west.

    ``shape`` is (rows, columns). None if that needs more than `MAX_TILES` tiles of the model.
    """
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    rows, columns = shape
    lon = west + (np.arange(columns) + 0.5) * (east - west) / columns
    lat = north - (np.arange(rows) + 0.5) * (north - south) / rows
    lon_of_cells, lat_of_cells = np.meshgrid(lon, lat)
    row, column = terrain.nodes(lat_of_cells.ravel() * DEGREE, lon_of_cells.ravel() * DEGREE)
    tiles = np.unique(np.floor(np.stack([row, column]) / TILE), axis=1)
    if tiles.shape[1] > MAX_TILES:
        return None
    return terrain.heights(row, column).reshape(rows, columns)


def utc(time_ns: int) -> str:
    """A time [Unix ns] as a text in UTC, to the second; a dash for `NO_TIME`.

    >>> utc(1_500_000_000)
    '1970-01-01 00:00:01'
    """
    if time_ns == NO_TIME:
        return "–"
    return str(np.datetime64(int(time_ns), "ns").astype("datetime64[s]")).replace("T", " ")
