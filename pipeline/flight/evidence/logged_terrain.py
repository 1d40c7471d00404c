"""Terrain heights that the autopilot logged, beside those of the mission: a check, never truth.

ArduPilot's grid is SRTM at 100 m, read from its own card: some 10 m (90 %) in open country.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Channel
from pipeline.flight.trajectory import interpolate
from pipeline.units import Array

_LONGEST_GAP_S = 5.0
_HEALTHY = 2.0  # status of TERR


def logged_terrain(channels: Iterable[Channel], time_ns: NDArray[np.int64]) -> Array:
    """(n,) terrain height above sea level [m] below the vehicle at times, NaN where none is logged.

    Rows count where the autopilot had its grid: TERR of status 2, TERRAIN_REPORT with a spacing and
    place.
    """
    height = np.full(time_ns.size, np.nan)
    for channel in channels:
        if "h_terrain_m" not in channel.columns:
            continue
        nothing = np.zeros(len(channel))
        healthy = channel.columns.get("terrain_status", nothing) == _HEALTHY
        placed = channel.columns.get("lat_rad", nothing + 1.0) != 0.0
        healthy |= (channel.columns.get("terrain_spacing_m", nothing) > 0.0) & placed
        of_grid = np.where(healthy, channel["h_terrain_m"], np.nan)
        channel = replace(channel, columns=dict(channel.columns) | {"h_terrain_m": of_grid})
        known = interpolate(channel, "h_terrain_m", time_ns, _LONGEST_GAP_S)
        height = np.where(np.isnan(height), known, height)
    return height
