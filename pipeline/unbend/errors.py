"""Refusals: what is wrong, where, and what to do about it.

Each has a stable code and an exit code. A refusal is for the user; all else that escapes is a bug.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from typing import Self, TypeVar

from unbend.exit_codes import EXIT_CONFIG, EXIT_IN_USE, EXIT_REFUSED, EXIT_STORAGE


@cache
def texts() -> Mapping[str, Mapping[str, str]]:
    """The texts of ``unbend/texts.toml`` by key: ``what``, and of a refusal its ``remedy``."""
    return tomllib.loads(files("unbend").joinpath("texts.toml").read_text("utf-8"))


_NOUNS = (
    "angle|band|bin|boot|byte|camera|cell|character|chunk|column|definition|degree|element|event|"
    "exposure|field|file|fix|frame|gap|hour|image|layer|level|line|message|minute|mission|node|pixel|"
    "observation|pair|parameter|place|point|position|profile|pulse|quaternion|raster|ray|value|"
    "reading|receiver|reconstruction|record|result|row|sample|second|sounding|station|time|trigger|"
    "window|calibration|name|number|solution|deviation|measurement|key"
)
_BEFORE = "bad|control|different|image|known|more|object|observed|sensor|shutter|standard|tie"
_VERBS = {"are": "is", "were": "was", "have": "has", "do": "does", "carry": "carries"}
_ONE = re.compile(
    rf"(?<![\w.,:/])(?<!\w-)1(?:( (?:(?:{_BEFORE}) )*(?:{_NOUNS}))s\b(?!\.\w)|(?<![\w)] 1))"
    rf"( (?:{'|'.join(_VERBS)}|lie|follow|find|come)\b)?"
)


def in_agreement(text: str) -> str:
    """A text with what follows a 1 in the singular: texts are written for several.

    >>> print(in_agreement("1 exposures have no fix, 11 rows, 1 image points are 1 m from them"))
    1 exposure has no fix, 11 rows, 1 image point is 1 m from them
    """

    def singular(found: re.Match[str]) -> str:
        verb = (found[2] or "")[1:]
        return f"1{found[1] or ''}" + (f" {_VERBS.get(verb, verb + 's')}" if verb else "")

    return _ONE.sub(singular, text)


class Counted(int):
    """A number that is written with its noun; in files it is the number.

    >>> f"{Counted(1, 'image')} of {Counted(2, 'strip')}, {Counted(0, 'axis', 'axes')}"
    '1 image of 2 strips, 0 axes'
    """

    noun: str

    def __new__(cls, number: int, one: str, many: str = "") -> Self:
        counted = super().__new__(cls, number)
        counted.noun = one if number == 1 else many or f"{one}s"
        return counted

    def __getnewargs__(self) -> tuple[int, str, str]:  # type: ignore[override]
        return int(self), self.noun, self.noun

    def __str__(self) -> str:
        return f"{int(self)} {self.noun}"

    def __format__(self, spec: str) -> str:
        return f"{int(self):{spec}} {self.noun}"


Value = object
"""What a text of a message names: str, int or float, once all rooms have their messages."""


@dataclass(frozen=True)
class Code:
    """A stable code of messages and refusals, and what ``unbend help CODE`` says of it.

    ``means`` what happened, ``effect`` what it does to the result, ``remedy`` what to do.
    """

    name: str
    means: str
    effect: str
    remedy: str


def rendered(text: str, values: Mapping[str, Value]) -> str:
    """A text with the values filled in for the names in its braces; values stay as they are.

    >>> rendered("{count} images of {name!r}", {"count": 2, "name": "strip {1}"})
    "2 images of 'strip {1}'"
    """
    return text.format_map(values)


Refusal = TypeVar("Refusal", bound="UnbendError")


class UnbendError(Exception):
    """A refusal: its code, what is wrong with its numbers, where, and what to do.

    ``text`` and ``remedy`` hold the names of ``values``, ``where`` and ``count`` in braces; ``one``
    is the text for a count of 1, where that is another. Made by the functions of ``messages.py``
    in each room.

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
        if isinstance(code, str):  # a text as it is, until all rooms have their messages
            self.code = code
            self.what = in_agreement(text)
            self.remedy = remedy
        else:
            text = one if count == 1 and one else text
            names = {"where": self.where, "count": count, **values}
            self.code = code.name
            self.what = rendered(text, names)
            self.remedy = rendered(remedy, names)
        super().__init__(self.code, self.what, self.where, self.remedy)

    @classmethod
    def of(cls, key: str, where: object = "", **values: object) -> Self:
        """The refusal with the texts of a key (CODE or CODE/word), the values filled in."""
        text, code = texts()[key], key.partition("/")[0]
        what, remedy = (text.get(part, "").format_map(values) for part in ("what", "remedy"))
        return cls(code, what, where=str(where), remedy=remedy)

    def again(self, kind: "type[Refusal]", where: object) -> "Refusal":
        """The same refusal of another kind, at another place."""
        refusal = kind(self.code, self.what, where=where, count=self.count, remedy=self.remedy)
        refusal.what = self.what
        refusal.values = self.values
        return refusal

    def __reduce__(self) -> tuple[object, ...]:
        again = partial(type(self), where=self.where, remedy=self.remedy)
        return again, (self.code, self.what), {"count": self.count, "values": self.values}

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


@contextmanager
def storage_errors(path: object) -> Iterator[None]:
    """Raise an error of the operating system as StorageError (STORAGE-WRITE)."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            "STORAGE-WRITE",
            f"{error.strerror or error}",
            where=str(error.filename or path),
            remedy="free space or mend permissions, then run again: finished missions are kept",
        ) from None
