"""What the adjustment does with good, bad and missing sensors, in an air known by construction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples, bin_by_height
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile, unadjusted
from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.messages import Kind, Ledger
from unbend.simulate.true_air import (
    TrueAir,
    relative_humidity,
    temperature_k,
    true_air,
    vapour_pressure_pa,
)

LATITUDE = math.radians(47.4)
FIELD_M = 450.0
US1976 = standard_atmosphere("us1976")


@pytest.fixture(scope="module")
def air() -> TrueAir:
    """An inversion and humidity; integrated with WGS84 gravity, apart from the estimator."""
    return true_air(LATITUDE)


def flight(climb: float, rate: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Times [ns] and heights [m] of a climb and a descent, once a second."""
    up = FIELD_M + np.arange(0.0, climb + 0.1, rate)
    h = np.concatenate([up, up[::-1]])
    return (1_600_000_000 + np.arange(h.size)).astype(np.int64) * 10**9, h


def samples(time_ns, h, value, name="sensor", accepted=None) -> SensorSamples:
    used = np.ones(h.size, bool) if accepted is None else accepted
    rejected = reasons_where(~used, Reason.GROUND_SOAK)
    return SensorSamples(time_ns, h, np.asarray(value, float), rejected, name)


def measured(air: TrueAir, climb: float, *, t=True, p=True, rh=True, **change) -> AirSamples:
    """Clean readings of a flight; ``change`` replaces values of temperature, pressure, humidity."""
    time_ns, h = flight(climb)
    values = {
        "temperature": temperature_k(h) if t else None,
        "pressure": air.pressure_pa(h) if p else None,
        "humidity": relative_humidity(h) if rh else None,
    } | change
    return AirSamples(
        **{name: None if v is None else samples(time_ns, h, v, name) for name, v in values.items()}
    )


EXACT = SensorSettings(calibration={SensorFault.PRESSURE_SCALE: SensorCalibration(sigma=1e-5)})
"""These readings are clean: their static pressure loses nothing of its change."""


def adjust(air_samples: AirSamples, standard=US1976):
    ledger = Ledger()
    pressure = air_samples.pressure
    settings = EXACT if pressure is not None and pressure.extent_m > 100.0 else None
    found = build_adjusted_profile(air_samples, standard, LATITUDE, ledger, settings=settings)
    return found, ledger


def codes(ledger: Ledger, kind: Kind | None = None) -> list[str]:
    return [entry.code for entry in ledger if kind is None or entry.kind is kind]


def test_the_profile_is_the_air_that_was_measured(air):
    adjusted, ledger = adjust(measured(air, 3000.0))
    h = np.linspace(FIELD_M + 30.0, FIELD_M + 2970.0, 500)
    assert adjusted.basis == "thermometer"
    # 50 m layers through an inversion 90 m thick.
    assert np.abs(adjusted.profile.temperature(h) - temperature_k(h)).max() < 0.2
    assert np.abs(adjusted.profile.pressure(h) - air.pressure_pa(h)).max() < 8.0
    e = adjusted.profile.vapour_pressure(h)
    assert np.abs(adjusted.profile.refractivity(h) + 1.0 - air.n(h)).max() < 2.5e-7
    assert e[0] > 800.0 > e[-1]
    assert codes(ledger) == ["AIR-ANCHOR", "AIR-SENSORS"]
    assert not ledger.has_losses


def test_it_relaxes_to_the_standard_far_above(air):
    adjusted, _ = adjust(measured(air, 3000.0))
    standard = adjusted.standard
    profile = adjusted.profile
    top = FIELD_M + 3000.0
    away = np.array([0.0, 2500.0, 5000.0, 10_000.0])
    left = profile.temperature(top + away) - standard.temperature(top + away)
    assert left[0] > 9.0
    # Ever less of the departure, ever more doubt about it.
    assert np.all(np.diff(left) < 0.0)
    assert left[-1] < 0.1 * left[0]
    sigma = adjusted.covariance.sigma_temperature(top + away)
    assert sigma[0] < 0.5
    assert np.all(np.diff(sigma[:3]) > 1.0)
    far = top + 25_000.0
    assert profile.temperature(far).item() == pytest.approx(standard.temperature(far).item(), 3e-3)
    # Pressure keeps the surplus of the warm air below: it is never forced back.
    assert profile.pressure(far).item() != pytest.approx(standard.pressure(far).item(), rel=1e-3)


