"""Blocks of images in files of other programs, by format: cameras, orientations, image points.

A new format is a module next to this one that has the functions of `BlockFormat`, and its line in
`BLOCKS`. Half a pixel, axes and units of each program are applied there: cameras and image points
come in COLMAP's pixels, orientations turn to a camera with x right, y down, z forward.
"""

from __future__ import annotations

import json
import sqlite3
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Protocol
from xml.etree import ElementTree

import numpy as np

from unbend.errors import InputError, PhysicsError, UnbendError
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports import Registry, format_of
from unbend.tables.imports.blocks import messages
from unbend.units import LARGEST_NUMBER, Array, Names, measured

if TYPE_CHECKING:
    import pyarrow as pa

    from unbend.block.known_places import KnownPlaces
    from unbend.tables.imports.blocks.image_points import CameraMakers
    from unbend.tables.imports.user_tables import OrientationTable


class BlockFormat(Protocol):
    """Functions of a format's module; ``path``, from the mission file, is a file or a folder."""

    def block_files(self, path: Path) -> tuple[Path, ...]:
        """The files that are read; refuses a folder without a needed file."""

    def read_cameras(self, path: Path) -> CameraMakers:
        """Camera name -> function that makes the camera, or refuses its calibration."""

    def read_images(self, path: Path) -> OrientationTable:
        """Images, their cameras, positions and quaternions; NaN for an image without a pose."""

    def read_places(self, path: Path) -> tuple[KnownPlaces, ...]:
        """Positions of the images before the adjustment, such as EXIF's; one entry a source."""

    def read_rows(self, path: Path) -> Iterator[pa.RecordBatch]:
        """Image points, image by image (see `image_points`)."""

    def read_points(self, path: Path) -> tuple[pa.StringArray, Array]:
        """Names and (p, 3) positions of object points, in the frame of the images."""


BLOCKS: Registry = {
    "colmap": ("unbend.tables.imports.blocks.colmap", (".txt", ".bin", ".db")),
    "opensfm": ("unbend.tables.imports.blocks.opensfm", (".json",)),
    "metashape": ("unbend.tables.imports.blocks.metashape", (".xml", ".psz", ".psx")),
    "pix4d": ("unbend.tables.imports.blocks.pix4d", ()),
    "blocksexchange": ("unbend.tables.imports.blocks.blocks_exchange", ()),
    "dbat": ("unbend.tables.imports.blocks.dbat", ()),
}
"""Format -> its module, and the endings that identify its files of cameras."""


def block_reader(program: str) -> BlockFormat:
    """Import the module of a format, a key of `BLOCKS`."""
    module: BlockFormat = resolve_name(BLOCKS[program][0])
    return module


