"""Times of the messages of MCAP logs: their own stamps, in any form, or the recorder's."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.clock import BOOT_STEP_NS, UNIX_NS_FROM
from unbend.ingest.boot_clock import BootClock
from unbend.ingest.field_maps import is_number
from unbend.ingest.mcap import messages
from unbend.ingest.timelines import nanoseconds
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Integers, Mask, Rows, whole_numbers

Columns = Mapping[str, NDArray[Any]]

# Columns that are added to the fields of messages.
STAMP = "\0stamp_ns"  # a message's own time
LOG_TIME = "\0log_ns"  # that of the recorder
SEQUENCE = "\0sequence"  # its number

_LAST_NS = 2**63 - 1
_LAST_S = 1 << 32  # until 2106
_MOST_PART_NS = 1 << 32  # [ns] beyond the second: the field of 32 bits may exceed 1 s
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ISO = re.compile(
    r"(?P<seconds>\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(?P<fraction>\d+))?"
    r"(?P<zone>Z|[+-]\d\d:\d\d)?"
)
_DIGITS_OF_NS = 9

# The unit [ns] of a bare number of Unix time, by its least size: so that it is from 1973 to 2286.
_UNITS_NS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))
_LARGEST_NUMBER = 1e19  # more is no time in any of them


def stamp_of(value: Any) -> int:
    """Unix time [ns] of a time in JSON or protobuf; 0 if the value is not a time.

    A time is an object with seconds and nanoseconds, a number of seconds, ms, us or ns (its size
    shows which), or a text as in RFC 3339.

    >>> stamp_of("2026-05-01T10:00:00.5Z"), stamp_of(1.5e9), stamp_of({"sec": 1, "nsec": 2})
    (1777629600500000000, 1500000000000000000, 1000000002)
    """
    if value is None or isinstance(value, bool):
        return 0
    if isinstance(value, str):
        time_ns = _ns_of_text(value)
    elif isinstance(value, int | float):
        time_ns = _ns_of_number(value)
    else:
        seconds = _first_member(value, ("sec", "secs", "seconds"))
        part_ns = _first_member(value, ("nsec", "nsecs", "nanosec", "nanos"))
        time_ns = int(seconds) * NANOSECONDS_PER_SECOND + int(part_ns)
    return min(max(time_ns, 0), _LAST_NS)


def _ns_of_text(text: str) -> int:
    """Unix time [ns] of a text as in RFC 3339; 0 for other texts and dates that do not exist."""
    match = _ISO.fullmatch(text.strip())
    if not match:
        return 0
    zone = match["zone"]
    if zone is None or zone == "Z":
        zone = "+00:00"
    try:
        moment = datetime.fromisoformat(match["seconds"] + zone)
    except ValueError:
        return 0
    seconds = (moment - _EPOCH) // timedelta(seconds=1)
    fraction = match["fraction"] or "0"
    part_ns = int(fraction[:_DIGITS_OF_NS].ljust(_DIGITS_OF_NS, "0"))
    return seconds * NANOSECONDS_PER_SECOND + part_ns


def _ns_of_number(value: float) -> int:
    """Unix time [ns] of a number of s, ms, us or ns; 0 for NaN and for numbers beyond all units."""
    if not abs(value) < _LARGEST_NUMBER:  # also not a number
        return 0
    unit_ns = next(unit for least, unit in _UNITS_NS if abs(value) >= least)
    whole = int(value)
    return whole * unit_ns + round((value - whole) * unit_ns)


def _first_member(value: Any, names: tuple[str, ...]) -> Any:
    """The value of the first of these names that a dict or object has, and not None; 0 without."""
    for name in names:
        member = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
        if member is not None:
            return member
    return 0


def order_by_sequence(sequence: NDArray[np.uint32], time_ns: TimeArray) -> Rows | None:
    """The rows of (n,) messages sorted by their sequence numbers; None if they stay as they are.

    They stay as they are

    - if their times are in order;
    - if a number repeats, because a recorder has counted anew;
    - if the order of the numbers does not put the times in order, because a clock was set.

    >>> order_by_sequence(np.array([0, 1, 4, 2], np.uint32), np.array([10, 11, 14, 12]))
    array([0, 1, 3, 2])
    """
    if bool(np.all(time_ns[1:] >= time_ns[:-1])):
        return None
    order = np.argsort(sequence, kind="stable")
    numbers = sequence[order]
    times_ns = time_ns[order]
    numbers_rise = bool(np.all(numbers[1:] > numbers[:-1]))
    times_rise = bool(np.all(times_ns[1:] >= times_ns[:-1]))
    return order if numbers_rise and times_rise else None


class OwnTimes(NamedTuple):
    """(n,) times [ns] that messages carry, 0 for messages without.

    ``from_integer``: True if each was one integer of microseconds, since a boot or since 1970;
    False for a Time with seconds and nanoseconds (since 1970), and for messages without a time.
    """

    time_ns: TimeArray
    from_integer: bool


def own_times(columns: Columns, time_field: str, count: int) -> OwnTimes:
    """The times that ``count`` messages carry, from the first of these that their columns have:

    - `STAMP`, which a decoder made of the time in the message.
    - ``time_field`` with the parts of a Time of ROS.
    - ``time_field`` with an integer: microseconds since a boot or 1970.

    Messages without any of these have the time 0.
    """
    if STAMP in columns:
        return OwnTimes(columns[STAMP], from_integer=False)
    numbers = {name: column for name, column in columns.items() if is_number(column)}
    if f"{time_field}.sec" in numbers:
        seconds = whole_numbers(numbers[f"{time_field}.sec"], 0, _LAST_S)
        time_ns = seconds * NANOSECONDS_PER_SECOND
        for name in (f"{time_field}.nanosec", f"{time_field}.nsec"):
            if name in numbers:
                time_ns = time_ns + whole_numbers(numbers[name], 0, _MOST_PART_NS)
                break
        return OwnTimes(time_ns, from_integer=False)
    if time_field in numbers and numbers[time_field].dtype.kind in "iu":
        return OwnTimes(nanoseconds(columns[time_field]), from_integer=True)
    return OwnTimes(np.zeros(count, np.int64), from_integer=False)


def since_boot(stamp_ns: TimeArray) -> Mask:
    """Which stamps [ns] count from a boot: those above 0 (no time) and below 2001 in Unix time."""
    return np.asarray((stamp_ns > 0) & (stamp_ns < UNIX_NS_FROM), np.bool_)


def good_rows(places: Integers, stamp_ns: TimeArray, clock: BootClock) -> Mask:
    """Which messages of a topic, at (n,) places and stamps [ns], have a time that fits the log.

    Stamps of Unix time and stamps of 0, which are none, always fit. A stamp since boot that is
    stray among its neighbours in the log may be of a message that came late: it fits if it is
    between its neighbours of the same topic, and within the times of the boot.
    """
    line = clock.line
    is_since_boot = since_boot(stamp_ns)
    is_good = np.asarray(line.good(places) | ~is_since_boot, np.bool_)
    misfits = np.flatnonzero(~is_good)
    if not misfits.size:
        return is_good
    boot = line.boot_of(places)
    for number in np.unique(boot[misfits]).tolist():
        stretches = ~line.stray & (line.boot == number)
        earliest_ns = line.begin[stretches].min() - BOOT_STEP_NS
        latest_ns = line.end[stretches].max() + BOOT_STEP_NS
        neighbours = np.flatnonzero(is_good & is_since_boot & (boot == number))
        bounds_ns = np.concatenate([[earliest_ns], stamp_ns[neighbours], [latest_ns]])
        rows = misfits[boot[misfits] == number]
        bound_before = np.searchsorted(neighbours, rows)
        is_good[rows] = _are_between(stamp_ns[rows], bounds_ns, bound_before)
    return is_good


def _are_between(stamp_ns: TimeArray, bounds_ns: TimeArray, bound_before: Rows) -> Mask:
    """Which (n,) stamps are between the bound in row ``bound_before`` (n,) and the next bound."""
    return (bounds_ns[bound_before] < stamp_ns) & (stamp_ns < bounds_ns[bound_before + 1])


class MessageTimes(NamedTuple):
    """UTC [ns] and boot of (n,) messages.

    ``unstamped``: how many have no time of their own, and therefore that of the recorder.
    """

    time_ns: TimeArray
    boot: NDArray[np.int16]
    unstamped: int


def times_of(
    stamp_ns: TimeArray,
    log_ns: TimeArray,
    places: Integers | None,
    clock: BootClock,
    *,
    ledger: Ledger,
    topic: str,
) -> MessageTimes:
    """The times of (n,) messages of a topic: their stamps, or the recorder's where these are 0.

    ``places`` in the log, if the stamps were integers of microseconds (`OwnTimes`), which may count
    from a boot; None if all stamps are Unix time. ``log_ns``: the recorder's times. Messages
    without a stamp, and stamps before 2001, are entered in the ledger.
    """
    if places is None:
        is_since_boot = np.zeros(stamp_ns.shape, np.bool_)
        time_ns = stamp_ns
        boot = np.zeros(stamp_ns.shape, np.int16)
    else:
        is_since_boot = since_boot(stamp_ns)
        time_ns = np.where(is_since_boot, clock.utc(places, stamp_ns), stamp_ns)
        boot = clock.line.boot_of(places)
    is_unstamped = stamp_ns == 0
    unstamped = int(np.count_nonzero(is_unstamped))
    if unstamped:
        ledger.add(messages.messages_without_stamp(topic=topic, count=unstamped))
        time_ns = np.where(is_unstamped, log_ns, time_ns)
    # times since a boot are small where UTC is unknown, which is reported elsewhere
    is_before_2001 = time_ns < UNIX_NS_FROM
    is_early = is_before_2001 & ~is_since_boot
    if bool(is_early.any()):
        ledger.add(messages.stamps_before_2001(topic=topic))
    return MessageTimes(
        time_ns=time_ns,
        boot=boot,
        unstamped=unstamped,
    )
