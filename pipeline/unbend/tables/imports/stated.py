"""Statements of the mission file about a file of another program, and steps that all readers share.

These are the time system, the week of seconds, the surface of heights, and a channel in the order
of time.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from unbend.flight.channels import Channel, Source, TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK
from unbend.flight.survey_dates import can_be_flown
from unbend.geodesy import GeoidGrid
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.text_columns import utc_of_weeks
from unbend.units import (
    LARGEST_HEIGHT_M,
    NANOSECONDS_PER_SECOND,
    UNIX_NS_OF_GPS_EPOCH,
    AngleUnit,
    Array,
    Integers,
    Mask,
)

LARGEST_LONGITUDE_RAD = 2.0 * np.pi  # files count to ±180 or to 360 deg
HEIGHT_COLUMNS = {"h_ellipsoid_m", "h_msl_m"}
LARGEST_SIGMA = 1e6  # metres or radians: programs write larger ones for an unknown place
FASTEST_M_S = 1000.0  # no aircraft that takes images is as fast
LONGEST_ARM_M = 1000.0  # from an antenna to a camera
LONGEST_NORM_ERROR = 0.0101  # of quaternions: four numbers of two decimals err by 0.01
_QUATERNION = ("q_w", "q_x", "q_y", "q_z")


def as_written(angles: Array) -> Array:
    """The angles of a file without a change."""
    return angles


@dataclass(frozen=True)
class Stated:
    """Statements of the mission file about a file; None where it does not state one.

    Parameters
    ----------
    time_system : gpst or utc.
    week : GPS week of the first row, where the file has seconds of the week.
    around_ns : first and last time of the log [Unix ns]: they give the week that is not stated.
    heights : ellipsoid or msl.
    accuracy : the file of standard deviations that belongs to an SBET.
    columns : quantity -> name of the column, of a CSV.
    unstated : quantities without a stated column, read from a table of orientations that this
        package has written.
    position_unit, angle_unit : of latitude and longitude, and of the attitude, in a CSV.
    angle_order : intrinsic rotations about z, y and x, as ``ZYX``.
    crs, geoid : coordinate system of a CSV, and the user's grid for its heights.
    grid : the projected coordinate system with the axes of omega, phi and kappa.
    angles_meant : function that corrects angles (n, 3) [rad], in the order in which they turn or as
        roll, pitch, yaw; by default it returns them unchanged. Other readings of a file, such as
        the opposite sign of an angle, are tried with it.
    """

    time_system: Literal["gpst", "utc"] | None = None
    week: int | None = None
    around_ns: tuple[int, int] | None = None
    heights: Literal["msl", "ellipsoid"] | None = None
    accuracy: Path | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    unstated: tuple[str, ...] = ()
    position_unit: AngleUnit = "deg"
    angle_unit: AngleUnit = "deg"
    angle_order: str = "ZYX"
    crs: str | None = None
    geoid: GeoidGrid | None = None
    grid: str | None = None
    angles_meant: Callable[[Array], Array] = as_written

    def system_of(self, path: Path, ledger: Ledger, by_header: str | None = None) -> str:
        """The time system of a file, gpst or utc, as stated, else by its header.

        ``by_header`` is the system that the file itself states, None without one.
        """
        key = "time.system"
        system = _stated_or_header(path, key, by_header, self.time_system, ledger)
        if system is None:
            raise messages.time_system_unstated(where=path)
        return system

    def height_column(self, path: Path, ledger: Ledger, by_header: str | None = None) -> str:
        """The channel's column for the heights of a file: h_ellipsoid_m or h_msl_m.

        ``by_header`` is the surface that the file itself states, ellipsoid or msl, None without.
        """
        surface = _stated_or_header(path, "heights", by_header, self.heights, ledger)
        if surface is None:
            raise messages.heights_unstated(where=path)
        return "h_ellipsoid_m" if surface == "ellipsoid" else "h_msl_m"

    def utc_of_week_seconds(self, path: Path, seconds: Array, system: str) -> TimeArray:
        """UTC (n,) of ``seconds`` (n,) of a week that the file does not state.

        The week is the stated one, or the week with the most rows within the time of the log. Where
        the seconds start again near 0, the next week begins. Unknown seconds (NaN or negative) give
        0. ``system`` is gpst or utc.
        """
        known_seconds = np.where(seconds >= 0.0, seconds, np.nan)
        without_gaps = np.asarray(pd.Series(known_seconds).ffill().bfill(), np.float64)
        steps = np.diff(without_gaps, prepend=without_gaps[:1])
        is_new_week = steps < -SECONDS_PER_WEEK / 2
        seconds = known_seconds + SECONDS_PER_WEEK * np.cumsum(is_new_week)
        if self.week is not None:
            return utc_of_weeks(self.week, seconds, system)
        if self.around_ns is None:
            raise messages.week_unknown(where=path)
        first, last = self.around_ns

        def rows_in_log(time_ns: TimeArray) -> int:
            return int(np.sum((time_ns >= first) & (time_ns <= last)))

        middle_of_log_ns = (first + last) // 2 - UNIX_NS_OF_GPS_EPOCH
        week = middle_of_log_ns // (SECONDS_PER_WEEK * NANOSECONDS_PER_SECOND)
        weeks = (week, week - 1, week + 1)  # where several fit equally, the first is used
        candidates = [utc_of_weeks(candidate, seconds, system) for candidate in weeks]
        return max(candidates, key=rows_in_log)


def _stated_or_header(
    path: Path,
    key: str,
    by_header: str | None,
    stated: str | None,
    ledger: Ledger,
) -> str | None:
    """The value that the mission file states for ``key``, else that of the file's header.

    None if neither states it. A contradiction between both is reported.
    """
    if by_header is not None and stated not in (None, by_header):
        contradicted = messages.header_contradicted(
            where=path.name, key=key, found=by_header, stated=str(stated)
        )
        ledger.add(contradicted)
    return stated or by_header


def read_text(path: Path) -> list[str]:
    """The lines of a UTF-8 text file that are not blank; refuses a file that is not text."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise messages.not_text(where=path, error=str(error)) from None
    return [line for line in lines if line.strip()]


