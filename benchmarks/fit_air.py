"""Fits the structure function of the air to public ascents: `atmosphere/data/air_variation.toml`.

    python benchmarks/fit_air.py [--half 0|1] [FOLDER] > air_variation.toml

(into pipeline/unbend/atmosphere/data).

First what the Supplements 1966 lack in the lowest 3 km, on average and by the hour of the day; then
the parts of `unbend.atmosphere.air_variation`, so that their sum has the second moments of

* the departures from that climatology, each group of ascents weighing alike,
* the changes in 12 to 240 hours over one station, without their mean,
* the differences between stations of one hour, 340 to 2700 km apart.

``--half`` fits one half of the ascents, so that `judge_air.py --half` judges by the other.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from ascents import CLIMBS_M, FOLDER, Ascent, read_ascents
from scipy.optimize import least_squares

from unbend.atmosphere.air_variation import (
    WARMEST_HOUR,
    correlation,
    mixed_share,
    reduced_height,
    share_of_day,
    tropopause_m,
    weather_share,
)
from unbend.atmosphere.climate_tables import season, supplements_profile

LOW_M = np.array([0.0, 50.0, 100.0, 200.0, 300.0, 500.0, 750.0, 1000.0, 1500.0, 2000.0, 3000.0])
HIGH_M = np.array([4000.0, 5000.0, 6000.0, 7000.0, 8000.0, 9000.0, 10e3, 11e3, 12e3, 13e3, 14.5e3])
HEIGHT_M = np.concatenate([LOW_M, HIGH_M])  # reduced heights at which ascents are compared

NODE_M = np.array([0.0, 1000.0, 3000.0, 5000.0, 7500.0, 9500.0, 11_500.0, 13_500.0, 16_000.0])
CLIMATE_NODE_M = np.array([0.0, 1000.0, 3000.0, 6000.0, 9000.0, 11_500.0, 15_000.0])
GROUND_K = 1.5
GROUND_DEPTH_M = 40.0
"""Air in the sun, or over a cold field, is off by so much, less by 1/e in so much height:
similarity theory (Businger et al. 1971) gives 2 K between 2 and 50 m, at 200 W/m2 and a friction
velocity of 0.3 m/s."""
GROUND_NODE_M = np.array([0.0, 15.0, 30.0, 50.0, 80.0, 120.0, 200.0, 320.0])

LAGS_H = (12, 24, 36, 48, 72, 120, 240)
DISTANCES_KM = (0, 450, 600, 900, 1300, 2000, 3500)
MIDDLE_LATITUDES_DEG = 24.0  # from here on the moments are fitted; nearer are 16 ascents
CLIMATE_MEMORY_H = 1000.0  # what a place has beside its climatology stays for weeks
STRATOSPHERE_M = (18_000.0, 22_000.0)
STRATOSPHERE_K = (3.0, 5.0)
"""Above the ascents: judgement, it weighs little in R."""
GROUP_WEIGHT = 30.0  # pairs of one lag or distance share ascents: they count as so many at most
NEAR_WEIGHT = 6.0  # of the nearest stations, since flights and their sources are nearer still
FEWEST = 8  # ascents, or pairs, that have moments
DAY_HOURS = (8.0, 20.0)

FINE_NODE_M = np.array([0.0, 300.0, 1000.0, 2000.0, 4000.0])
FINE_LENGTH_M = {"kinked": 600.0, "smooth": 500.0}
FINE_SHARES = {
    "kinked": np.array([1.0, 0.742, 0.742, 0.742, 0.742]),
    "smooth": np.array([0.0, 0.67, 0.67, 0.67, 0.67]),
}
FINE_K = np.array([2.0, 2.0, 2.0, 2.0, 0.8])
"""Fine structure: its amplitude at `FINE_NODE_M` in stable air, and how it is shared between a part
with kinks, all of it at the ground and 0.55 of the variance from 300 m on, and one without, from
nine ascents with all their levels (docs/decisions.md)."""

FUNCTIONAL_WEIGHT = 2.0  # of logarithms of variances of R and T, beside a row of a matrix


@dataclass
class Moments:
    """Second moments (n, n) of departures, or of changes in hours and over a distance; ``r`` (c,)
    those of R at `CLIMBS_M` [%2]; ``mixed`` the mean of `air_variation.mixed_share`.

    The inversions of winter (`air_variation.inversions_of_season`) were found beside this fit, by
    what it leaves over Vienna: the fit itself knows no season.
    """

    matrix: np.ndarray
    r: np.ndarray
    weight: float
    mixed: float
    hours: float = 0.0
    km: float = 0.0
    is_change: bool = True


@dataclass
class Departures:
    """Ascents (m,) as departures (m, n) from the Supplements at `HEIGHT_M`, NaN where unknown."""

    ascents: list[Ascent]
    kelvin: np.ndarray = field(init=False)
    winter: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        rows = []
        for ascent in self.ascents:
            ground = float(ascent.h_m[0])
            latitude = ascent.latitude_rad
            fine = np.arange(ground, ground + 30_000.0, 10.0)
            reduced = reduced_height(fine, ground, tropopause_m(latitude, ascent.month))
            h = np.interp(HEIGHT_M, reduced, fine)
            t = np.interp(h, ascent.h_m, ascent.temperature_k, right=np.nan)
            rows.append(t - supplements_profile(latitude, ascent.month).temperature(h))
        self.kelvin = np.array(rows)
        self.winter = np.array([0.5 + 0.5 * season(a.latitude_rad, a.month) for a in self.ascents])

    @property
    def groups(self) -> np.ndarray:
        return np.array([ascent.group for ascent in self.ascents])


def daily_tables(departures: Departures, share: np.ndarray) -> np.ndarray:
    """(4, n) means at `LOW_M` about that at 3 km: winter, summer, by the hour in winter, summer.

    Groups weigh alike, those of the tropics a third.
    """
    groups = departures.groups
    weight = np.array([1.0 / np.count_nonzero(groups == group) for group in groups])
    weight = weight * np.where(share < 0.5, 0.3, 1.0)
    hours = np.array([ascent.solar_hour for ascent in departures.ascents])
    by_hour = np.cos(2.0 * math.pi * (hours - WARMEST_HOUR) / 24.0)
    winter = departures.winter
    columns = np.stack([winter, 1.0 - winter, by_hour * winter, by_hour * (1.0 - winter)], axis=1)
    columns *= share[:, None]
    low = departures.kelvin[:, : LOW_M.size]
    tables = []
    for values in (low - low[:, -1:]).T:
        known = np.isfinite(values)
        root = np.sqrt(weight[known])
        fit = np.linalg.lstsq(columns[known] * root[:, None], values[known] * root, rcond=None)
        tables.append(fit[0])
    departures.kelvin[:, : LOW_M.size] -= columns @ np.array(tables).T
    return np.array(tables).T


def land_share(ascents: list[Ascent]) -> np.ndarray:
    """As `air_variation.share_of_day`, for the fit."""
    return np.array([share_of_day(ascent.latitude_rad) for ascent in ascents])


def second_moments(values: np.ndarray) -> np.ndarray:
    """(n, n) means of products of rows (m, n), without the unknown."""
    known = np.isfinite(values).astype(float)
    filled = np.nan_to_num(values)
    return (filled.T @ filled) / np.maximum(known.T @ known, 1.0)


def r_by_temperature() -> np.ndarray:
    """(c, n) change of R [%] at `CLIMBS_M` by a kelvin at `HEIGHT_M`, dry, about US 1976."""
    h = np.arange(0.0, CLIMBS_M[-1] + 1.0, 10.0)
    standard = np.maximum(288.15 - 0.0065 * h, 216.65)

    def r_of(t: np.ndarray) -> np.ndarray:
        fall = np.concatenate([[0.0], np.cumsum(0.0341632 * 20.0 / (t[1:] + t[:-1]))])
        density = np.exp(-fall) / t
        tops = [round(climb / 10.0) for climb in CLIMBS_M]
        return np.array([density[: top + 1].mean() - density[top] for top in tops])

    rows = [r_of(standard + np.interp(h, HEIGHT_M, hat)) for hat in np.eye(HEIGHT_M.size)]
    return 100.0 * (np.array(rows) / r_of(standard) - 1.0).T


R_BY_TEMPERATURE = r_by_temperature()


def moments_of(
    values: list[np.ndarray] | np.ndarray, weight: float, mixed: float, **how
) -> Moments:
    """Second moments of departures or changes (m, n)."""
    values = np.asarray(values)
    by = np.where(np.abs(R_BY_TEMPERATURE) > 1e-9, R_BY_TEMPERATURE, 0.0)
    r = np.array([values[:, row != 0.0] @ row[row != 0.0] for row in by])
    return Moments(second_moments(values), np.nanmean(r**2, axis=1), weight, mixed, **how)


def observed(departures: Departures) -> list[Moments]:
    """Departures of the middle latitudes, changes over stations, differences between them."""
    ascents = departures.ascents
    kelvin = departures.kelvin
    groups = departures.groups
    hours = np.array([ascent.time_ns / 3.6e12 for ascent in ascents])
    by_day = np.array([DAY_HOURS[0] < ascent.solar_hour < DAY_HOURS[1] for ascent in ascents])
    mixed = np.array([mixed_share(a.latitude_rad, a.month, a.solar_hour) for a in ascents])
    degrees = np.array([abs(math.degrees(ascent.latitude_rad)) for ascent in ascents])
    middle = degrees > MIDDLE_LATITUDES_DEG
    kelvin = kelvin / np.array([weather_share(ascent.latitude_rad) for ascent in ascents])[:, None]
    moments = []
    for group in np.unique(groups[middle]):
        for at_day in (True, False):
            chosen = middle & (groups == group) & (by_day == at_day)
            if chosen.sum() >= FEWEST:
                weight = GROUP_WEIGHT
                share = float(mixed[chosen].mean())
                moments.append(moments_of(kelvin[chosen], weight, share, is_change=False))
    place = np.array([(a.latitude_rad, a.longitude_rad) for a in ascents])
    pairs: dict[tuple[float, bool, bool], list[tuple[int, int]]] = {}
    for i in np.flatnonzero(middle):
        same = np.all(np.abs(place - place[i]) < 1e-3, axis=1)
        for lag in LAGS_H:
            for j in np.flatnonzero(same & (np.abs(hours - hours[i] - lag) < 1.5)):
                at_day = bool(by_day[i] and by_day[j])
                key = lag, bool(departures.winter[i] > 0.5), at_day
                pairs.setdefault(key, []).append((int(i), int(j)))
    for (lag, _, _), of_lag in pairs.items():
        if len(of_lag) >= FEWEST:
            first, later = np.array(of_lag).T
            share = float(np.mean(0.5 * (mixed[first] + mixed[later])))
            weight = min(float(len(of_lag)), GROUP_WEIGHT)
            moments.append(moments_of(kelvin[later] - kelvin[first], weight, share, hours=lag))
    america = np.flatnonzero(np.char.startswith(groups, "n_america"))
    km = np.array([[ascents[i].km_from(ascents[j]) for j in america] for i in america])
    for low, high in pairwise(DISTANCES_KM):
        first, other = np.nonzero(np.triu((km > low) & (km <= high), 1))
        if first.size >= FEWEST:
            changes = kelvin[america[first]] - kelvin[america[other]]
            share = float(mixed[america].mean())
            at = float(km[first, other].mean())
            weight = GROUP_WEIGHT * (NEAR_WEIGHT if high == DISTANCES_KM[1] else 1.0)
            moments.append(moments_of(changes, weight, share, km=at))
    return moments


NAMES = ("waves", "layers", "climate", "ground")
START = np.concatenate([
    [2.0, 3.0, 5.0, 5.5, 5.0, 1.5, -4.0, -4.5, -1.5],  # waves [K] at NODE_M
    [2.0, 3.0, 2.0, 2.0, 2.0, 3.0, 2.5, 2.0, 2.0],  # layers [K] at NODE_M
    [5.0, 4.5, 3.0, 2.3, 2.0, 2.0, 2.0],  # climate [K] at CLIMATE_NODE_M
    np.log([1500.0]),  # length of layers [m]
    np.log([100.0, 32.0, 8.0, 11.0]),  # memory of waves, layers, ground, fine [h]
    np.log([3500.0, 2000.0, 1500.0, 150.0, 300.0]),  # reach, with climate before ground [km]
    np.log([0.7]),  # factor of layers and fine structure in mixed air
])  # fmt: skip
EXPECTED = np.concatenate([
    np.full(9, 2.0), np.full(9, 1.0), np.full(7, 1.5),
    [0.5], [0.4, 0.2, 0.1, 0.2], [0.4, 0.4, 0.4, 0.1, 0.1], [0.4],
])  # fmt: skip
"""How far the fit may be from its start before that costs as much as a moment."""
WAVES_LENGTH_M = 20_000.0  # one pattern from the ground to the stratosphere
CLIMATE_LENGTH_M = 15_000.0
LEAST_WAVES_K = 1.5  # at the ground: inversions there are of other parts
MIXED_BELOW_M = 1500.0  # inversions stay at the top of mixed air [m]
LEAST_MIXED = 0.6
"""Share of layers and fine structure that stays in mixed air at least. The ascents near hail alone
would have 0.25, but moist air that is as warm cools less with height than theirs, and a
thermometer's climb through it was then 1.8 sigma off, or refused."""
LONGEST_FINE_H = 12.0  # memory of inversions: the day makes them, and ends them
LEAST_K = 1.0  # amplitude of layers, also where no ascent shows any
LEAST_CLIMATE_K = np.array([4.5, 4.0, 2.5, 2.3, 1.5, 1.5, 1.0])
"""What groups of ascents depart by together: R hardly sees it, stations at the ground do [K]."""


