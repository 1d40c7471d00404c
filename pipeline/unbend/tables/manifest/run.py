"""Which run a manifest is of: its mission file, its inputs, versions and files of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

MANIFEST_VERSION = 2
"""Since 2 a message of the ledger has its ``values`` beside its text ``what``."""


@dataclass(frozen=True)
class OutputRecord:
    """A file of the results: its name in their folder, and what it holds."""

    name: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class InputRecord:
    """An input: what it held, and what shows without reading that it still does.

    ``bytes`` and ``mtime_ns`` of its files: their sum, and the newest. ``mtime_ns`` is None where
    a file had changed so shortly before that a later change need not show. ``version`` is a hash
    of names, sizes and times of several files, or the version of objects in storage.
    """

    role: str
    name: str
    sha256: str
    bytes: int = -1
    mtime_ns: int | None = None
    version: str = ""

    def with_hash(self, sha256: str) -> InputRecord:
        """The record with the hash of its content."""
        return replace(self, sha256=sha256)

    def is_like(self, other: InputRecord | None) -> bool:
        """Whether another record is of the same files, unchanged by size and time."""
        return (
            other is not None
            and self.mtime_ns is not None
            and (self.name, self.bytes, self.mtime_ns, self.version)
            == (other.name, other.bytes, other.mtime_ns, other.version)
        )


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Which run a manifest is of. What an older version did not write is empty."""

    manifest_version: int = 0
    mission: str
    fingerprint: str
    mission_file_sha256: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)
    inputs: list[InputRecord] = field(default_factory=list)
    versions: Mapping[str, str] = field(default_factory=dict)

    def row(self) -> dict[str, Any]:
        """The record as plain values."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class RunRecord(Identity):
    """Which run a manifest is of, how it ended, and its files, none before it has finished.

    ``attempt`` is empty but where the run is published at a URL.
    """

    exit_code: int
    outputs: list[OutputRecord] = field(default_factory=list)
    attempt: str = ""
