"""Before and after on control points: the simulator's truth, and an intersection made here."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import pytest
import yaml

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
from unbend.simulate.flight import UNDULATION_M
from unbend.simulate.optics import height_and_up
from unbend.tables.manifest.whole import Manifest

EVERY = 7  # of the points is control


@pytest.fixture(scope="module")
def block() -> HeldBlock:
    return fly(6000.0, NADIR, seed=21)


def control_of(block: HeldBlock) -> pd.DataFrame:
    """The table of control points in every system that a test states."""
    height, up = height_and_up(block.place)
    lat = np.degrees(np.arcsin(up[:, 2]))
    lon = np.degrees(np.arctan2(up[:, 1], up[:, 0]))
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    east, north = to_grid.transform(lon, lat)
    return pd.DataFrame(
        {
            "point": block.point,
            "lat_deg": lat,
            "lon_deg": lon,
            "h_ellipsoid_m": height,
            "h_msl_m": height - UNDULATION_M,
            "east": east,
            "north": north,
        }
    )[::EVERY]


class Surveyed:
    """A mission of the block with a table of control points that a test may spoil."""

    def __init__(self, block: HeldBlock, folder: Path, unbend: Any) -> None:
        self.path, self.unbend = write_mission(block, folder), unbend
        self.config = yaml.safe_load(self.path.read_text(encoding="utf-8"))
        self.table = control_of(block)

    def state(self, table: pd.DataFrame | None = None, **stated: Any) -> None:
        table = self.table if table is None else table
        table.to_csv(self.path.parent / "control.csv", index=False)
        self.config["control"] = {"path": "control.csv", **stated} if stated else "control.csv"

    def run(self, word: str = "run") -> Any:
        self.path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        return self.unbend(word, self.path)

    def ran(self, exit_code: int = 0) -> dict:
        ended = self.run()
        assert ended.code == exit_code, ended.text
        text = (self.path.parent / "results" / "manifest.json").read_text(encoding="utf-8")
        return json.loads(text)

    def told(self, code: str) -> dict:
        """The finding of a run that ends with 3, and with it no other of control."""
        manifest = self.ran(3)
        of_control = [e for e in manifest["ledger"] if e["code"].startswith("CONTROL-")]
        assert [e["code"] for e in of_control] == [code], of_control
        return of_control[0]


@pytest.fixture
def surveyed(block, tmp_path, unbend):
    return Surveyed(block, tmp_path / "mission", unbend)


def tangents(pixels: np.ndarray) -> np.ndarray:
    """(n, 2) straight rays of pixels, the lens inverted by a fixed point of the test's own."""
    k1, k2, p1, p2, k3 = LENS
    given = (pixels - [CX, CY]) / FOCAL
    x, y = given.T
    for _ in range(30):
        r2 = x * x + y * y
        radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
        x, y = (
            given[:, 0] - x * radial - 2 * p1 * x * y - p2 * (r2 + 2 * x * x),
            given[:, 1] - y * radial - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y,
        )
    return np.stack([x, y], axis=1)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


def test_points_are_missed_by_what_the_independent_ray_says(surveyed, block):
    """Uncorrected 0.35 m too high, as the test's own intersection has it; corrected below 1 mm."""
    surveyed.state()
    manifest = surveyed.ran()
    control = manifest["control"]
    measured = block.rows[["x_px", "y_px"]].to_numpy()
    seen = block.point[np.unique(block.rows["point"])]
    error = pd.DataFrame(intersected(block, tangents(measured)), index=seen)
    wanted = error.loc[[p["point"] for p in control["points"]]].to_numpy()
    before = np.array([p["before_m"] for p in control["points"]])
    after = np.array([p["after_m"] for p in control["points"]])
    # The frame of the test is that of the middle of the block, 0.6 mrad from that of a point.
    np.testing.assert_allclose(before, wanted, atol=2e-3)
    assert before[:, 2].mean() == pytest.approx(0.35, abs=0.02)
    assert np.abs(after).max() < 1e-3
    assert control["used"] == len(control["points"]) > 20
    assert control["unmeasured"] == len(surveyed.table) - control["used"]
    np.testing.assert_allclose(control["rms_before_m"], rms(before), atol=1e-4)
    np.testing.assert_allclose(control["rms_refraction_m"], rms(before - after), atol=2e-4)
    np.testing.assert_allclose(control["mean_after_m"], after.mean(axis=0), atol=1e-4)
    assert control["part_explained"] > 0.999
    assert "control" in {item["role"] for item in manifest["inputs"]}
    rays = block.rows.groupby("point").size()
    assert [p["rays"] for p in control["points"]] == [
        rays[int(p["point"][1:])] for p in control["points"]
    ]


