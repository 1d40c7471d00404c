"""ArduPilot logs as text: against pymavlink's reader of text, and against the binary log."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pymavlink.DFReader import DFReader_text

from tests.helpers import refused, with_code
from tests.ingest import written_logs
from tests.ingest.dataflash.library import as_text, library_tables
from tests.ingest.written_logs import entry_in
from tests.logs import LOGS, at_hand
from unbend.ingest import open_log


@pytest.fixture(scope="module", params=at_hand("gps0_lost.bin", "beastayyg_sample.bin"))
def binary(request):
    return LOGS[request.param]


@pytest.fixture(scope="module")
def text(binary, tmp_path_factory):
    path = tmp_path_factory.mktemp("text") / "flight.log"
    path.write_text(as_text(binary), "utf-8")
    return path


def test_every_cell_is_that_of_the_library(text, record_property):
    log = open_log(text)
    cells = 0
    theirs = library_tables(DFReader_text(str(text)))
    counts = {name: len(next(iter(columns.values()))) for name, columns in theirs.items()}
    if theirs.pop("UNIT", None) is not None:  # the library loses the one whose label is empty
        counts["UNIT"] += 1
    assert log.message_types() == counts
    for name, columns in theirs.items():
        table = log.message(name)
        for field, values in columns.items():
            cells += len(values)
            ours = table[field]
            is_text = ours.dtype.kind == "U"
            expected = np.array(values) if is_text else np.array(values, float)
            message = f"{name}.{field}"
            assert_array_equal(ours.astype(expected.dtype), expected, message)
    assert cells > (250_000 if len(theirs) > 20 else 10_000)
    record_property("cells compared", cells)


def test_the_channels_are_those_of_the_binary_log(binary, text):
    log = open_log(text)
    expected = open_log(binary)
    assert log.format == "dataflash-text"
    assert log.boots == expected.boots
    assert log.start_ns == expected.start_ns
    names = [channel.name for channel in log.channels]
    assert names == [channel.name for channel in expected.channels]
    for channel in expected.channels:
        ours = log.channel(channel.name)
        assert_array_equal(ours.time_ns, channel.time_ns)
        for name, column in channel.columns.items():
            assert_allclose(
                ours[name],
                column,
                rtol=1e-15,
                err_msg=f"{channel.name} {name}",
            )


HEAD = """FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns
FMT, 23, 20, BARO, QBfc, TimeUS,I,Press,Temp
FMT, 59, 75, MSG, QZ, TimeUS,Message
"""
DROPS = "FMT, 61, 15, DSF, QI, TimeUS,Dp\n"


@pytest.fixture
def opened(tmp_path):
    """Opens text behind the definitions of `HEAD`."""

    def write_and_open(body):
        return written_logs.opened(
            tmp_path / "flight.log",
            (HEAD + body).encode("latin-1"),
        )

    return write_and_open


def barometer(second, dropped):
    """A row of a barometer and the logger's count at a second since boot."""
    time_us = second * 1_000_000
    return f"BARO, {time_us}, 0, 95000.0, 20.0\nDSF, {time_us}, {dropped}\n"


TWO_BOOTS = [(5, 35), (6, 42), (7, 49), (8, 56), (9, 63), (1, 2), (2, 2), (3, 2)]
STARTS_AGAIN = list(enumerate((5, 50, 50, 0, 7, 4_294_967_290, 9)))  # one of them is damaged
NOTHING_DROPPED = [(second, 0) for second in range(5)]


@pytest.mark.parametrize(
    ("counts", "boots", "lost"),
    [(TWO_BOOTS, 2, 65), (STARTS_AGAIN, 1, 59), (NOTHING_DROPPED, 1, 0)],
    ids=["two boots", "the logger starts again within a boot", "nothing dropped"],
)
def test_what_the_logger_dropped_is_a_finding_with_its_own_count(opened, counts, boots, lost):
    log = opened(DROPS + "".join(barometer(*count) for count in counts))
    assert log.boots == boots
    assert log.lost_messages == lost
    dropped = [(entry.kind, entry.count) for entry in with_code(log.ledger, "LOG-DROPOUT")]
    assert dropped == [("finding", lost)] * bool(lost)
    assert log.ledger.has_losses == bool(lost)


