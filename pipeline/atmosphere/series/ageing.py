"""How the air changes with time, and how much less is known of it when it was sampled long ago."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate.state import exponential
from pipeline.atmosphere.refractive_index import saturation_vapour_pressure

Array = NDArray[np.float64]

CHANGE_K2_PER_H, CHANGE_LENGTH_M = 2.0, 1500.0
CHANGE_ALOFT = 0.3
"""Variance of what the air is from its mean over the flight, at the ground; aloft a third of the
sigma, with the same scale height as the spread of the climatology. Set by judgement: the boundary
layer warms by some 5 K from dawn to noon."""

CHANGE_LOG_P_PER_H = 5e-4
CHANGE_RH, CHANGE_RH_IN_H = 0.1, 4.0
"""Of relative humidity, reached after four hours."""

FRESH_S = 1800.0
"""In half an hour the air of a calm day changes by some 0.5 K at the ground: R by 0.2 %."""

_BIN_M, _MINUTE_NS = 100.0, 60 * 10**9


@dataclass(frozen=True, eq=False)
class SampleAges:
    """Hours (n,) that the air of heights (n,) [m] has changed for since, or until, it was sampled.

    sqrt(t^2 - (1/2 h)^2): nothing within half an hour, and nearly t in the end.
    """

    h_m: Array
    hours: Array

    @property
    def is_fresh(self) -> bool:
        """Whether all of it was sampled within half an hour."""
        return not bool(np.any(self.hours > 0.0))


def sample_ages(
    samples: AirSamples, time_ns: Sequence[int], h_g: float, h_c: float
) -> list[SampleAges]:
    """How old the air between two heights [m above sea level] is at times [Unix ns].

    By the nearest readings of thermometer or barometer before or after, in bins of 100 m; a bin
    without readings is as old as its neighbours.
    """
    visits = [
        (np.floor(s.h_m[s.accepted] / _BIN_M), s.time_ns[s.accepted] // _MINUTE_NS)
        for s in (samples.temperature, samples.pressure)
        if s is not None
    ]
    if not any(bins.size for bins, _ in visits):
        return [SampleAges(np.zeros(1), np.zeros(1)) for _ in time_ns]
    both = np.unique(
        np.concatenate([np.stack([bins.astype(np.int64), at]) for bins, at in visits], axis=1),
        axis=1,
    )
    inside = (both[0] + 1 >= h_g / _BIN_M) & (both[0] <= h_c / _BIN_M)
    number, minute = both[:, inside] if bool(inside.any()) else both
    bins = np.unique(number)
    visited = [minute[number == i] for i in bins]
    middles = (bins + 0.5) * _BIN_M
    ages = []
    for now in time_ns:
        apart = np.array([np.abs(at - now // _MINUTE_NS).min() / 60.0 for at in visited])
        fresh = (FRESH_S / 3600.0) ** 2
        ages.append(SampleAges(middles, np.sqrt(np.maximum(apart**2 - fresh, 0.0))))
    return ages


def change_sigma(above_ground_m: Array, hours: Array | float) -> Array:
    """One sigma [K] of how temperature changes in hours, at heights above the ground."""
    near = np.exp(-np.maximum(above_ground_m, 0.0) / CHANGE_LENGTH_M)
    return np.asarray(np.sqrt(CHANGE_K2_PER_H * hours) * (CHANGE_ALOFT + (1 - CHANGE_ALOFT) * near))


def covariance_with_ageing(covariance: ProfileCovariance, ages: SampleAges) -> ProfileCovariance:
    """A covariance with what the air changes in its age added.

    Temperatures wander by `change_sigma`, neighbours within 1500 m alike, and carry pressure with
    them from the height that was sampled last, where ln p itself changes by 5e-4 an hour; relative
    humidity by 0.1 in four hours.
    """
    profile = covariance.profile
    edge = profile.layers.edge
    k = edge.size
    h = profile.gravity.height(edge)
    hours = np.interp(h, ages.h_m, ages.hours)
    alike = exponential(edge, CHANGE_LENGTH_M)
    warming = change_sigma(h - ages.h_m[0], hours)
    matrix = np.zeros_like(covariance.matrix)
    by_state = np.eye(2 * k + 1)
    matrix[:k, :k] = np.outer(warming, warming) * alike
    matrix[k, k] = (CHANGE_LOG_P_PER_H * float(hours.min())) ** 2
    saturated = saturation_vapour_pressure(profile.temperature(h)) / profile.pressure(h)
    moistening = CHANGE_RH * np.sqrt(np.minimum(hours / CHANGE_RH_IN_H, 1.0))
    moistening *= np.minimum(saturated, profile.layers.vapour.max())
    matrix[k + 1 :, k + 1 :] = np.outer(moistening, moistening) * alike
    last = ages.h_m[np.flatnonzero(ages.hours == ages.hours.min())[-1:]]
    by_state[k, :k] = -covariance.log_pressure_by_virtual(last)[0]
    added = by_state @ matrix @ by_state.T
    return replace(covariance, matrix=covariance.matrix + added)
