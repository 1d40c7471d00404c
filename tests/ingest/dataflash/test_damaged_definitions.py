"""DataFlash: damage that leaves whole records, in definitions and instances, is told."""

import numpy as np
import pytest
import yaml

from tests.ingest.dataflash.air_flight import BARO, ROWS, flight, losses
from tests.ingest.dataflash.walk import walk
from tests.ingest.written_logs import entry_in
from unbend.ingest.buffers import FileView

WEEK_NS = 604_800 * 10**9
AFTER_US = 1_000_000 + ROWS * 100_000  # behind the last row


def names_of(log, message):
    return [channel.name for channel in log.channels if channel.source.message == message]


def test_the_log_is_whole(opened):
    assert losses(opened(flight().data)) == []


FIELDS = yaml.safe_load("""
- [BARO, Press, pressure_pa]
- [HYGR, Humidity, relative_humidity]
- [HYGR, Temp, temperature_k]
- [GPS, Alt, h_msl_m]
- [POS, Alt, h_msl_m]
- [GPS, GMS, GMS]
- [GPS, Status, Status]
- [BARO, TimeUS, TimeUS]
""")


@pytest.mark.parametrize(("message", "field", "column"), FIELDS)
def test_a_flipped_bit_in_the_name_of_a_field(opened, message, field, column):
    data = bytearray(flight().data)
    name_begins = data.index(
        field.encode(),
        data.index(message.encode()),
    )
    data[name_begins + len(field) - 1] ^= 1
    log = opened(bytes(data))
    assert losses(log) == [("LOG-FIELDS", message, ROWS)]
    assert column in entry_in(log, "LOG-FIELDS").what


def test_a_flipped_bit_of_an_instance_is_no_sensor(opened):
    data = bytearray(flight().data)
    record = walk(bytes(data)).places_of("HYGR")[200]
    data[record + 3 + 8] ^= 32
    log = opened(bytes(data))
    assert losses(log) == [("LOG-INSTANCE", "HYGR", 1)]
    assert names_of(log, "HYGR") == ["HYGR[0]"]
    assert len(log.channel("HYGR[0]")) == ROWS - 1
    assert log.message("HYGR", "32")["Temp"].tolist() == [9.0]  # the table has what is logged


@pytest.mark.parametrize(
    ("rows", "stays"),
    [(1, False), (4, False), (5, True)],
)
def test_a_slow_second_sensor_is_no_damage(opened, rows, stays):
    """Up to four rows in a row may be one glitch; five beside 600 are a sensor."""
    writer = flight()
    for k in range(600):
        time_us = AFTER_US + k * 100_000
        writer.row("HYGR", time_us, 2, 55.0, 9.0)
        if k % 100 == 0 and k // 100 < rows:
            writer.row("HYGR", time_us, 1, 45.0, 19.0)
    log = opened(writer.data)
    if stays:
        assert names_of(log, "HYGR") == ["HYGR[0]", "HYGR[1]", "HYGR[2]"]
        assert losses(log) == []
    else:
        assert names_of(log, "HYGR") == ["HYGR[0]", "HYGR[2]"]
        assert losses(log) == [("LOG-INSTANCE", "HYGR", rows)]


def test_a_second_camera_of_few_images_stays_one(opened):
    writer = flight()
    writer.define(30, "CAM", "QBHLL", "TimeUS,I,Img,Lat,Lng")
    for k in range(300):
        writer.row(
            "CAM",
            1_000_000 + k * 100_000,
            0,
            k,
            47.0,
            8.0,
        )
    writer.row(
        "CAM",
        AFTER_US,
        1,
        0,
        47.0,
        8.0,
    )
    log = opened(writer.data)
    assert len(log.channel("CAM[1]")) == 1
    assert losses(log) == []


