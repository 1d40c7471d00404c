"""Missions whose block says, or is said to have, another frame than its files know of places."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.small_block import SmallBlock, SmallRig, ecef, enu_axes, largest_difference

pytestmark = pytest.mark.usefixtures("plain_report")

ORIGIN = {"enu": {"lat_deg": 46.95, "lon_deg": 7.45, "h_ellipsoid_m": 0.0}}


def config(observed: str, program: str, **orientation) -> dict:
    return {
        "mission": {"name": "small"},
        "observations": {"path": observed, "format": program},
        "cameras": {"c": {"calibration": "laboratory"}},
        "stations": {"orientation": {"date": "2026-05-14"} | orientation},
        "ground": {"height": "block"},
        "atmosphere": {"adjust": False},
        "output": {"path": "results"},
    }


def run(folder, mission: dict, code: int = 0) -> tuple[pd.DataFrame, dict[str, dict]]:
    """The stations of a run, and its messages by their codes."""
    from unbend.batch.runs import run_mission

    (folder / "m.yaml").write_text(yaml.safe_dump(mission))
    outcome = run_mission(folder / "m.yaml", force=True)
    values = outcome.manifest.values
    assert outcome.exit_code == code, values["ledger"]
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    return stations, {entry["code"]: entry for entry in values["ledger"]}


def refusal(folder, mission: dict) -> str:
    from unbend.batch.runs import run_mission
    from unbend.errors import UnbendError

    (folder / "m.yaml").write_text(yaml.safe_dump(mission))
    with pytest.raises(UnbendError) as refused:
        run_mission(folder / "m.yaml", force=True)
    return str(refused.value)


def odm_transformation(block: SmallBlock, offset: tuple[float, float]) -> np.ndarray:
    """(3, 4) from east, north, up to UTM minus an offset, by differences over a metre."""
    import pyproj

    to_geodetic = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
    to_utm = pyproj.Transformer.from_crs(4979, 32632, always_xy=True)
    lat, lon, h = block.origin
    axes = enu_axes(lat, lon)
    corners = np.vstack([np.zeros(3), np.eye(3)])
    places = []
    for corner in corners:
        lon_deg, lat_deg, height = to_geodetic.transform(*(ecef(lat, lon, h) + corner @ axes))
        x, y = to_utm.transform(lon_deg, lat_deg)
        places.append([x - offset[0], y - offset[1], height])
    columns = np.array(places[1:]) - places[0]
    return np.column_stack([columns.T, places[0]])


@pytest.fixture
def odm(tmp_path):
    """A project of ODM's far from the meridian of its zone: its reconstruction is in UTM."""
    block = SmallBlock.make(46.95, 6.2)
    offset = (286_800.0, 5_203_300.0)
    block.write_opensfm(tmp_path / "opensfm", linear=odm_transformation(block, offset))
    (tmp_path / "odm_georeferencing").mkdir()
    text = f"WGS84 UTM 32N\n{offset[0]} {offset[1]}\n"
    (tmp_path / "odm_georeferencing" / "coords.txt").write_text(text)
    return block, tmp_path


def test_the_topocentric_reconstruction_of_odm_is_read(odm):
    block, folder = odm
    block.write_opensfm(folder / "opensfm", name="reconstruction.topocentric.json")
    mission = config("opensfm", "opensfm", heights="ellipsoid")
    stations, messages = run(folder, mission)
    away, turned = largest_difference(stations, block)
    assert away < 1e-3
    assert turned < 1e-5
    assert messages["BLOCK-ODM"]["kind"] == "note"
    assert messages["FRAME-CONFIRMED"]["kind"] == "note"


def test_the_utm_of_odm_is_refused(odm):
    """By coords.txt and gps_position, or by the file that ODM leaves."""
    _, folder = odm
    mission = config("opensfm", "opensfm", heights="ellipsoid")
    said = refusal(folder, mission)
    assert "ORIENTATION-FRAME" in said
    assert "coords.txt" in said
    assert "reconstruction.topocentric.json" in said
    (folder / "odm_georeferencing" / "coords.txt").unlink()
    (folder / "opensfm" / "exported_geocoords.txt").touch()
    assert "exported_geocoords.txt" in refusal(folder, mission)


def test_utm_without_odm_is_a_finding(odm):
    """Nothing but gps_position tells."""
    _, folder = odm
    (folder / "odm_georeferencing" / "coords.txt").unlink()
    _, messages = run(folder, config("opensfm", "opensfm", heights="ellipsoid"), 3)
    entry = messages["FRAME-PLACES"]
    assert entry["kind"] == "finding"
    assert "turned by 2.0" in entry["what"]  # the convergence at 6.2 deg east of a zone about 9


