"""Readings that cannot be true, and units that look wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.flight.channels import ROLE_COLUMNS, Channel
from pipeline.ledger import Ledger

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
"""No aircraft turns there and, in the next interval, back that fast [rad/s]; a flip goes on."""

# What changes no faster: column -> (rate [1/s], step that is noise whatever the interval).
# 2,500 Pa/s is a climb of 200 m/s at sea level.
_FASTEST: Mapping[str, tuple[float, float]] = {
    "pressure_pa": (2_500.0, 100.0),
    "temperature_k": (20.0, 5.0),
}
_TURN_NOISE_RAD = np.radians(20.0)
_METRES_PER_RAD = 6_371_000.0  # a jump of 100 m is told from none: any radius will do

# Medians that give a wrong unit away: column -> (low, high, the unit it looks like).
_DISGUISES: Mapping[str, tuple[float, float, str]] = {
    "pressure_pa": (100.0, 1_200.0, "hPa"),
    "temperature_k": (-90.0, 60.0, "degC"),
    "relative_humidity": (1.2, 100.0, "percent"),
}


def within_reason(channel: Channel, role: str, ledger: Ledger) -> Channel:
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
        low, high = RANGES.get(column, (-np.inf, np.inf))
        with np.errstate(invalid="ignore"):
            outside = finite & ((values < low) | (values > high))
        for bad, what in (
            (~finite, "not a number"),
            (outside, f"outside {low:g} to {high:g}"),
        ):
            if bad.any():
                ledger.loss(
                    "SENSOR-RANGE",
                    f"{int(bad.sum())} of {len(channel)} samples of {column} are {what} and are "
                    "not used",
                    where=channel.name,
                    count=int(bad.sum()),
                )
        keep &= finite & ~outside
    keep[np.flatnonzero(keep)[_jumps(subset(channel, keep), role, ledger)]] = False
    return channel if bool(keep.all()) else subset(channel, keep)


def _jumps(channel: Channel, role: str, ledger: Ledger) -> Mask:
    """Single samples that a role's columns reach and leave faster than they can change."""
    time_s = (channel.time_ns - channel.time_ns[:1]) * 1e-9
    jump = np.zeros(len(channel), np.bool_)
    if len(channel) < 3:
        return jump
    limit_s = np.diff(time_s)
    if role in ("position", "height"):
        jump = _there_and_back(_metres(channel), FASTEST_M_S * limit_s)
    elif role == "attitude":
        q = np.stack([channel[f"q_{axis}"] for axis in "wxyz"], axis=1)
        jump = _turned_and_back(q, np.maximum(FASTEST_TURN_RAD_S * limit_s, _TURN_NOISE_RAD))
    for column in ROLE_COLUMNS[role]:
        if column in _FASTEST:
            rate, noise = _FASTEST[column]
            jump |= _there_and_back(channel[column][:, None], np.maximum(rate * limit_s, noise))
    if jump.any():
        first = int(np.flatnonzero(jump)[0])
        ledger.loss(
            "SENSOR-JUMP",
            f"{int(jump.sum())} of {len(channel)} samples jump there and back faster than a "
            f"vehicle or the air can change, the first {time_s[first]:.3f} s after the first "
            "sample; not used",
            where=f"{channel.name}, as {role}",
            count=int(jump.sum()),
        )
    return jump


def _metres(channel: Channel) -> Array:
    """Horizontal places [m], (n, 2), good enough to tell a jump."""
    lat, lon = channel["lat_rad"], np.unwrap(channel["lon_rad"])
    return _METRES_PER_RAD * np.stack([lat, lon * np.cos(lat[0])], axis=1)


def _there_and_back(values: Array, limit: Array) -> Mask:
    """Rows that are farther than a limit from both neighbours, which lie on the same side."""
    step = np.diff(values, axis=0)
    far = np.linalg.norm(step, axis=1) > limit
    back = np.einsum("ij,ij->i", step[:-1], step[1:]) < 0.0
    return np.concatenate([[False], far[:-1] & far[1:] & back, [False]])


def _turned_and_back(q: Array, limit: Array) -> Mask:
    """Attitudes that are farther than a limit from both neighbours, which agree."""
    far = _angle(q[:-1], q[1:]) > limit
    agree = _angle(q[:-2], q[2:]) <= limit[:-1] + limit[1:]
    return np.concatenate([[False], far[:-1] & far[1:] & agree, [False]])


def _angle(a: Array, b: Array) -> Array:
    """The angle between attitudes [rad]."""
    return np.asarray(2.0 * np.arccos(np.minimum(np.abs(np.einsum("ij,ij->i", a, b)), 1.0)))


def _without_wild_heights(channel: Channel, ledger: Ledger) -> Channel:
    """The channel with impossible heights unknown: out of range, or a jump there and back.

    The row keeps its latitude and longitude.
    """
    columns = dict(channel.columns)
    for column in ("h_msl_m", "h_ellipsoid_m"):
        if column not in columns:
            continue
        height = columns[column]
        low, high = RANGES[column]
        with np.errstate(invalid="ignore"):
            wild = (height < low) | (height > high)
        wild |= _spikes(channel, np.where(wild, np.nan, height))
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


def _spikes(channel: Channel, height: Array) -> NDArray[np.bool_]:
    """Single samples that would need more than 200 m/s there and 200 m/s back."""
    known = np.flatnonzero(np.isfinite(height))
    spike = np.zeros(height.shape, dtype=bool)
    if known.size < 3:
        return spike
    speed = np.diff(height[known]) / (np.diff(channel.time_ns[known]) * 1e-9)
    there, back = speed[:-1], speed[1:]
    too_fast = (np.abs(there) > FASTEST_CLIMB_M_S) & (np.abs(back) > FASTEST_CLIMB_M_S)
    spike[known[1:-1][too_fast & (there * back < 0.0)]] = True
    return spike


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


def subset(channel: Channel, keep: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Channel:
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
