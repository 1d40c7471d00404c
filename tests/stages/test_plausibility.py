"""Each rule finds its mistake in a mission that is sound otherwise, and nothing else does."""

import math
import re
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from tests.helpers import channel, with_code
from tests.stages.mistaken import changed, evaluated
from tests.stages.other_logs import read_folder, with_channels
from unbend.atmosphere.estimate.candidates import SourceUse
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.batch.rehearsal import camera_text
from unbend.errors import Code
from unbend.library import corrected_table
from unbend.messages import Kind, Ledger, message
from unbend.refraction import BrownConrady, Camera, Exposures
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.effect import Effect
from unbend.stages.multi_image.messages import ties_contradict
from unbend.stages.plausibility.air_limits import air_of_flight
from unbend.stages.plausibility.causes import cause_of_outside, statuses_explained
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.findings import (
    findings_causing_statuses,
    hold_back_extents,
    hold_back_ties,
    settle_findings,
)
from unbend.stages.plausibility.height_rules import (
    heights_of_weather_stations,
    median_distance_km,
)
from unbend.stages.plausibility.messages import many_flagged
from unbend.stages.plausibility.rules import (
    are_sides_exchanged,
    distortion,
    field_of_view,
)
from unbend.stages.story import prepare_mission

# What is changed -> the code, the key it must name, and words of the finding.
MISTAKES = r"""
feet:
    observations: h_g_m = h_g_m * 3.28084
    code: PLAUSIBLE-GROUND
    key: ground.height
    words: likely feet
f in mm:
    mission:
        cameras.nadir.fx_px: 3000.0
        cameras.nadir.fy_px: 3000.0
        cameras.nadir.distortion: {}
    code: PLAUSIBLE-VIEW
    key: cameras.nadir.fx_px
    words: is 142 deg .* likely f in millimetres
report of another camera:
    mission:
        cameras.nadir:
            width_px: 14000
            height_px: 10600
            calibration: laboratory
            metric:
                focal_mm: 13.8
                pixel_um: [4.6, 4.6]
                format_mm: [64.4, 48.76]
                origin: image_centre
                axes: right up
                ppa_mm: [0.0, 0.0]
    code: PLAUSIBLE-VIEW
    key: cameras.nadir.metric.focal_mm
    words: is 142 deg .* metric.pixel
params of another image:
    mission:
        cameras.nadir:
            width_px: 14000
            height_px: 10600
            calibration: laboratory
            model: SIMPLE_PINHOLE
            params: [20000.0, 4200.0, 5300.0]
    code: PLAUSIBLE-PRINCIPAL-POINT
    key: cameras.nadir, params or file
    words: is 20 % of the image
width and height:
    mission: {cameras.nadir.width_px: 10600, cameras.nadir.height_px: 14000}
    code: PLAUSIBLE-PRINCIPAL-POINT
    key: cameras.nadir.width_px
    words: width_px and height_px seem exchanged
fy of another:
    mission: {cameras.nadir.fy_px: 26000.0}
    code: PLAUSIBLE-VIEW
    key: cameras.nadir.fx_px
    words: fx of camera nadir is 20000 px and fy 26000 px
k1 of pixels:
    mission: {cameras.nadir.distortion: {k1: -4.5e-11}}
    code: PLAUSIBLE-DISTORTION
    key: cameras.nadir.distortion
    words: coefficients for pixels
order of k:
    mission:
        cameras.nadir.distortion: {k1: -0.018, k2: 0.009, k3: 0.00015, p1: -0.0001, p2: -0.002}
    code: PLAUSIBLE-DISTORTION
    key: cameras.nadir.distortion.k3
    words: in another order
x and y:
    observations: first = x_px; x_px = y_px; y_px = first; drop first
    code: PLAUSIBLE-EXTENT
    key: observations.columns.x_px
    words: width and height, or x and y, exchanged
gimbal:
    mission: {mount.nadir.pitch_deg: -90.0}
    code: PLAUSIBLE-DIRECTION
    key: mount.nadir
    words: '9\d.* deg from the nadir|8\d.* deg from the nadir'
radians:
    mission: {mount.oblique.roll_deg: -0.7853982}
    code: PLAUSIBLE-ANGLE
    key: mount.oblique.roll_deg
    words: which is -45 deg in radians
lever arm in cm:
    mission: {mount.oblique.lever_arm_m: [20.0, 28.0, 45.0]}
    code: PLAUSIBLE-LEVER-ARM
    key: mount.oblique.lever_arm_m
    words: is 57 m long
lever arm upward:
    mission: {mount.oblique.lever_arm_m: [0.2, 0.28, -0.55]}
    code: PLAUSIBLE-LEVER-ARM
    key: mount.oblique.lever_arm_m
    words: 0.55 m above the point with the known position
sigma in mm:
    mission: {ground.sigma_m: 150.0}
    code: PLAUSIBLE-SIGMA
    key: ground.sigma_m
    words: 150 m
delay of a clock:
    mission: {events.log.nadir.delay_s: 3.0}
    code: PLAUSIBLE-DELAY
    key: delay_s
    words: delay_s of nadir is 3 s
no window:
    mission: {cameras.nadir.window: null, cameras.oblique.window: null}
    code: PLAUSIBLE-WINDOW
    key: cameras.nadir.window
    words: no camera has a window
normal in body:
    mission: {cameras.oblique.window: {cabin: log, normal: [0.0, 0.7071, 0.7071]}}
    code: PLAUSIBLE-WINDOW
    key: cameras.oblique.window.frame
    words: is tilted by 45 deg
no heights:
    observations: h_g_m = h_g_m * 0.0 / 0.0
    code: PLAUSIBLE-FLAGGED
    key: ground.height
    words: 100 % of the observations are no_ground
ground above:
    mission: {ground.height: 4000.0}
    code: PLAUSIBLE-FLAGGED
    key: ground.height
    words: 'the ground is up to 1\d{3} m above the camera'
apply:
    mission: {refraction: {direction: apply}}
    code: PLAUSIBLE-APPLY
    key: refraction.direction
    words: expected remove
"""
FOUND = yaml.safe_load(MISTAKES)


