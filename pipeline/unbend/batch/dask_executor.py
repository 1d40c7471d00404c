"""Missions on a Dask cluster: a task is one mission, which the worker runs in a process apart.

The death of a mission's process costs that mission, the death of a worker its missions under way,
which others run again.
"""

from __future__ import annotations

import asyncio
import json
import logging
import multiprocessing
import pickle
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

from unbend.batch import messages
from unbend.batch.executors import Bug, Ends, Lost, Task, TaskEnd
from unbend.batch.fingerprint import all_versions, version
from unbend.batch.processes import MissionProcess, stop_all
from unbend.errors import OutputInUseError
from unbend.interrupts import held_back
from unbend.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef

_CONNECT_S = 10.0
"""How long a scheduler may take to answer, and to have its first worker."""

_STOP_S = 4.0
"""How long an interrupted command waits until its missions are stopped."""

_SUBMISSIONS = 6
"""How often a mission is handed out whose workers die; each time Dask tries a few of them."""

_ATTEMPTS = 20
"""How often, twice a second, a mission is tried whose folder another process still holds."""

_OPTIONAL = ("dask", "distributed", "pycolmap", "obstore")
"""Libraries that no number depends on, but must be the same everywhere or nowhere."""


# In the command


class _Submitted(NamedTuple):
    """A mission that a worker runs, for the n-th time."""

    mission: MissionRef
    future: Any
    times: int


class DaskExecutor:
    """The workers of a Dask scheduler, by its address or the JSON file that it writes."""

    def __init__(self, scheduler: str) -> None:
        self._scheduler = scheduler

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """How each mission ended, as soon as it did; ``alone`` changes nothing.

        Refuses before any work a scheduler that is not there or has no workers, and workers with
        other versions or without its files; SCHEDULER-LOST where it goes away.
        """
        # The main thread waits for nothing but these ends, so that a signal leaves no lock behind.
        ends: SimpleQueue[tuple[MissionRef, TaskEnd] | Exception] = SimpleQueue()
        done: SimpleQueue[Any] = SimpleQueue()

        def serve() -> None:
            try:
                self._serve(tasks, ends, done)
            except (OSError, CancelledError) as error:
                text = str(error) or type(error).__name__
                ends.put(messages.scheduler_lost(address=self._scheduler, error=text))
            except Exception as error:
                ends.put(error)  # raised where a person reads it

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            for _ in tasks:
                end = ends.get()
                if isinstance(end, Exception):
                    raise end
                yield end
        finally:
            done.put(None)
            with held_back():
                thread.join(_STOP_S)

    def _serve(
        self,
        tasks: Mapping[MissionRef, Task],
        ends: SimpleQueue[tuple[MissionRef, TaskEnd] | Exception],
        done: SimpleQueue[Any],
    ) -> None:
        """Hand all missions to the workers, and pass on how they ended, until None is done."""
        try:
            import distributed
        except ImportError as error:
            raise messages.dask_missing(error=str(error)) from None
        versions = versions_here()
        command = uuid.uuid4().hex
        with connected(self._scheduler, command) as client:
            check_workers(client, command, versions, [mission.path for mission in tasks])
            waiting: dict[str, _Submitted] = {}

            def submit(mission: MissionRef, times: int) -> None:
                task = pickle.dumps(partial(run_here, versions, tasks[mission]))
                future = client.submit(run_apart, command, task, pure=False)
                waiting[future.key] = _Submitted(mission, future, times)
                future.add_done_callback(done.put)

            for mission in tasks:
                submit(mission, 1)
            while waiting:
                ended = done.get()
                if ended is None:
                    return
                mission, future, times = waiting.pop(ended.key)
                try:
                    ends.put((mission, future.result()))
                except distributed.KilledWorker as error:
                    if times < _SUBMISSIONS:
                        submit(mission, times + 1)
                    else:
                        ends.put((mission, Lost(str(error))))


def scheduler_address(scheduler: str) -> str:
    """The address itself, or that in a scheduler's file; else refused (SCHEDULER-FILE)."""
    if "://" in scheduler:
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise messages.scheduler_file_invalid(path=scheduler, error=str(error)) from None


def refuse_missing(scheduler: str) -> None:
    """Refuse (SCHEDULER-NONE) a scheduler at whose address nobody begins to listen."""
    address = scheduler_address(scheduler)
    limit = time.monotonic() + _CONNECT_S
    with refusing_what_is_said_of(address):
        url = urlsplit(address)
        while url.scheme in ("tcp", "tls"):
            try:
                socket.create_connection((url.hostname, url.port), _CONNECT_S).close()
                break
            except ConnectionRefusedError:
                if time.monotonic() > limit:
                    raise
            time.sleep(0.2)


@contextmanager
def refusing_what_is_said_of(address: str) -> Iterator[None]:
    """Raise what is said of an address where no scheduler is as a refusal (SCHEDULER-NONE)."""
    try:
        yield
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise messages.no_scheduler(address=address, error=str(error)) from None


