"""Logs of ArduPilot 3.2 and before: milliseconds since boot, exposures with only a GPS time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.ingest import written_logs
from tests.ingest.written_logs import DataFlashWriter, entry_in
from tests.logs import LOGS, at_hand
from unbend.ingest import Log, open_log
from unbend.ingest.dataflash.binary_log import read_tables

Row = dict[str, Any]


def old_fix(ms: int, row: Row) -> tuple[float, ...]:
    place = (row["Lat"], row["Lng"], 0.0, row["Alt"])
    return (3, row["GMS"], row["GWk"], 10, 1.2, *place, 12.0, 90.0, 0.5, ms)


def old_attitude(ms: int, row: Row) -> tuple[float, ...]:
    return (ms, 0.0, row["Roll"], 0.0, row["Pitch"], 0.0, row["Yaw"] % 360.0)


def old_pressure(ms: int, row: Row) -> tuple[float, ...]:
    return (ms, 0.0, row["Press"], row["Temp"])


def old_shot(ms: int, row: Row) -> tuple[float, ...]:
    place = (row["Lat"], row["Lng"], row["Alt"], row["RelAlt"])
    return (row["GPSTime"], row["GPSWeek"], *place, 0.0, 0.0, 0.0)


# Definition and rows of today's messages in a log of then, of which rows of one time are in order.
OLD_MESSAGES: dict[str, tuple[str, str, Callable[[int, Row], tuple[float, ...]]]] = {
    "GPS": (
        "BIHBcLLeeECfI",
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
        old_fix,
    ),
    "ATT": ("IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", old_attitude),
    "BARO": ("Iffc", "TimeMS,Alt,Press,Temp", old_pressure),
    "CAM": ("IHLLeeccC", "GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw", old_shot),
}


def as_32(path: Path) -> bytes:
    """A log as ArduPilot 3.2 would have written it, from one of today with the same content."""
    writer = DataFlashWriter()
    rows = []
    for kind, (name, (letters, columns, old_row)) in enumerate(OLD_MESSAGES.items()):
        writer.define(20 + kind, name, letters, columns)
        table = read_tables(path, [name])[name]
        for k in range(len(table["TimeUS"])):
            row = {field: column[k] for field, column in table.items()}
            is_first_unit = row.get("I", 0) == 0
            has_fix = name != "GPS" or row["Status"] >= 3
            if is_first_unit and has_fix:
                time_us = int(row["TimeUS"])
                rows.append((time_us, kind, name, old_row(time_us // 1000, row)))
    rows.sort()
    rows.insert(len(rows) // 2, (0, 0, "MSG", (b"GPS Glitch",)))
    writer.define(24, "MSG", "N", "Message")
    writer.define(25, "PARM", "Nf", "Name,Value")
    writer.row("PARM", b"GPS_TYPE", 1.0)
    head = writer.data
    old = []
    for _, _, name, values in rows:
        writer.data = b""  # or it is copied with each row
        writer.row(name, *values)
        old.append(writer.data)
    return head + b"".join(old)


def last_fixes(path: Path) -> bytes:
    """The log with the time of the last fix in each CAM row, as autopilots write it."""
    tables = read_tables(path, ["GPS", "CAM"])
    data = bytearray(path.read_bytes())
    fixes = tables["GPS"]
    shots = tables["CAM"]
    last = np.searchsorted(fixes["TimeUS"], shots["TimeUS"], side="right") - 1
    for k, time_us in enumerate(shots["TimeUS"].tolist()):
        begin = data.index(struct.pack("<QBH", time_us, 0, shots["Img"][k]))
        epoch = struct.pack("<IH", fixes["GMS"][last[k]], fixes["GWk"][last[k]])
        data[begin + 11 : begin + 17] = epoch
    return bytes(data)


@pytest.fixture(
    scope="module", params=at_hand("flight.bin", "sitl_survey.BIN", "sitl_belowsea_2cam.BIN")
)
def both(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Log, Log]:
    """A log of today, and the same as ArduPilot 3.2 writes it."""
    folder = tmp_path_factory.mktemp("both")
    path = LOGS[request.param]
    if request.param == "flight.bin":
        content = last_fixes(path)
        path = folder / "today.bin"
        path.write_bytes(content)
    old = written_logs.opened(folder / "old.bin", as_32(path))
    return open_log(path), old


def receivers_delay_ns(today: Log) -> int:
    """The delay of fixes, which the old log has no positions of a filter to be found by."""
    fixes = next(c for c in today.channels if c.source.message == "GPS")
    rows = today.message("GPS")
    return int(rows["time_ns"][rows["Status"] >= 3][0] - fixes.time_ns[0])


def test_the_same_flight_as_today(both):
    today, old = both
    assert not old.ledger.has_losses
    assert old.parameters == {"GPS_TYPE": 1.0}
    now = today.channel("ATT")
    then = old.channel("ATT")
    late_ns = receivers_delay_ns(today)
    # both clocks are cut to 1 ms
    assert np.abs(now.time_ns - late_ns - then.time_ns).max() < 2_000_000
    np.testing.assert_allclose(then["q_z"], now["q_z"], atol=2e-4)
    fixes = old.channel("GPS")
    assert len(fixes) == len(next(c for c in today.channels if c.source.message == "GPS"))
    assert fixes["v_east_m_s"] == pytest.approx(12.0)
    texts = old.channel("MSG")
    assert texts.labels["text"] == ("GPS Glitch",)
    assert then.time_ns[0] < texts.time_ns[0] < then.time_ns[-1]
    table = old.message("ATT")
    assert "TimeUS" not in table
    np.testing.assert_array_equal(table["time_ns"], then.time_ns)


def test_an_exposure_is_half_an_interval_behind_its_fix(both):
    today, old = both
    now = next(c for c in today.channels if c.source.message == "CAM")
    then = old.channel("CAM")
    interval_s = 0.2
    error_s = (then.time_ns + receivers_delay_ns(today) - now.time_ns) * 1e-9
    assert then["sigma_time_s"] == pytest.approx(interval_s / np.sqrt(12.0))
    # a row is written up to 20 ms after its pulse, with the fix of that moment
    assert np.abs(error_s).max() < interval_s / 2.0 + 0.022
    assert np.sqrt(np.mean(error_s**2)) < 1.3 * interval_s / np.sqrt(12.0)
    assert np.abs(error_s.mean()) < 0.035  # without the half it is 0.1 s
    entry = entry_in(old, "EVENTS-FIX-TIME")
    assert entry.kind == "fallback"
    assert entry.count == len(then)


def test_a_log_as_text(tmp_path):
    """As Mission Planner writes it; the exposure without a fix stays at the record before it."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format",
        "FMT, 20, 45, GPS, BIHBcLLeeECfI, "
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
        "FMT, 21, 17, ATT, IccC, TimeMS,Roll,Pitch,Yaw",
        "FMT, 23, 30, CAM, IHLLeeccC, GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw",
    ]
    for k in range(20):
        week_ms = 1000 + 200 * k
        boot_ms = 60_000 + 200 * k
        lines.append(f"GPS, 3, {week_ms}, 1820, 10, 1.2, 47.5, 11.5, 0, 600, 10, 90, 0, {boot_ms}")
        lines.append(f"ATT, {boot_ms + 50}, 1.0, 2.0, 90.0")
        if k in (5, 9):
            week = 1820 if k == 5 else 0
            lines.append(f"CAM, {week_ms}, {week}, 47.5, 11.5, 600, 0, 0, 0, 0")
    content = "".join(f"{line}\n" for line in lines).encode()
    log = written_logs.opened(tmp_path / "old.log", content)
    assert not log.ledger.has_losses
    first_ns = log.channel("GPS").time_ns[0]
    assert ((log.channel("CAM").time_ns - first_ns) / 1e6).tolist() == [1100.0, 1850.0]
    assert ((log.channel("ATT").time_ns - first_ns) / 1e6)[:2].tolist() == [50.0, 250.0]
