"""The messages of a ULog file: definitions, the walk over the file, rows decoded into columns.

Source: PX4 User Guide, "ULog File Format"; rows are those of pyulog, bit for bit. A message counts
when its kind is known, it ends inside the file, and, as data, it has the size of its format; after
damage the walk goes on where three messages follow each other.
"""

import re
import struct
from collections import Counter, defaultdict
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import ColumnStore, FileView, gather
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.messages import Ledger

MAGIC = b"ULog\x01\x12\x35"


FILE_HEADER = 16  # bytes


HEAD = struct.Struct("<HB")  # size of what follows, kind


DATA = struct.Struct("<HBH")  # ... and the number of the topic


FLAGS = struct.Struct("<8s8s3Q")  # compatible, incompatible, places where data was appended


APPENDED = 1  # the first bit of the incompatible flags, the only one that is defined


SPAN, NEAR = 4 << 20, 4096  # [bytes] walked at once, and searched first after damage


LONGEST = HEAD.size + 0xFFFF


LINKS = 3  # messages in a row that prove a place after damage


DEEPEST = 8  # formats inside each other


_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "bool": "i1", "char": "i1", "int16_t": "<i2",
    "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4", "float": "<f4", "int64_t": "<i8",
    "uint64_t": "<u8", "double": "<f8",
}  # fmt: skip


_FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")


_DATUM = ord("D")


_KINDS = np.frombuffer(b"BFIMPQLCADSOR", np.uint8)


_FIXED = {ord("S"): 8, ord("O"): 2, ord("R"): 2}


_KEYED = {ord("I"): 0, ord("P"): 0, ord("M"): 1, ord("Q"): 1}  # bytes before the key's length


_KEY = re.compile(rb"([\w\[\]]+) [\w.:-]+")


_LEVELS = tuple(bytes([level]) for level in b"01234567")


Fields = list[tuple[str, int, str]]
"""Type, number of elements (0 for no array) and name of each field of a format."""


def flags_of(data: FileView) -> tuple[bytes, list[int]]:
    """The incompatible flags of a file, and the places where data was appended after a crash."""
    raw = data[FILE_HEADER : FILE_HEADER + HEAD.size + FLAGS.size]
    if len(raw) < HEAD.size + FLAGS.size or raw[2] != ord("B"):
        return bytes(8), []
    _, incompatible, *places = FLAGS.unpack_from(raw, HEAD.size)
    inside = [place for place in places if FILE_HEADER < place < data.size]
    return incompatible, inside if incompatible[0] & APPENDED else []


def flat_fields(
    name: str, formats: dict[str, Fields], depth: int = 0
) -> list[tuple[str, str]] | None:
    """Names and types of the elements of a format, with nested formats and padding.

    None where a part of it is not defined, or it is longer than a message can be.

    >>> flat_fields("a", {"a": [("b", 2, "x")], "b": [("float", 0, "y")]})
    [('x[0].y', '<f4'), ('x[1].y', '<f4')]
    """
    if name not in formats or depth > DEEPEST:
        return None
    result: list[tuple[str, str]] = []
    size = 0
    for kind, count, field_name in formats[name]:
        inner = [("", _TYPES[kind])] if kind in _TYPES else flat_fields(kind, formats, depth + 1)
        if not inner:
            return None
        size += max(count, 1) * sum(int(dtype[-1]) for _, dtype in inner)
        if size > 0xFFFF:
            return None
        elements = [f"{field_name}[{k}]" for k in range(count)] if count else [field_name]
        for element in elements:
            result += [(f"{element}.{path}" if path else element, dtype) for path, dtype in inner]
    return result


