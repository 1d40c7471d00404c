"""Damaged MCAP logs: whole, salvaged with a ledger, or refused with a code; no silent loss."""

import io
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import islice
from typing import NamedTuple

import pytest

from tests.faults.hostile import (
    CDR,
    FLUID_PRESSURE,
    HEADER_OF_ROS,
    START_NS,
    channel,
    message,
    packed_chunk,
    packed_zeros,
    record,
    schema,
)
from tests.faults.mutate import REFUSALS, Trial, damage_reported, peak_bytes, work_unit_s
from tests.helpers import NS_PER_S, codes_of_losses, with_code
from tests.ingest.written_logs import opened
from unbend.ingest import Log, open_log

LIMIT = 128 << 20
ROWS = 120
WHOLE = 4 * ROWS + ROWS // 10  # messages of four topics, and of a camera

FIX = (
    "sensor_msgs/NavSatStatus status\nfloat64 latitude\n"
    "float64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
    "uint8 position_covariance_type\n===\nMSG: sensor_msgs/NavSatStatus\nint8 status\n"
    "uint16 service"
)
STAMPED = {
    "/air": (FLUID_PRESSURE, "float64 fluid_pressure"),
    "/warm": ("sensor_msgs/msg/Temperature", "float64 temperature"),
    "/fix": ("sensor_msgs/msg/NavSatFix", FIX),
    "/camera": ("sensor_msgs/msg/CompressedImage", "string format\nuint8[] data"),
}
"""Messages with a header, and their other fields."""


def rows_of(k, time_ns):
    """What is written at one time, by topic."""
    rows = {
        "/air": {"fluid_pressure": 7e4 - k},
        "/warm": {"temperature": -12.5},
        "/fix": {
            "status": {"status": 0, "service": 1},
            "latitude": 47.0 + 1e-4 * k,
            "longitude": -122.5,
            "altitude": 580.25,
            "position_covariance": [1.0] * 9,
            "position_covariance_type": 2,
        },
    }
    if k % 10 == 0:
        rows["/camera"] = {"format": "jpeg", "data": bytes(range(200))}
    seconds, part_ns = divmod(time_ns, NS_PER_S)
    stamp = {"sec": seconds, "nanosec": part_ns}
    for row in rows.values():
        row["header"] = {"stamp": stamp, "frame_id": f"f{k % 3}"}
    rows["/note"] = {"data": f"note {k}"}
    return rows


def small_log(**options):
    """Two topics of air, a receiver and a camera, written by mcap-ros2-support."""
    from mcap_ros2.writer import Writer

    file = io.BytesIO()
    writer = Writer(file, chunk_size=4096, **options)
    schemas = {}
    for topic, (name, fields) in STAMPED.items():
        definition = f"std_msgs/Header header\n{fields}\n{HEADER_OF_ROS}"
        schemas[topic] = writer.register_msgdef(name, definition)
    schemas["/note"] = writer.register_msgdef("std_msgs/msg/String", "string data")
    for k in range(ROWS):
        time_ns = START_NS + k * NS_PER_S // 10
        for topic, row in rows_of(k, time_ns).items():
            writer.write_message(topic, schemas[topic], row, time_ns, time_ns, sequence=k)
    writer.finish()
    return file.getvalue()


@cache
def small_logs():
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