def observe(mission, recipe):
    """The observations of a mission, changed by assignments."""
    mission.observe_rows(evaluated(mission.measured_rows(), recipe))


def findings_of(manifest, code):
    """The entries of findings in the ledger."""
    return [e for e in manifest["ledger"] if e["kind"] == "finding" and e["code"] == code]


@pytest.mark.parametrize("name", FOUND)
def test_a_mistake_is_found_with_its_key(mission, name):
    mistake = FOUND[name]
    observe(mission, mistake.get("observations", ""))
    mission.config = changed(mission.config, mistake.get("mission", {}))

    manifest = mission.checked().manifest.values

    assert manifest["exit_code"] == 3
    findings = findings_of(manifest, mistake["code"])
    texts = [f"{finding['what']} {finding['where']}" for finding in findings]
    with_key = [text for text in texts if mistake["key"] in text]
    assert re.search(mistake["words"], "\n".join(with_key)), manifest["ledger"]


@pytest.mark.parametrize(("factor", "findings"), [(1.0, 0), (3.28084, 1)])
def test_slant_ranges_in_feet(mission, factor, findings):
    """Straight lines from 2500 m above the field to the points, 3.28 times as long."""
    facts = mission.checked().corrected.facts
    length = (facts.camera_height_m - facts.rows.h_g_m) / np.cos(facts.nadir_angle_rad)
    table = mission.measurements()
    mission.observe(table.append_column("slant", [length * factor]))
    mission.config["observations"]["columns"] = {"distance_m": "slant"}

    manifest = mission.checked().manifest.values

    texts = [finding["what"] for finding in findings_of(manifest, "PLAUSIBLE-DISTANCE")]
    assert len(texts) == findings
    assert all("3.28 times" in text for text in texts)


