"""Tables of images and image points of a block of any program, and records of its files.

Image points have the columns ``image``, ``point``, ``x_px``, ``y_px`` in COLMAP's pixels, and
``keypoint``, the index of the row among those of its image, from 0. ``point`` is the program's name
of the point; an image point without one is called ``image:keypoint``, so that each row has a name
that identifies it.
"""

import mmap
import struct
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike

from unbend.flight.heights import GeodeticOrigin
from unbend.flight.rotations import quaternions_of
from unbend.flight.stations import NO_TIME
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array, Integers

_LARGEST_DEVIATION = 1e-3
"""Of the products of rows of a rotation matrix, which is written with a few digits."""

CameraMakers = dict[str, Callable[[], Camera]]
"""Camera name -> function that makes the camera, or refuses its calibration."""


def rows_of_image(
    image: str,
    xy: ArrayLike,
    point: Sequence[str] | Integers | None = None,
    *,
    keypoint: ArrayLike | None = None,
    more: Mapping[str, pa.Array] | None = None,
) -> pa.RecordBatch:
    """The rows of one image, from the pixels ``xy`` (n, 2) of its image points.

    ``point`` (n,) are names of points, or numbers with -1 for no point; None if no image point has
    one. ``keypoint`` (n,) are their indices in the image, by default 0 to n - 1; ``more`` are
    further columns (n,).

    >>> rows_of_image("a.jpg", [[1, 2], [3, 4]], np.array([17, -1]))["point"].to_pylist()
    ['17', 'a.jpg:1']
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged file
        pixels = np.asarray(xy, np.float64).reshape(-1, 2)
    rows = len(pixels)
    if keypoint is None:
        keypoint = np.arange(rows)
    index = pa.array(np.asarray(keypoint, np.int64))
    if point is None or isinstance(point, np.ndarray):
        point = _names_of_numbers(image, index, point)
    columns = {
        "image": pa.repeat(pa.scalar(image, pa.string()), rows),
        "point": pa.array(point, pa.string()),
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
        "keypoint": index,
        **(more or {}),
    }
    return pa.RecordBatch.from_pydict(columns)


def _names_of_numbers(
    image: str,
    index: pa.Array,
    numbers: Integers | None,
) -> pa.StringArray:
    """(n,) names of points: their numbers as text; ``image:keypoint`` for -1, or without numbers.

    ``index`` (n,) is the keypoint of each row.
    """
    names_by_keypoint = pc.binary_replace_slice(index.cast(pa.string()), 0, 0, f"{image}:")
    if numbers is None:
        return names_by_keypoint
    number = pa.array(numbers, pa.int64())
    has_number = pc.greater_equal(number, 0)
    return pc.if_else(has_number, number.cast(pa.string()), names_by_keypoint)


def unused_camera_name(label: str, number: str, taken: Container[str]) -> str:
    """The label of a camera; where that is taken, with its number behind it until it is not.

    >>> unused_camera_name("RGB", "3", {"RGB", "RGB 3"})
    'RGB 3 3'
    """
    name = label
    while name in taken:
        name = f"{name} {number}"
    return name


def oriented_images(
    image: Sequence[str],
    camera: Sequence[str],
    position: ArrayLike,
    quaternion: ArrayLike,
    frame: Literal["ecef"] | GeodeticOrigin | None = None,
) -> OrientationTable:
    """The table of images (n,) with their cameras, (n, 3) positions and (n, 4) quaternions.

    A quaternion w, x, y, z turns from the frame to the camera (x right, y down, z forward); NaN for
    an image without a pose. ``frame`` is None where the files state none.
    """
    return OrientationTable(
        image=np.array([*image], object),
        camera=np.array([*camera], object),
        time_ns=np.full(len(image), NO_TIME, np.int64),
        position=np.asarray(position, np.float64).reshape(-1, 3),
        angles=np.asarray(quaternion, np.float64).reshape(-1, 4),
        sigmas={},
        frame=frame,
    )


def quaternions_of_poses(
    path: Path,
    image: Sequence[str],
    matrix: ArrayLike,
) -> Array:
    """(n, 4) quaternions w, x, y, z of the rotation matrices (n, 3, 3) of images (n,) in a file.

    NaN for a matrix with NaN. Refuses (InputError) the first image whose matrix is not a rotation:
    the nearest rotation, or a mirrored image, would be taken otherwise.
    """
    matrices = np.asarray(matrix, np.float64).reshape(-1, 3, 3)
    known = np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2)))
    known_matrices = matrices[known]
    products = known_matrices @ known_matrices.transpose(0, 2, 1)
    deviations = np.abs(products - np.eye(3))
    is_skewed = deviations.max(axis=(1, 2)) > _LARGEST_DEVIATION
    is_mirrored = np.linalg.det(known_matrices) < 0.0
    wrong = known[is_skewed | is_mirrored]
    if wrong.size:
        first_wrong = int(wrong[0])
        raise messages.no_rotation(
            where=path,
            image=image[first_wrong],
        )
    return quaternions_of(matrices)


def rows_with_point(rows: pa.RecordBatch, image: str, point: str) -> Integers:
    """(k,) the indices of the rows that belong to a point, not called ``image:keypoint``.

    All ``rows`` are of one image; ``image`` and ``point`` are the names of the columns.
    """
    if len(rows) == 0:
        return np.empty(0, np.int64)
    names = rows[point].cast(pa.string())
    is_by_keypoint = pc.starts_with(names, f"{rows[image][0]}:")
    return np.flatnonzero(~is_by_keypoint.to_numpy(zero_copy_only=False))


class TextFile:
    """Iterates over the lines of a text file, stripped; ``number`` is that of the last line.

    As a context manager it turns a ValueError into an InputError that names this line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = 0

    def __iter__(self) -> Iterator[str]:
        self.number = 0
        with self.path.open(encoding="utf-8-sig") as stream:
            for line in stream:
                self.number += 1
                yield line.strip()

    def __enter__(self) -> "TextFile":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, ValueError):
            raise messages.line_unreadable(where=self.path, line=self.number) from None


