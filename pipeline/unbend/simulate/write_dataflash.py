"""The flight as an ArduPilot DataFlash log, packed row by row as the FMT rows announce it."""

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

Row = tuple[int, bytes]

_MAGIC = b"\xa3\x95"
# Characters of a format string: how a value is packed, and the scale of fixed-point ones.
_PACK = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q", "f": "f",
    "d": "d", "n": "4s", "N": "16s", "Z": "64s", "M": "B",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i",
}  # fmt: skip
_SCALE = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}


@dataclass(frozen=True)
class _Format:
    """One FMT row with its units and multipliers."""

    type_id: int
    name: str
    format: str
    columns: str
    units: str
    multipliers: str

    @cached_property
    def struct(self) -> struct.Struct:
        return struct.Struct("<" + "".join(_PACK[c] for c in self.format))

    def pack(self, *values: float | int | bytes) -> bytes:
        """One record; fixed-point columns are rounded to their last digit."""
        body = [
            round(v * _SCALE[c]) if c in _SCALE and not isinstance(v, bytes) else v
            for c, v in zip(self.format, values, strict=True)
        ]
        return _MAGIC + bytes([self.type_id]) + self.struct.pack(*body)

    def rows(self, time_us: Integers, *columns: ArrayLike) -> list[Row]:
        """A record for each of (n,) times; columns are (n,), or one value for all."""
        return [(row[0], self.pack(*row)) for row in sensors.rows_of(time_us, *columns)]


_DATA = files("unbend.simulate").joinpath("data/dataflash.toml")
_ANNOUNCED = tomllib.loads(_DATA.read_text("utf-8"))
FORMATS = {k: _Format(v[0], k, *v[1:]) for k, v in _ANNOUNCED["formats"].items()}
_SHUTTER_LAG_US = 85_000


def write_dataflash(path: Path, samples: sensors.LoggedSamples) -> int:
    """Write the log; returns the number of messages, announcements included."""
    # FMT, UNIT, MULT, FMTU, PARM, VER and MSG stand at the start of every log.
    begin = sensors.LOG_BEGINS_BOOT_US - 500_000
    fmt, fmtu = FORMATS["FMT"], FORMATS["FMTU"]
    unit, scale, parameter = FORMATS["UNIT"], FORMATS["MULT"], FORMATS["PARM"]
    head = [
        fmt.pack(f.type_id, f.struct.size + 3, f.name.encode(), f.format.encode(),
                 f.columns.encode())
        for f in FORMATS.values()
    ]  # fmt: skip
    head += [unit.pack(begin, ord(k), v.encode()) for k, v in _ANNOUNCED["units"].items()]
    head += [scale.pack(begin, ord(k), v) for k, v in _ANNOUNCED["multipliers"].items()]
    head += [
        fmtu.pack(begin, f.type_id, f.units.encode(), f.multipliers.encode())
        for f in FORMATS.values()
    ]
    head += [parameter.pack(begin, k.encode(), v, v) for k, v in _ANNOUNCED["parameters"].items()]
    firmware = b"ArduPlane V4.7.0-dev (simulated by unbend)"
    head.append(FORMATS["VER"].pack(begin, 3, 65535, 4, 7, 0, 0, 0, firmware, 0, 3, 2))
    head.append(FORMATS["MSG"].pack(begin, firmware))
    rows = [*_position_rows(samples), *_air_rows(samples), *_camera_rows(samples)]
    rows.sort(key=lambda row: row[0])
    path.write_bytes(b"".join([*head, *(record for _, record in rows)]))
    return len(head) + len(rows)


