"""Telemetry logs: real ones, packets of pymavlink's own writer, and damage."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import with_code
from tests.ingest.written_logs import MavlinkWriter, entry_in, restamped
from unbend.errors import LogError
from unbend.ingest import open_log
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.tlog.scan import STRETCH, Scan

DEGREE = np.pi / 180.0
SECOND = 10**9
DAY_US = 86_400 * 10**6
START_US = 1_700_000_000_000_000  # the ground station's clock when the log begins
BOOT_UTC_US = START_US + 1_260_000 - 60_000_000  # it is 1.26 s slow
BEGIN_NS = (BOOT_UTC_US + 60_000_000) * 1000  # UTC of the first message
AIR = {"temperature": -1250, "humidity": 4725}
PLACE = {"lat": 470_000_000, "lng": -1_225_000_000}


class Vehicle(MavlinkWriter):
    """Messages sent at times since boot, 40 ms before they arrive."""

    def sent(self, name, at_ms, /, **fields):
        received_us = START_US + (at_ms - 60_000) * 1000 + 40_000
        self.send(name, received_us, **fields)

    def utc(self, ms, at_ms=None):
        """The vehicle's clock, and UTC by it."""
        at_ms = ms if at_ms is None else at_ms
        self.sent(
            "system_time",
            at_ms,
            time_unix_usec=BOOT_UTC_US + ms * 1000,
            time_boot_ms=ms,
        )

    def autopilots_frames(self):
        """Which frames are of system 1, component 1."""
        return [k for k, frame in enumerate(self.frames) if frame[13:15] == b"\x01\x01"]

    def flip(self, frame, byte, bits):
        flipped = bytearray(self.frames[frame])
        flipped[byte] ^= bits
        self.frames[frame] = bytes(flipped)


def flight(version=2, *, seconds=20):
    """Five times a second attitude, two barometers and a receiver; each second clocks and air."""
    writer = Vehicle(version)
    for k in range(seconds * 5):
        ms = 60_000 + 200 * k
        if k % 5 == 0:
            writer.utc(ms)
            host_us = 1_600_000_000_000_000
            writer.sent(
                "system_time", ms, source=(255, 190), time_unix_usec=host_us, time_boot_ms=5
            )
            if version == 2:  # MAVLink 1 has no ids above 255
                writer.sent("hygrometer_sensor", ms, id=2, **AIR)
                writer.sent("airspeed", ms, airspeed=41.5, temperature=32767)
            writer.sent(
                "named_value_float",
                ms,
                time_boot_ms=ms,
                name=b"CabT",
                value=21.5,
            )
        writer.sent("attitude", ms, time_boot_ms=ms, yaw=3.0)
        writer.sent("scaled_pressure", ms, time_boot_ms=ms, press_abs=700.25)
        writer.sent(
            "scaled_pressure",
            ms,
            source=(1, 25),
            time_boot_ms=ms,
            press_abs=850.5,
        )
        writer.sent(
            "gps_raw_int",
            ms,
            time_usec=ms * 1000,
            fix_type=3,
            lat=470_000_000 + k,
            lon=-1_225_000_000,
            alt=600_250,
            alt_ellipsoid=580_500 if k >= 50 else 0,
            h_acc=450,
        )
    return writer


def test_five_boots(real_log):
    log = open_log(real_log("pymavlink_swift_flight.tlog"))
    assert log.boots == 5
    assert "h_ellipsoid_m" not in log.channel("GPS_RAW_INT").columns  # MAVLink 1 sends none
    channel = log.channel("SCALED_PRESSURE")
    boot_ms = log.message("SCALED_PRESSURE")["time_boot_ms"]
    since_boot = boot_ms.astype(np.int64) * 1_000_000
    boots = np.concatenate([[0], np.cumsum(np.diff(since_boot) < 0)])
    assert_array_equal(channel.boot, boots)
    for boot in range(5):  # within a boot, time is the vehicle's, moved as a whole
        in_boot = boots == boot
        assert np.ptp(channel.time_ns[in_boot] - since_boot[in_boot]) == 0
    fits = [entry for entry in with_code(log.ledger, "TIME-FIT") if "accurate" not in entry.what]
    assert [entry.where[-6:] for entry in fits] == [f"boot {k}" for k in range(5)]


