"""How functions become kernels: compiled by numba at their first call, and kept in files.

Compiled in double precision, without fused or reordered operations, and without the lock of
Python. Importing a module of kernels imports numba, which takes half a second of CPU: callers
import theirs where they call them.

numba compares what it kept with the file of the kernel alone, though functions of other files are
compiled in. So the files lie in a folder that is named after all sources that may be.
"""

import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba.core import event

from unbend.caches import OF_COMPILED, compiled_code

ROOM = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
COMPILED_FOLDERS = ("camera", "kernels")  # of that room
COMPILED_FILES = ("status_codes.py",)
UNUSED_FOR_S = 7 * 86_400.0  # the folder of other sources is then removed
COMPILED_WITHIN_S = 300.0  # the slowest takes 15 s; another process may be stopped

# Division by zero gives infinity or NaN, as in numpy.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}

COMPILING: list[str] = []
"""Names of the functions that are being compiled, for whoever shows progress."""

_DECORATING = threading.Lock()


class _NoteOfCompiling(event.Listener):  # type: ignore[misc]
    """Keeps `COMPILING`; numba tells it when it compiles, but not when it loads what it kept."""

    def on_start(self, event: Any) -> None:
        COMPILING.append(event.data["dispatcher"].__name__)

    def on_end(self, event: Any) -> None:
        COMPILING.pop()


event.register("numba:compile", _NoteOfCompiling())


def compiled_sources(room: str = ROOM) -> list[str]:
    """Paths, within a room, of every source that may be compiled in."""
    names = list(COMPILED_FILES)
    for folder in COMPILED_FOLDERS:
        for name in sorted(os.listdir(os.path.join(room, folder))):
            if name.endswith(".py"):
                names.append(f"{folder}/{name}")
    return names


def source_hash(room: str = ROOM) -> str:
    """16 hexadecimal digits of the compiler's version and every source: 1 ms."""
    digest = sha256(f"{numba.__version__} {version('llvmlite')}".encode())
    for name in compiled_sources(room):
        with open(os.path.join(room, name), "rb") as source:
            digest.update(f"\0{name}\0".encode())
            digest.update(source.read())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def cache_folder() -> str | None:
    """The folder for compiled code of these sources, or None where nothing can be written.

    In ``NUMBA_CACHE_DIR`` or the user's cache; never site-packages, which may be read-only. Folders
    of other sources that were not used for a week are removed; a process that still uses one
    compiles again.
    """
    base = compiled_code()
    folder = os.path.join(base, f"unbend-{source_hash()}")
    try:
        os.makedirs(folder, exist_ok=True)
        os.utime(folder)  # the time of the last use
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    with suppress(OSError):  # another process removes them at this moment
        _remove_unused(base, folder)
    return folder


def _remove_unused(base: str, current: str) -> None:
    """Remove our folders of other sources that were not used for a week."""
    for name in os.listdir(base):
        path = os.path.join(base, name)
        if path == current or not OF_COMPILED.fullmatch(name):
            continue
        if time.time() - os.stat(path).st_mtime > UNUSED_FOR_S:
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def _caching_in(folder: str) -> Iterator[None]:
    """Let numba keep in a folder what is decorated meanwhile; the user's own functions not."""
    with _DECORATING:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = folder
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call."""
    compiled: Callable[..., Any] = numba.njit(
        no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS
    )(function)
    return compiled


def within(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function compiled as a part of the one that calls it; each level takes time."""
    compiled: Callable[..., Any] = numba.njit(inline="always", **OPTIONS)(function)
    return compiled


class _CompilesAlone:
    """What compiles or loads a kernel in the place of its dispatcher's ``compile``, under a lock.

    numba numbers the files of a function as it finds them, so two processes that compile it for
    two types of arguments at the same time may each be given the code of the other.
    """

    def __init__(
        self,
        compile_kept: Callable[..., object],
        compile_in_memory: Callable[..., object],
        lock_file: str,
    ) -> None:
        self._compile_kept = compile_kept
        self._compile_in_memory = compile_in_memory
        self._lock_file = lock_file
        self._patience_s = COMPILED_WITHIN_S

    def __call__(self, types: object) -> object:
        """The code for types of arguments; without the lock it is in memory alone."""
        lock = FileLock(self._lock_file, timeout=self._patience_s)
        try:
            lock.acquire()
        except (OSError, Timeout):
            self._patience_s = 0.0  # no further call waits for a process that is stopped
            return self._compile_in_memory(types)
        try:
            return self._compile_kept(types)
        finally:
            lock.release()


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that Python calls: compiled at its first call, unless it was kept."""
    kernel: Any = numba.njit(**OPTIONS)(function)
    folder = cache_folder()
    if folder is not None:
        in_memory = kernel
        with _caching_in(folder):
            kernel = numba.njit(cache=True, **OPTIONS)(function)
        lock_file = os.path.join(folder, f"{function.__name__}.lock")
        kernel.compile = _CompilesAlone(kernel.compile, in_memory.compile, lock_file)
    dispatcher: Callable[..., Any] = kernel
    return dispatcher
