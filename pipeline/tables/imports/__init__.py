"""Files of other programs that are read: trajectories, camera events, orientations, by format.

A new format is a module beside this one, and its reader in `TRAJECTORIES`, `CAMERA_EVENTS` or
`ORIENTATIONS`: a function of the path, what the mission file states, and the ledger, that returns a
channel, or an `OrientationTable`.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from pipeline.errors import InputError
from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger
from pipeline.tables.imports.eo_text import read_eo_text
from pipeline.tables.imports.exif import read_gimbal_orientations
from pipeline.tables.imports.mrk import read_mrk
from pipeline.tables.imports.orientation import OrientationTable, read_orientation
from pipeline.tables.imports.rtklib import read_pos
from pipeline.tables.imports.sbet import read_sbet
from pipeline.tables.imports.stated import Stated
from pipeline.tables.imports.trajectory_csv import read_trajectory_csv

Reader = Callable[[Path, Stated, Ledger], Channel]
AnyReader = TypeVar("AnyReader")

TRAJECTORIES: Mapping[str, tuple[Reader, tuple[str, ...]]] = {
    "rtklib": (read_pos, (".pos",)),
    "sbet": (read_sbet, (".sbet", ".out")),
    "csv": (read_trajectory_csv, (".csv", ".txt")),
}
"""Readers of trajectories, and the endings by which a file is known."""

CAMERA_EVENTS: Mapping[str, tuple[Reader, tuple[str, ...]]] = {
    "rtklib": (read_pos, (".pos",)),
    "mrk": (read_mrk, (".mrk",)),
    "eo": (read_eo_text, (".txt", ".eo", ".dat")),
}
"""Readers of exposures with their positions: columns of positions, and ``event_index``."""


ORIENTATIONS: Mapping[
    str, tuple[Callable[[Path, Stated, Ledger], OrientationTable], tuple[str, ...]]
] = {"csv": (read_orientation, (".csv", ".txt")), "dji": (read_gimbal_orientations, ())}
"""Readers of positions and attitudes of images: a table, or the images of a folder themselves."""


def reader_of(
    readers: Mapping[str, tuple[AnyReader, tuple[str, ...]]], path: Path, name: str | None
) -> tuple[str, AnyReader]:
    """The format of a file, stated or by its ending, and its reader.

    >>> reader_of(CAMERA_EVENTS, Path("100_0001_Timestamp.MRK"), None)[0]
    'mrk'
    """
    for known, (reader, endings) in readers.items():
        if known == name or (name is None and path.suffix.lower() in endings):
            return known, reader
    able = ", ".join(ending for _, endings in readers.values() for ending in endings)
    what = f"its ending {path.suffix or 'is missing: it'} says nothing; known are {able}"
    raise InputError(
        "IMPORT-FORMAT", what, where=str(path), remedy=f"give format: {', '.join(readers)}"
    )


__all__ = ["CAMERA_EVENTS", "ORIENTATIONS", "TRAJECTORIES", "Reader", "Stated", "reader_of"]