@pytest.mark.parametrize(
    ("factor", "status", "difference", "codes_of_ties"),
    [
        (1.0, 2, None, set()),
        (0.8, 2, r"-1?\d\d m from the terrain", {"TIES-HELD-BACK"}),
        (1.25, 2, r"\+1\d\d m from the terrain", {"TIES-HELD-BACK"}),
        (1.25, 1, None, {"TIES-HEIGHT"}),
    ],
)
def test_ground_beside_the_terrain_of_the_autopilot(
    mission, factor, status, difference, codes_of_ties
):
    """Heights 100 m off pass as near the take-off, but not beside the logged terrain.

    Tie points find the same where heights are spoiled; it is held back where the cause is named.
    """
    table = mission.measured_rows()
    ground_m = table.groupby("image")["h_g_m"].median()
    observe(mission, f"h_g_m = h_g_m * {factor}")
    read = read_folder(mission)
    stations = read.stations
    nadir = stations.rows(np.flatnonzero(stations.camera == "nadir"))
    terrain = channel(
        "TERR",
        nadir.time_ns / 1e9,
        h_terrain_m=ground_m[nadir.image],
        terrain_status=status,
    )
    terrain = replace(terrain, time_ns=nadir.time_ns)
    prepared = prepare_mission(read.mission, with_channels(read.inputs, terrain), Ledger())

    corrected_table(prepared)

    of_terrain = with_code(prepared.ledger, "PLAUSIBLE-TERRAIN")
    assert len(of_terrain) == (difference is not None)
    for finding in of_terrain:
        assert re.search(difference, finding.what)
        assert "ground.reference" in finding.where
    codes = set()
    for entry in prepared.ledger:
        if entry.kind is Kind.FINDING or entry.code == "TIES-HELD-BACK":
            codes.add(entry.code)
    assert codes - {"PLAUSIBLE-TERRAIN"} == codes_of_ties


# ---- the air


def test_air_of_another_pressure(mission):
    """R in air of half the pressure is half of the standard's: no ascent has that."""
    facts = mission.checked().corrected.facts
    profile = facts.adjustment.profile
    thin = profile.at_level(0.0, 0.5 * profile.pressure(0.0))
    adjustment = replace(facts.adjustment, profile=thin)
    (finding,) = air_of_flight(replace(facts, adjustment=adjustment))
    assert re.search(r"is 0\.50 ± 0\.0\d times that in the standard", finding.what)
    assert "log.channels.pressure" in finding.where
    assert "log.channels.temperature" in finding.where


SOUNDING = {"sounding 11035": 3.0}


def air_of(factor, sigma, sources=SOUNDING, *, climb_m=1000.0, usual=1.0):
    """The findings about an air: R over the standard's, its sigma, the sources and their fit."""
    uses = []
    for name, freedom in sources.items():
        quantity = "pressure" if name.startswith("BARO") else "temperature"
        fit = None if freedom is None else Fit(name, quantity, 9, 1.0, 1.0, freedom)
        uses.append(SourceUse(name, fit=fit))
    effect = Effect(45.0, 200.0 + climb_m, 200.0, factor, 1.0, sigma)
    facts = SimpleNamespace(
        effects=(effect,),
        usual_factor=usual,
        adjustment=SimpleNamespace(sources=uses),
    )
    return list(air_of_flight(facts))


@pytest.mark.parametrize(
    ("factor", "sigma", "climb_m", "findings"),
    [
        (1.9, 0.02, 1000.0, 0),  # ascents reach 1.75
        (2.4, 0.02, 1000.0, 1),
        (2.4, 0.06, 1000.0, 0),  # less than two sigma beyond the limit
        (2.4, math.nan, 1000.0, 1),
        (1.7, 0.02, 2000.0, 0),
        (1.9, 0.02, 2000.0, 1),
        (1.7, 0.02, 8000.0, 1),
        (0.6, 0.01, 1000.0, 0),
        (0.5, 0.01, 1000.0, 1),
        (0.5, 0.03, 1000.0, 0),
        (0.75, 0.01, 8000.0, 1),
        (-3.0, 0.01, 400.0, 0),  # the lowest layer decides
        (9.0, 0.01, 499.0, 0),
        (9.0, 0.01, 501.0, 1),
    ],
)
def test_air_is_what_ascents_have(factor, sigma, climb_m, findings):
    assert len(air_of(factor, sigma, climb_m=climb_m)) == findings


@pytest.mark.parametrize(
    ("factor", "usual", "findings"),
    [
        (4.0, 1.9, 0),
        (4.5, 1.9, 1),
        (0.5, 1.9, 1),
        (0.45, 0.8, 0),
    ],
)
def test_limits_reach_to_the_usual_air_of_place_and_season(factor, usual, findings):
    """Over the snow of Siberia R is twice the standard's: no finding, but a tenth of it is one."""
    assert len(air_of(factor, 0.02, usual=usual)) == findings


