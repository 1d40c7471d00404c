"""Places in object storage: which URLs name them, requests to them, and what a store refuses.

By obstore (the extra ``cloud``). No text of a store is printed, as it may hold a signature.
"""

import hashlib
import os
import re
import shutil
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from errno import ENOENT
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from unbend.caches import forget_oldest, user_cache
from unbend.errors import ConfigError, InputError, StorageError, storage_errors

_STORES = {"s3": "S3Store", "az": "AzureStore", "gs": "GCSStore"}
_BUCKET = re.compile(r"[a-z0-9][a-z0-9._-]{1,62}")
_CHUNK = 32 << 20

_PLAIN_HTTP = "AWS_ALLOW_HTTP", "AZURE_ALLOW_HTTP", "AZURE_STORAGE_USE_EMULATOR"
"""Variables of the environment that allow a store without encryption, such as one on this host."""


def is_url(text: str) -> bool:
    """Whether a path of a mission file or command is meant as a URL.

    >>> is_url("s3://flights/1.bin"), is_url("C:/flights/1.bin"), is_url("flights/1.bin")
    (True, False, False)
    """
    return re.match("[A-Za-z][A-Za-z0-9+.-]+:/", text) is not None


@dataclass(frozen=True)
class Place:
    """An object, or the common start of the names of several, in a bucket or container.

    >>> str(Place.of("s3://flights/2026/") / "manifest.json")
    's3://flights/2026/manifest.json'
    """

    scheme: str
    bucket: str
    key: str
    is_folder: bool = field(default=False, compare=False)

    @classmethod
    def of(cls, url: str) -> "Place":
        """The place of a URL; refuses (ConfigError URL-INVALID) what names none.

        A user, password, query or fragment is refused and not repeated: it may be a secret. The
        key is written as the bucket has it, without percent-encoding.
        """
        scheme, _, rest = url.partition("://")
        bucket, _, path = rest.partition("/")
        key, why = path.removesuffix("/"), ""
        shown = re.split(r"[?#]", f"{scheme}://{bucket.rpartition('@')[2]}/{key}")[0]
        if scheme not in _STORES:
            shown, why = "", f"it begins with none of {', '.join(f'{s}://' for s in _STORES)}"
        elif set("@?#") & {*bucket, *re.findall("[?#]", url)}:
            why = "it has a user, a password, a query or a fragment"
        elif not _BUCKET.fullmatch(bucket):
            why = "its bucket or container is not named by 2 to 63 of a-z, 0-9, '.', '-' and '_'"
        elif key and ({"", ".", ".."} & {*key.split("/")} or "\\" in key or not key.isprintable()):
            why = "between slashes stands nothing, '.', '..' or a backslash"
        if why:
            raise ConfigError.of("URL-INVALID", shown, why=why)
        return cls(scheme, bucket, key, path.endswith("/"))

    def __str__(self) -> str:
        return f"{self.scheme}://{self.bucket}/{self.key}".rstrip("/")

    def __truediv__(self, name: str) -> "Place":
        return Place(self.scheme, self.bucket, f"{self.key}/{name}".strip("/"))

    @property
    def name(self) -> str:
        return self.key.rpartition("/")[2] or self.bucket

    def is_below(self, other: "Place") -> bool:
        return f"{self}/".startswith(f"{other}/")

    def read(self) -> tuple[bytes | None, dict[str, Any] | None]:
        """The content of a small object, and its version for `put`; None where there is none."""
        try:
            got = ask("read", self, "get")
        except FileNotFoundError:
            return None, None
        version = {key: got.meta[key] for key in ("e_tag", "version") if got.meta[key] is not None}
        return bytes(ask("read", self, got.bytes)), version

    def put(self, content: Any, version: dict[str, Any] | str | None) -> bool:
        """Write it whole; False if the version (None: not there; "overwrite": any) is another."""
        return ask("write", self, "put", content, mode=version or "create") is not None

    def head(self) -> dict[str, Any]:
        """Size, version and time of an object; FileNotFoundError."""
        try:
            return dict(ask("read", self, "head"))
        except (FileNotFoundError, StorageError):  # that answer has no text: ask for one that has
            return dict(ask("read", self, "get").meta)

    def blocks(self) -> Iterator[bytes]:
        """The content of an object, 32 MiB at a time; refuses (INPUT-CHANGED) two versions."""
        meta = self.head()
        for start in range(0, meta["size"], _CHUNK):
            stop = min(start + _CHUNK, meta["size"])
            options = {"range": (start, stop), "if_match": meta["e_tag"]}
            got = ask("read", self, "get", options=options)
            if got is None:
                raise InputError.of("INPUT-CHANGED", self, role=self.name)
            block = bytes(ask("read", self, got.bytes))
            if len(block) != stop - start:
                raise StorageError.of("CLOUD-FAILED", self, verb="read", answer="a part of it")
            yield block

    def sha256(self) -> str:
        """The hash of an object; empty for one that is not there, or changes meanwhile."""
        digest = hashlib.sha256()
        try:
            for block in self.blocks():
                digest.update(block)
        except (FileNotFoundError, InputError):
            return ""
        return digest.hexdigest()

    def objects(self) -> dict[str, dict[str, Any]]:
        """The objects below the place, as of `head`, by the rest of their names."""
        start = f"{self.key}/" if self.key else ""
        listing = ask("list", Place(self.scheme, self.bucket, start), "list")
        listed = ask("list", self, listing.collect)
        return {str(meta["path"]).removeprefix(start): meta for meta in listed}

    def remove(self, names: Iterable[str]) -> None:
        """Remove objects below the place; one that is not there is none."""
        for name in names:
            try:
                ask("delete", self / name, "delete")
            except FileNotFoundError:
                continue


