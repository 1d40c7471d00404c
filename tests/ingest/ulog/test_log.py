"""PX4 logs: files with known content, written by hand as the ULog specification says."""

import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import refused, with_code
from tests.ingest.written_logs import ULogWriter, entry_in, loss_codes
from unbend.atmosphere.estimate.sensors import airspeed_heating, dynamic_pressure

NOW_US = 1_700_000_000_000_000
SHOT = "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;"
QUATERNION = "float[4] q;"
LEVEL = (1.0, 0.0, 0.0, 0.0)
NEW_GPS = (
    "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;double altitude_msl_m;"
    "double altitude_ellipsoid_m;uint8_t fix_type;"
)
PLACE = (47.5, 8.25, 600.0, 647.5)


def flight():
    """As PX4 until 1.13 logs it, with two barometers and one image."""
    writer = ULogWriter()
    writer.define(
        "vehicle_gps_position",
        "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
        "float eph;float epv;uint8_t fix_type;",
    )
    writer.define("vehicle_attitude", QUATERNION)
    writer.define("sensor_baro", "float pressure;float temperature;")
    writer.define("sensor_hygrometer", "float temperature;float humidity;")
    writer.define("camera_capture", SHOT)
    writer.subscribe("vehicle_gps_position", "vehicle_attitude")
    writer.subscribe("sensor_hygrometer", "camera_capture", "sensor_baro")
    writer.subscribe("sensor_baro", instance=1)
    for k in range(30):
        t = 5_000_000 + 100_000 * k
        place = (475_000_000, 82_500_000, 600_000, 647_500)
        writer.row(
            "vehicle_gps_position",
            "QiiiiffB",
            t,
            NOW_US + t,
            *place,
            0.5,
            0.75,
            3,
        )
        writer.row("vehicle_attitude", "4f", t, *LEVEL)
        for instance in (0, 1):
            writer.row(
                "sensor_baro",
                "ff",
                t,
                94_000.0 + instance,
                40.0,
                instance=instance,
            )
        writer.row("sensor_hygrometer", "ff", t, 12.5, 55.0)
    writer.row("camera_capture", "QIdd", 6_000_000, 0, 7, 47.5, 8.25)
    return writer.data


def channel_names(log):
    return [channel.name for channel in log.channels]


def test_known_flight(opened):
    log = opened(flight())
    assert channel_names(log) == [
        "camera_capture",
        "sensor_baro[0]",
        "sensor_baro[1]",
        "sensor_hygrometer",
        "vehicle_attitude",
        "vehicle_gps_position",
    ]
    assert log.channel("vehicle_gps_position").time_ns[0] == (NOW_US + 5_000_000) * 1000
    assert log.channel("sensor_baro[1]")["pressure_pa"][0] == 94_001.0
    assert log.channel("camera_capture")["event_index"].tolist() == [7.0]
    assert log.message_types()["sensor_baro"] == 60
    assert log.message("sensor_baro", "1")["pressure"].tolist() == [94_001.0] * 30
    assert not log.ledger.has_losses


def writer_of_114() -> ULogWriter:
    """A log of PX4 1.14 with a receiver, an attitude and air defined."""
    writer = ULogWriter()
    writer.define("sensor_gps", NEW_GPS)
    writer.define("vehicle_attitude", QUATERNION)
    writer.define("vehicle_air_data", "float baro_pressure_pa;float ambient_temperature;")
    return writer


