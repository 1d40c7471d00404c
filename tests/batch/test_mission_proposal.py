"""`unbend init`: what it writes loads, asks for what is open, and runs with the truth filled in."""

import io
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.helpers import channel
from tests.ingest.ulog.test_log import flight
from tests.ingest.written_logs import MavlinkWriter
from tests.logs import LOGS, at_hand
from unbend.batch.proposal import mission_text
from unbend.batch.proposal.log_facts import (
    LogFacts,
    cabin_barometers_of,
    enclosed_remark,
    facts_of_log,
    highest_of,
    place_remark,
)
from unbend.batch.proposal.mission_text import propose_mission
from unbend.batch.proposal.proposed_cameras import proposed_cameras
from unbend.batch.proposal.table_facts import block_format
from unbend.flight.channels import Channel
from unbend.flight.image_names import name_series

TWO_HEADS = yaml.safe_load("""
cameras:
  head0: &camera
    width_px: 6000
    height_px: 4000
    f_px: 5000.0
    cx_px: 3000.0
    cy_px: 2000.0
    calibration: laboratory
  head1: *camera
mount:
  head0: &at_rest {roll_deg: 0.0, pitch_deg: 0.0, yaw_deg: 0.0}
  head1: *at_rest
events: {log: {head0: {channel: "CAM[0]"}, head1: {channel: "CAM[1]"}}}
ground: {reference: msl}
observations: {refraction: none}
""")


def keys_of_todo(tree):
    """Where a TODO is, with dots."""
    keys = set()
    for key, value in tree.items():
        if value == "TODO":
            keys.add(key)
        elif isinstance(value, dict):
            keys |= {f"{key}.{inner}" for inner in keys_of_todo(value)}
    return keys


def answered(tree, truth):
    """The tree with the truth in the place of each TODO, and nothing else changed."""
    answers = {}
    for key, value in tree.items():
        if value == "TODO":
            answers[key] = truth[key]
        elif isinstance(value, dict) and keys_of_todo(value):
            answers[key] = answered(value, truth[key])
    return tree | answers


@pytest.fixture
def todo_of_check(refusal_of):
    """The keys that `check` says are open; it says nothing else."""

    def check(path):
        text = refusal_of("CONFIG-TODO", 2, "check", path)
        keys = re.findall(r"(?:line \d+: )(\S+): still TODO: \w+", text)
        assert len(keys) == text.count("line ")
        return set(keys)

    return check


def tree_of(path):
    return yaml.safe_load(path.read_text("utf-8"))


@pytest.fixture
def proposed(obeyed):
    """The text that `init` proposes for a log and other words."""

    def propose(*words):
        return obeyed("init", *words, "--out", "-")

    return propose


@pytest.fixture
def table(mission):
    """Writes the measurements as a CSV with other names of columns; its path."""

    def write(**columns):
        path = mission.folder / "o.csv"
        rows = mission.measured_rows()
        rows.rename(columns=columns).to_csv(path, index=False)
        return path

    return write


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_with_the_truth_filled_in_it_gives_what_the_mission_file_of_the_flight_gives(
    kind, mission_factory, baseline, plain_report, unbend, tmp_path, obeyed, todo_of_check
):
    flown = mission_factory(tmp_path / "mission", kind)
    truth = flown.config
    ended = unbend("init", flown.log, flown.folder / "observations.parquet", "--out", flown.file)
    assert ended.code == 0, ended.text
    text = flown.file.read_text("utf-8")
    assert text.startswith("# yaml-language-server: $schema=mission.schema.json\n")
    assert (flown.folder / "mission.schema.json").is_file()
    tree = yaml.safe_load(text)
    todo = keys_of_todo(tree)
    assert todo_of_check(flown.file) == todo
    assert f"{len(todo)} open questions" in ended.out
    assert {"cameras.nadir.f_px", "mount.oblique.roll_deg", "ground.reference"} <= todo
    assert tree["events"]["log"]["nadir"]["image"] == truth["events"]["log"]["nadir"]["image"]
    assert tree["ground"]["height"] == {"column": "h_g_m"}
    for camera in truth["cameras"].values():
        camera["f_px"] = camera["fx_px"]
    truth["observations"]["refraction"] = "none"
    # Of the log, channels alone may be asked for.
    truth["log"] = {"channels": {"cabin_humidity": None} | truth["log"]["channels"]}
    flown.config = answered(tree, truth)
    # What init leaves out, and says so: lever arms, distortion; the undulation is the geoid's.
    flown.config["mission"] = truth["mission"]
    for name, camera in truth["cameras"].items():
        flown.config["cameras"][name]["distortion"] = camera["distortion"]
        flown.config["mount"][name]["lever_arm_m"] = truth["mount"][name]["lever_arm_m"]
    obeyed("check", flown.save())
    if kind == "bin":
        flown.run_to_manifest()
        results = flown.result_rows()
        pd.testing.assert_frame_equal(results, baseline.result_rows(), check_exact=True)


