"""Plant bugs one at a time in a copy of the repository and run the tests of their room.

    python tests/planted/run.py [ROOM ...] [--index 3,5-7] [--sample 10 --seed 1] [--jobs 2]
    python tests/planted/run.py [ROOM ...] --drawn 60 --seed 20261128

The second form plants bugs that are drawn blindly (`draw.py`), not those of the lists. A room is
the name of a file beside this one, without `.toml`. Each file begins with the tests of its room,
`tests = ["tests/refraction"]`, and has a table `[[bug]]` for every planted bug: `file`, `before`
(stands exactly once in the file), `after`, `what`, and optionally `first`, the test file that is
run before the others. The tests of a room run once without a bug first: if they fail, nothing is
planted. Exit code 1 if fewer than 95 % of the bugs, or 85 % in any room, are noticed; of drawn
bugs, if fewer than 85 %, because some change nothing that a test could see.
"""

import argparse
import contextlib
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.planted.draw import drawn_bugs
from tests.planted.planted_bug import Bug, read_bugs

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SHARE_OF_ALL = 0.95
SHARE_OF_ROOM = 0.85
SHARE_OF_DRAWN = 0.85
# Tests with a bug may take so much longer than without before they count as hanging.
PATIENCE = 4.0
SHORTEST_LIMIT_S = 300.0
# Numba's cache compares only the file of the entry function with what it stored: bugs in these
# places need code that was compiled with them.
COMPILED = ("pipeline/unbend/refraction/", "pipeline/unbend/geodesy.py", "pipeline/unbend/units.py")
# pytest's exit codes: tests failed, collection interrupted, a conftest that cannot be imported.
FAILED = {1, 2, 4}
PASSED = {0, 5}  # 5: no test was left to run


@dataclass(frozen=True)
class Ended:
    """How a run of pytest ended: noticed is None if it could not run at all."""

    noticed: bool | None
    by: str
    seconds: float


def runs_of(bug: Bug) -> list[tuple[str, ...]]:
    """Arguments of pytest, from the likeliest tests of a bug to the slowest of its room."""
    if bug.first:
        return [(bug.first,), bug.tests]
    if not bug.nearest:
        return [bug.tests]
    others = (*bug.tests, *(f"--ignore={name}" for name in bug.nearest))
    return [bug.nearest, (*others, "-m", "not slow"), (*others, "-m", "slow")]


