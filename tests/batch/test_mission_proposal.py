"""`unbend init`: what it writes loads, asks for what is open, and runs with the truth filled in."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.ingest.ulog.test_log import flight
from tests.logs import at_hand
from unbend.batch.proposal import mission_text
from unbend.batch.proposal.log_facts import LogFacts, facts_of_log, place_remark
from unbend.batch.proposal.mission_text import propose_mission
from unbend.batch.proposal.proposed_cameras import proposed_cameras
from unbend.flight.channels import Channel, Source
from unbend.flight.image_names import name_series

SHARED = Path(__file__).resolve().parents[3] / "shared" / "logs"
CAMERA = {
    "width_px": 6000,
    "height_px": 4000,
    "f_px": 5000.0,
    "cx_px": 3000.0,
    "cy_px": 2000.0,
    "calibration": "laboratory",
}
AT_REST = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}


def places_of_todo(tree: Any, above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    if tree == "TODO":
        return [above]
    inner = tree.items() if isinstance(tree, dict) else ()
    return [place for key, value in inner for place in places_of_todo(value, (*above, key))]


def answered(tree: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """The tree with the truth in the place of each TODO, and nothing else changed."""
    truth = truth | {"observations": {"refraction": "none"} | truth.get("observations", {})}
    for place in places_of_todo(tree):
        inner = tree
        value = truth
        for key in place:
            value = value[key]
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
    return tree


def todo_of_check(unbend, path: Path) -> set[str]:
    """The keys that `check` says are open; it says nothing else."""
    ended = unbend("check", path)
    assert ended.code == 2, ended.text
    assert "CONFIG-TODO" in ended.err
    named = re.findall(r"(?:line \d+: )(\S+): still TODO: \w+", ended.err)
    assert len(named) == ended.err.count("line ")
    return set(named)


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_with_the_truth_filled_in_it_gives_what_the_mission_file_of_the_flight_gives(
    kind, mission_factory, baseline, plain_report, unbend, tmp_path
):
    flown = mission_factory(tmp_path / "mission", kind)
    truth = flown.config
    ended = unbend("init", flown.log, flown.folder / "observations.parquet", "--out", flown.file)
    assert ended.code == 0, ended.text
    text = flown.file.read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=mission.schema.json\n")
    assert (flown.folder / "mission.schema.json").is_file()
    tree = yaml.safe_load(text)
    todo = {".".join(place) for place in places_of_todo(tree)}
    assert todo_of_check(unbend, flown.file) == todo
    assert f"{len(todo)} open questions" in ended.out
    assert {"cameras.nadir.f_px", "mount.oblique.roll_deg", "ground.reference"} <= todo
    assert tree["events"]["log"]["nadir"]["image"] == truth["events"]["log"]["nadir"]["image"]
    assert tree["ground"]["height"] == {"column": "h_g_m"}
    cameras = {n: c | {"f_px": c["fx_px"]} for n, c in truth["cameras"].items()}
    channels = {"cabin_humidity": None} | truth["log"]["channels"]
    flown.config = answered(tree, truth | {"cameras": cameras, "log": {"channels": channels}})
    # What init leaves out, and says so: lever arms, distortion; the undulation is the geoid's.
    flown.config["mission"] = truth["mission"]
    for name, camera in truth["cameras"].items():
        flown.config["cameras"][name]["distortion"] = camera["distortion"]
        flown.config["mount"][name]["lever_arm_m"] = truth["mount"][name]["lever_arm_m"]
    ended = unbend("check", flown.save())
    assert ended.code == 0, ended.text
    if kind == "bin":
        assert flown.run().code == 0
        mine, wanted = (m.results().to_pandas() for m in (flown, baseline))
        pd.testing.assert_frame_equal(mine, wanted, check_exact=True)


def test_a_bare_camera_takes_twenty_lines(mission, monkeypatch):
    """Beside remarks on lines of their own; the flight has one channel, and no cabin."""
    seen = mission.measurements().to_pandas()
    seen[seen["image"].str.startswith("nadir")].to_csv(mission.folder / "o.csv", index=False)
    facts = LogFacts(events=(channel("CAM[0]", [1, 2, 3]),), takeoff="take-off 450 m above the sea")
    monkeypatch.setattr(mission_text, "facts_of_log", lambda _: facts)
    table = mission.folder / "o.csv"
    text = propose_mission(mission.log, table, None, mission.file)
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    assert len(lines) <= 20
    assert "refraction: TODO}" in text
    assert 'nadir: {channel: "CAM[0]", image: "nadir_{index:05d}"}  # guessed: 3 images' in text
    assert "ground: {height: {column: h_g_m}, reference: TODO}" in text


def test_nothing_is_written_over(mission, unbend, tmp_path):
    out = tmp_path / "mine.yaml"
    out.write_text("mine", encoding="utf-8")
    ended = unbend("init", mission.log, "--out", out)
    assert ended.code == 2
    assert "INIT-EXISTS" in ended.err
    assert out.read_text(encoding="utf-8") == "mine"
    assert unbend("init", mission.log, "--out", out, "--force").code == 0
    assert "still TODO" in unbend("check", out).err


def test_wrong_inputs_are_refused_in_words(mission, unbend, tmp_path):
    (tmp_path / "no.bin").write_bytes(b"nothing of a log" * 100)
    (tmp_path / "no.csv").write_text("image,point\na,b\nc,d,e\n", encoding="utf-8")
    assert "LOG-FORMAT" in unbend("init", tmp_path / "no.bin", "--out", "-").err
    assert "LOG-MISSING" in unbend("init", tmp_path / "none.bin", "--out", "-").err
    assert "OBS-CSV" in unbend("init", mission.log, tmp_path / "no.csv", "--out", "-").err
    assert "OBS-MISSING" in unbend("init", mission.log, tmp_path / "none.csv", "--out", "-").err
    other = "SourceFile,DateTimeOriginal\nx/DSC_1.JPG,2026:05:14 10:00:00\n"
    (tmp_path / "images.csv").write_text(other, encoding="utf-8")
    words = (mission.log, mission.folder / "observations.parquet", "--out", "-")
    assert "IMAGES-OTHER" in unbend("init", *words, "--images", tmp_path / "images.csv").err


def test_columns_and_heights_are_asked_for_where_their_names_do_not_say_it(mission, unbend):
    seen = (
        mission.measurements()
        .to_pandas()
        .rename(columns={"image": "Filename", "x_px": "x", "h_g_m": "Z_ellipsoid"})
    )
    seen.to_csv(mission.folder / "o.csv", index=False)
    text = unbend("init", mission.log, mission.folder / "o.csv", "--out", "-").out
    assert "    image: Filename  # guessed by its name" in text
    assert "    x_px: x  # guessed by its name" in text
    tree = yaml.safe_load(text)
    assert tree["ground"] == {"height": {"column": "Z_ellipsoid"}, "reference": "ellipsoid"}
    assert "guessed by the name of the column" in text
    assert "height: {column: Z_ellipsoid}  # guessed by its name" in text
    seen.rename(columns={"Filename": "bild"}).to_csv(mission.folder / "o.csv", index=False)
    text = unbend("init", mission.log, mission.folder / "o.csv", "--out", "-").out
    assert re.search(r"    image: TODO  # one of bild, point", text)
    assert yaml.safe_load(text)["observations"]["columns"]["x_px"] == "x"


def test_images_with_local_times_ask_for_the_time_zone(mission, unbend, tmp_path):
    names = sorted(set(mission.measurements()["image"].to_pylist()))
    rows = [f"x/{name}.JPG,2025:06:12 10:00:{k:02d}" for k, name in enumerate(names)]
    (tmp_path / "images.csv").write_text("\n".join(["SourceFile,DateTimeOriginal", *rows]))
    words = (mission.log, mission.folder / "observations.parquet", "--out", "-")
    tree = yaml.safe_load(unbend("init", *words, "--images", tmp_path / "images.csv").out)
    assert tree["events"]["images"]["time_zone"] == "TODO"


def channel(name: str, numbers: list[int]) -> Channel:
    return Channel(
        name,
        np.arange(len(numbers)) * 10**9,
        {"event_index": np.array(numbers, float)},
        Source(name),
        roles=("events",),
    )


def names(prefix: str, numbers: range) -> tuple[str, ...]:
    return tuple(f"{prefix}{n:04d}.tif" for n in numbers)


def test_two_cameras_by_one_channel_are_a_question():
    events = (channel("CAM[0]", [*range(1, 9)]),)
    cameras = proposed_cameras(events, names("left_", range(1, 9)) + names("right_", range(1, 9)))
    assert [c.name for c in cameras] == ["left", "right"]
    assert [c.channel.value for c in cameras] == ["TODO", "TODO"]
    assert "CAM[0] (8 events)" in cameras[0].channel.remark


def test_each_camera_gets_the_channel_that_counts_alike():
    events = (channel("CAM[0]", [*range(1, 9)]), channel("CAM[1]", [*range(3, 9)]))
    cameras = proposed_cameras(events, names("a_", range(3, 9)) + names("b_", range(1, 9)))
    found = {c.name: (c.channel.value, c.image.value) for c in cameras}
    assert found == {
        "b": ('"CAM[0]"', '"b_{index:04d}.tif"'),
        "a": ('"CAM[1]"', '"a_{index:04d}.tif"'),
    }


@pytest.mark.parametrize("numbers", [range(700, 708), range(2, 9), range(1, 8), range(9)])
def test_names_that_do_not_count_as_the_log_are_left_to_the_evidence(numbers):
    """Also where the first or last is missing: the camera's own count may begin elsewhere."""
    events = (channel("CAM[0]", [*range(1, 9)]),)
    (camera,) = proposed_cameras(events, names("DSC_", numbers))
    assert (camera.name, camera.channel.value) == ("camera", '"CAM[0]"')
    assert camera.image.value == '"DSC_*.tif"'
    assert "DSC_{index:04d}.tif" in camera.image.remark


