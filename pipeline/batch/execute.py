"""Many missions: one after the other or side by side; the end of one does not stop the others."""

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pipeline.batch.workers import Bug, MissionEnd, RunMission, run_guarded, side_by_side
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
    run_mission: RunMission,
    configs: Sequence[Path],
    jobs: int,
    bar: Callable[[str], AbstractContextManager[Any]],
) -> Generator[tuple[Path, MissionEnd]]:
    """Run mission files; yields how each ended, as soon as it did.

    With one job, ``bar`` shows the progress of each; side by side none is shown. A mission whose
    process dies is run a second time, alone (refused with WORKER-LOST if that dies too).
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
                end = run_guarded(run_mission, config, progress)
            yield config, end
        return
    lost: list[Path] = []
    yield from side_by_side(run_mission, waiting, jobs, lost)
    # Most processes that die do so for want of memory: now each mission has the machine alone.
    for config in lost:
        lost_again: list[Path] = []
        yield from side_by_side(run_mission, [config], 1, lost_again)
        if lost_again:
            what = "the process that ran this mission died, and so did a second one"
            remedy = (
                "the machine may be short of memory: lower output.batch_rows, or run it "
                "on a larger one"
            )
            yield (config, MissionError("WORKER-LOST", what, where=str(config), remedy=remedy))


def shared_outputs(configs: Sequence[Path]) -> dict[Path, UnbendError]:
    """Mission files whose results would be written to the folder of an earlier one.

    Folders are compared after symbolic links are resolved, and on Windows without case.
    """
    first_of: dict[str, Path] = {}
    refused: dict[Path, UnbendError] = {}
    for config in configs:
        try:
            mission = load_mission(config)
        except UnbendError:
            continue  # raised again, and reported, when the mission is run
        output = os.path.normcase(os.path.realpath(config.parent / mission.output.path))
        first = first_of.setdefault(output, config)
        if first is not config:
            what = f"writes to the same folder as {first}"
            remedy = "give each mission a folder of its own"
            refused[config] = ConfigError("OUTPUT-SHARED", what, where="output.path", remedy=remedy)
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
