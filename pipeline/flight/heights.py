"""Heights above sea level and above the ellipsoid, each from the other where it must be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.flight.channels import Channel
from pipeline.flight.stations import Stations
from pipeline.flight.trajectory import interpolate
from pipeline.ledger import Ledger

Array = NDArray[np.float64]


STEADY_HOME_M = 2.0
"""The take-off height of a flight does not change by more than this [m]."""


@dataclass(frozen=True)
class HeightSystem:
    """How the two kinds of height go together; None where the log and the user do not say."""

    undulation_m: float | None = None
    home_h_msl_m: float | None = None


def height_system(
    roles: Mapping[str, Channel], stated_undulation_m: float | None, ledger: Ledger
) -> HeightSystem:
    """Undulation and take-off height, from the mission file or the log itself."""
    undulation = stated_undulation_m
    height = roles.get("height")
    if undulation is None and height is not None:
        both = _difference(height, "h_ellipsoid_m", "h_msl_m")
        if both.size:
            undulation = float(np.median(both))
            _warn_of_one_height(height, both, ledger)
            ledger.note(
                "HEIGHT-UNDULATION",
                f"undulation {undulation:.2f} m, from the two heights of {height.name}",
                where=height.name,
                count=int(both.size),
            )
    position = roles.get("position")
    home = _home(position, ledger) if position is not None else None
    return HeightSystem(undulation, home)


def _warn_of_one_height(height: Channel, both: Array, ledger: Ledger) -> None:
    """Say that a receiver gives one height under two names, as some on a CAN bus do."""
    if not both.any():
        ledger.warning(
            "HEIGHT-SAME",
            f"both heights of {height.name} are equal to the last digit in {both.size} rows: one "
            "is a copy of the other, and which of them is meant is unknown; the undulation is "
            "hardly anywhere 0 (-107 to 86 m), give mission.undulation_m",
            where=height.name,
            count=int(both.size),
        )


def _home(position: Channel, ledger: Ledger) -> float | None:
    """Height of the take-off point above sea level [m], if the log has one and only one.

    Before an autopilot sets its home, it gives both heights alike; those rows do not count.
    """
    home = _difference(position, "h_msl_m", "h_home_m")
    is_set = np.abs(home) > 0.01
    home = home[is_set] if bool(is_set.any()) else home
    if home.size == 0:
        return None
    low, middle, high = np.percentile(home, [5.0, 50.0, 95.0])
    if high - low > STEADY_HOME_M:
        ledger.note(
            "HEIGHT-HOME",
            f"the take-off height of {position.name} changes between {low:.1f} and {high:.1f} m: "
            "it is not used",
            where=position.name,
        )
        return None
    ledger.note("HEIGHT-HOME", f"take-off height {middle:.2f} m", where=position.name)
    return float(middle)


def _difference(channel: Channel, first: str, second: str) -> Array:
    if first not in channel.columns or second not in channel.columns:
        return np.empty(0)
    difference = channel[first] - channel[second]
    return difference[np.isfinite(difference)]


def heights_at(
    height: Channel, time_ns: NDArray[np.int64], heights: HeightSystem, max_gap_s: float
) -> tuple[Array, Array]:
    """Heights above sea level and above the ellipsoid, each from the other where it must be."""
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
