"""Stations of a trajectory or an EO text without a log, and cameras with heads of their own.

Truth is that of the simulated flight; angles in a grid are made here by pyproj and scipy.
"""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyproj
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import channel, refused, with_code
from tests.stages.block_files import CABIN, matrices
from tests.stages.flown_files import (
    CAMERAS,
    assert_true,
    errors,
    files,
    gps_time,
    truth,
)
from tests.stages.flown_images import NED_FROM_ENU
from tests.stages.mistaken import changed
from tests.stages.other_logs import flight_of, opened, refusal_to_read, with_channels
from unbend import load_mission
from unbend.batch.runs import read_mission
from unbend.messages import Ledger
from unbend.simulate.flight import UNDULATION_M
from unbend.stages.story import prepare_mission

__all__ = ["files", "truth"]

QUATERNION = ["q_x", "q_y", "q_z", "q_w"]


@pytest.fixture
def without_log(mission, files):
    """The mission without its log: events with times from the truth, air of the standard."""
    config = mission.config
    del config["log"]
    config["mission"]["undulation_m"] = UNDULATION_M
    config["atmosphere"] = {"adjust": False}
    for camera in config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    events = files.stations.reset_index()[["image", "camera", "time_utc"]]
    events["time_utc"] = events["time_utc"].dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    events.to_csv(mission.folder / "events.csv", index=False)
    columns = {"time_utc": "time_utc", "camera": "camera"}
    config["events"] = {"csv": {"path": "events.csv", "columns": columns}}
    return mission


def sbet_of_week(files):
    section = files.sbet()
    section["time"]["week"] = files.week()
    return section


def table_of(files):
    return files.csv(files.table())


def prepare(mission, **stations):
    mission.config["stations"] = stations
    return read_mission(mission.save())


@pytest.mark.parametrize("section_of", [sbet_of_week, table_of])
def test_a_trajectory_gives_position_height_and_attitude(without_log, files, section_of):
    prepared = prepare(without_log, trajectory=section_of(files))
    assert prepared.stations.ok.all()
    assert_true(prepared, files)
    assert prepared.flight.log is None
    assert not prepared.ledger.has_losses
    alone, *_ = with_code(prepared.ledger, "TRAJECTORY-ALONE")
    assert alone.kind == "warning"


def test_a_week_that_no_log_gives_is_asked_for(without_log, files):
    without_log.config["stations"] = {"trajectory": files.sbet()}
    refusal_to_read(without_log, "IMPORT-WEEK")


def test_an_attitude_that_no_log_gives_is_asked_for(without_log, files):
    without_log.config["stations"] = {"trajectory": files.pos()}
    refusal_to_read(without_log, "STATIONS-ATTITUDE")


def test_heights_above_the_ellipsoid_become_those_above_the_sea_by_the_geoid(without_log, files):
    """EGM96 has 47.6 m within 2 m at the simulated field."""
    del without_log.config["mission"]["undulation_m"]
    stations = prepare(without_log, trajectory=sbet_of_week(files)).stations
    assert stations.ok.all()
    undulation_m = stations.h_ellipsoid_m - stations.h_msl_m
    assert undulation_m == pytest.approx(UNDULATION_M, abs=2.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stations.trajectory.replaces": ["attitude"]}, "no log"),
        ({"events": {"log": {"nadir": {}}}}, "no log"),
        ({"stations": {}}, "log is missing"),
        ({"mount.nadir.attitude": "MNT[0]"}, "no log"),
        ({"events": "delete"}, "events is missing"),
    ],
)
def test_what_a_mission_without_log_cannot_have(without_log, files, changes, words):
    without_log.config["stations"] = {"trajectory": files.sbet()}
    without_log.config = changed(without_log.config, changes)
    assert words in refusal_to_read(without_log, "CONFIG-INVALID")


EO_HEAD = """\
  Grid: Universal Transverse Mercator; Zone:  UTM North {zone} ;
  (position in Meters, orientation in Degrees, lat, long in Deg)
ID\t# EVENT\tTIME (s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\tLONG
"""


ZONE = 32  # of UTM, in which the flight is
GRID = "EPSG:32632"
EO_COLUMNS = [
    "image",
    "event",
    "seconds",
    "east",
    "north",
    "h_ellipsoid_m",
    "omega",
    "phi",
    "kappa",
    "lat_deg",
    "lon_deg",
]


def write_eo(files, camera, zone=ZONE):
    """An EO text of the camera's true stations; its head may name another zone."""
    rows = files.stations_of(camera).reset_index()
    lat = rows["lat_deg"].to_numpy()
    lon = rows["lon_deg"].to_numpy()
    project = pyproj.Proj(GRID)
    place = np.array(project(lon, lat))
    north = project(lon, lat + 1e-5) - place
    convergence_rad = -np.arctan2(*north)
    grid_from_enu = Rotation.from_euler("z", convergence_rad[:, None])
    half_turn = Rotation.from_euler("x", np.pi)
    enu_from_camera = Rotation.from_quat(rows[QUATERNION]).inv() * half_turn
    angles = (grid_from_enu * enu_from_camera).as_euler("XYZ", degrees=True)
    rows["event"] = rows.index + 1
    _, rows["seconds"] = gps_time(rows["time_utc"])
    rows[["east", "north"]] = place.T
    rows[["omega", "phi", "kappa"]] = angles
    table = rows[EO_COLUMNS]
    text = table.to_csv(sep="\t", header=False, index=False, float_format="%.9f")
    path = files.folder / f"{camera}.txt"
    path.write_text(EO_HEAD.format(zone=zone) + text)
    return {
        "path": path.name,
        "image": "{name}",
        "time": {"system": "gpst", "week": files.week()},
    }


