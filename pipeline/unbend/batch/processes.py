"""Missions side by side in processes of this machine.

Each process is a pool of its own: when a mission kills its process, no other one is lost with it,
and it is known which mission it was.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TYPE_CHECKING

from unbend.arithmetic import use_same_arithmetic
from unbend.batch.executors import Bug, Ends, Lost, Outcome, Task, TaskEnd, run_to_end
from unbend.batch.other_processes import is_suspended
from unbend.exit_codes import EXIT_INTERRUPTED
from unbend.interrupts import end_process, held_back
from unbend.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef

GRACE_S = 3.0
"""How long a process that was asked to stop may clean up before it is killed: 5 s are promised."""

LOOK_S = 5.0
"""How often it is looked whether the processes of missions are suspended (SIGSTOP)."""

MOST_LOOKS = 12
"""At so many looks, one minute, a process must be suspended to be killed. Looks are counted and not
time: Ctrl-Z suspends the command too, and then nobody looks."""


class MissionProcess:
    """A process that runs one mission at a time; it is replaced when one has killed it."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool: ProcessPoolExecutor | None = None
        self._process: BaseProcess | None = None
        self._looks_suspended = 0  # how often in turn it was found suspended
        self._was_suspended = False  # for so long that it was killed

    def submit(self, task: Callable[[], TaskEnd]) -> Future[TaskEnd]:
        """Begin a task; `end` says how it ended."""
        try:
            return self._submit(task)
        except BrokenProcessPool:  # the process was killed while it had nothing to do
            self._close()
            return self._submit(task)

    def _submit(self, task: Callable[[], TaskEnd]) -> Future[TaskEnd]:
        """Begin a task, in a new pool if there is none; notes a process that was started."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                max_workers=1,
                # A fork would copy the locks of threads that it does not copy.
                mp_context=multiprocessing.get_context("spawn"),
                initializer=prepare_process,
                initargs=(self._threads,),
            )
        with _STARTING, ctrl_c_kept_back():
            # A pool starts its process with the first task: the child that is new then is the one.
            before = set(multiprocessing.active_children())
            future = self._pool.submit(run_task, task)
            started = set(multiprocessing.active_children()) - before
        if started:
            self._process = started.pop()
            self._looks_suspended = 0
            self._was_suspended = False
        return future

    def end(self, future: Future[TaskEnd]) -> TaskEnd:
        """Wait for a task, and return how it ended.

        Lost where its process died, or was killed after it had been suspended (SIGSTOP) for
        `MOST_LOOKS` looks; Bug where the task or its result cannot be pickled.
        """
        while not wait([future], timeout=LOOK_S).done:
            self.kill_if_suspended()
        try:
            return future.result()
        except BrokenProcessPool:
            self._close()  # waits for the process, which has an exit code then
            code = None if self._process is None else self._process.exitcode
            return Lost(way_of_death(code, was_suspended=self._was_suspended))
        except Exception as error:  # the task, or what it returned, cannot be pickled
            return Bug(f"{type(error).__name__}: {error}")

    def kill_if_suspended(self) -> None:
        """Look whether the process is suspended (SIGSTOP); kill it after `MOST_LOOKS` in a row."""
        if self._process is None or not is_suspended(self._process.pid):
            self._looks_suspended = 0
            return
        self._looks_suspended += 1
        if self._looks_suspended >= MOST_LOOKS:
            self._was_suspended = True
            self._process.kill()

    def ask_to_stop(self) -> None:
        """Let the mission under way end as after SIGTERM."""
        if self._process is not None and self._process.is_alive():
            self._process.terminate()

    def stop(self, deadline: float) -> None:
        """Wait for the end of the process until a time of `time.monotonic`, then kill it."""
        if self._process is not None:
            self._process.join(max(0.0, deadline - time.monotonic()))
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        self._close()

    def _close(self) -> None:
        """Close the pool of a process that has ended or is about to.

        The pool's own thread is waited for: at the interpreter's end Python would write into a
        pipe that this thread is closing, and print a traceback.
        """
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


_STARTING = threading.Lock()
"""Held while a process starts: no other may start before it is known which child is new."""


@contextmanager
def ctrl_c_kept_back() -> Iterator[None]:
    """Start processes that Ctrl-C cannot end before `prepare_process` makes them ignore it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def stop_all(processes: Iterable[MissionProcess]) -> None:
    """Stop some processes, whatever they do; after three seconds they are killed."""
    stopping = list(processes)
    for process in stopping:
        process.ask_to_stop()
    deadline = time.monotonic() + GRACE_S
    for process in stopping:
        process.stop(deadline)


