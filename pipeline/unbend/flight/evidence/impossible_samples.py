"""Readings that cannot be true, and units that are probably wrong."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.rejection import Reason, Reasons, with_reason
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.clock import STRAY_ROWS
from unbend.flight.evidence import messages
from unbend.geodesy import wrapped
from unbend.messages import Message, Notes
from unbend.units import Array, Integers, Mask, Rows


class Range(NamedTuple):
    """A range of values, its ends included."""

    low: float
    high: float

    def has(self, value: float) -> bool:
        """Whether a value is in the range; False for NaN."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}"


RANGES: Mapping[str, Range] = {
    "lat_rad": Range(-np.pi / 2.0, np.pi / 2.0),
    "lon_rad": Range(-2.0 * np.pi, 2.0 * np.pi),
    "h_msl_m": Range(-600.0, 60_000.0),
    "h_ellipsoid_m": Range(-700.0, 60_000.0),
    "pressure_pa": Range(20.0, 120_000.0),
    "temperature_k": Range(170.0, 340.0),
    "relative_humidity": Range(-0.05, 1.15),
    "airspeed_m_s": Range(-5.0, 700.0),
}
"""The possible values of columns, for air and aircraft, in SI units."""

FASTEST_CLIMB_M_S = 200.0  # no survey aircraft climbs or sinks faster [m/s]
FASTEST_M_S = 700.0  # no aircraft that takes pictures flies faster over the ground [m/s]
# No aircraft turns faster [rad/s] and back again within few samples; a flip goes on turning.
FASTEST_TURN_RAD_S = float(np.radians(500.0))

_HEIGHTS = ("h_msl_m", "h_ellipsoid_m")
_METRES_PER_RAD = 6_371_000.0  # only to notice jumps of 100 m: any radius will do
_TURN_NOISE_RAD = float(np.radians(20.0))  # a smaller turn between two samples is not a jump

_BLOCK = 1 << 16  # steps that are compared together: a long channel is not copied as a whole
_MOST_STRETCHES = 20_000  # a series that jumps more often is noise
_FEWEST_SAMPLES = 3  # with fewer, no sample has one on either side


class _WrongUnit(NamedTuple):
    """Medians that show a wrong unit, and the unit that they look like."""

    medians: Range
    unit: str


_WRONG_UNITS: Mapping[str, tuple[_WrongUnit, ...]] = {
    "pressure_pa": (
        _WrongUnit(Range(100.0, 1_200.0), "hPa"),
        _WrongUnit(Range(1.2e6, 1.2e7), "Pa"),
    ),
    "temperature_k": (_WrongUnit(Range(-90.0, 60.0), "degC"),),
    "relative_humidity": (_WrongUnit(Range(1.2, 100.0), "percent"),),
}

# Roles for which jumps are searched before a role is given to a channel.
_ROLES_WITH_JUMPS = ("position", "attitude", "pressure", "temperature", "humidity", "airspeed")


class _Step(NamedTuple):
    """How the step from one sample to another is measured, and the largest step that is possible.

    size : function of a channel and two arrays (m,) of rows; gives (m,) sizes of the steps from the
        first rows to the second.
    rate : the largest possible size for each second between the samples.
    noise : a size that is possible in any time.
    """

    size: Callable[[Channel, Rows, Rows], Array]
    rate: float
    noise: float


def plausible_samples(channel: Channel, role: str) -> tuple[Channel, Notes]:
    """Remove the samples that are missing or impossible in the columns of a role.

    A value is impossible if it is out of range, or reached and left faster than air or aircraft can
    change. The notes count these samples, but not those that `mask_impossible_values` counted when
    the log was read. A sample gets the reason of the first column that gives one. Refuses
    (MissionError CHANNEL-UNIT) a channel with a median that shows a wrong unit (hPa for Pa).
    """
    notes: list[Message] = []
    if role in ("position", "height"):
        channel, height_notes = _mask_heights(channel)
        notes += height_notes
    reasons = np.zeros(len(channel), np.uint8)  # 0 is Reason.USED
    for column in ROLE_COLUMNS[role]:
        _refuse_wrong_unit(channel, role, column)
        column_reasons, column_notes = _reasons_of_column(channel, column)
        reasons = np.where(reasons == Reason.USED, column_reasons, reasons)
        notes += column_notes
    jumps, jump_notes = _jumps(channel, reasons == Reason.USED, role)
    reasons[jumps] = Reason.JUMP
    return channel.without(reasons), (*notes, *jump_notes)


