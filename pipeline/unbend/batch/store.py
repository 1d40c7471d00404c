"""A run's folder: nothing visible is incomplete, one writer at a time, damage can be found.

Results are written into a hidden staging folder. When all of them are there and on the disk, the
old results are removed and the new ones renamed into their places, the manifest last. A finished
part of the observations has a receipt there, so that a run that is interrupted need not make it
again.
"""

import json
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from errno import EACCES, EPERM, EROFS
from pathlib import Path
from typing import Any
from uuid import uuid4

from filelock import FileLock, Timeout

from unbend.batch.file_hashes import known_hash, remember, remembered_hash, stamp
from unbend.batch.object_store import Place
from unbend.batch.value_cache import packed, unpacked
from unbend.errors import OutputInUseError, StorageError, storage_errors
from unbend.ingest import hash_file

MANIFEST = "manifest.json"
_MANIFEST_KEYS = {"fingerprint", "mission", "outputs", "exit_code"}
STAGING = ".staging"
_LOCK = ".lock"
_KEY = "key"
_RECEIPTS = "receipts"
_PARTS = "observations"
_PART = re.compile(r"part-[0-9]{5,}\.parquet")
_RESULTS = (_PARTS, "stations.parquet", "profile.parquet", "report.html")
_ATTEMPT = re.compile("[0-9a-f]{32}")

# Windows refuses to replace a file that a virus scanner or a viewer has open; most let go soon.
_REPLACE_ATTEMPTS = 20 if os.name == "nt" else 1
_REPLACE_PAUSE_S = 0.1


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A path to write to, beside ``path``; renamed to it when all is written and on the disk.

    The caller writes a file there, or makes a folder of files, for a ``path`` that is not there.
    """
    draft = path.with_name(f".{path.name}.{uuid4().hex[:12]}.draft")
    try:
        with storage_errors(path):
            yield draft
            for file in sorted(draft.rglob("*")) if draft.is_dir() else [draft]:
                sync_folder(file) if file.is_dir() else sync_file(file)
            replace_file(draft, path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        with suppress(OSError):
            draft.unlink(missing_ok=True)


@dataclass(frozen=True)
class RunFolder:
    """The output folder of one mission, locked for this process."""

    path: Path
    _seals: dict[str, tuple[str, int]] = field(default_factory=dict)
    _in_place: set[str] = field(default_factory=set)

    @property
    def staging(self) -> Path:
        """The hidden folder that results are written to before they are committed."""
        return self.path / STAGING

    def place(self, name: str) -> Path:
        """The path in the staging folder to write a result to; its parent exists."""
        target = self.staging / name
        with storage_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        return target

    def seal(self, name: str) -> None:
        """Flush a written result to the disk, and keep its hash and size for the manifest."""
        target = self.staging / name
        with storage_errors(target):
            sync_file(target)
            self._seals[name] = (hash_file(target), target.stat().st_size)

    def leave(self, item: Mapping[str, Any]) -> None:
        """Let a visible result, as an earlier manifest has it, be one of this run too."""
        self._seals[item["name"]] = item["sha256"], item["bytes"]
        self._in_place.add(item["name"])

    def resume(self, key: str, *, anew: bool = False) -> None:
        """Go on with the parts that a run of the same key left; other ones, or all, are removed."""
        name = self.staging / _KEY
        with storage_errors(name):
            if anew or not name.is_file() or name.read_text(encoding="utf-8") != key:
                _remove(self.staging)
                self.staging.mkdir()
                with atomic_write(name) as draft:
                    draft.write_text(key, encoding="utf-8")

    def write_receipt(self, name: str, value: Any) -> None:
        """Keep a sealed part, and what is known of it, for the case that the run is interrupted."""
        receipt = self.place(f"{_RECEIPTS}/{Path(name).name}")
        with atomic_write(receipt) as draft:
            draft.write_bytes(packed((self._seals[name], value)))
        with storage_errors(receipt):
            for folder in ((self.staging / name).parent, receipt.parent):
                sync_folder(folder)

    def read_receipt(self, name: str, *, verify: bool = True) -> Any:
        """What is known of a part that is there and sealed; None where it must be made.

        Its content is compared with its hash, unless ``verify`` is False: then its size.
        """
        part, receipt = self.staging / name, self.staging / _RECEIPTS / Path(name).name
        with storage_errors(receipt):
            found = unpacked(receipt.read_bytes()) if receipt.is_file() and part.is_file() else None
            if found is None:
                return None
            seal, value = found
            if part.stat().st_size != seal[1] or (verify and hash_file(part) != seal[0]):
                return None
        self._seals[name] = seal
        return value

    def outputs(self) -> list[dict[str, str | int]]:
        """Name, hash and size of each sealed result, for the manifest."""
        return [
            {"name": name, "sha256": digest, "bytes": size}
            for name, (digest, size) in sorted(self._seals.items())
        ]

    def commit(self, manifest: dict[str, Any]) -> None:
        """Make the staged results the visible ones; the manifest comes last.

        A power cut between any two steps leaves either the old results with their manifest, or
        none: `open_folder` then finishes the removal. Therefore each step is flushed to the disk
        before the next begins.
        """
        text = json.dumps(manifest, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
        with storage_errors(self.path):
            draft = self.staging / MANIFEST
            draft.write_text(text + "\n", encoding="utf-8", newline="\n")
            sync_file(draft)
            staged = sorted(self._seals.keys() - self._in_place)
            for folder in sorted({(self.staging / name).parent for name in (*staged, MANIFEST)}):
                sync_folder(folder)
            (self.path / MANIFEST).unlink(missing_ok=True)
            sync_folder(self.path)
            for part in _parts(self.path):
                if f"{_PARTS}/{part.name}" not in self._seals:
                    part.unlink()
            for name in staged:
                target = self.path / name
                target.parent.mkdir(exist_ok=True)
                replace_file(self.staging / name, target)
            for folder in sorted({(self.path / name).parent for name in staged}):
                sync_folder(folder)
            replace_file(draft, self.path / MANIFEST)
            sync_folder(self.path)
            files = {os.path.realpath(self.path / name): self._seals[name][0] for name in staged}
            remember({file: (stamp(file), sha256) for file, sha256 in files.items()})
            _remove(self.staging)


def sync_file(path: Path) -> None:
    """Flush a file to the disk. Windows flushes only files that are open for writing."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """Flush the names in a folder to the disk, where the system can (Windows cannot)."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_file(source: Path, target: Path) -> None:
    """Rename a file over another one; on Windows again for 2 s while the target is open."""
    for attempt in range(1, _REPLACE_ATTEMPTS + 1):
        try:
            source.replace(target)
            return
        except PermissionError:
            if attempt == _REPLACE_ATTEMPTS:
                raise
            time.sleep(_REPLACE_PAUSE_S)


