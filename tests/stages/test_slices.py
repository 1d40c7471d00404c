"""One mission in several processes: the bytes of one process, whatever becomes of the others."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import pyarrow as pa
import pytest

from pipeline.batch import executors
from pipeline.batch.apart import Child
from pipeline.batch.outcomes import Lost
from pipeline.stages import correction

BATCH_ROWS, COPIES = 1000, 200


def tree(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*")) if p.is_file() and p.name != ".lock"
    }  # fmt: skip


@pytest.fixture
def large(mission):
    """A mission of a dozen parts."""
    mission.observe(pa.concat_tables([mission.measurements()] * COPIES))
    mission.config["output"]["batch_rows"] = BATCH_ROWS
    return mission


@pytest.fixture
def made_here(monkeypatch):
    """The parts that this process makes: none before another process has made one."""
    numbers, real = [], correction.PartsOfRun.write

    def write(self, number, table, statistics):
        limit = time.monotonic() + 100.0
        while not numbers and not list((self.folder.staging / "receipts").glob("part-*")):
            assert time.monotonic() < limit
            time.sleep(0.02)
        numbers.append(number)
        real(self, number, table, statistics)

    monkeypatch.setattr(correction.PartsOfRun, "write", write)
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


def test_slices_cover_all_numbers_once(monkeypatch):
    monkeypatch.setattr(Child, "run", lambda self, task: Lost("killed"))
    for count, processes in ((1, 4), (7, 2), (100, 3)):
        made, progress = [], []
        executors.make_parts(
            lambda numbers, made=made: made.extend(numbers),
            range(count),
            processes,
            progress.append,
        )
        # What was given to others is unmade: no more than one slice each.
        assert len(made) == len(set(made)) == sum(progress)
        size = -(-count // (processes * 3))
        assert len(made) >= count - (processes - 1) * size
