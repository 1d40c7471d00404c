"""A finished run whose mission file or inputs have changed since."""

import pytest
import yaml

from tests.helpers import one_line
from unbend.batch.finished_run.later_changes import notes_on_changes
from unbend.batch.results import read_manifest
from unbend.batch.runs import run_mission
from unbend.config.campaign import open_configs

pytestmark = pytest.mark.usefixtures("plain_report", "settled_inputs")


@pytest.fixture
def done(mission):
    """A mission that was run."""
    run_mission(mission.save())
    return mission


def changes(mission, output="results"):
    """The warnings on a run of a mission, as texts."""
    results = mission.folder / output
    manifest = read_manifest(results)
    return [entry.what for entry in notes_on_changes(results, manifest)]


def test_nothing_has_changed(done):
    assert changes(done) == []


def test_each_change_is_named(done):
    done.config["ground"]["sigma_m"] = 1.5
    done.save()
    with done.log.open("ab") as log:
        log.write(b"\0")

    (text,) = changes(done)

    log_name = done.config["log"]["path"]
    expected = f"before these changes: ground.sigma_m: nothing -> 1.5; log changed ({log_name}); "
    assert expected in text
    assert f"`unbend run {done.file}`" in text


def test_of_many_changes_five_are_named(done):
    for number, key in enumerate(("title", "client", "operator", "remarks")):
        done.config["mission"][key] = f"text {number}"
    done.config["cameras"]["nadir"]["fx_px"] += 1.0
    done.config["cameras"]["nadir"]["fy_px"] += 1.0
    done.save()

    (text,) = changes(done)

    assert text.count(" -> ") == 5
    assert "; and 1 more; " in text


@pytest.mark.parametrize("role", ["temperature", "airspeed"])
def test_a_null_that_is_stated_now(done, role):
    done.config["log"]["channels"].pop(role, None)
    run_mission(done.save())
    done.config["log"]["channels"][role] = None
    done.save()
    (text,) = changes(done)
    assert "a key is stated as null now, or is no longer" in text


def test_the_size_of_batches_is_no_change(done):
    done.config["output"]["batch_rows"] = 10_000
    done.save()
    assert changes(done) == []


def test_a_mission_file_that_is_refused_now(done):
    done.file.write_text("mission: [", "utf-8")
    (text,) = changes(done)
    assert "the mission file is refused now (CONFIG-" in text


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("output", "path", "of-another-day"),
        ("mission", "name", "another-flight"),
        ("log", "path", "archived.bin"),
    ],
)
def test_a_mission_file_that_is_used_for_something_else(done, section, key, value):
    """Or an input that is no longer there: results are often kept without their log."""
    done.config[section][key] = value
    done.config["ground"]["sigma_m"] = 1.5
    done.save()
    assert changes(done) == []


def test_results_without_their_mission_file(done):
    done.file.unlink()
    assert changes(done) == []


def test_a_folder_of_results_with_an_absolute_path(mission):
    mission.config["output"]["path"] = str(mission.folder / "results")
    run_mission(mission.save())
    assert read_manifest(mission.output).run.mission_file == ""
    assert changes(mission) == []


def test_a_default_of_the_campaign_counts(mission):
    """Run by the campaign, the mission has the campaign's defaults too."""
    mission.config["mission"]["name"] = "flight-1"
    mission.config["output"]["path"] = "results/flight-1"
    mission.save()
    campaign = {
        "campaign": {"name": "season", "output": "results"},
        "defaults": {"log": {"max_gap_s": 1.0}},
        "missions": ["mission.yaml"],
    }
    season = mission.folder / "season.yaml"
    season.write_text(yaml.safe_dump(campaign), "utf-8")
    (of_campaign,), _ = open_configs([season])
    run_mission(of_campaign)
    assert read_manifest(mission.output).run.mission_file == "../../season.yaml"
    assert changes(mission, "results/flight-1") == []

    campaign["defaults"]["log"]["max_gap_s"] = 2.0
    season.write_text(yaml.safe_dump(campaign), "utf-8")

    (text,) = changes(mission, "results/flight-1")
    assert "log.max_gap_s: 1.0 -> 2.0" in text


@pytest.mark.parametrize(
    "command",
    [
        ("export", "--format", "kml", "--out", "stations.kml"),
        ("report",),
    ],
)
def test_commands_warn(done, obeyed, monkeypatch, tmp_path, command):
    monkeypatch.chdir(tmp_path)
    done.config["ground"]["sigma_m"] = 1.5
    done.save()
    name, *options = command
    shown = one_line(obeyed(name, done.output, *options))
    assert "warning EXPORT-STALE: this is from the run before these changes" in shown
