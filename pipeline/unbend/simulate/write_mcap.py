"""Writes the flight as a ROS 2 recording: CDR messages in zstd chunks, by mcap-ros2-support."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer

from unbend.simulate import sensors
from unbend.simulate.flight import State
from unbend.simulate.optics import NED_FROM_ENU, body_rotation, quaternion
from unbend.units import NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K

_FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
_CHUNK_BYTES = 1024 * 1024

SHORTEST_DELAY_NS = 2e6  # from the stamp of a sensor to log_time of the recorder
LONGEST_DELAY_NS = 15e6
NO_ESTIMATE = [-1.0] + [0.0] * 8  # sensor_msgs/Imu: covariance of a quantity without estimate
ZERO_VECTOR = {"x": 0.0, "y": 0.0, "z": 0.0}


@dataclass(frozen=True)
class Row:
    """A message: its header.stamp [Unix ns], topic, schema, and all fields but the header."""

    stamp_ns: int
    topic: str
    schema: str
    fields: Mapping[str, Any]

    @property
    def content(self) -> dict[str, Any]:
        """The message with its header; frame_id is the first part of the topic."""
        sec, nanosec = divmod(self.stamp_ns, NANOSECONDS_PER_SECOND)
        header = {
            "stamp": {"sec": sec, "nanosec": nanosec},
            "frame_id": self.topic.split("/")[1],
        }
        return {"header": header, **self.fields}


def write_mcap(path: Path, samples: sensors.LoggedSamples, seed: int) -> int:
    """Write the recording; returns the number of messages.

    header.stamp is when a sensor measured; log_time, when the recorder got it, is 2-15 ms later.
    """
    rows = [
        *_fix_rows(samples.gnss),
        *_attitude_rows(samples.navigation),
        *_air_rows("outside", samples.outside),
        *_air_rows("cabin", samples.cabin),
        *_image_rows(samples),
    ]
    stamps_ns = np.array([row.stamp_ns for row in rows])
    rng = np.random.default_rng([seed, 3])
    delay_ns = rng.uniform(SHORTEST_DELAY_NS, LONGEST_DELAY_NS, len(rows))
    arrival_ns = stamps_ns + delay_ns.astype(np.int64)
    sequence = dict.fromkeys((row.topic for row in rows), 0)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES)
        schemas = _register_schemas(writer)
        for number in np.argsort(arrival_ns, kind="stable").tolist():
            row = rows[number]
            writer.write_message(
                row.topic,
                schemas[row.schema],
                row.content,
                log_time=int(arrival_ns[number]),
                publish_time=int(arrival_ns[number]),
                sequence=sequence[row.topic],
            )
            sequence[row.topic] += 1
        writer.finish()
    return len(rows)


def _register_schemas(writer: Writer) -> dict[str, Any]:
    """Register the message definitions of data/ros2.toml; returns the schemas by name."""
    text = files("unbend.simulate").joinpath("data/ros2.toml").read_text("utf-8")
    schemas = {}
    for name, definition in tomllib.loads(text).items():
        schemas[name] = writer.register_msgdef(name, definition)
    return schemas


def _fix_rows(gnss: sensors.GnssSamples) -> list[Row]:
    """/fix at 5 Hz: NavSatFix.altitude is the height above the ellipsoid."""
    stamps = sensors.unix_ns(gnss.time_s).tolist()
    lat_deg = np.degrees(gnss.lat_rad).tolist()
    lon_deg = np.degrees(gnss.lon_rad).tolist()
    height_m = gnss.h_ellipsoid_m.tolist()
    horizontal = sensors.GNSS_HORIZONTAL_M**2
    vertical = sensors.GNSS_VERTICAL_M**2
    covariance = _diagonal(horizontal, horizontal, vertical)
    rows = []
    for i, stamp in enumerate(stamps):
        fields = {
            "status": {"status": 2, "service": 9},
            "latitude": lat_deg[i],
            "longitude": lon_deg[i],
            "altitude": height_m[i],
            "position_covariance": covariance,
            "position_covariance_type": 2,
        }
        rows.append(Row(stamp, "/fix", "sensor_msgs/msg/NavSatFix", fields))
    return rows


def _attitude_rows(navigation: State) -> list[Row]:
    """/imu/data at 20 Hz: orientation of forward-left-up axes in east-north-up (REP 103)."""
    tilt = np.radians(sensors.TILT_DEG)
    heading = np.radians(sensors.HEADING_DEG)
    covariance = _diagonal(tilt**2, tilt**2, heading**2)
    rows = []
    for i, stamp in enumerate(sensors.unix_ns(navigation.time_s).tolist()):
        ned_from_body = body_rotation(
            navigation.roll_rad[i], navigation.pitch_rad[i], navigation.yaw_rad[i]
        )
        enu_from_flu = NED_FROM_ENU.T @ ned_from_body @ _FLU_FROM_FRD
        orientation = dict(zip("wxyz", quaternion(enu_from_flu).tolist(), strict=True))
        fields = {
            "orientation": orientation,
            "orientation_covariance": covariance,
            "angular_velocity": ZERO_VECTOR,
            "angular_velocity_covariance": NO_ESTIMATE,
            "linear_acceleration": ZERO_VECTOR,
            "linear_acceleration_covariance": NO_ESTIMATE,
        }
        rows.append(Row(stamp, "/imu/data", "sensor_msgs/msg/Imu", fields))
    return rows


def _diagonal(*variances: float) -> list[float]:
    """A covariance matrix with these variances on its diagonal, as a list row by row."""
    matrix: list[float] = np.diag(variances).ravel().tolist()
    return matrix


def _air_rows(place: str, box: sensors.BoxSamples) -> list[Row]:
    """Pressure of a box at 5 Hz, temperature and humidity at 2.5 Hz, on topics /``place``/..."""
    rows = []
    stamps = sensors.unix_ns(box.pressure_time_s)[::2].tolist()
    pressures = box.pressure_pa[::2].tolist()
    for stamp, pressure in zip(stamps, pressures, strict=True):
        fields = {"fluid_pressure": pressure, "variance": sensors.BAROMETER_PA**2}
        topic = f"/{place}/pressure"
        rows.append(Row(stamp, topic, "sensor_msgs/msg/FluidPressure", fields))
    # Rounded to the last digits of the sensors: a binary subtraction adds further digits.
    celsius = np.round(box.temperature_k - ZERO_CELSIUS_K, 2).tolist()
    humidity = np.round(box.humidity, 4).tolist()
    for i, stamp in enumerate(sensors.unix_ns(box.time_s).tolist()):
        topic = f"/{place}/temperature"
        fields = {"temperature": celsius[i], "variance": sensors.THERMOMETER_K**2}
        rows.append(Row(stamp, topic, "sensor_msgs/msg/Temperature", fields))
        topic = f"/{place}/humidity"
        fields = {"relative_humidity": humidity[i], "variance": sensors.HUMIDITY**2}
        rows.append(Row(stamp, topic, "sensor_msgs/msg/RelativeHumidity", fields))
    return rows


def _image_rows(samples: sensors.LoggedSamples) -> list[Row]:
    """Rows of image topics, without the pictures: the stamp is the time of the shutter."""
    schema = "sensor_msgs/msg/CompressedImage"
    no_picture = {"format": "jpeg", "data": b""}
    rows = []
    for name in samples.camera_names:
        for stamp in sensors.unix_ns(samples.exposure_s).tolist():
            rows.append(Row(stamp, f"/camera/{name}/image/compressed", schema, no_picture))
    return rows
