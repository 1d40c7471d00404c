"""What a mission file says of windows and lenses, and what it may not say."""

import math
import pickle

import numpy as np
import pytest
import yaml

from unbend.config import Mission
from unbend.refraction.lens_air import TypicalLens
from unbend.stages.exposure_setup import is_aircraft_attitude_by_mount

SCHEDULE = "standard_schedule"
LENS = {
    "reference": {"pressure_hpa": 950.0, "temperature_c": 20.0},
    "dc_dp_px_per_hpa": 0.0084,
    "dc_dt_px_per_k": -0.004,
}


def config(window=None, **camera):
    """A mission whose camera has a window, and other keys."""
    content = yaml.safe_load("""
mission: {name: survey}
log: {path: a.bin}
observations: {path: o.csv}
cameras:
  nadir:
    width_px: 14000
    height_px: 10600
    fx_px: 20000.0
    fy_px: 19990.0
    cx_px: 7000.0
    cy_px: 5300.0
    calibration: laboratory
mount: {nadir: {}}
events: {log: {nadir: {image: "{index}"}}}
ground: {height: 200.0, reference: msl}
output: {path: out}
""")
    if window is not None:
        camera["window"] = window
    content["cameras"]["nadir"] |= camera
    return content


def test_a_plane_window_square_to_the_axis_is_meant(load):
    window = load(config({"cabin": "log"})).windows["nadir"]
    assert (window.shape, window.frame, window.normal) == ("plane", "camera", (0.0, 0.0, 1.0))
    assert window.in_calibration == "none"
    assert window.cabin.source == "log"


def test_constant_air_in_si(load):
    air = {"pressure_hpa": 812.5, "temperature_c": 20.0, "relative_humidity": 0.3}
    cabin = load(config({"cabin": air})).windows["nadir"].cabin
    assert (cabin.source, cabin.relative_humidity) == ("constant", 0.3)
    assert (cabin.pressure_pa, cabin.temperature_k) == pytest.approx((81_250.0, 293.15))


def test_a_normal_becomes_a_unit_vector(load):
    given = {"cabin": SCHEDULE, "normal": [0.0, 3.0, 4.0], "in_calibration": "glass"}
    window = load(config(given)).windows["nadir"]
    assert window.normal == pytest.approx((0.0, 0.6, 0.8))
    assert (window.cabin.source, window.in_calibration) == (SCHEDULE, "glass")


IMPOSSIBLE_WINDOWS = yaml.safe_load("""
- ['{}', 'window.cabin: the air behind the window is missing']
- ['cabin: null', 'window.cabin: the air behind the window is missing']
- - '{shape: plane, normal: [0.0, 0.1, 1.0]}'
  - 'window.cabin: the air behind the window is missing'
- ['{cabin: log, normal: [0.0, 0.0, 0.0]}', normal of a window has the length 0]
- ['{cabin: log, normal: [0.0, 0.0, 0.0], frame: body}', has the length 0]
- ['{cabin: log, normal: [0.0, .nan, 1.0]}', 'normal[1]: nan is not allowed']
- ['{cabin: log, normal: [0.0, 1.0]}', use a list of 3]
- ['{cabin: log, normal: [0.0, 1.0, 0.0]}', third component is positive]
- ['{cabin: log, normal: [0.0, 0.0, -1.0]}', third component is positive]
- ['{cabin: log, normal: [0.0, 0.0, -1.0], frame: body}', "'nadir' has a normal away"]
- ['{shape: spherical, normal: [0.0, 0.1, 1.0]}', has no normal]
- ['{shape: spherical, frame: body}', has no frame]
""")


@pytest.mark.parametrize(("window", "words"), IMPOSSIBLE_WINDOWS)
def test_windows_that_cannot_be(invalid, window, words):
    assert words in invalid(config(yaml.safe_load(window)))


