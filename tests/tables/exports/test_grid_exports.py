"""Exports in a stated coordinate system, and the frame of every export.

Truth: PROJ for places, convergence and scale; a ray of an image through the exported angles reaches
the same ground as one in earth-centred axes; GDAL reads the GeoPackage.
"""

from __future__ import annotations

import csv
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
import pyogrio
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import FORMATS, FinishedRun
from unbend.tables.exports.export_frames import frame_record
from unbend.tables.geodata.map_grids import open_grid

from .test_station_exports import run as run  # the fixture
from .test_station_exports import wolf_and_dewitt

CAMERA = Camera(1000, 800, 900.0, 900.0, 500.0, 400.0)
DOWN = np.diag([1.0, -1.0, -1.0])
LAT = np.array([47.00, 47.01, 47.02])
LON = np.array([6.40, 6.41, 6.42])
H_MSL = 3000.0
UNDULATION = 48.0
GROUND = 400.0
TURNS = [
    DOWN,
    Rotation.from_euler("zyx", [70.0, -20.0, 15.0], degrees=True).as_matrix() @ DOWN,
    Rotation.from_euler("z", 190.0, degrees=True).as_matrix() @ DOWN,
]
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
# Where the points of the first two images are from below the station, and the shift there [m].
GROUND_STEPS = np.array([[300.0, -400.0], [-250.0, 100.0]])
SHIFT_EN = np.array([[0.9, -0.5], [-0.3, 1.2]])


def enu_axes(lon: float, lat: float) -> np.ndarray:
    """(3, 3) from earth-centred axes to east, north, up."""
    return Rotation.from_euler("ZX", [90.0 + lon, 90.0 - lat], degrees=True).inv().as_matrix()


