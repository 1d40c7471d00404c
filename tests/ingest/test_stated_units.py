"""Units that a mission file states for a channel, beside those in which the log defines it."""

import numpy as np
import pytest
import yaml

from tests.helpers import refused
from unbend.flight.channels import Source
from unbend.ingest.channel_builder import DecodedRows, channel_of
from unbend.ingest.dataflash.dataflash_channels import MESSAGES as DATAFLASH
from unbend.ingest.field_maps import PX4_MESSAGES as PX4
from unbend.ingest.field_maps import STATED_UNITS, extract, in_stated_unit
from unbend.ingest.tlog.dialect import MESSAGES as MAVLINK
from unbend.messages import Ledger

MAPS = {"dataflash": DATAFLASH, "mavlink": MAVLINK, "px4": PX4}


def logged(form, message, field, value):
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


def stated(channel, role, unit):
    """The value of a channel [SI] whose unit the mission file states."""
    column, *_ = STATED_UNITS[unit]
    return in_stated_unit(channel, role, unit)[column][0]


UNITS = yaml.safe_load("""
# A bare number, whose unit the mission file alone knows.
- [mavlink, NAMED_VALUE_FLOAT, value, 81250.0, cabin_pressure, Pa, 81250.0]
- [mavlink, NAMED_VALUE_FLOAT, value, 812.5, cabin_pressure, hPa, 81250.0]
- [mavlink, NAMED_VALUE_FLOAT, value, 81.25, cabin_pressure, kPa, 81250.0]
- [mavlink, NAMED_VALUE_FLOAT, value, 250.0, temperature, K, 250.0]
- [mavlink, NAMED_VALUE_FLOAT, value, -23.15, temperature, degC, 250.0]
- [mavlink, NAMED_VALUE_FLOAT, value, 0.65, humidity, fraction, 0.65]
- [mavlink, NAMED_VALUE_FLOAT, value, 65.0, humidity, percent, 0.65]
- [mavlink, NAMED_VALUE_FLOAT, value, 60.0, airspeed, m/s, 60.0]
# The unit of the format: to state it changes nothing.
- [dataflash, BARO, Press, 81250.0, pressure, Pa, 81250.0]
- [dataflash, HYGR, Humidity, 65.0, humidity, percent, 0.65]
- [dataflash, HYGR, Temp, 12.5, temperature, degC, 285.65]
- [dataflash, ARSP, Airspeed, 61.0, airspeed, m/s, 61.0]
- [mavlink, SCALED_PRESSURE, press_abs, 812.5, pressure, hPa, 81250.0]
- [mavlink, HIGHRES_IMU, abs_pressure, 812.5, cabin_pressure, hPa, 81250.0]
- [mavlink, HYGROMETER_SENSOR, humidity, 6500, humidity, percent, 0.65]
- [mavlink, HYGROMETER_SENSOR, temperature, 1250, cabin_temperature, degC, 285.65]
- [px4, SensorBaro, pressure, 81250.0, pressure, Pa, 81250.0]
- [px4, SensorHygrometer, humidity, 65.0, humidity, percent, 0.65]
# A driver fills the field with numbers of another unit than the format defines.
- [mavlink, SCALED_PRESSURE, press_abs, 81.25, pressure, kPa, 81250.0]
- [mavlink, HYGROMETER_SENSOR, temperature, 28565, temperature, K, 285.65]
- [dataflash, BARO, Press, 812.5, pressure, hPa, 81250.0]
- [dataflash, HYGR, Humidity, 0.65, humidity, fraction, 0.65]
- [px4, SensorHygrometer, humidity, 0.65, humidity, fraction, 0.65]
""")


@pytest.mark.parametrize(("form", "message", "field", "value", "role", "unit", "si"), UNITS)
def test_a_value_is_converted_from_the_stated_unit(form, message, field, value, role, unit, si):
    channel = logged(form, message, field, value)
    assert stated(channel, role, unit) == pytest.approx(si, rel=1e-14)


def test_a_unit_of_another_quantity_is_refused():
    named = logged("mavlink", "NAMED_VALUE_FLOAT", "value", 5.0)
    with refused("CHANNEL-UNIT", says="degC"):
        in_stated_unit(named, "pressure", "degC")