def test_a_window_of_the_aircraft_and_how_the_camera_sits_behind_it(load, invalid):
    content = config({"cabin": SCHEDULE, "frame": "body", "normal": [1.0, 0.0, 0.0]})
    # A camera that looks down does not see through a window in the nose ...
    assert "has a normal away from the viewing direction" in invalid(content)
    # ... one that looks ahead does, and which is moved by a stabilised mount only the log knows.
    content["mount"]["nadir"] = {"pitch_deg": 45.0}
    mission = load(content)
    normal = mission.mounts["nadir"].camera_from_body @ np.array(mission.windows["nadir"].normal)
    assert normal == pytest.approx([0.0, -math.sqrt(0.5), math.sqrt(0.5)], abs=1e-12)
    content["mount"]["nadir"] = {}
    content["log"]["channels"] = {"attitude": "ATT[1]", "aircraft_attitude": "ATT[0]"}
    named = load(content).log.channels.named()
    assert named["aircraft_attitude"].name == "ATT[0]"


OF_THE_CAMERA = {"angles": "omega_phi_kappa"}
OF_THE_AIRCRAFT = {"angles": "roll_pitch_yaw"}
OF_A_GIMBAL = {"format": "dji", "angles": "roll_pitch_yaw"}


@pytest.mark.parametrize(
    ("orientation", "channels", "by_mount"),
    [
        (None, {}, False),
        (OF_THE_CAMERA, {}, True),
        (OF_THE_CAMERA, {"aircraft_attitude": "ATT"}, False),
        (OF_THE_AIRCRAFT, {}, False),
        (OF_A_GIMBAL, {}, True),
    ],
    ids=["log", "camera", "camera, and the log's aircraft", "aircraft", "gimbal"],
)
def test_where_the_attitude_of_the_aircraft_is_that_of_camera_and_mount(
    load, orientation, channels, by_mount
):
    content = config()
    content["log"]["channels"] = channels
    if orientation is not None:
        common = {"path": "o.csv", "frame": "geographic", "heights": "msl"}
        content["stations"] = {"orientation": common | orientation}
    assert is_aircraft_attitude_by_mount(load(content), "nadir") is by_mount


@pytest.mark.parametrize(
    ("source", "by_mount"),
    [
        ({"path": "eo.txt"}, True),
        ({"path": "eo.txt", "times_only": True}, False),
        ({"path": "events.pos"}, False),
    ],
    ids=["EO text", "only its times", "positions alone"],
)
def test_only_an_eo_text_states_attitudes_of_cameras(load, source, by_mount):
    content = config()
    content["events"] = {"positions": {"nadir": source | {"image": "{index}"}}}
    assert is_aircraft_attitude_by_mount(load(content), "nadir") is by_mount


def test_a_dome_needs_cabin_air_only_for_the_lens(load, invalid):
    bare = load(config({"shape": "spherical"})).cameras["nadir"]
    assert bare.window.window.cabin is None
    with_lens = config({"shape": "spherical"}, principal_distance=LENS)
    assert "give window.cabin" in invalid(with_lens)


@pytest.mark.parametrize(
    ("window", "with_lens", "is_needed"),
    [
        (None, False, False),
        (None, True, False),
        ({"cabin": "log"}, False, True),
        ({"cabin": SCHEDULE}, True, False),
        ({"cabin": "log", "shape": "spherical"}, False, False),
        ({"cabin": "log", "shape": "spherical"}, True, True),
    ],
)
def test_which_windows_need_the_cabin_of_the_log(load, window, with_lens, is_needed):
    lens = {"principal_distance": LENS} if with_lens else {}
    camera = load(config(window, **lens)).cameras["nadir"]
    assert camera.needs_cabin_from_log is is_needed


def test_the_lens_in_si(load):
    lens = load(config(principal_distance=LENS)).cameras["nadir"].lens
    assert lens.principal_distance_px == 19_990.0
    assert lens.reference_pressure_pa == pytest.approx(95_000.0)
    assert lens.reference_temperature_k == pytest.approx(293.15)
    assert lens.px_per_pa == pytest.approx(8.4e-5)
    assert lens.px_per_k == pytest.approx(-0.004)
    assert load(config()).cameras["nadir"].lens is None


