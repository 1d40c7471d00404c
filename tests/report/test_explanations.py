"""`unbend help` and `unbend schema`: keys, codes and exit codes, offline."""

import json
import re

import pytest
import yaml

from tests.helpers import refused
from unbend.config.keys import mission_keys
from unbend.config.schema import mission_schema
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.report.explanations import TABLES, explain, glossary, meanings
from unbend.tables.written_columns import columns_of


@pytest.mark.parametrize("word", ["f_px", "cameras.*.f_px", "cameras.nadir.f_px", "F_PX"])
def test_a_key_is_found_whole_by_a_camera_s_name_or_by_its_last_part(word):
    lines = explain(word)
    assert lines[0] == "cameras.*.f_px"
    assert "  takes: a number from 10 to 1000000 [px]" in lines
    assert "  default: none" in lines
    assert "  example: 20000.0" in lines


def test_several_keys_of_one_name_are_listed():
    lines = explain("path")
    assert sum(line.endswith(".path") for line in lines[:-1]) == 8
    assert lines[-1].startswith("and: ")
    assert explain("undulation_m")[0] == "mission.undulation_m"
    assert explain("mission")[0] == "mission"  # the section, not all keys within it
    within = next(line for line in explain("cameras") if "within it" in line)
    assert " f_px," in within
    assert "pressure_hpa" not in within


def test_every_key_and_every_code_is_found():
    for key in mission_keys():
        assert key.path in explain(key.path)
    for code, meaning in meanings()["codes"].items():
        assert explain(code.lower())[:2] == [code, f"  {meaning.means}"]
    assert explain("130")[1].startswith("  Interrupted")


@pytest.mark.parametrize(
    ("typo", "meant"),
    [
        ("undulaton_m", "undulation_m"),
        ("EVENTS-AMBIGOUS", "EVENTS-AMBIGUOUS"),
        ("f_pix", "f_px"),
        ("omega_phi_kapa", "omega_phi_kappa"),
    ],
)
def test_a_typo_gets_the_nearest_names(typo, meant):
    with refused("HELP-WORD", remedy=meant):
        explain(typo)


def test_a_value_is_explained_by_the_keys_that_take_it():
    assert explain("OPENCV")[0] == "opencv (value of keys)"
    lines = explain("omega_phi_kappa")
    assert lines[:3] == ["omega_phi_kappa (value of keys)", "", "stations.orientation.angles"]
    assert "turns vectors of the photo (x right, y up, z backward) to the frame" in lines[3]
    for value, key in [
        ("relative", "ground.reference"),
        ("right up", "cameras.*.metric.axes"),
        ("case", "observations.match_names"),
    ]:
        assert key in explain(value)


def test_every_status_is_found():
    for status in (*STATUS_NAMES[1:], "unmatched", "in_gap", "height_reference_unknown"):
        assert explain(status)[0].startswith(f"{status} (status of ")


@pytest.mark.usefixtures("eighty_columns")
def test_the_commands(unbend, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    schema = unbend("schema", "--out", "mission.schema.json")
    assert schema.code == 0
    assert schema.out == "mission.schema.json\n"
    assert json.loads((tmp_path / "mission.schema.json").read_text()) == mission_schema()
    explained = unbend("help", "EVENTS-AMBIGUOUS")
    assert explained.code == 0
    assert "  effect on the result: The mission is refused." in explained.out
    assert max(map(len, explained.out.splitlines())) <= 80
    assert unbend("help", "lever", "arm").out.startswith("lever arm\n")
    assert unbend("help", "run").out == "run (command)\n  explained by: unbend run --help\n"
    assert "unbend profile --help" in unbend("help", "profile").out
    unknown = unbend("help", "nothing", "like", "it")
    assert unknown.code == 2
    assert "HELP-WORD" in unknown.err


def test_columns_of_results_are_explained_table_by_table():
    lines = explain("r_c_rad")
    assert lines[0] == "r_c_rad (column of observations)"
    assert lines[1].endswith("[rad]")
    assert "observations/part-*.parquet" in lines[2]
    for table in TABLES:
        for column in columns_of(table):
            assert f"{column} (column of {table})" in explain(column)
    assert "x_displaced_px (column of observations)" in explain("x_displaced_px")


WORDS = yaml.safe_load("""
- [GCP, Give such points under control]
- [control points, Give such points under control]
- [boresight, 'roll_deg, pitch_deg, yaw_deg under mount']
- [lever arm, 'mount.<camera>.lever_arm_m']
- [lever-arm, 'mount.<camera>.lever_arm_m']
- [focal length, f_px]
- ['R', r_c_rad]
- [taken_with, this camera for Metashape]
- [calibration.json, the camera that the images were taken with]
- [refraction of the window, are not to be added]
- [EXPORT-RESIDUAL, '--format bundler for Metashape']
""")


@pytest.mark.parametrize(("word", "says"), WORDS)
def test_words_of_the_field_are_explained(word, says):
    assert says in " ".join(explain(word))


def test_words_name_keys_that_there_are_and_each_name_is_of_one_word():
    names = [name for word in glossary() for name in (word.name, *word.also)]
    assert len(names) == len(set(names))
    assert names == [name.lower() for name in names]
    last = {key.path.rpartition(".")[2] for key in mission_keys()}
    columns = {column for table in TABLES for column in columns_of(table)}
    for word in glossary():
        for key in re.findall(r"\b[a-z]+(?:_[a-z0-9]+)+\b", word.means):
            assert key in last | columns, (word.name, key)


def test_what_is_a_key_and_a_word_is_explained_as_both():
    lines = explain("mount")
    assert lines[0] == "mount"
    assert "  takes: a section for each name" in lines
    assert lines.count("mount") == 2
