"""The mission file: every key misspelt, removed, repeated or given a wrong value."""

import copy
import random
import re
import string
import typing
from collections.abc import Iterator

import pytest
import yaml
from pydantic import BaseModel

from tests.config.conftest import C_LOADER, dumped
from unbend.config import Mission

FULL = yaml.safe_load("""
mission:
  name: survey
  undulation_m: 47.5
  geoid: egm96
  title: Zürich «Nord», Los 3 航空写真
  client: Amt
  operator: Luftbild GmbH
  remarks: "one\\n\\ntwo"
  time_zone: Europe/Zurich
log:
  path: a.bin
  channels:
    position: {name: POSITION, unit: null}
    height: {name: HEIGHT, unit: null}
    attitude: {name: ATTITUDE, unit: null}
    pressure: {name: PRESSURE, unit: hPa}
    temperature: {name: TEMPERATURE, unit: degC}
    humidity: {name: HUMIDITY, unit: percent}
    airspeed: {name: AIRSPEED, unit: m/s}
    cabin_pressure: {name: CABIN_PRESSURE, unit: kPa}
    cabin_temperature: {name: CABIN_TEMPERATURE, unit: K}
    cabin_humidity: {name: CABIN_HUMIDITY, unit: fraction}
    aircraft_attitude: {name: AIRCRAFT_ATTITUDE, unit: null}
  max_gap_s: 1.5
  local_origin: {lat_deg: 47.0, lon_deg: 11.0, h_ellipsoid_m: 600.0}
observations:
  path: o.parquet
  columns: {image: i, point: p, x_px: x, y_px: y, distance_m: d}
  pixel_origin: corner
  match_names: [case, digits]
  refraction: none
cameras:
  nadir:
    width_px: 14000
    height_px: 10600
    fx_px: 20000.0
    fy_px: 20000.0
    cx_px: 7000.0
    cy_px: 5300.0
    pixel_origin: centre
    distortion: {k1: 0.1, k2: 0.1, k3: 0.1, p1: 0.1, p2: 0.1}
    calibration: laboratory
    window:
      cabin:
        pressure_hpa: 800.0
        temperature_c: 20.0
        relative_humidity: 0.3
        sigma_pressure_hpa: 2.0
        sigma_temperature_k: 1.5
      shape: plane
      frame: camera
      normal: [0.0, 0.0, 1.0]
      in_calibration: glass
    principal_distance:
      reference: {pressure_hpa: 1013.25, temperature_c: 20.0}
      dc_dp_px_per_hpa: 0.0084
      dc_dt_px_per_k: 0.004
  window:  # a camera may be called like one of our keys
    width_px: 100
    height_px: 100
    f_px: 200.0
    cx_px: 50.0
    cy_px: 50.0
    calibration: in_flight_corrected
    window: {cabin: log}
  colmap:
    width_px: 100
    height_px: 100
    model: SIMPLE_RADIAL
    params: [200.0, 50.0, 50.0, -0.01]
    calibration: laboratory
  filed:
    file: cameras.json
    format: opensfm
    camera: v2 x
    width_px: 100
    height_px: 100
    calibration: laboratory
  metric:
    width_px: 100
    height_px: 100
    calibration: laboratory
    metric:
      focal_mm: 100.0
      pixel_um: [1000.0, 1000.0]
      format_mm: [100.0, 100.0]
      origin: image_centre
      axes: right up
      ppa_mm: [0.1, 0.0]
      ppbs_mm: [0.0, 0.0]
      radius_mm: 80.0
      distortion:
        sense: correction
        k0: 0.0
        k1: 1.0e-8
        k2: 0.0
        k3: 0.0
        k4: 0.0
        p1: 1.0e-7
        p2: 0.0
        b1: 1.0e-5
        b2: 0.0
      table:
        sense: distortion
        by: radius_mm
        rows: [[20.0, 0.0], [40.0, -0.5], [60.0, -2.0]]
mount:
  nadir:
    roll_deg: 0.0
    pitch_deg: 1.0
    yaw_deg: 2.0
    lever_arm_m: [0.1, 0.2, 0.3]
    sigma_tilt_deg: 0.05
    sigma_yaw_deg: 0.2
  window: {roll_deg: 45.0}
  colmap: {}
  filed: {}
  metric: {}
events:
  log:
    nadir: {channel: "CAM[0]", image: "n{index:05d}", delay_s: 0.1}
    window: {channel: "CAM[1]", image: "w{n}.tif"}
    colmap: {channel: "CAM[2]", image: "c{index}"}
    filed: {channel: "CAM[3]", image: "f{index}"}
    metric: {channel: "CAM[4]", image: "m{index}"}
  images: {path: images, time_zone: "+02:00"}
  first_image: {window: {image: w1.tif, event: 6}}
stations: {max_sigma_horizontal_m: 1.5, max_sigma_height_m: 2.0, max_sigma_tilt_deg: 0.5}
ground: {height: {column: h_g_m}, reference: msl, home_h_msl_m: 580.0, sigma_m: 2.0}
atmosphere:
  standard: us1976
  adjust: true
  index: gyer
  wavelength_m: 5.5e-7
  co2_ppm: 420.0
  climatology: auto
  board_temperature: true
  sensors:
    thermometer:
      bias_k: 0.3
      sigma_bias_k: 0.1
      lag_s: 4.0
      sigma_lag_s: 1.0
      transient_k: 0.0
      sigma_transient_k: 0.5
      recovery: 0.8
      sigma_recovery: 0.05
      sigma_drift_k: 0.1
    barometer: {offset_hpa: -0.2, sigma_offset_hpa: 0.1, sigma_scale: 0.0005}
    hygrometer: {bias: 0.01, sigma_bias: 0.01}
    gnss: {sigma_height_m: 0.1}
  model: {path: era5.nc, member: 0}
  soundings:
    - {path: s.csv, format: csv, station_h_msl_m: 500.0, across_coast_or_ridge: true}
  surface:
    - {h_msl_m: 500.0, metar: METAR EDDF 221150Z 12/08 Q1013, distance_km: 12.0}
    - h_msl_m: 500.0
      temperature_c: 15.0
      pressure_hpa: 955.0
      relative_humidity: 0.5
      time_utc: "2026-05-14T10:20:00Z"
refraction: {method: spherical, radius_m: 6371000.0, direction: remove}
output: {path: results, batch_rows: 100000}
""")