def _is_place_possible(columns: Mapping[str, Array]) -> Mask:
    """(n,) False where the place is 0, 0, as programs write an unknown one, or not on earth.

    True where the place is NaN: a row without a position is kept for its other columns.
    """
    is_at_equator = columns["lat_rad"] == 0.0
    is_at_greenwich = columns["lon_rad"] == 0.0
    is_nowhere = is_at_equator & is_at_greenwich
    is_nowhere |= np.abs(columns["lon_rad"]) > LARGEST_LONGITUDE_RAD
    for name in HEIGHT_COLUMNS & columns.keys():
        is_nowhere |= np.abs(columns[name]) > LARGEST_HEIGHT_M
    return np.asarray(~is_nowhere)


def _is_impossible(name: str, columns: Mapping[str, Array]) -> Mask:
    """(n,) which values of the column ``name`` are impossible in a flight.

    None of the columns of places: see `_is_place_possible`.
    """
    values = columns[name]
    if name.startswith("sigma_"):
        return np.asarray((values < 0.0) | (values > LARGEST_SIGMA))
    if name.startswith("v_"):
        return np.asarray(np.abs(values) > FASTEST_M_S)
    if name.startswith("offset_"):
        return np.asarray(np.abs(values) > LONGEST_ARM_M)
    if name in _QUATERNION and columns.keys() >= set(_QUATERNION):
        length = np.linalg.norm([columns[part] for part in _QUATERNION], axis=0)
        return np.asarray(np.abs(length - 1.0) > LONGEST_NORM_ERROR)
    return np.zeros(values.shape, np.bool_)


