"""Rows of ULog files, bit for bit those of pyulog, for formats of any kind."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tests.ingest.written_logs import subscription, ulog_message
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.ulog.ulog_messages import ULogMessages, flags_of

SIZES = {
    "int8_t": 1,
    "uint8_t": 1,
    "bool": 1,
    "char": 1,
    "int16_t": 2,
    "uint16_t": 2,
    "int32_t": 4,
    "uint32_t": 4,
    "float": 4,
    "int64_t": 8,
    "uint64_t": 8,
    "double": 8,
}
HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)


def definition(name, fields):
    return ulog_message("F", f"{name}:{fields}".encode())


def datum(number, content):
    return ulog_message("D", struct.pack("<H", number) + content)


def read(data):
    return ULogMessages(view_of_bytes(data), ("a",))


FIELDS = st.lists(
    st.tuples(
        st.sampled_from([*SIZES, "inner", "outer"]),
        st.integers(0, 3),
    ),
    max_size=6,
)
"""Types and lengths of arrays; 0 for one value."""


def declared(fields):
    text = ""
    for k, (kind, count) in enumerate(fields):
        text += f"{kind}[{count}] f{k};" if count else f"{kind} f{k};"
    return text


@given(
    inner=FIELDS.filter(bool),
    outer=FIELDS,
    top=FIELDS,
    padding=st.integers(0, 7),
    rows=st.lists(
        st.tuples(st.integers(0, 2), st.booleans()),
        min_size=1,
        max_size=20,
    ),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=40)
def test_rows_are_those_of_pyulog(inner, outer, top, padding, rows, seed):
    """Three instances of a nested format, with and without the padding at its end.

    pyulog 1.3 drops rows with padding, whatever its comment says: it gets them without.
    """
    pyulog = pytest.importorskip("pyulog")
    inner = [(kind if kind in SIZES else "float", count) for kind, count in inner]
    outer = [("inner" if kind == "outer" else kind, count) for kind, count in outer]
    outer.insert(0, ("double", 0))
    sizes = dict(SIZES)
    for name, fields in (("inner", inner), ("outer", outer), ("top", top)):
        sizes[name] = sum(sizes[kind] * max(count, 1) for kind, count in fields)
    pad = f"uint8_t[{padding}] _padding0;" if padding else ""
    data = HEADER + ulog_message("B", bytes(40)) + definition("inner", declared(inner))
    data += definition("a", f"uint64_t timestamp;{declared(top)}{pad}")
    data += definition("outer", declared(outer))
    for instance in range(3):
        data += subscription(7 + instance, "a", instance)
    random = np.random.default_rng(seed)
    reference = data
    for instance, padded in rows:
        content = random.bytes(8 + sizes["top"])
        reference += datum(7 + instance, content)
        data += datum(7 + instance, content + bytes(padding * padded))
    ours = read(data)
    assert ours.counts == {"a": len(rows)}
    assert ours.bad_bytes == ours.cut_bytes == 0
    expected = pyulog.ULog(io.BytesIO(reference)).data_list
    assert list(ours.rows) == [(topic.name, topic.multi_id) for topic in expected]
    for topic, columns in zip(expected, ours.rows.values(), strict=True):
        assert list(topic.data) == list(columns.dtype.names or ())
        for name, column in topic.data.items():
            assert columns[name].dtype == column.dtype
            assert columns[name].tobytes() == column.tobytes()


ROW = datum(0, bytes(12))
GOOD = HEADER + definition("a", "uint64_t timestamp;float x;")
SUBSCRIBED = subscription(0, "a")


@pytest.mark.parametrize(
    "format_a",
    [
        b"a:uint64_t timestamp;float x;float x;",
        b"a:uint64_t timestamp;b x;",
        b"a:uint64_t timestamp;a x;",
        b"a:uint64_t timestamp;double[9000] x;",
        b"a:uint64_t timestamp;float[0] x;",
        b"a uint64_t timestamp;float x;",
        b"a:uint64_t timestamp;float;",
    ],
    ids=[
        "two columns of one name",
        "nothing defines b",
        "endless",
        "longer than a message",
        "no elements",
        "no colon",
        "no name",
    ],
)
def test_what_is_not_defined_is_not_read(format_a):
    ours = read(HEADER + ulog_message("F", format_a) + SUBSCRIBED + 4 * ROW)
    assert not ours.counts
    assert ours.bad_bytes >= len(4 * ROW + SUBSCRIBED)


def test_data_of_another_length_than_their_format_are_damage():
    longer = datum(0, bytes(13))
    shorter = datum(0, bytes(11))
    start = GOOD + SUBSCRIBED + 4 * ROW
    ours = read(start + longer + 4 * ROW + shorter + 4 * ROW)
    assert ours.counts == {"a": 12}
    assert ours.bad_bytes == len(longer + shorter)
    assert ours.first_bad == len(start)


def test_a_subscription_that_came_twice_is_no_damage():
    ours = read(GOOD + SUBSCRIBED + ROW + SUBSCRIBED + ROW)
    assert ours.bad_bytes == 0
    assert len(ours.rows["a", 0]) == 2  # pyulog alone forgets the first


def test_a_number_is_given_once():
    other = subscription(0, "a", 1)
    ours = read(GOOD + SUBSCRIBED + other + 4 * ROW)
    assert ours.bad_bytes == len(other)
    assert ours.counts == {"a": 4}


def test_rows_of_a_large_file_are_in_order():
    """More than one block of 4 MiB, with a message across its end and damage in the second."""
    count = 260_000
    table = np.zeros(
        count,
        [("head", "V5"), ("t", "<u8"), ("x", "<f4")],
    )
    table["head"] = np.frombuffer(ROW[:5], "V5")[0]
    table["t"] = np.arange(count)
    data = GOOD + SUBSCRIBED + table.tobytes()
    assert len(data) > 4 << 20
    assert_array_equal(read(data).rows["a", 0]["timestamp"], np.arange(count))
    cut = len(data) - 17 * 1000
    ours = read(data[:cut] + b"\xff" * 9 + data[cut:])
    assert ours.counts["a"] == count
    assert ours.bad_bytes == 9
    assert ours.first_bad == cut


def test_data_without_a_definition_are_passed_one_by_one():
    """Half of the messages of a large file, whose subscription was lost: they are found at once."""
    unknown = datum(1, bytes(200))
    count = 30_000
    ours = read(GOOD + SUBSCRIBED + count * (ROW + unknown))
    assert ours.counts == {"a": count}
    assert ours.bad_bytes == count * len(unknown)


def test_flags_and_places_of_appended_data():
    incompatible = b"\1" + bytes(7)
    places = struct.pack("<3Q", 70, 0, 10**6)
    data = HEADER + ulog_message("B", bytes(8) + incompatible + places) + bytes(50)
    assert flags_of(view_of_bytes(data)) == (incompatible, [70])  # inside the file
    assert flags_of(view_of_bytes(GOOD + bytes(50))) == (bytes(8), [])
    unset = HEADER + ulog_message("B", bytes(16) + places) + bytes(50)
    assert flags_of(view_of_bytes(unset)) == (bytes(8), [])


def test_a_time_that_is_an_array_is_none():
    timeless = definition("a", "uint64_t[1] timestamp;float x;")
    ours = read(HEADER + timeless + SUBSCRIBED + 4 * ROW)
    assert ours.without_timestamp == {"a"}
    assert ours.counts == {"a": 4}
    assert ours.rows == {}
