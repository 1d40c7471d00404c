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

A control point has its name, a tie point its name or ``tie:`` and its number. The name of an image
is its path, or of an absolute path the name of the file, with the folder before it if such names
repeat.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.block.known_places import KnownPlaces
from unbend.flight.heights import GeodeticOrigin
from unbend.tables.geodata.coordinate_systems import kind_of_system, lat_lon_of
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.blocks_exchange_cameras import (
    camera_axes,
    camera_of,
    pixel_of,
    text_of,
)
from unbend.tables.imports.blocks.image_points import (
    CameraMakers,
    oriented_images,
    quaternions_of_poses,
    rows_of_image,
    unused_camera_name,
)
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_OPK = ("Omega", "Phi", "Kappa")
_MATRIX = tuple(f"M_{row}{column}" for row in range(3) for column in range(3))


@dataclass(frozen=True)
class _Document:
    """The block of a file, and the spatial reference systems of the file by their ids."""

    block: Element
    systems: Mapping[str, Element]


def block_files(path: Path) -> tuple[Path, ...]:
    """The file itself."""
    if path.is_dir():
        raise messages.is_folder_of_xml(
            where=path,
        )
    return (path,)


def read_cameras(path: Path) -> CameraMakers:
    """The camera of each photogroup, by the name of the photogroup (see `_photogroups`)."""
    makers: CameraMakers = {}
    for name, group in _photogroups(_document(path).block).items():
        makers[name] = partial(camera_of, group, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The photos of all photogroups with their poses; NaN without a pose that was estimated."""
    document = _document(path)
    block = document.block
    names = _image_names(block)
    images = []
    cameras = []
    positions = []
    rotations = []
    for camera, group in _photogroups(block).items():
        _refuse_other_system(path, block, group)
        axes = camera_axes(group)
        for photo in group.iterfind("Photo"):
            images.append(names[text_of(photo, "Id")])
            cameras.append(camera)
            positions.append(_centre(photo.find("Pose/Center")))
            rotations.append(axes @ _rotation(photo.find("Pose/Rotation"), path))
    position = np.array(positions).reshape(-1, 3)
    system = _system_of_block(document)
    if system.is_geographic:
        position[:, :2] = np.radians(position[:, [1, 0]])
    quaternion = quaternions_of_poses(path, images, rotations)
    table = oriented_images(images, cameras, position, quaternion)
    return replace(
        table,
        frame=system.frame,
        crs=system.crs,
    )


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The positions of the photos before the adjustment, in EXIF and in metadata of their poses."""
    document = _document(path)
    names = _image_names(document.block)
    sources = {
        "positions in EXIF": _places_in_exif(document.block, names),
        "metadata of the poses": _places_in_metadata(document, names),
    }
    places = []
    for source, place_of_image in sources.items():
        if place_of_image:
            image = np.array([*place_of_image], object)
            position = np.array([*place_of_image.values()])
            places.append(KnownPlaces(source, image, position))
    return tuple(places)


def _places_in_exif(
    block: Element,
    names: Mapping[str, str],
) -> dict[str, list[float]]:
    """Image -> latitude, longitude [rad] and altitude [m] in its EXIF.

    ``names`` are the names of the images by id of the photo.
    """
    places = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        gps = photo.find("ExifData/GPS")
        if gps is not None:
            image = names[text_of(photo, "Id")]
            places[image] = _place_in_exif(gps)
    return places


def _places_in_metadata(
    document: _Document,
    names: Mapping[str, str],
) -> dict[str, list[float]]:
    """Image -> latitude, longitude [rad] and height in the metadata of its pose.

    Each pose names a system. Images are collected by system, so that PROJ opens each only once.
    ``names`` are the names of the images by id of the photo.
    """
    by_system: dict[str, dict[str, list[float]]] = {}
    for photo in document.block.iterfind("Photogroups/Photogroup/Photo"):
        centre = photo.find("Pose/Metadata/Center")
        if centre is None:
            continue
        image = names[text_of(photo, "Id")]
        crs = _definition_of_system(document.systems, photo.findtext("Pose/Metadata/SRSId"))
        centres = by_system.setdefault(crs, {})
        centres[image] = _centre(centre, only_accurate=False)
    places: dict[str, list[float]] = {}
    for crs, centres_of_system in by_system.items():
        places |= _places_of_centres(centres_of_system, crs)
    return places


def _place_in_exif(gps: Element) -> list[float]:
    """Latitude, longitude [rad] and altitude [m] of the element GPS; NaN where one is missing."""
    latitude_deg = float(gps.findtext("Latitude", "nan"))
    longitude_deg = float(gps.findtext("Longitude", "nan"))
    altitude = float(gps.findtext("Altitude", "nan"))
    return [np.radians(latitude_deg), np.radians(longitude_deg), altitude]


def _places_of_centres(
    centres: Mapping[str, list[float]],
    crs: str,
) -> dict[str, list[float]]:
    """Image -> latitude, longitude [rad] and z, from x, y, z in the system ``crs``.

    Empty if PROJ does not know the system.
    """
    xyz = np.array([*centres.values()])
    lat_lon = lat_lon_of(crs, xyz[:, 0], xyz[:, 1])
    if lat_lon is None:
        return {}
    latitude, longitude = lat_lon
    places = np.stack([latitude, longitude, xyz[:, 2]], axis=1)
    return dict(zip(centres, places.tolist(), strict=True))


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The measurements of control points and tie points, image by image."""
    block = _document(path).block
    names = _image_names(block)
    groups = _group_of_photo(block)
    rows: dict[str, list[tuple[str, float, float]]] = {number: [] for number in names}
    for name, measurement in _measurements(block):
        number = text_of(measurement, "PhotoId")
        if number not in rows:
            raise messages.photo_unknown(
                where=path,
                point=name,
                number=number,
            )
        x, y = pixel_of(measurement, groups[number])
        rows[number].append((name, x, y))
    for number, name in names.items():
        if rows[number]:
            pixels = [row[1:] for row in rows[number]]
            points = [row[0] for row in rows[number]]
            yield rows_of_image(name, pixels, points)


def _measurements(block: Element) -> Iterator[tuple[str, Element]]:
    """All measurements of points in images, each with the name of its point."""
    for name, point in _points(block):
        for measurement in point.iterfind("Measurement"):
            yield name, measurement


def _group_of_photo(block: Element) -> dict[str, Element]:
    """Id of a photo -> its photogroup."""
    groups = {}
    for group in block.iterfind("Photogroups/Photogroup"):
        for photo in group.iterfind("Photo"):
            groups[text_of(photo, "Id")] = group
    return groups


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The control points and tie points that have a position in the block's system."""
    document = _document(path)
    block = document.block
    names = []
    places = []
    for container in ("ControlPoints", "TiePoints"):
        for name, point in _points(block, container):
            position = point.find("Position")
            if position is None or position.find("z") is None:
                continue
            if _is_in_system_of_block(block, container, point):
                names.append(name)
                places.append(_centre(position))
    positions = np.array(places, np.float64).reshape(-1, 3)
    if _system_of_block(document).is_geographic:
        positions[:, :2] = np.radians(positions[:, [1, 0]])
    return pa.array(names, pa.string()), positions


def _is_in_system_of_block(
    block: Element,
    container: str,
    point: Element,
) -> bool:
    """Whether a point is in the spatial reference system of its block.

    ``container`` is the element of the point's list, ControlPoints or TiePoints.
    """
    of_block = block.findtext("SRSId", "")
    of_container = block.findtext(f"{container}/SRSId", of_block)
    return point.findtext("SRSId", of_container) == of_block


@dataclass(frozen=True)
class BlockSystem:
    """The spatial reference system of a block.

    Either ``frame`` is the frame of x, y, z, or ``crs`` is a system of PROJ's, with longitude and
    latitude in degrees if ``is_geographic``. Both are None for a local system.
    """

    frame: Literal["ecef"] | GeodeticOrigin | None = None
    crs: str | None = None
    is_geographic: bool = False


def _document(path: Path) -> _Document:
    """Read the XML of a file; refuses another kind of file, and other than one block."""
    root = ElementTree.fromstring(path.read_bytes())
    if root.tag != "BlocksExchange":
        raise messages.not_blocks_exchange(
            where=path,
            tag=root.tag,
        )
    blocks = root.findall("Block")
    if len(blocks) != 1:
        names = ", ".join(repr(block.findtext("Name", "")) for block in blocks)
        raise messages.several_blocks(where=path, blocks=len(blocks), names=names)
    systems: dict[str, Element] = {}
    for system in root.iterfind("SpatialReferenceSystems/SRS"):
        systems.setdefault(text_of(system, "Id"), system)
    return _Document(blocks[0], systems)


def _photogroups(block: Element) -> dict[str, Element]:
    """The photogroups by name; their number, from 1, completes a missing or repeated name."""
    groups: dict[str, Element] = {}
    for number, group in enumerate(block.iterfind("Photogroups/Photogroup"), 1):
        label = group.findtext("Name", "").strip() or str(number)
        groups[unused_camera_name(label, str(number), groups)] = group
    return groups


def _image_names(block: Element) -> dict[str, str]:
    """Id of a photo -> name of its image (see `_name_of_path`)."""
    paths = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        path_text = text_of(photo, "ImagePath").replace("\\", "/")
        paths[text_of(photo, "Id")] = PurePosixPath(path_text)
    count = Counter(path.name for path in paths.values())
    names = {}
    for number, path in paths.items():
        names[number] = _name_of_path(path, is_unique=count[path.name] == 1)
    return names


def _name_of_path(
    path: PurePosixPath,
    *,
    is_unique: bool,
) -> str:
    """The name of an image: a relative path, or of an absolute path the name of the file.

    If this name is not unique in the block, the folder is before it.
    """
    is_absolute = path.is_absolute() or ":" in path.parts[0]
    if not is_absolute:
        return str(path)
    if is_unique or not path.parent.name:
        return path.name
    return f"{path.parent.name}/{path.name}"


def _points(
    block: Element,
    container: str | None = None,
) -> Iterator[tuple[str, Element]]:
    """Name and element of all control points, then of all tie points.

    ``container``, ControlPoints or TiePoints, restricts them to one kind. A point without a name is
    called control: or tie: and its number, from 1.
    """
    if container in (None, "ControlPoints"):
        for number, point in enumerate(block.iterfind("ControlPoints/ControlPoint"), 1):
            name = point.findtext("Name", "").strip()
            yield name or f"control:{number}", point
    if container in (None, "TiePoints"):
        for number, point in enumerate(block.iterfind("TiePoints/TiePoint"), 1):
            name = point.findtext("Name", "").strip()
            yield name or f"tie:{number}", point


def _definition_of_system(
    systems: Mapping[str, Element],
    number: str | None,
) -> str:
    """The definition of the spatial reference system with the id ``number``; empty without one."""
    if number is None:
        return ""
    system = systems.get(number.strip())
    if system is None:
        return ""
    return text_of(system, "Definition")


def _system_of_block(document: _Document) -> BlockSystem:
    """The spatial reference system of a block, from its definition."""
    definition = _definition_of_system(document.systems, document.block.findtext("SRSId"))
    if definition.upper().startswith("ENU:"):
        numbers = [float(number) for number in definition[4:].split(",")]
        lat, lon, *height = numbers
        origin = GeodeticOrigin(
            lat_rad=np.radians(lat),
            lon_rad=np.radians(lon),
            h_ellipsoid_m=height[0] if height else 0.0,
        )
        return BlockSystem(frame=origin)
    kind = kind_of_system(definition)
    if kind in ("geographic", "projected"):
        return BlockSystem(crs=definition, is_geographic=kind == "geographic")
    return BlockSystem(frame="ecef" if kind == "ecef" else None)


def _refuse_other_system(
    path: Path,
    block: Element,
    group: Element,
) -> None:
    """Refuse a photogroup in another spatial reference system than its block."""
    of_group = group.findtext("SRSId")
    if of_group is not None and of_group != block.findtext("SRSId"):
        raise messages.system_of_group(where=path, name=group.findtext("Name", ""))


def _is_not_accurate(element: Element) -> bool:
    """Whether the program has marked a part of a pose as not estimated (Accurate is false)."""
    accurate_text = element.findtext("Accurate", "true")
    return accurate_text.strip().lower() in ("false", "0")


def _centre(
    element: Element | None,
    *,
    only_accurate: bool = True,
) -> list[float]:
    """x, y, z of an element; NaN without the element.

    Also NaN, with ``only_accurate``, if the program has marked them as not estimated.
    """
    unknown = [np.nan, np.nan, np.nan]
    if element is None or (only_accurate and _is_not_accurate(element)):
        return unknown
    return [float(element.findtext(axis, "nan")) for axis in "xyz"]


def _rotation(
    element: Element | None,
    path: Path,
) -> Array:
    """(3, 3) from the spatial reference system to the camera's axes; NaN where unknown.

    Refuses angles other than omega, phi, kappa.
    """
    unknown = np.full((3, 3), np.nan)
    if element is None or _is_not_accurate(element):
        return unknown
    parts = {part.tag: part.text or "" for part in element}
    if set(_MATRIX) <= parts.keys():
        return np.array([float(parts[name]) for name in _MATRIX]).reshape(3, 3)
    if set(_OPK) <= parts.keys():
        angles = [float(parts[name]) for name in _OPK]
        return np.asarray(Rotation.from_euler("XYZ", angles, degrees=True).as_matrix().T)
    names = [name for name in parts if name != "Accurate"]
    if names:
        raise messages.rotation_unreadable(where=path, angles=", ".join(map(str, names)))
    return unknown
