"""From events to stations: attitude, mount, lever arm, air, sigmas. Expected values by hand."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import instants, quaternion_columns, rotation_of
from tests.helpers import channel
from unbend.flight.channels import Channel
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.station_builder import ClockSigmas, build_stations
from unbend.flight.stations import Stations

SECONDS = np.arange(0.0, 10.0, 0.1)
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(8.0)
PLACE = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE}
METRES_OF_LATITUDE = 6_367_000.0  # in a radian at 47 degrees, to 0.1 %
NO_UNDULATION = HeightSystem()
LOOKS_DOWN = Mount()


def flown(*yaw_pitch_roll_deg: float, **changed: Channel) -> dict[str, Channel]:
    """The roles of ten seconds at one place, 1000 m above the sea, in one attitude."""
    attitude = Rotation.from_euler("ZYX", yaw_pitch_roll_deg or [0.0, 0.0, 0.0], degrees=True)
    roles = {
        "position": channel("POS", SECONDS, **PLACE),
        "height": channel("GPS", SECONDS, **PLACE, h_msl_m=1000.0),
        "attitude": channel("ATT", SECONDS, **quaternion_columns(attitude)),
    }
    return roles | changed


def events(*seconds: float) -> Events:
    names = np.array([f"image_{second}" for second in seconds], object)
    return Events("cam", names, instants(*seconds))


def station_at_5_s(
    roles: dict[str, Channel],
    mount: Mount = LOOKS_DOWN,
    heights: HeightSystem = NO_UNDULATION,
    clocks: ClockSigmas = ClockSigmas(),  # noqa: B008
) -> Stations:
    return build_stations(events(5.0), roles, mount, heights, 1.0, clocks=clocks)


AXIS = [0, 0, 1]
TOP = [0, -1, 0]
SIN_10 = np.sin(np.radians(10.0))
COS_10 = np.cos(np.radians(10.0))
HALF = np.sqrt(0.5)
LOOKS_RIGHT = Mount(roll_rad=-np.pi / 4)
LOOKS_AHEAD = Mount(pitch_rad=np.pi / 4)
LOOKS_AHEAD_TURNED = Mount(pitch_rad=np.pi / 4, yaw_rad=np.pi / 2)


@pytest.mark.parametrize(
    ("yaw_pitch_roll_deg", "mount", "direction", "east_north_up"),
    [
        ([0, 0, 0], LOOKS_DOWN, AXIS, [0, 0, -1]),
        ([0, 0, 0], LOOKS_DOWN, TOP, [0, 1, 0]),
        ([90, 0, 0], LOOKS_DOWN, TOP, [1, 0, 0]),
        ([0, 10, 0], LOOKS_DOWN, AXIS, [0, SIN_10, -COS_10]),
        ([0, 0, 10], LOOKS_DOWN, AXIS, [-SIN_10, 0, -COS_10]),
        ([0, 0, 0], LOOKS_RIGHT, AXIS, [HALF, 0, -HALF]),
        ([0, 0, 0], LOOKS_AHEAD, AXIS, [0, HALF, -HALF]),
        ([0, 0, 0], LOOKS_AHEAD_TURNED, AXIS, [HALF, 0, -HALF]),
    ],
    ids=[
        "down",
        "top is north",
        "flight east",
        "nose up, ahead",
        "right bank, left",
        "mount to the right",
        "mount ahead",
        "yaw before pitch",
    ],
)
def test_where_a_direction_of_the_camera_points(
    yaw_pitch_roll_deg, mount, direction, east_north_up
):
    station = station_at_5_s(flown(*yaw_pitch_roll_deg), mount)
    enu_from_camera = rotation_of(station.quaternion[0]).inv()
    assert enu_from_camera.apply(direction) == pytest.approx(east_north_up, abs=1e-12)


def test_lever_arm_moves_the_projection_centre():
    """3 m forward, 2 m to the right and 1 m down of a flight to the east."""
    mount = Mount(lever_arm_m=(3.0, 2.0, 1.0))
    station = station_at_5_s(flown(90, 0, 0), mount, HeightSystem(undulation_m=40.0))
    degrees = np.degrees([LONGITUDE, LATITUDE, station.lon_rad[0], station.lat_rad[0]])
    azimuth_deg, _, distance_m = pyproj.Geod(ellps="WGS84").inv(*degrees)
    azimuth_rad = np.radians(azimuth_deg)
    # On the ellipsoid, 1040 m below: shorter by 1.6e-4.
    assert distance_m * np.sin(azimuth_rad) == pytest.approx(3.0, abs=1e-3)
    assert distance_m * np.cos(azimuth_rad) == pytest.approx(-2.0, abs=1e-3)
    assert station.h_msl_m[0] == pytest.approx(999.0, abs=1e-5)
    assert station.h_ellipsoid_m[0] == pytest.approx(1039.0, abs=1e-5)


NAN = float("nan")


@pytest.mark.parametrize(
    ("logged", "undulation_m", "status", "h_msl_m", "h_ellipsoid_m"),
    [
        ({"h_msl_m": 1000.0}, None, "ok", 999.0, NAN),
        ({"h_ellipsoid_m": 1048.0}, 48.0, "ok", 999.0, 1047.0),
        ({"h_ellipsoid_m": 1048.0}, None, "height_reference_unknown", NAN, 1047.0),
        ({}, None, "in_gap", NAN, NAN),
    ],
    ids=["above the sea", "with an undulation", "above the ellipsoid alone", "no height"],
)
def test_a_height_that_is_not_logged_follows_from_the_undulation_or_stays_unknown(
    logged,
    undulation_m,
    status,
    h_msl_m,
    h_ellipsoid_m,
):
    """The camera is 1 m below the position."""
    roles = flown(height=channel("GPS", SECONDS, **PLACE, **logged))
    mount = Mount(lever_arm_m=(0.0, 0.0, 1.0))
    station = station_at_5_s(roles, mount, HeightSystem(undulation_m))
    assert station.status[0] == status
    assert station.h_msl_m[0] == pytest.approx(h_msl_m, abs=1e-5, nan_ok=True)
    assert station.h_ellipsoid_m[0] == pytest.approx(h_ellipsoid_m, abs=1e-5, nan_ok=True)


LEVEL = quaternion_columns(Rotation.identity())
WITH_GAP = channel("POS", SECONDS[(SECONDS < 3.0) | (SECONDS >= 7.0)], **PLACE)
ENDS_AT_4_S = channel("ATT", SECONDS[SECONDS < 4.0], **LEVEL)


@pytest.mark.parametrize(
    ("changed", "status"),
    [
        ({"position": WITH_GAP}, ["outside_log", "ok", "in_gap", "outside_log"]),
        ({"attitude": ENDS_AT_4_S}, ["outside_log", "ok", "outside_log", "outside_log"]),
        ({"position": None}, ["no_position"] * 4),
        ({"attitude": None}, ["outside_log", "no_attitude", "no_attitude", "outside_log"]),
        (
            {"height": None},
            ["outside_log", *["height_reference_unknown"] * 2, "outside_log"],
        ),
    ],
    ids=["a gap", "the attitude ends", "no position", "no attitude", "no heights"],
)
def test_each_reason_has_its_name(changed, status):
    roles = {role: logged for role, logged in (flown() | changed).items() if logged is not None}
    exposures = events(-1.0, 2.0, 5.0, 9.95)
    stations = build_stations(exposures, roles, LOOKS_DOWN, NO_UNDULATION, 1.0)
    assert stations.status.tolist() == status


def test_air_outside_and_in_the_cabin_is_that_of_its_own_sensors():
    roles = flown(
        pressure=channel("BARO[0]", SECONDS, pressure_pa=90_000.0),
        temperature=channel("HYGR[0]", SECONDS, temperature_k=283.15),
        humidity=channel("HYGR[0]", SECONDS, relative_humidity=0.5),
        cabin_pressure=channel("BARO[1]", SECONDS, pressure_pa=80_000.0 + 100.0 * SECONDS),
        cabin_temperature=channel("HYGR[1]", SECONDS, temperature_k=293.15),
        cabin_humidity=channel("HYGR[1]", SECONDS, relative_humidity=1.1),  # clipped to 1
    )
    station = station_at_5_s(roles)
    assert station.pressure_pa[0] == pytest.approx(90_000.0)
    assert station.cabin_pressure_pa[0] == pytest.approx(80_500.0)
    assert station.temperature_k[0] == pytest.approx(283.15)
    assert station.cabin_temperature_k[0] == pytest.approx(293.15)
    # Saturation 12.28 hPa at 10 and 23.392 hPa at 20 degC; moist air holds 0.4 and 0.34 % more.
    assert station.vapour_pressure_pa[0] == pytest.approx(0.5 * 1228.0 * 1.004, rel=1e-3)
    assert station.cabin_vapour_pressure_pa[0] == pytest.approx(2339.2 * 1.0034, rel=1e-3)


def test_air_that_nothing_measures_is_unknown():
    station = station_at_5_s(flown())
    assert np.isnan(station.pressure_pa[0])
    assert np.isnan(station.cabin_pressure_pa[0])


@pytest.mark.parametrize(
    ("clocks", "horizontal_m", "height_m"),
    [
        (ClockSigmas(), 0.3, 0.6),
        # At 40 m/s 0.1 s are 4 m along the track: half of the variance counts on either level axis.
        (ClockSigmas(position_s=0.1), np.hypot(0.3, 4.0 / np.sqrt(2.0)), 0.6),
        # At a climb of 3 m/s 0.2 s are 0.6 m.
        (ClockSigmas(height_s=0.2), 0.3, np.hypot(0.6, 0.6)),
    ],
    ids=["one clock", "another clock of the positions", "another clock of the heights"],
)
def test_an_uncertain_clock_moves_the_stations_along_the_flight(clocks, horizontal_m, height_m):
    """Horizontal sigmas are those of the position, vertical ones those of the height."""
    latitude = LATITUDE + 40.0 * SECONDS / METRES_OF_LATITUDE
    place = {"lat_rad": latitude, "lon_rad": LONGITUDE}
    climb_m = 1000.0 + 3.0 * SECONDS
    height = channel("GPS", SECONDS, **place, h_msl_m=climb_m, sigma_h_m=0.5, sigma_v_m=0.6)
    position = channel("POS", SECONDS, **place, sigma_h_m=0.3, sigma_v_m=0.4)
    station = station_at_5_s(flown(position=position, height=height), clocks=clocks)
    assert station.sigma_horizontal_m[0] == pytest.approx(horizontal_m, rel=0.01)
    assert station.sigma_height_m[0] == pytest.approx(height_m, rel=0.01)


@pytest.mark.parametrize(
    ("axes", "tilt_rad", "yaw_rad"),
    [
        ("Z", 0.003, np.hypot(0.004, 0.02)),
        ("X", np.hypot(0.003, 0.02 / np.sqrt(2.0)), 0.004),
    ],
    ids=["yawing", "rolling"],
)
def test_an_uncertain_clock_turns_the_stations_with_the_flight(axes, tilt_rad, yaw_rad):
    """0.2 rad/s for 0.1 s; sigmas that the mount states take the place of the log's."""
    turning = Rotation.from_euler(axes, 0.2 * SECONDS[:, None])
    roles = flown(attitude=channel("ATT", SECONDS, **quaternion_columns(turning)))
    mount = Mount(sigma_tilt_rad=0.003, sigma_yaw_rad=0.004)
    station = station_at_5_s(roles, mount, clocks=ClockSigmas(attitude_s=0.1))
    assert station.sigma_tilt_rad[0] == pytest.approx(tilt_rad, rel=1e-3)
    assert station.sigma_yaw_rad[0] == pytest.approx(yaw_rad, rel=1e-3)
