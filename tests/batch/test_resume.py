"""A correction that is stopped anywhere goes on where it was, and gives the same bytes."""

import contextlib
import errno
import os
import random
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.draws import SEED
from tests.helpers import refused
from tests.tables.observed import COLUMNS
from unbend.atmosphere import standard_atmosphere
from unbend.batch import store
from unbend.batch.input_files import check_unchanged
from unbend.batch.receipts import packed, unpacked
from unbend.batch.run_files import PartsOfRun, correct_into
from unbend.batch.store import find_damage, open_folder, read_manifest
from unbend.errors import StorageError
from unbend.messages import Ledger
from unbend.refraction.camera.camera import BrownConrady, Camera
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.stages.correction import correct_parts
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.ground_heights import GivenGround
from unbend.tables.manifest.whole import Manifest
from unbend.tables.observations import open_observations

from .conftest import hashes_in, plan_of

ROWS = 950
BATCH_ROWS = 100
PARTS = 10
MOST_THREADS = 4


class Killed(BaseException):
    """The process is gone: nothing is cleaned up after it."""


@pytest.fixture(scope="module")
def stream(tmp_path_factory) -> tuple[Any, CorrectionSetup]:
    """950 points of three images, and the air above them."""
    rng = np.random.default_rng(16)
    columns = {
        "image": rng.choice(["a", "b", "c", "unknown"], ROWS),
        "point": [f"p{number}" for number in range(ROWS)],
        "x_px": rng.uniform(0.0, 4000.0, ROWS),
        "y_px": rng.uniform(0.0, 3000.0, ROWS),
    }
    path = tmp_path_factory.mktemp("stream") / "o.parquet"
    pq.write_table(pa.table(columns), path)
    outside = np.full(3, 2.1e-4)
    exposures = Exposures(
        np.ones(3, bool),
        np.tile(np.diag([1.0, -1.0, -1.0]), (3, 1, 1)),
        np.full(3, 0.8),
        np.array([3000.0, 3100.0, 2900.0]),
        outside,
        outside,
    )
    camera = Camera(
        4000,
        3000,
        3000.0,
        3000.0,
        2000.0,
        1500.0,
        BrownConrady(0.0, 0.0, 0.0),
    )
    setup = CorrectionSetup(
        np.array(["a", "b", "c"], object),
        np.full(3, "nadir", object),
        exposures,
        GivenGround(200.0, np.zeros(3), sigma_m=2.0),
        {"nadir": camera},
        (rays_by(standard_atmosphere("us1976"), "spherical"),),
        np.zeros(3, np.int64),
    )
    return open_observations(path, COLUMNS, None, Ledger()), setup


def receipts_in(out):
    """The receipts of the parts that a run has finished."""
    return sorted((out / ".staging" / "receipts").glob("part-*.parquet"))


def run(stream, out, key="key", batch_rows=BATCH_ROWS, **options):
    """A run that is a correction and nothing else; its manifest holds all that was counted."""
    observations, setup = stream
    with open_folder(out) as folder:
        folder.resume(key)
        parts = PartsOfRun(folder, **options)
        counted = correct_into(parts, observations, setup, batch_rows=batch_rows, metadata={})
        values = {
            "fingerprint": key,
            "mission": "m",
            "exit_code": 0,
            "outputs": [asdict(output) for output in folder.outputs()],
            "correction": asdict(counted.correction()),
            "sampled": counted.examples,
            "rows": counted.sampled_rows().x_px.tolist(),
        }
        folder.commit(Manifest(values))


