"""Before and after on control points: the simulator's truth, and an intersection made here."""

import re

import numpy as np
import pandas as pd
import pyproj
import pytest
import yaml
from numpy.testing import assert_allclose

from tests.conftest import MissionFolder
from tests.golden.held_block import (
    CX,
    CY,
    FOCAL,
    NADIR,
    distorted,
    fly,
    intersected,
    write_mission,
)
from tests.helpers import codes_of, entry_of, one_line
from tests.report.manifests import manifest_of
from unbend.messages import Kind, Ledger
from unbend.report.summary import control_rows, control_sentence
from unbend.simulate.flight import UNDULATION_M
from unbend.simulate.optics import height_and_up
from unbend.stages.multi_image.control import ControlComparison, judge_control
from unbend.tables.manifest.whole import Manifest

EVERY = 7  # of the points is control


@pytest.fixture(scope="module")
def block():
    return fly(6000.0, NADIR, seed=21)


@pytest.fixture(scope="module")
def table(block):
    """The table of control points in every system that a test states."""
    height, up = height_and_up(block.place)
    x, y, z = up.T
    lat = np.degrees(np.arcsin(z))
    lon = np.degrees(np.arctan2(y, x))
    east, north = pyproj.Proj("EPSG:25832")(lon, lat)
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
def surveyed(block, table, tmp_path):
    """A mission of the block with a table of control points that a test may spoil."""
    file = write_mission(block, tmp_path / "mission", control="control.csv")
    config = yaml.safe_load(file.read_text())
    mission = MissionFolder(file.parent, "no log", config)
    survey(mission, table)
    return mission


def survey(mission, table):
    """Write another table of control points."""
    table.to_csv(mission.folder / "control.csv", index=False)


def control_entry(mission, exit_code):
    """The only thing that a run says of control."""
    manifest = mission.run_to_manifest(exit_code)
    (code,) = [code for code in codes_of(manifest) if code.startswith("CONTROL-")]
    return entry_of(manifest, code)


def tangents(pixels):
    """(n, 2) straight rays of pixels, the lens inverted by a fixed point of the test's own."""
    straight = (pixels - [CX, CY]) / FOCAL
    for _ in range(30):
        straight += (pixels - distorted(straight)) / FOCAL
    return straight


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def test_points_are_missed_by_what_the_independent_ray_says(surveyed, block, table):
    """Uncorrected 0.35 m too high, as the test's own intersection has it; corrected below 1 mm."""
    measured = block.rows[["x_px", "y_px"]].to_numpy()
    rows_of_point = block.rows["point"].value_counts().sort_index()
    names = block.point[rows_of_point.index]
    rays = pd.Series(rows_of_point.to_numpy(), index=names)
    error = pd.DataFrame(intersected(block, tangents(measured)), index=names)

    manifest = surveyed.run_to_manifest()

    assert "control" in {entry["role"] for entry in manifest["inputs"]}
    control = manifest["control"]
    points = pd.DataFrame(control["points"])
    before = np.array(points["before_m"].tolist())
    after = np.array(points["after_m"].tolist())
    # The frame of the test is that of the middle of the block, 0.6 mrad from that of a point.
    assert_allclose(before, error.loc[points["point"]], atol=2e-3)
    assert before[:, 2].mean() == pytest.approx(0.35, abs=0.02)
    assert np.abs(after).max() < 1e-3
    assert control["used"] == len(points) > 20
    assert control["unmeasured"] == len(table) - len(points)
    assert points["rays"].tolist() == rays[points["point"]].tolist()
    # Nothing is known of the stations.
    assert points["sigma_u_m"].isna().all()
    assert control["sigma_u_m"] is None
    expected = {
        "rms_before_m": rms(before),
        "rms_after_m": rms(after),
        "rms_refraction_m": rms(before - after),
        "mean_before_m": before.mean(axis=0),
        "mean_after_m": after.mean(axis=0),
    }
    for name, values in expected.items():
        assert_allclose(control[name], values, atol=2e-4)
    assert control["part_explained"] > 0.999


GRID = {"x": "east", "y": "north", "height": "h_msl_m"}
PLACE = {"latitude": "lat_deg", "longitude": "lon_deg", "height": "h_ellipsoid_m"}


