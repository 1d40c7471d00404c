"""The estimator piece by piece: its derivatives, its sensor faults, its fallbacks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from tests.atmosphere import flights
from tests.atmosphere.adjusting import (
    DESERT,
    HOUR_NS,
    NO_SENSORS,
    QUIET,
    TRADES,
    US1976,
    adjust,
    balloon_of,
    drawn_flight,
    extreme,
    extreme_airs,
    fault_of,
    flown,
    seconds_of,
    sigma_of_r,
    station_at,
    warmer,
    with_readings,
)
from tests.helpers import with_code
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import SensorSamples
from unbend.atmosphere.climatology import AUTO, climatology
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.binning import bin_readings
from unbend.atmosphere.estimate.estimate_checks import is_plausible
from unbend.atmosphere.estimate.hypotheses import hypotheses_of
from unbend.atmosphere.estimate.knots import place_knots
from unbend.atmosphere.estimate.readings import collect_readings
from unbend.atmosphere.estimate.sensors import (
    THERMOMETER_FAULTS,
    FlownHeights,
    SensorCalibration,
    SensorSettings,
    Thermometer,
)
from unbend.atmosphere.estimate.solver import estimate, layout_of, solve
from unbend.atmosphere.estimate.state import (
    Drift,
    Layout,
    SensorFault,
    air_of,
    prior_of,
)
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Kind
from unbend.simulate.true_air import saturation_pressure_pa

LAG = SensorFault.THERMOMETER_LAG


def background(truth, name="us1976"):
    return climatology(name, latitude_rad=truth.latitude, month=6.0)


def estimated(truth, samples, **more):
    return estimate(samples, background(truth), moisture=background(truth, AUTO), **more)


def about_the_standard(truth, samples=NO_SENSORS, **more):
    return adjust(truth, samples, background=None, **more)


def airspeed_at(sensor, speed):
    return SensorSamples(sensor.time_ns, sensor.h_m, speed, name="airspeed")


# The derivatives of what sensors read


def test_every_derivative_of_every_source(trades):
    """At a state that is far from its prior, in humid air."""
    air = background(trades)
    samples = flown(trades, 2500.0, seed=8, humidity="profile")
    t = samples.temperature
    readings = collect_readings(
        replace(samples, airspeed=airspeed_at(t, np.full(t.value.size, 40.0))),
        air,
        SensorSettings(),
        soundings=[balloon_of(trades)],
        surface=[SurfaceReport(100.0, 1.0e5, 299.0, 2400.0)],
    )
    layout = layout_of(readings, air)
    prior = prior_of(layout, air, background(trades, AUTO))
    away = default_rng(8).normal(size=layout.size)
    x = prior.mean + 0.3 * away / np.sqrt(np.diag(prior.precision))
    x[layout.humidity] = np.clip(x[layout.humidity], 0.3, 0.8)
    profile = air.profile
    pressure = profile.pressure(profile.gravity.height(layout.knot))

    def predict(source, state):
        return source.predict(air_of(layout, state, pressure, profile.constant))

    assert len(readings.sets) == 10
    assert {type(source).__name__ for source in readings.sets} == {
        "Thermometer",
        "Barometer",
        "Humidities",
        "Temperatures",
        "Pressures",
    }
    for source in readings.sets:
        _, jacobian = predict(source, x)
        scale = np.abs(jacobian).max()
        for column, step in enumerate(1e-3 * np.eye(layout.size)):
            above, _ = predict(source, x + step)
            below, _ = predict(source, x - step)
            off = jacobian[:, column] - (above - below) / 2e-3
            # Lag moves a reading across kinks of T(H): there its derivative is one-sided.
            limit = 0.05 if column == layout.fault(LAG) else 2e-6
            assert np.abs(off).max() < limit * scale, (source.name, column)


def test_the_derivative_by_the_lag_is_that_of_an_exponential_memory():
    """T = a t^2 in a climb reads a (t^2 - 2 t lag + 2 lag^2): by the lag a (-2 t + 4 lag)."""
    drift = Drift(
        SensorFault.THERMOMETER_DRIFT,
        np.array([0.0, 1000.0]),
        1.0,
        900.0,
    )
    knot = np.arange(-1000.0, 4001.0, 10.0)
    layout = Layout(
        knot,
        np.array([0.0, 15_000.0]),
        0.0,
        THERMOMETER_FAULTS,
        (drift,),
    )
    climb = 5.0
    lag = 40.0
    curve = -2e-6
    x = np.zeros(layout.size)
    x[layout.temperature] = 290.0 + curve * np.maximum(knot, 0.0) ** 2
    x[layout.fault(LAG)] = lag
    x[layout.fault(SensorFault.TRANSIENT_DECAY)] = math.log(60.0)
    air = air_of(layout, x, np.full(knot.size, 9e4), 0.0342)
    t = np.array([300.0, 500.0])
    times = np.arange(0.0, 601.0)
    sensor = Thermometer(
        "T",
        climb * t,
        np.zeros(2),
        np.ones(2),
        t,
        since_s=t,
        flown=FlownHeights(times, climb * times),
        climbing=np.ones(2),
    )

    reading, jacobian = sensor.predict(air)

    a = curve * climb**2
    assert_allclose(reading, 290.0 + a * (t**2 - 2.0 * t * lag + 2.0 * lag**2), atol=0.02)
    by_lag = jacobian[:, layout.fault(LAG)]
    assert_allclose(by_lag, a * (-2.0 * t + 4.0 * lag), rtol=0.03)


def test_air_near_the_ground_and_sun_on_a_probe_are_in_the_prior():
    """By hand: 1.5 K at the ground, 1/e of it 40 m up; 0.2 K of a minute beside 0.4."""
    air = climatology(latitude_rad=0.8, month=7.0)
    knot = np.array([-500.0, 0.0, 40.0, 4000.0])
    layout = Layout(
        knot,
        np.array([0.0, 250.0, 15e3]),
        0.0,
        (),
        (),
    )
    prior = prior_of(layout, air, air)
    variance = np.diag(np.linalg.inv(prior.precision))[:4]
    h = air.profile.gravity.height(knot)
    assert_allclose(variance, air.spread.sigma_temperature(h) ** 2, rtol=1e-6)

    (ground,) = (part for part in air.spread.parts if part.name == "ground")
    sigma_k = np.interp(h, ground.h_m, ground.sigma_k)
    by_hand = [1.5, 1.5, 1.5 * math.exp(-1.0), 0.0]
    assert sigma_k == pytest.approx(by_hand, abs=0.08)

    drift = Drift(
        "thermometer_drift",
        np.array([0.0, 60.0]),
        0.4,
        900.0,
        (0.2, 60.0),
    )
    at_once, after_a_minute = drift.covariance()[0]
    assert_allclose(at_once, 0.2)
    by_hand = 0.16 * math.exp(-60.0 / 900.0) + 0.04 * math.exp(-1.0)
    assert_allclose(after_a_minute, by_hand)


# The covariance


def test_sigma_of_r_is_that_of_the_gradient(night):
    """By differences of R of profiles with one quantity moved, integrated in the test."""
    made = estimate(flown(night, 800.0), background(night))
    profile = made.profile
    layers = profile.layers
    edges = layers.edge.size
    t_m = profile.virtual_temperature(profile.gravity.height(layers.edge))
    vapour = np.append(layers.vapour, layers.vapour[-1])
    anchor_m = made.covariance.anchor_m
    level_pa = profile.pressure(profile.gravity.height(anchor_m))

    def r(change):
        moved = stack_layers(
            layers.edge,
            t_m + change[:edges],
            vapour + change[edges + 1 :],
            layers.source,
            anchor=(anchor_m, float(level_pa) * math.exp(change[edges])),
            constant=profile.constant,
        )
        moved_profile = Profile(moved, profile.gravity, profile.index)
        return night.r_plane(moved_profile.refractivity(night.h), 800.0)

    steps = np.repeat([1e-2, 1e-4, 1e-5], [edges, 1, edges])
    gradient = [(r(step) - r(-step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    variance = gradient @ made.covariance.matrix @ gradient
    sigma = math.sqrt(variance) / abs(r(0.0 * steps))
    assert sigma_of_r(made, night, 800.0) == pytest.approx(sigma, rel=2e-3)
    assert 0.005 < sigma < 0.05


@pytest.mark.parametrize("name", ["us1976", AUTO])
def test_without_measurements_it_is_the_climatology_with_its_sigma(monsoon, name):
    air = background(monsoon, name)
    made = estimate(NO_SENSORS, air)
    h = [0.0, 500.0, 3000.0, 9000.0, 15_000.0]
    assert_allclose(
        made.profile.temperature(h),
        air.profile.temperature(h),
        atol=0.03,
    )
    assert_allclose(
        made.profile.pressure(h),
        air.profile.pressure(h),
        rtol=1e-3,
    )
    assert_allclose(
        made.covariance.sigma_temperature(h),
        air.spread.sigma_temperature(h),
        rtol=0.05,
    )
    level = made.covariance.sigma_log_pressure(0.0)
    assert level == pytest.approx(air.spread.pressure_ratio, rel=0.02)


def test_a_covariance_must_fit_its_profile():
    with pytest.raises(ValueError, match="does not fit"):
        ProfileCovariance(US1976, 0.0, np.eye(3))


def test_the_doubt_of_vapour_is_that_of_humidity_and_of_pressure(monsoon):
    """Nothing measured: sigma_e is the climatology's sigma of RH times e_s(T), and e sigma_p/p."""
    air = background(monsoon, AUTO)
    made = estimate(NO_SENSORS, air)
    covariance = made.covariance
    h = [500.0, 1500.0, 3000.0]
    t = made.profile.temperature(h)
    e = made.profile.vapour_pressure(h)
    by_humidity = air.spread.sigma_relative_humidity(h) * saturation_pressure_pa(t)
    # e_s grows by 5420 K/T^2 a kelvin (Clausius-Clapeyron).
    by_temperature = e * 5420.0 / t**2 * covariance.sigma_temperature(h)
    both = np.hypot(by_humidity, by_temperature)
    assert_allclose(covariance.sigma_vapour_pressure(h), both, rtol=0.15)
    # Pressure alone in doubt, by 2 %: so is e where e/p is known.
    edges = made.profile.layers.edge.size
    level = np.zeros_like(covariance.matrix)
    level[edges, edges] = 0.02**2
    alone = replace(covariance, matrix=level)
    assert_allclose(alone.sigma_vapour_pressure(h), 0.02 * e, rtol=1e-12)


