"""Whether the texts of a COLMAP model are whole: by their comments, and by each other.

COLMAP writes a comment with the number of records of a text, and a newline at the end of the last
line. Other programs that filter or write models keep neither. So a text that lacks records or the
last newline is refused only where images and points of the model do not fit each other. They fit if
each image point with a point is in the track of that point, each entry of a track is such an image
point, and all images of the frames exist.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from unbend.messages import Notes
from unbend.tables.imports.blocks import messages

_COUNT = re.compile(rb"^# Number of \w+: (\d+)", re.M)
_HEAD_BYTES = 1000  # contain the comments, which come before the first record


@dataclass(frozen=True)
class TextEnds:
    """Signs that a text is complete: the number of records in its comment, and a last newline.

    ``stated`` is None without such a comment.
    """

    stated: int | None
    has_last_newline: bool

    @classmethod
    def of(cls, file: Path) -> "TextEnds":
        """Read comment and last byte of a file; an empty file counts as ending with a newline."""
        with file.open("rb") as stream:
            count_match = _COUNT.search(stream.read(_HEAD_BYTES))
            stream.seek(max(file.stat().st_size - 1, 0))
            last = stream.read()
        return cls(None if count_match is None else int(count_match[1]), last in (b"\n", b""))


def refuse_missing_records(
    file: Path,
    count: int,
) -> None:
    """Refuse a text that lacks records or its last newline, if the other texts show that it is cut.

    ``count`` is the number of records that were read from it.
    """
    ends = TextEnds.of(file)
    is_short = ends.stated is not None and count < ends.stated
    if ends.has_last_newline and not is_short:
        return
    folder = file.parent
    images = folder / "images.txt"
    points = folder / "points3D.txt"
    has_both = images.is_file() and points.is_file()
    is_consistent = has_both and fit_each_other(images, points)
    if is_short and not (is_consistent and count):
        raise messages.records_missing(
            where=file,
            found=count,
            total=ends.stated or 0,
        )
    if not is_consistent and file.name in (images.name, points.name):
        raise messages.records_missing(
            where=file,
            found=count,
            total=ends.stated or count,
        )


def notes_on_texts(
    files: tuple[Path, ...],
    images: int,
) -> Notes:
    """Warnings on the texts of a model that was read.

    They are on a comment with another number of images than ``images``, the number that was read,
    and on a last line without a newline.
    """
    notes = []
    for file in files:
        if file.suffix != ".txt":
            continue
        ends = TextEnds.of(file)
        is_of_images = file.name == "images.txt"
        if is_of_images and ends.stated not in (None, images):
            stated_count = ends.stated or 0
            notes.append(
                messages.count_of_comment(
                    where=file,
                    found=images,
                    stated=stated_count,
                )
            )
        if not ends.has_last_newline:
            notes.append(messages.line_without_end(where=file))
    return tuple(notes)


def fit_each_other(
    images: Path,
    points: Path,
) -> bool:
    """Whether images.txt and points3D.txt have the same image points, and all images of the frames.

    ``images`` and ``points`` are the two files; False where one cannot be read.
    """
    try:
        by_images = image_points_of_images(images)
        by_tracks = image_points_of_tracks(points)
        in_frames = images_of_frames(images.with_name("frames.txt"))
        image_ids = {head.split(maxsplit=1)[0] for head, _ in images_with_points(images)}
    except (ValueError, IndexError):
        return False
    return by_images == by_tracks and in_frames <= image_ids


def images_of_frames(file: Path) -> set[str]:
    """The ids of the images in frames.txt; none without that file, which is new in COLMAP 3.12."""
    images: set[str] = set()
    if not file.is_file():
        return images
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if line.strip() and not line.startswith("#"):
            data = line.split()[10:]  # after frame, rig, pose (7 numbers) and the count of data
            images.update(data[2::3])  # of each: type of sensor, sensor, image
    return images


def images_with_points(file: Path) -> Iterator[tuple[str, str]]:
    """The two lines of each image in images.txt: its own, and that of its image points."""
    rows = iter(file.read_text(encoding="utf-8-sig").splitlines())
    for head in rows:
        if head.strip() and not head.startswith("#"):
            yield head, next(rows, "")


def image_points_of_images(file: Path) -> set[tuple[str, int, str]]:
    """The image points with a point in images.txt: image, index in the image, and point."""
    image_points = set()
    for head, line in images_with_points(file):
        image = head.split(maxsplit=1)[0]
        point_numbers = line.split()[2::3]
        for index, number in enumerate(point_numbers):
            if int(number) >= 0:
                image_points.add((image, index, number))
    return image_points


def image_points_of_tracks(file: Path) -> set[tuple[str, int, str]]:
    """The image points in the tracks of points3D.txt: image, index in the image, and point."""
    image_points = set()
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        number, *fields = line.split()
        track = fields[7:]  # after x, y, z, the colour and the error
        for image, index in zip(track[::2], track[1::2], strict=True):
            image_points.add((image, int(index), number))
    return image_points
