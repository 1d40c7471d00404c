"""What the adjustment does with good, bad and missing sensors, in an air known by construction."""

import math
from functools import cache

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import trapezoid

from tests.atmosphere.adjusting import (
    NO_PRESSURE_LOST,
    NO_SENSORS,
    US1976,
    Adjusted,
    with_readings,
)
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples, bin_by_height
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile, unadjusted
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.rejection import Reason
from unbend.messages import Kind, Ledger
from unbend.simulate.true_air import (
    relative_humidity,
    temperature_k,
    true_air,
    vapour_pressure_pa,
)

LATITUDE = math.radians(47.4)
FIELD_M = 450.0
START_NS = 1_600_000_000 * 10**9
SECOND_NS = 10**9


@cache
def air():
    """An inversion and humidity; integrated with WGS84 gravity, apart from the estimator."""
    return true_air(LATITUDE)


def heights_of(climb):
    """A climb and a descent at 5 m/s, once a second."""
    up = FIELD_M + np.arange(0.0, climb + 0.1, 5.0)
    return np.append(up, up[::-1])


H = heights_of(3000.0)


def sensor(h, value, name="sensor"):
    time_ns = START_NS + SECOND_NS * np.arange(h.size, dtype=np.int64)
    return SensorSamples(time_ns, h, value, name=name)


def thermometer(h=H):
    return sensor(h, temperature_k(h), "thermometer")


def barometer(h=H):
    return sensor(h, air().pressure_pa(h), "barometer")


def hygrometer(h=H):
    return sensor(h, relative_humidity(h), "hygrometer")


def measured(climb=3000.0):
    """Clean readings of a flight with all sensors."""
    h = heights_of(climb)
    return AirSamples(thermometer(h), barometer(h), hygrometer(h))


def by_barometer(climb=3000.0):
    return AirSamples(pressure=barometer(heights_of(climb)))


EXACT = SensorSettings(calibration=NO_PRESSURE_LOST)
"""These readings are clean: their static pressure loses nothing of its change."""


def adjust(samples, standard=US1976):
    ledger = Ledger()
    pressure = samples.pressure
    is_climb = pressure is not None and pressure.extent_m > 100.0
    made = build_adjusted_profile(
        samples,
        standard,
        LATITUDE,
        ledger,
        settings=EXACT if is_climb else None,
    )
    return Adjusted(made, ledger, air())


def source_at(adjusted, h):
    """What the layer of a height comes from."""
    profile = adjusted.profile
    return profile.layers.source[profile.layer_of(h)]


def error_of_r(adjusted, climb=3000.0):
    """Relative error of R in the plane, from the field to the top of the climb."""
    h = np.linspace(FIELD_M, FIELD_M + climb, 601)
    n = adjusted.profile.refractivity(h)
    true_n = air().n(h)
    right = trapezoid(true_n - true_n[-1])
    return trapezoid(n - n[-1]) / right - 1.0


@pytest.fixture(scope="module")
def clean():
    return adjust(measured())


@pytest.fixture(scope="module")
def barometric():
    return adjust(by_barometer())


def test_the_profile_is_the_air_that_was_measured(clean):
    h = np.linspace(FIELD_M + 30.0, FIELD_M + 2970.0, 500)
    profile = clean.profile
    assert clean.basis == "thermometer"
    # 50 m layers through an inversion 90 m thick.
    assert profile.temperature(h) == pytest.approx(temperature_k(h), abs=0.2)
    assert profile.pressure(h) == pytest.approx(
        air().pressure_pa(h),
        abs=8.0,
    )
    assert profile.refractivity(h) + 1.0 == pytest.approx(
        air().n(h),
        abs=2.5e-7,
    )
    low_pa, high_pa = profile.vapour_pressure(h[[0, -1]])
    assert low_pa > 800.0 > high_pa
    assert clean.codes() == ["AIR-ANCHOR", "AIR-SENSORS"]
    assert not clean.losses
    layers = profile.layers
    is_measured = np.array(layers.source) == "measured"
    measured_m = np.diff(layers.edge)[is_measured]
    assert measured_m.size > 50
    assert measured_m.max() < 60.0
    # The middle of the flight dates it.
    assert clean.made.time_ns == START_NS + (H.size - 1) * SECOND_NS // 2


