"""Missions whose block says, or is said to have, another frame than its files know of places."""

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyproj
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.small_block import SmallBlock, SmallRig, ecef, enu_axes, largest_difference
from tests.stages.block_files import PLACE, earth_centred, matrices
from tests.stages.small_missions import ORIGIN, enu_at, mission_of, refusal, rows_of, run
from unbend.batch.results import read_manifest
from unbend.report.summary import verdict
from unbend.tables.imports.blocks import block_reader

GEOCENTRIC_TO_GEODETIC = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
GEODETIC_TO_UTM = pyproj.Transformer.from_crs(4979, 32632, always_xy=True)
UTM_OFFSET = (286_800.0, 5_203_300.0)
KEY = ["image", "point"]


@pytest.fixture
def block():
    return SmallBlock.make()


def assert_true(stations, block):
    """The stations are where the images of the block were taken."""
    away_m, turned_deg = largest_difference(stations, block)
    assert away_m < 1e-3
    assert turned_deg < 1e-5


def turn_by(axes, angles_deg):
    return Rotation.from_euler(axes, angles_deg, degrees=True).as_matrix()


# ---- OpenSfM and ODM


def write_coords(folder):
    """What ODM writes of the UTM of a reconstruction."""
    east, north = UTM_OFFSET
    path = folder / "odm_georeferencing" / "coords.txt"
    path.parent.mkdir()
    path.write_text(f"WGS84 UTM 32N\n{east} {north}\n")


def odm_transformation(block):
    """(3, 4) from east, north, up to UTM minus an offset, by differences over a metre."""
    lat, lon, _ = block.origin
    centre = ecef(*block.origin)
    corners = centre + enu_axes(lat, lon)
    places = np.vstack([corners, centre]).T
    geodetic = GEOCENTRIC_TO_GEODETIC.transform(*places)
    x, y, z = GEODETIC_TO_UTM.transform(*geodetic)
    east, north = UTM_OFFSET
    columns = np.stack([x - east, y - north, z])
    columns[:, :3] -= columns[:, 3:]
    return columns


@pytest.fixture
def odm(tmp_path):
    """A project of ODM's far from the meridian of its zone: its reconstruction is in UTM."""
    block = SmallBlock.make(46.95, 6.2)
    block.write_opensfm(tmp_path / "opensfm", linear=odm_transformation(block))
    write_coords(tmp_path)
    return block


OPENSFM = mission_of("opensfm", "opensfm", heights="ellipsoid")


def test_the_topocentric_reconstruction_of_odm_is_read(odm, tmp_path):
    odm.write_opensfm(tmp_path / "opensfm", name="reconstruction.topocentric.json")
    stations, messages = run(tmp_path, OPENSFM)
    assert_true(stations, odm)
    assert messages["BLOCK-ODM"]["kind"] == "note"
    assert messages["FRAME-CONFIRMED"]["kind"] == "note"


def test_the_utm_of_odm_is_refused(odm, tmp_path):
    """By coords.txt and gps_position, or by the file that ODM leaves."""
    text = refusal(tmp_path, OPENSFM, "ORIENTATION-FRAME")
    assert "coords.txt" in text
    assert "reconstruction.topocentric.json" in text
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    (tmp_path / "opensfm" / "exported_geocoords.txt").touch()
    assert "exported_geocoords.txt" in refusal(tmp_path, OPENSFM, "ORIENTATION-FRAME")


def test_utm_without_odm_is_a_finding(odm, tmp_path):
    """Nothing but gps_position tells."""
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    _, messages = run(tmp_path, OPENSFM, 3)
    places = messages["FRAME-PLACES"]
    assert places["kind"] == "finding"
    # The convergence at 6.2 deg east of a zone about 9.
    assert "turned by 2.0" in places["what"]


def test_inputs_hold_what_a_frame_rests_on(odm, tmp_path):
    """coords.txt is hashed with the project."""
    files = block_reader("opensfm").block_files(tmp_path / "opensfm")
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
    without_heights = mission_of("opensfm", "opensfm")
    text = refusal(opensfm, without_heights, "CONFIG-INVALID")
    assert "heights is missing" in text
    mission = mission_of("opensfm", "opensfm", heights="msl")
    mission["mission"]["undulation_m"] = 47.6
    reference = opensfm / "opensfm" / "reference_lla.json"
    text = reference.read_text()
    reference.write_text(text.replace('"altitude": 0.0', '"altitude": -47.6'))
    stations, _ = run(opensfm, mission)
    # The frame is laid 47.6 m deeper: 0.6 km are 4 mm shorter there.
    away_m, _ = largest_difference(stations, block)
    assert away_m < 0.005
    by_opensfm = rows_of(opensfm).set_index(KEY)

    block.write_colmap(opensfm / "sparse")
    mission["observations"] = {"path": "sparse", "format": "colmap"}
    mission["stations"]["orientation"] = {"frame": ORIGIN, "date": "2026-05-14"}
    run(opensfm, mission)
    by_colmap = rows_of(opensfm).set_index(KEY).loc[by_opensfm.index]

    shift_px = by_colmap["x_corrected_px"] - by_colmap["x_px"]
    assert shift_px.abs().max() > 0.01
    for column in ("x_corrected_px", "y_corrected_px"):
        assert_allclose(by_opensfm[column], by_colmap[column], rtol=0.0, atol=2e-6)


