"""Images and image points of a block, whatever the program calls them, and records of its files.

Image points have the columns ``image``, ``point``, ``x_px``, ``y_px`` in COLMAP's pixels, and
``keypoint``, the place of the row among those of its image, from 0. ``point`` is what the program
calls the point; an image point that belongs to none is called ``image:keypoint``, so that every row
has a name by which it goes back.
"""

import mmap
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike

from unbend.flight.heights import GeodeticOrigin
from unbend.flight.stations import NO_TIME
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Integers

CameraMakers = dict[str, Callable[[], Camera]]


def rows_of_image(
    image: str,
    xy: ArrayLike,
    point: Sequence[str] | Integers | None = None,
    *,
    keypoint: ArrayLike | None = None,
    more: Mapping[str, pa.Array] | None = None,
) -> pa.RecordBatch:
    """The rows of one image: (n, 2) pixels, names of points or numbers, of which -1 is none.

    >>> rows_of_image("a.jpg", [[1, 2], [3, 4]], np.array([17, -1]))["point"].to_pylist()
    ['17', 'a.jpg:1']
    """
    x, y = np.asarray(xy, np.float64).reshape(-1, 2).T
    index = pa.array(np.arange(x.size) if keypoint is None else np.asarray(keypoint, np.int64))
    names = pa.repeat(pa.scalar(image, pa.string()), x.size)
    if point is None or isinstance(point, np.ndarray):
        own = pc.binary_replace_slice(index.cast(pa.string()), 0, 0, f"{image}:")
        number = pa.array([] if point is None else point, pa.int64())
        placed = pc.greater_equal(number, 0)
        point = own if point is None else pc.if_else(placed, number.cast(pa.string()), own)
    columns = {"image": names, "point": pa.array(point, pa.string()), "x_px": x, "y_px": y}
    return pa.RecordBatch.from_pydict(columns | {"keypoint": index} | dict(more or {}))


def oriented_images(
    image: Sequence[str],
    camera: Sequence[str],
    position: ArrayLike,
    quaternion: ArrayLike,
    frame: Literal["ecef"] | GeodeticOrigin | None = None,
) -> OrientationTable:
    """Images with (n, 3) positions, and (n, 4) quaternions from the frame to the camera."""
    names, cameras = (np.array([*words], object) for words in (image, camera))
    places = np.asarray(position, np.float64).reshape(-1, 3)
    turns = np.asarray(quaternion, np.float64).reshape(-1, 4)
    time_ns = np.full(len(image), NO_TIME, np.int64)
    return OrientationTable(names, cameras, time_ns, places, turns, {}, frame=frame)


def of_points(rows: pa.RecordBatch, image: str, point: str) -> Integers:
    """(k,) the rows, all of one image, that belong to a point; ``image``, ``point`` are columns."""
    names = rows[point].cast(pa.string())
    own = pc.starts_with(names, f"{rows[image][0]}:") if len(rows) else names.is_null()
    return np.flatnonzero(~own.to_numpy(zero_copy_only=False))


class TextFile:
    """The lines of a text, stripped, in a ``with``: a ValueError in it names its last line."""

    def __init__(self, path: Path) -> None:
        self.path, self.number = path, 0

    def __iter__(self) -> Iterator[str]:
        with self.path.open(encoding="utf-8-sig") as stream:
            for self.number, line in enumerate(stream, 1):
                yield line.strip()

    def __enter__(self) -> "TextFile":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, ValueError):
            raise messages.line_unreadable(where=self.path, line=self.number) from None


class BinaryFile:
    """Little-endian records one behind the other, in a ``with``; refuses where they end early."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.content: Any = b""
        with path.open("rb") as stream:
            if path.stat().st_size:
                self.content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    def __enter__(self) -> "BinaryFile":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if (rest := len(self.content) - self.at) and error is None:
            raise messages.bytes_behind(where=self.path, count=rest)

    def skip(self, size: int) -> int:
        """Pass ``size`` bytes; returns where they begin."""
        if self.at + size > len(self.content):
            raise messages.record_cut(
                where=self.path, size=len(self.content), offset=self.at, needed=size
            )
        self.at += size
        return self.at - size

    def take(self, form: str) -> tuple[Any, ...]:
        """The next numbers, as `struct` writes them."""
        return struct.unpack_from(f"<{form}", self.content, self.skip(struct.calcsize(f"<{form}")))

    def array(self, kind: np.dtype[Any], count: int) -> Any:
        """(count,) the next records of one kind."""
        return np.frombuffer(self.content, kind, count, self.skip(kind.itemsize * count))

    def word(self) -> str:
        """The next text, which ends with a zero."""
        end = self.content.find(b"\0", self.at)
        at = self.skip(end + 1 - self.at if end >= 0 else len(self.content) + 1)
        return bytes(self.content[at:end]).decode("utf-8")
