"""Recognise a file or folder that was given instead of a mission file."""

import json
from pathlib import Path
from typing import NamedTuple

from unbend.tables.manifest.file_names import MANIFEST, REPORT

MISSION_ENDINGS = (".yaml", ".yml")

_HEAD_BYTES = 1 << 16  # enough to recognise a flight log


class OtherFile(NamedTuple):
    """A file of another kind, given instead of a mission file."""

    what: str  # it is, in words
    remedy: str  # what to do


class _Mark(NamedTuple):
    """The bytes at the beginning of a kind of files."""

    mark: bytes
    what: str  # such a file is, in words


_MARKS = (
    _Mark(b"PAR1", "a Parquet table"),
    _Mark(b"SQLite format 3", "a database"),
    _Mark(b"\x89HDF", "a netCDF or HDF5 file"),
    _Mark(b"CDF", "a netCDF file"),
    _Mark(b"GRIB", "a GRIB file"),
    _Mark(b"\xff\xd8\xff", "an image (JPEG)"),
    _Mark(b"\x89PNG", "an image (PNG)"),
    _Mark(b"II*\x00", "an image (TIFF)"),
    _Mark(b"MM\x00*", "an image (TIFF)"),
    _Mark(b"PK\x03\x04", "a ZIP archive"),
    _Mark(b"\x1f\x8b", "a file compressed with gzip"),
    _Mark(b"%PDF", "a PDF"),
)
_NAMED_IN_MISSION = "name it in a mission file; `unbend init LOG OBSERVATIONS` writes one"
_TABLES = (".csv", ".tsv", ".txt", ".pos", ".dat")


def other_file(path: Path) -> OtherFile | None:
    """What a path is, if it cannot be a mission file; None if it may be one.

    None also for a path that cannot be read.
    """
    if path.is_dir():
        return _folder(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError:
        return None
    folder = results_folder_of(path)
    if folder is not None and path.suffix in (".json", ".html", ".parquet"):
        return _results(folder)
    return _flight_log(path, head) or _binary_file(head) or _text_file(path, head)


def results_folder_of(path: Path) -> Path | None:
    """The folder of results of a run: the path itself, or the folder around it; else None."""
    for folder in (path, path.parent):
        if (folder / MANIFEST).is_file() and (folder / REPORT).is_file():
            return folder
    return None


def _folder(path: Path) -> OtherFile:
    """What a folder is: the results of a run, or any other folder."""
    if results_folder_of(path) == path:
        return _results(path, "the folder of the results of a run")
    if _has_mission_files(path):
        return OtherFile("a folder", f"name its mission files: {path}/*.yaml")
    return OtherFile("a folder", "name a mission file; `unbend init LOG OBSERVATIONS` writes one")


def _has_mission_files(path: Path) -> bool:
    """Whether there are YAML files in a folder."""
    return any(any(path.glob(f"*{ending}")) for ending in MISSION_ENDINGS)


def _results(folder: Path, what: str = "a file of the results of a run") -> OtherFile:
    """A folder of results, or a file in it; ``what`` names which of both."""
    return OtherFile(
        what,
        f"name the mission file of these results; `unbend verify {folder}` checks them, "
        f"`unbend export {folder}` writes them for other programs",
    )


def _flight_log(path: Path, head: bytes) -> OtherFile | None:
    """A flight log of a known format, by its first bytes, or by its ending if it is not text.

    None for any other file.
    """
    # Imported here because it takes a while, and is needed only if something is wrong.
    from unbend.ingest.registry import FORMATS, format_of_head

    form = format_of_head(head)
    if form is None and not _is_text(head):
        ending = path.suffix.lower()
        form = next((form for form in FORMATS if ending in form.extensions), None)
    if form is None:
        return None
    return OtherFile(
        f"a flight log: {form.title}",
        f"write a mission file first: `unbend init {path} OBSERVATIONS`, then run that; "
        f"`unbend inspect {path}` shows the content of the log",
    )


def _binary_file(head: bytes) -> OtherFile | None:
    """A file of a known kind by its first bytes, or any other file that is not text; else None."""
    for mark, what in _MARKS:
        if head.startswith(mark):
            return OtherFile(what, _NAMED_IN_MISSION)
    if not _is_text(head):
        return OtherFile("not text in UTF-8", "a mission file is YAML in UTF-8")
    return None


def _text_file(path: Path, head: bytes) -> OtherFile | None:
    """A page, XML, JSON or a table, by text and ending; None for a text that may be a mission."""
    text = head.decode("utf-8", errors="ignore").lstrip("\ufeff \r\n\t")
    ending = path.suffix.lower()
    if text[:15].lower().startswith(("<!doctype html", "<html")):
        return OtherFile("a web page", "name a mission file")
    if text.startswith("<"):
        return OtherFile("XML", _NAMED_IN_MISSION)
    if text.startswith("{") and ending in (".json", ".geojson"):
        return _json_file(path)
    if ending in _TABLES:
        return OtherFile("a table of text", _NAMED_IN_MISSION)
    return None


def _json_file(path: Path) -> OtherFile | None:
    """A manifest, a schema or GeoJSON; None for other JSON, which is YAML and may be a mission."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if "manifest_version" in values:
        return _results(path.parent)
    if "$schema" in values and "properties" in values:
        return OtherFile("the JSON schema of mission files, for editors", "name a mission file")
    if "features" in values:
        return OtherFile("GeoJSON", _NAMED_IN_MISSION)
    return None


def _is_text(head: bytes) -> bool:
    """Whether the beginning of a file is UTF-8 text without zero bytes."""
    if b"\x00" in head:
        return False
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # The head may end in the middle of a character.
        return len(head) == _HEAD_BYTES and error.start > len(head) - 4
    return True
