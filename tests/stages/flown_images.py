"""Tie points of a flight whose stations are known, seen by frame cameras without refraction.

A simulator's truth, not this package, says where each image was taken.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyproj
from scipy.spatial.transform import Rotation

from tests.small_block import ecef, enu_axes

FORMAT = np.array([6000, 4000])
FOCAL = 5000.0
CAMERA = {
    "width_px": 6000,
    "height_px": 4000,
    "f_px": FOCAL,
    "cx_px": 3000.0,
    "cy_px": 2000.0,
    "calibration": "laboratory",
}
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
GEODETIC = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)


def truth_of(table: Path, instance: int) -> pd.DataFrame:
    """The truth at each exposure of a camera; heights are above sea level, without undulation."""
    truth = pd.read_csv(table)
    rows = truth[(truth["row"] == "CAM") & (truth["I"] == instance)]
    return rows.sort_values("TimeUS").reset_index(drop=True)


def ground_points(
    pixels: np.ndarray, centre: np.ndarray, enu: np.ndarray, camera: np.ndarray, above_m: float
) -> np.ndarray:
    """(m, 3) where rays of pixels meet the plane below a camera; none of rays along it."""
    rays = np.column_stack([(pixels - FORMAT / 2) / FOCAL, np.ones(len(pixels))]) @ camera
    down = -rays @ enu[2]
    descends = down > 0.3 * np.linalg.norm(rays, axis=1)
    reach = above_m / down[descends]
    return centre + rays[descends] * reach[:, None]


def tie_points(
    truth: pd.DataFrame, names: list[str], ground_m: float, *, each: int = 6, seed: int = 1
) -> pd.DataFrame:
    """Observations of ground points in all images that show them; 0.5 px of noise.

    ``each`` points are drawn in each image that is not banked away from the ground.
    """
    rng = np.random.default_rng(seed)
    lat, lon, h = truth[["lat", "lng", "alt_amsl"]].to_numpy(float).T
    centres = ecef(lat, lon, h)
    axes = np.array([enu_axes(*place) for place in zip(lat, lon, strict=True)])
    body = Rotation.from_euler("ZYX", truth[["yaw", "pitch", "roll"]], degrees=True).as_matrix()
    ned_from_ecef = NED_FROM_ENU @ axes
    cameras = CAMERA_FROM_BODY @ body.transpose(0, 2, 1) @ ned_from_ecef
    points = []
    for centre, enu, camera, height in zip(centres, axes, cameras, h, strict=True):
        pixels = rng.uniform([0, 0], FORMAT, (each, 2))
        below = ground_points(pixels, centre, enu, camera, height - ground_m)
        x, y, _ = GEODETIC.transform(*below.T)
        points.append(ecef(y, x, ground_m))
    ground = np.concatenate(points)
    rows = []
    for name, centre, camera in zip(names, centres, cameras, strict=True):
        x, y, depth = camera @ (ground - centre).T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = FOCAL * np.stack([x, y], axis=1) / depth[:, None] + FORMAT / 2
        inside = (depth > 0) & (pixels > 0).all(axis=1) & (pixels < FORMAT).all(axis=1)
        for number in np.flatnonzero(inside):
            rows.append((name, f"p{number}", *pixels[number]))
    table = pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])
    table[["x_px", "y_px"]] += rng.normal(0.0, 0.5, (len(table), 2))
    return table
