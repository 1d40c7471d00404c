"""`unbend inspect LOG --type NAME`: every message type of a log as a table."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary

from .printed import csv_rows


def rows_of_library(path, kind: str) -> list[dict[str, object]]:
    """The messages of a type as pymavlink reads them."""
    reader = DFReader_binary(str(path))
    rows = []
    while (message := reader.recv_msg()) is not None:
        if message.get_type() == kind:
            row = message.to_dict()
            del row["mavpackettype"]
            rows.append(row)
    reader.close()
    return rows


@pytest.fixture
def inspect(unbend, flown):
    """`unbend inspect` of the DataFlash log, with more words."""
    return lambda *words: unbend("inspect", flown.logs["bin"], *words)


@pytest.mark.parametrize("kind", ["BARO", "PARM", "FMT", "GPS", "CAM"])
def test_every_row_as_csv(inspect, flown, kind):
    ended = inspect("--type", kind, "--csv")
    assert ended.code == 0
    rows = csv_rows(ended.out)
    expected = rows_of_library(flown.logs["bin"], kind)
    assert len(rows) == len(expected) > 5
    for row, values in zip(rows, expected, strict=True):
        for field, value in values.items():
            cell = row[field] if isinstance(value, str) else float(row[field])
            assert cell == value


def test_times_are_utc(inspect):
    rows = csv_rows(inspect("--type", "POS", "--csv").out)
    utc = np.array([row["time_utc"].rstrip("Z") for row in rows], "datetime64[ns]")
    boot_us = np.array([int(row["TimeUS"]) for row in rows])
    assert np.all(np.diff(utc).astype(np.int64) == np.diff(boot_us) * 1000)


def test_one_instance(inspect):
    rows = csv_rows(inspect("--type", "BARO", "--csv").out)
    second = csv_rows(inspect("--type", "BARO", "--csv", "--instance", "1").out)
    assert {row["I"] for row in rows} == {"0", "1"}
    assert second == [row for row in rows if row["I"] == "1"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("BARO[1]", ("--type", "BARO", "--instance", "1")),
        ("baro[1]", ("--type", "BARO", "--instance", "1")),
        ("baro", ("--type", "BARO")),
    ],
)
def test_names_as_printed_upper_or_lower_case(inspect, name, words):
    assert inspect("--type", name, "--csv").out == inspect(*words, "--csv").out


def test_topics_upper_or_lower_case(unbend, flown):
    topic = unbend("inspect", flown.logs["mcap"], "--type", "/CABIN/pressure", "--csv")
    assert topic.code == 0
    assert "fluid_pressure" in topic.out.splitlines()[0]


def test_fields_without_csv(inspect, flown):
    ended = inspect("--type", "BARO")
    assert ended.code == 0
    for words in ("flight.bin, BARO", "Press", "float32", "lowest"):
        assert words in ended.out
    content = json.loads(inspect("--type", "BARO", "--json").out)
    expected = rows_of_library(flown.logs["bin"], "BARO")
    assert content["rows"] == len(expected)
    (pressure,) = (field for field in content["fields"] if field["field"] == "Press")
    assert float(pressure["lowest"]) == min(row["Press"] for row in expected)


@pytest.mark.parametrize("more", [(), ("--csv",)], ids=str)
def test_quiet_prints_nothing(inspect, more):
    assert inspect("--type", "BARO", *more, "--quiet").out == ""


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
def test_what_cannot_be_shown(inspect, words, exit_code, code, remedy):
    ended = inspect(*words.split())
    assert ended.code == exit_code
    assert ended.err.startswith(f"{code}: ")
    assert remedy in ended.err
