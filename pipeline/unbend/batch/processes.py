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
"""Time to clean up after SIGTERM before a process is killed; the command ends within 5 s."""

CHECK_S = 5.0
"""Interval of the checks whether processes of missions are suspended (SIGSTOP)."""

CHECKS_UNTIL_KILLED = 12
"""A process that is suspended at so many checks in a row, for one minute, is killed. Checks are
counted and not time, because Ctrl-Z suspends the command too, which then does not check."""


class MissionProcess:
    """A process that runs one mission at a time; a new one is started when it has died."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool: ProcessPoolExecutor | None = None
        self._process: BaseProcess | None = None
        self._suspended_checks = 0  # checks in a row at which the process was suspended
        self._was_suspended = False  # the process was killed because it was suspended

    def submit(self, task: Callable[[], TaskEnd]) -> Future[TaskEnd]:
        """Begin a task; `wait_for_end` returns how it ended."""
        try:
            return self._submit(task)
        except BrokenProcessPool:  # the process was killed while it had nothing to do
            self._close()
            return self._submit(task)

    def _submit(self, task: Callable[[], TaskEnd]) -> Future[TaskEnd]:
        """Begin a task, in a new pool if there is none; keeps the process that the pool starts."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                max_workers=1,
                # A fork would copy the locks of threads that it does not copy.
                mp_context=multiprocessing.get_context("spawn"),
                initializer=prepare_process,
                initargs=(self._threads,),
            )
        with _START_LOCK, sigint_blocked():
            # A pool starts its process with the first task: that process is the new child.
            children_before = set(multiprocessing.active_children())
            future = self._pool.submit(run_task, task)
            started = set(multiprocessing.active_children()) - children_before
        if started:
            self._process = started.pop()
            self._suspended_checks = 0
            self._was_suspended = False
        return future

    def wait_for_end(self, future: Future[TaskEnd]) -> TaskEnd:
        """Wait for a task, and return how it ended.

        `Lost` if its process died, or was killed because it was suspended (SIGSTOP); `Bug` if the
        task or its result cannot be pickled.
        """
        while not wait([future], timeout=CHECK_S).done:
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
        """Kill the process if it is suspended at `CHECKS_UNTIL_KILLED` calls in a row."""
        if self._process is None or not is_suspended(self._process.pid):
            self._suspended_checks = 0
            return
        self._suspended_checks += 1
        if self._suspended_checks >= CHECKS_UNTIL_KILLED:
            self._was_suspended = True
            self._process.kill()

    def ask_to_stop(self) -> None:
        """Send SIGTERM to the process, which ends the mission that it runs."""
        if self._process is not None and self._process.is_alive():
            self._process.terminate()

    def stop(self, deadline: float) -> None:
        """Wait for the process until ``deadline`` (of `time.monotonic`), then kill it."""
        if self._process is not None:
            self._process.join(max(0.0, deadline - time.monotonic()))
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        self._close()

    def _close(self) -> None:
        """Close the pool of a process that has ended or is about to, if there is one.

        It waits for the pool's own thread: otherwise Python, when it exits, may write into a pipe
        that this thread is closing, and print a traceback.
        """
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


_START_LOCK = threading.Lock()
"""Locked while a process starts: no other may start before the new child is identified."""


@contextmanager
def sigint_blocked() -> Iterator[None]:
    """Context that blocks SIGINT: processes started in it inherit the block.

    So Ctrl-C cannot end them before `prepare_process` makes them ignore it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def stop_all(processes: Iterable[MissionProcess]) -> None:
    """Stop processes with SIGTERM; those that run after `GRACE_S` are killed."""
    stopping = list(processes)
    for process in stopping:
        process.ask_to_stop()
    deadline = time.monotonic() + GRACE_S
    for process in stopping:
        process.stop(deadline)


def prepare_process(threads: int) -> None:
    """Prepare a new process: it gets ``threads`` CPUs, and ends at SIGTERM or with its parent."""
    os.environ["UNBEND_THREADS"] = str(threads)
    use_same_arithmetic()  # as the command line does
    # Standard output goes to standard error: a library's output must not mix with the command's.
    os.dup2(2, 1)
    # Ctrl-C goes to all processes of a terminal; the command sends SIGTERM to this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop_at_signal)
    threading.Thread(target=end_with_parent, daemon=True).start()


def stop_at_signal(_: int, __: FrameType | None) -> None:
    """Handler of SIGTERM: end the process, after a clean-up that a second signal cannot stop."""
    end_process(EXIT_INTERRUPTED)


def end_with_parent() -> None:
    """Wait until the process that started this one has ended, then end this one at once.

    Otherwise it would keep the lock of its mission's folder, which the next run needs.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(EXIT_INTERRUPTED)


def run_task(task: Callable[[], TaskEnd]) -> TaskEnd:
    """Called in a process of a mission: run it; an outcome is returned as a receipt."""
    end = run_to_end(task)
    return end.receipt() if isinstance(end, Outcome) else end


def way_of_death(code: int | None, *, was_suspended: bool = False) -> str:
    """How a process died, in words, from its exit code; None if it has none.

    ``was_suspended`` : it was killed because it was suspended.

    >>> way_of_death(-9), way_of_death(3), way_of_death(0xC0000005)
    ('killed by SIGKILL', 'exit code 3', 'exit code 0xC0000005')
    """
    if was_suspended:
        seconds = CHECKS_UNTIL_KILLED * CHECK_S
        return f"stopped (SIGSTOP) for {seconds:.0f} s, so it was killed"
    if code is None:
        return "it ended without an exit code"
    if code < 0:
        return f"killed by {_name_of_signal(-code)}"
    if code < 256:
        return f"exit code {code}"
    # a status of Windows, such as 0xC0000005 for an access violation
    return f"exit code 0x{code:08X}"


def _name_of_signal(number: int) -> str:
    """The name of a signal, or "signal 40" for a number without a name."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


Done = tuple[MissionProcess, "MissionRef", Future[TaskEnd]]
"""A task that has ended: its process, its mission, and how it ended."""


def next_done(done: SimpleQueue[Done], processes: Iterable[MissionProcess]) -> Done:
    """Wait for the next task that ends, and meanwhile kill processes that stay suspended.

    ``done`` gets the tasks when they end.
    """
    while True:
        try:
            return done.get(timeout=CHECK_S)
        except Empty:
            for process in processes:
                process.kill_if_suspended()


class Processes:
    """Executor that runs ``jobs`` missions at the same time, each in a process of this machine.

    A process that has run a mission runs another one.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """Run the missions; yield how each ended, as soon as it did.

        ``alone`` runs them one by one. A mission is assigned when a process is free.
        """
        jobs = 1 if alone else min(self._jobs, len(tasks))
        threads = max(1, usable_cpus() // jobs)
        processes = [MissionProcess(threads) for _ in range(jobs)]
        waiting = iter(tasks.items())
        # The main thread waits only for this queue: it holds no lock when a signal interrupts it.
        done: SimpleQueue[Done] = SimpleQueue()

        def begin_next(process: MissionProcess) -> None:
            """Let a free process begin the next mission, if one is waiting."""
            next_task = next(waiting, None)
            if next_task is None:
                return
            mission, task = next_task
            future = process.submit(task)
            future.add_done_callback(lambda ended: done.put((process, mission, ended)))

        try:
            with held_back():
                for process in processes:
                    begin_next(process)
            for _ in tasks:
                process, mission, future = next_done(done, processes)
                with held_back():
                    end = process.wait_for_end(future)
                    begin_next(process)
                yield mission, end
        finally:
            with held_back():
                stop_all(processes)
