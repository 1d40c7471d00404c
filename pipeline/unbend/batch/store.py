"""A run's folder: nothing visible is incomplete, one writer at a time, damage can be found.

Results are written into a hidden staging folder. When all of them are there and on the disk, the
old results are removed and the new ones renamed into their places, the manifest last. A finished
part of the observations has a receipt there, so that a run that is interrupted need not make it
again.
"""

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from errno import EACCES, EPERM, EROFS
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

from filelock import FileLock, Timeout

from unbend.batch import messages
from unbend.batch.manifest import damage_of, manifest_text, parse_manifest
from unbend.batch.other_processes import holder_in_words
from unbend.batch.receipts import packed, unpacked
from unbend.errors import StorageError, storage_errors
from unbend.ingest import hash_file
from unbend.tables.manifest.file_names import MANIFEST, REPORT
from unbend.tables.manifest.run import OutputRecord
from unbend.tables.manifest.whole import Manifest

STAGING = ".staging"
"""The hidden folder in a run's folder that results are written to."""

_LOCK = ".lock"
_KEY = "key"  # file in the staging folder with the key of the parts there, see `resume`
_RECEIPTS = "receipts"
_RECEIPT_VALUES = 2  # the seal of a part, and its counts
_PARTS = "observations"
_PART = re.compile(r"part-[0-9]{5,}\.parquet")
_RESULTS = (_PARTS, "stations.parquet", "profile.parquet", REPORT)

# Windows refuses to replace a file that a virus scanner or a viewer has open; most close it soon.
_REPLACE_ATTEMPTS = 20 if os.name == "nt" else 1
_REPLACE_PAUSE_S = 0.1


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Context with a path to write to, which is renamed to ``path`` at its end.

    The caller writes a file to that path, which may replace a file at ``path``; or makes a folder
    of files there, if nothing is at ``path``. All is flushed to the disk before it is renamed.
    After an error it is removed.
    """
    draft = path.with_name(f".{path.name}.{uuid4().hex[:12]}.draft")
    try:
        with storage_errors(path):
            yield draft
            written = sorted(draft.rglob("*")) if draft.is_dir() else [draft]
            for file in written:
                if file.is_dir():
                    sync_folder(file)
                else:
                    sync_file(file)
            replace_file(draft, path)
    finally:
        # A draft that was not renamed may be a folder or a file; one that was is gone.
        shutil.rmtree(draft, ignore_errors=True)
        with suppress(OSError):
            draft.unlink(missing_ok=True)


class Seal(NamedTuple):
    """Hash and size of a file that was written and flushed."""

    sha256: str
    size_bytes: int


@dataclass(frozen=True)
class RunFolder:
    """The output folder of one mission, locked for this process.

    ``_seals`` has the hash and size of each result in the staging folder, by its name.
    """

    path: Path
    _seals: dict[str, Seal] = field(default_factory=dict)

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
            self._seals[name] = Seal(hash_file(target), target.stat().st_size)

    def resume(self, key: str, *, anew: bool = False) -> None:
        """Keep the finished parts of an interrupted run with the same ``key``; remove any others.

        ``anew`` removes all. The key is a text with all that the content of the parts depends on.
        """
        key_file = self.staging / _KEY
        with storage_errors(key_file):
            if anew or not key_file.is_file() or key_file.read_text(encoding="utf-8") != key:
                _remove(self.staging)
                self.staging.mkdir()
                with atomic_write(key_file) as draft:
                    draft.write_text(key, encoding="utf-8")

    def write_receipt(self, name: str, value: Any) -> None:
        """Write the receipt of a sealed part: its seal and ``value``, its counts.

        With it the part stays when the run is interrupted.
        """
        receipt = self.place(f"{_RECEIPTS}/{Path(name).name}")
        with atomic_write(receipt) as draft:
            draft.write_bytes(packed((tuple(self._seals[name]), value)))
        with storage_errors(receipt):
            for folder in ((self.staging / name).parent, receipt.parent):
                sync_folder(folder)

    def read_receipt(self, name: str) -> Any:
        """The value in the receipt of a finished part; None if the part must be made.

        A part is finished if it has the size and hash of the seal in its receipt. That seal is
        kept for the manifest, as if this run had sealed the part.
        """
        part = self.staging / name
        receipt = self.staging / _RECEIPTS / part.name
        with storage_errors(receipt):
            if not receipt.is_file() or not part.is_file():
                return None
            content = unpacked(receipt.read_bytes())
            if not isinstance(content, tuple) or len(content) != _RECEIPT_VALUES:
                return None
            seal_values, value = content
            seal = Seal(*seal_values)
            if part.stat().st_size != seal.size_bytes or hash_file(part) != seal.sha256:
                return None
        self._seals[name] = seal
        return value

    def outputs(self) -> list[OutputRecord]:
        """Name, hash and size of each sealed result, for the manifest."""
        return [
            OutputRecord(name, seal.sha256, seal.size_bytes)
            for name, seal in sorted(self._seals.items())
        ]

    def commit(self, manifest: Manifest) -> None:
        """Make the staged results the visible ones; the manifest comes last.

        A power cut between any two steps leaves either the old results with their manifest, or
        none: `open_folder` then finishes the removal. Therefore each step is flushed to the disk
        before the next begins.
        """
        with storage_errors(self.path):
            # All that is new is on the disk before anything old goes.
            draft = self.staging / MANIFEST
            draft.write_text(manifest_text(manifest), encoding="utf-8", newline="\n")
            sync_file(draft)
            staged = sorted(self._seals)
            for folder in sorted({(self.staging / name).parent for name in (*staged, MANIFEST)}):
                sync_folder(folder)
            # The old manifest goes first, so that it never names results that are replaced.
            (self.path / MANIFEST).unlink(missing_ok=True)
            sync_folder(self.path)
            # Old parts that no new part replaces are removed, and the new results renamed.
            for part in _parts(self.path):
                if f"{_PARTS}/{part.name}" not in self._seals:
                    part.unlink()
            for name in staged:
                target = self.path / name
                target.parent.mkdir(exist_ok=True)
                replace_file(self.staging / name, target)
            for folder in sorted({(self.path / name).parent for name in staged}):
                sync_folder(folder)
            # With the new manifest the results are complete.
            replace_file(draft, self.path / MANIFEST)
            sync_folder(self.path)
            _remove(self.staging)

    def rewrite_manifest(self, manifest: Manifest) -> None:
        """Replace the manifest of the visible results; it is complete at any time.

        It keeps its time of change, which is that of the run.
        """
        path = self.path / MANIFEST
        before = path.stat()
        with atomic_write(path) as draft:
            draft.write_text(manifest_text(manifest), encoding="utf-8", newline="\n")
            os.utime(draft, ns=(before.st_atime_ns, before.st_mtime_ns))


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
    """Rename ``source`` to ``target``, which it replaces; on Windows retried for 2 s."""
    for attempt in range(1, _REPLACE_ATTEMPTS + 1):
        try:
            source.replace(target)
            return
        except PermissionError:
            if attempt == _REPLACE_ATTEMPTS:
                raise
            time.sleep(_REPLACE_PAUSE_S)


def _parts(path: Path) -> list[Path]:
    """The files in a folder of results that are named like parts of the observations."""
    named = (path / _PARTS).glob("part-*.parquet")
    return [part for part in named if _PART.fullmatch(part.name)]


def _remove(path: Path) -> None:
    """Remove a file, a link, or a folder with its content; do nothing if there is none."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()


