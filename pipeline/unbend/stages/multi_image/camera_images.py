"""The images of each camera, by a pattern of their names, and the numbers in these names."""

import re
import string
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unbend.tables.imports.exif import ImageTimes
from unbend.units import Integers, Names

FIELDS = {"index": "index", "n": "counted"}
"""How images are numbered by the fields of a pattern: by the log's numbers, or counted."""


@dataclass(frozen=True, eq=False)
class CameraImages:
    """The images of one camera, (k,): names, numbers in them, rows of their files (-1 without)."""

    name: Names
    number: Integers
    numbering: str
    file: Integers


class FoundImage(NamedTuple):
    """An image that a pattern describes, with the row of its file and what its fields hold."""

    name: str
    row: int
    values: dict[str, str]


@dataclass(frozen=True)
class NamePattern:
    """A pattern of names, such as ``IMG_{index:04d}.JPG``, as regular expressions.

    ``stem`` leaves the ending open; ``fields`` are those of the pattern in their order.
    """

    pattern: str
    whole: re.Pattern[str]
    stem: re.Pattern[str]
    fields: tuple[str, ...]

    @classmethod
    def of(cls, pattern: str) -> "NamePattern":
        """The expressions of a pattern; ``*`` stands for anything."""
        text = ""
        fields: list[str] = []
        for literal, field, _, _ in string.Formatter().parse(pattern):
            text += ".*".join(re.escape(part) for part in literal.split("*"))
            if field is None:
                continue
            text += r"\d+" if field in fields else rf"(?P<{field}>\d+)"
            fields.append(field)
        without_ending = re.sub(r"\\\.\w+$", "", text)
        stem = re.compile(without_ending + r"(\.\w+)?", re.IGNORECASE)
        return cls(pattern, re.compile(text), stem, tuple(fields))

    def name_of(self, path: str, values: dict[str, str]) -> str:
        """The name of an image that is not observed, by its file."""
        if "*" in self.pattern or len(set(self.fields)) != 1:
            return path
        return self.pattern.format(**{key: int(value) for key, value in values.items()})


def images_of_camera(
    pattern: str, observed: tuple[str, ...], files: ImageTimes | None
) -> CameraImages:
    """Images of the observations, and files without any, that a pattern describes, in their order.

    Where it has no number, the digits that differ most are the camera's count.
    """
    names = NamePattern.of(pattern)
    found = described_images(names, observed, files)
    found.sort(key=lambda image: sorting_key(image.name))
    name = np.array([image.name for image in found], object)
    file = np.array([image.row for image in found], np.int64)
    for field, numbering in FIELDS.items():
        if field in names.fields:
            number = np.array([int(image.values[field]) for image in found], np.int64)
            return CameraImages(name, number, numbering, file)
    return CameraImages(name, count_of_camera(name), "sequence", file)


def described_images(
    names: NamePattern, observed: tuple[str, ...], files: ImageTimes | None
) -> list[FoundImage]:
    """The images that a pattern describes: observed ones first, then files of no observed image."""
    paths: list[str] = [] if files is None else files.file.tolist()
    row_of = {} if files is None else files.rows_of(observed)
    found = []
    for image in observed:
        row = row_of.get(image, -1)
        match = names.whole.fullmatch(image)
        if match is None and row >= 0:
            match = names.stem.fullmatch(paths[row])
        if match is not None:
            found.append(FoundImage(image, row, match.groupdict()))
    for row in sorted(set(range(len(paths))) - set(row_of.values())):
        path = paths[row]
        match = names.stem.fullmatch(path) or names.stem.fullmatch(path.rpartition("/")[2])
        if match is not None:
            name = names.name_of(path, match.groupdict())
            found.append(FoundImage(name, row, match.groupdict()))
    return found


def sorting_key(name: str) -> list[str]:
    """Digits with leading zeros, so that names are sorted by their numbers.

    >>> sorted(["a10", "a9"], key=sorting_key)
    ['a9', 'a10']
    """
    return [text.zfill(20) for text in re.split(r"(\d+)", name)]


def count_of_camera(names: Names) -> Integers:
    """(k,) the camera's count in sorted names: the digits that differ most, if they rise."""
    count = np.arange(names.size, dtype=np.int64)
    groups = [re.findall(r"\d{1,15}", name) for name in names]
    sizes = {len(group) for group in groups}
    if len(sizes) != 1 or not groups[0]:
        return count
    columns = np.array(groups).astype(np.int64).T[::-1]
    different = [np.unique(column).size for column in columns]
    most = columns[np.argmax(different)]
    return most if bool((np.diff(most) > 0).all()) else count
