"""Whole simulated missions: what the writers wrote, read back by the real libraries."""

from collections import defaultdict

import numpy as np
import pandas as pd
import pyproj
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.testing import assert_allclose
from pymavlink import DFReader, mavutil
from scipy.spatial.transform import Rotation

from tests.helpers import refused
from tests.lens import brown
from unbend.simulate import SimulationOptions, simulate
from unbend.simulate.sensors import LOG_BEGINS_BOOT_US, LOG_BEGINS_UNIX_NS

SMALL = {
    "height_above_ground_m": 2500.0,
    "lines": 1,
    "exposures_per_line": 3,
    "points_per_image": 12,
}
OPTIONS = SimulationOptions(seed=3, **SMALL)
EARTH_M = 6.37e6
BEFORE_TAKE_OFF_US = LOG_BEGINS_BOOT_US + 58_000_000


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("small"), OPTIONS)


@pytest.fixture(scope="module")
def stations(small):
    return pd.read_parquet(small.truth / "stations.parquet")


@pytest.fixture(scope="module")
def observations(small):
    return pd.read_parquet(small.truth / "observations.parquet")


def frames_of(rows):
    return {name: pd.DataFrame(messages) for name, messages in rows.items()}


@pytest.fixture(scope="module")
def dataflash(small):
    reader = DFReader.DFReader_binary(str(small.logs["bin"]))
    rows = defaultdict(list)
    while (message := reader.recv_match()) is not None:
        rows[message.get_type()].append(message.to_dict())
    reader.close()
    return frames_of(rows)


@pytest.fixture(scope="module")
def telemetry(small):
    link = mavutil.mavlink_connection(
        str(small.logs["tlog"]),
        dialect="ardupilotmega",
    )
    rows = defaultdict(list)
    log = small.logs["tlog"].read_bytes()
    place = 0
    while (message := link.recv_match()) is not None:
        frame = bytes(message.get_msgbuf())
        assert log[place + 8 : place + 8 + len(frame)] == frame
        host_us = int.from_bytes(log[place : place + 8], "big")  # stands before each frame
        place += 8 + len(frame)
        rows[message.get_type()].append(message.to_dict() | {"host_s": host_us * 1e-6})
    link.close()
    return frames_of(rows)


@pytest.fixture(scope="module")
def recording(small):
    """By topic: messages, their stamps and the times when they were recorded [ns]."""
    rows = defaultdict(list)
    with small.logs["mcap"].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, ros in reader.iter_decoded_messages():
            stamp = ros.header.stamp.sec * 1_000_000_000 + ros.header.stamp.nanosec
            row = {
                "ros": ros,
                "stamp": stamp,
                "recorded": message.log_time,
            }
            rows[channel.topic].append(row)
    return frames_of(rows)


def fields(recording, topic, name):
    """A field of all messages of a topic."""
    return np.array([getattr(message, name) for message in recording[topic].ros])


def orientations(recording):
    """Attitudes of the messages of the IMU."""
    quaternions = fields(recording, "/imu/data", "orientation")
    return Rotation.from_quat([[q.x, q.y, q.z, q.w] for q in quaternions])


def angle_apart(first_deg, second_deg):
    return np.abs((first_deg - second_deg + 180.0) % 360.0 - 180.0)


def test_every_message_is_read_back(small, dataflash, telemetry, recording):
    assert sum(map(len, dataflash.values())) == small.messages["bin"]
    assert sum(map(len, telemetry.values())) == small.messages["tlog"]
    assert sum(map(len, recording.values())) == small.messages["mcap"]
    assert "BAD_DATA" not in telemetry


@pytest.mark.parametrize(
    ("instance", "camera"),
    [(0, "nadir"), (1, "oblique")],
)
def test_events_are_the_shutter(dataflash, recording, stations, instance, camera):
    shots = dataflash["CAM"].query(f"I == {instance}")
    truth = stations[stations.camera == camera]
    true_ns = truth.time_utc.astype("int64").tolist()
    utc_ns = LOG_BEGINS_UNIX_NS + (shots.TimeUS - LOG_BEGINS_BOOT_US) * 1000
    assert utc_ns.tolist() == true_ns
    assert recording[f"/camera/{camera}/image/compressed"].stamp.tolist() == true_ns
    assert shots.Img.tolist() == [1, 2, 3]
    assert_allclose(
        shots.Lat,
        truth.lat_deg,
        atol=2e-5,
    )
    assert_allclose(
        shots.Alt,
        truth.h_msl_m,
        atol=1.0,
    )


