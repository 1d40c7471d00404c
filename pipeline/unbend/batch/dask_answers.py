"""Questions to a Dask cluster with a time limit, because a process that was stopped never answers.

On a machine that swaps, in a network that is cut, or after SIGSTOP the connection stays open, and
no answer comes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from unbend.batch.waiting import within

ANSWER_S = 60.0
"""How long a worker or a scheduler may take for an answer that needs no work."""


Client = Any  # of `distributed`, which has no types


def answers_of_workers(
    client: Client, workers: Sequence[str], seconds: float, function: Callable[[], Any]
) -> dict[str, Any]:
    """Call a function on each worker; returns its result, or its exception, by worker.

    ``workers`` are addresses. A worker that does not answer within ``seconds`` is left out.
    """
    answers: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    def ask(worker: str) -> None:
        try:
            answer = client.run(function, workers=[worker], on_error="return")[worker]
        except Exception as error:
            answer = error
        answers.put((worker, answer))

    for worker in workers:
        threading.Thread(target=ask, args=(worker,), daemon=True).start()
    deadline = time.monotonic() + seconds
    answer_of_worker: dict[str, Any] = {}
    while len(answer_of_worker) < len(workers):
        try:
            worker, answer = answers.get(timeout=max(deadline - time.monotonic(), 0.0))
        except Empty:
            break
        answer_of_worker[worker] = answer
    return answer_of_worker


def is_there() -> bool:
    """Called on a worker: returns True, which shows that the worker answers."""
    return True


class ClusterState(NamedTuple):
    """The addresses of the workers that answer and of the silent ones, and the worker of each task.

    ``worker_of`` has the address of the worker by the key of the task.
    """

    answering: tuple[str, ...]
    silent: tuple[str, ...]
    worker_of: dict[str, str]


def state_of_cluster(client: Client) -> ClusterState:
    """Which workers answer, and which tasks each has; TimeoutError if the scheduler is silent."""
    workers = sorted(within(ANSWER_S, client.nthreads))
    processing = within(ANSWER_S, client.processing)
    answers = answers_of_workers(client, workers, ANSWER_S, is_there)
    worker_of = {}
    for worker, keys in processing.items():
        for key in keys:
            worker_of[str(key)] = worker
    return ClusterState(
        answering=tuple(worker for worker in workers if answers.get(worker) is True),
        silent=tuple(worker for worker in workers if worker not in answers),
        worker_of=worker_of,
    )
