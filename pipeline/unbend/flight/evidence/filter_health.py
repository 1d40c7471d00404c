"""Evidence of a filter and of second attitudes against a flight, as suspect stretches."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.stretches import (
    ATTITUDE,
    POSITION,
    SECOND,
    Stretch,
    runs,
    stretch_of_run,
)
from unbend.flight.interpolation import interpolate
from unbend.flight.rotations import down_in_body
from unbend.units import MOST_FLAGS, Array, whole_numbers

# Two verticals differ by noise up to this [deg], or up to so many times the 95th percentile.
NOISE_TILT_DEG = 1.5
_SEVERAL_USUAL_TILTS = 3.0
_TURN_NS = SECOND // 10  # by so much, earlier or later, the times of telemetry may be wrong

# A filter has recovered when its innovation ratios have been below this for so long.
SETTLED_RATIO = 0.7
SETTLED_S = 3.0
REJECTED_RATIO = 1.0  # of an innovation to its gate: above, the filter rejects the measurement

# Rejections with a smaller ratio than this do not count if they last for less than this [s].
_LARGE_RATIO = 2.0
_SHORT_S = 0.5
_SHORT_COMPASS_S = 5.0

# Accelerometers that clip more often than this [1/s] make the attitude suspect, until they clip
# less often than half of it; if that takes longer than 2 s.
_CLIPS_PER_SECOND = 100.0
_STILL_CLIPS_PER_SECOND = 50.0
_LONGEST_CLIPPING_NS = 2 * SECOND

_LANE_GAP_S = 2.0  # between samples of another lane of the filter
_ATTITUDE_GAP_S = 1.0  # between samples of an attitude

# Bits of filter_flags, by their meaning.
_FLAGS = {"the filter sees a GPS glitch": 1 << 15, "the filter is dead reckoning": 1 << 18}

# By column of a filter's health: the quantity that a rejection makes suspect, and the reason.
_INNOVATIONS = {
    "innovation_position": (POSITION, "the filter rejected the receiver's position"),
    "innovation_velocity": (ATTITUDE, "the filter rejected the receiver's velocity"),
    "innovation_compass": (ATTITUDE, "the filter rejected the compass"),
}


def filter_evidence(channels: Sequence[Channel]) -> list[Stretch]:
    """The stretches that innovations, flags and accelerometers of a filter make suspect.

    An innovation ratio above 1 is a rejected measurement. Of several lanes (filters that run in
    parallel) the smallest ratio counts, as an autopilot flies by the best lane.
    """
    suspect: list[Stretch] = []
    for column in _INNOVATIONS:
        lanes = [channel for channel in channels if column in channel.columns]
        if lanes:
            suspect += _rejected_measurements(column, lanes)
    for channel in channels:
        if "filter_flags" in channel.columns:
            suspect += _flagged(channel)
        if "clipping" in channel.columns and len(channel) > 1:
            suspect += _clipping(channel)
    return suspect


def _rejected_measurements(column: str, lanes: list[Channel]) -> list[Stretch]:
    """The stretches in which all lanes of a filter reject a measurement.

    ``column`` : that of the innovation. A stretch lasts until the ratio has settled. It does not
    count if the ratio stays below 2 and it lasts for less than 0.5 s (compass: 5 s). A rejected
    velocity makes the position suspect, too.
    """
    quantity, reason = _INNOVATIONS[column]
    shortest_s = _SHORT_COMPASS_S if column == "innovation_compass" else _SHORT_S
    time_ns = lanes[0].time_ns
    ratio = lanes[0][column]
    for lane in lanes[1:]:
        lane_ratio = interpolate(
            lane,
            column,
            time_ns,
            lane.gap_limit_s(_LANE_GAP_S),
        )
        ratio = np.fmin(ratio, lane_ratio)
    suspect: list[Stretch] = []
    for run in runs(time_ns, ratio > SETTLED_RATIO, ratio > REJECTED_RATIO, SETTLED_S):
        lasts_s = (time_ns[run.last] - time_ns[run.first]) * 1e-9
        worst = float(np.nanmax(ratio[run.rows]))
        if worst < _LARGE_RATIO and lasts_s < shortest_s:
            continue
        reason_with_ratio = f"{reason} (innovation ratio {worst:.3g})"
        stretch = stretch_of_run(time_ns, run, quantity, reason_with_ratio)
        suspect.append(stretch)
        if column == "innovation_velocity":
            suspect.append(replace(stretch, quantity=POSITION))
    return suspect


def _flagged(channel: Channel) -> list[Stretch]:
    """The stretches in which a filter's flags (`_FLAGS`) make its position suspect."""
    flags = whole_numbers(channel["filter_flags"], 0, MOST_FLAGS)
    suspect: list[Stretch] = []
    for reason, bit in _FLAGS.items():
        is_set = flags & bit > 0
        for run in runs(channel.time_ns, is_set, is_set, SETTLED_S):
            suspect.append(stretch_of_run(channel.time_ns, run, POSITION, reason))
    return suspect


