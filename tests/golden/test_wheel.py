"""The wheel by itself: built, installed without extras far from the checkout, and run."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.logs import REPOSITORY

# As the user's shell has it, who may have a cache of pip: a test's own home is empty.
SHELL = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
PIP = ("-m", "pip", "--disable-pip-version-check", "--quiet")
# What pip says where it reaches no index; without one nothing can be installed.
UNREACHABLE = "Retrying (Retry("
LONGEST_S = 900.0


Ended = subprocess.CompletedProcess[str]


def ended(*words, place, **environment):
    return subprocess.run(
        [str(word) for word in words],
        cwd=place,
        env=SHELL | environment,
        capture_output=True,
        encoding="utf-8",
        timeout=LONGEST_S,
        check=False,
    )


def answer(*words, place, **environment):
    """What a command prints that must end well."""
    done = ended(*words, place=place, **environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling", reason="the build backend is not installed")
    folder = tmp_path_factory.mktemp("wheel")
    build = (*PIP, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder)
    answer(sys.executable, *build, REPOSITORY, place=folder)
    (file,) = folder.glob("unbend-*.whl")
    return file


@pytest.fixture(scope="module")
def clean_python(wheel, tmp_path_factory):
    """The Python of an environment with the wheel and what the program needs."""
    folder = tmp_path_factory.mktemp("clean")
    answer(sys.executable, "-m", "venv", "environment", place=folder)
    name = "Scripts/python.exe" if os.name == "nt" else "bin/python"
    python = folder / "environment" / name
    locked = REPOSITORY / ".locks" / "main.txt"
    install = (*PIP, "install", "--no-compile")
    needs = ("--retries", 1, "--require-hashes", "--requirement", locked)
    done = ended(python, *install, *needs, place=folder)
    if done.returncode != 0 and UNREACHABLE in done.stderr:
        pytest.skip("pip reaches no package index")
    assert done.returncode == 0, done.stderr
    answer(python, *install, "--no-deps", wheel, place=folder)
    return python


@pytest.mark.slow
def test_the_wheel_without_extras_corrects_the_sample_flight(clean_python, runs, tmp_path):
    for name in ("configs", "sample_logs"):
        shutil.copytree(REPOSITORY / name, tmp_path / name)
    package = answer(clean_python, "-c", "import unbend; print(unbend.__file__)", place=tmp_path)
    assert Path(package.strip()).is_relative_to(clean_python.parents[1])
    answer(clean_python, *PIP, "check", place=tmp_path)

    unbend = clean_python.with_name("unbend")
    cache = str(tmp_path / "cache")
    answer(
        unbend,
        "run",
        "configs/sample_bin.yaml",
        place=tmp_path,
        XDG_CACHE_HOME=cache,
    )
    answer(unbend, "verify", "results/sample_bin", place=tmp_path)
    results = tmp_path / "results" / "sample_bin"
    assert (results / "report.html").is_file()
    for file in ("observations/part-00000.parquet", "stations.parquet", "profile.parquet"):
        assert pq.read_table(results / file).equals(pq.read_table(runs["bin"].output / file)), file
