"""Hashes of files, remembered as long as a file's place, size and times stay as they were.

A season's inputs are a terabyte: they are read for their hashes once, not at each run.
"""

import hashlib
import os
import sqlite3
import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from pipeline.caches import user_cache
from pipeline.ingest import hash_file

SETTLED_NS = 2_000_000_000
"""A file changed within this time may change again with the same times: FAT counts 2 s."""

_MOST_FILES = 1_000_000
"""Remembered, a season or two: of more those that were hashed longest ago are forgotten."""

_TABLE = "CREATE TABLE IF NOT EXISTS hashes (path TEXT PRIMARY KEY, stamp TEXT, sha256 TEXT)"
_FORGET = "DELETE FROM hashes WHERE rowid <= (SELECT max(rowid) FROM hashes) - ?"


def remembered_hash(path: Path, *, verify: bool = False, of_jpeg: int | None = None) -> str:
    """SHA-256 of a file; not read again while inode, size, time of content and of status stay.

    Of a JPEG, whose EXIF comes first, only the first ``of_jpeg`` bytes where these are given.
    ``verify`` reads it anyway. A file that changed in the last two seconds is not remembered.
    Without a cache that can be written every file is read.
    """
    stat = path.stat()
    stamp = f"{stat.st_ino} {stat.st_size} {stat.st_mtime_ns} {stat.st_ctime_ns}"
    place = os.path.realpath(path) + ("" if of_jpeg is None else f"\0{of_jpeg} of JPEG")
    if not verify and (known := recalled(place, stamp)):
        return known
    began = time.time_ns()
    start = b""
    if of_jpeg is not None:
        with path.open("rb") as stream:
            start = stream.read(of_jpeg)
    is_jpeg = start.startswith(b"\xff\xd8")
    sha256 = hashlib.sha256(start).hexdigest() if is_jpeg else hash_file(path)
    if began - max(stat.st_mtime_ns, stat.st_ctime_ns) > SETTLED_NS:
        remember(place, stamp, sha256)
    return sha256


def recalled(place: str, stamp: str) -> str | None:
    """The SHA-256 remembered of a path or URL with this stamp."""
    with suppress(sqlite3.Error, OSError):
        query = "SELECT sha256 FROM hashes WHERE path = ? AND stamp = ?"
        if known := _database(user_cache()).execute(query, (place, stamp)).fetchone():
            return str(known[0])
    return None


def remember(place: str, stamp: str, sha256: str) -> None:
    """Remember the SHA-256 of a path or URL for as long as its stamp stays."""
    with suppress(sqlite3.Error, OSError), _database(user_cache()) as database:
        database.execute("INSERT OR REPLACE INTO hashes VALUES (?, ?, ?)", (place, stamp, sha256))
        database.execute(_FORGET, (_MOST_FILES,))


@lru_cache(maxsize=1)
def _database(folder: str) -> sqlite3.Connection:
    os.makedirs(folder, exist_ok=True)
    name = os.path.join(folder, "hashes.sqlite")
    database = sqlite3.connect(name, timeout=10.0, check_same_thread=False)
    database.execute(_TABLE)
    return database
