"""Walking the messages of a ULog file, so that pyulog sees whole ones only.

pyulog does not tell how much of a damaged file it lost, reads some for ever (a zeroed block among
the definitions) and seeks before the beginning of others. The walk is ours: a message counts when
its kind is known, it ends inside the file, and as data it has the size that its format defines.
"""

from __future__ import annotations

import io
import re
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.ingest.buffers import Bytes, FileView

FILE_HEADER = 16
HEAD = struct.Struct("<HB")  # size of what follows, kind
DATA = struct.Struct("<HBH")  # ... and the number of the topic
FLAGS = struct.Struct("<8s8s3Q")  # compatible, incompatible, places where data was appended
SPAN, NEAR = 4 << 20, 4096  # [bytes] walked at once, and searched first after damage
LONGEST = HEAD.size + 0xFFFF
LINKS = 3  # messages in a row that prove a place after damage

_SIZES = {
    "int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4,
    "uint32_t": 4, "float": 4, "int64_t": 8, "uint64_t": 8, "double": 8,
}  # fmt: skip
_FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
_DEFINITIONS, _DATA = frozenset(b"BFIMPQLCA"), frozenset(b"IMPQLCADSO")
_DATUM = ord("D")
_KINDS = np.array(sorted({*_DEFINITIONS, *_DATA, ord("R")}), np.uint8)
_FIXED = {ord("S"): 8, ord("O"): 2, ord("R"): 2}  # R ends a subscription; pyulog knows no R
_KEYED = {ord("I"): 0, ord("P"): 0, ord("M"): 1, ord("Q"): 1}  # bytes before the key's length
_KEY = re.compile(rb"[\w\[\]]+ [\w.:-]+")
_LEVELS = tuple(bytes([level]) for level in b"01234567")

Fields = list[tuple[str, int, str]]


@dataclass
class Walk:
    """What a file holds.

    ``good`` begin and end of the stretches of whole messages; ``topics`` names by number;
    ``counts`` of data messages by topic; ``bad_bytes`` that are part of no message, the first at
    ``first_bad``; ``cut_bytes`` of a last message that the end of the file cuts off; ``timeless``
    topics whose format has no timestamp: pyulog would read nothing behind their first message.
    """

    good: list[tuple[int, int]] = field(default_factory=list)
    topics: dict[int, str] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0
    timeless: set[str] = field(default_factory=set)

    def keep(self, begin: int, end: int) -> None:
        if self.good and self.good[-1][1] == begin:
            self.good[-1] = (self.good[-1][0], end)
        else:
            self.good.append((begin, end))

    def drop(self, begin: int, end: int) -> None:
        self.bad_bytes += end - begin
        self.first_bad = begin if self.first_bad < 0 else self.first_bad


def walk(data: FileView) -> Walk:
    """Find the messages of a file."""
    return _Walker(data).run()


