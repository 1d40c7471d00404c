"""A block of images with known truth as a mission without a log, and points from held poses.

The truth is the simulator's ray (an ODE) through the index of US 1976; orientations are exact
unless a test spoils them. The package only runs the mission.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import yaml
from scipy.interpolate import make_interp_spline

from tests.lens import brown
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
METRES_NORTH = 6.37e6  # of a radian
METRES_EAST = 6.38e6 * np.cos(LATITUDE)
IMAGES = 20  # of each head: four lines of five
POINTS = 300
Array = np.ndarray


class TrueIndex:
    """The index of US 1976 over the height above sea level, by a spline of degree 7."""

    def __init__(self):
        h = np.arange(-300.0, 12_000.0, 20.0)
        air = standard_atmosphere("us1976")
        self.spline = make_interp_spline(
            h,
            air.refractivity(h),
            k=7,
        )

    def n(self, h_m):
        return 1.0 + self.spline(h_m)

    def dn_dh(self, h_m):
        return self.spline(h_m, 1)


@dataclass(eq=False)
class HeldBlock:
    """(s,) images and (p,) points, earth-centred; (r,) rows of what was measured."""

    image: Array
    camera: Array
    centre: Array
    camera_from_enu: Array
    point: Array
    place: Array
    rows: pd.DataFrame  # image, point (numbers), x_px, y_px, h_g_m

    def in_frame(self, ecef):
        """(n, 3) east, north, up [m] about the middle of the block at sea level."""
        origin = to_ecef(LATITUDE, LONGITUDE, np.array(0.0))
        return (ecef - origin) @ enu_axes(LATITUDE, LONGITUDE).T

    @property
    def camera_from_frame(self):
        return self.camera_from_enu @ axes_at(self.centre) @ enu_axes(LATITUDE, LONGITUDE).T


def distorted(tangents):
    """(n, 2) pixels of tangents right and down."""
    u, v = brown(*tangents.T, *LENS)
    return FOCAL * np.column_stack([u, v]) + [CX, CY]


def axes_at(ecef):
    """(n, 3, 3) the axes east, north, up of earth-centred places."""
    _, up = height_and_up(ecef)
    return enu_axes(*angles_of(up))


def angles_of(up):
    """Latitude and longitude [rad] of verticals."""
    x, y, z = up.T
    return np.arcsin(z), np.arctan2(y, x)


def fly(
    above,
    heads: dict[str, tuple[float, float]],
    *,
    seed,
    wobble_deg=0.7,
    each=24,
    ground=200.0,
    relief=300.0,
):
    """20 images of each head, which is mounted with a roll and a pitch [deg], over 300 points.

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
    centre = []
    rotation = []
    for name, mount in heads.items():
        mounted = body_rotation(*np.radians(mount), 0.0)
        for i in range(IMAGES):
            # One height away from what a head looks at that looks 45 degrees aside.
            level = body_rotation(0.0, 0.0, heading[i])
            axis = NED_FROM_ENU.T @ level @ mounted[:, 2]
            aside = above * axis[:2] / axis[2] + rng.normal(0.0, 0.01 * above, 2)
            x = east[i] + aside[0]
            y = north[i] + aside[1]
            h_msl = ground + above * (1.0 + rng.normal(0.0, 0.003))
            roll, pitch = np.radians(rng.uniform(-wobble_deg, wobble_deg, 2))
            body = body_rotation(roll, pitch, heading[i]) @ mounted
            image.append(f"{name}_{i:02d}")
            centre.append(ecef_of(x, y, h_msl))
            rotation.append(CAMERA_FROM_BODY @ (NED_FROM_ENU.T @ body).T)
    reach = 0.5 * above
    x = rng.uniform(-reach, reach, POINTS)
    y = rng.uniform(-1.6 * reach, 1.6 * reach, POINTS)
    h_g_m = ground + rng.uniform(0.0, relief, POINTS)
    block = HeldBlock(
        image=np.array(image),
        camera=np.repeat(list(heads), IMAGES),
        centre=np.array(centre),
        camera_from_enu=np.array(rotation),
        point=np.array([f"p{i}" for i in range(POINTS)]),
        place=ecef_of(x, y, h_g_m),
        rows=pd.DataFrame(),
    )
    station, point = pairs_in_view(block, each, rng)
    rows = measured(block, station, point).assign(h_g_m=h_g_m[point])
    is_tied = rows.duplicated("point", keep=False)
    block.rows = rows[is_tied].reset_index(drop=True)
    return block


