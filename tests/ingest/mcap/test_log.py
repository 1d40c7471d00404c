"""MCAP: messages written with the real writers, a real log, and damage."""

import random
import re
import struct
import tracemalloc
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from numpy.testing import assert_allclose, assert_array_equal

from tests.faults.hostile import packed_chunk, packed_zeros
from tests.helpers import refused, with_code
from tests.ingest.written_logs import (
    DEFINITIONS,
    HEADER,
    McapWriter,
    RosWriter,
    entry_in,
    loss_codes,
    with_parts,
)
from tests.logs import LOGS, at_hand
from unbend.ingest import open_log
from unbend.ingest.mcap.chunks import MAX_CHUNK, Chunk, inflate
from unbend.ingest.mcap.topics import MAX_NAMES

SECOND = 10**9
CDR = b"\0\1\0\0"  # little-endian
START = 1_763_073_169 * SECOND + 920_749_554
COMPRESSIONS = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
IMAGE = "sensor_msgs/CompressedImage"
PRESSURE = "sensor_msgs/FluidPressure"
TEMPERATURE = "sensor_msgs/Temperature"
HUMIDITY = "sensor_msgs/RelativeHumidity"


def flight(rows=60, **options):
    """A receiver, an attitude and air at 10 Hz, an image each second; recorded 7 ms late."""
    bag = RosWriter(chunk_size=4096, **options)
    for k in range(rows):
        t = START + k * SECOND // 10
        recorded = t + 7_000_000
        bag.write(
            "/fix",
            "sensor_msgs/NavSatFix",
            t,
            recorded,
            latitude=47.0 + 1e-4 * k,
            longitude=-122.5,
            altitude=580.25,
            status={"status": -1 if k < 2 else 0},
            position_covariance=[4.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 9.0],
            position_covariance_type=2,
        )
        bag.write(
            "/imu",
            "sensor_msgs/Imu",
            t,
            recorded,
            orientation={"w": 1.0},
            orientation_covariance=[-1.0 if k == 3 else 0.0],
        )
        bag.write("/outside/pressure", PRESSURE, t, recorded, fluid_pressure=7e4 - k)
        bag.write("/cabin/pressure", PRESSURE, t, recorded, fluid_pressure=8.5e4)
        bag.write("/outside/air", TEMPERATURE, t, recorded, temperature=-12.5)
        bag.write("/outside/humidity", HUMIDITY, t, recorded, relative_humidity=0.45)
        bag.write("/note", "std_msgs/String", t, recorded, data="nothing of ours")
        if k % 10 == 0:
            bag.write(
                "/camera",
                IMAGE,
                t,
                recorded,
                frame_id=f"cam{k}",
                data=bytes(3000),
            )
    return bag


@pytest.mark.parametrize(
    "compression",
    COMPRESSIONS,
    ids=lambda kind: kind.name,
)
def test_known_flight(opened, compression):
    log = opened(flight(compression=compression).data)
    assert log.messages["/fix"] == log.messages["/note"] == 60
    fix = log.channel("/fix")
    assert len(fix) == 58
    assert fix.roles == ("height", "position")
    assert with_code(log.ledger, "POSITION-NO-FIX")[0].count == 2
    assert_array_equal(
        fix["lat_rad"],
        np.radians(47.0 + 1e-4 * np.arange(2, 60)),
    )
    assert_array_equal(fix["h_ellipsoid_m"], np.full(58, 580.25))
    assert_allclose(fix["sigma_h_m"], np.sqrt(3.0), rtol=1e-15)
    assert_array_equal(fix["sigma_v_m"], np.full(58, 3.0))
    # the time is that of the header, not that of the recorder 7 ms later
    assert_array_equal(
        fix.time_ns,
        START + np.arange(2, 60) * SECOND // 10,
    )
    assert np.flatnonzero(np.isnan(log.channel("/imu")["q_w"])).tolist() == [3]
    pressures = log.channel("/outside/pressure")["pressure_pa"]
    assert_array_equal(pressures, 7e4 - np.arange(60))
    assert log.channel("/cabin/pressure").roles == ("pressure", "cabin_pressure")
    assert log.channel("/outside/humidity")["relative_humidity"][0] == 0.45
    images = log.channel("/camera")
    assert_array_equal(images["event_index"], np.arange(6))
    assert images.labels["frame_id"] == tuple(f"cam{k}" for k in range(0, 60, 10))
    assert_array_equal(images.time_ns, START + np.arange(6) * SECOND)
    assert log.bad_bytes == 0
    assert log.lost_messages == 0
    assert log.boots == 1
    assert not log.ledger.has_losses


