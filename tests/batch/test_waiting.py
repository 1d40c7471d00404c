"""Nothing waits for ever: suspended processes, held locks, pipes in the place of results."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.batch.missions import wait_until
from tests.helpers import refused
from unbend.batch import other_processes, processes
from unbend.batch.campaigns import foreign_pages, head_of
from unbend.batch.execute import run_many
from unbend.batch.executors import Bug, Lost, Outcome
from unbend.batch.other_processes import holder_of, is_suspended
from unbend.batch.processes import MissionProcess, Processes, stop_all
from unbend.batch.store import open_folder, read_manifest, rehearse_folder
from unbend.batch.unchanged import find_unchanged
from unbend.batch.waiting import within
from unbend.config.campaign import MissionRef

linux = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(),
    reason="the system does not say which process is suspended",
)
pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no named pipes")


@pytest.fixture
def impatient(monkeypatch) -> None:
    """Looks often, and gives up after a tenth of a second."""
    monkeypatch.setattr(processes, "CHECK_S", 0.05)
    monkeypatch.setattr(processes, "CHECKS_UNTIL_KILLED", 2)


def suspend_once(mark: Path) -> Outcome:
    """A mission whose process is suspended when it runs for the first time."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGSTOP)
    return Outcome(mark.name, mark, None, 0, False)


def suspend_always() -> Outcome:
    os.kill(os.getpid(), signal.SIGSTOP)
    raise AssertionError


@linux
def test_a_suspended_process_costs_its_mission_one_attempt(tmp_path, impatient):
    """Others go on meanwhile; `run_many` runs it again, as any that is lost."""
    tasks: dict[Any, Any] = {
        "suspended": partial(suspend_once, tmp_path / "suspended"),
        "other": partial(suspend_once, tmp_path),  # which is there: it is not suspended
    }
    ends = dict(Processes(2).run(tasks))
    assert isinstance(ends["other"], Outcome)
    lost = ends["suspended"]
    assert isinstance(lost, Lost)
    assert lost.how == "stopped (SIGSTOP) for 0 s, so it was killed"


@linux
def test_a_process_that_goes_on_in_time_is_not_killed(impatient):
    process = MissionProcess(1)
    future = process.submit(partial(time.sleep, 0))  # type: ignore[arg-type]
    assert process.wait_for_end(future) is None
    assert process._process is not None
    number = process._process.pid
    assert number is not None
    for _ in range(3):
        os.kill(number, signal.SIGSTOP)
        wait_until(partial(is_suspended, number))
        process.kill_if_suspended()
        os.kill(number, signal.SIGCONT)
        process.kill_if_suspended()
    assert process.wait_for_end(process.submit(partial(time.sleep, 0))) is None  # type: ignore[arg-type]
    stop_all([process])


@linux
def test_a_worker_of_dask_does_not_wait_for_its_suspended_process(impatient):
    """It waits for a process by `MissionProcess.end` alone."""
    process = MissionProcess(1)
    end = process.wait_for_end(process.submit(suspend_always))
    stop_all([process])
    assert isinstance(end, Lost)
    assert not isinstance(end, Bug)
    assert "SIGSTOP" in end.how


def test_a_signal_without_a_name_is_told_by_its_number():
    assert processes.way_of_death(-999) == "killed by signal 999"


# ---- locks


@pytest.fixture
def holder(tmp_path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of a folder of results."""
    code = (
        "import sys, time; from pathlib import Path\n"
        "from unbend.batch.store import open_folder\n"
        "with open_folder(Path(sys.argv[1])): print('held', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


@linux
@pytest.mark.parametrize("is_holder_suspended", [False, True], ids=["running", "suspended"])
def test_a_lock_is_refused_at_once_and_names_who_holds_it(tmp_path, holder, is_holder_suspended):
    who = f"{holder.pid} "
    if is_holder_suspended:
        holder.send_signal(signal.SIGSTOP)
        wait_until(partial(is_suspended, holder.pid))
        who = f"process {holder.pid}, which is stopped,"
    for attempt in (partial(rehearse_folder, tmp_path), open_folder(tmp_path).__enter__):
        began_s = time.monotonic()
        with refused("OUTPUT-IN-USE") as refusal:
            attempt()
        assert time.monotonic() - began_s < 30.0
        assert who in refusal.value.what
        assert str(tmp_path / ".lock") in refusal.value.what


def test_where_no_holder_is_known_the_lock_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(other_processes, "LOCKS", tmp_path / "nothing")
    results = tmp_path / "results"
    with open_folder(results), refused("OUTPUT-IN-USE") as refusal:
        open_folder(results).__enter__()
    refusal.match("perhaps of another machine")
    assert holder_of(tmp_path / "not there") is None
    assert is_suspended(None) is False


# ---- pipes


@pipes
def test_a_pipe_among_results_is_not_read(tmp_path):
    for name in ("manifest.json", "campaign.html", "campaign.parquet"):
        os.mkfifo(tmp_path / name)
    with refused("MANIFEST-UNREADABLE") as refusal:
        read_manifest(tmp_path)
    refusal.match("it is not a file")
    assert read_manifest(tmp_path, ignore_damaged=True) is None
    assert head_of(tmp_path / "campaign.html") == ""
    assert foreign_pages(tmp_path) == ["campaign.html", "campaign.parquet"]
    assert find_unchanged(MissionRef.of(tmp_path / "manifest.json")) is None  # as a mission file


# ---- questions


def test_a_question_has_a_limit_and_its_errors_are_raised():
    blocked = threading.Event()
    with pytest.raises(TimeoutError, match="no answer within 0 s"):
        within(0.05, blocked.wait)
    blocked.set()
    assert within(None, blocked.wait) is True
    with pytest.raises(ZeroDivisionError):
        within(60.0, lambda: 1 // 0)  # type: ignore[arg-type]


def test_a_suspended_mission_that_is_suspended_again_is_refused_with_the_reason():
    class Suspending:
        def run(self, tasks: Any, *, alone: bool = False) -> Iterator[Any]:
            for mission in tasks:
                yield mission, Lost(processes.way_of_death(-9, was_suspended=True))

    ((_, end),) = run_many(print, [MissionRef(Path("m.yaml"))], Suspending())  # type: ignore[arg-type]
    assert str(end).count("stopped (SIGSTOP) for 60 s, so it was killed") == 2
