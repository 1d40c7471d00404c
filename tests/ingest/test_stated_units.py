"""Units that a mission file states for a channel, beside those in which the log defines it."""

import numpy as np
import pytest

from tests.helpers import refused
from unbend.flight.channels import Channel, Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.dataflash.dataflash_channels import MESSAGES as DATAFLASH
from unbend.ingest.field_maps import PX4_MESSAGES as PX4
from unbend.ingest.field_maps import STATED_UNITS, extract, in_stated_unit
from unbend.ingest.tlog.dialect import MESSAGES as MAVLINK
from unbend.messages import Ledger


def logged(maps, message: str, field: str, value: float) -> Channel:
    """A channel of one row, as the builder makes it of a field of a message."""
    columns = extract(
        {field: np.array([value])},
        maps[message].columns,
    )
    boot = np.zeros(1, np.int16)
    rows = DecodedRows(
        message,
        Source(message),
        np.zeros(1, np.int64),
        boot,
        columns,
    )
    channel = channel_of(
        rows,
        maps[message],
        Ledger(),
    )
    assert channel is not None
    return channel


@pytest.mark.parametrize(
    ("role", "unit", "number", "si"),
    [
        ("cabin_pressure", "Pa", 81_250.0, 81_250.0),
        ("cabin_pressure", "hPa", 812.5, 81_250.0),
        ("cabin_pressure", "kPa", 81.25, 81_250.0),
        ("temperature", "K", 250.0, 250.0),
        ("temperature", "degC", -23.15, 250.0),
        ("humidity", "fraction", 0.65, 0.65),
        ("humidity", "percent", 65.0, 0.65),
        ("airspeed", "m/s", 60.0, 60.0),
    ],
)
def test_a_bare_value_is_converted(role, unit, number, si):
    named = logged(MAVLINK, "NAMED_VALUE_FLOAT", "value", number)
    column, *_ = STATED_UNITS[unit]
    converted = in_stated_unit(named, role, unit)
    assert converted[column][0] == pytest.approx(si, rel=1e-14)


def test_a_unit_of_another_quantity_is_refused():
    named = logged(MAVLINK, "NAMED_VALUE_FLOAT", "value", 5.0)
    with refused("CHANNEL-UNIT"):
        in_stated_unit(named, "pressure", "degC")


@pytest.mark.parametrize(
    ("maps", "message", "field", "value", "role", "unit"),
    [
        (DATAFLASH, "BARO", "Press", 81_250.0, "pressure", "Pa"),
        (DATAFLASH, "HYGR", "Humidity", 65.0, "humidity", "percent"),
        (DATAFLASH, "HYGR", "Temp", 12.5, "temperature", "degC"),
        (DATAFLASH, "ARSP", "Airspeed", 61.0, "airspeed", "m/s"),
        (MAVLINK, "SCALED_PRESSURE", "press_abs", 812.5, "pressure", "hPa"),
        (MAVLINK, "HIGHRES_IMU", "abs_pressure", 812.5, "cabin_pressure", "hPa"),
        (MAVLINK, "HYGROMETER_SENSOR", "humidity", 6500, "humidity", "percent"),
        (MAVLINK, "HYGROMETER_SENSOR", "temperature", 1250, "cabin_temperature", "degC"),
        (PX4, "SensorBaro", "pressure", 81_250.0, "pressure", "Pa"),
        (PX4, "SensorHygrometer", "humidity", 65.0, "humidity", "percent"),
    ],
)
def test_stating_the_unit_of_the_format_changes_nothing(maps, message, field, value, role, unit):
    channel = logged(maps, message, field, value)
    column, *_ = STATED_UNITS[unit]
    converted = in_stated_unit(channel, role, unit)
    assert converted[column][0] == pytest.approx(channel[column][0], rel=1e-14)


@pytest.mark.parametrize(
    ("maps", "message", "field", "value", "role", "unit", "si"),
    [  # a driver that fills the field with numbers of another unit than the format defines
        (MAVLINK, "SCALED_PRESSURE", "press_abs", 81.25, "pressure", "kPa", 81_250.0),
        (MAVLINK, "HYGROMETER_SENSOR", "temperature", 28_565, "temperature", "K", 285.65),
        (DATAFLASH, "BARO", "Press", 812.5, "pressure", "hPa", 81_250.0),
        (DATAFLASH, "HYGR", "Humidity", 0.65, "humidity", "fraction", 0.65),
        (PX4, "SensorHygrometer", "humidity", 0.65, "humidity", "fraction", 0.65),
    ],
)
def test_another_unit_than_that_of_the_format(maps, message, field, value, role, unit, si):
    channel = logged(maps, message, field, value)
    column, *_ = STATED_UNITS[unit]
    converted = in_stated_unit(channel, role, unit)
    assert converted[column][0] == pytest.approx(si, rel=1e-14)