def refer_to(mission, columns, crs, reference):
    """State the system of the table of control points."""
    mission.config["control"] = {
        "path": "control.csv",
        "columns": columns,
        "crs": crs,
        "reference": reference,
    }


def assert_corrected(mission):
    control = mission.run_to_manifest()["control"]
    *_, up_m = control["rms_before_m"]
    assert up_m == pytest.approx(0.35, abs=0.02)
    assert max(control["rms_after_m"]) < 1e-3


@pytest.mark.parametrize(
    ("columns", "crs", "reference"),
    [
        (GRID, "EPSG:25832", "msl"),
        (GRID, "EPSG:25832+5773", "msl"),
        (PLACE, "EPSG:4258", "ellipsoid"),
    ],
    ids=["grid", "compound", "geographic"],
)
def test_every_system_says_the_same(surveyed, columns, crs, reference):
    refer_to(surveyed, columns, crs, reference)
    assert_corrected(surveyed)


def test_control_with_intersected_ground_heights(surveyed):
    """The control rows are few among all: intersected heights are looked up by their places."""
    surveyed.config["control"] = {"path": "control.csv"}
    surveyed.config["ground"] = {"height": "intersected"}
    assert_corrected(surveyed)


def test_the_terminal_and_a_rehearsal_show_it(surveyed, unbend):
    rehearsed = unbend("check", surveyed.save())
    assert rehearsed.code == 0
    text = one_line(rehearsed.out)
    assert "control points, intersected with fixed stations" in text

    text = one_line(surveyed.run().out)
    for words in (
        "27 control points: RMS distance 35 cm as measured, 0 mm corrected.",
        "RMS of east/north/up",
        "100.0 % of their mean square residual",
        "dU corr.",
        "p14",
        "more: manifest.json",
    ):
        assert words in text
    manifest = Manifest(surveyed.manifest())
    *_, rms_row = control_rows(manifest, 9)
    assert one_line(" ".join(rms_row)) in text


def test_the_report_has_each_point(surveyed, whole_report):
    manifest = Manifest(surveyed.run_to_manifest())
    page = (surveyed.output / "report.html").read_text("utf-8")
    assert "<h2>Control points</h2>" in page
    page = re.sub(r"<td [^>]*>", "<td>", page)
    *points, _, _ = control_rows(manifest, 200)
    for row in points:
        assert f"<td>{row[0]}</td>" in page
        cells = "</td><td>".join(row[2:8])
        assert f"<td>{cells}</td>" in page


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
    manifest = manifest_of({"control": control})
    rows = [one_line(" ".join(row)) for row in control_rows(manifest, 1)]
    assert rows == [
        "p1 3 +0.123 -0.200 +0.350 +0.001 -0.002 0.012",
        "(1 more: manifest.json)",
        "mean of 2 +0.100 +0.200 +0.300 +0.010 +0.020 +0.030",
        "rms of 2 +0.400 +0.500 +0.600 +0.040 +0.050 +0.060",
    ]


def test_nothing_is_said_without_control_points():
    manifest = manifest_of({})
    assert control_sentence(manifest) == ""
    assert control_rows(manifest, 9) == []


# -- what is judged, and from where on ----------------------------------------------------------


def judged(up_m, effect_m, *, sigma_m=0.0, sigma_stated=False, reading_m=np.nan):
    """What is said of points p0, p1 ... whose heights miss by so much after the correction."""
    count = len(up_m)
    after = np.zeros((count, 3))
    after[:, 2] = up_m
    before = after.copy()
    before[:, 2] += effect_m
    comparison = ControlComparison(
        name=tuple(f"p{k}" for k in range(count)),
        rays=np.full(count, 3),
        before=before,
        after=after,
        sigma_m=np.full(count, sigma_m),
        sigma_stated=sigma_stated,
        unmeasured=0,
    )
    readings = {"a reading": reading_m, "unknown": np.nan}
    ledger = Ledger()
    judge_control(comparison, readings, ledger)
    return list(ledger)


CAUSES = {
    "CONTROL-WORSE": "observations.refraction",
    "CONTROL-FAR": "wrong names of points",
}


SCATTER_M = [0.0, 0.1, -0.1, 0.1]
USUAL = [*SCATTER_M, 0.85]


