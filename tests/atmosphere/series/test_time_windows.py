"""Hours of flight through air that changes: windows, profiles between them, and their sigmas.

The true air is two real soundings that blend in time, integrated anew at each time (`flights`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import interpn

from tests.atmosphere import flights
from tests.atmosphere.adjusting import NO_SENSORS, US1976, codes, entry, rms, with_readings
from tests.atmosphere.flights import Balloon, Sensors, Truth
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
SIGMAS = ("sigma_temperature", "sigma_log_pressure", "sigma_refractivity")


def between(first: Balloon, second: Balloon, share: float) -> Balloon:
    """A balloon between two of one site: T, ln e and the lowest pressure linear in time."""
    lowest = max(first.H[0], second.H[0])
    highest = min(first.H[-1], second.H[-1], 12_000.0)
    H = np.arange(lowest, highest, 10.0)

    def mixed(of):
        return (1.0 - share) * of(first) + share * of(second)

    return replace(
        first,
        H=H,
        t=mixed(lambda balloon: np.interp(H, balloon.H, balloon.t)),
        e=np.exp(mixed(lambda balloon: np.interp(H, balloon.H, np.log(balloon.e)))),
        p0=mixed(lambda balloon: balloon.p0),
    )


class ChangingAir:
    """The air between two soundings over some hours, integrated at even times."""

    def __init__(self, first: Balloon, second: Balloon, hours: float, count: int) -> None:
        shares = np.linspace(0.0, 1.0, count)
        self.truths = [Truth(between(first, second, share), reach=4000.0) for share in shares]
        self.seconds = shares * hours * HOUR_S
        self.start_ns = self.truths[0].start_ns
        self.times = self.start_ns + (self.seconds * SECOND_NS).astype(np.int64)
        self.ground = float(self.truths[0].h[0])
        self.top = self.ground + CLIMB

    def at(self, name: str, seconds: np.ndarray, above: np.ndarray) -> np.ndarray:
        values = np.array([getattr(truth, name) for truth in self.truths])
        grid = (self.seconds, np.arange(values.shape[1]))
        return interpn(grid, values, (seconds, above))

    def errors(self, profiles) -> np.ndarray:
        """Errors of R in per cent at the even times."""
        pairs = zip(self.truths, profiles, strict=True)
        return np.array([100.0 * truth.error(profile, CLIMB) for truth, profile in pairs])

    def sigmas(self, series) -> np.ndarray:
        """Stated sigmas of R in per cent at the times of a series."""
        of_profiles = [
            100.0 * air.covariance.relative_sigma(self.top, self.ground)
            for air in series.timed_profiles
        ]
        return np.array(of_profiles)[series.profile_number]

    def fly(self, above_at, sensors: Sensors, seed: int) -> AirSamples:
        """What sensors with faults measure on this day, every other second."""
        seconds = np.arange(0.0, self.seconds[-1], 2.0)
        above = above_at(seconds)
        along = {name: self.at(name, seconds, above) for name in ("t", "p", "rh")}
        rng = np.random.default_rng(seed)
        return flights.measure(self.truths[0], along, seconds, above, sensors, rng, gate_s=62.0)


def legs(seconds: np.ndarray) -> np.ndarray:
    """Heights above ground: up to 3 km and down to 300 m, once in forty minutes."""
    phase = np.mod(seconds - 30.0, 2400.0)
    way = np.interp(phase, [0.0, 600.0, 1800.0, 2400.0], [300.0, CLIMB, CLIMB, 300.0])
    return np.where(seconds < 630.0, climb_of_ten_minutes(seconds), way)


def climb_of_ten_minutes(seconds: np.ndarray) -> np.ndarray:
    return np.interp(seconds, [30.0, 630.0], [0.0, CLIMB])


@dataclass(frozen=True)
class Flown:
    """A day, the air of the whole flight, its windows, and the ledger."""

    day: ChangingAir
    whole: Adjustment
    windows: tuple[TimeWindow, ...]
    ledger: Ledger

    def along(self, times):
        airs = [window.air for window in self.windows]
        return interpolate_series(airs, times, [self.day.top], self.day.ground)


def flown(day: ChangingAir, samples: AirSamples) -> Flown:
    ledger = Ledger()
    whole = build_adjusted_profile(samples, US1976, day.truths[0].latitude, ledger)
    windows = ledger.take(estimate_windows(whole, [day.top], day.ground))
    return Flown(day, whole, windows, ledger)


def flown_for_four_hours(first: Balloon, second: Balloon, seed: int) -> Flown:
    day = ChangingAir(first, second, hours=4.0, count=9)
    without = {"lag_s": 0.0, "pressure_noise_pa": 0.0, "gnss_noise_m": 0.0}
    sensors = replace(flights.REALISTIC, drift_k=0.2, **without)
    return flown(day, day.fly(legs, sensors, seed))


@pytest.fixture(scope="module")
def soundings():
    """Two mornings of Norman, Oklahoma, twelve Mays apart: R differs by 13 % over 3 km."""
    first, second = (balloon for balloon in flights.balloons() if "OUN" in balloon.name)
    return first, second


@pytest.fixture(scope="module")
def changing(soundings) -> Flown:
    return flown_for_four_hours(*soundings, seed=3)


def test_air_that_changes_is_followed(changing):
    """One profile errs by up to 6 % at the ends of the flight; measured along it: 1.5 and 0.6 %."""
    day = changing.day
    assert len(changing.windows) >= 5
    assert codes(changing.ledger).count("AIR-WINDOWS") == 1
    series = changing.along(day.times)
    errors = day.errors([series.profiles[i] for i in series.profile_number])
    assert np.abs(errors).max() < 2.5
    assert rms(errors) < 1.2
    # The sigmas are honest.
    sigmas = day.sigmas(series)
    assert np.mean(np.abs(errors) < sigmas) >= 0.5
    assert np.abs(errors / sigmas).max() < 3.0
    assert sigmas.min() > 0.3
    assert sigmas.max() < 2.0


def test_air_that_stands_still_needs_one_profile(soundings):
    """... so that a flight in it is corrected as if nobody had looked."""
    still = flown_for_four_hours(soundings[0], soundings[0], seed=1)
    assert still.windows == ()
    assert entry(still.ledger, "AIR-WINDOWS").what.startswith("one profile for 4.0 h")
    assert np.abs(still.day.errors([still.whole.profile] * 9)).max() < 1.0


def test_a_window_counts_its_readings_once(changing):
    """They are in its background too: the covariance of the estimate alone would be too small."""
    whole = changing.whole
    windows = changing.windows
    window = windows[2]
    part = part_of_flight(whole.samples, window.start_ns, window.end_ns)
    hours = (windows[-1].end_ns - windows[0].start_ns) / 3.6e12
    known = [replace(f, sigma=np.hypot(f.sigma, 0.2 * f.prior_sigma)) for f in whole.faults]
    background = _whole_flight_as_background(whole.covariance, whole.moisture.spread, hours)
    once = estimate(part, background, settings=whole.settings, known=known).covariance
    h = np.linspace(500.0, 6000.0, 12)
    for name in SIGMAS:
        ratio = getattr(window.air.covariance, name)(h) / getattr(once, name)(h)
        np.testing.assert_allclose(ratio, np.sqrt(2.0), rtol=1e-6)


def test_a_window_uses_what_is_known_of_the_sensors(changing):
    """A thermometer that may drift by 5 K in a quarter of an hour says less in each window."""
    drift = {SensorFault.THERMOMETER_DRIFT: SensorCalibration(sigma=5.0)}
    drifting = replace(changing.whole, settings=SensorSettings(calibration=drift))
    others, _ = estimate_windows(drifting, [changing.day.top], changing.day.ground)
    pairs = zip(changing.windows, others, strict=True)
    estimated = [pair for pair in pairs if not any(window.why_not for window in pair)]
    assert estimated
    for pair in estimated:
        sigma, of_drifting = (
            window.air.covariance.sigma_temperature([2000.0]).item() for window in pair
        )
        assert of_drifting > 1.1 * sigma


def test_a_window_that_falls_back_is_less_certain(changing):
    """... by what the air changes in four hours, and the ledger says when, in this century."""
    day = changing.day
    whole = changing.whole
    t = whole.samples.temperature
    seconds = (t.time_ns - day.start_ns) / SECOND_NS
    spoilt = (seconds > 5400.0) & (seconds < 8100.0)
    steps = np.random.default_rng(5).normal(size=t.value.size // 20 + 1)
    noise = 15.0 * steps.repeat(20)[: t.value.size]
    wild = with_readings(whole.samples, t.value + spoilt * noise)
    ledger = Ledger()
    of_wild = estimate_windows(replace(whole, samples=wild), [day.top], day.ground)
    windows = ledger.take(of_wild)
    fallen = [window for window in windows if window.why_not]
    assert 0 < len(fallen) < len(windows)
    of_whole = whole.covariance.relative_sigma(day.top, day.ground)
    for window in fallen:
        half_hours = (window.air.time_ns - day.start_ns) / SECOND_NS / 1800.0
        truth = day.truths[round(half_hours)]
        sigma = window.air.covariance.relative_sigma(day.top, day.ground)
        assert abs(truth.error(window.air.profile, CLIMB)) < 2.0 * sigma
        assert sigma > 3.0 * of_whole
    texts = [message.what for message in with_code(ledger, "AIR-WINDOW")]
    assert len(texts) == len(fallen)
    for text in texts:
        assert text.startswith("the air of the whole flight is used about 2020-")
        assert "climatology" not in text
    # What a window is compared with is the whole flight; no climatology was asked.
    held_out = [text for text in texts if "were not used in the estimate" in text]
    assert held_out
    assert all(text.endswith("K from the whole flight") for text in held_out)


# ---- air that was sampled long ago


@pytest.fixture(scope="module")
def level(soundings) -> Flown:
    """A climb to 3 km, hours of level flight, and no descent, while the ground warms by 4 K."""
    balloon = soundings[0]
    H = np.arange(balloon.H[0], 12_000.0, 10.0)
    warmer = 4.0 * np.exp(-(H - H[0]) / 1500.0)
    t = np.interp(H, balloon.H, balloon.t)
    e = np.exp(np.interp(H, balloon.H, np.log(balloon.e)))
    day = ChangingAir(balloon, replace(balloon, H=H, t=t + warmer, e=e), hours=3.0, count=7)
    sensors = Sensors(noise_k=0.2, pressure_noise_pa=5.0)
    samples = day.fly(climb_of_ten_minutes, sensors, seed=1)
    return flown(day, replace(samples, humidity=None))


def test_sigma_grows_with_the_time_since_the_air_was_sampled(level):
    day = level.day
    whole = level.whole
    assert level.windows == ()
    timed = TimedProfile(whole.time_ns, whole.profile, whole.covariance)
    unaged = constant_series(timed, day.times.size)
    ledger = Ledger()
    series = ledger.take(add_ageing(unaged, day.times, whole.samples, day.top, day.ground))
    sigmas = day.sigmas(series)
    assert sigmas[0] == pytest.approx(day.sigmas(unaged)[0])
    assert np.all(np.diff(sigmas[1:]) > 0.0)
    errors = day.errors([whole.profile] * 7)
    # With the sigma of the estimate alone the last is off by 4.6 of it.
    assert np.abs(errors / sigmas)[3:].max() < 2.5
    (aged,) = ledger
    assert aged.code == "AIR-AGED"
    assert "3.0 h" in aged.what
    assert 4 <= aged.count <= 6
    # The profile itself stays, and the height of the cameras was measured all the time.
    assert all(air.profile is whole.profile for air in series.timed_profiles)
    late = series.timed_profiles[series.profile_number[-1]].covariance
    for name in SIGMAS:
        heights = [day.ground + 300.0, day.top]
        low, high = getattr(late, name)(heights) / getattr(whole.covariance, name)(heights)
        assert low > 1.5
        assert high < 1.15


def test_fresh_air_stays_as_it_is(changing):
    day = changing.day
    times = day.times[:-1]  # in the end it was low 40 minutes ago
    unaged = changing.along(times)
    ground = day.ground + 300.0
    series, notes = add_ageing(unaged, times, changing.whole.samples, day.top, ground)
    assert series is unaged
    assert not notes


def test_nothing_ages_where_nothing_was_measured(changing):
    nothing = AirSamples(SensorSamples(np.empty(0, np.int64), np.empty(0), np.empty(0)))
    ages = sample_ages(nothing, changing.day.times, 0.0, 3000.0)
    assert all(age.is_fresh for age in ages)
    unaged = constant_series(changing.windows[0].air, 0)
    _, notes = add_ageing(unaged, np.empty(0, np.int64), nothing, 1.0, 0.0)
    assert not notes


# ---- windows of time


def sensor(hours, above, accepted=True) -> SensorSamples:
    time_ns = (np.asarray(hours) * HOUR_S * SECOND_NS).astype(np.int64)
    samples = SensorSamples(time_ns, above, np.full(above.size, 280.0))
    return samples if accepted else samples.reject(above > 0.0, Reason.GROUND_SOAK)


TIMES = np.linspace(0.0, 4.0, 2001)


def waves(half_m: float) -> np.ndarray:
    """Up and down all the time."""
    return 1000.0 + half_m * np.sin(TIMES * 20.0)


@pytest.mark.parametrize(
    ("heights", "edges"),
    [
        (waves(500.0), np.arange(0.0, 4.1, 0.5)),
        (waves(140.0), [0.0, 4.0]),
        # A climb, hours of level flight, a descent: the level half hours join their neighbours.
        (np.interp(TIMES, [0.0, 0.3, 3.7, 4.0], [0.0, 3e3, 3e3, 0.0]), [0.0, 1.0, 4.0]),
        # A climb and level flight for ever: one.
        (np.interp(TIMES, [0.0, 0.3], [0.0, 3e3]), [0.0, 4.0]),
        # Nothing of the height that says something.
        (np.full(TIMES.size, 100.0), [0.0, 4.0]),
    ],
    ids=["waves", "low waves", "level", "no descent", "no climb"],
)
def test_windows_span_enough_height(heights, edges):
    """Of a thermometer, and of a barometer alone."""
    flown_at = sensor(TIMES, heights)
    for samples in (AirSamples(flown_at), AirSamples(None, flown_at)):
        hours = np.array(time_windows(samples)) / HOUR_S / SECOND_NS
        np.testing.assert_allclose(hours, list(pairwise(edges)), atol=0.05)


@pytest.mark.parametrize(("hours", "count"), [(0.9, 1), (30.0, 12)])
def test_a_short_flight_is_one_window_and_a_long_one_not_many(hours, count):
    heights = 1000.0 + 500.0 * np.sin(np.linspace(0.0, 600.0, 4001))
    samples = AirSamples(sensor(np.linspace(0.0, hours, 4001), heights))
    assert len(time_windows(samples)) == count


def test_readings_that_no_gate_lets_through_make_no_windows():
    assert time_windows(AirSamples(sensor(TIMES, waves(500.0), accepted=False))) == ()


def test_every_reading_belongs_to_one_window():
    samples = AirSamples(sensor(TIMES, waves(500.0)), sensor(TIMES, waves(500.0)))
    parts = [part_of_flight(samples, *window) for window in time_windows(samples)]
    joined = np.concatenate([part.temperature.time_ns for part in parts])
    assert (joined == samples.temperature.time_ns).all()
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
    return interpolate_series(pair, np.asarray(times_ns, np.int64), [3000.0], 400.0)


@pytest.mark.parametrize("share", [0.25, 0.9])
def test_a_blend_is_linear(pair, share):
    first, second = pair
    mixed = interpolate_profiles(first, second, share)
    h = np.linspace(500.0, 8000.0, 801)
    for name in ("virtual_temperature", "pressure", "refractivity"):
        of_first = getattr(first.profile, name)(h)
        of_second = getattr(second.profile, name)(h)
        mean = (1 - share) * of_first + share * of_second
        # p is not linear in T, but nearly: 20 K apart the second order is 2e-4.
        assert getattr(mixed.profile, name)(h) == pytest.approx(mean, rel=4e-4)
    assert mixed.time_ns == first.time_ns + round(share * (second.time_ns - first.time_ns))


def test_the_ends_of_a_blend_are_the_profiles_themselves(pair):
    assert interpolate_profiles(*pair, 0.0) is pair[0]
    assert interpolate_profiles(*pair, 1.0) is pair[1]


def test_a_blend_is_never_surer_than_its_ends(pair):
    """Whatever the errors of the two have in common: between the sigmas, never below the mix."""
    h = np.linspace(500.0, 6000.0, 50)
    mixed = interpolate_profiles(*pair, 0.5).covariance
    for name in SIGMAS:
        sigmas = np.array([getattr(air.covariance, name)(h) for air in pair])
        of_mixed = getattr(mixed, name)(h)
        assert np.all(of_mixed > 0.97 * sigmas.mean(axis=0))
        assert np.all(of_mixed < 1.03 * sigmas.max(axis=0))


def test_profiles_follow_each_other_closely(pair):
    beyond_ns = 10**12
    series = series_at(
        pair, np.linspace(pair[0].time_ns - beyond_ns, pair[1].time_ns + beyond_ns, 5000)
    )
    airs = series.timed_profiles
    steps = [abs(later.change_from(earlier, [3000.0], 400.0)) for earlier, later in pairwise(airs)]
    assert max(steps) < 5.1e-4  # equal shares of a change that is not quite linear
    assert len(airs) > 50
    assert (np.diff(series.profile_number) >= 0).all()
    assert airs[0] is pair[0]
    assert airs[-1] is pair[1]


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
        assert getattr(series, name)(h) == pytest.approx([float(of_second), float(of_first)])


def test_air_without_a_time_cannot_be_put_in_order(pair):
    timeless = replace(pair[0], time_ns=None)
    with pytest.raises(ValueError, match="time"):
        series_at((timeless, pair[1]), [0])
    with pytest.raises(ValueError, match="both"):
        interpolate_profiles(timeless, pair[1], 0.5)
