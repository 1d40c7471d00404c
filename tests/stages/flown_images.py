"""Tie points of a flight whose stations are known, seen by frame cameras without refraction.

A simulator's truth, not this package, says where each image was taken.
"""

import numpy as np
import pandas as pd
import pyproj
from scipy.spatial.transform import Rotation

from tests.helpers import NED_FROM_ENU
from tests.small_block import ecef
from tests.stages.block_files import earth_centred

FORMAT = np.array([6000, 4000])
MIDDLE = FORMAT / 2
FOCAL = 5000.0
CAMERA = {
    "width_px": 6000,
    "height_px": 4000,
    "f_px": FOCAL,
    "cx_px": 3000.0,
    "cy_px": 2000.0,
    "calibration": "laboratory",
}
CAMERA_FROM_BODY = np.array(
    [
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
    ]
)
GEODETIC = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)


def truth_of(table, instance):
    """The truth at each exposure of a camera; heights are above sea level, without undulation."""
    rows = pd.read_csv(table).query("row == 'CAM' and I == @instance")
    return rows.sort_values("TimeUS").reset_index(drop=True)


def points_below(pixels, centre, down, camera, above_m):
    """(m, 3) where rays of pixels meet the plane below a camera; none of rays along it."""
    rays = np.pad((pixels - MIDDLE) / FOCAL, [(0, 0), (0, 1)], constant_values=1.0)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    descent = rays @ camera @ down
    is_steep = descent > 0.3
    reach = above_m / descent[is_steep]
    return centre + rays[is_steep] @ camera * reach[:, None]


def project(points, centre, camera):
    """(m, 2) pixels of points, and which of them are in the image."""
    in_camera = (points - centre) @ camera.T
    depth = in_camera[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = FOCAL * in_camera[:, :2] / depth + MIDDLE
    inside = (depth > 0) & (pixels > 0) & (pixels < FORMAT)
    return pixels, inside.all(axis=1)


def tie_points(
    truth,
    names,
    ground_m,
    *,
    each=6,
    seed=1,
):
    """Observations of ground points in all images that show them; 0.5 px of noise.

    ``each`` points are drawn in each image that is not banked away from the ground.
    """
    rng = np.random.default_rng(seed)
    lat, lon, h = truth[["lat", "lng", "alt_amsl"]].to_numpy(float).T
    centres, enu = earth_centred(lat, lon, h)
    angles = truth[["yaw", "pitch", "roll"]]
    ned_from_body = Rotation.from_euler("ZYX", angles, degrees=True)
    body_from_ned = ned_from_body.inv().as_matrix()
    cameras = CAMERA_FROM_BODY @ body_from_ned @ NED_FROM_ENU @ enu

    points = []
    for k, centre in enumerate(centres):
        pixels = rng.uniform([0, 0], FORMAT, (each, 2))
        down = -enu[k, 2]
        above_m = h[k] - ground_m
        below = points_below(
            pixels,
            centre,
            down,
            cameras[k],
            above_m,
        )
        lon, lat, _ = GEODETIC.transform(*below.T)
        points.append(ecef(lat, lon, ground_m))
    ground = np.concatenate(points)

    rows = []
    for name, centre, camera in zip(names, centres, cameras, strict=True):
        pixels, visible = project(ground, centre, camera)
        for number in np.flatnonzero(visible):
            rows.append((name, f"p{number}", *pixels[number]))
    table = pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])
    noise_px = rng.normal(0.0, 0.5, (len(table), 2))
    table[["x_px", "y_px"]] += noise_px
    return table