_LARGEST_NORM_ERROR = 1e-3  # of quaternions, which are written with a few digits
_ERRORS_OF_LIBRARIES = (
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,  # a number too large for a float or an integer of 64 bits
    RecursionError,  # JSON of 100,000 brackets
    EOFError,
    OSError,
    SyntaxError,
    sqlite3.Error,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def damage_refused(
    path: Path | str,
    program: str,
) -> Iterator[None]:
    """Raise the errors of libraries on a damaged file as InputError (IMPORT-FORMAT).

    In the block numpy raises on division by zero, overflow and invalid results too, as of a size of
    0 or a length of 1e308. ``program`` is the format, a key of `BLOCKS`.
    """
    strict = np.errstate(divide="raise", over="raise", invalid="raise")
    with refusals_of_libraries(path, program), strict:
        yield


@contextmanager
def refusals_of_libraries(
    path: Path | str,
    program: str,
) -> Iterator[None]:
    """As `damage_refused`, but leaves numpy's error state alone.

    For generators: between two values of a generator, its caller would have the changed state.
    """
    try:
        yield
    except PhysicsError as error:
        where = f"{path}, {error.where}" if error.where else path
        raise error.as_kind(InputError, where=where) from None
    except UnbendError:
        raise
    except _ERRORS_OF_LIBRARIES as error:
        raise _refusal_of(error, path, program) from None


def _refusal_of(
    error: Exception,
    path: Path | str,
    program: str,
) -> InputError:
    """The InputError (IMPORT-FORMAT) for an error that a library raised on a damaged file."""
    if isinstance(error, KeyError):
        return messages.part_missing(
            where=path,
            program=program,
            part=repr(error.args[0]),
        )
    if isinstance(error, json.JSONDecodeError):
        return messages.not_json(
            where=path,
            program=program,
            line=error.lineno,
        )
    if isinstance(error, ElementTree.ParseError):
        return messages.not_xml(
            where=path,
            program=program,
            line=error.position[0],
        )
    if isinstance(error, sqlite3.Error):
        return messages.not_database(
            where=path,
            program=program,
            error=str(error),
        )
    if isinstance(error, OSError) and error.strerror:
        return messages.not_readable(
            where=path,
            program=program,
            error=error.strerror,
        )
    return messages.damaged(
        where=path,
        program=program,
    )


def read_camera(
    path: Path,
    file_format: str | None,
    name: str | None,
) -> Camera:
    """The camera of a file with a ``name``, or without a name the only camera of the file.

    ``file_format`` is the stated format, None if the ending decides. Refuses (InputError) an
    unknown format or a file in another format (IMPORT-FORMAT), a name that the file does not have,
    and several cameras without a name (CAMERA-NAME).
    """
    program = format_of(BLOCKS, path, file_format)
    with damage_refused(path, program):
        cameras = block_reader(program).read_cameras(path)
        chosen = name or ""
        if name is None and len(cameras) == 1:
            chosen = next(iter(cameras))
        if chosen in cameras:
            with damage_refused(f"{path}, camera {chosen}", program):
                return cameras[chosen]()
    names = ", ".join(map(repr, cameras)) or "no camera"
    if name is None:
        raise messages.camera_unnamed(
            where=path,
            cameras=names,
        )
    raise messages.camera_not_there(
        where=path,
        cameras=names,
        name=name,
    )


def read_block_images(
    path: Path,
    program: str,
) -> OrientationTable:
    """The images of a block with their orientations.

    Quaternions are scaled to length 1. Refuses (InputError) an image that occurs twice, a block
    without orientations, positions beyond any measurement, and orientations that are not rotations.
    """
    with damage_refused(path, program):
        table = block_reader(program).read_images(path)
    counts = Counter(table.image.tolist())
    repeated = [name for name, count in counts.items() if count > 1]
    if repeated:
        raise messages.image_repeated(
            where=path,
            image=repeated[0],
        )
    if len(table.image) == 0:
        raise messages.no_orientation(where=path)
    _refuse_far_positions(path, table.image, table.position)
    length = np.linalg.norm(measured(table.angles), axis=1)
    is_wrong = np.abs(length - 1.0) > _LARGEST_NORM_ERROR
    if is_wrong.any():
        raise messages.no_rotation(
            where=path,
            image=str(table.image[np.argmax(is_wrong)]),
        )
    return replace(table, angles=table.angles / length[:, None])


def _refuse_far_positions(
    path: Path,
    name: Sequence[str] | Names,
    position: Array,
) -> None:
    """Refuse positions (n, 3) with a coordinate beyond `LARGEST_NUMBER`; NaN is not refused.

    ``name`` (n,) are the names of the images or points.
    """
    is_too_far = (np.abs(position) > LARGEST_NUMBER).any(axis=1)
    if is_too_far.any():
        first = int(np.argmax(is_too_far))
        raise messages.position_beyond(
            where=path,
            item=str(name[first]),
            largest=float(np.nanmax(np.abs(position[first]))),
        )


def read_block_points(
    path: Path,
    program: str,
) -> tuple[pa.StringArray, Array]:
    """The object points of a block: names, and (p, 3) positions in the frame of its images."""
    with damage_refused(path, program):
        names, position = block_reader(program).read_points(path)
    _refuse_far_positions(path, names, position)
    return names, position


def read_block_places(
    path: Path,
    program: str,
) -> tuple[KnownPlaces, ...]:
    """Positions of a block's images from before the adjustment; one entry for each source."""
    with damage_refused(path, program):
        places = block_reader(program).read_places(path)
    for source in places:
        _refuse_far_positions(path, source.image, source.position)
    return places


def block_rows(
    path: Path,
    program: str,
) -> Iterator[pa.RecordBatch]:
    """The image points of a block, image by image; a damaged part is refused when it is reached."""
    with refusals_of_libraries(path, program):
        yield from block_reader(program).read_rows(path)