@pytest.mark.parametrize(
    ("key", "word"),
    [
        ("reference", "principal_distance.reference: is missing"),
        ("dc_dp_px_per_hpa", "give both dc_dp_px_per_hpa and dc_dt_px_per_k, or none"),
        ("dc_dt_px_per_k", "give both dc_dp_px_per_hpa and dc_dt_px_per_k, or none"),
    ],
)
def test_a_lens_is_described_whole(invalid, key, word):
    lens = {name: value for name, value in LENS.items() if name != key}
    assert word in invalid(config(principal_distance=lens))


def test_the_air_of_the_calibration_alone_is_a_typical_lens(load):
    lens = load(config(principal_distance={"reference": LENS["reference"]})).lenses["nadir"]
    assert lens == TypicalLens(19_990.0, 95_000.0, 293.15)


def test_an_opening_in_si(load):
    given = {"warmer_k": 12.0, "pressure_excess_hpa": -4.0, "frame": "body", "normal": [0, 0, 2]}
    window = load(config(opening=given)).windows["nadir"]
    air = window.cabin
    assert window.section == "opening"
    assert window.frame == "body"
    assert window.normal == (0.0, 0.0, 1.0)
    assert air.source == "opening"
    assert air.warmer_k == 12.0
    assert air.excess_pa == -400.0
    assert air.sigma_temperature_k == 6.0
    assert air.sigma_pressure_pa == 200.0
    sigmas = {"sigma_warmer_k": 1.5, "sigma_pressure_excess_hpa": 0.5}
    air = load(config(opening=given | sigmas)).windows["nadir"].cabin
    assert air.sigma_temperature_k == 1.5
    assert air.sigma_pressure_pa == 50.0
    camera = load(config(opening=given, principal_distance=LENS)).cameras["nadir"]
    assert not camera.needs_cabin_from_log


IMPOSSIBLE_OPENINGS = yaml.safe_load("""
- ['opening: {}', 'opening.warmer_k: is missing']
- ['opening: {warmer_k: 70.0}', opening.warmer_k]
- ['opening: {warmer_k: 5.0, normal: [0.0, 0.0, -1.0]}', third component]
- - 'opening: {warmer_k: 5.0, frame: body, normal: [1.0, 0.0, 0.0]}'
  - "the opening of camera 'nadir' has a normal away"
- - '{opening: {warmer_k: 5.0}, window: {cabin: log}}'
  - 'window and opening: the camera looks through only one of them'
""")


@pytest.mark.parametrize(("keys", "words"), IMPOSSIBLE_OPENINGS)
def test_openings_that_cannot_be(invalid, keys, words):
    assert words in invalid(config(**yaml.safe_load(keys)))


def test_a_light_for_each_camera(load, invalid):
    assert load(config()).wavelengths_m == {}
    assert load(config(wavelength_m=8.5e-7)).wavelengths_m == {"nadir": 8.5e-7}
    assert "wavelength_m" in invalid(config(wavelength_m=850.0))


def test_windows_lenses_mounts_and_cameras_are_built_once(load):
    mission = load(config({"cabin": SCHEDULE}, principal_distance=LENS))
    camera = mission.cameras["nadir"]
    assert mission.windows["nadir"] is camera.window.window
    assert mission.lenses["nadir"] is camera.lens
    assert mission.mounts["nadir"] is mission.mount["nadir"].mount
    assert mission.interior_orientations["nadir"] is camera.interior_orientation
    assert mission.windows is mission.windows


def test_what_is_built_is_no_key_and_stays_with_the_mission(load):
    mission = load(config({"cabin": SCHEDULE}, principal_distance=LENS))
    assert mission.lenses.keys() == {"nadir"}
    assert mission.model_dump(warnings="error").keys() == Mission.model_fields.keys()
    again = pickle.loads(pickle.dumps(mission))
    assert again == mission
    assert again.lenses == mission.lenses


def test_a_copy_with_other_keys_builds_anew(load):
    mission = load(config({"cabin": SCHEDULE}))
    bare = load(config()).cameras
    assert mission.windows.keys() == {"nadir"}
    assert mission.model_copy(update={"cameras": bare}).windows == {}
