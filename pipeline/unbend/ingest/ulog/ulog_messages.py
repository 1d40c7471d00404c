"""The messages of a ULog file: the walk over the file, rows decoded into columns.

Source: PX4 User Guide, "ULog File Format"; rows are those of pyulog, bit for bit. A message counts
when its kind is known, it ends inside the file, and, as data, it has the size of its format; after
damage the walk goes on where three messages follow each other.
"""

import re
import struct
from collections import Counter, defaultdict
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import ColumnStore, FileView, gather
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.messages import rows_without_field
from unbend.ingest.ulog import messages
from unbend.ingest.ulog.ulog_definitions import DataSizes, Definitions, dtype_of_value
from unbend.messages import Ledger

MAGIC = b"ULog\x01\x12\x35"
FILE_HEADER = 16  # [bytes]
HEAD = struct.Struct("<HB")  # size of what follows, kind
DATA = struct.Struct("<HBH")  # ... and the number of the topic
FLAGS = struct.Struct("<8s8s3Q")  # compatible, incompatible, places where data was appended
APPENDED = 1  # the first bit of the incompatible flags, the only one that is defined
SPAN = 4 << 20  # [bytes] walked at once
NEAR = 4096  # [bytes] searched first after damage
LONGEST = HEAD.size + 0xFFFF
LINKS = 3  # messages that follow each other prove a place after damage
_KIND_PLACE = 2  # of the kind in a message: behind the size
_NUMBER_SIZE = 2  # [bytes] of the number of a topic, at the beginning of data
_TIME_SIZE = 8  # [bytes] of a time since boot
_LEAST_UNKNOWN = _NUMBER_SIZE + _TIME_SIZE  # [bytes] that any data has, also of a lost definition


class MessageKind:
    """The kinds of messages."""

    FLAGS = ord("B")
    FORMAT = ord("F")
    INFORMATION = ord("I")
    INFORMATION_PARTS = ord("M")
    PARAMETER = ord("P")
    DEFAULT_PARAMETER = ord("Q")
    SUBSCRIPTION = ord("A")
    DATA = ord("D")
    TEXT = ord("L")
    TAGGED_TEXT = ord("C")
    SYNC = ord("S")
    DROPOUT = ord("O")
    REMOVED = ord("R")


_KINDS = np.frombuffer(b"BFIMPQLCADSOR", np.uint8)
_FIXED_SIZES = {
    MessageKind.SYNC: 8,
    MessageKind.DROPOUT: 2,
    MessageKind.REMOVED: 2,
}
# Bytes before the length of the key.
_BEFORE_KEY = {
    MessageKind.INFORMATION: 0,
    MessageKind.PARAMETER: 0,
    MessageKind.INFORMATION_PARTS: 1,
    MessageKind.DEFAULT_PARAMETER: 1,
}
_BEFORE_TEXT = {MessageKind.TEXT: 1, MessageKind.TAGGED_TEXT: 3}  # [bytes]: the level, and a tag
_LEVELS = tuple(bytes([level]) for level in b"01234567")
_LONGEST_KEYED = 2 + 255  # [bytes] up to the end of the longest key: enough to check any message
_KEY = re.compile(rb"(?P<type>[\w\[\]]+) (?P<name>[\w.:-]+)")


class FileFlags(NamedTuple):
    """The incompatible flags of a file, and the places where data was appended after a crash."""

    incompatible: bytes
    appended: list[int]


def flags_of(data: FileView) -> FileFlags:
    """The flags of a file; all 0 where it has no message with flags."""
    raw = data[FILE_HEADER : FILE_HEADER + HEAD.size + FLAGS.size]
    if len(raw) < HEAD.size + FLAGS.size or raw[_KIND_PLACE] != MessageKind.FLAGS:
        return FileFlags(bytes(8), [])
    _, incompatible, *places = FLAGS.unpack_from(raw, HEAD.size)
    appended = []
    if incompatible[0] & APPENDED:
        appended = [place for place in places if FILE_HEADER < place < data.size]
    return FileFlags(incompatible, appended)


class UlogTopic(NamedTuple):
    """A topic and the number of one of its instances, from 0."""

    name: str
    instance: int


class Text(NamedTuple):
    """A text of the vehicle, and its time [us since boot]."""

    time_us: int
    words: str


class _View(NamedTuple):
    """Bytes of the file, and the place in the file where they begin."""

    raw: bytes
    base: int


