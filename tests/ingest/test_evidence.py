"""What logs say about themselves: velocities, health of the filter, texts, parameters."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.ingest import Log, open_log

DEGREE = np.pi / 180.0
DATAFLASH_LOGS = at_hand(
    "flight.bin",
    "beastayyg_sample.bin",
    "ardusub_small.BIN",
    "pymavlink_test.BIN",
    "sitl_survey.BIN",
    "sitl_belowsea_2cam.BIN",
)
TELEMETRY_LOGS = at_hand(
    "flight.tlog",
    "pymavlink_swift_flight.tlog",
    "ardusub_small.tlog",
    "sitl_survey.tlog",
    "sitl_belowsea_2cam.tlog",
)

# channel column -> what the library's field becomes, written down here once more
HEALTH = {
    "innovation_velocity": lambda r: r.SV,
    "innovation_position": lambda r: r.SP,
    "innovation_height": lambda r: r.SH,
    "innovation_compass": lambda r: r.SM,
    "filter_timeouts": lambda r: r.TS,
    "filter_faults": lambda r: r.FS,
    "filter_flags": lambda r: r.SS & 0x3FF | bool(r.SS & 1 << 14) << 15 | r.SS & 1 << 18,
}
FILTER = {
    "v_north_m_s": lambda r: r.VN,
    "v_east_m_s": lambda r: r.VE,
    "v_down_m_s": lambda r: r.VD,
    "north_m": lambda r: r.PN,
    "east_m": lambda r: r.PE,
    "up_m": lambda r: -r.PD,
}
RECEIVER = {
    "v_north_m_s": lambda r: r.Spd * np.cos(r.GCrs * DEGREE),
    "v_east_m_s": lambda r: r.Spd * np.sin(r.GCrs * DEGREE),
    "v_down_m_s": lambda r: r.VZ,
    "satellites": lambda r: r.NSats,
    "hdop": lambda r: r.HDop,
    "fix": lambda r: r.Status,
    "gps_week": lambda r: r.GWk,
    "gps_week_s": lambda r: r.GMS / 1000.0,
}
DATAFLASH = {
    "XKF4": HEALTH,
    "NKF4": HEALTH,
    "XKF1": FILTER,
    "NKF1": FILTER,
    "GPS": RECEIVER,
    "IMU": {
        "rate_x_rad_s": lambda r: r.GyrX,
        "rate_y_rad_s": lambda r: r.GyrY,
        "rate_z_rad_s": lambda r: r.GyrZ,
    },
    "VIBE": {
        "vibration_m_s2": lambda r: max(r.VibeX, r.VibeY, r.VibeZ),
        "clipping": lambda r: r.Clip if hasattr(r, "Clip") else r.Clip0 + r.Clip1 + r.Clip2,
    },
}
TELEMETRY = {
    "EKF_STATUS_REPORT": {
        "innovation_velocity": lambda r: r.velocity_variance,
        "innovation_position": lambda r: r.pos_horiz_variance,
        "innovation_height": lambda r: r.pos_vert_variance,
        "innovation_compass": lambda r: r.compass_variance,
        "filter_flags": lambda r: r.flags & 0x87FF,
    },
    "VIBRATION": {
        "vibration_m_s2": lambda r: max(r.vibration_x, r.vibration_y, r.vibration_z),
        "clipping": lambda r: r.clipping_0 + r.clipping_1 + r.clipping_2,
    },
    "LOCAL_POSITION_NED": {
        "north_m": lambda r: r.x,
        "east_m": lambda r: r.y,
        "up_m": lambda r: -r.z,
        "v_north_m_s": lambda r: r.vx,
        "v_east_m_s": lambda r: r.vy,
        "v_down_m_s": lambda r: r.vz,
    },
    "ATTITUDE": {
        "rate_x_rad_s": lambda r: r.rollspeed,
        "rate_y_rad_s": lambda r: r.pitchspeed,
        "rate_z_rad_s": lambda r: r.yawspeed,
    },
}


def library_rows(path: Path, types: Iterable[str]) -> dict[str, list]:
    """The library's messages of some types, to which it goes without reading the others."""
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(path), dialect="all")
    rows = defaultdict(list)
    wanted = list(types)
    while (row := reader.recv_match(type=wanted)) is not None:
        rows[row.get_type()].append(row)
    reader.close()
    return rows


