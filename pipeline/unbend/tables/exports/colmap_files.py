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
from collections.abc import Iterator, Sequence
from contextlib import closing
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import messages
from unbend.tables.exports.colmap_rigs import CAMERA_SENSOR, rig_tables
from unbend.tables.exports.export_frames import (
    CORNER_PIXELS,
    OF_COMPUTER_VISION,
    ExportFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import ExportedBlock, block_of
from unbend.tables.exports.format import ExportFormat, FinishedRun, Values, write_csv_stream
from unbend.tables.imports.blocks import damage_refused
from unbend.tables.imports.blocks.colmap import POINT2D, opened
from unbend.tables.imports.blocks.messages import matches_cut
from unbend.tables.refraction_mark import MARK_TABLE, REFRACTION_KEY, REFRACTION_REMOVED
from unbend.units import Integers

_USE = (
    "COLMAP corrects neither refraction nor earth curvature: nothing must be switched off in it; "
    "it is best to keep its calibration fixed"
)

_MODEL_IDS = {"PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}

_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_OF_GENERAL_FRAME = {"q1": "k4", "q2": "k5", "q3": "k6", "px": "p2", "py": "p1", "k4": "k4 r^8"}
_GREY, _NO_ERROR = (128, 128, 128), -1.0

_VERSION = 4_020_100
_MOST_IMAGES = 2_147_483_647  # of pair_id = first * this + second
_CALIBRATED, _CARTESIAN, _WITH_PRIOR = 2, 1, 1
_LARGEST_ROUNDING_PX = 0.0005


def opencv_coefficients(
    camera: Camera, name: str, program: str, holds: Sequence[str]
) -> dict[str, float]:
    """OpenCV's coefficients of a frame camera, without those that are zero.

    Refuses (MissionError EXPORT-DISTORTION) what is not among those that a program ``holds``, and
    what OpenCV has not: Metashape's k4, b1 and b2, and polynomials that correct what was measured.
    """
    known = camera.distortion._asdict()
    if isinstance(camera.distortion, GeneralFrame):
        known["sense"] -= 1.0
        del known["limit"], known["steps"]
        known = {_OF_GENERAL_FRAME.get(key, key): value for key, value in known.items()}
    known = {key: value for key, value in known.items() if value != 0.0}
    beyond = [key for key in known if key not in holds]
    if beyond:
        where, beyond_it = f"cameras.{name}", ", ".join(beyond)
        raise messages.distortion_unknown(where=where, name=name, beyond=beyond_it, program=program)
    return known


def colmap_camera(camera: Camera, name: str, *, simplest: bool = True) -> tuple[str, list[float]]:
    """COLMAP's model and parameters of a camera, the simplest that is exact or the fullest.

    >>> colmap_camera(Camera(1000, 800, 900.0, 900.0, 500.0, 400.0), "nadir")
    ('PINHOLE', [900.0, 900.0, 500.0, 400.0])
    """
    frame = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    if isinstance(camera.distortion, OpenCVFisheye):
        return "OPENCV_FISHEYE", [*frame, *camera.distortion]
    known = opencv_coefficients(camera, name, "COLMAP", _OPENCV)
    last = max((_OPENCV.index(key) for key in known), default=-1) if simplest else 7
    model = "PINHOLE" if last < 0 else "OPENCV" if last < 4 else "FULL_OPENCV"
    count = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8}[model]
    return model, [*frame, *(known.get(key, 0.0) for key in _OPENCV[:count])]


def note_cameras(block: ExportedBlock, ledger: Ledger) -> None:
    """Note which number each camera has."""
    numbers = ", ".join(f"{number} {name}" for number, name in enumerate(block.cameras, 1))
    ledger.add(messages.camera_numbers(where="cameras", count=len(block.cameras), numbers=numbers))


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
    note_cameras(block, ledger)
    ids, tied, moved = point_ids(block, folder), len(block.point_m), block.moved_m
    ids[tied:] = -1
    if tied < ids.size:
        ledger.add(messages.single_points(where="observations", count=ids.size - tied))
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(block.cameras)))
        for number, (name, camera) in enumerate(block.cameras.items(), 1):
            model, params = colmap_camera(camera, name)
            size = camera.width_px, camera.height_px
            file.write(struct.pack("<iiQQ", number, _MODEL_IDS[model], *size))
            file.write(np.array(params, "<f8").tobytes())
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", block.image.size))
        for i, _camera, here in block.images():
            pose, name = (*block.frame.quaternion[i], *moved[i]), block.image[i].encode()
            points = np.empty(here.stop - here.start, POINT2D)
            points["xy"] = np.stack([block.x_px[here], block.y_px[here]], axis=1)
            points["point"] = ids[block.point[here]]
            file.write(struct.pack("<i7di", i + 1, *pose, block.camera[i] + 1))
            file.write(name + b"\0" + struct.pack("<Q", points.size) + points.tobytes())
    order, begin, images = block.of_points()
    tracks = np.stack([images + 1, order - block.first[images]], axis=1).astype("<i4")
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", tied))
        for p, place in enumerate(block.point_m):
            track = tracks[begin[p] : begin[p + 1]]
            head = struct.pack("<Q3d3BdQ", ids[p], *place, *_GREY, _NO_ERROR, len(track))
            file.write(head + track.tobytes())
    return int(block.point.size)


