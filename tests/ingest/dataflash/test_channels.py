"""DataFlash: dates, gaps, tables and the walk through a file, on logs with known content."""

import struct

import numpy as np
import pytest

from tests.helpers import refused, with_code
from tests.ingest import written_logs
from tests.ingest.dataflash.walk import walk
from tests.ingest.written_logs import DataFlashWriter, entry_in
from tests.logs import LOGS
from unbend.flight.clock import utc_of_gps
from unbend.ingest import open_log

SAMPLE = LOGS["flight.bin"]


@pytest.fixture
def writer():
    made = DataFlashWriter()
    made.define_receiver()
    return made


def fixes(writer, week, from_us=5_000_000):
    for k in range(20):
        writer.fix(
            from_us + k * 200_000,
            1000 + 200 * k,
            week=week,
        )


def test_a_gimbal_a_probe_and_values_of_scripts_play_a_role_only_when_named(writer, opened):
    fixes(writer, 2200)
    writer.define(60, "MNT", "QBfff", "TimeUS,I,Roll,Pitch,YawE")
    writer.define(61, "NVF", "QNf", "TimeUS,Name,Value")
    writer.define(62, "TEMP", "QBf", "TimeUS,Instance,Temp")
    for k in range(6):
        time_us = 5_000_000 + k * 200_000
        writer.row(
            "MNT",
            time_us,
            1,
            0.0,
            -90.0,
            0.0,
        )
        writer.row("NVF", time_us, b"cabin_t", 20.5 + k)
        writer.row("NVF", time_us + 1, b"cabin_h", 40.0)
        writer.row("TEMP", time_us, 1, 21.5)  # may sit in the motor
    log = opened(writer.data)
    assert log.channel("NVF[cabin_t]")["value"].tolist() == [20.5, 21.5, 22.5, 23.5, 24.5, 25.5]
    for name in ("MNT[1]", "TEMP[1]", "NVF[cabin_h]"):
        assert log.channel(name).roles == ()
    assert log.channel("MNT[1]").fits_role("attitude")
    assert log.channel("TEMP[1]").fits_role("temperature")


@pytest.mark.parametrize(
    ("rows", "first_ms", "week"),
    [(1, 9_000, 3), (30, 700_000_000, 2324)],
    ids=["one wild week", "milliseconds of no week in more than half of all rows"],
)
def test_gps_time_that_cannot_be_is_not_used(writer, opened, rows, first_ms, week):
    fixes(writer, 2324)
    for k in range(rows):
        writer.fix(9_000_000 + k * 200_000, first_ms + k, week=week)
    log = opened(writer.data)
    assert log.channel("GPS[0]").time_ns[0] == utc_of_gps(2324, 1.0)
    assert not with_code(log.ledger, "TIME-WEEK-ROLLOVER")


@pytest.mark.parametrize(
    ("name", "week", "full"),
    [
        ("flight.bin", 1590, 1590),  # June 2010 is possible, and nothing speaks against it
        ("2010-06-28 10-12-00.bin", 1590, 1590),
        ("flight.bin", 1400, 2424),  # November 2006 is not: 2026 is the only possible date
        ("flight.bin", 1300, 2324),
        ("flight.bin", 276, 2324),
        ("2024-07-22.bin", 276, 2324),
    ],
)
def test_weeks_modulo_1024_are_moved_only_on_evidence(name, week, full, writer, tmp_path):
    fixes(writer, week)
    log = written_logs.opened(tmp_path / name, writer.data)
    assert log.channel("GPS[0]").time_ns[0] == utc_of_gps(full, 1.0)
    counts = [entry.count for entry in with_code(log.ledger, "TIME-WEEK-ROLLOVER")]
    assert counts == [20] * (week != full)


def test_silence_is_told(writer, opened):
    fixes(writer, 2200)
    place = len(writer.data)
    fixes(writer, 2200, from_us=60_000_000)
    gap = entry_in(opened(writer.data), "LOG-GAP")
    assert gap.kind == "warning"
    assert gap.count == 1
    assert f"byte {place}" in gap.where
    assert "51.2 s" in gap.what


