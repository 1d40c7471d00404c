"""Tables as people write them: CSV of all kinds, read without losing or guessing anything."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest

from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables import delimited
from unbend.tables.imports.user_tables import read_events
from unbend.tables.observations import open_observations

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
        "image": ["0012", "13"],
        "point": ["007", "true"],
        "x_px": [1.0, 4.0],
        "y_px": [2.0, 5.0],
        "ground": [3.0, 6.0],
        "strip": ["01", "02"],
        "n": [5, 6],
    }


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


def users_of(tmp_path, values: list[str]) -> tuple[str, list]:
    """Type and values with which a column of the user leaves."""
    rows = "".join(f"a,b,1,2,3,{value}\n" for value in values)
    table = opened(tmp_path / "o.csv", "image,point,x_px,y_px,h_g_m,own\n" + rows)
    (own,) = table.user_fields
    return str(own.type), whole(table)["own"]


@pytest.mark.parametrize(
    ("values", "kind", "left"),
    [
        (["5", "-6", "", "0"], "int64", [5, -6, None, 0]),
        ([" 5", "6 "], "int64", [5, 6]),
        (["1749722400123456789"], "int64", [1749722400123456789]),
        (["12345678901234567890"], "string", ["12345678901234567890"]),
        (["9007199254740993", "0.5"], "string", ["9007199254740993", "0.5"]),
        (["5", "05"], "string", ["5", "05"]),
        (["1.5", "007"], "string", ["1.5", "007"]),
        (["+491701234567"], "string", ["+491701234567"]),
        (["0x1F", "5"], "string", ["0x1F", "5"]),
        (["5", "-0"], "double", [5.0, -0.0]),
        (["1e400"], "string", ["1e400"]),
        (
            ["1.5", "2", "-3e-5", "1.5e+003", ".5", "inf"],
            "double",
            [1.5, 2.0, -3e-5, 1500.0, 0.5, float("inf")],
        ),
        (["."], "string", ["."]),
        (["TRUE", "false"], "bool", [True, False]),
        (["1", "true"], "string", ["1", "true"]),
        (["2025-02-28"], "date32[day]", [dt.date(2025, 2, 28)]),
        (["2025-02-28", "2025-02-31"], "string", ["2025-02-28", "2025-02-31"]),
        (["10:20"], "string", ["10:20"]),
        (["2025-06-01 10:20:30"], "timestamp[s]", [dt.datetime(2025, 6, 1, 10, 20, 30)]),
        (["2025-06-01T10:20:30+02:00"], "string", ["2025-06-01T10:20:30+02:00"]),
        (["", ""], "string", [None, None]),
        (["5", '""'], "string", ["5", ""]),
    ],
)
def test_every_value_can_be_had_back(tmp_path, values, kind, left):
    assert users_of(tmp_path, values) == (kind, left)


def test_fractions_of_seconds_are_kept(tmp_path):
    kind, values = users_of(tmp_path, ["2025-06-01T10:20:30.123456789Z", "2025-06-01T10:20:31Z"])
    assert kind == "timestamp[ns, tz=UTC]"
    assert [value.value for value in values] == [1_748_773_230_123_456_789, 1_748_773_231 * 10**9]


def test_text_that_looks_like_numbers_is_told(tmp_path):
    path = tmp_path / "o.csv"
    path.write_text("image,point,x_px,y_px,strip,word,n\n01,02,1,2,005,a7,5\n")
    ledger = Ledger()
    open_observations(path, COLUMNS, None, ledger)
    (entry,) = ledger
    assert (entry.kind, entry.code) == ("note", "OBS-CODES")
    assert "strip" in entry.what


@pytest.mark.parametrize(
    ("column", "late", "kind"),
    [
        (5, "005", "string"),
        (5, "12345678901234567890", "string"),
        (6, "1.10", "double"),
        (8, "0x10", "string"),
    ],
)
def test_a_late_code_keeps_a_column_text(tmp_path, column, late, kind):
    """The one value that tells stands some five megabytes into the file."""
    rows = 80_000
    text = long_csv(rows, {column: late})
    assert text.index("\n") < 100 < 5 << 20 < len(text)
    table = opened(tmp_path / "o.csv", text)
    names = [f.name for f in table.user_fields]
    name = text.splitlines()[0].split(",")[column]
    assert str(table.user_fields[names.index(name)].type) == kind
    found = whole(table, 50_000)[name]
    assert found[-1] == (1.1 if kind == "double" else late)
    assert found[7] == (7.0 if kind == "double" else " 7" if name == "late" else "7")


def test_a_column_that_begins_empty_is_still_one_of_numbers(tmp_path):
    lines = ["image,point,x_px,y_px,h_g_m,n,note"]
    lines += [f"a,b,1,2,3,,{'x' * 90}" for _ in range(60_000)] + ["a,b,1,2,3,17,y"]
    table = opened(tmp_path / "o.csv", "\n".join(lines) + "\n")
    assert str(table.user_fields[0].type) == "int64"
    assert whole(table, 100_000)["n"][-1] == 17


def test_a_csv_is_read_twice_at_most(tmp_path, monkeypatch):
    """One pass for rows, images and types, one for the stream; besides, the header."""
    blocks = []
    real = delimited.pa_csv.open_csv

    class Counted:
        def __init__(self, *args, **kwargs):
            self.reader, self.schema = real(*args, **kwargs), None
            self.schema = self.reader.schema

        def __enter__(self):
            self.reader.__enter__()
            return self

        def __exit__(self, *how):
            return self.reader.__exit__(*how)

        def __iter__(self):
            for batch in self.reader:
                blocks.append(batch.num_rows)
                yield batch

    monkeypatch.setattr(delimited.pa_csv, "open_csv", Counted)
    rows = 80_000
    table = opened(tmp_path / "o.csv", long_csv(rows, {5: "7.5", 6: "A-17", 2: "n/a"}))
    assert len(whole(table, rows)["x_px"]) == rows
    assert sum(blocks) == 2 * rows


@pytest.mark.parametrize(
    "content",
    [
        b"image,point,x_px,y_px,h_g_m,\xe4\na,b,1,2,3,4\n",
        b"image,point,x_px,y_px,h_g_m,n\na,b,1,2,3,4\na,b,1,2,3,\xe4\n",
    ],
)
def test_bytes_that_are_no_utf8(tmp_path, content):
    with pytest.raises(InputError, match="OBS-CSV") as refusal:
        opened(tmp_path / "o.csv", content)
    assert "UTF-8" in refusal.value.remedy


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_ground_heights_that_are_not_above_sea_level_stay_the_users(tmp_path, suffix):
    path = tmp_path / f"o.{suffix}"
    given = pa.table(
        {"image": ["a"], "point": ["p"], "x_px": [1.0], "y_px": [2.0], "h_g_m": [647.6]}
    )
    if suffix == "csv":
        pa_csv.write_csv(given, path)
    else:
        pq.write_table(given, path)
    ledger = Ledger()
    table = open_observations(path, COLUMNS, "h_g_m", ledger, ground_is_msl=False)
    assert [f.name for f in table.user_fields] == ["h_g_m_input"]
    (batch,) = table.batches(10)
    assert batch.users["h_g_m_input"].to_pylist() == batch.ground.tolist() == [647.6]
    assert [entry.code for entry in ledger] == ["OBS-RENAMED"]
    above_sea = open_observations(path, COLUMNS, "h_g_m", Ledger())
    assert above_sea.user_fields == ()


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_line_ends_marks_and_quotes(tmp_path, newline, start):
    lines = [
        "image,point,x_px,y_px,h_g_m,note",
        'a,"p,1",1.5,2,3,"two',
        'lines ""quoted"""',
        "b,q,-1e3,.5,0,",
    ]
    found = whole(opened(tmp_path / "o.csv", start + newline.join(lines)))
    assert found["image"] == ["a", "b"]
    assert found["point"] == ["p,1", "q"]
    assert found["x_px"] == [1.5, -1000.0]
    assert found["note"] == [f'two{newline}lines "quoted"', None]