def _reasons_of_column(channel: Channel, column: str) -> tuple[Reasons, Notes]:
    """(n,) reasons why samples have no possible value in a column; 0 (used) where they have one.

    The notes count the samples without a value, and those out of range. A value that was removed
    when the log was read keeps its reason, and is not counted again.
    """
    notes: list[Message] = []
    values = channel[column]
    unknown = ~np.isfinite(values)
    reasons = np.zeros(len(channel), np.uint8)
    if column in channel.rejected:
        reasons = np.where(unknown, channel.rejected[column], reasons)
    missing = int(np.count_nonzero(unknown & (reasons == Reason.USED)))
    if missing:
        notes.append(
            messages.samples_not_a_number(
                channel=channel.name,
                column=column,
                count=missing,
                total=len(channel),
            )
        )
    outside = _outside(values, column)
    if outside.any():
        notes.append(_out_of_range(channel, column, outside))
    reasons = with_reason(reasons, unknown, Reason.NO_VALUE)
    reasons = with_reason(reasons, outside, Reason.OUT_OF_RANGE)
    return reasons, tuple(notes)


def _refuse_wrong_unit(channel: Channel, role: str, column: str) -> None:
    """Refuse (MissionError CHANNEL-UNIT) a column with a median that shows a wrong unit."""
    values = channel[column]
    is_known = np.isfinite(values)
    if not is_known.any():
        return
    median = float(np.median(values[is_known]))
    for wrong in _WRONG_UNITS.get(column, ()):
        if wrong.medians.has(median):
            raise messages.unit_looks_wrong(
                channel=channel.name,
                role=role,
                column=column,
                median=median,
                unit=wrong.unit,
            )


def mask_impossible_values(channel: Channel) -> tuple[Channel, Notes]:
    """Replace the impossible values in a channel of a log by NaN; the notes count them.

    They are those of `plausible_samples`, for all roles that the channel may get. Rows in which no
    role has a value left are removed. A column with a median out of range is kept, with a warning,
    and not searched for jumps: it has another unit, or does not measure air. Of events only heights
    and ranges are checked.
    """
    # Ranges before jumps: a value out of range would be a jump as well.
    channel, height_notes = _mask_heights(channel)
    channel, odd_columns, range_notes = _mask_ranges(channel)
    notes = [*height_notes, *range_notes]
    if "events" in channel.roles:
        return channel, tuple(notes)
    roles = [role for role in _ROLES_WITH_JUMPS if channel.fits_role(role)]
    for role in roles:
        if odd_columns.isdisjoint(ROLE_COLUMNS[role]):
            channel, jump_notes = _mask_jumps(channel, role)
            notes += jump_notes
    return channel.without(_reasons_of_useless_rows(channel, roles)), tuple(notes)


def _reasons_of_useless_rows(channel: Channel, roles: list[str]) -> Reasons:
    """(n,) reasons for rows in which no role has a value left; 0 (used) for all other rows.

    An impossible height does not count: the row keeps its latitude and longitude. Without ``roles``
    all rows are kept.
    """
    reasons = np.zeros(len(channel), np.uint8)
    for column, column_reasons in channel.rejected.items():
        if column not in _HEIGHTS:
            reasons = np.where(reasons == Reason.USED, column_reasons, reasons)
    useful = np.full(len(channel), not roles)
    for role in roles:
        useful |= _has_all_columns(channel, role)
    return np.where(useful, Reason.USED, reasons).astype(np.uint8)


