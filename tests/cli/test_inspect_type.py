"""`unbend inspect LOG --type NAME`: every message type of a log as a table."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def library(path, kind):
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(path))
    rows = []
    while (row := reader.recv_msg()) is not None:
        if row.get_type() == kind:
            rows.append(row.to_dict())
    reader.close()
    return rows


@pytest.mark.parametrize("kind", ["BARO", "PARM", "FMT", "GPS", "CAM"])
def test_every_row_as_csv(unbend, flown, kind):
    path = flown.logs["bin"]
    ended = unbend("inspect", path, "--type", kind, "--csv")
    assert ended.code == 0
    rows = rows_of(ended.out)
    theirs = library(path, kind)
    assert len(rows) == len(theirs) > 5
    for row, expected in zip(rows, theirs, strict=True):
        for field, value in expected.items():
            if field != "mavpackettype":
                assert row[field] == value if isinstance(value, str) else float(row[field]) == value


def test_times_are_utc(unbend, flown):
    rows = rows_of(unbend("inspect", flown.logs["bin"], "--type", "POS", "--csv").out)
    told = np.array([row["time_utc"].rstrip("Z") for row in rows], "datetime64[ns]")
    boot = np.array([int(row["TimeUS"]) for row in rows])
    assert np.all(np.diff(told).astype(np.int64) == np.diff(boot) * 1000)


def test_one_instance(unbend, flown):
    words = ("inspect", flown.logs["bin"], "--type", "BARO", "--csv")
    every = rows_of(unbend(*words).out)
    second = rows_of(unbend(*words, "--instance", "1").out)
    assert {row["I"] for row in every} == {"0", "1"}
    assert second == [row for row in every if row["I"] == "1"]


@pytest.mark.parametrize("name", ["BARO[1]", "baro[1]"])
def test_names_as_printed_upper_or_lower_case(unbend, flown, name):
    path = flown.logs["bin"]
    second = unbend("inspect", path, "--type", "BARO", "--csv", "--instance", "1")
    assert unbend("inspect", path, "--type", name, "--csv").out == second.out
    lower = unbend("inspect", path, "--type", "baro", "--csv")
    assert lower.out == unbend("inspect", path, "--type", "BARO", "--csv").out
    topic = unbend("inspect", flown.logs["mcap"], "--type", "/CABIN/pressure", "--csv")
    assert topic.code == 0
    assert "fluid_pressure" in topic.out.splitlines()[0]


def test_fields_without_csv(unbend, flown):
    ended = unbend("inspect", flown.logs["bin"], "--type", "BARO")
    assert ended.code == 0
    words = ("inspect", flown.logs["bin"], "--type", "BARO")
    content = json.loads(unbend(*words, "--json").out)
    library_rows = library(flown.logs["bin"], "BARO")
    assert content["rows"] == len(library_rows)
    (pressure,) = (field for field in content["fields"] if field["field"] == "Press")
    assert float(pressure["lowest"]) == min(row["Press"] for row in library_rows)
    for more in ((), ("--csv",)):
        assert unbend(*words, *more, "--quiet").out == ""
    for words in ("flight.bin, BARO", "Press", "float32", "lowest"):
        assert words in ended.out


def test_what_there_is_not(unbend, flown):
    path = flown.logs["bin"]
    ended = unbend("inspect", path, "--type", "BARRO")
    assert (ended.code, ended.err.partition(":")[0]) == (6, "LOG-NO-TYPE")
    assert "perhaps BARO" in ended.err
    ended = unbend("inspect", path, "--type", "BARO", "--instance", "7")
    assert (ended.code, ended.err.partition(":")[0]) == (6, "LOG-NO-TABLE")


@pytest.mark.parametrize(
    "words", [("--csv",), ("--instance", "1"), ("--type", "BARO", "--csv", "--json")], ids=" ".join
)
def test_words_that_do_not_go_together(unbend, flown, words):
    ended = unbend("inspect", flown.logs["bin"], *words)
    assert (ended.code, ended.err.partition(":")[0]) == (2, "INSPECT-ARGUMENTS")
