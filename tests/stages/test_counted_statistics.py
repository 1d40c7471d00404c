"""Counts, sigmas and ground heights that the manifest has of all observations, by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from unbend.messages import Kind, Ledger
from unbend.refraction.status_codes import OK, STATUS_NAMES
from unbend.stages.statistics import SampledRows, Statistics

NO_GROUND = STATUS_NAMES.index("no_ground")
CAMERAS = {
    "nadir": SimpleNamespace(width_px=1400, height_px=1000),
    "oblique": SimpleNamespace(width_px=1400, height_px=1000),
}


class Rows(SimpleNamespace):
    """A batch of observations, all whose values a test states."""

    def __len__(self) -> int:
        return self.x_px.size


def batch(count: int, weight: list[float] | None = None, **values: Any) -> Rows:
    usual = {
        "x_px": np.full(count, 50.0),
        "y_px": np.full(count, 50.0),
        "image": np.array([f"i{k}" for k in range(count)], dtype=object),
        "point": pa.array([None if k == 1 else f"p{k}" for k in range(count)], pa.string()),
        "weight": None if weight is None else np.array(weight),
        "first_row": 100,
        "numbers": None,
        "no_distance": 0,
        "no_sigma": 0,
        "no_point": 0,
    }
    return Rows(**(usual | values))


class Moved(SimpleNamespace):
    """Corrections by (3, 4) px, 2 m on the ground, by 10 and 20 microradians."""

    def rows(self, chosen: np.ndarray) -> Moved:
        columns = {
            name: value[chosen]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray)
        }
        return Moved(**columns, sigmas=None)


def corrections(status: list[int], sigmas: Any = None) -> Moved:
    n = len(status)
    return Moved(
        dx_px=np.full(n, 3.0),
        dy_px=np.full(n, 4.0),
        shift_ground_m=np.full(n, 2.0),
        r_c_rad=np.full(n, 10e-6),
        r_cc_rad=np.full(n, -20e-6),
        status=np.array(status, np.uint8),
        sigmas=sigmas,
    )


def test_rows_of_a_sample_count_as_those_for_which_they_stand():
    statistics = Statistics.of(CAMERAS)
    given = batch(4, [10.0, 20.0, 30.0, 40.0], no_distance=1, no_sigma=2, no_point=3)
    statistics.add(given, corrections([OK, NO_GROUND, NO_GROUND, OK]), np.array([0, 0, 1, -1]))
    assert (statistics.parts, statistics.rows) == (1, 100)
    assert (statistics.no_distance, statistics.no_sigma, statistics.no_point) == (25, 50, 75)
    assert statistics.status["ok"] == 50
    assert statistics.status["no_ground"] == 50
    assert sum(statistics.status.values()) == 100
    assert statistics.examples == {"no_ground": ["i1 (row 101)", "i2 p2"]}
    counts = {name: shifts.sums[2].sum() for name, shifts in statistics.shifts.items()}
    assert counts == {"nadir": 2.0, "oblique": 1.0}


def test_rows_are_named_by_their_numbers_where_these_are_known():
    statistics = Statistics.of(CAMERAS)
    given = batch(3, numbers=np.array([7, 70, 700]))
    statistics.add(given, corrections([NO_GROUND, NO_GROUND, OK]), np.array([0, 0, 0]))
    assert statistics.examples == {"no_ground": ["i0 p0", "i1 (row 70)"]}


def test_variances_of_the_air_are_sums_of_squares_in_both_axes():
    statistics = Statistics.of(CAMERAS)
    sigmas = SimpleNamespace(
        r_cc_rad=np.array([1e-6, 2e-6]),
        air_dx_px=np.array([1.0, math.nan], np.float32),
        air_dy_px=np.array([2.0, 3.0], np.float32),
        dx_ds_px=np.array([0.5, 0.0], np.float32),
        dy_ds_px=np.array([0.0, -1.5], np.float32),
    )
    statistics.add(batch(2), corrections([OK, OK], sigmas), np.array([0, 0]))
    assert statistics.air_variance == pytest.approx(14.0)
    assert statistics.by_mode == pytest.approx(2.5)
    share = statistics.cabin_share.summary()
    assert share.maximum == pytest.approx(0.2, rel=0.05)


def test_later_parts_are_added():
    first = Statistics.of(CAMERAS)
    later = Statistics.of(CAMERAS)
    first.add(batch(2, no_point=1), corrections([OK, NO_GROUND]), np.array([0, 0]))
    later.add(batch(3), corrections([NO_GROUND, NO_GROUND, NO_GROUND]), np.array([1, 1, 1]))
    first.ground_m, later.ground_m = (120.0, 300.0), (100.0, 250.0)
    later.implausible_heights = 2
    first.merge(later)
    assert (first.parts, first.rows, first.no_point, first.implausible_heights) == (2, 5, 1, 2)
    assert first.ground_m == (100.0, 300.0)
    assert (first.status["ok"], first.status["no_ground"]) == (1, 4)
    assert first.examples["no_ground"] == ["i1 (row 101)", "i0 p0", "i1 (row 101)"]
    record = first.correction()
    assert record.shift_px.maximum == pytest.approx(5.0, rel=0.01)
    assert {name: of.shift_px.count for name, of in record.cameras.items()} == {
        "nadir": 2,
        "oblique": 3,
    }
    assert record.shift_px.count == 5


def sampled(**columns: Any) -> SampledRows:
    """Sampled rows in which a test states some columns; sigmas are unknown."""
    count = len(next(iter(columns.values())))
    values = {name: np.full(count, math.nan) for name in SampledRows._fields}
    values |= {"weight": np.ones(count), "sigma_px": np.full((count, 4), math.nan)}
    return SampledRows(**(values | {name: np.array(column) for name, column in columns.items()}))


def test_the_parts_of_sigma_by_camera_in_pixels_and_metres():
    statistics = Statistics.of(CAMERAS)
    statistics.sampled = [
        sampled(
            station=[0, 1],
            shift_px=[4.0, 5.0],
            shift_ground_m=[2.0, 10.0],  # 0.5 and 2 m a pixel
            sigma_px=[[3.0, 4.0, math.nan, math.nan], [0.6, 0.0, 0.8, math.nan]],
            weight=[1.0, 1.0],
        ),
        sampled(
            station=[-1],
            shift_px=[1.0],
            shift_ground_m=[1.0],
            sigma_px=[[90.0, 90.0, 90.0, 90.0]],
            weight=[5.0],
        ),
    ]
    budget = statistics.sigma_budget(np.array([0, 1, -1]))
    shown = {
        name: {part: (record.px.median, record.m.median) for part, record in parts.items()}
        for name, parts in budget.items()
    }
    assert shown == {
        "nadir": {"air": (3.0, 1.5), "station": (4.0, 2.0), "all": (5.0, 2.5)},
        "oblique": {
            "air": (0.6, 1.2),
            "station": (0.0, 0.0),
            "ground": (0.8, 1.6),
            "all": (1.0, 2.0),
        },
    }


def test_ground_heights_in_bins_of_a_round_width():
    """From 100 to 340 m: 24 bins of 10 m. Rows count as those for which they stand."""
    statistics = Statistics.of(CAMERAS)
    assert statistics.ground_heights() is None
    statistics.ground_m = (100.004, 339.996)
    statistics.sampled = [
        sampled(
            h_g_m=[105.0, 109.9, 110.1, 335.0, 200.0, math.nan],
            shift_px=[1.0, 1.0, 1.0, 1.0, math.nan, 1.0],
            weight=[2.0, 1.0, 4.0, 1.0, 50.0, 50.0],
            station=[0, 0, 1, 1, 3, 3],
        )
    ]
    record = statistics.ground_heights()
    assert (record.lowest_m, record.highest_m, record.median_m) == (100.0, 340.0, 110.1)
    assert (record.histogram.first_m, record.histogram.step) == (100.0, 10.0)
    counts = record.histogram.counts
    assert counts == [3, 4, *[0] * 21, 1]
    medians = statistics.ground_of_stations(5)
    np.testing.assert_allclose(medians, [107.45, 222.55, math.nan, 200.0, math.nan])


def test_rows_without_a_correction_are_reported_with_their_number_and_cause():
    statistics = Statistics.of(CAMERAS)
    statistics.rows = 200
    statistics.no_distance, statistics.no_sigma = 3, 4
    statistics.no_point, statistics.implausible_heights = 5, 6
    statistics.status = {"ok": 150, "no_ground": 40, "far_branch": 0}
    statistics.examples = {"no_ground": ["i1 p1"]}
    ledger = Ledger()
    statistics.report_flagged(ledger, {"no_ground": "the model ends there"})
    assert [(entry.where, entry.count) for entry in ledger][:4] == [
        ("observations.columns.distance_m", 3),
        ("ground.sigma_column", 4),
        ("ground.height.points", 5),
        ("ground.height", 6),
    ]
    (flagged,) = list(ledger)[4:]
    assert (flagged.count, flagged.kind) == (40, Kind.LOSS)
    for words in ("200", "no_ground", "the model ends there", "first i1 p1"):
        assert words in flagged.what
    explained = Ledger()
    statistics.report_flagged(explained, {}, explained={"no_ground"})
    assert list(explained)[-1].kind is Kind.NOTE
