"""`status`: what would run, and why."""

import json
from types import SimpleNamespace

import pytest

from unbend.batch import fingerprint
from unbend.batch.differences import changed_inputs, changed_versions
from unbend.batch.runs import mission_status, run_mission


@pytest.fixture
def done(mission, monkeypatch, tmp_path):
    """A mission that was run."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    run_mission(mission.save())
    return mission


def reasons(mission):
    return mission_status(mission.save())[1]


def test_unchanged(done):
    assert reasons(done) == []


def test_a_mission_that_never_ran(mission):
    assert reasons(mission) == [f"{mission.output} has no results of it"]


def test_each_change_is_named(done, monkeypatch):
    done.config["ground"]["sigma_m"] = 1.5
    assert reasons(done) == ["ground.sigma_m: nothing -> 1.5"]
    with done.log.open("ab") as log:
        log.write(b"\0")
    changed = f"log changed ({done.config['log']['path']})"
    assert reasons(done) == [changed, "ground.sigma_m: nothing -> 1.5"]
    del done.config["ground"]["sigma_m"]
    original = fingerprint.version
    monkeypatch.setattr(fingerprint, "version", lambda n: "0.1" if n == "numpy" else original(n))
    assert reasons(done) == [changed, f"numpy {original('numpy')} -> 0.1"]


def test_another_source_code_of_unbend(done, monkeypatch):
    monkeypatch.setattr(fingerprint, "code_hash", lambda: "other")
    assert reasons(done) == ["another source code of unbend 0.2.0"]


def test_a_later_version_of_unbend():
    before = {"unbend": "0.1.0", "code_sha256": "earlier"}
    now = {"unbend": "0.2.0", "code_sha256": "other"}
    assert list(changed_versions(now, before)) == ["another version of unbend (0.1.0 -> 0.2.0)"]


def test_the_size_of_batches_changes_no_number(done):
    done.config["output"]["batch_rows"] = 10_000
    assert reasons(done) == []
    assert run_mission(done.save()).repeated


def test_results_that_are_gone(done):
    (done.output / "report.html").unlink()
    assert reasons(done) == ["report.html: is missing"]


def test_a_manifest_without_its_inputs_is_no_bug(done):
    """That of another version may lack what says why; the mission would run."""
    manifest = done.manifest() | {"fingerprint": "0"}
    del manifest["inputs"]
    (done.output / "manifest.json").write_text(json.dumps(manifest))
    assert f"log is new ({done.config['log']['path']})" in reasons(done)
    assert not run_mission(done.save()).repeated
    assert reasons(done) == []


def test_inputs_that_come_and_go_are_named():
    plan = SimpleNamespace(
        inputs=[
            SimpleNamespace(role="log", sha256="1", name="a.bin"),
            SimpleNamespace(role="observations", sha256="2", name="o.csv"),
            SimpleNamespace(role="geoid", sha256="3", name="g.tif"),
        ]
    )
    before = [
        SimpleNamespace(role="log", sha256="0"),
        SimpleNamespace(role="observations", sha256="2"),
        SimpleNamespace(role="sounding 1", sha256="4"),
    ]
    assert list(changed_inputs(plan, before)) == [
        "sounding 1 is no longer read",
        "log changed (a.bin)",
        "geoid is new (g.tif)",
    ]
