"""The flight as a ROS 2 recording: CDR messages in zstd chunks, written by mcap-ros2-support."""

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer

from unbend.simulate import sensors
from unbend.simulate.optics import NED_FROM_ENU, body_rotation, quaternion
from unbend.units import NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K

_FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
_CHUNK_BYTES = 1024 * 1024

# header.stamp [ns], topic, schema, the fields beside the header.
Row = tuple[int, str, str, Mapping[str, Any]]


def write_mcap(path: Path, samples: sensors.LoggedSamples, seed: int) -> int:
    """Write the recording; returns the number of messages.

    header.stamp is when a sensor measured; log_time, when the recorder got it, is 2-15 ms later.
    """
    rows = [
        *_position_rows(samples),
        *_air_rows("outside", samples.outside),
        *_air_rows("cabin", samples.cabin),
        # Image topics whose pictures were left out of the recording: the stamp is the shutter.
        *[
            (stamp, f"/camera/{name}/image/compressed", "sensor_msgs/msg/CompressedImage",
             {"format": "jpeg", "data": b""})
            for name in samples.camera_names
            for stamp in sensors.unix_ns(samples.exposure_s).tolist()
        ],
    ]  # fmt: skip
    late = np.random.default_rng([seed, 3]).uniform(2e6, 15e6, len(rows)).astype(np.int64)
    arrival = np.array([row[0] for row in rows]) + late
    order = np.argsort(arrival, kind="stable")
    sequence = dict.fromkeys((row[1] for row in rows), 0)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES)
        texts = files("unbend.simulate").joinpath("data/ros2.toml").read_text("utf-8")
        definitions = tomllib.loads(texts).items()
        schemas = {name: writer.register_msgdef(name, text) for name, text in definitions}
        for i in order.tolist():
            stamp, topic, schema, fields = rows[i]
            sec, nanosec = divmod(stamp, NANOSECONDS_PER_SECOND)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": topic.split("/")[1]}
            writer.write_message(
                topic, schemas[schema], {"header": header, **fields},
                log_time=int(arrival[i]), publish_time=int(arrival[i]),
                sequence=sequence[topic],
            )  # fmt: skip
            sequence[topic] += 1
        writer.finish()
    return len(rows)


def _position_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """/fix at 5 Hz: NavSatFix.altitude is the height above the ellipsoid; /imu/data at 20 Hz:
    orientation of forward-left-up axes in east-north-up (REP 103)."""
    g, nav = samples.gnss, samples.navigation
    lat, lon = np.degrees(g.lat_rad).tolist(), np.degrees(g.lon_rad).tolist()
    height = g.h_ellipsoid_m.tolist()
    variances = [sensors.GNSS_HORIZONTAL_M**2] * 2 + [sensors.GNSS_VERTICAL_M**2]
    covariance = np.diag(variances).ravel().tolist()
    rows: list[Row] = [
        (stamp, "/fix", "sensor_msgs/msg/NavSatFix", {
            "status": {"status": 2, "service": 9}, "latitude": lat[i], "longitude": lon[i],
            "altitude": height[i], "position_covariance": covariance,
            "position_covariance_type": 2,
        })
        for i, stamp in enumerate(sensors.unix_ns(g.time_s).tolist())
    ]  # fmt: skip
    tilt, heading = np.radians(sensors.TILT_DEG), np.radians(sensors.HEADING_DEG)
    covariance = np.diag([tilt**2, tilt**2, heading**2]).ravel().tolist()
    unknown = [-1.0] + [0.0] * 8  # sensor_msgs/Imu: no estimate of this element
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    for i, stamp in enumerate(sensors.unix_ns(nav.time_s).tolist()):
        ned = body_rotation(nav.roll_rad[i], nav.pitch_rad[i], nav.yaw_rad[i])
        w, x, y, z = quaternion(NED_FROM_ENU.T @ ned @ _FLU_FROM_FRD).tolist()
        rows.append((stamp, "/imu/data", "sensor_msgs/msg/Imu", {
            "orientation": {"x": x, "y": y, "z": z, "w": w},
            "orientation_covariance": covariance,
            "angular_velocity": zero, "angular_velocity_covariance": unknown,
            "linear_acceleration": zero, "linear_acceleration_covariance": unknown,
        }))  # fmt: skip
    return rows


def _air_rows(place: str, box: sensors.BoxSamples) -> list[Row]:
    """Pressure of one place at 5 Hz, temperature and humidity at 2.5 Hz."""
    rows: list[Row] = [
        (stamp, f"/{place}/pressure", "sensor_msgs/msg/FluidPressure",
         {"fluid_pressure": value, "variance": sensors.BAROMETER_PA**2})
        for stamp, value in zip(
            sensors.unix_ns(box.pressure_time_s)[::2].tolist(), box.pressure_pa[::2].tolist(),
            strict=True,
        )
    ]  # fmt: skip
    # Rounded to what the sensors read: the digits of a subtraction in binary are not theirs.
    celsius = np.round(box.temperature_k - ZERO_CELSIUS_K, 2).tolist()
    humidity = np.round(box.humidity, 4).tolist()
    thermal, moist = sensors.THERMOMETER_K**2, sensors.HUMIDITY**2
    for i, stamp in enumerate(sensors.unix_ns(box.time_s).tolist()):
        rows.append((stamp, f"/{place}/temperature", "sensor_msgs/msg/Temperature",
                     {"temperature": celsius[i], "variance": thermal}))  # fmt: skip
        rows.append((stamp, f"/{place}/humidity", "sensor_msgs/msg/RelativeHumidity",
                     {"relative_humidity": humidity[i], "variance": moist}))  # fmt: skip
    return rows
