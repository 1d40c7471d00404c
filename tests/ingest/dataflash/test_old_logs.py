"""Logs of ArduPilot 3.2 and before: milliseconds since boot, exposures with only a GPS time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.ingest import Log, open_log
from unbend.ingest.dataflash.binary_log import read_tables

SAMPLE = Path(__file__).resolve().parents[3] / "sample_logs" / "flight.bin"


def as_32(path: Path, writer: Any) -> bytes:
    """A log as ArduPilot 3.2 would have written it, from one of today with the same content."""
    kinds = ["GPS", "ATT", "BARO", "CAM"]
    tables = read_tables(path, kinds)
    writer.define(
        20, "GPS", "BIHBcLLeeECfI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"
    )
    writer.define(21, "ATT", "IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    writer.define(22, "BARO", "Iffc", "TimeMS,Alt,Press,Temp")
    writer.define(23, "CAM", "IHLLeeccC", "GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw")
    writer.define(24, "MSG", "N", "Message")
    writer.define(25, "PARM", "Nf", "Name,Value")
    writer.row("PARM", b"GPS_TYPE", 1.0)
    head = writer.data
    rows = []

    def written(name: str, *values: float | bytes) -> bytes:
        writer.data = b""
        writer.row(name, *values)
        return bytes(writer.data)

    for kind in kinds:
        t = tables[kind]
        for k, time_us in enumerate(t["TimeUS"].tolist()):
            if t.get("I", np.zeros(k + 1))[k] or (kind == "GPS" and t["Status"][k] < 3):
                continue
            ms = time_us // 1000
            values: tuple = (ms, 0.0, t["Press"][k], t["Temp"][k]) if kind == "BARO" else ()
            if kind == "GPS":
                values = (
                    3,
                    t["GMS"][k],
                    t["GWk"][k],
                    10,
                    1.2,
                    t["Lat"][k],
                    t["Lng"][k],
                    0.0,
                    t["Alt"][k],
                    12.0,
                    90.0,
                    0.5,
                    ms,
                )
            elif kind == "ATT":
                values = (ms, 0.0, t["Roll"][k], 0.0, t["Pitch"][k], 0.0, t["Yaw"][k] % 360.0)
            elif kind == "CAM":
                values = (
                    t["GPSTime"][k],
                    t["GPSWeek"][k],
                    t["Lat"][k],
                    t["Lng"][k],
                    t["Alt"][k],
                    t["RelAlt"][k],
                    0.0,
                    0.0,
                    0.0,
                )
            rows.append((time_us, kinds.index(kind), written(kind, *values)))
    rows.sort()
    half = len(rows) // 2
    rows[half:half] = [(rows[half][0], 9, written("MSG", b"GPS Glitch"))]
    return head + b"".join(row for _, _, row in rows)


def last_fixes(path: Path) -> bytes:
    """The log with the time of the last fix in each CAM row, as autopilots write it."""
    tables = read_tables(path, ["GPS", "CAM"])
    data = bytearray(path.read_bytes())
    fixes = tables["GPS"]
    shots = tables["CAM"]
    row = np.searchsorted(fixes["TimeUS"], shots["TimeUS"], side="right") - 1
    for k, time_us in enumerate(shots["TimeUS"].tolist()):
        at = data.index(struct.pack("<Q", time_us) + struct.pack("<BH", 0, shots["Img"][k]))
        data[at + 11 : at + 17] = struct.pack("<IH", fixes["GMS"][row[k]], fixes["GWk"][row[k]])
    return bytes(data)


@pytest.fixture(params=at_hand("flight.bin", "sitl_survey.BIN", "sitl_belowsea_2cam.BIN"))
def both(
    request: pytest.FixtureRequest, dataflash_writer: Callable, tmp_path: Path
) -> tuple[Log, Log]:
    """A log of today, and the same as ArduPilot 3.2 writes it."""
    path = tmp_path / "today.bin"
    if request.param == "flight.bin":
        path.write_bytes(last_fixes(SAMPLE))
    else:
        path.symlink_to(LOGS[request.param])
    old = tmp_path / "old.bin"
    old.write_bytes(as_32(path, dataflash_writer()))
    return open_log(path), open_log(old)


def receivers_delay_ns(today: Log) -> int:
    """The delay of fixes, which the old log has no positions of a filter to be found by."""
    fixes = next(c for c in today.channels if c.source.message == "GPS")
    rows = today.message("GPS")
    return int(rows["time_ns"][rows["Status"] >= 3][0] - fixes.time_ns[0])


def test_the_same_flight_as_today(both: tuple[Log, Log]) -> None:
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
    assert len(fixes) == len(next(c for c in today.channels if c.name in ("GPS", "GPS[0]")))
    assert fixes["v_east_m_s"] == pytest.approx(12.0)
    said = old.channel("MSG")
    assert said.labels["text"] == ("GPS Glitch",)
    assert then.time_ns[0] < said.time_ns[0] < then.time_ns[-1]
    table = old.message("ATT")
    assert "TimeUS" not in table
    np.testing.assert_array_equal(table["time_ns"], then.time_ns)


def test_an_exposure_is_half_an_interval_behind_its_fix(both: tuple[Log, Log]) -> None:
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
    entry = next(entry for entry in old.ledger if entry.code == "EVENTS-FIX-TIME")
    assert (entry.kind, entry.count) == ("fallback", len(then))


def test_a_log_as_text(tmp_path: Path) -> None:
    """As Mission Planner writes it; the exposure without a fix stays at the record before it."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format",
        "FMT, 20, 45, GPS, BIHBcLLeeECfI, "
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
        "FMT, 21, 17, ATT, IccC, TimeMS,Roll,Pitch,Yaw",
        "FMT, 23, 30, CAM, IHLLeeccC, GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw",
    ]
    for k in range(20):
        lines += [
            f"GPS, 3, {1000 + 200 * k}, 1820, 10, 1.2, 47.5, 11.5, 0, 600, 10, 90, 0, "
            f"{60_000 + 200 * k}",
            f"ATT, {60_050 + 200 * k}, 1.0, 2.0, 90.0",
        ]
        if k in (5, 9):
            week = 1820 if k == 5 else 0
            lines.append(f"CAM, {1000 + 200 * k}, {week}, 47.5, 11.5, 600, 0, 0, 0, 0")
    path = tmp_path / "old.log"
    path.write_text("\n".join(lines) + "\n")
    log = open_log(path)
    assert not log.ledger.has_losses
    first = log.channel("GPS").time_ns[0]
    assert ((log.channel("CAM").time_ns - first) / 1e6).tolist() == [1100.0, 1850.0]
    assert ((log.channel("ATT").time_ns - first) / 1e6)[:2].tolist() == [50.0, 250.0]
