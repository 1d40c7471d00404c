"""Camera pulses become exposures: their channel, the names of their images, and lost pulses."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from unbend.errors import MissionError
from unbend.flight.channels import Channel
from unbend.flight.ground_times import times_on_the_ground
from unbend.flight.stations import Stations
from unbend.messages import Entry, Notes, loss, note, warning
from unbend.units import Array, Integers, Names


@dataclass(frozen=True, eq=False)
class Events:
    """Exposures of one camera: (m,) names, times (UTC, ns) and, one or (m,), their sigma [s].

    A name is "" where only the images themselves give it. ``index`` (m,) are the log's numbers
    where they count on from the first event to the last, ``lost`` how many of them have no event.
    ``counts`` of a file: always, where its rows have no numbers of their own, or maybe, where they
    begin at 1 and skip none, which a file renumbered after a loss does too.
    """

    camera: str
    image: Names
    time_ns: Integers
    sigma_time_s: Array | float = 0.0
    index: Integers | None = None
    lost: int = 0
    counts: Literal["no", "maybe", "always"] = "no"


LONGEST_LAG_S, FEWEST_PAIRS = 1.0, 10


def lag_from_feedback(
    channels: tuple[Channel, ...], trigger: Channel, camera: str
) -> tuple[tuple[float, float], Notes]:
    """The shutter's lag behind the trigger and its sigma [s], by triggers with a logged pulse.

    The median of the pairs of one number and power-up, with their scatter as sigma; refuses
    (MissionError EVENTS-FEEDBACK) fewer than ten, or events that are no triggers.
    """
    lags = np.empty(0)
    for shots in channels:
        pairs = shots.source.message == "CAM" and trigger.source.message == "TRIG"
        if not pairs or not _of_one_camera(trigger, shots):
            continue
        sent, seen = (c["event_index"] + 1e6 * c.boot for c in (trigger, shots))
        _, first, second = np.intersect1d(sent, seen, return_indices=True)
        apart = (shots.time_ns[second] - trigger.time_ns[first]) * 1e-9
        lags = np.append(lags, apart[(apart > 0.0) & (apart < LONGEST_LAG_S)])
    if lags.size < FEWEST_PAIRS:
        where, needed = f"events.log.{camera}.delay_s", FEWEST_PAIRS
        raise MissionError.of(
            "EVENTS-FEEDBACK", where, name=trigger.name, found=lags.size, needed=needed
        )
    low, middle, high = np.percentile(lags, [16.0, 50.0, 84.0])
    entry = note("EVENTS-SHUTTER-LAG", where=trigger.name, count=int(lags.size), camera=camera,
                 lag_ms=middle * 1e3, scatter_ms=(high - low) * 5e2)  # fmt: skip
    return (float(middle), float(high - low) / 2.0), (entry,)


def events_of_channel(
    channel: Channel, camera: str, pattern: str, delay_s: float, sigma_s: float = 0.0
) -> tuple[Events, Notes]:
    """Exposures of an event channel, named by a pattern of ``{index}`` and ``{n}``.

    ``pattern``: with ``*`` in it, the names are those of images that exist, and left empty here.
    ``delay_s``: what is added to the times of the log [s], positive where the shutter opens later.
    ``sigma_s``: of that [s].

    Numbers that the log skips are pulses that were lost: a loss for each power-up. ``{index}`` is
    the number as the log has it, which may count modulo 65536.
    """
    index = channel["event_index"].astype(np.int64)
    names = ["" if "*" in pattern else pattern.format(index=int(i), n=n)
             for n, i in enumerate(index, start=1)]  # fmt: skip
    notes = tuple(_skipped_numbers(channel, index))
    time_ns = channel.time_ns + round(delay_s * 1e9)
    logged = np.nan_to_num(channel.columns.get("sigma_time_s", np.zeros(len(channel))))
    late = np.hypot(logged, sigma_s)
    counts_on = bool((np.diff(unwrapped_numbers(index)) > 0).all())
    lost = sum(entry.count for entry in notes)
    image = np.array(names, dtype=object)
    return Events(camera, image, time_ns, late, index if counts_on else None, lost), notes


def events_of_table(
    image: Names,
    camera_of: NDArray[Any],
    time_ns: Integers,
    camera: str,
    delay_s: float,
    *,
    sigma_s: float = 0.0,
) -> Events:
    """Exposures of one camera from a table, ``delay_s`` [s] later, with ``sigma_s`` [s]."""
    rows = camera_of == camera
    return Events(camera, image[rows], time_ns[rows] + round(delay_s * 1e9), sigma_s)


# Counts of 16 bits run over; a count that goes on farther than this from zero has begun anew.
_COUNT_ROUND, _COUNT_NEAR = 1 << 16, 1 << 12


def unwrapped_numbers(index: Integers) -> Integers:
    """Image numbers that count on where a number of 16 bits ran over.

    ``index``: (n,) in the order of their time, of one power-up.

    >>> unwrapped_numbers(np.array([65534, 65535, 1, 2]))
    array([65534, 65535, 65537, 65538])
    """
    step = np.diff(index)
    ran_over = (step < 0) & (step + _COUNT_ROUND < _COUNT_NEAR)
    went_back = (step > 0) & (_COUNT_ROUND - step < _COUNT_NEAR)  # logged after its successor
    rounds = np.cumsum(ran_over.astype(np.int64) - went_back)
    return np.asarray(index + _COUNT_ROUND * np.append(0, rounds), np.int64)


def _skipped_numbers(channel: Channel, index: Integers) -> Iterator[Entry]:
    """A loss for each power-up in which numbers between others have no event."""
    for boot in np.unique(channel.boot):
        known = np.unique(unwrapped_numbers(index[channel.boot == boot]))
        gaps = np.diff(known) - 1
        missing = int(gaps.sum())
        if missing == 0:
            continue
        holes = zip(known[:-1][gaps > 0][:4].tolist(), gaps[gaps > 0][:4].tolist(), strict=True)
        first = [
            f"{_sent(low + 1)}" if gap == 1 else f"{_sent(low + 1)} to {_sent(low + gap)}"
            for low, gap in holes
        ]
        listed = ", ".join(first) + (" ..." if np.count_nonzero(gaps) > 4 else "")
        where = channel.name if channel.boot[-1] == 0 else f"{channel.name}, boot {boot}"
        begin, end = _sent(int(known[0])), _sent(int(known[-1]))
        yield loss("EVENTS-LOST/numbers", where=where, count=missing, listed=listed, first=begin,
                   last=end)  # fmt: skip


def _sent(counted: int) -> int:
    """A counted number as the log has it."""
    return counted % _COUNT_ROUND if counted >= _COUNT_ROUND else counted


_USUAL_SHIFTS_S = [
    sign * size
    for size in (18, *range(3600, 50_401, 3600), 86_400, 604_800, *range(900, 50_401, 900))
    for sign in (1, -1)
]
"""Leap seconds, whole hours of time zones, a day, a week, quarters of an hour: in this order."""


def span_notes(events: list[Events], position: Channel, key: str) -> Notes:
    """Events beyond the time of the flight: a warning, with the shift by which they would fit.

    That is the first of leap seconds, time zones, a day and a week which brings all of them into
    the span of ``position``, else the one that makes both begin together, if it brings more of them
    into it. ``key`` says where the times are stated. Refuses (MissionError EVENTS-SPAN) where more
    than half lie beyond it.
    """
    time_ns = np.sort(np.concatenate([np.empty(0, np.int64), *(e.time_ns for e in events)]))
    if time_ns.size == 0 or len(position) == 0:
        return ()
    first, last = int(position.time_ns[0]), int(position.time_ns[-1])
    beyond = int(np.count_nonzero((time_ns < first) | (time_ns > last)))
    if beyond == 0:
        return ()
    shifts = [shift * 1_000_000_000 for shift in _USUAL_SHIFTS_S]
    able = [s for s in shifts if time_ns[0] + s >= first and time_ns[-1] + s <= last]
    shift = [*able, first - int(time_ns[0])][0]
    left = int(np.count_nonzero((time_ns + shift < first) | (time_ns + shift > last)))
    spans = [
        " to ".join(str(np.datetime64(t, "ns").astype("datetime64[ms]")) for t in span)
        for span in ((int(time_ns[0]), int(time_ns[-1])), (first, last))
    ]
    fitting = f"{shift * 1e-9:+.6g} s would bring {time_ns.size - left if left else 'all'} of them"
    fitting = fitting if left < beyond else "no offset would bring more of them"
    what = f"{beyond} of {time_ns.size} events lie beyond the flight: events {spans[0]}, "
    what += f"{position.name} {spans[1]}; {fitting} into it"
    if 2 * beyond > time_ns.size:
        raise MissionError.of("EVENTS-SPAN", key, what=what, stated=key)
    return (warning("EVENTS-SPAN", what, where=key, count=beyond),)


def ground_shot_notes(
    stations: Stations, roles: Mapping[str, Channel], images: Collection[str]
) -> Notes:
    """Exposures made while the aircraft stood on the ground, by name: test shots.

    A note; a warning where some of them are images of the observations, a loss where more than
    half of all exposures are: then the events are of another time.
    """
    height = roles.get("height")
    on_ground_ns = times_on_the_ground(height) if height is not None else np.empty(0, np.int64)
    if on_ground_ns.size == 0 or len(stations) == 0:
        return ()
    near = np.clip(np.searchsorted(on_ground_ns, stations.time_ns), 1, on_ground_ns.size - 1)
    away = [np.abs(stations.time_ns - on_ground_ns[row]) for row in (near - 1, near)]
    names = stations.image[stations.ok & (np.minimum(*away) < 1_000_000_000)].tolist()
    if not names:
        return ()
    measured = [name for name in names if name in set(images)]
    what = f"{len(names)} exposures were made while the aircraft stood on the ground: "
    what += ", ".join(names[:5]) + (" ..." if len(names) > 5 else "")
    what += f"; {len(measured)} of them are in the observations" if measured else ""
    entry = loss if 2 * len(names) > int(stations.ok.sum()) else warning if measured else note
    return (entry("EVENTS-ON-GROUND", what, where="events", count=len(names)),)


def choose_event_channel(channels: tuple[Channel, ...], name: str | None) -> Channel:
    """The event channel of a camera: the one that was named, or the only one of the best rank."""
    able = [c for c in channels if c.fits_role("events")]
    candidates = [c for c in able if c.name == name] if name else able
    if candidates:
        best = [c for c in candidates if c.rank == min(c.rank for c in candidates)]
        if len(best) == 1:
            return best[0]
    there = ", ".join(f"{c.name} ({len(c)})" for c in able) or "no camera events at all"
    what = f"the log has no event channel {name!r}" if name else "which events are this camera's?"
    raise MissionError.of("EVENTS-CHANNEL", "events.log", text=what, there=there)


def trigger_notes(channels: tuple[Channel, ...], chosen: Channel) -> Iterator[Entry]:
    """How many triggers have no shutter event, and whether the events are triggers themselves.

    ArduPilot logs TRIG at the trigger and CAM at the feedback of a camera with a feedback pin, and
    without one CAM alone, at the trigger. Cameras fire apart: the rows of an instance belong to one
    camera.
    """
    triggers = [c for c in channels if c.source.message == "TRIG" and _of_one_camera(c, chosen)]
    if chosen.source.message in ("TRIG", "CAMERA_TRIGGER") or (
        chosen.source.message == "CAM" and not triggers
    ):
        yield note("EVENTS-TRIGGER-TIME", where=chosen.name, count=len(chosen))
    for trigger in triggers if chosen.source.message == "CAM" else ():
        fired = [c for c in channels if c.source.message == "CAM" and _of_one_camera(trigger, c)]
        names, events = ", ".join(c.name for c in fired), sum(map(len, fired))
        if len(trigger) > events:
            yield loss("EVENTS-LOST/triggers", where=names, count=len(trigger) - events,
                       events=events, sent=len(trigger), trigger=trigger.name)  # fmt: skip


def _of_one_camera(trigger: Channel, shots: Channel) -> bool:
    """Whether a trigger may belong to the camera of some events: any, without an instance."""
    return trigger.source.instance in (None, shots.source.instance)


def refuse_repeated_images(events: list[Events]) -> None:
    """Refuse two exposures of one name: the observations could belong to either."""
    names = np.concatenate([e.image for e in events]) if events else np.empty(0, object)
    names = names[names != ""]
    unique, count = np.unique(names.astype(str), return_counts=True)
    if bool((count > 1).any()):
        twice = unique[count > 1]
        raise MissionError.of("EVENTS-REPEATED", "events", total=twice.size, example=twice[0])
