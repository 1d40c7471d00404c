"""Spoilt mission files: each mistake in a sentence of one's own, none in pydantic's words."""

import copy
import json
import re
from itertools import pairwise

import pytest
import yaml
from pydantic import ValidationError

from tests.helpers import refused
from tests.logs import REPOSITORY
from unbend.config import Mission, load_mission
from unbend.config.mistakes import sentences_of
from unbend.errors import ConfigError

BASE = yaml.safe_load((REPOSITORY / "configs" / "sample_bin.yaml").read_text("utf-8"))
BASE |= yaml.safe_load("""
stations: {trajectory: {path: a.pos, point: antenna, lever_arm_m: [0.0, 0.0, 0.0]}}
atmosphere:
  soundings: [{path: s.csv}]
  surface: [{h_msl_m: 4.0, metar: M}]
  sensors: {gnss: {sigma_height_m: 1.0}}
accept: [{code: PLAUSIBLE-GROUND, reason: a mine}]
control: {path: control.csv}
""")
BASE["log"]["max_gap_s"] = 2.0
# What pydantic says of types, ranges, patterns, lengths, unions, missing and unknown keys.
FOREIGN = re.compile(
    r"Input should|Field required|valid (string|number|integer|dictionary|list|boolean)|\[type=|"
    r"should (match|have)|at least \d+ (character|item)|pydantic|Extra inputs|Value error|"
    r"greater than|less than|Unable to|input_value|union_tag|README",
    re.IGNORECASE,
)
WRONG = (None, True, -1e9, 3.5, "no such word", [1, "x"], {"nme": 1}, "x" * 300)


def places(values, above=()):
    """The places of all values, of sections too, as keys and numbers of list items."""
    items = ()
    if isinstance(values, dict):
        items = values.items()
    elif isinstance(values, list):
        items = enumerate(values)
    inner = [above] if above else []
    for key, value in items:
        inner += places(value, (*above, key))
    return inner


def spoilt(place, value):
    tree = copy.deepcopy(BASE)
    spoil(tree, place, value)
    return tree


def spoil(tree, place, value):
    *above, last = place
    for key in above:
        tree = tree[key]
    tree[last] = value


def test_the_file_that_is_spoilt_is_sound(load):
    load(BASE)


def test_no_phrase_of_a_library_reaches_the_user():
    """Every value of a mission replaced by eight wrong ones: over 400 files."""
    tried = 0
    node = yaml.compose("{}")
    for place in places(BASE):
        for value in WRONG:
            tree = spoilt(place, value)
            try:
                Mission.model_validate(tree)
            except ValidationError as error:
                sentences = sentences_of(error.errors(), tree, node)
            else:
                continue
            tried += 1
            assert sentences, (place, value)
            assert not FOREIGN.search("\n".join(sentences)), (place, value, sentences)
            assert max(map(len, sentences)) < 1000
    assert tried > 400


def test_the_phrases_are_what_pydantic_says():
    """Else the test above could not fail."""
    with pytest.raises(ValidationError) as caught:
        Mission.model_validate(spoilt(("cameras", "nadir", "fx_px"), "wide"))
    assert FOREIGN.search(str(caught.value))


WRONG_VALUES = yaml.safe_load("""
- - cameras.nadir.fx_px
  - wide
  - "line 20: cameras.nadir.fx_px: 'wide' is not allowed; use a number from 10 to 1000000 [px],
    as 20000.0"
- - ground.reference
  - sea
  - "ground.reference: 'sea' is not allowed; use msl | ellipsoid | relative"
- [mission.name, a b, 'use letters, digits, dots, dashes and underscores']
- [cameras.nadir.width_px, 3.5, 'use a whole number above 0 to 1000000 [px]']
- [log.channels.pressure, 5, 'use text or a section {name, unit}, as BARO[0]']
- - mount.nadir.lever_arm_m
  - [1.0]
  - 'a list of 1 is not allowed; use a list of 3: each a number from -50 to 50 [m]'
- - mount.nadir.lever_arm_m
  - [0.35, 100, -600]
  - 'mount.nadir.lever_arm_m[1]: 100 is not allowed; use a number from -50 to 50: lever arms are in
    metres, and this looks like millimetres'
- [mount.nadir.lever_arm_m, [0.35, 100, -600], 'lever_arm_m[2]: -600 is not allowed']
- - stations.trajectory.lever_arm_m
  - [0.0, 0.0, 900]
  - 'lever_arm_m[2]: 900 is not allowed; use a number from -50 to 50: lever arms are in metres'
- [output, null, 'output: is empty; use a section {path, batch_rows}']
- [ground.height, {colum: 'x'}, "ground.height.colum: unknown key; perhaps 'column'?"]
- [cameras.nadir.window, {cabin: {presure: 3}}, 'presure: unknown key']
""")


