"""ArduPilot logs as text (.log): FMT lines and rows -> the same channels as a binary log.

Mission Planner and mavlogdump write a message a line, scaled. A place is the first byte of a line.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.clock import LAST_US
from unbend.ingest.damaged_bytes import DamagedBytes
from unbend.ingest.dataflash.dataflash_channels import wanted_fields
from unbend.ingest.dataflash.dataflash_contents import contents_of
from unbend.ingest.dataflash.record_tables import merge_tables
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import PLACE, Table
from unbend.ingest.timelines import Stamps, nanoseconds, timeline
from unbend.ingest.utc_evidence import Witness
from unbend.messages import Ledger

LONGEST = 4096  # bytes of a line; real ones have up to 250
ROWS = 4096  # of one type that are made columns at once: as text they need 20 times the memory
_FIRST = re.compile(rb"FMT, ?\d+, ?\d+, ?\w+")
_BANNER = re.compile(rb"[\t -~]*\r?\n")  # a line of printable characters
_DECIMAL = "cCeELfdg"  # scaled and floating-point letters
_TEXT = "nNZaM"  # arrays and flight modes are words in these logs
_TIME_UNITS_US = {("TimeUS", "Q"): 1, ("TimeMS", "I"): 1000}  # by name and letter of a first field


def read_log(path: Path, ledger: Ledger, witnesses: Sequence[Witness] = ()) -> Contents:
    """The contents of a log as text; ``witnesses`` are other clocks that tell its date."""
    reader = _LineReader()
    tables = reader.read(path, set(wanted_fields()))
    reader.report_bytes(ledger, path.name, "line")

    def reread(names: set[str]) -> dict[str, Table]:
        return _LineReader().read(path, names)

    line = timeline(reader.stamps())
    return contents_of(
        reader,
        dict(reader.counts),
        line,
        tables,
        ledger,
        reread=reread,
        witnesses=witnesses,
    )


def is_text(head: bytes) -> bool:
    """Whether a file defines a message in its first bytes."""
    return _FIRST.search(head[:LONGEST]) is not None


DATAFLASH_TEXT = LogFormat(
    "dataflash-text", "ArduPilot DataFlash as text", (".log",), is_text, read_log
)


class _Line(NamedTuple):
    """The first byte of a line in the file, and its values as text."""

    place: int
    values: list[str]


@dataclass(frozen=True)
class _LineFormat:
    """The definition of a message by an FMT line: the letters and the names of its fields."""

    letters: str
    fields: tuple[str, ...]

    @property
    def time_unit_us(self) -> int:
        """The unit [us] of the time with which lines of this format begin; 0 without one."""
        return _TIME_UNITS_US.get((self.fields[0], self.letters[0]), 0)

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

    def table(self, lines: list[_Line]) -> Table:
        """Places and values of lines as columns."""
        columns: Table = {PLACE: np.array([line.place for line in lines], np.int64)}
        values_of_fields = zip(*(line.values for line in lines), strict=True)
        for name, letter, values in zip(self.fields, self.letters, values_of_fields, strict=True):
            columns[name] = _column(letter, values)
        return columns


def _column(letter: str, values: Sequence[str]) -> NDArray[Any]:
    """The values of a field as texts, float64 or integers, as its letter says."""
    if letter in _TEXT:
        return np.array(values, np.str_)
    if letter in _DECIMAL:
        return np.array([float(value) for value in values])
    integers = [int(value) for value in values]
    return np.array(integers, np.uint64 if min(integers) >= 0 else np.int64)


_FMT = _LineFormat("BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


class _TableBuilder:
    """Lines of the wanted messages, which become columns some thousand at a time."""

    def __init__(self) -> None:
        self._pending: dict[tuple[str, _LineFormat], list[_Line]] = {}
        self._tables: dict[str, list[Table]] = {}

    def add(self, name: str, form: _LineFormat, line: _Line) -> None:
        """Append a line of a message."""
        pending = self._pending.setdefault((name, form), [])
        pending.append(line)
        if len(pending) == ROWS:
            self._make_table(name, form, pending)

    def _make_table(self, name: str, form: _LineFormat, pending: list[_Line]) -> None:
        """Make a table of the pending lines of a message and a format, and empty their list."""
        self._tables.setdefault(name, []).append(form.table(pending))
        pending.clear()

    def tables(self) -> dict[str, Table]:
        """All lines as one table a message."""
        for (name, form), pending in self._pending.items():
            if pending:
                self._make_table(name, form, pending)
        return {name: merge_tables(several) for name, several in self._tables.items()}


@dataclass
class _LineReader(DamagedBytes):
    """One pass over a file: the current definitions, counts of messages, and damage."""

    formats: dict[str, _LineFormat] = field(default_factory=lambda: {"FMT": _FMT})
    counts: Counter[str] = field(default_factory=Counter)
    times: list[tuple[int, int]] = field(default_factory=list)  # places, times since boot [us]

    def read(self, path: Path, wanted: set[str]) -> dict[str, Table]:
        """The wanted messages as tables; everything is counted."""
        builder = _TableBuilder()
        end = 0
        with path.open("rb") as stream:
            while raw := stream.readline(LONGEST):  # a longer line comes in pieces
                begin = end
                end = begin + len(raw)
                is_cut_off = not raw.endswith(b"\n") and len(raw) < LONGEST
                if is_cut_off:  # maybe within a number
                    self.cut_bytes = len(raw)
                    break
                name, values = self._parse(raw)
                if name:
                    form = self.formats[name]
                    line = _Line(begin, values)
                    self._count(name, form, line)
                    if name in wanted:
                        builder.add(name, form, line)
                elif raw.strip() and not self._is_banner(raw):
                    self.drop(begin, end)
        return builder.tables()

    def _is_banner(self, raw: bytes) -> bool:
        """Whether a line is of the banner that old firmware prints before it defines messages."""
        return not self.counts and _BANNER.fullmatch(raw) is not None

    def _count(self, name: str, form: _LineFormat, line: _Line) -> None:
        """Count a line, and keep its time where it begins with one."""
        self.counts[name] += 1
        unit_us = form.time_unit_us
        if unit_us:
            self.times.append((line.place, int(line.values[0]) * unit_us))

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
        if name == "FMT" and not self._define(values):
            return "", []
        return name, values

    def _define(self, values: list[str]) -> bool:
        """Take the definition of an FMT line; False where it is not valid."""
        name = values[2]
        letters = values[3]
        columns = values[4]
        fields = tuple(part.strip() for part in columns.split(","))
        if columns == "Type,Length,Name,Format":  # old logs forget the last one
            fields += ("Columns",)
        is_distinct = len(set(fields)) == len(fields)
        if not name.isidentifier() or not is_distinct or "" in fields:
            return False
        if len(fields) != len(letters):
            return False
        if name == "FMT" and len(fields) != len(_FMT.fields):
            return False
        self.formats[name] = _LineFormat(letters, fields)
        return True

    def stamps(self) -> Iterator[Stamps]:
        """The times of all lines that begin with one, as a single block."""
        if not self.times:
            return
        places, times_us = zip(*self.times, strict=True)
        # Python's integers are of any size; damage makes some that no array holds
        raw = np.array([min(max(time_us, 0), LAST_US) for time_us in times_us], np.int64)
        yield np.array(places, np.int64), nanoseconds(raw)
