"""Requests to object storage by obstore (the extra ``cloud``), and the refusals of a store.

Only `remote` uses this module. No text of a store is printed, as it may contain a signature.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from errno import ENOENT
from functools import lru_cache
from pathlib import Path
from typing import Any

from unbend.batch import messages
from unbend.batch.waiting import within
from unbend.errors import InputError, StorageError

_STORES = {"s3": "S3Store", "az": "AzureStore", "gs": "GCSStore"}
"""Classes of obstore by the scheme of a URL.

A scheme that obstore does not have needs more than a line here: its own requests, and its errors in
`call_store`.
"""

_BUCKET = re.compile(r"[a-z0-9][a-z0-9._-]{1,62}")

_BLOCK_BYTES = 32 << 20  # of an object that is read; no more of it is in memory at once

# Stores that are cut off accept a connection and then say nothing.
CONNECT_S = 10.0
SILENCE_S = 60.0  # without a byte of an answer
REQUEST_S = 300.0  # for a request as a whole: 32 MiB that are read, 5 MB that are written
RETRY_S = 60.0  # after which a request that failed is not repeated

_PLAIN_HTTP = ("AWS_ALLOW_HTTP", "AZURE_ALLOW_HTTP", "AZURE_STORAGE_USE_EMULATOR")
"""Variables of the environment that allow a store without encryption, such as one on this host."""

# Regular expressions of whole codes that stores answer: <Code> of S3 and Azure, or the status of
# HTTP if there is no code.
_WRONG_CLOCK = re.compile("RequestTimeTooSkewed|RequestExpired")
_NO_BUCKET = re.compile(
    "NoSuchBucket|ContainerNotFound|Invalid(Bucket|Resource)Name|PermanentRedirect"
    "|AuthorizationHeaderMalformed|ContainerBeingDeleted|AccountNotFound"
)
_WRONG_CREDENTIALS = re.compile(
    "InvalidAccessKeyId|SignatureDoesNotMatch|AuthenticationFailed|(Expired|Invalid)Token"
    "|NoAuthenticationInformation|InvalidAuthenticationInfo|401"
)
_NOT_ALLOWED = re.compile(
    r"AccessDenied|Authorization\w+|InsufficientAccountPermissions|A(ll|ccount)\w*Disabled"
    "|PublicAccessNotPermitted|403"
)

# Words in the text of an error without a code.
_OTHER_REGION = re.compile("incorrectly configured region")
_NO_CREDENTIALS = re.compile(
    r"169\.254\.169\.254|latest/api/token|token request|Account must be specified"
)

_SILENT = re.compile(r"kind: Timeout|\bTimedOut\b")

_HOST = re.compile(r"https?://(?:[^/\s@]*@)?(\[[0-9a-fA-F:]+\](?::\d+)?|[\w.-]+(?::\d+)?)")
"""The host in a URL of HTTP; of such a URL nothing else may be printed."""

# Words in Azure's error for a wrong clock, which has the code of wrong credentials.
_OLD_DATE = re.compile("[Rr]equest date header too old")


def is_url(text: str) -> bool:
    """Whether a path in a mission file or command line is a URL, valid or not.

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
    def of(cls, url: str) -> Place:
        """The place of a URL; refuses (ConfigError URL-INVALID) a URL that names no place.

        A user, password, query or fragment is refused, and left out of the message, because it may
        be a secret. The key is written as the bucket has it, without percent-encoding.
        """
        scheme, _, bucket_and_path = url.partition("://")
        bucket, _, path = bucket_and_path.partition("/")
        key = path.removesuffix("/")
        if scheme not in _STORES:
            schemes = ", ".join(f"{name}://" for name in _STORES)
            raise messages.url_invalid(url="", why=f"it begins with none of {schemes}")
        without_user = f"{scheme}://{bucket.rpartition('@')[2]}/{key}"
        mistake = _mistake_of(url, bucket, key)
        if mistake:
            without_secrets = re.split(r"[?#]", without_user)[0]
            raise messages.url_invalid(url=without_secrets, why=mistake)
        return cls(scheme, bucket, key, path.endswith("/"))

    def __str__(self) -> str:
        return f"{self.scheme}://{self.bucket}/{self.key}".rstrip("/")

    def __truediv__(self, name: str) -> Place:
        return Place(self.scheme, self.bucket, f"{self.key}/{name}".strip("/"))

    @property
    def name(self) -> str:
        """The last part of the key, or the bucket."""
        return self.key.rpartition("/")[2] or self.bucket

    def is_below(self, other: Place) -> bool:
        """Whether the place is below ``other``, or is the same."""
        return f"{self}/".startswith(f"{other}/")

    def read(self) -> tuple[bytes | None, dict[str, Any] | None]:
        """The content of a small object, and its version for `put`; both None without an object."""
        try:
            response = request("read", self, "get")
        except FileNotFoundError:
            return None, None
        version = {}
        for key in ("e_tag", "version"):
            if response.meta[key] is not None:
                version[key] = response.meta[key]
        return bytes(call_store("read", self, response.bytes)), version

    def put(self, content: Any, version: dict[str, Any] | str | None) -> bool:
        """Write an object if its present version is ``version``; False if it is not.

        ``version`` is that of `read`; None means no object, "overwrite" any version. ``content`` is
        bytes, or the path of a file.
        """
        return request("write", self, "put", content, mode=version or "create") is not None

    def head(self) -> dict[str, Any]:
        """Size, version and time of an object; raises FileNotFoundError without an object."""
        try:
            return dict(request("read", self, "head"))
        except (FileNotFoundError, StorageError) as error:
            if is_silent(error):  # GET would wait as long
                raise
            # The refusal of HEAD has no text with the reason, the refusal of GET has.
            return dict(request("read", self, "get").meta)

    def blocks(self) -> Iterator[bytes]:
        """The content of an object, 32 MiB at a time.

        Refuses (INPUT-CHANGED) an object that is written to meanwhile.
        """
        meta = self.head()
        for start in range(0, meta["size"], _BLOCK_BYTES):
            stop = min(start + _BLOCK_BYTES, meta["size"])
            options = {"range": (start, stop), "if_match": meta["e_tag"]}
            response = request("read", self, "get", options=options)
            if response is None:  # the condition is not met: the object has changed
                raise messages.input_changed(role=self.name, path=str(self))
            block = bytes(call_store("read", self, response.bytes))
            if len(block) != stop - start:
                raise messages.request_failed(url=str(self), verb="read", answer="a part of it")
            yield block

    def sha256(self) -> str:
        """The hash of an object; "" if it is missing, or changes while it is read."""
        digest = hashlib.sha256()
        try:
            for block in self.blocks():
                digest.update(block)
        except (FileNotFoundError, InputError):
            return ""
        return digest.hexdigest()

    def objects(self) -> dict[str, dict[str, Any]]:
        """Size, version and time of each object below the place, by its name relative to it."""
        start = f"{self.key}/" if self.key else ""
        listing = request("list", Place(self.scheme, self.bucket, start), "list")
        listed = call_store("list", self, listing.collect)
        return {str(meta["path"]).removeprefix(start): meta for meta in listed}

    def remove(self, names: Iterable[str]) -> None:
        """Remove objects by their names relative to the place; a missing object is ignored."""
        for name in names:
            try:
                request("delete", self / name, "delete")
            except FileNotFoundError:
                continue


