"""Missions side by side, in real processes that are killed, stopped and slow."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from unbend.batch.processes import MissionProcess, stop_all

MISSIONS = str(Path(__file__).with_name("missions.py"))
sys.path.append(str(Path(MISSIONS).parent))
from missions import gone, wait_until  # noqa: E402


def ran(folder, jobs, *names, pace=0.0):
    """How each mission ended, and which began when and where."""
    ends, begun = ends_and_texts(folder, jobs, *names, pace=pace)
    return {name: word for name, word, _ in ends}, begun


def ends_and_texts(folder, jobs, *names, pace=0.0):
    """How each mission ended, in its order and with its text, and which began when and where."""
    (folder / "pace").write_text(str(pace))
    done = subprocess.run(
        [sys.executable, MISSIONS, str(jobs), str(folder), *names],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    ends = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(ends) == len(names), "every mission ends, and once"
    begun = [line.split() for line in (folder / "begun").read_text().splitlines()]
    return ends, begun


def test_a_killed_worker_costs_one_mission_only(tmp_path):
    names = ["deadly", "a", "b", "unlucky", "buggy", "refused", "elsewhere"]
    ends, begun = ends_and_texts(tmp_path, 2, *names)
    assert {name: word for name, word, _ in ends} == {
        "deadly": "WORKER-LOST",
        "a": "done",
        "b": "done",
        "unlucky": "done",
        "buggy": "bug",
        "refused": "OBS-EMPTY",
        "elsewhere": "RESULTS-ELSEWHERE",
    }
    (lost,) = (text for _, word, text in ends if word == "WORKER-LOST")
    assert lost.count("killed by SIGKILL") == 2
    assert f"unbend run {tmp_path / 'deadly.yaml'}" in lost
    order = [name for name, _ in begun]
    # Each began once, but for those whose worker died.
    assert sorted(order) == sorted([*names, "deadly", "unlucky"])
    # The second attempts come when nothing else is at work.
    assert sorted(order[-2:]) == ["deadly", "unlucky"]


def test_every_worker_may_die_at_once(tmp_path):
    ends, begun = ran(tmp_path, 3, "deadly", "unlucky", "unlucky2", "a")
    assert ends == {
        "deadly": "WORKER-LOST",
        "unlucky": "done",
        "unlucky2": "done",
        "a": "done",
    }
    assert len(begun) == 7


def test_workers_share_the_work_and_are_kept(tmp_path):
    ends, begun = ran(tmp_path, 2, *"abcdefgh", pace=0.2)
    assert set(ends.values()) == {"done"}
    assert len({process for _, process in begun}) == 2


def test_a_process_that_leaves_with_0_is_dead_too(tmp_path):
    ends, begun = ran(tmp_path, 2, "leaving", "a")
    assert ends == {"leaving": "WORKER-LOST", "a": "done"}
    assert [name for name, _ in begun].count("leaving") <= 3


def test_no_process_outlives_its_parent(tmp_path):
    (tmp_path / "pace").write_text("600")
    parent = subprocess.Popen([sys.executable, MISSIONS, "2", str(tmp_path), "a", "b"])
    begun = tmp_path / "begun"
    wait_until(lambda: begun.exists() and begun.read_text().count("\n") == 2)
    parent.kill()
    parent.wait()
    workers = [int(line.split()[1]) for line in begun.read_text().splitlines()]
    wait_until(lambda: all(map(gone, workers)), 5.0)


def test_the_threads_of_a_pool_end_with_its_process():
    before = set(threading.enumerate())
    processes = [MissionProcess(1) for _ in range(2)]
    for process in processes:
        process.submit(partial(time.sleep, 600))
    stop_all(processes)
    left = set(threading.enumerate()) - before
    assert not left


# `unbend run`, with a step in which every worker waits to be hit; deaf ones do not hear SIGTERM.
# Workers import this module because the function that runs a mission is one of its own.
STALLING = """
import os, signal, sys, time
from unbend.batch import runs
real, run_real = runs.write_tables, runs.run_mission
def stalled(*args):
    real(*args)
    if os.environ["DEAF"] == "yes":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.write(1, b"stalled %d\\n" % os.getpid())
    time.sleep(600)
def run_mission(*args, **named):
    runs.write_tables = stalled
    return run_real(*args, **named)
"""
RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a child of nohup has it ignored
sys.path.append(sys.argv.pop(1))
import stalling
from unbend.batch import campaigns
campaigns.run_chosen = stalling.run_mission
from unbend.cli import main
main()
"""


@pytest.mark.parametrize(
    ("number", "code", "deaf"),
    [(signal.SIGTERM, 143, "no"), (signal.SIGINT, 130, "no"), (signal.SIGTERM, 143, "yes")],
    ids=["term", "int", "deaf"],
)
def test_a_signal_stops_all_and_begins_nothing(mission_factory, tmp_path, number, code, deaf):
    missions = [mission_factory(tmp_path / name) for name in "abcdef"]
    (tmp_path / "stalling.py").write_text(STALLING, "utf-8")
    files = [str(mission.save()) for mission in missions]
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path), "run", "--jobs", "2", *files],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"DEAF": deaf},
    )
    # A worker's standard output is for its receipts alone.
    workers = [int(process.stderr.readline().split()[1]) for _ in range(2)]
    process.send_signal(number)
    out, err = process.communicate(timeout=300)  # the step itself takes 600 s
    assert process.returncode == code, err
    assert "stalled" not in out + err
    assert "Traceback" not in err, err
    assert all(gone(worker) for worker in workers)
    begun = [mission for mission in missions if mission.output.exists()]
    assert begun == missions[:2]
    for mission in begun:
        assert {path.name for path in mission.output.iterdir()} == {".lock", ".staging"}
        # A worker that had to be killed could not clear up; others leave their finished parts.
        tables = mission.output / ".staging" / "stations.parquet"
        assert tables.exists() is (deaf == "yes")
    assert begun[0].run().code == 0
    assert not (begun[0].output / ".staging").exists()