@pytest.mark.parametrize(
    ("sources", "where", "named"),
    [
        ({"sounding 11035": 2.0, "us1976": None}, "atmosphere.soundings", "sounding 11035"),
        ({"surface report METAR LOWW": 1.0}, "atmosphere.surface", "surface report METAR LOWW"),
        ({"weather model era5.nc": 9.0}, "atmosphere.model", "weather model era5.nc"),
        (
            {"BARO[0]": 1.0, "IMET[0]": 5.0, "sounding 11035": None},
            "log.channels.temperature, log.channels.pressure",
            "IMET[0], BARO[0]",
        ),
    ],
)
def test_air_that_is_none_is_blamed_on_what_is_there(sources, where, named):
    (finding,) = air_of(3.0, 0.02, sources)
    assert finding.where == where
    assert finding.what.endswith("unit of " + named)


# ---- weather stations


@pytest.mark.parametrize(
    ("station_m", "ground_m", "takeoff_m", "warned"),
    [
        (1417.0, 432.0, None, True),
        (1417.0, 900.0, 432.0, True),
        (1417.0, 640.0, None, False),
        (1417.0, 432.0, 1200.0, False),
        (700.0, 432.0, None, False),
        (1417.0, math.nan, None, False),
    ],
    ids=["ground", "take-off", "neither", "on a hill", "near", "unknown"],
)
def test_a_station_height_that_fits_in_feet_only(station_m, ground_m, takeoff_m, warned):
    """The station in Zurich is at 1,417 ft, 432 m."""
    station = SimpleNamespace(h_msl_m=station_m)
    facts = facts_of(
        mission=SimpleNamespace(atmosphere=SimpleNamespace(surface=[station])),
        rows=SimpleNamespace(h_g_m=np.array([ground_m, ground_m + 1.0, ground_m - 1.0])),
        takeoff=None if takeoff_m is None else SimpleNamespace(h_msl_m=takeoff_m),
    )

    warnings = list(heights_of_weather_stations(facts))

    assert len(warnings) == warned
    for warning in warnings:
        assert warning.kind is Kind.WARNING
        assert warning.code == "SURFACE-FEET"
        assert "1417 ft are 432 m" in warning.what
        assert warning.where == "atmosphere.surface[0].h_msl_m"


# ---- cameras


def facts_of(**values):
    """What the rules look at, as far as a test needs it."""
    names = [field.name for field in fields(Facts)]
    return Facts(**dict.fromkeys(names) | values)


PLAIN_SECTION = SimpleNamespace(model=None, metric=None)
FISHEYE = Camera(3000, 3000, 950.0, 950.0, 1500.0, 1500.0, OpenCVFisheye())
PLAIN = Camera(1000, 1000, 900.0, 900.0, 500.0, 500.0)


@pytest.mark.parametrize(
    ("camera", "codes"),
    [
        (replace(FISHEYE, distortion=OpenCVFisheye(-0.01)), []),
        (replace(FISHEYE, fx_px=9e3, fy_px=9e3), ["PLAUSIBLE-VIEW"]),
        (replace(PLAIN, fx_px=230.0, fy_px=230.0), ["PLAUSIBLE-VIEW"]),
        (replace(PLAIN, distortion=GeneralFrame(limit=0.9)), []),
        (replace(PLAIN, distortion=GeneralFrame(k1=1e-8)), ["PLAUSIBLE-DISTORTION"]),
    ],
    ids=["fisheye", "narrow fisheye", "wide frame", "general frame", "of pixels"],
)
def test_a_camera_is_judged_by_its_type(camera, codes):
    mission = SimpleNamespace(cameras={"nadir": PLAIN_SECTION})
    facts = facts_of(mission=mission, cameras={"nadir": camera})
    findings = [*field_of_view(facts), *distortion(facts)]
    assert [finding.code for finding in findings] == codes


@pytest.mark.parametrize(
    ("distortion", "view_deg"),
    [
        (BrownConrady(), 109.471),
        (OpenCVFisheye(), 162.057),
    ],
)
def test_the_field_of_view_is_that_of_the_diagonal(distortion, view_deg):
    """Two focal lengths wide and two high: half the diagonal is 1.41421."""
    camera = Camera(4000, 3000, 2000.0, 1500.0, 2000.0, 1500.0, distortion)
    facts = facts_of(cameras={"nadir": camera})
    assert facts.view_deg("nadir") == pytest.approx(view_deg, abs=1e-3)


