"""Ground heights of a batch, and the counts of many batches."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

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
    ground_sigma: np.ndarray | None
    count: int

    def __len__(self):
        return self.count


OFFSET = np.array([10.0, -20.0, np.nan])


def heights_of(ground, h_m=None, *, sigma_m=None, station=(0, 0, 0)):
    """Heights and sigmas of a batch whose rows are of these stations."""
    batch = Heights(h_m, sigma_m, len(station))
    return ground.heights(batch, np.array(station))


@pytest.mark.parametrize(
    ("station", "h_m"),
    [
        ([1, 0, 1], [80.0, 210.0, 280.0]),
        # Of an unknown offset no height follows; without a station there is nothing to reduce.
        ([2, -1, 0], [np.nan, 200.0, 310.0]),
    ],
)
def test_heights_of_points_and_the_offset_of_their_station(station, h_m):
    of_points = np.array([100.0, 200.0, 300.0])
    heights = heights_of(GivenGround(None, OFFSET), of_points, station=station)
    assert_array_equal(heights.h_m, h_m)


def test_one_height_and_the_offset_of_the_station():
    heights = heights_of(GivenGround(450.0, OFFSET), station=[1, 0, 1])
    assert heights.h_m.tolist() == [430.0, 460.0, 430.0]


def test_the_limits_are_those_of_all_stations():
    unknown = np.array([np.nan])
    assert GivenGround(450.0, OFFSET).limits == (430.0, 460.0)
    assert GivenGround(450.0, unknown).limits == (450.0, 450.0)
    assert GivenGround(None, OFFSET).limits == (-600.0, 10_000.0)


def test_heights_of_no_ground_are_unknown_and_counted():
    h_m = np.array([-600.0, -600.1, 10_000.0, 10_000.1, np.nan])
    station = [0] * 5
    of_points = heights_of(GivenGround(None, OFFSET), h_m, station=station)
    constant = heights_of(GivenGround(450.0, OFFSET), station=station)
    assert of_points.implausible == 2
    assert constant.implausible == 0
    is_plausible = np.isfinite(plausible_heights(h_m))
    assert is_plausible.tolist() == [True, False, True, False, False]


def test_the_status_of_the_ground_goes_before_ok_and_no_ground_only():
    zeros = np.zeros(5)
    codes = np.array([OK, OK, NO_GROUND, NO_STATION, OUTSIDE_CAMERA], np.uint8)
    of_ground = np.full(5, MISSES_GROUND, np.uint8)
    of_ground[1] = OK
    corrections = Corrections(*np.full((8, 5), np.nan), status=codes)

    unchanged = GroundHeights(zeros, zeros).with_ground_status(corrections)
    flagged = GroundHeights(zeros, zeros, of_ground).with_ground_status(corrections)

    assert unchanged is corrections
    assert flagged.status.tolist() == [
        MISSES_GROUND,
        OK,
        MISSES_GROUND,
        NO_STATION,
        OUTSIDE_CAMERA,
    ]


def test_the_sigma_of_a_column_goes_before_that_of_all():
    column = np.array([1.0, np.nan, 3.0])
    unknown = GivenGround(0.0, OFFSET)
    five = GivenGround(0.0, OFFSET, sigma_m=5.0)
    assert heights_of(five).sigma_m.tolist() == [5.0, 5.0, 5.0]
    assert_array_equal(heights_of(unknown, sigma_m=column).sigma_m, column)
    assert np.isnan(heights_of(unknown).sigma_m).all()


CAMERA = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)
CAUSES = {"no_ground": "the model ends there"}


def reported(explained=(), **counts):
    """What is said of 50 good observations of 54 and of some others."""
    status = dict.fromkeys(STATUS_NAMES, 0) | {"ok": 50}
    for name in counts.keys() & status:
        status[name] = counts.pop(name)
    none = Statistics.of({"nadir": CAMERA})
    statistics = replace(none, rows=54, status=status, **counts)
    ledger = Ledger()
    statistics.report_flagged(ledger, CAUSES, explained=explained)
    return list(ledger)


@pytest.mark.parametrize(
    ("count", "code", "kind", "where"),
    [
        ("no_distance", "OBS-DISTANCE", Kind.WARNING, "observations.columns.distance_m"),
        ("no_sigma", "OBS-SIGMA", Kind.WARNING, "ground.sigma_column"),
        ("no_point", "POINTS-MISSING", Kind.LOSS, "ground.height.points"),
        ("implausible_heights", "OBS-GROUND-RANGE", Kind.LOSS, "ground.height"),
    ],
)
def test_each_missing_value_has_its_entry(count, code, kind, where):
    (message,) = reported(**{count: 4})
    assert message.code == code
    assert message.kind is kind
    assert message.count == 4
    assert message.where == where


@pytest.mark.parametrize(
    ("status", "code", "kind"),
    [
        ("no_ground", "OBS-FLAGGED", Kind.LOSS),
        ("beyond_grazing", "OBS-BEYOND-GRAZING", Kind.LOSS),
        ("far_branch", "OBS-FAR-BRANCH", Kind.NOTE),
        ("several_crossings", "OBS-SEVERAL-CROSSINGS", Kind.WARNING),
    ],
)
def test_each_status_has_its_entry_with_its_kind_and_count(status, code, kind):
    (message,) = reported(**{status: 4})
    assert message.code == code
    assert message.kind is kind
    assert message.count == 4
    assert message.what.startswith(f"4 of 54 observations are {status}")


def test_rows_without_an_image_are_not_said_twice():
    (alone,) = reported(no_station=4, no_image=4, first_no_image="7 (point p0)")
    assert alone.code == "OBS-NO-IMAGE"
    assert alone.kind is Kind.LOSS
    assert "4 of 54 observations have no name of an image" in alone.what
    assert "row 7 (point p0)" in alone.what
    of_no_image, of_no_station = reported(
        no_station=6,
        no_image=4,
    )
    assert of_no_image.count == 4
    assert of_no_station.count == 2


def test_flagged_rows_are_told_with_cause_and_example_and_may_follow_from_another_loss():
    (flagged,) = reported(no_ground=4, examples={"no_ground": ["i1 p1"]})
    assert "the model ends there" in flagged.what
    assert "first i1 p1" in flagged.what
    (explained,) = reported(no_ground=4, explained={"no_ground"})
    assert explained.kind is Kind.NOTE


def test_nothing_is_said_of_good_observations():
    assert not reported()


@given(st.integers(1, 2000), st.integers(1, 500))
def test_evenly_spaced_rows_are_few_ordered_and_reach_both_ends(count, most):
    rows = evenly_spaced(count, most)
    assert 1 <= rows.size <= min(count, most)
    assert rows[0] == 0
    steps = np.diff(rows)
    assert (steps > 0).all()
    if most > 1:
        assert rows[-1] == count - 1
        assert rows.size == min(count, most)
    if rows.size > 1:
        assert np.ptp(steps) <= 1


def test_no_rows_of_none():
    assert evenly_spaced(0, 10).size == 0
