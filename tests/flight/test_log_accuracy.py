"""How accurate a log says it is; the filter's constants from its noises, by a Riccati equation."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from tests.flight.made_channels import instants
from tests.helpers import NS_PER_S, channel
from unbend.flight.evidence import log_accuracy
from unbend.flight.evidence.log_accuracy import LogAccuracy


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_the_filters_constants_are_the_steady_state_of_its_default_noises(rate_hz):
    """Place, velocity and tilt of ArduPilot's EKF3, as a Kalman-Bucy filter.

    Defaults: EK3_POSNE_M_NSE and EK3_VELNE_M_NSE 0.5, EK3_ACC_P_NSE 0.35 m/s2, EK3_GYRO_P_NSE 0.015
    rad/s, the latter two added in steps of 12 ms.
    """
    step_s = 0.012
    noise = np.diag([0.0, 0.35**2 * step_s, 0.015**2 * step_s])
    motion = np.diag([1.0, 9.80665], k=1)
    observed = np.eye(3)[:2]
    fixes = np.eye(2) * 0.5**2 / rate_hz
    state = solve_continuous_are(
        motion.T,
        observed.T,
        noise,
        fixes,
    )
    gain = state @ observed.T @ np.linalg.inv(fixes)
    closed = motion - gain @ observed
    poles = np.linalg.eigvals(closed)
    slowest_pole = np.min(-poles.real)
    shifts_s = []
    for period_s in np.geomspace(1.0, 300.0, 300):
        # Velocities of the receiver that swing: place over innovation.
        frequency = 2j * np.pi / period_s
        swing = frequency * np.eye(3) - closed
        place, velocity, _ = np.linalg.solve(swing, gain[:, 1])
        shifts_s.append(abs(place / (1.0 - velocity)))

    tilt_rad = np.sqrt(state[2, 2])
    assert pytest.approx(tilt_rad, rel=0.12) == log_accuracy.TILT_RAD
    window_s = log_accuracy.WINDOW_NS / NS_PER_S
    assert 2.5 / slowest_pole < window_s < 4.0 / slowest_pole
    assert max(shifts_s) == pytest.approx(log_accuracy.FILTER_TIME_S, rel=0.15)


def test_a_receiver_of_one_fix_has_that_accuracy_before_and_after_it():
    receiver = channel(
        "GPS",
        [10.0],
        sigma_h_m=1.0,
        sigma_v_m=1.5,
    )
    time_ns = instants(9.9, 10.0, 10.1)
    sigmas = LogAccuracy(receiver).positions(receiver, time_ns)
    assert sigmas.horizontal_m.tolist() == [1.0] * 3
    assert sigmas.height_m.tolist() == [1.5] * 3


SECONDS = np.arange(0.0, 60.0, 0.2)
RECEIVER = channel(
    "GPS",
    SECONDS,
    sigma_h_m=1.0,
    sigma_v_m=1.5,
)
FUSED = channel("POS", SECONDS, lat_rad=0.0)
HEALTH = channel(
    "XKF4",
    SECONDS,
    innovation_position=0.4,
    innovation_height=0.1,
    innovation_velocity=np.where(SECONDS < 30.0, 0.0, 0.2),
)
ACCURACY = LogAccuracy(RECEIVER, HEALTH)
SHAKEN_DEG = np.hypot(0.1, 0.22)  # 0.2 of the gate are one sigma of the filter
USUAL_YAW_DEG = 0.36


def test_a_filter_has_the_accuracy_of_its_receiver_and_its_innovations():
    """0.4 of a gate of 2.5 m is 1 m; 0.2 of 2.5 m/s in 1.3 s are 0.65 m; 0.1 of 15 m is 1.5 m."""
    sigmas = ACCURACY.positions(FUSED, instants(5.0, 50.0))

    still_m = np.sqrt(2.0)
    moving_m = np.hypot(still_m, 0.65)
    assert sigmas.horizontal_m == pytest.approx([still_m, moving_m])
    assert sigmas.height_m == pytest.approx(np.hypot(1.5, 1.5))


def test_a_height_without_a_reported_sigma_is_as_exact_as_that_of_a_filter():
    horizontal_only = channel("GPA", SECONDS, sigma_h_m=0.3)

    sigmas = ACCURACY.positions(horizontal_only, instants(5.0))

    assert sigmas.horizontal_m == pytest.approx([0.3])
    assert sigmas.height_m == pytest.approx(np.hypot(1.5, 1.5))


def test_an_attitude_is_as_uncertain_as_innovations_of_the_velocity_show():
    """The tangent of the dip is 0 and 2."""
    latitude = np.radians([0.0, 45.0])

    tilt_rad, yaw_rad = ACCURACY.attitude(
        FUSED,
        instants(5.0, 50.0),
        latitude,
    )

    assert np.degrees(tilt_rad) == pytest.approx([0.1, SHAKEN_DEG])
    shaken_yaw_deg = np.hypot(USUAL_YAW_DEG, 2.0 * SHAKEN_DEG)
    assert np.degrees(yaw_rad) == pytest.approx([USUAL_YAW_DEG, shaken_yaw_deg])


@pytest.mark.parametrize(
    ("latitude_deg", "yaw_deg"),
    [
        (np.nan, USUAL_YAW_DEG),
        (-89.0, np.hypot(USUAL_YAW_DEG, 6.0 * SHAKEN_DEG)),
    ],
)
def test_what_a_log_does_not_say_is_usual_or_unknown(latitude_deg, yaw_deg):
    silent = LogAccuracy()
    time_ns = instants(5.0)
    latitude = np.radians([latitude_deg])

    attitude = silent.attitude(FUSED, time_ns, latitude)
    positions = silent.positions(FUSED, time_ns)

    assert np.degrees(attitude.tilt_rad) == pytest.approx(SHAKEN_DEG)
    assert np.degrees(attitude.yaw_rad) == pytest.approx(yaw_deg)
    assert np.isnan(positions).all()


def test_without_an_accuracy_the_dilution_counts_and_without_fixes_the_filter_drifts():
    """0.8 times 3 m; 6 s behind the last fix, which is 5 s more than 1 s, at 2 m/s."""
    receiver = channel(
        "GPS",
        [*range(10), *range(30, 40)],
        hdop=0.8,
    )
    accuracy = LogAccuracy(receiver)

    sigmas = accuracy.positions(FUSED, instants(5.0, 15.0))

    drift_m = 10.0
    level_m = 2.4 / np.sqrt(2.0)
    level_later_m = np.hypot(level_m, drift_m)
    assert sigmas.horizontal_m == pytest.approx([level_m, level_later_m])
    assert sigmas.height_m == pytest.approx([3.6, np.hypot(3.6, drift_m)])


def test_the_height_of_a_receiver_that_swings_about_the_filter_is_that_uncertain():
    seconds = np.arange(0.0, 120.0, 0.2)
    climb_m = 500.0 + 3.0 * seconds
    swing_m = 0.8 * np.sin(0.63 * seconds)
    swing_m[seconds <= 60.0] = 0.0
    receiver = channel(
        "GPS",
        seconds,
        sigma_v_m=0.3,
        h_msl_m=climb_m + swing_m,
    )
    fused = channel("POS", seconds, h_msl_m=climb_m + 7.0)

    accuracy = LogAccuracy(receiver, None, fused)

    sigmas = accuracy.positions(receiver, instants(30.0, 95.0))

    uncertain_m = np.hypot(0.3, 0.8 / np.sqrt(2.0))
    assert sigmas.height_m == pytest.approx([0.3, uncertain_m], rel=0.05)