def write_database(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """The database of a block; the number of keypoints."""
    block = block_of(run, ledger, intersect=False)
    note_cameras(block, ledger)
    source = run.database()
    tables = rows_of_tables(block) | rig_tables(block, source, ledger)
    unknown = int(np.isnan(block.frame.covariance_m2).any(axis=(1, 2)).sum())
    if unknown:
        ledger.add(messages.sigmas_missing(where="stations.parquet", count=unknown))
    rounding = max(np.abs(c - c.astype("<f4")).max(initial=0.0) for c in (block.x_px, block.y_px))
    if rounding > _LARGEST_ROUNDING_PX:
        ledger.add(messages.pixels_rounded(where="keypoints", rounding=rounding))
    schema = resources.files("unbend.tables.exports").joinpath("colmap_4_2.sql")
    with closing(sqlite3.connect(path)) as database:
        # A draft that is interrupted is thrown away: no journal.
        database.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")
        database.execute(f"PRAGMA user_version = {_VERSION}")
        database.executescript(schema.read_text(encoding="utf-8"))
        database.execute(f"CREATE TABLE {MARK_TABLE} (key TEXT PRIMARY KEY, value TEXT)")
        for table, rows in tables.items():
            marks = ", ".join("?" * len(rows[0]))
            database.executemany(f"INSERT INTO {table} VALUES ({marks})", rows)
        for i, _camera, here in block.images():
            xy = np.stack([block.x_px[here], block.y_px[here]], axis=1).astype("<f4")
            keypoints = i + 1, len(xy), xy.tobytes()
            database.execute("INSERT INTO keypoints VALUES (?, ?, 2, ?)", keypoints)
        tied = 0
        for table, *row in match_rows(block) if source is None else copied_rows(block, source):
            marks = "?, ?, 2, ?" if table == "matches" else "?, ?, 2, ?, ?" + ", NULL" * 7
            database.execute(f"INSERT INTO {table} VALUES ({marks})", row)
            tied += 1
        database.commit()
    if not tied:
        ledger.add(messages.no_ties(where="observations"))
    return int(block.point.size)


def rows_of_tables(block: ExportedBlock) -> dict[str, list[tuple[Any, ...]]]:
    """Rows of the tables that have one for each camera or image, and the mark."""
    cameras, frame = list(block.cameras.items()), block.frame
    sensors = [(n, c + 1, CAMERA_SENSOR) for n, c in enumerate(block.camera.tolist(), 1)]
    unknown = np.full(3, np.nan).tobytes()
    models = [(camera, *colmap_camera(camera, name)) for name, camera in cameras]
    return {
        MARK_TABLE: [(REFRACTION_KEY.decode(), REFRACTION_REMOVED.decode())],
        "cameras": [
            (n, _MODEL_IDS[model], camera.width_px, camera.height_px,
             np.array(params, "<f8").tobytes(), _WITH_PRIOR)
            for n, (camera, model, params) in enumerate(models, 1)
        ],
        "images": [(n, block.image[n - 1], camera) for n, camera, _ in sensors],
        "pose_priors": [
            (n, n, camera, sensor, frame.position_m[n - 1].tobytes(),
             frame.covariance_m2[n - 1].tobytes(), unknown, _CARTESIAN)
            for n, camera, sensor in sensors
        ],
    }  # fmt: skip


def copied_rows(block: ExportedBlock, source: Path) -> Iterator[tuple[Any, ...]]:
    """Rows of both tables as the database that was read has them, with the keypoints' places here.

    Its keypoints are the points ``image:index``. Matches of those that are left out are left out;
    of the geometries the configuration is kept, and not the matrices, which are of bent rays.
    Refuses (InputError IMPORT-FORMAT) a database without these tables, and matches cut short.
    """
    places = {}
    for i, _camera, here in block.images():
        own = block.name.take(pa.array(block.point[here]))
        index = pc.binary_replace_slice(own, 0, len(f"{block.image[i]}:".encode()), "")
        index = index.cast(pa.int64()).to_numpy()
        place = np.full(index.max(initial=0) + 2, -1)  # of the last, and beyond, there is none
        place[index] = np.arange(index.size)
        places[block.image[i]] = i + 1, place
    with damage_refused(source, "colmap"), closing(opened(source)) as database:
        images = dict(database.execute("SELECT image_id, name FROM images"))
        for table, more in (("matches", ""), ("two_view_geometries", ", config")):
            query = f"SELECT pair_id, rows, cols, data{more} FROM {table} WHERE rows > 0"
            for pair, rows, columns, blob, *config in database.execute(query):
                names = [images.get(number) for number in divmod(pair, _MOST_IMAGES)]
                if columns != 2 or len(blob or b"") != 8 * rows:
                    raise matches_cut(
                        where=source, table=table, one=str(names[0]), other=str(names[1])
                    )
                if not places.keys() >= set(names):
                    continue
                given = np.frombuffer(blob, "<u4").reshape(rows, 2)
                (first, _, low), (second, _, high) = sorted(
                    (number, k, place.take(given[:, k], mode="clip"))
                    for k, (number, place) in enumerate(places[name] for name in names)
                )
                both = np.array([low, high])
                both = both[:, both.min(axis=0) >= 0].T.astype("<u4")
                if len(both):
                    pair = first * _MOST_IMAGES + second
                    yield table, pair, len(both), both.tobytes(), *config


def match_rows(block: ExportedBlock) -> Iterator[tuple[Any, ...]]:
    """Rows of both tables: pair of images, number of points in both, places of their keypoints."""
    order, begin, images = block.of_points()
    place = order - block.first[images]
    for i, _camera, here in block.images():
        point = block.point[here]
        count = block.count[point]
        # All image points of the points of this image, and of these those in later images.
        own = np.repeat(np.arange(point.size), count)
        other = np.repeat(begin[point] - np.cumsum(count) + count, count) + np.arange(own.size)
        later = np.flatnonzero(images[other] > i)
        later = later[np.argsort(images[other[later]], kind="stable")]
        own, other = own[later], other[later]
        edges = np.append(np.flatnonzero(np.diff(images[other], prepend=-1)), other.size)
        for low, high in pairwise(edges.tolist()):
            both = np.stack([own[low:high], place[other[low:high]]], axis=1).astype("<u4")
            pair = (i + 1) * _MOST_IMAGES + int(images[other[low]]) + 1
            yield "matches", pair, high - low, both.tobytes()
            yield "two_view_geometries", pair, high - low, both.tobytes(), _CALIBRATED


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
        "colmap", "a block for COLMAP: a folder with its sparse model", "", write_model,
        frame_of_model, use=_USE,
        marked=("images.bin",),
    ),
    ExportFormat(
        "colmap-database", "a block for COLMAP: database with matches and pose priors", ".db",
        write_database, frame_of_database, use=_USE, marked=("",),
    ),
)  # fmt: skip
