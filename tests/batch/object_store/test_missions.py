"""Missions whose inputs and results are in object storage, through the command line."""

import json
import shutil
import subprocess
import sys
from itertools import chain, repeat
from unittest.mock import Mock

import pyarrow.parquet as pq
import pytest

from tests.batch.conftest import plan_of
from tests.conftest import Ended
from tests.helpers import refused
from unbend.batch import results as results_module
from unbend.batch import runs
from unbend.batch.object_store import Place
from unbend.batch.plan import fetch_inputs
from unbend.batch.remote import Publication, find_damage, read_manifest, would_replace
from unbend.batch.runs import run_mission

pytestmark = pytest.mark.usefixtures("plain_report")


@pytest.fixture
def stored(mission, s3_place):
    """The mission with its log, observations and results at URLs."""
    for name in ("flight.bin", "observations.parquet"):
        assert (s3_place / name).put(mission.folder / name, None)
        (mission.folder / name).unlink()
    mission.config["log"]["path"] = str(s3_place / "flight.bin")
    mission.config["observations"]["path"] = str(s3_place / "observations.parquet")
    mission.config["output"]["path"] = str(s3_place / "results")
    return mission


@pytest.fixture
def reasons(stored, obeyed):
    """Why the mission would run."""

    def of_status():
        (mission,) = json.loads(obeyed("status", stored.file, "--json"))
        return mission["reasons"]

    return of_status


@pytest.fixture
def run(stored):
    """Runs the mission, which must end well; what is said."""

    def run_stored(*options) -> Ended:
        ended = stored.run(*options)
        assert ended.code == 0, ended.text
        return ended

    return run_stored


def content_of(place):
    content, _ = place.read()
    return content


def test_a_mission_in_object_storage(
    stored, run, reasons, s3_place, baseline, tmp_path, obeyed, refusal_of
):
    results = s3_place / "results"
    ended = run()
    manifest = read_manifest(results)
    assert manifest.run.mission_file == ""  # a path on this machine
    attempt = results / f"attempts/{manifest.run.attempt}"
    assert f"results  {results}\n  report   {attempt}/report.html\n" in ended.out
    # The observations are those of a run in a folder, byte for byte.
    for name in ("observations/part-00000.parquet", "stations.parquet", "profile.parquet"):
        assert content_of(attempt / name) == (baseline.output / name).read_bytes(), name
    assert manifest.values["observations"] == baseline.manifest()["observations"]
    assert set(results.objects()) == {
        "manifest.json",
        f"runs/{manifest.run.fingerprint}.json",
        *(f"attempts/{manifest.run.attempt}/{item.name}" for item in manifest.run.outputs),
    }
    text = content_of(results / "manifest.json").decode() + ended.text
    assert "not-to-be-printed" not in text
    assert str(tmp_path) not in text.replace(str(stored.file), "")

    assert reasons() == []
    assert json.loads(run("--json").out)[0]["repeated"] is True
    obeyed("verify", results)
    assert not any((tmp_path / "cache/unbend/results").rglob("*.parquet")), "published and removed"

    # Repeated with the copies gone: their hashes are remembered by version, nothing is copied.
    copies = tmp_path / "cache/unbend/copies"
    shutil.rmtree(copies)
    assert json.loads(run("--json").out)[0]["repeated"] is True
    assert not copies.exists()

    there = tmp_path / "there.geojson"
    here = tmp_path / "here.geojson"
    obeyed("export", results, "--format", "geojson", "--out", there)
    obeyed("export", baseline.output, "--format", "geojson", "--out", here)
    assert there.read_text() == here.read_text()
    url = s3_place / "f.geojson"
    refusal_of("URL-INVALID", 2, "export", results, "--format", "geojson", "--out", url)

    # A changed input: the new run takes the place of the old, of which nothing stays.
    table = pq.read_table(baseline.folder / "observations.parquet")
    pq.write_table(table.slice(0, table.num_rows - 1), tmp_path / "own.parquet")
    observations = s3_place / "observations.parquet"
    assert observations.put(tmp_path / "own.parquet", "overwrite")
    (reason,) = reasons()
    assert f"observations changed ({observations})" in reason
    run()
    now = read_manifest(results)
    assert now.results.observations.rows == manifest.results.observations.rows - 1
    assert {name.split("/")[1] for name in results.objects() if "/" in name} == {
        now.run.attempt,
        f"{now.run.fingerprint}.json",
    }


def test_a_publication_that_was_cut_off_is_finished_without_a_run(stored, s3_place, monkeypatch):
    results = s3_place / "results"
    with monkeypatch.context() as patch:
        patch.setattr(Publication, "publish", killed)
        with pytest.raises(ZeroDivisionError):
            run_mission(stored.save())
    assert read_manifest(results) is None
    monkeypatch.setattr(runs, "prepare", killed)
    done = run_mission(stored.save())
    assert find_damage(results, done.manifest) == []
    with pytest.raises(ZeroDivisionError):
        run_mission(stored.save(), force=True)


