"""The formats of `unbend export`, written from a small run that is made here by hand.

Two profiles, two cameras (one with fx and fy different), pixels counted from the centre of the
first, and a comma in the name of an image: whatever is taken from the wrong place comes out wrong.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.exports.export_runs import DOWN, finished_run, stations_at, write_export
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.refraction import refraction_angle
from unbend.refraction.camera.camera import Camera
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, ExportFormat, FinishedRun, Option
from unbend.tables.exports.export_frames import ExportFrame

NADIR = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)
SIDE = Camera(600, 400, 700.0, 500.0, 300.0, 200.0)
GROUND = 100.0
HEIGHT = np.array([3000.0, 3000.0, 3010.0, 6000.0, 3000.0])
PROFILES = (standard_atmosphere("us1976"), standard_atmosphere("ican", index="gyer"))
PROFILE_NUMBERS = np.array([0, 1, 1, 1, 0])
RADIUS = 6_371_000.0


@pytest.fixture(scope="module")
def run() -> FinishedRun:
    """Images a, b and c of the nadir camera, d of the side camera, e unusable."""
    images = ["a", 'b, "2".tif', "c", "d", "e"]
    cameras = ["nadir", "nadir", "nadir", "side", "nadir"]
    turns = np.tile(DOWN, (5, 1, 1))
    stations = stations_at(images, cameras, 0.0, np.degrees(0.8), HEIGHT, np.nan, turns)
    stations = replace(stations, time_ns=np.array([3, 1, 2, 4, 5]) * 10**9)
    run = finished_run(
        stations,
        turns,
        {"nadir": ExportCamera(NADIR, False), "side": ExportCamera(SIDE, True)},
        GROUND,
        air=ProfileSeries(tuple(TimedProfile(None, p) for p in PROFILES), PROFILE_NUMBERS),
        rays=tuple(rays_by(profile, "spherical") for profile in PROFILES),
    )
    usable = np.array(images) != "e"
    return replace(run, exposures=replace(run.exposures, usable=usable, radius_m=RADIUS))


def shift(focal: float, offset: float, profile, h_c: float) -> float:
    """Shift of a point on the x or y axis of a vertical image, `offset` px from its middle."""
    zeta = math.atan(abs(offset) / focal)
    r = refraction_angle(profile, h_c, GROUND, zeta, RADIUS)
    return math.copysign(1.0, offset) * focal * (math.tan(zeta - r) - math.tan(zeta))


def test_each_image_has_the_lattice_of_its_own_air_and_camera(run, tmp_path):
    written = write_export(run, "lattice", tmp_path, columns=3, rows=3)
    table = written.table()
    expected = {
        "a": (NADIR, PROFILES[0], 3000.0),
        'b, "2".tif': (NADIR, PROFILES[1], 3000.0),
        "c": (NADIR, PROFILES[1], 3010.0),
        "d": (SIDE, PROFILES[1], 6000.0),
    }
    assert table.image.tolist() == list(np.repeat(list(expected), 9))
    for image, (camera, profile, h_c) in expected.items():
        nodes = table[table.image == image]
        # Row by row from the upper left; pixels counted from the centre of the first.
        x = np.array([0.0, camera.cx_px, camera.width_px])
        y = np.array([0.0, camera.cy_px, camera.height_px])
        assert_array_equal(nodes.x_px, np.tile(x, 3) - 0.5)
        assert_array_equal(nodes.y_px, np.repeat(y, 3) - 0.5)
        top = nodes.iloc[1]
        left = nodes.iloc[3]
        assert top.dx_px == pytest.approx(0.0, abs=1e-9)
        top_shift = shift(camera.fy_px, -camera.cy_px, profile, h_c)
        assert top.dy_px == pytest.approx(top_shift, rel=1e-6)
        left_shift = shift(camera.fx_px, -camera.cx_px, profile, h_c)
        assert left.dx_px == pytest.approx(left_shift, rel=1e-6)
    assert (table.h_g_m == GROUND).all()
    assert (table.status == "ok").all()
    assert written.counts == [("loss", "EXPORT-LEFT-OUT", 1)]
    assert "lattice: e" in written.message("EXPORT-LEFT-OUT").what


def test_the_default_lattice_and_its_metadata(run, tmp_path):
    written = write_export(run, "lattice", tmp_path)
    assert written.count == 4 * 21 * 15
    metadata = pq.read_schema(written.path).metadata
    assert metadata[b"unbend.lattice"] == b"21 columns, 15 rows, row by row"
    assert metadata[b"unbend.mission"] == b"small"


@pytest.mark.parametrize("name", ["lattice", "radial"])
def test_csv_has_what_parquet_has(run, tmp_path, name):
    """Names with a comma too; numbers to their last bit, nothing for null."""
    as_parquet = write_export(run, name, tmp_path)
    as_csv = write_export(run, f"{name}-csv", tmp_path)
    assert list(as_parquet.ledger) == list(as_csv.ledger)
    pd.testing.assert_frame_equal(
        as_parquet.table(), as_csv.table(), check_dtype=False, check_exact=True
    )


def test_images_without_ground_have_a_lattice_without_corrections(run, tmp_path):
    ground = np.array([GROUND, np.nan, GROUND, np.nan, GROUND])
    blind = replace(run, find_ground=lambda _: ground)
    written = write_export(blind, "lattice", tmp_path, columns=2, rows=2)
    table = written.table()
    without = table[table.status == "no_ground"]
    assert set(without.image) == {'b, "2".tif', "d"}
    assert without.dx_px.isna().all()
    counts = {(code, count) for _, code, count in written.counts}
    assert counts == {("EXPORT-LEFT-OUT", 1), ("EXPORT-NO-GROUND", 2)}


def formula_of_the_manual(h_c_km: float, h_g_km: float) -> float:
    """K [microrad] by the Manual of Photogrammetry."""
    camera = 2410.0 * h_c_km / (h_c_km**2 - 6.0 * h_c_km + 250.0)
    ground = 2410.0 * h_g_km / (h_g_km**2 - 6.0 * h_g_km + 250.0)
    return camera - ground * h_g_km / h_c_km


def test_radial_tables_by_camera_and_height(run, tmp_path):
    """Images within 2 % of height share a table, of the air of the middle one by time."""
    written = write_export(run, "radial", tmp_path)
    table = written.table()
    assert table.camera.tolist() == ["nadir"] * 81 + ["side"] * 81
    assert table.nadir_angle_deg.tolist() == pytest.approx([*range(81)] * 2)
    for at_45, images, h_c, focal in (
        (table.iloc[45], 3, 3000.0, 900.0),
        (table.iloc[81 + 45], 1, 6000.0, 0.5 * (700.0 + 500.0)),
    ):
        assert at_45.images == images
        assert at_45.h_c_m == h_c
        assert at_45.h_g_m == GROUND
        assert at_45.radius_px == pytest.approx(focal)
        # In order of time the nadir images are b, c, a: the middle one, c, has the second profile.
        r = refraction_angle(PROFILES[1], h_c, GROUND, math.radians(45.0), RADIUS)
        assert at_45.r_c_urad == pytest.approx(r * 1e6, rel=1e-9)
        assert at_45.k_urad == pytest.approx(r * 1e6, rel=1e-9)
        assert at_45.k_manual_urad == pytest.approx(formula_of_the_manual(1e-3 * h_c, 0.1))
        assert at_45.r_c_arcsec == pytest.approx(math.degrees(r) * 3600.0, rel=1e-9)
        # f tan(45 - R) - f, by the rule of the tangent of a difference
        assert at_45.dr_px == pytest.approx(-2.0 * focal * math.tan(r) / (1 + math.tan(r)))
        assert at_45.shift_ground_m == pytest.approx(2.0 * (h_c - GROUND) * r, rel=3e-3)
    counts = [(code, count) for _, code, count in written.counts]
    assert counts == [("EXPORT-AIR-CHANGES", 2), ("EXPORT-WINDOW", 0)]
    assert "side" in written.message("EXPORT-WINDOW").what


def test_heights_apart_have_tables_of_their_own_the_lowest_first(run, tmp_path):
    """The middle of two images is the mean of their heights."""
    height = np.array([4000.0, 3000.0, 3010.0, 6000.0, 3000.0])
    exposures = replace(run.exposures, height_m=height)
    table = write_export(replace(run, exposures=exposures), "radial", tmp_path).table()
    assert table.h_c_m[:162:81].tolist() == [3005.0, 4000.0]
    assert table.images[:162:81].tolist() == [2, 1]


def test_the_radius_of_a_radial_table_is_the_mean_one_of_the_latitude(run, tmp_path):
    """At 45 degrees of azimuth: 2 / (1/M + 1/N), with M and N by hand for WGS84 at 0.8 rad."""
    on_ellipsoid = replace(run, exposures=replace(run.exposures, radius_m=None))
    table = write_export(on_ellipsoid, "radial", tmp_path).table()
    w2 = 1.0 - 0.00669437999014 * math.sin(0.8) ** 2
    m = 6378137.0 * (1.0 - 0.00669437999014) / w2**1.5
    n = 6378137.0 / math.sqrt(w2)
    radius = 2.0 / (1 / m + 1 / n)
    r = refraction_angle(PROFILES[1], 3000.0, GROUND, math.radians(80.0), radius)
    assert table.r_c_urad[80] == pytest.approx(r * 1e6, rel=1e-10)


def test_images_below_ground_are_in_no_radial_table(run, tmp_path):
    ground = np.array([GROUND, 3500.0, GROUND, np.nan, GROUND])
    written = write_export(replace(run, find_ground=lambda _: ground), "radial", tmp_path)
    table = written.table()
    assert (table.camera == "nadir").all()
    assert (table.images == 2).all()
    left_out = [(e.where, e.count) for e in written.ledger if e.code == "EXPORT-LEFT-OUT"]
    assert left_out == [("camera nadir", 1), ("camera side", 1)]


# -- options ------------------------------------------------------------------------------------


def test_values_are_given_or_by_default():
    lattice = FORMATS["lattice"]
    assert lattice.values({}) == {"columns": 21, "rows": 15}
    assert lattice.values({"rows": 2}) == {"columns": 21, "rows": 2}
    assert lattice.values({"columns": 2, "rows": 1000}) == {"columns": 2, "rows": 1000}


@pytest.mark.parametrize(
    ("name", "columns", "words"),
    [
        ("lattice", 1, "is not from 2 to 1000"),
        ("lattice", 1001, "is not from 2 to 1000"),
        ("lattice", math.nan, "is not from 2 to 1000"),
        ("radial", 5, "radial has no option --columns"),
    ],
)
def test_options_that_a_format_does_not_take(name, columns, words):
    with refused("EXPORT-OPTION") as refusal:
        FORMATS[name].values({"columns": columns})
    assert refusal.value.where == "--columns"
    assert words in str(refusal.value)


def test_limits_belong_to_the_range_and_units_to_the_remedy():
    option = Option("largest_angle", float, 80.0, "largest nadir angle", "deg", 1.0, 89.0)
    form = ExportFormat("x", "", ".csv", lambda *_: 0, lambda *_: ExportFrame(), options=(option,))
    assert form.values({"largest_angle": 89.0}) == {"largest_angle": 89.0}
    with refused("EXPORT-OPTION") as refusal:
        form.values({"largest_angle": 90.0})
    assert refusal.value.where == "--largest-angle"
    assert refusal.value.remedy == "largest nadir angle [deg]"


def test_the_command_line_shows_the_options_of_every_format(unbend):
    """Generated from the declarations: flag, help, default and limits."""
    ended = unbend("export", "--help")
    shown = " ".join(ended.out.split()).replace("- ", "-")  # lines also break at hyphens
    assert "geojson, kml stations and footprints" in shown
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
