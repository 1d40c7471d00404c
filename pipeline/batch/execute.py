"""Many missions: one after the other or side by side, none stopping the rest."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from pipeline.batch.manifest import Outcome
from pipeline.config import load_mission
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


class RunOne(Protocol):
    """Runs one mission file."""

    def __call__(self, path: Path, *, progress: Any = None) -> Outcome: ...


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an error of ours."""

    traceback: str


End = Outcome | UnbendError | Bug


def run_many(
    one: RunOne,
    configs: Sequence[Path],
    jobs: int,
    bar: Callable[[str], AbstractContextManager[Any]],
) -> Iterator[tuple[Path, End]]:
    """Run mission files; yields how each ended, as soon as it did.

    With one job, ``bar`` shows the progress of each; side by side they stay silent.
    """
    shared = shared_outputs(configs)
    todo = []
    for config in configs:
        if config in shared:
            yield config, shared[config]
        else:
            todo.append(config)
    if jobs == 1 or len(todo) < 2:
        for config in todo:
            with bar(config.stem) as progress:
                end = _attempt(one, config, progress)
            yield config, end
        return
    yield from _side_by_side(one, todo, jobs)


def _side_by_side(one: RunOne, configs: Sequence[Path], jobs: int) -> Iterator[tuple[Path, End]]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(configs)), context, _begin_worker) as pool:
        futures = {pool.submit(_attempt, one, config, None): config for config in configs}
        try:
            for future in as_completed(futures):
                yield futures[future], _end_of(future, futures[future])
        except BaseException:
            # Interrupted: the workers clean up after themselves and leave, too.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, which then asks every worker to stop in order."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)


def _stop(_: int, __: FrameType | None) -> None:
    raise SystemExit(EXIT_INTERRUPTED)


def _end_of(future: Future[End], config: Path) -> End:
    try:
        return future.result()
    except BrokenProcessPool:
        return MissionError(
            "WORKER-LOST",
            "the process that ran this mission died",
            where=str(config),
            remedy="run it again alone; the machine may be short of memory",
        )


def _attempt(one: RunOne, config: Path, progress: Any) -> End:
    try:
        return one(config, progress=progress)
    except UnbendError as error:
        return error
    except Exception:
        # The one broad net: an error of ours in one mission must not cost the user the others.
        return Bug(traceback.format_exc())


def shared_outputs(configs: Sequence[Path]) -> dict[Path, UnbendError]:
    """Mission files whose results would fall into the folder of an earlier one."""
    taken: dict[Path, Path] = {}
    refused: dict[Path, UnbendError] = {}
    for config in configs:
        try:
            mission = load_mission(config)
        except UnbendError:
            continue  # said again, and reported, when its turn comes
        output = (config.parent / mission.output.path).resolve()
        first = taken.setdefault(output, config)
        if first is not config:
            refused[config] = ConfigError(
                "OUTPUT-SHARED",
                f"writes to the same folder as {first}",
                where="output.path",
                remedy="give each mission a folder of its own",
            )
    return refused


def exit_code_of(ends: Sequence[int]) -> int:
    """The exit code of several missions: 1 for a bug, 6 for a refusal, else the worst done.

    A mission file that is run alone leaves with the code of its own refusal.

    >>> exit_code_of([0, 3]), exit_code_of([2]), exit_code_of([0, 2]), exit_code_of([6, 1])
    (3, 2, 6, 1)
    """
    if len(ends) == 1:
        return ends[0]
    if EXIT_BUG in ends:
        return EXIT_BUG
    done = (EXIT_DONE, EXIT_LOSSES)
    return max(end if end in done else EXIT_REFUSED for end in ends)
