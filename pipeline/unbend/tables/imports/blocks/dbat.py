"""The Damped Bundle Adjustment Toolbox: the XML script of a project, with the tables it names.

Image points count from the outer corner of the upper left pixel, as COLMAP's: by default DBAT puts
the principal point at half the size of the sensor, and its tables have the numbers that Metashape
exports (docs/decisions.md has the evidence). Millimetres of the principal point are
pixels times the pixel's size, y down. Orientations are the adjusted ones, of the report that the
script names: omega, phi, kappa in degrees. A point is called by its id. A file that is not at the
path in the script is searched next to the script.
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

SCRIPT_VERSION = "1.0"
MODELS = (1, 2, 3)  # of distortion that are read
PLAIN_CAMERA = {"skew": 0.0, "aspect": 1.0}  # the only values that are supported
NUMBERS_OF_PHOTO = 6  # three angles and three coordinates

_PHOTO = re.compile(r"^ +Photo \d+: (.+)$", re.M)
_VALUE = re.compile(r"^ +(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", re.M)


def block_files(path: Path) -> tuple[Path, ...]:
    """The script, and the tables and the report that it names."""
    root = _root(path)
    elements = [
        *root.iterfind("input//file"),
        *root.iterfind("output/files/report/file"),
    ]
    names = {element.text or "": None for element in elements}
    files_named = [_existing_file(path, name) for name in names]
    return (path, *files_named)


def read_cameras(path: Path) -> image_points.CameraMakers:
    """The cameras of the script, or of the file that it names, by their ids (1 without an id)."""
    root = _root(path)
    camera_file = root.findtext("input/cameras/file")
    if camera_file is not None:
        root = _root(_existing_file(path, camera_file))
    makers: image_points.CameraMakers = {}
    for camera in root.iter("camera"):
        number = camera.findtext("id", "1").strip()
        makers[number] = partial(_camera, camera, path)
    return makers


def read_images(path: Path) -> OrientationTable:
    """The images with the orientations of the report.

    Refuses a script without a report, and a script with no or several cameras.
    """
    report_name = _root(path).findtext("output/files/report/file")
    cameras = read_cameras(path)
    if report_name is None:
        raise messages.dbat_without_report(where=path)
    if len(cameras) != 1:
        raise messages.dbat_cameras(where=path, cameras=len(cameras))
    orientation_of_photo = _orientation_of_photos(_existing_file(path, report_name))
    photos = list(orientation_of_photo)
    orientation = np.array(list(orientation_of_photo.values()))
    orientation = orientation.reshape(-1, NUMBERS_OF_PHOTO)
    angles_rad = np.radians(orientation[:, :3])
    quaternion = quaternion_of_opk(angles_rad, "omega_phi_kappa")
    position = orientation[:, 3:]
    return image_points.oriented_images(
        image=photos,
        camera=list(cameras) * len(photos),
        position=position,
        quaternion=quaternion,
    )


def _orientation_of_photos(report: Path) -> dict[str, list[float]]:
    """Name of each photo in a report -> omega, phi, kappa [deg] and X, Y, Z."""
    content = "\n".join(read_text(report))
    orientations, _, _ = content.partition("\n   Quality")
    parts = _PHOTO.split(orientations)  # text before the first photo, then name and text of each
    photos = parts[1::2]
    texts = parts[2::2]
    orientation_of_photo = {}
    for photo, text in zip(photos, texts, strict=True):
        numbers = [float(value) for value in _VALUE.findall(text)]
        if len(numbers) != NUMBERS_OF_PHOTO:
            raise messages.orientation_cut(where=report, image=photo)
        orientation_of_photo[_file_name(photo)] = numbers
    return orientation_of_photo


def read_places(_: Path) -> tuple[KnownPlaces, ...]:
    """No places: a script has only the positions of control points."""
    return ()


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The image points of all tables, image by image."""
    image_names = {}
    for _, row in _tables(path, "images"):
        image_names[row["id"]] = _file_name(row["path"])
    points: dict[str, list[str]] = {}
    pixels: dict[str, list[Array]] = {}
    for line_name, row in _tables(path, "image_pts"):
        number = row["im"]
        if number not in image_names:
            raise messages.image_number_unknown(
                where=path,
                place=line_name,
                number=number,
            )
        name = image_names[number]
        points.setdefault(name, []).append(row["id"])
        coordinates = [row["x"], row["y"]]
        xy = np.array(coordinates, np.float64)
        pixels.setdefault(name, []).append(xy)
    for name, point in points.items():
        yield image_points.rows_of_image(name, pixels[name], point)


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The ids and (p, 3) positions of the control and check points."""
    places = {}
    for kind in ("ctrl_pts", "check_pts"):
        for _, row in _tables(path, kind):
            x = float(row["x"])
            y = float(row["y"])
            z = float(row["z"])
            places[row["id"]] = [x, y, z]
    names = pa.array([*places], pa.string())
    coordinates = np.array([*places.values()])
    return names, coordinates.reshape(-1, 3)


def _camera(element: ElementTree.Element, path: Path) -> Camera:
    """Make the camera of an element ``camera`` of the script, or of a file of cameras."""
    _refuse_unsupported(element, path)
    size_px = _numbers(element, "image", "")
    sensor_mm = _numbers(element, "sensor", "")
    focal = element.findtext("focal", "")
    c_mm = float(_numbers(element, "cc", focal)[0])
    pixel_mm = sensor_mm / size_px
    middle_of_sensor = "{},{}".format(*sensor_mm / 2.0)
    principal_point_mm = _numbers(element, "pp", middle_of_sensor)
    coefficients = {
        **_coefficients(element, "K"),
        **_coefficients(element, "P"),
    }
    width, height = map(int, size_px)
    if not any(coefficients.values()):
        parameters = [*c_mm / pixel_mm, *principal_point_mm / pixel_mm]
        return camera_of_model("PINHOLE", width, height, parameters)
    upwards_mm = principal_point_mm * [1.0, -1.0]
    report = MetricReport(
        c_mm,
        pixel_mm=pixel_mm,
        format_mm=sensor_mm,
        origin_px=(0.0, 0.0),
        axes="right up",
        ppa_mm=upwards_mm,
        ppbs_mm=upwards_mm,
        coefficients=coefficients,
        sense="correction",
    )
    return camera_of_report(report, (width, height))


def _refuse_unsupported(element: ElementTree.Element, path: Path) -> None:
    """Refuse a camera with a skew, another aspect than 1, or an unknown model of distortion."""
    for name, plain in PLAIN_CAMERA.items():
        if _numbers(element, name, str(plain))[0] != plain:
            raise messages.camera_not_plain(
                where=path,
                name=name,
                plain=plain,
            )
    model = float(_numbers(element, "model", "3")[0])
    if model not in MODELS:
        raise messages.dbat_model_unknown(where=path, model=model)


def _numbers(
    element: ElementTree.Element,
    name: str,
    default: str,
) -> Array:
    """The numbers, with commas between them, of a child of an element; ``default`` without it."""
    text = element.findtext(name, default).strip()
    if text == "default":
        text = default
    return np.array(text.split(","), np.float64)


def _coefficients(element: ElementTree.Element, letter: str) -> dict[str, float]:
    """The coefficients k1, k2, ... of the child ``K`` of an element, or p1, p2, ... of ``P``."""
    values = _numbers(element, letter, "0")
    coefficients = {}
    for number, value in enumerate(values, start=1):
        coefficients[f"{letter.lower()}{number}"] = float(value)
    return coefficients


def _root(path: Path) -> ElementTree.Element:
    """The root of a script or a file of cameras; refuses versions other than `SCRIPT_VERSION`."""
    root = ElementTree.fromstring(path.read_bytes())
    version = root.get("dbat_script_version")
    version = version or root.get("dbat_camera_version") or "unknown"
    if version != SCRIPT_VERSION:
        raise messages.dbat_version(where=path, version=version)
    return root


def _file_name(path: str) -> str:
    """The last part of a path of Windows or Unix."""
    return re.split(r"[\\/]", path.strip())[-1]


def _existing_file(path: Path, name: str) -> Path:
    """The file that a script (``path``) names, at its path or else next to the script.

    Refuses a file that is at neither place.
    """
    name = name.strip()
    candidates = (
        path.parent / name,
        path.parent / _file_name(name),
    )
    for file in candidates:
        if file.is_file():
            return file
    raise messages.file_of_script_missing(where=path, name=name)


def _tables(path: Path, kind: str) -> Iterator[tuple[str, dict[str, str]]]:
    """File and line of each row in the tables of a kind, as text, and its fields by their names.

    ``kind`` is an element of the script's input, as image_pts, which names these tables.
    """
    for table in _root(path).iterfind(f"input/{kind}/file"):
        names = [name.strip() for name in table.attrib["format"].split(",")]
        with image_points.TextFile(_existing_file(path, table.text or "")) as lines:
            for line in lines:
                text, _, _ = line.partition("#")
                if text.strip():
                    row = _fields(text, names)
                    yield f"{lines.path.name}, line {lines.number}", row


def _fields(text: str, names: list[str]) -> dict[str, str]:
    """The fields of a row by their names; ValueError for coordinates that are not numbers."""
    fields = [field.strip() for field in text.split(",", len(names) - 1)]
    row = dict(zip(names, fields, strict=True))
    for axis in ("x", "y", "z"):
        if axis in row:
            float(row[axis])
    return row
