"""Slant ranges beside the pixels: read, passed through, doubted; and marks of what was done."""

from __future__ import annotations

import datetime as dt
import math

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest

from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.observations import open_observations
from unbend.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS

COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}
RANGED = COLUMNS | {"distance_m": "range"}


def table(**more) -> pa.Table:
    rows = len(next(iter(more.values()))) if more else 2
    return pa.table(
        {
            "image": ["a"] * rows,
            "point": ["p"] * rows,
            "x_px": np.arange(rows, dtype=float),
            "y_px": np.arange(rows, dtype=float) + 0.5,
        }
        | more
    )


def opened(folder, content, columns=RANGED, *, ground=None, csv=False, ledger=None, **more):
    path = folder / ("o.csv" if csv else "o.parquet")
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    elif csv:
        pa_csv.write_csv(content, path)
    else:
        pq.write_table(content, path)
    return open_observations(path, columns, ground, Ledger() if ledger is None else ledger, **more)


def refused(code, *arguments, **more) -> str:
    with pytest.raises(InputError) as refusal:
        opened(*arguments, **more)
    assert refusal.value.code == code
    assert refusal.value.remedy
    return str(refusal.value)


@pytest.mark.parametrize("csv", [False, True])
def test_a_distance_is_read_and_leaves_unchanged(tmp_path, csv):
    given = [1500.5, None, 2000.0]
    found = opened(tmp_path, table(range=given, own=[1, 2, 3]), csv=csv)
    assert [f.name for f in found.user_fields] == ["range", "own"]
    (batch,) = found.batches(10)
    np.testing.assert_array_equal(batch.distance_m, [1500.5, math.nan, 2000.0])
    assert batch.no_distance == 0
    assert batch.users["range"].to_pylist() == given


@pytest.mark.parametrize("csv", [False, True])
def test_whole_numbers_stay_whole_numbers(tmp_path, csv):
    found = opened(tmp_path, table(range=[1500, 20]), csv=csv)
    assert found.user_fields[0].type == pa.int64()
    (batch,) = found.batches(10)
    assert batch.distance_m.tolist() == [1500.0, 20.0]
    assert batch.users["range"].to_pylist() == [1500, 20]


def test_without_the_column_there_are_no_distances(tmp_path):
    for columns in (COLUMNS, COLUMNS | {"distance_m": None}):
        found = opened(tmp_path, table(range=[1.0, 2.0]), columns)
        (batch,) = found.batches(10)
        assert batch.distance_m is None
        assert batch.no_distance == 0
        assert batch.users["range"].to_pylist() == [1.0, 2.0]


def test_what_is_no_distance_is_counted_and_taken_as_absent(tmp_path):
    given = [0.0, -3.0, math.inf, -math.inf, math.nan, None, 1e-3, 4e5]
    found = opened(tmp_path, table(range=given))
    batches = list(found.batches(3))
    assert [len(b) for b in batches] == [3, 3, 2]
    distance = np.concatenate([b.distance_m for b in batches])
    np.testing.assert_array_equal(distance, [math.nan] * 6 + [1e-3, 4e5])
    # Null and NaN are absent, not nonsense.
    assert [b.no_distance for b in batches] == [3, 1, 0]
    left = [v for b in batches for v in b.users["range"].to_pylist()]
    assert left[:4] == given[:4]


def test_words_among_the_distances_of_a_csv(tmp_path):
    text = "image,point,x_px,y_px,range\na,p,1,2,150\na,p,1,2,far\na,p,1,2,\na,p,1,2,007\n"
    found = opened(tmp_path, text, csv=True)
    (batch,) = found.batches(10)
    np.testing.assert_array_equal(batch.distance_m, [150.0, math.nan, math.nan, 7.0])
    assert batch.no_distance == 1
    assert batch.users["range"].to_pylist() == ["150", "far", None, "007"]


def test_a_distance_called_like_a_column_of_ours_leaves_renamed(tmp_path):
    ledger = Ledger()
    found = opened(
        tmp_path, table(r_c_rad=[5.0, 6.0]), COLUMNS | {"distance_m": "r_c_rad"}, ledger=ledger
    )
    (batch,) = found.batches(10)
    assert batch.distance_m.tolist() == [5.0, 6.0]
    assert batch.users["r_c_rad_input"].to_pylist() == [5.0, 6.0]
    assert [entry.code for entry in ledger] == ["OBS-RENAMED"]


