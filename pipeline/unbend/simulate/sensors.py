"""What the sensors of the aircraft report: truth sampled on one grid a sensor, noise drawn once.

All three logs carry (a subset of) these samples, so they differ in nothing but their format.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

import unbend.units as units
from unbend.simulate.flight import UNDULATION_M, Flight, State, cabin_air
from unbend.simulate.true_air import TrueAir, relative_humidity, temperature_k
from unbend.units import Array, Integers

LOG_BEGINS_UNIX_NS = 1_749_720_600 * units.NANOSECONDS_PER_SECOND  # 2025-06-12T09:30:00Z
LOG_BEGINS_BOOT_US = 25_000_000
LEAP_SECONDS = 18  # GPS minus UTC since 2017

GNSS_HORIZONTAL_M = 0.03
GNSS_VERTICAL_M = 0.05
TILT_DEG = 0.02
HEADING_DEG = 0.05
BAROMETER_PA = 20.0
THERMOMETER_K = 0.2
THERMOMETER_BIAS_K = 0.5
HUMIDITY = 0.02
# What the last digit of a sensor is; coarse enough for every log to carry the same number.
PRESSURE_DIGIT_PA = 1.0
TEMPERATURE_DIGIT_K = 0.01
HUMIDITY_DIGIT = 1e-4
BOARD_HEAT_K = 15.0  # a barometer's own thermometer sits on a warm board


@dataclass(frozen=True, eq=False)
class GnssSamples(State):
    """Receiver fixes, 5 Hz, on the receiver's own time, and how late [s] each row is written."""

    log_delay_s: Array

    @property
    def h_ellipsoid_m(self) -> Array:
        """Height above the ellipsoid (n,) [m]."""
        return self.h_msl_m + UNDULATION_M

    @classmethod
    def draw(cls, flight: Flight, rng: np.random.Generator) -> GnssSamples:
        """The samples of a flight, with noise."""
        fixes = _displaced(flight.at(_grid(flight, 0.2, 0.0)), rng, 100.0)
        # A time-tagged receiver: the row is written within milliseconds, and now and then late.
        delay = np.minimum(0.0005 + rng.exponential(0.0015, len(fixes.time_s)), 0.05)
        return cls(**vars(fixes), log_delay_s=np.asarray(np.round(delay, 6), np.float64))


def navigation_samples(flight: Flight, rng: np.random.Generator) -> State:
    """The autopilot's position and attitude, 20 Hz, with noise."""
    state = _displaced(flight.at(_grid(flight, 0.05, 0.003)), rng, 400.0)
    count, tilt = len(state.time_s), np.radians(TILT_DEG)
    return replace(
        state,
        roll_rad=state.roll_rad + _noise(rng, count, tilt, 400.0),
        pitch_rad=state.pitch_rad + _noise(rng, count, tilt, 400.0),
        yaw_rad=state.yaw_rad + _noise(rng, count, float(np.radians(HEADING_DEG)), 600.0),
    )


@dataclass(frozen=True, eq=False)
class BoxSamples:
    """A box outside or in the cabin: barometer at 10 Hz, thermometer, hygrometer at 2.5 Hz."""

    pressure_time_s: Array
    pressure_pa: Array
    board_k: Array
    time_s: Array
    temperature_k: Array
    humidity: Array

    @classmethod
    def outside(cls, flight: Flight, air: TrueAir, rng: np.random.Generator) -> BoxSamples:
        """The samples of the box outside, with noise and the bias of its thermometer."""
        fast, slow = _grid(flight, 0.1, 0.017), _grid(flight, 0.4, 0.041)
        h_fast, h_slow = flight.at(fast).h_msl_m, flight.at(slow).h_msl_m
        warmer = THERMOMETER_BIAS_K + THERMOMETER_K * rng.standard_normal(len(slow))
        humidity = relative_humidity(h_slow) + HUMIDITY * rng.standard_normal(len(slow))
        pressure = air.pressure_pa(h_fast) + BAROMETER_PA * rng.standard_normal(len(fast))
        board = temperature_k(h_fast) + BOARD_HEAT_K
        temperature = temperature_k(h_slow) + warmer
        return _read_out((fast, pressure, board), (slow, temperature, humidity))

    @classmethod
    def cabin(cls, flight: Flight, air: TrueAir, rng: np.random.Generator) -> BoxSamples:
        """The samples of the box in the cabin, with noise."""
        fast, slow = _grid(flight, 0.1, 0.053), _grid(flight, 0.4, 0.087)
        at_fast = cabin_air(air, flight.at(fast).h_msl_m, fast)
        at_slow = cabin_air(air, flight.at(slow).h_msl_m, slow)
        humidity = at_slow.humidity + HUMIDITY * rng.standard_normal(len(slow))
        pressure = at_fast.pressure_pa + BAROMETER_PA * rng.standard_normal(len(fast))
        temperature = at_slow.temperature_k + THERMOMETER_K * rng.standard_normal(len(slow))
        board = at_fast.temperature_k + BOARD_HEAT_K
        return _read_out((fast, pressure, board), (slow, temperature, humidity))


