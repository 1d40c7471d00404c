"""The state vector of the estimate, its prior (mean and covariance), and the air of a state.

The state x holds, in this order: temperature T at knots in geopotential height [K], linear
between; relative humidity at coarser knots; ln p at a reference height; one number for each sensor
fault; the values of each drift at knots in time or height.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from unbend.atmosphere.air_variation import Part, Parts
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.hypsometry import interpolation_weights, inverse_temperature_integral
from unbend.atmosphere.refractive_index import enhancement_factor, saturation_vapour_pressure
from unbend.units import VAPOUR_DEFICIT, Array, Rows

_LOWEST_K = 140.0  # of a state; no air is colder, or warmer than 360 K
_HIGHEST_K = 360.0
_DRY_RH = 1e-4  # one sigma of relative humidity at the highest knot

_LEAST_DEPARTURE_K2 = 1e-4  # keeps the covariance of a sounding over the flight itself regular
_UNKNOWN_LOG_P = 0.1  # prior sigma of ln p before sea-level pressure and barometer are used


class SensorFault(StrEnum):
    """Identifiers of what can be wrong with a sensor; the texts are in `sensors.FAULT_TEXTS`."""

    THERMOMETER_BIAS = "thermometer_bias"
    TAKEOFF_TRANSIENT = "takeoff_transient"
    TRANSIENT_DECAY = "transient_decay"
    THERMOMETER_LAG = "thermometer_lag"
    RECOVERY_FACTOR = "recovery_factor"
    THERMOMETER_DRIFT = "thermometer_drift"
    BAY_SHARE = "bay_share"
    CLIMB_WARMTH = "climb_warmth"
    PRESSURE_OFFSET = "pressure_offset"
    PRESSURE_SCALE = "pressure_scale"
    GNSS_HEIGHT_OFFSET = "gnss_height_offset"
    DYNAMIC_PRESSURE_ERROR = "dynamic_pressure_error"
    BAROMETER_DRIFT = "barometer_drift"
    HYGROMETER_BIAS = "hygrometer_bias"


@dataclass(frozen=True)
class Fault:
    """A sensor fault that is one number: its prior mean, sigma, and its limits."""

    name: SensorFault
    mean: float
    sigma: float
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True, eq=False)
class Drift:
    """Prior of a drift, a part of the state at its own knots (k,), in time [s] or height [m'].

    ``name``: a `SensorFault`, or `sensors.SOUNDING_HUMIDITY` with the sounding's number. ``sigma``:
    at the knots, in the unit of the drift. ``length``: correlation length, in the unit of the
    knots. ``quick``: sigma and correlation length of a second, independent process that is added.
    ``scales``: smallest and largest factor by which `solver.solve` may multiply the sigmas.
    """

    name: str
    knot: Array
    sigma: Array | float
    length: float
    quick: tuple[float, float] = (0.0, 1.0)
    scales: tuple[float, float] = (1.0, 1.0)

    def covariance(self) -> Array:
        """(k, k) prior covariance, of first-order Markov processes: sigma^2 exp(-d / length).

        1e-8 of the variance on the diagonal keeps it regular.
        """
        size = self.knot.size
        sigma = np.broadcast_to(self.sigma, size)
        correlation = exponential(self.knot, self.length) + 1e-8 * np.eye(size)
        quick_sigma, quick_length = self.quick
        quick = quick_sigma**2 * exponential(self.knot, quick_length)
        return np.outer(sigma, sigma) * correlation + quick


@dataclass(frozen=True)
class Separation:
    """How far apart two columns of air are."""

    hours: float
    metres: float


HERE = Separation(hours=0.0, metres=0.0)


@dataclass(frozen=True, eq=False)
class Departure:
    """Prior of a sounding's temperatures minus the flight's, at knots (k,) [m'].

    They differ because the sounding is of another time and place. ``expected_k`` (k,): mean, by the
    hour of the day. ``parts``: of the variation of the sounding's air. ``errors`` (k, k):
    covariance of the sounding's measurement errors [K2]. ``from_flight``, and
    ``from_other_soundings`` by their names: how far apart the columns of air are, which gives the
    correlation between departures. ``scales``: as in `Drift`.
    """

    name: str
    knot: Array
    expected_k: Array
    parts: Parts
    errors: Array
    from_flight: Separation
    from_other_soundings: Mapping[str, Separation] = field(default_factory=dict)
    scales: tuple[float, float] = (1.0, 1.0)

    def covariance(self, background: Climatology) -> Array:
        """(k, k) prior covariance of the departure [K2]."""
        k = self.knot.size
        joint = joint_covariance(background, self.knot, (self,))
        return joint[k:, k:]  # the first k are the flight's temperatures


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each quantity is in the state.

    ``knot`` (k,), ``humid`` (j,): knots of temperature and of humidity [m']. ``reference``: height
    of ln p [m'].
    """

    knot: Array
    humid: Array
    reference: float
    faults: tuple[Fault, ...]
    drifts: tuple[Drift | Departure, ...]

    @property
    def departures(self) -> tuple[Departure, ...]:
        """The departures of soundings' temperatures among the drifts."""
        return tuple(drift for drift in self.drifts if isinstance(drift, Departure))

    @property
    def temperature(self) -> slice:
        """Temperatures at the knots [K]."""
        return slice(0, self.knot.size)

    @property
    def humidity(self) -> slice:
        """Relative humidities at their knots."""
        return slice(self.knot.size, self.log_p)

    @property
    def log_p(self) -> int:
        """Index of ln p at the reference height."""
        return self.knot.size + self.humid.size

    @property
    def first_fault(self) -> int:
        """Index of the first sensor fault."""
        return self.log_p + 1

    @property
    def first_drift(self) -> int:
        """Index of the first value of the first drift."""
        return self.first_fault + len(self.faults)

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        return self.first_drift + sum(drift.knot.size for drift in self.drifts)

    def fault(self, name: SensorFault) -> int:
        """Index of a fault in the state."""
        names = [fault.name for fault in self.faults]
        return self.first_fault + names.index(name)

    def drift(self, name: str) -> tuple[Drift | Departure, slice]:
        """The drift of a name, and the slice of its values in the state; KeyError without one."""
        start = self.first_drift
        for drift in self.drifts:
            stop = start + drift.knot.size
            if drift.name == name:
                return drift, slice(start, stop)
            start = stop
        raise KeyError(name)

    def bounded(self, x: Array) -> Array:
        """The state with humidity, temperature and faults clipped to their physical limits."""
        x = x.copy()
        x[self.humidity] = np.clip(x[self.humidity], 0.0, 1.0)
        x[self.temperature] = np.clip(x[self.temperature], _LOWEST_K, _HIGHEST_K)
        for index, fault in enumerate(self.faults, self.first_fault):
            x[index] = min(max(x[index], fault.low), fault.high)
        return x


@dataclass(frozen=True, eq=False)
class Prior:
    """The state before any measurement: (s,) mean, (s, s) precision (inverse of the covariance B).

    ``sigma_temperature`` (k,): one sigma of the background's temperature at the knots [K].
    """

    mean: Array
    precision: Array
    sigma_temperature: Array

    def with_drifts(self, layout: Layout, variance_factor: Array) -> "Prior":
        """The prior with the variance of each drift multiplied by its factor (d,)."""
        precision = self.precision.copy()
        for drift, factor in zip(layout.drifts, variance_factor, strict=True):
            _, rows = layout.drift(drift.name)
            precision[rows, rows] /= factor
        return replace(self, precision=precision)


def prior_of(
    layout: Layout,
    background: Climatology,
    moisture: Climatology,
) -> Prior:
    """The prior of a state: mean and precision.

    Temperature and pressure are those of ``background``, humidity that of ``moisture``; the sensor
    faults are as the layout expects them. The flight's temperatures and the departures of soundings
    from them are correlated (`joint_covariance`); everything else is independent.
    """
    profile = background.profile
    mean = np.zeros(layout.size)
    precision = np.zeros((layout.size, layout.size))

    knot_h = profile.gravity.height(layout.knot)
    mean[layout.temperature] = profile.temperature(knot_h)
    for departure in layout.departures:
        _, rows = layout.drift(departure.name)
        mean[rows] = departure.expected_k
    rows_of_air = _rows_of_air(layout)
    covariance = joint_covariance(background, layout.knot, layout.departures)
    precision[np.ix_(rows_of_air, rows_of_air)] = np.linalg.inv(covariance)

    humid_h = profile.gravity.height(layout.humid)
    humidity = np.clip(moisture.relative_humidity(humid_h), 0.0, 1.0)
    humidity[-1] = 0.0  # the highest knot is dry
    mean[layout.humidity] = humidity
    humid_covariance = _humidity_covariance(layout.humid, humid_h, moisture)
    precision[layout.humidity, layout.humidity] = np.linalg.inv(humid_covariance)

    reference_pa = profile.pressure(profile.gravity.height(layout.reference))
    mean[layout.log_p] = float(np.log(reference_pa))
    precision[layout.log_p, layout.log_p] = _UNKNOWN_LOG_P**-2
    for index, fault in enumerate(layout.faults, layout.first_fault):
        mean[index] = fault.mean
        precision[index, index] = fault.sigma**-2
    for drift in layout.drifts:
        if isinstance(drift, Drift):
            _, rows = layout.drift(drift.name)
            precision[rows, rows] = np.linalg.inv(drift.covariance())
    return Prior(mean, precision, background.spread.sigma_temperature(knot_h))


def _rows_of_air(layout: Layout) -> Rows:
    """Indices in the state: the flight's temperatures, then the departures of each sounding."""
    rows_of_air = [np.arange(layout.knot.size)]
    for departure in layout.departures:
        _, rows = layout.drift(departure.name)
        rows_of_air.append(np.arange(rows.start, rows.stop))
    return np.concatenate(rows_of_air)


def _humidity_covariance(
    humid: Array,
    humid_h: Array,
    moisture: Climatology,
) -> Array:
    """(j, j) prior covariance of relative humidity at its knots, the last of them dry.

    ``humid`` (j,): the knots [m']; ``humid_h`` (j,): their heights above sea level [m].
    """
    sigma_rh = moisture.spread.sigma_relative_humidity(humid_h)
    sigma_rh = np.append(sigma_rh[:-1], _DRY_RH)
    correlation = exponential(humid, moisture.spread.humidity_correlation_m)
    return np.asarray(np.outer(sigma_rh, sigma_rh) * correlation)


def joint_covariance(
    background: Climatology,
    knot: Array,
    departures: Sequence[Departure],
) -> Array:
    """Prior covariance [K2] of the flight's temperatures and of soundings' departures from them.

    In this order: the temperatures at ``knot`` (k,) [m'], then each departure at its own knots. A
    departure is the air of a sounding minus that of the flight. So the covariance of the departures
    of two soundings a and b from the flight 0 is cov(a, b) - cov(a, 0) - cov(0, b) + cov(0, 0),
    where each part of the air's variation correlates by the time and distance between the columns.
    """
    gravity = background.profile.gravity
    flight = background.spread.parts
    columns = [_Column(gravity.height(knot), flight)]
    for departure in departures:
        h = gravity.height(departure.knot)
        columns.append(_Column(h, departure.parts, departure))
    blocks = []
    for a in columns:
        blocks.append([_covariance_of_columns(a, b, flight) for b in columns])
    return np.block(blocks)


@dataclass(frozen=True, eq=False)
class _Column:
    """A column of air: heights (n,) [m above sea level] and the parts of the air's variation.

    ``departure`` is None for the column of the flight itself, else that of the column's sounding.
    """

    h: Array
    parts: Parts
    departure: Departure | None = None

    @property
    def from_flight(self) -> Separation:
        """Separation of the column from that of the flight."""
        return HERE if self.departure is None else self.departure.from_flight

    def separation_from(self, other: "_Column") -> Separation:
        """Separation of the column from another column."""
        if self.departure is other.departure:
            return HERE
        if self.departure is None:
            return other.from_flight
        if other.departure is None:
            return self.from_flight
        return self.departure.from_other_soundings[other.departure.name]

    def is_departure(self) -> bool:
        """Whether the state has the column's departure from the flight, not its temperatures."""
        return self.departure is not None


def _covariance_of_columns(a: _Column, b: _Column, flight: Parts) -> Array:
    """(n, m) prior covariance [K2] between two columns of the state, by `joint_covariance`.

    The state has the temperatures of the flight's column, and the departures from these in the
    column of a sounding. ``flight``: parts of the variation of the flight's air.
    """
    total = np.zeros((a.h.size, b.h.size))
    for part_a, part_b, part in zip(a.parts, b.parts, flight, strict=True):
        a_with_b = part_a.covariance(a.h, b.h, part_b)
        total += a_with_b * _correlation_between(part, a.separation_from(b))
        if b.is_departure():
            a_with_flight = part_a.covariance(a.h, b.h, part)
            total -= a_with_flight * _correlation_between(part, a.from_flight)
        if a.is_departure():
            flight_with_b = part.covariance(a.h, b.h, part_b)
            total -= flight_with_b * _correlation_between(part, b.from_flight)
        if a.is_departure() and b.is_departure():
            total += part.covariance(a.h, b.h)
    if a.departure is not None and a.departure is b.departure:
        total += a.departure.errors + _LEAST_DEPARTURE_K2 * np.eye(a.h.size)
    return total


def _correlation_between(part: Part, separation: Separation) -> Array:
    """Correlation of a part between two columns of air of this separation."""
    return part.correlation_over(separation.hours, separation.metres)


@dataclass(frozen=True, eq=False)
class AirAtKnots:
    """The air of a state ``x`` (s,) at the knots of temperature (k,), and its derivatives.

    ``constant``: G M0/R* [K/m']. ``temperature`` T [K], ``virtual`` T_M [K], ``vapour`` e/p.
    ``virtual_by_t`` ... ``vapour_by_rh``: derivatives of T_M and e/p by T and by the relative
    humidity of the same knot. ``spreading`` (k, j): weights of the humidities in the state in the
    humidity of each knot.
    """

    layout: Layout
    x: Array
    constant: float
    temperature: Array
    virtual: Array
    vapour: Array
    virtual_by_t: Array
    virtual_by_rh: Array
    vapour_by_t: Array
    vapour_by_rh: Array
    spreading: Array

    def pressure_at_knots(self) -> Array:
        """Pressure [Pa] at the knots (k,) by Eq. 52-53."""
        layout = self.layout
        heights = np.concatenate([[layout.reference], layout.knot])
        integral, _ = inverse_temperature_integral(layout.knot, self.virtual, heights)
        fall = self.constant * (integral[1:] - integral[0])
        reference_log_p = self.x[layout.log_p]
        return np.asarray(np.exp(reference_log_p - fall))

    def log_pressure(self, height: Array) -> tuple[Array, Array]:
        """ln p at heights (m,) [m'] by Eq. 52-53, and its (m, s) derivatives by the state."""
        layout = self.layout
        heights = np.concatenate([[layout.reference], height])
        integral, gradient = inverse_temperature_integral(layout.knot, self.virtual, heights)
        fall = self.constant * (integral[1:] - integral[0])
        by_virtual = -self.constant * (gradient[1:] - gradient[0])
        jacobian = np.zeros((height.size, layout.size))
        jacobian[:, layout.temperature] = by_virtual * self.virtual_by_t
        jacobian[:, layout.humidity] = (by_virtual * self.virtual_by_rh) @ self.spreading
        jacobian[:, layout.log_p] = 1.0
        reference_log_p = self.x[layout.log_p]
        return reference_log_p - fall, jacobian


def air_of(
    layout: Layout,
    x: Array,
    pressure: Array,
    constant: float,
) -> AirAtKnots:
    """The air of a state ``x`` (s,), with derivatives; ``constant`` is G M0/R* [K/m'].

    T_M = T/(1 - 0.378 v), v = e/p = RH f(T, p) e_s(T)/p. ``pressure`` (k,) at the knots [Pa] is
    that of the previous iteration and only turns RH into v. The derivatives take it as constant:
    it changes v by 1 % where temperature changes v by 7 % a kelvin.
    """
    t = x[layout.temperature]
    spreading = interpolation_weights(layout.humid, layout.knot)
    spreading[layout.knot >= layout.humid[-1]] = 0.0
    rh = np.clip(spreading @ x[layout.humidity], 0.0, 1.0)
    saturated_vapour = enhancement_factor(t, pressure) * saturation_vapour_pressure(t) / pressure
    # d ln e_s / dT of the formula of Davis (Ciddor 1996, appendix A).
    log_saturation_by_t = 2.0 * 1.2378847e-5 * t - 1.9121316e-2 + 6.3431645e3 / t**2
    vapour = rh * saturated_vapour
    dryness = 1.0 - VAPOUR_DEFICIT * vapour
    virtual_by_vapour = t * VAPOUR_DEFICIT / dryness**2
    return AirAtKnots(
        layout=layout,
        x=x,
        constant=constant,
        temperature=t,
        virtual=t / dryness,
        vapour=vapour,
        virtual_by_t=1.0 / dryness + virtual_by_vapour * vapour * log_saturation_by_t,
        virtual_by_rh=virtual_by_vapour * saturated_vapour,
        vapour_by_t=vapour * log_saturation_by_t,
        vapour_by_rh=saturated_vapour,
        spreading=spreading,
    )


def exponential(x: Array, length: float) -> Array:
    """(n, n) correlation exp(-|dx| / length) between points ``x`` (n,) in the unit of length."""
    distance = np.abs(x[:, None] - x[None, :])
    return np.asarray(np.exp(-distance / length))
