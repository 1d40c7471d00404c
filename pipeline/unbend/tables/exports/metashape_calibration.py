"""Metashape's calibrations (XML): one camera in a file, as its Camera Calibration loads it.

cx and cy count from the centre of the image, f is that of y, and x is projected with f + b1 (user
manual, appendix on camera models). P1 belongs to x and P2 to y, the other way round than in OpenCV.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye


def metashape_coefficients(camera: Camera) -> dict[str, float] | None:
    """The coefficients of a camera by Metashape's names; None for a lens it does not support.

    Metashape supports Brown-Conrady, the fisheye, and its own additional k4 and b2.

    >>> lens = BrownConrady(p1=1e-4, p2=2e-4)
    >>> metashape_coefficients(Camera(1000, 800, 900.0, 900.0, 500.0, 400.0, lens))
    {'k1': 0.0, 'k2': 0.0, 'k3': 0.0, 'p1': 0.0002, 'p2': 0.0001}
    """
    lens = camera.distortion
    if isinstance(lens, GeneralFrame):
        return _coefficients_of_general_frame(lens, float(camera.fx_px))
    if not isinstance(lens, BrownConrady | OpenCVFisheye):
        return None
    coefficients = lens._asdict()
    p1 = coefficients.pop("p1", 0.0)
    p2 = coefficients.pop("p2", 0.0)
    return {
        **coefficients,
        "p1": p2,
        "p2": p1,
    }


def _coefficients_of_general_frame(lens: GeneralFrame, fx_px: float) -> dict[str, float] | None:
    """As `metashape_coefficients`; None for a lens with more than k1 to k4, px, py and skew_x.

    b2 is in pixels: skew_x times ``fx_px``.
    """
    supported_part = GeneralFrame(
        k1=lens.k1,
        k2=lens.k2,
        k3=lens.k3,
        k4=lens.k4,
        px=lens.px,
        py=lens.py,
        skew_x=lens.skew_x,
        limit=lens.limit,
        steps=lens.steps,
    )
    if lens != supported_part:
        return None
    return {
        "k1": lens.k1,
        "k2": lens.k2,
        "k3": lens.k3,
        "k4": lens.k4,
        "p1": lens.px,
        "p2": lens.py,
        "b2": lens.skew_x * fx_px,
    }


def write_metashape(camera: Camera, path: Path) -> bool:
    """Write Metashape's XML of a camera; False, without a file, for an unsupported lens."""
    coefficients = metashape_coefficients(camera)
    if coefficients is None:
        return False
    fx = float(camera.fx_px)
    fy = float(camera.fy_px)
    is_fisheye = isinstance(camera.distortion, OpenCVFisheye)
    values = {
        "projection": "fisheye" if is_fisheye else "frame",
        "width": camera.width_px,
        "height": camera.height_px,
        "f": fy,
        "cx": float(camera.cx_px) - 0.5 * camera.width_px,
        "cy": float(camera.cy_px) - 0.5 * camera.height_px,
        "b1": fx - fy,
        **coefficients,
    }
    root = ElementTree.Element("calibration")
    for tag, value in values.items():
        ElementTree.SubElement(root, tag).text = str(value)
    ElementTree.indent(root)
    tree = ElementTree.ElementTree(root)
    tree.write(path, encoding="UTF-8", xml_declaration=True)
    return True


def name_of_file(name: str) -> str:
    """A name as a file may have it on each system: other characters become underscores.

    >>> name_of_file("left/nadir 2")
    'left_nadir_2'
    """
    return re.sub(r"[^0-9A-Za-z._-]", "_", name)