@pytest.mark.parametrize(("place", "value", "says"), WRONG_VALUES)
def test_a_mistake_names_the_key_what_stands_there_and_what_may(place, value, says, refusal):
    error = refusal(spoilt(tuple(place.split(".")), value))
    assert says in error.what
    assert "unbend help KEY" in error.remedy


def test_a_missing_key_comes_with_its_meaning_and_an_example(refusal):
    tree = copy.deepcopy(BASE)
    del tree["cameras"]["nadir"]["calibration"]
    del tree["output"]["path"]
    error = refusal(tree)
    assert error.code == "CONFIG-INVALID"
    assert "output.path: is missing: folder of this mission's results, or a URL" in error.what
    assert "cameras.nadir.calibration: is missing: how the camera was calibrated" in error.what


def test_a_misspelt_required_key_is_one_mistake(refusal):
    tree = copy.deepcopy(BASE)
    height = tree["ground"].pop("height")
    reference = tree["ground"].pop("reference")
    tree["ground"] |= {"heigth": height, "refrence": reference}
    del tree["output"]["path"]
    error = refusal(tree)
    assert error.code == "CONFIG-UNKNOWN-KEY"
    assert "ground.heigth: unknown key; perhaps 'height'?" in error.what
    assert "ground.refrence: unknown key; perhaps 'reference'?" in error.what
    assert "ground.height: is missing" not in error.what
    assert "ground.reference: is missing" not in error.what
    assert "output.path: is missing" in error.what


ACROSS_SECTIONS = yaml.safe_load("""
- [ground.height, from_distance, height, 'needs observations.columns.distance_m']
- [ground.height, block, height, 'takes the points of stations.orientation']
- [observations.unit, mm, unit, 'needs cameras.nadir.metric']
- [atmosphere.board_temperature, true, board_temperature, 'needs log.channels.temperature']
- [stations.trajectory.lever_arm_m, from_events, lever_arm_m, 'needs events.positions']
- [stations.trajectory.point, camera, point, 'is possible for one camera']
- [refraction, {direction: apply}, control, 'control compares before and after']
""")


@pytest.mark.parametrize(("place", "value", "key", "says"), ACROSS_SECTIONS)
def test_a_mistake_of_several_sections_has_the_line_of_its_key(place, value, key, says, refusal):
    tree = copy.deepcopy(BASE)
    tree["log"]["channels"].pop("temperature", None)
    del tree["cameras"]["oblique"], tree["mount"]["oblique"], tree["events"]["log"]["oblique"]
    if place == "stations.trajectory.point":
        for section in (tree["cameras"], tree["mount"], tree["events"]["log"]):
            section["oblique"] = copy.deepcopy(section["nadir"])
        del tree["stations"]["trajectory"]["lever_arm_m"]
    spoil(tree, tuple(place.split(".")), value)
    error = refusal(tree)
    assert says in error.what
    text = yaml.safe_dump(tree, sort_keys=False)
    line = re.search(r"line (\d+)", error.what)
    assert text.splitlines()[int(line[1]) - 1].lstrip().startswith(f"{key}:")


