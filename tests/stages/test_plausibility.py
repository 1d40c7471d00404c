"""Each rule finds its mistake in a mission that is sound otherwise, and nothing else does."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from tests.batch.test_rehearsal import config, rows
from unbend.atmosphere.estimate.candidates import SourceUse
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.batch.rehearsal import camera_text
from unbend.batch.runs import check_mission
from unbend.errors import Code
from unbend.messages import Kind, Ledger, message
from unbend.refraction import BrownConrady, Camera, Exposures
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.effect import Effect
from unbend.simulate.flight import FIELD_LAT_RAD, FIELD_LON_RAD, geographic, terrain_m
from unbend.simulate.write_dataflash import FORMATS
from unbend.stages.multi_image.messages import ties_contradict
from unbend.stages.plausibility.causes import cause_of_outside
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.findings import hold_back_ties
from unbend.stages.plausibility.rules import (
    RULES,
    air_of_flight,
    distortion,
    field_of_view,
    median_distance_km,
)

pytestmark = pytest.mark.usefixtures("plain_report")


def scaled(**factors):
    def change(table):
        for name, factor in factors.items():
            table[name] *= factor

    return rows(change)


def many(spoil):
    """The observations ten times, so that their extent counts, before they are spoiled."""

    def change(mission):
        table = mission.measurements().to_pandas()
        table = table.loc[table.index.repeat(10)].reset_index(drop=True)
        mission.observe(pa.Table.from_pandas(table, preserve_index=False), "observations.parquet")
        spoil(mission)

    return change


def exchanged(table):
    table["x_px"], table["y_px"] = table["y_px"].copy(), table["x_px"].copy()


def centred(table):
    table["x_px"] -= 7000.0
    table["y_px"] -= 5300.0


NADIR = "cameras__nadir__"
SIZE = {"width_px": 14000, "height_px": 10600, "calibration": "laboratory"}
METRIC = SIZE | {
    "metric": {
        "focal_mm": 13.8,
        "pixel_um": [4.6, 4.6],
        "format_mm": [64.4, 48.76],
        "origin": "image_centre",
        "axes": "right up",
        "ppa_mm": [0.0, 0.0],
    }
}
PINHOLE = SIZE | {"model": "SIMPLE_PINHOLE", "params": [20000.0, 4200.0, 5300.0]}
# What is changed -> the code, the key it must name, and words of what was found.
FOUND = {
    "feet": (scaled(h_g_m=3.28084), "PLAUSIBLE-GROUND", "ground.height", "likely feet"),
    "f in mm": (
        config(**{NADIR + "fx_px": 3000.0, NADIR + "fy_px": 3000.0, NADIR + "distortion": {}}),
        "PLAUSIBLE-VIEW",
        "cameras.nadir.fx_px",
        r"is 142 deg .* likely f in millimetres",
    ),
    "f in um": (
        config(**{NADIR + "fx_px": 920000.0, NADIR + "fy_px": 920000.0}),
        "PLAUSIBLE-VIEW",
        "cameras.nadir.fx_px",
        r"is 1.09 deg",
    ),
    "report of another camera": (
        config(cameras__nadir=METRIC),
        "PLAUSIBLE-VIEW",
        "cameras.nadir.metric.focal_mm",
        "is 142 deg .* metric.pixel",
    ),
    "params of another image": (
        config(cameras__nadir=PINHOLE),
        "PLAUSIBLE-PRINCIPAL-POINT",
        "cameras.nadir, params or file",
        "is 20 % of the image",
    ),
    "fy of another": (
        config(**{NADIR + "fy_px": 26000.0}),
        "PLAUSIBLE-VIEW",
        "cameras.nadir.fx_px",
        "fx of camera nadir is 20000 px and fy 26000 px",
    ),
    "offset of c": (
        config(**{NADIR + "cx_px": 12.4}),
        "PLAUSIBLE-PRINCIPAL-POINT",
        "cameras.nadir.cx_px",
        "is 50 % of the image from its centre",
    ),
    "k1 of pixels": (
        config(**{NADIR + "distortion": {"k1": -4.5e-11}}),
        "PLAUSIBLE-DISTORTION",
        "cameras.nadir.distortion",
        "coefficients for pixels",
    ),
    "order of k": (
        config(
            **{
                NADIR + "distortion": {
                    "k1": -0.018,
                    "k2": 0.009,
                    "k3": 0.00015,
                    "p1": -0.0001,
                    "p2": -0.002,
                }
            }
        ),
        "PLAUSIBLE-DISTORTION",
        "cameras.nadir.distortion.k3",
        "in another order",
    ),
    "reduced images": (
        many(scaled(x_px=0.5, y_px=0.5)),
        "PLAUSIBLE-EXTENT",
        "cameras.nadir.width_px",
        "measured in reduced images",
    ),
    "x and y": (
        rows(exchanged),
        "PLAUSIBLE-EXTENT",
        "observations.columns.x_px",
        "width and height, or x and y, exchanged",
    ),
    "from the centre": (
        many(rows(centred)),
        "PLAUSIBLE-EXTENT",
        "cameras.nadir.width_px",
        "measured from the centre of the image",
    ),
    "width and height": (
        config(**{NADIR + "width_px": 10600, NADIR + "height_px": 14000}),
        "PLAUSIBLE-EXTENT",
        "cameras.nadir.width_px",
        "exchanged",
    ),
    "gimbal": (
        config(mount__nadir__pitch_deg=-90.0),
        "PLAUSIBLE-DIRECTION",
        "mount.nadir",
        r"9\d.* deg from the nadir|8\d.* deg from the nadir",
    ),
    "nadir by name": (
        config(mount__nadir__roll_deg=45.0),
        "PLAUSIBLE-DIRECTION",
        "mount.nadir",
        "within 30 deg of the nadir by the name of nadir",
    ),
    "radians": (
        config(mount__oblique__roll_deg=-0.7853982),
        "PLAUSIBLE-ANGLE",
        "mount.oblique.roll_deg",
        "which is -45 deg in radians",
    ),
    "oblique by name": (
        config(mount__oblique__roll_deg=-0.7),
        "PLAUSIBLE-DIRECTION",
        "mount.oblique",
        ("more than 10 deg from the nadir, because of the name of oblique"),
    ),
    "lever arm in cm": (
        config(mount__oblique__lever_arm_m=[20.0, 28.0, 55.0]),
        "PLAUSIBLE-LEVER-ARM",
        "mount.oblique.lever_arm_m",
        "is 65 m long",
    ),
    "lever arm upward": (
        config(mount__oblique__lever_arm_m=[0.2, 0.28, -0.55]),
        "PLAUSIBLE-LEVER-ARM",
        "mount.oblique.lever_arm_m",
        "0.55 m above the point with the known position",
    ),
    "sigma in mm": (config(ground__sigma_m=150.0), "PLAUSIBLE-SIGMA", "ground.sigma_m", "150 m"),
    "delay of a clock": (
        config(events__log__nadir__delay_s=3.0),
        "PLAUSIBLE-DELAY",
        "delay_s",
        "delay_s of nadir is 3 s",
    ),
    "no window": (
        config(**{NADIR + "window": None, "cameras__oblique__window": None}),
        "PLAUSIBLE-WINDOW",
        "cameras.nadir.window",
        "no camera has a window",
    ),
    "normal in body": (
        config(cameras__oblique__window={"cabin": "log", "normal": [0.0, 0.7071, 0.7071]}),
        "PLAUSIBLE-WINDOW",
        "cameras.oblique.window.frame",
        "is tilted by 45 deg",
    ),
    "no heights": (
        rows(lambda table: table.__setitem__("h_g_m", np.nan)),
        "PLAUSIBLE-FLAGGED",
        "ground.height",
        "100 % of the observations are no_ground",
    ),
    "ground above": (
        config(ground__height=4000.0),
        "PLAUSIBLE-FLAGGED",
        "ground.height",
        r"the ground is up to 1\d{3} m above the camera",
    ),
    "apply": (
        config(refraction={"direction": "apply"}),
        "PLAUSIBLE-APPLY",
        "refraction.direction",
        "expected remove",
    ),
}


@pytest.mark.parametrize("what", FOUND)
def test_a_mistake_is_found_with_its_key(mission, what):
    spoil, code, key, words = FOUND[what]
    spoil(mission)
    manifest = check_mission(mission.save()).manifest.values
    found = [e for e in manifest["ledger"] if e["kind"] == "finding" and e["code"] == code]
    texts = [f"{e['what']} {e['where']}" for e in found]
    assert any(re.search(words, text) and key in text for text in texts), manifest["ledger"]
    assert manifest["exit_code"] == 3


def test_slant_ranges_in_feet(mission):
    """Straight lines from 2500 m above the field to the points, 3.28 times as long."""
    checked = check_mission(mission.save())
    facts = checked.corrected.facts
    length = (facts.camera_height_m - facts.rows.h_g_m) / np.cos(facts.nadir_angle_rad)
    for factor, finds in ((1.0, False), (3.28084, True)):
        rows(lambda t, f=factor: t.insert(5, "slant", length * f))(mission)
        mission.config["observations"]["columns"] = {"distance_m": "slant"}
        ledger = check_mission(mission.save()).manifest.values["ledger"]
        text = [e["what"] for e in ledger if e["code"] == "PLAUSIBLE-DISTANCE"]
        assert bool(text) is finds
        assert not finds or "3.28 times" in text[0]
        mission.config["observations"] = {"path": "observations.parquet"}


TERR = type(FORMATS["POS"])(
    210,
    "TERR",
    "QBLLHffHHf",
    "TimeUS,Status,Lat,Lng,Spacing,TerrH,CHeight,Pending,Loaded,ROfs",
    "s-DU-mm--m",
    "F-GG-00--0",
)


def log_terrain(mission, *, status=2, add_m=0.0):
    """A TERR row after each POS row of the log: the simulator's terrain below it."""
    lengths = {f.type_id: 3 + f.struct.size for f in FORMATS.values()}
    data = mission.log.read_bytes()
    at = 0
    parts = []
    columns = (text.encode() for text in (TERR.name, TERR.format, TERR.columns))
    parts.append(FORMATS["FMT"].pack(TERR.type_id, 3 + TERR.struct.size, *columns))
    lat_1, lon_1 = (float(a) for a in geographic(np.array(1.0), np.array(1.0)))
    while at < len(data):
        row = data[at : at + lengths[data[at + 2]]]
        parts.append(row)
        at += len(row)
        if row[2] == FORMATS["POS"].type_id:
            time, lat, lon = FORMATS["POS"].struct.unpack(row[3:])[:3]
            north = (np.radians(lat * 1e-7) - FIELD_LAT_RAD) / (lat_1 - FIELD_LAT_RAD)
            east = (np.radians(lon * 1e-7) - FIELD_LON_RAD) / (lon_1 - FIELD_LON_RAD)
            height = float(terrain_m(east, north)) + add_m
            parts.append(TERR.pack(time, status, lat * 1e-7, lon * 1e-7, 100, height, 0, 0, 9, 0))
    mission.log.write_bytes(b"".join(parts))


