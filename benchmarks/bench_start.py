"""How long the first answer takes in a new process: importing, and compiling with a cold cache."""

import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from timing import seconds

ROOT = Path(__file__).parents[1]
ENVIRONMENT = dict(os.environ)
# The first call writes the bytecode of the package, as for a user.
ENVIRONMENT.pop("PYTHONDONTWRITEBYTECODE", None)

FIRST_POINT = """
import numpy as np
from survey import CAMERA, air, exposures, points
from unbend.refraction import correct_observations, ray_table
x, y, h_g = points(1000)
correct_observations(x, y, h_g, np.zeros(1000, int), exposures(1),
                     camera=CAMERA, table=ray_table(air()))
"""

FIRST_ANGLE = """
from unbend.atmosphere import standard_atmosphere
from unbend.refraction import refraction_angle
refraction_angle(standard_atmosphere("us1976"), 10000.0, 0.0, 0.785)
"""

# A kernel of fixed size: what numba takes to compile it is the unit of the first answers.
REFERENCE = """
import math
import numba, numpy as np

def kernel(a, n):
    s, t = 0.0, 1.0
    for i in range(n):
        for j in range(a.size):
            x = a[j] * i
            if x > t:
                s += math.sqrt(x) * math.sin(t)
            elif x < -t:
                s -= math.exp(-abs(x)) * math.atan2(s, t)
            else:
                t += math.log1p(abs(x)) / (1.0 + s * s)
            while t > 3.0:
                t *= 0.5
        a[i % a.size] = s
    return s, t

numba.njit(error_model="numpy", nogil=True)(kernel)(np.linspace(-1.0, 1.0, 9), 3)
"""


def taken(code: str, cache: Path) -> float:
    """Wall time [s] of a new interpreter that runs some code, less that of one that runs none."""
    folders = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(filter(None, folders))
    environment = ENVIRONMENT | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": path}

    def run(text: str) -> float:
        command = [sys.executable, "-c", text]
        return seconds(lambda: subprocess.run(command, check=True, env=environment))

    return -run("pass") + run(code)


def test_importing_the_package(ratios, tmp_path):
    """`import unbend` offers its names lazily: half the time of numpy at most."""
    taken("import unbend, numpy", tmp_path)
    pairs = [(taken("import unbend", tmp_path), taken("import numpy", tmp_path)) for _ in range(7)]
    ratio = statistics.median(ours / numpy for ours, numpy in pairs)
    ratios.check("import unbend, times import numpy", ratio, at_most=0.5)


def cold_in_compilations(code: str, tmp_path: Path) -> float:
    """Time with a cold cache, in compilations of the reference kernel."""
    taken(code, tmp_path / "warm")
    return statistics.median(
        taken(code, tmp_path / str(i)) / taken(REFERENCE, tmp_path / "reference") for i in range(3)
    )


def test_the_first_angle_with_a_cold_cache(ratios, tmp_path):
    ratio = cold_in_compilations(FIRST_ANGLE, tmp_path)
    ratios.check("first angle, cold, times compiling a small kernel", ratio, at_most=2.5)
    ratio = statistics.median(
        taken(FIRST_ANGLE, tmp_path / "warm") / taken(REFERENCE, tmp_path / "reference")
        for _ in range(5)
    )
    ratios.check("first angle, warm, times compiling a small kernel", ratio, at_most=1.2)


def test_the_first_points_with_a_cold_cache(ratios, tmp_path):
    """Four kernels are compiled, once."""
    ratio = cold_in_compilations(FIRST_POINT, tmp_path)
    ratios.check("first 1000 points, cold, times compiling a small kernel", ratio, at_most=6.0)


def cpu_seconds(*words: str, cache: Path) -> float:
    """User and system time of a command of ours in a new process."""
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "unbend", *words],
        stdout=subprocess.DEVNULL,
        check=True,
        env=ENVIRONMENT | {"NUMBA_CACHE_DIR": str(cache)},
    )
    after = os.times()
    used = after.children_user + after.children_system
    return used - before.children_user - before.children_system


def test_the_first_mission_on_a_machine(ratios, tmp_path):
    """In CPU time, which another load changes least; against one with all kernels in the cache."""
    text = (ROOT / "configs/sample_bin.yaml").read_text().replace("../", f"{ROOT}/")
    mission = tmp_path / "mission.yaml"
    mission.write_text(text.replace(f"{ROOT}/results", str(tmp_path)))
    words = "run", "--force", "--quiet", str(mission)
    cpu_seconds("warm", cache=tmp_path / "warm")
    cpu_seconds(*words, cache=tmp_path / "warm")
    pairs = [
        (cpu_seconds(*words, cache=tmp_path / str(i)), cpu_seconds(*words, cache=tmp_path / "warm"))
        for i in range(3)
    ]
    ratio = statistics.median(cold / warm for cold, warm in pairs)
    ratios.check("first mission on a machine, times a further one", ratio, at_most=6.0)


def test_the_first_answer_of_the_command_line(ratios):
    """The help, and what a log of 1 MB holds, in times of importing numpy and pyarrow."""
    log = ROOT / "sample_logs" / "flight.bin"

    def command(*words: str) -> Callable[[], object]:
        return lambda: subprocess.run(
            [sys.executable, *words], check=True, env=ENVIRONMENT, stdout=subprocess.DEVNULL
        )

    imports = command("-c", "import numpy, pyarrow")
    for what, words, at_most in (
        ("unbend --help", ("--help",), 2.0),
        ("unbend inspect, 1 MB", ("inspect", str(log)), 4.0),
    ):
        ratio = 1.0 / ratios.of_times(command("-m", "unbend", *words), imports)
        ratios.check(f"{what}, times import numpy, pyarrow", ratio, at_most=at_most)