def _position_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """GPS and GPA of the receiver; ATT and POS at 10 Hz, half the rate of the autopilot."""
    g, nav = samples.gnss, samples.navigation.rows(slice(None, None, 2))
    week, ms = sensors.gps_week_ms(g.time_s)
    written, taken_ms = sensors.boot_us(g.time_s + g.log_delay_s), sensors.boot_us(g.time_s) // 1000
    lat, lon, course = np.degrees([g.lat_rad, g.lon_rad, g.course_rad])
    rows = FORMATS["GPS"].rows(
        written, 0, 6, ms, week, 18, 0.71, lat, lon, g.h_msl_m, g.speed_m_s, course % 360.0,
        -g.climb_m_s, 0.0, 1,
    )  # fmt: skip
    rows += FORMATS["GPA"].rows(
        written, 0, 1.1, sensors.GNSS_HORIZONTAL_M, sensors.GNSS_VERTICAL_M, 0.05, 0.0, 1, taken_ms,
        200, g.h_ellipsoid_m, 0, 0,
    )  # fmt: skip
    lat, lon, roll, pitch, yaw = _degrees(nav)
    times, above = sensors.boot_us(nav.time_s), nav.h_msl_m - FIELD_HEIGHT_M
    rows += FORMATS["ATT"].rows(times, roll, roll, pitch, pitch, yaw, yaw, 0.0, 0.0, 3)
    return rows + FORMATS["POS"].rows(times, lat, lon, nav.h_msl_m, above, above)


def _degrees(at: State) -> tuple[Array, ...]:
    """Latitude, longitude, roll, pitch; yaw in [0, 360) after rounding to the last digit."""
    angles = [at.lat_rad, at.lon_rad, at.roll_rad, at.pitch_rad, at.yaw_rad]
    lat, lon, roll, pitch, yaw = np.degrees(angles)
    return lat, lon, roll, pitch, np.round(yaw % 360.0, 2) % 360.0


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """BARO and HYGR of both boxes, ARSP of a pitot with the outside thermometer in it."""
    rows: list[Row] = []
    for instance, box in enumerate((samples.outside, samples.cabin)):
        board, celsius = box.board_k - ZERO_CELSIUS_K, box.temperature_k - ZERO_CELSIUS_K
        # ArduPilot's Alt is a height in the standard atmosphere against the pressure at boot.
        height = 44_330.8 * (1.0 - (box.pressure_pa / 101_325.0) ** 0.190263)
        above, times = height - height[0], sensors.boot_us(box.pressure_time_s)
        rows += FORMATS["BARO"].rows(
            times, instance, above, above + FIELD_HEIGHT_M, box.pressure_pa, board, 0.0,
            times // 1000, 0.0, board[0], 1,
        )  # fmt: skip
        humidity = 100.0 * box.humidity
        rows += FORMATS["HYGR"].rows(sensors.boot_us(box.time_s), instance, humidity, celsius)
    box, nav = samples.outside, samples.navigation
    speed = np.interp(box.time_s, nav.time_s, nav.speed_m_s)
    pressure = np.interp(box.time_s, box.pressure_time_s, box.pressure_pa)
    dynamic = 0.5 * pressure / (287.05 * box.temperature_k) * speed**2
    indicated, celsius = np.sqrt(2.0 * dynamic / 1.225), box.temperature_k - ZERO_CELSIUS_K
    return rows + FORMATS["ARSP"].rows(
        sensors.boot_us(box.time_s), 0, indicated, dynamic, celsius, dynamic, 0.0, 1, 1, 1.0, 0.0, 0
    )


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """TRIG at the command and CAM at the shutter, one of each for every camera."""
    gnss, shutter, rows = samples.gnss, sensors.boot_us(samples.exposure_s), list[Row]()
    for message, times_us in (("TRIG", shutter - _SHUTTER_LAG_US), ("CAM", shutter)):
        at = np.asarray((times_us - sensors.LOG_BEGINS_BOOT_US) * 1e-6, np.float64)
        shot = samples.navigation.between(at)
        lat, lon, roll, pitch, yaw = _degrees(shot)
        last_fix = np.searchsorted(gnss.time_s + gnss.log_delay_s, at, side="right") - 1
        week, ms = sensors.gps_week_ms(gnss.time_s[last_fix])
        for instance in range(len(samples.camera_names)):
            rows += FORMATS[message].rows(
                times_us, instance, np.arange(at.size) + 1, ms, week, lat, lon, shot.h_msl_m,
                shot.h_msl_m - FIELD_HEIGHT_M, gnss.h_msl_m[last_fix], roll, pitch, yaw,
            )  # fmt: skip
    return rows
