"""ArduPilot logs as text (.log): FMT lines and rows -> the same channels as a binary log.

Mission Planner and mavlogdump write a message a line, scaled. A place is the first byte of a line.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from unbend.ingest.boot_clock import Stamps, nanoseconds, timeline
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash.dataflash_channels import wanted_fields
from unbend.ingest.dataflash.dataflash_contents import contents_of
from unbend.ingest.dataflash.record_tables import merge_tables
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import PLACE, Table
from unbend.messages import Ledger

LONGEST = 4096  # bytes of a line; real ones have up to 250


ROWS = 4096  # of one type that are made columns at once: as text they need 20 times the memory


_FIRST = re.compile(rb"FMT, ?\d+, ?\d+, ?\w+")


_DECIMAL = "cCeELfdg"  # scaled and floating-point letters


_TEXT = "nNZaM"  # arrays and flight modes are words in these logs


def read_log(path: Path, ledger: Ledger) -> Contents:
    """The contents of a log as text."""
    reader = _LineReader()
    tables = reader.read(path, set(wanted_fields()))
    reader.report_bytes(ledger, path.name, "line")

    def reread(names: set[str]) -> dict[str, Table]:
        return _LineReader().read(path, names)

    line = timeline(reader.stamps())
    return contents_of(reader, dict(reader.counts), line, tables, ledger, reread=reread)


def is_text(head: bytes) -> bool:
    """Whether a file defines a message in its first bytes."""
    return _FIRST.search(head[:LONGEST]) is not None


DATAFLASH_TEXT = LogFormat(
    "dataflash-text", "ArduPilot DataFlash as text", (".log",), is_text, read_log
)


@dataclass(frozen=True)
class _LineFormat:
    """The definition of a message by an FMT line: the letters and the names of its fields."""

    letters: str
    fields: tuple[str, ...]

    def accepts(self, values: list[str]) -> bool:
        """Whether there is a value for each field, and a number for each letter of numbers."""
        if len(values) != len(self.fields):
            return False
        try:
            for letter, value in zip(self.letters, values, strict=True):
                if letter in _DECIMAL:
                    float(value)
                elif letter not in _TEXT and not -(1 << 63) <= int(value) < 1 << 64:
                    return False
        except ValueError:
            return False
        return True

    def table(self, rows: list[tuple[int, list[str]]]) -> Table:
        """Places and values of lines as columns."""
        columns: Table = {PLACE: np.array([place for place, _ in rows], np.int64)}
        by_field = zip(*(values for _, values in rows), strict=True)
        for name, letter, values in zip(self.fields, self.letters, by_field, strict=True):
            if letter in _TEXT:
                columns[name] = np.array(values, np.str_)
            elif letter in _DECIMAL:
                columns[name] = np.array([float(value) for value in values])
            else:
                whole = [int(value) for value in values]
                columns[name] = np.array(whole, np.uint64 if min(whole) >= 0 else np.int64)
        return columns


_FMT = _LineFormat("BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


@dataclass
class _LineReader(DamagedBytes):
    """One pass over a file: the current definitions, counts of messages, and damage."""

    formats: dict[str, _LineFormat] = field(default_factory=lambda: {"FMT": _FMT})
    counts: Counter[str] = field(default_factory=Counter)
    times: list[tuple[int, int]] = field(default_factory=list)

    def read(self, path: Path, wanted: set[str]) -> dict[str, Table]:
        """The wanted messages as tables; everything is counted."""
        rows: dict[tuple[str, _LineFormat], list[tuple[int, list[str]]]] = {}
        tables: dict[str, list[Table]] = {}
        begin = 0
        with path.open("rb") as stream:
            while raw := stream.readline(LONGEST):  # a longer line comes in pieces
                place, begin = begin, begin + len(raw)
                if not raw.endswith(b"\n") and len(raw) < LONGEST:  # the last, maybe in a number
                    self.cut_bytes = len(raw)
                    break
                name, values = self._parse(raw)
                if not name:
                    if raw.strip():
                        self.drop(place, begin)
                    continue
                form = self.formats[name]
                self.counts[name] += 1
                first = form.fields[0], form.letters[0]
                unit = {("TimeUS", "Q"): 1, ("TimeMS", "I"): 1000}.get(first)
                if unit:
                    self.times.append((place, int(values[0]) * unit))
                if name in wanted:
                    pending = rows.setdefault((name, form), [])
                    pending.append((place, values))
                    if len(pending) == ROWS:
                        tables.setdefault(name, []).append(form.table(pending))
                        pending.clear()
        for (name, form), pending in rows.items():
            if pending:
                tables.setdefault(name, []).append(form.table(pending))
        return {name: merge_tables(several) for name, several in tables.items()}

    def _parse(self, raw: bytes) -> tuple[str, list[str]]:
        """The message of a line and its values; no name when the line is not valid."""
        text = raw.decode("utf-8", "replace").rstrip("\r\n")
        name, _, rest = text.partition(",")
        form = self.formats.get(name)
        if form is None:
            return "", []
        values = [value.strip() for value in rest.split(",", len(form.fields) - 1)]
        if not form.accepts(values):
            return "", []
        if name == "FMT":
            _, _, defined, letters, columns = values
            fields = tuple(part.strip() for part in columns.split(","))
            if columns == "Type,Length,Name,Format":  # old logs forget the last one
                fields += ("Columns",)
            distinct = len(set(fields)) == len(fields) == len(letters) and all(fields)
            if not defined.isidentifier() or not distinct:
                return "", []
            if defined == "FMT" and len(fields) != 5:
                return "", []
            self.formats[defined] = _LineFormat(letters, fields)
        return name, values

    def stamps(self) -> Iterator[Stamps]:
        """The times of all lines that begin with one, as a single block."""
        if self.times:
            places, times = zip(*self.times, strict=True)
            raw = np.array([max(time, 0) for time in times], np.uint64)
            yield np.array(places, np.int64), nanoseconds(raw)