# It settles


@pytest.mark.parametrize("climb", [1000.0, 3000.0])
def test_every_estimate_settles(climb):
    """Lag across the kinks of T(H) made whole steps jump by 0.1 to 0.4 K for ever.

    An estimate is a mixture, which is the minimum of nothing: the parts are what settles, here
    those of usual sensors and of each rare fault in turn.
    """
    for number, truth in enumerate(extreme_airs()):
        air = background(truth)
        samples = drawn_flight(truth, climb, number, descent=number % 2 == 0)
        readings = collect_readings(samples, air, SensorSettings())
        hypotheses = hypotheses_of(layout_of(readings, air), readings.rare)
        assert len(hypotheses) == 4
        layout = hypotheses[number % 4].layout
        prior = prior_of(layout, air, background(truth, AUTO))
        problem = (layout, prior, readings.sets, air.profile)

        made = solve(*problem)
        again = solve(*problem, made.x)

        assert made.converged, truth.name
        # From where it ended it does not move.
        moved_k = np.abs(again.x - made.x)[layout.temperature]
        variance = np.diag(again.covariance)[layout.temperature]
        assert moved_k.max() < 0.1
        assert (moved_k / np.sqrt(variance)).max() < 0.1


def test_an_estimate_that_does_not_settle_is_told_of(night, monkeypatch):
    # No flight is known that does not settle: the steps that are allowed are fewer than it needs.
    monkeypatch.setattr("unbend.atmosphere.estimate.solver._MOST_STEPS", 5)
    samples = flown(night, 3000.0)
    assert not estimated(night, samples).converged
    assert "AIR-UNSETTLED" in about_the_standard(night, samples).codes(Kind.WARNING)


