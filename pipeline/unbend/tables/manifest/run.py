"""The run that a manifest describes: its mission file, inputs, versions and files of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

MANIFEST_VERSION = 2
"""In version 2, a message of the ledger has ``values`` in addition to its text ``what``."""


@dataclass(frozen=True)
class OutputRecord:
    """A file of the results: its name in their folder, the hash of its content, and its size."""

    name: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class InputRecord:
    """An input: the hash of its content, and values that show a change without reading it again.

    ``bytes`` is the sum over its files, ``mtime_ns`` the newest time of change. ``mtime_ns`` is
    None if a file had changed so recently that a later change could have the same time.
    ``version`` is a hash of names, sizes and times of several files, or the version of objects in
    storage.
    """

    role: str
    name: str
    sha256: str
    bytes: int = -1
    mtime_ns: int | None = None
    version: str = ""

    def with_hash(self, sha256: str) -> InputRecord:
        """A copy of the record with the hash of its content."""
        return replace(self, sha256=sha256)

    def is_unchanged_since(self, other: InputRecord | None) -> bool:
        """Whether an earlier record is of the same files, with the same size, time and version.

        False without a record, and if ``mtime_ns`` is None, so that no change could be seen.
        """
        return (
            other is not None
            and self.mtime_ns is not None
            and (self.name, self.bytes, self.mtime_ns, self.version)
            == (other.name, other.bytes, other.mtime_ns, other.version)
        )


@dataclass(frozen=True, kw_only=True)
class Identity:
    """The values that identify a run; values that an older version did not write are empty.

    ``mission_file`` is the path of the mission file, or of its campaign file, from the folder of
    the results. It is empty too for a mission that was made in memory, for results at a URL, for an
    absolute ``output.path``, and if the file is on another drive.
    """

    manifest_version: int = 0
    mission: str
    mission_file: str = ""
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
    """The identity of a run, how it ended, and its files; no files before it has finished.

    ``attempt`` is the id of a run that is published at a URL, else empty.
    """

    exit_code: int
    outputs: list[OutputRecord] = field(default_factory=list)
    attempt: str = ""
