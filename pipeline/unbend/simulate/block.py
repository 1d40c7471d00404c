"""The block of images with known truth: stations, ground points, observations, and their tables."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from unbend.simulate import flight as plan
from unbend.simulate import messages, optics
from unbend.simulate.flight import UNDULATION_M, AirState, Flight
from unbend.simulate.sensors import unix_ns
from unbend.simulate.true_air import TrueAir, relative_humidity, temperature_k, vapour_pressure_pa
from unbend.units import Array, Integers

FEWEST_IMAGES = 2  # a point seen once measures nothing

CONVENTIONS = {
    "pixels": "the centre of the upper left pixel is (0.5, 0.5)",
    "quaternion": "v_camera = R(q) v_enu, Hamilton, q_w >= 0; camera x right, y down, z forward",
    "r_c": "positive where the apparent ray is farther from the nadir than the straight one",
    "r_cc": "positive where the cabin moved the image point inward",
    "true_px": "projection of the straight chord, without window and air",
}


@dataclass(frozen=True, eq=False)
class TrueStations:
    """Projection centres and attitudes (n,), camera by camera, with the air at each."""

    image: tuple[str, ...]
    camera: Integers
    time_ns: Integers
    ecef_m: Array  # (n, 3)
    lat_rad: Array
    lon_rad: Array
    h_ellipsoid_m: Array
    camera_from_enu: Array  # (n, 3, 3)
    quaternion: Array  # (n, 4) w, x, y, z: v_camera = R(q) v_enu
    outside: AirState
    cabin: AirState

    @property
    def h_msl_m(self) -> Array:
        """Height above mean sea level (n,) [m]."""
        return self.h_ellipsoid_m - UNDULATION_M


@dataclass(frozen=True, eq=False)
class GroundPoints:
    """Points on the terrain (n,): radians and metres."""

    name: tuple[str, ...]
    lat_rad: Array
    lon_rad: Array
    h_msl_m: Array
    ecef_m: Array  # (n, 3)


@dataclass(frozen=True, eq=False)
class TrueObservations:
    """What the cameras measure without error (n,), and what they would without air."""

    station: Integers
    point: Integers
    x_px: Array
    y_px: Array
    x_true_px: Array
    y_true_px: Array
    zeta_c_rad: Array
    r_c_rad: Array
    r_cc_rad: Array
    miss_m: Array


def stations(
    flight: Flight, air: TrueAir, cameras: tuple[optics.SimulatedCamera, ...]
) -> TrueStations:
    """Where each camera was at each exposure: the reference point plus the lever arm."""
    truth = flight.at(flight.exposure_s)
    reference = optics.to_ecef(truth.lat_rad, truth.lon_rad, truth.h_msl_m + UNDULATION_M)
    axes = optics.enu_axes(truth.lat_rad, truth.lon_rad)
    angles = zip(truth.roll_rad, truth.pitch_rad, truth.yaw_rad, strict=True)
    turns = [optics.NED_FROM_ENU.T @ optics.body_rotation(*rotation) for rotation in angles]
    enu_from_body = np.stack(turns)
    ecef, rotations = [], []
    for camera in cameras:
        offset = enu_from_body @ np.array(camera.lever_arm_m)
        ecef.append(reference + np.einsum("nij,ni->nj", axes, offset))
        # The axes of the horizon turn by 1e-7 rad over a lever arm: attitude is the camera's own.
        rotations.append(camera.from_body() @ np.swapaxes(enu_from_body, 1, 2))
    positions, rotation = np.concatenate(ecef), np.concatenate(rotations)
    height, up = optics.height_and_up(positions)
    msl = height - UNDULATION_M
    time_s = np.tile(flight.exposure_s, len(cameras))
    count = len(flight.exposure_s)
    vapour, humidity = vapour_pressure_pa(msl), relative_humidity(msl)
    outside = AirState(air.pressure_pa(msl), temperature_k(msl), vapour, humidity, air.n(msl))
    names = tuple(f"{c.name}_{i:05d}" for c in cameras for i in range(1, count + 1))
    shots = names, np.repeat(np.arange(len(cameras)), count), unix_ns(time_s)
    place = positions, np.arcsin(up[:, 2]), np.arctan2(up[:, 1], up[:, 0]), height
    attitude = rotation, np.stack([optics.quaternion(r) for r in rotation])
    return TrueStations(*shots, *place, *attitude, outside, plan.cabin_air(air, msl, time_s))


def _candidates(spacing_m: float, flight: Flight, rng: np.random.Generator) -> GroundPoints:
    """A jittered grid of points on the terrain around the lines, in random order."""
    path = flight.path(flight.exposure_s)
    reach = 3.0 * float(path[:, 2].max())
    low, high = path.min(axis=0) - reach, path.max(axis=0) + reach
    grid = np.meshgrid(np.arange(low[0], high[0], spacing_m), np.arange(low[1], high[1], spacing_m))
    place = np.stack([axis.ravel() for axis in grid], axis=-1)
    place += rng.uniform(-0.45, 0.45, place.shape) * spacing_m
    place = place[rng.permutation(len(place))]
    lat, lon = plan.geographic(place[:, 0], place[:, 1])
    h_msl = np.round(plan.terrain_m(place[:, 0], place[:, 1]), 3)
    return GroundPoints((), lat, lon, h_msl, optics.to_ecef(lat, lon, h_msl + UNDULATION_M))


def _in_camera(stations_: TrueStations, station: Integers, direction: Array) -> Array:
    """Unit vectors (n, 3) along ECEF axes, in the axes of the cameras of those stations."""
    axes = optics.enu_axes(stations_.lat_rad[station], stations_.lon_rad[station])
    rotation = stations_.camera_from_enu[station] @ axes
    return np.asarray(np.einsum("nij,nj->ni", rotation, direction))


def choose_points(
    flight: Flight,
    block: TrueStations,
    cameras: tuple[optics.SimulatedCamera, ...],
    points_per_image: int,
    rng: np.random.Generator,
) -> tuple[GroundPoints, Integers, Integers]:
    """Points, and the (station, point) pairs of the observations: each point in two images or more.

    Points are taken in random order into every image that sees them and is not full.
    """
    height = float(np.max(flight.path(flight.exposure_s)[:, 2]))
    footprint = height**2 * cameras[0].width_px * cameras[0].height_px / cameras[0].focal_px ** 2
    spacing = float(np.sqrt(footprint / (1.6 * points_per_image)))
    pool = _candidates(spacing, flight, rng)
    count = len(block.image)
    seen = np.zeros((len(pool.lat_rad), count), bool)
    for k in range(count):
        chord = optics.unit(pool.ecef_m - block.ecef_m[k])
        rays = _in_camera(block, np.full(len(chord), k), chord)
        seen[:, k] = cameras[block.camera[k]].sees(rays)
    room = np.full(count, points_per_image)
    pairs: list[tuple[int, int]] = []
    kept: list[int] = []
    for candidate in np.flatnonzero(seen.sum(axis=1) >= FEWEST_IMAGES).tolist():
        images = np.flatnonzero(seen[candidate] & (room > 0))
        if len(images) >= FEWEST_IMAGES:
            pairs += [(int(k), len(kept)) for k in images]
            kept.append(candidate)
            room[images] -= 1
    if not pairs:
        raise messages.sim_points(fewest=FEWEST_IMAGES, number=count)
    pairs.sort()
    station, point = np.array(pairs, np.int64).T
    names = tuple(f"p{i:05d}" for i in range(1, len(kept) + 1))
    points = GroundPoints(
        names, pool.lat_rad[kept], pool.lon_rad[kept], pool.h_msl_m[kept], pool.ecef_m[kept]
    )
    return points, station, point


def observe(
    air: TrueAir,
    block: TrueStations,
    points: GroundPoints,
    cameras: tuple[optics.SimulatedCamera, ...],
    *,
    station: Integers,
    point: Integers,
) -> TrueObservations:
    """Bend every ray, send it through the window and the lens; beside it the straight chord."""
    rays = optics.shoot(air, block.ecef_m[station], points.ecef_m[point], UNDULATION_M)
    apparent = _in_camera(block, station, rays.apparent)
    straight = _in_camera(block, station, rays.straight)
    inside, r_cc = optics.through_window(apparent, block.outside.n[station], block.cabin.n[station])
    measured, true = np.empty((2, len(station))), np.empty((2, len(station)))
    for index, camera in enumerate(cameras):
        rows = block.camera[station] == index
        measured[:, rows] = camera.project(inside[rows])
        true[:, rows] = camera.project(straight[rows])
    up = optics.height_and_up(block.ecef_m)[1][station]
    down = -np.sum(rays.apparent * up, axis=-1)
    zeta = np.arctan2(np.linalg.norm(np.cross(rays.apparent, up), axis=-1), down)
    (x, y), (x_true, y_true), r_c = measured, true, rays.r_c_rad
    return TrueObservations(station, point, x, y, x_true, y_true, zeta, r_c, r_cc, rays.miss_m)


def write_table(path: Path, columns: dict[str, object]) -> None:
    """Write one Parquet file with the conventions in its metadata."""
    table = pa.table(columns)
    table = table.replace_schema_metadata({"unbend.conventions": json.dumps(CONVENTIONS)})
    pq.write_table(table, path, compression="zstd")


def write_tables(
    out: Path,
    air: TrueAir,
    block: TrueStations,
    points: GroundPoints,
    seen: TrueObservations,
    *,
    cameras: tuple[optics.SimulatedCamera, ...],
    noise_px: float,
    rng: np.random.Generator,
) -> None:
    """Write the observations with noise [px], and the truth in a folder of its own."""
    truth = out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    measured, true = observation_columns(block, points, seen, noise_px, rng)
    write_table(out / "observations.parquet", measured)
    write_table(truth / "observations.parquet", true)
    write_table(truth / "stations.parquet", station_columns(block, cameras))
    # -100 m to 30 km, 5 m apart up to 5 km and 50 m above.
    h = np.concatenate([np.arange(-100.0, 5000.0, 5.0), np.arange(5000.0, 30_001.0, 50.0)])
    of_air = {"temperature_k": temperature_k(h), "pressure_pa": air.pressure_pa(h)}
    of_air |= {"vapour_pressure_pa": vapour_pressure_pa(h), "refractivity": air.n(h) - 1.0}
    write_table(truth / "profile.parquet", {"h_m": h, **of_air})
    place = {"lat_deg": np.degrees(points.lat_rad), "lon_deg": np.degrees(points.lon_rad)}
    place |= {"h_msl_m": points.h_msl_m, "h_ellipsoid_m": points.h_msl_m + UNDULATION_M}
    write_table(truth / "points.parquet", {"point": list(points.name), **place})


def station_columns(
    stations: TrueStations, cameras: tuple[optics.SimulatedCamera, ...]
) -> dict[str, object]:
    """truth/stations.parquet: one row an image."""
    q = stations.quaternion
    columns = {
        "image": list(stations.image),
        "camera": [cameras[k].name for k in stations.camera],
        "time_utc": pa.array(stations.time_ns, pa.timestamp("ns", tz="UTC")),
        "lat_deg": np.degrees(stations.lat_rad),
        "lon_deg": np.degrees(stations.lon_rad),
        "h_msl_m": stations.h_msl_m,
        "h_ellipsoid_m": stations.h_ellipsoid_m,
        **{name: q[:, i].copy() for i, name in enumerate(("q_w", "q_x", "q_y", "q_z"))},
    }
    for prefix, air in (("", stations.outside), ("cabin_", stations.cabin)):
        for name in ("pressure_pa", "temperature_k", "vapour_pressure_pa"):
            columns[prefix + name] = getattr(air, name)
    return columns | {"n_outside": stations.outside.n, "n_cabin": stations.cabin.n}


def observation_columns(
    stations: TrueStations,
    points: GroundPoints,
    seen: TrueObservations,
    noise_px: float,
    rng: np.random.Generator,
) -> tuple[dict[str, object], dict[str, object]]:
    """observations.parquet, as a photogrammetrist has it, and truth/observations.parquet."""
    images, named = [stations.image[k] for k in seen.station], [points.name[k] for k in seen.point]
    names: dict[str, object] = {"image": images, "point": named}
    quality = rng.integers(1, 6, len(seen.station)).astype(np.int32)
    x, y = noise_px * rng.standard_normal((2, len(seen.station)))
    h_g = points.h_msl_m[seen.point]
    measured = {**names, "x_px": seen.x_px + x, "y_px": seen.y_px + y, "h_g_m": h_g}
    measured["quality"] = quality
    known = "x_px", "y_px", "x_true_px", "y_true_px", "zeta_c_rad", "r_c_rad", "r_cc_rad"
    truth: dict[str, object] = {**names, **{n: getattr(seen, n) for n in known}, "h_g_m": h_g}
    return measured, truth
