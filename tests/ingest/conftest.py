"""Real logs from beside the repository, and small logs with known content."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

REAL_LOGS = Path(__file__).resolve().parents[2].parent / "shared" / "logs"

# struct letters and scale of the DataFlash format letters in use here (ArduPilot LogStructure.h)
LETTERS = {
    "Q": ("Q", 1),
    "B": ("B", 1),
    "I": ("I", 1),
    "H": ("H", 1),
    "f": ("f", 1),
    "N": ("16s", 1),
    "c": ("h", 100),
    "C": ("H", 100),
    "e": ("i", 100),
    "E": ("I", 100),
    "L": ("i", 10**7),
}


class DataFlashWriter:
    """Writes DataFlash records as ArduPilot does."""

    def __init__(self) -> None:
        self.data = b""
        self.formats: dict[str, tuple[int, str]] = {}
        self.define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)

    def define(self, kind: int, name: str, letters: str, columns: str, length: int = 0) -> None:
        size = length or 3 + struct.calcsize("<" + "".join(LETTERS[x][0] for x in letters))
        self.data += b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", kind, size, name.encode(), letters.encode(), columns.encode()
        )
        self.formats[name] = (kind, letters)

    def row(self, name: str, *values: float | bytes) -> None:
        kind, letters = self.formats[name]
        layout = "<" + "".join(LETTERS[letter][0] for letter in letters)
        raw = [
            value if letter in "fN" else round(value * LETTERS[letter][1])
            for letter, value in zip(letters, values, strict=True)
        ]
        self.data += b"\xa3\x95" + bytes([kind]) + struct.pack(layout, *raw)


@pytest.fixture
def dataflash_writer() -> type[DataFlashWriter]:
    return DataFlashWriter


@pytest.fixture
def real_log() -> Callable[[str], Path]:
    """The path of a log in ../shared/logs, or a skip."""

    def find(name: str) -> Path:
        path = REAL_LOGS / name
        if not path.is_file():
            pytest.skip(f"{path} is not there: real logs live beside the repository")
        return path

    return find


@pytest.fixture
def head(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, int], Path]:
    """A log, or a copy of its first bytes; all of it with UNBEND_WHOLE_LOGS, as in `make faults`.

    The libraries take a minute for the logs of 20 MB, whose messages have all begun by then.
    """

    def cut(path: Path, size: int) -> Path:
        if "UNBEND_WHOLE_LOGS" in os.environ or path.stat().st_size <= size:
            return path
        copy = tmp_path_factory.mktemp("head") / path.name
        with path.open("rb") as whole:
            copy.write_bytes(whole.read(size))
        return copy

    return cut
