"""Every cell of MCAP messages, as mcap-ros2-support and protobuf decode them one by one."""

import random
import struct
import sys
from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.ingest.mcap.protobuf_messages import message_class
from tests.ingest.written_logs import McapWriter, RosWriter, entry_in
from tests.logs import with_suffix
from unbend.ingest import open_log
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


def library_messages(path) -> dict[str, list[Any]]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    messages = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            messages[channel.topic].append(message)
    return messages


def follow(message, path):
    for part in path.split("."):
        if hasattr(message, "__getitem__") and part.isdigit():
            message = message[int(part)]
        else:  # the library reads the byte of an empty message and does not keep it
            message = getattr(message, part, 0)
    return list(message) if isinstance(message, bytes) else message


def compare(table: dict[str, np.ndarray], messages):
    """Compare the columns of a table with messages of the library; how many cells that is."""
    cells = 0
    for name in table.keys() - {"time_ns", "boot", "log_time_ns"}:
        ours = table[name]
        theirs = [follow(message, name.removesuffix("[]")) for message in messages]
        if name.endswith("[]"):
            theirs = [len(sequence) for sequence in theirs]
        if ours.dtype.kind == "f":
            assert ours.tobytes() == np.array(theirs, ours.dtype).tobytes(), name
        else:
            assert ours.tolist() == theirs, name
        cells += ours.size
    return cells


@pytest.mark.parametrize(
    "path",
    with_suffix(".mcap"),
    ids=lambda path: path.name,
)
def test_every_cell_is_the_librarys(path, record_property):
    log = open_log(path)
    expected = library_messages(path)
    assert log.message_types() == {topic: len(rows) for topic, rows in expected.items()}
    cells = sum(compare(log.message(topic), rows) for topic, rows in expected.items())
    assert cells > 100_000
    record_property("cells compared", cells)


def text(draw):
    return "".join(draw.choice("abcdeé") for _ in range(draw.randrange(6)))


def varying_message(draw):
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


def test_layouts_that_vary_from_message_to_message(opened):
    draw = random.Random(1)
    bag = RosWriter(chunk_size=20_000)
    bag.define("pkg/M", VARYING)
    bag.define("std_msgs/Float64", "float64 data")
    for k in range(400):
        bag.write("/varying", "pkg/M", START + k, **varying_message(draw))
        bag.write("/plain", "std_msgs/Float64", START + k, data=draw.random())
    for k in range(400):
        stamp = START + k * SECOND
        name = text(draw)
        bag.write("/air", "sensor_msgs/FluidPressure", stamp, frame_id=name, fluid_pressure=9e4 - k)
    log = opened(bag.data)
    expected = library_messages(log.path)
    assert sum(compare(log.message(topic), expected[topic]) for topic in expected) > 4000
    assert_array_equal(log.channel("/air")["pressure_pa"], 9e4 - np.arange(400))


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders(order):
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
    assert_array_equal(done, k)
    assert_array_equal(table["x"], k / 3)
    assert_array_equal(
        table["n"],
        np.stack([k, -k, np.full(18, 7)], axis=1),
    )
    assert_array_equal(table["z"], k)
    assert table["s"].tolist() == ["abcdefg"[: n % 7] for n in k]
    assert "f" not in table
    assert_array_equal(table["f[]"], k % 3)


NESTED = "".join(f"===\nMSG: a/A{k}\na/A{k + 1}[4000] x\n" for k in range(12))


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        ("float64", "is not a field"),
        ("wstring x", "x is a wstring"),
        ("Nothing n", "definition of a/Nothing is missing"),
        ("a/B b", "messages deep"),
        ("!!", "is not a field"),
        ("P[99999] p\n===\nMSG: a/P\nint8 x", "elements|fields"),
        (f"a/A0[4000] x\nfloat64 y\n{NESTED}===\nMSG: a/A12\nfloat64 z\n", "4096"),
        ("float64[3000000000] v", "elements"),
        (f"float64[{'9' * 30}] v", "elements"),
    ],
)
def test_definitions_that_make_no_sense(definition, words):
    """Arrays that multiply, or are longer than any message, are refused before they are made."""
    with pytest.raises(SchemaError, match=words):
        steps_of("a/msg/B", definition)


def test_a_length_of_more_digits_than_python_reads_is_refused():
    with pytest.raises(ValueError, match="digits"):
        steps_of("a/msg/B", f"float64[{'9' * 5000}] v")


