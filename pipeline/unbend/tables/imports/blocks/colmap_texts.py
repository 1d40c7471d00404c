"""Whether the texts of a COLMAP model are whole: by their comments, and by each other.

A comment counts the records of a text, and the last line ends with a newline. Programs that filter
or write models by themselves keep neither. So a text that lacks records or the end of its line is
refused only where images and points of the model do not fit each other: each image point of a point
is in the track of that point, each track leads to such an image point, and the images of the frames
are there.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from unbend.messages import Notes
from unbend.tables.imports.blocks import messages

_COUNT = re.compile(rb"^# Number of \w+: (\d+)", re.M)
_HEAD_BYTES = 1000  # comments stand before the first record


@dataclass(frozen=True)
class TextEnds:
    """What a text says of its own length: records by its comment, None without; a last newline."""

    stated: int | None
    has_last_newline: bool

    @classmethod
    def of(cls, file: Path) -> "TextEnds":
        """The ends of a file."""
        with file.open("rb") as stream:
            count_match = _COUNT.search(stream.read(_HEAD_BYTES))
            stream.seek(max(file.stat().st_size - 1, 0))
            last = stream.read()
        return cls(None if count_match is None else int(count_match[1]), last in (b"\n", b""))


def refuse_missing_records(
    file: Path,
    found: int,
) -> None:
    """Refuse a text with fewer records than it says, or no end, that others show to be cut."""
    ends = TextEnds.of(file)
    is_short = ends.stated is not None and found < ends.stated
    if ends.has_last_newline and not is_short:
        return
    folder = file.parent
    images = folder / "images.txt"
    points = folder / "points3D.txt"
    is_whole = images.is_file() and points.is_file() and fit_each_other(images, points)
    if is_short and not (is_whole and found):
        raise messages.records_missing(
            where=file,
            found=found,
            total=ends.stated or 0,
        )
    if not is_whole and file.name in (images.name, points.name):
        raise messages.records_missing(
            where=file,
            found=found,
            total=ends.stated or found,
        )


def notes_on_texts(
    files: tuple[Path, ...],
    images: int,
) -> Notes:
    """Warnings on the texts of a model that was read: counts of comments, a line without end."""
    made = []
    for file in files:
        if file.suffix != ".txt":
            continue
        ends = TextEnds.of(file)
        is_of_images = file.name == "images.txt"
        if is_of_images and ends.stated not in (None, images):
            stated_count = ends.stated or 0
            made.append(
                messages.count_of_comment(
                    where=file,
                    found=images,
                    stated=stated_count,
                )
            )
        if not ends.has_last_newline:
            made.append(messages.line_without_end(where=file))
    return tuple(made)


def fit_each_other(
    images: Path,
    points: Path,
) -> bool:
    """Whether image points and the tracks of points name each other; False where unreadable."""
    try:
        by_images = image_points_of_images(images)
        by_points = image_points_of_tracks(points)
        in_frames = images_of_frames(images.with_name("frames.txt"))
        there = {head.split(maxsplit=1)[0] for head, _ in images_with_points(images)}
    except (ValueError, IndexError):
        return False
    return by_images == by_points and in_frames <= there


def images_of_frames(file: Path) -> set[str]:
    """The images that frames hold; none without that file, which COLMAP 3.12 brought."""
    images: set[str] = set()
    if not file.is_file():
        return images
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if line.strip() and not line.startswith("#"):
            data = line.split()[10:]  # after two numbers, the pose and the count
            images.update(data[2::3])
    return images


def images_with_points(file: Path) -> Iterator[tuple[str, str]]:
    """The two lines of each image."""
    rows = iter(file.read_text(encoding="utf-8-sig").splitlines())
    for head in rows:
        if head.strip() and not head.startswith("#"):
            yield head, next(rows, "")


def image_points_of_images(file: Path) -> set[tuple[str, int, str]]:
    """Image, place among its image points, and point, of those that belong to one."""
    image_points = set()
    for head, line in images_with_points(file):
        image = head.split(maxsplit=1)[0]
        point_numbers = line.split()[2::3]
        for place, number in enumerate(point_numbers):
            if int(number) >= 0:
                image_points.add((image, place, number))
    return image_points


def image_points_of_tracks(file: Path) -> set[tuple[str, int, str]]:
    """The same by the tracks of the points."""
    image_points = set()
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        number, *fields = line.split()
        track = fields[7:]
        for image, place in zip(track[::2], track[1::2], strict=True):
            image_points.add((image, int(place), number))
    return image_points
