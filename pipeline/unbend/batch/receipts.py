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
"""What pickles of arrays call, by the library."""

_DIGEST_BYTES = 32  # of SHA-256


def packed(value: Any) -> bytes:
    """A value as bytes, behind their SHA-256."""
    import zstandard

    content = zstandard.ZstdCompressor(1).compress(pickle.dumps(value, protocol=5))
    return hashlib.sha256(content).digest() + content


def unpacked(content: bytes) -> Any:
    """The value that was packed; None where the bytes are damaged, or were not packed by this code.

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
        room = module.partition(".")[0]
        if name in _FUNCTIONS.get(room, ()):
            return super().find_class(module, name)
        if room == "unbend":
            plain = super().find_class(module, name)
            if isinstance(plain, type) and (issubclass(plain, tuple | Enum) or is_dataclass(plain)):
                return plain
        raise pickle.UnpicklingError(f"{module}.{name} is not a plain value")


def member_of(enumeration: Any, name: str) -> Any:
    """A member of an enumeration, which Python before 3.11.4 writes as its attribute."""
    if isinstance(enumeration, EnumType) and name in enumeration.__members__:
        return enumeration[name]
    raise pickle.UnpicklingError(f"{name} is not a member of an enumeration")
