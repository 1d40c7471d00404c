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
from unbend.messages import Notes
from unbend.units import Array, Integers

FINEST_CHANGE = 5e-4
"""Profiles follow each other so closely that R changes by less than this from one to the next."""

SLOT_NS = 900 * 10**9  # exposures within a quarter of an hour share the age of their air [ns]

_STEPS = 100  # trapezia of the plane integral
_SLIVER_M = 1.0  # edges of two profiles nearer than this become one [m']

CHANGE_LOG_P_PER_H, CHANGE_LOG_P_PER_M = 5e-4, 1.5e-8
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
        seconds = (time_ns - self.time_ns[0]) * 1e-9
        at = (self.time_ns - self.time_ns[0]) * 1e-9
        north = np.interp(seconds, at, self.latitude_rad - self.latitude_rad[0])
        east = np.interp(seconds, at, self.longitude_rad - self.longitude_rad[0])
        return _EARTH_M * np.stack([north, east * np.cos(self.latitude_rad[0])])


class PlaceInTime(NamedTuple):
    """Where and when air was met: geographic place [rad] and time [Unix ns]."""

    latitude_rad: float
    longitude_rad: float
    time_ns: int


@dataclass(frozen=True, eq=False)
class SampleAges:
    """Hours (n,) that the air of heights (n,) [m] has changed for since, or until, it was sampled:
    sqrt(t^2 - (1/2 h)^2), nothing within half an hour, and nearly t in the end; and likewise the
    ``metres`` (n,) to where it was, nothing within 18 km."""

    h_m: Array
    hours: Array
    metres: Array | float = 0.0

    @property
    def is_fresh(self) -> bool:
        """Whether all of it was sampled within half an hour and 18 km."""
        return not bool(np.any(self.hours > 0.0) or np.any(np.asarray(self.metres) > 0.0))


