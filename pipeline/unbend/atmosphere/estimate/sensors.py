"""Observation equations: what a sensor reads in the air of a state, and derivatives of this."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from unbend.atmosphere.estimate.state import AirAtKnots, Fault, Layout, SensorFault
from unbend.atmosphere.hypsometry import interpolation_weights
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

# Names of drifts: how the air of a sounding departs from that of the flight. The number of the
# sounding follows.
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

# One sigma of the drift of GNSS heights and of a static pressure over half an hour; its correlation
# in time is in `sensor_drifts`.
GNSS_DRIFT_M = 1.6
PRESSURE_DRIFT_PA = 12.0

# Gauss-Laguerre: the mean over an exponential memory, exact for polynomials of degree 9 in time.
_MEMORY, _WEIGHT = np.polynomial.laguerre.laggauss(5)  # ages in units of the lag, and their weights
_STEP_S = 0.5  # of the difference in time that gives the derivative by the lag


@dataclass(frozen=True)
class SensorCalibration:
    """Mean and sigma of a sensor fault by a calibration; None where it does not state them.

    ``subtracted``: the part of the fault that was already subtracted from the readings. ``path``:
    key of the mission file.
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
    """What the mission file states of the sensors, and what was estimated of them before.

    ``board_temperature``: the thermometer is on a circuit board, and is used as the air plus an
    unknown, drifting 10 K. ``calibration``: by fault. ``usual_errors_only``: drifts are not made
    larger than expected, and rare faults are not considered. ``highest_log_p``: ln of the highest
    pressure [Pa] of the whole flight, if the samples are a part of it (`Barometer`).
    """

    board_temperature: bool = False
    calibration: Mapping[SensorFault, SensorCalibration] = field(default_factory=dict)
    usual_errors_only: bool = False
    highest_log_p: float | None = None


@dataclass(frozen=True, eq=False)
class Readings(ABC):
    """A set of readings (m,) at geopotential heights (m,) [m'], with sigmas (m,).

    The sigmas are of errors that are independent between readings. ``robust``: readings lose weight
    where they do not fit, and the sigmas of the set may be inflated.
    """

    quantity: ClassVar[str]
    name: str
    height: Array
    value: Array
    sigma: Array
    robust: bool = field(default=True, kw_only=True)

    @abstractmethod
    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """(m,) what would be read in an air, and the (m, s) derivatives of this by the state."""


@dataclass(frozen=True, eq=False)
class FlownHeights:
    """The heights [m'] that were flown, at increasing times [s]."""

    seconds: Array
    height: Array

    def height_at(self, seconds: Array) -> Array:
        """(m,) heights [m'] at times (m,) [s], constant before the first and after the last."""
        return np.interp(seconds, self.seconds, self.height)


