"""Calibrated cameras in files of other programs, by format.

A new format is a module beside this one, and its reader in `CAMERA_FILES`: a function of the path
that returns, by the name of each camera in the file, a function that makes it. Half a pixel and the
unit of each program are applied there: cameras come in COLMAP's pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from pipeline.errors import InputError, PhysicsError
from pipeline.refraction.camera.camera import Camera
from pipeline.tables.imports import reader_of
from pipeline.tables.imports.camera_files.colmap_cameras import read_colmap_cameras
from pipeline.tables.imports.camera_files.metashape_cameras import read_metashape_cameras
from pipeline.tables.imports.camera_files.opensfm_cameras import read_opensfm_cameras
from pipeline.tables.imports.stated import not_of_format

CameraReader = Callable[[Path], dict[str, Callable[[], Camera]]]

CAMERA_FILES: Mapping[str, tuple[CameraReader, tuple[str, ...]]] = {
    "colmap": (read_colmap_cameras, (".txt", ".bin")),
    "opensfm": (read_opensfm_cameras, (".json",)),
    "metashape": (read_metashape_cameras, (".xml", ".psz")),
}
"""Readers of cameras, and the endings by which a file is known."""


def read_camera(path: Path, file_format: str | None, name: str | None) -> Camera:
    """The camera of a file: the named one, or the only one.

    Refuses (InputError) a format that is not known or not met (IMPORT-FORMAT), a name that is not
    there, and several cameras without a name (CAMERA-NAME).
    """
    program, reader = reader_of(CAMERA_FILES, path, file_format)
    try:
        cameras = reader(path)
        chosen = next(iter(cameras)) if name is None and len(cameras) == 1 else name or ""
        if chosen in cameras:
            return cameras[chosen]()
    except PhysicsError as error:
        raise InputError(error.code, error.what, where=str(path), remedy=error.remedy) from None
    except (LookupError, ValueError, TypeError, AttributeError, OSError, SyntaxError) as error:
        raise not_of_format(path, f"as a file of {program}: {error!r}") from None
    raise InputError(
        "CAMERA-NAME",
        f"it holds {', '.join(map(repr, cameras)) or 'no camera'}, "
        + ("and no camera is named" if name is None else f"and no {name!r}"),
        where=str(path),
        remedy="name one of them under camera",
    )


__all__ = ["CAMERA_FILES", "CameraReader", "read_camera"]
