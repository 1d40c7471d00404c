"""How near a sounding or a report is to a flight, in time and place, and what it says from there.

The air's departure from its climatology is carried on: after a time t and over a distance d it
correlates by rho = exp(-t/tau - (d/L)^2/2) with what it was. An old or far reading with an error
of variance s^2 (1/rho^2 - 1), where s is the spread of the climatology, weighs rho^2: as much as
it is worth, and nothing at last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport
from pipeline.ledger import Ledger

SPREAD_K, SPREAD_RH = 5.0, 0.3
"""Of the climatology in the free troposphere."""

MEMORY_H = 167.0
"""tau: the variance of temperature grows by 0.3 K2 an hour, 0.95 K in three hours, 2.9 K in a day.
Sun et al. 2010 (J. Geophys. Res. 115, D23104) find 0.35 K per 3 h in the free troposphere, linear
up to 6 h: 2.8 K in a day. Two pairs of ascents over Barrow differ by 1.0 to 2.3 K in 12 hours."""

MEMORY_M = 1.19e6
"""L: 0.42 K per 100 km, the figure of the same paper for soundings up to 250 km apart."""

FAR_M = 200e3
"""A sounding from farther away is said to be: 0.9 K."""

NOTHING = 9.0
"""A reading whose variance is that many times the climatology's weighs a tenth: after 8 days, or
1800 km. It is left out."""

UNDATED_SOUNDING_H, UNDATED_REPORT_H, UNPLACED_M = 6.0, 3.0, 100e3
"""Soundings are released every twelve hours, and a station near the flight is meant."""

_EARTH_M = 6.371e6
_MOST_EXPONENT = 50.0  # exp of it is finite, and far beyond NOTHING


@dataclass(frozen=True)
class TimeAndPlace:
    """When [Unix ns] and where [rad] a flight was; None and NaN where nobody knows."""

    time_ns: int | None = None
    latitude_rad: float = math.nan
    longitude_rad: float = math.nan

    def hours_from(self, time_ns: int | None) -> float:
        """Hours to another time, NaN where either is not known.

        >>> TimeAndPlace(3_600_000_000_000).hours_from(0)
        1.0
        """
        if self.time_ns is None or time_ns is None:
            return math.nan
        return abs(self.time_ns - time_ns) / 3.6e12

    def metres_from(self, latitude_rad: float, longitude_rad: float) -> float:
        """Great-circle distance [m]; along the meridian without a longitude, NaN without both.

        >>> round(TimeAndPlace(None, 0.0, 0.0).metres_from(0.0, 0.1))
        637100
        """
        north = latitude_rad - self.latitude_rad
        east = longitude_rad - self.longitude_rad
        if not math.isfinite(north):
            return math.nan
        east = east if math.isfinite(east) else 0.0
        squeezed = math.cos(latitude_rad) * math.cos(self.latitude_rad)
        half_chord = math.sin(0.5 * north) ** 2 + squeezed * math.sin(0.5 * east) ** 2
        return 2.0 * _EARTH_M * math.asin(math.sqrt(min(half_chord, 1.0)))


def unlikeness(hours: float, metres: float = 0.0) -> float:
    """1/rho^2 - 1: variance of what the air has become, over that of the climatology.

    >>> [round(SPREAD_K * unlikeness(*apart) ** 0.5, 2) for apart in ((3.0, 0.0), (0.0, 1e5))]
    [0.96, 0.42]
    """
    exponent = 2.0 * hours / MEMORY_H + (metres / MEMORY_M) ** 2
    return math.expm1(min(exponent, _MOST_EXPONENT))


def apart(source: Sounding | SurfaceReport, occasion: TimeAndPlace) -> tuple[float, float]:
    """Hours and metres between a source and the flight.

    Six hours and 100 km where those of a sounding are not known; three hours, and no distance, of
    a surface report: a station near the flight is meant.
    """
    hours, metres, undated_h = occasion.hours_from(source.time_ns), 0.0, UNDATED_REPORT_H
    if isinstance(source, Sounding):
        undated_h = UNDATED_SOUNDING_H
        metres = occasion.metres_from(source.latitude_rad, source.longitude_rad)
    return (
        hours if math.isfinite(hours) else undated_h,
        metres if math.isfinite(metres) else UNPLACED_M,
    )


def says_nothing(source: Sounding | SurfaceReport, occasion: TimeAndPlace) -> str | None:
    """Why a source is too old or too far away to say anything of the flight's air, in words.

    >>> says_nothing(SurfaceReport(0.0, 1e5, 280.0, 800.0, time_ns=0), TimeAndPlace(10**15))
    'it is 278 hours from the flight: the climatology knows as much'
    """
    hours, metres = apart(source, occasion)
    if unlikeness(hours, metres) <= NOTHING:
        return None
    if unlikeness(hours) > NOTHING:
        far = f"{hours:.0f} hours"
    elif unlikeness(0.0, metres) > NOTHING:
        far = f"{metres / 1e3:.0f} km"
    else:
        far = f"{hours:.0f} hours and {metres / 1e3:.0f} km"
    return f"it is {far} from the flight: the climatology knows as much"


def note_source_distances(
    soundings: Sequence[Sounding],
    surface: Sequence[SurfaceReport],
    occasion: TimeAndPlace,
    ledger: Ledger,
) -> None:
    """Say which sources have no time or place, and which soundings come from far away."""
    for sounding in soundings:
        name = sounding.name
        if sounding.time_ns is None:
            ledger.fallback(
                "SOUNDING-UNDATED",
                f"the sounding has no time: it is taken as {UNDATED_SOUNDING_H:.0f} hours from the "
                "flight",
                where=name,
            )
        metres = occasion.metres_from(sounding.latitude_rad, sounding.longitude_rad)
        if not math.isfinite(metres) and math.isfinite(occasion.latitude_rad):
            ledger.fallback(
                "SOUNDING-UNPLACED",
                f"the sounding has no position: it is taken as {UNPLACED_M / 1e3:.0f} km from the "
                "flight",
                where=name,
            )
        if metres > FAR_M:
            more = unlikeness(0.0, metres)
            worth = f"temperatures are {SPREAD_K * math.sqrt(more):.1f} K less certain for that"
            ledger.warning(
                "SOUNDING-FAR-AWAY",
                f"the sounding is {metres / 1e3:.0f} km from the flight: "
                + (worth if more <= NOTHING else "it says nothing of its air"),
                where=name,
            )
    for report in surface:
        if report.time_ns is None and occasion.time_ns is not None:
            ledger.fallback(
                "SURFACE-UNDATED",
                f"the report has no time: it is taken as {UNDATED_REPORT_H:.0f} hours from the "
                "flight",
                where=report.name,
            )
