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


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """One sensor's readings against height above sea level; (n,) arrays.

    ``value`` in SI (K, Pa, or relative humidity 0-1). ``rejected`` says why a reading is not used,
    0 where it is, as all are by default; one without value or height is rejected here. Those that
    are not used are shown. ``removed`` are impossible samples of the sensor, which have no row.
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
        """How many readings have a reason."""
        return int(np.count_nonzero(self.rejected == reason))

    def reject(self, rows: Mask, reason: Reason) -> SensorSamples:
        """The same without some readings, for a reason."""
        return replace(self, rejected=with_reason(self.rejected, rows, reason))

    def used(self) -> tuple[Array, Array]:
        """Heights and values that were accepted."""
        return self.h_m[self.accepted], self.value[self.accepted]

    @property
    def extent_m(self) -> float:
        """Height spanned by the accepted readings [m]."""
        heights = self.h_m[self.accepted]
        if not heights.size:
            return 0.0
        return float(np.ptp(heights))

    @property
    def middle_ns(self) -> int | None:
        """Middle of the time that the accepted readings span [Unix ns]."""
        used = self.time_ns[self.accepted]
        if not used.size:
            return None
        begin_ns = int(used[0])
        return begin_ns + (int(used[-1]) - begin_ns) // 2

    @property
    def middle_of_heights_ns(self) -> int | None:
        """When the heights were visited [Unix ns]: each bin of 100 m has the same weight.

        A climb at the end of an hour of level flight measures the air of that time, not of half an
        hour before.
        """
        used = self.time_ns[self.accepted]
        if used.size == 0:
            return None
        _, number = np.unique(np.floor(self.h_m[self.accepted] / 100.0), return_inverse=True)
        mean = np.bincount(number, (used - used[0]) * 1e-9) / np.bincount(number)
        return int(used[0]) + round(float(mean.mean()) * 1e9)


@dataclass(frozen=True, eq=False)
class AirSamples:
    """What a flight measured of the air outside; ``airspeed`` is indicated [m/s]; ``takeoff_ns``
    the times [Unix ns] at which the aircraft left the ground. None where not known."""

    temperature: SensorSamples | None = None
    pressure: SensorSamples | None = None
    humidity: SensorSamples | None = None
    airspeed: SensorSamples | None = None
    takeoff_ns: Integers | None = None

    @property
    def sensors(self) -> dict[str, SensorSamples]:
        """Those of the air that there are, by their quantity."""
        every = {"temperature": self.temperature, "pressure": self.pressure}
        every["humidity"] = self.humidity
        return {name: sensor for name, sensor in every.items() if sensor is not None}


@dataclass(frozen=True)
class SensorUse:
    """How many samples of a sensor are used, and of the others why they are not."""

    quantity: str
    sensor: str
    samples: int
    rejected: Mapping[Reason, int]

    @property
    def used(self) -> int:
        """How many samples are used."""
        return self.samples - sum(self.rejected.values())

    def sentence(self) -> str:
        """For a person.

        >>> SensorUse("temperature", "HYGR[0]", 900, {Reason.NO_VALUE: 2}).sentence()
        'HYGR[0], temperature: 898 of 900 samples used; not used: 2 (no value)'
        """
        sentence = f"{self.sensor}, {self.quantity}: {self.used} of {self.samples} samples used"
        if self.rejected:
            sentence += f"; not used: {described_counts(self.rejected)}"
        return sentence


def sensor_uses(samples: AirSamples, rejected: Mapping[str, Reasons]) -> tuple[SensorUse, ...]:
    """The use of each sensor outside; ``rejected`` by quantity, where an estimate says more."""
    uses: list[SensorUse] = []
    for quantity, sensor in samples.sensors.items():
        reasons = rejected.get(quantity, sensor.rejected)
        counts = count_by_reason([sensor.removed.reason, reasons])
        total = reasons.size + len(sensor.removed)
        uses.append(SensorUse(quantity, sensor.name, total, counts))
    return tuple(uses)


def part_of(record: Record, rows: Mask | Rows | slice) -> Record:
    """The same with some rows of all its arrays."""
    arrays = {}
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            arrays[name] = value[rows]
    return replace(record, **arrays)


def bin_by_height(
    geopotential: Array, samples: SensorSamples, width: float, value: Array | None = None
) -> tuple[Array, Array]:
    """Medians of the accepted readings in bins of height, climb and descent weighing alike.

    The lag of a sensor has opposite signs there. ``value`` replaces the readings themselves.
    Returns mean heights [m'] and values of bins with three readings or more, from the ground up.
    """
    seconds = np.asarray((samples.time_ns - samples.time_ns[:1]) * 1e-9, np.float64)
    rising = climb_of(seconds, geopotential) >= 0.0
    reading = samples.value if value is None else value
    use = samples.accepted & np.isfinite(reading) & np.isfinite(geopotential)
    height, reading, rising = geopotential[use], reading[use], rising[use]
    number = np.floor(height / width).astype(np.int64)
    order = np.argsort(number, kind="stable")
    bins = []
    for inside in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        if inside.size < _FEWEST_IN_BIN:
            continue
        both = [inside[rising[inside]], inside[~rising[inside]]]
        parts = [rows for rows in both if rows.size >= _FEWEST_IN_BIN] or [inside]
        means = [(height[rows].mean(), np.median(reading[rows])) for rows in parts]
        bins.append(np.mean(means, axis=0))
    heights, values = np.array(bins).reshape(-1, 2).T
    return heights, values


def climb_of(seconds: Array, height: Array) -> Array:
    """Height gained in the ten seconds around each sample, none where fewer than two are known."""
    known = np.isfinite(height)
    if known.sum() < 2:
        return np.zeros(seconds.shape)
    before = np.interp(seconds - 5.0, seconds[known], height[known])
    after = np.interp(seconds + 5.0, seconds[known], height[known])
    return np.asarray(after - before)
