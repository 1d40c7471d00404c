"""The air along a flight: profiles at several times, and the one of each exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.covariance import ProfileCovariance, plane_rule
from unbend.atmosphere.hypsometry import interpolation_weights
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.ageing import (
    FlightPath,
    SampleAges,
    aged_note,
    covariance_with_ageing,
    sample_ages,
)
from unbend.messages import Notes
from unbend.units import Array, Integers

FINEST_CHANGE = 5e-4
"""Profiles follow each other so closely that ln R changes by less than this between neighbours."""

SLOT_NS = 900 * 10**9  # exposures within a quarter of an hour share the age of their air [ns]
CELL_M = 20e3  # exposures of a square of this side share the distance of their air [m]

_STEPS = 100  # trapezia of the plane integral
_SLIVER_M = 1.0  # edges of two profiles nearer than this become one [m']


class PlaceInTime(NamedTuple):
    """Where and when air was sampled: geographic place [rad] and time [Unix ns]."""

    latitude_rad: float
    longitude_rad: float
    time_ns: int


@dataclass(frozen=True, eq=False)
class TimedProfile:
    """The air at a time [Unix ns], with its covariance where there is one.

    ``own_covariance``: of an estimate. ``neighbours``: of air that is interpolated, the earlier and
    the later profile and the share of the later; its covariance is computed when needed, because
    hundreds of them would fill memory. ``ages``: of the samples, None where these are fresh.
    ``sampled_at``: where they were taken.
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
        if self.neighbours is None:
            return self.own_covariance is not None
        earlier, later, _ = self.neighbours
        return earlier.own_covariance is not None and later.own_covariance is not None

    @property
    def covariance(self) -> ProfileCovariance | None:
        """Covariance of the estimate, and of the change of the air between sample and exposure.

        Of air between two profiles (1 - share) C_a + share C_b, an upper bound. None if unknown.
        """
        covariance = self.own_covariance
        if self.neighbours is not None:
            covariance = self._covariance_of_neighbours(*self.neighbours)
        if covariance is None or self.ages is None:
            return covariance
        return covariance_with_ageing(covariance, self.ages)

    def _covariance_of_neighbours(
        self,
        earlier: TimedProfile,
        later: TimedProfile,
        share: float,
    ) -> ProfileCovariance | None:
        """The mean of two profiles' covariances by the share of the later; None if one has none."""
        if earlier.own_covariance is None or later.own_covariance is None:
            return None
        edge = self.profile.layers.edge
        anchor = earlier.own_covariance.anchor_m
        matrix = (1.0 - share) * _covariance_at(earlier.own_covariance, edge, anchor)
        matrix += share * _covariance_at(later.own_covariance, edge, anchor)
        return ProfileCovariance(self.profile, anchor, matrix)

    def change_from(self, other: TimedProfile, h_c: Sequence[float], h_g: float) -> float:
        """ln of the refraction R in this air over that in another air, by the plane formula.

        Of cameras at ``h_c`` over the ground at ``h_g`` [m above sea level] the one that is largest
        in absolute value.
        """
        changes = []
        for camera_m in h_c:
            h, weight = plane_rule(camera_m, h_g, _STEPS)
            refraction = float(weight @ self.profile.refractivity(h))
            other_refraction = float(weight @ other.profile.refractivity(h))
            changes.append(np.log(refraction / other_refraction))
        return float(max(changes, key=abs))


@dataclass(frozen=True, eq=False)
class ProfileSeries:
    """Profiles, and the number of the profile of each exposure (s,).

    Functions of height are those of a `Profile`, for (s,) heights, one of each exposure.
    """

    timed_profiles: tuple[TimedProfile, ...]
    profile_number: Integers

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """The profiles without their times."""
        return tuple(air.profile for air in self.timed_profiles)

    @property
    def index(self) -> IndexModel:
        """The formula of the refractive index, which all profiles share."""
        return self.timed_profiles[0].profile.index

    def pressure(self, h: Array) -> Array:
        """(s,) pressure [Pa] at the heights of the exposures [m above sea level]."""
        return self._each(h, Profile.pressure)

    def temperature(self, h: Array) -> Array:
        """(s,) temperature [K] at the heights of the exposures [m above sea level]."""
        return self._each(h, Profile.temperature)

    def vapour_pressure(self, h: Array) -> Array:
        """(s,) vapour pressure [Pa] at the heights of the exposures [m above sea level]."""
        return self._each(h, Profile.vapour_pressure)

    def refractivity(self, h: Array) -> Array:
        """(s,) n - 1 at the heights of the exposures [m above sea level]."""
        return self._each(h, Profile.refractivity)

    def _each(self, h: Array, function: Callable[[Profile, ArrayLike], Array]) -> Array:
        """(s,) values of a function of height, each by the profile of the exposure."""
        if len(self.timed_profiles) == 1:
            return function(self.timed_profiles[0].profile, h)
        values = np.full(h.shape, np.nan)
        for number, air in enumerate(self.timed_profiles):
            rows = self.profile_number == number
            values[rows] = function(air.profile, h[rows])
        return values


