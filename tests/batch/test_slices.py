"""One mission in several processes: the bytes of one process, whatever becomes of the others."""

from __future__ import annotations

import hashlib
import pickle
import shutil
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from unbend.batch import executors, run_files
from unbend.batch.executors import Child, Lost, end_of
from unbend.batch.run_files import PartsOfRun, check_wanted
from unbend.batch.store import RunFolder
from unbend.errors import StorageError
from unbend.stages.statistics import Statistics

BATCH_ROWS, COPIES = 1000, 200


def tree(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*")) if p.is_file() and p.name != ".lock"
    }  # fmt: skip


@pytest.fixture
def large(mission):
    """A mission of a dozen parts."""
    mission.observe(mission.measured_often(COPIES))
    mission.config["output"]["batch_rows"] = BATCH_ROWS
    return mission


@pytest.fixture
def made_here(monkeypatch):
    """The parts that this process makes: none before another process has made one."""
    numbers, real = [], run_files.PartsOfRun.write

    def write(self, number, table, statistics):
        limit = time.monotonic() + 100.0
        while not numbers and not list((self.folder.staging / "receipts").glob("part-*")):
            assert time.monotonic() < limit
            time.sleep(0.02)
        numbers.append(number)
        real(self, number, table, statistics)

    monkeypatch.setattr(run_files.PartsOfRun, "write", write)
    return numbers


@pytest.mark.usefixtures("plain_report")
def test_slices_give_the_bytes_of_one_process(large, made_here, monkeypatch):
    assert large.run("--jobs", "2").code == 0
    in_slices, here = tree(large.output), list(made_here)
    parts = [name for name in in_slices if name.startswith("observations/")]
    assert 0 < len(here) < len(parts) > 10
    monkeypatch.undo()
    assert large.run("--force").code == 0
    assert tree(large.output) == in_slices


@pytest.mark.usefixtures("plain_report")
@pytest.mark.parametrize("end", [Lost("killed by SIGKILL"), OSError("no more processes")])
def test_what_another_process_leaves_is_made_here(large, monkeypatch, end):
    asked = []

    def run(self, task):
        asked.append(task)
        if isinstance(end, Exception):
            raise end
        return end

    monkeypatch.setattr(Child, "run", run)
    assert large.run("--jobs", "3").code == 0
    assert 0 < len(asked) < 3, "a process that fails is asked once"
    parts = list((large.output / "observations").iterdir())
    assert large.results().num_rows == COPIES * large.measurements().num_rows
    assert len(parts) == -(-large.results().num_rows // BATCH_ROWS)


def test_slices_cover_all_numbers_once(tmp_path):
    """Whatever workers do: nothing, die at once or when they have taken a slice, or work."""

    def dies(task):
        next(executors.made_with(*pickle.loads(task).args[:2])[1].taken("worker-1"))
        return Lost("killed by SIGKILL")

    for count in (0, 1, 7, 100):
        by_all = [lambda task: pickle.loads(task)(), dies]
        for workers in ([], [lambda task: Lost("killed")], by_all):
            slices = executors.Slices.of(tmp_path, range(count), len(workers))
            assert [n for some in slices.numbers for n in some] == list(range(count))
            made, progress = tmp_path / str(slices.folder.name) / "made", []
            executors.make_parts(partial(note, made), slices, workers, progress.append)
            numbers = [int(n) for n in made.read_text().split()] if made.exists() else []
            assert len(numbers) == len(set(numbers))
            assert sum(progress) == count
            lost = slices.numbers[0] if dies in workers and count else ()
            assert len(numbers) >= count - max(map(len, slices.numbers), default=0) * bool(lost)


def note(file, numbers):
    with file.open("a") as stream:
        print(*numbers, file=stream)


def test_a_worker_that_has_not_begun_is_not_waited_for(tmp_path):
    """As on a cluster whose workers are busy: it comes when all is done, and makes nothing."""
    waits, late = threading.Event(), []

    def busy(task):
        waits.wait(100.0)
        late.append(pickle.loads(task)())

    slices = executors.Slices.of(tmp_path, range(20), 1)
    executors.make_parts(partial(note, tmp_path / "made"), slices, [busy], lambda made: None)
    assert sorted(map(int, (tmp_path / "made").read_text().split())) == list(range(20))
    waits.set()
    limit = time.monotonic() + 100.0
    while not late:
        assert time.monotonic() < limit
        time.sleep(0.01)
    assert late == [[]]


def test_a_set_up_of_another_hash_is_refused(tmp_path):
    slices, ends = executors.Slices.of(tmp_path, range(20), 1), []

    def other(task):
        setup = slices.folder / "setup"
        setup.write_bytes(setup.read_bytes().replace(b"note", b"fade"))
        ends.append(end_of(pickle.loads(task)))

    executors.make_parts(partial(note, tmp_path / "made"), slices, [other], lambda made: None)
    limit = time.monotonic() + 100.0
    while not ends:
        assert time.monotonic() < limit
        time.sleep(0.01)
    assert ends[0].code == "INPUT-CHANGED"
    assert sorted(map(int, (tmp_path / "made").read_text().split())) == list(range(20))


def test_a_worker_whose_run_has_ended_puts_no_part_among_those_of_the_next(tmp_path):
    """Its machine did not notice that the command was killed; another run uses the folder now."""
    slices = executors.Slices.of(tmp_path, range(4), 1)
    (slices.folder / "setup").touch()
    of_next = PartsOfRun(RunFolder(tmp_path))
    of_next.write(0, pa.table({"x_px": [2.0]}), Statistics.of({}))
    late = replace(of_next, check=partial(check_wanted, slices, lambda: None))
    late.write(1, pa.table({"x_px": [1.0]}), Statistics.of({}))
    shutil.rmtree(slices.folder)
    with pytest.raises(StorageError, match="setup"):
        late.write(0, pa.table({"x_px": [1.0]}), Statistics.of({}))
    parts = sorted((tmp_path / ".staging" / "observations").iterdir())
    assert [pq.read_table(part)["x_px"].to_pylist() for part in parts] == [[2.0], [1.0]]