def compare(log: Log, fields: dict[str, dict], rows: dict[str, list]) -> int:
    """Compare channels with the library's rows, which are as many; how many values."""
    compared = 0
    for message, columns in fields.items():
        for channel in (c for c in log.channels if c.source.message == message):
            instance = channel.source.instance
            mine = [
                row
                for row in rows[message]
                if instance is None
                or next(getattr(row, name) for name in ("I", "C", "IMU") if hasattr(row, name))
                == int(instance)
            ]
            if len(mine) != len(channel):  # without a fix, repeated: tested elsewhere
                continue
            for column, value in columns.items():
                theirs = np.array([value(row) for row in mine], np.float64)
                np.testing.assert_array_equal(channel[column], theirs, f"{channel.name}.{column}")
                compared += theirs.size
    return compared


@pytest.mark.parametrize("name", DATAFLASH_LOGS)
def test_evidence_of_dataflash_is_the_librarys(name: str) -> None:
    path = LOGS[name]
    log = open_log(path)
    rows = library_rows(path, [*DATAFLASH, "MSG", "EV", "PARM"])
    assert compare(log, DATAFLASH, rows) > 300
    names = {"EKF_ALT_RESET": "60", "EKF_YAW_RESET": "62", "GPS_PRIMARY_CHANGED": "67"}
    names |= {"LAND_COMPLETE": "18", "NOT_LANDED": "28"}
    said = {channel.name: channel.labels.get("text", ()) for channel in log.channels}
    lines = [line for row in said.get("MSG", ()) for line in row.split("\n")]
    assert lines == [row.Message.strip() for row in rows["MSG"]]
    events = [line.split()[1] for row in said.get("EV", ()) for line in row.split("\n")]
    assert [names.get(event, event) for event in events] == [str(row.Id) for row in rows["EV"]]
    parameters = {row.Name: row.Value for row in rows["PARM"]}
    assert log.parameters == parameters
    assert len(parameters) > (0 if name == "flight.bin" else 800)


