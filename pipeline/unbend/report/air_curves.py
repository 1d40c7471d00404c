"""The curves of a flight's air against height, as the figures of page and command show them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.adjusted_profile import Adjustment
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.atmosphere.rejection import Reason
from unbend.refraction.effect import FlightAir
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array, evenly_spaced

TEMPERATURE = 0
PRESSURE = 1
VAPOUR_PRESSURE = 2
AGAINST_STANDARD = 4
"""Numbers of the columns of `Curves`."""

QUANTITIES = (
    "temperature T [°C]",
    "pressure p [hPa]",
    "vapour pressure e [hPa]",
    "refractivity N = (n − 1) 10⁶",
)
"""The first four columns of `Curves`; the fifth is N against the standard [%]."""

Curves = list[Array]
"""T [°C], p, e [hPa], N and N against the standard [%] at the heights of a figure."""

MAX_SAMPLES = 300  # used ones of a sensor that are drawn, and as many that are not used
LEVELS = 60  # heights of a curve
MAX_PARTS = 12  # of a flight, with a curve of their own
MARGIN = 0.06  # of the heights of the flight, above and below them
MIN_MARGIN_M = 50.0
HEIGHTS_OF_NO_FLIGHT_M = (0.0, 10_000.0)
AXIS_MARGIN = 0.04  # of the values along an axis, to each side
MIN_AXIS_RANGE = 5.0  # °C, hPa, N or %: less would show noise


@dataclass(frozen=True, eq=False)
class SensorCurve:
    """Some readings of a sensor in the unit of its axis, those that are used and the others.

    ``count`` readings have a value and a height; ``count_used`` of them are used.
    """

    quantity: str
    sensor: str
    column: int
    values_used: Array
    h_used: Array
    values_not_used: Array
    h_not_used: Array
    count: int
    count_used: int


@dataclass(frozen=True, eq=False)
class AirCurves:
    """Curves at heights ``h_m`` above sea level: of the flight, of its parts and of the standard.

    ``flight`` is None where the flight has the standard's air, ``sigma`` where it is not known;
    ``basis`` names what the air of the flight was estimated from.
    """

    h_m: Array
    flight: Curves | None
    sigma: Curves | None
    parts: list[Curves]
    standard: Curves
    standard_name: str
    samples: list[SensorCurve]
    basis: str

    @cached_property
    def limits(self) -> list[tuple[float, float]]:
        """The range of each column's axis."""
        return [self.limits_of_column(column) for column in range(len(self.standard))]

    def limits_of_column(self, column: int) -> tuple[float, float]:
        """The range of an axis that shows all that is drawn in it."""
        drawn = [self.standard[column]]
        if self.flight is not None:
            drawn.append(self.flight[column])
        if column != AGAINST_STANDARD:
            drawn += [part[column] for part in self.parts]
        if self.flight is not None and self.sigma is not None:
            drawn.append(self.flight[column] - self.sigma[column])
            drawn.append(self.flight[column] + self.sigma[column])
        for sensor in self.samples:
            if sensor.column == column:
                drawn += [sensor.values_used, sensor.values_not_used]
        values = np.concatenate(drawn)
        margin = AXIS_MARGIN * max(float(np.ptp(values)), MIN_AXIS_RANGE)
        return float(values.min()) - margin, float(values.max()) + margin


def air_curves(air: FlightAir, samples: AirSamples, heights_m: Array) -> AirCurves:
    """The curves of a flight's air over the heights that are given and those of its readings."""
    adjustment = air.adjustment
    profile = adjustment.profile
    standard = adjustment.standard
    readings = readings_of(samples, profile)
    heights = np.concatenate([heights_m, *(reading.samples.h_m for reading in readings)])
    h_m = heights_of_curves(heights, profile)
    n_standard = standard.refractivity(h_m)
    flight = None
    if profile is not standard:
        flight = curves_of(profile, h_m, n_standard)
    sigma = None
    if adjustment.covariance is not None:
        sigma = sigma_curves(adjustment.covariance, profile, h_m, n_standard)
    parts = [window.air.profile for window in air.windows if not window.why_not]
    return AirCurves(
        h_m=h_m,
        flight=flight,
        sigma=sigma,
        parts=[curves_of(part, h_m, n_standard) for part in parts[:MAX_PARTS]],
        standard=curves_of(standard, h_m, n_standard),
        standard_name=standard.name,
        samples=[sensor_curve(reading, adjustment) for reading in readings],
        basis=adjustment.basis,
    )