def test_repeats_and_the_empty_row_of_the_camera_feedback(real_log):
    log = open_log(real_log("sitl_belowsea_2cam.tlog"))
    assert log.messages["CAMERA_FEEDBACK"] == 510
    assert len(log.channel("CAMERA_FEEDBACK[0]")) == 127
    assert len(log.channel("CAMERA_FEEDBACK[1]")) == 128
    assert sum(entry.count for entry in with_code(log.ledger, "EVENT-REPEAT")) == 254
    assert entry_in(log, "EVENT-EMPTY").count == 1
    assert entry_in(log, "EVENT-NO-PULSE").where == "CAMERA_FEEDBACK[0]"


def test_the_two_logs_of_one_flight_agree(real_log):
    tlog = open_log(real_log("sitl_belowsea_2cam.tlog"))
    flash = open_log(real_log("sitl_belowsea_2cam.BIN"))
    for camera in (0, 1):
        ours = tlog.channel(f"CAMERA_FEEDBACK[{camera}]")
        theirs = flash.channel(f"CAM[{camera}]")
        # two clocks fitted to UTC apart; the receiver's time moves in steps of 200 ms
        apart = (ours.time_ns - theirs.time_ns) / 1e9
        assert np.abs(apart).max() < 0.25
        assert np.ptp(apart) < 2e-5  # camera 1 is stamped once for each log
        assert_array_equal(ours["event_index"], theirs["event_index"])
        assert_allclose(ours["lat_rad"], theirs["lat_rad"], atol=1e-15)


def test_a_ground_station_with_its_own_system_time_is_not_the_vehicle(real_log):
    log = open_log(real_log("ardusub_small.tlog"))
    assert log.messages["SYSTEM_TIME"] == 794  # 792 of the vehicle, 2 of the ground station
    assert entry_in(log, "TIME-HOST-CLOCK").kind == "fallback"
    assert log.channel("NAMED_VALUE_FLOAT[Lights1]").roles == ()
    assert sum(entry.count for entry in with_code(log.ledger, "LOG-DIALECT")) == 4


@pytest.mark.parametrize("version", [1, 2])
def test_known_flight(opened, version):
    log = opened(flight(version).data)
    vehicle = log.channel("SCALED_PRESSURE@1/1")
    assert vehicle["pressure_pa"].tolist() == [70_025.0] * 100
    other = log.channel("SCALED_PRESSURE@1/25")
    assert np.unique(other["pressure_pa"]).tolist() == [85_050.0]
    assert (vehicle.source.component, other.source.component) == (1, 25)
    assert_array_equal(
        vehicle.time_ns,
        BEGIN_NS + np.arange(100) * SECOND // 5,
    )
    gps = log.channel("GPS_RAW_INT")
    for channel in (gps, log.channel("ATTITUDE")):
        assert_array_equal(channel.time_ns, vehicle.time_ns)
    assert "sigma_v_m" not in gps.columns
    if version == 2:
        assert_array_equal(
            gps["h_ellipsoid_m"],
            [np.nan] * 50 + [580.5] * 50,
        )
        # no time of its own: the vehicle's time, by the messages it arrived with
        late_ns = log.channel("HYGROMETER_SENSOR[2]").time_ns - BEGIN_NS
        assert_allclose(late_ns, np.arange(20) * SECOND, atol=1e6)
        pitot = log.channel("AIRSPEED[0]")
        assert pitot.roles == ("airspeed",)
        assert "temperature_k" not in pitot.columns
    assert log.boots == 1
    assert log.bad_bytes == 0
    assert log.lost_messages == 0
    assert "SYSTEM_TIME" in log.time_base
    assert not log.ledger.has_losses


def test_camera_feedback_in_unix_time_and_in_time_since_boot(opened):
    writer = flight()
    for k in range(3):
        ms = 64_000 + k * 1000
        for camera, stamp_us in ((0, ms * 1000), (1, BOOT_UTC_US + ms * 1000)):
            feedback = {"cam_idx": camera, "img_idx": k, "time_usec": stamp_us}
            writer.sent("camera_feedback", ms, **feedback, **PLACE)
        writer.sent(
            "camera_trigger",
            ms,
            time_usec=ms * 1000,
            seq=k + 7,
        )
    log = opened(writer.data)
    expected_ns = BEGIN_NS + np.array([4, 5, 6]) * SECOND
    for name in ("CAMERA_FEEDBACK[0]", "CAMERA_FEEDBACK[1]", "CAMERA_TRIGGER"):
        assert_array_equal(log.channel(name).time_ns, expected_ns)
    assert log.channel("CAMERA_TRIGGER")["event_index"].tolist() == [7, 8, 9]