class BinaryFile:
    """Reads little-endian records of a file, one after the other; refuses a file that is cut off.

    As a context manager it also refuses bytes that are left after the last record.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.offset = 0
        self.content: Any = b""
        with path.open("rb") as stream:
            if path.stat().st_size:
                self.content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    def __enter__(self) -> "BinaryFile":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        bytes_left = len(self.content) - self.offset
        if bytes_left and error is None:
            raise messages.bytes_behind(where=self.path, count=bytes_left)

    def skip(self, size: int) -> int:
        """Move on by ``size`` bytes; returns the offset [bytes] at which they begin."""
        begin = self.offset
        if begin + size > len(self.content):
            raise messages.record_cut(
                where=self.path,
                size=len(self.content),
                offset=begin,
                needed=size,
            )
        self.offset += size
        return begin

    def take(self, form: str) -> tuple[Any, ...]:
        """The next numbers, in the format ``form`` of `struct` without its byte order."""
        form = f"<{form}"
        begin = self.skip(struct.calcsize(form))
        return struct.unpack_from(form, self.content, begin)

    def array(
        self,
        kind: np.dtype[Any],
        count: int,
    ) -> Any:
        """(count,) the next records of one kind."""
        begin = self.skip(kind.itemsize * count)
        return np.frombuffer(self.content, kind, count, begin)

    def word(self) -> str:
        """The next text in UTF-8, which ends with a zero byte; the zero is not returned."""
        end = self.content.find(b"\0", self.offset)
        size = end + 1 - self.offset
        if end < 0:
            size = len(self.content) + 1  # more than there is: `skip` refuses
        begin = self.skip(size)
        return bytes(self.content[begin:end]).decode("utf-8")
