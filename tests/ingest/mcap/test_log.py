"""MCAP: messages written with the real writers, a real log, and damage."""

from __future__ import annotations

import io
import random
import re
import struct
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.ingest import Log, open_log
from unbend.ingest.mcap.chunks import MAX_CHUNK, Chunk, inflate

SECOND = 10**9
START = 1_763_073_169 * SECOND + 920_749_554

SEPARATOR = "\n" + "=" * 80 + "\n"
TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
STATUS = "MSG: sensor_msgs/NavSatStatus\nint8 status\nuint16 service"
QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z"
POSE = "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"

SCHEMAS = {
    "sensor_msgs/msg/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\n"
        "float64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
        "uint8 position_covariance_type",
        HEADER,
        TIME,
        STATUS,
    ),
    "sensor_msgs/msg/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\n"
        "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity\n"
        "float64[9] angular_velocity_covariance\ngeometry_msgs/Vector3 linear_acceleration\n"
        "float64[9] linear_acceleration_covariance",
        HEADER,
        TIME,
        QUATERNION,
        VECTOR,
    ),
    "sensor_msgs/msg/FluidPressure": (
        "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance",
        HEADER,
        TIME,
    ),
    "sensor_msgs/msg/Temperature": (
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
        HEADER,
        TIME,
    ),
    "sensor_msgs/msg/RelativeHumidity": (
        "std_msgs/Header header\nfloat64 relative_humidity\nfloat64 variance",
        HEADER,
        TIME,
    ),
    "sensor_msgs/msg/CompressedImage": (
        "std_msgs/Header header\nstring format\nuint8[] data",
        HEADER,
        TIME,
    ),
    "geometry_msgs/msg/PoseStamped": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        HEADER,
        TIME,
        POSE,
        POINT,
        QUATERNION,
    ),
    "std_msgs/msg/String": ("string data",),
}


def stamp(time_ns: int, frame_id: str = "base") -> dict:
    sec, nanosec = divmod(time_ns, SECOND)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


class Bag:
    """A ROS 2 bag in memory, by the writer of mcap-ros2-support."""

    def __init__(self, **options) -> None:
        from mcap_ros2.writer import Writer

        self.file = io.BytesIO()
        self.writer = Writer(self.file, chunk_size=4096, **options)
        self.schemas = {
            name: self.writer.register_msgdef(name, SEPARATOR.join(parts))
            for name, parts in SCHEMAS.items()
        }

    def write(self, topic: str, kind: str, time_ns: int, log_time: int = 0, **fields) -> None:
        fields.setdefault("header", stamp(time_ns))
        schema = next(schema for name, schema in self.schemas.items() if name.endswith(kind))
        self.writer.write_message(topic, schema, fields, log_time or time_ns + 7_000_000)

    @property
    def data(self) -> bytes:
        self.writer.finish()
        return self.file.getvalue()


