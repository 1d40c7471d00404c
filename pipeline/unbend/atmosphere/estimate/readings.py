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
from unbend.atmosphere.estimate.knots import TOP_M
from unbend.atmosphere.estimate.sensor_drifts import (
    barometer_drift,
    drift_knots,
    thermometer_drift,
)
from unbend.atmosphere.estimate.sensors import Readings, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import Departure, Drift, Fault, SensorFault
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
"""Readings are averaged over 30 s at most, in a long flight over 1/120 of it. Longer means would
hide how a sensor catches up in level flight after a climb, which determines its lag."""

# One sigma of how the air of a bin differs from the mean air of its height: eddies, and the shape
# of the layer.
AIR_NOISE_K = 0.15
AIR_NOISE_LOG_P = 3e-5
AIR_NOISE_RH = 0.03

# The smallest scatter of readings about the mean of their bin that is assumed.
LEAST_SCATTER_K = 0.05
LEAST_SCATTER_LOG_P = 5e-5
LEAST_SCATTER_RH = 0.01

UNMEASURED_M = (0.0, 6000.0)  # range of heights with fine knots if nothing was measured [m']
LONG_AGO_S = -1e5  # take-off of a log that begins in the air [s]

# One sigma of the bias of a thermometer.
BOARD_BIAS_K = 10.0  # on a circuit board
USUAL_BIAS_K = 3.0  # outside

# Readings nearer to the ends of the background, or of the knots, are not used.
_MARGIN_AT_BOTTOM_M = 500.0
_MARGIN_AT_TOP_M = 2000.0
_GROUND_RISE_M = 20.0  # above the lowest height of a flight, where it has taken off


@dataclass(frozen=True, eq=False)
class FlightReadings:
    """Everything that was measured, from ``low`` to ``high`` [m'], and the errors it may have.

    ``faults``, ``drifts``: with their priors for usual sensors; ``rare``: the rare faults that the
    sensors may have. ``rejected``: by quantity, why samples of the sensor are not used; outliers
    included.
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
    """The readings of the flight's own sensors, with their faults and drifts.

    Empty at first; the ``_add_`` functions append to it.
    """

    sets: list[Readings] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    drifts: list[Drift] = field(default_factory=list)
    rejected: dict[str, Reasons] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Conditions:
    """How a thermometer was flown: airspeed, take-offs by their times since the start, heights."""

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
    """The readings of a flight in bins, of soundings, stations and the climatology's sea level.

    The means of bins are of departures from ``background``. The errors of soundings and stations
    grow with their time and distance from ``flight``; without it, with their time from the start of
    the samples.
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
    heights_of_sets = [readings.height for readings in sets]
    heights = np.concatenate(heights_of_sets or [np.array(UNMEASURED_M)])
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
        low=float(heights.min()),
        high=float(heights.max()),
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
    """A fault with the mean and sigma that a calibration states, as far as it states them."""
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
    """The rare faults that the sensors of a flight may have, where their ``faults`` are these.

    A fault of stated size has no rare one. A thermometer is not assumed to be in a bay if the
    mission file states that it is on a circuit board. Nor without a barometer, because the
    climatology alone cannot distinguish a bay from unusual air.
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
    """The readings of the flight's own sensors, with their faults and drifts.

    ``instruments``: the sensors with usable readings, by quantity. ``start_ns``: their first sample
    [Unix ns]; all times [s] count from it.
    """
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
    """Add the readings of a static pressure (ln p), and its faults, to ``readings``."""
    profile = binning.profile
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(sensor.value) - np.log(profile.pressure(sensor.h_m))
        step = resolution_of(sensor) / sensor.value
    bins = binning.bins(sensor, departure, LEAST_SCATTER_LOG_P, step)
    readings.rejected["pressure"] = binning.reasons(sensor, bins)
    h = profile.gravity.height(bins.height)
    log_pressure = bins.value + np.log(profile.pressure(h))
    airspeed = binning.airspeed_at(bins.seconds, samples.airspeed)
    dynamic_pa = None if airspeed is None else sensors.dynamic_pressure(airspeed)
    highest_log_p = settings.highest_log_p
    if highest_log_p is None:
        highest_log_p = float(log_pressure.max())
    barometer = sensors.Barometer(
        sensor.name,
        bins.height,
        log_pressure,
        np.hypot(bins.sigma, AIR_NOISE_LOG_P),
        seconds=bins.seconds,
        highest_log_p=highest_log_p,
        dynamic_pa=dynamic_pa,
    )
    readings.sets.append(barometer)
    readings.faults += sensors.BAROMETER_FAULTS
    if dynamic_pa is not None:
        readings.faults.append(sensors.DYNAMIC_PRESSURE_ERROR)


def _add_thermometer(
    readings: _OwnReadings,
    sensor: SensorSamples,
    conditions: _Conditions,
    binning: _Binning,
    settings: SensorSettings,
) -> None:
    """Add the readings of a thermometer, and its faults, to ``readings``."""
    departure = sensor.value - binning.profile.temperature(sensor.h_m)
    bins = binning.bins(sensor, departure, LEAST_SCATTER_K, resolution_of(sensor))
    readings.rejected["temperature"] = binning.reasons(sensor, bins)
    thermometer = _thermometer(sensor, bins, conditions, binning)
    readings.sets.append(thermometer)

    bias_k = BOARD_BIAS_K if settings.board_temperature else USUAL_BIAS_K
    bias, *other_faults = sensors.THERMOMETER_FAULTS
    readings.faults += [replace(bias, sigma=bias_k), *other_faults]
    if thermometer.heating_k is not None:
        readings.faults.append(sensors.RECOVERY_FACTOR)


def _add_hygrometer(readings: _OwnReadings, sensor: SensorSamples, binning: _Binning) -> None:
    """Add the readings of a hygrometer in bins of twice the height, and its bias."""
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
    """(n,) which readings are accepted and at heights of the background (`_is_within`)."""
    return np.asarray(sensor.accepted & _is_within(profile, sensor.h_m))


def _is_within(profile: Profile, height_m: Array) -> Mask:
    """Which heights [m] are well inside the background and the knots; False for NaN."""
    with np.errstate(invalid="ignore"):
        is_above_bottom = height_m > profile.bottom_m + _MARGIN_AT_BOTTOM_M
        is_below_top = height_m < TOP_M - _MARGIN_AT_TOP_M
    return np.asarray(is_above_bottom & is_below_top)


def _seconds(sensor: SensorSamples, start_ns: int) -> Array:
    """(n,) times of a sensor's readings [s], since ``start_ns`` [Unix ns]."""
    nanoseconds = (sensor.time_ns - start_ns).astype(np.float64)
    return np.asarray(nanoseconds * 1e-9)


