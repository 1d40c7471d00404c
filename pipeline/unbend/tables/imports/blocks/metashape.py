"""Metashape (PhotoScan): archives (.psz), exported cameras and markers (.xml), calibrations.

Pixels count from the corner of the image, as COLMAP's: the centre of the upper left pixel is (0.5,
0.5). u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f (manual, appendix on camera models);
before version 1.3: u = cx + x' fx + y' skew. P1 belongs to x and P2 to y, the other way round than
in OpenCV. A camera's transform leads from it (x right, y down, z forward) to its chunk, the chunk's
to the earth's centre where it has a coordinate system, in the datum of that, else to local
coordinates. A slave camera of a rig that follows its master has no transform in the file: it is the
master's, times rotation and place of its sensor in the master's axes and the chunk's units. A
marker has its label as name; a tie point is called ``tie:`` and its number. An image has the label
of its camera; labels that repeat have the group's label, or a folder, before them. A camera that is
disabled took no part in the adjustment: its pose is an old one, and it is left out.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from unbend.block.known_places import KnownPlaces
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.tables.geodata.coordinate_systems import is_on_wgs84, lat_lon_of
from unbend.tables.geodata.geocentric_datums import datum_of
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import (
    CameraMakers,
    oriented_images,
    quaternions_of_poses,
    rows_of_image,
    unused_camera_name,
)
from unbend.tables.imports.blocks.metashape_project import (
    document,
    files_of_project,
    only_chunk,
    vertices,
)
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

# Kind of calibration -> coefficients that no camera of this package has.
_NOT_MODELLED = {"frame": ("p3", "p4"), "fisheye": ("p1", "p2", "p3", "p4", "b2", "skew")}


def block_files(path: Path) -> tuple[Path, ...]:
    """The file itself, and the archives of a project."""
    return files_of_project(path)


def read_cameras(path: Path) -> CameraMakers:
    """The camera of each sensor by its label, with its id where labels repeat."""
    root = document(path)
    if root.tag == "calibration":
        return {"calibration": partial(_camera, root, path)}
    makers: CameraMakers = {}
    for sensor in _sensors(root).values():
        makers[sensor.name] = partial(_camera, sensor.calibration, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The enabled cameras of the chunk with their poses; NaN for cameras that are not aligned."""
    chunk = only_chunk(path)
    all_cameras = [*chunk.iterfind("cameras//camera")]
    cameras = [camera for camera in all_cameras if _is_enabled(camera)]
    name_of_camera = _image_names(chunk)
    names = [name_of_camera[camera.get("id", "")] for camera in cameras]
    position, rotation = _exterior_orientations(chunk, cameras)
    quaternion = quaternions_of_poses(path, names, rotation)
    table = oriented_images(names, _names_of_sensors(chunk, cameras), position, quaternion)
    left_out = [name_of_camera[number] for number in _disabled_cameras(chunk)]
    if left_out:
        note = messages.disabled_cameras(where=path, names=left_out)
        table = replace(table, notes=(note,))
    if chunk.find(".//transform/scale") is None:
        return table
    reference = chunk.findtext("reference", "")
    return replace(table, frame="ecef" if is_on_wgs84(reference) else datum_of(reference))


def _names_of_sensors(chunk: ElementTree.Element, cameras: list[ElementTree.Element]) -> list[str]:
    """(n,) the name of each camera's sensor; empty for a sensor that the chunk does not have."""
    sensors = _sensors(chunk)
    names = []
    for camera in cameras:
        sensor = sensors.get(camera.get("sensor_id", ""))
        names.append("" if sensor is None else sensor.name)
    return names


