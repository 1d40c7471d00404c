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

from unbend.batch.executors import Bug, Executor, Lost, Outcome, Task
from unbend.batch.store import read_manifest
from unbend.errors import ConfigError, MissionError, UnbendError
from unbend.exit_codes import EXIT_BUG, EXIT_DONE, EXIT_LOSSES, EXIT_REFUSED

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef


MissionEnd = Outcome | UnbendError | Bug


def run_many(
    run_mission: Task, missions: Sequence[MissionRef], executor: Executor
) -> Generator[tuple[MissionRef, MissionEnd]]:
    """Run missions; yields how each ended, as soon as it did.

    One whose process dies is run again, alone; then refused with its command (WORKER-LOST).
    """
    tasks: dict[MissionRef, Task] = {ref: partial(run_mission, ref) for ref in missions}
    lost: dict[MissionRef, Lost] = {}
    with closing(executor.run(tasks)) as ends:
        for mission, end in ends:
            if isinstance(end, Lost):
                lost[mission] = end
            else:
                yield mission, _read(end)
    if not lost:
        return
    # Most processes that die do so for want of memory: now each mission has the machine alone.
    with closing(executor.run({mission: tasks[mission] for mission in lost}, alone=True)) as ends:
        for mission, end in ends:
            if isinstance(end, Lost):
                replay, first = shlex.join(["unbend", "run", *mission.words]), lost[mission].how
                end = MissionError.of(
                    "WORKER-LOST", mission.path, first=first, second=end.how, replay=replay
                )
            yield mission, _read(end)


def shard_of(shard: str | None) -> slice:
    """The missions of one of several jobs, which have the same list; refuses (RUN-SHARD) others.

    >>> "abcdefg"[shard_of("1/3")], "abcdefg"[shard_of(None)]
    ('be', 'abcdefg')
    """
    found = re.fullmatch(r"(\d+)/(\d+)", shard or "0/1")
    if found is None or not int(found[1]) < int(found[2]):
        raise ConfigError.of("RUN-SHARD", "--shard", shard=shard)
    return slice(int(found[1]), None, int(found[2]))


def _read(end: MissionEnd) -> MissionEnd:
    """How a mission ended, with its manifest; refuses results that are not here."""
    if not isinstance(end, Outcome) or not end.fingerprint:
        return end
    try:
        manifest = read_manifest(end.output)
        if manifest is None or manifest["fingerprint"] != end.fingerprint:
            raise MissionError.of("RESULTS-ELSEWHERE", end.output, name=end.name)
    except UnbendError as error:
        return error
    return replace(end, manifest=manifest, fingerprint="")


def shared_outputs(folders: Iterable[tuple[MissionRef, object]]) -> dict[MissionRef, UnbendError]:
    """Missions whose results would be written to the folder of an earlier one.

    Folders are compared after symbolic links are resolved, and on Windows without case.
    """
    first_of: dict[str, int] = {}
    refused: dict[MissionRef, UnbendError] = {}
    listed = list(folders)
    for number, (ref, folder) in enumerate(listed):
        first = first_of.setdefault(os.path.normcase(os.path.realpath(str(folder))), number)
        if first != number:
            path = listed[first][0].path
            refused[ref] = ConfigError.of("OUTPUT-SHARED", "output.path", first=path)
    return refused


def exit_code_of(codes: Sequence[int]) -> int:
    """The exit code of one mission, or of several: 1 for a bug, 6 for a refusal, else the worst.

    >>> exit_code_of([0, 3]), exit_code_of([2]), exit_code_of([0, 2]), exit_code_of([6, 1])
    (3, 2, 6, 1)
    """
    if len(codes) < 2:
        return codes[0] if codes else EXIT_DONE
    if EXIT_BUG in codes:
        return EXIT_BUG
    done = (EXIT_DONE, EXIT_LOSSES)
    return max(code if code in done else EXIT_REFUSED for code in codes)
