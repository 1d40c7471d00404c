"""The flight as the telemetry log of a ground station: MAVLink 2 frames with the host's stamps."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from unbend.simulate import sensors
from unbend.simulate.true_air import FIELD_HEIGHT_M
from unbend.units import ZERO_CELSIUS_K, Array, Integers

HOST_AHEAD_S = 1.26
HOST_JITTER_S = 0.05

# When a message is sent [boot us], and the message.
Row = tuple[int, Any]


def write_tlog(path: Path, samples: sensors.LoggedSamples, seed: int) -> int:
    """Write the log; returns the number of frames.

    The host's clock is 1.26 s ahead and stamps a frame up to 50 ms late, in the order in which
    frames arrive.
    """
    # HEARTBEAT and SYSTEM_TIME at 1 Hz.
    times = np.arange(0.25, samples.navigation.time_s[-1], 1.0)
    sent = sensors.boot_us(times)
    rows = _messages(
        mavlink.MAVLink_heartbeat_message, sent, mavlink.MAV_TYPE_FIXED_WING,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 10,
        mavlink.MAV_STATE_ACTIVE, 3,
    )  # fmt: skip
    unix_us = sensors.unix_ns(times) // 1000
    rows += _messages(mavlink.MAVLink_system_time_message, sent, unix_us, sent // 1000)
    rows += [*_position_rows(samples), *_air_rows(samples), *_camera_rows(samples)]
    rows.sort(key=lambda row: row[0])
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    late = np.random.default_rng([seed, 2]).uniform(0.0, HOST_JITTER_S, len(rows))
    since = np.array([row[0] for row in rows]) - sensors.LOG_BEGINS_BOOT_US
    stamp = since + np.rint((HOST_AHEAD_S + late) * 1e6).astype(np.int64)
    stamp = np.maximum.accumulate(stamp) + sensors.LOG_BEGINS_UNIX_NS // 1000
    out = bytearray()
    for (_, message), microseconds in zip(rows, stamp.tolist(), strict=True):
        # The two lowest bits of a stamp carry MAVProxy's link number; this is link 0.
        out += struct.pack(">Q", microseconds & ~3) + message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
    path.write_bytes(out)
    return len(rows)


def _messages(kind: Callable[..., Any], sent: Integers, *columns: ArrayLike) -> list[Row]:
    return [(time, kind(*row)) for time, *row in sensors.rows_of(sent, *columns)]


def _whole(values: Array) -> Integers:
    return np.rint(values).astype(np.int64)


def _position_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """GPS_RAW_INT at 5 Hz, its time_usec since boot, as ArduPilot fills it; ATTITUDE at 10 Hz,
    GLOBAL_POSITION_INT at 5 Hz, VFR_HUD at 1 Hz."""
    g, nav = samples.gnss, samples.navigation
    rows = _messages(
        mavlink.MAVLink_gps_raw_int_message, sensors.boot_us(g.time_s + g.log_delay_s),
        sensors.boot_us(g.time_s), 6, _whole(np.degrees(g.lat_rad) * 1e7),
        _whole(np.degrees(g.lon_rad) * 1e7), _whole(g.h_msl_m * 1e3), 71, 110,
        _whole(g.speed_m_s * 100.0), _whole(np.degrees(g.course_rad) % 360.0 * 100.0) % 36_000, 18,
        _whole(g.h_ellipsoid_m * 1e3), round(sensors.GNSS_HORIZONTAL_M * 1e3),
        round(sensors.GNSS_VERTICAL_M * 1e3), 50,
    )  # fmt: skip
    angles = nav.roll_rad, nav.pitch_rad, np.remainder(nav.yaw_rad + np.pi, 2.0 * np.pi) - np.pi
    rates = [np.gradient(a, nav.time_s) for a in (nav.roll_rad, nav.pitch_rad, nav.yaw_rad)]
    often = [values[::2] for values in (*angles, *rates)]
    times = sensors.boot_us(nav.time_s)
    rows += _messages(mavlink.MAVLink_attitude_message, times[::2], times[::2] // 1000, *often)
    at, times = nav.rows(slice(None, None, 4)), times[::4]
    heading, speed = np.degrees(at.yaw_rad) % 360.0, 100.0 * at.speed_m_s
    rows += _messages(
        mavlink.MAVLink_global_position_int_message, times, times // 1000,
        _whole(np.degrees(at.lat_rad) * 1e7), _whole(np.degrees(at.lon_rad) * 1e7),
        _whole(at.h_msl_m * 1e3), _whole((at.h_msl_m - FIELD_HEIGHT_M) * 1e3),
        _whole(speed * np.cos(at.yaw_rad)), _whole(speed * np.sin(at.yaw_rad)),
        _whole(-at.climb_m_s * 100.0), _whole(heading * 100.0) % 36_000,
    )  # fmt: skip
    at, whole_deg = nav.rows(slice(None, None, 20)), _whole(heading[::5]) % 360
    return rows + _messages(
        mavlink.MAVLink_vfr_hud_message, times[::5], at.speed_m_s, at.speed_m_s, whole_deg, 60,
        at.h_msl_m, at.climb_m_s,
    )  # fmt: skip


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """SCALED_PRESSURE (outside), SCALED_PRESSURE2 (cabin) at 5 Hz; HYGROMETER_SENSOR at 2.5 Hz."""
    rows: list[Row] = []
    messages = (mavlink.MAVLink_scaled_pressure_message, mavlink.MAVLink_scaled_pressure2_message)
    for instance, box in enumerate((samples.outside, samples.cabin)):
        times = sensors.boot_us(box.pressure_time_s)[::2]
        board = _whole(100.0 * (box.board_k - ZERO_CELSIUS_K))[::2]
        pressure = box.pressure_pa[::2] / 100.0
        rows += _messages(messages[instance], times, times // 1000, pressure, 0.0, board)
        celsius, percent = 100.0 * (box.temperature_k - ZERO_CELSIUS_K), 1e4 * box.humidity
        times, message = sensors.boot_us(box.time_s), mavlink.MAVLink_hygrometer_sensor_message
        rows += _messages(message, times, instance, _whole(celsius), _whole(percent))
    return rows


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """CAMERA_FEEDBACK of every exposure and camera; time_usec since boot (feedback pin)."""
    at, rows = samples.exposure_s, list[Row]()
    shot, shutter = samples.navigation.between(at), sensors.boot_us(at)
    roll, pitch, yaw = np.degrees([shot.roll_rad, shot.pitch_rad, shot.yaw_rad])
    number = np.arange(shutter.size) + 1
    for instance in range(len(samples.camera_names)):
        rows += _messages(
            mavlink.MAVLink_camera_feedback_message, shutter + 20_000 + 1000 * instance, shutter, 1,
            instance, number, _whole(np.degrees(shot.lat_rad) * 1e7),
            _whole(np.degrees(shot.lon_rad) * 1e7), shot.h_msl_m, shot.h_msl_m - FIELD_HEIGHT_M,
            roll, pitch, yaw % 360.0, 0.0, mavlink.CAMERA_FEEDBACK_PHOTO, number,
        )  # fmt: skip
    return rows
