"""The images of each camera, by a pattern of their names, and the numbers in these names."""

import re
import string
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unbend.tables.imports.exif import ImageTimes
from unbend.units import Integers, Names

FIELDS = {"index": "index", "n": "counted"}
"""What the numbers in names count, by the field of the pattern (see `CameraImages.number`)."""


@dataclass(frozen=True, eq=False)
class CameraImages:
    """The images of one camera, (k,).

    number : the number in each name.
    numbering : what the number counts: ``index``: events, as the log numbers them; ``counted``:
        events from the first one on; ``sequence``: the images themselves.
    file : the row of each image in the table of image files, -1 without a file.
    """

    name: Names
    number: Integers
    numbering: str
    file: Integers


class DescribedImage(NamedTuple):
    """An image with a name that a pattern describes.

    row : the row of its file, -1 without a file.
    values : the digits of each field of the pattern in the name, as ``{"index": "0042"}``.
    """

    name: str
    row: int
    values: dict[str, str]


@dataclass(frozen=True)
class NamePattern:
    """A pattern of names, such as ``IMG_{index:04d}.JPG``, as regular expressions.

    whole : matches names as the pattern writes them.
    stem : also matches names with another ending or none, and ignores case.
    fields : names of the fields of the pattern, in their order.
    """

    pattern: str
    whole: re.Pattern[str]
    stem: re.Pattern[str]
    fields: tuple[str, ...]

    @classmethod
    def of(cls, pattern: str) -> "NamePattern":
        """The regular expressions of a pattern; ``*`` in it matches any text."""
        text = ""
        fields: list[str] = []
        for part in string.Formatter().parse(pattern):
            literal, field = part[:2]
            text += re.escape(literal).replace(re.escape("*"), ".*")
            if field is None:
                continue
            if field in fields:
                text += r"\d+"  # an expression cannot have two groups of one name
            else:
                text += rf"(?P<{field}>\d+)"
            fields.append(field)
        without_ending = re.sub(r"\\\.\w+$", "", text)
        any_ending = r"(\.\w+)?"
        return cls(
            pattern,
            whole=re.compile(text),
            stem=re.compile(without_ending + any_ending, re.IGNORECASE),
            fields=tuple(fields),
        )

    def name_of(self, path: str, values: dict[str, str]) -> str:
        """The name of an image without observations: the pattern with the value of its field.

        If the pattern has a ``*``, or not exactly one field, it does not give the name: then it is
        the ``path`` of the file. ``values`` are the digits of each field.
        """
        if "*" in self.pattern or len(set(self.fields)) != 1:
            return path
        numbers = {field: int(digits) for field, digits in values.items()}
        return self.pattern.format(**numbers)


def images_of_camera(
    pattern: str, observed: tuple[str, ...], files: ImageTimes | None
) -> CameraImages:
    """The images with names that a pattern describes, in the order of their names.

    They are ``observed`` images, and image files in which nothing was measured. If the pattern has
    no field for a number, the numbers are those of `count_of_camera`.
    """
    name_pattern = NamePattern.of(pattern)
    images = described_images(name_pattern, observed, files)
    images.sort(key=lambda image: sorting_key(image.name))
    name = np.array([image.name for image in images], object)
    file = np.array([image.row for image in images], np.int64)
    for field, numbering in FIELDS.items():
        if field in name_pattern.fields:
            numbers = [int(image.values[field]) for image in images]
            number = np.array(numbers, np.int64)
            return CameraImages(name, number, numbering, file)
    return CameraImages(name, count_of_camera(name), "sequence", file)


def described_images(
    name_pattern: NamePattern, observed: tuple[str, ...], files: ImageTimes | None
) -> list[DescribedImage]:
    """The images that a pattern describes: observed images first, then files without observations.

    The pattern has to match the name of an observed image, or the path of its file (in any case,
    with any ending). For other files it has to match the path, or its part after the last "/".
    """
    paths: list[str] = []
    row_of_image: Mapping[str, int] = {}
    if files is not None:
        paths = files.file.tolist()
        row_of_image = files.rows_of(observed)
    images = []
    for name in observed:
        row = row_of_image.get(name, -1)
        match = name_pattern.whole.fullmatch(name)
        if match is None and row >= 0:
            match = name_pattern.stem.fullmatch(paths[row])
        if match is not None:
            images.append(DescribedImage(name, row, match.groupdict()))
    all_rows = range(len(paths))
    unmeasured = set(all_rows) - set(row_of_image.values())
    for row in sorted(unmeasured):
        path = paths[row]
        match = name_pattern.stem.fullmatch(path)
        if match is None:
            last_part = path.rpartition("/")[2]
            match = name_pattern.stem.fullmatch(last_part)
        if match is not None:
            values = match.groupdict()
            name = name_pattern.name_of(path, values)
            images.append(DescribedImage(name, row, values))
    return images


def sorting_key(name: str) -> list[str]:
    """The parts of a name, digits with leading zeros, so that names are sorted by their numbers.

    >>> sorted(["a10", "a9"], key=sorting_key)
    ['a9', 'a10']
    """
    parts = re.split(r"(\d+)", name)
    return [part.zfill(20) for part in parts]


def count_of_camera(names: Names) -> Integers:
    """(k,) the camera's count in sorted names: the group of digits with most different values.

    Of groups with equally many values it is the last one in the name. The names are numbered from 0
    if that group does not rise from name to name, if names have different numbers of groups, or if
    they have none.
    """
    from_zero = np.arange(names.size, dtype=np.int64)
    groups = [re.findall(r"\d{1,15}", name) for name in names]
    group_counts = {len(group) for group in groups}
    if len(group_counts) != 1 or not groups[0]:
        return from_zero
    numbers_of_names = np.array(groups).astype(np.int64)
    last_group_first = numbers_of_names.T[::-1]  # a row for each group
    varieties = [np.unique(numbers).size for numbers in last_group_first]
    count = last_group_first[np.argmax(varieties)]  # the first of equals
    is_rising = bool((np.diff(count) > 0).all())
    return count if is_rising else from_zero
