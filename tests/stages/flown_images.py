"""Tie points of a flight whose stations are known, seen by frame cameras without refraction.

A simulator's truth, not this package, says where each image was taken.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyproj
from scipy.spatial.transform import Rotation

WIDTH = 6000
HEIGHT = 4000
FOCAL = 5000.0
CAMERA = {
    "width_px": WIDTH,
    "height_px": HEIGHT,
    "f_px": FOCAL,
    "cx_px": WIDTH / 2,
    "cy_px": HEIGHT / 2,
    "calibration": "laboratory",
}
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
GEODETIC = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)


def truth_of(table: Path, instance: int) -> pd.DataFrame:
    """The truth at each exposure of a camera; heights are above sea level, without undulation."""
    truth = pd.read_csv(table)
    rows = truth[(truth["row"] == "CAM") & (truth["I"] == instance)]
    return rows.sort_values("TimeUS").reset_index(drop=True)


def tie_points(
    truth: pd.DataFrame, names: list[str], ground_m: float, *, each: int = 6, seed: int = 1
) -> pd.DataFrame:
    """Observations of ground points in all images that show them; 0.5 px of noise.

    ``each`` points are drawn in each image that is not banked away from the ground.
    """
    rng = np.random.default_rng(seed)
    lon, lat, h = (truth[c].to_numpy(float) for c in ("lng", "lat", "alt_amsl"))
    centre = np.stack(ECEF.transform(lon, lat, h), axis=1)
    east = np.stack([-np.sin(np.radians(lon)), np.cos(np.radians(lon)), 0.0 * lon], axis=1)
    up = np.stack(
        [
            np.cos(np.radians(lat)) * np.cos(np.radians(lon)),
            np.cos(np.radians(lat)) * np.sin(np.radians(lon)),
            np.sin(np.radians(lat)),
        ],
        axis=1,
    )
    enu = np.stack([east, np.cross(up, east), up], axis=1)
    body = Rotation.from_euler("ZYX", truth[["yaw", "pitch", "roll"]], degrees=True).as_matrix()
    camera = CAMERA_FROM_BODY @ np.swapaxes(body, 1, 2) @ NED_FROM_ENU @ enu  # from ECEF
    points = []
    for i in range(len(truth)):
        pixel = rng.uniform([0, 0], [WIDTH, HEIGHT], (each, 2))
        ray = np.column_stack([(pixel - [WIDTH / 2, HEIGHT / 2]) / FOCAL, np.ones(each)])
        ray = ray @ camera[i]
        down = -ray @ up[i]
        reach = (h[i] - ground_m) / np.where(down > 0.3 * np.linalg.norm(ray, axis=1), down, np.nan)
        point = centre[i] + ray * reach[:, None]
        point = point[np.isfinite(point).all(axis=1)]
        x, y, _ = GEODETIC.transform(*point.T)
        points.append(np.stack(ECEF.transform(x, y, np.full(x.shape, ground_m)), axis=1))
    ground = np.concatenate(points)
    rows = []
    for i, name in enumerate(names):
        seen = (ground - centre[i]) @ camera[i].T
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = (FOCAL * seen[:, k] / seen[:, 2] + c / 2 for k, c in ((0, WIDTH), (1, HEIGHT)))
        inside = (seen[:, 2] > 0) & (x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT)
        for j in np.flatnonzero(inside):
            rows.append((name, f"p{j}", x[j], y[j]))
    table = pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])
    table[["x_px", "y_px"]] += rng.normal(0.0, 0.5, (len(table), 2))
    return table
