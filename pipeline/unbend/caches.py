"""Folders for what can be made again: compiled code, parsed templates, copies of inputs.

By default all are in one folder of the user, and none of them contains results.
"""

import os
import re
import shutil
import time

COMPILED_FOLDER = re.compile(r"unbend-[0-9a-f]{16}")
"""Pattern of the names of folders of compiled code; there is one for each state of the sources."""

_DAY_S = 86_400.0


def user_cache_folder() -> str:
    """The folder of all caches of this user: ``unbend`` in XDG_CACHE_HOME, or in ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    if not base:
        base = os.path.expanduser("~/.cache")
    return os.path.join(base, "unbend")


def compiled_code_folder() -> str:
    """The folder that contains folders of compiled code: NUMBA_CACHE_DIR, or one in the cache."""
    return os.environ.get("NUMBA_CACHE_DIR") or os.path.join(user_cache_folder(), "numba")


def parsed_templates_folder() -> str:
    """The folder for templates of reports, parsed; names hold jinja2's version and our code."""
    return os.path.join(user_cache_folder(), "templates")


def remove_oldest(folder: str, most_bytes: int) -> None:
    """Remove the oldest entries of a folder, until at most ``most_bytes`` are left.

    Entries are files and folders, and their age counts from their last change. Those of the last
    day stay, also in a folder that is too large.
    """
    paths = [os.path.join(folder, name) for name in os.listdir(folder)]
    excess_bytes = sum(map(size_of, paths)) - most_bytes
    for path in sorted(paths, key=os.path.getmtime):
        age_s = time.time() - os.path.getmtime(path)
        if excess_bytes > 0 and age_s > _DAY_S:
            excess_bytes -= size_of(path)
            shutil.rmtree(path, ignore_errors=True)


def size_of(path: str) -> int:
    """Bytes of a file, or of all files in a folder."""
    if os.path.isfile(path):
        return os.path.getsize(path)
    size = 0
    for root, _, names in os.walk(path):
        for name in names:
            inner = os.path.join(root, name)
            size += os.path.getsize(inner)
    return size