def _mask_ranges(channel: Channel) -> tuple[Channel, set[str], Notes]:
    """Replace values out of range by NaN; also returns the columns with a median out of range.

    The values of these columns stay, with a warning. Heights are left to `_mask_heights`.
    """
    odd_columns: set[str] = set()
    notes: list[Message] = []
    for column in RANGES:
        if column not in channel.columns or column in _HEIGHTS:
            continue
        outside = _outside(channel[column], column)
        if not outside.any():
            continue
        with np.errstate(over="ignore"):  # in the mean of two huge values in the middle
            median = float(np.nanmedian(channel[column]))
        if RANGES[column].has(median):
            notes.append(_out_of_range(channel, column, outside))
            channel = channel.with_impossible(column, outside, Reason.OUT_OF_RANGE)
        else:
            odd_columns.add(column)
            notes.append(
                messages.median_is_odd(
                    channel=channel.name,
                    column=column,
                    samples=len(channel),
                    median=median,
                    limits=f"outside {RANGES[column]}",
                )
            )
    return channel, odd_columns, tuple(notes)


def _mask_jumps(channel: Channel, role: str) -> tuple[Channel, Notes]:
    """Replace all columns of a role by NaN in the rows that jump away and back."""
    jumps, notes = _jumps(channel, _has_all_columns(channel, role), role)
    if jumps.size:
        is_jump = np.zeros(len(channel), np.bool_)
        is_jump[jumps] = True
        for column in ROLE_COLUMNS[role]:
            channel = channel.with_impossible(column, is_jump, Reason.JUMP)
    return channel, notes


def _has_all_columns(channel: Channel, role: str) -> Mask:
    """(n,) True for rows in which all columns of a role are known."""
    is_known = np.ones(len(channel), np.bool_)
    for column in ROLE_COLUMNS[role]:
        is_known &= np.isfinite(channel[column])
    return is_known


def _outside(values: Array, column: str) -> Mask:
    """(n,) True for values out of the range of their column; False for NaN, or without a range."""
    nowhere = np.zeros(values.shape, np.bool_)
    if column not in RANGES or values.size == 0:
        return nowhere
    low, high = RANGES[column]
    with np.errstate(invalid="ignore"):
        lowest = np.fmin.reduce(values)
        highest = np.fmax.reduce(values)
        if lowest >= low and highest <= high:
            return nowhere  # spares two masks of a long channel
        outside = (values < low) | (values > high)
    return np.asarray(outside, np.bool_)


def _out_of_range(channel: Channel, column: str, outside: Mask) -> Message:
    """The message that counts the values of a column that are out of range."""
    return messages.samples_out_of_range(
        channel=channel.name,
        column=column,
        count=int(np.count_nonzero(outside)),
        total=len(channel),
        limits=f"outside {RANGES[column]}",
    )


def _mask_heights(channel: Channel) -> tuple[Channel, Notes]:
    """Replace heights by NaN that are out of range, or jump away and back.

    Jumps are searched only in channels with positions. The rows keep latitude and longitude.
    """
    notes: list[Message] = []
    for column in _HEIGHTS:
        if column not in channel.columns:
            continue
        height = channel[column]
        outside = _outside(height, column)
        is_jump = np.zeros(len(channel), np.bool_)
        if "lat_rad" in channel.columns:
            is_known = np.isfinite(height) & ~outside
            step = _STEPS[column]
            stray, noise_notes = _stray_rows(channel, is_known, step, channel.name)
            is_jump[stray] = True
            notes += noise_notes
        impossible = outside | is_jump
        if impossible.any():
            first_row = int(np.argmax(impossible))
            notes.append(
                messages.heights_impossible(
                    channel=channel.name,
                    column=column,
                    count=int(np.count_nonzero(impossible)),
                    total=len(channel),
                    first_m=float(height[first_row]),
                    first_row=first_row,
                )
            )
            channel = channel.with_impossible(column, outside, Reason.OUT_OF_RANGE)
            channel = channel.with_impossible(column, is_jump, Reason.JUMP)
    return channel, tuple(notes)


