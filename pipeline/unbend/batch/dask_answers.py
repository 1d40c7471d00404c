"""What is asked of a Dask cluster within a time: a process that was stopped never answers.

A machine that swaps, a network that is cut, or SIGSTOP: the connection stays, and nothing comes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from unbend.batch.waiting import within

ANSWER_S = 60.0
"""How long a worker, or a scheduler, may take to answer a question that costs nothing."""


Client = Any  # of `distributed`, which has no types


def answers_of_workers(
    client: Client, workers: Sequence[str], seconds: float, question: Callable[[], Any]
) -> dict[str, Any]:
    """What a question returns on each worker, or its error; without those that do not answer."""
    answers: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    def ask(worker: str) -> None:
        try:
            answer = client.run(question, workers=[worker], on_error="return")[worker]
        except Exception as error:
            answer = error
        answers.put((worker, answer))

    for worker in workers:
        threading.Thread(target=ask, args=(worker,), daemon=True).start()
    limit = time.monotonic() + seconds
    answer_of_worker: dict[str, Any] = {}
    while len(answer_of_worker) < len(workers):
        try:
            worker, answer = answers.get(timeout=max(limit - time.monotonic(), 0.0))
        except Empty:
            break
        answer_of_worker[worker] = answer
    return answer_of_worker


def is_there() -> bool:
    """On a worker: the answer that it works."""
    return True


class ClusterState(NamedTuple):
    """The workers that answer, and the silent ones; the worker that has each task, by its key."""

    answering: tuple[str, ...]
    silent: tuple[str, ...]
    worker_of: dict[str, str]


def state_of_cluster(client: Client) -> ClusterState:
    """Which workers answer, and what each of them has; TimeoutError if the scheduler is silent."""
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
