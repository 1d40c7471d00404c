"""Blocks of rows on all cores that this process may use.

Threads are enough for that: compiled functions run without the lock of Python.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

from unbend.interrupts import held_back

BLOCK_ROWS = 8_192
"""Rows of a block: its columns fit into a core's cache together."""


def usable_cpus() -> int:
    """How many CPUs this process may use; taskset or a batch system may allow only some of them.

    The environment variable UNBEND_THREADS replaces that number, for processes that share CPUs.
    """
    if (threads := os.environ.get("UNBEND_THREADS", "")).isdecimal():
        return max(1, int(threads))
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """The pool of threads of this process, made at the first call."""
    return ThreadPoolExecutor(usable_cpus(), thread_name_prefix="rays")


if hasattr(os, "register_at_fork"):  # Windows has no fork
    # A child after a fork has none of its parent's threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def in_blocks(function: Callable[[slice], None], rows: int) -> None:
    """Call ``function`` with slices that together cover ``rows`` rows once.

    More than one block of `BLOCK_ROWS` rows is spread over the cores.
    """
    starts = range(0, rows, BLOCK_ROWS)
    blocks = [slice(start, min(start + BLOCK_ROWS, rows)) for start in starts]
    if len(blocks) <= 1:
        for block in blocks:
            function(block)
        return
    with held_back() as deliver_signals:
        futures = [_pool().submit(function, block) for block in blocks]
        try:
            for future in futures:
                future.result()
                deliver_signals()
        finally:  # after an error or a signal the blocks that have not begun are left out
            for future in futures:
                future.cancel()