def flight(rows: int = 60, **options) -> Bag:
    bag = Bag(**options)
    for k in range(rows):
        t = START + k * SECOND // 10
        bag.write(
            "/fix",
            "NavSatFix",
            t,
            latitude=47.0 + 1e-4 * k,
            longitude=-122.5,
            altitude=580.25,
            status={"status": -1 if k < 2 else 0, "service": 1},
            position_covariance=[4.0, 0, 0, 0, 2.0, 0, 0, 0, 9.0],
            position_covariance_type=2,
        )
        bag.write(
            "/imu",
            "Imu",
            t,
            orientation={"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            orientation_covariance=[-1.0 if k == 3 else 0.0] + [0.0] * 8,
            angular_velocity={"x": 0.0, "y": 0.0, "z": 0.0},
            angular_velocity_covariance=[0.0] * 9,
            linear_acceleration={"x": 0.0, "y": 0.0, "z": 0.0},
            linear_acceleration_covariance=[0.0] * 9,
        )
        bag.write("/outside/pressure", "FluidPressure", t, fluid_pressure=7e4 - k, variance=1.0)
        bag.write("/cabin/pressure", "FluidPressure", t, fluid_pressure=8.5e4, variance=1.0)
        bag.write("/outside/air", "Temperature", t, temperature=-12.5, variance=0.0)
        bag.write("/outside/humidity", "RelativeHumidity", t, relative_humidity=0.45, variance=0.0)
        bag.write("/note", "String", t, data="nothing of ours")
        if k % 10 == 0:
            bag.write(
                "/camera",
                "CompressedImage",
                t,
                header=stamp(t, f"cam{k}"),
                format="jpeg",
                data=bytes(3000),
            )
    return bag


def opened(tmp_path: Path, data: bytes) -> Log:
    path = tmp_path / "flight.mcap"
    path.write_bytes(data)
    return open_log(path)


def entries(log: Log, code: str) -> list:
    return [entry for entry in log.ledger if entry.code == code]


def compressions() -> list:
    from mcap.writer import CompressionType

    return [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]


@pytest.mark.parametrize("compression", compressions(), ids=lambda kind: kind.name)
def test_known_flight(tmp_path: Path, compression: object) -> None:
    log = opened(tmp_path, flight(compression=compression).data)
    assert log.messages["/fix"] == log.messages["/note"] == 60
    fix = log.channel("/fix")
    assert (len(fix), fix.roles) == (58, ("height", "position"))
    assert entries(log, "POSITION-NO-FIX")[0].count == 2
    np.testing.assert_array_equal(fix["lat_rad"], np.radians(47.0 + 1e-4 * np.arange(2, 60)))
    np.testing.assert_array_equal(fix["h_ellipsoid_m"], np.full(58, 580.25))
    np.testing.assert_allclose(fix["sigma_h_m"], np.sqrt(3.0), rtol=1e-15)
    np.testing.assert_array_equal(fix["sigma_v_m"], np.full(58, 3.0))
    # the time is that of the header, not that of the recorder 7 ms later
    np.testing.assert_array_equal(fix.time_ns, START + np.arange(2, 60) * SECOND // 10)
    imu = log.channel("/imu")
    assert np.isnan(imu["q_w"][3])
    np.testing.assert_allclose(  # x forward, facing east: heading 90 degrees
        [imu[f"q_{axis}"][0] for axis in "wxyz"], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-15
    )
    np.testing.assert_array_equal(
        log.channel("/outside/pressure")["pressure_pa"], 7e4 - np.arange(60)
    )
    assert log.channel("/cabin/pressure").roles == ("pressure", "cabin_pressure")
    assert log.channel("/outside/air")["temperature_k"][0] == 273.15 - 12.5
    assert log.channel("/outside/humidity")["relative_humidity"][0] == 0.45
    images = log.channel("/camera")
    np.testing.assert_array_equal(images["event_index"], np.arange(6))
    assert images.labels["frame_id"] == tuple(f"cam{k}" for k in range(0, 60, 10))
    np.testing.assert_array_equal(images.time_ns, START + np.arange(6) * SECOND)
    assert (log.bad_bytes, log.lost_messages, log.boots) == (0, 0, 1)
    assert not log.ledger.has_losses


def test_real_flight(real_log: Callable[[str], Path]) -> None:
    path = real_log("cubs2_cub_stabilize.mcap")
    log = open_log(path)
    assert dict(log.messages) == {"/cub1/joy_serial_status": 1555, "/cub1/pose": 19703}
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    pose = log.channel("/cub1/pose")
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for k, (_, _, _, message) in enumerate(reader.iter_decoded_messages(["/cub1/pose"])):
            if k == 500:
                break
            time = message.header.stamp
            assert pose.time_ns[k] == time.sec * SECOND + time.nanosec
            assert pose["east_m"][k] == message.pose.position.x
            assert pose["up_m"][k] == message.pose.position.z
    assert pose.roles == ("attitude",)


def test_a_truncated_log_gives_every_complete_chunk(tmp_path: Path) -> None:
    data = flight(200).data
    whole = sum(opened(tmp_path, data).messages.values())
    log = opened(tmp_path, data[: len(data) // 2])
    assert whole * 0.3 < sum(log.messages.values()) < whole
    cut = entries(log, "LOG-TRUNCATED")[0]
    assert (cut.kind, "without the footer" in cut.what) == ("loss", True)
    assert log.bad_bytes > 0


def outcome(tmp_path: Path, data: bytes) -> str:
    try:
        log = opened(tmp_path, data)
    except LogError as error:
        return error.code
    return "losses" if log.ledger.has_losses else "whole"


def test_every_truncation_opens_or_refuses(tmp_path: Path) -> None:
    data = flight(12).data
    outcomes = {outcome(tmp_path, data[:end]) for end in range(1, len(data), 211)}
    assert outcomes == {"LOG-FORMAT", "LOG-NO-MESSAGES", "losses"}
    assert outcome(tmp_path, data) == "whole"


def test_zeros_in_a_chunk_without_a_checksum_are_noticed(tmp_path: Path) -> None:
    from mcap.writer import CompressionType

    data = bytearray(flight(compression=CompressionType.NONE, enable_crcs=False).data)
    at = data.index(b"nothing of ours", 20_000)
    data[at : at + 500] = bytes(500)
    log = opened(tmp_path, bytes(data))
    assert log.lost_messages > 0
    assert entries(log, "LOG-INCONSISTENT")[0].kind == "loss"


def test_a_chunk_that_fails_its_checksum_is_left_out(tmp_path: Path) -> None:
    from mcap.writer import CompressionType

    data = bytearray(flight(compression=CompressionType.NONE).data)
    data[data.index(b"nothing of ours", 20_000)] ^= 1
    log = opened(tmp_path, bytes(data))
    assert entries(log, "LOG-CRC")
    assert entries(log, "LOG-INCONSISTENT")[0].count == log.lost_messages > 0


@pytest.mark.parametrize("place", ["image", "checksum"])
def test_the_checksum_of_a_chunk_over_16_mib_is_compared(tmp_path: Path, place: str) -> None:
    """One bit is flipped in an image of 20 MiB, or in the checksum of the chunk that holds it."""
    bag = flight()
    image = random.Random(1).randbytes(20 << 20)
    bag.write("/camera", "CompressedImage", START + 9 * SECOND, format="jpeg", data=image)
    data = bytearray(bag.data)
    whole = opened(tmp_path, data)
    assert not whole.ledger.has_losses
    heads = [match.start() for match in re.finditer(b"\x04\0\0\0zstd", data)]  # behind checksums
    head = next(k for k in heads if int.from_bytes(data[k + 8 : k + 16], "little") > 20 << 20)
    data[head - 2 if place == "checksum" else head + (10 << 20)] ^= 4
    log = opened(tmp_path, bytes(data))
    assert entries(log, "LOG-CRC")
    assert log.messages["/camera"] == whole.messages["/camera"] - 1
    assert len(log.channel("/imu")) > 50


@cache
def packed_zeros(compression: str, size: int) -> bytes:
    import lz4.frame
    import zstandard

    blocks = [bytes(1 << 20)] * (size >> 20)
    packer = (
        lz4.frame.LZ4FrameCompressor()
        if compression == "lz4"
        else zstandard.ZstdCompressor().compressobj()
    )
    begin = packer.begin() if compression == "lz4" else b""
    return begin + b"".join(packer.compress(block) for block in blocks) + packer.flush()


@pytest.mark.parametrize("behind", [b"", b"\0", b"trailing"])
def test_bytes_behind_an_lz4_frame_cost_nothing(behind: bytes) -> None:
    import lz4.frame

    packed = lz4.frame.compress(bytes(1000)) + behind
    chunk = Chunk(0, 0, 1000, 0, "lz4", 0, len(packed), 0)
    assert inflate(packed, chunk, where="a.mcap, byte 0", count=1000) == bytes(1000)


def bomb(compression: str, promised: int, size: int) -> bytes:
    """A chunk record of zeros that promises one size and inflates to another."""
    packed = packed_zeros(compression, size)
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 0, promised, 0, len(name)) + name
    content += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(content)) + content


def spliced(data: bytes, record: bytes) -> bytes:
    """A file with one more record behind its header record."""
    at = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    return data[:at] + record + data[at:]


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("promised", [2 << 30, 2**63, 64 << 20, 1000])
def test_bombs_are_skipped_at_once(
    tmp_path: Path, compression: str, promised: int, work_unit_s: float
) -> None:
    import tracemalloc

    path = tmp_path / "flight.mcap"
    path.write_bytes(spliced(flight().data, bomb(compression, promised, 2 << 30)))
    begin = time.process_time()
    log = open_log(path)
    assert time.process_time() - begin < 30.0 * work_unit_s
    codes = {entry.code for entry in log.ledger if entry.kind == "loss"}
    # the record moved the summary, whose place is under its checksum
    assert codes == {"LOG-CRC", "LOG-TOO-LARGE" if promised >= MAX_CHUNK else "LOG-BAD-BYTES"}
    assert len(log.channel("/imu")) == 60
    tracemalloc.start()
    open_log(path)
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_shrank_too_far_is_refused_above_the_free_size(
    tmp_path: Path, compression: str
) -> None:
    size = 65 << 20
    log = opened(tmp_path, spliced(flight().data, bomb(compression, size, size)))
    losses = {entry.code for entry in log.ledger if entry.kind == "loss"}
    assert losses == {"LOG-CRC", "LOG-TOO-LARGE"}


@pytest.mark.parametrize("size", [1 << 20, 16 << 20, 60 << 20])
def test_many_small_bombs_share_one_budget(tmp_path: Path, size: int, work_unit_s: float) -> None:
    """Each chunk is small enough to be free; together they claim 2 GiB."""
    records = bomb("zstd", size, size) * ((2 << 30) // size)
    path = tmp_path / "flight.mcap"
    path.write_bytes(spliced(flight().data, records))
    begin = time.process_time()
    log = open_log(path)
    taken = time.process_time() - begin
    refused = [entry for entry in entries(log, "LOG-TOO-LARGE") if entry.kind == "loss"]
    assert refused
    assert len(log.channel("/imu")) == 60
    assert taken < 30.0 * work_unit_s


@pytest.mark.parametrize("size", [1000, 20 << 20])
def test_a_window_of_128_mib_is_not_looked_back_over(tmp_path: Path, size: int) -> None:
    import zstandard

    inner = struct.pack("<BQ", 0x80, size - 9) + bytes(size - 9)
    wide = zstandard.ZstdCompressionParameters.from_level(1, window_log=27)
    packer = zstandard.ZstdCompressor(compression_params=wide).compressobj()
    packed = packer.compress(inner) + packer.flush()
    content = struct.pack("<QQQII", 0, 0, size, 0, 4) + b"zstd"
    content += struct.pack("<Q", len(packed)) + packed
    record = struct.pack("<BQ", 6, len(content)) + content
    log = opened(tmp_path, spliced(flight().data, record))
    assert [e.kind for e in entries(log, "LOG-BAD-BYTES")] == ["loss"]
    assert len(log.channel("/imu")) == 60


@pytest.mark.parametrize("statistics", [False, True])
def test_messages_that_a_recorder_missed_show_by_their_numbers(
    tmp_path: Path, statistics: bool
) -> None:
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file, use_statistics=statistics)
    writer.start(profile="", library="test")
    schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
    channel = writer.register_channel("/fix", "json", schema)
    for k in range(100):
        place = b'{"timestamp": %d, "latitude": 47.5, "longitude": 8.25}' % (START + k * SECOND)
        if not 40 <= k < 50:
            writer.add_message(channel, START + k * SECOND, place, 0, sequence=k)
    writer.finish()
    log = opened(tmp_path, file.getvalue())
    assert log.lost_messages == 10
    assert [(e.kind, e.count) for e in entries(log, "LOG-LINK-LOSS")] == [("finding", 10)]
    assert bool(entries(log, "LOG-NO-STATISTICS")) is not statistics


def test_log_time_0_takes_nothing_from_messages_with_a_stamp(tmp_path: Path) -> None:
    """Recorders exist that write 0 throughout (foxglove_tutorial)."""
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="test")
    for topic in ("/fix", "/bare"):
        schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for k in range(10):
            time_ns = START + k * SECOND if topic == "/fix" else 0
            place = b'{"timestamp": %d, "latitude": 47.5, "longitude": 8.25}' % time_ns
            writer.add_message(channel, 0, place, 0)
    writer.finish()
    log = opened(tmp_path, file.getvalue())
    np.testing.assert_array_equal(log.channel("/fix").time_ns, START + np.arange(10) * SECOND)
    said = {entry.code: entry.where for entry in log.ledger if entry.kind == "fallback"}
    assert said == {"TIME-LOG-TIME": "/bare", "TIME-NO-UTC": "/bare"}


def mavros_log(tmp_path: Path, kind: str, definition: str, rows: list[dict]) -> Log:
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    parts = ["std_msgs/Header header\n" + definition, HEADER, TIME]
    parts += [QUATERNION] if "Quaternion" in definition else []
    parts += (
        ["MSG: geographic_msgs/GeoPoint\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude"]
        if "GeoPoint" in definition
        else []
    )
    schema = writer.register_msgdef(f"mavros_msgs/msg/{kind}", SEPARATOR.join(parts))
    for k, row in enumerate(rows):
        at = START + k * SECOND
        writer.write_message("/mavros/one", schema, row | {"header": stamp(at)}, at)
    writer.finish()
    return opened(tmp_path, file.getvalue())


def test_values_of_different_names_are_channels_of_their_own(tmp_path: Path) -> None:
    rows = [
        {
            "index": 7 if name == "" else -1,
            "name": name,
            "value_float": value,
            "value_int": whole,
            "type": kind,
        }
        for k in range(5)
        for name, value, whole, kind in (
            ("CabT", 20.0 + k, 0, 3),
            ("CabRH", 44.0, 0, 3),
            ("Count", 0.0, 70 + k, 4),
            ("", 1.5, 0, 0),
        )
    ]
    definition = "int32 index\nstring name\nfloat32 value_float\nint32 value_int\nuint8 type"
    log = mavros_log(tmp_path, "DebugValue", definition, rows)
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
    with pytest.raises(LogError, match="LOG-NO-TABLE"):
        log.message("/mavros/one", "Cab")


def test_names_without_end_are_a_loss(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unbend.ingest.mcap.topics.MAX_NAMES", 3)
    rows = [{"name": f"n{k % 5}", "value_float": 1.0} for k in range(20)]
    log = mavros_log(tmp_path, "DebugValue", "string name\nfloat32 value_float", rows)
    assert len(log.channels) == 3
    assert [(e.kind, e.count) for e in entries(log, "LOG-TOO-LARGE")] == [("loss", 8)]


def test_images_of_mavros_are_numbered_where_it_numbers_none(tmp_path: Path) -> None:
    """Its plugin leaves image_index and capture_result at 0, and adds the undulation."""
    row = {
        "geo": {"latitude": 47.5, "longitude": 8.25, "altitude": 647.5},
        "relative_alt": 30.0,
        "orientation": {"w": 0.5, "x": 0.5, "y": -0.5, "z": 0.5},
        "image_index": 0,
        "capture_result": 0,
        "file_url": "a.jpg",
    }
    definition = (
        "geographic_msgs/GeoPoint geo\nfloat32 relative_alt\ngeometry_msgs/Quaternion orientation\n"
        "int32 image_index\nint8 capture_result\nstring file_url"
    )
    log = mavros_log(tmp_path, "CameraImageCaptured", definition, [row] * 4)
    shots = log.channel("/mavros/one")
    assert shots["event_index"].tolist() == [0, 1, 2, 3]
    assert shots["h_ellipsoid_m"].tolist() == [647.5] * 4
    assert "h_msl_m" not in shots.columns
    assert [shots[f"camera_q_{axis}"][0] for axis in "wxyz"] == [0.5, 0.5, -0.5, 0.5]
    assert [e.kind for e in entries(log, "EVENT-NO-INDEX")] == ["note"]


def test_a_height_of_0_above_the_ellipsoid_is_missing_in_gpsraw(tmp_path: Path) -> None:
    rows = [
        {"fix_type": 3, "lat": 475_000_000, "lon": 82_500_000, "alt": 600_000, "alt_ellipsoid": 0}
        for k in range(4)
    ]
    definition = "uint8 fix_type\nint32 lat\nint32 lon\nint32 alt\nint32 alt_ellipsoid"
    log = mavros_log(tmp_path, "GPSRAW", definition, rows)
    assert "h_ellipsoid_m" not in log.channel("/mavros/one").columns


@pytest.mark.parametrize("compression", compressions(), ids=lambda kind: kind.name)
def test_large_images_cost_no_memory_and_no_messages(tmp_path: Path, compression: object) -> None:
    import tracemalloc

    from mcap_ros2.writer import Writer

    pixels = random.Random(1).randbytes(1 << 20) * 81  # mono8 10600 x 8000
    path = tmp_path / "flight.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        images, pressures = (
            writer.register_msgdef(kind, SEPARATOR.join(SCHEMAS[kind]))
            for kind in ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/FluidPressure")
        )
        for k in range(60):
            t = START + k * SECOND // 10
            if k % 40 == 5:
                image = {"header": stamp(t, f"cam{k}"), "format": "mono8", "data": pixels}
                writer.write_message("/camera", images, image, t)
            air = {"header": stamp(t), "fluid_pressure": 7e4 - k, "variance": 0.0}
            writer.write_message("/air", pressures, air, t)
        writer.finish()
    tracemalloc.start()
    log = open_log(path)
    assert tracemalloc.get_traced_memory()[1] < 24 << 20
    tracemalloc.stop()
    assert not log.ledger.has_losses
    np.testing.assert_array_equal(log.channel("/air")["pressure_pa"], 7e4 - np.arange(60))
    assert log.channel("/camera").labels["frame_id"] == ("cam5", "cam45")


def test_a_clock_set_back_in_the_recording_mixes_nothing(tmp_path: Path) -> None:
    bag = Bag()
    for k in range(400):
        t = START + k * SECOND // 10 - (10 * SECOND if k >= 300 else 0)
        bag.write("/air", "FluidPressure", t, fluid_pressure=7e4 - k, variance=0.0)
        if k % 4 == 0:
            bag.write(
                "/camera", "CompressedImage", t, header=stamp(t, f"{k}"), format="jpeg", data=b""
            )
    log = opened(tmp_path, bag.data)
    air = log.channel("/air")
    camera = log.channel("/camera")
    # 20 to 30 s were passed twice: the later rows stand for them, and nothing bridges the step
    np.testing.assert_array_equal(7e4 - air["pressure_pa"], [*range(200), *range(300, 400)])
    np.testing.assert_array_equal(air.boot, [0] * 200 + [1] * 100)
    shots = [*range(0, 200, 4), *range(300, 400, 4)]
    assert [int(name) for name in camera.labels["frame_id"]] == shots
    # an image keeps its number when images before it are lost
    np.testing.assert_array_equal(4 * camera["event_index"], shots)
    assert [(e.kind, e.count) for e in entries(log, "TIME-BACKWARD")] == [
        ("loss", 100),
        ("loss", 25),
    ]
    assert "/air, first at row 200" in entries(log, "TIME-BACKWARD")[0].where
    assert {e.kind for e in entries(log, "TIME-SET-BACK")} == {"warning"}


@pytest.mark.parametrize("row", [0, 5, 300])
def test_a_stamp_days_ahead_costs_one_row(tmp_path: Path, row: int) -> None:
    bag = Bag()
    for k in range(1000):
        t = START + k * SECOND // 10 + (11 * 86_400 * SECOND if k == row else 0)
        bag.write("/air", "FluidPressure", t, fluid_pressure=7e4 - k, variance=0.0)
    log = opened(tmp_path, bag.data)
    assert len(log.channel("/air")) == 999
    loss = entries(log, "TIME-BACKWARD")[0]
    assert (loss.kind, loss.count) == ("loss", 1)
    assert f"first at row {row}," in loss.where


def test_second_topics_of_a_kind_rank_alike(tmp_path: Path) -> None:
    bag = flight()
    for k in range(5):
        t = START + k * SECOND
        bag.write("/cabin/air", "Temperature", t, temperature=21.0, variance=0.0)
        bag.write("/cabin/humidity", "RelativeHumidity", t, relative_humidity=0.3, variance=0.0)
    log = opened(tmp_path, bag.data)
    for kind in ("air", "humidity", "pressure"):
        outside = log.channel(f"/outside/{kind}")
        cabin = log.channel(f"/cabin/{kind}")
        assert (outside.rank, outside.roles) == (cabin.rank, cabin.roles)


def test_without_a_header_stamp_the_recorders_time_is_a_stated_fallback(tmp_path: Path) -> None:
    bag = Bag()
    for k in range(5):
        bag.write("/air", "Temperature", 0, log_time=START + k, temperature=20.0, variance=0.0)
    log = opened(tmp_path, bag.data)
    np.testing.assert_array_equal(log.channel("/air").time_ns, START + np.arange(5))
    assert entries(log, "TIME-LOG-TIME")[0].kind == "fallback"


def with_message(bag: bytes, topic: str, content: bytes) -> bytes:
    """A copy of a bag with a message of any bytes at the end, which its writer would not write."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start()
    channels: dict[str, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(bag)).iter_messages():
        if channel.topic not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(
                channel.topic, channel.message_encoding, number
            )
        writer.add_message(
            channels[channel.topic], message.log_time, message.data, message.publish_time
        )
    writer.add_message(channels[topic], START, content, START)
    writer.finish()
    return file.getvalue()


def test_a_message_that_does_not_fit_its_schema_is_a_loss(tmp_path: Path) -> None:
    damaged = with_message(flight().data, "/outside/air", b"\x00\x01\x00\x00abc")
    log = opened(tmp_path, damaged)
    assert entries(log, "LOG-DECODE")[0].count == 1
    assert len(log.channel("/outside/air")) == 60


def test_an_instance_that_is_not_there_is_not_told_as_messages_that_do_not_fit(
    tmp_path: Path,
) -> None:
    bag = Bag()
    definition = "string name\nfloat32 value_float"
    schema = bag.writer.register_msgdef("mavros_msgs/msg/DebugValue", definition)
    row = {"name": "CabT", "value_float": 20.0}
    bag.writer.write_message("/debug", schema, row, START)
    damaged = with_message(bag.data, "/debug", b"\x00\x01\x00\x00\xff\xff\xff\xff")
    log = opened(tmp_path, damaged)
    assert entries(log, "LOG-DECODE")[0].count == 1
    assert log.message("/debug", "CabT")["value_float"].tolist() == [20.0]
    with pytest.raises(LogError, match="/debug, instance Cab, has no rows") as caught:
        log.message("/debug", "Cab")
    assert "decoded" not in str(caught.value)


def test_a_schema_that_cannot_be_parsed_costs_its_topic(tmp_path: Path) -> None:
    bag = Bag()
    schema = bag.writer.register_msgdef("sensor_msgs/msg/FluidPressure", "wstring name")
    number = bag.writer._writer.register_channel("/odd", "cdr", schema.id)
    bag.writer._writer.add_message(number, START, b"\x00\x01\x00\x00abc", START, 0)
    bag.write("/air", "Temperature", START, temperature=20.0, variance=0.0)
    log = opened(tmp_path, bag.data)
    (entry,) = entries(log, "LOG-SCHEMA")
    assert (entry.kind, entry.where) == ("loss", "/odd")
    assert "name is a wstring" in entry.what
    with pytest.raises(LogError, match="the schema of sensor_msgs/FluidPressure") as caught:
        log.message("/odd")
    assert caught.value.code == "LOG-NO-TABLE"


def test_ros_1_is_counted_and_not_read(tmp_path: Path) -> None:
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="test")
    schema = writer.register_schema("sensor_msgs/NavSatFix", "ros1msg", b"float64 latitude")
    channel = writer.register_channel("/one", "ros1", schema)
    ros = writer.register_schema(
        "sensor_msgs/msg/Temperature",
        "ros2msg",
        SEPARATOR.join(SCHEMAS["sensor_msgs/msg/Temperature"]).encode(),
    )
    air = writer.register_channel("/air", "cdr", ros)
    # CDR: little-endian, sec, nanosec, frame_id "", padding to 8, temperature, variance
    body = b"\x00\x01\x00\x00" + struct.pack("<iII", 1_763_073_169, 5, 1) + b"\0" + bytes(3)
    body += struct.pack("<dd", 15.0, 0.0)
    for k in range(3):
        writer.add_message(channel, START + k, bytes(8), START + k)
    writer.add_message(air, START, body, START)
    writer.finish()
    log = opened(tmp_path, file.getvalue())
    assert log.messages["/one"] == 3
    assert entries(log, "LOG-NOT-ROS2")[0].where == "/one"
    assert log.channel("/air").time_ns[0] == 1_763_073_169 * SECOND + 5
    assert log.channel("/air")["temperature_k"][0] == 288.15


@pytest.mark.parametrize(
    ("encoding", "definitions"),
    [("ros1", "ros1msg"), ("cdr", "ros2idl"), ("cdr", "omgidl"), ("cbor", ""), ("", "flatbuffer")],
)
def test_a_refusal_names_the_encodings_that_are_not_read(
    tmp_path: Path, encoding: str, definitions: str
) -> None:
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="test")
    schema = writer.register_schema("sensor_msgs::msg::NavSatFix", definitions, b"x")
    channel = writer.register_channel("/fix", encoding, schema)
    for k in range(3):
        writer.add_message(channel, START + k, bytes(8), START + k)
    writer.finish()
    with pytest.raises(LogError) as caught:
        opened(tmp_path, file.getvalue())
    assert caught.value.code == "LOG-NO-MESSAGES"
    named = f"{encoding or 'no encoding'} with {definitions or 'no'} definitions (/fix)"
    assert named in caught.value.what


def test_any_damage_opens_or_refuses(tmp_path: Path) -> None:
    logs = [
        flight(12, compression=kind, enable_crcs=crcs).data
        for kind in compressions()
        for crcs in (True, False)
    ]
    source = random.Random(5)
    for _ in range(120):
        damaged = bytearray(source.choice(logs))
        for _ in range(source.choice((1, 5, 20))):
            damaged[source.randrange(len(damaged))] ^= 1 << source.randrange(8)
        cut = source.randrange(len(damaged))
        del damaged[cut : cut + source.choice((0, 0, 500))]
        assert outcome(tmp_path, bytes(damaged)) in {
            "LOG-FORMAT",
            "LOG-NO-MESSAGES",
            "losses",
            "whole",
        }


def headless(data: bytes, what: str) -> bytes:
    """A file whose beginning is lost, or overwritten with zeros."""
    count = {"first": 1, "mark": 8, "header": 60, "quarter": len(data) // 4}[what.split()[0]]
    return (bytes(count) if what.endswith("zero") else b"") + data[count:]


@pytest.mark.parametrize("end", ["lost", "zero"])
@pytest.mark.parametrize("what", ["first", "mark", "header", "quarter"])
@pytest.mark.parametrize("name", at_hand("flight.mcap", "cubs2_cub_stabilize.mcap"))
def test_a_file_whose_head_is_lost(tmp_path: Path, name: str, what: str, end: str) -> None:
    """Chunks behind the damage are whole: what they hold is the same, and the loss is told."""
    whole = LOGS[name]
    path = tmp_path / "headless.mcap"
    path.write_bytes(headless(whole.read_bytes(), f"{what} {end}"))
    log = open_log(path)
    expected = open_log(whole)
    assert [c.name for c in log.channels] == [c.name for c in expected.channels]
    for ours, theirs in zip(log.channels, expected.channels, strict=True):
        rows = np.isin(theirs.time_ns, ours.time_ns)
        np.testing.assert_array_equal(ours.time_ns, theirs.time_ns[rows])
        for column in ours.columns:
            if column != "event_index":  # counted from the first that is there
                np.testing.assert_array_equal(ours[column], theirs[column][rows], column)
        assert bool(rows.all()) == (what != "quarter") or what == "quarter"
    read = sum(log.messages.values()) / sum(expected.messages.values())
    assert read > 0.7 if what == "quarter" else read == 1.0
    assert log.ledger.has_losses
    assert "first bytes" in next(e.what for e in log.ledger if e.code == "LOG-BAD-BYTES")
