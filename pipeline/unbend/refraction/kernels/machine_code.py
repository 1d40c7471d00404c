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
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from typing import Any

import llvmlite.binding as llvm
import numpy as np

_PLAIN: dict[type, type] = {
    bool: bool, np.bool_: bool, int: int, np.int64: int, float: float, np.float64: float
}  # fmt: skip
_OF_C = {bool: ctypes.c_uint8, int: ctypes.c_int64, float: ctypes.c_double}
_OF_LLVM = {"double": float, "i8": bool, "i64": int, "ptr": int}
_FLAGS = 0x501  # of arrays: writeable, aligned, C contiguous; F is 2
_ENGINES: list[Any] = []  # they own the code that is linked


def flatten(argument: Any, types: list[Any], words: list[Any]) -> None:
    """Append what tells arguments apart for the compiler, and an argument as numbers of C.

    Raises TypeError for what kernels do not take.

    >>> flatten((1.5, (2,)), types := [], words := [])
    >>> words
    [1.5, 2]
    """
    if isinstance(argument, np.ndarray):
        flags = argument.flags.num
        types.append((argument.dtype, argument.ndim, flags & (_FLAGS if flags & 1 else _FLAGS | 2)))
        words += 0, 0, argument.size, argument.itemsize, argument.ctypes.data
        words += argument.shape
        words += argument.strides
    elif isinstance(argument, tuple):
        types += type(argument), len(argument)
        for member in argument:
            flatten(member, types, words)
    elif (plain := _PLAIN.get(type(argument))) is None:
        raise TypeError(f"kernels take no {type(argument).__name__}")
    else:
        types.append(plain)
        words.append(plain(argument))


@lru_cache(maxsize=1)
def _machine() -> tuple[Any, str]:
    """The target of this processor, and its name with all that it can do."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target, f"{target.triple} {llvm.get_host_cpu_name()} {features} {llvm.llvm_version_info}"


def file_of(folder: str | None, name: str, types: tuple[Any, ...]) -> str:
    """The file for the code of a function, for types of arguments and this processor."""
    digest = hashlib.sha256(f"{types} {_machine()[1]}".encode()).hexdigest()
    return os.path.join(folder or os.devnull, f"{name}-{digest[:32]}.o")


def compiled(dispatcher: Any, arguments: tuple[Any, ...], words: list[Any]) -> tuple[Any, ...]:
    """A function compiled by numba: where it lies, its symbol, what it calls, and its code.

    Raises RuntimeError where this version of numba takes the arguments in another way.
    """
    from numba import __version__, typeof

    types = tuple(map(typeof, arguments))
    dispatcher.compile(types)
    result = dispatcher.overloads[types]
    symbol, library = result.fndesc.llvm_func_name, result.library
    text = library.get_llvm_str()
    head = text[text.index(f"@{symbol}(" if f"@{symbol}(" in text else f'@"{symbol}"(') :]
    takes = re.findall(r'[(,] ?([\w*]+) [^%\n]*%"?arg\.', head[: head.index("\n")])
    if [_OF_LLVM.get("ptr" if "*" in kind else kind) for kind in takes] != list(map(type, words)):
        raise RuntimeError(f"numba {__version__} takes other arguments than expected: {takes}")
    called = re.findall(r'^declare [^\n]*?@"?([^"( ]+)', text, re.MULTILINE)
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


@lru_cache(maxsize=1)
def name_runtime() -> None:
    """Let LLVM know numba's runtime, for arrays that a kernel makes: a module without the rest."""
    numba: Any = find_spec("numba")
    folder = os.path.join(os.path.dirname(numba.origin), "core", "runtime")
    runtime: Any = PathFinder.find_spec("_nrt_python", [folder])
    module = module_from_spec(runtime)
    runtime.loader.exec_module(module)
    for name, address in module.c_helpers.items():
        if llvm.address_of_symbol(f"NRT_{name}") is None:
            llvm.add_symbol(f"NRT_{name}", address)


def linked(path: str) -> int | None:
    """The address of a function whose code is kept; None where it is not, or is damaged."""
    digest = content = b""
    with suppress(OSError), open(path, "rb") as file:
        digest, content = file.read(32), file.read()
    if hashlib.sha256(content).digest() != digest:
        return None
    head, _, code = content.partition(b"\n")
    symbol, needs = json.loads(head)
    machine = _machine()[0].create_target_machine(codemodel="jitdefault")
    # Before the first of them, LLVM knows no function of the C library.
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    name_runtime()
    if any(llvm.address_of_symbol(name) is None for name in needs):
        return None
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    return int(engine.get_function_address(symbol))


def callable_at(address: int, words: list[Any]) -> Callable[[list[Any]], None]:
    """A function of numbers of such types; other threads run while it does."""
    kinds: list[Any] = [ctypes.c_void_p, ctypes.c_void_p, *(_OF_C[type(word)] for word in words)]
    function = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(address)

    def called(words: list[Any]) -> None:
        result, raised = ctypes.c_void_p(), ctypes.c_void_p()
        if status := function(ctypes.addressof(result), ctypes.addressof(raised), *words):
            raise RuntimeError(f"a kernel ended with status {status}")

    return called
