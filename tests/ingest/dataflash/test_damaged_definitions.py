"""DataFlash: damage that leaves whole records, in definitions and instances, is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unbend.ingest import Log, open_log
from unbend.ingest.buffers import FileView, view_of_bytes
from unbend.ingest.dataflash.dataflash_records import find_records

BARO = 23
HYGR = 24
GPS = 20
POS = 25
ROWS = 400


def records(data: bytes) -> SimpleNamespace:
    """The place and the definition of every record in a file, and its damage."""
    found = find_records(view_of_bytes(data))
    blocks = [(block.base + block.at.astype(np.int64), block.numbers) for block in found.wanted]
    offsets, numbers = map(np.concatenate, zip(*blocks, strict=True))
    damage = {name: getattr(found, name) for name in ("bad_bytes", "first_bad", "cut_bytes")}
    return SimpleNamespace(
        offsets=offsets, numbers=numbers, definitions=found.definitions, **damage
    )


def written(dataflash_writer: Callable) -> Any:
    """Forty seconds of air data, a receiver and a position."""
    writer = dataflash_writer()
    writer.define(GPS, "GPS", "QBBIHLLe", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt")
    writer.define(21, "GPA", "QBe", "TimeUS,I,AEl")
    writer.define(BARO, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    writer.define(HYGR, "HYGR", "QBff", "TimeUS,Id,Humidity,Temp")
    writer.define(POS, "POS", "QLLe", "TimeUS,Lat,Lng,Alt")
    for k in range(ROWS):
        time = 1_000_000 + k * 100_000
        writer.row("GPS", time, 0, 3, 1000 + 100 * k, 2300, 47.0, 8.0, 600.0)
        writer.row("GPA", time, 0, 648.0)
        writer.row("BARO", time, 0, 95_000.0 - k, 20.0)
        writer.row("HYGR", time, 0, 55.0, 9.0)
        writer.row("POS", time, 47.0, 8.0, 600.0)
    return writer


def opened(tmp_path: Path, data: bytes, name: str = "flight.bin") -> Log:
    path = tmp_path / name
    path.write_bytes(data)
    return open_log(path)


def losses(log: Log) -> list[tuple[str, str, int]]:
    return [(e.code, e.where, e.count) for e in log.ledger if e.kind == "loss"]


def test_the_log_is_whole(tmp_path: Path, dataflash_writer: Callable) -> None:
    assert losses(opened(tmp_path, written(dataflash_writer).data)) == []


@pytest.mark.parametrize(
    ("message", "field", "column"),
    [
        ("BARO", "Press", "pressure_pa"),
        ("HYGR", "Humidity", "relative_humidity"),
        ("HYGR", "Temp", "temperature_k"),
        ("GPS", "Alt", "h_msl_m"),
        ("POS", "Alt", "h_msl_m"),
        ("GPS", "GMS", "GMS"),
        ("GPS", "Status", "Status"),
        ("BARO", "TimeUS", "TimeUS"),
    ],
)
def test_a_flipped_bit_in_the_name_of_a_field(
    tmp_path: Path, dataflash_writer: Callable, message: str, field: str, column: str
) -> None:
    data = bytearray(written(dataflash_writer).data)
    at = data.index(field.encode(), data.index(message.encode()))
    data[at + len(field) - 1] ^= 1
    log = opened(tmp_path, bytes(data))
    assert losses(log) == [("LOG-FIELDS", message, ROWS)]
    assert column in next(e.what for e in log.ledger if e.code == "LOG-FIELDS")


def test_a_flipped_bit_of_an_instance_is_no_sensor(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    data = bytearray(written(dataflash_writer).data)
    found = records(bytes(data))
    number = next(n for n, form in enumerate(found.definitions) if form.name == "HYGR")
    data[int(found.offsets[found.numbers == number][200]) + 3 + 8] ^= 32
    log = opened(tmp_path, bytes(data))
    assert losses(log) == [("LOG-INSTANCE", "HYGR", 1)]
    assert [c.name for c in log.channels if c.name.startswith("HYGR")] == ["HYGR[0]"]
    assert len(log.channel("HYGR[0]")) == ROWS - 1
    assert log.message("HYGR", "32")["Temp"].tolist() == [9.0]  # the table has what is logged


@pytest.mark.parametrize(("rows", "stays"), [(4, False), (5, True)])
def test_a_sensor_of_few_rows_stays_one(
    tmp_path: Path, dataflash_writer: Callable, rows: int, stays: bool
) -> None:
    writer = written(dataflash_writer)
    for k in range(rows):
        writer.row("BARO", 41_000_000 + k * 100_000, 1, 95_000.0, 20.0)
    log = opened(tmp_path, writer.data)
    assert ("BARO[1]" in {channel.name for channel in log.channels}) == stays
    assert bool(losses(log)) != stays


def test_a_second_camera_of_few_images_stays_one(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = written(dataflash_writer)
    writer.define(30, "CAM", "QBHLL", "TimeUS,I,Img,Lat,Lng")
    for k in range(300):
        writer.row("CAM", 1_000_000 + k * 100_000, 0, k, 47.0, 8.0)
    writer.row("CAM", 41_000_000, 1, 0, 47.0, 8.0)
    log = opened(tmp_path, writer.data)
    assert len(log.channel("CAM[1]")) == 1
    assert losses(log) == []


@pytest.mark.parametrize("letters", ["QN", "QB"])
def test_text_and_numbers_under_one_name(
    tmp_path: Path, dataflash_writer: Callable, letters: str
) -> None:
    """The table has every value; a channel has what the last definition says, and tells."""
    writer = written(dataflash_writer)
    rows = {"QN": b"ab", "QB": 7}
    other = "QB" if letters == "QN" else "QN"
    for k, code in enumerate((letters, other)):
        writer.define(50, "TST", code, "TimeUS,V")
        for row in range(3):
            writer.row("TST", 41_000_000 + k * 1_000_000 + row, rows[code])
    texts = [b.decode() if isinstance(b, bytes) else b for b in (rows[letters], rows[other])]
    log = opened(tmp_path, writer.data)
    assert log.message("TST")["V"].tolist() == [texts[0]] * 3 + [texts[1]] * 3
    writer.define(BARO, "BARO", "QBNc", "TimeUS,I,Press,Temp")
    writer.row("BARO", 44_000_000, 0, b"wet", 20.0)
    writer.define(BARO, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    writer.row("BARO", 45_000_000, 0, 95_000.0, 20.0)
    log = opened(tmp_path, writer.data)
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
def test_integers_of_two_definitions_stay_exact(
    tmp_path: Path,
    dataflash_writer: Callable,
    monkeypatch: pytest.MonkeyPatch,
    first: tuple[str, int],
    then: tuple[str, float],
    kind: str,
) -> None:
    writer = written(dataflash_writer)
    monkeypatch.setitem(writer.row.__globals__["LETTERS"], "i", ("i", 1))
    for letter, value in (first, then):
        writer.define(50, "TST", "Q" + letter, "TimeUS,V")
        writer.row("TST", 41_000_000, value)
    column = opened(tmp_path, writer.data).message("TST")["V"]
    assert column.tolist() == [first[1], then[1]]
    assert column.dtype.kind == kind


def test_a_splice_whose_time_goes_on_is_a_boot(tmp_path: Path, dataflash_writer: Callable) -> None:
    """The last rows of a log are of a flight a week later; p5 to p95 do not see them."""
    writer = written(dataflash_writer)
    for k in range(15):
        time = 641_000_000 + k * 100_000
        writer.row("GPS", time, 0, 3, 1000 + 100 * k, 2301, 47.0, 8.0, 600.0)
        writer.row("BARO", time, 0, 95_000.0 - k, 20.0)
    log = opened(tmp_path, writer.data)
    assert log.boots == 2
    for name in ("GPS[0]", "BARO[0]"):
        time_ns = log.channel(name).time_ns
        assert time_ns[-15] - time_ns[0] == 604_800 * 10**9
    assert losses(log) == []


def test_all_records_of_a_type_in_doubt_cost_what_lies_between_them(
    dataflash_writer: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One bit of the type in an FMT record: each search read the log to its end (131 s)."""
    data = bytearray(written(dataflash_writer).data)
    data[data.index(b"BARO") - 2] ^= 1
    read = []
    array = FileView.array

    def counted(self: FileView, begin: int, end: int) -> Any:
        read.append(end - begin)
        return array(self, begin, end)

    monkeypatch.setattr(FileView, "array", counted)
    monkeypatch.setattr("unbend.ingest.dataflash.dataflash_records.REACH", 8)
    found = records(bytes(data))
    assert found.bad_bytes >= 18 * ROWS
    assert sum(read) < 10 * len(data)


