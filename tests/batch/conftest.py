"""Commands that must end in one way, and the tables of a mission as data frames."""

from __future__ import annotations

import hashlib
import re

import pyarrow as pa
import pytest

from tests.conftest import MissionFolder


def measured_rows(mission: MissionFolder):
    return mission.measurements().to_pandas()


def observe(mission: MissionFolder, rows):
    """Make a data frame the observations of the mission."""
    mission.observe(pa.Table.from_pandas(rows, preserve_index=False))


def hashes_in(folder, pattern="*"):
    """SHA-256 by name of each file in a folder but its lock."""
    hashes = {}
    for path in folder.rglob(pattern):
        if path.is_file() and path.name != ".lock":
            name = path.relative_to(folder).as_posix()
            hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hashes


def flip_a_byte(path):
    """Change one byte, in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.fixture
def obeyed(unbend):
    """Runs a command that must end with an exit code, by default 0; what it prints."""

    def run(*words, exit_code=0):
        ended = unbend(*words)
        assert ended.code == exit_code, ended.text
        return ended.out

    return run


@pytest.fixture
def refusal_of(unbend):
    """Runs a command that must be refused with a code; what it says."""

    def run(code, exit_code, *words):
        ended = unbend(*words)
        assert ended.code == exit_code, ended.text
        assert "Traceback" not in ended.text
        assert re.search(rf"^(.+: )?{code}: \S", ended.err, re.MULTILINE), ended.text
        return ended.err

    return run
