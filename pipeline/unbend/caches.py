"""What only takes time to make again: compiled code, hashes, states, templates, decoded logs.

All of it lies in one folder of the user's, and none of it is a result.
"""

import json
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext, suppress
from functools import lru_cache
from typing import Any

OF_COMPILED = re.compile(r"unbend-[0-9a-f]{16}")
"""Names of the folders of compiled code, one for each state of the sources."""

_OF_VALUES = re.compile(r"\.?(log|flown)-[0-9a-f]{64}(\.\d+)?")


def user_cache() -> str:
    """The folder: ``unbend`` in XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return os.path.join(base, "unbend")


def compiled_code() -> str:
    """The folder for folders of compiled code: NUMBA_CACHE_DIR, or one in the user's cache."""
    return os.environ.get("NUMBA_CACHE_DIR") or os.path.join(user_cache(), "numba")


def parsed_templates() -> str:
    """The folder for templates of reports, parsed; names hold jinja2's version and our code."""
    return os.path.join(user_cache(), "templates")


def kept_values() -> str:
    """The folder for what logs and reports are made of."""
    return os.path.join(user_cache(), "kept")


def read_entry(name: str, key: str) -> Any:
    """What a database of the cache has under a key; None where it has, or is, nothing."""
    import sqlite3

    with suppress(sqlite3.Error, OSError, ValueError):
        query = "SELECT content FROM entries WHERE key = ?"
        if found := _database(user_cache(), name).execute(query, (key,)).fetchone():
            return json.loads(found[0])
    return None


def write_entries(name: str, entries: Mapping[str, Any], most: int) -> None:
    """Keep entries as JSON in a database, if one can be written, the ``most`` newest of them."""
    import sqlite3

    with suppress(sqlite3.Error, OSError), _database(user_cache(), name) as database:
        rows = [(key, json.dumps(content)) for key, content in entries.items()]
        database.executemany("INSERT OR REPLACE INTO entries VALUES (?, ?)", rows)
        oldest = "DELETE FROM entries WHERE rowid <= (SELECT max(rowid) FROM entries) - ?"
        database.execute(oldest, (most,))


@lru_cache(maxsize=2)
def _database(folder: str, name: str) -> Any:
    import sqlite3

    os.makedirs(folder, exist_ok=True)
    file = os.path.join(folder, name)
    database = sqlite3.connect(file, timeout=10.0, check_same_thread=False)
    database.execute("CREATE TABLE IF NOT EXISTS entries (key TEXT PRIMARY KEY, content TEXT)")
    return database


def cached() -> Iterator[tuple[str, str]]:
    """What is kept and the path of each: files and folders that exist and are ours."""
    for folder, what, ours in (
        (compiled_code(), "compiled code", OF_COMPILED),
        (user_cache(), "hashes of inputs", re.compile(r"hashes\.sqlite(-\w+)?")),
        (parsed_templates(), "templates", re.compile(r"[\w-]+\.jinja")),
        (user_cache(), "states of missions", re.compile(r"missions\.sqlite(-\w+)?")),
        (user_cache(), "copies of inputs", re.compile("copies")),
        (kept_values(), "decoded logs and figures", _OF_VALUES),
        (os.path.join(user_cache(), "results"), "results to be published", re.compile(".{32}")),
    ):
        names = sorted(os.listdir(folder)) if os.path.isdir(folder) else []
        paths = [os.path.join(folder, name) for name in names if ours.fullmatch(name)]
        yield from ((what, path) for path in paths if not in_use(path))


def in_use(folder: str) -> bool:
    """Whether a run holds the lock of a folder."""
    from filelock import FileLock, Timeout

    lock = FileLock(os.path.join(folder, ".lock"), timeout=0)
    try:
        with lock if os.path.exists(lock.lock_file) else nullcontext():
            return False
    except Timeout:
        return True


def forget_oldest(folder: str, most_bytes: int) -> None:
    """Remove from a folder what was used longest ago, beyond a size, and not within a day."""
    paths = [os.path.join(folder, name) for name in os.listdir(folder)]
    excess = sum(map(size_of, paths)) - most_bytes
    for path in sorted(paths, key=os.path.getmtime):
        if excess > 0 and time.time() - os.path.getmtime(path) > 86_400.0:
            excess -= size_of(path)
            shutil.rmtree(path, ignore_errors=True)


def size_of(path: str) -> int:
    """Bytes of a file, or of all files in a folder."""
    inside = [os.path.join(root, name) for root, _, names in os.walk(path) for name in names]
    return sum(os.path.getsize(file) for file in inside or [path])


def empty_caches() -> list[dict[str, str | int]]:
    """Remove all that is kept; what it was, where, its bytes. OSError where it stays."""
    removed: list[dict[str, str | int]] = []
    for what, path in list(cached()):
        size = size_of(path)
        if os.path.isdir(path):
            shutil.rmtree(path)
        else:
            os.remove(path)
        removed.append({"what": what, "path": path, "bytes": size})
    return removed