@dataclass(frozen=True, eq=False)
class Thermometer(Readings):
    """Means of a thermometer in bins [K]; (m,) arrays.

    ``seconds``: time since the start; ``since_s``: since the last take-off. ``flown``: heights of
    the whole flight, for the lag. ``climbing``: 1 in a climb, else 0. ``heating_k``: V^2/(2 c_p) of
    the true airspeed; None if that is not known.
    """

    quantity = "temperature"
    seconds: Array
    since_s: Array
    flown: FlownHeights
    climbing: Array
    heating_k: Array | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """(m,) temperatures as a sensor with lag and other faults reads them; see `Readings`.

        T_read(t) = (1 - g) T_felt + g T_bay + bias + b_0 exp(-t/tau) + c (in the climb) +
        r V^2/(2 c_p) + drift(t), where T_felt(t) is the integral of T(H(t - s)) exp(-s/lag)/lag ds
        over the heights H that were flown before: a climb into colder air reads warm, a descent
        cold. In order: a share g of the air is that of a bay; bias; take-off transient, with t
        since take-off; warmth in a climb; recovery factor r; drift.
        """
        layout = air.layout
        x = air.x
        felt_by_t, felt_by_lag = self._felt(air)
        felt_k = felt_by_t @ air.temperature
        bay_share = x[layout.fault(SensorFault.BAY_SHARE)]
        decay_s = np.exp(x[layout.fault(SensorFault.TRANSIENT_DECAY)])
        decay = np.exp(-self.since_s / decay_s)
        transient = x[layout.fault(SensorFault.TAKEOFF_TRANSIENT)]
        reading = felt_k + bay_share * (BAY_K - felt_k)
        reading += self.climbing * x[layout.fault(SensorFault.CLIMB_WARMTH)]
        reading += x[layout.fault(SensorFault.THERMOMETER_BIAS)] + transient * decay
        by_fault = {
            SensorFault.THERMOMETER_BIAS: 1.0,
            SensorFault.THERMOMETER_LAG: (1.0 - bay_share) * felt_by_lag,
            SensorFault.BAY_SHARE: BAY_K - felt_k,
            SensorFault.CLIMB_WARMTH: self.climbing,
            SensorFault.TAKEOFF_TRANSIENT: decay,
            # by ln tau
            SensorFault.TRANSIENT_DECAY: transient * decay * self.since_s / decay_s,
        }
        if self.heating_k is not None:
            by_fault[SensorFault.RECOVERY_FACTOR] = self.heating_k
            reading += self.heating_k * x[layout.fault(SensorFault.RECOVERY_FACTOR)]
        jacobian = np.zeros((self.value.size, layout.size))
        jacobian[:, layout.temperature] = felt_by_t * (1.0 - bay_share)
        for fault, derivative in by_fault.items():
            jacobian[:, layout.fault(fault)] = derivative
        drift, rows = layout.drift(SensorFault.THERMOMETER_DRIFT)
        jacobian[:, rows] = interpolation_weights(drift.knot, self.seconds)
        return reading + jacobian[:, rows] @ x[rows], jacobian

    def _felt(self, air: AirAtKnots) -> tuple[Array, Array]:
        """(m, k) weights of the knots' temperatures in T_felt, and (m,) d T_felt / d lag [K/s].

        T_felt is the weighted mean of the temperatures at five past times, from 0.3 to 13
        times the lag ago.
        """
        knot = air.layout.knot
        lag_s = air.x[air.layout.fault(SensorFault.THERMOMETER_LAG)]
        weights = np.zeros((self.value.size, knot.size))
        by_lag = np.zeros(self.value.size)
        # The mean height of a bin is not that flown at its mean time: the path is moved onto it.
        offset = self.height - self.flown.height_at(self.seconds)
        for memory, weight in zip(_MEMORY, _WEIGHT, strict=True):
            then_s = self.seconds - lag_s * memory
            weights_then = interpolation_weights(knot, self.flown.height_at(then_s) + offset)
            weights += weight * weights_then
            earlier_height = self.flown.height_at(then_s - _STEP_S) + offset
            earlier_k = np.interp(earlier_height, knot, air.temperature)
            change = earlier_k - weights_then @ air.temperature
            by_lag += weight * memory * change / _STEP_S
        return weights, by_lag


@dataclass(frozen=True, eq=False)
class Barometer(Readings):
    """Means of ln of a static pressure [Pa] in bins of GNSS height; (m,) arrays.

    ``highest_log_p``: ln of the highest pressure p_0 of the flight, since which a leaking source
    loses a share of the change. ``dynamic_pa``: q = rho_0 V^2/2 of the indicated airspeed; None if
    that is not known.
    """

    quantity = "pressure"
    seconds: Array
    highest_log_p: float
    dynamic_pa: Array | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """(m,) ln p(H) by Eq. 52-53, with the faults of the sensor and of H; see `Readings`.

        ln p_read = ln p(H - dh) + (offset + s (p_0 - p) + c q)/p + drift(t). A GNSS height that is
        too large by dh belongs to air farther down, d ln p/dh = -(G M0/R*)/T_M. A static source
        loses a share s of the change since the highest pressure p_0, and has an error c of dynamic
        pressure q. The drift is a process of unit variance times the sigma in ln p of the drifts of
        height and of pressure together.
        """
        layout = air.layout
        x = air.x
        reading, jacobian = air.log_pressure(self.height)
        per_metre = air.constant / np.interp(self.height, layout.knot, air.virtual)
        per_pascal = np.exp(-self.value)
        by_fault = {
            SensorFault.PRESSURE_OFFSET: per_pascal,
            SensorFault.PRESSURE_SCALE: np.expm1(self.highest_log_p - self.value),
            SensorFault.GNSS_HEIGHT_OFFSET: per_metre,
        }
        if self.dynamic_pa is not None:
            by_fault[SensorFault.DYNAMIC_PRESSURE_ERROR] = self.dynamic_pa * per_pascal
        for fault, derivative in by_fault.items():
            jacobian[:, layout.fault(fault)] = derivative
            reading += derivative * x[layout.fault(fault)]
        drift, rows = layout.drift(SensorFault.BAROMETER_DRIFT)
        sigma = np.hypot(GNSS_DRIFT_M * per_metre, PRESSURE_DRIFT_PA * per_pascal)
        jacobian[:, rows] = interpolation_weights(drift.knot, self.seconds) * sigma[:, None]
        return reading + jacobian[:, rows] @ x[rows], jacobian


