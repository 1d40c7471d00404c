"""COLMAP's files: a sparse model in binary, and a database ready to adjust.

COLMAP's pixels are those of the package: the centre of the upper left pixel is (0.5, 0.5). A pose
turns and moves from the frame of the block to the camera (x right, y down, z forward). Images are
numbered in the order of the stations, from 1. If the name of a point is a positive number, it is
its id; others are numbered after the largest of these, and ``points.csv`` in the model's folder has
their names. A point that was measured in one image only is an image point without object point:
an adjustment could not determine it.

Tables of the database are those of COLMAP 4.2 (``colmap_4_2.sql``); image points keep their places
as keypoints. Keypoints are 32-bit numbers there: up to 16,384 px they lose at most 0.0005 px, which
the model does not. Points tie each pair of their images (matches and verified geometries); where
the run read a database, its own matches and geometries are copied, and its rigs and frames. Pose
priors are the stations' positions with the covariance of their sigmas. An additional table, which
COLMAP ignores, marks that refraction was removed.
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
    COMPUTER_VISION_AXES,
    CORNER_PIXELS,
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
"""Coefficients of FULL_OPENCV in its order; the first four are those of OPENCV."""

_OPENCV_NAMES = {
    "q1": "k4",
    "q2": "k5",
    "q3": "k6",
    "px": "p2",
    "py": "p1",
    "k4": "k4 r^8",
}
"""OpenCV's names of coefficients of `GeneralFrame`; of k4, which OpenCV does not have, a name for
messages: OpenCV's k4 is another coefficient."""

_GREY = (128, 128, 128)  # red, green and blue of every point
_NO_ERROR = -1.0  # COLMAP's sign that the error of a point is not known yet

_VERSION = 4_020_100  # of the database, as COLMAP 4.2 writes it
_CARTESIAN = 1  # coordinate system of a pose prior
_WITH_PRIOR = 1  # the focal length of a camera is known
_NO_MATRICES = ", NULL" * 7  # F, E, H, qvec, tvec, camera1, camera2 of a two-view geometry
_LARGEST_ROUNDING_PX = 0.0005  # that is not reported


def opencv_coefficients(
    camera: Camera, name: str, program: str, supported: Sequence[str]
) -> dict[str, float]:
    """The distortion of a frame camera by OpenCV's names of coefficients, without zeros.

    Refuses (MissionError EXPORT-DISTORTION) coefficients that are not ``supported`` by the program,
    and those that OpenCV does not have: Metashape's k4, b1 and b2, and polynomials that correct
    measured points. ``name`` of the camera and ``program`` are for the message.
    """
    coefficients = camera.distortion._asdict()
    renamed: Mapping[str, str] = {}
    if isinstance(camera.distortion, GeneralFrame):
        coefficients["sense"] -= 1.0  # 0 for OpenCV's sense, else refused as a coefficient
        del coefficients["limit"]
        del coefficients["steps"]
        renamed = _OPENCV_NAMES
    nonzero = {}
    for key, value in coefficients.items():
        if value != 0.0:
            nonzero[renamed.get(key, key)] = value
    unsupported = [key for key in nonzero if key not in supported]
    if unsupported:
        raise messages.distortion_unknown(
            where=f"cameras.{name}",
            name=name,
            beyond=", ".join(unsupported),
            program=program,
        )
    return nonzero


def colmap_camera(camera: Camera, name: str, *, simplest: bool = True) -> tuple[str, list[float]]:
    """COLMAP's model and parameters of a camera; ``name`` is for messages.

    ``simplest`` : of PINHOLE, OPENCV and FULL_OPENCV the one with the fewest parameters that is
    exact; False: FULL_OPENCV. A fisheye is OPENCV_FISHEYE. Refuses as `opencv_coefficients` does.

    >>> colmap_camera(Camera(1000, 800, 900.0, 900.0, 500.0, 400.0), "nadir")
    ('PINHOLE', [900.0, 900.0, 500.0, 400.0])
    """
    frame = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    if isinstance(camera.distortion, OpenCVFisheye):
        return "OPENCV_FISHEYE", [*frame, *camera.distortion]
    coefficients = opencv_coefficients(camera, name, "COLMAP", _OPENCV)
    if simplest and not coefficients:
        return "PINHOLE", frame
    model = "FULL_OPENCV"
    names: Sequence[str] = _OPENCV
    if simplest and coefficients.keys() <= set(_OPENCV[:4]):
        model = "OPENCV"
        names = _OPENCV[:4]
    distortion = [coefficients.get(key, 0.0) for key in names]
    return model, [*frame, *distortion]