CSV_EVENTS = yaml.safe_load("""
csv:
  path: e.csv
  columns: {image: i, gps_week: w, gps_seconds: s, camera: c}
  camera: nadir
""")


def with_csv_events():
    ground = {"height": 120.0, "reference": "relative", "sigma_column": "sigma_h"}
    return FULL | {"events": CSV_EVENTS, "ground": ground}


WITHOUT_WINDOW = {key: value for key, value in FULL["cameras"]["nadir"].items() if key != "window"}
ORIENTED = {
    "mission": FULL["mission"],
    "observations": FULL["observations"],
    "ground": FULL["ground"],
    "output": FULL["output"],
    "cameras": {"nadir": WITHOUT_WINDOW, "window": WITHOUT_WINDOW},
    "stations": yaml.safe_load("""
use_suspect: true
orientation:
  format: csv
  path: block.csv
  angles: omega_phi_kappa
  unit: grad
  frame: unknown
  heights: ellipsoid
  columns:
    image: image
    camera: camera
    x: x
    y: y
    z: z
    omega: omega
    phi: phi
    kappa: kappa
    time_utc: time_utc
    sigma_horizontal_m: sigma_horizontal_m
    sigma_height_m: sigma_height_m
    sigma_tilt: sigma_tilt
    sigma_yaw: sigma_yaw
  camera: nadir
  known_positions: {path: known.csv, image: i, latitude: b, longitude: l, height: h}
  sigma_horizontal_m: 0.1
  sigma_height_m: 0.1
  sigma_tilt_deg: 0.01
  sigma_yaw_deg: 0.01
"""),
}
GEOGRAPHIC = yaml.safe_load("""
path: block.csv
angles: roll_pitch_yaw
frame: geographic
heights: msl
convergence_deg: 1.2
date: "2026-05-14"
camera: nadir
columns: {roll: r, pitch: p, yaw: y, latitude: b, longitude: l, height: h, camera: c}
""")
PROJECTED = yaml.safe_load("""
path: block.csv
angles: roll_pitch_yaw
frame: projected
crs: EPSG:25832
heights: msl
camera: nadir
date: "2026-05-14"
""")
TOPOCENTRIC = yaml.safe_load("""
path: block.csv
angles: quaternion
camera: nadir
frame: {enu: {lat_deg: 47.0, lon_deg: 11.0, h_ellipsoid_m: 600.0}}
columns: {q_w: a, q_x: b, q_y: c, q_z: d, gps_week: w, gps_seconds: s}
""")


