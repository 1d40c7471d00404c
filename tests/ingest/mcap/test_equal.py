"""Every cell of MCAP messages, as mcap-ros2-support and protobuf decode them one by one."""

from __future__ import annotations

import io
import json
import random
import struct
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.logs import with_suffix
from unbend.ingest import Log, open_log
from unbend.ingest.mcap.cdr import decode, decode_plan
from unbend.ingest.mcap.ros2_definitions import SchemaError, steps_of

SECOND = 10**9
START = 1_763_073_169 * SECOND

VARYING = """uint8 K=3
string s "a # b"
float64 a
string[] many
bool b
geo/P[] ps
float32[3] arr
int16 c
string<=10 t
P[2] two
uint8[] raw
float64[<=4] seq
int16 after
int64 z # the last but one
E e
char ch
===
MSG: geo/P
float64 x
string name
===
MSG: pkg/P
int8 q
float64 r
===
MSG: pkg/E
int8 K=2
"""


def library_messages(path: Path) -> dict[str, list]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            found[channel.topic].append(message)
    return found


def follow(message: Any, path: str) -> Any:
    for part in path.split("."):
        if hasattr(message, "__getitem__") and part.isdigit():
            message = message[int(part)]
        else:  # the library reads the byte of an empty message and does not keep it
            message = getattr(message, part, 0)
    return list(message) if isinstance(message, bytes) else message


def compare(table: dict[str, np.ndarray], messages: list) -> int:
    """Compare the columns of a table with messages of the library; how many cells that is."""
    cells = 0
    for name, ours in table.items():
        if name in ("time_ns", "boot", "log_time_ns"):
            continue
        theirs = [follow(message, name.removesuffix("[]")) for message in messages]
        if name.endswith("[]"):
            theirs = [len(sequence) for sequence in theirs]
        if ours.dtype.kind == "f":
            want = np.array(theirs, ours.dtype)
            assert np.array_equal(ours.view(f"u{ours.itemsize}"), want.view(f"u{ours.itemsize}"))
        else:
            assert ours.tolist() == theirs, name
        cells += ours.size
    return cells


