"""Missions side by side, in real processes that are killed, stopped and slow."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

# Each mission is named for what it does; every beginning is written down. No mission file is read,
# so the rooms that read them, a second and a half of each process, are not imported.
MISSIONS = """
import contextlib, json, os, signal, sys, time
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from types import ModuleType
from pipeline.errors import InputError

@dataclass(frozen=True)
class Unread:
    path: Path

    def load(self):
        raise InputError("INPUT-MISSING", "none is read", where=str(self.path))

plan = ModuleType("pipeline.batch.plan")
Outcome = plan.Outcome = make_dataclass("Outcome", ["name", "path"], namespace={
    "__module__": "__main__"})
sys.modules["pipeline.batch.plan"] = plan
from pipeline.batch.execute import Bug, run_many

def one(mission, *, progress=None):
    path = mission.path
    name, here = path.stem, path.parent
    with (here / "begun").open("a") as file:
        print(name, os.getpid(), file=file)
    if name.startswith("deadly") or (name.startswith("unlucky") and not (here / name).exists()):
        (here / name).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("buggy"):
        raise KeyError(name)
    if name.startswith("refused"):
        raise InputError("OBS-EMPTY", "nothing", where=str(path))
    time.sleep(float(os.environ.get("PACE", "0")))
    return Outcome(name, path)

if __name__ == "__main__":
    missions = [Unread(Path(sys.argv[2]) / f"{name}.yaml") for name in sys.argv[3:]]
    ends = run_many(one, missions, int(sys.argv[1]), lambda _: contextlib.nullcontext())
    for mission, end in ends:
        word = {Outcome: "done", Bug: "bug"}.get(type(end)) or end.code
        print(json.dumps([mission.path.stem, word]), flush=True)
"""


def ran(folder: Path, jobs: int, *names: str, pace: float = 0.0) -> tuple[dict[str, str], list]:
    """How each mission ended, and which began when and where."""
    script = folder / "missions.py"
    script.write_text(MISSIONS, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script), str(jobs), str(folder), *names],
        capture_output=True, text=True, timeout=300, env=os.environ | {"PACE": str(pace)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    ends = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(ends) == len(names), "every mission ends, and once"
    begun = [line.split() for line in (folder / "begun").read_text().splitlines()]
    return dict(ends), begun


def test_a_killed_worker_costs_one_mission_only(tmp_path):
    names = ["deadly", "a", "b", "unlucky", "buggy", "refused", "c"]
    ends, begun = ran(tmp_path, 2, *names)
    assert ends == {
        "deadly": "WORKER-LOST", "a": "done", "b": "done", "unlucky": "done", "buggy": "bug",
        "refused": "OBS-EMPTY", "c": "done",
    }  # fmt: skip
    times = [name for name, _ in begun]
    assert {name: times.count(name) for name in names} == {
        "deadly": 2, "unlucky": 2, "a": 1, "b": 1, "c": 1, "buggy": 1, "refused": 1,
    }  # fmt: skip
    # The second attempts come when nothing else is at work.
    assert sorted(times[-2:]) == ["deadly", "unlucky"]


def test_every_worker_may_die_at_once(tmp_path):
    ends, begun = ran(tmp_path, 3, "deadly", "unlucky", "unlucky2", "a")
    assert ends == {
        "deadly": "WORKER-LOST", "unlucky": "done", "unlucky2": "done", "a": "done",
    }  # fmt: skip
    assert len(begun) == 7


def test_workers_share_the_work_and_are_kept(tmp_path):
    ends, begun = ran(tmp_path, 2, *"abcdefgh", pace=0.2)
    assert set(ends.values()) == {"done"}
    assert len({process for _, process in begun}) == 2


# `unbend run`, with a step in which every worker waits to be hit; deaf ones do not hear SIGTERM.
STALLING = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a child of nohup has it ignored
from pipeline.stages import story as stages
real = stages.write_tables
def stalled(*args):
    real(*args)
    if os.environ["DEAF"] == "yes":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.write(1, b"stalled %d\\n" % os.getpid())
    time.sleep(600)
stages.write_tables = stalled
if __name__ == "__main__":
    from pipeline.cli import main
    main()
"""


def gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize(
    ("number", "code", "deaf"),
    [(signal.SIGTERM, 143, "no"), (signal.SIGINT, 130, "no"), (signal.SIGTERM, 143, "yes")],
    ids=["term", "int", "deaf"],
)
def test_a_signal_stops_all_and_begins_nothing(mission_factory, tmp_path, number, code, deaf):
    missions = [mission_factory(tmp_path / name) for name in "abcdef"]
    script = tmp_path / "stalling.py"
    script.write_text(STALLING, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, str(script), "run", *(str(m.save()) for m in missions), "--jobs", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"DEAF": deaf},
    )  # fmt: skip
    assert process.stdout is not None
    workers = [int(process.stdout.readline().split()[1]) for _ in range(2)]
    process.send_signal(number)
    out, err = process.communicate(timeout=300)  # the step itself takes 600 s
    assert process.returncode == code
    assert "stalled" not in out
    assert "Traceback" not in err, err
    assert all(gone(worker) for worker in workers)
    begun = [m for m in missions if m.output.exists()]
    assert begun == missions[:2]
    for one in begun:
        names = {p.name for p in one.output.iterdir()}
        # A worker that had to be killed could not clear up; what it left is hidden.
        assert names == ({".lock", ".staging"} if deaf == "yes" else {".lock"})
    assert begun[0].run().code == 0
    assert not (begun[0].output / ".staging").exists()
