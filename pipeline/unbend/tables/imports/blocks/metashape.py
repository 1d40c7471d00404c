"""Metashape (PhotoScan): archives (.psz), exported cameras and markers (.xml), calibrations.

Pixels count from the corner of the image, as COLMAP's: the centre of the upper left pixel is (0.5,
0.5). u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f (manual, appendix on camera models);
before version 1.3: u = cx + x' fx + y' skew. P1 belongs to x and P2 to y, the other way round than
in OpenCV. A camera's transform leads from it (x right, y down, z forward) to its chunk, the chunk's
to the earth's centre where it has a coordinate system, else to local coordinates. A marker has its
label as name; a tie point is called ``tie:`` and its number.
"""

import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.tables.geodata.coordinate_systems import is_on_wgs84
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import CameraMakers, oriented_images, rows_of_image
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_NOT_MODELLED = {"frame": ("p3", "p4"), "fisheye": ("p1", "p2", "p3", "p4", "b2", "skew")}
_TYPES = {"float": "<f4", "double": "<f8", "int": "<i4", "uint": "<u4", "uchar": "u1",
          "short": "<i2", "ushort": "<u2", "char": "i1"}  # fmt: skip


def block_files(path: Path) -> tuple[Path, ...]:
    """The file itself."""
    if path.is_dir():
        raise messages.is_folder(where=path)
    return (path,)


def read_cameras(path: Path) -> CameraMakers:
    """The calibration of each sensor by its label, with its number where labels repeat."""
    root = _root(path)
    if root.tag == "calibration":
        return {"calibration": partial(_camera, root, path)}
    return {name: partial(_camera, found, path) for name, found in _sensors(root).values()}


def read_images(path: Path) -> OrientationTable:
    """The cameras of the chunk with their transforms; unknown where one is not aligned."""
    chunk = _chunk(path)
    sensors, cameras = _sensors(chunk), [*chunk.iterfind("cameras//camera")]
    pose, quaternion = np.full((len(cameras), 4, 4), np.nan), np.full((len(cameras), 4), np.nan)
    for row, camera in enumerate(cameras):
        if given := camera.findtext("transform"):
            scale, turn, step = _to_earth(chunk, camera.get("component_id"))
            pose[row] = np.array(given.split(), np.float64).reshape(4, 4)
            turned = Rotation.from_matrix((turn @ pose[row, :3, :3]).T)
            quaternion[row] = turned.as_quat()[[3, 0, 1, 2]]
            pose[row, :3, 3] = scale * turn @ pose[row, :3, 3] + step
    of = [sensors.get(camera.get("sensor_id", ""), ("", None))[0] for camera in cameras]
    reference = chunk.findtext("reference", "")
    on_earth = chunk.find(".//transform/scale") is not None and is_on_wgs84(reference)
    labels = [camera.get("label", "") for camera in cameras]
    return oriented_images(labels, of, pose[:, :3, 3], quaternion, "ecef" if on_earth else None)


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """Markers, then tie points, image by image."""
    chunk = _chunk(path)
    frames = [*chunk.iterfind("frames/frame")] or [chunk]
    if len(frames) > 1:
        raise messages.several_frames(where=path, frames=len(frames))
    label = {m.get("id"): m.get("label", "") for m in chunk.iterfind("markers//marker")}
    marks: dict[str, list[tuple[str, float, float]]] = {}
    for marker in frames[0].iterfind("markers/marker"):
        for place in marker.iterfind("location"):
            name, (x, y) = label[marker.get("marker_id")], (float(place.attrib[a]) for a in "xy")
            marks.setdefault(place.attrib["camera_id"], []).append((name, x, y))
    ties = {p.get("camera_id"): p.attrib["path"]
            for p in frames[0].iterfind("point_cloud/projections")}  # fmt: skip
    for camera in chunk.iterfind("cameras//camera"):
        rows = marks.get(camera.get("id", ""), [])
        if camera.get("id") in ties:
            found = _ply(path, ties[camera.get("id")])
            rows += [(f"tie:{k}", x, y) for k, x, y in found[["id", "x", "y"]].tolist()]
        if rows:
            xy = [row[1:] for row in rows]
            yield rows_of_image(camera.get("label", ""), xy, [row[0] for row in rows])


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The tie points of an archive."""
    chunk = _chunk(path)
    cloud = chunk.find("frames/frame/point_cloud/points")
    if cloud is None:
        return pa.array([], pa.string()), np.empty((0, 3))
    points = _ply(path, cloud.attrib["path"])
    scale, turn, step = _to_earth(chunk, None)
    places = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    names = pa.array([f"tie:{number}" for number in points["id"].tolist()], pa.string())
    return names, np.asarray(scale * places @ turn.T + step)


def _root(path: Path) -> ElementTree.Element:
    """The document; refuses one of a version after 2."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("doc.xml"))
    else:
        root = ElementTree.fromstring(path.read_bytes())
    version = root.get("version", "1" if root.tag == "calibration" else "")
    if version.partition(".")[0] not in ("1", "2"):
        raise messages.metashape_version(where=path, tag=root.tag, version=version or "unknown")
    return root


