"""From events to stations: attitude, mount, lever arm, air, sigmas. Expected values by hand."""

import numpy as np
import pyproj
import pytest

from tests.flight.made_channels import (
    image_names,
    instants,
    rotation_of,
    turned_channel,
)
from tests.helpers import channel
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.station_builder import ClockSigmas, build_stations

NAN = float("nan")
SECONDS = np.arange(0.0, 10.0, 0.1)
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(8.0)
PLACE = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE}
METRES_OF_LATITUDE = 6_367_000.0  # in a radian at 47 degrees, to 0.1 %
NO_UNDULATION = HeightSystem()
LOOKS_DOWN = Mount()


def sensor(name, **columns):
    return channel(name, SECONDS, **columns)


def flown(*yaw_pitch_roll_deg, **changed):
    """The roles of ten seconds at one place, 1000 m above the sea, in one attitude."""
    angles_deg = yaw_pitch_roll_deg or [0.0, 0.0, 0.0]
    return {
        "position": sensor("POS", **PLACE),
        "height": sensor("GPS", **PLACE, h_msl_m=1000.0),
        "attitude": turned_channel("ATT", SECONDS, "ZYX", angles_deg),
        **changed,
    }


def stations_at(
    seconds,
    roles,
    mount=LOOKS_DOWN,
    heights=NO_UNDULATION,
    **clocks_s,
):
    names = image_names(*(f"image_{second}" for second in seconds))
    events = Events("cam", names, instants(*seconds))
    return build_stations(events, roles, mount, heights, 1.0, clocks=ClockSigmas(**clocks_s))


def station_at_5_s(roles, *more, **clocks_s):
    return stations_at([5.0], roles, *more, **clocks_s)


AXIS = [0, 0, 1]
TOP = [0, -1, 0]
SIN_10 = np.sin(np.radians(10.0))
COS_10 = np.cos(np.radians(10.0))
HALF = np.sqrt(0.5)
LOOKS_RIGHT = Mount(roll_rad=-np.pi / 4)
LOOKS_AHEAD = Mount(pitch_rad=np.pi / 4)
LOOKS_AHEAD_TURNED = Mount(
    pitch_rad=np.pi / 4,
    yaw_rad=np.pi / 2,
)


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

    azimuth_rad, _, distance_m = pyproj.Geod(ellps="WGS84").inv(
        LONGITUDE,
        LATITUDE,
        station.lon_rad[0],
        station.lat_rad[0],
        radians=True,
    )
    # On the ellipsoid, 1040 m below: shorter by 1.6e-4.
    assert distance_m * np.sin(azimuth_rad) == pytest.approx(3.0, abs=1e-3)
    assert distance_m * np.cos(azimuth_rad) == pytest.approx(-2.0, abs=1e-3)
    assert station.h_msl_m == pytest.approx(999.0, abs=1e-5)
    assert station.h_ellipsoid_m == pytest.approx(1039.0, abs=1e-5)


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
    roles = flown(height=sensor("GPS", **PLACE, **logged))
    mount = Mount(lever_arm_m=(0.0, 0.0, 1.0))

    station = station_at_5_s(roles, mount, HeightSystem(undulation_m))

    assert station.status[0] == status
    assert station.h_msl_m == pytest.approx(h_msl_m, abs=1e-5, nan_ok=True)
    assert station.h_ellipsoid_m == pytest.approx(h_ellipsoid_m, abs=1e-5, nan_ok=True)


WITH_GAP = flown()["position"].rows((SECONDS < 3.0) | (SECONDS >= 7.0))
ENDS_AT_4_S = flown()["attitude"].rows(SECONDS < 4.0)


@pytest.mark.parametrize(
    ("role", "logged", "status"),
    [
        ("position", WITH_GAP, ["outside_log", "ok", "in_gap", "outside_log"]),
        ("attitude", ENDS_AT_4_S, ["outside_log", "ok", "outside_log", "outside_log"]),
        ("position", None, ["no_position"] * 4),
        ("attitude", None, ["outside_log", "no_attitude", "no_attitude", "outside_log"]),
        ("height", None, ["outside_log", *["height_reference_unknown"] * 2, "outside_log"]),
    ],
    ids=["a gap", "the attitude ends", "no position", "no attitude", "no heights"],
)
def test_each_reason_has_its_name(role, logged, status):
    roles = flown()
    del roles[role]
    if logged is not None:
        roles[role] = logged
    stations = stations_at([-1.0, 2.0, 5.0, 9.95], roles)
    assert stations.status.tolist() == status


