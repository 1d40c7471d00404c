"""A survey of any size for the benchmarks: exposures, a camera, image points."""

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
    width_px=14_000,
    height_px=10_600,
    fx_px=20_000.0,
    fy_px=20_000.0,
    cx_px=7012.4,
    cy_px=5291.7,
    distortion=BrownConrady(-0.018, 0.009, -0.002),
)
GROUND_M = 500.0
_DOWN = np.diag([1.0, -1.0, -1.0])


def air() -> Profile:
    """The default atmosphere with the default index."""
    return standard_atmosphere("us1976")


def exposures(count: int) -> Exposures:
    """Nadir images from 6 km, a few degrees off the vertical, behind a window."""
    rng = np.random.default_rng(1)
    height = 6000.0 + rng.normal(0.0, 5.0, count)
    yaw = rng.uniform(-180, 180, count)
    tilts = rng.normal(0, 2, (2, count))
    angles = np.stack([yaw, *tilts], axis=1)
    turns = Rotation.from_euler("zxy", angles, degrees=True)
    outside = air().refractivity(height)
    return Exposures(
        usable=np.ones(count, bool),
        rotation=turns.as_matrix() @ _DOWN,
        latitude_rad=rng.uniform(0.80, 0.81, count),
        height_m=height,
        refractivity_outside=outside,
        refractivity_cabin=outside + 7e-5,
    )


def uncertainty(exposures: Exposures) -> Uncertainty | None:
    """Of exposures in air that is known to half a kelvin, by stations to 0.05 degree and 2 m."""
    profile = air()
    count = exposures.usable.size
    layers = profile.layers.edge.size
    temperature_k = np.full(layers, 0.5)
    vapour = np.full(layers, 1e-4)
    sigma = np.concatenate([temperature_k, [0.001], vapour])
    covariance = ProfileCovariance(profile, 0.0, np.diag(sigma**2))
    stations = StationSigmas(
        tilt_rad=np.full(count, 1e-3),
        yaw_rad=np.full(count, 3e-3),
        yaw_axis=np.tile([0.0, 0.0, 1.0], (count, 1)),
        height_m=np.full(count, 2.0),
    )
    return uncertainty_of(
        profile,
        covariance,
        exposures,
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


def write_observations(path: Path, rows: int, images: int):
    """A table of observations, image by image, each point seen in some five images."""
    x, y, h_g = points(rows)
    rng = np.random.default_rng(3)
    point = rng.integers(0, rows // 5, rows).astype(np.int32)
    point_names = pa.array([f"P{i:07d}" for i in range(rows // 5)])
    points_seen = pa.DictionaryArray.from_arrays(point, point_names)
    image = np.repeat(np.arange(images, dtype=np.int32), rows // images)
    columns = {
        "image": pa.DictionaryArray.from_arrays(image, pa.array(image_names(images))),
        "point": points_seen.cast(pa.string()),
        "x_px": x,
        "y_px": y,
        "h_g_m": h_g,
    }
    pq.write_table(
        pa.table(columns),
        path,
        compression="zstd",
        row_group_size=1_000_000,
    )
