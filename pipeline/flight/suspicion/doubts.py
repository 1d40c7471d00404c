"""Doubtful stretches of a flight by all evidence of its log, and the sources that stand in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.flight.channels import Array, Channel
from pipeline.flight.mount import is_of_gimbal
from pipeline.flight.quality import subset
from pipeline.flight.roles import follows_height
from pipeline.flight.stations import Stations
from pipeline.flight.suspicion.evidence import (
    ATTITUDE,
    Stretch,
    attitude_evidence,
    covered,
    filter_evidence,
    message_evidence,
)
from pipeline.flight.suspicion.sources import (
    HEIGHT,
    POSITION,
    SECOND,
    WORST_ACCURACY_M,
    Difference,
    SourcePath,
    beside,
    difference,
    height_of_pressure,
    moved,
    places_of,
    runs,
    track_of,
    velocity_at,
    with_places,
)
from pipeline.ledger import Entry, Notes, fallback, loss, warning

LONGEST_COAST_S = 2.0
"""A filter without a receiver for longer is no longer known to be right [s]."""

BESIDE_S = 10.0
"""A source that stands in for another agrees with it for so long before and after [s]."""

LONGEST_STAND_IN_S = 60
"""A filter without its receiver, or a barometer, stands in for no longer [s]."""

LARGEST_DRIFT_M_S2 = 0.02
"""Half the acceleration by which a filter drifts whose vertical is 0.25 degrees wrong [m/s2]."""

_FEWEST = 10  # samples of which a channel must have more to be compared


@dataclass(frozen=True, eq=False)
class Sources:
    """The source that plays the role of a quantity, and its difference from each other one.

    ``barometers`` names those compared, first the one that plays the role of the pressure.
    """

    quantity: str
    own: SourcePath
    differences: tuple[Difference, ...]
    barometers: tuple[str, ...] = ()


def is_receiver(channel: Channel) -> bool:
    """Whether a channel is a GNSS receiver, which gives both positions and heights."""
    return {POSITION, HEIGHT} <= set(channel.roles)


def examine(
    channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> tuple[dict[str, Channel], tuple[Stretch, ...], Notes]:
    """What all evidence of a log says against the position, height and attitude of its roles.

    Returns the roles, with the samples of a better source where one stands in; the doubtful
    stretches, those with a stand-in named so; and notes on other sensors that are wrong.
    """
    receivers = [c for c in channels if is_receiver(c)]
    evidence = [*filter_evidence(channels), *message_evidence(channels)] if receivers else []
    attitude, result, notes = roles.get(ATTITUDE), dict(roles), list[Entry]()
    found, turned = list[Stretch](), list[Stretch]()
    of_vehicle = attitude is not None and not is_of_gimbal(attitude.source.message)
    if attitude is not None and of_vehicle:
        turned = [s for s in evidence if s.quantity == ATTITUDE]
        turned += attitude_evidence(attitude, channels)
    for quantity in (POSITION, HEIGHT):
        mine = roles.get(quantity)
        if mine is None or len(with_places(mine, quantity)) <= _FEWEST:
            continue
        sources = sources_of(quantity, mine, channels, roles)
        steady = (roles.get(name) for name in (ATTITUDE, POSITION))
        while_on = next((c for c in steady if c is not None and c.name != mine.name), mine)
        doubts, drifts = doubts_of(sources, while_on)
        of_filter = quantity == POSITION and not is_receiver(mine)
        if of_filter:
            doubts += [s for s in evidence if s.quantity == POSITION]
            # A filter whose vertical was wrong settles with its position.
            ends = [[s.end_ns, *(d.end_ns for d in merged(doubts) if s.meets(d))] for s in turned]
            turned = [replace(s, end_ns=max(end)) for s, end in zip(turned, ends, strict=True)]
        elif quantity == HEIGHT and is_receiver(mine):
            # A fix that has stepped away in position is wrong in height too.
            path = track_of(mine, POSITION, [mine, *sorted(channels, key=is_receiver)])
            away = [s for s in self_doubts(path, POSITION) if np.isfinite(s.off_m)]
            doubts += [replace(s, quantity=HEIGHT, off_m=np.nan) for s in away]
            good = sources.own.good & ~covered(away, sources.own.channel.time_ns)
            sources = replace(sources, own=replace(sources.own, good=good))
        for drift in merged(drifts):
            pressure = result["pressure"]
            result["pressure"] = subset(pressure, ~drift.covers(pressure.time_ns))
            what = f"{drift.reason}: its pressure is not used from {drift.when}"
            notes.append(warning("BARO-DRIFT", what, where=pressure.name))
        for doubt in merged(doubts):
            found_one = stand_in_for(sources, doubt)
            if found_one is not None:
                stand_in, offsets = found_one
                if of_filter and of_vehicle:
                    turned += drifted(sources.own, stand_in, doubt)
                doubt = replace(doubt, instead=stand_in.other.channel.name)
                result[quantity] = spliced(result[quantity], stand_in, doubt, quantity, offsets)
            found.append(doubt)
    return result, tuple(sorted([*found, *merged(turned)])), tuple(notes)


def merged(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Stretches of one quantity that touch, as one, with up to three of their reasons."""
    result: list[Stretch] = []
    for stretch in sorted(stretches):
        last = result[-1] if result else None
        if last is None or stretch.begin_ns > last.end_ns + SECOND:
            result.append(stretch)
            continue
        reasons = last.reason.split("; ")
        if stretch.reason not in reasons and len(reasons) < 3:
            reasons.append(stretch.reason)
        end, off_m = max(last.end_ns, stretch.end_ns), float(np.fmax(last.off_m, stretch.off_m))
        result[-1] = replace(last, end_ns=end, reason="; ".join(reasons), off_m=off_m)
    return result


