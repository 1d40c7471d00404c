"""A planted bug, and the lists of them."""

import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Bug:
    """One planted bug of a room; `index` counts from 1 in its file or among the drawn ones."""

    room: str
    index: int
    tests: tuple[str, ...]
    file: str
    before: str
    after: str
    what: str
    first: str | None = None
    nearest: tuple[str, ...] = ()


def read_bugs(path: Path) -> list[Bug]:
    """The planted bugs of a room."""
    content = tomllib.loads(path.read_text("utf-8"))
    tests = tuple(content["tests"])
    return [
        Bug(path.stem, index, tests, **entry) for index, entry in enumerate(content["bug"], start=1)
    ]
