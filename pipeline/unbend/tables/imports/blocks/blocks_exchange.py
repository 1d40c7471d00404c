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
    "XRightYDown",
    "XRightYUp",
    "XLeftYDown",
    "XLeftYUp",
    "XDownYRight",
    "XDownYLeft",
    "XUpYRight",
    "XUpYLeft",
)
_COEFFICIENTS = ("K1", "K2", "K3", "P2", "P1")
"""Of this format, as OpenCV's k1, k2, k3, p1, p2: its P1 is OpenCV's p2."""
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
    system = _system(path, block)
    if system.is_geographic:
        position[:, :2] = np.radians(position[:, [1, 0]])
    table = oriented_images(images, cameras, position, _quaternions(rotations))
    return replace(
        table,
        frame=system.frame,
        crs=system.crs,
    )


def _quaternions(rotations: list[Array]) -> Array:
    """(n, 4) quaternions of matrices, NaN where one is unknown."""
    matrices = np.array(rotations).reshape(-1, 3, 3)
    known = np.isfinite(matrices).all(axis=(1, 2))
    quaternion = np.full((len(matrices), 4), np.nan)
    if known.any():
        quaternion[known] = quaternions_of(matrices[known])
    return quaternion


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The positions of the photos before the adjustment, in EXIF or as metadata of their poses."""
    block = _block(path)
    names = _image_names(block)
    of_exif = {}
    of_pose = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        name = names[_text(photo, "Id")]
        gps = photo.find("ExifData/GPS")
        if gps is not None:
            of_exif[name] = _place_in_exif(gps)
        metadata = photo.find("Pose/Metadata")
        place = None if metadata is None else _place_in_metadata(metadata, path)
        if place is not None:
            of_pose[name] = place
    sources = {"positions in EXIF": of_exif, "metadata of the poses": of_pose}
    places = []
    for source, place_of_image in sources.items():
        if place_of_image:
            image = np.array([*place_of_image], object)
            position = np.array([*place_of_image.values()])
            places.append(KnownPlaces(source, image, position))
    return tuple(places)


def _place_in_exif(gps: ElementTree.Element) -> list[float]:
    """Latitude, longitude [rad] and altitude [m] of a photo's EXIF."""
    latitude_deg = float(gps.findtext("Latitude", "nan"))
    longitude_deg = float(gps.findtext("Longitude", "nan"))
    altitude = float(gps.findtext("Altitude", "nan"))
    return [np.radians(latitude_deg), np.radians(longitude_deg), altitude]


def _place_in_metadata(
    metadata: ElementTree.Element,
    path: Path,
) -> list[float] | None:
    """The same of the metadata of a pose, which name their own system; None if unknown."""
    centre = metadata.find("Center")
    if centre is None:
        return None
    x, y, z = _centre(centre, only_accurate=False)
    crs = _definition(path, metadata.findtext("SRSId"))
    lat_lon = lat_lon_of(crs, np.array([x]), np.array([y]))
    if lat_lon is None:
        return None
    latitude, longitude = lat_lon
    return [float(latitude[0]), float(longitude[0]), z]


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The measurements of control points and tie points, image by image."""
    block = _block(path)
    names = _image_names(block)
    groups = _group_of_photo(block)
    rows: dict[str, list[tuple[str, float, float]]] = {number: [] for number in names}
    for name, measurement in _measurements(block):
        number = _text(measurement, "PhotoId")
        if number not in rows:
            raise messages.photo_unknown(where=path, point=name, number=number)
        x, y = _pixel(measurement, groups[number])
        rows[number].append((name, x, y))
    for number, name in names.items():
        if rows[number]:
            pixels = [row[1:] for row in rows[number]]
            points = [row[0] for row in rows[number]]
            yield rows_of_image(name, pixels, points)


def _measurements(block: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element]]:
    """All measurements, with the names of their points."""
    for name, point in _points(block):
        for measurement in point.iterfind("Measurement"):
            yield name, measurement


def _group_of_photo(block: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """The photogroup of each photo, by the photo's id."""
    groups = {}
    for group in block.iterfind("Photogroups/Photogroup"):
        for photo in group.iterfind("Photo"):
            groups[_text(photo, "Id")] = group
    return groups


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The tie points and control points that have a position in the block's own system."""
    block = _block(path)
    names = []
    places = []
    for container in ("ControlPoints", "TiePoints"):
        for name, point in _points(block, container):
            position = point.find("Position")
            if position is None or position.find("z") is None:
                continue
            if _has_own_system(block, container, point):
                names.append(name)
                places.append(_centre(position))
    positions = np.array(places, np.float64).reshape(-1, 3)
    if _system(path, block).is_geographic:
        positions[:, :2] = np.radians(positions[:, [1, 0]])
    return pa.array(names, pa.string()), positions


