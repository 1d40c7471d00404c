"""How functions become kernels: compiled by numba at their first call, and kept in files.

Compiled in double precision, without fused or reordered operations, and without the lock of
Python. Importing a module of kernels imports numba, which takes half a second of CPU: callers
import theirs where they call them.

numba takes a kernel that it kept if the file of that kernel has not changed, though functions of
other files are compiled into it. So what it keeps lies in a folder whose name is a hash of all
sources that may be compiled into a kernel.
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
from numba.core.event import Listener, register

from unbend.caches import COMPILED_FOLDER, compiled_code_folder

PACKAGE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
COMPILED_FOLDERS = ("camera", "kernels")  # of that package
COMPILED_FILES = ("status_codes.py",)
UNUSED_FOR_S = 7 * 86_400.0  # the folder of other sources is then removed
COMPILED_WITHIN_S = 300.0  # the slowest takes 15 s; another process may be stopped

# Division by zero gives infinity or NaN, as in numpy.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}

COMPILING: list[str] = []
"""Names of the functions that are being compiled, for whoever shows progress."""

_DECORATING = threading.Lock()


class _NoteOfCompiling(Listener):  # type: ignore[misc]
    """Keeps `COMPILING`: numba calls it when it compiles, but not when it loads what it kept."""

    def on_start(self, event: Any) -> None:
        COMPILING.append(event.data["dispatcher"].__name__)

    def on_end(self, event: Any) -> None:
        COMPILING.pop()


register("numba:compile", _NoteOfCompiling())


def compiled_sources(package: str = PACKAGE) -> list[str]:
    """Paths, within a package, of every source that may be compiled in."""
    names = list(COMPILED_FILES)
    for folder in COMPILED_FOLDERS:
        for name in sorted(os.listdir(os.path.join(package, folder))):
            if name.endswith(".py"):
                names.append(f"{folder}/{name}")
    return names


def source_hash(package: str = PACKAGE) -> str:
    """16 hexadecimal digits of the compiler's version and every source: 1 ms."""
    digest = sha256(f"{numba.__version__} {version('llvmlite')}".encode())
    for name in compiled_sources(package):
        with open(os.path.join(package, name), "rb") as source:
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
    base = compiled_code_folder()
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
        if path == current or not COMPILED_FOLDER.fullmatch(name):
            continue
        if time.time() - os.stat(path).st_mtime > UNUSED_FOR_S:
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def _caching_in(folder: str) -> Iterator[None]:
    """Let numba keep in a folder what is decorated inside this context.

    Afterwards its setting is what it was: the user's own functions are kept where the user says.
    """
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
    """A function that is compiled as a part of each function that calls it.

    Loops in it are then optimized with what the caller knows. Each level of such functions makes
    compiling slower.
    """
    compiled: Callable[..., Any] = numba.njit(inline="always", **OPTIONS)(function)
    return compiled


class _CompilesAlone:
    """Compiles or loads a kernel under a lock, in the place of its dispatcher's ``compile``.

    numba numbers the files of a function as it finds them. Without a lock two processes that
    compile it at the same time, for two types of arguments, may each be given the other's code.
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
        """The code for types of arguments; kept in memory alone where the lock is not to be had."""
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
    """A function that Python calls: compiled at its first call, or loaded if it was kept."""
    in_memory: Any = numba.njit(**OPTIONS)(function)
    dispatcher: Callable[..., Any] = in_memory
    folder = cache_folder()
    if folder is not None:
        with _caching_in(folder):
            kept: Any = numba.njit(cache=True, **OPTIONS)(function)
        lock_file = os.path.join(folder, f"{function.__name__}.lock")
        kept.compile = _CompilesAlone(kept.compile, in_memory.compile, lock_file)
        dispatcher = kept
    return dispatcher