def long_csv(rows: int, last: dict[int, str]) -> str:
    """Longer than what is looked at first; ``last`` replaces cells of the last row."""
    body = [
        f"img_{i % 9},p{i},{i}.25,{i},100,{i},{i},some words to make it longer {i}, {i}"
        for i in range(rows)
    ]
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
    plain = (
        values.cast(kind)
        if kind != pa.float16()
        else pa.array([np.float16(1), np.float16(2), None], kind)
    )
    table = pa.table(
        {"image": ["a"] * 3, "point": [1, 2, 3], "x_px": plain, "y_px": plain, "h_g_m": plain}
    )
    pq.write_table(table, tmp_path / "o.parquet")
    found = whole(open_observations(tmp_path / "o.parquet", COLUMNS, "h_g_m", Ledger()))
    assert found["point"] == ["1", "2", "3"]
    for name in ("x_px", "y_px", "ground"):
        assert found[name][:2] == [1.0, 2.0]
        assert np.isnan(found[name][2])


def test_categories_and_dotted_names(tmp_path):
    names = pa.array(["a.x", "b", "a.x"])
    table = pa.table(
        {
            "photo.name": names.dictionary_encode(),
            "point": names.cast("large_string"),
            "x_px": [1.0, 2.0, 3.0],
            "y_px": [1.0, 2.0, 3.0],
        }
    )
    pq.write_table(table, tmp_path / "o.parquet")
    columns = COLUMNS | {"image": "photo.name"}
    found = open_observations(tmp_path / "o.parquet", columns, None, Ledger())
    assert found.images == ("a.x", "b")
    assert whole_images(found) == ["a.x", "b", "a.x"]