def ecef_at(lon: float, lat: float, h: float, enu=(0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array(TO_ECEF.transform(lon, lat, h)) + enu_axes(lon, lat).T @ np.asarray(enu)


def place_on_ground(station: int, step) -> tuple[float, float]:
    """Longitude and latitude [deg] of a place some metres from below a station."""
    geod = pyproj.Geod(ellps="WGS84")
    azimuth = np.degrees(np.arctan2(step[0], step[1]))
    lon, lat, _ = geod.fwd(LON[station], LAT[station], azimuth, np.hypot(*step))
    return lon, lat


def pixel_of(station: int, lon: float, lat: float) -> tuple[float, float]:
    """The pixel in which a station sees a place on the ground."""
    step = ecef_at(lon, lat, GROUND + UNDULATION) - ecef_at(
        LON[station], LAT[station], H_MSL + UNDULATION
    )
    ray = TURNS[station] @ enu_axes(LON[station], LAT[station]) @ step
    x, y = CAMERA.project(np.array([ray[0] / ray[2]]), np.array([ray[1] / ray[2]]))
    return float(x[0]), float(y[0])


@pytest.fixture
def block(run, tmp_path) -> FinishedRun:
    """Three images, two with a point of known place and shift, one row without a correction."""
    names = np.array(["a,1.tif", "b.tif", "c.tif"], object)
    stations = replace(
        empty_stations(names, np.full(3, "nadir", object), "ok"),
        lat_rad=np.radians(LAT),
        lon_rad=np.radians(LON),
        h_msl_m=np.full(3, H_MSL),
        h_ellipsoid_m=np.full(3, H_MSL + UNDULATION),
        quaternion=Rotation.from_matrix(TURNS).as_quat(canonical=True, scalar_first=True),
        time_ns=np.full(3, 1_749_718_800_500_000_000),
    )
    rows = []
    for station, (step, shift) in enumerate(zip(GROUND_STEPS, SHIFT_EN, strict=True)):
        corrected = pixel_of(station, *place_on_ground(station, step))
        measured = pixel_of(station, *place_on_ground(station, step - shift))
        rows.append((names[station], f"p{station}", *measured, *corrected, GROUND, "ok"))
    rows.append(("a,1.tif", "lost", 5.0, 5.0, None, None, None, "no_ground"))
    columns = (
        "image",
        "point",
        "x_px",
        "y_px",
        "x_corrected_px",
        "y_corrected_px",
        "h_g_m",
        "status",
    )
    table = pa.table(dict(zip(columns, zip(*rows, strict=True), strict=True)))
    for name in columns[2:7]:
        position = table.schema.get_field_index(name)
        # Pixels of the run count from the centre of the first.
        values = table[name].cast(pa.float64())
        if name.endswith("_px"):
            values = pa.array([None if v is None else v - 0.5 for v in values.to_pylist()])
        table = table.set_column(position, name, values)
    pq.write_table(table, tmp_path / "part.parquet")
    exposures = replace(
        run.exposures,
        usable=np.full(3, True),
        rotation=np.array(TURNS),
        latitude_rad=stations.lat_rad,
        height_m=stations.h_msl_m,
        refractivity_outside=run.exposures.refractivity_outside[:3],
        refractivity_cabin=run.exposures.refractivity_cabin[:3],
    )
    cameras = {"nadir": replace(run.cameras["nadir"], camera=CAMERA)}
    return replace(
        run,
        stations=stations,
        exposures=exposures,
        cameras=cameras,
        find_ground=lambda _: np.full(3, GROUND),
        pixels=type(run.pixels)("centre"),
        parts=(tmp_path / "part.parquet",),
    )


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


def written(run: FinishedRun, name: str, folder: Path) -> tuple[Path, int, Ledger]:
    form = FORMATS[name]
    ledger = Ledger()
    path = folder / f"out{form.ending}"
    return path, form.write(run, form.values({}), path, ledger), ledger


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------- omega, phi, kappa in a grid


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:25831", "EPSG:2056", "EPSG:27572"])
def test_a_ray_through_the_exported_angles_reaches_the_ground_of_one_in_ecef(block, crs, tmp_path):
    """2.6 km below, 1 km around: to 0.1 m and 3e-5 of the way, the datum's turn of the vertical.

    Without the convergence (2 degrees west of the middle of zone 32) it would be 30 m.
    """
    path, count, _ = written(in_grid(block, crs, "opk"), "opk", tmp_path)
    assert count == 3
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    for station, row in enumerate(rows_of(path)):
        place = np.array([float(row[name]) for name in ("x_m", "y_m", "z_m")])
        np.testing.assert_allclose(place[:2], to_grid.transform(LON[station], LAT[station]))
        assert place[2] == pytest.approx(H_MSL + UNDULATION)
        photo = wolf_and_dewitt(
            *np.radians([float(row[f"{n}_deg"]) for n in ("omega", "phi", "kappa")])
        )
        for x, y in ((500.0, 400.0), (0.0, 0.0), (1000.0, 0.0), (300.0, 800.0)):
            ray = np.array([x - 500.0, y - 400.0, 900.0])
            # In earth-centred axes, to a level surface 2600 m below the station.
            down = TURNS[station].T @ ray
            down *= -2600.0 / down[2]
            ground = ecef_at(LON[station], LAT[station], H_MSL + UNDULATION, down)
            lon, lat, h = TO_ECEF.transform(*ground, direction="INVERSE")
            truth = np.array(to_grid.transform(lon, lat))
            # In the grid: the photo's y is up, its z backward; the scale as the file states it.
            in_map = photo.T @ (ray * [1.0, -1.0, -1.0])
            in_map *= -2600.0 / in_map[2]
            scale = float(row["scale_factor"]) * 6.378e6 / (6.378e6 + h)
            reached = place[:2] + scale * in_map[:2]
            allowed = 0.1 + 3e-5 * np.linalg.norm(down)
            assert np.linalg.norm(reached - truth) < allowed


def test_convergence_and_scale_stand_in_the_file_and_in_the_frame(block, tmp_path):
    run = in_grid(block, "EPSG:25832+5773", "opk")
    path, _, ledger = written(run, "opk", tmp_path)
    factors = [pyproj.Proj("EPSG:25832").get_factors(*at) for at in zip(LON, LAT, strict=True)]
    convergence = [of.meridian_convergence for of in factors]
    scale = [of.meridional_scale for of in factors]
    rows = rows_of(path)
    assert [float(row["convergence_deg"]) for row in rows] == pytest.approx(convergence, abs=1e-7)
    assert [float(row["scale_factor"]) for row in rows] == pytest.approx(scale, abs=1e-8)
    assert [float(row["z_m"]) for row in rows] == [H_MSL] * 3
    assert [message.code for message in ledger] == ["EXPORT-GRID"]
    frame = frame_record(FORMATS["opk"].frame(run, {}))
    positions = frame["positions"]
    angles = frame["angles"]
    assert positions["kind"] == "projected"
    assert positions["crs"] == "EPSG:25832+5773"
    assert pyproj.CRS.from_wkt(positions["crs_wkt"]).equals(pyproj.CRS("EPSG:25832+5773"))
    assert (positions["axes"], positions["units"]) == (("east", "north", "height"), ("m",) * 3)
    assert positions["height_reference"] == "EGM96 height"
    assert angles["is_convergence_applied"] is True
    assert angles["convergence_deg"] == pytest.approx((min(convergence), max(convergence)))
    assert angles["frame_axes"] == ("grid east", "grid north", "up")
    assert frame["scale"] == {
        "lowest": pytest.approx(min(scale)),
        "highest": pytest.approx(max(scale)),
        "is_in_heights": False,
        "is_in_principal_distance": False,
    }
    assert rows[0]["omega_deg"] != ""


def test_axis_order_of_a_system_and_of_the_file(block):
    """EPSG has this UTM zone also with its axes to the north and east; the file has x first."""
    run = in_grid(block, "EPSG:3044", "opk")
    positions = frame_record(FORMATS["opk"].frame(run, {}))["positions"]
    assert positions["axes"][:2] == ("east", "north")
    assert positions["axis_order_of_crs"] == ("north", "east")


# ---------------------------------------------------------------- points and layers


def test_points_on_the_ground_with_their_shift(block, tmp_path):
    run = in_grid(block, "EPSG:25832", "points")
    path, count, ledger = written(run, "points", tmp_path)
    rows = rows_of(path)
    assert count == len(rows) == 2
    assert [(e.kind, e.code, e.count) for e in ledger] == [("loss", "EXPORT-LEFT-OUT", 1)]
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    for station, row in enumerate(rows):
        step = GROUND_STEPS[station]
        true = np.array(to_grid.transform(*place_on_ground(station, step)))
        apparent = np.array(to_grid.transform(*place_on_ground(station, step - SHIFT_EN[station])))
        assert [float(row["x_m"]), float(row["y_m"])] == pytest.approx(true, abs=0.02)
        shift = [float(row["shift_x_m"]), float(row["shift_y_m"])]
        assert shift == pytest.approx(true - apparent, abs=1e-3)
        assert float(row["shift_m"]) == pytest.approx(np.hypot(*SHIFT_EN[station]), rel=1e-3)
        assert float(row["z_m"]) == pytest.approx(GROUND + UNDULATION)
        assert (row["image"], row["point"]) == (["a,1.tif", "b.tif"][station], f"p{station}")


def test_points_in_degrees_have_the_shift_to_the_east_and_north(block, tmp_path):
    path, _, _ = written(in_grid(block, "EPSG:4326", "points"), "points", tmp_path)
    for station, row in enumerate(rows_of(path)):
        lon, lat = place_on_ground(station, GROUND_STEPS[station])
        assert float(row["lon_deg"]) == pytest.approx(lon, abs=2e-7)
        assert float(row["lat_deg"]) == pytest.approx(lat, abs=2e-7)
        shift = [float(row["shift_x_m"]), float(row["shift_y_m"])]
        assert shift == pytest.approx(SHIFT_EN[station], abs=1e-3)


def test_the_scale_of_a_grid_is_not_in_the_shift(block, tmp_path):
    """Web Mercator is half as long again at 47 degrees; a state plane counts in feet."""
    path, _, _ = written(in_grid(block, "EPSG:3857", "points"), "points", tmp_path)
    lengths = [float(row["shift_m"]) for row in rows_of(path)]
    assert lengths == pytest.approx(np.hypot(*SHIFT_EN.T), rel=1e-3)


def test_a_geopackage_read_by_gdal(block, tmp_path):
    path, count, _ = written(
        in_grid(block, "EPSG:25832+5773", "geopackage"), "geopackage", tmp_path
    )
    layers = dict(pyogrio.list_layers(path))
    assert set(layers) >= {"stations", "footprints", "points"}
    stations, grounds, points = (
        geopandas.read_file(path, layer=name) for name in ("stations", "footprints", "points")
    )
    assert count == len(stations) + len(grounds) + len(points) == 3 + 3 + 2
    assert pyproj.CRS(stations.crs).sub_crs_list[0].to_epsg() == 25832
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    np.testing.assert_allclose(
        np.stack([stations.geometry.x, stations.geometry.y]), to_grid.transform(LON, LAT)
    )
    np.testing.assert_allclose(stations.geometry.z, H_MSL)
    np.testing.assert_allclose(points.geometry.z, GROUND)
    assert stations["time_utc"].iloc[0].isoformat().startswith("2025-06-12T09:00:00.500")
    # The nadir image: 2600 m above ground, 900 px: the corners are 2600 * 500 / 900 m away.
    west, _, east, _ = grounds.geometry.iloc[0].bounds
    centre = to_grid.transform(LON[0], LAT[0])
    assert 0.5 * (west + east) == pytest.approx(centre[0], abs=5.0)
    assert np.sqrt(grounds.geometry.iloc[0].area) == pytest.approx(
        2600.0 / 900.0 * np.sqrt(1000.0 * 800.0), rel=1e-3
    )
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA application_id").fetchone() == (0x47504B47,)
        box = database.execute(
            "SELECT min_x, max_y FROM gpkg_contents WHERE table_name = 'points'"
        ).fetchone()
        assert box == pytest.approx((points.total_bounds[0], points.total_bounds[3]))


def test_the_styles_are_those_that_qgis_takes_by_itself(block, tmp_path):
    """The query of QGIS's provider; arrows by the columns of the shift, 95 % up to 8 mm."""
    path, _, _ = written(in_grid(block, "EPSG:25832", "geopackage"), "geopackage", tmp_path)
    query = (
        "SELECT styleQML FROM layer_styles WHERE f_table_schema='' AND f_table_name=? AND "
        "f_geometry_column='geom' ORDER BY CASE WHEN useAsDefault THEN 1 ELSE 2 END, update_time "
        "DESC LIMIT 1"
    )
    with closing(sqlite3.connect(path)) as database:
        styles = {
            name: ET.fromstring(database.execute(query, (name,)).fetchone()[0])
            for name in ("points", "footprints", "stations")
        }
        columns = {row[1] for row in database.execute("PRAGMA table_info(points)")}
    kinds = {name: style.find(".//symbol").get("type") for name, style in styles.items()}
    assert kinds == {"points": "marker", "footprints": "fill", "stations": "marker"}
    (field,) = styles["points"].findall(".//layer[@class='VectorField']")
    settings = {of.get("k"): of.get("v") for of in field.findall("prop")}
    assert {settings["x_attribute"], settings["y_attribute"]} == {"shift_x_m", "shift_y_m"}
    assert {"shift_x_m", "shift_y_m"} <= columns
    longest = np.quantile(np.hypot(*SHIFT_EN.T), 0.95)
    assert float(settings["scale"]) == pytest.approx(8.0 / longest, rel=1e-3)


def test_a_run_without_corrected_points_has_empty_layers(block, tmp_path):
    path, count, _ = written(
        replace(in_grid(block, "EPSG:25832", "geopackage"), parts=()), "geopackage", tmp_path
    )
    assert count == 6
    assert len(geopandas.read_file(path, layer="points")) == 0


# ---------------------------------------------------------------- the frame of every export


def test_every_format_states_its_frame(block):
    """As fields that a program can read; none of the values is a sentence."""
    for name, form in FORMATS.items():
        run = block
        if form.grid is not None and form.grid.default:
            run = in_grid(block, form.grid.default, name)
        record = json.loads(json.dumps(frame_record(form.frame(run, form.values({})))))
        assert set(record) == {"positions", "angles", "scale", "pixels", "ground_heights"}
        assert any(record.values()), name
        if record["positions"] is not None:
            assert len(record["positions"]["units"]) == len(record["positions"]["axes"]) == 3
            assert record["positions"]["height_reference"]
        if record["angles"] is not None:
            assert record["angles"]["turns"] in {"camera to frame", "frame to camera"}
        has_origin = (record["positions"] or {}).get("kind") == "topocentric"
        assert has_origin == bool((record["positions"] or {}).get("origin")), name


def test_the_origin_of_a_block_is_that_of_its_file(block, tmp_path):
    path, _, _ = written(block, "opk-enu", tmp_path)
    row = rows_of(path)[0]
    origin = frame_record(FORMATS["opk-enu"].frame(block, {}))["positions"]["origin"]
    for name, column in (
        ("latitude_deg", "origin_lat_deg"),
        ("longitude_deg", "origin_lon_deg"),
        ("h_ellipsoid_m", "origin_h_ellipsoid_m"),
    ):
        assert origin[name] == float(row[column])


def test_quarter_turns_of_bingo_turn_the_axes_of_its_frame(block):
    frames = [
        FORMATS["bingo"].frame(block, {"quarter_turns": turns}).pixels.axes for turns in range(4)
    ]
    assert frames == [("right", "up"), ("up", "left"), ("left", "down"), ("down", "right")]


# ---------------------------------------------------------------- the command


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
    use = [entry["what"] for entry in answer["ledger"] if entry["code"] == "EXPORT-USE"]
    assert "map projection" in use[0]
    unbend("export", baseline.output, "--format", "opk", "--out", tmp_path / "p.csv")
    head = (tmp_path / "p.csv").read_text(encoding="utf-8").partition("\n")[0].split(",")
    beside = json.loads((tmp_path / "p.csv.unbend.json").read_text(encoding="utf-8"))
    assert head.index("lat_deg") < head.index("lon_deg")
    assert beside["frame"]["positions"]["axes"] == ["latitude", "longitude", "height"]
    for name in ("points", "geopackage"):
        file = tmp_path / f"x{FORMATS[name].ending}"
        ended = unbend("export", baseline.output, "--format", name, "--out", file)
        assert ended.code == 0, ended.text
        beside = json.loads((tmp_path / f"{file.name}.unbend.json").read_text(encoding="utf-8"))
        assert beside["frame"]["positions"]["crs"] == "EPSG:4326"


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("--format", "kml", "--crs", "EPSG:25832"), "EXPORT-OPTION", "opk, geopackage, points"),
        (("--format", "colmap", "--crs", "EPSG:25832"), "EXPORT-OPTION", "has a fixed frame"),
        (("--format", "opk", "--geoid", "g.gtx"), "EXPORT-OPTION", "not given"),
        (("--format", "opk", "--crs", "EPSG:4326"), "EXPORT-CRS", "without --crs"),
        (("--format", "opk", "--crs", "EPSG:3857"), "EXPORT-CRS", "UTM zone"),
        (("--format", "points", "--crs", "EPSG:32760"), "EXPORT-CRS", "its UTM zone"),
    ],
)
def test_what_does_not_fit_is_refused(unbend, baseline, tmp_path, options, code, said):
    ending = FORMATS[options[1]].ending
    ended = unbend("export", baseline.output, *options, "--out", tmp_path / f"o{ending}")
    assert ended.code == 2, ended.text
    assert code in ended.err
    assert said in " ".join(ended.err.split())
    assert not list(tmp_path.iterdir())


def test_a_station_that_the_grid_does_not_reach_is_not_in_its_frame(block):
    """It is left out of the table, and says nothing of convergence and scale of the others."""
    near = in_grid(block, "EPSG:32632", "opk")
    lon_rad = block.stations.lon_rad.copy()
    lon_rad[2] = np.radians(99.0)  # 90 degrees from the meridian of the zone
    stations = replace(near.stations, lat_rad=near.stations.lat_rad * [1, 1, 0], lon_rad=lon_rad)
    frame = FORMATS["opk"].frame(replace(near, stations=stations), {})
    assert np.isfinite(frame.angles.convergence_deg).all()
    assert 0.999 < frame.scale.lowest <= frame.scale.highest < 1.001
