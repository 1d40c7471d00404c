"""What each sensor reads in a given air, and how that changes with the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.estimate.state import Air, Fault, Layout
from pipeline.atmosphere.hypsometry import hats

Array = NDArray[np.float64]

HEAT_CAPACITY = 1005.0
"""c_p of dry air [J kg-1 K-1]."""

GAS_CONSTANT_DRY = 287.05
"""R of dry air [J kg-1 K-1]."""

SEA_LEVEL_DENSITY = 1.225
"""Airspeeds of pitot tubes are calibrated for it [kg m-3]."""

THERMOMETER_FAULTS = (
    Fault("thermometer bias [K]", 0.0, 3.0),
    Fault("take-off transient [K]", 0.0, 5.0),
    Fault("ln of its decay time [s]", float(np.log(60.0)), 0.4, float(np.log(15.0)), 6.0),
    Fault("thermometer lag [s]", 12.0, 10.0, 0.0, 90.0),
)
RECOVERY = Fault("recovery factor", 0.7, 0.3, 0.0, 1.1)
BAROMETER_FAULTS = (
    Fault("static pressure offset [Pa]", 0.0, 50.0),
    Fault("GNSS height offset [m]", 0.0, 2.5),
)
DYNAMIC = Fault("static error per dynamic pressure", 0.0, 0.03)
HYGROMETER_FAULT = Fault("hygrometer bias", 0.0, 0.03)
BIAS, TRANSIENT, DECAY, LAG = (fault.name for fault in THERMOMETER_FAULTS)
OFFSET, HEIGHT = (fault.name for fault in BAROMETER_FAULTS)

THERMOMETER_DRIFT = "thermometer drift [K]"
BAROMETER_DRIFT = "barometer and GNSS drift"
SOUNDING_DEPARTURE = "sounding departure [K]"
SOUNDING_HUMIDITY = "sounding departure of humidity"

GNSS_DRIFT_M, PRESSURE_DRIFT_PA = 1.6, 12.0
"""One sigma of what wanders in GNSS heights and in a static pressure, over half an hour."""

# Gauss-Laguerre: the mean over an exponential memory, exact for polynomials of degree 9 in time.
_MEMORY, _WEIGHT = np.polynomial.laguerre.laggauss(5)
_STEP_S = 0.5


class Source(Protocol):
    """Readings (m,) at heights (m,) [m'] with the sigma (m,) of their independent errors."""

    @property
    def name(self) -> str: ...
    @property
    def height(self) -> Array: ...
    @property
    def value(self) -> Array: ...
    @property
    def sigma(self) -> Array: ...
    @property
    def robust(self) -> bool: ...
    def predict(self, air: Air) -> tuple[Array, Array]:
        """What would be read, and its (m, s) derivatives by the state."""
        ...


@dataclass(frozen=True, eq=False)
class Track:
    """The heights [m'] that were flown, at increasing times [s]."""

    seconds: Array
    height: Array

    def at(self, seconds: Array) -> Array:
        return np.interp(seconds, self.seconds, self.height)


@dataclass(frozen=True, eq=False)
class Thermometer:
    """Means of a thermometer in bins [K].

    ``since_s`` time since take-off [s]; ``heating`` V^2/(2 c_p) of the true airspeed [K], or None.
    """

    name: str
    seconds: Array
    height: Array
    value: Array
    sigma: Array
    since_s: Array
    track: Track
    heating: Array | None = None
    robust: bool = True

    def predict(self, air: Air) -> tuple[Array, Array]:
        """T as a sensor with a memory feels it, and what is wrong with it.

        T_read(t) = integral of T(H(t - s)) exp(-s/lag)/lag ds + bias + b_0 exp(-t/tau) +
        r V^2/(2 c_p) + drift(t). To first order in the lag the integral is T - lag dT/dt: a climb
        into colder air reads warm, a descent cold. It follows the heights really flown, so a
        climb after a long stand or a level run needs no other formula.
        """
        layout, x = air.layout, air.x
        jacobian = np.zeros((self.value.size, layout.size))
        by_lag = np.zeros(self.value.size)
        beside = self.height - self.track.at(self.seconds)
        for memory, weight in zip(_MEMORY, _WEIGHT, strict=True):
            then = self.seconds - x[layout.fault(LAG)] * memory
            flown = self.track.at(then) + beside
            felt = hats(layout.knot, flown)
            jacobian[:, layout.temperature] += weight * felt
            before = self.track.at(then - _STEP_S) + beside
            change = np.interp(before, layout.knot, air.temperature) - felt @ air.temperature
            by_lag += weight * memory * change / _STEP_S
        reading = jacobian[:, layout.temperature] @ air.temperature
        decay = np.exp(x[layout.fault(DECAY)])
        left = np.exp(-self.since_s / decay)
        transient = x[layout.fault(TRANSIENT)]
        jacobian[:, layout.fault(BIAS)] = 1.0
        jacobian[:, layout.fault(LAG)] = by_lag
        jacobian[:, layout.fault(TRANSIENT)] = left
        jacobian[:, layout.fault(DECAY)] = transient * left * self.since_s / decay
        reading += x[layout.fault(BIAS)] + transient * left
        if self.heating is not None:
            jacobian[:, layout.fault(RECOVERY.name)] = self.heating
            reading += self.heating * x[layout.fault(RECOVERY.name)]
        drift, where = layout.drift(THERMOMETER_DRIFT)
        jacobian[:, where] = hats(drift.knot, self.seconds)
        return reading + jacobian[:, where] @ x[where], jacobian


@dataclass(frozen=True, eq=False)
class Barometer:
    """Means of ln of a static pressure [Pa] in bins of GNSS height.

    ``dynamic`` pressure q = rho_0 V^2/2 of the indicated airspeed [Pa], or None.
    """

    name: str
    seconds: Array
    height: Array
    value: Array
    sigma: Array
    dynamic: Array | None = None
    robust: bool = True

    def predict(self, air: Air) -> tuple[Array, Array]:
        """ln p(H) by Eq. 52-53, and what is wrong with the sensor and with H.

        ln p_read = ln p(H - dh) + (offset + c q)/p + drift(t): a height read too large belongs to
        air farther down, d ln p/dh = -(G M0/R*)/T_M. The drift is a process of unit variance
        times the two drifts, of height and of pressure, as large as they are in ln p.
        """
        layout, x = air.layout, air.x
        reading, jacobian = air.log_pressure(self.height)
        per_metre = air.constant / np.interp(self.height, layout.knot, air.virtual)
        per_pascal = np.exp(-self.value)
        jacobian[:, layout.fault(OFFSET)] = per_pascal
        jacobian[:, layout.fault(HEIGHT)] = per_metre
        reading += per_pascal * x[layout.fault(OFFSET)] + per_metre * x[layout.fault(HEIGHT)]
        if self.dynamic is not None:
            jacobian[:, layout.fault(DYNAMIC.name)] = self.dynamic * per_pascal
            reading += self.dynamic * per_pascal * x[layout.fault(DYNAMIC.name)]
        drift, where = layout.drift(BAROMETER_DRIFT)
        both = np.hypot(GNSS_DRIFT_M * per_metre, PRESSURE_DRIFT_PA * per_pascal)
        jacobian[:, where] = hats(drift.knot, self.seconds) * both[:, None]
        return reading + jacobian[:, where] @ x[where], jacobian


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures at heights [K], of a balloon or a station; ``drift`` names their departure."""

    name: str
    height: Array
    value: Array
    sigma: Array
    drift: str | None = None
    robust: bool = True

    def predict(self, air: Air) -> tuple[Array, Array]:
        """T(H) + departure(H)."""
        layout = air.layout
        jacobian = _at_heights(layout, self.height, layout.temperature, layout.knot, self.drift)
        return jacobian @ air.x, jacobian


@dataclass(frozen=True, eq=False)
class Humidities:
    """Relative humidities (0-1) at heights, of any origin; ``fault`` or ``drift`` is theirs."""

    name: str
    height: Array
    value: Array
    sigma: Array
    fault: str | None = None
    drift: str | None = None
    robust: bool = True

    def predict(self, air: Air) -> tuple[Array, Array]:
        """RH(H) + bias + departure(H)."""
        layout = air.layout
        jacobian = _at_heights(layout, self.height, layout.humidity, layout.humid, self.drift)
        if self.fault is not None:
            jacobian[:, layout.fault(self.fault)] = 1.0
        return jacobian @ air.x, jacobian


def _at_heights(
    layout: Layout, height: Array, where: slice, knot: Array, departure: str | None
) -> Array:
    """(m, s) derivatives of what is interpolated at heights between knots, and of its departure."""
    jacobian = np.zeros((height.size, layout.size))
    jacobian[:, where] = hats(knot, height)
    if departure is not None:
        drift, where = layout.drift(departure)
        jacobian[:, where] = hats(drift.knot, height)
    return jacobian


@dataclass(frozen=True, eq=False)
class Pressures:
    """ln of pressures [Pa] at heights that are known: a station, a balloon, the sea level."""

    name: str
    height: Array
    value: Array
    sigma: Array
    robust: bool = True

    def predict(self, air: Air) -> tuple[Array, Array]:
        """ln p(H) by Eq. 52-53."""
        return air.log_pressure(self.height)


def heating_of(airspeed_m_s: Array, pressure_pa: Array, temperature_k: Array) -> Array:
    """V^2/(2 c_p) [K] of the true airspeed, from the indicated one: V^2 = V_i^2 rho_0/rho.

    >>> heating_of(np.array([70.0]), np.array([7e4]), np.array([270.0])).round(2).tolist()
    [3.31]
    """
    density = pressure_pa / (GAS_CONSTANT_DRY * temperature_k)
    return np.asarray(airspeed_m_s**2 * SEA_LEVEL_DENSITY / density / (2.0 * HEAT_CAPACITY))


def dynamic_of(airspeed_m_s: Array) -> Array:
    """Dynamic pressure [Pa] of an indicated airspeed.

    >>> dynamic_of(np.array([40.0])).round(6).tolist()
    [980.0]
    """
    return np.asarray(0.5 * SEA_LEVEL_DENSITY * airspeed_m_s**2)
