"""Ground heights of a batch, and the counts of many batches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.messages import Kind, Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Corrections
from unbend.refraction.status_codes import (
    MISSES_GROUND,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    STATUS_NAMES,
)
from unbend.stages.correction_setup import GroundHeights
from unbend.stages.ground_heights import GivenGround, plausible_heights
from unbend.stages.statistics import Statistics, evenly_spaced


@dataclass
class Heights:
    """The heights of a batch of observations."""

    ground: np.ndarray | None
    ground_sigma: np.ndarray | None = None
    count: int = 3

    def __len__(self) -> int:
        return self.count


OFFSET = np.array([10.0, -20.0, np.nan])


@pytest.mark.parametrize(
    ("constant_m", "given_m", "station", "ground_m"),
    [
        (None, [100.0, 200.0, 300.0], [1, 0, 1], [80.0, 210.0, 280.0]),
        # Of an unknown offset no height follows; without a station there is nothing to reduce.
        (None, [100.0, 200.0, 300.0], [2, -1, 0], [np.nan, 200.0, 310.0]),
        (450.0, None, [1, 0, 1], [430.0, 460.0, 430.0]),
    ],
)
def test_heights_and_the_offset_of_their_station(constant_m, given_m, station, ground_m):
    ground = GivenGround(constant_m, OFFSET)
    given = Heights(None if given_m is None else np.array(given_m))
    heights = ground.heights(given, np.array(station))
    np.testing.assert_array_equal(heights.h_m, ground_m)


def test_the_limits_are_those_of_all_stations():
    assert GivenGround(450.0, OFFSET).limits == (430.0, 460.0)
    assert GivenGround(450.0, np.array([np.nan])).limits == (450.0, 450.0)
    assert GivenGround(None, OFFSET).limits == (-600.0, 10_000.0)


def test_heights_of_no_ground_are_unknown_and_counted():
    heights = np.array([-600.0, -600.1, 10_000.0, 10_000.1, np.nan])
    assert np.isfinite(plausible_heights(heights)).tolist() == [True, False, True, False, False]
    ground = GivenGround(None, OFFSET)
    station = np.zeros(5, np.int64)
    assert ground.heights(Heights(heights, count=5), station).implausible == 2
    constant = GivenGround(450.0, OFFSET)
    assert constant.heights(Heights(None, count=5), station).implausible == 0


def test_the_status_of_the_ground_goes_before_ok_and_no_ground_only():
    codes = [OK, OK, NO_GROUND, NO_STATION, OUTSIDE_CAMERA]
    corrections = Corrections(*np.full((8, 5), np.nan), status=np.array(codes, np.uint8))
    assert GroundHeights(np.zeros(5), np.zeros(5)).flagged(corrections) is corrections
    of_ground = np.array([MISSES_GROUND, OK, *[MISSES_GROUND] * 3], np.uint8)
    flagged = GroundHeights(np.zeros(5), np.zeros(5), of_ground).flagged(corrections).status
    assert flagged.tolist() == [MISSES_GROUND, OK, MISSES_GROUND, NO_STATION, OUTSIDE_CAMERA]


def test_the_sigma_of_a_column_goes_before_that_of_all():
    own = np.array([1.0, np.nan, 3.0])

    def sigmas(ground, column=None):
        return ground.heights(Heights(None, column), np.zeros(3, np.int64)).sigma_m

    assert sigmas(GivenGround(0.0, OFFSET, sigma_m=5.0)).tolist() == [5.0, 5.0, 5.0]
    np.testing.assert_array_equal(sigmas(GivenGround(0.0, OFFSET), own), own)
    assert np.isnan(sigmas(GivenGround(0.0, OFFSET))).all()


CAMERA = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)


def counted(**counts: object) -> Statistics:
    return replace(Statistics.of({"nadir": CAMERA}), **counts)


def test_the_counts_of_two_parts_are_added():
    names = ("no_distance", "no_sigma", "air_variance", "by_mode")
    total = counted(**dict(zip(names, (1, 2, 0.25, 2.0), strict=True)))
    total.merge(counted(**dict(zip(names, (10, 20, 0.5, 1.0), strict=True))))
    assert [getattr(total, name) for name in names] == [11, 22, 0.75, 3.0]


@pytest.mark.parametrize(
    ("counts", "status", "code", "kind"),
    [
        ({"no_distance": 4}, {}, "OBS-DISTANCE", Kind.WARNING),
        ({"no_sigma": 4}, {}, "OBS-SIGMA", Kind.WARNING),
        ({"implausible_heights": 4}, {}, "OBS-GROUND-RANGE", Kind.LOSS),
        ({}, {"no_ground": 4}, "OBS-FLAGGED", Kind.LOSS),
        ({}, {"beyond_grazing": 4}, "OBS-BEYOND-GRAZING", Kind.LOSS),
        ({}, {"far_branch": 4}, "OBS-FAR-BRANCH", Kind.NOTE),
        ({}, {"several_crossings": 4}, "OBS-SEVERAL-CROSSINGS", Kind.WARNING),
    ],
)
def test_each_reason_has_its_entry_with_its_kind_and_count(counts, status, code, kind):
    ledger = Ledger()
    every = dict.fromkeys(STATUS_NAMES, 0) | {"ok": 50} | status
    counted(rows=54, status=every, **counts).report_flagged(ledger, {})
    (message,) = ledger
    assert message.code == code
    assert message.kind is kind
    assert message.count == 4
    for name in status:
        assert message.what.startswith(f"4 of 54 observations are {name}")


def test_nothing_is_said_of_good_observations():
    ledger = Ledger()
    counted(rows=50, status={"ok": 50}).report_flagged(ledger, {})
    assert len(ledger) == 0


@given(st.integers(1, 2000), st.integers(1, 500))
def test_evenly_spaced_rows_are_few_ordered_and_reach_both_ends(count, most):
    rows = evenly_spaced(count, most)
    assert 1 <= rows.size <= min(count, most)
    assert rows[0] == 0
    assert (np.diff(rows) > 0).all()
    if most > 1:
        assert rows[-1] == count - 1
        assert rows.size == min(count, most)
        assert np.ptp(np.diff(rows)) <= 1 if rows.size > 1 else True


def test_no_rows_of_none():
    assert evenly_spaced(0, 10).size == 0