def test_a_bare_camera_takes_twenty_lines(mission, monkeypatch):
    """Beside remarks on lines of their own; the flight has one channel, and no cabin."""
    rows = mission.measured_rows()
    table = mission.folder / "o.csv"
    rows[rows["image"].str.startswith("nadir")].to_csv(table, index=False)
    facts = LogFacts(events=(events("CAM[0]", 1, 3),), takeoff="take-off 450 m above the sea")
    monkeypatch.setattr(mission_text, "facts_of_log", lambda _: facts)

    text = propose_mission(mission.log, table, None, mission.file)

    remarks = re.findall(r"^ *#", text, re.MULTILINE)
    assert len(text.splitlines()) - len(remarks) <= 20
    assert "refraction: TODO}" in text
    assert 'nadir: {channel: "CAM[0]", image: "nadir_{index:05d}"}  # guessed: 3 images' in text
    assert "ground: {height: {column: h_g_m}, reference: TODO}" in text


def test_nothing_is_written_over(mission, unbend, tmp_path, obeyed, refusal_of):
    out = tmp_path / "mine.yaml"
    out.write_text("mine", "utf-8")
    refusal_of("INIT-EXISTS", 2, "init", mission.log, "--out", out)
    assert out.read_text("utf-8") == "mine"
    obeyed("init", mission.log, "--out", out, "--force")
    assert "still TODO" in unbend("check", out).err


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("no.bin", "LOG-FORMAT"),
        ("none.bin", "LOG-MISSING"),
        ("flight.bin no.csv", "OBS-CSV"),
        ("flight.bin none.csv", "OBS-MISSING"),
        ("flight.bin observations.parquet --images images.csv", "IMAGES-OTHER"),
    ],
)
def test_wrong_inputs_are_refused_in_words(mission, unbend, monkeypatch, words, code):
    monkeypatch.chdir(mission.folder)
    Path("no.bin").write_bytes(b"nothing of a log" * 100)
    Path("no.csv").write_text("image,point\na,b\nc,d,e\n", "utf-8")
    images = "SourceFile,DateTimeOriginal\nx/DSC_1.JPG,2026:05:14 10:00:00\n"
    Path("images.csv").write_text(images, "utf-8")
    assert code in unbend("init", *words.split(), "--out", "-").err


def test_columns_are_guessed_by_their_names(mission, proposed, table):
    text = proposed(mission.log, table(image="Filename", x_px="x", h_g_m="Z_ellipsoid"))
    assert "    image: Filename  # guessed by its name" in text
    assert "    x_px: x  # guessed by its name" in text
    assert "guessed by the name of the column" in text
    assert "height: {column: Z_ellipsoid}  # guessed by its name" in text
    ground = yaml.safe_load(text)["ground"]
    assert ground == {"height": {"column": "Z_ellipsoid"}, "reference": "ellipsoid"}


def test_columns_are_asked_for_where_their_names_do_not_say_it(mission, proposed, table):
    text = proposed(mission.log, table(image="bild", x_px="x"))
    assert "    image: TODO  # one of bild, point" in text
    assert "its images are not known yet: image: no column has a usual name" in text
    assert yaml.safe_load(text)["observations"]["columns"]["x_px"] == "x"


def test_images_are_known_before_the_column_of_the_points_is(mission, proposed, table):
    usual = yaml.safe_load(proposed(mission.log, table()))
    tree = yaml.safe_load(proposed(mission.log, table(point="Nr", image="Photo")))
    assert tree["observations"]["columns"] == {"image": "Photo", "point": "TODO"}
    assert tree["events"] == usual["events"]


