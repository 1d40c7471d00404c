"""Each rule of plausibility on both sides of its limit, and the numbers of its finding.

What a rule looks at is made by hand; the limits are those that the sentences of the rules state.
"""

import math
from collections import defaultdict
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.stages.level_cameras import US1976, stations
from unbend.messages import Kind
from unbend.refraction import BrownConrady, Camera
from unbend.refraction.lens_air import TypicalLens
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.refraction.window import Cabin, Window
from unbend.stages.plausibility import height_rules, rules
from unbend.stages.plausibility.lens_references import lens_references

approx = pytest.approx

CAMERA = Camera(4000, 3000, 3500.0, 3500.0, 2000.0, 1500.0)
GROUND = SimpleNamespace(column=None, sigma_m=None)


def mission_of(**sections):
    return SimpleNamespace(**{"ground": GROUND} | sections)


def takeoff(stands=True):
    return SimpleNamespace(
        h_msl_m=400.0,
        lat_rad=0.8,
        lon_rad=0.2,
        stands=stands,
    )


def facts(**values):
    """What rules look at: a camera of 60 deg that looks down, and the values of a test."""
    usual = {
        "mission": mission_of(),
        "takeoff": takeoff(),
        "cameras": {"nadir": CAMERA},
        "view_deg": lambda name: 60.0,
        "axis_deg": lambda name: 0.0,
        "key_of": lambda name, pixel_key, metric_key: f"cameras.{name}.{pixel_key}",
    }
    return SimpleNamespace(**usual | values)


def facts_of_camera(view_deg=60.0, **changed):
    camera = replace(CAMERA, **changed)
    return facts(cameras={"nadir": camera}, view_deg=lambda name: view_deg)


def arrays(**lists):
    """Stations or rows of observations with these values."""
    return SimpleNamespace(**{name: np.array(values) for name, values in lists.items()})


def finding_of(rule, made, where=None):
    """The values of the only finding of a rule, which names this key of the mission file.

    Where there is no finding each value is None.
    """
    findings = list(rule(made))
    if not findings:
        return defaultdict(lambda: None)
    (finding,) = findings
    if where is not None:
        assert finding.where == where
    return finding.values


# ---- heights of the ground


def ground(km_north, height_m):
    stations = arrays(
        ok=[True],
        lat_rad=[0.8 + km_north / 6371.0],
        lon_rad=[0.2],
    )
    return facts(stations=stations, rows=arrays(h_g_m=[height_m, np.nan]))


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
    finding = finding_of(height_rules.ground_against_takeoff, ground(km, height_m))
    assert finding["off_m"] == approx(off_m)


def test_the_ground_far_below_the_takeoff_in_numbers():
    far_below = ground(10.0, -101.0)
    finding = finding_of(height_rules.ground_against_takeoff, far_below, "ground.height")
    assert finding["height_m"] == -101.0
    assert finding["allowed_m"] == approx(500.0, abs=0.1)
    assert finding["reference"] == "the take-off, 10 km away"


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
    rows = arrays(
        station=[0, 1, 0, 1, -1, 0],
        h_g_m=terrain_m + np.insert(above_m, 4, 0.0),
    )
    made = facts(
        logged_terrain_m=terrain_m[:2],
        rows=rows,
        nadir_angle_rad=np.full(6, nadir_rad),
    )

    finding = finding_of(height_rules.ground_against_terrain, made)

    assert finding["off_m"] == approx(off_m)
    if off_m is not None:
        assert finding["height_m"] == approx(450.0 + off_m)


@pytest.mark.parametrize(
    ("model_m", "stands", "off_m"),
    [
        (449.0, True, None),
        (451.0, True, 51.0),
        (349.0, True, -51.0),
        (900.0, False, None),
    ],
)
def test_the_elevation_model_lies_near_the_takeoff(model_m, stands, off_m):
    made = facts(takeoff=takeoff(stands), model_at_takeoff_m=model_m)
    finding = finding_of(height_rules.model_against_takeoff, made)
    assert finding["off_m"] == off_m


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
    assert height_rules.likely_reading(off_m, ground_m, takeoff_m) == reading


@pytest.mark.parametrize(
    ("ratio", "nadir_rad", "expected"),
    [
        (0.71, 0.5, None),
        (0.69, 0.5, 0.69),
        (1.39, 0.5, None),
        (1.41, 0.5, 1.41),
        (0.3048, 1.39, 0.3048),
        (0.3048, 1.41, None),
    ],
)
def test_slant_ranges_fit_the_heights(ratio, nadir_rad, expected):
    distance_m = ratio * 1500.0 / math.cos(nadir_rad)
    rows = arrays(h_g_m=[500.0], distance_m=[distance_m])
    made = facts(
        camera_height_m=np.array([2000.0]),
        nadir_angle_rad=np.array([nadir_rad]),
        rows=rows,
    )
    finding = finding_of(rules.slant_ranges, made)
    assert finding["ratio"] == approx(expected)