def renamed_camera(tree, sections, name):
    """The second camera has another name in some sections."""
    places = {
        "cameras": tree["cameras"],
        "mount": tree["mount"],
        "events": tree["events"]["log"],
    }
    for section in sections:
        places[section][name] = places[section].pop("oblique")
    return tree


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        (["cameras"], "perhaps 'oblique' under cameras?"),
        (["mount"], "mount names camera 'oblik'; perhaps 'oblique'?"),
        (["events"], "events.log names camera 'oblik'; perhaps 'oblique'?"),
        (["cameras", "mount"], "events.log names camera 'oblique'; perhaps 'oblik'?"),
    ],
)
def test_of_three_sections_the_odd_one_out_has_the_wrong_name(sections, says, refusal):
    tree = renamed_camera(copy.deepcopy(BASE), sections, "oblik")
    error = refusal(tree)
    assert says in error.what
    assert "line 1:" not in error.what


OPEN = {
    "cameras.nadir.fx_px": ("cameras", "nadir", "fx_px"),
    "cameras.nadir.width_px": ("cameras", "nadir", "width_px"),
    "ground.reference": ("ground", "reference"),
    "ground.height.column": ("ground", "height", "column"),
    "mount.oblique.roll_deg": ("mount", "oblique", "roll_deg"),
    "atmosphere.soundings[0].path": ("atmosphere", "soundings", 0, "path"),
}


def test_open_questions_are_named_exactly_and_nothing_that_follows_from_them(refusal):
    tree = copy.deepcopy(BASE)
    for place in OPEN.values():
        spoil(tree, place, "TODO")
    error = refusal(tree)
    assert error.code == "CONFIG-TODO"
    keys = re.findall(r"line \d+: (\S+): still TODO: \w+", error.what)
    assert sorted(keys) == sorted(OPEN)
    assert error.what.count("line ") == len(OPEN)
    tree["atmosphere"]["co2_ppm"] = "much"  # a mistake beside them is named too
    assert "co2_ppm: 'much'" in refusal(tree).what


def test_a_misspelt_key_with_todo_is_misspelt(refusal):
    tree = copy.deepcopy(BASE)
    tree["cameras"]["nadir"]["heigth_px"] = "TODO"

    assert "cameras.nadir.heigth_px: unknown key; perhaps 'height_px'?" in refusal(tree).what


def explosion():
    """Ten lists of ten of the list before."""
    text = "a: &a [x, x, x, x, x, x, x, x, x, x]\n"
    for inner, outer in pairwise("abcdefghij"):
        ten = ", ".join([f"*{inner}"] * 10)
        text += f"{outer}: &{outer} [{ten}]\n"
    return text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mission: {name: a", "a bracket or a brace is not closed"),
        ("\tmission: 1", "there is a tab"),
        ("mission: name: a", "a colon at a place where it is not allowed"),
        ("a: *x", "an alias (*) has no anchor"),
        ("a: !!python/name:os.system", "tags (!) are not allowed"),
        ("a: 1\na: 2", "the key 'a' occurs twice"),
        ("a: '\x01'", "here the text is not YAML"),
        ("mission: {name: a, undulation_m: " + "9" * 5000 + "}", "a number has too many digits"),
        ("mission: &m {name: *m}", "inside the section or list that it repeats"),
        (explosion(), "more than 1000000 values"),
        ("mission: {name: !!bool x}", "the text is not YAML"),
        ("mission: {name: !!timestamp x}", "tags (!) are not allowed"),
        ("mission: {name: !!timestamp 2026-05-14}", "tags (!) are not allowed"),
        ("mission: " + "[" * 5000, "too many brackets are inside each other"),
        ("mission: " + "- " * 5000, "the text is not YAML"),
    ],
    ids=lambda text: text[:20],
)
def test_text_that_is_no_yaml_is_refused_in_plain_words(text, says, refusal):
    error = refusal(text)
    assert error.code == "CONFIG-YAML"
    assert says in error.what


@pytest.mark.parametrize("section", ["observations", "stations.orientation"])
def test_a_list_of_formats_is_refused(section, refusal):
    tree = copy.deepcopy(BASE)
    tree["stations"]["orientation"] = {}
    spoil(tree, (*section.split("."), "format"), ["colmap"])
    assert f"{section}.format: a list of 1 is not allowed" in refusal(tree).what


