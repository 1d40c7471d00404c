"""Names of images that differ in case, ending, folder or the writing of their digits."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from itertools import combinations
from typing import Literal

import numpy as np

from pipeline.errors import MissionError
from pipeline.ledger import Notes, note
from pipeline.units import Names

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
    return (
        f"{len(found)} of them would have one with observations.match_names: "
        f"[{', '.join(differences)}], as {image!r} that of {name!r}"
    )


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
        raise MissionError(
            "IMAGES-OTHER",
            f"none of {len(unknown)} images of the observations, like {unknown[0]!r}, is one of "
            f"the {len(names)} exposures of {camera}{called}" + (f"; {near}" if near else ""),
            where=f"observations, {camera}",
            remedy="state observations.match_names, or mend the pattern or the names of the images",
        )
