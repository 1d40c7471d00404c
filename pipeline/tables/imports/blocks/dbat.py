"""The Damped Bundle Adjustment Toolbox: the XML script of a project, with the tables it names.

Image points count from the outer corner of the upper left pixel, as COLMAP's: without another
statement DBAT puts the principal point at half the size of the sensor, and its tables hold what
Metashape exports (docs/decisions.md has the evidence). Millimetres of the principal point are
pixels times the pixel's size, y down. Orientations are those of its report, or of prior_eo. Angles
are omega, phi, kappa; a point is its id. Paths that are not there are looked for beside the script.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from pipeline.errors import InputError
from pipeline.flight.rotations import quaternion_of_opk
from pipeline.flight.stations import NO_TIME
from pipeline.refraction.calibration import MetricReport, camera_of_model, camera_of_report
from pipeline.refraction.camera.camera import Camera
from pipeline.tables.imports.blocks.image_points import Array, CameraMakers, rows_of_image
from pipeline.tables.imports.orientation import OrientationTable
from pipeline.tables.imports.stated import not_of_format, read_text
from pipeline.units import RADIANS

_EO = ("omega", "phi", "kappa", "x", "y", "z")
_UNITS = {"radian": "rad", "degrees": "deg", "gon": "grad"}
_PHOTO = re.compile(r"^ +Photo \d+: (.+)$", re.M)
_VALUE = re.compile(r"^ +(Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value: +(\S+)", re.M)


def block_files(path: Path) -> tuple[Path, ...]:
    """The script, and the tables and the report that it names."""
    root = _root(path)
    named = [e.text or "" for e in root.iterfind("input//file")]
    files = [_beside(path, name) for name in dict.fromkeys(named)]
    report = _report(path, root)
    return (path, *files) if report is None else (path, *files, report)


def read_cameras(path: Path) -> CameraMakers:
    """The camera of the script, or of the file it names, by its id (1 where it has none)."""
    root = _root(path)
    named = root.findtext("input/cameras/file")
    cameras = (root if named is None else _root(_beside(path, named))).iter("camera")
    return {camera.findtext("id", "1").strip(): partial(_camera, camera, path)
            for camera in cameras}  # fmt: skip


def read_images(path: Path) -> OrientationTable:
    """The images with the adjusted orientations of the report, or those of prior_eo."""
    root, names = _root(path), _images(path)
    found: dict[str, list[float]] = {}
    report = _report(path, root)
    prior, unit = root.find("input/prior_eo/file"), "deg"
    if report is not None:
        text = "\n".join(read_text(report))
        parts = _PHOTO.split(text.partition("\n   Quality")[0])
        for name, part in zip(parts[1::2], parts[2::2], strict=True):
            found[_name_of(name)] = [float(value) for _, value in _VALUE.findall(part)]
            if len(found[_name_of(name)]) != 6:
                raise not_of_format(report, f"the orientation of {name} is not whole")
    elif prior is not None:
        unit = _UNITS[prior.get("units", "degrees")]
        file = _beside(path, prior.text or "")
        for line, row in _rows(file, prior.get("format", "")):
            if row["id"] not in names:
                raise not_of_format(file, f"line {line}: no image is called {row['id']}")
            found[names[row["id"]]] = [float(row[key]) for key in _EO]
    else:
        raise not_of_format(path, "it has neither a report nor prior_eo: nothing orients images",
                            "run DBAT, or give stations.orientation")  # fmt: skip
    cameras = read_cameras(path)
    if len(cameras) != 1:
        raise not_of_format(path, f"it has {len(cameras)} cameras: whose an image is, is not read")
    eo = np.array([found.get(name, [np.nan] * 6) for name in names.values()]).reshape(-1, 6)
    return OrientationTable(
        np.array(list(names.values()), object),
        np.array([*cameras] * len(names), object),
        np.full(len(names), NO_TIME, np.int64),
        eo[:, 3:],
        quaternion_of_opk(eo[:, :3] * RADIANS[unit], "omega_phi_kappa"),  # type: ignore[index]
        {},
    )


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The image points of all tables, image by image."""
    names = _images(path)
    points: dict[str, tuple[list[str], list[tuple[float, float]]]] = {}
    for table in _root(path).iterfind("input/image_pts/file"):
        file = _beside(path, table.text or "")
        for line, row in _rows(file, table.get("format", "id,im,x,y")):
            if row["im"] not in names:
                raise not_of_format(file, f"line {line}: no image has the number {row['im']}")
            point, xy = points.setdefault(names[row["im"]], ([], []))
            point.append(row["id"])
            xy.append((float(row["x"]), float(row["y"])))
    for name, (point, xy) in points.items():
        yield rows_of_image(name, xy, point)


