"""COLMAP's cameras.txt and cameras.bin: a model, the size and the parameters of each camera."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pipeline.refraction.calibration import MODELS, camera_of_model
from pipeline.refraction.camera.camera import Camera
from pipeline.tables.imports.stated import read_text

_NUMBERS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE",
    "FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
)  # fmt: skip


def read_colmap_cameras(path: Path) -> dict[str, Callable[[], Camera]]:
    """The cameras of a cameras.txt or cameras.bin, by their numbers as words."""
    cameras: dict[str, Callable[[], Camera]] = {}
    if path.suffix.lower() != ".bin":
        for line in read_text(path):
            if not line.lstrip().startswith("#"):
                number, model, width, height, *parameters = line.split()
                values = [float(value) for value in parameters]
                cameras[number] = partial(camera_of_model, model, int(width), int(height), values)
        return cameras
    content, at = path.read_bytes(), 8
    try:
        for _ in range(struct.unpack_from("<Q", content)[0]):
            number, code, size_x, size_y = struct.unpack_from("<iiQQ", content, at)
            model = _NUMBERS[code]
            count = 5 if model == "FOV" else len(MODELS[model][1])
            values = list(struct.unpack_from(f"<{count}d", content, at + 24))
            cameras[str(number)] = partial(camera_of_model, model, size_x, size_y, values)
            at += 24 + 8 * count
    except (struct.error, IndexError) as error:
        raise ValueError(f"no cameras.bin: {error}") from None
    return cameras
