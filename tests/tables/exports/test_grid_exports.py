"""Exports in a stated coordinate system, and the frame of every export.

Truth: PROJ for places, convergence and scale; GDAL reads the GeoPackage.
"""

import json
import sqlite3
import xml.etree.ElementTree as ET
from contextlib import closing
from dataclasses import replace

import geopandas
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import entry_of, one_line
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
from unbend.tables.exports import FORMATS, ExportCamera
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
TURNED_FROM_DOWN = Rotation.from_euler(
    "zyx",
    [
        [0.0, 0.0, 0.0],
        [70.0, -20.0, 15.0],
        [190.0, 0.0, 0.0],
    ],
    degrees=True,
)
TURNS = TURNED_FROM_DOWN.as_matrix() @ DOWN
# Where the points of the first two images are from below the station, and the shift there [m].
GROUND_STEPS = np.array(
    [
        [300.0, -400.0],
        [-250.0, 100.0],
    ]
)
SHIFT_EN = np.array(
    [
        [0.9, -0.5],
        [-0.3, 1.2],
    ]
)
SHIFT_M = np.hypot(*SHIFT_EN.T)


def places_on_ground(steps):
    """Longitudes and latitudes [deg] some metres from below the first two stations."""
    azimuth = np.degrees(np.arctan2(*steps.T))
    distance_m = np.hypot(*steps.T)
    geod = pyproj.Geod(ellps="WGS84")
    lon, lat, _ = geod.fwd(LON[:2], LAT[:2], azimuth, distance_m)
    return lon, lat


def pixels_of(lon, lat):
    """(2, 2) where the first two stations see these places on the ground, from the centre."""
    pixels = []
    for station in range(2):
        ground = ecef_of(lon[station], lat[station], GROUND_ELLIPSOID)
        step = ground - ecef_of(LON[station], LAT[station], H_ELLIPSOID)
        axes = enu_axes(LON[station], LAT[station])
        x, y, z = TURNS[station] @ axes @ step
        pixels.append(CAMERA.project(x / z, y / z))
    return np.array(pixels, float) - 0.5


PLACES = places_on_ground(GROUND_STEPS)
APPARENT_PLACES = places_on_ground(GROUND_STEPS - SHIFT_EN)
CORRECTED_PX = pixels_of(*PLACES)
MEASURED_PX = pixels_of(*APPARENT_PLACES)


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """Three images, two with a point of known place and shift, one row without a correction."""
    time_ns = np.full(3, 1_749_718_800_500_000_000)
    stations = stations_at(
        NAMES,
        "nadir",
        LON,
        LAT,
        H_MSL,
        H_ELLIPSOID,
        TURNS,
        time_ns=time_ns,
    )
    columns = {
        "image": [*NAMES[:2], NAMES[0]],
        "point": ["p0", "p1", "lost"],
        "x_px": [*MEASURED_PX[:, 0], 5.0],
        "y_px": [*MEASURED_PX[:, 1], 5.0],
        "x_corrected_px": [*CORRECTED_PX[:, 0], None],
        "y_corrected_px": [*CORRECTED_PX[:, 1], None],
        "h_g_m": [GROUND, GROUND, None],
        "status": ["ok", "ok", "no_ground"],
    }
    part = tmp_path_factory.mktemp("block") / "part.parquet"
    pq.write_table(pa.table(columns), part)
    cameras = {"nadir": ExportCamera(CAMERA, False)}
    return finished_run(stations, TURNS, cameras, GROUND, parts=(part,))


def in_grid(run, crs, name):
    form = FORMATS[name]
    grid, _ = open_grid(
        crs,
        run.stations.lat_rad,
        run.stations.lon_rad,
        geoid=None,
        needs_angles=form.grid.needs_angles,
    )
    return replace(run, grid=grid)


def written_in_grid(run, crs, name):
    return write_export(in_grid(run, crs, name), name)


