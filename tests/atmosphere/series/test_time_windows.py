"""Hours of flight through air that changes: windows, profiles between them, and their sigmas.

The true air is two real soundings that blend in time, integrated anew at each time (`flights`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.atmosphere.series.ageing import sample_ages
from unbend.atmosphere.series.profile_series import (
    TimedProfile,
    add_ageing,
    constant_series,
    interpolate_profiles,
    interpolate_series,
)
from unbend.atmosphere.series.time_windows import (
    _whole_flight_as_background,
    estimate_windows,
    part_of_flight,
    time_windows,
)
from unbend.messages import Ledger

US1976 = standard_atmosphere("us1976")
CLIMB = 3000.0
HOURS = 4.0
SECOND = 1_000_000_000


def between(flights, a, b, share):
    """A balloon between two of one site: T, ln e and the lowest pressure linear in time."""
    H = np.arange(max(a.H[0], b.H[0]), min(a.H[-1], b.H[-1], 12_000.0), 10.0)
    t = [np.interp(H, one.H, one.t) for one in (a, b)]
    e = [np.interp(H, one.H, np.log(one.e)) for one in (a, b)]
    return flights.Balloon(
        "between",
        a.latitude,
        H,
        (1.0 - share) * t[0] + share * t[1],
        np.exp((1.0 - share) * e[0] + share * e[1]),
        (1.0 - share) * a.p0 + share * b.p0,
        a.month,
    )


class Day:
    """The air between two soundings over four hours, known at nine times."""

    def __init__(self, flights, a, b) -> None:
        shares = np.linspace(0.0, 1.0, 9)
        self.truths = [flights.Truth(between(flights, a, b, s), reach=4000.0) for s in shares]
        self.start_ns = self.truths[0].start_ns
        self.ground = self.truths[0].h[0]
        self.times = self.start_ns + (shares * HOURS * 3600.0 * SECOND).astype(np.int64)

    def at(self, name: str, seconds: np.ndarray, above: np.ndarray) -> np.ndarray:
        u = np.clip(seconds / (HOURS * 3600.0), 0.0, 1.0) * 8.0
        i = np.minimum(u.astype(int), 7)
        values = np.array([truth.at(getattr(truth, name), above) for truth in self.truths])
        if name == "p":
            values = np.log(values)
        rows = np.arange(seconds.size)
        mixed = values[i, rows] + (u - i) * (values[i + 1, rows] - values[i, rows])
        return np.exp(mixed) if name == "p" else mixed

    def errors(self, profiles) -> np.ndarray:
        """Errors of R in per cent at the nine times."""
        pairs = zip(self.truths, profiles, strict=True)
        return np.array([100.0 * truth.error(profile, CLIMB) for truth, profile in pairs])


def legs(seconds: np.ndarray) -> np.ndarray:
    """Heights above ground: up to 3 km and down to 300 m, once in forty minutes."""
    up = CLIMB / 5.0
    phase = np.mod(seconds - 30.0, 2400.0)
    way = np.interp(phase, [0.0, up, 2400.0 - up, 2400.0], [300.0, CLIMB, CLIMB, 300.0])
    return np.where(seconds < 30.0 + up, np.interp(seconds, [30.0, 30.0 + up], [0.0, CLIMB]), way)


def fly(flights, day: Day, sensors, rng, hz: float = 0.5) -> AirSamples:
    """What sensors with the faults of `flights` measure on this day."""
    s = sensors
    seconds = np.arange(0.0, HOURS * 3600.0, 1.0 / hz)
    above = legs(seconds)
    n = seconds.size
    t = day.at("t", seconds, above) + s.bias_k
    t += s.transient_k * np.exp(-np.maximum(seconds - 30.0, 0.0) / s.transient_s)
    t += rng.normal(0.0, 1.0, n) * s.noise_k + s.drift_k * flights.walk(rng, seconds, 600.0)
    t += np.where(rng.random(n) < s.outliers, s.outlier_k, 0.0)
    p = day.at("p", seconds, above) + s.pressure_offset_pa
    p += s.pressure_drift_pa * flights.walk(rng, seconds, 1200.0)
    h = day.ground + above + s.gnss_offset_m + s.gnss_drift_m * flights.walk(rng, seconds, 900.0)
    rh = day.at("rh", seconds, above) + s.humidity_bias
    rh += rng.normal(0.0, 1.0, n) * s.humidity_noise
    time_ns = day.start_ns + np.round(seconds * SECOND).astype(np.int64)
    flown = reasons_where(seconds <= 90.0, Reason.GROUND_SOAK)
    every = np.zeros(n, np.uint8)
    return AirSamples(
        SensorSamples(time_ns, h, t, flown, "thermometer"),
        SensorSamples(time_ns, h, p, every, "barometer"),
        SensorSamples(time_ns, h, rh, flown, "hygrometer"),
    )


@pytest.fixture(scope="module")
def soundings(flights):
    """Two mornings of Norman, Oklahoma, twelve Mays apart: R differs by 13 % over 3 km."""
    found = [balloon for balloon in flights.balloons() if "OUN" in balloon.name]
    assert len(found) == 2
    return found


@pytest.fixture(scope="module")
def changing(flights, soundings):
    return flown(flights, Day(flights, *soundings), 3)


def flown(flights, day, seed):
    """A day, the air of the whole flight, its windows, and the ledger."""
    sensors = replace(flights.REALISTIC, drift_k=0.2)
    samples = fly(flights, day, sensors, np.random.default_rng(seed))
    ledger = Ledger()
    whole = build_adjusted_profile(samples, US1976, day.truths[0].latitude, ledger)
    windows = ledger.take(estimate_windows(whole, [day.ground + CLIMB], day.ground))
    return day, whole, windows, ledger


def along(day, windows):
    return interpolate_series([w.air for w in windows], day.times, [day.ground + CLIMB], day.ground)


def test_air_that_changes_is_followed(changing):
    """One profile errs by up to 6 % at the ends of the flight; measured along it: 1.5 and 0.6 %."""
    day, whole, windows, ledger = changing
    standing = day.errors([whole.profile] * 9)
    assert np.abs(standing).max() > 4.0
    assert len(windows) >= 5
    air = along(day, windows)
    errors = day.errors([air.timed_profiles[i].profile for i in air.profile_number])
    assert np.abs(errors).max() < 2.5
    assert np.sqrt(np.mean(errors**2)) < 1.2
    assert [entry.code for entry in ledger].count("AIR-WINDOWS") == 1


def test_sigmas_along_the_flight_are_honest(changing):
    day, _, windows, _ = changing
    air = along(day, windows)
    sigma = [
        100.0 * air.timed_profiles[i].covariance.relative_sigma(day.ground + CLIMB, day.ground)
        for i in air.profile_number
    ]
    errors = day.errors([air.timed_profiles[i].profile for i in air.profile_number]) / sigma
    assert np.mean(np.abs(errors) < 1.0) >= 0.5
    assert np.abs(errors).max() < 3.0
    assert 0.3 < min(sigma) <= max(sigma) < 2.0


def test_air_that_stands_still_needs_one_profile(flights, soundings):
    """... so that a flight in it is corrected as if nobody had looked."""
    day = Day(flights, soundings[0], soundings[0])
    _, whole, windows, ledger = flown(flights, day, 1)
    assert windows == ()
    (entry,) = [entry for entry in ledger if entry.code == "AIR-WINDOWS"]
    assert entry.what.startswith("one profile for 4.0 h")
    assert np.abs(day.errors([whole.profile] * 9)).max() < 1.0


def test_a_window_counts_its_readings_once(changing):
    """They are in its background too: the covariance of the estimate alone would be too small."""
    _, whole, windows, _ = changing
    window = windows[2]
    part = part_of_flight(whole.samples, window.start_ns, window.end_ns)
    hours = (windows[-1].end_ns - windows[0].start_ns) / 3.6e12
    known = [replace(f, sigma=np.hypot(f.sigma, 0.2 * f.prior_sigma)) for f in whole.faults]
    background = _whole_flight_as_background(whole.covariance, whole.moisture.spread, hours)
    once = estimate(part, background, settings=whole.settings, known=known).covariance
    h = np.linspace(500.0, 6000.0, 12)
    for of in ("sigma_temperature", "sigma_log_pressure", "sigma_refractivity"):
        ratio = getattr(window.air.covariance, of)(h) / getattr(once, of)(h)
        np.testing.assert_allclose(ratio, np.sqrt(2.0), rtol=1e-6)


def test_a_window_uses_what_is_known_of_the_sensors(changing):
    """A thermometer that may drift by 5 K in a quarter of an hour says less in each window."""
    _, whole, windows, _ = changing
    drifting = SensorSettings(
        calibration={SensorFault.THERMOMETER_DRIFT: SensorCalibration(sigma=5.0)}
    )
    h_c = float(whole.samples.temperature.h_m.max())
    h_g = 400.0
    others, _ = estimate_windows(replace(whole, settings=drifting), [h_c], h_g)
    for window, other in zip(windows, others, strict=True):
        if not (window.why_not or other.why_not):
            sigmas = [w.air.covariance.sigma_temperature([2000.0]).item() for w in (window, other)]
            assert sigmas[1] > 1.1 * sigmas[0]
    assert any(not other.why_not for other in others)


def test_a_window_that_falls_back_is_less_certain(changing):
    """... by what the air changes in four hours, and the ledger says when, in this century."""
    day, whole, _, _ = changing
    samples = whole.samples
    third = day.start_ns + 7200 * SECOND
    t = samples.temperature
    spoilt = (t.time_ns > third - 1800 * SECOND) & (t.time_ns < third + 900 * SECOND)
    noise = 15.0 * np.random.default_rng(5).normal(size=t.value.size // 20 + 1).repeat(20)
    wild = replace(t, value=t.value + np.where(spoilt, noise[: t.value.size], 0.0))
    ledger = Ledger()
    air = replace(whole, samples=replace(samples, temperature=wild))
    windows = ledger.take(estimate_windows(air, [day.ground + CLIMB], day.ground))
    fallen = [w for w in windows if w.why_not]
    assert fallen
    assert len(fallen) < len(windows)
    of_whole = whole.covariance.relative_sigma(day.ground + CLIMB, day.ground)
    for w in fallen:
        true = day.truths[round((w.air.time_ns - day.start_ns) / SECOND / 1800.0)]
        sigma = w.air.covariance.relative_sigma(day.ground + CLIMB, day.ground)
        assert abs(true.error(w.air.profile, CLIMB)) < 2.0 * sigma
        assert sigma > 3.0 * of_whole
    told = [e.what for e in ledger if e.code == "AIR-WINDOW"]
    assert len(told) == len(fallen)
    assert all(what.startswith("the air of the whole flight is used about 2020-") for what in told)
    # What a window is compared with is the whole flight; no climatology was asked.
    held_out = [what for what in told if "were not used in the estimate" in what]
    assert held_out
    assert all(what.endswith("K from the whole flight") for what in held_out)
    assert not any("climatology" in what for what in told)


# ---- air that was sampled long ago


class Level:
    """A climb to 3 km, hours of level flight, and no descent, while the ground warms by 4 K."""

    HOURS = 3.0

    def __init__(self, flights, balloon) -> None:
        H = np.arange(balloon.H[0], min(balloon.H[-1], 12_000.0), 10.0)
        t = np.interp(H, balloon.H, balloon.t)
        e = np.interp(H, balloon.H, np.log(balloon.e))
        warm = 4.0 * np.exp(-(H - H[0]) / 1500.0)
        self.truths = [
            flights.Truth(replace(balloon, H=H, t=t + share * warm, e=np.exp(e)), reach=4000.0)
            for share in np.linspace(0.0, 1.0, 7)
        ]
        self.ground, self.start_ns = self.truths[0].h[0], self.truths[0].start_ns
        self.latitude = balloon.latitude

    def times(self) -> np.ndarray:
        return self.start_ns + (np.linspace(0.0, self.HOURS, 7) * 3.6e12).astype(np.int64)

    def fly(self, rng) -> AirSamples:
        seconds = np.arange(0.0, self.HOURS * 3600.0, 2.0)
        above = np.interp(seconds, [30.0, 630.0], [0.0, CLIMB])
        u = seconds / (self.HOURS * 3600.0) * 6.0
        i = np.minimum(u.astype(int), 5)
        rows = np.arange(seconds.size)
        t, p = (
            np.array([truth.at(getattr(truth, name), above) for truth in self.truths])
            for name in ("t", "p")
        )
        t, p = (v[i, rows] + (u - i) * (v[i + 1, rows] - v[i, rows]) for v in (t, p))
        stamps = self.start_ns + (seconds * 1e9).astype(np.int64)
        h = self.ground + above
        t = t + rng.normal(0.0, 0.2, t.size)
        p = p + rng.normal(0.0, 5.0, p.size)
        return AirSamples(
            SensorSamples(
                stamps, h, t, reasons_where(seconds <= 150.0, Reason.GROUND_SOAK), "thermometer"
            ),
            SensorSamples(stamps, h, p, np.zeros(p.size, np.uint8), "barometer"),
        )


@pytest.fixture(scope="module")
def level(flights, soundings):
    flight = Level(flights, soundings[0])
    samples = flight.fly(np.random.default_rng(1))
    return flight, build_adjusted_profile(samples, US1976, flight.latitude, Ledger())


def sigmas_of_r(series, flight):
    top = flight.ground + CLIMB
    ground = flight.ground
    return np.array(
        [
            series.timed_profiles[i].covariance.relative_sigma(top, ground)
            for i in series.profile_number
        ]
    )


def test_sigma_grows_with_the_time_since_the_air_was_sampled(level):
    flight, whole = level
    times = flight.times()
    ledger = Ledger()
    top = flight.ground + CLIMB
    ground = flight.ground
    assert estimate_windows(whole, [top], ground)[0] == ()
    one = constant_series(TimedProfile(whole.time_ns, whole.profile, whole.covariance), times.size)
    series = ledger.take(add_ageing(one, times, whole.samples, top, ground))
    sigma = sigmas_of_r(series, flight)
    assert sigma[0] == pytest.approx(whole.covariance.relative_sigma(top, ground))
    assert np.all(np.diff(sigma[1:]) > 0.0)
    errors = np.array([truth.error(whole.profile, CLIMB) for truth in flight.truths])
    assert np.abs(errors).max() > 0.02
    # With the sigma of the estimate alone the last is off by 4.6 of it.
    assert np.abs(errors / sigmas_of_r(one, flight)).max() > 4.0
    assert np.abs(errors / sigma)[3:].max() < 2.5
    (entry,) = list(ledger)
    assert entry.code == "AIR-AGED"
    assert "3.0 h" in entry.what
    assert 4 <= entry.count <= 6
    # The profile itself stays, and the height of the cameras was measured all the time.
    assert all(air.profile is whole.profile for air in series.timed_profiles)
    late = series.timed_profiles[series.profile_number[-1]].covariance
    for of in ("sigma_temperature", "sigma_refractivity", "sigma_log_pressure"):
        old, new = (getattr(c, of)([ground + 300.0, top]) for c in (whole.covariance, late))
        assert new[0] > 1.5 * old[0]
        assert new[1] < 1.15 * old[1]


def test_air_that_was_sampled_before_and_after_is_oldest_between(level):
    flight, whole = level
    seconds = (whole.samples.temperature.time_ns - flight.start_ns) * 1e-9
    down = np.interp(seconds, [9600.0, 10_700.0], [0.0, CLIMB])
    sensors = {
        name: replace(getattr(whole.samples, name), h_m=getattr(whole.samples, name).h_m - down)
        for name in ("temperature", "pressure")
    }
    ages = sample_ages(AirSamples(**sensors), flight.times(), flight.ground, flight.ground + CLIMB)
    low = [float(age.hours[5]) for age in ages]
    # Up at 0.1 h, down at 2.9 h: sqrt(1.4^2 - 0.5^2) = 1.3 h in the middle.
    assert low[0] == low[-1] == 0.0
    assert low[3] == max(low) == pytest.approx(1.3, abs=0.1)
    assert all(age.hours[-1] == 0.0 for age in ages)


def test_fresh_air_stays_as_it_is(changing):
    day, whole, windows, _ = changing
    ledger = Ledger()
    # in the end it was low 40 minutes ago
    top = day.ground + CLIMB
    times = day.times[:-1]
    unaged = interpolate_series([w.air for w in windows], times, [top], day.ground)
    assert ledger.take(add_ageing(unaged, times, whole.samples, top, day.ground + 300.0)) is unaged
    assert list(ledger) == []
    nothing = AirSamples(
        SensorSamples(np.empty(0, np.int64), *[np.empty(0)] * 2, np.empty(0, np.uint8))
    )
    assert all(age.is_fresh for age in sample_ages(nothing, day.times, 0.0, 3000.0))
    assert add_ageing(constant_series(windows[0].air, 0), np.empty(0, np.int64), nothing, 1.0, 0.0)


# ---- windows of time


def sensor(hours, above, value=280.0, accepted=True):
    hours = np.asarray(hours, float)
    above = np.asarray(above, float)
    time_ns = (hours * 3600.0 * SECOND).astype(np.int64)
    refused = np.full(hours.size, not accepted)
    return SensorSamples(
        time_ns, above, np.full(hours.size, value), reasons_where(refused, Reason.GROUND_SOAK), "s"
    )


def hours_of(windows):
    return [tuple(round(t / 3600.0 / SECOND, 1) for t in window) for window in windows]


TIMES = np.linspace(0.0, 4.0, 2001)


@pytest.mark.parametrize(
    ("heights", "expected"),
    [
        # Up and down all the time: half hours.
        (1000.0 + 500.0 * np.sin(TIMES * 20.0), [(0.5 * i, 0.5 * i + 0.5) for i in range(8)]),
        # A climb, hours of level flight, a descent: the level half hours join their neighbours.
        (np.interp(TIMES, [0.0, 0.3, 3.7, 4.0], [0.0, 3e3, 3e3, 0.0]), [(0.0, 1.0), (1.0, 4.0)]),
        # A climb and level flight for ever: one.
        (np.interp(TIMES, [0.0, 0.3], [0.0, 3e3]), [(0.0, 4.0)]),
        # Nothing of the height that says something.
        (np.full(TIMES.size, 100.0), [(0.0, 4.0)]),
    ],
)
def test_windows_span_enough_height(heights, expected):
    found = time_windows(AirSamples(sensor(TIMES, heights)))
    assert hours_of(found) == expected


def test_a_barometer_alone_needs_the_same_height():
    for half, windows in ((500.0, 8), (140.0, 1)):
        heights = 1000.0 + half * np.sin(TIMES * 20.0)
        for samples in (
            AirSamples(None, sensor(TIMES, heights)),
            AirSamples(sensor(TIMES, heights)),
        ):
            assert len(time_windows(samples)) == windows


def test_a_short_flight_is_one_window_and_a_long_one_not_many():
    heights = 1000.0 + 500.0 * np.sin(np.linspace(0.0, 600.0, 4001))
    assert len(time_windows(AirSamples(sensor(np.linspace(0, 0.9, 4001), heights)))) == 1
    assert len(time_windows(AirSamples(sensor(np.linspace(0, 30, 4001), heights)))) == 12


def test_readings_that_no_gate_lets_through_make_no_windows():
    assert time_windows(AirSamples(sensor(TIMES, 1e3 * np.sin(TIMES), accepted=False))) == ()


def test_every_reading_belongs_to_one_window():
    heights = 1000.0 + 500.0 * np.sin(TIMES * 20.0)
    samples = AirSamples(sensor(TIMES, heights), sensor(TIMES, heights, 9e4))
    parts = [part_of_flight(samples, *window) for window in time_windows(samples)]
    joined = np.concatenate([part.temperature.time_ns for part in parts])
    assert (joined == samples.temperature.time_ns).all()
    # Nobody looked for take-offs: later parts begin in the air.
    assert parts[0].takeoff_ns is None
    assert all(part.takeoff_ns.size == 0 for part in parts[1:])


def test_a_flight_that_nothing_was_measured_in_has_no_windows():
    found = build_adjusted_profile(AirSamples(), US1976, 0.8, Ledger())
    assert estimate_windows(found, [3000.0], 0.0) == ((), ())


# ---- between two profiles


@pytest.fixture(scope="module")
def pair(changing):
    _, _, windows, _ = changing
    return windows[0].air, windows[-1].air


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_a_blend_is_linear_and_hydrostatic(pair, share):
    a, b = pair
    mixed = interpolate_profiles(a, b, share)
    h = np.linspace(500.0, 8000.0, 801)
    for of in ("virtual_temperature", "pressure", "refractivity"):
        mean = (1 - share) * getattr(a.profile, of)(h) + share * getattr(b.profile, of)(h)
        # p is not linear in T, but nearly: 20 K apart the second order is 2e-4.
        assert getattr(mixed.profile, of)(h) == pytest.approx(mean, rel=4e-4)
    p = mixed.profile.pressure(h)
    t = mixed.profile.virtual_temperature(h)
    g = mixed.profile.gravity.geopotential_height(h)
    slope = np.gradient(np.log(p), g) * t
    assert np.median(slope) == pytest.approx(-9.80665 * 28.9644e-3 / 8.31432, rel=1e-5)
    assert mixed.time_ns == a.time_ns + round(share * (b.time_ns - a.time_ns))


def test_the_ends_of_a_blend_are_the_profiles_themselves(pair):
    a, b = pair
    assert interpolate_profiles(a, b, 0.0) is a
    assert interpolate_profiles(a, b, 1.0) is b


def test_a_blend_is_never_surer_than_its_ends(pair):
    """Whatever the errors of the two have in common: between the sigmas, never below the mix."""
    a, b = pair
    h = np.linspace(500.0, 6000.0, 50)
    mixed = interpolate_profiles(a, b, 0.5).covariance
    for of in ("sigma_temperature", "sigma_refractivity", "sigma_log_pressure"):
        one, other = (getattr(air.covariance, of)(h) for air in pair)
        found = getattr(mixed, of)(h)
        assert np.all(found > 0.97 * 0.5 * (one + other))
        assert np.all(found < 1.03 * np.maximum(one, other))


def test_profiles_follow_each_other_closely(pair):
    times = np.linspace(pair[0].time_ns - 10**12, pair[1].time_ns + 10**12, 5000).astype(np.int64)
    air = interpolate_series(pair, times, [3000.0], 400.0)
    steps = [
        abs(two.change_from(one, [3000.0], 400.0))
        for one, two in zip(air.timed_profiles, air.timed_profiles[1:], strict=False)
    ]
    assert max(steps) < 5.1e-4  # equal shares of a change that is not quite linear
    assert len(air.timed_profiles) > 50
    assert (np.diff(air.profile_number) >= 0).all()
    assert air.timed_profiles[0] is pair[0]
    assert air.timed_profiles[-1] is pair[1]


def test_only_profiles_that_an_exposure_takes_are_made(pair):
    air = interpolate_series(pair, np.array([pair[0].time_ns, pair[1].time_ns]), [3000.0], 400.0)
    assert len(air.timed_profiles) == 2
    assert air.profile_number.tolist() == [0, 1]


def test_the_air_at_exposures_is_that_of_their_profile(pair):
    air = interpolate_series(pair, np.array([pair[1].time_ns, pair[0].time_ns]), [3000.0], 400.0)
    h = np.array([1000.0, 2000.0])
    for of in ("pressure", "temperature", "vapour_pressure", "refractivity"):
        one = getattr(pair[1].profile, of)(1000.0)
        other = getattr(pair[0].profile, of)(2000.0)
        assert getattr(air, of)(h) == pytest.approx([float(one), float(other)])
    assert air.index == US1976.index
    alone = constant_series(TimedProfile(None, US1976), 2)
    assert (alone.pressure(h) == US1976.pressure(h)).all()


def test_air_without_a_time_cannot_be_put_in_order(pair):
    timeless = replace(pair[0], time_ns=None)
    with pytest.raises(ValueError, match="time"):
        interpolate_series((timeless, pair[1]), np.zeros(1, np.int64), [3000.0], 0.0)
    with pytest.raises(ValueError, match="both"):
        interpolate_profiles(timeless, pair[1], 0.5)
