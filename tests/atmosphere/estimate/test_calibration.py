"""What calibrations know of the sensors takes the place of what is expected of cheap ones."""

from dataclasses import replace

import pytest
from numpy.random import default_rng

from tests.atmosphere import adjusting, flights
from tests.atmosphere.adjusting import (
    MONSOON,
    NO_PRESSURE_LOST,
    adjust,
    extreme,
    fault_of,
)
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.readings import collect_readings
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.messages import Kind

HYGROMETER = SensorFault.HYGROMETER_BIAS
RECOVERY = SensorFault.RECOVERY_FACTOR
DRIFT = SensorFault.THERMOMETER_DRIFT
BIAS = SensorFault.THERMOMETER_BIAS
LAG = SensorFault.THERMOMETER_LAG
TRANSIENT = SensorFault.TAKEOFF_TRANSIENT
OFFSET = SensorFault.PRESSURE_OFFSET
RIGHT = flights.Sensors()


@pytest.fixture(scope="module")
def truth():
    return extreme(MONSOON)


@pytest.fixture(scope="module")
def air(truth):
    return climatology(
        latitude_rad=truth.latitude,
        month=7.0,
        ground_h_m=truth.ground_m,
    )


@pytest.fixture(scope="module")
def flown(truth, air):
    """Flies sensors over 3 km, and adjusts with what is known of them."""

    def fly(sensors, calibration, seed=3, **how):
        samples = adjusting.flown(truth, 3000.0, sensors, seed, **how)
        settings = SensorSettings(calibration=calibration)
        return adjust(truth, samples, background=air, settings=settings)

    return fly


# All else is known to be good, and of thermometer or barometer there is only the one.
GOOD = {
    BIAS: SensorCalibration(0.0, 0.05),
    TRANSIENT: SensorCalibration(0.0, 0.05),
    LAG: SensorCalibration(0.0, 0.2),
    DRIFT: SensorCalibration(None, 0.02),
    OFFSET: SensorCalibration(0.0, 5.0),
    HYGROMETER: SensorCalibration(0.0, 0.005),
    SensorFault.GNSS_HEIGHT_OFFSET: SensorCalibration(None, 0.1),
    **NO_PRESSURE_LOST,
}
NO_BAROMETER = {"barometer": False}


@pytest.mark.parametrize(
    ("fault", "wrong", "sigma", "how"),
    [
        (BIAS, {"bias_k": 2.0}, 0.1, NO_BAROMETER),
        (TRANSIENT, {"transient_k": 6.0}, 0.2, {"barometer": False, "gate_s": 0.0}),
        (LAG, {"lag_s": 30.0}, 1.0, NO_BAROMETER),
        (OFFSET, {"pressure_offset_pa": 90.0}, 5.0, {}),
        (HYGROMETER, {"humidity_bias": 0.1}, 0.005, {"humidity": "profile"}),
    ],
)
def test_a_fault_that_is_known_is_taken_away(truth, flown, fault, wrong, sigma, how):
    """Beside a flight whose sensors have no fault at all: what is left of the change of R."""

    def r(adjusted):
        return truth.r_plane(adjusted.profile.refractivity(truth.h), 3000.0)

    right = r(flown(RIGHT, GOOD, **how))
    (value,) = wrong.values()
    changes = []
    for mean in (value, 0.0, -value):
        calibration = GOOD | {fault: SensorCalibration(mean, sigma)}
        adjusted = flown(flights.Sensors(**wrong), calibration, **how)
        if mean == value:
            assert fault_of(adjusted.made, fault).prior_sigma == pytest.approx(sigma)
        changes.append(abs(r(adjusted) / right - 1.0))
    of_right, of_none, of_opposite = changes
    # A lag that is known looks like warmth in the climb, which keeps its share of the air.
    assert of_right < (0.5 if fault is LAG else 0.3) * of_none
    if fault is HYGROMETER:
        # Off by 20 and 40 stated sigmas it has hardly any weight, and the error is that of the
        # climate's humidity.
        assert max(changes) < 0.002
        return
    # Twice as wrong is twice as bad, unless it is so much that the first readings are outliers of
    # the tropics' air, which varies by 3 K.
    assert of_none < (1.0 if fault is TRANSIENT else 0.8) * of_opposite


def test_what_is_not_said_stays_as_it_is_expected(truth, air):
    samples = adjusting.flown(truth, 1000.0, RIGHT, seed=3)

    def faults_with(calibration):
        settings = SensorSettings(calibration=calibration)
        readings = collect_readings(samples, air, settings)
        return {fault.name: fault for fault in readings.faults}

    usual = faults_with({})
    expected = usual | {
        BIAS: replace(usual[BIAS], sigma=0.2),
        LAG: replace(usual[LAG], mean=4.0),
    }
    calibration = {
        BIAS: SensorCalibration(sigma=0.2),
        LAG: SensorCalibration(mean=4.0),
    }
    assert faults_with(calibration) == expected