def constant_series(air: TimedProfile, exposures: int) -> ProfileSeries:
    """The same air for all exposures."""
    return ProfileSeries((air,), np.zeros(exposures, np.int64))


def interpolate_series(
    nodes: Sequence[TimedProfile],
    time_ns: Integers,
    h_c: Sequence[float],
    h_g: float,
) -> ProfileSeries:
    """The air at the times of exposures, linear in time between ``nodes`` and constant beyond.

    ``nodes``: two or more, in the order of time. ``time_ns``: (s,) of the exposures [Unix ns].
    ``h_c``, ``h_g``: heights of cameras and ground [m above sea level]. Between nodes there are as
    many profiles as are needed so that R of the cameras changes by less than 0.05 % from one to the
    next. An exposure gets the nearest in time; profiles without an exposure are left out.
    """
    node_times = []
    for node in nodes:
        if node.time_ns is None:
            raise ValueError("air along a flight needs times")
        node_times.append(node.time_ns)
    steps = _steps_between(nodes, h_c, h_g)
    times_ns = np.array([step.time_ns(node_times) for step in steps])
    middles = times_ns[:-1] + np.diff(times_ns) // 2
    nearest = np.searchsorted(middles, time_ns, side="left")
    used, number = np.unique(nearest, return_inverse=True)
    airs = []
    for row in used:
        node, share = steps[row]
        airs.append(interpolate_profiles(nodes[node], nodes[node + 1], share))
    return ProfileSeries(tuple(airs), number.astype(np.int64))


def _steps_between(
    nodes: Sequence[TimedProfile],
    h_c: Sequence[float],
    h_g: float,
) -> list[_Step]:
    """Steps from the first node to the last, such that R changes by less than 0.05 % in each."""
    steps: list[_Step] = []
    for number, (earlier, later) in enumerate(pairwise(nodes)):
        change = abs(later.change_from(earlier, h_c, h_g))
        count = max(1, int(np.ceil(change / FINEST_CHANGE)))
        for k in range(count):
            steps.append(_Step(number, k / count))
    steps.append(_Step(len(nodes) - 2, 1.0))
    return steps


class _Step(NamedTuple):
    """A profile between node number ``node`` and the next, with the share of the next, 0 to 1."""

    node: int
    share: float

    def time_ns(self, node_times: Sequence[int]) -> int:
        """Time of the profile, from the times of all nodes [Unix ns]."""
        earlier_ns = node_times[self.node]
        later_ns = node_times[self.node + 1]
        return earlier_ns + round(self.share * (later_ns - earlier_ns))


def add_ageing(
    series: ProfileSeries,
    time_ns: Integers,
    samples: AirSamples,
    h_c: float,
    h_g: float,
    path: FlightPath | None = None,
) -> tuple[ProfileSeries, Notes]:
    """The series with larger sigmas for exposures that are far in time or place from the samples.

    ``time_ns``: (s,) of the exposures [Unix ns]. ``samples``: what the air was estimated from.
    ``h_c``, ``h_g``: heights of the highest camera and of the ground [m above sea level].
    ``path``: where the flight was; without it only time counts. Exposures are taken together in
    quarters of an hour and squares of 20 km; air sampled within half an hour and 18 km is not
    changed.
    """
    if time_ns.size == 0:
        return series, ()
    groups = group_exposures(series, time_ns, path)
    ages = sample_ages(samples, groups.mean_ns, h_g, h_c, path)
    if all(age.is_fresh for age in ages):
        return series, ()
    airs: list[TimedProfile] = []
    new_number_of_fresh: dict[int, int] = {}  # by the number in the series
    new_number_of_group = np.zeros(len(ages), np.int64)
    for i, age in enumerate(ages):
        number = int(groups.profile_number[i])
        air = series.timed_profiles[number]
        if not age.is_fresh:
            air = replace(air, time_ns=groups.mean_ns[i], ages=age)
        elif number in new_number_of_fresh:
            new_number_of_group[i] = new_number_of_fresh[number]
            continue
        else:
            new_number_of_fresh[number] = len(airs)
        new_number_of_group[i] = len(airs)
        airs.append(air)
    is_old = np.array([not age.is_fresh for age in ages])
    old_exposures = int(np.count_nonzero(is_old[groups.group]))
    aged = aged_note(ages, count=old_exposures)
    return ProfileSeries(tuple(airs), new_number_of_group[groups.group]), (aged,)


