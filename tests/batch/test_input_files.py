"""Inputs that are unchanged by size and time are not read; a change of either is seen."""

import os
import time

import pytest

from unbend.batch import input_files
from unbend.batch.plan import make_plan
from unbend.batch.runs import mission_status, run_mission
from unbend.config import load_mission
from unbend.ingest import hash_file

from .conftest import flip_a_byte


@pytest.fixture
def reads(monkeypatch):
    """The files that are read for their hashes."""
    paths = []

    def hash_and_record(path):
        paths.append(path)
        return hash_file(path)

    monkeypatch.setattr(input_files, "hash_file", hash_and_record)
    input_files._hash_in_state.cache_clear()
    return paths


def settle(mission):
    """Let the inputs be written a minute ago, for a clock that runs a minute ahead."""
    for path in mission.folder.iterdir():
        if path.is_file():
            date(path)


def date(path):
    past_s = time.time() - 60
    os.utime(path, (past_s, past_s))


@pytest.fixture
def later(monkeypatch):
    """The clock is a minute ahead of the file system's."""
    now = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now() + 60_000_000_000)


@pytest.fixture
def done(mission, plain_report, later):
    """A mission that ran on inputs that were written some time before its clock."""
    mission.save()
    settle(mission)
    run_mission(mission.file)
    return mission


def test_what_is_unchanged_is_not_read(done, reads):
    assert run_mission(done.file).repeated
    assert mission_status(done.file)[1] == []
    assert reads == []
    assert run_mission(done.file, verify_inputs=True).repeated
    assert len(reads) == 2


def test_another_time_is_read_and_the_same_content_is_the_same(done, reads):
    """Afterwards the new time is known."""
    os.utime(done.log, (1_700_000_000, 1_700_000_000))
    manifest = done.output / "manifest.json"
    time_of_run_ns = manifest.stat().st_mtime_ns
    content = manifest.read_text("utf-8")
    assert run_mission(done.file).repeated
    assert manifest.read_text("utf-8") != content  # it has the new time of the log
    assert manifest.stat().st_mtime_ns == time_of_run_ns
    assert reads == [done.log]
    assert run_mission(done.file).repeated
    assert reads == [done.log]


def test_content_of_the_same_size_with_another_time_is_seen(done):
    flip_a_byte(done.log)
    assert mission_status(done.file)[1] == [f"log changed ({done.config['log']['path']})"]


def test_content_that_keeps_size_and_time_is_seen_where_it_is_asked_for(done):
    """Size and time are all that a run looks at; --verify-inputs reads."""
    before = done.log.stat()
    flip_a_byte(done.log)
    os.utime(done.log, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert run_mission(done.file).repeated
    plan = make_plan(load_mission(done.file), done.folder, verify=True)
    assert plan.input("log").sha256 == hash_file(done.log)


def test_what_was_just_written_is_read_once_more(mission, plain_report, reads):
    """The next change may have the same time: that of the manifest is not trusted."""
    run_mission(mission.save())
    assert [row["mtime_ns"] for row in mission.manifest()["inputs"]] == [None, None]
    reads.clear()
    assert run_mission(mission.file).repeated
    assert len(reads) == 2


def test_missions_of_one_process_read_a_shared_file_once(mission_factory, tmp_path, later, reads):
    shared = tmp_path / "points.csv"
    shared.write_text("point,lat,lon,h\n")
    date(shared)
    for name in "ab":
        mission = mission_factory(tmp_path / name)
        mission.config["control"] = {"path": str(shared)}
        make_plan(load_mission(mission.save()), mission.folder)
    assert reads.count(shared) == 1


@pytest.mark.parametrize(("start", "counts"), [(b"\xff\xd8", False), (b"II*\0", True)])
def test_only_of_a_jpeg_the_end_is_left_out(tmp_path, start, counts):
    """EXIF may lie at the end of a TIFF file."""
    image = tmp_path / "a.tif"
    hashes = set()
    for end in (b"1", b"2"):
        image.write_bytes(start + bytes(1 << 18) + end)
        hashes.add(input_files.hash_of_exif(image))
    assert (len(hashes) == 2) == counts