def test_the_place_of_a_flight_across_the_180th_meridian():
    columns = {"lat_rad": np.radians([-17.0, -17.0]), "lon_rad": np.radians([179.99, -179.97])}
    time_ns = np.array([0, 1], dtype=np.int64)
    position = Channel("GPS[0]", time_ns, columns, source=Source("GPS"))
    assert place_remark({"position": position}) == "place: latitude -17.0000, longitude -179.9900"


def test_without_events_their_table_is_asked_for(mission, unbend, monkeypatch):
    facts = replace(facts_of_log(mission.log), events=())
    monkeypatch.setattr(mission_text, "facts_of_log", lambda _: facts)
    text = propose_mission(mission.log, None, None, mission.file)
    assert yaml.safe_load(text)["events"] == {"csv": {"path": "TODO"}}
    assert "# the log has no camera events" in text
    mission.file.write_text(text, encoding="utf-8")
    assert "events.csv.path" in todo_of_check(unbend, mission.file)


def test_a_block_alone_asks_for_its_frame_and_its_day(unbend, tmp_path):
    block = tmp_path / "sparse"
    block.mkdir()
    (block / "cameras.txt").write_text("1 PINHOLE 6000 4000 5000 5000 3000 2000\n")
    (block / "images.txt").write_text(
        "1 0 1 0 0 0 0 100 1 a_1.jpg\n10 20 1 30 40 2\n2 0 1 0 0 10 0 100 1 a_2.jpg\n11 21 1\n"
    )
    (block / "points3D.txt").write_text("1 0 0 0 0 0 0 1 1 0 2 0\n2 5 5 0 0 0 0 1 1 1\n")
    out = tmp_path / "mission.yaml"
    assert unbend("init", block, "--out", out).code == 0
    tree = yaml.safe_load(out.read_text(encoding="utf-8"))
    assert tree["observations"] == {"path": "sparse", "format": "colmap", "refraction": "TODO"}
    assert todo_of_check(unbend, out) == {
        "cameras.a.calibration",
        "stations.orientation.frame",
        "stations.orientation.date",
        "observations.refraction",
    }
    enu = {"enu": {"lat_deg": 47.0, "lon_deg": 8.5, "h_ellipsoid_m": 500.0}}
    truth = {
        "cameras": {"a": {"calibration": "laboratory"}},
        "stations": {"orientation": {"frame": enu, "date": "2026-05-14"}},
    }
    out.write_text(yaml.safe_dump(answered(tree, truth)), encoding="utf-8")
    ended = unbend("check", out)
    assert ended.code in (0, 3), ended.text  # two images: findings, no refusal


