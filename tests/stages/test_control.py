"""Before and after on control points: the simulator's truth, and an intersection made here."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pyproj
import pytest
import yaml

from tests.conftest import MissionFolder
from tests.golden.held_block import (
    CX,
    CY,
    FOCAL,
    LENS,
    NADIR,
    HeldBlock,
    fly,
    intersected,
    write_mission,
)
from tests.report.manifests import manifest_of
from unbend.messages import Kind, Ledger, Message
from unbend.report.summary import control_rows, control_sentence
from unbend.simulate.flight import UNDULATION_M
from unbend.simulate.optics import height_and_up
from unbend.stages.multi_image.control import ControlComparison, judge_control
from unbend.tables.manifest.whole import Manifest

EVERY = 7  # of the points is control


@pytest.fixture(scope="module")
def block() -> HeldBlock:
    return fly(6000.0, NADIR, seed=21)


@pytest.fixture(scope="module")
def table(block) -> pd.DataFrame:
    """The table of control points in every system that a test states."""
    height, up = height_and_up(block.place)
    lat = np.degrees(np.arcsin(up[:, 2]))
    lon = np.degrees(np.arctan2(up[:, 1], up[:, 0]))
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    east, north = to_grid.transform(lon, lat)
    columns = {
        "point": block.point,
        "lat_deg": lat,
        "lon_deg": lon,
        "h_ellipsoid_m": height,
        "h_msl_m": height - UNDULATION_M,
        "east": east,
        "north": north,
    }
    return pd.DataFrame(columns)[::EVERY]


@pytest.fixture
def surveyed(block, table, tmp_path) -> MissionFolder:
    """A mission of the block with a table of control points that a test may spoil."""
    file = write_mission(block, tmp_path / "mission", control="control.csv")
    config = yaml.safe_load(file.read_text(encoding="utf-8"))
    mission = MissionFolder(file.parent, "no log", config)
    survey(mission, table)
    return mission


def survey(mission: MissionFolder, table: pd.DataFrame) -> None:
    """Write another table of control points."""
    table.to_csv(mission.folder / "control.csv", index=False)


def control_entry(mission: MissionFolder, exit_code: int) -> dict:
    """The only thing that a run says of control."""
    ledger = mission.run_to_manifest(exit_code)["ledger"]
    (entry,) = [entry for entry in ledger if entry["code"].startswith("CONTROL-")]
    return entry


def tangents(pixels: np.ndarray) -> np.ndarray:
    """(n, 2) straight rays of pixels, the lens inverted by a fixed point of the test's own."""
    k1, k2, p1, p2, k3 = LENS
    x_d, y_d = ((pixels - [CX, CY]) / FOCAL).T
    x = x_d
    y = y_d
    for _ in range(30):
        r2 = x * x + y * y
        radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
        dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        x = x_d - dx
        y = y_d - dy
    return np.stack([x, y], axis=1)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


def test_points_are_missed_by_what_the_independent_ray_says(surveyed, block, table):
    """Uncorrected 0.35 m too high, as the test's own intersection has it; corrected below 1 mm."""
    manifest = surveyed.run_to_manifest()
    assert "control" in {entry["role"] for entry in manifest["inputs"]}
    control = manifest["control"]
    points = pd.DataFrame(control["points"])
    before = np.array(points["before_m"].tolist())
    after = np.array(points["after_m"].tolist())
    measured = block.rows[["x_px", "y_px"]].to_numpy()
    names = block.point[np.unique(block.rows["point"])]
    error = pd.DataFrame(intersected(block, tangents(measured)), index=names)
    # The frame of the test is that of the middle of the block, 0.6 mrad from that of a point.
    np.testing.assert_allclose(before, error.loc[points["point"]], atol=2e-3)
    assert before[:, 2].mean() == pytest.approx(0.35, abs=0.02)
    assert np.abs(after).max() < 1e-3
    assert control["used"] == len(points) > 20
    assert control["unmeasured"] == len(table) - control["used"]
    rays = pd.Series(block.point[block.rows["point"]]).value_counts()
    assert points["rays"].tolist() == rays.loc[points["point"]].tolist()
    # Nothing is known of the stations.
    assert points["sigma_u_m"].isna().all()
    assert control["sigma_u_m"] is None
    for name, values in (
        ("rms_before_m", rms(before)),
        ("rms_after_m", rms(after)),
        ("rms_refraction_m", rms(before - after)),
        ("mean_before_m", before.mean(axis=0)),
        ("mean_after_m", after.mean(axis=0)),
    ):
        np.testing.assert_allclose(control[name], values, atol=2e-4)
    assert control["part_explained"] > 0.999


GRID = {"x": "east", "y": "north", "height": "h_msl_m"}
PLACE = {"latitude": "lat_deg", "longitude": "lon_deg", "height": "h_ellipsoid_m"}


