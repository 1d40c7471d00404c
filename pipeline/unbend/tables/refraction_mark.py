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
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
    folder = path if path.is_dir() else path.parent
    sidecars = sorted(p for p in folder.glob(f"*{SIDECAR}") if p.is_file())
    named = []
    for sidecar in sidecars:
        try:
            items = json.loads(sidecar.read_text(encoding="utf-8"))["files"]
            named += [(sidecar, str(item["name"]), str(item["sha256"])) for item in items]
        except (OSError, ValueError, KeyError, TypeError) as error:
            name = type(error).__name__
            raise messages.sidecar_unreadable(where=sidecar, name=name) from None
    by_content = {sha256: sidecar for sidecar, _, sha256 in named}
    by_name = {name: sidecar for sidecar, name, _ in named}
    for file in files:
        digest = _sha256(file) if named else ""
        if digest in by_content:
            raise messages.corrected_by_sidecar(where=file, sidecar=by_content[digest].name)
        if _database_is_marked(file):
            raise messages.corrected_by_database(where=file, table=MARK_TABLE)
        if file.name in by_name:
            raise messages.marked_file_changed(where=file, name=by_name[file.name].name)


def refuse_done(
    path: Path, schema: pa.Schema, direction: Direction, *, is_file: bool = True
) -> None:
    """Refuse to do to a table what was done to it already.

    ``schema`` is the table's, ``direction`` what is to be done. The mark in the metadata is
    enough, and so is a column of our results without it: a CSV has no metadata. A sidecar may name
    it as any other file; a table in memory (``is_file`` False) has none.
    """
    removing = direction == "remove"
    mark = REFRACTION_REMOVED if removing else REFRACTION_APPLIED
    word = "corrected" if removing else "displaced"
    ours = [name for name in schema.names if name in (f"x_{word}_px", f"y_{word}_px")]
    if (schema.metadata or {}).get(REFRACTION_KEY) == mark:
        by_mark = messages.corrected_by_mark if removing else messages.displaced_by_mark
        raise by_mark(where=path, mark=mark.decode())
    if ours:
        by_column = messages.corrected_by_column if removing else messages.displaced_by_column
        raise by_column(where=path, column=ours[0])
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
            found = database.execute(query, (REFRACTION_KEY.decode(),)).fetchone()
    except sqlite3.DatabaseError:  # no such table, or damaged: for its reader to say
        return False
    return bool(found == (REFRACTION_REMOVED.decode(),))


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
