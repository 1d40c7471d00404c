"""Fits the structure function of the air to public ascents: `atmosphere/data/air_variation.toml`.

    python benchmarks/fit_air.py [--half 0|1] [FOLDER] > air_variation.toml

(into pipeline/unbend/atmosphere/data).

First what the Supplements 1966 lack in the lowest 3 km, on average and by the hour of the day; then
the parts of `unbend.atmosphere.air_variation`, so that their sum has the second moments of

* the departures from that climatology, each group of ascents weighing alike, and what of R is left
  of them where a METAR gives the temperature at the ground,
* the changes in 12 to 240 hours over one station, without their mean,
* the differences between stations of one hour, 340 to 2700 km apart.

``--half`` fits one half of the ascents, so that `judge_air.py --half` judges by the other.
"""

import argparse
import math
import sys
from collections.abc import Iterator
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
METAR_SIGMA_K = 0.3  # of a temperature in whole degrees
LEAST_LEFT_BY_METAR = 0.3  # variance of R [%2] that counts as known: few ascents may have less


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

    def __post_init__(self):
        departures = []
        winter = []
        for ascent in self.ascents:
            latitude = ascent.latitude_rad
            h = compared_heights(ascent)
            measured = np.interp(h, ascent.h_m, ascent.temperature_k, right=np.nan)
            supplements = supplements_profile(latitude, ascent.month)
            departures.append(measured - supplements.temperature(h))
            winter.append(0.5 + 0.5 * season(latitude, ascent.month))
        self.kelvin = np.array(departures)
        self.winter = np.array(winter)

    @property
    def groups(self) -> np.ndarray:
        return np.array([ascent.group for ascent in self.ascents])

    @property
    def latitude_rad(self) -> np.ndarray:
        return np.array([ascent.latitude_rad for ascent in self.ascents])

    @property
    def solar_hour(self) -> np.ndarray:
        return np.array([ascent.solar_hour for ascent in self.ascents])


def compared_heights(ascent: Ascent) -> np.ndarray:
    """`HEIGHT_M` above the ground of an ascent, as heights above the sea [m]."""
    ground = float(ascent.h_m[0])
    top = ground + 30_000.0
    fine = np.arange(ground, top, 10.0)
    tropopause = tropopause_m(ascent.latitude_rad, ascent.month)
    reduced = reduced_height(fine, ground, tropopause)
    return np.interp(HEIGHT_M, reduced, fine)


def daily_tables(departures: Departures, share: np.ndarray) -> np.ndarray:
    """(4, n) means at `LOW_M` about that at 3 km: winter, summer, by the hour in winter, summer.

    Groups weigh alike, those of the tropics a third.
    """
    _, group, members = np.unique(
        departures.groups,
        return_inverse=True,
        return_counts=True,
    )
    weight = 1.0 / members[group]
    weight = weight * np.where(share < 0.5, 0.3, 1.0)
    phase = (departures.solar_hour - WARMEST_HOUR) / 24.0
    by_hour = np.cos(2.0 * math.pi * phase)
    winter = departures.winter
    summer = 1.0 - winter
    columns = [
        winter,
        summer,
        by_hour * winter,
        by_hour * summer,
    ]
    design = share[:, None] * np.stack(columns, axis=1)
    low = departures.kelvin[:, : LOW_M.size]
    above_3_km = low - low[:, -1:]
    tables = []
    for values in above_3_km.T:
        known = np.isfinite(values)
        root = np.sqrt(weight[known])
        weighted = design[known] * root[:, None]
        fit = np.linalg.lstsq(weighted, values[known] * root, rcond=None)
        tables.append(fit[0])
    departures.kelvin[:, : LOW_M.size] -= design @ np.array(tables).T
    return np.array(tables).T


def second_moments(values: np.ndarray) -> np.ndarray:
    """(n, n) means of products of rows (m, n), without the unknown."""
    known = np.isfinite(values).astype(float)
    count = known.T @ known
    filled = np.nan_to_num(values)
    return (filled.T @ filled) / np.maximum(count, 1.0)