# ---- cameras


@pytest.mark.parametrize(
    ("view_deg", "expected_deg"),
    [
        (2.9, 2.9),
        (3.0, None),
        (130.0, None),
        (130.1, 130.1),
    ],
)
def test_a_field_of_view_is_that_of_a_camera(view_deg, expected_deg):
    finding = finding_of(rules.field_of_view, facts_of_camera(view_deg))
    assert finding["view"] == expected_deg


def test_a_wide_field_of_view_in_numbers():
    finding = finding_of(rules.field_of_view, facts_of_camera(131.0), "cameras.nadir.fx_px")
    assert finding == {
        "name": "nadir",
        "view": 131.0,
        "least": 3.0,
        "most": 130.0,
        "width_px": 4000,
        "height_px": 3000,
        "fx_px": 3500.0,
    }


@pytest.mark.parametrize(
    ("fx_px", "is_square"),
    [
        (3569.0, True),
        (3571.0, False),
        (3431.0, True),
        (3429.0, False),
    ],
)
def test_pixels_are_square_within_two_percent(fx_px, is_square):
    finding = finding_of(rules.field_of_view, facts_of_camera(fx_px=fx_px))
    if is_square:
        assert not finding
    else:
        assert finding["fx_px"] == fx_px
        assert finding["fy_px"] == 3500.0


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
    made = facts_of_camera(cx_px=cx_px, cy_px=cy_px)
    finding = finding_of(rules.principal_point, made, "cameras.nadir.cx_px")
    assert finding["percent"] == approx(percent)


def test_the_distortion_at_the_corners_is_a_share_of_the_radius():
    """k1 r^2 at the corner: (2000^2 + 1500^2) / 3500^2 = 0.5102."""
    camera = replace(CAMERA, distortion=BrownConrady(k1=-0.1))
    assert rules.distortion_at_corners(camera) == approx(0.05102, rel=1e-4)


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
    made = facts_of_camera(view_deg, distortion=BrownConrady(k1=k1))
    finding = finding_of(rules.distortion, made)
    assert (finding["share"] is not None) == is_wrong


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
    terms = BrownConrady(k1=-0.05, k3=k3, p1=p1, p2=p2)
    finding = finding_of(rules.distortion, facts_of_camera(distortion=terms))
    assert finding["most"] == most


# ---- observations in images


def extent(pixels):
    x_px, y_px = zip(*pixels, strict=True)
    rows = arrays(x_px=x_px, y_px=y_px)
    made = facts(rows=rows, camera=np.full(len(pixels), "nadir"))
    return finding_of(rules.extent_of_observations, made)


@pytest.mark.parametrize(
    "beside",
    [
        (4001.0, 10.0),
        (-1.0, 10.0),
        (10.0, 3001.0),
        (10.0, -1.0),
    ],
)
@pytest.mark.parametrize(
    ("inside", "outside", "percent"),
    [
        (198, 2, None),
        (197, 3, 1.5),
        (99, 1, None),
        (98, 2, 2.0),
    ],
)
def test_hardly_any_observation_lies_outside_its_image(inside, outside, percent, beside):
    pixels = [(3900.0, 10.0)] * inside + [beside] * outside
    assert extent(pixels)["outside"] == percent


REDUCED = "measured in reduced images"


@pytest.mark.parametrize(
    ("number", "pixel", "mistake"),
    [
        (100, (2790.0, 2090.0), REDUCED),  # less than 0.7 of both sides
        (100, (2810.0, 2090.0), None),
        (100, (2790.0, 2110.0), None),
        (99, (2790.0, 2090.0), None),
    ],
)
def test_many_observations_fill_their_image(number, pixel, mistake):
    assert extent([pixel] * number)["mistake"] == mistake


@pytest.mark.parametrize(
    ("x_px", "y_px", "words"),
    [
        ([-801.0, 900.0], [-601.0, 700.0], "centre"),
        ([-799.0, 900.0], [-601.0, 700.0], "exchanged"),
        ([0.0, 3000.0], [0.0, 4000.0], "exchanged"),
        ([0.0, 3001.0], [0.0, 4000.0], "another size"),
        ([0.0, 3000.0], [0.0, 4001.0], "another size"),
    ],
)
def test_what_pixels_outside_likely_are(x_px, y_px, words):
    likely = rules.likely_cause_of_pixels_outside(np.array(x_px), np.array(y_px), 4000, 3000)
    assert words in likely


