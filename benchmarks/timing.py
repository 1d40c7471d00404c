"""Two things timed by turns in the same run; the ratios and their bounds are printed as a table."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

ROUNDS = 7


def seconds(action: Callable[[], Any]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


@dataclass
class Ratios:
    """The ratios measured so far, each with its bound."""

    rows: list[tuple[str, str, str, str]] = field(default_factory=list)

    def check(
        self, what: str, ratio: float, *, at_least: float = 0.0, at_most: float = 0.0
    ) -> None:
        """Note a ratio and assert its bound: ``at_least`` or ``at_most``."""
        bound = f">= {at_least:g}" if at_least else f"<= {at_most:g}"
        holds = ratio >= at_least if at_least else ratio <= at_most
        self.rows.append((what, f"{ratio:.3g}", bound, "" if holds else "NOT HELD"))
        assert holds, f"{what}: {ratio:.3g}, but the bound is {bound}"

    def of_times(
        self,
        ours: Callable[[], Any],
        reference: Callable[[], Any],
        *,
        counts: tuple[int, int] = (1, 1),
        rounds: int = ROUNDS,
    ) -> float:
        """Median of the time of the reference divided by ours, both for one item.

        The two run by turns, so that other load of the machine falls on both, after one call each
        that is not timed. ``counts`` : items that a call of ours and of the reference works on.
        """
        ours()
        reference()
        times = [(seconds(ours), seconds(reference)) for _ in range(rounds)]
        own, other = counts
        return statistics.median((r / other) / (o / own) for o, r in times)