def test_the_column_of_the_heights_is_not_taken_for_the_points(mission, proposed, tmp_path):
    rows = mission.measured_rows().rename(columns={"point": "tie_label"})
    path = tmp_path / "observations.csv"
    rows[["image", "x_px", "y_px", "h_g_m", "tie_label"]].to_csv(path, index=False)
    tree = yaml.safe_load(proposed(mission.log, path))
    assert tree["ground"]["height"] == {"column": "h_g_m"}


@pytest.mark.parametrize("point", ["tie point id", "Point-ID", "TIE_ID"])
def test_blanks_hyphens_and_capitals_of_a_name_do_not_count(mission, proposed, table, point):
    tree = yaml.safe_load(proposed(mission.log, table(point=point)))
    assert tree["observations"]["columns"]["point"] == point


@pytest.mark.parametrize("column", ["ground_m", "terrain_h", "Höhe", "z", "msl_m"])
def test_columns_of_heights_are_known_by_their_names(mission, proposed, table, column):
    tree = yaml.safe_load(proposed(mission.log, table(h_g_m=column)))
    assert tree["ground"]["height"] == {"column": column}


def test_images_with_local_times_ask_for_the_time_zone(mission, proposed, tmp_path):
    image = mission.measurements()["image"][0]
    images = tmp_path / "images.csv"
    images.write_text(f"SourceFile,DateTimeOriginal\nx/{image}.JPG,2025:06:12 10:00:00\n")
    observations = mission.folder / "observations.parquet"
    tree = yaml.safe_load(proposed(mission.log, observations, "--images", images))
    assert tree["events"]["images"]["time_zone"] == "TODO"


def events(name, first, last) -> Channel:
    """A channel of exposures with these numbers in the log."""
    numbers = np.arange(first, last + 1)
    return channel(name, numbers, "events", event_index=numbers)


def names(prefix, first, last):
    return tuple(f"{prefix}{number:04d}.tif" for number in range(first, last + 1))


CAMERAS = {
    "two series, one channel": (
        [events("CAM[0]", 1, 8)],
        names("left_", 1, 8) + names("right_", 1, 8),
        {"left": "TODO left_{index:04d}.tif", "right": "TODO right_{index:04d}.tif"},
        "CAM[0] (8 events)",
    ),
    "channels that count alike": (
        [events("CAM[0]", 1, 8), events("CAM[1]", 3, 8)],
        names("a_", 3, 8) + names("b_", 1, 8),
        {"b": "CAM[0] b_{index:04d}.tif", "a": "CAM[1] a_{index:04d}.tif"},
        "8 images count as the log does, 1 to 8",
    ),
    "one stray name": (
        [events("CAM[0]", 1, 28)],
        (*names("a_", 1, 28), "a_9999.tif"),
        {"a": "CAM[0] a_{index:04d}.tif"},
        "1 to 28; not a_9999.tif",
    ),
    "an event may be lost": (
        [events("CAM[0]", 1, 28)],
        names("a_", 1, 29),
        {"a": "CAM[0] a_*.tif"},
        "numbers and tie points assign 29 images",
    ),
}


@pytest.mark.parametrize(
    ("channels", "images", "expected", "remark"),
    CAMERAS.values(),
    ids=CAMERAS,
)
def test_cameras_get_the_channels_that_count_as_their_images(channels, images, expected, remark):
    cameras = proposed_cameras(channels, images)
    proposals = {}
    for camera in cameras:
        proposal = f"{camera.channel.value} {camera.image.value}"
        proposals[camera.name] = proposal.replace('"', "")
    assert list(proposals.items()) == list(expected.items())
    first = cameras[0]
    assert remark in f"{first.channel.remark}; {first.image.remark}"


@pytest.mark.parametrize(("first", "last"), [(700, 707), (2, 8), (1, 7), (0, 8)])
def test_names_that_do_not_count_as_the_log_are_left_to_the_evidence(first, last):
    """Also where the first or last is missing: the camera's own count may begin elsewhere."""
    (camera,) = proposed_cameras([events("CAM[0]", 1, 8)], names("DSC_", first, last))
    assert camera.name == "camera"
    assert camera.channel.value == '"CAM[0]"'
    assert camera.image.value == '"DSC_*.tif"'
    may_be_numbers_of_log = first <= 8
    assert ("DSC_{index:04d}.tif" in camera.image.remark) == may_be_numbers_of_log


