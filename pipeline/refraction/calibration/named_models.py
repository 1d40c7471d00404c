"""Cameras by the name of a model and its parameters, in COLMAP's order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pipeline.errors import PhysicsError
from pipeline.refraction.camera.brown_conrady import BrownConrady
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.general_frame import GeneralFrame
from pipeline.refraction.camera.opencv_fisheye import OpenCVFisheye

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