def test_a_trigger_without_a_time_is_placed_by_when_it_was_received(opened):
    writer = flight()
    for k in range(3):
        stamp_us = 0 if k == 1 else 90_000_000 + k * 1_000_000
        writer.sent(
            "camera_trigger",
            79_000 + k * 100,
            time_usec=stamp_us,
            seq=k,
        )
    triggers = opened(writer.data).channel("CAMERA_TRIGGER")
    assert triggers["event_index"].tolist() == [1, 0, 2]
    # the host's clock is 1.26 s slow, messages arrive 40 ms late; both are in its map to UTC
    sent_ns = (BOOT_UTC_US + 79_100_000) * 1000
    assert abs(triggers.time_ns[0] - sent_ns) < 1_000_000


def test_a_late_first_feedback_is_put_in_order(opened):
    writer = flight()
    for k in (0, 2, 1):
        stamp_us = (62 + k) * 10**6
        writer.sent(
            "camera_feedback",
            70_000 + k,
            img_idx=k,
            time_usec=stamp_us,
            **PLACE,
        )
    shots = opened(writer.data).channel("CAMERA_FEEDBACK[0]")
    assert shots["event_index"].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("byte", "bits"),
    [(0, 0x10), (1, 0x10), (8, 0x10), (9, 0x10), (10, 1), (20, 4)],
    ids=["stamp 0", "stamp 1", "mark", "length", "flags", "payload"],
)
def test_a_flipped_bit_costs_one_message(opened, byte, bits):
    writer = flight()
    attitudes = [k for k, frame in enumerate(writer.frames) if frame[15] == 30]
    victim = attitudes[12]
    writer.flip(victim, byte, bits)
    log = opened(writer.data)
    assert sum(log.messages.values()) == len(writer.frames) - 1
    assert log.messages["ATTITUDE"] == len(attitudes) - 1
    assert log.bad_bytes == len(writer.frames[victim])
    assert log.ledger.has_losses
    if byte == 20:
        assert entry_in(log, "LOG-CRC").kind == "loss"


def test_garbage_between_frames_is_counted(opened):
    writer = flight()
    writer.frames.insert(100, b"\xfd\xfe" * 150)
    log = opened(writer.data)
    assert sum(log.messages.values()) == len(writer.frames) - 1
    assert log.bad_bytes == 300
    assert entry_in(log, "LOG-BAD-BYTES").count == 300


def test_a_cut_last_message_costs_no_other(opened):
    writer = flight()
    log = opened(writer.data[:-3])
    assert sum(log.messages.values()) == len(writer.frames) - 1
    assert entry_in(log, "LOG-TRUNCATED").kind == "loss"
    assert log.bad_bytes == 0


def scanned(writer, data):
    """A scan of bytes that knows the messages of a writer."""
    extras = {}
    for number, kind in writer.library.mavlink_map.items():
        extras[number] = kind.crc_extra
    return Scan(view_of_bytes(data), extras, {})


@pytest.mark.parametrize("beyond", [1, 8, 16, 17])
def test_a_frame_that_is_cut_just_behind_a_stretch(beyond):
    """The header of its last frame begins before the end of a stretch and after it is the end."""
    writer = flight(seconds=2)
    head = START_US.to_bytes(8, "big") + b"\xfd\x09"
    begin = STRETCH + beyond - len(head)
    filling = bytes(begin - len(writer.data))

    cut = scanned(writer, writer.data + filling + head)

    assert cut.counts == scanned(writer, writer.data).counts


def test_messages_lost_by_the_link_are_counted_by_sequence(opened):
    writer = flight()
    frames = writer.autopilots_frames()
    for k in [*reversed(frames[40:47]), frames[10]]:
        del writer.frames[k]
    log = opened(writer.data)
    assert log.lost_messages == 8
    assert entry_in(log, "LOG-LINK-LOSS").kind == "finding"
    assert scanned(writer, writer.data).lost[(255, 190)] == 0