class _Walker:
    def __init__(self, data: FileView) -> None:
        self.data = data
        self.found = Walk()
        self.formats: dict[str, Fields] = {}
        self.spans: dict[str, tuple[int, int] | None] = {}
        self.sizes: dict[int, tuple[int, int]] = {}  # of a topic, without padding and with it
        self.hidden: dict[int, tuple[int, int]] = {}  # ... which pyulog is not to see
        self.appended = _appended(data)
        self.defining = True
        self.counts: Counter[int] = Counter()

    def run(self) -> Walk:
        at, end = FILE_HEADER, self.data.size
        while at < end:
            raw = self.data[at : at + SPAN + LONGEST]
            last = len(raw) if at + len(raw) >= end else SPAN
            place = 0
            while place < last:
                place = self._data(raw, place, last, at)
                length = self._length(raw, place, at) if place < last else 0
                if not length:
                    found = self._near(raw, place, at)
                    if found < 0:
                        break
                    self.found.drop(at + place, at + found)
                    place = found
                    continue
                self._take(raw, place, length, at)
                place += length
            at += place
            if place < last:
                at = self._resume(at)
        for number, count in self.counts.items():
            self.found.counts[self.found.topics[number]] += count
        return self.found

    def _data(self, raw: bytes, place: int, last: int, base: int) -> int:
        """Keep data messages wall to wall, which most of a file is; where they end."""
        begin, last = place, min(last, len(raw) - HEAD.size - 2)
        stop = len(raw) if not self.appended else 0  # such files are read with more care
        sizes, unpack, counts = self.sizes, DATA.unpack_from, self.counts
        while place < last:
            size, kind, number = unpack(raw, place)
            end = place + HEAD.size + size
            if kind != _DATUM or end > stop or number not in sizes:
                break
            least, most = sizes[number]
            if not least <= size - 2 <= most:
                break
            counts[number] += 1
            place = end
        if place > begin:
            self.found.keep(base + begin, base + place)
        return place

    def _length(self, raw: bytes, place: int, base: int, *, loose: bool = False) -> int:
        """The length of the message that begins here; 0 where none does.

        ``loose`` takes data of a topic that is not known, whose definition may be what was lost.
        """
        if place + HEAD.size > len(raw):
            return 0
        size, kind = HEAD.unpack_from(raw, place)
        end = place + HEAD.size + size
        if end > len(raw) or any(base + place < cut < base + end for cut in self.appended):
            return 0
        fits = self._fits(raw, place, size, kind, base)
        return HEAD.size + size if fits or (loose and kind == _DATUM and size >= 10) else 0

    def _fits(self, raw: bytes, place: int, size: int, kind: int, base: int) -> bool:
        content = place + HEAD.size
        if kind in _FIXED:
            return size == _FIXED[kind]
        if kind in b"LC":  # what the vehicle says has no other mark than its level
            return size > 9 and raw[content : content + 1] in _LEVELS
        if kind in _KEYED:
            begin, end = content + _KEYED[kind], content + size
            key = raw[begin + 1 : begin + 1 + raw[begin]] if begin < end else b""
            return begin + 1 + len(key) <= end and _KEY.fullmatch(key) is not None
        if kind == _DATUM:
            number = int.from_bytes(raw[content : content + 2], "little")
            least, most = self.sizes.get(number) or self.hidden.get(number, (1, 0))
            return least + 2 <= size <= most + 2
        if kind == ord("B"):
            return base + place == FILE_HEADER and size >= FLAGS.size
        return kind in b"FA"

    def _take(self, raw: bytes, place: int, length: int, base: int) -> None:
        """Keep a message, and what it defines."""
        kind, begin = raw[place + 2], place + HEAD.size
        content = raw[begin : place + length] if kind in b"FA" else b""
        if kind == _DATUM:
            number = raw[begin] | raw[begin + 1] << 8
            self.counts[number] += 1
            if number in self.hidden:
                return
        elif kind == ord("F") and self.defining:
            if not self._format(content):
                self.found.drop(base + place, base + place + length)
                return
        elif kind == ord("A"):
            self.defining = False
            if not self._subscribe(content):
                self.found.drop(base + place, base + place + length)
                return
        elif kind in b"LC":
            self.defining = False
        if kind in (_DEFINITIONS if self.defining else _DATA):
            self.found.keep(base + place, base + place + length)
        elif kind in b"BF":
            self.found.drop(base + place, base + place + length)

    def _format(self, content: bytes) -> bool:
        name, colon, text = content.decode("ascii", "replace").partition(":")
        fields = [_FIELD.fullmatch(part) for part in text.split(";") if part]
        known = [found.groups() for found in fields if found]
        if not colon or not known or len(known) < len(fields):
            return False
        self.formats[name] = [(kind, int(count or 1), field) for kind, count, field in known]
        return True

    def _subscribe(self, content: bytes) -> bool:
        name = content[3:].decode("ascii", "replace")
        if name not in self.spans:
            self.spans[name] = span_of(name, self.formats)
        sizes = self.spans[name]
        number = int.from_bytes(content[1:3], "little")
        taken = self.found.topics.get(number, name) != name  # numbers are never given twice
        if sizes is None or len(content) < 4 or taken:
            return False
        self.found.topics[number] = name
        if ("uint64_t", 1, "timestamp") in self.formats[name]:
            self.sizes[number] = sizes
        else:
            self.hidden[number] = sizes
            self.found.timeless.add(name)
        return True

    def _near(self, raw: bytes, place: int, base: int) -> int:
        """Where messages go on soon after a place that begins none, or -1."""
        if place + NEAR + LONGEST * LINKS > len(raw):
            return -1
        unknown = self._length(raw, place, base, loose=True)
        if unknown and self._linked(raw, place + unknown, base, whole=False):
            return place + unknown
        return self._next(np.frombuffer(raw, np.uint8), raw, place + 1, place + NEAR, base)

    def _next(self, view: Bytes, raw: bytes, begin: int, end: int, base: int) -> int:
        may = np.flatnonzero(np.isin(view[begin + 2 : end + 2], _KINDS)) + begin
        cuts = {cut - base for cut in self.appended if begin <= cut - base < end}
        whole = base + len(raw) >= self.data.size
        for place in sorted({*may.tolist(), *cuts}):
            if self._linked(raw, place, base, whole):
                return int(place)
        return -1

    def _resume(self, at: int) -> int:
        """Where messages go on after a place that begins none."""
        begin, reach = at + 1, NEAR
        while begin < self.data.size:
            view = self.data.array(begin, begin + reach + LONGEST * LINKS)
            found = self._next(view, view.tobytes(), 0, reach, begin)
            if found >= 0:
                self.found.drop(at, begin + found)
                return begin + found
            begin, reach = begin + reach, SPAN
        if self._cut(at):
            self.found.cut_bytes = self.data.size - at
        else:
            self.found.drop(at, self.data.size)
        return self.data.size

    def _linked(self, raw: bytes, place: int, base: int, whole: bool) -> bool:
        if base + place in self.appended:
            return True
        for link in range(LINKS):
            length = self._length(raw, place, base, loose=link > 0)
            if not length:
                return False
            place += length
            if whole and place == len(raw):
                return True
        return True

    def _cut(self, at: int) -> bool:
        """Whether the end of the file cuts a message off that begins here."""
        raw = self.data[at : at + LONGEST]
        if len(raw) < HEAD.size + 2:
            return True
        size, kind = HEAD.unpack_from(raw)
        return HEAD.size + size > len(raw) and self._fits(raw, 0, size, kind, at)


