"""Each rule of plausibility on both sides of its limit, and the numbers of its finding.

What a rule looks at is made by hand; the limits are those that the sentences of the rules state.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unbend.refraction import BrownConrady, Camera
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.stages.plausibility import rules

TAKEOFF = SimpleNamespace(h_msl_m=400.0, lat_rad=0.8, lon_rad=0.2, stands=True)
CAMERA = Camera(4000, 3000, 3500.0, 3500.0, 2000.0, 1500.0)
GROUND = SimpleNamespace(column=None, sigma_m=None)


def facts(**values: Any) -> SimpleNamespace:
    """What rules look at: a camera of 60 deg that looks down, and what a test states."""
    usual = {
        "mission": SimpleNamespace(ground=GROUND),
        "takeoff": TAKEOFF,
        "cameras": {"nadir": CAMERA},
        "view_deg": lambda name: 60.0,
        "axis_deg": lambda name: 0.0,
        "key_of": lambda name, of_numbers, of_metric: f"cameras.{name}.{of_numbers}",
    }
    return SimpleNamespace(**(usual | values))


def mission(**sections: Any) -> dict[str, SimpleNamespace]:
    return {"mission": SimpleNamespace(**({"ground": GROUND} | sections))}


def found(rule: Any, made: SimpleNamespace, name: str) -> Any:
    """What the finding of a rule names, or its place; None where there is no finding."""
    values = [{"where": finding.where, **finding.values}[name] for finding in rule(made)]
    assert len(values) < 2
    return values[0] if values else None


def ground(km_north: float, height_m: float) -> SimpleNamespace:
    lat_rad = np.array([0.8 + km_north / 6371.0])
    stations = SimpleNamespace(ok=np.array([True]), lat_rad=lat_rad, lon_rad=np.array([0.2]))
    return facts(stations=stations, rows=SimpleNamespace(h_g_m=np.array([height_m, np.nan])))


@pytest.mark.parametrize(
    ("km", "height_m", "off_m"),
    [
        (0.0, 699.0, None),
        (0.0, 701.0, 301.0),
        (0.0, 101.0, None),
        (0.0, 99.0, -301.0),
        (10.0, 899.0, None),  # 20 m more for each kilometre
        (10.0, 901.0, 501.0),
        (29.0, 1400.0, 1000.0),
        (31.0, 9000.0, None),
    ],
)
def test_the_ground_lies_near_the_takeoff(km, height_m, off_m):
    made = ground(km, height_m)
    assert found(rules.ground_beside_takeoff, made, "off_m") == pytest.approx(off_m)


def test_the_ground_far_below_the_takeoff_in_numbers():
    (finding,) = rules.ground_beside_takeoff(ground(10.0, -101.0))
    assert finding.where == "ground.height"
    assert finding.values["height_m"] == -101.0
    assert finding.values["allowed_m"] == pytest.approx(500.0, abs=0.1)
    assert finding.values["reference"] == "the take-off, 10 km away"


@pytest.mark.parametrize(
    ("above_m", "nadir_rad", "off_m"),
    [
        ([49.0] * 5, 0.1, None),
        ([51.0] * 5, 0.1, 51.0),
        ([-51.0] * 5, 0.1, -51.0),
        ([51.0] * 5, 0.49, 51.0),
        ([51.0] * 5, 0.51, None),  # these rays land elsewhere
        # percentiles 16 and 84 of the scatter: 68 m apart; 34 m are allowed more
        ([33.0, 58.0, 83.0, 108.0, 133.0], 0.1, None),
        ([35.0, 60.0, 85.0, 110.0, 135.0], 0.1, 85.0),
    ],
)
def test_the_ground_lies_near_the_logged_terrain(above_m, nadir_rad, off_m):
    terrain_m = np.array([450.0, 620.0, 450.0, 620.0, 9e3, 450.0])
    rows = SimpleNamespace(
        station=np.array([0, 1, 0, 1, -1, 0]), h_g_m=terrain_m + np.insert(above_m, 4, 0.0)
    )
    made = facts(logged_terrain_m=terrain_m[:2], rows=rows, nadir_angle_rad=np.full(6, nadir_rad))
    assert found(rules.ground_beside_terrain, made, "off_m") == pytest.approx(off_m)
    height_m = None if off_m is None else pytest.approx(450.0 + off_m)
    assert found(rules.ground_beside_terrain, made, "height_m") == height_m


@pytest.mark.parametrize(
    ("model_m", "stands", "off_m"),
    [(449.0, True, None), (451.0, True, 51.0), (349.0, True, -51.0), (900.0, False, None)],
)
def test_the_elevation_model_lies_near_the_takeoff(model_m, stands, off_m):
    takeoff = SimpleNamespace(**(vars(TAKEOFF) | {"stands": stands}))
    made = facts(takeoff=takeoff, model_at_takeoff_m=model_m)
    assert found(rules.model_beside_takeoff, made, "off_m") == off_m


@pytest.mark.parametrize(
    ("off_m", "ground_m", "takeoff_m", "reading"),
    [
        (1045.0, 1500.0, 455.0, "feet"),  # 1500 ft are 457 m
        (-449.5, 0.45, 450.0, "km"),
        (-400.0, 35.0, 400.0, "heights above the take-off (ground.reference: relative)"),
        (400.0, 850.0, 400.0, "heights above sea level, not relative ones (ground.reference)"),
        (400.0, 3000.0, 190.0, "a wrong height, datum or unit in ground.height"),
        (400.0, 3000.0, 210.0, "heights above sea level, not relative ones (ground.reference)"),
        (-400.0, 0.0, 400.0, "a wrong height, datum or unit in ground.height"),
    ],
)
def test_the_reading_that_explains_a_difference_best_is_likely(off_m, ground_m, takeoff_m, reading):
    assert rules.likely_reading(off_m, ground_m, takeoff_m) == reading


@pytest.mark.parametrize(
    ("view_deg", "told_deg"), [(2.9, 2.9), (3.0, None), (130.0, None), (130.1, 130.1)]
)
def test_a_field_of_view_is_that_of_a_camera(view_deg, told_deg):
    made = facts(view_deg=lambda name: view_deg)
    assert found(rules.field_of_view, made, "view") == told_deg


def test_a_wide_field_of_view_in_numbers():
    (finding,) = rules.field_of_view(facts(view_deg=lambda name: 131.0))
    assert finding.where == "cameras.nadir.fx_px"
    assert finding.values == {
        "name": "nadir",
        "view": 131.0,
        "least": 3.0,
        "most": 130.0,
        "width_px": 4000,
        "height_px": 3000,
        "fx_px": 3500.0,
    }


@pytest.mark.parametrize(
    ("fx_px", "told_px"), [(3569.0, None), (3571.0, 3571.0), (3431.0, None), (3429.0, 3429.0)]
)
def test_pixels_are_square_within_two_percent(fx_px, told_px):
    made = facts(cameras={"nadir": replace(CAMERA, fx_px=fx_px)})
    assert found(rules.field_of_view, made, "fx_px") == told_px
    assert found(rules.field_of_view, made, "fy_px") == (told_px and 3500.0)


@pytest.mark.parametrize(
    ("cx_px", "cy_px", "percent"),
    [
        (2399.0, 1500.0, None),
        (2404.0, 1500.0, 10.1),
        (1596.0, 1500.0, 10.1),
        (2000.0, 1799.0, None),
        (2000.0, 1806.0, 10.2),
        (2000.0, 1194.0, 10.2),
    ],
)
def test_the_principal_point_lies_near_the_centre(cx_px, cy_px, percent):
    made = facts(cameras={"nadir": replace(CAMERA, cx_px=cx_px, cy_px=cy_px)})
    assert found(rules.principal_point, made, "percent") == pytest.approx(percent)
    assert found(rules.principal_point, made, "where") == (percent and "cameras.nadir.cx_px")


def test_the_distortion_at_the_corners_is_a_share_of_the_radius():
    """k1 r^2 at the corner: (2000^2 + 1500^2) / 3500^2 = 0.5102."""
    camera = replace(CAMERA, distortion=BrownConrady(k1=-0.1))
    assert rules.distortion_at_corners(camera) == pytest.approx(0.05102, rel=1e-4)


@pytest.mark.parametrize(
    ("k1", "view_deg", "is_wrong"),
    [
        (0.58, 60.0, False),  # 0.296 of the radius
        (0.60, 60.0, True),  # 0.306
        (0.60, 89.9, True),
        (0.60, 90.1, False),
        (1.9, 91.0, False),
        (2.0, 91.0, True),
        (2.0, 131.0, False),  # of no use to say: the field of view is wrong
        (1.8e-6, 60.0, True),
        (2.1e-6, 60.0, False),
        (0.0, 60.0, False),
    ],
)
def test_distortions_have_the_size_of_a_lens(k1, view_deg, is_wrong):
    camera = replace(CAMERA, distortion=BrownConrady(k1=k1))
    made = facts(cameras={"nadir": camera}, view_deg=lambda name: view_deg)
    assert (found(rules.distortion, made, "share") is not None) == is_wrong


@pytest.mark.parametrize(
    ("p1", "p2", "k3", "most"),
    [
        (9e-4, 0.0, 0.0, None),
        (1.1e-3, 0.0, 0.0, 1.1e-3),
        (0.0, -1.2e-3, 0.0, 1.2e-3),
        (1.2e-3, 0.0, 3.9e-4, 1.2e-3),
        (1.2e-3, 0.0, 4.1e-4, None),  # not over three times of k3
    ],
)
def test_tangential_terms_are_small(p1, p2, k3, most):
    camera = replace(CAMERA, distortion=BrownConrady(k1=-0.05, k3=k3, p1=p1, p2=p2))
    assert found(rules.distortion, facts(cameras={"nadir": camera}), "most") == most


def extent(pixels: list[tuple[float, float]], name: str) -> Any:
    x_px, y_px = np.array(pixels).T
    rows = SimpleNamespace(x_px=x_px, y_px=y_px)
    made = facts(rows=rows, camera=np.full(len(pixels), "nadir"))
    return found(rules.extent_of_observations, made, name)


@pytest.mark.parametrize("beside", [(4001.0, 10.0), (-1.0, 10.0), (10.0, 3001.0), (10.0, -1.0)])
@pytest.mark.parametrize(
    ("number", "outside", "share"), [(200, 2, None), (200, 3, 1.5), (100, 1, None), (100, 2, 2.0)]
)
def test_hardly_any_observation_lies_outside_its_image(number, outside, share, beside):
    pixels = [(3900.0, 10.0)] * (number - outside) + [beside] * outside
    assert extent(pixels, "outside") == share


@pytest.mark.parametrize(
    ("number", "pixel", "is_small"),
    [
        (100, (2790.0, 2090.0), True),  # less than 0.7 of both sides
        (100, (2810.0, 2090.0), False),
        (100, (2790.0, 2110.0), False),
        (99, (2790.0, 2090.0), False),
    ],
)
def test_many_observations_fill_their_image(number, pixel, is_small):
    mistake = extent([pixel] * number, "mistake")
    assert mistake == ("measured in reduced images" if is_small else None)


@pytest.mark.parametrize(
    ("x_px", "y_px", "says"),
    [
        ([-801.0, 900.0], [-601.0, 700.0], "centre"),
        ([-799.0, 900.0], [-601.0, 700.0], "exchanged"),
        ([0.0, 3000.0], [0.0, 4000.0], "exchanged"),
        ([0.0, 3001.0], [0.0, 4000.0], "another size"),
        ([0.0, 3000.0], [0.0, 4001.0], "another size"),
    ],
)
def test_what_pixels_outside_likely_are(x_px, y_px, says):
    assert says in rules.likely_extent(np.array(x_px), np.array(y_px), 4000, 3000)


@pytest.mark.parametrize(
    ("name", "axis_deg", "view_deg", "says"),
    [
        ("wing", 79.0, 60.0, None),
        ("wing", 81.0, 60.0, "not -90"),
        ("wing", 87.0, 8.0, "not -90"),
        ("wing", 85.0, 8.0, None),
        ("Nadir", 29.0, 60.0, None),
        ("Nadir", 31.0, 60.0, "within 30 deg"),
        ("wing", 31.0, 60.0, None),
        ("oblique_left", 9.0, 60.0, "more than 10 deg"),
        ("oblique_left", 11.0, 60.0, None),
    ],
)
def test_cameras_look_where_their_names_say(name, axis_deg, view_deg, says):
    made = facts(
        cameras={name: CAMERA},
        axis_deg=lambda name: axis_deg,
        view_deg=lambda name: view_deg,
        **mission(attitude_key=lambda name: f"mount.{name}"),
    )
    expected = found(rules.direction_of_cameras, made, "expected")
    assert (expected is None) if says is None else (says in expected)
    assert found(rules.direction_of_cameras, made, "axis") == (says and axis_deg)
    assert found(rules.direction_of_cameras, made, "where") == (says and f"mount.{name}")


@pytest.mark.parametrize(
    ("roll", "deg"),
    [
        (0.7854, 45.0),  # 45 degrees in radians, rounded
        (-1.5708, -90.0),
        (0.786, None),
        (6.28318, 360.0),
        (6.5449, None),  # 375 degrees: more than a turn
        (0.0, None),
        (0.0003, None),  # a boresight angle: as small in radians
        (45.0, None),
    ],
)
def test_angles_of_mounts_are_in_degrees(roll, deg):
    mount = SimpleNamespace(roll_deg=roll, pitch_deg=0.0, yaw_deg=0.0)
    made = facts(**mission(mount={"nadir": mount}))
    assert found(rules.angles_of_mounts, made, "deg") == pytest.approx(deg, abs=0.01)
    assert found(rules.angles_of_mounts, made, "where") == (deg and "mount.nadir.roll_deg")


@pytest.mark.parametrize(
    ("lever_arm_m", "down", "name", "told_m"),
    [
        ([6.0, 7.9, 0.5], 1.0, "length", None),  # 9.93 m
        ([6.0, 8.1, 0.5], 1.0, "length", 10.0925715),
        ([0.0, 0.0, -0.24], 1.0, "up", None),
        ([0.0, 0.0, -0.26], 1.0, "up", 0.26),  # above the antenna
        ([0.0, 0.0, -0.26], 0.49, "up", None),
        ([0.0, 0.0, -0.26], 0.51, "up", 0.26),
    ],
)
def test_lever_arms_are_those_of_an_aircraft(lever_arm_m, down, name, told_m):
    mount = SimpleNamespace(lever_arm_m=lever_arm_m)
    axes = SimpleNamespace(camera_from_body=np.diag([1.0, 1.0, down]))
    made = facts(**mission(mount={"nadir": mount}, mounts={"nadir": axes}))
    assert found(rules.lever_arms, made, name) == pytest.approx(told_m)
    assert found(rules.lever_arms, made, "where") == (told_m and "mount.nadir.lever_arm_m")


@pytest.mark.parametrize(
    ("sigma_m", "delay_s", "where"),
    [
        (50.0, 1.0, None),
        (50.1, -1.0, "ground.sigma_m"),
        (None, 1.01, "events.log.nadir.delay_s"),
        (None, -1.01, "events.log.nadir.delay_s"),
    ],
)
def test_sigmas_and_delays_have_the_size_of_their_unit(sigma_m, delay_s, where):
    events = SimpleNamespace(log={"nadir": SimpleNamespace(delay_s=delay_s)})
    made = facts(**mission(ground=SimpleNamespace(sigma_m=sigma_m), events=events))
    assert found(rules.sigmas_and_delays, made, "where") == where


@pytest.mark.parametrize(("tilt_deg", "told_deg"), [(34.9, None), (35.1, 35.1)])
def test_a_window_is_square_to_its_camera(tilt_deg, told_deg):
    tilt = math.radians(tilt_deg)
    window = SimpleNamespace(
        frame="camera", normal=(math.sin(tilt), 0.0, math.cos(tilt)), section="window"
    )
    in_body = SimpleNamespace(frame="body", normal=(1.0, 0.0, 0.0), section="window")
    made = facts(**mission(log=None, windows={"nadir": window, "wing": in_body}))
    assert found(rules.windows, made, "tilt") == pytest.approx(told_deg)
    assert found(rules.windows, made, "where") == (told_deg and "cameras.nadir.window.frame")


@pytest.mark.parametrize(
    ("ratio", "nadir_rad", "told"),
    [
        (0.71, 0.5, None),
        (0.69, 0.5, 0.69),
        (1.39, 0.5, None),
        (1.41, 0.5, 1.41),
        (0.3048, 1.39, 0.3048),
        (0.3048, 1.41, None),
    ],
)
def test_slant_ranges_fit_the_heights(ratio, nadir_rad, told):
    distance_m = ratio * 1500.0 / math.cos(nadir_rad)
    made = facts(
        camera_height_m=np.array([2000.0]),
        nadir_angle_rad=np.array([nadir_rad]),
        rows=SimpleNamespace(h_g_m=np.array([500.0]), distance_m=np.array([distance_m])),
    )
    assert found(rules.slant_ranges, made, "ratio") == pytest.approx(told)


@pytest.mark.parametrize(("weight", "percent"), [(0.99, None), (1.01, 20.16)])
def test_a_fifth_of_the_observations_may_be_flagged_for_one_cause(weight, percent):
    """A row of the sample counts for as many observations as it stands for."""
    columns = SimpleNamespace(x_px="x_px", y_px="y_px")
    stations = SimpleNamespace(ok=np.array([True]), status=np.array(["ok"]))
    flagged = np.array([STATUS_NAMES.index("no_ground"), STATUS_NAMES.index("ok")])
    made = facts(
        **mission(observations=SimpleNamespace(columns=columns)),
        stations=stations,
        rows=SimpleNamespace(status=flagged, weight=np.array([weight, 4.0])),
    )
    assert found(rules.flagged_rows, made, "percent") == pytest.approx(percent, abs=0.01)
    assert found(rules.flagged_rows, made, "most") == (percent and 20.0)


@pytest.mark.parametrize(
    ("direction", "orientation", "where"),
    [
        ("apply", None, "refraction.direction"),
        ("remove", None, None),
        ("apply", object(), None),
    ],
)
def test_refraction_is_not_applied_to_measured_observations(direction, orientation, where):
    refraction = SimpleNamespace(direction=direction)
    stations = SimpleNamespace(orientation=orientation)
    made = facts(**mission(refraction=refraction, stations=stations))
    assert found(rules.measured_observations, made, "where") == where
