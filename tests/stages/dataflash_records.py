"""Records of a DataFlash log, for tests that change one."""

import struct
from dataclasses import dataclass

HEAD_BYTES = 3
FORMAT_RECORD = 128
FORMAT_BYTES = 89
TEXTS = ((5, 9), (9, 25), (25, 89))
"""Bytes of the name, the letters and the columns in the record of a format."""

STRUCT_CODES = {
    "a": "64s",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "M": "B",
}
"""Codes of `struct` for letters of formats; other letters are codes themselves."""


@dataclass(frozen=True)
class Field:
    """Where a value stands in the log: its letter, its code of `struct`, its first byte."""

    letter: str
    code: str
    start: int


@dataclass(frozen=True)
class Record:
    """A record that starts at a byte of the log."""

    name: str
    start: int
    content: bytes
    letters: str
    columns: str

    @property
    def time_us(self):
        return int.from_bytes(self.content[HEAD_BYTES : HEAD_BYTES + 8], "little")

    def fields(self) -> dict[str, Field]:
        """Its fields by their names; records of formats have none."""
        fields = {}
        byte = self.start + HEAD_BYTES
        for letter, column in zip(self.letters, self.columns.split(","), strict=False):
            code = "<" + STRUCT_CODES.get(letter, letter)
            fields[column] = Field(letter, code, byte)
            byte += struct.calcsize(code)
        return fields


def value_of(log, field):
    (value,) = struct.unpack_from(field.code, log, field.start)
    return value


def write_value(log, field, value):
    struct.pack_into(field.code, log, field.start, value)


def text_of(content):
    return content.rstrip(b"\0").decode()


def records(log):
    """All records of a log without damage; those of formats are called FMT."""
    formats = {FORMAT_RECORD: ("FMT", FORMAT_BYTES, "", "")}
    start = 0
    while start + HEAD_BYTES <= len(log):
        kind = log[start + 2]
        name, length, letters, columns = formats[kind]
        content = log[start : start + length]
        if kind == FORMAT_RECORD:
            texts = [text_of(content[first:end]) for first, end in TEXTS]
            formats[content[3]] = (texts[0], content[4], *texts[1:])
        yield Record(name, start, content, letters, columns)
        start += length


def without(log, name, first_us, last_us):
    """The log without the records of this name between two times."""
    contents = []
    for record in records(log):
        if record.name != name or not first_us <= record.time_us <= last_us:
            contents.append(record.content)
    return b"".join(contents)


def times_us(log, name):
    return [record.time_us for record in records(log) if record.name == name]