def test_where_each_layer_comes_from(air):
    adjusted, _ = adjust(measured(air, 3000.0))
    layers = adjusted.profile.layers
    gravity = adjusted.profile.gravity
    low, high = (float(gravity.geopotential_height(FIELD_M + d)) for d in (25.0, 2975.0))
    for lower, upper, source in zip(layers.edge[:-1], layers.edge[1:], layers.source, strict=True):
        if lower >= low and upper <= high:
            assert source == "measured"
        elif lower > high + 20_001.0:
            assert source == "standard"
        elif high + 60.0 < lower < high + 2000.0 or low - 500.0 < lower < low - 110.0:
            assert source == "relaxed"
    assert set(adjust(measured(air, 4000.0, t=False))[0].profile.layers.source) == {
        "barometric",
        "relaxed",
        "standard",
    }


def test_a_gap_in_the_heights_is_not_called_measured(air):
    time_ns, h = flight(3000.0)
    gap = (h > 1500.0) & (h < 2300.0)
    given = AirSamples(
        samples(time_ns[~gap], h[~gap], temperature_k(h[~gap])),
        samples(time_ns, h, air.pressure_pa(h)),
    )
    adjusted = adjust(given)[0]
    profile = adjusted.profile
    i = int(profile.layer_of(1900.0))
    assert profile.layers.source[i] == "barometric"
    alone = adjust(AirSamples(given.temperature))[0].profile
    assert alone.layers.source[int(alone.layer_of(1900.0))] == "relaxed"
    inside, beside = adjusted.covariance.sigma_temperature([1900.0, 2600.0])
    assert inside > 1.7 * beside
    assert profile.layers.source[int(profile.layer_of(1200.0))] == "measured"
    assert profile.layers.source[int(profile.layer_of(2600.0))] == "measured"


def test_lag_of_climb_and_descent_cancels(air):
    time_ns, h = flight(3000.0)
    # A sensor 20 s late at 5 m/s feels the air 100 m behind: lower in the climb, higher after.
    half = h.size // 2
    behind = np.where(np.arange(h.size) < half, h - 100.0, h + 100.0)
    both = adjust(measured(air, 3000.0, temperature=temperature_k(behind)))[0].profile
    climb_only = AirSamples(
        samples(time_ns[:half], h[:half], temperature_k(behind[:half])),
        samples(time_ns, h, air.pressure_pa(h)),
    )
    one = adjust(climb_only)[0].profile
    # Away from the inversion, where the lapse rate is constant, the lag cancels.
    quiet = np.concatenate([np.arange(600.0, 1050.0, 25.0), np.arange(1700.0, 3300.0, 25.0)])
    truth = temperature_k(quiet)
    assert np.abs(both.temperature(quiet) - truth).max() < 0.2
    # The climb alone reads 0.65 K too warm; the barometer, and level flight, tell.
    assert np.median(np.abs(one.temperature(quiet) - truth)) < 0.4


def test_outliers_do_not_matter(air):
    rng = np.random.default_rng(12)
    _, h = flight(3000.0)
    noisy = temperature_k(h) + rng.normal(0.0, 0.2, h.size)
    clean = adjust(measured(air, 3000.0, temperature=noisy))[0].profile
    bad = noisy.copy()
    bad[rng.random(h.size) < 0.03] += 15.0
    assert (bad != noisy).sum() > 20
    dirty = adjust(measured(air, 3000.0, temperature=bad))[0].profile
    inside = np.linspace(500.0, 3400.0, 300)
    assert np.abs(dirty.temperature(inside) - clean.temperature(inside)).max() < 0.25
    ratio = (dirty.refractivity(500.0) - dirty.refractivity(3400.0)) / (
        clean.refractivity(500.0) - clean.refractivity(3400.0)
    )
    assert abs(float(ratio) - 1.0) < 5e-4


