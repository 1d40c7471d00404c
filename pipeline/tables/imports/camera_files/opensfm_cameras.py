"""OpenSfM's and ODM's cameras: camera_models.json, cameras.json, or a reconstruction.json.

Lengths are in units of the longer side of the image, counted from its centre, which is the corner
of pixels (w/2, h/2): a pixel (0, 0) of OpenSfM's is the centre of the upper left one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.refraction.calibration import camera_of_model
from pipeline.refraction.camera.camera import Camera

_COEFFICIENTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "perspective": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "simple_radial": ("BROWN", ("k1", "-", "-", "-", "-")),
    "radial": ("BROWN", ("k1", "k2", "-", "-", "-")),
    "brown": ("BROWN", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": ("OPENCV_FISHEYE", ("k1", "k2", "-", "-")),
    "fisheye_opencv": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}


def read_opensfm_cameras(path: Path) -> dict[str, Callable[[], Camera]]:
    """The cameras of the file by their names."""
    content = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(content, list):
        if len(content) != 1:
            raise ValueError(f"{len(content)} reconstructions, each with cameras of its own")
        content = content[0]["cameras"]
    return {name: partial(_camera, camera) for name, camera in content.items()}


def _camera(given: Mapping[str, Any]) -> Camera:
    kind, width, height = given["projection_type"], int(given["width"]), int(given["height"])
    # Of another kind nothing is known but its name, which is refused with those that are.
    model, names = _COEFFICIENTS.get(kind, (kind, ()))
    longer = float(max(width, height))
    focal = float(given["focal"] if "focal" in given else given["focal_x"]) * longer
    focal_y = float(given.get("focal_y", focal / longer)) * longer
    cx = 0.5 * width + float(given.get("c_x", 0.0)) * longer
    cy = 0.5 * height + float(given.get("c_y", 0.0)) * longer
    coefficients = [float(given.get(name, 0.0)) for name in names]
    return camera_of_model(model, width, height, [focal, focal_y, cx, cy, *coefficients])
