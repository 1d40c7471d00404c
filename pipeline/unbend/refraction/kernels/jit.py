"""How functions become kernels: compiled by numba at their first call, and kept in files.

Compiled in double precision, without fused or reordered operations, and without the lock of
Python. Importing a module of kernels imports numba, which takes half a second of CPU: callers
import theirs where they call them.

numba loads a kernel from its cache if the file of that kernel has not changed, though functions of
other files are compiled into it. So the cache is a folder with a name that is a hash of all sources
that may be compiled into a kernel.
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
UNUSED_FOR_S = 7 * 86_400.0  # a folder of other sources that was not used for so long is removed
# Longest wait for another process that compiles: the slowest kernel takes 15 s, and the process may
# be stopped.
COMPILED_WITHIN_S = 300.0

# Division by zero gives infinity or NaN, as in numpy.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}

COMPILING: list[str] = []
"""Names of the functions that are being compiled now, innermost last; a display of progress reads
them."""

_DECORATING = threading.Lock()


class _CompilingListener(Listener):  # type: ignore[misc]
    """Keeps `COMPILING` up to date.

    numba calls the listener when it compiles a function, not when it loads one from the cache.
    """

    def on_start(self, event: Any) -> None:
        """Add the function that numba begins to compile."""
        COMPILING.append(event.data["dispatcher"].__name__)

    def on_end(self, event: Any) -> None:
        """Remove the function that numba has compiled, the last that was added."""
        COMPILING.pop()


register("numba:compile", _CompilingListener())


def compiled_sources(package: str = PACKAGE) -> list[str]:
    """Paths, relative to the folder ``package``, of all sources that may be compiled in kernels."""
    names = list(COMPILED_FILES)
    for folder in COMPILED_FOLDERS:
        for name in sorted(os.listdir(os.path.join(package, folder))):
            if name.endswith(".py"):
                names.append(f"{folder}/{name}")
    return names


def source_hash(package: str = PACKAGE) -> str:
    """Hash of the compiler's versions and all `compiled_sources`, 16 hexadecimal digits.

    ``package`` is the folder of the sources. It takes 1 ms.
    """
    digest = sha256(f"{numba.__version__} {version('llvmlite')}".encode())
    for name in compiled_sources(package):
        with open(os.path.join(package, name), "rb") as source:
            digest.update(f"\0{name}\0".encode())
            digest.update(source.read())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def cache_folder() -> str | None:
    """Path of the cache for the compiled code of these sources; None if it cannot be written.

    The folder is made in ``NUMBA_CACHE_DIR`` or the user's cache, not in site-packages, which may
    be read-only. Folders of other sources that were not used for a week are removed; a process that
    still uses one compiles again.
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
    """Remove this package's folders in ``base`` that were not used for a week, except ``current``.

    The arguments are paths. Raises `OSError` where another process removes a folder first.
    """
    for name in os.listdir(base):
        path = os.path.join(base, name)
        if path == current or not COMPILED_FOLDER.fullmatch(name):
            continue
        if time.time() - os.stat(path).st_mtime > UNUSED_FOR_S:
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def _caching_in(folder: str) -> Iterator[None]:
    """Context in which the functions that are decorated get ``folder`` as numba's cache.

    Afterwards numba's setting is restored: the user's functions are cached where the user wants.
    """
    with _DECORATING:
        previous_folder = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = folder
        try:
            yield
        finally:
            numba.config.CACHE_DIR = previous_folder


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: compiles a function that only compiled functions call."""
    compiled: Callable[..., Any] = numba.njit(
        no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS
    )(function)
    return compiled


def within(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: inlines a function into each compiled function that calls it.

    Its loops are then optimized together with the code of the caller. Each level of such functions
    makes compiling slower.
    """
    compiled: Callable[..., Any] = numba.njit(inline="always", **OPTIONS)(function)
    return compiled


class _CompileUnderLock:
    """Compiles or loads a kernel under a lock; replaces the ``compile`` of its numba dispatcher.

    numba numbers the cached files of a function in the order in which they are made. Without a lock
    two processes that compile the function at the same time, for two types of arguments, may each
    load the other's code.
    """

    def __init__(
        self,
        compile_cached: Callable[..., object],
        compile_in_memory: Callable[..., object],
        lock_file: str,
    ) -> None:
        self._compile_cached = compile_cached
        self._compile_in_memory = compile_in_memory
        self._lock_file = lock_file
        self._longest_wait_s = COMPILED_WITHIN_S

    def __call__(self, types: object) -> object:
        """The code for types of arguments, from the cache or compiled.

        Without the lock it is compiled and not cached.
        """
        lock = FileLock(self._lock_file, timeout=self._longest_wait_s)
        try:
            lock.acquire()
        except (OSError, Timeout):
            self._longest_wait_s = 0.0  # no further call waits for a process that is stopped
            return self._compile_in_memory(types)
        try:
            return self._compile_cached(types)
        finally:
            lock.release()


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: a kernel that Python calls, compiled at its first call or loaded from the cache.

    Where the cache cannot be written, each process compiles it again.
    """
    in_memory: Any = numba.njit(**OPTIONS)(function)
    dispatcher: Callable[..., Any] = in_memory
    folder = cache_folder()
    if folder is not None:
        with _caching_in(folder):
            cached: Any = numba.njit(cache=True, **OPTIONS)(function)
        lock_file = os.path.join(folder, f"{function.__name__}.lock")
        cached.compile = _CompileUnderLock(cached.compile, in_memory.compile, lock_file)
        dispatcher = cached
    return dispatcher
