"""Damaged MCAP logs: whole, salvaged with a ledger, or refused with a code; no silent loss."""

from __future__ import annotations

import io
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from unbend.ingest import Log, open_log

SECOND = 10**9
START = 1_763_073_169 * SECOND
REFUSALS = {"LOG-FORMAT", "LOG-NO-MESSAGES", "LOG-EMPTY"}
LIMIT = 128 << 20

STAMP = (
    "std_msgs/Header header\n%s\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
    "string frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
FIX = (
    "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\n"
    "float64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
    "uint8 position_covariance_type\n===\nMSG: sensor_msgs/NavSatStatus\nint8 status\n"
    "uint16 service\n" + STAMP.split("%s\n")[1]
)


def small_log(rows: int = 120, **options: object) -> bytes:
    """Two topics of air, a receiver and a camera, written by mcap-ros2-support."""
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file, chunk_size=4096, **options)
    kinds = {
        "/air": ("sensor_msgs/msg/FluidPressure", STAMP % "float64 fluid_pressure"),
        "/warm": ("sensor_msgs/msg/Temperature", STAMP % "float64 temperature"),
        "/fix": ("sensor_msgs/msg/NavSatFix", FIX),
        "/camera": ("sensor_msgs/msg/CompressedImage", STAMP % "string format\nuint8[] data"),
        "/note": ("std_msgs/msg/String", "string data"),
    }
    schemas = {topic: writer.register_msgdef(*kind) for topic, kind in kinds.items()}
    fields = {
        "/air": lambda k: {"fluid_pressure": 7e4 - k},
        "/warm": lambda k: {"temperature": -12.5},
        "/fix": lambda k: {
            "status": {"status": 0, "service": 1},
            "latitude": 47.0 + 1e-4 * k,
            "longitude": -122.5,
            "altitude": 580.25,
            "position_covariance": [1.0] * 9,
            "position_covariance_type": 2,
        },
        "/camera": lambda k: {"format": "jpeg", "data": bytes(range(200))},
        "/note": lambda k: {"data": f"note {k}"},
    }
    for k in range(rows):
        sec, nanosec = divmod(START + k * SECOND // 10, SECOND)
        for topic, schema in schemas.items():
            if topic == "/camera" and k % 10:
                continue
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": f"f{k % 3}"}
            row = fields[topic](k) | ({} if topic == "/note" else {"header": header})
            at = START + k * SECOND // 10
            writer.write_message(topic, schema, row, at, at, sequence=k)
    writer.finish()
    return file.getvalue()


@cache
def small_logs() -> tuple[bytes, ...]:
    from mcap.writer import CompressionType as Kind

    return (
        small_log(compression=Kind.ZSTD),
        small_log(compression=Kind.LZ4),
        small_log(compression=Kind.NONE),
        small_log(compression=Kind.NONE, enable_crcs=False),
        small_log(compression=Kind.ZSTD, enable_crcs=False),
        rewritten(small_log(), use_chunking=False, enable_data_crcs=True),
        rewritten(small_log(), use_chunking=False),
    )


def rewritten(data: bytes, **options: object) -> bytes:
    """The same messages by the plain writer of the mcap library."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file = io.BytesIO()
    numbers = {}
    writer = Writer(file, **options)
    writer.start(profile="ros2", library="test")
    for schema, channel, message in make_reader(io.BytesIO(data)).iter_messages():
        if channel.id not in numbers:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number)
        writer.add_message(
            numbers[channel.id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
    writer.finish()
    return file.getvalue()


@pytest.fixture(scope="module")
def trial(mutate: ModuleType, tmp_path_factory: pytest.TempPathFactory):
    return mutate.Trial(small_logs(), ".mcap", open_log, tmp_path_factory.mktemp("mcap"))


def test_the_small_logs_are_whole(trial, mutate: ModuleType) -> None:
    assert [mutate.damage_reported(log) for log in trial.whole] == [False] * len(small_logs())
    assert {sum(log.messages.values()) for log in trial.whole} == {4 * 120 + 12}


def test_mutations(
    trial,
    mutate: ModuleType,
    mutation_count: int,
    mutation_seed: int,
    record_property: Callable[[str, object], None],
) -> None:
    for recipe in mutate.recipes(len(small_logs()), mutation_count, mutation_seed):
        trial.run(recipe)
    record_property("mutations", f"seed {mutation_seed}, {trial.summary()}")
    assert not trial.failures, trial.summary()
    assert trial.unreported == []
    assert set(trial.ends) <= {"complete", "reported"} | REFUSALS


def test_failures_found_once_stay_away(trial, mutate: ModuleType, corpus) -> None:
    before = list(trial.failures)
    for name, recipe in corpus.get("mcap", []):
        assert trial.run(mutate.Recipe(*recipe)) in {"complete", "reported"} | REFUSALS, name
    assert trial.failures == before


def test_every_cut_of_the_first_and_last_1000_bytes(trial, cuts: list[int]) -> None:
    data = small_logs()[0]
    before = trial.ends.copy()
    for count in cuts:
        trial.examine(0, data[count:], f"first {count} bytes cut")
        trial.examine(0, data[:-count], f"last {count} bytes cut")
    assert not trial.failures, trial.summary()
    ends = trial.ends - before
    assert ends == {"reported": 2 * len(cuts)}


def read(path: Path, data: bytes) -> Log:
    path.write_bytes(data)
    return open_log(path)


def chunks(data: bytes) -> Iterator[tuple[int, int, list[tuple[int, int]]]]:
    """Begin, end and messages (channel, sequence) of each chunk, as the library finds them."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk, Message
    from mcap.stream_reader import breakup_chunk

    at = 8
    while at + 9 < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:
            content = Chunk.read(ReadDataStream(io.BytesIO(data[at + 9 : at + 9 + length])))
            records = [r for r in breakup_chunk(content) if isinstance(r, Message)]
            yield at, at + 9 + length, [(r.channel_id, r.sequence) for r in records]
        at += 9 + length


@pytest.mark.parametrize("file", [0, 1, 2, 3])
@pytest.mark.parametrize("part", [0.3, 0.7])
def test_a_cut_log_gives_every_complete_chunk(tmp_path: Path, file: int, part: float) -> None:
    data = small_logs()[file]
    end = int(len(data) * part)
    expected = sum(len(found) for _, stop, found in chunks(data) if stop <= end)
    log = read(tmp_path / "cut.mcap", data[:end])
    assert sum(log.messages.values()) == expected > 100
    assert any(entry.code == "LOG-TRUNCATED" and entry.kind == "loss" for entry in log.ledger)


@pytest.mark.parametrize("file", [0, 1, 2, 3])
def test_damage_between_chunks_costs_nothing_behind_it(tmp_path: Path, file: int) -> None:
    """The record after a chunk gives a length beyond the file: the next chunk is found."""
    data = bytearray(small_logs()[file])
    _, end, _ = list(chunks(bytes(data)))[2]
    data[end + 1 : end + 9] = struct.pack("<Q", 1 << 60)
    log = read(tmp_path / "hole.mcap", bytes(data))
    assert sum(log.messages.values()) == 4 * 120 + 12
    assert [entry.kind for entry in log.ledger if entry.code == "LOG-BAD-BYTES"] == ["loss"]


@pytest.mark.parametrize("file", [0, 1, 2])
def test_a_damaged_length_of_a_chunk_costs_that_chunk(tmp_path: Path, file: int) -> None:
    data = bytearray(small_logs()[file])
    every = list(chunks(bytes(data)))
    begin, end, lost = every[2]
    data[begin + 1 : begin + 9] = struct.pack("<Q", end - begin + 500)
    log = read(tmp_path / "length.mcap", bytes(data))
    assert sum(log.messages.values()) >= 4 * 120 + 12 - len(lost)
    assert log.ledger.has_losses


def test_zeros_in_a_chunk_without_a_checksum_cost_what_they_cover(tmp_path: Path) -> None:
    data = bytearray(small_logs()[3])
    begin, end, _ = list(chunks(bytes(data)))[3]
    middle = (begin + end) // 2
    data[middle : middle + 300] = bytes(300)
    log = read(tmp_path / "zeros.mcap", bytes(data))
    assert 1 <= log.lost_messages <= 10
    codes = {entry.code for entry in log.ledger if entry.kind == "loss"}
    assert {"LOG-BAD-BYTES", "LOG-INCONSISTENT"} <= codes


def message_records(data: bytes) -> list[int]:
    """Where the messages of the fourth chunk begin, in a log that is not compressed."""
    begin, end, _ = list(chunks(data))[3]
    at = begin + 9 + 32 + 8
    found = []
    while at < end:
        if data[at] == 5:
            found.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return found


def test_a_damaged_length_of_a_message_costs_that_message(tmp_path: Path) -> None:
    data = bytearray(small_logs()[3])
    at = message_records(bytes(data))[4]
    length = struct.unpack_from("<Q", data, at + 1)[0]
    data[at + 1 : at + 9] = struct.pack("<Q", length + 150)
    log = read(tmp_path / "length.mcap", bytes(data))
    assert sum(log.messages.values()) == 4 * 120 + 12 - 1
    assert {e.code for e in log.ledger if e.kind == "loss"} >= {"LOG-BAD-BYTES", "LOG-INCONSISTENT"}


def test_a_log_without_an_end_of_its_data_says_so(tmp_path: Path) -> None:
    """The record that ends the data is cut out, and no checksum tells."""
    data = small_logs()[3]
    end_of_data = b"\x0f" + struct.pack("<Q", 4)
    at = data.rindex(end_of_data)
    log = read(tmp_path / "end.mcap", data[:at] + data[at + len(end_of_data) + 4 :])
    assert sum(log.messages.values()) == 4 * 120 + 12
    losses = [e.what for e in log.ledger if e.code == "LOG-INCONSISTENT"]
    assert len(losses) == 1
    assert "but no record ends the data" in losses[0]


def test_a_message_that_changed_its_topic_is_noticed(tmp_path: Path) -> None:
    """The total stays what the statistics say; the topics do not."""
    data = bytearray(small_logs()[3])
    for at in message_records(bytes(data)):
        if data[at + 9 : at + 11] == b"\1\0":
            data[at + 9] = 2
            break
    log = read(tmp_path / "topic.mcap", bytes(data))
    assert sum(log.messages.values()) == 4 * 120 + 12
    assert [e.kind for e in log.ledger if e.code == "LOG-INCONSISTENT"] == ["loss"]


def test_definitions_from_the_summary_save_a_log_that_lost_its_first_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Writers define channels in the first chunk that needs them."""
    monkeypatch.setattr("unbend.ingest.mcap.mcap_records.SPAN", 8192)  # as if the log were long
    monkeypatch.setattr("unbend.ingest.mcap.message_batches.BATCH_BYTES", 8192)
    data = bytearray(small_logs()[0])
    begin, end, lost = next(chunks(bytes(data)))
    data[end - 40] ^= 0xFF
    log = read(tmp_path / "first.mcap", bytes(data))
    assert sum(log.messages.values()) == 4 * 120 + 12 - len(lost)
    assert begin < end


def test_a_data_section_that_fails_its_checksum_is_a_loss(tmp_path: Path) -> None:
    """A log without chunks: nothing else tells that a value changed."""
    data = bytearray(small_logs()[5])
    data[data.index(b"note 50") + 5] ^= 1
    log = read(tmp_path / "data.mcap", bytes(data))
    assert [(e.kind, "data section" in e.what) for e in log.ledger if e.code == "LOG-CRC"] == [
        ("loss", True)
    ]


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


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(compression: str, promised: int, packed: bytes, crc: int = 0) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, promised, crc, len(name)) + name
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def many_channels(count: int) -> bytes:
    """As many channels as numbers allow, defined over and over."""
    parts = [
        record(
            4, struct.pack("<HH", 1000 + k % 60_000, 0) + text(f"/t{k}") + text("cdr") + bytes(4)
        )
        for k in range(count)
    ]
    return b"".join(parts)


def schema_bomb(definition: str) -> bytes:
    """A topic of pressure whose definition takes long to take apart, and messages."""
    schema = struct.pack("<H", 900) + text("sensor_msgs/msg/FluidPressure") + text("ros2msg")
    schema += text(definition)
    channel = struct.pack("<HH", 900, 900) + text("/bomb") + text("cdr") + bytes(4)
    message = struct.pack("<HIQQ", 900, 0, START, START) + b"\0\1\0\0" + bytes(64)
    return record(3, schema) + record(4, channel) + record(5, message) * 50


def nested(depth: int) -> str:
    """Arrays of messages in arrays of messages: 4000 to the power of the depth numbers."""
    parts = [f"MSG: a/A{k}\na/A{k + 1}[4000] x" for k in range(depth)]
    return "\n===\n".join(
        ["a/A0[4000] x\nfloat64 fluid_pressure", *parts, f"MSG: a/A{depth}\nfloat64 z"]
    )


def bomb(kind: str) -> bytes:
    if kind == "data that ends again and again":  # each a checksum of all before it
        return record(15, struct.pack("<I", 1)) * 1_000_000
    if kind == "schema of a long array":
        return schema_bomb("float64[2000000000] variance\nfloat64 fluid_pressure")
    if kind == "schema of long arrays":
        return schema_bomb("float64[2147483647] x\n" * 4000 + "float64 fluid_pressure")
    if kind == "schema of nested arrays":
        return schema_bomb(nested(12))
    if kind == "schema of remarks":  # one definition, named 4000 times
        remarks = "int8 A=1\n" * 100_000
        return schema_bomb(f"a/B[4000] x\nfloat64 y\n===\nMSG: a/B\n{remarks}int8 z")
    if kind == "schema of many channels":
        one = record(4, struct.pack("<HH", 901, 900) + text("/b") + text("cdr") + bytes(4))
        more = [one[:9] + struct.pack("<H", k) + one[11:] for k in range(901, 20_000)]
        return schema_bomb("float64 x\n" * 4000) + b"".join(more)
    if kind == "empty records":
        return record(0x80, b"") * 10**6
    if kind == "empty messages":
        return record(5, b"") * 10**6
    if kind == "channels":
        return many_channels(100_000)
    if kind == "nested":
        return (
            chunk("", 0, b"") + chunk("zstd", 64 << 20, packed_zeros("zstd", 64 << 20), crc=1) * 2
        )
    if kind == "many chunks":  # each of 256 MiB, as much as one chunk alone once could
        return chunk("zstd", 256 << 20, packed_zeros("zstd", 256 << 20)) * 40
    if kind == "chunk of records":
        inner = record(5, bytes(22)) * (8 << 20 >> 5)
        return chunk("", len(inner), inner)
    compression, promised = kind.split()
    return chunk(compression, int(promised), packed_zeros(compression, 2 << 30))


SIZES = (1024, 64 << 20, 2 << 30, 2**63)
BOMBS = [
    *(f"{how} {size}" for how in ("zstd", "lz4") for size in SIZES),
    "empty records",
    "empty messages",
    "channels",
    "nested",
    "chunk of records",
    "many chunks",
    "data that ends again and again",
    "schema of a long array",
    "schema of long arrays",
    "schema of nested arrays",
    "schema of remarks",
    "schema of many channels",
]


@pytest.mark.parametrize("kind", BOMBS)
def test_bombs_are_skipped_at_once(tmp_path: Path, mutate: ModuleType, kind: str) -> None:
    data = small_logs()[0]
    at = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data[:at] + bomb(kind) + data[at:])
    before = mutate.peak_bytes()
    begin = time.process_time()
    log = open_log(path)
    taken = time.process_time() - begin
    assert mutate.peak_bytes() - before < LIMIT
    assert sum(log.messages.values()) >= 4 * 120 + 12
    assert log.ledger.has_losses
    assert len(log.ledger) < 60
    assert taken < 120.0 * mutate.work_unit_s()  # 15 for the channels; 60 for a million data ends
    if kind.split()[0] in ("zstd", "lz4", "nested"):  # a million records take long to trace
        tracemalloc.start()
        open_log(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < LIMIT // 4
