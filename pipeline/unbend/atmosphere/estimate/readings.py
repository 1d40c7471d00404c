"""From the samples of a flight to the readings of the estimator: means in bins, and their faults.

Bins are of height, of direction (climb, level, descent) and of time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorSamples, climb_of
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate import external_readings, sensors
from unbend.atmosphere.estimate.hypotheses import RARE_FAULTS, RareFault
from unbend.atmosphere.estimate.sensors import Readings, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import TOP_M, Departure, Drift, Fault, SensorFault
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason, Reasons, with_reason
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.units import Array, Integers, Mask, Rows

CLIMBING_M_S = 0.5  # slower than this an aircraft flies level; lag has a sign only above it [m/s]
CLIMB_WINDOW_S = 10.0  # over which the rate of a climb is taken, about a reading [s]

OUTLIER_SIGMA = 4.5
"""Readings farther from the median of their bin are outliers: 7 in a million of normal errors."""

CORRELATED_S = 2.0
"""Noise of a sensor is independent after so long [s]: 10 Hz are not 20 times as good as 0.5 Hz."""

SHALLOW_M, SHALLOW_BIN_M, BIN_M = 1500.0, 25.0, 50.0
"""Bins are 25 m' where less than 1500 m were sampled, else 50 m'."""

MOST_BINS = 1000
"""Bins are higher where the climbs and descents of a long flight would fill more than these."""

SLICE_S, MOST_SLICES = 30.0, 120
"""Readings so far apart in time are never averaged, in a long flight 1/120 of it: a sensor that
catches up in level flight after a climb determines its lag [s]."""

MOST_DIFFERENT = 0.5  # share of readings that differ, above which a sensor shows no steps

AIR_NOISE_K, AIR_NOISE_LOG_P, AIR_NOISE_RH = 0.15, 3e-5, 0.03
"""Sigma of a bin's mean about the mean air of its height: eddies, the shape of the layer."""

LEAST_SCATTER_K, LEAST_SCATTER_LOG_P, LEAST_SCATTER_RH = 0.05, 5e-5, 0.01

DRIFT_STEP_S, ALONE_STEP_S, MOST_DRIFT_STEPS = 45.0, 15.0, 60
"""Knots of drifts; with 300 s the sigma of R over 1 km was 2.3 % and the error 4.1 %. Nearer of a
barometer alone (a walk between knots 45 s apart is too smooth for a climb of a minute: over 300 m
errors of 1.35 sigma RMS), and where it judges a thermometer (1 in 100 good ones failed)."""

BAROMETER_SCALES, THERMOMETER_SCALES = (0.1, 8.0), (1.0, 3.0)
"""Smallest and largest factor of the sigma of a drift that the residuals of a flight may give it:
heights of a survey receiver wander by centimetres, those of an autopilot's by metres. Beside a
thermometer no drift becomes smaller: its errors hide drifts (R erred by 1.3 sigma, not 1.15)."""

UNMEASURED_M = (0.0, 6000.0)  # where knots are fine if nothing was measured [m']
LONG_AGO_S = -1e5  # take-off of a log that begins in the air [s]

BOARD_BIAS_K, BOARD_DRIFT_K = 10.0, 5.0
"""A board is so much warmer than the air, and that changes by so much within a quarter hour."""

USUAL_BIAS_K, USUAL_DRIFT_K = 3.0, 0.4  # the same of a thermometer outside

SUN_ON_PROBE = 0.2, 60.0
"""What headings and clouds change of the sun on a probe: sigma [K] and correlation time [s]; none
where the mission file states the drift."""

