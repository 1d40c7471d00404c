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
from xml.etree.ElementTree import Element

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.block.known_places import KnownPlaces
from unbend.flight.heights import GeodeticOrigin
from unbend.flight.rotations import quaternions_of
from unbend.tables.geodata.coordinate_systems import kind_of_system, lat_lon_of
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.blocks_exchange_cameras import (
    camera_axes,
    camera_of,
    pixel_of,
    text_of,
)
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
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
    """The camera of each photogroup by its name, with its number where names repeat."""
    makers: CameraMakers = {}
    for name, group in _groups(_document(path).block).items():
        makers[name] = partial(camera_of, group, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The photos of all photogroups; unknown where one has no pose, or one not yet estimated."""
    document = _document(path)
    block = document.block
    names = _image_names(block)
    images = []
    cameras = []
    positions = []
    rotations = []
    for camera, group in _groups(block).items():
        _refuse_other_system(path, block, group)
        axes = camera_axes(group)
        for photo in group.iterfind("Photo"):
            images.append(names[text_of(photo, "Id")])
            cameras.append(camera)
            positions.append(_centre(photo.find("Pose/Center")))
            rotations.append(axes @ _rotation(photo.find("Pose/Rotation"), path))
    position = np.array(positions).reshape(-1, 3)
    system = _system(document)
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
    is_known = np.isfinite(matrices).all(axis=(1, 2))
    quaternion = np.full((len(matrices), 4), np.nan)
    if is_known.any():
        quaternion[is_known] = quaternions_of(matrices[is_known])
    return quaternion


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The positions of the photos before the adjustment, in EXIF or as metadata of their poses."""
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
    """Latitude, longitude [rad] and altitude [m] in the EXIF of the photos, by image."""
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
    """The same of the metadata of the poses, which name a system each; PROJ reads each once."""
    by_system: dict[str, dict[str, list[float]]] = {}
    for photo in document.block.iterfind("Photogroups/Photogroup/Photo"):
        centre = photo.find("Pose/Metadata/Center")
        if centre is None:
            continue
        image = names[text_of(photo, "Id")]
        crs = _definition(document.systems, photo.findtext("Pose/Metadata/SRSId"))
        of_system = by_system.setdefault(crs, {})
        of_system[image] = _centre(centre, only_accurate=False)
    places: dict[str, list[float]] = {}
    for crs, centres in by_system.items():
        places |= _places_of_centres(centres, crs)
    return places


def _place_in_exif(gps: Element) -> list[float]:
    """Latitude, longitude [rad] and altitude [m] of a photo's EXIF."""
    latitude_deg = float(gps.findtext("Latitude", "nan"))
    longitude_deg = float(gps.findtext("Longitude", "nan"))
    altitude = float(gps.findtext("Altitude", "nan"))
    return [np.radians(latitude_deg), np.radians(longitude_deg), altitude]


def _places_of_centres(
    centres: Mapping[str, list[float]],
    crs: str,
) -> dict[str, list[float]]:
    """Latitude, longitude [rad] and z of x, y, z in a system, by image; none if it is unknown."""
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
    """All measurements, with the names of their points."""
    for name, point in _points(block):
        for measurement in point.iterfind("Measurement"):
            yield name, measurement


def _group_of_photo(block: Element) -> dict[str, Element]:
    """The photogroup of each photo, by the photo's id."""
    groups = {}
    for group in block.iterfind("Photogroups/Photogroup"):
        for photo in group.iterfind("Photo"):
            groups[text_of(photo, "Id")] = group
    return groups


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The tie points and control points that have a position in the block's own system."""
    document = _document(path)
    block = document.block
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
    if _system(document).is_geographic:
        positions[:, :2] = np.radians(positions[:, [1, 0]])
    return pa.array(names, pa.string()), positions


def _has_own_system(
    block: Element,
    container: str,
    point: Element,
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


def _document(path: Path) -> _Document:
    """What a file holds; refuses another kind of file, no block, and several."""
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


def _groups(block: Element) -> dict[str, Element]:
    """The photogroups by their names."""
    groups: dict[str, Element] = {}
    for number, group in enumerate(block.iterfind("Photogroups/Photogroup"), 1):
        name = group.findtext("Name", "").strip() or str(number)
        groups[f"{name} {number}" if name in groups else name] = group
    return groups


def _image_names(block: Element) -> dict[str, str]:
    """What the image of each photo is called, by the photo's id."""
    paths = {}
    for photo in block.iterfind("Photogroups/Photogroup/Photo"):
        written = text_of(photo, "ImagePath").replace("\\", "/")
        paths[text_of(photo, "Id")] = PurePosixPath(written)
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
    block: Element,
    container: str | None = None,
) -> Iterator[tuple[str, Element]]:
    """Control points by their names, then tie points by their place."""
    if container in (None, "ControlPoints"):
        for number, point in enumerate(block.iterfind("ControlPoints/ControlPoint"), 1):
            name = point.findtext("Name", "").strip()
            yield name or f"control:{number}", point
    if container in (None, "TiePoints"):
        for number, point in enumerate(block.iterfind("TiePoints/TiePoint"), 1):
            name = point.findtext("Name", "").strip()
            yield name or f"tie:{number}", point


def _definition(
    systems: Mapping[str, Element],
    number: str | None,
) -> str:
    """The definition of a spatial reference system by its id; empty for a local one."""
    if number is None:
        return ""
    system = systems.get(number.strip())
    if system is None:
        return ""
    return text_of(system, "Definition")


def _system(document: _Document) -> BlockSystem:
    """What the spatial reference system of a block is."""
    definition = _definition(document.systems, document.block.findtext("SRSId"))
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
    """Whether the program says that it has not estimated a part of a pose."""
    accurate_text = element.findtext("Accurate", "true")
    return accurate_text.strip().lower() in ("false", "0")


def _centre(
    element: Element | None,
    *,
    only_accurate: bool = True,
) -> list[float]:
    """x, y, z; NaN without, and where the program says that it has not estimated them."""
    unknown = [np.nan, np.nan, np.nan]
    if element is None or (only_accurate and _is_not_accurate(element)):
        return unknown
    return [float(element.findtext(axis, "nan")) for axis in "xyz"]


def _rotation(
    element: Element | None,
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
        raise messages.rotation_unreadable(where=path, angles=", ".join(map(str, names)))
    return unknown
