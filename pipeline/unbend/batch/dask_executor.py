"""Missions on a Dask cluster: a task is one mission, which the worker runs in a process apart.

When a mission's process dies, that mission alone is lost. When a worker dies, other workers run
again the missions that it had under way.
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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

from unbend.batch import dask_answers, messages
from unbend.batch.dask_answers import Client, answers_of_workers, state_of_cluster
from unbend.batch.executors import Bug, Ends, Lost, Task, TaskEnd
from unbend.batch.fingerprint import all_versions, version
from unbend.batch.processes import MissionProcess, stop_all
from unbend.batch.waiting import within
from unbend.errors import OutputInUseError
from unbend.interrupts import held_back
from unbend.refraction.kernels.threads import usable_cpus

if TYPE_CHECKING:
    from unbend.config.campaign import MissionRef

_CONNECT_S = 10.0
"""How long a scheduler may take to answer, and to have its first worker."""

_LISTEN_PAUSE_S = 0.2
"""Between two tries to reach a scheduler that does not listen yet."""

_STOP_S = 4.0
"""How long an interrupted command waits until its missions are stopped."""

_CHECK_S = 180.0
"""How long a worker may take to report its versions: it imports the program first."""

_LEAVE_S = 5.0
"""How long a scheduler may take to notice that a worker with a broken connection has ended."""

_LEAVE_PAUSE_S = 0.2
"""Between two checks whether it has noticed."""

_LOOK_S = 30.0
"""If no mission ends for so long, it is checked whether the workers still answer."""

_SUBMISSIONS = 6
"""How often a mission is submitted if its workers die; each time Dask tries a few workers."""

_ATTEMPTS = 20
"""How often, twice a second, a mission is tried while another process has locked its folder."""

_OPTIONAL = ("dask", "distributed", "pycolmap", "obstore")
"""Libraries that no number depends on, but must be the same everywhere or nowhere."""


# In the command


class _Submitted(NamedTuple):
    """A mission submitted to Dask for the ``times``-th time; ``future`` is Dask's."""

    mission: MissionRef
    future: Any
    times: int


class DaskExecutor:
    """Executor that runs missions on a Dask scheduler's workers, by its address or JSON file."""

    def __init__(self, scheduler: str) -> None:
        self._scheduler = scheduler

    def run(self, tasks: Mapping[MissionRef, Task], *, alone: bool = False) -> Ends:
        """Run the missions; yield how each ended, as soon as it did. ``alone`` changes nothing.

        Refuses before any work a scheduler that does not answer or has no workers, and workers with
        other versions or without the mission files; SCHEDULER-LOST where the scheduler goes away.
        """
        # A signal raises an exception in the main thread. Inside the client it could leave one of
        # the client's locks taken. So another thread has the client, and the main thread waits for
        # a SimpleQueue, which has no lock in Python.
        ends: SimpleQueue[tuple[MissionRef, TaskEnd] | Exception] = SimpleQueue()
        ended_or_stop: SimpleQueue[Any] = SimpleQueue()  # futures that ended; None: to stop

        def serve() -> None:
            try:
                self._serve(tasks, ends, ended_or_stop)
            except (OSError, CancelledError) as error:
                text = str(error) or type(error).__name__
                ends.put(messages.scheduler_lost(address=self._scheduler, error=text))
            except Exception as error:
                ends.put(error)  # raised in the main thread, which reports it

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            for _ in tasks:
                end = ends.get()
                if isinstance(end, Exception):
                    raise end
                yield end
        finally:
            ended_or_stop.put(None)
            with held_back():  # a signal in `join` could leave the thread's own lock taken
                thread.join(_STOP_S)

    def _serve(
        self,
        tasks: Mapping[MissionRef, Task],
        ends: SimpleQueue[tuple[MissionRef, TaskEnd] | Exception],
        ended_or_stop: SimpleQueue[Any],
    ) -> None:
        """Submit all missions to the scheduler, and put how each ended into ``ends``.

        Returns when all have ended, or when None is put into ``ended_or_stop``, into which Dask
        puts the futures that ended. If its worker dies, a mission is submitted again, a few times.
        """
        try:
            import distributed
        except ImportError as error:
            raise messages.dask_missing(error=str(error)) from None
        command = uuid.uuid4().hex
        with connected(self._scheduler, command) as client:
            versions = versions_here()
            check_workers(client, command, versions, [mission.path for mission in tasks])
            handout = _Handout(
                client=client,
                make_task=lambda mission: pickle.dumps(partial(run_here, versions, tasks[mission])),
                command=command,
                ends=ends,
                ended_or_stop=ended_or_stop,
                worker_died=distributed.KilledWorker,
            )
            handout.serve(list(tasks))


