"""Tables as people write them: CSV of all kinds, read without losing or guessing anything."""

import datetime as dt
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pytest

from tests.helpers import refused
from tests.tables.checks import refused_with
from tests.tables.observed import COLUMNS, columns_of, opened
from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports.user_tables import read_events

HEAD = "image,point,x_px,y_px,h_g_m"
LONGER_THAN_A_BLOCK = 5 << 20  # bytes; what is read of a CSV at a time is less


def open_text(content, **options):
    return opened(content, ground="h_g_m", **options)


def read(content, **options) -> dict[str, list]:
    return columns_of(open_text(content, **options))


def table_of(names, rows):
    """A CSV of observations with more columns."""
    return "\n".join([f"{HEAD},{names}", *rows, ""])


def test_names_are_text_whatever_they_look_like():
    rows = ["0012,007,1,2,3,01,5", "13,true,4,5,6,02,6"]

    table = open_text(table_of("strip,n", rows))

    assert table.images == ("0012", "13")
    assert columns_of(table) == {
        "image": ["0012", "13"],
        "point": ["007", "true"],
        "x_px": [1.0, 4.0],
        "y_px": [2.0, 5.0],
        "ground": [3.0, 6.0],
        "strip": ["01", "02"],
        "n": [5, 6],
    }


def test_words_that_look_empty_are_kept():
    rows = ["NA,null,1,2,3,NA", 'nan,,1,2,,""', ",p,nan,2,3,"]

    table = open_text(table_of("land", rows))
    columns = columns_of(table)

    assert columns["image"] == ["NA", "nan", None]
    assert columns["point"] == ["null", None, "p"]
    assert columns["land"] == ["NA", "", None]
    assert np.isnan(columns["x_px"][2])
    assert np.isnan(columns["ground"][1])
    assert table.images == ("NA", "nan")


SECOND = dt.datetime(2025, 6, 1, 10, 20, 30)
NANOSECONDS = pd.Timestamp("2025-06-01T10:20:30.123456789Z")


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
        (["2025-06-01 10:20:30"], "timestamp[s]", [SECOND]),
        (["2025-06-01T10:20:30Z"], "timestamp[s, tz=UTC]", [SECOND.replace(tzinfo=dt.UTC)]),
        (["2025-06-01T10:20:30.123456789Z"], "timestamp[ns, tz=UTC]", [NANOSECONDS]),
        (["2025-06-01T10:20:30+02:00"], "string", ["2025-06-01T10:20:30+02:00"]),
        (["", ""], "string", [None, None]),
        (["5", '""'], "string", ["5", ""]),
    ],
)
def test_every_value_can_be_had_back(values, kind, left):
    rows = [f"a,b,1,2,3,{value}" for value in values]

    table = open_text(table_of("own", rows))

    (field,) = table.user_fields
    assert str(field.type) == kind
    assert columns_of(table)["own"] == left


def test_text_that_looks_like_numbers_is_told():
    text = "image,point,x_px,y_px,strip,word,n\n01,02,1,2,005,a7,5\n"
    ledger = Ledger()

    opened(text, ledger=ledger)

    (entry,) = ledger
    assert entry.kind == "note"
    assert entry.code == "OBS-CODES"
    assert "strip" in entry.what


LONG = 100_000
LAST_BUT_ONE = LONG - 2
LATE = {
    "whole": ("double", [float(LAST_BUT_ONE), 7.5]),
    "code": ("string", [str(LAST_BUT_ONE), "A-17"]),
    "zeros": ("string", [str(LAST_BUT_ONE), "005"]),
    "digits": ("string", [str(LAST_BUT_ONE), "12345678901234567890"]),
    "decimal": ("double", [float(LAST_BUT_ONE), 1.1]),
    "blank": ("string", [f" {LAST_BUT_ONE}", "0x10"]),
    "empty": ("int64", [None, 17]),
}
"""Columns: their type, which the last row decides, and the values of the last two rows."""