@pytest.mark.parametrize(
    ("ground", "stated"),
    [
        ("given", {"columns": GRID, "crs": "EPSG:25832", "reference": "msl"}),
        ("given", {"columns": GRID, "crs": "EPSG:25832+5773", "reference": "msl"}),
        ("given", {"columns": PLACE, "crs": "EPSG:4258", "reference": "ellipsoid"}),
        # The control rows are few among all: intersected heights are looked up by their places.
        ("intersected", {}),
    ],
    ids=["grid", "compound", "geographic", "heights row by row"],
)
def test_every_system_says_the_same(surveyed, ground, stated):
    surveyed.config["control"] = {"path": "control.csv"} | stated
    if ground == "intersected":
        surveyed.config["ground"] = {"height": "intersected"}
    control = surveyed.run_to_manifest()["control"]
    assert control["rms_before_m"][2] == pytest.approx(0.35, abs=0.02)
    assert max(control["rms_after_m"]) < 1e-3


def test_the_terminal_and_a_rehearsal_show_it(surveyed, unbend):
    rehearsed = unbend("check", surveyed.save())
    assert rehearsed.code == 0
    text = " ".join(rehearsed.out.split())
    assert "control points, intersected with fixed stations" in text
    text = " ".join(surveyed.run().out.split())
    assert "27 control points: RMS distance 35 cm as measured, 0 mm corrected." in text
    for words in (
        "RMS of east/north/up",
        "100.0 % of their mean square residual",
        "dU corr.",
        "p14",
        "more: manifest.json",
    ):
        assert words in text
    *_, rms_row = control_rows(Manifest(surveyed.manifest()), 9)
    assert " ".join(" ".join(rms_row).split()) in text


def test_the_report_has_each_point(surveyed, whole_report):
    manifest = Manifest(surveyed.run_to_manifest())
    page = (surveyed.output / "report.html").read_text(encoding="utf-8")
    assert "<h2>Control points</h2>" in page
    page = re.sub(r"<td [^>]*>", "<td>", page)
    for row in control_rows(manifest, 200)[:-2]:
        assert f"<td>{row[0]}</td>" in page
        assert "".join(f"<td>{cell}</td>" for cell in row[2:8]) in page


def test_rows_of_control_points():
    point = {
        "point": "p1",
        "rays": 3,
        "before_m": [0.1234, -0.2, 0.35],
        "after_m": [0.001, -0.002, None],
        "sigma_u_m": 0.01234,
    }
    control = {
        "points": [point, point],
        "used": 2,
        "mean_before_m": [0.1, 0.2, 0.3],
        "mean_after_m": [0.01, 0.02, 0.03],
        "rms_before_m": [0.4, 0.5, 0.6],
        "rms_after_m": [0.04, 0.05, 0.06],
    }
    rows = [" ".join(row).split() for row in control_rows(manifest_of({"control": control}), 1)]
    assert rows == [
        ["p1", "3", "+0.123", "-0.200", "+0.350", "+0.001", "-0.002", "0.012"],
        ["(1", "more:", "manifest.json)"],
        ["mean", "of", "2", "+0.100", "+0.200", "+0.300", "+0.010", "+0.020", "+0.030"],
        ["rms", "of", "2", "+0.400", "+0.500", "+0.600", "+0.040", "+0.050", "+0.060"],
    ]
    without = manifest_of({})
    assert control_sentence(without) == ""
    assert control_rows(without, 9) == []


# -- what is judged, and from where on ----------------------------------------------------------


def judged(after, effect_m, *, sigma_m=0.0, stated=False, reading_m=np.nan) -> list[Message]:
    """What is said of points p0, p1 ... whose heights miss by so much after the correction."""
    up = np.array([0.0, 0.0, 1.0])
    misses = np.outer(after, up)
    comparison = ControlComparison(
        name=tuple(f"p{k}" for k in range(len(after))),
        rays=np.full(len(after), 3),
        before=misses + effect_m * up,
        after=misses,
        sigma_m=np.full(len(after), sigma_m),
        sigma_stated=stated,
        unmeasured=0,
    )
    ledger = Ledger()
    judge_control(comparison, {"a reading": reading_m, "unknown": np.nan}, ledger)
    return list(ledger)


CAUSES = {"CONTROL-WORSE": "observations.refraction", "CONTROL-FAR": "wrong names of points"}


