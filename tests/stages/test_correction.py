"""Batches side by side: in their order, and never more of them in memory than is said."""

from __future__ import annotations

import os
import threading

import pytest

from unbend.refraction.kernels import threads as kernel_threads
from unbend.stages import correction as correct


class Counter:
    """Counts the batches that were read and are not done, and those at work.

    The first ``workers`` batches wait for each other, and until one more was read: so all threads
    are seen at work, however slow the machine is.
    """

    def __init__(self, workers: int = 1) -> None:
        self.lock = threading.Lock()
        self.workers = workers
        self.together = threading.Barrier(workers)
        self.one_more_read = threading.Event()
        self.held = self.at_work = self.most_held = self.most_at_work = 0

    def batches(self, count: int):
        for number in range(count):
            with self.lock:
                self.held += 1
                self.most_held = max(self.most_held, self.held)
            if number == self.workers:
                self.one_more_read.set()
            yield number

    def work(self, number: int, batch: int) -> int:
        assert number == batch
        with self.lock:
            self.at_work += 1
            self.most_at_work = max(self.most_at_work, self.at_work)
        if number < self.workers:
            self.together.wait()
            self.one_more_read.wait()
        with self.lock:
            self.at_work -= 1
            self.held -= 1
        return number


@pytest.mark.parametrize(
    ("cpus", "memory_gb", "threads"),
    [(1, 64, 1), (3, 64, 3), (64, 64, 45), (64, 8, 5), (8, 0.5, 1)],
)
def test_batches_in_flight_are_as_many_as_cpus_and_memory(monkeypatch, cpus, memory_gb, threads):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cpus)), raising=False)
    pages = {"SC_PHYS_PAGES": int(memory_gb * (1 << 30)) // 4096, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr(os, "sysconf", pages.__getitem__)
    assert correct.threads_for(250_000) == threads


@pytest.mark.parametrize("threads", [1, 3])
def test_no_more_batches_are_held_than_threads_and_one(threads):
    counter = Counter(threads)
    made = correct.on_threads(counter.work, counter.batches(40), threads=threads)
    assert list(made) == list(range(40))
    assert counter.most_at_work == threads
    assert counter.most_held == threads + 1
    assert counter.held == 0


def test_a_batch_that_fails_stops_the_others():
    counter = Counter()

    def broken(number: int, batch: int) -> int:
        if number == 3:
            raise KeyError(number)
        return counter.work(number, batch)

    with pytest.raises(KeyError):
        list(correct.on_threads(broken, counter.batches(1000), threads=4))
    assert counter.held < 10


def test_cpus_are_those_this_process_may_use(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 256)
    if hasattr(os, "sched_getaffinity"):
        assert kernel_threads.usable_cpus() == len(os.sched_getaffinity(0))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 7}, raising=False)
    assert kernel_threads.usable_cpus() == 2
    used = set()
    together = threading.Barrier(2, timeout=60.0)

    def block(_: slice) -> None:
        together.wait()  # none ends before the other has begun
        used.add(threading.get_ident())

    kernel_threads._pool.cache_clear()
    try:
        kernel_threads.in_blocks(block, 6 * kernel_threads.BLOCK_ROWS)
        assert len(used) == 2
    finally:
        kernel_threads._pool().shutdown()
        kernel_threads._pool.cache_clear()
    # Where the system has no affinity: all there are.
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert kernel_threads.usable_cpus() == 256
