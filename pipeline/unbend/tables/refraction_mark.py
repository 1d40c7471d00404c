"""The mark of observations from which refraction was removed, so that nothing removes it twice.

Parquet keeps the mark in its metadata, a database in a separate table. Any other file has a sidecar
``<file>.unbend.json`` next to it, with the SHA-256 of each file that contains such observations.
Every export has a sidecar that describes its frame; without such observations it lists no files.
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
"""Whether a mission removes refraction from observations, or applies it to ideal ones."""

REFRACTION_KEY = b"unbend.refraction"
REFRACTION_REMOVED = b"removed"
REFRACTION_APPLIED = b"applied"
SIDECAR = ".unbend.json"
MARK_TABLE = "unbend"  # of a database, with columns key and value; one row is the mark
_SQLITE = b"SQLite format 3\0"
# The same observations under another name: COLMAP writes a model in a binary form or as text.
_OTHER_FORMS = {"images.bin": "images.txt", "images.txt": "images.bin"}


def sidecar_text(files: Mapping[str, Path], about: Mapping[str, Any]) -> str:
    """The text of a sidecar that marks files; ``about`` is added as information for readers.

    ``files`` : the name that each file will have -> where it is now. Without files the sidecar has
    no mark.
    """
    hashes = [{"name": name, "sha256": _sha256(path)} for name, path in files.items()]
    content: dict[str, Any] = {"files": hashes, **about}
    if files:
        content = {REFRACTION_KEY.decode(): REFRACTION_REMOVED.decode(), **content}
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def refuse_marked(path: Path, direction: Direction = "remove") -> None:
    """Refuse to remove refraction from a file of observations that is marked as corrected.

    ``path`` is a file, or a folder: then all its files are checked. Refused (InputError) are:

    - OBS-ALREADY-CORRECTED: a database with the mark, or a file with a content that a sidecar in
      its folder lists, under any name;
    - OBS-MARK-CHANGED: a file with a name that a sidecar lists, but with another content. Another
      program has changed or replaced it, or has written it in its other form (`_OTHER_FORMS`);
    - OBS-MARK-UNREADABLE: any file in a folder with a sidecar that cannot be read.

    Files are hashed only if there is a sidecar. Marks of Parquet and CSV: `refuse_marked_table`.
    """
    if direction != "remove":
        return
    folder = path.parent
    files = [path]
    if path.is_dir():
        folder = path
        files = sorted(file for file in path.iterdir() if file.is_file())
    sidecar_of_name, sidecar_of_hash = _marked_files(folder)
    for file in files:
        file_hash = _sha256(file) if sidecar_of_hash else ""
        if file_hash in sidecar_of_hash:
            raise messages.corrected_by_sidecar(where=file, sidecar=sidecar_of_hash[file_hash].name)
        if _database_is_marked(file):
            raise messages.corrected_by_database(where=file, table=MARK_TABLE)
        if file.name in sidecar_of_name:
            raise messages.marked_file_changed(where=file, name=sidecar_of_name[file.name].name)


def _marked_files(folder: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """The sidecars in a folder, by the names and by the SHA-256 of the files that they list.

    A file of `_OTHER_FORMS` is found by the name of its other form too.
    Refuses (OBS-MARK-UNREADABLE) a sidecar that cannot be read.
    """
    sidecar_of_name = {}
    sidecar_of_hash = {}
    sidecars = [file for file in folder.glob(f"*{SIDECAR}") if file.is_file()]
    for sidecar in sorted(sidecars):
        try:
            for item in json.loads(sidecar.read_text(encoding="utf-8"))["files"]:
                name = str(item["name"])
                sidecar_of_name[name] = sidecar
                if name in _OTHER_FORMS:
                    sidecar_of_name.setdefault(_OTHER_FORMS[name], sidecar)
                sidecar_of_hash[str(item["sha256"])] = sidecar
        except (OSError, ValueError, KeyError, TypeError) as error:
            error_name = type(error).__name__
            raise messages.sidecar_unreadable(where=sidecar, name=error_name) from None
    return sidecar_of_name, sidecar_of_hash


def refuse_marked_table(
    path: Path, schema: pa.Schema, direction: Direction, *, is_file: bool = True
) -> None:
    """Refuse to remove refraction from, or apply it to, a table where that was done already.

    ``schema`` is the schema of the table, ``direction`` what the mission will do. The table is
    marked by its metadata, by a column of our results (a CSV has no metadata), or by a sidecar. A
    table in memory, with ``is_file`` False, has no sidecar.
    """
    metadata = schema.metadata or {}
    mark = metadata.get(REFRACTION_KEY)
    if direction == "remove":
        refused_mark = REFRACTION_REMOVED
        refused_columns = ("x_corrected_px", "y_corrected_px")
        refusal_of_mark = messages.corrected_by_mark
        refusal_of_column = messages.corrected_by_column
    else:
        refused_mark = REFRACTION_APPLIED
        refused_columns = ("x_displaced_px", "y_displaced_px")
        refusal_of_mark = messages.displaced_by_mark
        refusal_of_column = messages.displaced_by_column
    if mark == refused_mark:
        raise refusal_of_mark(where=path, mark=refused_mark.decode())
    for name in schema.names:
        if name in refused_columns:
            raise refusal_of_column(where=path, column=name)
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
    except sqlite3.DatabaseError:  # no such table; damage is reported by the reader of the file
        return False
    return bool(row == (REFRACTION_REMOVED.decode(),))


def _sha256(path: Path) -> str:
    """The SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
