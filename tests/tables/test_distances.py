"""Slant ranges beside the pixels: read, passed through, doubted; and marks of what was done."""

import datetime as dt
import math

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.checks import refused_with
from tests.tables.observed import COLUMNS, opened
from unbend.messages import Ledger
from unbend.tables.written_columns import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of

RANGED = COLUMNS | {"distance_m": "range"}
PAIR = [1.5, 2.5]
OPPOSITE = {"remove": "apply", "apply": "remove"}


def table(**more):
    """A table of observations with more columns; two rows without any."""
    rows = 2
    for values in more.values():
        rows = len(values)
    numbers = np.arange(rows, dtype=float)
    columns = {
        "image": ["a"] * rows,
        "point": ["p"] * rows,
        "x_px": numbers,
        "y_px": numbers,
    }
    return pa.table(columns | more)


def read(content, columns=COLUMNS, **options):
    """All rows of a table, in one batch."""
    observations = opened(content, columns, **options)
    (batch,) = observations.batches(10)
    return batch


def names_of(schema):
    return [field.name for field in schema]


as_parquet_and_csv = pytest.mark.parametrize("csv", [False, True])


@as_parquet_and_csv
@pytest.mark.parametrize(
    ("distances", "kind"),
    [
        ([1500.5, None, 2000.0], pa.float64()),
        ([1500, 20], pa.int64()),
    ],
)
def test_a_distance_is_read_and_leaves_unchanged(distances, kind, csv):
    content = table(range=distances, copy=distances)

    observations = opened(content, RANGED, csv=csv)
    (batch,) = observations.batches(10)

    assert names_of(observations.user_fields) == ["range", "copy"]
    assert {field.type for field in observations.user_fields} == {kind}
    assert_array_equal(batch.distance_m, np.array(distances, float))
    assert batch.no_distance == 0
    assert batch.users["range"].to_pylist() == distances


@pytest.mark.parametrize(
    "columns",
    [
        COLUMNS,
        COLUMNS | {"distance_m": None},
    ],
)
def test_without_the_column_there_are_no_distances(columns):
    batch = read(table(range=PAIR), columns)

    assert batch.distance_m is None
    assert batch.no_distance == 0
    assert batch.users["range"].to_pylist() == PAIR


NUMBERS = [
    0.0,
    -3.0,
    math.inf,
    -math.inf,
    math.nan,
    None,
    1e-3,
    4e5,
]


def test_what_is_no_distance_is_counted_and_taken_as_absent():
    """Null and NaN are absent, not nonsense; zero is not a slant range."""
    observations = opened(table(range=NUMBERS), RANGED)

    batches = list(observations.batches(3))

    assert [len(batch) for batch in batches] == [3, 3, 2]
    assert [batch.no_distance for batch in batches] == [3, 1, 0]
    distance_m = np.concatenate([batch.distance_m for batch in batches])
    assert np.isnan(distance_m[:6]).all()
    assert distance_m[6:].tolist() == NUMBERS[6:]
    assert batches[0].users["range"].to_pylist() == NUMBERS[:3]  # as they came


def test_what_is_no_sigma_of_a_ground_height_is_counted():
    """Zero is one."""
    batch = read(table(s=NUMBERS), sigma_column="s")

    assert batch.ground_sigma[0] == 0.0
    assert np.isnan(batch.ground_sigma[1:6]).all()
    assert batch.ground_sigma[6:].tolist() == NUMBERS[6:]
    assert batch.no_sigma == 3
    assert batch.users["s"].to_pylist()[:4] == NUMBERS[:4]


def test_words_among_the_distances_of_a_csv():
    text = "image,point,x_px,y_px,range\na,p,1,2,150\na,p,1,2,far\na,p,1,2,\na,p,1,2,007\n"

    batch = read(text, RANGED)

    assert_array_equal(batch.distance_m, [150.0, math.nan, math.nan, 7.0])
    assert batch.no_distance == 1
    assert batch.users["range"].to_pylist() == ["150", "far", None, "007"]


@pytest.mark.parametrize(
    ("direction", "column"),
    [
        ("remove", "r_c_rad"),
        ("remove", "x_displaced_px"),
        ("apply", "x_corrected_px"),
    ],
)
def test_a_column_called_like_one_of_ours_leaves_renamed(direction, column):
    """In either direction: it would make the results look like those of the other one."""
    distances = {column: PAIR}
    content = table(u=[3.0, 4.0], v=[5.0, 6.0], **distances)
    columns = {
        "image": "image",
        "point": "point",
        "x_px": "u",
        "y_px": "v",
        "distance_m": column,
    }
    ledger = Ledger()

    batch = read(content, columns, direction=direction, ledger=ledger)

    assert batch.distance_m.tolist() == PAIR
    assert batch.users[f"{column}_input"].to_pylist() == PAIR
    assert {entry.code for entry in ledger} == {"OBS-RENAMED"}


