"""Processes that run missions side by side, each for itself: the death of one costs one mission."""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from pipeline.batch.manifest import Outcome
from pipeline.errors import EXIT_INTERRUPTED, UnbendError

# How long a worker that was told to stop may clean up before it is killed.
_GRACE_S = 3.0


class RunOne(Protocol):
    """Runs one mission file."""

    def __call__(self, path: Path, *, progress: Any = None) -> Outcome: ...


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an error of ours."""

    traceback: str


End = Outcome | UnbendError | Bug


def attempt(one: RunOne, config: Path, progress: Any) -> End:
    """Run a mission, whatever comes of it."""
    try:
        return one(config, progress=progress)
    except UnbendError as error:
        return error
    except Exception:
        # The one broad net: an error of ours in one mission must not cost the user the others.
        return Bug(traceback.format_exc())


@dataclass(eq=False)
class _Worker:
    """A process that has one mission at a time, and the line to it."""

    process: SpawnProcess
    line: Connection
    config: Path | None = None

    def give(self, config: Path) -> None:
        self.config = config
        with suppress(OSError):  # that it died is noticed where its answer is due
            self.line.send(config)

    def answer(self) -> End | None:
        """How its mission ended; None if the process ended first."""
        try:
            end: End = self.line.recv()
        except (EOFError, OSError):
            return None
        return end


def side_by_side(
    one: RunOne, configs: Sequence[Path], jobs: int, lost: list[Path]
) -> Iterator[tuple[Path, End]]:
    """Run missions in ``jobs`` processes; yields how each ended, as soon as it did.

    No mission is handed out before a worker is free for it. Those whose worker died are added to
    ``lost``; the others never notice. When this is left early, the workers stop.
    """
    waiting = iter(configs)
    crew: dict[Connection, _Worker] = {}
    leaving: list[_Worker] = []
    try:
        for config in islice(waiting, jobs):
            _hire(one, crew).give(config)
        while crew:
            ready = wait(list(crew))
            for worker in [crew[line] for line in crew if line in ready]:
                done, end = worker.config, worker.answer()
                following = next(waiting, None)
                if following is not None and end is not None:
                    worker.give(following)
                else:
                    del crew[worker.line]
                    worker.line.close()
                    leaving.append(worker)
                    if following is not None:
                        _hire(one, crew).give(following)
                if done is None:
                    continue
                if end is None:
                    lost.append(done)
                else:
                    yield done, end
    finally:
        for worker in crew.values():
            worker.process.terminate()
        _see_off([*crew.values(), *leaving])


def _hire(one: RunOne, crew: dict[Connection, _Worker]) -> _Worker:
    """Start a worker that knows what to do with a mission file."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=_work, args=(theirs,), daemon=True
    )
    with _without_interrupts():
        process.start()
        worker = crew[ours] = _Worker(process, ours)
    theirs.close()  # else the line would not break when the worker dies
    with suppress(OSError):
        ours.send(one)
    return worker


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Ctrl-C reaches all processes of a terminal; a worker must not even be born listening."""
    resource_tracker.ensure_running()  # it would unblock the signal when first started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _see_off(workers: Iterable[_Worker]) -> None:
    """Wait until processes that were told to leave have left, and kill those that do not."""
    deadline = time.monotonic() + _GRACE_S
    for worker in workers:
        worker.process.join(max(0.0, deadline - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.line.close()


def _work(line: Connection) -> None:
    """What a worker does: a mission at a time, until nobody is at the other end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        one: RunOne = line.recv()
        while True:
            line.send(attempt(one, line.recv(), None))


def _stop(_: int, __: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not break the cleaning up
    raise SystemExit(EXIT_INTERRUPTED)