def oriented(orientation):
    return ORIENTED | {"stations": {"orientation": orientation}}


TRAJECTORY = yaml.safe_load("""
path: t.csv
format: csv
replaces: [position, height, attitude]
point: antenna
lever_arm_m: [0.1, 0.2, -1.0]
heights: msl
time: {system: gpst, week: 2400}
accuracy: s.out
position_unit: deg
angle_unit: grad
angle_order: ZYX
""")
POSITIONS = yaml.safe_load("""
path: e.MRK
format: mrk
image: "{index:04d}.JPG"
times_only: true
delay_s: 0.1
point: camera
heights: ellipsoid
time: {system: gpst, week: 2400}
grid: EPSG:32632
""")
# Columns that exclude each other.
BY_ANGLES = yaml.safe_load("""
{time: t, latitude: LATITUDE, longitude: LONGITUDE, height: HEIGHT, roll: ROLL, pitch: PITCH,
 yaw: YAW, v_north_m_s: V_NORTH_M_S, v_east_m_s: V_EAST_M_S, v_down_m_s: V_DOWN_M_S,
 sigma_h_m: SIGMA_H_M, sigma_v_m: SIGMA_V_M}
""")
BY_QUATERNIONS = yaml.safe_load("""
{time: t, x: X, y: Y, z: Z, q_w: Q_W, q_x: Q_X, q_y: Q_Y, q_z: Q_Z, week: WEEK}
""")


def with_imports():
    """Trajectories and camera events of others."""
    positions = dict.fromkeys(FULL["cameras"], POSITIONS)
    for columns in (BY_ANGLES, BY_QUATERNIONS):
        trajectory = TRAJECTORY | {"columns": columns}
        yield FULL | {
            "events": {"positions": positions},
            "stations": {"trajectory": trajectory},
        }


def with_object_points():
    columns = {"point": "name", "x": "east", "y": "north", "height": "h"}
    points = {"points": "points.csv", "columns": columns, "crs": "EPSG:25832"}
    return FULL | {"ground": {"height": points, "reference": "msl"}}


CONTROL = yaml.safe_load("""
path: control.csv
columns: {point: name, latitude: lat, longitude: lon, height: h}
crs: EPSG:4258
reference: ellipsoid
""")
OPENING = yaml.safe_load("""
warmer_k: 10.0
pressure_excess_hpa: -3.0
sigma_warmer_k: 4.0
sigma_pressure_excess_hpa: 1.0
frame: camera
normal: [0.0, 0.0, 1.0]
""")


def with_opening():
    nadir = WITHOUT_WINDOW | {"opening": OPENING}
    return FULL | {"cameras": FULL["cameras"] | {"nadir": nadir}}


NAMES = set(FULL["cameras"])
SECTIONS_OF_NAMES = {"cameras", "mount", "events.log", "events.first_image"}


def keys_of(tree, above=""):
    """Every key of a dictionary, with those above it and dots between them."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            key = f"{above}{name}"
            yield key
            yield from keys_of(value, f"{key}.")


def last_of(key):
    return key.rpartition(".")[2]


def is_camera_name(key):
    section, _, name = key.rpartition(".")
    return section in SECTIONS_OF_NAMES and name in NAMES


def at(tree, key):
    for name in filter(None, key.split(".")):
        tree = tree[name]
    return tree


def copied(tree, key):
    """A copy of a tree, the section of a key in it, and the key's name there."""
    tree = copy.deepcopy(tree)
    section, _, name = key.rpartition(".")
    return tree, at(tree, section), name


def changed(tree, key, value):
    tree, section, name = copied(tree, key)
    section[name] = value
    return tree


def renamed(tree, key, new_name):
    tree, section, old_name = copied(tree, key)
    for name in list(section):  # the order of the keys stays
        value = section.pop(name)
        if name == old_name:
            name = new_name
        section[name] = value
    return tree


def without(tree, key):
    tree, section, name = copied(tree, key)
    del section[name]
    return tree


