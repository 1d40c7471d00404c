"""Which rows of a table of levels are of one ascent."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.levels import Columns, RawLevels, numbers, stated_time_ns
from unbend.units import NANOSECONDS_PER_SECOND, Array

LONGEST_ASCENT_H = 4.0  # a balloon rises for two hours, and falls for one
MOST_OVERLAP = 1.5
"""Of the pressures of groups of rows: the sum of their ranges over the range of all. The levels of
one ascent, each with its own time or place, share none: 1 at most. Two ascents share all: 2."""
LONGEST_STEP_BACK = 0.5
"""Of the range of all pressures, from one level to the next against the way of the others: an
ascent that begins again. A balloon that bursts falls step by step."""

NANOSECONDS_PER_HOUR = 3600 * NANOSECONDS_PER_SECOND
FEWEST_TO_JUDGE = 6  # levels: two ascents of three


def columns_of_ascents(
    columns: Columns, identity: Iterable[str], pressure: Sequence[str]
) -> list[dict[str, list[str]]]:
    """The columns of each ascent of a table.

    Rows are of several ascents if a column of ``identity``, such as the station or the time, has
    several values, each with the same ``pressure`` levels. A table of one ascent stays as it is.
    """
    values = numbers(pressure)
    for name in identity:
        fields = columns.get(name, [])
        groups = rows_by_value(fields)
        ranges = 0.0
        for rows in groups:
            ranges += range_of(values[rows])
        if ranges > MOST_OVERLAP * range_of(values):
            return [columns_of_rows(columns, rows) for rows in groups]
    return [dict(columns)]


def rows_by_value(fields: Sequence[str]) -> list[list[int]]:
    """The rows of each value of a column.

    >>> rows_by_value(["a", "b", "a "])
    [[0, 2], [1]]
    """
    rows_of: dict[str, list[int]] = {}
    for row, field in enumerate(fields):
        value = field.strip()
        rows = rows_of.setdefault(value, [])
        rows.append(row)
    return list(rows_of.values())


def columns_of_rows(columns: Columns, rows: list[int]) -> dict[str, list[str]]:
    """Some rows of all columns."""
    chosen = {}
    for name, fields in columns.items():
        chosen[name] = [fields[row] for row in rows]
    return chosen


def range_of(values: Array) -> float:
    """The largest minus the smallest of the known values, 0 of none."""
    known_values = values[np.isfinite(values)]
    if known_values.size == 0:
        return 0.0
    return float(np.ptp(known_values))


def refuse_several(times: Sequence[str], pressure: Array, where: str) -> None:
    """Refuse (`InputError` SOUNDING-CHOICE) rows of one table that are of no single ascent.

    No ascent takes so long, or begins again at the ground.
    """
    stated_ns = [stated_time_ns(time, where) for time in times]
    known_ns = [time_ns for time_ns in stated_ns if time_ns is not None]
    if known_ns:
        first_ns = min(known_ns)
        last_ns = max(known_ns)
        hours = (last_ns - first_ns) / NANOSECONDS_PER_HOUR
        if hours > LONGEST_ASCENT_H:
            raise messages.sounding_choice_rows(where=where, hours=hours)
    if begins_again(pressure[np.isfinite(pressure)]):
        raise messages.sounding_choice_begins_again(where=where)


def begins_again(pressure: Array) -> bool:
    """Whether pressures go back by more than half of their range, from one level to the next.

    >>> ascent = np.array([950.0, 850.0, 700.0, 500.0, 400.0])
    >>> begins_again(np.append(ascent, ascent))
    True
    >>> begins_again(np.array([900.0, 700.0, 5.0, 500.0, 400.0, 300.0, 200.0, 100.0]))
    False
    """
    if pressure.size < FEWEST_TO_JUDGE:
        return False
    # The middle of three neighbours: one wild level is no ascent.
    smooth = np.median(sliding_window_view(pressure, 3), axis=1)
    steps = np.diff(smooth)
    way = np.sign(np.median(steps))
    steps_back = -way * steps
    longest = float(np.max(steps_back))
    return longest > LONGEST_STEP_BACK * range_of(smooth)


def is_same_ascent(first: RawLevels, second: RawLevels) -> bool:
    """Whether two readings of a file have the same levels: a page that was pasted twice."""
    same_pressure = np.array_equal(first.pressure_pa, second.pressure_pa, equal_nan=True)
    same_temperature = np.array_equal(first.temperature_k, second.temperature_k, equal_nan=True)
    return same_pressure and same_temperature
