"""Heights above sea level and above the ellipsoid, each from the other where it must be.

Local positions (motion capture, visual odometry) get a place on the earth, and with it heights.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.flight.channels import Channel
from pipeline.flight.stations import Stations
from pipeline.flight.trajectory import interpolate
from pipeline.geodesy import offset_geodetic
from pipeline.ledger import Entry, Notes, note, warning

Array = NDArray[np.float64]

STEADY_HOME_M = 2.0
"""The take-off height of a flight does not change by more than this [m]."""


@dataclass(frozen=True)
class HeightSystem:
    """How the two kinds of height go together; None where neither log nor mission file has them."""

    undulation_m: float | None = None
    home_h_msl_m: float | None = None

    def known_undulation_m(self, what: str, where: str) -> float:
        """The undulation; refuses (MissionError) heights of ``what`` that cannot do without."""
        if self.undulation_m is not None:
            return self.undulation_m
        raise MissionError(
            "HEIGHT-REFERENCE",
            f"the heights of {what} cannot be related from the ellipsoid to mean sea level: "
            "nothing says how far the two are apart",
            where=where,
            remedy="give mission.undulation_m (ellipsoidal minus mean sea level)",
        )


def height_system(
    roles: Mapping[str, Channel], stated_undulation_m: float | None
) -> tuple[HeightSystem, Notes]:
    """Undulation and take-off height, from the mission file or the log itself.

    The take-off height is known where the height of the position above sea level and above home
    differ by one value. Before an autopilot sets its home, it gives both heights alike; those rows
    do not count.
    """
    undulation, home = stated_undulation_m, None
    notes: list[Entry] = []
    height, position = roles.get("height"), roles.get("position")
    if undulation is None and height is not None:
        both = _difference(height, "h_ellipsoid_m", "h_msl_m")
        if both.size:
            undulation = float(np.median(both))
            notes.append(
                note(
                    "HEIGHT-UNDULATION",
                    f"undulation {undulation:.2f} m, from the two heights of {height.name}",
                    where=height.name,
                    count=int(both.size),
                )
            )
        if both.size and not both.any():  # as some receivers on a CAN bus do
            notes.append(
                warning(
                    "HEIGHT-SAME",
                    f"both heights of {height.name} are equal to the last digit in {both.size} "
                    "rows: one is a copy of the other, and which of them is meant is unknown; the "
                    "undulation is hardly anywhere 0 (-107 to 86 m), give mission.undulation_m",
                    where=height.name,
                    count=int(both.size),
                )
            )
    homes = np.empty(0) if position is None else _difference(position, "h_msl_m", "h_home_m")
    is_set = np.abs(homes) > 0.01
    homes = homes[is_set] if bool(is_set.any()) else homes
    if position is not None and homes.size:
        low, middle, high = np.percentile(homes, [5.0, 50.0, 95.0])
        what = (
            f"the take-off height of {position.name} changes between {low:.1f} and {high:.1f} m: "
            "it is not used"
        )
        if high - low <= STEADY_HOME_M:
            home, what = float(middle), f"take-off height {middle:.2f} m"
        notes.append(note("HEIGHT-HOME", what, where=position.name))
    return HeightSystem(undulation, home), tuple(notes)


def _difference(channel: Channel, first: str, second: str) -> Array:
    """Known differences of two columns; empty where the channel lacks one."""
    if first not in channel.columns or second not in channel.columns:
        return np.empty(0)
    difference = channel[first] - channel[second]
    return difference[np.isfinite(difference)]


def heights_at(
    height: Channel, time_ns: NDArray[np.int64], heights: HeightSystem, max_gap_s: float
) -> tuple[Array, Array]:
    """Heights above sea level and above the ellipsoid, each from the other where it must be.

    Local positions (motion capture, visual odometry) get a place on the earth, and with it heights.
    """
    h_msl = interpolate(height, "h_msl_m", time_ns, max_gap_s)
    h_ell = interpolate(height, "h_ellipsoid_m", time_ns, max_gap_s)
    if heights.undulation_m is not None:
        h_msl = np.where(np.isfinite(h_msl), h_msl, h_ell - heights.undulation_m)
        h_ell = np.where(np.isfinite(h_ell), h_ell, h_msl + heights.undulation_m)
    return h_msl, h_ell


def ground_offsets(reference: str, stations: Stations, heights: HeightSystem) -> Array:
    """(s,) what to add to a ground height to have it above mean sea level [m].

    ``reference`` is msl, ellipsoid (minus the undulation at the station) or relative (the height
    of the take-off point). Refuses where the log and the mission file leave that unknown.
    """
    n = len(stations)
    if reference == "msl":
        return np.zeros(n)
    if reference == "ellipsoid":
        undulation = stations.h_ellipsoid_m - stations.h_msl_m
        if not bool(np.isfinite(undulation[stations.ok]).any()) and bool(stations.ok.any()):
            raise MissionError(
                "HEIGHT-REFERENCE",
                "ground heights are above the ellipsoid, but the log gives only heights above "
                "mean sea level and nothing says how the two go together",
                where="ground.reference",
                remedy="give mission.undulation_m (ellipsoidal minus mean sea level)",
            )
        return -undulation
    if heights.home_h_msl_m is None:
        raise MissionError(
            "HEIGHT-REFERENCE",
            "ground heights are relative to the take-off point, of which the log gives no height, "
            "or more than one",
            where="ground.reference",
            remedy="give ground.home_h_msl_m",
        )
    return np.full(n, heights.home_h_msl_m)


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