def test_readings_a_gate_took_out_and_gaps_are_not_used(air):
    time_ns, h = flight(3000.0)
    soaked = time_ns < time_ns[0] + 60 * 10**9
    pressure = samples(time_ns, h, air.pressure_pa(h))
    found = []
    for heat in (0.0, 12.0, 40.0):
        t = np.where(soaked, temperature_k(h) + heat, temperature_k(h))
        t[500:520] = np.nan
        warm = samples(time_ns, h, t, accepted=~soaked)
        found.append(adjust(AirSamples(warm, pressure))[0].profile)
    low = FIELD_M + np.array([50.0, 150.0, 250.0])
    for gated in found:
        np.testing.assert_array_equal(gated.temperature(low), found[0].temperature(low))
        assert np.abs(gated.temperature(low) - temperature_k(low)).max() < 0.35


def test_without_humidity_the_climatology_s_is_taken_and_that_is_said(air):
    adjusted, ledger = adjust(measured(air, 3000.0, rh=False))
    assert "AIR-HUMIDITY-EXPECTED" in codes(ledger, Kind.FALLBACK)
    assert not ledger.has_losses
    assert "climatology" in next(e.what for e in ledger if e.code == "AIR-HUMIDITY-EXPECTED")
    # Of the climatology, within its doubt: 30 % of relative humidity are 570 Pa here.
    moist = adjust(measured(air, 3000.0))[0]
    e = adjusted.profile.vapour_pressure(600.0)
    assert abs(float(e - moist.profile.vapour_pressure(600.0))) < 570.0
    doubt = [a.covariance.sigma_refractivity(600.0).item() for a in (adjusted, moist)]
    assert doubt[0] > doubt[1]


def test_humidity_changes_the_weight_of_the_air_too(air):
    _, h = flight(3000.0)
    arid = adjust(measured(air, 3000.0, p=False, humidity=0.0 * h + 0.015))[0].profile
    moist = adjust(measured(air, 3000.0, p=False))[0].profile
    thickness = [math.log(float(p.pressure(500.0) / p.pressure(3400.0))) for p in (arid, moist)]
    # The same thermometer: virtual temperature differs by the factor 1 - 0.378 e/p.
    way = np.linspace(500.0, 3400.0, 200)
    light = 0.378 * vapour_pressure_pa(way) / air.pressure_pa(way) / temperature_k(way)
    truth = 0.0341632 * trapezoid(light, way)
    # The hygrometer's own bias, 3 %, leaves some of the climatology's humidity in arid air.
    assert thickness[0] - thickness[1] == pytest.approx(truth, rel=0.2)


def test_barometer_alone_passes_through_the_pressures(air):
    adjusted, ledger = adjust(measured(air, 3000.0, t=False, rh=False))
    assert adjusted.basis == "barometer"
    assert set(codes(ledger, Kind.FALLBACK)) == {"AIR-BAROMETRIC", "AIR-HUMIDITY-EXPECTED"}
    _, h = flight(3000.0)
    residual = (air.pressure_pa(h) - adjusted.profile.pressure(h)) / 100.0
    assert np.abs(residual).max() < 0.3  # hPa
    assert "over 3000 m" in adjusted.reason


@pytest.mark.parametrize("climb", [0.0, 20.0])
def test_a_hop_without_a_thermometer_keeps_the_standard(air, climb):
    adjusted, ledger = adjust(measured(air, climb, t=False, rh=False))
    assert adjusted.basis == "standard"
    assert codes(ledger) == ["AIR-STANDARD"]
    h = np.linspace(0.0, 20_000.0, 200)
    # Unscaled: the measured pressure, 10 hPa off the standard's, is not forced on it.
    own = standard_atmosphere("us1976", latitude=LATITUDE)
    np.testing.assert_allclose(adjusted.profile.pressure(h), own.pressure(h), rtol=1e-12)
    np.testing.assert_allclose(adjusted.profile.temperature(h), own.temperature(h), rtol=1e-12)
    assert f"over {climb:.0f} m" in adjusted.reason
    assert "no information on temperature" in adjusted.reason
    (use,) = [use for use in adjusted.sources if use.source.startswith("barometer")]
    assert use.why_not


