"""The ledger: what was read, repaired, assumed, skipped and lost, and where.

Every stage adds to it, nothing is removed from it, and it ends in the manifest and the report.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import TypeVar

from pipeline.errors import in_agreement


class Kind(StrEnum):
    """How serious an entry is. ``LOSS`` and ``FINDING`` make a run end with exit code 3."""

    NOTE = "note"  # a choice made, for example which channel plays which role
    FALLBACK = "fallback"  # an allowed substitute, for example dry air without a hygrometer
    WARNING = "warning"  # the user should look, but the result stands
    FINDING = "finding"  # an input contradicts another, or what is plausible; may be accepted
    LOSS = "loss"  # data was lost, damaged, flagged, or something the config names is absent


@dataclass(frozen=True, order=True)
class Entry:
    """One line of the ledger.

    ``code`` is stable (``BARO-RANGE``); ``where`` a channel, file and byte offset, or column;
    ``count`` how many messages, bytes, samples or rows it is about.
    """

    kind: Kind
    code: str
    what: str
    where: str = ""
    count: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "what", in_agreement(self.what))


Result = TypeVar("Result")

Notes = tuple[Entry, ...]
"""What a function of a pure room has to report, beside its result."""


def note(code: str, what: str, *, where: str = "", count: int = 0) -> Entry:
    """An entry for a choice that was made."""
    return Entry(Kind.NOTE, code, what, where, count)


def fallback(code: str, what: str, *, where: str = "", count: int = 0) -> Entry:
    """An entry for an allowed substitute."""
    return Entry(Kind.FALLBACK, code, what, where, count)


def warning(code: str, what: str, *, where: str = "", count: int = 0) -> Entry:
    """An entry for what the user should look at, though the result stands."""
    return Entry(Kind.WARNING, code, what, where, count)


def loss(code: str, what: str, *, where: str = "", count: int = 0) -> Entry:
    """An entry for what was lost, damaged, flagged or absent."""
    return Entry(Kind.LOSS, code, what, where, count)


def finding(code: str, what: str, *, where: str = "", count: int = 0) -> Entry:
    """An entry for inputs that contradict each other, or what is plausible."""
    return Entry(Kind.FINDING, code, what, where, count)


class Ledger:
    """An append-only list of entries.

    >>> ledger = Ledger()
    >>> ledger.fallback("AIR-NO-BAROMETER", "no static pressure outside")
    >>> [entry.code for entry in ledger]
    ['AIR-NO-BAROMETER']
    >>> ledger.has_losses
    False
    """

    def __init__(self, entries: Iterable[Entry] = ()) -> None:
        self._entries: list[Entry] = list(entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def has_losses(self) -> bool:
        return any(entry.kind in (Kind.LOSS, Kind.FINDING) for entry in self._entries)

    def add(self, entry: Entry) -> None:
        if entry not in self._entries:
            self._entries.append(entry)

    def extend(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self.add(entry)

    def accept(self, reasons: Mapping[str, str]) -> tuple[str, ...]:
        """Make warnings of the findings of some codes; returns the codes that no finding has.

        ``reasons`` by code: why the mission file accepts it.

        >>> ledger = Ledger([finding("PLAUSIBLE-GROUND", "the ground is 400 m off")])
        >>> ledger.accept({"PLAUSIBLE-GROUND": "a gorge"}), ledger.has_losses
        ((), False)
        """
        unused = set(reasons)
        for i, entry in enumerate(self._entries):
            if entry.kind is Kind.FINDING and entry.code in reasons:
                what = f"{entry.what} (accepted: {reasons[entry.code]})"
                self._entries[i] = replace(entry, kind=Kind.WARNING, what=what)
                unused.discard(entry.code)
        return tuple(sorted(unused))

    def take(self, outcome: tuple[Result, Notes]) -> Result:
        """The result of a function that returns notes beside it; the notes are added.

        >>> ledger = Ledger()
        >>> ledger.take((1.5, (note("LENS-IN-AIR", "0.3 px"),))), len(ledger)
        (1.5, 1)
        """
        result, notes = outcome
        self.extend(notes)
        return result

    def note(self, code: str, what: str, *, where: str = "", count: int = 0) -> None:
        self.add(note(code, what, where=where, count=count))

    def fallback(self, code: str, what: str, *, where: str = "", count: int = 0) -> None:
        self.add(fallback(code, what, where=where, count=count))

    def warning(self, code: str, what: str, *, where: str = "", count: int = 0) -> None:
        self.add(warning(code, what, where=where, count=count))

    def loss(self, code: str, what: str, *, where: str = "", count: int = 0) -> None:
        self.add(loss(code, what, where=where, count=count))

    def finding(self, code: str, what: str, *, where: str = "", count: int = 0) -> None:
        self.add(finding(code, what, where=where, count=count))

    def rows(self) -> list[dict[str, str | int]]:
        """The entries as plain dictionaries, sorted, for the manifest."""
        return [asdict(entry) | {"kind": entry.kind.value} for entry in sorted(self._entries)]
