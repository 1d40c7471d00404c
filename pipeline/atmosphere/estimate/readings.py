"""From samples, soundings and surface reports to the readings that the estimator takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorCalibration, SensorSamples
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.bins import Bins, bin_readings
from pipeline.atmosphere.estimate.external_readings import (
    departures_of,
    of_report,
    of_sounding,
    of_the_sea,
)
from pipeline.atmosphere.estimate.representativeness import TimeAndPlace
from pipeline.atmosphere.estimate.sensors import (
    BAROMETER_DRIFT,
    BAROMETER_FAULTS,
    DYNAMIC,
    HYGROMETER_FAULT,
    RECOVERY,
    THERMOMETER_DRIFT,
    THERMOMETER_FAULTS,
    Barometer,
    Humidities,
    Source,
    Thermometer,
    Track,
    dynamic_of,
    heating_of,
)
from pipeline.atmosphere.estimate.state import TOP_M, Drift, Fault
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport

Array = NDArray[np.float64]

SHALLOW_M, SHALLOW_BIN_M, BIN_M = 1500.0, 25.0, 50.0
"""Bins are 25 m' where less than 1500 m were sampled, else 50 m'."""

MOST_BINS = 1000
"""... and higher where the legs of a long flight would fill more than these."""

SLICE_S, MOST_SLICES = 30.0, 120
"""Readings so far apart in time are never averaged, in a long flight 1/120 of it: a sensor that
catches up in level flight after a climb tells its lag [s]."""

AIR_NOISE_K, AIR_NOISE_LOG_P, AIR_NOISE_RH = 0.15, 3e-5, 0.03
"""What a bin's mean differs by from the mean air of its height: eddies, the shape of the layer."""

LEAST_SCATTER_K, LEAST_SCATTER_LOG_P, LEAST_SCATTER_RH = 0.05, 5e-5, 0.01

DRIFT_STEP_S, MOST_DRIFT_STEPS = 45.0, 60
"""Knots of drifts; with 300 s the sigma of R over 1 km was 2.3 % and the error 4.1 %."""

UNMEASURED_M = (0.0, 6000.0)
"""Where knots are fine if nothing was measured [m']."""

LONG_AGO_S = -1e5
"""Take-off of a log that begins in the air [s]."""

BOARD_BIAS_K, BOARD_DRIFT_K = 10.0, 5.0
"""A board is so much warmer than the air, and that changes by so much within a quarter hour."""

_GROUND_RISE_M = 20.0


@dataclass(frozen=True, eq=False)
class Sources:
    """Everything that was measured, and the faults it may have; ``rejected`` outliers by sensor."""

    sources: tuple[Source, ...]
    faults: tuple[Fault, ...]
    drifts: tuple[Drift, ...]
    low: float
    high: float
    rejected: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)


def sources_of(
    samples: AirSamples,
    background: Climatology,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    occasion: TimeAndPlace | None = None,
) -> Sources:
    """The readings of a flight in bins, and of soundings and stations, with their faults.

    ``background`` gives gravity, and the shape that bins are averaged about. ``low`` and ``high``
    are the lowest and highest geopotential height [m'] that something was measured at.
    Soundings and stations are weighed by their age and distance from ``occasion``, without one by
    their age at the start of the samples.
    """
    flown = _flown(samples, background)
    found: list[Source] = of_the_sea(background)
    when = occasion or TimeAndPlace(flown.start_ns)
    for number, sounding in enumerate(soundings):
        found += of_sounding(sounding, number, background, when)
    for report in surface:
        found += of_report(report, background, when)
    measured = [*found[1:], *flown.sources]
    heights = np.concatenate([source.height for source in measured] or [np.array(UNMEASURED_M)])
    low, high = float(heights.min()), float(heights.max())
    departures = departures_of(soundings, background, when)
    return Sources(
        (*found, *flown.sources),
        flown.faults,
        (*flown.drifts, *departures),
        low,
        high,
        flown.rejected,
    )


@dataclass(frozen=True, eq=False)
class _Flown:
    sources: tuple[Source, ...]
    faults: tuple[Fault, ...]
    drifts: tuple[Drift, ...]
    rejected: Mapping[str, NDArray[np.bool_]]
    start_ns: int | None