class Disk:
    """Counts what a run does to the disk; from a step on, or once, that goes wrong."""

    def __init__(self, patch, wrong=None, at=-1, lasting=False):
        self.steps = 0
        self.parts = 0
        self.failed = False
        self._wrong = wrong
        self._at = at
        self._lasting = lasting
        self._wrap(patch, os, "fsync")
        for name in ("replace", "mkdir", "unlink", "write_bytes", "write_text"):
            self._wrap(patch, Path, name)
        self._wrap(patch, store.shutil, "rmtree")
        self._wrap(patch, pq, "write_table")

    def _wrap(self, patch, owner, name):
        original = getattr(owner, name)

        def called(*words, **options):
            self.steps += 1
            self.parts += name == "write_table"
            if (self.failed and self._lasting) or self.steps == self._at:
                self.failed = True
                if name == "write_table":  # half a file
                    shutil.copy(__file__, words[1])
                if not (options.get("ignore_errors") and isinstance(self._wrong, OSError)):
                    raise self._wrong
            return original(*words, **options)

        patch.setattr(owner, name, called)


@pytest.fixture(scope="module")
def untouched(stream, tmp_path_factory):
    """The results of a run that nothing stopped, and how many steps it took on the disk."""
    out = tmp_path_factory.mktemp("untouched")
    with pytest.MonkeyPatch.context() as patch:
        disk = Disk(patch)
        run(stream, out)
    assert disk.parts == PARTS
    return hashes_in(out), disk.steps


def drawn_steps(steps, count=6):
    """Steps at which something goes wrong; with UNBEND_KILLS=all every one."""
    every = range(1, steps + 1)
    if os.environ.get("UNBEND_KILLS") == "all":
        return list(every)
    return random.Random(SEED).sample(every, count)


@pytest.mark.parametrize(
    ("has_results", "more_steps"),
    [(False, 0), (True, 14)],
    ids=["nothing", "results"],
)
def test_a_run_that_is_killed_goes_on_where_it_was(
    stream, untouched, tmp_path, has_results, more_steps
):
    whole, steps = untouched
    for step in drawn_steps(steps + more_steps):
        out = tmp_path / str(step)
        if has_results:  # of another size, so that their parts are others of the same names
            run(stream, out, "before", 70)
        with pytest.MonkeyPatch.context() as patch:
            disk = Disk(patch, Killed(), step, lasting=True)
            with contextlib.suppress(Killed):
                run(stream, out)
        manifest = read_manifest(out)
        if manifest is not None:
            assert find_damage(out, manifest) == []
        finished = len(receipts_in(out))
        committed = manifest is not None and manifest.run.fingerprint == "key"
        if not committed:
            assert disk.parts - finished <= MOST_THREADS, (step, SEED)
        parts = parts_made(stream, out)
        if not committed:
            assert parts == PARTS - finished, (step, SEED)
        assert hashes_in(out) == whole, (step, SEED)


@pytest.mark.parametrize("lasting", [True, False], ids=["lasting", "once"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS])
def test_a_disk_that_refuses_leaves_what_is_finished(stream, untouched, tmp_path, number, lasting):
    whole, steps = untouched
    for step in drawn_steps(steps, count=2):
        out = tmp_path / str(step)
        refusal = None
        with pytest.MonkeyPatch.context() as patch:
            disk = Disk(patch, OSError(number, os.strerror(number)), step, lasting)
            try:
                run(stream, out)
            except StorageError as error:
                refusal = error
        if not disk.failed:  # threads met at folders: this run took fewer steps than was counted
            assert steps - 2 * MOST_THREADS <= disk.steps < step, (step, SEED)
            continue
        if refusal is None:  # while it cleaned up: then all was done
            assert {*hashes_in(out)} >= {*whole}, (step, SEED)
        else:
            assert os.strerror(number) in refusal.what, (step, SEED)
            manifest = read_manifest(out)  # which is the last but for what cleans up
            assert manifest is None or find_damage(out, manifest) == [], (step, SEED)
        if not lasting:
            assert not [*out.rglob("*.draft")], (step, SEED)
        run(stream, out)
        assert hashes_in(out) == whole, (step, SEED)


def stopped_after(stream, out, parts, **options):
    """A run that is stopped after some of its parts."""

    def check():
        if len(receipts_in(out)) >= parts:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(stream, out, check=check, **options)


def parts_made(stream, out, **options):
    """How many parts a run makes."""
    with pytest.MonkeyPatch.context() as patch:
        disk = Disk(patch)
        run(stream, out, **options)
    return disk.parts


