"""ArduPilot logs as text: against pymavlink's reader of text, and against the binary log."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.ingest import Log, open_log


def as_text(binary: Path, text: Path) -> None:
    """What a ground station writes: one message a line, scaled fields in their unit."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(binary))
    lines = []
    with contextlib.closing(reader):
        while (row := reader.recv_msg()) is not None:
            values = [getattr(row, field) for field in row.get_fieldnames()]
            lines.append(", ".join([row.get_type(), *(str(value) for value in values)]))
    text.write_text("\n".join(lines) + "\n", encoding="utf-8")


def library_tables(path: Path) -> dict[str, dict[str, list[Any]]]:
    from pymavlink.DFReader import DFReader_text

    reader = DFReader_text(str(path))
    tables: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    with contextlib.closing(reader):
        while (row := reader.recv_msg()) is not None:
            for field in row.get_fieldnames():
                tables[row.get_type()][field].append(getattr(row, field))
    return tables


@pytest.fixture(scope="module", params=at_hand("gps0_lost.bin", "beastayyg_sample.bin"))
def binary(request: pytest.FixtureRequest) -> Path:
    return LOGS[request.param]


@pytest.fixture(scope="module")
def text(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("text") / "flight.log"
    as_text(binary, path)
    return path


def test_every_cell_is_that_of_the_library(
    text: Path, record_property: Callable[[str, object], None]
) -> None:
    log = open_log(text)
    cells = 0
    theirs = library_tables(text)
    counts = {name: len(next(iter(columns.values()))) for name, columns in theirs.items()}
    if theirs.pop("UNIT", None) is not None:  # the library loses the one whose label is empty
        counts["UNIT"] += 1
    assert log.message_types() == counts
    for name, columns in theirs.items():
        ours = log.message(name)
        for field, values in columns.items():
            cells += len(values)
            expected = (
                np.array(values) if ours[field].dtype.kind == "U" else np.array(values, float)
            )
            np.testing.assert_array_equal(
                ours[field].astype(expected.dtype), expected, f"{name}.{field}"
            )
    assert cells > (250_000 if len(theirs) > 20 else 10_000)
    record_property("cells compared", cells)
    print(f"{cells:,} cells of {len(theirs)} message types are equal with pymavlink")


def test_the_channels_are_those_of_the_binary_log(binary: Path, text: Path) -> None:
    told = open_log(text)
    expected = open_log(binary)
    assert told.format == "dataflash-text"
    assert (told.boots, told.start_ns) == (expected.boots, expected.start_ns)
    assert [channel.name for channel in told.channels] == [
        channel.name for channel in expected.channels
    ]
    for channel in expected.channels:
        np.testing.assert_array_equal(told.channel(channel.name).time_ns, channel.time_ns)
        for name, column in channel.columns.items():
            np.testing.assert_allclose(
                told.channel(channel.name)[name],
                column,
                rtol=1e-15,
                err_msg=f"{channel.name} {name}",
            )


HEAD = """FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns
FMT, 23, 20, BARO, QBfc, TimeUS,I,Press,Temp
FMT, 59, 75, MSG, QZ, TimeUS,Message
"""


def opened(tmp_path: Path, body: str) -> Log:
    path = tmp_path / "flight.log"
    path.write_bytes((HEAD + body).encode("latin-1"))
    return open_log(path)


def barometer(second: int, dropped: int) -> str:
    """A row of a barometer and the logger's count at a second since boot."""
    time_us = second * 1_000_000
    return f"BARO, {time_us}, 0, 95000.0, 20.0\nDSF, {time_us}, {dropped}\n"


DEFINED = "FMT, 61, 15, DSF, QI, TimeUS,Dp\n"


def test_what_the_logger_dropped_is_a_loss_with_its_own_count(tmp_path: Path) -> None:
    first = "".join(barometer(second, 7 * second) for second in range(5, 10))
    second = "".join(barometer(second, 2) for second in range(1, 4))
    log = opened(tmp_path, DEFINED + first + second)
    (dropped,) = [entry for entry in log.ledger if entry.code == "LOG-DROPOUT"]
    assert (dropped.kind, dropped.count, log.lost_messages) == ("loss", 65, 65)
    assert log.boots == 2


def test_a_logger_that_starts_again_within_a_boot_counts_from_0(tmp_path: Path) -> None:
    counts = (5, 50, 50, 0, 7, 4_294_967_290, 9)  # one of them is damaged
    rows = "".join(barometer(second, count) for second, count in enumerate(counts))
    log = opened(tmp_path, DEFINED + rows)
    assert (log.boots, log.lost_messages) == (1, 59)


def test_a_logger_that_dropped_nothing_lost_nothing(tmp_path: Path) -> None:
    log = opened(tmp_path, DEFINED + "".join(barometer(second, 0) for second in range(5)))
    assert not log.ledger.has_losses
    assert log.lost_messages == 0


def test_the_banner_of_the_firmware_is_no_damage(tmp_path: Path) -> None:
    body = "".join(f"BARO, {second}000000, 0, 95000.0, 20.0\n" for second in range(5))
    banner = "\r\nArduCopter V3.2.1 (36b405fb)\r\nFree RAM: 2048\r\nPX4: 34e1d543\r\n \r\n"
    path = tmp_path / "flight.log"
    path.write_bytes((banner + HEAD + body).encode())
    log = open_log(path)
    assert (log.bad_bytes, log.ledger.has_losses) == (0, False)
    path.write_bytes((HEAD + banner + body).encode())
    assert open_log(path).bad_bytes > 0
    path.write_bytes(b"\x00\xf3\n" + (HEAD + body).encode())
    assert open_log(path).bad_bytes == 3


def test_lines_that_make_no_sense_are_counted(tmp_path: Path) -> None:
    rows = [f"BARO, {k}000000, 0, {95_000 - k}.5, 20.5" for k in range(6)]
    rows[2] = "BARO, 2000000, 0, 95#98.5, 20.5"
    rows[4] = "BARO, 4000000, 0"
    rows.insert(5, "\xff\x00\x17")
    body = "\n".join([*rows, "MSG, 5500000, Mission: 3, then home", ""])
    log = opened(tmp_path, body)
    np.testing.assert_array_equal(
        log.message("BARO")["Press"], [95000.5, 94999.5, 94997.5, 94995.5]
    )
    assert log.message("MSG")["Message"].tolist() == ["Mission: 3, then home"]
    assert log.bad_bytes == len(rows[2]) + len(rows[4]) + len(rows[5]) + 3
    entry = next(entry for entry in log.ledger if entry.code == "LOG-BAD-BYTES")
    assert f"byte {len(HEAD) + len(rows[0]) + len(rows[1]) + 2}" in entry.where
    assert log.ledger.has_losses


def test_a_last_line_without_its_end_is_not_trusted(tmp_path: Path) -> None:
    log = opened(tmp_path, "BARO, 1000000, 0, 95000, 20\nBARO, 1100000, 0, 95000, 2")
    assert log.message_types()["BARO"] == 1
    assert [entry.code for entry in log.ledger if entry.kind == "loss"] == ["LOG-TRUNCATED"]


def test_a_definition_that_changes(tmp_path: Path) -> None:
    body = "BARO, 1000000, 0, 95000, 20\nFMT, 23, 24, BARO, QBffc, TimeUS,I,Alt,Press,Temp\n"
    table = opened(tmp_path, body + "BARO, 1100000, 1, 7, 94000, 21\n").message("BARO")
    np.testing.assert_array_equal(table["Alt"], [np.nan, 7.0])
    np.testing.assert_array_equal(table["Press"], [95_000.0, 94_000.0])


def test_a_line_without_end(tmp_path: Path) -> None:
    log = opened(tmp_path, "BARO, 1000000, 0, 95000, 20\n" + "x" * 100_000 + "\n")
    assert log.bad_bytes == 100_001


def test_a_time_longer_than_any_number_costs_its_line(tmp_path: Path) -> None:
    """A damaged TimeMS may have more digits than 64 bits hold, once it is in microseconds."""
    body = "FMT, 24, 15, OLD, Ih, TimeMS,Value\n"
    rows = [f"OLD, {k}00, {k}" for k in range(20)]
    rows[9] = f"OLD, {2**63}, 9"
    baro = "BARO, 2000000, 0, 95000, 20\n"
    log = opened(tmp_path, body + "\n".join(rows) + "\n" + baro)
    assert log.message_types()["OLD"] == 20
    assert any(entry.code == "TIME-STRAY" for entry in log.ledger)


def test_only_definitions(tmp_path: Path) -> None:
    with pytest.raises(LogError) as caught:
        opened(tmp_path, "")
    assert caught.value.code == "LOG-NO-MESSAGES"