def _exterior_orientations(
    chunk: ElementTree.Element,
    cameras: list[ElementTree.Element],
) -> tuple[Array, Array]:
    """(n, 3) positions and (n, 3, 3) rotation matrices of ``cameras``; NaN if not aligned.

    The matrices lead from the earth or local coordinates to the camera.
    """
    all_cameras = [*chunk.iterfind("cameras//camera")]
    poses = _poses(chunk, all_cameras)  # a master may be disabled, and its slave not
    components = _components(all_cameras)
    position = np.full((len(cameras), 3), np.nan)
    rotation = np.full((len(cameras), 3, 3), np.nan)
    for row, camera in enumerate(cameras):
        number = camera.get("id", "")
        if number in poses:
            pose = poses[number]
            transform = _chunk_transform(chunk, components[number])
            camera_place = transform.scale * transform.rotation @ pose[:3, 3]
            position[row] = camera_place + transform.translation
            rotation[row] = (transform.rotation @ pose[:3, :3]).T
    return position, rotation


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The enabled references of cameras: their positions before the adjustment.

    Latitude, longitude [rad] and height, or x, y, z in the local coordinates of the chunk.
    """
    root = document(path)
    if root.tag == "calibration":
        return ()
    chunk = only_chunk(path)
    names = _image_names(chunk)
    images = []
    places = []
    for camera in chunk.iterfind("cameras//camera"):
        reference = camera.find("reference")
        if reference is None or not _is_enabled(reference) or not _is_enabled(camera):
            continue
        place = [float(reference.get(axis, "nan")) for axis in "xyz"]
        if np.isfinite(place[:2]).all():
            images.append(names[camera.get("id", "")])
            places.append(place)
    if not images:
        return ()
    position = np.array(places)
    crs = chunk.findtext("camera_crs", "") or chunk.findtext("reference", "")
    lat_lon = lat_lon_of(
        crs,
        position[:, 0],
        position[:, 1],
    )
    if lat_lon is not None:
        position[:, 0], position[:, 1] = lat_lon
    reference_places = KnownPlaces(
        "the camera reference of the chunk",
        np.array(images, object),
        position,
        in_frame=lat_lon is None,
    )
    return (reference_places,)


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The markers, then the tie points of each image, image by image."""
    chunk = only_chunk(path)
    frames = [*chunk.iterfind("frames/frame")] or [chunk]
    if len(frames) > 1:
        raise messages.several_frames(where=path, frames=len(frames))
    markers = _markers_of_images(chunk, frames[0])
    tie_point_files = _files_of_tie_points(frames[0])
    disabled = _disabled_cameras(chunk)
    for number, image in _image_names(chunk).items():
        if number in disabled:
            continue
        points = markers.get(number, [])
        if number in tie_point_files:
            points += _tie_points(path, tie_point_files[number])
        if points:
            names = [point.name for point in points]
            pixels = [(point.x, point.y) for point in points]
            yield rows_of_image(image, pixels, names)


def _files_of_tie_points(frame: ElementTree.Element) -> dict[str | None, str]:
    """Id of a camera -> file of the project with the tie points of its image."""
    files = {}
    for projections in frame.iterfind("point_cloud/projections"):
        files[projections.get("camera_id")] = projections.attrib["path"]
    return files


class _ImagePoint(NamedTuple):
    """A point in an image: its name, x and y [px]."""

    name: str
    x: float
    y: float


def _tie_points(path: Path, file: str) -> list[_ImagePoint]:
    """The tie points of an image; ``file`` is their file in the project or archive ``path``."""
    rows = vertices(path, file)[["id", "x", "y"]].tolist()
    return [_ImagePoint(f"tie:{number}", x, y) for number, x, y in rows]


