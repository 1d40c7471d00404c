"""The records of an MCAP file in their order: definitions one by one, messages by the thousand.

The mcap library parses the content of definitions, not the file: its readers give nothing for a
truncated file, inflate chunks without a limit and lose messages silently. After damage, reading
goes on at the next place where a record is proved to begin.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from unbend.ingest.buffers import Bytes, FileView
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.chunk_records import ChunkReader
from unbend.ingest.mcap.damage import Damage
from unbend.ingest.mcap.message_batches import MessageBatch, MessageRecords, Messages
from unbend.ingest.mcap.record_layout import (
    CHECKSUM,
    DEFINITIONS,
    FOOT,
    LARGE_MESSAGE,
    LAST,
    MAGIC,
    MAX_DEFINITION,
    MESSAGE_START,
    PRIVATE,
    RECORD,
    Definition,
    Opcode,
    Record,
    checksum_of,
    raw_of,
    record_at,
)
from unbend.ingest.mcap.record_proofs import is_proved, next_proved_record
from unbend.ingest.mcap.summary_definitions import summary_definitions

SPAN = 4 << 20  # [bytes] of the file walked at once
MAX_HEADER = 1 << 16  # [bytes] of the header record, by which a file with a damaged mark is found
LISTED_ENDS = 2  # a million records that end the data must cost no more than two


@dataclass
class _Span:
    """Records that begin in a stretch of the file.

    ``following`` is where in the file to go on; None at its end.
    """

    begin: int
    view: Bytes  # the bytes from ``begin`` on
    starts: list[int] = field(default_factory=list)  # places of small messages in the view
    others: list[Record] = field(default_factory=list)
    following: int | None = None

    def drop_last_message_at(self, at: int) -> None:
        """Remove the last small message, if it begins at this place of the file."""
        if self.starts and self.begin + self.starts[-1] == at:
            self.starts.pop()


class RecordWalk:
    """The definitions and messages of a file; ``damage`` is filled on the way.

    A summary that its checksum proves comes first: its definitions serve where those among the
    messages are damaged. A definition may come several times.
    """

    def __init__(self, data: FileView, damage: Damage) -> None:
        self.data = data
        self.damage = damage
        self.channels: set[int] = set()  # their numbers prove messages after damage
        self._chunks = ChunkReader(data, damage, self.channels)
        self._batch = MessageBatch()
        # Where the last record begins, or a proved chunk has its last byte. Records are searched
        # behind it after damage, as the length of that record may be what is damaged.
        self._last_begin = -1
        self._data_end: int | None = None  # behind it the summary begins
        self._data_ends = 0  # records that end the data
        self._data_end_checked = False

    def __iter__(self) -> Iterator[Definition | Messages]:
        yield from self._handed_on(summary_definitions(self.data, self.damage))
        place: int | None = self._first_record()
        while place is not None:
            span = self._walk_span(place)
            yield from self._handed_on(self._read_span(span))
            place = span.following
        yield from self._batch.flush()

    def _handed_on(
        self, parts: Iterable[Definition | MessageRecords]
    ) -> Iterator[Definition | Messages]:
        """The parts for the reader of the file: definitions at once, messages decoded in batches.

        Here the numbers of the defined channels are noted.
        """
        for part in parts:
            if isinstance(part, MessageRecords):
                yield from self._batch.add(part)
                continue
            if part.opcode == Opcode.CHANNEL:
                self.channels.add(int.from_bytes(part.content[:2], "little"))
            yield part

    # The walk from record to record.

    def _first_record(self) -> int:
        """Where the records begin; a damaged mark may have lost bytes."""
        if self.data[0 : len(MAGIC)] == MAGIC:
            first = len(MAGIC)
        else:
            first = self._first_after_damaged_mark()
            where = self.damage.at(0)
            self.damage.add(messages.file_beginning_damaged(where=where, count=first))
        self._last_begin = first - 1
        return first

    def _first_after_damaged_mark(self) -> int:
        """The last place near the beginning with a header before another record; 0 without any."""
        first = 0
        for place in range(len(MAGIC) + 1):
            record = record_at(self.data, place)
            if record.opcode == Opcode.HEADER and record.length < MAX_HEADER:
                following = self.data[record.end : record.end + 1]
                if following and 0 < following[0] <= LAST:
                    first = place
        return first

    def _walk_span(self, begin: int) -> _Span:
        """The records that begin in a stretch of the file, and where to go on."""
        span = _Span(begin, self.data.array(begin, begin + SPAN))
        raw = raw_of(span.view)
        unpack = RECORD.unpack_from
        place = 0
        while place + RECORD.size <= len(raw):
            opcode, length = unpack(raw, place)
            end = place + RECORD.size + length
            if opcode == Opcode.MESSAGE and length <= LARGE_MESSAGE and end <= len(raw):
                span.starts.append(place)
                self._last_begin = begin + place
            elif self._ends_span(span, Record(opcode, begin + place, length)):
                return span
            place = end
        following = begin + place
        if place > len(raw) or (place > 0 and following < self.data.size):
            span.following = following
        else:
            left = self.data.size - following
            self.damage.add(messages.no_footer(where=self.damage.at(following), count=left))
        return span

    def _ends_span(self, span: _Span, record: Record) -> bool:
        """Take a record that is no small message in the span; returns whether the span ends here.

        Where it does, ``following`` of the span is set.
        """
        is_possible = 0 < record.opcode <= LAST or record.opcode >= PRIVATE
        if record.end > self.data.size or not is_possible:
            last_begin = self._last_begin
            span.following = self._resume(record)
            if span.following is not None and span.following < record.at:
                span.drop_last_message_at(last_begin)  # records lie in it: its length was damaged
            return True
        if record.opcode == Opcode.FOOTER:
            span.following = self._end_at_footer(record)
            return True
        if record.opcode == Opcode.MESSAGE and record.length <= LARGE_MESSAGE:
            span.following = record.at  # it ends behind the span, and begins the next one
            return True
        self._list_record(span, record)
        is_chunk = record.opcode == Opcode.CHUNK
        if is_chunk and is_proved(self.data, record.at, self.channels):
            self._last_begin = record.end - 1
        else:
            self._last_begin = record.at
        return False

    def _list_record(self, span: _Span, record: Record) -> None:
        """Add a record to the others of a span, if it is of a kind that is read."""
        if record.opcode == Opcode.DATA_END:
            self._data_end = record.end
            self._data_ends += 1
            if self._data_ends > LISTED_ENDS:
                return
        is_read = record.opcode in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
        if is_read or record.opcode in DEFINITIONS:
            span.others.append(record)

    def _end_at_footer(self, record: Record) -> int | None:
        """Where to go on after a footer: at another record if it is not at the file's end."""
        mark = record.content + FOOT.size  # the mark of the format comes behind the footer
        end = mark + len(MAGIC)
        if record.length != FOOT.size or end > self.data.size:
            return self._resume(record)
        where = self.damage.at(record.at)
        if end < self.data.size or self.data[mark:end] != MAGIC:
            extra = self.data.size - end
            self.damage.add(messages.file_end_damaged(where=where, count=extra))
        summary_start, _, _ = FOOT.unpack(self.data[record.content : mark])
        if not self.damage.losses:  # else what is missing is known
            self._check_summary_start(where, summary_start)
        return None

    def _check_summary_start(self, where: str, stated: int) -> None:
        """Enter a loss where the footer states another place than the end of the data; 0: none."""
        if self._data_end is None:
            self.damage.add(messages.data_end_missing(where=where, stated=stated))
        elif stated not in (0, self._data_end):
            self.damage.add(
                messages.summary_elsewhere(where=where, stated=stated, found=self._data_end)
            )

    def _resume(self, record: Record) -> int | None:
        """Enter damage that begins at a record; returns where records go on, None if nowhere."""
        before = self._last_begin
        place = next_proved_record(self.data, before + 1, self.channels)
        if place is None:
            self.damage.add(
                messages.record_cut_off(
                    where=self.damage.at(record.at),
                    count=self.data.size - record.at,
                    length=record.length,
                    opcode=record.opcode,
                )
            )
            return None
        # Records that go on before this one do so inside the last one, all of which is lost.
        lost = place - record.at if place > record.at else place - before
        where = self.damage.at(min(record.at, place))
        self.damage.add(messages.not_a_record(where=where, count=lost))
        self._last_begin = place
        return place

    # The content of the records.

    def _read_span(self, span: _Span) -> Iterator[Definition | MessageRecords]:
        """The content of the records of a span: definitions before the messages they define."""
        for record in span.others:
            if record.opcode in DEFINITIONS:
                yield from self._read_definition(record)
        if span.starts:
            yield MessageRecords(span.view, np.array(span.starts, np.int64))
        for record in span.others:
            if record.opcode == Opcode.CHUNK:
                yield from self._chunks.read(record)
            elif record.opcode == Opcode.MESSAGE:
                yield self._start_of_large_message(record)
            elif record.opcode == Opcode.DATA_END:
                self._check_data_end(record)

    def _read_definition(self, record: Record) -> Iterator[Definition]:
        """A schema, channel or statistics record; one that is too large is damage."""
        if record.length > MAX_DEFINITION:
            self.damage.add(
                messages.definition_too_large(
                    where=self.damage.at(record.at), count=record.length, opcode=record.opcode
                )
            )
            return
        content = self.data[record.content : record.end]
        yield Definition(record.opcode, content, record.content)

    def _start_of_large_message(self, record: Record) -> MessageRecords:
        """The beginning of a large message, as a record of its own."""
        head = RECORD.pack(Opcode.MESSAGE, MESSAGE_START)
        start = head + self.data[record.content : record.content + MESSAGE_START]
        return MessageRecords(np.frombuffer(start, np.uint8), np.zeros(1, np.int64))

    def _check_data_end(self, record: Record) -> None:
        """Check the first end of the data, whose checksum is that of all bytes before."""
        where = self.damage.at(record.at)
        if self._data_end_checked:
            self.damage.add(messages.data_end_twice(where=where))
            return
        self._data_end_checked = True
        end = record.content + min(record.length, CHECKSUM)
        crc = int.from_bytes(self.data[record.content : end], "little")
        if crc and checksum_of(self.data, 0, record.at) != crc:
            self.damage.add(messages.data_checksum_fails(where=where))
