"""DataFlash: the field map, clocks, tables and memory, on logs with known content."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.flight.clock import utc_of_gps
from unbend.ingest import Log, open_log
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.dataflash.binary_log import read_tables
from unbend.ingest.dataflash.dataflash_records import find_records

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ROOT / "sample_logs" / "flight.bin"


def records(data: bytes) -> SimpleNamespace:
    """The place and the definition of every record in a file, and its damage."""
    found = find_records(view_of_bytes(data))
    blocks = [(block.base + block.at.astype(np.int64), block.numbers) for block in found.wanted]
    offsets, numbers = map(np.concatenate, zip(*blocks, strict=True))
    damage = {name: getattr(found, name) for name in ("bad_bytes", "first_bad", "cut_bytes")}
    return SimpleNamespace(
        offsets=offsets,
        numbers=numbers,
        definitions=found.definitions,
        blocks=len(blocks),
        **damage,
    )


def entries(log: Log, code: str) -> list[Any]:
    return [entry for entry in log.ledger if entry.code == code]


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[bytes], Log]:
    def write_and_open(data: bytes) -> Log:
        path = tmp_path / "flight.bin"
        path.write_bytes(data)
        return open_log(path)

    return write_and_open


@pytest.fixture
def writer(dataflash_writer: Callable) -> Any:
    made = dataflash_writer()
    made.define(20, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt")
    return made


def fixes(writer: Any, week: int, rows: int = 20, from_us: int = 5_000_000) -> None:
    for k in range(rows):
        time = (from_us + k * 200_000, 0, 3, 1000 + 200 * k, week)
        writer.row("GPS", *time, 12, 0.8, 47.0, 8.0, 600.0)


def test_the_gimbal_is_an_attitude_that_plays_only_when_named(
    writer: Any, opened: Callable
) -> None:
    fixes(writer, 2200)
    columns = "TimeUS,I,DRoll,Roll,DPitch,Pitch,DYawB,YawB,DYawE,YawE,Dist"
    writer.define(60, "MNT", "QBfffffffff", columns)
    angles = np.array([[0.5 * k, -80.0 + k, 15.0 * k] for k in range(20)])
    for k, (roll, pitch, yaw) in enumerate(angles):
        writer.row("MNT", 5_000_000 + k * 200_000, 1, 0, roll, 0, pitch, 0, 2.5, 0, yaw, 0)
    gimbal = opened(writer.data).channel("MNT[1]")
    assert (gimbal.roles, gimbal.fits_role("attitude")) == ((), True)
    theirs = Rotation.from_euler("ZYX", angles[:, ::-1].astype(np.float32), degrees=True)
    ours = Rotation.from_quat(np.stack([gimbal[f"q_{axis}"] for axis in "xyzw"], axis=1))
    assert (ours.inv() * theirs).magnitude().max() < 1e-9
    assert gimbal["yaw_in_body_rad"][0] == np.radians(2.5)


def test_values_of_scripts_are_channels_by_their_name(writer: Any, opened: Callable) -> None:
    fixes(writer, 2200)
    writer.define(61, "NVF", "QNf", "TimeUS,Name,Value")
    for k in range(6):
        writer.row("NVF", 5_000_000 + k * 200_000, b"cabin_t", 20.5 + k)
        writer.row("NVF", 5_000_001 + k * 200_000, b"cabin_h", 40.0)
    log = opened(writer.data)
    assert log.channel("NVF[cabin_t]")["value"].tolist() == [20.5, 21.5, 22.5, 23.5, 24.5, 25.5]
    assert log.channel("NVF[cabin_h]").roles == ()


def test_the_undulation_has_the_sign_of_the_autopilot(writer: Any, opened: Callable) -> None:
    """Until 4.6 ArduPilot logged height above sea level minus height above the ellipsoid."""
    writer.define(62, "GPA", "QBCf", "TimeUS,I,HAcc,Und")
    fixes(writer, 2200)
    for k in range(20):
        writer.row("GPA", 5_000_000 + k * 200_000, 0, 0.5, 0.0 if k == 3 else -47.5)
    channel = opened(writer.data).channel("GPS[0]")
    assert channel["h_ellipsoid_m"][0] == 647.5
    assert np.isnan(channel["h_ellipsoid_m"][3])  # 0 is what it says when it does not know
    assert "undulation_m" not in channel.columns


@pytest.mark.parametrize("rollovers", [0, 1, 2])
def test_a_receiver_that_counts_weeks_modulo_1024(
    rollovers: int, writer: Any, opened: Callable
) -> None:
    fixes(writer, 2324 - 1024 * rollovers)  # July 2024
    log = opened(writer.data)
    assert log.channel("GPS[0]").time_ns[0] == utc_of_gps(2324, 1.0)
    told = entries(log, "TIME-WEEK-ROLLOVER")
    assert [entry.count for entry in told] == ([20] if rollovers else [])


def test_one_wild_week_is_no_rollover(writer: Any, opened: Callable) -> None:
    fixes(writer, 2324)
    writer.row("GPS", 9_000_000, 0, 3, 9_000, 3, 12, 0.8, 47.0, 8.0, 600.0)
    log = opened(writer.data)
    assert log.channel("GPS[0]").time_ns[0] == utc_of_gps(2324, 1.0)
    assert not entries(log, "TIME-WEEK-ROLLOVER")


@pytest.mark.parametrize(
    ("name", "week", "full"),
    [
        ("flight.bin", 1590, 1590),  # June 2010 is possible, and nothing speaks against it
        ("2010-06-28 10-12-00.bin", 1590, 1590),
        ("flight.bin", 1400, 2424),  # November 2006 is not: 2026 is the only possible date
        ("2024-07-22.bin", 276, 2324),
    ],
)
def test_a_date_is_moved_only_on_evidence(
    name: str, week: int, full: int, writer: Any, tmp_path: Path
) -> None:
    fixes(writer, week)
    path = tmp_path / name
    path.write_bytes(writer.data)
    log = open_log(path)
    assert log.channel("GPS[0]").time_ns[0] == utc_of_gps(full, 1.0)
    assert len(entries(log, "TIME-WEEK-ROLLOVER")) == (week != full)


def test_gps_time_that_cannot_be_is_not_used(writer: Any, opened: Callable) -> None:
    fixes(writer, 2324)
    expected = opened(writer.data).channel("GPS[0]").time_ns[0]
    for k in range(30):  # more than half of all rows
        time = (9_000_000 + k * 200_000, 0, 3, 700_000_000 + k, 2324)
        writer.row("GPS", *time, 12, 0.8, 47.0, 8.0, 600.0)
    assert opened(writer.data).channel("GPS[0]").time_ns[0] == expected


def test_silence_is_told(writer: Any, opened: Callable) -> None:
    fixes(writer, 2200)
    place = len(writer.data)
    fixes(writer, 2200, from_us=60_000_000)
    (entry,) = entries(opened(writer.data), "LOG-GAP")
    assert (entry.kind, entry.count) == ("warning", 1)
    assert f"byte {place}" in entry.where
    assert "51.2 s" in entry.what


def test_what_is_logged_now_and_then_before_and_after_the_sensors_is_no_gap(
    writer: Any, opened: Callable
) -> None:
    """Parameters every 31 s, as ArduPilot logs them while it is not armed: 3 before, 4 after."""
    writer.define(64, "PARM", "QNf", "TimeUS,Name,Value")
    for k in range(3):
        writer.row("PARM", 1_000_000 + 31_000_000 * k, b"A", 1.0)
    fixes(writer, 2200, from_us=100_000_000)
    fixes(writer, 2200, from_us=160_000_000)
    for k in range(4):
        writer.row("PARM", 200_000_000 + 31_000_000 * k, b"A", 1.0)
    (entry,) = entries(opened(writer.data), "LOG-GAP")
    assert entry.count == 1
    seconds = float(entry.what.split(", ")[1].split(" s")[0])
    assert seconds == pytest.approx(60.0 - 3.8)


def test_the_gaps_of_a_real_log_fit_into_its_span(real_log: Callable[[str], Path]) -> None:
    """628 s not armed, with a parameter every 31 s; and again 80 s of it after the flight."""
    log = open_log(real_log("beastayyg_sample.bin"))
    (entry,) = entries(log, "LOG-GAP")
    assert entry.count == 24
    assert "627.9 s together" in entry.what
    (gap,) = log.to_json_dict()["channels"][1]["gaps"]
    assert gap["seconds"] == pytest.approx(627.9, abs=0.2)
    assert log.duration_s == pytest.approx(700.8, abs=0.1)


@pytest.mark.parametrize("name", at_hand("gps0_lost.bin", "beastayyg_sample.bin"))
def test_one_flipped_type_byte_in_the_middle_costs_one_message(tmp_path: Path, name: str) -> None:
    """pymavlink's index loses more than half of the GPS rows of the real log."""
    data = bytearray(LOGS[name].read_bytes())
    whole = records(bytes(data))
    places = whole.offsets
    middle = int(places[np.searchsorted(places, len(data) // 2)])
    path = tmp_path / "flight.bin"
    expected = {name: len(next(iter(t.values()))) for name, t in tables(path, data).items()}
    for bit in range(8):
        damaged = bytearray(data)
        damaged[middle + 2] ^= 1 << bit
        counts = {name: len(next(iter(t.values()))) for name, t in tables(path, damaged).items()}
        lost = {name: expected[name] - counts.get(name, 0) for name in expected}
        assert sum(max(count, 0) for count in lost.values()) <= 1, bit


def tables(path: Path, data: bytes | bytearray) -> dict[str, Any]:
    path.write_bytes(data)
    return read_tables(path)


def test_the_walk_does_not_depend_on_where_blocks_end(monkeypatch: pytest.MonkeyPatch) -> None:
    from unbend.ingest import buffers as window
    from unbend.ingest.dataflash import dataflash_records as dataflash_records

    data = bytearray(SAMPLE.read_bytes()[:60_000])
    for at in range(5_000, 55_000, 1_700):  # damage of several kinds, all over
        data[at : at + 1 + at % 97] = bytes(1 + at % 97)
    expected = records(bytes(data))
    for span in (97, 512, 4_001, 30_000):
        monkeypatch.setattr(dataflash_records, "SPAN", span)
        monkeypatch.setattr(window, "SPAN", span)
        found = records(bytes(data))
        np.testing.assert_array_equal(found.offsets, expected.offsets, f"{span}")
        np.testing.assert_array_equal(found.numbers, expected.numbers)
        assert (found.bad_bytes, found.first_bad) == (expected.bad_bytes, expected.first_bad)
    assert expected.blocks < found.blocks


def test_messages_as_columns_and_as_a_frame(opened: Callable, writer: Any) -> None:
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
    with pytest.raises(LogError, match="GPSS") as caught:
        log.message("GPSS")
    assert caught.value.code == "LOG-NO-TYPE"
    with pytest.raises(LogError) as caught:  # I is a term of the controller here
        log.message("PIDR", "0")
    assert caught.value.code == "LOG-NO-TABLE"


@pytest.fixture(scope="module")
def grower() -> ModuleType:
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("unbend_benchmarks", ROOT / "benchmarks" / "dataflash.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_grown_log_is_one_long_flight(tmp_path: Path, grower: ModuleType) -> None:
    path = tmp_path / "grown.bin"
    size = grower.grow(SAMPLE, path, 3 * SAMPLE.stat().st_size - 1)
    assert size == path.stat().st_size == 3 * SAMPLE.stat().st_size
    log = open_log(path)
    once = open_log(SAMPLE)
    assert log.boots == 1
    assert log.duration_s == pytest.approx(3 * once.duration_s, rel=0.01)
    assert len(log.channel("ATT")) == 3 * len(once.channel("ATT"))
    assert not log.ledger.has_losses


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