@dataclass
class Model:
    """The parts by the numbers that are fitted."""

    numbers: np.ndarray

    def tables(self) -> dict[str, dict[str, object]]:
        """Each part as the package has it."""
        x = self.numbers
        memory = dict(zip(("waves", "layers", "ground", "fine"), np.exp(x[26:30]), strict=True))
        reach = dict(
            zip(("waves", "layers", "climate", "ground", "fine"), np.exp(x[30:35]), strict=True)
        )
        ground = GROUND_K * np.exp(-GROUND_NODE_M / GROUND_DEPTH_M)
        ground[-1] = 0.0
        length = float(np.exp(x[25]))
        shapes = {
            "waves": (NODE_M, x[:9], WAVES_LENGTH_M, "smooth"),
            "layers": (NODE_M, x[9:18], length, "smooth"),
            "climate": (
                np.append(CLIMATE_NODE_M, STRATOSPHERE_M),
                np.append(x[18:25], STRATOSPHERE_K),
                CLIMATE_LENGTH_M,
                "smooth",
            ),
            "ground": (GROUND_NODE_M, ground, WAVES_LENGTH_M, "smooth"),
        }
        mixed = float(np.exp(x[35]))
        mixed_k = {"layers": x[9:18] * np.where(NODE_M < MIXED_BELOW_M, mixed, 1.0)}
        for name, fine_length in FINE_LENGTH_M.items():
            stable = FINE_K * FINE_SHARES[name]
            shapes[name] = (FINE_NODE_M, stable, fine_length, name)
            mixed_k[name] = stable * np.where(FINE_NODE_M < MIXED_BELOW_M, mixed, 1.0)
        memory |= {"climate": CLIMATE_MEMORY_H, "kinked": memory["fine"], "smooth": memory["fine"]}
        reach |= {"kinked": reach["fine"], "smooth": reach["fine"]}
        return {
            name: {
                "height_m": nodes,
                "sigma_k": sigma,
                "mixed_sigma_k": mixed_k.get(name, sigma),
                "length_m": length_m,
                "shape": shape,
                "memory_h": float(memory[name]),
                "reach_km": float(reach[name]),
            }
            for name, (nodes, sigma, length_m, shape) in shapes.items()
        }

    def moments(self, of: list[Moments]) -> list[np.ndarray]:
        """What the parts give in the place of the observed moments."""
        apart = np.abs(HEIGHT_M[:, None] - HEIGHT_M)
        sums = [np.zeros(apart.shape) for _ in of]
        for part in self.tables().values():
            stable, mixed = (
                np.interp(HEIGHT_M, part["height_m"], part[key])
                for key in ("sigma_k", "mixed_sigma_k")
            )
            shape = correlation(apart, part["length_m"], kinked=part["shape"] == "kinked")
            for i, moment in enumerate(of):
                sigma = (1.0 - moment.mixed) * stable + moment.mixed * mixed
                covariance = np.outer(sigma, sigma) * shape
                alike = math.exp(-moment.hours / part["memory_h"] - moment.km / part["reach_km"])
                sums[i] += covariance * (2.0 * (1.0 - alike) if moment.is_change else 1.0)
        return sums