def ecef_of(x, y, h_msl_m):
    """Earth-centred places x east and y north [m] of the middle of the block."""
    lat = LATITUDE + y / METRES_NORTH
    lon = LONGITUDE + x / METRES_EAST
    return to_ecef(lat, lon, np.asarray(h_msl_m + UNDULATION_M))


def pairs_in_view(block, each, rng):
    """Numbers of images and of points well inside them, at most so many of each image."""
    axes = axes_at(block.centre)
    pairs = []
    for k, centre in enumerate(block.centre):
        chord = unit(block.place - centre) @ axes[k].T
        ray = chord @ block.camera_from_enu[k].T
        with np.errstate(divide="ignore", invalid="ignore"):
            tangent = ray[:, :2] / ray[:, 2:]
        pixel = distorted(tangent)
        inside = (pixel > 80) & (pixel < [WIDTH - 80, HEIGHT - 80])
        narrow = np.abs(tangent) < 0.6
        ahead = ray[:, 2] > 0.5
        usable = ahead & np.all(inside & narrow, axis=1)
        seen = rng.permutation(np.flatnonzero(usable))[:each]
        pairs += [(k, p) for p in seen]
    station, point = np.array(pairs).T
    return station, point


def measured(block, station, point):
    """What these images see of these points, along bent rays."""
    centre = block.centre[station]
    rays = shoot(
        TrueIndex(),
        centre,
        block.place[point],
        UNDULATION_M,
    )
    to_camera = block.camera_from_enu[station] @ axes_at(centre)
    apparent = np.einsum("nij,nj->ni", to_camera, rays.apparent)
    pixel = distorted(apparent[:, :2] / apparent[:, 2:])
    rows = pd.DataFrame(pixel, columns=["x_px", "y_px"])
    return rows.assign(image=station, point=point)


def write_mission(block, folder, **sections):
    """The mission file, orientations and observations of a block, in US 1976."""
    folder.mkdir(parents=True, exist_ok=True)
    height, up = height_and_up(block.centre)
    quaternions = [quaternion(matrix) for matrix in block.camera_from_enu]
    stations = pd.DataFrame(quaternions, columns=["q_w", "q_x", "q_y", "q_z"])
    stations["image"] = block.image
    stations["camera"] = block.camera
    stations["latitude"], stations["longitude"] = np.degrees(angles_of(up))
    stations["height"] = height
    stations.to_csv(folder / "block.csv", index=False)

    rows = block.rows.copy()
    rows["image"] = block.image[rows["image"]]
    rows["point"] = block.point[rows["point"]]
    rows.to_parquet(folder / "observations.parquet")

    lens = dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS.tolist(), strict=True))
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "f_px": FOCAL,
        "cx_px": CX,
        "cy_px": CY,
        "distortion": lens,
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
    path.write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
    return path


def intersected(block, tangents):
    """(p, 3) errors east, north, up [m] of points from straight rays (r, 2), right and down.

    Least squares of the distances, weighted by what a pixel is worth there; poses are held.
    """
    centre = block.in_frame(block.centre)
    to_camera = block.camera_from_frame
    station = block.rows["image"].to_numpy()
    point = block.rows["point"].to_numpy()
    axes = np.ones(len(tangents))
    rays = np.column_stack([tangents, axes])
    rays = unit(np.einsum("rji,rj->ri", to_camera[station], rays))
    true = block.in_frame(block.place)
    distance = np.linalg.norm(true[point] - centre[station], axis=1)
    square = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    square /= distance[:, None, None] ** 2
    normal = np.zeros((len(true), 3, 3))
    right = np.zeros((len(true), 3))
    np.add.at(normal, point, square)
    np.add.at(right, point, np.einsum("rij,rj->ri", square, centre[station]))
    seen = np.unique(point)
    solved = np.linalg.solve(normal[seen], right[seen][..., None])
    return solved[..., 0] - true[seen]
