"""What is kept between runs saves time and nothing else."""

from __future__ import annotations

import gc
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import unbend
from unbend import caches
from unbend.batch import keys, value_cache
from unbend.batch.finished_run import verify_run
from unbend.batch.runs import mission_status, run_mission
from unbend.messages import Kind, Ledger
from unbend.stages import correction

PACKAGE = Path(unbend.__file__).parent


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "unbend" / "kept"


def named(number: int) -> str:
    return f"log-{number:064x}"


def test_what_was_used_longest_ago_goes_first(cache, monkeypatch):
    values = [np.random.default_rng(number).random(1000) for number in range(4)]
    monkeypatch.setattr(value_cache, "MOST_BYTES", 3 * len(value_cache.packed(values[0])) + 100)
    for number, value in enumerate(values[:3]):
        value_cache.keep(named(number), value)
        os.utime(cache / named(number), (1000.0 + number,) * 2)
    assert np.array_equal(value_cache.recall(named(0)), values[0])  # used just now
    value_cache.keep(named(3), values[3])
    assert sorted(path.name for path in cache.iterdir()) == [named(0), named(2), named(3)]
    assert value_cache.recall(named(1)) is None
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache.parent))
    assert {what for what, _ in caches.cached()} == {"decoded logs and figures"}
    caches.empty_caches()
    assert list(cache.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
@pytest.mark.filterwarnings("error")
def test_what_goes_while_the_folder_is_read_leaves_nothing_open(cache):
    """Another process renames its draft; an iterator left open would be a warning in any test."""
    cache.mkdir(parents=True)
    (cache / "gone").symlink_to(cache / "nowhere")
    value_cache.keep(named(0), 1)
    gc.collect()
    assert value_cache.recall(named(0)) == 1


class Attribute:
    """Written as Python before 3.11.4 writes members of enumerations."""

    def __init__(self, of, name):
        self.words = of, name

    def __reduce__(self):
        return getattr, self.words


def test_members_of_enumerations_are_read_as_older_pythons_wrote_them():
    assert value_cache.unpacked(value_cache.packed(Attribute(Kind, "LOSS"))) is Kind.LOSS
    for other in (Attribute(Kind, "mro"), Attribute(Ledger, "loss")):
        assert value_cache.unpacked(value_cache.packed(other)) is None


def test_without_a_cache_nothing_is_kept_and_nothing_fails(cache):
    cache.parent.mkdir(parents=True)
    cache.write_text("no folder")
    value_cache.keep(named(0), 1)
    assert value_cache.recall(named(0)) is None


def report_run(mission, monkeypatch) -> tuple[bool, dict[str, bytes]]:
    """Whether a run corrects anything, and all that is in its folder."""
    corrected = []
    original = correction.correct_batch
    with monkeypatch.context() as patch:
        patch.setattr(correction, "correct_batch", lambda *w: corrected.append(1) or original(*w))
        assert not run_mission(mission.save()).repeated
    return bool(corrected), {
        path.relative_to(mission.output).as_posix(): path.read_bytes()
        for path in sorted(mission.output.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def test_another_report_is_written_without_correcting_anything(mission, cache, monkeypatch):
    mission.config["output"]["batch_rows"] = 1000
    fresh, whole = report_run(mission, monkeypatch)
    assert fresh
    own = keys.code_below(PACKAGE)
    other = own | {"report": "other"}
    monkeypatch.setattr(keys, "code_of_package", lambda: other)
    text = "report: another version of unbend (0.2.0 -> 0.2.0); nothing is corrected again"
    assert mission_status(mission.file)[1] == [text]
    again, renewed = report_run(mission, monkeypatch)
    assert not again
    before = json.loads(whole["manifest.json"])["keys"]
    after = verify_run(mission.output)["keys"]
    assert [stage for stage in keys.STAGES if after[stage] != before[stage]] == ["report"]
    for name, content in whole.items():
        same = name not in ("report.html", "manifest.json")
        assert (renewed[name] == content) is same, name
    # The same bytes as when everything is made: with an empty cache, that is.
    caches.shutil.rmtree(cache)
    (mission.output / "report.html").unlink()
    again, made = report_run(mission, monkeypatch)
    assert again
    assert made == renewed
    # A report that is lost is written again, and so is one with another folder in its settings.
    (mission.output / "report.html").unlink()
    again, made = report_run(mission, monkeypatch)
    assert not again
    assert made == renewed
    # Corrections that are damaged are made again, and so are those of another ground.
    (mission.output / "observations" / "part-00000.parquet").unlink()
    again, made = report_run(mission, monkeypatch)
    assert again
    assert made == renewed
    mission.config["ground"]["sigma_m"] = 1.5
    assert report_run(mission, monkeypatch)[0]
    # The figures' own code is no wording: what it made is not taken up.
    monkeypatch.setattr(keys, "code_of_package", lambda: own | {"report": "3", "flown": "3"})
    assert report_run(mission, monkeypatch)[0]


def test_the_figures_read_no_file_beside_their_module():
    """Texts beside it are in no key of theirs."""
    assert "files(" not in (PACKAGE / "report" / "flown.py").read_text(encoding="utf-8")
