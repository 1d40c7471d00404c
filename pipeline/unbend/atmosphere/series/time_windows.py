"""The air of a long flight in windows of time, each estimated by itself.

The whole flight's estimate is the background of each window, so that heights which a window did not
visit keep that of the rest of the flight; estimated sensor faults are carried over too.
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
from unbend.atmosphere.estimate.solver import estimate
from unbend.atmosphere.series import profile_series
from unbend.atmosphere.series.profile_series import SampleAges, TimedProfile
from unbend.messages import Notes

MOST_WINDOWS = 12  # each as long as the air stays fresh, or longer

_FAULT_CHANGE = 0.2
"""Share of a fault's expected sigma by which it may be another in another window."""

SIGNIFICANT = 1.5
"""Sigmas (RMS over the windows) by which R must depart from the whole flight's: in constant air 16
flights of four hours came to 1.3 at most."""

OWN_LENGTH_M = 5000.0  # correlation in height of the errors of the whole flight's profile [m]

COUNTED_TWICE = 2.0
"""A window's readings are in its background too, so its covariance is doubled. Without this errors
of R were 1.1 to 1.6 sigma RMS in six sets of flights."""


@dataclass(frozen=True, eq=False)
class TimeWindow:
    """A part of the flight [Unix ns] and its air; ``change`` is ln of its R over the whole's;
    ``why_not`` says why its own estimate is not used."""

    start_ns: int
    end_ns: int
    air: TimedProfile
    change: float = 0.0
    sigma: float = 0.0
    why_not: str = ""


