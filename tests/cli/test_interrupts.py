"""Signals, kills and locks, with real processes: nothing half done can be seen."""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pytest

from tests.draws import SEED

# A child of nohup, or of a command in the background of a script, is born with Ctrl-C ignored.
HEARING = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"

# The stalled steps last 600 s: who waits for one of them is stopped here.
LIMIT_S = 300

# Stops in the middle of a named step, says so, and waits to be hit.
STALLING = """
import sys, time
from unbend.batch import runs
from unbend.stages import story
from unbend.batch import store
step, mode = sys.argv[1], sys.argv[2]
sys.argv = ["unbend", "run", sys.argv[3]]
def stall(real, after):
    def stalled(*args, **kwargs):
        result = real(*args, **kwargs) if after else None
        print("stalled", flush=True)
        time.sleep(600)
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
            time.sleep(600)
    store.Path.replace = slow
else:
    module = runs if hasattr(runs, step) else story
    setattr(module, step, stall(getattr(module, step), mode == "after"))
from unbend.cli import main
main()
"""


# Every batch is corrected for a second, on threads that the main one must wait for.
STREAMING = """
import sys, time
from unbend.stages import correction as correct
real = correct.correct_batch
def slow(*args):
    print("stalled", flush=True)
    time.sleep(1.0)
    return real(*args)
correct.correct_batch = slow
sys.argv = ["unbend", "run", sys.argv[1]]
from unbend.cli import main
main()
"""

# Hit where the main thread has just taken a lock that other threads need: the nth that it takes
# while batches are corrected, whoever asked for it.
HITTING = """
import signal, sys, threading
turn, number = map(int, sys.argv[1:3])
sys.argv = ["unbend", "run", sys.argv[3]]
taken, main_thread = [], threading.get_ident()
class Hit(threading.Condition):
    def __enter__(self):
        entered = super().__enter__()
        if threading.get_ident() == main_thread and began.is_set() and len(taken) < turn:
            taken.append(self)
            if len(taken) == turn:
                signal.raise_signal(number)
        return entered
began = threading.Event()
threading.Condition = Hit
from unbend.stages import correction as correct
real = correct.correct_batch
def seen(*args):
    began.set()
    return real(*args)
correct.correct_batch = seen
from unbend.cli import main
try:
    main()
finally:
    print("hit" if len(taken) == turn else "missed")
"""


RUN = """
import sys
from unbend.cli import main
sys.argv = ["unbend", "run", sys.argv[1]]
print("stalled", flush=True)
main()
"""

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
"""Exit code of a process that each signal ends."""

SIGNALS = int(os.environ.get("UNBEND_SIGNALS", "4"))
LONGEST_RUN_S = 6.0  # of the simulated mission on a machine that has nothing else to do


def visible(folder):
    """Hash of each result; of the manifest without the times of the inputs, which settle first."""
    hashes = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() or any(part.startswith(".") for part in name.split("/")):
            continue
        content = path.read_bytes()
        if name == "manifest.json":
            manifest = json.loads(content)
            for item in manifest["inputs"]:
                item.pop("mtime_ns")
            content = json.dumps(manifest).encode()
        hashes[name] = hashlib.sha256(content).hexdigest()
    return hashes


def finished_parts(folder):
    """How many parts an interrupted run left to be taken up; nothing else is there."""
    staging = folder / ".staging"
    assert {path.name for path in folder.iterdir()} == {".lock", ".staging"}
    parts = [path.name for path in (staging / "receipts").iterdir()]
    expected = {"key", "receipts", "observations"}
    for name in parts:
        expected |= {f"receipts/{name}", f"observations/{name}"}
    assert {path.relative_to(staging).as_posix() for path in staging.rglob("*")} == expected
    return len(parts)


def observe_often(mission, copies):
    """Let the mission have its measurements many times, a thousand rows in a batch."""
    mission.observe(pa.concat_tables([mission.measurements()] * copies))
    mission.config["output"]["batch_rows"] = 1000


