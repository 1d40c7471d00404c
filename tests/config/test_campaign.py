"""Campaign files: what missions share, which they are, and what is refused with its line."""

import json
import pickle

import jsonschema
import pytest
import yaml

from tests.helpers import refused
from unbend.batch.object_store import is_url
from unbend.config import Mission
from unbend.config.campaign import Campaign, MissionRef, open_configs
from unbend.config.campaign_defaults import LEADING_KEYS, WHOLE_SECTIONS, merged
from unbend.config.schema import alternatives, campaign_schema, mission_schema, nodes_at
from unbend.errors import ConfigError, UnbendError

OWN = ("mission", "log", "observations", "events")


@pytest.fixture
def season(mission, tmp_path):
    """A campaign file beside one mission, which keeps only what is its own."""

    def write(changes="{}", defaults="{}"):
        """Sections of the file and of its defaults are YAML."""
        own = {key: mission.config[key] for key in OWN}
        (mission.folder / "mission.yaml").write_text(yaml.safe_dump(own), "utf-8")
        shared = {k: v for k, v in mission.config.items() if k not in (*OWN, "output")}
        content = {
            "campaign": {"name": "season", "output": "out"},
            "defaults": shared | yaml.safe_load(defaults),
            "missions": ["mission/mission.yaml"],
        } | yaml.safe_load(changes)
        file = tmp_path / "season.yaml"
        file.write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")
        return file

    return write


def opened(file) -> tuple[list[MissionRef], Campaign]:
    refs, campaigns = open_configs([file])
    return refs, campaigns[0]


def loaded(file) -> Mission:
    """The only mission of a campaign."""
    (ref,), _ = opened(file)
    return ref.load()


def test_a_mission_is_its_own_sections_and_the_defaults(season, mission):
    (ref,), campaign = opened(season(defaults="output: {batch_rows: 5000}"))
    values = ref.load()
    whole = mission.config | {"output": {"path": "../out/simulated_bin", "batch_rows": 5000}}
    assert values == Mission.model_validate(whole)
    assert campaign.name == "season"
    assert campaign.output == campaign.path.parent / "out"
    assert pickle.loads(pickle.dumps(ref)) == ref  # as it travels to another process
    assert len(pickle.dumps(ref)) < 10_000


def test_paths_of_defaults_are_relative_to_the_campaign(season, mission):
    defaults = """
    control: control.csv
    atmosphere: {soundings: [{path: air/s.csv}, {path: /abs/s.csv}]}
    ground: {height: {dem: [a.tif, "s3://bucket/b.tif"]}, reference: msl}
    mission: {geoid: egm96}
    """
    values = loaded(season(defaults=defaults))
    assert values.control.path == "../control.csv"
    assert [sounding.path for sounding in values.atmosphere.soundings] == [
        "../air/s.csv",
        "/abs/s.csv",
    ]
    assert values.ground.model.paths == ("../a.tif", "s3://bucket/b.tif")
    assert values.mission.geoid == "egm96"  # a word, not a path
    assert values.log.path == mission.config["log"]["path"]  # the mission's own


def test_from_a_folder_that_is_a_link_paths_are_absolute(season, mission, tmp_path):
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "link").symlink_to(mission.folder, target_is_directory=True)
    (tmp_path / "far" / "away" / "link").symlink_to(mission.folder, target_is_directory=True)
    file = season("missions: [far/away/link/mission.yaml]", defaults="control: c.csv")
    assert loaded(file).control.path == str(tmp_path / "c.csv")


def test_own_values_replace_defaults_and_null_takes_them_away(season, mission):
    defaults = """
    atmosphere: {standard: us1976, model: {path: m.nc}}
    control: c.csv
    ground: {height: {column: h_g_m}, reference: msl}
    """
    changes = """
    atmosphere: {model: null}
    control: null
    cameras: {oblique: null}
    mount: {oblique: null}
    ground:
      height: {points: p.csv, crs: EPSG:4326, columns: {latitude: a, longitude: b}}
      reference: msl
    """
    file = season(defaults=defaults)
    mission_file = yaml.safe_load(mission.file.read_text()) | yaml.safe_load(changes)
    del mission_file["events"]["log"]["oblique"]
    mission.file.write_text(yaml.safe_dump(mission_file))
    values = loaded(file)
    assert list(values.cameras) == ["nadir"]
    assert values.atmosphere.model is None
    assert values.control is None
    assert values.atmosphere.standard == "us1976"
    assert values.ground.points.points == "p.csv"  # one of several sections: not mixed