@lru_cache(maxsize=1)
def _answers() -> dict[str, dict[str, str]]:
    return tomllib.loads(
        files(__package__).joinpath("object_store_answers.toml").read_text("utf-8")
    )


@lru_cache(maxsize=64)
def open_store(scheme: str, bucket: str) -> Any:
    """The store of a bucket; what else it needs is taken from the environment."""
    from obstore import store

    # Where options are given, those of the environment are not looked at.
    plain = any(os.environ.get(name, "").lower() == "true" for name in _PLAIN_HTTP)
    options = {"timeout": "300s", "connect_timeout": "10s", "allow_http": plain}
    retries = {"max_retries": 5, "retry_timeout": timedelta(seconds=60)}
    return getattr(store, _STORES[scheme])(bucket, client_options=options, retry_config=retries)


def ask(verb: str, place: Place, call: Any, *arguments: Any, **options: Any) -> Any:
    """Call obstore by the name of its function, or something that it returned.

    None where a condition of the request does not hold; FileNotFoundError where an object is not
    there. ``verb`` is what a refusal (StorageError) says.
    """
    try:
        import obstore
        from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
    except ImportError:
        raise ConfigError.of("CLOUD-EXTRA", place) from None
    try:
        if callable(call):
            return call()
        store = open_store(place.scheme, place.bucket)
        return getattr(obstore, call)(store, place.key, *arguments, **options)
    except (AlreadyExistsError, PreconditionError):
        return None
    except (BaseError, FileNotFoundError, ValueError) as error:
        text, is_absent = str(error), isinstance(error, FileNotFoundError)
    found = re.search(r"<Code>\s*(\w+)", text) or re.search(r"status code: (\d{3})", text)
    answer = found[1] if found else "nothing"
    words, codes = _answers()["detail" if "<Code>" in text else "words"], _answers()["codes"]
    reasons = [reason for reason, known in words.items() if re.search(known, text)]
    reasons += [reason for reason, known in codes.items() if re.fullmatch(known, answer)]
    if reasons:
        raise {
            "clock": StorageError.of("CLOUD-CLOCK", place, answer=answer),
            "bucket": StorageError.of("CLOUD-BUCKET", place, answer=answer),
            "credentials": StorageError.of("CLOUD-CREDENTIALS", place, answer=answer),
            "no credentials": StorageError.of("CLOUD-CREDENTIALS/none", place, scheme=place.scheme),
            "denied": StorageError.of("CLOUD-DENIED", place, verb=verb, answer=answer),
        }[reasons[0]]
    if is_absent:
        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(place))
    raise StorageError.of("CLOUD-FAILED", place, verb=verb, answer=answer)


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