@dataclass(frozen=True, eq=False)
class _Readings:
    """The samples of one sensor, and their values in the unit of an axis."""

    quantity: str
    column: int
    samples: SensorSamples
    values: Array


def readings_of(samples: AirSamples, profile: Profile) -> Sequence[_Readings]:
    """Readings as temperature, pressure and vapour pressure; the latter with a profile's T, p."""
    readings = []
    thermometer = samples.temperature
    if thermometer is not None:
        t_celsius = thermometer.value - ZERO_CELSIUS_K
        readings.append(_Readings("temperature", TEMPERATURE, thermometer, t_celsius))
    barometer = samples.pressure
    if barometer is not None:
        p_hpa = barometer.value / HECTOPASCAL
        readings.append(_Readings("pressure", PRESSURE, barometer, p_hpa))
    hygrometer = samples.humidity
    if hygrometer is not None:
        humidity = np.clip(hygrometer.value, 0.0, 1.0)
        t_k = profile.temperature(hygrometer.h_m)
        p_pa = profile.pressure(hygrometer.h_m)
        e_hpa = np.asarray(vapour_pressure(humidity, t_k, p_pa)) / HECTOPASCAL
        readings.append(_Readings("humidity", VAPOUR_PRESSURE, hygrometer, e_hpa))
    return readings


def heights_of_curves(heights_m: Array, profile: Profile) -> Array:
    """Heights above sea level [m] around those of a flight, within a profile."""
    known_heights_m = heights_m[np.isfinite(heights_m)]
    low, high = HEIGHTS_OF_NO_FLIGHT_M
    margin = 0.0
    if known_heights_m.size:
        low = known_heights_m.min()
        high = known_heights_m.max()
        margin = max(MARGIN * (high - low), MIN_MARGIN_M)
    bottom = max(low - margin, profile.bottom_m)
    top = min(high + margin, profile.top_m)
    return np.linspace(bottom, top, LEVELS)


def curves_of(profile: Profile, h_m: Array, n_standard: Array) -> Curves:
    """The columns of a profile; ``n_standard`` is n - 1 of the standard at the same heights."""
    n = profile.refractivity(h_m)
    return [
        profile.temperature(h_m) - ZERO_CELSIUS_K,
        profile.pressure(h_m) / HECTOPASCAL,
        profile.vapour_pressure(h_m) / HECTOPASCAL,
        n * 1e6,
        100.0 * (n / n_standard - 1.0),
    ]


def sigma_curves(
    covariance: ProfileCovariance, profile: Profile, h_m: Array, n_standard: Array
) -> Curves:
    """Standard deviations of the columns of a profile."""
    sigma_n = covariance.sigma_refractivity(h_m)
    return [
        covariance.sigma_temperature(h_m),
        covariance.sigma_log_pressure(h_m) * profile.pressure(h_m) / HECTOPASCAL,
        covariance.sigma_vapour_pressure(h_m) / HECTOPASCAL,
        sigma_n * 1e6,
        100.0 * sigma_n / n_standard,
    ]


def sensor_curve(readings: _Readings, adjustment: Adjustment) -> SensorCurve:
    """Readings of a sensor that a figure draws, evenly spaced over those that are known."""
    samples = readings.samples
    reasons = adjustment.rejected.get(readings.quantity, samples.rejected)
    is_used = reasons == Reason.USED
    is_known = np.isfinite(readings.values) & np.isfinite(samples.h_m)
    used = np.flatnonzero(is_known & is_used)
    not_used = np.flatnonzero(is_known & ~is_used)
    drawn_used = used[evenly_spaced(used.size, MAX_SAMPLES)]
    drawn_not_used = not_used[evenly_spaced(not_used.size, MAX_SAMPLES)]
    return SensorCurve(
        quantity=readings.quantity,
        sensor=samples.name,
        column=readings.column,
        values_used=readings.values[drawn_used],
        h_used=samples.h_m[drawn_used],
        values_not_used=readings.values[drawn_not_used],
        h_not_used=samples.h_m[drawn_not_used],
        count=int(is_known.sum()),
        count_used=int(used.size),
    )
