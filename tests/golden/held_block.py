"""A block of images with known truth as a mission without a log, and points from held poses.

The truth is the simulator's ray (an ODE) through the index of US 1976; orientations are exact
unless a test spoils them. The package only runs the mission.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy.interpolate import make_interp_spline

from unbend.atmosphere import standard_atmosphere
from unbend.simulate.flight import UNDULATION_M
from unbend.simulate.optics import (
    CAMERA_FROM_BODY,
    NED_FROM_ENU,
    body_rotation,
    enu_axes,
    height_and_up,
    quaternion,
    shoot,
    to_ecef,
    unit,
)

WIDTH = 14_000
HEIGHT = 10_600
FOCAL = 20_000.0
LENS = np.array([-0.02, 0.01, 1e-4, -1e-4, -0.002])  # OpenCV's k1, k2, p1, p2, k3
CX = 7012.4
CY = 5291.7
NADIR = {"nadir": (0.0, 0.0)}
FIVE = NADIR | {
    "left": (45.0, 0.0),
    "right": (-45.0, 0.0),
    "fore": (0.0, 45.0),
    "aft": (0.0, -45.0),
}
LATITUDE = 0.83
LONGITUDE = 0.15


class TrueIndex:
    """The index of US 1976 over the height above sea level, by a spline of degree 7."""

    def __init__(self) -> None:
        h = np.arange(-300.0, 12_000.0, 20.0)
        air = standard_atmosphere("us1976")
        self.spline = make_interp_spline(h, air.refractivity(h), k=7)

    def n(self, h_m):
        return 1.0 + self.spline(h_m)

    def dn_dh(self, h_m):
        return self.spline(h_m, 1)


@dataclass(eq=False)
class HeldBlock:
    """(s,) images and (p,) points, earth-centred; (r,) rows of what was measured."""

    image: np.ndarray
    camera: np.ndarray
    centre: np.ndarray
    camera_from_enu: np.ndarray
    point: np.ndarray
    place: np.ndarray
    rows: pd.DataFrame  # image, point (numbers), x_px, y_px, h_g_m

    def in_frame(self, ecef: np.ndarray) -> np.ndarray:
        """(n, 3) east, north, up [m] about the middle of the block at sea level."""
        origin = to_ecef(LATITUDE, LONGITUDE, np.array(0.0))
        return (ecef - origin) @ enu_axes(LATITUDE, LONGITUDE).T

    @property
    def camera_from_frame(self) -> np.ndarray:
        return self.camera_from_enu @ axes_at(self.centre) @ enu_axes(LATITUDE, LONGITUDE).T


def brown(x, y, k1, k2, p1, p2, k3):
    """Tangents as a lens draws them: OpenCV's formula, with its order of the coefficients."""
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return u, v


