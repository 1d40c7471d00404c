"""Exports in a stated coordinate system, and the frame of every export.

Truth: PROJ for places, convergence and scale; a ray of an image through the exported angles reaches
the same ground as one in earth-centred axes; GDAL reads the GeoPackage.
"""

from __future__ import annotations

import json
import sqlite3
import xml.etree.ElementTree as ET
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import entry_of
from tests.tables.checks import assert_within
from tests.tables.exports.export_runs import (
    DOWN,
    ecef_of,
    enu_axes,
    finished_run,
    rotation_to_photo,
    stations_at,
    write_export,
)
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun
from unbend.tables.exports.export_frames import frame_record
from unbend.tables.geodata.map_grids import open_grid

CAMERA = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)
NAMES = ["a,1.tif", "b.tif", "c.tif"]
LAT = np.array([47.00, 47.01, 47.02])
LON = np.array([6.40, 6.41, 6.42])
H_MSL = 3000.0
H_ELLIPSOID = 3048.0
GROUND = 400.0
GROUND_ELLIPSOID = 448.0
TURNS = np.array(
    [
        DOWN,
        Rotation.from_euler("zyx", [70.0, -20.0, 15.0], degrees=True).as_matrix() @ DOWN,
        Rotation.from_euler("z", 190.0, degrees=True).as_matrix() @ DOWN,
    ]
)
# Where the points of the first two images are from below the station, and the shift there [m].
GROUND_STEPS = np.array([[300.0, -400.0], [-250.0, 100.0]])
SHIFT_EN = np.array([[0.9, -0.5], [-0.3, 1.2]])


