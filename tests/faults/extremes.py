"""Logs whose fields hold values at their limits, and whose definitions are repeated and nested.

`extreme_log` draws one by its format and a seed: the structure stays whole, the values do not.
"""

import random
import struct
from collections.abc import Callable

import numpy as np

from tests.faults import hostile
from tests.faults.extreme_inputs import WORDS as ALL_WORDS
from tests.faults.extreme_inputs import extreme_number
from tests.ingest.written_logs import MavlinkWriter, blank_fields

WORDS = [word for word in ALL_WORDS if len(word) <= 1000]
JSON_VALUES = (
    "-5",
    "0",
    str(2**63),
    str(2**64),
    "9" * 300,
    "1e400",
    "-1e400",
    "NaN",
    "Infinity",
    "null",
    "true",
    '""',
    '"x"',
    '"0000-00-00T00:00:00Z"',
    '"9999-12-31T23:59:59.999999999Z"',
    '"0001-01-01T00:00:00+23:59"',
    '"9999-12-31T23:59:59-23:59"',
    "[]",
    "{}",
    "[[[[1]]]]",
    '{"sec":-1,"nsec":-1}',
    '{"sec":1e400,"nsec":0}',
    '{"sec":"x"}',
    '{"sec":null,"nsec":null}',
    '{"sec":99999999999999999999,"nsec":5}',
    '{"sec":[1],"nsec":{}}',
)


def extreme_value(letter, draw):
    """A value at a limit of a letter of struct."""
    return extreme_number(np.dtype(letter), draw).item()


def packed_extremes(layout, values, changed, draw):
    """Values packed by the letters of struct, those at some places at their limits."""
    result = list(values)
    for place in changed:
        if isinstance(values[place], int | float):
            result[place] = extreme_value(layout[place], draw)
    return struct.pack("<" + layout, *result)


def some_places(count, draw):
    return {k for k in range(count) if draw.random() < 0.3} or {draw.randrange(count)}


DATAFLASH_ROWS = {
    # letters of FMT; usual values
    "GPS": (
        "QBIHBcLLefffB",
        {
            "TimeUS": 0,
            "Status": 3,
            "GMS": 200_000,
            "GWk": 2200,
            "NSats": 9,
            "HDop": 80,
            "Lat": 470_000_000,
            "Lng": 80_000_000,
            "Alt": 50_000,
            "Spd": 3.0,
            "GCrs": 1.0,
            "VZ": 0.0,
            "I": 0,
        },
    ),
    "ATT": ("QccC", {"TimeUS": 0, "Roll": 100, "Pitch": 50, "Yaw": 9000}),
    "BARO": ("QBff", {"TimeUS": 0, "I": 0, "Press": 9e4, "Temp": 20.0}),
    "HYGR": ("QBff", {"TimeUS": 0, "Id": 0, "Humidity": 50.0, "Temp": 20.0}),
    "CAM": (
        "QIHLLee",
        {
            "TimeUS": 0,
            "GPSTime": 200_000,
            "GPSWeek": 2200,
            "Lat": 470_000_000,
            "Lng": 80_000_000,
            "Alt": 50_000,
            "RelAlt": 100,
        },
    ),
    "GPA": ("QCCf", {"TimeUS": 0, "HAcc": 50, "VAcc": 80, "AEl": 500.0}),
    "DSF": ("QI", {"TimeUS": 0, "Dp": 0}),
    "MNT": ("Qfff", {"TimeUS": 0, "Roll": 1.0, "Pitch": 1.0, "YawE": 1.0}),
    "TRIG": ("QIH", {"TimeUS": 0, "GPSTime": 0, "GPSWeek": 2200}),
}
LETTERS_OF_NUMBERS = "bBhHiIqQfdcCeELg"
LETTERS_OF_STRUCT = str.maketrans("cCeELg", "hHiIie")
"""Of those letters of FMT that struct has in another sense: scaled numbers, and half floats."""