def test_a_project_without_a_reference_has_no_frame(opensfm):
    (opensfm / "opensfm" / "reference_lla.json").unlink()
    text = refusal(opensfm, OPENSFM, "ORIENTATION-FRAME")
    assert "stations.orientation.frame: ecef" in text


@pytest.mark.parametrize(
    ("h_m", "contradicts"),
    [(0.0, False), (1.0, True)],
)
def test_a_stated_frame_is_used_and_a_contradiction_is_told(block, opensfm, h_m, contradicts):
    frame = enu_at(46.95, 7.45, h_m)
    mission = mission_of("opensfm", "opensfm", frame=frame)
    stations, messages = run(opensfm, mission)
    away_m, _ = largest_difference(stations, block)
    assert away_m == pytest.approx(h_m, abs=1e-3)
    assert ("IMPORT-CONTRADICTED" in messages) == contradicts


# ---- COLMAP


def above_the_sea(block):
    """Geodetic places of the images, of which nothing says that heights are above the sea."""
    return np.column_stack([block.lat, block.lon, block.h - 47.0])


def in_axes_of_the_block(block):
    centres, _, _ = block.in_enu()
    return centres


def with_priors(block, folder, places=above_the_sea, system=0):
    """A mission by a database that has priors in a system: 0 is WGS 84, 1 is Cartesian."""
    path = folder / "database.db"
    block.write_colmap_database(path, known=places(block), system=system)
    return mission_of(
        path.name,
        "colmap",
        path="sparse",
        format="colmap",
        frame=ORIGIN,
    )


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scale": 1 / 0.3048}, "multiplied by 0.3048"),
        ({"turn": turn_by("y", 6.0)}, "tilted by"),
    ],
    ids=["feet", "tilted"],
)
def test_pose_priors_tell_a_model_in_feet_or_tilted(block, tmp_path, changed, words):
    block.write_colmap(tmp_path / "sparse", **changed)
    _, messages = run(tmp_path, with_priors(block, tmp_path), 3)
    text = messages["FRAME-PLACES"]["what"]
    assert words in text
    assert "pose priors of 12 images" in text


@pytest.mark.parametrize(
    ("places", "system"),
    [(above_the_sea, 0), (in_axes_of_the_block, 1)],
)
def test_pose_priors_confirm_a_right_model(block, tmp_path, places, system):
    block.write_colmap(tmp_path / "sparse")
    mission = with_priors(block, tmp_path, places, system)
    stations, messages = run(tmp_path, mission)
    assert_true(stations, block)
    assert "FRAME-CONFIRMED" in messages


def known_positions(block, folder):
    table = {
        "image": block.names,
        "latitude": block.lat,
        "longitude": block.lon,
        "height": block.h,
    }
    pd.DataFrame(table).to_csv(folder / "known.csv", index=False)
    return {"path": "known.csv"}


def test_known_positions_are_compared_with_a_stated_frame(block, tmp_path):
    block.write_colmap(tmp_path / "sparse", scale=0.01)
    mission = mission_of("sparse", "colmap", frame=ORIGIN)
    _, messages = run(tmp_path, mission)
    unverified = messages["FRAME-UNVERIFIED"]
    assert unverified["kind"] == "warning"
    assert "12 images are within 11 m" in unverified["what"]
    assert "a tilt, the scale, the unit." in unverified["what"]  # heights are those of the block
    to_write = "write stations.orientation.known_positions: {path: positions.csv}"
    assert to_write in unverified["what"]
    text = verdict(read_manifest(tmp_path / "results"))
    assert "not needed here, if the frame of the block is right (nothing confirms it)" in text

    orientation = mission["stations"]["orientation"]
    orientation["known_positions"] = known_positions(block, tmp_path)
    _, messages = run(tmp_path, mission, 3)
    assert "multiplied by 100" in messages["FRAME-PLACES"]["what"]


def test_a_model_in_an_unknown_frame(block, tmp_path):
    """The block turned and 50 times smaller, fitted to the known places of its images."""
    turn = turn_by("xyz", [70.0, -40.0, 150.0])
    block.write_colmap(tmp_path / "sparse", scale=0.02, turn=turn)
    places = known_positions(block, tmp_path) | {"sigma_m": 0.05}
    mission = mission_of(
        "sparse",
        "colmap",
        frame="unknown",
        heights="ellipsoid",
        known_positions=places,
    )
    mission["mission"]["undulation_m"] = 47.6

    stations, messages = run(tmp_path, mission)

    assert "12 known positions" in messages["ORIENTATION-FIT"]["what"]
    assert_true(stations, block)
    rows = rows_of(tmp_path)
    assert (rows["status"] == "ok").all()
    number = rows["point"].astype(int)
    h_g = pd.Series(block.point_h[number - 1] - 47.6)
    assert_allclose(rows["h_g_m"], h_g, atol=1e-3)
    from_median = h_g - h_g.groupby(rows["image"]).transform("median")
    ground = messages["GROUND-BLOCK"]["values"]
    expected = {
        "low": h_g.min(),
        "high": h_g.max(),
        "apart": from_median.abs().median(),
    }
    heights = {name: ground[name] for name in expected}
    assert heights == pytest.approx(expected, abs=1e-3)


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