def _flown(samples: AirSamples, background: Climatology) -> _Flown:
    """The sensors of the flight."""
    used = {
        name: sensor
        for name, sensor in (
            ("pressure", samples.pressure),
            ("temperature", samples.temperature),
            ("humidity", samples.humidity),
        )
        if sensor is not None and bool(_usable(sensor, background).any())
    }
    if not used:
        return _Flown((), (), (), {}, None)
    start = min(int(sensor.time_ns[0]) for sensor in used.values())
    end = max(int(sensor.time_ns[-1]) for sensor in used.values())
    duration = max((end - start) * 1e-9, 1.0)
    steps = 1 + min(MOST_DRIFT_STEPS, int(duration / DRIFT_STEP_S))
    course = np.linspace(0.0, duration, steps + 1)
    bins_of = _BinSize(_width(used), max(SLICE_S, duration / MOST_SLICES))
    sources: list[Source] = []
    faults: list[Fault] = []
    drifts: list[Drift] = []
    rejected = {}
    if "pressure" in used:
        bins, source = _barometer(used["pressure"], samples, background, start, bins_of)
        rejected["pressure"] = bins.rejected
        sources.append(source)
        faults += [*BAROMETER_FAULTS, *([DYNAMIC] if source.dynamic is not None else [])]
        drifts.append(Drift(BAROMETER_DRIFT, course, 1.0, 1200.0))
    if "temperature" in used:
        took_off = _takeoffs(samples, used, start)
        bins, warm = _thermometer(
            used["temperature"], samples, background, start, bins_of, took_off
        )
        rejected["temperature"] = bins.rejected
        sources.append(warm)
        board = samples.board_temperature
        bias = replace(THERMOMETER_FAULTS[0], sigma=BOARD_BIAS_K if board else 3.0)
        faults += [bias, *THERMOMETER_FAULTS[1:], *([RECOVERY] if warm.heating is not None else [])]
        known = samples.calibration.get(THERMOMETER_DRIFT, SensorCalibration())
        wander = known.sigma_or(BOARD_DRIFT_K if board else 0.4)
        drifts.append(Drift(THERMOMETER_DRIFT, course, wander, 900.0))
    if "humidity" in used:
        bins, moist = _hygrometer(used["humidity"], background, start, bins_of)
        rejected["humidity"] = bins.rejected
        sources.append(moist)
        faults.append(HYGROMETER_FAULT)
    return _Flown(
        tuple(sources),
        tuple(_calibrated(fault, samples.calibration) for fault in faults),
        tuple(drifts),
        rejected,
        start,
    )


def _calibrated(fault: Fault, calibration: Mapping[str, SensorCalibration]) -> Fault:
    """A fault as the calibration of its sensor expects it."""
    known = calibration.get(fault.name, SensorCalibration())
    return replace(fault, mean=known.mean_or(fault.mean), sigma=known.sigma_or(fault.sigma))


@dataclass(frozen=True)
class _BinSize:
    width_m: float
    slice_s: float


def _width(used: Mapping[str, SensorSamples]) -> float:
    """Of bins [m']: fine in a shallow flight, wider where many legs would fill too many."""
    extent = max(sensor.extent_m for sensor in used.values())
    way = max(_way(sensor) for sensor in used.values())
    return max(SHALLOW_BIN_M if extent < SHALLOW_M else BIN_M, way / MOST_BINS)


def _way(sensor: SensorSamples) -> float:
    """Metres climbed and descended, from heights a quarter minute apart."""
    seconds = _seconds(sensor, int(sensor.time_ns[0]))
    known = np.isfinite(sensor.h_m)
    if known.sum() < 2:
        return 0.0
    h = np.interp(np.arange(0.0, seconds[-1], 15.0), seconds[known], sensor.h_m[known])
    return float(np.abs(np.diff(h)).sum())


def _seconds(sensor: SensorSamples, start: int) -> Array:
    return np.asarray((sensor.time_ns - start).astype(np.float64) * 1e-9)


def _usable(sensor: SensorSamples, background: Climatology) -> NDArray[np.bool_]:
    """Accepted readings at heights that both aircraft and background reach."""
    with np.errstate(invalid="ignore"):
        inside = (sensor.h_m > background.profile.bottom_m + 500.0) & (sensor.h_m < TOP_M - 2000.0)
    return np.asarray(sensor.accepted & inside)


