"""The tables of a simulated mission: observations to be corrected, and the truth beside them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.errors import StorageError
from pipeline.simulate.block import GroundPoints, TrueObservations, TrueStations
from pipeline.simulate.camera import SimulatedCamera
from pipeline.simulate.flight import UNDULATION_M
from pipeline.simulate.true_air import TrueAir, temperature_k, vapour_pressure_pa

Array = NDArray[np.float64]

CONVENTIONS = {
    "pixels": "the centre of the upper left pixel is (0.5, 0.5)",
    "quaternion": "v_camera = R(q) v_enu, Hamilton, q_w >= 0; camera x right, y down, z forward",
    "r_c": "positive where the apparent ray is farther from the nadir than the straight one",
    "r_cc": "positive where the cabin moved the image point inward",
    "true_px": "projection of the straight chord, without window and air",
}


def write_table(path: Path, columns: dict[str, object]) -> int:
    """Write one Parquet file with the conventions in its metadata; returns the number of rows."""
    table = pa.table(columns)
    table = table.replace_schema_metadata({"unbend.conventions": json.dumps(CONVENTIONS)})
    try:
        pq.write_table(table, path, compression="zstd")
    except OSError as error:
        raise StorageError("DISK-WRITE", str(error), where=str(path)) from error
    return int(table.num_rows)


def station_columns(
    stations: TrueStations, cameras: tuple[SimulatedCamera, ...]
) -> dict[str, object]:
    """truth/stations.parquet: one row an image."""
    outside, cabin = stations.outside, stations.cabin
    q = stations.quaternion
    return {
        "image": list(stations.image),
        "camera": [cameras[k].name for k in stations.camera],
        "time_utc": pa.array(stations.time_ns, pa.timestamp("ns", tz="UTC")),
        "lat_deg": np.degrees(stations.lat_rad),
        "lon_deg": np.degrees(stations.lon_rad),
        "h_msl_m": stations.h_msl_m,
        "h_ellipsoid_m": stations.h_ellipsoid_m,
        **{name: q[:, i].copy() for i, name in enumerate(("q_w", "q_x", "q_y", "q_z"))},
        "pressure_pa": outside.pressure_pa,
        "temperature_k": outside.temperature_k,
        "vapour_pressure_pa": outside.vapour_pa,
        "cabin_pressure_pa": cabin.pressure_pa,
        "cabin_temperature_k": cabin.temperature_k,
        "cabin_vapour_pressure_pa": cabin.vapour_pa,
        "n_outside": outside.n,
        "n_cabin": cabin.n,
    }


def observation_columns(
    stations: TrueStations,
    points: GroundPoints,
    seen: TrueObservations,
    noise_px: float,
    rng: np.random.Generator,
) -> tuple[dict[str, object], dict[str, object]]:
    """observations.parquet, as a photogrammetrist has it, and truth/observations.parquet."""
    names = {
        "image": [stations.image[k] for k in seen.station],
        "point": [points.name[k] for k in seen.point],
    }
    quality = rng.integers(1, 6, len(seen.station))
    error = noise_px * rng.standard_normal((2, len(seen.station)))
    h_g = points.h_msl_m[seen.point]
    measured: dict[str, object] = {
        **names,
        "x_px": seen.x_px + error[0],
        "y_px": seen.y_px + error[1],
        "h_g_m": h_g,
        "quality": quality.astype(np.int32),
    }
    truth: dict[str, object] = {
        **names,
        "x_px": seen.x_px,
        "y_px": seen.y_px,
        "x_true_px": seen.x_true_px,
        "y_true_px": seen.y_true_px,
        "zeta_c_rad": seen.zeta_c_rad,
        "r_c_rad": seen.r_c_rad,
        "r_cc_rad": seen.r_cc_rad,
        "h_g_m": h_g,
    }
    return measured, truth


def profile_columns(air: TrueAir) -> dict[str, object]:
    """truth/profile.parquet: -100 m to 30 km, 5 m apart up to 5 km and 50 m above."""
    h = np.concatenate([np.arange(-100.0, 5000.0, 5.0), np.arange(5000.0, 30_001.0, 50.0)])
    return {
        "h_m": h,
        "temperature_k": temperature_k(h),
        "pressure_pa": air.pressure_pa(h),
        "vapour_pressure_pa": vapour_pressure_pa(h),
        "refractivity": air.n(h) - 1.0,
    }


def point_columns(points: GroundPoints) -> dict[str, object]:
    """truth/points.parquet: the ground points."""
    return {
        "point": list(points.name),
        "lat_deg": np.degrees(points.lat_rad),
        "lon_deg": np.degrees(points.lon_rad),
        "h_msl_m": points.h_msl_m,
        "h_ellipsoid_m": points.h_msl_m + UNDULATION_M,
    }
