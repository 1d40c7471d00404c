"""Writes the flight as an ArduPilot DataFlash log; FMT records define how rows are packed."""

import struct
import tomllib
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from unbend.simulate import sensors
from unbend.simulate.flight import State
from unbend.simulate.true_air import FIELD_HEIGHT_M
from unbend.units import ZERO_CELSIUS_K, Array, Integers

Row = tuple[int, bytes]  # time since boot [us] (rows are sorted by it), and the record

_MAGIC = b"\xa3\x95"
# By character of a format string: how `struct` packs a value, and the scale of fixed-point ones.
_PACK = {
    "b": "b",
    "B": "B",
    "h": "h",
    "H": "H",
    "i": "i",
    "I": "I",
    "q": "q",
    "Q": "Q",
    "f": "f",
    "d": "d",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "M": "B",
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
}
_SCALE = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}


@dataclass(frozen=True)
class _Format:
    """The definition of a message: its FMT record, and units and multipliers of its columns."""

    type_id: int
    name: str
    format: str
    columns: str
    units: str
    multipliers: str

    @cached_property
    def struct(self) -> struct.Struct:
        """The layout of the columns of a record, without its header."""
        return struct.Struct("<" + "".join(_PACK[character] for character in self.format))

    @property
    def record_bytes(self) -> int:
        """Length of a record, with the three bytes before its columns."""
        return self.struct.size + 3

    def pack(self, *values: float | int | bytes) -> bytes:
        """One record; fixed-point columns are rounded to their last digit."""
        packed: list[float | int | bytes] = []
        for character, value in zip(self.format, values, strict=True):
            if character in _SCALE and not isinstance(value, bytes):
                packed.append(round(value * _SCALE[character]))
            else:
                packed.append(value)
        return _MAGIC + bytes([self.type_id]) + self.struct.pack(*packed)

    def rows(self, time_us: Integers, **columns: ArrayLike) -> list[Row]:
        """A record for each of (n,) times; each column is (n,) or one value for all records.

        Raises TypeError for a column that the message does not have.
        """
        _, *names = self.columns.split(",")  # the first is TimeUS
        values = [columns.pop(name) for name in names]
        if columns:
            raise TypeError(f"{self.name} has no {', '.join(columns)}")
        return [(row[0], self.pack(*row)) for row in sensors.rows_of(time_us, *values)]


_DATA = files("unbend.simulate").joinpath("data/dataflash.toml")
_ANNOUNCED = tomllib.loads(_DATA.read_text("utf-8"))
FORMATS: dict[str, _Format] = {}
for _name, (_type_id, *_texts) in _ANNOUNCED["formats"].items():
    FORMATS[_name] = _Format(_type_id, _name, *_texts)

HEAD_BEFORE_US = 500_000  # how long before the samples the definitions and parameters are logged
SHUTTER_LAG_US = 85_000  # from the command to the shutter
SEA_LEVEL_PA = 101_325.0
DRY_AIR_J_KG_K = 287.05
STANDARD_DENSITY_KG_M3 = 1.225  # assumed for airspeed from dynamic pressure


def write_dataflash(path: Path, samples: sensors.LoggedSamples) -> int:
    """Write the log; returns the number of its messages, definitions included."""
    head = _announcements()
    rows = [*_position_rows(samples), *_air_rows(samples), *_camera_rows(samples)]
    rows.sort(key=lambda row: row[0])
    records = [record for _, record in rows]
    path.write_bytes(b"".join([*head, *records]))
    return len(head) + len(rows)