class _KeyedValue(NamedTuple):
    """A value of a parameter or an information message: its bytes, and its key.

    ``key``: the match with its ``type`` and ``name``; None if it is damaged.
    """

    key: re.Match[bytes] | None
    raw: bytes


def _keyed_value(content: bytes, kind: int) -> _KeyedValue:
    """The key and the value in the content of a keyed message, which has a whole key."""
    length_at = _BEFORE_KEY[kind]
    begin = length_at + 1
    end = begin + content[length_at]
    key = content[begin:end]
    return _KeyedValue(_KEY.fullmatch(key), raw=content[end:])


class ULogMessages(DamagedBytes):
    """The messages of a file with a whole header, those of the ``wanted`` topics as rows.

    The file is read when the object is made.
    """

    def __init__(self, data: FileView, wanted: Collection[str]) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()  # by topic
        self.rows: dict[UlogTopic, NDArray[Any]] = {}
        self.without_timestamp: set[str] = set()  # topics without a timestamp, which have no rows
        self.damaged_values = 0  # parameters and information of a wrong length
        self.dropouts_ms: list[int] = []  # of the logger
        self.texts: list[Text] = []  # of the vehicle
        self.parameters: dict[str, float] = {}  # the last value of each
        self.numbers: dict[str, float] = {}  # the last value of information that is a number
        self.definitions = Definitions()
        self.topics: dict[int, UlogTopic] = {}  # by number
        self.sizes: dict[int, DataSizes] = {}  # by number of the topic
        self._data = data
        self._wanted = wanted
        self._defining = True  # until the first subscription or text
        self._appended = flags_of(data).appended
        # Places of data messages in the present span, by number of the topic.
        self._places: defaultdict[int, list[int]] = defaultdict(list)
        self._stores: dict[UlogTopic, ColumnStore] = {}
        self._walk()

    def report_damage(self, ledger: Ledger, file_name: str) -> None:
        """Enter damage and dropouts in the ledger.

        Lost messages are not counted, because the format does not number messages.
        """
        self.report_bytes(ledger, file_name, "message")
        for topic in sorted(self.without_timestamp):
            without_time = rows_without_field(
                where=topic,
                count=self.counts[topic],
                fields=["timestamp"],
            )
            ledger.add(without_time)
        if self.damaged_values:
            ledger.add(messages.damaged_values(file=file_name, count=self.damaged_values))
        if self.dropouts_ms:
            seconds = sum(self.dropouts_ms) / 1000.0
            count = len(self.dropouts_ms)
            ledger.add(messages.logger_dropouts(file=file_name, count=count, seconds=seconds))

    def _walk(self) -> None:
        """Walk over the file, a span at a time."""
        if self._data[0 : len(MAGIC)] != MAGIC:
            self.drop(0, FILE_HEADER)
        begin = FILE_HEADER
        while begin < self._data.size:
            view = _View(self._data[begin : begin + SPAN + LONGEST], begin)
            begin += self._walk_span(view)
            self._store_data(np.frombuffer(view.raw, np.uint8))
        for topic, store in sorted(self._stores.items()):
            if len(store):
                self.rows[topic] = store.whole()

    def _walk_span(self, view: _View) -> int:
        """Take the messages that begin in a span; returns where in the view the next one begins."""
        is_last = view.base + len(view.raw) >= self._data.size
        end = len(view.raw) if is_last else SPAN  # behind it messages may not be whole in the view
        place = 0
        while place < end:
            place = self._pass_data(view.raw, place, end)
            if place >= end:
                break
            length = self._message_length(view, place)
            if not length:
                place = self._resume(view, place) - view.base
                if self.is_hopeless(self._data.size):
                    end = self.give_up(view.base + place, self._data.size)
                    return end - view.base
                continue
            if not self._take(view.raw, place, length):
                self.drop(view.base + place, view.base + place + length)
            place += length
        return place

    def _pass_data(self, raw: bytes, place: int, end: int) -> int:
        """Take messages of data that follow each other; returns the place of the first other one.

        ``end``: where in ``raw`` to stop. Most of a file is such data, so this loop has to be fast.
        """
        if self._appended:  # such files are read message by message
            return place
        unpack = DATA.unpack_from
        sizes = self.sizes
        places_of = self._places
        raw_length = len(raw)
        last = min(end, raw_length - DATA.size)
        while place < last:
            size, kind, number = unpack(raw, place)
            following = place + HEAD.size + size
            if kind != MessageKind.DATA or following > raw_length or number not in sizes:
                break
            least, most = sizes[number]
            if not least <= size - _NUMBER_SIZE <= most:
                break
            places_of[number].append(place)
            place = following
        return place

    def _store_data(self, view: NDArray[np.uint8]) -> None:
        """Count the data of a span, the bytes ``view``, and decode that of the wanted topics."""
        for number, places in self._places.items():
            topic = self.topics[number]
            self.counts[topic.name] += len(places)
            layout = self.definitions.layouts.get(topic.name)
            if layout is None:
                self.without_timestamp.add(topic.name)
            elif topic.name in self._wanted:
                store = self._stores.setdefault(topic, ColumnStore(layout))
                starts = np.array(places, np.int64) + DATA.size
                store.add(gather(view, starts, layout.itemsize).view(layout))
        self._places.clear()

    def _message_length(self, view: _View, place: int, *, allow_unknown_topic: bool = False) -> int:
        """The length [bytes] of the message at a place of the view; 0 if none begins there.

        ``allow_unknown_topic``: accept a message of data also if its topic is not subscribed.
        """
        if place + HEAD.size > len(view.raw):
            return 0
        size, kind = HEAD.unpack_from(view.raw, place)
        length = int(HEAD.size + size)
        begin = view.base + place
        if place + length > len(view.raw):
            return 0
        if any(begin < appended < begin + length for appended in self._appended):
            return 0  # a crash cut the message off, before data was appended
        may_be_unknown_data = (
            allow_unknown_topic and kind == MessageKind.DATA and size >= _LEAST_UNKNOWN
        )
        if self._is_plausible(view, place) or may_be_unknown_data:
            return length
        return 0

    def _is_plausible(self, view: _View, place: int) -> bool:
        """Whether the message at a place has a size and first bytes that its kind can have."""
        size, kind = HEAD.unpack_from(view.raw, place)
        begin = place + HEAD.size
        content = view.raw[begin : begin + _LONGEST_KEYED]
        if kind in _FIXED_SIZES:
            return bool(size == _FIXED_SIZES[kind])
        if kind in _BEFORE_TEXT:  # only the level shows that it is a text
            return size > 1 + _TIME_SIZE and content[:1] in _LEVELS
        if kind in _BEFORE_KEY:
            return _has_key(content, kind, size)
        if kind == MessageKind.DATA:
            number = int.from_bytes(content[:_NUMBER_SIZE], "little")
            if number not in self.sizes:
                return False
            least, most = self.sizes[number]
            return bool(least <= size - _NUMBER_SIZE <= most)
        if kind == MessageKind.FLAGS:
            return bool(view.base + place == FILE_HEADER and size >= FLAGS.size)
        return kind in (MessageKind.FORMAT, MessageKind.SUBSCRIPTION)

    def _take(self, raw: bytes, place: int, length: int) -> bool:
        """Take a message; False where a definition or a subscription cannot be used.

        Messages of kinds that are not read are passed over.
        """
        kind = raw[place + _KIND_PLACE]
        content = raw[place + HEAD.size : place + length]
        if kind == MessageKind.DATA:
            number = int.from_bytes(content[:_NUMBER_SIZE], "little")
            self._places[number].append(place)
        elif kind == MessageKind.FORMAT:  # behind the definitions a format is not valid
            return self._defining and self.definitions.add_format(content)
        elif kind == MessageKind.SUBSCRIPTION:
            self._defining = False
            return self._subscribe(content)
        elif kind in _BEFORE_TEXT:
            self._defining = False
            self._take_text(content[_BEFORE_TEXT[kind] :])
        elif kind in _BEFORE_KEY:
            self._take_value(kind, content)
        elif kind == MessageKind.DROPOUT and not self._defining:
            self.dropouts_ms.append(int.from_bytes(content, "little"))
        return True

    def _subscribe(self, content: bytes) -> bool:
        """Take a subscription; False if its topic is not defined or its number is of another topic.

        The content: the instance in one byte, the number of the topic in two, the name.
        """
        name = content[3:].decode("ascii", "replace")
        number = int.from_bytes(content[1:3], "little")
        sizes = self.definitions.sizes_of(name)
        if sizes is None:
            return False
        instance = content[0]
        topic = UlogTopic(name, instance)
        topic_of_number = self.topics.setdefault(number, topic)
        if topic_of_number != topic:
            return False
        self.sizes[number] = sizes
        return True

    def _take_text(self, content: bytes) -> None:
        """Keep a text of the vehicle and the time before it; drop it if it is too short."""
        if len(content) >= _TIME_SIZE:
            time_us = int.from_bytes(content[:_TIME_SIZE], "little")
            words = content[_TIME_SIZE:].decode("utf-8", "replace")
            self.texts.append(Text(time_us, words))

    def _take_value(self, kind: int, content: bytes) -> None:
        """Check the length of a value with a key, and keep it if it is a number that is used.

        Used are parameters, but not their defaults, and information that is in one part.
        """
        value = _keyed_value(content, kind)
        dtype = dtype_of_value(value.key)
        if value.key is None or dtype is None:
            return
        if len(value.raw) != dtype.itemsize:
            self.damaged_values += 1
            return
        name = value.key["name"].decode()
        if kind == MessageKind.PARAMETER:
            self.parameters[name] = _first_number(value.raw, dtype)
        elif kind == MessageKind.INFORMATION and dtype.kind in "iuf":
            self.numbers[name] = _first_number(value.raw, dtype)

    def _resume(self, view: _View, place: int) -> int:
        """Pass over damage at a place of the view; returns where in the file messages go on.

        The bytes up to there are counted: either one message of data with a lost definition, if
        messages follow it, or all bytes up to the next place that `_is_proved`.
        """
        begin = view.base + place
        length_of_unknown = self._message_length(view, place, allow_unknown_topic=True)
        number = int.from_bytes(view.raw[place + HEAD.size : place + DATA.size], "little")
        is_unknown = length_of_unknown > 0 and number not in self.sizes
        if is_unknown and self._is_proved(view, place + length_of_unknown):
            resumed = begin + length_of_unknown
            self.drop(begin, resumed)
            return resumed
        resumed = self._next_proved(begin + 1)
        if resumed < self._data.size:
            self.drop_searched(begin, resumed)
        elif self._is_cut_message(begin):
            self.cut_bytes = self._data.size - begin
        else:
            self.drop_searched(begin, self._data.size)
        return resumed

    def _next_proved(self, begin: int) -> int:
        """The first place of the file from ``begin`` on that `_is_proved`, or the file's end."""
        reach = NEAR
        while begin < self._data.size:
            data = self._data.array(begin, begin + reach + LONGEST * LINKS)
            view = _View(data.tobytes(), begin)
            kinds = data[_KIND_PLACE : _KIND_PLACE + reach]
            starts = np.flatnonzero(np.isin(kinds, _KINDS)).tolist()
            for place in self._appended:
                if begin <= place < begin + reach:
                    starts.append(place - begin)
            for start in sorted(set(starts)):
                if self._is_proved(view, start):
                    return int(begin + start)
            begin += reach
            reach = SPAN
        return self._data.size

    def _is_cut_message(self, begin: int) -> bool:
        """Whether the end of the file cuts off a message that begins at this place of the file."""
        last_bytes = self._data[begin : begin + LONGEST]
        if len(last_bytes) < DATA.size:
            return True
        size, _ = HEAD.unpack_from(last_bytes)
        is_cut = HEAD.size + size > len(last_bytes)
        return is_cut and self._is_plausible(_View(last_bytes, begin), 0)

    def _is_proved(self, view: _View, place: int) -> bool:
        """Whether `LINKS` messages follow each other from a place on, or fewer up to the end.

        A place where data was appended counts as proved. The messages behind the first may be data
        of a topic that is not subscribed.
        """
        if view.base + place in self._appended:
            return True
        reaches_end = view.base + len(view.raw) >= self._data.size
        for link in range(LINKS):
            length = self._message_length(view, place, allow_unknown_topic=link > 0)
            if not length:
                return False
            place += length
            if reaches_end and place == len(view.raw):
                return True
        return True


def _first_number(raw: bytes, dtype: np.dtype[Any]) -> float:
    """The number, the first if there are several, in the bytes of a value."""
    numbers = np.frombuffer(raw, dtype)
    return float(numbers[0])


def _has_key(content: bytes, kind: int, size: int) -> bool:
    """Whether the content of a keyed message, of ``size`` bytes in total, has a valid whole key.

    ``content``: its first bytes.
    """
    length_at = _BEFORE_KEY[kind]
    if length_at >= min(size, len(content)):
        return False
    begin = length_at + 1
    key = content[begin : begin + content[length_at]]
    return begin + len(key) <= size and _KEY.fullmatch(key) is not None
