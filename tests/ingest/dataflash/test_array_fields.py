"""DataFlash: fields of the map that hold arrays or texts by their definition, as after one bit."""

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal

from tests.helpers import with_code
from tests.ingest.dataflash.air_flight import NOT_NUMBERS, ROWS, WORDS, flight, losses


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
    of_field = [entry for entry in log.ledger if entry.what.startswith(field)]
    assert [(entry.where, entry.count) for entry in of_field] == [("BARO", ROWS)]
    assert {code for code, *_ in losses(log)} == {"LOG-FIELDS"}
    told = [entry.what for entry in with_code(log.ledger, "LOG-FIELDS")]
    assert not [what for what in told if column in what], "one cause is told twice"
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
    assert ("LOG-FIELDS", message, ROWS) in losses(log)
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
