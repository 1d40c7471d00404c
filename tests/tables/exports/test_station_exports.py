"""Stations and footprints as KML, GeoJSON and omega, phi, kappa, read by other programs.

Truth: PROJ for places and frames, GDAL for the files, Wolf and Dewitt's matrix element by element.
"""

import json
from dataclasses import replace

import geopandas
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

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
from tests.tables.exports.projected_block import Frame
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import ExportCamera
from unbend.tables.exports.export_frames import origin_of

CAMERA = Camera(
    width_px=1000,
    height_px=800,
    fx_px=900.0,
    fy_px=880.0,
    cx_px=510.0,
    cy_px=395.0,
    distortion=BrownConrady(k1=-0.02, p1=1e-3),
)
CORNERS = [
    [0.0, 0.0],
    [0.0, 800.0],
    [1000.0, 800.0],
    [1000.0, 0.0],
]
NAMES = ["a,b.tif", '<c> & "d".tif', "e\x01.tif", "over the horizon", "nowhere"]
STATUS = ["ok", "suspect", "ok", "ok", "in_gap"]
COUNT = len(NAMES)
LAT = np.array([47.0, 47.05, -33.0, 47.0, np.nan])
LON = np.array([8.0, 8.1, 179.999, 8.0, np.nan])
H_MSL = 3000.0
H_ELLIPSOID = 3048.0
GROUND = 400.0
GROUND_ELLIPSOID = 448.0
# Level to the north; yawed, banked; to the east near the 180th meridian; far too oblique.
TURNED_FROM_DOWN = Rotation.from_euler(
    "zyx",
    [
        [0.0, 0.0, 0.0],
        [70.0, -20.0, 15.0],
        [90.0, 0.0, 0.0],
        [0.0, 0.0, 75.0],
    ],
    degrees=True,
)
TURNS = np.full((COUNT, 3, 3), np.nan)
TURNS[:4] = TURNED_FROM_DOWN.as_matrix() @ DOWN
OK = [0, 2, 3]  # stations that can be used, without the suspect one
NAMES_OF_OK = [NAMES[number] for number in OK]


@pytest.fixture(scope="module")
def run():
    status = np.array(STATUS, object)
    suspect_reason = np.full(COUNT, "", object)
    suspect_reason[1] = "no fix"
    suspect_m = np.full(COUNT, np.nan)
    suspect_m[1] = 77.0
    stations = stations_at(
        NAMES,
        "nadir",
        LON,
        LAT,
        H_MSL,
        H_ELLIPSOID,
        TURNS,
        status=status,
        time_ns=np.full(COUNT, 1_749_718_800_500_000_000),
        sigma_horizontal_m=np.full(COUNT, 0.5),
        sigma_tilt_rad=np.full(COUNT, np.radians(0.25)),
        suspect_reason=suspect_reason,
        suspect_m=suspect_m,
    )
    cameras = {"nadir": ExportCamera(CAMERA, False)}
    run = finished_run(stations, TURNS, cameras, GROUND, mission="<survey>")
    usable = status != "in_gap"  # as where suspect ones are used
    exposures = replace(run.exposures, usable=usable)
    return replace(run, exposures=exposures)


def assert_footprints_show_the_images(polygons):
    """The ground at the corners of each footprint is what the corners of its image see."""
    assert len(polygons) == 3
    for station, polygon in enumerate(polygons):
        lon, lat = polygon.exterior.coords.xy[:2]
        ground = ecef_of(lon[:4], lat[:4], [GROUND_ELLIPSOID] * 4)
        step = ground - ecef_of(LON[station], LAT[station], H_ELLIPSOID)
        axes = enu_axes(LON[station], LAT[station])
        x, y, z = TURNS[station] @ axes @ step.T
        pixels = CAMERA.project(x / z, y / z)
        assert_within(np.transpose(pixels), CORNERS, 0.1)


# ---------------------------------------------------------------- places and footprints


def assert_stations_of_four(stations, h_m, rtol):
    assert_allclose(stations.geometry.x, LON[:4], rtol=rtol)
    assert_allclose(stations.geometry.y, LAT[:4], rtol=rtol)
    assert_allclose(stations.geometry.z, h_m)


LOSSES = [
    ("loss", "EXPORT-NO-GROUND", 1),
    ("loss", "EXPORT-LEFT-OUT", 1),
]


def test_geojson_read_by_gdal(run):
    written = write_export(run, "geojson")

    features = geopandas.read_file(written.path)
    stations = features[features["kind"] == "station"]
    grounds = features[features["kind"] == "footprint"]

    assert written.count == len(features) == 4 + 3
    assert written.counts == LOSSES
    assert features.crs.to_epsg() == 4326
    assert stations["image"].tolist() == NAMES[:4]
    assert_stations_of_four(stations, H_ELLIPSOID, rtol=1e-12)
    assert stations["status"].tolist() == STATUS[:4]
    assert stations["suspect_m"].iloc[1] == 77.0
    assert grounds["image"].tolist() == NAMES[:3]
    assert (grounds["h_g_m"] == GROUND).all()
    assert_footprints_show_the_images(grounds.geometry)
    assert grounds.geometry.exterior.is_ccw.all(), "RFC 7946, 3.1.6"
    # Across the 180th meridian the polygon stays in one piece.
    assert grounds.geometry.iloc[2].bounds[2] > 180.0
    first = json.loads(written.path.read_text())["features"][0]
    assert first["properties"]["time_utc"] == "2025-06-12T09:00:00.500000000Z"