def test_the_direction_of_a_camera_is_the_median_of_its_good_stations():
    tilt = np.radians([10.0, 20.0, 80.0, 60.0])
    rotation = np.zeros((4, 3, 3))
    rotation[:, 2, 2] = -np.cos(tilt)
    stations = SimpleNamespace(
        camera=np.array(["nadir", "nadir", "nadir", "wing"]),
        ok=np.array([True, True, False, True]),
    )
    facts = facts_of(stations=stations, exposures=SimpleNamespace(rotation=rotation))
    assert facts.axis_deg("nadir") == pytest.approx(15.0)
    assert math.isnan(facts.axis_deg("tail"))


def test_what_a_fisheye_sees_follows_its_angles():
    """3000 px of 1/950 rad are 180.9 deg; the ground to 85 deg: 2 * 1000 m * 11.43."""
    facts = SimpleNamespace(
        mission=SimpleNamespace(cameras={}),
        cameras={"nadir": FISHEYE},
        of_camera=lambda name, values: values,
        camera_height_m=np.array([1000.0]),
        rows=SimpleNamespace(h_g_m=np.array([0.0])),
        axis_deg=lambda name: 0.0,
    )
    assert camera_text(facts, "nadir").startswith("nadir 181 x 181 deg, 1.1 m a pixel, 22860 x")


# ---- rows without a correction


def test_rays_beyond_the_horizon_are_told_by_how_much(mission):
    """A camera that looks 120 deg from the nadir sees nothing but sky."""
    mission.config["mount"]["nadir"]["pitch_deg"] = -120.0

    corrected = mission.checked().corrected

    flagged = with_code(corrected.prepared.ledger, "OBS-FLAGGED")
    (above,) = [message for message in flagged if "misses_ground" in message.what]
    (degrees,) = re.findall(r"up to ([\d.]+) deg above the horizon", above.what)
    facts = corrected.facts
    angle = np.degrees(np.nanmax(facts.nadir_angle_rad[facts.camera == "nadir"]))
    # Geometry by hand: the horizon of a sphere of 6371 km from the height above the ground.
    height = np.nanmax(facts.camera_height_m - facts.rows.h_g_m)
    dip = np.degrees(np.sqrt(2.0 * height / 6.371e6))
    assert float(degrees) == pytest.approx(angle - 90.0 + dip, abs=0.2)


def outside_facts(camera, x_px, *, direction="remove", normal=(0.0, 0.0, 1.0)):
    """What `cause_of_outside` looks at: a point in the middle row, behind a window."""
    exposures = Exposures(
        np.ones(1, bool),
        np.diag([1.0, -1.0, -1.0])[None],
        np.zeros(1),
        np.array([3000.0]),
        np.array([2e-4]),
        np.array([2.5e-4]),
        np.array([normal]),
    )
    mission = SimpleNamespace(
        cameras={"nadir": PLAIN_SECTION},
        windows={"nadir": SimpleNamespace(section="window")},
        refraction=SimpleNamespace(direction=direction),
    )
    pixel = SimpleNamespace(
        x_px=np.array([x_px]),
        y_px=np.array([500.0]),
        station=np.zeros(1, np.int64),
    )
    stations = SimpleNamespace(camera=np.array(["nadir"]))
    return facts_of(
        mission=mission,
        stations=stations,
        exposures=exposures,
        cameras={"nadir": camera},
        rows=pixel,
    )


CURVED = Camera(1000, 1000, 300.0, 300.0, 500.0, 500.0, BrownConrady(k1=-0.2))


@pytest.mark.parametrize(
    ("camera", "x_px", "changed", "cause"),
    [
        (PLAIN, -5.0, {}, "outside 1000 x 1000 px (cameras.nadir.width_px; observations.columns)"),
        (
            CURVED,
            990.0,
            {},
            "beyond the radius at which the distortion of nadir can be inverted "
            "(cameras.nadir.distortion)",
        ),
        (
            PLAIN,
            990.0,
            {"normal": (-0.9, 0.0, np.sqrt(0.19))},
            "their rays do not pass the window of nadir (cameras.nadir.window.normal)",
        ),
        (
            PLAIN,
            999.99,
            {"direction": "apply"},
            "refraction moves them out of the image of nadir (refraction.direction)",
        ),
    ],
)
def test_the_cause_of_a_pixel_outside_the_camera(camera, x_px, changed, cause):
    facts = outside_facts(camera, x_px, **changed)
    assert cause_of_outside(facts, np.ones(1, bool)) == cause