def line_of(text, key):
    """The line of a key, by YAML's own account."""
    node = yaml.compose(text, C_LOADER)
    for name in key.split("."):
        key_node, node = next(pair for pair in node.value if pair[0].value == name)
    return key_node.start_mark.line + 1


def models_in(annotation) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from models_in(argument)


def fields_of(model: type[BaseModel], seen: set[type[BaseModel]]):
    if model in seen:
        return
    seen.add(model)
    for name, field in model.model_fields.items():
        yield name
        for inner in models_in(field.annotation):
            yield from fields_of(inner, seen)


def test_the_examples_here_use_every_key_there_is(load):
    missions = [
        with_csv_events(),
        ORIENTED,
        oriented(GEOGRAPHIC),
        oriented(TOPOCENTRIC),
        *with_imports(),
        with_object_points(),
        oriented(PROJECTED),
        FULL | {"ground": {"height": {"dem": "terrain.tif"}, "reference": "msl"}},
        FULL | {"control": CONTROL},
        with_opening(),
        FULL | {"accept": [{"code": "PLAUSIBLE-GROUND", "reason": "a mine"}]},
    ]
    used = set()
    for tree in (FULL, *missions):
        used.update(map(last_of, keys_of(tree)))
    atmosphere = FULL["atmosphere"]
    for entry in (*atmosphere["soundings"], *atmosphere["surface"], *missions[-1]["accept"]):
        used.update(entry)
    assert set(fields_of(Mission, set())) <= used
    for tree in missions:
        load(tree)
    assert load(FULL).mission.title == FULL["mission"]["title"]


def typos(word, draw):
    """One letter too few, too many, wrong, and two swapped."""
    letters = string.ascii_lowercase + "_"
    i = draw.randrange(len(word))
    yield word[:i] + word[i + 1 :]
    yield word[:i] + draw.choice(letters) + word[i:]
    yield word[:i] + draw.choice(letters) + word[i + 1 :]
    if len(word) > 1:
        j = draw.randrange(len(word) - 1)
        yield word[:j] + word[j + 1] + word[j] + word[j + 2 :]


def test_a_misspelt_key_is_refused_with_its_line_and_the_right_one(refusal):
    draw = random.Random(20240607)
    tried = 0
    right = 0
    wrong = []
    for tree in (FULL, with_csv_events()):
        for key in keys_of(tree):
            was_tried = tree is not FULL and not key.startswith("events")
            if is_camera_name(key) or was_tried:
                continue
            section, dot, name = key.rpartition(".")
            for typo in draw.sample(list(typos(name, draw)), 2):
                if not typo or typo in set(fields_of(Mission, set())):
                    continue
                text = dumped(renamed(tree, key, typo))
                error = refusal(text)
                spoilt = f"{section}{dot}{typo}"
                line = line_of(text, spoilt)
                assert error.code == "CONFIG-UNKNOWN-KEY", (typo, error)
                assert f"line {line}: {spoilt}: unknown key" in error.what, (typo, error)
                tried += 1
                if f"{spoilt}: unknown key; perhaps {name!r}?" in error.what:
                    right += 1
                else:
                    wrong.append((typo, name))
    assert tried > 180
    assert right / tried >= 0.95, wrong


REQUIRED = """
mission
log
observations
cameras
mount
events
ground
output
mission.name
log.path
observations.path
cameras.nadir.width_px
cameras.nadir.height_px
cameras.nadir.cx_px
cameras.nadir.cy_px
cameras.nadir.calibration
cameras.nadir.window.cabin
ground.height
ground.reference
output.path
log.local_origin.lat_deg
log.local_origin.h_ellipsoid_m
log.channels.pressure.name
cameras.nadir.window.cabin.pressure_hpa
cameras.nadir.principal_distance.reference
cameras.nadir.principal_distance.reference.temperature_c
"""


@pytest.mark.parametrize("key", REQUIRED.split())
def test_a_required_key_that_is_missing_is_named(refusal, key):
    error = refusal(without(FULL, key))
    assert key in error.what
    assert "is missing" in error.what