@pytest.mark.parametrize(
    "stated",
    [
        {
            "columns": {"x": "east", "y": "north", "height": "h_msl_m"},
            "crs": "EPSG:25832",
            "reference": "msl",
        },
        {
            "columns": {"x": "east", "y": "north", "height": "h_msl_m"},
            "crs": "EPSG:25832+5773",
            "reference": "msl",
        },
        {
            "columns": {"latitude": "lat_deg", "longitude": "lon_deg", "height": "h_ellipsoid_m"},
            "crs": "EPSG:4258",
            "reference": "ellipsoid",
        },
    ],
)
def test_every_system_says_the_same(surveyed, stated):
    surveyed.state(**stated)
    control = surveyed.ran()["control"]
    assert control["rms_before_m"][2] == pytest.approx(0.35, abs=0.02)
    assert max(control["rms_after_m"]) < 1e-3


def test_heights_that_were_computed_row_by_row_belong_to_the_rows(surveyed):
    """The control rows are few among all: intersected heights are looked up by their places."""
    surveyed.config["ground"] = {"height": "intersected"}
    surveyed.state()
    control = surveyed.ran()["control"]
    assert control["rms_before_m"][2] == pytest.approx(0.35, abs=0.02)
    assert max(control["rms_after_m"]) < 1e-3


def test_the_terminal_and_a_rehearsal_show_it(surveyed):
    surveyed.state()
    ended = surveyed.run("check")
    assert ended.code == 0
    assert "control" in ended.out
    rehearsed = " ".join(ended.out.split())
    assert "control points, intersected with fixed stations" in rehearsed
    ended = surveyed.run()
    printed = " ".join(ended.out.split())
    assert "27 control points: RMS distance 35 cm as measured, 0 mm corrected." in printed
    for words in (
        "RMS of east/north/up",
        "100.0 % of their mean square residual",
        "p14",
        "rms of",
        "more: manifest.json",
        "dU corr.",
    ):
        assert words in printed, printed
    line = next(line for line in ended.out.splitlines() if "rms of" in line)
    assert float(line.split()[5]) == pytest.approx(0.35, abs=0.02)


def test_the_report_has_each_point(block, tmp_path, unbend, whole_report):
    from unbend.report.summary import CONTROL_HEAD, control_rows, control_sentence

    surveyed = Surveyed(block, tmp_path, unbend)
    surveyed.state()
    manifest = surveyed.ran()
    page = (tmp_path / "results" / "report.html").read_text(encoding="utf-8")
    assert "<h2>Control points</h2>" in page
    page = re.sub(r"<td [^>]*>", "<td>", page)
    for point in manifest["control"]["points"]:
        cells = [f"{v:+.3f}" for v in (*point["before_m"], *point["after_m"])]
        assert f"<td>{point['point']}</td>" in page
        assert "".join(f"<td>{cell}</td>" for cell in cells) in page
    rows = control_rows(Manifest(manifest), 200)
    assert {len(row) for row in rows} == {len(CONTROL_HEAD)}
    assert [row[0] for row in rows[:-2]] == [p["point"] for p in manifest["control"]["points"]]
    assert float(rows[0][4]) == pytest.approx(
        manifest["control"]["points"][0]["before_m"][2], abs=1e-3
    )
    without = Manifest(manifest | {"control": None})
    assert control_sentence(without) == ""
    assert control_rows(without, 9) == []


# -- the wrong control --------------------------------------------------------------------------


def test_names_that_match_nothing(surveyed):
    surveyed.state(surveyed.table.assign(point="GCP" + surveyed.table["point"]))
    ended = surveyed.run()
    assert (ended.code, "CONTROL-MISSING" in ended.err) == (6, True)
    assert "GCPp0" in ended.err
    assert "control.columns.point" in ended.err
    assert surveyed.run("check").code == 6


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda t: t.assign(h_ellipsoid_m=t["h_msl_m"]),
            "above sea level read as heights above the ",
        ),
        (
            lambda t: t.assign(h_ellipsoid_m=t["h_ellipsoid_m"] + UNDULATION_M),
            "above the ellipsoid read as heights above sea level",
        ),
        (lambda t: t.assign(h_ellipsoid_m=t["h_ellipsoid_m"] / 0.3048), "feet read as metres"),
        (lambda t: t.assign(lat_deg=t["lon_deg"], lon_deg=t["lat_deg"]), "longitude exchanged"),
    ],
    ids=["msl", "twice", "feet", "exchanged"],
)
def test_another_reading_of_the_table_fits(surveyed, spoil, words):
    surveyed.state(spoil(surveyed.table))
    entry = surveyed.told("CONTROL-READING")
    assert entry["kind"] == "finding"
    assert words in entry["what"]
    assert "control.reference" in entry["what"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda t: t.assign(lat_deg=t["lat_deg"] + 0.01),
        lambda t: t.assign(point=np.roll(t["point"], 1)),
    ],
    ids=["elsewhere", "names"],
)
def test_control_that_fits_in_no_reading(surveyed, spoil):
    surveyed.state(spoil(surveyed.table))
    assert "wrong names of points" in surveyed.told("CONTROL-FAR")["what"]


