"""The curves of a flight's air against height, for the figures of the report and of plots."""

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
"""Indices of the columns of `Curves`."""

QUANTITIES = (
    "temperature T [°C]",
    "pressure p [hPa]",
    "vapour pressure e [hPa]",
    "refractivity N = (n − 1) 10⁶",
)
"""Labels of the first four columns of `Curves`; the fifth is N against the standard [%]."""

Curves = list[Array]
"""Five columns (h,): T [°C], p, e [hPa], N and N against the standard [%] at a figure's heights."""

MAX_SAMPLES = 300  # of a sensor that are drawn: of the used ones, and of the others
LEVELS = 60  # heights of a curve
MAX_PARTS = 12  # of a flight that are drawn
MARGIN = 0.06  # above and below the heights of the flight, as a share of their range
MIN_MARGIN_M = 50.0
DEFAULT_HEIGHTS_M = (0.0, 10_000.0)  # of a figure if no height of the flight is known
AXIS_MARGIN = 0.04  # at each end of an axis, as a share of the range of its values
MIN_AXIS_RANGE = 5.0  # °C, hPa, N or %, for the margin: less would show noise


@dataclass(frozen=True, eq=False)
class SensorCurve:
    """Readings of a sensor that are drawn, in the unit of the axis ``column`` of `Curves`.

    ``values_used`` at the heights ``h_used`` (n,) [m] were used for the estimate of the air, the
    others were not. ``count`` is the number of all readings with a value and a height, drawn or
    not, and ``count_used`` that of the used ones among them.
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
    """Curves at heights ``h_m`` (h,) above sea level: of the flight, its parts and the standard.

    ``flight`` is None if the standard atmosphere is used for the flight; ``sigma``, its standard
    deviations, is None if unknown. ``basis`` is the kind of source of the flight's air.
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
        """The range of an axis that contains all curves and readings of a column, with a margin."""
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
    """The curves of a flight's air over the range of ``heights_m`` and of its readings' heights."""
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
    """The samples of one sensor, and their values (n,) in the unit of the axis ``column``."""

    quantity: str
    column: int
    samples: SensorSamples
    values: Array


def readings_of(samples: AirSamples, profile: Profile) -> Sequence[_Readings]:
    """The samples of each sensor in the units of the axes: °C and hPa.

    Relative humidity becomes vapour pressure with the temperature and pressure of the profile.
    """
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
    """The heights (60,) [m above sea level] of the curves: from below to above ``heights_m``.

    They are within the limits of the profile; unknown heights (NaN) do not count.
    """
    known_heights_m = heights_m[np.isfinite(heights_m)]
    low, high = DEFAULT_HEIGHTS_M
    margin = 0.0
    if known_heights_m.size:
        low = known_heights_m.min()
        high = known_heights_m.max()
        margin = max(MARGIN * (high - low), MIN_MARGIN_M)
    bottom = max(low - margin, profile.bottom_m)
    top = min(high + margin, profile.top_m)
    return np.linspace(bottom, top, LEVELS)


def curves_of(profile: Profile, h_m: Array, n_standard: Array) -> Curves:
    """The curves of a profile; ``n_standard`` (h,) is n - 1 of the standard at the same heights."""
    n = profile.refractivity(h_m)  # n - 1
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
    """The standard deviations of the curves of a profile, in the units of `Curves`."""
    sigma_n = covariance.sigma_refractivity(h_m)
    return [
        covariance.sigma_temperature(h_m),
        covariance.sigma_log_pressure(h_m) * profile.pressure(h_m) / HECTOPASCAL,
        covariance.sigma_vapour_pressure(h_m) / HECTOPASCAL,
        sigma_n * 1e6,
        100.0 * sigma_n / n_standard,
    ]


def sensor_curve(readings: _Readings, adjustment: Adjustment) -> SensorCurve:
    """The readings of a sensor to draw: some of those used, and some of those not used.

    They are evenly spaced over all that have a value and a height.
    """
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