def test_nothing_is_assumed_about_calibration_and_ground(refusal):
    for key, choices in (
        ("cameras.nadir.calibration", "laboratory | in_flight_uncorrected"),
        ("ground.reference", "msl | ellipsoid | relative"),
    ):
        assert choices in refusal(without(FULL, key)).what
    assert "column" in refusal(without(FULL, "ground.height")).what


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_no_number_may_be_infinite_or_nan(refusal, value):
    numbers = [key for key in keys_of(FULL) if type(at(FULL, key)) in (int, float)]
    assert len(numbers) > 35
    for key in numbers:
        assert key in refusal(changed(FULL, key, value)).what
    for key in ("cameras.nadir.window.normal", "mount.nadir.lever_arm_m"):
        assert key in refusal(changed(FULL, key, [value, 0.0, 1.0])).what


def test_a_value_of_the_wrong_type_is_refused_where_it_stands(refusal):
    for key in keys_of(FULL):
        right = at(FULL, key)
        wrongs = [{"surprise": 1}] if isinstance(right, list) else [["a", "b"]]
        if isinstance(right, (int, float)) and not isinstance(right, bool):
            wrongs += ["12"]
        if isinstance(right, (str, bool)) and key != "cameras.filed.camera":  # or a number
            wrongs += [7]
        if isinstance(right, bool):
            wrongs += ["yes"]
        for wrong in wrongs:
            error = refusal(changed(FULL, key, wrong))
            assert key.partition(".")[0] in error.what, (key, wrong, error)
            assert re.search(r"line \d+", error.what), (key, wrong, error)


OUT_OF_RANGE = yaml.safe_load(r"""
mission.name: [../up, Zürich Nord, "", a/b, "a\nb", {a: {b: 1}}, {a: [1]}, {}, {a: 1}]
mission.undulation_m: [500.0]
log.max_gap_s: [0.0, -1.0]
log.path: ["", "a\0b"]
output.path: ["a\0b"]
output.batch_rows: [10]
cameras.nadir.width_px: [0, 100.5, 18446744073709551616]
cameras.nadir.fx_px: [-1.0]
cameras.nadir.calibration: [lab]
cameras.nadir.window.normal: [[0.0, 0.0, 0.0], [0.0, 1.0, -0.1], [0.0, 1.0]]
cameras.nadir.window.cabin: [constant, null]
cameras.nadir.window.shape: [dome]
cameras.nadir.window.frame: [aircraft]
cameras.nadir.window.in_calibration: [true]
cameras.nadir.principal_distance.reference.pressure_hpa: [101325.0]
cameras.nadir.principal_distance.dc_dp_px_per_hpa: [20.0]
cameras.nadir.window.cabin.pressure_hpa: [80000.0]
events.log.nadir.image:
  - same.tif
  - "{number}.tif"
  - "{index.real}"
  - "{index!r}"
  - "{index:999999999d}"
  - "{index"
events.images.time_zone: [CEST, "+25:00"]
events.first_image.window.event: [0]
ground.height: [40000.0, from_distances, range, {distance: true}, [450.0], true]
ground.reference: [wgs84]
atmosphere.standard: [us1967]
atmosphere.index: [edlen]
refraction.method: [magic]
refraction.direction: [add]
refraction.radius_m: [6371.0]
mount.nadir.roll_deg: [1.0e+9]
mount.nadir.sigma_tilt_deg: [-0.1]
mount.nadir.sigma_yaw_deg: [200.0]
ground.sigma_m: [-1.0]
stations.max_sigma_height_m: [1.0e+308]
ground.sigma_column: [3.0]
""")
OUT_OF_RANGE["mission.name"].append("x" * 300)
OUT_OF_RANGE["stations.max_sigma_height_m"].append(int("9" * 400))


@pytest.mark.parametrize(
    ("key", "value"),
    [(key, value) for key, values in OUT_OF_RANGE.items() for value in values],
)
def test_a_value_out_of_range_is_refused(refusal, key, value):
    said = refusal(changed(FULL, key, value)).what
    assert key in said
    assert re.search(r"line \d+", said)


@pytest.mark.parametrize(
    ("events", "why"),
    [
        (CSV_EVENTS | {"images": {"path": "images"}}, "a csv gives each image its time"),
        (CSV_EVENTS | {"first_image": {"nadir": "n1"}}, "a csv gives each image its time"),
        (FULL["events"] | {"first_image": {"left": "n1"}}, "which has no pulses"),
        (FULL["events"] | {"first_image": {"nadir": "n1"}}, "leave first_image out"),
        (
            FULL["events"] | {"log": {"nadir": {}, "window": {"image": "w{n}.tif"}}},
            "the image of nadir must state which images belong to this camera",
        ),
    ],
)
def test_events_that_contradict_each_other(refusal, events, why):
    assert why in refusal(FULL | {"events": events}).what


