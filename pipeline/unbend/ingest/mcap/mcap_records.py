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
    FIRST_PRIVATE_OPCODE,
    FOOTER,
    LARGE_MESSAGE,
    LAST_OPCODE,
    MAGIC,
    MAX_DEFINITION,
    MESSAGE_START,
    RECORD_HEAD,
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
MAX_HEADER = 1 << 16  # [bytes] of a header record: a longer one does not show where records begin
LISTED_ENDS = 2  # ends of the data that are checked; a damaged file may have a million


@dataclass
class _Span:
    """A span of the file, and the records that begin in it.

    begin, view : where it begins in the file, and its bytes.
    starts : the places in ``view`` where the records of small messages begin that end in it.
    others : the other records of kinds that are read.
    following : where in the file the next span begins; None after the last.
    """

    begin: int
    view: Bytes
    starts: list[int] = field(default_factory=list)
    others: list[Record] = field(default_factory=list)
    following: int | None = None

    def drop_last_message_at(self, place: int) -> None:
        """Remove the last small message from ``starts``, if it begins at this place of the file."""
        if self.starts and self.begin + self.starts[-1] == place:
            self.starts.pop()


class RecordWalk:
    """Yields the definitions and messages of a file; ``damage`` is filled on the way.

    The definitions of the summary come first, if its checksum fits: they are used where those among
    the messages are damaged. So a definition may come several times.
    """

    def __init__(self, data: FileView, damage: Damage) -> None:
        self.data = data
        self.damage = damage
        self.channels: set[int] = set()  # their numbers prove messages after damage
        self._chunks = ChunkReader(data, damage, self.channels)
        self._batch = MessageBatch()
        # After damage, records are searched behind this place. It is the begin of the previous
        # record, because the length of that may be damaged; of a proved chunk it is the last byte.
        self._search_after = -1
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
        """Where the first record begins: behind the mark of the format, `MAGIC`.

        A damaged mark is entered as damage. It may have lost bytes, and the record begin earlier.
        """
        if self.data[0 : len(MAGIC)] == MAGIC:
            first = len(MAGIC)
        else:
            first = self._first_after_damaged_mark()
            where = self.damage.place_in_words(0)
            self.damage.add(messages.file_beginning_damaged(where=where, count=first))
        self._search_after = first - 1  # the first record itself may be damaged
        return first

    def _first_after_damaged_mark(self) -> int:
        """Where the header record begins behind a damaged mark of at most its usual length.

        That is the last place with a header record and another record behind it; 0 without any.
        """
        first = 0
        for place in range(len(MAGIC) + 1):  # up to that behind a mark of the usual length
            record = record_at(self.data, place)
            if record.opcode == Opcode.HEADER and record.length < MAX_HEADER:
                following = self.data[record.end : record.end + 1]
                if following and 0 < following[0] <= LAST_OPCODE:
                    first = place
        return first

    def _walk_span(self, begin: int) -> _Span:
        """Find the records of the span that begins at a place of the file, each by the one before.

        Damage on the way is entered. ``following`` of the span is set.
        """
        span = _Span(begin, self.data.array(begin, begin + SPAN))
        raw = raw_of(span.view)
        unpack = RECORD_HEAD.unpack_from
        place = 0
        while place + RECORD_HEAD.size <= len(raw):
            opcode, length = unpack(raw, place)
            end = place + RECORD_HEAD.size + length
            if opcode == Opcode.MESSAGE and length <= LARGE_MESSAGE and end <= len(raw):
                span.starts.append(place)
                self._search_after = begin + place
            else:
                has_ended = self._take_other_record(span, Record(opcode, begin + place, length))
                if has_ended:
                    return span
            place = end
        following = begin + place
        reaches_beyond = place > len(raw)  # the last record, whose end is in the file
        begins_record = place > 0 and following < self.data.size  # its head is not in the span
        if reaches_beyond or begins_record:
            span.following = following
        else:  # the file ends without a footer
            where = self.damage.place_in_words(following)
            bytes_left = self.data.size - following
            self.damage.add(messages.no_footer(where=where, count=bytes_left))
        return span

    def _take_other_record(self, span: _Span, record: Record) -> bool:
        """Take a record that is not a small message inside the span.

        Returns whether the span ends here: at damage, at the footer, or at a small message that
        ends behind the span. ``span.following`` is then set.
        """
        is_possible = 0 < record.opcode <= LAST_OPCODE or record.opcode >= FIRST_PRIVATE_OPCODE
        if record.end > self.data.size or not is_possible:
            previous_begin = self._search_after  # `_resume` changes it
            span.following = self._resume(record)
            if span.following is not None and span.following < record.begin:
                # Records go on inside the last message: its length was damaged.
                span.drop_last_message_at(previous_begin)
            return True
        if record.opcode == Opcode.FOOTER:
            span.following = self._end_at_footer(record)
            return True
        if record.opcode == Opcode.MESSAGE and record.length <= LARGE_MESSAGE:
            span.following = record.begin  # it ends behind the span, and begins the next one
            return True
        self._list_record(span, record)
        is_chunk = record.opcode == Opcode.CHUNK
        if is_chunk and is_proved(self.data, record.begin, self.channels):
            self._search_after = record.end - 1
        else:
            self._search_after = record.begin
        return False

    def _list_record(self, span: _Span, record: Record) -> None:
        """Add a record to ``span.others``, if it is of a kind that is read.

        The place of a record that ends the data is kept too: the summary begins behind it.
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
        """Check the footer and the mark behind it; returns where records go on.

        None behind an undamaged footer, as no record follows. A footer of another length, or
        without room for the mark behind it, is damage: records may go on as behind other damage.
        """
        mark = record.content_begin + FOOTER.size  # the mark of the format comes behind the footer
        end = mark + len(MAGIC)
        if record.length != FOOTER.size or end > self.data.size:
            return self._resume(record)
        where = self.damage.place_in_words(record.begin)
        if end < self.data.size or self.data[mark:end] != MAGIC:
            extra = self.data.size - end
            self.damage.add(messages.file_end_damaged(where=where, count=extra))
        summary_start, _, _ = FOOTER.unpack(self.data[record.content_begin : mark])
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
        """Report the damage found at a record; returns where records go on, None if nowhere.

        That may be before ``record``, inside the previous record, if the length of the previous
        record was damaged.
        """
        previous_begin = self._search_after
        place = next_proved_record(self.data, previous_begin + 1, self.channels)
        if place is None:
            self.damage.add(
                messages.record_cut_off(
                    where=self.damage.place_in_words(record.begin),
                    count=self.data.size - record.begin,
                    length=record.length,
                    opcode=record.opcode,
                )
            )
            return None
        # A place before this record is inside the previous one, which is lost from its begin on.
        lost_from = record.begin if place > record.begin else previous_begin
        lost = place - lost_from
        where = self.damage.place_in_words(lost_from)
        self.damage.add(messages.not_a_record(where=where, count=lost))
        self._search_after = place
        return place

    # The content of the records.

    def _read_span(self, span: _Span) -> Iterator[Definition | MessageRecords]:
        """Yield what the records of a span contain, and check the ends of the data.

        Definitions come first, before the messages that they define; then small messages; chunks
        and large messages, in their order, come last.
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
                    where=self.damage.place_in_words(record.begin),
                    count=record.length,
                    opcode=record.opcode,
                )
            )
            return
        content = self.data[record.content_begin : record.end]
        yield Definition(record.opcode, content, record.content_begin)

    def _start_of_large_message(self, record: Record) -> MessageRecords:
        """The first `MESSAGE_START` bytes of a large message, as a record of that length."""
        head = RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_START)
        start = head + self.data[record.content_begin : record.content_begin + MESSAGE_START]
        return MessageRecords(np.frombuffer(start, np.uint8), np.zeros(1, np.int64))

    def _check_data_end(self, record: Record) -> None:
        """Check a record that ends the data.

        The first contains the checksum of all bytes before it, or 0 for no checksum. A second one
        is damage.
        """
        where = self.damage.place_in_words(record.begin)
        if self._data_end_checked:
            self.damage.add(messages.data_end_twice(where=where))
            return
        self._data_end_checked = True
        end = record.content_begin + min(record.length, CHECKSUM)
        crc = int.from_bytes(self.data[record.content_begin : end], "little")
        if crc and checksum_of(self.data, 0, record.begin) != crc:
            self.damage.add(messages.data_checksum_fails(where=where))