def distorted(tangents: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of tangents right and down."""
    u, v = brown(*tangents.T, *LENS)
    return np.stack([FOCAL * u + CX, FOCAL * v + CY], axis=1)


def axes_at(ecef: np.ndarray) -> np.ndarray:
    """(n, 3, 3) the axes east, north, up of earth-centred places."""
    up = height_and_up(ecef)[1]
    return enu_axes(np.arcsin(up[:, 2]), np.arctan2(up[:, 1], up[:, 0]))


def fly(
    above: float,
    heads: dict[str, tuple[float, float]],
    *,
    seed: int,
    wobble_deg: float = 0.7,
    each: int = 24,
    ground: float = 200.0,
    relief: float = 300.0,
) -> HeldBlock:
    """20 images of each head, which is mounted with a roll and a pitch [deg]; 300 points.

    These lie 0 to ``relief`` above ``ground``, which is above sea level. Lines fly east and west in
    turn; roll and pitch of the flight are uniform within ``wobble_deg``, so that the tilt of an
    image is up to 1 degree by default.
    """
    rng = np.random.default_rng(seed)
    line, shot = (grid.ravel() for grid in np.mgrid[0:4, 0:5])
    east = 0.212 * above * (shot - 2.0)
    north = 0.49 * above * (line - 1.5)
    heading = np.where(line % 2, -0.5, 0.5) * np.pi
    image = []
    camera = []
    centre = []
    rotation = []
    for name, mount in heads.items():
        mounted = body_rotation(*np.radians(mount), 0.0)
        for i in range(20):
            # One height away from what a head looks at that looks 45 degrees aside.
            axis = NED_FROM_ENU.T @ body_rotation(0.0, 0.0, heading[i]) @ mounted[:, 2]
            x = east[i] + above * axis[0] / axis[2] + rng.normal(0.0, 0.01 * above)
            y = north[i] + above * axis[1] / axis[2] + rng.normal(0.0, 0.01 * above)
            lat = LATITUDE + y / 6.37e6
            lon = LONGITUDE + x / (6.38e6 * np.cos(LATITUDE))
            h = ground + UNDULATION_M + above * (1.0 + rng.normal(0.0, 0.003))
            roll, pitch = np.radians(rng.uniform(-wobble_deg, wobble_deg, 2))
            body = body_rotation(roll, pitch, heading[i]) @ mounted
            image.append(f"{name}_{i:02d}")
            camera.append(name)
            centre.append(to_ecef(lat, lon, np.array(h)))
            rotation.append(CAMERA_FROM_BODY @ (NED_FROM_ENU.T @ body).T)
    reach = 0.5 * above
    x = rng.uniform(-reach, reach, 300)
    y = rng.uniform(-1.6 * reach, 1.6 * reach, 300)
    h_g = ground + rng.uniform(0.0, relief, 300)
    place = to_ecef(
        LATITUDE + y / 6.37e6, LONGITUDE + x / (6.38e6 * np.cos(LATITUDE)), h_g + UNDULATION_M
    )
    block = HeldBlock(
        np.array(image),
        np.array(camera),
        np.array(centre),
        np.array(rotation),
        np.array([f"p{i}" for i in range(300)]),
        place,
        pd.DataFrame(),
    )
    axes = axes_at(block.centre)
    chosen = []
    for k in range(len(image)):
        ray = (unit(place - block.centre[k]) @ axes[k].T) @ block.camera_from_enu[k].T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = distorted(ray[:, :2] / ray[:, 2:])
        inside = np.all((pixel > 80) & (pixel < [WIDTH - 80, HEIGHT - 80]), axis=1)
        inside &= (ray[:, 2] > 0.5) & (np.abs(ray[:, :2]) < 0.6 * ray[:, 2:]).all(axis=1)
        seen = rng.permutation(np.flatnonzero(inside))[:each]
        chosen += [(k, p) for p in seen]
    station, point = np.array(chosen).T
    rays = shoot(TrueIndex(), block.centre[station], place[point], UNDULATION_M)
    to_camera = block.camera_from_enu[station] @ axes[station]
    apparent = np.einsum("nij,nj->ni", to_camera, rays.apparent)
    pixel = distorted(apparent[:, :2] / apparent[:, 2:])
    columns = {"image": station, "point": point, "h_g_m": h_g[point]}
    block.rows = pd.DataFrame(columns).assign(x_px=pixel[:, 0], y_px=pixel[:, 1])
    several = block.rows.groupby("point")["point"].transform("size") > 1
    block.rows = block.rows[several].reset_index(drop=True)
    return block


def write_mission(block: HeldBlock, folder: Path, **sections: Any) -> Path:
    """The mission file, orientations and observations of a block, in US 1976."""
    folder.mkdir(parents=True, exist_ok=True)
    height, up = height_and_up(block.centre)
    quaternions = [quaternion(matrix) for matrix in block.camera_from_enu]
    stations = pd.DataFrame(quaternions, columns=["q_w", "q_x", "q_y", "q_z"])
    stations["image"] = block.image
    stations["camera"] = block.camera
    stations["latitude"] = np.degrees(np.arcsin(up[:, 2]))
    stations["longitude"] = np.degrees(np.arctan2(up[:, 1], up[:, 0]))
    stations["height"] = height
    stations.to_csv(folder / "block.csv", index=False)
    rows = block.rows.assign(
        image=block.image[block.rows["image"]], point=block.point[block.rows["point"]]
    )
    rows.to_parquet(folder / "observations.parquet")
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "f_px": FOCAL,
        "cx_px": CX,
        "cy_px": CY,
        "distortion": dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS.tolist(), strict=True)),
        "calibration": "laboratory",
    }
    config = yaml.safe_load("""
    mission: {name: block}
    observations: {path: observations.parquet}
    stations:
      orientation:
        path: block.csv
        angles: quaternion
        frame: geographic
        heights: ellipsoid
        columns: {camera: camera}
    ground: {height: {column: h_g_m}, reference: msl}
    atmosphere: {adjust: false}
    output: {path: results}
    """)
    config["mission"]["undulation_m"] = UNDULATION_M
    config["cameras"] = {name: dict(camera) for name in dict.fromkeys(block.camera.tolist())}
    config |= sections
    path = folder / "mission.yaml"
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return path


def intersected(block: HeldBlock, tangents: np.ndarray) -> np.ndarray:
    """(p, 3) errors east, north, up [m] of points from straight rays (r, 2), right and down.

    Least squares of the distances, weighted by what a pixel is worth there; poses are held.
    """
    centre = block.in_frame(block.centre)
    to_camera = block.camera_from_frame
    station = block.rows["image"].to_numpy()
    point = block.rows["point"].to_numpy()
    rays = np.column_stack([tangents, np.ones(len(tangents))])
    rays = np.einsum("rji,rj->ri", to_camera[station], rays)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    true = block.in_frame(block.place)
    square = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    square /= np.sum((true[point] - centre[station]) ** 2, axis=1)[:, None, None]
    normal = np.zeros((len(true), 3, 3))
    right = np.zeros((len(true), 3))
    np.add.at(normal, point, square)
    np.add.at(right, point, np.einsum("rij,rj->ri", square, centre[station]))
    seen = np.unique(point)
    return np.linalg.solve(normal[seen], right[seen][..., None])[..., 0] - true[seen]