def test_a_thermometer_that_keeps_still_says_more(truth, air):
    samples = adjusting.flown(truth, 1000.0, RIGHT, seed=3)
    bias = {BIAS: SensorCalibration(sigma=0.1)}
    drift = {DRIFT: SensorCalibration(sigma=0.02)}

    def sigma(calibration):
        made = estimate(samples, air, settings=SensorSettings(calibration=calibration))
        return made.covariance.sigma_temperature(500.0)

    assert sigma(bias | drift) < sigma(bias) < sigma({})


def test_a_flight_that_contradicts_the_calibration_says_so(flown):
    sensors = flights.Sensors(bias_k=4.0)
    wrong = flown(sensors, {BIAS: SensorCalibration(0.0, 0.1), **NO_PRESSURE_LOST})
    text = wrong.entry("AIR-CALIBRATION").what
    assert FAULT_TEXTS[BIAS] in text
    assert "0 ± 0.1 in the mission file" in text
    _, by_flight, *_ = text.split(", ")
    alone = float(by_flight.split()[0])
    assert alone == pytest.approx(4.0, abs=0.8)
    right = flown(sensors, {BIAS: SensorCalibration(4.0, 0.1)})
    assert not {"AIR-CALIBRATION", "AIR-CALIBRATION-UNUSED"} & set(right.codes())


@pytest.mark.parametrize("off", [-5.0, 3.5])
def test_no_rare_fault_of_the_barometer_explains_a_wrong_calibration(flown, off):
    """Of the barometer nothing is known: lost pressure explains what the thermometer reads."""
    wrong_k = flights.REALISTIC.bias_k + off
    calibration = {BIAS: SensorCalibration(wrong_k, 0.1)}
    adjusted = flown(flights.REALISTIC, calibration)
    message = adjusted.entry("AIR-CALIBRATION", Kind.FINDING)
    assert f"{wrong_k:.3g} ± 0.1 in the mission file" in message.what


def test_a_calibration_that_is_right_is_seldom_contradicted(flown):
    """Sensors drawn from what is said of them: none in ten flights at 4 sigma."""
    calibration = {
        BIAS: SensorCalibration(0.0, 0.5),
        OFFSET: SensorCalibration(0.0, 20.0),
    }
    for seed in range(10):
        bias_k, offset_pa = default_rng(seed).normal(0.0, [0.5, 20.0])
        sensors = replace(
            flights.REALISTIC,
            bias_k=bias_k,
            pressure_offset_pa=offset_pa,
        )
        adjusted = flown(sensors, calibration, seed)
        assert "AIR-CALIBRATION" not in adjusted.codes()


def test_what_no_sensor_has_is_said(flown):
    adjusted = flown(RIGHT, {RECOVERY: SensorCalibration(0.8, 0.05)})
    message = adjusted.entry("AIR-CALIBRATION-UNUSED")
    assert FAULT_TEXTS[RECOVERY] in message.what


@pytest.mark.parametrize("descent", [False, True])
@pytest.mark.parametrize(
    ("wrong", "fault", "sigma", "unless_known"),
    [
        ({"bias_k": 12.0}, BIAS, 0.1, ("barometer",)),
        ({"bias_k": -12.0}, BIAS, 0.1, ("barometer",)),
        ({"pressure_offset_pa": 3000.0}, OFFSET, 10.0, ("barometer", "thermometer", "both")),
    ],
)
def test_no_sensor_is_refused_for_a_fault_that_is_known(
    flown, wrong, fault, sigma, unless_known, descent
):
    """8 K are too much for a thermometer of which nothing is known, and a barometer's 30 hPa look
    like that many kelvins."""
    sensors = flights.Sensors(**wrong)
    (value,) = wrong.values()
    calibration = {fault: SensorCalibration(value, sigma), **NO_PRESSURE_LOST}
    adjusted = flown(sensors, calibration, descent=descent)
    codes = set(adjusted.codes())
    assert adjusted.basis in ("thermometer", "both")
    assert "AIR-CALIBRATED" in codes
    assert not {"AIR-THERMOMETER", "AIR-CALIBRATION"} & codes
    assert abs(adjusted.error(3000.0)) < 0.005
    assert flown(sensors, {}, descent=descent).basis in unless_known


def test_only_the_worst_is_accused(flown):
    """A lag that is stated wrongly draws the bias along, which is right.

    The thermometer is known to be no warmer in the climb, which would explain 4 s of lag as well.
    """
    calibration = GOOD | {
        LAG: SensorCalibration(8.0, 0.5),
        BIAS: SensorCalibration(0.0, 0.02),
        SensorFault.CLIMB_WARMTH: SensorCalibration(0.0, 0.01),
    }
    adjusted = flown(flights.Sensors(lag_s=12.0), calibration, descent=True)
    text = adjusted.entry("AIR-CALIBRATION").what
    assert text.startswith(f"{FAULT_TEXTS[LAG]}: 8 ± 0.5 in the mission file, 1")
