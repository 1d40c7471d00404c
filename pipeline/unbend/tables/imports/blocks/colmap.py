"""COLMAP: sparse models as text or binary files, and databases.

Pixels are those of this package: the centre of the upper left pixel is (0.5, 0.5), x counts to the
right, y down. A pose turns and moves from the frame of the model to the camera, which has x right,
y down, z forward. A point is the number of its point3D; keypoints without one, and all of a
database, are called ``image:index``. Read without pycolmap, which takes a camera file that is cut
short without a word, streamed, and tested against what pycolmap writes.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from unbend.block.known_places import KnownPlaces
from unbend.errors import PhysicsError
from unbend.flight.rotations import matrices_of
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.colmap_texts import notes_on_texts, refuse_missing_records
from unbend.tables.imports.blocks.image_points import (
    BinaryFile,
    CameraMakers,
    TextFile,
    oriented_images,
    rows_of_image,
)
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array, Integers, exact_integers

_MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)  # fmt: skip
_PRIOR_WGS84 = 0  # coordinate_system of a pose prior
_PRIOR_CARTESIAN = 1
_PRIOR_SYSTEMS = (_PRIOR_WGS84, _PRIOR_CARTESIAN)  # others are unknown
POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


def block_files(path: Path) -> tuple[Path, ...]:
    """The database, a file of cameras, or cameras, images and points3D of a model's folder."""
    if not path.is_dir():
        return (path,)
    ending = ".bin" if (path / "images.bin").is_file() else ".txt"
    files = tuple(path / f"{name}{ending}" for name in ("cameras", "images", "points3D"))
    for file in files:
        if not file.is_file():
            raise messages.file_of_model_missing(where=file, name=file.name)
    return files


def read_cameras(path: Path) -> CameraMakers:
    """The cameras of a model, a cameras.txt or cameras.bin, or a database, by their numbers."""

    def camera(line: int | None, model: str, width: float, height: float, *p: float) -> Camera:
        try:
            return camera_of_model(model, int(width), int(height), [*map(float, p)])
        except PhysicsError as error:
            if line is None:
                raise
            raise error.again(PhysicsError, f"line {line}") from None

    rows = _cameras(block_files(path)[0])
    return {str(number): partial(camera, line, *row) for line, number, *row in rows}