def _chunk(path: Path) -> ElementTree.Element:
    chunks = [*_root(path).iter("chunk")]
    if len(chunks) != 1:
        names = ", ".join(repr(chunk.get("label", "")) for chunk in chunks)
        raise messages.several_chunks(where=path, chunks=len(chunks), names=names)
    return chunks[0]


def _to_earth(chunk: ElementTree.Element, component: str | None) -> tuple[float, Array, Array]:
    """Scale, rotation (3, 3) and step (3,) from the chunk to its coordinate system."""
    parts = chunk.findall("components/component")
    given = chunk.find("transform")
    for part in parts:
        if component == part.get("id") or len(parts) == 1:
            given = part.find("transform")
    if given is None:
        return 1.0, np.eye(3), np.full(3, np.nan if len(parts) > 1 else 0.0)
    turn = np.array(given.findtext("rotation", "1 0 0 0 1 0 0 0 1").split(), np.float64)
    step = np.array(given.findtext("translation", "0 0 0").split(), np.float64)
    return float(given.findtext("scale", "1")), turn.reshape(3, 3), step


def _ply(path: Path, name: str) -> Any:
    """The vertices of a binary PLY in an archive, a structured array."""
    with zipfile.ZipFile(path) as archive:
        if name not in archive.namelist():
            raise messages.archive_part_missing(where=path, part=name)
        head, _, content = archive.read(name).partition(b"end_header\n")
    count, kinds = 0, []
    for words in (line.split() for line in head.decode("ascii").splitlines()):
        if words[:2] == ["element", "vertex"]:
            count = int(words[2])
        elif words[:1] == ["property"]:
            kinds.append((words[2], _TYPES[words[1]]))
    kind = np.dtype(kinds)
    if b"binary_little_endian" not in head or len(content) != count * kind.itemsize:
        raise messages.ply_cut(
            where=path, part=name, size=len(content), records=count, each=kind.itemsize
        )
    return np.frombuffer(content, kind)


def _sensors(root: ElementTree.Element) -> dict[str, tuple[str, ElementTree.Element | None]]:
    """By the id of each sensor: its name, and its calibration."""
    sensors: dict[str, tuple[str, ElementTree.Element | None]] = {}
    names: set[str] = set()
    for sensor in root.iter("sensor"):
        label = sensor.get("label", "")
        name = f"{label} {sensor.get('id')}" if label in names else label
        names.add(name)
        fixed = sensor.find("property[@name='fixed'][@value='true']") is not None
        found = sensor.find("calibration[@class='adjusted']")
        if found is None and (fixed or sensor.find("calibration[@class='initial']") is None):
            found = sensor.find("calibration")
        sensors[sensor.get("id", name)] = name, found
    return sensors


def _camera(calibration: ElementTree.Element | None, path: Path) -> Camera:
    if calibration is None:
        raise messages.calibration_missing(where=path)
    size = calibration.find("resolution")
    width, height = (
        int(calibration.findtext(side, "0") if size is None else size.get(side, "0"))
        for side in ("width", "height")
    )
    kind = calibration.get("type") or calibration.findtext("projection") or "frame"

    def number(name: str) -> float:
        return float(calibration.findtext(name, "0"))

    unused = [name for name in _NOT_MODELLED.get(kind, ()) if number(name) != 0.0]
    if unused:
        raise messages.calibration_unusable(where=path, coefficients=", ".join(unused), kind=kind)
    if calibration.find("fx") is not None:
        frame = [number("fx"), number("fy"), number("cx"), number("cy")]
    else:
        f, cx, cy = number("f"), number("cx"), number("cy")
        frame = [f + number("b1"), f, 0.5 * width + cx, 0.5 * height + cy]
    k1, k2, k3, k4, p1, p2 = (number(name) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    skew = number("b2") + number("skew")
    if kind == "fisheye":
        return camera_of_model("OPENCV_FISHEYE", width, height, [*frame, k1, k2, k3, k4])
    if kind != "frame":
        return camera_of_model(kind, width, height, frame)
    if k4 == 0.0 and skew == 0.0:
        return camera_of_model("BROWN", width, height, [*frame, k1, k2, k3, p2, p1])
    general = GeneralFrame(k1=k1, k2=k2, k3=k3, k4=k4, px=p1, py=p2, skew_x=skew / frame[0])
    return camera_of_model("GENERAL_FRAME", width, height, [*frame, *general])