def test_east_north_up_beside_coords_of_odm_is_read(tmp_path):
    """As older ODM left it."""
    block = SmallBlock.make(46.95, 6.2)
    block.write_opensfm(tmp_path / "opensfm")
    (tmp_path / "odm_georeferencing").mkdir()
    (tmp_path / "odm_georeferencing" / "coords.txt").write_text(
        "WGS84 UTM 32N\n286800.0 5203300.0\n"
    )
    stations, messages = run(tmp_path, config("opensfm", "opensfm", heights="ellipsoid"))
    assert largest_difference(stations, block)[0] < 1e-3
    assert "BLOCK-ODM" not in messages


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scale": 1 / 0.3048}, "multiplied by 0.3048"),
        ({"turn": Rotation.from_euler("y", 6.0, degrees=True).as_matrix()}, "tilted by"),
    ],
)
def test_pose_priors_tell_a_model_in_feet_or_tilted(tmp_path, changed, words):
    block = SmallBlock.make()
    block.write_colmap(tmp_path / "sparse", **changed)
    known = np.stack([block.lat, block.lon, block.h - 47.0], axis=1)
    block.write_colmap_database(tmp_path / "database.db", known=known)
    mission = config("database.db", "colmap", path="sparse", format="colmap", frame=ORIGIN)
    _, messages = run(tmp_path, mission, 3)
    assert words in messages["FRAME-PLACES"]["what"]
    assert "pose priors of 12 images" in messages["FRAME-PLACES"]["what"]


@pytest.mark.parametrize("system", [0, 1])
def test_pose_priors_confirm_a_right_model(tmp_path, system):
    block = SmallBlock.make()
    block.write_colmap(tmp_path / "sparse")
    centres, _, _ = block.in_enu()
    known = centres if system else np.stack([block.lat, block.lon, block.h - 47.0], axis=1)
    block.write_colmap_database(tmp_path / "database.db", known=known, system=system)
    mission = config("database.db", "colmap", path="sparse", format="colmap", frame=ORIGIN)
    stations, messages = run(tmp_path, mission)
    assert largest_difference(stations, block)[0] < 1e-3
    assert "FRAME-CONFIRMED" in messages


def test_known_positions_are_compared_with_a_stated_frame(tmp_path):
    block = SmallBlock.make()
    block.write_colmap(tmp_path / "sparse", scale=0.01)
    known = pd.DataFrame(
        {"image": block.names, "latitude": block.lat, "longitude": block.lon, "height": block.h}
    )
    mission = config("sparse", "colmap", frame=ORIGIN)
    _, messages = run(tmp_path, mission)
    entry = messages["FRAME-UNVERIFIED"]
    assert entry["kind"] == "warning"
    assert "12 images are within 11 m" in entry["what"]
    known.to_csv(tmp_path / "known.csv", index=False)
    mission["stations"]["orientation"]["known_positions"] = {"path": "known.csv"}
    _, messages = run(tmp_path, mission, 3)
    assert "multiplied by 100" in messages["FRAME-PLACES"]["what"]


def test_the_verdict_rests_on_a_frame_that_nothing_confirms(tmp_path):
    from unbend.batch.results import read_manifest
    from unbend.report.summary import verdict

    block = SmallBlock.make()
    block.write_colmap(tmp_path / "sparse", scale=0.01)
    run(tmp_path, config("sparse", "colmap", frame=ORIGIN))
    said = verdict(read_manifest(tmp_path / "results"))
    assert "not needed here, if the frame of the block is right (nothing confirms it)" in said


def test_inputs_hold_what_a_frame_rests_on(odm):
    """coords.txt is hashed with the project."""
    _, folder = odm
    from unbend.tables.imports.blocks import block_reader

    names = {file.name for file in block_reader("opensfm").block_files(folder / "opensfm")}
    assert names == {"reconstruction.json", "tracks.csv", "reference_lla.json", "coords.txt"}
    assert json.loads((folder / "opensfm" / "reference_lla.json").read_text())["latitude"] == 46.95


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


@pytest.mark.parametrize("orientation", [{"frame": "ecef"}, {"heights": "ellipsoid"}])
def test_a_chunk_in_a_national_datum(tmp_path, orientation):
    block = SmallBlock.make()
    block.write_metashape(tmp_path / "s.xml", shift=-TO_WGS84_OF_LV95, reference=LV95)
    mission = config("s.xml", "metashape", **orientation)
    mission["ground"] = {"height": 530, "reference": "ellipsoid"}
    stations, messages = run(tmp_path, mission)
    away, turned = largest_difference(stations, block)
    assert away < 1e-3
    assert turned < 1e-5
    assert "CH1903+" in messages["CRS-DATUM"]["what"]
    assert "FRAME-UNVERIFIED" in messages


