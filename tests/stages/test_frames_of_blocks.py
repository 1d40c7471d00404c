"""Missions whose block says, or is said to have, another frame than its files know of places."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from tests.small_block import SmallBlock, SmallRig, ecef, enu_axes, largest_difference
from tests.stages.small_missions import ORIGIN, enu_at, mission_of, refusal, rows_of, run
from unbend.batch.results import read_manifest
from unbend.report.summary import verdict
from unbend.tables.imports.blocks import block_reader

GEODETIC_TO_UTM = pyproj.Transformer.from_crs(4979, 32632, always_xy=True)
UTM_OFFSET = (286_800.0, 5_203_300.0)


@pytest.fixture
def block():
    return SmallBlock.make()


def assert_true(stations: pd.DataFrame, block: SmallBlock) -> None:
    """The stations are where the images of the block were taken."""
    away_m, turned_deg = largest_difference(stations, block)
    assert away_m < 1e-3
    assert turned_deg < 1e-5


# ---- OpenSfM and ODM


def write_coords(folder) -> None:
    """What ODM writes of the UTM of a reconstruction."""
    (folder / "odm_georeferencing").mkdir()
    text = f"WGS84 UTM 32N\n{UTM_OFFSET[0]} {UTM_OFFSET[1]}\n"
    (folder / "odm_georeferencing" / "coords.txt").write_text(text)


def odm_transformation(block: SmallBlock) -> np.ndarray:
    """(3, 4) from east, north, up to UTM minus an offset, by differences over a metre."""
    to_geodetic = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
    corners = np.vstack([np.zeros(3), np.eye(3)]) @ enu_axes(*block.origin[:2])
    geodetic = to_geodetic.transform(*(ecef(*block.origin) + corners).T)
    places = np.stack(GEODETIC_TO_UTM.transform(*geodetic), axis=1) - [*UTM_OFFSET, 0.0]
    return np.column_stack([(places[1:] - places[0]).T, places[0]])


@pytest.fixture
def odm(tmp_path):
    """A project of ODM's far from the meridian of its zone: its reconstruction is in UTM."""
    block = SmallBlock.make(46.95, 6.2)
    block.write_opensfm(tmp_path / "opensfm", linear=odm_transformation(block))
    write_coords(tmp_path)
    return block, tmp_path


OPENSFM = mission_of("opensfm", "opensfm", heights="ellipsoid")


def test_the_topocentric_reconstruction_of_odm_is_read(odm):
    block, folder = odm
    block.write_opensfm(folder / "opensfm", name="reconstruction.topocentric.json")
    stations, messages = run(folder, OPENSFM)
    assert_true(stations, block)
    assert messages["BLOCK-ODM"]["kind"] == "note"
    assert messages["FRAME-CONFIRMED"]["kind"] == "note"


def test_the_utm_of_odm_is_refused(odm):
    """By coords.txt and gps_position, or by the file that ODM leaves."""
    _, folder = odm
    text = refusal(folder, OPENSFM, "ORIENTATION-FRAME")
    assert "coords.txt" in text
    assert "reconstruction.topocentric.json" in text
    (folder / "odm_georeferencing" / "coords.txt").unlink()
    (folder / "opensfm" / "exported_geocoords.txt").touch()
    assert "exported_geocoords.txt" in refusal(folder, OPENSFM, "ORIENTATION-FRAME")


def test_utm_without_odm_is_a_finding(odm):
    """Nothing but gps_position tells."""
    _, folder = odm
    (folder / "odm_georeferencing" / "coords.txt").unlink()
    _, messages = run(folder, OPENSFM, 3)
    assert messages["FRAME-PLACES"]["kind"] == "finding"
    # The convergence at 6.2 deg east of a zone about 9.
    assert "turned by 2.0" in messages["FRAME-PLACES"]["what"]


def test_inputs_hold_what_a_frame_rests_on(odm):
    """coords.txt is hashed with the project."""
    _, folder = odm
    files = block_reader("opensfm").block_files(folder / "opensfm")
    names = {file.name for file in files}
    assert names == {"reconstruction.json", "tracks.csv", "reference_lla.json", "coords.txt"}


@pytest.fixture
def opensfm(block, tmp_path):
    block.write_opensfm(tmp_path / "opensfm")
    return tmp_path


