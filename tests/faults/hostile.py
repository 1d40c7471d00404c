"""Logs that cost a naive reader more than their bytes: one builder for each way, by its size.

`GROWING` has them by name. ``n`` is how often the structure occurs that costs; the bytes of the log
are proportional to it, except where they are compressed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from unbend.simulate.write_dataflash import FORMATS

START_NS = 1_763_073_169_000_000_000
HEADER_OF_ROS = (
    "===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    "===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
TOO_LARGE = "LOG-TOO-LARGE"


@dataclass(frozen=True)
class Hostile:
    """A way to cost more than the bytes: the extension of its logs, and their bytes for a size.

    ``n``: the size at which it was found; ``small``: one at which the growth of work shows.
    ``said``: the loss or refusal at ``n``.
    """

    suffix: str
    build: Callable[[int], bytes]
    n: int
    small: int = 2000
    said: str = ""


# MCAP: records as its specification has them.


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(records: bytes) -> bytes:
    """Records in a chunk that zstd has compressed."""
    import zstandard

    packed = zstandard.ZstdCompressor(level=3).compress(records)
    head = struct.pack("<QQQI", START_NS, START_NS, len(records), 0) + text("zstd")
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def mcap(records: bytes) -> bytes:
    """A file of these records, without a summary."""
    magic = b"\x89MCAP0\r\n"
    end = record(15, bytes(4)) + record(2, bytes(20))
    return magic + record(1, text("ros2") + text("hostile")) + records + end + magic


def schema(number: int, name: str, encoding: str, definition: str) -> bytes:
    return record(3, struct.pack("<H", number) + text(name) + text(encoding) + text(definition))


def channel(number: int, schema_number: int, topic: str, encoding: str) -> bytes:
    head = struct.pack("<HH", number, schema_number)
    return record(4, head + text(topic) + text(encoding) + struct.pack("<I", 0))


def message(number: int, k: int, content: bytes) -> bytes:
    time_ns = START_NS + k * 10_000_000
    return record(5, struct.pack("<HIQQ", number, k, time_ns, time_ns) + content)


def stamped(k: int, frame: bytes = b"b\0") -> bytes:
    """CDR: the header of a message of ROS, its text with the NUL; padded to 8 bytes."""
    seconds, part_ns = divmod(START_NS + k * 10_000_000, 10**9)
    data = struct.pack("<iII", seconds, part_ns, len(frame)) + frame
    return data + bytes(-len(data) % 8)


def pressures(count: int, number: int = 1) -> bytes:
    """Messages of static pressure."""
    rows = [
        message(number, k, b"\0\1\0\0" + stamped(k) + struct.pack("<d", 9e4 - k))
        for k in range(count)
    ]
    return b"".join(rows)


PRESSURE = schema(
    1, FLUID_PRESSURE, "ros2msg", f"std_msgs/Header header\nfloat64 fluid_pressure\n{HEADER_OF_ROS}"
)
AIR = PRESSURE + channel(1, 1, "/air", "cdr")


def elements_of_bytes(n: int) -> bytes:
    """Three sequences of n elements of two bytes each, before the wanted field; compressed."""
    element = "===\nMSG: a/Pair\nuint8 x\nuint8 y\n"
    fields = "a/Pair[] a\na/Pair[] b\na/Pair[] c\nfloat64 fluid_pressure\n"
    definition = schema(
        2, FLUID_PRESSURE, "ros2msg", f"std_msgs/Header header\n{fields}{HEADER_OF_ROS}\n{element}"
    )
    content = stamped(0)
    for _ in range(3):
        content += bytes(-len(content) % 4) + struct.pack("<I", n) + bytes(2 * n)
    content += bytes(-len(content) % 8) + struct.pack("<d", 9e4)
    data = definition + channel(2, 2, "/bytes", "cdr")
    # messages longer than 64 KiB are not kept whole: many shorter ones cost the same
    return mcap(AIR + pressures(30) + data + chunk(message(2, 0, b"\0\1\0\0" + content)))


def elements_of_texts(n: int) -> bytes:
    """A sequence of n texts before the wanted field; compressed."""
    definition = schema(
        2,
        FLUID_PRESSURE,
        "ros2msg",
        f"std_msgs/Header header\nstring[] words\nfloat64 fluid_pressure\n{HEADER_OF_ROS}",
    )
    content = stamped(0) + struct.pack("<I", n) + bytes(4 * n)
    content += bytes(-len(content) % 8) + struct.pack("<d", 9e4)
    data = definition + channel(2, 2, "/words", "cdr")
    return mcap(AIR + pressures(30) + data + chunk(message(2, 0, b"\0\1\0\0" + content)))


def new_keys(n: int) -> bytes:
    """n messages of JSON, each with 300 keys that no other has; compressed."""
    rows = []
    for k in range(n):
        keys = ",".join(f'"k{k}_{j}":1' for j in range(300))
        rows.append(message(2, k, f'{{"timestamp":{START_NS + k},"value":{k},{keys}}}'.encode()))
    return mcap(AIR + pressures(30) + channel(2, 0, "/json", "json") + chunk(b"".join(rows)))


def long_names(n: int) -> bytes:
    """A text of 50 n letters in one exposure among n others; compressed."""
    image = f"std_msgs/Header header\nstring format\nuint8[] data\n{HEADER_OF_ROS}"
    rows = []
    for k in range(n):
        frame = b"f" * (50 * n if k == n // 2 else 1) + b"\0"
        rows.append(
            message(2, k, b"\0\1\0\0" + stamped(k, frame) + struct.pack("<I4sI", 4, b"jpg\0", 0))
        )
    data = schema(2, "sensor_msgs/msg/CompressedImage", "ros2msg", image)
    return mcap(
        AIR + pressures(30) + data + channel(2, 2, "/camera", "cdr") + chunk(b"".join(rows))
    )


def minimal_messages(n: int) -> bytes:
    """n messages without content that take nearly no bytes; compressed."""
    row = record(5, struct.pack("<HIQQ", 2, 0, START_NS, START_NS))
    data = PRESSURE + channel(2, 1, "/empty", "cdr")
    chunks = [chunk(row * min(100_000, n - done)) for done in range(0, n, 100_000)]
    return mcap(AIR + pressures(30) + data + b"".join(chunks))


def minimal_values(n: int) -> bytes:
    """n messages of pressure that are all the same; compressed."""
    row = message(1, 0, b"\0\1\0\0" + stamped(0) + struct.pack("<d", 9e4))
    chunks = [chunk(row * min(100_000, n - done)) for done in range(0, n, 100_000)]
    return mcap(AIR + b"".join(chunks))


def tiny_chunks(n: int) -> bytes:
    """n chunks with a message each, and as many without any."""
    parts = []
    for k in range(n):
        row = message(1, k, b"\0\1\0\0" + stamped(k) + struct.pack("<d", 9e4 - k))
        parts += [chunk(row), chunk(b"")]
    return mcap(AIR + b"".join(parts))


def many_channels(n: int) -> bytes:
    """n topics with a message each."""
    parts = [PRESSURE]
    for k in range(n):
        parts.append(channel(k + 1, 1, f"/t{k}", "cdr"))
        parts.append(message(k + 1, k, b"\0\1\0\0" + stamped(k) + struct.pack("<d", 9e4)))
    return mcap(b"".join(parts))


# DataFlash as text and in binary.


def definition_line(number: int, name: str, letters: str, columns: str) -> str:
    length = 3 + 8 * len(letters)
    return f"FMT, {number}, {length}, {name}, {letters}, {columns}"


BARO_LINES = [
    definition_line(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    definition_line(129, "BARO", "QBff", "TimeUS,I,Press,Temp"),
]


def baro_lines(count: int, from_us: int = 1_000_000) -> Iterable[str]:
    for k in range(count):
        yield f"BARO, {from_us + 100_000 * k}, 0, {90_000 - k}.5, 20.25"


def text_log(lines: Iterable[str]) -> bytes:
    return "\n".join([*lines, ""]).encode()


def redefined_lines(n: int) -> bytes:
    """n times a new definition of GPS, and a row of it."""
    lines = [*BARO_LINES, *baro_lines(30)]
    for k in range(n):
        lines.append(
            definition_line(130, "GPS", "QBIHBfff", f"TimeUS,Status,GMS,GWk,NSats,F{k},G{k},H{k}")
        )
        lines.append(f"GPS, {1_000_000 + k}, 3, {k}, 2200, 9, 1.0, 2.0, 3.0")
    return text_log(lines)


def defined_in_turns(n: int) -> bytes:
    """n new message types, each defined once and with a row."""
    lines = [*BARO_LINES, *baro_lines(30)]
    for k in range(n):
        lines.append(definition_line(130, f"M{k}", "QB", "TimeUS,X"))
        lines.append(f"M{k}, {1_000_000 + k}, 3")
    return text_log(lines)


def boots_as_text(n: int) -> bytes:
    """n power-ups of thirty rows, with a fix each."""
    lines = [
        *BARO_LINES,
        definition_line(130, "GPS", "QBBIHLLf", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt"),
    ]
    for boot in range(n):
        lines += baro_lines(12, from_us=5_000_000)
        for k in range(3):
            week_ms = 1000 * (60 * boot + k)
            time_us = 6_000_000 + 200_000 * k
            lines.append(f"GPS, {time_us}, 0, 3, {week_ms % 604_800_000}, 2200, 47.0, 8.0, 500.0")
    return text_log(lines)


def packed(name: str, **values: object) -> bytes:
    """A record of DataFlash whose other fields are zero."""
    form = FORMATS[name]
    blank: dict[str, object] = {}
    for field, letter in zip(form.columns.split(","), form.format, strict=True):
        blank[field] = b"" if letter in "nNZ" else 0
    return form.pack(*(blank | values).values())


def binary_definition(type_id: int, name: str, letters: str, columns: str, length: int) -> bytes:
    parts = (name.encode(), letters.encode(), columns.encode())
    return FORMATS["FMT"].pack(type_id, length, *parts)


def definition_of(name: str) -> bytes:
    form = FORMATS[name]
    return binary_definition(
        form.type_id, form.name, form.format, form.columns, 3 + form.struct.size
    )


def binary_log(records: bytes) -> bytes:
    rows = b"".join(
        packed("BARO", TimeUS=1_000_000 + 100_000 * k, Press=90_000.0 - k, Temp=20.0)
        for k in range(30)
    )
    return definition_of("FMT") + definition_of("BARO") + rows + records


def redefined_records(n: int) -> bytes:
    """n times a new definition of one type, and a record of it."""
    parts = []
    for k in range(n):
        parts.append(binary_definition(200, "GPS", "QBI", f"TimeUS,A{k},B{k}", 16))
        parts.append(b"\xa3\x95" + bytes([200]) + struct.pack("<QBI", 1_000_000 + k, 3, 5))
    return binary_log(b"".join(parts))


def redefined_in_turns(n: int) -> bytes:
    """One type that has two definitions in turns."""
    parts = []
    for k in range(n):
        letter, value = ("I", struct.pack("<I", 5)) if k % 2 else ("H", struct.pack("<H", 5))
        length = 3 + 8 + len(value)
        parts.append(binary_definition(200, "GPS", f"Q{letter}", "TimeUS,A", length))
        parts.append(b"\xa3\x95" + bytes([200]) + struct.pack("<Q", 1_000_000 + k) + value)
    return binary_log(b"".join(parts))


def boots_as_records(n: int) -> bytes:
    """n power-ups of a few records, with a fix each."""
    parts = [definition_of("GPS")]
    for boot in range(n):
        for k in range(12):
            parts.append(packed("BARO", TimeUS=5_000_000 + 100_000 * k, Press=90_000.0, Temp=20.0))
        for k in range(3):
            week_ms = 1000 * (60 * boot + k)
            fix = {"Status": 4, "GMS": week_ms % 604_800_000, "GWk": 2200, "Lat": 47.0, "Lng": 8.0}
            parts.append(packed("GPS", TimeUS=6_000_000 + 200_000 * k, **fix))
    return binary_log(b"".join(parts))


def damage_again_and_again(n: int) -> bytes:
    """n times four records with a bad byte behind."""
    rows = [packed("BARO", TimeUS=5_000_000 + k, Press=90_000.0, Temp=20.0) for k in range(4)]
    one = b"".join(rows) + b"\xa3"
    return binary_log(one * n)


# PX4.


def ulog_message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def ulog(parts: Iterable[bytes]) -> bytes:
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + ulog_message("B", bytes(40))
    head += ulog_message("F", b"sensor_baro:uint64_t timestamp;float pressure;float temperature;")
    definitions = b""
    data = b""
    for part in parts:
        if part[2] in b"FIMPQ":
            definitions += part
        else:
            data += part
    head += definitions + ulog_message("A", struct.pack("<BH", 0, 0) + b"sensor_baro")
    for k in range(30):
        head += ulog_message("D", struct.pack("<HQ2f", 0, 1_000_000 + 100_000 * k, 9e4 - k, 20.0))
    return head + data


def nested_formats(n: int) -> bytes:
    """n topics of nested formats, each of which has as many fields as a message may have bytes."""
    parts = [ulog_message("F", b"a:uint8_t[250] x;"), ulog_message("F", b"b:a[250] y;")]
    for k in range(n):
        parts.append(ulog_message("F", f"t{k}:uint64_t timestamp;b z;".encode()))
        parts.append(ulog_message("A", struct.pack("<BH", 0, k + 1) + f"t{k}".encode()))
    return ulog(parts)


def many_topics(n: int) -> bytes:
    """n instances of the barometer, with a row each."""
    parts = []
    for k in range(n):
        parts.append(ulog_message("A", struct.pack("<BH", k % 256, k + 1) + b"sensor_baro"))
        parts.append(ulog_message("D", struct.pack("<HQ2f", k + 1, 1_000_000, 9e4, 20.0)))
    return ulog(parts)


# Telemetry.


def telemetry(frames: Iterable[tuple[int, int, int, dict[str, object], str]]) -> bytes:
    """Messages: sender (system, component), host time [us], fields and name."""
    from pymavlink.dialects.v20 import all as library

    senders: dict[tuple[int, int], object] = {}
    parts = []
    for system, component, host_us, fields, name in frames:
        sender = senders.setdefault((system, component), library.MAVLink(None, system, component))
        packet = getattr(library, f"MAVLink_{name}_message")(**fields).pack(sender)
        sender.seq = (sender.seq + 1) % 256  # type: ignore[attr-defined]
        parts.append(struct.pack(">Q", host_us) + packet)
    return b"".join(parts)


HOST_US = 1_700_000_000_000_000


def pressure_fields(ms: int) -> dict[str, object]:
    return {
        "time_boot_ms": ms,
        "press_abs": 700.0,
        "press_diff": 0.0,
        "temperature": 4500,
        "temperature_press_diff": 0,
    }


def boots_of_telemetry(n: int) -> bytes:
    """n power-ups with UTC."""
    frames = []
    for boot in range(n):
        for k in range(6):
            ms = 5000 + 200 * k
            host_us = HOST_US + 60_000_000 * boot + 200_000 * k
            utc = {"time_unix_usec": host_us, "time_boot_ms": ms}
            frames.append((1, 1, host_us, utc, "system_time"))
            frames.append((1, 1, host_us + 1, pressure_fields(ms), "scaled_pressure"))
    return telemetry(frames)


def many_senders(n: int) -> bytes:
    """n systems and components with a row each."""
    frames = []
    for k in range(n):
        host_us = HOST_US + 1000 * k
        frames.append(
            (1 + k // 250 % 250, 1 + k % 250, host_us, pressure_fields(5000 + k), "scaled_pressure")
        )
    return telemetry(frames)


def unknown_ids(n: int) -> bytes:
    """n messages, and behind each a frame of another id that no dialect has."""
    parts = []
    known = telemetry(
        (1, 1, HOST_US + 1000 * k, pressure_fields(5000 + k), "scaled_pressure") for k in range(n)
    )
    place = 0
    for k in range(n):
        end = place + 8 + known[place + 9] + 12  # stamp, payload; header and checksum
        parts.append(known[place:end])
        place = end
        unknown_id = (50_000 + k).to_bytes(3, "little")
        head = struct.pack(">QBBBBBBB", HOST_US + 1000 * k + 1, 0xFD, 4, 0, 0, k % 256, 1, 1)
        parts.append(head + unknown_id + b"\1\2\3\4" + b"\5\6")
    return b"".join(parts)


def named_values(n: int) -> bytes:
    """n names of values with a row each."""
    frames = []
    for k in range(n):
        fields = {"time_boot_ms": 5000 + k, "name": f"v{k}".encode(), "value": 1.0}
        frames.append((1, 1, HOST_US + 1000 * k, fields, "named_value_float"))
        frames.append((1, 1, HOST_US + 1000 * k + 1, pressure_fields(5000 + k), "scaled_pressure"))
    return telemetry(frames)


GROWING = {
    "mcap elements of bytes": Hostile(".mcap", elements_of_bytes, 1_000_000),
    "mcap elements of texts": Hostile(".mcap", elements_of_texts, 1_000_000, 5000, TOO_LARGE),
    "mcap new keys": Hostile(".mcap", new_keys, 1000, 40),
    "mcap long names": Hostile(".mcap", long_names, 8000, 500),
    "mcap minimal messages": Hostile(".mcap", minimal_messages, 3_400_000, 50_000, TOO_LARGE),
    "mcap minimal values": Hostile(".mcap", minimal_values, 2_000_000, 50_000, TOO_LARGE),
    "mcap tiny chunks": Hostile(".mcap", tiny_chunks, 3000, 250),
    "mcap channels": Hostile(".mcap", many_channels, 60_000, 200, TOO_LARGE),
    "text redefined": Hostile(".log", redefined_lines, 26_000, 40, TOO_LARGE),
    "text defined": Hostile(".log", defined_in_turns, 20_000, 500),
    "text boots": Hostile(".log", boots_as_text, 6000, 60, TOO_LARGE),
    "bin redefined": Hostile(".bin", redefined_records, 20_000, 40, TOO_LARGE),
    "bin in turns": Hostile(".bin", redefined_in_turns, 20_000, 1100, TOO_LARGE),
    "bin boots": Hostile(".bin", boots_as_records, 6000, 60, TOO_LARGE),
    "bin damage": Hostile(".bin", damage_again_and_again, 20_000, 1500, TOO_LARGE),
    "ulog nested": Hostile(".ulg", nested_formats, 200, 3, TOO_LARGE),
    "ulog topics": Hostile(".ulg", many_topics, 20_000, 100),
    "tlog boots": Hostile(".tlog", boots_of_telemetry, 1500, 100),
    "tlog senders": Hostile(".tlog", many_senders, 5000, 100, TOO_LARGE),
    "tlog unknown ids": Hostile(".tlog", unknown_ids, 10_000, 500),
    "tlog names": Hostile(".tlog", named_values, 5000, 200, TOO_LARGE),
}