def _clipping(channel: Channel) -> list[Stretch]:
    """The stretches in which accelerometers clip for more than 2 s: the attitude is suspect."""
    time_ns = channel.time_ns
    clips_per_second = np.diff(channel["clipping"]) / np.diff(time_ns) * SECOND
    rate = np.append(0.0, clips_per_second)
    suspect: list[Stretch] = []
    for run in runs(time_ns, rate > _STILL_CLIPS_PER_SECOND, rate > _CLIPS_PER_SECOND):
        if time_ns[run.last] - time_ns[run.first] > _LONGEST_CLIPPING_NS:
            reason = f"the accelerometers clip {rate[run.rows].max():.0f} times a second"
            suspect.append(stretch_of_run(time_ns, run, ATTITUDE, reason))
    return suspect


def attitude_evidence(attitude: Channel, channels: Sequence[Channel]) -> list[Stretch]:
    """The stretches in which the vertical of an attitude departs from that of another attitude.

    The angle between both, minus the turn of the aircraft in 0.2 s (times of telemetry are no
    better), must exceed a limit of noise in two samples or more. A stretch begins and ends where
    the angle exceeds half of the limit.
    """
    suspect: list[Stretch] = []
    vertical = _vertical(attitude)
    for other in channels:
        if other.name == attitude.name or ATTITUDE not in other.roles or len(other) < 2:
            continue
        time_ns = other.time_ns
        other_down = _down_at(_vertical(other), time_ns)
        apart_deg = _angle_deg(_down_at(vertical, time_ns), other_down)
        tilt_deg = apart_deg - _turned_deg(vertical, time_ns)
        if not np.isfinite(tilt_deg).any():
            continue
        usual_deg = float(np.nanpercentile(tilt_deg, 95.0))
        limit_deg = max(NOISE_TILT_DEG, _SEVERAL_USUAL_TILTS * usual_deg)
        for run in runs(time_ns, tilt_deg > 0.5 * limit_deg, tilt_deg > limit_deg):
            if np.count_nonzero(tilt_deg[run.rows] > limit_deg) > 1:
                worst_deg = float(np.nanmax(apart_deg[run.rows]))
                reason = f"{attitude.name} and {other.name} are {worst_deg:.1f} deg apart"
                suspect.append(stretch_of_run(time_ns, run, ATTITUDE, reason))
    return suspect


def _turned_deg(vertical: Channel, time_ns: TimeArray) -> Array:
    """(n,) angles [deg] by which a vertical turns within 0.2 s about instants; 0 where unknown."""
    later = _down_at(vertical, time_ns + _TURN_NS)
    earlier = _down_at(vertical, time_ns - _TURN_NS)
    return np.asarray(np.nan_to_num(_angle_deg(later, earlier)))


def _vertical(attitude: Channel) -> Channel:
    """The channel with the unit vector to the nadir in body axes as its columns x, y, z."""
    columns = dict(zip("xyz", down_in_body(attitude), strict=True))
    return replace(attitude, columns=columns, labels={})


def _down_at(vertical: Channel, time_ns: TimeArray) -> Array:
    """(3, n) directions to the nadir in body axes at instants; ``vertical`` is from `_vertical`."""
    gap_s = vertical.gap_limit_s(_ATTITUDE_GAP_S)
    return np.stack([interpolate(vertical, axis, time_ns, gap_s) for axis in "xyz"])


def _angle_deg(first: Array, second: Array) -> Array:
    """(n,) angles [deg] between (3, n) unit vectors."""
    half_chord = 0.5 * np.linalg.norm(first - second, axis=0)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.clip(half_chord, 0.0, 1.0))))