def test_it_relaxes_to_the_standard_far_above(clean):
    profile = clean.profile
    standard = clean.made.standard
    top = FIELD_M + 3000.0
    h = top + np.array([0.0, 2500.0, 5000.0, 10_000.0])
    departure_k = profile.temperature(h) - standard.temperature(h)
    assert departure_k[0] > 9.0
    # Ever less of the departure, ever more doubt about it.
    assert np.all(np.diff(departure_k) < 0.0)
    assert departure_k[-1] < 0.1 * departure_k[0]
    sigma = clean.covariance.sigma_temperature(h)
    assert sigma[0] < 0.5
    assert np.all(np.diff(sigma[:3]) > 1.0)
    far = top + 25_000.0
    t = standard.temperature(far)
    p = standard.pressure(far)
    assert profile.temperature(far) == pytest.approx(t, rel=3e-3)
    # Pressure keeps the surplus of the warm air below: it is never forced back.
    assert profile.pressure(far) != pytest.approx(p, rel=1e-3)


@pytest.mark.parametrize(
    ("above_field_m", "source"),
    {
        -500.0: "relaxed",
        60.0: "measured",
        2940.0: "measured",
        3150.0: "relaxed",
        4900.0: "relaxed",
        24_500.0: "standard",
    }.items(),
)
def test_where_each_layer_comes_from(clean, above_field_m, source):
    assert source_at(clean, FIELD_M + above_field_m) == source


def test_where_the_layers_of_a_barometer_come_from(barometric):
    sources = set(barometric.profile.layers.source)
    assert sources == {"barometric", "relaxed", "standard"}


def test_a_gap_in_the_heights_is_not_called_measured():
    outside_gap = H[(H <= 1500.0) | (H >= 2300.0)]
    adjusted = adjust(AirSamples(thermometer(outside_gap), barometer()))
    assert source_at(adjusted, 1200.0) == "measured"
    assert source_at(adjusted, 1900.0) == "barometric"
    assert source_at(adjusted, 2600.0) == "measured"
    inside, beside = adjusted.covariance.sigma_temperature([1900.0, 2600.0])
    assert inside > 1.7 * beside
    alone = adjust(AirSamples(thermometer(outside_gap)))
    assert source_at(alone, 1900.0) == "relaxed"


def test_readings_a_gate_took_out_and_gaps_are_not_used():
    low = FIELD_M + np.array([50.0, 150.0, 250.0])
    soaked = np.arange(H.size) < 60
    middle_s = (60 + H.size - 1) / 2.0
    h = H.copy()
    h[3::97] = np.nan

    def adjusted_temperature(heat_k):
        t = temperature_k(H) + heat_k * soaked
        t[500:520] = np.nan
        gated = sensor(h, t).reject(soaked, Reason.GROUND_SOAK)
        adjusted = adjust(AirSamples(gated, barometer()))
        assert adjusted.made.time_ns == START_NS + middle_s * SECOND_NS
        assert "nan" not in " ".join(message.what for message in adjusted.ledger)
        return adjusted.profile.temperature(low)

    t = adjusted_temperature(heat_k=0.0)
    assert_array_equal(t, adjusted_temperature(heat_k=40.0))
    assert t == pytest.approx(temperature_k(low), abs=0.35)


def test_without_humidity_the_climatology_s_is_taken_and_that_is_said(clean):
    adjusted = adjust(AirSamples(thermometer(), barometer()))
    message = adjusted.entry("AIR-HUMIDITY-EXPECTED", Kind.FALLBACK)
    assert "climatology" in message.what
    assert not adjusted.is_told
    # Of the climatology, within its doubt: 30 % of relative humidity are 570 Pa here.
    measured_pa = clean.profile.vapour_pressure(600.0)
    expected_pa = adjusted.profile.vapour_pressure(600.0)
    assert expected_pa == pytest.approx(measured_pa, abs=570.0)
    doubt = adjusted.covariance.sigma_refractivity(600.0)
    assert doubt > clean.covariance.sigma_refractivity(600.0)


def test_humidity_changes_the_weight_of_the_air_too():
    def thickness(humidity):
        adjusted = adjust(AirSamples(thermometer(), humidity=sensor(H, humidity)))
        low, high = adjusted.profile.pressure([500.0, 3400.0])
        return math.log(low / high)

    arid = thickness(np.full(H.size, 0.015))
    moist = thickness(relative_humidity(H))
    # The same thermometer: virtual temperature differs by the factor 1 - 0.378 e/p.
    way = np.linspace(500.0, 3400.0, 200)
    light = 0.378 * vapour_pressure_pa(way) / air().pressure_pa(way)
    fall = 0.0341632 * trapezoid(light / temperature_k(way), way)
    # The hygrometer's own bias, 3 %, leaves some of the climatology's humidity in arid air.
    assert_allclose(arid - moist, fall, rtol=0.2)


def test_barometer_alone_passes_through_the_pressures(barometric):
    assert barometric.basis == "barometer"
    assert set(barometric.codes(Kind.FALLBACK)) == {
        "AIR-BAROMETRIC",
        "AIR-HUMIDITY-EXPECTED",
    }
    assert barometric.profile.pressure(H) == pytest.approx(
        air().pressure_pa(H),
        abs=30.0,
    )
    assert "over 3000 m" in barometric.reason