def span_of(name: str, formats: Mapping[str, Fields], depth: int = 0) -> tuple[int, int] | None:
    """Bytes of a format, without the padding at its end and with it; None where it is not defined.

    >>> span_of("a", {"a": [("b", 2, "x"), ("uint8_t", 3, "_padding0")], "b": [("float", 1, "y")]})
    (8, 11)
    """
    if name not in formats or depth > 8:
        return None
    total = padding = 0
    for kind, count, field_name in formats[name]:
        inner = span_of(kind, formats, depth + 1) if kind not in _SIZES else None
        size = _SIZES.get(kind, inner[1] if inner else 0) * count
        if not size:
            return None
        total += size
        if total > 0xFFFF:
            return None
        padding = padding + size if field_name.startswith("_padding") else 0
    return (total - padding, total) if total > padding else None


def _appended(data: FileView) -> frozenset[int]:
    """Places where data was appended after a crash: what lies before them may be cut off."""
    raw = data[FILE_HEADER : FILE_HEADER + HEAD.size + FLAGS.size]
    if len(raw) < HEAD.size + FLAGS.size or raw[2] != ord("B"):
        return frozenset()
    _, incompatible, *places = FLAGS.unpack_from(raw, HEAD.size)
    inside = [place for place in places if FILE_HEADER < place < data.size]
    return frozenset(inside if incompatible[0] & 1 else ())


class Whole(io.RawIOBase):
    """The whole messages of a file as a file of their own, without a word of appended data."""

    def __init__(self, data: FileView, found: Walk) -> None:
        super().__init__()
        self.parts: list[tuple[int, int]] = [(0, FILE_HEADER), *found.good]
        self.data = data
        self.starts = [0]
        for begin, end in self.parts:
            self.starts.append(self.starts[-1] + end - begin)
        self.at = self.part = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = (0, self.at, self.starts[-1])[whence]
        self.at, self.part = max(base + offset, 0), 0
        return self.at

    def tell(self) -> int:
        return self.at

    def readinto(self, buffer: Any) -> int:
        while self.part < len(self.parts) and self.at >= self.starts[self.part + 1]:
            self.part += 1
        if self.part == len(self.parts):
            return 0
        begin, end = self.parts[self.part]
        begin += self.at - self.starts[self.part]
        block = bytearray(self.data[begin : min(begin + len(buffer), end)])
        flags = FILE_HEADER + HEAD.size + 8  # the incompatible ones; the first bit: appended
        if begin <= flags < begin + len(block) and self.data[18:19] == b"B":
            block[flags - begin] &= 0xFE
        buffer[: len(block)] = block
        self.at += len(block)
        return len(block)
