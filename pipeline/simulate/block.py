"""The block of images with known truth: stations, ground points, and what every camera measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.simulate.camera import (
    NED_FROM_ENU,
    SimulatedCamera,
    body_rotation,
    quaternion,
    through_window,
)
from pipeline.simulate.flight import (
    UNDULATION_M,
    AirState,
    Flight,
    State,
    cabin_air,
    geographic,
    terrain_m,
)
from pipeline.simulate.rays import enu_axes, height_and_up, shoot, to_ecef, unit
from pipeline.simulate.sensors import unix_ns
from pipeline.simulate.true_air import TrueAir, relative_humidity, temperature_k, vapour_pressure_pa

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FEWEST_IMAGES = 2  # a point seen once measures nothing


@dataclass(frozen=True, eq=False)
class TrueStations:
    """Projection centres and attitudes (n,), camera by camera, with the air at each."""

    image: tuple[str, ...]
    camera: Indices
    time_ns: Indices
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

    station: Indices
    point: Indices
    x_px: Array
    y_px: Array
    x_true_px: Array
    y_true_px: Array
    zeta_c_rad: Array
    r_c_rad: Array
    r_cc_rad: Array
    miss_m: Array


def stations(flight: Flight, air: TrueAir, cameras: tuple[SimulatedCamera, ...]) -> TrueStations:
    """Where each camera was at each exposure: the reference point plus the lever arm."""
    truth = flight.at(flight.exposure_s)
    reference = to_ecef(truth.lat_rad, truth.lon_rad, truth.h_msl_m + UNDULATION_M)
    axes = enu_axes(truth.lat_rad, truth.lon_rad)
    enu_from_body = _enu_from_body(truth)
    ecef, rotations = [], []
    for camera in cameras:
        offset = enu_from_body @ np.array(camera.lever_arm_m)
        ecef.append(reference + np.einsum("nij,ni->nj", axes, offset))
        # The axes of the horizon turn by 1e-7 rad over a lever arm: attitude is the camera's own.
        rotations.append(camera.from_body() @ np.swapaxes(enu_from_body, 1, 2))
    positions, rotation = np.concatenate(ecef), np.concatenate(rotations)
    height, up = height_and_up(positions)
    msl = height - UNDULATION_M
    time_s = np.tile(flight.exposure_s, len(cameras))
    count = len(flight.exposure_s)
    outside = AirState(
        air.pressure_pa(msl),
        temperature_k(msl),
        vapour_pressure_pa(msl),
        relative_humidity(msl),
        air.n(msl),
    )
    return TrueStations(
        tuple(f"{c.name}_{i:05d}" for c in cameras for i in range(1, count + 1)),
        np.repeat(np.arange(len(cameras)), count),
        unix_ns(time_s),
        positions,
        np.arcsin(up[:, 2]),
        np.arctan2(up[:, 1], up[:, 0]),
        height,
        rotation,
        np.stack([quaternion(r) for r in rotation]),
        outside,
        cabin_air(air, msl, time_s),
    )


def _enu_from_body(state: State) -> Array:
    """Rotations (n, 3, 3) from body axes to east, north, up."""
    angles = zip(state.roll_rad, state.pitch_rad, state.yaw_rad, strict=True)
    return np.stack([NED_FROM_ENU.T @ body_rotation(r, p, y) for r, p, y in angles])


def _candidates(spacing_m: float, flight: Flight, rng: np.random.Generator) -> GroundPoints:
    """A jittered grid of points on the terrain around the lines, in random order."""
    path = flight.path(flight.exposure_s)
    reach = 3.0 * float(path[:, 2].max())
    low, high = path.min(axis=0) - reach, path.max(axis=0) + reach
    grid = np.meshgrid(np.arange(low[0], high[0], spacing_m), np.arange(low[1], high[1], spacing_m))
    place = np.stack([axis.ravel() for axis in grid], axis=-1)
    place += rng.uniform(-0.45, 0.45, place.shape) * spacing_m
    place = place[rng.permutation(len(place))]
    lat, lon = geographic(place[:, 0], place[:, 1])
    h_msl = np.round(terrain_m(place[:, 0], place[:, 1]), 3)
    return GroundPoints((), lat, lon, h_msl, to_ecef(lat, lon, h_msl + UNDULATION_M))


def _in_camera(stations_: TrueStations, station: Indices, direction: Array) -> Array:
    """Unit vectors (n, 3) along ECEF axes, in the axes of the cameras of those stations."""
    axes = enu_axes(stations_.lat_rad[station], stations_.lon_rad[station])
    rotation = stations_.camera_from_enu[station] @ axes
    return np.asarray(np.einsum("nij,nj->ni", rotation, direction))


def choose_points(
    flight: Flight,
    block: TrueStations,
    cameras: tuple[SimulatedCamera, ...],
    points_per_image: int,
    rng: np.random.Generator,
) -> tuple[GroundPoints, Indices, Indices]:
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
        chord = unit(pool.ecef_m - block.ecef_m[k])
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
        raise MissionError(
            "SIM-POINTS",
            f"no ground point is seen by {FEWEST_IMAGES} of the {count} images",
            remedy="fly more exposures a line, or lower the focal length",
        )
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
    cameras: tuple[SimulatedCamera, ...],
    station: Indices,
    point: Indices,
) -> TrueObservations:
    """Bend every ray, send it through the window and the lens; beside it the straight chord."""
    rays = shoot(air, block.ecef_m[station], points.ecef_m[point], UNDULATION_M)
    apparent = _in_camera(block, station, rays.apparent)
    straight = _in_camera(block, station, rays.straight)
    inside, r_cc = through_window(apparent, block.outside.n[station], block.cabin.n[station])
    measured, true = np.empty((2, len(station))), np.empty((2, len(station)))
    for index, camera in enumerate(cameras):
        mine = block.camera[station] == index
        measured[:, mine] = camera.project(inside[mine])
        true[:, mine] = camera.project(straight[mine])
    up = height_and_up(block.ecef_m)[1][station]
    down = -np.sum(rays.apparent * up, axis=-1)
    across = np.linalg.norm(np.cross(rays.apparent, up), axis=-1)
    return TrueObservations(
        station,
        point,
        measured[0],
        measured[1],
        true[0],
        true[1],
        np.arctan2(across, down),
        rays.r_c_rad,
        r_cc,
        rays.miss_m,
    )