def test_the_pose_of_a_real_flight_is_an_attitude(real_log):
    log = open_log(real_log("cubs2_cub_stabilize.mcap"))
    assert log.channel("/cub1/pose").roles == ("attitude",)


def test_a_chunk_that_fails_its_checksum_is_left_out(opened):
    data = bytearray(flight(compression=CompressionType.NONE).data)
    data[data.index(b"nothing of ours", 20_000)] ^= 1
    log = opened(bytes(data))
    assert with_code(log.ledger, "LOG-CRC")
    assert entry_in(log, "LOG-INCONSISTENT").count == log.lost_messages > 0


@pytest.mark.parametrize("place", ["image", "checksum"])
def test_the_checksum_of_a_chunk_over_16_mib_is_compared(opened, place):
    """One bit is flipped in an image of 20 MiB, or in the checksum of the chunk that holds it."""
    bag = flight()
    bag.write(
        "/camera",
        IMAGE,
        START + 9 * SECOND,
        data=random.Random(1).randbytes(20 << 20),
    )
    data = bytearray(bag.data)
    whole = opened(data)
    assert not whole.ledger.has_losses
    chunks = re.finditer(b"\x04\0\0\0zstd(.{8})", data, re.DOTALL)  # behind a checksum
    large = 20 << 20
    head = next(match.start() for match in chunks if int.from_bytes(match[1], "little") > large)
    data[head - 2 if place == "checksum" else head + (10 << 20)] ^= 4
    log = opened(bytes(data))
    assert with_code(log.ledger, "LOG-CRC")
    assert log.messages["/camera"] == whole.messages["/camera"] - 1
    assert len(log.channel("/imu")) > 50


@pytest.mark.parametrize("behind", [b"", b"\0", b"trailing"])
def test_bytes_behind_an_lz4_frame_cost_nothing(behind):
    import lz4.frame

    packed = lz4.frame.compress(bytes(1000)) + behind
    chunk = Chunk(
        0,
        0,
        1000,
        0,
        "lz4",
        0,
        len(packed),
        0,
    )
    assert inflate(packed, chunk, where="a.mcap, byte 0", count=1000) == bytes(1000)


def spliced(data, record):
    """A file with one more record behind its header record."""
    header_end = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    return data[:header_end] + record + data[header_end:]


@pytest.mark.parametrize(
    ("compression", "promised", "size", "code"),
    [
        ("zstd", MAX_CHUNK, 2 << 30, "LOG-TOO-LARGE"),
        ("lz4", 2**63, 2 << 30, "LOG-TOO-LARGE"),
        ("zstd", 64 << 20, 2 << 30, "LOG-BAD-BYTES"),
        ("lz4", 1000, 2 << 30, "LOG-BAD-BYTES"),
        ("zstd", 65 << 20, 65 << 20, "LOG-TOO-LARGE"),
        ("lz4", 65 << 20, 65 << 20, "LOG-TOO-LARGE"),
    ],
    ids=[
        "as large as no chunk may be",
        "larger than any file",
        "more than is promised",
        "far more than is promised",
        "shrunk too far for zstd",
        "shrunk too far for lz4",
    ],
)
def test_a_bomb_is_skipped(opened, compression, promised, size, code):
    """How soon, and with how little memory, is tested with the faults."""
    bomb = packed_chunk(compression, promised, packed_zeros(compression, size))
    log = opened(spliced(flight().data, bomb))
    # the record moved the summary, whose place is under its checksum
    assert loss_codes(log) == {"LOG-CRC", code}
    assert len(log.channel("/imu")) == 60


def test_chunks_that_are_each_free_share_one_budget(opened):
    """Of 256 MiB, in which each counts twice; that they hold less is seen when it is too late."""
    claim = packed_chunk("zstd", 60 << 20, packed_zeros("zstd", 1 << 20))
    log = opened(spliced(flight().data, 3 * claim))
    assert "all chunks of a file" in entry_in(log, "LOG-TOO-LARGE").what
    assert loss_codes(log) == {"LOG-CRC", "LOG-BAD-BYTES", "LOG-TOO-LARGE"}
    assert len(log.channel("/imu")) == 60