def ledger_of(kinds):
    """A ledger with messages of these codes; ``where`` is the code in small letters."""
    ledger = Ledger()
    for name, kind in kinds.items():
        code = Code(name, means="...", effect="...", remedy="...")
        ledger.add(message(kind, code, "said of " + name, where=name.lower()))
    return ledger


TIES = ("TIES-MOUNT", "TIES-HEIGHT", "TIES-RESIDUALS")


@pytest.mark.parametrize(
    ("cause", "held_back"),
    [
        ("PLAUSIBLE-VIEW", set(TIES)),
        ("PLAUSIBLE-ANGLE", set(TIES)),
        ("PLAUSIBLE-GROUND", {"TIES-HEIGHT"}),
        ("PLAUSIBLE-TERRAIN", {"TIES-HEIGHT"}),
        ("PLAUSIBLE-AIR", set()),
        ("PLAUSIBLE-WINDOW", set()),
    ],
)
def test_what_tie_points_find_is_held_back_while_its_cause_stands(cause, held_back):
    """One cause, one message: a wrong focal length turns every mount by tie points."""
    codes = [cause, *TIES]
    ledger = ledger_of(dict.fromkeys(codes, Kind.FINDING))

    hold_back_ties(ledger)

    findings = {entry.code for entry in ledger if entry.kind is Kind.FINDING}
    assert findings == set(codes) - held_back
    notes = with_code(ledger, "TIES-HELD-BACK")
    assert len(notes) == bool(held_back)
    for note in notes:
        assert cause in note.what
        for code in held_back:
            assert code in note.what
            assert code.lower() in note.what


@pytest.mark.parametrize(
    ("kind_of_cause", "kind_of_ties"),
    [
        (Kind.WARNING, Kind.FINDING),  # accepted in the mission file
        (Kind.FINDING, Kind.NOTE),  # only says how well rays meet
    ],
)
def test_nothing_is_held_back_by_what_is_accepted_or_of_what_is_a_note(kind_of_cause, kind_of_ties):
    ledger = ledger_of({"PLAUSIBLE-VIEW": kind_of_cause, "TIES-MOUNT": kind_of_ties})
    hold_back_ties(ledger)
    assert [entry.code for entry in ledger] == ["PLAUSIBLE-VIEW", "TIES-MOUNT"]


@pytest.mark.parametrize(
    ("camera", "is_exchanged"),
    [
        ((10600, 14000, 7012.4, 5291.7), True),
        ((14000, 10600, 7012.4, 5291.7), False),
        ((10600, 14000, 5300.0, 7000.0), False),
        ((14000, 10600, 4200.0, 5300.0), False),  # of another image
        ((10600, 10600, 5300.0, 5300.0), False),
        ((10000, 10500, 5250.0, 5000.0), False),  # nearly square: in the middle of both
    ],
)
def test_sides_are_exchanged_if_the_principal_point_is_at_the_other_middle(camera, is_exchanged):
    width, height, cx, cy = camera
    assert are_sides_exchanged(Camera(width, height, 20000.0, 20000.0, cx, cy)) is is_exchanged


def ledger_of_exchanged(kind=Kind.FINDING):
    """What is found of two cameras with exchanged sides and a third, whose points are outside."""
    ledger = Ledger()
    for code, name in (
        ("PLAUSIBLE-PRINCIPAL-POINT", "nadir"),
        ("PLAUSIBLE-PRINCIPAL-POINT", "oblique"),
        ("PLAUSIBLE-EXTENT", "nadir"),
        ("PLAUSIBLE-EXTENT", "oblique"),
        ("PLAUSIBLE-EXTENT", "third"),
        ("PLAUSIBLE-FLAGGED", "outside_camera"),
        ("PLAUSIBLE-FLAGGED", "no_ground"),
    ):
        of_code = Code(code, means="...", effect="...", remedy="...")
        ledger.add(message(kind, of_code, "said of {name}", name=name))
    return ledger


