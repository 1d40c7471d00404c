"""Hashes that are remembered: right after any change, and nothing is read without one."""

from __future__ import annotations

import hashlib
import os
import sqlite3
import time
from pathlib import Path

import pytest

from unbend.batch import file_hashes
from unbend.batch.file_hashes import remembered_hash
from unbend.caches import user_cache
from unbend.ingest import hash_file


@pytest.fixture
def reads(monkeypatch, tmp_path) -> list[Path]:
    """The files that were read, with a cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    read: list[Path] = []
    monkeypatch.setattr(file_hashes, "hash_file", lambda path: read.append(path) or hash_file(path))
    return read


def settled(path: Path, content: bytes) -> Path:
    """A file that was changed a minute ago; the clock of the cache runs ahead."""
    path.write_bytes(content)
    os.utime(path, (time.time() - 60, time.time() - 60))
    return path


@pytest.fixture
def later(monkeypatch):
    """The clock is a minute ahead of the file system's."""
    now = time.time_ns
    monkeypatch.setattr(file_hashes.time, "time_ns", lambda: now() + 60_000_000_000)


def test_a_file_is_read_once(reads, later, tmp_path):
    path = settled(tmp_path / "flight.bin", b"one")
    expected = hashlib.sha256(b"one").hexdigest()
    assert [remembered_hash(path) for _ in range(3)] == [expected] * 3
    assert reads == [path]
    assert remembered_hash(path, verify=True) == expected
    assert len(reads) == 2


def test_content_of_the_same_size_and_time_is_seen(reads, later, tmp_path):
    path = settled(tmp_path / "flight.bin", b"one")
    before = path.stat()
    remembered_hash(path)
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_mtime_ns == before.st_mtime_ns
    assert remembered_hash(path) == hashlib.sha256(b"two").hexdigest()


def test_another_file_in_its_place_is_seen(reads, later, tmp_path):
    path = settled(tmp_path / "flight.bin", b"one")
    remembered_hash(path)
    settled(tmp_path / "other.bin", b"two").replace(path)
    assert remembered_hash(path) == hashlib.sha256(b"two").hexdigest()


def test_what_was_just_written_is_not_remembered(reads, tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(b"one")
    assert remembered_hash(path) == remembered_hash(path)
    assert len(reads) == 2


@pytest.mark.parametrize("state", ["damaged", "a folder", "without the table's columns"])
def test_a_cache_that_cannot_be_used_costs_time_only(reads, later, tmp_path, state):
    file = Path(user_cache()) / "hashes.sqlite"
    file.parent.mkdir(parents=True)
    if state == "damaged":
        file.write_bytes(b"no database" * 100)
    elif state == "a folder":
        file.mkdir()
    else:
        with sqlite3.connect(file) as database:
            database.execute("CREATE TABLE entries (name TEXT)")
    path = settled(tmp_path / "flight.bin", b"one")
    for _ in range(2):
        assert remembered_hash(path) == hashlib.sha256(b"one").hexdigest()
    assert len(reads) == 2


def test_the_start_of_a_jpeg_has_a_hash_of_its_own(reads, later, tmp_path):
    path = settled(tmp_path / "image.jpg", b"\xff\xd8head and image")
    assert remembered_hash(path, of_jpeg=6) == hashlib.sha256(b"\xff\xd8head").hexdigest()
    assert remembered_hash(path) == hashlib.sha256(b"\xff\xd8head and image").hexdigest()
    assert remembered_hash(path, of_jpeg=6) == hashlib.sha256(b"\xff\xd8head").hexdigest()
    opened, first = [], Path.open
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Path, "open", lambda self, *a: opened.append(self) or first(self, *a))
        remembered_hash(path, of_jpeg=6)
        assert opened == []
        remembered_hash(path, of_jpeg=6, verify=True)
        assert opened == [path]


def test_what_was_hashed_longest_ago_is_forgotten(reads, later, tmp_path, monkeypatch):
    monkeypatch.setattr(file_hashes, "_MOST_FILES", 2)
    paths = [settled(tmp_path / name, name.encode()) for name in ("a", "b", "c")]
    for path in (*paths, paths[2], paths[1], paths[0]):
        remembered_hash(path)
    assert [path.name for path in reads] == ["a", "b", "c", "a"]
