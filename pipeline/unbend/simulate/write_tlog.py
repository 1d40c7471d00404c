"""Writes the flight as the telemetry log of a ground station: MAVLink 2 frames with stamps."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pymavlink.dialects.v20.ardupilotmega import (
    CAMERA_FEEDBACK_PHOTO,
    MAV_AUTOPILOT_ARDUPILOTMEGA,
    MAV_MODE_FLAG_SAFETY_ARMED,
    MAV_STATE_ACTIVE,
    MAV_TYPE_FIXED_WING,
    MAVLink,
    MAVLink_attitude_message,
    MAVLink_camera_feedback_message,
    MAVLink_global_position_int_message,
    MAVLink_gps_raw_int_message,
    MAVLink_heartbeat_message,
    MAVLink_hygrometer_sensor_message,
    MAVLink_scaled_pressure2_message,
    MAVLink_scaled_pressure_message,
    MAVLink_system_time_message,
    MAVLink_vfr_hud_message,
)

from unbend.simulate import sensors
from unbend.simulate.flight import State
from unbend.simulate.true_air import FIELD_HEIGHT_M
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array, Integers

HOST_AHEAD_S = 1.26  # the clock of the ground station minus UTC
HOST_JITTER_S = 0.05  # the longest time from sending a frame to its stamp
FEEDBACK_US = 20_000  # from the shutter to the message of the first camera ...
FEEDBACK_STEP_US = 1000  # ... and between the messages of successive cameras
LINK_BITS = 3  # the two lowest bits of a stamp carry MAVProxy's link number; this is link 0

# When a message is sent [boot us], and the message.
Row = tuple[int, Any]


def write_tlog(path: Path, samples: sensors.LoggedSamples, seed: int) -> int:
    """Write the log; returns the number of frames.

    The ground station (host) stamps a frame up to 50 ms after it is sent, with a clock that is
    1.26 s ahead. Frames arrive in the order in which they are sent.
    """
    rows = [
        *_system_rows(samples),
        *_gnss_rows(samples.gnss),
        *_navigation_rows(samples.navigation),
        *_air_rows(samples),
        *_camera_rows(samples),
    ]
    rows.sort(key=lambda row: row[0])
    stamps_us = _stamps_us([sent_us for sent_us, _ in rows], seed)
    sender = MAVLink(None, srcSystem=1, srcComponent=1)
    out = bytearray()
    for (_, message), stamp_us in zip(rows, stamps_us.tolist(), strict=True):
        out += struct.pack(">Q", stamp_us & ~LINK_BITS) + message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
    path.write_bytes(out)
    return len(rows)


def _stamps_us(sent_us: list[int], seed: int) -> Integers:
    """(n,) the stamps of frames by the clock of the host [Unix us], never falling.

    ``sent_us``: (n,) times since boot [us] at which the frames are sent, in rising order.
    """
    late_s = np.random.default_rng([seed, 2]).uniform(0.0, HOST_JITTER_S, len(sent_us))
    off_us = np.rint((HOST_AHEAD_S + late_s) * 1e6).astype(np.int64)
    since_beginning_us = np.array(sent_us) - sensors.LOG_BEGINS_BOOT_US
    arrival_us = np.maximum.accumulate(since_beginning_us + off_us)
    return np.asarray(arrival_us + sensors.LOG_BEGINS_UNIX_NS // 1000, np.int64)


def _messages(kind: Callable[..., Any], sent_us: Integers, **columns: ArrayLike) -> list[Row]:
    """A message of a ``kind`` for each of (n,) times; each column is (n,) or one value for all."""
    rows: list[Row] = []
    for time_us, *values in sensors.rows_of(sent_us, *columns.values()):
        rows.append((time_us, kind(**dict(zip(columns, values, strict=True)))))
    return rows


def _whole(values: Array) -> Integers:
    """Values rounded to integers."""
    return np.rint(values).astype(np.int64)


def _degrees_e7(angle_rad: Array) -> Integers:
    """Angles [rad] as integers in units of 1e-7 degrees."""
    return _whole(np.degrees(angle_rad) * 1e7)


def _millimetres(height_m: Array) -> Integers:
    """Heights [m] as integers in millimetres."""
    return _whole(height_m * 1e3)


def _system_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """HEARTBEAT and SYSTEM_TIME at 1 Hz."""
    time_s = np.arange(0.25, samples.navigation.time_s[-1], 1.0)
    sent_us = sensors.boot_us(time_s)
    rows = _messages(
        MAVLink_heartbeat_message,
        sent_us,
        type=MAV_TYPE_FIXED_WING,
        autopilot=MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode=MAV_MODE_FLAG_SAFETY_ARMED,
        custom_mode=10,
        system_status=MAV_STATE_ACTIVE,
        mavlink_version=3,
    )
    rows += _messages(
        MAVLink_system_time_message,
        sent_us,
        time_unix_usec=sensors.unix_ns(time_s) // 1000,
        time_boot_ms=sent_us // 1000,
    )
    return rows


def _gnss_rows(gnss: sensors.GnssSamples) -> list[Row]:
    """GPS_RAW_INT at 5 Hz, its time_usec since boot, as ArduPilot fills it."""
    course_cdeg = _whole(np.degrees(gnss.course_rad) % 360.0 * 100.0) % 36_000
    return _messages(
        MAVLink_gps_raw_int_message,
        sensors.boot_us(gnss.time_s + gnss.log_delay_s),
        time_usec=sensors.boot_us(gnss.time_s),
        fix_type=6,
        lat=_degrees_e7(gnss.lat_rad),
        lon=_degrees_e7(gnss.lon_rad),
        alt=_millimetres(gnss.h_msl_m),
        eph=71,
        epv=110,
        vel=_whole(gnss.speed_m_s * 100.0),
        cog=course_cdeg,
        satellites_visible=18,
        alt_ellipsoid=_millimetres(gnss.h_ellipsoid_m),
        h_acc=round(sensors.GNSS_HORIZONTAL_M * 1e3),
        v_acc=round(sensors.GNSS_VERTICAL_M * 1e3),
        vel_acc=50,
    )


def _navigation_rows(navigation: State) -> list[Row]:
    """ATTITUDE at 10 Hz, GLOBAL_POSITION_INT at 5 Hz, VFR_HUD at 1 Hz."""
    return [
        *_attitude_rows(navigation),
        *_position_rows(navigation.rows(slice(None, None, 4))),
        *_display_rows(navigation.rows(slice(None, None, 20))),
    ]


def _attitude_rows(navigation: State) -> list[Row]:
    """ATTITUDE of every second state; the angular rates are computed from all states."""
    time_us = sensors.boot_us(navigation.time_s)[::2]
    yaw = np.remainder(navigation.yaw_rad + np.pi, 2.0 * np.pi) - np.pi
    roll_rate = np.gradient(navigation.roll_rad, navigation.time_s)
    pitch_rate = np.gradient(navigation.pitch_rad, navigation.time_s)
    yaw_rate = np.gradient(navigation.yaw_rad, navigation.time_s)
    return _messages(
        MAVLink_attitude_message,
        time_us,
        time_boot_ms=time_us // 1000,
        roll=navigation.roll_rad[::2],
        pitch=navigation.pitch_rad[::2],
        yaw=yaw[::2],
        rollspeed=roll_rate[::2],
        pitchspeed=pitch_rate[::2],
        yawspeed=yaw_rate[::2],
    )


def _position_rows(state: State) -> list[Row]:
    """GLOBAL_POSITION_INT: the horizontal velocity has the direction of the heading (no wind)."""
    time_us = sensors.boot_us(state.time_s)
    speed_cm_s = 100.0 * state.speed_m_s
    return _messages(
        MAVLink_global_position_int_message,
        time_us,
        time_boot_ms=time_us // 1000,
        lat=_degrees_e7(state.lat_rad),
        lon=_degrees_e7(state.lon_rad),
        alt=_millimetres(state.h_msl_m),
        relative_alt=_millimetres(state.h_msl_m - FIELD_HEIGHT_M),
        vx=_whole(speed_cm_s * np.cos(state.yaw_rad)),
        vy=_whole(speed_cm_s * np.sin(state.yaw_rad)),
        vz=_whole(-state.climb_m_s * 100.0),
        hdg=_whole(np.degrees(state.yaw_rad) % 360.0 * 100.0) % 36_000,
    )


def _display_rows(state: State) -> list[Row]:
    """VFR_HUD, what a head-up display shows."""
    return _messages(
        MAVLink_vfr_hud_message,
        sensors.boot_us(state.time_s),
        airspeed=state.speed_m_s,
        groundspeed=state.speed_m_s,
        heading=_whole(np.degrees(state.yaw_rad) % 360.0) % 360,
        throttle=60,
        alt=state.h_msl_m,
        climb=state.climb_m_s,
    )


def _air_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """SCALED_PRESSURE (outside), SCALED_PRESSURE2 (cabin) at 5 Hz; HYGROMETER_SENSOR at 2.5 Hz."""
    return [
        *_pressure_rows(MAVLink_scaled_pressure_message, samples.outside),
        *_hygrometer_rows(0, samples.outside),
        *_pressure_rows(MAVLink_scaled_pressure2_message, samples.cabin),
        *_hygrometer_rows(1, samples.cabin),
    ]


def _pressure_rows(kind: Callable[..., Any], box: sensors.BoxSamples) -> list[Row]:
    """The pressures of a box, every second one, with the temperature of its board."""
    time_us = sensors.boot_us(box.pressure_time_s)[::2]
    return _messages(
        kind,
        time_us,
        time_boot_ms=time_us // 1000,
        press_abs=box.pressure_pa[::2] / HECTOPASCAL,
        press_diff=0.0,
        temperature=_whole(100.0 * (box.board_k - ZERO_CELSIUS_K))[::2],
    )


def _hygrometer_rows(instance: int, box: sensors.BoxSamples) -> list[Row]:
    """Temperature and humidity of a box, in hundredths of a degree and of a per cent."""
    return _messages(
        MAVLink_hygrometer_sensor_message,
        sensors.boot_us(box.time_s),
        id=instance,
        temperature=_whole(100.0 * (box.temperature_k - ZERO_CELSIUS_K)),
        humidity=_whole(1e4 * box.humidity),
    )


def _camera_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """CAMERA_FEEDBACK of every exposure and camera; time_usec since boot (feedback pin)."""
    shutter_us = sensors.boot_us(samples.exposure_s)
    shot = samples.navigation.between(samples.exposure_s)
    number = np.arange(shutter_us.size) + 1
    rows: list[Row] = []
    for instance in range(len(samples.camera_names)):
        rows += _messages(
            MAVLink_camera_feedback_message,
            shutter_us + FEEDBACK_US + FEEDBACK_STEP_US * instance,
            time_usec=shutter_us,
            target_system=1,
            cam_idx=instance,
            img_idx=number,
            lat=_degrees_e7(shot.lat_rad),
            lng=_degrees_e7(shot.lon_rad),
            alt_msl=shot.h_msl_m,
            alt_rel=shot.h_msl_m - FIELD_HEIGHT_M,
            roll=np.degrees(shot.roll_rad),
            pitch=np.degrees(shot.pitch_rad),
            yaw=np.degrees(shot.yaw_rad) % 360.0,
            foc_len=0.0,
            flags=CAMERA_FEEDBACK_PHOTO,
            completed_captures=number,
        )
    return rows
