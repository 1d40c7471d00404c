"""Stations of a trajectory or an EO text without a log, and cameras with heads of their own.

Truth is that of the simulated flight; angles in a grid are made here by pyproj and scipy.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers import channel, refused, with_code
from tests.stages.block_files import CABIN
from tests.stages.flown_files import CAMERAS, Files, assert_true, errors, files, gps_time, truth
from tests.stages.other_logs import flight_of, opened, with_channels
from unbend import load_mission
from unbend.batch.runs import read_mission
from unbend.messages import Ledger
from unbend.simulate.flight import UNDULATION_M
from unbend.stages.story import prepare_mission

__all__ = ["files", "truth"]

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
QUATERNION = ["q_x", "q_y", "q_z", "q_w"]


def without_log(mission, files: Files) -> None:
    """The mission without its log: events with times from the truth, air of the standard."""
    del mission.config["log"]
    mission.config["mission"]["undulation_m"] = UNDULATION_M
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    events = files.stations.reset_index()[["image", "camera", "time_utc"]]
    events["time_utc"] = events["time_utc"].dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    events.to_csv(mission.folder / "events.csv", index=False)
    columns = {"time_utc": "time_utc", "camera": "camera"}
    mission.config["events"] = {"csv": {"path": "events.csv", "columns": columns}}


def sbet_of_week(files: Files) -> dict:
    section = files.sbet()
    section["time"]["week"] = files.week()
    return section


def prepare(mission, **stations):
    mission.config["stations"] = stations
    return read_mission(mission.save())


@pytest.mark.parametrize(
    "section_of", [sbet_of_week, lambda files: files.csv(files.table())], ids=["sbet", "csv"]
)
def test_a_trajectory_gives_position_height_and_attitude_without_a_log(mission, files, section_of):
    without_log(mission, files)
    prepared = prepare(mission, trajectory=section_of(files))
    assert prepared.stations.ok.all()
    assert_true(prepared, files)
    assert prepared.flight.log is None
    assert not prepared.ledger.has_losses
    assert with_code(prepared.ledger, "TRAJECTORY-ALONE")[0].kind == "warning"


@pytest.mark.parametrize(("form", "code"), [("sbet", "IMPORT-WEEK"), ("pos", "STATIONS-ATTITUDE")])
def test_a_week_that_no_log_gives_and_an_attitude_are_asked_for(mission, files, form, code):
    without_log(mission, files)
    section = getattr(files, form)()
    with refused(code):
        prepare(mission, trajectory=section)


def test_heights_above_the_ellipsoid_become_those_above_the_sea_by_the_geoid(mission, files):
    """EGM96 has 47.6 m within 2 m at the simulated field."""
    without_log(mission, files)
    del mission.config["mission"]["undulation_m"]
    stations = prepare(mission, trajectory=sbet_of_week(files)).stations
    assert stations.ok.all()
    assert stations.h_ellipsoid_m - stations.h_msl_m == pytest.approx(UNDULATION_M, abs=2.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["stations"]["trajectory"].update(replaces=["attitude"]), "no log"),
        (lambda c: c.update(events={"log": {"nadir": {}}}), "no log"),
        (lambda c: c.update(stations={}), "log is missing"),
        (lambda c: c["mount"]["nadir"].update(attitude="MNT[0]"), "no log"),
        (lambda c: c.pop("events"), "events is missing"),
    ],
)
def test_what_a_mission_without_log_cannot_have(mission, files, change, words):
    without_log(mission, files)
    mission.config["stations"] = {"trajectory": files.sbet()}
    change(mission.config)
    with refused("CONFIG-INVALID") as refusal:
        read_mission(mission.save())
    assert words in str(refusal.value)


EO_HEAD = """\
  Grid: Universal Transverse Mercator; Zone:  UTM North {zone} ;
  (position in Meters, orientation in Degrees, lat, long in Deg)
ID\t# EVENT\tTIME (s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\tLONG
"""


def grid_of(files: Files) -> tuple[int, str]:
    """The zone of UTM of the flight, and its code."""
    zone = int(files.stations["lon_deg"].iloc[0] // 6) + 31
    return zone, f"EPSG:{32600 + zone}"


def write_eo(files: Files, camera: str, zones_off: int = 0) -> dict:
    """An EO text of the camera's true stations; its head may name another zone."""
    zone, grid = grid_of(files)
    rows = files.stations_of(camera).reset_index()
    lat = rows["lat_deg"].to_numpy()
    lon = rows["lon_deg"].to_numpy()
    project = pyproj.Proj(grid)
    here = np.array(project(lon, lat))
    north = np.array(project(lon, lat + 1e-5)) - here
    convergence_rad = -np.arctan2(*north)
    grid_from_enu = Rotation.from_euler("z", convergence_rad[:, None])
    enu_from_camera = Rotation.from_quat(rows[QUATERNION]).inv() * Rotation.from_euler("x", np.pi)
    angles = (grid_from_enu * enu_from_camera).as_euler("XYZ", degrees=True)
    rows["event"] = range(1, len(rows) + 1)
    rows["seconds"] = gps_time(rows["time_utc"])[1]
    rows[["east", "north"]] = here.T
    rows[["omega", "phi", "kappa"]] = angles
    columns = ["image", "event", "seconds", "east", "north", "h_ellipsoid_m", "omega", "phi"]
    columns += ["kappa", "lat_deg", "lon_deg"]
    text = rows[columns].to_csv(sep="\t", header=False, index=False, float_format="%.9f")
    path = files.folder / f"{camera}.txt"
    path.write_text(EO_HEAD.format(zone=zone + zones_off) + text)
    time = {"system": "gpst", "week": files.week()}
    return {"path": path.name, "image": "{name}", "time": time}


