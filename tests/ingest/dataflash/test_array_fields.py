"""DataFlash: fields of the map that hold arrays or texts by their definition, as after one bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unbend.ingest import Log, open_log

ROWS = 300
WORDS = np.arange(1, 33, dtype="<i2")
FORMS = {
    "GPS": {
        "TimeUS": "Q",
        "I": "B",
        "Status": "B",
        "GMS": "I",
        "GWk": "H",
        "Lat": "L",
        "Lng": "L",
        "Alt": "e",
    },
    "BARO": {"TimeUS": "Q", "I": "B", "Press": "f", "Temp": "c"},
}
SIZES = {"Q": 8, "B": 1, "I": 4, "H": 2, "L": 4, "e": 4, "f": 4, "c": 2, "N": 16}


def written(
    dataflash_writer: Callable,
    field: str = "",
    letter: str = "",
    message: str = "BARO",
    more: Callable[[Any], None] = lambda _: None,
) -> bytes:
    """A log with a receiver and a barometer; a field of one of them has another letter."""
    writer = dataflash_writer()
    other = {"a": [WORDS.tobytes()[k : k + 16] for k in range(0, 64, 16)], "N": [b"wet"]}
    forms = {name: dict(form) for name, form in FORMS.items()}
    if field:
        forms[message][field] = letter
    for kind, (name, form) in enumerate(forms.items(), 20):
        letters = "".join(form.values())
        packed = letters.replace("a", "NNNN")  # 64 bytes either way
        size = 3 + sum(SIZES[code] for code in packed)
        writer.define(kind, name, letters, ",".join(form), size)
        writer.formats[name] = (kind, packed)
    for k in range(ROWS):
        time = 1_000_000 + k * 100_000
        good = {
            "GPS": (time, 0, 3, 1000 + 100 * k, 2300, 47.0, 8.0, 600.0 + 0.5 * k),
            "BARO": (time, 0, 95_000.0 - k, 20.0),
        }
        for name, values in good.items():
            cells: list[Any] = []
            for column, value in zip(forms[name], values, strict=True):
                cells += other[letter] if (name, column) == (message, field) else [value]
            writer.row(name, *cells)
    more(writer)
    data: bytes = writer.data
    return data


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[bytes], Log]:
    def write_and_open(data: bytes) -> Log:
        path = tmp_path / "flight.bin"
        path.write_bytes(data)
        return open_log(path)

    return write_and_open


def losses(log: Log) -> list[tuple[str, str, int, str]]:
    return [(e.code, e.where, e.count, e.what) for e in log.ledger if e.kind == "loss"]


def test_all_is_well_without_it(dataflash_writer: Callable, opened: Callable) -> None:
    assert losses(opened(written(dataflash_writer))) == []


@pytest.mark.parametrize("letter", ["a", "N"], ids=["array", "text"])
@pytest.mark.parametrize(
    ("field", "column"), [("Press", "pressure_pa"), ("Temp", "board_temperature_k")]
)
def test_a_field_without_numbers_is_lost_and_told(
    dataflash_writer: Callable, opened: Callable, field: str, column: str, letter: str
) -> None:
    whole = opened(written(dataflash_writer))
    log = opened(written(dataflash_writer, field, letter))
    told = [entry for entry in losses(log) if entry[3].startswith(field)]
    assert [entry[:3] for entry in told] == [("LOG-FIELDS", "BARO", ROWS)]
    assert {entry[0] for entry in losses(log)} == {"LOG-FIELDS"}
    assert not [entry for entry in losses(log) if column in entry[3]], "one cause is told twice"
    # The rest of the log, and of the message, is read as it was.
    table = log.message("BARO")
    if letter == "a":
        np.testing.assert_array_equal(table[field], np.tile(WORDS, (ROWS, 1)))
    else:
        assert table[field].tolist() == ["wet"] * ROWS
    for channel in whole.channels:
        for name, values in channel.columns.items():
            if channel.source.message != "BARO" or name != column:
                np.testing.assert_array_equal(log.channel(channel.name)[name], values)
            else:
                assert name not in log.channel(channel.name).columns


def test_an_instance_that_is_a_text_ends_no_log(
    dataflash_writer: Callable, opened: Callable
) -> None:
    log = opened(written(dataflash_writer, "I", "N"))
    assert log.channel("GPS[0]")["h_msl_m"].tolist() == [600.0 + 0.5 * k for k in range(ROWS)]
    assert log.channel("BARO")["pressure_pa"].tolist() == [95_000.0 - k for k in range(ROWS)]


@pytest.mark.parametrize(
    ("message", "field", "letter"),
    [
        ("BARO", "I", "a"),
        ("BARO", "TimeUS", "a"),
        ("GPS", "I", "a"),
        ("GPS", "TimeUS", "a"),
        ("GPS", "Status", "a"),
        ("GPS", "Status", "N"),
        ("GPS", "GMS", "a"),
        ("GPS", "GMS", "N"),
        ("GPS", "GWk", "a"),
        ("GPS", "GWk", "N"),
    ],
)
def test_what_places_a_row_and_is_no_number(
    dataflash_writer: Callable, opened: Callable, message: str, field: str, letter: str
) -> None:
    log = opened(written(dataflash_writer, field, letter, message))
    assert ("LOG-FIELDS", message, ROWS) in {entry[:3] for entry in losses(log)}
    other = {"BARO": "GPS[0]", "GPS": "BARO[0]"}[message]
    assert len(log.channel(other)) == ROWS


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("NVF", {"TimeUS": "Q", "Name": "a", "Value": "f"}),
        ("PARM", {"TimeUS": "Q", "Name": "a", "Value": "f"}),
        ("GPA", {"TimeUS": "Q", "I": "B", "AEl": "a"}),
        ("GPA", {"TimeUS": "Q", "I": "B", "AEl": "N"}),
    ],
)
def test_names_and_accuracies_that_are_arrays(
    dataflash_writer: Callable, opened: Callable, name: str, form: dict[str, str]
) -> None:
    def more(writer: Any) -> None:
        letters = "".join(form.values())
        packed = letters.replace("a", "NNNN")
        writer.define(40, name, letters, ",".join(form), 3 + sum(SIZES[c] for c in packed))
        writer.formats[name] = (40, packed)
        cells = {"Q": [], "a": [b"0123456789abcdef"] * 4, "N": [b"wet"], "f": [1.0], "B": [0]}
        for k in range(1, ROWS):  # one fix is without its accuracy
            values = [value for letter in letters for value in cells[letter]]
            writer.row(name, 1_000_000 + k * 100_000, *values)

    data = written(dataflash_writer, more=more)
    log = opened(data)
    assert log.channel("GPS[0]")["h_msl_m"].tolist() == [600.0 + 0.5 * k for k in range(ROWS)]
    assert ("LOG-FIELDS", name) in {entry[:2] for entry in losses(log)}


def test_the_table_of_a_message_whose_time_is_an_array(
    dataflash_writer: Callable, opened: Callable
) -> None:
    table = opened(written(dataflash_writer, "TimeUS", "a")).message("BARO")
    np.testing.assert_array_equal(table["TimeUS"], np.tile(WORDS, (ROWS, 1)))
    assert table["Press"].shape == (ROWS,)
