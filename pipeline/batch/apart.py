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
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any

from pipeline.batch.outcomes import Lost, Outcome, Receipt, TaskEnd, end_of
from pipeline.errors import EXIT_INTERRUPTED

_GRACE_S = 3.0
"""How long a child that was asked to stop may clean up before it is killed."""

_IDLE_S = 60.0
"""How long a child without a task waits for another one."""

_SERVE = "from pipeline.batch.apart import serve; serve()"


class Child:
    """A process that runs one task at a time; started when it is needed.

    ``threads`` : how many it may use, None for as many as there are CPUs.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._threads = threads
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, task: bytes) -> TaskEnd:
        """How a task ends: a pickled function without arguments, which returns an outcome."""
        while True:
            known = self._process
            process = self._process = known or self._start()
            try:
                end: TaskEnd = self._answer(process, task)
                return end
            except (OSError, EOFError, pickle.UnpicklingError):
                self._process = None
                code = _closed(process).wait()
            if known is None or code != 0:
                return Lost(_how(code))
            # It had waited for so long that it ended before this task came: one more is started.

    def _answer(self, process: subprocess.Popen[bytes], task: bytes) -> Any:
        if process.stdin is None or process.stdout is None:
            raise EOFError
        pickle.dump(task, process.stdin)
        process.stdin.flush()
        return pickle.load(process.stdout)

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the process: with our paths of modules, out of reach of a terminal's Ctrl-C."""
        own = {} if self._threads is None else {"UNBEND_THREADS": str(self._threads)}
        code = f"import sys; sys.path[:] = {sys.path!r}; {_SERVE}"
        windows = os.name == "nt"
        return subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | own,
            process_group=None if windows else 0,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )

    def stop(self) -> None:
        """Ask the process to stop, if there is one."""
        if self._process is not None:
            with suppress(OSError):
                self._process.terminate()

    def end(self, deadline: float) -> None:
        """Wait for a process that was asked to stop; at a time of the monotonic clock kill it."""
        process = self._process
        if process is None:
            return
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
        _closed(process).wait()


def _closed(process: subprocess.Popen[bytes]) -> subprocess.Popen[bytes]:
    """A process that has ended, or is about to, without its pipes."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):  # what was written last has nobody who reads it
                pipe.close()
    return process


def stop_all(children: Iterable[Child]) -> None:
    """Stop some processes, whatever they do; after three seconds they are killed."""
    children = list(children)
    for child in children:
        child.stop()
    deadline = time.monotonic() + _GRACE_S
    for child in children:
        child.end(deadline)


def _how(code: int) -> str:
    """What an exit code of a process says, in words.

    >>> _how(-9), _how(3), _how(0xC0000005)
    ('killed by SIGKILL', 'exit code 3', 'exit code 0xC0000005')
    """
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit code {code if code < 256 else f'0x{code:08X}'}"


def _unpickled(task: bytes) -> Outcome:
    """Run a pickled task; to unpickle it imports what it needs."""
    run: Callable[[], Outcome] = pickle.loads(task)
    return run()


def serve(idle_s: float = _IDLE_S) -> None:
    """Body of a child: run the tasks that come, until none comes for ``idle_s``."""
    # Files of its own: at the end Python closes its standard input, which a thread still reads, and
    # what a library prints must not get among the replies.
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
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
            end = end_of(partial(_unpickled, task))
            if isinstance(end, Outcome):
                fingerprint = str(end.manifest["fingerprint"])
                end = Receipt(end.name, end.output, fingerprint, end.exit_code, end.repeated)
            pickle.dump(end, replies)
            replies.flush()
