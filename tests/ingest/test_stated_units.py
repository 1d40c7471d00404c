"""Units that a mission file states for a channel, beside those in which the log defines it."""

import numpy as np
import pytest
import yaml

from tests.helpers import refused
from unbend.flight.channels import Channel, Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.dataflash.dataflash_channels import MESSAGES as DATAFLASH
from unbend.ingest.field_maps import PX4_MESSAGES as PX4
from unbend.ingest.field_maps import STATED_UNITS, extract, in_stated_unit
from unbend.ingest.tlog.dialect import MESSAGES as MAVLINK
from unbend.messages import Ledger

MAPS = {"dataflash": DATAFLASH, "mavlink": MAVLINK, "px4": PX4}


def logged(form, message: str, field: str, value: float) -> Channel:
    """A channel of one row, as the builder makes it of a field of a message."""
    field_map = MAPS[form][message]
    rows = DecodedRows(
        message,
        Source(message),
        np.zeros(1, np.int64),
        np.zeros(1, np.int16),
        extract({field: np.array([value])}, field_map.columns),
    )
    return channel_of(rows, field_map, Ledger())


def stated(channel: Channel, role: str, unit: str) -> float:
    """The value of a channel [SI] whose unit the mission file states."""
    column, *_ = STATED_UNITS[unit]
    return in_stated_unit(channel, role, unit)[column][0]


BARE = yaml.safe_load("""
- [cabin_pressure, Pa, 81250.0, 81250.0]
- [cabin_pressure, hPa, 812.5, 81250.0]
- [cabin_pressure, kPa, 81.25, 81250.0]
- [temperature, K, 250.0, 250.0]
- [temperature, degC, -23.15, 250.0]
- [humidity, fraction, 0.65, 0.65]
- [humidity, percent, 65.0, 0.65]
- [airspeed, m/s, 60.0, 60.0]
""")


@pytest.mark.parametrize(("role", "unit", "number", "si"), BARE)
def test_a_bare_value_is_converted(role, unit, number, si):
    named = logged("mavlink", "NAMED_VALUE_FLOAT", "value", number)
    assert stated(named, role, unit) == pytest.approx(si, rel=1e-14)


def test_a_unit_of_another_quantity_is_refused():
    named = logged("mavlink", "NAMED_VALUE_FLOAT", "value", 5.0)
    with refused("CHANNEL-UNIT") as refusal:
        in_stated_unit(named, "pressure", "degC")
    assert "degC" in str(refusal.value)


OF_THE_FORMAT = yaml.safe_load("""
- [dataflash, BARO, Press, 81250.0, pressure, Pa]
- [dataflash, HYGR, Humidity, 65.0, humidity, percent]
- [dataflash, HYGR, Temp, 12.5, temperature, degC]
- [dataflash, ARSP, Airspeed, 61.0, airspeed, m/s]
- [mavlink, SCALED_PRESSURE, press_abs, 812.5, pressure, hPa]
- [mavlink, HIGHRES_IMU, abs_pressure, 812.5, cabin_pressure, hPa]
- [mavlink, HYGROMETER_SENSOR, humidity, 6500, humidity, percent]
- [mavlink, HYGROMETER_SENSOR, temperature, 1250, cabin_temperature, degC]
- [px4, SensorBaro, pressure, 81250.0, pressure, Pa]
- [px4, SensorHygrometer, humidity, 65.0, humidity, percent]
""")


@pytest.mark.parametrize(("form", "message", "field", "value", "role", "unit"), OF_THE_FORMAT)
def test_stating_the_unit_of_the_format_changes_nothing(form, message, field, value, role, unit):
    channel = logged(form, message, field, value)
    column, *_ = STATED_UNITS[unit]
    assert stated(channel, role, unit) == pytest.approx(channel[column][0], rel=1e-14)


# A driver fills the field with numbers of another unit than the format defines.
OTHER_UNITS = yaml.safe_load("""
- [mavlink, SCALED_PRESSURE, press_abs, 81.25, pressure, kPa, 81250.0]
- [mavlink, HYGROMETER_SENSOR, temperature, 28565, temperature, K, 285.65]
- [dataflash, BARO, Press, 812.5, pressure, hPa, 81250.0]
- [dataflash, HYGR, Humidity, 0.65, humidity, fraction, 0.65]
- [px4, SensorHygrometer, humidity, 0.65, humidity, fraction, 0.65]
""")


@pytest.mark.parametrize(("form", "message", "field", "value", "role", "unit", "si"), OTHER_UNITS)
def test_another_unit_than_that_of_the_format(form, message, field, value, role, unit, si):
    channel = logged(form, message, field, value)
    assert stated(channel, role, unit) == pytest.approx(si, rel=1e-14)
