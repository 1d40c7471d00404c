"""Missions on a Dask cluster of this machine, whose workers and scheduler are killed."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed")

from tests.draws import SEED
from tests.helpers import refused
from unbend.batch import dask_executor
from unbend.batch.dask_executor import DaskExecutor
from unbend.batch.execute import run_many
from unbend.batch.executors import Outcome
from unbend.errors import UnbendError

MISSIONS = Path(__file__).with_name("missions.py")
sys.path.append(str(MISSIONS.parent))
import missions as missions_module  # noqa: E402
from missions import wait_until  # noqa: E402

LIMIT_S = 200.0
RUNS = int(os.environ.get("UNBEND_CLUSTER_KILLS", "1"))


class Machines:
    """A scheduler and its workers, which hear on this machine only and have no dashboard."""

    def __init__(self, folder):
        self.folder = folder
        self.file = folder / "scheduler.json"
        self.workers: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def start(self, program, *words):
        path = os.pathsep.join([str(MISSIONS.parent), *sys.path])
        options = ("--scheduler-file", str(self.file), "--host", "127.0.0.1", "--no-dashboard")
        settings = {"PYTHONPATH": path, "DASK_DISTRIBUTED__WORKER__HTTP__ROUTES": "[]"}
        with (self.folder / "output.txt").open("ab") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", program, *words, *options],
                stdout=output,
                stderr=output,
                env=os.environ | settings,
                cwd=self.folder,
            )

    def start_scheduler(self):
        self.file.unlink(missing_ok=True)
        self.scheduler = self.start("scheduler", "--port", "0")
        wait_until(lambda: self.file.exists() and self.file.read_text())

    def need_workers(self, count):
        while sum(worker.poll() is None for worker in self.workers) < count:
            self.start_worker()

    def start_worker(self):
        before = self.registered()
        self.workers.append(
            self.start(
                "worker",
                "--nthreads",
                "1",
                "--no-nanny",
            )
        )
        wait_until(lambda: self.registered() > before)  # which takes long on a busy machine

    def registered(self):
        """How many workers have said that the scheduler knows them."""
        return (self.folder / "output.txt").read_text().count("Registered to:")

    def stop(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()
        self.workers.clear()


@pytest.fixture(scope="module")
def machines(tmp_path_factory) -> Iterator[Machines]:
    of_tests = Machines(tmp_path_factory.mktemp("machines"))
    yield of_tests
    of_tests.stop()


def started(machines, folder, *names, pace=0.0):
    folder.mkdir(exist_ok=True)
    (folder / "pace").write_text(str(pace))
    for name in names:
        if not name.startswith("--"):
            (folder / f"{name}.yaml").touch()
    return subprocess.Popen(
        [sys.executable, "-W", "error", str(MISSIONS), str(machines.file), str(folder), *names],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ends_of(process):
    """How each mission ended."""
    return {name: word for name, word, _ in told_by(process)}


def told_by(process):
    """Name of each mission, how it ended and the text of that; nothing else may have been said."""
    out, err = process.communicate(timeout=LIMIT_S)
    assert err == ""
    assert process.returncode == 0
    return [json.loads(line) for line in out.splitlines()]


def beginnings(folder):
    """Name and process of each mission that began, in their order."""
    file = folder / "begun"
    if not file.exists():
        return []
    return [line.split(" ") for line in file.read_text().splitlines()]


def begun(folder):
    """The missions that began, in their order."""
    return [name for name, _ in beginnings(folder)]


def refusal(scheduler, mission=MISSIONS):
    """What is said before any work."""
    tasks = {missions_module.Unread(mission): missions_module.run_mission}
    with pytest.raises(UnbendError) as caught:
        list(DaskExecutor(scheduler).run(tasks))
    return str(caught.value)


def test_what_is_no_scheduler_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_CONNECT_S", 0.3)
    assert refusal("tcp://127.0.0.1:9").startswith("SCHEDULER-NONE: ")
    assert refusal("nothing://127.0.0.1").startswith("SCHEDULER-NONE: ")
    with refused("SCHEDULER-NONE"):
        dask_executor.refuse_missing("tcp://127.0.0.1:9")
    for content in (None, "{", "[]", '{"other": 1}'):
        file = tmp_path / "scheduler.json"
        if content is not None:
            file.write_text(content)
        assert refusal(str(file)).startswith("SCHEDULER-FILE: ")
        assert str(file) in refusal(str(file))


def test_without_the_library_it_is_asked_for(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    text = refusal("tcp://127.0.0.1:9")
    assert text.startswith("SCHEDULER-EXTRA: ")
    assert "pip install 'unbend[dask]'" in text


def test_workers_that_differ_are_refused_before_any_work(machines, tmp_path, monkeypatch):
    file = str(machines.file)
    assert not machines.workers, "this test comes before those with workers"
    with monkeypatch.context() as patch:
        patch.setattr(dask_executor, "_CONNECT_S", 0.3)
        assert refusal(file).startswith("SCHEDULER-WORKERS: ")
    machines.need_workers(1)
    text = refusal(file, tmp_path / "nowhere.yaml")
    assert text.startswith("WORKER-FILES: this worker does not find 1 mission file")
    assert "nowhere.yaml" in text
    versions = dask_executor.versions_here()
    changed = versions | {"numpy": "1.0", "more": "2"}
    monkeypatch.setattr(dask_executor, "versions_here", lambda: changed)
    text = refusal(file)
    assert text.startswith("WORKER-VERSION: ")
    assert f"more missing (here 2), numpy {versions['numpy']} (here 1.0)" in text
    assert "tcp://127.0.0.1" in text


@pytest.mark.parametrize("run", range(RUNS))
def test_workers_that_are_killed_cost_no_mission(machines, tmp_path, run):
    """Workers, and some with a mission, are killed at random times; others take their places."""
    draw = random.Random(SEED + run)
    machines.need_workers(2)
    names = ["deadly", "unlucky", "refused", *(f"m{i}" for i in range(12))]
    process = started(machines, tmp_path, *names, pace=0.2)
    kills = 6 if RUNS > 1 else 2
    for _ in range(kills):
        before = len(begun(tmp_path))

        def another_began(before=before):
            return len(begun(tmp_path)) > before or process.poll() is not None

        wait_until(another_began)
        time.sleep(draw.uniform(0.0, 0.3))
        alive = [worker for worker in machines.workers if worker.poll() is None]
        machines.start_worker()
        draw.choice(alive).kill()
    ends = ends_of(process)
    assert set(ends) == set(names)
    assert ends.pop("deadly") == "WORKER-LOST"
    assert ends.pop("refused") == "OBS-EMPTY"
    assert set(ends.values()) <= {"done", "repeated"}
    for name in ends:
        results = tmp_path / f"results of {name}"
        files = {path.name for path in results.iterdir()}
        assert files == {".lock", "stations.parquet", "manifest.json"}
        assert (results / "stations.parquet").read_bytes() == name.encode() * 1000


def test_a_worker_that_dies_while_it_is_checked_costs_no_mission(machines, tmp_path):
    """Also in the middle of a command: missions whose workers died are run again after a check."""
    machines.need_workers(2)
    (tmp_path / "pace").write_text("0")
    path = missions_module.KillsWhoLooks(tmp_path / "m0.yaml")
    path.touch()
    mission = missions_module.Unread(path)
    running = [worker for worker in machines.workers if worker.poll() is None]

    ((_, end),) = run_many(missions_module.run_mission, [mission], DaskExecutor(str(machines.file)))

    assert isinstance(end, Outcome), end
    assert sum(worker.poll() is None for worker in running) == len(running) - 1


def test_a_scheduler_that_is_killed_costs_no_finished_mission(machines, tmp_path):
    names = [f"m{i}" for i in range(6)]
    machines.need_workers(1)
    process = started(machines, tmp_path, *names, pace=0.3)
    wait_until(lambda: len(begun(tmp_path)) >= 4)
    machines.stop()
    out, err = process.communicate(timeout=LIMIT_S)
    assert "SCHEDULER-LOST" in err
    finished = {json.loads(line)[0] for line in out.splitlines()}
    assert finished
    before = begun(tmp_path)
    machines.start_scheduler()
    machines.need_workers(1)

    ends = ends_of(started(machines, tmp_path, *names))

    assert {name for name, word in ends.items() if word == "repeated"} >= finished
    again = begun(tmp_path)[len(before) :]
    assert finished.isdisjoint(again)


def test_a_signal_stops_what_the_workers_do(machines, tmp_path):
    machines.need_workers(1)
    process = started(machines, tmp_path, "a", "b", pace=600.0)
    wait_until(lambda: begun(tmp_path))
    began_s = time.monotonic()
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=LIMIT_S)
    assert process.returncode == 143
    assert time.monotonic() - began_s < 5.0
    ((mission, worker),) = beginnings(tmp_path)
    assert mission == "a"
    wait_until(lambda: missions_module.gone(int(worker)), 5.0)
    assert begun(tmp_path) == ["a"]


def test_a_worker_that_is_stopped_costs_no_mission(machines, tmp_path, monkeypatch):
    """SIGSTOP: the connection stays, and nothing comes. The other worker does what it had."""
    machines.stop()
    machines.start_scheduler()
    machines.need_workers(2)
    names = [f"m{i}" for i in range(4)]
    process = started(machines, tmp_path, *names, "--impatient", pace=1.0)
    wait_until(lambda: len(begun(tmp_path)) >= 2)
    frozen = machines.workers[0]
    frozen.send_signal(signal.SIGSTOP)
    (tmp_path / "frozen").touch()
    try:
        ends = ends_of(process)
        monkeypatch.setattr(dask_executor, "_CHECK_S", 3.0)
        text = refusal(str(machines.file))
    finally:
        frozen.kill()
    assert set(ends) == set(names)
    assert set(ends.values()) <= {"done", "repeated"}
    assert text.startswith("SCHEDULER-WORKERS: this worker has not answered for")


def test_the_only_worker_that_is_stopped_is_named(machines, tmp_path):
    machines.stop()
    machines.start_scheduler()
    machines.need_workers(1)
    process = started(machines, tmp_path, "m0", "m1", "--impatient", pace=600.0)
    wait_until(lambda: begun(tmp_path))
    machines.workers[0].send_signal(signal.SIGSTOP)
    (tmp_path / "frozen").touch()
    try:
        ends = told_by(process)
    finally:
        machines.stop()
    names, words, texts = zip(*ends, strict=True)
    assert set(names) == {"m0", "m1"}
    assert set(words) == {"WORKER-LOST"}
    assert any("tcp://127.0.0.1" in text and "has not answered" in text for text in texts)
