"""How accurate a log says it is; the filter's constants from its noises, by a Riccati equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from unbend.flight.channels import Channel, Source
from unbend.flight.evidence import log_accuracy
from unbend.flight.evidence.log_accuracy import LogAccuracy

SECOND = 1_000_000_000


def channel(seconds: list[float], **columns: np.ndarray) -> Channel:
    time_ns = (np.array(seconds) * SECOND).astype(np.int64)
    return Channel("X", time_ns, columns, Source("X"))


def at(*seconds: float) -> np.ndarray:
    return (np.array(seconds) * SECOND).astype(np.int64)


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_the_filters_constants_are_the_steady_state_of_its_default_noises(rate_hz) -> None:
    """Place, velocity and tilt of ArduPilot's EKF3, as a Kalman-Bucy filter.

    Defaults: EK3_POSNE_M_NSE and EK3_VELNE_M_NSE 0.5, EK3_ACC_P_NSE 0.35 m/s2, EK3_GYRO_P_NSE 0.015
    rad/s, the latter two added in steps of 12 ms.
    """
    step_s = 0.012
    gravity = 9.80665
    noise = np.diag([0.0, 0.35**2 * step_s, 0.015**2 * step_s])
    motion = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, gravity], [0.0, 0.0, 0.0]])
    seen = np.eye(3)[:2]
    fixes = np.eye(2) * 0.5**2 / rate_hz
    state = solve_continuous_are(motion.T, seen.T, noise, fixes)
    tilt = np.degrees(np.sqrt(state[2, 2]))
    assert np.degrees(log_accuracy.TILT_RAD) == pytest.approx(tilt, rel=0.12)
    gain = state @ seen.T @ np.linalg.inv(fixes)
    closed = motion - gain @ seen
    forgets_s = 1.0 / np.min(-np.linalg.eigvals(closed).real)
    assert 2.5 * forgets_s < log_accuracy.WINDOW_NS / SECOND < 4.0 * forgets_s
    periods_s = np.geomspace(1.0, 300.0, 300)
    shifts = []
    for period_s in periods_s:  # velocities of the receiver that swing: place over innovation
        swing = 2j * np.pi / period_s * np.eye(3) - closed
        moved = np.linalg.solve(swing, gain[:, 1])
        shifts.append(abs(moved[0] / (1.0 - moved[1])))
    assert max(shifts) == pytest.approx(log_accuracy.FILTER_TIME_S, rel=0.15)


def test_a_receiver_of_one_fix_has_that_accuracy_before_and_after_it() -> None:
    receiver = channel([10.0], sigma_h_m=np.array([1.0]), sigma_v_m=np.array([1.5]))
    sigmas = LogAccuracy(receiver).positions(receiver, at(9.9, 10.0, 10.1))
    assert sigmas.horizontal_m.tolist() == [1.0, 1.0, 1.0]
    assert sigmas.height_m.tolist() == [1.5, 1.5, 1.5]


def test_a_filter_has_the_accuracy_of_its_receiver_and_its_innovations() -> None:
    seconds = list(np.arange(0.0, 60.0, 0.2))
    receiver = channel(seconds, sigma_h_m=np.full(300, 1.0), sigma_v_m=np.full(300, 1.5))
    health = channel(
        seconds,
        innovation_position=np.full(300, 0.4),
        innovation_height=np.zeros(300),
        innovation_velocity=np.repeat([0.0, 0.2], 150),
    )
    fused = channel(seconds, lat_rad=np.zeros(300))
    accuracy = LogAccuracy(receiver, health)
    horizontal, vertical = accuracy.positions(fused, at(5.0, 50.0))
    # 0.4 of a gate of 2.5 m is 1 m; 0.2 of 2.5 m/s in 1.3 s are 0.65 m
    np.testing.assert_allclose(horizontal, [np.sqrt(2.0), np.sqrt(2.0 + 0.65**2)], rtol=1e-9)
    np.testing.assert_allclose(vertical, 1.5)
    latitude = np.radians([0.0, 45.0])  # the tangent of the dip is 0 and 2
    tilt, yaw = accuracy.attitude(fused, at(5.0, 50.0), latitude)
    shaken = np.hypot(0.1, 0.22)  # 0.2 of the gate are one sigma of the filter
    np.testing.assert_allclose(np.degrees(tilt), [0.1, shaken])
    np.testing.assert_allclose(np.degrees(yaw), [0.36, np.hypot(0.36, 2.0 * shaken)])
    unknown = LogAccuracy().attitude(fused, at(5.0), np.array([np.nan]))
    np.testing.assert_allclose(np.degrees(np.ravel(unknown)), [shaken, 0.36])
    near_pole = LogAccuracy().attitude(fused, at(5.0), np.radians([-89.0]))[1]
    np.testing.assert_allclose(np.degrees(near_pole), np.hypot(0.36, 6.0 * shaken))
    assert np.isnan(LogAccuracy().positions(fused, at(5.0))[0]).all()


def test_without_an_accuracy_the_dilution_counts_and_without_fixes_the_filter_drifts() -> None:
    seconds = [*np.arange(0.0, 10.0), *np.arange(30.0, 40.0)]
    receiver = channel(seconds, hdop=np.full(20, 0.8))
    fused = channel(seconds, lat_rad=np.zeros(20))
    horizontal, vertical = LogAccuracy(receiver).positions(fused, at(5.0, 15.0))
    # 0.8 times 3 m in the plane; 6 s behind the last fix, which is 5 s more than 1 s, at 2 m/s
    np.testing.assert_allclose(horizontal, np.sqrt([2.4**2 / 2, 2.4**2 / 2 + 10.0**2]))
    np.testing.assert_allclose(vertical, np.sqrt([3.6**2, 3.6**2 + 10.0**2]))


def test_the_height_of_a_receiver_that_swings_about_the_filter_is_that_uncertain() -> None:
    seconds = np.arange(0.0, 120.0, 0.2)
    climb = 500.0 + 3.0 * seconds
    swing = np.where(seconds > 60.0, 0.8 * np.sin(0.63 * seconds), 0.0)
    receiver = channel(list(seconds), sigma_v_m=np.full(600, 0.3), h_msl_m=climb + swing)
    fused = channel(list(seconds), h_msl_m=climb + 7.0)
    _, vertical = LogAccuracy(receiver, None, fused).positions(receiver, at(30.0, 95.0))
    np.testing.assert_allclose(vertical, [0.3, np.hypot(0.3, 0.8 / np.sqrt(2.0))], rtol=0.05)
