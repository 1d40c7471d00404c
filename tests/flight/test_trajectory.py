"""Position and attitude between samples: closed forms, and scipy's Slerp."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies
from scipy.spatial.transform import Rotation, Slerp

from tests.flight.made_channels import (
    instants,
    quaternion_columns,
    rotation_of,
    with_columns,
    without_columns,
)
from tests.helpers import channel
from unbend.flight.ground_times import LoggedPath, takeoff_of
from unbend.flight.interpolation import (
    GAP_IN_CHANNEL,
    INSIDE,
    OUTSIDE_CHANNEL,
    bracket,
    interpolate,
)
from unbend.flight.trajectory import (
    RATES,
    attitude_at,
    bend_of_heights,
    track_at,
    with_slopes,
)

TENTHS_S = [0, 0.1, 0.2, 0.3]
THREE = channel(
    "X",
    [0, 1, 2],
    value=[0.0, 10.0, 40.0],
)
WITH_GAP = channel("X", [*TENTHS_S, 9.0, 9.1], value=1.0)
WITH_RESTART = replace(
    channel("X", TENTHS_S, value=1.0),
    boot=np.array([0, 0, 1, 1], np.int16),
)
EMPTY = channel("X", [], value=[])


@pytest.mark.parametrize("begin_ns", [0, 1_700_000_000_123_456_789])
def test_linear_between_samples_and_exact_on_them(begin_ns):
    logged = replace(THREE, time_ns=THREE.time_ns + begin_ns)
    time_ns = begin_ns + instants(0, 0.25, 1, 1.5, 2)
    assert interpolate(logged, "value", time_ns, 1.0).tolist() == [0, 2.5, 10, 25, 40]


@pytest.mark.parametrize(
    ("logged", "seconds", "coverage"),
    [
        (
            THREE,
            [-0.001, 0, 2, 2.001],
            [OUTSIDE_CHANNEL, INSIDE, INSIDE, OUTSIDE_CHANNEL],
        ),
        (
            WITH_GAP,
            [0.3, 0.31, 8.99, 9.0],
            [INSIDE, GAP_IN_CHANNEL, GAP_IN_CHANNEL, INSIDE],
        ),
        (WITH_RESTART, [0.05, 0.15, 0.25], [INSIDE, GAP_IN_CHANNEL, INSIDE]),
        (EMPTY, [0], [OUTSIDE_CHANNEL]),
    ],
    ids=["outside", "in a gap", "a restart, however short", "an empty channel"],
)
def test_nothing_is_known_outside_a_log_and_in_its_gaps(logged, seconds, coverage):
    time_ns = instants(*seconds)
    assert bracket(logged, time_ns, 1.0).coverage.tolist() == coverage
    values = interpolate(logged, "value", time_ns, 1.0)
    assert np.isfinite(values).tolist() == [place == INSIDE for place in coverage]


def test_a_missing_column_is_unknown():
    assert np.isnan(interpolate(THREE, "other", instants(0.5), 1.0)).all()


def test_slow_air_sensors_have_a_limit_of_gaps_of_their_own():
    slow = channel("X", [0, 2, 4, 6])
    assert bracket(slow, instants(3.0), 1.0).coverage.tolist() == [GAP_IN_CHANNEL]
    assert slow.gap_limit_s(1.0) == 6.0
    assert bracket(slow, instants(3.0), 6.0).coverage.tolist() == [INSIDE]


def test_longitude_across_the_180th_meridian():
    lon_rad = np.radians([179.9999, -179.9999])
    logged = channel(
        "X",
        [0, 1],
        lat_rad=0.3,
        lon_rad=lon_rad,
    )

    track = track_at(logged, instants(0.25, 0.5, 0.75), 2.0)

    degrees = np.degrees(track.lon_rad) % 360.0
    assert degrees == pytest.approx(
        [179.99995, 180.0, 180.00005],
        rel=0,
        abs=1e-9,
    )
    assert track.lat_rad == pytest.approx(0.3, rel=0, abs=1e-12)


def test_position_over_the_pole():
    lon_rad = np.radians([10.0, 190.0])
    logged = channel(
        "X",
        [0, 1],
        lat_rad=np.radians(89.9999),
        lon_rad=lon_rad,
    )
    latitude = track_at(logged, instants(0.5), 2.0).lat_rad
    assert np.degrees(latitude) == pytest.approx(90.0, abs=1e-7)


def test_a_log_that_begins_on_the_180th_meridian_stands_still_there():
    """Its longitudes change sign from sample to sample, and lie 20 cm apart."""
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    path = LoggedPath(
        instants(*range(5)),
        np.zeros(5),
        signs * (np.pi - 1.5e-8),
        np.full(5, 12.0),
    )

    takeoff = takeoff_of(path, home_m=None)

    assert takeoff.stands
    assert takeoff.h_msl_m == 12.0


def with_attitudes(seconds, attitude):
    return channel("ATT", seconds, **quaternion_columns(attitude))


def attitudes_at(logged, *seconds):
    return attitude_at(logged, instants(*seconds), 2.0)


ANGLES_RAD = strategies.lists(
    strategies.floats(-np.pi, np.pi),
    min_size=6,
    max_size=6,
)
BETWEEN_S = strategies.lists(
    strategies.floats(0.0, 1.0),
    min_size=1,
    max_size=5,
)


@settings(max_examples=50)
@given(ANGLES_RAD, BETWEEN_S)
def test_two_attitudes_agree_with_scipys_slerp(angles, seconds):
    both = Rotation.from_euler("ZYX", np.reshape(angles, (2, 3)))

    quaternion = attitudes_at(with_attitudes([0, 1], both), *seconds).quaternion

    assert (quaternion[:, 0] >= 0.0).all()
    expected = Slerp([0, 1], both)(instants(*seconds) / 1e9)
    turned = expected.inv() * rotation_of(quaternion)
    if (both[0].inv() * both[1]).magnitude() < np.pi - 1e-3:  # else either way is right
        assert turned.magnitude().max() < 1e-7


def test_quaternions_of_either_sign_are_the_same_attitude():
    logged = with_attitudes([0, 1], Rotation.from_euler("Z", [[0.1], [0.3]]))
    signs = [1.0, -1.0]
    turned = with_columns(
        logged,
        q_w=logged["q_w"] * signs,
        q_z=logged["q_z"] * signs,
    )
    quaternion = attitudes_at(turned, 0.5).quaternion
    assert rotation_of(quaternion[0]).as_rotvec() == pytest.approx([0.0, 0.0, 0.2])


def test_no_attitude_from_zeros_or_nan():
    logged = channel(
        "ATT",
        [0, 1, 2],
        q_x=0,
        q_y=0,
        q_z=[0, np.nan, 0],
        q_w=[1, 1, 0],
    )
    assert np.isnan(attitudes_at(logged, 0.5, 1.5).quaternion).all()


# WGS84 at 0.8 rad, by hand: e2 = 0.00669438, w2 = 1 - e2 sin^2(0.8) = 0.99655504
MERIDIAN_M = 6_378_137.0 * 0.99330562 / 0.99655504**1.5
PARALLEL_M = 6_389_152.0 * np.cos(0.8)
VELOCITIES = ("v_north_m_s", "v_east_m_s", "v_down_m_s")


def circle(seconds):
    """30 m/s around a circle of 150 m, climbing faster and faster, in closed form."""
    angle = seconds * 0.2
    return {
        "lat_rad": 0.8 + 150.0 * np.sin(angle) / MERIDIAN_M,
        "lon_rad": 0.1 - 150.0 * np.cos(angle) / PARALLEL_M,
        "h_msl_m": 500.0 + 0.4 * seconds**2,
        "v_north_m_s": 30.0 * np.cos(angle),
        "v_east_m_s": 30.0 * np.sin(angle),
        "v_down_m_s": -0.8 * seconds,
    }


EVERY_2_S = np.arange(0.0, 20.0, 2.0)
FLOWN = channel("POS", EVERY_2_S, **circle(EVERY_2_S))
ASKED_S = np.array([6.5, 7.0, 9.0, 11.3])
TRUTH = circle(ASKED_S)


def beside_m(latitude, longitude):
    """How far places are from the circle at most."""
    north_m = (latitude - TRUTH["lat_rad"]) * MERIDIAN_M
    east_m = (longitude - TRUTH["lon_rad"]) * PARALLEL_M
    return np.hypot(north_m, east_m).max()


@pytest.mark.parametrize(
    ("unknown", "allowed_m"),
    [((), 0.06), (VELOCITIES, 0.5)],
    ids=["by velocities", "by parabolas"],
)
def test_a_turn_is_followed(unknown, allowed_m):
    """The chord of 2 s is 3.0 m beside the circle, and in height 0.4 m below the parabola."""
    logged = without_columns(FLOWN, *unknown)
    time_ns = instants(*ASKED_S)

    track = track_at(logged, time_ns, 3.0)
    bent = bend_of_heights(logged, "h_msl_m", time_ns, 3.0)

    chord_lat = interpolate(logged, "lat_rad", time_ns, 3.0)
    chord_lon = interpolate(logged, "lon_rad", time_ns, 3.0)
    assert beside_m(chord_lat, chord_lon) > 2.9
    assert beside_m(track.lat_rad, track.lon_rad) < allowed_m
    assert np.linalg.norm(track.sigma_m, axis=1).max() < 2.0
    velocity_m_s = [
        30 * np.cos(1.4),
        30 * np.sin(1.4),
    ]
    assert track.velocity_m_s[1] == pytest.approx(velocity_m_s, rel=0.05)
    height_m = interpolate(logged, "h_msl_m", time_ns, 3.0) + bent.metres_up
    assert height_m == pytest.approx(TRUTH["h_msl_m"], abs=1e-6)
    assert bent.speed_down_m_s[1:3] == pytest.approx([-5.6, -7.2])


def test_velocities_that_contradict_the_positions_are_not_followed():
    logged = with_columns(FLOWN, v_north_m_s=np.full(10, 300.0))
    straight = interpolate(logged, "lat_rad", instants(7.0), 3.0)
    bend_rad = track_at(logged, instants(7.0), 3.0).lat_rad - straight
    assert bend_rad * MERIDIAN_M == pytest.approx(0, abs=0.01)


EVERY_SECOND = np.arange(0.0, 30.0)
BETWEEN = np.arange(4.0, 26.0, 0.07)


def rolling(t):
    """A roll to and fro by 35 degrees and a steady turn."""
    yaw = 0.25 * t
    pitch = np.full(t.shape, 0.05)
    roll = 0.6 * np.sin(1.3 * t)
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))


def coning(t):
    """The axis of a turn of 50 deg/s goes round a cone of 1.2 rad."""
    cone = np.full(t.shape, 1.2)
    return Rotation.from_euler("ZYZ", np.stack([0.9 * t, cone, -0.18 * t], axis=1))


def with_rates(logged, motion):
    """Attitudes at 1 Hz with the rates of their motion about the axes of the body."""
    step = motion(EVERY_SECOND - 1e-5).inv() * motion(EVERY_SECOND + 1e-5)
    rates = step.as_rotvec().T / 2e-5
    gyro = channel(
        "IMU",
        EVERY_SECOND,
        **dict(zip(RATES, rates, strict=True)),
    )
    return with_slopes(logged, [gyro], RATES)


def rms(values):
    return np.sqrt(np.mean(values**2))


def rms_deg(truth, attitude):
    return rms((truth.inv() * attitude).as_rotvec(degrees=True))


def test_an_attitude_at_1_hz_follows_its_rates_and_knows_its_sigma():
    truth = rolling(BETWEEN)
    slerp = Slerp(EVERY_SECOND, rolling(EVERY_SECOND))
    slerp_deg = rms_deg(truth, slerp(BETWEEN))
    assert slerp_deg > 2.0
    alone = with_attitudes(EVERY_SECOND, rolling(EVERY_SECOND))
    from_middle_s = np.abs(BETWEEN % 1.0 - 0.5)

    for logged, times_better in (
        (alone, 2.0),
        (with_rates(alone, rolling), 10.0),
    ):
        attitudes = attitudes_at(logged, *BETWEEN)
        error_deg = rms_deg(truth, rotation_of(attitudes.quaternion))
        assert error_deg < slerp_deg / times_better
        sigma_deg = np.degrees(attitudes.sigma_rad)
        assert 0.1 < error_deg / rms(sigma_deg) < 1.2
        near_middle = sigma_deg[from_middle_s < 0.1].mean()
        near_samples = sigma_deg[from_middle_s > 0.4].mean()
        assert near_middle > 2.0 * near_samples


def test_the_rates_of_a_coning_body_are_turned_to_the_second_order():
    """Sola et al. 2018, Eq. 144.

    Without the term of the second order the error is 0.010 deg, with twice of it 0.019 deg.
    """
    alone = with_attitudes(EVERY_SECOND, coning(EVERY_SECOND))
    quaternion = attitudes_at(with_rates(alone, coning), *BETWEEN).quaternion
    assert rms_deg(coning(BETWEEN), rotation_of(quaternion)) < 0.006
