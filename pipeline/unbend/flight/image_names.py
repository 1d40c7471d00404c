"""Names of images: how two of them differ, and the pattern of names that differ in one number."""

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

# The parts of a name: k + 1 texts, and the k groups of digits between them.
_Texts = tuple[str, ...]
_Digits = list[str]


def composed(name: str) -> str:
    """A name with its characters composed (Unicode NFC), as most systems but macOS write them.

    >>> composed("A\u0308.jpg") == "\u00c4.jpg"
    True
    """
    return unicodedata.normalize("NFC", name)


def without_differences(name: str, differences: Collection[str]) -> str:
    """A form of a name that is equal for names with only the listed differences.

    ``differences`` : any of `DIFFERENCES`. Without "case" letters are small; "folder" and
    "extension" are cut off; "digits" puts one ``#`` before each group of digits, in place of
    leading zeros, blanks, hyphens and underscores. Characters are composed in any case, because
    file systems differ in that.

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
    """For each known name, the image that has the same name apart from the listed differences.

    ``differences`` : as of `without_differences`. Left out are names that are equal to an image,
    and names for which two known names or two images could match.

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
    """Each name by its form `without_differences`; names with the same form are left out."""
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
    """Give exposures the names of the observed images that they match.

    ``names`` : (m,) of exposures, "" where unknown. ``images`` : the observed ones; they may differ
    from ``names`` by the ``differences`` that the mission file allows, and in composed characters.
    ``where`` : the source of the exposures. A note counts the replaced names.
    """
    all_names = names.tolist()
    known_names = [name for name in all_names if name]
    matches = images_by_name(images, known_names, differences)
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
    """Propose, in words, which differences to allow so that most images match a known name.

    Of sets of differences that match equally many images the smallest is proposed. "" if no image
    matches.
    """
    best: dict[str, str] = {}
    best_differences: tuple[Difference, ...] = ()
    for size in range(1, len(DIFFERENCES) + 1):
        for differences in combinations(DIFFERENCES, size):
            matches = images_by_name(images, known, differences)
            if len(matches) > len(best):  # of equally good sets, the first one is the smallest
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


def shift_of_names(images: Collection[str], known: Collection[str]) -> int:
    """By how many numbers the images of a series seem later than the exposures; 0 if they do not.

    Negative if they seem earlier. A series (`name_series`) seems shifted if as many images at one
    end have no exposure as exposures at the other end have no image, and all numbers between are
    common to both. Of several series the first counts.

    >>> shift_of_names(["I9", "I10", "I11"], ["I8", "I9", "I10"])
    1
    """
    known_numbers = {
        (series.before, series.after): set(series.numbers) for series in name_series(known)
    }
    for series in name_series(images):
        exposures = known_numbers.get((series.before, series.after), set())
        shift = _shift_of_numbers(set(series.numbers), exposures)
        if shift:
            return shift
    return 0


def _shift_of_numbers(images: set[int], exposures: set[int]) -> int:
    """By how much the numbers of images seem later than those of exposures; 0 if they do not."""
    only_images = images - exposures
    only_exposures = exposures - images
    common = images & exposures
    shift = len(only_images)
    if not common or shift == 0 or len(only_exposures) != shift:
        return 0
    if max(only_exposures) < min(common) and max(common) < min(only_images):
        return shift
    if max(only_images) < min(common) and max(common) < min(only_exposures):
        return -shift
    return 0


def refuse_other_names(
    exposures: Mapping[str, Collection[str]],
    images: Iterable[str],
) -> None:
    """Refuse (MissionError IMAGES-OTHER) a camera if none of its exposures is an observed image.

    ``exposures`` : names of exposures, by camera. ``images`` : the observed ones. Not refused are

    * all cameras, if each observed image has an exposure;
    * a camera with more than twice as many exposures as there are observed images without one:
      perhaps nothing was measured in the images of this camera.
    """
    observed = set(images)
    without_exposure = sorted(observed.difference(*exposures.values()))
    if not without_exposure:
        return
    for camera, names in exposures.items():
        may_be_unmeasured = 2 * len(without_exposure) < len(names)
        has_observed_image = not observed.isdisjoint(names)
        if may_be_unmeasured or has_observed_image:
            continue
        raise messages.no_image_of_camera(
            camera=camera,
            unknown=len(without_exposure),
            image=without_exposure[0],
            exposures=len(names),
            example=next(iter(names), None),
            proposal=propose_differences(without_exposure, names),
        )


_MOST_SERIES = 12  # digits that would divide the names into more series become "*"
_LISTED = 3  # names in a message
_NUMBERS_PER_STRAY = 10  # one in so many numbers may be far from those of a log

