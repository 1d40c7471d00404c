"""Tables of the air by latitude and season, with humidity, as profiles.

The nine profiles of the U.S. Standard Atmosphere Supplements, 1966, reconstructed from public
tables descended from it (to 0.05 K below 25 km, above that extrapolated), and the six of Anderson
et al. 1986, AFGL Atmospheric Constituent Profiles (0-120 km), AFGL-TR-86-0110, to 80 km.
"""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.layers import STANDARD, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel, saturation_vapour_pressure
from unbend.geodesy import Gravity, lambert_gravity
from unbend.units import DEGREE, VAPOUR_DEFICIT, Array

SUPPLEMENTS = "supplements1966"
SUPPLEMENTS_ORIGIN = (
    "U.S. Standard Atmosphere Supplements 1966, reconstructed from public tables descended from it"
)
AFGL_ORIGIN = "AFGL 1986 model atmospheres (AFGL-TR-86-0110)"
_AFGL_FILE = "afgl1986.csv"

LOWEST_GEOPOTENTIAL_M = -5000.0  # as far down as the atmospheres of this package go

# Humidity bends between breakpoints; a layer's e/p is linear, so layers are at most this thick
# where there is water: halving it moves R from 10 km by 7e-6 at most.
_STEP_M = 500.0
_DRY_ABOVE_M = 16_000.0

_SAME_HEIGHT_M = 1e-3  # heights nearer than this are one [m']
_SCALE_HEIGHT_M = 7500.0  # of the pressure that the iteration begins with


@dataclass(frozen=True, eq=False)
class _SupplementsColumn:
    """One profile of the Supplements; (k,) by geopotential height [m'], pressure at H = 0 [Pa]."""

    latitude_deg: float
    season: str
    edge: Array
    temperature: Array
    relative_humidity: Array
    sea_level_pa: float


class _WeightedColumn(NamedTuple):
    """A column and its share in a mean of several."""

    weight: float
    column: _SupplementsColumn


def climate_names() -> tuple[str, ...]:
    """Names of the tables that `climate_profile` makes profiles of.

    >>> climate_names()[1], climate_names()[-1]
    ('supplements1966_30n_january', 'afgl1986_us_standard')
    """
    return (*_supplements(), *read_models(_AFGL_FILE))


def climate_profile(
    name: str,
    index: IndexModel | None = None,
    gravity: Gravity | None = None,
) -> Profile:
    """One of the tables as a profile, under Lambert's gravity of its own latitude by default.

    ``name`` : one of `climate_names`. Pressure is hydrostatic from the table's surface pressure and
    humidity: within 0.12 % of AFGL's printed pressures up to 10 km and 0.5 % up to 30 km.

    >>> climate_profile("afgl1986_tropical").temperature([0.0, 5000.0]).round(2).tolist()
    [299.7, 270.3]
    """
    if name in _supplements():
        column = _supplements()[name]
        gravity = gravity or lambert_gravity(column.latitude_deg * DEGREE)
        return _mean_of_columns([_WeightedColumn(1.0, column)], gravity, index, name)
    rows = read_models(_AFGL_FILE)[name]
    gravity = gravity or lambert_gravity(rows[0]["latitude_deg"] * DEGREE)
    heights = gravity.geopotential_height([row["h_m"] for row in rows])
    temperatures = [row["temperature_k"] for row in rows]
    log_fractions = np.log([row["water_ppmv"] * 1e-6 for row in rows])
    edge = _edges(heights)
    vapour = np.exp(np.interp(edge, heights, log_fractions))
    return hydrostatic_profile(
        edge,
        np.interp(edge, heights, temperatures),
        lambda _: vapour,
        rows[0]["pressure_pa"],
        gravity,
        index=index,
        name=name,
    )


def supplements_profile(
    latitude_rad: float,
    month: float,
    index: IndexModel | None = None,
    gravity: Gravity | None = None,
) -> Profile:
    """The Supplements 1966 at a latitude and season.

    Temperature, relative humidity and surface pressure are linear in latitude between 15, 30, 45,
    60 and 75 degrees and constant beyond; over the year they follow `season`. ``latitude_rad``:
    north positive. ``month``: any real number, modulo 12.

    >>> supplements_profile(0.25 * 3.141592653589793, 7.0).temperature(0.0).round(2).item()
    294.15
    """
    degrees = abs(latitude_rad) / DEGREE
    summer = 0.5 - 0.5 * season(latitude_rad, month)
    share_of_season = {
        "annual": 1.0,
        "january": 1.0 - summer,
        "july": summer,
    }
    nodes = np.array([15.0, 30.0, 45.0, 60.0, 75.0])
    parts = []
    for latitude, is_node in zip(nodes, np.eye(nodes.size), strict=True):
        weight = float(np.interp(degrees, nodes, is_node))
        for column in _supplements().values():
            if column.latitude_deg == latitude and weight > 0.0:
                share = share_of_season[column.season]
                parts.append(_WeightedColumn(weight * share, column))
    gravity = gravity or lambert_gravity(latitude_rad)
    return _mean_of_columns(parts, gravity, index, SUPPLEMENTS)


