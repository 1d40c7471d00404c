"""Logs grown to 110 MB: their columns beside the libraries, and the memory that takes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import dataflash
import pytest
import ros2_mcap
import tlog

from pipeline.ingest import open_log

LOGS = Path(__file__).resolve().parents[1].parent / "shared" / "logs"
SIZE = 110_000_000
SPARE = 128_000_000  # [bytes] beyond the columns

PEAK = """
import json, sys
from pipeline.ingest import open_log
def status(key):
    lines = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return int(lines[key].split()[0]) * 1024
open_log(sys.argv[1])  # imports are not the log's memory
before = status("VmRSS")
log = open_log(sys.argv[2])
columns = sum(c.time_ns.nbytes + c.boot.nbytes + sum(x.nbytes for x in c.columns.values())
              for c in log.channels)
print(json.dumps({"more": status("VmHWM") - before, "columns": columns}))
"""

# All anonymous memory of the process, imports included, every 10 ms.
PRIVATE = """
import json, sys, threading, time
from pipeline.ingest import open_log
def private():
    lines = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return int(lines["RssAnon"].split()[0]) * 1024
def watch():
    while not over.wait(0.01):
        seen.append(private())
open_log(sys.argv[1])
over, seen = threading.Event(), [private()]
watcher = threading.Thread(target=watch)
watcher.start()
begin = time.perf_counter()
log = open_log(sys.argv[2])
seconds = time.perf_counter() - begin
over.set()
watcher.join()
columns = sum(c.time_ns.nbytes + c.boot.nbytes + sum(x.nbytes for x in c.columns.values())
              for c in log.channels)
print(json.dumps({"private": max(seen), "columns": columns, "seconds": seconds}))
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


def test_dataflash_needed_types(pair, flash):
    assert dataflash.ours_needed(flash) == dataflash.library_needed(flash) > 500_000
    ratio = pair(
        lambda: dataflash.ours_needed(flash),
        lambda: dataflash.library_needed(flash),
        flash.stat().st_size,
        flash.stat().st_size,
    )
    assert ratio >= 10.0


def test_dataflash_all_types(pair, flash):
    """The library, at 4 MB/s, reads the log as it was; rates are compared."""
    source = real("sitl_survey.BIN")
    assert dataflash.ours_all(source) == dataflash.library_all(source) > 100_000
    ratio = pair(
        lambda: dataflash.ours_all(flash),
        lambda: dataflash.library_all(source),
        flash.stat().st_size,
        source.stat().st_size,
    )
    assert ratio >= 24.0


def test_tlog_with_every_checksum(pair, telemetry):
    ratio = pair(
        lambda: tlog.ours(telemetry),
        lambda: tlog.library(telemetry, tlog.LIBRARY_BYTES),
        telemetry.stat().st_size,
        tlog.library(telemetry, tlog.LIBRARY_BYTES),
    )
    assert ratio >= 15.0


def test_mcap_of_ros_2(pair, bag):
    source = real("cubs2_cub_stabilize.mcap")
    topics = [channel.name for channel in open_log(source).channels]
    ratio = pair(
        lambda: ros2_mcap.ours(bag),
        lambda: ros2_mcap.library(source, topics),
        ros2_mcap.ours(bag),
        ros2_mcap.library(source, topics),
    )
    assert ratio >= 15.0


@pytest.mark.parametrize("kind", ["flash", "telemetry", "bag"])
def test_memory_is_the_columns_and_a_little(kind: str, request: pytest.FixtureRequest):
    path: Path = request.getfixturevalue(kind)
    sample = Path(__file__).resolve().parents[1] / "sample_logs" / f"flight{path.suffix}"
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(sample), str(path)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    print(f"{path.name}: {found['more'] / 1e6:.0f} MB for {found['columns'] / 1e6:.0f} MB")
    assert found["more"] < found["columns"] + SPARE


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
    sample = Path(__file__).resolve().parents[1] / "sample_logs" / f"flight{suffix}"
    done = subprocess.run(
        [sys.executable, "-c", PRIVATE, str(sample), str(path)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    path.unlink()
    found = json.loads(done.stdout)
    print(
        f"{path.name}: {found['private'] / 1e6:.0f} MB of private memory for "
        f"{found['columns'] / 1e6:.0f} MB of columns, {found['seconds']:.0f} s"
    )
    assert found["private"] < 1_000_000_000
    assert found["private"] < found["columns"] + SPARE


@pytest.mark.parametrize("kind", ["flash", "telemetry", "bag"])
def test_inspect_answers_at_once(kind: str, request: pytest.FixtureRequest):
    path: Path = request.getfixturevalue(kind)
    taken = sorted(seconds(["inspect", str(path)]) for _ in range(5))
    print(f"unbend inspect {path.name}, {path.stat().st_size / 1e6:.0f} MB: {taken[2]:.2f} s")
    assert taken[2] < 2.0


def seconds(words: list[str]) -> float:
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-m", "pipeline", *words], capture_output=True, check=False)
    return time.perf_counter() - begin
