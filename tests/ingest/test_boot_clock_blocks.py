"""Offsets without their glitches are the same in however many blocks they are looked at."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest import boot_clock as boots

SECOND = 10**9
BLOCK = 7


def plainly(offset: np.ndarray) -> np.ndarray:
    """The median of `STRAY_ROWS` rows on either side, row by row; rows beyond the ends mirrored."""
    n = offset.size
    half = min(STRAY_ROWS, offset.size - 1)
    if half < 1:
        return offset
    rows = np.abs(np.arange(n)[:, None] + np.arange(-half, half + 1))
    rows = np.where(rows >= n, 2 * (n - 1) - rows, rows)
    return np.asarray(np.sort(offset[rows], axis=1)[:, half])


def offsets(count: int, rng: np.random.Generator) -> np.ndarray:
    """Offsets with jitter, a step that stays, and glitches over borders of blocks."""
    found = 1_700_000_000 * SECOND + rng.integers(-(10**6), 10**6, count)
    found[count // 2 :] += 90 * SECOND
    for border in range(BLOCK, count, 3 * BLOCK):
        first = max(border - int(rng.integers(1, STRAY_ROWS + 1)), 0)
        found[first : first + STRAY_ROWS] += int(rng.choice([-1, 1])) * 3600 * SECOND
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 5, 6, 7, 8, 13, 14, 15, 70, 71, 500])
def test_blocks_are_one(monkeypatch, count):
    offset = offsets(count, np.random.default_rng(count))
    given = offset.copy()
    whole = boots.without_glitches(offset)
    monkeypatch.setattr(boots, "_BLOCK", BLOCK)
    replace_in_blocks = boots.without_glitches(offset)
    np.testing.assert_array_equal(replace_in_blocks, whole)
    np.testing.assert_array_equal(replace_in_blocks, plainly(given))
    np.testing.assert_array_equal(offset, given)


def test_glitches_over_borders_are_gone_and_the_step_stays(monkeypatch):
    monkeypatch.setattr(boots, "_BLOCK", BLOCK)
    steady = boots.without_glitches(offsets(500, np.random.default_rng(1)))
    steps = np.flatnonzero(np.abs(np.diff(steady)) > SECOND)
    assert steps.size == 1
    assert abs(int(steps[0]) - 249) <= STRAY_ROWS
    assert np.ptp(steady[: steps[0] + 1]) < 2 * 10**6 > np.ptp(steady[steps[0] + 1 :])