@pytest.mark.parametrize(
    ("missing", "counted"),
    [(200, 200), (512, 0), (700, 188), (40, 40)],
)
def test_a_hole_is_a_gap_and_its_messages_are_counted_at_least(opened, missing, counted):
    """Sequence numbers begin again after 256: two rounds more or less look alike."""
    writer = flight(seconds=90)
    frames = writer.autopilots_frames()
    place = sum(map(len, writer.frames[: frames[200]]))
    for k in reversed(frames[200 : 200 + missing]):
        del writer.frames[k]
    log = opened(writer.data)
    gaps = with_code(log.ledger, "LOG-GAP")
    if missing > 60:
        (gap,) = gaps
        assert gap.kind == "finding"
        assert gap.count == 1
        assert "system 1, component 1 " in gap.what
        assert place <= int(gap.where.rpartition(" ")[2]) <= place + 2000 * 60
    assert log.lost_messages == counted
    for entry in with_code(log.ledger, "LOG-LINK-LOSS"):
        assert f"at least {counted} " in entry.what
    assert log.ledger.has_losses


@pytest.mark.parametrize(
    ("frames_later", "later_us"),
    [(slice(300, None), DAY_US), (slice(300, 303), DAY_US), (slice(300, 303), -DAY_US)],
    ids=["a clock that was set", "stray stamps", "stray stamps back"],
)
def test_stamps_of_a_ground_station_are_no_hole(opened, frames_later, later_us):
    writer = flight(seconds=30)
    later = [restamped(frame, later_us) for frame in writer.frames[frames_later]]
    writer.frames[frames_later] = later
    assert with_code(opened(writer.data).ledger, "LOG-GAP") == []


@pytest.mark.parametrize("ahead_us", [-DAY_US, DAY_US, 3_500_000])
def test_stray_stamps_of_a_sender_without_a_clock(opened, ahead_us):
    writer = flight(seconds=2)
    for k in range(200):
        writer.sent(
            "hygrometer_sensor",
            62_000 + 100 * k,
            source=(1, 30),
            **AIR,
        )
    for row in (-100, -98):
        writer.frames[row] = restamped(writer.frames[row], ahead_us)
    assert with_code(opened(writer.data).ledger, "LOG-GAP") == []
    del writer.frames[-60:-20]
    gap = entry_in(opened(writer.data), "LOG-GAP")
    assert "component 30 " in gap.what
    assert " 4.1 s " in gap.what


def test_a_log_and_itself_has_no_losses_of_what_was_never_there(opened):
    """temperature_press_diff is 0, unknown, in all messages: no channel, and nothing to lose."""
    whole = flight(seconds=30).data
    assert not [entry for entry in opened(whole + whole).ledger if "press_diff" in entry.where]


def test_a_message_of_an_unknown_id_is_counted(opened):
    writer = flight()
    unknown = b"\xfd" + bytes([3, 0, 0, 0, 1, 99]) + (60_001).to_bytes(3, "little") + b"abcXY"
    writer.frames.insert(
        50,
        writer.frames[50][:8] + unknown,
    )
    log = opened(writer.data)
    assert log.messages["UNKNOWN_60001"] == 1
    assert entry_in(log, "LOG-UNKNOWN-ID").count == 1
    assert log.bad_bytes == 0


def test_a_count_of_milliseconds_that_runs_over_is_counted_on(opened):
    """32 bits hold 49.7 days; the host's clock tells the turn from a new boot."""
    begin_ms = 2**32 - 9_990
    writer = Vehicle()
    for k in range(100):
        overtaken_ms = 300 if k == 51 else 0  # as the count turns
        ms = begin_ms + 200 * k - overtaken_ms
        boot_ms = ms % 2**32
        at_ms = 60_000 + 200 * k
        if k % 10 == 0:
            unix_us = START_US + (ms - begin_ms) * 1000
            writer.sent("system_time", at_ms, time_unix_usec=unix_us, time_boot_ms=boot_ms)
        writer.sent("scaled_pressure", at_ms, time_boot_ms=boot_ms, press_abs=700.0 + k)
        place = {"lat": 470_000_000, "lon": -1_225_000_000 - k, "alt": 600_250}
        writer.sent(
            "gps_raw_int",
            at_ms,
            time_usec=boot_ms * 1000,
            fix_type=3,
            **place,
        )
        writer.sent(
            "camera_trigger",
            at_ms,
            time_usec=ms * 1000 % 2**32,
            seq=k,
        )
    log = opened(writer.data)
    assert log.boots == 1
    wrap = entry_in(log, "TIME-WRAP")
    assert wrap.kind == "note"
    assert wrap.count == 1
    sent_ns = np.arange(100) * SECOND // 5
    sent_ns[51] -= 300_000_000
    for name in ("SCALED_PRESSURE", "GPS_RAW_INT", "CAMERA_TRIGGER"):
        # what was overtaken is where it was sent
        late_ns = log.channel(name).time_ns - START_US * 1000
        assert_array_equal(late_ns, np.sort(sent_ns))