def _has_own_system(
    block: ElementTree.Element,
    container: str,
    point: ElementTree.Element,
) -> bool:
    """Whether a point is in the spatial reference system of its block."""
    of_block = block.findtext("SRSId", "")
    of_container = block.findtext(f"{container}/SRSId", of_block)
    return point.findtext("SRSId", of_container) == of_block


@dataclass(frozen=True)
class BlockSystem:
    """What the spatial reference system of a block is: a frame, or a system of PROJ's."""

    frame: Literal["ecef"] | GeodeticOrigin | None = None
    crs: str | None = None
    is_geographic: bool = False


def _root(path: Path) -> ElementTree.Element:
    root = ElementTree.fromstring(path.read_bytes())
    if root.tag != "BlocksExchange":
        raise messages.not_blocks_exchange(
            where=path,
            tag=root.tag,
        )
    return root


def _block(path: Path) -> ElementTree.Element:
    """The block of a file; refuses none, and several."""
    blocks = _root(path).findall("Block")
    if len(blocks) != 1:
        names = ", ".join(repr(block.findtext("Name", "")) for block in blocks)
        raise messages.several_blocks(
            where=path,
            blocks=len(blocks),
            names=names,
        )
    return blocks[0]


def _text(
    element: ElementTree.Element,
    name: str,
) -> str:
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
    paths = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        written = _text(photo, "ImagePath").replace("\\", "/")
        paths[_text(photo, "Id")] = PurePosixPath(written)
    count = Counter(path.name for path in paths.values())
    names = {}
    for number, path in paths.items():
        is_alone = count[path.name] == 1
        names[number] = _name_of_path(path, is_alone=is_alone)
    return names


def _name_of_path(
    path: PurePosixPath,
    *,
    is_alone: bool,
) -> str:
    """A relative path, or the last part of an absolute one, with its folder if not alone."""
    is_absolute = path.is_absolute() or ":" in path.parts[0]
    if not is_absolute:
        return str(path)
    if is_alone or not path.parent.name:
        return path.name
    return f"{path.parent.name}/{path.name}"


def _points(
    block: ElementTree.Element,
    container: str | None = None,
) -> Iterator[tuple[str, ElementTree.Element]]:
    """Control points by their names, then tie points by their place."""
    if container in (None, "ControlPoints"):
        for number, point in enumerate(block.iterfind("ControlPoints/ControlPoint"), 1):
            yield point.findtext("Name", "").strip() or f"control:{number}", point
    if container in (None, "TiePoints"):
        for number, point in enumerate(block.iterfind("TiePoints/TiePoint"), 1):
            yield point.findtext("Name", "").strip() or f"tie:{number}", point


def _definition(
    path: Path,
    number: str | None,
) -> str:
    """The definition of a spatial reference system by its id; empty for a local one."""
    for system in _root(path).iterfind("SpatialReferenceSystems/SRS"):
        if number is not None and _text(system, "Id") == number.strip():
            return _text(system, "Definition")
    return ""


def _system(
    path: Path,
    block: ElementTree.Element,
) -> BlockSystem:
    """What the spatial reference system of a block is."""
    definition = _definition(path, block.findtext("SRSId"))
    if definition.upper().startswith("ENU:"):
        numbers = [float(number) for number in definition[4:].split(",")]
        lat, lon, *height = numbers
        h = height[0] if height else 0.0
        return BlockSystem(frame=GeodeticOrigin(np.radians(lat), np.radians(lon), h))
    kind = kind_of_system(definition)
    if kind in ("geographic", "projected"):
        return BlockSystem(
            crs=definition,
            is_geographic=kind == "geographic",
        )
    return BlockSystem(frame="ecef" if kind == "ecef" else None)


