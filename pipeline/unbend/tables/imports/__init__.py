"""Files of other programs that are read: trajectories, camera events, orientations, by format.

A new format is a module next to this one, and its reader in `TRAJECTORIES`, `CAMERA_EVENTS` or
`ORIENTATIONS`: a function of the path, what the mission file states, and the ledger, that returns a
channel, or an `OrientationTable`.
"""

from collections.abc import Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from unbend.tables.imports import messages

Registry = Mapping[str, tuple[str, tuple[str, ...]]]
"""Format -> its reader as ``module:function``, imported when a file is read, and its endings."""

TRAJECTORIES: Registry = {
    "rtklib": ("unbend.tables.imports.rtklib:read_pos", (".pos",)),
    "sbet": ("unbend.tables.imports.sbet:read_sbet", (".sbet", ".out")),
    "csv": ("unbend.tables.imports.user_trajectories:read_trajectory_csv", (".csv", ".txt")),
}

CAMERA_EVENTS: Registry = {
    "rtklib": ("unbend.tables.imports.rtklib:read_pos", (".pos",)),
    "mrk": ("unbend.tables.imports.camera_events:read_mrk", (".mrk",)),
    "eo": ("unbend.tables.imports.camera_events:read_eo_text", (".txt", ".eo", ".dat")),
}
"""Readers of exposures with their positions: columns of positions, and ``event_index``."""

ORIENTATIONS: Registry = {
    "csv": ("unbend.tables.imports.user_tables:read_orientation", (".csv", ".txt")),
    "dji": ("unbend.tables.imports.exif:read_gimbal_orientations", ()),
}
"""Readers of positions and attitudes of images: a table, or the images of a folder themselves."""


def format_of(readers: Registry, path: Path, stated_format: str | None) -> str:
    """The format of a file: ``stated_format``, or without that the format with the file's ending.

    Refuses (InputError) a file without a stated format that has an unknown ending or none.

    >>> format_of(CAMERA_EVENTS, Path("100_0001_Timestamp.MRK"), None)
    'mrk'
    """
    all_endings: list[str] = []
    for format_name, (_, endings) in readers.items():
        is_stated = format_name == stated_format
        has_ending = stated_format is None and path.suffix.lower() in endings
        if is_stated or has_ending:
            return format_name
        all_endings += endings
    known_endings = ", ".join(all_endings)
    formats = ", ".join(readers)
    if not path.suffix:
        raise messages.ending_missing(where=path, known=known_endings, formats=formats)
    raise messages.ending_unknown(
        where=path,
        ending=path.suffix,
        known=known_endings,
        formats=formats,
    )


def reader_of(readers: Registry, path: Path, stated_format: str | None) -> Any:
    """Import the function that reads a file of the stated format, or of that of its ending."""
    reader_name, _ = readers[format_of(readers, path, stated_format)]
    return resolve_name(reader_name)