@pytest.fixture(scope="module")
def long_csv():
    """Longer than what is read at a time; the last row contradicts all others."""
    rows = [f"img,p{i},{i}.25,1,100,{i},{i},{i},{i},{i}, {i}," for i in range(LONG - 1)]
    rows.append("img,p,n/a,1,100,7.5,A-17,005,12345678901234567890,1.10,0x10,17")
    text = table_of(",".join(LATE), rows)
    assert len(text) > LONGER_THAN_A_BLOCK
    return text


def test_a_late_value_decides_the_type_of_a_column(long_csv):
    table = open_text(long_csv)
    columns = columns_of(table, 40_000)

    assert table.rows == LONG
    assert columns["x_px"][:-1] == [i + 0.25 for i in range(LONG - 1)]
    assert np.isnan(columns["x_px"][-1])
    assert [field.name for field in table.user_fields] == list(LATE)
    for field in table.user_fields:
        kind, last_values = LATE[field.name]
        assert str(field.type) == kind
        assert columns[field.name][-2:] == last_values


def test_batches_do_not_end_where_blocks_do(long_csv):
    """What is read in one block ends within the second batch."""
    table = open_text(long_csv)

    batches = list(table.batches(40_000))
    (second,) = table.batches(40_000, 1, 2)

    assert [len(batch) for batch in batches] == [40_000, 40_000, 20_000]
    assert second.image.equals(batches[1].image)
    assert second.x_px.tolist() == batches[1].x_px.tolist()


def test_a_late_row_with_a_field_too_few(long_csv):
    with refused("OBS-CSV"):
        opened(long_csv + "a,b,1,2\n")


def test_a_csv_is_opened_for_its_head_its_types_and_its_rows_alone(monkeypatch, long_csv):
    openings = []
    open_csv = pa_csv.open_csv

    def counted(*arguments, **options):
        openings.append(arguments)
        return open_csv(*arguments, **options)

    monkeypatch.setattr(pa_csv, "open_csv", counted)
    for text in (PLAIN, long_csv):
        openings.clear()
        read(text)
        assert len(openings) == 3


@pytest.mark.parametrize("length", [1, 2, 3, 6, 7])
def test_batches_of_any_length_hold_the_same_rows(length):
    rows = [f"img{k % 2},p{k},{k}.25,{k}.75,{100 + k},n{k}" for k in range(7)]

    table = open_text(table_of("note", rows))

    lengths = [len(batch) for batch in table.batches(length)]
    assert set(lengths[:-1]) <= {length}
    assert columns_of(table, length) == {
        "image": ["img0", "img1", "img0", "img1", "img0", "img1", "img0"],
        "point": [f"p{k}" for k in range(7)],
        "x_px": [k + 0.25 for k in range(7)],
        "y_px": [k + 0.75 for k in range(7)],
        "ground": [100.0 + k for k in range(7)],
        "note": [f"n{k}" for k in range(7)],
    }


@pytest.mark.parametrize(
    "content",
    [
        b"image,point,x_px,y_px,h_g_m,\xe4\na,b,1,2,3,4\n",
        b"image,point,x_px,y_px,h_g_m,n\na,b,1,2,3,4\na,b,1,2,3,\xe4\n",
    ],
)
def test_bytes_that_are_no_utf8(content):
    with refused("OBS-CSV", remedy="UTF-8"):
        opened(content)


def test_ground_heights_that_are_not_above_sea_level_stay_the_users():
    text = f"{HEAD}\na,p,1,2,647.6\n"
    ledger = Ledger()

    columns = read(text, ledger=ledger, ground_is_msl=False)

    assert columns["h_g_m_input"] == columns["ground"] == [647.6]
    assert [entry.code for entry in ledger] == ["OBS-RENAMED"]
    assert open_text(text).user_fields == ()


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_line_ends_marks_and_quotes(newline, start):
    lines = [f"{HEAD},note", 'a,"p,1",1.5,2,3,"two', 'lines ""quoted"""', "b,q,-1e3,.5,0,"]

    columns = read(start + newline.join(lines))

    assert columns["image"] == ["a", "b"]
    assert columns["point"] == ["p,1", "q"]
    assert columns["x_px"] == [1.5, -1000.0]
    assert columns["note"] == [f'two{newline}lines "quoted"', None]