def test_the_place_of_a_flight_across_the_180th_meridian():
    lat_rad = np.radians([-17.0, -17.0])
    lon_rad = np.radians([179.99, -179.97])
    position = channel("GPS[0]", np.arange(2), lat_rad=lat_rad, lon_rad=lon_rad)
    assert place_remark({"position": position}) == "place: latitude -17.0000, longitude -179.9900"


def test_without_events_their_table_is_asked_for(mission, monkeypatch, todo_of_check):
    facts = replace(facts_of_log(mission.log), events=())
    monkeypatch.setattr(mission_text, "facts_of_log", lambda _: facts)
    text = propose_mission(mission.log, None, None, mission.file)
    assert yaml.safe_load(text)["events"] == {"csv": {"path": "TODO"}}
    assert "# the log has no camera events" in text
    mission.file.write_text(text, "utf-8")
    assert "events.csv.path" in todo_of_check(mission.file)


def test_a_block_alone_asks_for_its_frame_and_its_day(unbend, tmp_path, obeyed, todo_of_check):
    block = tmp_path / "sparse"
    block.mkdir()
    (block / "cameras.txt").write_text("1 PINHOLE 6000 4000 5000 5000 3000 2000\n")
    (block / "images.txt").write_text(
        "1 0 1 0 0 0 0 100 1 a_1.jpg\n10 20 1 30 40 2\n2 0 1 0 0 10 0 100 1 a_2.jpg\n11 21 1\n"
    )
    (block / "points3D.txt").write_text("1 0 0 0 0 0 0 1 1 0 2 0\n2 5 5 0 0 0 0 1 1 1\n")
    out = tmp_path / "mission.yaml"
    obeyed("init", block, "--out", out)
    tree = tree_of(out)
    assert tree["observations"] == {"path": "sparse", "format": "colmap", "refraction": "TODO"}
    assert todo_of_check(out) == {
        "cameras.a.calibration",
        "stations.orientation.frame",
        "stations.orientation.date",
        "observations.refraction",
    }
    truth = yaml.safe_load("""
    cameras: {a: {calibration: laboratory}}
    observations: {refraction: none}
    stations:
      orientation:
        frame: {enu: {lat_deg: 47.0, lon_deg: 8.5, h_ellipsoid_m: 500.0}}
        date: "2026-05-14"
    """)
    out.write_text(yaml.safe_dump(answered(tree, truth)), encoding="utf-8")
    ended = unbend("check", out)
    assert ended.code in (0, 3), ended.text  # two images: findings, no refusal


def test_choices_stand_with_what_the_sensors_read(unbend, flown):
    """By the CSV of the log's messages."""
    log = flown.logs["bin"]
    text = unbend("init", log, "--out", "-").out
    for field, key, unit in (("Temp", "temperature", "°C"), ("Humidity", "humidity", "%")):
        choices = []
        for instance in (0, 1):
            ended = unbend("inspect", log, "--type", "HYGR", "--instance", instance, "--csv")
            readings = pd.read_csv(io.StringIO(ended.out))[field]
            span = f"{readings.min():.0f} to {readings.max():.0f} {unit}"
            choices.append(f"HYGR[{instance}] ({span})")
        assert f"    {key}: TODO  # {' or '.join(choices)}: the sensor outside" in text


PROJECT = """[{
  "cameras": {"c": {"projection_type": "perspective", "width": 600, "height": 400,
                    "focal": 0.8, "k1": 0.0, "k2": 0.0}},
  "shots": {"1.jpg": {"rotation": [3.14, 0, 0], "translation": [0, 0, 9], "camera": "c"},
            "2.jpg": {"rotation": [3.14, 0, 0], "translation": [0, 0, 9], "camera": "c"}},
  "points": {"7": {"coordinates": [0.0, 0.0, 0.0]}}
}]"""
TRACKS = """OPENSFM_TRACKS_VERSION_v2
1.jpg\t7\t0\t0.1\t0.1\t0.01\t0\t0\t0\t-1\t-1
2.jpg\t7\t0\t0.1\t0.1\t0.01\t0\t0\t0\t-1\t-1
"""
IMAGES = "SourceFile,DateTimeOriginal\nA_0001.JPG,2023:11:14 22:13:26\n"
LOG = {"path": "flight.ulg"}
BLOCK = {"path": "project", "format": "opensfm", "refraction": "TODO"}