def _announcements() -> list[bytes]:
    """The records at the start of each log: FMT, UNIT, MULT, FMTU, PARM, VER and MSG."""
    begin_us = sensors.LOG_BEGINS_BOOT_US - HEAD_BEFORE_US
    head = []
    for form in FORMATS.values():
        texts = (form.name.encode(), form.format.encode(), form.columns.encode())
        head.append(FORMATS["FMT"].pack(form.type_id, form.record_bytes, *texts))
    for character, unit in _ANNOUNCED["units"].items():
        head.append(FORMATS["UNIT"].pack(begin_us, ord(character), unit.encode()))
    for character, multiplier in _ANNOUNCED["multipliers"].items():
        head.append(FORMATS["MULT"].pack(begin_us, ord(character), multiplier))
    for form in FORMATS.values():
        units = form.units.encode()
        multipliers = form.multipliers.encode()
        head.append(FORMATS["FMTU"].pack(begin_us, form.type_id, units, multipliers))
    for name, value in _ANNOUNCED["parameters"].items():
        head.append(FORMATS["PARM"].pack(begin_us, name.encode(), value, value))
    firmware = b"ArduPlane V4.7.0-dev (simulated by unbend)"
    board = (3, 65535)
    version = (4, 7, 0, 0)
    build = (0, firmware, 0, 3, 2)
    head.append(FORMATS["VER"].pack(begin_us, *board, *version, *build))
    head.append(FORMATS["MSG"].pack(begin_us, firmware))
    return head


def _position_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """Rows GPS and GPA of the receiver; ATT and POS of every second navigation sample (10 Hz)."""
    gnss = samples.gnss
    measured_us = sensors.boot_us(gnss.time_s)
    written_us = sensors.boot_us(gnss.time_s + gnss.log_delay_s)
    week, ms_of_week = sensors.gps_week_ms(gnss.time_s)
    rows = FORMATS["GPS"].rows(
        written_us,
        I=0,
        Status=6,
        GMS=ms_of_week,
        GWk=week,
        NSats=18,
        HDop=0.71,
        Lat=np.degrees(gnss.lat_rad),
        Lng=np.degrees(gnss.lon_rad),
        Alt=gnss.h_msl_m,
        Spd=gnss.speed_m_s,
        GCrs=np.degrees(gnss.course_rad) % 360.0,
        VZ=-gnss.climb_m_s,
        Yaw=0.0,
        U=1,
    )
    rows += FORMATS["GPA"].rows(
        written_us,
        I=0,
        VDop=1.1,
        HAcc=sensors.GNSS_HORIZONTAL_M,
        VAcc=sensors.GNSS_VERTICAL_M,
        SAcc=0.05,
        YAcc=0.0,
        VV=1,
        SMS=measured_us // 1000,
        Delta=200,
        AEl=gnss.h_ellipsoid_m,
        RTCMFU=0,
        RTCMFD=0,
    )
    nav = samples.navigation.rows(slice(None, None, 2))
    nav_us = sensors.boot_us(nav.time_s)
    angles = _degrees(nav)
    rows += FORMATS["ATT"].rows(
        nav_us,
        DesRoll=angles.roll,
        Roll=angles.roll,
        DesPitch=angles.pitch,
        Pitch=angles.pitch,
        DesYaw=angles.yaw,
        Yaw=angles.yaw,
        ErrRP=0.0,
        ErrYaw=0.0,
        AEKF=3,
    )
    above_field = nav.h_msl_m - FIELD_HEIGHT_M
    rows += FORMATS["POS"].rows(
        nav_us,
        Lat=angles.lat,
        Lng=angles.lon,
        Alt=nav.h_msl_m,
        RelHomeAlt=above_field,
        RelOriginAlt=above_field,
    )
    return rows


@dataclass(frozen=True, eq=False)
class _Degrees:
    """Place and attitude (n,) [deg]; yaw in [0, 360) after rounding to the last digit."""

    lat: Array
    lon: Array
    roll: Array
    pitch: Array
    yaw: Array