def test_a_distance_that_is_not_there(tmp_path):
    words = refused("OBS-COLUMN", tmp_path, table(ranges=[1.0, 2.0]))
    assert "perhaps 'ranges'" in words
    assert "observations.columns.distance_m" in words


@pytest.mark.parametrize("csv", [False, True])
@pytest.mark.parametrize("values", [[True, False], [dt.date(2024, 1, 1)] * 2])
def test_a_distance_of_another_kind(tmp_path, values, csv):
    refused("OBS-TYPE", tmp_path, table(range=pa.array(values)), csv=csv)


@pytest.mark.parametrize("other", ["x_px", "point"])
def test_a_distance_that_is_something_else_too(tmp_path, other):
    columns = COLUMNS | {"distance_m": other}
    assert other in refused("OBS-COLUMN", tmp_path, table(), columns)


def test_a_distance_is_no_ground_height(tmp_path):
    words = refused("OBS-COLUMN", tmp_path, table(range=[1.0, 2.0]), ground="range")
    assert "two quantities" in words


# What was done to a table before.


def marked(mark: str | None, **more) -> pa.Table:
    return table(**more).replace_schema_metadata({"unbend.refraction": mark} if mark else None)


def test_what_is_removed_may_be_applied_and_the_reverse(tmp_path):
    corrected = marked("removed", x_corrected_px=[1.5, 2.5], y_corrected_px=[0.0, 1.0])
    ours = COLUMNS | {"x_px": "x_corrected_px", "y_px": "y_corrected_px"}
    found = opened(tmp_path, corrected, ours, direction="apply")
    (batch,) = found.batches(10)
    assert batch.x_px.tolist() == [1.5, 2.5]
    # The measured pixels leave under a name that nobody takes for the ideal ones.
    assert [f.name for f in found.user_fields] == ["x_px_input", "y_px_input"]

    displaced = marked("applied", x_displaced_px=[1.5, 2.5], y_displaced_px=[0.0, 1.0])
    ours = COLUMNS | {"x_px": "x_displaced_px", "y_px": "y_displaced_px"}
    (batch,) = opened(tmp_path, displaced, ours).batches(10)
    assert batch.x_px.tolist() == [1.5, 2.5]


def test_nothing_is_done_twice(tmp_path):
    assert "refraction removed" in refused(
        "OBS-ALREADY-CORRECTED", tmp_path, marked("removed"), COLUMNS
    )
    words = refused(
        "OBS-ALREADY-DISPLACED", tmp_path, marked("applied"), COLUMNS, direction="apply"
    )
    assert "refraction applied" in words
    # A mark alone says which pixels these are only together with the columns of ours.
    opened(tmp_path, marked("removed"), COLUMNS, direction="apply")
    opened(tmp_path, marked("applied"), COLUMNS)


@pytest.mark.parametrize(
    ("direction", "code", "column"),
    [
        ("remove", "OBS-ALREADY-CORRECTED", "x_corrected_px"),
        ("apply", "OBS-ALREADY-DISPLACED", "x_displaced_px"),
    ],
)
def test_a_csv_has_no_mark_but_columns(tmp_path, direction, code, column):
    content = table(**{column: [1.0, 2.0]})
    words = refused(code, tmp_path, content, COLUMNS, csv=True, direction=direction)
    assert column in words


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
    words = refused("OBS-OTHER-PIXELS", tmp_path, table(**right), wrong, direction=direction)
    assert what in words
    assert f"observations.columns.{axis}_px: {axis}_{kind}_px" in words


def test_displaced_columns_stand_where_corrected_ones_would():
    names = [name.replace("corrected", "displaced") for name in OBSERVATION_COLUMNS]
    assert list(DISPLACED_COLUMNS) == names
    assert [c[0] for c in DISPLACED_COLUMNS.values()] == [
        c[0] for c in OBSERVATION_COLUMNS.values()
    ]
    assert not any("measured" in DISPLACED_COLUMNS[n][2] for n in ("x_px", "y_px"))


@pytest.mark.parametrize(
    ("direction", "column"), [("remove", "x_displaced_px"), ("apply", "x_corrected_px")]
)
def test_a_column_of_the_other_direction_leaves_renamed(tmp_path, direction, column):
    """Under its own name it would make the results look like those of the other direction."""
    content = table(**{column: [1.0, 2.0]}, u=[3.0, 4.0], v=[5.0, 6.0])
    found = opened(tmp_path, content, COLUMNS | {"x_px": "u", "y_px": "v"}, direction=direction)
    assert f"{column}_input" in [f.name for f in found.user_fields]