@dataclass(frozen=True, eq=False)
class _Binning:
    """How the readings of a flight are averaged in bins: as departures from ``profile``.

    ``start_ns``: time from which seconds count [Unix ns]. ``width_m``, ``slice_s``: size of a bin
    in height [m'] and in time.
    """

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
        """Thin bins in a shallow flight, thicker ones where many climbs would fill too many."""
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
        """Means of departures (n,) in bins, in the unit of the departures.

        ``departure``: of each reading of the sensor from the profile, or the reading itself.
        ``floor``: smallest scatter that is assumed. ``step``: resolution of the sensor.
        """
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
        """(n,) why each sample of a sensor is not in its bins; `Reason.USED` where it is."""
        outside = ~_is_within(self.profile, sensor.h_m)
        reasons = with_reason(sensor.rejected, outside, Reason.OUTSIDE_CLIMATOLOGY)
        return with_reason(reasons, bins.rejected, Reason.OUTLIER)

    def airspeed_at(self, seconds: Array, sensor: SensorSamples | None) -> Array | None:
        """(m,) indicated airspeed [m/s] at times (m,) [s]; None if it was not measured."""
        if sensor is None:
            return None
        is_finite = np.isfinite(sensor.value)
        if not bool(is_finite.any()):
            return None
        times = _seconds(sensor, self.start_ns)[is_finite]
        speeds = np.maximum(sensor.value[is_finite], 0.0)
        return np.interp(seconds, times, speeds)

    def flown_heights(self, sensor: SensorSamples) -> sensors.FlownHeights:
        """The heights [m'] and times [s] of a sensor's samples, where the height is finite."""
        has_height = np.isfinite(sensor.h_m)
        height = self.profile.gravity.geopotential_height(sensor.h_m[has_height])
        seconds = _seconds(sensor, self.start_ns)[has_height]
        return sensors.FlownHeights(seconds, height)


def _takeoffs(samples: AirSamples, height_source: SensorSamples, start_ns: int) -> Array:
    """Times of the take-offs since ``start_ns`` [s]; long ago if the log begins in the air.

    Where the samples have no take-offs, the heights of ``height_source`` give one: its last sample
    before it first is 20 m above its lowest height, or its first sample if it never is.
    """
    if samples.takeoff_ns is None:
        with np.errstate(invalid="ignore"):
            is_up = height_source.h_m > np.nanmin(height_source.h_m) + _GROUND_RISE_M
        last_on_ground = 0
        if bool(is_up.any()):
            last_on_ground = max(int(np.argmax(is_up)) - 1, 0)
        takeoff_ns = int(height_source.time_ns[last_on_ground])
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
    """The readings of a thermometer in bins, each with what its errors depend on.

    That is the time since the last take-off, the warming by airspeed, and whether in a climb.
    """
    profile = binning.profile
    h = profile.gravity.height(bins.height)
    temperature_k = bins.value + profile.temperature(h)
    speed = binning.airspeed_at(bins.seconds, conditions.airspeed)
    heating_k = None
    if speed is not None:
        heating_k = sensors.airspeed_heating(speed, profile.pressure(h), temperature_k)
    last = np.searchsorted(conditions.takeoffs_s, bins.seconds, side="right") - 1
    since_s = bins.seconds - conditions.takeoffs_s[np.maximum(last, 0)]  # negative before the first
    flown = conditions.flown
    half_s = 0.5 * CLIMB_WINDOW_S
    rise_m = flown.height_at(bins.seconds + half_s) - flown.height_at(bins.seconds - half_s)
    is_climbing = rise_m > CLIMB_WINDOW_S * CLIMBING_M_S
    return sensors.Thermometer(
        sensor.name,
        bins.height,
        temperature_k,
        np.hypot(bins.sigma, AIR_NOISE_K),
        seconds=bins.seconds,
        since_s=np.maximum(since_s, 0.0),
        flown=flown,
        climbing=np.where(is_climbing, 1.0, 0.0),
        heating_k=heating_k,
    )
