"""PX4 logs: files with known content, written by hand as the ULog specification says."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from unbend.atmosphere.estimate.sensors import dynamic_of, heating_of
from unbend.errors import LogError
from unbend.ingest import Log, open_log

NOW_US = 1_700_000_000_000_000


class ULogWriter:
    """Writes the messages of a ULog file: definitions, subscriptions, data."""

    def __init__(self) -> None:
        self.data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
        self.message("B", bytes(40))
        self.ids: dict[tuple[str, int], int] = {}

    def message(self, kind: str, payload: bytes) -> None:
        self.data += struct.pack("<HB", len(payload), ord(kind)) + payload

    def define(self, name: str, fields: str) -> None:
        self.message("F", f"{name}:uint64_t timestamp;{fields}".encode())

    def subscribe(self, name: str, instance: int = 0) -> None:
        self.ids[name, instance] = len(self.ids)
        number = self.ids[name, instance]
        self.message("A", struct.pack("<BH", instance, number) + name.encode())

    def row(self, name: str, layout: str, *values: float, instance: int = 0) -> None:
        number = struct.pack("<H", self.ids[name, instance])
        self.message("D", number + struct.pack("<Q" + layout, *values))


def flight() -> bytes:
    writer = ULogWriter()
    writer.define(
        "vehicle_gps_position",
        "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
        "float eph;float epv;uint8_t fix_type;",
    )
    writer.define("vehicle_attitude", "float[4] q;")
    writer.define("sensor_baro", "float pressure;float temperature;")
    writer.define("sensor_hygrometer", "float temperature;float humidity;")
    writer.define("camera_capture", "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;")
    for name in ("vehicle_gps_position", "vehicle_attitude", "sensor_hygrometer", "camera_capture"):
        writer.subscribe(name)
    for instance in (0, 1):
        writer.subscribe("sensor_baro", instance)
    for k in range(30):
        t = 5_000_000 + 100_000 * k
        place = (int(47.5e7), int(8.25e7), 600_000, 647_500)
        writer.row("vehicle_gps_position", "QiiiiffB", t, NOW_US + t, *place, 0.5, 0.75, 3)
        writer.row("vehicle_attitude", "4f", t, 0.8, 0.0, 0.0, 0.6)
        for instance in (0, 1):
            values = (94_000.0 + instance, 40.0)
            writer.row("sensor_baro", "ff", t, *values, instance=instance)
        writer.row("sensor_hygrometer", "ff", t, 12.5, 55.0)
    writer.row("camera_capture", "QIdd", 6_000_000, 0, 7, 47.5, 8.25)
    return writer.data


def opened(tmp_path: Path, data: bytes) -> Log:
    path = tmp_path / "flight.ulg"
    path.write_bytes(data)
    return open_log(path)


def test_known_flight(tmp_path: Path) -> None:
    log = opened(tmp_path, flight())
    names = ["camera_capture", "sensor_baro[0]", "sensor_baro[1]", "sensor_hygrometer"]
    assert [channel.name for channel in log.channels] == [
        *names,
        "vehicle_attitude",
        "vehicle_gps_position",
    ]
    fix = log.channel("vehicle_gps_position")
    assert fix.time_ns[0] == (NOW_US + 5_000_000) * 1000
    assert fix["lat_rad"][0] == np.radians(47.5)
    assert (fix["h_msl_m"][0], fix["h_ellipsoid_m"][0], fix["sigma_v_m"][0]) == (600, 647.5, 0.75)
    attitude = log.channel("vehicle_attitude")
    np.testing.assert_allclose([attitude[f"q_{a}"][0] for a in "wxyz"], [0.8, 0, 0, 0.6], atol=1e-7)
    assert log.channel("sensor_baro[1]")["pressure_pa"][0] == 94_001.0
    assert log.channel("sensor_hygrometer")["relative_humidity"][0] == pytest.approx(0.55)
    assert log.channel("camera_capture")["event_index"].tolist() == [7.0]
    assert log.message_types()["sensor_baro"] == 60
    assert log.message("sensor_baro", "1")["pressure"].tolist() == [94_001.0] * 30
    assert not log.ledger.has_losses


NEW_GPS = (
    "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;double altitude_msl_m;"
    "double altitude_ellipsoid_m;uint8_t fix_type;"
)


def newer(rows: int = 60, **options: Callable[[int], int]) -> ULogWriter:
    """As PX4 1.14 and later log it; options by row: utc, fix, stray, ellipsoid."""
    writer = ULogWriter()
    writer.define("sensor_gps", NEW_GPS)
    writer.define("vehicle_attitude", "float[4] q;")
    writer.define("vehicle_air_data", "float baro_pressure_pa;float ambient_temperature;")
    writer.define(
        "camera_capture",
        "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;float[4] q;int8_t result;",
    )
    writer.define("gimbal_device_attitude_status", "uint16_t device_flags;float[4] q;")
    writer.define("acme", "uint8_t a;")
    names = ("sensor_gps", "vehicle_attitude", "vehicle_air_data", "camera_capture")
    for name in (*names, "gimbal_device_attitude_status", "acme"):
        writer.subscribe(name)
    for k in range(rows):
        t = 60_000_000 + 200_000 * k
        utc = options.get("utc", lambda k: NOW_US + 200_000 * k)(k)
        fix = options.get("fix", lambda _: 3)(k)
        above = 647.5 if options.get("ellipsoid", lambda _: 1)(k) else 0.0
        stamp = t + options.get("stray", lambda _: 0)(k)
        writer.row("sensor_gps", "QddddB", stamp, utc, 47.5, 8.25, 600.0, above, fix)
        writer.row("vehicle_attitude", "4f", t, 1.0, 0.0, 0.0, 0.0)
        writer.row("vehicle_air_data", "2f", t, 94_000.0, 40.0)
        writer.row("gimbal_device_attitude_status", "H4f", t, 0, 0.5, 0.5, -0.5, 0.5)
        writer.row("acme", "B", t, 1)
        if k % 10 == 0:
            told = options.get("capture", lambda _: 0)(k)
            result = 0 if k == 20 else 1
            shot = (told, k // 10, 47.5, 8.25, 0.5, 0.5, -0.5, 0.5, result)
            writer.row("camera_capture", "QIdd4fb", t, *shot)
    return writer


def seconds(log: Log, name: str) -> list[float]:
    return ((log.channel(name).time_ns // 1000 - NOW_US) / 1e6).tolist()


WHOLE = [k / 5 for k in range(60)]


def test_messages_mean_what_they_mean_over_ros(tmp_path: Path) -> None:
    log = opened(tmp_path, newer().data)
    shots = log.channel("camera_capture")
    assert shots["event_index"].tolist() == [0, 1, 3, 4, 5]  # the third failed
    assert [(e.kind, e.count) for e in log.ledger if e.code == "EVENT-FAILED"] == [("warning", 1)]
    assert shots["camera_q_y"].tolist() == [-0.5] * 5
    air = log.channel("vehicle_air_data")
    assert air["board_temperature_k"][0] == 313.15
    assert air.roles == ("pressure", "cabin_pressure")
    assert log.channel("gimbal_device_attitude_status")["gimbal_q_y"][0] == -0.5
    assert log.message_types()["acme"] == 60  # not of ours: counted, and a table
    assert log.message("acme")["a"].tolist() == [1] * 60
    assert not log.ledger.has_losses


def test_two_gimbals_in_one_topic_of_px4_are_two_channels(tmp_path: Path) -> None:
    forward = (0.5, 0.5, -0.5, 0.5)
    down = (1.0, 0.0, 0.0, 0.0)
    yaw_in_earth_frame = 64
    writer = ULogWriter()
    fields = "uint16_t device_flags;float[4] q;uint8_t gimbal_device_id;"
    writer.define("gimbal_device_attitude_status", fields)
    writer.subscribe("gimbal_device_attitude_status")
    for k in range(20):
        at_us = 60_000_000 + 200_000 * k
        for gimbal_id, q in ((0, forward), (1, down)):
            row = (yaw_in_earth_frame, *q, gimbal_id)
            writer.row("gimbal_device_attitude_status", "H4fB", at_us, *row)
    log = opened(tmp_path, writer.data)
    of_0 = log.channel("gimbal_device_attitude_status[0]")
    of_1 = log.channel("gimbal_device_attitude_status[1]")
    assert of_0["gimbal_q_y"].tolist() == [-0.5] * 20
    assert of_1["gimbal_q_y"].tolist() == [0.0] * 20
    for number in (0, 1):
        table = log.message(f"gimbal_device_attitude_status[{number}]")
        assert table["gimbal_device_id"].tolist() == [number] * 20


def test_tables_are_those_of_pyulog(tmp_path: Path) -> None:
    from pyulog import ULog

    log = opened(tmp_path, newer().data)
    cells = 0
    for data in ULog(str(log.path)).data_list:
        table = log.message(data.name)
        for field, column in data.data.items():
            assert table[field].tobytes() == column.tobytes()
            cells += column.size
    assert cells > 1400


def test_a_height_of_0_above_the_ellipsoid_is_missing(tmp_path: Path) -> None:
    log = opened(tmp_path, newer(ellipsoid=lambda _: 0).data)
    assert "h_ellipsoid_m" not in log.channel("sensor_gps").columns
    old = flight().replace(struct.pack("<i", 647_500), bytes(4))
    assert "h_ellipsoid_m" not in opened(tmp_path, old).channel("vehicle_gps_position").columns


def test_the_filters_position_and_its_height_of_0_that_is_missing(tmp_path: Path) -> None:
    writer = ULogWriter()
    fields = "double lat;double lon;float alt;float alt_ellipsoid;float eph;float epv;"
    writer.define("vehicle_global_position", fields)
    writer.subscribe("vehicle_global_position")
    for k in range(20):
        above = 647.5 if k < 10 else 0.0
        row = (5_000_000 + 100_000 * k, 47.5, 8.25, 600.0, above, 0.5, 0.75)
        writer.row("vehicle_global_position", "2d4f", *row)
    channel = opened(tmp_path, writer.data).channel("vehicle_global_position")
    np.testing.assert_array_equal(channel["h_ellipsoid_m"], [647.5] * 10 + [np.nan] * 10)
    assert (channel["h_msl_m"][0], channel["sigma_v_m"][0]) == (600.0, 0.75)
    assert channel["sigma_h_m"][0] == pytest.approx(0.5 / np.sqrt(2.0))


def test_exposures_are_preferred_to_commands(tmp_path: Path) -> None:
    writer = ULogWriter()
    for name in ("camera_trigger", "camera_capture"):
        writer.define(name, "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;")
    for name in ("camera_trigger", "camera_capture"):
        writer.subscribe(name)
        for k in range(5):
            delay = 80_000 if name == "camera_capture" else 0
            writer.row(name, "QIdd", 10**6 * (k + 1) + delay, 0, k, 47.5, 8.25)
    log = opened(tmp_path, writer.data)
    assert log.channel("camera_capture").rank < log.channel("camera_trigger").rank


def test_utc_of_a_receiver_counts_with_a_fix_and_once_a_time(tmp_path: Path) -> None:
    """The first rows are an hour off, without a fix; then two of three repeat the time before."""

    def utc(k: int) -> int:
        return NOW_US + 200_000 * (k - k % 3) - (3_600_000_000 if k < 24 else 0)

    log = opened(tmp_path, newer(fix=lambda k: 0 if k < 24 else 3, utc=utc).data)
    assert seconds(log, "vehicle_attitude") == WHOLE
    assert not log.ledger.has_losses


@pytest.mark.parametrize("row", [0, 1, 30, 59])
def test_a_stray_stamp_costs_its_row(tmp_path: Path, row: int) -> None:
    log = opened(tmp_path, newer(stray=lambda k: 1 << 30 if k == row else 0).data)
    assert seconds(log, "vehicle_attitude") == WHOLE
    if row != 59:  # behind the last row may be a gap: only the rows before it say so
        assert seconds(log, "sensor_gps") == [t for k, t in enumerate(WHOLE) if k != row]
        lost = [(e.kind, e.count) for e in log.ledger if e.code == "TIME-STRAY"]
        assert lost == [("loss", 1)]
        assert "TIME-BACKWARD" not in {e.code for e in log.ledger}
        assert log.time_base.endswith("the median of 59 rows")


def test_a_camera_tells_utc_where_no_receiver_does(tmp_path: Path) -> None:
    """Where one does, the autopilot's own clock (0.4 s ahead here) would move the exposures."""
    log = opened(tmp_path, newer(fix=lambda _: 0, capture=lambda k: NOW_US + 200_000 * k).data)
    assert seconds(log, "vehicle_attitude") == WHOLE
    log = opened(tmp_path, newer(capture=lambda k: NOW_US + 200_000 * k + 400_000).data)
    assert seconds(log, "camera_capture") == [0, 2, 6, 8, 10]
    log = opened(tmp_path, newer(fix=lambda _: 0).data)
    assert [e.kind for e in log.ledger if e.code == "TIME-NO-UTC"] == ["fallback"]


