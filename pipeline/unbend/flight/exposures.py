"""Exposures from camera events: their channel, the names of their images, and lost pulses."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from unbend.flight import messages
from unbend.flight.channels import Channel
from unbend.flight.ground_times import NOTHING_SAID, GroundEvidence, times_on_the_ground
from unbend.flight.interpolation import ns_to_nearest
from unbend.flight.stations import Stations
from unbend.messages import Message, Notes
from unbend.units import NANOSECONDS_PER_SECOND, Array, Integers, Names, whole_numbers


@dataclass(frozen=True, eq=False)
class Events:
    """Exposures of one camera: (m,) names, times (UTC, ns) and, one or (m,), their sigma [s].

    A name is "" if the files of the images give it later. ``index`` : (m,) numbers of the events in
    the log; None if they do not rise from the first event to the last. ``lost`` : how many numbers
    have no event. ``counts`` : whether the numbers of a file may be mere row numbers, which do not
    show lost events: "always" if it has none of its own; "maybe" if they begin at 1 and skip none,
    as in a file renumbered after a loss; else "no".
    """

    camera: str
    image: Names
    time_ns: Integers
    sigma_time_s: Array | float = 0.0
    index: Integers | None = None
    lost: int = 0
    counts: Literal["no", "maybe", "always"] = "no"


@dataclass(frozen=True)
class ExposureDelay:
    """Time from a logged event to the opening of the shutter [s], and its sigma."""

    seconds: float
    sigma_s: float = 0.0

    @property
    def nanoseconds(self) -> int:
        """The delay in whole nanoseconds."""
        return round(self.seconds * 1e9)


def events_of_channel(
    channel: Channel, camera: str, pattern: str, delay: ExposureDelay
) -> tuple[Events, Notes]:
    """Exposures of an event channel, named by a pattern, and a loss for each power-up with gaps.

    In the pattern ``{index}`` is the number in the log, which may count modulo 65536, and ``{n}``
    the number of the event from 1. A pattern with ``*`` leaves the names empty: the files of the
    images give them later. Numbers that the log skips are lost pulses.
    """
    index = whole_numbers(channel["event_index"], -_MOST_INDEX, _MOST_INDEX)
    if "*" in pattern:
        names = [""] * index.size
    else:
        names = [pattern.format(index=int(number), n=n) for n, number in enumerate(index, start=1)]
    logged_sigma_s = np.zeros(len(channel))
    if "sigma_time_s" in channel.columns:
        logged_sigma_s = np.nan_to_num(channel["sigma_time_s"])
    is_rising = bool((np.diff(unwrapped_numbers(index)) > 0).all())
    skipped = _skipped_numbers(channel, index)
    events = Events(
        camera,
        np.array(names, dtype=object),
        channel.time_ns + delay.nanoseconds,
        sigma_time_s=np.hypot(logged_sigma_s, delay.sigma_s),
        index=index if is_rising else None,
        lost=sum(numbers.missing for numbers in skipped),
    )
    return events, tuple(numbers.message(channel) for numbers in skipped)


def events_of_table(
    image: Names,
    camera_of: NDArray[Any],
    time_ns: Integers,
    camera: str,
    delay: ExposureDelay,
) -> Events:
    """Exposures of one camera from the (n,) columns of a table, with a delay added to their times.

    ``camera_of`` is the column with the camera of each row.
    """
    rows = camera_of == camera
    return Events(
        camera,
        image[rows],
        time_ns[rows] + delay.nanoseconds,
        sigma_time_s=delay.sigma_s,
    )


_MOST_INDEX = 1 << 53  # float64 has not every larger integer
_COUNT_ROUND = 1 << 16  # a counter of 16 bits starts at 0 again here
# A counter that overflows skips fewer numbers than this; a larger step is a reset of the counter.
_MOST_SKIPPED = 1 << 12


def unwrapped_numbers(index: Integers) -> Integers:
    """Image numbers that go on after 65535, where the 16-bit counter of the log starts at 0 again.

    ``index``: (n,) numbers of one power-up in the log, in the order of their time.

    >>> unwrapped_numbers(np.array([65534, 65535, 1, 2]))
    array([65534, 65535, 65537, 65538])
    """
    step = np.diff(index)
    # A step back by almost 65536 is an overflow; a smaller one is a reset of the counter.
    ran_over = (step < 0) & (step + _COUNT_ROUND < _MOST_SKIPPED)
    # A step forward by almost 65536: a number from before the overflow was logged after it.
    went_back = (step > 0) & (_COUNT_ROUND - step < _MOST_SKIPPED)
    rounds = np.cumsum(ran_over.astype(np.int64) - went_back)
    return np.asarray(index + _COUNT_ROUND * np.append(0, rounds), np.int64)


@dataclass(frozen=True)
class _SkippedNumbers:
    """The gaps in the unwrapped numbers of one power-up, which go from ``first`` to ``last``.

    ``gaps`` are the first and the last missing number of each gap.
    """

    boot: int
    first: int
    last: int
    gaps: tuple[tuple[int, int], ...]

    @property
    def missing(self) -> int:
        """How many numbers have no event."""
        return sum(end - begin + 1 for begin, end in self.gaps)

    def message(self, channel: Channel) -> Message:
        """The loss to report, with a list of the first gaps."""
        listed: list[str] = []
        for begin, end in self.gaps:
            first = _number_as_logged(begin)
            last = _number_as_logged(end)
            listed.append(f"{first}" if begin == end else f"{first} to {last}")
        where = channel.name
        has_several_boots = channel.boot[-1] > 0
        if has_several_boots:
            where = f"{channel.name}, boot {self.boot}"
        return messages.numbers_without_event(
            where=where,
            missing=self.missing,
            listed=messages.first_names(listed, _GAPS_LISTED),
            first=_number_as_logged(self.first),
            last=_number_as_logged(self.last),
        )


_GAPS_LISTED = 4  # in a message


def _skipped_numbers(channel: Channel, index: Integers) -> list[_SkippedNumbers]:
    """The numbers without event, one entry for each power-up that has gaps.

    ``index``: (n,) numbers of the events of the channel.
    """
    skipped = []
    for boot in np.unique(channel.boot).tolist():
        numbers_of_boot = np.unique(unwrapped_numbers(index[channel.boot == boot]))
        before_gap = np.flatnonzero(np.diff(numbers_of_boot) > 1)
        if before_gap.size == 0:
            continue
        begins = numbers_of_boot[before_gap] + 1
        ends = numbers_of_boot[before_gap + 1] - 1
        gaps = tuple(zip(begins.tolist(), ends.tolist(), strict=True))
        skipped.append(
            _SkippedNumbers(boot, int(numbers_of_boot[0]), int(numbers_of_boot[-1]), gaps)
        )
    return skipped


def _number_as_logged(unwrapped: int) -> int:
    """The 16-bit number in the log of an unwrapped number; numbers below 65536 stay."""
    return unwrapped % _COUNT_ROUND if unwrapped >= _COUNT_ROUND else unwrapped


def _usual_shifts_ns() -> list[int]:
    """Shifts between two clocks [ns] to try: the most usual first, each with both signs."""
    leap_seconds = 18
    hour = 3600
    quarter = 900
    widest_zone = 14 * hour
    sizes_s = [leap_seconds, *range(hour, widest_zone + 1, hour)]  # hours of time zones
    sizes_s += [24 * hour, 7 * 24 * hour]
    sizes_s += range(quarter, widest_zone + 1, quarter)  # rarer zones; whole hours may come twice
    shifts: list[int] = []
    for size_s in sizes_s:
        shifts += [size_s * NANOSECONDS_PER_SECOND, -size_s * NANOSECONDS_PER_SECOND]
    return shifts


@dataclass(frozen=True)
class _Span:
    """From a first to a last instant [Unix ns]."""

    first_ns: int
    last_ns: int

    @classmethod
    def of(cls, time_ns: Integers) -> "_Span":
        """The span of one or more times, in rising order."""
        return cls(int(time_ns[0]), int(time_ns[-1]))

    def count_outside(self, time_ns: Integers) -> int:
        """How many times are before or after the span."""
        outside = (time_ns < self.first_ns) | (time_ns > self.last_ns)
        return int(np.count_nonzero(outside))

    def __str__(self) -> str:
        ends = np.array([self.first_ns, self.last_ns], "datetime64[ns]").astype("datetime64[ms]")
        return f"{ends[0]} to {ends[1]}"


def span_notes(events: list[Events], position: Channel, key: str) -> Notes:
    """Warn about events before or after the flight, and propose a shift of their times.

    ``events`` : of each camera. ``position`` : the channel that gives the time of the flight.
    ``key`` : where the mission file states the times of the events. A shift is proposed only if it
    brings more events into the flight. Refuses (MissionError EVENTS-SPAN) if more than half of the
    events are outside the flight.
    """
    times = [camera_events.time_ns for camera_events in events]
    time_ns = np.sort(np.concatenate([np.empty(0, np.int64), *times]))
    if time_ns.size == 0 or len(position) == 0:
        return ()
    span_of_events = _Span.of(time_ns)
    span_of_flight = _Span.of(position.time_ns)
    beyond = span_of_flight.count_outside(time_ns)
    if beyond == 0:
        return ()
    shift_ns = _fitting_shift(span_of_events, span_of_flight)
    still_beyond = span_of_flight.count_outside(time_ns + shift_ns)
    if still_beyond < beyond:
        number_inside = f"{time_ns.size - still_beyond}" if still_beyond else "all"
        shift_that_fits = (
            f"{shift_ns * 1e-9:+.6g} s would bring {number_inside} of them into the flight"
        )
    else:
        shift_that_fits = (
            "neither leap seconds, a time zone, a day nor a week would bring all of them into the "
            "flight, and a common begin does not bring more of them"
        )
    events_beyond = messages.BeyondFlight(
        key=key,
        beyond=beyond,
        total=time_ns.size,
        span_of_events=str(span_of_events),
        channel=position.name,
        span_of_flight=str(span_of_flight),
        shift_that_fits=shift_that_fits,
    )
    if 2 * beyond > time_ns.size:
        raise messages.most_events_beyond_flight(events_beyond)
    return (messages.events_beyond_flight(events_beyond),)


def _fitting_shift(events: _Span, flight: _Span) -> int:
    """A shift [ns] to add to the times of events so that they may fit the time of a flight.

    That is the first usual shift (leap seconds, time zones, a day, a week) that brings all events
    into the flight, else the one with which events and flight begin together.
    """
    for shift_ns in _usual_shifts_ns():
        begins_after = events.first_ns + shift_ns >= flight.first_ns
        ends_before = events.last_ns + shift_ns <= flight.last_ns
        if begins_after and ends_before:
            return shift_ns
    return flight.first_ns - events.first_ns


def ground_shot_notes(
    stations: Stations,
    roles: Mapping[str, Channel],
    images: Collection[str],
    evidence: GroundEvidence = NOTHING_SAID,
) -> Notes:
    """Report exposures made while the aircraft was on the ground (test shots), by name.

    ``images`` : those with observations. The report is

    * a loss if more than half of all usable exposures are on the ground: the events are of another
      time;
    * else a warning if some of those on the ground have observations;
    * else a note.
    """
    height = roles.get("height")
    if height is None or len(stations) == 0:
        return ()
    on_ground_ns = times_on_the_ground(height, evidence)
    if on_ground_ns.size == 0:
        return ()
    is_on_ground = ns_to_nearest(stations.time_ns, on_ground_ns) < NANOSECONDS_PER_SECOND
    names = stations.image[stations.ok & is_on_ground].tolist()
    if not names:
        return ()
    observed = set(images)
    message = messages.exposures_on_ground(
        names=names,
        measured=sum(name in observed for name in names),
        are_most=2 * len(names) > int(np.count_nonzero(stations.ok)),
    )
    return (message,)


def choose_event_channel(channels: tuple[Channel, ...], name: str | None) -> Channel:
    """The event channel of a camera: the one of this name, or the only one of the best rank.

    ``name`` : from the mission file; None if it names no channel. Refuses (MissionError
    EVENTS-CHANNEL) if there is no such channel, or several of the best rank.
    """
    event_channels = [channel for channel in channels if channel.fits_role("events")]
    candidates = event_channels
    if name:
        candidates = [channel for channel in event_channels if channel.name == name]
    best_rank = min((channel.rank for channel in candidates), default=None)
    best = [channel for channel in candidates if channel.rank == best_rank]
    if len(best) == 1:
        return best[0]
    listed = [f"{channel.name} ({len(channel)})" for channel in event_channels]
    raise messages.event_channel_unknown(name=name, channels=listed)


def refuse_repeated_images(events: list[Events]) -> None:
    """Refuse (MissionError EVENTS-REPEATED) exposures that have the same image name.

    ``events`` : of each camera. The observations of such a name could belong to either exposure.
    """
    if not events:
        return
    names = np.concatenate([camera_events.image for camera_events in events])
    names = names[names != ""]  # "" where the files of the images give the names later
    unique, count = np.unique(names.astype(str), return_counts=True)
    repeated = unique[count > 1]
    if repeated.size:
        raise messages.image_names_repeated(total=repeated.size, example=str(repeated[0]))