def prepare_process(threads: int) -> None:
    """In a new process: set its share of the CPUs, and let it end at SIGTERM or with its parent."""
    os.environ["UNBEND_THREADS"] = str(threads)
    use_same_arithmetic()  # as the command line does
    # What a library prints must not get among what the command prints.
    os.dup2(2, 1)
    # Ctrl-C goes to all processes of a terminal; the command tells this one to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop_at_signal)
    threading.Thread(target=end_with_parent, daemon=True).start()


def stop_at_signal(_: int, __: FrameType | None) -> None:
    """End the mission under way; a second signal must not stop the cleaning up."""
    end_process(EXIT_INTERRUPTED)


def end_with_parent() -> None:
    """End this process when the one that started it has died.

    Otherwise it would keep the lock of its mission's folder, which the next run needs.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(EXIT_INTERRUPTED)


def run_task(task: Callable[[], TaskEnd]) -> TaskEnd:
    """In a process: run a mission; only a receipt of its outcome is sent back."""
    end = run_to_end(task)
    return end.receipt() if isinstance(end, Outcome) else end


def way_of_death(code: int | None, *, was_suspended: bool = False) -> str:
    """What an exit code of a process says, in words.

    >>> way_of_death(-9), way_of_death(3), way_of_death(0xC0000005)
    ('killed by SIGKILL', 'exit code 3', 'exit code 0xC0000005')
    """
    if was_suspended:
        seconds = MOST_LOOKS * LOOK_S
        return f"stopped (SIGSTOP) for {seconds:.0f} s, so it was killed"
    if code is None:
        return "it ended without an exit code"
    if code < 0:
        return f"killed by {_name_of_signal(-code)}"
    if code < 256:
        return f"exit code {code}"
    return f"exit code 0x{code:08X}"


def _name_of_signal(number: int) -> str:
    """The name of a signal; most real-time signals have only a number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


Done = tuple[MissionProcess, "MissionRef", Future[TaskEnd]]
"""A task that has ended: its process, its mission, and how it ended."""


def next_done(done: SimpleQueue[Done], processes: Iterable[MissionProcess]) -> Done:
    """Wait for the next task that ends, and kill processes that stay suspended meanwhile."""
    while True:
        try:
            return done.get(timeout=LOOK_S)
        except Empty:
            for process in processes:
                process.kill_if_suspended()


class Processes:
    """Side by side in processes of this machine, which are kept from mission to mission."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """Yield how each mission ended, as soon as it did; ``alone`` runs them one by one.

        A mission is assigned when a process is free.
        """
        jobs = 1 if alone else min(self._jobs, len(tasks))
        threads = max(1, usable_cpus() // jobs)
        processes = [MissionProcess(threads) for _ in range(jobs)]
        waiting = iter(tasks.items())
        # The main thread waits for this queue alone: a signal interrupts it without a lock held.
        done: SimpleQueue[Done] = SimpleQueue()

        def begin_next(process: MissionProcess) -> None:
            """Let a free process begin the next mission that waits, if one does."""
            following = next(waiting, None)
            if following is None:
                return
            mission, task = following
            future = process.submit(task)
            future.add_done_callback(lambda ended: done.put((process, mission, ended)))

        try:
            with held_back():
                for process in processes:
                    begin_next(process)
            for _ in tasks:
                process, mission, future = next_done(done, processes)
                with held_back():
                    end = process.end(future)
                    begin_next(process)
                yield mission, end
        finally:
            with held_back():
                stop_all(processes)
