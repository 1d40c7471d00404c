"""What running a mission somewhere means: the task, how it ended, and the simplest executor."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from unbend.errors import UnbendError
from unbend.interrupts import raise_if_ended_by_signal

if TYPE_CHECKING:
    from unbend.batch.object_store import Place
    from unbend.config.campaign import MissionRef
    from unbend.tables.manifest.whole import Manifest


@dataclass(frozen=True)
class Outcome:
    """A mission that ended with results.

    output : the folder of the results, or a place in object storage.
    manifest : None in a receipt, and for an unchanged mission among several.
    repeated : whether an earlier run had made the results, so that the mission did not run.
    fingerprint : that of the manifest, in a receipt only; otherwise empty. A receipt is the outcome
        as another process sends it, in less than a kilobyte: the manifest is read at ``output``.
    """

    name: str
    output: Path | Place
    manifest: Manifest | None
    exit_code: int
    repeated: bool
    fingerprint: str = ""

    def __repr__(self) -> str:
        """Name, exit code and folder of the mission; the manifest has too much for a line."""
        again = ", repeated" if self.repeated else ""
        return f"<Outcome {self.name}: exit code {self.exit_code}{again}, {self.output}>"

    def receipt(self) -> Outcome:
        """The outcome with the fingerprint of its manifest in place of the manifest.

        A receipt is returned unchanged.
        """
        fingerprint = self.fingerprint
        if self.manifest is not None:
            fingerprint = self.manifest.run.fingerprint
        return Outcome(
            name=self.name,
            output=self.output,
            manifest=None,
            exit_code=self.exit_code,
            repeated=self.repeated,
            fingerprint=fingerprint,
        )


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an unexpected exception."""

    traceback: str


@dataclass(frozen=True)
class Lost:
    """The end of a mission by the death of its process; ``how`` states in words how it died."""

    how: str


TaskEnd = Outcome | UnbendError | Bug | Lost

Task = Callable[..., Outcome]
"""Runs one mission; takes ``progress``. A function of a module with its arguments, so that it can
be pickled."""

Ends = Generator[tuple["MissionRef", TaskEnd]]


class Executor(Protocol):
    """Runs missions somewhere."""

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """Run the missions; yield how each ended, as soon as it did.

        With ``alone`` they run one by one, otherwise several may run at the same time. Closing the
        generator stops the missions that have not ended.
        """


def run_to_end(task: Callable[[], TaskEnd]) -> TaskEnd:
    """Run a mission, and return how it ended.

    A refusal (UnbendError) is returned as it is, an unexpected exception as a `Bug`. After a signal
    that ends this process SystemExit is raised instead.
    """
    try:
        return task()
    except UnbendError as error:
        raise_if_ended_by_signal()
        return error
    except Exception:
        raise_if_ended_by_signal()
        # The one broad except: a bug in one mission must not cost the user the others.
        return Bug(traceback.format_exc())


class Inline:
    """Executor that runs missions one after the other in this process.

    ``bar`` opens a progress bar with a title: the name of the mission's file.
    """

    def __init__(self, bar: Callable[[str], AbstractContextManager[Any]]) -> None:
        self._bar = bar

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = True) -> Ends:
        """Yield how each mission ended, in the order of ``tasks``; ``alone`` changes nothing."""
        for mission, task in tasks.items():
            with self._bar(mission.path.stem) as progress:
                end = run_to_end(partial(task, progress=progress))
            yield mission, end