def test_a_distance_that_is_not_there():
    with refused_with("OBS-COLUMN", "perhaps 'ranges'") as refusal:
        opened(table(ranges=PAIR), RANGED)
    assert "observations.columns.distance_m" in str(refusal.value)


@as_parquet_and_csv
@pytest.mark.parametrize(
    "values",
    [
        [True, False],
        [dt.date(2024, 1, 1)] * 2,
    ],
)
def test_a_distance_of_another_kind(values, csv):
    with refused("OBS-TYPE"):
        opened(table(range=values), RANGED, csv=csv)


@pytest.mark.parametrize("name", ["x_px", "point", "range"])
def test_a_distance_that_is_something_else_too(name):
    columns = COLUMNS | {"distance_m": name}
    with refused_with("OBS-COLUMN", f"{name}.*two quantities"):
        opened(table(range=PAIR), columns, ground="range")


# What was done to a table before.


def marked(mark, **more):
    return table(**more).replace_schema_metadata({"unbend.refraction": mark})


@pytest.mark.parametrize(
    ("mark", "kind", "direction"),
    [
        ("removed", "corrected", "apply"),
        ("applied", "displaced", "remove"),
    ],
)
def test_what_is_removed_may_be_applied_and_the_reverse(mark, kind, direction):
    x = f"x_{kind}_px"
    y = f"y_{kind}_px"
    results = marked(mark, **{x: PAIR, y: [0.0, 1.0]})
    columns = COLUMNS | {"x_px": x, "y_px": y}

    observations = opened(results, columns, direction=direction)
    (batch,) = observations.batches(10)

    assert batch.x_px.tolist() == PAIR
    # The pixels of the table leave under a name that nobody takes for ours.
    assert names_of(observations.user_fields) == ["x_px_input", "y_px_input"]


@pytest.mark.parametrize(
    ("mark", "direction", "code"),
    [
        ("removed", "remove", "OBS-ALREADY-CORRECTED"),
        ("applied", "apply", "OBS-ALREADY-DISPLACED"),
    ],
)
def test_nothing_is_done_twice(mark, direction, code):
    content = marked(mark)

    with refused_with(code, f"refraction {mark}"):
        opened(content, direction=direction)

    # A mark alone says which pixels these are only together with the columns of ours.
    opened(content, direction=OPPOSITE[direction])


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(
    ("direction", "code", "kind"),
    [
        ("remove", "OBS-ALREADY-CORRECTED", "corrected"),
        ("apply", "OBS-ALREADY-DISPLACED", "displaced"),
    ],
)
def test_a_csv_has_no_mark_but_columns(direction, code, kind, axis):
    column = f"{axis}_{kind}_px"
    content = table(**{column: PAIR})
    with refused_with(code, column):
        opened(content, csv=True, direction=direction)


@pytest.mark.parametrize(
    ("direction", "kind", "meaning"),
    [
        ("remove", "displaced", "ideal"),
        ("apply", "corrected", "measured"),
    ],
)
@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_other_pixels_of_our_own_table(direction, kind, meaning, axis):
    x = f"x_{kind}_px"
    y = f"y_{kind}_px"
    content = table(**{x: PAIR, y: PAIR})
    right = COLUMNS | {"x_px": x, "y_px": y}
    opened(content, right, direction=direction)

    wrong = right | {f"{axis}_px": f"{axis}_px"}
    with refused_with("OBS-OTHER-PIXELS", meaning) as refusal:
        opened(content, wrong, direction=direction)
    assert f"observations.columns.{axis}_px: {axis}_{kind}_px" in str(refusal.value)


def test_displaced_columns_stand_where_corrected_ones_would():
    displaced = schema_of(DISPLACED_COLUMNS, {})
    corrected = schema_of(OBSERVATION_COLUMNS, {})
    text = ",".join(corrected.names)
    assert displaced.names == text.replace("corrected", "displaced").split(",")
    assert displaced.types == corrected.types
    for name in ("x_px", "y_px"):
        assert "measured" not in DISPLACED_COLUMNS[name][2]
