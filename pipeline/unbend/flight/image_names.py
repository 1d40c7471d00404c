"""Names of images: what they differ in, and the pattern of those that differ in one number."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from unbend.flight import messages
from unbend.messages import Notes
from unbend.units import Names

Difference = Literal["case", "extension", "folder", "digits"]
DIFFERENCES: tuple[Difference, ...] = ("case", "extension", "folder", "digits")

# The parts of a name: texts, and the groups of digits between them.
_Texts = tuple[str, ...]
_Digits = list[str]


def composed(name: str) -> str:
    """A name with its characters composed (Unicode NFC), as most systems but macOS write them.

    >>> composed("A\u0308.jpg") == "\u00c4.jpg"
    True
    """
    return unicodedata.normalize("NFC", name)


def without_differences(name: str, differences: Collection[str]) -> str:
    """A name without the listed differences: case, extension, folder, marks before digits.

    ``differences`` : which of these are taken away. In front of each group of digits, one ``#``
    replaces its zeros, blanks, hyphens and underscores, or is added where there are none.
    Characters come composed: file systems differ in that.

    >>> without_differences("left/DSC_0001.JPG", DIFFERENCES)
    'dsc#1'
    >>> without_differences("DSC1.jpg", ["digits", "extension"])
    'DSC#1'
    """
    name = composed(name)
    if "folder" in differences:
        name = re.split(r"[\\/]", name)[-1]
    if "extension" in differences:
        # An extension has a letter: what follows the point of "strip.0001" is a number.
        name = re.sub(r"\.(?=\w*[A-Za-z])\w{1,5}$", "", name)
    if "digits" in differences:
        name = re.sub(r"(?:^|[ _-]+|(?<=\D))0*(\d+)", r"#\1", name)
    return name.casefold() if "case" in differences else name


def images_by_name(
    images: Iterable[str], known: Iterable[str], differences: Collection[str]
) -> dict[str, str]:
    """Match ``known`` names to ``images`` that have the same name but for the differences.

    Returns the image of each known name that has exactly one match. Names that are equal are left
    out, and so are names that the differences make equal to another one.

    >>> images_by_name(["A_01.tif", "b.tif"], ["a_1.tif", "b.tif"], ["case", "digits"])
    {'a_1.tif': 'A_01.tif'}
    """
    images = set(images)
    known = set(known)
    exact = images & known
    image_by_short_name = _by_short_name(images - exact, differences)
    known_by_short_name = _by_short_name(known - exact, differences)
    matches: dict[str, str] = {}
    for short_name, name in known_by_short_name.items():
        if short_name in image_by_short_name:
            matches[name] = image_by_short_name[short_name]
    return matches


def _by_short_name(names: Collection[str], differences: Collection[str]) -> dict[str, str]:
    """Each name by its form `without_differences`; without names that share that form."""
    names_by_short_name: defaultdict[str, list[str]] = defaultdict(list)
    for name in sorted(names):
        short_name = without_differences(name, differences)
        names_by_short_name[short_name].append(name)
    only_names: dict[str, str] = {}
    for short_name, names_of_form in names_by_short_name.items():
        if len(names_of_form) == 1:
            only_names[short_name] = names_of_form[0]
    return only_names


def renamed_like_images(
    names: Names,
    images: Iterable[str],
    differences: Collection[str],
    where: str,
) -> tuple[Names, Notes]:
    """Names of exposures, with those that match an observed image replaced by the image's name.

    ``images`` are observed; they may differ from ``names`` by the ``differences`` that the mission
    file allows, and in composed characters. A note says how many names were replaced.
    """
    all_names = names.tolist()
    given = [name for name in all_names if name]
    matches = images_by_name(images, given, differences)
    if not matches:
        return names, ()
    example, its_image = next(iter(matches.items()))
    message = messages.images_renamed(
        where=where,
        count=len(matches),
        differences=list(differences),
        name=example,
        image=its_image,
    )
    new_names = [matches.get(name, name) for name in all_names]
    return np.array(new_names, dtype=object), (message,)


def propose_differences(images: Collection[str], known: Collection[str]) -> str:
    """Propose, in words, which differences to allow so that most images match; "" where none do.

    Of sets of differences that match equally many images the smallest is proposed.
    """
    best: dict[str, str] = {}
    best_differences: tuple[Difference, ...] = ()
    for size in range(1, len(DIFFERENCES) + 1):
        for differences in combinations(DIFFERENCES, size):
            matches = images_by_name(images, known, differences)
            if len(matches) > len(best):  # else the smaller set, which was tried before, stays
                best = matches
                best_differences = differences
    if not best:
        return ""
    name, image = next(iter(best.items()))
    return messages.difference_in_names(
        matched=len(best),
        differences=best_differences,
        name=name,
        image=image,
    )


def refuse_other_names(
    exposures: Mapping[str, Collection[str]],
    images: Iterable[str],
) -> None:
    """Refuse (MissionError IMAGES-OTHER) a camera of whose exposures none is an observed image.

    ``exposures`` : the names of exposures, by camera. Passed over are

    * all cameras, if each observed image has an exposure;
    * a camera with more than twice as many exposures as there are observed images without one:
      perhaps nothing was measured in the images of this camera.
    """
    observed = set(images)
    unknown = sorted(observed.difference(*exposures.values()))
    if not unknown:
        return
    for camera, names in exposures.items():
        may_be_unmeasured = 2 * len(unknown) < len(names)
        if may_be_unmeasured or not observed.isdisjoint(names):
            continue
        raise messages.no_image_of_camera(
            camera=camera,
            unknown=len(unknown),
            image=unknown[0],
            exposures=len(names),
            example=next(iter(names), None),
            proposal=propose_differences(unknown, names),
        )


_MOST_SERIES = 12  # into which digits that differ between groups part the names
_LISTED = 3
_STRAYS_IN = 10  # numbers of which one may be far from those of a log

# What cameras call all their images: no name of one camera.
_OF_ANY_CAMERA = {
    "",
    "cap",
    "dji",
    "dsc",
    "dscf",
    "frame",
    "image",
    "img",
    "p",
    "photo",
    "pic",
}


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
        before = _with_doubled_braces(self.before)
        after = _with_doubled_braces(self.after)
        if field == "*":
            return f"{before}*{after}"
        digits = f":0{self.width}d" if self.width else ""
        return f"{before}{{{field}{digits}}}{after}"

    @property
    def camera(self) -> str:
        """What the names call their camera: the word before the number, or the folder; or empty."""
        *folders, word = re.split(r"[\\/]", self.before)
        for name in (word, *reversed(folders)):
            plain = re.sub(r"[^A-Za-z0-9]+", "_", name)
            plain = plain.strip("_").lower()
            if plain not in _OF_ANY_CAMERA and not plain.isdigit():
                return plain
        return ""

    def counts_as(self, index: Collection[int]) -> bool:
        """Whether all numbers are numbers of a log, the first and the last of the log included."""
        log_numbers = set(index)
        own_numbers = set(self.numbers)
        if not self.has_number or not own_numbers:
            return False
        repeats_own = len(own_numbers) < len(self.numbers)
        repeats_in_log = len(log_numbers) < len(index)
        if repeats_own or repeats_in_log or not own_numbers <= log_numbers:
            return False
        has_first = min(own_numbers) == min(log_numbers)
        has_last = max(own_numbers) == max(log_numbers)
        return has_first and has_last

    def listed(self, numbers: tuple[int, ...]) -> str:
        """The names of images, the first three of them; ``*`` where other digits differ."""
        pattern = self.pattern("index")
        names = [pattern.format(index=number) for number in numbers]
        return messages.first_names(names, _LISTED)

    def strays(self, index: Collection[int]) -> tuple[int, ...]:
        """The few numbers that are far from those of a log, if all others may be the log's.

        ``index`` : the numbers of the log. Returns no number if more than a tenth of the numbers is
        far, or the others do not count as the log does. A number is far if it is beyond either end
        by more than the length of the log: numbers that go on where the log ends (1 to 29 for 28
        events) rather show a lost event.
        """
        first = min(index, default=0)
        last = max(index, default=0)
        length = last - first + 1
        near: list[int] = []
        far: list[int] = []
        for number in self.numbers:
            if first - length <= number <= last + length:
                near.append(number)
            else:
                far.append(number)
        has_too_many = _STRAYS_IN * len(far) > len(self.numbers)
        near_images = replace(self, numbers=tuple(near))
        if has_too_many or not near_images.counts_as(index):
            return ()
        return tuple(far)


def name_series(names: Iterable[str]) -> list[NameSeries]:
    """The series of some names, the largest first.

    Digits that differ between few groups of images (a head, a folder) part them into several
    series; digits that differ from image to image beside the count (a time) become ``*``.

    >>> [s.pattern("n") for s in name_series(["cam1/a_01.jpg", "cam1/a_02.jpg", "cam2/a_01.jpg"])]
    ['cam1/a_{n:02d}.jpg', 'cam2/a_{n:02d}.jpg']
    """
    digits_by_texts: defaultdict[_Texts, list[_Digits]] = defaultdict(list)
    for name in sorted(set(names)):
        parts = re.split(r"(\d+)", name)  # text, digits, text, ... , text
        texts = tuple(parts[::2])
        digits = parts[1::2]
        digits_by_texts[texts].append(digits)
    all_series: list[NameSeries] = []
    for texts, rows in digits_by_texts.items():
        all_series += _series(texts, rows)
    return sorted(all_series, key=lambda series: (-len(series.numbers), series.before))


def _series(texts: _Texts, rows: list[_Digits]) -> list[NameSeries]:
    """The series of names that have the same texts between their groups of digits.

    ``rows``: the groups of digits of each name. One group counts the images; the others that differ
    part the names into series if these are few and have two names or more in the mean.
    """
    if not rows[0]:
        return [_name_without_number(texts[0])]
    varieties = [len(set(digits)) for digits in zip(*rows, strict=True)]
    columns = range(len(varieties))
    # The digits that differ most count the images; of several such groups the last.
    count_column = max(columns, key=lambda column: (varieties[column], column))
    other_columns: list[int] = []
    for column in columns:
        if column != count_column and varieties[column] > 1:
            other_columns.append(column)
    groups: defaultdict[tuple[str, ...], list[_Digits]] = defaultdict(list)
    for row in rows:
        other_digits = tuple(row[column] for column in other_columns)
        groups[other_digits].append(row)
    groups_have_several = 2 * len(groups) <= len(rows) + 1  # an odd name may be alone
    if other_columns and len(groups) <= _MOST_SERIES and groups_have_several:
        parted: list[NameSeries] = []
        for group in groups.values():
            parted += _series(texts, group)
        return parted
    return [_one_series(texts, rows, count_column, other_columns)]


def _name_without_number(name: str) -> NameSeries:
    """The series of a single name without digits, apart at its ending."""
    stem, dot, ending = name.rpartition(".")
    if not dot:
        stem = name
        ending = ""
    return NameSeries(
        before=stem,
        width=0,
        after=dot + ending,
        numbers=(0,),
        has_number=False,
    )


def _one_series(
    texts: _Texts,
    rows: list[_Digits],
    count_column: int,
    other_columns: list[int],
) -> NameSeries:
    """The series that one column of digits counts; other digits that differ become ``*``."""
    written = list(rows[0])
    for column in other_columns:
        written[column] = "*"
    next_column = count_column + 1
    counts = [row[count_column] for row in rows]
    widths = {len(count) for count in counts}
    is_padded = len(widths) == 1 and widths != {1}
    numbers = [int(count) for count in counts]
    return NameSeries(
        before=_joined(texts[:next_column], written[:count_column]),
        width=max(widths) if is_padded else 0,
        after=_joined(texts[next_column:], written[next_column:]),
        numbers=tuple(sorted(numbers)),
    )


def _joined(texts: _Texts, digits: _Digits) -> str:
    """A part of a name from what alternates in it: text, digits, text, ... , text."""
    parts = [texts[0]]
    for number, text in zip(digits, texts[1:], strict=True):
        parts.append(number)
        parts.append(text)
    return "".join(parts)


def _with_doubled_braces(text: str) -> str:
    return text.replace("{", "{{").replace("}", "}}")
