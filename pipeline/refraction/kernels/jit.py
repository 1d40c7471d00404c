"""How functions are compiled: in double precision, without the interpreter's lock, and cached.

Imported with the first ray only, because importing numba costs most of a second. numba compares the
file of a cached function with the source, but not the files of the functions it calls; so the cache
is a folder named after the hash of all sources that may be compiled in.
"""

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from typing import Any

import numba

from pipeline.caches import OF_COMPILED, compiled_code

_ROOM = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_KEPT_S = 7 * 86_400.0  # unused this long, the folder of another version is removed


def source_hash(room: str = _ROOM) -> str:
    """16 hexadecimal digits for numba's version and every source that may be compiled in.

    Those are the modules in the folders kernels and camera of ``room``, and status_codes: 1 ms.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    names = [
        f"{folder}/{name}"
        for folder in ("camera", "kernels")
        for name in sorted(os.listdir(os.path.join(room, folder)))
        if name.endswith(".py")
    ]
    for name in (*names, "status_codes.py"):
        with open(os.path.join(room, name), "rb") as source:
            digest.update(f"\0{name}\0".encode() + source.read())
    return digest.hexdigest()[:16]


def cache_folder() -> str | None:
    """The folder for compiled code of these sources, or None where nothing can be written.

    In ``NUMBA_CACHE_DIR`` or the user's cache; never site-packages, which may be read-only. Folders
    of other sources that were not used for a week are removed; a process that still uses one
    compiles again.
    """
    base = numba.config.CACHE_DIR or compiled_code()
    try:
        folder = os.path.join(base, f"unbend-{source_hash()}")
        os.makedirs(folder, exist_ok=True)
        os.utime(folder)  # the time of the last use
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    try:
        with os.scandir(base) as entries:
            unused = [
                entry.path
                for entry in entries
                if OF_COMPILED.fullmatch(entry.name)
                and entry.path != folder
                and time.time() - entry.stat().st_mtime > _KEPT_S
            ]
    except OSError:  # another process removes them at this moment
        unused = []
    for path in unused:
        shutil.rmtree(path, ignore_errors=True)
    return folder


_CACHE = cache_folder()


def _compiled(function: Callable[..., Any], cache: bool, **options: Any) -> Callable[..., Any]:
    # numba looks for the folder when a function is decorated; others in this process keep theirs.
    theirs, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE or ""
    try:
        compiled: Callable[..., Any] = numba.njit(
            cache=cache and _CACHE is not None,
            error_model="numpy",
            nogil=True,
            no_cfunc_wrapper=True,
            **options,
        )(function)
        return compiled
    finally:
        numba.config.CACHE_DIR = theirs


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that only compiled ones call; without wrappers, which take time."""
    return _compiled(function, cache=False, no_cpython_wrapper=True)


def within(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function as a part of the compiled one that calls it; each level takes time."""
    return _compiled(function, cache=False, inline="always")


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that Python calls; at its first call, or load it from the cache."""
    return _compiled(function, cache=True)