def test_east_north_up_beside_coords_of_odm_is_read(block, opensfm):
    """As older ODM left it."""
    write_coords(opensfm)
    stations, messages = run(opensfm, OPENSFM)
    assert_true(stations, block)
    assert "BLOCK-ODM" not in messages


def test_altitudes_of_opensfm_may_be_above_the_sea(block, opensfm):
    """Whether they are has to be said; corrections are those of the same block by COLMAP."""
    mission = mission_of("opensfm", "opensfm")
    assert "give heights (msl or ellipsoid)" in refusal(opensfm, mission, "CONFIG-INVALID")
    mission["mission"]["undulation_m"] = 47.6
    mission["stations"]["orientation"]["heights"] = "msl"
    reference = opensfm / "opensfm" / "reference_lla.json"
    reference.write_text(reference.read_text().replace('"altitude": 0.0', '"altitude": -47.6'))
    stations, _ = run(opensfm, mission)
    # The frame is laid 47.6 m deeper: 0.6 km are 4 mm shorter there.
    assert largest_difference(stations, block)[0] < 0.005
    by_opensfm = rows_of(opensfm)
    block.write_colmap(opensfm / "sparse")
    mission["observations"] = {"path": "sparse", "format": "colmap"}
    mission["stations"]["orientation"] = {"frame": ORIGIN, "date": "2026-05-14"}
    run(opensfm, mission)
    by_colmap = rows_of(opensfm).set_index(["image", "point"])
    rows = by_colmap.loc[list(zip(by_opensfm["image"], by_opensfm["point"], strict=True))]
    shift = rows["x_corrected_px"] - rows["x_px"]
    assert np.abs(shift).max() > 0.01
    for column in ("x_corrected_px", "y_corrected_px"):
        np.testing.assert_allclose(by_opensfm[column], rows[column], rtol=0.0, atol=2e-6)


def test_a_project_without_a_reference_has_no_frame(opensfm):
    (opensfm / "opensfm" / "reference_lla.json").unlink()
    assert "stations.orientation.frame: ecef" in refusal(opensfm, OPENSFM, "ORIENTATION-FRAME")


@pytest.mark.parametrize(("h", "is_told"), [(0.0, False), (1.0, True)])
def test_a_stated_frame_holds_and_a_contradiction_is_told(block, opensfm, h, is_told):
    mission = mission_of("opensfm", "opensfm", frame=enu_at(46.95, 7.45, h))
    stations, messages = run(opensfm, mission)
    assert largest_difference(stations, block)[0] == pytest.approx(h, abs=1e-3)
    assert ("IMPORT-CONTRADICTED" in messages) == is_told


# ---- COLMAP


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scale": 1 / 0.3048}, "multiplied by 0.3048"),
        ({"turn": Rotation.from_euler("y", 6.0, degrees=True).as_matrix()}, "tilted by"),
    ],
    ids=["feet", "tilted"],
)
def test_pose_priors_tell_a_model_in_feet_or_tilted(block, tmp_path, changed, words):
    block.write_colmap(tmp_path / "sparse", **changed)
    priors = np.stack([block.lat, block.lon, block.h - 47.0], axis=1)
    _, messages = run(tmp_path, with_priors(block, tmp_path, priors), 3)
    assert words in messages["FRAME-PLACES"]["what"]
    assert "pose priors of 12 images" in messages["FRAME-PLACES"]["what"]


def with_priors(block, folder, priors: np.ndarray, system: int = 0) -> dict:
    """A mission by a database that has priors in a system: 0 is WGS 84, 1 is Cartesian."""
    block.write_colmap_database(folder / "database.db", known=priors, system=system)
    return mission_of("database.db", "colmap", path="sparse", format="colmap", frame=ORIGIN)


@pytest.mark.parametrize("system", [0, 1])
def test_pose_priors_confirm_a_right_model(block, tmp_path, system):
    block.write_colmap(tmp_path / "sparse")
    priors = np.stack([block.lat, block.lon, block.h - 47.0], axis=1)
    if system == 1:
        priors, _, _ = block.in_enu()
    stations, messages = run(tmp_path, with_priors(block, tmp_path, priors, system))
    assert_true(stations, block)
    assert "FRAME-CONFIRMED" in messages


