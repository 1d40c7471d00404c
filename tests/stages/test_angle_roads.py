"""Angles come in on several roads; on each of them tie points tell another reading.

The truth is that of the simulator; grids are pyproj's and angles scipy's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pyproj
import pytest
import yaml
from scipy.spatial.transform import Rotation

from unbend.batch.runs import read_mission
from unbend.errors import InputError, MissionError

PHOTOGRAMMETRIC = np.diag([1.0, -1.0, -1.0])
GPS_EPOCH = pd.Timestamp("1980-01-06", tz="UTC")
LEAP_SECONDS = 18
STATED = {
    "omega first": "First rotation is about the 'x' axis by the 'omega' angle.\n"
    "Second rotation is about the 'y' axis by the 'phi' angle.\n"
    "Third rotation is about the 'z' axis by the 'kappa' angle.\n",
    "phi first": "First rotation is about the 'y' axis by the 'phi' angle.\n"
    "Second rotation is about the 'x' axis by the 'omega' angle.\n"
    "Third rotation is about the 'z' axis by the 'kappa' angle.\n",
    "nothing": "",
}


@pytest.fixture(scope="module")
def crossing(tmp_path_factory, fly_crossing_lines):
    """Three lines with tie points between them: a mission of the oblique camera, and its truth."""
    folder = tmp_path_factory.mktemp("roads")
    flown, config = fly_crossing_lines(folder)
    del config["log"]
    camera = config["cameras"]["oblique"]
    del camera["window"]
    config |= {"cameras": {"c": camera}, "mount": {"c": {}}}
    truth = pq.read_table(flown.truth / "stations.parquet").to_pandas()
    return folder, config, truth[truth["camera"] == "oblique"].reset_index(drop=True)


def enu_from_camera(truth: pd.DataFrame) -> np.ndarray:
    """(n, 3, 3) the camera (x right, y down, z forward) against east, north, up."""
    camera_from_enu = Rotation.from_quat(truth[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
    return camera_from_enu.as_matrix().transpose(0, 2, 1)


def prepared(crossing, sections: dict):
    folder, config, _ = crossing
    (folder / "road.yaml").write_text(yaml.safe_dump(config | sections), encoding="utf-8")
    return read_mission(folder / "road.yaml")


def refused(crossing, sections: dict) -> str:
    with pytest.raises(InputError, match="ORIENTATION-READING") as refusal:
        prepared(crossing, sections)
    return refusal.value.what


def worst_turn_deg(stations, truth: pd.DataFrame) -> float:
    """How far the attitudes of stations are from the truth [deg]."""
    row = {name: number for number, name in enumerate(stations.image.tolist())}
    q = stations.quaternion[[row[name] for name in truth["image"]]]
    apart = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() @ enu_from_camera(truth)
    return float(np.degrees(Rotation.from_matrix(apart).magnitude().max()))


# --- exterior orientations of POSPac ----------------------------------------------------------


def write_eo(path: Path, truth: pd.DataFrame, axes: str, head: str, turn_deg: float = 0.0) -> None:
    """An exterior orientation with angles about ``axes`` of the grid, kappa turned further."""
    zone = int(np.floor((truth["lon_deg"].iloc[0] + 180.0) / 6.0)) + 1
    utm = pyproj.Proj(f"EPSG:{32600 + zone}")
    lon = truth["lon_deg"].to_numpy()
    lat = truth["lat_deg"].to_numpy()
    east, north = utm(lon, lat)
    convergence = np.asarray(utm.get_factors(lon, lat).meridian_convergence)
    grid_from_enu = Rotation.from_euler("z", convergence[:, None], degrees=True).as_matrix()
    matrix = grid_from_enu @ enu_from_camera(truth) @ PHOTOGRAMMETRIC
    first, second, kappa = Rotation.from_matrix(matrix).as_euler(axes, degrees=True).T
    angle = {axes[0]: first, axes[1]: second}
    time = pd.to_datetime(truth["time_utc"], utc=True) - GPS_EPOCH
    seconds = (time.dt.total_seconds() + LEAP_SECONDS) % (7 * 86_400)
    text = (
        f"{head}Grid: Zone: UTM North {zone}; lat, long in Deg; orientation in Degrees ;\n\n"
        "ID EVENT TIME (s) EASTING NORTHING ORTHOMETRIC HEIGHT OMEGA PHI KAPPA LAT LONG\n"
    )
    for k in range(len(truth)):
        text += (
            f"{truth['image'][k]} {k + 1} {seconds[k]:.6f} {east[k]:.3f} {north[k]:.3f} "
            f"{truth['h_msl_m'][k]:.4f} {angle['X'][k]:.7f} {angle['Y'][k]:.7f} "
            f"{kappa[k] + turn_deg:.7f} {lat[k]:.9f} {lon[k]:.9f}\n"
        )
    path.write_text(text, encoding="utf-8")


def with_eo(crossing, axes: str, head: str, turn_deg: float = 0.0) -> dict:
    folder, _, truth = crossing
    write_eo(folder / "eo.txt", truth, axes, head, turn_deg)
    week = int((pd.to_datetime(truth["time_utc"][0], utc=True) - GPS_EPOCH).days // 7)
    source = {
        "path": "eo.txt",
        "format": "eo",
        "image": "{name}",
        "point": "camera",
        "time": {"system": "gpst", "week": week},
    }
    return {"events": {"positions": {"c": source}}}


@pytest.mark.parametrize(
    ("axes", "stated"), [("XYZ", "omega first"), ("YXZ", "phi first"), ("XYZ", "nothing")]
)
def test_the_order_that_a_head_states_is_the_one_that_is_read(crossing, axes, stated):
    stations = prepared(crossing, with_eo(crossing, axes, STATED[stated])).stations
    assert worst_turn_deg(stations, crossing[2]) < 1e-4


@pytest.mark.parametrize(
    ("axes", "stated", "order"),
    [
        ("YXZ", "nothing", "phi_omega_kappa"),
        ("YXZ", "omega first", "phi_omega_kappa"),
        ("XYZ", "phi first", "omega_phi_kappa"),
    ],
)
def test_tie_points_tell_an_order_that_the_head_does_not(crossing, axes, stated, order):
    what = refused(crossing, with_eo(crossing, axes, STATED[stated]))
    assert f"if the angles are {order}" in what


def test_a_cardinal_rotation_is_a_warning_and_tie_points_tell_turned_images(crossing):
    head = STATED["omega first"] + "Kappa cardinal rotation: 90 deg\n"
    ledger = prepared(crossing, with_eo(crossing, "XYZ", head)).ledger
    told = [entry for entry in ledger if entry.code == "IMPORT-EO-HEAD" and entry.kind == "warning"]
    assert "cardinal rotation of 90 deg" in told[0].what
    what = refused(crossing, with_eo(crossing, "XYZ", head, turn_deg=90.0))
    assert "images turned by -90 degrees" in what


# --- a trajectory -----------------------------------------------------------------------------


def with_trajectory(crossing, change) -> dict:
    """A trajectory whose body is that of the camera at rest, its rows at the exposures."""
    folder, _, truth = crossing
    ned_from_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    camera_from_body = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    body = ned_from_enu @ enu_from_camera(truth) @ camera_from_body
    yaw, pitch, roll = Rotation.from_matrix(body).as_euler("ZYX", degrees=True).T
    time = pd.to_datetime(truth["time_utc"], utc=True)
    rows = pd.DataFrame(
        {"time": time, "lat": truth["lat_deg"], "lon": truth["lon_deg"], "h": truth["h_msl_m"]}
    )
    rows["roll"], rows["pitch"], rows["yaw"] = change(roll, pitch, yaw)
    # A row a second before and after each exposure, where the body is the same.
    parts = [rows.assign(time=rows["time"] + pd.Timedelta(s, "s")) for s in (-0.5, 0.0, 0.5)]
    table = pd.concat(parts).sort_values("time")
    table["time"] = table["time"].dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    table.to_csv(folder / "track.csv", index=False)
    truth.assign(time=time.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ"))[["image", "time"]].to_csv(
        folder / "events.csv", index=False
    )
    columns = {name: name for name in ("time", "roll", "pitch", "yaw")}
    columns |= {"latitude": "lat", "longitude": "lon", "height": "h"}
    return {
        "stations": {
            "trajectory": {
                "path": "track.csv",
                "point": "camera",
                "heights": "msl",
                "time": {"system": "utc"},
                "columns": columns,
            },
        },
        "events": {"csv": {"path": "events.csv", "columns": {"time_utc": "time"}}},
    }


def test_tie_points_tell_the_reading_of_a_trajectory_without_a_log(crossing):
    right = prepared(crossing, with_trajectory(crossing, lambda *angles: angles))
    assert worst_turn_deg(right.stations, crossing[2]) < 1e-4
    turned = with_trajectory(crossing, lambda roll, pitch, yaw: (roll, pitch, -yaw))
    assert "with the other sign of yaw" in refused(crossing, turned)


# --- tags of images ---------------------------------------------------------------------------


def with_tags(crossing, change) -> dict:
    """A table of tags: the gimbal's axis is the optical one."""
    folder, _, truth = crossing
    ned_from_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    camera_from_gimbal = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    gimbal = ned_from_enu @ enu_from_camera(truth) @ camera_from_gimbal
    yaw, pitch, roll = change(*Rotation.from_matrix(gimbal).as_euler("ZYX", degrees=True).T)
    table = pd.DataFrame(
        {
            "SourceFile": truth["image"],
            "GPSLatitude": truth["lat_deg"],
            "GPSLongitude": truth["lon_deg"],
            "AbsoluteAltitude": truth["h_msl_m"],
            "GimbalRollDegree": roll,
            "GimbalPitchDegree": pitch,
            "GimbalYawDegree": yaw,
        }
    )
    table.to_csv(folder / "tags.csv", index=False)
    orientation = {
        "path": "tags.csv",
        "format": "dji",
        "angles": "roll_pitch_yaw",
        "frame": "geographic",
        "heights": "msl",
    }
    return {"stations": {"orientation": orientation}, "events": None}


