"""Where missions are run: in this process, or in several: side by side, or one in slices."""

from __future__ import annotations

import pickle
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from pipeline.batch.apart import Child, stop_all
from pipeline.batch.outcomes import Bug, Lost, Outcome, TaskEnd, end_of
from pipeline.errors import UnbendError
from pipeline.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from pipeline.config.campaign import MissionRef

Task = Callable[..., Outcome]
"""Runs one mission; takes ``progress``. A function of a module with its arguments, so that it can
be pickled."""

T = TypeVar("T")
Ends = Generator[tuple["MissionRef", TaskEnd]]

_SLICES_EACH = 3
"""Slices for each process: few, for what they are made with is sent with each."""


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
            for mission, task in taken(waiting):
                ends.put((mission, end_of(partial(child.run, task))))

        try:
            for child in children:
                threading.Thread(target=serve, args=(child,), daemon=True).start()
            for _ in tasks:
                yield ends.get()
        finally:
            deque(taken(waiting), 0)
            stop_all(children)


def taken(waiting: SimpleQueue[T]) -> Iterator[T]:
    """What waits in a queue, taken one by one until nothing does."""
    with suppress(Empty):
        while True:
            yield waiting.get_nowait()


def make_parts(
    make: Callable[..., Any],
    numbers: Sequence[int],
    processes: int,
    progress: Callable[[int], None],
) -> None:
    """Call ``make(numbers=...)`` with slices of the numbers, here and in other processes.

    Parts that a process leaves unmade, for it died or nothing can be sent to it, stay unmade.
    ``progress`` is called with the number of parts that may be done now.
    """
    size = max(1, -(-len(numbers) // (processes * _SLICES_EACH)))
    waiting: SimpleQueue[Sequence[int]] = SimpleQueue()
    for first in range(0, len(numbers), size):
        waiting.put(numbers[first : first + size])
    finished: SimpleQueue[None] = SimpleQueue()
    children = [Child(max(1, usable_cpus() // processes)) for _ in range(processes - 1)]

    def send(child: Child, some: Sequence[int]) -> Any:
        return child.run(pickle.dumps(partial(make, numbers=some)))

    def serve(child: Child) -> None:
        for some in taken(waiting):
            if isinstance(end_of(partial(send, child, some)), (Lost, Bug, UnbendError)):
                break
            progress(len(some))
        finished.put(None)

    try:
        for child in children:
            threading.Thread(target=serve, args=(child,), daemon=True).start()
        for some in taken(waiting):
            make(numbers=some)
            progress(len(some))
        for _ in children:
            finished.get()
    finally:
        deque(taken(waiting), 0)
        stop_all(children)