def _markers_of_images(
    chunk: ElementTree.Element,
    frame: ElementTree.Element,
) -> dict[str, list[_ImagePoint]]:
    """Id of a camera -> the markers that are measured in its image, by their labels."""
    label_of_marker = {}
    for marker in chunk.iterfind("markers//marker"):
        label_of_marker[marker.get("id")] = marker.get("label", "")
    markers: dict[str, list[_ImagePoint]] = {}
    for marker in frame.iterfind("markers/marker"):
        name = label_of_marker[marker.get("marker_id")]
        for location in marker.iterfind("location"):
            if location.get("valid", "true") in ("false", "0"):
                continue
            x = float(location.attrib["x"])
            y = float(location.attrib["y"])
            point = _ImagePoint(name, x, y)
            markers.setdefault(location.attrib["camera_id"], []).append(point)
    return markers


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The names and (p, 3) positions of the tie points, in the frame of the images."""
    chunk = only_chunk(path)
    cloud = chunk.find("frames/frame/point_cloud/points")
    if cloud is None:
        return pa.array([], pa.string()), np.empty((0, 3))
    points = vertices(path, cloud.attrib["path"])
    transform = _chunk_transform(chunk, None)
    places = np.stack(
        [points[axis].astype(np.float64) for axis in "xyz"],
        axis=1,
    )
    turned = transform.scale * places @ transform.rotation.T
    names = [f"tie:{number}" for number in points["id"].tolist()]
    return pa.array(names, pa.string()), np.asarray(turned + transform.translation)


def _disabled_cameras(chunk: ElementTree.Element) -> list[str]:
    """The ids of the cameras that took no part in the adjustment."""
    cameras = chunk.iterfind("cameras//camera")
    return [camera.get("id", "") for camera in cameras if not _is_enabled(camera)]


def _is_enabled(element: ElementTree.Element) -> bool:
    """Whether a camera, or its reference, takes part in the adjustment."""
    return element.get("enabled", "true").lower() not in ("false", "0")


def _image_names(chunk: ElementTree.Element) -> dict[str, str]:
    """Id of each camera, in their order -> name of its image.

    The name is the camera's label. Where several cameras have the same label, it is group/label, or
    if that repeats too, folder/label with the folder of the photo.
    """
    label = {}
    for camera in chunk.iterfind("cameras//camera"):
        label[camera.get("id", "")] = camera.get("label", "")
    group_of_camera = {}
    for group in chunk.iterfind("cameras//group"):
        for camera in group.iterfind("camera"):
            group_of_camera[camera.get("id", "")] = group.get("label", "")
    path_of_camera = {}
    for camera in chunk.iterfind("frames/frame/cameras/camera"):
        photo = camera.find("photo")
        if photo is not None:
            path_of_camera[camera.get("camera_id", "")] = photo.get("path", "")
    names = dict(label)
    for number in _repeated(names):
        if group_of_camera.get(number):
            names[number] = f"{group_of_camera[number]}/{label[number]}"
    for number in _repeated(names):
        folder = PurePosixPath(path_of_camera.get(number, "")).parent.name
        if folder:
            names[number] = f"{folder}/{label[number]}"
    return names


def _repeated(names: Mapping[str, str]) -> list[str]:
    """The keys with a name that another key has too."""
    count = Counter(names.values())
    return [key for key, name in names.items() if count[name] > 1]


def _poses(chunk: ElementTree.Element, cameras: list[ElementTree.Element]) -> dict[str, Array]:
    """Id of a camera -> (4, 4) from the camera to the chunk.

    A slave camera without a transform has its master's and that of its sensor. Cameras that are not
    aligned are left out.
    """
    poses = {}
    for camera in cameras:
        transform = camera.findtext("transform")
        if transform:
            poses[camera.get("id", "")] = _numbers(transform).reshape(4, 4)
    master_from_sensors = {}
    for sensor in chunk.iter("sensor"):
        master_from_sensors[sensor.get("id", "")] = _master_from_sensor(sensor)
    for camera in cameras:
        number = camera.get("id", "")
        master = camera.get("master_id", "")
        if number not in poses and master in poses:
            sensor_id = camera.get("sensor_id", "")
            poses[number] = poses[master] @ master_from_sensors.get(sensor_id, np.eye(4))
    return poses


def _numbers(text: str) -> Array:
    """The numbers of a text that are separated by blanks; ValueError where one is not finite."""
    numbers = np.array(text.split(), np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError(text)
    return numbers


def _master_from_sensor(sensor: ElementTree.Element) -> Array:
    """(4, 4) from a sensor of a rig to the master's sensor; an element that is missing is zero."""
    pose = np.eye(4)
    rotation = sensor.findtext("rotation")
    translation = sensor.findtext("translation") or sensor.findtext("location")
    if rotation:
        pose[:3, :3] = _numbers(rotation).reshape(3, 3)
    if translation:
        pose[:3, 3] = _numbers(translation)
    return pose


def _components(cameras: list[ElementTree.Element]) -> dict[str, str | None]:
    """Id of a camera -> id of its component or None; that of its master for a slave without."""
    component_ids = {camera.get("id", ""): camera.get("component_id") for camera in cameras}
    components = {}
    for camera in cameras:
        number = camera.get("id", "")
        component = component_ids[number]
        if component is None and not camera.findtext("transform"):
            component = component_ids.get(camera.get("master_id", ""))
        components[number] = component
    return components


@dataclass(frozen=True, eq=False)
class _ChunkTransform:
    """Places x in a chunk to the earth or local coordinates: scale * rotation @ x + translation."""

    scale: float
    rotation: Array  # (3, 3)
    translation: Array  # (3,) [m]; NaN if unknown


