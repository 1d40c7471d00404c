"""The simulated block of images: true stations, points and observations, and their tables."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from unbend.simulate import messages
from unbend.simulate.flight import (
    UNDULATION_M,
    AirState,
    Flight,
    cabin_air,
    geographic,
    terrain_m,
)
from unbend.simulate.optics import (
    NED_FROM_ENU,
    SimulatedCamera,
    body_rotation,
    enu_axes,
    height_and_up,
    quaternion,
    shoot,
    through_window,
    to_ecef,
    unit,
)
from unbend.simulate.sensors import unix_ns
from unbend.simulate.true_air import TrueAir, relative_humidity, temperature_k, vapour_pressure_pa
from unbend.units import Array, Integers, Mask

FEWEST_IMAGES = 2  # a point in fewer images cannot be intersected
REACH = 3.0  # [flying heights] how far around the lines there are points
JITTER = 0.45  # [spacings of points] largest displacement from the grid, in each direction
OVERSUPPLY = 1.6  # candidates in a footprint for each point of an image: some are in one image only
LAST_HEIGHT_DIGIT = 3  # decimals of ground heights [m]
TRUE_PIXELS = ("x_px", "y_px", "x_true_px", "y_true_px")
TRUE_ANGLES = ("zeta_c_rad", "r_c_rad", "r_cc_rad")

CONVENTIONS = {
    "pixels": "the centre of the upper left pixel is (0.5, 0.5)",
    "quaternion": "v_camera = R(q) v_enu, Hamilton, q_w >= 0; camera x right, y down, z forward",
    "r_c": "positive where the apparent ray is farther from the nadir than the straight one",
    "r_cc": "positive where the cabin moved the image point inward",
    "true_px": "projection of the straight chord, without window and air",
}


@dataclass(frozen=True, eq=False)
class TrueStations:
    """Projection centres and attitudes (n,), camera by camera, with the air at each.

    ``camera``: the index of the camera of each image.
    """

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
    """Points on the terrain (n,): radians and metres; ``name`` is empty for candidates."""

    name: tuple[str, ...]
    lat_rad: Array
    lon_rad: Array
    h_msl_m: Array
    ecef_m: Array  # (n, 3)


@dataclass(frozen=True, eq=False)
class TrueObservations:
    """The (n,) observations without error.

    station, point : indices of the image and of the ground point.
    x_px, y_px : the pixels that the camera measures.
    x_true_px, y_true_px : the pixels of the straight chord, without window and air.
    zeta_c_rad : nadir angle of the apparent ray at the camera.
    r_c_rad : refraction in the air; r_cc_rad : refraction at the window (signs: `CONVENTIONS`).
    miss_m : by how much the traced ray misses the ground point.
    """

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


def stations(flight: Flight, air: TrueAir, cameras: tuple[SimulatedCamera, ...]) -> TrueStations:
    """The true station of each camera at each exposure: the reference point plus the lever arm."""
    exposures = len(flight.exposure_s)
    time_s = np.tile(flight.exposure_s, len(cameras))
    position, camera_from_enu = camera_poses(flight, cameras)
    height, up = height_and_up(position)
    h_msl = height - UNDULATION_M
    names = []
    for camera in cameras:
        names += [f"{camera.name}_{number:05d}" for number in range(1, exposures + 1)]
    return TrueStations(
        image=tuple(names),
        camera=np.repeat(np.arange(len(cameras)), exposures),
        time_ns=unix_ns(time_s),
        ecef_m=position,
        lat_rad=np.arcsin(up[:, 2]),
        lon_rad=np.arctan2(up[:, 1], up[:, 0]),
        h_ellipsoid_m=height,
        camera_from_enu=camera_from_enu,
        quaternion=np.stack([quaternion(rotation) for rotation in camera_from_enu]),
        outside=outside_air(air, h_msl),
        cabin=cabin_air(air, h_msl, time_s),
    )


def camera_poses(flight: Flight, cameras: tuple[SimulatedCamera, ...]) -> tuple[Array, Array]:
    """Earth-centred positions (n, 3) [m] and attitudes (n, 3, 3), camera by camera."""
    truth = flight.at(flight.exposure_s)
    reference = to_ecef(truth.lat_rad, truth.lon_rad, truth.h_msl_m + UNDULATION_M)
    enu_from_ecef = enu_axes(truth.lat_rad, truth.lon_rad)
    rotations = []
    for angles in zip(truth.roll_rad, truth.pitch_rad, truth.yaw_rad, strict=True):
        rotations.append(NED_FROM_ENU.T @ body_rotation(*angles))
    enu_from_body = np.stack(rotations)
    body_from_enu = np.swapaxes(enu_from_body, 1, 2)
    positions = []
    attitudes = []
    for camera in cameras:
        lever_arm = enu_from_body @ np.array(camera.lever_arm_m)
        positions.append(reference + np.einsum("nij,ni->nj", enu_from_ecef, lever_arm))
        # The ENU axes of the reference point and of the camera differ by 1e-7 rad: neglected.
        attitudes.append(camera.from_body() @ body_from_enu)
    return np.concatenate(positions), np.concatenate(attitudes)


def outside_air(air: TrueAir, h_msl_m: Array) -> AirState:
    """The true air outside at heights above sea level [m]."""
    return AirState(
        pressure_pa=air.pressure_pa(h_msl_m),
        temperature_k=temperature_k(h_msl_m),
        vapour_pressure_pa=vapour_pressure_pa(h_msl_m),
        humidity=relative_humidity(h_msl_m),
        n=air.n(h_msl_m),
    )


def _candidates(spacing_m: float, flight: Flight, rng: np.random.Generator) -> GroundPoints:
    """A jittered grid of points on the terrain around the lines, in random order, without names."""
    path = flight.path(flight.exposure_s)
    reach = REACH * float(path[:, 2].max())
    low = path.min(axis=0) - reach
    high = path.max(axis=0) + reach
    grid = np.meshgrid(
        np.arange(low[0], high[0], spacing_m),
        np.arange(low[1], high[1], spacing_m),
    )
    place = np.stack([axis.ravel() for axis in grid], axis=-1)
    place += rng.uniform(-JITTER, JITTER, place.shape) * spacing_m
    east, north = place[rng.permutation(len(place))].T
    lat, lon = geographic(east, north)
    h_msl = np.round(terrain_m(east, north), LAST_HEIGHT_DIGIT)
    return GroundPoints(
        name=(),
        lat_rad=lat,
        lon_rad=lon,
        h_msl_m=h_msl,
        ecef_m=to_ecef(lat, lon, h_msl + UNDULATION_M),
    )


def _in_camera(block: TrueStations, station: Integers, direction: Array) -> Array:
    """Rotate unit vectors (n, 3) from ECEF axes into the camera axes of the (n,) stations."""
    enu_from_ecef = enu_axes(block.lat_rad[station], block.lon_rad[station])
    camera_from_ecef = block.camera_from_enu[station] @ enu_from_ecef
    return np.asarray(np.einsum("nij,nj->ni", camera_from_ecef, direction))


def choose_points(
    flight: Flight,
    block: TrueStations,
    cameras: tuple[SimulatedCamera, ...],
    points_per_image: int,
    rng: np.random.Generator,
) -> tuple[GroundPoints, Integers, Integers]:
    """Choose points, each in two images or more; returns them, and the observations of them.

    Candidates are taken in random order, each into all images that see it and have fewer than
    ``points_per_image``. The observations are two (n,) arrays: the indices of the stations, and
    those of the points.
    """
    spacing = _point_spacing_m(flight, cameras[0], points_per_image)
    pool = _candidates(spacing, flight, rng)
    seen = _seen_by_images(pool, block, cameras)

    free_places = np.full(len(block.image), points_per_image)  # by image
    chosen: list[int] = []  # rows of the candidates
    pairs: list[tuple[int, int]] = []  # station, point
    for candidate in np.flatnonzero(seen.sum(axis=1) >= FEWEST_IMAGES).tolist():
        images = np.flatnonzero(seen[candidate] & (free_places > 0))
        if len(images) >= FEWEST_IMAGES:
            pairs += [(int(image), len(chosen)) for image in images]
            chosen.append(candidate)
            free_places[images] -= 1
    if not pairs:
        raise messages.sim_points(fewest=FEWEST_IMAGES, number=len(block.image))
    pairs.sort()
    station, point = np.array(pairs, np.int64).T
    points = GroundPoints(
        name=tuple(f"p{number:05d}" for number in range(1, len(chosen) + 1)),
        lat_rad=pool.lat_rad[chosen],
        lon_rad=pool.lon_rad[chosen],
        h_msl_m=pool.h_msl_m[chosen],
        ecef_m=pool.ecef_m[chosen],
    )
    return points, station, point


def _point_spacing_m(flight: Flight, camera: SimulatedCamera, points_per_image: int) -> float:
    """The spacing [m] of candidates: `OVERSUPPLY` times ``points_per_image`` in a footprint."""
    height = float(np.max(flight.path(flight.exposure_s)[:, 2]))
    footprint = height**2 * camera.width_px * camera.height_px / camera.focal_px**2
    return float(np.sqrt(footprint / (OVERSUPPLY * points_per_image)))


def _seen_by_images(
    points: GroundPoints, block: TrueStations, cameras: tuple[SimulatedCamera, ...]
) -> Mask:
    """(n, k) True if the straight ray to a point (n) falls on the sensor of an image (k)."""
    images = len(block.image)
    seen = np.zeros((len(points.lat_rad), images), bool)
    for image in range(images):
        chord = unit(points.ecef_m - block.ecef_m[image])
        rays = _in_camera(block, np.full(len(chord), image), chord)
        seen[:, image] = cameras[block.camera[image]].sees(rays)
    return seen


def observe(
    air: TrueAir,
    block: TrueStations,
    points: GroundPoints,
    cameras: tuple[SimulatedCamera, ...],
    *,
    station: Integers,
    point: Integers,
) -> TrueObservations:
    """The observations of the (n,) pairs of ``station`` and ``point``.

    Each ray is traced through the air, refracted at the window and projected by the lens. The
    straight chord is only projected.
    """
    rays = shoot(air, block.ecef_m[station], points.ecef_m[point], UNDULATION_M)
    outside = _in_camera(block, station, rays.apparent)
    straight = _in_camera(block, station, rays.straight)
    inside, r_cc = through_window(outside, block.outside.n[station], block.cabin.n[station])
    measured = np.empty((2, len(station)))
    true = np.empty((2, len(station)))
    for index, camera in enumerate(cameras):
        rows = block.camera[station] == index
        measured[:, rows] = camera.project(inside[rows])
        true[:, rows] = camera.project(straight[rows])
    _, up_of_station = height_and_up(block.ecef_m)
    up = up_of_station[station]
    cosine = -np.sum(rays.apparent * up, axis=-1)
    sine = np.linalg.norm(np.cross(rays.apparent, up), axis=-1)
    return TrueObservations(
        station=station,
        point=point,
        x_px=measured[0],
        y_px=measured[1],
        x_true_px=true[0],
        y_true_px=true[1],
        zeta_c_rad=np.arctan2(sine, cosine),
        r_c_rad=rays.r_c_rad,
        r_cc_rad=r_cc,
        miss_m=rays.miss_m,
    )


def write_table(path: Path, columns: dict[str, object]) -> None:
    """Write a Parquet file with `CONVENTIONS` in its metadata."""
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
    cameras: tuple[SimulatedCamera, ...],
    noise_px: float,
    rng: np.random.Generator,
) -> None:
    """Write the observations, with noise [px], to ``out``, and the truth to out/truth."""
    truth = out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    measured, true = observation_columns(block, points, seen, noise_px, rng)
    write_table(out / "observations.parquet", measured)
    write_table(truth / "observations.parquet", true)
    write_table(truth / "stations.parquet", station_columns(block, cameras))
    write_table(truth / "profile.parquet", profile_columns(air))
    write_table(truth / "points.parquet", point_columns(points))


def profile_columns(air: TrueAir) -> dict[str, object]:
    """Columns of truth/profile.parquet: -100 m to 30 km, every 5 m up to 5 km, every 50 m above."""
    h_m = np.concatenate([np.arange(-100.0, 5000.0, 5.0), np.arange(5000.0, 30_001.0, 50.0)])
    return {
        "h_m": h_m,
        "temperature_k": temperature_k(h_m),
        "pressure_pa": air.pressure_pa(h_m),
        "vapour_pressure_pa": vapour_pressure_pa(h_m),
        "refractivity": air.n(h_m) - 1.0,
    }


def point_columns(points: GroundPoints) -> dict[str, object]:
    """Columns of truth/points.parquet: one row a point."""
    return {
        "point": list(points.name),
        "lat_deg": np.degrees(points.lat_rad),
        "lon_deg": np.degrees(points.lon_rad),
        "h_msl_m": points.h_msl_m,
        "h_ellipsoid_m": points.h_msl_m + UNDULATION_M,
    }


def station_columns(
    stations: TrueStations, cameras: tuple[SimulatedCamera, ...]
) -> dict[str, object]:
    """Columns of truth/stations.parquet: one row an image."""
    columns = {
        "image": list(stations.image),
        "camera": [cameras[row].name for row in stations.camera],
        "time_utc": pa.array(stations.time_ns, pa.timestamp("ns", tz="UTC")),
        "lat_deg": np.degrees(stations.lat_rad),
        "lon_deg": np.degrees(stations.lon_rad),
        "h_msl_m": stations.h_msl_m,
        "h_ellipsoid_m": stations.h_ellipsoid_m,
    }
    for column, name in enumerate(("q_w", "q_x", "q_y", "q_z")):
        columns[name] = stations.quaternion[:, column].copy()
    for prefix, air in (("", stations.outside), ("cabin_", stations.cabin)):
        for name in ("pressure_pa", "temperature_k", "vapour_pressure_pa"):
            columns[prefix + name] = getattr(air, name)
    columns["n_outside"] = stations.outside.n
    columns["n_cabin"] = stations.cabin.n
    return columns


def observation_columns(
    stations: TrueStations,
    points: GroundPoints,
    seen: TrueObservations,
    noise_px: float,
    rng: np.random.Generator,
) -> tuple[dict[str, object], dict[str, object]]:
    """Columns of observations.parquet, with noise, and of truth/observations.parquet.

    ``noise_px``: sigma of the noise in each coordinate [px].
    """
    names: dict[str, object] = {
        "image": [stations.image[row] for row in seen.station],
        "point": [points.name[row] for row in seen.point],
    }
    count = len(seen.station)
    quality = rng.integers(1, 6, count).astype(np.int32)
    x_error, y_error = noise_px * rng.standard_normal((2, count))
    h_g_m = points.h_msl_m[seen.point]
    measured = {
        **names,
        "x_px": seen.x_px + x_error,
        "y_px": seen.y_px + y_error,
        "h_g_m": h_g_m,
        "quality": quality,
    }
    true_values = {name: getattr(seen, name) for name in (*TRUE_PIXELS, *TRUE_ANGLES)}
    return measured, {**names, **true_values, "h_g_m": h_g_m}
