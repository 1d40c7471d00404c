"""Spoilt mission files: each mistake in a sentence of one's own, none in pydantic's words."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from unbend.config import Mission, load_mission
from unbend.config.mistakes import sentences_of
from unbend.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
BASE = yaml.safe_load((ROOT / "configs" / "sample_bin.yaml").read_text(encoding="utf-8"))
BASE |= {
    "stations": {"trajectory": {"path": "a.pos", "point": "antenna", "lever_arm_m": [0.0] * 3}},
    "atmosphere": {"soundings": [{"path": "s.csv"}], "surface": [{"h_msl_m": 4.0, "metar": "M"}],
                   "sensors": {"gnss": {"sigma_height_m": 1.0}}},
    "accept": [{"code": "PLAUSIBLE-GROUND", "reason": "a mine"}],
    "control": {"path": "control.csv"},
}  # fmt: skip
BASE["log"]["max_gap_s"] = 2.0
# What pydantic says of types, ranges, patterns, lengths, unions, missing and unknown keys.
FOREIGN = re.compile(
    r"Input should|Field required|valid (string|number|integer|dictionary|list|boolean)|\[type=|"
    r"should (match|have)|at least \d+ (character|item)|pydantic|Extra inputs|Value error|"
    r"greater than|less than|Unable to|input_value|union_tag|README",
    re.IGNORECASE,
)
WRONG: tuple[Any, ...] = (None, True, -1e9, 3.5, "no such word", [1, "x"], {"nme": 1}, "x" * 300)


def places(values: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = values.items() if isinstance(values, dict) else ()
    found = [above] if above else []
    for key, value in enumerate(values) if isinstance(values, list) else inner:
        found += places(value, (*above, key))
    return found


def spoilt(place: tuple[Any, ...], value: Any) -> dict[str, Any]:
    tree = copy.deepcopy(BASE)
    inner = tree
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return tree


def refusal(tree: Any, path: Path) -> ConfigError | None:
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    try:
        load_mission(path)
    except ConfigError as error:
        return error
    return None


def test_the_file_that_is_spoilt_is_sound(tmp_path):
    assert refusal(BASE, tmp_path / "mission.yaml") is None


def test_no_phrase_of_a_library_reaches_the_user():
    """Every value of a mission replaced by eight wrong ones: over 400 files."""
    tried, node = 0, yaml.compose("{}")
    for place in places(BASE):
        for value in WRONG:
            tree = spoilt(place, value)
            try:
                Mission.model_validate(tree)
            except ValidationError as error:
                said = sentences_of(error.errors(), tree, node)
            else:
                continue
            tried += 1
            assert said, (place, value)
            assert not FOREIGN.search("\n".join(said)), (place, value, said)
            assert max(map(len, said)) < 1000
    assert tried > 400


def test_the_phrases_are_what_pydantic_says():
    """Else the test above could not fail."""
    with pytest.raises(ValidationError) as caught:
        Mission.model_validate(spoilt(("cameras", "nadir", "fx_px"), "wide"))
    assert FOREIGN.search(str(caught.value))


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        ("cameras.nadir.fx_px", "wide",
         "line 20: cameras.nadir.fx_px: 'wide' is not allowed; use a number from 10 to "
         "1000000 [px], as 20000.0"),
        ("ground.reference", "sea",
         "ground.reference: 'sea' is not allowed; use msl | ellipsoid | relative"),
        ("mission.name", "a b", "use letters, digits, dots, dashes and underscores"),
        ("cameras.nadir.width_px", 3.5, "use a whole number above 0 to 1000000 [px]"),
        ("log.channels.pressure", 5, "use text or a section {name, unit}, as BARO[0]"),
        ("mount.nadir.lever_arm_m", [1.0], "a list of 1 is not allowed; use a list of 3: "
         "each a number from -100 to 100 [m]"),
        ("output", None, "output: is empty; use a section {path, batch_rows}"),
        ("ground.height", {"colum": "x"}, "ground.height.colum: unknown key; perhaps 'column'?"),
        ("cameras.nadir.window", {"cabin": {"presure": 3}}, "presure: unknown key"),
    ],
)  # fmt: skip
def test_a_mistake_names_the_key_what_stands_there_and_what_may(place, value, says, tmp_path):
    error = refusal(spoilt(tuple(place.split(".")), value), tmp_path / "mission.yaml")
    assert error is not None
    assert says in error.what
    assert "unbend help KEY" in error.remedy


def test_a_missing_key_comes_with_its_meaning_and_an_example(tmp_path):
    tree = copy.deepcopy(BASE)
    del tree["cameras"]["nadir"]["calibration"], tree["output"]["path"]
    error = refusal(tree, tmp_path / "mission.yaml")
    assert error is not None
    assert error.code == "CONFIG-INVALID"
    assert "output.path: is missing: folder of this mission's results, or a URL" in error.what
    assert "cameras.nadir.calibration: is missing: how the camera was calibrated" in error.what


def test_open_questions_are_named_exactly_and_nothing_that_follows_from_them(tmp_path):
    tree = copy.deepcopy(BASE)
    todo = [("cameras", "nadir", "fx_px"), ("cameras", "nadir", "width_px"),
            ("ground", "reference"), ("ground", "height", "column"),
            ("mount", "oblique", "roll_deg"), ("atmosphere", "soundings", 0, "path")]  # fmt: skip
    for *above, last in todo:
        inner = tree
        for key in above:
            inner = inner[key]
        inner[last] = "TODO"
    error = refusal(tree, tmp_path / "mission.yaml")
    assert error is not None
    assert error.code == "CONFIG-TODO"
    named = re.findall(r"line \d+: (\S+): still TODO: \w+", error.what)
    wanted = {".".join(map(str, place)).replace(".0.", "[0].") for place in todo}
    assert len(named) == len(todo)
    assert set(named) == wanted
    assert error.what.count("line ") == len(todo)
    tree["atmosphere"]["co2_ppm"] = "much"  # a mistake beside them is named too
    error = refusal(tree, tmp_path / "mission.yaml")
    assert error is not None
    assert "co2_ppm: 'much'" in error.what


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mission: {name: a", "a bracket or a brace is not closed"),
        ("\tmission: 1", "there is a tab"),
        ("mission: name: a", "a colon where none can stand"),
        ("a: *x", "an alias (*) has no anchor"),
        ("a: !!python/name:os.system", "tags (!) are not taken"),
        ("a: 1\na: 2", "the key 'a' stands here twice"),
        ("a: '\x01'", "here the text is no YAML"),
    ],
)
def test_text_that_is_no_yaml_is_refused_in_plain_words(text, says, tmp_path):
    (tmp_path / "mission.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_mission(tmp_path / "mission.yaml")
    assert caught.value.code == "CONFIG-YAML"
    assert says in caught.value.what


@pytest.mark.parametrize("section", ["observations", "stations.orientation"])
def test_a_list_of_formats_is_refused(section, tmp_path):
    tree = copy.deepcopy(BASE)
    values = tree
    for key in section.split("."):
        values = values.setdefault(key, {})
    values["format"] = ["colmap"]
    error = refusal(tree, tmp_path / "mission.yaml")
    assert error is not None
    assert f"{section}.format: a list of 1 is not allowed" in error.what


@pytest.mark.parametrize(
    ("window", "key"), [({"normal": [1.0, 0.0, 0.0]}, "normal"), ({"cabin": None}, "cabin")]
)
def test_what_a_window_refuses_is_said_of_its_key(window, key, tmp_path):
    tree = copy.deepcopy(BASE)
    tree["cameras"]["nadir"]["window"] = {"cabin": "standard_schedule"} | window
    text = yaml.safe_dump(tree, sort_keys=False)
    error = refusal(tree, tmp_path / "mission.yaml")
    assert error is not None
    line = 1 + next(i for i, t in enumerate(text.splitlines()) if t.startswith(f"      {key}:"))
    assert error.what.startswith(f"line {line}: cameras.nadir.window.{key}: ")