def sources_of(
    quantity: str, mine: Channel, channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> Sources:
    """Compare the source of a quantity with all others, receivers first; heights with barometers.

    The height of a barometer is that of the flight's own relation of pressure and height.
    """
    moving = sorted(channels, key=is_receiver)  # a filter's velocity is smoother than a receiver's
    others = [
        c
        for c in sorted(channels, key=lambda c: (not is_receiver(c), c.rank))
        if c.name != mine.name and POSITION in c.roles
        and len(with_places(c, quantity)) > _FEWEST
    ]  # fmt: skip
    pressure, barometers = roles.get("pressure"), list[Channel]()
    if pressure is not None and quantity == HEIGHT:
        barometers = [pressure] + [
            c
            for c in channels
            if "pressure" in c.roles and c.name != pressure.name and follows_height(c, mine)
        ]
        heights = (height_of_pressure(c, mine) for c in barometers)
        others += [h for h in heights if h is not None]
    differences = []
    for other in others:
        track = track_of(other, quantity, [other, *moving])
        velocity = velocity_at([mine, *moving], quantity, track.channel.time_ns)
        differences.append(difference(mine, track, quantity, velocity))
    own = track_of(mine, quantity, [mine, *moving])
    return Sources(quantity, own, tuple(differences), tuple(c.name for c in barometers))


def doubts_of(sources: Sources, while_on: Channel) -> tuple[list[Stretch], list[Stretch]]:
    """Where a source contradicts itself or the others, and where only the barometer is wrong.

    ``while_on`` is a channel that goes on where a receiver has no fix.
    """
    own, name, quantity = sources.own, sources.own.channel.name, sources.quantity
    found, drifts = self_doubts(own, quantity), list[Stretch]()
    receivers = [d.other for d in sources.differences if is_receiver(d.other.channel)]
    if is_receiver(own.channel):
        found += silences(own.channel, while_on, quantity)
    elif receivers:
        # A filter that was led away leaves the receiver's path less its steps. One that steps back
        # to it was wrong before the step, which its own path does not tell.
        found = self_doubts(receivers[0], quantity) if len(receivers) == 1 else []
        found = [s for s in found if not np.isfinite(s.off_m)]
        quiet = [silences(r.channel, own.channel, quantity) for r in receivers]
        found += [s for s in quiet[0] if all(any(map(s.meets, more)) for more in quiet[1:])]
    for d in sources.differences:
        other, time_ns = d.other, d.other.channel.time_ns
        for a, b in d.apart:
            off_m = float(np.nanmax(d.off_m[a : b + 1]))
            reason = f"{name} and {other.channel.name} are {off_m:.0f} m apart"
            if other.wander_m[a : b + 1].any():
                reason = f"{other.channel.name} steps at {other.fastest_m_s:.0f} m/s; {reason}"
            stretch = Stretch(*beside(time_ns, a, b), quantity, reason, off_m)
            of_receiver = is_receiver(own.channel) and not is_receiver(other.channel)
            if quantity == HEIGHT and of_receiver and receiver_is_right(sources, d, a, b):
                # A filter's height follows the barometer: it says nothing of its own.
                if other.channel.name in sources.barometers[:1]:
                    drifts.append(stretch)
            else:
                found.append(stretch)
    return found, drifts


def self_doubts(track: SourcePath, quantity: str) -> list[Stretch]:
    """Where a source has stepped away from itself, or reports a poor accuracy."""
    time_ns, name, found = track.channel.time_ns, track.channel.name, []
    away = np.linalg.norm(track.wander_m, axis=1)
    for a, b in runs(time_ns, away > 0.0, away > 0.0):
        off_m = float(away[a : b + 1].max())
        reason = f"{name} steps by {off_m:.0f} m at {track.fastest_m_s:.0f} m/s"
        found.append(Stretch(*beside(time_ns, a, b), quantity, reason, off_m))
    for time in track.lone_ns.tolist():
        reason = f"{name} steps at {track.fastest_m_s:.0f} m/s and does not return"
        wide = LONGEST_STAND_IN_S // 2 * SECOND
        found.append(Stretch(int(time - wide), int(time + wide), quantity, reason))
    poor = ~track.good & (away == 0.0)
    for a, b in runs(time_ns, poor, poor):
        reason = f"{name} reports an accuracy worse than {WORST_ACCURACY_M:g} m"
        found.append(Stretch(*beside(time_ns, a, b), quantity, reason))
    return found


def silences(channel: Channel, while_on: Channel, quantity: str) -> list[Stretch]:
    """When a receiver gives nothing though another channel goes on: it has no fix."""
    limit_ns = max(LONGEST_COAST_S, 5.0 / max(channel.rate_hz, 1e-3)) * SECOND
    edges = np.concatenate([while_on.time_ns[:1], channel.time_ns, while_on.time_ns[-1:]])
    found = []
    for k in np.flatnonzero(np.diff(edges) > limit_ns):
        begin, end = int(edges[k]), int(edges[k + 1])
        rows = int(np.diff(np.searchsorted(while_on.time_ns, [begin, end]))[0])
        if rows > 0.8 * while_on.rate_hz * (end - begin) / SECOND:
            reason = f"{channel.name} has no fix for {(end - begin) / SECOND:.0f} s"
            found.append(Stretch(begin + SECOND // 2, end, quantity, reason))
    return found


def receiver_is_right(sources: Sources, d: Difference, a: int, b: int) -> bool:
    """Whether a receiver's height is confirmed where a barometer, or a filter by it, departs.

    By its own vertical velocity from 10 s before to the greatest difference, or by a source that
    does not depend on that barometer and agrees all the time. ``a`` and ``b`` are rows of the other
    source of ``d``.
    """
    own, time_ns = sources.own, d.other.channel.time_ns
    worst = a + int(np.nanargmax(d.off_m[a : b + 1]))
    mine = own.channel
    rows = np.flatnonzero(
        (mine.time_ns >= time_ns[a] - BESIDE_S * SECOND) & (mine.time_ns <= time_ns[b])
    )
    if rows.size < 2 or own.wander_m[rows].any():
        return False
    rows = rows[mine.time_ns[rows] <= time_ns[worst]]
    climb = velocity_at([mine], HEIGHT, mine.time_ns[rows])[:, 0]
    if rows.size > 1 and np.isfinite(climb).all():
        dt = np.diff(mine.time_ns[rows]) * 1e-9
        h, _ = places_of(mine, HEIGHT)
        climbed = float(np.sum(0.5 * (climb[1:] + climb[:-1]) * dt))
        return abs(climbed - float(h[rows[-1], 0] - h[rows[0], 0])) < 0.5 * float(d.off_m[worst])
    for free in sources.differences:
        stamps = free.other.channel.time_ns
        inside = (stamps >= time_ns[a]) & (stamps <= time_ns[b])
        name = free.other.channel.name
        independent = is_receiver(free.other.channel) or name in sources.barometers[1:]
        agrees = inside.any() and bool((free.off_m[inside] < free.limit_m).all())
        if independent and name != d.other.channel.name and agrees:
            return True
    return False


def stand_in_for(sources: Sources, doubt: Stretch) -> tuple[Difference, list[Array]] | None:
    """The source that replaces a doubtful one where it is plain who is wrong, and two offsets.

    Who is wrong has steps of its own, a poor accuracy or no fix: the source itself, or, where that
    is a filter, one of several receivers. The one that stands in has none of these from 10 s before
    to 10 s after, and agrees before and after, where its offsets are taken. A filter or a barometer
    stands in for a receiver, for at most 60 s.
    """
    own, long = sources.own, doubt.end_ns - doubt.begin_ns > LONGEST_STAND_IN_S * SECOND
    wide = replace(doubt, begin_ns=doubt.begin_ns - SECOND, end_ns=doubt.end_ns + SECOND)

    def fails(track: SourcePath) -> bool:
        rows = wide.covers(track.channel.time_ns)
        silent = bool(np.diff(track.channel.time_ns[rows], prepend=wide.begin_ns,
                              append=wide.end_ns).max() > LONGEST_COAST_S * SECOND)  # fmt: skip
        return silent or not track.good[rows].all() or bool(wide.covers(track.step_ns).any())

    paths = [own, *(d.other for d in sources.differences)]
    if not any(fails(path) for path in paths if is_receiver(path.channel)):
        return None
    for d in sources.differences:
        channel = d.other.channel
        if fails(d.other) or (not is_receiver(channel) and (long or not is_receiver(own.channel))):
            continue
        margin = int(BESIDE_S * SECOND)
        before = replace(wide, begin_ns=wide.begin_ns - margin, end_ns=wide.begin_ns)
        after = replace(wide, begin_ns=wide.end_ns, end_ns=wide.end_ns + margin)
        known = np.isfinite(d.off_m)
        sides = [side.covers(channel.time_ns) & known for side in (before, after)]
        if all(
            np.count_nonzero(side) > 4 and np.percentile(d.off_m[side], 90.0) < d.limit_m
            for side in sides
        ):
            return d, [np.median(d.apart_m[side], axis=0) for side in sides]
    return None


def drifted(own: SourcePath, d: Difference, doubt: Stretch) -> list[Stretch]:
    """A filter that left its stand-in without a step has a wrong vertical: a doubtful attitude.

    A quarter of a degree of tilt carries a coasting filter 0.02 m/s² t² away.
    """
    time_ns = d.other.channel.time_ns
    stepped = np.interp(time_ns, own.channel.time_ns, own.wander_m.any(axis=1))
    off = np.where(doubt.covers(time_ns) & (stepped == 0.0), np.nan_to_num(d.off_m), 0.0)
    worst = int(np.argmax(off))
    t = (int(time_ns[worst]) - doubt.begin_ns) / SECOND
    if off[worst] < max(d.limit_m, LARGEST_DRIFT_M_S2 * t**2):
        return []
    reason = f"{own.channel.name} drifts {off[worst]:.0f} m in {t:.0f} s, as with a wrong vertical"
    return [replace(doubt, quantity=ATTITUDE, reason=reason, off_m=np.nan)]


def spliced(
    channel: Channel, d: Difference, doubt: Stretch, quantity: str, offsets: list[Array]
) -> Channel:
    """The channel with the samples of another source in a stretch, its lag and offset taken out.

    The offset is the mean of those before and after; half their difference and the usual
    difference of the two go into the standard deviation, with the source's own.
    """
    other, sigma = d.other.channel, "sigma_v_m" if quantity == HEIGHT else "sigma_h_m"
    time_ns = other.time_ns - round(d.lag_s * 1e9)
    inside, keep = doubt.covers(time_ns), ~doubt.covers(channel.time_ns)
    spread = np.hypot(0.5 * float(np.linalg.norm(offsets[1] - offsets[0])), d.usual_m)
    fill = {name: values[inside] for name, values in other.columns.items()}
    fill |= moved(other, inside, 0.5 * (offsets[0] + offsets[1]), channel.height_column)
    unknown = np.full(np.count_nonzero(inside), np.nan)
    fill[sigma] = np.hypot(np.nan_to_num(fill.get(sigma, unknown)), spread)
    joined, rows = np.unique(
        np.concatenate([channel.time_ns[keep], time_ns[inside]]), return_index=True
    )

    def column(name: str) -> Array:
        mine = channel.columns.get(name, np.full(len(channel), np.nan))[keep]
        return np.concatenate([mine, fill.get(name, unknown)])[rows]

    boot = np.concatenate([channel.boot[keep], other.boot[inside]])[rows]
    columns = {name: column(name) for name in (*channel.columns, sigma)}
    return replace(channel, time_ns=joined, boot=boot, columns=columns, labels={})


def flag_doubtful(
    stations: Stations, stretches: Sequence[Stretch], *, use_suspect: bool
) -> tuple[Stations, Notes]:
    """Mark the stations in doubtful stretches as suspect, and note those with a stand-in.

    With ``use_suspect`` they stay usable; the loss is entered all the same.
    """
    notes, suspects = [], stations.ok
    for stretch in stretches:
        rows = stretch.covers(stations.time_ns) & suspects
        count = int(rows.sum())
        if count == 0:
            continue
        when = f"{count} exposures from {stretch.when}, the first {stations.image[np.argmax(rows)]}"
        far = f", up to {stretch.off_m:.0f} m off" if np.isfinite(stretch.off_m) else ""
        if stretch.instead:
            what = f"{when}: {stretch.quantity} from {stretch.instead}, because {stretch.reason}"
            notes.append(fallback("STATIONS-STAND-IN", what, where=stretch.quantity, count=count))
            continue
        what = f"{when}: {stretch.quantity} is suspect{far}: {stretch.reason}"
        notes.append(loss("STATIONS-SUSPECT", what, where=stretch.quantity, count=count))
        stations = stations.as_suspect(rows, stretch.reason, stretch.off_m, use=use_suspect)
    return stations, tuple(notes)