def test_an_eo_text_needs_neither_log_nor_trajectory(mission, files):
    without_log(mission, files)
    mission.config["events"] = {
        "positions": {camera: write_eo(files, camera) for camera in CAMERAS}
    }
    prepared = read_mission(mission.save())
    found = errors(prepared, files)
    assert prepared.stations.ok.all()
    assert found.place_m < 0.01
    assert found.height_m < 0.01
    assert found.attitude_deg < 1e-4


def test_the_attitude_of_an_eo_text_is_compared_with_the_log(mission, files):
    """By the mounts both cameras' angles are the aircraft's; by another mount they are not."""
    mission.config["events"] = {
        "positions": {camera: write_eo(files, camera) for camera in CAMERAS}
    }
    prepared = read_mission(mission.save())
    assert errors(prepared, files).attitude_deg < 1e-4
    told = with_code(prepared.ledger, "TRAJECTORY-ANGLES-AGREE")
    assert [message.kind for message in told] == ["note", "note"]
    mission.config["mount"]["oblique"]["roll_deg"] = 45.0
    told = with_code(read_mission(mission.save()).ledger, "TRAJECTORY-ANGLES-AGREE")
    assert "loss" in [message.kind for message in told]


def test_angles_of_another_grid_are_refused(mission, files):
    without_log(mission, files)
    nadir = write_eo(files, "nadir", zones_off=1)
    oblique = write_eo(files, "oblique")
    mission.config["events"] = {"positions": {"nadir": nadir, "oblique": oblique}}
    with refused("IMPORT-EO-GRID"):
        read_mission(mission.save())
    _, nadir["grid"] = grid_of(files)
    assert read_mission(mission.save()).stations.ok.all()


PAYLOAD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


LEVEL_TO_NORTH = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
LEVEL_TO_EAST = {"q_w": np.sqrt(0.5), "q_x": 0.0, "q_y": 0.0, "q_z": np.sqrt(0.5)}
AXES_IN_EAST_NORTH_UP = {
    "nadir": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
    "oblique": [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
}
"""Right, down and forward of a camera whose level head points to the north, to the east."""


def test_each_camera_follows_the_gimbal_of_its_own(mission, files):
    seconds = files.start.timestamp() + files.t
    heads = [
        channel("MNT[0]", seconds, **LEVEL_TO_NORTH),
        channel("MNT[1]", seconds, **LEVEL_TO_EAST),
    ]
    inputs = with_channels(opened(mission), *heads)
    mounts = mission.config["mount"]
    for camera, head in zip(CAMERAS, heads, strict=True):
        mounts[camera] |= {"attitude": head.name, "pitch_deg": 90.0, "roll_deg": 0.0}
    ledger = Ledger()
    stations = prepare_mission(load_mission(mission.save()), inputs, ledger).stations
    assert stations.ok.all()
    axes = Rotation.from_quat(stations.quaternion, scalar_first=True).as_matrix()
    for camera, expected in AXES_IN_EAST_NORTH_UP.items():
        of_camera = axes[stations.camera == camera]
        np.testing.assert_allclose(of_camera, [expected] * 3, atol=1e-9)
    assert np.isfinite(stations.aircraft_quaternion).all()
    told = with_code(ledger, "GIMBAL-FRAME")
    assert {message.where for message in told} == {"mount.nadir", "mount.oblique"}
    mounts["nadir"]["attitude"] = "MNT[7]"
    with refused("CHANNEL-MISSING") as refusal:
        flight_of(mission, inputs)
    assert "MNT[1]" in refusal.value.what


def test_dji_images_orient_themselves(mission, files):
    """Gimbal angles and positions of exiftool's table: axes forward, right, down of the payload."""
    without_log(mission, files)
    for section in ("events", "mount"):
        del mission.config[section]
    del mission.config["cameras"]["oblique"]
    table = mission.measurements().to_pandas()
    mission.observe(pa.Table.from_pandas(table[table["image"].str.startswith("nadir")]))
    rows = files.stations_of("nadir")
    camera = Rotation.from_quat(rows[QUATERNION]).inv()
    payload = Rotation.from_matrix(NED @ camera.as_matrix() @ PAYLOAD_FROM_CAMERA.T)
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
    exif.to_csv(mission.folder / "exif.csv", index=False, float_format="%.10f")
    orientation = {
        "path": "exif.csv",
        "format": "dji",
        "angles": "roll_pitch_yaw",
        "frame": "geographic",
        "heights": "ellipsoid",
    }
    mission.config["observations"]["match_names"] = ["extension"]
    prepared = prepare(mission, orientation=orientation)
    found = errors(prepared, files)
    assert prepared.stations.ok.all()
    assert found.place_m < 0.01
    assert found.height_m < 0.01
    assert found.attitude_deg < 1e-4
    with refused("CONFIG-INVALID") as refusal:
        prepare(mission, orientation=orientation | {"angles": "omega_phi_kappa"})
    assert "format: dji" in str(refusal.value)
