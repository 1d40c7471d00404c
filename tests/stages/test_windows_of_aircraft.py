"""Windows in the frame of the aircraft, of cameras whose own angles are given: by log and mount."""

import copy
import math

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.helpers import codes_of, entry_of, with_code
from tests.stages.oriented_tables import PINHOLE, columns_of
from tests.stages.other_logs import message_of, read_folder
from unbend import correct
from unbend.batch.results import read_manifest

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

CORRECTED = ["x_corrected_px", "y_corrected_px"]
CABIN = {
    "pressure_hpa": 900.0,
    "temperature_c": 21.0,
    "relative_humidity": 0.0,
}
AT_REST = {}
SIN_20 = math.sin(math.radians(20.0))
COS_20 = math.cos(math.radians(20.0))
SIN_10 = math.sin(math.radians(10.0))
COS_10 = math.cos(math.radians(10.0))


# ---------------------------------------------------------------- by the mount, without a log


@pytest.fixture
def corrected():
    """Corrects two images of a level flight at 3 km in US 1976, behind a window."""
    place = {
        "latitude": 47.0,
        "longitude": 8.0,
        "h_msl_m": 3000.0,
    }
    level_camera = {
        "omega": 0.0,
        "phi": 0.0,
        "kappa": 0.0,
    }
    level_aircraft = {
        "roll": 0.0,
        "pitch": 0.0,
        "yaw": 0.0,
    }
    observations = pd.DataFrame(
        {
            "image": ["a", "a", "b"],
            "point": ["1", "2", "3"],
            "x_px": [200.5, 7012.4, 12000.0],
            "y_px": [300.0, 5291.7, 9000.0],
            "h_g_m": 400.0,
        }
    )

    def run(angles="camera", mount=AT_REST, **window):
        attitude = level_camera
        if angles == "aircraft":
            attitude = level_aircraft
        stations = pd.DataFrame({"image": ["a", "b"]})
        stations = stations.assign(**place, **attitude)
        camera = PINHOLE | {"window": {"cabin": CABIN} | window}
        return correct(
            observations,
            stations,
            "us1976",
            {"main": camera},
            mount={"main": mount},
        )

    return run


def test_the_ledger_says_that_the_direction_of_a_window_follows_from_the_mount(corrected):
    result = corrected(frame="body")
    entry = entry_of(result.attrs, "WINDOW-MOUNT")
    assert entry["kind"] == "warning"
    assert entry["where"] == "cameras.main.window.frame"
    assert entry["count"] == 2
    assert "follows from mount.main" in entry["what"]

    # Of US 1976 by its own table: 701.08 hPa and 268.66 K at 3 km; air of 15 degC and 1013.25 hPa
    # has n - 1 = 277.9e-6 at this light.
    per_density = 277.9e-6 / (1013.25 / 288.15)
    inside = per_density * 900.0 / 294.15
    outside = per_density * 701.08 / 268.66
    tangent = math.tan(math.radians(1.0))
    by_degree_px = 20_000.0 * (inside - outside) * tangent
    assert entry["values"]["px"] == pytest.approx(by_degree_px, rel=0.02)


def test_one_degree_behind_the_window_shifts_points_as_the_ledger_says(corrected):
    """A camera that leans by 5 degrees behind the window, beside one that does not."""
    lean = math.radians(5.0)
    square = corrected(frame="body")
    leaning = corrected(normal=[math.sin(lean), 0.0, math.cos(lean)])
    x_px = "x_corrected_px"
    shift_px = leaning[x_px] - square[x_px]
    entry = entry_of(square.attrs, "WINDOW-MOUNT")
    expected_px = 5.0 * entry["values"]["px"]
    assert abs(shift_px[1]) == pytest.approx(expected_px, rel=0.02)


