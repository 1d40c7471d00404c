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

_STEP_M = 10.0
_LEAST_LEVELS = 5
_DRIEST_K = 190.0  # dew points below are no measurements
_BLOCK_DAYS = 10  # days of one station that are fitted, or judged, together
_EARTH_KM = 6371.0


@dataclass(frozen=True, eq=False)
class Ascent:
    """Levels (n,) of one ascent from the ground up: geopotential height [m'], Pa, K, dew point."""

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
        """Heights above sea level [m]: 3.086e-6 1/s2 is the fall of gravity with height."""
        gravity = normal_gravity(self.latitude_rad, 0.0)
        first = self.geopotential_m * 9.80665 / gravity
        return first * (1.0 + 0.5 * 3.086e-6 / gravity * first)

    @property
    def solar_hour(self) -> float:
        """Mean local time [h]."""
        return (self.time_ns / 3.6e12 + math.degrees(self.longitude_rad) / 15.0) % 24.0

    @property
    def month(self) -> float:
        """1.0 is 15 January."""
        day = np.datetime64(self.time_ns, "ns").astype("datetime64[D]")
        return (float((day - day.astype("datetime64[Y]")).astype(float)) - 14.0) / 30.4375 + 1.0

    @property
    def vapour_pressure_pa(self) -> np.ndarray:
        """At the levels; dew points between known ones are filled in."""
        known = np.isfinite(self.dew_point_k)
        if not known.any():
            return np.full(self.h_m.size, 1e-3)
        dew = np.interp(self.geopotential_m, self.geopotential_m[known], self.dew_point_k[known])
        return saturation_pressure_pa(np.maximum(dew, _DRIEST_K))

    def km_from(self, other: Ascent) -> float:
        """Great-circle distance."""
        north = 0.5 * (self.latitude_rad - other.latitude_rad)
        east = 0.5 * (self.longitude_rad - other.longitude_rad)
        squeezed = math.cos(self.latitude_rad) * math.cos(other.latitude_rad)
        chord = math.sin(north) ** 2 + squeezed * math.sin(east) ** 2
        return 2.0 * _EARTH_KM * math.asin(math.sqrt(chord))

    @property
    def half(self) -> int:
        """0 or 1, by blocks of days and by place: one half is fitted, the other judges."""
        days = self.time_ns // (86_400 * 10**9)
        block = days // _BLOCK_DAYS
        place = round(math.degrees(self.latitude_rad) * 20) + round(
            math.degrees(self.longitude_rad) * 20
        )
        return int((block + place) % 2)

    def mean_gradient(self, climb_m: float, air=None) -> float:
        """R / tan(zeta) in the plane from a camera so high above the lowest level to that level:
        the mean of N - N_c (Gyer 1996, Eq. 24); of another ``air`` over the same heights."""
        h = self.h_m[0] + np.arange(0.0, climb_m + 0.5 * _STEP_M, _STEP_M)
        refractivity = self._refractivity(h) if air is None else air.refractivity(h)
        return float(trapezoid(refractivity - refractivity[-1], dx=_STEP_M) / climb_m)

    def error(self, air, climb_m: float) -> float:
        """Relative error of R with another air."""
        return self.mean_gradient(climb_m, air) / self.mean_gradient(climb_m) - 1.0

    def reaches(self, climb_m: float) -> bool:
        """Whether its levels go as high as a camera so high above its lowest one."""
        return bool(self.h_m[-1] >= self.h_m[0] + climb_m)

    def _refractivity(self, h: np.ndarray) -> np.ndarray:
        t = np.interp(h, self.h_m, self.temperature_k)
        e = np.exp(np.interp(h, self.h_m, np.log(self.vapour_pressure_pa)))
        gravity = normal_gravity(self.latitude_rad, 0.0) - 3.086e-6 * h
        p = np.full(h.size, self.pressure_pa[0])
        for _ in range(3):  # the vapour's share of the weight settles against pressure
            virtual = t / (1.0 - 0.378 * e / p)
            fall = cumulative_trapezoid(gravity * 28.9644 / 8314.32 / virtual, h, initial=0.0)
            p = self.pressure_pa[0] * np.exp(-fall)
        return edlen_index(p, t, e) - 1.0


def read_ascents(folder: Path = FOLDER) -> list[Ascent]:
    """All ascents of the files of a folder."""
    return [ascent for path in sorted(folder.glob("*.csv.xz")) for ascent in _of_file(path)]


def _of_file(path: Path) -> Iterator[Ascent]:
    """The ascents of one group; levels whose height or pressure turns back are left out."""
    rows_of: dict[str, list[dict[str, str]]] = {}
    with lzma.open(path, "rt", encoding="ascii") as lines:
        for row in csv.DictReader(lines):
            rows_of.setdefault(row["ascent"], []).append(row)
    names = ("geopotential_m", "pressure_hpa", "temperature_c", "dew_point_c")
    for name, rows in rows_of.items():
        levels = np.array([[float(row[key] or "nan") for key in names] for row in rows])
        levels = levels[np.isfinite(levels[:, :3]).all(axis=1)]
        for column, sign in ((0, 1.0), (1, -1.0)):
            value = sign * levels[:, column]
            rising = value[1:] > np.maximum.accumulate(value)[:-1]
            levels = levels[np.concatenate([[True], rising])]
        if levels.shape[0] < _LEAST_LEVELS:
            continue
        height, hpa, celsius, dew = levels.T
        time = np.datetime64(rows[0]["time_utc"].rstrip("Z"), "ns")
        yield Ascent(
            name=name,
            group=path.name.removesuffix(".csv.xz"),
            time_ns=int(time.astype(np.int64)),
            latitude_rad=math.radians(float(rows[0]["latitude_deg"])),
            longitude_rad=math.radians(float(rows[0]["longitude_deg"])),
            geopotential_m=height,
            pressure_pa=100.0 * hpa,
            temperature_k=celsius + 273.15,
            dew_point_k=dew + 273.15,
        )
