"""BlocksExchange XML of ContextCapture and iTwin Capture Modeler, which other programs write too.

Pixels count from the centre of the upper left one: half a pixel from COLMAP's. Millimetres count
along the axes of ``CameraOrientation``, of the principal point from the middle of the sensor, of
measurements from the principal point. A rotation, as a matrix or omega, phi, kappa in degrees,
turns from the spatial reference system to these axes. P1 belongs to r2 + 2 x2 and P2 to r2 + 2 y2,
as in the article that the format refers to (Brown's model in Wikipedia): the other way round than
in OpenCV. The spatial reference system of the block is one that PROJ knows, a local one, or
``ENU:latitude,longitude``. In a geographic system angles count from east, north and up at each
image, in a map projection from the axes of its grid. Source: the commented example of the vendor;
the program was not run here.

A point is called as its control point, or ``tie:`` and its place. An image is called by its path,
where that is absolute by the name of its file, with the folder before it if such names repeat.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.block.known_places import KnownPlaces
from unbend.flight.heights import GeodeticOrigin
from unbend.flight.rotations import quaternions_of
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.tables.geodata.coordinate_systems import kind_of_system, lat_lon_of
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_DIRECTIONS = {
    "Right": (1.0, 0.0, 0.0),
    "Left": (-1.0, 0.0, 0.0),
    "Down": (0.0, 1.0, 0.0),
    "Up": (0.0, -1.0, 0.0),
}
"""Directions in the image as axes of a camera with x right, y down, z forward."""
_ORIENTATIONS = (
    "XRightYDown", "XRightYUp", "XLeftYDown", "XLeftYUp",
    "XDownYRight", "XDownYLeft", "XUpYRight", "XUpYLeft",
)  # fmt: skip
_HALF_PIXEL = 0.5  # from the centre of the upper left pixel to its corner
_OPK = ("Omega", "Phi", "Kappa")
_MATRIX = tuple(f"M_{row}{column}" for row in range(3) for column in range(3))


def block_files(path: Path) -> tuple[Path, ...]:
    """The file itself."""
    if path.is_dir():
        raise messages.is_folder_of_xml(where=path)
    return (path,)


def read_cameras(path: Path) -> CameraMakers:
    """The camera of each photogroup by its name, with its number where names repeat."""
    makers: CameraMakers = {}
    for name, group in _groups(_block(path)).items():
        makers[name] = partial(_camera, group, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The photos of all photogroups; unknown where one has no pose, or one not yet estimated."""
    block = _block(path)
    names = _image_names(block)
    images = []
    cameras = []
    positions = []
    rotations = []
    for camera, group in _groups(block).items():
        _refuse_other_system(path, block, group)
        axes = _camera_axes(group)
        for photo in group.iterfind("Photo"):
            images.append(names[_text(photo, "Id")])
            cameras.append(camera)
            positions.append(_centre(photo.find("Pose/Center")))
            rotations.append(axes @ _rotation(photo.find("Pose/Rotation"), path))
    position = np.array(positions).reshape(-1, 3)
    quaternion = np.full((len(rotations), 4), np.nan)
    known = np.array([np.isfinite(matrix).all() for matrix in rotations], np.bool_)
    if known.any():
        quaternion[known] = quaternions_of(np.array(rotations)[known])
    system = _system(path, block)
    if system.is_geographic:
        position[:, :2] = np.radians(position[:, [1, 0]])
    table = oriented_images(images, cameras, position, quaternion)
    return replace(table, frame=system.frame, crs=system.crs)


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The positions of the photos before the adjustment, in EXIF or as metadata of their poses."""
    block = _block(path)
    names = _image_names(block)
    of_exif: dict[str, list[float]] = {}
    of_pose: dict[str, list[float]] = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        name = names[_text(photo, "Id")]
        gps = photo.find("ExifData/GPS")
        if gps is not None:
            lat = np.radians(float(gps.findtext("Latitude", "nan")))
            lon = np.radians(float(gps.findtext("Longitude", "nan")))
            of_exif[name] = [lat, lon, float(gps.findtext("Altitude", "nan"))]
        before = photo.find("Pose/Metadata")
        centre = None if before is None else before.find("Center")
        if before is not None and centre is not None:
            x, y, z = _centre(centre, only_accurate=False)
            crs = _definition(path, before.findtext("SRSId"))
            lat_lon = lat_lon_of(crs, np.array([x]), np.array([y]))
            if lat_lon is not None:
                of_pose[name] = [float(lat_lon[0][0]), float(lat_lon[1][0]), z]
    places = []
    for source, found in (("positions in EXIF", of_exif), ("metadata of the poses", of_pose)):
        if found:
            image = np.array([*found], object)
            places.append(KnownPlaces(source, image, np.array([*found.values()])))
    return tuple(places)


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The measurements of control points and tie points, image by image."""
    block = _block(path)
    names = _image_names(block)
    group_of_photo = {}
    for group in block.iterfind("Photogroups/Photogroup"):
        for photo in group.iterfind("Photo"):
            group_of_photo[_text(photo, "Id")] = group
    rows: dict[str, list[tuple[str, float, float]]] = {number: [] for number in names}
    for name, point in _points(block):
        for measurement in point.iterfind("Measurement"):
            number = _text(measurement, "PhotoId")
            if number not in rows:
                raise messages.photo_unknown(where=path, point=name, number=number)
            x, y = _pixel(measurement, group_of_photo[number], path)
            rows[number].append((name, x, y))
    for number, name in names.items():
        if rows[number]:
            pixels = [row[1:] for row in rows[number]]
            yield rows_of_image(name, pixels, [row[0] for row in rows[number]])


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The tie points and control points that have a position in the block's own system."""
    block = _block(path)
    is_geographic = _system(path, block).is_geographic
    own = block.findtext("SRSId")
    names = []
    places = []
    for container in ("ControlPoints", "TiePoints"):
        system = block.findtext(f"{container}/SRSId", own or "")
        for name, point in _points(block, container):
            position = point.find("Position")
            of_point = point.findtext("SRSId", system)
            if position is None or position.find("z") is None or of_point != (own or ""):
                continue
            x, y, z = _centre(position)
            names.append(name)
            places.append([np.radians(y), np.radians(x), z] if is_geographic else [x, y, z])
    return pa.array(names, pa.string()), np.array(places, np.float64).reshape(-1, 3)