def _parts(path: Path) -> list[Path]:
    """The parts of the observations in a folder of results; no other files beside them."""
    return [p for p in (path / _PARTS).glob("part-*.parquet") if _PART.fullmatch(p.name)]


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()


def would_replace(folder: Path | Place, path: Path | Place) -> bool:
    """Whether a run that writes to a folder removes or replaces this file, or one of this folder.

    >>> would_replace(Path("/r"), Path("/r/observations/own.parquet"))
    True
    >>> would_replace(Path("/r"), Path("/r/flight.bin"))
    False
    """
    if isinstance(folder, Place) or isinstance(path, Place):
        if not isinstance(folder, Place) or not isinstance(path, Place):
            return False
        own = (folder / name for name in ("attempts", "runs", MANIFEST))
        return any(map(path.is_below, own)) or (path.is_folder and folder.is_below(path))
    replaced = {*_RESULTS, MANIFEST, STAGING, _LOCK}
    # A link may lie in one folder and lead to another: neither path may be among the results.
    for resolve in (os.path.abspath, os.path.realpath):
        results, file = Path(resolve(folder)), Path(resolve(path))
        if file.is_relative_to(results) and {*file.relative_to(results).parts[:1]} & replaced:
            return True
    return False


def rehearse_folder(path: Path) -> None:
    """Refuse what `open_folder` would, and a folder that cannot be written to; writes nothing."""
    exists = next(folder for folder in (path, *path.parents) if os.path.lexists(folder))
    with storage_errors(path):
        os.stat(os.path.join(exists, "."))  # NotADirectoryError where it is a file
        if not os.access(exists, os.W_OK | os.X_OK):
            raise PermissionError(EACCES, os.strerror(EACCES), str(exists))
    _refuse_links(path)
    _refuse_strangers(path)
    if (path / _LOCK).exists():
        lock_folder(path).release()


@contextmanager
def open_folder(path: Path) -> Iterator[RunFolder]:
    """Lock an output folder and remove what an interrupted run left, but for its finished parts.

    These stay, hidden, when it is interrupted or the disk refuses to write: `RunFolder.resume`
    takes them up. The lock ends with the process that holds it. Refuses a folder that another
    process writes to (OUTPUT-IN-USE), one with symbolic links in the place of results
    (STORAGE-SYMLINK), and one whose files are named like results but were written by another
    program (STORAGE-NOT-OURS).
    """
    with storage_errors(path):
        path.mkdir(parents=True, exist_ok=True)
    _refuse_links(path)
    lock = lock_folder(path)
    try:
        with storage_errors(path):
            _clear_interrupted(path, resumable=True)
            (path / STAGING).mkdir(exist_ok=True)
        resumable = False
        try:
            yield RunFolder(path)
        except (StorageError, MemoryError, KeyboardInterrupt, SystemExit):
            resumable = True
            raise
        finally:
            with suppress(OSError, StorageError):
                _clear_interrupted(path, resumable=resumable)
    finally:
        lock.release()


def _refuse_links(path: Path) -> None:
    for name in (_LOCK, STAGING, *_RESULTS, MANIFEST):
        if (path / name).is_symlink():
            raise StorageError.of("STORAGE-SYMLINK", path, name=name)


