"""Writes a block of a given number of image points in a format; prints the peak of the memory [MB].

    python block_memory.py FORMAT ROWS FOLDER

Four images of each point, 400 points an image, parts of 50,000 rows.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun
from unbend.tables.pixels import COLMAP

CAMERA = Camera(14000, 10600, 20000.0, 20000.0, 7000.0, 5300.0, BrownConrady(k1=-0.01))
POINTS = 400
IMAGES = 4


def peak_mb() -> float:
    # Not ru_maxrss: that starts at what the parent had when it made this process.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def write(name: str, rows: int, folder: Path) -> None:
    n = rows // POINTS
    rng = np.random.default_rng(3)
    air = standard_atmosphere("us1976")
    down = np.tile(np.diag([1.0, -1.0, -1.0]), (n, 1, 1))
    images = np.array([f"{i:05d}.tif" for i in range(n)], object)
    stations = replace(
        empty_stations(images, np.full(n, "nadir", object), "ok"),
        lat_rad=np.full(n, 0.8),
        lon_rad=1e-5 * np.arange(n),
        h_ellipsoid_m=np.full(n, 3050.0),
        h_msl_m=np.full(n, 3000.0),
        quaternion=np.tile([0.0, 1.0, 0.0, 0.0], (n, 1)),
        sigma_horizontal_m=np.full(n, 0.03),
        sigma_height_m=np.full(n, 0.05),
    )
    outside = np.full(n, 2e-4)
    parts = []
    for first in range(0, rows, 50_000):
        row = np.arange(first, min(first + 50_000, rows))
        # A hundred points begin in every image, and go on in the next three.
        point = row // POINTS * (POINTS // IMAGES) + row % POINTS
        parts.append(folder / f"part-{first:09d}.parquet")
        x, y = rng.uniform(0.0, [[14000.0], [10600.0]], (2, row.size))
        pq.write_table(
            pa.table(
                {
                    "image": images[row // POINTS],
                    "point": [f"point-{p:07d}" for p in point],
                    "x_corrected_px": x,
                    "y_corrected_px": y,
                    "h_g_m": np.zeros(row.size),
                    "status": ["ok"] * row.size,
                }
            ),
            parts[-1],
        )
    run = FinishedRun(
        "block",
        stations,
        Exposures(np.full(n, True), down, stations.lat_rad, stations.h_msl_m, outside, outside),
        constant_series(TimedProfile(None, air), n),
        (rays_by(air, "spherical"),),
        "spherical",
        {"nadir": ExportCamera(CAMERA, False, 0.004)},
        lambda _: np.zeros(n),
        COLMAP,
        tuple(parts),
        {},
    )
    form = FORMATS[name]
    out = folder / f"out{form.ending}"
    if not form.ending:
        out.mkdir()
    before = peak_mb()
    assert form.write(run, form.values({}), out, Ledger()) > 0.9 * rows
    print(before, peak_mb())


if __name__ == "__main__":
    write(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