_GROUND_RISE_M = 20.0
_OwnReadings = tuple[list[Readings], list[Fault], list[Drift], dict[str, Reasons]]


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
    instruments = {
        name: sensor
        for name, sensor in samples.sensors.items()
        if bool(_usable(sensor, background.profile).any())
    }
    start_ns = min((int(sensor.time_ns[0]) for sensor in instruments.values()), default=None)
    flight = flight or external_readings.TimeAndPlace(start_ns)
    external: list[Readings] = []
    for number, sounding in enumerate(soundings):
        external += external_readings.sounding_readings(sounding, number, background, flight)
    for report in surface:
        external += external_readings.surface_readings(report, background, flight)
    own: _OwnReadings = ([], [], [], {})
    if start_ns is not None:
        own = _sensor_readings(samples, instruments, background.profile, start_ns, settings)
    sets, expected, drifts, rejected = own
    measured = [readings.height for readings in (*external, *sets)]
    heights = np.concatenate(measured or [np.array(UNMEASURED_M)])
    faults = []
    for fault in expected:
        known = settings.calibration.get(fault.name, SensorCalibration())
        mean = fault.mean if known.mean is None else known.mean
        faults.append(replace(fault, mean=mean, sigma=known.sigma_or(fault.sigma)))
    at_sea = np.zeros(1)
    level = np.array([background.spread.pressure_ratio])
    log_pressure = np.log(background.profile.pressure(at_sea))
    at_sea_level = sensors.Pressures("climatology", at_sea, log_pressure, level, robust=False)
    departures = external_readings.sounding_departures(soundings, background, flight)
    drifts += external_readings.humidity_drifts(soundings, background, flight)
    span = float(heights.min()), float(heights.max())
    every = at_sea_level, *external, *sets
    every_drift: tuple[Drift | Departure, ...] = (*drifts, *departures)
    rare = _rare_faults(faults, settings)
    return FlightReadings(every, tuple(faults), every_drift, *span, rejected, rare)


def _rare_faults(faults: Sequence[Fault], settings: SensorSettings) -> tuple[RareFault, ...]:
    """The rare faults that the sensors of a flight may have.

    None of those whose size is stated. No bay for a thermometer stated to sit on a board, nor
    without a barometer: the climatology alone does not tell a bay from unusual air.
    """
    if settings.usual_errors_only:
        return ()
    possible = {fault.name for fault in faults}
    has_barometer = SensorFault.PRESSURE_OFFSET in possible
    for name, known in settings.calibration.items():
        if known.sigma is not None:
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
    sets, faults, drifts = list[Readings](), list[Fault](), list[Drift]()
    rejected: dict[str, Reasons] = {}
    end_ns = max(int(sensor.time_ns[-1]) for sensor in instruments.values())
    duration = max((end_ns - start_ns) * 1e-9, 1.0)
    alone, usual_only = "temperature" not in instruments, settings.usual_errors_only
    step_s = ALONE_STEP_S if alone or usual_only else DRIFT_STEP_S
    knots = np.linspace(0.0, duration, 2 + min(MOST_DRIFT_STEPS, int(duration / step_s)))
    binning = _Binning.of_flight(instruments, profile, start_ns, duration)
    if (sensor := instruments.get("pressure")) is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            departure = np.log(sensor.value) - np.log(profile.pressure(sensor.h_m))
            step = resolution_of(sensor) / sensor.value
        bins = binning.bins(sensor, departure, LEAST_SCATTER_LOG_P, step)
        rejected["pressure"] = binning.reasons(sensor, bins)
        value = bins.value + np.log(profile.pressure(profile.gravity.height(bins.height)))
        speed = binning.airspeed_at(bins.seconds, samples.airspeed)
        dynamic = None if speed is None else sensors.dynamic_of(speed)
        least, most = BAROMETER_SCALES
        scales = (least, 1.0) if usual_only else (least if alone else 1.0, most)
        highest = float(value.max()) if settings.highest is None else settings.highest
        of_bins = bins.height, value, np.hypot(bins.sigma, AIR_NOISE_LOG_P), bins.seconds
        sets.append(sensors.Barometer(sensor.name, *of_bins, highest, dynamic))
        faults += sensors.BAROMETER_FAULTS
        faults += [] if dynamic is None else [sensors.DYNAMIC_PRESSURE_ERROR]
        drifts.append(Drift(SensorFault.BAROMETER_DRIFT, knots, 1.0, 1200.0, scales=scales))
    if (sensor := instruments.get("temperature")) is not None:
        height_source = instruments.get("pressure", sensor)
        rejected["temperature"], warm = _thermometer(sensor, samples, height_source, binning)
        sets.append(warm)
        board = settings.board_temperature
        bias = replace(sensors.THERMOMETER_FAULTS[0], sigma=BOARD_BIAS_K if board else USUAL_BIAS_K)
        faults += [bias, *sensors.THERMOMETER_FAULTS[1:]]
        faults += [] if warm.heating is None else [sensors.RECOVERY_FACTOR]
        known = settings.calibration.get(SensorFault.THERMOMETER_DRIFT, SensorCalibration())
        sun = SUN_ON_PROBE if known.sigma is None else (0.0, SUN_ON_PROBE[1])
        drift = known.sigma_or(BOARD_DRIFT_K if board else USUAL_DRIFT_K)
        least, most = THERMOMETER_SCALES
        scales = least, least if known.sigma is not None or board or usual_only else most
        drifts.append(Drift(SensorFault.THERMOMETER_DRIFT, knots, drift, 900.0, sun, scales))
    if (sensor := instruments.get("humidity")) is not None:
        high_bins = replace(binning, width_m=2.0 * binning.width_m)
        bins = high_bins.bins(sensor, sensor.value, LEAST_SCATTER_RH, resolution_of(sensor))
        fault, sigma = sensors.HYGROMETER_BIAS, np.hypot(bins.sigma, AIR_NOISE_RH)
        sets.append(
            sensors.Humidities(sensor.name, bins.height, bins.value, sigma, fault=fault.name)
        )
        rejected["humidity"] = high_bins.reasons(sensor, bins)
        faults.append(fault)
    return sets, faults, drifts, rejected


