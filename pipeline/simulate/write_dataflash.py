"""The flight as an ArduPilot DataFlash log, packed row by row as the FMT rows announce it."""

import struct
import tomllib
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import numpy as np

from pipeline.simulate import sensors
from pipeline.simulate.true_air import FIELD_HEIGHT_M
from pipeline.units import ZERO_CELSIUS_K, Array

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


_ANNOUNCED = tomllib.loads(
    files("pipeline.simulate").joinpath("data/dataflash.toml").read_text("utf-8")
)
FORMATS = {
    name: _Format(number, name, *texts) for name, (number, *texts) in _ANNOUNCED["formats"].items()
}
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
    g, nav = samples.gnss, samples.navigation
    week, ms = sensors.gps_week_ms(g.time_s)
    written = sensors.boot_us(g.time_s + g.log_delay_s)
    taken_ms = sensors.boot_us(g.time_s) // 1000
    lat, lon = np.degrees(g.lat_rad), np.degrees(g.lon_rad)
    course = np.degrees(g.course_rad) % 360.0
    rows: list[Row] = []
    for i, time in enumerate(written.tolist()):
        rows.append((time, FORMATS["GPS"].pack(
            time, 0, 6, int(ms[i]), int(week[i]), 18, 0.71, lat[i], lon[i], g.h_msl_m[i],
            g.speed_m_s[i], course[i], -g.climb_m_s[i], 0.0, 1,
        )))  # fmt: skip
        rows.append((time, FORMATS["GPA"].pack(
            time, 0, 1.1, sensors.GNSS_HORIZONTAL_M, sensors.GNSS_VERTICAL_M, 0.05, 0.0, 1,
            int(taken_ms[i]), 200, g.h_ellipsoid_m[i], 0, 0,
        )))  # fmt: skip
    times = sensors.boot_us(nav.time_s)
    lat, lon = np.degrees(nav.lat_rad), np.degrees(nav.lon_rad)
    roll, pitch = np.degrees(nav.roll_rad), np.degrees(nav.pitch_rad)
    yaw = _centidegrees(np.degrees(nav.yaw_rad))
    for i in range(0, len(times), 2):
        time = int(times[i])
        rows.append((time, FORMATS["ATT"].pack(
            time, roll[i], roll[i], pitch[i], pitch[i], yaw[i], yaw[i], 0.0, 0.0, 3
        )))  # fmt: skip
        above = nav.h_msl_m[i] - FIELD_HEIGHT_M
        rows.append((time, FORMATS["POS"].pack(
            time, lat[i], lon[i], nav.h_msl_m[i], above, above
        )))  # fmt: skip
    return rows


def _centidegrees(degrees: Array) -> Array:
    """Headings (n,) in [0, 360) after rounding to the column's last digit."""
    return np.asarray(np.round(degrees % 360.0, 2) % 360.0)


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """BARO and HYGR of both boxes, ARSP of a pitot with the outside thermometer in it."""
    rows: list[Row] = []
    for instance, box in enumerate((samples.outside, samples.cabin)):
        board = box.board_k - ZERO_CELSIUS_K
        # ArduPilot's Alt is a height in the standard atmosphere against the pressure at boot.
        height = 44_330.8 * (1.0 - (box.pressure_pa / 101_325.0) ** 0.190263)
        above = height - height[0]
        for i, time in enumerate(sensors.boot_us(box.pressure_time_s).tolist()):
            rows.append((time, FORMATS["BARO"].pack(
                time, instance, above[i], above[i] + FIELD_HEIGHT_M, box.pressure_pa[i], board[i],
                0.0, time // 1000, 0.0, board[0], 1,
            )))  # fmt: skip
        celsius = box.temperature_k - ZERO_CELSIUS_K
        for i, time in enumerate(sensors.boot_us(box.time_s).tolist()):
            rows.append((time, FORMATS["HYGR"].pack(
                time, instance, 100.0 * box.humidity[i], celsius[i]
            )))  # fmt: skip
    box, nav = samples.outside, samples.navigation
    speed = np.interp(box.time_s, nav.time_s, nav.speed_m_s)
    pressure = np.interp(box.time_s, box.pressure_time_s, box.pressure_pa)
    dynamic = 0.5 * pressure / (287.05 * box.temperature_k) * speed**2
    indicated = np.sqrt(2.0 * dynamic / 1.225)
    celsius = box.temperature_k - ZERO_CELSIUS_K
    for i, time in enumerate(sensors.boot_us(box.time_s).tolist()):
        rows.append((time, FORMATS["ARSP"].pack(
            time, 0, indicated[i], dynamic[i], celsius[i], dynamic[i], 0.0, 1, 1, 1.0, 0.0, 0
        )))  # fmt: skip
    return rows


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """TRIG at the command and CAM at the shutter, one of each for every camera."""
    nav, gnss = samples.navigation, samples.gnss
    shutter = sensors.boot_us(samples.exposure_s)
    rows: list[Row] = []
    for message, times_us in (("TRIG", shutter - _SHUTTER_LAG_US), ("CAM", shutter)):
        at = (times_us - sensors.LOG_BEGINS_BOOT_US) * 1e-6
        shot = nav.between(np.asarray(at, np.float64))
        lat, lon, alt = np.degrees(shot.lat_rad), np.degrees(shot.lon_rad), shot.h_msl_m
        roll, pitch = np.degrees(shot.roll_rad), np.degrees(shot.pitch_rad)
        yaw = _centidegrees(np.degrees(shot.yaw_rad))
        last_fix = np.searchsorted(gnss.time_s + gnss.log_delay_s, at, side="right") - 1
        week, ms = sensors.gps_week_ms(gnss.time_s[last_fix])
        for instance in range(len(samples.camera_names)):
            for i, time in enumerate(times_us.tolist()):
                rows.append((time, FORMATS[message].pack(
                    time, instance, i + 1, int(ms[i]), int(week[i]), lat[i], lon[i], alt[i],
                    alt[i] - FIELD_HEIGHT_M, gnss.h_msl_m[last_fix[i]], roll[i], pitch[i], yaw[i],
                )))  # fmt: skip
    return rows
