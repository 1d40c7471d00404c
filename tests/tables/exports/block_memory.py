"""Writes a block of a given number of image points in a format; prints the peak of the memory [MB].

    python -m tests.tables.exports.block_memory FORMAT ROWS FOLDER

Four images of each point, 400 points an image, parts of 50,000 rows.
"""

import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.tables.exports.export_runs import DOWN, finished_run, stations_at, write_export
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import ExportCamera

CAMERA = Camera(
    width_px=14000,
    height_px=10600,
    fx_px=20000.0,
    fy_px=20000.0,
    cx_px=7000.0,
    cy_px=5300.0,
    distortion=BrownConrady(k1=-0.01),
)
POINTS = 400
IMAGES = 4


def peak_mb():
    # Not ru_maxrss: that starts at what the parent had when it made this process.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def write(name, rows, folder):
    n = rows // POINTS
    rng = np.random.default_rng(3)
    images = np.array([f"{i:05d}.tif" for i in range(n)], object)
    turns = np.tile(DOWN, (n, 1, 1))
    stations = stations_at(
        images,
        "nadir",
        1e-3 * np.arange(n),
        46.0,
        3000.0,
        3050.0,
        turns,
        sigma_horizontal_m=np.full(n, 0.03),
        sigma_height_m=np.full(n, 0.05),
    )
    parts = []
    for first in range(0, rows, 50_000):
        row = np.arange(first, min(first + 50_000, rows))
        # A hundred points begin in every image, and go on in the next three.
        point = row // POINTS * (POINTS // IMAGES) + row % POINTS
        columns = {
            "image": images[row // POINTS],
            "point": [f"point-{p:07d}" for p in point],
            "x_corrected_px": rng.uniform(0.0, 14000.0, row.size),
            "y_corrected_px": rng.uniform(0.0, 10600.0, row.size),
            "h_g_m": np.zeros(row.size),
            "status": ["ok"] * row.size,
        }
        part = folder / f"part-{first:09d}.parquet"
        pq.write_table(pa.table(columns), part)
        parts.append(part)
    cameras = {"nadir": ExportCamera(CAMERA, False, 0.004)}
    run = finished_run(stations, turns, cameras, 0.0, parts=tuple(parts))
    before = peak_mb()
    assert write_export(run, name, folder).count > 0.9 * rows
    print(before, peak_mb())


if __name__ == "__main__":
    write(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
