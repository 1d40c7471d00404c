"""Whole simulated missions: what the writers wrote, read back by the real libraries."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyproj
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pymavlink import DFReader, mavutil
from scipy.spatial.transform import Rotation

from unbend.errors import ConfigError, StorageError
from unbend.simulate import SimulationOptions, simulate
from unbend.simulate.sensors import LOG_BEGINS_BOOT_US, LOG_BEGINS_UNIX_NS

SMALL = SimulationOptions(
    seed=3, height_above_ground_m=2500.0, lines=1, exposures_per_line=3, points_per_image=12
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("small"), SMALL)


@pytest.fixture(scope="module")
def stations(small):
    return pd.read_parquet(small.truth / "stations.parquet")


@pytest.fixture(scope="module")
def observations(small):
    return pd.read_parquet(small.truth / "observations.parquet")


@pytest.fixture(scope="module")
def dataflash(small):
    reader = DFReader.DFReader_binary(str(small.logs["bin"]))
    rows: dict[str, list[dict]] = {}
    while (message := reader.recv_match()) is not None:
        rows.setdefault(message.get_type(), []).append(message.to_dict())
    reader.close()
    return {name: pd.DataFrame(found) for name, found in rows.items()}


@pytest.fixture(scope="module")
def telemetry(small):
    link = mavutil.mavlink_connection(str(small.logs["tlog"]), dialect="ardupilotmega")
    rows: dict[str, list[dict]] = {}
    log = small.logs["tlog"].read_bytes()
    place = 0
    while (message := link.recv_match()) is not None:
        frame = bytes(message.get_msgbuf())
        assert log[place + 8 : place + 8 + len(frame)] == frame
        host_us = int.from_bytes(log[place : place + 8], "big")  # stands before each frame
        place += 8 + len(frame)
        rows.setdefault(message.get_type(), []).append(
            message.to_dict() | {"host_s": host_us * 1e-6}
        )
    link.close()
    return {name: pd.DataFrame(found) for name, found in rows.items()}


@pytest.fixture(scope="module")
def recording(small):
    rows: dict[str, list] = {}
    with small.logs["mcap"].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, ros in reader.iter_decoded_messages():
            stamp = ros.header.stamp.sec * 1_000_000_000 + ros.header.stamp.nanosec
            rows.setdefault(channel.topic, []).append((stamp, message.log_time, ros))
    return rows


def test_every_message_is_read_back(small, dataflash, telemetry, recording):
    assert sum(len(rows) for rows in dataflash.values()) == small.messages["bin"]
    assert sum(len(rows) for rows in telemetry.values()) == small.messages["tlog"]
    assert sum(len(rows) for rows in recording.values()) == small.messages["mcap"]
    assert "BAD_DATA" not in telemetry


def test_dataflash_events_are_the_shutter(small, dataflash, stations):
    cam = dataflash["CAM"]
    for instance, camera in enumerate(("nadir", "oblique")):
        rows = cam.query(f"I == {instance}")
        truth = stations[stations.camera == camera]
        boot_ns = (rows.TimeUS.to_numpy() - LOG_BEGINS_BOOT_US) * 1000 + LOG_BEGINS_UNIX_NS
        np.testing.assert_array_equal(boot_ns, truth.time_utc.astype("int64"))
        assert rows.Img.tolist() == [1, 2, 3]
        np.testing.assert_allclose(rows.Lat, truth.lat_deg, atol=2e-5)
        np.testing.assert_allclose(rows.Alt, truth.h_msl_m, atol=1.0)
    assert (dataflash["CAM"].TimeUS - dataflash["TRIG"].TimeUS).min() > 0


def test_heights_carry_the_undulation(dataflash, telemetry, recording):
    gps = dataflash["GPS"]
    gpa = dataflash["GPA"]
    raw = telemetry["GPS_RAW_INT"]
    np.testing.assert_allclose(gpa.AEl - gps.Alt, 47.6, atol=0.011)
    np.testing.assert_allclose((raw.alt_ellipsoid - raw.alt) / 1e3, 47.6, atol=0.0011)
    fixes = np.array([ros.altitude for _, _, ros in recording["/fix"]])
    np.testing.assert_allclose(fixes, gpa.AEl, atol=0.0051)


def test_the_three_logs_carry_the_same_samples(dataflash, telemetry, recording):
    hygr = dataflash["HYGR"].query("Id == 0")
    mavlink = telemetry["HYGROMETER_SENSOR"].query("id == 0")
    ros = recording["/outside/temperature"]
    np.testing.assert_allclose(hygr.Temp, mavlink.temperature / 100.0, atol=1e-5)
    np.testing.assert_allclose(hygr.Temp, [m.temperature for _, _, m in ros], atol=1e-5)
    np.testing.assert_allclose(dataflash["ARSP"].Temp, hygr.Temp, atol=1e-5)
    baro = dataflash["BARO"].query("I == 1").Press.to_numpy()[::2]
    np.testing.assert_allclose(telemetry["SCALED_PRESSURE2"].press_abs * 100.0, baro, rtol=1e-7)
    cabin = [m.fluid_pressure for _, _, m in recording["/cabin/pressure"]]
    np.testing.assert_allclose(cabin, baro, rtol=1e-7)


def test_attitude_is_the_same_in_all_frames(dataflash, telemetry, recording):
    att = dataflash["ATT"]
    mavlink = telemetry["ATTITUDE"]
    np.testing.assert_allclose(np.degrees(mavlink.roll), att.Roll, atol=0.0051)
    np.testing.assert_allclose(np.degrees(mavlink.pitch), att.Pitch, atol=0.0051)
    turn = (np.degrees(mavlink.yaw) - att.Yaw + 180.0) % 360.0 - 180.0
    assert np.abs(turn).max() < 0.0051
    q = [m.orientation for _, _, m in recording["/imu/data"]][::2]
    forward = Rotation.from_quat([[o.x, o.y, o.z, o.w] for o in q]).apply([1.0, 0.0, 0.0])
    course = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    assert np.abs((course - att.Yaw + 180.0) % 360.0 - 180.0).max() < 0.0051
    np.testing.assert_allclose(np.degrees(np.arcsin(forward[:, 2])), att.Pitch, atol=0.0051)


def test_clocks(dataflash, telemetry, recording):
    gps = dataflash["GPS"]
    unix_ms = 315_964_800_000 + gps.GWk * 604_800_000 + gps.GMS - 18_000
    late_ms = (gps.TimeUS - LOG_BEGINS_BOOT_US) / 1e3 - (unix_ms - LOG_BEGINS_UNIX_NS // 10**6)
    assert late_ms.min() > 0.0
    assert late_ms.median() < 5.0
    beat = telemetry["SYSTEM_TIME"]
    ahead = beat.host_s - beat.time_unix_usec * 1e-6
    assert 1.2 < ahead.median() < 1.4
    lag = [log - stamp for rows in recording.values() for stamp, log, _ in rows]
    assert min(lag) >= 2_000_000
    assert max(lag) < 20_000_000


def test_velocities_point_where_the_aircraft_goes(dataflash, telemetry):
    """GPS.VZ and GLOBAL_POSITION_INT.vz are downwards; vx is north, vy east."""
    gps = dataflash["GPS"]
    climb = np.gradient(gps.Alt, gps.GMS / 1000.0)
    assert climb.max() > 5.0
    assert np.corrcoef(climb, gps.VZ)[0, 1] < -0.9
    place = telemetry["GLOBAL_POSITION_INT"]
    time_s = place.time_boot_ms / 1000.0
    moved = 6.37e6 * np.radians(np.gradient(place.lat * 1e-7, time_s))
    assert np.corrcoef(moved, place.vx)[0, 1] > 0.99
    moved = 4.3e6 * np.radians(np.gradient(place.lon * 1e-7, time_s))
    assert np.corrcoef(moved, place.vy)[0, 1] > 0.99
    assert np.corrcoef(np.gradient(place.alt, time_s), place.vz)[0, 1] < -0.9


def test_the_orientation_of_imu_is_that_of_forward_left_up_axes(recording):
    """REP 103: in east-north-up, the body's z axis is upwards and its x axis along the flight."""
    stamps, _, messages = zip(*recording["/imu/data"], strict=True)
    q = [m.orientation for m in messages]
    rotation = Rotation.from_quat([[each.x, each.y, each.z, each.w] for each in q])
    assert rotation.apply([0.0, 0.0, 1.0])[:, 2].min() > 0.8
    fixes = recording["/fix"]
    time_s = (np.array([stamp for stamp, _, _ in fixes]) - stamps[0]) / 1e9
    north = np.gradient([m.latitude for _, _, m in fixes], time_s)
    east = np.gradient([m.longitude for _, _, m in fixes], time_s) * np.cos(np.radians(47.4))
    at = (np.array(stamps) - stamps[0]) / 1e9
    track = np.stack([np.interp(at, time_s, east), np.interp(at, time_s, north)], axis=-1)
    moving = np.linalg.norm(track, axis=-1) > np.degrees(50.0 / 6.37e6)
    forward = rotation.apply([1.0, 0.0, 0.0])[moving, :2]
    cosine = np.sum(forward * track[moving], axis=-1)
    cosine /= np.linalg.norm(forward, axis=-1) * np.linalg.norm(track[moving], axis=-1)
    assert cosine.min() > 0.99


