"""Missions on a Dask cluster: a task is one mission, which the worker runs apart.

The death of a mission's process costs that mission, the death of a worker its missions under way,
which others run again. A large mission is made by other workers too, after all missions.
"""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlsplit

from unbend.batch.executors import (
    Bug,
    Child,
    Ends,
    Lost,
    Task,
    TaskEnd,
    Worker,
    run_pickled,
    stop_all,
)
from unbend.batch.keys import version, versions
from unbend.errors import ConfigError, MissionError, OutputInUseError
from unbend.interrupts import held_back
from unbend.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef

_CONNECT_S = 10.0
"""How long a scheduler may take to answer, and to have its first worker."""

_ASK_S = 2.0
"""How often it is asked whether the worker of a task is still there."""

_STOP_S = 4.0
"""How long an interrupted command waits until its missions are stopped."""

_SUBMISSIONS = 6
"""How often a mission is handed out whose workers die; each time Dask tries a few of them."""

_ATTEMPTS = 20
"""How often, twice a second, a mission is tried whose folder another process still holds."""

_SHARED_PARTS = 20, 400
"""Parts of a mission that is worth a client of its own, where threads are idle, and else."""

_OPTIONAL = ("dask", "distributed", "pycolmap", "obstore")
"""Libraries that no number depends on, but must be the same everywhere or nowhere."""

_CHILDREN: dict[str, dict[Child, bool]] = {}
"""On a worker: the processes of each command, and whether they are busy."""

_LOCK = threading.Lock()
_STOPPED: set[str] = set()


class Cluster:
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
        events: SimpleQueue[Any] = SimpleQueue()

        def serve() -> None:
            try:
                self._serve(tasks, ends, events)
            except (OSError, CancelledError) as error:
                text = str(error) or type(error).__name__
                ends.put(MissionError.of("SCHEDULER-LOST", self._scheduler, error=text))
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
            events.put(None)
            with held_back():
                thread.join(_STOP_S)

    def _serve(self, tasks: Mapping[MissionRef, Task], ends: Any, events: Any) -> None:
        """Hand all missions to the workers, and pass on how they ended, until None is an event."""
        try:
            import distributed
        except ImportError as error:
            raise ConfigError.of("SCHEDULER-EXTRA", "--scheduler", error=error) from None
        own = versions_here()
        command = uuid.uuid4().hex
        with connected(self._scheduler, command) as client:
            check_workers(client, command, own, [mission.path for mission in tasks])
            waiting: dict[str, tuple[MissionRef, Any, int]] = {}
            address, threads = client.scheduler_info()["address"], sum(client.nthreads().values())
            fewest = _SHARED_PARTS[len(tasks) >= threads]
            helpers = ClusterHelpers(address, command, own, fewest)

            def submit(mission: MissionRef, times: int) -> None:
                run = partial(tasks[mission], helpers=helpers)
                task = pickle.dumps(partial(run_here, own, run))
                future = client.submit(run_apart, command, task, pure=False)
                waiting[future.key] = mission, future, times
                future.add_done_callback(events.put)

            for mission in tasks:
                submit(mission, 1)
            while waiting and (done := events.get()) is not None:
                mission, future, times = waiting.pop(done.key)
                try:
                    ends.put((mission, future.result()))
                except distributed.KilledWorker as error:
                    if times < _SUBMISSIONS:
                        submit(mission, times + 1)
                    else:
                        ends.put((mission, Lost(str(error))))