def note_cameras(block: ExportedBlock, ledger: Ledger) -> None:
    """Add to the ledger which number, from 1, each camera of the block has in COLMAP."""
    numbers = [f"{number} {name}" for number, name in enumerate(block.cameras, start=1)]
    note = messages.camera_numbers(
        where="cameras",
        count=len(numbers),
        numbers=", ".join(numbers),
    )
    ledger.add(note)


def point_ids(block: ExportedBlock, folder: Path) -> Integers:
    """(p,) ids of the points: names that are positive numbers, new numbers for other names.

    Writes ``points.csv`` with the ids and names of the points with new numbers, if there are any.
    """
    is_number = pc.match_substring_regex(block.point_name, "^[1-9][0-9]{0,17}$")
    ids = np.array(pc.if_else(is_number, block.point_name, "0").cast(pa.int64()))
    renumbered = np.flatnonzero(ids == 0)
    ids[renumbered] = ids.max(initial=0) + 1 + np.arange(renumbered.size)
    if renumbered.size:
        names = block.point_name.take(pa.array(renumbered))
        table = pa.table({"id": ids[renumbered], "point": names})
        write_csv_stream(folder / "points.csv", table.schema, [table])
    return ids


def write_model(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """Write the three files of a sparse model, and points.csv if names are not numbers.

    Returns the number of image points.
    """
    block = block_of(run, ledger)
    add_counts_of_block(block, ledger)
    note_cameras(block, ledger)
    ids = point_ids(block, folder)
    object_points = len(block.point_m)
    ids[object_points:] = -1  # COLMAP's id of an image point without object point
    if object_points < ids.size:
        single_points = messages.single_points(
            where="observations",
            count=ids.size - object_points,
            total=block.point.size,
        )
        ledger.add(single_points)
    _write_cameras(block, folder / "cameras.bin")
    _write_images(block, ids, folder / "images.bin")
    _write_points(block, ids, folder / "points3D.bin")
    return int(block.point.size)


def _write_cameras(block: ExportedBlock, path: Path) -> None:
    """Write cameras.bin: number from 1, model, size and parameters of each camera."""
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
    """Write images.bin: the poses of the images, with their image points.

    ``ids`` (p,) of the points, -1 for image points without object point.
    """
    translation_m = block.translation_m
    with path.open("wb") as file:
        file.write(struct.pack("<Q", block.image.size))
        for i, _camera, image_points in block.images():
            points = np.empty(image_points.stop - image_points.start, POINT2D)
            points["xy"] = np.stack([block.x_px[image_points], block.y_px[image_points]], axis=1)
            points["point"] = ids[block.point[image_points]]
            head = struct.pack(
                "<i7di",
                i + 1,
                *block.frame.quaternion[i],
                *translation_m[i],
                block.camera[i] + 1,
            )
            file.write(head)
            file.write(block.image[i].encode() + b"\0")
            file.write(struct.pack("<Q", points.size))
            file.write(points.tobytes())


def _write_points(block: ExportedBlock, ids: Integers, path: Path) -> None:
    """Write points3D.bin: the object points, each with the track of its image points.

    An element of a track is the number of the image, from 1, and of the image point in it, from 0.
    ``ids`` (p,) of the points.
    """
    by_point = block.image_points_by_point()
    begin = by_point.begin
    tracks = np.stack([by_point.image + 1, by_point.number_in_image], axis=1).astype("<i4")
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
    """Write the database of a block; returns the number of keypoints."""
    block = block_of(run, ledger, intersect=False)
    add_counts_of_block(block, ledger)
    note_cameras(block, ledger)
    source = run.database()
    tables = rows_of_tables(block) | rig_tables(block, source, ledger)
    without_sigma = int(np.isnan(block.frame.covariance_m2).any(axis=(1, 2)).sum())
    if without_sigma:
        ledger.add(messages.sigmas_missing(where="stations.parquet", count=without_sigma))
    rounding = max(_rounding_of(block.x_px), _rounding_of(block.y_px))
    if rounding > _LARGEST_ROUNDING_PX:
        ledger.add(messages.pixels_rounded(where="keypoints", rounding=rounding))
    with closing(sqlite3.connect(path)) as database:
        _create_tables(database)
        for table, rows in tables.items():
            placeholders = ", ".join("?" * len(rows[0]))
            database.executemany(f"INSERT INTO {table} VALUES ({placeholders})", rows)
        _insert_keypoints(database, block)
        rows_of_matches = _insert_matches(database, block, source)
        database.commit()
    if not rows_of_matches:
        ledger.add(messages.no_ties(where="observations"))
    return int(block.point.size)


def _rounding_of(pixels: Array) -> float:
    """The largest rounding error [px] of (r,) coordinates as numbers of 32 bits."""
    return float(np.abs(pixels - pixels.astype("<f4")).max(initial=0.0))


def _create_tables(database: sqlite3.Connection) -> None:
    """Create COLMAP's tables and the table of the refraction mark, all empty."""
    schema = resources.files("unbend.tables.exports").joinpath("colmap_4_2.sql")
    # No journal: an unfinished file is deleted anyway.
    database.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")
    database.execute(f"PRAGMA user_version = {_VERSION}")
    database.executescript(schema.read_text(encoding="utf-8"))
    database.execute(f"CREATE TABLE {MARK_TABLE} (key TEXT PRIMARY KEY, value TEXT)")


def _insert_keypoints(database: sqlite3.Connection, block: ExportedBlock) -> None:
    """Insert the image points of each image, x and y as 32-bit numbers, into ``keypoints``."""
    for i, _camera, image_points in block.images():
        xy = np.stack([block.x_px[image_points], block.y_px[image_points]], axis=1).astype("<f4")
        keypoints = (i + 1, len(xy), xy.tobytes())
        database.execute("INSERT INTO keypoints VALUES (?, ?, 2, ?)", keypoints)


def _insert_matches(
    database: sqlite3.Connection,
    block: ExportedBlock,
    source: Path | None,
) -> int:
    """Insert matches and two-view geometries; returns the number of rows.

    They are copied from ``source``, the database that the run read; without it they are new.
    """
    tables_and_rows = match_rows(block) if source is None else copied_rows(block, source)
    count = 0
    for table, *row in tables_and_rows:
        placeholders = "?, ?, 2, ?"  # pair, rows, columns, data
        if table == "two_view_geometries":
            placeholders += ", ?" + _NO_MATRICES
        database.execute(f"INSERT INTO {table} VALUES ({placeholders})", row)
        count += 1
    return count


def rows_of_tables(block: ExportedBlock) -> dict[str, list[Row]]:
    """Rows by table: the mark, cameras, images, pose priors. Cameras and images count from 1."""
    mark = (REFRACTION_KEY.decode(), REFRACTION_REMOVED.decode())
    images = []
    priors = []
    for i, camera in enumerate(block.camera.tolist()):
        images.append((i + 1, block.image[i], camera + 1))
        priors.append(_pose_prior(block, i))
    return {
        MARK_TABLE: [mark],
        "cameras": _rows_of_cameras(block),
        "images": images,
        "pose_priors": priors,
    }


def _rows_of_cameras(block: ExportedBlock) -> list[Row]:
    """Rows of the table ``cameras``: number from 1, model, size, parameters, known focal length."""
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


def _pose_prior(block: ExportedBlock, image: int) -> Row:
    """The pose prior of an image, a number from 0: position, covariance, unknown gravity."""
    unknown_gravity = np.full(3, np.nan)
    return (
        image + 1,  # id of the prior
        image + 1,  # id of the image
        int(block.camera[image]) + 1,
        CAMERA_SENSOR,
        block.frame.position_m[image].tobytes(),
        block.frame.covariance_m2[image].tobytes(),
        unknown_gravity.tobytes(),
        _CARTESIAN,
    )


def frame_of_model(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of a model: east, north, up at the origin, pixels from the corner."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("quaternion_wxyz", COMPUTER_VISION_AXES),
        pixels=CORNER_PIXELS,
    )


def frame_of_database(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of a database: pose priors at the origin, pixels from the corner, no attitudes."""
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
