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
LISTED_ENDS = 2  # ends of the data that are checked; a damaged file may have a million


@dataclass
class _Span:
    """A span of the file, and the records that begin in it.

    begin, view : where it begins in the file, and its bytes.
    starts : the places in ``view`` where records of small messages begin, which lie in it.
    others : the other records that are read.
    following : where in the file the next span begins; None after the last.
    """

    begin: int
    view: Bytes
    starts: list[int] = field(default_factory=list)
    others: list[Record] = field(default_factory=list)
    following: int | None = None

    def drop_last_message_at(self, at: int) -> None:
        """Remove the last small message, if it begins at this place of the file."""
        if self.starts and self.begin + self.starts[-1] == at:
            self.starts.pop()


class RecordWalk:
    """Yields the definitions and messages of a file; ``damage`` is filled on the way.

    The definitions of the summary come first, if its checksum holds: they serve where those among
    the messages are damaged. So a definition may come several times.
    """

    def __init__(self, data: FileView, damage: Damage) -> None:
        self.data = data
        self.damage = damage
        self.channels: set[int] = set()  # their numbers prove messages after damage
        self._chunks = ChunkReader(data, damage, self.channels)
        self._batch = MessageBatch()
        # Where the last record before the present one begins. After damage records are searched
        # behind this place, as the length of that record may be what is damaged. The length of a
        # proved chunk is not: for a chunk it is the place of its last byte.
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
        """Yield definitions as they come, and messages in batches, when there are enough of them.

        The number of each channel that is defined is entered in ``channels`` before it is yielded.
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
        """Where the records begin. The mark before them, if damaged, may have lost bytes."""
        if self.data[0 : len(MAGIC)] == MAGIC:
            first = len(MAGIC)
        else:
            first = self._first_after_damaged_mark()
            where = self.damage.at(0)
            self.damage.add(messages.file_beginning_damaged(where=where, count=first))
        self._last_begin = first - 1  # the first record itself may be damaged
        return first

    def _first_after_damaged_mark(self) -> int:
        """The last place, within the mark's length, of a header before another record; else 0."""
        first = 0
        for place in range(len(MAGIC) + 1):
            record = record_at(self.data, place)
            if record.opcode == Opcode.HEADER and record.length < MAX_HEADER:
                following = self.data[record.end : record.end + 1]
                if following and 0 < following[0] <= LAST:
                    first = place
        return first

    def _walk_span(self, begin: int) -> _Span:
        """The span that begins at a place of the file, with its records."""
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
            else:
                has_ended = self._take_other_record(span, Record(opcode, begin + place, length))
                if has_ended:
                    return span
            place = end
        # Fewer bytes are left of the span than the head of a record has, or the last record, whose
        # end is in the file, reaches beyond the span. At the end of the file a footer is missing.
        following = begin + place
        if place > len(raw) or (place > 0 and following < self.data.size):
            span.following = following
        else:
            left = self.data.size - following
            self.damage.add(messages.no_footer(where=self.damage.at(following), count=left))
        return span

    def _take_other_record(self, span: _Span, record: Record) -> bool:
        """Take a record that is not a small message inside the span.

        Returns whether the span ends here: at damage, at the footer, or at a small message that
        ends behind the span. Its ``following`` is then set.
        """
        is_possible = 0 < record.opcode <= LAST or record.opcode >= PRIVATE
        if record.end > self.data.size or not is_possible:
            last_begin = self._last_begin
            span.following = self._resume(record)
            if span.following is not None and span.following < record.at:
                # Records lie inside the last message: its length was damaged.
                span.drop_last_message_at(last_begin)
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
        """Add a record to the others of a span, if it is of a kind that is read.

        An end of the data is noted here: the summary begins behind it.
        """
        if record.opcode == Opcode.DATA_END:
            self._data_end = record.end
            self._data_ends += 1
            if self._data_ends > LISTED_ENDS:
                return
        is_read = record.opcode in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
        if is_read or record.opcode in DEFINITIONS:
            span.others.append(record)

    def _end_at_footer(self, record: Record) -> int | None:
        """Check the end of the file at a footer; returns None, as no record follows.

        A footer of another length, or without room for the mark behind it, is damage: records then
        go on at the place that is returned.
        """
        mark = record.content + FOOT.size  # the mark of the format comes behind the footer
        end = mark + len(MAGIC)
        if record.length != FOOT.size or end > self.data.size:
            return self._resume(record)
        where = self.damage.at(record.at)
        if end < self.data.size or self.data[mark:end] != MAGIC:
            extra = self.data.size - end
            self.damage.add(messages.file_end_damaged(where=where, count=extra))
        summary_start, _, _ = FOOT.unpack(self.data[record.content : mark])
        if not self.damage.losses:  # else damage explains a summary elsewhere
            self._check_summary_start(where, summary_start)
        return None

    def _check_summary_start(self, where: str, stated: int) -> None:
        """Compare the place of the summary that the footer states with the end of the data.

        A loss is entered where they differ, or where no record ends the data. A footer that states
        0 states no place.
        """
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
        """The content of the records of a span.

        Definitions come first, before the messages that they define; chunks and large messages, in
        their order, come last.
        """
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
        """Check the first end of the data by its checksum, which is that of all bytes before it.

        A checksum of 0 is none. A second end of the data is damage.
        """
        where = self.damage.at(record.at)
        if self._data_end_checked:
            self.damage.add(messages.data_end_twice(where=where))
            return
        self._data_end_checked = True
        end = record.content + min(record.length, CHECKSUM)
        crc = int.from_bytes(self.data[record.content : end], "little")
        if crc and checksum_of(self.data, 0, record.at) != crc:
            self.damage.add(messages.data_checksum_fails(where=where))