def stalled(mission, step, mode="after"):
    """A run in a process of its own that waits in the middle of a step."""
    return started(STALLING, step, mode, mission.save())


def process_of(code, *words):
    """A process of Python that hears Ctrl-C."""
    return subprocess.Popen(
        [sys.executable, "-c", HEARING + code, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def started(code, *words):
    """A process that has said it waits to be hit."""
    process = process_of(code, *words)
    for line in process.stdout:
        if "stalled" in line:
            return process
    raise AssertionError(process.communicate()[1])


def ended(process):
    """The exit code of a process, and what it wrote."""
    try:
        out, err = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        raise AssertionError(f"it did not end, and had said: {process.communicate()}") from None
    return process.returncode, out + err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["term", "int"])
def test_a_signal_leaves_nothing_half_done(mission, baseline, number):
    process = stalled(mission, "write_tables")
    os.kill(process.pid, number)
    returned, text = ended(process)
    assert returned == CODES[number]
    assert "Traceback" not in text
    assert finished_parts(mission.output) == 1
    mission.run_to_manifest()
    assert visible(mission.output) == visible(baseline.output)


@pytest.mark.parametrize(
    "numbers",
    [
        (signal.SIGINT, signal.SIGTERM, signal.SIGTERM),
        (signal.SIGTERM, signal.SIGINT, signal.SIGINT),
    ],
    ids=["int-term", "term-int"],
)
def test_impatience_does_no_harm_to_a_stream(mission, numbers):
    observe_often(mission, 200)
    process = started(STREAMING, mission.save())
    for number in numbers:
        os.kill(process.pid, number)
        time.sleep(0.15)
    returned, text = ended(process)
    assert text.count("stalled") < 11, "the other batches were not given up"
    assert returned == CODES[numbers[0]]
    assert "Traceback" not in text
    assert "Exception ignored" not in text
    assert 1 <= finished_parts(mission.output) < 11


@pytest.mark.parametrize(
    ("turn", "number"),
    [
        (1, signal.SIGTERM),
        (2, signal.SIGINT),
        (3, signal.SIGTERM),
        (4, signal.SIGINT),
    ],
    ids=["1st", "2nd", "3rd", "4th"],
)
def test_a_signal_takes_no_lock_with_it(mission, turn, number):
    observe_often(mission, 50)
    returned, text = ended(process_of(HITTING, turn, int(number), mission.save()))
    assert text.split()[0] == "hit"
    assert returned == CODES[number], text
    assert "Traceback" not in text
    assert finished_parts(mission.output) >= 1


# Each batch takes ten minutes to be read, by the thread that hears signals.
READING = """
import sys, time
from unbend.tables.observations import Observations
real = Observations.batches
def slow(self, *parts):
    for batch in real(self, *parts):
        print("stalled", flush=True)
        time.sleep(600)
        yield batch
Observations.batches = slow
sys.argv = ["unbend", "run", sys.argv[1]]
from unbend.cli import main
main()
"""


def test_a_signal_does_not_wait_for_what_is_read(mission):
    observe_often(mission, 50)
    process = started(READING, mission.save())
    os.kill(process.pid, signal.SIGTERM)
    returned, text = ended(process)
    assert returned == 143, text
    assert [p.name for p in mission.output.iterdir()] == [".lock"]


TWO_AT_ONCE = """
import signal, sys
from unbend.cli import entry
both = [signal.SIGINT, signal.SIGTERM]
def pressed(words):
    signal.pthread_sigmask(signal.SIG_BLOCK, both)
    [signal.raise_signal(number) for number in both]
    signal.pthread_sigmask(signal.SIG_UNBLOCK, both)
    return 0
entry.run_command = pressed
entry.main()
"""


def test_two_signals_at_once_are_one():
    returned, text = ended(process_of(TWO_AT_ONCE))
    assert returned in (130, 143)  # of two that wait, which is served first is not ours
    assert "Traceback" not in text


AFTER_THE_END = """
import atexit, signal
from unbend.cli import entry
entry.run_command = lambda words: 0
atexit.register(signal.raise_signal, signal.SIGINT)
entry.main()
"""
BORN_DEAF = """
import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.argv = ["unbend", "--version"]
from unbend.cli import entry
entry.run_command = lambda words: signal.raise_signal(signal.SIGINT) or 0
entry.main()
"""


@pytest.mark.parametrize("code", [AFTER_THE_END, BORN_DEAF], ids=["after the end", "born deaf"])
def test_a_signal_that_changes_nothing(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr == ""


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


# A library that makes an error of its own of whatever is raised in it, as pydantic does.
WRAPPED = """
import signal, sys
from unbend.batch import runs
number = int(sys.argv[1])
def wrapped(*args, **kwargs):
    try:
        signal.raise_signal(number)
    except BaseException as error:
        raise ValueError("building failed: " + repr(error)) from None
runs.write_report = wrapped
sys.argv = ["unbend", "run", *sys.argv[2:]]
from unbend.cli import main
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_a_library_wraps_is_no_bug(mission, mission_factory, tmp_path, number):
    other = mission_factory(tmp_path / "other")
    returned, text = ended(process_of(WRAPPED, int(number), mission.save(), other.save()))
    assert returned == CODES[number], text
    assert "bug in unbend" not in text
    assert not (other.output / "manifest.json").exists()


# A destructor, in which Python ignores every exception.
IGNORED = """
import signal, sys, time
from unbend.batch import runs
number = int(sys.argv[1])
class Ignoring:
    def __del__(self):
        signal.raise_signal(number)
def write_report(*args, **kwargs):
    Ignoring()
    time.sleep(600)
runs.write_report = write_report
sys.argv = ["unbend", "run", sys.argv[2]]
from unbend.cli import main
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_whose_exception_is_ignored_is_sent_again(mission, number):
    returned, text = ended(process_of(IGNORED, int(number), mission.save()))
    assert returned == CODES[number], text
    assert "Traceback" not in text


@pytest.mark.parametrize("draw", range(SIGNALS))
def test_a_signal_at_any_time_leaves_what_a_rerun_completes(mission, baseline, draw):
    chance = random.Random(f"{SEED} {draw}")
    number = chance.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    process = started(RUN, mission.save())
    time.sleep(chance.uniform(0.0, LONGEST_RUN_S))
    process.send_signal(number)
    code, text = ended(process)
    assert code in {0, CODES[number]}, text
    assert "Traceback" not in text, text
    mission.run_to_manifest()
    assert visible(mission.output) == visible(baseline.output)


BUG = """
import sys; from unbend.batch import results
sys.argv = ["unbend", "verify", "x"]
results.verify_run = lambda path: 1 / 0
from unbend.cli import main; main()
"""


def test_a_bug_is_owned_up_to():
    returned, text = ended(process_of(BUG))
    assert returned == 1
    assert "ZeroDivisionError" in text
    last = text.rstrip().splitlines()[-1]
    assert last.startswith("this is a bug in unbend: please report the lines above ")


def test_a_reader_who_goes_away_is_no_bug(flown):
    process = subprocess.Popen(
        [sys.executable, "-m", "unbend", "inspect", str(flown.logs["mcap"]), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=LIMIT_S) == 130
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    assert "bug" not in err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_standard_output_is_no_bug():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "unbend", "-h"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 5
    assert done.stderr.startswith("STORAGE-WRITE: ")


@pytest.mark.parametrize("command", ["run", "inspect", "verify"])
def test_a_path_that_is_too_long_is_refused(command):
    words = [sys.executable, "-m", "unbend", command, "a" * 300 + ".bin"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("COMMAND-PATH: ")