def _mistake_of(url: str, bucket: str, key: str) -> str:
    """Why a URL with a known scheme is invalid; "" for a valid one."""
    if "@" in bucket or re.search("[?#]", url):
        return "it has a user, a password, a query or a fragment"
    if not _BUCKET.fullmatch(bucket):
        return (
            "the name of its bucket or container must have 2 to 63 characters of a-z, 0-9, '.', "
            "'-' and '_'"
        )
    parts = set(key.split("/"))
    if key and (parts & {"", ".", ".."} or "\\" in key or not key.isprintable()):
        return "a part between slashes is empty, '.' or '..', or has a backslash"
    return ""


@lru_cache(maxsize=64)
def open_store(scheme: str, bucket: str, *, uploads: bool = False) -> Any:
    """Obstore's store of a bucket, with credentials and region of the environment.

    With ``uploads`` it has no limit on the time without an answer: while it sends a file, no byte
    is received.
    """
    from obstore import store

    # With ``client_options`` obstore does not read this variable of the environment.
    allows_http = any(os.environ.get(name, "").lower() == "true" for name in _PLAIN_HTTP)
    options = {
        "timeout": timedelta(seconds=REQUEST_S),
        "connect_timeout": timedelta(seconds=CONNECT_S),
        "allow_http": allows_http,
    }
    if not uploads:
        options["read_timeout"] = timedelta(seconds=SILENCE_S)
    retries = {"max_retries": 5, "retry_timeout": timedelta(seconds=RETRY_S)}
    return getattr(store, _STORES[scheme])(bucket, client_options=options, retry_config=retries)


