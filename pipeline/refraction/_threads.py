"""Blocks of rows on all cores. The compiled functions hold no lock, so threads are enough."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

BLOCK_ROWS = 8_192
"""Rows of a block: its columns fit into a core's cache together."""


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """One pool for the process."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="rays")


# A child after a fork has none of its parent's threads.
os.register_at_fork(after_in_child=_pool.cache_clear)


def in_blocks(function: Callable[[slice], None], rows: int) -> None:
    """Call ``function`` with slices that cover all rows once, on all cores where it pays."""
    blocks = [slice(start, min(start + BLOCK_ROWS, rows)) for start in range(0, rows, BLOCK_ROWS)]
    if len(blocks) <= 1:
        for block in blocks:
            function(block)
        return
    for done in [_pool().submit(function, block) for block in blocks]:
        done.result()
