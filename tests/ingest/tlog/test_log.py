"""Telemetry logs against pymavlink, against packets of its own writer, and with damage."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.flight.mount import payload_attitude
from unbend.ingest import Log, open_log
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.tlog.scan import Scan

DEGREE = np.pi / 180.0
SECOND = 10**9
START_US = 1_700_000_000_000_000  # the ground station's clock when the log begins
BOOT_UTC_US = 1_700_000_000_000_000 + 1_260_000 - 60_000_000  # it is 1.26 s slow


def library_rows(path: Path, *messages: str) -> dict[str, list]:
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(path), dialect="all")
    rows: dict[str, list] = {message: [] for message in messages}
    while (row := reader.recv_match(type=list(messages))) is not None:
        rows[row.get_type()].append(row)
    reader.close()
    return rows


def entries(log: Log, code: str) -> list:
    return [entry for entry in log.ledger if entry.code == code]


@pytest.mark.parametrize("name", at_hand("flight.tlog", "pymavlink_swift_flight.tlog"))
def test_columns_are_those_of_the_library_bit_for_bit(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("MAVLINK20", "1")  # so that the library knows the fields of MAVLink 2
    path = LOGS[name]
    log = open_log(path)
    expected = {
        ("SCALED_PRESSURE", "pressure_pa"): ("press_abs", 1.0, 100.0, 0.0),
        ("SCALED_PRESSURE", "board_temperature_k"): ("temperature", 100.0, 1.0, 273.15),
        ("GLOBAL_POSITION_INT", "lat_rad"): ("lat", 1e7, DEGREE, 0.0),
        ("GLOBAL_POSITION_INT", "h_msl_m"): ("alt", 1e3, 1.0, 0.0),
        ("GPS_RAW_INT", "lon_rad"): ("lon", 1e7, DEGREE, 0.0),
        ("VFR_HUD", "airspeed_m_s"): ("airspeed", 1.0, 1.0, 0.0),
    }
    rows = library_rows(path, *{channel for channel, _ in expected})
    for (name, column), (field, divisor, factor, offset) in expected.items():
        theirs = np.array([getattr(row, field) for row in rows[name]], np.float64)
        np.testing.assert_array_equal(log.channel(name)[column], theirs / divisor * factor + offset)
    # MAVLink 1: no ellipsoidal height was sent, none is made up
    sent = "h_ellipsoid_m" in log.channel("GPS_RAW_INT").columns
    assert sent is (path.name == "flight.tlog")


def test_five_boots(real_log: Callable[[str], Path]) -> None:
    path = real_log("pymavlink_swift_flight.tlog")
    log = open_log(path)
    assert log.boots == 5
    channel = log.channel("SCALED_PRESSURE")
    rows = library_rows(path, "SCALED_PRESSURE")["SCALED_PRESSURE"]
    since_boot = np.array([row.time_boot_ms for row in rows], np.int64) * 1_000_000
    boots = np.concatenate([[0], np.cumsum(np.diff(since_boot) < 0)])
    np.testing.assert_array_equal(channel.boot, boots)
    for boot in range(5):  # within a boot, time is the vehicle's, moved as a whole
        mine = boots == boot
        assert np.ptp(channel.time_ns[mine] - since_boot[mine]) == 0
    agreement = [e.where[-6:] for e in entries(log, "TIME-FIT") if "accurate" not in e.what]
    assert agreement == [f"boot {k}" for k in range(5)]


def test_repeats_and_the_empty_row_of_the_camera_feedback(
    real_log: Callable[[str], Path],
) -> None:
    log = open_log(real_log("sitl_belowsea_2cam.tlog"))
    assert log.messages["CAMERA_FEEDBACK"] == 510
    assert len(log.channel("CAMERA_FEEDBACK[0]")) == 127
    assert len(log.channel("CAMERA_FEEDBACK[1]")) == 128
    assert sum(entry.count for entry in entries(log, "EVENT-REPEAT")) == 254
    assert [entry.count for entry in entries(log, "EVENT-EMPTY")] == [1]
    assert entries(log, "EVENT-NO-PULSE")[0].where == "CAMERA_FEEDBACK[0]"


def test_the_two_logs_of_one_flight_agree(real_log: Callable[[str], Path]) -> None:
    tlog = open_log(real_log("sitl_belowsea_2cam.tlog"))
    flash = open_log(real_log("sitl_belowsea_2cam.BIN"))
    for camera in (0, 1):
        ours = tlog.channel(f"CAMERA_FEEDBACK[{camera}]")
        theirs = flash.channel(f"CAM[{camera}]")
        # two clocks fitted to UTC apart; the receiver's time moves in steps of 200 ms
        apart = (ours.time_ns - theirs.time_ns) / 1e9
        assert np.abs(apart).max() < 0.25
        assert np.ptp(apart) < 2e-5  # camera 1 is stamped once for each log
        np.testing.assert_array_equal(ours["event_index"], theirs["event_index"])
        np.testing.assert_allclose(ours["lat_rad"], theirs["lat_rad"], atol=1e-15)


def test_a_ground_station_with_its_own_system_time_is_not_the_vehicle(
    real_log: Callable[[str], Path],
) -> None:
    log = open_log(real_log("ardusub_small.tlog"))
    assert log.messages["SYSTEM_TIME"] == 794  # 792 of the vehicle, 2 of the ground station
    assert [entry.kind for entry in entries(log, "TIME-HOST-CLOCK")] == ["fallback"]
    assert log.channel("NAMED_VALUE_FLOAT[Lights1]").roles == ()
    assert sum(entry.count for entry in entries(log, "LOG-DIALECT")) == 4


class TlogWriter:
    """Packets of pymavlink's own encoder with the stamps of a ground station."""

    def __init__(self, version: int = 2) -> None:
        from pymavlink.dialects.v20 import all as dialect

        self.dialect = dialect
        self.version = version
        self.senders: dict[tuple[int, int], object] = {}
        self.frames: list[bytes] = []

    def send(self, kind: str, at_ms: int, /, *, source: tuple[int, int] = (1, 1), **fields) -> None:
        """A message sent at_ms after boot; it arrives 40 ms later."""
        library = self.dialect
        if source not in self.senders:
            self.senders[source] = library.MAVLink(None, *source)
        message = getattr(library, f"MAVLink_{kind}_message")(**fields)
        packet = message.pack(self.senders[source], force_mavlink1=self.version == 1)
        self.senders[source].seq = (self.senders[source].seq + 1) % 256
        stamp = START_US + (at_ms - 60_000) * 1000 + 40_000
        self.frames.append(struct.pack(">Q", stamp) + packet)

    @property
    def data(self) -> bytes:
        return b"".join(self.frames)