def extreme_dataflash(draw):
    """Some rows with values at their limits; a definition may come again with other letters."""
    parts = [hostile.definition_of("FMT")]
    numbers = {name: 150 + k for k, name in enumerate(DATAFLASH_ROWS)}
    changed = {name: some_places(len(row[0]), draw) for name, row in DATAFLASH_ROWS.items()}
    layouts = {}

    def define(name, letters):
        columns = ",".join(DATAFLASH_ROWS[name][1])
        layouts[name] = letters.translate(LETTERS_OF_STRUCT)
        length = 3 + struct.calcsize("<" + layouts[name])
        parts.append(hostile.binary_definition(numbers[name], name, letters, columns, length))

    for name, (letters, _) in DATAFLASH_ROWS.items():
        define(name, letters)
    share = draw.choice((0.02, 0.5, 1.0))
    for k in range(40):
        for name, (letters, usual) in DATAFLASH_ROWS.items():
            if draw.random() < 0.01:
                define(name, "".join(draw.choice(LETTERS_OF_NUMBERS) for _ in letters))
            values = []
            for field, letter, value in zip(usual, layouts[name], usual.values(), strict=True):
                now = 5_000_000 + 200_000 * k if field == "TimeUS" else value
                if letter in "efd":
                    values.append(float(min(now, 6e4)))
                else:
                    bits = 8 * struct.calcsize(letter)
                    values.append(int(now) % (1 << bits - 1))
            places = changed[name] if draw.random() < share else set()
            row = packed_extremes(layouts[name], values, places, draw)
            parts.append(b"\xa3\x95" + bytes([numbers[name]]) + row)
    return b"".join(parts)


def extreme_text(draw):
    """Lines with odd words in the place of some values."""
    lines = [hostile.BARO_LINES[0]]
    for k, (name, (letters, usual)) in enumerate(DATAFLASH_ROWS.items()):
        lines.append(hostile.definition_line(150 + k, name, letters, ",".join(usual)))
    lines.append(hostile.definition_line(190, "MSG", "QZ", "TimeUS,Message"))
    lines.append(hostile.definition_line(191, "PARM", "QNf", "TimeUS,Name,Value"))
    share = draw.choice((0.02, 0.5, 1.0))
    columns = {name: some_places(len(row[0]), draw) for name, row in DATAFLASH_ROWS.items()}
    words = {name: draw.choice(WORDS) for name in DATAFLASH_ROWS}
    for k in range(40):
        for name, (_, usual) in DATAFLASH_ROWS.items():
            values = [str(value) for value in usual.values()]
            values[0] = str(5_000_000 + 200_000 * k)
            if draw.random() < share:
                for place in columns[name]:
                    values[place] = draw.choice((words[name], draw.choice(WORDS)))
            lines.append(", ".join([name, *values]))
        lines.append(f"MSG, {draw.choice(WORDS)}, {draw.choice(WORDS)}")
        lines.append(f"PARM, {5_000_000 + k}, GPS_DELAY_MS, {draw.choice(WORDS)}")
    return hostile.text_log(lines)


ULOG_TOPICS = {
    "sensor_gps": (
        "QQddfffB",
        "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
        "float altitude_msl_m;float eph;float epv;uint8_t fix_type;",
        (0, 1_700_000_000_000_000, 47.5, 8.25, 600.0, 0.5, 0.5, 3),
    ),
    "vehicle_attitude": ("Qffff", "float[4] q;", (0, 1.0, 0.0, 0.0, 0.0)),
    "sensor_baro": ("Qff", "float pressure;float temperature;", (0, 9e4, 20.0)),
    "camera_capture": (
        "QQIddb",
        "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;int8_t result;",
        (0, 1_700_000_000_000_000, 1, 47.5, 8.25, 1),
    ),
}


