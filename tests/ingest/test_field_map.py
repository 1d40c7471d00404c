"""The messages that logs are known to carry: each is a channel with these values, or a table.

The values are in known_messages.yaml.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal

from tests.ingest.written_logs import (
    NS_PER_S,
    DataFlashWriter,
    MavlinkWriter,
    McapWriter,
    RosWriter,
    opened,
    ros_time,
)
from unbend.ingest.field_maps import extract, message_maps

START_NS = 1_700_000_000 * NS_PER_S
START_US = START_NS // 1000
KNOWN = yaml.safe_load(Path(__file__).with_name("known_messages.yaml").read_text("utf-8"))
ANGLES = ("q_", "gimbal_", "camera_q_", "roll_", "pitch_", "yaw_")
"""How names of columns begin that are angles, or a part of a turn."""


def name_of(known):
    return known["message"]


def check_channel(log, message, expected: dict[str, float]):
    """The channel of a message has these values; without any there is none.

    One of a gimbal plays no role by itself.
    """
    channels = [channel for channel in log.channels if channel.source.message == message]
    if any(part in message for part in ("GIMBAL", "Gimbal", "MOUNT", "MNT")):
        assert [channel.roles for channel in channels] == [()]
    if not expected:
        assert not channels
    for name, value in expected.items():
        columns = [channel[name] for channel in channels if name in channel.columns]
        assert columns, f"no channel of {message} has {name}"
        approximately = pytest.approx(value, rel=4e-15, abs=0.0)
        if name.startswith(ANGLES):  # sent as float32
            approximately = pytest.approx(value, rel=1e-6, abs=1e-7)
        assert columns[0][-1] == approximately, name


@pytest.mark.parametrize("name", KNOWN["mavlink"])
def test_mavlink(tmp_path, name):
    fields = KNOWN["mavlink"][name]["fields"]
    writer = MavlinkWriter()
    kind = getattr(writer.library, f"MAVLink_{name.lower()}_message")
    for k in range(10):
        received_us = START_US + k * 10**6
        boot_ms = 60_000 + 1000 * k
        writer.send("system_time", received_us, time_unix_usec=received_us, time_boot_ms=boot_ms)
        if name != "ATTITUDE":
            writer.send("attitude", received_us, time_boot_ms=boot_ms)
        times = {"time_boot_ms": boot_ms, "time_usec": boot_ms * 1000}
        for field in times.keys() - set(kind.fieldnames):
            del times[field]
        writer.send(name.lower(), received_us, **times | fields)
    log = opened(tmp_path / "one.tlog", writer.data)
    check_channel(log, name, KNOWN["mavlink"][name]["columns"])
    table = log.message(name)
    assert table["time_ns"].shape[0] == log.messages[name] >= 10
    for field, value in fields.items():
        if isinstance(value, int | float):
            assert table[field][-1] == pytest.approx(value, rel=1e-6)
    assert not log.ledger.has_losses


@pytest.mark.parametrize("known", KNOWN["dataflash"], ids=name_of)
def test_dataflash(tmp_path, known):
    name = known["message"]
    letters, fields = known["form"].split()
    writer = DataFlashWriter()
    writer.define_receiver()
    writer.define(30, name, f"Q{letters}", f"TimeUS,{fields}")
    for k in range(10):
        time_us = 5_000_000 + 200_000 * k
        writer.fix(time_us, 1000 + 200 * k, week=2200)
        writer.row(name, time_us + 1, *known["values"])
    log = opened(tmp_path / "one.bin", writer.data)
    check_channel(log, name, known["columns"])
    table = log.message(name)
    for field, value in zip(fields.split(","), known["values"], strict=True):
        if isinstance(value, bytes):
            assert table[field][-1] == value.decode(), field
        else:
            assert table[field][-1] == pytest.approx(value), field
    assert not log.ledger.has_losses


@pytest.mark.parametrize("known", KNOWN["ros"], ids=name_of)
def test_ros_2(tmp_path, known):
    name = known["message"]
    writer = RosWriter()
    writer.define(name, known["definition"])
    times_ns = START_NS + np.arange(10) * NS_PER_S
    for time_ns in times_ns.tolist():
        stamps = {"frame_stamp": ros_time(time_ns), "timestamp": time_ns // 1000}
        writer.write("/one", name, time_ns, **stamps, **known["fields"])
        writer.write("/air", "sensor_msgs/Temperature", time_ns, temperature=-12.5)
    log = opened(tmp_path / "one.mcap", writer.data)
    check_channel(log, name, known["columns"])
    assert_array_equal(log.message("/one")["time_ns"], times_ns)
    assert not log.ledger.has_losses


@pytest.mark.parametrize("name", KNOWN["foxglove"])
def test_foxglove_as_json(tmp_path, name):
    known = KNOWN["foxglove"][name]
    writer = McapWriter()
    channel = writer.channel("/one", "json", f"foxglove.{name}", "{}")
    for k in range(10):
        time_ns = START_NS + k * NS_PER_S
        stamp = {"sec": time_ns // NS_PER_S, "nsec": 0}
        row = {"timestamp": stamp, "frame_id": "a"} | known["fields"]
        writer.write(channel, time_ns, row)
    log = opened(tmp_path / "one.mcap", writer.data)
    check_channel(log, f"foxglove.{name}", known["columns"])
    assert len(log.message("/one")["time_ns"]) == 10


# Format, message, field, its value that means unknown, column.
UNKNOWN = """
tlog      GPS_RAW_INT                            alt_ellipsoid          0     h_ellipsoid_m
tlog      GPS_RAW_INT                            h_acc                  0     sigma_h_m
tlog      GPS_RAW_INT                            v_acc                  0     sigma_v_m
tlog      GPS_RAW_INT                            vel_acc                0     sigma_speed_m_s
tlog      GPS_RAW_INT                            satellites_visible     255   satellites
tlog      GPS_RAW_INT                            eph                    65535 hdop
tlog      GPS_RAW_INT                            vel                    65535 speed_m_s
tlog      GPS_RAW_INT                            cog                    65535 course_rad
tlog      AHRS2                                  lat                    0     lat_rad
tlog      SCALED_PRESSURE.temperature_press_diff temperature_press_diff 0     temperature_k
tlog      HIGHRES_IMU                            abs_pressure           0.0   pressure_pa
tlog      HYGROMETER_SENSOR                      temperature            32767 temperature_k
tlog      HYGROMETER_SENSOR                      humidity               65535 relative_humidity
tlog      AIRSPEED                               temperature            32767 temperature_k
tlog      RAW_IMU                                temperature            0     board_temperature_k
tlog      MOUNT_ORIENTATION                      yaw_absolute           0.0   yaw_rad
tlog      ESTIMATOR_STATUS                       pos_horiz_accuracy     0.0   sigma_h_m
dataflash GPS                                    HDop                   99.99 hdop
dataflash GPS                                    GWk                    0     gps_week
dataflash AHR2                                   Lng                    0.0   lon_rad
px4       SensorGps                              altitude_ellipsoid_m   0.0   h_ellipsoid_m
px4       VehicleGpsPosition                     alt_ellipsoid          0     h_ellipsoid_m
px4       VehicleGlobalPosition                  alt_ellipsoid          0.0   h_ellipsoid_m
px4       HomePosition                           alt                    0.0   home_h_msl_m
ros       mavros_msgs/GPSRAW                     alt_ellipsoid          0     h_ellipsoid_m
ros       mavros_msgs/ExtendedState              landed_state           0     landed_state
"""


@pytest.mark.parametrize("row", UNKNOWN.strip().splitlines(), ids=str.strip)
def test_a_value_that_means_unknown(row):
    format_name, message, field, unknown, column = row.split()
    columns = message_maps(format_name)[message].columns
    extracted = extract({field: np.array([yaml.safe_load(unknown), 1])}, columns)
    assert np.isnan(extracted[column]).tolist() == [True, False]


@pytest.mark.parametrize(
    ("format_name", "message"),
    [
        ("dataflash", "HYGR"),
        ("dataflash", "TEMP"),
        ("dataflash", "ARSP"),
        ("tlog", "HYGROMETER_SENSOR"),
        ("tlog", "AIRSPEED"),
        ("tlog", "SCALED_PRESSURE"),
        ("ros", "sensor_msgs/Temperature"),
        ("ros", "sensor_msgs/RelativeHumidity"),
        ("ros", "sensor_msgs/FluidPressure"),
    ],
)
def test_the_first_of_several_is_not_preferred(format_name, message):
    """The numbers of instances do not show which sensor is outside."""
    assert message_maps(format_name)[message].spare_rank is None


def test_exposures_are_preferred_to_commands():
    px4 = message_maps("px4")
    assert px4["CameraCapture"].rank < px4["CameraTrigger"].rank
