"""Readings that cannot be true, and units that are probably wrong."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.clock import STRAY_ROWS
from unbend.geodesy import wrapped
from unbend.messages import Entry, Notes, loss, note, warning
from unbend.units import Array, Mask, Rows

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

FASTEST_CLIMB_M_S = 200.0  # no survey aircraft climbs or sinks faster [m/s]
FASTEST_M_S = 700.0  # no aircraft that takes pictures flies faster over the ground [m/s]
# No aircraft turns faster [rad/s] and, within few samples, back; a flip goes on.
FASTEST_TURN_RAD_S = np.radians(500.0)

_HEIGHTS = ("h_msl_m", "h_ellipsoid_m")
_METRES_PER_RAD = 6_371_000.0  # only to notice jumps of 100 m: any radius will do
_TURN_NOISE_RAD = float(np.radians(20.0))

_BLOCK = 1 << 16  # steps that are compared together: a long channel is not copied
_MOST_STRETCHES = 20_000  # a series that jumps more often than this has no glitches, it is noise

# Medians that show a wrong unit: column -> (low, high, the unit it looks like).
_WRONG_UNITS: Mapping[str, tuple[tuple[float, float, str], ...]] = {
    "pressure_pa": ((100.0, 1_200.0, "hPa"), (1.2e6, 1.2e7, "Pa")),
    "temperature_k": ((-90.0, 60.0, "degC"),),
    "relative_humidity": ((1.2, 100.0, "percent"),),
}

# Roles for which jumps are searched before a role is given to a channel.
_ROLES_WITH_JUMPS = ("position", "attitude", "pressure", "temperature", "humidity", "airspeed")


class _Distance(NamedTuple):
    """How far samples of two sets of rows are apart, and what is no jump."""

    between: Callable[[Channel, Rows, Rows], Array]
    rate: float  # per second
    noise: float  # whatever the interval


def plausible_samples(channel: Channel, role: str) -> tuple[Channel, Notes]:
    """The channel without the samples that are missing or impossible in the columns of its role.

    Impossible is a value out of range, or one that is reached and left faster than air or aircraft
    can change; the notes count those that `mask_impossible_values` has not. Refuses a channel whose
    median shows a wrong unit (hPa where Pa is due).
    """
    notes: list[Entry] = []
    if role in ("position", "height"):
        channel, wild = _mask_heights(channel)
        notes += wild
    keep = np.ones(len(channel), dtype=bool)
    for column in ROLE_COLUMNS[role]:
        values = channel[column]
        finite = np.isfinite(values)
        median = float(np.median(values[finite])) if finite.any() else np.nan
        for low, high, unit in _WRONG_UNITS.get(column, ()):
            if low <= median <= high:
                raise MissionError.of(
                    "CHANNEL-UNIT", f"channel {channel.name}, role {role}", median=median,
                    unit=unit, role=role, column=column, name=channel.name,
                )  # fmt: skip
        missing = int(np.count_nonzero(~finite)) - channel.masked.get(column, 0)
        if missing > 0:
            notes.append(_range_loss(channel, column, missing, "not a number"))
        outside = _outside(values, column)
        if count := int(np.count_nonzero(outside)):
            notes.append(_range_loss(channel, column, count, _limits(column)))
        keep &= finite & ~outside
    jumps, reported = _jumps(channel, keep, role)
    keep[jumps] = False
    return channel if bool(keep.all()) else subset(channel, keep), (*notes, *reported)


def mask_impossible_values(channel: Channel) -> tuple[Channel, Notes]:
    """The channel of a log without the values that cannot be true; the notes count them.

    As `plausible_samples`, before a role is given to it: a wrong value becomes unknown (NaN), and
    its row goes where nothing is left that a role could use. A column whose median is impossible is
    kept, with a warning: it has another unit, or is not of air. Of events only ranges are checked.
    """
    before = channel
    channel, wild = _mask_heights(channel)
    notes = list(wild)
    columns, wrong = dict(channel.columns), np.zeros(len(channel), np.bool_)
    odd = set()
    for column in [name for name in RANGES if name in columns and name not in _HEIGHTS]:
        outside = _outside(columns[column], column)
        if not outside.any():
            continue
        low, high = RANGES[column]
        median = float(np.nanmedian(channel[column]))
        if not low <= median <= high:
            odd.add(column)
            notes.append(
                warning("SENSOR-ODD", where=channel.name, count=len(channel), column=column,
                        median=median, limits=_limits(column))
            )  # fmt: skip
            continue
        count = int(np.count_nonzero(outside))
        notes.append(_range_loss(channel, column, count, _limits(column)))
        columns[column] = np.where(outside, np.nan, columns[column])
        wrong |= outside
    channel = replace(channel, columns=columns)
    roles = [role for role in _ROLES_WITH_JUMPS if channel.fits_role(role)]
    roles = [] if "events" in channel.roles else roles
    for role in [role for role in roles if not odd & {*ROLE_COLUMNS[role]}]:
        jumps, reported = _jumps(channel, _known(channel, role), role)
        notes += reported
        for column in ROLE_COLUMNS[role] if jumps.size else ():
            columns[column] = columns[column].copy()
            columns[column][jumps] = np.nan
        wrong[jumps] = True
    for role in roles:
        wrong &= ~_known(channel, role)
    useless = wrong if roles else np.zeros(len(channel), np.bool_)
    masked = {
        name: int(np.count_nonzero(np.isnan(values) & ~np.isnan(before[name]) & ~useless))
        for name, values in columns.items()
        if values is not before[name]
    }
    channel = subset(channel, ~useless) if useless.any() else channel
    return replace(channel, masked=masked), tuple(notes)


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


def _range_loss(channel: Channel, column: str, count: int, what: str) -> Entry:
    text = f"{count} of {len(channel)} samples of {column} are {what} and are not used"
    return loss("SENSOR-RANGE", text, where=channel.name, count=count)


def _mask_heights(channel: Channel) -> tuple[Channel, Notes]:
    """The channel with impossible heights unknown: out of range, or a jump there and back.

    The row keeps its latitude and longitude.
    """
    columns = dict(channel.columns)
    notes: list[Entry] = []
    for column in [name for name in _HEIGHTS if name in columns]:
        height = columns[column]
        wild = _outside(height, column)
        if "lat_rad" in columns:
            known = np.isfinite(height) & ~wild
            jumps, reported = _stray_rows(channel, known, _STEPS[column], channel.name)
            wild[jumps] = True
            notes += reported
        if bool(wild.any()):
            row = int(np.argmax(wild))
            notes.append(
                loss("SENSOR-RANGE/heights", where=channel.name, count=int(wild.sum()),
                     total=len(channel), column=column, height=height[row], row=row)
            )  # fmt: skip
            columns[column] = np.where(wild, np.nan, height)
    return replace(channel, columns=columns), tuple(notes)


def _jumps(channel: Channel, known: Mask, role: str) -> tuple[Rows, Notes]:
    """Few samples in a row that a role's columns cannot reach from those around them."""
    where = f"{channel.name}, as {role}"
    notes: list[Entry] = []
    stray = np.zeros(len(channel), np.bool_)
    for name in (name for name in (role, *ROLE_COLUMNS[role]) if name in _STEPS):
        rows, reported = _stray_rows(channel, known, _STEPS[name], where)
        stray[rows] = True
        notes += reported
    jumps = np.flatnonzero(stray)
    lost = jumps
    if jumps.size and role.endswith("attitude"):
        kept = np.flatnonzero(known & ~stray)
        after = np.searchsorted(kept, jumps)
        inner = (after > 0) & (after < kept.size)
        i, j = kept[after[inner] - 1], kept[after[inner]]
        limit = _STEPS["attitude"].rate * 1e-9 * (channel.time_ns[j] - channel.time_ns[i])
        stays = after == 0  # what comes behind is another attitude than what was before
        stays[inner] = _angle(channel, i, j) > np.maximum(limit, _TURN_NOISE_RAD)
        lost = jumps[~stays]
        if count := int(np.count_nonzero(stays)):
            notes.append(note("ATTITUDE-ALIGNED", where=where, count=count))
    if lost.size:
        time_s, total = (channel.time_ns[lost[0]] - channel.time_ns[0]) * 1e-9, len(channel)
        count = int(lost.size)
        notes.append(loss("SENSOR-JUMP", where=where, count=count, total=total, time_s=time_s))
    return jumps, tuple(notes)