def extreme_ulog(draw):
    """Rows with values at their limits, and information and parameters too."""
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + hostile.ulog_message("B", bytes(40))
    for name, (_, fields, _) in ULOG_TOPICS.items():
        data += hostile.ulog_message("F", f"{name}:uint64_t timestamp;{fields}".encode())
    for kind, letter in (("uint64_t", "Q"), ("int64_t", "q"), ("double", "d"), ("float", "f")):
        key = f"{kind} boot_time_utc_us".encode()
        value = struct.pack("<" + letter, extreme_value(letter, draw))
        if draw.random() < 0.5:
            data += hostile.ulog_message("I", bytes([len(key)]) + key + value)
        key = f"{kind} EKF2_GPS_DELAY".encode()
        data += hostile.ulog_message("P", bytes([len(key)]) + key + value)
    for number, name in enumerate(ULOG_TOPICS):
        data += hostile.subscription(number, name)
    share = draw.choice((0.02, 0.5, 1.0))
    changed = {name: some_places(len(row[0]), draw) for name, row in ULOG_TOPICS.items()}
    for k in range(60):
        for number, (name, (layout, _, usual)) in enumerate(ULOG_TOPICS.items()):
            values = [60_000_000 + 100_000 * k, *usual[1:]]
            places = changed[name] if draw.random() < share else set()
            row = packed_extremes(layout, values, places, draw)
            data += hostile.ulog_message("D", struct.pack("<H", number) + row)
        text = struct.pack("<BQ", ord("6"), extreme_value("Q", draw)) + b"text"
        data += hostile.ulog_message("L", text)
    return data


TLOG_MESSAGES = {
    "system_time": {},
    "attitude": {},
    "gps_raw_int": {
        "fix_type": 3,
        "lat": 470_000_000,
        "lon": 80_000_000,
        "alt": 500_000,
        "eph": 80,
        "epv": 80,
        "satellites_visible": 9,
    },
    "scaled_pressure": {"press_abs": 700.0, "temperature": 4500},
    "camera_feedback": {"lat": 470_000_000, "lng": 80_000_000, "alt_msl": 600.0},
    "camera_image_captured": {"camera_id": 1, "q": [1.0, 0, 0, 0], "capture_result": 1},
    "param_value": {"param_id": b"GPS_DELAY_MS", "param_type": 9, "param_count": 1},
}
"""Usual values of fields that are not zero."""

STEADY = {"camera_id", "param_type"}
LETTERS_OF_MAVLINK = {
    "uint8_t": "B",
    "int8_t": "b",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "uint64_t": "Q",
    "float": "f",
}


def letters_of(kind):
    """The letters of struct of a message of pymavlink, by its fields of one number."""
    letters = {}
    blank = blank_fields(kind)
    for field, field_type in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if blank[field] == 0 and field not in STEADY:
            letters[field] = LETTERS_OF_MAVLINK[field_type]
    return letters


def extreme_tlog(draw):
    """Frames whose checksums hold, with values and stamps of reception at their limits."""
    share = draw.choice((0.02, 0.5, 1.0))
    stamp_share = draw.choice((0.0, 0.0, 0.1))
    writer = MavlinkWriter()
    letters = {}
    chosen = {}
    for name in TLOG_MESSAGES:
        letters[name] = letters_of(getattr(writer.library, f"MAVLink_{name}_message"))
        chosen[name] = [field for field in letters[name] if draw.random() < 0.4]
    for k in range(40):
        for name, usual in TLOG_MESSAGES.items():
            ms = 60_000 + 200 * k
            host_us = hostile.HOST_US + 200_000 * k
            now = {
                "time_boot_ms": ms,
                "time_usec": 1000 * ms,
                "time_unix_usec": host_us,
                "img_idx": k,
                "image_index": k,
            }
            fields = usual | {field: now[field] for field in letters[name] if field in now}
            if draw.random() < share:
                for field in chosen[name]:
                    fields[field] = extreme_value(letters[name][field], draw)
            if draw.random() < stamp_share:
                host_us = draw.choice((0, 1, 2**63 - 1, 2**64 - 1, 2**52))
            writer.send(name, host_us, **fields)
    return writer.data