def test_messages_that_pyulog_does_not_know_and_padding(tmp_path: Path) -> None:
    writer = ULogWriter()
    writer.define("vehicle_attitude", "float[4] q;uint8_t[4] _padding0;")
    writer.define("nested", "vehicle_attitude[2] both;")
    writer.message("S", bytes(8))
    writer.message("O", struct.pack("<H", 250))
    writer.subscribe("vehicle_attitude")
    writer.subscribe("nested")
    for k in range(20):
        writer.row("vehicle_attitude", "4f", 10**6 * k, 1.0, 0.0, 0.0, 0.0)
        writer.message("R", b"\7\0")
        writer.message("S", bytes(8))
        if k < 3:
            writer.message("O", struct.pack("<H", 250))
        writer.message("L", b"6" + bytes(8) + b"hello")
    log = opened(tmp_path, writer.data)
    assert len(log.channel("vehicle_attitude")) == 20
    assert log.message_types() == {"vehicle_attitude": 20}
    silent = [(e.kind, e.count, "0.750 s" in e.what) for e in log.ledger if e.code == "LOG-DROPOUT"]
    assert silent == [("loss", 3, True)]
    assert (log.bad_bytes, log.lost_messages) == (0, 0)


def test_damage_is_located_and_what_follows_is_read(tmp_path: Path) -> None:
    data = newer().data
    middle = data.index(b"D", len(data) // 2) - 2
    log = opened(tmp_path, data[:middle] + b"\xff" * 500 + data[middle:])
    assert sum(log.messages.values()) >= sum(opened(tmp_path, data).messages.values()) - 1
    found = [e for e in log.ledger if e.code == "LOG-BAD-BYTES"]
    assert [(e.kind, e.where) for e in found] == [("loss", f"flight.ulg, first at byte {middle}")]
    assert log.bad_bytes == found[0].count
    assert log.lost_messages == 1  # at least


def test_a_definition_among_the_data_is_none(tmp_path: Path) -> None:
    writer = newer()
    before = len(writer.data)
    writer.define("vehicle_attitude", "double[4] q;")
    more = len(writer.data) - before
    writer.row("acme", "B", 80_000_000, 1)
    log = opened(tmp_path, writer.data)
    assert (log.bad_bytes, log.messages["acme"]) == (more, 61)
    assert seconds(log, "vehicle_attitude") == WHOLE


def test_zeros_among_the_definitions_end(tmp_path: Path) -> None:
    """pyulog steps back by more than it can read there, and begins anew without end."""
    data = bytearray(newer().data)
    data[80:4176] = bytes(4096)
    with pytest.raises(LogError) as caught:
        opened(tmp_path, bytes(data[:5000]))
    assert caught.value.code == "LOG-FORMAT"


def test_a_topic_without_a_time_is_a_loss(tmp_path: Path) -> None:
    data = newer().data.replace(
        b"vehicle_air_data:uint64_t timestamp", b"vehicle_air_data:uint64_t timeszamp"
    )
    log = opened(tmp_path, data)
    lost = [(e.kind, e.where, e.count) for e in log.ledger if e.code == "LOG-FIELDS"]
    assert lost == [("loss", "vehicle_air_data", 60)]
    assert seconds(log, "vehicle_attitude") == WHOLE  # pyulog alone would give one row
    assert log.bad_bytes == 0
    with pytest.raises(LogError, match="LOG-NO-TABLE"):
        log.message("vehicle_air_data")


def test_data_appended_after_a_crash_is_read_once(tmp_path: Path) -> None:
    """The message before it is cut off; the file says where it begins."""
    writer = newer()
    whole = opened(tmp_path, writer.data).messages
    place = len(writer.data) + 5
    number = writer.ids["vehicle_attitude", 0]
    writer.data += struct.pack("<HBH", 26, ord("D"), number)  # the first bytes of another row
    for k in range(60, 80):
        writer.row("vehicle_attitude", "4f", 60_000_000 + 200_000 * k, 1.0, 0.0, 0.0, 0.0)
    data = bytearray(writer.data)
    data[19 + 8] = 1
    data[19 + 16 : 19 + 24] = struct.pack("<Q", place)
    log = opened(tmp_path, bytes(data))
    assert log.messages["vehicle_attitude"] == whole["vehicle_attitude"] + 20
    assert seconds(log, "vehicle_attitude") == [k / 5 for k in range(80)]
    assert log.bad_bytes == 5


def test_every_cut_opens_or_refuses_and_is_reported(tmp_path: Path) -> None:
    data = flight()
    boundaries = {len(data)}
    at = 16
    while at < len(data):
        boundaries.add(at)
        at += 3 + int.from_bytes(data[at : at + 2], "little")
    ends = set()
    for end in range(20, len(data), 37):
        try:
            log = opened(tmp_path, data[:end])
        except LogError as error:
            ends.add(error.code)
            continue
        told = {entry.code for entry in log.ledger if entry.kind in ("loss", "warning")}
        ends |= told
        assert told or end in boundaries
    assert "LOG-TRUNCATED" in ends
    assert ends <= {"LOG-TRUNCATED", "LOG-NO-MESSAGES", "LOG-FORMAT"}


def test_a_header_that_is_cut_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(LogError, match="after 8 of 16 bytes") as caught:
        open_log(path)
    assert caught.value.code == "LOG-ULOG"


def test_flags_that_are_not_known_are_refused(tmp_path: Path) -> None:
    """Bit 0 of the incompatible flags means appended data; what others mean may be anything."""
    for byte, bit in ((27, 1), (28, 0), (34, 7)):
        data = bytearray(flight())
        data[byte] |= 1 << bit
        with pytest.raises(LogError, match="incompatible flags") as caught:
            opened(tmp_path, bytes(data))
        assert caught.value.code == "LOG-ULOG"
    data = bytearray(flight())
    data[26] = 1  # the last of the compatible flags
    assert not opened(tmp_path, bytes(data)).ledger.has_losses


def test_a_damaged_mark_at_the_beginning_costs_the_header(tmp_path: Path) -> None:
    data = bytearray(flight())
    data[2] ^= 1
    log = opened(tmp_path, bytes(data))
    assert log.messages == opened(tmp_path, flight()).messages
    lost = [(e.kind, e.where, e.count) for e in log.ledger if e.code == "LOG-BAD-BYTES"]
    assert lost == [("loss", "flight.ulg, first at byte 0", 16)]


def test_a_value_shorter_than_its_type_is_damage(tmp_path: Path) -> None:
    """What follows is read: pyulog alone stops there, and says nothing."""
    writer = newer()
    whole = opened(tmp_path, writer.data).messages
    writer.message("P", b"\x0bint32_t ABC" + bytes(4))
    writer.message("Q", b"\x01\x09float XYZ" + bytes(4))
    writer.message("I", b"\x0achar[5] sys" + bytes(5))
    writer.message("M", b"\0\x0cuint8_t[9] x" + bytes(5))  # of an array a part
    assert not opened(tmp_path, writer.data).ledger.has_losses
    writer.message("P", b"\x0bint32_t ABC" + bytes(3))
    writer.row("acme", "B", 80_000_000, 1)
    log = opened(tmp_path, writer.data)
    assert log.messages["acme"] == whole["acme"] + 1
    lost = [(e.kind, e.count) for e in log.ledger if e.code == "LOG-ULOG-DAMAGE"]
    assert lost == [("loss", 1)]
    assert (log.bad_bytes, log.lost_messages) == (0, 1)


def test_a_pitot_tube_gives_dynamic_pressure_and_heating(tmp_path: Path) -> None:
    """50 m/s at 3000 m of the ICAO atmosphere: q = rho V^2/2, and V^2/(2 c_p) at the stagnation.

    PX4 logs the indicated airspeed sqrt(2 q/rho_0) and the true one; with the true one taken for
    the indicated, both would be 1.35 times too large.
    """
    pressure = 70_108.5
    temperature = 268.659
    true = 50.0
    density = pressure / (287.053 * temperature)
    dynamic = 0.5 * density * true**2
    indicated = np.sqrt(2.0 * dynamic / 1.225)
    writer = ULogWriter()
    writer.define(
        "airspeed",
        "float indicated_airspeed_m_s;float true_airspeed_m_s;float air_temperature_celsius;",
    )
    writer.subscribe("airspeed")
    for k in range(20):
        row = (indicated, true, temperature - 273.15)
        writer.row("airspeed", "3f", 5_000_000 + 100_000 * k, *row)
    channel = opened(tmp_path, writer.data).channel("airspeed")
    assert "airspeed" in channel.roles
    assert dynamic_of(channel["airspeed_m_s"])[0] == pytest.approx(dynamic, rel=1e-6)
    heating = heating_of(channel["airspeed_m_s"], pressure, channel["temperature_k"])
    np.testing.assert_allclose(heating, true**2 / (2.0 * 1004.7), rtol=1e-3)


def test_pyulog_is_not_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    assert len(opened(tmp_path, flight()).channels) == 6


@pytest.mark.parametrize("count", [1, 7, 16, 40])
def test_a_file_whose_head_is_lost(tmp_path: Path, count: int) -> None:
    """The definitions are whole: all messages are there, and the loss is told."""
    expected = opened(tmp_path, flight())
    for data in (flight()[count:], bytes(count) + flight()[count:]):
        log = opened(tmp_path, data)
        assert log.messages == expected.messages
        assert [c.name for c in log.channels] == [c.name for c in expected.channels]
        for ours, theirs in zip(log.channels, expected.channels, strict=True):
            np.testing.assert_array_equal(ours.time_ns, theirs.time_ns)
        assert {e.code for e in log.ledger if e.kind == "loss"} == {"LOG-BAD-BYTES"}


def regular() -> tuple[bytes, list[bytes]]:
    """Definitions, and 60 s of messages: attitude at 100 Hz, air at 50 Hz, receiver at 5 Hz."""
    writer = ULogWriter()
    writer.define("sensor_gps", NEW_GPS)
    writer.define("vehicle_attitude", "float[4] q;")
    writer.define("vehicle_air_data", "float baro_pressure_pa;float ambient_temperature;")
    for name in ("sensor_gps", "vehicle_attitude", "vehicle_air_data"):
        writer.subscribe(name)
    head = writer.data
    rows = []

    def row(name: str, layout: str, *values: float) -> None:
        writer.data = b""
        writer.row(name, layout, *values)
        rows.append(writer.data)

    row("vehicle_air_data", "ff", 3_000_000, 94_000.0, 40.0)  # of before the logger began
    for k in range(6000):
        t = 60_000_000 + 10_000 * k
        row("vehicle_attitude", "4f", t, 1.0, 0.0, 0.0, 0.0)
        if k % 2 == 0:
            row("vehicle_air_data", "ff", t - 1500, 94_000.0, 40.0)
        if k % 20 == 0:
            place = (47.5, 8.25, 600.0, 647.5)
            row("sensor_gps", "QddddB", t - 90_000, NOW_US + t, *place, 3)
    return head, rows


def test_triggers_and_feedbacks_of_one_topic_are_two_channels(tmp_path: Path) -> None:
    writer = ULogWriter()
    writer.define("camera_trigger", "uint64_t timestamp_utc;uint32_t seq;bool feedback;")
    writer.define("vehicle_land_detected", "bool landed;")
    writer.subscribe("camera_trigger")
    writer.subscribe("vehicle_land_detected")
    for number in range(1, 9):
        sent_us = 5_000_000 * number
        writer.row("vehicle_land_detected", "?", sent_us, False)
        writer.row("camera_trigger", "QI?", sent_us, 0, number, False)
        writer.row("camera_trigger", "QI?", sent_us + 120_000, 0, number, True)
    log = opened(tmp_path, writer.data)
    pulses = log.channel("camera_trigger")
    commands = log.channel("camera_trigger.sent")
    assert pulses["event_index"].tolist() == commands["event_index"].tolist() == [*range(1, 9)]
    assert ((pulses.time_ns - commands.time_ns) // 1000).tolist() == [120_000] * 8
    assert pulses.rank < commands.rank
    (both,) = [entry for entry in log.ledger if entry.code == "EVENTS-BOTH"]
    assert (both.kind, both.count) == ("note", 16)
    assert log.channel("vehicle_land_detected")["landed"].tolist() == [0.0] * 8


def test_messages_that_were_cut_out_between_records_are_told(tmp_path: Path) -> None:
    head, rows = regular()
    assert not opened(tmp_path, head + b"".join(rows)).ledger.has_losses
    for begin, count in ((2000, 3948), (5000, 60)):
        log = opened(tmp_path, head + b"".join(rows[:begin] + rows[begin + count :]))
        gap = next(e for e in log.ledger if e.code == "LOG-GAP")
        assert (gap.kind, gap.count) == ("finding", 1)
        told = int(gap.what.split("about ")[1].split()[0])
        assert told == pytest.approx(count, rel=0.05)
        seconds = float(gap.where.split("first ")[1].split()[0])
        assert seconds == pytest.approx(60.0 + begin / 155.0, abs=0.1)
    assert not [e for e in log.ledger if e.kind == "loss"]


def test_a_log_that_is_mostly_silent_was_not_logged_all_the_time(tmp_path: Path) -> None:
    """1,300 messages in 8.4 s of 50 s: no message of an intact log is said to be missing."""
    head, rows = regular()
    log = opened(tmp_path, head + b"".join(rows[:650] + rows[-650:]))
    assert not log.ledger.has_losses
    (paused,) = [entry for entry in log.ledger if entry.code == "LOG-PAUSED"]
    assert (paused.kind, paused.count) == ("warning", 1)


def test_events_in_bursts_are_no_steady_topic(tmp_path: Path) -> None:
    """Eight triggers, each with its feedback 0.12 s later, in a log of one attitude a second."""
    writer = ULogWriter()
    writer.define("camera_trigger", "uint64_t timestamp_utc;uint32_t seq;bool feedback;")
    writer.define("vehicle_attitude", "float[4] q;")
    for name in ("camera_trigger", "vehicle_attitude"):
        writer.subscribe(name)
    for number in range(1, 61):
        second_us = 5_000_000 + 1_000_000 * number
        writer.row("vehicle_attitude", "4f", second_us, 1.0, 0.0, 0.0, 0.0)
        if number % 3 == 0:
            writer.row("camera_trigger", "QI?", second_us + 10_000, 0, number, False)
            writer.row("camera_trigger", "QI?", second_us + 130_000, 0, number, True)
    codes = {entry.code for entry in opened(tmp_path, writer.data).ledger}
    assert not codes & {"LOG-GAP", "LOG-PAUSED"}


def test_a_topic_that_is_not_read_shows_that_the_log_goes_on(tmp_path: Path) -> None:
    writer = ULogWriter()
    for name in ("actuator_outputs", "vehicle_attitude"):
        writer.define(name, "float[4] q;")
    for name in ("actuator_outputs", "vehicle_attitude"):
        writer.subscribe(name)
    for k in range(200):
        t = 60_000_000 + 50_000 * k
        writer.row("actuator_outputs", "4f", t, 0.0, 0.0, 0.0, 0.0)
        if not 60 <= k < 120:
            writer.row("vehicle_attitude", "4f", t, 1.0, 0.0, 0.0, 0.0)
    codes = {entry.code for entry in opened(tmp_path, writer.data).ledger}
    assert not codes & {"LOG-GAP", "LOG-PAUSED"}


def test_a_stray_time_is_no_cut(tmp_path: Path) -> None:
    head, rows = regular()
    at = next(k for k in range(1500, 2000) if len(rows[k]) == 29)  # an attitude
    rows[at] = rows[at][:5] + struct.pack("<Q", 900_000_000) + rows[at][13:]
    log = opened(tmp_path, head + b"".join(rows))
    assert {e.code for e in log.ledger if e.kind == "loss"} == {"TIME-STRAY"}


def test_texts_and_parameters(tmp_path: Path) -> None:
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
    writer = ULogWriter()
    for key, value in (
        (b"float EKF2_BARO_DELAY", struct.pack("<f", 110.0)),
        (b"int32_t GPS_1_CONFIG", struct.pack("<i", 201)),
        (b"float EKF2_BARO_DELAY", struct.pack("<f", 127.5)),
    ):
        writer.message("P", bytes([len(key)]) + key + value)
    body = flight()[len(head) :]
    said = [
        (b"L", b"\x34" + struct.pack("<Q", 6_000_000) + b"GPS fix lost"),
        (b"C", b"\x34" + struct.pack("<HQ", 7, 6_500_000) + b"Estimator reset"),
        (b"L", b"\x34" + struct.pack("<Q", 6_000_000) + b"Position lost"),
    ]
    tail = b"".join(struct.pack("<H", len(text)) + kind + text for kind, text in said)
    log = opened(tmp_path, writer.data + body[43:] + tail)
    assert log.parameters == {"EKF2_BARO_DELAY": 127.5, "GPS_1_CONFIG": 201.0}
    channel = log.channel("MSG")
    assert channel.labels["text"] == ("GPS fix lost\nPosition lost", "Estimator reset")
    np.testing.assert_array_equal(
        channel.time_ns, (NOW_US + np.array([6_000_000, 6_500_000])) * 1000
    )
    assert not log.ledger.has_losses
    assert not opened(tmp_path, flight()).parameters


ROLLOVER_US = 1024 * 604_800 * 10**6
UTC_2042_US = 2_272_147_200_000_000


@pytest.mark.parametrize("rollovers", [1, 2])
def test_a_receiver_that_has_rolled_over(tmp_path: Path, rollovers: int) -> None:
    early_us = NOW_US - rollovers * ROLLOVER_US
    log = opened(tmp_path, newer(utc=lambda k: early_us + 200_000 * k).data)
    assert seconds(log, "vehicle_attitude") == WHOLE
    assert [e.kind for e in log.ledger if e.code == "TIME-WEEK-ROLLOVER"] == ["warning"]


def test_a_date_that_no_log_can_have_is_none(tmp_path: Path) -> None:
    """2042 less a rollover is 2022: a clock that was never set is no rollover."""
    log = opened(tmp_path, newer(utc=lambda k: UTC_2042_US + 200_000 * k).data)
    assert not log.has_utc
    assert {"TIME-IMPOSSIBLE", "TIME-NO-UTC"} <= {e.code for e in log.ledger}


@pytest.mark.parametrize("fix", [0, 3])
def test_the_utc_of_the_boot_counts_where_no_receiver_has_a_fix(tmp_path: Path, fix: int) -> None:
    writer = newer(fix=lambda _: fix)
    key = b"uint64_t boot_time_utc_us"
    value = struct.pack("<Q", NOW_US - 60_000_000 + 1_500_000)
    writer.message("I", bytes([len(key)]) + key + value)
    log = opened(tmp_path, writer.data)
    late_s = 0.0 if fix else 1.5
    assert seconds(log, "vehicle_attitude") == pytest.approx([t + late_s for t in WHOLE])
    assert (log.utc_sigma_s == 5.0) is (fix == 0)