@pytest.mark.parametrize(
    ("factor", "status", "words"),
    [
        (1.0, 2, None),
        (0.8, 2, r"-\d\d m from the terrain|-1\d\d m from the terrain"),
        (1.25, 2, r"\+1\d\d m from the terrain"),
        (1.25, 1, None),
    ],
)
def test_ground_beside_the_terrain_of_the_autopilot(mission, factor, status, words):
    """Heights 100 m off pass as near the take-off, but not beside the logged terrain."""
    log_terrain(mission, status=status)
    scaled(h_g_m=factor)(mission)
    manifest = check_mission(mission.save()).manifest.values
    found = [e for e in manifest["ledger"] if e["code"] == "PLAUSIBLE-TERRAIN"]
    assert len(found) == (words is not None), manifest["ledger"]
    assert all(re.search(words, e["what"]) and "ground.reference" in e["where"] for e in found)
    # Tie points find the same where heights are spoiled; it is held back where the cause is named.
    other = {e["code"] for e in manifest["ledger"] if e["kind"] == "finding" and e not in found}
    assert other == ({"TIES-HEIGHT"} if factor != 1.0 and words is None else set())
    held_back = "TIES-HELD-BACK" in {e["code"] for e in manifest["ledger"]}
    assert held_back is (words is not None)


