"""The air of a long flight in windows of time, each with an estimate of its own.

The background of each window is the estimate of the whole flight, so heights that a window did not
visit keep the air of the whole flight. The estimated sensor faults of the whole flight are the
prior of those in a window.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from unbend.atmosphere import messages
from unbend.atmosphere.air_samples import AirSamples, SensorSamples, part_of
from unbend.atmosphere.air_variation import Part
from unbend.atmosphere.climatology import Climatology, Spread
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.adjusted_profile import Adjustment
from unbend.atmosphere.estimate.candidates import SMALLEST_CLIMB_M
from unbend.atmosphere.estimate.estimate_checks import is_better_than_background, is_plausible
from unbend.atmosphere.estimate.solver import FaultEstimate, estimate
from unbend.atmosphere.series import ageing
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.messages import Notes

MOST_WINDOWS = 12  # each as long as the air stays fresh, or longer

_FAULT_CHANGE = 0.2
"""One sigma of a fault's change between windows, as a share of its prior sigma."""

SIGNIFICANT = 1.5
"""Sigmas (RMS over the windows) by which R must depart from that of the whole flight, so that
windows are used: in constant air, 16 flights of four hours reached 1.3 at most."""

OWN_LENGTH_M = 5000.0  # correlation in height of the errors of the whole flight's profile [m]

COUNTED_TWICE = 2.0
"""A window's readings are in its background too, so its covariance is doubled. Without this errors
of R were 1.1 to 1.6 sigma RMS in six sets of flights."""


@dataclass(frozen=True, eq=False)
class TimeWindow:
    """A part of the flight [Unix ns] and its air.

    ``change``: ln of its refraction R over that of the whole flight; ``sigma``: one sigma of R/R.
    Both are 0 where the air is that of the whole flight, and ``why_not`` states why.
    """

    start_ns: int
    end_ns: int
    air: TimedProfile
    change: float = 0.0
    sigma: float = 0.0
    why_not: str = ""


