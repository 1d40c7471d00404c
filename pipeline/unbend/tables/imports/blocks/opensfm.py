"""OpenSfM and ODM: the folder of a project, or a file of cameras.

Lengths are in units of the longer side of the image, counted from its centre, which is the corner
of pixels (w/2, h/2): a pixel (0, 0) of OpenSfM's is the centre of the upper left one, half a pixel
from COLMAP's. Rotation vectors and translations lead from the frame of the reconstruction, east,
north, up at reference_lla, to the camera, which has x right, y down, z forward. A point is the
number of its track.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.flight.heights import GeodeticOrigin
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
from unbend.tables.imports.messages import IMPORT_FORMAT
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.text_columns import LINE_OF_FIRST_ROW, numbers_of
from unbend.units import Array

_COEFFICIENTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "perspective": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "simple_radial": ("BROWN", ("k1", "-", "-", "-", "-")),
    "radial": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "brown": ("BROWN", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": ("OPENCV_FISHEYE", ("k1", "k2", "-", "-")),
    "fisheye_opencv": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_VERSION = "OPENSFM_TRACKS_VERSION_v2"
_COLUMNS = ("image", "track", "keypoint", "x", "y", "scale", "red", "green", "blue",
            "segmentation", "instance")  # fmt: skip


def block_files(path: Path) -> tuple[Path, ...]:
    """A file of cameras, or reconstruction.json and tracks.csv, and reference_lla.json if any."""
    if not path.is_dir():
        return (path,)
    needed = (path / "reconstruction.json", path / "tracks.csv")
    for file in needed:
        if not file.is_file():
            raise messages.file_of_project_missing(where=file, name=file.name)
    reference = path / "reference_lla.json"
    return (*needed, reference) if reference.is_file() else needed


def read_cameras(path: Path) -> CameraMakers:
    """The cameras of camera_models.json, cameras.json or a reconstruction.json by their names."""
    file = block_files(path)[0]
    content = json.loads(file.read_text(encoding="utf-8"))
    if isinstance(content, list):
        content = _reconstruction(path)["cameras"]
    return {name: partial(_camera, camera) for name, camera in content.items()}


def read_images(path: Path) -> OrientationTable:
    """The shots of the reconstruction; its frame is east, north, up at reference_lla."""
    content = _reconstruction(path)
    shots = content["shots"]
    turn = Rotation.from_rotvec(_vectors(shots, "rotation", path))
    reference, files = content.get("reference_lla"), block_files(path)
    if reference is None and len(files) == 3:
        reference = json.loads(files[2].read_text(encoding="utf-8"))
    frame = None
    if reference is not None:
        lat, lon, h = (float(reference[key]) for key in ("latitude", "longitude", "altitude"))
        frame = GeodeticOrigin(np.radians(lat), np.radians(lon), h)
    cameras = [shot["camera"] for shot in shots.values()]
    centres = turn.inv().apply(-_vectors(shots, "translation", path))
    return oriented_images([*shots], cameras, centres, turn.as_quat()[:, [3, 0, 1, 2]], frame)


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The rows of tracks.csv, image by image, with all their columns.

    Pixels of an image that was not reconstructed are those of the only camera, or unknown.
    """
    content, file = _reconstruction(path), block_files(path)[1]
    sizes = {n: (int(c["width"]), int(c["height"])) for n, c in content["cameras"].items()}
    only = next(iter(sizes.values())) if len(sizes) == 1 else (np.nan, np.nan)
    with file.open(encoding="utf-8") as stream:
        version = stream.readline().strip()
    if version != _VERSION:
        raise messages.tracks_version(where=file, first_line=version[:40], expected=_VERSION)
    kinds = dict.fromkeys(_COLUMNS, "float64") | {"image": "str", "track": "int64",
                                                  "keypoint": "int64"}  # fmt: skip
    read: Callable[..., Any] = partial(
        pd.read_csv, file, sep="\t", skiprows=1, header=None, names=_COLUMNS, quoting=3,
        keep_default_na=False, na_values=[""], index_col=False,
    )  # fmt: skip
    try:
        table = read(dtype=kinds)
    except (ValueError, OverflowError):
        text = read(dtype="str").fillna("")
        text.index = text.index + LINE_OF_FIRST_ROW
        for column in _COLUMNS[1:]:
            numbers_of(text, column, file, IMPORT_FORMAT)
        raise
    others = [name for name in _COLUMNS[5:] if table[name].notna().all()]
    for image, rows in table.groupby("image", sort=False):
        shot = content["shots"].get(image)
        size = np.array(only if shot is None else sizes[shot["camera"]], np.float64)
        xy = rows[["x", "y"]].to_numpy() * size.max() + 0.5 * size
        more = {name: pa.array(rows[name].to_numpy()) for name in others}
        yield rows_of_image(str(image), xy, rows["track"].to_numpy(), keypoint=rows["keypoint"],
                            more=more)  # fmt: skip


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The points of the reconstruction, by their tracks."""
    points = _reconstruction(path)["points"]
    return pa.array(list(points), pa.string()), _vectors(points, "coordinates", path)


def _reconstruction(path: Path) -> dict[str, Any]:
    file = block_files(path)[0]
    content = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(content, list) or len(content) != 1:
        raise messages.several_reconstructions(where=file, found=len(content))
    return dict(content[0])


def _vectors(items: Mapping[str, Any], key: str, path: Path) -> Array:
    """(n, 3) a vector of each item; refuses one that has none."""
    for name, item in items.items():
        if len(item.get(key, ())) != 3 or not all(isinstance(v, int | float) for v in item[key]):
            raise messages.vector_missing(where=path, item=name, key=key)
    return np.array([item[key] for item in items.values()], np.float64).reshape(-1, 3)


def _camera(given: Mapping[str, Any]) -> Camera:
    kind, width, height = given["projection_type"], int(given["width"]), int(given["height"])
    # Of another kind nothing is known but its name, which is refused with those that are.
    model, names = _COEFFICIENTS.get(kind, (kind, ()))
    longer = float(max(width, height))
    focal = float(given["focal"] if "focal" in given else given["focal_x"]) * longer
    focal_y = float(given.get("focal_y", focal / longer)) * longer
    cx = 0.5 * width + float(given.get("c_x", 0.0)) * longer
    cy = 0.5 * height + float(given.get("c_y", 0.0)) * longer
    coefficients = [float(given.get(name, 0.0)) for name in names]
    return camera_of_model(model, width, height, [focal, focal_y, cx, cy, *coefficients])