@pytest.mark.parametrize(
    ("window", "key"), [({"normal": [1.0, 0.0, 0.0]}, "normal"), ({"cabin": None}, "cabin")]
)
def test_what_a_window_refuses_is_said_of_its_key(window, key, refusal):
    tree = copy.deepcopy(BASE)
    tree["cameras"]["nadir"]["window"] = {"cabin": "standard_schedule"} | window
    lines = yaml.safe_dump(tree, sort_keys=False).splitlines()
    line = next(n for n, text in enumerate(lines, 1) if text.startswith(f"      {key}:"))
    assert refusal(tree).what.startswith(f"line {line}: cameras.nadir.window.{key}: ")


DECIMAL_COMMAS = yaml.safe_load("""
- ['k1: -0.018000', 'k1: -0,018', "'-0,018' has a decimal comma: write -0.018"]
- ['p2: -0.000100}', 'p2: -0,0001}', "'-0,0001' has a decimal comma: write -0.0001"]
- ['undulation_m: 47.6', 'undulation_m: 47,6', "'47,6' has a decimal comma: write 47.6"]
- ['roll_deg: 0.0', 'roll_deg: -0,5', "'-0,5' has a decimal comma: write -0.5"]
- ['fx_px: 20000.0', 'fx_px: 20.000,5', "'20.000,5' has a decimal comma: write 20000.5"]
- ['fx_px: 20000.0', 'fx_px: 20,000', "'20,000' has a comma: write 20.000 or 20000"]
- ['[0.35, 0.1, 0.6]', '[0,35, 0,1, 0,6]', 'numbers have a decimal point, not a comma']
""")


@pytest.mark.parametrize(("before", "after", "says"), DECIMAL_COMMAS)
def test_a_decimal_comma_is_named_wherever_a_number_is_expected(before, after, says, refusal):
    """In braces YAML takes the comma for the end of the number: the text is looked at."""
    text = (REPOSITORY / "configs" / "sample_bin.yaml").read_text("utf-8")
    assert before in text
    error = refusal(text.replace(before, after, 1))
    assert says in error.what
    line = text[: text.index(before)].count("\n") + 1
    assert f"{line}" in f"{error.where} {error.what}"


MILLIMETRES = yaml.safe_load("""
- [f_mm, metric.focal_mm]
- [focal_length_mm, metric.focal_mm]
- [focal_length, 'in pixels is f_px; .* metric.focal_mm']
- [pixel_size_um, metric.pixel_um]
- [pixel_pitch, metric.pixel_um]
- [sensor_width_mm, metric.format_mm]
- [cx_mm, metric.ppa_mm]
""")


@pytest.mark.parametrize(("key", "says"), MILLIMETRES)
def test_a_camera_in_millimetres_is_led_to_its_section(key, says, refusal):
    error = refusal(spoilt(("cameras", "nadir", key), 80.0))
    assert error.code == "CONFIG-UNKNOWN-KEY"
    assert re.search(says, error.what)


OTHER_UNITS = yaml.safe_load("""
- [mount.nadir.roll_rad, "perhaps 'roll_deg', in degrees?"]
- [mount.nadir.lever_arm_mm, "perhaps 'lever_arm_m', in metres?"]
- [mission.undulation_ft, "perhaps 'undulation_m', in metres?"]
- [cameras.nadir.fx_pix, "perhaps 'fx_px'?"]
""")


@pytest.mark.parametrize(("place", "says"), OTHER_UNITS)
def test_a_key_in_another_unit_is_led_to_the_key_and_its_unit(place, says, refusal):
    error = refusal(spoilt(tuple(place.split(".")), 1.0))
    assert says in error.what


WITHOUT_QUOTES = yaml.safe_load(r"""
- - '    nadir: {channel: CAM[0], image: x}'
  - 'put quotes around a text with brackets or braces: "CAM[0]"'
- ['    nadir: {channel: CAM, image: n_{index:05d}}', '"n_{index:05d}"']
- ['    image: {index:05d}.jpg', '"{index:05d}.jpg"']
- ['    image: @x', put quotes around a text that begins with this character]
- ['    image: *.jpg', 'put quotes around a text that begins with * or &']
- ["    path: \"..\\logs\\flight.bin\"", write / or single quotes]
""")