@pytest.mark.parametrize(
    ("up_m", "effect_m", "beside", "codes"),
    [
        # All miss: farther than 1 m, and three times the effect.
        ([0.99] * 5, -0.3, {}, ["CONTROL-WORSE"]),
        ([1.01] * 5, -0.3, {}, ["CONTROL-FAR"]),
        ([1.01] * 5, 0.34, {}, []),
        # Squares of the misses grow by more than a quarter of that of the effect.
        ([0.63] * 5, -1.0, {}, ["CONTROL-WORSE"]),
        ([0.62] * 5, -1.0, {}, []),
        # Less than five sigmas.
        ([1.01] * 5, 0.3, {"sigma_m": 0.21}, []),
        # Another reading leaves less than a fifth, or more.
        ([2.0] * 5, 0.3, {"reading_m": 0.39}, ["CONTROL-READING"]),
        ([2.0] * 5, 0.3, {"reading_m": 0.41}, ["CONTROL-FAR"]),
        # One of five is five times as far as usual, within its stated sigma or not; one of four.
        (USUAL, 2.0, {}, ["CONTROL-OUTLIER"]),
        ([*SCATTER_M, 0.83], 2.0, {}, []),
        (USUAL, 2.0, {"sigma_m": 0.2, "sigma_stated": True}, []),
        (USUAL[1:], 2.0, {}, []),
        # Sigmas that are stated hide the effect.
        ([0.0] * 5, 0.3, {"sigma_m": 0.31, "sigma_stated": True}, ["CONTROL-NOISE"]),
        ([0.0] * 5, 0.3, {"sigma_m": 0.29, "sigma_stated": True}, []),
        ([0.0] * 5, 0.3, {"sigma_m": 0.31}, []),
    ],
)
def test_what_is_said_of_misses(up_m, effect_m, beside, codes):
    messages = judged(up_m, effect_m, **beside)
    assert [message.code for message in messages] == codes
    for message in messages:
        assert CAUSES.get(message.code, "") in message.what


def test_outliers_are_named():
    up_m = [0.0, 0.1, -0.1, 2.0, 0.1]
    (finding,) = judged(up_m, 3.0)
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
    ("changes", "words"),
    [
        ("h_ellipsoid_m = h_msl_m", "above sea level read as heights above the "),
        (
            f"h_ellipsoid_m = h_ellipsoid_m + {UNDULATION_M}",
            "above the ellipsoid read as heights above sea level",
        ),
        ("h_ellipsoid_m = h_ellipsoid_m / 0.3048", "feet read as metres"),
        ("old = lat_deg\nlat_deg = lon_deg\nlon_deg = old", "longitude exchanged"),
    ],
    ids=["msl", "twice", "feet", "exchanged"],
)
def test_another_reading_of_the_table_fits(surveyed, table, changes, words):
    survey(surveyed, table.eval(changes))
    entry = control_entry(surveyed, 3)
    assert entry["code"] == "CONTROL-READING"
    assert entry["kind"] == "finding"
    assert words in entry["what"]
    assert "control.reference" in entry["what"]


def test_exchanged_axes_of_a_grid_are_refused(surveyed):
    exchanged = GRID | {"x": "north", "y": "east"}
    refer_to(surveyed, exchanged, "EPSG:25832", "msl")
    assert "control.crs" in surveyed.refusal("CRS-AREA")


def test_stations_that_are_worse_known_than_refraction_is_large(surveyed):
    """Half a metre of noise in the heights of the stations, as stated: said, and no finding."""
    path = surveyed.folder / "block.csv"
    stations = pd.read_csv(path)
    noise_m = np.random.default_rng(4).normal(0.0, 0.5, len(stations))
    stations["height"] += noise_m
    stations["sh"] = 0.5
    stations["st"] = 0.003
    stations.to_csv(path, index=False)
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
    in_one_image = rows.drop_duplicates("point").copy()
    in_one_image["point"] = "c" + in_one_image["point"]
    pd.concat([rows, in_one_image]).to_parquet(path)
    survey(surveyed, table.assign(point="c" + table["point"]))
    assert control_entry(surveyed, 3)["code"] == "CONTROL-RAYS"
    assert surveyed.manifest()["control"] is None


def test_a_table_without_the_usual_columns_names_the_key(surveyed, table):
    survey(surveyed, table.rename(columns={"h_ellipsoid_m": "z"}))
    assert "control.columns.height" in surveyed.refusal("POINTS-COLUMN")