@dataclass(frozen=True, eq=False)
class LoggedSamples:
    """Everything that goes into the logs."""

    gnss: GnssSamples
    navigation: State
    outside: BoxSamples
    cabin: BoxSamples
    exposure_s: Array
    camera_names: tuple[str, ...]


def boot_us(time_s: Array) -> Integers:
    """Microseconds since boot (n,) of times since the log began [s]."""
    return np.asarray(np.rint(time_s * 1e6), np.int64) + LOG_BEGINS_BOOT_US


def unix_ns(time_s: Array) -> Integers:
    """UTC, Unix nanoseconds (n,), whole microseconds, of times since the log began [s]."""
    return np.asarray(np.rint(time_s * 1e6), np.int64) * 1000 + LOG_BEGINS_UNIX_NS


def gps_week_ms(time_s: Array) -> tuple[Integers, Integers]:
    """GPS week and milliseconds of the week (n,) of times since the log began [s]."""
    second = units.NANOSECONDS_PER_SECOND
    gps_ns = unix_ns(time_s) - units.UNIX_NS_OF_GPS_EPOCH + LEAP_SECONDS * second
    week, rest = np.divmod(gps_ns, 604_800 * second)
    return week, rest // 1_000_000


def rows_of(time_us: Integers, *columns: ArrayLike) -> Iterator[tuple[Any, ...]]:
    """Rows of (n,) times and columns, which are (n,) or one value for all."""
    values = (np.broadcast_to(column, time_us.shape).tolist() for column in (time_us, *columns))
    return zip(*values, strict=True)


def sample(flight: Flight, air: TrueAir, seed: int, camera_names: tuple[str, ...]) -> LoggedSamples:
    """Draw every sensor's samples; the same seed gives the same numbers."""
    gnss, navigation, outside, cabin = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)
    )
    places = GnssSamples.draw(flight, gnss), navigation_samples(flight, navigation)
    boxes = BoxSamples.outside(flight, air, outside), BoxSamples.cabin(flight, air, cabin)
    return LoggedSamples(*places, *boxes, flight.exposure_s, camera_names)


def _grid(flight: Flight, period_s: float, first_s: float) -> Array:
    """Sampling times, whole milliseconds as the messages carry them."""
    count = int((flight.duration_s - first_s - 0.1) / period_s)
    return np.round(first_s + period_s * np.arange(count), 3)


def _noise(rng: np.random.Generator, count: int, sigma: float, samples: float) -> Array:
    """Noise of which nine tenths are slow, white under a Gaussian of so many samples."""
    white = rng.standard_normal(count)
    smooth = gaussian_filter1d(rng.standard_normal(count), samples, mode="wrap")
    slow = smooth * np.sqrt(2.0 * np.sqrt(np.pi) * samples)  # of unit variance
    return np.asarray(sigma * (np.sqrt(0.9) * slow + np.sqrt(0.1) * white))


def _displaced(truth: State, rng: np.random.Generator, samples: float) -> State:
    """A true state with the noise of a receiver's place and height."""
    lat, count = truth.lat_rad, len(truth.time_s)
    north = _noise(rng, count, GNSS_HORIZONTAL_M, samples)
    east = _noise(rng, count, GNSS_HORIZONTAL_M, samples)
    return replace(
        truth,
        lat_rad=lat + north / units.WGS84_A,
        lon_rad=truth.lon_rad + east / (units.WGS84_A * np.cos(lat)),
        h_msl_m=truth.h_msl_m + _noise(rng, count, GNSS_VERTICAL_M, samples),
    )


def _read_out(fast: tuple[Array, Array, Array], slow: tuple[Array, Array, Array]) -> BoxSamples:
    """Readings to the last digit of each sensor: time, pressure, board; time, air, humidity."""
    fast_s, pressure_pa, board_k = fast
    slow_s, air_k, humidity = slow
    return BoxSamples(
        fast_s,
        _digits(pressure_pa, PRESSURE_DIGIT_PA),
        units.ZERO_CELSIUS_K + _digits(board_k - units.ZERO_CELSIUS_K, TEMPERATURE_DIGIT_K),
        slow_s,
        units.ZERO_CELSIUS_K + _digits(air_k - units.ZERO_CELSIUS_K, TEMPERATURE_DIGIT_K),
        np.clip(_digits(humidity, HUMIDITY_DIGIT), 0.0, 1.0),
    )


def _digits(values: Array, digit: float) -> Array:
    return np.asarray(digit * np.rint(values / digit))