def whole_images(observations) -> list[str]:
    return [name for batch in observations.batches(2) for name in batch.image.to_pylist()]


UTC = {"image": "image", "time_utc": "time"}
GPS = {"image": "image", "gps_week": "week", "gps_seconds": "seconds", "camera": "camera"}


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
        (b"", "EVENTS-CSV"),
        (b"image,tme\na,2025-06-12T10:00:00Z\n", "EVENTS-COLUMN"),
        (b"image,time\na,soon\n", "EVENTS-EMPTY"),
        (b"image,time\n", "EVENTS-EMPTY"),
        (b"image,time\na,1,2,3\nb,1\n", "EVENTS-CSV"),
        (b"image,time\na,1,2\nb,1,2\n", "EVENTS-CSV"),
        (b"image,time\nx,2025-06-12T10:00:00Z\nx,1,2\n", "EVENTS-CSV"),
        (b"image,time,time\na,2025-06-12T10:00:00Z,b\n", "EVENTS-CSV"),
        (b"image,time\n\xff\xfe,2025\n", "EVENTS-CSV"),
    ],
)
def test_tables_of_exposures_that_are_none(tmp_path, text, code):
    with pytest.raises(InputError, match=code):
        events(tmp_path, text)


@pytest.mark.parametrize("mark", [",", ";", "\t", "|", "   "])
def test_semicolons_and_tabs_separate_too(tmp_path, mark):
    found, ledger = events(tmp_path, f"image{mark}time\na{mark}2025-06-12T10:00:00Z\n")
    assert found.image.tolist() == ["a"]
    assert not len(ledger)


def test_a_column_that_nearly_has_the_name(tmp_path):
    with pytest.raises(InputError, match="perhaps 'tme'") as refusal:
        events(tmp_path, "image,tme\na,2025-06-12T10:00:00Z\n")
    assert refusal.value.remedy == "state the name of the column: events.csv.columns.time_utc"


