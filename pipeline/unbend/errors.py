"""Refusals: what is wrong, where, and what to do about it.

Each has a stable code and an exit code. A refusal is for the user; all else that escapes is a bug.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Self, TypeVar

from unbend.exit_codes import EXIT_CONFIG, EXIT_IN_USE, EXIT_REFUSED, EXIT_STORAGE


class Counted(int):
    """A number that is shown with its noun in texts, in the singular or the plural.

    Written as JSON it is the number alone.

    >>> f"{Counted(1, 'image')} of {Counted(2, 'strip')}, {Counted(0, 'axis', 'axes')}"
    '1 image of 2 strips, 0 axes'
    """

    noun: str

    def __new__(cls, number: int, singular: str, plural: str = "") -> Self:
        """``plural``: where it is not the singular with an s."""
        counted = super().__new__(cls, number)
        counted.noun = singular if number == 1 else plural or f"{singular}s"
        return counted

    def __getnewargs__(self) -> tuple[int, str, str]:  # type: ignore[override]
        return int(self), self.noun, self.noun

    def __str__(self) -> str:
        return f"{int(self)} {self.noun}"

    def __format__(self, spec: str) -> str:
        return f"{int(self):{spec}} {self.noun}"


Value = str | int | float
"""A value that is filled into the text of a message."""


@dataclass(frozen=True)
class Code:
    """A stable code of messages and refusals, and what ``unbend help CODE`` says of it.

    ``means`` what happened, ``effect`` what it does to the result, ``remedy`` what to do.
    """

    name: str
    means: str
    effect: str
    remedy: str


LONGEST_WORD = 1000  # characters without a blank: a path may have them, a damaged field has more
SHOWN_OF_WORD = 60  # characters of the beginning of a longer one
LONGEST_TEXT = 20_000  # characters of a text: a hundred mistakes of a mission file have fewer
_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD},}}|\s{{{LONGEST_WORD},}}")


def rendered(text: str, values: Mapping[str, Value]) -> str:
    """A text with values filled in for the names in its braces; braces inside a value stay.

    A word of `LONGEST_WORD` characters or more, as from a damaged file, is cut to its first
    `SHOWN_OF_WORD`; the result is cut to `LONGEST_TEXT`, and the number of cut characters added.

    >>> rendered("{count} images of {name!r}", {"count": 2, "name": "strip {1}"})
    "2 images of 'strip {1}'"
    """
    filled = text.format_map(values)
    short = _LONG_WORD.sub(lambda word: f"{word[0][:SHOWN_OF_WORD]}...", filled)
    excess = len(short) - LONGEST_TEXT
    if excess > 0:
        short = f"{short[:LONGEST_TEXT]}... ({excess:,} more characters)"
    return short


Refusal = TypeVar("Refusal", bound="UnbendError")


class UnbendError(Exception):
    """A refusal: its code, what is wrong (``what``), where, and what to do about it.

    ``text`` and ``remedy`` contain ``{where}``, ``{count}`` and the names of ``values`` in braces;
    ``one`` is the text for a count of 1, if it differs. The functions of ``messages.py`` in each
    package make refusals.

    >>> empty = Code("LOG-EMPTY", means="A log has no bytes.", effect="None.", remedy="Copy it.")
    >>> print(LogError(empty, "the file has {n} bytes", where="a.bin", remedy="copy it again", n=0))
    LOG-EMPTY: the file has 0 bytes
      where: a.bin
      to do: copy it again
    """

    exit_code = EXIT_REFUSED

    def __init__(
        self,
        code: Code | str,
        text: str,
        *,
        one: str = "",
        where: object = "",
        count: int = 0,
        remedy: str = "",
        **values: Value,
    ) -> None:
        self.where = str(where)
        self.count = count
        self.values = values
        if isinstance(code, str):  # a copy of a refusal: its texts are complete
            self.code = code
            self.what = text
            self.remedy = remedy
        else:
            text = one if count == 1 and one else text
            names = {"where": self.where, "count": count, **values}
            self.code = code.name
            self.what = rendered(text, names)
            self.remedy = rendered(remedy, names)
        super().__init__(self.code, self.what, self.where, self.remedy)

    def as_kind(self, kind: "type[Refusal]", *, where: object) -> "Refusal":
        """A copy of the refusal as another class of error, at another place."""
        refusal = kind(self.code, self.what, where=where, count=self.count, remedy=self.remedy)
        refusal.what = self.what
        refusal.values = self.values
        return refusal

    def __reduce__(self) -> tuple[object, ...]:
        """How pickle copies a refusal: by its texts as they are, then ``count`` and ``values``."""
        copy = partial(type(self), where=self.where, remedy=self.remedy)
        return copy, (self.code, self.what), {"count": self.count, "values": self.values}

    def __str__(self) -> str:
        lines = [f"{self.code}: {self.what}"]
        if self.where:
            lines.append(f"  where: {self.where}")
        if self.remedy:
            lines.append(f"  to do: {self.remedy}")
        return "\n".join(lines)


class ConfigError(UnbendError):
    """The command line or the mission file asks for what cannot be done."""

    exit_code = EXIT_CONFIG


class LogError(UnbendError):
    """A flight log cannot be used."""


class InputError(UnbendError):
    """A table of observations, events or points cannot be used."""


class MissionError(UnbendError):
    """What the inputs hold does not allow this mission to be processed."""


class PhysicsError(UnbendError, ValueError):
    """A scalar call was given values outside the range of a formula."""

    exit_code = EXIT_CONFIG


class OutputInUseError(UnbendError):
    """Another process is writing to the output folder."""

    exit_code = EXIT_IN_USE


class StorageError(UnbendError):
    """The disk refused, or results on it are damaged."""

    exit_code = EXIT_STORAGE


STORAGE_WRITE = Code(
    "STORAGE-WRITE",
    means="The system refused to write: no space, or no permission.",
    effect="Finished missions are kept (exit code 5).",
    remedy="Free space or correct the permissions, then run again.",
)


def not_written(error: OSError, path: object) -> StorageError:
    """The system refuses to write the file that the error names, or else ``path``."""
    return StorageError(
        STORAGE_WRITE,
        "{answer}",
        where=error.filename or path,
        remedy="free space or correct permissions, then run again: finished missions are kept",
        answer=error.strerror or str(error),
    )


@contextmanager
def storage_errors(path: object) -> Iterator[None]:
    """Raise an error of the operating system as StorageError (STORAGE-WRITE)."""
    try:
        yield
    except OSError as error:
        raise not_written(error, path) from None
