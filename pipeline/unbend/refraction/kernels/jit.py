"""How kernels run: interpreted while little is asked of them, else compiled, and cached.

Both give the same digits, bit for bit: compiled in double precision, without fused or reordered
operations, and interpreted with the functions of the C library that compiled code calls. numba is
imported with the first kernel that is compiled, because that takes half a second.

A function is compiled with all that it calls, in other files too; so the cache is a folder named
after the hash of all sources that may be compiled in.
"""

import hashlib
import math
import os
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache
from importlib.metadata import version
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from unbend.caches import OF_COMPILED, compiled_code
from unbend.refraction.kernels.threads import BLOCK_ROWS

_ROOM = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_KEPT_S = 7 * 86_400.0  # unused this long, the folder of another version is removed
_LINKED = 0.01  # of the rows worth compiling a kernel for: worth linking it

_INLINED: dict[Callable[..., Any], str] = {}
"""Functions that kernels call, and whether each is compiled as a part of those that call it."""

_LINKING = threading.RLock()

COMPILING: list[str] = []
"""The kernel that is being compiled, for whoever shows progress."""


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
    with suppress(OSError):  # another process removes them at this moment
        for path in (os.path.join(base, name) for name in os.listdir(base)):
            ours = OF_COMPILED.fullmatch(os.path.basename(path)) and path != folder
            if ours and time.time() - os.stat(path).st_mtime > _KEPT_S:
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
def _linked(function: Any, compiled: bool) -> Callable[..., Any]:
    """A copy of a function that calls compiled functions, or interpreted ones, in its module."""
    if isinstance(function, OfType):
        return function.compiled() if compiled else function
    within = function.__globals__
    names: dict[str, Any] = {} if compiled else {"math": _MATH, "np": _NUMPY}
    for name in function.__code__.co_names:
        value = within.get(name)
        if isinstance(value, OfType) or (isinstance(value, FunctionType) and value in _INLINED):
            names[name] = _linked(value, compiled)
    copy = FunctionType(function.__code__, within | names, function.__name__, function.__defaults__)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    if not compiled:
        return copy
    import numba

    dispatcher: Callable[..., Any] = numba.njit(
        error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True,
        inline=_INLINED.get(function, "never"),
    )(copy)  # fmt: skip
    return dispatcher


class Kernel:
    """A function that Python calls: of few rows interpreted, of many compiled."""

    always_compiled = False
    """Whether few rows are compiled too: to fill the cache."""

    def __init__(self, function: Callable[..., Any], rows: int, most: int) -> None:
        self.function, self.rows, self.asked, self.most = function, rows, 0, most
        self.by_types: dict[tuple[Any, ...], Callable[[list[Any]], None]] = {}
        self.name = f"{function.__module__}.{function.__qualname__}"

    def __call__(self, *arguments: Any) -> None:
        """Interpreted, or by machine code: linked from the cache, or compiled for many rows."""
        if not (self.by_types or Kernel.always_compiled) and self.is_interpreted(arguments):
            try:
                self.interpreted(*arguments)
                return
            except (ArithmeticError, ValueError, IndexError):
                pass  # what Python refuses and compiled code has a number for
        code, words = self.code_for(arguments, compiles=True)
        code(words)

    def is_interpreted(self, arguments: tuple[Any, ...]) -> bool:
        """Whether machine code is not worth linking, or is not there and not worth compiling."""
        counted = arguments[self.rows]
        rows = (counted[0] if isinstance(counted, tuple) else counted).shape[0]
        self.asked += rows
        if self.asked <= _LINKED * self.most:
            return True
        if rows >= BLOCK_ROWS or self.code_for(arguments, compiles=False) is not None:
            return False
        return self.counted(rows) <= self.most

    def counted(self, rows: int) -> int:
        """These rows, with all interpreted since the cache was begun: a byte of a file for 100."""
        path = os.path.join(cache_folder() or os.devnull, f"{self.name}.rows")
        with suppress(OSError), open(path, "ab") as file:
            file.write(bytes(rows // 100))
            return max(self.asked, 100 * file.tell())
        return self.asked

    def interpreted(self, *arguments: Any) -> None:
        """The same, interpreted."""
        with np.errstate(all="ignore"):
            _linked(self.function, False)(*arguments)

    def code_for(self, arguments: Any, *, compiles: bool) -> Any:
        """Machine code, in the cache or compiled by numba, and numbers to call it with; or None."""
        from unbend.refraction.kernels import machine_code

        types, words = list[Any](), list[Any]()
        machine_code.flatten(arguments, types, words)
        key = tuple(types)
        if key not in self.by_types:
            with _LINKING:
                path = machine_code.file_of(cache_folder(), self.name, key)
                address = machine_code.linked(path)
                if address is None and not compiles:
                    return None
                if address is None:
                    COMPILING.append(self.name)
                    dispatcher = _linked(self.function, True)
                    address, *code = machine_code.compiled(dispatcher, arguments, words)
                    machine_code.keep(path, *code)
                    COMPILING.clear()
                self.by_types[key] = machine_code.callable_at(address, words)
        return self.by_types[key], words


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call."""
    _INLINED[function] = "never"
    return function


def within(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function compiled as a part of the one that calls it; each level takes time."""
    _INLINED[function] = "always"
    return function


def entry(rows: int, most: int = 0) -> Callable[[Callable[..., Any]], Kernel]:
    """A function that Python calls.

    ``rows`` numbers the argument that has its rows, or a tuple of columns; ``most`` of them take
    about as long interpreted as compiling does, and are before it is compiled, by however many
    processes.
    """
    return lambda function: Kernel(function, rows, most)
