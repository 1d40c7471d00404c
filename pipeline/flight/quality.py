"""Readings that cannot be true, and units that look wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.flight.channels import ROLE_COLUMNS, Array, Channel
from pipeline.flight.clock import STRAY_ROWS
from pipeline.ledger import Ledger

Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]
Apart = Callable[[Channel, Rows, Rows], Array]
"""How far the samples of some rows are from those of others."""

RANGES: Mapping[str, tuple[float, float]] = {
    "lat_rad": (-np.pi / 2.0, np.pi / 2.0),
    "lon_rad": (-2.0 * np.pi, 2.0 * np.pi),
    "h_msl_m": (-600.0, 60_000.0),
    "h_ellipsoid_m": (-700.0, 60_000.0),
    "pressure_pa": (20.0, 120_000.0),
    "temperature_k": (170.0, 340.0),
    "relative_humidity": (-0.05, 1.15),
    "airspeed_m_s": (-5.0, 700.0),
}
"""What can be true of the air and the aircraft, in SI."""

FASTEST_CLIMB_M_S = 200.0
"""No survey aircraft climbs or sinks faster [m/s]."""

FASTEST_M_S = 700.0
"""No aircraft that takes pictures flies faster over the ground [m/s]."""

FASTEST_TURN_RAD_S = np.radians(500.0)
"""No aircraft turns faster [rad/s] and, within few samples, back; a flip goes on."""

# What changes no faster: column -> (rate [1/s], step that is noise whatever the interval).
# 2,500 Pa/s is a climb of 200 m/s at sea level.
_FASTEST: Mapping[str, tuple[float, float]] = {
    "pressure_pa": (2_500.0, 100.0),
    "temperature_k": (20.0, 5.0),
    "h_msl_m": (FASTEST_CLIMB_M_S, 20.0),
    "h_ellipsoid_m": (FASTEST_CLIMB_M_S, 20.0),
}
_HEIGHTS = ("h_msl_m", "h_ellipsoid_m")
_PLACE_NOISE_M, _TURN_NOISE_RAD = 100.0, float(np.radians(20.0))
_METRES_PER_RAD = 6_371_000.0  # a jump of 100 m is told from none: any radius will do

_BLOCK = 1 << 16  # steps that are looked at together: a long channel is not copied
_MOST_STRETCHES = 20_000  # a series that jumps more often than this has no glitches, it is noise

# Medians that give a wrong unit away: column -> (low, high, the unit it looks like).
_DISGUISES: Mapping[str, tuple[float, float, str]] = {
    "pressure_pa": (100.0, 1_200.0, "hPa"),
    "temperature_k": (-90.0, 60.0, "degC"),
    "relative_humidity": (1.2, 100.0, "percent"),
}


def plausible_samples(channel: Channel, role: str, ledger: Ledger) -> Channel:
    """The channel without the samples that are missing or cannot be true in its role's columns.

    Out of range, or there and back faster than air or aircraft can change: each is counted in
    the ledger. Refuses a channel whose median gives away a wrong unit (hPa where Pa is due).
    """
    if role in ("position", "height"):
        channel = _without_wild_heights(channel, ledger)
    keep = np.ones(len(channel), dtype=bool)
    for column in ROLE_COLUMNS[role]:
        values = channel[column]
        finite = np.isfinite(values)
        if column in _DISGUISES and finite.any():
            _refuse_disguise(channel, role, column, float(np.median(values[finite])))
        if not bool(finite.all()):
            _report_range(channel, column, ~finite, "not a number", ledger)
        outside = _outside(values, column)
        if outside.any():
            _report_range(channel, column, outside, _limits(column), ledger)
        keep &= finite & ~outside
    keep[_jumps(channel, keep, role, ledger)] = False
    return channel if bool(keep.all()) else subset(channel, keep)


def mask_impossible_values(channel: Channel, ledger: Ledger) -> Channel:
    """The channel of a log without the values that cannot be true; they are in the ledger.

    As `plausible_samples`, before a role is given to it: a wrong value becomes unknown (NaN), and
    its row goes where nothing is left that a role could use. A column whose median is impossible is
    kept, with a warning: it has another unit, or is not of air. Of events only ranges are checked.
    """
    channel = _without_wild_heights(channel, ledger)
    columns, wrong = dict(channel.columns), np.zeros(len(channel), np.bool_)
    odd = set()
    for column in [name for name in RANGES if name in columns and name not in _HEIGHTS]:
        outside = _outside(columns[column], column)
        if not outside.any():
            continue
        if _is_odd(channel, column, ledger):
            odd.add(column)
            continue
        _report_range(channel, column, outside, _limits(column), ledger)
        columns[column] = np.where(outside, np.nan, columns[column])
        wrong |= outside
    channel = replace(channel, columns=columns)
    if "events" in channel.roles:
        return channel
    roles = [role for role in _FLAGGED_AS if channel.fits_role(role)]
    for role in [role for role in roles if not odd & {*ROLE_COLUMNS[role]}]:
        jump = _jumps(channel, _known(channel, role), role, ledger)
        for column in ROLE_COLUMNS[role] if jump.size else ():
            columns[column] = columns[column].copy()
            columns[column][jump] = np.nan
        wrong[jump] = True
    if not wrong.any() or not roles:
        return channel
    for role in roles:
        wrong &= ~_known(channel, role)
    return subset(channel, ~wrong) if wrong.any() else channel


_FLAGGED_AS = ("position", "attitude", "pressure", "temperature", "humidity", "airspeed")


def _known(channel: Channel, role: str) -> Mask:
    """The rows in which all columns of a role are known."""
    known = np.ones(len(channel), np.bool_)
    for column in ROLE_COLUMNS[role]:
        known &= np.isfinite(channel[column])
    return known


def _outside(values: Array, column: str) -> Mask:
    """Where values are out of their range."""
    low, high = RANGES.get(column, (-np.inf, np.inf))
    with np.errstate(invalid="ignore"):
        if values.size and np.fmin.reduce(values) >= low and np.fmax.reduce(values) <= high:
            return np.zeros(values.shape, np.bool_)
        return np.asarray((values < low) | (values > high), np.bool_)


def _limits(column: str) -> str:
    low, high = RANGES[column]
    return f"outside {low:g} to {high:g}"


def _report_range(channel: Channel, column: str, bad: Mask, what: str, ledger: Ledger) -> None:
    count = int(np.count_nonzero(bad))
    ledger.loss(
        "SENSOR-RANGE",
        f"{count} of {len(channel)} samples of {column} are {what} and are not used",
        where=channel.name,
        count=count,
    )


def _is_odd(channel: Channel, column: str, ledger: Ledger) -> bool:
    """Whether a column as a whole is not what it is called; a warning says so."""
    low, high = RANGES[column]
    median = float(np.nanmedian(channel[column]))
    if low <= median <= high:
        return False
    ledger.warning(
        "SENSOR-ODD",
        f"the median of {column} is {median:.4g}, {_limits(column)}: it has another unit, or is "
        "not of air or aircraft; nothing of it is checked",
        where=channel.name,
        count=len(channel),
    )
    return True


def _jumps(channel: Channel, known: Mask, role: str, ledger: Ledger) -> Rows:
    """Few samples in a row that a role's columns cannot reach from those around them."""
    found = [
        _glitches(channel, known, apart, rate, noise, f"{channel.name}, as {role}", ledger)
        for apart, rate, noise in _distances(role)
    ]
    jump = np.unique(np.concatenate(found)) if found else np.empty(0, np.intp)
    if jump.size:
        time_s = (channel.time_ns[jump[0]] - channel.time_ns[0]) * 1e-9
        ledger.loss(
            "SENSOR-JUMP",
            f"{jump.size} of {len(channel)} samples jump faster than a vehicle or the air can "
            f"change, the first {time_s:.3f} s after the first sample; not used",
            where=f"{channel.name}, as {role}",
            count=int(jump.size),
        )
    return jump


