"""What is read of a manifest: records, and the refusal of what is none."""

import json
from dataclasses import asdict

import pytest

from tests.helpers import refused
from unbend.config import Mission
from unbend.refraction.effect import Effect
from unbend.tables.manifest.results import EffectRecord, FittedSource, OtherSource
from unbend.tables.manifest.run import Identity, RunRecord
from unbend.tables.manifest.whole import Manifest


@pytest.fixture
def values(baseline):
    """The manifest of a run, as its file has it."""
    return baseline.manifest()


def test_the_effect_of_the_air():
    """10 urad for 8 in the standard, sigma 0.4: 2.0626 and 1.6501 arcsec, factor 1.25 +- 0.05."""
    effect = Effect(45.0, 6000.04, 200.0, 10e-6, 8e-6, 0.4e-6)

    record = EffectRecord.of(effect)

    assert asdict(record) == {
        "nadir_angle_deg": 45.0,
        "h_c_m": 6000.0,
        "h_g_m": 200.0,
        "r_c_arcsec": 2.0626,
        "standard_arcsec": 1.6501,
        "sigma_arcsec": 0.0825,
        "factor": 1.25,
        "sigma_factor": 0.05,
    }
    unknown = EffectRecord.of(Effect(45.0, 6000.0, 200.0, 10e-6, 8e-6))
    assert unknown.sigma_arcsec is unknown.sigma_factor is None


def test_the_records_hold_all_that_the_file_holds(values):
    """Written again they give the same values, and no key is without a field."""
    manifest = Manifest(values)

    run = asdict(manifest.run)
    assert run.pop("attempt") == ""
    assert run | manifest.results.row() == values
    sources = manifest.results.profile.sources
    assert {type(source) for source in sources} == {FittedSource, OtherSource}


def test_what_the_report_reads_of_a_mission_file_are_keys_of_it(values):
    mission = Mission.model_validate_json(json.dumps(values["config"]))

    sections = Manifest(values).sections

    assert sections.refraction.method == mission.refraction.method
    assert sections.refraction.direction == mission.refraction.direction
    assert sections.stations.use_suspect == mission.stations.use_suspect
    assert sections.cameras.keys() == mission.cameras.keys()
    for name, camera in sections.cameras.items():
        in_file = mission.cameras[name]
        has_distance = camera.principal_distance is not None
        assert has_distance == (in_file.principal_distance is not None)
        for quantity, value in vars(camera.window).items():
            assert value == getattr(in_file.window, quantity)


def test_what_a_later_version_adds_is_kept_and_not_read(values):
    values["correction"]["later"] = 1
    values["later"] = {"a": 2}

    manifest = Manifest(values)

    assert manifest.results.correction.shift_px.count == 59
    changed = manifest.with_values({"mission_file_sha256": "x"})
    assert changed.values["later"] == {"a": 2}


def test_what_an_older_version_did_not_write_is_empty():
    old = {
        "mission": "m",
        "fingerprint": "f",
        "exit_code": 0,
        "outputs": [],
    }

    run = Manifest(old).run

    assert run == RunRecord(mission="m", fingerprint="f", exit_code=0)
    assert isinstance(run, Identity)
    assert run.inputs == []
    assert run.config == run.versions == {}
    log = {"role": "log", "name": "n", "sha256": "s"}
    assert Manifest(old | {"inputs": [log]}).run.inputs


@pytest.mark.parametrize(
    "wrong",
    [
        {"shift_px": None},
        {"shift_px": {"count": "many"}},
        {},
    ],
)
def test_results_that_lack_something_are_refused_with_their_file(values, wrong):
    values["correction"] = wrong
    with refused("MANIFEST-UNREADABLE") as refusal:
        _ = Manifest(values, "out/manifest.json").results
    assert refusal.value.where == "out/manifest.json"
