"""Logs grown to 110 MB: time and memory of their columns, beside the libraries."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import dataflash
import pytest
import ros2_mcap
import tlog

from unbend.ingest import open_log

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT.parent / "shared" / "logs"
SIZE = 110_000_000
SPARE = 128_000_000  # [bytes] beyond the columns

SCAN = """
import sys
import numpy as np
data = np.fromfile(sys.argv[1], np.uint8)
print(sum(np.flatnonzero(data == value).size for value in range(160, 176)))
"""


def real(name: str) -> Path:
    path = LOGS / name
    if not path.is_file():
        pytest.skip(f"{name} is not there: real logs live beside the repository")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def flash(folder: Path) -> Path:
    dataflash.grow(real("sitl_survey.BIN"), folder / "grown.bin", SIZE)
    return folder / "grown.bin"


@pytest.fixture(scope="module")
def telemetry(folder: Path) -> Path:
    tlog.grow(real("sitl_survey.tlog"), folder / "grown.tlog", SIZE)
    return folder / "grown.tlog"


@pytest.fixture(scope="module")
def bag(folder: Path) -> Path:
    ros2_mcap.grow(real("cubs2_cub_stabilize.mcap"), folder / "grown.mcap", SIZE)
    return folder / "grown.mcap"


def test_dataflash_needed_types(ratios, flash):
    assert dataflash.ours_needed(flash) == dataflash.library_needed(flash) > 500_000
    ratio = ratios.of_times(
        lambda: dataflash.ours_needed(flash),
        lambda: dataflash.library_needed(flash),
    )
    ratios.check("DataFlash, needed types, times as fast as pymavlink", ratio, at_least=10.0)


def test_dataflash_all_types(ratios, flash):
    """The library, at 4 MB/s, reads the log as it was; rates are compared."""
    source = real("sitl_survey.BIN")
    assert dataflash.ours_all(source) == dataflash.library_all(source) > 100_000
    ratio = ratios.of_times(
        lambda: dataflash.ours_all(flash),
        lambda: dataflash.library_all(source),
        counts=(flash.stat().st_size, source.stat().st_size),
    )
    ratios.check("DataFlash, all types, times as fast as pymavlink", ratio, at_least=24.0)


def test_tlog_with_every_checksum(ratios, telemetry):
    ratio = ratios.of_times(
        lambda: tlog.ours(telemetry),
        lambda: tlog.library(telemetry, tlog.LIBRARY_BYTES),
        counts=(telemetry.stat().st_size, tlog.library(telemetry, tlog.LIBRARY_BYTES)),
    )
    ratios.check("tlog, times as fast as pymavlink", ratio, at_least=15.0)


def test_mcap_of_ros_2(ratios, bag):
    source = real("cubs2_cub_stabilize.mcap")
    topics = [channel.name for channel in open_log(source).channels]
    ratio = ratios.of_times(
        lambda: ros2_mcap.ours(bag),
        lambda: ros2_mcap.library(source, topics),
        counts=(ros2_mcap.ours(bag), ros2_mcap.library(source, topics)),
    )
    ratios.check("ROS 2 in MCAP, times as fast as mcap_ros2", ratio, at_least=15.0)


@pytest.mark.parametrize("kind", ["flash", "telemetry", "bag"])
def test_memory_is_the_columns_and_a_little(kind: str, request: pytest.FixtureRequest):
    path: Path = request.getfixturevalue(kind)
    memory = ended_with("benchmarks/log_memory.py", "measure", sample_beside(path), path)
    print(f"{path.name}: {memory['more'] / 1e6:.0f} MB for {memory['columns'] / 1e6:.0f} MB")
    assert memory["more"] < memory["columns"] + SPARE


def sample_beside(log: Path) -> Path:
    """A small log of the same format."""
    return ROOT / "sample_logs" / f"flight{log.suffix}"


def ended_with(*arguments: object) -> dict[str, float]:
    """What a Python program prints of a log, whose imports do not count by a small log."""
    words = [str(argument) for argument in arguments]
    command = [sys.executable, *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return json.loads(ended.stdout)


@pytest.mark.parametrize(
    ("suffix", "grower", "name"),
    [
        (".bin", dataflash, "sitl_survey.BIN"),
        (".tlog", tlog, "sitl_survey.tlog"),
        (".mcap", ros2_mcap, "cubs2_cub_stabilize.mcap"),
    ],
)
def test_two_gigabytes_take_one_of_memory(folder: Path, suffix: str, grower: ModuleType, name: str):
    path = folder / f"two{suffix}"
    grower.grow(real(name), path, 2_000_000_000)
    memory = ended_with("benchmarks/log_memory.py", "watch", sample_beside(path), path)
    path.unlink()
    print(
        f"{path.name}: {memory['private'] / 1e6:.0f} MB of private memory for "
        f"{memory['columns'] / 1e6:.0f} MB of columns, {memory['seconds']:.0f} s"
    )
    assert memory["private"] < 1_000_000_000
    assert memory["private"] < memory["columns"] + SPARE


@pytest.mark.parametrize("kind", ["flash", "telemetry", "bag"])
def test_inspect_beside_scanning_the_file(ratios, kind: str, request: pytest.FixtureRequest):
    """`unbend inspect`, its start included, beside a numpy program that looks for each byte value
    of a short list in the same file."""
    path: Path = request.getfixturevalue(kind)
    ratio = 1.0 / ratios.of_times(
        lambda: new_process("-m", "unbend", "inspect", str(path)),
        lambda: new_process("-c", SCAN, str(path)),
        rounds=5,
    )
    ratios.check(
        f"inspect of {path.stat().st_size / 1e6:.0f} MB {path.suffix}, times a scan of "
        "16 byte values",
        ratio,
        at_most=6.0,
    )


def new_process(*arguments: str):
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False, env=environment)