def r_of_temperature(t: np.ndarray) -> np.ndarray:
    """(c,) R at `CLIMBS_M`, up to a factor, of temperatures in steps of 10 m."""
    between = 0.0341632 * 20.0 / (t[1:] + t[:-1])
    fall = np.append(0.0, np.cumsum(between))
    density = np.exp(-fall) / t
    r = []
    for climb in CLIMBS_M:
        top = round(climb / 10.0)
        r.append(density[: top + 1].mean() - density[top])
    return np.array(r)


def r_by_temperature() -> np.ndarray:
    """(c, n) change of R [%] at `CLIMBS_M` by a kelvin at `HEIGHT_M`, dry, about US 1976."""
    h = np.arange(0.0, CLIMBS_M[-1] + 1.0, 10.0)
    standard = np.maximum(288.15 - 0.0065 * h, 216.65)
    r = []
    for hat in np.eye(HEIGHT_M.size):
        warmer = standard + np.interp(h, HEIGHT_M, hat)
        r.append(r_of_temperature(warmer))
    ratio = np.array(r) / r_of_temperature(standard)
    return 100.0 * (ratio - 1.0).T


R_BY_TEMPERATURE = r_by_temperature()


def moments_of(values: np.ndarray, weight: float, mixed: float, **how) -> Moments:
    """Second moments of departures or changes (m, n)."""
    r2 = []
    for row in R_BY_TEMPERATURE:
        used = np.abs(row) > 1e-9  # other heights may be unknown
        r = values[:, used] @ row[used]
        r2.append(np.nanmean(r**2))
    return Moments(second_moments(values), np.array(r2), weight, mixed, **how)


@dataclass
class Observed:
    """Departures by the weather of their place, and what their moments are grouped by (m,)."""

    departures: Departures
    kelvin: np.ndarray = field(init=False)
    by_day: np.ndarray = field(init=False)
    mixed: np.ndarray = field(init=False)
    middle: np.ndarray = field(init=False)

    def __post_init__(self):
        latitude = self.departures.latitude_rad
        hour = self.departures.solar_hour
        weather = []
        mixed = []
        for ascent in self.departures.ascents:
            weather.append(weather_share(ascent.latitude_rad))
            share = mixed_share(
                ascent.latitude_rad,
                ascent.month,
                ascent.solar_hour,
            )
            mixed.append(share)
        self.kelvin = self.departures.kelvin / np.array(weather)[:, None]
        self.by_day = (DAY_HOURS[0] < hour) & (hour < DAY_HOURS[1])
        self.mixed = np.array(mixed)
        self.middle = np.abs(np.degrees(latitude)) > MIDDLE_LATITUDES_DEG

    def moments(self) -> list[Moments]:
        """Departures of the middle latitudes, changes over stations, differences between them."""
        return [*self.of_groups(), *self.of_changes(), *self.of_distances()]

    def of_groups(self) -> Iterator[Moments]:
        groups = self.departures.groups
        for group in np.unique(groups[self.middle]):
            of_group = self.middle & (groups == group)
            for at_day in (True, False):
                chosen = of_group & (self.by_day == at_day)
                if chosen.sum() >= FEWEST:
                    yield moments_of(
                        self.kelvin[chosen],
                        GROUP_WEIGHT,
                        float(self.mixed[chosen].mean()),
                        is_change=False,
                    )

    def of_changes(self) -> Iterator[Moments]:
        for (lag, _, _), pairs in self.pairs_in_time().items():
            if len(pairs) < FEWEST:
                continue
            first, later = np.array(pairs).T
            mixed = 0.5 * (self.mixed[first] + self.mixed[later])
            yield moments_of(
                self.kelvin[later] - self.kelvin[first],
                min(float(len(pairs)), GROUP_WEIGHT),
                float(np.mean(mixed)),
                hours=lag,
            )

    def pairs_in_time(self) -> dict[tuple[float, bool, bool], list[tuple[int, int]]]:
        """Ascents over one station, by hours between them, winter, and whether both are by day."""
        ascents = self.departures.ascents
        place = np.array([(ascent.latitude_rad, ascent.longitude_rad) for ascent in ascents])
        hours = np.array([ascent.time_ns / 3.6e12 for ascent in ascents])
        pairs: dict[tuple[float, bool, bool], list[tuple[int, int]]] = {}
        for first in np.flatnonzero(self.middle).tolist():
            apart = np.abs(place - place[first])
            same_place = np.all(apart < 1e-3, axis=1)
            winter = bool(self.departures.winter[first] > 0.5)
            for lag in LAGS_H:
                off = np.abs(hours - hours[first] - lag)
                for later in np.flatnonzero(same_place & (off < 1.5)).tolist():
                    at_day = bool(self.by_day[first] and self.by_day[later])
                    key = (lag, winter, at_day)
                    pairs.setdefault(key, []).append((first, later))
        return pairs

    def of_distances(self) -> Iterator[Moments]:
        ascents = self.departures.ascents
        america = np.flatnonzero(np.char.startswith(self.departures.groups, "n_america"))
        km = np.empty((america.size, america.size))
        for row, i in enumerate(america):
            km[row] = [ascents[i].km_from(ascents[j]) for j in america]
        kelvin = self.kelvin[america]
        for low, high in pairwise(DISTANCES_KM):
            between = (km > low) & (km <= high)
            first, second = np.nonzero(np.triu(between, 1))
            if first.size < FEWEST:
                continue
            weight = GROUP_WEIGHT
            if high == DISTANCES_KM[1]:
                weight *= NEAR_WEIGHT
            yield moments_of(
                kelvin[first] - kelvin[second],
                weight,
                float(self.mixed[america].mean()),
                km=float(km[first, second].mean()),
            )


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
CLIMATE_LENGTH_M = 8000.0
LEAST_WAVES_K = 1.5  # at the ground: inversions there are of other parts
MIXED_BELOW_M = 2500.0  # inversions stay at the top of mixed air [m]
LEAST_MIXED = 0.4
"""Share of layers and fine structure that stays in mixed air at least. The ascents near hail alone
would have 0.25, but moist air that is as warm cools less with height than theirs, and a
thermometer's climb through it was then 1.8 sigma off, or refused."""
LONGEST_FINE_H = 12.0  # memory of inversions: the day makes them, and ends them
LEAST_K = 1.0  # amplitude of layers, also where no ascent shows any
LEAST_CLIMATE_K = np.array([4.5, 4.0, 2.5, 2.3, 1.5, 1.5, 1.0])
"""What groups of ascents depart by together: R hardly sees it, stations at the ground do [K]."""


