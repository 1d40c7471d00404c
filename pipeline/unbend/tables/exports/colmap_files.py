"""COLMAP's files: a sparse model in binary, and a database ready to adjust.

COLMAP's pixels are those of the package: the centre of the upper left pixel is (0.5, 0.5). A pose
turns and moves from the frame of the block to the camera (x right, y down, z forward). Images are
numbered in the order of the stations, from 1. A point whose name is a positive number keeps it as
its id; others are numbered after the largest of these, and ``points.csv`` beside the model has
their names. A point that was measured in one image only is an image point without object point:
an adjustment could not determine it.

Tables of the database are those of COLMAP 4.2 (``colmap_4_2.sql``); image points keep their places
as keypoints. Keypoints are 32-bit numbers there: up to 16,384 px they lose at most 0.0005 px, which
the model does not. Points tie each pair of their images (matches and verified geometries); where
the run read a database, its own matches and geometries are copied, and its rigs and frames. Pose
priors are the stations' positions with the covariance of their sigmas. That refraction was removed
stands in a table of its own, which COLMAP leaves alone.
"""

import sqlite3
import struct
from collections.abc import Mapping, Sequence
from contextlib import closing
from importlib import resources
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import messages
from unbend.tables.exports.colmap_matches import Row, copied_rows, match_rows
from unbend.tables.exports.colmap_rigs import CAMERA_SENSOR, rig_tables
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, Values, write_csv_stream
from unbend.tables.exports.export_frames import (
    CORNER_PIXELS,
    OF_COMPUTER_VISION,
    ExportFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import ExportedBlock, add_counts_of_block, block_of
from unbend.tables.imports.blocks.colmap import POINT2D
from unbend.tables.refraction_mark import MARK_TABLE, REFRACTION_KEY, REFRACTION_REMOVED
from unbend.units import Array, Integers

_USE = (
    "COLMAP corrects neither refraction nor earth curvature: nothing must be switched off in it; "
    "it is best to keep its calibration fixed"
)

_MODEL_IDS = {"PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}

_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_OF_GENERAL_FRAME = {
    "q1": "k4",
    "q2": "k5",
    "q3": "k6",
    "px": "p2",
    "py": "p1",
    "k4": "k4 r^8",
}
_GREY = (128, 128, 128)  # red, green and blue of every point
_NO_ERROR = -1.0  # COLMAP's sign that the error of a point is not known yet

_VERSION = 4_020_100
_CARTESIAN = 1  # coordinate system of a pose prior
_WITH_PRIOR = 1  # the focal length of a camera is known
_NO_MATRICES = ", NULL" * 7  # columns of a geometry behind its configuration
_LARGEST_ROUNDING_PX = 0.0005


def opencv_coefficients(
    camera: Camera, name: str, program: str, holds: Sequence[str]
) -> dict[str, float]:
    """OpenCV's coefficients of a frame camera, without those that are zero.

    Refuses (MissionError EXPORT-DISTORTION) what is not among those that a program ``holds``, and
    what OpenCV has not: Metashape's k4, b1 and b2, and polynomials that correct what was measured.
    """
    coefficients = camera.distortion._asdict()
    renamed: Mapping[str, str] = {}
    if isinstance(camera.distortion, GeneralFrame):
        coefficients["sense"] -= 1.0
        del coefficients["limit"]
        del coefficients["steps"]
        renamed = _OF_GENERAL_FRAME
    in_use = {}
    for own_name, value in coefficients.items():
        if value != 0.0:
            in_use[renamed.get(own_name, own_name)] = value
    beyond = [key for key in in_use if key not in holds]
    if beyond:
        raise messages.distortion_unknown(
            where=f"cameras.{name}",
            name=name,
            beyond=", ".join(beyond),
            program=program,
        )
    return in_use


def colmap_camera(camera: Camera, name: str, *, simplest: bool = True) -> tuple[str, list[float]]:
    """COLMAP's model and parameters of a camera, the simplest that is exact or the fullest.

    >>> colmap_camera(Camera(1000, 800, 900.0, 900.0, 500.0, 400.0), "nadir")
    ('PINHOLE', [900.0, 900.0, 500.0, 400.0])
    """
    frame = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    if isinstance(camera.distortion, OpenCVFisheye):
        return "OPENCV_FISHEYE", [*frame, *camera.distortion]
    coefficients = opencv_coefficients(camera, name, "COLMAP", _OPENCV)
    places = [_OPENCV.index(key) for key in coefficients]
    last = max(places, default=-1) if simplest else len(_OPENCV) - 1
    if last < 0:
        return "PINHOLE", frame
    model = "FULL_OPENCV"
    names: Sequence[str] = _OPENCV
    if last < 4:
        model = "OPENCV"
        names = _OPENCV[:4]
    distortion = [coefficients.get(key, 0.0) for key in names]
    return model, [*frame, *distortion]


def note_cameras(block: ExportedBlock, ledger: Ledger) -> None:
    """Note which number each camera has."""
    numbers = [f"{number} {name}" for number, name in enumerate(block.cameras, start=1)]
    note = messages.camera_numbers(
        where="cameras",
        count=len(numbers),
        numbers=", ".join(numbers),
    )
    ledger.add(note)


def point_ids(block: ExportedBlock, folder: Path) -> Integers:
    """(p,) numbers of points; writes points.csv with the names of those that are no numbers."""
    is_number = pc.match_substring_regex(block.name, "^[1-9][0-9]{0,17}$")
    ids = np.array(pc.if_else(is_number, block.name, "0").cast(pa.int64()))
    other = np.flatnonzero(ids == 0)
    ids[other] = ids.max(initial=0) + 1 + np.arange(other.size)
    if other.size:
        table = pa.table({"id": ids[other], "point": block.name.take(pa.array(other))})
        write_csv_stream(folder / "points.csv", table.schema, [table])
    return ids


def write_model(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """The three files of a model and, where names are no numbers, points.csv."""
    block = block_of(run, ledger)
    add_counts_of_block(block, ledger)
    note_cameras(block, ledger)
    ids = point_ids(block, folder)
    tied = len(block.point_m)
    ids[tied:] = -1
    if tied < ids.size:
        single = messages.single_points(
            where="observations",
            count=ids.size - tied,
            total=block.point.size,
        )
        ledger.add(single)
    _write_cameras(block, folder / "cameras.bin")
    _write_images(block, ids, folder / "images.bin")
    _write_points(block, ids, folder / "points3D.bin")
    return int(block.point.size)


def _write_cameras(block: ExportedBlock, path: Path) -> None:
    with path.open("wb") as file:
        file.write(struct.pack("<Q", len(block.cameras)))
        for number, (name, camera) in enumerate(block.cameras.items(), start=1):
            model, parameters = colmap_camera(camera, name)
            head = struct.pack(
                "<iiQQ",
                number,
                _MODEL_IDS[model],
                camera.width_px,
                camera.height_px,
            )
            file.write(head)
            file.write(np.array(parameters, "<f8").tobytes())


def _write_images(block: ExportedBlock, ids: Integers, path: Path) -> None:
    """Poses of the images with their image points; ``ids`` (p,) of the points, -1 for none."""
    moved_m = block.moved_m
    with path.open("wb") as file:
        file.write(struct.pack("<Q", block.image.size))
        for i, _camera, here in block.images():
            points = np.empty(here.stop - here.start, POINT2D)
            points["xy"] = np.stack([block.x_px[here], block.y_px[here]], axis=1)
            points["point"] = ids[block.point[here]]
            head = struct.pack(
                "<i7di",
                i + 1,
                *block.frame.quaternion[i],
                *moved_m[i],
                block.camera[i] + 1,
            )
            file.write(head)
            file.write(block.image[i].encode() + b"\0")
            file.write(struct.pack("<Q", points.size))
            file.write(points.tobytes())


def _write_points(block: ExportedBlock, ids: Integers, path: Path) -> None:
    """Object points, each with its track: its images, and its number in each of these."""
    rows, begin, images = block.image_points_by_point()
    place_in_image = rows - block.first[images]
    tracks = np.stack([images + 1, place_in_image], axis=1).astype("<i4")
    with path.open("wb") as file:
        file.write(struct.pack("<Q", len(block.point_m)))
        for point, position_m in enumerate(block.point_m):
            track = tracks[begin[point] : begin[point + 1]]
            head = struct.pack(
                "<Q3d3BdQ",
                ids[point],
                *position_m,
                *_GREY,
                _NO_ERROR,
                len(track),
            )
            file.write(head + track.tobytes())


def write_database(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """The database of a block; the number of keypoints."""
    block = block_of(run, ledger, intersect=False)
    add_counts_of_block(block, ledger)
    note_cameras(block, ledger)
    source = run.database()
    tables = rows_of_tables(block) | rig_tables(block, source, ledger)
    unknown = int(np.isnan(block.frame.covariance_m2).any(axis=(1, 2)).sum())
    if unknown:
        ledger.add(messages.sigmas_missing(where="stations.parquet", count=unknown))
    rounding = max(_rounding_of(block.x_px), _rounding_of(block.y_px))
    if rounding > _LARGEST_ROUNDING_PX:
        ledger.add(messages.pixels_rounded(where="keypoints", rounding=rounding))
    with closing(sqlite3.connect(path)) as database:
        _create_tables(database)
        for table, rows in tables.items():
            marks = ", ".join("?" * len(rows[0]))
            database.executemany(f"INSERT INTO {table} VALUES ({marks})", rows)
        _insert_keypoints(database, block)
        tied = _insert_matches(database, block, source)
        database.commit()
    if not tied:
        ledger.add(messages.no_ties(where="observations"))
    return int(block.point.size)


def _rounding_of(pixels: Array) -> float:
    """The most [px] that coordinates lose as numbers of 32 bits."""
    return float(np.abs(pixels - pixels.astype("<f4")).max(initial=0.0))


def _create_tables(database: sqlite3.Connection) -> None:
    """COLMAP's tables and the one of the mark, all empty."""
    schema = resources.files("unbend.tables.exports").joinpath("colmap_4_2.sql")
    # A draft that is interrupted is thrown away: no journal.
    database.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")
    database.execute(f"PRAGMA user_version = {_VERSION}")
    database.executescript(schema.read_text(encoding="utf-8"))
    database.execute(f"CREATE TABLE {MARK_TABLE} (key TEXT PRIMARY KEY, value TEXT)")


def _insert_keypoints(database: sqlite3.Connection, block: ExportedBlock) -> None:
    for i, _camera, here in block.images():
        xy = np.stack([block.x_px[here], block.y_px[here]], axis=1).astype("<f4")
        keypoints = (i + 1, len(xy), xy.tobytes())
        database.execute("INSERT INTO keypoints VALUES (?, ?, 2, ?)", keypoints)


def _insert_matches(
    database: sqlite3.Connection,
    block: ExportedBlock,
    source: Path | None,
) -> int:
    """Matches and geometries, those of the database that was read or new ones; how many rows."""
    pairs = match_rows(block) if source is None else copied_rows(block, source)
    count = 0
    for table, *row in pairs:
        marks = "?, ?, 2, ?"
        if table != "matches":
            marks += ", ?" + _NO_MATRICES
        database.execute(f"INSERT INTO {table} VALUES ({marks})", row)
        count += 1
    return count


def rows_of_tables(block: ExportedBlock) -> dict[str, list[Row]]:
    """Rows of the tables that have one for each camera or image, and the mark."""
    mark = (REFRACTION_KEY.decode(), REFRACTION_REMOVED.decode())
    images = []
    priors = []
    for number, camera in enumerate(block.camera.tolist(), start=1):
        images.append((number, block.image[number - 1], camera + 1))
        priors.append(_pose_prior(block, number, camera + 1))
    return {
        MARK_TABLE: [mark],
        "cameras": _rows_of_cameras(block),
        "images": images,
        "pose_priors": priors,
    }


def _rows_of_cameras(block: ExportedBlock) -> list[Row]:
    rows = []
    for number, (name, camera) in enumerate(block.cameras.items(), start=1):
        model, parameters = colmap_camera(camera, name)
        row = (
            number,
            _MODEL_IDS[model],
            camera.width_px,
            camera.height_px,
            np.array(parameters, "<f8").tobytes(),
            _WITH_PRIOR,
        )
        rows.append(row)
    return rows


def _pose_prior(block: ExportedBlock, number: int, camera: int) -> Row:
    """The row of the pose prior of an image: its position and covariance, gravity unknown."""
    unknown_gravity = np.full(3, np.nan)
    return (
        number,
        number,
        camera,
        CAMERA_SENSOR,
        block.frame.position_m[number - 1].tobytes(),
        block.frame.covariance_m2[number - 1].tobytes(),
        unknown_gravity.tobytes(),
        _CARTESIAN,
    )


def frame_of_model(run: FinishedRun, _: Values) -> ExportFrame:
    """East, north, up at the origin, quaternions, pixels from the corner."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("quaternion_wxyz", OF_COMPUTER_VISION),
        pixels=CORNER_PIXELS,
    )


def frame_of_database(run: FinishedRun, _: Values) -> ExportFrame:
    """Pose priors east, north, up at the origin, and pixels from the corner; no attitudes."""
    return ExportFrame(positions=block_positions(run.stations), pixels=CORNER_PIXELS)


FORMATS = (
    ExportFormat(
        "colmap",
        "a block for COLMAP: a folder with its sparse model",
        "",
        write_model,
        frame_of_model,
        use=_USE,
        marked=("images.bin",),
    ),
    ExportFormat(
        "colmap-database",
        "a block for COLMAP: database with matches and pose priors",
        ".db",
        write_database,
        frame_of_database,
        use=_USE,
        marked=("",),
    ),
)