@pytest.mark.parametrize(("rows", "kept"), [(1, False), (4, False), (5, True)])
def test_a_slow_second_sensor_is_no_damage(
    tmp_path: Path, dataflash_writer: Callable, rows: int, kept: bool
) -> None:
    """Up to four rows in a row may be one glitch; five beside 600 are a sensor."""
    writer = written(dataflash_writer)
    for k in range(600):
        time = 42_000_000 + k * 100_000
        writer.row("HYGR", time, 2, 55.0, 9.0)
        if k % 100 == 0 and k // 100 < rows:
            writer.row("HYGR", time, 1, 45.0, 19.0)
    log = opened(tmp_path, writer.data)
    names = [c.name for c in log.channels if c.name.startswith("HYGR")]
    assert names == ["HYGR[0]", *(["HYGR[1]"] if kept else []), "HYGR[2]"]
    assert losses(log) == ([] if kept else [("LOG-INSTANCE", "HYGR", rows)])


def test_rows_of_a_definition_without_instances_have_none(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.define(BARO, "BARO", "Qf", "TimeUS,Press")
    for k in range(50):
        writer.row("BARO", 1_000_000 + k * 100_000, 95_000.0)
    writer.define(40, "BARO", "QBf", "TimeUS,I,Press")
    for k in range(50, 100):
        writer.row("BARO", 1_000_000 + k * 100_000, 1, 90_000.0)
    log = opened(tmp_path, writer.data)
    found = {c.name: (len(c), c["pressure_pa"][0]) for c in log.channels}
    assert found == {"BARO": (50, 95_000.0), "BARO[1]": (50, 90_000.0)}


def test_the_first_damage_is_located(tmp_path: Path, dataflash_writer: Callable) -> None:
    data = written(dataflash_writer).data
    places = records(data).offsets.tolist()
    damaged = data[: places[700]] + bytes(40) + data[places[700] : places[1400]]
    log = opened(tmp_path, damaged + bytes(60) + data[places[1400] :])
    # a record with zeros behind it may have a wrong length: it belongs to the damage
    count = 40 + 60 + places[700] - places[699] + places[1400] - places[1399]
    (entry,) = [e for e in log.ledger if e.code == "LOG-BAD-BYTES"]
    assert (entry.count, entry.where) == (count, f"flight.bin, first at byte {places[699]}")