def test_a_quoted_line_break_at_the_border_of_two_blocks():
    note = '"first\nsecond\nthird"'
    rows = [f"img,p{i},1,2,3,{note}" for i in range(200_000)]
    text = table_of("note", rows)
    assert len(text) > LONGER_THAN_A_BLOCK

    columns = columns_of(opened(text), 100_000)

    assert columns["point"] == [f"p{i}" for i in range(200_000)]
    assert set(columns["note"]) == {"first\nsecond\nthird"}


def test_a_row_longer_than_anything():
    longest = "x" * (20 << 20)
    text = table_of("note", ["a,b,1,2,3,x", f"a,b,1,2,3,{longest}"])
    with refused("OBS-CSV"):
        opened(text)


@pytest.mark.parametrize(
    "kind",
    [
        pa.float32(),
        pa.float16(),
        pa.int16(),
        pa.decimal128(22, 3),
        pa.string(),
        pa.large_string(),
    ],
)
def test_numbers_of_any_type(kind):
    numbers = pa.array([1, 2, None], pa.float32()).cast(kind)
    content = {
        "image": ["a"] * 3,
        "point": [1, 2, 3],
        "x_px": numbers,
        "y_px": numbers,
        "h_g_m": numbers,
    }

    columns = read(pa.table(content))

    assert columns["point"] == ["1", "2", "3"]
    for name in ("x_px", "y_px", "ground"):
        assert columns[name] == pytest.approx([1.0, 2.0, np.nan], nan_ok=True)


def test_categories_and_dotted_names():
    names = pa.array(["a.x", "b", "a.x"])
    numbers = [1.0, 2.0, 3.0]
    content = {
        "photo.name": names.dictionary_encode(),
        "point": names.cast("large_string"),
        "x_px": numbers,
        "y_px": numbers,
    }
    columns = COLUMNS | {"image": "photo.name"}

    table = opened(pa.table(content), columns)

    assert table.images == ("a.x", "b")
    assert columns_of(table, 2)["image"] == ["a.x", "b", "a.x"]


UTC = {"image": "image", "time_utc": "time"}
GPS = {
    "image": "image",
    "gps_week": "week",
    "gps_seconds": "seconds",
    "camera": "camera",
}


def events(text, columns=UTC, encoding="utf-8"):
    path = Path("e.csv")
    path.write_text(text, encoding=encoding, newline="")
    ledger = Ledger()
    return read_events(path, columns, ledger), ledger


def test_times_with_and_without_a_zone():
    text = (
        "\ufeffimage,time\r\n"
        "a,2025-06-12T10:00:00.123456789Z\r\n"
        "b,2025-06-12T12:00:00+02:00\r\n"
        "007,2025-06-12 10:00:00\r\n"
    )

    table, ledger = events(text)

    ten = 1_749_722_400_000_000_000
    assert table.image.tolist() == ["a", "b", "007"]
    assert table.time_ns.tolist() == [ten + 123_456_789, ten, ten]
    assert len(ledger) == 0


def test_gps_weeks_and_seconds_with_the_leap_seconds_of_their_date():
    """2016-12-31T23:59:42Z and 2017-01-01T00:00:00Z: 17 and 18 leap seconds."""
    text = "image,week,seconds,camera\na,1930,18.5,n\nb,1929,604799,n\n"

    table, _ = events(text, GPS)

    midnight_ns = 1_483_228_800 * 10**9
    since_ns = table.time_ns - midnight_ns
    assert since_ns.tolist() == [500_000_000, -18 * 10**9]
    assert table.camera.tolist() == ["n", "n"]


