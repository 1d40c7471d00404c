"""Heights above sea level and above the ellipsoid, each from the other where it must be.

Local positions (motion capture, visual odometry) get a place on the earth, and with it heights.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.errors import MissionError
from unbend.flight.channels import Channel
from unbend.flight.stations import Stations
from unbend.flight.trajectory import interpolate
from unbend.geodesy import GeoidGrid, offset_geodetic
from unbend.messages import Entry, Notes, finding, loss, note, warning
from unbend.units import Array, Integers

STEADY_HOME_M = 2.0  # the take-off height of a flight does not change by more than this [m]

LOWEST_GROUND_M, HIGHEST_GROUND_M = -600.0, 10_000.0
"""Heights outside this range are no ground heights [m]."""

USUAL_GEOID_M, LARGEST_GEOID_M = 3.0, 10.0
"""EGM96 at 15 minutes and national sea levels differ by less than the first, and by the second
nowhere [m]."""


@dataclass(frozen=True)
class HeightSystem:
    """How the two kinds of height go together; without undulation and geoid that is unknown.

    undulation_m : ellipsoidal height minus height above sea level, the same everywhere.
    home_h_msl_m : height of the take-off point.
    geoid : its undulations plus ``offset_m`` (the log's own minus the grid's) hold where
        ``undulation_m`` is None.
    source : where the undulation comes from.
    one_height : the log's height above the ellipsoid is a copy of the other and not used.
    """

    undulation_m: float | None = None
    home_h_msl_m: float | None = None
    geoid: GeoidGrid | None = None
    offset_m: float = 0.0
    source: str = ""
    one_height: bool = False

    def undulation(self, lat_rad: Array, lon_rad: Array) -> Array:
        """(n,) undulation [m] at (n,) places; NaN where unknown, and outside the grid."""
        if self.undulation_m is None and self.geoid is not None:
            return self.geoid.undulation(lat_rad, lon_rad) + self.offset_m
        return np.full(np.shape(lat_rad), self.undulation_m, np.float64)


def height_system(
    roles: Mapping[str, Channel],
    stated_undulation_m: float | None,
    geoid: GeoidGrid | None = None,
    *,
    stated_home_m: float | None = None,
) -> tuple[HeightSystem, Notes]:
    """Undulation and take-off height, from the mission file, the log itself or a geoid.

    The take-off height is known where the height of the position above sea level and above home
    differ by one value, but for rows that give both alike: there the home is not set.
    """
    undulation, home, offset, one_height = stated_undulation_m, None, 0.0, False
    source = "mission.undulation_m"
    if undulation is None:
        source = "unknown" if geoid is None else geoid.name
    notes: list[Entry] = []
    height, position = roles.get("height"), roles.get("position")
    both = np.empty(0) if height is None else _difference(height, "h_ellipsoid_m", "h_msl_m")
    if height is not None and both.size:
        where, count, own = height.name, int(both.size), float(np.median(both))
        of_grid = np.full(len(height), np.nan)
        if undulation is None and geoid is not None:
            of_grid = geoid.undulation(height["lat_rad"], height["lon_rad"])
        one_height = not both.any()  # as some receivers on a CAN bus do
        if one_height:
            here = _median(of_grid) if undulation is None else undulation
            size = "" if here is None else f" of {here:.1f} m"
            notes.append(warning("HEIGHT-SAME", where=where, count=count, source=source, size=size))
        elif undulation is None:
            source = f"the two heights of {height.name}"
            if geoid is None:
                undulation = own
            apart = height["h_ellipsoid_m"] - height["h_msl_m"] - of_grid
            offset = _median(apart) or 0.0
        elif abs(undulation - own) > USUAL_GEOID_M:
            entry, stated = _by_size(undulation - own), undulation
            notes += [entry("HEIGHT-GEOID/log", where=where, count=count, stated=stated, own=own)]
    homes = np.empty(0) if position is None else _difference(position, "h_msl_m", "h_home_m")
    is_set = np.abs(homes) > 0.01
    homes = homes[is_set] if bool(is_set.any()) else homes
    if position is not None and homes.size:
        low, middle, high = np.percentile(homes, [5.0, 50.0, 95.0])
        steady = bool(high - low <= STEADY_HOME_M)
        home, where = float(middle) if steady else None, position.name
        notes.append(
            note("HEIGHT-HOME/steady", where=where, height=middle) if steady
            else note("HEIGHT-HOME/changes", where=where, low=low, high=high)
        )  # fmt: skip
    home = home if stated_home_m is None else stated_home_m
    system = HeightSystem(undulation, home, geoid, offset, source, one_height)
    return system, tuple(notes)


def _median(values: Array) -> float | None:
    """That of the known values."""
    return float(np.nanmedian(values)) if np.isfinite(values).any() else None


def _by_size(off_m: float) -> Callable[..., Entry]:
    """An undulation that is off: a warning, beyond 10 m a finding."""
    return finding if abs(off_m) > LARGEST_GEOID_M else warning


def undulation_notes(
    heights: HeightSystem, stations: Stations, egm96: GeoidGrid
) -> Iterator[Entry]:
    """Which undulation is used at the stations; what speaks against it, by EGM96."""
    placed = np.isfinite(stations.lat_rad)
    lat, lon = stations.lat_rad[placed], stations.lon_rad[placed]
    used, where = heights.undulation(lat, lon), "mission.geoid"
    known = np.isfinite(used)
    if heights.undulation_m is not None:
        where = "mission.undulation_m"
    if not bool(known.all()):
        count = int((~known).sum())
        grid = heights.source if heights.geoid is None else heights.geoid.name
        what = f"{count} of {known.size} stations lie outside {grid}, or in its holes"
        yield loss("GEOID-OUTSIDE", what, where=where, count=count)
    if not bool(known.any()):
        return
    used, of_egm = used[known], egm96.undulation(lat, lon)[known]
    there, size = used, int(used.size)
    if heights.source.startswith("the two heights"):
        own, where = stations.h_ellipsoid_m - stations.h_msl_m, "log.channels.height"
        there = np.where(np.isfinite(own[placed][known]), own[placed][known], used)
    ends = dict.fromkeys(f"{h:.2f}" for h in (there.min(), there.max()))
    what = f"undulation of {' to '.join(ends)} m, by {heights.source}"
    yield note("HEIGHT-UNDULATION", what, where=where, count=size)
    off, other = float(np.median(used - of_egm)), float(np.median(-used - of_egm))
    if abs(off) > USUAL_GEOID_M:
        what += f", is {off:+.1f} m from EGM96, which has {np.median(of_egm):.1f} m here"
        if abs(other) < min(USUAL_GEOID_M, abs(off)):
            what += f"; with the other sign it is {other:+.1f} m from it: the undulation is the "
            what += "ellipsoidal height minus the height above sea level"
        entry = _by_size(off)
        yield entry("HEIGHT-GEOID", what, where=where, count=size)


def _difference(channel: Channel, first: str, second: str) -> Array:
    """Known differences of two columns; empty where the channel lacks one."""
    if first not in channel.columns or second not in channel.columns:
        return np.empty(0)
    difference = channel[first] - channel[second]
    return difference[np.isfinite(difference)]


def heights_at(
    height: Channel, time_ns: Integers, heights: HeightSystem, max_gap_s: float
) -> tuple[Array, Array]:
    """(n,) heights [m] above sea level and above the ellipsoid at instants [Unix ns]."""
    h_msl = interpolate(height, "h_msl_m", time_ns, max_gap_s)
    h_ell = interpolate(height, "h_ellipsoid_m", time_ns, max_gap_s)
    if heights.one_height:
        h_ell = np.full(h_msl.shape, np.nan)
    if np.isnan(h_msl).any() or np.isnan(h_ell).any():
        # At the next sample: within 0.2 km, where a geoid rises by a centimetre.
        known = np.flatnonzero(np.isfinite(height["lat_rad"]) & np.isfinite(height["lon_rad"]))
        undulation = np.full(h_msl.shape, np.nan)
        if known.size:
            row = known[np.searchsorted(height.time_ns[known[:-1]], time_ns)]
            undulation = heights.undulation(height["lat_rad"][row], height["lon_rad"][row])
        h_msl = np.where(np.isfinite(h_msl), h_msl, h_ell - undulation)
        h_ell = np.where(np.isfinite(h_ell), h_ell, h_msl + undulation)
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
            raise MissionError.of("HEIGHT-REFERENCE", "ground.reference")
        return -undulation
    return np.full(n, known_home_m(heights))


def known_home_m(heights: HeightSystem) -> float:
    """The height of the take-off point; refuses (MissionError) heights relative to an unknown."""
    if heights.home_h_msl_m is not None:
        return heights.home_h_msl_m
    raise MissionError.of("HEIGHT-REFERENCE/known-home-m", "ground.reference")


@dataclass(frozen=True)
class GeodeticOrigin:
    """Where east = north = up = 0 lies."""

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
    place = (origin.lat_rad, origin.lon_rad, origin.h_ellipsoid_m)
    lat, lon, height = (np.full(len(channel), value) for value in place)
    lat, lon, height = offset_geodetic(lat, lon, height, enu)
    return replace(
        channel,
        columns=dict(channel.columns) | {"lat_rad": lat, "lon_rad": lon, "h_ellipsoid_m": height},
        roles=(*channel.roles, "height", "position"),
    )


_LONGEST_GAP_S = 5.0
_HEALTHY = 2.0  # status of TERR


def logged_terrain(channels: Iterable[Channel], time_ns: Integers) -> Array:
    """(n,) terrain height above sea level [m] below the vehicle at times, NaN where none is logged.

    For checks, never as truth: ArduPilot's grid is SRTM at 100 m, some 10 m (90 %) in open country.
    Rows count where the autopilot had its grid: TERR of status 2, TERRAIN_REPORT with a spacing and
    place.
    """
    height = np.full(time_ns.size, np.nan)
    for channel in (c for c in channels if "h_terrain_m" in c.columns):
        placed = channel.get("lat_rad") != 0.0
        healthy = (channel.get("terrain_spacing_m") > 0.0) & placed
        healthy |= channel.get("terrain_status") == _HEALTHY
        of_grid = np.where(healthy, channel["h_terrain_m"], np.nan)
        channel = replace(channel, columns=dict(channel.columns) | {"h_terrain_m": of_grid})
        known = interpolate(channel, "h_terrain_m", time_ns, _LONGEST_GAP_S)
        height = np.where(np.isnan(height), known, height)
    return height
