"""OpenSfM and ODM: the folder of a project, or a file of cameras.

Lengths are in units of the longer side of the image, counted from its centre, which is the corner
of pixels (w/2, h/2): a pixel (0, 0) of OpenSfM's is the centre of the upper left one, half a pixel
from COLMAP's. Rotation vectors and translations lead from the frame of the reconstruction, east,
north, up at reference_lla, to the camera, which has x right, y down, z forward. A point is the
number of its track.

ODM overwrites ``reconstruction.json`` with coordinates in UTM minus an offset, which ``coords.txt``
has. It keeps the earlier one, in east, north, up, as ``reconstruction.topocentric.json``: that is
read.
"""

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.known_places import KnownPlaces
from unbend.block.oriented_images import topocentric
from unbend.flight.heights import GeodeticOrigin
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.refraction.messages import camera_model
from unbend.tables.geodata.coordinate_systems import grid_coordinates
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
from unbend.tables.imports.messages import IMPORT_FORMAT
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.text_columns import LINE_OF_FIRST_ROW, numbers_of
from unbend.units import Array, measured

# Projection of OpenSfM -> model here, and names of its coefficients in order; "-" for 0.
_COEFFICIENTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "perspective": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "simple_radial": ("BROWN", ("k1", "-", "-", "-", "-")),
    "radial": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "brown": ("BROWN", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": ("OPENCV_FISHEYE", ("k1", "k2", "-", "-")),
    "fisheye_opencv": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_VERSION = "OPENSFM_TRACKS_VERSION_v2"
_TOPOCENTRIC = "reconstruction.topocentric.json"
_FLAG_OF_UTM = "exported_geocoords.txt"  # ODM writes it when reconstruction.json became UTM
_COORDS = "odm_georeferencing/coords.txt"  # of ODM, next to the folder of the project
_ZONE = re.compile(r"UTM (\d{1,2})([NS])", re.I)
_ROUNDING_M2 = 1e-6  # of coordinates in the file: positions that agree are not infinitely likely
_NO_FIX_DOP = 1000.0  # OpenSfM writes 999999 for an image without a position
_COLUMNS_NEEDED = ("image", "track", "keypoint", "x", "y")
_COLUMNS_PASSED_ON = ("scale", "red", "green", "blue", "segmentation", "instance")
_COLUMNS = _COLUMNS_NEEDED + _COLUMNS_PASSED_ON


def block_files(path: Path) -> tuple[Path, ...]:
    """The file of cameras itself; of a folder the reconstruction, tracks.csv and further files.

    Further files, if they exist, are reference_lla.json and ODM's coords.txt. Refuses a
    reconstruction that ODM has written in UTM, if the earlier one is missing.
    """
    if not path.is_dir():
        return (path,)
    reconstruction = path / "reconstruction.json"
    before_odm = path / _TOPOCENTRIC
    if before_odm.is_file():
        reconstruction = before_odm
    elif (path / _FLAG_OF_UTM).is_file():
        raise messages.reconstruction_in_utm(
            where=reconstruction, evidence=_FLAG_OF_UTM, name=_TOPOCENTRIC
        )
    needed = (reconstruction, path / "tracks.csv")
    for file in needed:
        if not file.is_file():
            raise messages.file_of_project_missing(where=file, name=file.name)
    optional = [path / "reference_lla.json"]
    if reconstruction.name != _TOPOCENTRIC:
        optional.append(path.parent / _COORDS)
    existing = [file for file in optional if file.is_file()]
    return (*needed, *existing)


def read_cameras(path: Path) -> CameraMakers:
    """The cameras of camera_models.json, cameras.json or a reconstruction.json by their names."""
    file = block_files(path)[0]
    content = json.loads(file.read_text(encoding="utf-8"))
    if isinstance(content, list):
        content = _reconstruction(path)["cameras"]
    return {name: partial(_camera, camera) for name, camera in content.items()}


def read_images(path: Path) -> OrientationTable:
    """The shots of the reconstruction; its frame is east, north, up at reference_lla.

    Refuses (ORIENTATION-FRAME) shots that agree with their gps_position only in ODM's UTM.
    """
    content = _reconstruction(path)
    shots = content["shots"]
    rotation = Rotation.from_rotvec(_vectors_of(shots, "rotation", path))
    cameras = [shot["camera"] for shot in shots.values()]
    centres = rotation.inv().apply(-_vectors_of(shots, "translation", path))
    quaternion = rotation.as_quat()[:, [3, 0, 1, 2]]
    table = oriented_images(
        [*shots],
        cameras,
        centres,
        quaternion,
        _origin(path, content),
    )
    file = block_files(path)[0]
    if file.name != _TOPOCENTRIC:
        _refuse_utm(path, table)
        return table
    return replace(table, notes=(messages.reconstruction_before_odm(where=file),))


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The positions of the shots by EXIF or geo.txt, which OpenSfM has in the reconstruction.

    They are latitude, longitude [rad] and height, or in the frame of the reconstruction if it has
    no origin.
    """
    if not path.is_dir():
        return ()
    content = _reconstruction(path)
    images = []
    positions = []
    for name, shot in content["shots"].items():
        position = shot.get("gps_position")
        has_fix = float(shot.get("gps_dop", 0.0)) < _NO_FIX_DOP
        if position is not None and len(position) == 3 and has_fix and any(position):
            images.append(name)
            positions.append(position)
    if not images:
        return ()
    places = np.array(positions, np.float64)
    origin = _origin(path, content)
    if origin is not None:
        places = np.stack(topocentric(origin).geodetic(places), axis=1)
    gps_positions = KnownPlaces(
        "gps_position",
        np.array(images, object),
        places,
        in_frame=origin is None,
    )
    return (gps_positions,)


def _refuse_utm(path: Path, table: OrientationTable) -> None:
    """Refuse a reconstruction whose camera centres are in UTM, not in east, north, up.

    The centres are compared with the gps_position of the shots in both frames; that of UTM has the
    offset of ODM's coords.txt. All shots are compared together: in a small block the frames differ
    by less than the error of a receiver at one shot.
    """
    coords = path.parent / _COORDS
    places = read_places(path)
    origin = table.frame
    if not coords.is_file() or not places or not isinstance(origin, GeodeticOrigin):
        return
    gps_position = places[0].rows_of(table.image)
    has_position = np.isfinite(gps_position).all(axis=1)
    gps_position = gps_position[has_position]
    in_utm = _in_utm_of_odm(coords, gps_position)
    if in_utm is None:
        return
    in_enu = topocentric(origin).local(gps_position)[:, :2]
    shots = table.position[has_position, :2]
    ratio = _scatter_of_difference_m2(shots, in_enu) / _scatter_of_difference_m2(shots, in_utm)
    if len(shots) * np.log(ratio) > LOG_RATIO_NEEDED:
        raise messages.reconstruction_in_utm(
            where=block_files(path)[0],
            evidence=coords.name,
            name=_TOPOCENTRIC,
        )


def _in_utm_of_odm(coords: Path, geodetic: Array) -> Array | None:
    """(n, 2) x and y as ODM writes them: UTM minus the offset in ``coords``, ODM's coords.txt.

    ``geodetic`` (n, 3) is latitude, longitude [rad] and height. None if the zone cannot be read.
    """
    first_line, offset = coords.read_text(encoding="utf-8").splitlines()[:2]
    zone = _ZONE.search(first_line)
    if zone is None:
        return None
    first_digits = 326 if zone[2].upper() == "N" else 327
    crs = f"EPSG:{first_digits}{int(zone[1]):02d}"  # UTM on WGS 84
    lat_deg, lon_deg = np.degrees(geodetic[:, :2]).T
    x, y, _ = grid_coordinates(crs, lon_deg, lat_deg)
    return np.stack([x, y], axis=1) - np.array(offset.split()[:2], np.float64)


def _scatter_of_difference_m2(places: Array, others: Array) -> float:
    """Mean square distance [m2] of (n, 2) places from others, after removal of the mean offset."""
    difference = places - others
    square = np.sum(
        (difference - difference.mean(axis=0)) ** 2,
        axis=1,
    )
    return float(np.mean(square)) + _ROUNDING_M2


def _origin(path: Path, content: Mapping[str, Any]) -> GeodeticOrigin | None:
    """The origin of the frame of east, north and up; None if it is not stated.

    It is in the reconstruction (``content``), or in the file reference_lla.json of the folder.
    """
    reference = content.get("reference_lla")
    reference_file = path / "reference_lla.json"
    if reference is None and reference_file.is_file():
        reference = json.loads(reference_file.read_text(encoding="utf-8"))
    if reference is None:
        return None
    latitude_deg = float(reference["latitude"])
    longitude_deg = float(reference["longitude"])
    return GeodeticOrigin(
        np.radians(latitude_deg),
        np.radians(longitude_deg),
        float(reference["altitude"]),
    )


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The rows of tracks.csv, image by image, with all columns that have no gaps.

    The pixels of an image that was not reconstructed are computed with the size of the only camera;
    with several cameras they are NaN.
    """
    content = _reconstruction(path)
    file = block_files(path)[1]
    sizes = {}
    for name, camera in content["cameras"].items():
        sizes[name] = np.array([int(camera["width"]), int(camera["height"])], np.float64)
    size_without_shot = np.full(2, np.nan)
    if len(sizes) == 1:
        size_without_shot = next(iter(sizes.values()))
    with file.open(encoding="utf-8") as stream:
        version = stream.readline().strip()
    if version != _VERSION:
        raise messages.tracks_version(
            where=file,
            first_line=version[:40],
            expected=_VERSION,
        )
    table = _tracks_of(file)
    passed_on = [name for name in _COLUMNS_PASSED_ON if table[name].notna().all()]
    for image, rows in table.groupby("image", sort=False):
        shot = content["shots"].get(image)
        size = size_without_shot if shot is None else sizes[shot["camera"]]
        xy = measured(rows[["x", "y"]].to_numpy()) * size.max() + 0.5 * size
        yield rows_of_image(
            str(image),
            xy,
            rows["track"].to_numpy(),
            keypoint=rows["keypoint"],
            more={name: pa.array(rows[name].to_numpy()) for name in passed_on},
        )


def _tracks_of(file: Path) -> pd.DataFrame:
    """Read the columns `_COLUMNS` of tracks.csv; an error names the line of a wrong number."""
    kinds = dict.fromkeys(_COLUMNS, "float64")
    kinds["image"] = "str"
    kinds["track"] = "int64"
    kinds["keypoint"] = "int64"
    read: Callable[..., Any] = partial(
        pd.read_csv,
        file,
        sep="\t",
        skiprows=1,
        header=None,
        names=_COLUMNS,
        quoting=csv.QUOTE_NONE,
        keep_default_na=False,
        na_values=[""],
        index_col=False,
    )
    try:
        with np.errstate(invalid="ignore"):  # pandas casts 1e308 to integers before it checks
            table: pd.DataFrame = read(dtype=kinds)
    except (ValueError, OverflowError):
        text = read(dtype="str").fillna("")
        text.index = text.index + LINE_OF_FIRST_ROW
        for column in _COLUMNS[1:]:  # without the image
            numbers_of(text, column, file, IMPORT_FORMAT, largest=np.inf)
        raise
    return table


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The points of the reconstruction: numbers of their tracks, and (p, 3) positions."""
    points = _reconstruction(path)["points"]
    return pa.array(list(points), pa.string()), _vectors_of(
        points,
        "coordinates",
        path,
    )


def _reconstruction(path: Path) -> dict[str, Any]:
    """Read the reconstruction of a project; refuses a file with none or several."""
    file = block_files(path)[0]
    content = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(content, list) or len(content) != 1:
        raise messages.several_reconstructions(where=file, found=len(content))
    return dict(content[0])


def _vectors_of(
    items: Mapping[str, Any],
    key: str,
    path: Path,
) -> Array:
    """(n, 3) the vector ``key`` of each shot or point; refuses an item without three numbers."""
    for name, item in items.items():
        vector = item.get(key, ())
        if len(vector) != 3 or not all(isinstance(part, int | float) for part in vector):
            raise messages.vector_missing(
                where=path,
                item=name,
                key=key,
            )
    vectors = [item[key] for item in items.values()]
    return np.array(vectors, np.float64).reshape(-1, 3)


def _camera(camera: Mapping[str, Any]) -> Camera:
    """Make the camera of an entry of OpenSfM's cameras.

    Refuses (PhysicsError CAMERA-MODEL) a kind that is not in `_COEFFICIENTS`.
    """
    kind = camera["projection_type"]
    if kind not in _COEFFICIENTS:
        raise camera_model(model=kind, models=", ".join(_COEFFICIENTS))
    model, names = _COEFFICIENTS[kind]
    width = int(camera["width"])
    height = int(camera["height"])
    longer_px = float(max(width, height))
    focal = camera["focal"] if "focal" in camera else camera["focal_x"]
    fx_px = float(focal) * longer_px
    fy_px = float(camera.get("focal_y", fx_px / longer_px)) * longer_px
    cx = 0.5 * width + float(camera.get("c_x", 0.0)) * longer_px
    cy = 0.5 * height + float(camera.get("c_y", 0.0)) * longer_px
    coefficients = [float(camera.get(name, 0.0)) for name in names]
    parameters = [fx_px, fy_px, cx, cy, *coefficients]
    return camera_of_model(model, width, height, parameters)
