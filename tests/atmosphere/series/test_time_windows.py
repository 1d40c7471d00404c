"""Hours of flight through air that changes: windows, profiles between them, and their sigmas.

The true air is two real soundings that blend in time, integrated anew at each time (`flights`).
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import interpn

from tests.atmosphere import flights
from tests.atmosphere.adjusting import (
    NO_SENSORS,
    US1976,
    codes,
    entry,
    rms,
    seconds_of,
    warmer,
)
from tests.atmosphere.flights import Sensors, Truth
from tests.helpers import with_code
from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.adjusted_profile import Adjustment, build_adjusted_profile
from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.rejection import Reason
from unbend.atmosphere.series.ageing import sample_ages
from unbend.atmosphere.series.profile_series import (
    TimedProfile,
    add_ageing,
    constant_series,
    interpolate_profiles,
    interpolate_series,
)
from unbend.atmosphere.series.time_windows import (
    TimeWindow,
    _whole_flight_as_background,
    estimate_windows,
    part_of_flight,
    time_windows,
)
from unbend.messages import Ledger

CLIMB = 3000.0
HOUR_S = 3600.0
SECOND_NS = 10**9
SIGMAS = (
    "sigma_temperature",
    "sigma_log_pressure",
    "sigma_refractivity",
)


def resampled(balloon, H, warmer_k=0.0):
    """A balloon at other heights: T and ln e linear between its levels."""
    t = np.interp(H, balloon.H, balloon.t)
    log_e = np.interp(H, balloon.H, np.log(balloon.e))
    return replace(
        balloon,
        H=H,
        t=t + warmer_k,
        e=np.exp(log_e),
    )


def between(first, second, share):
    """A balloon between two of one site: T, ln e and the lowest pressure linear in time."""
    lowest = max(first.H[0], second.H[0])
    highest = min(first.H[-1], second.H[-1], 12_000.0)
    H = np.arange(lowest, highest, 10.0)
    before = resampled(first, H)
    after = resampled(second, H)

    def mixed(of_first, of_second):
        return (1.0 - share) * of_first + share * of_second

    log_e = mixed(np.log(before.e), np.log(after.e))
    return replace(
        before,
        t=mixed(before.t, after.t),
        e=np.exp(log_e),
        p0=mixed(before.p0, after.p0),
    )


class ChangingAir:
    """The air between two soundings over some hours, integrated at even times."""

    def __init__(self, first, second, hours, count):
        shares = np.linspace(0.0, 1.0, count)
        self.truths = []
        for share in shares:
            balloon = between(first, second, share)
            self.truths.append(Truth(balloon, reach=4000.0))
        self.first = self.truths[0]
        self.seconds = shares * hours * HOUR_S
        self.start_ns = self.first.start_ns
        since_start_ns = (self.seconds * SECOND_NS).astype(np.int64)
        self.times = self.start_ns + since_start_ns
        self.ground = self.first.ground_m
        self.top = self.ground + CLIMB

    def at_height(self, name, seconds, above):
        values = np.array([getattr(truth, name) for truth in self.truths])
        metres = np.arange(values.shape[1])
        return interpn((self.seconds, metres), values, (seconds, above))

    def errors(self, profiles):
        """Errors of R in per cent at the even times."""
        pairs = zip(self.truths, profiles, strict=True)
        errors = [truth.error(profile, CLIMB) for truth, profile in pairs]
        return 100.0 * np.array(errors)

    def sigma(self, air):
        """Stated sigma of R from the ground to the top, in per cent."""
        return 100.0 * air.covariance.relative_sigma(self.top, self.ground)

    def sigmas(self, series):
        """Stated sigmas of R in per cent at the times of a series."""
        sigmas = [self.sigma(air) for air in series.timed_profiles]
        return np.array(sigmas)[series.profile_number]

    def fly(self, above_at, sensors, seed):
        """What sensors with faults measure on this day, every other second."""
        seconds = np.arange(0.0, self.seconds[-1], 2.0)
        above = above_at(seconds)
        along = {name: self.at_height(name, seconds, above) for name in flights.AIR}
        return flights.measure(
            self.first,
            along,
            seconds,
            above,
            sensors,
            default_rng(seed),
            gate_s=62.0,
        )

    def windows(self, whole):
        """Windows of a flight on this day, and their messages."""
        return estimate_windows(whole, [self.top], self.ground)


def legs(seconds):
    """Heights above ground: up to 3 km and down to 300 m, once in forty minutes."""
    phase = np.mod(seconds - 30.0, 2400.0)
    way = np.interp(
        phase,
        [0, 600, 1800, 2400],
        [300.0, CLIMB, CLIMB, 300.0],
    )
    return np.where(seconds < 630.0, climb_of_ten_minutes(seconds), way)


def climb_of_ten_minutes(seconds):
    return np.interp(seconds, [30, 630], [0.0, CLIMB])


@dataclass(frozen=True)
class Flown:
    """A day, the air of the whole flight, its windows, and the ledger."""

    day: ChangingAir
    whole: Adjustment
    windows: tuple[TimeWindow, ...]
    ledger: Ledger

    def along(self, times):
        day = self.day
        airs = [window.air for window in self.windows]
        return interpolate_series(airs, times, [day.top], day.ground)


def flown(day, samples):
    ledger = Ledger()
    whole = build_adjusted_profile(samples, US1976, day.first.latitude, ledger)
    windows = ledger.take(day.windows(whole))
    return Flown(day, whole, windows, ledger)


def flown_for_four_hours(first, second, seed):
    day = ChangingAir(first, second, hours=4.0, count=9)
    sensors = replace(
        flights.REALISTIC,
        drift_k=0.2,
        lag_s=0.0,
        pressure_noise_pa=0.0,
        gnss_noise_m=0.0,
    )
    return flown(day, day.fly(legs, sensors, seed))


@pytest.fixture(scope="module")
def soundings():
    """Two mornings of Norman, Oklahoma, twelve Mays apart: R differs by 13 % over 3 km."""
    return [balloon for balloon in flights.balloons() if "OUN" in balloon.name]


@pytest.fixture(scope="module")
def changing(soundings):
    return flown_for_four_hours(*soundings, seed=3)


def test_air_that_changes_is_followed(changing):
    """One profile errs by up to 6 % at the ends of the flight; measured along it: 1.5 and 0.6 %."""
    day = changing.day
    assert len(changing.windows) >= 5
    assert codes(changing.ledger).count("AIR-WINDOWS") == 1
    series = changing.along(day.times)
    profiles = [series.profiles[number] for number in series.profile_number]
    errors = day.errors(profiles)
    assert np.abs(errors).max() < 2.5
    assert rms(errors) < 1.2
    # The sigmas are honest.
    sigmas = day.sigmas(series)
    departures = np.abs(errors) / sigmas
    assert np.mean(departures < 1.0) >= 0.5
    assert departures.max() < 3.0
    assert sigmas.min() > 0.3
    assert sigmas.max() < 2.0


def test_air_that_stands_still_needs_one_profile(soundings):
    """... so that a flight in it is corrected as if nobody had looked."""
    balloon, _ = soundings
    still = flown_for_four_hours(balloon, balloon, seed=1)
    assert still.windows == ()
    assert entry(still.ledger, "AIR-WINDOWS").what.startswith("one profile for 4.0 h")
    errors = still.day.errors([still.whole.profile] * 9)
    assert np.abs(errors).max() < 1.0


def test_a_window_counts_its_readings_once(changing):
    """They are in its background too: the covariance of the estimate alone would be too small."""
    whole = changing.whole
    first, _, window, *_, last = changing.windows
    part = part_of_flight(whole.samples, window.start_ns, window.end_ns)
    hours = (last.end_ns - first.start_ns) / 3.6e12
    faults = []
    for fault in whole.faults:
        sigma = np.hypot(fault.sigma, 0.2 * fault.prior_sigma)
        faults.append(replace(fault, sigma=sigma))
    # Not public: what a window is estimated about cannot be read from its result.
    background = _whole_flight_as_background(
        whole.covariance,
        whole.moisture.spread,
        hours,
    )

    once = estimate(part, background, settings=whole.settings, known_faults=faults)

    h = np.linspace(500.0, 6000.0, 12)
    for name in SIGMAS:
        sigma_twice = getattr(window.air.covariance, name)(h)
        sigma_once = getattr(once.covariance, name)(h)
        assert_allclose(sigma_twice / sigma_once, np.sqrt(2.0), rtol=1e-6)


def test_a_window_uses_what_is_known_of_the_sensors(changing):
    """A thermometer that may drift by 5 K in a quarter of an hour says less in each window."""
    drift = {SensorFault.THERMOMETER_DRIFT: SensorCalibration(sigma=5.0)}
    drifting = replace(changing.whole, settings=SensorSettings(calibration=drift))
    of_drifting, _ = changing.day.windows(drifting)

    compared = 0
    for window, drifting_window in zip(changing.windows, of_drifting, strict=True):
        if window.why_not or drifting_window.why_not:
            continue
        sigma = window.air.covariance.sigma_temperature(2000.0)
        assert drifting_window.air.covariance.sigma_temperature(2000.0) > 1.1 * sigma
        compared += 1
    assert compared


def test_a_window_that_falls_back_is_less_certain(changing):
    """... by what the air changes in four hours, and the ledger says when, in this century."""
    day = changing.day
    whole = changing.whole
    seconds = seconds_of(whole.samples)
    spoilt = (seconds > 5400.0) & (seconds < 8100.0)
    steps = default_rng(5).normal(size=seconds.size // 20 + 1)
    noise = 15.0 * steps.repeat(20)[: seconds.size]
    wild = replace(whole, samples=warmer(whole.samples, spoilt * noise))
    ledger = Ledger()

    windows = ledger.take(day.windows(wild))

    fallen = [window for window in windows if window.why_not]
    assert 0 < len(fallen) < len(windows)
    for window in fallen:
        half_hours = (window.air.time_ns - day.start_ns) / SECOND_NS / 1800.0
        truth = day.truths[round(half_hours)]
        sigma = day.sigma(window.air)
        error = 100.0 * truth.error(window.air.profile, CLIMB)
        assert abs(error) < 2.0 * sigma
        assert sigma > 3.0 * day.sigma(whole)
    texts = [message.what for message in with_code(ledger, "AIR-WINDOW")]
    assert len(texts) == len(fallen)
    # What a window is compared with is the whole flight; no climatology was asked.
    held_out = 0
    for text in texts:
        assert text.startswith("the air of the whole flight is used about 2020-")
        assert "climatology" not in text
        if "were not used in the estimate" in text:
            assert text.endswith("K from the whole flight")
            held_out += 1
    assert held_out


# ---- air that was sampled long ago


@pytest.fixture(scope="module")
def level(soundings):
    """A climb to 3 km, hours of level flight, and no descent, while the ground warms by 4 K."""
    balloon, _ = soundings
    H = np.arange(balloon.H[0], 12_000.0, 10.0)
    warmer_k = 4.0 * np.exp((H[0] - H) / 1500.0)
    afterwards = resampled(balloon, H, warmer_k)
    day = ChangingAir(balloon, afterwards, hours=3.0, count=7)
    sensors = Sensors(noise_k=0.2, pressure_noise_pa=5.0)
    samples = day.fly(climb_of_ten_minutes, sensors, seed=1)
    return flown(day, replace(samples, humidity=None))


def test_sigma_grows_with_the_time_since_the_air_was_sampled(level):
    day = level.day
    whole = level.whole
    assert level.windows == ()
    timed = TimedProfile(whole.time_ns, whole.profile, whole.covariance)
    unaged = constant_series(timed, day.times.size)

    series, (message,) = add_ageing(
        unaged,
        day.times,
        whole.samples,
        day.top,
        day.ground,
    )

    sigmas = day.sigmas(series)
    assert sigmas[0] == pytest.approx(day.sigma(whole))
    assert np.all(np.diff(sigmas[1:]) > 0.0)
    errors = day.errors([whole.profile] * 7)
    # With the sigma of the estimate alone the last is off by 4.6 of it.
    assert np.abs(errors / sigmas)[3:].max() < 2.5
    assert message.code == "AIR-AGED"
    assert "3.0 h" in message.what
    assert 4 <= message.count <= 6
    # The profile itself stays, and the height of the cameras was measured all the time.
    assert {air.profile for air in series.timed_profiles} == {whole.profile}
    late = series.timed_profiles[series.profile_number[-1]].covariance
    heights = [day.ground + 300.0, day.top]
    for name in SIGMAS:
        late_sigma = getattr(late, name)(heights)
        low, high = late_sigma / getattr(whole.covariance, name)(heights)
        assert low > 1.5
        assert high < 1.15


def test_fresh_air_stays_as_it_is(changing):
    day = changing.day
    times = day.times[:-1]  # in the end it was low 40 minutes ago
    unaged = changing.along(times)
    series, notes = add_ageing(
        unaged,
        times,
        changing.whole.samples,
        day.top,
        day.ground + 300.0,
    )
    assert series is unaged
    assert not notes


def test_nothing_ages_where_nothing_was_measured(changing):
    none = np.empty(0)
    nothing = AirSamples(sensor(none, none))
    ages = sample_ages(nothing, changing.day.times, 0.0, 3000.0)
    assert all(age.is_fresh for age in ages)

    unaged = constant_series(changing.windows[0].air, 0)
    _, notes = add_ageing(unaged, none, nothing, 1.0, 0.0)
    assert not notes


# ---- windows of time


def sensor(hours, above):
    time_ns = (hours * HOUR_S * SECOND_NS).astype(np.int64)
    return SensorSamples(time_ns, above, np.full(above.size, 280.0))


TIMES = np.linspace(0.0, 4.0, 2001)
CLIMB_ALONE = np.interp(TIMES, [0.0, 0.3], [0.0, CLIMB])
CLIMB_AND_DESCENT = np.minimum(CLIMB_ALONE, CLIMB_ALONE[::-1])


def waves(half_m):
    """Up and down all the time."""
    return 1000.0 + half_m * np.sin(TIMES * 20.0)


@pytest.mark.parametrize(
    ("heights", "edges"),
    [
        (waves(500.0), np.arange(0, 4.1, 0.5)),
        (waves(140.0), [0, 4]),
        # A climb, hours of level flight, a descent: the level half hours join their neighbours.
        (CLIMB_AND_DESCENT, [0, 1, 4]),
        # A climb and level flight for ever: one.
        (CLIMB_ALONE, [0, 4]),
        # Nothing of the height that says something.
        (np.full(TIMES.size, 100.0), [0, 4]),
    ],
    ids=["waves", "low waves", "level", "no descent", "no climb"],
)
def test_windows_span_enough_height(heights, edges):
    """Of a thermometer, and of a barometer alone."""
    flown_at = sensor(TIMES, heights)
    for samples in (AirSamples(flown_at), AirSamples(None, flown_at)):
        hours = np.array(time_windows(samples)) / HOUR_S / SECOND_NS
        assert_allclose(hours, list(pairwise(edges)), atol=0.05)


@pytest.mark.parametrize(
    ("hours", "count"),
    [
        (0.9, 1),
        (30.0, 12),
    ],
)
def test_a_short_flight_is_one_window_and_a_long_one_not_many(hours, count):
    share = np.linspace(0.0, 1.0, 4001)
    heights = 1000.0 + 500.0 * np.sin(600.0 * share)
    samples = AirSamples(sensor(hours * share, heights))
    assert len(time_windows(samples)) == count


WAVING = sensor(TIMES, waves(500.0))


def test_readings_that_no_gate_lets_through_make_no_windows():
    soaked = WAVING.reject(WAVING.h_m > 0.0, Reason.GROUND_SOAK)
    assert time_windows(AirSamples(soaked)) == ()


def test_every_reading_belongs_to_one_window():
    samples = AirSamples(WAVING, WAVING)
    parts = [part_of_flight(samples, *window) for window in time_windows(samples)]
    joined = np.concatenate([part.temperature.time_ns for part in parts])
    assert_array_equal(joined, WAVING.time_ns)
    # Nobody looked for take-offs: later parts begin in the air.
    assert parts[0].takeoff_ns is None
    assert all(part.takeoff_ns.size == 0 for part in parts[1:])


def test_a_flight_that_nothing_was_measured_in_has_no_windows():
    unmeasured = build_adjusted_profile(NO_SENSORS, US1976, 0.8, Ledger())
    assert estimate_windows(unmeasured, [3000.0], 0.0) == ((), ())


# ---- between two profiles


@pytest.fixture(scope="module")
def pair(changing):
    return changing.windows[0].air, changing.windows[-1].air


def series_at(pair, times_ns):
    return interpolate_series(
        pair,
        np.array(times_ns, np.int64),
        [3000.0],
        400.0,
    )


@pytest.mark.parametrize("share", [0.25, 0.9])
def test_a_blend_is_linear(pair, share):
    first, second = pair
    mixed = interpolate_profiles(first, second, share)
    h = np.linspace(500.0, 8000.0, 801)
    for name in ("virtual_temperature", "pressure", "refractivity"):
        of_first = getattr(first.profile, name)(h)
        change = getattr(second.profile, name)(h) - of_first
        of_mixed = getattr(mixed.profile, name)(h)
        # p is not linear in T, but nearly: 20 K apart the second order is 2e-4.
        assert of_mixed == pytest.approx(of_first + share * change, rel=4e-4)
    between_ns = second.time_ns - first.time_ns
    assert mixed.time_ns == first.time_ns + round(share * between_ns)


def test_the_ends_of_a_blend_are_the_profiles_themselves(pair):
    assert interpolate_profiles(*pair, 0.0) is pair[0]
    assert interpolate_profiles(*pair, 1.0) is pair[1]


def test_a_blend_is_never_surer_than_its_ends(pair):
    """Whatever the errors of the two have in common: between the sigmas, never below the mix."""
    h = np.linspace(500.0, 6000.0, 50)
    mixed = interpolate_profiles(*pair, 0.5).covariance
    for name in SIGMAS:
        sigmas = [getattr(air.covariance, name)(h) for air in pair]
        of_mixed = getattr(mixed, name)(h)
        assert np.all(of_mixed > 0.97 * np.mean(sigmas, axis=0))
        assert np.all(of_mixed < 1.03 * np.max(sigmas, axis=0))


def test_profiles_follow_each_other_closely(pair):
    first, second = pair
    beyond_ns = 10**12
    times = np.linspace(
        first.time_ns - beyond_ns,
        second.time_ns + beyond_ns,
        5000,
    )

    series = series_at(pair, times)

    airs = series.timed_profiles
    for earlier, later in pairwise(airs):
        step = later.change_from(earlier, [3000.0], 400.0)
        assert abs(step) < 5.1e-4  # equal shares of a change that is not quite linear
    assert len(airs) > 50
    assert (np.diff(series.profile_number) >= 0).all()
    assert airs[0] is first
    assert airs[-1] is second


def test_the_air_at_exposures_is_that_of_their_profile(pair):
    """Only profiles that an exposure takes are made."""
    first, second = pair
    series = series_at(pair, [second.time_ns, first.time_ns])
    assert len(series.timed_profiles) == 2
    assert series.index == US1976.index
    h = np.array([1000.0, 2000.0])
    for name in ("pressure", "temperature", "vapour_pressure", "refractivity"):
        of_second = getattr(second.profile, name)(1000.0)
        of_first = getattr(first.profile, name)(2000.0)
        values = getattr(series, name)(h)
        assert values == pytest.approx(np.array([of_second, of_first]))


def test_air_without_a_time_cannot_be_put_in_order(pair):
    timeless = replace(pair[0], time_ns=None)
    with pytest.raises(ValueError, match="time"):
        series_at((timeless, pair[1]), [0])
    with pytest.raises(ValueError, match="both"):
        interpolate_profiles(timeless, pair[1], 0.5)
