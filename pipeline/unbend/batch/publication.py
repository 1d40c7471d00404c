"""Results in object storage: uploaded as an attempt, then published whole by one conditional write.

Below a place lie ``attempts/<uuid>/`` with the files of a run, ``runs/<fingerprint>.json``, which
the first writer of that run creates, and ``manifest.json``, which names the attempt to read. A
writer replaces the manifest only where it is still the one that was there before its run; it
publishes no attempt but its own, and so may remove that at any time before.
"""

import json
import re
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from unbend.batch.object_store import Place
from unbend.batch.store import MANIFEST, find_damage, read_manifest
from unbend.errors import OutputInUseError, StorageError, UnbendError

_OURS = re.compile(r"((?:.+/)?)(?:attempts/([0-9a-f]{32})/(.+)|runs/([0-9a-f]{64})\.json)")
_FILE = re.compile(r"(observations/part-\d{5,}|stations|profile)\.parquet|report\.html|probe")
_WAIT_S = 10.0
_NEVER = {"e_tag": '"00000000000000000000000000000000"', "version": "1"}


def rehearse_place(place: Place, *, writes: bool = False) -> None:
    """Refuse credentials that may not write, a clock that is off, a store that does not compare.

    Tried by a write that must fail; ``writes`` also writes an object and removes it.
    """
    name = f"attempts/{uuid.uuid4().hex}/probe"
    probe, content = place / name, b"written to see whether it can be; nothing reads it"
    try:
        conditional = not probe.put(content, _NEVER)
        if conditional and writes:
            conditional = probe.put(content, None) and not probe.put(content, None)
            late = abs(datetime.now(UTC) - probe.head()["last_modified"])
            if late > timedelta(minutes=15):
                raise StorageError.of("CLOUD-CLOCK", place, answer=f"off by {late}")
            place.remove([name])
        if not conditional:
            raise StorageError.of("CLOUD-UNCONDITIONAL", place)
    except UnbendError:
        with suppress(UnbendError):
            place.remove([name])
        raise


class Publication:
    """What is published at a place before a run, to be replaced by that run alone."""

    def __init__(self, place: Place, fingerprint: str) -> None:
        self._place, self._fingerprint = place, fingerprint
        self._run = place / f"runs/{fingerprint}.json"
        self._version, self._run_version = (place / MANIFEST).read()[1], self._run.read()[1]
        self._manifest = read_manifest(place, damaged=True)

    def publish(
        self, folder: Path, manifest: dict[str, Any], advance: Callable[[int], None]
    ) -> dict[str, Any]:
        """Upload the results of a folder and publish them; the manifest that is then there.

        Of several writers of the same run the first wins, and the others return its manifest.
        Refuses (OutputInUseError) where another run was published since. ``advance`` is called
        with the bytes of each file.
        """
        attempt = uuid.uuid4().hex
        own = manifest | {"attempt": attempt}
        content = json.dumps(own, indent=2, sort_keys=True, ensure_ascii=False).encode()
        try:
            for item in manifest["outputs"]:
                file = f"attempts/{attempt}/{item['name']}"
                (self._place / file).put(folder / item["name"], "overwrite")
                advance(item["bytes"])
            if damage := find_damage(self._place, own, read=False):
                answer = ", ".join(damage)
                raise StorageError.of("CLOUD-FAILED", self._place, verb="write", answer=answer)
            first = self._run.put(content, self._run_version)
            published = None if first else self.of_another_writer()
        except BaseException:
            with suppress(UnbendError):
                self._remove(attempt)
            raise
        if published is None:
            # An answer may be lost: what is there then says which was published.
            swapped = (self._place / MANIFEST).put(content, self._version)
            published = own if swapped else read_manifest(self._place) or {"attempt": ""}
        if published["attempt"] != attempt:
            self._remove(attempt)
            if published.get("fingerprint") != self._fingerprint:
                self._place.remove([f"runs/{self._fingerprint}.json"])
                raise OutputInUseError.of("OUTPUT-IN-USE/published", self._place)
        old = self._manifest or published
        if old["attempt"] != published["attempt"]:
            self._remove(old["attempt"])
            if old["fingerprint"] != self._fingerprint:
                self._place.remove([f"runs/{old['fingerprint']}.json"])
        return published

    def of_another_writer(self) -> dict[str, Any] | None:
        """The manifest of the same run by a faster writer; None where that did not publish it."""
        deadline = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline:
            now = read_manifest(self._place, damaged=True) or {"fingerprint": ""}
            if now["fingerprint"] == self._fingerprint and now != self._manifest:
                return now
            time.sleep(0.2)
        return None

    def _remove(self, attempt: str) -> None:
        of_attempt = self._place / f"attempts/{attempt}"
        of_attempt.remove(of_attempt.objects())


def remove_orphans(place: Place, *, recent: bool = False) -> tuple[list[str], int]:
    """Remove what killed runs left at a place and below it; what, and how many of them stay.

    What is of the last hour stays, except with ``recent``, and so do other programs' objects.
    """
    objects = place.objects()
    orphans: dict[str, list[str]] = {}
    kept: dict[str, tuple[str, ...]] = {}
    others: set[str] = set()
    for name in objects:
        if found := _OURS.fullmatch(name):
            start, attempt, file, run = found.groups()
            if start not in kept:  # read after the listing: what is published now stays
                now = read_manifest(place / start)
                kept[start] = () if now is None else (now["attempt"], now["fingerprint"])
            if (attempt or run) not in kept[start]:
                group = f"{start}attempts/{attempt}/" if attempt else name
                orphans.setdefault(group, []).append(name)
                content = b"" if attempt else (place / name).read()[0] or b""
                if not (
                    _FILE.fullmatch(file or "") or f'"fingerprint": "{run}"'.encode() in content
                ):
                    others.add(group)
    limit = datetime.now(UTC) - timedelta(hours=1)
    old = {
        group: names
        for group, names in orphans.items()
        if group not in others
        and (recent or max(objects[name]["last_modified"] for name in names) < limit)
    }
    for names in old.values():
        place.remove(names)
    return [f"{place}/{group}" for group in old], len(orphans.keys() - others - old.keys())
