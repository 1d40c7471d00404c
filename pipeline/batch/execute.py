"""Many missions: one after the other or side by side, none stopping the rest."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from pipeline.batch.manifest import Outcome
from pipeline.config import load_mission
from pipeline.errors import (
    EXIT_DONE,
    EXIT_LOSSES,
    EXIT_REFUSED,
    ConfigError,
    MissionError,
    UnbendError,
)


class RunOne(Protocol):
    """Runs one mission file."""

    def __call__(self, path: Path, *, progress: Any = None) -> Outcome: ...


End = Outcome | UnbendError


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
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(todo)), mp_context=context) as pool:
        futures = {pool.submit(_attempt, one, config, None): config for config in todo}
        for future in as_completed(futures):
            config = futures[future]
            try:
                yield config, future.result()
            except BrokenProcessPool:
                yield (
                    config,
                    MissionError(
                        "WORKER-LOST",
                        "the process that ran this mission died",
                        where=str(config),
                        remedy="run it again alone; the machine may be short of memory",
                    ),
                )


def _attempt(one: RunOne, config: Path, progress: Any) -> End:
    try:
        return one(config, progress=progress)
    except UnbendError as error:
        return error


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
    """The exit code of several missions: the worst of those done, or 6 when one was refused.

    A mission file that is run alone leaves with the code of its own refusal.

    >>> exit_code_of([0, 3]), exit_code_of([2]), exit_code_of([0, 2])
    (3, 2, 6)
    """
    if len(ends) == 1:
        return ends[0]
    done = (EXIT_DONE, EXIT_LOSSES)
    return max(end if end in done else EXIT_REFUSED for end in ends)
