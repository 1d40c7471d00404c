"""What only takes time to make again: compiled code, templates, copies of inputs.

All of it lies in one folder of the user's, and none of it is a result.
"""

import os
import re
import shutil
import time

OF_COMPILED = re.compile(r"unbend-[0-9a-f]{16}")
"""Names of the folders of compiled code, one for each state of the sources."""

_DAY_S = 86_400.0


def user_cache() -> str:
    """The folder: ``unbend`` in XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    if not base:
        base = os.path.expanduser("~/.cache")
    return os.path.join(base, "unbend")


def compiled_code() -> str:
    """The folder for folders of compiled code: NUMBA_CACHE_DIR, or one in the user's cache."""
    return os.environ.get("NUMBA_CACHE_DIR") or os.path.join(user_cache(), "numba")


def parsed_templates() -> str:
    """The folder for templates of reports, parsed; names hold jinja2's version and our code."""
    return os.path.join(user_cache(), "templates")


def forget_oldest(folder: str, most_bytes: int) -> None:
    """Remove from a folder what was used longest ago, beyond a size, and not within a day."""
    paths = [os.path.join(folder, name) for name in os.listdir(folder)]
    excess = sum(map(size_of, paths)) - most_bytes
    for path in sorted(paths, key=os.path.getmtime):
        age_s = time.time() - os.path.getmtime(path)
        if excess > 0 and age_s > _DAY_S:
            excess -= size_of(path)
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
