"""A mission run apart: in a child process, whose death costs that mission and nothing else.

The child reads tasks from its standard input and answers each with what became of it. It ends with
its input: at the latest when its parent ends, however that ended, so that none is left behind.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from types import FrameType
from typing import IO, cast

from pipeline.batch.outcomes import Lost, Outcome, Receipt, TaskEnd, end_of
from pipeline.exit_codes import EXIT_INTERRUPTED

_GRACE_S = 3.0
"""How long a child that was asked to stop may clean up before it is killed."""

_IDLE_S = 60.0
"""How long a child without a task waits for another one."""

_SERVE = "from pipeline.batch.apart import serve; serve()"


class Child:
    """A process that runs one task at a time; started when it is needed, or before.

    ``threads`` : how many it may use, None for as many as there are CPUs; ``module`` : what it
    imports before its first task.
    """

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
                fingerprint = str(end.manifest["fingerprint"])
                end = Receipt(end.name, end.output, fingerprint, end.exit_code, end.repeated)
            pickle.dump(end, replies)
            replies.flush()
