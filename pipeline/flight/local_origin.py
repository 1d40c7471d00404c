"""Local positions (motion capture, visual odometry) given a place on the earth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.geodesy import offset_geodetic


@dataclass(frozen=True)
class GeodeticOrigin:
    """Where east = north = up = 0 lies; radians and metres above the ellipsoid."""

    lat_rad: float
    lon_rad: float
    h_ellipsoid_m: float


def to_geodetic(channel: Channel, origin: GeodeticOrigin) -> Channel:
    """The channel with its local positions as latitude, longitude and ellipsoidal height.

    A channel without ``east_m``, ``north_m``, ``up_m`` is returned as it is.
    """
    if "east_m" not in channel.columns or "lat_rad" in channel.columns:
        return channel
    enu = np.stack([channel["east_m"], channel["north_m"], channel["up_m"]], axis=1)
    n = len(channel)
    lat, lon, height = offset_geodetic(
        np.full(n, origin.lat_rad),
        np.full(n, origin.lon_rad),
        np.full(n, origin.h_ellipsoid_m),
        enu,
    )
    return replace(
        channel,
        columns=dict(channel.columns) | {"lat_rad": lat, "lon_rad": lon, "h_ellipsoid_m": height},
        roles=(*channel.roles, "height", "position"),
    )