@dataclass(frozen=True)
class BlockSystem:
    """What the spatial reference system of a block is: a frame, or a system of PROJ's."""

    frame: Literal["ecef"] | GeodeticOrigin | None = None
    crs: str | None = None
    is_geographic: bool = False


def _root(path: Path) -> ElementTree.Element:
    root = ElementTree.fromstring(path.read_bytes())
    if root.tag != "BlocksExchange":
        raise messages.not_blocks_exchange(where=path, tag=root.tag)
    return root


def _block(path: Path) -> ElementTree.Element:
    """The block of a file; refuses none, and several."""
    blocks = _root(path).findall("Block")
    if len(blocks) != 1:
        names = ", ".join(repr(block.findtext("Name", "")) for block in blocks)
        raise messages.several_blocks(where=path, blocks=len(blocks), names=names)
    return blocks[0]


def _text(element: ElementTree.Element, name: str) -> str:
    """The text of a part that must be there."""
    text = element.findtext(name)
    if text is None:
        raise KeyError(name)
    return text.strip()


def _groups(block: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """The photogroups by their names."""
    groups: dict[str, ElementTree.Element] = {}
    for number, group in enumerate(block.iterfind("Photogroups/Photogroup"), 1):
        name = group.findtext("Name", "").strip() or str(number)
        groups[f"{name} {number}" if name in groups else name] = group
    return groups


def _image_names(block: ElementTree.Element) -> dict[str, str]:
    """What the image of each photo is called, by the photo's id."""
    parts = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        image = PurePosixPath(_text(photo, "ImagePath").replace("\\", "/"))
        parts[_text(photo, "Id")] = image
    count = Counter(image.name for image in parts.values())
    names = {}
    for number, image in parts.items():
        if not image.is_absolute() and ":" not in image.parts[0]:
            names[number] = str(image)
            continue
        repeats = count[image.name] > 1 and image.parent.name
        names[number] = f"{image.parent.name}/{image.name}" if repeats else image.name
    return names


def _points(
    block: ElementTree.Element, container: str | None = None
) -> Iterator[tuple[str, ElementTree.Element]]:
    """Control points by their names, then tie points by their place."""
    if container in (None, "ControlPoints"):
        for number, point in enumerate(block.iterfind("ControlPoints/ControlPoint"), 1):
            yield point.findtext("Name", "").strip() or f"control:{number}", point
    if container in (None, "TiePoints"):
        for number, point in enumerate(block.iterfind("TiePoints/TiePoint"), 1):
            yield point.findtext("Name", "").strip() or f"tie:{number}", point


def _definition(path: Path, number: str | None) -> str:
    """The definition of a spatial reference system by its id; empty for a local one."""
    for system in _root(path).iterfind("SpatialReferenceSystems/SRS"):
        if number is not None and _text(system, "Id") == number.strip():
            return _text(system, "Definition")
    return ""


def _system(path: Path, block: ElementTree.Element) -> BlockSystem:
    """What the spatial reference system of a block is."""
    definition = _definition(path, block.findtext("SRSId"))
    if definition.upper().startswith("ENU:"):
        numbers = [float(number) for number in definition[4:].split(",")]
        lat, lon, *height = numbers
        h = height[0] if height else 0.0
        return BlockSystem(frame=GeodeticOrigin(np.radians(lat), np.radians(lon), h))
    kind = kind_of_system(definition)
    if kind in ("geographic", "projected"):
        return BlockSystem(crs=definition, is_geographic=kind == "geographic")
    return BlockSystem(frame="ecef" if kind == "ecef" else None)


def _refuse_other_system(
    path: Path, block: ElementTree.Element, group: ElementTree.Element
) -> None:
    """Refuse a photogroup in another spatial reference system than its block."""
    own = group.findtext("SRSId")
    if own is not None and own != block.findtext("SRSId"):
        raise messages.system_of_group(where=path, name=group.findtext("Name", ""))


def _camera_axes(group: ElementTree.Element) -> Array:
    """(3, 3) from the axes of a photogroup's cameras to x right, y down, z forward."""
    name = group.findtext("CameraOrientation", "XRightYDown").strip()
    if name not in _ORIENTATIONS:
        raise KeyError(name)
    x_name, _, y_name = name[1:].partition("Y")
    x = np.array(_DIRECTIONS[x_name])
    y = np.array(_DIRECTIONS[y_name])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _centre(element: ElementTree.Element | None, *, only_accurate: bool = True) -> list[float]:
    """x, y, z; NaN without, and where the program says that it has not estimated them."""
    unknown = [np.nan, np.nan, np.nan]
    if element is None or (only_accurate and element.findtext("Accurate") == "false"):
        return unknown
    return [float(element.findtext(axis, "nan")) for axis in "xyz"]


def _rotation(element: ElementTree.Element | None, path: Path) -> Array:
    """(3, 3) from the spatial reference system to the camera's axes; NaN where unknown."""
    unknown = np.full((3, 3), np.nan)
    if element is None or element.findtext("Accurate") == "false":
        return unknown
    given = {part.tag: part.text or "" for part in element}
    if set(_MATRIX) <= given.keys():
        return np.array([float(given[name]) for name in _MATRIX]).reshape(3, 3)
    if set(_OPK) <= given.keys():
        angles = [float(given[name]) for name in _OPK]
        return np.asarray(Rotation.from_euler("XYZ", angles, degrees=True).as_matrix().T)
    names = [name for name in given if name != "Accurate"]
    if names:
        raise messages.rotation_unreadable(where=path, angles=", ".join(map(str, names)))
    return unknown


def _pixel_mm(group: ElementTree.Element) -> float:
    """The size of a pixel [mm]; NaN if unknown."""
    stated = group.findtext("PixelSize")
    if stated is not None:
        return float(stated)
    width, height = _size(group)
    return float(group.findtext("SensorSize", "nan")) / max(width, height)


def _size(group: ElementTree.Element) -> tuple[int, int]:
    return (
        int(_text(group, "ImageDimensions/Width")),
        int(_text(group, "ImageDimensions/Height")),
    )


def _pixel(
    measurement: ElementTree.Element, group: ElementTree.Element, path: Path
) -> tuple[float, float]:
    """x and y of a measurement in COLMAP's pixels."""
    if measurement.find("xmm") is None:
        x = float(_text(measurement, "x"))
        y = float(_text(measurement, "y"))
        return x + _HALF_PIXEL, y + _HALF_PIXEL
    step = _in_pixels(measurement, group)
    cx, cy = _principal_point(group)
    return cx + step[0], cy + step[1]


def _in_pixels(element: ElementTree.Element, group: ElementTree.Element) -> Array:
    """(2,) xmm and ymm along the camera's axes as pixels to the right and down."""
    step_mm = np.array([float(_text(element, "xmm")), float(_text(element, "ymm"))])
    return np.asarray(_camera_axes(group)[:2, :2] @ step_mm / _pixel_mm(group))


def _principal_point(group: ElementTree.Element) -> tuple[float, float]:
    """The principal point in COLMAP's pixels; by default the middle of the image."""
    width, height = _size(group)
    given = group.find("PrincipalPoint")
    if given is None:
        return 0.5 * width, 0.5 * height
    if given.find("xmm") is None:
        return float(_text(given, "x")) + _HALF_PIXEL, float(_text(given, "y")) + _HALF_PIXEL
    step = _in_pixels(given, group)
    return 0.5 * width + float(step[0]), 0.5 * height + float(step[1])


def _camera(group: ElementTree.Element, path: Path) -> Camera:
    """The camera of a photogroup; refuses a fisheye, pixels that are not square, and skew."""
    kind = group.findtext("CameraModelType", "Perspective").strip()
    if kind != "Perspective":
        raise messages.calibration_unusable(where=path, coefficients="coefficients", kind=kind)
    plain: Mapping[str, float] = {"AspectRatio": 1.0, "Skew": 0.0}
    for name, value in plain.items():
        if float(group.findtext(name, str(value))) != value:
            raise messages.calibration_unusable(where=path, coefficients=name, kind=kind)
    width, height = _size(group)
    focal = group.findtext("FocalLengthPixels")
    f_px = float(_text(group, "FocalLength")) / _pixel_mm(group) if focal is None else float(focal)
    cx, cy = _principal_point(group)
    k1, k2, k3, p1, p2 = (
        float(group.findtext(f"Distortion/{name}", "0")) for name in ("K1", "K2", "K3", "P1", "P2")
    )
    # P1 of this format is OpenCV's p2, and the other way round.
    params = [f_px, f_px, cx, cy, k1, k2, k3, p2, p1]
    return camera_of_model("BROWN", width, height, params)