def without_impossible(
    path: Path, columns: Mapping[str, Array], ledger: Ledger
) -> dict[str, Array]:
    """The columns with NaN for impossible values; each column with such values is reported.

    Impossible are negative and huge sigmas, velocities that no aircraft flies, offsets of a camera
    longer than `LONGEST_ARM_M`, and quaternions with another length than 1.
    """
    result = dict(columns)
    for name, values in columns.items():
        is_wrong = _is_impossible(name, columns)
        if not bool(is_wrong.any()):
            continue
        result[name] = np.where(is_wrong, np.nan, values)
        first = int(np.argmax(is_wrong))
        ledger.add(
            messages.values_impossible(
                where=path.name,
                column=name,
                count=int(is_wrong.sum()),
                row=first + 1,
                first=float(values[first]),
            )
        )
    return result


def _refuse_beyond_poles(path: Path, lat_rad: Array) -> None:
    """Refuse (InputError) latitudes (n,) beyond the poles; NaN is not refused."""
    is_beyond = np.abs(lat_rad) > np.pi / 2.0
    if bool(is_beyond.any()):
        worst_row = int(np.nanargmax(np.abs(lat_rad)))
        worst_deg = float(np.degrees(lat_rad[worst_row]))
        raise messages.latitude_beyond_poles(where=path, worst_deg=worst_deg)


def _rows_in_time(path: Path, time_ns: TimeArray, readable: Mask, ledger: Ledger) -> Integers:
    """The numbers of the rows to keep, in the order of time; lost rows are reported.

    Rows that are not ``readable`` (n,) are lost, and of several rows with the same time all but the
    first. Refuses (InputError) a file without a row to keep.
    """
    rows = np.argsort(time_ns, kind="stable")
    rows = rows[readable[rows]]
    is_repeated = np.diff(time_ns[rows], prepend=-1) == 0  # no file has the time -1 ns
    unreadable = np.flatnonzero(~readable)
    repeated = np.sort(rows[is_repeated])
    for lost_rows, message in (
        (unreadable, messages.rows_unreadable),
        (repeated, messages.rows_repeat_time),
    ):
        if lost_rows.size:
            lost = message(
                where=path.name,
                count=lost_rows.size,
                total=time_ns.size,
                first=int(lost_rows[0]) + 1,  # counted from 1
            )
            ledger.add(lost)
    if bool(is_repeated.all()):
        raise messages.no_row_readable(where=path)
    return np.asarray(rows[~is_repeated])


def channel_of_rows(
    path: Path,
    kind: str,
    time_ns: TimeArray,
    columns: Mapping[str, Array],
    ledger: Ledger,
    *,
    readable: Mask,
    labels: Mapping[str, tuple[str, ...]] | None = None,
) -> Channel:
    """A channel with the name of the file, in the order of time, without unusable rows.

    ``kind`` is the format's name for the channel's source, ``labels`` the columns of text, (n,)
    each. Unusable rows are those that are damaged (``readable`` (n,) is False), that have an
    impossible time or place (0, 0 is an unknown place), or that repeat a time. These rows, and
    single impossible values, are reported as losses. Refuses latitudes beyond the poles.
    """
    columns = without_impossible(path, columns, ledger)
    readable = readable & can_be_flown(time_ns)
    # Before places are removed: in a wrong unit all of them are impossible, which is refused.
    _refuse_beyond_poles(path, columns["lat_rad"][readable])
    readable = readable & _is_place_possible(columns)
    rows = _rows_in_time(path, time_ns, readable, ledger)
    values = {name: column[rows] for name, column in columns.items()}
    labels_of_rows = {}
    for name, texts in (labels or {}).items():
        labels_of_rows[name] = tuple(np.array(texts, dtype=object)[rows])
    return Channel(
        path.name,
        time_ns[rows],
        values,
        Source(kind),
        labels=labels_of_rows,
    )