def test_exchanged_axes_of_a_grid_are_refused(surveyed):
    surveyed.state(
        columns={"x": "north", "y": "east", "height": "h_msl_m"}, crs="EPSG:25832", reference="msl"
    )
    ended = surveyed.run()
    assert (ended.code, "CRS-AREA" in ended.err, "control.crs" in ended.err) == (6, True, True)


def test_a_single_wrong_point_is_named(surveyed):
    table = surveyed.table.copy()
    table.loc[table.index[4], "h_ellipsoid_m"] += 2.0
    surveyed.state(table)
    assert table["point"].iloc[4] in surveyed.told("CONTROL-OUTLIER")["what"]
    surveyed.config["accept"] = [{"code": "CONTROL-OUTLIER", "reason": "a marker that was moved"}]
    assert surveyed.ran()["control"]["rms_after_m"][2] > 0.2


def test_observations_that_were_corrected_before_are_moved_away_from_control(surveyed):
    """Their mark is lost, or the calibration was made on images with refraction in."""
    surveyed.state()
    surveyed.ran()
    folder = surveyed.path.parent
    table = pd.read_parquet(folder / "results" / "observations")
    table = table[["image", "point", "h_g_m"]].assign(
        x_px=table["x_corrected_px"], y_px=table["y_corrected_px"]
    )
    table.to_parquet(folder / "observations.parquet")
    shutil.rmtree(folder / "results")
    entry = surveyed.told("CONTROL-WORSE")
    assert "observations.refraction" in entry["what"]


def test_stations_that_are_worse_known_than_refraction_is_large(surveyed, block):
    """Half a metre of noise in the heights of the stations, as stated: said, and no finding."""
    path = surveyed.path.parent / "block.csv"
    table = pd.read_csv(path)
    rng = np.random.default_rng(4)
    table["height"] += rng.normal(0.0, 0.5, len(table))
    table = table.assign(sh=0.5, st=0.003)
    table.to_csv(path, index=False)
    surveyed.config["stations"]["orientation"]["columns"] |= {
        "sigma_height_m": "sh",
        "sigma_horizontal_m": "sh",
        "sigma_tilt": "st",
    }
    surveyed.state()
    manifest = surveyed.ran()
    codes = {e["code"]: e for e in manifest["ledger"] if e["code"].startswith("CONTROL-")}
    assert set(codes) == {"CONTROL-NOISE"}
    assert codes["CONTROL-NOISE"]["kind"] == "warning"
    assert manifest["control"]["sigma_u_m"] > 0.4
    assert manifest["control"]["part_explained"] < 0.9


def test_control_in_single_images_cannot_be_intersected(surveyed, block):
    rows = block.rows.drop_duplicates("point")
    few = rows.assign(image=block.image[rows["image"]], point="c" + rows["point"].astype(str))
    all_rows = block.rows.assign(
        image=block.image[block.rows["image"]], point=block.point[block.rows["point"]]
    )
    both = pd.concat([all_rows, few])
    both.to_parquet(surveyed.path.parent / "observations.parquet")
    table = control_of(block)
    surveyed.state(table.assign(point="c" + table["point"].str[1:]))
    assert "3 deg" in surveyed.told("CONTROL-RAYS")["what"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"control": {"path": "control.csv", "crs": "EPSG:4326"}}, "together"),
        ({"control": "control.csv", "refraction": {"direction": "apply"}}, "leave it out"),
        ({"control": {"path": "control.csv", "clumns": {}}}, "clumns"),
    ],
)
def test_what_the_mission_file_may_not_say(surveyed, change, words):
    surveyed.state()
    surveyed.config |= change
    ended = surveyed.run()
    assert (ended.code, words in ended.err) == (2, True), ended.text


def test_a_table_without_the_usual_columns_names_the_key(surveyed):
    surveyed.state(surveyed.table.rename(columns={"h_ellipsoid_m": "z"}))
    ended = surveyed.run()
    assert (ended.code, "POINTS-COLUMN" in ended.err) == (6, True)
    assert "control.columns.height" in ended.err
