"""Counts, sigmas and ground heights that the manifest has of all observations, by hand.

What is said of them stands in `test_ground_and_statistics`.
"""

import math
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from unbend.refraction.image import COLUMNS, Corrections
from unbend.refraction.status_codes import OK, STATUS_NAMES
from unbend.stages.statistics import SampledRows, Statistics
from unbend.tables.observations import Batch

NO_GROUND = STATUS_NAMES.index("no_ground")
NO_STATION = STATUS_NAMES.index("no_station")
CAMERA = SimpleNamespace(width_px=1400, height_px=1000)
NAN = math.nan


def two_cameras():
    return Statistics.of({"nadir": CAMERA, "oblique": CAMERA})


@pytest.fixture
def statistics():
    return two_cameras()


def add(statistics, status, camera, sigmas=None, *, images=None, **counts):
    """Count a batch of points i0 p0, i1 without a name, i2 p2 ..., whose first row is the 100th.

    ``images`` are other names. Corrections are by (3, 4) px, 2 m on the ground, by 10 and 20
    microradians.
    """
    n = len(status)
    pixels = np.full(n, 50.0)
    images = images or [f"i{k}" for k in range(n)]
    points = [f"p{k}" for k in range(n)]
    points[1] = None
    batch = Batch(
        image=pa.array(images, pa.string()),
        point=pa.array(points),
        x_px=pixels,
        y_px=pixels,
        x_given_px=pixels,
        y_given_px=pixels,
        ground=None,
        users={},
        first_row=100,
        **counts,
    )
    values = dict.fromkeys(COLUMNS, 0.0) | {
        "dx_px": 3.0,
        "dy_px": 4.0,
        "shift_ground_m": 2.0,
        "r_c_rad": 10e-6,
        "r_cc_rad": -20e-6,
    }
    columns = {name: np.full(n, value) for name, value in values.items()}
    codes = np.array(status, np.uint8)
    corrections = Corrections(**columns, status=codes, sigmas=sigmas)
    statistics.add(batch, corrections, np.array(camera))


def test_rows_of_a_sample_count_as_those_for_which_they_stand(statistics):
    add(
        statistics,
        [OK, NO_GROUND, NO_GROUND, OK],
        [0, 0, 1, -1],
        weight=np.array([10.0, 20.0, 30.0, 40.0]),
        no_distance=1,
        no_sigma=2,
        no_point=3,
    )
    assert statistics.parts == 1
    assert statistics.rows == 100
    assert statistics.no_distance == 25
    assert statistics.no_sigma == 50
    assert statistics.no_point == 75
    expected = dict.fromkeys(STATUS_NAMES, 0) | {"ok": 50, "no_ground": 50}
    assert statistics.status == expected
    assert statistics.examples == {"no_ground": ["i1 (row 101)", "i2 p2"]}
    assert statistics.shifts["nadir"].sums[2].sum() == 2.0
    assert statistics.shifts["oblique"].sums[2].sum() == 1.0


def test_rows_are_named_by_their_numbers_where_these_are_known(statistics):
    numbers = np.array([7, 70, 700])
    add(statistics, [NO_GROUND, NO_GROUND, OK], [0, 0, 0], numbers=numbers)
    assert statistics.examples == {"no_ground": ["i0 p0", "i1 (row 70)"]}


@pytest.mark.parametrize("empty", [None, "", "  "])
def test_rows_without_the_name_of_an_image_are_counted_apart(statistics, empty):
    images = ["i0", empty, empty, "i3", empty]
    add(statistics, [NO_STATION] * 4 + [OK], [-1] * 5, images=images)
    later = two_cameras()
    weight = np.array([5.0, 5.0, 5.0])
    add(later, [OK, NO_STATION, NO_STATION], [-1] * 3, images=["i0", "i1", empty], weight=weight)
    statistics.merge(later)
    assert statistics.status["no_station"] == 14
    assert statistics.no_image == 7
    assert statistics.first_no_image == "101"
    assert statistics.examples == {"no_station": ["i0 p0", "i3 p3", "i1 (row 101)"]}


def test_the_first_row_without_an_image_is_that_of_any_part_with_its_point(statistics):
    later = two_cameras()
    add(statistics, [OK, OK], [0, 0])
    add(later, [NO_STATION, NO_STATION], [-1, -1], images=[None, None], numbers=np.array([7, 9]))
    statistics.merge(later)
    assert statistics.first_no_image == "7 (point p0)"
    assert statistics.examples == {}


