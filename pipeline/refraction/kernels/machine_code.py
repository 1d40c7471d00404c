"""Machine code of kernels: kept in files, linked and called without numba.

numba takes half a second to be imported, and as long to load what it compiled; this 0.1 s.
What numba compiles is a function with the arguments of C: a place for its result, one for what it
raises, and of every array the two owners of its memory (none here), size, bytes of an element,
address, shape and strides; of tuples all members, one after the other.
"""

import ctypes
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np

_RELEASE = "NRT_MemInfo_call_dtor"  # of memory with an owner, which no argument has
_KINDS: dict[type, type] = {
    bool: ctypes.c_uint8, np.bool_: ctypes.c_uint8, int: ctypes.c_int64, np.int64: ctypes.c_int64,
    float: ctypes.c_double, np.float64: ctypes.c_double,
}  # fmt: skip
_ENGINES: list[Any] = []  # they own the code that is linked


def words_of(argument: Any) -> Iterator[tuple[type, Any]]:
    """An argument as numbers of C, each behind its type; TypeError for what kernels do not take.

    >>> [value for _, value in words_of((1.5, (2,)))]
    [1.5, 2]
    """
    if isinstance(argument, np.ndarray):
        yield from ((ctypes.c_void_p, None), (ctypes.c_void_p, None))
        yield from ((ctypes.c_int64, argument.size), (ctypes.c_int64, argument.itemsize))
        yield ctypes.c_void_p, argument.ctypes.data
        yield from ((ctypes.c_int64, step) for step in (*argument.shape, *argument.strides))
    elif isinstance(argument, tuple):
        for member in argument:
            yield from words_of(member)
    else:
        if type(argument) not in _KINDS:
            raise TypeError(f"kernels take no {type(argument).__name__}")
        yield _KINDS[type(argument)], argument


def type_of(argument: Any) -> str:
    """What tells arguments apart for which a function is compiled differently."""
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return f"{argument.dtype.str} {argument.ndim}{layout}{flags.writeable:d}{flags.aligned:d}"
    if isinstance(argument, tuple):
        members = ",".join(map(type_of, argument))
        return f"{type(argument).__module__}.{type(argument).__qualname__}({members})"
    return next(words_of(argument))[0].__name__


@lru_cache(maxsize=1)
def _machine() -> tuple[Any, str]:
    """The target of this processor, and its name with all that it can do."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target, f"{target.triple} {llvm.get_host_cpu_name()} {features} {llvm.llvm_version_info}"


def file_of(folder: str | None, name: str, types: str) -> str:
    """The file for the code of a function, for types of arguments and this processor."""
    digest = hashlib.sha256(f"{types} {_machine()[1]}".encode()).hexdigest()
    return os.path.join(folder or os.devnull, f"{name}-{digest[:32]}.o")


def compiled(dispatcher: Any, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """A function compiled by numba: where it lies, its symbol, what it calls, and its code."""
    from numba import typeof

    types = tuple(map(typeof, arguments))
    dispatcher.compile(types)
    result = dispatcher.overloads[types]
    symbol, library = result.fndesc.llvm_func_name, result.library
    called = re.findall(r'^declare [^\n]*?@"?([^"( ]+)', library.get_llvm_str(), re.MULTILINE)
    called = [name for name in called if not name.startswith("llvm.")]
    address = library.get_pointer_to_function(symbol)
    return address, symbol, called, library._get_compiled_object()


def keep(path: str, symbol: str, needs: list[str], code: bytes) -> None:
    """Write the code of a function, the name it has there, and the names of what it calls."""
    content, draft = json.dumps([symbol, needs]).encode() + b"\n" + code, f"{path}.{os.getpid()}"
    with suppress(OSError):
        with open(draft, "wb") as file:
            file.write(hashlib.sha256(content).digest() + content)
        os.replace(draft, path)


def linked(path: str) -> int | None:
    """The address of a function whose code is kept; None where it is not, or is damaged."""
    try:
        with open(path, "rb") as file:
            digest, content = file.read(32), file.read()
    except OSError:
        return None
    if hashlib.sha256(content).digest() != digest:
        return None
    head, _, code = content.partition(b"\n")
    symbol, needs = json.loads(head)
    machine = _machine()[0].create_target_machine(codemodel="jitdefault")
    if llvm.address_of_symbol(_RELEASE) is None:
        ends = ctypes.cast(ctypes.pythonapi.Py_FatalError, ctypes.c_void_p)
        llvm.add_symbol(_RELEASE, ends.value)
    if any(llvm.address_of_symbol(name) is None for name in needs):
        from numba.core.registry import cpu_target

        cpu_target.target_context.refresh()  # numba's own, for code that allocates memory
    _ENGINES.append(llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine))
    _ENGINES[-1].add_object_file(llvm.ObjectFileRef.from_data(code))
    _ENGINES[-1].finalize_object()
    return int(_ENGINES[-1].get_function_address(symbol))


def callable_at(address: int, arguments: tuple[Any, ...]) -> Callable[..., None]:
    """A function of arguments of these types; other threads run while it does."""
    kinds = [ctypes.c_void_p, ctypes.c_void_p, *(kind for kind, _ in words_of(arguments))]
    function = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(address)

    def called(*arguments: Any) -> None:
        result, raised = ctypes.c_void_p(), ctypes.c_void_p()
        words = [value for _, value in words_of(arguments)]
        if status := function(ctypes.addressof(result), ctypes.addressof(raised), *words):
            raise RuntimeError(f"a kernel ended with status {status}")

    return called
