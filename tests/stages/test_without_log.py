"""Stations of a trajectory or an EO text without a log, and cameras with heads of their own.

Truth is that of the simulated flight; angles in a grid are made here by pyproj and by the matrix.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from tests.stages.test_imports import (
    GPS_EPOCH,
    NEAR_M,
    Files,
    angles,
    csv_of,
    entries,
    errors,
    files,
    truth,
)
from unbend.batch import opening
from unbend.batch.runs import read_mission
from unbend.errors import ConfigError, InputError, MissionError
from unbend.flight.channels import Channel, Source
from unbend.simulate.flight import UNDULATION_M

__all__ = ["files", "truth"]

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
CABIN = {"pressure_hpa": 812.0, "temperature_c": 21.0, "relative_humidity": 0.3}


def without_log(mission, files: Files, events: str = "csv") -> None:
    """The mission without its log: events with times from the truth, air of the standard."""
    del mission.config["log"]
    mission.config["mission"]["undulation_m"] = UNDULATION_M
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    if events == "csv":
        rows = [
            f"{image},{row['camera']},{row['time_utc']:%Y-%m-%dT%H:%M:%S.%fZ}"
            for image, row in files.stations.iterrows()
        ]
        text = "\n".join(["image,camera,time_utc", *rows])
        (mission.folder / "events.csv").write_text(text + "\n")
        columns = {"time_utc": "time_utc", "camera": "camera"}
        mission.config["events"] = {"csv": {"path": "events.csv", "columns": columns}}


def week_of(files: Files) -> int:
    return files.tow(0.0)[0]


@pytest.mark.parametrize("form", ["sbet", "csv"])
def test_a_trajectory_gives_position_height_and_attitude_without_a_log(
    mission, files, truth, form, plain_report
):
    without_log(mission, files)
    section = files.sbet() if form == "sbet" else csv_of(files, angles())
    if form == "sbet":
        section["time"]["week"] = week_of(files)
    mission.config["stations"] = {"trajectory": section}
    ended = mission.run()
    assert ended.code == 0, ended.text
    prepared = read_mission(mission.save())
    place, height, attitude = errors(prepared, truth)
    assert prepared.stations.ok.all()
    assert place < NEAR_M
    assert height < 0.05
    assert attitude < 0.02
    assert prepared.flight.log is None
    assert entries(prepared, "TRAJECTORY-ALONE")[0].kind == "warning"


def test_a_week_that_no_log_gives_is_asked_for(mission, files):
    without_log(mission, files)
    mission.config["stations"] = {"trajectory": files.sbet()}
    with pytest.raises(InputError) as caught:
        read_mission(mission.save())
    assert caught.value.code == "IMPORT-WEEK"


def test_positions_alone_do_not_say_where_a_camera_looks(mission, files):
    without_log(mission, files)
    mission.config["stations"] = {"trajectory": files.pos()}
    with pytest.raises(MissionError) as caught:
        read_mission(mission.save())
    assert caught.value.code == "STATIONS-ATTITUDE"


def test_heights_above_the_ellipsoid_become_those_above_the_sea_by_the_geoid(mission, files):
    """EGM96 has 47.6 m within 2 m at the simulated field."""
    without_log(mission, files)
    del mission.config["mission"]["undulation_m"]
    section = files.sbet()
    section["time"]["week"] = week_of(files)
    mission.config["stations"] = {"trajectory": section}
    stations = read_mission(mission.save()).stations
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
    with pytest.raises(ConfigError, match=words):
        read_mission(mission.save())


def convergence(lat: np.ndarray, lon: np.ndarray, grid: str) -> np.ndarray:
    """True minus grid azimuth [rad], by a step to the north of the projection itself."""
    project = pyproj.Proj(grid)
    here = np.array(project(lon, lat))
    there = np.array(project(lon, lat + 1e-5))
    return -np.arctan2(*(there - here))


def write_eo(files: Files, camera: str, grid: str = "EPSG:32632", zone: str = "UTM North 32"):
    """An EO text of the camera's true stations; omega, phi, kappa from the elements of M."""
    rows = files.stations[files.stations["camera"] == camera].sort_values("time_utc")
    lat = rows["lat_deg"].to_numpy()
    lon = rows["lon_deg"].to_numpy()
    east, north = pyproj.Proj(grid)(lon, lat)
    q = rows[["q_x", "q_y", "q_z", "q_w"]].to_numpy()
    enu = Rotation.from_quat(q).as_matrix().transpose(0, 2, 1) * [1.0, -1.0, -1.0]
    c = np.cos(convergence(lat, lon, grid))
    s = np.sin(convergence(lat, lon, grid))
    zero = np.zeros_like(c)
    one = np.ones_like(c)
    grid_from_enu = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    m = grid_from_enu @ enu
    omega = np.arctan2(-m[:, 1, 2], m[:, 2, 2])
    phi = np.arcsin(m[:, 0, 2])
    kappa = np.arctan2(-m[:, 0, 1], m[:, 0, 0])
    lines = []
    for k, (image, row) in enumerate(rows.iterrows()):
        since = (row["time_utc"].to_pydatetime(False) - GPS_EPOCH).total_seconds() + 18.0
        o, p, a = np.degrees([omega[k], phi[k], kappa[k]])
        lines.append(
            f"{image}\t{k + 1}\t{since % 604_800:.6f}\t{east[k]:.3f}\t{north[k]:.3f}\t"
            f"{row['h_ellipsoid_m']:.4f}\t{o:.7f}\t{p:.7f}\t{a:.7f}\t{lat[k]:.9f}\t{lon[k]:.9f}\n"
        )
    head = (
        f"  Grid: Universal Transverse Mercator; Zone:  {zone} ;\n"
        "  (position in Meters, orientation in Degrees, lat, long in Deg)\n"
        "ID\t# EVENT\tTIME (s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\tLONG\n"
    )
    (files.folder / f"{camera}.txt").write_text(head + "".join(lines))
    return {
        "path": f"{camera}.txt",
        "image": "{name}",
        "time": {"system": "gpst", "week": week_of(files)},
    }