def test_image_topics_are_stamped_at_the_shutter(recording, stations):
    for camera in ("nadir", "oblique"):
        stamps = [stamp for stamp, _, _ in recording[f"/camera/{camera}/image/compressed"]]
        truth = stations[stations.camera == camera].time_utc.astype("int64")
        assert stamps == truth.tolist()


def test_sensor_noise_is_what_was_announced(small, dataflash):
    """Against the written truth: stand on the ground, where the air does not change."""
    profile = pd.read_parquet(small.truth / "profile.parquet")
    field = profile[profile.h_m == 450.0].iloc[0]
    standing = LOG_BEGINS_BOOT_US + 58_000_000
    hygr = dataflash["HYGR"].query(f"Id == 0 and TimeUS < {standing}")
    error = hygr.Temp + 273.15 - field.temperature_k
    assert error.mean() == pytest.approx(0.5, abs=0.08)
    assert error.std() == pytest.approx(0.2, abs=0.05)
    baro = dataflash["BARO"].query(f"I == 0 and TimeUS < {standing}")
    assert baro.Press.std() == pytest.approx(20.0, abs=3.0)
    assert baro.Press.mean() == pytest.approx(field.pressure_pa, abs=5.0)
    assert baro.Temp.mean() + 273.15 - field.temperature_k > 10.0


