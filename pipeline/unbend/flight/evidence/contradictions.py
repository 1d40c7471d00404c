"""Suspect stretches of a flight by all evidence of its log, and of what other programs imported."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence import filter_health as health
from unbend.flight.evidence import sources as src
from unbend.flight.evidence import stretches as spans
from unbend.flight.evidence.quality import subset
from unbend.flight.evidence.sources import SourcePath, Sources, is_receiver, velocity_at
from unbend.flight.evidence.stretches import ATTITUDE, HEIGHT, POSITION, SECOND, Stretch, merged
from unbend.flight.mount import is_of_gimbal
from unbend.flight.roles import follows_height
from unbend.messages import Entry, Notes, warning

_FEWEST = 10  # samples of which a channel must have more to be compared

# A difference from the log that is an autopilot's own, beyond a constant one [m].
LEAST_M = {POSITION: 5.0, HEIGHT: 10.0}

_SLOWEST_HZ, _SIGMAS = 1.0, 3.0


def examine(
    channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> tuple[dict[str, Channel], tuple[Stretch, ...], Notes]:
    """What all evidence of a log says against the position, height and attitude of its roles.

    Returns the roles with the samples of better sources; the suspect stretches, which name them;
    and notes on other sensors that are wrong.
    """
    evidence = list[Stretch]()
    if any(map(is_receiver, channels)):
        evidence = health.filter_evidence(channels) + health.message_evidence(channels)
    attitude, result, notes = roles.get(ATTITUDE), dict(roles), list[Entry]()
    found, turned = list[Stretch](), list[Stretch]()
    of_vehicle = attitude is not None and not is_of_gimbal(attitude.source.message)
    if attitude is not None and of_vehicle:
        turned = [s for s in evidence if s.quantity == ATTITUDE]
        turned += health.attitude_evidence(attitude, channels)
    for quantity in (POSITION, HEIGHT):
        mine = roles.get(quantity)
        if mine is None or len(src.with_places(mine, quantity)) <= _FEWEST:
            continue
        sources = sources_of(quantity, mine, channels, roles)
        steady = (roles.get(name) for name in (ATTITUDE, POSITION))
        while_on = next((c for c in steady if c is not None and c.name != mine.name), mine)
        suspect, drifts = contradictions_of(sources, while_on)
        of_filter = quantity == POSITION and not is_receiver(mine)
        if of_filter:
            suspect += [s for s in evidence if s.quantity == POSITION]
            # A filter whose vertical was wrong settles with its position.
            ends = [[s.end_ns, *(d.end_ns for d in merged(suspect) if s.meets(d))] for s in turned]
            turned = [replace(s, end_ns=max(end)) for s, end in zip(turned, ends, strict=True)]
        elif quantity == HEIGHT and is_receiver(mine):
            # A fix that has stepped away in position is wrong in height too.
            path = src.source_path(mine, POSITION, [mine, *sorted(channels, key=is_receiver)])
            away = [s for s in own_contradictions(path, POSITION) if np.isfinite(s.off_m)]
            suspect += [replace(s, quantity=HEIGHT, off_m=np.nan) for s in away]
            good = sources.own.good & ~spans.covered(away, sources.own.channel.time_ns)
            sources = replace(sources, own=replace(sources.own, good=good))
        for drift in merged(drifts):
            pressure = result["pressure"]
            result["pressure"] = subset(pressure, ~drift.covers(pressure.time_ns))
            what = f"{drift.reason}: its pressure is not used from {drift.when}"
            notes.append(warning("BARO-DRIFT", what, where=pressure.name))
        for stretch in merged(suspect):
            replacement = src.replacement_for(sources, stretch)
            if replacement is not None:
                better, offsets = replacement
                if of_filter and of_vehicle:
                    turned += src.drifted(sources.own, better, stretch)
                stretch = replace(stretch, replaced_by=better.other.channel.name)
                result[quantity] = src.with_replaced(result[quantity], better, stretch, offsets)
            found.append(stretch)
    return result, tuple(sorted([*found, *merged(turned)])), tuple(notes)


def sources_of(
    quantity: str, mine: Channel, channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> Sources:
    """Compare the source of a quantity with all others, receivers first, and barometers."""
    moving = sorted(channels, key=is_receiver)  # a filter's velocity is smoother than a receiver's
    others = [c for c in channels if c.name != mine.name and POSITION in c.roles]
    others = [c for c in others if len(src.with_places(c, quantity)) > _FEWEST]
    others.sort(key=lambda c: (not is_receiver(c), c.rank))
    pressure, barometers = roles.get("pressure"), list[Channel]()
    if pressure is not None and quantity == HEIGHT:
        more = (c for c in channels if "pressure" in c.roles and c.name != pressure.name)
        barometers = [pressure, *(c for c in more if follows_height(c, mine))]
        heights = (src.height_of_pressure(c, mine) for c in barometers)
        others += [h for h in heights if h is not None]
    own, steady_until_ns = src.source_path(mine, quantity, [mine, *moving]), None
    if own.lasting_ns.size:  # what is better after a step than before it was wrong before
        name = "sigma_v_m" if quantity == HEIGHT else "sigma_h_m"
        sigma, later = mine.columns.get(name, np.ones(len(mine))), mine.time_ns > own.lasting_ns[0]
        if not np.median(sigma[later]) < 0.5 * np.median(sigma[~later]):
            steady_until_ns = int(own.lasting_ns[0])
    differences = []
    for other in others:
        path = src.source_path(other, quantity, [other, *moving])
        speed = velocity_at([mine, *moving], quantity, path.channel.time_ns)
        apart = src.difference(mine, path, quantity, speed, steady_until_ns=steady_until_ns)
        differences.append(apart)
    return Sources(quantity, own, tuple(differences), tuple(c.name for c in barometers))


def contradictions_of(sources: Sources, while_on: Channel) -> tuple[list[Stretch], list[Stretch]]:
    """Where a source contradicts itself or the others, and where only the barometer is wrong."""
    own, name, quantity = sources.own, sources.own.channel.name, sources.quantity
    found, drifts = own_contradictions(own, quantity), list[Stretch]()
    receivers = [d.other for d in sources.differences if is_receiver(d.other.channel)]
    if is_receiver(own.channel):
        found += silences(own.channel, while_on, quantity)
    elif receivers:
        # A filter that was led away leaves the receiver's path less its steps. One that steps back
        # to it was wrong before the step, which its own path does not show.
        found = own_contradictions(receivers[0], quantity) if len(receivers) == 1 else []
        found = [s for s in found if not np.isfinite(s.off_m)]
        quiet = [silences(r.channel, own.channel, quantity) for r in receivers]
        found += [s for s in quiet[0] if all(any(map(s.meets, more)) for more in quiet[1:])]
    for d in sources.differences:
        other, time_ns = d.other, d.other.channel.time_ns
        for a, b in d.apart:
            off_m = float(np.nanmax(d.off_m[a : b + 1]))
            reason = f"{name} and {other.channel.name} are {off_m:.0f} m apart"
            if other.stepped_m[a : b + 1].any():
                reason = f"{other.channel.name} steps at {other.fastest_m_s:.0f} m/s; {reason}"
            stretch = Stretch(*spans.beside(time_ns, a, b), quantity, reason, off_m)
            of_receiver = is_receiver(own.channel) and not is_receiver(other.channel)
            if quantity == HEIGHT and of_receiver and receiver_is_right(sources, d, a, b):
                # A filter's height follows the barometer: it says nothing of its own.
                if other.channel.name in sources.barometers[:1]:
                    drifts.append(stretch)
            else:
                found.append(stretch)
    return found, drifts


def own_contradictions(track: SourcePath, quantity: str) -> list[Stretch]:
    """Where a source has stepped away from itself, or reports a poor accuracy."""
    time_ns, name, found = track.channel.time_ns, track.channel.name, []
    away = np.linalg.norm(track.stepped_m, axis=1)
    for a, b in spans.runs(time_ns, away > 0.0, away > 0.0):
        off_m = float(away[a : b + 1].max())
        reason = f"{name} steps by {off_m:.0f} m at {track.fastest_m_s:.0f} m/s"
        found.append(Stretch(*spans.beside(time_ns, a, b), quantity, reason, off_m))
    for time in track.lasting_ns.tolist():
        reason = f"{name} steps at {track.fastest_m_s:.0f} m/s and does not return"
        wide = src.LONGEST_REPLACED_S // 2 * SECOND
        found.append(Stretch(int(time - wide), int(time + wide), quantity, reason))
    poor = ~track.good & (away == 0.0)
    for a, b in spans.runs(time_ns, poor, poor):
        reason = f"{name} reports an accuracy worse than {src.WORST_ACCURACY_M:g} m"
        found.append(Stretch(*spans.beside(time_ns, a, b), quantity, reason))
    return found


def silences(channel: Channel, while_on: Channel, quantity: str) -> list[Stretch]:
    """When a receiver gives nothing though another channel goes on: it has no fix."""
    limit_ns = max(src.LONGEST_COAST_S, 5.0 / max(channel.rate_hz, 1e-3)) * SECOND
    edges = np.concatenate([while_on.time_ns[:1], channel.time_ns, while_on.time_ns[-1:]])
    found = []
    for k in np.flatnonzero(np.diff(edges) > limit_ns):
        begin, end = int(edges[k]), int(edges[k + 1])
        rows = int(np.diff(np.searchsorted(while_on.time_ns, [begin, end]))[0])
        if rows > 0.8 * while_on.rate_hz * (end - begin) / SECOND:
            reason = f"{channel.name} has no fix for {(end - begin) / SECOND:.0f} s"
            found.append(Stretch(begin + SECOND // 2, end, quantity, reason))
    return found


def receiver_is_right(sources: Sources, d: src.Difference, a: int, b: int) -> bool:
    """Whether a receiver's height is confirmed where a barometer, or a filter by it, departs.

    By its own vertical velocity from 10 s before to the greatest difference and about the end, or
    by a source that does not depend on that barometer and agrees all the time (rows a to b).
    """
    mine, time_ns = sources.own.channel, d.other.channel.time_ns
    beside_ns = int(src.BESIDE_S * SECOND)
    begin_ns, end_ns = time_ns[a] - beside_ns, time_ns[b] + beside_ns
    rows = (mine.time_ns >= begin_ns) & (mine.time_ns <= end_ns)
    if np.count_nonzero(rows) < 2 or sources.own.stepped_m[rows].any():
        return False
    worst = a + int(np.nanargmax(d.off_m[a : b + 1]))
    times = mine.time_ns[rows]
    climb = velocity_at([mine], HEIGHT, times)[:, 0]
    if np.isfinite(climb).all():
        climbed = np.cumsum(np.diff(times * 1e-9) * (climb[1:] + climb[:-1]) / 2.0)
        left = np.append(0.0, climbed) - src.places_of(mine, HEIGHT)[0][rows, 0]
        at = np.searchsorted(times, [begin_ns, time_ns[worst], time_ns[b] - beside_ns, end_ns])
        left = left[np.minimum(at, times.size - 1)]
        return bool((np.abs(left[1::2] - left[::2]) < 0.5 * float(d.off_m[worst])).all())
    for free in sources.differences:
        stamps = free.other.channel.time_ns
        inside = (stamps >= time_ns[a]) & (stamps <= time_ns[b])
        name = free.other.channel.name
        independent = is_receiver(free.other.channel) or name in sources.barometers[1:]
        agrees = inside.any() and bool((free.off_m[inside] < free.limit_m).all())
        if independent and name != d.other.channel.name and agrees:
            return True
    return False


def contradictions_of_import(
    imported: Channel,
    quantities: Sequence[str],
    own: Mapping[str, Channel],
    own_suspect: Sequence[Stretch],
) -> tuple[Stretch, ...]:
    """Stretches in which an imported channel steps, or leaves what the log has in the same roles.

    ``own`` are the roles as the log fills them, but for ``own_suspect`` stretches. Steps are looked
    for at 1 Hz and faster. What three of the channel's own sigmas explain is no contradiction.
    """
    found = []
    for quantity in (q for q in (POSITION, HEIGHT) if q in quantities):
        mine = src.with_places(imported, quantity)
        if len(mine) <= _FEWEST:
            continue
        sigma = mine.columns.get("sigma_v_m" if quantity == HEIGHT else "sigma_h_m")
        stated = np.zeros(len(mine)) if sigma is None else np.nan_to_num(sigma)
        bare = {name: v for name, v in mine.columns.items() if not name.startswith("sigma_")}
        moving = [mine, *(own[name] for name in (POSITION, HEIGHT) if name in own)]
        path = src.source_path(replace(mine, columns=bare), quantity, moving)
        stretches = own_contradictions(path, quantity) if mine.rate_hz >= _SLOWEST_HZ else []
        log = src.with_places(own[quantity], quantity) if quantity in own else None
        if log is not None and len(log) > _FEWEST:
            still, one = np.zeros_like(path.stepped_m), mine.boot.astype(np.intp)
            whole = replace(path, stepped_m=still, good=np.ones(len(mine), np.bool_), part=one)
            # Heights above two surfaces are apart where nothing lags.
            speed = still if quantity == HEIGHT else velocity_at(moving, quantity, mine.time_ns)
            apart = src.difference(log, whole, quantity, speed)
            silent = spans.covered([s for s in own_suspect if s.quantity == quantity], mine.time_ns)
            off = np.where(silent, 0.0, np.nan_to_num(apart.off_m))
            limit = max(apart.limit_m, LEAST_M[quantity])
            for a, b in spans.runs(mine.time_ns, off > 0.5 * limit, off > limit):
                off_m = float(off[a : b + 1].max())
                reason = f"{mine.name} and {log.name} are {off_m:.0f} m apart"
                ends = spans.beside(mine.time_ns, a, b)
                stretches.append(Stretch(*ends, quantity, reason, off_m))
        for stretch in merged(stretches):
            reported = float(stated[stretch.covers(mine.time_ns)].max(initial=0.0))
            if not stretch.off_m < _SIGMAS * reported:
                found.append(stretch)
    return tuple(found)
