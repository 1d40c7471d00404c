"""Plant bugs one at a time in a copy of the repository and run the tests of their room.

    python tests/planted/run.py [ROOM ...] [--sample 10 --seed 1] [--jobs 2]
    python tests/planted/run.py [ROOM ...] --drawn 60 --seed 20261128

The second form plants bugs that are drawn blindly (`draw.py`), not those of the lists. A room is
the name of a file beside this one, without `.toml`. Each file begins with the tests of its room,
`tests = ["tests/refraction"]`, and has a table `[[bug]]` for every planted bug: `file`, `before`
(stands exactly once in the file), `after`, `what`, and optionally `first`, the test file that is
run before the others. The tests of each room run once without a bug: if they fail, nothing is
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
# Some times what the tests of the largest room take on a busy machine: beyond it they hang.
LIMIT_S = 3600.0
# Numba's cache compares only the file of the entry function with what it stored: bugs in these
# places need code that was compiled with them.
COMPILED = ("pipeline/unbend/refraction/", "pipeline/unbend/geodesy.py", "pipeline/unbend/units.py")
# pytest's exit codes: tests failed, collection interrupted, a conftest that cannot be imported.
FAILED = {1, 2, 4}
PASSED = {0, 5}  # 5: no test was left to run
OUTCOMES = {True: "noticed by ", False: "NOT NOTICED", None: "NOT RUN: "}


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

    def pytest(self, tests: tuple[str, ...], cache: Path) -> Ended:
        """Run tests until the first failure, or for `LIMIT_S` seconds."""
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
            text, _ = process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            return Ended(True, f"a hang, ended after {LIMIT_S:.0f} s", time.monotonic() - started)
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

    def try_bug(self, bug: Bug) -> Ended:
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
                ended = self.pytest(tests, cache)
                seconds += ended.seconds
                if ended.noticed is not False:
                    break
            return Ended(ended.noticed, ended.by, seconds)
        finally:
            path.write_bytes(text.encode("utf-8"))
            shutil.rmtree(self.parent / "numba-of-bug", ignore_errors=True)


def chosen(arguments: argparse.Namespace) -> list[Bug]:
    """The bugs that the command asks for: drawn, or of the lists in the order of the files."""
    if arguments.drawn:
        return drawn_bugs(arguments.drawn, arguments.seed, arguments.rooms)
    return listed_bugs(arguments)


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


def refuse_failing_tests(copy: Copy, bugs: list[Bug]) -> None:
    """End the program if the tests of a room fail without a bug.

    In a broken copy every bug would seem noticed.
    """
    tests_of_room: dict[str, set[str]] = defaultdict(set)
    for bug in bugs:
        tests_of_room[bug.room].update(bug.tests, bug.nearest)
        if bug.first:
            tests_of_room[bug.room].add(bug.first)
    for room, tests in sorted(tests_of_room.items()):
        ended = copy.pytest(tuple(sorted(tests)), copy.parent / "numba")
        if ended.noticed is not False:
            raise SystemExit(f"{room}: without a bug its tests do not pass: {ended.by}")
        print(f"{room}: without a bug its tests pass ({ended.seconds:.0f} s)", flush=True)


def print_table(results: list[tuple[Bug, Ended]], *, drawn: bool) -> bool:
    """Print how many bugs of each room and of all were noticed; return if no share is too small.

    A bug that could not be tried counts as not noticed.
    """
    rooms: dict[str, list[bool]] = defaultdict(list)
    for bug, ended in results:
        rooms[bug.room].append(ended.noticed is True)
    least_of_room = 0.0 if drawn else SHARE_OF_ROOM  # a room has few drawn bugs
    least_of_all = SHARE_OF_DRAWN if drawn else SHARE_OF_ALL
    rows = [(room, noticed, least_of_room) for room, noticed in sorted(rooms.items())]
    every = [noticed for of_room in rooms.values() for noticed in of_room]
    rows.append(("all", every, least_of_all))
    print(f"\n{'room':<16}{'planted':>8}{'noticed':>9}{'share':>8}")
    is_enough = True
    for name, noticed, least in rows:
        share = sum(noticed) / len(noticed)
        too_few = f"  under {least:.0%}" if share < least else ""
        print(f"{name:<16}{len(noticed):>8}{sum(noticed):>9}{share:>8.1%}{too_few}")
        is_enough &= share >= least
    return is_enough


def main():
    """Read the command line, plant the bugs, print a line for each and the table."""
    parser = argparse.ArgumentParser(description="Plant bugs and see whether tests notice them.")
    parser.add_argument(
        "rooms", nargs="*", help="files of tests/planted without .toml; all if none"
    )
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
    results = []
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        copies: queue.Queue[Copy] = queue.Queue()
        for number in range(arguments.jobs):
            parent = Path(folder) / str(number)
            parent.mkdir()
            copies.put(Copy(parent))
        if not arguments.no_baseline:
            any_copy = copies.get()
            refuse_failing_tests(any_copy, bugs)
            copies.put(any_copy)

        def try_in_a_copy(bug: Bug) -> Ended:
            copy = copies.get()
            try:
                return copy.try_bug(bug)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(arguments.jobs) as workers:
            for bug, ended in zip(bugs, workers.map(try_in_a_copy, bugs), strict=True):
                results.append((bug, ended))
                where = f"{bug.room} {bug.index}: {bug.file}: {bug.what}"
                print(
                    f"{where}: {OUTCOMES[ended.noticed]}{ended.by} ({ended.seconds:.0f} s)",
                    flush=True,
                )
    is_enough = print_table(results, drawn=bool(arguments.drawn))
    raise SystemExit(0 if is_enough else 1)


if __name__ == "__main__":
    main()
