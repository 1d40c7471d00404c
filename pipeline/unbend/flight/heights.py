"""Heights above sea level and above the ellipsoid; one that is not logged follows from the other.

Local positions (motion capture, visual odometry) get a place on the earth, and with it heights.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import Channel
from unbend.flight.ground_times import GroundEvidence, LoggedPath, home_is_set, takeoff_of
from unbend.flight.interpolation import interpolate
from unbend.flight.stations import Stations
from unbend.geodesy import GeoidGrid, offset_geodetic
from unbend.messages import Message, Notes
from unbend.units import Array, Integers

STEADY_HOME_M = 2.0  # the take-off height of a flight does not change by more than this [m]

LOWEST_GROUND_M = -600.0
HIGHEST_GROUND_M = 10_000.0
"""The range in which ground heights are possible [m]."""

USUAL_GEOID_M = 3.0
"""EGM96 at 15 minutes and national sea levels usually differ by less than this [m]."""
LARGEST_GEOID_M = 10.0
"""They differ by less than this everywhere [m]."""


@dataclass(frozen=True)
class HeightSystem:
    """How heights above sea level and above the ellipsoid of a mission are related.

    Without an undulation and a geoid their relation is unknown. Heights of points are above sea
    level [m].

    undulation_m : ellipsoidal height minus height above sea level, the same everywhere.
    home_h_msl_m : height of the take-off point; None if unknown.
    geoid : gives the undulations, with ``offset_m`` added, if ``undulation_m`` is None.
    offset_m : undulation by the two heights of the log, minus that of the geoid.
    source : where the undulation comes from, in words.
    one_height : True if the log's height above the ellipsoid is a copy of that above sea level;
        it is not used then.
    by_log : True if the undulation is that of two heights of the log.
    begin_h_msl_m : height at which the log begins, if the take-off height is unknown and the
        aircraft is at rest there. It is only proposed to the user, in a refusal.
    """

    undulation_m: float | None = None
    home_h_msl_m: float | None = None
    geoid: GeoidGrid | None = None
    offset_m: float = 0.0
    source: str = ""
    one_height: bool = False
    by_log: bool = False
    begin_h_msl_m: float | None = None

    def undulation(self, lat_rad: Array, lon_rad: Array) -> Array:
        """(n,) undulations [m] at places; NaN where unknown, and outside the grid of the geoid."""
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
    """Choose undulation and take-off height from the mission file, the log and a geoid.

    The undulation is that of the mission file, else that of the log, else that of the geoid. The
    take-off height (home) is that of the mission file, else that of the log.

    ``stated_undulation_m``, ``stated_home_m`` : of the mission file; None if it states none. A log
    gives the take-off height if the heights of its position above sea level and above home differ
    by a constant. Rows with equal heights do not count: there the home is not set yet.
    """
    system = _without_log(stated_undulation_m, geoid)
    notes: list[Message] = []
    height = roles.get("height")
    if height is not None:
        logged_undulation = _difference(height, "h_ellipsoid_m", "h_msl_m")
        if logged_undulation.size:
            system, height_notes = _with_two_heights(system, height, logged_undulation)
            notes += height_notes
    home_m = None
    position = roles.get("position")
    if position is not None:
        home_m, home_notes = _logged_home(position)
        notes += home_notes
    if stated_home_m is not None:
        home_m = stated_home_m
    return replace(system, home_h_msl_m=home_m), tuple(notes)


def _without_log(stated_undulation_m: float | None, geoid: GeoidGrid | None) -> HeightSystem:
    """The height system by the mission file, else by a geoid; without both it is unknown."""
    if stated_undulation_m is not None:
        source = "mission.undulation_m"
    elif geoid is not None:
        source = geoid.name
    else:
        source = "unknown"
    return HeightSystem(undulation_m=stated_undulation_m, geoid=geoid, source=source)


def _with_two_heights(
    system: HeightSystem, height: Channel, logged_undulation: Array
) -> tuple[HeightSystem, Notes]:
    """Adapt a height system to a log that has both heights, which give an undulation.

    ``system`` : by the mission file or a geoid. ``logged_undulation`` : (m,) the known differences
    ellipsoidal minus above sea level, m > 0.

    * All differences are 0: one height is a copy of the other. The ellipsoidal height is not used;
      a warning.
    * The mission file states no undulation: it becomes that of the log. A geoid keeps its
      undulations, plus the median difference of the log's from them.
    * The mission file states one: the system stays; a large difference from the log is reported.
    """
    logged_m = float(np.median(logged_undulation))
    rows = logged_undulation.size
    stated_m = system.undulation_m
    if not logged_undulation.any():  # as some receivers on a CAN bus do
        used_m = stated_m
        if stated_m is None:
            used_m = _median(_undulation_of_grid(system.geoid, height))
        warning = messages.heights_are_one(
            channel=height.name, rows=rows, source=system.source, undulation_m=used_m
        )
        return replace(system, one_height=True), (warning,)
    if stated_m is None:
        all_logged_m = height["h_ellipsoid_m"] - height["h_msl_m"]
        off_grid_m = _median(all_logged_m - _undulation_of_grid(system.geoid, height))
        by_log = replace(
            system,
            undulation_m=logged_m if system.geoid is None else None,
            offset_m=off_grid_m or 0.0,  # None without a geoid, and outside its grid
            source=f"the two heights of {height.name}",
            by_log=True,
        )
        return by_log, ()
    if abs(stated_m - logged_m) > USUAL_GEOID_M:
        differs = messages.stated_undulation_off(
            channel=height.name,
            rows=rows,
            stated_m=stated_m,
            own_m=logged_m,
            is_grave=_is_grave(stated_m - logged_m),
        )
        return system, (differs,)
    return system, ()


def _undulation_of_grid(geoid: GeoidGrid | None, channel: Channel) -> Array:
    """(n,) undulations [m] of a geoid at the places of a channel; all NaN without a geoid."""
    if geoid is None:
        return np.full(len(channel), np.nan)
    return geoid.undulation(channel["lat_rad"], channel["lon_rad"])


def _logged_home(position: Channel) -> tuple[float | None, Notes]:
    """The take-off height [m]: a position's height above sea level minus that above home.

    None if it is unknown, was not set in the whole log, or changes by more than `STEADY_HOME_M`.
    """
    h_msl_m = position.get("h_msl_m")
    above_home_m = position.get("h_home_m")
    homes_m = (h_msl_m - above_home_m)[home_is_set(h_msl_m, above_home_m)]
    homes_m = homes_m[np.isfinite(homes_m)]
    if homes_m.size == 0:
        return None, ()
    low_m, middle_m, high_m = np.percentile(homes_m, [5.0, 50.0, 95.0]).tolist()
    if high_m - low_m > STEADY_HOME_M:
        changes = messages.home_height_changes(channel=position.name, low_m=low_m, high_m=high_m)
        return None, (changes,)
    return middle_m, (messages.home_height(channel=position.name, height_m=middle_m),)


def _median(values: Array) -> float | None:
    """The median of the known (finite) values; None if all are unknown."""
    return float(np.nanmedian(values)) if np.isfinite(values).any() else None


def _is_grave(off_m: float) -> bool:
    """Whether an undulation is off by more than two sea levels can differ (`LARGEST_GEOID_M`)."""
    return abs(off_m) > LARGEST_GEOID_M


def undulation_notes(
    heights: HeightSystem, stations: Stations, egm96: GeoidGrid
) -> Iterator[Message]:
    """Report the undulations used at the stations, and whether they differ much from EGM96.

    Stations outside the grid of the geoid, where the undulation is unknown, are reported too.
    """
    has_place = np.isfinite(stations.lat_rad + stations.lon_rad)
    undulation_m = heights.undulation(stations.lat_rad[has_place], stations.lon_rad[has_place])
    is_known = np.isfinite(undulation_m)
    unknown = int(np.count_nonzero(~is_known))
    if unknown:
        yield messages.stations_outside_geoid(
            where="mission.geoid",  # the undulation of mission.undulation_m is known everywhere
            count=unknown,
            total=is_known.size,
            grid=heights.source if heights.geoid is None else heights.geoid.name,
        )
    if not bool(is_known.any()):
        return
    places = stations.rows(np.flatnonzero(has_place)[is_known])
    used_m = undulation_m[is_known]
    where = _origin_of_undulation(heights)
    used = _used_undulation(heights, places, used_m)
    yield messages.undulation_used(where=where, stations=used_m.size, used=used)

    egm96_m = egm96.undulation(places.lat_rad, places.lon_rad)
    off_m = float(np.median(used_m - egm96_m))
    if abs(off_m) <= USUAL_GEOID_M:
        return
    other_sign_off_m = float(np.median(-used_m - egm96_m))
    other_sign_fits = abs(other_sign_off_m) < USUAL_GEOID_M
    yield messages.undulation_off(
        where=where,
        stations=used_m.size,
        used=used,
        off_m=off_m,
        egm96_m=float(np.median(egm96_m)),
        other_sign_off_m=other_sign_off_m if other_sign_fits else None,
        is_grave=_is_grave(off_m),
    )


def _origin_of_undulation(heights: HeightSystem) -> str:
    """The key of the mission file that decides on the undulation."""
    if heights.by_log:
        return "log.channels.height"
    return "mission.geoid" if heights.undulation_m is None else "mission.undulation_m"


def _used_undulation(heights: HeightSystem, places: Stations, used_m: Array) -> str:
    """The smallest and the largest undulation at (s,) stations, in words.

    If the undulation is by the log, that between a station's own two heights counts where both are
    known; else ``used_m`` (s,).
    """
    shown_m = used_m
    if heights.by_log:
        logged_m = places.h_ellipsoid_m - places.h_msl_m
        shown_m = np.where(np.isfinite(logged_m), logged_m, used_m)
    ends = dict.fromkeys([f"{shown_m.min():.2f}", f"{shown_m.max():.2f}"])  # once if equal
    return f"undulation of {' to '.join(ends)} m, by {heights.source}"


def _difference(channel: Channel, first: str, second: str) -> Array:
    """(m,) known differences, first minus second column; empty if the channel lacks a column."""
    if first not in channel.columns or second not in channel.columns:
        return np.empty(0)
    difference = channel[first] - channel[second]
    return difference[np.isfinite(difference)]


def heights_at(
    height: Channel, time_ns: Integers, heights: HeightSystem, max_gap_s: float
) -> tuple[Array, Array]:
    """Heights above sea level (n,) and above the ellipsoid (n,) [m] at instants [Unix ns].

    A height that is not logged follows from the other one by the undulation. NaN where unknown.
    """
    h_msl = interpolate(height, "h_msl_m", time_ns, max_gap_s)
    h_ellipsoid = interpolate(height, "h_ellipsoid_m", time_ns, max_gap_s)
    if heights.one_height:  # the logged one is a copy of that above sea level
        h_ellipsoid = np.full(h_msl.shape, np.nan)
    if np.isnan(h_msl).any() or np.isnan(h_ellipsoid).any():
        undulation = _undulation_near(height, time_ns, heights)
        h_msl = np.where(np.isfinite(h_msl), h_msl, h_ellipsoid - undulation)
        h_ellipsoid = np.where(np.isfinite(h_ellipsoid), h_ellipsoid, h_msl + undulation)
    return h_msl, h_ellipsoid


def _undulation_near(height: Channel, time_ns: Integers, heights: HeightSystem) -> Array:
    """(n,) undulations [m] at instants, by the place of a channel's next sample with a place.

    That sample is within 0.2 km, in which a geoid rises by a centimetre. For instants after the
    last such sample it is that one. NaN if no sample has a place.
    """
    placed_rows = np.flatnonzero(np.isfinite(height["lat_rad"]) & np.isfinite(height["lon_rad"]))
    if placed_rows.size == 0:
        return np.full(time_ns.shape, np.nan)
    # The last stamp is left out of the search, so that later instants get the last row.
    row = placed_rows[np.searchsorted(height.time_ns[placed_rows[:-1]], time_ns)]
    return heights.undulation(height["lat_rad"][row], height["lon_rad"][row])


def ground_offsets(reference: str, stations: Stations, heights: HeightSystem) -> Array:
    """(s,) heights [m] to add to ground heights so that they are above mean sea level.

    ``reference`` is the surface from which ground heights count: msl (adds 0), ellipsoid (adds
    minus the undulation at the station) or relative (adds the height of the take-off point).
    Refuses (MissionError HEIGHT-REFERENCE) if the undulation or the take-off height is unknown.
    """
    n = len(stations)
    if reference == "msl":
        return np.zeros(n)
    if reference == "ellipsoid":
        undulation = stations.h_ellipsoid_m - stations.h_msl_m
        if stations.ok.any() and not np.isfinite(undulation[stations.ok]).any():
            raise messages.undulation_unknown()
        return -undulation
    return np.full(n, required_home_m(heights))


def required_home_m(heights: HeightSystem) -> float:
    """The height of the take-off point above sea level [m].

    Refuses (MissionError HEIGHT-REFERENCE) if it is unknown.
    """
    if heights.home_h_msl_m is not None:
        return heights.home_h_msl_m
    raise messages.home_unknown(begin_m=heights.begin_h_msl_m)


def with_begin_of_log(
    heights: HeightSystem,
    roles: Mapping[str, Channel],
    evidence: GroundEvidence,
    max_gap_s: float,
) -> HeightSystem:
    """Add the height at which the log begins (``begin_h_msl_m``) if the take-off height is unknown.

    Else, and without a position and heights, the system is returned unchanged.
    """
    position = roles.get("position")
    height = roles.get("height")
    if heights.home_h_msl_m is not None or position is None or height is None:
        return heights
    h_msl_m, _ = heights_at(height, position.time_ns, heights, max_gap_s)
    path = LoggedPath(position.time_ns, position["lat_rad"], position["lon_rad"], h_msl_m)
    begin = takeoff_of(path, None, evidence)
    return replace(heights, begin_h_msl_m=None if begin is None else begin.h_msl_m)


@dataclass(frozen=True)
class GeodeticOrigin:
    """The place where the local coordinates east, north and up are 0."""

    lat_rad: float
    lon_rad: float
    h_ellipsoid_m: float


def to_geodetic(channel: Channel, origin: GeodeticOrigin) -> Channel:
    """Add latitude, longitude and ellipsoidal height to a channel with local positions.

    It can then have the roles of height and position. A channel without ``east_m``, ``north_m``,
    ``up_m``, or with latitudes of its own, is returned unchanged.
    """
    if "east_m" not in channel.columns or "lat_rad" in channel.columns:
        return channel
    n = len(channel)
    enu = np.stack([channel["east_m"], channel["north_m"], channel["up_m"]], axis=1)
    lat_rad, lon_rad, h_ellipsoid_m = offset_geodetic(
        np.full(n, origin.lat_rad),
        np.full(n, origin.lon_rad),
        np.full(n, origin.h_ellipsoid_m),
        enu,
    )
    places = {"lat_rad": lat_rad, "lon_rad": lon_rad, "h_ellipsoid_m": h_ellipsoid_m}
    return replace(
        channel,
        columns=dict(channel.columns) | places,
        roles=(*channel.roles, "height", "position"),
    )


_LONGEST_TERRAIN_GAP_S = 5.0  # between two heights of the autopilot's terrain
_TERR_STATUS_OK = 2.0  # of ArduPilot's TERR: the grid is loaded


def logged_terrain(channels: Iterable[Channel], time_ns: Integers) -> Array:
    """(n,) terrain heights above sea level [m] below the vehicle at times; NaN if none is logged.

    For checks only: ArduPilot's grid is SRTM at 100 m, with errors of some 10 m (90 %) in open
    country. Rows count if the autopilot had its grid: TERR of status 2, TERRAIN_REPORT with a
    spacing and a place. Of several channels the first that has a height at an instant counts.
    """
    terrain_m = np.full(time_ns.size, np.nan)
    for channel in channels:
        if "h_terrain_m" not in channel.columns:
            continue
        is_placed = channel.get("lat_rad") != 0.0
        is_usable_report = (channel.get("terrain_spacing_m") > 0.0) & is_placed
        is_usable_terr = channel.get("terrain_status") == _TERR_STATUS_OK
        is_usable = is_usable_report | is_usable_terr
        usable_m = np.where(is_usable, channel["h_terrain_m"], np.nan)
        usable = replace(channel, columns={"h_terrain_m": usable_m}, labels={})
        logged_m = interpolate(usable, "h_terrain_m", time_ns, _LONGEST_TERRAIN_GAP_S)
        terrain_m = np.where(np.isnan(terrain_m), logged_m, terrain_m)
    return terrain_m
