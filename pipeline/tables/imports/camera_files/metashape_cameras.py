"""Metashape's cameras: a calibration or a document as XML, or an archive (.psz).

u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f, from the corner of the image (Metashape's
manual, appendix on camera models); before version 1.3: u = cx + x' fx + y' skew. P1 belongs to x
and P2 to y, the other way round than in OpenCV.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

from pipeline.refraction.calibration import camera_of_model
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.general_frame import GeneralFrame

_NOT_MODELLED = {"frame": ("p3", "p4"), "fisheye": ("p1", "p2", "p3", "p4", "b2", "skew")}


def read_metashape_cameras(path: Path) -> dict[str, Callable[[], Camera]]:
    """The calibration of each sensor by its label, with its number where labels repeat."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("doc.xml"))
    else:
        root = ElementTree.fromstring(path.read_bytes())
    if root.tag == "calibration":
        return {"calibration": partial(_camera, root)}
    cameras: dict[str, Callable[[], Camera]] = {}
    for sensor in root.iter("sensor"):
        label = sensor.get("label", "")
        name = f"{label} {sensor.get('id')}" if label in cameras else label
        fixed = sensor.find("property[@name='fixed'][@value='true']") is not None
        found = sensor.find("calibration[@class='adjusted']")
        if found is None and (fixed or sensor.find("calibration[@class='initial']") is None):
            found = sensor.find("calibration")
        cameras[name] = partial(_camera, found)
    return cameras


def _camera(calibration: ElementTree.Element | None) -> Camera:
    if calibration is None:
        raise ValueError("the camera has no adjusted calibration")
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
        raise ValueError(f"{', '.join(unused)} of a {kind} calibration cannot be used")
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
