"""Two things timed by turns in the same run; the ratios and their bounds are printed as a table."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

ROUNDS = 7


def seconds(action: Callable[[], Any]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def rate(action: Callable[[], int]) -> float:
    """Items a second of a call that returns how many it has worked on."""
    start = time.perf_counter()
    items = action()
    return items / (time.perf_counter() - start)


@dataclass
class Rates:
    """Items a second of a library and of ours, by turns (pairs,)."""

    library: np.ndarray
    ours: np.ndarray

    @classmethod
    def by_turns(
        cls,
        library: Callable[[], int],
        ours: Callable[[], int],
        pairs: int,
    ) -> Rates:
        """Measure them; each call returns on how many items it has worked."""
        pairs_of_rates = [(rate(library), rate(ours)) for _ in range(pairs)]
        return cls(*np.transpose(pairs_of_rates))

    def ratio(self, library: str) -> str:
        """How many times as fast as the library."""
        ratios = self.ours / self.library
        spread = f"median of {ratios.size} pairs, {ratios.min():.1f} to {ratios.max():.1f}"
        return f"{np.median(ratios):.1f}x {library} ({spread})"

    def medians(self, unit: float) -> tuple[float, float]:
        """Of the library and of ours, in so many items a second."""
        return float(np.median(self.library)) / unit, float(np.median(self.ours)) / unit


@dataclass
class Ratios:
    """The ratios measured so far, each with its bound."""

    rows: list[tuple[str, str, str, str]] = field(default_factory=list)

    def check(
        self,
        what: str,
        ratio: float,
        *,
        at_least: float = 0.0,
        at_most: float = math.inf,
    ):
        """Note a ratio and assert its bound: ``at_least`` or ``at_most``."""
        assert at_least > 0.0 or at_most < math.inf, f"{what}: no bound is stated"
        bound = f"<= {at_most:g}"
        if at_least:
            bound = f">= {at_least:g}"
        fulfilled = at_least <= ratio <= at_most
        remark = ""
        if not fulfilled:
            remark = "NOT HELD"
        self.rows.append((what, f"{ratio:.3g}", bound, remark))
        assert fulfilled, f"{what}: {ratio:.3g}, but the bound is {bound}"

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
        our_count, reference_count = counts
        ratios = []
        for _ in range(rounds):
            our_s = seconds(ours) / our_count
            reference_s = seconds(reference) / reference_count
            ratios.append(reference_s / our_s)
        return statistics.median(ratios)
