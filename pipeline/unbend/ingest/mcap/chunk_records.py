"""The records in the chunks of an MCAP file: messages by the run, between them definitions."""

from collections.abc import Iterator, Set
from typing import IO

import numpy as np

from unbend.ingest.buffers import Bytes, FileView, Runs, gather
from unbend.ingest.mcap import chunks, messages
from unbend.ingest.mcap.damage import Damage
from unbend.ingest.mcap.message_batches import BATCH_BYTES, MessageRecords
from unbend.ingest.mcap.record_layout import (
    DEFINITIONS_IN_CHUNKS,
    LARGE_MESSAGE,
    MAX_DEFINITION,
    MESSAGE_START,
    RECORD_HEAD,
    Definition,
    Opcode,
    Record,
    raw_of,
)
from unbend.ingest.mcap.record_proofs import next_message_in_chunk
from unbend.messages import Message
from unbend.units import Integers

KEPT_KINDS = (*DEFINITIONS_IN_CHUNKS, Opcode.MESSAGE)  # of the records of a large chunk


class ChunkReader:
    """Reads the chunks of a file one after the other; ``damage`` is filled on the way.

    ``channels`` are the numbers of the channels defined so far. When a chunk yields a definition,
    the caller adds its channel before it asks for the next record: these numbers prove messages
    after damage in the same chunk.
    """

    def __init__(self, data: FileView, damage: Damage, channels: Set[int]) -> None:
        self.data = data
        self.damage = damage
        self.channels = channels
        self.budget = chunks.InflationBudget(data.size)

    def read(self, record: Record) -> Iterator[Definition | MessageRecords]:
        """Yield the definitions and messages of a chunk; one that cannot be read is damage."""
        chunk = self._checked_head(record)
        if chunk is None:
            return
        lost_bytes = record.length if chunk.small else chunk.length  # reported if inflating fails
        where = self.damage.place_in_words(record.begin)
        inflated = chunks.inflate(self.data, chunk, where=where, count=lost_bytes)
        if isinstance(inflated, Message):
            self.damage.add(inflated)
        elif chunk.small:
            yield from self._records_in(np.frombuffer(inflated, np.uint8), record.begin)
        else:
            yield from self._large_chunk(record.begin, chunk)

    def _checked_head(self, record: Record) -> chunks.Chunk | None:
        """The head of a chunk that may be inflated; the cost of that is taken from the budget.

        None for any other chunk, which is entered as damage.
        """
        where = self.damage.place_in_words(record.begin)
        count = record.length
        chunk = chunks.chunk_head(self.data, record.content_begin, record.length)
        if chunk is None:
            self.damage.add(messages.chunk_head_invalid(where=where, count=count))
            return None
        if chunk.compression not in chunks.COMPRESSIONS:
            self.damage.add(
                messages.compression_unknown(
                    where=where, count=count, compression=chunk.compression
                )
            )
            return None
        too_large = self.budget.spend(chunk, where=where, count=count)
        if too_large is not None:
            self.damage.add(too_large)
            return None
        return chunk

    def _large_chunk(
        self, chunk_begin: int, chunk: chunks.Chunk
    ) -> Iterator[Definition | MessageRecords]:
        """The records of a chunk that `inflate` has checked, inflated again, block by block.

        ``chunk_begin``: the place of the chunk in the file, for reports of damage.
        """
        kept = bytearray()
        place = 0
        with chunks.chunk_stream(self.data, chunk) as stream:
            while place + RECORD_HEAD.size <= chunk.size:
                opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
                bytes_left = chunk.size - place - RECORD_HEAD.size
                if opcode == 0 or length > bytes_left:
                    self.damage.add(
                        messages.chunk_end_not_records(
                            where=self.damage.place_in_words(chunk_begin),
                            count=chunk.size - place,
                            size=chunk.size,
                        )
                    )
                    break
                kept += _kept_part(stream, opcode, length)
                place += RECORD_HEAD.size + length
                if len(kept) >= BATCH_BYTES:
                    batch = bytes(kept)  # a copy: messages keep views of it
                    kept.clear()
                    yield from self._records_in(np.frombuffer(batch, np.uint8), chunk_begin)
        yield from self._records_in(np.frombuffer(bytes(kept), np.uint8), chunk_begin)

    def _records_in(self, view: Bytes, chunk_begin: int) -> Iterator[Definition | MessageRecords]:
        """Yield the definitions among inflated records, and then all messages among them together.

        ``chunk_begin``: the place of the chunk in the file. Damage is entered, and passed over.
        """
        size = int(view.shape[0])
        if not size:
            return
        raw = raw_of(view)
        runs = _message_runs(view)
        starts: list[Integers] = []
        place = 0
        while place < size:
            run = runs.starting_at(place)
            if run.stop > run.start:  # messages that follow each other: all are taken at once
                starts.append(runs.at[run])
                place = int(runs.end[run.stop - 1])
                continue
            end = _definition_end(raw, place)
            if end is None:
                place = self._resume_in(view, place, starts, chunk_begin)
                continue
            content = raw[place + RECORD_HEAD.size : end]
            if len(content) <= MAX_DEFINITION:
                yield Definition(raw[place], bytes(content), chunk_begin)
            place = end
        if starts:
            records = MessageRecords(view, np.concatenate(starts))
            yield from self._within_budget(records, chunk_begin)

    def _within_budget(self, records: MessageRecords, chunk_begin: int) -> Iterator[MessageRecords]:
        """Yield the messages of a chunk, unless they are too many for a file of this size."""
        too_many = self.budget.spend_messages(
            records.starts.shape[0],
            where=self.damage.place_in_words(chunk_begin),
            count=records.data.shape[0],
        )
        if too_many is None:
            yield records
        else:
            self.damage.add(too_many)

    def _resume_in(self, view: Bytes, place: int, starts: list[Integers], chunk_begin: int) -> int:
        """Enter the damage at a place of an inflated chunk; returns where in it messages go on.

        The length of the message before ``place`` may be what is damaged: messages then go on
        inside that message, before ``place``, and that message is removed from ``starts``.
        """
        last_begin = place
        if starts and starts[-1].size:
            last_begin = int(starts[-1][-1])  # where the message before the place begins
        resumed = next_message_in_chunk(view, last_begin, self.channels)
        if resumed < place:
            starts[-1] = starts[-1][:-1]
            lost = resumed - last_begin
        else:
            lost = resumed - place
        self.damage.add(
            messages.chunk_not_records(
                where=self.damage.place_in_words(chunk_begin),
                count=lost,
                size=int(view.shape[0]),
            )
        )
        return resumed