def test_true_pixels_are_the_projected_chord(small, stations, observations):
    """An independent collinearity: PROJ and scipy rotations instead of the simulator's own."""
    points = pd.read_parquet(small.truth / "points.parquet")
    rows = observations.merge(stations, on="image").merge(points, on="point", suffixes=("", "_g"))
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    camera = np.array(to_ecef.transform(rows.lon_deg, rows.lat_deg, rows.h_ellipsoid_m))
    ground = np.array(to_ecef.transform(rows.lon_deg_g, rows.lat_deg_g, rows.h_ellipsoid_m_g))
    enu = Rotation.from_euler(
        "ZX", np.radians(np.stack([90.0 + rows.lon_deg, 90.0 - rows.lat_deg], -1))
    )
    chord = enu.inv().apply((ground - camera).T)
    nadir_angle = np.arctan2(np.hypot(chord[:, 0], chord[:, 1]), -chord[:, 2])
    np.testing.assert_allclose(nadir_angle, rows.zeta_c_rad - rows.r_c_rad, atol=2e-12)
    ray = Rotation.from_quat(rows[["q_x", "q_y", "q_z", "q_w"]].to_numpy()).apply(chord)
    settings = yaml.safe_load(small.missions["bin"].read_text())["cameras"]
    for name, cam in settings.items():
        mine = (rows.camera == name).to_numpy()
        x, y = (ray[mine, :2] / ray[mine, 2:]).T
        r2 = x**2 + y**2
        d = cam["distortion"]
        radial = 1 + d["k1"] * r2 + d["k2"] * r2**2 + d["k3"] * r2**3
        xd = x * radial + 2 * d["p1"] * x * y + d["p2"] * (r2 + 2 * x**2)
        yd = y * radial + d["p1"] * (r2 + 2 * y**2) + 2 * d["p2"] * x * y
        found = rows[mine]
        np.testing.assert_allclose(cam["fx_px"] * xd + cam["cx_px"], found.x_true_px, atol=1e-7)
        np.testing.assert_allclose(cam["fy_px"] * yd + cam["cy_px"], found.y_true_px, atol=1e-7)