def sample_ages(
    samples: AirSamples,
    time_ns: Sequence[int],
    h_g: float,
    h_c: float,
    path: FlightPath | None = None,
) -> list[SampleAges]:
    """How old the air between two heights [m above sea level] is at times [Unix ns], by the nearest
    readings of thermometer or barometer before or after, in bins of 100 m; and how far away it was
    sampled from where the flight was then, by its ``path``."""
    visits = [
        (np.floor(s.h_m[s.accepted] / _BIN_M), s.time_ns[s.accepted] // _MINUTE_NS)
        for s in (samples.temperature, samples.pressure)
        if s is not None
    ]
    if not any(bins.size for bins, _ in visits):
        return [SampleAges(np.zeros(1), np.zeros(1)) for _ in time_ns]
    both = np.hstack([np.stack([bins.astype(np.int64), at]) for bins, at in visits])
    both = np.unique(both, axis=1)
    inside = (both[0] + 1 >= h_g / _BIN_M) & (both[0] <= h_c / _BIN_M)
    number, minute = both[:, inside] if bool(inside.any()) else both
    bins = np.unique(number)
    ages = []
    for now in time_ns:
        hours = np.abs(minute - now // _MINUTE_NS) / 60.0
        metres = np.zeros(hours.size)
        if path is not None:
            here = path.metres_at(np.array([now]))
            metres = np.hypot(*(path.metres_at(minute * _MINUTE_NS) - here))
        apart = hours + metres / METRES_AS_AN_HOUR
        nearest = [
            rows[np.argmin(apart[rows])] for rows in (np.flatnonzero(number == i) for i in bins)
        ]
        ages.append(
            SampleAges(
                (bins + 0.5) * _BIN_M,
                np.sqrt(np.maximum(hours[nearest] ** 2 - (FRESH_S / 3600.0) ** 2, 0.0)),
                np.sqrt(np.maximum(metres[nearest] ** 2 - FRESH_M**2, 0.0)),
            )
        )
    return ages


def change_parts(
    latitude_rad: float | None, ground_h_m: float, hours: ArrayLike, metres: ArrayLike, h_m: Array
) -> Parts:
    """How temperatures over a ground [m] change in hours and metres (n,) for heights (n,) [m].

    To the structure function comes the mean cycle of the day, over hours whose place in the day is
    not known.
    """
    latitude = _MIDDLE_LATITUDE_RAD if latitude_rad is None else latitude_rad
    parts = variation_parts(latitude, SPRING, ground_h_m)
    at = parts[0].h_m
    age, away = (np.interp(at, h_m, np.broadcast_to(x, h_m.shape)) for x in (hours, metres))
    cycle = DailyCycle(latitude, SPRING, ground_h_m).by_hour_k(at)
    day = cycle * np.sqrt(1.0 - np.cos(2.0 * np.pi * age / 24.0))
    return (*(part.change(age, away) for part in parts), Part("day", at, day, CYCLE_LENGTH_M))


def covariance_with_ageing(covariance: ProfileCovariance, ages: SampleAges) -> ProfileCovariance:
    """A covariance with what the air changes in its age, and over its distance, added.

    Temperatures change by `change_parts` and carry pressure with them from the height that was
    sampled last, where ln p itself changes too; so does relative humidity.
    """
    profile = covariance.profile
    edge = profile.layers.edge
    k = edge.size
    h = profile.gravity.height(edge)
    hours = np.interp(h, ages.h_m, ages.hours)
    metres = np.broadcast_to(ages.metres, ages.h_m.shape)
    latitude, ground = profile.gravity.latitude_rad, float(ages.h_m[0])
    parts = change_parts(latitude, ground, ages.hours, metres, ages.h_m)
    matrix = np.zeros_like(covariance.matrix)
    by_state = np.eye(2 * k + 1)
    matrix[:k, :k] = covariance_of(parts, h, h)
    weather = CHANGE_LOG_P_PER_H * ages.hours.min(), CHANGE_LOG_P_PER_M * metres.min()
    matrix[k, k] = float(np.hypot(*weather)) ** 2
    saturated = saturation_vapour_pressure(profile.temperature(h)) / profile.pressure(h)
    as_hours = hours + np.interp(h, ages.h_m, metres) / METRES_AS_AN_HOUR
    moistening = CHANGE_RH * np.sqrt(np.minimum(as_hours / CHANGE_RH_IN_H, 1.0))
    moistening *= np.minimum(saturated, profile.layers.vapour.max())
    alike = exponential(edge, CHANGE_RH_LENGTH_M)
    matrix[k + 1 :, k + 1 :] = np.outer(moistening, moistening) * alike
    last = ages.h_m[np.flatnonzero(ages.hours == ages.hours.min())[-1:]]
    by_state[k, :k] = -covariance.log_pressure_by_virtual(last)[0]
    added = by_state @ matrix @ by_state.T
    return replace(covariance, matrix=covariance.matrix + added)


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
    start = int(time_ns.min())
    slot = (time_ns - start) // SLOT_NS
    keys = np.stack([series.profile_number, slot])
    if path is not None:
        cells = np.floor(path.metres_at(time_ns) / CELL_M).astype(np.int64)
        keys = np.vstack([keys, cells])
    pairs, group = np.unique(keys, axis=1, return_inverse=True)
    group = group.ravel()
    since = np.bincount(group, (time_ns - start) * 1e-9) / np.bincount(group)
    middles = [start + round(float(s) * 1e9) for s in since]
    ages = sample_ages(samples, middles, h_g, h_c, path)
    if all(age.is_fresh for age in ages):
        return series, ()
    airs: list[TimedProfile] = []
    place: dict[tuple[int, int], int] = {}
    new = np.zeros(len(ages), np.int64)
    for i, (number, age) in enumerate(zip(pairs[0], ages, strict=True)):
        key = (int(number), -1 if age.is_fresh else i)
        if key not in place:
            place[key] = len(airs)
            air = series.timed_profiles[key[0]]
            airs.append(air if age.is_fresh else replace(air, time_ns=middles[i], ages=age))
        new[i] = place[key]
    oldest = max(ages, key=lambda age: float(age.hours.max()))
    farthest = max(float(np.max(age.metres)) for age in ages)
    aged = messages.air_aged(
        hours=np.hypot(oldest.hours.max(), FRESH_S / 3600.0),
        km=np.hypot(farthest, FRESH_M) * 1e-3 if farthest > 0.0 else 0.0,
        height_m=oldest.h_m[int(np.argmax(oldest.hours))],
        count=int(np.isin(new[group], [i for i, air in enumerate(airs) if air.ages]).sum()),
    )
    return ProfileSeries(tuple(airs), new[group]), (aged,)


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