# Words with which many cameras begin their images: they do not tell the camera.
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
    """Images that have the same name apart from one number.

    ``before``, ``after`` : the texts around the number, with a ``*`` for other digits that differ.
    ``width`` : number of digits, 0 if they are not padded with zeros. ``numbers`` : of all images,
    in rising order. ``has_number`` is False for the series of a name without digits.
    """

    before: str
    width: int
    after: str
    numbers: tuple[int, ...]
    has_number: bool = True

    def pattern(self, field: str) -> str:
        """The pattern of these names for a mission file, for example ``DSC_{index:04d}.tif``.

        ``field`` : the word for the number, ``index`` or ``n``; with ``*`` the pattern has a ``*``
        in place of the number.

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
        """The camera that the names tell: the word before the number, or a folder; "" if neither.

        Words of `_OF_ANY_CAMERA` and mere digits do not count.
        """
        *folders, word = re.split(r"[\\/]", self.before)
        for name in (word, *reversed(folders)):
            plain = re.sub(r"[^A-Za-z0-9]+", "_", name)
            plain = plain.strip("_").lower()
            if plain not in _OF_ANY_CAMERA and not plain.isdigit():
                return plain
        return ""

    def counts_as(self, index: Collection[int]) -> bool:
        """Whether the numbers of the images are those of the events of a log (``index``).

        All must be in the log, once each, among them the first and the last number of the log.
        """
        log_numbers = set(index)
        image_numbers = set(self.numbers)
        if not self.has_number or not image_numbers:
            return False
        repeats_image = len(image_numbers) < len(self.numbers)
        repeats_in_log = len(log_numbers) < len(index)
        if repeats_image or repeats_in_log or not image_numbers <= log_numbers:
            return False
        has_first = min(image_numbers) == min(log_numbers)
        has_last = max(image_numbers) == max(log_numbers)
        return has_first and has_last

    def listed(self, numbers: tuple[int, ...]) -> str:
        """The names of the images with these numbers, the first three of them, for a message.

        They have a ``*`` where other digits differ.
        """
        pattern = self.pattern("index")
        names = [pattern.format(index=number) for number in numbers]
        return messages.first_names(names, _LISTED)

    def strays(self, index: Collection[int]) -> tuple[int, ...]:
        """The few numbers that are far from those of a log, if all others `counts_as` the log.

        ``index`` : the numbers of the log. A number is far if it is beyond either end by more than
        the length of the log: numbers that go on where the log ends (1 to 29 for 28 events) rather
        show a lost event. Empty if more than a tenth of the numbers is far.
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
        has_too_many = _NUMBERS_PER_STRAY * len(far) > len(self.numbers)
        near_images = replace(self, numbers=tuple(near))
        if has_too_many or not near_images.counts_as(index):
            return ()
        return tuple(far)


def name_series(names: Iterable[str]) -> list[NameSeries]:
    """Divide names into series, the largest first.

    Digits that differ between few groups of images (a camera head, a folder) divide them into
    several series; digits that differ from image to image in addition to the count (a time) become
    ``*``.

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
        all_series += _series_of_texts(texts, rows)
    return sorted(all_series, key=lambda series: (-len(series.numbers), series.before))


def _series_of_texts(texts: _Texts, rows: list[_Digits]) -> list[NameSeries]:
    """The series of names that have the same texts between their groups of digits.

    ``rows``: for each name its groups of digits. One column of these counts the images. The other
    columns that differ divide the names into series, if that gives few series of two names or more
    on average.
    """
    if not rows[0]:
        return [_name_without_number(texts[0])]
    distinct = [len(set(digits)) for digits in zip(*rows, strict=True)]
    columns = range(len(distinct))
    # The column with most distinct digits counts the images; of several such columns the last.
    count_column = max(columns, key=lambda column: (distinct[column], column))
    other_columns: list[int] = []
    for column in columns:
        if column != count_column and distinct[column] > 1:
            other_columns.append(column)
    groups: defaultdict[tuple[str, ...], list[_Digits]] = defaultdict(list)
    for row in rows:
        other_digits = tuple(row[column] for column in other_columns)
        groups[other_digits].append(row)
    have_two_on_average = 2 * len(groups) <= len(rows) + 1  # with an odd count one may be alone
    if other_columns and len(groups) <= _MOST_SERIES and have_two_on_average:
        series_of_groups: list[NameSeries] = []
        for group in groups.values():
            series_of_groups += _series_of_texts(texts, group)
        return series_of_groups
    return [_one_series(texts, rows, count_column, other_columns)]


def _name_without_number(name: str) -> NameSeries:
    """The series of a single name without digits, divided at its extension."""
    stem, dot, extension = name.rpartition(".")
    if not dot:
        stem = name
        extension = ""
    return NameSeries(
        before=stem,
        width=0,
        after=dot + extension,
        numbers=(0,),
        has_number=False,
    )


def _one_series(
    texts: _Texts,
    rows: list[_Digits],
    count_column: int,
    other_columns: list[int],
) -> NameSeries:
    """The series of names that one column of digits counts.

    ``other_columns``: columns of digits that differ too; they become ``*``.
    """
    digits = list(rows[0])
    for column in other_columns:
        digits[column] = "*"
    next_column = count_column + 1
    counts = [row[count_column] for row in rows]
    widths = {len(count) for count in counts}
    is_padded = len(widths) == 1 and widths != {1}
    numbers = [int(count) for count in counts]
    return NameSeries(
        before=_joined(texts[:next_column], digits[:count_column]),
        width=max(widths) if is_padded else 0,
        after=_joined(texts[next_column:], digits[next_column:]),
        numbers=tuple(sorted(numbers)),
    )


def _joined(texts: _Texts, digits: _Digits) -> str:
    """A part of a name, from k + 1 texts and the k groups of digits between them."""
    parts = [texts[0]]
    for number, text in zip(digits, texts[1:], strict=True):
        parts.append(number)
        parts.append(text)
    return "".join(parts)


def _with_doubled_braces(text: str) -> str:
    """A text in which braces are escaped for `str.format`."""
    return text.replace("{", "{{").replace("}", "}}")