def test_the_image_of_the_first_event_may_be_stated_by_its_name(load):
    events = FULL["events"] | {"first_image": {"window": "w7.tif"}}
    anchor = load(FULL | {"events": events}).events.stated_first_image("window")
    assert anchor.image == "w7.tif"
    assert anchor.event == 1


def test_sigmas_that_contradict_each_other(refusal):
    both = changed(FULL, "ground.sigma_column", "sigma_h")
    assert "sigma_m or sigma_column" in refusal(both).what
    assert "sigma_tilt_deg" in refusal(without(FULL, "mount.nadir.sigma_tilt_deg")).what


def test_one_principal_distance(refusal, load):
    fx = "cameras.nadir.fx_px"
    fy = "cameras.nadir.fy_px"
    f = "cameras.nadir.f_px"
    none = without(without(FULL, fx), fy)
    load(changed(none, f, 20000.0))
    for tree in (changed(FULL, f, 1.0), without(FULL, fx), none):
        assert "f_px" in refusal(tree).what


@pytest.mark.parametrize("section", ["mount", "events.log", "cameras"])
def test_cameras_must_agree(refusal, section):
    nadir = f"{section}.nadir"
    error = refusal(renamed(FULL, nadir, "nadri"))
    assert "nadri" in error.what
    assert "nadir" in error.what
    if section != "cameras":
        text = f"'nadir' has no entry under {section}"
        assert text in refusal(without(FULL, nadir)).what


def test_a_csv_of_events_names_its_camera(refusal):
    camera = "events.csv.camera"
    assert "oblique" in refusal(changed(with_csv_events(), camera, "oblique")).what
    silent = without(with_csv_events(), camera)
    column = "events.csv.columns.camera"
    assert "which camera" in refusal(without(silent, column)).what


def test_exposures_have_one_source_and_one_clock(refusal):
    for events in ({}, FULL["events"] | CSV_EVENTS):
        assert "either log, csv or positions" in refusal(FULL | {"events": events}).what
    columns = "events.csv.columns"
    for given in ({"time_utc": "t", "gps_week": "w", "gps_seconds": "s"}, {"gps_week": "w"}, {}):
        assert "time_utc" in refusal(changed(with_csv_events(), columns, given)).what


@pytest.mark.parametrize("key", [key for key in keys_of(FULL) if key.count(".") < 2])
def test_a_key_that_stands_there_twice_is_refused(refusal, key):
    text = dumped(FULL)
    lines = text.splitlines()
    line = line_of(text, key)
    name = last_of(key)
    indentation = re.match(" *", lines[line - 1]).group()
    lines.insert(line - 1, f"{indentation}{name}: twice")
    error = refusal("\n".join(lines))
    assert error.code == "CONFIG-YAML"
    assert repr(name) in error.what
    assert error.where.endswith(f":{line + 1}")