def to_grid(crs, lon, lat):
    """(n, 2) coordinates, x first, by PROJ."""
    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    return np.stack(transformer.transform(lon, lat), axis=-1)


# ---------------------------------------------------------------- omega, phi, kappa in a grid


@pytest.mark.parametrize(
    "crs",
    [
        "EPSG:25832",
        "EPSG:25831",
        "EPSG:2056",
        "EPSG:27572",
    ],
)
def test_angles_count_from_the_axes_of_the_grid(block, crs):
    """East and north, by hand, are turned by the convergence against those of the grid.

    It has both signs; the last counts longitudes from Paris.
    """
    table = written_in_grid(block, crs, "opk").table()

    assert_allclose(table[["x_m", "y_m"]], to_grid(crs, LON, LAT))
    assert_allclose(table.z_m, H_ELLIPSOID)
    for station, row in table.iterrows():
        turn = Rotation.from_euler("z", -row.convergence_deg, degrees=True)
        expected = DOWN @ TURNS[station] @ turn.as_matrix()
        assert_within(rotation_to_photo(row), expected, 1e-9)


def test_convergence_and_scale_stand_in_the_file_and_its_frame(block):
    factors = pyproj.Proj("EPSG:25832").get_factors(LON, LAT)
    convergence = factors.meridian_convergence
    scale = factors.meridional_scale
    run = in_grid(block, "EPSG:25832+5773", "opk")

    written = write_export(run, "opk")
    frame = frame_record(FORMATS["opk"].frame(run, {}))

    table = written.table()
    assert_within(table.convergence_deg, convergence, 1e-7)
    assert_within(table.scale_factor, scale, 1e-8)
    assert (table.z_m == H_MSL).all()
    assert table.omega_deg.notna().all()
    assert [message.code for message in written.ledger] == ["EXPORT-GRID"]
    positions = frame["positions"]
    angles = frame["angles"]
    assert positions["kind"] == "projected"
    assert positions["crs"] == "EPSG:25832+5773"
    crs = pyproj.CRS.from_wkt(positions["crs_wkt"])
    assert crs.equals(pyproj.CRS("EPSG:25832+5773"))
    assert positions["axes"] == ("east", "north", "height")
    assert positions["units"] == ("m", "m", "m")
    assert positions["height_reference"] == "EGM96 height"
    assert angles["is_convergence_applied"] is True
    limits = (min(convergence), max(convergence))
    assert angles["convergence_deg"] == pytest.approx(limits)
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
    far_lon = [*LON[:2], 99.0]  # 90 degrees from the meridian of the zone
    stations = replace(
        near.stations,
        lat_rad=np.radians([*LAT[:2], 0.0]),
        lon_rad=np.radians(far_lon),
    )

    run = replace(near, stations=stations)
    frame = FORMATS["opk"].frame(run, {})

    assert np.isfinite(frame.angles.convergence_deg).all()
    assert 0.999 < frame.scale.lowest <= frame.scale.highest < 1.001


# ---------------------------------------------------------------- points and layers


def test_points_on_the_ground_with_their_shift(block):
    written = written_in_grid(block, "EPSG:25832", "points")

    table = written.table()
    assert written.counts == [("loss", "EXPORT-LEFT-OUT", 1)]
    assert table.image.tolist() == NAMES[:2]
    assert table.point.tolist() == ["p0", "p1"]
    places = to_grid("EPSG:25832", *PLACES)
    shift = places - to_grid("EPSG:25832", *APPARENT_PLACES)
    assert_within(table[["x_m", "y_m"]], places, 0.02)
    assert_within(table[["shift_x_m", "shift_y_m"]], shift, 1e-3)
    assert_allclose(table.shift_m, SHIFT_M, rtol=1e-3)
    assert_allclose(table.z_m, GROUND_ELLIPSOID, rtol=1e-6)
    assert (table.h_g_m == GROUND).all()
    assert_within(table[["dx_px", "dy_px"]], CORRECTED_PX - MEASURED_PX, 1e-9)