@dataclass(frozen=True, eq=False)
class Temperatures(Readings):
    """Temperatures [K] of a balloon or a station; ``drift`` names their departure in the state.

    None if their departure is part of the sigmas.
    """

    quantity = "temperature"
    drift: str | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """T(H) + departure(H); see `Readings`."""
        layout = air.layout
        jacobian = _interpolation_jacobian(
            layout, self.height, layout.temperature, layout.knot, self.drift
        )
        return jacobian @ air.x, jacobian


@dataclass(frozen=True, eq=False)
class Humidities(Readings):
    """Relative humidities (0-1) of a hygrometer, balloon or station.

    ``fault``: the bias of a hygrometer; ``drift``: name of a balloon's departure in the state; None
    where there is none.
    """

    quantity = "humidity"
    fault: SensorFault | None = None
    drift: str | None = None

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """RH(H) + bias + departure(H); see `Readings`."""
        layout = air.layout
        jacobian = _interpolation_jacobian(
            layout, self.height, layout.humidity, layout.humid, self.drift
        )
        if self.fault is not None:
            jacobian[:, layout.fault(self.fault)] = 1.0
        return jacobian @ air.x, jacobian


def _interpolation_jacobian(
    layout: Layout,
    height: Array,
    rows: slice,
    knot: Array,
    departure: str | None,
) -> Array:
    """(m, s) derivatives by the state of a quantity at heights (m,) [m'], and of its departure.

    The quantity is the part ``rows`` of the state, at knots ``knot`` [m'], and linear between.
    ``departure``: name of the drift that is added to it, or None.
    """
    jacobian = np.zeros((height.size, layout.size))
    jacobian[:, rows] = interpolation_weights(knot, height)
    if departure is not None:
        drift, rows_of_drift = layout.drift(departure)
        jacobian[:, rows_of_drift] = interpolation_weights(drift.knot, height)
    return jacobian


@dataclass(frozen=True, eq=False)
class Pressures(Readings):
    """ln of pressures [Pa] without sensor faults: of a station, a balloon, or at sea level."""

    quantity = "pressure"

    def predict(self, air: AirAtKnots) -> tuple[Array, Array]:
        """ln p(H) by Eq. 52-53; see `Readings`."""
        return air.log_pressure(self.height)


def airspeed_heating(airspeed_m_s: Array, pressure_pa: Array, temperature_k: Array) -> Array:
    """By how much air that is stopped warms [K]: V^2/(2 c_p) of the true airspeed V.

    From the indicated airspeed V_i [m/s], with V^2 = V_i^2 rho_0/rho.

    >>> airspeed_heating(np.array([70.0]), np.array([7e4]), np.array([270.0])).round(2).tolist()
    [3.31]
    """
    density = pressure_pa / (GAS_CONSTANT_DRY * temperature_k)
    return np.asarray(airspeed_m_s**2 * SEA_LEVEL_DENSITY / density / (2.0 * HEAT_CAPACITY))


def dynamic_pressure(airspeed_m_s: Array) -> Array:
    """Dynamic pressure [Pa] of an indicated airspeed.

    >>> dynamic_pressure(np.array([40.0])).round(6).tolist()
    [980.0]
    """
    return np.asarray(0.5 * SEA_LEVEL_DENSITY * airspeed_m_s**2)