@pytest.mark.parametrize(
    "other",
    [{"key": "of another air"}, {"batch_rows": 95, "key": "key 95"}],
    ids=["key", "size"],
)
def test_parts_of_another_key_are_made_again(stream, untouched, tmp_path, other):
    stopped_after(stream, tmp_path, 4, **other)
    assert receipts_in(tmp_path)
    assert parts_made(stream, tmp_path) == PARTS
    assert hashes_in(tmp_path) == untouched[0]


def flip_a_bit(path, other):
    content = bytearray(path.read_bytes())
    place = random.Random(SEED).randrange(len(content) * 8)
    content[place // 8] ^= 1 << place % 8
    path.write_bytes(content)


def cut_short(path, other):
    path.write_bytes(path.read_bytes()[:-1])


def swap(path, other):
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def copy_other(path, other):
    shutil.copy(other, path)


def remove(path, other):
    path.unlink()


@pytest.mark.parametrize(
    ("folder", "damage", "made_again"),
    [
        ("observations", flip_a_bit, 1),
        ("observations", cut_short, 1),
        ("observations", swap, 2),
        ("observations", remove, 1),
        ("receipts", flip_a_bit, 1),
        ("receipts", copy_other, 1),
    ],
)
def test_a_part_that_was_damaged_meanwhile_is_made_again(
    stream, untouched, tmp_path, folder, damage, made_again
):
    stopped_after(stream, tmp_path, 4)
    receipts = receipts_in(tmp_path)
    files = tmp_path / ".staging" / folder
    damage(files / receipts[0].name, files / receipts[1].name)
    missing = PARTS - len(receipts)
    assert parts_made(stream, tmp_path) == missing + made_again, SEED
    assert hashes_in(tmp_path) == untouched[0]


def test_a_receipt_runs_nothing(tmp_path):
    class Hostile:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "made"),))

    class Ours:
        def __reduce__(self):
            return (store.sync_folder, (tmp_path / "nowhere",))

    for hostile in (Hostile(), Ours(), np.array([Hostile()], object)):
        assert unpacked(packed(hostile)) is None
    assert list(tmp_path.iterdir()) == []
    plain = {"a": np.arange(3.0), "b": [(1, None)]}
    assert repr(unpacked(packed(plain))) == repr(plain)


def test_no_receipt_is_written_for_inputs_that_changed(mission):
    """Otherwise a run with the former content would take up parts of the other one."""
    plan = plan_of(mission)
    check_unchanged(plan.inputs)
    observations = plan.input("observations")
    time_ns = observations.states[0].mtime_ns
    flip_a_bit(observations.path, observations.path)
    os.utime(observations.path, ns=(time_ns, time_ns))
    with refused("INPUT-CHANGED"):
        check_unchanged(plan.inputs, folders=False)


def test_parts_may_be_made_by_others_in_any_order(stream, untouched, tmp_path):
    """Ranges of parts; the counts are merged in the order of the parts."""
    observations, setup = stream
    with open_folder(tmp_path) as folder:
        folder.resume("key")
        for numbers in (range(7, 10), range(2, 5), range(2)):
            elsewhere = PartsOfRun(store.RunFolder(tmp_path))
            made = correct_parts(
                observations,
                setup,
                elsewhere.write,
                numbers=numbers,
                batch_rows=BATCH_ROWS,
                metadata={},
            )
            assert [counts.rows for counts in made]
        parts = PartsOfRun(folder)
        counted = correct_into(parts, observations, setup, batch_rows=BATCH_ROWS, metadata={})
        assert counted.parts == PARTS
        assert counted.rows == ROWS
        hashes = {output.name: output.sha256 for output in folder.outputs()}
        assert list(hashes) == [
            f"observations/part-{number:05d}.parquet" for number in range(PARTS)
        ]
        whole, _ = untouched
        for name, sha256 in hashes.items():
            assert sha256 == whole[name]