def extreme_mcap(draw):
    """Messages of CDR, JSON and PX4 with times and values at their limits."""
    kinds = {
        1: (
            hostile.FLUID_PRESSURE,
            f"std_msgs/Header header\nfloat64 fluid_pressure\n{hostile.HEADER_OF_ROS}",
        ),
        2: (
            "px4_msgs/msg/SensorGps",
            "uint64 timestamp\nuint64 time_utc_usec\nfloat64 latitude_deg\n"
            "float64 longitude_deg\nfloat64 altitude_msl_m\nuint8 fix_type",
        ),
        3: ("px4_msgs/msg/SensorBaro", "uint64 timestamp\nfloat32 pressure\nfloat32 temperature"),
        4: (
            "sensor_msgs/msg/Temperature",
            "std_msgs/Header header\nfloat64 temperature\n"
            "===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
            "===\nMSG: builtin_interfaces/Time\n"
            + draw.choice(
                (
                    "uint64 sec\nuint64 nanosec",
                    "float64 sec\nfloat64 nanosec",
                    "int8 sec\nint64 nanosec",
                    "bool sec\nbool nanosec",
                    "int32[2] sec\nuint32[2] nanosec",
                    "string sec\nuint32 nanosec",
                )
            ),
        ),
    }
    parts = []
    for number, (name, definition) in kinds.items():
        parts.append(hostile.schema(number, name, definition))
        parts.append(hostile.channel(number, number, f"/t{number}", "cdr"))
    parts.append(hostile.channel(9, 0, "/json", "json"))
    share = draw.choice((0.02, 0.5, 1.0))
    changed = {number: some_places(6, draw) for number in kinds}
    letters_of_time = draw.choice(("QQ", "dd", "qq"))
    for k in range(40):
        now_us = 60_000_000 + 100_000 * k
        rows = {
            1: ("iIId", [1_763_073_169 + k, 5, 0, 9e4]),
            2: ("QQdddB", [now_us, 1_700_000_000_000_000 + now_us, 47.5, 8.25, 600.0, 3]),
            3: ("Qff", [now_us, 9e4, 20.0]),
            4: (
                f"{letters_of_time}QQ",
                [1_763_073_169 + k if letters_of_time != "dd" else 1e9, 5, 0, 0],
            ),
        }
        for number, (layout, values) in rows.items():
            places = set()
            if draw.random() < share:
                places = {place for place in changed[number] if place < len(values)}
            if number == 1:
                places.discard(2)  # the length of a text
            content = packed_extremes(layout, values, places, draw)
            if number == 1:
                content = content[:12] + bytes(4) + content[12:]
            time_ns = hostile.START_NS + 10_000_000 * k
            if draw.random() < 0.05:
                time_ns = draw.choice((0, 1, 2**63 - 1, 2**64 - 1))
            head = struct.pack("<HIQQ", number, k, time_ns, time_ns)
            parts.append(hostile.record(5, head + b"\0\1\0\0" + content))
        stamp = draw.choice(JSON_VALUES) if draw.random() < share else str(hostile.START_NS + k)
        value = draw.choice(JSON_VALUES) if draw.random() < share else str(k)
        content = f'{{"timestamp":{stamp},"header":{{"stamp":{stamp}}},"value":{value}}}'
        parts.append(hostile.message(9, k, content.encode()))
    return hostile.mcap(b"".join(parts))


EXTREME: dict[str, Callable[[random.Random], bytes]] = {
    ".bin": extreme_dataflash,
    ".log": extreme_text,
    ".tlog": extreme_tlog,
    ".mcap": extreme_mcap,
    ".ulg": extreme_ulog,
}


def extreme_log(suffix, seed):
    """The log of a format that a seed draws."""
    return EXTREME[suffix](random.Random(f"{suffix} {seed}"))