class ULogMessages(DamagedBytes):
    """The messages of a file with a whole header, those of the ``wanted`` topics as rows.

    ``counts`` by topic; ``rows`` by name and instance; ``timeless`` topics have no timestamp and no
    rows; ``damaged_values``: parameters and information of a wrong length; ``dropouts_ms`` of the
    logger; ``texts`` with their time since boot [us]; ``parameters``: the last value of each.
    Formats by name; by number the ``topics`` (name, instance), ``sizes`` without, with padding;
    ``columns`` are what rows of a topic hold; a format without a timestamp has none.
    """

    def __init__(self, data: FileView, wanted: Collection[str]) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()
        self.rows: dict[tuple[str, int], NDArray[Any]] = {}
        self.timeless: set[str] = set()
        self.damaged_values = 0
        self.dropouts_ms: list[int] = []
        self.texts: list[tuple[int, str]] = []
        self.parameters: dict[str, float] = {}
        self._data = data
        self._wanted = wanted
        self.formats: dict[str, Fields] = {}
        self.columns: dict[str, np.dtype[Any]] = {}
        self.topics: dict[int, tuple[str, int]] = {}
        self.sizes: dict[int, tuple[int, int]] = {}
        self._defining = True  # until the first subscription or text
        self._appended = flags_of(data)[1]
        self._places: defaultdict[int, list[int]] = defaultdict(list)  # of data, in one block
        self._stores: dict[tuple[str, int], ColumnStore] = {}
        self.walk()

    def define(self, content: bytes) -> bool:
        """Take a format; False where it is damaged."""
        name, colon, text = content.decode("ascii", "replace").partition(":")
        parts = [_FIELD.fullmatch(part) for part in text.split(";") if part]
        fields = [part.groups() for part in parts if part]
        empty = any(count is not None and not int(count) for _, count, _ in fields)
        if not colon or not fields or len(fields) < len(parts) or empty:
            return False
        self.formats[name] = [(kind, int(count or 0), label) for kind, count, label in fields]
        return True

    def subscribe(self, content: bytes) -> bool:
        """Take a subscription; False where its format is not defined or its number is taken."""
        name = content[3:].decode("ascii", "replace")
        fields = flat_fields(name, self.formats) or []
        size = sum(int(dtype[-1]) for _, dtype in fields)
        while fields and fields[-1][0].startswith("_padding"):  # at the end it is not always logged
            fields.pop()
        if not fields or len({label for label, _ in fields}) < len(fields):
            return False
        topic, number = (name, content[0]), int.from_bytes(content[1:3], "little")
        if self.topics.setdefault(number, topic) != topic:
            return False
        columns = np.dtype(fields)
        self.sizes[number] = columns.itemsize, size
        if ("uint64_t", 0, "timestamp") in self.formats[name]:
            self.columns[name] = columns
        return True

    def report_damage(self, ledger: Ledger, file_name: str) -> None:
        """Enter what is damaged. The format does not number messages: lost ones are not counted."""
        self.report_bytes(ledger, file_name, "message")
        for topic in sorted(self.timeless):
            count = self.counts[topic]
            what = f"{count} rows cannot be used: the log defines no field for timestamp"
            ledger.loss("LOG-FIELDS", what, where=topic, count=count)
        if self.damaged_values:
            ledger.loss("LOG-ULOG-DAMAGE", where=file_name, count=self.damaged_values)
        if self.dropouts_ms:
            count, lost_s = len(self.dropouts_ms), sum(self.dropouts_ms) / 1000.0
            what = f"the logger could not keep up {count} times, {lost_s:.3f} s together"
            ledger.loss("LOG-DROPOUT", what, where=file_name, count=count)

    def walk(self) -> None:
        """Walk over the file."""
        at, end = FILE_HEADER, self._data.size
        sizes, unpack, places_of = self.sizes, DATA.unpack_from, self._places
        if self._data[0 : len(MAGIC)] != MAGIC:
            self.drop(0, FILE_HEADER)
        while at < end:
            raw = self._data[at : at + SPAN + LONGEST]
            last = len(raw) if at + len(raw) >= end else SPAN
            data_last = min(last, len(raw) - HEAD.size - 2)
            stop = len(raw) if not self._appended else 0  # such files are read message by message
            place = 0
            while place < last:
                while place < data_last:  # data wall to wall, which most of a file is
                    size, kind, number = unpack(raw, place)
                    following = place + HEAD.size + size
                    if kind != _DATUM or following > stop or number not in sizes:
                        break
                    least, most = sizes[number]
                    if not least <= size - 2 <= most:
                        break
                    places_of[number].append(place)
                    place = following
                length = self._length(raw, place, at) if place < last else 0
                if length and not self._take(raw, place, length):
                    self.drop(at + place, at + place + length)
                elif place < last and not length:
                    length = self._resume(raw, place, at) - at - place
                place += length
            view = np.frombuffer(raw, np.uint8)
            for number, places in self._places.items():
                name, instance = self.topics[number]
                self.counts[name] += len(places)
                columns = self.columns.get(name)
                if columns is None:
                    self.timeless.add(name)
                elif name in self._wanted:
                    store = self._stores.setdefault((name, instance), ColumnStore(columns))
                    starts = np.array(places, np.int64) + DATA.size
                    store.add(gather(view, starts, columns.itemsize).view(columns))
            self._places.clear()
            at += place
        self.rows = {
            key: store.whole() for key, store in sorted(self._stores.items()) if len(store)
        }

    def _length(self, raw: bytes, place: int, base: int, *, loose: bool = False) -> int:
        """The length of a message that begins here, or 0; ``loose``: also of unknown topics."""
        if place + HEAD.size > len(raw):
            return 0
        size, kind = HEAD.unpack_from(raw, place)
        end = place + HEAD.size + size
        if end > len(raw) or any(base + place < cut < base + end for cut in self._appended):
            return 0
        fits = self._fits(raw, place, base)
        return HEAD.size + size if fits or (loose and kind == _DATUM and size >= 10) else 0

    def _fits(self, raw: bytes, place: int, base: int) -> bool:
        """Whether the content, as far as it is there, is that of a message of its kind."""
        size, kind = HEAD.unpack_from(raw, place)
        content = place + HEAD.size
        if kind in _FIXED:
            return bool(size == _FIXED[kind])
        if kind in b"LC":  # what the vehicle says has no other mark than its level
            return size > 9 and raw[content : content + 1] in _LEVELS
        if kind in _KEYED:
            begin, end = content + _KEYED[kind], content + size
            key = raw[begin + 1 : begin + 1 + raw[begin]] if begin < end else b""
            return begin + 1 + len(key) <= end and _KEY.fullmatch(key) is not None
        if kind == _DATUM:
            number = int.from_bytes(raw[content : content + 2], "little")
            least, most = self.sizes.get(number, (1, 0))
            return bool(least + 2 <= size <= most + 2)
        if kind == ord("B"):
            return bool(base + place == FILE_HEADER and size >= FLAGS.size)
        return kind in b"FA"

    def _take(self, raw: bytes, place: int, length: int) -> bool:
        """Take a message; False where it cannot be used."""
        kind, begin, end = raw[place + 2], place + HEAD.size, place + length
        if kind == _DATUM:
            self._places[raw[begin] | raw[begin + 1] << 8].append(place)
        elif kind == ord("F"):  # among the data it is none
            return self._defining and self.define(raw[begin:end])
        elif kind in b"ALC":
            self._defining = False
            if kind != ord("A") and (begin := begin + (3 if kind == ord("C") else 1)) + 8 <= end:
                text = raw[begin + 8 : end].decode("utf-8", "replace")
                self.texts.append((int.from_bytes(raw[begin : begin + 8], "little"), text))
            return kind != ord("A") or self.subscribe(raw[begin:end])
        elif kind in _KEYED:
            begin += _KEYED[kind]
            value = begin + 1 + raw[begin]
            key = _KEY.fullmatch(raw[begin + 1 : value])
            dtype = _TYPES.get(key[1].decode()) if key else None
            fits = dtype is None or end - value == int(dtype[-1])
            self.damaged_values += not fits
            if kind == ord("P") and key and dtype and fits:
                name = key[0].decode().partition(" ")[2]
                self.parameters[name] = float(np.frombuffer(raw[value:end], dtype)[0])
        elif kind == ord("O") and not self._defining:
            self.dropouts_ms.append(int.from_bytes(raw[begin:end], "little"))
        return True

    def _resume(self, raw: bytes, place: int, base: int) -> int:
        """Where in the file messages go on after a place that begins none."""
        at = base + place
        skipped = self._length(raw, place, base, loose=True)  # data whose definition was lost
        number = int.from_bytes(raw[place + 3 : place + 5], "little")
        unknown = number not in self.sizes
        if skipped and unknown and self._linked(raw, place + skipped, base):
            self.drop(at, at + skipped)
            return at + skipped
        begin, reach = at + 1, NEAR
        while begin < self._data.size:
            view = self._data.array(begin, begin + reach + LONGEST * LINKS)
            block = view.tobytes()
            starts = np.flatnonzero(np.isin(view[2 : reach + 2], _KINDS)).tolist()
            cuts = [cut - begin for cut in self._appended if begin <= cut < begin + reach]
            for start in sorted({*starts, *cuts}):
                if self._linked(block, start, begin):
                    self.drop(at, begin + start)
                    return begin + start
            begin, reach = begin + reach, SPAN
        rest = self._data[at : at + LONGEST]
        cut = len(rest) < HEAD.size + 2 or HEAD.unpack_from(rest)[0] + HEAD.size > len(rest)
        if cut and (len(rest) < HEAD.size + 2 or self._fits(rest, 0, at)):
            self.cut_bytes = self._data.size - at
        else:
            self.drop(at, self._data.size)
        return self._data.size

    def _linked(self, raw: bytes, place: int, base: int) -> bool:
        """Whether three messages follow each other from here, or fewer up to the file's end."""
        if base + place in self._appended:
            return True
        whole = base + len(raw) >= self._data.size
        for link in range(LINKS):
            length = self._length(raw, place, base, loose=link > 0)
            if not length:
                return False
            place += length
            if whole and place == len(raw):
                return True
        return True