def test_air_of_another_pressure(mission, monkeypatch):
    """R in air of half the pressure is half of the standard's: no ascent has that."""
    from dataclasses import replace

    from unbend.stages import story

    real = story.adjusted_profiles

    def thin(*args):
        air = real(*args)
        profile = air.adjustment.profile
        layers = replace(profile.layers, pressure=0.5 * profile.layers.pressure)
        profile = replace(profile, layers=layers)
        return replace(air, adjustment=replace(air.adjustment, profile=profile))

    monkeypatch.setattr(story, "adjusted_profiles", thin)
    ledger = check_mission(mission.save()).manifest.values["ledger"]
    (entry,) = [e for e in ledger if e["code"] == "PLAUSIBLE-AIR"]
    assert re.search(r"is 0\.50 ± 0\.0\d times that in the standard", entry["what"])
    assert "log.channels.pressure" in entry["where"]
    assert "log.channels.temperature" in entry["where"]


def quantity_of(name):
    return "pressure" if name.startswith("BARO") else "temperature"


def air_of(factor, sigma, sources, *, climb_m=1000.0, usual=1.0):
    """What the rule says of an air: R over the standard's, its sigma, the sources and their fit."""
    effect = Effect(45.0, 200.0 + climb_m, 200.0, factor, 1.0, sigma)
    uses = []
    for name, freedom in sources.items():
        fit = None
        if freedom is not None:
            fit = Fit(name, quantity_of(name), 9, 1.0, 1.0, freedom)
        uses.append(SourceUse(name, fit=fit))
    facts = SimpleNamespace(
        effects=(effect,), usual_factor=usual, adjustment=SimpleNamespace(sources=uses)
    )
    return [(e.where, e.what) for e in air_of_flight(facts)]