@dataclass
class _Handout:
    """Submits the missions of a command to a scheduler, and collects how they end.

    make_task : returns the pickled task of a mission.
    command : identifier of the command, for the workers.
    ends : queue that gets how each mission ended.
    ended_or_stop : queue that gets each future that ended from Dask; None stops `serve`.
    worker_died : the class of the exception of a future if its workers died.
    waiting : the missions that have not ended, by the key of the future.
    """

    client: Any
    make_task: Callable[[MissionRef], bytes]
    command: str
    ends: SimpleQueue[tuple[MissionRef, TaskEnd] | Exception]
    ended_or_stop: SimpleQueue[Any]
    worker_died: type[Exception]
    waiting: dict[str, _Submitted] = field(default_factory=dict)

    def serve(self, missions: Sequence[MissionRef]) -> None:
        """Submit all missions, and wait until all have ended or None is in ``ended_or_stop``."""
        for mission in missions:
            self._submit(mission, times=1)
        while self.waiting:
            try:
                ended = self.ended_or_stop.get(timeout=_LOOK_S)
            except Empty:
                self._replace_lost()
                continue
            if ended is None:
                return
            if ended.key in self.waiting:  # else `_replace_lost` has cancelled it
                self._put_end(ended.key)

    def _submit(
        self, mission: MissionRef, times: int, workers: Sequence[str] | None = None
    ) -> None:
        """Submit a mission for the ``times``-th time, to one of ``workers``; None means any."""
        task = self.make_task(mission)
        future = self.client.submit(run_apart, self.command, task, pure=False, workers=workers)
        self.waiting[future.key] = _Submitted(mission, future, times)
        future.add_done_callback(self.ended_or_stop.put)

    def _put_end(self, key: str) -> None:
        """Put how a mission ended into ``ends``; if its worker died, submit it some more times."""
        mission, future, times = self.waiting.pop(key)
        try:
            self.ends.put((mission, future.result()))
        except self.worker_died as error:
            if times < _SUBMISSIONS:
                self._submit(mission, times + 1)
            else:
                self.ends.put((mission, Lost(str(error))))

    def _replace_lost(self) -> None:
        """Submit the missions of silent workers to other workers, or let them end as refused."""
        for lost in lost_tasks(self.client, list(self.waiting)):
            mission, future, times = self.waiting.pop(lost.key)
            future.cancel()
            if lost.other_workers and times < _SUBMISSIONS:
                self._submit(mission, times + 1, lost.other_workers)
            else:
                path = str(mission.path)
                self.ends.put((mission, messages.no_answer(path=path, how=lost.how)))


class _LostTask(NamedTuple):
    """A task with a silent worker: its key, a description, and the workers that answer."""

    key: str
    how: str
    other_workers: tuple[str, ...]


def lost_tasks(client: Client, keys: Iterable[str]) -> list[_LostTask]:
    """The tasks among ``keys`` with a worker that does not answer, or without any worker left."""
    state = state_of_cluster(client)
    lost = []
    for key in keys:
        worker = state.worker_of.get(key)
        if worker in state.silent:
            how = f"its worker {worker} has not answered for {dask_answers.ANSWER_S:.0f} s"
            lost.append(_LostTask(key, how, state.answering))
        elif worker is None and not state.answering:
            how = "no worker of the scheduler answers any more"
            lost.append(_LostTask(key, how, ()))
    return lost


def scheduler_address(scheduler: str) -> str:
    """The address of a scheduler, itself or from its JSON file; refuses others (SCHEDULER-FILE)."""
    if "://" in scheduler:
        return scheduler
    if Path(scheduler).exists() and not Path(scheduler).is_file():  # reading might never end
        raise messages.scheduler_file_invalid(path=scheduler, error="it is not a file")
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise messages.scheduler_file_invalid(path=scheduler, error=str(error)) from None