def test_heights_above_the_sea_stay_what_a_national_chunk_was_given(tmp_path):
    """The program took them for heights above Bessel's ellipsoid."""
    block = SmallBlock.make()
    lat = block.lat
    lon = block.lon
    block.write_metashape(tmp_path / "s.xml", shift=-TO_WGS84_OF_LV95, reference=LV95)
    mission = config("s.xml", "metashape", heights="msl")
    mission["ground"] = {"height": 480, "reference": "msl"}
    stations, _ = run(tmp_path, mission)
    own = ecef(lat, lon, block.h) - TO_WGS84_OF_LV95
    a = 6377397.155
    e2 = 0.006674372231802
    # The height above Bessel's ellipsoid, by Bowring's iteration.
    across = np.hypot(own[:, 0], own[:, 1])
    phi = np.arctan2(own[:, 2], across * (1 - e2))
    for _ in range(6):
        n = a / np.sqrt(1 - e2 * np.sin(phi) ** 2)
        h = across / np.cos(phi) - n
        phi = np.arctan2(own[:, 2], across * (1 - e2 * n / (n + h)))
    np.testing.assert_allclose(stations["h_msl_m"], h, atol=0.05)
    np.testing.assert_allclose(stations["lat_deg"], lat, atol=1e-8)


def test_the_reference_of_a_chunk_is_compared_with_its_cameras(tmp_path):
    """Cameras in UTM: x and y change places, and the middle of the block is elsewhere."""
    import pyproj

    block = SmallBlock.make()
    x, y = pyproj.Transformer.from_crs(4979, 32632, always_xy=True).transform(block.lon, block.lat)
    for moved, code, expected in ((0.0, 0, "FRAME-CONFIRMED"), (300.0, 3, "FRAME-PLACES")):
        known = np.stack([x + moved, y, block.h], axis=1)
        block.write_metashape(tmp_path / "s.xml", reference="EPSG:32632", known=known)
        mission = config("s.xml", "metashape", heights="ellipsoid")
        mission["ground"] = {"height": 530, "reference": "ellipsoid"}
        _, messages = run(tmp_path, mission, code)
        assert expected in messages


def test_a_disabled_camera_is_left_out(tmp_path):
    """Metashape leaves its old pose in the file: here 50 m away in the chunk."""
    block = SmallBlock.make()
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
    mission = config("s.xml", "metashape", heights="ellipsoid")
    mission["ground"] = {"height": 530, "reference": "ellipsoid"}
    stations, messages = run(tmp_path, mission)
    assert len(stations) == len(block.names) - 1
    assert (stations["status"] == "ok").all()
    assert block.names[0] in messages["BLOCK-DISABLED"]["what"]


def test_slave_cameras_follow_their_master(tmp_path):
    """An oblique head 0.4 m from the nadir camera, 45 deg to the side: truth by own arithmetic."""
    block = SmallBlock.make()
    turn = Rotation.from_euler("yx", [45.0, 3.0], degrees=True).as_matrix()
    head = SmallRig("head_", (0.4, -0.1, 0.05), turn)
    block.write_metashape(tmp_path / "s.xml", reference="EPSG:4326", head=head)
    mission = config("s.xml", "metashape", heights="ellipsoid")
    mission["cameras"] = {
        "nadir": {"camera": "c", "calibration": "laboratory"},
        "oblique": {"camera": "head", "calibration": "laboratory"},
    }
    mission["ground"] = {"height": 530, "reference": "ellipsoid"}
    stations, _ = run(tmp_path, mission)
    assert (stations["status"] == "ok").all()
    heads = stations[stations["camera"] == "oblique"]
    assert len(heads) == 12
    for row in heads.itertuples():
        k = block.names.index(row.image.removeprefix("head_"))
        master = block.cam_from_ecef()[k]
        centre = ecef(block.lat[k], block.lon[k], block.h[k]) + master.T @ head.place_m
        here = ecef(row.lat_deg, row.lon_deg, row.h_ellipsoid_m)
        assert np.linalg.norm(here - centre) < 1e-3
        wanted = turn.T @ master @ enu_axes(row.lat_deg, row.lon_deg).T
        found = Rotation.from_quat([row.q_x, row.q_y, row.q_z, row.q_w]).as_matrix()
        np.testing.assert_allclose(found, wanted, atol=1e-7)