@pytest.fixture
def beginnings(tmp_path, monkeypatch):
    """The current folder: a log, and a project with images."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.ulg").write_bytes(flight())
    project = tmp_path / "project"
    project.mkdir()
    (project / "reconstruction.json").write_text(PROJECT, "utf-8")
    (project / "tracks.csv").write_text(TRACKS, "utf-8")
    (project / "images.csv").write_text(IMAGES, "utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("flight.ulg project", {"log": LOG, "observations": BLOCK}),
        ("project", {"observations": BLOCK, "ground": {"height": "block"}}),
        ("project/reconstruction.json", {"observations": BLOCK}),
        ("flight.ulg --images project/images.csv", {"log": LOG}),
    ],
)
def test_every_kind_of_beginning(words, expected, beginnings, obeyed, todo_of_check):
    out = beginnings / "mission.yaml"
    obeyed("init", *words.split(), "--out", out.name)
    tree = tree_of(out)
    assert tree | expected == tree
    if "--images" in words:
        assert tree["events"]["images"]["path"] == "project/images.csv"
    assert todo_of_check(out) == keys_of_todo(tree)


@pytest.mark.parametrize(
    ("name", "text", "program"),
    [
        ("block.xml", '<?xml version="1.0"?>\n<BlocksExchange version="3.2">', "blocksexchange"),
        ("block.xml", "<document><chunks/></document>", "metashape"),
        ("block.xml", "<!-- DBAT --><document/>", "dbat"),
        ("flight_calibrated_camera_parameters.txt", "fileName imageWidth", "pix4d"),
    ],
)
def test_the_program_of_a_block(name, text, program, tmp_path):
    file = tmp_path / name
    file.write_text(text, "utf-8")

    assert block_format(tmp_path if program == "pix4d" else file) == program


def test_a_folder_is_no_beginning(unbend, beginnings):
    ended = unbend("init", ".", "--out", "mission.yaml")
    assert ended.code == 6
    assert ended.err.startswith("INPUT-MISSING:")


@pytest.mark.parametrize("name", ["2025-06-12_flight", "0012", "null", "Flug 7"])
def test_results_get_a_folder_of_the_name_of_the_mission(mission, proposed, tmp_path, name):
    log = mission.log.rename(tmp_path / f"{name}.bin")
    tree = yaml.safe_load(proposed(log))
    assert tree["output"] == {"path": f"results/{tree['mission']['name']}"}


def test_names_of_files_do_not_break_the_yaml(mission, proposed, tmp_path):
    log = mission.log.rename(tmp_path / "a: b #c, {d}.bin")
    rows = mission.measured_rows()
    rows["image"] = 'x: "{y}" # ' + rows["image"]
    path = tmp_path / "o #1.csv"
    rows.to_csv(path, index=False)
    tree = yaml.safe_load(proposed(log, path))
    assert tree["log"]["path"].endswith("a: b #c, {d}.bin")
    assert tree["observations"]["path"].endswith("o #1.csv")
    for section in tree["events"]["log"].values():
        assert section["image"].format(index=1) in set(rows["image"])


def tlog_with_a_still_barometer(path, highest_m):
    """A .tlog of a climb from 500 m, of which SCALED_PRESSURE2 is always 955 hPa."""
    writer = MavlinkWriter()
    for second in range(300):
        height_m = 500.0 + (highest_m - 500.0) * min(second / 200.0, 1.0)
        pressure_hpa = 1013.25 * (1.0 - 2.25577e-5 * height_m) ** 5.25588
        host_us = 1_748_000_000_000_000 + 900_000 * second
        writer.send(
            "gps_raw_int",
            host_us,
            time_usec=1_000_000 * second,
            fix_type=3,
            lat=474_000_000 + 100 * second,
            lon=85_000_000,
            alt=round(1000.0 * height_m),
            eph=100,
            epv=100,
            satellites_visible=12,
        )
        air = {"time_boot_ms": 1000 * second, "temperature": 2000}
        writer.send("scaled_pressure", host_us + 300_000, press_abs=pressure_hpa, **air)
        writer.send("scaled_pressure2", host_us + 600_000, press_abs=955.0, **air)
    path.write_bytes(writer.data)
    return path


@pytest.mark.parametrize("highest_m", [1500.0, 4000.0])
def test_below_2_km_a_second_barometer_proposes_no_window(tmp_path, highest_m):
    log = tlog_with_a_still_barometer(tmp_path / "flight.tlog", highest_m)

    text = propose_mission(log, None, None, tmp_path / "mission.yaml")

    is_high = highest_m > 2000.0
    assert ("window: TODO" in text) == is_high
    assert ("SCALED_PRESSURE2 is in a closed compartment" in text) == is_high
    assert ("SCALED_PRESSURE2 is not used: it does not follow the height" in text) != is_high
    assert ("so no window is proposed" in text) != is_high


@pytest.mark.parametrize(
    ("indoors", "highest_m", "names", "remark"),
    [
        ([], 6000.0, "", ""),
        (["BARO[1]"], 6000.0, "BARO[1]", "BARO[1] is in a closed compartment"),
        (["BARO[1]"], 2000.0, "BARO[1]", "BARO[1] is in a closed compartment"),
        (["BARO[1]"], 1999.0, "", "BARO[1] is not used: it does not follow the height"),
        (["BARO[1]"], math.nan, "BARO[1]", "BARO[1] is in a closed compartment"),
    ],
)
def test_a_compartment_may_be_a_cabin_from_2_km_on_or_at_unknown_height(
    indoors, highest_m, names, remark
):
    cabin_barometers = cabin_barometers_of(indoors, highest_m)
    text = enclosed_remark(indoors, cabin_barometers)
    assert cabin_barometers == names
    assert text.startswith(remark)
    assert bool(text) == bool(remark)


def test_the_highest_height_is_unknown_without_heights():
    without_heights = channel("position", [0.0, 1.0], h_msl_m=math.nan)

    assert math.isnan(highest_of({}))
    assert math.isnan(highest_of({"height": without_heights}))


@pytest.mark.parametrize(
    "images",
    [["a_0009.tif", "a_0010.tif"], ["x10", "x9"], ["l/7.tif"], ["{0}_1", "{0}_2"]],
)
def test_a_series_of_names_has_the_pattern_that_gives_them_again(images):
    (series,) = name_series(images)
    pattern = series.pattern("n")
    assert sorted(pattern.format(n=number) for number in series.numbers) == images


NO_CAMERA = at_hand("beastayyg_sample.bin", "ardusub_small.BIN", "cubs2_cub_stabilize.mcap")


@pytest.mark.parametrize("name", NO_CAMERA)
def test_real_logs_without_a_camera_ask_for_what_is_open(name, tmp_path, obeyed, todo_of_check):
    out = tmp_path / "mission.yaml"
    obeyed("init", LOGS[name], "--out", out)
    todo = keys_of_todo(tree_of(out))
    assert todo_of_check(out) == todo
    assert "events.csv.path" in todo


@pytest.mark.shared("logs")
def test_a_flight_of_two_cameras_runs_once_the_questions_are_answered(unbend, tmp_path, obeyed):
    """Of the second, 128 triggers are 128 images; of the first, pulses were lost."""
    log = LOGS["sitl_belowsea_2cam.BIN"]
    truth = pd.read_csv(log.with_name("sitl_belowsea_2cam_truth.csv"))
    images = []
    for trigger in truth[truth["row"] == "CAM"].itertuples():
        images.append(f"head{trigger.I}_{trigger.Img:05d}")
    rng = np.random.default_rng(3)
    count = 4 * len(images)
    observations = pd.DataFrame(
        {
            "image": np.repeat(images, 4),
            "point": [f"p{number}" for number in range(count)],
            "x_px": rng.uniform(0, 6000, count),
            "y_px": rng.uniform(0, 4000, count),
            "h_g_m": -430.0,
        }
    )
    path = tmp_path / "o.csv"
    observations.to_csv(path, index=False)
    out = tmp_path / "mission.yaml"
    obeyed("init", log, path, "--out", out)
    tree = tree_of(out)
    assert set(tree["cameras"]) == {"head0", "head1"}
    out.write_text(yaml.safe_dump(answered(tree, TWO_HEADS)), encoding="utf-8")
    ended = unbend("check", out)
    assert ended.code in (0, 3), ended.text
    assert "PLAUSIBLE" not in ended.text
    assert "no_station" not in ended.text