def fitted(moments: list[Moments]) -> Model:
    """Least squares of the moments, each about the sigmas of its heights."""

    def residuals(numbers: np.ndarray) -> np.ndarray:
        parts = [0.3 * (numbers - START) / EXPECTED]
        for moment, matrix in zip(moments, Model(numbers).moments(moments), strict=True):
            sigma = np.sqrt(np.maximum(np.diag(moment.matrix), 1.0))
            off = (matrix - moment.matrix) / np.outer(sigma, sigma)
            off /= math.sqrt(sigma.size)
            r = np.einsum("ci,ij,cj->c", R_BY_TEMPERATURE, matrix, R_BY_TEMPERATURE)
            of_r = FUNCTIONAL_WEIGHT * np.log(r / moment.r)
            of_t = np.log(np.diag(matrix) / sigma**2) / math.sqrt(sigma.size)
            rows = off.ravel(), of_r, FUNCTIONAL_WEIGHT * of_t
            parts += [np.sqrt(moment.weight / GROUP_WEIGHT) * row for row in rows]
        return np.concatenate(parts)

    low = np.full(START.size, -np.inf)
    low[9:18] = LEAST_K
    low[0] = LEAST_WAVES_K
    low[18:25] = LEAST_CLIMATE_K
    low[35] = math.log(LEAST_MIXED)
    high = np.full(START.size, np.inf)
    high[29] = math.log(LONGEST_FINE_H)
    return Model(least_squares(residuals, START, bounds=(low, high)).x)