def test_the_banner_of_the_firmware_is_no_damage(tmp_path):
    path = tmp_path / "flight.log"
    body = "".join(f"BARO, {second}000000, 0, 95000.0, 20.0\n" for second in range(5))
    banner = "\r\nArduCopter V3.2.1 (36b405fb)\r\nFree RAM: 2048\r\nPX4: 34e1d543\r\n \r\n"
    log = written_logs.opened(
        path,
        (banner + HEAD + body).encode(),
    )
    assert log.bad_bytes == 0
    assert not log.ledger.has_losses
    among_rows = (HEAD + banner + body).encode()
    assert written_logs.opened(path, among_rows).bad_bytes > 0
    of_other_bytes = b"\x00\xf3\n" + (HEAD + body).encode()
    assert written_logs.opened(path, of_other_bytes).bad_bytes == 3


def test_lines_that_make_no_sense_are_counted(opened):
    lines = [
        "BARO, 0, 0, 95000.5, 20.5\n",
        "BARO, 1000000, 0, 94999.5, 20.5\n",
        "BARO, 2000000, 0, 95#98.5, 20.5\n",
        "BARO, 3000000, 0, 94997.5, 20.5\n",
        "BARO, 4000000, 0\n",
        "\xff\x00\x17\n",
        "BARO, 5000000, 0, 94995.5, 20.5\n",
        "MSG, 5500000, Mission: 3, then home\n",
    ]
    log = opened("".join(lines))
    assert log.message("BARO")["Press"].tolist() == [95000.5, 94999.5, 94997.5, 94995.5]
    assert log.message("MSG")["Message"].tolist() == ["Mission: 3, then home"]
    assert log.bad_bytes == len(lines[2] + lines[4] + lines[5])
    entry = entry_in(log, "LOG-BAD-BYTES")
    assert f"byte {len(HEAD + lines[0] + lines[1])}" in entry.where
    assert log.ledger.has_losses


def test_a_last_line_without_its_end_is_not_trusted(opened):
    log = opened("BARO, 1000000, 0, 95000, 20\nBARO, 1100000, 0, 95000, 2")
    assert log.message_types()["BARO"] == 1
    assert [entry.code for entry in log.ledger if entry.kind == "loss"] == ["LOG-TRUNCATED"]


def test_a_definition_that_changes(opened):
    body = "BARO, 1000000, 0, 95000, 20\nFMT, 23, 24, BARO, QBffc, TimeUS,I,Alt,Press,Temp\n"
    table = opened(body + "BARO, 1100000, 1, 7, 94000, 21\n").message("BARO")
    assert_array_equal(table["Alt"], [np.nan, 7.0])
    assert_array_equal(table["Press"], [95_000.0, 94_000.0])


def test_a_line_without_end(opened):
    log = opened("BARO, 1000000, 0, 95000, 20\n" + "x" * 100_000 + "\n")
    assert log.bad_bytes == 100_001


def test_a_time_longer_than_any_number_costs_its_line(opened):
    """A damaged TimeMS may have more digits than 64 bits hold, once it is in microseconds."""
    rows = [f"OLD, {k}00, {k}\n" for k in range(20)]
    rows[9] = f"OLD, {2**63}, 9\n"
    definition = "FMT, 24, 15, OLD, Ih, TimeMS,Value\n"
    log = opened(definition + "".join(rows) + "BARO, 2000000, 0, 95000, 20\n")
    assert log.message_types()["OLD"] == 20
    assert with_code(log.ledger, "TIME-STRAY")


def test_only_definitions(opened):
    with refused("LOG-NO-MESSAGES"):
        opened("")
