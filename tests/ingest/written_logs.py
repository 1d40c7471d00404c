"""Logs that tests write, of messages of their choice by an encoder of each format, and open."""

import io
import json
import struct
from functools import cache
from typing import Any

from tests.helpers import with_code
from unbend.ingest import open_log

NS_PER_S = 10**9


def opened(path, data):
    """The log in a file with this content."""
    path.write_bytes(data)
    return open_log(path)


def entry_in(log, code):
    """The only entry with this code in the ledger of a log."""
    entries = with_code(log.ledger, code)
    assert len(entries) == 1, f"{code} stands {len(entries)} times"
    return entries[0]


def loss_codes(log) -> set[str]:
    return {entry.code for entry in log.ledger if entry.kind == "loss"}


# struct letters and scale of the DataFlash format letters in use here (ArduPilot LogStructure.h)
_LETTERS = """
Q Q 1
B B 1
I I 1
H H 1
i i 1
f f 1
N 16s 1
a 64s 1
c h 100
C H 100
e i 100
E I 100
L i 10000000
"""
LETTERS: dict[str, tuple[str, int]] = {}
for _row in _LETTERS.strip().splitlines():
    _letter, _code, _scale = _row.split()
    LETTERS[_letter] = (_code, int(_scale))


class DataFlashWriter:
    """Writes DataFlash records as ArduPilot does."""

    def __init__(self):
        self.data = b""
        self.formats: dict[str, tuple[int, str]] = {}
        self.define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)

    def define(self, kind, name, letters, columns, length=0):
        if not length:
            layout = "".join(LETTERS[letter][0] for letter in letters)
            length = 3 + struct.calcsize("<" + layout)
        texts = (name.encode(), letters.encode(), columns.encode())
        self.data += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, *texts)
        self.formats[name] = (kind, letters)

    def row(self, name, *values):
        kind, letters = self.formats[name]
        self.data += b"\xa3\x95" + bytes([kind])
        for letter, value in zip(letters, values, strict=True):
            code, scale = LETTERS[letter]
            raw = value if letter in "fNa" else round(value * scale)
            self.data += struct.pack("<" + code, raw)

    def define_receiver(self):
        """GPS of several receivers, whose rows `fix` writes."""
        columns = "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt"
        self.define(20, "GPS", "QBBIHBcLLe", columns)

    def fix(self, time_us, week_ms, *, week, instance=0, status=3):
        """A fix at a place that does not change."""
        self.row(
            "GPS",
            time_us,
            instance,
            status,
            week_ms,
            week,
            12,
            0.8,
            47.0,
            8.0,
            600.0,
        )


@cache
def blank_fields(kind):
    """The fields of a message of pymavlink, zero all of them."""
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    fields = {}
    for name, field_type in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        fields[name] = b"" if field_type == "char" else 0
        if lengths[name] and field_type != "char":
            fields[name] = [0] * lengths[name]
    return fields


class MavlinkWriter:
    """Packets of pymavlink's encoder, each behind the stamp of a ground station."""

    def __init__(self, version=2):
        from pymavlink.dialects.v20 import all as library

        self.library = library
        self.version = version
        self.senders: dict[tuple[int, int], Any] = {}
        self.frames = []

    def send(self, name, received_us, /, source: tuple[int, int] = (1, 1), **fields):
        """A message of a system and component; fields that are not given are zero."""
        kind = getattr(self.library, f"MAVLink_{name}_message")
        message = kind(**blank_fields(kind) | fields)
        if source not in self.senders:
            self.senders[source] = self.library.MAVLink(None, *source)
        sender = self.senders[source]
        packet = message.pack(sender, force_mavlink1=self.version == 1)
        sender.seq = (sender.seq + 1) % 256
        self.frames.append(struct.pack(">Q", received_us) + packet)

    @property
    def data(self):
        return b"".join(self.frames)


def restamped(frame, later_us):
    """A packet that the ground station received later, by its clock."""
    (received_us,) = struct.unpack(">Q", frame[:8])
    return struct.pack(">Q", received_us + later_us) + frame[8:]


HEADER = "std_msgs/Header header\n"
_XYZ = "float64 x\nfloat64 y\nfloat64 z"
PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Quaternion": f"{_XYZ}\nfloat64 w",
    "geometry_msgs/Vector3": _XYZ,
    "geographic_msgs/GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude",
}
"""Definitions that others are made of; none is made of an earlier one."""

