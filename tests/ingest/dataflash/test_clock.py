"""DataFlash: boots, receivers and instances that have to be kept apart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unbend.flight.clock import utc_of_gps
from unbend.ingest import Log, open_log

WEEK = 2324


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[Any], Log]:
    def write_and_open(writer: Any) -> Log:
        path = tmp_path / "flight.bin"
        path.write_bytes(writer.data)
        return open_log(path)

    return write_and_open


@pytest.fixture
def writer(dataflash_writer: Callable) -> Any:
    made = dataflash_writer()
    made.define(20, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt")
    made.define(50, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    return made


def fix(
    writer: Any, time_us: int, ms: int, instance: int = 0, status: int = 3, week: int = WEEK
) -> None:
    writer.row("GPS", time_us, instance, status, ms, week, 12, 0.8, 47.0, 8.0, 600.0)


def codes(log: Log, kind: str) -> list[str]:
    return [entry.code for entry in log.ledger if entry.kind == kind]


def seconds(log: Log, name: str) -> np.ndarray:
    return (log.channel(name).time_ns - utc_of_gps(WEEK, 0.0)) / 1e9


def test_a_boot_whose_first_time_is_later_than_the_last(writer: Any, opened: Callable) -> None:
    expected = []
    for begin_s, utc_s, rows in ((10, 1, 100), (60, 3601, 3000)):
        for k in range(rows):
            fix(writer, begin_s * 10**6 + 200_000 * k, utc_s * 1000 + 200 * k)
            writer.row("ATT", begin_s * 10**6 + 200_000 * k + 50, 0, 0, 0)
            expected.append(utc_s + 0.2 * k)
    log = opened(writer)
    assert log.boots == 2
    np.testing.assert_allclose(seconds(log, "ATT"), expected, atol=1e-4)
    np.testing.assert_array_equal(log.channel("ATT").boot, [0] * 100 + [1] * 3000)
    assert "TIME-REBOOT" in codes(log, "warning")


def test_the_first_boot_of_two_with_the_second_receiver_alone(
    writer: Any, opened: Callable
) -> None:
    for k in range(300):
        seen = k == 5
        fix(writer, 10**7 + 200_000 * k, 1000 if seen else 0, 0, 3 if seen else 0, 2300)
        fix(writer, 10**7 + 200_000 * k + 20, 1000 + 200 * k, 1)
        writer.row("ATT", 10**7 + 200_000 * k + 50, 0, 0, 0)
    log = opened(writer)
    assert seconds(log, "ATT")[0] == pytest.approx(1.0, abs=1e-4)
    assert "TIME-SOURCES" in codes(log, "loss")


def test_time_without_a_fix_is_not_used(writer: Any, opened: Callable) -> None:
    """A receiver that has no fix yet counts from its own battery clock."""
    for k in range(100):
        blind = k < 60
        fix(writer, 10**7 + 200_000 * k, 1000 + 200 * k - 500 * blind, 0, 2 if blind else 3)
        writer.row("ATT", 10**7 + 200_000 * k + 50, 0, 0, 0)
    log = opened(writer)
    assert seconds(log, "ATT")[0] == pytest.approx(1.0, abs=1e-4)
    assert codes(log, "loss") == []


def test_rows_that_repeat_their_time_are_not_used(writer: Any, opened: Callable) -> None:
    """At 10 Hz with time in steps of 400 ms three rows in four are late, by up to 300 ms."""
    for k in range(400):
        fix(writer, 10**7 + 100_000 * k, 1000 + 400 * (k // 4))
        writer.row("ATT", 10**7 + 100_000 * k + 50, 0, 0, 0)
    assert seconds(opened(writer), "ATT")[0] == pytest.approx(1.0, abs=1e-4)


def test_accuracy_goes_to_its_boot_and_its_instance(writer: Any, opened: Callable) -> None:
    """Two boots and two receivers with equal stamps, of which one row of either kind is lost."""
    writer.define(62, "GPA", "QBCe", "TimeUS,I,HAcc,AEl")
    for boot in (0, 1):
        for k in range(40):
            time_us = 5_000_000 + 200_000 * k
            for instance in (0, 1):
                if (boot, instance, k) != (0, 0, 9):
                    fix(writer, time_us, 1000 + 60_000 * boot + 200 * k, instance)
            for instance in (0, 1):
                told = 0.5 + boot + 0.25 * instance
                if (boot, instance, k) != (1, 0, 7):
                    writer.row("GPA", time_us, instance, told, 600.0 + told)
    log = opened(writer)
    assert log.boots == 2
    for instance, lost in ((0, [46]), (1, [])):
        channel = log.channel(f"GPS[{instance}]")
        told = 0.5 + channel.boot + 0.25 * instance
        told[lost] = np.nan
        np.testing.assert_allclose(channel["sigma_h_m"], told / np.sqrt(2.0), rtol=1e-12)
        np.testing.assert_array_equal(channel["h_ellipsoid_m"], 600.0 + told)


def test_instances_stay_apart_where_a_definition_gains_them(writer: Any, opened: Callable) -> None:
    writer.define(30, "BARO", "Qfc", "TimeUS,Press,Temp")
    for k in range(40):
        fix(writer, 5_000_000 + 100_000 * k, 100 * k)
        writer.row("BARO", 5_000_050 + 100_000 * k, 90_000.0, 30.0)
    writer.define(31, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k in range(40):
        fix(writer, 9_100_000 + 100_000 * k, 4100 + 100 * k)
        writer.row("BARO", 9_100_000 + 100_000 * k, 0, 80_000.0, 30.0)
        writer.row("BARO", 9_100_010 + 100_000 * k, 1, 99_000.0, 40.0)
    log = opened(writer)
    found = {c.name: np.unique(c["pressure_pa"]).tolist() for c in log.channels if "BARO" in c.name}
    assert found == {"BARO": [90_000.0], "BARO[0]": [80_000.0], "BARO[1]": [99_000.0]}
    table = log.message("BARO")
    assert table["I"].dtype.kind == "i"
    assert np.bincount(table["I"] + 1).tolist() == [40, 40, 40]
    assert len(log.message("BARO", "1")["Press"]) == 40


@pytest.mark.parametrize(
    ("option", "msl", "ellipsoid"), [(16.0, 552.5, 600.0), (0.0, 600.0, 647.5)]
)
def test_the_undulation_and_heights_above_the_ellipsoid(
    writer: Any, opened: Callable, option: float, msl: float, ellipsoid: float
) -> None:
    """Until 4.6 the undulation is logged as sea level minus ellipsoid; Alt is either."""
    writer.define(21, "PARM", "QNf", "TimeUS,Name,Value")
    writer.define(62, "GPA", "QBCf", "TimeUS,I,HAcc,Und")
    writer.row("PARM", 4_900_000, b"GPS_DRV_OPTIONS", option)
    for k in range(20):
        fix(writer, 5_000_000 + 200_000 * k, 1000 + 200 * k)
        writer.row("GPA", 5_000_000 + 200_000 * k, 0, 0.5, -47.5)
    channel = opened(writer).channel("GPS[0]")
    assert (channel["h_msl_m"][0], channel["h_ellipsoid_m"][0]) == (msl, ellipsoid)
    assert "undulation_m" not in channel.columns


def test_impossible_values_are_flagged_when_a_log_is_opened(writer: Any, opened: Callable) -> None:
    for k in range(60):
        row = (5_000_000 + 200_000 * k, 0, 3, 1000 + 200 * k, WEEK, 12, 0.8)
        lat = {20: 147.0, 40: 47.5, 41: 47.5, 59: 47.5}.get(k, 47.0)
        writer.row("GPS", *row, lat, 8.0, 6e6 if k == 30 else 600.0)
    log = opened(writer)
    channel = log.channel("GPS[0]")
    assert len(channel) == 56
    assert np.isnan(channel["h_msl_m"]).sum() == 1
    assert np.degrees(channel["lat_rad"]).max() == pytest.approx(47.0)
    flags = [(entry.code, entry.count) for entry in log.ledger if entry.kind == "loss"]
    assert sorted(flags) == [("SENSOR-JUMP", 3), ("SENSOR-RANGE", 1), ("SENSOR-RANGE", 1)]
    assert len(log.message("GPS")["Lat"]) == 60  # a table is as it was logged
