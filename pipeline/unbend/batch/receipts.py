"""Receipts of finished parts as bytes: plain classes of the package, arrays and numbers.

A folder of results may come from somebody else. Therefore a receipt is read back only if it is
whole, and nothing in it is run: only classes that hold values, and functions that make arrays, are
looked up.
"""

import hashlib
import io
import pickle
from dataclasses import is_dataclass
from enum import Enum, EnumType
from typing import Any

_FUNCTIONS = {
    "numpy": {"_frombuffer", "_reconstruct", "scalar", "ndarray", "dtype"},
}
"""Functions and classes that pickles of arrays call, by the library."""

_DIGEST_BYTES = 32  # of SHA-256


def packed(value: Any) -> bytes:
    """A value as bytes: the SHA-256 of the compressed pickle (32 bytes), then that pickle."""
    import zstandard

    content = zstandard.ZstdCompressor(1).compress(pickle.dumps(value, protocol=5))
    return hashlib.sha256(content).digest() + content


def unpacked(content: bytes) -> Any:
    """The value that `packed` made into bytes; None if they are damaged or not of `packed`.

    >>> unpacked(packed({"rows": 3})), unpacked(packed({"rows": 3})[:-1])
    ({'rows': 3}, None)
    """
    import zstandard

    digest = content[:_DIGEST_BYTES]
    compressed = content[_DIGEST_BYTES:]
    if hashlib.sha256(compressed).digest() != digest:
        return None
    try:
        stream = io.BytesIO(zstandard.ZstdDecompressor().decompress(compressed))
        return _PlainUnpickler(stream).load()
    except (
        pickle.UnpicklingError,
        zstandard.ZstdError,
        EOFError,
        LookupError,
        AttributeError,
        ImportError,
        TypeError,
        ValueError,
        RuntimeError,
    ):
        return None


class _PlainUnpickler(pickle.Unpickler):
    """Reads values of plain classes; refuses to call anything else."""

    def find_class(self, module: str, name: str) -> Any:
        """The class or function that a pickle names; UnpicklingError for any that is not allowed.

        Allowed are functions that make arrays, and classes of this package that hold values:
        dataclasses, named tuples and enumerations.
        """
        if (module, name) == ("builtins", "getattr"):
            return member_of
        library = module.partition(".")[0]
        if name in _FUNCTIONS.get(library, ()):
            return super().find_class(module, name)
        if library == "unbend":
            found_class = super().find_class(module, name)
            if is_plain(found_class):
                return found_class
        raise pickle.UnpicklingError(f"{module}.{name} is not a plain value")


def is_plain(candidate: object) -> bool:
    """Whether an object is a named tuple, an enumeration or a dataclass."""
    if not isinstance(candidate, type):
        return False
    return issubclass(candidate, tuple | Enum) or is_dataclass(candidate)


def member_of(enumeration: Any, name: str) -> Any:
    """The member of an enumeration; UnpicklingError for any other object or name.

    It takes the place of ``getattr``, which pickles of Python before 3.11.4 call for a member.
    """
    if isinstance(enumeration, EnumType) and name in enumeration.__members__:
        return enumeration[name]
    raise pickle.UnpicklingError(f"{name} is not a member of an enumeration")
