"""What a mission file says of slant ranges, and of the direction of the correction."""

import pytest
import yaml

from unbend.config import Mission

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


def changed(**changes):
    return yaml.safe_load(BASE) | changes


def test_heights_from_distances_need_no_reference(load):
    ground = load(changed()).ground
    assert ground.from_distance
    assert ground.reference == "msl"
    assert (ground.column, ground.constant_m) == (None, None)
    ground_with_reference = load(
        changed(ground={"height": "from_distance", "reference": "msl"})
    ).ground
    assert ground_with_reference == ground


@pytest.mark.parametrize("more", [{"reference": "ellipsoid"}, {"home_h_msl_m": 500.0}])
def test_what_would_have_no_effect_is_refused(invalid, more):
    assert "above mean sea level" in invalid(changed(ground={"height": "from_distance"} | more))


def test_intersected_heights_are_above_mean_sea_level_and_may_say_so(load, invalid):
    """The manifest says so, and `unbend init` asks for the reference before it knows the height."""
    ground = load(changed(ground={"height": "intersected"})).ground
    assert ground.reference == "msl"
    assert load(changed(ground={"height": "intersected", "reference": "msl"})).ground == ground
    words = invalid(changed(ground={"height": "intersected", "reference": "ellipsoid"}))
    assert "height: intersected gives heights above mean sea level" in words


@pytest.mark.parametrize(
    "changes",
    [
        {"ground": {"height": "from_distance"}},
        {"ground": {"height": "intersected"}},
        {"refraction": {"direction": "apply"}},
    ],
)
def test_a_mission_is_understood_again_from_the_manifest_of_its_run(load, changes):
    """`unbend export` reads it there; defaults that were filled in are then stated."""
    mission = load(changed(**changes))
    again = Mission.model_validate_json(mission.model_dump_json())
    assert again.model_dump() == mission.model_dump()


@pytest.mark.parametrize("height", [450.0, 450, {"column": "h"}])
def test_other_heights_keep_their_reference(load, invalid, height):
    words = invalid(changed(ground={"height": height}))
    assert "ground.reference: is missing" in words
    ground = load(changed(ground={"height": height, "reference": "ellipsoid"})).ground
    assert not ground.from_distance
    assert (ground.column, ground.constant_m) == (
        ("h", None) if isinstance(height, dict) else (None, 450.0)
    )
