"""Batches side by side: in their order, and never more of them in memory than is said."""

import os
import threading

import pytest

from unbend.refraction.kernels.threads import BLOCK_ROWS, in_blocks, usable_cpus
from unbend.stages.correction import on_threads, threads_for


class Counter:
    """Counts the batches that were read and are not done, and those at work.

    The first ``workers`` batches wait for each other, and until one more was read: so all threads
    are seen at work, however slow the machine is.
    """

    def __init__(self, workers=1):
        self.lock = threading.Lock()
        self.workers = workers
        self.together = threading.Barrier(workers)
        self.one_more_read = threading.Event()
        self.held = self.at_work = self.most_held = self.most_at_work = 0

    def batches(self, count):
        for number in range(count):
            with self.lock:
                self.held += 1
                self.most_held = max(self.most_held, self.held)
            if number == self.workers:
                self.one_more_read.set()
            yield number

    def work(self, number, batch):
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
    monkeypatch.setenv("UNBEND_THREADS", str(cpus))
    page_bytes = 4096
    pages = int(memory_gb * 2**30) // page_bytes
    memory = {"SC_PHYS_PAGES": pages, "SC_PAGE_SIZE": page_bytes}
    monkeypatch.setattr(os, "sysconf", memory.__getitem__)
    assert threads_for(250_000) == threads


@pytest.mark.parametrize("threads", [1, 3])
def test_no_more_batches_are_held_than_threads_and_one(threads):
    counter = Counter(threads)
    made = on_threads(counter.work, counter.batches(40), threads=threads)
    assert list(made) == list(range(40))
    assert counter.most_at_work == threads
    assert counter.most_held == threads + 1
    assert counter.held == 0


def test_a_batch_that_fails_stops_the_others():
    counter = Counter()

    def broken(number, batch):
        if number == 3:
            raise KeyError(number)
        return counter.work(number, batch)

    with pytest.raises(KeyError):
        list(on_threads(broken, counter.batches(1000), threads=4))
    assert counter.held < 10


@pytest.mark.parametrize(
    ("setting", "affinity", "cpus"),
    [
        ("", {5, 7}, 2),
        ("", None, 256),  # where the system has no affinity: all there are
        ("3", {5, 7}, 3),
        ("0", {5, 7}, 1),
        ("many", {5, 7}, 2),
    ],
)
def test_cpus_are_those_this_process_may_use(monkeypatch, setting, affinity, cpus):
    monkeypatch.setenv("UNBEND_THREADS", setting)
    monkeypatch.setattr(os, "cpu_count", lambda: 256)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: affinity, raising=False)
    if affinity is None:
        monkeypatch.delattr(os, "sched_getaffinity")
    assert usable_cpus() == cpus


def test_blocks_are_on_all_cpus_of_this_process():
    together = threading.Barrier(usable_cpus(), timeout=60.0)
    threads = set()

    def block(_):
        together.wait()  # none ends before the others have begun
        threads.add(threading.get_ident())

    in_blocks(block, 6 * usable_cpus() * BLOCK_ROWS)
    assert len(threads) == usable_cpus()