@pytest.mark.parametrize("size", [1000, 20 << 20])
def test_a_window_of_128_mib_is_not_looked_back_over(opened, size):
    import zstandard

    inner = struct.pack("<BQ", 0x80, size - 9) + bytes(size - 9)
    wide = zstandard.ZstdCompressionParameters.from_level(1, window_log=27)
    packer = zstandard.ZstdCompressor(compression_params=wide).compressobj()
    packed = packer.compress(inner) + packer.flush()
    log = opened(spliced(flight().data, packed_chunk("zstd", size, packed)))
    assert entry_in(log, "LOG-BAD-BYTES").kind == "loss"
    assert len(log.channel("/imu")) == 60


def place(time_ns):
    """A foxglove.LocationFix."""
    return {"timestamp": time_ns, "latitude": 47.5, "longitude": 8.25}


@pytest.mark.parametrize("statistics", [False, True])
def test_messages_that_a_recorder_missed_show_by_their_numbers(opened, statistics):
    writer = McapWriter(use_statistics=statistics)
    channel = writer.channel("/fix", "json", "foxglove.LocationFix", "{}")
    for k in [*range(40), *range(50, 100)]:
        time_ns = START + k * SECOND
        writer.write(channel, time_ns, place(time_ns), k)
    log = opened(writer.data)
    assert log.lost_messages == 10
    entry = entry_in(log, "LOG-LINK-LOSS")
    assert entry.kind == "finding"
    assert entry.count == 10
    assert bool(with_code(log.ledger, "LOG-NO-STATISTICS")) is not statistics


def test_log_time_0_takes_nothing_from_messages_with_a_stamp(opened):
    """Recorders exist that write 0 throughout (foxglove_tutorial)."""
    writer = McapWriter()
    fixes = writer.channel("/fix", "json", "foxglove.LocationFix", "{}")
    bare = writer.channel("/bare", "json", "foxglove.LocationFix", "{}")
    for k in range(10):
        writer.write(fixes, 0, place(START + k * SECOND))
        writer.write(bare, 0, place(0))
    log = opened(writer.data)
    assert_array_equal(
        log.channel("/fix").time_ns,
        START + np.arange(10) * SECOND,
    )
    fallbacks = {entry.code: entry.where for entry in log.ledger if entry.kind == "fallback"}
    assert fallbacks == {"TIME-LOG-TIME": "/bare", "TIME-NO-UTC": "/bare"}


def mavros_log(opened, kind, definition, rows: list[dict[str, Any]]):
    bag = RosWriter()
    bag.define(f"mavros_msgs/{kind}", HEADER + definition)
    for k, row in enumerate(rows):
        bag.write("/mavros/one", f"mavros_msgs/{kind}", START + k * SECOND, **row)
    return opened(bag.data)


def test_values_of_different_names_are_channels_of_their_own(opened):
    rows = []
    for k in range(5):
        rows += [
            {"index": -1, "name": "CabT", "value_float": 20.0 + k, "type": 3},
            {"index": -1, "name": "CabRH", "value_float": 44.0, "type": 3},
            {"index": -1, "name": "Count", "value_int": 70 + k, "type": 4},
            {"index": 7, "name": "", "value_float": 1.5, "type": 0},
        ]
    definition = "int32 index\nstring name\nfloat32 value_float\nint32 value_int\nuint8 type"
    log = mavros_log(opened, "DebugValue", definition, rows)
    values = {channel.name: channel["value"].tolist() for channel in log.channels}
    assert values == {
        "/mavros/one[7]": [1.5] * 5,
        "/mavros/one[CabRH]": [44.0] * 5,
        "/mavros/one[CabT]": [20.0, 21.0, 22.0, 23.0, 24.0],
        "/mavros/one[Count]": [70.0, 71.0, 72.0, 73.0, 74.0],
    }
    assert log.channel("/mavros/one[CabT]").source.instance == "CabT"
    assert log.message("/mavros/one", "CabT")["value_float"].tolist() == values["/mavros/one[CabT]"]
    assert log.message("/mavros/one")["name"].shape == (20,)
    with refused("LOG-NO-TABLE"):
        log.message("/mavros/one", "Cab")


def test_names_without_end_are_a_loss(opened):
    rows = [{"name": f"n{k}", "value_float": 1.0} for k in range(MAX_NAMES + 8)]
    log = mavros_log(opened, "DebugValue", "string name\nfloat32 value_float", rows)
    assert len(log.channels) == MAX_NAMES
    entry = entry_in(log, "LOG-TOO-LARGE")
    assert entry.kind == "loss"
    assert entry.count == 8


