"""Angles come in on several roads; on each of them tie points tell another reading.

The truth is that of the simulator; grids are pyproj's and angles scipy's.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.helpers import NED_FROM_ENU, refused, with_code
from tests.stages.eo_texts import write_eo
from tests.stages.flown_images import CAMERA_FROM_BODY
from tests.stages.oriented_tables import attitudes, textbook_opk
from unbend.batch.runs import read_mission
from unbend.flight.stations import station_columns

PLACE_DEG = ["lat_deg", "lon_deg"]
CAMERA_FROM_GIMBAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


class Crossing(NamedTuple):
    """A mission of the oblique camera, whose three lines have tie points between them."""

    folder: object
    config: dict
    truth: pd.DataFrame

    @property
    def enu_from_camera(self):
        """(n, 3, 3) the camera (x right, y down, z forward) against east, north, up."""
        return attitudes(self.truth).transpose(0, 2, 1)

    @property
    def time(self):
        return pd.to_datetime(self.truth["time_utc"], utc=True)

    def read(self, sections):
        file = self.folder / "road.yaml"
        text = yaml.safe_dump(self.config | sections)
        file.write_text(text)
        return read_mission(file)

    def refusal(self, sections, code="ORIENTATION-READING"):
        with refused(code) as refusal:
            self.read(sections)
        return refusal.value.what

    def assert_true(self, sections, tolerance_deg=1e-4):
        """Places and attitudes of the stations are those of the truth."""
        columns = station_columns(self.read(sections).stations)
        stations = pd.DataFrame(columns).set_index("image")
        stations = stations.loc[self.truth["image"]]
        assert set(stations["status"]) == {"ok"}
        difference = attitudes(stations) @ self.enu_from_camera
        turned_rad = Rotation.from_matrix(difference).magnitude()
        assert np.degrees(turned_rad).max() < tolerance_deg
        assert_allclose(stations[PLACE_DEG], self.truth[PLACE_DEG], atol=1e-7)
        assert_allclose(stations["h_msl_m"], self.truth["h_msl_m"], atol=0.01)


def angles(rotations, axes):
    """(3, n) [deg]."""
    return Rotation.from_matrix(rotations).as_euler(axes, degrees=True).T


@pytest.fixture(scope="module")
def crossing(crossing_lines):
    folder, config, truth = crossing_lines
    cameras = {"c": config["cameras"]["oblique"]}
    of_one_camera = config | {"cameras": cameras, "mount": {"c": {}}}
    of_camera = truth.query("camera == 'oblique'").reset_index(drop=True)
    return Crossing(folder, of_one_camera, of_camera)


# --- exterior orientations of POSPac ----------------------------------------------------------

ORDER = (
    "First rotation is about the '{}' axis by the '{}' angle.\n"
    "Second rotation is about the '{}' axis by the '{}' angle.\n"
    "Third rotation is about the 'z' axis by the 'kappa' angle.\n"
)
OMEGA_FIRST = ORDER.format("x", "omega", "y", "phi")
PHI_FIRST = ORDER.format("y", "phi", "x", "omega")


def with_eo(crossing, axes, head, turn_deg=0.0):
    """An exterior orientation with angles about ``axes`` of the grid, kappa turned further."""
    source = write_eo(
        crossing.folder / "eo.txt",
        crossing.truth,
        axes=axes,
        head=head,
        turn_deg=turn_deg,
    )
    source |= {"format": "eo", "point": "camera"}
    return {"events": {"positions": {"c": source}}}


@pytest.mark.parametrize(
    ("axes", "head"),
    [("XYZ", OMEGA_FIRST), ("YXZ", PHI_FIRST), ("XYZ", "")],
)
def test_the_order_that_a_head_states_is_the_one_that_is_read(crossing, axes, head):
    crossing.assert_true(with_eo(crossing, axes, head))


@pytest.mark.parametrize(
    ("axes", "head", "order"),
    [
        ("YXZ", "", "phi_omega_kappa"),
        ("YXZ", OMEGA_FIRST, "phi_omega_kappa"),
        ("XYZ", PHI_FIRST, "omega_phi_kappa"),
    ],
)
def test_tie_points_tell_an_order_that_the_head_does_not(crossing, axes, head, order):
    text = crossing.refusal(with_eo(crossing, axes, head))
    assert f"if the angles are {order}" in text


def test_a_cardinal_rotation_is_a_warning_and_tie_points_tell_turned_images(crossing):
    head = OMEGA_FIRST + "Kappa cardinal rotation: 90 deg\n"
    ledger = crossing.read(with_eo(crossing, "XYZ", head)).ledger
    messages = with_code(ledger, "IMPORT-EO-HEAD")
    warning = next(message for message in messages if message.kind == "warning")
    assert "cardinal rotation of 90 deg" in warning.what

    turned = with_eo(crossing, "XYZ", head, turn_deg=90.0)
    assert "images turned by -90 degrees" in crossing.refusal(turned)


# --- a trajectory, and tags of images ---------------------------------------------------------


def with_trajectory(crossing, yaw_sign):
    """A trajectory whose body is that of the camera at rest, its rows at the exposures."""
    truth = crossing.truth
    body = NED_FROM_ENU @ crossing.enu_from_camera @ CAMERA_FROM_BODY
    yaw, pitch, roll = angles(body, "ZYX")
    rows = pd.DataFrame(
        {
            "time": crossing.time,
            "latitude": truth["lat_deg"],
            "longitude": truth["lon_deg"],
            "height": truth["h_msl_m"],
            "roll": roll,
            "pitch": pitch,
            "yaw": yaw_sign * yaw,
        }
    )
    # A row half a second before and after each exposure, where the body is the same.
    half_second = pd.Timedelta(seconds=0.5)
    before = rows.assign(time=rows["time"] - half_second)
    after = rows.assign(time=rows["time"] + half_second)
    track = pd.concat([before, rows, after]).sort_values("time")
    time_format = "%Y-%m-%dT%H:%M:%S.%f"
    track.to_csv(crossing.folder / "track.csv", index=False, date_format=time_format)
    events = rows[["time"]].assign(image=truth["image"])
    time_format += "Z"
    events.to_csv(crossing.folder / "events.csv", index=False, date_format=time_format)
    trajectory = {
        "path": "track.csv",
        "point": "camera",
        "heights": "msl",
        "time": {"system": "utc"},
        "columns": {name: name for name in rows.columns},
    }
    exposures = {"path": "events.csv", "columns": {"time_utc": "time"}}
    return {"stations": {"trajectory": trajectory}, "events": {"csv": exposures}}


def with_tags(crossing, yaw_sign):
    """A table of tags: the gimbal's axis is the optical one."""
    truth = crossing.truth
    gimbal = NED_FROM_ENU @ crossing.enu_from_camera @ CAMERA_FROM_GIMBAL
    yaw, pitch, roll = angles(gimbal, "ZYX")
    table = pd.DataFrame(
        {
            "FileName": truth["image"],
            "GPSLatitude": truth["lat_deg"],
            "GPSLongitude": truth["lon_deg"],
            "AbsoluteAltitude": truth["h_msl_m"],
            "GimbalRollDegree": roll,
            "GimbalPitchDegree": pitch,
            "GimbalYawDegree": yaw_sign * yaw,
        }
    )
    return with_orientation(crossing, table, format="dji", angles="roll_pitch_yaw")