def test_variances_of_the_air_are_sums_of_squares_in_both_axes(statistics):
    sigmas = {
        "r_cc_rad": [1e-6, 2e-6],
        "air_dx_px": [1.0, NAN],
        "air_dy_px": [2.0, 3.0],
        "dx_ds_px": [0.5, 0.0],
        "dy_ds_px": [0.0, -1.5],
    }
    columns = {name: np.array(values, np.float32) for name, values in sigmas.items()}
    add(statistics, [OK, OK], [0, 0], SimpleNamespace(**columns))
    assert statistics.air_variance == pytest.approx(14.0)
    assert statistics.by_mode == pytest.approx(2.5)
    share = statistics.cabin_share.summary()
    assert share.maximum == pytest.approx(0.2, rel=0.05)


def test_later_parts_are_added(statistics):
    later = two_cameras()
    add(statistics, [OK, NO_GROUND], [0, 0], no_distance=1, no_sigma=1, no_point=1)
    add(later, [NO_GROUND] * 3, [1, 1, 1], no_distance=1, no_sigma=2)
    statistics.ground_m = (120.0, 300.0)
    statistics.air_variance = 0.25
    statistics.by_mode = 2.0
    later.ground_m = (100.0, 250.0)
    later.air_variance = 0.5
    later.by_mode = 1.0
    later.implausible_heights = 2
    statistics.merge(later)
    assert statistics.parts == 2
    assert statistics.rows == 5
    assert statistics.no_distance == 2
    assert statistics.no_sigma == 3
    assert statistics.no_point == 1
    assert statistics.air_variance == 0.75
    assert statistics.by_mode == 3.0
    assert statistics.implausible_heights == 2
    assert statistics.ground_m == (100.0, 300.0)
    assert statistics.status["ok"] == 1
    assert statistics.status["no_ground"] == 4
    assert statistics.examples["no_ground"] == ["i1 (row 101)", "i0 p0", "i1 (row 101)"]
    record = statistics.correction()
    assert record.shift_px.count == 5
    assert record.cameras["nadir"].shift_px.count == 2
    assert record.cameras["oblique"].shift_px.count == 3
    assert record.shift_px.maximum == pytest.approx(5.0)
    assert record.shift_ground_m.maximum == pytest.approx(2.0)
    assert record.refraction_arcsec.maximum == pytest.approx(2.0626, abs=1e-4)
    assert record.window_arcsec.maximum == pytest.approx(4.1253, abs=1e-4)


def sampled(**columns):
    """Sampled rows in which a test states some columns; sigmas are unknown."""
    unknown = np.full_like(columns["weight"], NAN)
    values = dict.fromkeys(SampledRows._fields, unknown)
    values["sigma_px"] = np.stack([unknown] * 4, axis=1)
    for name, column in columns.items():
        values[name] = np.array(column)
    return SampledRows(**values)


def test_the_parts_of_sigma_by_camera_in_pixels_and_metres(statistics):
    statistics.sampled = [
        sampled(
            station=[0, 1],
            shift_px=[4.0, 5.0],
            shift_ground_m=[2.0, 10.0],  # 0.5 and 2 m a pixel
            sigma_px=[[3.0, 4.0, NAN, 12.0], [0.6, 0.0, 0.8, NAN]],
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
    camera_of_station = np.array([0, 1, -1])
    medians = {}
    for name, parts in statistics.sigma_budget(camera_of_station).items():
        medians[name] = {}
        for part, record in parts.items():
            medians[name][part] = (record.px.median, record.m.median)
    assert medians == {
        "nadir": {
            "air": (3.0, 1.5),
            "station": (4.0, 2.0),
            "cabin": (12.0, 6.0),
            "all": (13.0, 6.5),
        },
        "oblique": {
            "air": (0.6, 1.2),
            "station": (0.0, 0.0),
            "ground": (0.8, 1.6),
            "all": (1.0, 2.0),
        },
    }


def test_ground_heights_in_bins_of_a_round_width(statistics):
    """From 100 to 340 m: 24 bins of 10 m. Rows count as those for which they stand."""
    assert statistics.ground_heights() is None
    statistics.ground_m = (100.004, 339.996)
    statistics.sampled = [
        sampled(
            h_g_m=[105.0, 109.9, 110.1, 335.0, 200.0, NAN],
            shift_px=[1.0, 1.0, 1.0, 1.0, NAN, 1.0],
            weight=[2.0, 1.0, 4.0, 1.0, 50.0, 50.0],
            station=[0, 0, 1, 1, 3, 3],
        )
    ]
    record = statistics.ground_heights()
    assert record.lowest_m == 100.0
    assert record.highest_m == 340.0
    assert record.median_m == 110.1
    assert record.histogram.first_m == 100.0
    assert record.histogram.step == 10.0
    assert record.histogram.counts == [3, 4, *[0] * 21, 1]
    medians = statistics.ground_of_stations(5)
    expected = [107.45, 222.55, NAN, 200.0, NAN]
    np.testing.assert_allclose(medians, expected)
