"""How functions are compiled: in double precision, without the interpreter's lock, and cached.

Imported with the first ray only, because importing numba costs most of a second.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numba


def _user_cache() -> str | None:
    """A folder of the user's for compiled code; never site-packages, which may be read-only."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = numba.config.CACHE_DIR or os.path.join(base, "unbend", "numba")
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_CACHE = _user_cache()


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