def location_fix():
    fields = {
        "latitude": "DOUBLE",
        "longitude": "DOUBLE",
        "altitude": "DOUBLE",
        "position_covariance": "DOUBLE*",
        "position_covariance_type": "INT32",
        "timestamp": "Timestamp",
        "frame_id": "STRING",
    }
    return message_class("foxglove.LocationFix", fields)


def test_protobuf_of_foxglove(tmp_path):
    from mcap_protobuf.writer import Writer

    kind = location_fix()
    latitudes = 47.0 + np.arange(300) / 3e6
    longitudes = -122.0 - np.arange(300) / 7e6
    altitudes = 580.0 + np.arange(300) / 9.0
    path = tmp_path / "fix.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        for k in range(300):
            fix = kind(
                frame_id="gps",
                latitude=latitudes[k],
                longitude=longitudes[k],
                altitude=altitudes[k],
                position_covariance=[4, 0, 0, 0, 2, 0, 0, 0, 9],
                position_covariance_type=2,
            )
            fix.timestamp.seconds, fix.timestamp.nanos = divmod(START + k * SECOND // 5, SECOND)
            writer.write_message("/fix", fix, START + k, START + k)
        writer.finish()
    log = open_log(path)
    fix = log.channel("/fix")
    table = log.message("/fix")
    assert_array_equal(fix.time_ns, START + np.arange(300) * SECOND // 5)
    assert_array_equal(table["latitude"], latitudes)
    assert_array_equal(table["longitude"], longitudes)
    assert_array_equal(fix["lat_rad"], np.radians(latitudes))
    assert_array_equal(fix["lon_rad"], np.radians(longitudes))
    assert_array_equal(fix["h_ellipsoid_m"], altitudes)
    assert_array_equal(fix["sigma_v_m"], np.full(300, 3.0))
    assert table["frame_id"].tolist() == ["gps"] * 300
    assert fix.roles == ("height", "position")
    assert not log.ledger.has_losses


def test_without_the_protobuf_library_its_topics_are_a_stated_loss(tmp_path, monkeypatch):
    from mcap_protobuf.writer import Writer

    path = tmp_path / "fix.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.write_message("/fix", location_fix()(latitude=1.0), START, START)
        writer.finish()
    monkeypatch.setitem(sys.modules, "mcap_protobuf.decoder", None)
    with refused("LOG-NO-MESSAGES"):
        open_log(path)
    log = open_log(path, needs_channels=False)
    assert [(entry.code, entry.where) for entry in log.ledger] == [("LOG-NO-PROTOBUF", "/fix")]


TIMES_OF_ONE_MOMENT = [
    {"sec": START // SECOND, "nsec": 5 * 10**8},
    START // SECOND + 0.5,
    "2025-11-13T22:32:49.500Z",
    "2025-11-13T23:32:49.5+01:00",
    START // 10**6 + 500,
]


@pytest.mark.parametrize("timestamp", TIMES_OF_ONE_MOMENT, ids=str)
def test_json_with_times_of_any_form(opened, timestamp):
    writer = McapWriter()
    channel = writer.channel("/fix", "json", "foxglove.LocationFix", "{}")
    place = {"latitude": 47.5, "longitude": -122.5, "altitude": 580.0}
    writer.write(channel, START, {"timestamp": timestamp} | place)
    assert opened(writer.data).channel("/fix").time_ns.tolist() == [START + 5 * 10**8]


def test_json_of_nobodys_schema_is_a_channel_of_its_numbers(opened):
    writer = McapWriter()
    channel = writer.channel("/cabin", "json", "acme.Reading", "{}")
    first = {"timestamp": TIMES_OF_ONE_MOMENT[0], "value": 21.5, "unit": "degC"}
    second = {"timestamp": {"sec": START // SECOND, "nsec": 6 * 10**8}}
    for content in (first, second, b"[1]", b"{broken"):
        writer.write(channel, START, content)
    fixes = writer.channel("/fix", "json", "foxglove.LocationFix", "{}")
    writer.write(
        fixes,
        START,
        {"timestamp": START // SECOND, "latitude": 47.5, "longitude": 8.25},
    )
    log = opened(writer.data)
    cabin = log.channel("/cabin")
    assert_array_equal(cabin["value"], [21.5, np.nan])
    assert cabin.roles == ()
    assert log.message("/cabin")["unit"].tolist() == ["degC", ""]
    undecoded = entry_in(log, "LOG-DECODE")
    assert undecoded.where == "/cabin"
    assert undecoded.count == 2
    assert log.messages["/cabin"] == 4