def places_on_ground(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes [deg] some metres from below the first two stations."""
    azimuth = np.degrees(np.arctan2(*steps.T))
    geod = pyproj.Geod(ellps="WGS84")
    lon, lat, _ = geod.fwd(LON[:2], LAT[:2], azimuth, np.hypot(*steps.T))
    return lon, lat


def pixels_of(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """(2, 2) where the first two stations see these places on the ground, from the centre."""
    pixels = []
    for station in range(2):
        ground = ecef_of(lon[station], lat[station], GROUND_ELLIPSOID)
        step = ground - ecef_of(LON[station], LAT[station], H_ELLIPSOID)
        x, y, z = TURNS[station] @ enu_axes(LON[station], LAT[station]) @ step
        pixels.append(CAMERA.project(x / z, y / z))
    return np.array(pixels, float) - 0.5


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> FinishedRun:
    """Three images, two with a point of known place and shift, one row without a correction."""
    time_ns = np.full(3, 1_749_718_800_500_000_000)
    places = (LON, LAT, H_MSL, H_ELLIPSOID)
    stations = stations_at(NAMES, "nadir", *places, TURNS, time_ns=time_ns)
    corrected = pixels_of(*places_on_ground(GROUND_STEPS))
    measured = pixels_of(*places_on_ground(GROUND_STEPS - SHIFT_EN))
    columns = {
        "image": [*NAMES[:2], "a,1.tif"],
        "point": ["p0", "p1", "lost"],
        "x_px": [*measured[:, 0], 5.0],
        "y_px": [*measured[:, 1], 5.0],
        "x_corrected_px": [*corrected[:, 0], None],
        "y_corrected_px": [*corrected[:, 1], None],
        "h_g_m": [GROUND, GROUND, None],
        "status": ["ok", "ok", "no_ground"],
    }
    part = tmp_path_factory.mktemp("block") / "part.parquet"
    pq.write_table(pa.table(columns), part)
    cameras = {"nadir": ExportCamera(CAMERA, False)}
    return finished_run(stations, TURNS, cameras, GROUND, parts=(part,))


def in_grid(run: FinishedRun, crs: str, name: str) -> FinishedRun:
    form = FORMATS[name]
    assert form.grid is not None
    grid, _ = open_grid(
        crs,
        run.stations.lat_rad,
        run.stations.lon_rad,
        geoid=None,
        needs_angles=form.grid.needs_angles,
    )
    return replace(run, grid=grid)


def to_grid(crs: str, lon, lat) -> np.ndarray:
    """(n, 2) coordinates, x first, by PROJ."""
    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    return np.stack(transformer.transform(lon, lat), axis=-1)


# ---------------------------------------------------------------- omega, phi, kappa in a grid


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:25831", "EPSG:2056", "EPSG:27572"])
def test_angles_count_from_the_axes_of_the_grid(block, crs, tmp_path):
    """East and north, by hand, are turned by the convergence against those of the grid.

    It has both signs; the last counts longitudes from Paris.
    """
    table = write_export(in_grid(block, crs, "opk"), "opk", tmp_path).table()
    assert_allclose(table[["x_m", "y_m"]], to_grid(crs, LON, LAT))
    assert_allclose(table.z_m, H_ELLIPSOID)
    for station, row in table.iterrows():
        enu_from_grid = Rotation.from_euler("z", -row.convergence_deg, degrees=True).as_matrix()
        expected = DOWN @ TURNS[station] @ enu_from_grid
        assert_within(rotation_to_photo(row), expected, 1e-9)


def test_convergence_and_scale_stand_in_the_file_and_in_the_frame(block, tmp_path):
    run = in_grid(block, "EPSG:25832+5773", "opk")
    written = write_export(run, "opk", tmp_path)
    factors = pyproj.Proj("EPSG:25832").get_factors(LON, LAT)
    convergence = factors.meridian_convergence
    scale = factors.meridional_scale
    table = written.table()
    assert_within(table.convergence_deg, convergence, 1e-7)
    assert_within(table.scale_factor, scale, 1e-8)
    assert (table.z_m == H_MSL).all()
    assert table.omega_deg.notna().all()
    assert [code for _, code, _ in written.counts] == ["EXPORT-GRID"]
    frame = frame_record(FORMATS["opk"].frame(run, {}))
    positions = frame["positions"]
    angles = frame["angles"]
    assert positions["kind"] == "projected"
    assert positions["crs"] == "EPSG:25832+5773"
    assert pyproj.CRS.from_wkt(positions["crs_wkt"]).equals(pyproj.CRS("EPSG:25832+5773"))
    assert positions["axes"] == ("east", "north", "height")
    assert positions["units"] == ("m", "m", "m")
    assert positions["height_reference"] == "EGM96 height"
    assert angles["is_convergence_applied"] is True
    assert angles["convergence_deg"] == pytest.approx((min(convergence), max(convergence)))
    assert angles["frame_axes"] == ("grid east", "grid north", "up")
    assert frame["scale"] == {
        "lowest": pytest.approx(min(scale), rel=1e-8),
        "highest": pytest.approx(max(scale), rel=1e-8),
        "is_in_heights": False,
        "is_in_principal_distance": False,
    }


def test_axis_order_of_a_system_and_of_the_file(block):
    """EPSG has this UTM zone also with its axes to the north and east; the file has x first."""
    run = in_grid(block, "EPSG:3044", "opk")
    positions = FORMATS["opk"].frame(run, {}).positions
    assert positions.axes[:2] == ("east", "north")
    assert positions.axis_order_of_crs == ("north", "east")


def test_angles_without_a_grid_have_places_with_the_latitude_first(block):
    positions = FORMATS["opk"].frame(block, {}).positions
    assert positions.axes == ("latitude", "longitude", "height")


def test_a_station_that_the_grid_does_not_reach_is_not_in_its_frame(block):
    """It is left out of the table, and says nothing of convergence and scale of the others."""
    near = in_grid(block, "EPSG:32632", "opk")
    far_lon_rad = np.radians([*LON[:2], 99.0])  # 90 degrees from the meridian of the zone
    lat_rad = np.radians([*LAT[:2], 0.0])
    stations = replace(near.stations, lat_rad=lat_rad, lon_rad=far_lon_rad)
    frame = FORMATS["opk"].frame(replace(near, stations=stations), {})
    assert np.isfinite(frame.angles.convergence_deg).all()
    assert 0.999 < frame.scale.lowest <= frame.scale.highest < 1.001


# ---------------------------------------------------------------- points and layers


def test_points_on_the_ground_with_their_shift(block, tmp_path):
    written = write_export(in_grid(block, "EPSG:25832", "points"), "points", tmp_path)
    table = written.table()
    assert written.counts == [("loss", "EXPORT-LEFT-OUT", 1)]
    assert table.image.tolist() == NAMES[:2]
    assert table.point.tolist() == ["p0", "p1"]
    true = to_grid("EPSG:25832", *places_on_ground(GROUND_STEPS))
    apparent = to_grid("EPSG:25832", *places_on_ground(GROUND_STEPS - SHIFT_EN))
    shift = table[["shift_x_m", "shift_y_m"]]
    assert_within(table[["x_m", "y_m"]], true, 0.02)
    assert_within(shift, true - apparent, 1e-3)
    assert_allclose(table.shift_m, np.hypot(*SHIFT_EN.T), rtol=1e-3)
    assert_allclose(table.z_m, GROUND_ELLIPSOID, rtol=1e-6)
    assert (table.h_g_m == GROUND).all()
    corrected = pixels_of(*places_on_ground(GROUND_STEPS))
    measured = pixels_of(*places_on_ground(GROUND_STEPS - SHIFT_EN))
    assert_within(table[["dx_px", "dy_px"]], corrected - measured, 1e-9)


def test_points_in_degrees_have_the_shift_to_the_east_and_north(block, tmp_path):
    table = write_export(in_grid(block, "EPSG:4326", "points"), "points", tmp_path).table()
    places = np.stack(places_on_ground(GROUND_STEPS), axis=1)
    assert_within(table[["lon_deg", "lat_deg"]], places, 2e-7)
    shift = table[["shift_x_m", "shift_y_m"]]
    assert_within(shift, SHIFT_EN, 1e-3)


def test_the_scale_of_a_grid_is_not_in_the_shift(block, tmp_path):
    """Web Mercator is half as long again at 47 degrees."""
    table = write_export(in_grid(block, "EPSG:3857", "points"), "points", tmp_path).table()
    assert_allclose(table.shift_m, np.hypot(*SHIFT_EN.T), rtol=1e-3)


def test_a_geopackage_read_by_gdal(block, tmp_path):
    written = write_export(in_grid(block, "EPSG:25832+5773", "geopackage"), "geopackage", tmp_path)
    layers = ("stations", "footprints", "points")
    stations, grounds, points = (geopandas.read_file(written.path, layer=name) for name in layers)
    assert [len(stations), len(grounds), len(points)] == [3, 3, 2]
    assert written.count == 8
    assert pyproj.CRS(stations.crs).sub_crs_list[0].to_epsg() == 25832
    places = np.stack([stations.geometry.x, stations.geometry.y], axis=1)
    assert_allclose(places, to_grid("EPSG:25832", LON, LAT))
    assert_allclose(stations.geometry.z, H_MSL)
    assert_allclose(points.geometry.z, GROUND)
    assert_allclose(points["shift_m"], np.hypot(*SHIFT_EN.T), rtol=1e-3)
    assert stations["time_utc"].iloc[0].isoformat().startswith("2025-06-12T09:00:00.500")
    # The nadir image: 2600 m above ground, 900 px: the corners are 2600 * 500 / 900 m away.
    nadir = grounds.geometry.iloc[0]
    west, _, east, _ = nadir.bounds
    assert 0.5 * (west + east) == pytest.approx(stations.geometry.x.iloc[0], abs=5.0)
    side = 2600.0 / 900.0 * np.sqrt(1000.0 * 800.0)
    assert np.sqrt(nadir.area) == pytest.approx(side, rel=1e-3)
    query = "SELECT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE table_name = 'points'"
    with closing(sqlite3.connect(written.path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA application_id").fetchone() == (0x47504B47,)
        box = database.execute(query).fetchone()
    assert box == pytest.approx(points.total_bounds)


def test_the_styles_are_those_that_qgis_takes_by_itself(block, tmp_path):
    """The query of QGIS's provider; arrows by the columns of the shift, 95 % up to 8 mm."""
    written = write_export(in_grid(block, "EPSG:25832", "geopackage"), "geopackage", tmp_path)
    query = (
        "SELECT styleQML FROM layer_styles WHERE f_table_schema='' AND f_table_name=? AND "
        "f_geometry_column='geom' ORDER BY CASE WHEN useAsDefault THEN 1 ELSE 2 END, update_time "
        "DESC LIMIT 1"
    )
    symbols = {"points": "marker", "footprints": "fill", "stations": "marker"}
    styles = {}
    with closing(sqlite3.connect(written.path)) as database:
        for name, symbol in symbols.items():
            (style,) = database.execute(query, (name,)).fetchone()
            styles[name] = ET.fromstring(style)
            assert styles[name].find(".//symbol").get("type") == symbol
        columns = {row[1] for row in database.execute("PRAGMA table_info(points)")}
    (field,) = styles["points"].findall(".//layer[@class='VectorField']")
    settings = {setting.get("k"): setting.get("v") for setting in field.findall("prop")}
    assert settings["x_attribute"] == "shift_x_m"
    assert settings["y_attribute"] == "shift_y_m"
    assert {"shift_x_m", "shift_y_m"} <= columns
    longest = np.quantile(np.hypot(*SHIFT_EN.T), 0.95)
    assert float(settings["scale"]) == pytest.approx(8.0 / longest, rel=1e-3)


def test_a_run_without_corrected_points_has_empty_layers(block, tmp_path):
    run = replace(in_grid(block, "EPSG:25832", "geopackage"), parts=())
    written = write_export(run, "geopackage", tmp_path)
    assert written.count == 6
    assert len(geopandas.read_file(written.path, layer="points")) == 0


# ---------------------------------------------------------------- the frame of every export


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_states_its_frame(block, name):
    """As fields that a program can read; none of the values is a sentence."""
    form = FORMATS[name]
    run = block
    if form.grid is not None and form.grid.default:
        run = in_grid(block, form.grid.default, name)
    record = json.loads(json.dumps(frame_record(form.frame(run, form.values({})))))
    assert set(record) == {"positions", "angles", "scale", "pixels", "ground_heights"}
    assert any(record.values())
    positions = record["positions"]
    if positions is not None:
        assert len(positions["units"]) == len(positions["axes"]) == 3
        assert positions["height_reference"]
        assert (positions["kind"] == "topocentric") == (positions["origin"] is not None)
    if record["angles"] is not None:
        assert record["angles"]["turns"] in {"camera to frame", "frame to camera"}


def test_the_origin_of_a_block_is_that_of_its_file(block, tmp_path):
    row = write_export(block, "opk-enu", tmp_path).table().iloc[0]
    origin = FORMATS["opk-enu"].frame(block, {}).positions.origin
    assert origin.latitude_deg == row.origin_lat_deg
    assert origin.longitude_deg == row.origin_lon_deg
    assert origin.h_ellipsoid_m == row.origin_h_ellipsoid_m


def test_quarter_turns_of_bingo_turn_the_axes_of_its_frame(block):
    frame_of = FORMATS["bingo"].frame
    axes = [frame_of(block, {"quarter_turns": turns}).pixels.axes for turns in range(4)]
    assert axes == [("right", "up"), ("up", "left"), ("left", "down"), ("down", "right")]


# ---------------------------------------------------------------- the command


def frame_beside(file: Path) -> dict:
    sidecar = file.with_name(f"{file.name}.unbend.json")
    return json.loads(sidecar.read_text(encoding="utf-8"))["frame"]


def test_the_command_writes_the_frame_beside_the_file(unbend, baseline, tmp_path):
    out = tmp_path / "o.csv"
    ended = unbend(
        "export", baseline.output, "--format", "opk", "--crs", "EPSG:32632", "--out", out, "--json"
    )
    assert ended.code == 0, ended.text
    answer = json.loads(ended.out)
    beside = json.loads((tmp_path / "o.csv.unbend.json").read_text(encoding="utf-8"))
    assert answer["frame"] == beside["frame"]
    assert beside["frame"]["positions"]["crs"] == "EPSG:32632"
    assert beside["files"] == []
    assert "unbend.refraction" not in beside
    assert "map projection" in entry_of(answer, "EXPORT-USE")["what"]


@pytest.mark.parametrize("name", ["points", "geopackage"])
def test_places_are_geographic_without_a_system(unbend, baseline, tmp_path, name):
    out = tmp_path / f"x{FORMATS[name].ending}"
    ended = unbend("export", baseline.output, "--format", name, "--out", out)
    assert ended.code == 0, ended.text
    assert frame_beside(out)["positions"]["crs"] == "EPSG:4326"


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--format", "kml", "--crs", "EPSG:25832"), "EXPORT-OPTION", "opk, geopackage, points"),
        (("--format", "colmap", "--crs", "EPSG:25832"), "EXPORT-OPTION", "has a fixed frame"),
        (("--format", "opk", "--geoid", "g.gtx"), "EXPORT-OPTION", "not given"),
        (("--format", "opk", "--crs", "EPSG:4326"), "EXPORT-CRS", "without --crs"),
        (("--format", "opk", "--crs", "EPSG:3857"), "EXPORT-CRS", "UTM zone"),
        (("--format", "points", "--crs", "EPSG:32760"), "EXPORT-CRS", "its UTM zone"),
    ],
)
def test_what_does_not_fit_is_refused(unbend, baseline, tmp_path, options, code, words):
    ending = FORMATS[options[1]].ending
    ended = unbend("export", baseline.output, *options, "--out", tmp_path / f"o{ending}")
    assert ended.code == 2, ended.text
    assert code in ended.err
    assert words in " ".join(ended.err.split())
    assert not list(tmp_path.iterdir())