def newer(
    *,
    utc=lambda k: NOW_US + 200_000 * k,
    fix=lambda _: 3,
    stray=lambda _: 0,
    capture=lambda _: 0,
):
    """As PX4 1.14 and later log it, for 12 s; by row: UTC and fix of the receiver, its error."""
    writer = writer_of_114()
    writer.define("camera_capture", f"{SHOT}int8_t result;")
    writer.define("acme", "uint8_t a;")
    writer.subscribe("sensor_gps", "vehicle_attitude", "vehicle_air_data", "camera_capture", "acme")
    for k in range(60):
        t = 60_000_000 + 200_000 * k
        writer.row(
            "sensor_gps",
            "QddddB",
            t + stray(k),
            utc(k),
            *PLACE,
            fix(k),
        )
        writer.row("vehicle_attitude", "4f", t, *LEVEL)
        writer.row("vehicle_air_data", "2f", t, 94_000.0, 40.0)
        writer.row("acme", "B", t, 1)
        if k % 10 == 0:
            result = 0 if k == 20 else 1
            writer.row(
                "camera_capture",
                "QIddb",
                t,
                capture(k),
                k // 10,
                47.5,
                8.25,
                result,
            )
    return writer


def seconds(log, name="vehicle_attitude"):
    return ((log.channel(name).time_ns // 1000 - NOW_US) / 1e6).tolist()


WHOLE = [k / 5 for k in range(60)]


def test_messages_mean_what_they_mean_over_ros(opened):
    log = opened(newer().data)
    assert log.channel("camera_capture")["event_index"].tolist() == [0, 1, 3, 4, 5]
    failed = entry_in(log, "EVENT-FAILED")
    assert failed.kind == "warning"
    assert failed.count == 1
    assert log.channel("vehicle_air_data").roles == ("pressure", "cabin_pressure")
    assert log.message_types()["acme"] == 60  # not of ours: counted, and a table
    assert log.message("acme")["a"].tolist() == [1] * 60
    assert not log.ledger.has_losses


def test_two_gimbals_in_one_topic_of_px4_are_two_channels(opened):
    yaw_in_earth_frame = 64
    attitudes = ((0.5, 0.5, -0.5, 0.5), LEVEL)
    writer = ULogWriter()
    fields = "uint16_t device_flags;float[4] q;uint8_t gimbal_device_id;"
    writer.define("gimbal_device_attitude_status", fields)
    writer.subscribe("gimbal_device_attitude_status")
    for k in range(20):
        t = 60_000_000 + 200_000 * k
        for number, q in enumerate(attitudes):
            row = (yaw_in_earth_frame, *q, number)
            writer.row("gimbal_device_attitude_status", "H4fB", t, *row)
    log = opened(writer.data)
    for number, q in enumerate(attitudes):
        name = f"gimbal_device_attitude_status[{number}]"
        assert log.channel(name)["gimbal_q_y"].tolist() == [q[2]] * 20
        assert log.message(name)["gimbal_device_id"].tolist() == [number] * 20


def test_utc_of_a_receiver_counts_with_a_fix_and_once_a_time(opened):
    """The first rows are an hour off, without a fix; then two of three repeat the time before."""

    def utc(k):
        early_us = 3_600_000_000 if k < 24 else 0
        return NOW_US + 200_000 * (k - k % 3) - early_us

    log = opened(newer(fix=lambda k: 0 if k < 24 else 3, utc=utc).data)
    assert seconds(log) == WHOLE
    assert not log.ledger.has_losses


@pytest.mark.parametrize("row", [0, 1, 30, 59])
def test_a_stray_stamp_costs_its_row(opened, row):
    log = opened(newer(stray=lambda k: 1 << 30 if k == row else 0).data)
    assert seconds(log) == WHOLE
    if row != 59:  # behind the last row may be a gap: only the rows before it say so
        assert seconds(log, "sensor_gps") == WHOLE[:row] + WHOLE[row + 1 :]
        stray = entry_in(log, "TIME-STRAY")
        assert stray.kind == "loss"
        assert stray.count == 1
        assert not with_code(log.ledger, "TIME-BACKWARD")
        assert log.time_base.endswith("the median of 59 rows")


def test_a_camera_tells_utc_where_no_receiver_does(opened):
    """Where one does, the autopilot's own clock (0.4 s ahead here) would move the exposures."""
    log = opened(newer(fix=lambda _: 0, capture=lambda k: NOW_US + 200_000 * k).data)
    assert seconds(log) == WHOLE
    log = opened(newer(capture=lambda k: NOW_US + 200_000 * k + 400_000).data)
    assert seconds(log, "camera_capture") == [0, 2, 6, 8, 10]
    log = opened(newer(fix=lambda _: 0).data)
    assert entry_in(log, "TIME-NO-UTC").kind == "fallback"


def test_messages_that_pyulog_does_not_know_and_padding(opened):
    writer = ULogWriter()
    writer.define("vehicle_attitude", "float[4] q;uint8_t[4] _padding0;")
    writer.define("nested", "vehicle_attitude[2] both;")
    writer.message("S", bytes(8))
    writer.message("O", struct.pack("<H", 250))
    writer.subscribe("vehicle_attitude", "nested")
    for k in range(20):
        writer.row("vehicle_attitude", "4f", 10**6 * k, *LEVEL)
        writer.message("R", b"\7\0")
        writer.message("S", bytes(8))
        if k < 3:
            writer.message("O", struct.pack("<H", 250))
        writer.message("L", b"6" + bytes(8) + b"hello")
    log = opened(writer.data)
    assert len(log.channel("vehicle_attitude")) == 20
    assert log.message_types() == {"vehicle_attitude": 20}
    silent = entry_in(log, "LOG-DROPOUT")
    assert silent.kind == "finding"
    assert silent.count == 3
    assert "0.750 s" in silent.what
    assert log.bad_bytes == 0
    assert log.lost_messages == 0


def test_damage_is_located_and_what_follows_is_read(opened):
    data = newer().data
    middle = data.index(b"D", len(data) // 2) - 2
    log = opened(data[:middle] + b"\xff" * 500 + data[middle:])
    assert sum(log.messages.values()) >= sum(opened(data).messages.values()) - 1
    damage = entry_in(log, "LOG-BAD-BYTES")
    assert damage.kind == "loss"
    assert damage.where == f"flight.ulg, first at byte {middle}"
    assert damage.count == log.bad_bytes
    assert log.lost_messages == 1  # at least


def test_a_definition_among_the_data_is_none(opened):
    writer = newer()
    before = len(writer.data)
    writer.define("vehicle_attitude", "double[4] q;")
    more = len(writer.data) - before
    writer.row("acme", "B", 80_000_000, 1)
    log = opened(writer.data)
    assert log.bad_bytes == more
    assert log.messages["acme"] == 61
    assert seconds(log) == WHOLE


def test_zeros_among_the_definitions_end(opened):
    """pyulog steps back by more than it can read there, and begins anew without end."""
    data = newer().data
    with refused("LOG-FORMAT"):
        opened(data[:80] + bytes(4096) + data[4176:5000])


def test_a_topic_without_a_time_is_a_loss(opened):
    definition = b"vehicle_air_data:uint64_t timestamp"
    log = opened(newer().data.replace(definition, definition.replace(b"stamp", b"szamp")))
    entry = entry_in(log, "LOG-FIELDS")
    assert (entry.kind, entry.where, entry.count) == ("loss", "vehicle_air_data", 60)
    assert seconds(log) == WHOLE  # pyulog alone would give one row
    assert log.bad_bytes == 0
    with refused("LOG-NO-TABLE"):
        log.message("vehicle_air_data")


def test_data_appended_after_a_crash_is_read_once(opened):
    """The message before it is cut off; the file says where it begins."""
    writer = newer()
    place = len(writer.data) + 5
    number = writer.ids["vehicle_attitude", 0]
    writer.data += struct.pack("<HBH", 26, ord("D"), number)  # the first bytes of another row
    for k in range(60, 80):
        writer.row("vehicle_attitude", "4f", 60_000_000 + 200_000 * k, *LEVEL)
    data = bytearray(writer.data)
    data[19 + 8] = 1
    data[19 + 16 : 19 + 24] = struct.pack("<Q", place)
    log = opened(bytes(data))
    assert seconds(log) == [k / 5 for k in range(80)]
    assert log.bad_bytes == 5


def test_a_header_that_is_cut_is_refused(opened):
    with refused("LOG-ULOG", says="after 8 of 16 bytes"):
        opened(b"ULog\x01\x12\x35\x01")


@pytest.mark.parametrize(
    ("byte", "bit"),
    [(27, 1), (28, 0), (34, 7)],
)
def test_flags_that_are_not_known_are_refused(opened, byte, bit):
    """Bit 0 of the incompatible flags means appended data; what others mean may be anything."""
    data = bytearray(flight())
    data[byte] |= 1 << bit
    with refused("LOG-ULOG", says="incompatible flags"):
        opened(bytes(data))


def test_compatible_flags_that_are_not_known_are_left(opened):
    data = bytearray(flight())
    data[26] = 1  # the last of them
    assert not opened(bytes(data)).ledger.has_losses


def test_a_value_shorter_than_its_type_is_damage(opened):
    """What follows is read: pyulog alone stops there, and says nothing."""
    writer = newer()
    writer.message("P", b"\x0bint32_t ABC" + bytes(4))
    writer.message("Q", b"\x01\x09float XYZ" + bytes(4))
    writer.message("I", b"\x0achar[5] sys" + bytes(5))
    writer.message("M", b"\0\x0cuint8_t[9] x" + bytes(5))  # of an array a part
    assert not opened(writer.data).ledger.has_losses
    writer.message("P", b"\x0bint32_t ABC" + bytes(3))
    writer.row("acme", "B", 80_000_000, 1)
    log = opened(writer.data)
    assert log.messages["acme"] == 61
    damage = entry_in(log, "LOG-ULOG-DAMAGE")
    assert damage.kind == "loss"
    assert damage.count == log.lost_messages == 1
    assert log.bad_bytes == 0


def test_a_pitot_tube_gives_dynamic_pressure_and_heating(opened):
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
    channel = opened(writer.data).channel("airspeed")
    assert "airspeed" in channel.roles
    assert dynamic_pressure(channel["airspeed_m_s"])[0] == pytest.approx(dynamic, rel=1e-6)
    heating = airspeed_heating(channel["airspeed_m_s"], pressure, channel["temperature_k"])
    assert_allclose(heating, true**2 / (2.0 * 1004.7), rtol=1e-3)


WHOLE_FILE = flight()


@pytest.mark.parametrize(
    ("head", "count"),
    [
        *((b"", count) for count in (1, 7, 16, 40)),
        *((bytes(count), count) for count in (1, 7, 16, 40)),
        (b"UM", 2),
    ],
)
def test_a_file_whose_head_is_lost_or_damaged(opened, head, count):
    """The definitions are whole: all messages are there, and the loss is told."""
    expected = opened(WHOLE_FILE)
    log = opened(head + WHOLE_FILE[count:])
    assert log.messages == expected.messages
    assert channel_names(log) == channel_names(expected)
    for ours, theirs in zip(log.channels, expected.channels, strict=True):
        assert_array_equal(ours.time_ns, theirs.time_ns)
    assert loss_codes(log) == {"LOG-BAD-BYTES"}
    if len(head) == count <= 16:
        damage = entry_in(log, "LOG-BAD-BYTES")
        assert damage.where == "flight.ulg, first at byte 0"
        assert damage.count == 16  # the header


def regular():
    """Definitions, and 60 s of messages: attitude at 100 Hz, air at 50 Hz, receiver at 5 Hz."""
    writer = writer_of_114()
    writer.subscribe("sensor_gps", "vehicle_attitude", "vehicle_air_data")
    head = writer.data
    rows = []

    def row(name, layout, *values):
        writer.data = b""
        writer.row(name, layout, *values)
        rows.append(writer.data)

    row("vehicle_air_data", "ff", 3_000_000, 94_000.0, 40.0)  # of before the logger began
    for k in range(6000):
        t = 60_000_000 + 10_000 * k
        row("vehicle_attitude", "4f", t, *LEVEL)
        if k % 2 == 0:
            row("vehicle_air_data", "ff", t - 1500, 94_000.0, 40.0)
        if k % 20 == 0:
            row(
                "sensor_gps",
                "QddddB",
                t - 90_000,
                NOW_US + t,
                *PLACE,
                3,
            )
    return head, rows


def test_triggers_and_feedbacks_of_one_topic_are_two_channels(opened):
    writer = ULogWriter()
    writer.define("camera_trigger", "uint64_t timestamp_utc;uint32_t seq;bool feedback;")
    writer.define("vehicle_land_detected", "bool landed;")
    writer.subscribe("camera_trigger", "vehicle_land_detected")
    for number in range(1, 9):
        sent_us = 5_000_000 * number
        writer.row("vehicle_land_detected", "?", sent_us, False)
        writer.row("camera_trigger", "QI?", sent_us, 0, number, False)
        writer.row("camera_trigger", "QI?", sent_us + 120_000, 0, number, True)
    log = opened(writer.data)
    pulses = log.channel("camera_trigger")
    commands = log.channel("camera_trigger.sent")
    assert pulses["event_index"].tolist() == commands["event_index"].tolist() == [*range(1, 9)]
    assert (pulses.time_ns - commands.time_ns).tolist() == [120_000_000] * 8
    assert pulses.rank < commands.rank
    both = entry_in(log, "EVENTS-BOTH")
    assert both.kind == "note"
    assert both.count == 16


@pytest.mark.parametrize(
    ("begin", "count"),
    [(2000, 3948), (5000, 60)],
)
def test_messages_that_were_cut_out_between_records_are_told(opened, begin, count):
    head, rows = regular()
    log = opened(head + b"".join(rows[:begin] + rows[begin + count :]))
    gap = entry_in(log, "LOG-GAP")
    assert gap.kind == "finding"
    assert gap.count == 1
    missing = int(gap.what.split("about ")[1].split()[0])
    assert missing == pytest.approx(count, rel=0.05)
    first_s = float(gap.where.split("first ")[1].split()[0])
    assert first_s == pytest.approx(60.0 + begin / 155.0, abs=0.1)
    assert not [entry for entry in log.ledger if entry.kind == "loss"]


def test_a_log_that_is_mostly_silent_was_not_logged_all_the_time(opened):
    """1,300 messages in 8.4 s of 50 s: no message of an intact log is said to be missing."""
    head, rows = regular()
    log = opened(head + b"".join(rows[:650] + rows[-650:]))
    assert not log.ledger.has_losses
    paused = entry_in(log, "LOG-PAUSED")
    assert paused.kind == "warning"
    assert paused.count == 1


def test_events_in_bursts_are_no_steady_topic(opened):
    """Eight triggers, each with its feedback 0.12 s later, in a log of one attitude a second."""
    writer = ULogWriter()
    writer.define("camera_trigger", "uint64_t timestamp_utc;uint32_t seq;bool feedback;")
    writer.define("vehicle_attitude", QUATERNION)
    writer.subscribe("camera_trigger", "vehicle_attitude")
    for number in range(1, 61):
        second_us = 5_000_000 + 1_000_000 * number
        writer.row("vehicle_attitude", "4f", second_us, *LEVEL)
        if number % 3 == 0:
            writer.row("camera_trigger", "QI?", second_us + 10_000, 0, number, False)
            writer.row("camera_trigger", "QI?", second_us + 130_000, 0, number, True)
    assert not {entry.code for entry in opened(writer.data).ledger} & {"LOG-GAP", "LOG-PAUSED"}


def test_a_topic_that_is_not_read_shows_that_the_log_goes_on(opened):
    writer = ULogWriter()
    writer.define("actuator_outputs", QUATERNION)
    writer.define("vehicle_attitude", QUATERNION)
    writer.subscribe("actuator_outputs", "vehicle_attitude")
    for k in range(200):
        t = 60_000_000 + 50_000 * k
        writer.row("actuator_outputs", "4f", t, *LEVEL)
        if not 60 <= k < 120:
            writer.row("vehicle_attitude", "4f", t, *LEVEL)
    assert not {entry.code for entry in opened(writer.data).ledger} & {"LOG-GAP", "LOG-PAUSED"}


def test_a_stray_time_is_no_cut(opened):
    head, rows = regular()
    attitude = next(k for k in range(1500, 2000) if len(rows[k]) == 29)
    stray = struct.pack("<Q", 900_000_000)
    rows[attitude] = rows[attitude][:5] + stray + rows[attitude][13:]
    log = opened(head + b"".join(rows))
    assert loss_codes(log) == {"TIME-STRAY"}


def test_texts_and_parameters(opened):
    writer = ULogWriter()
    head = writer.data
    for key, value in (
        (b"float EKF2_BARO_DELAY", struct.pack("<f", 110.0)),
        (b"int32_t GPS_1_CONFIG", struct.pack("<i", 201)),
        (b"float EKF2_BARO_DELAY", struct.pack("<f", 127.5)),
    ):
        writer.message(
            "P",
            bytes([len(key)]) + key + value,
        )
    writer.data += flight()[len(head) :]
    at_6_s = b"\x34" + struct.pack("<Q", 6_000_000)
    writer.message("L", at_6_s + b"GPS fix lost")
    writer.message(
        "C",
        b"\x34" + struct.pack("<HQ", 7, 6_500_000) + b"Estimator reset",
    )
    writer.message("L", at_6_s + b"Position lost")
    log = opened(writer.data)
    assert log.parameters == {"EKF2_BARO_DELAY": 127.5, "GPS_1_CONFIG": 201.0}
    channel = log.channel("MSG")
    assert channel.labels["text"] == ("GPS fix lost\nPosition lost", "Estimator reset")
    assert (channel.time_ns // 1000 - NOW_US).tolist() == [6_000_000, 6_500_000]
    assert not log.ledger.has_losses


ROLLOVER_US = 1024 * 604_800 * 10**6
UTC_2042_US = 2_272_147_200_000_000


@pytest.mark.parametrize("rollovers", [1, 2])
def test_a_receiver_that_has_rolled_over(opened, rollovers):
    early_us = NOW_US - rollovers * ROLLOVER_US
    log = opened(newer(utc=lambda k: early_us + 200_000 * k).data)
    assert seconds(log) == WHOLE
    assert entry_in(log, "TIME-WEEK-ROLLOVER").kind == "warning"


def test_a_date_that_no_log_can_have_is_none(opened):
    """2042 less a rollover is 2022: a clock that was never set is no rollover."""
    log = opened(newer(utc=lambda k: UTC_2042_US + 200_000 * k).data)
    assert not log.has_utc
    assert {"TIME-IMPOSSIBLE", "TIME-NO-UTC"} <= {entry.code for entry in log.ledger}


@pytest.mark.parametrize(
    ("fix", "late_s"),
    [(0, 1.5), (3, 0.0)],
)
def test_the_utc_of_the_boot_counts_where_no_receiver_has_a_fix(opened, fix, late_s):
    writer = newer(fix=lambda _: fix)
    key = b"uint64_t boot_time_utc_us"
    value = struct.pack("<Q", NOW_US - 60_000_000 + 1_500_000)
    writer.message(
        "I",
        bytes([len(key)]) + key + value,
    )
    log = opened(writer.data)
    assert seconds(log) == pytest.approx([t + late_s for t in WHOLE])
    assert (log.utc_sigma_s == 5.0) is (fix == 0)
