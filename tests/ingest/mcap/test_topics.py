"""MCAP topics of several definitions, values that are no numbers, and what tables show of them."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from unbend.errors import LogError
from unbend.ingest import Log, open_log
from unbend.ingest.mcap.cdr import decode_plan
from unbend.ingest.mcap.ros2_definitions import KINDS, SchemaError, steps_of

SECOND = 10**9
START = 1_763_073_169 * SECOND
STAMP = (
    "std_msgs/Header header\n%s\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
    "string frame_id"
)
AIR = "sensor_msgs/msg/FluidPressure"
WARM = "sensor_msgs/msg/Temperature"
PRESSURE = STAMP % "float64 fluid_pressure\nfloat64 variance"
SWAPPED = STAMP % "float64 variance\nfloat64 fluid_pressure"
TEMPERATURE = STAMP % "float64 temperature\nfloat64 variance"

Message = tuple[int, int, bytes]  # channel, log_time, data


def cdr(time_ns: int, *values: float, head: bytes = b"\0\1\0\0", align: int = 8) -> bytes:
    """A header and float64, in CDR (in XCDR2 aligned to 4)."""
    body = struct.pack("<iII", *divmod(time_ns, SECOND), 5) + b"base\0"
    return head + body + bytes(-len(body) % align) + struct.pack(f"<{len(values)}d", *values)


def written(
    path: Path,
    channels: list[tuple[str, str, str, str]],
    messages: Iterable[Message],
    sequence: Callable[[int], int] | None = None,
) -> Log:
    """A log of channels (topic, name of schema, definition, encoding) by the plain writer."""
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file, chunk_size=2000)
    writer.start(profile="ros2", library="test")
    for topic, name, definition, encoding in channels:
        kind = {"cdr": "ros2msg", "json": "jsonschema"}[encoding]
        number = writer.register_schema(name, kind, definition.encode()) if name else 0
        writer.register_channel(topic, encoding, number)
    for k, (channel, time_ns, data) in enumerate(messages):
        writer.add_message(channel, time_ns, data, time_ns, sequence(k) if sequence else k)
    writer.finish()
    path.write_bytes(file.getvalue())
    return open_log(path)


def times(count: int) -> list[int]:
    return [START + k * SECOND // 10 for k in range(count)]


def entries(log: Log, code: str) -> list[tuple[str, str, int]]:
    return [(entry.kind, entry.where, entry.count) for entry in log.ledger if entry.code == code]


@pytest.mark.parametrize("mixed", [False, True])
def test_each_definition_of_a_topic_has_its_own_layout(tmp_path: Path, mixed: bool) -> None:
    channels = [("/baro", AIR, PRESSURE, "cdr"), ("/baro", AIR, SWAPPED, "cdr")]
    messages = []
    for k, t in enumerate(times(200)):
        second = k % 2 if mixed else k >= 100
        values = (5.0, 9e4 + k) if second else (9e4 + k, 5.0)
        messages.append((1 + second, t, cdr(t, *values)))
    log = written(tmp_path / "log.mcap", channels, messages, lambda k: 0)
    np.testing.assert_array_equal(log.channel("/baro")["pressure_pa"], 9e4 + np.arange(200))
    np.testing.assert_array_equal(log.message("/baro")["fluid_pressure"], 9e4 + np.arange(200))
    assert not log.ledger.has_losses


def test_encodings_of_a_topic_make_one_channel(tmp_path: Path) -> None:
    channels = [("/baro", AIR, PRESSURE, "cdr"), ("/baro", AIR, "{}", "json")]
    messages = []
    for k, t in enumerate(times(200)):
        sec, nanosec = divmod(t, SECOND)
        row = {"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "fluid_pressure": 9e4 + k}
        data = json.dumps(row).encode() if k % 2 else cdr(t, 9e4 + k, 5.0)
        messages.append((1 + k % 2, t, data))
    log = written(tmp_path / "log.mcap", channels, messages)
    np.testing.assert_array_equal(log.channel("/baro")["pressure_pa"], 9e4 + np.arange(200))
    np.testing.assert_array_equal(log.channel("/baro").time_ns, times(200))
    table = log.message("/baro")
    np.testing.assert_array_equal(table["time_ns"], times(200))
    np.testing.assert_array_equal(table["variance"], [np.nan if k % 2 else 5 for k in range(200)])
    assert not log.ledger.has_losses


def test_schemas_of_a_topic_are_channels_apart_and_one_table(tmp_path: Path) -> None:
    channels = [("/air", AIR, PRESSURE, "cdr"), ("/air", WARM, TEMPERATURE, "cdr")]
    messages = [
        (1 + k % 2, t, cdr(t, 9e4 if k % 2 == 0 else 15.0, 0)) for k, t in enumerate(times(60))
    ]
    log = written(tmp_path / "log.mcap", channels, messages)
    assert log.messages == {"/air": 60}
    assert log.channel("/air (sensor_msgs/FluidPressure)").roles == ("pressure", "cabin_pressure")
    assert len(log.channel("/air (sensor_msgs/Temperature)")) == 30
    table = log.message("/air")
    np.testing.assert_array_equal(table["time_ns"], times(60))
    np.testing.assert_array_equal(table["fluid_pressure"][:2], [9e4, np.nan])
    np.testing.assert_array_equal(table["temperature"][:2], [np.nan, 15.0])


def readings(path: Path, values: list[str], pad: str = "") -> Log:
    """A thermometer in CDR, and JSON of nobody's schema."""
    channels = [("/t", WARM, TEMPERATURE, "cdr"), ("/cabin", "", "", "json")]
    messages: list[Message] = []
    for t, value in zip(times(len(values)), values, strict=True):
        row = b'{"timestamp":%d,"pad":"%s","value":%s}' % (t, pad.encode(), value.encode())
        messages += [(1, t, cdr(t, 15.0, 0.0)), (2, t, row)]
    return written(path, channels, messages)