DEFINITIONS = {
    "sensor_msgs/NavSatFix": HEADER
    + "sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
    "float64[9] position_covariance\nuint8 position_covariance_type",
    "sensor_msgs/Imu": HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
    "sensor_msgs/FluidPressure": HEADER + "float64 fluid_pressure\nfloat64 variance",
    "sensor_msgs/Temperature": HEADER + "float64 temperature\nfloat64 variance",
    "sensor_msgs/RelativeHumidity": HEADER + "float64 relative_humidity\nfloat64 variance",
    "sensor_msgs/CompressedImage": HEADER + "string format\nuint8[] data",
    "std_msgs/String": "string data",
}


def with_parts(definition):
    """A definition, and behind it those of the messages that it is made of."""
    text = definition
    for name, part in PARTS.items():
        if f"{name} " in text:
            text += f"\n{'=' * 80}\nMSG: {name}\n{part}"
    return text


def ros_time(time_ns) -> dict[str, int]:
    sec, nanosec = divmod(time_ns, NS_PER_S)
    return {"sec": sec, "nanosec": nanosec}


class RosWriter:
    """A recording of ROS 2 by the writer of mcap-ros2-support."""

    def __init__(self, **options):
        from mcap_ros2.writer import Writer

        self.file = io.BytesIO()
        self.writer = Writer(self.file, **options)
        self.schemas: dict[str, Any] = {}

    def define(self, kind, definition):
        package, name = kind.split("/")
        full_name = f"{package}/msg/{name}"
        self.schemas[kind] = self.writer.register_msgdef(full_name, with_parts(definition))

    def write(
        self,
        topic,
        kind,
        time_ns,
        recorded_ns=None,
        *,
        frame_id="base",
        **fields,
    ):
        """A message with this stamp in its header; fields that are not given are zero."""
        if kind not in self.schemas:
            self.define(kind, DEFINITIONS[kind])
        header = {"stamp": ros_time(time_ns), "frame_id": frame_id}
        recorded_ns = time_ns if recorded_ns is None else recorded_ns
        row = {"header": header} | fields
        self.writer.write_message(topic, self.schemas[kind], row, recorded_ns)

    @property
    def data(self):
        self.writer.finish()
        return self.file.getvalue()


class McapWriter:
    """A recording of messages of any encoding, by the writer of mcap."""

    def __init__(self, **options):
        from mcap.writer import Writer

        self.file = io.BytesIO()
        self.writer = Writer(self.file, **options)
        self.writer.start(profile="", library="test")

    def channel(self, topic, encoding, schema="", definition="", form=""):
        """The number of a new channel; ``form`` is that of its definition."""
        schema_form = form or {"cdr": "ros2msg", "json": "jsonschema"}.get(encoding, "")
        number = 0
        if schema:
            number = self.writer.register_schema(schema, schema_form, definition.encode())
        return self.writer.register_channel(topic, encoding, number)

    def write(self, channel, recorded_ns, content: bytes | dict[str, Any], sequence=0):
        """A message of bytes, or of a dictionary in JSON."""
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.writer.add_message(channel, recorded_ns, data, recorded_ns, sequence)

    @property
    def data(self):
        self.writer.finish()
        return self.file.getvalue()


def ulog_message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def subscription(number, topic, instance=0):
    """The message by which a topic gets a number."""
    return ulog_message("A", struct.pack("<BH", instance, number) + topic.encode())


class ULogWriter:
    """Writes the messages of a ULog file by hand: definitions, subscriptions, data."""

    def __init__(self):
        self.data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
        self.message("B", bytes(40))
        self.ids: dict[tuple[str, int], int] = {}

    def message(self, kind, payload):
        self.data += ulog_message(kind, payload)

    def define(self, name, fields):
        self.message("F", f"{name}:uint64_t timestamp;{fields}".encode())

    def subscribe(self, *names, instance=0):
        for name in names:
            number = len(self.ids)
            self.ids[name, instance] = number
            self.data += subscription(number, name, instance)

    def row(self, name, layout, *values, instance=0):
        number = struct.pack("<H", self.ids[name, instance])
        self.message(
            "D",
            number + struct.pack("<Q" + layout, *values),
        )