def test_heights_that_are_not_known(run):
    """Without the ellipsoid no third coordinate; without ground no footprint, and a loss."""
    unknown = np.full(COUNT, np.nan)
    stations = replace(run.stations, h_ellipsoid_m=unknown)
    flat = replace(run, stations=stations, find_ground=lambda _: unknown)

    written = write_export(flat, "geojson")
    angles = write_export(flat, "opk")

    text = written.path.read_text()
    first = json.loads(text)["features"][0]
    assert written.count == 4
    assert first["geometry"]["coordinates"] == pytest.approx([8.0, 47.0])
    assert "NaN" not in text
    assert ("loss", "EXPORT-NO-GROUND", 4) in written.counts
    assert angles.count == 0
    assert angles.counts == [("loss", "EXPORT-LEFT-OUT", COUNT)]


def test_kml_read_by_gdal(run):
    """Heights of KML count from the sea; names survive, control characters do not."""
    written = write_export(run, "kml")

    stations = geopandas.read_file(written.path, layer="stations")
    grounds = geopandas.read_file(written.path, layer="footprints")
    text = written.path.read_text("utf-8")

    assert written.count == len(stations) + len(grounds) == 4 + 3
    assert written.counts == LOSSES
    assert stations["Name"].tolist() == [*NAMES[:2], "e\ufffd.tif", NAMES[3]]
    assert_stations_of_four(stations, H_MSL, rtol=1e-9)
    descriptions = stations.filter(regex="(?i)^description$")
    assert descriptions.iloc[1, 0] == "nadir, suspect, no fix"
    assert_footprints_show_the_images(grounds.geometry)
    assert "<altitudeMode>absolute</altitudeMode>" in text
    assert "<when>2025-06-12T09:00:00.500Z</when>" in text
    assert "&lt;survey&gt;" in text


# ---------------------------------------------------------------- omega, phi, kappa


def rotations_to_photos(table):
    return [rotation_to_photo(row) for _, row in table.iterrows()]


def test_angles_against_the_horizon_of_each_station(run):
    written = write_export(run, "opk")

    table = written.table()
    assert table.image.tolist() == NAMES_OF_OK, "no suspect one"
    assert ",".join(table.columns) == (
        "image,camera,status,time_utc,lat_deg,lon_deg,h_ellipsoid_m,omega_deg,phi_deg,kappa_deg,"
        "sigma_horizontal_m,sigma_height_m,sigma_tilt_deg,sigma_yaw_deg"
    )
    assert table.camera.tolist() == ["nadir"] * 3
    # The photo's y is up and its z backward.
    assert_within(rotations_to_photos(table), DOWN @ TURNS[OK], 1e-12)
    assert table.lat_deg.tolist() == pytest.approx(LAT[OK], rel=1e-14)
    assert table.lon_deg.tolist() == pytest.approx(LON[OK], rel=1e-14)
    assert (table.h_ellipsoid_m == H_ELLIPSOID).all()
    assert (table.sigma_horizontal_m == 0.5).all()
    assert table.sigma_tilt_deg.tolist() == pytest.approx([0.25] * 3)
    assert written.counts == [("loss", "EXPORT-LEFT-OUT", 2)]


def test_a_suspect_station_that_is_used_is_marked(run):
    accepted = np.array(run.stations.status == "suspect")
    stations = replace(run.stations, accepted=accepted)

    written = write_export(replace(run, stations=stations), "opk")

    assert written.table().status.tolist() == STATUS[:4]


@pytest.mark.parametrize(
    ("lat", "lon", "h", "origin"),
    [
        pytest.param(
            [10.0, 20.0, 10.0],
            [5.0, 6.0, 5.0],
            [100.0, 300.0, 100.0],
            [15.0, 5.5, 200.0],
            id="middle, not mean",
        ),
        pytest.param(
            [47.0, 47.000013],
            [8.0, 8.000007],
            [100.0, 301.3],
            [47.00001, 8.0, 201.0],
            id="rounded",
        ),
        pytest.param(
            [-17.0, -16.0],
            [179.99, -179.97],
            [0.0, 0.0],
            [-16.5, 180.01, 0.0],
            id="across 180 degrees",
        ),
        pytest.param(
            [-17.0, -16.0],
            [-179.97, 179.99],
            [0.0, 0.0],
            [-16.5, -179.99, 0.0],
            id="across it from the other side",
        ),
    ],
)
def test_the_origin_is_the_middle(lat, lon, h, origin):
    middle = origin_of(np.radians(lat), np.radians(lon), np.array(h))
    assert_within(middle, origin, 1e-9)


def test_positions_and_angles_in_one_frame(block):
    """Against PROJ's topocentric coordinates, turned by hand."""
    table = write_export(block.run(), "opk-enu").table()

    origin = table.loc[0, ["origin_lat_deg", "origin_lon_deg", "origin_h_ellipsoid_m"]]
    frame = Frame(origin)
    middle_m = round(0.5 * (block.h.min() + block.h.max()))
    assert frame.origin == pytest.approx([47.005, 8.075, middle_m], abs=1e-9)
    assert_within(table[["x_m", "y_m", "z_m"]], frame(block.centre), 1e-6)
    turns = block.turn @ block.axes(frame)
    assert_within(rotations_to_photos(table), DOWN @ turns, 1e-8)
