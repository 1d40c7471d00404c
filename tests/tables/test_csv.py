"""Tables as people write them: CSV of all kinds, read without losing or guessing anything."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.tables.events import EventColumns, read_events
from pipeline.tables.observations import open_observations

COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def opened(path, content, ground="h_g_m", columns=COLUMNS):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return open_observations(path, columns, ground, Ledger())


def whole(observations, rows=1000) -> dict[str, list]:
    found: dict[str, list] = {}
    for batch in observations.batches(rows):
        columns = {"image": batch.image, "point": batch.point} | batch.users
        for name, values in (("x_px", batch.x_px), ("y_px", batch.y_px), ("ground", batch.ground)):
            columns[name] = pa.array(values)
        for name, values in columns.items():
            found.setdefault(name, []).extend(values.to_pylist())
    return found


def test_names_are_text_whatever_they_look_like(tmp_path):
    table = opened(
        tmp_path / "o.csv",
        "image,point,x_px,y_px,h_g_m,strip,n\n0012,007,1,2,3,01,5\n13,true,4,5,6,02,6\n",
    )
    assert table.images == ("0012", "13")
    assert whole(table) == {
        "image": ["0012", "13"], "point": ["007", "true"], "x_px": [1.0, 4.0], "y_px": [2.0, 5.0],
        "ground": [3.0, 6.0], "strip": ["01", "02"], "n": [5, 6],
    }  # fmt: skip


def test_words_that_look_empty_are_kept(tmp_path):
    table = opened(
        tmp_path / "o.csv",
        'image,point,x_px,y_px,h_g_m,land\nNA,null,1,2,3,NA\nnan,,1,2,,""\n,p,nan,2,3,\n',
    )
    found = whole(table)
    assert found["image"] == ["NA", "nan", None]
    assert found["point"] == ["null", None, "p"]
    assert found["land"] == ["NA", "", None]
    assert np.isnan(found["x_px"][2])
    assert np.isnan(found["ground"][1])
    assert table.images == ("NA", "nan")


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_line_ends_marks_and_quotes(tmp_path, newline, start):
    lines = ["image,point,x_px,y_px,h_g_m,note", 'a,"p,1",1.5,2,3,"two', 'lines ""quoted"""',
             "b,q,-1e3,.5,0,"]  # fmt: skip
    found = whole(opened(tmp_path / "o.csv", start + newline.join(lines)))
    assert found["image"] == ["a", "b"]
    assert found["point"] == ["p,1", "q"]
    assert found["x_px"] == [1.5, -1000.0]
    assert found["note"] == [f'two{newline}lines "quoted"', None]


def long_csv(rows: int, last: dict[int, str]) -> str:
    """Longer than what is looked at first; ``last`` replaces cells of the last row."""
    body = [f"img_{i % 9},p{i},{i}.25,{i},100,{i},{i},some words to make it longer {i}, {i}"
            for i in range(rows)]  # fmt: skip
    cells = body[-1].split(",")
    for column, text in last.items():
        cells[column] = text
    body[-1] = ",".join(cells)
    return "image,point,x_px,y_px,h_g_m,whole,code,note,late\n" + "\n".join(body) + "\n"


def test_a_late_row_may_contradict_the_first_block(tmp_path):
    rows = 80_000
    text = long_csv(rows, {5: "7.5", 6: "A-17", 2: "n/a", 8: "2024"})
    assert len(text) > 5 << 20
    table = opened(tmp_path / "o.csv", text)
    types = {f.name: str(f.type) for f in table.user_fields}
    assert types["whole"] == "double"
    assert types["code"] == "string"
    found = whole(table, 33_333)
    assert len(found["x_px"]) == rows == table.rows
    assert found["whole"][-2:] == [rows - 2.0, 7.5]
    assert found["code"][-2:] == [str(rows - 2), "A-17"]
    assert found["code"][0] == "0"
    assert np.isnan(found["x_px"][-1])
    assert found["x_px"][:3] == [0.25, 1.25, 2.25]
    assert found["point"][-1] == f"p{rows - 1}"


def test_a_late_row_with_a_field_too_few(tmp_path):
    text = long_csv(80_000, {}) + "a,b,1,2\n"
    with pytest.raises(InputError, match="OBS-CSV"):
        opened(tmp_path / "o.csv", text)


def test_a_quoted_line_break_at_the_border_of_two_blocks(tmp_path):
    note = '"first\nsecond\nthird"'
    rows = [f"img,p{i},1,2,3,{note}" for i in range(200_000)]
    text = "image,point,x_px,y_px,h_g_m,note\n" + "\n".join(rows) + "\n"
    assert len(text) > 5 << 20
    found = whole(opened(tmp_path / "o.csv", text), 100_000)
    assert found["point"] == [f"p{i}" for i in range(200_000)]
    assert set(found["note"]) == {"first\nsecond\nthird"}


def test_a_row_longer_than_anything(tmp_path):
    text = "image,point,x_px,y_px,h_g_m,note\na,b,1,2,3,x\na,b,1,2,3," + "x" * (20 << 20) + "\n"
    with pytest.raises(InputError, match="OBS-CSV"):
        opened(tmp_path / "o.csv", text)


