"""Rows of ULog files, bit for bit those of pyulog, for formats of any kind."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


def message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content


def subscription(number: int, name: str, instance: int = 0) -> bytes:
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def datum(number: int, content: bytes) -> bytes:
    return message("D", struct.pack("<H", number) + content)


def read(data: bytes, *topics: str) -> ULogMessages:
    return ULogMessages(view_of_bytes(data), topics)


FIELDS = st.lists(
    st.tuples(st.sampled_from([*SIZES, "inner", "outer"]), st.integers(0, 3)), max_size=6
)


def declared(fields: list[tuple[str, int]]) -> str:
    return "".join(
        f"{kind}[{count}] f{k};" if count else f"{kind} f{k};"
        for k, (kind, count) in enumerate(fields)
    )


@given(
    inner=FIELDS.filter(bool),
    outer=FIELDS,
    top=FIELDS,
    padding=st.integers(0, 7),
    rows=st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=20),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=60)
def test_rows_are_those_of_pyulog(
    inner: list[tuple[str, int]],
    outer: list[tuple[str, int]],
    top: list[tuple[str, int]],
    padding: int,
    rows: list[tuple[int, bool]],
    seed: int,
) -> None:
    """Three instances of a nested format, with and without the padding at its end.

    pyulog 1.3 drops rows with padding, whatever its comment says: it gets them without.
    """
    pyulog = pytest.importorskip("pyulog")
    inner = [(kind if kind in SIZES else "float", count) for kind, count in inner]
    outer = [("double", 0), *((k if k != "outer" else "inner", n) for k, n in outer)]
    sizes = dict(SIZES)
    for name, fields in (("inner", inner), ("outer", outer), ("top", top)):
        sizes[name] = sum(sizes[kind] * max(count, 1) for kind, count in fields)
    pad = f"uint8_t[{padding}] _padding0;" if padding else ""
    data = HEADER + message("B", bytes(40))
    data += message("F", f"inner:{declared(inner)}".encode())
    data += message("F", f"top:uint64_t timestamp;{declared(top)}{pad}".encode())
    data += message("F", f"outer:{declared(outer)}".encode())
    for instance in range(3):
        data += subscription(7 + instance, "top", instance)
    random = np.random.default_rng(seed)
    reference = data
    for instance, padded in rows:
        content = random.bytes(8 + sizes["top"])
        reference += datum(7 + instance, content)
        data += datum(7 + instance, content + bytes(padding * padded))
    found = read(data, "top")
    assert found.counts == {"top": len(rows)}
    assert found.bad_bytes == found.cut_bytes == 0
    expected = pyulog.ULog(io.BytesIO(reference)).data_list
    assert list(found.rows) == [(topic.name, topic.multi_id) for topic in expected]
    for topic, columns in zip(expected, found.rows.values(), strict=True):
        assert list(topic.data) == list(columns.dtype.names or ())
        for name, column in topic.data.items():
            assert columns[name].dtype == column.dtype
            assert columns[name].tobytes() == column.tobytes()


def rejected(*definitions: bytes) -> tuple[int, dict[str, Any]]:
    """Bytes that were not used, and the counts, of a file with some rows of topic 0."""
    found = read(HEADER + b"".join(definitions) + 4 * datum(0, bytes(12)), "a")
    return found.bad_bytes, dict(found.counts)


ROWS = 4 * len(datum(0, bytes(12)))
GOOD = message("F", b"a:uint64_t timestamp;float x;")


@pytest.mark.parametrize(
    "format_a",
    [
        message("F", b"a:uint64_t timestamp;float x;float x;"),  # two columns of one name
        message("F", b"a:uint64_t timestamp;b x;"),  # nothing defines b
        message("F", b"a:uint64_t timestamp;a x;"),  # endless
        message("F", b"a:uint64_t timestamp;double[9000] x;"),  # longer than a message
        message("F", b"a:uint64_t timestamp;float[0] x;"),
        message("F", b"a uint64_t timestamp;float x;"),
        message("F", b"a:uint64_t timestamp;float;"),
    ],
)
def test_what_is_not_defined_is_not_read(format_a: bytes) -> None:
    bad, counts = rejected(format_a, subscription(0, "a"))
    assert not counts
    assert bad >= ROWS + len(subscription(0, "a"))


def test_data_of_another_length_than_their_format_are_damage() -> None:
    rows = 4 * datum(0, bytes(12))
    longer = datum(0, bytes(13))
    shorter = datum(0, bytes(11))
    start = HEADER + GOOD + subscription(0, "a")
    found = read(start + rows + longer + rows + shorter + rows, "a")
    assert found.counts == {"a": 12}
    assert found.bad_bytes == len(longer) + len(shorter)
    assert found.first_bad == len(start + rows)


def test_a_number_is_given_once() -> None:
    """The first subscription counts; repeated as it is, by a block that came twice, it is none."""
    again = subscription(0, "a")
    assert rejected(GOOD, again, again) == (0, {"a": 4})
    other = subscription(0, "a", 1)
    assert rejected(GOOD, again, other) == (len(other), {"a": 4})
    data = HEADER + GOOD + again + datum(0, bytes(12)) + again + datum(0, bytes(12))
    assert len(read(data, "a").rows["a", 0]) == 2  # pyulog alone forgets the first


def test_rows_of_a_large_file_are_in_order() -> None:
    """More than one block of 4 MiB, with a message across its end and damage in the second."""
    data = HEADER + GOOD + subscription(0, "a")
    count = 260_000
    table = np.zeros(count, np.dtype([("head", "V5"), ("t", "<u8"), ("x", "<f4")]))
    table["head"] = np.frombuffer(datum(0, bytes(12))[:5], "V5")[0]
    table["t"] = np.arange(count)
    data += table.tobytes()
    assert len(data) > 4 << 20
    found = read(data, "a")
    assert found.rows["a", 0]["timestamp"].tolist() == list(range(count))
    cut = len(data) - 17 * 1000
    found = read(data[:cut] + b"\xff" * 9 + data[cut:], "a")
    assert (found.counts["a"], found.bad_bytes, found.first_bad) == (count, 9, cut)


def test_data_without_a_definition_are_passed_one_by_one() -> None:
    """Half of the messages of a large file, whose subscription was lost: they are found at once."""
    pair = datum(0, bytes(12)) + datum(1, bytes(200))
    count = 30_000
    found = read(HEADER + GOOD + subscription(0, "a") + count * pair, "a")
    assert found.counts == {"a": count}
    assert found.bad_bytes == count * len(datum(1, bytes(200)))


def test_flags_and_places_of_appended_data() -> None:
    flags = struct.pack("<8s8s3Q", bytes(8), b"\1" + bytes(7), 70, 0, 10**6)
    data = HEADER + message("B", flags) + bytes(50)
    assert flags_of(view_of_bytes(data)) == (b"\1" + bytes(7), [70])  # inside the file
    assert flags_of(view_of_bytes(HEADER + GOOD + bytes(50))) == (bytes(8), [])
    unset = HEADER + message("B", flags[:8] + bytes(8) + flags[16:]) + bytes(50)
    assert flags_of(view_of_bytes(unset)) == (bytes(8), [])


def test_a_time_that_is_an_array_is_none() -> None:
    found = read(
        HEADER
        + message("F", b"a:uint64_t[1] timestamp;float x;")
        + subscription(0, "a")
        + 4 * datum(0, bytes(12)),
        "a",
    )
    assert (found.timeless, found.counts, found.rows) == ({"a"}, {"a": 4}, {})
