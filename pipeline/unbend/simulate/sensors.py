"""Samples of the sensors: the truth at the times of each sensor, with noise that is drawn once.

All three logs have the same samples, or some of them: they differ only in format.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from unbend.simulate.flight import UNDULATION_M, Flight, State, cabin_air
from unbend.simulate.true_air import TrueAir, relative_humidity, temperature_k
from unbend.units import (
    NANOSECONDS_PER_SECOND,
    UNIX_NS_OF_GPS_EPOCH,
    WGS84_A,
    ZERO_CELSIUS_K,
    Array,
    Integers,
)

LOG_BEGINS_UNIX_NS = 1_749_720_600 * NANOSECONDS_PER_SECOND  # 2025-06-12T09:30:00Z
LOG_BEGINS_BOOT_US = 25_000_000
LEAP_SECONDS = 18  # GPS minus UTC since 2017

SECONDS_PER_WEEK = 604_800

GNSS_PERIOD_S = 0.2
NAVIGATION_PERIOD_S = 0.05
PRESSURE_PERIOD_S = 0.1
AIR_PERIOD_S = 0.4  # thermometer and hygrometer

# Sigma of the Gaussian that smooths the slow noise [samples].
GNSS_SMOOTH = 100.0
NAVIGATION_SMOOTH = 400.0
HEADING_SMOOTH = 600.0

# Sigmas of the noise of each sensor, and the bias of the thermometer outside.
GNSS_HORIZONTAL_M = 0.03
GNSS_VERTICAL_M = 0.05
TILT_DEG = 0.02
HEADING_DEG = 0.05
BAROMETER_PA = 20.0
THERMOMETER_K = 0.2
THERMOMETER_BIAS_K = 0.5
HUMIDITY = 0.02
# The last digit of each sensor; so coarse that every log format has the same number.
PRESSURE_DIGIT_PA = 1.0
TEMPERATURE_DIGIT_K = 0.01
HUMIDITY_DIGIT = 1e-4
BOARD_HEAT_K = 15.0  # a barometer's own thermometer sits on a warm board


@dataclass(frozen=True, eq=False)
class GnssSamples(State):
    """Fixes of the receiver, 5 Hz, at the times of the receiver.

    ``log_delay_s``: (n,) time from a fix until its row is written [s].
    """

    log_delay_s: Array

    @property
    def h_ellipsoid_m(self) -> Array:
        """Height above the ellipsoid (n,) [m]."""
        return self.h_msl_m + UNDULATION_M

    @classmethod
    def draw(cls, flight: Flight, rng: np.random.Generator) -> GnssSamples:
        """The samples of a flight, with noise."""
        fixes = _displaced(flight.at(_grid(flight, GNSS_PERIOD_S, 0.0)), rng, GNSS_SMOOTH)
        # Rows are written some milliseconds after the fix, at most 50 ms.
        delay = np.minimum(0.0005 + rng.exponential(0.0015, len(fixes.time_s)), 0.05)
        return cls(**vars(fixes), log_delay_s=np.asarray(np.round(delay, 6), np.float64))


def navigation_samples(flight: Flight, rng: np.random.Generator) -> State:
    """The autopilot's position and attitude, 20 Hz, with noise."""
    state = flight.at(_grid(flight, NAVIGATION_PERIOD_S, 0.003))
    state = _displaced(state, rng, NAVIGATION_SMOOTH)
    count = len(state.time_s)
    tilt = np.radians(TILT_DEG)
    heading = float(np.radians(HEADING_DEG))
    return replace(
        state,
        roll_rad=state.roll_rad + _noise(rng, count, tilt, NAVIGATION_SMOOTH),
        pitch_rad=state.pitch_rad + _noise(rng, count, tilt, NAVIGATION_SMOOTH),
        yaw_rad=state.yaw_rad + _noise(rng, count, heading, HEADING_SMOOTH),
    )