def zone_of(files: Files) -> int:
    return int(files.stations["lon_deg"].iloc[0] // 6) + 31


def test_an_eo_text_needs_neither_log_nor_trajectory(mission, files, truth):
    without_log(mission, files, "eo")
    zone = zone_of(files)
    mission.config["events"] = {
        "positions": {
            camera: write_eo(files, camera, f"EPSG:{32600 + zone}", f"UTM North {zone}")
            for camera in ("nadir", "oblique")
        }
    }
    prepared = read_mission(mission.save())
    place, height, attitude = errors(prepared, truth)
    assert prepared.stations.ok.all()
    assert place < 0.01
    assert height < 0.01
    assert attitude < 1e-4


def test_the_attitude_of_an_eo_text_is_compared_with_the_log(mission, files, truth):
    """By the mounts both cameras' angles are the aircraft's; by another mount they are not."""
    zone = zone_of(files)
    mission.config["events"] = {
        "positions": {
            camera: write_eo(files, camera, f"EPSG:{32600 + zone}", f"UTM North {zone}")
            for camera in ("nadir", "oblique")
        }
    }
    prepared = read_mission(mission.save())
    assert errors(prepared, truth)[2] < 1e-4
    assert [e.kind for e in entries(prepared, "TRAJECTORY-ANGLES-AGREE")] == ["note", "note"]
    mission.config["mount"]["oblique"]["roll_deg"] = 45.0
    prepared = read_mission(mission.save())
    assert "loss" in [e.kind for e in entries(prepared, "TRAJECTORY-ANGLES-AGREE")]


def test_angles_of_another_grid_are_refused(mission, files):
    without_log(mission, files, "eo")
    zone = zone_of(files)
    section = write_eo(files, "nadir", f"EPSG:{32600 + zone}", f"UTM North {zone + 1}")
    other = write_eo(files, "oblique", f"EPSG:{32600 + zone}", f"UTM North {zone}")
    mission.config["events"] = {"positions": {"nadir": section, "oblique": other}}
    with pytest.raises(InputError) as caught:
        read_mission(mission.save())
    assert caught.value.code == "IMPORT-EO-GRID"
    section["grid"] = f"EPSG:{32600 + zone}"
    assert read_mission(mission.save()).stations.ok.all()


SWAY = {"nadir": (0.05, 3.0), "oblique": (0.03, 5.0)}
PAYLOAD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def looking(files: Files, camera: str, t: np.ndarray) -> Rotation:
    """v_ned = R v_camera of a camera that sways about its own x by some degrees."""
    state = files.flight.at(t)
    body = Rotation.from_euler("ZYX", np.stack([state.yaw_rad, state.pitch_rad, state.roll_rad], 1))
    amplitude, period = SWAY[camera]
    down = Rotation.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    sway = Rotation.from_euler("x", amplitude * np.sin(t[:, None] / period))
    lean = Rotation.from_euler("x", 0.0 if camera == "nadir" else -np.pi / 4.0)
    return body * lean * down * sway


def test_each_camera_follows_the_gimbal_of_its_own(mission, files, truth, monkeypatch):
    """Two gimbals with other motions; their cameras look along the forward axes."""
    t = files.t
    start_ns = round(files.start.timestamp() * 1e6) * 1000
    heads = []
    for k, camera in enumerate(SWAY):
        payload = looking(files, camera, t) * Rotation.from_matrix(PAYLOAD_FROM_CAMERA.T)
        q = payload.as_quat()
        columns = {f"q_{axis}": q[:, j] for j, axis in enumerate("xyzw")}
        time_ns = start_ns + np.rint(t * 1e9).astype(np.int64)
        heads.append(Channel(f"MNT[{k}]", time_ns, columns, Source("MNT", str(k))))
        mission.config["mount"][camera] |= {
            "attitude": f"MNT[{k}]",
            "pitch_deg": 90.0,
            "roll_deg": 0.0,
        }
    whole = opening.open_log

    def with_heads(*file, **named):
        log = whole(*file, **named)
        return replace(log, channels=(*log.channels, *heads))

    monkeypatch.setattr(opening, "open_log", with_heads)
    prepared = read_mission(mission.save())
    stations = prepared.stations
    assert stations.ok.all()
    for camera in SWAY:
        rows = stations.camera == camera
        at = (stations.time_ns[rows] - start_ns) * 1e-9
        ned = Rotation.from_quat(stations.quaternion[rows][:, [1, 2, 3, 0]]).inv().as_matrix()
        apart = Rotation.from_matrix(NED @ ned).inv() * looking(files, camera, at)
        assert np.degrees(apart.magnitude()).max() < 0.05
        assert np.isfinite(stations.aircraft_quaternion[rows]).all()
    assert {e.where for e in entries(prepared, "GIMBAL-FRAME")} == {"mount.nadir", "mount.oblique"}
    mission.config["mount"]["nadir"]["attitude"] = "MNT[7]"
    with pytest.raises(MissionError) as caught:
        read_mission(mission.save())
    assert caught.value.code == "CHANNEL-MISSING"
    assert "MNT[1]" in caught.value.what


def test_dji_images_orient_themselves(mission, files, truth):
    """Gimbal angles and positions of exiftool's table: axes forward, right, down of the payload."""
    without_log(mission, files, "dji")
    for section in ("events", "mount"):
        del mission.config[section]
    del mission.config["cameras"]["oblique"]
    table = mission.measurements().to_pandas()
    mission.observe(pa.Table.from_pandas(table[table["image"].str.startswith("nadir")]))
    rows = files.stations[files.stations["camera"] == "nadir"]
    camera = Rotation.from_quat(rows[["q_x", "q_y", "q_z", "q_w"]].to_numpy()).inv()
    payload = NED @ camera.as_matrix() @ PAYLOAD_FROM_CAMERA.T
    yaw, pitch, roll = Rotation.from_matrix(payload).as_euler("ZYX", degrees=True).T
    lines = [
        "FileName,DateTimeOriginal,GPSLatitude,GPSLongitude,AbsoluteAltitude,GimbalRollDegree,"
        "GimbalPitchDegree,GimbalYawDegree"
    ]
    for k, (image, row) in enumerate(rows.iterrows()):
        lines.append(
            f"{image}.JPG,{row['time_utc']:%Y:%m:%d %H:%M:%S.%f}Z,{row['lat_deg']:.10f},"
            f"{row['lon_deg']:.10f},{row['h_ellipsoid_m']:.4f},{roll[k]:.9f},"
            f"{pitch[k]:.9f},{yaw[k]:.9f}"
        )
    (mission.folder / "exif.csv").write_text("\n".join(lines) + "\n")
    orientation = {
        "path": "exif.csv",
        "format": "dji",
        "angles": "roll_pitch_yaw",
        "frame": "geographic",
        "heights": "ellipsoid",
    }
    mission.config["stations"] = {"orientation": orientation}
    mission.config["observations"]["match_names"] = ["extension"]
    prepared = read_mission(mission.save())
    place, height, attitude = errors(prepared, truth)
    assert prepared.stations.ok.all()
    assert (place, height) < (0.01, 0.01)
    assert attitude < 1e-4
    orientation["angles"] = "omega_phi_kappa"
    with pytest.raises(ConfigError, match="format: dji"):
        read_mission(mission.save())
