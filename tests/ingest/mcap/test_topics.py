"""MCAP topics of several definitions, values that are no numbers, and what tables show of them."""

import json
import struct

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal

from tests.helpers import with_code
from tests.ingest.mcap.protobuf_messages import message_class
from tests.ingest.written_logs import HEADER, McapWriter, entry_in, ros_time, with_parts
from unbend.ingest import open_log
from unbend.ingest.mcap.cdr import decode_plan
from unbend.ingest.mcap.message_batches import BATCH_BYTES
from unbend.ingest.mcap.ros2_definitions import KINDS, steps_of
from unbend.ingest.mcap.stamps import order_by_sequence

SECOND = 10**9
START = 1_763_073_169 * SECOND
TIMES = [START + k * SECOND // 10 for k in range(600)]
CDR = b"\0\1\0\0"
AIR = "sensor_msgs/msg/FluidPressure"
WARM = "sensor_msgs/msg/Temperature"
PRESSURE = with_parts(HEADER + "float64 fluid_pressure\nfloat64 variance")
SWAPPED = with_parts(HEADER + "float64 variance\nfloat64 fluid_pressure")
TEMPERATURE = with_parts(HEADER + "float64 temperature\nfloat64 variance")


def cdr(time_ns, *values, head=CDR, align=8):
    """A header and float64, in CDR (in XCDR2 aligned to 4)."""
    body = struct.pack("<iII", *divmod(time_ns, SECOND), 5) + b"base\0"
    padding = bytes(-len(body) % align)
    numbers = struct.pack(f"<{len(values)}d", *values)
    return head + body + padding + numbers


PRESSURES = ("/p", "cdr", AIR, PRESSURE)
TEMPERATURES = ("/t", "cdr", WARM, TEMPERATURE)


def check_entry(log, code, **expected):
    """The only entry with this code has these values."""
    entry = entry_in(log, code)
    for name, value in expected.items():
        assert getattr(entry, name) == value, name


def warm(time_ns):
    """A temperature of the first channel."""
    return (1, time_ns, cdr(time_ns, 15.0, 0.0))


def written(
    opened,
    channels,
    messages,
    sequence=None,
):
    """A log of channels (topic, encoding, name of schema, definition), numbered from 1.

    Messages are channel, log_time and data.
    """
    writer = McapWriter(chunk_size=2000)
    for channel in channels:
        writer.channel(*channel)
    numbers = sequence or range(len(messages))
    for message, number in zip(messages, numbers, strict=True):
        writer.write(*message, number)
    return opened(writer.data)


@pytest.mark.parametrize("mixed", [False, True])
def test_each_definition_of_a_topic_has_its_own_layout(opened, mixed):
    channels = [PRESSURES, ("/p", "cdr", AIR, SWAPPED)]
    expected_pa = 9e4 + np.arange(200)
    messages = []
    for k, t in enumerate(TIMES[:200]):
        is_swapped = k >= 100
        if mixed:
            is_swapped = k % 2 == 1
        if is_swapped:
            messages.append((2, t, cdr(t, 5.0, expected_pa[k])))
        else:
            messages.append((1, t, cdr(t, expected_pa[k], 5.0)))
    log = written(
        opened,
        channels,
        messages,
        [0] * 200,
    )
    assert_array_equal(log.channel("/p")["pressure_pa"], expected_pa)
    assert_array_equal(log.message("/p")["fluid_pressure"], expected_pa)
    assert not log.ledger.has_losses


def test_encodings_of_a_topic_make_one_channel(opened):
    channels = [PRESSURES, ("/p", "json", AIR, "{}")]
    messages = []
    for k, t in enumerate(TIMES[:200]):
        if k % 2:
            row = {
                "header": {"stamp": ros_time(t)},
                "fluid_pressure": 9e4 + k,
            }
            messages.append((2, t, json.dumps(row).encode()))
        else:
            messages.append((1, t, cdr(t, 9e4 + k, 5.0)))
    log = written(opened, channels, messages)
    assert_array_equal(
        log.channel("/p")["pressure_pa"],
        9e4 + np.arange(200),
    )
    assert_array_equal(
        log.channel("/p").time_ns,
        TIMES[:200],
    )
    table = log.message("/p")
    assert_array_equal(table["time_ns"], TIMES[:200])
    assert_array_equal(
        table["variance"],
        [5.0, np.nan] * 100,
    )
    assert not log.ledger.has_losses


def test_schemas_of_a_topic_are_channels_apart_and_one_table(opened):
    channels = [("/air", "cdr", AIR, PRESSURE), ("/air", "cdr", WARM, TEMPERATURE)]
    messages = []
    for k, t in enumerate(TIMES[:60]):
        if k % 2 == 0:
            messages.append((1, t, cdr(t, 9e4, 0.0)))
        else:
            messages.append((2, t, cdr(t, 15.0, 0.0)))
    log = written(opened, channels, messages)
    assert log.messages == {"/air": 60}
    assert log.channel("/air (sensor_msgs/FluidPressure)").roles == ("pressure", "cabin_pressure")
    assert len(log.channel("/air (sensor_msgs/Temperature)")) == 30
    table = log.message("/air")
    assert_array_equal(table["time_ns"], TIMES[:60])
    assert_array_equal(
        table["fluid_pressure"],
        [9e4, np.nan] * 30,
    )
    assert_array_equal(
        table["temperature"],
        [np.nan, 15.0] * 30,
    )


def readings(opened, values, pad=""):
    """A thermometer in CDR, and JSON of nobody's schema."""
    channels = [TEMPERATURES, ("/cabin", "json", "", "")]
    messages = []
    for t, value in zip(TIMES[: len(values)], values, strict=True):
        row = f'{{"timestamp":{t},"pad":"{pad}","value":{value}}}'
        messages.append(warm(t))
        messages.append((2, t, row.encode()))
    return written(opened, channels, messages)


@pytest.mark.parametrize(
    "odd",
    ['"n/a"', "9" * 400, "{}", "[1]"],
)
def test_a_value_that_is_no_number_costs_itself(opened, odd):
    log = readings(
        opened,
        ["3"] * 20 + [odd] + ["2.5", "null", '"4.5"'] * 5,
    )
    expected = [3.0] * 20 + [np.nan] + [2.5, np.nan, 4.5] * 5
    assert_array_equal(log.channel("/cabin")["value"], expected)
    check_entry(log, "LOG-DECODE", kind="loss", where="/cabin", count=1)
    assert log.message("/cabin")["time_ns"].shape == (36,)


PAD_TO_SEVERAL_BATCHES = "x" * (3 * BATCH_BYTES // 600)


def test_texts_in_one_block_take_no_numbers_from_others(opened):
    values = [str(k) for k in range(600)]
    values[20] = '"n/a"'
    log = readings(opened, values, PAD_TO_SEVERAL_BATCHES)
    numbers = log.channel("/cabin")["value"]
    assert np.flatnonzero(np.isnan(numbers)).tolist() == [20]
    assert_array_equal(
        numbers[21:],
        np.arange(21, 600),
    )
    assert log.message("/cabin")["value"][[0, 20, 21, -1]].tolist() == [0, "n/a", 21, 599]


def test_fields_with_names_of_ours_are_fields(opened):
    channels = [
        TEMPERATURES,
        ("/x", "cdr", "my/msg/Foo", "int64 stamp_ns\nint8 place"),
    ]
    messages = []
    for k, t in enumerate(TIMES[:5]):
        messages.append(warm(t))
        messages.append((2, t, CDR + struct.pack("<qb", 7, 5 - k)))
    table = written(opened, channels, messages).message("/x")
    assert table["time_ns"].tolist() == TIMES[:5]
    assert table["stamp_ns"].tolist() == [7] * 5
    assert table["place"].tolist() == [5, 4, 3, 2, 1]


def test_a_topic_of_texts_alone_is_no_loss(opened):
    log = readings(opened, ['"taking off"', '"landed"'] * 5)
    assert [channel.name for channel in log.channels] == ["/t"]
    assert not log.ledger.has_losses
    assert log.message("/cabin")["value"][:2].tolist() == ["taking off", "landed"]


def test_integers_are_exact_in_tables(opened):
    values = [2**60 + k for k in range(300)]
    table = readings(opened, [str(value) for value in values]).message("/cabin")
    assert table["value"].tolist() == values
    assert table["value"].dtype == np.int64
    assert table["timestamp"].tolist() == TIMES[:300]


def test_integers_are_exact_where_parts_are_of_several_kinds(opened):
    values = [2**60 + k for k in range(600)]
    values[0] = 2**64 - 1
    values[1] = None
    values[200] = True
    values[350] = 0.5
    texts = list(map(json.dumps, values))
    log = readings(opened, texts, PAD_TO_SEVERAL_BATCHES)
    assert log.message("/cabin")["value"].tolist() == values


def test_protobuf_integers_are_exact(tmp_path):
    from mcap_protobuf.writer import Writer

    kind = message_class(
        "a.M",
        {
            "a": "UINT64",
            "b": "INT64",
            "c": "BOOL",
            "d": "BYTES",
        },
    )
    path = tmp_path / "pb.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        for k in range(5):
            row = kind(
                a=2**63 + k,
                b=2**53 + 1,
                c=k == 1,
                d=bytes(k),
            )
            writer.write_message(
                "/pb",
                row,
                START + k,
                START + k,
            )
        writer.finish()
    table = open_log(path, needs_channels=False).message("/pb")
    assert table["a"].tolist() == [2**63 + k for k in range(5)]
    assert table["b"].tolist() == [2**53 + 1] * 5
    assert table["c"].tolist() == [False, True, False, False, False]
    assert table["d[]"].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("head", "align"),
    [
        (b"\0\2\0\0", 8),
        (b"\0\3\0\0", 8),
        (b"\0\7\0\0", 4),
        (b"\0\x0b\0\0", 4),
    ],
)
def test_other_encapsulations_are_no_cdr(opened, head, align):
    messages = [(1, t, cdr(t, 9e4, 1.0)) for t in TIMES[:10]]
    messages += [(1, t, cdr(t, 9e4, 1.0, head=head, align=align)) for t in TIMES[10:20]]
    log = written(
        opened,
        [PRESSURES],
        messages,
    )
    assert log.channel("/p")["pressure_pa"].tolist() == [9e4] * 10
    check_entry(log, "LOG-DECODE", kind="loss", where="/p", count=10)


def test_elements_of_long_arrays_are_found_without_the_others():
    steps = steps_of("a/msg/B", "float64[2000000000] v\nuint8 k")
    assert len(decode_plan(steps, frozenset({"v.0", "v.4", "k"})).steps[0]) == 5
    assert decode_plan(steps, frozenset({"v.9", "v.x"})).wanted == {"v.9"}


def test_a_sequence_that_is_cut_off_has_no_length(opened):
    channels = [
        TEMPERATURES,
        ("/x", "cdr", "my/msg/Foo", "uint8 k\nfloat32[<=4] c"),
    ]
    whole = CDR + struct.pack("<B3xIf", 9, 1, 3.0)
    messages = [warm(t) for t in TIMES[:3]]
    messages += [(2, TIMES[0], whole), (2, TIMES[1], whole[:-9])]
    table = written(opened, channels, messages).message("/x")
    assert table["c[]"].tolist() == [1, -1]
    assert table["k"].tolist() == [9, 9]


def numbered(opened, numbers, times):
    """Pressures with these sequence numbers, from 90,000 Pa on as they are numbered."""
    messages = [(1, t, cdr(t, 9e4 + k, 0.0)) for k, t in zip(numbers, times, strict=True)]
    return written(
        opened,
        [PRESSURES],
        messages,
        numbers,
    )


@pytest.mark.parametrize("missing", [0, 7])
def test_chunks_in_another_order_lose_nothing_and_hide_no_gap(opened, missing):
    first = [*range(40), *range(40 + missing, 100)]
    order = [*first, *range(150, 200), *range(100, 150), *range(200, 300)]
    log = numbered(
        opened,
        order,
        [TIMES[k] for k in order],
    )
    assert log.lost_messages == missing
    assert_array_equal(
        log.channel("/p")["pressure_pa"],
        9e4 + np.sort(order),
    )
    reordered_from = f"/p, first at row {len(first)}"
    check_entry(log, "LOG-REORDERED", kind="note", where=reordered_from, count=100)
    assert log.ledger.has_losses == bool(missing)
    if missing:
        check_entry(log, "LOG-LINK-LOSS", kind="finding", where="/p", count=missing)


def test_a_recorder_that_counts_anew_hides_no_gap(opened):
    numbers = [*range(40), *range(47, 100), *range(100)]
    log = numbered(
        opened,
        numbers,
        TIMES[: len(numbers)],
    )
    assert log.lost_messages == 7
    assert with_code(log.ledger, "LOG-REORDERED") == []


def order_of(numbers, times):
    return order_by_sequence(
        np.array(numbers.split(), np.uint32),
        np.array(times.split(), np.int64),
    )


@pytest.mark.parametrize(
    ("numbers", "times"),
    [
        ("0 1 2 3", "10 11 12 13"),  # in order
        ("0 1 2 3", "10 12 11 13"),  # a clock was set back: numbers do not say more
        ("3 2 1 0", "10 12 11 13"),  # numbers that disagree with the times
        ("0 1 0 1", "10 11 5 6"),  # a recorder that counts anew
    ],
)
def test_messages_stay_where_numbers_do_not_put_times_right(numbers, times):
    assert order_of(numbers, times) is None


def stamped(opened, stamp_ns, recorded_ns):
    """A pressure each tenth of a second, stamped by one clock and recorded by another."""
    steps = [k * SECOND // 10 for k in range(50)]
    rows = [(1, recorded_ns + step, cdr(stamp_ns + step, 9e4, 1.0)) for step in steps]
    return written(
        opened,
        [PRESSURES],
        rows,
    )


def test_stamps_that_have_rolled_over_are_moved_by_the_recorders_clock(opened):
    rollover_ns = 1024 * 604_800 * SECOND
    log = stamped(
        opened,
        START - rollover_ns,
        START + SECOND,
    )
    assert log.channel("/p").time_ns[0] == START
    assert entry_in(log, "TIME-WEEK-ROLLOVER").kind == "warning"
    assert log.message("/p")["time_ns"][0] == START


@pytest.mark.parametrize("stamp_s", [1_150_000_000, 2_145_916_800])  # 2006, 2038
def test_stamps_whose_date_cannot_be_are_no_utc(opened, stamp_s):
    log = stamped(opened, stamp_s * SECOND, START)
    assert not log.has_utc
    assert len(log.channel("/p")) == 50
    assert with_code(log.ledger, "TIME-IMPOSSIBLE")
    assert with_code(log.ledger, "TIME-NO-UTC")
    assert np.isnan(log.utc_sigma_s)


@pytest.mark.parametrize(
    ("early_s", "kinds"),
    [(30, []), (365 * 86_400, ["warning"])],
)
def test_stamps_are_compared_with_the_recorders_clock(opened, early_s, kinds):
    log = stamped(
        opened,
        START - early_s * SECOND,
        START,
    )
    assert [entry.kind for entry in with_code(log.ledger, "TIME-SOURCES")] == kinds


STORED = """
bool: ["01", 1]
byte: ["f0", 240]
char: ["f0", -16]
int8: ["f0", -16]
uint8: ["f0", 240]
int16: ["feff", -2]
uint16: ["feff", 65534]
int32: ["feffffff", -2]
uint32: ["feffffff", 4294967294]
int64: ["feffffffffffffff", -2]
uint64: ["feffffffffffffff", 18446744073709551614]
float32: ["0000c0bf", -1.5]
float64: ["000000000000f8bf", -1.5]
"""


def test_each_kind_is_read_as_ros_2_stores_it():
    """Values of which the size, the sign and the point count: by hand, little endian."""
    stored = yaml.safe_load(STORED)
    assert set(stored) == set(KINDS)
    for kind, (content, value) in stored.items():
        (number,) = np.frombuffer(
            bytes.fromhex(content),
            np.dtype(KINDS[kind]).newbyteorder("<"),
        )
        assert number == value, kind
