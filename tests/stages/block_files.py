"""A mission without its log, and its stations and points as other programs would write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

A = 6378137.0
E2 = 0.00669437999014
CABIN = {"pressure_hpa": 812.0, "temperature_c": 21.0, "relative_humidity": 0.3}


def matrices(q) -> np.ndarray:
    """(n, 3, 3) of v_camera = R(q) v_enu by the formula, not by a library."""
    w, x, y, z = np.asarray(q).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def earth_centred(lat_deg, lon_deg, h) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) coordinates, and (n, 3, 3) from them to east, north, up, written out here."""
    p = np.radians(lat_deg)
    lon = np.radians(lon_deg)
    h = np.asarray(h)
    n = A / np.sqrt(1 - E2 * np.sin(p) ** 2)
    xyz = np.stack(
        [
            (n + h) * np.cos(p) * np.cos(lon),
            (n + h) * np.cos(p) * np.sin(lon),
            (n * (1 - E2) + h) * np.sin(p),
        ],
        -1,
    )
    zero = np.zeros_like(p)
    enu = np.stack(
        [
            np.stack([-np.sin(lon), np.cos(lon), zero], -1),
            np.stack([-np.sin(p) * np.cos(lon), -np.sin(p) * np.sin(lon), np.cos(p)], -1),
            np.stack([np.cos(p) * np.cos(lon), np.cos(p) * np.sin(lon), np.sin(p)], -1),
        ],
        -2,
    )
    return xyz, enu


def in_enu(stations: pd.DataFrame, points: pd.DataFrame, origin: tuple[float, float, float]):
    """Positions (n, 3), rotations (n, 3, 3) to the camera and points (p, 3), about one place."""
    place, axes = earth_centred(*(np.array([v]) for v in origin))
    xyz, enu = earth_centred(
        *(stations[c].to_numpy() for c in ("lat_deg", "lon_deg", "h_ellipsoid_m"))
    )
    turn = matrices(stations[["q_w", "q_x", "q_y", "q_z"]]) @ enu @ axes[0].T
    object_points, _ = earth_centred(
        *(points[c].to_numpy() for c in ("lat_deg", "lon_deg", "h_ellipsoid_m"))
    )
    return (xyz - place) @ axes[0].T, turn, (object_points - place) @ axes[0].T


def write_colmap(
    folder: Path,
    cameras: dict[str, tuple[str, int, int, list[float]]],
    stations: pd.DataFrame,
    observations: pd.DataFrame,
    points: pd.DataFrame,
    *,
    origin,
    text: bool = False,
    without_point: frozenset[int] = frozenset(),
) -> dict[str, int]:
    """A sparse model by pycolmap; the rows of ``without_point`` are keypoints of no point3D.

    Returns the numbers of the points by name.
    """
    import pycolmap

    block = pycolmap.Reconstruction()
    number = {name: k for k, name in enumerate(cameras, 1)}
    for name, (model, width, height, params) in cameras.items():
        camera = pycolmap.Camera(
            model=model, width=width, height=height, params=params, camera_id=number[name]
        )
        block.add_camera_with_trivial_rig(camera)
    centre, turn, xyz = in_enu(stations, points, origin)
    tracks: dict[str, list[pycolmap.TrackElement]] = {name: [] for name in points["point"]}
    for k, s in enumerate(stations.itertuples()):
        rows = observations[observations["image"] == s.image]
        image = pycolmap.Image(
            name=s.image,
            keypoints=rows[["x_px", "y_px"]].to_numpy(),
            camera_id=number[s.camera],
            image_id=k + 1,
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn[k]), -turn[k] @ centre[k])
        block.add_image_with_trivial_frame(image, pose)
        for i, (row, point) in enumerate(rows["point"].items()):
            if row not in without_point:
                tracks[point].append(pycolmap.TrackElement(k + 1, i))
    numbers = {}
    for name, place in zip(points["point"], xyz, strict=True):
        if tracks[name]:
            numbers[name] = block.add_point3D(place, pycolmap.Track(tracks[name]))
    folder.mkdir(parents=True, exist_ok=True)
    (block.write_text if text else block.write_binary)(str(folder))
    return numbers