def test_triggers_are_before_the_shutter(dataflash):
    assert (dataflash["CAM"].TimeUS - dataflash["TRIG"].TimeUS).min() > 0


def test_heights_carry_the_undulation(dataflash, telemetry, recording):
    above_ellipsoid = dataflash["GPA"].AEl
    raw = telemetry["GPS_RAW_INT"]
    assert_allclose(
        above_ellipsoid - dataflash["GPS"].Alt,
        47.6,
        atol=0.011,
    )
    assert_allclose(
        (raw.alt_ellipsoid - raw.alt) / 1e3,
        47.6,
        atol=0.0011,
    )
    altitudes = fields(recording, "/fix", "altitude")
    assert_allclose(altitudes, above_ellipsoid, atol=0.0051)


def test_the_logs_state_the_accuracy_of_the_receiver(dataflash, telemetry, recording):
    assert dataflash["GPA"].HAcc[0] == pytest.approx(0.03)
    assert dataflash["GPA"].VAcc[0] == pytest.approx(0.05)
    assert telemetry["GPS_RAW_INT"].h_acc[0] == 30
    assert telemetry["GPS_RAW_INT"].v_acc[0] == 50
    covariance = fields(recording, "/fix", "position_covariance")[0].reshape(
        3,
        3,
    )
    assert_allclose(
        covariance,
        np.diag([9e-4, 9e-4, 25e-4]),
    )


def test_the_three_logs_carry_the_same_samples(dataflash, telemetry, recording):
    celsius = dataflash["HYGR"].query("Id == 0").Temp
    mavlink = telemetry["HYGROMETER_SENSOR"].query("id == 0")
    assert_allclose(
        celsius,
        mavlink.temperature / 100.0,
        atol=1e-5,
    )
    ros = fields(recording, "/outside/temperature", "temperature")
    assert_allclose(celsius, ros, atol=1e-5)
    assert_allclose(
        dataflash["ARSP"].Temp,
        celsius,
        atol=1e-5,
    )
    cabin_pa = dataflash["BARO"].query("I == 1").Press.to_numpy()[::2]
    mavlink_pa = telemetry["SCALED_PRESSURE2"].press_abs * 100.0
    assert_allclose(mavlink_pa, cabin_pa, rtol=1e-7)
    ros_pa = fields(recording, "/cabin/pressure", "fluid_pressure")
    assert_allclose(ros_pa, cabin_pa, rtol=1e-7)


def test_attitude_is_the_same_in_all_frames(dataflash, telemetry, recording):
    attitude = dataflash["ATT"]
    mavlink = telemetry["ATTITUDE"]
    assert_allclose(
        np.degrees(mavlink.roll),
        attitude.Roll,
        atol=0.0051,
    )
    assert_allclose(
        np.degrees(mavlink.pitch),
        attitude.Pitch,
        atol=0.0051,
    )
    assert angle_apart(np.degrees(mavlink.yaw), attitude.Yaw).max() < 0.0051
    east, north, up = orientations(recording)[::2].apply([1.0, 0.0, 0.0]).T
    assert angle_apart(np.degrees(np.arctan2(east, north)), attitude.Yaw).max() < 0.0051
    assert_allclose(
        np.degrees(np.arcsin(up)),
        attitude.Pitch,
        atol=0.0051,
    )


