"""Two things timed by turns, so that whatever else the machine does falls on both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import pytest

PAIRS = 7


class Pair:
    """Times one thing beside another and keeps the median ratio of seven pairs."""

    def __init__(self, benchmark: Any, write: Callable[[str], None]) -> None:
        self.benchmark, self.write = benchmark, write

    def __call__(
        self,
        ours: Callable[[], Any],
        theirs: Callable[[], Any],
        ours_count: int = 1,
        theirs_count: int = 1,
    ) -> float:
        """Median of their time for one item divided by ours."""
        their_times: list[float] = []

        def before() -> None:
            start = time.perf_counter()
            theirs()
            their_times.append((time.perf_counter() - start) / theirs_count)

        self.benchmark.pedantic(ours, setup=before, rounds=PAIRS, warmup_rounds=1)
        our_times = [t / ours_count for t in self.benchmark.stats.stats.data]
        ratio = statistics.median(
            their / our for their, our in zip(their_times[-PAIRS:], our_times, strict=True)
        )
        self.benchmark.extra_info["ratio"] = ratio
        self.write(
            f"{1e-6 / statistics.median(our_times):.3g} M/s beside "
            f"{1e-6 / statistics.median(their_times):.3g} M/s: {ratio:.3g} times as fast"
        )
        return ratio


@pytest.fixture
def pair(benchmark: Any, request: pytest.FixtureRequest) -> Pair:
    terminal = request.config.pluginmanager.getplugin("terminalreporter")
    return Pair(benchmark, lambda text: terminal.write_line(f"\n{request.node.name}: {text}"))