@pytest.mark.parametrize("odd", ['"n/a"', "9" * 400, "{}", "[1]"])
def test_a_value_that_is_no_number_costs_itself(tmp_path: Path, odd: str) -> None:
    values = ["3"] * 20 + [odd] + ["2.5", "null", '"4.5"'] * 5
    log = readings(tmp_path / "log.mcap", values)
    wanted = [3.0] * 20 + [np.nan] + [2.5, np.nan, 4.5] * 5
    np.testing.assert_array_equal(log.channel("/cabin")["value"], wanted)
    assert entries(log, "LOG-DECODE") == [("loss", "/cabin", 1)]
    assert log.message("/cabin")["time_ns"].shape == (36,)


def test_texts_in_one_block_take_no_numbers_from_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unbend.ingest.mcap.mcap_records.SPAN", 20_000)
    monkeypatch.setattr("unbend.ingest.mcap.message_batches.BATCH_BYTES", 20_000)
    values = [str(k) for k in range(600)]
    values[20] = '"n/a"'
    log = readings(tmp_path / "log.mcap", values, "x" * 300)
    found = log.channel("/cabin")["value"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found)), [20])
    np.testing.assert_array_equal(found[21:], np.arange(21, 600))
    assert log.message("/cabin")["value"][[0, 20, 21, -1]].tolist() == [0, "n/a", 21, 599]


def test_fields_with_names_of_ours_are_fields(tmp_path: Path) -> None:
    channels = [
        ("/t", WARM, TEMPERATURE, "cdr"),
        ("/x", "my/msg/Foo", "int64 stamp_ns\nint8 place", "cdr"),
    ]
    messages: list[Message] = []
    for k, t in enumerate(times(5)):
        messages += [(1, t, cdr(t, 15.0, 0.0)), (2, t, b"\0\1\0\0" + struct.pack("<qb", 7, 5 - k))]
    table = written(tmp_path / "log.mcap", channels, messages).message("/x")
    assert table["time_ns"].tolist() == times(5)
    assert table["stamp_ns"].tolist() == [7] * 5
    assert table["place"].tolist() == [5, 4, 3, 2, 1]


def test_a_topic_of_texts_alone_is_no_loss(tmp_path: Path) -> None:
    log = readings(tmp_path / "log.mcap", ['"taking off"', '"landed"'] * 5)
    assert [channel.name for channel in log.channels] == ["/t"]
    assert not log.ledger.has_losses
    assert log.message("/cabin")["value"][:2].tolist() == ["taking off", "landed"]


def test_integers_are_exact_in_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = [2**60 + k for k in range(300)]
    log = readings(tmp_path / "log.mcap", [str(value) for value in values])
    table = log.message("/cabin")
    assert (table["value"].tolist(), table["value"].dtype) == (values, np.int64)
    assert table["timestamp"].tolist() == times(300)
    monkeypatch.setattr("unbend.ingest.mcap.mcap_records.SPAN", 8000)  # parts of several kinds
    monkeypatch.setattr("unbend.ingest.mcap.message_batches.BATCH_BYTES", 8000)
    odd = [2**64 - 1, None, *values[2:200], True, *values[201:250], 0.5, *values[251:]]
    log = readings(tmp_path / "odd.mcap", [json.dumps(value) for value in odd])
    assert log.message("/cabin")["value"].tolist() == odd


