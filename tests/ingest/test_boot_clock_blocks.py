"""Offsets without their glitches are the same in however many blocks they are looked at."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from unbend.flight.clock import STRAY_ROWS
from unbend.ingest.boot_clock import without_glitches

SECOND = 10**9
BLOCK = 65_536  # rows looked at at once


def plainly(offset):
    """The median of `STRAY_ROWS` rows on either side, row by row; rows beyond the ends mirrored."""
    half = min(STRAY_ROWS, offset.size - 1)
    mirrored = np.pad(
        offset,
        half,
        mode="reflect",
    )
    windows = np.lib.stride_tricks.sliding_window_view(
        mirrored,
        2 * half + 1,
    )
    return np.sort(windows, axis=1)[:, half]


def offsets(count, borders):
    """Offsets with jitter, a step in the middle that stays, and glitches over borders of blocks."""
    rng = np.random.default_rng(count)
    values = 1_700_000_000 * SECOND + rng.integers(-(10**6), 10**6, count)
    values[count // 2 :] += 90 * SECOND
    for border in borders:
        first = border - int(rng.integers(1, STRAY_ROWS + 1))
        values[first : first + STRAY_ROWS] += int(rng.choice([-1, 1])) * 3600 * SECOND
    return values


@pytest.mark.parametrize(
    "count",
    [1, 2, 3, 5, 6, 7, 8, 13, 14, 15, 70, 71, 500],
)
def test_the_median_runs_over_the_rows_around(count):
    given = offsets(count, range(7, count, 21))
    kept = given.copy()
    assert_array_equal(without_glitches(given), plainly(given))
    assert_array_equal(given, kept)


def test_glitches_over_borders_are_gone_and_the_step_stays():
    given = offsets(
        3 * BLOCK,
        range(BLOCK, 3 * BLOCK, BLOCK),
    )
    steady = without_glitches(given)
    assert_array_equal(steady, plainly(given))
    (step,) = np.flatnonzero(np.abs(np.diff(steady)) > SECOND)
    assert abs(step + 1 - 3 * BLOCK // 2) <= STRAY_ROWS
    assert np.ptp(steady[: step + 1]) < 2 * 10**6
    assert np.ptp(steady[step + 1 :]) < 2 * 10**6
