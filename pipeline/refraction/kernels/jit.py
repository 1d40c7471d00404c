"""How kernels run: interpreted while little is asked of them, else compiled, and cached.

Both give the same digits, bit for bit: compiled in double precision, without fused or reordered
operations, and interpreted with the functions of the C library that compiled code calls. numba is
imported with the first kernel that is compiled or loaded, because that takes half a second.

numba compares the file of a cached function with the source, but not the files of the functions
it calls; so the cache is a folder named after the hash of all sources that may be compiled in.
"""

import hashlib
import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, lru_cache
from importlib.metadata import version
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from pipeline.caches import OF_COMPILED, compiled_code

_ROOM = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_KEPT_S = 7 * 86_400.0  # unused this long, the folder of another version is removed
_LOADED = 0.1  # of the rows worth compiling a kernel for: worth loading it

_OPTIONS: dict[Callable[..., Any], dict[str, Any]] = {}
"""Functions that kernels call, with the options to compile each with."""

_LINKING = threading.RLock()


def source_hash(room: str = _ROOM) -> str:
    """16 hexadecimal digits for numba's version and every source that may be compiled in.

    Those are the modules in the folders kernels and camera of ``room``, and status_codes: 1 ms.
    """
    digest = hashlib.sha256(version("numba").encode())
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


@lru_cache(maxsize=1)
def cache_folder() -> str | None:
    """The folder for compiled code of these sources, or None where nothing can be written.

    In ``NUMBA_CACHE_DIR`` or the user's cache; never site-packages, which may be read-only. Folders
    of other sources that were not used for a week are removed; a process that still uses one
    compiles again.
    """
    base = compiled_code()
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


def _of_libm(function: Callable[..., float]) -> Callable[..., Any]:
    """A function of the C library as compiled code has it: NaN where it has no value."""

    def called(*arguments: float) -> Any:
        try:
            return np.float64(function(*arguments))
        except ValueError:
            return np.float64(math.nan)

    return called


_MATH = SimpleNamespace(nan=math.nan, inf=math.inf, isnan=math.isnan, isfinite=math.isfinite,
                        copysign=math.copysign, hypot=np.hypot)  # fmt: skip
vars(_MATH).update(
    (name, _of_libm(getattr(math, name)))
    for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2")
)
# What models of cameras call by numpy's names, whose vectors have other last digits.
_NUMPY = SimpleNamespace(**{**vars(np), "sqrt": _MATH.sqrt, "arctan": _MATH.atan})


class OfType:
    """A function that kernels call, chosen by the type of its third argument."""

    def __init__(self, choose: Callable[[type], Callable[..., Any]]) -> None:
        self.choose = choose

    def __call__(self, u: Any, v: Any, parameters: Any) -> Any:
        """Call the one for the parameters, interpreted."""
        return _linked(self.choose(type(parameters)), False)(u, v, parameters)

    def compiled(self) -> Callable[..., Any]:
        """What numba replaces by the one for the parameters."""
        from numba.extending import overload

        def function(u: Any, v: Any, parameters: Any) -> Any:
            raise NotImplementedError

        def chosen(u, v, parameters):  # type: ignore[no-untyped-def]
            called = _linked(self.choose(parameters.instance_class), True)
            return lambda u, v, parameters: called(u, v, parameters)

        overload(function)(chosen)
        return function


@cache
def _linked(function: Any, compiled: bool, cache: bool = False) -> Callable[..., Any]:
    """A copy of a function that calls compiled functions, or interpreted ones, in its module."""
    if isinstance(function, OfType):
        return function.compiled() if compiled else function
    within = function.__globals__
    names: dict[str, Any] = {} if compiled else {"math": _MATH, "np": _NUMPY}
    for name in function.__code__.co_names:
        value = within.get(name)
        if isinstance(value, OfType) or (isinstance(value, FunctionType) and value in _OPTIONS):
            names[name] = _linked(value, compiled)
    copy = FunctionType(
        function.__code__, {**within, **names}, function.__name__, function.__defaults__
    )
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    if not compiled:
        return copy
    import numba

    # numba looks for the folder when a function is decorated; others in this process keep theirs.
    folder = cache_folder()
    theirs, numba.config.CACHE_DIR = numba.config.CACHE_DIR, folder or ""
    options = {} if cache else _OPTIONS.get(function, {"no_cpython_wrapper": True})
    try:
        dispatcher: Callable[..., Any] = numba.njit(
            cache=cache and folder is not None, error_model="numpy", nogil=True,
            no_cfunc_wrapper=True, **options,
        )(copy)  # fmt: skip
        return dispatcher
    finally:
        numba.config.CACHE_DIR = theirs


@lru_cache(maxsize=1)
def names_in_cache() -> frozenset[str]:
    """Names of the functions that were in the cache when this process began to ask."""
    walked = os.walk(cache_folder() or os.devnull)
    return frozenset(name for *_, names in walked for name in names if name.endswith(".nbi"))


class Kernel:
    """A function that Python calls: of few rows interpreted, of many compiled."""

    always_compiled = False
    """Whether few rows are compiled too: to fill the cache."""

    def __init__(self, function: Callable[..., Any], rows: int, most: int) -> None:
        self.function, self.rows, self.left, self.most = function, rows, most, most
        self._compiled: Callable[..., Any] | None = None

    @property
    def cached(self) -> bool:
        """Whether the cache has it, for some types of arguments."""
        code: Any = self.function.__code__
        name = f"{self.function.__module__.rpartition('.')[2]}.{self.function.__qualname__}"
        python = f"py{sys.version_info.major}{sys.version_info.minor}{sys.abiflags}"
        return f"{name}-{code.co_firstlineno}.{python}.nbi" in names_in_cache()

    def __call__(self, *arguments: Any) -> Any:
        if self._compiled is None and not Kernel.always_compiled:
            counted = arguments[self.rows]
            self.left -= (counted[0] if isinstance(counted, tuple) else counted).shape[0]
            if self.left >= (self.most * (1.0 - _LOADED) if self.cached else 0):
                try:
                    return self.interpreted(*arguments)
                except (ArithmeticError, ValueError, IndexError):
                    pass  # what Python refuses and compiled code has a number for
        return self.compiled()(*arguments)

    def interpreted(self, *arguments: Any) -> Any:
        """The same, interpreted."""
        with np.errstate(all="ignore"):
            return _linked(self.function, False)(*arguments)

    def compiled(self) -> Callable[..., Any]:
        """The compiled function, which numba compiles, or loads, when it is called first."""
        if self._compiled is None:
            with _LINKING:
                self._compiled = _linked(self.function, True, True)
        return self._compiled


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call; compiled without wrappers, which take time."""
    _OPTIONS[function] = {"no_cpython_wrapper": True}
    return function


def within(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function compiled as a part of the one that calls it; each level takes time."""
    _OPTIONS[function] = {"inline": "always"}
    return function


def entry(rows: int, most: int = 0) -> Callable[[Callable[..., Any]], Kernel]:
    """A function that Python calls.

    ``rows`` numbers the argument that has its rows, or a tuple of columns; ``most`` of them are
    interpreted in a process: compiling it takes several times as long.
    """
    return lambda function: Kernel(function, rows, most)
