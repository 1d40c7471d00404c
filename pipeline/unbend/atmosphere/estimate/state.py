"""The state vector of the estimate, its prior (mean and covariance), and the air of a state.

The state x holds, in this order: temperature T at knots in geopotential height [K], linear
between; relative humidity at coarser knots; ln p at a reference height; one number for each sensor
fault; the values of each drift at knots in time or height.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.hypsometry import column, hats
from unbend.atmosphere.refractive_index import enhancement_factor, saturation_vapour_pressure
from unbend.units import VAPOUR_DEFICIT, Array

FINEST_M, MOST_FINE = 50.0, 200
"""Knots where something was sampled: 50 m' apart, or so far that there are no more than these."""

MARGIN_M = 100.0  # fine knots go on so far beyond the samples [m']
WIDENING, WIDEST_M = 1.25, 750.0  # beyond, each layer is thicker than the last, up to this [m']
TOP_M = 32_000.0  # above, the background's own breakpoints suffice [m']
HUMID_M, HUMID_TOP_M = 250.0, 15_000.0
"""Knots of humidity; above the highest vapour weighs less than 1e-5 of n - 1 [m']."""

ROUGH_K, ROUGH_ALOFT_K = 2.0, 1.2
ROUGH_BELOW_M, SMOOTH_ABOVE_M = 2000.0, 4000.0
KINKED_LENGTH_M, SMOOTH_LENGTH_M, BROAD_LENGTH_M = 600.0, 500.0, 5000.0
KINKED_SHARES, KINKED_BELOW_M = (1.0, 0.55), 300.0
"""Structure of T about a climatology, from nine real ascents: over 50, 100, 200 and 500 m it
changes by 0.5, 1.0, 1.7, 2.8 K RMS in the lowest 1.5 km, and by 0.2, 0.3, 0.5, 1.0 K above. So it
grows in proportion to the distance, as in straight lines, but for inversions, which lie near the
ground more often: all of it is a process with kinks at the ground, and 0.55 of it from 300 m on.
(Kinks everywhere: the sigma of R by a barometer over 500 m is 2.3 times its error, now 2.0.)"""

SURFACE_K, SURFACE_M = 1.5, 40.0
"""Air near the ground is warmer in the sun, or colder at night, than that above it by so much, less
by 1/e in so much height [m']. In the sun similarity theory (Businger et al. 1971) gives 2 K between
2 and 50 m, at 200 W/m2 and a friction velocity of 0.3 m/s."""

_UNKNOWN_LOG_P = 0.1  # prior sigma of ln p before sea-level pressure and barometer are used


class SensorFault(StrEnum):
    """Identifiers of what can be wrong with a sensor; the texts are in `sensors.FAULT_TEXTS`."""

    THERMOMETER_BIAS = "thermometer_bias"
    TAKEOFF_TRANSIENT = "takeoff_transient"
    TRANSIENT_DECAY = "transient_decay"
    THERMOMETER_LAG = "thermometer_lag"
    RECOVERY_FACTOR = "recovery_factor"
    THERMOMETER_DRIFT = "thermometer_drift"
    PRESSURE_OFFSET = "pressure_offset"
    PRESSURE_SCALE = "pressure_scale"
    GNSS_HEIGHT_OFFSET = "gnss_height_offset"
    DYNAMIC_PRESSURE_ERROR = "dynamic_pressure_error"
    BAROMETER_DRIFT = "barometer_drift"
    HYGROMETER_BIAS = "hygrometer_bias"


