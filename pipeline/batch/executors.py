"""Where missions are run: in this process, or in several: side by side, or one in slices."""

from __future__ import annotations

import hashlib
import pickle
import threading
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from pipeline.batch.apart import Child, stop_all
from pipeline.batch.outcomes import Outcome, TaskEnd, end_of
from pipeline.errors import InputError
from pipeline.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from pipeline.config.campaign import MissionRef

Task = Callable[..., Outcome]
"""Runs one mission; takes ``progress`` and ``helpers``. A function of a module with its arguments,
so that it can be pickled."""

T = TypeVar("T")
Ends = Generator[tuple["MissionRef", TaskEnd]]

Worker = Callable[[bytes], Any]
"""Runs a pickled task somewhere else and waits for its end."""

_SLICE = 2, 32
"""Parts of a slice: the last ones are small, so that all end together."""


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


class Helpers(Protocol):
    """Who helps to make the parts of one mission."""

    def workers(self, module: str, parts: int) -> AbstractContextManager[Sequence[Worker]]:
        """Workers for so many parts, which import a module before there is a task."""


@dataclass(frozen=True)
class ChildHelpers:
    """Processes of this machine; ``processes`` : how many there are with this one."""

    processes: int = 1

    @contextmanager
    def workers(self, module: str, parts: int) -> Iterator[Sequence[Worker]]:
        """The other processes, for a mission of four parts or more."""
        count = self.processes if parts >= 4 else 1
        children = [Child(max(1, usable_cpus() // count), module) for _ in range(count - 1)]
        try:
            for child in children:
                with suppress(OSError):  # it is started once more when there is a task
                    child.process = child.started()
            yield [child.run for child in children]
        finally:
            stop_all(children)


ALONE = ChildHelpers()


@dataclass(frozen=True)
class Slices:
    """Numbers of parts, in slices that anyone takes who sees the folder.

    Whoever makes the file of a slice's place makes its parts, and nobody else does.
    """

    folder: Path
    numbers: Sequence[Sequence[int]]

    @classmethod
    def of(cls, staging: Path, numbers: Sequence[int], workers: int) -> Slices:
        """The numbers for so many workers and this process, in a folder of this call alone."""
        folder, slices = staging / f"slices-{uuid.uuid4().hex}", list[Sequence[int]]()
        folder.mkdir()
        while numbers:
            fewest, most = _SLICE
            size = min(most, max(fewest, len(numbers) // (2 * workers + 2)))
            slices.append(numbers[:size])
            numbers = numbers[size:]
        return cls(folder, slices)

    def taken(
        self, name: str, passed: Callable[[int], None] = lambda _: None
    ) -> Iterator[Sequence[int]]:
        """Slices that nobody has, for ``name``, who has begun before the first.

        ``passed`` is called with the length of each that is behind, whoever had it.
        """
        (self.folder / name).touch()
        for place, some in enumerate(self.numbers):
            with suppress(FileExistsError):
                with (self.folder / str(place)).open("x") as file:
                    file.write(name)
                yield some
            passed(len(some))


def make_parts(
    make: Callable[..., Any],
    slices: Slices,
    workers: Sequence[Worker],
    progress: Callable[[int], None],
) -> None:
    """Call ``make(numbers=...)`` with slices, here and by workers, which get a path and a key.

    Parts that a worker leaves unmade, for it died or nothing can be sent to it, stay unmade. One
    that has not begun when nothing is left is not waited for. ``progress`` is called with the
    number of parts that may be done now.
    """
    content, setup = pickle.dumps((make, slices)), slices.folder / "setup"
    setup.write_bytes(content)
    digest, ended = hashlib.sha256(content).hexdigest(), SimpleQueue[str]()

    def send(worker: Worker, name: str) -> None:
        task = pickle.dumps(partial(make_as_worker, setup, digest, name))
        end_of(partial(worker, task))
        ended.put(name)

    names = [f"worker-{number}" for number in range(len(workers))]
    for sent in zip(workers, names, strict=True):
        threading.Thread(target=send, args=sent, daemon=True).start()
    for some in slices.taken("own", progress):
        make(numbers=some)
    left = {name for name in names if (slices.folder / name).exists()}
    while left:
        left.discard(ended.get())


def make_as_worker(setup: Path, digest: str, name: str) -> list[int]:
    """Make parts in the place of another process until none are left; their numbers."""
    make, slices = made_with(setup, digest)
    made = list[int]()
    for some in slices.taken(name):
        make(numbers=some)
        made += some
    return made


@lru_cache(maxsize=1)
def made_with(setup: Path, digest: str) -> tuple[Callable[..., Any], Slices]:
    """What parts are made with; refuses (INPUT-CHANGED) a file that is not of this SHA-256."""
    content = setup.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError.of("INPUT-CHANGED", setup, role="set-up")
    found: tuple[Callable[..., Any], Slices] = pickle.loads(content)
    return found