@dataclass(frozen=True)
class ClusterHelpers:
    """The workers of a mission's scheduler, of ``versions``, if it has ``fewest`` parts or more."""

    scheduler: str
    command: str
    versions: Mapping[str, str]
    fewest: int

    @contextmanager
    def workers(self, module: str, parts: int) -> Iterator[list[Worker]]:
        """One for each thread of the workers; none where the scheduler has gone."""
        client: Any = None
        if parts >= self.fewest:
            with suppress(ConfigError, ImportError):
                client = client_of(self.scheduler)
        if client is None:
            yield []
            return
        try:
            threads = [worker for worker, count in client.nthreads().items() for _ in range(count)]
            yield [partial(self.run, client, worker) for worker in threads[: parts // 4]]
        finally:
            with suppress(Exception):  # where the scheduler has gone there is nobody to tell
                client.close(timeout=_STOP_S)

    def run(self, client: Any, worker: str, task: bytes) -> TaskEnd:
        """Run a task on a worker when it has nothing else to do, and wait for the end of either."""
        here = pickle.dumps(partial(run_here, self.versions, partial(run_pickled, task)))
        # Tied to a worker: Dask would else repeat it elsewhere, behind the mission that waits.
        options = {"pure": False, "priority": -1, "workers": [worker]}
        sent = client.submit(run_apart, self.command, here, **options)
        while True:
            with suppress(TimeoutError):
                return cast(TaskEnd, sent.result(timeout=_ASK_S))
            if worker not in client.nthreads():
                return Lost("its worker has gone")


def scheduler_address(scheduler: str) -> str:
    """The address itself, or that in a scheduler's file; else refused (SCHEDULER-FILE)."""
    if "://" in scheduler:
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError.of("SCHEDULER-FILE", scheduler, error=error) from None


def refuse_missing(scheduler: str) -> None:
    """Refuse (SCHEDULER-NONE) a scheduler at whose address nobody begins to listen."""
    address = scheduler_address(scheduler)
    limit = time.monotonic() + _CONNECT_S
    with not_there(address):
        while (url := urlsplit(address)).scheme in ("tcp", "tls"):
            try:
                socket.create_connection((url.hostname, url.port), _CONNECT_S).close()
                break
            except ConnectionRefusedError:
                if time.monotonic() > limit:
                    raise
            time.sleep(0.2)


@contextmanager
def not_there(address: str) -> Iterator[None]:
    """Raise what is said of an address where no scheduler is as a refusal."""
    try:
        yield
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise ConfigError.of("SCHEDULER-NONE", address, error=error) from None


def client_of(address: str) -> Any:
    """A client of a scheduler that is there."""
    from distributed import Client
    from distributed.comm import resolve_address

    for name in [name for name in logging.root.manager.loggerDict if name[:11] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # each has a level of its own
    with not_there(address):
        resolve_address(address)  # a client of another scheme would try it for long, unasked
        return Client(address, timeout=_CONNECT_S, set_as_default=False, direct_to_workers=False)


@contextmanager
def connected(scheduler: str, command: str) -> Iterator[Any]:
    """A client of a scheduler that is there; at the end what the command runs is stopped."""
    client = client_of(scheduler_address(scheduler))
    try:
        with suppress(TimeoutError):
            client.wait_for_workers(1, timeout=_CONNECT_S)
        yield client
    finally:
        with suppress(Exception):  # where the scheduler has gone there is nobody to tell
            client.run(stop_children, command)
            client.close(timeout=_STOP_S)


def check_workers(client: Any, command: str, own: Mapping[str, str], files: list[Path]) -> None:
    """Refuse (WORKER-VERSION, WORKER-FILES) workers that would not do what this process does."""
    question = pickle.dumps(partial(about_worker, files))
    reports = client.run(run_beside, command, question, on_error="return")
    if not reports:
        raise ConfigError.of("SCHEDULER-WORKERS", client.scheduler_info()["address"])
    for worker, report in sorted(reports.items()):
        if not isinstance(report, tuple):
            what = report.traceback if isinstance(report, Bug) else str(report)
            raise ConfigError.of("WORKER-VERSION/none", worker, error=what.strip().split("\n")[-1])
        theirs, missing = report
        refuse_other_versions(worker, own, theirs)
        if missing:
            raise ConfigError.of("WORKER-FILES", worker, file=missing[0], count=len(missing))


def refuse_other_versions(worker: str, own: Mapping[str, str], theirs: Mapping[str, str]) -> None:
    other = [
        f"{name} {theirs.get(name, 'missing')} (here {own.get(name, 'missing')})"
        for name in sorted(own.keys() | theirs.keys())
        if own.get(name) != theirs.get(name)
    ]
    if other:
        raise ConfigError.of("WORKER-VERSION", worker, other=", ".join(other))


def versions_here() -> dict[str, str]:
    """Versions of the program, Python and all libraries in this process."""
    found = versions() | {name: version(name) for name in _OPTIONAL}
    return {name: str(known) for name, known in found.items() if known is not None}


def about_worker(files: list[Path]) -> Any:
    """In a worker's process: its versions, and which mission files it cannot see."""
    return versions_here(), [str(file) for file in files if not file.is_file()]


def run_here(versions: Mapping[str, str], task: Callable[..., TaskEnd]) -> TaskEnd:
    """In a worker's process: run a task, if this worker, perhaps new, is like the others."""
    refuse_other_versions("one of the workers", versions, versions_here())
    return task()


def run_apart(command: str, task: bytes, threads: int | None = None) -> TaskEnd:
    """On a worker of so many ``threads``: run a pickled task in a free process."""
    if threads is None:
        from distributed import get_worker

        threads = int(get_worker().state.nthreads)
    with _LOCK:
        if command in _STOPPED:
            return Lost("the command was stopped")
        children = _CHILDREN.setdefault(command, {})
        free = [child for child, busy in children.items() if not busy]
        child = free[0] if free else Child(max(1, usable_cpus() // threads))
        children[child] = True
    try:
        for _ in range(_ATTEMPTS):
            end = child.run(task)
            if not isinstance(end, OutputInUseError):
                break
            time.sleep(0.5)
        return end
    finally:
        children[child] = False


async def run_beside(command: str, task: bytes, dask_worker: Any) -> TaskEnd:
    """On a worker: run a task now, whatever else it does."""
    run = partial(run_apart, command, task, int(dask_worker.state.nthreads))
    return await asyncio.get_running_loop().run_in_executor(None, run)


def stop_children(command: str) -> None:
    """On a worker: stop the processes of a command."""
    with _LOCK:
        _STOPPED.add(command)
        children = list(_CHILDREN.pop(command, ()))
    threading.Thread(target=stop_all, args=(children,), daemon=True).start()
