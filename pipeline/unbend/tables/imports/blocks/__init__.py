"""Blocks of images in files of other programs, by format: cameras, orientations, image points.

A new format is a module beside this one that has the functions of `BlockFormat`, and its line in
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
    """What the module of a format does with the path of a mission file, a file or a folder."""

    def block_files(self, path: Path) -> tuple[Path, ...]:
        """The files that are read; refuses where one that is needed is missing."""

    def read_cameras(self, path: Path) -> CameraMakers:
        """The cameras by name: a function that makes each."""

    def read_images(self, path: Path) -> OrientationTable:
        """Images, their cameras, x, y, z and quaternions; NaN where an image has none."""

    def read_places(self, path: Path) -> tuple[KnownPlaces, ...]:
        """Where the files say that the images were, beside their orientations; of each source."""

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
"""Formats, and the endings by which the file of a camera is known."""


def block_reader(program: str) -> BlockFormat:
    """The module of a format."""
    module: BlockFormat = resolve_name(BLOCKS[program][0])
    return module


_LONGEST_NORM_ERROR = 1e-3  # of quaternions, which are written with a few digits
_OF_LIBRARIES = (
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,  # a number that no float or integer of 64 bits holds
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
    """Raise what a library says of a damaged file as InputError (IMPORT-FORMAT).

    So are numbers whose quotients and products are none: a size of 0, a length of 1e308.
    """
    strict = np.errstate(divide="raise", over="raise", invalid="raise")
    with refusals_of_libraries(path, program), strict:
        yield


@contextmanager
def refusals_of_libraries(
    path: Path | str,
    program: str,
) -> Iterator[None]:
    """As `damage_refused`, around what yields: the state of numpy would be that of its caller."""
    try:
        yield
    except PhysicsError as error:
        where = f"{path}, {error.where}" if error.where else path
        raise error.as_kind(InputError, where=where) from None
    except UnbendError:
        raise
    except _OF_LIBRARIES as error:
        raise _refusal_of(error, path, program) from None


def _refusal_of(
    error: Exception,
    path: Path | str,
    program: str,
) -> InputError:
    """What a library says of a damaged file, as a refusal."""
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
    """The camera of a file: the named one, or the only one.

    Refuses (InputError) a format that is not known or not met (IMPORT-FORMAT), a name that is not
    there, and several cameras without a name (CAMERA-NAME).
    """
    program = format_of(BLOCKS, path, file_format)
    with damage_refused(path, program):
        cameras = block_reader(program).read_cameras(path)
        chosen = next(iter(cameras)) if name is None and len(cameras) == 1 else name or ""
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

    Refuses (InputError) an image that stands there twice, and a block without orientations.
    """
    with damage_refused(path, program):
        table = block_reader(program).read_images(path)
    twice = [name for name, count in Counter(table.image.tolist()).items() if count > 1]
    if twice:
        raise messages.image_repeated(
            where=path,
            image=twice[0],
        )
    if len(table.image) == 0:
        raise messages.no_orientation(where=path)
    _refuse_beyond(path, table.image, table.position)
    length = np.linalg.norm(measured(table.angles), axis=1)
    wrong = np.abs(length - 1.0) > _LONGEST_NORM_ERROR
    if wrong.any():
        raise messages.no_rotation(
            where=path,
            image=str(table.image[np.argmax(wrong)]),
        )
    return replace(table, angles=table.angles / length[:, None])


def _refuse_beyond(
    path: Path,
    name: Sequence[str] | Names,
    position: Array,
) -> None:
    """Refuse positions (n, 3) that no frame of a block has; NaN where one is unknown."""
    beyond = (np.abs(position) > LARGEST_NUMBER).any(axis=1)
    if beyond.any():
        first = int(np.argmax(beyond))
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
    _refuse_beyond(path, names, position)
    return names, position


def read_block_places(
    path: Path,
    program: str,
) -> tuple[KnownPlaces, ...]:
    """Where the files of a block say that its images were, beside their orientations."""
    with damage_refused(path, program):
        places = block_reader(program).read_places(path)
    for source in places:
        _refuse_beyond(path, source.image, source.position)
    return places


def block_rows(
    path: Path,
    program: str,
) -> Iterator[pa.RecordBatch]:
    """The image points of a block, image by image; refuses a damaged file where it is damaged."""
    with refusals_of_libraries(path, program):
        yield from block_reader(program).read_rows(path)
