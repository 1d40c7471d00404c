"""Metashape (PhotoScan): archives (.psz), exported cameras and markers (.xml), calibrations.

Pixels count from the corner of the image, as COLMAP's: the centre of the upper left pixel is (0.5,
0.5). u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f (manual, appendix on camera models);
before version 1.3: u = cx + x' fx + y' skew. P1 belongs to x and P2 to y, the other way round than
in OpenCV. A camera's transform leads from it (x right, y down, z forward) to its chunk, the chunk's
to the earth's centre where it has a coordinate system, in the datum of that, else to local
coordinates. A slave camera of a rig has no transform of its own where it follows its master: there
it is the master's, times rotation and place of its sensor in the master's axes and the chunk's
units. A marker has its label as name; a tie point is called ``tie:`` and its number. An image has
the label of its camera; labels that repeat have the group's, or folders, before them. A camera that
is disabled took no part in the adjustment: its pose is an old one, and it is left out.
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
from scipy.spatial.transform import Rotation

from unbend.block.known_places import KnownPlaces
from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.tables.geodata.coordinate_systems import is_on_wgs84, lat_lon_of
from unbend.tables.geodata.geocentric_datums import datum_of
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
from unbend.tables.imports.blocks.metashape_project import (
    document,
    files_of_project,
    only_chunk,
    vertices,
)
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_NOT_MODELLED = {"frame": ("p3", "p4"), "fisheye": ("p1", "p2", "p3", "p4", "b2", "skew")}


def block_files(path: Path) -> tuple[Path, ...]:
    """The file itself, and the archives of a project."""
    return files_of_project(path)


def read_cameras(path: Path) -> CameraMakers:
    """The calibration of each sensor by its label, with its number where labels repeat."""
    root = document(path)
    if root.tag == "calibration":
        return {"calibration": partial(_camera, root, path)}
    makers: CameraMakers = {}
    for sensor in _sensors(root).values():
        makers[sensor.name] = partial(_camera, sensor.calibration, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The cameras of the chunk with their transforms; unknown where one is not aligned."""
    chunk = only_chunk(path)
    all_cameras = [*chunk.iterfind("cameras//camera")]
    cameras = [camera for camera in all_cameras if _is_enabled(camera)]
    name_of_camera = _image_names(chunk)
    names = [name_of_camera[camera.get("id", "")] for camera in cameras]
    position, quaternion = _exterior_orientations(chunk, cameras)
    table = oriented_images(names, _names_of_sensors(chunk, cameras), position, quaternion)
    left_out = [name_of_camera[number] for number in _disabled_cameras(chunk)]
    if left_out:
        note = messages.disabled_cameras(where=path, names=left_out)
        table = replace(table, notes=(note,))
    if chunk.find(".//transform/scale") is None:
        return table
    reference = chunk.findtext("reference", "")
    return replace(table, frame="ecef" if is_on_wgs84(reference) else datum_of(reference))


def _names_of_sensors(
    chunk: ElementTree.Element,
    cameras: list[ElementTree.Element],
) -> list[str]:
    """The name of each camera's sensor, empty for one that is not there."""
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
    """(n, 3) positions and (n, 4) quaternions w, x, y, z of cameras; NaN of those not aligned."""
    all_cameras = [*chunk.iterfind("cameras//camera")]
    poses = _poses(chunk, all_cameras)  # a master may be disabled, and its slave not
    components = _components(all_cameras)
    position = np.full((len(cameras), 3), np.nan)
    quaternion = np.full((len(cameras), 4), np.nan)
    for row, camera in enumerate(cameras):
        number = camera.get("id", "")
        if number in poses:
            to_earth = _to_earth(chunk, components[number])
            position[row], quaternion[row] = _exterior_orientation(poses[number], to_earth)
    return position, quaternion


