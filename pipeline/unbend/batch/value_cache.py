"""Values of the package as bytes, kept between runs: its plain classes, arrays and numbers.

What was used longest ago is forgotten first; without the cache all is made again. Read back only
if whole, and nothing in it is run: classes that hold values are all that is looked up.
"""

import hashlib
import io
import os
import pickle
from contextlib import suppress
from dataclasses import is_dataclass
from enum import Enum, EnumType
from typing import Any

from unbend.caches import kept_values
from unbend.messages import Ledger

_OTHERS = {
    "numpy": {"_frombuffer", "_reconstruct", "scalar", "ndarray", "dtype"},
    "pathlib": {"PosixPath", "WindowsPath"},
}
_DIGEST_BYTES = 32

MOST_BYTES = 2_000_000_000
"""Of all values in the user's cache together."""


def packed(value: Any) -> bytes:
    """A value as bytes, behind their SHA-256."""
    import zstandard

    content = zstandard.ZstdCompressor(1).compress(pickle.dumps(value, protocol=5))
    return hashlib.sha256(content).digest() + content


def unpacked(content: bytes) -> Any:
    """The value that was packed; None where the bytes are damaged, or another program's.

    >>> unpacked(packed({"rows": 3})), unpacked(packed({"rows": 3})[:-1])
    ({'rows': 3}, None)
    """
    import zstandard

    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    try:
        return _Reader(io.BytesIO(zstandard.ZstdDecompressor().decompress(content))).load()
    except (pickle.UnpicklingError, AttributeError, ImportError, TypeError, ValueError,
            RuntimeError):  # fmt: skip
        return None


def keep(name: str, value: Any) -> None:
    """Keep a value in the user's cache under a key, if it can be written."""
    content, folder = packed(value), kept_values()
    draft = os.path.join(folder, f".{name}.{os.getpid()}")
    with suppress(OSError):
        os.makedirs(folder, exist_ok=True)
        with open(draft, "wb") as file:
            file.write(content)
        os.replace(draft, os.path.join(folder, name))
        used = {(path := os.path.join(folder, name)): os.stat(path) for name in os.listdir(folder)}
        excess = sum(stat.st_size for stat in used.values()) - MOST_BYTES
        for path in sorted(used, key=lambda path: used[path].st_mtime_ns):
            if excess > 0:
                os.remove(path)
                excess -= used[path].st_size


def is_kept(name: str) -> bool:
    return os.path.isfile(os.path.join(kept_values(), name))


def recall(name: str) -> Any:
    """The value that is kept under a key; None where there is none, or a damaged one."""
    with suppress(OSError):
        path = os.path.join(kept_values(), name)
        with open(path, "rb") as file:
            content = file.read()
        os.utime(path)
        return unpacked(content)
    return None


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("builtins", "getattr"):
            return self.member
        room = module.partition(".")[0]
        if name in _OTHERS.get(room, ()):
            return super().find_class(module, name)
        if room == "unbend":
            found = super().find_class(module, name)
            plain = isinstance(found, type) and issubclass(found, tuple | Enum | Ledger)
            if plain or (isinstance(found, type) and is_dataclass(found)):
                return found
        raise pickle.UnpicklingError(f"{module}.{name} is no plain value")

    @staticmethod
    def member(of: Any, name: str) -> Any:
        """A member of an enumeration, which Python before 3.11.4 writes as its attribute."""
        if isinstance(of, EnumType) and name in of.__members__:
            return of[name]
        raise pickle.UnpicklingError(f"{name} is no member of an enumeration")
