"""PX4 over ROS 2: a clock that begins at each boot, receivers, cameras. Truth is how it is sent."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import with_code
from tests.ingest.written_logs import RosWriter, entry_in, loss_codes

SECOND = 10**9
START = 1_700_000_000 * SECOND
STEP = SECOND // 5

KINDS = {
    "SensorGps": "uint64 timestamp\nuint64 time_utc_usec\nfloat64 latitude_deg\n"
    "float64 longitude_deg\nfloat64 altitude_msl_m\nfloat64 altitude_ellipsoid_m\nuint8 fix_type",
    "VehicleAttitude": "uint64 timestamp\nfloat32[4] q",
    "SensorHygrometer": "uint64 timestamp\nfloat32 temperature\nfloat32 humidity",
    "GimbalDeviceAttitudeStatus": "uint64 timestamp\nfloat32[4] q\nuint8 gimbal_device_id",
    "CameraCapture": "uint64 timestamp\nuint64 timestamp_utc\nuint32 seq\nint8 result",
}
PLACE = {"latitude_deg": 47.5, "longitude_deg": 8.25, "altitude_msl_m": 600.0}


class Recording(RosWriter):
    """Topics of PX4, recorded 3 ms late or, by a recorder without a clock, at 0."""

    def __init__(self, *, has_clock=True):
        super().__init__()
        self.has_clock = has_clock
        for kind, definition in KINDS.items():
            self.define(f"px4_msgs/{kind}", definition)

    def send(self, kind, boot_ns, utc_ns, **fields):
        recorded_ns = utc_ns + 3_000_000 if self.has_clock else 0
        topic = f"/fmu/out/{kind}"
        timestamp = boot_ns // 1000
        self.write(topic, f"px4_msgs/{kind}", utc_ns, recorded_ns, timestamp=timestamp, **fields)

    def fix(self, boot_ns, utc_ns, *, stated_utc_ns=None, fix_type=3):
        """A fix, which may state another UTC than that at which it is sent."""
        if stated_utc_ns is None:
            stated_utc_ns = utc_ns
        self.send(
            "SensorGps",
            boot_ns,
            utc_ns,
            time_utc_usec=stated_utc_ns // 1000,
            fix_type=fix_type,
            **PLACE,
        )

    def attitude(self, boot_ns, utc_ns):
        self.send(
            "VehicleAttitude",
            boot_ns,
            utc_ns,
            q=[1.0, 0.0, 0.0, 0.0],
        )

    def shot(self, boot_ns, utc_ns, number, **fields):
        self.send(
            "CameraCapture",
            boot_ns,
            utc_ns,
            **{"seq": number, "result": 1} | fields,
        )

    def flight(self, *, rows=200, boot_s=60, utc_s=0, fix_type=3):
        """A receiver and an attitude at 5 Hz, from a time since boot and a time of the test on."""
        for k in range(rows):
            boot_ns = boot_s * SECOND + k * STEP
            utc_ns = START + utc_s * SECOND + k * STEP
            self.fix(boot_ns, utc_ns, fix_type=fix_type)
            self.attitude(boot_ns, utc_ns)


def seconds(log, kind="VehicleAttitude"):
    return (log.channel(f"/fmu/out/{kind}").time_ns - START) / SECOND


def test_topics_of_the_second_boot_alone_belong_to_the_second_boot(opened):
    recording = Recording()
    recording.flight()
    for k in range(200):
        boot_ns = 10 * SECOND + k * STEP
        utc_ns = START + 200 * SECOND + k * STEP
        recording.fix(boot_ns, utc_ns)
        recording.send("SensorHygrometer", boot_ns, utc_ns, temperature=5.0, humidity=40.0)
        if k % 20 == 0:
            recording.shot(boot_ns, utc_ns, k)
    log = opened(recording.data)
    assert log.boots == 2
    assert_array_equal(seconds(log, "SensorHygrometer"), 200 + np.arange(200) / 5)
    assert_array_equal(
        seconds(log, "CameraCapture"),
        200 + np.arange(0, 40, 4),
    )
    assert log.channel("/fmu/out/CameraCapture").boot.tolist() == [1] * 10
    assert not loss_codes(log)
    table = log.message("/fmu/out/SensorHygrometer")
    assert table["time_ns"][0] == START + 200 * SECOND
    assert table["boot"][0] == 1


@pytest.mark.parametrize("row", [0, 1, 3, 199])
def test_a_stray_stamp_of_the_receiver_moves_nothing_else(opened, row):
    recording = Recording()
    for k in range(200):
        boot_ns = 60 * SECOND + k * STEP
        stray_ns = (1 << 30) * 1000 if k == row else 0
        recording.fix(boot_ns + stray_ns, START + k * STEP)
        recording.attitude(boot_ns, START + k * STEP)
    log = opened(recording.data)
    assert_array_equal(seconds(log), np.arange(200) / 5)
    assert_array_equal(
        seconds(log, "SensorGps"),
        np.delete(np.arange(200), row) / 5,
    )
    assert log.boots == 1
    assert entry_in(log, "TIME-STRAY").count == 1
    assert loss_codes(log) == {"TIME-STRAY"}


def take_shots(recording, utc_ahead_ns):
    """Exposures behind the flight in the file, as from a recorder that groups topics."""
    for k in range(250):  # more than the receiver has rows
        boot_ns = 70 * SECOND + k * SECOND // 10
        utc_ns = START + 10 * SECOND + k * SECOND // 10
        recording.shot(boot_ns, utc_ns, k, timestamp_utc=(utc_ns + utc_ahead_ns) // 1000)


def test_exposures_are_on_the_clock_of_the_poses(opened):
    """The autopilot's own UTC, 0.4 s ahead here, would move them against the poses."""
    recording = Recording()
    recording.flight()
    take_shots(recording, 4 * 10**8)
    shots_s = seconds(opened(recording.data), "CameraCapture")
    assert_array_equal(shots_s, 10 + np.arange(250) / 10)


