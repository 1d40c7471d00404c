"""The priors of the drifts of a thermometer and of a barometer."""

import numpy as np

from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import Drift, SensorFault
from unbend.units import Array

DRIFT_STEP_S = 45.0
ALONE_STEP_S = 15.0
MOST_DRIFT_STEPS = 60
"""Time between the knots of drifts, and their largest number. With 300 s the sigma of R over 1 km
was 2.3 % and the error 4.1 %. A barometer alone has closer knots, because a walk between knots 45 s
apart is too smooth for a climb of a minute (over 300 m errors of 1.35 sigma RMS); so has one that a
thermometer is compared with (else 1 in 100 good thermometers failed)."""

BAROMETER_SCALES = (0.1, 8.0)
THERMOMETER_SCALES = (1.0, 3.0)
"""Smallest and largest factor of the sigma of a drift that the residuals of a flight may give it:
heights of a survey receiver wander by centimetres, those of an autopilot's by metres. Beside a
thermometer no drift becomes smaller: its errors hide drifts (R erred by 1.3 sigma, not 1.15)."""

# What the departure of a thermometer from the air changes by within a quarter hour.
BOARD_DRIFT_K = 5.0  # of one on a circuit board
USUAL_DRIFT_K = 0.4  # of one outside

SUN_ON_PROBE_K = 0.2
SUN_ON_PROBE_S = 60.0
"""What headings and clouds change of the sun on a probe: sigma and correlation time; none where the
mission file states the drift."""

_THERMOMETER_DRIFT_S = 900.0  # correlation time of the drift
_BAROMETER_DRIFT_S = 1200.0


def drift_knots(duration_s: float, settings: SensorSettings, *, with_thermometer: bool) -> Array:
    """Knots (k,) [s] of the drifts of a flight, from its first sample to its last.

    ``with_thermometer``: whether the flight has a thermometer in use.
    """
    is_close = settings.usual_errors_only or not with_thermometer
    step_s = ALONE_STEP_S if is_close else DRIFT_STEP_S
    steps = min(MOST_DRIFT_STEPS, int(duration_s / step_s))
    return np.linspace(0.0, duration_s, 2 + steps)


def barometer_drift(knots: Array, settings: SensorSettings, *, with_thermometer: bool) -> Drift:
    """The prior of the drift of a barometer and of GNSS heights together.

    Its sigma is 1; `sensors.Barometer` multiplies it by that in ln p. ``with_thermometer``: whether
    the flight has a thermometer in use; then the sigma is not made smaller by the residuals.
    """
    least, most = BAROMETER_SCALES
    if settings.usual_errors_only:
        most = 1.0
    elif with_thermometer:
        least = 1.0
    return Drift(
        SensorFault.BAROMETER_DRIFT,
        knots,
        sigma=1.0,
        length=_BAROMETER_DRIFT_S,
        scales=(least, most),
    )


def thermometer_drift(knots: Array, settings: SensorSettings) -> Drift:
    """The prior of the drift of a thermometer [K], and of what the sun on it changes.

    A drift that the mission file states, or of one on a circuit board, keeps its sigma.
    """
    calibration = settings.calibration.get(SensorFault.THERMOMETER_DRIFT, SensorCalibration())
    is_stated = calibration.sigma is not None
    usual_k = BOARD_DRIFT_K if settings.board_temperature else USUAL_DRIFT_K
    least, most = THERMOMETER_SCALES
    if is_stated or settings.board_temperature or settings.usual_errors_only:
        most = least
    sun_k = 0.0 if is_stated else SUN_ON_PROBE_K
    return Drift(
        SensorFault.THERMOMETER_DRIFT,
        knots,
        sigma=calibration.sigma_or(usual_k),
        length=_THERMOMETER_DRIFT_S,
        quick=(sun_k, SUN_ON_PROBE_S),
        scales=(least, most),
    )