def test_what_is_logged_now_and_then_before_and_after_the_sensors_is_no_gap(writer, opened):
    """Parameters every 31 s, as ArduPilot logs them while it is not armed: 3 before, 4 after."""
    writer.define(64, "PARM", "QNf", "TimeUS,Name,Value")
    for k in range(3):
        writer.row(
            "PARM",
            1_000_000 + 31_000_000 * k,
            b"A",
            1.0,
        )
    fixes(writer, 2200, from_us=100_000_000)
    fixes(writer, 2200, from_us=160_000_000)
    for k in range(4):
        writer.row(
            "PARM",
            200_000_000 + 31_000_000 * k,
            b"A",
            1.0,
        )
    gap = entry_in(opened(writer.data), "LOG-GAP")
    assert gap.count == 1
    assert "56.2 s together" in gap.what


def test_the_gaps_of_a_real_log_fit_into_its_span(real_log):
    """628 s not armed, with a parameter every 31 s; and again 80 s of it after the flight."""
    log = open_log(real_log("beastayyg_sample.bin"))
    entry = entry_in(log, "LOG-GAP")
    assert entry.count == 24
    assert "627.9 s together" in entry.what
    (gap,) = log.to_json_dict()["channels"][1]["gaps"]
    assert gap["seconds"] == pytest.approx(627.9, abs=0.2)
    assert log.duration_s == pytest.approx(700.8, abs=0.1)


def test_the_walk_does_not_depend_on_where_blocks_end(monkeypatch):
    data = bytearray(SAMPLE.read_bytes()[:60_000])
    for place in range(5_000, 55_000, 1_700):  # damage of several kinds, all over
        length = 1 + place % 97
        data[place : place + length] = bytes(length)
    expected = walk(bytes(data))
    for span in (97, 512, 4_001, 30_000):
        monkeypatch.setattr("unbend.ingest.dataflash.dataflash_records.SPAN", span)
        monkeypatch.setattr("unbend.ingest.buffers.SPAN", span)
        in_blocks = walk(bytes(data))
        assert in_blocks.records == expected.records, span
        assert in_blocks.bad_bytes == expected.bad_bytes
        assert in_blocks.first_bad == expected.first_bad
        assert in_blocks.blocks > expected.blocks


def test_messages_as_columns_and_as_a_frame(opened, writer):
    fixes(writer, 2200)
    writer.define(63, "PIDR", "Qff", "TimeUS,P,I")
    writer.row("PIDR", 5_000_000, 0.25, 0.5)
    log = opened(writer.data)
    assert log.message_types() == {"FMT": 3, "GPS": 20, "PIDR": 1}
    table = log.message("GPS", "0")
    assert list(table)[:4] == ["time_ns", "boot", "TimeUS", "I"]
    assert table["GMS"].dtype == np.uint32
    assert log.message_to_pandas("GPS")["Lat"].tolist() == [47.0] * 20
    assert log.message("FMT")["Name"].tolist() == ["FMT", "GPS", "PIDR"]
    with refused("LOG-NO-TYPE", says="GPSS"):
        log.message("GPSS")
    for message, instance in (("GPS", "2"), ("PIDR", "0")):  # there I is a term of the controller
        with refused("LOG-NO-TABLE"):
            log.message(message, instance)


def test_the_format_letters_are_those_of_the_library():
    """Letter by letter: size, kind and divisor as pymavlink unpacks and scales them."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    from unbend.ingest.dataflash.record_definitions import DIVISORS, FORMAT_LETTERS

    assert set(FORMAT_LETTERS) == set(FORMAT_TO_STRUCT)
    for letter, (struct_code, scale, _) in FORMAT_TO_STRUCT.items():
        dtype = np.dtype(FORMAT_LETTERS[letter])
        assert dtype.itemsize == struct.calcsize(f"<{struct_code}"), letter
        if letter != "a" and not struct_code.endswith("s"):
            assert dtype == np.dtype(f"<{struct_code}"), letter
        assert DIVISORS.get(letter) == (None if scale is None else 1.0 / scale), letter