@pytest.mark.parametrize(
    ("after", "named", "codes"),
    [
        # All: farther than 1 m, five sigmas, and three times the effect.
        ([0.99] * 5, {"effect_m": -0.3}, ["CONTROL-WORSE"]),
        ([1.01] * 5, {"effect_m": -0.3}, ["CONTROL-FAR"]),
        ([1.01] * 5, {"effect_m": 0.34}, []),
        ([1.01] * 5, {"effect_m": 0.3, "sigma_m": 0.21}, []),
        # Another reading leaves less than a fifth of it.
        ([2.0] * 5, {"effect_m": 0.3, "reading_m": 0.39}, ["CONTROL-READING"]),
        ([2.0] * 5, {"effect_m": 0.3, "reading_m": 0.41}, ["CONTROL-FAR"]),
        # One: five times as far as usual, among five.
        ([0.0, 0.1, -0.1, 0.1, 0.85], {"effect_m": 2.0}, ["CONTROL-OUTLIER"]),
        ([0.0, 0.1, -0.1, 0.1, 0.83], {"effect_m": 2.0}, []),
        ([0.0, 0.1, -0.1, 0.85], {"effect_m": 2.0}, []),
        ([0.0, 0.1, -0.1, 0.1, 0.85], {"effect_m": 2.0, "sigma_m": 0.2, "stated": True}, []),
        # The sigmas, if they are stated, hide the effect.
        ([0.0] * 5, {"effect_m": 0.3, "sigma_m": 0.31, "stated": True}, ["CONTROL-NOISE"]),
        ([0.0] * 5, {"effect_m": 0.3, "sigma_m": 0.29, "stated": True}, []),
        ([0.0] * 5, {"effect_m": 0.3, "sigma_m": 0.31}, []),
        # Squares of the misses grow by more than a quarter of that of the effect.
        ([0.63] * 5, {"effect_m": -1.0}, ["CONTROL-WORSE"]),
        ([0.62] * 5, {"effect_m": -1.0}, []),
    ],
)
def test_what_is_said_of_misses(after, named, codes):
    messages = judged(after, **named)
    assert [message.code for message in messages] == codes
    for message in messages:
        assert CAUSES.get(message.code, "") in message.what


def test_outliers_are_named():
    (finding,) = judged([0.0, 0.1, -0.1, 2.0, 0.1], 3.0)
    assert finding.kind is Kind.FINDING
    assert finding.count == 1
    assert re.findall(r"\bp\d\b", finding.what) == ["p3"]


# -- the wrong control --------------------------------------------------------------------------


def test_names_that_match_nothing(surveyed, table, unbend):
    survey(surveyed, table.assign(point="GCP" + table["point"]))
    text = surveyed.refusal("CONTROL-MISSING")
    assert "GCPp0" in text
    assert "control.columns.point" in text
    assert unbend("check", surveyed.file).code == 6


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda t: {"h_ellipsoid_m": t["h_msl_m"]},
            "above sea level read as heights above the ",
        ),
        (
            lambda t: {"h_ellipsoid_m": t["h_ellipsoid_m"] + UNDULATION_M},
            "above the ellipsoid read as heights above sea level",
        ),
        (lambda t: {"h_ellipsoid_m": t["h_ellipsoid_m"] / 0.3048}, "feet read as metres"),
        (lambda t: {"lat_deg": t["lon_deg"], "lon_deg": t["lat_deg"]}, "longitude exchanged"),
    ],
    ids=["msl", "twice", "feet", "exchanged"],
)
def test_another_reading_of_the_table_fits(surveyed, table, spoil, words):
    survey(surveyed, table.assign(**spoil(table)))
    entry = control_entry(surveyed, 3)
    assert entry["code"] == "CONTROL-READING"
    assert entry["kind"] == "finding"
    assert words in entry["what"]
    assert "control.reference" in entry["what"]


def test_exchanged_axes_of_a_grid_are_refused(surveyed):
    exchanged = GRID | {"x": "north", "y": "east"}
    surveyed.config["control"] = {
        "path": "control.csv",
        "columns": exchanged,
        "crs": "EPSG:25832",
        "reference": "msl",
    }
    assert "control.crs" in surveyed.refusal("CRS-AREA")


def test_stations_that_are_worse_known_than_refraction_is_large(surveyed):
    """Half a metre of noise in the heights of the stations, as stated: said, and no finding."""
    path = surveyed.folder / "block.csv"
    stations = pd.read_csv(path)
    noise = np.random.default_rng(4).normal(0.0, 0.5, len(stations))
    heights = stations["height"] + noise
    stations.assign(height=heights, sh=0.5, st=0.003).to_csv(path, index=False)
    surveyed.config["stations"]["orientation"]["columns"] |= {
        "sigma_height_m": "sh",
        "sigma_horizontal_m": "sh",
        "sigma_tilt": "st",
    }
    entry = control_entry(surveyed, 0)
    assert entry["code"] == "CONTROL-NOISE"
    assert entry["kind"] == "warning"
    control = surveyed.manifest()["control"]
    assert control["sigma_u_m"] > 0.4
    assert control["part_explained"] < 0.9


def test_control_in_single_images_cannot_be_intersected(surveyed, table):
    path = surveyed.folder / "observations.parquet"
    rows = pd.read_parquet(path)
    in_one_image = rows.drop_duplicates("point")
    in_one_image = in_one_image.assign(point="c" + in_one_image["point"].str[1:])
    pd.concat([rows, in_one_image]).to_parquet(path)
    survey(surveyed, table.assign(point="c" + table["point"].str[1:]))
    assert control_entry(surveyed, 3)["code"] == "CONTROL-RAYS"
    assert surveyed.manifest()["control"] is None


def test_a_system_needs_columns_and_a_reference(surveyed):
    surveyed.config["control"] = {"path": "control.csv", "crs": "EPSG:4326"}
    surveyed.refusal("together", 2)


def test_a_table_without_the_usual_columns_names_the_key(surveyed, table):
    survey(surveyed, table.rename(columns={"h_ellipsoid_m": "z"}))
    assert "control.columns.height" in surveyed.refusal("POINTS-COLUMN")
