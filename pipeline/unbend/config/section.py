"""The base class of all sections of a mission file, and types of values that they share."""

import re
from collections.abc import Callable, Collection, Iterator
from pathlib import PurePath
from typing import Annotated, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    field_validator,
)

from unbend.tables.imports.blocks import BLOCKS
from unbend.units import LARGEST_NUMBER

LONGEST_PATH = 4096  # bytes that operating systems allow
LONGEST_FILE_NAME = 255  # bytes that file systems allow; looking for a longer name is an error

Value = TypeVar("Value")


def _checked_path(value: str) -> str:
    """Check the length of a path and return it as it is; a URL may have any length."""
    if "://" in value:
        return value
    names = re.split(r"[/\\]", value)  # Windows writes both
    longest_name = max(len(name.encode()) for name in names)
    if len(value.encode()) > LONGEST_PATH or longest_name > LONGEST_FILE_NAME:
        raise SectionError("is longer than a path can be")
    return value


PathText = Annotated[str, Field(min_length=1, pattern=r"^[^\x00]+$"), AfterValidator(_checked_path)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
LONGEST_ARM_M = 50  # along an axis: more than half the length or the span of any aircraft
LeverArm = Annotated[
    list[Annotated[float, Field(ge=-LONGEST_ARM_M, le=LONGEST_ARM_M)]],
    Field(min_length=3, max_length=3),
]
Hectopascal = Annotated[float, Field(ge=100, le=1200)]
Celsius = Annotated[float, Field(ge=-60, le=60)]


def one_of(names: Callable[[], Collection[str]]) -> AfterValidator:
    """A validator that refuses values which are not among the names.

    The names are those that ``names`` returns when a mission file is read.
    """

    def check(value: str) -> str:
        if value not in names():
            raise SectionError(f"{value!r} is not valid; choose {', '.join(names())}")
        return value

    return AfterValidator(check)


def is_block(value: object) -> bool:
    """Whether a format is that of a block: a project of another program with its cameras."""
    return isinstance(value, str) and value in BLOCKS


def _numbers_in(value: object) -> Iterator[float]:
    """The number that a value is, or the numbers in a list and in lists inside it."""
    if isinstance(value, int | float):
        yield value
    elif isinstance(value, list):
        for item in value:
            yield from _numbers_in(item)


class Section(BaseModel):
    """A part of the mission file: strict types, no unknown keys, no NaN."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )

    @field_validator("*")
    @classmethod
    def _check_numbers(cls, value: Value) -> Value:
        """Refuse numbers that are larger than any measured value: calculations would overflow."""
        for number in _numbers_in(value):
            if abs(number) > LARGEST_NUMBER:
                raise SectionError(f"contains a number beyond {LARGEST_NUMBER:g}")
        return value

    def __copy__(self) -> Self:
        """A copy without cached properties: `model_copy` may change the keys that they follow."""
        copied = super().__copy__()
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


class SectionError(ValueError):
    """What a validator of a section refuses: a value, or values that do not go together.

    ``key`` is the key of the validated section where the mistake is; empty for the section itself.
    ``at`` are the keys from there to the one with the line that is shown. They are not shown: the
    text names them.
    """

    def __init__(self, text: str, *, key: str = "", at: tuple[str | int, ...] = ()) -> None:
        super().__init__(text)
        self.at = at
        self.key = key


ENDINGS_OF_FILES = (
    ".csv",
    ".tsv",
    ".txt",
    ".parquet",
    ".json",
    ".geojson",
    ".gpkg",
    ".html",
    ".xml",
    ".yaml",
    ".yml",
    ".xlsx",
    ".zip",
    ".pdf",
)
"""Endings that the name of a folder of results does not have."""


def folder_of_results(path: str) -> str:
    """Check the path of a folder of results and return it; raises SectionError for a file."""
    ending = PurePath(path).suffix
    if ending.lower() in ENDINGS_OF_FILES:
        folder = path.rstrip("/").removesuffix(ending)
        raise SectionError(
            f"{path!r} is the name of a file, and a run writes a folder of tables and a report: "
            f"write {folder!r}; `unbend export` then writes single files"
        )
    return path


FolderOfResults = Annotated[PathText, AfterValidator(folder_of_results)]
