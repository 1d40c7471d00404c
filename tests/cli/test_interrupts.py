"""Signals, kills and locks, with real processes: nothing half done can be seen."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time

import pytest

# Stops in the middle of a named step, says so, and waits to be hit.
STALLING = """
import sys, time
from pipeline import stages
from pipeline.batch import store
step, mode = sys.argv[1], sys.argv[2]
sys.argv = ["unbend", "run", sys.argv[3]]
def stall(real, after):
    def stalled(*args, **kwargs):
        result = real(*args, **kwargs) if after else None
        print("stalled", flush=True)
        time.sleep(60)
        return result
    return stalled
if step == "commit":
    replace = store.Path.replace
    seen = []
    def slow(self, target):
        replace(self, target)
        seen.append(target)
        if len(seen) == 2:
            print("stalled", flush=True)
            time.sleep(60)
    store.Path.replace = slow
else:
    setattr(stages, step, stall(getattr(stages, step), mode == "after"))
from pipeline.cli import main
main()
"""


def visible(folder) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not any(part.startswith(".") for part in p.relative_to(folder).parts)
    }


def stalled(mission, step: str, mode: str = "after") -> subprocess.Popen[str]:
    """A run in a process of its own that waits in the middle of a step."""
    process = subprocess.Popen(
        [sys.executable, "-c", STALLING, step, mode, str(mission.save())],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        if "stalled" in line:
            return process
    raise AssertionError(process.communicate()[1])


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, err = process.communicate(timeout=20)
    return process.returncode, out + err


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)], ids=["term", "int"]
)
def test_a_signal_leaves_nothing_half_done(mission, baseline, number, code):
    process = stalled(mission, "write_tables")
    begin = time.monotonic()
    os.kill(process.pid, number)
    returned, text = ended(process)
    assert time.monotonic() - begin < 5.0
    assert returned == code
    assert "Traceback" not in text
    assert [p.name for p in mission.output.iterdir()] == [".lock"]
    assert mission.run().code == 0
    assert visible(mission.output) == visible(baseline.output)


def test_kill_and_rerun_give_what_an_untouched_run_gives(mission, baseline, unbend):
    for step in ("write_report", "commit"):
        process = stalled(mission, step)
        # Meanwhile nobody else may write here.
        other = mission.run()
        assert other.code == 4
        assert "OUTPUT-IN-USE" in other.err
        process.kill()
        ended(process)
        assert not (mission.output / "manifest.json").exists()
        assert unbend("verify", mission.output).code == 5
        whole = visible(baseline.output)
        for name, digest in visible(mission.output).items():
            assert whole[name] == digest, f"{name} is visible and incomplete"
    again = mission.run()
    assert again.code == 0, again.text
    assert visible(mission.output) == visible(baseline.output)
    assert {p.name for p in mission.output.iterdir()} >= {".lock", "manifest.json"}
    assert not (mission.output / ".staging").exists()


def test_a_bug_is_owned_up_to(mission):
    code = (
        "import sys; from pipeline import stages; sys.argv = ['unbend', 'verify', 'x']\n"
        "stages.verify_run = lambda path: 1 / 0\n"
        "from pipeline.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr
    assert done.stderr.rstrip().endswith("this is a bug in unbend: please report the lines above")


def test_a_reader_who_goes_away_is_no_bug(flown):
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline", "inspect", str(flown.logs["mcap"]), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=30) == 130
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    assert "bug" not in err
