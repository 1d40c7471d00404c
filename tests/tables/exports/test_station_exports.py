"""Stations and footprints as KML, GeoJSON and omega, phi, kappa, read by other programs.

Truth: PROJ for places and frames, GDAL for the files, Wolf and Dewitt's matrix element by element.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import geopandas
import numpy as np
import pyarrow.parquet as pq
import pyproj
import pytest
import yaml
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun
from unbend.tables.pixels import PixelSystem

CAMERA = Camera(1000, 800, 900.0, 880.0, 510.0, 395.0, BrownConrady(k1=-0.02, p1=1e-3))
CORNERS = np.array([[0.0, 0.0], [0.0, 800.0], [1000.0, 800.0], [1000.0, 0.0]])
NAMES = ["a,b.tif", '<c> & "d".tif', "e\x01.tif", "over the horizon", "nowhere"]
LAT = [47.0, 47.05, -33.0, 47.0, np.nan]
LON = [8.0, 8.1, 179.999, 8.0, np.nan]
H_MSL = 3000.0
UNDULATION = 48.0
GROUND = 400.0
DOWN = np.diag([1.0, -1.0, -1.0])
# Level to the north; yawed, banked; to the east near the 180th meridian; far too oblique.
TURNS = [
    DOWN,
    Rotation.from_euler("zyx", [70.0, -20.0, 15.0], degrees=True).as_matrix() @ DOWN,
    Rotation.from_euler("z", 90.0, degrees=True).as_matrix() @ DOWN,
    Rotation.from_euler("x", 75.0, degrees=True).as_matrix() @ DOWN,
    np.full((3, 3), np.nan),
]
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)


@pytest.fixture(scope="module")
def run() -> FinishedRun:
    n = len(NAMES)
    status = np.array(["ok", "suspect", "ok", "ok", "in_gap"], object)
    quaternion = np.full((n, 4), np.nan)
    quaternion[:4] = Rotation.from_matrix(TURNS[:4]).as_quat(canonical=True, scalar_first=True)
    air = standard_atmosphere("us1976")
    stations = replace(
        empty_stations(np.array(NAMES, object), np.full(n, "nadir", object), "ok"),
        status=status,
        time_ns=np.full(n, 1_749_718_800_500_000_000),
        lat_rad=np.radians(LAT),
        lon_rad=np.radians(LON),
        h_msl_m=np.full(n, H_MSL),
        h_ellipsoid_m=np.full(n, H_MSL + UNDULATION),
        quaternion=quaternion,
        sigma_horizontal_m=np.full(n, 0.5),
        sigma_tilt_rad=np.full(n, np.radians(0.25)),
        suspect_reason=np.array(["", "no fix", "", "", ""], object),
        suspect_m=np.array([np.nan, 77.0, np.nan, np.nan, np.nan]),
    )
    outside = air.refractivity(stations.h_msl_m)
    usable = np.array([True, True, True, True, False])  # as where suspect ones are used
    return FinishedRun(
        "<survey>",
        stations,
        Exposures(usable, np.array(TURNS), stations.lat_rad, stations.h_msl_m, outside, outside),
        constant_series(TimedProfile(None, air), n),
        (rays_by(air, "spherical"),),
        "spherical",
        {"nadir": ExportCamera(CAMERA, False)},
        lambda _: np.full(n, GROUND),
        PixelSystem("corner"),
        (),
        {},
    )


def written(run, name, folder):
    form = FORMATS[name]
    ledger = Ledger()
    path = folder / f"out{form.ending}"
    return path, form.write(run, form.values({}), path, ledger), ledger


def assert_shows(corners: np.ndarray, station: int) -> None:
    """The ground at the corners of a footprint is what the corners of the image see."""
    lon = corners[:, 0]
    lat = corners[:, 1]
    ground = np.stack(TO_ECEF.transform(lon, lat, np.full(4, GROUND + UNDULATION)), axis=1)
    place = LON[station], LAT[station], H_MSL + UNDULATION
    step = ground - np.array(TO_ECEF.transform(*place))
    enu = Rotation.from_euler("ZX", [90.0 + place[0], 90.0 - place[1]], degrees=True).inv()
    rays = enu.apply(step) @ TURNS[station].T
    x, y = CAMERA.project(rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2])
    np.testing.assert_allclose(np.stack([x, y], axis=1), CORNERS, atol=0.1)


# ---------------------------------------------------------------- places and footprints


def test_geojson_read_by_gdal(run, tmp_path):
    path, count, ledger = written(run, "geojson", tmp_path)
    frame = geopandas.read_file(path)
    assert count == len(frame) == 4 + 3
    assert frame.crs.to_epsg() == 4326
    stations = frame[frame["kind"] == "station"]
    assert stations["image"].tolist() == NAMES[:4]
    np.testing.assert_allclose(stations.geometry.x, LON[:4], rtol=1e-12)
    np.testing.assert_allclose(stations.geometry.y, LAT[:4], rtol=1e-12)
    np.testing.assert_allclose(stations.geometry.z, H_MSL + UNDULATION)
    assert stations["status"].tolist() == ["ok", "suspect", "ok", "ok"]
    assert stations["suspect_m"].iloc[1] == 77.0
    grounds = frame[frame["kind"] == "footprint"]
    assert grounds["image"].tolist() == NAMES[:3]
    for station, polygon in enumerate(grounds.geometry):
        assert polygon.exterior.is_ccw, "RFC 7946, 3.1.6"
        assert_shows(np.array(polygon.exterior.coords)[:4, :2], station)
    # Across the 180th meridian the polygon stays in one piece.
    assert grounds.geometry.iloc[2].bounds[2] > 180.0
    assert [(e.kind, e.code, e.count) for e in ledger] == [
        ("loss", "EXPORT-NO-GROUND", 1),
        ("loss", "EXPORT-LEFT-OUT", 1),
    ]
    times = {f["properties"].get("time_utc") for f in json.loads(path.read_text())["features"]}
    assert times == {"2025-06-12T09:00:00.500000000Z", None}


def test_a_footprint_by_hand(run, tmp_path):
    """From 2600 m above ground 400 px left of the middle are 2600 * 510 / 900 m, less the lens."""
    straight = replace(
        run, cameras={"nadir": ExportCamera(replace(CAMERA, distortion=(BrownConrady())), False)}
    )
    path, _, _ = written(straight, "geojson", tmp_path)
    first = json.loads(path.read_text())["features"][1]["geometry"]["coordinates"][0]
    azimuth, _, distance = pyproj.Geod(ellps="WGS84").inv(8.0, 47.0, *first[0])
    east = 2600.0 * 510.0 / 900.0
    north = 2600.0 * 395.0 / 880.0
    assert distance == pytest.approx(np.hypot(east, north), rel=3e-4)
    assert azimuth == pytest.approx(np.degrees(np.arctan2(-east, north)), abs=0.02)


def test_heights_that_are_not_known(run, tmp_path):
    """Without the ellipsoid no third coordinate; without ground no footprint, and a loss."""
    n = len(NAMES)
    at = replace(run.stations, h_ellipsoid_m=np.full(n, np.nan))
    path, count, ledger = written(
        replace(run, stations=at, find_ground=lambda _: np.full(n, np.nan)), "geojson", tmp_path
    )
    features = json.loads(path.read_text())["features"]
    assert count == 4
    assert features[0]["geometry"]["coordinates"] == pytest.approx([8.0, 47.0])
    assert "NaN" not in path.read_text()
    assert ("EXPORT-NO-GROUND", 4) in [(e.code, e.count) for e in ledger]
    _, count, ledger = written(replace(run, stations=at), "opk", tmp_path)
    assert count == 0
    assert [(e.code, e.count) for e in ledger] == [("EXPORT-LEFT-OUT", n)]


def test_kml_read_by_gdal(run, tmp_path):
    """Heights of KML count from the sea; names survive, control characters do not."""
    path, count, ledger = written(run, "kml", tmp_path)
    stations, grounds = (geopandas.read_file(path, layer=n) for n in ("stations", "footprints"))
    assert count == len(stations) + len(grounds) == 4 + 3
    assert stations["Name"].tolist() == [*NAMES[:2], "e\ufffd.tif", NAMES[3]]
    np.testing.assert_allclose(stations.geometry.x, LON[:4], rtol=1e-9)
    np.testing.assert_allclose(stations.geometry.y, LAT[:4], rtol=1e-9)
    np.testing.assert_allclose(stations.geometry.z, H_MSL)
    column = "description" if "description" in stations else "Description"
    assert stations[column].tolist()[1] == "nadir, suspect, no fix"
    for station, polygon in enumerate(grounds.geometry):
        assert_shows(np.array(polygon.exterior.coords)[:4, :2], station)
    text = path.read_text(encoding="utf-8")
    assert "<altitudeMode>absolute</altitudeMode>" in text
    assert "<when>2025-06-12T09:00:00.500Z</when>" in text
    assert "&lt;survey&gt;" in text
    assert [e.code for e in ledger] == ["EXPORT-NO-GROUND", "EXPORT-LEFT-OUT"]


# ---------------------------------------------------------------- omega, phi, kappa


def wolf_and_dewitt(omega: float, phi: float, kappa: float) -> np.ndarray:
    """From the frame to the photo (x right, y up): Elements of Photogrammetry, Eq. C-33."""
    so = np.sin(omega)
    co = np.cos(omega)
    sp = np.sin(phi)
    cp = np.cos(phi)
    sk = np.sin(kappa)
    ck = np.cos(kappa)
    return np.array(
        [
            [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
            [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
            [sp, -so * cp, co * cp],
        ]
    )


def rows_of(run, name, folder):
    path, count, ledger = written(run, name, folder)
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert count == len(rows)
    return rows, ledger


def photo_of(row: dict[str, str]) -> np.ndarray:
    angles = np.radians([float(row[f"{name}_deg"]) for name in ("omega", "phi", "kappa")])
    return wolf_and_dewitt(*angles)


def test_angles_against_the_horizon_of_each_station(run, tmp_path):
    rows, ledger = rows_of(run, "opk", tmp_path)
    assert [row["image"] for row in rows] == [NAMES[0], *NAMES[2:4]]  # no suspect one
    for row, station in zip(rows, (0, 2, 3), strict=True):
        # The photo's y is up and its z backward.
        expected = np.diag([1.0, -1.0, -1.0]) @ TURNS[station]
        np.testing.assert_allclose(photo_of(row), expected, atol=1e-12)
        place = [float(row[name]) for name in ("lat_deg", "lon_deg", "h_ellipsoid_m")]
        assert place == pytest.approx([LAT[station], LON[station], H_MSL + UNDULATION])
    assert [(e.code, e.count) for e in ledger] == [("EXPORT-LEFT-OUT", 2)]
    assert [float(rows[1][f"sigma_{n}"]) for n in ("horizontal_m", "tilt_deg")] == [0.5, 0.25]
    # A suspect station that is used all the same is marked as such.
    used = replace(run.stations, accepted=np.array(run.stations.status == "suspect"))
    rows, _ = rows_of(replace(run, stations=used), "opk", tmp_path)
    assert [row["status"] for row in rows] == ["ok", "suspect", "ok", "ok"]
    assert "omega" in FORMATS["opk"].contents


def test_one_frame_for_the_block(run, tmp_path):
    """A ray of each image in the frame of the origin, against PROJ's topocentric coordinates."""
    near = replace(
        run,
        stations=replace(
            run.stations,
            lon_rad=np.radians([8.0, 8.1, 8.2, 8.0, np.nan]),
            lat_rad=np.radians([47.0, 47.05, 47.3, 47.0, np.nan]),
        ),
    )
    rows, _ = rows_of(near, "opk-enu", tmp_path)
    origin = [float(rows[0][f"origin_{n}"]) for n in ("lat_deg", "lon_deg", "h_ellipsoid_m")]
    assert origin == pytest.approx([47.15, 8.1, 3048.0], abs=1e-4)
    frame = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={origin[0]!r} +lon_0={origin[1]!r} +h_0={origin[2]!r}"
    )
    for row, station in zip(rows, (0, 2, 3), strict=True):
        lat, lon, h = (float(row[n]) for n in ("lat_deg", "lon_deg", "h_ellipsoid_m"))
        here = np.array(frame.transform(lon, lat, h))
        assert [float(row[n]) for n in ("x_m", "y_m", "z_m")] == pytest.approx(here, abs=1e-4)
        # One metre north of the station, in the camera by its own horizon and by the frame.
        step = np.degrees(1.0 / 6_367_000.0)
        north = np.array(frame.transform(lon, lat + step, h)) - here
        photo = photo_of(row) @ (north / np.linalg.norm(north))
        own = np.diag([1.0, -1.0, -1.0]) @ TURNS[station] @ np.array([0.0, 1.0, 0.0])
        np.testing.assert_allclose(photo, own, atol=2e-7)


