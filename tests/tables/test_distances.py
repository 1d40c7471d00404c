"""Slant ranges beside the pixels: read, passed through, doubted; and marks of what was done."""

from __future__ import annotations

import datetime as dt
import math

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.observed import COLUMNS, opened
from unbend.messages import Ledger
from unbend.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS

RANGED = COLUMNS | {"distance_m": "range"}


def table(**more) -> pa.Table:
    """Rows as many as the columns have, two without any."""
    rows = len(next(iter(more.values()), "ab"))
    numbers = np.arange(rows, dtype=float)
    columns = {"image": ["a"] * rows, "point": ["p"] * rows, "x_px": numbers, "y_px": numbers}
    return pa.table(columns | more)


def refusal(code, *arguments, **more) -> str:
    with refused(code) as caught:
        opened(*arguments, **more)
    return str(caught.value)


@pytest.mark.parametrize("csv", [False, True])
@pytest.mark.parametrize(
    ("given", "kind"), [([1500.5, None, 2000.0], pa.float64()), ([1500, 20], pa.int64())]
)
def test_a_distance_is_read_and_leaves_unchanged(tmp_path, given, kind, csv):
    observations = opened(tmp_path, table(range=given, own=given), RANGED, csv=csv)
    assert [(f.name, f.type) for f in observations.user_fields] == [("range", kind), ("own", kind)]
    (batch,) = observations.batches(10)
    assert_array_equal(batch.distance_m, np.array(given, float))
    assert batch.no_distance == 0
    assert batch.users["range"].to_pylist() == given


@pytest.mark.parametrize("columns", [COLUMNS, COLUMNS | {"distance_m": None}])
def test_without_the_column_there_are_no_distances(tmp_path, columns):
    (batch,) = opened(tmp_path, table(range=[1.0, 2.0]), columns).batches(10)
    assert batch.distance_m is None
    assert batch.no_distance == 0
    assert batch.users["range"].to_pylist() == [1.0, 2.0]


NUMBERS = [0.0, -3.0, math.inf, -math.inf, math.nan, None, 1e-3, 4e5]


def test_what_is_no_distance_is_counted_and_taken_as_absent(tmp_path):
    """Null and NaN are absent, not nonsense; a slant range of zero is none."""
    batches = list(opened(tmp_path, table(range=NUMBERS), RANGED).batches(3))
    assert [len(batch) for batch in batches] == [3, 3, 2]
    distance = np.concatenate([batch.distance_m for batch in batches])
    assert_array_equal(distance, [math.nan] * 6 + [1e-3, 4e5])
    assert [batch.no_distance for batch in batches] == [3, 1, 0]
    assert batches[0].users["range"].to_pylist() == NUMBERS[:3]  # as they came


def test_what_is_no_sigma_of_a_ground_height_is_counted(tmp_path):
    """Zero is one."""
    (batch,) = opened(tmp_path, table(s=NUMBERS), sigma_column="s").batches(10)
    assert_array_equal(batch.ground_sigma, [0.0] + [math.nan] * 5 + [1e-3, 4e5])
    assert batch.no_sigma == 3
    assert batch.users["s"].to_pylist()[:4] == NUMBERS[:4]


def test_words_among_the_distances_of_a_csv(tmp_path):
    text = "image,point,x_px,y_px,range\na,p,1,2,150\na,p,1,2,far\na,p,1,2,\na,p,1,2,007\n"
    (batch,) = opened(tmp_path, text, RANGED).batches(10)
    assert_array_equal(batch.distance_m, [150.0, math.nan, math.nan, 7.0])
    assert batch.no_distance == 1
    assert batch.users["range"].to_pylist() == ["150", "far", None, "007"]


@pytest.mark.parametrize(
    ("direction", "column"),
    [("remove", "r_c_rad"), ("remove", "x_displaced_px"), ("apply", "x_corrected_px")],
)
def test_a_column_called_like_one_of_ours_leaves_renamed(tmp_path, direction, column):
    """In either direction: it would make the results look like those of the other one."""
    content = table(**{column: [5.0, 6.0]}, u=[3.0, 4.0], v=[5.0, 6.0])
    columns = RANGED | {"x_px": "u", "y_px": "v", "distance_m": column}
    ledger = Ledger()
    (batch,) = opened(tmp_path, content, columns, direction=direction, ledger=ledger).batches(10)
    assert batch.distance_m.tolist() == [5.0, 6.0]
    assert batch.users[f"{column}_input"].to_pylist() == [5.0, 6.0]
    assert {entry.code for entry in ledger} == {"OBS-RENAMED"}


