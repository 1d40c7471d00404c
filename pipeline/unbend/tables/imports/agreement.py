"""A trajectory, or the positions of camera events, against the log: time, place, height, attitude.

What cannot belong to the flight of the log is refused with what would make it fit; what differs
more than autopilots err is a warning or a loss.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.flight.channels import Channel
from unbend.flight.heights import HeightSystem, heights_at
from unbend.flight.rotations import ANGLE_MISTAKES, UNIT_MISTAKES
from unbend.flight.trajectory import attitude_at
from unbend.geodesy import principal_radii, wrapped
from unbend.messages import Kind, Ledger
from unbend.tables.imports import messages
from unbend.units import RADIANS, Array, Integers, Rows

_MOST_SAMPLES = 3000
_MAX_GAP_S = 5.0
_FEWEST = 20

# Seconds by which clocks are usually set wrong: leap seconds and their like, and time zones.
_SHIFTS_S = np.concatenate([np.arange(-60.0, 60.1, 0.5), 3600.0 * np.arange(-14.0, 14.1, 0.5)])

# Limits of place and height [m], tilt and yaw [deg] and time [s]: beyond the first a warning,
# beyond the second a loss. Autopilots are within the first.
_LIMITS = {
    "place": (5.0, 20.0), "height": (10.0, 30.0), "tilt": (3.0, 20.0), "yaw": (10.0, 30.0),
    "time": (0.15, 0.75),
}  # fmt: skip
_OTHER_FLIGHT_M, _LARGE_TURN_DEG, _SMALL_TURN_DEG = 100.0, 5.0, 2.0
_ORDERS = ("ZYX", "ZXY", "YXZ", "YZX", "XYZ", "XZY")

_Change = Callable[[Array, Array], tuple[Array, Array]]
_OF_PLACE: Mapping[str, _Change] = {
    "with latitude and longitude exchanged": lambda lat, lon: (lon, lat),
    "with the opposite sign of the longitude": lambda lat, lon: (lat, -lon),
    "read as radians": lambda lat, lon: (lat / RADIANS["deg"], lon / RADIANS["deg"]),
    "read as degrees": lambda lat, lon: (lat * RADIANS["deg"], lon * RADIANS["deg"]),
    "read as grads": lambda lat, lon: (lat * 0.9, lon * 0.9),
}
"""Mistakes about the columns of positions, and what undoes them."""


def compare_with_log(
    imported: Channel,
    own: Mapping[str, Channel],
    heights: HeightSystem,
    ledger: Ledger,
    *,
    replaces: tuple[str, ...],
    angle_order: str = "ZYX",
) -> None:
    """Compare an imported channel with what the log itself has in the same roles.

    Refuses (MissionError) other times (TRAJECTORY-OVERLAP, TRAJECTORY-TIME), another place
    (TRAJECTORY-PLACE), heights above the other surface (TRAJECTORY-HEIGHT) and attitudes in another
    unit, sense or order (TRAJECTORY-ANGLES), where the log shows it. ``angle_order`` is that by
    which roll, pitch and yaw became its attitude.
    """
    position, known = own.get("position"), np.flatnonzero(np.isfinite(imported["lat_rad"]))
    if position is None or len(position) < 2 or known.size == 0:
        ledger.add(messages.trajectory_alone(where=imported.name))
        return
    rows = known[np.unique(np.linspace(0, known.size - 1, _MOST_SAMPLES).astype(int))]
    _compare_places(imported, rows, _Track(position), ledger)
    if "height" in replaces and "height" in own:
        _compare_heights(imported, rows, own["height"], heights, ledger)
    if "attitude" in replaces and "attitude" in own:
        theirs = attitude_at(own["attitude"], imported.time_ns[rows], _MAX_GAP_S).quaternion
        mine = np.stack([imported[f"q_{axis}"][rows] for axis in "wxyz"], axis=1)
        _compare_attitudes(imported.name, mine, theirs, angle_order, ledger)


class _Track:
    """The log's positions in metres about their middle, and how far others are from them."""

    def __init__(self, position: Channel) -> None:
        keep = np.isfinite(position["lat_rad"]) & np.isfinite(position["lon_rad"])
        lat, lon = position["lat_rad"][keep], position["lon_rad"][keep]
        self.name, self.time_ns = position.name, position.time_ns[keep]
        self._origin = float(np.median(lat)), float(lon[lon.size // 2])
        self._seconds = (self.time_ns - self.time_ns[0]) * 1e-9
        self._own = self.metres(lat, lon)

    def metres(self, lat: Array, lon: Array) -> NDArray[np.complex128]:
        """North + 1j east from the origin, good to a thousandth within 100 km [m]."""
        meridian, vertical = principal_radii(self._origin[0])
        east = wrapped(lon - self._origin[1]) * vertical * np.cos(self._origin[0])
        return np.asarray((lat - self._origin[0]) * meridian + 1j * east)

    def distances(self, time_ns: Integers, places: NDArray[np.complex128], shift_s: float) -> Array:
        """From the log's positions ``shift_s`` later; of those the log has, without gaps [m]."""
        at, seconds = (time_ns - self.time_ns[0]) * 1e-9 + shift_s, self._seconds
        after = np.clip(np.searchsorted(seconds, at), 1, seconds.size - 1)
        near = seconds[after] - seconds[after - 1] <= _MAX_GAP_S
        inside = (at >= seconds[0]) & (at <= seconds[-1]) & near
        return np.asarray(np.abs(places[inside] - np.interp(at[inside], seconds, self._own)))


def _compare_places(imported: Channel, rows: Rows, track: _Track, ledger: Ledger) -> None:
    """Position and time offset against the log's positions."""
    places = track.metres(imported["lat_rad"][rows], imported["lon_rad"][rows])
    at = [track.distances(imported.time_ns[rows], places, shift) for shift in _SHIFTS_S.tolist()]
    fewest = max(distance.size for distance in at) / 2

    def misfit(distance: Array) -> float:
        """Median [m], where half of the places are within the log."""
        return float(np.median(distance)) if distance.size >= max(fewest, 1) else 1e9

    from scipy.optimize import minimize_scalar  # a fifth of a second, and few runs need it

    coarse = _SHIFTS_S[np.argmin([misfit(distance) for distance in at])]
    fine = minimize_scalar(
        lambda shift: misfit(track.distances(imported.time_ns[rows], places, float(shift))),
        bounds=(coarse - 0.5, coarse + 0.5), method="bounded", options={"xatol": 1e-3},
    )  # fmt: skip
    shift, best = float(fine.x), float(fine.fun)
    distance = track.distances(imported.time_ns[rows], places, 0.0)
    now = float(np.median(distance)) if distance.size else np.inf
    better = best < 0.5 * now and now - best > 2.0
    far = now > _LIMITS["place"][0] and abs(shift) > _LIMITS["time"][1]
    if better and far and best < _OTHER_FLIGHT_M:
        raise messages.trajectory_time(
            where=imported.name, shift_s=shift, log=track.name, best_m=best, now_m=now
        )
    if distance.size == 0:
        spans = _span(imported.time_ns), _span(track.time_ns)
        raise messages.trajectory_overlap(where=imported.name, own=spans[0], log=spans[1])
    if now > _OTHER_FLIGHT_M:
        hints = ""
        for mistake, undone in _OF_PLACE.items():
            other = track.metres(*undone(imported["lat_rad"], imported["lon_rad"]))
            if (away := float(np.nanmedian(np.abs(other)))) < 0.01 * now:
                hints += f"; {mistake} it is {_metres(away)} from the centre of the flight"
        raise messages.trajectory_place(
            where=imported.name, away=_metres(now), log=track.name, hints=hints
        )
    most_m = float(np.percentile(distance, 95.0))
    sizes = {"place": max(now, most_m), "time": abs(shift) if better else 0.0}
    agrees = messages.trajectory_agrees(
        kind=_grade(sizes),
        where=imported.name,
        count=distance.size,
        log=track.name,
        median_m=now,
        most_m=most_m,
        shift_s=shift,
        shifted_m=best,
    )
    ledger.add(agrees)


def _compare_heights(
    imported: Channel, rows: Rows, own: Channel, heights: HeightSystem, ledger: Ledger
) -> None:
    """Heights against the log's, above the same surface and above the other."""
    column = imported.height_column or "h_msl_m"
    names = ("msl", "ellipsoid") if column == "h_msl_m" else ("ellipsoid", "msl")
    msl, ellipsoid = heights_at(own, imported.time_ns[rows], heights, _MAX_GAP_S)
    of_log = (msl, ellipsoid) if column == "h_msl_m" else (ellipsoid, msl)
    same, other = (imported[column][rows] - h for h in of_log)
    if not np.isfinite(same).any():
        ledger.add(messages.trajectory_height_alone(where=imported.name))
        return
    apart = float(np.nanmedian(same))
    by_other = float(np.nanmedian(other)) if np.isfinite(other).any() else np.inf
    if abs(apart) > _LIMITS["height"][0] and abs(by_other) < abs(apart) / 3.0:
        raise messages.trajectory_height(
            where=imported.name,
            apart=apart,
            own=own.name,
            same=names[0],
            by_other=by_other,
            other=names[1],
        )
    spread = float(np.nanpercentile(np.abs(same - apart), 95.0))
    agrees = messages.trajectory_height_agrees(
        kind=_grade({"height": max(abs(apart), spread)}),
        where=imported.name,
        count=rows.size,
        log=own.name,
        apart_m=apart,
        spread_m=spread,
    )
    ledger.add(agrees)


def _compare_attitudes(
    name: str, mine: Array, theirs: Array, angle_order: str, ledger: Ledger
) -> None:
    """Attitudes (n, 4) w, x, y, z against the log's, about the body's axes."""
    known = np.isfinite(mine).all(axis=1) & np.isfinite(theirs).all(axis=1)
    if not known.any():
        ledger.add(messages.trajectory_angles_alone(where=name))
        return
    own, imported = (Rotation.from_quat(q[known][:, [1, 2, 3, 0]]) for q in (theirs, mine))
    angles = imported.as_euler("ZYX")

    def apart(attitude: Rotation) -> float:
        return float(np.degrees(np.percentile((own.inv() * attitude).magnitude(), 90.0)))

    # Few attitudes, as of some events, do not separate one mistake from another.
    size = apart(imported) if np.count_nonzero(known) >= _FEWEST else 0.0
    for mistake, undone in (
        (UNIT_MISTAKES | ANGLE_MISTAKES).items() if size > _LARGE_TURN_DEG else ()
    ):
        left = apart(Rotation.from_euler("ZYX", np.stack(undone(*angles.T[::-1])[::-1], axis=1)))
        if left < min(_LARGE_TURN_DEG, size / 3.0):
            mistake = mistake.format("roll", "pitch", "yaw")
            raise messages.trajectory_angles_columns(
                where=name, size_deg=size, mistake=mistake, left_deg=left
            )
    # The angle about each axis, as the file has it, in another order of the rotations.
    seq: Any = angle_order
    about = dict(zip(seq, imported.as_euler(seq).T, strict=True))
    for order in _ORDERS if size > _SMALL_TURN_DEG else ():
        again = Rotation.from_euler(order, np.stack([about[axis] for axis in order], axis=1))
        left = apart(again)
        if order != angle_order and left < min(_LARGE_TURN_DEG, size / 3.0):
            raise messages.trajectory_angles(where=name, size_deg=size, order=order, left_deg=left)
    cosine = np.sum(own.as_matrix()[:, 2] * imported.as_matrix()[:, 2], axis=1)
    tilt = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))
    yaw = float(np.degrees(np.median(wrapped(angles[:, 0] - own.as_euler("ZYX")[:, 0]))))
    agrees = messages.trajectory_angles_agree(
        kind=_grade({"tilt": tilt, "yaw": abs(yaw)}),
        where=name,
        count=int(known.sum()),
        tilt_deg=tilt,
        yaw_deg=yaw,
    )
    ledger.add(agrees)


def _grade(sizes: Mapping[str, float]) -> Kind:
    """How serious the worst of some differences is, by their names in `_LIMITS`."""
    level = max(sum(size > limit for limit in _LIMITS[name]) for name, size in sizes.items())
    return (Kind.NOTE, Kind.WARNING, Kind.LOSS)[level]


def _metres(distance: float) -> str:
    return f"{distance / 1000.0:,.0f} km" if distance > 10_000.0 else f"{distance:.0f} m"


def _span(time_ns: Integers) -> str:
    first, last = time_ns[[0, -1]].astype("datetime64[ns]").astype("datetime64[s]")
    return f"{first} to {last} UTC"