def request(verb: str, place: Place, function: str, *arguments: Any, **options: Any) -> Any:
    """Call a function of obstore for the object at ``place``.

    ``function`` is its name, ``verb`` the word for it in an error's text: read, write, list or
    delete. Returns None if a condition of the request is not met. Raises FileNotFoundError if there
    is no object, and StorageError for any other error.
    """

    def call() -> Any:
        import obstore

        uploads = any(isinstance(argument, Path) for argument in arguments)
        store = open_store(place.scheme, place.bucket, uploads=uploads)
        return getattr(obstore, function)(store, place.key, *arguments, **options)

    return call_store(verb, place, call)


def call_store(verb: str, place: Place, call: Callable[[], Any]) -> Any:
    """Call obstore, and translate its errors.

    Returns what ``call`` returns; None if a condition of the request is not met. Otherwise raises
    as `request` does, or ConfigError (CLOUD-EXTRA) if obstore is not installed.
    """
    try:
        from obstore import exceptions
    except ImportError:
        raise messages.obstore_missing(url=str(place)) from None
    began_s = time.monotonic()
    try:
        return within(None, call)  # the limits of time are those of the store
    except (exceptions.AlreadyExistsError, exceptions.PreconditionError):
        return None
    except (exceptions.BaseError, FileNotFoundError, ValueError) as error:
        text = str(error)
        refusal = refusal_of(text, verb, place, time.monotonic() - began_s)
        if refusal is None and isinstance(error, FileNotFoundError):
            raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(place)) from None
        answer = answer_in(text)
    # Raised after the handler: in it obstore's error would be printed as the cause, with its text.
    raise refusal or messages.request_failed(url=str(place), verb=verb, answer=answer)


def is_silent(error: Exception) -> bool:
    """Whether an error is the refusal for a store that does not answer (CLOUD-SILENT)."""
    return isinstance(error, StorageError) and error.code == messages.CLOUD_SILENT.name


def host_in(text: str) -> str:
    """The host of the first URL in the text of an error of obstore; "" without a URL.

    >>> host_in("Error performing GET http://127.0.0.1:9000/season/a?X-Signature=1 in 60 s")
    '127.0.0.1:9000'
    """
    match = _HOST.search(text)
    return "" if match is None else match[1]


def answer_in(text: str) -> str:
    """The code in the text of an error of obstore, or the status of HTTP; else "nothing".

    >>> answer_in("... <Code>AccessDenied</Code> ..."), answer_in("status code: 500"), answer_in("")
    ('AccessDenied', '500', 'nothing')
    """
    match = re.search(r"<Code>\s*(\w+)", text)
    if match is None:
        match = re.search(r"status code: (\d{3})", text)
    return match[1] if match else "nothing"


def refusal_of(text: str, verb: str, place: Place, waited_s: float) -> StorageError | None:
    """The refusal for the text of obstore's error; None for an error of an unknown kind.

    ``waited_s`` : how long the call took, with all its repetitions.
    """
    url = str(place)
    answer = answer_in(text)
    has_code = "<Code>" in text
    if has_code and _OLD_DATE.search(text):
        return messages.wrong_clock(url=url, answer=answer)
    if not has_code and _OTHER_REGION.search(text):
        return messages.no_bucket(url=url, answer=answer)
    if not has_code and _NO_CREDENTIALS.search(text):
        return messages.no_credentials(url=url, scheme=place.scheme)
    if not has_code and _SILENT.search(text):
        return messages.store_silent(url=url, verb=verb, host=host_in(text), seconds=waited_s)
    if _WRONG_CLOCK.fullmatch(answer):
        return messages.wrong_clock(url=url, answer=answer)
    if _NO_BUCKET.fullmatch(answer):
        return messages.no_bucket(url=url, answer=answer)
    if _WRONG_CREDENTIALS.fullmatch(answer):
        return messages.wrong_credentials(url=url, answer=answer)
    if _NOT_ALLOWED.fullmatch(answer):
        return messages.not_allowed(url=url, verb=verb, answer=answer)
    return None
