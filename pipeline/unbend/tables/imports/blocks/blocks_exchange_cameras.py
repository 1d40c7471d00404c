"""Photogroups of BlocksExchange XML: the axes, pixels and calibration of their cameras.

See `blocks_exchange` for what the numbers mean.
"""

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from unbend.refraction.calibration import camera_of_model
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.blocks import messages
from unbend.units import Array

_DIRECTIONS = {
    "Right": (1.0, 0.0, 0.0),
    "Left": (-1.0, 0.0, 0.0),
    "Down": (0.0, 1.0, 0.0),
    "Up": (0.0, -1.0, 0.0),
}
"""Directions in the image as axes of a camera with x right, y down, z forward."""
_ORIENTATIONS = (
    "XRightYDown",
    "XRightYUp",
    "XLeftYDown",
    "XLeftYUp",
    "XDownYRight",
    "XDownYLeft",
    "XUpYRight",
    "XUpYLeft",
)
_COEFFICIENTS = ("K1", "K2", "K3", "P2", "P1")
"""Of this format, as OpenCV's k1, k2, k3, p1, p2: its P1 is OpenCV's p2."""
_HALF_PIXEL = 0.5  # from the centre of the upper left pixel to its corner


def text_of(
    element: Element,
    name: str,
) -> str:
    """The text of a part that must be there."""
    text = element.findtext(name)
    if text is None:
        raise KeyError(name)
    return text.strip()


def camera_axes(group: Element) -> Array:
    """(3, 3) from the axes of a photogroup's cameras to x right, y down, z forward."""
    name = group.findtext("CameraOrientation", "XRightYDown").strip()
    if name not in _ORIENTATIONS:
        raise KeyError(name)
    x_name, _, y_name = name[1:].partition("Y")
    x = np.array(_DIRECTIONS[x_name])
    y = np.array(_DIRECTIONS[y_name])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _pixel_mm(group: Element) -> float:
    """The size of a pixel [mm]; NaN if unknown."""
    pixel_size = group.findtext("PixelSize")
    if pixel_size is not None:
        return float(pixel_size)
    width, height = _size(group)
    return float(group.findtext("SensorSize", "nan")) / max(width, height)


def _size(group: Element) -> tuple[int, int]:
    return (
        int(text_of(group, "ImageDimensions/Width")),
        int(text_of(group, "ImageDimensions/Height")),
    )


def pixel_of(
    measurement: Element,
    group: Element,
) -> tuple[float, float]:
    """x and y of a measurement in COLMAP's pixels."""
    if measurement.find("xmm") is None:
        x = float(text_of(measurement, "x"))
        y = float(text_of(measurement, "y"))
        return x + _HALF_PIXEL, y + _HALF_PIXEL
    step = _in_pixels(measurement, group)
    cx, cy = _principal_point(group)
    return cx + step[0], cy + step[1]


def _in_pixels(
    element: Element,
    group: Element,
) -> Array:
    """(2,) xmm and ymm along the camera's axes as pixels to the right and down."""
    step_mm = np.array([float(text_of(element, "xmm")), float(text_of(element, "ymm"))])
    return np.asarray(camera_axes(group)[:2, :2] @ step_mm / _pixel_mm(group))


def _principal_point(group: Element) -> tuple[float, float]:
    """The principal point in COLMAP's pixels; by default the middle of the image."""
    width, height = _size(group)
    given = group.find("PrincipalPoint")
    if given is None:
        return 0.5 * width, 0.5 * height
    if given.find("xmm") is None:
        return float(text_of(given, "x")) + _HALF_PIXEL, float(text_of(given, "y")) + _HALF_PIXEL
    step = _in_pixels(given, group)
    return 0.5 * width + float(step[0]), 0.5 * height + float(step[1])


def camera_of(
    group: Element,
    path: Path,
) -> Camera:
    """The camera of a photogroup; refuses a fisheye, pixels that are not square, and skew."""
    kind = group.findtext("CameraModelType", "Perspective").strip()
    if kind != "Perspective":
        raise messages.calibration_unusable(
            where=path,
            coefficients="coefficients",
            kind=kind,
        )
    plain: Mapping[str, float] = {"AspectRatio": 1.0, "Skew": 0.0}
    for name, value in plain.items():
        if float(group.findtext(name, str(value))) != value:
            raise messages.calibration_unusable(
                where=path,
                coefficients=name,
                kind=kind,
            )
    width, height = _size(group)
    focal = group.findtext("FocalLengthPixels")
    f_px = (
        float(text_of(group, "FocalLength")) / _pixel_mm(group) if focal is None else float(focal)
    )
    cx, cy = _principal_point(group)
    coefficients = [float(group.findtext(f"Distortion/{name}", "0")) for name in _COEFFICIENTS]
    return camera_of_model("BROWN", width, height, [f_px, f_px, cx, cy, *coefficients])
