"""The definitions that the summary of an MCAP file repeats, if the summary is undamaged."""

from collections.abc import Iterator
from typing import NamedTuple

from unbend.ingest.buffers import FileView
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.damage import Damage
from unbend.ingest.mcap.record_layout import (
    CHECKSUM,
    DEFINITIONS_IN_CHUNKS,
    FOOTER,
    MAGIC,
    MAX_DEFINITION,
    RECORD_HEAD,
    Definition,
    Opcode,
    checksum_of,
    record_at,
)

MARKS_TRIED = 3  # places tried as the end of the data: messages may contain the same bytes


class _Footer(NamedTuple):
    """The footer of a file: where its content begins, and what it states of the summary."""

    content_begin: int
    summary_start: int
    summary_crc: int

    @property
    def checked_end(self) -> int:
        """The end of the bytes that the checksum of the summary covers: where it begins itself."""
        return self.content_begin + FOOTER.size - CHECKSUM


def summary_definitions(data: FileView, damage: Damage) -> Iterator[Definition]:
    """Yield the schemas and channels of the summary at the end of the file, if its checksum fits.

    A summary without a checksum, or without a stated place, is not read. If the checksum does not
    fit at the stated place, this is entered as damage. Lost bytes may have moved the summary, so it
    is searched behind the records that end the data.
    """
    footer = _footer_of(data)
    if footer is None or not footer.summary_crc or not footer.summary_start:
        return
    start: int | None = footer.summary_start
    if not _is_summary(data, footer.summary_start, footer):
        damage.add(
            messages.summary_checksum_fails(where=damage.place_in_words(footer.content_begin))
        )
        start = _moved_summary(data, footer)
    if start is None:
        return
    place = start
    while place + RECORD_HEAD.size < footer.content_begin:
        record = record_at(data, place)
        if record.opcode in DEFINITIONS_IN_CHUNKS and record.length <= MAX_DEFINITION:
            content = data[record.content_begin : record.end]
            yield Definition(record.opcode, content, record.content_begin)
        place = record.end


def _footer_of(data: FileView) -> _Footer | None:
    """The footer of a file; None if the file does not end with one and the mark of the format."""
    content_begin = data.size - len(MAGIC) - FOOTER.size
    end = content_begin + FOOTER.size
    if content_begin < RECORD_HEAD.size or data[end : data.size] != MAGIC:
        return None
    record = data[content_begin - RECORD_HEAD.size : end]
    if RECORD_HEAD.unpack_from(record) != (Opcode.FOOTER, FOOTER.size):
        return None
    summary_start, _, summary_crc = FOOTER.unpack_from(record, RECORD_HEAD.size)
    return _Footer(content_begin, summary_start, summary_crc)


def _is_summary(data: FileView, start: int, footer: _Footer) -> bool:
    """Whether the bytes from ``start`` on have the checksum of the summary in the footer."""
    if not 0 < start <= footer.content_begin:
        return False
    return checksum_of(data, start, footer.checked_end) == footer.summary_crc


def _moved_summary(data: FileView, footer: _Footer) -> int | None:
    """Where behind an end of the data the summary begins, by its checksum; None if nowhere."""
    mark = RECORD_HEAD.pack(Opcode.DATA_END, CHECKSUM)
    place = -1  # the search begins one byte behind it
    for _ in range(MARKS_TRIED):
        place = data.find(mark, place + 1, footer.content_begin)
        if place < 0:
            return None
        start = place + len(mark) + CHECKSUM
        if checksum_of(data, start, footer.checked_end) == footer.summary_crc:
            return start
    return None
