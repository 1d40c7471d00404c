"""Many missions: one after the other or side by side, none stopping the rest."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pipeline.batch.workers import Bug, End, RunOne, attempt, side_by_side
from pipeline.config import load_mission
from pipeline.errors import (
    EXIT_BUG,
    EXIT_DONE,
    EXIT_LOSSES,
    EXIT_REFUSED,
    ConfigError,
    MissionError,
    UnbendError,
)


def run_many(
    one: RunOne,
    configs: Sequence[Path],
    jobs: int,
    bar: Callable[[str], AbstractContextManager[Any]],
) -> Generator[tuple[Path, End]]:
    """Run mission files; yields how each ended, as soon as it did.

    With one job, ``bar`` shows the progress of each; side by side they stay silent.
    """
    shared = shared_outputs(configs)
    waiting = []
    for config in configs:
        if config in shared:
            yield config, shared[config]
        else:
            waiting.append(config)
    if jobs == 1 or len(waiting) < 2:
        for config in waiting:
            with bar(config.stem) as progress:
                end = attempt(one, config, progress)
            yield config, end
        return
    lost: list[Path] = []
    yield from side_by_side(one, waiting, jobs, lost)
    # Whatever killed their workers, for want of memory most likely: now each has the machine alone.
    for config in lost:
        again: list[Path] = []
        yield from side_by_side(one, [config], 1, again)
        if again:
            yield (
                config,
                MissionError(
                    "WORKER-LOST",
                    "the process that ran this mission died, and so did a second one",
                    where=str(config),
                    remedy="the machine may be short of memory: lower output.batch_rows, or run it "
                    "on a larger one",
                ),
            )


def shared_outputs(configs: Sequence[Path]) -> dict[Path, UnbendError]:
    """Mission files whose results would fall into the folder of an earlier one."""
    taken: dict[Path, Path] = {}
    refused: dict[Path, UnbendError] = {}
    for config in configs:
        try:
            mission = load_mission(config)
        except UnbendError:
            continue  # said again, and reported, when its turn comes
        output = Path(os.path.realpath(config.parent / mission.output.path))
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


__all__ = ["Bug", "End", "exit_code_of", "run_many", "shared_outputs"]
