"""Angles come in on several roads; on each of them tie points tell another reading.

The truth is that of the simulator; grids are pyproj's and angles scipy's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pyproj
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.helpers import refused, with_code
from unbend.batch.runs import read_mission

PHOTOGRAMMETRIC = np.diag([1.0, -1.0, -1.0])
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
CAMERA_FROM_GIMBAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
GPS_EPOCH = pd.Timestamp("1980-01-06", tz="UTC")
LEAP_SECONDS = 18
WEEK_S = 7 * 86_400


class Crossing(NamedTuple):
    """A mission of the oblique camera, whose three lines have tie points between them."""

    folder: object
    config: dict
    truth: pd.DataFrame

    @property
    def enu_from_camera(self) -> np.ndarray:
        """(n, 3, 3) the camera (x right, y down, z forward) against east, north, up."""
        camera_from_enu = Rotation.from_quat(self.truth[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
        return camera_from_enu.inv().as_matrix()

    @property
    def time(self) -> pd.Series:
        return pd.to_datetime(self.truth["time_utc"], utc=True)

    def read(self, sections: dict):
        file = self.folder / "road.yaml"
        file.write_text(yaml.safe_dump(self.config | sections), encoding="utf-8")
        return read_mission(file)

    def refusal(self, sections: dict, code: str = "ORIENTATION-READING") -> str:
        with refused(code) as refusal:
            self.read(sections)
        return refusal.value.what

    def assert_true(self, sections: dict, tolerance_deg: float = 1e-4) -> None:
        """The attitudes of the stations are those of the truth."""
        stations = self.read(sections).stations
        quaternions = pd.DataFrame(stations.quaternion, index=stations.image)
        scalar_last = quaternions.loc[self.truth["image"], [1, 2, 3, 0]].to_numpy()
        apart = Rotation.from_quat(scalar_last).as_matrix() @ self.enu_from_camera
        worst_rad = Rotation.from_matrix(apart).magnitude().max()
        assert np.degrees(worst_rad) < tolerance_deg


def angles(matrices: np.ndarray, axes: str) -> np.ndarray:
    """(3, n) [deg]."""
    return Rotation.from_matrix(matrices).as_euler(axes, degrees=True).T


@pytest.fixture(scope="module")
def crossing(tmp_path_factory, fly_crossing_lines) -> Crossing:
    folder = tmp_path_factory.mktemp("roads")
    flown, config = fly_crossing_lines(folder)
    del config["log"]
    camera = config["cameras"]["oblique"]
    del camera["window"]
    config |= {"cameras": {"c": camera}, "mount": {"c": {}}}
    truth = pq.read_table(flown.truth / "stations.parquet").to_pandas()
    of_camera = truth[truth["camera"] == "oblique"].reset_index(drop=True)
    return Crossing(folder, config, of_camera)


# --- exterior orientations of POSPac ----------------------------------------------------------

ORDER = (
    "First rotation is about the '{}' axis by the '{}' angle.\n"
    "Second rotation is about the '{}' axis by the '{}' angle.\n"
    "Third rotation is about the 'z' axis by the 'kappa' angle.\n"
)
OMEGA_FIRST = ORDER.format("x", "omega", "y", "phi")
PHI_FIRST = ORDER.format("y", "phi", "x", "omega")


def with_eo(crossing: Crossing, axes: str, head: str, turn_deg: float = 0.0) -> dict:
    """An exterior orientation with angles about ``axes`` of the grid, kappa turned further."""
    truth = crossing.truth
    lon = truth["lon_deg"].to_numpy()
    lat = truth["lat_deg"].to_numpy()
    zone = int(np.floor((lon[0] + 180.0) / 6.0)) + 1
    utm = pyproj.Proj(f"EPSG:{32600 + zone}")
    east, north = utm(lon, lat)
    convergence = np.asarray(utm.get_factors(lon, lat).meridian_convergence)
    grid_from_enu = Rotation.from_euler("z", convergence[:, None], degrees=True).as_matrix()
    grid_from_image = grid_from_enu @ crossing.enu_from_camera @ PHOTOGRAMMETRIC
    first, second, kappa = angles(grid_from_image, axes)
    angle = {axes[0]: first, axes[1]: second}
    gps_s = (crossing.time - GPS_EPOCH).dt.total_seconds() + LEAP_SECONDS
    table = pd.DataFrame(
        {
            "ID": truth["image"],
            "EVENT": np.arange(len(truth)) + 1,
            "TIME (s)": gps_s % WEEK_S,
            "EASTING": east,
            "NORTHING": north,
            "ORTHOMETRIC HEIGHT": truth["h_msl_m"],
            "OMEGA": angle["X"],
            "PHI": angle["Y"],
            "KAPPA": kappa + turn_deg,
            "LAT": lat,
            "LONG": lon,
        }
    )
    text = f"{head}Grid: Zone: UTM North {zone}; lat, long in Deg; orientation in Degrees ;\n\n"
    text += " ".join(table.columns) + "\n"
    text += table.to_csv(sep=" ", header=False, index=False, float_format="%.9f")
    (crossing.folder / "eo.txt").write_text(text, encoding="utf-8")
    source = {
        "path": "eo.txt",
        "format": "eo",
        "image": "{name}",
        "point": "camera",
        "time": {"system": "gpst", "week": int(gps_s[0] // WEEK_S)},
    }
    return {"events": {"positions": {"c": source}}}


@pytest.mark.parametrize(("axes", "head"), [("XYZ", OMEGA_FIRST), ("YXZ", PHI_FIRST), ("XYZ", "")])
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
    warnings = [note for note in with_code(ledger, "IMPORT-EO-HEAD") if note.kind == "warning"]
    assert "cardinal rotation of 90 deg" in warnings[0].what
    text = crossing.refusal(with_eo(crossing, "XYZ", head, turn_deg=90.0))
    assert "images turned by -90 degrees" in text


# --- a trajectory, and tags of images ---------------------------------------------------------


def with_trajectory(crossing: Crossing, yaw_sign: int) -> dict:
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
    parts = [rows.assign(time=rows["time"] + pd.Timedelta(s, "s")) for s in (-0.5, 0.0, 0.5)]
    track = pd.concat(parts).sort_values("time")
    time_format = "%Y-%m-%dT%H:%M:%S.%f"
    track.to_csv(crossing.folder / "track.csv", index=False, date_format=time_format)
    events = pd.DataFrame({"image": truth["image"], "time": crossing.time})
    events.to_csv(crossing.folder / "events.csv", index=False, date_format=time_format + "Z")
    trajectory = {
        "path": "track.csv",
        "point": "camera",
        "heights": "msl",
        "time": {"system": "utc"},
        "columns": {name: name for name in rows.columns},
    }
    return {
        "stations": {"trajectory": trajectory},
        "events": {"csv": {"path": "events.csv", "columns": {"time_utc": "time"}}},
    }


def with_tags(crossing: Crossing, yaw_sign: int) -> dict:
    """A table of tags: the gimbal's axis is the optical one."""
    truth = crossing.truth
    gimbal = NED_FROM_ENU @ crossing.enu_from_camera @ CAMERA_FROM_GIMBAL
    yaw, pitch, roll = angles(gimbal, "ZYX")
    table = pd.DataFrame(
        {
            "SourceFile": truth["image"],
            "GPSLatitude": truth["lat_deg"],
            "GPSLongitude": truth["lon_deg"],
            "AbsoluteAltitude": truth["h_msl_m"],
            "GimbalRollDegree": roll,
            "GimbalPitchDegree": pitch,
            "GimbalYawDegree": yaw_sign * yaw,
        }
    )
    return with_orientation(crossing, table, format="dji", angles="roll_pitch_yaw")