@dataclass(frozen=True)
class Fault:
    """A sensor fault that is one number: its prior mean, sigma, and its limits.

    Where it is ``rare``, as a share, that a sensor has it at all, the others have one of sigma
    ``usual``.
    """

    name: SensorFault
    mean: float
    sigma: float
    low: float = -np.inf
    high: float = np.inf
    rare: float = 1.0
    usual: float = 0.0

    @property
    def prior_sigma(self) -> float:
        """Of all sensors, those that have the fault and the others."""
        return float(np.sqrt(self.rare * self.sigma**2 + (1.0 - self.rare) * self.usual**2))

    @property
    def ordinary(self) -> "Fault":
        """The same of a sensor that has not what is rare."""
        return replace(self, sigma=self.usual, rare=1.0) if self.rare < 1.0 else self

    def mixed(self, value: float, variance: float) -> tuple[float, float]:
        """Mean and variance where the estimate of one that has it is ``value``, ``variance``.

        The posterior of a prior that is a mixture of two normal distributions about ``mean`` is one
        of two, whose weights are the marginal likelihoods of the estimate.
        """
        precision = max(1.0 / variance - 1.0 / self.sigma**2, 1e-12 / self.sigma**2)
        departure = (value - self.mean) / variance / precision
        sigmas = np.array([self.sigma, self.usual])
        spread = sigmas**2 + 1.0 / precision
        weight = np.array([self.rare, 1.0 - self.rare]) * np.exp(-0.5 * departure**2 / spread)
        weight /= np.sqrt(spread)
        weight /= weight.sum()
        means = departure * sigmas**2 / spread
        mean = float(weight @ means)
        own = sigmas**2 / (precision * spread)
        return self.mean + mean, float(weight @ (own + (means - mean) ** 2))


@dataclass(frozen=True, eq=False)
class Drift:
    """A drift along time [s] or height [m']: (k,) knots, sigma there, correlation length.

    ``name`` is a `SensorFault`, or that of a sounding's departure with its number; ``quick`` sigma
    and correlation length of a second process beside the first. ``scales`` are
    the smallest and the largest factor of the sigmas that the flight may show (`solver.solve`).
    """

    name: str
    knot: Array
    sigma: Array | float
    length: float
    quick: tuple[float, float] = (0.0, 1.0)
    scales: tuple[float, float] = (1.0, 1.0)

    def covariance(self) -> Array:
        """Of a first-order Markov process: sigma^2 exp(-d / length); a jitter keeps it regular."""
        size = self.knot.size
        sigma = np.broadcast_to(self.sigma, size)
        correlation = exponential(self.knot, self.length) + 1e-8 * np.eye(size)
        quick = self.quick[0] ** 2 * exponential(self.knot, self.quick[1])
        return np.outer(sigma, sigma) * correlation + quick


@dataclass(frozen=True, eq=False)
class Layout:
    """Where in the state each quantity stands."""

    knot: Array
    humid: Array
    reference: float
    faults: tuple[Fault, ...]
    drifts: tuple[Drift, ...]

    @property
    def temperature(self) -> slice:
        return slice(0, self.knot.size)

    @property
    def humidity(self) -> slice:
        return slice(self.knot.size, self.knot.size + self.humid.size)

    @property
    def level(self) -> int:
        """ln p at the reference height."""
        return self.knot.size + self.humid.size

    @property
    def size(self) -> int:
        return self.level + 1 + len(self.faults) + sum(d.knot.size for d in self.drifts)

    def fault(self, name: SensorFault) -> int:
        """Index of a fault in the state."""
        return self.level + 1 + [fault.name for fault in self.faults].index(name)

    def drift(self, name: str) -> tuple[Drift, slice]:
        """A drift, and its place in the state."""
        at = self.level + 1 + len(self.faults)
        for drift in self.drifts:
            if drift.name == name:
                return drift, slice(at, at + drift.knot.size)
            at += drift.knot.size
        raise KeyError(name)

    def bounded(self, x: Array) -> Array:
        """The state with humidity, temperature and faults clipped to their physical limits."""
        x = x.copy()
        x[self.humidity] = np.clip(x[self.humidity], 0.0, 1.0)
        x[self.temperature] = np.clip(x[self.temperature], 140.0, 360.0)
        for i, fault in enumerate(self.faults, self.level + 1):
            x[i] = min(max(x[i], fault.low), fault.high)
        return x


