"""From the samples of a flight to the readings of the estimator: means in bins, and faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import external_readings, sensors
from unbend.atmosphere.estimate.binning import (
    CLIMB_WINDOW_S,
    CLIMBING_M_S,
    Bins,
    Digits,
    bin_readings,
    resolution_of,
)
from unbend.atmosphere.estimate.hypotheses import RARE_FAULTS, RareFault
from unbend.atmosphere.estimate.sensor_drifts import (
    barometer_drift,
    drift_knots,
    thermometer_drift,
)
from unbend.atmosphere.estimate.sensors import Readings, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import TOP_M, Departure, Drift, Fault, SensorFault
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason, Reasons, with_reason
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.units import Array, Mask

SHALLOW_M = 1500.0
SHALLOW_BIN_M = 25.0  # the height of bins where less than 1500 m were sampled [m']
BIN_M = 50.0  # else

MOST_BINS = 1000
"""Bins are higher where the climbs and descents of a long flight would fill more than these."""

SLICE_S = 30.0
MOST_SLICES = 120
"""Readings so far apart in time are never averaged, in a long flight 1/120 of it: a sensor that
catches up in level flight after a climb determines its lag [s]."""

# Sigma of a bin's mean about the mean air of its height: eddies, the shape of the layer.
AIR_NOISE_K = 0.15
AIR_NOISE_LOG_P = 3e-5
AIR_NOISE_RH = 0.03

# The smallest scatter of readings about the mean of their bin that is assumed.
LEAST_SCATTER_K = 0.05
LEAST_SCATTER_LOG_P = 5e-5
LEAST_SCATTER_RH = 0.01

UNMEASURED_M = (0.0, 6000.0)  # where knots are fine if nothing was measured [m']
LONG_AGO_S = -1e5  # take-off of a log that begins in the air [s]

BOARD_BIAS_K = 10.0  # a board is so much warmer than the air
USUAL_BIAS_K = 3.0  # the same of a thermometer outside

_BELOW_BOTTOM_M = 500.0  # from the lowest height of the background that readings are used
_BELOW_TOP_M = 2000.0
_GROUND_RISE_M = 20.0


@dataclass(frozen=True, eq=False)
class FlightReadings:
    """Everything that was measured, from ``low`` to ``high`` [m'], and the faults it may have.

    ``rare`` are those that few sensors have; ``rejected`` says of each sensor why samples are not
    used, outliers too.
    """

    sets: tuple[Readings, ...]
    faults: tuple[Fault, ...]
    drifts: tuple[Drift | Departure, ...]
    low: float
    high: float
    rejected: Mapping[str, Reasons] = field(default_factory=dict)
    rare: tuple[RareFault, ...] = ()


@dataclass(eq=False)
class _OwnReadings:
    """The readings of the flight's own sensors, with their faults and drifts, as they are added."""

    sets: list[Readings] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    drifts: list[Drift] = field(default_factory=list)
    rejected: dict[str, Reasons] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Conditions:
    """How a thermometer was flown: airspeed, times of the take-offs [s], and heights."""

    airspeed: SensorSamples | None
    takeoffs_s: Array
    flown: sensors.FlownHeights


def collect_readings(
    samples: AirSamples,
    background: Climatology,
    settings: SensorSettings,
    *,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    flight: external_readings.TimeAndPlace | None = None,
) -> FlightReadings:
    """The readings of a flight in bins, and of soundings and stations, with their faults.

    Bins are averaged about ``background``. Soundings and stations are weighted by their age and
    distance from ``flight``, without it by their age at the start of the samples.
    """
    instruments: dict[str, SensorSamples] = {}
    for name, sensor in samples.sensors.items():
        if bool(_usable(sensor, background.profile).any()):
            instruments[name] = sensor
    start_ns = min((int(sensor.time_ns[0]) for sensor in instruments.values()), default=None)
    flight = flight or external_readings.TimeAndPlace(start_ns)
    measured = _OwnReadings()
    if start_ns is not None:
        measured = _sensor_readings(samples, instruments, background.profile, start_ns, settings)
    sets = [
        *_external_readings(soundings, surface, background, flight),
        *measured.sets,
    ]
    heights = [readings.height for readings in sets]
    span = np.concatenate(heights or [np.array(UNMEASURED_M)])
    faults = tuple(_as_calibrated(fault, settings) for fault in measured.faults)
    drifts: tuple[Drift | Departure, ...] = (
        *measured.drifts,
        *external_readings.humidity_drifts(soundings, background, flight),
        *external_readings.sounding_departures(soundings, background, flight),
    )
    return FlightReadings(
        sets=(_at_sea_level(background), *sets),
        faults=faults,
        drifts=drifts,
        low=float(span.min()),
        high=float(span.max()),
        rejected=measured.rejected,
        rare=_rare_faults(faults, settings),
    )


def _external_readings(
    soundings: Sequence[Sounding],
    surface: Sequence[SurfaceReport],
    background: Climatology,
    flight: external_readings.TimeAndPlace,
) -> list[Readings]:
    """The readings of soundings and stations."""
    sets: list[Readings] = []
    for number, sounding in enumerate(soundings):
        sets += external_readings.sounding_readings(sounding, number, background, flight)
    for report in surface:
        sets += external_readings.surface_readings(report, background, flight)
    return sets


def _as_calibrated(fault: Fault, settings: SensorSettings) -> Fault:
    """A fault with the mean and sigma that a calibration states of it."""
    calibration = settings.calibration.get(fault.name, SensorCalibration())
    mean = fault.mean if calibration.mean is None else calibration.mean
    return replace(fault, mean=mean, sigma=calibration.sigma_or(fault.sigma))


def _at_sea_level(background: Climatology) -> sensors.Pressures:
    """The pressure at sea level that a climatology expects, as a reading."""
    at_sea = np.zeros(1)
    log_pressure = np.log(background.profile.pressure(at_sea))
    sigma = np.array([background.spread.pressure_ratio])
    return sensors.Pressures("climatology", at_sea, log_pressure, sigma, robust=False)


def _rare_faults(faults: Sequence[Fault], settings: SensorSettings) -> tuple[RareFault, ...]:
    """The rare faults that the sensors of a flight may have.

    None of those whose size is stated. No bay for a thermometer stated to sit on a board, nor
    without a barometer: the climatology alone does not tell a bay from unusual air.
    """
    if settings.usual_errors_only:
        return ()
    possible = {fault.name for fault in faults}
    has_barometer = SensorFault.PRESSURE_OFFSET in possible
    for name, calibration in settings.calibration.items():
        if calibration.sigma is not None:
            possible.discard(name)
    if settings.board_temperature or not has_barometer:
        possible.discard(SensorFault.BAY_SHARE)
    return tuple(rare for rare in RARE_FAULTS if rare.faults.keys() <= possible)


def _sensor_readings(
    samples: AirSamples,
    instruments: Mapping[str, SensorSamples],
    profile: Profile,
    start_ns: int,
    settings: SensorSettings,
) -> _OwnReadings:
    """The readings of the flight's own sensors, with their faults and drifts."""
    readings = _OwnReadings()
    end_ns = max(int(sensor.time_ns[-1]) for sensor in instruments.values())
    duration_s = max((end_ns - start_ns) * 1e-9, 1.0)
    binning = _Binning.of_flight(instruments, profile, start_ns, duration_s)
    has_thermometer = "temperature" in instruments
    knots = drift_knots(duration_s, settings, with_thermometer=has_thermometer)
    barometer = instruments.get("pressure")
    if barometer is not None:
        _add_barometer(readings, barometer, samples, binning, settings)
        drift = barometer_drift(knots, settings, with_thermometer=has_thermometer)
        readings.drifts.append(drift)
    thermometer = instruments.get("temperature")
    if thermometer is not None:
        conditions = _Conditions(
            samples.airspeed,
            _takeoffs(samples, thermometer if barometer is None else barometer, start_ns),
            binning.flown_heights(thermometer),
        )
        _add_thermometer(readings, thermometer, conditions, binning, settings)
        readings.drifts.append(thermometer_drift(knots, settings))
    hygrometer = instruments.get("humidity")
    if hygrometer is not None:
        _add_hygrometer(readings, hygrometer, binning)
    return readings


def _add_barometer(
    readings: _OwnReadings,
    sensor: SensorSamples,
    samples: AirSamples,
    binning: _Binning,
    settings: SensorSettings,
) -> None:
    """Readings of a static pressure, and its faults."""
    profile = binning.profile
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(sensor.value) - np.log(profile.pressure(sensor.h_m))
        step = resolution_of(sensor) / sensor.value
    bins = binning.bins(sensor, departure, LEAST_SCATTER_LOG_P, step)
    readings.rejected["pressure"] = binning.reasons(sensor, bins)
    h = profile.gravity.height(bins.height)
    log_pressure = bins.value + np.log(profile.pressure(h))
    airspeed = binning.airspeed_at(bins.seconds, samples.airspeed)
    dynamic = None if airspeed is None else sensors.dynamic_of(airspeed)
    highest = settings.highest
    if highest is None:
        highest = float(log_pressure.max())
    barometer = sensors.Barometer(
        sensor.name,
        bins.height,
        log_pressure,
        np.hypot(bins.sigma, AIR_NOISE_LOG_P),
        seconds=bins.seconds,
        highest=highest,
        dynamic=dynamic,
    )
    readings.sets.append(barometer)
    readings.faults += sensors.BAROMETER_FAULTS
    if dynamic is not None:
        readings.faults.append(sensors.DYNAMIC_PRESSURE_ERROR)


def _add_thermometer(
    readings: _OwnReadings,
    sensor: SensorSamples,
    conditions: _Conditions,
    binning: _Binning,
    settings: SensorSettings,
) -> None:
    """Readings of a thermometer, and its faults."""
    departure = sensor.value - binning.profile.temperature(sensor.h_m)
    bins = binning.bins(sensor, departure, LEAST_SCATTER_K, resolution_of(sensor))
    readings.rejected["temperature"] = binning.reasons(sensor, bins)
    thermometer = _thermometer(sensor, bins, conditions, binning)
    readings.sets.append(thermometer)

    bias_k = BOARD_BIAS_K if settings.board_temperature else USUAL_BIAS_K
    bias, *other_faults = sensors.THERMOMETER_FAULTS
    readings.faults += [replace(bias, sigma=bias_k), *other_faults]
    if thermometer.heating is not None:
        readings.faults.append(sensors.RECOVERY_FACTOR)


def _add_hygrometer(readings: _OwnReadings, sensor: SensorSamples, binning: _Binning) -> None:
    """Readings of a hygrometer in bins of twice the height, and its bias."""
    high_bins = replace(binning, width_m=2.0 * binning.width_m)
    bins = high_bins.bins(sensor, sensor.value, LEAST_SCATTER_RH, resolution_of(sensor))
    hygrometer = sensors.Humidities(
        sensor.name,
        bins.height,
        bins.value,
        np.hypot(bins.sigma, AIR_NOISE_RH),
        fault=sensors.HYGROMETER_BIAS.name,
    )
    readings.sets.append(hygrometer)
    readings.rejected["humidity"] = high_bins.reasons(sensor, bins)
    readings.faults.append(sensors.HYGROMETER_BIAS)


def _usable(sensor: SensorSamples, profile: Profile) -> Mask:
    """Accepted readings at heights that both aircraft and background reach."""
    return np.asarray(sensor.accepted & _is_within(profile, sensor.h_m))


def _is_within(profile: Profile, height_m: Array) -> Mask:
    """Which heights both aircraft and background reach; none that is not known."""
    with np.errstate(invalid="ignore"):
        is_above_bottom = height_m > profile.bottom_m + _BELOW_BOTTOM_M
        is_below_top = height_m < TOP_M - _BELOW_TOP_M
    return np.asarray(is_above_bottom & is_below_top)


def _seconds(sensor: SensorSamples, start_ns: int) -> Array:
    """(n,) seconds of its readings since a time [Unix ns]."""
    nanoseconds = (sensor.time_ns - start_ns).astype(np.float64)
    return np.asarray(nanoseconds * 1e-9)


@dataclass(frozen=True, eq=False)
class _Binning:
    """The bins of a flight: their size, the first time, and the profile they are averaged about."""

    profile: Profile
    start_ns: int
    width_m: float
    slice_s: float

    @classmethod
    def of_flight(
        cls,
        instruments: Mapping[str, SensorSamples],
        profile: Profile,
        start_ns: int,
        duration_s: float,
    ) -> _Binning:
        """Thin bins in a shallow flight, thicker where many climbs would fill too many."""
        extent_m = max(sensor.extent_m for sensor in instruments.values())
        climbed_m = max(sensor.climbed_m for sensor in instruments.values())
        width_m = SHALLOW_BIN_M if extent_m < SHALLOW_M else BIN_M
        return cls(
            profile,
            start_ns,
            width_m=max(width_m, climbed_m / MOST_BINS),
            slice_s=max(SLICE_S, duration_s / MOST_SLICES),
        )

    def bins(
        self,
        sensor: SensorSamples,
        departure: Array,
        floor: float,
        step: Array | float,
    ) -> Bins:
        """Means of a departure from the profile that is averaged about; ``step`` of the sensor."""
        return bin_readings(
            _seconds(sensor, self.start_ns),
            self.profile.gravity.geopotential_height(sensor.h_m),
            departure,
            _usable(sensor, self.profile),
            width=self.width_m,
            slice_s=self.slice_s,
            floor=floor,
            digits=Digits(sensor.value, step),
        )

    def reasons(self, sensor: SensorSamples, bins: Bins) -> Reasons:
        """(n,) why samples of a sensor are not in its bins."""
        outside = ~_is_within(self.profile, sensor.h_m)
        reasons = with_reason(sensor.rejected, outside, Reason.OUTSIDE_CLIMATOLOGY)
        return with_reason(reasons, bins.rejected, Reason.OUTLIER)

    def airspeed_at(self, seconds: Array, sensor: SensorSamples | None) -> Array | None:
        """Indicated airspeed [m/s] at times, or None."""
        if sensor is None:
            return None
        is_finite = np.isfinite(sensor.value)
        if not bool(is_finite.any()):
            return None
        times = _seconds(sensor, self.start_ns)[is_finite]
        speeds = np.maximum(sensor.value[is_finite], 0.0)
        return np.interp(seconds, times, speeds)

    def flown_heights(self, sensor: SensorSamples) -> sensors.FlownHeights:
        """The heights [m'] and times [s] that a sensor was read at."""
        has_height = np.isfinite(sensor.h_m)
        height = self.profile.gravity.geopotential_height(sensor.h_m[has_height])
        seconds = _seconds(sensor, self.start_ns)[has_height]
        return sensors.FlownHeights(seconds, height)


def _takeoffs(samples: AirSamples, height_source: SensorSamples, start_ns: int) -> Array:
    """Times of the take-offs since ``start_ns`` [s]; long ago if the log begins in the air.

    Where they are not known, it is the last sample of ``height_source``, which knows heights best,
    before it first left the lowest 20 m; its first sample, if it never did.
    """
    if samples.takeoff_ns is None:
        with np.errstate(invalid="ignore"):
            is_up = height_source.h_m > np.nanmin(height_source.h_m) + _GROUND_RISE_M
        last_low = 0
        if bool(is_up.any()):
            last_low = max(int(np.argmax(is_up)) - 1, 0)
        takeoff_ns = int(height_source.time_ns[last_low])
        return np.array([(takeoff_ns - start_ns) * 1e-9])
    if samples.takeoff_ns.size == 0:  # in the air from the beginning
        return np.array([LONG_AGO_S])
    return np.asarray((samples.takeoff_ns - start_ns) * 1e-9)


def _thermometer(
    sensor: SensorSamples,
    bins: Bins,
    conditions: _Conditions,
    binning: _Binning,
) -> sensors.Thermometer:
    """Readings of a thermometer, since which take-off, and in which airspeed and climb."""
    profile = binning.profile
    h = profile.gravity.height(bins.height)
    temperature_k = bins.value + profile.temperature(h)
    speed = binning.airspeed_at(bins.seconds, conditions.airspeed)
    heating = None
    if speed is not None:
        heating = sensors.heating_of(speed, profile.pressure(h), temperature_k)
    last = np.searchsorted(conditions.takeoffs_s, bins.seconds, side="right") - 1
    since_s = bins.seconds - conditions.takeoffs_s[np.maximum(last, 0)]
    heights = conditions.flown
    half_s = 0.5 * CLIMB_WINDOW_S
    rise_m = heights.at(bins.seconds + half_s) - heights.at(bins.seconds - half_s)
    is_climbing = rise_m > CLIMB_WINDOW_S * CLIMBING_M_S
    return sensors.Thermometer(
        sensor.name,
        bins.height,
        temperature_k,
        np.hypot(bins.sigma, AIR_NOISE_K),
        seconds=bins.seconds,
        since_s=np.maximum(since_s, 0.0),
        flown=heights,
        climbing=np.where(is_climbing, 1.0, 0.0),
        heating=heating,
    )