def read_places(path: Path) -> tuple[KnownPlaces, ...]:
    """The reference of the cameras, in the chunk's coordinate system or its local coordinates."""
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
    """Markers, then tie points, image by image."""
    chunk = only_chunk(path)
    frames = [*chunk.iterfind("frames/frame")] or [chunk]
    if len(frames) > 1:
        raise messages.several_frames(where=path, frames=len(frames))
    marks = _marks(chunk, frames[0])
    ties = _files_of_tie_points(frames[0])
    disabled = _disabled_cameras(chunk)
    for number, image in _image_names(chunk).items():
        if number in disabled:
            continue
        points = marks.get(number, [])
        if number in ties:
            points += _tie_points(path, ties[number])
        if points:
            names = [point.name for point in points]
            pixels = [(point.x, point.y) for point in points]
            yield rows_of_image(image, pixels, names)


def _files_of_tie_points(frame: ElementTree.Element) -> dict[str | None, str]:
    """The file of the project with the tie points in each image, by the camera's id."""
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
    """The tie points in an image, by the file of the project that has them."""
    rows = vertices(path, file)[["id", "x", "y"]].tolist()
    return [_ImagePoint(f"tie:{number}", x, y) for number, x, y in rows]


def _marks(
    chunk: ElementTree.Element,
    frame: ElementTree.Element,
) -> dict[str, list[_ImagePoint]]:
    """The markers in each image, by the camera's id: label of the marker, x and y."""
    label = {}
    for marker in chunk.iterfind("markers//marker"):
        label[marker.get("id")] = marker.get("label", "")
    marks: dict[str, list[_ImagePoint]] = {}
    for marker in frame.iterfind("markers/marker"):
        name = label[marker.get("marker_id")]
        for place in marker.iterfind("location"):
            if place.get("valid", "true") in ("false", "0"):
                continue
            x = float(place.attrib["x"])
            y = float(place.attrib["y"])
            mark = _ImagePoint(name, x, y)
            marks.setdefault(place.attrib["camera_id"], []).append(mark)
    return marks


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The tie points of an archive."""
    chunk = only_chunk(path)
    cloud = chunk.find("frames/frame/point_cloud/points")
    if cloud is None:
        return pa.array([], pa.string()), np.empty((0, 3))
    points = vertices(path, cloud.attrib["path"])
    to_earth = _to_earth(chunk, None)
    places = np.stack(
        [points[axis].astype(np.float64) for axis in "xyz"],
        axis=1,
    )
    turned = to_earth.scale * places @ to_earth.turn.T
    names = [f"tie:{number}" for number in points["id"].tolist()]
    return pa.array(names, pa.string()), np.asarray(turned + to_earth.step)


def _disabled_cameras(chunk: ElementTree.Element) -> list[str]:
    """The ids of the cameras that took no part in the adjustment."""
    cameras = chunk.iterfind("cameras//camera")
    return [camera.get("id", "") for camera in cameras if not _is_enabled(camera)]


def _is_enabled(element: ElementTree.Element) -> bool:
    """Whether a camera, or its reference, takes part in the adjustment."""
    return element.get("enabled", "true").lower() not in ("false", "0")


def _image_names(chunk: ElementTree.Element) -> dict[str, str]:
    """What the image of each camera is called, by the camera's id, in the order of the cameras.

    It is the camera's label; where several cameras have the same one, it has the label of the
    camera's group before it, or, if they still have the same name, folders of the photo's path.
    """
    cameras = [*chunk.iterfind("cameras//camera")]
    label = {camera.get("id", ""): camera.get("label", "") for camera in cameras}
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
    """The keys whose name is that of another key too."""
    count = Counter(names.values())
    return [key for key, name in names.items() if count[name] > 1]


def _poses(chunk: ElementTree.Element, cameras: list[ElementTree.Element]) -> dict[str, Array]:
    """(4, 4) from each camera to the chunk, by its id; of a slave without one by its master's."""
    poses = {}
    for camera in cameras:
        transform = camera.findtext("transform")
        if transform:
            poses[camera.get("id", "")] = _numbers(transform).reshape(4, 4)
    in_master = {}
    for sensor in chunk.iter("sensor"):
        in_master[sensor.get("id", "")] = _place_in_master(sensor)
    for camera in cameras:
        number = camera.get("id", "")
        master = camera.get("master_id", "")
        if number not in poses and master in poses:
            from_sensor = in_master.get(camera.get("sensor_id", ""), np.eye(4))
            poses[number] = poses[master] @ from_sensor
    return poses