@pytest.mark.parametrize(("weight", "percent"), [(0.99, None), (1.01, 20.16)])
def test_a_fifth_of_the_observations_may_be_flagged_for_one_cause(weight, percent):
    """A row of the sample counts for as many observations as it represents."""
    columns = SimpleNamespace(x_px="x_px", y_px="y_px")
    observations = SimpleNamespace(columns=columns)
    no_ground = STATUS_NAMES.index("no_ground")
    rows = arrays(
        status=[no_ground, STATUS_NAMES.index("ok")],
        weight=[weight, 4.0],
    )
    made = facts(
        mission=mission_of(observations=observations),
        stations=arrays(ok=[True], status=["ok"]),
        rows=rows,
    )

    finding = finding_of(rules.flagged_rows, made)

    assert finding["percent"] == approx(percent, abs=0.01)
    if percent is not None:
        assert finding["most"] == 20.0


# ---- directions, mounts, sigmas, windows


@pytest.mark.parametrize(
    ("name", "axis_deg", "view_deg", "words"),
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
def test_cameras_look_where_their_names_say(name, axis_deg, view_deg, words):
    made = facts(
        cameras={name: CAMERA},
        axis_deg=lambda name: axis_deg,
        view_deg=lambda name: view_deg,
        mission=mission_of(attitude_key=lambda name: "mount." + name),
    )
    finding = finding_of(rules.direction_of_cameras, made, "mount." + name)
    if words is None:
        assert not finding
    else:
        assert words in finding["expected"]
        assert finding["axis"] == axis_deg


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
    made = facts(mission=mission_of(mount={"nadir": mount}))
    finding = finding_of(rules.angles_of_mounts, made, "mount.nadir.roll_deg")
    assert finding["deg"] == approx(deg, abs=0.01)


def lever_arm(arm_m, down=1.0):
    """The finding about the lever arm of a camera by which the body's down is so far down."""
    mount = SimpleNamespace(lever_arm_m=arm_m)
    axes = SimpleNamespace(camera_from_body=np.diag([1.0, 1.0, down]))
    mission = mission_of(mount={"nadir": mount}, mounts={"nadir": axes})
    return finding_of(rules.lever_arms, facts(mission=mission), "mount.nadir.lever_arm_m")


@pytest.mark.parametrize(
    ("right_m", "length_m"),
    [
        (7.9, None),  # 9.93 m
        (8.1, 10.0925715),
    ],
)
def test_lever_arms_are_those_of_an_aircraft(right_m, length_m):
    finding = lever_arm([6.0, right_m, 0.5])
    assert finding["length"] == approx(length_m)


@pytest.mark.parametrize(
    ("up_m", "down", "expected_m"),
    [
        (0.24, 1.0, None),
        (0.26, 1.0, 0.26),  # above the antenna
        (0.26, 0.49, None),
        (0.26, 0.51, 0.26),
    ],
)
def test_cameras_that_look_down_are_below_the_antenna(up_m, down, expected_m):
    finding = lever_arm([0.0, 0.0, -up_m], down)
    assert finding["up"] == approx(expected_m)


@pytest.mark.parametrize(
    ("sigma_m", "delay_s", "keys"),
    [
        (50.0, 1.0, []),
        (50.1, -1.0, ["ground.sigma_m"]),
        (None, 1.01, ["events.log.nadir.delay_s"]),
        (None, -1.01, ["events.log.nadir.delay_s"]),
    ],
)
def test_sigmas_and_delays_have_the_size_of_their_unit(sigma_m, delay_s, keys):
    source = SimpleNamespace(delay_s=delay_s)
    mission = mission_of(
        ground=SimpleNamespace(sigma_m=sigma_m),
        events=SimpleNamespace(log={"nadir": source}),
    )
    assert keys_of(rules.sigmas_and_delays, mission) == keys


def keys_of(rule, mission):
    """The keys that the findings of a rule name."""
    return [finding.where for finding in rule(facts(mission=mission))]


@pytest.mark.parametrize(("tilt_deg", "expected_deg"), [(34.9, None), (35.1, 35.1)])
def test_a_window_is_square_to_its_camera(tilt_deg, expected_deg):
    tilt = math.radians(tilt_deg)
    in_camera = SimpleNamespace(
        frame="camera",
        normal=(math.sin(tilt), 0.0, math.cos(tilt)),
        section="window",
    )
    in_body = SimpleNamespace(
        frame="body",
        normal=(1.0, 0.0, 0.0),
        section="window",
    )
    windows = {"nadir": in_camera, "wing": in_body}
    made = facts(mission=mission_of(log=None, windows=windows))
    finding = finding_of(rules.windows, made, "cameras.nadir.window.frame")
    assert finding["tilt"] == approx(expected_deg)


@pytest.mark.parametrize(
    ("direction", "orientation", "keys"),
    [
        ("apply", None, ["refraction.direction"]),
        ("remove", None, []),
        ("apply", object(), []),
    ],
)
def test_refraction_is_not_applied_to_measured_observations(direction, orientation, keys):
    mission = mission_of(
        refraction=SimpleNamespace(direction=direction),
        stations=SimpleNamespace(orientation=orientation),
    )
    assert keys_of(rules.measured_observations, mission) == keys


# ---- the air in the lens during the calibration

FLOWN_M = 3000.0  # 701 hPa
FLOWN_PA = float(US1976.pressure(FLOWN_M))
LABORATORY_PA = 101_325.0


def about_reference(
    reference_pa=LABORATORY_PA,
    calibration="in_flight_uncorrected",
    *,
    flown_m=FLOWN_M,
    ground_m=0.0,
    in_lens_pa=LABORATORY_PA,
    windows=None,
    width_px=8000,
):
    """What is said of the reference of a camera that flew in the air outside, or in a cabin."""
    frame = SimpleNamespace(width_px=width_px, height_px=0.75 * width_px)
    camera = SimpleNamespace(calibration=calibration, interior_orientation=frame)
    mission = mission_of(
        cameras={"nadir": camera},
        lenses={"nadir": TypicalLens(3500.0, reference_pa, 293.15)},
        windows=windows or {},
    )
    flown = stations(
        flown_m,
        cabin_pressure_pa=in_lens_pa,
        cabin_temperature_k=293.15,
        cabin_vapour_pressure_pa=0.0,
    )
    made = facts(
        mission=mission,
        stations=flown,
        adjustment=SimpleNamespace(profile=US1976),
        rows=arrays(h_g_m=[ground_m, np.nan]),
    )
    return list(lens_references(made))


@pytest.mark.parametrize(
    ("calibration", "kinds"),
    [
        ("laboratory", []),
        ("in_flight_uncorrected", [Kind.FINDING]),
        ("in_flight_corrected", [Kind.WARNING]),
    ],
)
def test_a_calibration_in_flight_has_the_air_of_its_flight(calibration, kinds):
    """The ppm of the page on lenses, over half a diagonal of 5000 px."""
    messages = about_reference(calibration=calibration)
    assert [message.kind for message in messages] == kinds
    for message in messages:
        assert message.code == "PLAUSIBLE-REFERENCE"
        assert message.where == "cameras.nadir.principal_distance.reference"
        assert message.values["in_lens_hpa"] == approx(701.2, abs=0.1)
        assert message.values["ppm"] == approx(134.0, abs=1.0)
        assert message.values["corner_px"] == approx(134e-6 * 5000.0, rel=0.01)
        assert "removed twice" in message.what
        assert "1013 hPa and 20 C" in message.what


@pytest.mark.parametrize(
    ("reference_pa", "flown_m", "ground_m", "is_said"),
    [
        (95_000.0, FLOWN_M, 0.0, True),  # a laboratory 540 m up
        (92_000.0, FLOWN_M, 0.0, False),  # a calibration flight at 800 m
        (FLOWN_PA, FLOWN_M, 0.0, False),
        (80_000.0, FLOWN_M, 0.0, False),
        (60_000.0, FLOWN_M, 0.0, False),  # it flew higher
        (79_500.0, 5000.0, 2000.0, True),  # the air of the ground below the flight
        (79_500.0, 5000.0, 0.0, False),
        (79_500.0, 5000.0, math.nan, False),
        (LABORATORY_PA, 5000.0, math.nan, True),
        (LABORATORY_PA, 400.0, 0.0, False),  # as little as weather makes
        (LABORATORY_PA, 500.0, 0.0, True),
    ],
)
def test_a_reference_is_air_of_the_ground(reference_pa, flown_m, ground_m, is_said):
    messages = about_reference(reference_pa, flown_m=flown_m, ground_m=ground_m)
    assert bool(messages) is is_said


def test_a_reference_does_not_matter_in_a_cabin_of_its_air_or_in_a_small_image():
    cabin = Window(Cabin("log"))
    assert about_reference(windows={"nadir": cabin}) == []
    opening = Window(Cabin("opening", warmer_k=10.0, excess_pa=0.0), shape="spherical")
    assert about_reference(windows={"nadir": opening}, in_lens_pa=FLOWN_PA) != []
    assert about_reference(flown_m=500.0, width_px=4000) == []  # 17 ppm of 2500 px
