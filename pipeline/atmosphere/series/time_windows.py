"""The air of a long flight in parts: windows of time, each estimated by itself.

The estimate of the whole flight is the background of each window, so that heights which a window
did not visit keep what the rest of the flight found there; what was found wrong with the sensors is
carried over too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.climatology import Climatology, Spread
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate.adjusted_profile import Adjustment
from pipeline.atmosphere.estimate.candidates import SMALLEST_BAROMETRIC_CLIMB_M, SMALLEST_CLIMB_M
from pipeline.atmosphere.estimate.estimate_checks import implausible, worse_than_climatology
from pipeline.atmosphere.estimate.solver import Estimate, Nuisance, estimate
from pipeline.atmosphere.series.ageing import (
    CHANGE_LOG_P_PER_H,
    CHANGE_RH,
    FRESH_S,
    SampleAges,
    change_sigma,
    covariance_with_ageing,
)
from pipeline.atmosphere.series.profile_series import TimedProfile
from pipeline.ledger import Ledger

Array = NDArray[np.float64]

MOST_WINDOWS = 12  # each as long as the air stays fresh, or longer

_BIAS_WANDERS = 0.2
"""Share of a fault's expected sigma by which it may be another in another window."""

SIGNIFICANT = 1.5
"""Sigmas (RMS over the windows) by which R must depart from the whole flight's to be believed: in
air that stood still 16 flights of four hours came to 1.3 at most."""

COUNTED_TWICE = 2.0
"""A window's readings are in its background too, so its covariance is doubled. Without this errors
of R were 1.1 to 1.6 sigma RMS in six sets of flights."""


@dataclass(frozen=True, eq=False)
class TimeWindow:
    """A part of the flight [Unix ns] and its air; ``change`` is ln of its R over the whole's.

    ``why_not`` says in words why its own estimate is not used, and is empty where it is.
    """

    start_ns: int
    end_ns: int
    air: TimedProfile
    change: float = 0.0
    sigma: float = 0.0
    why_not: str = ""