@pytest.mark.parametrize(
    ("factor", "sigma", "climb_m", "told"),
    [
        (1.9, 0.02, 1000.0, False),  # ascents reach 1.75
        (2.4, 0.02, 1000.0, True),
        (2.4, 0.06, 1000.0, False),  # less than two sigma beyond the limit
        (2.4, math.nan, 1000.0, True),
        (1.7, 0.02, 2000.0, False),
        (1.9, 0.02, 2000.0, True),
        (1.7, 0.02, 8000.0, True),
        (0.6, 0.01, 1000.0, False),
        (0.5, 0.01, 1000.0, True),
        (0.5, 0.03, 1000.0, False),
        (0.75, 0.01, 8000.0, True),
        (-3.0, 0.01, 400.0, False),  # the lowest layer decides
        (9.0, 0.01, 499.0, False),
        (9.0, 0.01, 501.0, True),
    ],
)
def test_air_is_what_ascents_have(factor, sigma, climb_m, told):
    found = air_of(factor, sigma, {"sounding 11035": 3.0}, climb_m=climb_m)
    assert len(found) == told


def test_limits_reach_to_the_usual_air_of_place_and_season():
    """Over the snow of Siberia R is twice the standard's: no finding, but a tenth of it is one."""
    sources = {"sounding 30230": 3.0}
    assert air_of(4.0, 0.02, sources, usual=1.9) == []
    assert len(air_of(4.5, 0.02, sources, usual=1.9)) == 1
    assert len(air_of(0.5, 0.02, sources, usual=1.9)) == 1
    assert air_of(0.45, 0.02, sources, usual=0.8) == []


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
    ((key, text),) = air_of(3.0, 0.02, sources)
    assert key == where
    assert text.endswith(f"unit of {named}")


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_a_sound_mission_has_no_findings(mission_factory, tmp_path, kind):
    manifest = check_mission(mission_factory(tmp_path / "m", kind).save()).manifest.values
    assert [e for e in manifest["ledger"] if e["kind"] in ("finding", "loss")] == []


