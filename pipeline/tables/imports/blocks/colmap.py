"""COLMAP: sparse models as text or binary files, and databases.

Pixels are those of this package: the centre of the upper left pixel is (0.5, 0.5), x counts to the
right, y down. A pose turns and moves from the frame of the model to the camera, which has x right,
y down, z forward. A point is the number of its point3D; keypoints without one, and all of a
database, are called ``image:index``. Read without pycolmap, streamed, with the place of damage in
the refusal; tested against what pycolmap writes.
"""

from __future__ import annotations

import mmap
import re
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.errors import InputError
from pipeline.flight.stations import NO_TIME
from pipeline.refraction.calibration import camera_of_model
from pipeline.tables.imports.blocks.image_points import Array, CameraMakers, rows_of_image
from pipeline.tables.imports.orientation import OrientationTable
from pipeline.tables.imports.stated import not_of_format

_MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)  # fmt: skip
_POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
_Image = tuple[str, str, Array, Array, NDArray[np.int64]]


def block_files(path: Path) -> tuple[Path, ...]:
    """The database, a file of cameras, or cameras, images and points3D of a model's folder."""
    if not path.is_dir():
        wal = path.with_name(f"{path.name}-wal")
        return (path, wal) if wal.is_file() else (path,)
    ending = ".bin" if (path / "images.bin").is_file() else ".txt"
    files = tuple(path / f"{name}{ending}" for name in ("cameras", "images", "points3D"))
    for file in files:
        if not file.is_file():
            raise InputError(
                "INPUT-MISSING", f"a model of COLMAP has a {file.name}", where=str(file),
                remedy="name the folder of the model, as sparse/0",
            )  # fmt: skip
    return files


def read_cameras(path: Path) -> CameraMakers:
    """The cameras of a model, a cameras.txt or cameras.bin, or a database, by their numbers."""
    file = block_files(path)[0]
    if _is_database(file):
        query = "SELECT camera_id, model, width, height, params FROM cameras"
        with closing(_opened(file)) as database:
            return {
                str(number): partial(
                    camera_of_model, _model(code, file)[0], width, height,
                    np.frombuffer(blob, "<f8").tolist(),
                )
                for number, code, width, height, blob in database.execute(query)
            }  # fmt: skip
    cameras: CameraMakers = {}
    if file.suffix.lower() == ".bin":
        content = BinaryFile(file)
        for _ in range(content.take("Q")[0]):
            number, code, width, height = content.take("iiQQ")
            model, count = _model(code, file)
            cameras[str(number)] = partial(camera_of_model, model, width, height,
                                           list(content.take(f"{count}d")))  # fmt: skip
        content.end()
        return cameras
    for line, text in _lines(file):
        try:
            number, model, width, height, *given = text.split()
            values = [float(value) for value in given]
            cameras[number] = partial(camera_of_model, model, int(width), int(height), values)
        except ValueError:
            raise not_of_format(file, f"line {line} is no camera of COLMAP") from None
    return cameras


def read_images(path: Path) -> OrientationTable:
    """The images of a model; refuses a database, which has none, and no rotations."""
    names, cameras, poses = [], [], [np.empty((0, 7))]
    for name, camera, pose, _, _ in _images(path):
        names.append(name)
        cameras.append(camera)
        poses.append(pose[None])
    pose = np.concatenate(poses)
    length = np.linalg.norm(pose[:, :4], axis=1)
    wrong = ~(np.abs(length - 1.0) < 1e-3) | ~np.isfinite(pose).all(axis=1)
    if wrong.any():
        raise not_of_format(path, f"the pose of {names[np.argmax(wrong)]!r} is no rotation")
    turn = Rotation.from_quat(pose[:, [1, 2, 3, 0]]) if names else None
    return OrientationTable(
        np.array(names, object),
        np.array(cameras, object),
        np.full(len(names), NO_TIME, np.int64),
        pose[:, 4:] if turn is None else turn.inv().apply(-pose[:, 4:]),
        pose[:, :4] / length[:, None],
        {},
    )


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The keypoints of a model or a database."""
    if not _is_database(path):
        for name, _, _, xy, point in _images(path):
            yield rows_of_image(name, xy, point)
        return
    query = "SELECT name, rows, cols, data FROM keypoints JOIN images USING (image_id)"
    with closing(_opened(path)) as database:
        count = 0
        for name, rows, columns, blob in database.execute(f"{query} ORDER BY image_id"):
            blob, count = blob or b"", count + rows
            if columns < 2 or len(blob) != 4 * rows * columns:
                raise not_of_format(path, f"the keypoints of {name!r} are {len(blob)} bytes, and "
                                    f"not {rows} rows of {columns} float32")  # fmt: skip
            yield rows_of_image(name, np.frombuffer(blob, "<f4").reshape(rows, columns)[:, :2])
        matches = database.execute("SELECT COUNT(*) FROM matches").fetchone()[0]
        if count == 0:
            what = f"the database has {matches} pairs with matches, and no keypoints"
            raise InputError("OBS-EMPTY", what, where=str(path),
                             remedy="extract features first, or name another file")  # fmt: skip


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The points3D of a model."""
    if _is_database(path):
        raise not_of_format(path, "a database has no points", "name a model, as sparse/0")
    file = block_files(path)[2]
    numbers, places = [], []
    if file.suffix == ".bin":
        content = BinaryFile(file)
        for _ in range(content.take("Q")[0]):
            number, x, y, z, track = content.take("Q3d11xQ")
            numbers.append(number)
            places.append((x, y, z))
            content.skip(8 * track)
        content.end()
    else:
        for line, text in _lines(file):
            try:
                number, x, y, z, _ = text.split(maxsplit=4)
                numbers.append(int(number))
                places.append((float(x), float(y), float(z)))
            except ValueError:
                raise not_of_format(file, f"line {line} is no point3D of COLMAP") from None
    return pa.array(map(str, numbers), pa.string()), np.array(places).reshape(-1, 3)