def place_knots(low: float, high: float, edge: Array) -> Array:
    """Knots [m'] of temperature: fine from ``low`` to ``high``, widening to the ends of ``edge``.

    ``edge`` are the breakpoints of the background; they stay knots.

    >>> place_knots(0.0, 200.0, np.array([-5000.0, 11e3, 20e3]))[14:20].round().tolist()
    [-100.0, -50.0, 0.0, 50.0, 100.0, 150.0]
    """
    low = max(low - MARGIN_M, edge[0] + MARGIN_M)
    high = min(high + MARGIN_M, edge[-1] - MARGIN_M)
    step = max(FINEST_M, (high - low) / MOST_FINE)
    fine = np.linspace(low, high, 1 + max(1, round((high - low) / step)))
    step = fine[1] - fine[0]
    away = np.cumsum(np.minimum(step * WIDENING ** np.arange(1, 100), WIDEST_M))
    above = high + away[high + away < min(TOP_M, edge[-1] - step)]
    below = low - away[low - away > edge[0] + step]
    free = np.concatenate([below[::-1], fine, above])
    # No sliver of a layer beside a breakpoint of the background.
    nearest = np.min(np.abs(free[:, None] - edge[None, :]), axis=1)
    return np.unique(np.concatenate([free[nearest > 0.4 * step], edge]))


def place_humid_knots(low: float, high: float) -> Array:
    """Knots [m'] of relative humidity, at the last of which there is none."""
    bottom = max(low - 2.0 * HUMID_M, -4000.0)
    middle = min(high + 2.0 * HUMID_M, HUMID_TOP_M - 3.0 * HUMID_M)
    fine = np.arange(bottom, max(middle, bottom + HUMID_M), HUMID_M)
    coarse = np.arange(fine[-1] + 2.0 * HUMID_M, HUMID_TOP_M - HUMID_M, 2.0 * HUMID_M)
    return np.concatenate([fine, coarse, [HUMID_TOP_M]])


@dataclass(frozen=True, eq=False)
class Prior:
    """The state before any measurement: (s,) mean, (s, s) precision (inverse of B)."""

    mean: Array
    precision: Array
    sigma_temperature: Array

    def with_drifts(self, layout: Layout, variance: Array) -> "Prior":
        """The same with drifts (d,) of so many times the variance."""
        precision = self.precision.copy()
        for drift, times in zip(layout.drifts, variance, strict=True):
            where = layout.drift(drift.name)[1]
            precision[where, where] /= times
        return replace(self, precision=precision)


def prior_of(layout: Layout, background: Climatology, moisture: Climatology) -> Prior:
    """The background at the knots, and the expected sensor faults.

    The departure of temperature from the climatology has its spread sigma(H) in three parts: of
    the rough variance sigma_r^2 a share with kinks, exp(-d/600 m), and the rest without, Matern 3/2
    (1 + q) exp(-q) with q = sqrt(3) d / 500 m; sigma^2 - sigma_r^2 likewise over 5 km. To these
    comes a layer of air near the lowest height. ``moisture`` gives humidity.
    """
    gravity = background.profile.gravity
    knot, humid = layout.knot, layout.humid
    mean, precision = np.zeros(layout.size), np.zeros((layout.size, layout.size))

    def put(where: slice, values: Array | float, covariance: Array) -> None:
        mean[where] = values
        precision[where, where] = np.linalg.inv(covariance)

    spread = background.spread.sigma_temperature(gravity.height(knot))
    above = knot - layout.reference
    rough = np.interp(above, [ROUGH_BELOW_M, SMOOTH_ABOVE_M], [ROUGH_K, ROUGH_ALOFT_K])
    rough = np.minimum(rough, 0.7 * spread)
    kinked = np.interp(above, [0.0, KINKED_BELOW_M], KINKED_SHARES)
    near_ground = SURFACE_K * np.exp(-np.maximum(above, 0.0) / SURFACE_M)
    covariance = np.outer(near_ground, near_ground)
    for variance, correlation in (
        (kinked * rough**2, exponential(knot, KINKED_LENGTH_M)),
        ((1.0 - kinked) * rough**2, matern(knot, SMOOTH_LENGTH_M)),
        (spread**2 - rough**2, matern(knot, BROAD_LENGTH_M)),
    ):
        covariance += np.sqrt(np.outer(variance, variance)) * correlation
    put(layout.temperature, background.profile.temperature(gravity.height(knot)), covariance)

    h = gravity.height(humid)
    expected = np.clip(moisture.relative_humidity(h), 0.0, 1.0)
    expected[-1] = 0.0
    sigma_rh = np.append(moisture.spread.sigma_relative_humidity(h)[:-1], 1e-4)
    length = moisture.spread.humidity_correlation_m
    put(layout.humidity, expected, np.outer(sigma_rh, sigma_rh) * exponential(humid, length))

    level = float(np.log(background.profile.pressure(gravity.height(layout.reference))))
    mean[layout.level], precision[layout.level, layout.level] = level, _UNKNOWN_LOG_P**-2
    for i, fault in enumerate(layout.faults, layout.level + 1):
        mean[i], precision[i, i] = fault.mean, fault.sigma**-2
    for drift in layout.drifts:
        put(layout.drift(drift.name)[1], 0.0, drift.covariance())
    return Prior(mean, precision, spread)