def test_clocks(dataflash, telemetry, recording):
    gps = dataflash["GPS"]
    unix_ms = 315_964_800_000 + gps.GWk * 604_800_000 + gps.GMS - 18_000
    stamp_ms = (gps.TimeUS - LOG_BEGINS_BOOT_US) / 1e3
    late_ms = stamp_ms - (unix_ms - LOG_BEGINS_UNIX_NS // 10**6)
    assert late_ms.min() > 0.0
    assert late_ms.median() < 5.0
    beat = telemetry["SYSTEM_TIME"]
    host_ahead_s = beat.host_s - beat.time_unix_usec * 1e-6
    assert 1.2 < host_ahead_s.median() < 1.4
    messages = pd.concat(recording.values())
    lag_ns = messages.recorded - messages.stamp
    assert lag_ns.min() >= 2_000_000
    assert lag_ns.max() < 20_000_000


def correlation(first, second):
    return np.corrcoef(first, second)[0, 1]


def test_velocities_point_where_the_aircraft_goes(dataflash, telemetry):
    """GPS.VZ and GLOBAL_POSITION_INT.vz are downwards; vx is north, vy east."""
    gps = dataflash["GPS"]
    climb = np.gradient(gps.Alt, gps.GMS / 1000.0)
    assert climb.max() > 5.0
    assert correlation(climb, gps.VZ) < -0.9
    place = telemetry["GLOBAL_POSITION_INT"]
    time_s = place.time_boot_ms / 1000.0
    assert correlation(np.gradient(place.lat, time_s), place.vx) > 0.99
    assert correlation(np.gradient(place.lon, time_s), place.vy) > 0.99
    assert correlation(np.gradient(place.alt, time_s), place.vz) < -0.9
    fastest = np.abs(np.gradient(np.radians(place.lat * 1e-7), time_s)).max() * EARTH_M
    assert np.abs(place.vx).max() / 100.0 == pytest.approx(fastest, rel=0.05)


def test_the_nose_is_along_the_flight_and_the_roof_is_up(telemetry, recording):
    """REP 103: in east-north-up, the body's z axis is upwards; its x axis is that of MAVLink."""
    attitude = telemetry["ATTITUDE"]
    place = telemetry["GLOBAL_POSITION_INT"]
    yaw = np.interp(
        place.time_boot_ms,
        attitude.time_boot_ms,
        np.unwrap(attitude.yaw),
    )
    course = np.arctan2(place.vy, place.vx)
    is_fast = np.hypot(place.vx, place.vy) > 5000.0
    assert np.cos(yaw - course)[is_fast].min() > 0.99
    assert orientations(recording).apply([0.0, 0.0, 1.0])[:, 2].min() > 0.8


def test_samples_are_those_of_the_true_air(small, dataflash):
    """On the ground, where the air does not change; their noise is tested with the sensors."""
    profile = pd.read_parquet(small.truth / "profile.parquet")
    field = profile[profile.h_m == 450.0].iloc[0]
    standing = f"TimeUS < {BEFORE_TAKE_OFF_US}"
    kelvin = dataflash["HYGR"].query(f"Id == 0 and {standing}").Temp.mean() + 273.15
    assert kelvin == pytest.approx(field.temperature_k + 0.5, abs=0.08)
    pascal = dataflash["BARO"].query(f"I == 0 and {standing}").Press.mean()
    assert pascal == pytest.approx(field.pressure_pa, abs=5.0)


@pytest.fixture(scope="module")
def chords(small, stations, observations):
    """Observations, and the straight lines from the cameras to the points, in east, north, up."""
    points = pd.read_parquet(small.truth / "points.parquet")
    rows = observations.merge(stations, on="image").merge(
        points,
        on="point",
        suffixes=("", "_g"),
    )
    to_ecef = pyproj.Transformer.from_crs(
        4979,
        4978,
        always_xy=True,
    )
    camera = np.array(to_ecef.transform(rows.lon_deg, rows.lat_deg, rows.h_ellipsoid_m))
    ground = np.array(to_ecef.transform(rows.lon_deg_g, rows.lat_deg_g, rows.h_ellipsoid_m_g))
    angles = np.stack(
        [90.0 + rows.lon_deg, 90.0 - rows.lat_deg],
        -1,
    )
    enu = Rotation.from_euler(
        "ZX",
        angles,
        degrees=True,
    )
    return rows, enu.inv().apply((ground - camera).T)


def test_the_angle_of_the_chord_is_that_of_the_ray_less_the_refraction(chords):
    rows, chord = chords
    nadir_angle = np.arctan2(
        np.hypot(
            chord[:, 0],
            chord[:, 1],
        ),
        -chord[:, 2],
    )
    assert_allclose(
        nadir_angle,
        rows.zeta_c_rad - rows.r_c_rad,
        atol=2e-12,
    )


@pytest.mark.parametrize("camera", ["nadir", "oblique"])
def test_true_pixels_are_the_projected_chord(small, chords, camera):
    """An independent collinearity: PROJ and scipy rotations instead of the simulator's own."""
    every_row, every_chord = chords
    is_of_camera = (every_row.camera == camera).to_numpy()
    rows = every_row[is_of_camera]
    attitude = Rotation.from_quat(rows[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
    ray = attitude.apply(every_chord[is_of_camera])
    x = ray[:, 0] / ray[:, 2]
    y = ray[:, 1] / ray[:, 2]
    settings = yaml.safe_load(small.missions["bin"].read_text())["cameras"][camera]
    lens = settings["distortion"]
    x_distorted, y_distorted = brown(x, y, **lens)
    x_px = settings["fx_px"] * x_distorted + settings["cx_px"]
    y_px = settings["fy_px"] * y_distorted + settings["cy_px"]
    assert_allclose(
        x_px,
        rows.x_true_px,
        atol=1e-7,
    )
    assert_allclose(
        y_px,
        rows.y_true_px,
        atol=1e-7,
    )


def test_signs_and_sizes(stations, observations):
    rows = observations.merge(stations, on="image")
    assert (rows.n_cabin > rows.n_outside).all()
    assert (rows.r_cc_rad > 0.0).all()
    oblique = rows[rows.camera == "oblique"]
    assert oblique.zeta_c_rad.between(np.radians(20.0), np.radians(70.0)).all()
    shift = np.hypot(
        oblique.x_px - oblique.x_true_px,
        oblique.y_px - oblique.y_true_px,
    )
    assert 0.3 < shift.median() < 2.0


def test_every_point_is_seen_at_least_twice(observations):
    assert observations.groupby("point").size().min() >= 2
    assert observations.groupby("image").size().max() <= OPTIONS.points_per_image


def test_observations_are_the_true_ones_without_noise(small, observations):
    measured = pd.read_parquet(small.observations)
    names = ["image", "point", "x_px", "y_px", "h_g_m"]
    assert list(measured.columns) == [*names, "quality"]
    pd.testing.assert_frame_equal(
        measured[names],
        observations[names],
    )


def test_same_seed_same_bytes_other_seed_other_bytes(small, tmp_path):
    again = simulate(tmp_path / "again", OPTIONS)
    files = [path for path in small.folder.rglob("*") if path.is_file()]
    assert len(files) == 12
    for path in files:
        name = path.relative_to(small.folder)
        assert path.read_bytes() == (again.folder / name).read_bytes(), name
    changed = simulate(
        tmp_path / "other",
        SimulationOptions(seed=4, **SMALL),
    )
    assert small.logs["bin"].read_bytes() != changed.logs["bin"].read_bytes()


def test_default_mission(tmp_path):
    steps = []
    made = simulate(
        tmp_path,
        progress=lambda stage, done, total: steps.append((done, total)),
    )
    done, total = steps[-1]
    assert done == total
    assert made.images == 56
    assert sum(path.stat().st_size for path in made.logs.values()) < 10e6
    observations = pd.read_parquet(made.truth / "observations.parquet")
    assert observations.groupby("image").size().mean() == pytest.approx(40.0, abs=3.0)
    assert observations.h_g_m.between(350.0, 700.0).all()
    stations = pd.read_parquet(made.truth / "stations.parquet")
    assert (stations.h_msl_m - 3450.0).abs().max() < 10.0
    cabin = stations[stations.camera == "nadir"].n_cabin
    assert cabin.diff().abs().dropna().min() > 1e-9
    assert cabin.max() - cabin.min() > 5e-7


@pytest.mark.parametrize(
    "change", [{"lines": 0}, {"height_above_ground_m": 50.0}, {"image_noise_px": -1.0}]
)
def test_options_out_of_range_are_refused(change):
    with refused("SIM-OPTION"):
        SimulationOptions(**change)


@pytest.mark.parametrize(
    "kind",
    ["bin", "tlog", "mcap"],
)
def test_mission_files_are_yaml_that_names_the_log(small, kind):
    content = yaml.safe_load(small.missions[kind].read_text())
    assert content["log"]["path"] == f"flight.{kind}"
    assert (small.folder / content["observations"]["path"]).exists()


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with refused("STORAGE-WRITE"):
        simulate(tmp_path / "taken", OPTIONS)