def _jumps(channel: Channel, known: Mask, role: str) -> tuple[Rows, Notes]:
    """The rows of samples that jump away and back in the columns of a role, as of `_stray_rows`.

    ``known`` (n,) : the rows that are compared. Jumps by which a filter is aligned are returned
    too; they have a note of their own, and are not counted in the loss for the other jumps.
    """
    where = f"{channel.name}, as {role}"
    notes: list[Message] = []
    is_stray = np.zeros(len(channel), np.bool_)
    for name in (role, *ROLE_COLUMNS[role]):  # places and attitudes are compared as a whole
        step = _STEPS.get(name)
        if step is not None:
            rows, noise_notes = _stray_rows(channel, known, step, where)
            is_stray[rows] = True
            notes += noise_notes
    jumps = np.flatnonzero(is_stray)
    unexplained = jumps
    if role.endswith("attitude"):
        aligned = _leads_to_another_attitude(channel, known & ~is_stray, jumps)
        unexplained = jumps[~aligned]
        count = int(np.count_nonzero(aligned))
        if count:
            notes.append(messages.attitude_aligned(where=where, count=count))
    if unexplained.size:
        first_ns = channel.time_ns[unexplained[0]]
        after_begin_ns = first_ns - channel.time_ns[0]
        notes.append(
            messages.samples_jump(
                where=where,
                count=unexplained.size,
                total=len(channel),
                first_s=float(after_begin_ns * 1e-9),
            )
        )
    return jumps, tuple(notes)


def _leads_to_another_attitude(channel: Channel, kept: Mask, jumps: Rows) -> Mask:
    """(j,) True for jumps in which the filter was aligned to another attitude.

    ``kept`` (n,) : the rows that do not jump; ``jumps`` (j,) : the rows that do. The filter was
    aligned if the kept attitudes before and after a jump are too far apart for the time between
    them, or no attitude before it is kept. It was not if none after it is kept.
    """
    kept_rows = np.flatnonzero(kept)
    place = np.searchsorted(kept_rows, jumps)  # in kept_rows, of the first one after each jump
    is_aligned = place == 0
    is_between = (place > 0) & (place < kept_rows.size)
    before = kept_rows[place[is_between] - 1]
    after = kept_rows[place[is_between]]
    interval_ns = channel.time_ns[after] - channel.time_ns[before]
    possible_turn = FASTEST_TURN_RAD_S * 1e-9 * interval_ns
    largest_turn = np.maximum(possible_turn, _TURN_NOISE_RAD)
    turn = _angle(channel, before, after)
    is_aligned[is_between] = turn > largest_turn
    return np.asarray(is_aligned)


def _metres(channel: Channel, first: Rows, second: Rows) -> Array:
    """(m,) horizontal distances [m] from first to second rows, good enough to notice a jump."""
    lat = channel["lat_rad"]
    lon = channel["lon_rad"]
    north = lat[second] - lat[first]
    turned_east = wrapped(lon[second] - lon[first])
    east = turned_east * np.cos(lat[first])
    distance = np.hypot(north, east)
    return np.asarray(_METRES_PER_RAD * distance)


def _angle(channel: Channel, first: Rows, second: Rows) -> Array:
    """(m,) angles [rad] between the attitudes in first and second rows; 0 if less than noise."""
    cosine_of_half = np.zeros(first.shape)
    for name in ROLE_COLUMNS["attitude"]:
        component = channel[name]
        cosine_of_half += component[first] * component[second]
    cosine_of_half = np.abs(cosine_of_half)  # a quaternion and its negative are one attitude
    angle = np.zeros(cosine_of_half.shape)
    wide = cosine_of_half < np.cos(_TURN_NOISE_RAD / 2.0)
    angle[wide] = 2.0 * np.arccos(cosine_of_half[wide])
    return angle


def _step_of(column: str, rate: float, noise: float) -> _Step:
    """The step whose size is the difference of the values in a column."""

    def size(channel: Channel, first: Rows, second: Rows) -> Array:
        """(m,) absolute differences of the column between rows."""
        values = channel[column]
        return np.abs(values[second] - values[first])

    return _Step(size, rate, noise)