def killed(*_, **__):
    raise ZeroDivisionError


def test_results_damaged_in_the_store_are_found_and_made_again(
    stored, run, reasons, s3_place, unbend, obeyed
):
    results = s3_place / "results"
    run()
    attempt = results / f"attempts/{read_manifest(results).run.attempt}"
    stations = attempt / "stations.parquet"
    content = bytearray(content_of(stations))
    content[len(content) // 2] ^= 1
    assert stations.put(bytes(content), "overwrite")

    verified = unbend("verify", results)
    assert verified.code == 5
    assert "stations.parquet: its content has changed" in verified.err

    out = stored.folder / "f.geojson"
    exported = unbend("export", results, "--format", "geojson", "--out", out)
    assert exported.code == 5, "damage is exported"

    attempt.remove(["profile.parquet"])
    assert reasons() == ["profile.parquet: is missing"]
    run()
    obeyed("verify", results)


@pytest.mark.parametrize("is_half_removed", [False, True])
def test_results_that_are_replaced_while_they_are_exported(
    run, s3_place, monkeypatch, obeyed, tmp_path, is_half_removed
):
    """A manifest is read whose attempt is gone when its files are."""
    results = s3_place / "results"
    run()
    newer = read_manifest(results)
    older = "0" * 32
    if is_half_removed:
        assert (results / f"attempts/{older}/stations.parquet").put(b"x", None)
    # Between two requests of an export nothing else can come.
    answers = chain([newer.with_values({"attempt": older})], repeat(newer))
    monkeypatch.setattr(results_module, "read_manifest", Mock(side_effect=answers))

    obeyed("export", results, "--format", "geojson", "--out", tmp_path / "o.geojson")


def test_results_whose_attempt_is_gone_are_damaged(run, s3_place, refusal_of, tmp_path):
    results = s3_place / "results"
    run()
    manifest = read_manifest(results)
    attempt = results / f"attempts/{manifest.run.attempt}"
    attempt.remove(output.name for output in manifest.run.outputs)
    out = tmp_path / "gone.geojson"
    refusal_of("VERIFY-DAMAGED", 5, "export", results, "--format", "geojson", "--out", out)


@pytest.mark.parametrize("when", ["before", "while"])
def test_an_input_that_changes_meanwhile_is_refused(stored, s3_place, monkeypatch, when):
    log = s3_place / "flight.bin"
    prepare = runs.prepare

    def change(plan, *arguments):
        if when == "while":
            prepared = prepare(plan, *arguments)
        assert log.put(content_of(log) + b"\0", "overwrite")
        if when == "before":
            shutil.rmtree(plan.input("log").path.parent)
            prepare(plan, *arguments)
        return prepared

    monkeypatch.setattr(runs, "prepare", change)
    assert str(log) in stored.refusal("INPUT-CHANGED")
    assert set((s3_place / "results").objects()) == set()


def test_a_damaged_copy_is_made_again(stored, s3_place):
    plan = plan_of(stored)
    copy = plan.input("log").path
    content = copy.read_bytes()
    copy.write_bytes(content[:-1] + b"\0\0")
    fetch_inputs(plan)
    assert copy.read_bytes() == content


def test_refusals_name_urls_and_not_copies(stored, s3_place, tmp_path):
    log = s3_place / "flight.bin"
    assert log.put(b"no log at all" * 100, "overwrite")
    text = stored.refusal("LOG-FORMAT")
    assert str(log) in text
    assert str(tmp_path / "cache") not in text


def test_missions_that_would_share_a_place(stored, run, mission_factory, s3_place, refusal_of):
    other = mission_factory(stored.folder / "other")
    other.config["output"]["path"] = f"{stored.config['output']['path']}/"
    refusal_of("OUTPUT-SHARED", 6, "check", stored.save(), other.save())
    # And one that is not in the same command finds whose results they are.
    run()
    manifest = s3_place / "results/manifest.json"
    before = manifest.read()
    other.config["mission"]["name"] = "other"
    refusal_of("OUTPUT-OTHER", 2, "run", other.save(), "--force")
    assert manifest.read() == before


def test_an_input_among_the_results_is_refused(stored, s3_place):
    for path in (s3_place, s3_place / "flight.bin/attempts"):
        stored.config["output"]["path"] = str(path)
        assert plan_of(stored).output == path

    results = s3_place / "results"
    log = results / "runs/flight.bin"
    assert log.put(b"log", None)
    stored.config["log"]["path"] = str(log)
    stored.config["output"]["path"] = str(results)
    with refused("OUTPUT-OVER-INPUT"):
        plan_of(stored)

    folder = Place.of(f"{s3_place}/")
    assert would_replace(results, folder), "results below a folder that is read"
    assert would_replace(s3_place, folder), "results in a folder that is read"
    assert not would_replace(results, s3_place / "results.bin")


def test_a_url_costs_no_import_where_none_is_used():
    code = "import unbend.batch.remote, unbend.batch.plan, sys; print('obstore' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
