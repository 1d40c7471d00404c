"""PX4 logs: files with known content, written by hand as the ULog specification says."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import LogError
from pipeline.ingest import Log, open_log

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


@pytest.fixture
def pyulog() -> None:
    pytest.importorskip("pyulog", reason="pyulog is an extra: pip install 'unbend[ulog]'")


@pytest.mark.usefixtures("pyulog")
def test_known_flight(tmp_path: Path) -> None:
    log = opened(tmp_path, flight())
    names = ["camera_capture", "sensor_baro[0]", "sensor_baro[1]", "sensor_hygrometer"]
    assert [channel.name for channel in log.channels] == [
        *names, "vehicle_attitude", "vehicle_gps_position",
    ]  # fmt: skip
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


@pytest.mark.usefixtures("pyulog")
def test_every_cut_opens_or_refuses_and_is_told(tmp_path: Path) -> None:
    data = flight()
    boundaries, at = {len(data)}, 16
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
    assert ends <= {"LOG-TRUNCATED", "LOG-ULOG-DAMAGE", "LOG-NO-MESSAGES", "LOG-FORMAT", "LOG-ULOG"}


@pytest.mark.usefixtures("pyulog")
def test_a_file_that_pyulog_gives_up_on(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(LogError) as caught:
        open_log(path)
    assert caught.value.code == "LOG-ULOG"


def test_without_pyulog_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(LogError, match="ulog") as caught:
        opened(tmp_path, flight())
    assert caught.value.code == "LOG-NEEDS-EXTRA"
    assert "unbend[ulog]" in caught.value.remedy