def test_points_in_degrees_have_the_shift_to_the_east_and_north(block):
    table = written_in_grid(block, "EPSG:4326", "points").table()
    assert_within(table[["lon_deg", "lat_deg"]].T, PLACES, 2e-7)
    assert_within(table[["shift_x_m", "shift_y_m"]], SHIFT_EN, 1e-3)


def test_the_scale_of_a_grid_is_not_in_the_shift(block):
    """Web Mercator is half as long again at 47 degrees."""
    table = written_in_grid(block, "EPSG:3857", "points").table()
    assert_allclose(table.shift_m, SHIFT_M, rtol=1e-3)


def test_a_geopackage_read_by_gdal(block):
    written = written_in_grid(block, "EPSG:25832+5773", "geopackage")

    stations = geopandas.read_file(written.path, layer="stations")
    grounds = geopandas.read_file(written.path, layer="footprints")
    points = geopandas.read_file(written.path, layer="points")

    assert len(stations) == len(grounds) == 3
    assert len(points) == 2
    assert written.count == 8
    assert pyproj.CRS(stations.crs).sub_crs_list[0].to_epsg() == 25832
    assert_allclose(stations.get_coordinates(), to_grid("EPSG:25832", LON, LAT))
    assert_allclose(stations.geometry.z, H_MSL)
    assert_allclose(points.geometry.z, GROUND)
    assert_allclose(points["shift_m"], SHIFT_M, rtol=1e-3)
    assert stations["time_utc"].iloc[0].isoformat().startswith("2025-06-12T09:00:00.500")
    # The nadir image: 2600 m above ground, 900 px: the corners are 2600 * 500 / 900 m away.
    nadir = grounds.geometry.iloc[0]
    west, _, east, _ = nadir.bounds
    assert 0.5 * (west + east) == pytest.approx(stations.geometry.x[0], abs=5.0)
    side_m = 2600.0 / 900.0 * np.sqrt(1000.0 * 800.0)
    assert np.sqrt(nadir.area) == pytest.approx(side_m, rel=1e-3)
    query = "SELECT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE table_name = 'points'"
    with closing(sqlite3.connect(written.path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA application_id").fetchone() == (0x47504B47,)
        box = database.execute(query).fetchone()
    assert box == pytest.approx(points.total_bounds)


QUERY_OF_QGIS = (
    "SELECT styleQML FROM layer_styles WHERE f_table_schema='' AND f_table_name=? AND "
    "f_geometry_column='geom' ORDER BY CASE WHEN useAsDefault THEN 1 ELSE 2 END, update_time "
    "DESC LIMIT 1"
)
"""Of its provider, for the style of a layer."""


def test_the_styles_are_those_that_qgis_takes_by_itself(block):
    """Arrows by the columns of the shift, 95 % up to 8 mm."""
    written = written_in_grid(block, "EPSG:25832", "geopackage")

    styles = {}
    with closing(sqlite3.connect(written.path)) as database:
        for name in ("points", "footprints", "stations"):
            (style,) = database.execute(QUERY_OF_QGIS, (name,)).fetchone()
            styles[name] = ET.fromstring(style)
        columns = {row[1] for row in database.execute("PRAGMA table_info(points)")}

    symbols = {
        "points": "marker",
        "footprints": "fill",
        "stations": "marker",
    }
    for name, symbol in symbols.items():
        assert styles[name].find(".//symbol").get("type") == symbol
    (field,) = styles["points"].findall(".//layer[@class='VectorField']")
    settings = {setting.get("k"): setting.get("v") for setting in field.findall("prop")}
    assert settings["x_attribute"] == "shift_x_m"
    assert settings["y_attribute"] == "shift_y_m"
    assert {"shift_x_m", "shift_y_m"} <= columns
    longest_m = np.quantile(SHIFT_M, 0.95)
    assert float(settings["scale"]) == pytest.approx(8.0 / longest_m, rel=1e-3)


def test_a_run_without_corrected_points_has_empty_layers(block):
    without_points = replace(block, parts=())
    written = written_in_grid(without_points, "EPSG:25832", "geopackage")
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

    frame = form.frame(run, form.values({}))
    record = json.loads(json.dumps(frame_record(frame)))
    assert set(record) == {"positions", "angles", "scale", "pixels", "ground_heights"}
    assert any(record.values())
    positions = record["positions"]
    if positions is not None:
        assert len(positions["units"]) == len(positions["axes"]) == 3
        assert positions["height_reference"]
        assert (positions["kind"] == "topocentric") == (positions["origin"] is not None)
    if record["angles"] is not None:
        assert record["angles"]["turns"] in {"camera to frame", "frame to camera"}


def test_the_origin_of_a_block_is_that_of_its_file(block):
    table = write_export(block, "opk-enu").table()
    row = table.iloc[0]
    origin = FORMATS["opk-enu"].frame(block, {}).positions.origin
    assert origin.latitude_deg == row.origin_lat_deg
    assert origin.longitude_deg == row.origin_lon_deg
    assert origin.h_ellipsoid_m == row.origin_h_ellipsoid_m


@pytest.mark.parametrize(
    ("quarter_turns", "axes"),
    [
        (0, ("right", "up")),
        (1, ("up", "left")),
        (2, ("left", "down")),
        (3, ("down", "right")),
    ],
)
def test_quarter_turns_of_bingo_turn_the_axes_of_its_frame(block, quarter_turns, axes):
    frame = FORMATS["bingo"].frame(block, {"quarter_turns": quarter_turns})
    assert frame.pixels.axes == axes


# ---------------------------------------------------------------- the command


def sidecar_of(file):
    sidecar = file.with_name(f"{file.name}.unbend.json")
    return json.loads(sidecar.read_text("utf-8"))


def test_the_command_writes_the_frame_beside_the_file(obeyed, baseline, tmp_path):
    out = tmp_path / "o.csv"
    words = ["--format", "opk", "--crs", "EPSG:32632", "--out", out, "--json"]

    answer = json.loads(obeyed("export", baseline.output, *words))

    beside = sidecar_of(out)
    assert answer["frame"] == beside["frame"]
    assert beside["frame"]["positions"]["crs"] == "EPSG:32632"
    assert beside["files"] == []
    assert "unbend.refraction" not in beside
    assert "map projection" in entry_of(answer, "EXPORT-USE")["what"]


@pytest.mark.parametrize("name", ["points", "geopackage"])
def test_places_are_geographic_without_a_system(obeyed, baseline, tmp_path, name):
    out = tmp_path / f"x{FORMATS[name].ending}"

    obeyed("export", baseline.output, "--format", name, "--out", out)

    assert sidecar_of(out)["frame"]["positions"]["crs"] == "EPSG:4326"


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("kml --crs EPSG:25832", "EXPORT-OPTION", "opk, geopackage, points"),
        ("colmap --crs EPSG:25832", "EXPORT-OPTION", "has a fixed frame"),
        ("opk --geoid g.gtx", "EXPORT-OPTION", "not given"),
        ("opk --crs EPSG:4326", "EXPORT-CRS", "without --crs"),
        ("opk --crs EPSG:3857", "EXPORT-CRS", "UTM zone"),
        ("points --crs EPSG:32760", "EXPORT-CRS", "its UTM zone"),
    ],
)
def test_what_does_not_fit_is_refused(unbend, baseline, tmp_path, options, code, words):
    name, *arguments = options.split()
    out = tmp_path / f"o{FORMATS[name].ending}"

    ended = unbend(
        "export",
        baseline.output,
        "--out",
        out,
        "--format",
        name,
        *arguments,
    )

    assert ended.code == 2, ended.text
    assert code in ended.err
    assert words in one_line(ended.err)
    assert not list(tmp_path.iterdir())
