"""Stations of a trajectory or an EO text without a log, and cameras with heads of their own.

Truth is that of the simulated flight.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.helpers import channel, refused, with_code
from tests.stages.block_files import CABIN, matrices
from tests.stages.eo_texts import GRID, ZONE, write_eo
from tests.stages.flown_files import (
    CAMERAS,
    Files,
    assert_true,
    errors,
)
from tests.stages.other_logs import flight_of, opened, read_folder, refusal_to_read, with_channels
from unbend import load_mission
from unbend.messages import Ledger
from unbend.simulate.flight import UNDULATION_M
from unbend.stages.story import prepare_mission


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
    return read_folder(mission)


@pytest.mark.parametrize("section_of", [sbet_of_week, table_of])
def test_a_trajectory_gives_position_height_and_attitude(without_log, files, section_of):
    prepared = prepare(without_log, trajectory=section_of(files))
    assert prepared.stations.ok.all()
    assert_true(prepared, files)
    assert prepared.flight.log is None
    assert not prepared.ledger.has_losses
    alone, *_ = with_code(prepared.ledger, "TRAJECTORY-ALONE")
    assert alone.kind == "warning"


@pytest.mark.parametrize(
    ("written", "code"),
    [(Files.sbet, "IMPORT-WEEK"), (Files.pos, "STATIONS-ATTITUDE")],
)
def test_what_no_log_gives_is_asked_for(without_log, files, written, code):
    without_log.config["stations"] = {"trajectory": written(files)}
    refusal_to_read(without_log, code)


def test_heights_above_the_ellipsoid_become_those_above_the_sea_by_the_geoid(without_log, files):
    """EGM96 has 47.6 m within 2 m at the simulated field."""
    del without_log.config["mission"]["undulation_m"]
    stations = prepare(without_log, trajectory=sbet_of_week(files)).stations
    assert stations.ok.all()
    undulation_m = stations.h_ellipsoid_m - stations.h_msl_m
    assert undulation_m == pytest.approx(UNDULATION_M, abs=2.0)


def eo_of(files, camera, zone=ZONE):
    """An EO text of the camera's true stations; its head may name another zone."""
    stations = files.stations_of(camera).reset_index()
    path = files.folder / f"{camera}.txt"
    return write_eo(
        path,
        stations,
        height="h_ellipsoid_m",
        zone=zone,
    )


def positions_of(files):
    """Events by the EO texts of both cameras."""
    return {"positions": {camera: eo_of(files, camera) for camera in CAMERAS}}


def test_an_eo_text_needs_neither_log_nor_trajectory(without_log, files):
    without_log.config["events"] = positions_of(files)
    prepared = read_folder(without_log)
    off = errors(prepared, files)
    assert prepared.stations.ok.all()
    assert off.place_m < 0.01
    assert off.height_m < 0.01
    assert off.attitude_deg < 1e-4


def test_an_eo_text_does_not_state_the_attitude_of_the_aircraft(without_log, files):
    """The direction of a window of the aircraft follows from the mount, which the ledger says."""
    without_log.config["events"] = positions_of(files)
    for camera in without_log.config["cameras"].values():
        camera["window"]["frame"] = "body"
    manifest = without_log.run_to_manifest()
    warned = []
    for entry in manifest["ledger"]:
        if entry["code"] == "WINDOW-MOUNT":
            warned.append(entry["where"])
    assert len(warned) == 2
    assert "cameras.oblique.window.frame" in warned


def test_the_attitude_of_an_eo_text_is_compared_with_the_log(mission, files):
    """By the mounts both cameras' angles are the aircraft's; by another mount they are not."""
    mission.config["events"] = positions_of(files)
    prepared = read_folder(mission)
    assert errors(prepared, files).attitude_deg < 1e-4
    assert kinds_of(prepared, "TRAJECTORY-ANGLES-AGREE") == ["note", "note"]

    mission.config["mount"]["oblique"]["roll_deg"] = 45.0
    prepared = read_folder(mission)
    assert "loss" in kinds_of(prepared, "TRAJECTORY-ANGLES-AGREE")


def kinds_of(prepared, code):
    return [message.kind for message in with_code(prepared.ledger, code)]


def test_angles_of_another_grid_are_refused(without_log, files):
    nadir = eo_of(files, "nadir", ZONE + 1)
    oblique = eo_of(files, "oblique")
    without_log.config["events"] = {"positions": {"nadir": nadir, "oblique": oblique}}
    refusal_to_read(without_log, "IMPORT-EO-GRID")
    nadir["grid"] = GRID
    assert read_folder(without_log).stations.ok.all()


HALF = np.sqrt(0.5)
LEVEL_TO_NORTH = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
LEVEL_TO_EAST = {"q_w": HALF, "q_x": 0.0, "q_y": 0.0, "q_z": HALF}
AXES_IN_EAST_NORTH_UP = {
    "nadir": [
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
        [0.0, 1.0, 0.0],
    ],
    "oblique": [
        [0.0, -1.0, 0.0],
        [0.0, 0.0, -1.0],
        [1.0, 0.0, 0.0],
    ],
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
    with refused("CHANNEL-MISSING", what="MNT[1]"):
        flight_of(mission, inputs)