@pytest.mark.parametrize(
    "text",
    [
        "!!python/object/apply:os.system ['touch owned']",
        "mission: !!python/object/apply:os.system ['touch owned']",
        "mission: {name: !!python/name:os.system }",
        "a: &x [*x]\nb: *y",
        "? [a, b]\n: 1",
        "? {a: b}\n: 1",
        "{}: 3",
        "- 1\n- 2",
        "just words",
        "",
        "# nothing\n",
        "null",
        "mission: {name: a, <<: 7}",
        "--- {a: 1}\n--- {b: 2}\n",
    ],
)
def test_text_that_is_no_mission_file(refusal, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refusal(text).code in (
        "CONFIG-YAML",
        "CONFIG-EMPTY",
        "CONFIG-INVALID",
        "CONFIG-UNKNOWN-KEY",
    )
    assert not (tmp_path / "owned").exists()


def test_words_and_numbers_are_those_of_yaml_1_2(load, refusal):
    text = dumped(FULL)
    plain = text.replace("name: survey", "name: no").replace(
        "wavelength_m: 5.5e-07", "wavelength_m: 55e-8"
    )
    assert "55e-8" in plain
    mission = load(plain)
    assert mission.mission.name == "no"
    assert mission.atmosphere.wavelength_m == pytest.approx(0.55e-6)
    for word in ("on", "off", "yes", "y"):
        assert load(text.replace("name: survey", f"name: {word}")).mission.name == word
    assert load(text.replace("co2_ppm: 420.0", "co2_ppm: 0420")).atmosphere.co2_ppm == 420.0
    for odd in ("1:30", "1_000", "0x10", "yes", "2024-05-01", "1e400"):
        assert "co2_ppm" in refusal(text.replace("co2_ppm: 420.0", f"co2_ppm: {odd}")).what


def test_every_mistake_is_told_at_once_in_the_order_of_the_file(refusal):
    spoilt = renamed(changed(FULL, "ground.reference", "sea"), "log.path", "pth")
    spoilt = changed(spoilt, "cameras.nadir.width_px", "wide")
    text = refusal(spoilt).what
    assert "3 mistakes" in text
    lines = [int(n) for n in re.findall(r"line (\d+):", text)]
    assert lines == sorted(lines)
    assert len(lines) == 3


ORIENTATIONS = yaml.safe_load("""
- ['frame: null', orientation.frame]
- ['angles: null', orientation.angles]
- ['heights: null', 'heights is missing: what the heights count from']
- ['frame: ecef', frame must be geographic]
- ['{frame: ecef, angles: quaternion, convergence_deg: 0.0, columns: {}}', remove heights]
- - '{frame: unknown, angles: quaternion, heights: null, convergence_deg: 0, columns: {}}'
  - 'no vertical, no north and no scale'
- ['{frame: unknown, angles: quaternion, known_positions: log}', not columns.latitude]
- ['{angles: quaternion, frame: ecef}', 'convergence_deg is for frame: geographic']
- ['frame: projected', projected needs crs]
- ['date: 14.5.2026', not a date like]
- ['columns: {omega: o, x: e}', 'columns has omega, x, which']
- ['columns: {time_utc: t}', 'either date, or the columns of time']
- ['columns: {gps_week: t}', both gps_week and gps_seconds]
- ['camera: forward', "names camera 'forward'"]
- ['unit: gon', grad]
""")


@pytest.mark.parametrize(("changes", "words"), ORIENTATIONS)
def test_an_orientation_that_says_too_little_or_too_much(refusal, changes, words):
    orientation = GEOGRAPHIC | yaml.safe_load(changes)
    orientation_section = {key: value for key, value in orientation.items() if value is not None}
    refused = refusal(oriented(orientation_section))
    assert refused.code == "CONFIG-INVALID"
    assert words in refused.what


def test_without_a_log_nothing_comes_from_a_log(refusal, load):
    assert "stations.orientation" in refusal(without(FULL, "log")).what
    no_log = oriented(GEOGRAPHIC)
    load(no_log)
    assert "there is no log" in refusal(no_log | {"events": FULL["events"]}).what
    camera = WITHOUT_WINDOW | {"window": {"cabin": "log"}}
    cameras = {"nadir": camera, "window": WITHOUT_WINDOW}
    assert "there is no log" in refusal(no_log | {"cameras": cameras}).what
    unknown = ORIENTED["stations"]["orientation"] | {"known_positions": "log"}
    del unknown["heights"]
    assert "needs log and events" in refusal(oriented(unknown)).what
    air = {"board_temperature": True}
    assert "log.channels.temperature" in refusal(no_log | {"atmosphere": air}).what


def test_a_channel_of_null_is_stated_and_one_without_its_key_is_not(load):
    content = copy.deepcopy(FULL)
    content["log"]["channels"] = {"temperature": None, "pressure": "BARO[0]"}
    content["atmosphere"].pop("board_temperature", None)  # it needs a named thermometer
    channels = load(content).log.channels
    assert channels.unused_roles == ("temperature",)
    assert list(channels.named()) == ["pressure"]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("time_zone", "Europe/Zuerich", "not a time zone"),
        ("time_zone", "../etc/passwd", "not a time zone"),
        ("time_zone", "MEZ+1", "not a time zone"),
        ("title", "two\nlines", "a line of text"),
        ("client", "  ", "a line of text"),
        ("operator", "x" * 201, "200"),
        ("remarks", "", "remarks"),
    ],
)
def test_what_the_report_cannot_state_is_refused(refusal, key, value, words):
    error = refusal(FULL | {"mission": {"name": "survey", key: value}})
    assert words in str(error)