def would_replace(folder: Path, path: Path) -> bool:
    """Whether a run that writes to ``folder`` removes or replaces the input at ``path``.

    >>> would_replace(Path("/r"), Path("/r/observations/own.parquet"))
    True
    >>> would_replace(Path("/r"), Path("/r/flight.bin"))
    False
    """
    replaced = {*_RESULTS, MANIFEST, STAGING, _LOCK}
    # A link may lead from one folder to another: neither its path nor its target may be a result.
    for resolve in (os.path.abspath, os.path.realpath):
        results = Path(resolve(folder))
        file = Path(resolve(path))
        if not file.is_relative_to(results):
            continue
        parts = file.relative_to(results).parts
        if parts and parts[0] in replaced:
            return True
    return False


def rehearse_folder(path: Path) -> None:
    """Refuse what `open_folder` would, and a folder that cannot be written to; write nothing."""
    # The folder itself, or the nearest parent that exists, in which it would be made.
    nearest = next(folder for folder in (path, *path.parents) if os.path.lexists(folder))
    with storage_errors(path):
        os.stat(os.path.join(nearest, "."))  # raises NotADirectoryError if `nearest` is a file
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise PermissionError(EACCES, os.strerror(EACCES), str(nearest))
    _refuse_links(path)
    _refuse_foreign_results(path)
    if (path / _LOCK).exists():
        lock_folder(path).release()


