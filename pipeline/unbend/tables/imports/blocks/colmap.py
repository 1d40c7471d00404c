"""COLMAP: sparse models as text or binary files, and databases.

Pixels are those of this package: the centre of the upper left pixel is (0.5, 0.5), x counts to the
right, y down. A pose turns and moves from the frame of the model to the camera, which has x right,
y down, z forward. A point is the number of its point3D; keypoints without one, and all of a
database, are called ``image:index``. Files are streamed, and read without pycolmap, which accepts a
file of cameras that is cut off. The readers are tested with files that pycolmap writes.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

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
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)
"""Name and number of parameters of each camera model, in the order of COLMAP's numbers."""
_PRIOR_WGS84 = 0  # coordinate_system of a pose prior
_PRIOR_CARTESIAN = 1
_PRIOR_SYSTEMS = (_PRIOR_WGS84, _PRIOR_CARTESIAN)  # others are unknown
POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


def block_files(path: Path) -> tuple[Path, ...]:
    """The database or file of cameras itself; of a folder its cameras, images and points3D.

    These three, in this order, are binary files where images.bin exists, else texts.
    """
    if not path.is_dir():
        return (path,)
    ending = ".bin" if (path / "images.bin").is_file() else ".txt"
    files = tuple(path / f"{name}{ending}" for name in ("cameras", "images", "points3D"))
    for file in files:
        if not file.is_file():
            raise messages.file_of_model_missing(where=file, name=file.name)
    return files


@dataclass(frozen=True)
class _CameraRecord:
    """A camera as a file has it; ``line`` is its line in a text, None in other files."""

    number: str
    model: str
    width: float
    height: float
    parameters: Sequence[float]
    line: int | None = None

    def camera(self) -> Camera:
        """Make the camera; an error names its line in a text."""
        try:
            return camera_of_model(
                self.model,
                int(self.width),
                int(self.height),
                [*self.parameters],
            )
        except PhysicsError as error:
            if self.line is None:
                raise
            raise error.as_kind(PhysicsError, where=f"line {self.line}") from None


def read_cameras(path: Path) -> CameraMakers:
    """The cameras of a model, a cameras.txt or cameras.bin, or a database, by their numbers."""
    records = _cameras(block_files(path)[0])
    return {record.number: record.camera for record in records}


@dataclass(frozen=True, eq=False)
class _ImageRecord:
    """An image of a model: its keypoints ``xy`` (n, 2) [px] and their point3D (n,), -1 for none.

    ``pose`` (7,) is quaternion w, x, y, z and translation, from the model to the camera.
    """

    name: str
    camera: str
    pose: Array
    xy: Array
    point: Integers


def read_images(path: Path) -> OrientationTable:
    """The images of a model; refuses a database, which has no orientations."""
    names = []
    cameras = []
    poses = []
    for image in _images(path):
        names.append(image.name)
        cameras.append(image.camera)
        poses.append(image.pose)
    pose = np.array(poses).reshape(-1, 7)
    quaternion = pose[:, :4]
    translation = pose[:, 4:]
    centre = -np.einsum("nji,nj->ni", matrices_of(quaternion), translation)
    table = oriented_images(names, cameras, centre, quaternion)
    return replace(table, notes=notes_on_texts(_files_of_model(path), len(names)))


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The pose priors of a database, one entry for each coordinate system; none of a model.

    Priors on WGS 84, as of EXIF, become latitude, longitude [rad] and height [m]; others are x, y,
    z in the frame of the model.
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
    """Coordinate system, of `_PRIOR_SYSTEMS` -> image -> its prior (3,), in the file's units."""
    query = (
        "SELECT images.name, position, coordinate_system FROM pose_priors JOIN images ON "
        "{key} = images.image_id WHERE position IS NOT NULL"
    )
    priors: dict[int, dict[str, Array]] = {}
    with closing(open_database(path)) as database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(pose_priors)")]
        if "position" not in columns:
            return priors  # a database of COLMAP before 3.8
        key = "corr_data_id" if "corr_data_id" in columns else "pose_priors.image_id"
        for name, blob, system in database.execute(query.format(key=key)):
            position = np.frombuffer(blob, "<f8")
            is_whole = position.size == 3 and bool(np.isfinite(position).all())
            if is_whole and system in _PRIOR_SYSTEMS:
                priors.setdefault(system, {})[name] = position
    return priors


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The keypoints of a model or a database."""
    if path.suffix.lower() == ".db":
        yield from _keypoints_of_database(path)
    else:
        for image in _images(path):
            yield rows_of_image(image.name, image.xy, image.point)


def _keypoints_of_database(path: Path) -> Iterator[pa.RecordBatch]:
    """The keypoints of a database; refuses a database without keypoints."""
    query = (
        "SELECT name, rows, cols, data FROM keypoints JOIN images USING (image_id) "
        "ORDER BY image_id"
    )
    with closing(open_database(path)) as database:
        count = 0
        for name, *shape, blob in database.execute(query):
            rows, columns = shape
            count += rows
            size = len(blob or b"")
            if columns < 2 or size != 4 * rows * columns:
                raise messages.keypoints_cut(
                    where=path,
                    image=name,
                    size=size,
                    rows=rows,
                    columns=columns,
                )
            if rows:
                keypoints = np.frombuffer(blob, "<f4").reshape(rows, -1)
                yield rows_of_image(name, keypoints[:, :2])
        if count == 0:
            pairs = database.execute("SELECT COUNT(*) FROM matches").fetchone()[0]
            raise messages.keypoints_none(where=path, pairs=pairs)


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The numbers, as text, and (p, 3) positions of the points3D of a model."""
    _, _, file = _files_of_model(path)
    numbers = []
    places = []
    if file.suffix == ".bin":
        with BinaryFile(file) as content:
            for _ in range(content.take("Q")[0]):
                number, *place, track = content.take("Q3d11xQ")  # 11 bytes: colour and error
                numbers.append(str(number))
                places.append(place)
                content.skip(8 * track)  # two integers of 32 bits for each image point
    else:
        for row in _text_rows(file, leading_words=1, fewest_fields=8):
            numbers.append(row.words[0])
            places.append(row.numbers[:3])
    names = pa.array(numbers, pa.string())
    return names, np.array(places, np.float64).reshape(-1, 3)