def refuse_missing(scheduler: str) -> None:
    """Refuse (SCHEDULER-NONE) an address where no scheduler begins to listen within 10 s.

    Addresses other than tcp and tls are not tried, and not refused here.
    """
    address = scheduler_address(scheduler)
    deadline = time.monotonic() + _CONNECT_S
    with connection_errors(address):
        url = urlsplit(address)
        if url.scheme not in ("tcp", "tls"):
            return
        while True:
            try:
                socket.create_connection((url.hostname, url.port), _CONNECT_S).close()
                return
            except ConnectionRefusedError:  # nothing listens yet
                if time.monotonic() > deadline:
                    raise
            time.sleep(_LISTEN_PAUSE_S)


@contextmanager
def connection_errors(address: str) -> Iterator[None]:
    """Context that turns errors of connecting to an address into a refusal (SCHEDULER-NONE)."""
    try:
        yield
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise messages.no_scheduler(address=address, error=str(error)) from None


@contextmanager
def connected(scheduler: str, command: str) -> Iterator[Any]:
    """Context with a Dask client that is connected to a scheduler.

    At its end all processes that the ``command`` has on the workers are stopped. Refuses
    (SCHEDULER-NONE) an address where no scheduler answers.
    """
    from distributed import Client
    from distributed.comm import resolve_address

    address = scheduler_address(scheduler)
    for name in list(logging.root.manager.loggerDict):
        if name.startswith("distributed"):  # each has its own level, so each is silenced
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with connection_errors(address):
        resolve_address(address)  # fails at once for an unknown scheme, which a client would retry
        client = Client(address, timeout=_CONNECT_S, set_as_default=False, direct_to_workers=False)
    try:
        with suppress(TimeoutError):  # `check_workers` refuses a scheduler without workers
            client.wait_for_workers(1, timeout=_CONNECT_S)
        yield client
    finally:
        with suppress(Exception):  # the scheduler may be gone
            workers = list(within(_STOP_S, client.nthreads))
            answers_of_workers(client, workers, _STOP_S, partial(stop_command, command))
        with suppress(Exception):
            within(2.0 * _STOP_S, partial(client.close, timeout=_STOP_S))


def check_workers(
    client: Any, command: str, versions: Mapping[str, str], files: list[Path]
) -> None:
    """Refuse workers that would give other results than this process, and a lack of workers.

    Refused are workers with other versions, or that cannot run the program (WORKER-VERSION), that
    cannot see one of the mission ``files`` (WORKER-FILES), or that do not answer
    (SCHEDULER-WORKERS). Workers that end during the check are ignored. ``versions`` are those of
    this process.
    """
    task = pickle.dumps(partial(about_worker, files))
    workers = sorted(within(_CHECK_S, client.nthreads))
    if not workers:
        raise messages.no_workers(address=client.scheduler_info()["address"])
    reports = reports_of_workers(client, workers, partial(run_beside, command, task))
    if not reports:
        raise messages.no_workers(address=client.scheduler_info()["address"])
    for worker, report in sorted(reports.items()):
        if not isinstance(report, tuple):  # a Bug or an error; the last line says why
            text = report.traceback if isinstance(report, Bug) else str(report)
            raise messages.worker_unable(worker=worker, error=text.strip().split("\n")[-1])
        versions_there, missing_files = report
        refuse_other_versions(worker, versions, versions_there)
        if missing_files:
            first = missing_files[0]
            raise messages.files_not_seen(worker=worker, first=first, count=len(missing_files))


def reports_of_workers(
    client: Client, workers: Sequence[str], function: Callable[[], Any]
) -> dict[str, Any]:
    """Call a function on each worker; returns its result, or its exception, by worker.

    Workers that end meanwhile are left out. Refuses (SCHEDULER-WORKERS) a worker that stays
    registered and does not answer.
    """
    reports = answers_of_workers(client, workers, _CHECK_S, function)
    for worker in workers:
        is_silent = worker not in reports
        has_no_answer = is_silent or isinstance(reports[worker], OSError)
        if has_no_answer and has_left(client, worker):
            reports.pop(worker, None)
        elif is_silent:
            raise messages.worker_silent(worker=worker, seconds=_CHECK_S)
    return reports