def season(latitude_rad: float, month: float) -> float:
    """1 in mid-winter, -1 in mid-summer of a hemisphere; ``month`` 1.0 is mid-January.

    >>> season(0.8, 1.0), season(-0.8, 1.0)
    (1.0, -1.0)
    """
    shift = 0.0 if latitude_rad >= 0.0 else 6.0
    return math.cos(2.0 * math.pi * (month - 1.0 + shift) / 12.0)


def rows_of(file: str) -> list[dict[str, str]]:
    """The rows of a CSV table in the folder ``data``, each by column name."""
    text = resources.files("unbend.atmosphere").joinpath(f"data/{file}")
    return list(csv.DictReader(text.read_text(encoding="ascii").splitlines()))


@lru_cache(maxsize=1)
def _supplements() -> dict[str, _SupplementsColumn]:
    """The columns of the Supplements by name."""
    levels_by_name: dict[str, list[dict[str, str]]] = {}
    for row in rows_of("supplements1966.csv"):
        levels_by_name.setdefault(row["name"], []).append(row)
    columns = {}
    for name, levels in levels_by_name.items():
        t = _numbers(levels, "temperature_k")
        e = _numbers(levels, "vapour_pressure_pa")
        columns[name] = _SupplementsColumn(
            latitude_deg=float(levels[0]["latitude_deg"]),
            season=levels[0]["season"],
            edge=_numbers(levels, "geopotential_m"),
            temperature=t,
            relative_humidity=e / saturation_vapour_pressure(t),
            sea_level_pa=float(levels[0]["pressure_pa"]),
        )
    return columns


def _numbers(rows: Sequence[Mapping[str, str]], name: str) -> Array:
    """A column of a table as numbers."""
    return np.array([float(row[name]) for row in rows])


@lru_cache
def read_models(file: str) -> dict[str, list[dict[str, float]]]:
    """The rows of each model in a CSV table in the folder ``data``, by the model's name.

    The table has a column ``name``; all other columns are numbers.
    """
    models: dict[str, list[dict[str, float]]] = {}
    for row in rows_of(file):
        name = row.pop("name")
        level = {key: float(value) for key, value in row.items()}
        models.setdefault(name, []).append(level)
    return models


def _edges(*breaks: Array) -> Array:
    """Edges of layers [m'], from 0 to the lowest of the tops of some tables.

    All breakpoints of the tables (``breaks``, increasing), and steps of 500 m' up to 16 km, where
    there is water; heights less than a millimetre apart are one.
    """
    top = min(float(heights[-1]) for heights in breaks)
    steps = np.arange(0.0, _DRY_ABOVE_M + 1.0, _STEP_M)
    edges = np.unique(np.concatenate([steps, *breaks]))
    edges = edges[(edges >= 0.0) & (edges <= top)]
    is_apart = np.diff(edges) > _SAME_HEIGHT_M
    return np.asarray(edges[np.concatenate([[True], is_apart])])


def _mean_of_columns(
    parts: Sequence[_WeightedColumn],
    gravity: Gravity,
    index: IndexModel | None,
    name: str,
) -> Profile:
    """The profile of a weighted mean of columns.

    Temperature, relative humidity and surface pressure are averaged. Weights add up to 1.
    """
    edge = _edges(*(column.edge for _, column in parts))
    t = np.zeros(edge.size)
    humidity = np.zeros(edge.size)
    surface_pa = 0.0
    for weight, column in parts:
        t = t + weight * np.interp(edge, column.edge, column.temperature)
        humidity = humidity + weight * np.interp(edge, column.edge, column.relative_humidity)
        surface_pa += weight * column.sea_level_pa
    e = humidity * saturation_vapour_pressure(t)
    return hydrostatic_profile(
        edge,
        t,
        lambda p: e / p,
        surface_pa,
        gravity,
        index=index,
        name=name,
    )


def hydrostatic_profile(
    edge: Array,
    temperature: Array,
    vapour_of: Callable[[Array], Array],
    surface_pa: float,
    gravity: Gravity,
    *,
    index: IndexModel | None,
    name: str,
) -> Profile:
    """A profile through temperatures at edges (k,) [m'], with pressure and e/p that fit each other.

    ``vapour_of``: e/p (k,) at the edges from the pressures (k,) there [Pa]. ``surface_pa``:
    pressure at H = 0. Below the lowest edge the lowest layer is continued, as isothermal where it
    is an inversion.
    """
    lapse = min((temperature[1] - temperature[0]) / (edge[1] - edge[0]), 0.0)
    lowest_k = temperature[0] + lapse * (LOWEST_GEOPOTENTIAL_M - edge[0])
    edges = np.append(LOWEST_GEOPOTENTIAL_M, edge)
    t = np.append(lowest_k, temperature)
    source = (STANDARD,) * (edges.size - 1)
    pressure = surface_pa * np.exp(-edge / _SCALE_HEIGHT_M)
    # Pressure depends on humidity by less than 1 %, so each round gains more than two digits.
    for _ in range(6):
        vapour = vapour_of(pressure)
        vapour = np.append(vapour[:1], vapour)
        virtual = t / (1.0 - VAPOUR_DEFICIT * vapour)
        layers = stack_layers(
            edges,
            virtual,
            vapour,
            source,
            anchor=(0.0, surface_pa),
        )
        profile = Profile(layers, gravity, index or IndexModel(), name)
        pressure = profile.pressure(gravity.height(edge))
    return profile