@pytest.mark.parametrize(
    ("camera", "codes"),
    [
        (Camera(3000, 3000, 950.0, 950.0, 1500.0, 1500.0, OpenCVFisheye(-0.01)), []),
        (Camera(4000, 3000, 1700.0, 1700.0, 2000.0, 1500.0, OpenCVFisheye()), []),
        (Camera(4000, 3000, 9e3, 9e3, 2000.0, 1500.0, OpenCVFisheye()), ["PLAUSIBLE-VIEW"]),
        (Camera(3000, 3000, 700.0, 700.0, 1500.0, 1500.0), ["PLAUSIBLE-VIEW"]),
        (Camera(9000, 9000, 7500.0, 7500.0, 4500.0, 4500.0, GeneralFrame(limit=0.9)), []),
        (Camera(9000, 9000, 7500.0, 7500.0, 4500.0, 4500.0, GeneralFrame(k1=1e-8)),
         ["PLAUSIBLE-DISTORTION"]),
    ],
)  # fmt: skip
def test_a_camera_is_judged_by_its_type(camera, codes):
    facts = Facts(*[None] * len(fields(Facts)))
    mission = SimpleNamespace(cameras={"nadir": SimpleNamespace(model=None, metric=None)})
    facts = replace(facts, mission=mission, cameras={"nadir": camera})
    found = [entry.code for rule in (field_of_view, distortion) for entry in rule(facts)]
    assert found == codes


def test_what_a_fisheye_sees_follows_its_angles():
    """3000 px of 1/950 rad are 180.9 deg; the ground to 85 deg: 2 * 1000 m * 11.43."""
    facts = SimpleNamespace(
        cameras={"nadir": Camera(3000, 3000, 950.0, 950.0, 1500.0, 1500.0, OpenCVFisheye())},
        of_camera=lambda name, values: values,
        camera_height_m=np.array([1000.0]),
        rows=SimpleNamespace(h_g_m=np.array([0.0])),
        axis_deg=lambda name: 0.0,
    )
    assert camera_text(facts, "nadir").startswith("nadir 181 x 181 deg, 1.1 m a pixel, 22860 x")


def test_every_rule_is_a_function_with_one_sentence():
    assert len(RULES) == len(set(RULES))
    assert all(rule.__doc__ and rule.__doc__.strip().endswith(".") for rule in RULES)


def test_rays_beyond_the_horizon_are_told_by_how_much(mission):
    """A camera that looks 120 deg from the nadir sees nothing but sky."""
    mission.config["mount"]["nadir"]["pitch_deg"] = -120.0
    checked = check_mission(mission.save())
    (entry,) = [
        e
        for e in checked.manifest.values["ledger"]
        if e["code"] == "OBS-FLAGGED" and "misses_ground" in e["what"]
    ]
    degrees = float(re.search(r"up to ([\d.]+) deg above the horizon", entry["what"])[1])
    facts = checked.corrected.facts
    angle = np.degrees(np.nanmax(facts.nadir_angle_rad[facts.camera == "nadir"]))
    # Geometry by hand: the horizon of a sphere of 6371 km from the height above the ground.
    height = np.nanmax(facts.camera_height_m - facts.rows.h_g_m)
    dip = np.degrees(np.sqrt(2.0 * height / 6.371e6))
    assert degrees == pytest.approx(angle - 90.0 + dip, abs=0.2)


def outside_facts(camera, x_px, *, direction="remove", normal=(0.0, 0.0, 1.0)):
    """What `cause_of_outside` looks at: points in the middle row, behind a window."""
    n = len(x_px)
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
        cameras={"nadir": SimpleNamespace(model=None, metric=None)},
        windows={"nadir": SimpleNamespace(section="window")},
        refraction=SimpleNamespace(direction=direction),
    )
    rows = SimpleNamespace(
        x_px=np.asarray(x_px, float), y_px=np.full(n, 500.0), station=np.zeros(n, np.int64)
    )
    # The cameras of rows are a cached property of stations.
    facts = Facts(*[None] * len(fields(Facts)))
    facts = replace(
        facts, mission=mission, exposures=exposures, cameras={"nadir": camera}, rows=rows
    )
    facts.__dict__["camera"] = np.full(n, "nadir")
    return facts, np.ones(n, bool)


PLAIN = Camera(1000, 1000, 900.0, 900.0, 500.0, 500.0)
CURVED = Camera(1000, 1000, 300.0, 300.0, 500.0, 500.0, BrownConrady(k1=-0.2))


