"""The formats of `unbend export`, written from a small run that is made here by hand.

Two profiles, two cameras (one with fx and fy different), pixels counted from the centre of the
first, and a comma in the name of an image: whatever is taken from the wrong place comes out wrong.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import one_line, refused, with_code
from tests.tables.exports.export_runs import DOWN, finished_run, stations_at, write_export
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.refraction import refraction_angle
from unbend.refraction.camera.camera import Camera
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, ExportFormat, Option
from unbend.tables.exports.export_frames import ExportFrame

NADIR = Camera(
    width_px=1000,
    height_px=800,
    fx_px=900.0,
    fy_px=900.0,
    cx_px=500.0,
    cy_px=400.0,
)
SIDE = Camera(
    width_px=600,
    height_px=400,
    fx_px=700.0,
    fy_px=500.0,
    cx_px=300.0,
    cy_px=200.0,
)
CAMERAS = {
    "nadir": ExportCamera(NADIR, False),
    "side": ExportCamera(SIDE, True),
}
US = standard_atmosphere("us1976")
ICAN = standard_atmosphere("ican", index="gyer")
GROUND = 100.0
RADIUS = 6_371_000.0
STATIONS = pd.DataFrame(
    [
        ("a", "nadir", 3000.0, 3, 0),
        ('b, "2".tif', "nadir", 3000.0, 1, 1),
        ("c", "nadir", 3010.0, 2, 1),
        ("d", "side", 6000.0, 4, 1),
        ("e", "nadir", 3000.0, 5, 0),
    ],
    columns=["image", "camera", "h_m", "time_s", "profile"],
)


@pytest.fixture(scope="module")
def run():
    """Images a, b and c of the nadir camera, d of the side camera, e unusable."""
    turns = np.tile(DOWN, (5, 1, 1))
    stations = stations_at(
        STATIONS.image,
        STATIONS.camera,
        0.0,
        np.degrees(0.8),
        STATIONS.h_m,
        np.nan,
        turns,
        time_ns=STATIONS.time_s.to_numpy() * 10**9,
    )
    profiles = (TimedProfile(None, US), TimedProfile(None, ICAN))
    run = finished_run(
        stations,
        turns,
        CAMERAS,
        GROUND,
        air=ProfileSeries(profiles, STATIONS.profile.to_numpy()),
        rays=(
            rays_by(US, "spherical"),
            rays_by(ICAN, "spherical"),
        ),
    )
    usable = STATIONS.image.to_numpy() != "e"
    exposures = replace(run.exposures, usable=usable, radius_m=RADIUS)
    return replace(run, exposures=exposures)


def refraction(profile, h_c_m, zeta, radius_m=RADIUS):
    return refraction_angle(profile, h_c_m, GROUND, zeta, radius_m)


def shift(focal_px, offset_px, profile, h_c_m):
    """Of a point on the x or y axis of a vertical image, left of or above its middle."""
    zeta = math.atan(offset_px / focal_px)
    r = refraction(profile, h_c_m, zeta)
    return focal_px * (math.tan(zeta) - math.tan(zeta - r))


@pytest.fixture
def lattice(run):
    """Three nodes by three of each usable image."""
    written = write_export(run, "lattice", columns=3, rows=3)
    assert written.counts == [("loss", "EXPORT-LEFT-OUT", 1)]
    assert "lattice: e" in written.message("EXPORT-LEFT-OUT").what
    return written.table()


@pytest.mark.parametrize(
    ("image", "camera", "profile", "h_c_m"),
    [
        ("a", NADIR, US, 3000.0),
        ('b, "2".tif', NADIR, ICAN, 3000.0),
        ("c", NADIR, ICAN, 3010.0),
        ("d", SIDE, ICAN, 6000.0),
    ],
)
def test_each_image_has_the_lattice_of_its_own_air_and_camera(
    lattice, image, camera, profile, h_c_m
):
    nodes = lattice[lattice.image == image]
    # Row by row from the upper left; pixels counted from the centre of the first.
    x_px = [0.0, camera.cx_px, camera.width_px]
    y_px = [0.0, camera.cy_px, camera.height_px]
    assert_array_equal(nodes.x_px + 0.5, np.tile(x_px, 3))
    assert_array_equal(nodes.y_px + 0.5, np.repeat(y_px, 3))
    top = nodes.iloc[1]
    left = nodes.iloc[3]
    top_shift = shift(camera.fy_px, camera.cy_px, profile, h_c_m)
    left_shift = shift(camera.fx_px, camera.cx_px, profile, h_c_m)
    assert top.dx_px == pytest.approx(0.0, abs=1e-9)
    assert top.dy_px == pytest.approx(top_shift, rel=1e-6)
    assert left.dx_px == pytest.approx(left_shift, rel=1e-6)


def test_a_lattice_has_all_usable_images(lattice):
    assert_array_equal(lattice.image, STATIONS.image[:4].repeat(9))
    assert (lattice.h_g_m == GROUND).all()
    assert (lattice.status == "ok").all()


def test_the_default_lattice_and_its_metadata(run):
    written = write_export(run, "lattice")

    assert written.count == 4 * 21 * 15
    schema = pq.read_schema(written.path)
    assert schema.names == ["image", "x_px", "y_px", "dx_px", "dy_px", "h_g_m", "status"]
    assert schema.field("dx_px").metadata[b"unit"] == b"px"
    assert schema.metadata[b"unbend.lattice"] == b"21 columns, 15 rows, row by row"
    assert schema.metadata[b"unbend.mission"] == b"small"


@pytest.mark.parametrize("name", ["lattice", "radial"])
def test_csv_has_what_parquet_has(run, name):
    """Names with a comma and quotes too; numbers to their last bit, nothing for null."""
    ground = np.array([GROUND, GROUND, np.nan, GROUND, GROUND])
    one_is_blind = replace(run, find_ground=lambda _: ground)
    as_parquet = write_export(one_is_blind, name)
    as_csv = write_export(one_is_blind, f"{name}-csv")

    assert [*as_parquet.ledger] == [*as_csv.ledger]
    assert "nan" not in as_csv.path.read_text().lower()
    pd.testing.assert_frame_equal(
        as_parquet.table(),
        as_csv.table(),
        check_dtype=False,
        check_exact=True,
    )


def test_images_without_ground_have_a_lattice_without_corrections(run):
    ground = np.full(5, GROUND)
    ground[[1, 3]] = np.nan
    blind = replace(run, find_ground=lambda _: ground)

    written = write_export(blind, "lattice", columns=2, rows=2)

    table = written.table()
    without = table[table.status == "no_ground"]
    assert set(without.image) == {'b, "2".tif', "d"}
    assert without.dx_px.isna().all()
    assert len(written.ledger) == 2
    assert written.message("EXPORT-LEFT-OUT").count == 1
    assert written.message("EXPORT-NO-GROUND").count == 2


def effect_by_the_manual(h_km):
    """[microrad] of a height, by the Manual of Photogrammetry."""
    return 2410.0 * h_km / (h_km**2 - 6.0 * h_km + 250.0)


@pytest.mark.parametrize(
    ("row", "images", "h_c_m", "focal_px"),
    [
        (45, 3, 3000.0, 900.0),
        (81 + 45, 1, 6000.0, 600.0),  # the mean of fx and fy
    ],
)
def test_a_radial_table_at_45_degrees(run, row, images, h_c_m, focal_px):
    """Images within 2 % of height share a table, of the air of the middle one by time."""
    table = write_export(run, "radial").table()

    at_45 = table.iloc[row]
    # In order of time the nadir images are b, c, a: the middle one, c, has the second profile.
    r = refraction(ICAN, h_c_m, math.radians(45.0))
    h_c_km = 1e-3 * h_c_m
    k_ground = effect_by_the_manual(0.1) * 0.1 / h_c_km
    assert at_45.images == images
    assert at_45.h_c_m == h_c_m
    assert at_45.h_g_m == GROUND
    assert at_45.radius_px == pytest.approx(focal_px, rel=1e-12)
    assert at_45.r_c_urad == pytest.approx(r * 1e6, rel=1e-9)
    assert at_45.k_urad == pytest.approx(r * 1e6, rel=1e-9)
    assert at_45.k_manual_urad == pytest.approx(effect_by_the_manual(h_c_km) - k_ground)
    assert at_45.r_c_arcsec == pytest.approx(math.degrees(r) * 3600.0, rel=1e-9)
    # f tan(45 - R) - f, by the rule of the tangent of a difference
    dr_px = -2.0 * focal_px * math.tan(r) / (1 + math.tan(r))
    assert at_45.dr_px == pytest.approx(dr_px)
    shift_m = 2.0 * (h_c_m - GROUND) * r
    assert at_45.shift_ground_m == pytest.approx(shift_m, rel=3e-3)


def test_radial_tables_by_camera_and_height(run):
    written = write_export(run, "radial")

    table = written.table()
    assert_array_equal(table.camera, np.repeat(["nadir", "side"], 81))
    assert table.nadir_angle_deg.tolist() == pytest.approx([*range(81)] * 2)
    for _, rows in table.groupby("camera"):
        assert rows.r_c_arcsec.is_monotonic_increasing
    air, window = written.ledger
    assert (air.code, air.count) == ("EXPORT-AIR-CHANGES", 2)
    assert (window.code, window.count) == ("EXPORT-WINDOW", 0)
    assert "side" in window.what


def test_heights_apart_have_tables_of_their_own_the_lowest_first(run):
    """The middle of two images is the mean of their heights."""
    height_m = STATIONS.h_m.to_numpy().copy()
    height_m[0] = 4000.0
    exposures = replace(run.exposures, height_m=height_m)
    run = replace(run, exposures=exposures)

    table = write_export(run, "radial").table()

    heads = table[:162:81]
    assert heads.h_c_m.tolist() == [3005.0, 4000.0]
    assert heads.images.tolist() == [2, 1]


def test_the_radius_of_a_radial_table_is_the_mean_one_of_the_latitude(run):
    """At 45 degrees of azimuth: 2 / (1/M + 1/N), with M and N by hand for WGS84 at 0.8 rad."""
    exposures = replace(run.exposures, radius_m=None)
    run = replace(run, exposures=exposures)

    table = write_export(run, "radial").table()

    w2 = 1.0 - 0.00669437999014 * math.sin(0.8) ** 2
    m = 6378137.0 * (1.0 - 0.00669437999014) / w2**1.5
    n = 6378137.0 / math.sqrt(w2)
    radius = 2.0 / (1 / m + 1 / n)
    r = refraction(ICAN, 3000.0, math.radians(80.0), radius)
    assert table.r_c_urad[80] == pytest.approx(r * 1e6, rel=1e-10)


def test_images_below_ground_are_in_no_radial_table(run):
    ground = np.full(5, GROUND)
    ground[1] = 3500.0
    ground[3] = np.nan
    buried = replace(run, find_ground=lambda _: ground)

    written = write_export(buried, "radial")

    table = written.table()
    assert (table.camera == "nadir").all()
    assert (table.images == 2).all()
    left_out = with_code(written.ledger, "EXPORT-LEFT-OUT")
    assert [message.where for message in left_out] == ["camera nadir", "camera side"]
    assert [message.count for message in left_out] == [1, 1]


# -- options ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rows": 2},
        {"columns": 2, "rows": 1000},
    ],
)
def test_values_are_given_or_by_default(options):
    defaults = {"columns": 21, "rows": 15}
    assert FORMATS["lattice"].values(options) == defaults | options


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
    form = ExportFormat(
        "x",
        "",
        ".csv",
        write=lambda *_: 0,
        frame=lambda *_: ExportFrame(),
        options=(option,),
    )

    assert form.values({"largest_angle": 89.0}) == {"largest_angle": 89.0}
    with refused("EXPORT-OPTION") as refusal:
        form.values({"largest_angle": 90.0})
    assert refusal.value.where == "--largest-angle"
    assert refusal.value.remedy == "largest nadir angle [deg]"


def test_the_command_line_shows_the_options_of_every_format(unbend):
    """Generated from the declarations: flag, help, default and limits."""
    ended = unbend("export", "--help")

    shown = one_line(ended.out)
    shown = shown.replace("- ", "-")  # lines also break at hyphens
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
        ("--format radial --rows 3", "EXPORT-OPTION"),
        ("--format lattice --rows 1", "--rows"),
        ("--format lattice --rows many", "--rows"),
        ("", "--format"),
    ],
)
def test_the_command_line_refuses(unbend, tmp_path, options, words):
    out = tmp_path / "out.parquet"

    ended = unbend("export", tmp_path, "--out", out, *options.split())

    assert ended.code == 2
    assert words in ended.err