def test_dates_and_truths_stay_what_they_are(tmp_path):
    table = opened(
        tmp_path / "o.csv",
        "image,point,x_px,y_px,h_g_m,when,ok\na,b,1,2,3,2025-06-01T10:20:30Z,true\n",
    )
    when, ok = table.user_fields
    assert pa.types.is_timestamp(when.type)
    assert when.type.tz == "UTC"
    assert ok.type == pa.bool_()
    found = whole(table)
    assert found["ok"] == [True]
    assert found["when"][0].isoformat() == "2025-06-01T10:20:30+00:00"


@pytest.mark.parametrize(
    "kind",
    [pa.float32(), pa.float16(), pa.int16(), pa.decimal128(22, 3), pa.string(), pa.large_string()],
)
def test_numbers_of_any_type(tmp_path, kind):
    values = pa.array([1, 2, None], pa.int64())
    plain = values.cast(kind) if kind != pa.float16() else pa.array(
        [np.float16(1), np.float16(2), None], kind)  # fmt: skip
    table = pa.table({"image": ["a"] * 3, "point": [1, 2, 3], "x_px": plain, "y_px": plain,
                      "h_g_m": plain})  # fmt: skip
    pq.write_table(table, tmp_path / "o.parquet")
    found = whole(open_observations(tmp_path / "o.parquet", COLUMNS, "h_g_m", Ledger()))
    assert found["point"] == ["1", "2", "3"]
    for name in ("x_px", "y_px", "ground"):
        assert found[name][:2] == [1.0, 2.0]
        assert np.isnan(found[name][2])


def test_categories_and_dotted_names(tmp_path):
    names = pa.array(["a.x", "b", "a.x"])
    table = pa.table({"photo.name": names.dictionary_encode(), "point": names.cast("large_string"),
                      "x_px": [1.0, 2.0, 3.0], "y_px": [1.0, 2.0, 3.0]})  # fmt: skip
    pq.write_table(table, tmp_path / "o.parquet")
    columns = COLUMNS | {"image": "photo.name"}
    found = open_observations(tmp_path / "o.parquet", columns, None, Ledger())
    assert found.images == ("a.x", "b")
    assert whole_images(found) == ["a.x", "b", "a.x"]


def whole_images(observations) -> list[str]:
    return [name for batch in observations.batches(2) for name in batch.image.to_pylist()]


UTC = EventColumns("image", "time", None, None, None)
GPS = EventColumns("image", None, "week", "seconds", "camera")


def events(tmp_path, text, columns=UTC):
    path = tmp_path / "e.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    ledger = Ledger()
    return read_events(path, columns, ledger), ledger


def test_times_with_and_without_a_zone(tmp_path):
    found, ledger = events(
        tmp_path,
        "\ufeffimage,time\r\na,2025-06-12T10:00:00.123456789Z\r\nb,2025-06-12T12:00:00+02:00\r\n"
        "007,2025-06-12 10:00:00\r\n",
    )
    ten = 1_749_722_400_000_000_000
    assert found.image.tolist() == ["a", "b", "007"]
    assert found.time_ns.tolist() == [ten + 123_456_789, ten, ten]
    assert len(ledger) == 0


def test_gps_weeks_and_seconds_with_the_leap_seconds_of_their_date(tmp_path):
    """2016-12-31T23:59:42Z and 2017-01-01T00:00:00Z: 17 and 18 leap seconds."""
    found, _ = events(
        tmp_path,
        "image,week,seconds,camera\na,1930,17.0,n\nb,1930,18.5,n\nc,1929,604799,n\n",
        GPS,
    )
    midnight = 1_483_228_800
    assert found.time_ns[1] == (midnight + 0.5) * 1e9
    assert found.time_ns[2] == (midnight - 18) * 10**9
    assert found.camera.tolist() == ["n"] * 3


def test_rows_without_a_time_are_counted(tmp_path):
    found, ledger = events(tmp_path, "image,time\na,soon\nb,2025-06-12T10:00:00Z\nc,\n")
    assert found.image.tolist() == ["b"]
    (entry,) = ledger
    assert (entry.code, entry.kind, entry.count) == ("EVENTS-TIME", "loss", 2)
    assert "line 2" in entry.what


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (b"", "EVENTS-CSV"), (b"image;time\na;2025-06-12T10:00:00Z\n", "EVENTS-COLUMN"),
        (b"image,tme\na,2025-06-12T10:00:00Z\n", "EVENTS-COLUMN"),
        (b"image,time\na,soon\n", "EVENTS-EMPTY"), (b"image,time\n", "EVENTS-EMPTY"),
        (b"image,time\na,1,2,3\nb,1\n", "EVENTS-CSV"),
        (b"image,time\na,1,2\nb,1,2\n", "EVENTS-CSV"),
        (b"image,time\nx,2025-06-12T10:00:00Z\nx,1,2\n", "EVENTS-CSV"),
        (b"image,time,time\na,2025-06-12T10:00:00Z,b\n", "EVENTS-CSV"),
        (b"image,time\n\xff\xfe,2025\n", "EVENTS-CSV"),
    ],
)  # fmt: skip
def test_tables_of_exposures_that_are_none(tmp_path, text, code):
    with pytest.raises(InputError, match=code):
        events(tmp_path, text)