def flight(
    version: int = 2, *, utc: bool = True, seconds: int = 20, cabin_system: int = 1
) -> TlogWriter:
    writer = TlogWriter(version)
    for k in range(seconds * 5):
        ms = 60_000 + 200 * k
        unix = BOOT_UTC_US + ms * 1000 if utc else 0
        if k % 5 == 0:
            writer.send("system_time", ms, time_unix_usec=unix, time_boot_ms=ms)
            writer.send(
                "system_time",
                ms,
                source=(255, 190),
                time_unix_usec=1_600_000_000_000_000,
                time_boot_ms=5,
            )
            if version == 2:  # MAVLink 1 has no ids above 255
                writer.send("hygrometer_sensor", ms, id=2, temperature=-1250, humidity=4725)
                writer.send(
                    "airspeed", ms, id=0, airspeed=41.5, temperature=32767, raw_press=1.0, flags=0
                )
            writer.send("named_value_float", ms, time_boot_ms=ms, name=b"CabT", value=21.5)
        writer.send(
            "attitude",
            ms,
            time_boot_ms=ms,
            roll=0.1,
            pitch=-0.2,
            yaw=3.0,
            rollspeed=0.0,
            pitchspeed=0.0,
            yawspeed=0.0,
        )
        writer.send(
            "scaled_pressure",
            ms,
            time_boot_ms=ms,
            press_abs=700.25,
            press_diff=0.0,
            temperature=4500,
            temperature_press_diff=0,
        )
        writer.send(
            "scaled_pressure",
            ms,
            source=(cabin_system, 25),
            time_boot_ms=ms,
            press_abs=850.5,
            press_diff=0.0,
            temperature=2500,
            temperature_press_diff=0,
        )
        writer.send(
            "gps_raw_int",
            ms,
            time_usec=ms * 1000,
            fix_type=3,
            lat=470000000 + k,
            lon=-1225000000,
            alt=600_250,
            eph=80,
            epv=90,
            vel=0,
            cog=0,
            satellites_visible=12,
            alt_ellipsoid=580_500 if k >= 50 else 0,
            h_acc=450,
            v_acc=0,
        )
    return writer


def opened(tmp_path: Path, data: bytes) -> Log:
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    return open_log(path)


