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
"""Directions in the image as vectors in the axes of a camera with x right, y down, z forward."""
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
"""Names in this format of OpenCV's k1, k2, k3, p1, p2: its P1 is OpenCV's p2."""
_HALF_PIXEL = 0.5  # from the centre of the upper left pixel to its corner


def text_of(
    element: Element,
    name: str,
) -> str:
    """The text of a required part of an element; KeyError without it."""
    text = element.findtext(name)
    if text is None:
        raise KeyError(name)
    return text.strip()


def camera_axes(group: Element) -> Array:
    """(3, 3) from the axes of a photogroup's cameras to x right, y down, z forward.

    ``CameraOrientation`` states these axes, as XRightYDown; KeyError for an unknown one.
    """
    name = group.findtext("CameraOrientation", "XRightYDown").strip()
    if name not in _ORIENTATIONS:
        raise KeyError(name)
    x_name, _, y_name = name[1:].partition("Y")
    x = np.array(_DIRECTIONS[x_name])
    y = np.array(_DIRECTIONS[y_name])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _pixel_mm(group: Element) -> float:
    """The size of a pixel [mm], or SensorSize over the longer side of the image; NaN if unknown."""
    pixel_size = group.findtext("PixelSize")
    if pixel_size is not None:
        return float(pixel_size)
    width, height = _size(group)
    return float(group.findtext("SensorSize", "nan")) / max(width, height)


def _size(group: Element) -> tuple[int, int]:
    """Width and height of a photogroup's images [px]."""
    return (
        int(text_of(group, "ImageDimensions/Width")),
        int(text_of(group, "ImageDimensions/Height")),
    )


def pixel_of(
    measurement: Element,
    group: Element,
) -> tuple[float, float]:
    """x and y of a measurement in COLMAP's pixels; ``group`` is the photogroup of its image.

    The file has pixels from the centre of the upper left one, or millimetres from the principal
    point.
    """
    if measurement.find("xmm") is None:
        x = float(text_of(measurement, "x"))
        y = float(text_of(measurement, "y"))
        return x + _HALF_PIXEL, y + _HALF_PIXEL
    offset_px = _pixels_of_mm(measurement, group)
    cx, cy = _principal_point(group)
    return cx + offset_px[0], cy + offset_px[1]


def _pixels_of_mm(
    element: Element,
    group: Element,
) -> Array:
    """(2,) pixels to the right and down of xmm and ymm, which count along the camera's axes."""
    offset_mm = np.array([float(text_of(element, "xmm")), float(text_of(element, "ymm"))])
    return np.asarray(camera_axes(group)[:2, :2] @ offset_mm / _pixel_mm(group))


def _principal_point(group: Element) -> tuple[float, float]:
    """The principal point in COLMAP's pixels; by default the middle of the image."""
    width, height = _size(group)
    point = group.find("PrincipalPoint")
    if point is None:
        return 0.5 * width, 0.5 * height
    if point.find("xmm") is None:
        return float(text_of(point, "x")) + _HALF_PIXEL, float(text_of(point, "y")) + _HALF_PIXEL
    offset_px = _pixels_of_mm(point, group)
    return 0.5 * width + float(offset_px[0]), 0.5 * height + float(offset_px[1])


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
    required: Mapping[str, float] = {"AspectRatio": 1.0, "Skew": 0.0}
    for name, value in required.items():
        if float(group.findtext(name, str(value))) != value:
            raise messages.calibration_unusable(
                where=path,
                coefficients=name,
                kind=kind,
            )
    width, height = _size(group)
    focal_px = group.findtext("FocalLengthPixels")
    if focal_px is not None:
        f_px = float(focal_px)
    else:
        f_px = float(text_of(group, "FocalLength")) / _pixel_mm(group)
    cx, cy = _principal_point(group)
    coefficients = [float(group.findtext(f"Distortion/{name}", "0")) for name in _COEFFICIENTS]
    return camera_of_model("BROWN", width, height, [f_px, f_px, cx, cy, *coefficients])