@contextmanager
def open_folder(path: Path) -> Iterator[RunFolder]:
    """Context that locks an output folder, cleared of an interrupted run except finished parts.

    Finished parts stay, hidden, when a run is interrupted or the disk refuses to write;
    `RunFolder.resume` decides whether the next run keeps them. When a run ends in another way, all
    that it staged is removed. The lock ends with the process that holds it.

    Refuses a folder that another process writes to (OUTPUT-IN-USE), one with symbolic links in the
    place of results (STORAGE-SYMLINK), and one whose files are named like results but were written
    by another program (STORAGE-NOT-OURS).
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
    """Refuse (STORAGE-SYMLINK) symbolic links in the place of results or of the lock."""
    for name in (_LOCK, STAGING, *_RESULTS, MANIFEST):
        if (path / name).is_symlink():
            raise messages.result_is_link(path=str(path), name=name)


def has_traces(path: Path) -> bool:
    """Whether a folder has a file with the name of a file that a run writes, finished or not."""
    names = (_LOCK, STAGING, *_RESULTS, MANIFEST)
    return any(os.path.lexists(path / name) for name in names)


def lock_folder(path: Path) -> FileLock:
    """The lock of a folder, acquired.

    Refuses a folder that another process has (OUTPUT-IN-USE), one that cannot be written to
    (STORAGE-WRITE), and one whose file system has no locks (STORAGE-LOCK).
    """
    lock = FileLock(path / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        file = path / _LOCK
        raise messages.output_in_use(
            path=str(path), lock=str(file), holder=holder_in_words(file)
        ) from None
    except (OSError, NotImplementedError) as error:
        if getattr(error, "errno", None) in (EACCES, EPERM, EROFS):
            with storage_errors(path):  # turns it into the refusal STORAGE-WRITE
                raise
        raise messages.folder_not_lockable(path=str(path), error=str(error)) from None
    return lock


def _refuse_foreign_results(path: Path) -> None:
    """Refuse (STORAGE-NOT-OURS) files that are named like results in a folder without a manifest.

    A manifest shows that unbend wrote them. After an interrupted commit the manifest is in the
    staging folder.
    """
    results = [name for name in _RESULTS if os.path.lexists(path / name)]
    has_manifest = (path / MANIFEST).exists() or (path / STAGING / MANIFEST).is_file()
    if results and not has_manifest:
        raise messages.files_not_ours(path=str(path), results=results)


def _clear_interrupted(path: Path, *, resumable: bool) -> None:
    """Remove staged files, and visible results that an interrupted commit left without a manifest.

    ``resumable`` keeps finished parts, which have receipts; those that an interrupted commit made
    visible are staged again.
    """
    _refuse_foreign_results(path)
    staging = path / STAGING
    receipts: set[str] = set()  # names of receipts, which are those of their parts
    if resumable:
        receipts = {file.name for file in (staging / _RECEIPTS).glob("part-*")}
    kept_names: set[str] = set()  # in the staging folder, in addition to parts with receipts
    if receipts:
        kept_names = {_RECEIPTS, _KEY, _PARTS}
    if not (path / MANIFEST).exists():
        # Visible results are then of an interrupted commit: those of others are refused above.
        _undo_commit(path, receipts)
        if os.path.lexists(path / _PARTS):
            # Files of the user are among the parts, so that their folder could not be removed. The
            # staged manifest stays until a commit ends: it shows that the folder is unbend's.
            kept_names.add(MANIFEST)
    if not kept_names:
        _remove(staging)
        return
    staged = [*staging.iterdir(), *(staging / _PARTS).glob("*")]
    staged += (staging / _RECEIPTS).glob(".*")  # drafts of receipts
    for file in staged:
        if file.name not in kept_names and file.name not in receipts:
            _remove(file)


def _undo_commit(path: Path, receipts: set[str]) -> None:
    """Remove the visible results of an interrupted commit.

    Parts with ``receipts`` (names of the parts) are moved back into the staging folder.
    """
    for part in _parts(path):
        staged = path / STAGING / _PARTS / part.name
        if part.name in receipts and not staged.exists():
            staged.parent.mkdir(exist_ok=True)
            replace_file(part, staged)
        part.unlink(missing_ok=True)  # gone already if it was staged
    for name in _RESULTS:
        if name != _PARTS:
            (path / name).unlink(missing_ok=True)
    with suppress(OSError):  # not empty: it contains files of the user
        (path / _PARTS).rmdir()


def read_manifest(path: Path, *, ignore_damaged: bool = False) -> Manifest | None:
    """The manifest of a run's folder; None without a manifest.

    A damaged manifest is refused; with ``ignore_damaged`` None is returned for it.
    """
    file = path / MANIFEST
    try:
        if file.exists() and not file.is_file():  # reading a pipe might never end
            raise messages.manifest_unreadable(path=str(file), error="it is not a file")
        try:
            content = file.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise messages.manifest_unreadable(path=str(file), error=str(error)) from None
        return parse_manifest(content, str(file))
    except StorageError:
        if ignore_damaged:
            return None
        raise


def find_damage(path: Path, manifest: Manifest, *, hash_all: bool = True) -> list[str]:
    """What is missing, changed or superfluous in a run's folder, one text each.

    Superfluous are parts of the observations that the manifest does not name; other files in the
    folder do not count. ``hash_all`` reads and hashes all results. Without it only those are read
    that changed after the manifest was written: a run writes its manifest last.
    """
    names = [item.name for item in manifest.run.outputs]
    names += [f"{_PARTS}/{part.name}" for part in (path / _PARTS).glob("part-*.parquet")]
    stats = {}
    for name in names:
        with suppress(OSError):
            stats[name] = (path / name).stat()
    sizes = {name: stat.st_size for name, stat in stats.items()}
    finished_ns = 0  # if the manifest cannot be looked at, all results count as changed after it
    with suppress(OSError):
        finished_ns = (path / MANIFEST).stat().st_mtime_ns

    def hash_of(name: str) -> str | None:
        if hash_all or stats[name].st_mtime_ns >= finished_ns:
            return hash_file(path / name)
        return None  # trusted without reading

    return damage_of(manifest, sizes, hash_of)