@pytest.mark.parametrize("path", with_suffix(".mcap"), ids=lambda path: path.name)
def test_every_cell_is_the_librarys(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    log = open_log(path)
    expected = library_messages(path)
    assert log.message_types() == {topic: len(rows) for topic, rows in expected.items()}
    cells = sum(compare(log.message(topic), rows) for topic, rows in expected.items())
    assert cells > 100_000
    record_property("cells compared", cells)
    print(f"{path.name}: {cells} cells, all bit-equal")


def text(draw: random.Random) -> str:
    return "".join(draw.choice("abcdeé") for _ in range(draw.randrange(6)))


def varying_message(draw: random.Random) -> dict:
    return {
        "s": text(draw),
        "a": draw.random(),
        "many": [text(draw) for _ in range(draw.randrange(3))],
        "b": draw.random() < 0.5,
        "ps": [{"x": 1.0, "name": text(draw)} for _ in range(draw.randrange(3))],
        "arr": [1.0, 2.0, draw.random()],
        "c": draw.randrange(-9, 9),
        "t": text(draw),
        "two": [{"q": 1, "r": draw.random()}, {"q": -1, "r": draw.random()}],
        "raw": bytes(draw.randrange(9)),
        "seq": [1.0] * draw.randrange(4),
        "after": draw.randrange(-9, 9),
        "z": draw.randrange(1 << 40),
        "e": {},
        "ch": draw.randrange(99),
    }


def test_layouts_that_vary_from_message_to_message(tmp_path: Path) -> None:
    from mcap_ros2.writer import Writer

    draw = random.Random(1)
    path = tmp_path / "varying.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000)
        schema = writer.register_msgdef("pkg/msg/M", VARYING)
        air = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for k in range(800):
            writer.write_message("/varying", schema, varying_message(draw), START + k)
            writer.write_message("/plain", air, {"data": draw.random()}, START + k)
        pressure = writer.register_msgdef(
            "sensor_msgs/msg/FluidPressure",
            "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n===\n"
            "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        )
        for k in range(800):
            header = {"stamp": {"sec": 1_763_073_169 + k, "nanosec": 5}, "frame_id": text(draw)}
            row = {"header": header, "fluid_pressure": 9e4 - k, "variance": 0.0}
            writer.write_message("/air", pressure, row, START + k)
        writer.finish()
    log = open_log(path)
    expected = library_messages(path)
    assert sum(compare(log.message(topic), expected[topic]) for topic in expected) > 8000
    np.testing.assert_array_equal(log.channel("/air")["pressure_pa"], 9e4 - np.arange(800))


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders(order: str) -> None:
    steps = steps_of("a/msg/B", "uint8 k\nfloat64 x\nstring s\nint16[3] n\nfloat32[] f\nuint32 z")
    rows = []
    for k in range(20):
        text_bytes = b"abcdefg"[: k % 7] + b"\0"
        body = struct.pack(f"{order}B7xdI", k, k / 3, len(text_bytes)) + text_bytes
        body += bytes(-len(body) % 2) + struct.pack(f"{order}3h", k, -k, 7)
        body += bytes(-len(body) % 4) + struct.pack(f"{order}I", k % 3)
        body += struct.pack(f"{order}{k % 3}f", *([1.5] * (k % 3))) + struct.pack(f"{order}I", k)
        rows.append(bytes([0, order == "<", 0, 0]) + body)
    rows[3] = rows[3][:-1]  # too short
    rows[5] = b"\0"
    length = np.array([len(row) for row in rows])
    data = np.frombuffer(b"".join(rows), np.uint8)
    done, table = decode(data, np.cumsum(length) - length, length, decode_plan(steps))
    k = np.delete(np.arange(20), [3, 5])
    np.testing.assert_array_equal(done, k)
    np.testing.assert_array_equal(table["x"], k / 3)
    np.testing.assert_array_equal(table["n"], np.stack([k, -k, np.full(18, 7)], axis=1))
    np.testing.assert_array_equal(table["z"], k)
    assert table["s"].tolist() == ["abcdefg"[: n % 7] for n in k]
    assert "f" not in table
    np.testing.assert_array_equal(table["f[]"], k % 3)


@pytest.mark.parametrize(
    "definition",
    ["float64", "wstring x", "Nothing n", "a/B b", "!!", "P[99999] p\n===\nMSG: a/P\nint8 x"],
)
def test_definitions_that_make_no_sense(definition: str) -> None:
    with pytest.raises(SchemaError):
        steps_of("a/msg/B", definition)


def location_fix() -> Any:
    """foxglove.LocationFix as a class of protobuf, without its generated module."""
    from google.protobuf import timestamp_pb2
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
    from google.protobuf.descriptor_pb2 import FileDescriptorProto
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    file = FileDescriptorProto(
        name="foxglove/LocationFix.proto",
        package="foxglove",
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )
    message = file.message_type.add(name="LocationFix")
    double = Field.TYPE_DOUBLE
    optional = Field.LABEL_OPTIONAL
    message.field.add(
        name="timestamp",
        number=6,
        type=Field.TYPE_MESSAGE,
        label=optional,
        type_name=".google.protobuf.Timestamp",
    )
    message.field.add(name="frame_id", number=7, type=Field.TYPE_STRING, label=optional)
    for number, name in enumerate(("latitude", "longitude", "altitude"), 1):
        message.field.add(name=name, number=number, type=double, label=optional)
    message.field.add(name="position_covariance", number=4, type=double, label=Field.LABEL_REPEATED)
    message.field.add(
        name="position_covariance_type", number=5, type=Field.TYPE_INT32, label=optional
    )
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("foxglove.LocationFix"))


def test_protobuf_of_foxglove(tmp_path: Path) -> None:
    from mcap_protobuf.writer import Writer

    kind = location_fix()
    messages = []
    path = tmp_path / "fix.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        for k in range(300):
            fix = kind(
                frame_id="gps",
                latitude=47 + k / 3e6,
                longitude=-122 - k / 7e6,
                altitude=580.0 + k / 9,
                position_covariance=[4, 0, 0, 0, 2, 0, 0, 0, 9],
                position_covariance_type=2,
            )
            fix.timestamp.seconds, fix.timestamp.nanos = divmod(START + k * SECOND // 5, SECOND)
            messages.append(fix)
            writer.write_message("/fix", fix, START + k, START + k)
        writer.finish()
    log = open_log(path)
    fix = log.channel("/fix")
    table = log.message("/fix")
    np.testing.assert_array_equal(fix.time_ns, START + np.arange(300) * SECOND // 5)
    for column, field in (("lat_rad", "latitude"), ("lon_rad", "longitude")):
        theirs = np.array([getattr(message, field) for message in messages])
        np.testing.assert_array_equal(table[field], theirs)
        np.testing.assert_array_equal(fix[column], theirs * (np.pi / 180.0))
    np.testing.assert_array_equal(fix["h_ellipsoid_m"], [m.altitude for m in messages])
    np.testing.assert_array_equal(fix["sigma_v_m"], np.full(300, 3.0))
    assert table["frame_id"].tolist() == ["gps"] * 300
    assert (fix.roles, log.ledger.has_losses) == (("height", "position"), False)


def test_without_the_protobuf_library_its_topics_are_a_stated_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mcap_protobuf.writer import Writer

    path = tmp_path / "fix.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.write_message("/fix", location_fix()(latitude=1.0), START, START)
        writer.finish()
    monkeypatch.setitem(__import__("sys").modules, "mcap_protobuf.decoder", None)
    with pytest.raises(Exception, match="LOG-NO-MESSAGES"):
        open_log(path)
    log = open_log(path, needs_channels=False)
    assert [(entry.code, entry.where) for entry in log.ledger] == [("LOG-NO-PROTOBUF", "/fix")]


def json_log(path: Path, rows: list[tuple[str, str, dict | bytes]]) -> Log:
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="test")
    channels: dict[str, int] = {}
    for k, (topic, schema, message) in enumerate(rows):
        if topic not in channels:
            number = writer.register_schema(schema, "jsonschema", b"{}")
            channels[topic] = writer.register_channel(topic, "json", number)
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        writer.add_message(channels[topic], START + k, data, START + k)
    writer.finish()
    path.write_bytes(file.getvalue())
    return open_log(path)


def test_json_with_times_of_any_form(tmp_path: Path) -> None:
    forms = [
        {"sec": START // SECOND, "nsec": 5 * 10**8},
        START // SECOND + 0.5,
        "2025-11-13T22:32:49.500Z",
        "2025-11-13T23:32:49.5+01:00",
        START // 10**6 + 500,
    ]
    rows = [
        (
            f"/fix{k}",
            "foxglove.LocationFix",
            {"timestamp": form, "latitude": 47.5, "longitude": -122.5, "altitude": 580.0},
        )
        for k, form in enumerate(forms)
    ]
    rows += [
        ("/cabin", "acme.Reading", {"timestamp": forms[0], "value": 21.5, "unit": "degC"}),
        ("/cabin", "acme.Reading", {"timestamp": forms[0] | {"nsec": 6 * 10**8}}),
        ("/cabin", "acme.Reading", b"[1]"),
        ("/cabin", "acme.Reading", b"{broken"),
    ]
    log = json_log(tmp_path / "log.mcap", rows)
    for k in range(len(forms)):
        fix = log.channel(f"/fix{k}")
        assert fix.time_ns.tolist() == [START + 5 * 10**8]
        assert fix["h_ellipsoid_m"].tolist() == [580.0]
    cabin = log.channel("/cabin")
    np.testing.assert_array_equal(cabin["value"], [21.5, np.nan])
    assert cabin.roles == ()
    assert log.message("/cabin")["unit"].tolist() == ["degC", ""]
    decode_losses = [entry for entry in log.ledger if entry.code == "LOG-DECODE"]
    assert [(entry.where, entry.count) for entry in decode_losses] == [("/cabin", 2)]
    assert log.messages["/cabin"] == 4


PX4 = {
    "SensorGps": "uint64 timestamp\nuint64 time_utc_usec\nfloat64 latitude_deg\n"
    "float64 longitude_deg\nfloat64 altitude_msl_m\nfloat64 altitude_ellipsoid_m\nfloat32 eph\n"
    "float32 epv\nuint8 fix_type",
    "VehicleGpsPosition": "uint64 timestamp\nint32 lat\nint32 lon\nint32 alt\nint32 alt_ellipsoid\n"
    "uint64 time_utc_usec\nuint8 fix_type",
    "VehicleAttitude": "uint64 timestamp\nfloat32[4] q",
    "VehicleAirData": "uint64 timestamp\nfloat32 baro_temp_celcius\nfloat32 baro_pressure_pa",
    "SensorHygrometer": "uint64 timestamp\nfloat32 temperature\nfloat32 humidity",
    "CameraCapture": "uint64 timestamp\nuint64 timestamp_utc\nuint32 seq\nfloat64 lat\n"
    "float64 lon\nfloat32 alt\nfloat32 ground_distance\nfloat32[4] q\nint8 result",
}


def px4_log(path: Path, *, utc: bool = True) -> Log:
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {
            name: writer.register_msgdef(f"px4_msgs/msg/{name}", definition)
            for name, definition in PX4.items()
        }

        def send(name: str, us: int, **fields: object) -> None:
            at = START + us * 1000 + 3_000_000  # recorded 3 ms late
            row = {"timestamp": us, **fields}
            writer.write_message(f"/fmu/out/{name}", schemas[name], row, at)

        for k in range(40):
            us = 60_000_000 + 200_000 * k
            unix = START // 1000 + us if utc else 0
            send(
                "SensorGps",
                us,
                time_utc_usec=unix,
                latitude_deg=47.5,
                longitude_deg=-122.5,
                altitude_msl_m=600.0,
                altitude_ellipsoid_m=580.0,
                eph=0.5,
                epv=0.75,
                fix_type=3,
            )
            send(
                "VehicleGpsPosition",
                us,
                time_utc_usec=unix,
                lat=475000000,
                lon=-1225000000,
                alt=600_000,
                alt_ellipsoid=0,
                fix_type=3,
            )
            send("VehicleAttitude", us, q=[0.5, 0.5, -0.5, 0.5])
            send("VehicleAirData", us, baro_temp_celcius=40.0, baro_pressure_pa=70_025.0)
            send("SensorHygrometer", us, temperature=-12.5, humidity=45.0)
            if k % 10 == 0:
                send(
                    "CameraCapture",
                    us,
                    timestamp_utc=0,
                    seq=k,
                    lat=47.5,
                    lon=-122.5,
                    alt=600.0,
                    ground_distance=1.0,
                    q=[1.0, 0.0, 0.0, 0.0],
                    result=1,
                )
        writer.finish()
    return open_log(path)


def test_px4_counts_time_from_boot(tmp_path: Path) -> None:
    log = px4_log(tmp_path / "px4.mcap")
    utc_ns = START + 60 * SECOND + np.arange(40) * SECOND // 5
    for name in ("SensorGps", "VehicleAttitude", "VehicleAirData", "SensorHygrometer"):
        np.testing.assert_array_equal(log.channel(f"/fmu/out/{name}").time_ns, utc_ns)
    np.testing.assert_array_equal(log.channel("/fmu/out/CameraCapture").time_ns, utc_ns[::10])
    gps = log.channel("/fmu/out/SensorGps")
    old = log.channel("/fmu/out/VehicleGpsPosition")
    assert (gps["h_msl_m"][0], gps["h_ellipsoid_m"][0], gps["sigma_v_m"][0]) == (600, 580, 0.75)
    assert old["lat_rad"][0] == gps["lat_rad"][0]
    assert old["h_msl_m"][0] == 600.0
    assert "h_ellipsoid_m" not in old.columns  # 0 with a fix is missing
    attitude = log.channel("/fmu/out/VehicleAttitude")
    assert [attitude[f"q_{axis}"][0] for axis in "wxyz"] == [0.5, 0.5, -0.5, 0.5]
    assert log.channel("/fmu/out/VehicleAirData")["pressure_pa"][0] == 70_025.0
    assert log.channel("/fmu/out/SensorHygrometer")["relative_humidity"][0] == pytest.approx(0.45)
    assert "GNSS" in log.time_base


def test_px4_without_utc_is_set_by_the_recorder_and_says_so(tmp_path: Path) -> None:
    log = px4_log(tmp_path / "px4.mcap", utc=False)
    attitude = log.channel("/fmu/out/VehicleAttitude")
    assert attitude.time_ns[0] == START + 60 * SECOND + 3_000_000
    assert {e.kind for e in log.ledger if e.code == "TIME-LOG-TIME"} == {"fallback"}
    assert "recorder" in log.time_base