def test_what_follows_from_exchanged_sides_is_held_back():
    ledger = ledger_of_exchanged()
    hold_back_extents(["nadir", "oblique"], ledger)
    found = [(entry.code, entry.values["name"]) for entry in ledger if entry.kind is Kind.FINDING]
    assert found == [
        ("PLAUSIBLE-PRINCIPAL-POINT", "nadir"),
        ("PLAUSIBLE-PRINCIPAL-POINT", "oblique"),
        ("PLAUSIBLE-EXTENT", "third"),
        ("PLAUSIBLE-FLAGGED", "no_ground"),
    ]
    (note,) = with_code(ledger, "SIDES-HELD-BACK")
    assert note.kind is Kind.NOTE
    assert note.count == 3
    assert "PLAUSIBLE-EXTENT, PLAUSIBLE-FLAGGED" in note.what
    assert "nadir, oblique" in note.what


@pytest.mark.parametrize(("exchanged", "kind"), [([], Kind.FINDING), (["nadir"], Kind.WARNING)])
def test_nothing_is_held_back_without_exchanged_sides_or_if_they_are_accepted(exchanged, kind):
    ledger = ledger_of_exchanged(kind)
    hold_back_extents(exchanged, ledger)
    assert len(ledger) == 7


OF_RAYS = ("misses_ground", "beyond_grazing", "far_branch")


@pytest.mark.parametrize(
    ("codes", "accepted", "known"),
    [
        (["TIES-TIME"], [], dict.fromkeys(OF_RAYS, "TIES-TIME")),
        (["TIES-TIME"], ["TIES-TIME"], {}),
        (["TIES-TIME", "PLAUSIBLE-VIEW"], [], {}),  # held back
        (["TIES-HEIGHT", "PLAUSIBLE-GROUND"], [], {}),
        (["TIES-RESIDUALS"], [], {}),  # decides nothing
        (["PLAUSIBLE-EXTENT"], [], {"outside_camera": "PLAUSIBLE-EXTENT"}),
        (["PLAUSIBLE-SENSORS", "STATIONS-HEIGHT"], [], {"no_station": "PLAUSIBLE-SENSORS"}),
        (["PLAUSIBLE-SENSORS"], [], {}),
    ],
)
def test_a_finding_is_the_cause_of_flagged_rows_while_it_stands(codes, accepted, known):
    facts = SimpleNamespace(
        mission=SimpleNamespace(accept=[SimpleNamespace(code=code) for code in accepted]),
        stations=SimpleNamespace(ok=np.array([False]), status=np.array(["suspect"])),
    )
    assert findings_causing_statuses(facts, ledger_of(dict.fromkeys(codes, Kind.FINDING))) == known


def test_many_flagged_rows_of_a_known_cause_are_no_other_finding():
    ledger = ledger_of({"PLAUSIBLE-EXTENT": Kind.FINDING})
    for status in ("outside_camera", "no_ground"):
        text = {"where": "observations", "percent": 36.0, "most": 20.0, "cause": "..."}
        ledger.add(many_flagged(name=status, **text))
    known = {"outside_camera": "PLAUSIBLE-EXTENT", "misses_ground": "TIES-TIME"}

    settle_findings([], known, [], ledger)

    left = with_code(ledger, "PLAUSIBLE-FLAGGED")
    assert [entry.values["name"] for entry in left] == ["no_ground"]
    facts = SimpleNamespace(
        stations=SimpleNamespace(ok=np.array([True]), status=np.array(["ok"])),
    )
    # Rays that miss the ground stay a loss, which names the finding.
    assert statuses_explained(facts, ledger, known) == {"outside_camera"}


def test_x_and_y_exchanged_are_one_mistake(mission):
    """Rows outside the image follow from it."""
    table = mission.measured_rows()
    table["x_px"], table["y_px"] = table["y_px"].copy(), table["x_px"].copy()
    mission.observe_rows(table)

    ledger = mission.checked().corrected.prepared.ledger

    of_kind = {entry.code for entry in ledger if entry.kind in (Kind.FINDING, Kind.LOSS)}
    assert of_kind == {"PLAUSIBLE-EXTENT"}


def exchange(mission, quantity):
    """Exchange the channels outside and in the cabin in the mission file."""
    channels = mission.config["log"]["channels"]
    outside = channels[quantity]
    channels[quantity] = channels[f"cabin_{quantity}"]
    channels[f"cabin_{quantity}"] = outside


