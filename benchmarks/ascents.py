"""Public ascents as truth for what is said of the air: their levels, and R integrated over them.

The files (one a group, a row a level; `python benchmarks/judge_air.py` says where they are looked
for) are not part of the repository. Nothing of the integration is shared with the estimator.
"""

from __future__ import annotations

import csv
import lzma
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid

from unbend.simulate.true_air import edlen_index, normal_gravity, saturation_pressure_pa

_WORKSPACE = Path(__file__).resolve().parents[2]
FOLDER = _WORKSPACE / "shared" / "soundings" / "many"
CLIMBS_M = (500.0, 1000.0, 3000.0, 6000.0, 10_000.0)

STANDARD_GRAVITY = 9.80665  # of geopotential metres [m/s2]
GRAVITY_FALL = 3.086e-6  # of gravity with height [1/s2]
MOLAR_MASS = 28.9644  # [kg/kmol]
GAS_CONSTANT = 8314.32  # [J/(kmol K)]

_STEP_M = 10.0
_COLUMNS = ("geopotential_m", "pressure_hpa", "temperature_c", "dew_point_c")
_LEAST_LEVELS = 5
_DRIEST_K = 190.0  # dew points below are no measurements
_BLOCK_DAYS = 10  # days of one station that are fitted, or judged, together
_EARTH_KM = 6371.0


@dataclass(frozen=True, eq=False)
class Ascent:
    """Levels (n,) of one ascent from the ground up."""

    name: str
    group: str
    time_ns: int
    latitude_rad: float
    longitude_rad: float
    geopotential_m: np.ndarray
    pressure_pa: np.ndarray
    temperature_k: np.ndarray
    dew_point_k: np.ndarray

    @property
    def h_m(self) -> np.ndarray:
        """Heights above sea level [m]."""
        gravity = normal_gravity(self.latitude_rad, 0.0)
        h = self.geopotential_m * STANDARD_GRAVITY / gravity
        fall = 0.5 * GRAVITY_FALL / gravity * h
        return h * (1.0 + fall)

    @property
    def solar_hour(self) -> float:
        """Mean local time [h]."""
        hour = self.time_ns / 3.6e12
        east_h = math.degrees(self.longitude_rad) / 15.0
        return (hour + east_h) % 24.0

    @property
    def month(self) -> float:
        """1.0 is 15 January."""
        date = np.datetime64(self.time_ns, "ns").astype("datetime64[D]")
        year = date.astype("datetime64[Y]")
        day = float((date - year).astype(float))
        return (day - 14.0) / 30.4375 + 1.0

    @property
    def vapour_pressure_pa(self) -> np.ndarray:
        """At the levels; missing dew points are interpolated."""
        height = self.geopotential_m
        is_measured = np.isfinite(self.dew_point_k)
        if not is_measured.any():
            return np.full(height.size, 1e-3)
        dew_point = np.interp(
            height,
            height[is_measured],
            self.dew_point_k[is_measured],
        )
        return saturation_pressure_pa(np.maximum(dew_point, _DRIEST_K))

    def km_from(self, other: Ascent) -> float:
        """Great-circle distance."""
        north = 0.5 * (self.latitude_rad - other.latitude_rad)
        east = 0.5 * (self.longitude_rad - other.longitude_rad)
        squeezed = math.cos(self.latitude_rad) * math.cos(other.latitude_rad)
        half_chord2 = math.sin(north) ** 2 + squeezed * math.sin(east) ** 2
        half_chord = math.sqrt(half_chord2)
        angle = 2.0 * math.asin(half_chord)
        return _EARTH_KM * angle

    @property
    def half(self) -> int:
        """0 or 1, by blocks of days and by place: one half is fitted, the other judges."""
        days = self.time_ns // (86_400 * 10**9)
        north = round(math.degrees(self.latitude_rad) * 20)
        east = round(math.degrees(self.longitude_rad) * 20)
        block = days // _BLOCK_DAYS
        return int((block + north + east) % 2)

    def mean_gradient(self, climb_m: float, air=None) -> float:
        """R / tan(zeta) in the plane from a camera so high above the lowest level to that level:
        the mean of N - N_c (Gyer 1996, Eq. 24); of another ``air`` over the same heights."""
        refractivity = self._refractivity
        if air is not None:
            refractivity = air.refractivity
        highest_m = climb_m + 0.5 * _STEP_M
        above_m = np.arange(0.0, highest_m, _STEP_M)
        n = refractivity(self.h_m[0] + above_m)
        integral = trapezoid(n - n[-1], dx=_STEP_M)
        mean = integral / climb_m
        return float(mean)

    def error(self, air, climb_m: float) -> float:
        """Relative error of R with another air."""
        truth = self.mean_gradient(climb_m)
        return self.mean_gradient(climb_m, air) / truth - 1.0

    def reaches(self, climb_m: float) -> bool:
        """Whether its levels go as high as a camera so high above its lowest one."""
        return bool(self.h_m[-1] >= self.h_m[0] + climb_m)

    def _refractivity(self, h: np.ndarray) -> np.ndarray:
        levels = self.h_m
        log_pressure = np.log(self.vapour_pressure_pa)
        t = np.interp(h, levels, self.temperature_k)
        e = np.exp(np.interp(h, levels, log_pressure))
        gravity = normal_gravity(self.latitude_rad, 0.0)
        gravity = gravity - GRAVITY_FALL * h
        p = np.full(h.size, self.pressure_pa[0])
        for _ in range(3):  # the vapour's share of the weight settles against pressure
            virtual = t / (1.0 - 0.378 * e / p)
            slope = gravity * MOLAR_MASS / GAS_CONSTANT / virtual
            fall = cumulative_trapezoid(slope, h, initial=0.0)
            p = self.pressure_pa[0] * np.exp(-fall)
        return edlen_index(p, t, e) - 1.0