# What is wrong with the sensors is found

QUIET_BOTH = replace(QUIET, pressure_noise_pa=3.0)


def test_bias_lag_and_transient_are_found(trades):
    samples = flown(trades, 3000.0, seed=2, gate_s=0.0, descent=True)
    made = estimated(trades, samples)
    check_fault(made, SensorFault.THERMOMETER_BIAS, 3.0, sharp=2.0)
    check_fault(made, LAG, 20.0, sharp=2.0)
    check_fault(made, SensorFault.TAKEOFF_TRANSIENT, 5.0, sharp=1.5)


def check_fault(made, fault, value, *, sharp, sigmas=3.0):
    """A fault is found within so many of its sigmas, which are smaller than ``sharp``."""
    estimate_of_fault = fault_of(made, fault)
    assert estimate_of_fault.sigma < sharp, fault
    off = estimate_of_fault.value - value
    assert abs(off) < sigmas * estimate_of_fault.sigma, fault


GOOD_BAROMETER = {
    SensorFault.GNSS_HEIGHT_OFFSET: SensorCalibration(sigma=30.0),
    SensorFault.PRESSURE_OFFSET: SensorCalibration(0.0, 1.0),
}


@pytest.mark.parametrize(
    ("fault", "wrong", "climb", "calibration", "sharp"),
    [
        # 1 hPa, twice what is expected.
        (SensorFault.PRESSURE_OFFSET, {"pressure_offset_pa": 100.0}, 6000.0, {}, 45.0),
        # Heights that read too large are a positive offset.
        (SensorFault.GNSS_HEIGHT_OFFSET, {"gnss_offset_m": 12.0}, 3000.0, GOOD_BAROMETER, 5.0),
        (SensorFault.GNSS_HEIGHT_OFFSET, {"gnss_offset_m": -12.0}, 3000.0, GOOD_BAROMETER, 5.0),
    ],
)
def test_an_offset_is_found_beside_stations_with_its_sign(
    trades, fault, wrong, climb, calibration, sharp
):
    (value,) = wrong.values()
    samples = flown(
        trades,
        climb,
        replace(QUIET_BOTH, **wrong),
        seed=2,
        descent=True,
    )
    made = estimated(
        trades,
        samples,
        surface=[station_at(trades, row) for row in (0, 100, 200, 300)],
        settings=SensorSettings(calibration=calibration),
    )
    check_fault(made, fault, value, sharp=sharp, sigmas=2.5)