def test_protobuf_integers_are_exact(tmp_path: Path) -> None:
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
    from google.protobuf.descriptor_pb2 import FileDescriptorProto
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from mcap_protobuf.writer import Writer

    file = FileDescriptorProto(name="a.proto", package="a", syntax="proto3")
    message = file.message_type.add(name="M")
    kinds = (Field.TYPE_UINT64, Field.TYPE_INT64, Field.TYPE_BOOL, Field.TYPE_BYTES)
    for number, (name, kind) in enumerate(zip("abcd", kinds, strict=True), 1):
        message.field.add(name=name, number=number, type=kind, label=Field.LABEL_OPTIONAL)
    pool = DescriptorPool()
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("a.M"))
    path = tmp_path / "pb.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        for k in range(5):
            row = made(a=2**63 + k, b=2**53 + 1, c=k == 1, d=bytes(k))
            writer.write_message("/pb", row, START + k, START + k)
        writer.finish()
    table = open_log(path, needs_channels=False).message("/pb")
    assert table["a"].tolist() == [2**63 + k for k in range(5)]
    assert table["b"].tolist() == [2**53 + 1] * 5
    assert table["c"].tolist() == [False, True, False, False, False]
    assert table["d[]"].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("head", "align"), [(b"\0\2\0\0", 8), (b"\0\3\0\0", 8), (b"\0\7\0\0", 4), (b"\0\x0b\0\0", 4)]
)
def test_other_encapsulations_are_no_cdr(tmp_path: Path, head: bytes, align: int) -> None:
    messages = [
        (1, t, cdr(t, 9e4, 1.0, head=head if k % 2 else b"\0\1\0\0", align=align if k % 2 else 8))
        for k, t in enumerate(times(20))
    ]
    log = written(tmp_path / "log.mcap", [("/p", AIR, PRESSURE, "cdr")], messages)
    np.testing.assert_array_equal(log.channel("/p")["pressure_pa"], [9e4] * 10)
    assert entries(log, "LOG-DECODE") == [("loss", "/p", 10)]


def test_elements_of_long_arrays_are_found_without_the_others() -> None:
    steps = steps_of("a/msg/B", "float64[2000000000] v\nuint8 k")
    assert len(decode_plan(steps, frozenset({"v.0", "v.4", "k"})).steps[0]) == 5
    assert decode_plan(steps, frozenset({"v.9", "v.x"})).wanted == {"v.9"}


def test_a_schema_that_multiplies_is_refused_before_it_has() -> None:
    nested = "".join(f"===\nMSG: a/A{k}\na/A{k + 1}[4000] x\n" for k in range(12))
    definition = f"a/A0[4000] x\nfloat64 y\n{nested}===\nMSG: a/A12\nfloat64 z\n"
    with pytest.raises(SchemaError, match="4096"):
        steps_of("a/msg/B", definition)


@pytest.mark.parametrize("count", ["3000000000", "9" * 30, "9" * 5000])
def test_arrays_longer_than_any_message_are_refused(count: str) -> None:
    with pytest.raises(ValueError, match=r"elements|digits"):
        steps_of("a/msg/B", f"float64[{count}] v")


def test_a_table_says_how_many_elements_are_left_out(tmp_path: Path) -> None:
    foo = "int32 b\nfloat64[] a\nuint8 k"
    channels = [
        ("/t", WARM, TEMPERATURE, "cdr"),
        ("/x", "my/msg/Foo", f"{foo}\nstring[] names\nfloat32[<=4] c", "cdr"),
        ("/w", "my/msg/Bar", "wstring w", "cdr"),
    ]
    messages: list[Message] = []
    for k, t in enumerate(times(6)):
        body = struct.pack("<iI", k, k) + struct.pack(f"<{k}d", *range(k)) + bytes([9, 0, 0, 0])
        body += struct.pack("<IIIII", 2, 1, 0, 1, 0) + struct.pack("<If", 1, 3.0)
        messages += [(1, t, cdr(t, 15.0, 0.0)), (2, t, b"\0\1\0\0" + body), (3, t, bytes(12))]
    messages[-2] = (2, messages[-2][1], messages[-2][2][:-9])  # it ends before the last sequence
    log = written(tmp_path / "log.mcap", channels, messages)
    table = log.message("/x")
    assert table["a[]"].tolist() == [0, 1, 2, 3, 4, 5]
    assert table["names[]"].tolist() == [2] * 6
    assert table["c[]"].tolist() == [1] * 5 + [-1]
    assert table["k"].tolist() == [9] * 6
    with pytest.raises(LogError, match="w is a wstring"):
        log.message("/w")