WAVES = slice(0, 9)  # of the numbers that are fitted
LAYERS = slice(9, 18)
CLIMATE = slice(18, 25)
LAYERS_LENGTH = 25
MEMORIES = slice(26, 30)
MEMORY_OF_FINE = 29
REACHES = slice(30, 35)
MIXED = 35


@dataclass
class Part:
    """One part of the structure function."""

    height_m: np.ndarray
    sigma_k: np.ndarray
    length_m: float
    memory_h: float
    reach_km: float
    mixed_sigma_k: np.ndarray | None = None  # `sigma_k` where it is the same
    shape: str = "smooth"

    def __post_init__(self):
        if self.mixed_sigma_k is None:
            self.mixed_sigma_k = self.sigma_k

    def sigma(self, mixed: float) -> np.ndarray:
        """At `HEIGHT_M`, where a share of the air is mixed [K]."""
        stable_k = np.interp(HEIGHT_M, self.height_m, self.sigma_k)
        mixed_k = np.interp(HEIGHT_M, self.height_m, self.mixed_sigma_k)
        return (1.0 - mixed) * stable_k + mixed * mixed_k

    def share(self, moment: Moments) -> float:
        """How much of its variance is in departures, or in changes so far apart."""
        if not moment.is_change:
            return 1.0
        hours = moment.hours / self.memory_h
        km = moment.km / self.reach_km
        alike = math.exp(-hours - km)
        return 2.0 * (1.0 - alike)