def test_a_distance_that_is_not_there(tmp_path):
    words = refusal("OBS-COLUMN", tmp_path, table(ranges=[1.0, 2.0]), RANGED)
    assert "perhaps 'ranges'" in words
    assert "observations.columns.distance_m" in words


@pytest.mark.parametrize("csv", [False, True])
@pytest.mark.parametrize("values", [[True, False], [dt.date(2024, 1, 1)] * 2])
def test_a_distance_of_another_kind(tmp_path, values, csv):
    refusal("OBS-TYPE", tmp_path, table(range=pa.array(values)), RANGED, csv=csv)


@pytest.mark.parametrize("name", ["x_px", "point"])
def test_a_distance_that_is_something_else_too(tmp_path, name):
    assert name in refusal("OBS-COLUMN", tmp_path, table(), COLUMNS | {"distance_m": name})


def test_a_distance_is_no_ground_height(tmp_path):
    content = table(range=[1.0, 2.0])
    assert "two quantities" in refusal("OBS-COLUMN", tmp_path, content, RANGED, ground="range")


# What was done to a table before.


def marked(mark: str, **more) -> pa.Table:
    return table(**more).replace_schema_metadata({"unbend.refraction": mark})


@pytest.mark.parametrize(
    ("mark", "kind", "direction"),
    [("removed", "corrected", "apply"), ("applied", "displaced", "remove")],
)
def test_what_is_removed_may_be_applied_and_the_reverse(tmp_path, mark, kind, direction):
    results = {f"x_{kind}_px": [1.5, 2.5], f"y_{kind}_px": [0.0, 1.0]}
    ours = COLUMNS | {"x_px": f"x_{kind}_px", "y_px": f"y_{kind}_px"}
    observations = opened(tmp_path, marked(mark, **results), ours, direction=direction)
    (batch,) = observations.batches(10)
    assert batch.x_px.tolist() == [1.5, 2.5]
    # The pixels of the table leave under a name that nobody takes for ours.
    assert [field.name for field in observations.user_fields] == ["x_px_input", "y_px_input"]


@pytest.mark.parametrize(
    ("mark", "direction", "code"),
    [
        ("removed", "remove", "OBS-ALREADY-CORRECTED"),
        ("applied", "apply", "OBS-ALREADY-DISPLACED"),
    ],
)
def test_nothing_is_done_twice(tmp_path, mark, direction, code):
    words = refusal(code, tmp_path, marked(mark), COLUMNS, direction=direction)
    assert f"refraction {mark}" in words
    # A mark alone says which pixels these are only together with the columns of ours.
    reverse = {"remove": "apply", "apply": "remove"}[direction]
    opened(tmp_path, marked(mark), COLUMNS, direction=reverse)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(
    ("direction", "code", "kind"),
    [
        ("remove", "OBS-ALREADY-CORRECTED", "corrected"),
        ("apply", "OBS-ALREADY-DISPLACED", "displaced"),
    ],
)
def test_a_csv_has_no_mark_but_columns(tmp_path, direction, code, kind, axis):
    column = f"{axis}_{kind}_px"
    content = table(**{column: [1.0, 2.0]})
    assert column in refusal(code, tmp_path, content, csv=True, direction=direction)


@pytest.mark.parametrize(
    ("direction", "kind", "what"),
    [("remove", "displaced", "ideal"), ("apply", "corrected", "measured")],
)
@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_other_pixels_of_our_own_table(tmp_path, direction, kind, what, axis):
    right = {f"{a}_{kind}_px": [1.0, 2.0] for a in "xy"}
    ours = COLUMNS | {f"{a}_px": f"{a}_{kind}_px" for a in "xy"}
    opened(tmp_path, table(**right), ours, direction=direction)
    wrong = ours | {f"{axis}_px": f"{axis}_px"}
    words = refusal("OBS-OTHER-PIXELS", tmp_path, table(**right), wrong, direction=direction)
    assert what in words
    assert f"observations.columns.{axis}_px: {axis}_{kind}_px" in words


def test_displaced_columns_stand_where_corrected_ones_would():
    names = [name.replace("corrected", "displaced") for name in OBSERVATION_COLUMNS]
    assert list(DISPLACED_COLUMNS) == names
    kinds = [kind for kind, _, _ in OBSERVATION_COLUMNS.values()]
    assert [kind for kind, _, _ in DISPLACED_COLUMNS.values()] == kinds
    for name in ("x_px", "y_px"):
        assert "measured" not in DISPLACED_COLUMNS[name][2]
