"""Many missions: one after the other or side by side; the end of one does not stop the others.

Side by side each runs in a worker process, the death of which costs that one mission.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

from pipeline.batch.plan import Outcome
from pipeline.errors import (
    EXIT_BUG,
    EXIT_DONE,
    EXIT_INTERRUPTED,
    EXIT_LOSSES,
    EXIT_REFUSED,
    ConfigError,
    MissionError,
    UnbendError,
)

if TYPE_CHECKING:
    from pipeline.config.campaign import MissionRef

# How long a worker that was asked to stop may clean up before it is killed.
_GRACE_S = 3.0


class RunMission(Protocol):
    """Runs one mission."""

    def __call__(self, mission: MissionRef, /, *, progress: Any = None) -> Outcome: ...


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an unexpected exception."""

    traceback: str


MissionEnd = Outcome | UnbendError | Bug


def run_guarded(run_mission: RunMission, mission: MissionRef, progress: Any) -> MissionEnd:
    """Run a mission; refusals and unexpected exceptions are returned, not raised."""
    try:
        return run_mission(mission, progress=progress)
    except UnbendError as error:
        return error
    except Exception:
        # The one broad except: a bug in one mission must not cost the user the others.
        return Bug(traceback.format_exc())


@dataclass(eq=False)
class _Worker:
    """A process that runs one mission at a time, and the connection to it."""

    process: SpawnProcess
    connection: Connection
    mission: MissionRef

    @classmethod
    def start(cls, run_mission: RunMission, mission: MissionRef) -> _Worker:
        """Start a process and send it the function that runs a mission, and the first one."""
        ours, theirs = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(
            target=_run_missions, args=(theirs,), daemon=True
        )
        process.start()
        theirs.close()  # otherwise the connection would not end when the worker dies
        with suppress(OSError):
            ours.send(run_mission)
        worker = cls(process, ours, mission)
        worker.assign(mission)
        return worker

    def assign(self, mission: MissionRef) -> None:
        """Send a mission to the worker."""
        self.mission = mission
        with suppress(OSError):  # a dead worker is noticed when its result is received
            self.connection.send(mission)

    def result(self) -> MissionEnd | None:
        """How its mission ended; None if the process ended first."""
        try:
            end: MissionEnd = self.connection.recv()
        except (EOFError, OSError):
            return None
        return end


def side_by_side(
    run_mission: RunMission, missions: Sequence[MissionRef], jobs: int, lost: list[MissionRef]
) -> Iterator[tuple[MissionRef, MissionEnd]]:
    """Run missions in ``jobs`` processes; yields how each ended, as soon as it did.

    A mission is assigned when a worker is free for it. The missions of workers that died are
    added to ``lost``; the others go on. When the caller leaves early, the workers are stopped.
    """
    waiting = iter(missions)
    workers: dict[Connection, _Worker] = {}
    finished: list[_Worker] = []

    def start(mission: MissionRef) -> None:
        with _interrupts_blocked():
            worker = _Worker.start(run_mission, mission)
            workers[worker.connection] = worker

    try:
        for mission in islice(waiting, jobs):
            start(mission)
        while workers:
            ready = wait(list(workers))
            for worker in [workers[c] for c in workers if c in ready]:
                done, end = worker.mission, worker.result()
                following = next(waiting, None)
                if following is not None and end is not None:
                    worker.assign(following)
                else:
                    del workers[worker.connection]
                    worker.connection.close()
                    finished.append(worker)
                    if following is not None:
                        start(following)
                if end is None:
                    lost.append(done)
                else:
                    yield done, end
    finally:
        for worker in workers.values():
            worker.process.terminate()
        deadline = time.monotonic() + _GRACE_S
        for worker in (*workers.values(), *finished):
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.connection.close()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C while a worker starts: a terminal sends it to all processes.

    A process inherits the block. On Windows there is none; there a Ctrl-C in the first moments of
    a worker ends it like any other process.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # it would unblock the signal when first started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run_missions(connection: Connection) -> None:
    """Body of a worker process: run the missions it is sent until the connection ends."""

    def stop(_: int, __: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not stop the cleaning up
        raise SystemExit(EXIT_INTERRUPTED)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        run_mission: RunMission = connection.recv()
        while True:
            connection.send(run_guarded(run_mission, connection.recv(), None))


def run_many(
    run_mission: RunMission,
    missions: Sequence[MissionRef],
    jobs: int,
    bar: Callable[[str], AbstractContextManager[Any]],
) -> Generator[tuple[MissionRef, MissionEnd]]:
    """Run missions; yields how each ended, as soon as it did.

    With one job, ``bar`` shows the progress of each; side by side none is shown. A mission whose
    process dies is run a second time, alone (refused with WORKER-LOST if that dies too).
    """
    shared = shared_outputs(missions)
    waiting = []
    for mission in missions:
        if mission in shared:
            yield mission, shared[mission]
        else:
            waiting.append(mission)
    if jobs == 1 or len(waiting) < 2:
        for mission in waiting:
            with bar(mission.path.stem) as progress:
                end = run_guarded(run_mission, mission, progress)
            yield mission, end
        return
    lost: list[MissionRef] = []
    yield from side_by_side(run_mission, waiting, jobs, lost)
    # Most processes that die do so for want of memory: now each mission has the machine alone.
    for mission in lost:
        lost_again: list[MissionRef] = []
        yield from side_by_side(run_mission, [mission], 1, lost_again)
        if lost_again:
            yield (mission, MissionError.of("WORKER-LOST", mission.path))


def shared_outputs(missions: Sequence[MissionRef]) -> dict[MissionRef, UnbendError]:
    """Missions whose results would be written to the folder of an earlier one.

    Folders are compared after symbolic links are resolved, and on Windows without case.
    """
    first_of: dict[str, MissionRef] = {}
    refused: dict[MissionRef, UnbendError] = {}
    for ref in missions:
        try:
            mission = ref.load()
        except UnbendError:
            continue  # raised again, and reported, when the mission is run
        output = os.path.normcase(os.path.realpath(ref.folder / mission.output.path))
        first = first_of.setdefault(output, ref)
        if first is not ref:
            refused[ref] = ConfigError.of("OUTPUT-SHARED", "output.path", first=first.path)
    return refused


def exit_code_of(codes: Sequence[int]) -> int:
    """The exit code of several missions: 1 for a bug, 6 for a refusal, else the worst done.

    The code of a single mission is returned as it is.

    >>> exit_code_of([0, 3]), exit_code_of([2]), exit_code_of([0, 2]), exit_code_of([6, 1])
    (3, 2, 6, 1)
    """
    if len(codes) == 1:
        return codes[0]
    if EXIT_BUG in codes:
        return EXIT_BUG
    done = (EXIT_DONE, EXIT_LOSSES)
    return max(code if code in done else EXIT_REFUSED for code in codes)


__all__ = ["Bug", "MissionEnd", "exit_code_of", "run_many", "shared_outputs"]