@pytest.mark.parametrize("climb", [0.0, 20.0])
def test_a_hop_without_a_thermometer_keeps_the_standard(climb):
    adjusted = adjust(by_barometer(climb))
    assert adjusted.basis == "standard"
    assert adjusted.codes() == ["AIR-STANDARD"]
    h = np.linspace(0.0, 20_000.0, 200)
    # Unscaled: the measured pressure, 10 hPa off the standard's, is not forced on it.
    standard = standard_atmosphere("us1976", latitude=LATITUDE)
    profile = adjusted.profile
    assert_allclose(
        profile.pressure(h),
        standard.pressure(h),
        rtol=1e-12,
    )
    assert_allclose(
        profile.temperature(h),
        standard.temperature(h),
        rtol=1e-12,
    )
    assert f"over {climb:.0f} m" in adjusted.reason
    assert "no information on temperature" in adjusted.reason
    assert adjusted.why_not("barometer barometer")


@pytest.mark.parametrize("climb", [300.0, 1000.0, 2010.0])
def test_a_barometer_is_used_from_the_first_climb_that_has_information(climb):
    """The sigma decides: no height of the climb does."""
    adjusted = adjust(by_barometer(climb))
    assert adjusted.basis == "barometer"
    top_m = FIELD_M + climb
    of_standard = adjust(NO_SENSORS).covariance.relative_sigma(top_m, FIELD_M)
    assert adjusted.covariance.relative_sigma(top_m, FIELD_M) < 0.95 * of_standard


def test_a_short_hop_with_a_thermometer():
    adjusted = adjust(measured(290.0))
    assert adjusted.basis == "barometer"
    assert "spans only 290 m" in adjusted.reason
    assert adjust(measured(310.0)).basis == "thermometer"
    alone = adjust(AirSamples(thermometer(heights_of(290.0))))
    assert alone.codes() == ["AIR-STANDARD"]
    assert "at least 300 m" in alone.reason
    assert "of height are too few" in alone.why_not("thermometer thermometer")


def test_a_log_without_a_barometer():
    adjusted = adjust(AirSamples(thermometer(), humidity=hygrometer()))
    assert adjusted.basis == "thermometer"
    assert "AIR-NO-BAROMETER" in adjusted.codes(Kind.FALLBACK)
    # The standard's pressure at sea level stays.
    assert_allclose(adjusted.profile.pressure(0.0), 101_325.0, rtol=1e-4)


def constant_sensors(h):
    ones = np.ones(h.size)
    return AirSamples(
        sensor(h, 280.0 * ones),
        sensor(h, 9e4 * ones),
        sensor(h, 0.5 * ones),
    )


def gated_sensors():
    sensors = constant_sensors(H).sensors.values()
    return AirSamples(*(each.reject(H > 0.0, Reason.GROUND_SOAK) for each in sensors))


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (NO_SENSORS, "no usable thermometer or barometer"),
        (constant_sensors(np.empty(0)), "spans 0 m of height"),
        (constant_sensors(np.full(H.size, np.nan)), "spans 0 m of height"),
        (gated_sensors(), "spans 0 m of height"),
    ],
    ids=["no sensor", "no samples", "heights unknown", "none accepted"],
)
def test_sensors_that_say_nothing(samples, words):
    adjusted = adjust(samples)
    assert adjusted.basis == "standard"
    assert adjusted.made.time_ns is None
    assert "AIR-STANDARD" in adjusted.codes()
    assert words in adjusted.reason


def test_the_index_formula_and_the_model_of_the_standard_are_kept():
    standard = standard_atmosphere("ardc1959", index="gyer")
    profile = adjust(measured(), standard).profile
    assert profile.index.name == "gyer"
    assert profile.constant == standard.constant
    assert_allclose(profile.gravity.latitude_rad, LATITUDE)


def test_a_pressure_sensor_off_by_a_constant_moves_the_level_only(clean):
    off_pa = air().pressure_pa(H) + 150.0
    off = adjust(with_readings(measured(), off_pa, "pressure"))
    p = clean.profile.pressure(H)
    ratio = off.profile.pressure(H) / p
    # 1.5 hPa are 7e-4 of p more at the top: with a thermometer whose own bias is not known the
    # column may be so much colder.
    assert np.ptp(ratio) < 8e-4
    assert_allclose(ratio.mean(), 1.0 + 150.0 / 82_000.0, rtol=5e-4)