@pytest.mark.parametrize(
    ("mount", "normal"),
    [
        # It looks to the right by 20 degrees: the belly's normal is to the left of its axis.
        ({"roll_deg": -20.0}, [-SIN_20, 0.0, COS_20]),
        # It looks ahead by 10 degrees, up in the image: the belly's normal is below.
        ({"pitch_deg": 10.0}, [0.0, SIN_10, COS_10]),
    ],
    ids=["to the right", "ahead"],
)
def test_a_window_in_the_belly_stands_before_a_camera_as_its_mount_says(corrected, mount, normal):
    of_body = corrected(frame="body", mount=mount)
    of_camera = corrected(normal=normal)
    square = corrected()
    expected = of_camera[CORRECTED].to_numpy()
    result = of_body[CORRECTED].to_numpy()
    assert_allclose(result, expected, rtol=0.0, atol=1e-9)
    assert np.abs(result - square[CORRECTED]).max(axis=None) > 0.03


def test_nothing_is_said_where_the_direction_is_known(corrected):
    in_camera = corrected(frame="camera")
    assert "WINDOW-MOUNT" not in codes_of(in_camera.attrs)
    by_aircraft = corrected(angles="aircraft", frame="body")
    assert "WINDOW-MOUNT" not in codes_of(by_aircraft.attrs)


# ---------------------------------------------------------------- by the log beside a block


@pytest.fixture(scope="module")
def in_the_belly(mission_factory, tmp_path_factory):
    """The mission by its log, both cameras behind windows in the belly."""
    mission = mission_factory(tmp_path_factory.mktemp("belly") / "mission")
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN, "frame": "body"}
    mission.run_to_manifest()
    return mission


@pytest.fixture
def oriented(mission_factory, in_the_belly, tmp_path):
    """The same with the angles of the cameras from a table, and mounts that are not those flown."""
    mission = mission_factory(tmp_path / "mission")
    mission.config = copy.deepcopy(in_the_belly.config)
    del mission.config["mount"]
    del mission.config["events"]
    mission.config["stations"] = {
        "orientation": {
            "path": "block.csv",
            "angles": "omega_phi_kappa",
            "frame": "geographic",
            "heights": "msl",
            "columns": {"camera": "camera", "time_utc": "time"},
        }
    }
    mission.table = columns_of(in_the_belly.station_rows())
    mission.table.to_csv(mission.folder / "block.csv", index=False)
    return mission


def name_aircraft(mission):
    mission.config["log"]["channels"]["aircraft_attitude"] = "ATT"


def test_the_attitude_of_the_aircraft_is_that_of_the_named_channel(oriented, in_the_belly):
    """The mounts at rest would put the window 45 degrees off before the oblique camera."""
    expected = in_the_belly.result_rows()["r_cc_rad"]
    of_log = read_manifest(in_the_belly.output).results.ledger

    by_mount = oriented.run_to_manifest()
    wrong = oriented.result_rows()["r_cc_rad"]
    name_aircraft(oriented)
    by_log = oriented.run_to_manifest()
    right = oriented.result_rows()["r_cc_rad"]

    assert np.abs(wrong - expected).max() > 1e-5
    assert_allclose(right, expected, rtol=0.0, atol=1e-9)
    said_with_log = [entry.code for entry in of_log]
    assert "WINDOW-MOUNT" not in said_with_log
    assert "WINDOW-MOUNT" in codes_of(by_mount)
    assert "WINDOW-MOUNT" not in codes_of(by_log)


def test_an_image_without_the_attitude_of_the_aircraft_is_suspect(oriented):
    name_aircraft(oriented)
    late = oriented.table.copy()
    late.loc[0, "time"] = "2035-01-01T00:00:00Z"
    late.to_csv(oriented.folder / "block.csv", index=False)

    prepared = read_folder(oriented)

    loss = message_of(prepared, "AIRCRAFT-ATTITUDE-MISSING")
    assert loss.kind == "loss"
    assert loss.count == 1
    assert prepared.stations.status[0] == "suspect"
    assert prepared.stations.ok[1:].all()
    assert not with_code(prepared.ledger, "WINDOW-MOUNT")
