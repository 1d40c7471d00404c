"""DataFlash: fields of the map that hold arrays or texts by their definition, as after one bit."""

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal

from tests.ingest.written_logs import DataFlashWriter
from unbend.ingest import Log

ROWS = 300
WORDS = np.arange(
    1,
    33,
    dtype="<i2",
)
NOT_NUMBERS = {
    "a": WORDS.tobytes(),
    "N": b"wet",
}
FORMS = {
    "GPS": ("QBBIHLLe", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt"),
    "BARO": ("QBfc", "TimeUS,I,Press,Temp"),
}


def flight(message: str = "", field: str = "", letter: str = "") -> DataFlashWriter:
    """A log with a receiver and a barometer; a field of one of them has another letter."""
    writer = DataFlashWriter()
    changed = FORMS[message][1].split(",").index(field) if message else -1
    for kind, (name, (letters, columns)) in enumerate(FORMS.items(), 20):
        if name == message:
            letters = letters[:changed] + letter + letters[changed + 1 :]
        writer.define(
            kind,
            name,
            letters,
            columns,
        )
    for k in range(ROWS):
        time_us = 1_000_000 + k * 100_000
        rows: dict[str, list[float | bytes]] = {
            "GPS": [time_us, 0, 3, 1000 + 100 * k, 2300, 47.0, 8.0, 600.0 + 0.5 * k],
            "BARO": [time_us, 0, 95_000.0 - k, 20.0],
        }
        if message:
            rows[message][changed] = NOT_NUMBERS[letter]
        for name, values in rows.items():
            writer.row(name, *values)
    return writer


def losses(log: Log) -> list[tuple[str, str, int, str]]:
    return [(e.code, e.where, e.count, e.what) for e in log.ledger if e.kind == "loss"]


def test_all_is_well_without_it(opened):
    assert losses(opened(flight().data)) == []


@pytest.mark.parametrize(
    "letter",
    ["a", "N"],
    ids=["array", "text"],
)
@pytest.mark.parametrize(
    ("field", "column"), [("Press", "pressure_pa"), ("Temp", "board_temperature_k")]
)
def test_a_field_without_numbers_is_lost_and_told(opened, field, column, letter):
    whole = opened(flight().data)
    log = opened(flight("BARO", field, letter).data)
    lost = losses(log)
    of_field = [entry[:3] for entry in lost if entry[3].startswith(field)]
    assert of_field == [("LOG-FIELDS", "BARO", ROWS)]
    assert {code for code, *_ in lost} == {"LOG-FIELDS"}
    assert not [entry for entry in lost if column in entry[3]], "one cause is told twice"
    # The rest of the log, and of the message, is read as it was.
    cells = log.message("BARO")[field]
    assert cells.tolist() == ([WORDS.tolist()] if letter == "a" else ["wet"]) * ROWS
    assert column not in log.channel("BARO[0]").columns
    for channel in whole.channels:
        for name, values in channel.columns.items():
            if channel.source.message != "BARO" or name != column:
                assert_array_equal(
                    log.channel(channel.name)[name],
                    values,
                )


def test_an_instance_that_is_a_text_ends_no_log(opened):
    log = opened(flight("BARO", "I", "N").data)
    assert log.channel("GPS[0]")["h_msl_m"].tolist() == [600.0 + 0.5 * k for k in range(ROWS)]
    assert log.channel("BARO")["pressure_pa"].tolist() == [95_000.0 - k for k in range(ROWS)]


IDENTITIES = yaml.safe_load("""
- [BARO, 'I', 'a']
- [BARO, TimeUS, 'a']
- [GPS, 'I', 'a']
- [GPS, TimeUS, 'a']
- [GPS, Status, 'a']
- [GPS, Status, 'N']
- [GPS, GMS, 'a']
- [GPS, GMS, 'N']
- [GPS, GWk, 'a']
- [GPS, GWk, 'N']
""")


@pytest.mark.parametrize(("message", "field", "letter"), IDENTITIES)
def test_what_places_a_row_and_is_no_number(opened, message, field, letter):
    log = opened(flight(message, field, letter).data)
    assert ("LOG-FIELDS", message, ROWS) in {entry[:3] for entry in losses(log)}
    whole_channel = {"BARO": "GPS[0]", "GPS": "BARO[0]"}[message]
    assert len(log.channel(whole_channel)) == ROWS


@pytest.mark.parametrize(
    ("name", "letters", "columns"),
    [
        ("NVF", "Qaf", "TimeUS,Name,Value"),
        ("PARM", "Qaf", "TimeUS,Name,Value"),
        ("GPA", "QBa", "TimeUS,I,AEl"),
        ("GPA", "QBN", "TimeUS,I,AEl"),
    ],
)
def test_names_and_accuracies_that_are_arrays(opened, name, letters, columns):
    writer = flight()
    writer.define(
        40,
        name,
        letters,
        columns,
    )
    cells = NOT_NUMBERS | {"f": 1.0, "B": 0}
    values = [cells[letter] for letter in letters[1:]]
    for k in range(1, ROWS):  # one fix is without its accuracy
        writer.row(
            name,
            1_000_000 + k * 100_000,
            *values,
        )
    log = opened(writer.data)
    assert log.channel("GPS[0]")["h_msl_m"].tolist() == [600.0 + 0.5 * k for k in range(ROWS)]
    assert ("LOG-FIELDS", name) in {entry[:2] for entry in losses(log)}


def test_the_table_of_a_message_whose_time_is_an_array(opened):
    table = opened(flight("BARO", "TimeUS", "a").data).message("BARO")
    assert_array_equal(
        table["TimeUS"],
        np.tile(WORDS, (ROWS, 1)),
    )
    assert table["Press"].shape == (ROWS,)
