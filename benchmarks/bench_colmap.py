"""A database of COLMAP in, corrected and out, beside the same rows as Parquet."""

import sqlite3
import statistics
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from timing import Ratios

from unbend.batch.finished_run.export import export_run
from unbend.batch.runs import run_mission

IMAGES = 112
ROWS = 448_000
FEWER = 44_800
FEW = 1_008
CAMERA = (1, 14000, 10600, [20000.0, 20000.0, 7000.0, 5300.0])  # COLMAP's PINHOLE

MISSION = """
mission: {undulation_m: 50.0}
observations: {path: observations.parquet}
cameras:
  frame:
    width_px: 14000
    height_px: 10600
    f_px: 20000.0
    cx_px: 7000.0
    cy_px: 5300.0
    calibration: laboratory
stations:
  orientation:
    path: stations.csv
    angles: omega_phi_kappa
    frame: geographic
    heights: ellipsoid
    date: "2026-05-14"
    columns: {camera: camera}
    sigma_horizontal_m: 0.03
    sigma_height_m: 0.05
ground: {height: 300.0, reference: msl}
atmosphere: {adjust: false}
output: {path: results}
"""

_RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from bench_colmap import work
work(Path(sys.argv[2]))
# Not ru_maxrss: that starts at what the parent had when it made this process.
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(int(status["VmHWM"].split()[0]) * 1024)
"""


def write_mission(folder: Path, rows: int, kind: str) -> Path:
    """A mission of oriented images over level ground; its observations in a database or a table."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(3)
    each = rows // IMAGES
    names = [f"{i:05d}.tif" for i in range(IMAGES)]
    xy = rng.uniform(0.0, CAMERA[1:3], (IMAGES, each, 2)).astype("<f4")
    mission = yaml.safe_load(MISSION)
    mission["mission"]["name"] = kind
    if kind == "colmap":
        mission["cameras"]["frame"] = {"camera": 1, "calibration": "laboratory"}
        mission["observations"] = {"path": "database.db", "format": "colmap"}
        write_database(folder / "database.db", names, xy)
    else:
        points = []
        for name in names:
            points += [f"{name}:{i}" for i in range(each)]
        columns = {
            "image": np.repeat(names, each),
            "point": points,
            "x_px": xy[..., 0].ravel().astype(float),
            "y_px": xy[..., 1].ravel().astype(float),
        }
        pd.DataFrame(columns).to_parquet(folder / "observations.parquet")
    pd.DataFrame(
        {
            "image": names,
            "camera": "frame",
            "latitude": 47.0 + 0.002 * (np.arange(IMAGES) // 14),
            "longitude": 8.0 + 0.02 * (np.arange(IMAGES) % 14),
            "height": 6050.0,
            "omega": rng.normal(0.0, 1.0, IMAGES),
            "phi": rng.normal(0.0, 1.0, IMAGES),
            "kappa": 0.0,
        }
    ).to_csv(folder / "stations.csv", index=False)
    (folder / "mission.yaml").write_text(yaml.safe_dump(mission), "utf-8")
    return folder


def write_database(path: Path, names: list[str], xy: np.ndarray):
    """The tables of COLMAP's that are read; each keypoint matches one of the next image."""
    model, width, height, params = CAMERA
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE cameras (camera_id, model, width, height, params, prior_focal_length);"
            "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name, camera_id);"
            "CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows, cols, data);"
            "CREATE TABLE matches (pair_id INTEGER PRIMARY KEY, rows, cols, data);"
            "CREATE TABLE two_view_geometries"
            " (pair_id INTEGER PRIMARY KEY, rows, cols, data, config);"
        )
        each = np.arange(xy.shape[1], dtype="<u4")
        tied = np.stack([each, each[::-1]], axis=1).tobytes()
        row = (1, model, width, height, np.array(params, "<f8").tobytes(), 1)
        database.execute("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)", row)
        for number, (name, points) in enumerate(zip(names, xy, strict=True), start=1):
            database.execute("INSERT INTO images VALUES (?, ?, 1)", (number, name))
            row = (number, len(points), 2, points.tobytes())
            database.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", row)
            if number < len(names):
                row = (number * (2**31 - 1) + number + 1, each.size, 2, tied)
                database.execute("INSERT INTO matches VALUES (?, ?, ?, ?)", row)
                database.execute("INSERT INTO two_view_geometries VALUES (?, ?, ?, ?, 2)", row)
        database.commit()


def work(folder: Path) -> float:
    """Seconds of a run, and of the export of a database where the mission has one."""
    start = time.perf_counter()
    outcome = run_mission(folder / "mission.yaml", force=True)
    counted = outcome.manifest.results.observations
    assert counted.status["ok"] == counted.rows
    if (folder / "database.db").is_file():
        export_run(outcome.output, "colmap-database", folder / "out.db", {}, force=True)
    return time.perf_counter() - start


def test_half_a_million_keypoints_beside_a_table(ratios: Ratios, tmp_path: Path):
    """What a database costs beyond a thousand keypoints, beside what a table costs beyond them."""
    many, few, table, short = (
        write_mission(tmp_path / f"{kind}_{rows}", rows, kind)
        for kind in ("colmap", "parquet")
        for rows in (ROWS, FEW)
    )
    work(few)  # compiles
    rounds = [[work(folder) for folder in (many, few, table, short)] for _ in range(7)]
    ratio = statistics.median((a - b) / (c - d) for a, b, c, d in rounds)
    ratios.check("448,000 keypoints of a database, times a table", ratio, at_most=1.9)
    with closing(sqlite3.connect(many / "out.db")) as database:
        (count,) = database.execute("SELECT SUM(rows) FROM keypoints").fetchone()
        (tied,) = database.execute("SELECT SUM(rows) FROM two_view_geometries").fetchone()
    assert (count, tied) == (ROWS, ROWS * (IMAGES - 1) // IMAGES)


def test_memory_does_not_follow_the_keypoints(ratios: Ratios, tmp_path: Path):
    """100 MB more at most, from 45,000 to 448,000 keypoints."""
    peaks = []
    for rows in (FEWER, ROWS):
        folder = write_mission(tmp_path / str(rows), rows, "colmap")
        command = [sys.executable, "-c", _RUN, str(Path(__file__).parent), str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        peaks.append(int(done.stdout.splitlines()[-1]))
    grown = (peaks[1] - peaks[0]) / 1e6
    ratios.check("memory from 45,000 to 448,000 keypoints [MB]", grown, at_most=100.0)