PLAIN = "image,point,x_px,y_px,h_g_m,own\nA 1.jpg,p,1.5,-2.25,300.125,7\nB.jpg,q,2,3.5,,8\n"
AS_SPREADSHEETS_WRITE = {
    "semicolons": "image;point;x_px;y_px;h_g_m;own\r\n"
    "A 1.jpg;p;1,5;-2,25;300,125;7\r\nB.jpg;q;2;3,5;;8\r\n",
    "quoted decimal commas": "image,point,x_px,y_px,h_g_m,own\n"
    'A 1.jpg,p,"1,5","-2,25","300,125",7\nB.jpg,q,2,"3,5",,8\n',
    "tabs": PLAIN.replace(",", "\t"),
    "bars": PLAIN.replace(",", "|"),
    "a comment and a head in it": "# by hand\n#" + PLAIN.replace(",", "\t"),
    "sep=": "sep=;\n" + PLAIN.replace(",", ";"),
    "a mark of UTF-8": "\ufeff" + PLAIN,
}


@pytest.mark.parametrize("form", AS_SPREADSHEETS_WRITE)
def test_observations_as_spreadsheets_write_them(tmp_path, form):
    plain = whole(opened(tmp_path / "o.csv", PLAIN))
    assert str(whole(opened(tmp_path / "o.csv", AS_SPREADSHEETS_WRITE[form]))) == str(plain)


def test_observations_parted_by_blanks(tmp_path):
    text = "  image   point x_px\ty_px  h_g_m own\n"
    rows = [f'"A {k}.jpg"  p{k}   {k}.5 -2.25 \t 300.125   {k}  \n' for k in range(40_000)]
    table = opened(tmp_path / "o.txt", text + "".join(rows))
    found = whole(table, 100_000)
    assert table.rows == 40_000
    assert found["image"][:2] == ["A 0.jpg", "A 1.jpg"]
    assert found["x_px"] == [k + 0.5 for k in range(40_000)]
    assert found["own"] == list(range(40_000))


def test_unicode_text_of_spreadsheets(tmp_path):
    """UTF-16 with tabs."""
    path = tmp_path / "o.csv"
    path.write_bytes(AS_SPREADSHEETS_WRITE["tabs"].encode("utf-16"))
    table = open_observations(path, COLUMNS, "h_g_m", Ledger())
    assert whole(table)["image"] == ["A 1.jpg", "B.jpg"]


def test_a_decimal_point_among_decimal_commas_changes_no_other_number(tmp_path):
    text = "image;point;x_px;y_px;h_g_m\n" + "a;q;1,5;2,5;3,5\n" * 300
    found = whole(opened(tmp_path / "o.csv", text + "a;q;7.25;2,5;3,5\na;q;1,234;2,5;x\n"))
    assert found["x_px"][:301] == [1.5] * 300 + [7.25]
    assert np.isnan(found["x_px"][301])  # a thousand, or one and a quarter
    assert np.isnan(found["ground"][301])


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("image,point,x_px,y_px,h_g_m\nFl\u00e4che,p,1,2,3\n".encode("latin-1"), "is not UTF-8"),
        (b"PK\x03\x04\x14\x00\x06\x00\x08\x00\xb9\x9c" * 9, "it is a workbook"),
        ('image,point,x_px,y_px,h_g_m\na,p,"1,234","2,345",\n', "thousands or a decimal comma"),
        ("a b 1 2 3\nc d 4 5 6\n", "no header: its columns are named 1 to 5"),
        ("image;point;x_px;y_px\na;p;1,5;2;3;4\n", "by semicolons its first row has 4 fields"),
    ],
)
def test_what_is_no_table_is_named(tmp_path, content, why):
    with pytest.raises(InputError, match="OBS-C") as refusal:
        opened(tmp_path / "o.csv", content)
    assert why in refusal.value.what


def test_columns_without_names_are_called_by_numbers(tmp_path):
    columns = dict(zip(COLUMNS, "1234", strict=True))
    table = opened(tmp_path / "o.csv", "a b 1 2 3\nc d 4 5 6\n", ground="5", columns=columns)
    assert whole(table)["x_px"] == [1.0, 4.0]
    assert whole(table)["ground"] == [3.0, 6.0]
