"""The air along a flight by a weather model: how the model's column changes from place to place.

A flight measures the air in its climb. Elsewhere, and at another time, the air is that profile plus
the model's column there minus the model's column where and when the climb was.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from unbend.atmosphere import messages
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.series.profile_series import (
    FINEST_CHANGE,
    PlaceInTime,
    ProfileSeries,
    SampleAges,
    TimedProfile,
)
from unbend.atmosphere.soundings.model_field import ModelColumns, ModelField
from unbend.messages import Notes
from unbend.units import VAPOUR_DEFICIT, Array, Integers

LONG_KM, LONG_H = 30.0, 2.0  # in a shorter flight the air of one place and time is that of all

LEFT_BY_MODEL = 0.5
"""Share of a distance that counts where a model's differences are added: half of the variance that
the air changes by is left. Set by judgement."""

_CELL_KM, _CELL_NS, _EARTH_KM = 2.0, 600 * 10**9, 6371.0
_AGE_STEP_KM = 20.0


def add_model_changes(
    series: ProfileSeries,
    field: ModelField,
    time_ns: Integers,
    latitude_rad: Array,
    longitude_rad: Array,
    *,
    h_c: list[float],
    h_g: float,
    measured: bool,
) -> tuple[ProfileSeries, Notes]:
    """The air of each exposure's own place, where a flight is longer than 30 km or two hours.

    Times and places (s,) of the exposures, NaN where not known, longitudes going on across the
    180th meridian. Profiles of ``series`` have ``sampled_at``, or neighbours that have it. ``h_c``,
    ``h_g``: heights of cameras and of the ground [m above sea level]. Exposures share a profile
    where R differs by less than 0.05 %. What a model's differences leave is that of half the
    distance from where it was ``measured``; a ray at 45 degrees ends as far away as the camera is
    high, so that counts as a distance too (docs/pages/air/weather_model.md).
    """
    known = np.flatnonzero(np.isfinite(latitude_rad + longitude_rad))
    if known.size == 0:
        return series, ()
    latitude, longitude, time_ns = latitude_rad[known], longitude_rad[known], time_ns[known]
    scale = _EARTH_KM * np.array([1.0, np.cos(latitude.mean())])
    km = scale[:, None] * np.stack([latitude, longitude])
    origins = {place: _column(field.columns(*(np.array([x]) for x in place)), 0)
               for air in series.timed_profiles for place, _ in _origins(air)}  # fmt: skip
    ends = np.hstack([km, np.array([scale * place[:2] for place in origins]).T])
    length_km = float(np.hypot(*np.ptp(ends, axis=1)))
    times = [*time_ns.tolist(), *(place[2] for place in origins)]
    hours = (max(times) - min(times)) / 3.6e12
    if length_km < LONG_KM and hours < LONG_H:
        return series, ()
    slot = (time_ns - time_ns.min()) // _CELL_NS
    cell = np.vstack([series.profile_number[known], slot, np.floor(km / _CELL_KM)])
    cells, row, number = np.unique(cell, axis=1, return_index=True, return_inverse=True)
    here = field.columns(latitude[row], longitude[row], time_ns[row])
    reach_km = (max(h_c) - h_g) * 1e-3
    airs: list[TimedProfile] = list(series.timed_profiles)
    place_of: dict[tuple[int, ...], int] = {}
    new, largest = np.zeros(row.size, np.int64), 0.0
    for i in range(row.size):
        air = series.timed_profiles[int(cells[0, i])]
        away_km = reach_km
        for place, weight in _origins(air):
            away_km += measured * weight * float(np.hypot(*(km[:, row[i]] - scale * place[:2])))
        changed = changed_air(air, _column(here, i), origins, h_g)
        change = [changed.change_from(air, [h], h_g) for h in h_c if h > h_g + 1.0]
        largest = max(largest, *map(abs, change), 0.0)
        key = (int(cells[0, i]), round(away_km / _AGE_STEP_KM),
               *(round(value / FINEST_CHANGE) for value in change))  # fmt: skip
        if key not in place_of:
            place_of[key] = len(airs)
            old = air.ages or SampleAges(np.array([h_g]), np.zeros(1))
            left_m = 1e3 * LEFT_BY_MODEL * away_km
            metres = np.broadcast_to(old.metres + left_m, old.h_m.shape)
            ages = SampleAges(old.h_m, old.hours, metres)
            airs.append(replace(changed, time_ns=int(time_ns[row[i]]), ages=ages))
        new[i] = place_of[key]
    numbers = series.profile_number.copy()
    numbers[known] = new[number.ravel()]
    used, numbers = np.unique(numbers, return_inverse=True)
    entry = messages.air_by_place(
        count=len(place_of), length_km=length_km, hours=hours, percent=100.0 * largest
    )
    return ProfileSeries(tuple(airs[u] for u in used), numbers.astype(np.int64)), (entry,)


def _origins(air: TimedProfile) -> list[tuple[PlaceInTime, float]]:
    """Where and when the air was sampled, with weights that add up to 1."""
    if air.sampled_at is not None:
        return [(air.sampled_at, 1.0)]
    if air.neighbours is None:
        raise ValueError("air that changes from place to place needs the place that it is of")
    a, b, share = air.neighbours
    return [(place, weight * part) for node, part in ((a, 1.0 - share), (b, share))
            for place, weight in _origins(node)]  # fmt: skip


def _column(columns: ModelColumns, i: int) -> tuple[Array, Array]:
    """(l,) heights [m'] of one column from the ground up; (3, l) T_M, e/p and ln p there."""
    virtual = columns.temperature_k[i] / (1.0 - VAPOUR_DEFICIT * columns.vapour[i])
    values = np.stack([virtual, columns.vapour[i], columns.log_pressure[i]])
    known = np.flatnonzero(np.isfinite(columns.height[i] + values.sum(axis=0)))[::-1]
    return columns.height[i, known], values[:, known]


def changed_air(
    air: TimedProfile,
    here: tuple[Array, Array],
    origins: Mapping[PlaceInTime, tuple[Array, Array]],
    h_g: float,
) -> TimedProfile:
    """The air with the model's change to a column from where the air was sampled, below the lowest
    and above the highest level of both columns that there."""
    profile = air.profile
    layers, gravity = profile.layers, profile.gravity
    edge = layers.edge
    anchor = float(np.clip(gravity.geopotential_height(h_g), edge[0], edge[-1]))
    change = np.zeros((3, edge.size + 1))
    for place, weight in _origins(air):
        there = origins[place]
        low, high = max(here[0][0], there[0][0]), min(here[0][-1], there[0][-1])
        at = np.clip(np.append(edge, anchor), low, high)
        for j in range(3):
            difference = np.interp(at, here[0], here[1][j]) - np.interp(at, there[0], there[1][j])
            change[j] += weight * difference
    vapour = np.append(layers.vapour, layers.vapour[-1] + layers.vapour_slope[-1] * (
        edge[-1] - edge[-2]))  # fmt: skip
    pressure = float(profile.pressure(gravity.height(anchor)) * np.exp(change[2, -1]))
    layers = stack_layers(
        edge, layers.edge_temperature + change[0, :-1], np.maximum(vapour + change[1, :-1], 0.0),
        layers.source, anchor=(anchor, pressure), constant=profile.constant,
    )  # fmt: skip
    profile, own = replace(profile, layers=layers), air.own_covariance
    own = None if own is None else replace(own, profile=profile)
    return replace(air, profile=profile, own_covariance=own)
