"""Copies of inputs in object storage, in the user's cache, by URL and version."""

import hashlib
import os
import shutil
from contextlib import suppress
from errno import ENOENT
from pathlib import Path
from typing import Any

from pipeline.batch.object_store.place import Place
from pipeline.caches import forget_oldest, user_cache
from pipeline.errors import InputError, storage_errors

_MOST_BYTES = 50_000_000_000
"""Kept beyond a day after their last use; what is used longest ago goes first."""

_STORE = "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AZURE_STORAGE_ACCOUNT_NAME"
"""Variables of the environment that say which store a URL leads to."""


def objects_of(place: Place) -> dict[str, dict[str, Any]]:
    """The objects of an input by their names: one, or all below a folder; FileNotFoundError."""
    if not place.is_folder:
        return {"": place.head()}
    found = {name: meta for name, meta in place.objects().items() if name}
    if not found:
        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(place))
    for name in found:
        Place.of(f"{place}/{name}")  # refuses names that would lead out of the folder
    return found


def version_of(place: Place) -> str:
    """What changes where the content of an input does, or where its URL leads to another store."""
    parts = [os.environ.get(name) for name in _STORE]
    for name, meta in sorted(objects_of(place).items()):
        changed = meta["e_tag"] or meta["last_modified"]
        parts += [name, str(changed), str(meta["version"]), str(meta["size"])]
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def copy_of(place: Place, version: str) -> Path:
    """Where the copy of a version of an input is, or will be: a path of the same name."""
    key = hashlib.sha256(f"{place}\0{version}".encode()).hexdigest()[:32]
    return Path(user_cache()) / "copies" / key / place.name


def fetched(place: Place, version: str, *, anew: bool = False) -> Path:
    """The copy of a version of an input, made where it is not there yet, or ``anew``.

    Refuses (INPUT-CHANGED) an object that changes or goes while it is read.
    """
    copy = copy_of(place, version)
    kept, draft = copy.parent, copy.parent.with_suffix(f".{os.getpid()}.draft")
    if anew:
        shutil.rmtree(kept, ignore_errors=True)
    with storage_errors(copy):
        if not copy.exists():
            try:
                for name in objects_of(place):
                    target = draft / place.name / name
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with target.open("wb") as file:
                        file.writelines((place / name).blocks())
                if version_of(place) != version:
                    raise InputError.of("INPUT-CHANGED", place, role=place.name)
                with suppress(OSError):  # another process was faster
                    draft.replace(kept)
            except FileNotFoundError:  # one was removed since
                raise InputError.of("INPUT-CHANGED", place, role=place.name) from None
            finally:
                shutil.rmtree(draft, ignore_errors=True)
            forget_oldest(str(kept.parent), _MOST_BYTES)
        os.utime(kept)
    return copy