def test_a_static_port_in_the_wind_is_found(night):
    """p reads 5 % of the dynamic pressure too much: 50 Pa at 40 m/s, 200 Pa at 80."""
    samples = flown(night, 3000.0, QUIET_BOTH, seed=3, descent=True)
    p = samples.pressure
    speed = np.where(np.gradient(p.h_m) > 1.0, 40.0, 80.0)
    dynamic_pa = 0.5 * 1.225 * speed**2
    windy = with_readings(samples, p.value + 0.05 * dynamic_pa, "pressure")
    made = estimated(night, replace(windy, airspeed=airspeed_at(p, speed)))
    check_fault(
        made,
        SensorFault.DYNAMIC_PRESSURE_ERROR,
        0.05,
        sharp=0.015,
        sigmas=2.5,
    )


def test_the_heat_of_speed_is_found(night):
    """r V^2/(2 c_p): 2.3 K at 75 m/s, and the climb was slower than the survey."""
    samples = flown(night, 3000.0, QUIET, seed=3, descent=True)
    t = samples.temperature
    speed = np.where(np.gradient(t.h_m) > 1.0, 45.0, 80.0)
    density = night.at_height(night.p / night.t, t.h_m - night.ground_m) / 287.05
    heated = warmer(samples, 0.85 * speed**2 / (2.0 * 1005.0) * 1.225 / density)
    made = estimated(night, replace(heated, airspeed=airspeed_at(t, speed)))
    check_fault(made, SensorFault.RECOVERY_FACTOR, 0.85, sharp=0.2, sigmas=2.5)
    assert abs(night.error(made.profile, 3000.0)) < 0.006


def test_outliers_are_marked(monsoon):
    samples = flown(monsoon, 3000.0, QUIET)
    t = samples.temperature
    bad = default_rng(4).random(t.value.size) < 0.03

    adjusted = about_the_standard(monsoon, warmer(samples, 15.0 * bad))

    rejected = adjusted.made.rejected["temperature"] == Reason.OUTLIER
    # In the few bins where the air itself changes fast an outlier may stay, with little weight.
    assert rejected[bad & t.accepted].mean() > 0.9
    assert rejected[~bad].mean() < 0.002
    outliers = with_code(adjusted.ledger, "AIR-OUTLIERS")
    counts = [message.count for message in outliers if message.where == "thermometer"]
    assert counts == [rejected.sum()]


