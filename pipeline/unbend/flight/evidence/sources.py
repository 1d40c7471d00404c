"""Sources of position and height: their places, and steps that no vehicle makes."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.stretches import HEIGHT, POSITION, SECOND
from unbend.flight.interpolation import interpolate
from unbend.geodesy import wrapped
from unbend.units import Array, Mask, Rows

# The largest move between samples that is noise, if velocity and neighbours do not explain it [m].
NOISE_STEP_M = {POSITION: 3.0, HEIGHT: 5.0}
WORST_ACCURACY_M = 5.0  # a reported accuracy (sigma) up to this is useful [m]
SEVERAL_USUAL_ACCURACIES = 3.0  # or up to so many times the median one
SEVERAL = 6.0  # a difference up to so many times the usual one is noise
EARTH_RADIUS_M = 6_371_000.0  # for differences of metres: any radius will do
SOURCE_GAP_S = 2.0  # between samples of a source that is compared

_LONGEST_STEP_S = 10.0  # over a longer interval a vehicle may have gone anywhere
_LIKELY_M_S2 = 4.0  # acceleration of a vehicle; it explains a part of each move
_RETURNS_WITHIN = 0.1  # a source that comes back to within this share of its step has returned
_MOST_STEPS = 1_000  # a source with more of them is noise
_NEIGHBOURS = 3  # speeds before, and as many after, that a median speed is taken of


@dataclass(frozen=True, eq=False)
class SourcePath:
    """One source of positions or heights, with the steps that no vehicle makes.

    stepped_m : (n, 2) north and east, or (n, 1) up [m]: how far the source has stepped away from
        the level to which it returns; 0 where it is not away.
    good : (n,) True where it is not away and reports a useful accuracy.
    part : (n,) number of the part of the flight; a restart begins a part, and so does a step
        without return.
    step_ns : times of all steps.
    lasting_ns : times of the steps without return.
    fastest_m_s : speed of the fastest step; 0 without steps.
    """

    channel: Channel
    stepped_m: Array
    good: Mask
    part: Rows
    step_ns: TimeArray
    lasting_ns: TimeArray
    fastest_m_s: float


def is_receiver(channel: Channel) -> bool:
    """Whether a channel is a GNSS receiver, which gives both positions and heights."""
    return {POSITION, HEIGHT} <= set(channel.roles)


def sigma_column(quantity: str) -> str:
    """The column in which a source reports the accuracy of a quantity."""
    return "sigma_v_m" if quantity == HEIGHT else "sigma_h_m"


def places_of(channel: Channel, quantity: str) -> Array:
    """(n, 2) latitude and unwrapped longitude [rad], or (n, 1) height [m], of a channel.

    The height is that of `Channel.height_column`.
    """
    if quantity == HEIGHT:
        return channel[channel.height_column or "h_msl_m"][:, None]
    latitude = channel["lat_rad"]
    longitude = np.unwrap(channel["lon_rad"])
    return np.stack([latitude, longitude], axis=1)


def moves_of(channel: Channel, quantity: str) -> Array:
    """(n - 1, k) metres from each place of a channel to the next: north and east, or up."""
    places = places_of(channel, quantity)
    changes = np.diff(places, axis=0)
    if quantity == HEIGHT:
        return changes
    return north_east_m(changes, places[1:, 0])


def with_places(channel: Channel, quantity: str) -> Channel:
    """The channel with only the samples that have a position, or a height."""
    if quantity == HEIGHT and channel.height_column is None:
        nowhere = np.zeros(len(channel), np.bool_)
        return channel.rows(nowhere)
    places = places_of(channel, quantity)
    is_known = np.asarray(np.isfinite(places).all(axis=1))
    return channel if is_known.all() else channel.rows(is_known)


def north_east_m(change: Array, lat_rad: Array) -> Array:
    """(n, 2) metres north and east of (n, 2) changes of latitude and longitude [rad]."""
    north = change[:, 0]
    east = wrapped(change[:, 1]) * np.cos(lat_rad)
    return EARTH_RADIUS_M * np.stack([north, east], axis=1)


def velocity_at(channels: Iterable[Channel], quantity: str, time_ns: TimeArray) -> Array:
    """(n, 2) north and east, or (n, 1) up [m/s], at instants by the first channel with velocities.

    NaN where that channel has none, and everywhere if no channel has velocities.
    """
    names: tuple[str, ...] = ("v_north_m_s", "v_east_m_s")
    sign = 1.0
    if quantity == HEIGHT:
        names = ("v_down_m_s",)
        sign = -1.0
    for channel in channels:
        has_velocities = all(name in channel.columns for name in names)
        if has_velocities and len(channel) > 1:
            gap_s = channel.gap_limit_s(SOURCE_GAP_S)
            components = [interpolate(channel, name, time_ns, gap_s) for name in names]
            return np.stack(components, axis=1) * sign
    return np.full((time_ns.size, len(names)), np.nan)


def source_path(
    channel: Channel,
    quantity: str,
    channels: Iterable[Channel],
) -> SourcePath:
    """Find the steps of a source that no vehicle makes.

    The part of a move between two samples that neither a logged velocity nor the speed of
    neighbouring samples explains is a step if it exceeds 3 m (5 m in height) and several times the
    usual part, with what a vehicle may accelerate in the interval added. The velocity is that of
    the first of ``channels`` that has any. Between a step that leaves and the step that returns the
    source is away; a step without return divides it into two parts. A source with more than 1000
    such moves is noise, and has no steps.
    """
    channel = with_places(channel, quantity)
    time_ns = channel.time_ns
    seconds = np.diff(time_ns) * 1e-9
    unexplained_m = _unexplained_moves(channel, quantity, channels)
    size_m = np.linalg.norm(unexplained_m, axis=1)
    usual_m = float(np.percentile(size_m, 95.0))
    noise_m = max(NOISE_STEP_M[quantity], SEVERAL * usual_m)
    limit_m = noise_m + 0.5 * _LIKELY_M_S2 * seconds**2
    before_step = np.flatnonzero(size_m > limit_m)  # the row before each step
    if before_step.size > _MOST_STEPS:
        before_step = before_step[:0]
    fastest_m_s = 0.0
    if before_step.size:
        speed_m_s = size_m[before_step] / seconds[before_step]
        fastest_m_s = float(speed_m_s.max())
    steps = _paired_steps(channel, unexplained_m, before_step, noise_m)
    has_not_stepped = np.asarray(~steps.stepped_m.any(axis=1))
    return SourcePath(
        channel=channel,
        stepped_m=steps.stepped_m,
        good=has_not_stepped & _reports_useful_accuracy(channel, quantity),
        part=steps.part,
        step_ns=time_ns[before_step + 1],
        lasting_ns=time_ns[steps.lasting_rows],
        fastest_m_s=fastest_m_s,
    )


def _reports_useful_accuracy(channel: Channel, quantity: str) -> Mask:
    """(n,) False where a channel reports an accuracy too poor to use; else True."""
    sigma_m = channel.columns.get(sigma_column(quantity))
    if sigma_m is None or not np.isfinite(sigma_m).any():
        return np.ones(len(channel), np.bool_)
    usual_m = float(np.nanmedian(sigma_m))
    limit_m = max(WORST_ACCURACY_M, SEVERAL_USUAL_ACCURACIES * usual_m)
    return np.asarray(~(sigma_m > limit_m))


def _unexplained_moves(
    channel: Channel,
    quantity: str,
    channels: Iterable[Channel],
) -> Array:
    """(n - 1, k) metres of each move to the next sample that velocity or neighbours do not explain.

    Of the two, the one that leaves less unexplained counts; if the velocity is unknown (NaN), the
    speed of the neighbours. 0 over long intervals and restarts.
    """
    seconds = np.diff(channel.time_ns)[:, None] * 1e-9
    speed = moves_of(channel, quantity) / seconds
    beyond_neighbours = speed - _median_of_neighbours(speed)
    velocity = velocity_at(channels, quantity, channel.time_ns)
    mean_velocity = 0.5 * (velocity[1:] + velocity[:-1])
    beyond_velocity = speed - mean_velocity
    size_beyond_velocity = np.linalg.norm(beyond_velocity, axis=1)
    size_beyond_neighbours = np.linalg.norm(beyond_neighbours, axis=1)
    velocity_is_better = (size_beyond_velocity < size_beyond_neighbours)[:, None]
    unexplained_m = seconds * np.where(velocity_is_better, beyond_velocity, beyond_neighbours)
    has_restarted = np.diff(channel.boot) != 0
    is_long = seconds[:, 0] > _LONGEST_STEP_S
    unexplained_m[has_restarted | is_long] = 0.0
    return unexplained_m


def _median_of_neighbours(speed: Array) -> Array:
    """(n, k) running medians of (n, k) speeds: of each one, three before and three after it.

    At the ends the first and the last speed are repeated.
    """
    padding = ((_NEIGHBOURS, _NEIGHBOURS), (0, 0))
    padded_speed = np.pad(speed, padding, mode="edge")
    windows = sliding_window_view(padded_speed, 2 * _NEIGHBOURS + 1, axis=0)
    parted = np.partition(windows, _NEIGHBOURS, axis=-1)
    return np.asarray(parted[..., _NEIGHBOURS])


class _PairedSteps(NamedTuple):
    """The steps of a source, after those that leave are paired with those that return."""

    stepped_m: Array  # (n, k), see `SourcePath`
    part: Rows  # (n,), see `SourcePath`
    lasting_rows: list[int]  # the first row after each step without return


def _paired_steps(
    channel: Channel, unexplained_m: Array, before_step: Rows, noise_m: float
) -> _PairedSteps:
    """Pair the steps of a source that leave its level with those that return to it.

    ``unexplained_m`` (n - 1, k) : of `_unexplained_moves`. ``before_step`` : the row before each
    step. A level is the median sum of all steps so far, between two steps. The base is the level
    to which the source returns: the first one, and later that after a step without return.
    """
    carried_m = _carried_by_steps(channel.time_ns, unexplained_m, before_step)
    after_steps = (before_step + 1).tolist()
    edges = [0, *after_steps, len(channel)]
    levels = []
    for begin, end in pairwise(edges):
        levels.append(np.median(carried_m[begin:end], axis=0))
    stepped_m = np.zeros_like(carried_m)
    part = channel.boot.astype(np.intp)
    lasting_rows: list[int] = []
    base_m = levels[0]
    level = 1
    while level < len(levels):
        step_m = float(np.linalg.norm(levels[level] - base_m))
        if step_m <= noise_m:  # it is at the base
            level += 1
            continue
        begin = edges[level]
        tolerance_m = noise_m + _RETURNS_WITHIN * step_m
        return_level = _return_to(base_m, levels, level, tolerance_m)
        if return_level is None:  # it does not return: this level is the new base
            base_m = levels[level]
            lasting_rows.append(begin)
            part[begin:] += int(part.max()) + 1  # numbers that no part has yet
            level += 1
        else:
            end = edges[return_level]
            stepped_m[begin:end] = carried_m[begin:end] - base_m
            level = return_level
    return _PairedSteps(stepped_m, part, lasting_rows)


def _carried_by_steps(time_ns: TimeArray, unexplained_m: Array, before_step: Rows) -> Array:
    """(n, k) metres: the sum of all steps of a source up to each sample.

    Unexplained moves within a second of a step belong to it, because receivers smooth steps.
    """
    near_step = np.zeros(time_ns.size - 1, np.bool_)
    end_ns = time_ns[1:]  # of each move
    for row in before_step:
        apart_ns = np.abs(end_ns - end_ns[row])
        near_step |= apart_ns <= SECOND
    by_steps_m = np.where(near_step[:, None], unexplained_m, 0.0)
    carried_m = np.zeros((time_ns.size, by_steps_m.shape[1]))
    carried_m[1:] = np.cumsum(by_steps_m, axis=0)
    return carried_m


def _return_to(
    base_m: Array, levels: list[Array], away_level: int, tolerance_m: float
) -> int | None:
    """The number of the first level after ``away_level`` that is near the base; None if none is."""
    for later in range(away_level + 1, len(levels)):
        if np.linalg.norm(levels[later] - base_m) < tolerance_m:
            return later
    return None