def _cameras(file: Path) -> Iterator[_CameraRecord]:
    """The cameras of a database, or of a binary or text file."""
    if file.suffix.lower() == ".db":
        yield from _cameras_of_database(file)
    elif file.suffix.lower() == ".bin":
        yield from _cameras_of_binary(file)
    else:
        for row in _text_rows(file, leading_words=2, fewest_fields=5):
            number, model = row.words
            width, height, *parameters = row.numbers
            yield _CameraRecord(
                number,
                model,
                width,
                height,
                parameters,
                line=row.line,
            )


def _cameras_of_database(file: Path) -> Iterator[_CameraRecord]:
    query = "SELECT camera_id, model, width, height, params FROM cameras"
    with closing(open_database(file)) as database:
        for number, code, *size, blob in database.execute(query):
            width, height = size
            model, _ = _camera_model(code, file)
            parameters = np.frombuffer(blob, "<f8").tolist()
            yield _CameraRecord(str(number), model, width, height, parameters)


def _cameras_of_binary(file: Path) -> Iterator[_CameraRecord]:
    with BinaryFile(file) as content:
        for _ in range(content.take("Q")[0]):
            number, code, *size = content.take("iiQQ")
            width, height = size
            model, count = _camera_model(code, file)
            parameters = content.take(f"{count}d")
            yield _CameraRecord(str(number), model, width, height, parameters)


def _images(path: Path) -> Iterator[_ImageRecord]:
    """The images of a model, one after the other."""
    file = _files_of_model(path)[1]
    if file.suffix == ".bin":
        yield from _images_of_binary(file)
    else:
        yield from _images_of_text(path, file)


def _images_of_binary(file: Path) -> Iterator[_ImageRecord]:
    with BinaryFile(file) as content:
        for _ in range(content.take("Q")[0]):
            _, *pose, camera = content.take("i7di")
            name = content.word()
            count = content.take("Q")[0]
            record = content.array(POINT2D, count)
            yield _ImageRecord(
                name=name,
                camera=str(camera),
                pose=np.array(pose),
                xy=record["xy"],
                point=record["point"],
            )


def _images_of_text(path: Path, file: Path) -> Iterator[_ImageRecord]:
    """The images of images.txt (``file``), two lines for each; ``path`` is the model's folder.

    Refuses an image with a camera that cameras.txt does not have.
    """
    cameras = {record.number for record in _cameras(_files_of_model(path)[0])}
    count = 0
    with TextFile(file) as lines:
        rows = iter(lines)
        for head in rows:
            if not head or head.startswith("#"):
                continue
            _, *pose, camera, name = head.split(maxsplit=9)
            if camera not in cameras:
                raise messages.camera_of_image_unknown(
                    where=file,
                    line=lines.number,
                    image=name,
                    camera=camera,
                )
            count += 1
            pose_of_image = np.array(pose, np.float64).reshape(7)
            points = np.array(next(rows, "").split(), np.float64).reshape(-1, 3)
            yield _ImageRecord(
                name=name,
                camera=camera,
                pose=pose_of_image,
                xy=points[:, :2],
                point=_object_points(points[:, 2]),
            )
    refuse_missing_records(file, count)


UNSET_POINT = 2.0**64  # as float: COLMAP's 2**64 - 1 for no point, where scripts write it unsigned


def _object_points(numbers: Array) -> Integers:
    """(n,) numbers of object points as integers, -1 for none; ValueError for other numbers."""
    return exact_integers(np.where(numbers == UNSET_POINT, -1.0, numbers))


@dataclass(frozen=True)
class _TextRow:
    """A line of a text: its number, its first words, and the numbers after these."""

    line: int
    words: list[str]
    numbers: list[float]


def _text_rows(file: Path, *, leading_words: int, fewest_fields: int) -> Iterator[_TextRow]:
    """The lines of a text, without comments: as many words as ``leading_words``, then numbers.

    Refuses lines with fewer fields than ``fewest_fields``, and a text that is cut off.
    """
    count = 0
    with TextFile(file) as lines:
        for line in lines:
            if not line or line.startswith("#"):
                continue
            fields = line.split()
            if len(fields) < fewest_fields:
                raise ValueError
            count += 1
            numbers = [float(field) for field in fields[leading_words:]]
            yield _TextRow(lines.number, fields[:leading_words], numbers)
    refuse_missing_records(file, count)


def _files_of_model(path: Path) -> tuple[Path, ...]:
    """The files of cameras, images and points3D in a model's folder; refuses other paths."""
    if not path.is_dir():
        raise messages.not_a_model(where=path)
    return block_files(path)


def _camera_model(code: int, path: Path) -> tuple[str, int]:
    """The name of the camera model with a number, and how many parameters it has.

    Refuses a number that only later versions of COLMAP have.
    """
    if not 0 <= code < len(_MODELS):
        raise messages.colmap_model_unknown(where=path, number=code, last=len(_MODELS) - 1)
    return _MODELS[code]


def open_database(path: Path) -> sqlite3.Connection:
    """Open a database for reading only; refuses it while rows are still in its write-ahead log."""
    log = Path(f"{path}-wal")
    if log.is_file() and log.stat().st_size:
        raise messages.database_in_use(where=path, log=log.name)
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