def _images(path: Path) -> Iterator[_Image]:
    """Name, camera, pose (7,), keypoints (n, 2) and their point3D, -1 for none, of each image."""
    if _is_database(path):
        raise not_of_format(path, "a database has no orientations of images",
                            "give stations.orientation.path, a model as sparse/0")  # fmt: skip
    file = block_files(path)[1]
    if file.suffix == ".bin":
        content = BinaryFile(file)
        for _ in range(content.take("Q")[0]):
            _, *numbers, camera = content.take("i7di")
            name = content.word()
            record = content.array(_POINT2D, content.take("Q")[0])
            yield name, str(camera), np.array(numbers), record["xy"], record["point"]
        content.end()
        return
    lines = _lines(file, 2)
    for line, text in lines:
        try:
            _, *numbers, camera, name = text.split(maxsplit=9)
            pose = np.array(numbers, np.float64)
            points = np.array(next(lines, (0, ""))[1].split(), np.float64).reshape(-1, 3)
        except ValueError:
            what = f"lines {line} and {line + 1} are no image of COLMAP"
            raise not_of_format(file, what) from None
        yield name, camera, pose, points[:, :2], points[:, 2].astype(np.int64)


def _lines(file: Path, of_each: int = 1) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments; refuses fewer records than the file says.

    Behind the first of ``of_each`` lines of a record, the others may be empty.
    """
    stated, count = None, 0
    with file.open(encoding="utf-8") as stream:
        for number, line in enumerate(stream, 1):
            text = line.strip()
            if count % of_each == 0 and (not text or text.startswith("#")):
                found = re.match(r"# Number of \w+: (\d+)", text)
                stated = int(found[1]) if found else stated
                continue
            count += 1
            yield number, text
    records = -(-count // of_each)
    if stated not in (None, records):
        raise not_of_format(file, f"it is cut short: it says {stated} and holds {records}")


def _model(code: int, path: Path) -> tuple[str, int]:
    """Name of a camera model, and how many parameters it has; refuses one of a later version."""
    if not 0 <= code < len(_MODELS):
        raise not_of_format(path, f"its camera model number {code} is not known: COLMAP has "
                            f"{len(_MODELS)} up to version 4.2")  # fmt: skip
    return _MODELS[code]


def _is_database(path: Path) -> bool:
    return path.suffix.lower() == ".db"


def _opened(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)


class BinaryFile:
    """Little-endian records of a file, one behind the other; refuses where it ends too early."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        with path.open("rb") as stream:
            size = path.stat().st_size
            self.content: Any = b""
            if size:
                self.content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    def skip(self, size: int) -> int:
        """Pass ``size`` bytes; returns where they begin."""
        if self.at + size > len(self.content):
            raise not_of_format(self.path, f"it is cut short: {len(self.content)} bytes, and a "
                                f"record from byte {self.at} on needs {size}")  # fmt: skip
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

    def end(self) -> None:
        """Refuse what stands behind the last record."""
        if rest := len(self.content) - self.at:
            raise not_of_format(self.path, f"{rest} bytes stand behind its last record: it is "
                                "damaged, or of another version")  # fmt: skip