def with_orientation(crossing: Crossing, table: pd.DataFrame, **stated: str) -> dict:
    """Sections by a table of orientations against the vertical of each station."""
    table.to_csv(crossing.folder / "table.csv", index=False)
    same = {"path": "table.csv", "frame": "geographic", "heights": "msl"}
    return {"stations": {"orientation": same | stated}, "events": None}


@pytest.mark.parametrize("road", [with_trajectory, with_tags])
def test_tie_points_tell_the_reading(crossing, road):
    crossing.assert_true(road(crossing, 1))
    assert "with the other sign of yaw" in crossing.refusal(road(crossing, -1))


# --- our own tables ---------------------------------------------------------------------------


def test_a_table_against_each_vertical_is_read_and_one_in_one_frame_refused(crossing):
    omega, phi, kappa = angles(crossing.enu_from_camera @ PHOTOGRAMMETRIC, "XYZ")
    table = crossing.truth[["image", "lat_deg", "lon_deg", "h_msl_m"]]
    table = table.assign(omega_deg=omega, phi_deg=phi, kappa_deg=kappa)
    stated = {"angles": "omega_phi_kappa", "date": "2026-05-01"}
    crossing.assert_true(with_orientation(crossing, table, **stated), 1e-6)
    in_one_frame = table.assign(origin_lat_deg=47.0, origin_lon_deg=8.0, origin_h_ellipsoid_m=400.0)
    crossing.refusal(with_orientation(crossing, in_one_frame, **stated), "ORIENTATION-FRAME")