class Copy:
    """A copy of the repository in a temporary folder, for one worker."""

    def __init__(self, parent: Path):
        self.parent = parent
        self.root = parent / "repository"
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT,
            check=True,
            capture_output=True,
        ).stdout.decode()
        for name in sorted(set(listed.split("\0")) - {""}):
            if (ROOT / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.root / name)
        if (ROOT.parent / "shared").is_dir():
            (parent / "shared").symlink_to(ROOT.parent / "shared", target_is_directory=True)

    def pytest(self, tests: tuple[str, ...], limit_s: float | None, cache: Path) -> Ended:
        """Run tests until the first failure, or for `limit_s` seconds."""
        scratch = self.parent / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        environment = dict(
            os.environ,
            PYTHONPATH=str(self.root / "pipeline"),
            PYTHONDONTWRITEBYTECODE="1",
            NUMBA_CACHE_DIR=str(cache),
            OPENBLAS_NUM_THREADS="1",
            TMPDIR=str(scratch),
        )
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        started = time.monotonic()
        process = subprocess.Popen(
            [*command, "--basetemp", str(scratch / "pytest"), *tests],
            cwd=self.root,
            env=environment,
            text=True,
            errors="replace",
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        try:
            text, _ = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            return Ended(True, f"a hang, ended after {limit_s:.0f} s", time.monotonic() - started)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # children of the tests too
            process.wait()
        seconds = time.monotonic() - started
        if process.returncode in PASSED:
            return Ended(False, "", seconds)
        if process.returncode in FAILED or process.returncode < 0:
            named = re.findall(r"^(?:FAILED|ERROR) (\S+?)(?:\[.*)?(?: - .*)?$", text, re.MULTILINE)
            last = text.strip().splitlines()[-1:]
            return Ended(True, named[0] if named else " ".join(last), seconds)
        return Ended(None, f"pytest ended with {process.returncode}:\n{text[-3000:]}", seconds)

    def try_bug(self, bug: Bug, limit_s: float) -> Ended:
        """Plant a bug, run the tests that it may concern, and take it out again."""
        path = self.root / bug.file
        text = path.read_bytes().decode("utf-8")
        if text.count(bug.before) != 1:
            return Ended(None, f"'before' stands {text.count(bug.before)} times in it", 0.0)
        fresh = bug.file.startswith(COMPILED)
        cache = self.parent / ("numba-of-bug" if fresh else "numba")
        path.write_bytes(text.replace(bug.before, bug.after).encode("utf-8"))
        try:
            seconds = 0.0
            for tests in runs_of(bug):
                ended = self.pytest(tests, limit_s, cache)
                seconds += ended.seconds
                if ended.noticed is not False:
                    break
            return Ended(ended.noticed, ended.by, seconds)
        finally:
            path.write_bytes(text.encode("utf-8"))
            shutil.rmtree(self.parent / "numba-of-bug", ignore_errors=True)


def numbers(text: str) -> set[int]:
    """`3,5-7` as the numbers that it means."""
    wanted: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        wanted.update(range(int(first), int(last or first) + 1))
    return wanted


def chosen(arguments: argparse.Namespace) -> list[Bug]:
    """The bugs that the command asks for: drawn, or of the lists in the order of the files."""
    if arguments.drawn:
        bugs = drawn_bugs(arguments.drawn, arguments.seed, arguments.rooms)
    else:
        bugs = listed_bugs(arguments)
    if arguments.index:
        bugs = [bug for bug in bugs if bug.index in numbers(arguments.index)]
    return bugs


def listed_bugs(arguments: argparse.Namespace) -> list[Bug]:
    """The bugs of the files, or a sample of them."""
    rooms = arguments.rooms or sorted(path.stem for path in HERE.glob("*.toml"))
    unknown = [room for room in rooms if not (HERE / f"{room}.toml").is_file()]
    if unknown:
        raise SystemExit(
            f"no planted bugs for {', '.join(unknown)}: tests/planted has no such file"
        )
    bugs = [bug for room in rooms for bug in read_bugs(HERE / f"{room}.toml")]
    if arguments.sample is not None and arguments.sample < len(bugs):
        kept = set(random.Random(arguments.seed).sample(range(len(bugs)), arguments.sample))
        bugs = [bug for number, bug in enumerate(bugs) if number in kept]
    return bugs


def run_baselines(
    bugs: list[Bug], copies: queue.Queue[Copy], workers: ThreadPoolExecutor
) -> dict[str, float]:
    """Run the tests of every room without a bug: room -> seconds. Ends the command on failure."""

    def baseline(room: str) -> tuple[str, Ended]:
        of_room = [bug for bug in bugs if bug.room == room]
        firsts = {bug.first for bug in of_room if bug.first}
        firsts.update(name for bug in of_room for name in bug.nearest)
        outside = sorted(first for first in firsts if not first.startswith(of_room[0].tests))
        copy = copies.get()
        try:
            return room, copy.pytest((*of_room[0].tests, *outside), None, copy.parent / "numba")
        finally:
            copies.put(copy)

    seconds = {}
    failed = False
    for room, ended in workers.map(baseline, dict.fromkeys(bug.room for bug in bugs)):
        seconds[room] = ended.seconds
        good = ended.noticed is False
        failed |= not good
        outcome = "pass" if good else f"FAIL: {ended.by}"
        print(f"{room}: without a bug its tests {outcome} ({ended.seconds:.0f} s)", flush=True)
    if failed:
        raise SystemExit("the tests must pass before a bug can be planted")
    return seconds


def print_table(results: list[tuple[Bug, Ended]], drawn: bool) -> bool:
    """Shares by room; whether they suffice."""
    least_of_room = 0.0 if drawn else SHARE_OF_ROOM  # of few drawn bugs a share says little
    least_of_all = SHARE_OF_DRAWN if drawn else SHARE_OF_ALL
    rooms: dict[str, list[bool]] = defaultdict(list)
    for bug, ended in results:
        rooms[bug.room].append(ended.noticed is True)
    print(f"\n{'room':<16}{'planted':>8}{'noticed':>9}{'share':>8}")
    sufficient = True
    for room, noticed in sorted(rooms.items()):
        share = sum(noticed) / len(noticed)
        sufficient &= share >= least_of_room
        few = "" if share >= least_of_room else f"  under {least_of_room:.0%}"
        print(f"{room:<16}{len(noticed):>8}{sum(noticed):>9}{share:>8.0%}{few}")
    every = [was for noticed in rooms.values() for was in noticed]
    share = sum(every) / len(every)
    few = "" if share >= least_of_all else f"  under {least_of_all:.0%}"
    print(f"{'all':<16}{len(every):>8}{sum(every):>9}{share:>8.1%}{few}")
    return sufficient and share >= least_of_all


def main():
    """Read the command line, plant the bugs, print a line for each and the table."""
    parser = argparse.ArgumentParser(description="Plant bugs and see whether tests notice them.")
    parser.add_argument(
        "rooms", nargs="*", help="files of tests/planted without .toml; all if none"
    )
    parser.add_argument("--index", help="bugs of the room by number, such as 3 or 1,4-6")
    parser.add_argument("--sample", type=int, help="try only so many of them")
    parser.add_argument("--drawn", type=int, help="draw so many blindly instead of the lists")
    parser.add_argument("--seed", type=int, default=0, help="of the sample or of the drawn bugs")
    parser.add_argument("--jobs", type=int, default=2, help="copies of the repository at work")
    parser.add_argument(
        "--no-baseline", action="store_true", help="do not run the tests without a bug first"
    )
    arguments = parser.parse_args()
    bugs = chosen(arguments)
    if not bugs:
        raise SystemExit("no planted bug has been chosen")
    jobs = max(1, min(arguments.jobs, len(bugs)))
    results: dict[int, Ended] = {}
    printing = threading.Lock()
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        copies: queue.Queue[Copy] = queue.Queue()
        for number in range(jobs):
            parent = Path(folder) / str(number)
            parent.mkdir()
            copies.put(Copy(parent))
        with ThreadPoolExecutor(jobs) as workers:
            seconds = {} if arguments.no_baseline else run_baselines(bugs, copies, workers)

            def work(number: int):
                bug = bugs[number]
                limit = max(SHORTEST_LIMIT_S, PATIENCE * seconds.get(bug.room, 900.0))
                copy = copies.get()
                try:
                    ended = results[number] = copy.try_bug(bug, limit)
                finally:
                    copies.put(copy)
                outcome = {
                    True: f"noticed by {ended.by}",
                    False: "NOT NOTICED",
                    None: f"NOT RUN: {ended.by}",
                }[ended.noticed]
                with printing:
                    print(
                        f"{bug.room} {bug.index}: {bug.file}: {bug.what}: {outcome}"
                        f" ({ended.seconds:.0f} s)",
                        flush=True,
                    )

            list(workers.map(work, range(len(bugs))))
    ended_bugs = [(bugs[number], results[number]) for number in sorted(results)]
    sufficient = print_table(ended_bugs, drawn=arguments.drawn is not None)
    raise SystemExit(0 if sufficient else 1)


if __name__ == "__main__":
    main()