@pytest.mark.parametrize("climb", [300.0, 1000.0, 2010.0])
def test_a_barometer_is_used_from_the_first_climb_that_has_information(air, climb):
    """The sigma decides: no height of the climb does."""
    adjusted, ledger = adjust(measured(air, climb, t=False, rh=False))
    assert adjusted.basis == "barometer"
    assert set(codes(ledger, Kind.FALLBACK)) == {"AIR-BAROMETRIC", "AIR-HUMIDITY-EXPECTED"}
    kept, _ = adjust(AirSamples())
    ground = float(adjusted.samples.pressure.h_m.min())
    sigmas = [a.covariance.relative_sigma(ground + climb, ground) for a in (adjusted, kept)]
    assert sigmas[0] < 0.95 * sigmas[1]


def test_a_short_hop_with_a_thermometer(air):
    adjusted, ledger = adjust(measured(air, 290.0))
    assert adjusted.basis == "barometer"
    assert "spans only 290 m" in adjusted.reason
    assert adjust(measured(air, 310.0))[0].basis == "thermometer"
    alone, ledger = adjust(measured(air, 290.0, p=False))
    assert alone.basis == "standard"
    assert "at least 300 m" in alone.reason
    assert "AIR-STANDARD" in codes(ledger)


def test_a_short_thermometer_leaves_a_long_barometer_its_say(air):
    time_ns, h = flight(3000.0)
    early = h < 600.0
    given = AirSamples(
        samples(time_ns[early], h[early], temperature_k(h[early])),
        samples(time_ns, h, air.pressure_pa(h)),
    )
    assert adjust(given)[0].basis == "barometer"


def test_a_log_without_a_barometer(air):
    adjusted, ledger = adjust(measured(air, 3000.0, p=False))
    assert adjusted.basis == "thermometer"
    assert "AIR-NO-BAROMETER" in codes(ledger, Kind.FALLBACK)
    # The standard's pressure at sea level stays.
    assert float(adjusted.profile.pressure(0.0)) == pytest.approx(101_325.0, rel=1e-4)


def test_a_log_without_any_sensor():
    adjusted, ledger = adjust(AirSamples())
    assert (adjusted.basis, adjusted.time_ns) == ("standard", None)
    assert codes(ledger) == ["AIR-STANDARD"]
    assert "no usable thermometer or barometer" in adjusted.reason


@pytest.mark.parametrize("empty", ["none accepted", "no samples", "heights unknown"])
def test_sensors_that_say_nothing(air, empty):
    time_ns, h = flight(3000.0)
    used = np.ones(h.size, bool)
    if empty == "none accepted":
        used[:] = False
    elif empty == "no samples":
        time_ns = time_ns[:0]
        h = h[:0]
        used = used[:0]
    else:
        h, used = np.full(h.size, np.nan), np.zeros(h.size, bool)
    t = np.full(h.size, 280.0)
    given = AirSamples(
        samples(time_ns, h, t, accepted=used),
        samples(time_ns, h, 9e4 + 0.0 * t, accepted=used),
        samples(time_ns, h, 0.5 + 0.0 * t, accepted=used),
    )
    adjusted, ledger = adjust(given)
    assert adjusted.basis == "standard"
    assert "AIR-STANDARD" in codes(ledger)


def test_the_index_formula_and_the_model_of_the_standard_are_kept(air):
    standard = standard_atmosphere("ardc1959", index="gyer")
    profile = adjust(measured(air, 3000.0), standard)[0].profile
    assert profile.index.name == "gyer"
    assert profile.constant == standard.constant
    assert profile.gravity.latitude_rad == pytest.approx(LATITUDE)


