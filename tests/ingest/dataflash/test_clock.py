"""DataFlash: boots, receivers and instances that have to be kept apart."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import with_code
from tests.ingest.written_logs import DataFlashWriter, loss_codes
from unbend.flight.clock import utc_of_gps

WEEK = 2324


@pytest.fixture
def writer():
    made = DataFlashWriter()
    made.define_receiver()
    made.define(50, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    return made


def seconds(log, name="ATT"):
    """The times of a channel from the beginning of the week on."""
    return (log.channel(name).time_ns - utc_of_gps(WEEK, 0.0)) / 1e9


def test_the_first_boot_of_two_with_the_second_receiver_alone(writer, opened):
    for k in range(300):
        time_us = 10**7 + 200_000 * k
        if k == 5:
            writer.fix(time_us, 1000, week=2300)
        else:
            writer.fix(time_us, 0, week=2300, status=0)
        writer.fix(
            time_us + 20,
            1000 + 200 * k,
            week=WEEK,
            instance=1,
        )
        writer.row("ATT", time_us + 50, 0, 0, 0)
    log = opened(writer.data)
    assert seconds(log)[0] == pytest.approx(1.0, abs=1e-4)
    assert "TIME-SOURCES" in loss_codes(log)


def test_time_without_a_fix_is_not_used(writer, opened):
    """A receiver that has no fix yet counts from its own battery clock."""
    for k in range(100):
        time_us = 10**7 + 200_000 * k
        if k < 60:
            writer.fix(
                time_us,
                500 + 200 * k,
                week=WEEK,
                status=2,
            )
        else:
            writer.fix(time_us, 1000 + 200 * k, week=WEEK)
        writer.row("ATT", time_us + 50, 0, 0, 0)
    log = opened(writer.data)
    assert seconds(log)[0] == pytest.approx(1.0, abs=1e-4)
    assert not loss_codes(log)


def test_accuracy_goes_to_its_boot_and_its_instance(writer, opened):
    """Two boots and two receivers with equal stamps, of which one row of either kind is lost."""
    writer.define(62, "GPA", "QBCe", "TimeUS,I,HAcc,AEl")
    for boot in (0, 1):
        for k in range(40):
            time_us = 5_000_000 + 200_000 * k
            week_ms = 1000 + 60_000 * boot + 200 * k
            for instance in (0, 1):
                if (boot, instance, k) != (0, 0, 9):
                    writer.fix(time_us, week_ms, week=WEEK, instance=instance)
            for instance in (0, 1):
                accuracy = 0.5 + boot + 0.25 * instance
                if (boot, instance, k) != (1, 0, 7):
                    writer.row("GPA", time_us, instance, accuracy, 600.0 + accuracy)
    log = opened(writer.data)
    assert log.boots == 2
    for instance, lost in ((0, [46]), (1, [])):
        channel = log.channel(f"GPS[{instance}]")
        accuracy = 0.5 + channel.boot + 0.25 * instance
        accuracy[lost] = np.nan
        assert_allclose(
            channel["sigma_h_m"],
            accuracy / np.sqrt(2.0),
            rtol=1e-12,
        )
        assert_array_equal(channel["h_ellipsoid_m"], 600.0 + accuracy)


def test_instances_stay_apart_where_a_definition_gains_them(writer, opened):
    writer.define(30, "BARO", "Qfc", "TimeUS,Press,Temp")
    for k in range(40):
        writer.fix(
            5_000_000 + 100_000 * k,
            100 * k,
            week=WEEK,
        )
        writer.row("BARO", 5_000_050 + 100_000 * k, 90_000.0, 30.0)
    writer.define(31, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k in range(40):
        time_us = 9_100_000 + 100_000 * k
        writer.fix(time_us, 4100 + 100 * k, week=WEEK)
        writer.row("BARO", time_us, 0, 80_000.0, 30.0)
        writer.row(
            "BARO",
            time_us + 10,
            1,
            99_000.0,
            40.0,
        )
    log = opened(writer.data)
    read_pa = {"BARO": 90_000.0, "BARO[0]": 80_000.0, "BARO[1]": 99_000.0}
    for name, pressure_pa in read_pa.items():
        assert np.unique(log.channel(name)["pressure_pa"]).tolist() == [pressure_pa]
    instances = log.message("BARO")["I"]
    assert instances.dtype.kind == "i"
    assert np.bincount(instances + 1).tolist() == [40, 40, 40]
    assert len(log.message("BARO", "1")["Press"]) == 40


SEA_LEVEL = {"h_msl_m": [600.0, 600.0]}


@pytest.mark.parametrize(
    ("options", "logged_m", "columns"),
    [
        (16.0, 0.0, {"h_msl_m": [552.5, np.nan], "h_ellipsoid_m": [600.0, 600.0]}),
        (64.0, 0.0, SEA_LEVEL | {"h_ellipsoid_m": [647.5, np.nan]}),
        (0.0, 0.0, SEA_LEVEL | {"h_ellipsoid_m": [647.5, np.nan]}),
        (0.0, 599.0, SEA_LEVEL | {"h_ellipsoid_m": [599.0, 599.0]}),
    ],
    ids=["above the ellipsoid", "another option", "above sea level", "both are logged"],
)
def test_the_undulation_and_heights_above_the_ellipsoid(writer, opened, options, logged_m, columns):
    """Until 4.6 the undulation is logged as sea level minus ellipsoid, 0 where it is not known.

    Alt is either: bit 4 of GPS_DRV_OPTIONS (AP_GPS.h) makes it a height above the ellipsoid.
    """
    writer.define(21, "PARM", "QNf", "TimeUS,Name,Value")
    above_ellipsoid = "AEl" if logged_m else "Unused"
    writer.define(62, "GPA", "QBCfe", f"TimeUS,I,HAcc,Und,{above_ellipsoid}")
    writer.row("PARM", 4_900_000, b"GPS_DRV_OPTIONS", options)
    for k in range(20):
        time_us = 5_000_000 + 200_000 * k
        undulation_m = 0.0 if k == 1 else -47.5
        writer.fix(time_us, 1000 + 200 * k, week=WEEK)
        writer.row("GPA", time_us, 0, 0.5, undulation_m, logged_m)
        writer.row("ATT", time_us, 0, 0, 0)
    log = opened(writer.data)
    assert len(log.channel("ATT")) == 20  # what has no height is left as it is
    channel = log.channel("GPS[0]")
    for name, heights in columns.items():
        assert_array_equal(channel[name][:2], heights)
    assert "undulation_m" not in channel.columns
    entries = with_code(log.ledger, "HEIGHT-ELLIPSOID")
    told = [(entry.kind, entry.where) for entry in entries]
    assert told == [("note", "PARM")] * (options == 16.0)


def test_impossible_values_are_flagged_when_a_log_is_opened(writer, opened):
    latitudes = {
        20: 147.0,
        40: 47.5,
        41: 47.5,
        59: 47.5,
    }
    for k in range(60):
        epoch = (5_000_000 + 200_000 * k, 0, 3, 1000 + 200 * k, WEEK)
        height = 6e6 if k == 30 else 600.0
        writer.row(
            "GPS",
            *epoch,
            12,
            0.8,
            latitudes.get(k, 47.0),
            8.0,
            height,
        )
    log = opened(writer.data)
    channel = log.channel("GPS[0]")
    assert len(channel) == 56
    assert np.isnan(channel["h_msl_m"]).sum() == 1
    assert np.degrees(channel["lat_rad"]).max() == pytest.approx(47.0)
    losses = [entry for entry in log.ledger if entry.kind == "loss"]
    flags = [(entry.code, entry.count) for entry in losses]
    assert sorted(flags) == [("SENSOR-JUMP", 3), ("SENSOR-RANGE", 1), ("SENSOR-RANGE", 1)]
    assert len(log.message("GPS")["Lat"]) == 60  # a table is as it was logged
