"""The age and distance of the air that a flight sampled, and how much it changes by them.

The age is the time between an exposure and the samples of the air, whichever was first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.air_variation import (
    CYCLE_LENGTH_M,
    SPRING,
    DailyCycle,
    Part,
    Parts,
    covariance_of,
    variation_parts,
)
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.state import exponential
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import saturation_vapour_pressure
from unbend.messages import Message
from unbend.units import Array, Integers

CHANGE_LOG_P_PER_H = 5e-4  # one sigma; 0.5 hPa an hour
CHANGE_LOG_P_PER_M = 1.5e-8  # one sigma; a wind of 12 m/s

CHANGE_RH = 0.1  # one sigma of the change of relative humidity, reached after four hours
CHANGE_RH_IN_H = 4.0
CHANGE_RH_LENGTH_M = 1500.0  # correlation of that in height [m]

METRES_AS_AN_HOUR = 36e3
"""Distance over which weather changes as much as in an hour (`data/air_variation.toml`: 48 h and
1300 to 2300 km)."""

FRESH_S = 1800.0
FRESH_M = FRESH_S / 3600.0 * METRES_AS_AN_HOUR
"""Air sampled within half an hour and 18 km counts as that of the exposure: at the ground it
changes by some 0.6 K in that time."""

_BIN_M = 100.0
_MINUTE_NS = 60 * 10**9
_EARTH_M = 6.371e6
_MIDDLE_LATITUDE_RAD = 0.8  # of a profile without a place


@dataclass(frozen=True, eq=False)
class FlightPath:
    """Times and places (k,) of a flight; longitudes go on across the 180th meridian."""

    time_ns: Integers
    latitude_rad: Array
    longitude_rad: Array

    def metres_at(self, time_ns: Integers) -> Array:
        """(2, n) metres north and east of the first place at times (n,) [Unix ns]."""
        first_ns = self.time_ns[0]
        seconds = (time_ns - first_ns) * 1e-9
        path_s = (self.time_ns - first_ns) * 1e-9
        first_latitude = self.latitude_rad[0]
        first_longitude = self.longitude_rad[0]
        north = np.interp(seconds, path_s, self.latitude_rad - first_latitude)
        east = np.interp(seconds, path_s, self.longitude_rad - first_longitude)
        return _EARTH_M * np.stack([north, east * np.cos(first_latitude)])

    def metres_between(self, time_ns: Integers, now_ns: int) -> Array:
        """(n,) distance [m] between the places at times (n,) and that at another time [Unix ns]."""
        here = self.metres_at(np.array([now_ns]))
        north, east = self.metres_at(time_ns) - here
        return np.asarray(np.hypot(north, east))


@dataclass(frozen=True, eq=False)
class SampleAges:
    """Age and distance of the samples of the air at heights (n,) [m above sea level], increasing.

    ``hours`` (n,): sqrt(t^2 - (1/2 h)^2) for samples a time t before or after the exposure, 0
    within half an hour. ``metres`` (n,) or one: likewise of the distance, 0 within 18 km.
    """

    h_m: Array
    hours: Array
    metres: Array | float = 0.0

    @property
    def is_fresh(self) -> bool:
        """Whether the air of all heights was sampled within half an hour and 18 km."""
        is_old = np.any(self.hours > 0.0)
        is_far = np.any(np.asarray(self.metres) > 0.0)
        return not bool(is_old or is_far)


class Visits(NamedTuple):
    """Bins of 100 m in which a sensor was read (n,), and in which minutes of Unix time (n,).

    Bin number i is from 100 i to 100 (i + 1) m above sea level.
    """

    bin_number: Integers
    minute: Integers

    def between(self, h_g: float, h_c: float) -> Visits:
        """The visits to bins between ground and camera [m]; all visits if there are none."""
        is_above_ground = self.bin_number + 1 >= h_g / _BIN_M
        is_below_camera = self.bin_number <= h_c / _BIN_M
        inside = is_above_ground & is_below_camera
        if not bool(inside.any()):
            return self
        return Visits(self.bin_number[inside], self.minute[inside])


def visits_of(samples: AirSamples) -> Visits:
    """The visits of thermometer and barometer to bins of 100 m, each bin once a minute."""
    visits = []
    for sensor in (samples.temperature, samples.pressure):
        if sensor is not None:
            bins = np.floor(sensor.h_m[sensor.accepted] / _BIN_M)
            minutes = sensor.time_ns[sensor.accepted] // _MINUTE_NS
            visits.append(np.stack([bins.astype(np.int64), minutes]))
    if not visits:
        return Visits(np.zeros(0, np.int64), np.zeros(0, np.int64))
    bin_number, minute = np.unique(np.hstack(visits), axis=1)
    return Visits(bin_number, minute)


def sample_ages(
    samples: AirSamples,
    time_ns: Sequence[int],
    h_g: float,
    h_c: float,
    path: FlightPath | None = None,
) -> list[SampleAges]:
    """Age and distance of the sampled air from ground to camera, at each of some times [Unix ns].

    ``h_g``, ``h_c``: heights of ground and camera [m above sea level]. In each bin of 100 m between
    them, the reading of thermometer or barometer counts that is nearest in time (before or after)
    and distance together. ``path`` gives the distances; without it they are 0. Without any reading
    all air counts as fresh.
    """
    visits = visits_of(samples)
    if visits.minute.size == 0:
        return [SampleAges(np.zeros(1), np.zeros(1)) for _ in time_ns]
    visits = visits.between(h_g, h_c)
    return [ages_at(now_ns, visits, path) for now_ns in time_ns]


def ages_at(
    now_ns: int,
    visits: Visits,
    path: FlightPath | None,
) -> SampleAges:
    """Age and distance of the air of each visited bin at a time [Unix ns], by its nearest visit.

    Nearest in time and distance together (`METRES_AS_AN_HOUR`).
    """
    hours = np.abs(visits.minute - now_ns // _MINUTE_NS) / 60.0
    metres = np.zeros(hours.size)
    if path is not None:
        metres = path.metres_between(visits.minute * _MINUTE_NS, now_ns)
    apart = hours + metres / METRES_AS_AN_HOUR
    nearest_first = np.lexsort([apart, visits.bin_number])  # by bin, then by nearness
    bins, first = np.unique(visits.bin_number[nearest_first], return_index=True)
    nearest = nearest_first[first]
    return SampleAges(
        h_m=np.asarray((bins + 0.5) * _BIN_M, np.float64),
        hours=beyond(hours[nearest], FRESH_S / 3600.0),
        metres=beyond(metres[nearest], FRESH_M),
    )


def beyond(values: Array, fresh: float) -> Array:
    """sqrt(v^2 - fresh^2) of values v (n,); 0 for values below ``fresh``.

    >>> beyond(np.array([0.3, 0.5, 1.3]), 0.5).round(6).tolist()
    [0.0, 0.0, 1.2]
    """
    square = np.maximum(values**2 - fresh**2, 0.0)
    return np.asarray(np.sqrt(square))


def aged_note(ages: Sequence[SampleAges], *, count: int) -> Message:
    """Message that the air of ``count`` exposures is old or from far away, with the extremes."""
    oldest = max(ages, key=lambda age: float(age.hours.max()))
    farthest_m = max(float(np.max(age.metres)) for age in ages)
    farthest_km = 0.0
    if farthest_m > 0.0:
        farthest_km = np.hypot(farthest_m, FRESH_M) * 1e-3
    return messages.air_aged(
        hours=np.hypot(oldest.hours.max(), FRESH_S / 3600.0),
        km=farthest_km,
        height_m=oldest.h_m[int(np.argmax(oldest.hours))],
        count=count,
    )


def change_parts(
    latitude_rad: float | None,
    ground_h_m: float,
    hours: ArrayLike,
    metres: ArrayLike,
    h_m: Array,
) -> Parts:
    """The parts of the change of temperature over some hours and metres, as standard deviations.

    ``hours``, ``metres``: one, or (n,) at heights ``h_m`` (n,) [m above sea level], increasing.
    ``ground_h_m``: of the ground [m above sea level]. The change is that of the structure function
    and of the day's cycle, where the hour of the day is unknown.
    """
    latitude = _MIDDLE_LATITUDE_RAD if latitude_rad is None else latitude_rad
    parts = variation_parts(latitude, SPRING, ground_h_m)
    nodes_m = parts[0].h_m
    hours_there = np.interp(nodes_m, h_m, np.broadcast_to(hours, h_m.shape))
    metres_there = np.interp(nodes_m, h_m, np.broadcast_to(metres, h_m.shape))
    changes = [part.change(hours_there, metres_there) for part in parts]

    cycle_k = DailyCycle(latitude, SPRING, ground_h_m).by_hour_k(nodes_m)
    phase = 2.0 * np.pi * hours_there / 24.0
    change_k = cycle_k * np.sqrt(1.0 - np.cos(phase))
    changes.append(Part("day", nodes_m, change_k, CYCLE_LENGTH_M))
    return tuple(changes)


def covariance_with_ageing(covariance: ProfileCovariance, ages: SampleAges) -> ProfileCovariance:
    """A covariance, to which the change of the air by its age and distance is added.

    Temperatures change by `change_parts`, and pressures with them by hydrostatics, starting at the
    height that was sampled last; ln p at this height changes too, and so does relative humidity.
    """
    profile = covariance.profile
    edge = profile.layers.edge
    k = edge.size
    h = profile.gravity.height(edge)
    metres = np.broadcast_to(ages.metres, ages.h_m.shape)
    ground_m = float(ages.h_m[0])
    parts = change_parts(
        profile.gravity.latitude_rad,
        ground_m,
        ages.hours,
        metres,
        ages.h_m,
    )
    moistening = change_of_vapour(profile, ages)
    moistening_correlation = exponential(edge, CHANGE_RH_LENGTH_M)

    matrix = np.zeros_like(covariance.matrix)
    matrix[:k, :k] = covariance_of(parts, h, h)
    matrix[k, k] = _change_of_log_pressure(ages) ** 2
    matrix[k + 1 :, k + 1 :] = np.outer(moistening, moistening) * moistening_correlation

    last_sampled = np.flatnonzero(ages.hours == ages.hours.min())[-1:]
    last_m = ages.h_m[last_sampled]
    by_state = np.eye(2 * k + 1)
    by_state[k, :k] = -covariance.log_pressure_by_virtual(last_m)[0]
    change = by_state @ matrix @ by_state.T
    return replace(covariance, matrix=covariance.matrix + change)


def _change_of_log_pressure(ages: SampleAges) -> float:
    """One sigma of the change of ln p at the height that was sampled last."""
    metres = np.broadcast_to(ages.metres, ages.h_m.shape)
    by_time = CHANGE_LOG_P_PER_H * ages.hours.min()
    by_distance = CHANGE_LOG_P_PER_M * metres.min()
    return float(np.hypot(by_time, by_distance))


def change_of_vapour(profile: Profile, ages: SampleAges) -> Array:
    """(k,) one sigma of the change of e/p at the edges of a profile, by age and distance.

    It is a change of relative humidity, at most as large as in air with the largest e/p of the
    profile.
    """
    h = profile.gravity.height(profile.layers.edge)
    metres = np.broadcast_to(ages.metres, ages.h_m.shape)
    as_hours = ages.hours + metres / METRES_AS_AN_HOUR
    age_h = np.interp(h, ages.h_m, as_hours)
    reached = np.minimum(age_h / CHANGE_RH_IN_H, 1.0)
    change_rh = CHANGE_RH * np.sqrt(reached)
    saturation_pa = saturation_vapour_pressure(profile.temperature(h))
    saturated = saturation_pa / profile.pressure(h)
    wettest = profile.layers.vapour.max()
    return np.asarray(change_rh * np.minimum(saturated, wettest))
