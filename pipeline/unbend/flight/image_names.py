"""Names of images: what they differ in, and the pattern of those that differ in one number."""

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from unbend.errors import MissionError
from unbend.messages import Notes, note
from unbend.units import Names

Difference = Literal["case", "extension", "folder", "digits"]
DIFFERENCES: tuple[Difference, ...] = ("case", "extension", "folder", "digits")


def without_differences(name: str, differences: Collection[str]) -> str:
    """What is left of a name without its case, extension, folder, zeros and marks before digits.

    >>> without_differences("left/DSC_0001.JPG", DIFFERENCES)
    'dsc#1'
    >>> without_differences("DSC1.jpg", ["digits", "extension"])
    'DSC#1'
    """
    if "folder" in differences:
        name = re.split(r"[\\/]", name)[-1]
    if "extension" in differences:
        name = re.sub(r"\.(?=\w*[A-Za-z])\w{1,5}$", "", name)
    if "digits" in differences:
        name = re.sub(r"(?:^|[ _-]+|(?<=\D))0*(\d+)", r"#\1", name)
    return name.casefold() if "case" in differences else name


def other_names(
    images: Iterable[str], known: Iterable[str], differences: Collection[str]
) -> dict[str, str]:
    """``known`` names -> ``images`` they are but for the differences; one to one, no exact ones.

    Two names that become one are no match for anything.

    >>> other_names(["A_01.tif", "b.tif"], ["a_1.tif", "b.tif"], ["case", "digits"])
    {'a_1.tif': 'A_01.tif'}
    """
    images, known = set(images), set(known)
    exact = images & known
    left: list[dict[str, str]] = []
    for names in (images - exact, known - exact):
        plain = {name: without_differences(name, differences) for name in sorted(names)}
        count = Counter(plain.values())
        left.append({text: name for name, text in plain.items() if count[text] == 1})
    return {name: left[0][text] for text, name in left[1].items() if text in left[0]}


def renamed(
    names: Names, images: Iterable[str], differences: Collection[str], where: str
) -> tuple[Names, Notes]:
    """Names as the observations have them, by the differences that the mission file allows."""
    other = other_names(images, filter(None, names.tolist()), differences) if differences else {}
    if not other:
        return names, ()
    name, image = next(iter(other.items()))
    what = f"{len(other)} names are those of images of the observations but for "
    what += f"{' and '.join(differences)}: {name!r} is {image!r}"
    entry = note("IMAGES-RENAMED", what, where=where, count=len(other))
    return np.array([other.get(name, name) for name in names.tolist()], object), (entry,)


def proposal(images: Collection[str], known: Collection[str]) -> str:
    """How many images the fewest differences would match, for a message; empty where none."""
    tried = [
        (other_names(images, known, differences), differences)
        for size in range(1, len(DIFFERENCES) + 1)
        for differences in combinations(DIFFERENCES, size)
    ]
    found, differences = max(tried, key=lambda pair: len(pair[0]))  # the first, fewest, of equals
    if not found:
        return ""
    name, image = next(iter(found.items()))
    key = f"observations.match_names: [{', '.join(differences)}]"
    return f"{len(found)} of them would have one with {key}, as {image!r} that of {name!r}"


def refuse_other_names(exposures: Mapping[str, Collection[str]], images: Iterable[str]) -> None:
    """Refuse (MissionError IMAGES-OTHER) a camera of whose exposures none is an observed image.

    ``exposures`` : by camera, their names. Only where half as many observed images as a camera has
    exposures are without any: it may be that nothing was measured in the images of that camera.
    """
    observed = set(images)
    unknown = sorted(observed.difference(*exposures.values()))
    for camera, names in exposures.items():
        if not unknown or 2 * len(unknown) < len(names) or observed & set(names):
            continue
        near = proposal(unknown, names)
        called = f", which are called like {next(iter(names))!r}" if names else ""
        more = called + (f"; {near}" if near else "")
        raise MissionError.of(
            "IMAGES-OTHER/camera", f"observations, {camera}", unknown=len(unknown),
            image=unknown[0], exposures=len(names), camera=camera, more=more,
        )  # fmt: skip


_MOST_SERIES = 12
_OF_ANY_CAMERA = {"dsc", "dscf", "img", "image", "dji", "photo", "p", "pic", "frame", "cap", ""}


