"""What calibrations know of the sensors takes the place of what is expected of cheap ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.estimate.readings import collect_readings
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.messages import Kind, Ledger

US1976 = standard_atmosphere("us1976")
HYGROMETER = SensorFault.HYGROMETER_BIAS
RECOVERY = SensorFault.RECOVERY_FACTOR
DRIFT = SensorFault.THERMOMETER_DRIFT
BIAS = SensorFault.THERMOMETER_BIAS
LAG = SensorFault.THERMOMETER_LAG
TRANSIENT = SensorFault.TAKEOFF_TRANSIENT
OFFSET = SensorFault.PRESSURE_OFFSET
HEIGHT = SensorFault.GNSS_HEIGHT_OFFSET
SCALE = {SensorFault.PRESSURE_SCALE: SensorCalibration(sigma=1e-5)}


@pytest.fixture(scope="module")
def truth(flights):
    return flights.Truth(flights.extremes()[2])


def background(truth):
    return climatology(latitude_rad=truth.latitude, month=7.0, ground_h_m=float(truth.h[0]))


def flown(flights, truth, sensors, calibration, climb=3000.0, **how):
    samples = flights.fly(truth, climb, sensors, np.random.default_rng(3), **how)
    ledger = Ledger()
    found = build_adjusted_profile(
        samples,
        US1976,
        truth.latitude,
        ledger,
        background=background(truth),
        settings=SensorSettings(calibration=calibration),
    )
    return found, ledger


# All else is known to be good, and of thermometer or barometer there is only the one.
GOOD = {
    BIAS: SensorCalibration(0.0, 0.05),
    TRANSIENT: SensorCalibration(0.0, 0.05),
    LAG: SensorCalibration(0.0, 0.2),
    DRIFT: SensorCalibration(None, 0.02),
    OFFSET: SensorCalibration(0.0, 5.0),
    HYGROMETER: SensorCalibration(0.0, 0.005),
    HEIGHT: SensorCalibration(None, 0.1),
    **SCALE,
}
WRONG = {
    BIAS: ({"bias_k": 2.0}, 2.0, 0.1, {"barometer": False}),
    TRANSIENT: (
        {"transient_k": 6.0},
        6.0,
        0.2,
        {"gate_s": 0.0, "barometer": False},
    ),
    LAG: ({"lag_s": 30.0}, 30.0, 1.0, {"barometer": False}),
    OFFSET: ({"pressure_offset_pa": 90.0}, 90.0, 5.0, {}),
    HYGROMETER: ({"humidity_bias": 0.1}, 0.1, 0.005, {"humidity": "profile"}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_fault_that_is_known_is_taken_away(flights, truth, name):
    """Beside a flight whose sensors have no fault at all: what is left of the change of R."""
    wrong, mean, sigma, how = WRONG[name]
    ideal = flown(flights, truth, flights.Sensors(), GOOD, **how)[0].profile
    right = truth.r_plane(ideal.refractivity(truth.h), 3000.0)
    left = []
    for value in (mean, 0.0, -mean):
        given = GOOD | {name: SensorCalibration(value, sigma)}
        found, _ = flown(flights, truth, flights.Sensors(**wrong), given, **how)
        left.append(abs(truth.r_plane(found.profile.refractivity(truth.h), 3000.0) / right - 1.0))
        if value == mean:
            (fault,) = [n for n in found.faults if n.fault == name]
            assert fault.prior_sigma == pytest.approx(sigma)
    print(f"{name}: {left}")
    # A lag that is known looks like warmth in the climb, which keeps its share of the air.
    assert left[0] < (0.5 if name == LAG else 0.3) * left[1]
    if name == HYGROMETER:
        # Off by 20 and 40 stated sigmas it has hardly any weight, and the error is that of the
        # climate's humidity.
        assert max(left) < 0.002
        return
    # Twice as wrong is twice as bad, unless it is so much that the first readings are outliers of
    # the tropics' air, which varies by 3 K.
    assert left[1] < (1.0 if name == TRANSIENT else 0.8) * left[2]


def test_what_is_not_said_stays_as_it_is_expected(flights, truth):
    samples = flights.fly(truth, 1000.0, flights.Sensors(), np.random.default_rng(3))
    air = background(truth)
    expected = {f.name: f for f in collect_readings(samples, air, SensorSettings()).faults}
    given = {
        BIAS: SensorCalibration(sigma=0.2),
        LAG: SensorCalibration(mean=4.0),
    }
    found = collect_readings(samples, air, SensorSettings(calibration=given))
    faults = {f.name: f for f in found.faults}
    assert (
        faults[BIAS].mean,
        faults[BIAS].sigma,
    ) == (0.0, 0.2)
    assert (
        faults[LAG].mean,
        faults[LAG].sigma,
    ) == (4.0, expected[LAG].sigma)
    assert {n: f for n, f in faults.items() if n not in given} == {
        n: f for n, f in expected.items() if n not in given
    }


def test_a_thermometer_that_keeps_still_says_more(flights, truth):
    samples = flights.fly(truth, 1000.0, flights.Sensors(), np.random.default_rng(3))
    sigma = [
        estimate(samples, background(truth), settings=SensorSettings(calibration=known))
        .covariance.sigma_temperature([500.0])
        .item()
        for known in (
            {},
            {DRIFT: SensorCalibration(sigma=0.02), BIAS: SensorCalibration(sigma=0.1)},
            {BIAS: SensorCalibration(sigma=0.1)},
        )
    ]
    assert sigma[1] < sigma[2] < sigma[0]


def test_a_flight_that_contradicts_the_calibration_says_so(flights, truth):
    sensors = flights.Sensors(bias_k=4.0)
    _, ledger = flown(flights, truth, sensors, {BIAS: SensorCalibration(0.0, 0.1), **SCALE})
    (entry,) = [e for e in ledger if e.code == "AIR-CALIBRATION"]
    assert FAULT_TEXTS[BIAS] in entry.what
    assert "0 ± 0.1 in the mission file" in entry.what
    alone = float(entry.what.split(", ")[1].split()[0])
    assert alone == pytest.approx(4.0, abs=0.8)
    _, ledger = flown(flights, truth, sensors, {BIAS: SensorCalibration(4.0, 0.1)})
    assert not [e for e in ledger if e.code.startswith("AIR-CALIBRATION")]


@pytest.mark.parametrize("off", [-5.0, 3.5])
def test_no_rare_fault_of_the_barometer_explains_a_wrong_calibration(flights, truth, off):
    """Of the barometer nothing is known: lost pressure explains what the thermometer reads."""
    stated = flights.REALISTIC.bias_k + off
    given = {BIAS: SensorCalibration(stated, 0.1)}
    _, ledger = flown(flights, truth, flights.REALISTIC, given)
    (entry,) = [e for e in ledger if e.code == "AIR-CALIBRATION"]
    assert entry.kind is Kind.FINDING
    assert f"{stated:.3g} ± 0.1 in the mission file" in entry.what


def test_a_calibration_that_is_right_is_seldom_contradicted(flights, truth):
    """Sensors drawn from what is said of them: none in 40 flights at 4 sigma."""
    rng = np.random.default_rng(8)
    said = 0
    for _ in range(40):
        bias = rng.normal(0.0, 0.5)
        offset = rng.normal(0.0, 20.0)
        sensors = replace(flights.REALISTIC, bias_k=bias, pressure_offset_pa=offset)
        samples = flights.fly(truth, 3000.0, sensors, rng)
        ledger = Ledger()
        given = {
            BIAS: SensorCalibration(0.0, 0.5),
            OFFSET: SensorCalibration(0.0, 20.0),
        }
        build_adjusted_profile(
            samples,
            US1976,
            truth.latitude,
            ledger,
            background=background(truth),
            settings=SensorSettings(calibration=given),
        )
        said += sum(entry.code == "AIR-CALIBRATION" for entry in ledger)
    assert said == 0


def test_what_no_sensor_has_is_said(flights, truth):
    _, ledger = flown(
        flights,
        truth,
        flights.Sensors(),
        {RECOVERY: SensorCalibration(0.8, 0.05)},
    )
    (entry,) = [e for e in ledger if e.code == "AIR-CALIBRATION-UNUSED"]
    assert FAULT_TEXTS[RECOVERY] in entry.what


@pytest.mark.parametrize("descent", [False, True])
@pytest.mark.parametrize(
    ("wrong", "name", "mean", "sigma"),
    [
        ({"bias_k": 12.0}, BIAS, 12.0, 0.1),
        ({"bias_k": -12.0}, BIAS, -12.0, 0.1),
        ({"pressure_offset_pa": 3000.0}, OFFSET, 3000.0, 10.0),
    ],
)
def test_no_sensor_is_refused_for_a_fault_that_is_known(
    flights, truth, wrong, name, mean, sigma, descent
):
    """8 K are too much for a thermometer of which nothing is known, and a barometer's 30 hPa look
    like that many kelvins."""
    sensors = flights.Sensors(**wrong)
    given = {name: SensorCalibration(mean, sigma), **SCALE}
    found, ledger = flown(flights, truth, sensors, given, descent=descent)
    assert found.basis in ("thermometer", "both")
    codes = {entry.code for entry in ledger}
    assert "AIR-CALIBRATED" in codes
    assert not codes & {"AIR-THERMOMETER", "AIR-CALIBRATION"}
    assert abs(truth.error(found.profile, 3000.0)) < 0.005
    refused, _ = flown(flights, truth, sensors, {}, descent=descent)
    assert refused.basis == "barometer" or name == OFFSET


def test_only_the_worst_is_accused(flights, truth):
    """A lag that is stated wrongly draws the bias along, which is right.

    The thermometer is known to be no warmer in the climb, which would explain 4 s of lag as well.
    """
    given = GOOD | {
        LAG: SensorCalibration(8.0, 0.5),
        BIAS: SensorCalibration(0.0, 0.02),
        SensorFault.CLIMB_WARMTH: SensorCalibration(0.0, 0.01),
    }
    _, ledger = flown(flights, truth, flights.Sensors(lag_s=12.0), given, descent=True)
    (entry,) = [e for e in ledger if e.code == "AIR-CALIBRATION"]
    assert entry.what.startswith(f"{FAULT_TEXTS[LAG]}: 8 ± 0.5 in the mission file, 1")