@pytest.mark.parametrize("version", [1, 2])
def test_known_flight(tmp_path: Path, version: int) -> None:
    log = opened(tmp_path, flight(version).data)
    vehicle = log.channel("SCALED_PRESSURE@1/1")
    cabin = log.channel("SCALED_PRESSURE@1/25")
    np.testing.assert_array_equal(vehicle["pressure_pa"], np.full(100, 70_025.0))
    assert cabin["pressure_pa"][0] == 85_050.0
    utc_ns = (BOOT_UTC_US + 60_000_000) * 1000
    np.testing.assert_array_equal(vehicle.time_ns, utc_ns + np.arange(100) * SECOND // 5)
    np.testing.assert_array_equal(log.channel("ATTITUDE").time_ns, vehicle.time_ns)
    gps = log.channel("GPS_RAW_INT")
    np.testing.assert_array_equal(gps.time_ns, vehicle.time_ns)
    if version == 2:
        assert np.isnan(gps["h_ellipsoid_m"][:50]).all()
        np.testing.assert_array_equal(gps["h_ellipsoid_m"][50:], np.full(50, 580.5))
        assert gps["sigma_h_m"][0] == pytest.approx(0.45 / np.sqrt(2.0))
        assert "sigma_v_m" not in gps.columns
        air = log.channel("HYGROMETER_SENSOR[2]")
        assert air["temperature_k"][0] == 273.15 - 12.5
        assert air["relative_humidity"][0] == 0.4725
        # no time of its own: the vehicle's time, by the messages it arrived with
        expected = utc_ns + np.arange(20) * SECOND
        np.testing.assert_allclose(air.time_ns - utc_ns, expected - utc_ns, atol=1e6)
        assert log.channel("AIRSPEED[0]").roles == ("airspeed",)
        assert "temperature_k" not in log.channel("AIRSPEED[0]").columns
    assert log.channel("NAMED_VALUE_FLOAT[CabT]")["value"][3] == 21.5
    assert (log.boots, log.bad_bytes, log.lost_messages) == (1, 0, 0)
    assert "SYSTEM_TIME" in log.time_base
    assert not log.ledger.has_losses


def test_without_utc_the_ground_stations_clock_is_a_stated_fallback(tmp_path: Path) -> None:
    log = opened(tmp_path, flight(utc=False).data)
    assert {entry.kind for entry in entries(log, "TIME-HOST-CLOCK")} == {"fallback"}
    attitude = log.channel("ATTITUDE")
    assert attitude.time_ns[0] == START_US * 1000 + 40_000_000
    assert np.ptp(np.diff(attitude.time_ns)) == 0
    assert not log.ledger.has_losses


def test_a_new_boot_in_a_fresh_log(tmp_path: Path) -> None:
    first = flight(seconds=10)
    second = flight(seconds=10)
    hour = 3_600 * 1_000_000
    for k, frame in enumerate(second.frames):
        stamp = struct.unpack(">Q", frame[:8])[0] + hour
        second.frames[k] = struct.pack(">Q", stamp) + frame[8:]
    log = opened(tmp_path, first.data + second.data)
    assert log.boots == 2


def test_camera_feedback_in_unix_time_and_in_time_since_boot(tmp_path: Path) -> None:
    place = {
        "target_system": 0,
        "lat": 470000000,
        "lng": -1225000000,
        "alt_msl": 600.0,
        "alt_rel": 30.0,
        "roll": 1.0,
        "pitch": 2.0,
        "yaw": 3.0,
        "foc_len": 0.0,
        "flags": 0,
    }
    writer = flight()
    for k in range(3):
        ms = 64_000 + k * 1000
        shots = ((0, ms * 1000), (1, BOOT_UTC_US + ms * 1000))
        for camera, stamp in shots:
            writer.send("camera_feedback", ms, cam_idx=camera, img_idx=k, time_usec=stamp, **place)
        writer.send("camera_trigger", ms, time_usec=ms * 1000, seq=k + 7)
    log = opened(tmp_path, writer.data)
    first = log.channel("CAMERA_FEEDBACK[0]")
    second = log.channel("CAMERA_FEEDBACK[1]")
    np.testing.assert_array_equal(first.time_ns, second.time_ns)
    np.testing.assert_array_equal(first.time_ns, log.channel("CAMERA_TRIGGER").time_ns)
    assert first.time_ns[0] == (BOOT_UTC_US + 64_000_000) * 1000
    np.testing.assert_array_equal(log.channel("CAMERA_TRIGGER")["event_index"], [7, 8, 9])
    assert first["pitch_rad"][0] == pytest.approx(2 * DEGREE, abs=1e-15)


def test_a_trigger_without_a_time_is_placed_by_when_it_was_received(tmp_path: Path) -> None:
    writer = flight()
    for k in range(3):
        stamp = 0 if k == 1 else 90_000_000 + k * 1_000_000
        writer.send("camera_trigger", 79_000 + k * 100, time_usec=stamp, seq=k)
    times = opened(tmp_path, writer.data).channel("CAMERA_TRIGGER")
    np.testing.assert_array_equal(times["event_index"], [1, 0, 2])
    # the host's clock is 1.26 s slow, messages arrive 40 ms late; both are in its map to UTC
    received = (BOOT_UTC_US + 79_100_000) * 1000
    assert abs(times.time_ns[0] - received) < 1_000_000


@pytest.mark.parametrize("row", [0, 5, 60])
def test_a_stamp_days_ahead_costs_one_row(tmp_path: Path, row: int) -> None:
    writer = TlogWriter()
    for k in range(1000):
        ms = 60_000 + 100 * k
        if k % 10 == 0:
            writer.send("system_time", ms, time_unix_usec=BOOT_UTC_US + ms * 1000, time_boot_ms=ms)
            writer.send("hygrometer_sensor", ms, id=2, temperature=-1250, humidity=4725)
        ahead = 11 * 86_400_000 if k == row else 0
        writer.send(
            "attitude",
            ms,
            time_boot_ms=ms + ahead,
            roll=0.1,
            pitch=-0.2,
            yaw=3.0,
            rollspeed=0.0,
            pitchspeed=0.0,
            yawspeed=0.0,
        )
    log = opened(tmp_path, writer.data)
    assert (log.boots, len(log.channel("ATTITUDE"))) == (1, 999)
    loss = entries(log, "TIME-BACKWARD")[0]
    assert (loss.kind, loss.count) == ("loss", 1)
    assert f"first at row {row}," in loss.where
    # messages without a time of their own keep the vehicle's, before and after
    air = log.channel("HYGROMETER_SENSOR[2]")
    expected = (BOOT_UTC_US + 60_000_000) * 1000 + np.arange(100) * SECOND
    np.testing.assert_allclose((air.time_ns - expected).astype(float), 0.0, atol=1e6)


def test_instances_of_equal_standing_rank_alike(tmp_path: Path) -> None:
    writer = flight()
    for k in range(5):
        ms = 64_000 + 200 * k
        for unit in (0, 1):
            writer.send("hygrometer_sensor", ms, id=unit, temperature=-1250, humidity=4725)
            writer.send(
                "airspeed", ms, id=unit, airspeed=41.5, temperature=-1250, raw_press=1.0, flags=0
            )
    ranks = {channel.name: channel.rank for channel in opened(tmp_path, writer.data).channels}
    assert len({ranks[f"HYGROMETER_SENSOR[{unit}]"] for unit in (0, 1, 2)}) == 1
    assert ranks["AIRSPEED[0]"] == ranks["AIRSPEED[1]"]
    assert ranks["SCALED_PRESSURE@1/1"] == ranks["SCALED_PRESSURE@1/25"]


def test_a_late_first_feedback_is_put_in_order(tmp_path: Path) -> None:
    writer = flight()
    for k in (0, 2, 1):
        writer.send(
            "camera_feedback",
            70_000 + k,
            cam_idx=0,
            img_idx=k,
            target_system=0,
            time_usec=(62 + k) * 10**6,
            lat=1,
            lng=1,
            alt_msl=1.0,
            alt_rel=1.0,
            roll=0.0,
            pitch=0.0,
            yaw=0.0,
            foc_len=0.0,
            flags=0,
        )
    log = opened(tmp_path, writer.data)
    np.testing.assert_array_equal(log.channel("CAMERA_FEEDBACK[0]")["event_index"], [0, 1, 2])


def test_a_flipped_payload_bit_costs_one_message_and_is_a_loss(tmp_path: Path) -> None:
    writer = flight()
    whole = opened(tmp_path, writer.data)
    victim = next(k for k, frame in enumerate(writer.frames) if frame[15] == 30 and k > 50)
    frame = bytearray(writer.frames[victim])
    frame[20] ^= 4
    writer.frames[victim] = bytes(frame)
    log = opened(tmp_path, writer.data)
    assert log.messages["ATTITUDE"] == whole.messages["ATTITUDE"] - 1
    assert log.bad_bytes == len(frame)
    assert entries(log, "LOG-CRC")[0].kind == "loss"


@pytest.mark.parametrize("byte", [0, 1, 8, 9, 10])
def test_a_flipped_header_costs_one_message(tmp_path: Path, byte: int) -> None:
    writer = flight()
    count = len(writer.frames)
    frame = bytearray(writer.frames[60])
    frame[byte] ^= 0x10 if byte != 10 else 1
    writer.frames[60] = bytes(frame)
    log = opened(tmp_path, writer.data)
    assert sum(log.messages.values()) == count - 1
    assert log.bad_bytes == len(frame)
    assert log.ledger.has_losses


def test_garbage_between_frames_is_counted(tmp_path: Path) -> None:
    writer = flight()
    writer.frames.insert(100, b"\xfd\xfe" * 150)
    log = opened(tmp_path, writer.data)
    assert sum(log.messages.values()) == len(writer.frames) - 1
    assert (log.bad_bytes, entries(log, "LOG-BAD-BYTES")[0].count) == (300, 300)


def test_a_cut_last_message_costs_no_other(tmp_path: Path) -> None:
    data = flight().data
    log = opened(tmp_path, data[:-3])
    assert entries(log, "LOG-TRUNCATED")[0].kind == "loss"
    assert log.bad_bytes == 0


def test_messages_lost_by_the_link_are_counted_by_sequence(tmp_path: Path) -> None:
    writer = flight()
    mine = [k for k, frame in enumerate(writer.frames) if frame[13:15] == b"\x01\x01"]
    for k in mine[40:47][::-1] + mine[10:11]:
        del writer.frames[k]
    log = opened(tmp_path, writer.data)
    assert log.lost_messages == 8
    assert entries(log, "LOG-LINK-LOSS")[0].kind == "finding"
    extras = {key: found.crc_extra for key, found in writer.dialect.mavlink_map.items()}
    assert Scan(view_of_bytes(writer.data), extras, {}).lost[(255, 190)] == 0


@pytest.mark.parametrize(("missing", "told"), [(200, 200), (512, 0), (700, 188), (40, 40)])
def test_a_hole_is_a_gap_and_its_messages_are_counted_at_least(
    tmp_path: Path, missing: int, told: int
) -> None:
    """Sequence numbers begin again after 256: two rounds more or less look alike."""
    writer = flight(seconds=90)
    mine = [k for k, frame in enumerate(writer.frames) if frame[13:15] == b"\x01\x01"]
    place = sum(map(len, writer.frames[: mine[200]]))
    for k in mine[200 : 200 + missing][::-1]:
        del writer.frames[k]
    log = opened(tmp_path, writer.data)
    (gap,) = entries(log, "LOG-GAP") if missing > 60 else [None]
    if gap is not None:
        assert (gap.kind, gap.count) == ("finding", 1)
        assert "system 1, component 1 " in gap.what
        assert place <= int(gap.where.rpartition(" ")[2]) <= place + 2000 * 60
    assert log.lost_messages == told
    assert all(f"at least {told} " in entry.what for entry in entries(log, "LOG-LINK-LOSS"))
    assert log.ledger.has_losses


@pytest.mark.parametrize("change", ["set", "stray", "stray back", "restart"])
def test_what_is_no_hole(tmp_path: Path, change: str) -> None:
    """A ground station's clock that was set or has stray stamps, and a vehicle that was off."""
    writer = flight(seconds=30)
    if change == "restart":
        writer.frames += flight(seconds=30).frames
    rows = slice(300, None) if change in ("set", "restart") else slice(300, 303)
    day_us = 86_400_000_000 * (-1 if change == "stray back" else 1)
    writer.frames[rows] = [
        struct.pack(">Q", struct.unpack(">Q", frame[:8])[0] + day_us) + frame[8:]
        for frame in writer.frames[rows]
    ]
    log = opened(tmp_path, writer.data)
    assert entries(log, "LOG-GAP") == []


@pytest.mark.parametrize("ahead_s", [-86_400, 86_400, 3.5])
def test_stray_stamps_of_a_sender_without_a_clock(tmp_path: Path, ahead_s: float) -> None:
    writer = flight(seconds=2)
    for k in range(200):
        ms = 62_000 + 100 * k
        writer.send("hygrometer_sensor", ms, source=(1, 30), id=0, temperature=-1250, humidity=4725)
    for row in (-100, -98):
        stamp = struct.unpack(">Q", writer.frames[row][:8])[0] + round(ahead_s * 1e6)
        writer.frames[row] = struct.pack(">Q", stamp) + writer.frames[row][8:]
    assert entries(opened(tmp_path, writer.data), "LOG-GAP") == []
    del writer.frames[-60:-20]
    (gap,) = entries(opened(tmp_path, writer.data), "LOG-GAP")
    assert "component 30 " in gap.what
    assert " 4.1 s " in gap.what


def test_a_log_and_itself_has_no_losses_of_what_was_never_there(tmp_path: Path) -> None:
    """temperature_press_diff is 0, unknown, in all messages: no channel, and nothing to lose."""
    whole = flight(seconds=30).data
    log = opened(tmp_path, whole + whole)
    assert {e.where.partition(",")[0] for e in log.ledger if "press_diff" in e.where} == set()


def test_a_message_of_an_unknown_id_is_counted(tmp_path: Path) -> None:
    writer = flight()
    unknown = b"\xfd" + bytes([3, 0, 0, 0, 1, 99]) + (60_001).to_bytes(3, "little") + b"abcXY"
    writer.frames.insert(50, writer.frames[50][:8] + unknown)
    log = opened(tmp_path, writer.data)
    assert log.messages["UNKNOWN_60001"] == 1
    assert entries(log, "LOG-UNKNOWN-ID")[0].count == 1
    assert log.bad_bytes == 0


def test_a_count_of_milliseconds_that_runs_over_is_counted_on(tmp_path: Path) -> None:
    """32 bits hold 49.7 days; the host's clock tells the turn from a new boot."""
    begin = 2**32 - 9_990
    boot_utc_us = START_US - begin * 1000
    writer = TlogWriter()
    for k in range(100):
        ms = begin + 200 * k - (300 if k == 51 else 0)  # one is overtaken as the count turns
        at = 60_000 + 200 * k
        if k % 10 == 0:
            unix = boot_utc_us + ms * 1000
            writer.send("system_time", at, time_unix_usec=unix, time_boot_ms=ms % 2**32)
        writer.send(
            "scaled_pressure",
            at,
            time_boot_ms=ms % 2**32,
            press_abs=700.0 + k,
            press_diff=0.0,
            temperature=4500,
            temperature_press_diff=0,
        )
        writer.send(
            "gps_raw_int",
            at,
            time_usec=ms % 2**32 * 1000,
            fix_type=3,
            lat=470000000,
            lon=-1225000000 - k,
            alt=600_250,
            eph=80,
            epv=90,
            vel=0,
            cog=0,
            satellites_visible=12,
        )
        writer.send("camera_trigger", at, time_usec=ms * 1000 % 2**32, seq=k)
    log = opened(tmp_path, writer.data)
    assert log.boots == 1
    assert [(entry.kind, entry.count) for entry in entries(log, "TIME-WRAP")] == [("note", 1)]
    first = START_US * 1000
    every = np.arange(100) * SECOND // 5
    every[51] -= 300_000_000
    for name in ("SCALED_PRESSURE", "GPS_RAW_INT"):  # what was overtaken is where it was sent
        np.testing.assert_array_equal(log.channel(name).time_ns - first, np.sort(every))
    shots = log.channel("CAMERA_TRIGGER")
    np.testing.assert_array_equal(shots.time_ns - first, np.sort(every))


def test_a_new_boot_after_weeks_is_no_overrun(tmp_path: Path) -> None:
    writer = TlogWriter()
    for k in range(60):
        up = 30 * 86_400_000 if k < 30 else 0  # 30 days up, then 5 s
        ms = up + 5_000 + 200 * k
        writer.send(
            "attitude",
            60_000 + 200 * k,
            time_boot_ms=ms,
            roll=0.1,
            pitch=-0.2,
            yaw=3.0,
            rollspeed=0.0,
            pitchspeed=0.0,
            yawspeed=0.0,
        )
    log = opened(tmp_path, writer.data)
    assert (log.boots, entries(log, "TIME-WRAP")) == (2, [])


@pytest.mark.parametrize(("value", "column"), [(16.0, "h_ellipsoid_m"), (2.0, "h_msl_m")])
def test_heights_above_the_ellipsoid_by_parameter(
    tmp_path: Path, value: float, column: str
) -> None:
    writer = TlogWriter()
    name = b"GPS_DRV_OPTIONS"
    writer.send(
        "param_value",
        60_000,
        param_id=name,
        param_value=value,
        param_type=9,
        param_count=1,
        param_index=0,
    )
    writer.send(
        "param_value",
        60_000,
        source=(255, 190),
        param_id=name,
        param_value=18.0 - value,
        param_type=9,
        param_count=1,
        param_index=0,
    )
    for k in range(10):
        ms = 60_000 + 200 * k
        writer.send(
            "global_position_int",
            ms,
            time_boot_ms=ms,
            lat=470000000,
            lon=-1225000000 + k,
            alt=600_250,
            relative_alt=30_000,
            vx=0,
            vy=0,
            vz=0,
            hdg=0,
        )
    log = opened(tmp_path, writer.data)
    channel = log.channel("GLOBAL_POSITION_INT")
    assert channel[column][0] == 600.25
    assert channel["h_home_m"][0] == 30.0
    assert len({"h_msl_m", "h_ellipsoid_m"} & set(channel.columns)) == 1
    assert len(entries(log, "HEIGHT-ELLIPSOID")) == (value == 16.0)


def test_images_captured(tmp_path: Path) -> None:
    writer = flight()
    q = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    for k, result in enumerate((1, 0, 1, 1, 1)):
        for _ in range(2 if k == 3 else 1):  # asked for again
            ms = 62_000 + 1000 * k
            writer.send(
                "camera_image_captured",
                ms,
                time_boot_ms=ms,
                time_utc=0,
                camera_id=0,
                lat=470000000 + k,
                lon=-1225000000,
                alt=700_500,
                relative_alt=100_000,
                q=q,
                image_index=k,
                capture_result=result,
                file_url=f"DCIM/{k}.jpg".encode(),
            )
    log = opened(tmp_path, writer.data)
    images = log.channel("CAMERA_IMAGE_CAPTURED[0]")
    assert images.roles == ("events",)
    np.testing.assert_array_equal(images["event_index"], [0, 2, 3, 4])
    assert images.labels["file_url"] == tuple(f"DCIM/{k}.jpg" for k in (0, 2, 3, 4))
    np.testing.assert_array_equal(images["h_msl_m"], np.full(4, 700.5))
    assert images.time_ns[0] == (BOOT_UTC_US + 62_000_000) * 1000
    assert [(entry.kind, entry.count) for entry in entries(log, "EVENT-FAILED")] == [("warning", 1)]
    assert entries(log, "EVENT-REPEAT")[0].count == 1


def test_gimbals(tmp_path: Path) -> None:
    """Channels, but of no role by themselves; an attitude only where the yaw is from north."""
    writer = flight()
    q = np.array([0.8, 0.1, -0.5, 0.3])
    q /= np.linalg.norm(q)
    for k, flags in enumerate((0, 16, 32, 64, 48)):
        ms = 62_000 + 1000 * k
        writer.send(
            "gimbal_device_attitude_status",
            ms,
            target_system=0,
            target_component=0,
            time_boot_ms=ms,
            flags=flags,
            q=q.tolist(),
            angular_velocity_x=0.0,
            angular_velocity_y=0.0,
            angular_velocity_z=0.0,
            failure_flags=0,
        )
        writer.send(
            "mount_orientation",
            ms,
            time_boot_ms=ms,
            roll=0.0,
            pitch=-90.0,
            yaw=10.0,
            yaw_absolute=90.0 if k else 0.0,
        )
        writer.send(
            "mount_status",
            ms,
            target_system=0,
            target_component=0,
            pointing_a=-9000,
            pointing_b=150,
            pointing_c=1000,
        )
    log = opened(tmp_path, writer.data)
    device = log.channel("GIMBAL_DEVICE_ATTITUDE_STATUS[0]")
    north = np.isfinite(device["q_w"])
    np.testing.assert_array_equal(north, [False, True, False, True, False])
    np.testing.assert_allclose(device["q_y"][north], q[2], atol=1e-7)
    np.testing.assert_allclose(device["gimbal_q_y"], q[2], atol=1e-7)
    mount = log.channel("MOUNT_ORIENTATION")
    np.testing.assert_array_equal(np.isfinite(mount["q_w"]), [False, *[True] * 4])
    # straight down, top towards the east: R(yaw 90) R(pitch -90)
    np.testing.assert_allclose([mount[f"q_{a}"][1] for a in "wxyz"], [0.5, 0.5, -0.5, 0.5])
    assert mount["gimbal_yaw_rad"][0] == 10 * DEGREE
    assert log.channel("MOUNT_STATUS")["gimbal_roll_rad"][0] == pytest.approx(1.5 * DEGREE)
    assert {device.roles, mount.roles, log.channel("MOUNT_STATUS").roles} == {()}


def test_mount_status_of_two_heads(tmp_path: Path) -> None:
    """Two gimbals of one aircraft by their components: each has its own angles, none is mixed."""
    writer = flight()
    for k in range(10):
        for component, pitch, roll in ((154, -9000, 150), (171, -4500, -300)):
            writer.send(
                "mount_status",
                62_000 + 500 * k,
                source=(1, component),
                target_system=0,
                target_component=0,
                pointing_a=pitch,
                pointing_b=roll,
                pointing_c=1000,
            )
    log = opened(tmp_path, writer.data)
    heads = [channel for channel in log.channels if channel.name.startswith("MOUNT_STATUS")]
    assert [head.source.component for head in heads] == [154, 171]
    for head, pitch, roll in zip(heads, (-90.0, -45.0), (1.5, -3.0), strict=True):
        assert len(head) == 10
        np.testing.assert_allclose(head["gimbal_pitch_rad"], pitch * DEGREE)
        np.testing.assert_allclose(head["gimbal_roll_rad"], roll * DEGREE)


def test_a_stabilised_gimbal_of_a_real_flight(real_log: Callable) -> None:
    """Its servos counter the copter's roll: composed, the roll is steady."""
    log = open_log(real_log("pymavlink_swift_flight.tlog"))
    mount, (told,) = payload_attitude(log.channel("MOUNT_STATUS"), log.channel("ATTITUDE"), 2.0)
    assert "compensate the motion" in told.what
    known = np.isfinite(mount["q_w"])
    assert known.mean() > 0.98
    q = np.stack([mount[f"q_{axis}"][known] for axis in "xyzw"], axis=1)
    roll = Rotation.from_quat(q).as_euler("ZYX")[:, 2]
    spread = [
        np.subtract(*np.percentile(x, (95, 5))) / DEGREE for x in (roll, mount["gimbal_roll_rad"])
    ]
    assert spread[0] < 1.0 < 7.0 < spread[1]


def test_every_type_is_a_table(tmp_path: Path) -> None:
    log = opened(tmp_path, flight().data)
    assert log.message_types()["ATTITUDE"] == 100
    table = log.message("ATTITUDE")
    assert [*table][:5] == ["time_ns", "boot", "system", "component", "time_boot_ms"]
    np.testing.assert_array_equal(table["time_ns"], log.channel("ATTITUDE").time_ns)
    assert log.message("NAMED_VALUE_FLOAT", "CabT")["name"].tolist() == ["CabT"] * 20
    with pytest.raises(LogError, match="LOG-NO-TABLE"):
        log.message("NAMED_VALUE_FLOAT", "CabX")


def test_any_damage_opens_or_refuses(tmp_path: Path) -> None:
    data = flight(seconds=6).data
    source = random.Random(2)
    for _ in range(40):
        damaged = bytearray(data)
        for _ in range(source.choice((1, 20, 200))):
            damaged[source.randrange(len(damaged))] ^= 1 << source.randrange(8)
        cut = source.randrange(len(damaged))
        del damaged[cut : cut + source.randrange(400)]
        log = opened(tmp_path, bytes(damaged))
        assert log.ledger.has_losses
        assert log.bad_bytes > 0


@pytest.mark.parametrize("damaged", [1, 5])
def test_failed_checksums_are_damage_unless_all_of_an_unneeded_message_fail(
    tmp_path: Path, damaged: int
) -> None:
    """All fail where another version of the dialect defines the message."""
    writer = flight()
    whole = len(writer.frames)
    for k in range(5):
        writer.send(
            "heartbeat",
            80_000 + 1000 * k,
            type=1,
            autopilot=3,
            base_mode=0,
            custom_mode=0,
            system_status=4,
            mavlink_version=3,
        )
    for k in range(whole, whole + damaged):
        frame = bytearray(writer.frames[k])
        frame[20] ^= 4
        writer.frames[k] = bytes(frame)
    log = opened(tmp_path, writer.data)
    code, kind = ("LOG-DIALECT", "warning") if damaged == 5 else ("LOG-CRC", "loss")
    found = [e for e in log.ledger if e.code in ("LOG-DIALECT", "LOG-CRC")]
    assert [(e.code, e.kind, e.count) for e in found] == [(code, kind, damaged)]
    assert log.messages.get("HEARTBEAT", 0) == 5 - damaged


def test_the_last_message_ends_with_the_file(tmp_path: Path) -> None:
    log = opened(tmp_path, flight().data)
    assert (log.messages["GPS_RAW_INT"], log.bad_bytes) == (100, 0)
    assert [e for e in log.ledger if e.kind == "loss"] == []