def read_images(path: Path) -> OrientationTable:
    """The images of a model; refuses a database, which orients none."""
    images = [image[:3] for image in _images(path)]
    names = [name for name, _, _ in images]
    cameras = [camera for _, camera, _ in images]
    pose = np.array([pose for _, _, pose in images]).reshape(-1, 7)
    centre = -np.einsum("nji,nj->ni", matrices_of(pose[:, :4]), pose[:, 4:])
    table = oriented_images(names, cameras, centre, pose[:, :4])
    return replace(table, notes=notes_on_texts(_of_model(path), len(images)))


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The pose priors of a database; those of EXIF are latitude, longitude and height.

    Others are x, y, z in the frame of the model. A model has none.
    """
    if path.suffix.lower() != ".db":
        return ()
    places = []
    for system, position_of_image in _priors(path).items():
        position = np.array([*position_of_image.values()])
        in_frame = system == _PRIOR_CARTESIAN
        if not in_frame:
            position[:, :2] = np.radians(position[:, :2])
        image = np.array([*position_of_image], object)
        places.append(KnownPlaces("pose priors", image, position, in_frame=in_frame))
    return tuple(places)


def _priors(path: Path) -> dict[int, dict[str, Array]]:
    """The positions of images of a database, by their coordinate systems and names."""
    query = (
        "SELECT images.name, position, coordinate_system FROM pose_priors JOIN images ON "
        "{key} = images.image_id WHERE position IS NOT NULL"
    )
    priors: dict[int, dict[str, Array]] = {}
    with closing(opened(path)) as database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(pose_priors)")]
        if "position" not in columns:
            return priors  # of COLMAP before 3.8
        key = "corr_data_id" if "corr_data_id" in columns else "pose_priors.image_id"
        for name, blob, system in database.execute(query.format(key=key)):
            position = np.frombuffer(blob, "<f8")
            is_whole = position.size == 3 and bool(np.isfinite(position).all())
            if is_whole and system in _PRIOR_SYSTEMS:
                priors.setdefault(system, {})[name] = position
    return priors


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The keypoints of a model or a database."""
    if path.suffix.lower() != ".db":
        for name, _, _, xy, point in _images(path):
            yield rows_of_image(name, xy, point)
        return
    query = "SELECT name, rows, cols, data FROM keypoints JOIN images USING (image_id)"
    with closing(opened(path)) as database:
        count = 0
        for name, rows, columns, blob in database.execute(f"{query} ORDER BY image_id"):
            count += rows
            if columns < 2 or len(blob or b"") != 4 * rows * columns:
                raise messages.keypoints_cut(
                    where=path, image=name, size=len(blob or b""), rows=rows, columns=columns
                )
            if rows:
                yield rows_of_image(name, np.frombuffer(blob, "<f4").reshape(rows, -1)[:, :2])
        if count == 0:
            pairs = database.execute("SELECT COUNT(*) FROM matches").fetchone()[0]
            raise messages.keypoints_none(where=path, pairs=pairs)


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The points3D of a model."""
    file = _of_model(path)[2]
    numbers, places = [], []
    if file.suffix == ".bin":
        with BinaryFile(file) as content:
            for _ in range(content.take("Q")[0]):
                number, *place, track = content.take("Q3d11xQ")
                numbers.append(str(number))
                places.append(place)
                content.skip(8 * track)
    else:
        for _, number, x, y, z, *_ in _text_rows(file, words=1, least=8):
            numbers.append(number)
            places.append([x, y, z])
    return pa.array(numbers, pa.string()), np.array(places, np.float64).reshape(-1, 3)


def _cameras(file: Path) -> Iterator[Sequence[Any]]:
    """Line in a text, else None; number, model, width, height and parameters of each camera."""
    if file.suffix.lower() == ".db":
        query = "SELECT camera_id, model, width, height, params FROM cameras"
        with closing(opened(file)) as database:
            for number, code, width, height, blob in database.execute(query):
                model, _ = _model(code, file)
                yield None, number, model, width, height, *np.frombuffer(blob, "<f8")
    elif file.suffix.lower() == ".bin":
        with BinaryFile(file) as content:
            for _ in range(content.take("Q")[0]):
                number, code, width, height = content.take("iiQQ")
                model, count = _model(code, file)
                yield None, number, model, width, height, *content.take(f"{count}d")
    else:
        yield from _text_rows(file, words=2, least=5)


def _images(path: Path) -> Iterator[tuple[str, str, Array, Array, Integers]]:
    """Name, camera, pose (7,), keypoints (n, 2) and their point3D, -1 for none, of each image."""
    file = _of_model(path)[1]
    if file.suffix == ".bin":
        with BinaryFile(file) as content:
            for _ in range(content.take("Q")[0]):
                _, *numbers, camera = content.take("i7di")
                name = content.word()
                record = content.array(POINT2D, content.take("Q")[0])
                yield name, str(camera), np.array(numbers), record["xy"], record["point"]
        return
    count, cameras = 0, {str(number) for _, number, *_ in _cameras(_of_model(path)[0])}
    with TextFile(file) as lines:
        rows = iter(lines)
        for head in rows:
            if head and not head.startswith("#"):
                _, *numbers, camera, name = head.split(maxsplit=9)
                if camera not in cameras:
                    raise messages.camera_of_image_unknown(
                        where=file, line=lines.number, image=name, camera=camera
                    )
                pose, count = np.array(numbers, np.float64).reshape(7), count + 1
                points = np.array(next(rows, "").split(), np.float64).reshape(-1, 3)
                yield name, camera, pose, points[:, :2], _object_points(points[:, 2])
    refuse_missing_records(file, count)


UNSET_POINT = 2.0**64  # COLMAP's 2**64 - 1 for none, as scripts write it that read it unsigned


def _object_points(numbers: Array) -> Integers:
    """The numbers of object points in a text, -1 for none; ValueError for what is no number."""
    return exact_integers(np.where(numbers == UNSET_POINT, -1.0, numbers))


def _text_rows(file: Path, *, words: int, least: int) -> Iterator[list[Any]]:
    """Number and fields, at least so many, of lines that are no comments: words, then numbers."""
    count = 0
    with TextFile(file) as lines:
        for fields in (line.split() for line in lines if line and not line.startswith("#")):
            if len(fields) < least:
                raise ValueError
            count += 1
            yield [lines.number, *fields[:words], *map(float, fields[words:])]
    refuse_missing_records(file, count)


def _of_model(path: Path) -> tuple[Path, ...]:
    if not path.is_dir():
        raise messages.not_a_model(where=path)
    return block_files(path)


def _model(code: int, path: Path) -> tuple[str, int]:
    """Name of a camera model, and how many parameters it has; refuses one of a later version."""
    if not 0 <= code < len(_MODELS):
        raise messages.colmap_model_unknown(where=path, number=code, last=len(_MODELS) - 1)
    return _MODELS[code]


def opened(path: Path) -> sqlite3.Connection:
    """A database for reading only; refuses one with rows that are still in the log beside it."""
    log = Path(f"{path}-wal")
    if log.is_file() and log.stat().st_size:
        raise messages.database_in_use(where=path, log=log.name)
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