def read_ascents(folder: Path = FOLDER) -> list[Ascent]:
    """All ascents of the files of a folder."""
    ascents: list[Ascent] = []
    for path in sorted(folder.glob("*.csv.xz")):
        ascents += _of_file(path)
    return ascents


def _of_file(path: Path) -> Iterator[Ascent]:
    """The ascents of one group that have enough levels."""
    rows_of: dict[str, list[dict[str, str]]] = {}
    with lzma.open(path, "rt", encoding="ascii") as lines:
        for row in csv.DictReader(lines):
            rows = rows_of.setdefault(row["ascent"], [])
            rows.append(row)
    for name, rows in rows_of.items():
        levels = _levels_of(rows)
        if levels.shape[0] < _LEAST_LEVELS:
            continue
        first = rows[0]
        time = np.datetime64(first["time_utc"].rstrip("Z"), "ns")
        latitude = float(first["latitude_deg"])
        longitude = float(first["longitude_deg"])
        yield Ascent(
            name=name,
            group=path.name.removesuffix(".csv.xz"),
            time_ns=int(time.astype(np.int64)),
            latitude_rad=math.radians(latitude),
            longitude_rad=math.radians(longitude),
            geopotential_m=levels[:, 0],
            pressure_pa=100.0 * levels[:, 1],
            temperature_k=levels[:, 2] + 273.15,
            dew_point_k=levels[:, 3] + 273.15,
        )


def _levels_of(rows: list[dict[str, str]]) -> np.ndarray:
    """`_COLUMNS` of the levels, without those whose height or pressure turns back."""
    texts = [[row[name] or "nan" for name in _COLUMNS] for row in rows]
    levels = np.array(texts).astype(float)
    is_whole = np.isfinite(levels[:, :3]).all(axis=1)
    levels = levels[is_whole]
    levels = levels[_rises(levels[:, 0])]
    return levels[_rises(-levels[:, 1])]


def _rises(values: np.ndarray) -> np.ndarray:
    """Whether each value is above all before it."""
    highest = np.maximum.accumulate(values)
    rises = values[1:] > highest[:-1]
    return np.append(True, rises)