def print_toml(daily: np.ndarray, model: Model, count: int) -> None:
    """The numbers as the package reads them."""

    def row(values: np.ndarray, digits: int) -> str:
        return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"

    print(f"# Written by benchmarks/fit_air.py from {count} public ascents: do not edit.")
    print("\n[daily]")
    print(f"height_m = {row(LOW_M, 0)}")
    for name, values in zip(
        ("winter_k", "summer_k", "by_hour_winter_k", "by_hour_summer_k"), daily, strict=True
    ):
        print(f"{name} = {row(values, 2)}")
    for name, part in model.tables().items():
        print(f"\n[parts.{name}]")
        print(f"height_m = {row(part['height_m'], 0)}")
        print(f"sigma_k = {row(part['sigma_k'], 2)}")
        print(f"mixed_sigma_k = {row(part['mixed_sigma_k'], 2)}")
        print(f"length_m = {part['length_m']:.0f}")
        print(f'shape = "{part["shape"]}"')
        print(f"memory_h = {part['memory_h']:.1f}")
        print(f"reach_km = {part['reach_km']:.0f}")


def main() -> None:
    """Read, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    parser.add_argument("--half", type=int, choices=(0, 1), help="fit this half of the ascents")
    arguments = parser.parse_args()
    ascents = read_ascents(arguments.folder)
    if arguments.half is not None:
        ascents = [ascent for ascent in ascents if ascent.half == arguments.half]
    departures = Departures(ascents)
    daily = daily_tables(departures, land_share(ascents))
    moments = observed(departures)
    model = fitted(moments)
    for moment, matrix in zip(moments, model.moments(moments), strict=True):
        r = np.einsum("ci,ij,cj->c", R_BY_TEMPERATURE, matrix, R_BY_TEMPERATURE)
        what = f"{moment.hours:.0f} h, {moment.km:.0f} km, {moment.mixed:.1f} mixed"
        ratios = ", ".join(f"{ratio:.2f}" for ratio in np.sqrt(moment.r / r))
        kelvin = np.sqrt(np.diag(moment.matrix) / np.diag(matrix))[::4]
        of_t = ", ".join(f"{ratio:.2f}" for ratio in kelvin)
        print(f"{what:>32}: observed over fitted R {ratios}, T {of_t}", file=sys.stderr)
    print_toml(daily, model, len(ascents))


if __name__ == "__main__":
    main()