@pytest.mark.parametrize("name", TELEMETRY_LOGS)
def test_evidence_of_telemetry_is_the_librarys(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv("MAVLINK20", "1")
    path = LOGS[name]
    log = open_log(path)
    rows = library_rows(path, [*TELEMETRY, "STATUSTEXT", "PARAM_VALUE"])
    vehicle = {
        message: [r for r in several if r.get_srcSystem() == 1 and r.get_srcComponent() == 1]
        for message, several in rows.items()
    }
    assert compare(log, TELEMETRY, vehicle) > 10_000
    lines = [
        line
        for channel in log.channels
        if channel.source.message == "STATUSTEXT"
        for row in channel.labels["text"]
        for line in row.split("\n")
    ]
    assert len(lines) <= len(rows["STATUSTEXT"])
    assert "".join(sorted("".join(lines))) == "".join(
        sorted("".join(row.text.strip() for row in rows["STATUSTEXT"]))
    )
    assert log.parameters == {
        row.param_id: row.param_value for row in vehicle.get("PARAM_VALUE", ())
    }


def test_both_logs_of_a_flight_have_the_same_innovations(real_log: Callable) -> None:
    """XKF4 is scaled by 100 and a root, as the report is: else 14 would not be above 1."""
    logged = open_log(real_log("sitl_survey.BIN")).channel("XKF4[0]")
    sent = open_log(real_log("sitl_survey.tlog")).channel("EKF_STATUS_REPORT")
    at = np.searchsorted(logged.time_ns, sent.time_ns[10:-10])
    for column in ("innovation_position", "innovation_height", "innovation_compass"):
        apart = np.abs(logged[column][at] - sent[column][10:-10])
        assert np.median(apart) < 0.01, column
    flags = logged["filter_flags"][at].astype(int) & 0x3FF
    assert np.mean(flags == sent["filter_flags"][10:-10].astype(int) & 0x3FF) > 0.99


def test_texts_of_one_time_are_lines_of_one_row(tmp_path: Path, dataflash_writer: Callable) -> None:
    writer = dataflash_writer()
    writer.define(20, "GPS", "QBIHLLe", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt")
    writer.define(21, "MSG", "QN", "TimeUS,Message")
    writer.define(22, "ERR", "QBB", "TimeUS,Subsys,ECode")
    writer.define(23, "EV", "QB", "TimeUS,Id")
    writer.define(24, "PARM", "QNf", "TimeUS,Name,Value")
    for name, value in ((b"GPS_DELAY_MS", 0.0), (b"GPS_TYPE", 1.0), (b"GPS_DELAY_MS", 120.0)):
        writer.row("PARM", 900_000, name, value)
    for k in range(5):
        writer.row("GPS", 1_000_000 + 200_000 * k, 3, 1000 + 200 * k, 2300, 47.0, -122.5, 600.25)
    writer.row("MSG", 1_300_000, b"GPS Glitch")
    writer.row("MSG", 1_300_000, b"DCM active")
    writer.row("ERR", 1_300_000, 16, 2)
    writer.row("ERR", 1_400_000, 99, 0)
    writer.row("EV", 1_350_000, 62)
    writer.row("MSG", 1_400_000, b"EKF3 lane switch")
    path = tmp_path / "texts.bin"
    path.write_bytes(writer.data)
    log = open_log(path)
    said = log.channel("MSG")
    assert said.labels["text"] == ("GPS Glitch\nDCM active", "EKF3 lane switch")
    assert np.diff(said.time_ns).tolist() == [100_000_000]
    # the first fix was stamped 120 ms after its epoch, which is the time of its row
    assert said.time_ns[0] - log.channel("GPS").time_ns[0] == 420_000_000
    assert log.channel("ERR").labels["text"] == ("ERR EKFCHECK 2", "ERR 99 0")
    assert log.channel("EV").labels["text"] == ("EV EKF_YAW_RESET",)
    assert log.parameters == {"GPS_DELAY_MS": 120.0, "GPS_TYPE": 1.0}
    assert not log.ledger.has_losses
    assert all(channel.is_evidence for channel in log.channels if channel.name != "GPS")


def test_a_log_of_evidence_alone_is_refused(tmp_path: Path, dataflash_writer: Callable) -> None:
    writer = dataflash_writer()
    writer.define(21, "XKF4", "QBcc", "TimeUS,C,SV,SP")
    for k in range(5):
        writer.row("XKF4", 1_000_000 + 100_000 * k, 0, 0.25, 0.5)
    path = tmp_path / "health.bin"
    path.write_bytes(writer.data)
    with pytest.raises(LogError, match="none with a position") as refused:
        open_log(path)
    assert refused.value.code == "LOG-NO-MESSAGES"


def test_a_receiver_without_vertical_speed_has_none(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.define(20, "GPS", "QBIHLLefff", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ")
    writer.define(21, "GPA", "QCCCB", "TimeUS,HAcc,VAcc,SAcc,VV")
    for k, has_vertical in enumerate((1, 0, 1)):
        time_us = 1_000_000 + 200_000 * k
        writer.row("GPS", time_us, 3, 200 * k, 2300, 47.0, -122.5, 600.25, 10.0, 0.0, 0.5)
        writer.row("GPA", time_us, 0.5, 0.75, 0.25, has_vertical)
    path = tmp_path / "receiver.bin"
    path.write_bytes(writer.data)
    channel = open_log(path).channel("GPS")
    np.testing.assert_array_equal(channel["v_down_m_s"], [0.5, np.nan, 0.5])
    np.testing.assert_array_equal(channel["sigma_speed_m_s"], [0.25] * 3)
    np.testing.assert_array_equal(channel["v_north_m_s"], [10.0] * 3)


def test_long_texts_of_telemetry_are_joined(tmp_path: Path) -> None:
    from pymavlink.dialects.v20 import all as library

    first = "EKF3 IMU0 stopped aiding because the receiver lost"
    assert len(first) == 50
    sender = library.MAVLink(None, 1, 1)
    frames = []
    texts = (
        (first.encode(), 7, 0),
        (b"AHRS: DCM active", 0, 0),
        (b" its fix", 7, 1),
        (b", and the baro", 7, 2),
        (b"GPS Glitch", 0, 0),
        (b"tail of a text", 8, 1),
        (b"a" * 50, 9, 0),
        (b"c" * 9, 9, 2),
    )
    for k, (text, number, chunk) in enumerate(texts):
        for message in (
            library.MAVLink_attitude_message(60_000 + 1000 * k, 0, 0, 0, 0, 0, 0),
            library.MAVLink_statustext_message(2, text, number, chunk),
        ):
            stamp_us = 1_700_000_000_000_000 + k * 1_000_000
            frames.append(struct.pack(">Q", stamp_us) + message.pack(sender))
            sender.seq = (sender.seq + 1) % 256
    path = tmp_path / "texts.tlog"
    path.write_bytes(b"".join(frames))
    said = open_log(path).channel("STATUSTEXT").labels["text"]
    assert said == (
        f"{first} its fix, and the baro",
        "AHRS: DCM active",
        "GPS Glitch",
        "...tail of a text",
        "a" * 50 + "..." + "c" * 9,
    )
