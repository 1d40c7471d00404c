"""Hashes of files, remembered as long as a file's place, size and times stay as they were."""

import hashlib
import os
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unbend.batch.object_store import Place, version_of
from unbend.caches import read_entry, write_entries
from unbend.errors import InputError
from unbend.ingest import hash_file
from unbend.tables.geodata.gdal import raster_files
from unbend.tables.imports.blocks import block_reader, damage_refused

GDAL = "GDAL"

SETTLED_NS = 2_000_000_000
"""A file changed within this time may change again with the same times: FAT counts 2 s."""

_MOST_FILES = 1_000_000
"""Remembered, a season or two: of more those that were hashed longest ago are forgotten."""

_DATABASE = "hashes.sqlite"


@dataclass(frozen=True)
class Input:
    """A file the mission reads: as the mission file names it, where it is, and what it holds.

    ``program`` is a block's, or GDAL, which read files beside it too; ``path`` of an input at a
    ``place`` is that of its copy, which may not be made yet.
    """

    role: str
    name: str
    path: Path
    sha256: str
    stamp: tuple[list[int] | None, ...] | str
    program: str | None = None
    place: Place | None = None


def stamp(path: str | Path) -> list[int] | None:
    """Device, inode, size, times of content and status [ns] of a file, links followed; or None."""
    try:
        s = os.stat(path)
    except OSError:
        return None
    return [s.st_dev, s.st_ino, s.st_size, s.st_mtime_ns, s.st_ctime_ns]


def is_settled(stamped: list[int] | None) -> bool:
    """Whether a file is there, and changed so long ago that its next change will show."""
    return stamped is not None and max(stamped[3:]) < time.time_ns() - SETTLED_NS


def remembered_hash(path: Path, *, verify: bool = False, of_jpeg: int | None = None) -> str:
    """SHA-256 of a file; not read again while device, inode, size and both times stay.

    Of a JPEG, whose EXIF comes first, only the first ``of_jpeg`` bytes where these are given.
    ``verify`` reads it anyway. A file that changed in the last two seconds is not remembered.
    Without a cache that can be written every file is read.
    """
    stamped = stamp(path)
    settled = is_settled(stamped)
    place = os.path.realpath(path) + ("" if of_jpeg is None else f"\0{of_jpeg} of JPEG")
    if not verify and (known := recalled(place, stamped)):
        return known
    start = b""
    if of_jpeg is not None:
        with path.open("rb") as stream:
            start = stream.read(of_jpeg)
    is_jpeg = start.startswith(b"\xff\xd8")
    sha256 = hashlib.sha256(start).hexdigest() if is_jpeg else hash_file(path)
    if settled:
        remember({place: (stamped, sha256)})
    return sha256


def recalled(place: str, stamped: Any) -> str | None:
    """The SHA-256 remembered of a path or URL with this stamp, or version."""
    was, sha256 = read_entry(_DATABASE, place) or (None, None)
    return sha256 if stamped is not None and was == stamped else None


def remember(hashes: Mapping[str, tuple[Any, str]]) -> None:
    """Remember the stamp, or version, and SHA-256 of paths or URLs for as long as that stays."""
    write_entries(_DATABASE, hashes, _MOST_FILES)


def known_hash(path: Path) -> str | None:
    """`remembered_hash` of a file of which one is remembered, as it is or as it was; else None."""
    return remembered_hash(path) if read_entry(_DATABASE, os.path.realpath(path)) else None


def check_unchanged(inputs: Iterable[Input], *, folders: bool = True) -> None:
    """Refuse results whose inputs were written to, or replaced, while they were made.

    By the same content too: another one may have been there in between, and read. Without
    ``folders`` those of images are not looked at, and no object storage. The number of the device
    is not compared: each machine that shares a disk has its own.
    """
    for item in inputs:
        if item.place is not None:
            if folders:
                with suppress(FileNotFoundError):
                    if version_of(item.place) == item.stamp:
                        continue
                raise InputError.of("INPUT-CHANGED", item.place, role=item.role)
            continue
        if not folders and item.program is None and item.path.is_dir():
            continue
        now = map(stamp, files_of(item.path, item.program))
        if [s and s[1:] for s in now] != [s and s[1:] for s in item.stamp]:
            raise InputError.of("INPUT-CHANGED", str(item.path), role=item.role)


def files_of(path: Path, program: str | None) -> tuple[Path, ...]:
    """The files of an input: of a block all, of a raster those beside it too, or images."""
    if program == GDAL:
        return raster_files(path)
    if program is not None:
        with damage_refused(path, program):
            return block_reader(program).block_files(path)
    if path.is_file():
        return (path,)
    from unbend.tables.imports.exif import image_files

    return tuple(image_files(path))