def known_positions(block, folder) -> dict:
    table = {"image": block.names, "latitude": block.lat, "longitude": block.lon, "height": block.h}
    pd.DataFrame(table).to_csv(folder / "known.csv", index=False)
    return {"path": "known.csv"}


def test_known_positions_are_compared_with_a_stated_frame(block, tmp_path):
    block.write_colmap(tmp_path / "sparse", scale=0.01)
    mission = mission_of("sparse", "colmap", frame=ORIGIN)
    _, messages = run(tmp_path, mission)
    assert messages["FRAME-UNVERIFIED"]["kind"] == "warning"
    assert "12 images are within 11 m" in messages["FRAME-UNVERIFIED"]["what"]
    text = verdict(read_manifest(tmp_path / "results"))
    assert "not needed here, if the frame of the block is right (nothing confirms it)" in text
    mission["stations"]["orientation"]["known_positions"] = known_positions(block, tmp_path)
    _, messages = run(tmp_path, mission, 3)
    assert "multiplied by 100" in messages["FRAME-PLACES"]["what"]


def test_a_model_in_an_unknown_frame(block, tmp_path):
    """The block turned and 50 times smaller, fitted to the known places of its images."""
    turn = Rotation.from_euler("xyz", [70.0, -40.0, 150.0], degrees=True).as_matrix()
    block.write_colmap(tmp_path / "sparse", scale=0.02, turn=turn)
    places = known_positions(block, tmp_path) | {"sigma_m": 0.05}
    mission = mission_of(
        "sparse", "colmap", frame="unknown", heights="ellipsoid", known_positions=places
    )
    mission["mission"]["undulation_m"] = 47.6
    stations, messages = run(tmp_path, mission)
    assert "12 known positions" in messages["ORIENTATION-FIT"]["what"]
    assert_true(stations, block)
    rows = rows_of(tmp_path)
    assert (rows["status"] == "ok").all()
    height_of_point = dict(zip(map(str, range(1, 61)), block.point_h - 47.6, strict=True))
    h_g = rows["point"].map(height_of_point)
    np.testing.assert_allclose(rows["h_g_m"], h_g, atol=1e-3)
    from_median = h_g - h_g.groupby(rows["image"]).transform("median")
    ground = messages["GROUND-BLOCK"]["values"]
    assert ground["low"] == pytest.approx(h_g.min(), abs=1e-3)
    assert ground["high"] == pytest.approx(h_g.max(), abs=1e-3)
    assert ground["apart"] == pytest.approx(from_median.abs().median(), abs=1e-3)


# ---- Metashape

LV95 = (
    'PROJCS["CH1903+ / LV95",GEOGCS["CH1903+",DATUM["CH1903+",SPHEROID["Bessel 1841",6377397.155,'
    '299.1528128,AUTHORITY["EPSG","7004"]],TOWGS84[674.374,15.056,405.346,0,0,0,0],'
    'AUTHORITY["EPSG","6150"]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],'
    'AUTHORITY["EPSG","4150"]],PROJECTION["Hotine_Oblique_Mercator_Azimuth_Center"],'
    'PARAMETER["latitude_of_center",46.9524055555556],PARAMETER["longitude_of_center",'
    '7.43958333333333],PARAMETER["azimuth",90],PARAMETER["rectified_grid_angle",90],'
    'PARAMETER["scale_factor",1],PARAMETER["false_easting",2600000],'
    'PARAMETER["false_northing",1200000],UNIT["metre",1],AUTHORITY["EPSG","2056"]]'
)
TO_WGS84_OF_LV95 = np.array([674.374, 15.056, 405.346])  # m, published by swisstopo


def chunk_mission(**orientation) -> dict:
    mission = mission_of("s.xml", "metashape", **orientation)
    return mission | {"ground": {"height": 530, "reference": "ellipsoid"}}


@pytest.mark.parametrize("orientation", [{"frame": "ecef"}, {"heights": "ellipsoid"}])
def test_a_chunk_in_a_national_datum(block, tmp_path, orientation):
    block.write_metashape(tmp_path / "s.xml", shift=-TO_WGS84_OF_LV95, reference=LV95)
    stations, messages = run(tmp_path, chunk_mission(**orientation))
    assert_true(stations, block)
    assert "CH1903+" in messages["CRS-DATUM"]["what"]
    assert "FRAME-UNVERIFIED" in messages


