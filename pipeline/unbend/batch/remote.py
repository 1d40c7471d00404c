"""Object storage: inputs are copied from it before a run, results are published there after it.

Below the place of results are ``attempts/<uuid>/`` with the files of a run,
``runs/<fingerprint>.json``, which the first writer of that run creates, and ``manifest.json``,
which names the attempt to read. A writer replaces the manifest only if it is still the one that
was there before its run. A writer publishes only its own attempt, and so may remove this attempt at
any time before it is published.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from errno import ENOENT
from functools import partial
from pathlib import Path
from typing import Any

from unbend.batch import messages
from unbend.batch.manifest import damage_of, manifest_text, parse_manifest
from unbend.batch.object_store import Place, is_url
from unbend.batch.waiting import within
from unbend.caches import remove_oldest, user_cache_folder
from unbend.errors import UnbendError, storage_errors
from unbend.tables.manifest.file_names import MANIFEST
from unbend.tables.manifest.whole import Manifest

__all__ = ["Place", "is_url"]

# Inputs

_MOST_BYTES = 50_000_000_000
"""Bytes of copies of inputs. If there are more, copies with their last use over a day ago are
removed, the oldest use first."""

_STORE_VARIABLES = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AZURE_STORAGE_ACCOUNT_NAME")
"""Variables of the environment that say which store a URL leads to."""


@dataclass(frozen=True)
class RemoteInput:
    """An input in object storage, in one version.

    ``version`` is a hash. It differs if the content changes, or if the URL leads to another store.
    """

    place: Place
    version: str
    size_bytes: int
    mtime_ns: int

    @property
    def copy(self) -> Path:
        """The path of the copy on this machine, which may not be made yet.

        It ends with the name of the input.
        """
        key = hashlib.sha256(f"{self.place}\0{self.version}".encode()).hexdigest()[:32]
        return Path(user_cache_folder()) / "copies" / key / self.place.name


def objects_of(place: Place) -> dict[str, dict[str, Any]]:
    """Size, version and time of each object of an input, by its name below the place.

    An input that is one object has the name "". A folder has all objects below it. Raises
    FileNotFoundError if there are none.
    """
    if not place.is_folder:
        return {"": place.head()}
    objects = place.objects()
    objects.pop("", None)  # some programs write an object for the folder itself
    if not objects:
        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(place))
    for name in objects:
        Place.of(f"{place}/{name}")  # refuses names that would lead out of the folder
    return objects


def look_up(place: Place) -> RemoteInput:
    """The present version of an input in object storage; FileNotFoundError if there is none."""
    objects = objects_of(place)
    version_parts = [os.environ.get(name) for name in _STORE_VARIABLES]
    for name, meta in sorted(objects.items()):
        tag_or_time = meta["e_tag"] or meta["last_modified"]  # some stores have no tags
        version_parts += [name, str(tag_or_time), str(meta["version"]), str(meta["size"])]
    newest = max(meta["last_modified"] for meta in objects.values())
    return RemoteInput(
        place=place,
        version=hashlib.sha256(repr(version_parts).encode()).hexdigest(),
        size_bytes=sum(meta["size"] for meta in objects.values()),
        mtime_ns=int(newest.timestamp()) * 1_000_000_000,
    )


def fetch(remote: RemoteInput, *, anew: bool = False) -> Path:
    """Copy an input if it has no copy yet, with ``anew`` always; returns the path of the copy.

    Refuses (INPUT-CHANGED) an object that is changed or removed while it is read.
    """
    copy = remote.copy
    folder = copy.parent
    if anew:
        shutil.rmtree(folder, ignore_errors=True)
    with storage_errors(copy):
        if not copy.exists():
            _make_copy(remote, folder)
            remove_oldest(str(folder.parent), _MOST_BYTES)
        os.utime(folder)  # sets the time of the last use, which `remove_oldest` compares
    return copy


def _make_copy(remote: RemoteInput, folder: Path) -> None:
    """Copy the objects of an input into a folder, which appears when all are copied."""
    place = remote.place
    draft = folder.with_suffix(f".{os.getpid()}.draft")
    try:
        for name in objects_of(place):
            target = draft / place.name / name
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                file.writelines((place / name).blocks())
        refuse_changed(remote, role=place.name)
        with suppress(OSError):  # another process was faster
            draft.replace(folder)
    except FileNotFoundError:  # an object was removed after it was listed
        raise messages.input_changed(role=place.name, path=str(place)) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def refuse_changed(remote: RemoteInput, *, role: str) -> None:
    """Refuse (INPUT-CHANGED) an input that has another version now, or is gone."""
    with suppress(FileNotFoundError):
        if look_up(remote.place).version == remote.version:
            return
    raise messages.input_changed(role=role, path=str(remote.place))


# Results

_WAIT_S = 10.0
"""How long a writer waits for a faster writer of the same run to publish it."""

_CLEARING_S = 4.0
"""Time for a failed run to remove its files; an interrupted command ends within 5 s."""

_CLOCK_TOLERANCE = timedelta(minutes=15)  # stores reject the signatures of clocks beyond it

_IF_ABSENT = None  # the condition of a write that there is no object yet
_NEVER = {"e_tag": '"00000000000000000000000000000000"', "version": "1"}
"""A version that no object has."""


def read_manifest(place: Place, *, ignore_damaged: bool = False) -> Manifest | None:
    """The manifest published at a place; None without a manifest.

    A damaged manifest is refused; with ``ignore_damaged`` None is returned for it.
    """
    file = place / MANIFEST
    content = file.read()[0]
    if content is None:
        return None
    try:
        return parse_manifest(content, str(file), of_attempt=True)
    except UnbendError:
        if ignore_damaged:
            return None
        raise


def attempt_of(place: Place, manifest: Manifest) -> Place:
    """The place of the files of a published run, which its manifest names."""
    return place / f"attempts/{manifest.run.attempt}"


def copy_of_attempt(place: Place, manifest: Manifest) -> Path:
    """Copy the files of a published run; returns the folder of the copy.

    Raises FileNotFoundError if the files are gone.
    """
    attempt = Place.of(f"{attempt_of(place, manifest)}/")
    return fetch(look_up(attempt))


def find_damage(place: Place, manifest: Manifest, *, hash_all: bool = True) -> list[str]:
    """What is missing or changed among the files of a published run, one text each.

    ``hash_all`` reads and hashes all files. Without it only sizes are compared: no file of an
    attempt is written twice.
    """
    attempt = attempt_of(place, manifest)
    sizes = {name: int(meta["size"]) for name, meta in attempt.objects().items()}

    def hash_of(name: str) -> str | None:
        return (attempt / name).sha256() if hash_all else None

    return damage_of(manifest, sizes, hash_of)


def rehearse(place: Place, *, writes: bool = False) -> None:
    """Check that results can be published at a place, before a run that may take hours.

    Refuses credentials that may not write, a wrong clock, and a store that ignores the conditions
    of a write. Without ``writes`` only one write is tried, with a condition that cannot be met, and
    the clock is not checked; ``writes`` also writes an object and removes it.
    """
    name = f"attempts/{uuid.uuid4().hex}/probe"
    probe = place / name
    content = b"written to see whether it can be; nothing reads it"
    try:
        heeds_conditions = not probe.put(content, _NEVER)
        if heeds_conditions and writes:
            is_created = probe.put(content, _IF_ABSENT)
            is_created_again = probe.put(content, _IF_ABSENT)
            heeds_conditions = is_created and not is_created_again
            clock_error = abs(datetime.now(UTC) - probe.head()["last_modified"])
            if clock_error > _CLOCK_TOLERANCE:
                raise messages.wrong_clock(url=str(place), answer=f"off by {clock_error}")
            place.remove([name])
        if not heeds_conditions:
            raise messages.writes_unconditional(url=str(place))
    except BaseException:
        # Removes also a probe that the store wrote although its condition was not met.
        try_to_remove(partial(place.remove, [name]))
        raise


def try_to_remove(remove: Callable[[], None]) -> None:
    """Call ``remove``, which removes what a failed run has written, for at most four seconds.

    Its errors are ignored: `remove_leftovers` can remove later what remains.
    """
    with suppress(UnbendError, TimeoutError):
        within(_CLEARING_S, remove)


class Publication:
    """A run that will be published at a place, and what is published there before.

    The manifest at the place is replaced only if it is still the one that was there when this
    object was made.
    """

    def __init__(self, place: Place, fingerprint: str) -> None:
        self._place = place
        self._fingerprint = fingerprint
        self._run = place / run_name(fingerprint)  # the object of the first writer of this run
        # Versions of manifest and run object before this run; None if the object is not there.
        self._version = (place / MANIFEST).read()[1]
        self._run_version = self._run.read()[1]
        self._before = read_manifest(place, ignore_damaged=True)

    def publish(self, folder: Path, manifest: Manifest, advance: Callable[[int], None]) -> Manifest:
        """Upload the results of a folder and publish them; returns the manifest then published.

        If several writers make the same run, the first one publishes it, and the others return the
        manifest of the first. Refuses (OutputInUseError) if another run was published since this
        object was made. ``advance`` is called with the number of bytes of each file.
        """
        attempt = uuid.uuid4().hex
        manifest_of_attempt = manifest.with_values({"attempt": attempt})
        content = manifest_text(manifest_of_attempt).encode()
        by_another: Manifest | None = None
        try:
            self._upload(folder, manifest_of_attempt, advance)
            is_first = self._run.put(content, self._run_version)
            if not is_first:
                by_another = self._published_by_another_writer()
        except BaseException:
            try_to_remove(partial(self._remove, attempt))
            raise
        published = by_another
        if by_another is None:
            # This writer is the first, or the first one did not publish in time. The attempt is not
            # removed if the next step fails: it may be published already.
            published = self._replace_manifest(manifest_of_attempt, content)
        is_own = published is not None and published.run.attempt == attempt
        if not is_own:
            self._remove(attempt)
        if published is None or published.run.fingerprint != self._fingerprint:
            # This run is refused. Its run object would make later writers of it wait in vain.
            self._place.remove([run_name(self._fingerprint)])
            raise messages.published_meanwhile(url=str(self._place))
        self._remove_previous(published)
        return published

    def _replace_manifest(self, manifest: Manifest, content: bytes) -> Manifest | None:
        """Publish a manifest, if the one from before this run is still at the place.

        Returns the manifest that is then at the place, this or another; None if there is none.
        ``content`` is ``manifest`` as bytes.
        """
        if not (self._place / MANIFEST).put(content, self._version):
            # Refused; or written, but the answer was lost. The manifest at the place shows which.
            return read_manifest(self._place)
        return manifest

    def _upload(self, folder: Path, manifest: Manifest, advance: Callable[[int], None]) -> None:
        """Write the results of a folder below the attempt of a manifest, and check their sizes."""
        attempt = attempt_of(self._place, manifest)
        for item in manifest.run.outputs:
            (attempt / item.name).put(folder / item.name, "overwrite")
            advance(item.bytes)
        damage = find_damage(self._place, manifest, hash_all=False)
        if damage:
            raise messages.request_failed(
                url=str(self._place), verb="write", answer=", ".join(damage)
            )

    def _published_by_another_writer(self) -> Manifest | None:
        """Wait for the manifest of the same run by a faster writer; None if none comes in 10 s.

        The manifest from before this run does not count, although it may be of the same run.
        """
        deadline = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline:
            now = read_manifest(self._place, ignore_damaged=True)
            is_same_run = now is not None and now.run.fingerprint == self._fingerprint
            if is_same_run and now != self._before:
                return now
            time.sleep(0.2)
        return None

    def _remove_previous(self, published: Manifest) -> None:
        """Remove the files of the run that was published before, unless it is ``published`` now."""
        before = self._before
        if before is None or before.run.attempt == published.run.attempt:
            return
        self._remove(before.run.attempt)
        if before.run.fingerprint != self._fingerprint:
            self._place.remove([run_name(before.run.fingerprint)])

    def _remove(self, attempt: str) -> None:
        """Remove the files of an attempt."""
        files = self._place / f"attempts/{attempt}"
        files.remove(files.objects())


def run_name(fingerprint: str) -> str:
    """The name of the object that the first writer of a run creates."""
    return f"runs/{fingerprint}.json"


def would_replace(output: Place, place: Place) -> bool:
    """Whether a run that publishes at ``output`` would replace the input at ``place``.

    The input is an object or a folder. Also True if the run would write into that folder.
    """
    if place.is_folder and output.is_below(place):
        return True
    return any(place.is_below(output / name) for name in ("attempts", "runs", MANIFEST))


_OBJECT_OF_A_RUN = re.compile(
    r"(?P<start>(?:.+/)?)"
    r"(?:attempts/(?P<attempt>[0-9a-f]{32})/(?P<file>.+)|runs/(?P<run>[0-9a-f]{64})\.json)"
)
"""Names, below a place, of the objects that runs publish: files of attempts, and run objects."""

_FILE_OF_AN_ATTEMPT = re.compile(
    r"(observations/part-\d{5,}|stations|profile)\.parquet|report\.html|probe"
)
_YOUNG = timedelta(hours=1)  # up to this age an upload may still go on


class _Leftovers:
    """Attempts and run objects below a place that no published manifest names.

    ``objects`` : size, version and time of all objects below the place, by name. ``groups`` : the
    names of the objects of each attempt or run object, by its own name. A group with an object that
    no run writes belongs to another program, and is left out.
    """

    def __init__(self, place: Place) -> None:
        self.objects = place.objects()
        self.groups: dict[str, list[str]] = {}
        self._place = place
        self._published: dict[str, tuple[str, ...]] = {}
        foreign: set[str] = set()
        for name in self.objects:
            match = _OBJECT_OF_A_RUN.fullmatch(name)
            if match is None or self._is_published(match):
                continue
            group = name  # of the record of a run (runs/....json), which is one object
            if match["attempt"]:
                group = f"{match['start']}attempts/{match['attempt']}/"
            self.groups.setdefault(group, []).append(name)
            if not self._is_of_this_program(name, match):
                foreign.add(group)
        for group in foreign:
            del self.groups[group]

    def _is_published(self, match: re.Match[str]) -> bool:
        """Whether a published manifest names the attempt or the run of an object.

        ``match`` is that of its name with `_OBJECT_OF_A_RUN`. The manifest is read after the
        objects were listed, so that it names all that are in use.
        """
        start = match["start"]
        if start not in self._published:
            manifest = read_manifest(self._place / start)
            names = () if manifest is None else (manifest.run.attempt, manifest.run.fingerprint)
            self._published[start] = names
        return (match["attempt"] or match["run"]) in self._published[start]

    def _is_of_this_program(self, name: str, match: re.Match[str]) -> bool:
        """Whether a run of this program wrote an object; ``match`` is that of its name.

        A file of an attempt is recognised by its name, a run object by its content.
        """
        if match["attempt"]:
            return _FILE_OF_AN_ATTEMPT.fullmatch(match["file"]) is not None
        content = (self._place / name).read()[0] or b""
        return f'"fingerprint": "{match["run"]}"'.encode() in content

    def is_young(self, group: str) -> bool:
        """Whether an object of a group was written within the last hour."""
        newest: datetime = max(self.objects[name]["last_modified"] for name in self.groups[group])
        return newest >= datetime.now(UTC) - _YOUNG


def remove_leftovers(place: Place, *, recent: bool = False) -> tuple[list[str], int]:
    """Remove what killed runs left at a place and below it.

    Leftovers of the last hour stay, because their run may go on; ``recent`` removes them, too.
    Returns the URLs of the removed leftovers, and the number of those that stay. Objects of other
    programs stay, and are not counted.
    """
    leftovers = _Leftovers(place)
    removed = []
    kept = 0
    for group, names in leftovers.groups.items():
        if not recent and leftovers.is_young(group):
            kept += 1
        else:
            place.remove(names)
            removed.append(f"{place}/{group}")
    return removed, kept
