"""Camera pulses become exposures: their channel, the names of their images, and lost pulses."""

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

    A name is "" where only the images themselves give it. ``index`` (m,) : the numbers in the log,
    if they rise from the first event to the last; ``lost`` : how many numbers have no event.
    ``counts`` : whether the numbers of a file only count its rows: "always" where it has none of
    its own; "maybe" where they begin at 1 and skip none, as in a file renumbered after a loss.
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
    """What is added to times of events, positive where the shutter opens later, and its sigma."""

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

    In the pattern ``{index}`` stands for the number in the log, which may count modulo 65536, and
    ``{n}`` for the number of the event from 1. A pattern with ``*`` leaves the names empty: the
    images themselves give them. Numbers that the log skips are pulses that were lost.
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
    """Exposures of one camera from a table, ``delay`` later."""
    rows = camera_of == camera
    return Events(
        camera,
        image[rows],
        time_ns[rows] + delay.nanoseconds,
        sigma_time_s=delay.sigma_s,
    )


_MOST_INDEX = 1 << 53  # of an exposure: beyond, float64 has not every integer
_COUNT_ROUND = 1 << 16  # counts of 16 bits run over here
_COUNT_NEAR = 1 << 12  # a count that goes on farther than this from zero has begun anew


def unwrapped_numbers(index: Integers) -> Integers:
    """Image numbers of one power-up that go on beyond 65535, where the log begins at 0 again.

    ``index``: (n,) 16-bit numbers of the log, in the order of their time.

    >>> unwrapped_numbers(np.array([65534, 65535, 1, 2]))
    array([65534, 65535, 65537, 65538])
    """
    step = np.diff(index)
    # a large step back is from 65535 to 0; a smaller one is of a count that was set to zero
    ran_over = (step < 0) & (step + _COUNT_ROUND < _COUNT_NEAR)
    # a large step forward is of an image that was logged after its successor, which ran over
    went_back = (step > 0) & (_COUNT_ROUND - step < _COUNT_NEAR)
    rounds = np.cumsum(ran_over.astype(np.int64) - went_back)
    return np.asarray(index + _COUNT_ROUND * np.append(0, rounds), np.int64)


@dataclass(frozen=True)
class _SkippedNumbers:
    """Numbers of one power-up, from ``first`` to ``last``, of which some have no event.

    ``gaps`` are the first and the last number of each gap.
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
        """The loss to report, which lists the first gaps."""
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


_GAPS_LISTED = 4


def _skipped_numbers(channel: Channel, index: Integers) -> list[_SkippedNumbers]:
    """For each power-up with gaps in its numbers, which numbers have no event."""
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


def _number_as_logged(counted: int) -> int:
    """A number of a count that goes on beyond 16 bits, as the log has it."""
    return counted % _COUNT_ROUND if counted >= _COUNT_ROUND else counted


def _usual_shifts_ns() -> list[int]:
    """Shifts of clocks [ns], the most usual first, each later and earlier."""
    leap_seconds = 18
    hour = 3600
    quarter = 900
    widest_zone = 14 * hour
    sizes_s = [leap_seconds, *range(hour, widest_zone + 1, hour)]  # hours of time zones
    sizes_s += [24 * hour, 7 * 24 * hour]
    sizes_s += range(quarter, widest_zone + 1, quarter)  # rarer zones; whole hours twice, no matter
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
        """The span of times in rising order, at least one."""
        return cls(int(time_ns[0]), int(time_ns[-1]))

    def count_outside(self, time_ns: Integers) -> int:
        """How many times lie before or after the span."""
        outside = (time_ns < self.first_ns) | (time_ns > self.last_ns)
        return int(np.count_nonzero(outside))

    def __str__(self) -> str:
        ends = np.array([self.first_ns, self.last_ns], "datetime64[ns]").astype("datetime64[ms]")
        return f"{ends[0]} to {ends[1]}"


def span_notes(events: list[Events], position: Channel, key: str) -> Notes:
    """Events beyond the time of the flight: a warning, with a shift that would help.

    ``position`` has the time of the flight, ``key`` says where those of the events are stated. The
    shift of `_fitting_shift` is named if it brings more events into the flight. Refuses
    (MissionError EVENTS-SPAN) events more than half of which lie beyond the flight.
    """
    times = [exposed.time_ns for exposed in events]
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
        brought = f"{time_ns.size - still_beyond}" if still_beyond else "all"
        shift_that_fits = f"{shift_ns * 1e-9:+.6g} s would bring {brought} of them into the flight"
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
    """A shift [ns] that may bring events into the time of a flight.

    That is the first of the usual shifts (leap seconds, time zones, a day, a week) which brings all
    of them into it, else the one by which both begin together.
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
    """Report exposures made while the aircraft stood on the ground, by name: test shots.

    * A loss where more than half of all exposures are such: the events are of another time.
    * Else a warning where some of them are images of the observations.
    * Else a note.
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
        most=2 * len(names) > int(np.count_nonzero(stations.ok)),
    )
    return (message,)


def choose_event_channel(channels: tuple[Channel, ...], name: str | None) -> Channel:
    """The event channel of a camera: the one that was named, or the only one of the best rank.

    Refuses (MissionError EVENTS-CHANNEL) where there is none, or several have that rank.
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
    """Refuse two exposures of one name: the observations could belong to either."""
    if not events:
        return
    names = np.concatenate([exposed.image for exposed in events])
    names = names[names != ""]  # where the images themselves give the names later
    unique, count = np.unique(names.astype(str), return_counts=True)
    repeated = unique[count > 1]
    if repeated.size:
        raise messages.image_names_repeated(total=repeated.size, example=str(repeated[0]))