def test_images_of_mavros_are_numbered_where_it_numbers_none(opened):
    """Its plugin leaves image_index and capture_result at 0, and adds the undulation."""
    row = {"geo": {"latitude": 47.5, "longitude": 8.25, "altitude": 647.5}}
    definition = "geographic_msgs/GeoPoint geo\nint32 image_index\nint8 capture_result"
    log = mavros_log(opened, "CameraImageCaptured", definition, [row] * 4)
    shots = log.channel("/mavros/one")
    assert shots["event_index"].tolist() == [0, 1, 2, 3]
    assert shots["h_ellipsoid_m"].tolist() == [647.5] * 4
    assert "h_msl_m" not in shots.columns
    assert entry_in(log, "EVENT-NO-INDEX").kind == "note"


@pytest.mark.parametrize(
    "compression",
    COMPRESSIONS,
    ids=lambda kind: kind.name,
)
def test_large_images_cost_no_memory_and_no_messages(opened, compression):
    pixels = random.Random(1).randbytes(1 << 20) * 81  # mono8 10600 x 8000
    bag = RosWriter(compression=compression)
    for k in range(60):
        t = START + k * SECOND // 10
        if k % 40 == 5:
            bag.write(
                "/camera",
                IMAGE,
                t,
                frame_id=f"cam{k}",
                format="mono8",
                data=pixels,
            )
        bag.write("/air", PRESSURE, t, fluid_pressure=7e4 - k)
    data = bag.data
    tracemalloc.start()
    log = opened(data)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 24 << 20
    assert not log.ledger.has_losses
    assert_array_equal(
        log.channel("/air")["pressure_pa"],
        7e4 - np.arange(60),
    )
    assert log.channel("/camera").labels["frame_id"] == ("cam5", "cam45")


def test_a_clock_set_back_in_the_recording_mixes_nothing(opened):
    bag = RosWriter(chunk_size=4096)
    for k in range(400):
        set_back = 10 * SECOND if k >= 300 else 0
        t = START + k * SECOND // 10 - set_back
        bag.write("/air", PRESSURE, t, fluid_pressure=7e4 - k)
        if k % 4 == 0:
            bag.write("/camera", IMAGE, t, frame_id=f"{k}")
    log = opened(bag.data)
    air = log.channel("/air")
    camera = log.channel("/camera")
    # 20 to 30 s were passed twice: the later rows stand for them, and nothing bridges the step
    assert_array_equal(
        7e4 - air["pressure_pa"],
        [*range(200), *range(300, 400)],
    )
    assert_array_equal(air.boot, [0] * 200 + [1] * 100)
    shots = [*range(0, 200, 4), *range(300, 400, 4)]
    assert [int(name) for name in camera.labels["frame_id"]] == shots
    # an image keeps its number when images before it are lost
    assert_array_equal(4 * camera["event_index"], shots)
    of_air, of_camera = with_code(log.ledger, "TIME-BACKWARD")
    assert of_air.kind == of_camera.kind == "loss"
    assert of_air.count == 100
    assert of_camera.count == 25
    assert "/air, first at row 200" in of_air.where
    assert {entry.kind for entry in with_code(log.ledger, "TIME-SET-BACK")} == {"warning"}


def test_without_a_header_stamp_the_recorders_time_is_a_stated_fallback(opened):
    bag = RosWriter()
    for k in range(5):
        bag.write(
            "/air",
            TEMPERATURE,
            0,
            START + k,
            temperature=20.0,
        )
    log = opened(bag.data)
    assert_array_equal(
        log.channel("/air").time_ns,
        START + np.arange(5),
    )
    assert entry_in(log, "TIME-LOG-TIME").kind == "fallback"


def fifteen_degrees():
    """A Temperature in CDR: little-endian, sec, nanosec, frame_id "" and padding, two float64."""
    header = struct.pack("<iII", 1_763_073_169, 5, 1) + b"\0" + bytes(3)
    return CDR + header + struct.pack("<dd", 15.0, 0.0)


def temperatures(writer):
    definition = with_parts(DEFINITIONS[TEMPERATURE])
    return writer.channel("/air", "cdr", "sensor_msgs/msg/Temperature", definition)