def test_from_the_command_line(unbend, baseline, tmp_path):
    for name, ending in (("kml", "kml"), ("geojson", "geojson"), ("opk", "csv")):
        out = tmp_path / f"{name}.{ending}"
        ended = unbend("export", baseline.output, "--format", name, "--out", out)
        assert ended.code == 0, ended.text
        assert out.stat().st_size > 500
    help_text = " ".join(unbend("export", "--help").out.split())
    assert "geojson, kml stations and footprints" in help_text


@pytest.mark.usefixtures("plain_report")
def test_exported_orientations_are_read_again(unbend, baseline, tmp_path):
    """As the page says, with the columns of camera and time: the stations are those of the run."""
    exported = tmp_path / "opk.csv"
    unbend("export", baseline.output, "--format", "opk", "--out", exported)
    mission = yaml.safe_load((baseline.folder / "mission.yaml").read_text())
    for key in ("log", "mount", "events"):
        del mission[key]
    mission["observations"]["path"] = str(baseline.folder / mission["observations"]["path"])
    mission["stations"] = {
        "orientation": {
            "path": "opk.csv",
            "angles": "omega_phi_kappa",
            "frame": "geographic",
            "heights": "ellipsoid",
            "columns": {"camera": "camera", "time_utc": "time_utc"},
        }
    }
    for camera in mission["cameras"].values():
        camera.pop("window", None)
    mission["output"] = {"path": "results"}
    (tmp_path / "block.yaml").write_text(yaml.safe_dump(mission))
    ended = unbend("run", tmp_path / "block.yaml")
    assert ended.code == 0, ended.text
    one, other = (
        pq.read_table(folder / "stations.parquet").to_pandas().set_index("image").sort_index()
        for folder in (baseline.output, tmp_path / "results")
    )
    assert one.index.equals(other.index)
    tolerances = {"lat_deg": 1e-12, "h_ellipsoid_m": 1e-6, "q_w": 1e-12, "q_x": 1e-12}
    for name, tolerance in tolerances.items():
        np.testing.assert_allclose(other[name], one[name], rtol=0.0, atol=tolerance)
    assert (one["time_utc"] == other["time_utc"]).all()
