"""Logs that cost a naive reader more than their bytes: one builder for each way, by its size.

`GROWING` has them by name. ``n`` is how often the structure occurs that costs; the bytes of the log
are proportional to it, except where they are compressed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from struct import pack

from tests.ingest.written_logs import MavlinkWriter, subscription, ulog_message
from unbend.simulate.write_dataflash import FORMATS

START_NS = 1_763_073_169_000_000_000
WEEK_MS = 604_800_000
HEADER_OF_ROS = (
    "===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    "===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
CDR = b"\0\1\0\0"  # little-endian
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


def record(opcode, content):
    return pack("<BQ", opcode, len(content)) + content


def text(value):
    return pack("<I", len(value)) + value.encode()


def packed_chunk(compression, promised, content, crc=0):
    """A chunk that promises so many bytes."""
    head = pack(
        "<QQQI",
        START_NS,
        START_NS,
        promised,
        crc,
    ) + text(compression)
    return record(6, head + pack("<Q", len(content)) + content)


@cache
def packed_zeros(compression, size):
    """Whole mebibytes of zeros."""
    import lz4.frame
    import zstandard

    if compression == "lz4":
        packer = lz4.frame.LZ4FrameCompressor()
        parts = [packer.begin()]
    else:
        packer = zstandard.ZstdCompressor().compressobj()
        parts = []
    block = bytes(1 << 20)
    for _ in range(size >> 20):
        parts.append(packer.compress(block))
    return b"".join([*parts, packer.flush()])


def chunk(records):
    """Records in a chunk that zstd has compressed."""
    import zstandard

    content = zstandard.ZstdCompressor(level=3).compress(records)
    return packed_chunk("zstd", len(records), content)


def mcap(records):
    """A file of these records, without a summary."""
    magic = b"\x89MCAP0\r\n"
    begin = record(1, text("ros2") + text("hostile"))
    end = record(15, bytes(4)) + record(2, bytes(20))
    return magic + begin + records + end + magic


def schema(number, name, definition):
    """A message of ROS."""
    content = pack("<H", number) + text(name) + text("ros2msg") + text(definition)
    return record(3, content)


def channel(number, schema_number, topic, encoding):
    head = pack("<HH", number, schema_number)
    content = head + text(topic) + text(encoding) + pack("<I", 0)
    return record(4, content)


def message(number, k, content):
    time_ns = START_NS + k * 10_000_000
    return record(5, pack("<HIQQ", number, k, time_ns, time_ns) + content)


def stamped(k, frame=b"b\0"):
    """CDR: the header of a message of ROS, its text with the NUL; padded to 8 bytes."""
    seconds, part_ns = divmod(START_NS + k * 10_000_000, 10**9)
    data = pack("<iII", seconds, part_ns, len(frame)) + frame
    return padded(data, 8)


def padded(data, step):
    """Zeros up to the next multiple of the step."""
    return data + bytes(-len(data) % step)


def pressure(number, k, pressure_pa):
    """A message of static pressure."""
    return message(number, k, CDR + stamped(k) + pack("<d", pressure_pa))


def pressures(count):
    return b"".join(pressure(1, k, 9e4 - k) for k in range(count))


def stamped_schema(number, name, fields):
    """A message of ROS with a header."""
    return schema(number, name, f"std_msgs/Header header\n{fields}{HEADER_OF_ROS}")


PRESSURE = stamped_schema(1, FLUID_PRESSURE, "float64 fluid_pressure\n")
AIR = PRESSURE + channel(1, 1, "/air", "cdr")


def beside_air(definitions, rows):
    """A log of thirty pressures, and of messages of others in a chunk."""
    return mcap(AIR + pressures(30) + definitions + chunk(rows))


def before_a_pressure(definitions, content):
    """A log of a message whose wanted field stands behind this content; compressed."""
    content = padded(content, 8) + pack("<d", 9e4)
    return beside_air(definitions, message(2, 0, CDR + content))


def elements_of_bytes(n):
    """Three sequences of n elements of two bytes each, before the wanted field; compressed."""
    fields = "a/Pair[] a\na/Pair[] b\na/Pair[] c\nfloat64 fluid_pressure\n"
    pair = "\n===\nMSG: a/Pair\nuint8 x\nuint8 y\n"
    definition = f"std_msgs/Header header\n{fields}{HEADER_OF_ROS}{pair}"
    definitions = schema(2, FLUID_PRESSURE, definition)
    definitions += channel(2, 2, "/bytes", "cdr")
    content = stamped(0)
    for _ in range(3):
        content = padded(content, 4) + pack("<I", n) + bytes(2 * n)
    # messages longer than 64 KiB are not kept whole: many shorter ones cost the same
    return before_a_pressure(definitions, content)


def elements_of_texts(n):
    """A sequence of n texts before the wanted field; compressed."""
    fields = "string[] words\nfloat64 fluid_pressure\n"
    definitions = stamped_schema(2, FLUID_PRESSURE, fields)
    definitions += channel(2, 2, "/words", "cdr")
    content = stamped(0) + pack("<I", n) + bytes(4 * n)
    return before_a_pressure(definitions, content)


def new_keys(n):
    """n messages of JSON, each with 300 keys that no other has; compressed."""
    rows = []
    for k in range(n):
        keys = ",".join(f'"k{k}_{j}":1' for j in range(300))
        content = f'{{"timestamp":{START_NS + k},"value":{k},{keys}}}'
        rows.append(message(2, k, content.encode()))
    return beside_air(channel(2, 0, "/json", "json"), b"".join(rows))


def long_names(n):
    """A text of 50 n letters in one exposure among n others; compressed."""
    definitions = stamped_schema(
        2,
        "sensor_msgs/msg/CompressedImage",
        "string format\nuint8[] data\n",
    )
    definitions += channel(2, 2, "/camera", "cdr")
    image = pack("<I4sI", 4, b"jpg\0", 0)
    rows = []
    for k in range(n):
        letters = 50 * n if k == n // 2 else 1
        frame = b"f" * letters + b"\0"
        rows.append(message(2, k, CDR + stamped(k, frame) + image))
    return beside_air(definitions, b"".join(rows))


def chunks_of(row, n):
    """A record n times, 100,000 in a chunk."""
    sizes = [min(100_000, n - done) for done in range(0, n, 100_000)]
    return b"".join(chunk(row * size) for size in sizes)


def minimal_messages(n):
    """n messages without content that take nearly no bytes; compressed."""
    definitions = PRESSURE + channel(2, 1, "/empty", "cdr")
    rows = chunks_of(message(2, 0, b""), n)
    return mcap(AIR + pressures(30) + definitions + rows)


def minimal_values(n):
    """n messages of pressure that are all the same; compressed."""
    return mcap(AIR + chunks_of(pressure(1, 0, 9e4), n))


def tiny_chunks(n):
    """n chunks with a message each, and as many without any."""
    parts = []
    for k in range(n):
        parts += [chunk(pressure(1, k, 9e4 - k)), chunk(b"")]
    return mcap(AIR + b"".join(parts))


def many_channels(n):
    """n topics with a message each."""
    parts = [PRESSURE]
    for k in range(n):
        parts.append(channel(k + 1, 1, f"/t{k}", "cdr"))
        parts.append(pressure(k + 1, k, 9e4))
    return mcap(b"".join(parts))


# DataFlash as text and in binary.


def definition_line(number, name, letters, columns):
    length = 3 + 8 * len(letters)
    return f"FMT, {number}, {length}, {name}, {letters}, {columns}"


BARO_LINES = [
    definition_line(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    definition_line(129, "BARO", "QBff", "TimeUS,I,Press,Temp"),
]


def baro_lines(count, from_us=1_000_000):
    for k in range(count):
        yield f"BARO, {from_us + 100_000 * k}, 0, {90_000 - k}.5, 20.25"


def text_log(lines):
    return "\n".join([*lines, ""]).encode()


def redefined_lines(n):
    """n times a new definition of GPS, and a row of it."""
    lines = [*BARO_LINES, *baro_lines(30)]
    for k in range(n):
        columns = f"TimeUS,Status,GMS,GWk,NSats,F{k},G{k},H{k}"
        lines.append(definition_line(130, "GPS", "QBIHBfff", columns))
        lines.append(f"GPS, {1_000_000 + k}, 3, {k}, 2200, 9, 1.0, 2.0, 3.0")
    return text_log(lines)


def defined_in_turns(n):
    """n new message types, each defined once and with a row."""
    lines = [*BARO_LINES, *baro_lines(30)]
    for k in range(n):
        lines.append(definition_line(130, f"M{k}", "QB", "TimeUS,X"))
        lines.append(f"M{k}, {1_000_000 + k}, 3")
    return text_log(lines)


def boots_as_text(n):
    """n power-ups of thirty rows, with a fix each."""
    lines = [
        *BARO_LINES,
        definition_line(130, "GPS", "QBBIHLLf", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt"),
    ]
    for boot in range(n):
        lines += baro_lines(12, from_us=5_000_000)
        for k in range(3):
            week_ms = 1000 * (60 * boot + k) % WEEK_MS
            time_us = 6_000_000 + 200_000 * k
            lines.append(f"GPS, {time_us}, 0, 3, {week_ms}, 2200, 47.0, 8.0, 500.0")
    return text_log(lines)


def packed(name, **values):
    """A record of DataFlash whose other fields are zero."""
    form = FORMATS[name]
    blank = {}
    for field, letter in zip(form.columns.split(","), form.format, strict=True):
        blank[field] = b"" if letter in "nNZ" else 0
    return form.pack(*(blank | values).values())


def binary_definition(type_id, name, letters, columns, length):
    return FORMATS["FMT"].pack(
        type_id,
        length,
        name.encode(),
        letters.encode(),
        columns.encode(),
    )


def definition_of(name):
    form = FORMATS[name]
    length = 3 + form.struct.size
    return binary_definition(
        form.type_id,
        form.name,
        form.format,
        form.columns,
        length,
    )


def baro_record(time_us, pressure_pa=90_000.0):
    return packed("BARO", TimeUS=time_us, Press=pressure_pa, Temp=20.0)


def record_of_200(columns):
    """A record of the type that a builder defines."""
    return b"\xa3\x95" + bytes([200]) + columns


def binary_log(records):
    data = definition_of("FMT") + definition_of("BARO")
    for k in range(30):
        data += baro_record(1_000_000 + 100_000 * k, 90_000.0 - k)
    return data + records


def redefined_records(n):
    """n times a new definition of one type, and a record of it."""
    parts = []
    for k in range(n):
        parts.append(binary_definition(200, "GPS", "QBI", f"TimeUS,A{k},B{k}", 16))
        parts.append(record_of_200(pack("<QBI", 1_000_000 + k, 3, 5)))
    return binary_log(b"".join(parts))


def redefined_in_turns(n):
    """One type that has two definitions in turns."""
    parts = []
    for k in range(n):
        letters = "QI" if k % 2 else "QH"
        row = record_of_200(pack(f"<{letters}", 1_000_000 + k, 5))
        parts.append(binary_definition(200, "GPS", letters, "TimeUS,A", len(row)))
        parts.append(row)
    return binary_log(b"".join(parts))


def boots_as_records(n):
    """n power-ups of a few records, with a fix each."""
    parts = [definition_of("GPS")]
    for boot in range(n):
        parts += [baro_record(5_000_000 + 100_000 * k) for k in range(12)]
        for k in range(3):
            fix = packed(
                "GPS",
                TimeUS=6_000_000 + 200_000 * k,
                Status=4,
                GMS=1000 * (60 * boot + k) % WEEK_MS,
                GWk=2200,
                Lat=47.0,
                Lng=8.0,
            )
            parts.append(fix)
    return binary_log(b"".join(parts))


def damage_again_and_again(n):
    """n times four records with a bad byte behind."""
    rows = b"".join(baro_record(5_000_000 + k) for k in range(4))
    return binary_log((rows + b"\xa3") * n)


# PX4.


def baro_data(number, time_us, pressure_pa):
    return ulog_message("D", pack("<HQ2f", number, time_us, pressure_pa, 20.0))


def ulog(parts):
    head = b"ULog\x01\x12\x35\x01" + pack("<Q", 1000) + ulog_message("B", bytes(40))
    head += ulog_message("F", b"sensor_baro:uint64_t timestamp;float pressure;float temperature;")
    data = subscription(0, "sensor_baro")
    for k in range(30):
        data += baro_data(0, 1_000_000 + 100_000 * k, 9e4 - k)
    for part in parts:
        if part[2] in b"FIMPQ":
            head += part
        else:
            data += part
    return head + data


def nested_formats(n):
    """n topics of nested formats, each of which has as many fields as a message may have bytes."""
    parts = [ulog_message("F", b"a:uint8_t[250] x;"), ulog_message("F", b"b:a[250] y;")]
    for k in range(n):
        parts.append(ulog_message("F", f"t{k}:uint64_t timestamp;b z;".encode()))
        parts.append(subscription(k + 1, f"t{k}"))
    return ulog(parts)


def many_topics(n):
    """n instances of the barometer, with a row each."""
    parts = []
    for k in range(n):
        parts.append(subscription(k + 1, "sensor_baro", instance=k % 256))
        parts.append(baro_data(k + 1, 1_000_000, 9e4))
    return ulog(parts)


# Telemetry.


HOST_US = 1_700_000_000_000_000


def send_pressure(writer: MavlinkWriter, host_us, boot_ms, source=(1, 1)):
    """A reading of 700 hPa at 45 degrees."""
    air = {
        "time_boot_ms": boot_ms,
        "press_abs": 700.0,
        "temperature": 4500,
    }
    writer.send("scaled_pressure", host_us, source, **air)


def boots_of_telemetry(n):
    """n power-ups with UTC."""
    writer = MavlinkWriter()
    for boot in range(n):
        for k in range(6):
            boot_ms = 5000 + 200 * k
            host_us = HOST_US + 60_000_000 * boot + 200_000 * k
            writer.send(
                "system_time",
                host_us,
                time_unix_usec=host_us,
                time_boot_ms=boot_ms,
            )
            send_pressure(writer, host_us + 1, boot_ms)
    return writer.data


def many_senders(n):
    """n systems and components with a row each."""
    writer = MavlinkWriter()
    for k in range(n):
        system = 1 + k // 250 % 250
        component = 1 + k % 250
        send_pressure(
            writer,
            HOST_US + 1000 * k,
            5000 + k,
            (system, component),
        )
    return writer.data


def unknown_ids(n):
    """n messages, and behind each a frame of another id that no dialect has."""
    writer = MavlinkWriter()
    for k in range(n):
        send_pressure(writer, HOST_US + 1000 * k, 5000 + k)
    parts = []
    for k, frame in enumerate(writer.frames):
        unknown_id = (50_000 + k).to_bytes(3, "little")
        head = pack(
            ">QBBBBBBB",
            HOST_US + 1000 * k + 1,
            0xFD,
            4,
            0,
            0,
            k % 256,
            1,
            1,
        )
        parts += [frame, head + unknown_id + b"\1\2\3\4\5\6"]
    return b"".join(parts)


def named_values(n):
    """n names of values with a row each."""
    writer = MavlinkWriter()
    for k in range(n):
        host_us = HOST_US + 1000 * k
        boot_ms = 5000 + k
        value = {
            "time_boot_ms": boot_ms,
            "name": f"v{k}".encode(),
            "value": 1.0,
        }
        writer.send("named_value_float", host_us, **value)
        send_pressure(writer, host_us + 1, boot_ms)
    return writer.data


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