def time_windows(samples: AirSamples) -> tuple[tuple[int, int], ...]:
    """Parts of a flight [Unix ns], each half an hour or more, that span enough height.

    A part that says too little by the gates of `build_adjusted_profile` is joined with its
    shorter neighbour. One part where the flight is short or the samples say too little.

    >>> time_windows(AirSamples())
    ()
    """
    gated = _gated(samples)
    if gated is None:
        return ()
    sensor, least = gated
    time = sensor.time_ns[sensor.accepted]
    if time.size == 0:
        return ()
    first, last = int(time[0]), int(time[-1]) + 1
    count = min(MOST_WINDOWS, int((last - first) * 1e-9 / FRESH_S))
    edges = [first + (last - first) * i // max(count, 1) for i in range(max(count, 1) + 1)]
    parts = list(pairwise(edges))
    while len(parts) > 1:
        extents = [_part(sensor, *part).extent_m for part in parts]
        i = int(np.argmin(extents))
        if extents[i] >= least:
            break
        sides = [j for j in (i - 1, i + 1) if 0 <= j < len(parts)]
        j = min(sides, key=lambda side: parts[side][1] - parts[side][0])
        low, high = sorted((i, j))
        parts[low : high + 1] = [(parts[low][0], parts[high][1])]
    return tuple(parts)


def _gated(samples: AirSamples) -> tuple[SensorSamples, float] | None:
    """The sensor whose heights decide, and the height it must span [m]."""
    if samples.temperature is not None:
        return samples.temperature, SMALLEST_CLIMB_M
    if samples.pressure is not None:
        return samples.pressure, SMALLEST_BAROMETRIC_CLIMB_M
    return None


def _part(sensor: SensorSamples, start_ns: int, end_ns: int) -> SensorSamples:
    rows = slice(*np.searchsorted(sensor.time_ns, [start_ns, end_ns]))
    return SensorSamples(
        sensor.time_ns[rows],
        sensor.h_m[rows],
        sensor.value[rows],
        sensor.accepted[rows],
        sensor.name,
    )


def part_of_flight(samples: AirSamples, start_ns: int, end_ns: int) -> AirSamples:
    """What a flight measured from one time until before another [Unix ns].

    Take-offs stay those of the whole flight; where nobody looked for them, a part that begins
    after the first sample begins in the air.
    """
    parts = {
        name: _part(sensor, start_ns, end_ns)
        for name in ("temperature", "pressure", "humidity", "airspeed")
        if (sensor := getattr(samples, name)) is not None
    }
    takeoffs = samples.takeoff_ns
    gated = _gated(samples)
    if takeoffs is None and gated is not None and start_ns > int(gated[0].time_ns[0]):
        takeoffs = np.empty(0, np.int64)
    parts = {name: sensor for name, sensor in parts.items() if sensor.time_ns.size}
    return AirSamples(
        **parts,
        takeoff_ns=takeoffs,
        board_temperature=samples.board_temperature,
        calibration=samples.calibration,
    )


def estimate_windows(
    whole: Adjustment, h_c: Sequence[float], h_g: float, ledger: Ledger
) -> tuple[TimeWindow, ...]:
    """The air of each window of a flight, in the order of time; none where one profile is enough.

    Parameters
    ----------
    whole : the air of the whole flight, from `build_adjusted_profile`.
    h_c, h_g : heights of cameras and of the ground [m above sea level], by which the change of R
        is judged.

    A window whose estimate is no air, or foretells its own held-out readings worse than the whole
    flight does, keeps the air of the whole. One profile is enough where R departs from that of the
    whole by less than its own sigma, RMS over the windows.
    """
    samples, covariance, moisture = whole.samples, whole.covariance, whole.moisture
    if samples is None or covariance is None or moisture is None:
        return ()
    parts = time_windows(samples)
    if len(parts) < 2:
        return ()
    hours = (parts[-1][1] - parts[0][0]) / 3.6e12
    background = _background(covariance, moisture.spread, hours)
    # Where what a window measured cannot be used: the whole's air, changed as over the flight.
    anywhere = SampleAges(np.array([covariance.anchor_height_m]), np.array([hours]))
    doubted = TimedProfile(None, whole.profile, covariance_with_ageing(covariance, anywhere))
    windows = []
    for start, end in parts:
        part = part_of_flight(samples, start, end)
        windows.append(_window(part, (start, end), whole, background, doubted, h_c, h_g))
    own = [w for w in windows if not w.why_not]
    if not own:
        ledger.note("AIR-WINDOWS", f"one profile for {hours:.1f} h: no part of it says more")
        return ()
    departure = float(np.sqrt(np.mean([(w.change / w.sigma) ** 2 for w in own])))
    largest = 100.0 * max(abs(w.change) for w in own)
    if departure < SIGNIFICANT:
        ledger.note(
            "AIR-WINDOWS",
            f"one profile for {hours:.1f} h: over {len(parts)} windows R changes by "
            f"{largest:.2f} % at most, {departure:.1f} sigma",
        )
        return ()
    ledger.note(
        "AIR-WINDOWS",
        f"the air changes: {len(parts)} windows in {hours:.1f} h, R departs from that of the whole "
        f"flight by up to {largest:.2f} %, {departure:.1f} sigma",
        count=len(parts),
    )
    for w in windows:
        if w.why_not:
            when = np.datetime64(w.air.time_ns, "ns").astype("datetime64[s]")
            ledger.fallback("AIR-WINDOW", f"about {when} the whole flight's air: {w.why_not}")
    return tuple(windows)


def _background(covariance: ProfileCovariance, spread: Spread, hours: float) -> Climatology:
    """The whole flight as what is expected in a part of it; ``spread`` of the climatology."""
    profile = covariance.profile
    h = spread.h_m[(spread.h_m > profile.bottom_m) & (spread.h_m < profile.top_m)]
    lowest = float(covariance.anchor_height_m)
    change = change_sigma(h - lowest, hours)
    level = float(covariance.sigma_log_pressure(0.0)[0])
    doubt = np.minimum(spread.sigma_relative_humidity(h), CHANGE_RH)
    return Climatology(
        profile,
        Spread(
            h,
            np.hypot(covariance.sigma_temperature(h), change),
            doubt,
            spread.correlation_m,
            spread.humidity_correlation_m,
            float(np.hypot(level, CHANGE_LOG_P_PER_H * hours)),
        ),
        "the whole flight",
        True,
    )


def _window(
    part: AirSamples,
    span: tuple[int, int],
    whole: Adjustment,
    background: Climatology,
    doubted: TimedProfile,
    h_c: Sequence[float],
    h_g: float,
) -> TimeWindow:
    """One window, with its own air or with that of the whole flight and the reason."""
    middle = _informative_middle(part, sum(span) // 2)
    fallen = replace(doubted, time_ns=middle)
    if _gated(part) is None:
        return TimeWindow(*span, fallen, why_not="nothing was measured then")
    made = estimate(part, background, known=_carried(whole.nuisances))
    fault = _fault(made, background, whole.moisture)
    if fault is not None:
        return TimeWindow(*span, fallen, why_not=fault)
    layers = made.profile.layers
    layers = replace(layers, source=whole.profile.layers.sources_between(layers.edge))
    profile = replace(made.profile, layers=layers)
    doubled = COUNTED_TWICE * made.covariance.matrix
    covariance = replace(made.covariance, profile=profile, matrix=doubled)
    air = TimedProfile(middle, profile, covariance)
    change = air.change_from(doubted, h_c, h_g)
    return TimeWindow(*span, air, change, covariance.relative_sigma(max(h_c), h_g))


def _fault(made: Estimate, background: Climatology, expected: Climatology | None) -> str | None:
    """Why a window's estimate is no air by the climatology, or no better than the whole flight."""
    if not made.converged:
        return "its estimate did not settle"
    if expected is not None and (fault := implausible(made, expected)) is not None:
        return fault
    return worse_than_climatology(made, background, background, called="the whole flight")


def _carried(nuisances: Sequence[Nuisance]) -> tuple[Nuisance, ...]:
    """What was found of the sensors, a little less certain in another hour."""
    return tuple(
        replace(n, sigma=float(np.hypot(n.sigma, _BIAS_WANDERS * n.prior_sigma))) for n in nuisances
    )


def _informative_middle(part: AirSamples, otherwise: int) -> int:
    """When the heights of a part were visited [Unix ns]: each bin of 100 m weighs alike.

    A climb at the end of an hour of level flight tells of the air then, not half an hour before.
    """
    gated = _gated(part)
    if gated is None or not bool(gated[0].accepted.any()):
        return otherwise
    sensor = gated[0]
    h, _ = sensor.used()
    time = sensor.time_ns[sensor.accepted]
    _, number = np.unique(np.floor(h / 100.0), return_inverse=True)
    seconds = (time - time[0]) * 1e-9
    mean = np.bincount(number, seconds) / np.bincount(number)
    return int(time[0]) + round(float(mean.mean()) * 1e9)
