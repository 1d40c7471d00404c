"""Cameras by the name of a model and its parameters, and whether a camera can be one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.errors import PhysicsError
from pipeline.refraction.camera import model_of
from pipeline.refraction.camera.brown_conrady import BrownConrady
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.general_frame import GeneralFrame
from pipeline.refraction.camera.opencv_fisheye import LARGEST_ANGLE_RAD, OpenCVFisheye

_Distortion = type[BrownConrady] | type[GeneralFrame] | type[OpenCVFisheye]
_FULL_OPENCV = ("fx", "fy", "cx", "cy", "k1", "k2", "py", "px", "k3", "q1", "q2", "q3")

MODELS: Mapping[str, tuple[_Distortion, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (BrownConrady, ("f", "cx", "cy")),
    "PINHOLE": (BrownConrady, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": (BrownConrady, ("f", "cx", "cy", "k1")),
    "RADIAL": (BrownConrady, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": (BrownConrady, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (GeneralFrame, _FULL_OPENCV),
    "SIMPLE_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy")),
    "FISHEYE": (OpenCVFisheye, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV_FISHEYE": (OpenCVFisheye, ("fx", "fy", "cx", "cy", *OpenCVFisheye._fields)),
    # Not COLMAP's: what its models lack.
    "BROWN": (BrownConrady, ("fx", "fy", "cx", "cy", *BrownConrady._fields)),
    "GENERAL_FRAME": (GeneralFrame, ("fx", "fy", "cx", "cy", *GeneralFrame._fields)),
}
"""By name: the distortion, and the names of the parameters in COLMAP's order."""


def camera_of_model(
    model: str, width_px: int, height_px: int, parameters: Sequence[float]
) -> Camera:
    """The camera of a model and its parameters [px and without unit], in COLMAP's pixels.

    Agrees with pycolmap to 1e-9 px over the image, fisheye lenses to 85 degrees off the axis.
    Refuses (PhysicsError CAMERA-MODEL) models that are not in `MODELS` and parameters that do not
    fit.

    >>> camera_of_model("SIMPLE_RADIAL", 4000, 3000, [3200.0, 2000.0, 1500.0, -0.05]).distortion
    BrownConrady(k1=-0.05, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    """
    if model not in MODELS:
        raise PhysicsError(
            "CAMERA-MODEL",
            f"{model!r} is no camera model that can be corrected",
            remedy=f"models are {', '.join(MODELS)}; convert the calibration to one of them",
        )
    distortion, names = MODELS[model]
    if len(parameters) != len(names) or not all(map(math.isfinite, parameters)):
        raise PhysicsError(
            "CAMERA-MODEL",
            f"{model} has {len(names)} parameters, {', '.join(names)}; given are "
            f"{', '.join(f'{value:g}' for value in parameters) or 'none'}",
            remedy="give them in the order in which COLMAP writes them into cameras.txt",
        )
    of = dict(zip(names, map(float, parameters), strict=True))
    fx, fy = of.pop("fx", of.get("f", 0.0)), of.pop("fy", of.pop("f", 0.0))
    cx, cy = of.pop("cx"), of.pop("cy")
    return Camera(width_px, height_px, fx, fy, cx, cy, distortion(**of))


def model_of_camera(camera: Camera) -> tuple[str, list[float]]:
    """The name of a model with all its parameters that is this camera.

    >>> model_of_camera(camera_of_model("SIMPLE_PINHOLE", 40, 30, [32.0, 20.0, 15.0]))
    ('BROWN', [32.0, 32.0, 20.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    """
    # The last of a type is the one that has all parameters.
    name = [name for name, (kind, _) in MODELS.items() if kind is type(camera.distortion)][-1]
    frame = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return name, [float(value) for value in (*frame, *camera.distortion)]


def is_fisheye(camera: Camera) -> bool:
    """Whether the lens is equidistant, and no frame camera's."""
    return isinstance(camera.distortion, OpenCVFisheye)


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Angles [rad] seen across and down through the principal point, but for the distortion.

    >>> camera = Camera(2000, 1000, 1000.0, 1000.0, 1000.0, 500.0)
    >>> np.degrees(field_of_view(camera)).round(2).tolist()
    [90.0, 53.13]
    """
    size = np.array([camera.width_px, camera.height_px])
    centre = np.array([camera.cx_px, camera.cy_px])
    ends = np.array([centre, size - centre]) / [camera.fx_px, camera.fy_px]
    across, down = (ends if is_fisheye(camera) else np.arctan(ends)).sum(axis=0)
    return float(across), float(down)


def refuse_impossible(camera: Camera) -> None:
    """Refuse (PhysicsError) a camera that cannot be one.

    CAMERA-FIELD: a frame camera that sees more than 150 degrees, or a fisheye that sees more than
    360. CAMERA-TURNS: a distortion that turns back inside the image, so that two directions share a
    pixel. Beyond the calibrated radius, and 89.5 degrees off the axis of a fisheye, observations
    have the status outside_camera instead.
    """
    seen = np.degrees(max(field_of_view(camera)))
    if seen > (360.0 if is_fisheye(camera) else 150.0):
        raise PhysicsError(
            "CAMERA-FIELD",
            f"with a principal distance of {camera.fx_px:g} px an image of {camera.width_px} x "
            f"{camera.height_px} px sees {seen:.0f} degrees",
            remedy="give the principal distance in pixels (millimetres divided by the size of a "
            "pixel in millimetres), or the model of a fisheye",
        )
    end = min(float(getattr(camera.distortion, "limit", np.inf)), float(np.tan(LARGEST_ANGLE_RAD)))
    theta = np.linspace(0.0, np.arctan(min(end, camera.largest_radius)), 200)[:, None]
    right = (np.array([0, camera.width_px]) - camera.cx_px) / camera.fx_px
    down = (np.array([[0], [camera.height_px]]) - camera.cy_px) / camera.fy_px
    azimuth = np.append(np.linspace(0.0, 2.0 * np.pi, 25), np.arctan2(down, right))
    u, v = np.tan(theta) * np.cos(azimuth), np.tan(theta) * np.sin(azimuth)
    with np.errstate(all="ignore"):
        x, y = camera.project(u, v)
        uu, uv, vv = model_of(type(camera.distortion)).slopes(u, v, camera.distortion)
        folded = np.asarray(uu * vv - uv * uv) <= 0.0
    # Where the distortion turns, and nothing limits it earlier, the circle lies outside the image.
    folded[-1] |= camera.largest_radius < end * (1.0 - 1e-9)
    folded &= (x >= 0.0) & (x <= camera.width_px) & (y >= 0.0) & (y <= camera.height_px)
    if folded.any():
        i, k = np.argwhere(folded)[0]
        raise PhysicsError(
            "CAMERA-TURNS",
            "the distortion turns back inside the image (or is a correction of more than 30 %), "
            f"{np.degrees(theta[i, 0]):.1f} degrees off the axis at ({x[i, k]:.0f}, {y[i, k]:.0f}) "
            "px",
            remedy="check signs, order and units of the coefficients",
        )
