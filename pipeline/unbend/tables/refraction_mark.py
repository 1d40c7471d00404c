"""The mark of observations from which refraction was removed, so that nothing removes it twice.

Parquet keeps it in its metadata, a database in a table of its own. Beside any other file stands a
sidecar ``<file>.unbend.json`` with the SHA-256 of each file that holds such observations. Every
export has a sidecar, for its frame; one without such observations names no file in it.
"""

import hashlib
import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from unbend.tables import messages

Direction = Literal["remove", "apply"]

REFRACTION_KEY = b"unbend.refraction"
REFRACTION_REMOVED = b"removed"
REFRACTION_APPLIED = b"applied"
SIDECAR = ".unbend.json"
MARK_TABLE = "unbend"  # of a database: key and value, of which one is the mark
_SQLITE = b"SQLite format 3\0"


def sidecar_text(files: Mapping[str, Path], about: Mapping[str, Any]) -> str:
    """The sidecar of files by the names they get; ``about`` is for whoever reads it.

    Without files it is no mark.
    """
    hashes = [{"name": name, "sha256": _sha256(path)} for name, path in files.items()]
    content: dict[str, Any] = {"files": hashes, **about}
    if files:
        content = {REFRACTION_KEY.decode(): REFRACTION_REMOVED.decode(), **content}
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def refuse_marked(path: Path, direction: Direction = "remove") -> None:
    """Refuse a file of observations from which refraction was removed, if it is to be removed.

    ``path`` is a file, or a folder of which every file is looked at. Refused (InputError) are a
    database with the mark, and a file whose content a sidecar in its folder names, under whatever
    name (OBS-ALREADY-CORRECTED); a file whose name a sidecar has with another content
    (OBS-MARK-CHANGED): another program has written to it, or it is another file; any file beside a
    sidecar that cannot be read (OBS-MARK-UNREADABLE).

    Files are hashed only where there is a sidecar. Parquet and CSV: `refuse_done`.
    """
    if direction != "remove":
        return
    folder = path.parent
    files = [path]
    if path.is_dir():
        folder = path
        files = sorted(file for file in path.iterdir() if file.is_file())
    by_name, by_content = _marked_files(folder)
    for file in files:
        digest = _sha256(file) if by_content else ""
        if digest in by_content:
            raise messages.corrected_by_sidecar(where=file, sidecar=by_content[digest].name)
        if _database_is_marked(file):
            raise messages.corrected_by_database(where=file, table=MARK_TABLE)
        if file.name in by_name:
            raise messages.marked_file_changed(where=file, name=by_name[file.name].name)


def _marked_files(folder: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """The sidecars in a folder, by the names of the files that they mark, and by their hashes."""
    by_name = {}
    by_content = {}
    sidecars = [file for file in folder.glob(f"*{SIDECAR}") if file.is_file()]
    for sidecar in sorted(sidecars):
        try:
            for item in json.loads(sidecar.read_text(encoding="utf-8"))["files"]:
                by_name[str(item["name"])] = sidecar
                by_content[str(item["sha256"])] = sidecar
        except (OSError, ValueError, KeyError, TypeError) as error:
            name = type(error).__name__
            raise messages.sidecar_unreadable(where=sidecar, name=name) from None
    return by_name, by_content


def refuse_done(
    path: Path, schema: pa.Schema, direction: Direction, *, is_file: bool = True
) -> None:
    """Refuse to do to a table what was done to it already.

    ``schema`` is the table's, ``direction`` what is to be done. The mark in the metadata is
    enough, and so is a column of our results without it: a CSV has no metadata. A sidecar may name
    it as any other file; a table in memory (``is_file`` False) has none.
    """
    metadata = schema.metadata or {}
    mark = metadata.get(REFRACTION_KEY)
    if direction == "remove":
        done = REFRACTION_REMOVED
        results = ("x_corrected_px", "y_corrected_px")
        by_mark = messages.corrected_by_mark
        by_column = messages.corrected_by_column
    else:
        done = REFRACTION_APPLIED
        results = ("x_displaced_px", "y_displaced_px")
        by_mark = messages.displaced_by_mark
        by_column = messages.displaced_by_column
    if mark == done:
        raise by_mark(where=path, mark=done.decode())
    for name in schema.names:
        if name in results:
            raise by_column(where=path, column=name)
    if is_file:
        refuse_marked(path, direction)


def _database_is_marked(path: Path) -> bool:
    """Whether a file is a SQLite database with the mark."""
    with path.open("rb") as stream:
        if stream.read(len(_SQLITE)) != _SQLITE:
            return False
    query = f"SELECT value FROM {MARK_TABLE} WHERE key = ?"
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            row = database.execute(query, (REFRACTION_KEY.decode(),)).fetchone()
    except sqlite3.DatabaseError:  # no such table, or damaged: for its reader to say
        return False
    return bool(row == (REFRACTION_REMOVED.decode(),))


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