def with_orientation(crossing, table, **orientation):
    """Sections by a table of orientations against the vertical of each station."""
    table.to_csv(crossing.folder / "table.csv", index=False)
    orientation |= {"path": "table.csv", "frame": "geographic", "heights": "msl"}
    return {"stations": {"orientation": orientation}, "events": None}


@pytest.mark.parametrize("road", [with_trajectory, with_tags])
def test_tie_points_tell_the_reading(crossing, road):
    crossing.assert_true(road(crossing, 1))
    assert "with the other sign of yaw" in crossing.refusal(road(crossing, -1))


# --- our own tables ---------------------------------------------------------------------------


def test_a_table_against_each_vertical_is_read_and_one_in_one_frame_refused(crossing):
    truth = crossing.truth
    table = truth[["image", "lat_deg", "lon_deg", "h_msl_m"]].copy()
    table[["omega_deg", "phi_deg", "kappa_deg"]] = textbook_opk(attitudes(truth))
    angles = {"angles": "omega_phi_kappa", "date": "2026-05-01"}
    crossing.assert_true(with_orientation(crossing, table, **angles), 1e-6)

    table["origin_lat_deg"] = 47.0
    table["origin_lon_deg"] = 8.0
    table["origin_h_ellipsoid_m"] = 400.0
    in_one_frame = with_orientation(crossing, table, **angles)
    crossing.refusal(in_one_frame, "ORIENTATION-FRAME")