@pytest.mark.parametrize(
    ("quantities", "loss"),
    [
        (["temperature"], "AIR-THERMOMETER"),
        (["pressure"], "AIR-NOT-OUTSIDE"),
        (["pressure", "temperature"], "AIR-NOT-OUTSIDE"),
    ],
)
def test_sensors_of_the_cabin_that_are_named_as_outside(mission, quantities, loss):
    for quantity in quantities:
        exchange(mission, quantity)

    ledger = mission.checked().corrected.prepared.ledger

    assert with_code(ledger, loss)
    said = [entry.what for entry in with_code(ledger, "PLAUSIBLE-SENSORS")]
    assert len(said) == len(quantities)
    for quantity, what in zip(quantities, said, strict=True):
        assert re.match(
            rf"log\.channels\.{quantity} \(\w+\[1\]\) and log\.channels\.cabin_{quantity} ", what
        )
    assert not with_code(ledger, "PLAUSIBLE-FLAGGED")


def test_thermometers_that_are_both_in_the_cabin_are_not_exchanged(mission):
    exchange(mission, "temperature")
    read = read_folder(mission)
    channels = {channel.name: channel for channel in read.inputs.log.channels}
    outside = channels["HYGR[0]"]
    cabin_k = channels["HYGR[1]"]["temperature_k"][: len(outside)]
    in_cabin = replace(outside, columns={**outside.columns, "temperature_k": cabin_k})

    prepared = prepare_mission(read.mission, with_channels(read.inputs, in_cabin), Ledger())

    assert with_code(prepared.ledger, "AIR-THERMOMETER")
    assert not with_code(prepared.ledger, "PLAUSIBLE-SENSORS")


def test_an_image_that_the_log_does_not_know_is_one_loss(mission):
    """Its rows are a note; rows without ground stay a loss of their own."""
    table = mission.measured_rows()
    table.loc[0, "image"] = "nadir_09999"
    table.loc[5, "h_g_m"] = np.nan
    mission.observe_rows(table)

    checked = mission.checked()

    ledger = checked.corrected.prepared.ledger
    (unmatched,) = with_code(ledger, "IMAGES-UNMATCHED")
    assert unmatched.kind == "loss"
    flagged = with_code(ledger, "OBS-FLAGGED")
    kinds = {message.values["status"]: message.kind for message in flagged}
    assert kinds == {"no_station": "note", "no_ground": "loss"}
    assert checked.manifest.values["exit_code"] == 3


@pytest.mark.parametrize(
    ("decades", "words"),
    [
        (3.4, "this is 10^3 times as likely as what is stated"),
        (6.0, "this is 10^6 times as likely as what is stated"),
        (499.0, "this is practically certain"),
        (math.inf, "by 12 tie points; change"),
    ],
)
def test_odds_beyond_a_million_are_practically_certain(decades, words):
    finding = ties_contradict(
        code="TIES-MOUNT",
        where="mount.nadir",
        count=12,
        mistake="roll is 1 deg off",
        decades=decades,
        change="mount.nadir",
        residual=None,
    )
    assert words in finding.what
    assert ("10^" in finding.what) == (decades <= 6.0)


@pytest.mark.parametrize(
    ("lat_deg", "north_deg", "east_deg", "km"),
    [
        (60.0, 0.0, 0.1, 5.56),  # a degree of longitude is half as long as on the equator
        (60.0, 0.1, 0.0, 11.12),
        (0.0, 0.3, 0.4, 55.6),
        (60.0, 0.0, -359.9, 5.56),  # across the 180th meridian
    ],
)
def test_the_distance_from_the_takeoff_is_that_over_ground(lat_deg, north_deg, east_deg, km):
    takeoff = SimpleNamespace(lat_rad=math.radians(lat_deg), lon_rad=3.1)
    stations = SimpleNamespace(
        ok=np.array([True, True, False]),
        lat_rad=takeoff.lat_rad + np.radians([north_deg, north_deg, 20.0]),
        lon_rad=takeoff.lon_rad + np.radians([east_deg, east_deg, 20.0]),
    )
    facts = SimpleNamespace(stations=stations)
    assert median_distance_km(facts, takeoff) == pytest.approx(km, rel=0.002)
