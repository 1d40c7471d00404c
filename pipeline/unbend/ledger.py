"""The ledger: what every stage read, repaired, assumed, skipped and lost, and where."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from unbend.errors import in_agreement, texts


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
P = ParamSpec("P")

Notes = tuple[Entry, ...]
"""What a function of a pure room has to report, beside its result."""


class _Make(Protocol):
    """Makes an entry: with its text, or that of its key (CODE or CODE/word), filled in."""

    def __call__(
        self, key: str, what: str = "", *, where: str = "", count: int = 0, **values: object
    ) -> Entry: ...


def _entries_of(kind: Kind) -> _Make:
    def make(
        key: str, what: str = "", *, where: str = "", count: int = 0, **values: object
    ) -> Entry:
        what = what or texts()[key]["what"].format(where=where, count=count, **values)
        return Entry(kind, key.partition("/")[0], what, where, count)

    return make


note, fallback, warning = map(_entries_of, (Kind.NOTE, Kind.FALLBACK, Kind.WARNING))
finding, loss = map(_entries_of, (Kind.FINDING, Kind.LOSS))


def _adding(make: Callable[P, Entry]) -> Callable[Concatenate[Ledger, P], None]:
    """The method that adds such an entry to a ledger."""

    def add(ledger: Ledger, /, *key: P.args, **values: P.kwargs) -> None:
        ledger.add(make(*key, **values))

    return add


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

    note, fallback, warning = map(_adding, (note, fallback, warning))
    finding, loss = map(_adding, (finding, loss))

    def rows(self) -> list[dict[str, str | int]]:
        """The entries as plain dictionaries, sorted, for the manifest."""
        return [asdict(entry) | {"kind": entry.kind.value} for entry in sorted(self._entries)]