def _chunk_transform(chunk: ElementTree.Element, component: str | None) -> _ChunkTransform:
    """The transform of a chunk, or of its component with the id ``component``.

    Without a transform in the file it is the identity. Of a chunk with several components the
    translation is then NaN: how they are placed to each other is unknown.
    """
    parts = chunk.findall("components/component")
    transform = chunk.find("transform")
    for part in parts:
        if component == part.get("id") or len(parts) == 1:
            transform = part.find("transform")
    if transform is None:
        coordinate = np.nan if len(parts) > 1 else 0.0
        return _ChunkTransform(
            1.0,
            np.eye(3),
            np.full(3, coordinate),
        )
    rotation = _numbers(transform.findtext("rotation", "1 0 0 0 1 0 0 0 1"))
    return _ChunkTransform(
        scale=float(transform.findtext("scale", "1")),
        rotation=rotation.reshape(3, 3),
        translation=_numbers(transform.findtext("translation", "0 0 0")),
    )


@dataclass(frozen=True)
class _Sensor:
    """A sensor of a chunk: its label, with its id where labels repeat, and its calibration."""

    name: str
    calibration: ElementTree.Element | None


def _sensors(root: ElementTree.Element) -> dict[str, _Sensor]:
    """The sensors by their ids."""
    sensors: dict[str, _Sensor] = {}
    names: set[str] = set()
    for sensor in root.iter("sensor"):
        name = unused_camera_name(sensor.get("label", ""), sensor.get("id", ""), names)
        names.add(name)
        sensors[sensor.get("id", name)] = _Sensor(name, _calibration_of(sensor))
    return sensors


def _calibration_of(sensor: ElementTree.Element) -> ElementTree.Element | None:
    """The adjusted calibration of a sensor, or its only one; None if it was not adjusted.

    The initial calibration is used only of a sensor that was kept fixed in the adjustment.
    """
    adjusted = sensor.find("calibration[@class='adjusted']")
    if adjusted is not None:
        return adjusted
    is_fixed = sensor.find("property[@name='fixed'][@value='true']") is not None
    has_initial = sensor.find("calibration[@class='initial']") is not None
    if has_initial and not is_fixed:
        return None
    return sensor.find("calibration")


def _camera(calibration: ElementTree.Element | None, path: Path) -> Camera:
    """Make the camera of a calibration; refuses None, and coefficients that are not modelled."""
    if calibration is None:
        raise messages.calibration_missing(where=path)
    width = _size_px(calibration, "width")
    height = _size_px(calibration, "height")

    def number(name: str) -> float:
        return _number(calibration, name)

    kind = calibration.get("type") or calibration.findtext("projection") or "frame"
    unused = [name for name in _NOT_MODELLED.get(kind, ()) if number(name) != 0.0]
    if unused:
        raise messages.calibration_unusable(
            where=path,
            coefficients=", ".join(unused),
            kind=kind,
        )
    frame = _frame_of(calibration, width, height)
    k1 = number("k1")
    k2 = number("k2")
    k3 = number("k3")
    k4 = number("k4")
    p1 = number("p1")
    p2 = number("p2")
    skew = number("b2") + number("skew")
    if kind == "fisheye":
        return camera_of_model(
            "OPENCV_FISHEYE",
            width,
            height,
            [*frame, k1, k2, k3, k4],
        )
    if kind != "frame":
        return camera_of_model(kind, width, height, frame)
    if k4 == 0.0 and skew == 0.0:
        return camera_of_model(
            "BROWN",
            width,
            height,
            [*frame, k1, k2, k3, p2, p1],
        )
    general = GeneralFrame(
        k1=k1,
        k2=k2,
        k3=k3,
        k4=k4,
        px=p1,
        py=p2,
        skew_x=skew / frame[0],
    )
    return camera_of_model(
        "GENERAL_FRAME",
        width,
        height,
        [*frame, *general],
    )


def _size_px(calibration: ElementTree.Element, side: str) -> int:
    """The ``width`` or ``height`` of the image [px]."""
    resolution = calibration.find("resolution")
    if resolution is None:
        return int(calibration.findtext(side, "0"))
    return int(resolution.get(side, "0"))


def _number(calibration: ElementTree.Element, name: str) -> float:
    """A number of a calibration, 0 where it has none of that name."""
    return float(calibration.findtext(name, "0"))


def _frame_of(
    calibration: ElementTree.Element,
    width: int,
    height: int,
) -> list[float]:
    """fx, fy, cx and cy [px]; files before version 1.3 have these, later ones f, b1, cx and cy."""
    if calibration.find("fx") is not None:
        return [_number(calibration, name) for name in ("fx", "fy", "cx", "cy")]
    f = _number(calibration, "f")
    cx = 0.5 * width + _number(calibration, "cx")
    cy = 0.5 * height + _number(calibration, "cy")
    return [f + _number(calibration, "b1"), f, cx, cy]
