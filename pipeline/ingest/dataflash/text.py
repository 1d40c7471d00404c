"""ArduPilot logs as text (.log): FMT lines and rows -> the same channels as a binary log.

Mission Planner and mavlogdump write them: one message a line, fields after commas, scaled fields
already in their unit. A place in the file is the first byte of a line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.boot_clock import Stamps, microseconds, timeline
from pipeline.ingest.dataflash.channels import wanted
from pipeline.ingest.dataflash.columns import Decoded, merged
from pipeline.ingest.dataflash.log import contents_of
from pipeline.ingest.log import Contents, report_damage
from pipeline.ledger import Ledger

LONGEST = 4096  # bytes of a line; real ones have up to 250
ROWS = 4096  # of one type that are made columns at once: as text they need 20 times the memory
_FIRST = re.compile(rb"FMT, ?\d+, ?\d+, ?\w+")
_DECIMAL = "cCeELfdg"  # scaled and floating-point letters
_TEXT = "nNZaM"  # arrays and flight modes are words in these logs


@dataclass(frozen=True)
class DataFlashText:
    """The registry's line of this format."""

    name: str = "dataflash-text"
    title: str = "ArduPilot DataFlash as text"
    extensions: tuple[str, ...] = (".log",)

    def matches(self, head: bytes) -> bool:
        return _FIRST.search(head[:LONGEST]) is not None

    def read(self, path: Path, ledger: Ledger) -> Contents:
        found = _Lines()
        tables = found.read(path, set(wanted()))
        report_damage(
            ledger, path.name, unit="line", bad_bytes=found.bad_bytes, first_bad=found.first_bad,
            cut_bytes=found.cut_bytes,
        )  # fmt: skip
        line, again = timeline(_stamps(found)), partial(_decoded, path)
        return contents_of(dict(found.counts), found.bad_bytes, line, tables, again, ledger)


DATAFLASH_TEXT = DataFlashText()


@dataclass(frozen=True)
class _Format:
    """What a FMT line said: the letters and the names of the fields."""

    letters: str
    fields: tuple[str, ...]


@dataclass
class _Lines:
    """One reading of a file: what its lines define, how many there are, and which make no sense."""

    formats: dict[str, _Format] = field(
        default_factory=lambda: {
            "FMT": _Format("BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
        }
    )
    counts: Counter[str] = field(default_factory=Counter)
    times: list[tuple[int, int]] = field(default_factory=list)
    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0

    def read(self, path: Path, wanted: set[str]) -> dict[str, Decoded]:
        """The wanted messages as tables; everything is counted."""
        rows: dict[tuple[str, _Format], list[tuple[int, list[str]]]] = {}
        tables: dict[str, list[Decoded]] = {}
        for place, raw in _lines(path):
            if not raw.endswith(b"\n") and len(raw) < LONGEST:  # the last one, maybe in a number
                self.cut_bytes = len(raw)
                break
            name, values = self._parsed(raw)
            if not name:
                self._count_bad(place, raw)
                continue
            form = self.formats[name]
            self.counts[name] += 1
            if form.fields[0] == "TimeUS" and form.letters[0] == "Q":
                self.times.append((place, int(values[0])))
            if name in wanted:
                some = rows.setdefault((name, form), [])
                some.append((place, values))
                if len(some) == ROWS:
                    tables.setdefault(name, []).append(_table_of(form, some))
                    some.clear()
        for (name, form), some in rows.items():
            if some:
                tables.setdefault(name, []).append(_table_of(form, some))
        return {name: merged(several) for name, several in tables.items()}

    def _count_bad(self, place: int, raw: bytes) -> None:
        if raw.strip():
            self.bad_bytes += len(raw)
            self.first_bad = place if self.first_bad < 0 else self.first_bad

    def _parsed(self, raw: bytes) -> tuple[str, list[str]]:
        """The message of a line and its values; no name when the line makes no sense."""
        text = raw.decode("utf-8", "replace").rstrip("\r\n")
        name, _, rest = text.partition(",")
        form = self.formats.get(name)
        if form is None:
            return "", []
        values = [value.strip() for value in rest.split(",", len(form.fields) - 1)]
        if len(values) != len(form.fields) or not _sound(form.letters, values):
            return "", []
        if name == "FMT" and not self._defined(values):
            return "", []
        return name, values

    def _defined(self, values: list[str]) -> bool:
        _, _, name, letters, columns = values
        fields = tuple(part.strip() for part in columns.split(","))
        if columns == "Type,Length,Name,Format":  # old logs forget the last one
            fields += ("Columns",)
        if not name.isidentifier() or len(set(fields)) != len(fields) or not all(fields):
            return False
        if len(letters) != len(fields) or (name == "FMT" and len(fields) != 5):
            return False
        self.formats[name] = _Format(letters, fields)
        return True


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """The lines of a file with their places; an endless one comes in pieces."""
    place = 0
    with path.open("rb") as stream:
        while raw := stream.readline(LONGEST):
            yield place, raw
            place += len(raw)


def _sound(letters: str, values: list[str]) -> bool:
    try:
        for letter, value in zip(letters, values, strict=True):
            if letter in _DECIMAL:
                float(value)
            elif letter not in _TEXT and not -(1 << 63) <= int(value) < 1 << 64:
                return False
    except ValueError:
        return False
    return True


def _table_of(form: _Format, rows: list[tuple[int, list[str]]]) -> Decoded:
    places = np.array([place for place, _ in rows], np.int64)
    columns = zip(*(values for _, values in rows), strict=True)
    return Decoded(
        {
            name: _column(letter, column)
            for name, letter, column in zip(form.fields, form.letters, columns, strict=True)
        },
        places,
    )


def _column(letter: str, values: tuple[str, ...]) -> NDArray[Any]:
    if letter in _TEXT:
        return np.array(values, np.str_)
    if letter in _DECIMAL:
        return np.array([float(value) for value in values])
    whole = [int(value) for value in values]
    return np.array(whole, np.uint64 if min(whole) >= 0 else np.int64)


def _stamps(found: _Lines) -> Iterator[Stamps]:
    if found.times:
        places, times = zip(*found.times, strict=True)
        raw = np.array([max(time, 0) for time in times], np.uint64)
        yield np.array(places, np.int64), microseconds(raw) * 1000


def _decoded(path: Path, names: set[str]) -> dict[str, Decoded]:
    """All fields of some types."""
    return _Lines().read(path, names)
