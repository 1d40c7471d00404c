"""Why a sample of a sensor is not used: one reason for each sample, by the rule that rejects it.

A reason is not replaced by a later rule.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from unbend.units import Integers, Mask

Reasons = NDArray[np.uint8]
"""(n,) the `Reason` of each sample, 0 where it is used."""


class Reason(IntEnum):
    """Why a sample is not used, in the order in which the rules are applied."""

    USED = 0
    NO_VALUE = 1
    OUT_OF_RANGE = 2
    JUMP = 3
    BAROMETER_DRIFT = 4
    NO_HEIGHT = 5
    SUSPECT_HEIGHT = 6
    FUSED_HEIGHT = 7
    GROUND_SOAK = 8
    STUCK = 9
    SENSOR_NOT_USED = 10
    OUTSIDE_CLIMATOLOGY = 11
    OUTLIER = 12
    LEFT_OUT = 13

    @property
    def text(self) -> str:
        """The reason in plain words."""
        return _TEXTS[self]


_TEXTS = {
    Reason.USED: "used",
    Reason.NO_VALUE: "no value",
    Reason.OUT_OF_RANGE: "outside the possible range",
    Reason.JUMP: "jumps faster than the air or a vehicle can change",
    Reason.BAROMETER_DRIFT: "the barometer drifts away from the GNSS height",
    Reason.NO_HEIGHT: "no height at its time",
    Reason.SUSPECT_HEIGHT: "other evidence contradicts its height",
    Reason.FUSED_HEIGHT: "its height follows the barometer",
    Reason.GROUND_SOAK: "on the ground or shortly after take-off",
    Reason.STUCK: "stays the same while the height changes",
    Reason.SENSOR_NOT_USED: "the whole sensor is not used",
    Reason.OUTSIDE_CLIMATOLOGY: "above or below the heights of the climatology",
    Reason.OUTLIER: "far from the other readings at its height",
    Reason.LEFT_OUT: "left out of a comparison",
}


def reasons_where(rejected: Mask, reason: Reason) -> Reasons:
    """An array with one reason where a mask is True, and `Reason.USED` elsewhere.

    >>> reasons_where(np.array([True, False]), Reason.JUMP).tolist()
    [3, 0]
    """
    return np.where(rejected, reason, Reason.USED).astype(np.uint8)


def with_reason(reasons: Reasons, rejected: Mask, reason: Reason) -> Reasons:
    """The reasons, with ``reason`` set where a mask is True and the sample was used so far.

    >>> with_reason(np.array([0, 3, 0], np.uint8), np.array([True, True, False]), Reason.STUCK)
    array([9, 3, 0], dtype=uint8)
    """
    return np.where(rejected & (reasons == Reason.USED), reason, reasons).astype(np.uint8)


def count_by_reason(reasons: Iterable[Reasons]) -> dict[Reason, int]:
    """How many samples are rejected for each reason, over several arrays of reasons.

    >>> count_by_reason([np.array([0, 3, 3], np.uint8)])
    {<Reason.JUMP: 3>: 2}
    """
    total = np.zeros(len(Reason), np.int64)
    for of_samples in reasons:
        total += np.bincount(of_samples, minlength=len(Reason))
    return {reason: int(total[reason]) for reason in list(Reason)[1:] if total[reason]}


def described_counts(counts: Mapping[Reason, int]) -> str:
    """Counts by reason, in words.

    >>> described_counts({Reason.JUMP: 2, Reason.NO_VALUE: 1})
    '2 (jumps faster than the air or a vehicle can change), 1 (no value)'
    """
    return ", ".join(f"{count} ({reason.text})" for reason, count in counts.items())


@dataclass(frozen=True, eq=False)
class RemovedSamples:
    """Samples that were removed from a channel: (r,) times [Unix ns] and reasons."""

    time_ns: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    reason: Reasons = field(default_factory=lambda: np.empty(0, np.uint8))

    def __len__(self) -> int:
        return int(self.time_ns.size)

    def and_also(self, time_ns: Integers, reason: Reasons) -> RemovedSamples:
        """These samples and more, in the order of their times."""
        times = np.append(self.time_ns, time_ns)
        reasons = np.append(self.reason, reason)
        order = np.argsort(times, kind="stable")
        return RemovedSamples(times[order], reasons[order])
