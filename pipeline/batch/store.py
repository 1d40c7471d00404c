"""A run's folder: nothing visible is incomplete, one writer at a time, damage can be found.

Everything is written into a hidden staging folder beside its place. Only when all of it is there
and on the disk are the old results taken away and the new ones moved in, the manifest last.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import OutputInUseError, StorageError
from pipeline.ingest import hash_file

MANIFEST = "manifest.json"
_MANIFEST_KEYS = {"fingerprint", "mission", "outputs", "exit_code"}
_STAGING = ".staging"
_LOCK = ".lock"
_OWNED = "The files of this folder that manifest.json names were written by unbend.\n"
_PARTS = "observations"
_PART = re.compile(r"part-[0-9]{5,}\.parquet")
_OURS = (_PARTS, "stations.parquet", "profile.parquet", "report.html")


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn what the operating system says about a file into a refusal."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            "STORAGE-WRITE",
            f"{error.strerror or error}",
            where=str(error.filename or path),
            remedy="free space or mend permissions, then run again: finished missions are kept",
        ) from None


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A place to write to, beside ``path``; the file appears there when all of it is written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    try:
        with translated(path):
            yield draft
            with draft.open("rb") as file:
                os.fsync(file.fileno())
            draft.replace(path)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


@dataclass(frozen=True)
class RunFolder:
    """The output folder of one mission, locked for this process."""

    path: Path
    _seals: dict[str, tuple[str, int]] = field(default_factory=dict)

    @property
    def staging(self) -> Path:
        return self.path / _STAGING

    def place(self, name: str) -> Path:
        """Where to write a result for now; its folder exists."""
        target = self.staging / name
        with translated(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        return target

    def seal(self, name: str) -> None:
        """Put a result that was written on the disk for good, and remember its hash."""
        target = self.staging / name
        with translated(target):
            _sync(target)
            self._seals[name] = (hash_file(target), target.stat().st_size)

    def outputs(self) -> list[dict[str, str | int]]:
        """What was sealed, for the manifest."""
        return [
            {"name": name, "sha256": digest, "bytes": size}
            for name, (digest, size) in sorted(self._seals.items())
        ]

    def commit(self, manifest: dict[str, Any]) -> None:
        """Make the staged results the visible ones; the manifest comes last."""
        text = json.dumps(manifest, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
        text += "\n"
        with translated(self.path):
            draft = self.staging / MANIFEST
            draft.write_text(text, encoding="utf-8")
            _sync(draft)
            for folder in {(self.staging / name).parent for name in self._seals}:
                _sync(folder)
            # From here on the folder is ours, even if we die before the manifest is written.
            (self.path / _LOCK).write_text(_OWNED, encoding="ascii")
            (self.path / MANIFEST).unlink(missing_ok=True)
            _sync(self.path)
            for part in (self.path / _PARTS).glob("part-*.parquet"):
                if _PART.fullmatch(part.name) and f"{_PARTS}/{part.name}" not in self._seals:
                    part.unlink()
            for name in sorted(self._seals):
                target = self.path / name
                target.parent.mkdir(exist_ok=True)
                (self.staging / name).replace(target)
            for folder in {(self.path / name).parent for name in self._seals}:
                _sync(folder)
            draft.rename(self.path / MANIFEST)
            _sync(self.path)
            _remove(self.staging)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def would_replace(folder: Path, path: Path) -> bool:
    """Whether a run that writes to a folder removes this file, or writes in its place.

    >>> would_replace(Path("/r"), Path("/r/observations/own.parquet"))
    True
    >>> would_replace(Path("/r"), Path("/r/flight.bin"))
    False
    """
    ours = {*_OURS, MANIFEST, _STAGING, _LOCK}
    # A link may stand in one place and lead to another: neither may be touched.
    for place in (os.path.abspath, os.path.realpath):
        holds, held = Path(place(folder)), Path(place(path))
        if held.is_relative_to(holds) and {*held.relative_to(holds).parts[:1]} & ours:
            return True
    return False


def _refuse_strangers(path: Path) -> None:
    """Refuse a folder that holds files of our names which no run of ours put there."""
    lock = path / _LOCK
    if (lock.is_file() and lock.stat().st_size > 0) or (path / MANIFEST).exists():
        return
    strangers = [name for name in _OURS if os.path.lexists(path / name)]
    if strangers:
        raise StorageError(
            "STORAGE-NOT-OURS",
            f"{', '.join(strangers)} would be replaced, but no run of unbend left traces here",
            where=str(path),
            remedy="choose an output.path of its own for the results",
        )


@contextmanager
def open_folder(path: Path) -> Iterator[RunFolder]:
    """Lock an output folder and clear what an interrupted run left in it.

    The lock dies with the process. Refuses a folder that another process writes to, and one that
    is a symbolic link in disguise.
    """
    with translated(path):
        path.mkdir(parents=True, exist_ok=True)
    for name in (_STAGING, *_OURS, MANIFEST):
        if (path / name).is_symlink():
            raise StorageError(
                "STORAGE-SYMLINK",
                f"{name} is a symbolic link",
                where=str(path),
                remedy="remove it: results are never written through a link",
            )
    with translated(path):
        _refuse_strangers(path)
        lock = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise StorageError("STORAGE-LOCK", str(error), where=str(path)) from None
            raise OutputInUseError(
                "OUTPUT-IN-USE",
                "another process is writing to this folder",
                where=str(path),
                remedy="wait for it, or choose another output.path",
            ) from None
        with translated(path):
            _remove(path / _STAGING)
            (path / _STAGING).mkdir()
        try:
            yield RunFolder(path)
        finally:
            with suppress(OSError):
                _remove(path / _STAGING)
    finally:
        os.close(lock)


def _listed(manifest: dict[str, Any]) -> list[Any]:
    outputs = manifest["outputs"]
    return outputs if isinstance(outputs, list) else [outputs]


def read_manifest(path: Path) -> dict[str, Any] | None:
    """The manifest of a run's folder; None where there is none."""
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StorageError(
            "MANIFEST-UNREADABLE",
            f"the manifest cannot be read: {error}",
            where=str(path / MANIFEST),
            remedy="run the mission again with --force",
        ) from None
    whole = isinstance(manifest, dict) and manifest.keys() >= _MANIFEST_KEYS
    if not whole or not all(isinstance(item, dict) for item in _listed(manifest)):
        raise StorageError(
            "MANIFEST-UNREADABLE",
            "manifest.json is not one that unbend wrote",
            where=str(path / MANIFEST),
            remedy="choose another folder, or remove that file",
        )
    found: dict[str, Any] = manifest
    return found


def find_damage(path: Path, manifest: dict[str, Any], *, read: bool = True) -> list[str]:
    """What is missing or changed in a run's folder, one line each; empty when it is whole.

    ``read=False`` reads the small files, but of the parts only names and sizes.
    """
    damage = []
    known = {str(item["name"]) for item in manifest["outputs"]}
    for item in manifest["outputs"]:
        file = path / str(item["name"])
        if not file.is_file():
            damage.append(f"{item['name']}: is missing")
        elif file.stat().st_size != item["bytes"]:
            damage.append(f"{item['name']}: {file.stat().st_size} bytes, not {item['bytes']}")
        elif (read or file.parent == path) and hash_file(file) != item["sha256"]:
            damage.append(f"{item['name']}: its content has changed")
    found = {f"{_PARTS}/{p.name}" for p in (path / _PARTS).glob("part-*.parquet")}
    damage += [f"{name}: belongs to no run" for name in sorted(found - known)]
    return damage
