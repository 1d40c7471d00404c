"""COLMAP's sparse model in binary: cameras, images with their points, points3D.

COLMAP's pixels are those of the package: the centre of the upper left pixel is (0.5, 0.5). A pose
turns and moves from the frame of the block to the camera (x right, y down, z forward). Images are
numbered in the order of the stations, from 1. A point whose name is a positive number keeps it as
its id; others are numbered after the largest of these, and ``points.csv`` beside the model has
their names. A point that was measured in one image only is an image point without object point:
an adjustment could not determine it.
"""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pipeline.errors import MissionError
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.general_frame import GeneralFrame
from pipeline.refraction.camera.opencv_fisheye import OpenCVFisheye
from pipeline.tables.exports.blocks.exported_block import ExportedBlock, block_of
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values, write_csv_stream
from pipeline.units import Integers

USE = (
    "COLMAP knows neither refraction nor earth curvature: nothing is to be switched off in it; its "
    "calibration is best held"
)

MODEL_IDS = {"PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}

_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_OF_GENERAL_FRAME = {"q1": "k4", "q2": "k5", "q3": "k6", "px": "p2", "py": "p1", "k4": "k4 r^8"}
_POINT2D = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<i8")])
_GREY, _NO_ERROR = (128, 128, 128), -1.0


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
        raise MissionError.of(
            "EXPORT-DISTORTION",
            f"cameras.{name}",
            name=name,
            beyond=", ".join(beyond),
            program=program,
        )
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
    ledger.note("EXPORT-CAMERAS", f"camera {numbers}", where="cameras", count=len(block.cameras))


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
        ledger.note("EXPORT-SINGLE", where="observations", count=ids.size - tied)
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(block.cameras)))
        for number, (name, camera) in enumerate(block.cameras.items(), 1):
            model, params = colmap_camera(camera, name)
            size = camera.width_px, camera.height_px
            file.write(struct.pack("<iiQQ", number, MODEL_IDS[model], *size))
            file.write(np.array(params, "<f8").tobytes())
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", block.image.size))
        for i, name in enumerate(block.image):
            here, pose = block.of_image(i), (*block.frame.quaternion[i], *moved[i])
            points = np.empty(here.stop - here.start, _POINT2D)
            points["x"], points["y"] = block.x_px[here], block.y_px[here]
            points["point"] = ids[block.point[here]]
            file.write(struct.pack("<i7di", i + 1, *pose, block.camera[i] + 1))
            file.write(name.encode() + b"\0" + struct.pack("<Q", points.size) + points.tobytes())
    order, begin, images = block.of_points()
    tracks = np.stack([images + 1, order - block.first[images]], axis=1).astype("<i4")
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", tied))
        for p, place in enumerate(block.point_m):
            track = tracks[begin[p] : begin[p + 1]]
            head = struct.pack("<Q3d3BdQ", ids[p], *place, *_GREY, _NO_ERROR, len(track))
            file.write(head + track.tobytes())
    return int(block.point.size)


FORMATS = (
    ExportFormat(
        "colmap", "a block for COLMAP: a folder with its sparse model", "", write_model, use=USE,
        marked=("images.bin",),
    ),
)  # fmt: skip