def test_a_new_boot_after_weeks_is_no_overrun(opened):
    writer = Vehicle()
    for k in range(60):
        up_ms = 30 * 86_400_000 if k < 30 else 0  # 30 days up, then 5 s
        writer.sent(
            "attitude",
            60_000 + 200 * k,
            time_boot_ms=up_ms + 5_000 + 200 * k,
        )
    log = opened(writer.data)
    assert log.boots == 2
    assert with_code(log.ledger, "TIME-WRAP") == []


@pytest.mark.parametrize(
    ("options", "column", "other_column"),
    [(16.0, "h_ellipsoid_m", "h_msl_m"), (2.0, "h_msl_m", "h_ellipsoid_m")],
)
def test_heights_above_the_ellipsoid_by_parameter(opened, options, column, other_column):
    writer = Vehicle()
    name = {"param_id": b"GPS_DRV_OPTIONS", "param_type": 9}
    writer.sent("param_value", 60_000, **name, param_value=options)
    writer.sent(
        "param_value",
        60_000,
        **name,
        param_value=18.0 - options,
        source=(255, 190),
    )
    place = {"lat": 470_000_000, "lon": -1_225_000_000, "alt": 600_250, "relative_alt": 30_000}
    for k in range(10):
        ms = 60_000 + 200 * k
        writer.sent("global_position_int", ms, time_boot_ms=ms, **place)
    log = opened(writer.data)
    channel = log.channel("GLOBAL_POSITION_INT")
    assert channel[column][0] == 600.25
    assert channel["h_home_m"][0] == 30.0
    assert other_column not in channel.columns
    assert len(with_code(log.ledger, "HEIGHT-ELLIPSOID")) == (options == 16.0)


def test_images_captured(opened):
    writer = flight()
    results = (1, 0, 1, 1, 1)
    for k in (0, 1, 2, 3, 3, 4):  # one is asked for again
        ms = 62_000 + 1000 * k
        writer.sent(
            "camera_image_captured",
            ms,
            time_boot_ms=ms,
            lat=470_000_000 + k,
            lon=-1_225_000_000,
            image_index=k,
            capture_result=results[k],
            file_url=f"DCIM/{k}.jpg".encode(),
        )
    log = opened(writer.data)
    images = log.channel("CAMERA_IMAGE_CAPTURED[0]")
    assert images.roles == ("events",)
    assert images["event_index"].tolist() == [0, 2, 3, 4]
    assert images.labels["file_url"] == tuple(f"DCIM/{k}.jpg" for k in (0, 2, 3, 4))
    assert images.time_ns[0] == BEGIN_NS + 2 * SECOND
    failed = entry_in(log, "EVENT-FAILED")
    assert failed.kind == "warning"
    assert failed.count == 1
    assert entry_in(log, "EVENT-REPEAT").count == 1


def test_the_table_of_an_instance_has_its_rows_only(opened):
    log = opened(flight().data)
    times_ns = log.channel("ATTITUDE").time_ns
    assert_array_equal(log.message("ATTITUDE")["time_ns"], times_ns)
    assert log.message("NAMED_VALUE_FLOAT", "CabT")["name"].tolist() == ["CabT"] * 20
    with pytest.raises(LogError, match="LOG-NO-TABLE"):
        log.message("NAMED_VALUE_FLOAT", "CabX")


@pytest.mark.parametrize(
    ("damaged", "code", "kind"), [(1, "LOG-CRC", "loss"), (5, "LOG-DIALECT", "warning")]
)
def test_failed_checksums_are_damage_unless_all_of_an_unneeded_message_fail(
    opened, damaged, code, kind
):
    """All fail where another version of the dialect defines the message."""
    writer = flight()
    first = len(writer.frames)
    for k in range(5):
        writer.sent("heartbeat", 80_000 + 1000 * k, type=1)
    for frame in range(first, first + damaged):
        writer.flip(frame, 20, 4)
    log = opened(writer.data)
    failed = [*with_code(log.ledger, "LOG-DIALECT"), *with_code(log.ledger, "LOG-CRC")]
    assert [(entry.code, entry.kind, entry.count) for entry in failed] == [(code, kind, damaged)]
    assert log.messages.get("HEARTBEAT", 0) == 5 - damaged