def _metres(channel: Channel, i: Rows, j: Rows) -> Array:
    """Horizontal distance [m], good enough to notice a jump."""
    lat, lon = channel["lat_rad"], channel["lon_rad"]
    east = wrapped(lon[j] - lon[i])
    return np.asarray(_METRES_PER_RAD * np.hypot(lat[j] - lat[i], east * np.cos(lat[i])))


def _angle(channel: Channel, i: Rows, j: Rows) -> Array:
    """The angle between attitudes [rad]; 0 where it is less than what is noise."""
    cosine = np.abs(sum(channel[name][i] * channel[name][j] for name in ROLE_COLUMNS["attitude"]))
    angle = np.zeros(cosine.shape)
    wide = cosine < np.cos(_TURN_NOISE_RAD / 2.0)
    angle[wide] = 2.0 * np.arccos(cosine[wide])
    return angle


def _step_of(column: str, rate: float, noise: float) -> _Distance:
    """The difference of the values of a column."""
    return _Distance(lambda c, i, j: np.abs(c[column][j] - c[column][i]), rate, noise)


# By role or by column. 2,500 Pa/s is a climb of 200 m/s at sea level.
_STEPS: Mapping[str, _Distance] = {
    "position": _Distance(_metres, FASTEST_M_S, 100.0),
    "height": _Distance(_metres, FASTEST_M_S, 100.0),
    "attitude": _Distance(_angle, float(FASTEST_TURN_RAD_S), _TURN_NOISE_RAD),
    "pressure_pa": _step_of("pressure_pa", 2_500.0, 100.0),
    "temperature_k": _step_of("temperature_k", 20.0, 5.0),
    "h_msl_m": _step_of("h_msl_m", FASTEST_CLIMB_M_S, 20.0),
    "h_ellipsoid_m": _step_of("h_ellipsoid_m", FASTEST_CLIMB_M_S, 20.0),
}