def test_a_pressure_sensor_off_by_a_constant_moves_the_level_only(air):
    _, h = flight(3000.0)
    off = adjust(measured(air, 3000.0, pressure=air.pressure_pa(h) + 150.0))[0].profile
    right = adjust(measured(air, 3000.0))[0].profile
    ratio = off.pressure(h) / right.pressure(h)
    # 1.5 hPa are 7e-4 of p more at the top: with a thermometer whose own bias is not known the
    # column may be so much colder.
    assert np.ptp(ratio) < 8e-4
    assert float(ratio.mean()) == pytest.approx(1.0 + 150.0 / 82_000.0, rel=5e-4)


def test_bins_weigh_climb_and_descent_alike():
    # A slow climb through the bin, and a fast way down: 90 readings against 9.
    h = np.concatenate([np.arange(50.0, 200.0, 0.5), np.arange(200.0, 50.0, -5.0)])
    time_ns = np.arange(h.size, dtype=np.int64) * 10**9
    value = np.where(np.arange(h.size) < 300, 280.0, 282.0)
    height, binned = bin_by_height(h, samples(time_ns, h, value), 50.0)
    np.testing.assert_allclose(binned[:2], 281.0, atol=1e-12)
    np.testing.assert_allclose(height[:2], [75.0, 125.0], atol=2.0)


def test_too_few_readings_make_no_layer():
    h = np.array([10.0, 11.0, 60.0, 61.0, 62.0])
    time_ns = np.arange(5, dtype=np.int64) * 10**9
    height, binned = bin_by_height(h, samples(time_ns, h, np.full(5, 280.0)), 50.0)
    np.testing.assert_allclose(height, [61.0])
    assert binned.tolist() == [280.0]


def test_readings_that_are_no_numbers_are_never_used(air):
    time_ns, h = flight(3000.0)
    p = air.pressure_pa(h)
    p[::7] = np.nan
    holes = h.copy()
    holes[3::11] = np.nan
    given = AirSamples(None, samples(time_ns, holes, p), None)
    assert not given.pressure.accepted[0]
    adjusted, ledger = adjust(given)
    assert adjusted.basis == "barometer"
    assert "nan" not in " ".join(entry.what for entry in ledger)
    known = np.isfinite(p)
    residual = p[known] - adjusted.profile.pressure(h[known])
    assert np.abs(residual).max() < 30.0


def test_unadjusted_says_why():
    adjusted = unadjusted(US1976, "the config asks for it")
    assert adjusted.profile is US1976
    assert (adjusted.basis, adjusted.reason) == ("standard", "the config asks for it")


def test_the_middle_of_the_flight_dates_the_profile(air):
    time_ns, _ = flight(3000.0)
    adjusted, _ = adjust(measured(air, 3000.0))
    assert adjusted.time_ns == int(time_ns[0]) + (int(time_ns[-1]) - int(time_ns[0])) // 2


def refraction_error(air, profile, climb: float) -> float:
    """Relative error of R at 45 degrees, from the field to the top of the climb."""
    from unbend.atmosphere import profile_from_table
    from unbend.geodesy import lambert_gravity
    from unbend.refraction import refraction_angle

    h = np.arange(FIELD_M - 100.0, FIELD_M + climb + 200.0, 10.0)
    true = profile_from_table(
        h,
        temperature_k(h),
        air.pressure_pa(h),
        relative_humidity(h) * 0.0,
        gravity=lambert_gravity(LATITUDE),
    )
    place = (FIELD_M + climb, FIELD_M, math.radians(45.0))
    return refraction_angle(profile, *place) / refraction_angle(true, *place) - 1.0


@pytest.mark.parametrize("share", [0.001, 0.01, 0.03])
def test_spikes_of_pressure_do_not_matter(air, share):
    """A barometer alone is the usual autopilot; 300 hPa is inside the range of the possible."""
    _, h = flight(3000.0)
    pressure = air.pressure_pa(h)
    spiked = pressure.copy()
    count = max(2, round(share * h.size))
    spiked[np.random.default_rng(2).choice(h.size, count, replace=False)] = 30_000.0
    clean, _ = adjust(measured(air, 3000.0, t=False, rh=False))
    adjusted, _ = adjust(measured(air, 3000.0, t=False, rh=False, pressure=spiked))
    assert adjusted.basis == "barometer"
    difference = refraction_error(air, adjusted.profile, 3000.0) - refraction_error(
        air, clean.profile, 3000.0
    )
    assert abs(difference) < 0.003


