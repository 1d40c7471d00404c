"""PX4 over ROS 2: a clock that begins at each boot, receivers, cameras. Truth is how it is sent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from unbend.ingest import Log, open_log

SECOND = 10**9
START = 1_700_000_000 * SECOND
STEP = SECOND // 5

KINDS = {
    "SensorGps": "uint64 timestamp\nuint64 time_utc_usec\nfloat64 latitude_deg\n"
    "float64 longitude_deg\nfloat64 altitude_msl_m\nfloat64 altitude_ellipsoid_m\nuint8 fix_type",
    "VehicleAttitude": "uint64 timestamp\nfloat32[4] q",
    "SensorHygrometer": "uint64 timestamp\nfloat32 temperature\nfloat32 humidity",
    "CameraCapture": "uint64 timestamp\nuint64 timestamp_utc\nuint32 seq\nint8 result",
}
FIX = {
    "latitude_deg": 47.5,
    "longitude_deg": 8.25,
    "altitude_msl_m": 600.0,
    "altitude_ellipsoid_m": 647.5,
    "fix_type": 3,
}
Send = Callable[..., None]


def recorded(path: Path, send_all: Callable[[Send], None]) -> Log:
    """``send(kind, boot_ns, utc_ns, log_ns=..., field=...)``; recorded 3 ms late."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {n: writer.register_msgdef(f"px4_msgs/msg/{n}", d) for n, d in KINDS.items()}

        def send(kind: str, boot_ns: int, utc_ns: int, log_ns: int | None = None, **fields) -> None:
            at = utc_ns + 3_000_000 if log_ns is None else log_ns
            row = {"timestamp": boot_ns // 1000, **fields}
            writer.write_message(f"/fmu/out/{kind}", schemas[kind], row, at)

        send_all(send)
        writer.finish()
    return open_log(path)


def flight(send: Send, rows: int = 200, boot_s: int = 60, utc_s: int = 0, **options) -> None:
    """A receiver and an attitude at 5 Hz; options: utc(k) and fix(k) of the receiver, stray(k)."""
    for k in range(rows):
        boot_ns = boot_s * SECOND + k * STEP
        utc_ns = START + utc_s * SECOND + k * STEP
        told = options.get("utc", lambda _, utc_ns: utc_ns)(k, utc_ns)
        fix = options.get("fix", lambda _: 3)(k)
        wrong = options.get("stray", lambda _: 0)(k)
        fields = FIX | {"time_utc_usec": told // 1000, "fix_type": fix}
        log = {"log_ns": options["log_ns"]} if "log_ns" in options else {}
        send("SensorGps", boot_ns + wrong, utc_ns, **fields, **log)
        send("VehicleAttitude", boot_ns, utc_ns, q=[1.0, 0.0, 0.0, 0.0], **log)


def seconds(log: Log, kind: str) -> np.ndarray:
    return (log.channel(f"/fmu/out/{kind}").time_ns - START) / SECOND


def losses(log: Log) -> set[str]:
    return {entry.code for entry in log.ledger if entry.kind == "loss"}


def test_topics_of_the_second_boot_alone_belong_to_the_second_boot(tmp_path: Path) -> None:
    def send_all(send: Send) -> None:
        flight(send)
        for k in range(200):
            boot_ns = 10 * SECOND + k * STEP
            utc_ns = START + 200 * SECOND + k * STEP
            send("SensorGps", boot_ns, utc_ns, **FIX, time_utc_usec=utc_ns // 1000)
            send("SensorHygrometer", boot_ns, utc_ns, temperature=5.0, humidity=40.0)
            if k % 20 == 0:
                send("CameraCapture", boot_ns, utc_ns, timestamp_utc=0, seq=k, result=1)

    log = recorded(tmp_path / "two.mcap", send_all)
    assert log.boots == 2
    np.testing.assert_array_equal(seconds(log, "SensorHygrometer"), 200 + np.arange(200) / 5)
    np.testing.assert_array_equal(seconds(log, "CameraCapture"), 200 + np.arange(0, 40, 4))
    assert np.unique(log.channel("/fmu/out/CameraCapture").boot).tolist() == [1]
    assert not losses(log)
    table = log.message("/fmu/out/SensorHygrometer")
    assert (table["time_ns"][0], table["boot"][0]) == (START + 200 * SECOND, 1)


def test_a_reboot_whose_clock_is_ahead_of_the_last_is_one(tmp_path: Path) -> None:
    def send_all(send: Send) -> None:
        flight(send, rows=150, boot_s=10)
        flight(send, rows=150, boot_s=60, utc_s=3600)

    log = recorded(tmp_path / "ahead.mcap", send_all)
    assert log.boots == 2
    found = seconds(log, "VehicleAttitude")
    np.testing.assert_array_equal(found, np.append(np.arange(150), np.arange(150) + 18_000) / 5)
    assert [e.count for e in log.ledger if e.code == "TIME-REBOOT"] == [1]


@pytest.mark.parametrize("row", [0, 1, 3, 199])
def test_a_stray_stamp_of_the_receiver_moves_nothing_else(tmp_path: Path, row: int) -> None:
    log = recorded(
        tmp_path / "stray.mcap",
        lambda send: flight(send, stray=lambda k: (1 << 30) * 1000 if k == row else 0),
    )
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(200) / 5)
    np.testing.assert_array_equal(seconds(log, "SensorGps"), np.delete(np.arange(200), row) / 5)
    assert log.boots == 1
    assert [(e.kind, e.count) for e in log.ledger if e.code == "TIME-STRAY"] == [("loss", 1)]
    assert losses(log) == {"TIME-STRAY"}


def test_utc_without_a_fix_counts_for_nothing(tmp_path: Path) -> None:
    log = recorded(
        tmp_path / "nofix.mcap",
        lambda send: flight(
            send,
            fix=lambda k: 0 if k < 120 else 3,
            utc=lambda k, utc_ns: utc_ns - 3600 * SECOND if k < 120 else utc_ns,
        ),
    )
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(200) / 5)
    assert not losses(log)


def test_a_receiver_that_repeats_its_time_counts_once_a_time(tmp_path: Path) -> None:
    """Two of three rows repeat the UTC of the row before: late by 0.2 and 0.4 s."""
    log = recorded(
        tmp_path / "repeats.mcap",
        lambda send: flight(send, utc=lambda k, utc_ns: utc_ns - k % 3 * STEP),
    )
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(200) / 5)