def _refuse_other_system(
    path: Path,
    block: ElementTree.Element,
    group: ElementTree.Element,
) -> None:
    """Refuse a photogroup in another spatial reference system than its block."""
    of_group = group.findtext("SRSId")
    if of_group is not None and of_group != block.findtext("SRSId"):
        raise messages.system_of_group(
            where=path,
            name=group.findtext("Name", ""),
        )


def _camera_axes(group: ElementTree.Element) -> Array:
    """(3, 3) from the axes of a photogroup's cameras to x right, y down, z forward."""
    name = group.findtext("CameraOrientation", "XRightYDown").strip()
    if name not in _ORIENTATIONS:
        raise KeyError(name)
    x_name, _, y_name = name[1:].partition("Y")
    x = np.array(_DIRECTIONS[x_name])
    y = np.array(_DIRECTIONS[y_name])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _is_not_accurate(element: ElementTree.Element) -> bool:
    """Whether the program says that it has not estimated a part of a pose."""
    return element.findtext("Accurate", "true").strip().lower() in ("false", "0")


def _centre(
    element: ElementTree.Element | None,
    *,
    only_accurate: bool = True,
) -> list[float]:
    """x, y, z; NaN without, and where the program says that it has not estimated them."""
    unknown = [np.nan, np.nan, np.nan]
    if element is None or (only_accurate and _is_not_accurate(element)):
        return unknown
    return [float(element.findtext(axis, "nan")) for axis in "xyz"]


def _rotation(
    element: ElementTree.Element | None,
    path: Path,
) -> Array:
    """(3, 3) from the spatial reference system to the camera's axes; NaN where unknown."""
    unknown = np.full((3, 3), np.nan)
    if element is None or _is_not_accurate(element):
        return unknown
    given = {part.tag: part.text or "" for part in element}
    if set(_MATRIX) <= given.keys():
        return np.array([float(given[name]) for name in _MATRIX]).reshape(3, 3)
    if set(_OPK) <= given.keys():
        angles = [float(given[name]) for name in _OPK]
        return np.asarray(Rotation.from_euler("XYZ", angles, degrees=True).as_matrix().T)
    names = [name for name in given if name != "Accurate"]
    if names:
        raise messages.rotation_unreadable(
            where=path,
            angles=", ".join(map(str, names)),
        )
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
    measurement: ElementTree.Element,
    group: ElementTree.Element,
) -> tuple[float, float]:
    """x and y of a measurement in COLMAP's pixels."""
    if measurement.find("xmm") is None:
        x = float(_text(measurement, "x"))
        y = float(_text(measurement, "y"))
        return x + _HALF_PIXEL, y + _HALF_PIXEL
    step = _in_pixels(measurement, group)
    cx, cy = _principal_point(group)
    return cx + step[0], cy + step[1]


def _in_pixels(
    element: ElementTree.Element,
    group: ElementTree.Element,
) -> Array:
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


def _camera(
    group: ElementTree.Element,
    path: Path,
) -> Camera:
    """The camera of a photogroup; refuses a fisheye, pixels that are not square, and skew."""
    kind = group.findtext("CameraModelType", "Perspective").strip()
    if kind != "Perspective":
        raise messages.calibration_unusable(
            where=path,
            coefficients="coefficients",
            kind=kind,
        )
    plain: Mapping[str, float] = {"AspectRatio": 1.0, "Skew": 0.0}
    for name, value in plain.items():
        if float(group.findtext(name, str(value))) != value:
            raise messages.calibration_unusable(
                where=path,
                coefficients=name,
                kind=kind,
            )
    width, height = _size(group)
    focal = group.findtext("FocalLengthPixels")
    f_px = float(_text(group, "FocalLength")) / _pixel_mm(group) if focal is None else float(focal)
    cx, cy = _principal_point(group)
    coefficients = [float(group.findtext(f"Distortion/{name}", "0")) for name in _COEFFICIENTS]
    return camera_of_model("BROWN", width, height, [f_px, f_px, cx, cy, *coefficients])