def lock_folder(path: Path) -> FileLock:
    """The lock of a folder, acquired; refuses (OUTPUT-IN-USE) one that another process has."""
    lock = FileLock(path / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise OutputInUseError.of("OUTPUT-IN-USE", path) from None
    except (OSError, NotImplementedError) as error:
        with storage_errors(path):
            if getattr(error, "errno", None) in (EACCES, EPERM, EROFS):
                raise
        raise StorageError.of("STORAGE-LOCK", path, error=error) from None
    return lock


def _refuse_strangers(path: Path) -> None:
    """Refuse files that are named like results where no manifest says whose they are."""
    results = [name for name in _RESULTS if os.path.lexists(path / name)]
    manifests = (path / MANIFEST).exists() or (path / STAGING / MANIFEST).is_file()
    if results and not manifests:
        raise StorageError.of("STORAGE-NOT-OURS", path, results=", ".join(results))


def _clear_interrupted(path: Path, *, resumable: bool) -> None:
    """Remove what is staged but for finished parts; of an interrupted commit the results too.

    Parts stay only where a run may resume; a part of an interrupted commit goes back to them.
    """
    _refuse_strangers(path)
    staging = path / STAGING
    receipts = [file.name for file in (staging / _RECEIPTS).glob("part-*")] if resumable else []
    kept = {_RECEIPTS, _KEY, _PARTS} if receipts else set()
    if not (path / MANIFEST).exists():
        # Only a commit puts a manifest into the staging folder: it began and did not end.
        for part in _parts(path):
            staged = staging / _PARTS / part.name
            if part.name in receipts and not staged.exists():
                staged.parent.mkdir(exist_ok=True)
                replace_file(part, staged)
            part.unlink(missing_ok=True)
        for name in _RESULTS:
            if name != _PARTS:
                (path / name).unlink(missing_ok=True)
        with suppress(OSError):  # not empty: it holds files of the user
            (path / _PARTS).rmdir()
        if os.path.lexists(path / _PARTS):
            # The staged manifest stays until a commit ends: it shows that the folder is unbend's.
            kept = kept | {MANIFEST}
    if not kept:
        return _remove(staging)
    for file in [
        *staging.iterdir(),
        *(staging / _PARTS).glob("*"),
        *(staging / _RECEIPTS).glob(".*"),
    ]:
        if file.name not in kept and file.name not in receipts:
            _remove(file)
    return None


def read_manifest(path: Path | Place, *, damaged: bool = False) -> dict[str, Any] | None:
    """The manifest of a run's folder; None where there is none, or ``damaged`` where it is that."""
    file = path / MANIFEST
    try:
        content = file.read()[0] if isinstance(file, Place) else file.read_bytes()
        if content is None:
            return None
        manifest = json.loads(content.decode("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        if damaged:
            return None
        raise StorageError.of("MANIFEST-UNREADABLE", str(file), error=error) from None
    outputs = manifest.get("outputs") if isinstance(manifest, dict) else None
    if (
        not isinstance(outputs, list)
        or not all(isinstance(item, dict) for item in outputs)
        or not manifest.keys() >= _MANIFEST_KEYS
        or (isinstance(path, Place) and not _ATTEMPT.fullmatch(str(manifest.get("attempt"))))
    ):
        if damaged:
            return None
        raise StorageError.of("MANIFEST-UNREADABLE/read-manifest", str(file))
    return dict(manifest)


def find_damage(path: Path | Place, manifest: dict[str, Any], *, read: bool = True) -> list[str]:
    """What is missing or changed in a run's folder, one line each; empty when nothing is.

    ``read=False`` reads no file that stayed as it was hashed, nor parts of which no hash is known;
    in object storage, where no file of an attempt is written twice, none.
    """
    damage = []
    known = {str(item["name"]) for item in manifest["outputs"]}
    if isinstance(path, Place):
        path /= f"attempts/{manifest['attempt']}"
        sizes = {name: meta["size"] for name, meta in path.objects().items()}
        present = set(sizes)
    else:
        present = {f"{_PARTS}/{p.name}" for p in (path / _PARTS).glob("part-*.parquet")}
        sizes = {name: (path / name).stat().st_size for name in known if (path / name).is_file()}
    for item in manifest["outputs"]:
        name = str(item["name"])
        if name not in sizes:
            damage.append(f"{name}: is missing")
        elif sizes[name] != item["bytes"]:
            damage.append(f"{name}: {sizes[name]} bytes, not {item['bytes']}")
        elif isinstance(path, Place):
            if read and (path / name).sha256() != item["sha256"]:
                damage.append(f"{name}: its content has changed")
        else:
            file, by_size = path / name, "/" in name and not read
            sha256 = known_hash(file) if by_size else remembered_hash(file, verify=read)
            if sha256 not in (None, item["sha256"]):
                damage.append(f"{name}: its content has changed")
    damage += [f"{name}: belongs to no run" for name in sorted(present - known)]
    return damage
