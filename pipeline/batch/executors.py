"""Where missions are run: in this process, or side by side in processes of their own."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol

from pipeline.batch.apart import Child, stop_all
from pipeline.batch.outcomes import Outcome, TaskEnd, end_of
from pipeline.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from pipeline.config.campaign import MissionRef

Task = Callable[..., Outcome]
"""Runs one mission; takes ``progress``. A function of a module with its arguments, so that it can
be pickled."""

Ends = Generator[tuple["MissionRef", TaskEnd]]


class Executor(Protocol):
    """Runs missions somewhere."""

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """How each ended, as soon as it did; what is left is stopped when the caller leaves.

        ``alone`` : one after the other, with the machine to itself.
        """


class Inline:
    """One after the other in this process; ``bar`` shows the progress of each."""

    def __init__(self, bar: Callable[[str], AbstractContextManager[Any]]) -> None:
        self._bar = bar

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = True) -> Ends:
        """How each ended, in their order."""
        for mission, task in tasks.items():
            with self._bar(mission.path.stem) as progress:
                end = end_of(partial(task, progress=progress))
            yield mission, end


class Processes:
    """Side by side in processes of this machine, which are kept from mission to mission."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """How each ended, as soon as it did. A mission is assigned when a process is free."""
        waiting: SimpleQueue[tuple[MissionRef, bytes]] = SimpleQueue()
        for mission, task in tasks.items():
            waiting.put((mission, pickle.dumps(task)))
        # The main thread waits for nothing else: a signal interrupts that without a lock held.
        ends: SimpleQueue[tuple[MissionRef, TaskEnd]] = SimpleQueue()
        jobs = 1 if alone else min(self._jobs, len(tasks))
        children = [Child(max(1, usable_cpus() // jobs)) for _ in range(jobs)]

        def serve(child: Child) -> None:
            while True:
                try:
                    mission, task = waiting.get_nowait()
                except Empty:
                    return
                ends.put((mission, end_of(partial(child.run, task))))

        try:
            for child in children:
                threading.Thread(target=serve, args=(child,), daemon=True).start()
            for _ in tasks:
                yield ends.get()
        finally:
            with suppress(Empty):
                while True:
                    waiting.get_nowait()
            stop_all(children)