def test_bins_weigh_climb_and_descent_alike():
    """A slow climb through the bin, and a fast way down: 90 readings against 9."""
    up = np.arange(50.0, 200.0, 0.5)
    down = np.arange(200.0, 50.0, -5.0)
    h = np.append(up, down)
    value = np.repeat([280.0, 282.0], [up.size, down.size])
    height, binned = bin_by_height(h, sensor(h, value), 50.0)
    assert_allclose(binned[:2], 281.0, atol=1e-12)
    assert_allclose(height[:2], [75.0, 125.0], atol=2.0)


def test_too_few_readings_make_no_layer():
    h = np.array([10.0, 11.0, 60.0, 61.0, 62.0])
    readings = sensor(h, np.full(5, 280.0))
    height, binned = bin_by_height(h, readings, 50.0)
    assert_allclose(height, [61.0])
    assert binned.tolist() == [280.0]


def test_unadjusted_says_why():
    adjusted = unadjusted(US1976, "the config asks for it")
    assert adjusted.profile is US1976
    assert adjusted.basis == "standard"
    assert adjusted.reason == "the config asks for it"


@pytest.mark.parametrize("share", [0.001, 0.01, 0.03])
def test_spikes_of_pressure_do_not_matter(barometric, share):
    """A barometer alone is the usual autopilot; 300 hPa is inside the range of the possible."""
    spiked = air().pressure_pa(H)
    count = max(2, round(share * H.size))
    spikes = default_rng(2).choice(
        H.size,
        count,
        replace=False,
    )
    spiked[spikes] = 30_000.0
    adjusted = adjust(AirSamples(pressure=sensor(H, spiked)))
    assert adjusted.basis == "barometer"
    error = error_of_r(adjusted)
    assert error == pytest.approx(error_of_r(barometric), abs=0.003)


@pytest.mark.parametrize(
    ("reached", "basis"),
    {
        150.0: "barometer",
        320.0: "both",
        620.0: "both",
        1200.0: "both",
    }.items(),
)
def test_a_thermometer_that_fails_early_does_not_silence_the_barometer(barometric, reached, basis):
    failing = thermometer().reject(FIELD_M + reached < H, Reason.GROUND_SOAK)
    adjusted = adjust(AirSamples(failing, barometer()))
    assert adjusted.basis == basis
    assert "thermometer" in adjusted.reason
    assert "barometer" in adjusted.reason
    if basis == "both":
        assert {"measured", "barometric"} <= set(adjusted.profile.layers.source)
    error = abs(error_of_r(adjusted))
    assert error < min(0.03, 0.01 + abs(error_of_r(barometric)))


def test_the_pressure_of_a_cabin_is_not_the_air_outside():
    cabin_pa = air().pressure_pa(np.minimum(H, FIELD_M + 300.0))
    adjusted = adjust(with_readings(measured(), cabin_pa, "pressure"))
    assert adjusted.losses == ["AIR-NOT-OUTSIDE"]
    assert adjusted.basis == "thermometer"
    assert adjust(AirSamples(pressure=sensor(H, cabin_pa))).basis == "standard"


@pytest.mark.parametrize(
    ("share", "kind", "code"),
    [
        (0.01, Kind.WARNING, "AIR-MISFIT"),
        (0.03, Kind.LOSS, "AIR-IMPLAUSIBLE"),
    ],
)
def test_pressures_that_no_air_has_are_left_out(share, kind, code):
    """Over too little height to say which of the sensors is wrong."""
    samples = measured(900.0)
    p = samples.pressure
    bent = p.value * (1.0 + share * np.sin(p.h_m / 100.0))
    adjusted = adjust(with_readings(samples, bent, "pressure"))
    assert adjusted.basis == "thermometer"
    assert code in adjusted.codes(kind)
    is_left_out = kind is Kind.LOSS
    assert ("without barometer" in adjusted.reason) is is_left_out
    assert abs(error_of_r(adjusted, 900.0)) < 0.03


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (1.0, Kind.NOTE),
        (1.07, Kind.WARNING),
        (1.2, Kind.LOSS),
    ],
)
def test_a_level_of_pressure_that_is_no_weather_is_told_of(factor, kind):
    samples = measured(900.0)
    adjusted = adjust(
        with_readings(
            samples,
            factor * samples.pressure.value,
            "pressure",
        )
    )
    adjusted.entry("AIR-ANCHOR", kind)


def test_wild_heights_crash_nothing():
    t = temperature_k(H)
    p = air().pressure_pa(H)
    wild = H.copy()
    wild[::97] = 59_000.0
    samples = AirSamples(sensor(wild, t), sensor(wild, p))
    assert np.isfinite(adjust(samples).profile.refractivity(1000.0))
    far = AirSamples(pressure=sensor(H + 90_000.0, p))
    assert adjust(far).basis == "standard"
