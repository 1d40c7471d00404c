"""Messages of a log as CSV and as a table of fields, against texts written by hand."""

import io

import numpy as np
import yaml

from unbend.report import message_csv
from unbend.report.message_csv import field_rows, write_messages_csv

TIME_NS = [1_500_000_000_000_000_001, 1_500_000_086_400_000_000, 2]
COLUMNS = {
    "time_ns": np.array(TIME_NS, np.int64),
    "Temp": np.array([np.nan, -2.5, 0.1]),
    "Name": np.array(["a,b", 'c"d', ""]),
    "q": np.array([[1, 2], [3, 4], [6, 5]], np.int16),
}


def test_every_cell_of_the_csv(monkeypatch):
    expected = (
        "time_utc,Temp,Name,q[0],q[1]\n"
        '2017-07-14T02:40:00.000000001Z,nan,"a,b",1,2\n'
        '2017-07-14T02:41:26.400000000Z,-2.5,"c""d",3,4\n'
        ",0.1,,6,5\n"  # a time that counts from a boot
    )
    for block in (8192, 2):
        monkeypatch.setattr(message_csv, "BLOCK", block)
        stream = io.StringIO()
        write_messages_csv(stream, COLUMNS)
        assert stream.getvalue() == expected


FIELDS = """
- {field: time_ns, type: int64, first: "2017-07-14T02:40:00.000000001Z"}
- {field: Temp, type: float64, first: nan, lowest: "-2.5", highest: "0.1"}
- {field: Name, type: "<U3", first: "a,b"}
- {field: "q[0]", type: int16, first: "1", lowest: "1", highest: "6"}
- {field: "q[1]", type: int16, first: "2", lowest: "2", highest: "5"}
"""


def test_every_cell_of_the_fields():
    assert field_rows(COLUMNS) == yaml.safe_load(FIELDS)


def test_a_type_without_rows():
    (row,) = field_rows({"Temp": np.empty(0)})
    expected = {"field": "Temp", "type": "float64", "first": ""}
    assert row == expected
