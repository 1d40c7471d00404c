"""What the mission file states of a file of another program, and what every such file needs.

Text, times in UTC, and a channel in the order of time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.flight.channels import Array, Channel, Source, TimeArray
from pipeline.flight.clock import SECONDS_PER_WEEK, utc_of_gps
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND, UNIX_NS_OF_GPS_EPOCH

AngleUnit = Literal["deg", "rad", "grad"]
RADIANS: Mapping[str, float] = {"deg": np.pi / 180.0, "rad": 1.0, "grad": np.pi / 200.0}
"""Units of angles [rad]."""

_WEEK_NS = SECONDS_PER_WEEK * NANOSECONDS_PER_SECOND


@dataclass(frozen=True)
class Stated:
    """What the mission file says of a file, None where it says nothing.

    Parameters
    ----------
    time_system : gpst or utc.
    week : GPS week of the first row, where the file has seconds of the week.
    around_ns : first and last time of the log [Unix ns]: they give the week that is not stated.
    heights : ellipsoid or msl.
    accuracy : the file of standard deviations that belongs to an SBET.
    columns : quantity -> name of the column, of a CSV.
    position_unit, angle_unit : of latitude and longitude, and of the attitude, in a CSV.
    angle_order : intrinsic rotations about z, y and x, as ``ZYX``.
    """

    time_system: Literal["gpst", "utc"] | None = None
    week: int | None = None
    around_ns: tuple[int, int] | None = None
    heights: Literal["ellipsoid", "msl"] | None = None
    accuracy: Path | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    position_unit: AngleUnit = "deg"
    angle_unit: AngleUnit = "deg"
    angle_order: str = "ZYX"


def read_text(path: Path) -> list[str]:
    """The lines of a text file; refuses one that cannot be read or is no text."""
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise not_of_format(path, f"it cannot be read as text: {error}") from None


def number(text: str) -> float:
    """The number of a field, NaN where it is none; -0 keeps its sign."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def not_of_format(path: Path, why: str, remedy: str = "") -> InputError:
    """The refusal of a file that is not what its format says."""
    return InputError(
        "IMPORT-FORMAT",
        why,
        where=str(path),
        remedy=remedy or "name the format of the file, or export it again",
    )


def settled(path: Path, key: str, found: str | None, stated: str | None) -> str:
    """What a file says of itself or the mission file of it; they may not contradict each other."""
    if found is not None and stated not in (None, found):
        raise InputError(
            "IMPORT-CONTRADICTED",
            f"by its header {key} is {found}, by the mission file {stated}",
            where=str(path),
            remedy=f"leave {key} out, or export the file again",
        )
    known = found or stated
    if known is None:
        raise InputError(
            "IMPORT-UNSTATED",
            f"the file does not say its {key}: GPS time is 18 s ahead of UTC since 2017, heights "
            "above ellipsoid and sea are up to 107 m apart",
            where=str(path),
            remedy="give time: {system: gpst} or {system: utc}, and heights: ellipsoid or msl",
        )
    return known


def height_column(path: Path, stated: Stated, found: str | None = None) -> str:
    """The channel's column for the heights of a file."""
    known = settled(path, "heights", found, stated.heights)
    return "h_ellipsoid_m" if known == "ellipsoid" else "h_msl_m"


def time_system(path: Path, stated: Stated, found: str | None = None) -> str:
    """The time system of a file: gpst or utc."""
    return settled(path, "time.system", found, stated.time_system)


def utc_of_calendar(time_ns: TimeArray, system: str) -> TimeArray:
    """UTC of dates and times of day in GPS time or UTC, as if Unix time [ns]."""
    if system == "utc":
        return time_ns
    since = time_ns - UNIX_NS_OF_GPS_EPOCH
    return utc_of_gps(since // _WEEK_NS, (since % _WEEK_NS) / NANOSECONDS_PER_SECOND)


def utc_of_week_seconds(
    path: Path, seconds: Array, stated: Stated, system: str, week: Array | None = None
) -> TimeArray:
    """UTC of seconds of the week; ``week`` (n,) where the file has it.

    Seconds that begin anew belong to the next week. Without a week it is the stated one, or that
    in which most of the file lies within the log.
    """
    known = np.where(np.isfinite(seconds), seconds, 0.0)
    if week is None:
        known = known + SECONDS_PER_WEEK * np.cumsum(
            np.diff(known, prepend=known[:1]) < -SECONDS_PER_WEEK / 2
        )

    def utc(weeks: Array | int) -> TimeArray:
        if system == "gpst":
            return utc_of_gps(weeks, known)
        start = UNIX_NS_OF_GPS_EPOCH + np.asarray(weeks, np.int64) * _WEEK_NS
        return np.asarray(start + np.rint(known * 1e9).astype(np.int64), np.int64)

    if week is not None:
        return utc(np.where(np.isfinite(week), week, 0.0))
    if stated.week is not None:
        return utc(stated.week)
    if stated.around_ns is None:
        raise InputError(
            "IMPORT-WEEK",
            "it has seconds of the week, and nothing says of which week",
            where=str(path),
            remedy="give time: {week: NUMBER}, counted from 1980-01-06",
        )
    first, last = stated.around_ns
    middle = (first + last) // 2 - UNIX_NS_OF_GPS_EPOCH

    def inside(candidate: int) -> float:
        time_ns = utc(candidate)
        return float(np.count_nonzero((time_ns >= first) & (time_ns <= last)))

    at = int(middle // _WEEK_NS)
    return utc(max((at, at - 1, at + 1), key=inside))


def channel_of_rows(
    path: Path,
    kind: str,
    time_ns: TimeArray,
    columns: Mapping[str, Array],
    ledger: Ledger,
    *,
    readable: NDArray[np.bool_],
    labels: Mapping[str, tuple[str, ...]] | None = None,
) -> Channel:
    """A channel called like the file, in the order of time, without rows that cannot be read.

    ``readable`` (n,) False where a row is damaged or repeats a time; these rows are a loss. The
    positions of no row may be outside the earth's coordinates.
    """
    order = np.argsort(time_ns, kind="stable")
    again = np.zeros(time_ns.shape, np.bool_)
    in_order = order[readable[order]]
    again[in_order[1:]] = np.diff(time_ns[in_order]) == 0
    for bad, what in ((~readable, "cannot be read"), (again, "repeat the time of another")):
        if bool(bad.any()):
            count = int(np.count_nonzero(bad))
            ledger.loss(
                "IMPORT-ROWS",
                f"{count} of {time_ns.size} rows {what} and are not used, the first is row "
                f"{int(np.argmax(bad)) + 1}",
                where=path.name,
                count=count,
            )
    rows = in_order[~again[in_order]]
    if rows.size == 0:
        raise not_of_format(path, "none of its rows can be read")
    worst = float(np.fmax.reduce(np.abs(columns["lat_rad"][rows]), initial=0.0))
    if worst > np.pi / 2.0:
        raise InputError(
            "IMPORT-RANGE",
            f"a latitude of {np.degrees(worst):.2f} degrees: it is a longitude, or in another unit",
            where=str(path),
            remedy="exchange the columns of latitude and longitude, or state the unit that it has",
        )
    return Channel(
        path.name,
        time_ns[rows],
        {name: values[rows] for name, values in columns.items()},
        Source(kind),
        labels={
            name: tuple(np.array(values, dtype=object)[rows])
            for name, values in (labels or {}).items()
        },
    )