@dataclass
class Model:
    """The parts by the numbers that are fitted."""

    numbers: np.ndarray

    def parts(self) -> dict[str, Part]:
        """Each part as the package has it."""
        waves_h, layers_h, ground_h, fine_h = np.exp(self.numbers[MEMORIES]).tolist()
        reaches_km = np.exp(self.numbers[REACHES]).tolist()
        waves_km, layers_km, climate_km, ground_km, fine_km = reaches_km
        waves_k = self.numbers[WAVES]
        layers_k = self.numbers[LAYERS]
        climate_k = np.append(self.numbers[CLIMATE], STRATOSPHERE_K)
        ground_k = GROUND_K * np.exp(-GROUND_NODE_M / GROUND_DEPTH_M)
        ground_k[-1] = 0.0
        parts = {
            "waves": Part(
                height_m=NODE_M,
                sigma_k=waves_k,
                length_m=WAVES_LENGTH_M,
                memory_h=waves_h,
                reach_km=waves_km,
            ),
            "layers": Part(
                height_m=NODE_M,
                sigma_k=layers_k,
                mixed_sigma_k=self.in_mixed_air(NODE_M, layers_k),
                length_m=float(np.exp(self.numbers[LAYERS_LENGTH])),
                memory_h=layers_h,
                reach_km=layers_km,
            ),
            "climate": Part(
                height_m=np.append(CLIMATE_NODE_M, STRATOSPHERE_M),
                sigma_k=climate_k,
                length_m=CLIMATE_LENGTH_M,
                memory_h=CLIMATE_MEMORY_H,
                reach_km=climate_km,
            ),
            "ground": Part(
                height_m=GROUND_NODE_M,
                sigma_k=ground_k,
                length_m=WAVES_LENGTH_M,
                memory_h=ground_h,
                reach_km=ground_km,
            ),
        }
        for name, length_m in FINE_LENGTH_M.items():
            fine_k = FINE_K * FINE_SHARES[name]
            parts[name] = Part(
                height_m=FINE_NODE_M,
                sigma_k=fine_k,
                mixed_sigma_k=self.in_mixed_air(FINE_NODE_M, fine_k),
                length_m=length_m,
                shape=name,
                memory_h=fine_h,
                reach_km=fine_km,
            )
        return parts

    def in_mixed_air(self, height_m: np.ndarray, stable_k: np.ndarray) -> np.ndarray:
        """Amplitudes in mixed air [K], by those in stable air."""
        mixed = float(np.exp(self.numbers[MIXED]))
        return stable_k * np.where(height_m < MIXED_BELOW_M, mixed, 1.0)

    def moments(self, observed: list[Moments]) -> list[np.ndarray]:
        """What the parts give in the place of the observed moments."""
        apart = np.abs(HEIGHT_M[:, None] - HEIGHT_M)
        sums = [np.zeros(apart.shape) for _ in observed]
        for part in self.parts().values():
            is_kinked = part.shape == "kinked"
            shape = correlation(apart, part.length_m, kinked=is_kinked)
            for matrix, moment in zip(sums, observed, strict=True):
                sigma = part.sigma(moment.mixed)
                covariance = np.outer(sigma, sigma) * shape
                matrix += covariance * part.share(moment)
        return sums


def variance_of_r(matrix: np.ndarray) -> np.ndarray:
    """(c,) of R at `CLIMBS_M` [%2], of temperatures with these second moments."""
    return np.einsum("ci,ij,cj->c", R_BY_TEMPERATURE, matrix, R_BY_TEMPERATURE)


def variance_of_r_left_by_metar(matrix: np.ndarray) -> np.ndarray:
    """(c,) variance of R at `CLIMBS_M` [%2] that is left when a METAR gives the temperature at the
    ground, which is row 0 of ``matrix``."""
    with_ground = R_BY_TEMPERATURE @ matrix[:, 0]
    explained = with_ground**2 / (matrix[0, 0] + METAR_SIGMA_K**2)
    return variance_of_r(matrix) - explained


