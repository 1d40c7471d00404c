"""The ascents of a table of levels: which rows are of one ascent."""

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.levels import Columns, RawLevels, numbers, stated_time_ns
from unbend.units import NANOSECONDS_PER_SECOND, Array

LONGEST_ASCENT_H = 4.0  # a balloon rises for two hours, and falls for one
MOST_OVERLAP = 1.5
"""Sum of the pressure ranges of groups of rows over the range of all rows, above which each group
is an ascent. Groups of levels of one ascent have separate ranges: 1 at most. Two ascents have the
same range: 2."""
LONGEST_STEP_BACK = 0.5
"""Share of the range of all pressures. A longer step from one level to the next, against the
direction of the others, begins another ascent. A balloon that bursts falls in short steps."""

MOST_ASCENTS = 20  # of a table that are compared one by one

NANOSECONDS_PER_HOUR = 3600 * NANOSECONDS_PER_SECOND
FEWEST_TO_JUDGE = 6  # levels: two ascents of three


def columns_of_ascents(
    columns: Columns, identity: Iterable[str], pressure: Sequence[str]
) -> list[dict[str, list[str]]]:
    """The columns of each ascent of a table, which are those of the table if it has only one.

    Rows are of several ascents if a column of ``identity`` (names of columns, such as the station
    or the time) has several values with overlapping ranges of pressure. Then the rows of each value
    are an ascent. ``pressure`` are the fields of the column of pressures.
    """
    values = numbers(pressure)
    for name in identity:
        fields = columns.get(name, [])
        groups = rows_by_value(fields)
        pressures = [values[rows] for rows in groups]
        sum_of_ranges = sum(map(range_of, pressures))
        repeats_range = sum_of_ranges > MOST_OVERLAP * range_of(values)
        if repeats_range or two_begin_together(pressures):
            return [columns_of_rows(columns, rows) for rows in groups]
    return [dict(columns)]


def two_begin_together(pressures: Sequence[Array]) -> bool:
    """Whether two of few groups of levels begin at about the same pressure, as on the ground.

    So it is with two ascents, also if one ended early. Minutes of an ascent and a descent follow
    each other. ``pressures`` are those of the levels of each group; False for more than
    `MOST_ASCENTS` groups, which are such minutes.

    >>> two_begin_together([np.array([950.0, 700.0]), np.array([940.0, 400.0])])
    True
    >>> two_begin_together([np.array([950.0, 700.0]), np.array([700.0, 400.0])])
    False
    """
    if len(pressures) > MOST_ASCENTS:
        return False
    groups = [group[np.isfinite(group)] for group in pressures if range_of(group) > 0.0]
    for first, second in combinations(groups, 2):
        shorter_range = min(range_of(first), range_of(second))
        if abs(first.max() - second.max()) < shorter_range / 2.0:
            return True
    return False


def rows_by_value(fields: Sequence[str]) -> list[list[int]]:
    """The numbers of the rows of each value of a column, in the order of first occurrence.

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
    """All columns with the given rows only."""
    chosen = {}
    for name, fields in columns.items():
        chosen[name] = [fields[row] for row in rows]
    return chosen


def range_of(values: Array) -> float:
    """The largest minus the smallest of the finite values; 0 if none is finite."""
    known_values = values[np.isfinite(values)]
    if known_values.size == 0:
        return 0.0
    return float(np.ptp(known_values))


def refuse_several(times: Sequence[str], pressure: Array, where: str) -> None:
    """Refuse (`InputError` SOUNDING-CHOICE) rows that cannot be of one ascent.

    Their ``times`` (texts) are more than 4 hours apart, or their ``pressure`` begins again at the
    ground. Also refuses times that cannot be read (SOUNDING-TIME).
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
    """Whether pressures jump back by more than half of their range from one level to the next.

    False for fewer than six levels. Back is against the direction of most steps.

    >>> ascent = np.array([950.0, 850.0, 700.0, 500.0, 400.0])
    >>> begins_again(np.append(ascent, ascent))
    True
    >>> begins_again(np.array([900.0, 700.0, 5.0, 500.0, 400.0, 300.0, 200.0, 100.0]))
    False
    """
    if pressure.size < FEWEST_TO_JUDGE:
        return False
    # The median of three neighbours: a single wrong level does not count.
    smooth = np.median(sliding_window_view(pressure, 3), axis=1)
    steps = np.diff(smooth)
    direction = np.sign(np.median(steps))
    steps_back = -direction * steps
    longest = float(np.max(steps_back))
    return longest > LONGEST_STEP_BACK * range_of(smooth)


def is_same_ascent(first: RawLevels, second: RawLevels) -> bool:
    """Whether two ascents have the same levels, as of a page that was pasted twice."""
    same_pressure = np.array_equal(first.pressure_pa, second.pressure_pa, equal_nan=True)
    same_temperature = np.array_equal(first.temperature_k, second.temperature_k, equal_nan=True)
    return same_pressure and same_temperature
