"""Where missions are run: in this process, or in several: side by side, or one in slices.

A mission run apart has a child process, whose death costs that mission alone. The child answers
each task that it reads with how it ended, and ends with its input: none is left behind.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import IO, TYPE_CHECKING, Any, Protocol, TypeVar, cast

from unbend.batch.object_store import Place
from unbend.errors import InputError, UnbendError
from unbend.exit_codes import EXIT_INTERRUPTED
from unbend.refraction.kernels.threads import usable_cpus


@dataclass(frozen=True)
class Outcome:
    """How a mission ended: where its results are, its manifest, and its exit code.

    From another process it is a receipt of less than a kilobyte: the manifest, which is at
    ``output``, is left out, and only its ``fingerprint`` comes.
    """

    name: str
    output: Path | Place
    manifest: dict[str, Any]
    exit_code: int
    repeated: bool
    fingerprint: str = ""


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an unexpected exception."""

    traceback: str


@dataclass(frozen=True)
class Lost:
    """A mission whose process died: how, in words."""

    how: str


TaskEnd = Outcome | UnbendError | Bug | Lost


def end_of(task: Callable[[], TaskEnd]) -> TaskEnd:
    """Run a mission; refusals and unexpected exceptions are returned, not raised."""
    try:
        return task()
    except UnbendError as error:
        return error
    except Exception:
        # The one broad except: a bug in one mission must not cost the user the others.
        return Bug(traceback.format_exc())


_GRACE_S = 3.0
"""How long a child that was asked to stop may clean up before it is killed."""

_IDLE_S = 60.0
"""How long a child without a task waits for another one."""

_SERVE = "from unbend.batch.executors import serve; serve()"


class Child:
    """A process that runs a task at a time, on ``threads`` or all; it imports ``module`` first."""

    def __init__(self, threads: int | None = None, module: str = __name__) -> None:
        self._threads, self._module = threads, module
        self.process: subprocess.Popen[bytes] | None = None

    def run(self, task: bytes) -> TaskEnd:
        """How a task ends: a pickled function without arguments, which returns an outcome."""
        while True:
            known = self.process
            process = self.process = known or self.started()
            try:
                pickle.dump(task, cast(IO[bytes], process.stdin))
                cast(IO[bytes], process.stdin).flush()
                return cast(TaskEnd, pickle.load(cast(IO[bytes], process.stdout)))
            except (OSError, EOFError, ValueError, pickle.UnpicklingError):
                self.process = None
                ended(process, None)
            if known is None or process.returncode != 0:
                return Lost(way_of_death(process.returncode))
            # It had waited for so long that it ended before this task came: one more is started.

    def started(self) -> subprocess.Popen[bytes]:
        """The process, with our paths of modules, out of reach of a terminal's Ctrl-C."""
        own = {} if self._threads is None else {"UNBEND_THREADS": str(self._threads)}
        code = f"import sys; sys.path[:] = {sys.path!r}; import {self._module}; {_SERVE}"
        return subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | own,
            process_group=None if os.name == "nt" else 0,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )


def stop_all(children: Iterable[Child]) -> None:
    """Stop some processes, whatever they do; after three seconds they are killed."""
    processes = [child.process for child in children if child.process is not None]
    for process in processes:
        process.terminate()
    deadline = time.monotonic() + _GRACE_S
    for process in processes:
        ended(process, max(0.0, deadline - time.monotonic()))


def ended(process: subprocess.Popen[bytes], seconds: float | None) -> None:
    """Wait for the end of a process, kill it after some seconds, and close its pipes."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for pipe in (process.stdin, process.stdout):
        with suppress(OSError):  # what was written last has nobody who reads it
            cast(IO[bytes], pipe).close()


def way_of_death(code: int) -> str:
    """What an exit code of a process says, in words.

    >>> way_of_death(-9), way_of_death(3), way_of_death(0xC0000005)
    ('killed by SIGKILL', 'exit code 3', 'exit code 0xC0000005')
    """
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit code {code if code < 256 else f'0x{code:08X}'}"


def run_pickled(task: bytes) -> TaskEnd:
    """Run a pickled task; to unpickle it imports what it needs."""
    return cast(TaskEnd, pickle.loads(task)())


def serve(idle_s: float = _IDLE_S) -> None:
    """Body of a child: run the tasks that come, until none comes for ``idle_s``."""
    # Files of its own: at the end Python closes its standard input, which a thread still reads, and
    # what a library prints must not get among the replies.
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as the command line does
    tasks: SimpleQueue[bytes] = SimpleQueue()

    def receive() -> None:
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                tasks.put(pickle.load(requests))
        # Nobody waits for results, and whoever runs the mission next needs the folder's lock.
        os._exit(EXIT_INTERRUPTED)

    def stop(_: int, __: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not stop the cleaning up
        raise SystemExit(EXIT_INTERRUPTED)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop)
    threading.Thread(target=receive, daemon=True).start()
    with suppress(Empty, BrokenPipeError):
        while True:
            task = tasks.get(timeout=idle_s)
            end = end_of(partial(run_pickled, task))
            if isinstance(end, Outcome):
                end = replace(end, manifest={}, fingerprint=str(end.manifest["fingerprint"]))
            pickle.dump(end, replies)
            replies.flush()


if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef

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
        """How each ended, as soon as it did (``alone`` : one by one). Leaving stops the rest."""


class Inline:
    """One after the other in this process; ``bar`` shows the progress of each."""

    def __init__(self, bar: Callable[[str], AbstractContextManager[Any]]) -> None:
        self._bar = bar

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = True) -> Ends:
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
    """Numbers of parts, in slices: whoever makes the file of a slice's place makes its parts."""

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
        """Slices nobody has, for ``name``; ``passed`` gets the length of each that is behind."""
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

    What a worker leaves unmade stays so; one that has not begun at the end is not waited for.
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