@pytest.mark.parametrize(
    ("camera", "x_px", "given", "cause"),
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
def test_the_cause_of_a_pixel_outside_the_camera(camera, x_px, given, cause):
    facts, outside = outside_facts(camera, [x_px], **given)
    assert cause_of_outside(facts, outside) == cause


def told(*codes_and_kinds):
    """A ledger with messages of these codes and kinds; ``where`` is the code in small letters."""
    ledger = Ledger()
    for name, kind in codes_and_kinds:
        code = Code(name, means="...", effect="...", remedy="...")
        ledger.add(message(kind, code, f"said of {name}", where=name.lower()))
    return ledger


@pytest.mark.parametrize(
    ("cause", "held"),
    [
        ("PLAUSIBLE-VIEW", {"TIES-MOUNT", "TIES-HEIGHT", "TIES-RESIDUALS"}),
        ("PLAUSIBLE-ANGLE", {"TIES-MOUNT", "TIES-HEIGHT", "TIES-RESIDUALS"}),
        ("PLAUSIBLE-GROUND", {"TIES-HEIGHT"}),
        ("PLAUSIBLE-AIR", set()),
        ("PLAUSIBLE-WINDOW", set()),
    ],
)
def test_what_tie_points_find_is_held_back_while_its_cause_stands(cause, held):
    """One cause, one message: a wrong focal length turns every mount by tie points."""
    ties = ["TIES-MOUNT", "TIES-HEIGHT", "TIES-RESIDUALS"]
    ledger = told((cause, Kind.FINDING), *((code, Kind.FINDING) for code in ties))
    hold_back_ties(ledger)
    left = {entry.code for entry in ledger if entry.kind is Kind.FINDING}
    assert left == {cause, *ties} - held
    notes = [entry.what for entry in ledger if entry.code == "TIES-HELD-BACK"]
    assert len(notes) == bool(held)
    for note in notes:
        assert cause in note
        assert all(code in note and code.lower() in note for code in held)


def test_nothing_is_held_back_by_what_is_accepted_or_of_what_is_a_note():
    """What the mission file states is right is no cause; notes only say how well rays meet."""
    ledger = told(("PLAUSIBLE-VIEW", Kind.WARNING), ("TIES-MOUNT", Kind.FINDING))
    hold_back_ties(ledger)
    assert [entry.code for entry in ledger] == ["PLAUSIBLE-VIEW", "TIES-MOUNT"]
    ledger = told(("PLAUSIBLE-VIEW", Kind.FINDING), ("TIES-RESIDUALS", Kind.NOTE))
    hold_back_ties(ledger)
    assert len(ledger) == 2


def test_an_image_that_the_log_does_not_know_is_one_loss(mission):
    """Its rows are a note; rows without ground stay a loss of their own."""
    table = mission.measurements().to_pandas()
    table.loc[0, "image"] = "nadir_09999"
    table.loc[5, "h_g_m"] = np.nan
    mission.observe(pa.Table.from_pandas(table, preserve_index=False))
    manifest = check_mission(mission.save()).manifest.values
    kinds = {
        (entry["code"], entry["values"].get("status"), entry["kind"])
        for entry in manifest["ledger"]
        if entry["code"] in ("IMAGES-UNMATCHED", "OBS-FLAGGED")
    }
    assert kinds == {
        ("IMAGES-UNMATCHED", None, "loss"),
        ("OBS-FLAGGED", "no_station", "note"),
        ("OBS-FLAGGED", "no_ground", "loss"),
    }
    assert manifest["exit_code"] == 3


@pytest.mark.parametrize(
    ("decades", "says"),
    [
        (3.4, "this is 10^3 times as likely as what is stated"),
        (6.0, "this is 10^6 times as likely as what is stated"),
        (499.0, "this is practically certain"),
        (math.inf, "by 12 tie points; change"),
    ],
)
def test_odds_beyond_a_million_are_practically_certain(decades, says):
    found = ties_contradict(
        code="TIES-MOUNT",
        where="mount.nadir",
        count=12,
        mistake="roll is 1 deg off",
        decades=decades,
        change="mount.nadir",
        residual=None,
    )
    assert says in found.what
    assert ("10^" in found.what) == (decades <= 6.0)


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
    found_km = median_distance_km(SimpleNamespace(stations=stations), takeoff)
    assert found_km == pytest.approx(km, rel=0.002)
