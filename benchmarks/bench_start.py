"""How long the first answer takes, in new processes: importing, and compiling with a cold cache."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

FIRST_POINT = """
import numpy as np
from survey import CAMERA, air, exposures, points
from pipeline.refraction import correct_observations, ray_table
x, y, h_g = points(1000)
correct_observations(x, y, h_g, np.zeros(1000, int), exposures(1), CAMERA, ray_table(air()))
"""

FIRST_ANGLE = """
from pipeline.atmosphere import standard_atmosphere
from pipeline.refraction import refraction_angle
refraction_angle(standard_atmosphere("us1976"), 10000.0, 0.0, 0.785)
"""


def seconds(code: str, cache: Path) -> float:
    """Wall time of a new interpreter that runs some code, less that of one that runs none."""
    surroundings = dict(
        os.environ, NUMBA_CACHE_DIR=str(cache), PYTHONPATH=str(Path(__file__).parent)
    )
    times = []
    for text in ("pass", code):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", text], check=True, env=surroundings)
        times.append(time.perf_counter() - start)
    return times[1] - times[0]


def test_importing_the_package(tmp_path):
    measured = statistics.median(seconds("import pipeline", tmp_path) for _ in range(7))
    print(f"import pipeline: {measured:.3f} s")
    assert measured < 0.3


def cold_and_warm(code: str, tmp_path: Path) -> tuple[float, float]:
    """Median wall times with a cold cache and with a warm one."""
    cold = statistics.median(seconds(code, tmp_path / str(i)) for i in range(3))
    return cold, statistics.median(seconds(code, tmp_path / "0") for _ in range(3))


def test_the_first_angle_with_a_cold_cache(tmp_path):
    cold, warm = cold_and_warm(FIRST_ANGLE, tmp_path)
    print(f"first angle: {cold:.2f} s with a cold cache, {warm:.2f} s with a warm one")
    assert cold < 5.0


def test_the_first_points_with_a_cold_cache(tmp_path):
    cold, warm = cold_and_warm(FIRST_POINT, tmp_path)
    print(f"first 1000 points: {cold:.2f} s with a cold cache, {warm:.2f} s with a warm one")
    # More than an angle takes: the passes over an exposure are many functions.
    assert cold < 8.0