@dataclass(frozen=True)
class NameSeries:
    """Images whose names differ in one number, and where ``before`` has a ``*`` in other digits.

    ``width`` : digits of the number, 0 where they are not padded. ``numbers`` : of all images, in
    rising order. ``has_number`` is False where the names have none.
    """

    before: str
    width: int
    after: str
    numbers: tuple[int, ...]
    has_number: bool = True

    def pattern(self, field: str) -> str:
        """The pattern of a mission file, for example ``DSC_{index:04d}.tif``; ``*`` for any.

        >>> NameSeries("DSC_", 4, ".tif", (7, 8)).pattern("index")
        'DSC_{index:04d}.tif'
        """
        before, after = (t.replace("{", "{{").replace("}", "}}") for t in (self.before, self.after))
        digits = f":0{self.width}d" if self.width else ""
        return f"{before}{'*' if field == '*' else f'{{{field}{digits}}}'}{after}"

    @property
    def camera(self) -> str:
        """What the names call their camera: the word before the number, or the folder; or empty."""
        *folders, word = re.split(r"[\\/]", self.before)
        for name in (word, *reversed(folders)):
            plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()
            if plain not in _OF_ANY_CAMERA and not plain.isdigit():
                return plain
        return ""

    def counts_as(self, index: Collection[int]) -> bool:
        """Whether the numbers may be those of a log: none is missing at either end, none is new."""
        of_log, mine = set(index), set(self.numbers)
        once = len(mine) == len(self.numbers) and len(of_log) == len(index)
        if not (self.has_number and once and mine and mine <= of_log):
            return False
        return min(mine) == min(of_log) and max(mine) == max(of_log)

    def listed(self, numbers: tuple[int, ...]) -> str:
        """The names of images, the first three of them; ``*`` where other digits differ."""
        names = [self.pattern("index").format(index=number) for number in numbers[:3]]
        return ", ".join(names) + " ..." * (len(numbers) > 3)

    def strays(self, index: Collection[int]) -> tuple[int, ...]:
        """Few numbers far from a log's, beside which all others may be the log's; else none.

        Numbers that go on where the log's end (1 to 29 for 28 events) rather show a lost event.
        """
        first, last = min(index, default=0), max(index, default=0)
        reach = last - first + 1
        far = tuple(n for n in self.numbers if not first - reach <= n <= last + reach)
        rest = replace(self, numbers=tuple(n for n in self.numbers if n not in far))
        return far if 10 * len(far) <= len(self.numbers) and rest.counts_as(index) else ()


def name_series(names: Iterable[str]) -> list[NameSeries]:
    """The series of some names, the largest first.

    Digits that differ between few groups of images (a head, a folder) part them into several
    series; digits that differ from image to image beside the count (a time) become ``*``.

    >>> [s.pattern("n") for s in name_series(["cam1/a_01.jpg", "cam1/a_02.jpg", "cam2/a_01.jpg"])]
    ['cam1/a_{n:02d}.jpg', 'cam2/a_{n:02d}.jpg']
    """
    shapes: defaultdict[tuple[str, ...], list[list[str]]] = defaultdict(list)
    for name in sorted(set(names)):
        parts = re.split(r"(\d+)", name)
        shapes[tuple(parts[::2])].append(parts[1::2])
    found = [series for texts, rows in shapes.items() for series in _series(texts, rows)]
    return sorted(found, key=lambda series: (-len(series.numbers), series.before))


def _series(texts: tuple[str, ...], rows: list[list[str]]) -> list[NameSeries]:
    """The series of names of the same texts, whose digits are ``rows`` (one a name)."""
    if not rows[0]:
        stem, dot, ending = texts[0].rpartition(".")
        return [NameSeries(stem if dot else ending, 0, dot + ending if dot else "", (0,), False)]
    values = [set(column) for column in zip(*rows, strict=True)]
    # Of digits that differ alike the last count the images.
    count = max(range(len(values)), key=lambda k: (len(values[k]), k))
    others = [k for k in range(len(values)) if k != count and len(values[k]) > 1]
    groups: defaultdict[tuple[str, ...], list[list[str]]] = defaultdict(list)
    for row in rows:
        groups[tuple(row[k] for k in others)].append(row)
    if others and len(groups) <= _MOST_SERIES and 2 * len(groups) <= len(rows) + 1:
        return [series for group in groups.values() for series in _series(texts, group)]
    written = ["*" if k in others else rows[0][k] for k in range(len(values))]
    digits = [row[count] for row in rows]
    pieces = [text for pair in zip(texts, [*written, ""], strict=True) for text in pair]
    before, after = "".join(pieces[: 2 * count + 1]), "".join(pieces[2 * count + 2 :])
    width = len(digits[0]) if len({len(text) for text in digits}) == 1 else 0
    return [NameSeries(before, width * (width > 1), after, tuple(sorted(map(int, digits))))]