def has_left(client: Client, worker: str) -> bool:
    """Whether a worker is no longer registered at the scheduler; waits `_LEAVE_S` for that."""
    deadline = time.monotonic() + _LEAVE_S
    while worker in within(_CHECK_S, client.nthreads):
        if time.monotonic() > deadline:
            return False
        time.sleep(_LEAVE_PAUSE_S)
    return True


def refuse_other_versions(
    worker: str, versions: Mapping[str, str], versions_there: Mapping[str, str]
) -> None:
    """Refuse (WORKER-VERSION) a worker with other ``versions_there`` than the command's."""
    differences = []
    for name in sorted(versions.keys() | versions_there.keys()):
        there = versions_there.get(name, "missing")
        here = versions.get(name, "missing")
        if there != here:
            differences.append(f"{name} {there} (here {here})")
    if differences:
        raise messages.other_versions(worker=worker, other=differences)


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
    """The versions in this process, and those of ``files`` that it cannot see."""
    return versions_here(), [str(file) for file in files if not file.is_file()]


def run_here(versions: Mapping[str, str], task: Callable[[], TaskEnd]) -> TaskEnd:
    """Run a task if this process has the same versions as the command.

    Refuses (WORKER-VERSION) other versions: the worker may have connected after `check_workers`.
    """
    refuse_other_versions("one of the workers", versions, versions_here())
    return task()


def run_pickled(task: bytes) -> TaskEnd:
    """Run a pickled task. Unpickling it imports its modules in this process, not in the worker."""
    end: TaskEnd = pickle.loads(task)()
    return end


# On a worker


class _Processes:
    """The processes of one command on this worker, and whether each is ``busy``.

    ``stopped`` : the command has ended, and no process may be started any more.
    """

    def __init__(self) -> None:
        self.busy: dict[MissionProcess, bool] = {}
        self.stopped = False

    def take(self, threads: int) -> MissionProcess:
        """Mark a free process, or a new one, as busy, and return it.

        ``threads`` is the number of threads of the worker, which share its CPUs. The caller has
        locked `_LOCK`.
        """
        free = [process for process, busy in self.busy.items() if not busy]
        process = free[0] if free else MissionProcess(max(1, usable_cpus() // threads))
        self.busy[process] = True
        return process


_COMMANDS: dict[str, _Processes] = {}
_LOCK = threading.Lock()
"""Locked while `_COMMANDS` or the processes of a command are looked up or changed."""


def run_apart(command: str, task: bytes, threads: int | None = None) -> TaskEnd:
    """On a worker: run a pickled task in a free process, and return how it ended.

    ``threads`` is the number of threads of the worker, which run tasks at the same time; None asks
    Dask, which works only in these threads.
    """
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
            end = process.wait_for_end(process.submit(partial(run_pickled, task)))
            if not isinstance(end, OutputInUseError):
                break
            # The process of a worker that died may still have locked the folder; it ends soon.
            time.sleep(0.5)
        return end
    finally:
        processes.busy[process] = False


def allow_processes() -> None:
    """Let this worker start processes.

    Dask's nanny starts workers as daemons, and Python forbids daemons to start processes, which
    might stay behind. The processes started here do not: they end with the worker
    (`processes.end_with_parent`).
    """
    settings: Any = getattr(multiprocessing.current_process(), "_config", {})
    settings["daemon"] = False


async def run_beside(command: str, task: bytes, dask_worker: Any) -> TaskEnd:
    """On a worker, which Dask passes: run a pickled task at once, even if all threads are busy."""
    run = partial(run_apart, command, task, int(dask_worker.state.nthreads))
    return await asyncio.get_running_loop().run_in_executor(None, run)


def stop_command(command: str) -> None:
    """On a worker: stop the processes of a command; no later task of it starts one."""
    with _LOCK:
        processes = _COMMANDS.setdefault(command, _Processes())
        processes.stopped = True
        running = list(processes.busy)
        processes.busy = {}
    threading.Thread(target=stop_all, args=(running,), daemon=True).start()