def time_windows(samples: AirSamples) -> tuple[tuple[int, int], ...]:
    """Start and end [Unix ns] of parts of a flight, each half an hour or more over enough height.

    A part over too little height is joined with the shorter of its neighbours; at last there may be
    one part only. Empty if neither thermometer nor barometer has a reading.

    >>> time_windows(AirSamples())
    ()
    """
    sensor = _deciding_sensor(samples)
    if sensor is None or not bool(sensor.accepted.any()):
        return ()
    time_ns = sensor.time_ns[sensor.accepted]
    start_ns = int(time_ns[0])
    duration_ns = int(time_ns[-1]) + 1 - start_ns
    fresh_periods = int(duration_ns * 1e-9 / ageing.FRESH_S)
    count = max(1, min(MOST_WINDOWS, fresh_periods))
    edges = [start_ns + duration_ns * i // count for i in range(count + 1)]
    parts = list(pairwise(edges))
    while len(parts) > 1:
        extents = [_part_of_sensor(sensor, *part).extent_m for part in parts]
        flattest = int(np.argmin(extents))
        if extents[flattest] >= SMALLEST_CLIMB_M:
            break
        first = _first_of_pair(parts, flattest)
        joined = (parts[first][0], parts[first + 1][1])
        parts[first : first + 2] = [joined]
    return tuple(parts)


def _first_of_pair(parts: Sequence[tuple[int, int]], number: int) -> int:
    """The first of the two parts that are joined: part ``number`` and its shorter neighbour."""
    if number == 0:
        return number
    if number == len(parts) - 1:
        return number - 1
    before_ns = parts[number - 1][1] - parts[number - 1][0]
    after_ns = parts[number + 1][1] - parts[number + 1][0]
    is_before_shorter = before_ns <= after_ns
    return number - 1 if is_before_shorter else number


def _deciding_sensor(samples: AirSamples) -> SensorSamples | None:
    """The sensor that decides on windows by its heights: the thermometer, else the barometer."""
    return samples.pressure if samples.temperature is None else samples.temperature


def _part_of_sensor(sensor: SensorSamples, start_ns: int, end_ns: int) -> SensorSamples:
    """The samples of a sensor from one time until before another [Unix ns]."""
    first, last = np.searchsorted(sensor.time_ns, [start_ns, end_ns])
    return part_of(sensor, slice(first, last))


def part_of_flight(samples: AirSamples, start_ns: int, end_ns: int) -> AirSamples:
    """What a flight measured from one time until before another [Unix ns].

    The take-offs of the whole flight stay. Where they are unknown, a part that begins after the
    first sample is taken to begin in the air: it has an empty array of take-offs.
    """
    parts: dict[str, SensorSamples] = {}
    for name in ("temperature", "pressure", "humidity", "airspeed"):
        sensor = getattr(samples, name)
        if sensor is None:
            continue
        part = _part_of_sensor(sensor, start_ns, end_ns)
        if part.time_ns.size:
            parts[name] = part
    takeoffs = samples.takeoff_ns
    deciding = _deciding_sensor(samples)
    if takeoffs is None and deciding is not None and start_ns > int(deciding.time_ns[0]):
        takeoffs = np.empty(0, np.int64)
    return AirSamples(**parts, takeoff_ns=takeoffs)


def estimate_windows(
    whole: Adjustment,
    h_c: Sequence[float],
    h_g: float,
) -> tuple[tuple[TimeWindow, ...], Notes]:
    """The air of each window of a flight, in the order of time; empty if one profile is enough.

    ``h_c``, ``h_g``: heights of cameras and of the ground [m above sea level], for the change of R.

    A window whose estimate fails its checks, or predicts its own held-out readings worse than the
    whole flight does, keeps the air of the whole. One profile is enough where R departs from that
    of the whole by less than `SIGNIFICANT` of its own sigmas, RMS over the windows that have an
    estimate of their own.
    """
    if whole.samples is None or whole.covariance is None or whole.moisture is None:
        return (), ()
    parts = time_windows(whole.samples)
    if len(parts) < 2:
        return (), ()
    hours = (parts[-1][1] - parts[0][0]) / 3.6e12
    background = _whole_flight_as_background(whole.covariance, whole.moisture.spread, hours)
    # The whole flight's air as of one window: uncertain by what air changes in all its hours.
    ages = ageing.SampleAges(
        h_m=np.array([whole.covariance.anchor_height_m]),
        hours=np.array([hours]),
    )
    widened_covariance = ageing.covariance_with_ageing(whole.covariance, ages)
    whole_air = TimedProfile(None, whole.profile, widened_covariance)
    windows = []
    for start_ns, end_ns in parts:
        part = part_of_flight(whole.samples, start_ns, end_ns)
        middle_ns = _middle_of_part(part, start_ns, end_ns)
        air, why_not = _air_of_part(part, middle_ns, whole, background)
        if air is None or air.own_covariance is None:
            # The window has no estimate of its own that can be used.
            air = replace(whole_air, time_ns=middle_ns)
            windows.append(TimeWindow(start_ns, end_ns, air, why_not=why_not))
            continue
        change = air.change_from(whole_air, h_c, h_g)
        sigma = air.own_covariance.relative_sigma(max(h_c), h_g)
        windows.append(TimeWindow(start_ns, end_ns, air, change, sigma))
    return _windows_if_significant(windows, hours, utc_known=whole.utc_known)


def _middle_of_part(part: AirSamples, start_ns: int, end_ns: int) -> int:
    """The middle of a part [Unix ns]: that of the visits to its heights, else of its limits."""
    deciding = _deciding_sensor(part)
    if deciding is not None and deciding.middle_of_heights_ns is not None:
        return deciding.middle_of_heights_ns
    return (start_ns + end_ns) // 2


def _windows_if_significant(
    windows: Sequence[TimeWindow],
    hours: float,
    *,
    utc_known: bool,
) -> tuple[tuple[TimeWindow, ...], Notes]:
    """The windows if their R departs from that of the whole flight, else none; and messages why.

    ``hours``: duration of the flight.
    """
    estimated = [window for window in windows if not window.why_not]
    if not estimated:
        return (), (messages.air_windows_none(hours=hours),)
    square = np.mean([(window.change / window.sigma) ** 2 for window in estimated])
    departure = float(np.sqrt(square))
    largest = 100.0 * max(abs(window.change) for window in estimated)
    if departure < SIGNIFICANT:
        constant = messages.air_windows_one(
            hours=hours,
            total=len(estimated),
            sigmas=departure,
            largest=largest,
        )
        return (), (constant,)
    changing = messages.air_windows(
        hours=hours,
        count=len(windows),
        sigmas=departure,
        largest=largest,
    )
    notes = [changing]
    for window in windows:
        if window.why_not:
            when = _moment(window.air.time_ns, utc_known=utc_known)
            notes.append(messages.air_window(when=when, reason=window.why_not))
    return tuple(windows), tuple(notes)


def _moment(time_ns: int | None, *, utc_known: bool) -> str:
    """A time in words: UTC, or minutes after the boot."""
    if time_ns is None:
        return "unknown"
    if not utc_known:
        return f"{time_ns / 6e10:.0f} min after boot"
    return str(np.datetime64(time_ns, "ns").astype("datetime64[s]"))


def _whole_flight_as_background(
    covariance: ProfileCovariance, spread: Spread, hours: float
) -> Climatology:
    """The air of the whole flight as the background of its parts.

    Its spread has the errors of the estimate, and what the air may change by in the ``hours`` of
    the flight. ``spread``: of the climatology, which limits that of humidity.
    """
    profile = covariance.profile
    inside = (spread.h_m > profile.bottom_m) & (spread.h_m < profile.top_m)
    h = spread.h_m[inside]
    change = ageing.change_parts(
        profile.gravity.latitude_rad,
        covariance.anchor_height_m,
        hours,
        metres=0.0,
        h_m=h,
    )
    weather = ageing.CHANGE_LOG_P_PER_H * hours
    level = float(np.hypot(covariance.sigma_log_pressure(0.0)[0], weather))
    of_errors = Part("flight", h, covariance.sigma_temperature(h), OWN_LENGTH_M)
    humidity = np.minimum(spread.sigma_relative_humidity(h), ageing.CHANGE_RH)
    of_flight = Spread(
        (*change, of_errors),
        h,
        humidity,
        spread.humidity_correlation_m,
        level,
    )
    return Climatology(profile, of_flight, "the whole flight", has_humidity=True)


def _air_of_part(
    part: AirSamples,
    middle_ns: int,
    whole: Adjustment,
    background: Climatology,
) -> tuple[TimedProfile | None, str]:
    """The air of a window by its own readings; or None, and in words why they cannot be used.

    ``whole``: the adjustment of the whole flight; ``background``: its air as a background.
    """
    if _deciding_sensor(part) is None:
        return None, "nothing was measured then"
    faults = [_less_certain(fault) for fault in whole.faults]
    made = estimate(part, background, settings=whole.settings, known_faults=faults)
    if not made.converged:
        return None, "its estimate did not converge"
    if whole.moisture is not None:
        plausible = is_plausible(made, whole.moisture)
        if not plausible:
            return None, plausible.reason
    better = is_better_than_background(made, background, background, name="the whole flight")
    if not better:
        return None, better.reason
    sources = whole.profile.layers.sources_between(made.profile.layers.edge)
    layers = replace(made.profile.layers, source=sources)
    profile = replace(made.profile, layers=layers)
    doubled = COUNTED_TWICE * made.covariance.matrix
    covariance = replace(made.covariance, profile=profile, matrix=doubled)
    return TimedProfile(middle_ns, profile, covariance), ""


def _less_certain(fault: FaultEstimate) -> FaultEstimate:
    """A sensor fault of the whole flight as the prior of one window: less certain by its change."""
    change = _FAULT_CHANGE * fault.prior_sigma
    return replace(fault, sigma=float(np.hypot(fault.sigma, change)))