@pytest.mark.parametrize(
    ("definitions", "values"),
    [(("QN", "QB"), (b"ab", 7)), (("QB", "QN"), (7, b"ab"))],
    ids=["text first", "numbers first"],
)
def test_a_table_of_text_and_numbers_under_one_name_has_every_value(opened, definitions, values):
    writer = flight()
    cells = []
    for letters, value in zip(definitions, values, strict=True):
        writer.define(50, "TST", letters, "TimeUS,V")
        for row in range(3):
            writer.row("TST", AFTER_US + row, value)
        cells += [value.decode() if isinstance(value, bytes) else value] * 3
    assert opened(writer.data).message("TST")["V"].tolist() == cells


def test_a_channel_has_numbers_where_one_row_was_defined_as_text(opened):
    writer = flight()
    writer.define(BARO, "BARO", "QBNc", "TimeUS,I,Press,Temp")
    writer.row("BARO", AFTER_US, 0, b"wet", 20.0)
    writer.define(BARO, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    writer.row("BARO", AFTER_US + 1_000_000, 0, 95_000.0, 20.0)
    log = opened(writer.data)
    assert losses(log) == [("LOG-REDEFINED", "BARO", 1)]
    unknown = np.isnan(log.channel("BARO[0]")["pressure_pa"])
    assert np.flatnonzero(unknown).tolist() == [ROWS]


@pytest.mark.parametrize(
    ("first", "then", "kind"),
    [
        (("Q", 2**53 + 1), ("B", 7), "u"),
        (("Q", 2**53 + 1), ("i", -7), "i"),
        (("Q", 2**63 + 1), ("i", -7), "O"),
        (("Q", 2**53 + 1), ("f", 0.5), "O"),
        (("Q", 5), ("f", 0.5), "f"),
    ],
)
def test_integers_of_two_definitions_stay_exact(opened, first, then, kind):
    writer = flight()
    for letter, value in (first, then):
        writer.define(50, "TST", "Q" + letter, "TimeUS,V")
        writer.row("TST", AFTER_US, value)
    column = opened(writer.data).message("TST")["V"]
    assert column.tolist() == [first[1], then[1]]
    assert column.dtype.kind == kind


def test_a_splice_whose_time_goes_on_is_a_boot(opened):
    """The last rows of a log are of a flight a week later; p5 to p95 do not see them."""
    writer = flight()
    for k in range(15):
        time_us = 641_000_000 + k * 100_000
        writer.row(
            "GPS",
            time_us,
            0,
            3,
            1000 + 100 * k,
            2301,
            47.0,
            8.0,
            600.0,
        )
        writer.row(
            "BARO",
            time_us,
            0,
            95_000.0 - k,
            20.0,
        )
    log = opened(writer.data)
    assert log.boots == 2
    for name in ("GPS[0]", "BARO[0]"):
        channel = log.channel(name)
        assert channel.time_ns[-15] - channel.time_ns[0] == WEEK_NS
        assert channel.boot.tolist() == [0] * ROWS + [1] * 15
    assert entry_in(log, "TIME-REBOOT").kind == "warning"
    assert losses(log) == []


def test_all_records_of_a_type_in_doubt_cost_what_lies_between_them(monkeypatch):
    """One bit of the type in an FMT record: each search read the log to its end (131 s)."""
    data = bytearray(flight().data)
    data[data.index(b"BARO") - 2] ^= 1
    lengths_read = []
    array = FileView.array

    def counted(self, begin, end):
        lengths_read.append(end - begin)
        return array(self, begin, end)

    monkeypatch.setattr(FileView, "array", counted)
    monkeypatch.setattr("unbend.ingest.dataflash.dataflash_records.REACH", 8)
    assert walk(bytes(data)).bad_bytes >= 18 * ROWS
    assert sum(lengths_read) < 10 * len(data)


def test_the_first_damage_is_located(opened):
    data = flight().data
    places = walk(data).places.tolist()
    first = places[700]
    second = places[1400]
    log = opened(data[:first] + bytes(40) + data[first:second] + bytes(60) + data[second:])
    # a record with zeros behind it may have a wrong length: it belongs to the damage
    count = 40 + 60 + first - places[699] + second - places[1399]
    entry = entry_in(log, "LOG-BAD-BYTES")
    assert entry.count == count
    assert entry.where == f"flight.bin, first at byte {places[699]}"
