"""Position and attitude between samples: closed forms, and scipy's Slerp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from unbend.flight.channels import Channel, Source
from unbend.flight.ground_times import LoggedPath, takeoff_of
from unbend.flight.interpolation import (
    GAP_IN_CHANNEL,
    INSIDE,
    OUTSIDE_CHANNEL,
    bracket,
    interpolate,
)
from unbend.flight.trajectory import attitude_at, bend_of_heights, track_at, with_slopes

SECOND = 1_000_000_000


def channel(seconds: list[float], boot: list[int] | None = None, **columns: object) -> Channel:
    time_ns = (np.array(seconds) * SECOND).astype(np.int64)
    arrays = {name: np.asarray(values, np.float64) for name, values in columns.items()}
    boots = np.array(boot if boot is not None else [0] * len(seconds), np.int16)
    return Channel("X", time_ns, arrays, Source("X"), boots)


def at(*seconds: float) -> np.ndarray:
    return (np.array(seconds) * SECOND).astype(np.int64)


def test_linear_between_samples_and_exact_on_them() -> None:
    x = channel([0, 1, 2], value=[0.0, 10.0, 40.0])
    assert interpolate(x, "value", at(0, 0.25, 1, 1.5, 2), 1.0).tolist() == [0, 2.5, 10, 25, 40]


def test_nothing_outside_the_log() -> None:
    x = channel([0, 1, 2], value=[0.0, 10.0, 40.0])
    assert np.isnan(interpolate(x, "value", at(-0.001, 2.001), 1.0)).all()
    assert bracket(x, at(-0.001, 2.001), 1.0).coverage.tolist() == [OUTSIDE_CHANNEL] * 2


def test_nothing_in_a_gap_but_its_edges_stand() -> None:
    x = channel([0, 0.1, 0.2, 0.3, 9.0, 9.1], value=range(6))
    found = bracket(x, at(0.3, 0.31, 5.0, 8.99, 9.0), 1.0).coverage
    assert found.tolist() == [INSIDE, GAP_IN_CHANNEL, GAP_IN_CHANNEL, GAP_IN_CHANNEL, INSIDE]
    assert np.isnan(interpolate(x, "value", at(5.0), 1.0)).all()


def test_the_limit_is_the_limit_but_slow_air_sensors_have_their_own() -> None:
    x = channel([0, 2, 4, 6], value=range(4))
    assert bracket(x, at(3.0), 1.0).coverage.tolist() == [GAP_IN_CHANNEL]
    assert x.gap_limit_s(1.0) == 6.0
    assert bracket(x, at(3.0), x.gap_limit_s(1.0)).coverage.tolist() == [INSIDE]


def test_a_restart_is_a_gap_however_short() -> None:
    x = channel([0, 0.1, 0.2, 0.3], boot=[0, 0, 1, 1], value=range(4))
    coverage = bracket(x, at(0.05, 0.15, 0.25), 1.0).coverage
    assert coverage.tolist() == [INSIDE, GAP_IN_CHANNEL, INSIDE]


def test_an_empty_channel_and_a_missing_column() -> None:
    assert np.isnan(interpolate(channel([]), "value", at(0.0), 1.0)).all()
    assert np.isnan(interpolate(channel([0, 1], value=[0, 1]), "other", at(0.5), 1.0)).all()
    assert bracket(channel([]), at(0.0), 1.0).coverage.tolist() == [OUTSIDE_CHANNEL]


def test_longitude_across_the_180th_meridian() -> None:
    x = channel([0, 1], lat_rad=[0.3, 0.3], lon_rad=np.radians([179.9999, -179.9999]))
    track = track_at(x, at(0.25, 0.5, 0.75), 2.0)
    latitude = track.lat_rad
    longitude = track.lon_rad
    degrees = np.degrees(longitude) % 360.0
    assert np.allclose(degrees, [179.99995, 180.0, 180.00005], rtol=0, atol=1e-9)
    assert np.allclose(latitude, 0.3, rtol=0, atol=1e-12)


def test_position_over_the_pole() -> None:
    x = channel([0, 1], lat_rad=np.radians([89.9999, 89.9999]), lon_rad=np.radians([10, 190.0]))
    latitude = track_at(x, at(0.5), 2.0).lat_rad
    assert np.degrees(latitude[0]) == pytest.approx(90.0, abs=1e-7)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6),
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=5),
)
def test_attitude_agrees_with_scipys_slerp(angles: list[float], when: list[float]) -> None:
    both = Rotation.from_euler("ZYX", np.array(angles).reshape(2, 3))
    q = both.as_quat()
    x = channel([0, 1], q_x=q[:, 0], q_y=q[:, 1], q_z=q[:, 2], q_w=q[:, 3])
    found = attitude_at(x, at(*when), 2.0).quaternion
    instants = at(*when) / SECOND
    expected = Slerp([0, 1], both)(instants)
    turned = expected.inv() * Rotation.from_quat(found[:, [1, 2, 3, 0]])
    if (both[0].inv() * both[1]).magnitude() < np.pi - 1e-3:  # else either way is right
        assert turned.magnitude().max() < 1e-7
    assert (found[:, 0] >= 0.0).all()


def test_quaternions_of_either_sign_are_the_same_attitude() -> None:
    q = Rotation.from_euler("Z", [[0.1], [0.3]]).as_quat()
    signed = q * np.array([[1.0], [-1.0]])
    x = channel([0, 1], q_x=signed[:, 0], q_y=signed[:, 1], q_z=signed[:, 2], q_w=signed[:, 3])
    found = attitude_at(x, at(0.5), 2.0).quaternion
    assert Rotation.from_quat(found[0, [1, 2, 3, 0]]).as_euler("ZYX")[0] == pytest.approx(0.2)


def test_no_attitude_from_zeros_or_nan() -> None:
    x = channel([0, 1, 2], q_x=[0, 0, 0], q_y=[0, 0, 0], q_z=[0, np.nan, 0], q_w=[1, 1, 0])
    found = attitude_at(x, at(0.5, 1.5), 2.0).quaternion
    assert np.isnan(found).all()


def circle(seconds: np.ndarray) -> dict[str, np.ndarray]:
    """30 m/s around a circle of 150 m, climbing faster and faster, in closed form."""
    angle = seconds * 0.2
    return {
        "lat_rad": 0.8 + 150.0 * np.sin(angle) / MERIDIAN,
        "lon_rad": 0.1 - 150.0 * np.cos(angle) / PARALLEL,
        "h_msl_m": 500.0 + 0.4 * seconds**2,
        "v_north_m_s": 30.0 * np.cos(angle),
        "v_east_m_s": 30.0 * np.sin(angle),
        "v_down_m_s": -0.8 * seconds,
    }


# WGS84 at 0.8 rad, by hand: e2 = 0.00669438, w2 = 1 - e2 sin^2(0.8) = 0.99655504
MERIDIAN = 6_378_137.0 * 0.99330562 / 0.99655504**1.5
PARALLEL = 6_389_152.0 * np.cos(0.8)
SECONDS = np.arange(0.0, 20.0, 2.0)


@pytest.mark.parametrize(("velocity", "allowed"), [(True, 0.06), (False, 0.5)])
def test_a_turn_is_followed_by_its_velocities(velocity: bool, allowed: float) -> None:
    """The chord of 2 s is 3.0 m beside the circle, and in height 0.4 m below the parabola."""
    columns = circle(SECONDS)
    if not velocity:
        columns = {name: c for name, c in columns.items() if not name.startswith("v_")}
    x = channel(list(SECONDS), **columns)
    when = np.array([6.5, 7.0, 9.0, 11.3])
    true = circle(when)
    found = track_at(x, at(*when), 3.0)
    north = (found.lat_rad - true["lat_rad"]) * MERIDIAN
    east = (found.lon_rad - true["lon_rad"]) * PARALLEL
    assert np.hypot(north, east).max() < allowed
    chord = interpolate(x, "lat_rad", at(*when), 3.0), interpolate(x, "lon_rad", at(*when), 3.0)
    beside = np.hypot(
        (chord[0] - true["lat_rad"]) * MERIDIAN, (chord[1] - true["lon_rad"]) * PARALLEL
    )
    assert beside.max() > 2.9
    assert np.linalg.norm(found.sigma_m, axis=1).max() < 2.0
    bent = bend_of_heights(x, "h_msl_m", at(*when), 3.0)
    bend = bent.metres_up
    down = bent.speed_down_m_s
    height = interpolate(x, "h_msl_m", at(*when), 3.0) + bend
    np.testing.assert_allclose(height, true["h_msl_m"], atol=1e-6)
    np.testing.assert_allclose(down[1:3], true["v_down_m_s"][1:3] if velocity else [-5.6, -7.2])
    np.testing.assert_allclose(
        found.velocity_m_s[1], [30 * np.cos(1.4), 30 * np.sin(1.4)], rtol=0.05
    )


def test_velocities_that_contradict_the_positions_are_not_followed() -> None:
    columns = circle(SECONDS) | {"v_north_m_s": np.full(10, 300.0)}
    x = channel(list(SECONDS), **columns)
    straight = interpolate(x, "lat_rad", at(7.0), 3.0)
    assert (track_at(x, at(7.0), 3.0).lat_rad - straight)[0] * MERIDIAN == pytest.approx(
        0, abs=0.01
    )


def rolling(seconds: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """A roll to and fro by 35 degrees and a steady turn, and its body rates by differences."""

    def attitude(t: np.ndarray) -> Rotation:
        angles = np.stack([0.25 * t, np.full(t.shape, 0.05), 0.6 * np.sin(1.3 * t)], axis=1)
        return Rotation.from_euler("ZYX", angles)

    step = attitude(seconds - 1e-5).inv() * attitude(seconds + 1e-5)
    return attitude(seconds), step.as_rotvec() / 2e-5


def test_an_attitude_at_1_hz_follows_its_rates_and_knows_its_sigma() -> None:
    seconds = np.arange(0.0, 30.0)
    when = np.arange(4.0, 26.0, 0.07)
    true, rates = rolling(seconds)
    q = true.as_quat()
    names = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
    gyro = channel(list(seconds), **dict(zip(names, rates.T, strict=True)))
    bare = channel(list(seconds), q_x=q[:, 0], q_y=q[:, 1], q_z=q[:, 2], q_w=q[:, 3])
    errors = [rms_deg(rolling(when)[0], Slerp(seconds, true)(when))]
    from_middle = np.abs(when % 1.0 - 0.5)
    for x in (bare, with_slopes(bare, [gyro], names)):
        found = attitude_at(x, at(*when), 2.0)
        rotation = Rotation.from_quat(found.quaternion[:, [1, 2, 3, 0]])
        errors.append(rms_deg(rolling(when)[0], rotation))
        sigma = np.degrees(found.sigma_rad)
        assert 0.1 < errors[-1] / np.sqrt(np.mean(sigma**2)) < 1.2
        assert sigma[from_middle < 0.1].mean() > 2.0 * sigma[from_middle > 0.4].mean()
    slerp, parabolas, with_rates = errors
    assert slerp > 2.0
    assert parabolas < slerp / 2.0
    assert with_rates < slerp / 10.0


def rms_deg(true: Rotation, found: Rotation) -> float:
    return float(np.sqrt(np.mean((true.inv() * found).as_rotvec(degrees=True) ** 2)))


def test_a_log_that_begins_on_the_180th_meridian_stands_still_there() -> None:
    """Its longitudes change sign from sample to sample, and lie 20 cm apart."""
    time_ns = np.arange(5) * SECOND
    lon_rad = np.array([1.0, -1.0, 1.0, -1.0, 1.0]) * (np.pi - 1.5e-8)
    takeoff = takeoff_of(LoggedPath(time_ns, np.zeros(5), lon_rad, np.full(5, 12.0)), home_m=None)
    assert takeoff is not None
    assert takeoff.stands
    assert takeoff.h_msl_m == 12.0


def test_the_rates_of_a_coning_body_are_turned_to_the_second_order() -> None:
    """Sola et al. 2018, Eq. 144: the axis of a turn of 50 deg/s goes round a cone of 1.2 rad.

    Without the term of the second order the error is 0.010 deg, with twice of it 0.019 deg.
    """

    def attitude(t: np.ndarray) -> Rotation:
        angles = np.stack([0.9 * t, np.full(t.shape, 1.2), -0.18 * t], axis=1)
        return Rotation.from_euler("ZYZ", angles)

    seconds = np.arange(0.0, 30.0)
    rates = (attitude(seconds - 1e-5).inv() * attitude(seconds + 1e-5)).as_rotvec() / 2e-5
    q = attitude(seconds).as_quat()
    names = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
    gyro = channel(list(seconds), **dict(zip(names, rates.T, strict=True)))
    bare = channel(list(seconds), q_x=q[:, 0], q_y=q[:, 1], q_z=q[:, 2], q_w=q[:, 3])
    when = np.arange(4.0, 26.0, 0.07)
    found = attitude_at(with_slopes(bare, [gyro], names), at(*when), 2.0).quaternion
    assert rms_deg(attitude(when), Rotation.from_quat(found[:, [1, 2, 3, 0]])) < 0.006
