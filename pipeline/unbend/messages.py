"""Messages: what every stage read, repaired, assumed, skipped and lost, and where.

A message is a value: its code, how serious it is, where, how many, and named values. The words
stand beside those who send it, in ``messages.py`` of each package, one typed function a message;
the report and the terminal render them. Nothing decides by the words.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import TypeVar

from unbend.errors import Code, ConfigError, Value, rendered


class Kind(StrEnum):
    """How serious a message is. ``LOSS`` and ``FINDING`` make a run end with exit code 3."""

    NOTE = "note"  # a choice made, for example which channel plays which role
    FALLBACK = "fallback"  # an allowed substitute, for example dry air without a hygrometer
    WARNING = "warning"  # the user should look, but the result stands
    FINDING = "finding"  # an input contradicts another, or what is plausible; may be accepted
    LOSS = "loss"  # data was lost, damaged, flagged, or something the config names is absent


LOSSES = (Kind.LOSS, Kind.FINDING)
"""The kinds that make a run end with exit code 3."""


@dataclass(frozen=True)
class MessageRecord:
    """A message as the manifest has it: ``what`` is its text for people, with all values."""

    kind: str
    code: str
    what: str
    where: str
    count: int = 0
    values: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Message:
    """One message about a mission.

    ``code`` is stable (``BARO-RANGE``); ``where`` a channel, file and byte offset, or column;
    ``count`` how many messages, bytes, samples or rows it is about; ``values`` what else its text
    names. ``text`` contains ``{count}``, ``{where}`` and names of values in braces. ``accepted``
    is the reason for which the mission file accepts it.
    """

    kind: Kind
    code: str
    text: str
    where: str = ""
    count: int = 0
    values: Mapping[str, Value] = field(default_factory=dict)
    accepted: str = ""

    @property
    def what(self) -> str:
        """The text for people, with all values filled in."""
        what = rendered(self.text, {"where": self.where, "count": self.count, **self.values})
        if self.accepted:
            return f"{what} (accepted: {self.accepted})"
        return what

    def record(self) -> MessageRecord:
        """The message with its text, for the manifest and the report."""
        return MessageRecord(
            kind=self.kind.value,
            code=self.code,
            what=self.what,
            where=self.where,
            count=self.count,
            values={name: _finite(value) for name, value in self.values.items()},
        )

    def row(self) -> dict[str, object]:
        """The message as plain values."""
        return asdict(self.record())


def _finite(value: Value) -> Value | None:
    """A value for the manifest, None for an infinite number and for NaN."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


Notes = tuple[Message, ...]
"""Messages that a function returns with its result, because it has no ledger."""


def message(
    kind: Kind,
    code: Code,
    text: str,
    *,
    one: str = "",
    where: str = "",
    count: int = 0,
    **values: Value,
) -> Message:
    """A message of a code; ``one`` is the text for a ``count`` of 1, where that is another.

    >>> lost = Code("GPS-LOST", means="Fixes are lost.", effect="Gaps.", remedy="See the antenna.")
    >>> said = message(
    ...     Kind.LOSS, lost, "{count} fixes of {where} are lost",
    ...     one="1 fix of {where} is lost", where="GPS[0]", count=1,
    ... )
    >>> said.what
    '1 fix of GPS[0] is lost'
    """
    if count == 1 and one:
        text = one
    return Message(kind, code.name, text, where, count, values)


note = partial(message, Kind.NOTE)
fallback = partial(message, Kind.FALLBACK)
warning = partial(message, Kind.WARNING)
finding = partial(message, Kind.FINDING)
loss = partial(message, Kind.LOSS)


Result = TypeVar("Result")


def _identity(message: Message) -> tuple[object, ...]:
    """A key for sets that two messages have in common if they are the same message."""
    values = tuple(sorted(message.values.items()))
    return message.kind, message.code, message.text, message.where, message.count, values