def test_air_outside_and_in_the_cabin_is_that_of_its_own_sensors():
    outside = sensor("HYGR[0]", temperature_k=283.15, relative_humidity=0.5)
    inside = sensor("HYGR[1]", temperature_k=293.15, relative_humidity=1.1)  # clipped to 1
    roles = flown(
        pressure=sensor("BARO[0]", pressure_pa=90_000.0),
        temperature=outside,
        humidity=outside,
        cabin_pressure=sensor("BARO[1]", pressure_pa=80_000.0 + 100.0 * SECONDS),
        cabin_temperature=inside,
        cabin_humidity=inside,
    )

    station = station_at_5_s(roles)

    assert station.pressure_pa == pytest.approx(90_000.0)
    assert station.cabin_pressure_pa == pytest.approx(80_500.0)
    assert station.temperature_k == pytest.approx(283.15)
    assert station.cabin_temperature_k == pytest.approx(293.15)
    # Saturation 12.28 hPa at 10 and 23.392 hPa at 20 degC; moist air holds 0.4 and 0.34 % more.
    assert station.vapour_pressure_pa == pytest.approx(0.5 * 1228.0 * 1.004, rel=1e-3)
    assert station.cabin_vapour_pressure_pa == pytest.approx(2339.2 * 1.0034, rel=1e-3)


def test_air_that_nothing_measures_is_unknown():
    station = station_at_5_s(flown())
    assert np.isnan(station.pressure_pa)
    assert np.isnan(station.cabin_pressure_pa)


@pytest.mark.parametrize(
    ("clocks_s", "horizontal_m", "height_m"),
    [
        ({}, 0.3, 0.6),
        # At 40 m/s 0.1 s are 4 m along the track: half of the variance counts on either level axis.
        ({"position_s": 0.1}, np.hypot(0.3, 4.0 / np.sqrt(2.0)), 0.6),
        # At a climb of 3 m/s 0.2 s are 0.6 m.
        ({"height_s": 0.2}, 0.3, np.hypot(0.6, 0.6)),
    ],
    ids=["one clock", "another clock of the positions", "another clock of the heights"],
)
def test_an_uncertain_clock_moves_the_stations_along_the_flight(clocks_s, horizontal_m, height_m):
    """Horizontal sigmas are those of the position, vertical ones those of the height."""
    north_rad = 40.0 * SECONDS / METRES_OF_LATITUDE
    place = {"lat_rad": LATITUDE + north_rad, "lon_rad": LONGITUDE}
    climb_m = 1000.0 + 3.0 * SECONDS
    roles = flown(
        position=sensor("POS", **place, sigma_h_m=0.3, sigma_v_m=0.4),
        height=sensor(
            "GPS",
            **place,
            h_msl_m=climb_m,
            sigma_h_m=0.5,
            sigma_v_m=0.6,
        ),
    )

    station = station_at_5_s(roles, **clocks_s)

    assert station.sigma_horizontal_m == pytest.approx(horizontal_m, rel=0.01)
    assert station.sigma_height_m == pytest.approx(height_m, rel=0.01)


@pytest.mark.parametrize(
    ("axis", "tilt_rad", "yaw_rad"),
    [
        ("Z", 0.003, np.hypot(0.004, 0.02)),
        ("X", np.hypot(0.003, 0.02 / np.sqrt(2.0)), 0.004),
    ],
    ids=["yawing", "rolling"],
)
def test_an_uncertain_clock_turns_the_stations_with_the_flight(axis, tilt_rad, yaw_rad):
    """0.2 rad/s for 0.1 s; sigmas that the mount states take the place of the log's."""
    angles_deg = np.degrees(0.2 * SECONDS[:, None])
    roles = flown(attitude=turned_channel("ATT", SECONDS, axis, angles_deg))
    mount = Mount(sigma_tilt_rad=0.003, sigma_yaw_rad=0.004)

    station = station_at_5_s(roles, mount, attitude_s=0.1)

    assert station.sigma_tilt_rad == pytest.approx(tilt_rad, rel=1e-3)
    assert station.sigma_yaw_rad == pytest.approx(yaw_rad, rel=1e-3)