def _degrees(state: State) -> _Degrees:
    """Place and attitude of states, in degrees."""
    yaw = np.degrees(state.yaw_rad)
    return _Degrees(
        lat=np.degrees(state.lat_rad),
        lon=np.degrees(state.lon_rad),
        roll=np.degrees(state.roll_rad),
        pitch=np.degrees(state.pitch_rad),
        yaw=np.round(yaw % 360.0, 2) % 360.0,
    )


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """Rows BARO and HYGR of the boxes outside (instance 0) and in the cabin (1), and ARSP."""
    rows: list[Row] = []
    for instance, box in enumerate((samples.outside, samples.cabin)):
        rows += _barometer_rows(instance, box)
        rows += FORMATS["HYGR"].rows(
            sensors.boot_us(box.time_s),
            Id=instance,
            Humidity=100.0 * box.humidity,
            Temp=box.temperature_k - ZERO_CELSIUS_K,
        )
    return rows + _pitot_rows(samples.outside, samples.navigation)


def _barometer_rows(instance: int, box: sensors.BoxSamples) -> list[Row]:
    """Rows BARO: Alt is as in ArduPilot, the height above boot in the standard atmosphere."""
    time_us = sensors.boot_us(box.pressure_time_s)
    height = 44_330.8 * (1.0 - (box.pressure_pa / SEA_LEVEL_PA) ** 0.190263)
    above_boot = height - height[0]
    board_celsius = box.board_k - ZERO_CELSIUS_K
    return FORMATS["BARO"].rows(
        time_us,
        I=instance,
        Alt=above_boot,
        AltAMSL=above_boot + FIELD_HEIGHT_M,
        Press=box.pressure_pa,
        Temp=board_celsius,
        CRt=0.0,
        SMS=time_us // 1000,
        Offset=0.0,
        GndTemp=board_celsius[0],
        Health=1,
    )


def _pitot_rows(box: sensors.BoxSamples, navigation: State) -> list[Row]:
    """Rows ARSP: the dynamic pressure of the ground speed (no wind) in the measured air."""
    speed = np.interp(box.time_s, navigation.time_s, navigation.speed_m_s)
    pressure = np.interp(box.time_s, box.pressure_time_s, box.pressure_pa)
    dynamic_pressure = 0.5 * pressure / (DRY_AIR_J_KG_K * box.temperature_k) * speed**2
    return FORMATS["ARSP"].rows(
        sensors.boot_us(box.time_s),
        I=0,
        Airspeed=np.sqrt(2.0 * dynamic_pressure / STANDARD_DENSITY_KG_M3),
        DiffPress=dynamic_pressure,
        Temp=box.temperature_k - ZERO_CELSIUS_K,
        RawPress=dynamic_pressure,
        Offset=0.0,
        U=1,
        H=1,
        Hp=1.0,
        TR=0.0,
        Pri=0,
    )


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """Rows TRIG at the command and CAM at the shutter, one of each for an exposure and camera."""
    shutter_us = sensors.boot_us(samples.exposure_s)
    rows = _exposure_rows("TRIG", samples, shutter_us - SHUTTER_LAG_US)
    return rows + _exposure_rows("CAM", samples, shutter_us)


def _exposure_rows(message: str, samples: sensors.LoggedSamples, time_us: Integers) -> list[Row]:
    """A row for each exposure and camera, with the state at its time and the last fix before it."""
    time_s = np.asarray((time_us - sensors.LOG_BEGINS_BOOT_US) * 1e-6, np.float64)
    gnss = samples.gnss
    written_s = gnss.time_s + gnss.log_delay_s
    last_fix = np.searchsorted(written_s, time_s, side="right") - 1
    week, ms_of_week = sensors.gps_week_ms(gnss.time_s[last_fix])
    shot = samples.navigation.between(time_s)
    angles = _degrees(shot)
    rows: list[Row] = []
    for instance in range(len(samples.camera_names)):
        rows += FORMATS[message].rows(
            time_us,
            I=instance,
            Img=np.arange(time_s.size) + 1,
            GPSTime=ms_of_week,
            GPSWeek=week,
            Lat=angles.lat,
            Lng=angles.lon,
            Alt=shot.h_msl_m,
            RelAlt=shot.h_msl_m - FIELD_HEIGHT_M,
            GPSAlt=gnss.h_msl_m[last_fix],
            R=angles.roll,
            P=angles.pitch,
            Y=angles.yaw,
        )
    return rows