def test_an_instance_that_is_not_there_is_not_told_as_messages_that_do_not_fit(opened):
    writer = McapWriter()
    definition = "string name\nfloat32 value_float"
    debug = writer.channel("/debug", "cdr", "mavros_msgs/msg/DebugValue", definition)
    writer.write(debug, START, CDR + struct.pack("<I8sf", 5, b"CabT", 20.0))
    writer.write(debug, START, CDR + b"\xff\xff\xff\xff")
    log = opened(writer.data)
    assert entry_in(log, "LOG-DECODE").count == 1
    assert log.message("/debug", "CabT")["value_float"].tolist() == [20.0]
    with refused("LOG-NO-TABLE") as caught:
        log.message("/debug", "Cab")
    assert "/debug, instance Cab, has no rows" in str(caught.value)
    assert "decoded" not in str(caught.value)


def test_a_schema_that_cannot_be_parsed_costs_its_topic(opened):
    writer = McapWriter()
    odd = writer.channel("/odd", "cdr", "sensor_msgs/msg/FluidPressure", "wstring name")
    writer.write(
        odd,
        START,
        CDR + b"abc",
    )
    writer.write(temperatures(writer), START, fifteen_degrees())
    mine = writer.channel("/mine", "cdr", "my/msg/Bar", "wstring w")  # a table alone
    writer.write(mine, START, bytes(12))
    log = opened(writer.data)
    entry = entry_in(log, "LOG-SCHEMA")
    assert entry.kind == "loss"
    assert entry.where == "/odd"
    assert "name is a wstring" in entry.what
    with refused("LOG-NO-TABLE", says="the schema of sensor_msgs/FluidPressure"):
        log.message("/odd")
    with refused("LOG-NO-TABLE", says="w is a wstring"):
        log.message("/mine")


def test_ros_1_is_counted_and_not_read(opened):
    writer = McapWriter()
    ros_1 = writer.channel("/one", "ros1", "sensor_msgs/NavSatFix", "float64 latitude", "ros1msg")
    for k in range(3):
        writer.write(ros_1, START + k, bytes(8))
    writer.write(temperatures(writer), START, fifteen_degrees())
    log = opened(writer.data)
    assert log.messages["/one"] == 3
    assert entry_in(log, "LOG-NOT-ROS2").where == "/one"
    assert log.channel("/air").time_ns[0] == 1_763_073_169 * SECOND + 5
    assert log.channel("/air")["temperature_k"][0] == 288.15


@pytest.mark.parametrize(
    ("encoding", "definitions"),
    [("ros1", "ros1msg"), ("cdr", "ros2idl"), ("cdr", "omgidl"), ("cbor", ""), ("", "flatbuffer")],
)
def test_a_refusal_names_the_encodings_that_are_not_read(opened, encoding, definitions):
    writer = McapWriter()
    channel = writer.channel("/fix", encoding, "sensor_msgs::msg::NavSatFix", "x", definitions)
    writer.write(channel, START, bytes(8))
    with refused("LOG-NO-MESSAGES") as caught:
        opened(writer.data)
    named = f"{encoding or 'no encoding'} with {definitions or 'no'} definitions (/fix)"
    assert named in caught.value.what


@pytest.mark.parametrize("end", ["lost", "zero"])
@pytest.mark.parametrize("part", ["first byte", "mark", "header", "quarter"])
@pytest.mark.parametrize("name", at_hand("flight.mcap", "cubs2_cub_stabilize.mcap"))
def test_a_file_whose_head_is_lost(opened, name, part, end):
    """Chunks behind the damage are whole: what they hold is the same, and the loss is told."""
    data = LOGS[name].read_bytes()
    counts = {
        "first byte": 1,
        "mark": 8,
        "header": 60,
        "quarter": len(data) // 4,
    }
    count = counts[part]
    log = opened((bytes(count) if end == "zero" else b"") + data[count:])
    expected = open_log(LOGS[name])
    assert [c.name for c in log.channels] == [c.name for c in expected.channels]
    for ours, theirs in zip(log.channels, expected.channels, strict=True):
        rows = np.isin(theirs.time_ns, ours.time_ns)
        assert_array_equal(ours.time_ns, theirs.time_ns[rows])
        for column in ours.columns.keys() - {"event_index"}:  # from the first that is there
            assert_array_equal(ours[column], theirs[column][rows], column)
        assert rows.all() or part == "quarter"
    read = sum(log.messages.values()) / sum(expected.messages.values())
    assert read > 0.7 if part == "quarter" else read == 1.0
    assert log.ledger.has_losses
    assert "first bytes" in with_code(log.ledger, "LOG-BAD-BYTES")[0].what