def test_signs_and_sizes(stations, observations):
    rows = observations.merge(stations, on="image")
    assert (rows.r_c_rad > 0.0).all()
    assert (rows.n_cabin > rows.n_outside).all()
    assert (rows.r_cc_rad > 0.0).all()
    oblique = rows[rows.camera == "oblique"]
    assert oblique.zeta_c_rad.between(np.radians(20.0), np.radians(70.0)).all()
    shift = np.hypot(oblique.x_px - oblique.x_true_px, oblique.y_px - oblique.y_true_px)
    assert 0.3 < shift.median() < 2.0


def test_every_point_is_seen_at_least_twice(observations):
    assert observations.groupby("point").size().min() >= 2
    assert observations.groupby("image").size().max() <= SMALL.points_per_image


def test_observations_are_the_true_ones_without_noise(small, observations):
    measured = pd.read_parquet(small.observations)
    assert list(measured.columns) == ["image", "point", "x_px", "y_px", "h_g_m", "quality"]
    pd.testing.assert_frame_equal(
        measured[["image", "point", "x_px", "y_px", "h_g_m"]],
        observations[["image", "point", "x_px", "y_px", "h_g_m"]],
    )


def test_same_seed_same_bytes_other_seed_other_bytes(small, tmp_path):
    again = simulate(tmp_path / "again", SMALL)
    files = sorted(p.relative_to(small.folder) for p in small.folder.rglob("*") if p.is_file())
    assert len(files) == 12
    for name in files:
        assert (small.folder / name).read_bytes() == (again.folder / name).read_bytes(), name
    other = SimulationOptions(
        seed=4, height_above_ground_m=2500.0, lines=1, exposures_per_line=3, points_per_image=12
    )
    changed = simulate(tmp_path / "other", other)
    assert small.logs["bin"].read_bytes() != changed.logs["bin"].read_bytes()


def test_default_mission(tmp_path):
    told = []
    made = simulate(tmp_path, progress=lambda stage, done, total: told.append((done, total)))
    assert made.images == 56
    assert told[-1][0] == told[-1][1]
    assert sum(path.stat().st_size for path in made.logs.values()) < 10e6
    observations = pd.read_parquet(made.truth / "observations.parquet")
    assert observations.groupby("image").size().mean() == pytest.approx(40.0, abs=3.0)
    assert observations.h_g_m.between(350.0, 700.0).all()
    stations = pd.read_parquet(made.truth / "stations.parquet")
    heights = stations.h_msl_m - 3450.0
    assert heights.abs().max() < 10.0
    cabin = stations[stations.camera == "nadir"].n_cabin
    assert cabin.diff().abs().dropna().min() > 1e-9
    assert cabin.max() - cabin.min() > 5e-7


@pytest.mark.parametrize(
    "change", [{"lines": 0}, {"height_above_ground_m": 50.0}, {"image_noise_px": -1.0}]
)
def test_options_out_of_range_are_refused(change):
    with pytest.raises(ConfigError, match="SIM-OPTION"):
        SimulationOptions(**change)


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_mission_files_are_yaml_that_names_the_log(small, kind):
    content = yaml.safe_load(small.missions[kind].read_text())
    assert content["log"]["path"] == f"flight.{kind}"
    assert (small.folder / content["observations"]["path"]).exists()


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(StorageError, match="STORAGE-WRITE"):
        simulate(tmp_path / "taken", SMALL)