def test_choices_stand_with_what_the_sensors_read(unbend, flown):
    """By the CSV of the log's messages."""
    text = unbend("init", flown.logs["bin"], "--out", "-").out
    for field, key, unit in (("Temp", "temperature", "°C"), ("Humidity", "humidity", "%")):
        said = []
        for instance in ("0", "1"):
            words = ("--type", "HYGR", "--instance", instance, "--csv")
            rows = csv.DictReader(io.StringIO(unbend("inspect", flown.logs["bin"], *words).out))
            read = [float(row[field]) for row in rows]
            said.append(f"HYGR[{instance}] ({min(read):.0f} to {max(read):.0f} {unit})")
        assert f"    {key}: TODO  # {' or '.join(said)}: the sensor outside" in text


@pytest.mark.parametrize("kind", ["ulg", "opensfm", "reconstruction.json", "photographs", "folder"])
def test_every_kind_of_beginning(kind, unbend, tmp_path):
    log = tmp_path / "flight.ulg"
    log.write_bytes(flight())
    project = tmp_path / "project"
    project.mkdir()
    (project / "reconstruction.json").write_text(
        json.dumps(
            [
                {
                    "cameras": {
                        "c": {
                            "projection_type": "perspective",
                            "width": 600,
                            "height": 400,
                            "focal": 0.8,
                            "k1": 0.0,
                            "k2": 0.0,
                        }
                    },
                    "shots": {
                        f"{n}.jpg": {
                            "rotation": [3.14, 0, 0],
                            "translation": [0, 0, 9],
                            "camera": "c",
                        }
                        for n in (1, 2)
                    },
                    "points": {"7": {"coordinates": [0.0, 0.0, 0.0]}},
                }
            ]
        ),
        encoding="utf-8",
    )
    rows = [f"{n}.jpg\t7\t0\t0.1\t0.1\t0.01\t0\t0\t0\t-1\t-1" for n in (1, 2)]
    tracks = "\n".join(["OPENSFM_TRACKS_VERSION_v2", *rows, ""])
    (project / "tracks.csv").write_text(tracks, encoding="utf-8")
    block = {"path": "project", "format": "opensfm", "refraction": "TODO"}
    words, expected = {
        "ulg": ((log, project), {"log": {"path": "flight.ulg"}, "observations": block}),
        "opensfm": ((project,), {"observations": block, "ground": {"height": "block"}}),
        "reconstruction.json": ((project / kind,), {"observations": block}),
        "photographs": ((log, "--images", project / "images.csv"), {"log": {"path": "flight.ulg"}}),
        "folder": ((tmp_path,), None),
    }[kind]
    (project / "images.csv").write_text(
        "SourceFile,DateTimeOriginal\nA_0001.JPG,2023:11:14 22:13:26\n", encoding="utf-8"
    )
    ended = unbend("init", *words, "--out", tmp_path / "mission.yaml")
    if expected is None:
        assert (ended.code, ended.err.partition(":")[0]) == (6, "INPUT-MISSING")
        return
    assert ended.code == 0, ended.text
    tree = yaml.safe_load((tmp_path / "mission.yaml").read_text(encoding="utf-8"))
    assert {key: tree[key] for key in expected} == expected
    if kind == "photographs":
        assert tree["events"]["images"]["path"] == "project/images.csv"
    assert todo_of_check(unbend, tmp_path / "mission.yaml") == {
        ".".join(place) for place in places_of_todo(tree)
    }