def _stray_rows(channel: Channel, known: Mask, step: _Distance, where: str) -> tuple[Rows, Notes]:
    """Rows that neither side reaches at the rate of a step, up to `STRAY_ROWS` in a row."""
    rows = np.flatnonzero(known)

    def far(i: Rows, j: Rows) -> Mask:
        seconds = 1e-9 * (channel.time_ns[j] - channel.time_ns[i])
        limit = np.maximum(step.rate * seconds, step.noise)
        return np.asarray(step.between(channel, i, j) > limit, np.bool_)

    edges = [np.zeros(1, np.intp)]
    for begin in range(0, rows.size - 1, _BLOCK):
        part = rows[begin : begin + _BLOCK + 1]
        edges.append(np.flatnonzero(far(part[:-1], part[1:])) + begin + 1)
    first = np.concatenate(edges)
    if rows.size < 3 or first.size == 1:
        return rows[:0], ()
    if first.size > _MOST_STRETCHES:
        count = int(first.size - 1)
        return rows[:0], (warning("SENSOR-NOISE", where=where, count=count, total=rows.size),)
    length = np.diff(np.append(first, rows.size))
    begin_row, end_row = rows[first], rows[first + length - 1]
    # From the longest stretch on, both ways, a stretch is kept that is reached from the last one
    # kept. A long one is kept wherever it is: a sensor that is set anew, or the end of a gap.
    stray = np.zeros(first.shape, np.bool_)
    before = after = int(np.argmax(length))
    for k in range(before + 1, first.size):
        short = length[k] <= STRAY_ROWS
        stray[k] = short and far(end_row[before : before + 1], begin_row[k : k + 1])[0]
        before = before if stray[k] else k
    for k in range(after - 1, -1, -1):
        short = length[k] <= STRAY_ROWS
        stray[k] = short and far(end_row[k : k + 1], begin_row[after : after + 1])[0]
        after = after if stray[k] else k
    return np.asarray(rows[np.repeat(stray, length)], np.intp), ()


def subset(channel: Channel, keep: Mask) -> Channel:
    """The samples of a channel that a mask keeps."""
    columns = {name: values[keep] for name, values in channel.columns.items()}
    labels = {name: tuple(compress(values, keep)) for name, values in channel.labels.items()}
    time_ns, boot = channel.time_ns[keep], channel.boot[keep]
    return replace(channel, time_ns=time_ns, boot=boot, columns=columns, labels=labels)