@pytest.mark.parametrize(("line", "says"), WITHOUT_QUOTES)
def test_a_text_that_needs_quotes_is_shown_with_them(line, says, refusal):
    error = refusal(f"events:\n  log:\n{line}\n")
    assert error.code == "CONFIG-YAML"
    assert says in error.what
    assert error.where.endswith("mission.yaml:3")


def test_a_text_in_braces_alone_is_shown_with_quotes(refusal):
    error = refusal(spoilt(("mission", "name"), {"index:05d": None}))
    assert 'put quotes around a text with braces: "{index:05d}"' in error.what


@pytest.mark.parametrize("name", ["x.csv", "results/survey.Parquet", "report.html", "a.yaml"])
def test_results_go_to_a_folder_that_is_not_named_as_a_file(name, refusal):
    error = refusal(spoilt(("output", "path"), name))
    assert f"{name!r} is the name of a file, and a run writes a folder" in error.what
    assert f"write {name.rpartition('.')[0]!r}" in error.what
    for folder in ("results/survey.v2", "results/2026-05.12", "s3://bucket/season.x"):
        tree = spoilt(("output", "path"), folder)
        assert Mission.model_validate(tree).output.path == folder


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("t.parquet", b"PAR1 and more\x00", "is a Parquet table"),
        ("t.csv", b"image,point,x,y\n1,2,3,4\n", "is a table of text"),
        ("a.jpg", b"\xff\xd8\xff\xe0\x00", "is an image (JPEG)"),
        ("a.db", b"SQLite format 3\x00", "is a database"),
        ("a.dat", bytes(range(256)), "is not text in UTF-8"),
        ("mission.yaml", b"\xff\xfe\x00\x01", "codec can"),
        ("mission.yaml", "mission".encode("utf-16"), "codec can"),
        ("a.html", b"<!DOCTYPE html><html></html>", "is a web page"),
        ("a.xml", b"<?xml version='1.0'?><document/>", "is XML"),
        ("mission.schema.json", b'{"$schema": "x", "properties": {}}', "is the JSON schema"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_another_file_in_the_place_of_a_mission_file_is_named(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with refused("CONFIG-UNREADABLE", what=says):
        load_mission(tmp_path / name)


def test_a_log_in_the_place_of_a_mission_file_is_named():
    with refused(
        "CONFIG-UNREADABLE", what="is a flight log: ArduPilot DataFlash", remedy="unbend init"
    ):
        load_mission(REPOSITORY / "sample_logs" / "flight.bin")


def test_a_folder_in_the_place_of_a_mission_file_is_named(tmp_path):
    with refused("CONFIG-UNREADABLE", what="is a folder, not a mission file", remedy="unbend init"):
        load_mission(tmp_path)
    (tmp_path / "m.yaml").write_text("mission: {name: a}\n", "utf-8")
    with refused("CONFIG-UNREADABLE") as refusal:
        load_mission(tmp_path)
    assert refusal.value.remedy == f"name its mission files: {tmp_path}/*.yaml"


def test_results_in_the_place_of_a_mission_file_are_named(tmp_path):
    run = tmp_path / "results"
    run.mkdir()
    (run / "manifest.json").write_text('{"manifest_version": 1}', "utf-8")
    (run / "report.html").write_text("<html>", "utf-8")
    for path, kind in (
        (run, "the folder of the results of a run"),
        (run / "manifest.json", "a file of the results of a run"),
        (run / "report.html", "a file of the results of a run"),
    ):
        with pytest.raises(ConfigError, match=f"is {kind}") as caught:
            load_mission(path)
        assert f"unbend verify {run}" in caught.value.remedy


def test_a_mission_file_of_another_ending_is_read(tmp_path):
    """JSON is YAML; and no ending is wrong."""
    tree = json.dumps(BASE)
    for name in ("mission.json", "mission.txt.yaml", "mission"):
        path = tmp_path / name
        path.write_text(tree, "utf-8")
        assert load_mission(path).mission.name == BASE["mission"]["name"]


def test_a_key_of_another_section_is_sent_there(refusal):
    error = refusal(spoilt(("ground", "undulation_m"), 47.6))
    assert "it is a key of another section: mission.undulation_m" in error.what
