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


def test_the_first_points_with_a_cold_cache(tmp_path):
    cold = statistics.median(seconds(FIRST_POINT, tmp_path / str(i)) for i in range(3))
    warm = statistics.median(seconds(FIRST_POINT, tmp_path / "0") for _ in range(3))
    print(f"first 1000 points: {cold:.2f} s with a cold cache, {warm:.2f} s with a warm one")
    assert cold < 5.0
