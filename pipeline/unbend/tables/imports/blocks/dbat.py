"""The Damped Bundle Adjustment Toolbox: the XML script of a project, with the tables it names.

Image points count from the outer corner of the upper left pixel, as COLMAP's: without another
statement DBAT puts the principal point at half the size of the sensor, and its tables hold what
Metashape exports (docs/decisions.md has the evidence). Millimetres of the principal point are
pixels times the pixel's size, y down. Orientations are the adjusted ones, of the report that the
script names: omega, phi, kappa in degrees. A point is its id. Files that are not where the script
says are looked for beside it.
"""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from unbend.block.known_places import KnownPlaces
from unbend.flight.rotations import quaternion_of_opk
from unbend.refraction.calibration import MetricReport, camera_of_model, camera_of_report
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import image_points, messages
from unbend.tables.imports.stated import read_text
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_PHOTO = re.compile(r"^ +Photo \d+: (.+)$", re.M)
_VALUE = re.compile(r"^ +(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", re.M)


def block_files(path: Path) -> tuple[Path, ...]:
    """The script, and the tables and the report that it names."""
    root = _root(path)
    named = [element.text or "" for element in root.iterfind("input//file")]
    named += [element.text or "" for element in root.iterfind("output/files/report/file")]
    return (path, *(_beside(path, name) for name in dict.fromkeys(named)))


def read_cameras(path: Path) -> image_points.CameraMakers:
    """The camera of the script, or of the file it names, by its id (1 where it has none)."""
    root = _root(path)
    named = root.findtext("input/cameras/file")
    cameras = (root if named is None else _root(_beside(path, named))).iter("camera")
    return {camera.findtext("id", "1").strip(): partial(_camera, camera, path)
            for camera in cameras}  # fmt: skip


def read_images(path: Path) -> OrientationTable:
    """The images with the orientations of the report."""
    named, cameras = _root(path).findtext("output/files/report/file"), read_cameras(path)
    if named is None or len(cameras) != 1:
        raise messages.dbat_cameras(where=path, cameras=len(cameras))
    report = _beside(path, named)
    text = "\n".join(read_text(report)).partition("\n   Quality")[0]
    parts, found = _PHOTO.split(text), {}
    for name, part in zip(parts[1::2], parts[2::2], strict=True):
        found[_name_of(name)] = [float(value) for value in _VALUE.findall(part)]
        if len(found[_name_of(name)]) != 6:
            raise messages.orientation_cut(where=report, image=name)
    eo = np.array([*found.values()]).reshape(-1, 6)
    quaternion = quaternion_of_opk(np.radians(eo[:, :3]), "omega_phi_kappa")
    return image_points.oriented_images([*found], [*cameras] * len(found), eo[:, 3:], quaternion)


def read_places(_: Path) -> tuple[KnownPlaces, ...]:
    """None: a script has positions of control points alone."""
    return ()


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The image points of all tables, image by image."""
    names = {row["id"]: _name_of(row["path"]) for row in _tables(path, "images")}
    points: dict[str, tuple[list[str], list[Array]]] = {}
    for row in _tables(path, "image_pts"):
        if row["im"] not in names:
            raise messages.image_number_unknown(where=path, place=row["at"], number=row["im"])
        point, xy = points.setdefault(names[row["im"]], ([], []))
        point.append(row["id"])
        xy.append(np.array([row["x"], row["y"]], np.float64))
    for name, (point, xy) in points.items():
        yield image_points.rows_of_image(name, xy, point)


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The control and check points."""
    rows = (row for kind in ("ctrl_pts", "check_pts") for row in _tables(path, kind))
    places = {row["id"]: [float(row[axis]) for axis in "xyz"] for row in rows}
    return pa.array([*places], pa.string()), np.array([*places.values()]).reshape(-1, 3)


def _camera(given: ElementTree.Element, path: Path) -> Camera:
    def numbers(name: str, default: str) -> Array:
        text = given.findtext(name, default).strip()
        return np.array((default if text == "default" else text).split(","), np.float64)

    for name, harmless in {"skew": 0.0, "aspect": 1.0}.items():
        if numbers(name, str(harmless))[0] != harmless:
            raise messages.camera_not_plain(where=path, name=name, plain=harmless)
    model = float(numbers("model", "3")[0])
    if model not in (1, 2, 3):
        raise messages.dbat_model_unknown(where=path, model=model)
    size, sensor = numbers("image", ""), numbers("sensor", "")
    c, pixel = float(numbers("cc", given.findtext("focal", ""))[0]), sensor / size
    pp = numbers("pp", "{},{}".format(*sensor / 2.0))
    known = {f"{letter.lower()}{i}": float(value) for letter in "KP"
             for i, value in enumerate(numbers(letter, "0"), 1)}  # fmt: skip
    width, height = map(int, size)
    if not any(known.values()):
        return camera_of_model("PINHOLE", width, height, [*c / pixel, *pp / pixel])
    report = MetricReport(
        c, pixel_mm=pixel, format_mm=sensor, origin_px=(0.0, 0.0), axes="right up",
        ppa_mm=pp * [1.0, -1.0], ppbs_mm=pp * [1.0, -1.0], coefficients=known, sense="correction",
    )  # fmt: skip
    return camera_of_report(report, (width, height))


def _root(path: Path) -> ElementTree.Element:
    root = ElementTree.fromstring(path.read_bytes())
    version = root.get("dbat_script_version") or root.get("dbat_camera_version") or "unknown"
    if version != "1.0":
        raise messages.dbat_version(where=path, version=version)
    return root


def _name_of(path: str) -> str:
    return re.split(r"[\\/]", path.strip())[-1]


def _beside(path: Path, name: str) -> Path:
    for file in (path.parent / name.strip(), path.parent / _name_of(name)):
        if file.is_file():
            return file
    raise messages.file_of_script_missing(where=path, name=name.strip())


def _tables(path: Path, kind: str) -> Iterator[dict[str, str]]:
    """The rows of the tables of one kind, by the names of their format, and where each stands."""
    for table in _root(path).iterfind(f"input/{kind}/file"):
        names = [name.strip() for name in table.attrib["format"].split(",")]
        with image_points.TextFile(_beside(path, table.text or "")) as lines:
            for text in (line.partition("#")[0].strip() for line in lines):
                if text:
                    fields = map(str.strip, text.split(",", len(names) - 1))
                    row = dict(zip(names, fields, strict=True))
                    _ = [float(row[axis]) for axis in {"x", "y", "z"} & {*names}]
                    yield row | {"at": f"{lines.path.name}, line {lines.number}"}
