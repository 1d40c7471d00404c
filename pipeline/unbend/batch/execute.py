"""Many missions: an executor says where they run; the end of one does not stop the others."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from unbend.batch import messages
from unbend.batch.executors import Bug, Executor, Lost, Outcome, Task
from unbend.batch.results import read_manifest
from unbend.errors import UnbendError
from unbend.exit_codes import EXIT_BUG, EXIT_DONE, EXIT_LOSSES, EXIT_REFUSED

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef


MissionEnd = Outcome | UnbendError | Bug


def run_many(
    run_mission: Task, missions: Sequence[MissionRef], executor: Executor
) -> Generator[tuple[MissionRef, MissionEnd]]:
    """Run missions; yields how each ended, as soon as it did.

    ``run_mission`` takes a mission as its first argument. If its process dies, a mission is run
    again, alone. If its process dies again, the mission is refused (WORKER-LOST) with the command
    that repeats it.
    """
    tasks: dict[MissionRef, Task] = {ref: partial(run_mission, ref) for ref in missions}
    lost: dict[MissionRef, Lost] = {}
    with closing(executor.run(tasks)) as ends:
        for mission, end in ends:
            if isinstance(end, Lost):
                lost[mission] = end
            else:
                yield mission, with_manifest(end)
    if not lost:
        return
    # Most processes that die do so for want of memory: now each mission has the machine alone.
    again = {mission: tasks[mission] for mission in lost}
    with closing(executor.run(again, alone=True)) as ends:
        for mission, end in ends:
            if isinstance(end, Lost):
                yield mission, lost_twice(mission, lost[mission], end)
            else:
                yield mission, with_manifest(end)


def lost_twice(mission: MissionRef, first: Lost, second: Lost) -> UnbendError:
    """The refusal (WORKER-LOST) of a mission that killed its process again when it ran alone.

    ``first`` and ``second`` are its two ends.
    """
    return messages.worker_lost(
        path=str(mission.path),
        first=first.how,
        second=second.how,
        replay=shlex.join(["unbend", "run", *mission.run_arguments]),
    )


def with_manifest(end: MissionEnd) -> MissionEnd:
    """The end of a mission, a receipt completed by the manifest at its output.

    Returns a refusal (RESULTS-ELSEWHERE) if there is no manifest, or that of another run. An end
    that is not a receipt is returned unchanged.
    """
    if not isinstance(end, Outcome) or not end.fingerprint:
        return end
    try:
        manifest = read_manifest(end.output)
        if manifest is None or manifest.run.fingerprint != end.fingerprint:
            raise messages.results_elsewhere(path=str(end.output), name=end.name)
    except UnbendError as error:
        return error
    return replace(end, manifest=manifest, fingerprint="")


def shard_of(shard: str | None) -> slice:
    """The slice of a list of missions that one of several jobs runs.

    All jobs have the same list. ``shard`` is K/N: the number of this job, counted from 0, and the
    number of jobs, as ``1/3``; None means one job. Refuses (RUN-SHARD) any other text.

    >>> "abcdefg"[shard_of("1/3")], "abcdefg"[shard_of(None)]
    ('be', 'abcdefg')
    """
    if shard is None:
        return slice(None)
    match = re.fullmatch(r"(\d+)/(\d+)", shard)
    if match is None:
        raise messages.no_such_shard(shard=shard)
    number = int(match[1])
    jobs = int(match[2])
    if number >= jobs:
        raise messages.no_such_shard(shard=shard)
    return slice(number, None, jobs)


def shared_outputs(folders: Iterable[tuple[MissionRef, object]]) -> dict[MissionRef, UnbendError]:
    """The refusal of each mission that would write its results to the folder of an earlier one.

    ``folders`` are the missions with their output folders or places. Folders are compared after
    symbolic links are resolved, and on Windows without case.
    """
    first_of: dict[str, MissionRef] = {}
    refused: dict[MissionRef, UnbendError] = {}
    for mission, folder in folders:
        real_folder = os.path.normcase(os.path.realpath(str(folder)))
        if real_folder in first_of:
            refused[mission] = messages.output_shared(first=str(first_of[real_folder].path))
        else:
            first_of[real_folder] = mission
    return refused


def exit_code_of_command(codes: Sequence[int]) -> int:
    """The exit code of a command, from the exit codes of its missions.

    A single mission gives its own code. Several give 1 if one is a bug (1), else 6 if one failed in
    another way, else 3 if one has losses (3), else 0.

    >>> [exit_code_of_command(codes) for codes in ([0, 3], [2], [0, 2], [6, 1])]
    [3, 2, 6, 1]
    """
    if not codes:
        return EXIT_DONE
    if len(codes) == 1:
        return codes[0]
    if EXIT_BUG in codes:
        return EXIT_BUG
    if any(code not in (EXIT_DONE, EXIT_LOSSES) for code in codes):
        return EXIT_REFUSED
    return max(codes)