@pytest.mark.parametrize("name", ["2025-06-12_flight", "0012", "null", "Flug 7"])
def test_results_get_a_folder_of_the_name_of_the_mission(mission, unbend, tmp_path, name):
    log = tmp_path / f"{name}.bin"
    log.write_bytes(mission.log.read_bytes())
    tree = yaml.safe_load(unbend("init", log, "--out", "-").out)
    assert tree["output"] == {"path": f"results/{tree['mission']['name']}"}


@pytest.mark.parametrize("column", ["ground_m", "terrain_h", "Höhe", "z", "msl_m"])
def test_columns_of_heights_are_known_by_their_names(mission, unbend, column):
    seen = mission.measurements().to_pandas().rename(columns={"h_g_m": column})
    seen.to_csv(mission.folder / "o.csv", index=False)
    tree = yaml.safe_load(unbend("init", mission.log, mission.folder / "o.csv", "--out", "-").out)
    assert tree["ground"]["height"] == {"column": column}


def test_names_of_files_do_not_break_the_yaml(mission, unbend, tmp_path):
    odd = tmp_path / "a: b #c, {d}.bin"
    odd.write_bytes(mission.log.read_bytes())
    seen = mission.measurements().to_pandas()
    seen["image"] = 'x: "{y}" # ' + seen["image"]
    seen.to_csv(tmp_path / "o #1.csv", index=False)
    text = unbend("init", odd, tmp_path / "o #1.csv", "--out", "-").out
    tree = yaml.safe_load(text)
    assert tree["log"]["path"].endswith("a: b #c, {d}.bin")
    assert tree["observations"]["path"].endswith("o #1.csv")
    images = [events["image"] for events in tree["events"]["log"].values()]
    assert all(image.format(index=1) in set(seen["image"]) for image in images)