def test_seconds_beyond_a_week_are_no_time():
    """2300 weeks after 1980-01-06 is 2024-02-04; 18 leap seconds. Line 1 holds the names."""
    text = (
        "image,week,seconds,camera\n"
        "a,2300,18.5,n\n"
        "b,2300,-1,n\n"
        "c,2300,604801,n\n"
        "d,0,5,n\n"
        "e,2300,604800,n\n"
    )

    table, ledger = events(text, GPS)

    assert table.image.tolist() == ["a", "e"]
    sunday = np.datetime64("2024-02-04T00:00:00", "ns")
    since_ns = table.time_ns - sunday.astype(np.int64)
    assert since_ns.tolist() == [500_000_000, (604_800 - 18) * 10**9]
    (entry,) = ledger
    assert entry.code == "EVENTS-TIME"
    assert entry.kind == "loss"
    assert entry.count == 3
    assert "first in line 3" in entry.what


def test_rows_without_a_time_are_counted():
    table, ledger = events("image,time\na,soon\nb,2025-06-12T10:00:00Z\nc,\n")
    assert table.image.tolist() == ["b"]
    (entry,) = ledger
    assert entry.code == "EVENTS-TIME"
    assert entry.count == 2
    assert "line 2" in entry.what


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "EVENTS-CSV"),
        ("image,tme\na,2025-06-12T10:00:00Z\n", "EVENTS-COLUMN"),
        ("image,time\n\xff\xfe,2025\n", "EVENTS-CSV"),
        ("image,time\na,soon\n", "EVENTS-EMPTY"),
        ("image,time\n", "EVENTS-EMPTY"),
        ("image,time\na,1,2,3\nb,1\n", "EVENTS-CSV"),
        ("image,time\na,1,2\nb,1,2\n", "EVENTS-CSV"),
        ("image,time\nx,2025-06-12T10:00:00Z\nx,1,2\n", "EVENTS-CSV"),
        ("image,time,time\na,2025-06-12T10:00:00Z,b\n", "EVENTS-CSV"),
    ],
)
def test_tables_of_exposures_that_are_none(text, code):
    with refused(code):
        events(text, encoding="latin-1")


def test_a_column_that_nearly_has_the_name():
    with refused_with("EVENTS-COLUMN", "perhaps 'tme'") as refusal:
        events("image,tme\na,2025-06-12T10:00:00Z\n")
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
    "UTF-16": PLAIN.replace(",", "\t").encode("utf-16"),
}


@pytest.mark.parametrize("form", AS_SPREADSHEETS_WRITE)
def test_observations_as_spreadsheets_write_them(form):
    plain = read(PLAIN)

    columns = read(AS_SPREADSHEETS_WRITE[form])

    assert str(columns) == str(plain)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_observations_parted_by_blanks(encoding):
    rows = [f'"A {k}.jpg"  p{k}   {k}.5 -2.25 \t 300.125   {k}  \n' for k in range(28_000)]
    text = "  image   point x_px\ty_px  h_g_m own\n" + "".join(rows)

    columns = read(text.encode(encoding))

    assert columns["image"] == [f"A {k}.jpg" for k in range(28_000)]
    assert columns["x_px"] == [k + 0.5 for k in range(28_000)]
    assert columns["own"] == list(range(28_000))


def test_a_decimal_point_among_decimal_commas_changes_no_other_number():
    usual = "a;q;1,5;2,5;3,5\n" * 300
    other = "a;q;7.25;2,5;3,5\na;q;1,234;2,5;x\n"

    columns = read("image;point;x_px;y_px;h_g_m\n" + usual + other)

    assert columns["x_px"][:301] == [1.5] * 300 + [7.25]
    assert np.isnan(columns["x_px"][301])  # a thousand, or one and a quarter
    assert np.isnan(columns["ground"][301])


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
def test_what_is_no_table_is_named(content, why):
    with pytest.raises(InputError, match="OBS-C") as refusal:
        open_text(content)
    assert why in refusal.value.what


def test_columns_without_names_are_called_by_numbers():
    numbers = dict(zip(COLUMNS, "1234", strict=True))

    table = opened("a b 1 2 3\nc d 4 5 6\n", numbers, ground="5")

    columns = columns_of(table)
    assert columns["x_px"] == [1.0, 4.0]
    assert columns["ground"] == [3.0, 6.0]