class Ledger:
    """All messages of a mission, each once, in the order in which they are added.

    >>> no_barometer = Code("AIR-NO-BAROMETER", means="...", effect="...", remedy="...")
    >>> ledger = Ledger()
    >>> ledger.add(fallback(no_barometer, "no static pressure outside"))
    >>> [message.code for message in ledger], ledger.has_losses
    (['AIR-NO-BAROMETER'], False)
    """

    def __init__(self, messages: Iterable[Message] = ()) -> None:
        self._messages: list[Message] = list(messages)
        self._identities = {_identity(message) for message in self._messages}

    def __iter__(self) -> Iterator[Message]:
        return iter(self._messages)

    def __len__(self) -> int:
        return len(self._messages)

    @property
    def has_losses(self) -> bool:
        """Whether a run with these messages ends with exit code 3."""
        return any(message.kind in LOSSES for message in self._messages)

    def add(self, message: Message) -> None:
        """Append a message, unless the ledger has the same message already."""
        identity = _identity(message)
        if identity not in self._identities:
            self._identities.add(identity)
            self._messages.append(message)

    def extend(self, messages: Iterable[Message]) -> None:
        """Append several messages, each unless the ledger has it already."""
        for message in messages:
            self.add(message)

    def take(self, outcome: tuple[Result, Notes]) -> Result:
        """Add the notes of an outcome (result, notes) to the ledger, and return the result.

        >>> lens = Code("LENS-IN-AIR", means="...", effect="...", remedy="...")
        >>> ledger = Ledger()
        >>> ledger.take((1.5, (note(lens, "0.3 px"),))), len(ledger)
        (1.5, 1)
        """
        result, notes = outcome
        self.extend(notes)
        return result

    def remove(self, is_removed: Callable[[Message], bool]) -> Notes:
        """Remove the messages for which a function returns True; returns these messages."""
        removed = tuple(message for message in self._messages if is_removed(message))
        self._messages = [message for message in self._messages if not is_removed(message)]
        self._identities = {_identity(message) for message in self._messages}
        return removed

    def accept(self, reasons: Mapping[str, str]) -> tuple[str, ...]:
        """Turn findings into warnings; returns the codes of ``reasons`` that no finding has.

        ``reasons`` : why the mission file accepts a finding, by the code of the finding.

        >>> ground = Code("PLAUSIBLE-GROUND", means="...", effect="...", remedy="...")
        >>> ledger = Ledger([finding(ground, "the ground is 400 m off")])
        >>> ledger.accept({"PLAUSIBLE-GROUND": "a gorge"}), ledger.has_losses
        ((), False)
        """
        unused = set(reasons)
        for row, message in enumerate(self._messages):
            if message.kind is Kind.FINDING and message.code in reasons:
                self._messages[row] = replace(
                    message, kind=Kind.WARNING, accepted=reasons[message.code]
                )
                unused.discard(message.code)
        self._identities = {_identity(message) for message in self._messages}
        return tuple(sorted(unused))

    def sorted(self) -> list[Message]:
        """The messages by kind, code, text, place and count, as the manifest has them."""

        def order(message: Message) -> tuple[str, str, str, str, int]:
            return message.kind, message.code, message.what, message.where, message.count

        return sorted(self._messages, key=order)

    def records(self) -> list[MessageRecord]:
        """The messages with their texts, sorted, for the manifest and the report."""
        return [message.record() for message in self.sorted()]

    def rows(self) -> list[dict[str, object]]:
        """The messages as plain values, sorted."""
        return [message.row() for message in self.sorted()]


PLOT_MATPLOTLIB = Code(
    "PLOT-MATPLOTLIB",
    means="A plot was asked for, and matplotlib is not installed.",
    effect="No plot is made.",
    remedy="pip install matplotlib.",
)


def matplotlib_missing() -> ConfigError:
    """A plot is asked for, and matplotlib cannot be imported."""
    return ConfigError(
        PLOT_MATPLOTLIB,
        "plots need matplotlib, which is not installed",
        remedy="pip install matplotlib",
    )