@dataclass(frozen=True, eq=False)
class AirAtKnots:
    """The air of a state, and its derivatives by the state.

    Arrays at the knots: ``temperature`` T, ``virtual`` T_M, ``vapour`` e/p; derivatives by T at
    the same knot and by the relative humidity there; ``spreading`` (k, j) relative humidity of
    the knots from that of the humid knots.
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

    def log_pressure(self, height: Array) -> tuple[Array, Array]:
        """ln p at heights (m,) [m'] by Eq. 52-53, and its (m, s) derivatives by the state."""
        layout = self.layout
        at = np.concatenate([[layout.reference], height])
        integral, gradient = column(layout.knot, self.virtual, at)
        by_virtual = -self.constant * (gradient[1:] - gradient[0])
        jacobian = np.zeros((height.size, layout.size))
        jacobian[:, layout.temperature] = by_virtual * self.virtual_by_t
        jacobian[:, layout.humidity] = (by_virtual * self.virtual_by_rh) @ self.spreading
        jacobian[:, layout.level] = 1.0
        return self.x[layout.level] - self.constant * (integral[1:] - integral[0]), jacobian


def air_of(layout: Layout, x: Array, pressure: Array, constant: float) -> AirAtKnots:
    """The air of a state; ``pressure`` (k,) at the knots only turns humidity into e/p.

    T_M = T/(1 - 0.378 v), v = e/p = RH f(T, p) e_s(T)/p. The derivatives hold p: it changes v by
    1 % where temperature changes v by 7 % a kelvin, and the next iteration sees the new p.
    """
    t = x[layout.temperature]
    spreading = hats(layout.humid, layout.knot)
    spreading[layout.knot >= layout.humid[-1]] = 0.0
    rh = np.clip(spreading @ x[layout.humidity], 0.0, 1.0)
    saturated = enhancement_factor(t, pressure) * saturation_vapour_pressure(t) / pressure
    # d ln e_s / dT of the formula of Davis (Ciddor 1996, appendix A).
    relative = 2.0 * 1.2378847e-5 * t - 1.9121316e-2 + 6.3431645e3 / t**2
    vapour = rh * saturated
    dryness = 1.0 - VAPOUR_DEFICIT * vapour
    steep = t * VAPOUR_DEFICIT / dryness**2
    return AirAtKnots(
        layout, x, constant, t, t / dryness, vapour,
        1.0 / dryness + steep * vapour * relative, steep * saturated,
        vapour * relative, saturated, spreading,
    )  # fmt: skip


def exponential(x: Array, length: float) -> Array:
    """(n, n) correlation exp(-|dx| / length)."""
    return np.asarray(np.exp(-np.abs(x[:, None] - x[None, :]) / length))


def matern(x: Array, length: float) -> Array:
    """(n, n) correlation (1 + q) exp(-q), q = sqrt(3) |dx| / length: Matern 3/2, no kinks."""
    q = np.sqrt(3.0) * np.abs(x[:, None] - x[None, :]) / length
    return np.asarray((1.0 + q) * np.exp(-q))
