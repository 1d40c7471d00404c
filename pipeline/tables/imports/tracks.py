"""Movement along a track of positions: to test what a file says of itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Array, TimeArray
from pipeline.geodesy import principal_radii

FASTEST_M_S = 700.0
"""No aircraft that takes pictures flies faster [m/s]."""


def track_velocity(
    time_ns: TimeArray, lat_rad: Array, lon_rad: Array, step_s: float
) -> NDArray[np.complex128]:
    """(n,) velocity over the ground, north + 1j east [m/s], from positions ``step_s`` apart [s].

    NaN at the ends, and across intervals of more than four steps.

    >>> time_ns = np.arange(5) * 10**9
    >>> track_velocity(time_ns, np.zeros(5), np.arange(5) * 1e-6, 1.0)[2].round(3)
    np.complex128(6.378j)
    """
    seconds = (time_ns - time_ns[0]) * 1e-9
    usual = float(np.median(np.diff(seconds))) if seconds.size > 1 else step_s
    reach = max(1, round(step_s / max(usual, 1e-6) / 2.0))
    velocity = np.full(time_ns.shape, np.nan + 0j)
    if seconds.size <= 2 * reach:
        return velocity
    meridian, vertical = principal_radii(lat_rad)
    lon = np.unwrap(np.where(np.isfinite(lon_rad), lon_rad, 0.0))
    before, after = slice(None, -2 * reach), slice(2 * reach, None)
    middle = slice(reach, -reach)
    took = seconds[after] - seconds[before]
    north = (lat_rad[after] - lat_rad[before]) * meridian[middle]
    east = (lon[after] - lon[before]) * (vertical * np.cos(lat_rad))[middle]
    torn = took > 4.0 * max(2.0 * reach * usual, step_s)
    velocity[middle] = np.where(torn, np.nan, (north + 1j * east) / took)
    return velocity


def wrapped(angle: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