def read_points(path: Path) -> tuple[pa.StringArray, Array]:
    """The control and check points."""
    places: dict[str, list[float]] = {}
    for kind in ("ctrl_pts", "check_pts"):
        for table in _root(path).iterfind(f"input/{kind}/file"):
            for _, row in _rows(_beside(path, table.text or ""), table.get("format", "")):
                places[row["id"]] = [float(row[axis]) for axis in "xyz"]
    return pa.array(list(places), pa.string()), np.array(list(places.values())).reshape(-1, 3)


def _camera(given: ElementTree.Element, path: Path) -> Camera:
    def numbers(name: str, default: str) -> list[float]:
        return [float(value) for value in given.findtext(name, default).split(",")]

    def stated(name: str, default: float) -> float:
        text = given.findtext(name, "default").strip()
        return default if text in ("default", "focal") else float(text)

    unused = {"skew": 0.0, "aspect": 1.0}
    for name, harmless in unused.items():
        if given.findtext(name, "").strip() != "auto" and stated(name, harmless) != harmless:
            raise not_of_format(path, f"the {name} of its camera cannot be used: {stated(name, 0)}")
    if stated("model", 3.0) not in (1.0, 2.0, 3.0):
        raise not_of_format(path, f"the lens distortion model {stated('model', 0.0):g} of its "
                            "camera is not known: 1, 2 and 3 are")  # fmt: skip
    width, height = (int(value) for value in numbers("image", ""))
    across, down = given.findtext("sensor", "").split(",")
    size = [float(down) / height * width if "auto" in across else float(across), float(down)]
    c, pixel = stated("cc", float(given.findtext("focal", "nan"))), np.array(size) / [width, height]
    centre = given.findtext("pp", "default").strip() == "default"
    pp = np.array(size) / 2.0 if centre else np.array(numbers("pp", ""))
    k, p = numbers("K", "0"), numbers("P", "0")
    if not any(k + p):
        return camera_of_model("PINHOLE", width, height, [*c / pixel, *pp / pixel])
    known = {f"k{i}": value for i, value in enumerate(k, 1)}
    known |= {f"p{i}": value for i, value in enumerate(p, 1)}
    report = MetricReport(
        c, pixel_mm=pixel, format_mm=size, origin_px=(0.0, 0.0), axes="right up",
        ppa_mm=pp * [1.0, -1.0], ppbs_mm=pp * [1.0, -1.0], coefficients=known, sense="correction",
    )  # fmt: skip
    return camera_of_report(report, (width, height))


def _root(path: Path) -> ElementTree.Element:
    root = ElementTree.fromstring(path.read_bytes())
    version = root.get("dbat_script_version") or root.get("dbat_camera_version")
    if version != "1.0":
        raise not_of_format(
            path, f"it is a script of DBAT's version {version or 'unknown'}; 1.0 is read"
        )
    return root


def _report(path: Path, root: ElementTree.Element) -> Path | None:
    named = root.findtext("output/files/report/file")
    candidates = () if named is None else _places(path, named)
    return next((file for file in candidates if file.is_file()), None)


def _images(path: Path) -> dict[str, str]:
    """Number -> name of each image, without its folder."""
    table = _root(path).find("input/images/file")
    if table is None:
        raise not_of_format(path, "it names no table of images (input/images/file)")
    rows = _rows(_beside(path, table.text or ""), table.get("format", "id,path"))
    return {row["id"]: _name_of(row["path"]) for _, row in rows}


def _name_of(path: str) -> str:
    return re.split(r"[\\/]", path.strip())[-1]


def _places(path: Path, name: str) -> tuple[Path, Path]:
    return path.parent / name.strip(), path.parent / _name_of(name)


def _beside(path: Path, name: str) -> Path:
    for file in _places(path, name):
        if file.is_file():
            return file
    raise InputError("INPUT-MISSING", f"the script names {name.strip()}", where=str(path),
                     remedy="put the file where the script says, or beside it")  # fmt: skip


def _rows(file: Path, form: str) -> Iterator[tuple[int, dict[str, str]]]:
    """Number of the line, and its fields by the names of the format, of each row of a table."""
    names = [name.strip() for name in form.split(",")]
    for number, line in enumerate(file.read_text(encoding="utf-8-sig").splitlines(), 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        try:
            fields = dict(zip(names, map(str.strip, text.split(",", len(names) - 1)), strict=True))
            _ = [float(fields[name]) for name in {*_EO} & {*names}]
        except ValueError:
            what = f"line {number} is not {form}: {text[:60]!r}"
            raise not_of_format(file, what) from None
        yield number, fields
