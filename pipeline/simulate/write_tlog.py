"""The flight as the telemetry log of a ground station: MAVLink 2 frames with the host's stamps."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from pipeline.simulate import sensors
from pipeline.simulate.true_air import FIELD_HEIGHT_M
from pipeline.units import ZERO_CELSIUS_K

HOST_AHEAD_S = 1.26
HOST_JITTER_S = 0.05

# When a message is sent [boot us], and the message.
Row = tuple[int, Any]


def write_tlog(path: Path, samples: sensors.LoggedSamples, seed: int) -> int:
    """Write the log; returns the number of frames.

    The host's clock is 1.26 s ahead and stamps a frame up to 50 ms late, in the order in which
    frames arrive.
    """
    rows: list[Row] = []
    # HEARTBEAT and SYSTEM_TIME at 1 Hz.
    times = np.arange(0.25, samples.navigation.time_s[-1], 1.0)
    unix_us = sensors.unix_ns(times) // 1000
    for i, sent in enumerate(sensors.boot_us(times).tolist()):
        rows.append((sent, mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 10, mavlink.MAV_STATE_ACTIVE, 3,
        )))  # fmt: skip
        rows.append((sent, mavlink.MAVLink_system_time_message(int(unix_us[i]), sent // 1000)))
    rows += [*_position_rows(samples), *_air_rows(samples), *_camera_rows(samples)]
    rows.sort(key=lambda row: row[0])
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    late = np.random.default_rng([seed, 2]).uniform(0.0, HOST_JITTER_S, len(rows))
    sent = np.array([row[0] for row in rows]) - sensors.LOG_BEGINS_BOOT_US
    stamp = sent + np.rint((HOST_AHEAD_S + late) * 1e6).astype(np.int64)
    stamp = np.maximum.accumulate(stamp) + sensors.LOG_BEGINS_UNIX_NS // 1000
    out = bytearray()
    for (_, message), microseconds in zip(rows, stamp.tolist(), strict=True):
        # The two lowest bits of a stamp carry MAVProxy's link number; this is link 0.
        out += struct.pack(">Q", microseconds & ~3) + message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
    path.write_bytes(out)
    return len(rows)


def _degrees_e7(radians: NDArray[np.float64]) -> list[int]:
    return [round(v) for v in (np.degrees(radians) * 1e7).tolist()]


def _position_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """GPS_RAW_INT at 5 Hz, its time_usec since boot, as ArduPilot fills it; ATTITUDE at 10 Hz,
    GLOBAL_POSITION_INT at 5 Hz, VFR_HUD at 1 Hz."""
    g = samples.gnss
    taken = sensors.boot_us(g.time_s)
    sent = sensors.boot_us(g.time_s + g.log_delay_s)
    lat, lon = _degrees_e7(g.lat_rad), _degrees_e7(g.lon_rad)
    course = np.degrees(g.course_rad) % 360.0
    rows: list[Row] = [
        (int(sent[i]), mavlink.MAVLink_gps_raw_int_message(
            int(taken[i]), 6, lat[i], lon[i], round(g.h_msl_m[i] * 1e3), 71, 110,
            round(g.speed_m_s[i] * 100.0), round(course[i] * 100.0) % 36_000, 18,
            round(g.h_ellipsoid_m[i] * 1e3), round(sensors.GNSS_HORIZONTAL_M * 1e3),
            round(sensors.GNSS_VERTICAL_M * 1e3), 50,
        ))
        for i in range(len(sent))
    ]  # fmt: skip
    nav = samples.navigation
    times = sensors.boot_us(nav.time_s)
    lat, lon = _degrees_e7(nav.lat_rad), _degrees_e7(nav.lon_rad)
    yaw = np.remainder(nav.yaw_rad + np.pi, 2.0 * np.pi) - np.pi
    heading = np.degrees(nav.yaw_rad) % 360.0
    rates = [np.gradient(a, nav.time_s) for a in (nav.roll_rad, nav.pitch_rad, nav.yaw_rad)]
    north = np.rint(100.0 * nav.speed_m_s * np.cos(nav.yaw_rad)).astype(int).tolist()
    east = np.rint(100.0 * nav.speed_m_s * np.sin(nav.yaw_rad)).astype(int).tolist()
    for i in range(0, len(times), 2):
        time = int(times[i])
        rows.append((time, mavlink.MAVLink_attitude_message(
            time // 1000, nav.roll_rad[i], nav.pitch_rad[i], yaw[i],
            rates[0][i], rates[1][i], rates[2][i],
        )))  # fmt: skip
        if i % 4:
            continue
        height = nav.h_msl_m[i]
        rows.append((time, mavlink.MAVLink_global_position_int_message(
            time // 1000, lat[i], lon[i], round(height * 1e3),
            round((height - FIELD_HEIGHT_M) * 1e3), north[i], east[i],
            round(-nav.climb_m_s[i] * 100.0), round(heading[i] * 100.0) % 36_000,
        )))  # fmt: skip
        if i % 20 == 0:
            rows.append((time, mavlink.MAVLink_vfr_hud_message(
                nav.speed_m_s[i], nav.speed_m_s[i], round(heading[i]) % 360, 60, height,
                nav.climb_m_s[i],
            )))  # fmt: skip
    return rows


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """SCALED_PRESSURE (outside), SCALED_PRESSURE2 (cabin) at 5 Hz; HYGROMETER_SENSOR at 2.5 Hz."""
    rows: list[Row] = []
    messages = (mavlink.MAVLink_scaled_pressure_message, mavlink.MAVLink_scaled_pressure2_message)
    for instance, box in enumerate((samples.outside, samples.cabin)):
        times = sensors.boot_us(box.pressure_time_s)
        board = np.rint(100.0 * (box.board_k - ZERO_CELSIUS_K)).astype(int).tolist()
        for i in range(0, len(times), 2):
            sent = int(times[i])
            message = messages[instance](sent // 1000, box.pressure_pa[i] / 100.0, 0.0, board[i])
            rows.append((sent, message))
        celsius = np.rint(100.0 * (box.temperature_k - ZERO_CELSIUS_K)).astype(int).tolist()
        percent = np.rint(1e4 * box.humidity).astype(int).tolist()
        rows += [
            (sent, mavlink.MAVLink_hygrometer_sensor_message(instance, celsius[i], percent[i]))
            for i, sent in enumerate(sensors.boot_us(box.time_s).tolist())
        ]
    return rows


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """CAMERA_FEEDBACK of every exposure and camera; time_usec since boot (feedback pin)."""
    shot, at = samples.navigation.between(samples.exposure_s), samples.exposure_s
    lat, lon, height = _degrees_e7(shot.lat_rad), _degrees_e7(shot.lon_rad), shot.h_msl_m
    roll, pitch = np.degrees(shot.roll_rad), np.degrees(shot.pitch_rad)
    yaw = np.degrees(shot.yaw_rad) % 360.0
    rows: list[Row] = []
    for i, shutter in enumerate(sensors.boot_us(at).tolist()):
        for instance in range(len(samples.camera_names)):
            sent = shutter + 20_000 + 1000 * instance
            rows.append((sent, mavlink.MAVLink_camera_feedback_message(
                shutter, 1, instance, i + 1, lat[i], lon[i], height[i],
                height[i] - FIELD_HEIGHT_M, roll[i], pitch[i], yaw[i], 0.0,
                mavlink.CAMERA_FEEDBACK_PHOTO, i + 1,
            )))  # fmt: skip
    return rows