def _distances(role: str) -> Iterator[tuple[Apart, float, float]]:
    """How far samples are from each other, the fastest rate of that, and what is noise."""
    if role in ("position", "height"):
        yield _metres, FASTEST_M_S, _PLACE_NOISE_M
    elif role == "attitude":
        yield _angle, float(FASTEST_TURN_RAD_S), _TURN_NOISE_RAD
    for column in ROLE_COLUMNS[role]:
        if column in _FASTEST:
            yield partial(_difference, column), *_FASTEST[column]


def _metres(channel: Channel, i: Rows, j: Rows) -> Array:
    """Horizontal distance [m], good enough to tell a jump."""
    lat, lon = channel["lat_rad"], channel["lon_rad"]
    east = (lon[j] - lon[i] + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(_METRES_PER_RAD * np.hypot(lat[j] - lat[i], east * np.cos(lat[i])))


def _angle(channel: Channel, i: Rows, j: Rows) -> Array:
    """The angle between attitudes [rad]; 0 where it is less than what is noise."""
    cosine = np.abs(sum(channel[name][i] * channel[name][j] for name in ROLE_COLUMNS["attitude"]))
    angle = np.zeros(cosine.shape)
    wide = cosine < np.cos(_TURN_NOISE_RAD / 2.0)
    angle[wide] = 2.0 * np.arccos(cosine[wide])
    return angle


def _difference(column: str, channel: Channel, i: Rows, j: Rows) -> Array:
    return np.abs(channel[column][j] - channel[column][i])


def _glitches(
    channel: Channel, known: Mask, apart: Apart, rate: float, noise: float, where: str,
    ledger: Ledger,
) -> Rows:  # fmt: skip
    """Rows that neither side reaches at a rate, up to `STRAY_ROWS` of them in a row."""
    rows = np.flatnonzero(known)

    def far(i: Rows, j: Rows) -> Mask:
        limit = np.maximum(rate * 1e-9 * (channel.time_ns[j] - channel.time_ns[i]), noise)
        return np.asarray(apart(channel, i, j) > limit, np.bool_)

    edges = [np.zeros(1, np.intp)]
    for begin in range(0, rows.size - 1, _BLOCK):
        part = rows[begin : begin + _BLOCK + 1]
        edges.append(np.flatnonzero(far(part[:-1], part[1:])) + begin + 1)
    first = np.concatenate(edges)
    if rows.size < 3 or first.size == 1:
        return rows[:0]
    if first.size > _MOST_STRETCHES:
        ledger.warning(
            "SENSOR-NOISE",
            f"{first.size - 1} of {rows.size} samples are farther from the one before than a "
            "vehicle or the air can change: which of them are wrong is not to be told",
            where=where,
            count=int(first.size - 1),
        )
        return rows[:0]
    length = np.diff(np.append(first, rows.size))
    stray = _unreached(rows[first], rows[first + length - 1], length, far)
    return np.asarray(rows[np.repeat(stray, length)], np.intp)


def _unreached(first: Rows, last: Rows, length: Rows, far: Callable[[Rows, Rows], Mask]) -> Mask:
    """Stretches that are not reached from the longest on, one believed stretch to the next.

    A long one is believed wherever it is: a sensor that is set anew, or the other side of a gap.
    """
    stray = np.zeros(first.shape, np.bool_)
    longest = int(np.argmax(length))
    before = after = longest
    for k in range(longest + 1, first.size):
        stray[k] = length[k] <= STRAY_ROWS and far(last[before : before + 1], first[k : k + 1])[0]
        before = before if stray[k] else k
    for k in range(longest - 1, -1, -1):
        stray[k] = length[k] <= STRAY_ROWS and far(last[k : k + 1], first[after : after + 1])[0]
        after = after if stray[k] else k
    return stray


def _without_wild_heights(channel: Channel, ledger: Ledger) -> Channel:
    """The channel with impossible heights unknown: out of range, or a jump there and back.

    The row keeps its latitude and longitude.
    """
    columns = dict(channel.columns)
    for column in [name for name in _HEIGHTS if name in columns]:
        height = columns[column]
        wild = _outside(height, column)
        if "lat_rad" in columns:
            known = np.isfinite(height) & ~wild
            apart, limits = partial(_difference, column), _FASTEST[column]
            wild[_glitches(channel, known, apart, *limits, channel.name, ledger)] = True
        if bool(wild.any()):
            first = int(np.flatnonzero(wild)[0])
            ledger.loss(
                "SENSOR-RANGE",
                f"{int(wild.sum())} of {len(channel)} values of {column} are impossible or jump "
                f"there and back, the first {height[first]:.0f} m in row {first}; not used",
                where=channel.name,
                count=int(wild.sum()),
            )
            columns[column] = np.where(wild, np.nan, height)
    return replace(channel, columns=columns)


def _refuse_disguise(channel: Channel, role: str, column: str, median: float) -> None:
    low, high, unit = _DISGUISES[column]
    if low <= median <= high:
        raise MissionError(
            "CHANNEL-UNIT",
            f"the median of {column} is {median:.4g}: that looks like {unit}",
            where=f"channel {channel.name}, role {role}",
            remedy=f"say so in the mission file: log.channels.{role}: "
            f"{{name: {channel.name}, unit: {unit}}}",
        )


def subset(channel: Channel, keep: Mask) -> Channel:
    """The samples of a channel that a mask keeps."""
    return replace(
        channel,
        time_ns=channel.time_ns[keep],
        boot=channel.boot[keep],
        columns={name: values[keep] for name, values in channel.columns.items()},
        labels={
            name: tuple(np.array(values, dtype=object)[keep])
            for name, values in channel.labels.items()
        },
    )