def test_a_series_of_names_has_the_pattern_that_gives_them_again():
    for own in (["a_0009.tif", "a_0010.tif"], ["x9", "x10"], ["l/7.tif"], ["{0}_1", "{0}_2"]):
        (series,) = name_series(own)
        assert sorted(series.pattern("n").format(n=k) for k in series.numbers) == sorted(own)


@pytest.mark.parametrize(
    "name", at_hand("beastayyg_sample.bin", "ardusub_small.BIN", "cubs2_cub_stabilize.mcap")
)
def test_real_logs_without_a_camera_ask_for_what_is_open(name, unbend, tmp_path):
    out = tmp_path / "mission.yaml"
    assert unbend("init", SHARED / name, "--out", out).code == 0
    todo = {".".join(p) for p in places_of_todo(yaml.safe_load(out.read_text(encoding="utf-8")))}
    assert todo_of_check(unbend, out) == todo
    assert "events.csv.path" in todo


@pytest.mark.shared("logs")
def test_a_flight_of_two_cameras_runs_once_the_questions_are_answered(unbend, tmp_path):
    """Of the second, 128 triggers are 128 images; of the first, pulses were lost."""
    truth = pd.read_csv(SHARED / "sitl_belowsea_2cam_truth.csv")
    flown = truth[truth["row"] == "CAM"]
    images = [f"head{i}_{n:05d}" for i, n in zip(flown["I"], flown["Img"], strict=True)]
    rng = np.random.default_rng(3)
    count = 4 * len(images)
    pd.DataFrame(
        {
            "image": np.repeat(images, 4),
            "point": [f"p{i}" for i in range(count)],
            "x_px": rng.uniform(0, 6000, count),
            "y_px": rng.uniform(0, 4000, count),
            "h_g_m": -430.0,
        }
    ).to_csv(tmp_path / "o.csv", index=False)
    out = tmp_path / "mission.yaml"
    log = SHARED / "sitl_belowsea_2cam.BIN"
    assert unbend("init", log, tmp_path / "o.csv", "--out", out).code == 0
    tree = yaml.safe_load(out.read_text(encoding="utf-8"))
    assert set(tree["cameras"]) == {"head0", "head1"}
    answers = {
        "cameras": dict.fromkeys(tree["cameras"], CAMERA),
        "mount": dict.fromkeys(tree["mount"], AT_REST),
        "ground": {"reference": "msl"},
        "events": {"log": {f"head{i}": {"channel": f"CAM[{i}]"} for i in (0, 1)}},
    }
    out.write_text(yaml.safe_dump(answered(tree, answers)), encoding="utf-8")
    ended = unbend("check", out)
    assert ended.code in (0, 3), ended.text
    assert "PLAUSIBLE" not in ended.text
    assert "no_station" not in ended.text


def test_one_stray_name_does_not_hide_that_the_others_count_as_the_log():
    events = (channel("CAM[0]", [*range(1, 29)]),)
    (camera,) = proposed_cameras(events, (*names("a_", range(1, 29)), "a_9999.tif"))
    assert camera.image.value == '"a_{index:04d}.tif"'
    assert camera.image.remark.endswith("1 to 28; not a_9999.tif")
    (camera,) = proposed_cameras(events, names("a_", range(1, 30)))  # an event may be lost
    assert camera.image.value == '"a_*.tif"'