def residuals_of(moment: Moments, matrix: np.ndarray) -> np.ndarray:
    """Weighted residuals for least squares.

    Of the matrix in units of its sigmas, and of the logarithms of the variances of R and of T.
    Moments of departures also have the variance of R that a METAR leaves.
    """
    variance = np.maximum(np.diag(moment.matrix), 1.0)
    sigma = np.sqrt(variance)
    root_of_levels = math.sqrt(sigma.size)  # so that a matrix weighs as one of its rows
    of_matrix = (matrix - moment.matrix) / np.outer(sigma, sigma) / root_of_levels
    of_r = np.log(variance_of_r(matrix) / moment.r)
    variance_ratio = np.diag(matrix) / sigma**2
    of_t = np.log(variance_ratio) / root_of_levels
    rows = [
        of_matrix.ravel(),
        FUNCTIONAL_WEIGHT * of_r,
        FUNCTIONAL_WEIGHT * of_t,
    ]
    if not moment.is_change:
        observed = np.maximum(variance_of_r_left_by_metar(moment.matrix), LEAST_LEFT_BY_METAR)
        of_metar = np.log(variance_of_r_left_by_metar(matrix) / observed)
        rows.append(FUNCTIONAL_WEIGHT * of_metar)
    return np.sqrt(moment.weight / GROUP_WEIGHT) * np.concatenate(rows)


def fitted(moments: list[Moments]) -> Model:
    """Least squares of the moments, each about the sigmas of its heights."""

    def residuals(numbers: np.ndarray) -> np.ndarray:
        parts = [0.3 * (numbers - START) / EXPECTED]
        matrices = Model(numbers).moments(moments)
        for moment, matrix in zip(moments, matrices, strict=True):
            parts.append(residuals_of(moment, matrix))
        return np.concatenate(parts)

    low = np.full(START.size, -np.inf)
    low[LAYERS] = LEAST_K
    low[WAVES.start] = LEAST_WAVES_K
    low[CLIMATE] = LEAST_CLIMATE_K
    low[MIXED] = math.log(LEAST_MIXED)
    high = np.full(START.size, np.inf)
    high[MEMORY_OF_FINE] = math.log(LONGEST_FINE_H)
    fit = least_squares(residuals, START, bounds=(low, high))
    return Model(fit.x)


def print_toml(daily: np.ndarray, model: Model, count: int):
    """The numbers as the package reads them."""
    print(f"# Written by benchmarks/fit_air.py from {count} public ascents: do not edit.")
    print("\n[daily]")
    print(f"height_m = {row(LOW_M, 0)}")
    names = ("winter_k", "summer_k", "by_hour_winter_k", "by_hour_summer_k")
    for name, values in zip(names, daily, strict=True):
        print(f"{name} = {row(values, 2)}")
    for name, part in model.parts().items():
        print(f"\n[parts.{name}]")
        print(f"height_m = {row(part.height_m, 0)}")
        print(f"sigma_k = {row(part.sigma_k, 2)}")
        print(f"mixed_sigma_k = {row(part.mixed_sigma_k, 2)}")
        print(f"length_m = {part.length_m:.0f}")
        print(f'shape = "{part.shape}"')
        print(f"memory_h = {part.memory_h:.1f}")
        print(f"reach_km = {part.reach_km:.0f}")


def row(values: np.ndarray, digits: int) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"


def print_ratios(moment: Moments, matrix: np.ndarray):
    """Observed over fitted, to the error stream."""
    case = f"{moment.hours:.0f} h, {moment.km:.0f} km, {moment.mixed:.1f} mixed"
    of_r = np.sqrt(moment.r / variance_of_r(matrix))
    of_t = np.sqrt(np.diag(moment.matrix) / np.diag(matrix))
    ratios = f"R {row(of_r, 2)}, T {row(of_t[::4], 2)}"
    print(f"{case:>32}: observed over fitted {ratios}", file=sys.stderr)


def main():
    """Read, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    parser.add_argument(
        "--half",
        type=int,
        choices=(0, 1),
        help="fit this half of the ascents",
    )
    arguments = parser.parse_args()
    ascents = read_ascents(arguments.folder)
    if arguments.half is not None:
        ascents = [ascent for ascent in ascents if ascent.half == arguments.half]
    departures = Departures(ascents)
    share = np.array([share_of_day(ascent.latitude_rad) for ascent in ascents])
    daily = daily_tables(departures, share)
    moments = Observed(departures).moments()
    model = fitted(moments)
    for moment, matrix in zip(moments, model.moments(moments), strict=True):
        print_ratios(moment, matrix)
    print_toml(daily, model, len(ascents))


if __name__ == "__main__":
    main()