TOGETHER = yaml.safe_load("""
- section: ground
  defaults: {height: 450.0, reference: ellipsoid, sigma_m: 0.5}
  mission: {height: {dem: d.tif}}
  together: {height: {dem: d.tif}}
- section: ground
  defaults: {height: 450.0, reference: msl}
  mission: {sigma_m: 2.0}
  together: {height: 450.0, reference: msl, sigma_m: 2.0}
- section: control
  defaults: {path: c.csv, crs: EPSG:25833, reference: msl}
  mission: {path: own.csv}
  together: {path: own.csv}
- section: cameras
  defaults: {n: {f_px: 9.0, distortion: {k1: 0.1, k2: 0.2}}}
  mission: {n: {distortion: {k1: 0.3}}}
  together: {n: {distortion: {k1: 0.3}}}
- section: mount
  defaults: {n: {roll_deg: 4.0}, o: {}}
  mission: {n: {yaw_deg: 9.0}}
  together: {n: {yaw_deg: 9.0}, o: {}}
- section: log
  defaults: {max_gap_s: 3.0, channels: {pressure: {name: P, unit: hPa}}}
  mission: {path: a, channels: {pressure: {name: Q}, height: H}}
  together: {max_gap_s: 3.0, path: a, channels: {pressure: {name: Q}, height: H}}
- section: atmosphere
  defaults: {model: {path: m.nc, member: 3}, index: gyer}
  mission: {model: {path: o.nc}}
  together: {model: {path: o.nc}, index: gyer}
- section: atmosphere
  defaults: {sensors: {thermometer: {lag_s: 5.0}}}
  mission: {sensors: {thermometer: {bias_k: 1.0}}}
  together: {sensors: {thermometer: {bias_k: 1.0}}}
- section: stations
  defaults: {orientation: {path: a, heights: msl}, trajectory: {path: t, crs: E}}
  mission: {orientation: {path: b}, trajectory: {path: u}}
  together: {orientation: {path: b}, trajectory: {path: u}}
- section: events
  defaults: {csv: {path: a, delay_s: 3.0}, log: {n: {delay_s: 1.0}, o: {delay_s: 1.0}}}
  mission: {csv: {path: b}, log: {n: {channel: CAM}, o: {image: x*}}}
  together: {csv: {path: b}, log: {n: {channel: CAM}, o: {image: x*, delay_s: 1.0}}}
- section: mission
  defaults: {undulation_m: 47.0}
  mission: {name: n, geoid: g.tif}
  together: {name: n, geoid: g.tif}
""")
"""Defaults and values of a mission, and what they are together."""


@pytest.mark.parametrize("case", TOGETHER, ids=str)
def test_values_that_belong_together_are_not_mixed(case):
    section = case["section"]
    values = merged({section: case["defaults"]}, {section: case["mission"]})
    assert values == {section: case["together"]}


def test_what_is_taken_whole_are_keys_of_a_mission_file():
    for pattern in (*WHOLE_SECTIONS, *LEADING_KEYS):
        section, _, name = pattern.partition(".*")
        names = {"log.channels": "pressure", "atmosphere.sensors": "gnss"}
        star = "." + names.get(section, "nadir") if name or "*" in pattern else ""
        assert nodes_at(tuple(f"{section}{star}{name}".split("."))), pattern


@pytest.mark.parametrize("text", ["s3:/bucket/x", "s3://bucket/x", "az:/x", "C:/x", "a/b", "x:y/z"])
def test_a_url_of_the_defaults_is_what_is_one_of_a_mission(season, text):
    file = season(defaults=f"control: {text}")
    assert (loaded(file).control.path == text) == is_url(text)


def test_a_file_that_is_named_twice_is_taken_once(season, mission):
    file = season()
    folder = mission.folder
    own = folder / "mission.yaml"
    refs, campaigns = open_configs([file, own, folder / ".." / "mission" / "mission.yaml", file])
    of_campaign, alone = refs
    assert len(campaigns) == 1
    assert of_campaign.path.name == alone.path.name == "mission.yaml"
    assert of_campaign.defaults
    assert not alone.defaults