# By role or by column, in the units of the column. 2,500 Pa/s is a climb of 200 m/s at sea level.
_STEPS: Mapping[str, _Step] = {
    "position": _Step(_metres, FASTEST_M_S, 100.0),
    "height": _Step(_metres, FASTEST_M_S, 100.0),
    "attitude": _Step(_angle, FASTEST_TURN_RAD_S, _TURN_NOISE_RAD),
    "pressure_pa": _step_of("pressure_pa", 2_500.0, 100.0),
    "temperature_k": _step_of("temperature_k", 20.0, 5.0),
    "h_msl_m": _step_of("h_msl_m", FASTEST_CLIMB_M_S, 20.0),
    "h_ellipsoid_m": _step_of("h_ellipsoid_m", FASTEST_CLIMB_M_S, 20.0),
}


def _is_far(channel: Channel, first: Rows, second: Rows, step: _Step) -> Mask:
    """(m,) True if the step from a first to a second row is larger than possible in that time."""
    stamps = channel.time_ns
    seconds = 1e-9 * (stamps[second] - stamps[first])
    limit = np.maximum(step.rate * seconds, step.noise)
    size = step.size(channel, first, second)
    return np.asarray(size > limit, np.bool_)


def _stray_rows(
    channel: Channel,
    known: Mask,
    step: _Step,
    where: str,
) -> tuple[Rows, Notes]:
    """The rows of short stretches that cannot be reached from the other samples.

    Jumps divide the ``known`` rows (n,) into stretches. Going from the longest stretch to either
    end, a stretch of up to `STRAY_ROWS` rows is stray if the step from the last kept stretch to it
    is a jump; all others are kept. A series with too many jumps is noise: it has no stray rows, but
    a note. ``where`` : the channel and role in words.
    """
    rows = np.flatnonzero(known)
    begin = _begins_of_stretches(channel, rows, step)
    if rows.size < _FEWEST_SAMPLES or begin.size == 1:
        return rows[:0], ()
    if begin.size > _MOST_STRETCHES:
        noise = messages.samples_are_noise(
            where=where,
            count=begin.size - 1,
            total=rows.size,
        )
        return rows[:0], (noise,)
    length = np.diff(np.append(begin, rows.size))
    begin_row = rows[begin]
    end_row = rows[begin + length - 1]

    def is_jump(earlier: int, later: int) -> bool:
        """Whether the step from the end of a stretch to the begin of a later one is a jump."""
        from_row = end_row[earlier : earlier + 1]
        to_row = begin_row[later : later + 1]
        return bool(_is_far(channel, from_row, to_row, step)[0])

    # A long stretch is always kept: the sensor was set anew, or a gap has ended.
    is_short = length <= STRAY_ROWS
    is_stray = np.zeros(begin.shape, np.bool_)
    longest = int(np.argmax(length))
    last_kept = longest  # on the way to the end
    for stretch in range(longest + 1, begin.size):
        is_stray[stretch] = is_short[stretch] and is_jump(last_kept, stretch)
        if not is_stray[stretch]:
            last_kept = stretch
    last_kept = longest  # on the way to the begin
    for stretch in range(longest - 1, -1, -1):
        is_stray[stretch] = is_short[stretch] and is_jump(stretch, last_kept)
        if not is_stray[stretch]:
            last_kept = stretch
    stray_rows = rows[np.repeat(is_stray, length)]
    return np.asarray(stray_rows, np.intp), ()


def _begins_of_stretches(channel: Channel, rows: Rows, step: _Step) -> Integers:
    """Indices into ``rows`` at which a stretch begins: 0, and each one after a jump."""
    begins = [np.zeros(1, np.intp)]
    for block_begin in range(0, rows.size - 1, _BLOCK):
        block_end = block_begin + _BLOCK + 1  # one more, for the step to the next block
        block = rows[block_begin:block_end]
        is_far = _is_far(channel, block[:-1], block[1:], step)
        before_jump = np.flatnonzero(is_far)
        begins.append(before_jump + block_begin + 1)
    return np.concatenate(begins)