def time_windows(samples: AirSamples) -> tuple[tuple[int, int], ...]:
    """Parts of a flight [Unix ns], each half an hour or more, that span enough height.

    A part that spans less is joined with its shorter neighbour, until there is one part only.

    >>> time_windows(AirSamples())
    ()
    """
    sensor = _deciding_sensor(samples)
    if sensor is None or not bool(sensor.accepted.any()):
        return ()
    time = sensor.time_ns[sensor.accepted]
    first, last = int(time[0]), int(time[-1]) + 1
    count = max(1, min(MOST_WINDOWS, int((last - first) * 1e-9 / profile_series.FRESH_S)))
    edges = [first + (last - first) * i // count for i in range(count + 1)]
    parts = list(pairwise(edges))
    while len(parts) > 1:
        extents = [_part(sensor, *part).extent_m for part in parts]
        i = int(np.argmin(extents))
        if extents[i] >= SMALLEST_CLIMB_M:
            break
        sides = [j for j in (i - 1, i + 1) if 0 <= j < len(parts)]
        j = min(sides, key=lambda side: parts[side][1] - parts[side][0])
        low, high = sorted((i, j))
        parts[low : high + 1] = [(parts[low][0], parts[high][1])]
    return tuple(parts)


def _deciding_sensor(samples: AirSamples) -> SensorSamples | None:
    """The sensor whose heights decide: the thermometer, without it the barometer."""
    return samples.pressure if samples.temperature is None else samples.temperature


def _part(sensor: SensorSamples, start_ns: int, end_ns: int) -> SensorSamples:
    return part_of(sensor, slice(*np.searchsorted(sensor.time_ns, [start_ns, end_ns])))


def part_of_flight(samples: AirSamples, start_ns: int, end_ns: int) -> AirSamples:
    """What a flight measured from one time until before another [Unix ns]. Take-offs stay; where
    they are not known, a part that begins after the first sample begins in the air."""
    parts = {
        name: _part(sensor, start_ns, end_ns)
        for name in ("temperature", "pressure", "humidity", "airspeed")
        if (sensor := getattr(samples, name)) is not None
    }
    takeoffs = samples.takeoff_ns
    deciding = _deciding_sensor(samples)
    if takeoffs is None and deciding is not None and start_ns > int(deciding.time_ns[0]):
        takeoffs = np.empty(0, np.int64)
    parts = {name: sensor for name, sensor in parts.items() if sensor.time_ns.size}
    return AirSamples(**parts, takeoff_ns=takeoffs)


def estimate_windows(
    whole: Adjustment, h_c: Sequence[float], h_g: float
) -> tuple[tuple[TimeWindow, ...], Notes]:
    """The air of each window of a flight, in the order of time; none where one profile is enough.

    ``h_c``, ``h_g``: heights of cameras and of the ground [m above sea level], for the change of R.

    A window whose estimate fails its checks, or predicts its own held-out readings worse than the
    whole flight does, keeps the air of the whole. One profile is enough where R departs from that
    of the whole by less than its own sigma, RMS over the windows.
    """
    samples, covariance, moisture = whole.samples, whole.covariance, whole.moisture
    if samples is None or covariance is None or moisture is None:
        return (), ()
    parts = time_windows(samples)
    if len(parts) < 2:
        return (), ()
    hours = (parts[-1][1] - parts[0][0]) / 3.6e12
    background = _whole_flight_as_background(covariance, moisture.spread, hours)
    # Where the readings of a window cannot be used: the whole's air, changed as over the flight.
    anywhere = SampleAges(np.array([covariance.anchor_height_m]), np.array([hours]))
    aged = profile_series.covariance_with_ageing(covariance, anywhere)
    changed = TimedProfile(None, whole.profile, aged)
    windows = []
    for start_ns, end_ns in parts:
        part = part_of_flight(samples, start_ns, end_ns)
        deciding = _deciding_sensor(part)
        visited_ns = deciding.middle_of_heights_ns if deciding is not None else None
        middle_ns = (start_ns + end_ns) // 2 if visited_ns is None else visited_ns
        air = replace(changed, time_ns=middle_ns)
        own, why_not = _own_air(part, air, whole, background)
        if own is None or own.own_covariance is None:
            windows.append(TimeWindow(start_ns, end_ns, air, why_not=why_not))
            continue
        change = own.change_from(changed, h_c, h_g)
        sigma = own.own_covariance.relative_sigma(max(h_c), h_g)
        windows.append(TimeWindow(start_ns, end_ns, own, change, sigma))
    estimated = [window for window in windows if not window.why_not]
    if not estimated:
        return (), (messages.air_windows_none(hours=hours),)
    departure = float(np.sqrt(np.mean([(w.change / w.sigma) ** 2 for w in estimated])))
    largest, count = 100.0 * max(abs(w.change) for w in estimated), len(parts)
    if departure < SIGNIFICANT:
        return (), (
            messages.air_windows_one(hours=hours, total=count, sigmas=departure, largest=largest),
        )
    notes = [messages.air_windows(hours=hours, count=count, sigmas=departure, largest=largest)]
    for w in windows:
        if w.why_not:
            when = _moment(w.air.time_ns, utc_known=whole.utc_known)
            notes.append(messages.air_window(when=when, reason=w.why_not))
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
    """The whole flight as what is expected in a part of it; ``spread`` of the climatology."""
    profile = covariance.profile
    h = spread.h_m[(spread.h_m > profile.bottom_m) & (spread.h_m < profile.top_m)]
    change = profile_series.change_parts(
        profile.gravity.latitude_rad,
        covariance.anchor_height_m,
        hours,
        metres=0.0,
        h_m=h,
    )
    weather = profile_series.CHANGE_LOG_P_PER_H * hours
    level = float(np.hypot(covariance.sigma_log_pressure(0.0)[0], weather))
    of_errors = Part("flight", h, covariance.sigma_temperature(h), OWN_LENGTH_M)
    humidity = np.minimum(spread.sigma_relative_humidity(h), profile_series.CHANGE_RH)
    of_flight = Spread((*change, of_errors), h, humidity, spread.humidity_correlation_m, level)
    return Climatology(profile, of_flight, "the whole flight", True)


def _own_air(
    part: AirSamples, air: TimedProfile, whole: Adjustment, background: Climatology
) -> tuple[TimedProfile | None, str]:
    """The air of a window by its own readings, or None and why they cannot be used."""
    if _deciding_sensor(part) is None:
        return None, "nothing was measured then"
    known = [  # sensor faults, a little less certain in another hour
        replace(f, sigma=float(np.hypot(f.sigma, _FAULT_CHANGE * f.prior_sigma)))
        for f in whole.faults
    ]
    made = estimate(part, background, settings=whole.settings, known=known)
    if not made.converged:
        return None, "its estimate did not converge"
    if whole.moisture is not None and not (check := is_plausible(made, whole.moisture)):
        return None, check.reason
    check = is_better_than_background(made, background, background, name="the whole flight")
    if not check:
        return None, check.reason
    layers = made.profile.layers
    layers = replace(layers, source=whole.profile.layers.sources_between(layers.edge))
    profile = replace(made.profile, layers=layers)
    doubled = COUNTED_TWICE * made.covariance.matrix
    covariance = replace(made.covariance, profile=profile, matrix=doubled)
    return TimedProfile(air.time_ns, profile, covariance), ""
