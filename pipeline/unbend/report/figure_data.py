"""The data of the report's figures that no manifest holds: a flight, its places and its air."""

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

MAX_EXPOSURES = 1500  # of all, and as many of those that are not ok
MAX_FOOTPRINTS = 250
MAX_TRACK_POINTS = 800

RELIEF_NODES = 220  # of the longer side
RELIEF_MARGIN_DEG = 2e-4
METRES_A_DEGREE = 111_200.0  # of a great circle
LEAST_SLOPE = 1e-3  # of a relief with contrast: a plain stays grey
MAX_TILES = 300  # each is read and decoded, some milliseconds

WIDEST_GRID_DEG = 6.0  # of a map with a metric grid: the width of a UTM zone
LONGEST_GAP = 5.0  # of the usual time between two exposures, within a strip

STATES = ("ok", "suspect", "unusable")
"""How an exposure is shown."""

HEIGHT_MARGIN = 0.05  # of the heights of a flight, above and below them
MIN_HEIGHT_RANGE_M = 10.0


@dataclass(frozen=True, eq=False)
class FlightTimes:
    """Times of a flight along an axis: seconds after ``begin_ns`` [Unix ns], from 0 to ``span``.

    Where nothing has a time, ``begin_ns`` is None and exposures are numbered. ``heights_m`` is the
    range of heights above sea level, None where none is known.
    """

    is_utc: bool
    begin_ns: int | None
    of_exposures: Array
    of_track: Array
    span: float
    heights_m: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Flown:
    """What the map, the heights and the air of a page show; thinned, longitudes without a jump.

    ``exposures`` and ``track`` are columns (n,) and (m,): time_ns, lat_deg, lon_deg, h_msl_m; of
    the exposures also image, camera, status, ground_m, and ``shown_as`` ok, suspect or unusable, of
    all of which ``counts`` has the numbers. ``footprints`` (k, 4, 2) longitude, latitude [deg] by
    camera, of ``seen`` that could be drawn; ``limits_deg`` those of all places. ``relief`` : limits
    and light (rows, columns) from -1 to 1, NaN where unknown. ``grid`` : the metric grid of the
    map.
    """

    exposures: Mapping[str, NDArray[Any]]
    counts: Mapping[str, int]
    track: Mapping[str, NDArray[Any]]
    footprints: Mapping[str, Array]
    seen: int
    limits_deg: Limits | None
    relief: tuple[Limits, Array] | None
    air: AirCurves
    from_boot: bool = False  # whether times count from a boot, without UTC
    grid: MapGrid | None = None

    @cached_property
    def time(self) -> FlightTimes:
        """When the exposures and the track were, and between which heights."""
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
        """The range of heights above sea level [m] of exposures, ground and track."""
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
    """The exposures of a camera in the order of their times: (n,) columns, NaN between strips."""

    lon_deg: Array
    lat_deg: Array
    h_msl_m: Array
    time: Array  # as `Flown.time` has it


def track_of_camera(flown: Flown, camera: str) -> CameraTrack:
    """The usable exposures of a camera as a line, with a gap after each strip."""
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
    """What a page shows of a flight; ``ground_m`` (s,) below each station, NaN for the median."""
    if np.isfinite(ground_m).any():
        ground_m = np.where(np.isfinite(ground_m), ground_m, np.nanmedian(ground_m))
    shown_as = states_of(stations)
    path = thinned(track, MAX_TRACK_POINTS)
    lon_deg, path_lon_deg = continuous_longitudes(stations.lon_rad, path.longitude_rad)
    lat_deg = stations.lat_rad / DEGREE
    path_lat_deg = path.latitude_rad / DEGREE
    seen = np.flatnonzero(stations.ok & np.isfinite(ground_m))
    drawn = seen[evenly_spaced(seen.size, MAX_FOOTPRINTS)]
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
        seen=int(seen.size),
        limits_deg=limits,
        relief=relief,
        air=air_curves(air, samples, np.concatenate([stations.h_msl_m, ground_m])),
        from_boot=bool(stations.from_boot.any()),
        grid=grid,
    )