def test_tie_points_tell_the_reading_of_a_gimbal(crossing):
    right = prepared(crossing, with_tags(crossing, lambda *angles: angles))
    assert worst_turn_deg(right.stations, crossing[2]) < 1e-4
    turned = with_tags(crossing, lambda yaw, pitch, roll: (-yaw, pitch, roll))
    assert "with the other sign of yaw" in refused(crossing, turned)


# --- our own tables ---------------------------------------------------------------------------


def with_own_table(crossing, frame: object) -> dict:
    """A table with the names of our own in one frame, read against the vertical of each station."""
    folder, _, truth = crossing
    matrix = enu_from_camera(truth) @ PHOTOGRAMMETRIC
    omega, phi, kappa = Rotation.from_matrix(matrix).as_euler("XYZ", degrees=True).T
    table = pd.DataFrame(
        {
            "image": truth["image"],
            "lat_deg": truth["lat_deg"],
            "lon_deg": truth["lon_deg"],
            "h_msl_m": truth["h_msl_m"],
            "omega_deg": omega,
            "phi_deg": phi,
            "kappa_deg": kappa,
        }
    )
    if frame is not None:
        table = table.assign(origin_lat_deg=47.0, origin_lon_deg=8.0, origin_h_ellipsoid_m=400.0)
    table.to_csv(folder / "own.csv", index=False)
    orientation = {
        "path": "own.csv",
        "angles": "omega_phi_kappa",
        "frame": "geographic",
        "heights": "msl",
        "date": "2026-05-01",
    }
    return {"stations": {"orientation": orientation}, "events": None}


def test_a_table_against_each_vertical_is_read_and_one_in_one_frame_refused(crossing):
    stations = prepared(crossing, with_own_table(crossing, None)).stations
    assert worst_turn_deg(stations, crossing[2]) < 1e-6
    with pytest.raises(MissionError, match="ORIENTATION-FRAME"):
        prepared(crossing, with_own_table(crossing, "one"))