@contextmanager
def connected(scheduler: str, command: str) -> Iterator[Any]:
    """A client of a scheduler that is there; at the end what the command runs is stopped."""
    from distributed import Client
    from distributed.comm import resolve_address

    address = scheduler_address(scheduler)
    for name in list(logging.root.manager.loggerDict):
        if name.startswith("distributed"):  # each has a level of its own
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with refusing_what_is_said_of(address):
        resolve_address(address)  # a client of another scheme would try it for long, unasked
        client = Client(address, timeout=_CONNECT_S, set_as_default=False, direct_to_workers=False)
    try:
        with suppress(TimeoutError):
            client.wait_for_workers(1, timeout=_CONNECT_S)
        yield client
    finally:
        with suppress(Exception):  # where the scheduler has gone there is nobody to tell
            client.run(stop_command, command)
            client.close(timeout=_STOP_S)


def check_workers(
    client: Any, command: str, versions: Mapping[str, str], files: list[Path]
) -> None:
    """Refuse (WORKER-VERSION, WORKER-FILES) workers that would not do what this process does."""
    question = pickle.dumps(partial(about_worker, files))
    reports = client.run(run_beside, command, question, on_error="return")
    if not reports:
        raise messages.no_workers(address=client.scheduler_info()["address"])
    for worker, report in sorted(reports.items()):
        if not isinstance(report, tuple):
            text = report.traceback if isinstance(report, Bug) else str(report)
            raise messages.worker_unable(worker=worker, error=text.strip().split("\n")[-1])
        versions_there, missing = report
        refuse_other_versions(worker, versions, versions_there)
        if missing:
            raise messages.files_not_seen(worker=worker, first=missing[0], count=len(missing))


def refuse_other_versions(
    worker: str, versions: Mapping[str, str], versions_there: Mapping[str, str]
) -> None:
    """Refuse (WORKER-VERSION) a worker with other versions than those of the command."""
    other = []
    for name in sorted(versions.keys() | versions_there.keys()):
        there = versions_there.get(name, "missing")
        here = versions.get(name, "missing")
        if there != here:
            other.append(f"{name} {there} (here {here})")
    if other:
        raise messages.other_versions(worker=worker, other=other)


def versions_here() -> dict[str, str]:
    """Versions of the program, Python and all libraries in this process."""
    versions = all_versions()
    for name in _OPTIONAL:
        installed = version(name)
        if installed is not None:
            versions[name] = installed
    return versions


# In a process of a worker


def about_worker(files: Sequence[Path]) -> Any:
    """Its versions, and which mission files it cannot see."""
    return versions_here(), [str(file) for file in files if not file.is_file()]


def run_here(versions: Mapping[str, str], task: Callable[[], TaskEnd]) -> TaskEnd:
    """Run a task, if this worker, perhaps new, is like the others."""
    refuse_other_versions("one of the workers", versions, versions_here())
    return task()


def run_pickled(task: bytes) -> TaskEnd:
    """Run a pickled task; to unpickle it imports what it needs, which the worker does not."""
    end: TaskEnd = pickle.loads(task)()
    return end


# On a worker


class _Processes:
    """The processes of one command on this worker, and which of them are busy."""

    def __init__(self) -> None:
        self.busy: dict[MissionProcess, bool] = {}
        self.stopped = False

    def take(self, threads: int) -> MissionProcess:
        """A process that has nothing to do, or a new one."""
        free = [process for process, busy in self.busy.items() if not busy]
        process = free[0] if free else MissionProcess(max(1, usable_cpus() // threads))
        self.busy[process] = True
        return process


_COMMANDS: dict[str, _Processes] = {}
_LOCK = threading.Lock()


def run_apart(command: str, task: bytes, threads: int | None = None) -> TaskEnd:
    """On a worker of so many ``threads``: run a pickled task in a free process."""
    if threads is None:
        from distributed import get_worker

        threads = int(get_worker().state.nthreads)
    with _LOCK:
        processes = _COMMANDS.setdefault(command, _Processes())
        if processes.stopped:
            return Lost("the command was stopped")
        process = processes.take(threads)
    try:
        allow_processes()
        for _ in range(_ATTEMPTS):
            end = process.end(process.submit(partial(run_pickled, task)))
            if not isinstance(end, OutputInUseError):
                break
            time.sleep(0.5)
        return end
    finally:
        processes.busy[process] = False


def allow_processes() -> None:
    """Let this worker start processes.

    Dask's nanny starts workers as daemons, which may have none, so that none is left behind; those
    that it starts here end with it (`processes.end_with_parent`).
    """
    settings: Any = getattr(multiprocessing.current_process(), "_config", {})
    settings["daemon"] = False


async def run_beside(command: str, task: bytes, dask_worker: Any) -> TaskEnd:
    """On a worker: run a task now, whatever else it does."""
    run = partial(run_apart, command, task, int(dask_worker.state.nthreads))
    return await asyncio.get_running_loop().run_in_executor(None, run)


def stop_command(command: str) -> None:
    """On a worker: stop the processes of a command; none begins any more."""
    with _LOCK:
        processes = _COMMANDS.setdefault(command, _Processes())
        processes.stopped = True
        running = list(processes.busy)
        processes.busy = {}
    threading.Thread(target=stop_all, args=(running,), daemon=True).start()
