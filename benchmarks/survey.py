"""A survey of any size for the benchmarks: exposures, a camera, image points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from unbend.atmosphere import Profile, standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    StationSigmas,
    Uncertainty,
    uncertainty_of,
)

CAMERA = Camera(
    14_000, 10_600, 20_000.0, 20_000.0, 7012.4, 5291.7, BrownConrady(-0.018, 0.009, -0.002)
)
GROUND_M = 500.0
_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def air() -> Profile:
    """The default atmosphere with the default index."""
    return standard_atmosphere("us1976")


def exposures(count: int) -> Exposures:
    """Nadir images from 6 km, a few degrees off the vertical, behind a window."""
    rng = np.random.default_rng(1)
    height = 6000.0 + rng.normal(0.0, 5.0, count)
    angles = np.stack([rng.uniform(-180, 180, count), *rng.normal(0, 2, (2, count))], axis=1)
    outside = air().refractivity(height)
    return Exposures(
        np.ones(count, bool),
        Rotation.from_euler("zxy", angles, degrees=True).as_matrix() @ _DOWN,
        rng.uniform(0.80, 0.81, count),
        height,
        outside,
        outside + 7e-5,
    )


def uncertainty(of: Exposures) -> Uncertainty | None:
    """Of exposures in air that is known to half a kelvin, by stations to 0.05 degree and 2 m."""
    profile = air()
    count = of.usable.size
    size = profile.layers.edge.size
    known = np.concatenate([np.full(size, 0.5), [0.001], np.full(size, 1e-4)])
    stations = StationSigmas(
        np.full(count, 1e-3),
        np.full(count, 3e-3),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.full(count, 2.0),
    )
    return uncertainty_of(
        profile,
        ProfileCovariance(profile, 0.0, np.diag(known**2)),
        of,
        stations,
        [(CAMERA, np.ones(count, bool))],
        ground_heights_m=(-600.0, 10_000.0),
    )


def points(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels x and y and ground heights [m]."""
    rng = np.random.default_rng(2)
    x = rng.uniform(0.0, CAMERA.width_px, count)
    y = rng.uniform(0.0, CAMERA.height_px, count)
    return x, y, GROUND_M + rng.normal(0.0, 60.0, count)


def image_names(count: int) -> np.ndarray:
    """Names of the images."""
    return np.array([f"IMG_{i:05d}.tif" for i in range(count)], dtype=object)


def write_observations(path: Path, rows: int, images: int) -> None:
    """A table of observations, image by image, each point seen in some five images."""
    x, y, h_g = points(rows)
    rng = np.random.default_rng(3)
    point = rng.integers(0, rows // 5, rows).astype(np.int32)
    names = pa.array([f"P{i:07d}" for i in range(rows // 5)])
    image = np.repeat(np.arange(images, dtype=np.int32), rows // images)
    table = pa.table(
        {
            "image": pa.DictionaryArray.from_arrays(image, pa.array(image_names(images))),
            "point": pa.DictionaryArray.from_arrays(point, names).cast(pa.string()),
            "x_px": x,
            "y_px": y,
            "h_g_m": h_g,
        }
    )
    pq.write_table(table, path, compression="zstd", row_group_size=1_000_000)
