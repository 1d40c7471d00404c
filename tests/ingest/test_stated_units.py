"""Units that a mission file states for a channel, beside those in which the log defines it."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.dataflash.dataflash_channels import MESSAGES as DATAFLASH
from unbend.ingest.field_maps import PX4_MESSAGES as PX4
from unbend.ingest.field_maps import STATED_UNITS, extract, in_stated_unit
from unbend.ingest.tlog.dialect import MESSAGES as MAVLINK
from unbend.messages import Ledger


def logged(maps, message: str, **fields: float) -> Channel:
    """A channel of one row, as the builder makes it of these fields of a message."""
    table = {name: np.array([value]) for name, value in fields.items()}
    columns = extract(table, maps[message].columns)
    rows = DecodedRows(
        message, Source(message), np.zeros(1, np.int64), np.zeros(1, np.int16), columns
    )
    channel = channel_of(rows, maps[message], Ledger())
    assert channel is not None
    return channel


@pytest.mark.parametrize(
    ("unit", "number", "si"),
    [
        ("Pa", 81_250.0, 81_250.0),
        ("hPa", 812.5, 81_250.0),
        ("kPa", 81.25, 81_250.0),
        ("K", 250.0, 250.0),
        ("degC", -23.15, 250.0),
        ("fraction", 0.65, 0.65),
        ("percent", 65.0, 0.65),
        ("m/s", 60.0, 60.0),
    ],
)
def test_a_bare_value_is_converted(unit, number, si):
    column = STATED_UNITS[unit][0]
    role = {
        "pressure_pa": "cabin_pressure",
        "temperature_k": "temperature",
        "relative_humidity": "humidity",
        "airspeed_m_s": "airspeed",
    }[column]
    named = logged(MAVLINK, "NAMED_VALUE_FLOAT", value=number)
    assert in_stated_unit(named, role, unit)[column][0] == pytest.approx(si, rel=1e-14)


def test_a_unit_of_another_quantity_is_refused():
    named = logged(MAVLINK, "NAMED_VALUE_FLOAT", value=5.0)
    with pytest.raises(MissionError, match="CHANNEL-UNIT"):
        in_stated_unit(named, "pressure", "degC")


@pytest.mark.parametrize(
    ("maps", "message", "fields", "role", "unit"),
    [
        (DATAFLASH, "BARO", {"Press": 81_250.0}, "pressure", "Pa"),
        (DATAFLASH, "HYGR", {"Humidity": 65.0}, "humidity", "percent"),
        (DATAFLASH, "HYGR", {"Temp": 12.5}, "temperature", "degC"),
        (DATAFLASH, "ARSP", {"Airspeed": 61.0}, "airspeed", "m/s"),
        (MAVLINK, "SCALED_PRESSURE", {"press_abs": 812.5}, "pressure", "hPa"),
        (MAVLINK, "HIGHRES_IMU", {"abs_pressure": 812.5}, "cabin_pressure", "hPa"),
        (MAVLINK, "HYGROMETER_SENSOR", {"humidity": 6500}, "humidity", "percent"),
        (MAVLINK, "HYGROMETER_SENSOR", {"temperature": 1250}, "cabin_temperature", "degC"),
        (PX4, "SensorBaro", {"pressure": 81_250.0}, "pressure", "Pa"),
        (PX4, "SensorHygrometer", {"humidity": 65.0}, "humidity", "percent"),
    ],
)
def test_stating_the_unit_of_the_format_changes_nothing(maps, message, fields, role, unit):
    channel = logged(maps, message, **fields)
    column = STATED_UNITS[unit][0]
    stated = in_stated_unit(channel, role, unit)
    assert stated[column][0] == pytest.approx(channel[column][0], rel=1e-14)


@pytest.mark.parametrize(
    ("maps", "message", "fields", "role", "unit", "si"),
    [  # a driver that fills the field with numbers of another unit than the format defines
        (MAVLINK, "SCALED_PRESSURE", {"press_abs": 81.25}, "pressure", "kPa", 81_250.0),
        (MAVLINK, "HYGROMETER_SENSOR", {"temperature": 28_565}, "temperature", "K", 285.65),
        (DATAFLASH, "BARO", {"Press": 812.5}, "pressure", "hPa", 81_250.0),
        (DATAFLASH, "HYGR", {"Humidity": 0.65}, "humidity", "fraction", 0.65),
        (PX4, "SensorHygrometer", {"humidity": 0.65}, "humidity", "fraction", 0.65),
    ],
)
def test_another_unit_than_that_of_the_format(maps, message, fields, role, unit, si):
    channel = logged(maps, message, **fields)
    assert in_stated_unit(channel, role, unit)[STATED_UNITS[unit][0]][0] == pytest.approx(si)