def _binned(
    sensor: SensorSamples,
    departure: Array,
    background: Climatology,
    start: int,
    size: _BinSize,
    floor: float,
) -> Bins:
    seconds = _seconds(sensor, start)
    height = background.profile.gravity.geopotential_height(sensor.h_m)
    usable = _usable(sensor, background)
    return bin_readings(
        seconds, height, departure, usable, width=size.width_m, slice_s=size.slice_s, floor=floor
    )


def _barometer(
    sensor: SensorSamples, samples: AirSamples, background: Climatology, start: int, size: _BinSize
) -> tuple[Bins, Barometer]:
    profile = background.profile
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(sensor.value) - np.log(profile.pressure(sensor.h_m))
    bins = _binned(sensor, departure, background, start, size, LEAST_SCATTER_LOG_P)
    value = bins.value + np.log(profile.pressure(profile.gravity.height(bins.height)))
    airspeed = _airspeed(samples, bins.seconds, start)
    dynamic = None if airspeed is None else dynamic_of(airspeed)
    sigma = np.hypot(bins.sigma, AIR_NOISE_LOG_P)
    return bins, Barometer(sensor.name, bins.seconds, bins.height, value, sigma, dynamic)


def _thermometer(
    sensor: SensorSamples,
    samples: AirSamples,
    background: Climatology,
    start: int,
    size: _BinSize,
    took_off: Array,
) -> tuple[Bins, Thermometer]:
    profile = background.profile
    departure = sensor.value - profile.temperature(sensor.h_m)
    bins = _binned(sensor, departure, background, start, size, LEAST_SCATTER_K)
    h = profile.gravity.height(bins.height)
    value = bins.value + profile.temperature(h)
    airspeed = _airspeed(samples, bins.seconds, start)
    heating = None if airspeed is None else heating_of(airspeed, profile.pressure(h), value)
    known = np.isfinite(sensor.h_m)
    flown = profile.gravity.geopotential_height(sensor.h_m[known])
    track = Track(_seconds(sensor, start)[known], flown)
    last = np.maximum(np.searchsorted(took_off, bins.seconds, side="right") - 1, 0)
    since = np.maximum(bins.seconds - took_off[last], 0.0)
    sigma = np.hypot(bins.sigma, AIR_NOISE_K)
    return bins, Thermometer(
        sensor.name, bins.seconds, bins.height, value, sigma, since, track, heating
    )


def _hygrometer(
    sensor: SensorSamples, background: Climatology, start: int, size: _BinSize
) -> tuple[Bins, Humidities]:
    size = _BinSize(2.0 * size.width_m, size.slice_s)
    bins = _binned(sensor, sensor.value, background, start, size, LEAST_SCATTER_RH)
    sigma = np.hypot(bins.sigma, AIR_NOISE_RH)
    name = HYGROMETER_FAULT.name
    return bins, Humidities(sensor.name, bins.height, bins.value, sigma, fault=name)


def _airspeed(samples: AirSamples, seconds: Array, start: int) -> Array | None:
    """Indicated airspeed [m/s] at times, or None."""
    sensor = samples.airspeed
    if sensor is None:
        return None
    known = np.isfinite(sensor.value)
    if not bool(known.any()):
        return None
    times = _seconds(sensor, start)[known]
    return np.interp(seconds, times, np.maximum(sensor.value[known], 0.0))


def _takeoffs(samples: AirSamples, used: Mapping[str, SensorSamples], start: int) -> Array:
    """Times of take-off [s]; where nobody looked, when the lowest 20 m were first left."""
    if samples.takeoff_ns is not None:
        seen = (samples.takeoff_ns - start) * 1e-9
        return np.asarray(seen) if seen.size else np.array([LONG_AGO_S])
    sensor = used.get("pressure", used["temperature"])
    with np.errstate(invalid="ignore"):
        up = sensor.h_m > np.nanmin(sensor.h_m) + _GROUND_RISE_M
    first = max(int(np.argmax(up)) - 1, 0) if bool(up.any()) else 0
    return np.array([(int(sensor.time_ns[first]) - start) * 1e-9])


def part_of(source: Source, rows: NDArray[np.bool_]) -> Source:
    """Some of the readings of a source."""
    size = source.value.size
    cut = {
        name: values[rows]
        for name, values in vars(source).items()
        if isinstance(values, np.ndarray) and values.shape == (size,)
    }
    return replace(source, **cut)  # type: ignore[type-var]