def with_captures(send: Send, utc_ahead_ns: int, fix: int, log_ns: int | None = None) -> None:
    """All exposures behind the flight in the file, as from a recorder that groups topics."""
    log = {} if log_ns is None else {"log_ns": log_ns}
    flight(send, fix=lambda _: fix, **log)
    for k in range(250):  # more than the receiver has rows
        boot_ns = 70 * SECOND + k * SECOND // 10
        utc_ns = START + 10 * SECOND + k * SECOND // 10
        told = (utc_ns + utc_ahead_ns) // 1000
        send("CameraCapture", boot_ns, utc_ns, timestamp_utc=told, seq=k, result=1, **log)


def test_exposures_are_on_the_clock_of_the_poses(tmp_path: Path) -> None:
    """The autopilot's own UTC, 0.4 s ahead here, would move them against the poses."""
    log = recorded(tmp_path / "both.mcap", lambda send: with_captures(send, 4 * 10**8, 3))
    np.testing.assert_array_equal(seconds(log, "CameraCapture"), 10 + np.arange(250) / 10)


def test_a_camera_tells_utc_where_no_receiver_does(tmp_path: Path) -> None:
    log = recorded(tmp_path / "camera.mcap", lambda send: with_captures(send, 0, 0, log_ns=0))
    np.testing.assert_array_equal(seconds(log, "CameraCapture"), 10 + np.arange(250) / 10)
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(200) / 5)
    assert not {"TIME-LOG-TIME", "TIME-NO-UTC"} & {entry.code for entry in log.ledger}


def test_with_neither_utc_nor_log_time_every_row_stays_and_time_is_from_boot(
    tmp_path: Path,
) -> None:
    log = recorded(tmp_path / "boot.mcap", lambda send: flight(send, fix=lambda _: 0, log_ns=0))
    attitude = log.channel("/fmu/out/VehicleAttitude")
    np.testing.assert_array_equal(attitude.time_ns, 60 * SECOND + np.arange(200) * STEP)
    assert [e.kind for e in log.ledger if e.code == "TIME-NO-UTC"] == ["fallback"]
    assert "unknown" in log.time_base


def test_stamps_that_change_from_boot_to_unix_time_fit_together(tmp_path: Path) -> None:
    """As from an agent that has not yet agreed with the vehicle on the time."""

    def send_all(send: Send) -> None:
        for k in range(100):
            boot_ns = 60 * SECOND + k * STEP
            utc_ns = START + k * STEP
            stamp = boot_ns if k < 40 else utc_ns
            send("SensorGps", stamp, utc_ns, **FIX, time_utc_usec=utc_ns // 1000)
            send("VehicleAttitude", stamp, utc_ns, q=[1.0, 0.0, 0.0, 0.0])

    log = recorded(tmp_path / "both.mcap", send_all)
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(100) / 5)
    assert not losses(log)


@pytest.mark.parametrize("events", [2, 9])
def test_messages_that_come_late_are_no_boot_and_not_stray(tmp_path: Path, events: int) -> None:
    def send_all(send: Send) -> None:
        flight(send, rows=100)
        for k in range(events):
            utc_ns = START + k * SECOND
            send(
                "CameraCapture",
                60 * SECOND + k * SECOND + 1000,
                utc_ns,
                timestamp_utc=0,
                seq=k,
                result=1,
            )
        flight(send, rows=100, boot_s=80, utc_s=20)

    log = recorded(tmp_path / "late.mcap", send_all)
    assert log.boots == 1
    assert len(log.channel("/fmu/out/CameraCapture")) == events
    np.testing.assert_array_equal(seconds(log, "VehicleAttitude"), np.arange(200) / 5)
    assert not losses(log)


def test_images_that_were_not_taken_are_no_exposures(tmp_path: Path) -> None:
    def send_all(send: Send) -> None:
        flight(send)
        for k in range(9):
            result = {2: 0, 5: -1}.get(k, 1)  # failed, not known
            utc_ns = START + k * SECOND
            send(
                "CameraCapture",
                60 * SECOND + k * SECOND,
                utc_ns,
                timestamp_utc=0,
                seq=k,
                result=result,
            )

    log = recorded(tmp_path / "failed.mcap", send_all)
    shots = log.channel("/fmu/out/CameraCapture")
    assert shots["event_index"].tolist() == [0, 1, 3, 4, 5, 6, 7, 8]
    assert "result" not in shots.columns
    assert [(e.kind, e.count) for e in log.ledger if e.code == "EVENT-FAILED"] == [("warning", 1)]


def test_a_height_of_0_above_the_ellipsoid_is_missing(tmp_path: Path) -> None:
    def send_all(send: Send) -> None:
        for k in range(20):
            utc_ns = START + k * STEP
            send(
                "SensorGps",
                SECOND + k * STEP,
                utc_ns,
                **FIX | {"altitude_ellipsoid_m": 0.0},
                time_utc_usec=utc_ns // 1000,
            )

    fix = recorded(tmp_path / "zero.mcap", send_all).channel("/fmu/out/SensorGps")
    assert "h_ellipsoid_m" not in fix.columns