def test_a_camera_tells_utc_where_no_receiver_does(opened):
    recording = Recording(has_clock=False)
    recording.flight(fix_type=0)
    take_shots(recording, 0)
    log = opened(recording.data)
    assert_array_equal(seconds(log, "CameraCapture"), 10 + np.arange(250) / 10)
    assert_array_equal(seconds(log), np.arange(200) / 5)
    assert not {"TIME-LOG-TIME", "TIME-NO-UTC"} & {entry.code for entry in log.ledger}


def test_without_utc_the_recorder_sets_the_clock_and_is_stated(opened):
    recording = Recording()
    recording.flight(fix_type=0)
    log = opened(recording.data)
    assert seconds(log)[0] == 0.003
    assert {entry.kind for entry in with_code(log.ledger, "TIME-LOG-TIME")} == {"fallback"}
    assert "recorder" in log.time_base


def test_with_neither_utc_nor_log_time_every_row_stays_and_time_is_from_boot(opened):
    recording = Recording(has_clock=False)
    recording.flight(fix_type=0)
    log = opened(recording.data)
    attitude = log.channel("/fmu/out/VehicleAttitude")
    assert_array_equal(attitude.time_ns, 60 * SECOND + np.arange(200) * STEP)
    assert entry_in(log, "TIME-NO-UTC").kind == "fallback"
    assert "unknown" in log.time_base


def test_stamps_that_change_from_boot_to_unix_time_fit_together(opened):
    """As from an agent that has not yet agreed with the vehicle on the time."""
    recording = Recording()
    for k in range(100):
        utc_ns = START + k * STEP
        stamp_ns = 60 * SECOND + k * STEP if k < 40 else utc_ns
        recording.fix(stamp_ns, utc_ns)
        recording.attitude(stamp_ns, utc_ns)
    log = opened(recording.data)
    assert_array_equal(seconds(log), np.arange(100) / 5)
    assert not loss_codes(log)


@pytest.mark.parametrize("events", [2, 9])
def test_messages_that_come_late_are_no_boot_and_not_stray(opened, events):
    recording = Recording()
    recording.flight(rows=100)
    for k in range(events):
        recording.shot(
            (60 + k) * SECOND + 1000,
            START + k * SECOND,
            k,
        )
    recording.flight(rows=100, boot_s=80, utc_s=20)
    log = opened(recording.data)
    assert log.boots == 1
    assert len(log.channel("/fmu/out/CameraCapture")) == events
    assert_array_equal(seconds(log), np.arange(200) / 5)
    assert "GNSS" in log.time_base
    assert not loss_codes(log)


@pytest.mark.parametrize(
    ("numbers", "endings"),
    [((1, 1), [""]), ((1, 2), ["[1]", "[2]"])],
    ids=["one gimbal", "two gimbals"],
)
def test_the_number_of_a_gimbal_names_a_channel_only_where_there_are_several(
    opened, numbers, endings
):
    recording = Recording()
    for k in range(20):
        gimbal = {"q": [1.0, 0.0, 0.0, 0.0], "gimbal_device_id": numbers[k % 2]}
        boot_ns = 60 * SECOND + k * STEP
        recording.send("GimbalDeviceAttitudeStatus", boot_ns, START + k * STEP, **gimbal)
    names = [channel.name for channel in opened(recording.data).channels]
    assert names == [f"/fmu/out/GimbalDeviceAttitudeStatus{ending}" for ending in endings]


@pytest.mark.parametrize("ahead_s", [0.0, -1.5, 0.8])
def test_a_second_clock_is_measured_by_the_recorder(opened, ahead_s):
    """Images with header.stamp of a computer, next to PX4's poses: recorded 43 ms late."""
    recording = Recording()
    recording.flight()
    for k in range(40):
        utc_ns = START + k * STEP
        stamp_ns = utc_ns + int(ahead_s * SECOND)
        recording.write("/image", "sensor_msgs/CompressedImage", stamp_ns, utc_ns + 43_000_000)
    log = opened(recording.data)
    assert log.second_clock.channels == {"/image", "/image.sent"}
    seems_s = ahead_s - 0.04
    assert log.second_clock.sigma_s == pytest.approx(np.hypot(seems_s, 0.1), abs=1e-6)
    entry = entry_in(log, "TIME-TWO-CLOCKS")
    assert (entry.kind, entry.where) == ("fallback", "/image")
    assert f"seems {seems_s:+.2f} s ahead" in entry.what


def test_a_second_clock_that_no_recorder_sees_is_unchecked(opened):
    recording = Recording(has_clock=False)
    recording.flight()
    recording.write("/image", "sensor_msgs/CompressedImage", START, 0)
    assert opened(recording.data).second_clock.sigma_s == 5.0


def test_stamps_of_one_clock_have_no_second(opened):
    recording = Recording()
    recording.flight()
    recording.shot(70 * SECOND, START + 10 * SECOND, 1)
    log = opened(recording.data)
    assert log.second_clock is None
    assert not with_code(log.ledger, "TIME-TWO-CLOCKS")