class ExposureGroups(NamedTuple):
    """Exposures that share the age of their air.

    ``group`` (s,): number of the group of each exposure. Of each group (g,): ``profile_number``,
    and ``mean_ns``, the mean of its times [Unix ns].
    """

    group: Integers
    profile_number: Integers
    mean_ns: list[int]


def group_exposures(
    series: ProfileSeries,
    time_ns: Integers,
    path: FlightPath | None,
) -> ExposureGroups:
    """Groups of exposures that share profile, quarter of an hour and square of 20 km.

    ``time_ns`` (s,): of the exposures [Unix ns]. Without a ``path`` place does not count.
    """
    start_ns = int(time_ns.min())
    slots = (time_ns - start_ns) // SLOT_NS
    keys = np.stack([series.profile_number, slots])
    if path is not None:
        cells = np.floor(path.metres_at(time_ns) / CELL_M).astype(np.int64)
        keys = np.vstack([keys, cells])
    keys_of_groups, group = np.unique(keys, axis=1, return_inverse=True)
    group = group.ravel()
    seconds = (time_ns - start_ns) * 1e-9
    mean_s = np.bincount(group, seconds) / np.bincount(group)
    mean_ns = [start_ns + round(float(mean) * 1e9) for mean in mean_s]
    return ExposureGroups(group, keys_of_groups[0], mean_ns)


def interpolate_profiles(
    a: TimedProfile,
    b: TimedProfile,
    share: float,
) -> TimedProfile:
    """The air between two times: (1 - share) of ``a`` and share of ``b``, which have one gravity.

    T_M and e/p are interpolated at the edges of both, ln p at one height; pressure elsewhere
    follows by Eq. 52-53.
    """
    if a.time_ns is None or b.time_ns is None:
        raise ValueError("air between two times needs both")
    if share == 0.0:
        return a
    if share == 1.0:
        return b
    edge = _common_edges(a.profile.layers.edge, b.profile.layers.edge)
    heights = a.profile.gravity.height(edge)
    t_m_a, _, vapour_a = a.profile.state(heights)
    t_m_b, _, vapour_b = b.profile.state(heights)

    anchor = 0.0 if a.own_covariance is None else a.own_covariance.anchor_m
    anchor_h = a.profile.gravity.height(anchor)
    log_p_a = float(np.log(a.profile.pressure(anchor_h)))
    log_p_b = float(np.log(b.profile.pressure(anchor_h)))
    log_p = (1.0 - share) * log_p_a + share * log_p_b

    nearer = a if share < 0.5 else b
    layers = stack_layers(
        edge,
        (1.0 - share) * t_m_a + share * t_m_b,
        (1.0 - share) * vapour_a + share * vapour_b,
        nearer.profile.layers.sources_between(edge),
        anchor=(anchor, float(np.exp(log_p))),
        constant=a.profile.constant,
    )
    return TimedProfile(
        time_ns=a.time_ns + round(share * (b.time_ns - a.time_ns)),
        profile=replace(a.profile, layers=layers),
        neighbours=(a, b, share),
    )


def _common_edges(a: Array, b: Array) -> Array:
    """The edges (k,) of two profiles [m'] where both have air, all more than 1 m' apart."""
    lowest = max(a[0], b[0])
    highest = min(a[-1], b[-1])
    edge = np.union1d(a, b)
    edge = edge[(edge >= lowest) & (edge <= highest)]
    is_apart = np.diff(edge) > _SLIVER_M
    edge = edge[np.concatenate([[True], is_apart])]
    edge[0] = lowest
    edge[-1] = highest
    return np.asarray(edge)


def _covariance_at(covariance: ProfileCovariance, edge: Array, anchor: float) -> Array:
    """The covariance matrix of a profile for other edges (n,) and another anchor [m'].

    (2n + 1, 2n + 1), in the order of `ProfileCovariance.matrix`.
    """
    layers = covariance.profile.layers
    k = layers.edge.size
    size = edge.size
    weights = interpolation_weights(layers.edge, edge)
    anchor_h = np.atleast_1d(covariance.profile.gravity.height(anchor))
    by_state = np.zeros((2 * size + 1, 2 * k + 1))
    by_state[:size, :k] = weights
    by_state[size, :k] = covariance.log_pressure_by_virtual(anchor_h)[0]
    by_state[size, k] = 1.0
    by_state[size + 1 :, k + 1 :] = weights
    return np.asarray(by_state @ covariance.matrix @ by_state.T)