def chunk_mission(height_m=530, reference="ellipsoid", **orientation):
    orientation = orientation or {"heights": "ellipsoid"}
    mission = mission_of("s.xml", "metashape", **orientation)
    mission["ground"] = {"height": height_m, "reference": reference}
    return mission


@pytest.fixture
def chunk(block, tmp_path):
    """Writes the block as an XML of Metashape."""

    def write(**reference):
        block.write_metashape(tmp_path / "s.xml", **reference)

    return write


@pytest.mark.parametrize(
    "orientation",
    [{"frame": "ecef"}, {"heights": "ellipsoid"}],
)
def test_a_chunk_in_a_national_datum(block, chunk, tmp_path, orientation):
    chunk(shift=-TO_WGS84_OF_LV95, reference=LV95)
    stations, messages = run(tmp_path, chunk_mission(**orientation))
    assert_true(stations, block)
    assert "CH1903+" in messages["CRS-DATUM"]["what"]
    assert "FRAME-UNVERIFIED" in messages


def test_heights_above_the_sea_stay_what_a_national_chunk_was_given(block, chunk, tmp_path):
    """The program took them for heights above Bessel's ellipsoid."""
    chunk(shift=-TO_WGS84_OF_LV95, reference=LV95)
    stations, _ = run(tmp_path, chunk_mission(480, "msl", heights="msl"))
    in_lv95 = ecef(block.lat, block.lon, block.h) - TO_WGS84_OF_LV95
    bessel = pyproj.Transformer.from_pipeline("+proj=cart +ellps=bessel +inv")
    _, _, h = bessel.transform(*in_lv95.T)
    assert_allclose(stations["h_msl_m"], h, atol=0.05)
    assert_allclose(stations["lat_deg"], block.lat, atol=1e-8)


@pytest.mark.parametrize(
    ("moved_m", "exit_code", "code"),
    [(0.0, 0, "FRAME-CONFIRMED"), (300.0, 3, "FRAME-PLACES")],
)
def test_the_reference_of_a_chunk_is_compared_with_its_cameras(
    block, chunk, tmp_path, moved_m, exit_code, code
):
    """Cameras in UTM: x and y change places, and the middle of the block is elsewhere."""
    east, north = GEODETIC_TO_UTM.transform(block.lon, block.lat)
    cameras = np.column_stack([east + moved_m, north, block.h])
    chunk(reference="EPSG:32632", known=cameras)
    _, messages = run(tmp_path, chunk_mission(), exit_code)
    assert code in messages


def test_a_disabled_camera_is_left_out(block, chunk, tmp_path):
    """Metashape leaves its old pose in the file: here 50 m away in the chunk."""
    chunk(reference="EPSG:4326")
    file = tmp_path / "s.xml"
    tree = ElementTree.parse(file)
    camera = tree.find(".//camera")
    camera.set("enabled", "false")
    transform = camera.find("transform")
    numbers = transform.text.split()
    numbers[3] = str(float(numbers[3]) + 50.0)
    transform.text = " ".join(numbers)
    tree.write(file)
    stations, messages = run(tmp_path, chunk_mission())
    assert len(stations) == len(block.names) - 1
    assert (stations["status"] == "ok").all()
    assert block.names[0] in messages["BLOCK-DISABLED"]["what"]


def test_slave_cameras_follow_their_master(block, chunk, tmp_path):
    """An oblique head 0.4 m from the nadir camera, 45 deg to the side."""
    turn = turn_by("yx", [45.0, 3.0])
    head = SmallRig("head_", (0.4, -0.1, 0.05), turn)
    chunk(reference="EPSG:4326", head=head)
    mission = chunk_mission()
    mission["cameras"] = {
        "nadir": {"camera": "c", "calibration": "laboratory"},
        "oblique": {"camera": "head", "calibration": "laboratory"},
    }
    stations, _ = run(tmp_path, mission)
    assert (stations["status"] == "ok").all()
    heads = stations[stations["camera"] == "oblique"].set_index("image")
    assert len(heads) == 12
    heads = heads.loc["head_" + pd.Index(block.names)]
    centres, enu = earth_centred(*heads[PLACE].to_numpy().T)
    attitudes = matrices(heads[["q_w", "q_x", "q_y", "q_z"]])
    masters = block.cam_from_ecef()
    places = ecef(block.lat, block.lon, block.h)
    offsets = masters.transpose(0, 2, 1) @ head.place_m
    assert_allclose(centres, places + offsets, atol=1e-3)
    masters_from_enu = masters @ enu.transpose(0, 2, 1)
    assert_allclose(attitudes, turn.T @ masters_from_enu, atol=1e-7)