def _kept_part(stream: IO[bytes], opcode: int, length: int) -> bytes:
    """Read the content of a record from the stream of a large chunk; returns what is kept of it.

    A message or definition is returned as a record, with its head and its whole content, or, if it
    is large, the first bytes of that; a record of another kind as b"". In any case the stream is
    moved behind the content.
    """
    kept = b""
    bytes_left = length
    if opcode in KEPT_KINDS:
        kept_length = _kept_length(opcode, length)
        kept = RECORD_HEAD.pack(opcode, kept_length) + stream.read(kept_length)
        bytes_left -= kept_length
    while bytes_left > 0:
        bytes_left -= len(stream.read(min(bytes_left, chunks.BLOCK)))
    return kept


def _kept_length(opcode: int, length: int) -> int:
    """How many bytes of the content of a definition or message are kept: all, or the first ones."""
    if opcode in DEFINITIONS_IN_CHUNKS:
        return min(length, MAX_DEFINITION)
    return length if length <= LARGE_MESSAGE else MESSAGE_START


def _message_runs(view: Bytes) -> Runs:
    """Where messages may begin and end in an inflated chunk.

    They begin at each byte with the opcode of a message and a length that ends inside the chunk.
    """
    size = int(view.shape[0])
    places = np.flatnonzero(view[: max(size - RECORD_HEAD.size + 1, 0)] == Opcode.MESSAGE)
    lengths = gather(view, places + 1, 8).view("<u8")
    fits = lengths <= (size - RECORD_HEAD.size - places).astype(np.uint64)
    begins = places[fits].astype(np.int64)
    return Runs(begins, begins + RECORD_HEAD.size + lengths[fits].astype(np.int64))


def _definition_end(raw: memoryview, place: int) -> int | None:
    """Where the schema or channel ends that begins at a place of an inflated chunk.

    None if neither begins there, or if it does not end inside the chunk.
    """
    if place + RECORD_HEAD.size > len(raw):
        return None
    opcode, length = RECORD_HEAD.unpack_from(raw, place)
    end = place + RECORD_HEAD.size + length
    if opcode not in DEFINITIONS_IN_CHUNKS or end > len(raw):
        return None
    return int(end)
