"""The definitions that the summary of an MCAP file repeats, if the summary is undamaged."""

from collections.abc import Iterator
from typing import NamedTuple

from unbend.ingest.buffers import FileView
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.damage import Damage
from unbend.ingest.mcap.record_layout import (
    CHECKSUM,
    DEFINITIONS_IN_CHUNKS,
    FOOT,
    MAGIC,
    MAX_DEFINITION,
    RECORD,
    Definition,
    Opcode,
    checksum_of,
    record_at,
)

MARKS_TRIED = 3  # places tried as the end of the data: messages may hold the same bytes


class _Footer(NamedTuple):
    """The footer of a file: where its content begins, and what it states of the summary."""

    content: int
    summary_start: int
    summary_crc: int

    @property
    def checked_end(self) -> int:
        """Where the bytes end that the checksum of the summary covers: before itself."""
        return self.content + FOOT.size - CHECKSUM


def summary_definitions(data: FileView, damage: Damage) -> Iterator[Definition]:
    """Yield the schemas and channels of the summary at the end of the file, if its checksum holds.

    Lost bytes may have moved the summary: where it is not at its stated place, which is damage, it
    is searched behind the records that end the data.
    """
    footer = _footer_of(data)
    if footer is None or not footer.summary_crc or not footer.summary_start:
        return  # no summary, or none that could be checked
    start: int | None = footer.summary_start
    if not _is_summary(data, footer.summary_start, footer):
        damage.add(messages.summary_checksum_fails(where=damage.at(footer.content)))
        start = _moved_summary(data, footer)
    if start is None:
        return
    while start + RECORD.size < footer.content:
        record = record_at(data, start)
        if record.opcode in DEFINITIONS_IN_CHUNKS and record.length <= MAX_DEFINITION:
            content = data[record.content : record.end]
            yield Definition(record.opcode, content, record.content)
        start = record.end


def _footer_of(data: FileView) -> _Footer | None:
    """The footer of a file, if the file ends with one and the mark of the format."""
    content = data.size - len(MAGIC) - FOOT.size
    end = content + FOOT.size
    if content < RECORD.size or data[end : data.size] != MAGIC:
        return None
    record = data[content - RECORD.size : end]
    if RECORD.unpack_from(record) != (Opcode.FOOTER, FOOT.size):
        return None
    summary_start, _, summary_crc = FOOT.unpack_from(record, RECORD.size)
    return _Footer(content, summary_start, summary_crc)


def _is_summary(data: FileView, start: int, footer: _Footer) -> bool:
    """Whether the summary begins at ``start``, by its checksum in the footer."""
    if not 0 < start <= footer.content:
        return False
    return checksum_of(data, start, footer.checked_end) == footer.summary_crc


def _moved_summary(data: FileView, footer: _Footer) -> int | None:
    """Where, behind an end of the data, a summary begins whose checksum holds; None if nowhere."""
    mark = RECORD.pack(Opcode.DATA_END, CHECKSUM)
    place = -1
    for _ in range(MARKS_TRIED):
        place = data.find(mark, place + 1, footer.content)
        if place < 0:
            return None
        start = place + len(mark) + CHECKSUM
        if checksum_of(data, start, footer.checked_end) == footer.summary_crc:
            return start
    return None