@dataclass(frozen=True, eq=False)
class BoxSamples:
    """A sensor box, outside or in the cabin: barometer at 10 Hz, thermometer, hygrometer at 2.5 Hz.

    ``pressure_time_s``: the times of pressure and of ``board_k``, the temperature of the board;
    ``time_s``: those of temperature and humidity.
    """

    pressure_time_s: Array
    pressure_pa: Array
    board_k: Array
    time_s: Array
    temperature_k: Array
    humidity: Array

    @classmethod
    def outside(cls, flight: Flight, air: TrueAir, rng: np.random.Generator) -> BoxSamples:
        """The samples of the box outside, with noise and the bias of its thermometer."""
        fast_s = _grid(flight, PRESSURE_PERIOD_S, 0.017)
        slow_s = _grid(flight, AIR_PERIOD_S, 0.041)
        h_fast = flight.at(fast_s).h_msl_m
        h_slow = flight.at(slow_s).h_msl_m
        thermometer_error = THERMOMETER_BIAS_K + THERMOMETER_K * rng.standard_normal(len(slow_s))
        humidity = relative_humidity(h_slow) + HUMIDITY * rng.standard_normal(len(slow_s))
        pressure = air.pressure_pa(h_fast) + BAROMETER_PA * rng.standard_normal(len(fast_s))
        return cls(
            pressure_time_s=fast_s,
            pressure_pa=pressure,
            board_k=temperature_k(h_fast) + BOARD_HEAT_K,
            time_s=slow_s,
            temperature_k=temperature_k(h_slow) + thermometer_error,
            humidity=humidity,
        ).read_out()

    @classmethod
    def cabin(cls, flight: Flight, air: TrueAir, rng: np.random.Generator) -> BoxSamples:
        """The samples of the box in the cabin, with noise."""
        fast_s = _grid(flight, PRESSURE_PERIOD_S, 0.053)
        slow_s = _grid(flight, AIR_PERIOD_S, 0.087)
        fast = cabin_air(air, flight.at(fast_s).h_msl_m, fast_s)
        slow = cabin_air(air, flight.at(slow_s).h_msl_m, slow_s)
        humidity = slow.humidity + HUMIDITY * rng.standard_normal(len(slow_s))
        pressure = fast.pressure_pa + BAROMETER_PA * rng.standard_normal(len(fast_s))
        temperature = slow.temperature_k + THERMOMETER_K * rng.standard_normal(len(slow_s))
        return cls(
            pressure_time_s=fast_s,
            pressure_pa=pressure,
            board_k=fast.temperature_k + BOARD_HEAT_K,
            time_s=slow_s,
            temperature_k=temperature,
            humidity=humidity,
        ).read_out()

    def read_out(self) -> BoxSamples:
        """The samples, rounded to the last digit of each sensor."""
        return replace(
            self,
            pressure_pa=_digits(self.pressure_pa, PRESSURE_DIGIT_PA),
            board_k=_celsius_digits(self.board_k),
            temperature_k=_celsius_digits(self.temperature_k),
            humidity=np.clip(_digits(self.humidity, HUMIDITY_DIGIT), 0.0, 1.0),
        )


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
    second = NANOSECONDS_PER_SECOND
    gps_ns = unix_ns(time_s) - UNIX_NS_OF_GPS_EPOCH + LEAP_SECONDS * second
    week, ns_of_week = np.divmod(gps_ns, SECONDS_PER_WEEK * second)
    return week, ns_of_week // 1_000_000


def rows_of(time_us: Integers, *columns: ArrayLike) -> Iterator[tuple[Any, ...]]:
    """Yield tuples of a time and the value of each column at it; a column is (n,) or one value."""
    values = [time_us.tolist()]
    for column in columns:
        values.append(np.broadcast_to(column, time_us.shape).tolist())
    return zip(*values, strict=True)


def sample(flight: Flight, air: TrueAir, seed: int, camera_names: tuple[str, ...]) -> LoggedSamples:
    """Draw every sensor's samples; the same seed gives the same numbers."""
    streams = np.random.SeedSequence(seed).spawn(4)
    generators = [np.random.default_rng(stream) for stream in streams]
    return LoggedSamples(
        gnss=GnssSamples.draw(flight, generators[0]),
        navigation=navigation_samples(flight, generators[1]),
        outside=BoxSamples.outside(flight, air, generators[2]),
        cabin=BoxSamples.cabin(flight, air, generators[3]),
        exposure_s=flight.exposure_s,
        camera_names=camera_names,
    )


def _grid(flight: Flight, period_s: float, first_s: float) -> Array:
    """Times [s] of the samples of a sensor, from ``first_s`` on, rounded to milliseconds."""
    count = int((flight.duration_s - first_s - 0.1) / period_s)
    return np.round(first_s + period_s * np.arange(count), 3)


def _noise(rng: np.random.Generator, count: int, sigma: float, smooth_samples: float) -> Array:
    """(count,) noise with a sigma; nine tenths of its variance are slow, the rest is white.

    The slow part is white noise smoothed by a Gaussian with a sigma of ``smooth_samples``.
    """
    white = rng.standard_normal(count)
    smooth = gaussian_filter1d(rng.standard_normal(count), smooth_samples, mode="wrap")
    slow = smooth * np.sqrt(2.0 * np.sqrt(np.pi) * smooth_samples)  # of unit variance
    return np.asarray(sigma * (np.sqrt(0.9) * slow + np.sqrt(0.1) * white))


def _displaced(truth: State, rng: np.random.Generator, smooth_samples: float) -> State:
    """The true states with the noise of a receiver in position and height (`_noise`)."""
    lat = truth.lat_rad
    count = len(truth.time_s)
    north = _noise(rng, count, GNSS_HORIZONTAL_M, smooth_samples)
    east = _noise(rng, count, GNSS_HORIZONTAL_M, smooth_samples)
    return replace(
        truth,
        lat_rad=lat + north / WGS84_A,
        lon_rad=truth.lon_rad + east / (WGS84_A * np.cos(lat)),
        h_msl_m=truth.h_msl_m + _noise(rng, count, GNSS_VERTICAL_M, smooth_samples),
    )


def _celsius_digits(temperature: Array) -> Array:
    """Temperatures [K], rounded to the last digit of a sensor that reads degrees Celsius."""
    celsius = _digits(temperature - ZERO_CELSIUS_K, TEMPERATURE_DIGIT_K)
    return ZERO_CELSIUS_K + celsius


def _digits(values: Array, digit: float) -> Array:
    """Values rounded to whole multiples of ``digit``."""
    return np.asarray(digit * np.rint(values / digit))