def test_a_board_is_air_plus_ten_kelvin_only_if_the_user_insists(night):
    samples = flown(night, 3000.0, QUIET, seed=5, gate_s=60.0)
    board = warmer(samples, 12.0 + 4.0 * np.sin(seconds_of(samples) / 200.0))

    refused = about_the_standard(night, board)
    insisted = about_the_standard(
        night,
        board,
        settings=SensorSettings(board_temperature=True),
    )

    assert refused.losses == ["AIR-THERMOMETER"]
    assert refused.basis == "barometer"
    assert not insisted.is_told
    assert insisted.basis == "thermometer"
    assert fault_of(insisted.made, SensorFault.THERMOMETER_BIAS).prior_sigma == 10.0
    assert insisted.departure(3000.0) < 2.0
    assert insisted.sigma(3000.0) > 0.006


# Other sources


@pytest.mark.parametrize("age_h", [0, 24])
def test_a_sounding_alone(arctic, age_h):
    """Of a flight whose time is not known no sounding is old."""
    balloon = balloon_of(arctic, time_ns=arctic.start_ns - age_h * HOUR_NS)
    adjusted = about_the_standard(arctic, soundings=[balloon], time_ns=None)
    assert adjusted.basis == "sounding"
    assert abs(adjusted.error(1000.0)) < 0.02
    assert abs(adjusted.error(6000.0)) < 0.02


def test_a_surface_report_anchors_a_flight_without_a_barometer(monsoon):
    samples = flown(
        monsoon,
        2000.0,
        flights.Sensors(),
        seed=6,
        barometer=False,
        humidity="none",
    )
    report = replace(
        station_at(monsoon),
        temperature_k=monsoon.t[0],
        vapour_pressure_pa=monsoon.e[0],
    )

    alone = about_the_standard(monsoon, samples)
    anchored = about_the_standard(monsoon, samples, surface=[report])

    levels = slice(0, 2000, 100)
    p = anchored.profile.pressure(monsoon.h[levels])
    assert_allclose(p, monsoon.p[levels], rtol=1.5e-3)
    doubt = anchored.covariance.sigma_log_pressure(monsoon.ground_m)
    assert doubt < 0.2 * alone.covariance.sigma_log_pressure(monsoon.ground_m)
    assert about_the_standard(monsoon, surface=[report]).basis == "surface"
    blank = SurfaceReport(monsoon.ground_m, math.nan, math.nan, math.nan)
    assert about_the_standard(monsoon, samples, surface=[blank]).basis == "thermometer"


# Never worse than the climatology


