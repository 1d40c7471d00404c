"""`unbend inspect LOG --type NAME`: every message type of a log as a table."""

import io
import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
from pymavlink.DFReader import DFReader_binary

from tests.ingest.dataflash.library import library_tables


def rows_of_library(path, kind):
    """The messages of a type as pymavlink reads them."""
    table = library_tables(DFReader_binary(str(path)))[kind]
    return pd.DataFrame(table).to_dict("records")


@pytest.fixture
def log(flown):
    """A DataFlash log."""
    return flown.logs["bin"]


@pytest.fixture
def inspect(unbend, log):
    """`unbend inspect --type` of it."""
    return partial(unbend, "inspect", log, "--type")


@pytest.fixture
def csv_of(inspect):
    """A message type as CSV, from words behind `--type`."""

    def table(*words):
        ended = inspect(*words, "--csv")
        assert ended.code == 0
        return pd.read_csv(io.StringIO(ended.out), engine="python")

    return table


@pytest.mark.parametrize(
    "kind",
    [
        "BARO",
        "PARM",
        "FMT",
        "GPS",
        "CAM",
    ],
)
def test_every_row_as_csv(csv_of, log, kind):
    rows = csv_of(kind).to_dict("records")
    expected = rows_of_library(log, kind)
    assert len(rows) == len(expected) > 5
    for row, values in zip(rows, expected, strict=True):
        shown = {field: row[field] for field in values}
        assert shown == values


def test_times_are_utc(csv_of):
    rows = csv_of("POS")
    utc = pd.to_datetime(rows["time_utc"]).astype("datetime64[ns, UTC]")
    boot_ns = 1000 * rows["TimeUS"]
    np.testing.assert_array_equal(np.diff(utc.astype(np.int64)), np.diff(boot_ns))


def test_one_instance(csv_of):
    rows = csv_of("BARO")
    assert set(rows["I"]) == {0, 1}
    second = rows[rows["I"] == 1].reset_index(drop=True)
    alone = csv_of("BARO", "--instance", "1")
    pd.testing.assert_frame_equal(alone, second, check_exact=True)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("BARO[1]", ["BARO", "--instance", "1"]),
        ("baro[1]", ["BARO", "--instance", "1"]),
        ("baro", ["BARO"]),
    ],
)
def test_names_as_printed_upper_or_lower_case(inspect, name, words):
    assert inspect(name, "--csv").out == inspect(*words, "--csv").out


def test_topics_upper_or_lower_case(unbend, flown):
    words = ("--type", "/CABIN/pressure", "--csv")
    topic = unbend("inspect", flown.logs["mcap"], *words)
    assert topic.code == 0
    head = topic.out.splitlines()[0]
    assert "fluid_pressure" in head


def test_fields_without_csv(inspect, log):
    ended = inspect("BARO")
    assert ended.code == 0
    for words in ("flight.bin, BARO", "Press", "float32", "lowest"):
        assert words in ended.out
    as_json = inspect("BARO", "--json")
    content = json.loads(as_json.out)
    expected = pd.DataFrame(rows_of_library(log, "BARO"))
    assert content["rows"] == len(expected)
    fields = content["fields"]
    by_name = {field["field"]: field for field in fields}
    assert len(by_name) == len(fields)
    lowest = by_name["Press"]["lowest"]
    assert float(lowest) == expected["Press"].min()


@pytest.mark.parametrize("more", [(), ("--csv",)], ids=str)
def test_quiet_prints_nothing(inspect, more):
    assert inspect("BARO", *more, "--quiet").out == ""


@pytest.mark.parametrize(
    ("words", "exit_code", "code", "remedy"),
    [
        ("--type BARRO", 6, "LOG-NO-TYPE", "perhaps BARO"),
        ("--type BARO --instance 7", 6, "LOG-NO-TABLE", ""),
        ("--csv", 2, "INSPECT-ARGUMENTS", ""),
        ("--instance 1", 2, "INSPECT-ARGUMENTS", ""),
        ("--type BARO --csv --json", 2, "INSPECT-ARGUMENTS", ""),
    ],
)
def test_what_cannot_be_shown(unbend, log, words, exit_code, code, remedy):
    ended = unbend("inspect", log, *words.split())
    assert ended.code == exit_code
    assert ended.err.startswith(f"{code}: ")
    assert remedy in ended.err
