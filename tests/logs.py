"""The logs that are at hand: those of this repository, and real ones in ../shared/logs."""

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
SHARED = REPOSITORY.parent / "shared"
REAL = SHARED / "logs"
FOLDERS = (REPOSITORY / "sample_logs", REPOSITORY / "tests" / "data" / "logs", REAL)

LOGS = {path.name: path for folder in FOLDERS for path in sorted(folder.glob("*.*"))}
"""Paths by name; the names of all are different."""


def at_hand(*names):
    """Those of the names whose logs are here: tests of all of them name one of this repository."""
    return [name for name in names if name in LOGS]


def with_suffix(*suffixes):
    """The logs of a format."""
    return [path for path in LOGS.values() if path.suffix.lower() in suffixes]