def _numbers(text: str) -> Array:
    """The numbers of a text with blanks between them."""
    return np.array(text.split(), np.float64)


def _place_in_master(sensor: ElementTree.Element) -> Array:
    """(4, 4) from a sensor of a rig to the master's; Metashape leaves out what is none."""
    pose = np.eye(4)
    turn = sensor.findtext("rotation")
    step = sensor.findtext("translation") or sensor.findtext("location")
    if turn:
        pose[:3, :3] = _numbers(turn).reshape(3, 3)
    if step:
        pose[:3, 3] = _numbers(step)
    return pose


def _components(cameras: list[ElementTree.Element]) -> dict[str, str | None]:
    """The id of the component of each camera, by the camera's id; of a slave its master's."""
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
class _ToEarth:
    """From a chunk to its coordinate system: scale, rotation (3, 3) and step (3,)."""

    scale: float
    turn: Array
    step: Array


def _to_earth(chunk: ElementTree.Element, component: str | None) -> _ToEarth:
    """The transform of a chunk, or of a component of it; the step is NaN where it is not known."""
    parts = chunk.findall("components/component")
    transform = chunk.find("transform")
    for part in parts:
        if component == part.get("id") or len(parts) == 1:
            transform = part.find("transform")
    if transform is None:
        unknown = np.nan if len(parts) > 1 else 0.0
        return _ToEarth(
            1.0,
            np.eye(3),
            np.full(3, unknown),
        )
    turn = _numbers(transform.findtext("rotation", "1 0 0 0 1 0 0 0 1"))
    return _ToEarth(
        scale=float(transform.findtext("scale", "1")),
        turn=turn.reshape(3, 3),
        step=_numbers(transform.findtext("translation", "0 0 0")),
    )


def _exterior_orientation(pose: Array, to_earth: _ToEarth) -> tuple[Array, Array]:
    """Position (3,) and quaternion (4,) w, x, y, z of a camera by its pose (4, 4) in the chunk."""
    turn = to_earth.turn
    turned = Rotation.from_matrix((turn @ pose[:3, :3]).T)
    position = to_earth.scale * turn @ pose[:3, 3] + to_earth.step
    return position, turned.as_quat()[[3, 0, 1, 2]]


@dataclass(frozen=True)
class _Sensor:
    """A sensor of a chunk: its label, with its number where labels repeat, and its calibration."""

    name: str
    calibration: ElementTree.Element | None


def _sensors(root: ElementTree.Element) -> dict[str, _Sensor]:
    """The sensors by their ids."""
    sensors: dict[str, _Sensor] = {}
    names: set[str] = set()
    for sensor in root.iter("sensor"):
        label = sensor.get("label", "")
        name = f"{label} {sensor.get('id')}" if label in names else label
        names.add(name)
        sensors[sensor.get("id", name)] = _Sensor(name, _calibration_of(sensor))
    return sensors


def _calibration_of(sensor: ElementTree.Element) -> ElementTree.Element | None:
    """The adjusted calibration of a sensor, or the one that it has if it was held fixed."""
    adjusted = sensor.find("calibration[@class='adjusted']")
    if adjusted is not None:
        return adjusted
    is_fixed = sensor.find("property[@name='fixed'][@value='true']") is not None
    has_initial = sensor.find("calibration[@class='initial']") is not None
    if has_initial and not is_fixed:
        return None
    return sensor.find("calibration")


def _camera(calibration: ElementTree.Element | None, path: Path) -> Camera:
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
    """fx, fy, cx and cy [px], of which those before version 1.3 stand in the file."""
    if calibration.find("fx") is not None:
        return [_number(calibration, name) for name in ("fx", "fy", "cx", "cy")]
    f = _number(calibration, "f")
    cx = 0.5 * width + _number(calibration, "cx")
    cy = 0.5 * height + _number(calibration, "cy")
    return [f + _number(calibration, "b1"), f, cx, cy]
