"""What a mission file says of slant ranges, and of the direction of the correction."""

import pytest
import yaml

from unbend.config import Mission, load_mission
from unbend.errors import ConfigError

BASE = """
mission: {name: survey}
log: {path: a.bin}
observations: {path: o.parquet, columns: {distance_m: range}}
cameras:
  nadir: {width_px: 100, height_px: 100, f_px: 200.0, cx_px: 50.0, cy_px: 50.0,
          calibration: laboratory}
mount: {nadir: {}}
events: {log: {nadir: {image: "n{n}"}}}
ground: {height: from_distance}
output: {path: results}
"""


@pytest.fixture
def load(tmp_path):
    def attempt(**changes) -> Mission:
        path = tmp_path / "mission.yaml"
        path.write_text(yaml.safe_dump(yaml.safe_load(BASE) | changes), "utf-8")
        return load_mission(path)

    return attempt


def refused(load, **changes) -> str:
    with pytest.raises(ConfigError) as refusal:
        load(**changes)
    assert refusal.value.code == "CONFIG-INVALID"
    return refusal.value.what


def test_heights_from_distances_need_no_reference(load):
    ground = load().ground
    assert ground.from_distance
    assert ground.reference == "msl"
    assert (ground.column, ground.constant_m) == (None, None)
    ground_with_reference = load(ground={"height": "from_distance", "reference": "msl"}).ground
    assert ground_with_reference == ground


@pytest.mark.parametrize("more", [{"reference": "ellipsoid"}, {"home_h_msl_m": 500.0}])
def test_what_would_have_no_effect_is_refused(load, more):
    assert "above mean sea level" in refused(load, ground={"height": "from_distance"} | more)


def test_intersected_heights_are_above_mean_sea_level_and_may_say_so(load):
    """The manifest says so, and `unbend init` asks for the reference before it knows the height."""
    ground = load(ground={"height": "intersected"}).ground
    assert ground.reference == "msl"
    assert load(ground={"height": "intersected", "reference": "msl"}).ground == ground
    words = refused(load, ground={"height": "intersected", "reference": "ellipsoid"})
    assert "height: intersected gives heights above mean sea level" in words


@pytest.mark.parametrize("height", ["from_distance", "intersected"])
def test_a_mission_is_understood_again_from_the_manifest_of_its_run(load, height):
    """`unbend export` reads it there; defaults that were filled in are then stated."""
    mission = load(ground={"height": height})
    again = Mission.model_validate_json(mission.model_dump_json())
    assert again.model_dump() == mission.model_dump()


def test_heights_from_distances_need_the_column(load):
    words = refused(load, observations={"path": "o.parquet"})
    assert "observations.columns.distance_m" in words


@pytest.mark.parametrize("height", [450.0, 450, {"column": "h"}])
def test_other_heights_keep_their_reference(load, height):
    words = refused(load, ground={"height": height})
    assert "ground.reference: is missing" in words
    ground = load(ground={"height": height, "reference": "ellipsoid"}).ground
    assert not ground.from_distance
    assert (ground.column, ground.constant_m) == (
        ("h", None) if isinstance(height, dict) else (None, 450.0)
    )


@pytest.mark.parametrize("height", ["from_distances", "range", {"distance": True}, [450.0], True])
def test_another_word_for_it_is_refused(load, height):
    with pytest.raises(ConfigError) as refusal:
        load(ground={"height": height, "reference": "msl"})
    assert "ground.height" in refusal.value.what


def test_a_distance_may_stand_beside_heights(load):
    mission = load(ground={"height": 450.0, "reference": "msl"})
    assert mission.observations.columns.distance_m == "range"


def test_the_direction(load):
    assert load().refraction.direction == "remove"
    assert load(refraction={"direction": "apply"}).refraction.direction == "apply"
    assert "refraction.direction" in refused(load, refraction={"direction": "add"})


def test_the_mission_survives_its_manifest(load):
    mission = load(refraction={"direction": "apply"})
    again = Mission.model_validate_json(mission.model_dump_json())
    assert again.model_dump() == mission.model_dump()
