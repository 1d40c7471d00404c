"""The samples before and after an instant, and values interpolated between them, not over gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, TimeArray
from unbend.units import Array, Mask, Rows

# Where an instant is, relative to the samples of a channel.
INSIDE = 0
OUTSIDE_CHANNEL = 1
GAP_IN_CHANNEL = 2


@dataclass(frozen=True, eq=False)
class Bracket:
    """The rows of a channel just before and after (m,) instants; both are that of a sample hit.

    ``fraction`` is 0 at the sample before and 1 at the one after. ``coverage`` is INSIDE,
    OUTSIDE_CHANNEL or GAP_IN_CHANNEL; the other values are of use only where it is INSIDE.
    """

    before: Rows
    after: Rows
    fraction: Array
    coverage: NDArray[np.uint8]

    def rows(self, keep: Mask) -> Bracket:
        """The bracket of only those instants for which ``keep`` (m,) is True."""
        return Bracket(
            before=self.before[keep],
            after=self.after[keep],
            fraction=self.fraction[keep],
            coverage=self.coverage[keep],
        )


def bracket(channel: Channel, time_ns: TimeArray, max_gap_s: float) -> Bracket:
    """The samples of a channel just before and after (m,) instants [ns].

    A gap is an interval longer than ``max_gap_s``, or one in which the vehicle restarted. An
    instant that is exactly the time of a sample is not in a gap.
    """
    stamps = channel.time_ns
    if stamps.size == 0:
        no_rows = np.zeros(time_ns.shape, np.intp)
        return Bracket(
            before=no_rows,
            after=no_rows,
            fraction=np.zeros(time_ns.shape),
            coverage=np.full(time_ns.shape, OUTSIDE_CHANNEL, np.uint8),
        )
    first_not_earlier = np.searchsorted(stamps, time_ns, side="left")
    after = np.clip(first_not_earlier, 0, stamps.size - 1)
    is_hit = stamps[after] == time_ns
    row_before = np.maximum(after - 1, 0)
    before = np.where(is_hit, after, row_before)
    interval_ns = stamps[after] - stamps[before]
    since_before_ns = time_ns - stamps[before]
    fraction = since_before_ns / np.maximum(interval_ns, 1)
    is_long = interval_ns > max_gap_s * 1e9
    has_restarted = channel.boot[after] != channel.boot[before]
    is_gap = is_long | has_restarted
    is_outside = (time_ns < stamps[0]) | (time_ns > stamps[-1])
    coverage = np.full(time_ns.shape, INSIDE, np.uint8)
    coverage[is_gap & ~is_hit] = GAP_IN_CHANNEL
    coverage[is_outside] = OUTSIDE_CHANNEL  # whatever the interval at the end of the channel is
    return Bracket(
        before=before,
        after=after,
        fraction=np.where(is_hit, 0.0, fraction),
        coverage=coverage,
    )


def nearest_rows(time_ns: TimeArray, stamps: TimeArray) -> Rows:
    """(m,) rows of the stamps that are nearest to (m,) instants; of two equally near the later.

    ``stamps``: (n,) times in rising order, n > 0.

    >>> nearest_rows(np.array([1, 8, 30]), np.array([5, 10])).tolist()
    [0, 1, 1]
    """
    last_row = stamps.size - 1
    rows_after = np.searchsorted(stamps, time_ns)
    after = np.minimum(rows_after, last_row)
    before = np.maximum(rows_after - 1, 0)
    to_before = time_ns - stamps[before]
    to_after = stamps[after] - time_ns
    return np.asarray(np.where(to_before < to_after, before, after))


def ns_to_nearest(time_ns: TimeArray, stamps: TimeArray) -> TimeArray:
    """(m,) nanoseconds between instants and their nearest stamps, without sign.

    ``stamps``: (n,) times in rising order, n > 0.

    >>> ns_to_nearest(np.array([1, 8, 30]), np.array([5, 10])).tolist()
    [4, 2, 20]
    """
    rows = nearest_rows(time_ns, stamps)
    apart_ns = time_ns - stamps[rows]
    return np.asarray(np.abs(apart_ns))


def interpolate(channel: Channel, column: str, time_ns: TimeArray, max_gap_s: float) -> Array:
    """(m,) values of a column at instants, linear in time; NaN outside the channel and in gaps.

    All are NaN if the channel does not have the column.
    """
    if column not in channel.columns or len(channel) == 0:
        return np.full(time_ns.shape, np.nan)
    samples = bracket(channel, time_ns, max_gap_s)
    values = channel[column]
    value_before = values[samples.before]
    # At the time of a sample only its own value counts, even if the next one is NaN.
    is_between = samples.fraction > 0.0
    value_after = np.where(is_between, values[samples.after], 0.0)
    from_before = value_before * (1.0 - samples.fraction)
    from_after = value_after * samples.fraction
    is_inside = samples.coverage == INSIDE
    return np.where(is_inside, from_before + from_after, np.nan)