@pytest.mark.parametrize("reached", [320.0, 620.0, 1200.0])
def test_a_thermometer_that_fails_early_does_not_silence_the_barometer(air, reached):
    time_ns, h = flight(3000.0)
    short = measured(air, 3000.0, rh=False)
    accepted = h < FIELD_M + reached
    temperature = samples(time_ns, h, temperature_k(h), "thermometer", accepted)
    both, _ = adjust(AirSamples(temperature, short.pressure))
    alone, _ = adjust(measured(air, 3000.0, t=False, rh=False))
    assert both.basis == "both"
    assert "thermometer" in both.reason
    assert "pressure" in both.reason
    assert {"measured", "barometric"} <= set(both.profile.layers.source)
    assert abs(refraction_error(air, both.profile, 3000.0)) < 0.03
    assert abs(refraction_error(air, both.profile, 3000.0)) < 0.01 + abs(
        refraction_error(air, alone.profile, 3000.0)
    )


def test_the_pressure_of_a_cabin_is_not_the_air_outside(air):
    _, h = flight(3000.0)
    held = air.pressure_pa(np.minimum(h, FIELD_M + 300.0))
    adjusted, ledger = adjust(measured(air, 3000.0, pressure=held))
    assert "AIR-NOT-OUTSIDE" in codes(ledger, Kind.LOSS)
    assert adjusted.basis == "thermometer"
    alone, _ = adjust(measured(air, 3000.0, t=False, pressure=held))
    assert alone.basis == "standard"


def test_a_thermometer_indoors_is_not_the_air_outside(air):
    _, h = flight(3000.0)
    room = 294.0 + 0.2 * np.random.default_rng(1).normal(size=h.size)
    adjusted, ledger = adjust(measured(air, 3000.0, temperature=room))
    assert "AIR-THERMOMETER" in codes(ledger, Kind.LOSS)
    assert adjusted.basis == "barometer"
    warmed, ledger = adjust(measured(air, 3000.0, temperature=temperature_k(h) + 3.0))
    assert warmed.basis == "thermometer"
    assert not ledger.has_losses


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_pressures_that_no_air_has_are_left_out(air, share):
    _, h = flight(900.0)  # too little height to say which of them is wrong
    bent = air.pressure_pa(h) * (1.0 + share * np.sin(h / 100.0))
    adjusted, ledger = adjust(measured(air, 900.0, pressure=bent))
    assert adjusted.basis == "thermometer"
    if share > 0.02:
        assert [e.code for e in ledger if e.kind is Kind.LOSS] == ["AIR-IMPLAUSIBLE"]
        assert "without pressure" in adjusted.reason
    else:
        assert "AIR-MISFIT" in codes(ledger, Kind.WARNING)
    assert abs(refraction_error(air, adjusted.profile, 900.0)) < 0.03


@pytest.mark.parametrize(
    ("factor", "kind"), [(1.0, Kind.NOTE), (1.07, Kind.WARNING), (1.2, Kind.LOSS)]
)
def test_a_level_of_pressure_that_is_no_weather_is_told_of(air, factor, kind):
    _, h = flight(900.0)
    _, ledger = adjust(measured(air, 900.0, pressure=factor * air.pressure_pa(h)))
    assert [e.kind for e in ledger if e.code == "AIR-ANCHOR"] == [kind]


def test_wild_heights_crash_nothing(air):
    time_ns, h = flight(3000.0)
    wild = h.copy()
    wild[::97] = 59_000.0
    air_samples = AirSamples(
        samples(time_ns, wild, temperature_k(h)), samples(time_ns, wild, air.pressure_pa(h))
    )
    adjusted, _ = adjust(air_samples)
    assert np.isfinite(adjusted.profile.refractivity(1000.0))
    far = AirSamples(pressure=samples(time_ns, h + 90_000.0, air.pressure_pa(h)))
    assert adjust(far)[0].basis == "standard"
