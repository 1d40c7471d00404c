"""Observation equations: what a sensor reads in a given air, and its derivatives by the state."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from unbend.atmosphere.estimate.state import AirAtKnots, Fault, Layout, SensorFault
from unbend.atmosphere.hypsometry import hats
from unbend.units import Array

BAY_K = 294.0  # of a heated bay or cabin [K]
HEAT_CAPACITY = 1005.0  # c_p of dry air [J kg-1 K-1]
GAS_CONSTANT_DRY = 287.05  # R of dry air [J kg-1 K-1]
SEA_LEVEL_DENSITY = 1.225  # airspeeds of pitot tubes are calibrated for it [kg m-3]

THERMOMETER_FAULTS = (
    Fault(SensorFault.THERMOMETER_BIAS, 0.0, 3.0),
    Fault(SensorFault.TAKEOFF_TRANSIENT, 0.0, 5.0),
    # ln of the decay time [s] of the transient
    Fault(SensorFault.TRANSIENT_DECAY, float(np.log(60.0)), 0.4, float(np.log(15.0)), 6.0),
    Fault(SensorFault.THERMOMETER_LAG, 12.0, 10.0, 0.0, 90.0),
    Fault(SensorFault.BAY_SHARE, 0.0, 0.002),
    Fault(SensorFault.CLIMB_WARMTH, 0.0, 0.2),
)
RECOVERY_FACTOR = Fault(SensorFault.RECOVERY_FACTOR, 0.7, 0.3, 0.0, 1.1)
BAROMETER_FAULTS = (
    Fault(SensorFault.PRESSURE_OFFSET, 0.0, 50.0),
    Fault(SensorFault.GNSS_HEIGHT_OFFSET, 0.0, 2.5),
    # Share of its change that a static pressure loses, or that GNSS heights gain: a quarter of
    # 2.5 hPa over 650 hPa (MS5611, data sheet). Static ports err by dynamic pressure, which 3 km
    # change by 30 Pa.
    Fault(SensorFault.PRESSURE_SCALE, 0.0, 0.001),
)
DYNAMIC_PRESSURE_ERROR = Fault(SensorFault.DYNAMIC_PRESSURE_ERROR, 0.0, 0.03)
HYGROMETER_BIAS = Fault(SensorFault.HYGROMETER_BIAS, 0.0, 0.03)

# Drifts: how the air of a sounding departs from that of the flight; with its number.
SOUNDING_DEPARTURE = "sounding_temperature"
SOUNDING_HUMIDITY = "sounding_humidity"

FAULT_TEXTS: Mapping[SensorFault, str] = {
    SensorFault.THERMOMETER_BIAS: "thermometer bias [K]",
    SensorFault.TAKEOFF_TRANSIENT: "take-off transient [K]",
    SensorFault.TRANSIENT_DECAY: "decay time of the take-off transient [s]",
    SensorFault.THERMOMETER_LAG: "thermometer lag [s]",
    SensorFault.RECOVERY_FACTOR: "recovery factor",
    SensorFault.THERMOMETER_DRIFT: "thermometer drift [K]",
    SensorFault.BAY_SHARE: "share of a bay's air at the thermometer",
    SensorFault.CLIMB_WARMTH: "thermometer in the climb [K]",
    SensorFault.PRESSURE_OFFSET: "static pressure offset [Pa]",
    SensorFault.PRESSURE_SCALE: "static pressure scale",
    SensorFault.GNSS_HEIGHT_OFFSET: "GNSS height offset [m]",
    SensorFault.DYNAMIC_PRESSURE_ERROR: "static error per dynamic pressure",
    SensorFault.BAROMETER_DRIFT: "barometer and GNSS drift",
    SensorFault.HYGROMETER_BIAS: "hygrometer bias",
}
"""What the ledger, the manifest and the report print for each fault."""

# One sigma of what wanders in GNSS heights and in a static pressure, over half an hour; for how it
# goes on in time see `sensor_drifts`.
GNSS_DRIFT_M = 1.6
PRESSURE_DRIFT_PA = 12.0

# Gauss-Laguerre: the mean over an exponential memory, exact for polynomials of degree 9 in time.
_MEMORY, _WEIGHT = np.polynomial.laguerre.laggauss(5)
_STEP_S = 0.5


@dataclass(frozen=True)
class SensorCalibration:
    """What a calibration states of a sensor fault, None where it is silent.

    ``subtracted`` is the part of it that was subtracted from the readings already, ``path`` where
    it is stated.
    """

    mean: float | None = None
    sigma: float | None = None
    subtracted: float = 0.0
    path: str = field(default="atmosphere.sensors", compare=False)

    def sigma_or(self, usual: float) -> float:
        """The stated sigma, else the usual one."""
        return usual if self.sigma is None else self.sigma


@dataclass(frozen=True)
class SensorSettings:
    """What the mission file states of the sensors, and what is known of them.

    ``board_temperature``: the thermometer sits on a circuit board and is used all the same, as the
    air plus an unknown 10 K that wanders. ``usual_errors_only``: no larger drift, no rare fault.
    ``highest``: ln of the pressure [Pa] from which a lost share of change counts, where
    readings are a flight's part.
    """

    board_temperature: bool = False
    calibration: Mapping[SensorFault, SensorCalibration] = field(default_factory=dict)
    usual_errors_only: bool = False
    highest: float | None = None


@dataclass(frozen=True, eq=False)
class Readings(ABC):
    """Readings (m,) at heights (m,) [m'], with the sigma (m,) of independent errors.

    ``robust`` ones lose weight where they do not fit.
    """

    quantity: ClassVar[str]
    name: str
    height: Array
    value: Array
    sigma: Array
    robust: bool = field(default=True, kw_only=True)

    @abstractmethod
    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """What would be read, and its (m, s) derivatives by the state."""


@dataclass(frozen=True, eq=False)
class FlownHeights:
    """The heights [m'] that were flown, at increasing times [s]."""

    seconds: Array
    height: Array

    def at(self, seconds: Array) -> Array:
        """Heights (m,) [m'] at times (m,) [s]."""
        return np.interp(seconds, self.seconds, self.height)


@dataclass(frozen=True, eq=False)
class Thermometer(Readings):
    """Means of a thermometer in bins [K].

    ``since_s`` time since take-off [s]; ``climbing`` is 1 in a climb, else 0; ``heating``
    V^2/(2 c_p) of the true airspeed [K], or None.
    """

    quantity = "temperature"
    seconds: Array
    since_s: Array
    flown: FlownHeights
    climbing: Array
    heating: Array | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """T as a sensor with a memory reads it, with its faults.

        T_read(t) = (1 - g) T_felt + g T_bay + bias + b_0 exp(-t/tau) + c (in the climb) +
        r V^2/(2 c_p) + drift(t), where T_felt(t) is the integral of T(H(t - s)) exp(-s/lag)/lag ds.
        A climb into colder air reads warm, a descent cold; the integral follows the heights really
        flown, after a long stand or a level run too. Of a thermometer in a bay a share g of the
        air is not from outside.
        """
        layout = air.layout
        x = air.x
        felt, by_lag = self._felt(air)
        felt_k = felt @ air.temperature
        in_bay = x[layout.fault(SensorFault.BAY_SHARE)]
        decay_s = np.exp(x[layout.fault(SensorFault.TRANSIENT_DECAY)])
        left = np.exp(-self.since_s / decay_s)
        transient = x[layout.fault(SensorFault.TAKEOFF_TRANSIENT)]
        reading = felt_k + in_bay * (BAY_K - felt_k)
        reading += self.climbing * x[layout.fault(SensorFault.CLIMB_WARMTH)]
        reading += x[layout.fault(SensorFault.THERMOMETER_BIAS)] + transient * left
        by_fault = {
            SensorFault.THERMOMETER_BIAS: 1.0,
            SensorFault.THERMOMETER_LAG: (1.0 - in_bay) * by_lag,
            SensorFault.BAY_SHARE: BAY_K - felt_k,
            SensorFault.CLIMB_WARMTH: self.climbing,
            SensorFault.TAKEOFF_TRANSIENT: left,
            SensorFault.TRANSIENT_DECAY: transient * left * self.since_s / decay_s,
        }
        if self.heating is not None:
            by_fault[SensorFault.RECOVERY_FACTOR] = self.heating
            reading += self.heating * x[layout.fault(SensorFault.RECOVERY_FACTOR)]
        jacobian = np.zeros((self.value.size, layout.size))
        jacobian[:, layout.temperature] = felt * (1.0 - in_bay)
        for fault, derivative in by_fault.items():
            jacobian[:, layout.fault(fault)] = derivative
        drift, rows = layout.drift(SensorFault.THERMOMETER_DRIFT)
        jacobian[:, rows] = hats(drift.knot, self.seconds)
        return reading + jacobian[:, rows] @ x[rows], jacobian

    def _felt(self, air: AirAtKnots) -> tuple[Array, Array]:
        """(m, k) weights of the knots' temperatures in T_felt, and its derivative by the lag."""
        knot = air.layout.knot
        lag_s = air.x[air.layout.fault(SensorFault.THERMOMETER_LAG)]
        weights = np.zeros((self.value.size, knot.size))
        by_lag = np.zeros(self.value.size)
        beside = self.height - self.flown.at(self.seconds)
        for memory, weight in zip(_MEMORY, _WEIGHT, strict=True):
            then = self.seconds - lag_s * memory
            at_knots = hats(knot, self.flown.at(then) + beside)
            weights += weight * at_knots
            before = self.flown.at(then - _STEP_S) + beside
            before_k = np.interp(before, knot, air.temperature)
            change = before_k - at_knots @ air.temperature
            by_lag += weight * memory * change / _STEP_S
        return weights, by_lag


@dataclass(frozen=True, eq=False)
class Barometer(Readings):
    """Means of ln of a static pressure [Pa] in bins of GNSS height.

    ``highest`` ln of it, from which a lost share of change counts; ``dynamic`` pressure
    rho_0 V^2/2 of the indicated airspeed [Pa], or None.
    """

    quantity = "pressure"
    seconds: Array
    highest: float
    dynamic: Array | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """ln p(H) by Eq. 52-53, with the faults of the sensor and of H.

        ln p_read = ln p(H - dh) + (offset + s (p_0 - p) + c q)/p + drift(t): a height read too
        large belongs to air farther down, d ln p/dh = -(G M0/R*)/T_M, and a static source loses a
        share s of the change since the highest pressure p_0. The drift is a process of unit
        variance times the two drifts, of height and of pressure, as large as they are in ln p.
        """
        layout = air.layout
        x = air.x
        reading, jacobian = air.log_pressure(self.height)
        per_metre = air.constant / np.interp(self.height, layout.knot, air.virtual)
        per_pascal = np.exp(-self.value)
        by_fault = {
            SensorFault.PRESSURE_OFFSET: per_pascal,
            SensorFault.PRESSURE_SCALE: np.expm1(self.highest - self.value),
            SensorFault.GNSS_HEIGHT_OFFSET: per_metre,
        }
        if self.dynamic is not None:
            by_fault[SensorFault.DYNAMIC_PRESSURE_ERROR] = self.dynamic * per_pascal
        for fault, derivative in by_fault.items():
            jacobian[:, layout.fault(fault)] = derivative
            reading += derivative * x[layout.fault(fault)]
        drift, rows = layout.drift(SensorFault.BAROMETER_DRIFT)
        sigma = np.hypot(GNSS_DRIFT_M * per_metre, PRESSURE_DRIFT_PA * per_pascal)
        jacobian[:, rows] = hats(drift.knot, self.seconds) * sigma[:, None]
        return reading + jacobian[:, rows] @ x[rows], jacobian


@dataclass(frozen=True, eq=False)
class Temperatures(Readings):
    """Temperatures at heights [K], of a balloon or a station; ``drift`` names their departure."""

    quantity = "temperature"
    drift: str | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """T(H) + departure(H)."""
        layout = air.layout
        jacobian = _at_heights(layout, self.height, layout.temperature, layout.knot, self.drift)
        return jacobian @ air.x, jacobian


@dataclass(frozen=True, eq=False)
class Humidities(Readings):
    """Relative humidities (0-1) at heights, of any origin; ``fault`` or ``drift`` is theirs."""

    quantity = "humidity"
    fault: SensorFault | None = None
    drift: str | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """RH(H) + bias + departure(H)."""
        layout = air.layout
        jacobian = _at_heights(layout, self.height, layout.humidity, layout.humid, self.drift)
        if self.fault is not None:
            jacobian[:, layout.fault(self.fault)] = 1.0
        return jacobian @ air.x, jacobian


def _at_heights(
    layout: Layout,
    height: Array,
    rows: slice,
    knot: Array,
    departure: str | None,
) -> Array:
    """(m, s) derivatives of what is interpolated at heights between knots, and of its departure."""
    jacobian = np.zeros((height.size, layout.size))
    jacobian[:, rows] = hats(knot, height)
    if departure is not None:
        drift, rows_of_drift = layout.drift(departure)
        jacobian[:, rows_of_drift] = hats(drift.knot, height)
    return jacobian


@dataclass(frozen=True, eq=False)
class Pressures(Readings):
    """ln of pressures [Pa] at heights that are known: a station, a balloon, the sea level."""

    quantity = "pressure"

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
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
