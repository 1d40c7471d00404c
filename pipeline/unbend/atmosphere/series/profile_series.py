"""The air along a flight: profiles at several times, the one of each exposure, and its ageing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
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
from unbend.atmosphere.covariance import ProfileCovariance, plane_rule
from unbend.atmosphere.estimate.state import exponential
from unbend.atmosphere.hypsometry import hats
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel, saturation_vapour_pressure
from unbend.messages import Message, Notes
from unbend.units import Array, Integers

FINEST_CHANGE = 5e-4
"""Profiles follow each other so closely that R changes by less than this from one to the next."""

SLOT_NS = 900 * 10**9  # exposures within a quarter of an hour share the age of their air [ns]

_STEPS = 100  # trapezia of the plane integral
_SLIVER_M = 1.0  # edges of two profiles nearer than this become one [m']

CHANGE_LOG_P_PER_H = 5e-4
CHANGE_LOG_P_PER_M = 1.5e-8
CHANGE_RH, CHANGE_RH_IN_H = 0.1, 4.0  # of relative humidity, reached after four hours

CHANGE_RH_LENGTH_M = 1500.0  # correlation of that in height [m]

METRES_AS_AN_HOUR = 36e3
"""Weather changes as much over so much distance as in an hour (`data/air_variation.toml`: 48 h and
1300 to 2300 km); of two visits to a height the nearer counts."""

FRESH_S = 1800.0
FRESH_M = FRESH_S / 3600.0 * METRES_AS_AN_HOUR
"""Air sampled within half an hour, and within as much in distance (18 km), counts as that of the
exposure: at the ground it changes by some 0.6 K in that time."""

CELL_M = 20e3  # exposures of so large a square share the distance of their air [m]

_BIN_M, _MINUTE_NS = 100.0, 60 * 10**9
_EARTH_M = 6.371e6
_MIDDLE_LATITUDE_RAD = 0.8  # of a profile without a place


@dataclass(frozen=True, eq=False)
class FlightPath:
    """Where a flight was (k,), longitudes going on across the 180th meridian."""

    time_ns: Integers
    latitude_rad: Array
    longitude_rad: Array

    def metres_at(self, time_ns: Integers) -> Array:
        """(2, n) metres north and east of the first place at times (n,) [Unix ns]."""
        first_ns = self.time_ns[0]
        seconds = (time_ns - first_ns) * 1e-9
        known_s = (self.time_ns - first_ns) * 1e-9
        north = np.interp(seconds, known_s, self.latitude_rad - self.latitude_rad[0])
        east = np.interp(seconds, known_s, self.longitude_rad - self.longitude_rad[0])
        return _EARTH_M * np.stack([north, east * np.cos(self.latitude_rad[0])])

    def metres_between(self, time_ns: Integers, now_ns: int) -> Array:
        """(n,) distance [m] between the places at times (n,) and that at another time [Unix ns]."""
        here = self.metres_at(np.array([now_ns]))
        return np.asarray(np.hypot(*(self.metres_at(time_ns) - here)))


class PlaceInTime(NamedTuple):
    """Where and when air was met: geographic place [rad] and time [Unix ns]."""

    latitude_rad: float
    longitude_rad: float
    time_ns: int


@dataclass(frozen=True, eq=False)
class SampleAges:
    """How old, and how far away, the air of heights (n,) [m] is that was sampled.

    ``hours`` (n,) that it has changed for since, or until, it was sampled: sqrt(t^2 - (1/2 h)^2),
    nothing within half an hour, and nearly t in the end. ``metres`` (n,) likewise to where it was,
    nothing within 18 km.
    """

    h_m: Array
    hours: Array
    metres: Array | float = 0.0

    @property
    def is_fresh(self) -> bool:
        """Whether all of it was sampled within half an hour and 18 km."""
        return not bool(np.any(self.hours > 0.0) or np.any(np.asarray(self.metres) > 0.0))


class Visits(NamedTuple):
    """Bins of height (n,) in which a sensor was read, and the minutes (n,) of Unix time."""

    bin_number: Integers
    minute: Integers

    def between(self, h_g: float, h_c: float) -> Visits:
        """Those between two heights [m]; all where there are none."""
        is_above = self.bin_number + 1 >= h_g / _BIN_M
        inside = is_above & (self.bin_number <= h_c / _BIN_M)
        if not bool(inside.any()):
            return self
        return Visits(self.bin_number[inside], self.minute[inside])


def visits_of(samples: AirSamples) -> Visits:
    """The visits of thermometer and barometer to bins of 100 m, each bin once a minute."""
    both = []
    for sensor in (samples.temperature, samples.pressure):
        if sensor is not None:
            bins = np.floor(sensor.h_m[sensor.accepted] / _BIN_M).astype(np.int64)
            both.append(np.stack([bins, sensor.time_ns[sensor.accepted] // _MINUTE_NS]))
    if not both:
        return Visits(np.zeros(0, np.int64), np.zeros(0, np.int64))
    return Visits(*np.unique(np.hstack(both), axis=1))


def sample_ages(
    samples: AirSamples,
    time_ns: Sequence[int],
    h_g: float,
    h_c: float,
    path: FlightPath | None = None,
) -> list[SampleAges]:
    """How old the air between two heights [m above sea level] is at times [Unix ns].

    By the nearest readings of thermometer or barometer before or after, in bins of 100 m; and how
    far away it was sampled from where the flight was then, by its ``path``.
    """
    visits = visits_of(samples)
    if visits.minute.size == 0:
        return [SampleAges(np.zeros(1), np.zeros(1)) for _ in time_ns]
    visits = visits.between(h_g, h_c)
    return [ages_at(now_ns, visits, path) for now_ns in time_ns]


def ages_at(now_ns: int, visits: Visits, path: FlightPath | None) -> SampleAges:
    """How old and how far away the air of each bin is at a time [Unix ns], by its nearest visit."""
    hours = np.abs(visits.minute - now_ns // _MINUTE_NS) / 60.0
    metres = np.zeros(hours.size)
    if path is not None:
        metres = path.metres_between(visits.minute * _MINUTE_NS, now_ns)
    apart = hours + metres / METRES_AS_AN_HOUR
    nearest_first = np.lexsort([apart, visits.bin_number])
    bins, first = np.unique(visits.bin_number[nearest_first], return_index=True)
    nearest = nearest_first[first]
    return SampleAges(
        h_m=np.asarray((bins + 0.5) * _BIN_M, np.float64),
        hours=beyond(hours[nearest], FRESH_S / 3600.0),
        metres=beyond(metres[nearest], FRESH_M),
    )


def beyond(values: Array, fresh: float) -> Array:
    """sqrt(v^2 - fresh^2) of values (n,), 0 of those that are smaller.

    >>> beyond(np.array([0.3, 0.5, 1.3]), 0.5).round(6).tolist()
    [0.0, 0.0, 1.2]
    """
    return np.asarray(np.sqrt(np.maximum(values**2 - fresh**2, 0.0)))


def change_parts(
    latitude_rad: float | None, ground_h_m: float, hours: ArrayLike, metres: ArrayLike, h_m: Array
) -> Parts:
    """How temperatures over a ground [m] change in hours and metres (n,) for heights (n,) [m].

    To the structure function comes the mean cycle of the day, over hours whose place in the day is
    not known.
    """
    latitude = _MIDDLE_LATITUDE_RAD if latitude_rad is None else latitude_rad
    parts = variation_parts(latitude, SPRING, ground_h_m)
    nodes_m = parts[0].h_m
    hours_there = np.interp(nodes_m, h_m, np.broadcast_to(hours, h_m.shape))
    metres_there = np.interp(nodes_m, h_m, np.broadcast_to(metres, h_m.shape))
    cycle_k = DailyCycle(latitude, SPRING, ground_h_m).by_hour_k(nodes_m)
    change_k = cycle_k * np.sqrt(1.0 - np.cos(2.0 * np.pi * hours_there / 24.0))
    of_day = Part("day", nodes_m, change_k, CYCLE_LENGTH_M)
    return (*(part.change(hours_there, metres_there) for part in parts), of_day)


def covariance_with_ageing(covariance: ProfileCovariance, ages: SampleAges) -> ProfileCovariance:
    """A covariance with what the air changes in its age, and over its distance, added.

    Temperatures change by `change_parts` and carry pressure with them from the height that was
    sampled last, where ln p itself changes too; so does relative humidity.
    """
    profile = covariance.profile
    edge = profile.layers.edge
    k = edge.size
    h = profile.gravity.height(edge)
    metres = np.broadcast_to(ages.metres, ages.h_m.shape)
    ground_m = float(ages.h_m[0])
    latitude_rad = profile.gravity.latitude_rad
    parts = change_parts(latitude_rad, ground_m, ages.hours, metres, ages.h_m)
    of_time = CHANGE_LOG_P_PER_H * ages.hours.min()
    of_distance = CHANGE_LOG_P_PER_M * metres.min()
    moistening = change_of_vapour(profile, ages)

    matrix = np.zeros_like(covariance.matrix)
    matrix[:k, :k] = covariance_of(parts, h, h)
    matrix[k, k] = float(np.hypot(of_time, of_distance)) ** 2
    correlation = exponential(edge, CHANGE_RH_LENGTH_M)
    matrix[k + 1 :, k + 1 :] = np.outer(moistening, moistening) * correlation
    by_state = np.eye(2 * k + 1)
    last_m = ages.h_m[np.flatnonzero(ages.hours == ages.hours.min())[-1:]]
    by_state[k, :k] = -covariance.log_pressure_by_virtual(last_m)[0]
    return replace(covariance, matrix=covariance.matrix + by_state @ matrix @ by_state.T)


def change_of_vapour(profile: Profile, ages: SampleAges) -> Array:
    """One sigma (k,) of what e/p at the edges of a profile has changed by in its age."""
    h = profile.gravity.height(profile.layers.edge)
    as_hours = ages.hours + np.broadcast_to(ages.metres, ages.h_m.shape) / METRES_AS_AN_HOUR
    age_h = np.interp(h, ages.h_m, as_hours)
    change_rh = CHANGE_RH * np.sqrt(np.minimum(age_h / CHANGE_RH_IN_H, 1.0))
    saturated = saturation_vapour_pressure(profile.temperature(h)) / profile.pressure(h)
    return np.asarray(change_rh * np.minimum(saturated, profile.layers.vapour.max()))


@dataclass(frozen=True, eq=False)
class TimedProfile:
    """The air at a time [Unix ns], with its covariance where there is one.

    Between ``neighbours`` (the earlier and the later profile and the share of the later) it is
    computed when needed: hundreds of them would fill memory. ``ages`` are those of its samples,
    where these are old; ``sampled_at`` is where they were taken.
    """

    time_ns: int | None
    profile: Profile
    own_covariance: ProfileCovariance | None = None
    neighbours: tuple[TimedProfile, TimedProfile, float] | None = None
    ages: SampleAges | None = None
    sampled_at: PlaceInTime | None = None

    @property
    def has_covariance(self) -> bool:
        """Whether `covariance` is known, without making it."""
        sources = (self,) if self.neighbours is None else self.neighbours[:2]
        return all(source.own_covariance is not None for source in sources)

    @property
    def covariance(self) -> ProfileCovariance | None:
        """That of the estimate, and the change of the air since it was sampled; between two
        profiles (1 - share) C_a + share C_b, the most that it can be."""
        covariance = self.own_covariance
        if self.neighbours is not None:
            a, b, share = self.neighbours
            if a.own_covariance is None or b.own_covariance is None:
                return None
            edge, anchor = self.profile.layers.edge, a.own_covariance.anchor_m
            matrix = (1.0 - share) * _covariance_at(a.own_covariance, edge, anchor)
            matrix += share * _covariance_at(b.own_covariance, edge, anchor)
            covariance = ProfileCovariance(self.profile, anchor, matrix)
        if covariance is None or self.ages is None:
            return covariance
        return covariance_with_ageing(covariance, self.ages)

    def change_from(self, other: TimedProfile, h_c: Sequence[float], h_g: float) -> float:
        """ln R of this air over that of another in the plane, the largest of several cameras at
        ``h_c`` over the ground at ``h_g`` [m above sea level]."""

        def r(air: TimedProfile, h_c: float) -> float:
            h, weight = plane_rule(h_c, h_g, _STEPS)
            return float(weight @ air.profile.refractivity(h))

        return float(max((np.log(r(self, h) / r(other, h)) for h in h_c), key=abs))


@dataclass(frozen=True, eq=False)
class ProfileSeries:
    """Profiles in the order of time, and which of them belongs to each of (s,) exposures; functions
    of height are those of a `Profile`, for (s,) heights, one of each exposure."""

    timed_profiles: tuple[TimedProfile, ...]
    profile_number: Integers

    @property
    def profiles(self) -> tuple[Profile, ...]:
        return tuple(air.profile for air in self.timed_profiles)

    @property
    def index(self) -> IndexModel:
        """The formula of the refractive index, the same in all."""
        return self.timed_profiles[0].profile.index

    def pressure(self, h: Array) -> Array:
        """(s,) pressure [Pa] at the heights of the exposures [m above sea level]."""
        return self._each(h, Profile.pressure)

    def temperature(self, h: Array) -> Array:
        """(s,) temperature [K]."""
        return self._each(h, Profile.temperature)

    def vapour_pressure(self, h: Array) -> Array:
        """(s,) partial pressure of water [Pa]."""
        return self._each(h, Profile.vapour_pressure)

    def refractivity(self, h: Array) -> Array:
        """(s,) n - 1."""
        return self._each(h, Profile.refractivity)

    def _each(self, h: Array, of: Callable[[Profile, ArrayLike], Array]) -> Array:
        if len(self.timed_profiles) == 1:
            return of(self.timed_profiles[0].profile, h)
        values = np.full(h.shape, np.nan)
        for i, air in enumerate(self.timed_profiles):
            rows = self.profile_number == i
            values[rows] = of(air.profile, h[rows])
        return values


def constant_series(air: TimedProfile, exposures: int) -> ProfileSeries:
    """The same air for all exposures."""
    return ProfileSeries((air,), np.zeros(exposures, np.int64))


def interpolate_series(
    nodes: Sequence[TimedProfile], time_ns: Integers, h_c: Sequence[float], h_g: float
) -> ProfileSeries:
    """The air at the times of exposures, linear in time between ``nodes`` and constant beyond.

    ``nodes``: two or more, in the order of time. ``time_ns``: (s,) of the exposures [Unix ns].
    ``h_c``, ``h_g``: heights of cameras and ground [m above sea level]. Between nodes stand just so
    many profiles that R of the cameras changes by less than 0.05 % from one to the next; an
    exposure takes the nearest in time, and what none takes is left out.
    """
    if any(node.time_ns is None for node in nodes):
        raise ValueError("air along a flight needs times")
    at = np.array([node.time_ns for node in nodes], np.int64)
    places: list[tuple[int, float]] = []
    for i, (a, b) in enumerate(pairwise(nodes)):
        count = max(1, int(np.ceil(abs(b.change_from(a, h_c, h_g)) / FINEST_CHANGE)))
        places += [(i, k / count) for k in range(count)]
    places.append((len(nodes) - 2, 1.0))
    times = np.array([at[i] + round(share * int(at[i + 1] - at[i])) for i, share in places])
    nearest = np.searchsorted(times[:-1] + np.diff(times) // 2, time_ns, side="left")
    used, number = np.unique(nearest, return_inverse=True)
    between = [(nodes[i], nodes[i + 1], share) for i, share in (places[u] for u in used)]
    airs = tuple(interpolate_profiles(*pair) for pair in between)
    return ProfileSeries(airs, number.astype(np.int64))


def add_ageing(
    series: ProfileSeries,
    time_ns: Integers,
    samples: AirSamples,
    h_c: float,
    h_g: float,
    path: FlightPath | None = None,
) -> tuple[ProfileSeries, Notes]:
    """The same air, with the sigmas that it has for exposures long after, or before, its samples,
    and far from them.

    ``time_ns``: (s,) of the exposures [Unix ns]. ``samples``: what the air was estimated from.
    ``h_c``, ``h_g``: heights of the highest camera and of the ground [m above sea level].
    ``path``: where the flight was; without it only time counts. Exposures are taken together in
    quarters of an hour and squares of 20 km; air sampled within half an hour and 18 km stays as it
    is.
    """
    if time_ns.size == 0:
        return series, ()
    groups = group_exposures(series, time_ns, path)
    ages = sample_ages(samples, groups.middle_ns, h_g, h_c, path)
    if all(age.is_fresh for age in ages):
        return series, ()
    airs: list[TimedProfile] = []
    place_of_fresh: dict[int, int] = {}
    new = np.zeros(len(ages), np.int64)
    for i, age in enumerate(ages):
        number = int(groups.profile_number[i])
        air = series.timed_profiles[number]
        if not age.is_fresh:
            air = replace(air, time_ns=groups.middle_ns[i], ages=age)
        elif number in place_of_fresh:
            new[i] = place_of_fresh[number]
            continue
        else:
            place_of_fresh[number] = len(airs)
        new[i] = len(airs)
        airs.append(air)
    is_old = np.array([not age.is_fresh for age in ages])
    aged = aged_note(ages, count=int(np.count_nonzero(is_old[groups.group])))
    return ProfileSeries(tuple(airs), new[groups.group]), (aged,)


class ExposureGroups(NamedTuple):
    """Exposures that share the age of their air.

    ``group`` (s,) of each exposure; of each of the (g,) groups the number of its profile and the
    mean of its times [Unix ns].
    """

    group: Integers
    profile_number: Integers
    middle_ns: list[int]


def group_exposures(
    series: ProfileSeries, time_ns: Integers, path: FlightPath | None
) -> ExposureGroups:
    """Exposures of one profile, quarter of an hour and square of 20 km together."""
    start_ns = int(time_ns.min())
    keys = np.stack([series.profile_number, (time_ns - start_ns) // SLOT_NS])
    if path is not None:
        cells = np.floor(path.metres_at(time_ns) / CELL_M).astype(np.int64)
        keys = np.vstack([keys, cells])
    keys_of_groups, group = np.unique(keys, axis=1, return_inverse=True)
    group = group.ravel()
    since_s = np.bincount(group, (time_ns - start_ns) * 1e-9) / np.bincount(group)
    middle_ns = [start_ns + round(float(seconds) * 1e9) for seconds in since_s]
    return ExposureGroups(group, keys_of_groups[0], middle_ns)


def aged_note(ages: Sequence[SampleAges], *, count: int) -> Message:
    """That the air of so many exposures is old or from far away, and how much at the most."""
    oldest = max(ages, key=lambda age: float(age.hours.max()))
    farthest_m = max(float(np.max(age.metres)) for age in ages)
    return messages.air_aged(
        hours=np.hypot(oldest.hours.max(), FRESH_S / 3600.0),
        km=np.hypot(farthest_m, FRESH_M) * 1e-3 if farthest_m > 0.0 else 0.0,
        height_m=oldest.h_m[int(np.argmax(oldest.hours))],
        count=count,
    )


def interpolate_profiles(a: TimedProfile, b: TimedProfile, share: float) -> TimedProfile:
    """The air between two times: (1 - share) of one and share of the other, under one gravity: T_M
    and e/p at the edges of both, ln p at one height; pressure follows by Eq. 52-53."""
    if a.time_ns is None or b.time_ns is None:
        raise ValueError("air between two times needs both")
    if share in (0.0, 1.0):
        return a if share == 0.0 else b
    edges = a.profile.layers.edge, b.profile.layers.edge
    low, high = max(edge[0] for edge in edges), min(edge[-1] for edge in edges)
    edge = np.union1d(*edges)
    edge = edge[(edge >= low) & (edge <= high)]
    edge = edge[np.concatenate([[True], np.diff(edge) > _SLIVER_M])]
    edge[[0, -1]] = low, high
    anchor = a.own_covariance.anchor_m if a.own_covariance is not None else 0.0
    here, heights = a.profile.gravity.height(anchor), a.profile.gravity.height(edge)
    parts = [air.profile.state(heights) for air in (a, b)]
    t_m, vapour = ((1.0 - share) * parts[0][i] + share * parts[1][i] for i in (0, 2))
    levels = [float(np.log(air.profile.pressure(here))) for air in (a, b)]
    log_p = (1.0 - share) * levels[0] + share * levels[1]
    source = (a if share < 0.5 else b).profile.layers.sources_between(edge)
    level, constant = (anchor, float(np.exp(log_p))), a.profile.constant
    layers = stack_layers(edge, t_m, vapour, source, anchor=level, constant=constant)
    profile = replace(a.profile, layers=layers)
    time_ns = a.time_ns + round(share * (b.time_ns - a.time_ns))
    return TimedProfile(time_ns, profile, neighbours=(a, b, share))


def _covariance_at(covariance: ProfileCovariance, edge: Array, anchor: float) -> Array:
    """A covariance for other edges and another anchor [m']."""
    layers, size = covariance.profile.layers, edge.size
    k = layers.edge.size
    weights = hats(layers.edge, edge)
    here = np.atleast_1d(covariance.profile.gravity.height(anchor))
    by_state = np.zeros((2 * size + 1, 2 * k + 1))
    by_state[:size, :k] = weights
    by_state[size, :k] = covariance.log_pressure_by_virtual(here)[0]
    by_state[size, k] = 1.0
    by_state[size + 1 :, k + 1 :] = weights
    return np.asarray(by_state @ covariance.matrix @ by_state.T)