def states_of(stations: Stations) -> Names:
    """(s,) how each exposure is shown: ok, suspect or unusable."""
    is_suspect = stations.status == SUSPECT
    return np.where(is_suspect, "suspect", np.where(stations.ok, "ok", "unusable"))


def counts_of_states(stations: Stations, shown_as: Names) -> dict[str, int]:
    """How many exposures are shown in each way; images without an exposure do not count."""
    is_exposed = stations.status != UNMATCHED
    counts = {}
    for state in STATES:
        counts[state] = int(np.count_nonzero(is_exposed & (shown_as == state)))
    return counts


def rows_shown(shown_as: Names) -> Integers:
    """Rows of a table: some of all exposures, and some of those that are not ok."""
    flagged = np.flatnonzero(shown_as != "ok")
    some_of_all = evenly_spaced(shown_as.size, MAX_EXPOSURES)
    some_flagged = flagged[evenly_spaced(flagged.size, MAX_EXPOSURES)]
    return np.union1d(some_of_all, some_flagged).astype(np.int64)


def thinned(track: LoggedPath, most: int) -> LoggedPath:
    """At most so many points of a track, evenly spaced."""
    rows = evenly_spaced(track.time_ns.size, most)
    return LoggedPath(
        time_ns=track.time_ns[rows],
        latitude_rad=track.latitude_rad[rows],
        longitude_rad=track.longitude_rad[rows],
        h_msl_m=track.h_msl_m[rows],
    )


def continuous_longitudes(stations_rad: Array, track_rad: Array) -> tuple[Array, Array]:
    """Longitudes [deg] of stations and track without a jump at the 180th meridian."""
    lon_rad = np.concatenate([stations_rad, track_rad])
    known_rad = lon_rad[np.isfinite(lon_rad)]
    if known_rad.size:
        lon_rad = longitudes_near(lon_rad, known_rad[0])
    lon_deg = lon_rad / DEGREE
    return lon_deg[: stations_rad.size], lon_deg[stations_rad.size :]


def limits_of_places(lon_deg: Array, lat_deg: Array) -> Limits | None:
    """What known places (n,) extend over; None where there is none."""
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
    """Footprints (k, 4, 2) of each camera, of those all corners of which are known."""
    is_whole = np.isfinite(corners).all(axis=(1, 2))
    footprints = {}
    for name in cameras:
        footprints[name] = corners[is_whole & (camera_of_image == name)]
    return footprints


def metric_grid(limits_deg: Limits) -> MapGrid | None:
    """The UTM zone of the middle of a map; None near the poles, and on a map of several zones."""
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    if max(east - west, north - south) > WIDEST_GRID_DEG:
        return None
    lon_deg = 0.5 * (west + east)
    lat_deg = 0.5 * (south + north)
    return utm_grid(lat_deg, (lon_deg + 180.0) % 360.0 - 180.0)


def relief_of(terrain: ElevationModel, limits_deg: Limits) -> tuple[Limits, Array] | None:
    """Light from the north-west on a model within limits, and these with a margin.

    None where it has no heights there, or is so fine that drawing it would cost more than the run.
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
    """Light from the north-west, -1 to 1, on heights (rows, columns) at distances [m].

    Slopes are exaggerated so that the steepest tenth has nearly the full contrast.
    """
    down, right = np.gradient(heights_m, row_m, column_m)
    steepness = np.hypot(down, right)
    if not np.isfinite(steepness).any():
        return None
    steep = max(float(np.nanpercentile(steepness, 90)), LEAST_SLOPE)
    return np.asarray(np.tanh((down + right) / steep))


def heights_of_map(
    terrain: ElevationModel, limits_deg: Limits, shape: tuple[int, int]
) -> Array | None:
    """Heights (rows, columns) of a model in the cells of a map; None where it is too fine."""
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
    """A time [Unix ns] to the second; a dash where there is none.

    >>> utc(1_500_000_000)
    '1970-01-01 00:00:01'
    """
    if time_ns == NO_TIME:
        return "–"
    return str(np.datetime64(int(time_ns), "ns").astype("datetime64[s]")).replace("T", " ")
