"""What is kept between runs saves time and nothing else."""

from __future__ import annotations

import json
import os
import random

import numpy as np
import pytest

from pipeline import caches
from pipeline.batch import kept
from pipeline.errors import LogError
from pipeline.stages import inputs
from pipeline.stages.story import run_mission

SEED = random.randrange(1 << 30)


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "unbend" / "kept"


def named(number: int) -> str:
    return f"log-{number:064x}"


def test_what_was_used_longest_ago_goes_first(cache, monkeypatch):
    values = [np.random.default_rng(number).random(1000) for number in range(4)]
    monkeypatch.setattr(kept, "MOST_BYTES", 3 * len(kept.packed(values[0])) + 100)
    for number, value in enumerate(values[:3]):
        kept.keep(named(number), value)
        os.utime(cache / named(number), (1000.0 + number,) * 2)
    assert np.array_equal(kept.recall(named(0)), values[0])  # used just now
    kept.keep(named(3), values[3])
    assert sorted(path.name for path in cache.iterdir()) == [named(0), named(2), named(3)]
    assert kept.recall(named(1)) is None
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache.parent))
    assert {what for what, _ in caches.cached()} == {"decoded logs"}
    caches.empty_caches()
    assert list(cache.iterdir()) == []


def test_without_a_cache_nothing_is_kept_and_nothing_fails(cache):
    cache.parent.mkdir(parents=True)
    cache.write_text("no folder")
    kept.keep(named(0), 1)
    assert kept.recall(named(0)) is None


def run_and_decode(mission, monkeypatch) -> tuple[int, dict]:
    """How often a run decodes its log, and its manifest."""
    decoded = []
    original = inputs.open_log
    with monkeypatch.context() as patch:
        patch.setattr(inputs, "open_log", lambda *words: decoded.append(1) or original(*words))
        run_mission(mission.save(), force=True)
    manifest = json.loads((mission.output / "manifest.json").read_text())
    return len(decoded), manifest


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_a_log_is_decoded_once_and_the_results_are_the_same(
    mission_factory, tmp_path, cache, monkeypatch, plain_report, kind
):
    mission = mission_factory(tmp_path / "mission", kind)
    first, whole = run_and_decode(mission, monkeypatch)
    again, same = run_and_decode(mission, monkeypatch)
    assert (first, again) == (1, 0)
    assert same == whole
    if kind != "bin":
        return
    (entry,) = cache.iterdir()
    content = bytearray(entry.read_bytes())
    place = random.Random(SEED).randrange(len(content) * 8)
    content[place // 8] ^= 1 << place % 8
    entry.write_bytes(content)
    assert run_and_decode(mission, monkeypatch) == (1, whole), SEED
    mission.config["ground"]["sigma_m"] = 1.5
    changed, other = run_and_decode(mission, monkeypatch)
    assert changed == 0
    assert other["outputs"] != whole["outputs"]
    # Content of another name is another log: whether it may be read depends on the name.
    mission.log.rename(mission.folder / "flight.tlog")
    mission.config["log"]["path"] = "flight.tlog"
    with pytest.raises(LogError, match="LOG-FORMAT"):
        run_and_decode(mission, monkeypatch)


def test_a_log_that_changed_is_decoded(mission, monkeypatch, plain_report):
    run_and_decode(mission, monkeypatch)
    with mission.log.open("ab") as log:
        log.write(b"\0")
    decoded, _ = run_and_decode(mission, monkeypatch)
    assert decoded == 1
