"""The formats of `unbend export`, written from a small run that is made here by hand.

Two profiles, two cameras (one with fx and fy different), pixels counted from the centre of the
first, and a comma in the name of an image: whatever is taken from the wrong place comes out wrong.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.errors import ConfigError
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction import refraction_angle
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, ExportFormat, FinishedRun, Option
from unbend.tables.exports.export_frames import ExportFrame
from unbend.tables.pixels import PixelSystem

NADIR = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)
SIDE = Camera(600, 400, 700.0, 500.0, 300.0, 200.0)
GROUND = 100.0
HEIGHT = np.array([3000.0, 3000.0, 3010.0, 6000.0, 3000.0])
PROFILES = (standard_atmosphere("us1976"), standard_atmosphere("ican", index="gyer"))
RADIUS = 6_371_000.0


@pytest.fixture(scope="module")
def run() -> FinishedRun:
    """Images a to e: a, "b, 2.tif" and c of the nadir camera, d of the side camera, e unusable."""
    images = np.array(["a", "b, 2.tif", "c", "d", "e"], object)
    cameras = np.array(["nadir", "nadir", "nadir", "side", "nadir"], object)
    down = np.diag([1.0, -1.0, -1.0])  # camera x east, y south, z down
    usable = np.array([True, True, True, True, False])
    stations = replace(
        empty_stations(images, cameras, "ok"),
        time_ns=np.array([3, 1, 2, 4, 5]) * 10**9,
        lat_rad=np.full(5, 0.8),
        h_msl_m=HEIGHT,
    )
    number = np.array([0, 1, 1, 1, 0])
    outside = np.array(
        [float(PROFILES[k].refractivity(h)) for k, h in zip(number, HEIGHT, strict=True)]
    )
    return FinishedRun(
        mission="small",
        stations=stations,
        exposures=Exposures(
            usable,
            np.tile(down, (5, 1, 1)),
            np.full(5, 0.8),
            HEIGHT,
            outside,
            outside,
            radius_m=RADIUS,
        ),
        air=ProfileSeries(tuple(TimedProfile(None, p) for p in PROFILES), number),
        rays=tuple(rays_by(profile, "spherical") for profile in PROFILES),
        method="spherical",
        cameras={"nadir": ExportCamera(NADIR, False), "side": ExportCamera(SIDE, True)},
        find_ground=lambda _: np.full(5, GROUND),
        pixels=PixelSystem("centre"),
        parts=(),
        metadata={"unbend.mission": "small"},
    )


def written(run, name, folder, **values):
    """The rows of a format as dictionaries, its number of rows, and the ledger."""
    form = FORMATS[name]
    ledger = Ledger()
    path = folder / f"out{form.ending}"
    count = form.write(run, form.values(values), path, ledger)
    if form.ending == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    else:
        rows = pq.read_table(path).to_pylist()
    assert count == len(rows)
    return rows, ledger


def shift(camera: Camera, focal: float, offset: float, profile, h_c: float) -> float:
    """Shift of a point on the x or y axis of a vertical image, `offset` px from its middle."""
    zeta = math.atan(abs(offset) / focal)
    r = refraction_angle(profile, h_c, GROUND, zeta, RADIUS)
    return math.copysign(1.0, offset) * focal * (math.tan(zeta - r) - math.tan(zeta))


def test_each_image_has_the_lattice_of_its_own_air_and_camera(run, tmp_path):
    rows, ledger = written(run, "lattice", tmp_path, columns=3, rows=3)
    assert len(rows) == 4 * 9
    assert [row["image"] for row in rows[::9]] == ["a", "b, 2.tif", "c", "d"]
    for image, (camera, profile, h_c) in {
        "a": (NADIR, PROFILES[0], 3000.0),
        "b, 2.tif": (NADIR, PROFILES[1], 3000.0),
        "c": (NADIR, PROFILES[1], 3010.0),
        "d": (SIDE, PROFILES[1], 6000.0),
    }.items():
        nodes = [row for row in rows if row["image"] == image]
        # Row by row from the upper left; pixels counted from the centre of the first.
        assert [(n["x_px"], n["y_px"]) for n in nodes[:4]] == [
            (-0.5, -0.5),
            (camera.cx_px - 0.5, -0.5),
            (camera.width_px - 0.5, -0.5),
            (-0.5, camera.cy_px - 0.5),
        ]
        top = nodes[1]
        left = nodes[3]
        assert top["dx_px"] == pytest.approx(0.0, abs=1e-9)
        assert top["dy_px"] == pytest.approx(
            shift(camera, camera.fy_px, -camera.cy_px, profile, h_c), rel=1e-6
        )
        assert left["dx_px"] == pytest.approx(
            shift(camera, camera.fx_px, -camera.cx_px, profile, h_c), rel=1e-6
        )
        assert {(n["h_g_m"], n["status"]) for n in nodes} == {(GROUND, "ok")}
    assert [(e.code, e.count, e.kind) for e in ledger] == [("EXPORT-LEFT-OUT", 1, "loss")]
    assert "lattice: e" in next(iter(ledger)).what


def test_the_default_lattice_and_its_metadata(run, tmp_path):
    rows, _ = written(run, "lattice", tmp_path)
    assert len(rows) == 4 * 21 * 15
    metadata = pq.read_schema(tmp_path / "out.parquet").metadata
    assert metadata[b"unbend.lattice"] == b"21 columns, 15 rows, row by row"
    assert metadata[b"unbend.mission"] == b"small"


@pytest.mark.parametrize("name", ["lattice", "radial"])
def test_csv_has_what_parquet_has(run, tmp_path, name):
    """Names with a comma too; numbers to their last bit, nothing for null."""
    as_parquet, ledger = written(run, name, tmp_path)
    as_csv, ledger_of_csv = written(run, f"{name}-csv", tmp_path)
    assert list(ledger) == list(ledger_of_csv)
    for row, text in zip(as_parquet, as_csv, strict=True):
        assert row.keys() == text.keys()
        for column, value in row.items():
            read = type(value)(text[column]) if value is not None else text[column] or None
            assert read == value


def test_images_without_ground_have_a_lattice_without_corrections(run, tmp_path):
    blind = replace(run, find_ground=lambda _: np.array([GROUND, np.nan, GROUND, np.nan, GROUND]))
    rows, ledger = written(blind, "lattice", tmp_path, columns=2, rows=2)
    empty = {row["image"] for row in rows if row["dx_px"] is None and row["status"] == "no_ground"}
    assert empty == {"b, 2.tif", "d"}
    assert {(e.code, e.count) for e in ledger} == {("EXPORT-LEFT-OUT", 1), ("EXPORT-NO-GROUND", 2)}


def test_radial_tables_by_camera_and_height(run, tmp_path):
    """Images within 2 % of height share a table, of the air of the middle one by time."""
    rows, ledger = written(run, "radial", tmp_path)
    assert len(rows) == 2 * 81
    for table, (camera, images, h_c, focal) in zip(
        (rows[:81], rows[81:]),
        (("nadir", 3, 3000.0, 900.0), ("side", 1, 6000.0, 0.5 * (700.0 + 500.0))),
        strict=True,
    ):
        at_45 = table[45]
        assert (at_45["camera"], at_45["images"]) == (camera, images)
        assert (at_45["h_c_m"], at_45["h_g_m"]) == (h_c, GROUND)
        assert at_45["nadir_angle_deg"] == pytest.approx(45.0)
        assert at_45["radius_px"] == pytest.approx(focal)
        # In order of time the nadir images are b, c, a: the middle one, c, has the second profile.
        r = refraction_angle(PROFILES[1], h_c, GROUND, math.radians(45.0), RADIUS)
        assert at_45["r_c_urad"] == pytest.approx(r * 1e6, rel=1e-9)
        assert at_45["k_urad"] == pytest.approx(r * 1e6, rel=1e-9)
        assert at_45["r_c_arcsec"] == pytest.approx(math.degrees(r) * 3600.0, rel=1e-9)
        # f tan(45 - R) - f, by the rule of the tangent of a difference
        assert at_45["dr_px"] == pytest.approx(-2.0 * focal * math.tan(r) / (1 + math.tan(r)))
        assert at_45["shift_ground_m"] == pytest.approx(2.0 * (h_c - GROUND) * r, rel=3e-3)
    assert [(e.code, e.count) for e in ledger] == [("EXPORT-AIR-CHANGES", 2), ("EXPORT-WINDOW", 0)]
    assert "side" in list(ledger)[1].what


def test_heights_apart_have_tables_of_their_own_the_lowest_first(run, tmp_path):
    high = replace(run.exposures, height_m=np.array([4000.0, 3000.0, 3010.0, 6000.0, 3000.0]))
    rows, _ = written(replace(run, exposures=high), "radial", tmp_path)
    assert [(r["h_c_m"], r["images"]) for r in rows[:162:81]] == [(3005.0, 2), (4000.0, 1)]


def test_the_radius_of_a_radial_table_is_the_mean_one_of_the_latitude(run, tmp_path):
    """At 45 degrees of azimuth: 2 / (1/M + 1/N), with M and N by hand for WGS84 at 0.8 rad."""
    own = replace(run, exposures=replace(run.exposures, radius_m=None))
    rows, _ = written(own, "radial", tmp_path)
    w2 = 1.0 - 0.00669437999014 * math.sin(0.8) ** 2
    m = 6378137.0 * (1.0 - 0.00669437999014) / w2**1.5
    n = 6378137.0 / math.sqrt(w2)
    r = refraction_angle(PROFILES[1], 3000.0, GROUND, math.radians(80.0), 2.0 / (1 / m + 1 / n))
    assert rows[80]["r_c_urad"] == pytest.approx(r * 1e6, rel=1e-10)
    assert abs(rows[80]["r_c_urad"] / (r * 1e6) - 1.0) < abs(
        refraction_angle(PROFILES[1], 3000.0, GROUND, math.radians(80.0), m) / r - 1.0
    )


def test_images_below_ground_are_in_no_radial_table(run, tmp_path):
    low = replace(run, find_ground=lambda _: np.array([GROUND, 3500.0, GROUND, np.nan, GROUND]))
    rows, ledger = written(low, "radial", tmp_path)
    assert {(row["camera"], row["images"]) for row in rows} == {("nadir", 2)}
    left_out = [(e.where, e.count) for e in ledger if e.code == "EXPORT-LEFT-OUT"]
    assert left_out == [("camera nadir", 1), ("camera side", 1)]


# -- options ------------------------------------------------------------------------------------


def test_values_are_given_or_by_default():
    lattice = FORMATS["lattice"]
    assert lattice.values({}) == {"columns": 21, "rows": 15}
    assert lattice.values({"rows": 2}) == {"columns": 21, "rows": 2}


@pytest.mark.parametrize("value", [1, 1001, math.nan])
def test_a_value_beyond_its_limits(value):
    with pytest.raises(ConfigError, match="is not from 2 to 1000") as refusal:
        FORMATS["lattice"].values({"columns": value})
    assert (refusal.value.code, refusal.value.where) == ("EXPORT-OPTION", "--columns")


def test_an_option_of_another_format():
    with pytest.raises(ConfigError, match="radial has no option --columns") as refusal:
        FORMATS["radial"].values({"columns": 5})
    assert refusal.value.code == "EXPORT-OPTION"


def test_limits_belong_to_the_range_and_units_to_the_remedy():
    option = Option("largest_angle", float, 80.0, "largest nadir angle", "deg", 1.0, 89.0)
    form = ExportFormat("x", "", ".csv", lambda *_: 0, lambda *_: ExportFrame(), options=(option,))
    assert form.values({"largest_angle": 89.0}) == {"largest_angle": 89.0}
    with pytest.raises(ConfigError) as refusal:
        form.values({"largest_angle": 90.0})
    assert refusal.value.where == "--largest-angle"
    assert refusal.value.remedy == "largest nadir angle [deg]"


def test_the_command_line_shows_the_options_of_every_format(unbend):
    """Generated from the declarations: flag, help, default and limits."""
    ended = unbend("export", "--help")
    shown = " ".join(ended.out.split()).replace("- ", "-")  # lines also break at hyphens
    for form in FORMATS.values():
        assert form.contents in shown
        assert form.name in shown
        for option in form.options:
            assert option.flag in shown
            assert f"{option.help}, by default {option.default}" in shown
            assert f"[{option.minimum}<=x<={option.maximum}]" in shown


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--format", "radial", "--rows", 3), "EXPORT-OPTION"),
        (("--format", "lattice", "--rows", 1), "--rows"),
        (("--format", "lattice", "--rows", "many"), "--rows"),
        ((), "--format"),
    ],
)
def test_the_command_line_refuses(unbend, tmp_path, options, words):
    ended = unbend("export", tmp_path, "--out", tmp_path / "out.parquet", *options)
    assert ended.code == 2
    assert words in ended.err
