"""ArduPilot logs as text (.log): FMT lines and rows -> the same channels as a binary log.

Mission Planner and mavlogdump write one message a line, with scaled values. A place is the first
byte of a line.
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
from unbend.ingest.limits import MAX_DEFINITIONS_OF_ONE
from unbend.ingest.message_tables import PLACE, Table
from unbend.ingest.messages import too_many_definitions
from unbend.ingest.timelines import Stamps, nanoseconds, timeline
from unbend.ingest.utc_evidence import Witness
from unbend.messages import Ledger

LONGEST = 4096  # bytes of a line; real ones have up to 250
ROWS = 4096  # rows of one type that become columns at once: as text they need 20 times the memory
_FIRST = re.compile(rb"FMT, ?\d+, ?\d+, ?\w+")
_BANNER = re.compile(rb"[\t -~]*\r?\n")  # a line of printable characters
_DECIMAL = "cCeELfdg"  # letters of scaled and of floating-point numbers
_TEXT = "nNZaM"  # letters of texts; arrays (a) and flight modes (M) are written as text
_UNSIGNED = "BHIQ"  # letters of whole numbers that are never negative
_LONGEST_WORD = 128  # characters of a text: binary logs have at most 64 bytes
_LONGEST_TEXT = {"a": 512}  # by letter, instead of `_LONGEST_WORD`: 32 whole numbers as text
_TIME_UNITS_US = {("TimeUS", "Q"): 1, ("TimeMS", "I"): 1000}  # by name and letter of a first field


def read_log(
    path: Path,
    ledger: Ledger,
    witnesses: Sequence[Witness] = (),
) -> Contents:
    """The contents of a log as text; ``witnesses`` are other clocks that know its date."""
    reader = _LineReader()
    tables = reader.read(path, set(wanted_fields()))  # now the reader knows all counts and times
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
    name="dataflash-text",
    title="ArduPilot DataFlash as text",
    extensions=(".log",),
    matches=is_text,
    read=read_log,
)


class _Line(NamedTuple):
    """The place of a line in the file, and its values as text."""

    place: int
    values: list[str]


@dataclass(frozen=True)
class _LineFormat:
    """The definition of a message by an FMT line: the letters and the names of its fields."""

    letters: str
    fields: tuple[str, ...]

    @property
    def time_unit_us(self) -> int:
        """The unit [us] of the time with which lines of this format begin; 0 without a time."""
        first_field = (self.fields[0], self.letters[0])
        return _TIME_UNITS_US.get(first_field, 0)

    def accepts(self, values: list[str]) -> bool:
        """Whether there is a value for each field, and each value is possible for its letter."""
        if len(values) != len(self.fields):
            return False
        try:
            return all(map(_fits, self.letters, values))
        except ValueError:  # not a number
            return False

    def table(self, lines: list[_Line]) -> Table:
        """Places and values of lines as columns."""
        places = [line.place for line in lines]
        columns: Table = {PLACE: np.array(places, np.int64)}
        values_of_fields = zip(*(line.values for line in lines), strict=True)
        fields = zip(self.fields, self.letters, values_of_fields, strict=True)
        for name, letter, values in fields:
            columns[name] = _column(letter, values)
        return columns


def _fits(letter: str, value: str) -> bool:
    """Whether the text of a value is possible for a field of a letter.

    Texts and integers may be as long as in binary logs. Raises ValueError if the letter is of
    numbers and the value is not a number.
    """
    if letter in _DECIMAL:
        float(value)
        return True
    if letter in _TEXT:
        return len(value) <= _LONGEST_TEXT.get(letter, _LONGEST_WORD)
    lowest = 0 if letter in _UNSIGNED else -(1 << 63)
    return lowest <= int(value) < lowest + (1 << 64)


def _column(letter: str, values: Sequence[str]) -> NDArray[Any]:
    """The values of a field as texts, float64 or integers; its letter decides."""
    if letter in _TEXT:
        return np.array(values, np.str_)
    if letter in _DECIMAL:
        return np.array([float(value) for value in values])
    integers = [int(value) for value in values]
    kind = np.uint64 if min(integers) >= 0 else np.int64
    return np.array(integers, kind)


_FMT = _LineFormat(
    letters="BBnNZ",
    fields=("Type", "Length", "Name", "Format", "Columns"),
)


class _TableBuilder:
    """Collects the lines of messages, and makes tables of `ROWS` lines at a time."""

    def __init__(self) -> None:
        # By message and format: the lines that are not in a table yet.
        self._pending: dict[tuple[str, _LineFormat], list[_Line]] = {}
        self._tables: dict[str, list[Table]] = {}

    def add(self, name: str, form: _LineFormat, line: _Line) -> None:
        """Append a line of the message ``name``."""
        pending = self._pending.setdefault((name, form), [])
        pending.append(line)
        if len(pending) == ROWS:
            self._make_table(name, form, pending)

    def _make_table(
        self,
        name: str,
        form: _LineFormat,
        pending: list[_Line],
    ) -> None:
        """Make a table of the pending lines of a message and a format, and empty their list."""
        table = form.table(pending)
        self._tables.setdefault(name, []).append(table)
        pending.clear()

    def tables(self) -> dict[str, Table]:
        """All lines as one table a message."""
        for (name, form), pending in self._pending.items():
            if pending:
                self._make_table(name, form, pending)
        merged = {}
        for name, several in self._tables.items():
            merged[name] = merge_tables(several)
        return merged


@dataclass
class _LineReader(DamagedBytes):
    """One pass over a file: the current definitions, the counts of messages, and the damage.

    formats : the definition in force by message.
    definitions_of : all definitions by message.
    counts : the number of lines by message.
    times : place and time since boot [us] of each line that begins with a time.
    """

    formats: dict[str, _LineFormat] = field(default_factory=lambda: {"FMT": _FMT})
    definitions_of: dict[str, set[_LineFormat]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    times: list[tuple[int, int]] = field(default_factory=list)

    def read(self, path: Path, wanted: set[str]) -> dict[str, Table]:
        """Read the file, and count lines and damage; returns the wanted messages as tables."""
        builder = _TableBuilder()
        end = 0
        with path.open("rb") as stream:
            while raw := stream.readline(LONGEST):  # a longer line comes in pieces
                begin = end
                end = begin + len(raw)
                is_cut_off = not raw.endswith(b"\n") and len(raw) < LONGEST
                if is_cut_off:  # not used: the cut may be within a number
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
        """Count a line, and keep its time if it begins with one."""
        self.counts[name] += 1
        unit_us = form.time_unit_us
        if unit_us:
            time_us = int(line.values[0]) * unit_us
            self.times.append((line.place, time_us))

    def _parse(self, raw: bytes) -> tuple[str, list[str]]:
        """The name of the message of a line, and its values; "" and [] if the line is not valid.

        A valid FMT line puts its definition in force.
        """
        text = raw.decode("utf-8", "replace").rstrip("\r\n")
        name, _, values_text = text.partition(",")
        form = self.formats.get(name)
        if form is None:
            return "", []
        commas = len(form.fields) - 1  # further commas belong to the last value
        values = [value.strip() for value in values_text.split(",", commas)]
        if not form.accepts(values):
            return "", []
        if name == "FMT" and not self._define(values):
            return "", []
        return name, values

    def _define(self, values: list[str]) -> bool:
        """Put the definition of an FMT line in force; False if it is not valid."""
        definition = dict(zip(_FMT.fields, values, strict=True))
        name = definition["Name"]
        letters = definition["Format"]
        columns = definition["Columns"]
        fields = tuple(part.strip() for part in columns.split(","))
        if columns == "Type,Length,Name,Format":  # old logs omit the last field
            fields += ("Columns",)
        is_distinct = len(set(fields)) == len(fields)
        if not name.isidentifier() or not is_distinct or "" in fields:
            return False
        if len(fields) != len(letters) or not letters:
            return False
        if name == "FMT" and len(fields) != len(_FMT.fields):
            return False  # further FMT lines could not be read
        form = _LineFormat(letters, fields)
        definitions = self.definitions_of.setdefault(name, set())
        definitions.add(form)
        self.formats[name] = form
        if len(definitions) > MAX_DEFINITIONS_OF_ONE:
            raise too_many_definitions(name=name, most=MAX_DEFINITIONS_OF_ONE)
        return True

    def stamps(self) -> Iterator[Stamps]:
        """The times of all lines that begin with one, as a single block."""
        if not self.times:
            return
        places = []
        possible_us = []
        for place, time_us in self.times:
            places.append(place)
            # damage makes integers that are too large for an array
            possible_us.append(min(max(time_us, 0), LAST_US))
        time_ns = nanoseconds(np.array(possible_us, np.int64))
        yield np.array(places, np.int64), time_ns
