"""What a flight measured of the air, against height, and its robust binning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from unbend.atmosphere.rejection import (
    Reason,
    Reasons,
    RemovedSamples,
    count_by_reason,
    described_counts,
    with_reason,
)
from unbend.units import Array, Integers, Mask, Rows

Record = TypeVar("Record", bound=Any)

BIN_M = 50.0  # thickness of the layers where temperature was measured [m']

_FEWEST_IN_BIN = 3
_VISITED_BIN_M = 100.0  # thickness of the bins of `SensorSamples.middle_of_heights_ns`
_CLIMB_SAMPLE_S = 15.0  # step in time of `SensorSamples.climbed_m`: shorter ones add up noise


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """One sensor's readings against height above sea level; (n,) arrays, in the order of time.

    ``value``: in SI (K, Pa, or relative humidity 0-1). ``rejected``: why a reading is not used, 0
    if it is used; by default all are used. Readings without value or height are rejected here.
    ``removed``: impossible samples of the sensor, which have no row in the arrays.
    """

    time_ns: Integers
    h_m: Array
    value: Array
    rejected: Reasons = field(default_factory=lambda: np.empty(0, np.uint8))
    name: str = ""
    removed: RemovedSamples = field(default_factory=RemovedSamples)

    def __post_init__(self) -> None:
        rejected = self.rejected
        if rejected.size == 0:
            rejected = np.zeros(self.time_ns.shape, np.uint8)
        rejected = with_reason(rejected, ~np.isfinite(self.value), Reason.NO_VALUE)
        rejected = with_reason(rejected, ~np.isfinite(self.h_m), Reason.NO_HEIGHT)
        object.__setattr__(self, "rejected", rejected)

    @property
    def accepted(self) -> Mask:
        """(n,) which readings are used."""
        return np.asarray(self.rejected == Reason.USED)

    def count(self, reason: Reason) -> int:
        """How many readings are rejected for a reason."""
        return int(np.count_nonzero(self.rejected == reason))

    def reject(self, rows: Mask, reason: Reason) -> SensorSamples:
        """The samples with some more readings rejected, where ``rows`` is True, for a reason."""
        return replace(self, rejected=with_reason(self.rejected, rows, reason))

    def used(self) -> tuple[Array, Array]:
        """Heights [m above sea level] and values of the accepted readings."""
        return self.h_m[self.accepted], self.value[self.accepted]

    @property
    def extent_m(self) -> float:
        """Height spanned by the accepted readings [m]."""
        heights = self.h_m[self.accepted]
        if not heights.size:
            return 0.0
        return float(np.ptp(heights))

    @property
    def climbed_m(self) -> float:
        """Sum of all climbs and descents [m], from heights 15 s apart."""
        has_height = np.isfinite(self.h_m)
        if has_height.sum() < 2:
            return 0.0
        nanoseconds = self.time_ns - int(self.time_ns[0])
        seconds = nanoseconds.astype(np.float64) * 1e-9
        times = np.arange(0.0, seconds[-1], _CLIMB_SAMPLE_S)
        h = np.interp(times, seconds[has_height], self.h_m[has_height])
        return float(np.abs(np.diff(h)).sum())

    @property
    def middle_ns(self) -> int | None:
        """Middle of the time from first to last accepted reading [Unix ns]; None without any."""
        used = self.time_ns[self.accepted]
        if not used.size:
            return None
        begin_ns = int(used[0])
        return begin_ns + (int(used[-1]) - begin_ns) // 2

    @property
    def middle_of_heights_ns(self) -> int | None:
        """Mean time at which the heights were visited [Unix ns]: mean over bins of 100 m.

        A climb after an hour of level flight measures the air at the time of the climb, not of half
        an hour before. None without accepted readings.
        """
        used = self.time_ns[self.accepted]
        if used.size == 0:
            return None
        levels = np.floor(self.h_m[self.accepted] / _VISITED_BIN_M)
        _, bin_of = np.unique(levels, return_inverse=True)
        seconds = (used - used[0]) * 1e-9
        mean_s = np.bincount(bin_of, seconds) / np.bincount(bin_of)
        return int(used[0]) + round(float(mean_s.mean()) * 1e9)


@dataclass(frozen=True, eq=False)
class AirSamples:
    """What a flight measured of the air outside; None where it was not measured.

    ``airspeed``: indicated [m/s]. ``takeoff_ns``: times at which the aircraft left the ground
    [Unix ns]; empty if the log begins in the air, None if unknown.
    """

    temperature: SensorSamples | None = None
    pressure: SensorSamples | None = None
    humidity: SensorSamples | None = None
    airspeed: SensorSamples | None = None
    takeoff_ns: Integers | None = None

    @property
    def sensors(self) -> dict[str, SensorSamples]:
        """The sensors of the air that there are, by quantity; without airspeed."""
        by_quantity = {
            "temperature": self.temperature,
            "pressure": self.pressure,
            "humidity": self.humidity,
        }
        return {quantity: sensor for quantity, sensor in by_quantity.items() if sensor is not None}


@dataclass(frozen=True)
class SensorUse:
    """How many samples of a sensor there are, and how many are rejected for each reason."""

    quantity: str
    sensor: str
    samples: int
    rejected: Mapping[Reason, int]

    @property
    def used(self) -> int:
        """How many samples are used."""
        return self.samples - sum(self.rejected.values())

    def sentence(self) -> str:
        """The counts in words.

        >>> SensorUse("temperature", "HYGR[0]", 900, {Reason.NO_VALUE: 2}).sentence()
        'HYGR[0], temperature: 898 of 900 samples used; not used: 2 (no value)'
        """
        sentence = f"{self.sensor}, {self.quantity}: {self.used} of {self.samples} samples used"
        if self.rejected:
            sentence += f"; not used: {described_counts(self.rejected)}"
        return sentence


def sensor_uses(
    samples: AirSamples,
    rejected: Mapping[str, Reasons],
) -> tuple[SensorUse, ...]:
    """The use of each sensor of the air.

    ``rejected``: reasons by quantity, also those of an estimate; they replace those of the samples.
    """
    uses: list[SensorUse] = []
    for quantity, sensor in samples.sensors.items():
        reasons = rejected.get(quantity, sensor.rejected)
        counts = count_by_reason([sensor.removed.reason, reasons])
        total = reasons.size + len(sensor.removed)
        uses.append(SensorUse(quantity, sensor.name, total, counts))
    return tuple(uses)


def part_of(record: Record, rows: Mask | Rows | slice) -> Record:
    """A copy of a dataclass in which each array has only some rows; other fields stay."""
    arrays = {}
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            arrays[name] = value[rows]
    return replace(record, **arrays)


def bin_by_height(
    geopotential: Array,
    samples: SensorSamples,
    width: float,
    value: Array | None = None,
) -> tuple[Array, Array]:
    """Medians of the accepted readings in bins of height; climb and descent have equal weight.

    So the lag of a sensor cancels, which has opposite signs in climb and descent.
    ``geopotential`` (n,): heights of the readings [m']; ``width``: of a bin [m']; ``value`` (n,):
    what is averaged instead of the readings. Returns mean heights [m'] and values of the bins with
    three readings or more, from the ground up.
    """
    seconds = np.asarray((samples.time_ns - samples.time_ns[:1]) * 1e-9, np.float64)
    readings = samples.value if value is None else value
    use = samples.accepted & np.isfinite(readings) & np.isfinite(geopotential)
    is_rising = (climb_of(seconds, geopotential) >= 0.0)[use]
    height = geopotential[use]
    reading = readings[use]
    bin_number = np.floor(height / width).astype(np.int64)
    order = np.argsort(bin_number, kind="stable")
    starts = np.flatnonzero(np.diff(bin_number[order])) + 1  # of all bins but the first
    bins = []
    for rows_of_bin in np.split(order, starts):
        if rows_of_bin.size < _FEWEST_IN_BIN:
            continue
        means = []
        for rows in _climb_and_descent(rows_of_bin, is_rising):
            means.append((height[rows].mean(), np.median(reading[rows])))
        bins.append(np.mean(means, axis=0))
    heights, values = np.array(bins).reshape(-1, 2).T
    return heights, values


def _climb_and_descent(rows: Rows, is_rising: Mask) -> list[Rows]:
    """The rows of a bin in climb and those in descent, without a part of fewer than three.

    All rows together if neither part has three.
    """
    climb = rows[is_rising[rows]]
    descent = rows[~is_rising[rows]]
    parts = [part for part in (climb, descent) if part.size >= _FEWEST_IN_BIN]
    return parts or [rows]


def climb_of(seconds: Array, height: Array) -> Array:
    """(n,) height gained in the ten seconds around each sample; 0 with fewer than two heights.

    ``seconds``, ``height`` (n,): times [s] and heights, NaN where unknown.
    """
    has_height = np.isfinite(height)
    if has_height.sum() < 2:
        return np.zeros(seconds.shape)
    finite_s = seconds[has_height]
    finite_height = height[has_height]
    before = np.interp(seconds - 5.0, finite_s, finite_height)
    after = np.interp(seconds + 5.0, finite_s, finite_height)
    return np.asarray(after - before)