def rewritten(data, **options):
    """The same messages by the plain writer of the mcap library."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file = io.BytesIO()
    numbers = {}
    writer = Writer(file, **options)
    writer.start(profile="ros2", library="test")
    for kind, topic, row in make_reader(io.BytesIO(data)).iter_messages():
        if topic.id not in numbers:
            number = writer.register_schema(kind.name, kind.encoding, kind.data)
            numbers[topic.id] = writer.register_channel(topic.topic, "cdr", number)
        writer.add_message(
            numbers[topic.id],
            row.log_time,
            row.data,
            row.publish_time,
            row.sequence,
        )
    writer.finish()
    return file.getvalue()


@pytest.fixture(scope="module")
def trial(tmp_path_factory) -> Trial:
    return Trial(small_logs(), ".mcap", open_log, tmp_path_factory.mktemp("mcap"))


def messages_in(log):
    return sum(log.messages.values())


def test_the_small_logs_are_whole(trial):
    for log in trial.whole:
        assert not damage_reported(log)
        assert messages_in(log) == WHOLE


def test_mutations(trial, run_mutations):
    run_mutations(trial)

    assert trial.unreported == []
    assert set(trial.ends) <= {"complete", "reported"} | REFUSALS


def test_failures_found_once_stay_away(trial, run_corpus):
    run_corpus(trial, "mcap", {"complete", "reported"} | REFUSALS)


def test_every_cut_of_the_first_and_last_1000_bytes(trial, run_cuts):
    assert set(run_cuts(trial)) == {"reported"}


@pytest.fixture
def read(tmp_path) -> Callable[[bytes], Log]:
    return partial(opened, tmp_path / "damaged.mcap")


class ChunkOfLog(NamedTuple):
    """Begin and end of a chunk, and how many messages the library finds in it."""

    begin: int
    end: int
    messages: int


def records_of(data, begin, end):
    """Opcode, begin and end of each record in a part of a log."""
    while begin < end:
        opcode, length = struct.unpack_from("<BQ", data, begin)
        yield opcode, begin, begin + 9 + length
        begin += 9 + length


def chunks(data) -> Iterator[ChunkOfLog]:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk, Message
    from mcap.stream_reader import breakup_chunk

    for opcode, begin, end in records_of(data, 8, len(data) - 17):
        if opcode == 6:
            stream = io.BytesIO(data[begin + 9 : end])
            content = breakup_chunk(Chunk.read(ReadDataStream(stream)))
            messages = [record for record in content if isinstance(record, Message)]
            yield ChunkOfLog(begin, end, len(messages))


def chunk_of(data, number) -> ChunkOfLog:
    return next(islice(chunks(data), number, None))


def overwrite(data, begin, part):
    return data[:begin] + part + data[begin + len(part) :]


def with_length(data, begin, length):
    """A log in which the record that begins there gives this length."""
    return overwrite(data, begin + 1, struct.pack("<Q", length))


@pytest.mark.parametrize("file", [0, 1, 2, 3])
@pytest.mark.parametrize("part", [0.3, 0.7])
def test_a_cut_log_gives_every_complete_chunk(read, file, part):
    data = small_logs()[file]
    end = int(len(data) * part)
    expected = sum(chunk.messages for chunk in chunks(data) if chunk.end <= end)

    log = read(data[:end])

    assert messages_in(log) == expected > 100
    assert "LOG-TRUNCATED" in codes_of_losses(log.ledger)


@pytest.mark.parametrize("file", [0, 1, 2, 3])
def test_damage_between_chunks_costs_nothing_behind_it(read, file):
    """The record after a chunk gives a length beyond the file: the next chunk is found."""
    data = small_logs()[file]
    behind = chunk_of(data, 2).end

    log = read(with_length(data, behind, 1 << 60))

    assert messages_in(log) == WHOLE
    (damage,) = with_code(log.ledger, "LOG-BAD-BYTES")
    assert damage.kind == "loss"


@pytest.mark.parametrize("file", [0, 1, 2])
def test_a_damaged_length_of_a_chunk_costs_that_chunk(read, file):
    data = small_logs()[file]
    begin, end, lost = chunk_of(data, 2)

    log = read(with_length(data, begin, end - begin + 500))

    assert messages_in(log) >= WHOLE - lost
    assert log.ledger.has_losses


def test_zeros_in_a_chunk_without_a_checksum_cost_what_they_cover(read):
    data = small_logs()[3]
    begin, end, _ = chunk_of(data, 3)
    middle = (begin + end) // 2

    log = read(overwrite(data, middle, bytes(300)))

    assert 1 <= log.lost_messages <= 10
    assert set(codes_of_losses(log.ledger)) >= {"LOG-BAD-BYTES", "LOG-INCONSISTENT"}


def message_records(data):
    """Begin and end of the messages of the fourth chunk, in a log that is not compressed."""
    begin, end, _ = chunk_of(data, 3)
    first = begin + 9 + 32 + 8
    return [(at, to) for opcode, at, to in records_of(data, first, end) if opcode == 5]


def test_a_damaged_length_of_a_message_costs_that_message(read):
    data = small_logs()[3]
    begin, end = message_records(data)[4]

    log = read(with_length(data, begin, end - begin - 9 + 150))

    assert messages_in(log) == WHOLE - 1
    assert set(codes_of_losses(log.ledger)) >= {"LOG-BAD-BYTES", "LOG-INCONSISTENT"}


def test_a_log_without_an_end_of_its_data_says_so(read):
    """The record that ends the data is cut out, and no checksum tells."""
    data = small_logs()[3]
    end_of_data = b"\x0f" + struct.pack("<Q", 4)
    before, _, after = data.rpartition(end_of_data)

    log = read(before + after[4:])

    assert messages_in(log) == WHOLE
    (loss,) = with_code(log.ledger, "LOG-INCONSISTENT")
    assert "but no record ends the data" in loss.what


def test_a_message_that_changed_its_topic_is_noticed(read):
    """The total stays what the statistics say; the topics do not."""
    data = small_logs()[3]
    topics = {begin + 9: data[begin + 9 : begin + 11] for begin, _ in message_records(data)}
    first_of_one = next(place for place, topic in topics.items() if topic == b"\1\0")

    log = read(overwrite(data, first_of_one, b"\2"))

    assert messages_in(log) == WHOLE
    (loss,) = with_code(log.ledger, "LOG-INCONSISTENT")
    assert loss.kind == "loss"


def test_definitions_from_the_summary_save_a_log_that_lost_its_first_chunk(read, monkeypatch):
    """Writers define channels in the first chunk that needs them."""
    # As if the log were long: one that is would take minutes.
    monkeypatch.setattr("unbend.ingest.mcap.mcap_records.SPAN", 8192)
    monkeypatch.setattr("unbend.ingest.mcap.message_batches.BATCH_BYTES", 8192)
    data = bytearray(small_logs()[0])
    _, end, lost = chunk_of(data, 0)
    data[end - 40] ^= 0xFF

    assert messages_in(read(data)) == WHOLE - lost


def test_a_data_section_that_fails_its_checksum_is_a_loss(read):
    """A log without chunks: nothing else tells that a value changed."""
    data = small_logs()[5].replace(b"note 50", b"note 40", 1)

    (damage,) = with_code(read(data).ledger, "LOG-CRC")

    assert damage.kind == "loss"
    assert "data section" in damage.what


def schema_bomb(definition):
    """A topic of pressure whose definition takes long to take apart, and messages."""
    definitions = schema(900, FLUID_PRESSURE, definition)
    definitions += channel(900, 900, "/bomb", "cdr")
    return definitions + message(900, 0, CDR + bytes(64)) * 50


def nested(depth):
    """Arrays of messages in arrays of messages: 4000 to the power of the depth numbers."""
    parts = ["a/A0[4000] x\nfloat64 fluid_pressure"]
    for k in range(depth):
        parts.append(f"MSG: a/A{k}\na/A{k + 1}[4000] x")
    return "\n===\n".join([*parts, f"MSG: a/A{depth}\nfloat64 z"])


def bomb(kind):
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
        more = b"".join(channel(k, 900, "/b", "cdr") for k in range(901, 20_000))
        return schema_bomb("float64 x\n" * 4000) + more
    if kind == "empty records":
        return record(0x80, b"") * 10**6
    if kind == "empty messages":
        return record(5, b"") * 10**6
    if kind == "channels":  # as many as numbers allow, defined over and over
        return b"".join(channel(1000 + k % 60_000, 0, f"/t{k}", "cdr") for k in range(100_000))
    if kind == "nested":
        size = 64 << 20
        return (
            packed_chunk("", 0, b"")
            + packed_chunk(
                "zstd",
                size,
                packed_zeros("zstd", size),
                crc=1,
            )
            * 2
        )
    if kind == "many chunks":  # as much in each as one chunk alone once could have
        size = 256 << 20
        return packed_chunk("zstd", size, packed_zeros("zstd", size)) * 40
    if kind == "chunk of records":
        inner = record(5, bytes(22)) * (8 << 20 >> 5)
        return packed_chunk("", len(inner), inner)
    compression, promised = kind.split()
    return packed_chunk(compression, int(promised), packed_zeros(compression, 2 << 30))


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
def test_bombs_are_skipped_at_once(tmp_path, kind):
    data = small_logs()[0]
    _, _, behind_header = next(records_of(data, 8, len(data)))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data[:behind_header] + bomb(kind) + data[behind_header:])
    before = peak_bytes()
    begin_s = time.process_time()

    log = open_log(path)

    taken_s = time.process_time() - begin_s
    assert peak_bytes() - before < LIMIT
    assert messages_in(log) >= WHOLE
    assert log.ledger.has_losses
    assert len(log.ledger) < 60
    assert taken_s < 120.0 * work_unit_s()  # 15 for the channels; 60 for a million data ends
    if kind.split()[0] in ("zstd", "lz4", "nested"):  # a million records take long to trace
        tracemalloc.start()
        open_log(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < LIMIT // 4