def test_heights_above_the_sea_stay_what_a_national_chunk_was_given(block, tmp_path):
    """The program took them for heights above Bessel's ellipsoid."""
    block.write_metashape(tmp_path / "s.xml", shift=-TO_WGS84_OF_LV95, reference=LV95)
    mission = chunk_mission(heights="msl") | {"ground": {"height": 480, "reference": "msl"}}
    stations, _ = run(tmp_path, mission)
    in_lv95 = ecef(block.lat, block.lon, block.h) - TO_WGS84_OF_LV95
    bessel = pyproj.Transformer.from_pipeline("+proj=cart +ellps=bessel +inv")
    _, _, h = bessel.transform(*in_lv95.T)
    np.testing.assert_allclose(stations["h_msl_m"], h, atol=0.05)
    np.testing.assert_allclose(stations["lat_deg"], block.lat, atol=1e-8)


@pytest.mark.parametrize(
    ("moved_m", "code", "expected"), [(0.0, 0, "FRAME-CONFIRMED"), (300.0, 3, "FRAME-PLACES")]
)
def test_the_reference_of_a_chunk_is_compared_with_its_cameras(
    block, tmp_path, moved_m, code, expected
):
    """Cameras in UTM: x and y change places, and the middle of the block is elsewhere."""
    x, y = GEODETIC_TO_UTM.transform(block.lon, block.lat)
    cameras = np.stack([x + moved_m, y, block.h], axis=1)
    block.write_metashape(tmp_path / "s.xml", reference="EPSG:32632", known=cameras)
    _, messages = run(tmp_path, chunk_mission(heights="ellipsoid"), code)
    assert expected in messages


def test_a_disabled_camera_is_left_out(block, tmp_path):
    """Metashape leaves its old pose in the file: here 50 m away in the chunk."""
    file = tmp_path / "s.xml"
    block.write_metashape(file, reference="EPSG:4326")
    root = ElementTree.fromstring(file.read_text())
    camera = next(root.iter("camera"))
    camera.set("enabled", "false")
    transform = camera.find("transform")
    numbers = transform.text.split()
    numbers[3] = str(float(numbers[3]) + 50.0)
    transform.text = " ".join(numbers)
    file.write_text(ElementTree.tostring(root, encoding="unicode"))
    stations, messages = run(tmp_path, chunk_mission(heights="ellipsoid"))
    assert len(stations) == len(block.names) - 1
    assert (stations["status"] == "ok").all()
    assert block.names[0] in messages["BLOCK-DISABLED"]["what"]


def test_slave_cameras_follow_their_master(block, tmp_path):
    """An oblique head 0.4 m from the nadir camera, 45 deg to the side."""
    turn = Rotation.from_euler("yx", [45.0, 3.0], degrees=True).as_matrix()
    head = SmallRig("head_", (0.4, -0.1, 0.05), turn)
    block.write_metashape(tmp_path / "s.xml", reference="EPSG:4326", head=head)
    mission = chunk_mission(heights="ellipsoid")
    mission["cameras"] = {
        "nadir": {"camera": "c", "calibration": "laboratory"},
        "oblique": {"camera": "head", "calibration": "laboratory"},
    }
    stations, _ = run(tmp_path, mission)
    assert (stations["status"] == "ok").all()
    heads = stations[stations["camera"] == "oblique"].set_index("image")
    assert len(heads) == 12
    masters = ecef(block.lat, block.lon, block.h)
    for name, place, master in zip(block.names, masters, block.cam_from_ecef(), strict=True):
        row = heads.loc[f"head_{name}"]
        centre = ecef(row.lat_deg, row.lon_deg, row.h_ellipsoid_m)
        np.testing.assert_allclose(centre, place + master.T @ head.place_m, atol=1e-3)
        attitude = Rotation.from_quat([row.q_x, row.q_y, row.q_z, row.q_w]).as_matrix()
        expected = turn.T @ master @ enu_axes(row.lat_deg, row.lon_deg).T
        np.testing.assert_allclose(attitude, expected, atol=1e-7)