def test_sections_that_are_replaced_as_a_whole_are_those_of_which_there_are_several():
    places = []

    def walk(node, place):
        arms = alternatives(node)
        if sum("properties" in arm for arm in arms) > 1:
            places.append(place)
        for arm in arms:
            for key, value in arm.get("properties", {}).items():
                walk(value, f"{place}.{key}".removeprefix("."))

    walk(mission_schema(), "")
    assert places == ["ground.height"]
    assert set(places) <= set(WHOLE_SECTIONS)


def test_missions_are_files_patterns_and_sections(season, mission, tmp_path):
    for name in ("b", "a", "deep/er"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "m.yaml").write_text(f"mission: {{name: {name[:1]}}}")
    inline = {
        "mission": {"name": "inline"},
        "log": {"path": "x.bin"},
        "observations": {"path": "o.csv"},
        "events": mission.config["events"],
    }
    missions = ["mission/mission.yaml", "**/m.yaml", inline, "b/m.yaml"]
    file = season(yaml.safe_dump({"missions": [*missions, "*.yaml"]}))
    with refused("CAMPAIGN-NO-MATCH"):  # *.yaml is itself alone
        open_configs([file])
    refs, _ = opened(season(yaml.safe_dump({"missions": missions})))
    places = [ref.path.relative_to(tmp_path).as_posix() for ref in refs]
    assert places == [
        "mission/mission.yaml",
        "a/m.yaml",
        "deep/er/m.yaml",
        "season.yaml",
        "b/m.yaml",
    ]
    assert refs[3].load().output.path == "out/inline"
    assert refs[3].label.endswith("season.yaml: inline")
    assert refs[3].run_arguments == (str(file), "--mission", "inline")
    assert refs[1].run_arguments == (str(file), "--mission", str(tmp_path / "a" / "m.yaml"))


MISTAKES = yaml.safe_load("""
- ['campaign: {name: a/b, output: x}', ['line 2: campaign.name']]
- ['campaign: {name: a}', ['line 1: campaign.output: is missing']]
- ['missions: []', [missions]]
- ['missions: [7]', ['missions[0]']]
- ['misions: [a]', ["misions: unknown key; perhaps 'missions'?"]]
- ['missions: [{mission: {name: x}, lag: 1}]', ['missions[0].lag', "'log'"]]
- ['missions: [{mission: {name: x}}]', ['missions[0].observations: is missing']]
- ['defaults: {atmosfere: {}}', [defaults.atmosfere, "perhaps 'atmosphere'?"]]
- - 'defaults: {cameras: {nadir: {window: {normal: [1.0, 0.0, 0.0]}}}}'
  - [defaults.cameras.nadir.window]
- ['defaults: {output: {batch_rows: many}}', [defaults.output.batch_rows]]
- ['defaults: {output: {batch_rows: TODO}}', [CONFIG-TODO, batch_rows]]
""")


@pytest.mark.parametrize(("changes", "texts"), MISTAKES)
def test_mistakes_are_refused_with_their_lines(season, changes, texts):
    with pytest.raises(ConfigError) as refusal:
        open_configs([season(changes)])
    for part in ("line ", *texts):
        assert part in str(refusal.value)


def test_what_defaults_leave_out_is_no_mistake_of_theirs(season):
    (ref,), _ = opened(season(defaults="stations: {orientation: {frame: geographic}}"))
    with pytest.raises(UnbendError) as refusal:
        ref.load()  # now the path is missing
    text = "defaults of the campaign: stations.orientation.path: is missing"
    assert text in str(refusal.value)


def test_a_campaign_is_no_mission(season):
    file = season()
    with refused("CONFIG-CAMPAIGN"):
        MissionRef(file).load()
    assert open_configs([file.parent / "mission" / "mission.yaml"])[1] == []


def test_the_schema_takes_what_the_program_takes(season):
    schema = campaign_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    file = season()
    jsonschema.validate(yaml.safe_load(file.read_text()), schema)
    wrong = yaml.safe_load(file.read_text()) | {"defaults": {"cameras": 7}}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, schema)
    assert nodes_at(("defaults", "log", "path")) == nodes_at(("log", "path"))


def test_schema_and_help_know_campaigns(unbend):
    assert json.loads(unbend("schema", "--campaign").out) == campaign_schema()
    assert "flights/*/mission.yaml" in unbend("help", "missions").out
    assert "folder of campaign.html" in unbend("help", "campaign.output").out