def _usable(sensor: SensorSamples, profile: Profile) -> Mask:
    """Accepted readings at heights that both aircraft and background reach."""
    return np.asarray(sensor.accepted & _is_within(profile, sensor.h_m))


def _is_within(profile: Profile, height_m: Array) -> Mask:
    """Which heights both aircraft and background reach; none that is not known."""
    with np.errstate(invalid="ignore"):
        return np.asarray((height_m > profile.bottom_m + 500.0) & (height_m < TOP_M - 2000.0))


def _seconds(sensor: SensorSamples, start_ns: int) -> Array:
    return np.asarray((sensor.time_ns - start_ns).astype(np.float64) * 1e-9)


@dataclass(frozen=True, eq=False)
class _Binning:
    """The bins of a flight: their size, the first time, and the profile they are averaged about."""

    profile: Profile
    start_ns: int
    width_m: float
    slice_s: float

    @classmethod
    def of_flight(
        cls, own: Mapping[str, SensorSamples], profile: Profile, start_ns: int, duration_s: float
    ) -> _Binning:
        """Thin bins in a shallow flight, thicker where many climbs would fill too many."""
        extent = max(sensor.extent_m for sensor in own.values())
        climbed = 0.0
        for sensor in own.values():  # climb and descent, from heights a quarter minute apart
            known = np.isfinite(sensor.h_m)
            if known.sum() >= 2:
                seconds = _seconds(sensor, int(sensor.time_ns[0]))
                times = np.arange(0.0, seconds[-1], 15.0)
                h = np.interp(times, seconds[known], sensor.h_m[known])
                climbed = max(climbed, float(np.abs(np.diff(h)).sum()))
        width = max(SHALLOW_BIN_M if extent < SHALLOW_M else BIN_M, climbed / MOST_BINS)
        return cls(profile, start_ns, width, max(SLICE_S, duration_s / MOST_SLICES))

    def bins(
        self, sensor: SensorSamples, departure: Array, floor: float, step: Array | float
    ) -> Bins:
        """Means of a departure from the profile that is averaged about; ``step`` of the sensor."""
        height = self.profile.gravity.geopotential_height(sensor.h_m)
        rows = _seconds(sensor, self.start_ns), height, departure, _usable(sensor, self.profile)
        return bin_readings(
            *rows,
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
        if sensor is None or not bool(np.isfinite(sensor.value).any()):
            return None
        known = np.isfinite(sensor.value)
        times = _seconds(sensor, self.start_ns)[known]
        return np.interp(seconds, times, np.maximum(sensor.value[known], 0.0))


def _thermometer(
    sensor: SensorSamples, samples: AirSamples, height_source: SensorSamples, binning: _Binning
) -> tuple[Reasons, sensors.Thermometer]:
    """Readings of a thermometer, and why samples are in none of them.

    Where the take-off is not known, it is when ``height_source``, which knows heights best, first
    left the lowest 20 m.
    """
    profile, start_ns = binning.profile, binning.start_ns
    if samples.takeoff_ns is None:
        with np.errstate(invalid="ignore"):
            up = height_source.h_m > np.nanmin(height_source.h_m) + _GROUND_RISE_M
        first = max(int(np.argmax(up)) - 1, 0) if bool(up.any()) else 0
        takeoffs = np.array([(int(height_source.time_ns[first]) - start_ns) * 1e-9])
    elif samples.takeoff_ns.size == 0:  # in the air from the beginning
        takeoffs = np.array([LONG_AGO_S])
    else:
        takeoffs = (samples.takeoff_ns - start_ns) * 1e-9
    departure = sensor.value - profile.temperature(sensor.h_m)
    bins = binning.bins(sensor, departure, LEAST_SCATTER_K, resolution_of(sensor))
    h = profile.gravity.height(bins.height)
    value = bins.value + profile.temperature(h)
    speed = binning.airspeed_at(bins.seconds, samples.airspeed)
    known = np.isfinite(sensor.h_m)
    flown = profile.gravity.geopotential_height(sensor.h_m[known])
    heights = sensors.FlownHeights(_seconds(sensor, start_ns)[known], flown)
    last = np.maximum(np.searchsorted(takeoffs, bins.seconds, side="right") - 1, 0)
    since_s = np.maximum(bins.seconds - takeoffs[last], 0.0)
    heating = None if speed is None else sensors.heating_of(speed, profile.pressure(h), value)
    half_s = 0.5 * CLIMB_WINDOW_S
    rise_m = heights.at(bins.seconds + half_s) - heights.at(bins.seconds - half_s)
    climbing_up = np.where(rise_m > CLIMB_WINDOW_S * CLIMBING_M_S, 1.0, 0.0)
    of_bins = bins.height, value, np.hypot(bins.sigma, AIR_NOISE_K), bins.seconds
    reasons = binning.reasons(sensor, bins)
    return reasons, sensors.Thermometer(
        sensor.name, *of_bins, since_s, heights, climbing_up, heating
    )


@dataclass(frozen=True, eq=False)
class Bins:
    """Means of readings in bins; (m,) arrays, in no particular order.

    Mean ``seconds`` since the epoch, geopotential ``height`` [m'] and value; ``sigma`` of it from
    the scatter of the ``count`` readings; ``rejected`` (n,) the outliers among all.
    """

    seconds: Array
    height: Array
    value: Array
    sigma: Array
    count: Integers
    rejected: Mask


@dataclass(frozen=True, eq=False)
class Digits:
    """The readings (n,) as a sensor gave them, and the ``step`` between two that it tells apart.

    The step is in the unit of the departures that are averaged.
    """

    reading: Array
    step: Array | float

    def sigma(self, use: Rows, bin_of: Rows) -> Array:
        """(m,) sigma of a reading for its last digit, in each bin of the rows in ``use``."""
        of_rows = np.broadcast_to(self.step, self.reading.shape)[use] / np.sqrt(12.0)
        return np.bincount(bin_of, of_rows) / np.bincount(bin_of)

    def different(self, use: Rows, bin_of: Rows) -> Array:
        """(m,) how many different readings each bin has."""
        pairs = np.unique(np.stack([bin_of, self.reading[use]]), axis=1)
        return np.bincount(pairs[0].astype(np.int64)).astype(np.float64)


def bin_readings(
    seconds: Array,
    height: Array,
    value: Array,
    accepted: Mask,
    *,
    width: float,
    slice_s: float,
    floor: float,
    digits: Digits | None = None,
) -> Bins:
    """Means without outliers, of readings alike in height, direction and time.

    ``seconds``, ``height``, ``value``: (n,) time [s], geopotential height [m'], reading in any
    unit, best as a departure from something that follows the height. ``accepted``: (n,) readings
    to use. ``width``, ``slice_s``: of a bin, in height [m'] and in time [s]. ``floor``: smallest
    scatter that is assumed. Scatter is 1.4826 times the median absolute deviation, that of the
    sensor or of the bin, whichever is larger. The last of the ``digits`` that were read is
    off by as much in all readings that are the same, so that only different ones average it.
    """
    # +1 climbing, 0 level, -1 descending: by the change of height over ten seconds.
    rate = climb_of(seconds, height) / 10.0
    direction = np.asarray(np.sign(rate) * (np.abs(rate) > CLIMBING_M_S))
    use = np.flatnonzero(accepted & np.isfinite(height) & np.isfinite(value))
    rejected = np.zeros(seconds.size, dtype=bool)
    if use.size == 0:
        empty = np.empty(0)
        return Bins(empty, empty, empty, empty, np.empty(0, np.int64), rejected)
    level = np.floor(height[use] / width)
    slices = np.floor((seconds[use] - seconds[use].min()) / slice_s)
    key = (slices * 3.0 + direction[use] + 1.0) * (np.ptp(level) + 1.0) + level - level.min()
    _, bin_of = np.unique(key, return_inverse=True)
    size = np.bincount(bin_of)
    reading = value[use]
    deviation = np.abs(reading - _medians(bin_of, reading, size)[bin_of])
    spread = 1.4826 * _medians(bin_of, deviation, size)
    several = size >= 5
    common = max(floor, float(np.median(spread[several])) if several.any() else floor)
    of_digit = np.zeros(size.size) if digits is None else digits.sigma(use, bin_of)
    scatter = np.hypot(np.maximum(spread, common), of_digit)
    bad = deviation > OUTLIER_SIGMA * scatter[bin_of]
    rejected[use[bad]] = True
    good = (~bad).astype(np.float64)
    count = np.bincount(bin_of, good)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(bin_of, good * values) / count)

    middle = mean(seconds[use])
    lasted = np.sqrt(12.0 * mean((seconds[use] - middle[bin_of]) ** 2))
    independent = np.minimum(count, 1.0 + lasted / CORRELATED_S)
    sigma = scatter / np.sqrt(independent)
    if digits is not None:
        sigma = np.hypot(sigma, of_digit / digits.different(use, bin_of))
    number = count.astype(np.int64)
    return Bins(middle, mean(height[use]), mean(reading), sigma, number, rejected)


def resolution_of(sensor: SensorSamples) -> float:
    """The smallest step between readings of a sensor that differ, to a hundredth of their unit.

    0 where few of them are the same: the last digit is then noise like other.

    >>> whole = np.array([101_300.0, 101_200.0]).repeat(3)
    >>> resolution_of(SensorSamples(np.arange(6), np.arange(6.0), whole))
    100.0
    """
    _, value = sensor.used()
    distinct = np.unique(np.round(value, 2))
    if distinct.size < 2 or distinct.size > MOST_DIFFERENT * value.size:
        return 0.0
    return float(np.diff(distinct).min())


def _medians(bin_of: Rows, value: Array, size: Integers) -> Array:
    """Median of the values of each bin."""
    ordered = value[np.lexsort((value, bin_of))]
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    return np.asarray(0.5 * (ordered[start + (size - 1) // 2] + ordered[start + size // 2]))