def positions_of(files):
    """Events by the EO texts of both cameras."""
    return {"positions": {camera: write_eo(files, camera) for camera in CAMERAS}}


def assert_exact(prepared, files):
    """The stations are those of the flight to the digits of a table."""
    off = errors(prepared, files)
    assert prepared.stations.ok.all()
    assert off.place_m < 0.01
    assert off.height_m < 0.01
    assert off.attitude_deg < 1e-4


def test_an_eo_text_needs_neither_log_nor_trajectory(without_log, files):
    without_log.config["events"] = positions_of(files)
    assert_exact(read_mission(without_log.save()), files)


def test_the_attitude_of_an_eo_text_is_compared_with_the_log(mission, files):
    """By the mounts both cameras' angles are the aircraft's; by another mount they are not."""
    mission.config["events"] = positions_of(files)
    prepared = read_mission(mission.save())
    assert errors(prepared, files).attitude_deg < 1e-4
    assert kinds_of(prepared, "TRAJECTORY-ANGLES-AGREE") == ["note", "note"]

    mission.config["mount"]["oblique"]["roll_deg"] = 45.0
    prepared = read_mission(mission.save())
    assert "loss" in kinds_of(prepared, "TRAJECTORY-ANGLES-AGREE")


def kinds_of(prepared, code):
    return [message.kind for message in with_code(prepared.ledger, code)]


def test_angles_of_another_grid_are_refused(without_log, files):
    nadir = write_eo(files, "nadir", ZONE + 1)
    oblique = write_eo(files, "oblique")
    without_log.config["events"] = {"positions": {"nadir": nadir, "oblique": oblique}}
    refusal_to_read(without_log, "IMPORT-EO-GRID")
    nadir["grid"] = GRID
    assert read_mission(without_log.save()).stations.ok.all()


PAYLOAD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


HALF = np.sqrt(0.5)
LEVEL_TO_NORTH = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
LEVEL_TO_EAST = {"q_w": HALF, "q_x": 0.0, "q_y": 0.0, "q_z": HALF}
AXES_IN_EAST_NORTH_UP = {
    "nadir": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
    "oblique": [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
}
"""Right, down and forward of a camera whose level head points to the north, to the east."""


def test_each_camera_follows_the_gimbal_of_its_own(mission, files):
    seconds = files.start.timestamp() + files.t
    north = channel("MNT[0]", seconds, **LEVEL_TO_NORTH)
    east = channel("MNT[1]", seconds, **LEVEL_TO_EAST)
    inputs = with_channels(opened(mission), north, east)
    at_rest = {"pitch_deg": 90.0, "roll_deg": 0.0}
    mounts = mission.config["mount"]
    mounts["nadir"] |= at_rest | {"attitude": "MNT[0]"}
    mounts["oblique"] |= at_rest | {"attitude": "MNT[1]"}
    ledger = Ledger()

    stations = prepare_mission(load_mission(mission.save()), inputs, ledger).stations

    assert stations.ok.all()
    axes = matrices(stations.quaternion)
    for camera, expected in AXES_IN_EAST_NORTH_UP.items():
        of_camera = axes[stations.camera == camera]
        assert_allclose(of_camera, [expected] * 3, atol=1e-9)
    assert np.isfinite(stations.aircraft_quaternion).all()
    notes = with_code(ledger, "GIMBAL-FRAME")
    assert {note.where for note in notes} == {"mount.nadir", "mount.oblique"}

    mounts["nadir"]["attitude"] = "MNT[7]"
    with refused("CHANNEL-MISSING") as refusal:
        flight_of(mission, inputs)
    assert "MNT[1]" in refusal.value.what


def test_dji_images_orient_themselves(without_log, files):
    """Gimbal angles and positions of exiftool's table: axes forward, right, down of the payload."""
    config = without_log.config
    del config["events"]
    del config["mount"]
    del config["cameras"]["oblique"]
    table = without_log.measurements().to_pandas()
    nadir = table[table["image"].str.startswith("nadir")]
    without_log.observe(pa.Table.from_pandas(nadir))
    rows = files.stations_of("nadir")
    enu_from_camera = Rotation.from_quat(rows[QUATERNION]).inv().as_matrix()
    payload = Rotation.from_matrix(NED_FROM_ENU @ enu_from_camera @ PAYLOAD_FROM_CAMERA.T)
    yaw, pitch, roll = payload.as_euler("ZYX", degrees=True).T
    exif = pd.DataFrame(
        {
            "FileName": rows.index + ".JPG",
            "DateTimeOriginal": rows["time_utc"].dt.strftime("%Y:%m:%d %H:%M:%S.%fZ"),
            "GPSLatitude": rows["lat_deg"],
            "GPSLongitude": rows["lon_deg"],
            "AbsoluteAltitude": rows["h_ellipsoid_m"],
            "GimbalRollDegree": roll,
            "GimbalPitchDegree": pitch,
            "GimbalYawDegree": yaw,
        }
    )
    exif.to_csv(without_log.folder / "exif.csv", index=False, float_format="%.10f")
    orientation = {
        "path": "exif.csv",
        "format": "dji",
        "angles": "roll_pitch_yaw",
        "frame": "geographic",
        "heights": "ellipsoid",
    }
    config["observations"]["match_names"] = ["extension"]

    assert_exact(prepare(without_log, orientation=orientation), files)

    orientation["angles"] = "omega_phi_kappa"
    assert "format: dji" in refusal_to_read(without_log, "CONFIG-INVALID")