def with_noise_of_40_s(t, seed, size_k):
    """Of eight draws of 20 K three are refused; about a wider spread, of 7 K, it was four. The
    others err by 2 to 5 % and state 7 %."""
    count = t.value.size
    steps = default_rng(seed).normal(0.0, size_k, count // 40 + 1)
    return t.value + steps.repeat(40)[:count]


def noise_of_20_k(t):
    return with_noise_of_40_s(t, 11, 20.0)


def cooling_by_14_k_per_km(t):
    return 290.0 - 0.014 * (t.h_m - t.h_m.min())


def hot_as_no_air(t):
    return 330.0 + 1e-4 * t.h_m


@pytest.mark.parametrize(
    ("readings", "words"),
    [
        (noise_of_20_k, "were not used in the estimate"),
        (cooling_by_14_k_per_km, "air is unstable from 9.8 K/km"),
        (hot_as_no_air, "sigma from the climatology"),
    ],
)
def test_a_thermometer_that_measures_no_air(night, readings, words):
    samples = flown(
        night,
        3000.0,
        flights.Sensors(),
        seed=9,
        barometer=False,
        gate_s=60.0,
    )
    wrong = with_readings(samples, readings(samples.temperature))

    adjusted = about_the_standard(night, wrong)

    assert adjusted.basis == "standard"
    message = adjusted.entry("AIR-IMPLAUSIBLE", Kind.LOSS)
    assert words in message.what
    h = np.linspace(0.0, 12_000.0, 60)
    standard = standard_atmosphere("us1976", latitude=night.latitude)
    assert_allclose(
        adjusted.profile.refractivity(h),
        standard.refractivity(h),
        rtol=1e-12,
    )
    assert adjusted.sigma(3000.0) > 0.05
    assert adjusted.departure(3000.0) < 2.5


@pytest.mark.parametrize("factor", [0.6, 1.25])
def test_temperatures_that_no_air_has(monsoon, factor):
    made = estimated(monsoon, flown(monsoon, 800.0, flights.Sensors()))
    assert is_plausible(made, background(monsoon))
    layers = made.profile.layers
    hot = replace(
        layers,
        temperature=factor * layers.temperature,
        lapse=factor * layers.lapse,
    )
    unlike_air = replace(made, profile=replace(made.profile, layers=hot))
    assert "not those of air" in is_plausible(unlike_air, background(monsoon)).reason


@pytest.mark.parametrize("place", [DESERT, TRADES])
@pytest.mark.parametrize("size_k", [2.0, 9.0, 25.0])
@pytest.mark.parametrize("barometer", [True, False])
def test_whatever_a_thermometer_reads_the_sigma_knows(place, size_k, barometer):
    """Noise that is no longer random within a bin: either not used, or hardly, and it is said."""
    truth = extreme(place)
    samples = flown(truth, 3000.0, seed=10, barometer=barometer)
    wild = with_readings(samples, with_noise_of_40_s(samples.temperature, 12, size_k))
    adjusted = about_the_standard(truth, wild)
    assert {
        "AIR-IMPLAUSIBLE",
        "AIR-MISFIT",
        "AIR-THERMOMETER",
        "AIR-UNSETTLED",
    }.intersection(adjusted.codes())
    assert adjusted.departure(3000.0) < 2.5
    if barometer:
        assert abs(adjusted.error(3000.0)) < 0.03


def test_too_little_height_returns_the_climatology_with_its_sigma(trades):
    climate = climatology(AUTO, latitude_rad=trades.latitude, month=3.0)
    adjusted = adjust(trades, flown(trades, 20.0), background=climate)
    assert adjusted.basis == "climatology"
    assert adjusted.codes() == ["AIR-STANDARD"]
    h = np.linspace(0.0, 12_000.0, 50)
    assert_allclose(
        adjusted.profile.temperature(h),
        climate.profile.temperature(h),
        atol=0.02,
    )
    assert_allclose(
        adjusted.covariance.sigma_temperature(h),
        climate.spread.sigma_temperature(h),
        rtol=0.1,
    )


# Bins and knots


def test_bins_keep_ways_and_times_apart():
    """A climb, 800 s of level flight in slices of 300 s, and a descent."""
    seconds = np.arange(1200.0)
    bins = bin_readings(
        seconds,
        np.interp(seconds, [0, 199, 1000, 1199], [0, 100, 100, 0]),
        np.repeat([1.0, 2.0, 3.0], [200, 800, 200]),
        np.ones(1200, bool),
        width=50.0,
        slice_s=300.0,
        floor=0.01,
    )
    assert bins.count.sum() >= 1198
    assert (bins.height > 99.0).sum() >= 4
    low = bins.height < 90.0
    climbing = bins.seconds < 300.0
    assert_allclose(bins.value[low & climbing], 1.0, atol=1e-12)
    assert_allclose(bins.value[low & ~climbing], 3.0, atol=1e-12)


def test_means_of_many_readings_are_not_better_than_their_correlation():
    """200 s at 10 Hz: independent every 2 s."""
    bins = bin_readings(
        0.1 * np.arange(2000),
        np.full(2000, 10.0),
        default_rng(2).normal(0.0, 0.2, 2000),
        np.ones(2000, bool),
        width=50.0,
        slice_s=1e4,
        floor=0.05,
    )
    assert_allclose(bins.sigma.item(), 0.2 / math.sqrt(101.0), rtol=0.1)


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (0.0, 100.0),
        (-400.0, 12_000.0),
        (3000.0, 3300.0),
    ],
)
def test_knots(low, high):
    edge = US1976.layers.edge
    knot = place_knots(low, high, edge)
    gap = np.diff(knot)
    below = knot[:-1]
    assert gap.min() > 10.0
    assert {edge[0], edge[-1]} <= set(knot)
    assert gap[(below >= low) & (knot[1:] <= high)].max() <= 101.0
    assert knot.size < 300
    assert gap[knot[1:] < 32_000.0].max() < 900.0