def test_chunks_in_another_order_lose_nothing(tmp_path: Path) -> None:
    order = [*range(100), *range(150, 200), *range(100, 150), *range(200, 300)]
    messages = [(1, times(300)[k], cdr(times(300)[k], 9e4 + k, 0.0)) for k in order]
    channels = [("/p", AIR, PRESSURE, "cdr")]
    log = written(tmp_path / "log.mcap", channels, messages, lambda k: order[k])
    assert (log.lost_messages, log.ledger.has_losses) == (0, False)
    np.testing.assert_array_equal(log.channel("/p")["pressure_pa"], 9e4 + np.arange(300))
    assert entries(log, "LOG-REORDERED") == [("note", "/p, first at row 100", 100)]
    missing = [k for k in order if not 40 <= k < 47]
    messages = [(1, times(300)[k], cdr(times(300)[k], 9e4 + k, 0.0)) for k in missing]
    log = written(tmp_path / "log.mcap", channels, messages, lambda k: missing[k])
    assert log.lost_messages == 7
    assert entries(log, "LOG-LINK-LOSS") == [("finding", "/p", 7)]


def test_a_recorder_that_counts_anew_hides_no_gap(tmp_path: Path) -> None:
    numbers = [k for k in range(100) if not 40 <= k < 47] + [*range(100)]
    messages = [(1, t, cdr(t, 9e4, 0.0)) for t in times(len(numbers))]
    channels = [("/p", AIR, PRESSURE, "cdr")]
    log = written(tmp_path / "log.mcap", channels, messages, lambda k: numbers[k])
    assert log.lost_messages == 7
    assert entries(log, "LOG-REORDERED") == []


def stamped(path: Path, stamp_ns: int, recorded_ns: int) -> Log:
    """A pressure each tenth of a second, stamped by one clock and recorded by another."""
    steps = [k * SECOND // 10 for k in range(50)]
    rows = [(1, recorded_ns + step, cdr(stamp_ns + step, 9e4, 1.0)) for step in steps]
    return written(path, [("/baro", AIR, PRESSURE, "cdr")], rows)


def test_stamps_that_have_rolled_over_are_moved_by_the_recorders_clock(tmp_path: Path) -> None:
    rollover_ns = 1024 * 604_800 * SECOND
    log = stamped(tmp_path / "a.mcap", START - rollover_ns, START + SECOND)
    assert log.channel("/baro").time_ns[0] == START
    assert [kind for kind, _, _ in entries(log, "TIME-WEEK-ROLLOVER")] == ["warning"]
    assert log.message("/baro")["time_ns"][0] == START


@pytest.mark.parametrize("stamp_s", [1_150_000_000, 2_145_916_800])  # 2006, 2038
def test_stamps_whose_date_cannot_be_are_no_utc(tmp_path: Path, stamp_s: int) -> None:
    log = stamped(tmp_path / "a.mcap", stamp_s * SECOND, START)
    assert not log.has_utc
    assert len(log.channel("/baro")) == 50
    assert entries(log, "TIME-IMPOSSIBLE")
    assert entries(log, "TIME-NO-UTC")
    assert np.isnan(log.utc_sigma_s)


@pytest.mark.parametrize(("early_s", "expected"), [(30, []), (365 * 86_400, ["warning"])])
def test_stamps_are_compared_with_the_recorders_clock(
    tmp_path: Path, early_s: int, expected: list[str]
) -> None:
    log = stamped(tmp_path / "a.mcap", START - early_s * SECOND, START)
    assert [kind for kind, _, _ in entries(log, "TIME-SOURCES")] == expected


def test_each_kind_is_read_as_ros_2_stores_it(tmp_path: Path) -> None:
    """Values of which the size, the sign and the point count: by hand, little endian."""
    stored = {
        "bool": ("01", 1),
        "byte": ("f0", 240),
        "char": ("f0", -16),
        "int8": ("f0", -16),
        "uint8": ("f0", 240),
        "int16": ("feff", -2),
        "uint16": ("feff", 65534),
        "int32": ("feffffff", -2),
        "uint32": ("feffffff", 4294967294),
        "int64": ("feffffffffffffff", -2),
        "uint64": ("feffffffffffffff", 18446744073709551614),
        "float32": ("0000c0bf", -1.5),
        "float64": ("000000000000f8bf", -1.5),
    }
    assert set(stored) == set(KINDS)
    for kind, (content, value) in stored.items():
        (number,) = np.frombuffer(bytes.fromhex(content), np.dtype(KINDS[kind]).newbyteorder("<"))
        assert number == value, kind
