"""The data of the report's figures that no manifest holds: a flight, its places and its air."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.rejection import Reason
from unbend.flight.stations import NO_TIME, SUSPECT, UNMATCHED, Stations
from unbend.geodesy import longitudes_near
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import FlightAir
from unbend.refraction.kernels.columns import TILE
from unbend.tables.exports.footprints import ground_corners
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.geodata.map_grids import MapGrid, utm_grid
from unbend.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K, Array, Integers, evenly_spaced

Track = tuple[Integers, Array, Array, Array]
"""Time [Unix ns], latitude, longitude [rad], height above sea level [m] as logged; (n,) each."""

Limits = tuple[float, float, float, float]
"""West, east, south, north [deg]."""

MOST_EXPOSURES, MOST_FOOTPRINTS, MOST_OF_TRACK = 1500, 250, 800

_MOST_SAMPLES = 300
_LEVELS = 60
_MOST_PROFILES = 12
_RELIEF_NODES = 220
_MOST_TILES = 300  # each is read and decoded, some milliseconds


QUANTITIES = (
    "temperature T [°C]", "pressure p [hPa]", "vapour pressure e [hPa]",
    "refractivity N = (n − 1) 10⁶",
)  # fmt: skip
"""The columns of `air_curves`; the fifth is N against the standard [%]."""


@dataclass(frozen=True, eq=False)
class Flown:
    """What the map, the heights and the air of a page show; thinned, longitudes without a jump.

    ``exposures`` and ``track`` are columns (n,) and (m,): time_ns, lat_deg, lon_deg, h_msl_m; of
    the exposures also image, camera, status, ground_m, and ``shown_as`` ok, suspect or unusable, of
    all of which ``counts`` has the numbers. ``footprints`` (k, 4, 2) longitude, latitude [deg] by
    camera, of ``seen`` that could be drawn; ``limits_deg`` those of all places. ``relief`` : limits
    and light (rows, columns) from -1 to 1, NaN where unknown. ``air`` : see `air_curves`. ``grid``
    : the metric grid of the map.
    """

    exposures: Mapping[str, Any]
    counts: Mapping[str, int]
    track: Mapping[str, Any]
    footprints: Mapping[str, Array]
    seen: int
    limits_deg: Limits | None
    relief: tuple[Limits, Array] | None
    air: Mapping[str, Any]
    from_boot: bool = False  # whether times count from a boot, without UTC
    grid: MapGrid | None = None

    @cached_property
    def time(self) -> dict[str, Any]:
        """Seconds of exposures and track after ``begin_ns``, their ``span``, and ``heights_m``.

        Where nothing has a time, ``begin_ns`` is None and exposures are numbered.
        """
        exposures, track = self.exposures, self.track
        heights = np.concatenate([exposures["h_msl_m"], exposures["ground_m"], track["h_msl_m"]])
        heights = heights[np.isfinite(heights)]
        time_ns = exposures["time_ns"]
        timed = np.concatenate([time_ns[time_ns != NO_TIME], track["time_ns"]])
        begin = int(timed.min()) if timed.size else None
        of_exposures = np.arange(time_ns.size, dtype=np.float64)
        if begin is not None:
            of_exposures = np.where(time_ns == NO_TIME, np.nan, (time_ns - begin) * 1e-9)
        margin = 0.05 * max(float(np.ptp(heights)), 10.0) if heights.size else 0.0
        return {
            "is_utc": not self.from_boot,
            "begin_ns": begin,
            "of_exposures": of_exposures,
            "of_track": (track["time_ns"] - (begin or 0)) * 1e-9,
            "span": max(time_ns.size - 1.0 if begin is None else (timed.max() - begin) * 1e-9, 1.0),
            "heights_m": (float(heights.min()) - margin, float(heights.max()) + margin)
            if heights.size
            else None,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class CameraTrack:
    """The exposures of a camera in the order of their times: (n,) columns, NaN between strips."""

    lon_deg: Array
    lat_deg: Array
    h_msl_m: Array
    time: Array  # as `Flown.time` has it


_WIDEST_GRID_DEG = 6.0  # of a map with a metric grid: the width of a UTM zone
_LONGEST_GAP = 5.0  # of the usual time between two exposures, within a strip


def track_of_camera(flown: Flown, camera: str) -> CameraTrack:
    """The usable exposures of a camera as a line, with a gap after each strip."""
    exposures = flown.exposures
    is_shown = (exposures["camera"] == camera) & (exposures["shown_as"] != "unusable")
    rows = np.flatnonzero(is_shown & np.isfinite(exposures["lat_deg"]))
    rows = rows[np.argsort(exposures["time_ns"][rows], kind="stable")]
    gaps = np.diff(exposures["time_ns"][rows]).astype(np.float64)
    first_of_strips = np.zeros(0, np.int64)
    if gaps.size:
        first_of_strips = np.flatnonzero(gaps > _LONGEST_GAP * np.median(gaps)) + 1

    def in_strips(column: Array) -> Array:
        """Values of the exposures, with NaN before each strip but the first."""
        return np.insert(column[rows].astype(np.float64), first_of_strips, np.nan)

    return CameraTrack(
        lon_deg=in_strips(exposures["lon_deg"]),
        lat_deg=in_strips(exposures["lat_deg"]),
        h_msl_m=in_strips(exposures["h_msl_m"]),
        time=in_strips(flown.time["of_exposures"]),
    )


def flown_of(
    stations: Stations,
    air: FlightAir,
    samples: AirSamples,
    track: Track,
    *,
    cameras: Mapping[str, Camera],
    ground_m: Array,
    radius_m: float | None,
    terrain: ElevationModel | None,
) -> Flown:
    """What a page shows of a flight; ``ground_m`` (s,) below each station, NaN for the median."""
    if np.isfinite(ground_m).any():
        ground_m = np.where(np.isfinite(ground_m), ground_m, np.nanmedian(ground_m))
    suspect, exposed = stations.status == SUSPECT, stations.status != UNMATCHED
    shown_as = np.where(suspect, "suspect", np.where(stations.ok, "ok", "unusable"))
    flagged = np.flatnonzero(shown_as != "ok")
    rows = np.union1d(
        evenly_spaced(len(stations), MOST_EXPOSURES),
        flagged[evenly_spaced(flagged.size, MOST_EXPOSURES)],
    ).astype(np.int64)
    time_ns, *places = (column[evenly_spaced(track[0].size, MOST_OF_TRACK)] for column in track)
    lon = np.concatenate([stations.lon_rad, places[1]])
    known = lon[np.isfinite(lon)][:1]
    lon = longitudes_near(lon, known[0]) if known.size else lon
    lon_deg, track_lon = np.split(lon / DEGREE, [len(stations)])
    seen = np.flatnonzero(stations.ok & np.isfinite(ground_m))
    drawn = seen[evenly_spaced(seen.size, MOST_FOOTPRINTS)]
    corners = ground_corners(stations.rows(drawn), cameras, ground_m[drawn], radius_m)
    whole = np.isfinite(corners).all(axis=(1, 2))
    everything = np.concatenate([
        np.stack([lon_deg, stations.lat_rad / DEGREE], axis=1),
        np.stack([track_lon, places[0] / DEGREE], axis=1), corners.reshape(-1, 2),
    ])  # fmt: skip
    everything = everything[np.isfinite(everything).all(axis=1)]
    limits = None
    if everything.size:
        low, high = everything.min(axis=0).tolist(), everything.max(axis=0).tolist()
        limits = low[0], high[0], low[1], high[1]
    heights = np.concatenate([stations.h_msl_m, ground_m])
    shown = {
            "image": stations.image[rows], "camera": stations.camera[rows],
            "time_ns": stations.time_ns[rows],
            "lat_deg": stations.lat_rad[rows] / DEGREE, "lon_deg": lon_deg[rows],
            "h_msl_m": stations.h_msl_m[rows], "ground_m": ground_m[rows],
            "status": stations.status[rows], "shown_as": shown_as[rows],
    }  # fmt: skip
    return Flown(
        shown,
        {name: int((exposed & (shown_as == name)).sum()) for name in ("ok", "suspect", "unusable")},
        {"time_ns": time_ns, "lat_deg": places[0] / DEGREE, "lon_deg": track_lon,
         "h_msl_m": places[2]},
        {name: corners[whole & (stations.camera[drawn] == name)] for name in cameras},
        int(seen.size),
        limits,
        None if terrain is None or limits is None else relief_of(terrain, limits),
        air_curves(air, samples, heights[np.isfinite(heights)]),
        from_boot=bool(stations.from_boot.any()),
        grid=None if limits is None else metric_grid(limits),
    )  # fmt: skip


def metric_grid(limits_deg: Limits) -> MapGrid | None:
    """The UTM zone of the middle of a map; None near the poles, and on a map of several zones."""
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    if max(east - west, north - south) > _WIDEST_GRID_DEG:
        return None
    lon_deg = 0.5 * sum(limits_deg[:2])
    lat_deg = 0.5 * sum(limits_deg[2:])
    return utm_grid(lat_deg, (lon_deg + 180.0) % 360.0 - 180.0)


def relief_of(terrain: ElevationModel, limits_deg: Limits) -> tuple[Limits, Array] | None:
    """Light from the north-west on a model within limits, and these with a margin.

    None where it has no heights there, or is so fine that drawing it would cost more than the run.
    """
    west, east, south, north = limits_deg + 2e-4 * np.array([-1.0, 1.0, -1.0, 1.0])
    per_degree = 111_200.0 * np.array([np.cos(np.radians(0.5 * (south + north))), 1.0])
    size = np.array([east - west, north - south]) * per_degree
    columns, rows = np.maximum(2, np.round(_RELIEF_NODES * size / size.max())).astype(int)
    lon = west + (np.arange(columns) + 0.5) * (east - west) / columns
    lat = north - (np.arange(rows) + 0.5) * (north - south) / rows
    grid_lon, grid_lat = (a.ravel() * DEGREE for a in np.meshgrid(lon, lat))
    row, column = terrain.nodes(grid_lat, grid_lon)
    tiles = np.unique(np.floor(np.stack([row, column]) / TILE), axis=1).shape[1]
    if tiles > _MOST_TILES:
        return None
    heights = terrain.heights(row, column).reshape(rows, columns)
    down, right = np.gradient(heights, size[1] / rows, size[0] / columns)
    steep = np.hypot(down, right)
    if not np.isfinite(steep).any():
        return None
    # Slopes are exaggerated so that the steepest tenth has nearly the full contrast.
    light = np.tanh((down + right) / max(float(np.nanpercentile(steep, 90)), 1e-3))
    return (float(west), float(east), float(south), float(north)), light


def air_curves(air: FlightAir, samples: AirSamples, heights_m: Array) -> dict[str, Any]:
    """T [°C], p, e [hPa], N and N against the standard [%] at heights ``h_m`` around those given.

    ``ours`` (None in the standard's air), ``standard``, ``sigma`` (or None) and each of ``parts``
    hold five columns, ``limits`` the range of each; ``samples`` those of some readings by sensor.
    """
    adjustment = air.adjustment
    profile, standard, covariance = adjustment.profile, adjustment.standard, adjustment.covariance
    measured: list[tuple[int, str, Any, Array]] = []
    if (sensor := samples.temperature) is not None:
        measured.append((0, "temperature", sensor, sensor.value - ZERO_CELSIUS_K))
    if (sensor := samples.pressure) is not None:
        measured.append((1, "pressure", sensor, sensor.value / HECTOPASCAL))
    if (sensor := samples.humidity) is not None:
        humidity, at = np.clip(sensor.value, 0.0, 1.0), sensor.h_m
        e_pa = vapour_pressure(humidity, profile.temperature(at), profile.pressure(at))
        measured.append((2, "humidity", sensor, np.asarray(e_pa) / HECTOPASCAL))
    heights = np.concatenate([heights_m, *(sensor.h_m for _, _, sensor, _ in measured)])
    heights = heights[np.isfinite(heights)]
    low, high = (heights.min(), heights.max()) if heights.size else (0.0, 10_000.0)
    margin = max(0.06 * (high - low), 50.0) if heights.size else 0.0
    h = np.linspace(max(low - margin, profile.bottom_m), min(high + margin, profile.top_m), _LEVELS)
    n_standard = standard.refractivity(h)

    def columns(of: Any) -> list[Array]:
        n = of.refractivity(h)
        t_celsius, e_hpa = of.temperature(h) - ZERO_CELSIUS_K, of.vapour_pressure(h) / HECTOPASCAL
        p_hpa, more_percent = of.pressure(h) / HECTOPASCAL, 100.0 * (n / n_standard - 1.0)
        return [t_celsius, p_hpa, e_hpa, n * 1e6, more_percent]

    sigma = None
    if covariance is not None:
        sigma_n = covariance.sigma_refractivity(h)
        sigma = [
            covariance.sigma_temperature(h),
            covariance.sigma_log_pressure(h) * profile.pressure(h) / HECTOPASCAL,
            covariance.sigma_vapour_pressure(h) / HECTOPASCAL,
            sigma_n * 1e6,
            100.0 * sigma_n / n_standard,
        ]
    shown: list[dict[str, Any]] = []
    for column, quantity, sensor, values in measured:
        used = adjustment.rejected.get(quantity, sensor.rejected) == Reason.USED
        known = np.isfinite(values) & np.isfinite(sensor.h_m)
        groups: Sequence[Any] = [np.flatnonzero(known & which) for which in (used, ~used)]
        rows, not_used = (group[evenly_spaced(group.size, _MOST_SAMPLES)] for group in groups)
        shown.append({
            "quantity": quantity, "sensor": sensor.name, "column": column,
            "values_used": values[rows], "h_used": sensor.h_m[rows],
            "values_not_used": values[not_used], "h_not_used": sensor.h_m[not_used],
            "count": int(known.sum()), "count_used": int(groups[0].size),
        })  # fmt: skip
    parts = [window.air.profile for window in air.windows if not window.why_not][:_MOST_PROFILES]
    theirs, of_parts = columns(standard), [columns(part) for part in parts]
    ours = None if profile is standard else columns(profile)
    limits = []
    for i in range(5):
        shown_here = [theirs[i], *([] if ours is None else [ours[i]])]
        shown_here += [part[i] for part in of_parts if i < 4]
        if ours is not None and sigma is not None:
            shown_here += [ours[i] - sigma[i], ours[i] + sigma[i]]
        for of in shown:
            if of["column"] == i:
                shown_here += [of["values_used"], of["values_not_used"]]
        every = np.concatenate(shown_here)
        margin = 0.04 * max(float(np.ptp(every)), 5.0)
        limits.append((float(every.min()) - margin, float(every.max()) + margin))
    return {
        "h_m": h, "samples": shown, "standard_name": standard.name, "basis": adjustment.basis,
        "standard": theirs, "sigma": sigma, "parts": of_parts, "ours": ours, "limits": limits,
    }  # fmt: skip


def utc(time_ns: int) -> str:
    """A time [Unix ns] to the second; a dash where there is none.

    >>> utc(1_500_000_000)
    '1970-01-01 00:00:01'
    """
    if time_ns == NO_TIME:
        return "–"
    return str(np.datetime64(int(time_ns), "ns").astype("datetime64[s]")).replace("T", " ")
