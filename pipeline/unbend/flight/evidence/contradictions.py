"""Suspect stretches of a flight by all evidence of its log, and of what other programs imported."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.filter_health import (
    attitude_evidence,
    filter_evidence,
    message_evidence,
)
from unbend.flight.evidence.messages import barometer_drifts, spare_barometer_drifts
from unbend.flight.evidence.sources import (
    BESIDE_S,
    LONGEST_COAST_S,
    LONGEST_REPLACED_S,
    WORST_ACCURACY_M,
    Difference,
    SourcePath,
    Sources,
    drifted,
    height_of_pressure,
    is_receiver,
    places_of,
    replacement_for,
    sigma_column,
    source_difference,
    source_path,
    velocity_at,
    with_places,
    with_replaced,
)
from unbend.flight.evidence.stretches import (
    ATTITUDE,
    HEIGHT,
    POSITION,
    SECOND,
    Run,
    Stretch,
    covered,
    merged,
    runs,
    stretch_of_run,
)
from unbend.flight.mount import is_of_gimbal
from unbend.flight.roles import follows_height
from unbend.messages import Message, Notes
from unbend.units import Array

_FEWEST = 10  # samples of which a channel must have more to be compared

# A difference from the log that is an autopilot's own, beyond a constant one [m].
LEAST_M = {POSITION: 5.0, HEIGHT: 10.0}

_SLOWEST_HZ = 1.0  # of a channel in which steps are looked for
_EXPLAINED_SIGMAS = 3.0  # of an imported channel, which explain a difference
_BETTER_AFTER = 0.5  # of the accuracy before a step: what is so much better was wrong before
_PRESENT = 0.8  # of the usual samples of a channel that goes on
_SILENT_INTERVALS = 5.0  # usual ones of a receiver, after which it has no fix
_BESIDE_NS = int(BESIDE_S * SECOND)
_LARGE_PART = 0.5  # of the greatest difference, by which a receiver would contradict itself


def examine(
    channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> tuple[dict[str, Channel], tuple[Stretch, ...], Notes]:
    """What all evidence of a log says against the position, height and attitude of its roles.

    Returns the roles with the samples of better sources; the suspect stretches, which name them;
    and notes on other sensors that are wrong.
    """
    examination = _Examination(channels, roles, dict(roles))
    if any(is_receiver(channel) for channel in channels):
        examination.said = filter_evidence(channels) + message_evidence(channels)
    examination.examine_attitude()
    for quantity in (POSITION, HEIGHT):
        own = roles.get(quantity)
        if own is not None and len(with_places(own, quantity)) > _FEWEST:
            examination.examine_places(quantity, own)
    suspect = [*examination.suspect, *merged(examination.suspect_attitude)]
    return examination.result, tuple(sorted(suspect)), tuple(examination.notes)


@dataclass
class _Examination:
    """What is known so far against the roles of a log.

    ``result`` : the roles, with the samples of better sources. ``said`` : what filter and autopilot
    say of themselves.
    """

    channels: Sequence[Channel]
    roles: Mapping[str, Channel]
    result: dict[str, Channel]
    said: list[Stretch] = field(default_factory=list)
    suspect: list[Stretch] = field(default_factory=list)
    suspect_attitude: list[Stretch] = field(default_factory=list)
    notes: list[Message] = field(default_factory=list)

    @property
    def attitude_of_vehicle(self) -> Channel | None:
        """The attitude, unless it is a gimbal's."""
        attitude = self.roles.get(ATTITUDE)
        if attitude is None or is_of_gimbal(attitude.source.message):
            return None
        return attitude

    def examine_attitude(self) -> None:
        """What filter, autopilot and other attitudes say against the vehicle's."""
        attitude = self.attitude_of_vehicle
        if attitude is not None:
            self.suspect_attitude = [s for s in self.said if s.quantity == ATTITUDE]
            self.suspect_attitude += attitude_evidence(attitude, self.channels)

    def examine_places(self, quantity: str, own: Channel) -> None:
        """What other sources say against a position or height, and which replaces it."""
        sources = sources_of(quantity, own, self.channels, self.roles)
        contradictions = contradictions_of(sources, self._goes_on_beside(own))
        suspect = contradictions.suspect
        if quantity == POSITION and not is_receiver(own):
            suspect += [s for s in self.said if s.quantity == POSITION]
            self._prolong_attitude(merged(suspect))
        elif quantity == HEIGHT and is_receiver(own):
            # A fix that has stepped away in position is wrong in height too.
            away = self._steps_in_position(own)
            suspect += [replace(s, quantity=HEIGHT, off_m=np.nan) for s in away]
            good = sources.own.good & ~covered(away, sources.own.channel.time_ns)
            sources = replace(sources, own=replace(sources.own, good=good))
        for barometer, drifts in contradictions.barometer_drifts.items():
            for drift in merged(drifts):
                self._report_drift(barometer, drift)
        for stretch in merged(suspect):
            self.suspect.append(self._replaced_if_plain(sources, stretch))

    def _goes_on_beside(self, own: Channel) -> Channel:
        """A channel that shows whether the log goes on where a receiver is silent."""
        for role in (ATTITUDE, POSITION):
            channel = self.roles.get(role)
            if channel is not None and channel.name != own.name:
                return channel
        return own

    def _prolong_attitude(self, suspect_positions: list[Stretch]) -> None:
        """A filter whose vertical was wrong settles with its position."""
        prolonged: list[Stretch] = []
        for stretch in self.suspect_attitude:
            end_ns = stretch.end_ns
            for position in suspect_positions:
                if stretch.meets(position):
                    end_ns = max(end_ns, position.end_ns)
            prolonged.append(replace(stretch, end_ns=end_ns))
        self.suspect_attitude = prolonged

    def _steps_in_position(self, receiver: Channel) -> list[Stretch]:
        """Where a receiver has stepped away in position, by a known distance."""
        moving = [receiver, *sorted(self.channels, key=is_receiver)]
        path = source_path(receiver, POSITION, moving)
        return [s for s in own_contradictions(path, POSITION) if np.isfinite(s.off_m)]

    def _report_drift(self, barometer: str, drift: Stretch) -> None:
        """Report a barometer that drifts; if the pressure is from it, remove the pressure there."""
        pressure = self.result["pressure"]
        if barometer != pressure.name:
            message = spare_barometer_drifts(
                barometer=barometer, reason=drift.reason, when=drift.when
            )
            self.notes.append(message)
            return
        reasons = reasons_where(drift.covers(pressure.time_ns), Reason.BAROMETER_DRIFT)
        self.result["pressure"] = pressure.without(reasons)
        message = barometer_drifts(barometer=barometer, reason=drift.reason, when=drift.when)
        self.notes.append(message)

    def _replaced_if_plain(self, sources: Sources, stretch: Stretch) -> Stretch:
        """A suspect stretch, with the source that replaces it where it is plain who is wrong."""
        replacement = replacement_for(sources, stretch)
        if replacement is None:
            return stretch
        is_filter = sources.quantity == POSITION and not is_receiver(sources.own.channel)
        if is_filter and self.attitude_of_vehicle is not None:
            self.suspect_attitude += drifted(sources.own, replacement, stretch)
        stretch = replace(stretch, replaced_by=replacement.channel.name)
        channel = self.result[sources.quantity]
        self.result[sources.quantity] = with_replaced(channel, replacement, stretch)
        return stretch


def sources_of(
    quantity: str, own: Channel, channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> Sources:
    """Compare the source of a quantity with all others, receivers first, and barometers."""
    moving = sorted(channels, key=is_receiver)  # a filter's velocity is smoother than a receiver's
    others = [
        channel
        for channel in channels
        if channel.name != own.name
        and POSITION in channel.roles
        and len(with_places(channel, quantity)) > _FEWEST
    ]
    others.sort(key=lambda channel: (not is_receiver(channel), channel.rank))
    barometers: list[Channel] = []
    pressure = roles.get("pressure")
    if pressure is not None and quantity == HEIGHT:
        barometers = _barometers_outside(pressure, own, channels)
        for barometer in barometers:
            heights = height_of_pressure(barometer, own)
            if heights is not None:
                others.append(heights)
    own_path = source_path(own, quantity, [own, *moving])
    differences: list[Difference] = []
    for other in others:
        path = source_path(other, quantity, [other, *moving])
        apart = source_difference(
            own,
            path,
            quantity,
            velocity_at([own, *moving], quantity, path.channel.time_ns),
            steady_until_ns=_steady_until(own, own_path, quantity),
        )
        differences.append(apart)
    names = tuple(barometer.name for barometer in barometers)
    return Sources(quantity, own_path, tuple(differences), names)


def _barometers_outside(
    pressure: Channel, height: Channel, channels: Sequence[Channel]
) -> list[Channel]:
    """The barometer of the pressure, and others that follow a height as free air does."""
    others = [
        channel
        for channel in channels
        if "pressure" in channel.roles and channel.name != pressure.name
    ]
    return [pressure, *(channel for channel in others if follows_height(channel, height))]


def _steady_until(own: Channel, path: SourcePath, quantity: str) -> int | None:
    """When a source first stepped and did not return [ns]; None where it is better since.

    What is better after a step than before it was wrong before.
    """
    if path.lasting_ns.size == 0:
        return None
    step_ns = int(path.lasting_ns[0])
    sigma = own.columns.get(sigma_column(quantity), np.ones(len(own)))
    is_later = own.time_ns > step_ns
    if np.median(sigma[is_later]) < _BETTER_AFTER * np.median(sigma[~is_later]):
        return None
    return step_ns


class Contradictions(NamedTuple):
    """Stretches in which the sources of one quantity contradict each other.

    ``suspect``: the source of the role may be wrong. ``barometer_drifts``: that source, a receiver,
    is right, and the barometer of that name is wrong.
    """

    suspect: list[Stretch]
    barometer_drifts: dict[str, list[Stretch]]


def contradictions_of(sources: Sources, while_on: Channel) -> Contradictions:
    """Find where the source of a role contradicts itself or another source.

    ``while_on``: a channel that goes on where a receiver is silent.
    """
    suspect = _contradictions_of_source_itself(sources, while_on)
    barometer_drifts: defaultdict[str, list[Stretch]] = defaultdict(list)
    for difference in sources.differences:
        other_name = difference.other.channel.name
        for run in difference.apart:
            stretch = _stretch_apart(sources, difference, run)
            if not receiver_is_right(sources, difference, run):
                suspect.append(stretch)
            elif other_name in sources.barometers:
                barometer_drifts[other_name].append(stretch)
            # Else the other source is a filter, whose height follows a barometer: the difference
            # from that barometer is reported.
    return Contradictions(suspect, dict(barometer_drifts))


def _stretch_apart(sources: Sources, difference: Difference, run: Run) -> Stretch:
    """The stretch in which another source is apart from that of the role."""
    other = difference.other
    off_m = float(np.nanmax(difference.off_m[run.rows]))
    reason = f"{sources.own.channel.name} and {other.channel.name} are {off_m:.0f} m apart"
    if other.stepped_m[run.rows].any():
        reason = f"{other.channel.name} steps at {other.fastest_m_s:.0f} m/s; {reason}"
    return stretch_of_run(other.channel.time_ns, run, sources.quantity, reason, off_m)


def _contradictions_of_source_itself(sources: Sources, while_on: Channel) -> list[Stretch]:
    """Where a source steps or is silent; of a filter, where its receivers do.

    A filter that was led away leaves the receiver's path less its steps. One that steps back to it
    was wrong before the step, which its own path does not show.
    """
    own = sources.own
    quantity = sources.quantity
    if is_receiver(own.channel):
        return own_contradictions(own, quantity) + silences(own.channel, while_on, quantity)
    receivers = [each.other for each in sources.differences if is_receiver(each.other.channel)]
    if not receivers:
        return own_contradictions(own, quantity)
    suspect: list[Stretch] = []
    if len(receivers) == 1:
        of_receiver = own_contradictions(receivers[0], quantity)
        suspect = [stretch for stretch in of_receiver if not np.isfinite(stretch.off_m)]
    first, *others = [silences(path.channel, own.channel, quantity) for path in receivers]
    for silence in first:
        if all(any(silence.meets(other) for other in of_other) for of_other in others):
            suspect.append(silence)
    return suspect


def own_contradictions(path: SourcePath, quantity: str) -> list[Stretch]:
    """Where a source has stepped away from itself, or reports a poor accuracy."""
    time_ns = path.channel.time_ns
    name = path.channel.name
    suspect: list[Stretch] = []
    away_m = np.linalg.norm(path.stepped_m, axis=1)
    is_away = away_m > 0.0
    for run in runs(time_ns, is_away, is_away):
        off_m = float(away_m[run.rows].max())
        reason = f"{name} steps by {off_m:.0f} m at {path.fastest_m_s:.0f} m/s"
        suspect.append(stretch_of_run(time_ns, run, quantity, reason, off_m))
    around_ns = LONGEST_REPLACED_S // 2 * SECOND
    for step_ns in path.lasting_ns.tolist():
        reason = f"{name} steps at {path.fastest_m_s:.0f} m/s and does not return"
        suspect.append(Stretch(step_ns - around_ns, step_ns + around_ns, quantity, reason))
    is_poor = ~path.good & ~is_away
    for run in runs(time_ns, is_poor, is_poor):
        reason = f"{name} reports an accuracy worse than {WORST_ACCURACY_M:g} m"
        suspect.append(stretch_of_run(time_ns, run, quantity, reason))
    return suspect


def silences(channel: Channel, while_on: Channel, quantity: str) -> list[Stretch]:
    """When a receiver gives nothing though another channel goes on: it has no fix."""
    usual_s = _SILENT_INTERVALS / max(channel.rate_hz, 1e-3)
    limit_ns = max(LONGEST_COAST_S, usual_s) * SECOND
    edges = np.concatenate([while_on.time_ns[:1], channel.time_ns, while_on.time_ns[-1:]])
    suspect: list[Stretch] = []
    for before in np.flatnonzero(np.diff(edges) > limit_ns):
        begin_ns = int(edges[before])
        end_ns = int(edges[before + 1])
        lasts_s = (end_ns - begin_ns) / SECOND
        first, last = np.searchsorted(while_on.time_ns, [begin_ns, end_ns]).tolist()
        if last - first > _PRESENT * while_on.rate_hz * (end_ns - begin_ns) / SECOND:
            reason = f"{channel.name} has no fix for {lasts_s:.0f} s"
            suspect.append(Stretch(begin_ns + SECOND // 2, end_ns, quantity, reason))
    return suspect


def receiver_is_right(sources: Sources, difference: Difference, run: Run) -> bool:
    """Whether a receiver gives the height, and is confirmed where another source departs from it.

    The other source is a barometer, or a filter that follows one. The receiver is confirmed by its
    own vertical velocity; without that by a source that does not depend on the barometer.
    """
    receiver = sources.own
    is_height_of_receiver = (
        sources.quantity == HEIGHT
        and is_receiver(receiver.channel)
        and not is_receiver(difference.other.channel)
    )
    if not is_height_of_receiver:
        return False
    time_ns = difference.other.channel.time_ns
    begin_ns = int(time_ns[run.first])
    end_ns = int(time_ns[run.last])
    around = receiver.channel.time_ns >= begin_ns - _BESIDE_NS
    around &= receiver.channel.time_ns <= end_ns + _BESIDE_NS
    if np.count_nonzero(around) < 2 or receiver.stepped_m[around].any():
        return False
    around_ns = receiver.channel.time_ns[around]
    climb_m_s = velocity_at([receiver.channel], HEIGHT, around_ns)[:, 0]
    if not np.isfinite(climb_m_s).all():
        return _another_source_agrees(sources, difference, begin_ns, end_ns)
    height_m = places_of(receiver.channel, HEIGHT)[around, 0]
    unexplained_m = _climbed(around_ns, climb_m_s) - height_m
    worst = run.first + int(np.nanargmax(difference.off_m[run.rows]))
    worst_ns = int(time_ns[worst])
    allowed_m = _LARGE_PART * float(difference.off_m[worst])
    until_worst_m = _change(unexplained_m, around_ns, begin_ns - _BESIDE_NS, worst_ns)
    about_end_m = _change(unexplained_m, around_ns, end_ns - _BESIDE_NS, end_ns + _BESIDE_NS)
    return until_worst_m < allowed_m and about_end_m < allowed_m


def _change(values: Array, time_ns: TimeArray, from_ns: int, to_ns: int) -> float:
    """By how much (n,) values change from one instant to another, without its sign."""
    first, last = np.searchsorted(time_ns, [from_ns, to_ns])
    newest = time_ns.size - 1
    return abs(float(values[min(last, newest)] - values[min(first, newest)]))


def _climbed(time_ns: TimeArray, climb_m_s: Array) -> Array:
    """(n,) metres climbed since the first of some times."""
    mean_m_s = (climb_m_s[1:] + climb_m_s[:-1]) / 2.0
    return np.append(0.0, np.cumsum(np.diff(time_ns * 1e-9) * mean_m_s))


def _another_source_agrees(
    sources: Sources, departing: Difference, begin_ns: int, end_ns: int
) -> bool:
    """Whether another receiver, or a spare barometer, agrees all the time with the role's source.

    The source that departs, and what depends on the barometer of the pressure, are not asked.
    """
    spare_barometers = sources.barometers[1:]
    for difference in sources.differences:
        channel = difference.other.channel
        if channel.name == departing.other.channel.name:
            continue
        if not is_receiver(channel) and channel.name not in spare_barometers:
            continue
        inside = (channel.time_ns >= begin_ns) & (channel.time_ns <= end_ns)
        if inside.any() and bool((difference.off_m[inside] < difference.limit_m).all()):
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
    suspect: list[Stretch] = []
    for quantity in (POSITION, HEIGHT):
        if quantity not in quantities:
            continue
        placed = with_places(imported, quantity)
        if len(placed) <= _FEWEST:
            continue
        moving = [placed, *(own[role] for role in (POSITION, HEIGHT) if role in own)]
        path = source_path(_without_sigmas(placed), quantity, moving)
        stretches: list[Stretch] = []
        if placed.rate_hz >= _SLOWEST_HZ:
            stretches += own_contradictions(path, quantity)
        if quantity in own:
            log = with_places(own[quantity], quantity)
            silent = [stretch for stretch in own_suspect if stretch.quantity == quantity]
            if len(log) > _FEWEST:
                stretches += _departures_from_log(path, log, quantity, moving, silent)
        sigma = np.nan_to_num(placed.get(sigma_column(quantity)))
        for stretch in merged(stretches):
            reported_m = float(sigma[stretch.covers(placed.time_ns)].max(initial=0.0))
            is_explained = stretch.off_m < _EXPLAINED_SIGMAS * reported_m
            if not is_explained:
                suspect.append(stretch)
    return tuple(suspect)


def _without_sigmas(channel: Channel) -> Channel:
    """A channel that says nothing of its accuracy."""
    columns = {name: v for name, v in channel.columns.items() if not name.startswith("sigma_")}
    return replace(channel, columns=columns)


def _departures_from_log(
    imported: SourcePath,
    log: Channel,
    quantity: str,
    moving: Sequence[Channel],
    silent: Sequence[Stretch],
) -> list[Stretch]:
    """Where an imported path leaves the log's by more than an autopilot's own error.

    ``silent`` : stretches in which the log itself is suspect, and says nothing.
    """
    channel = imported.channel
    never_away = np.zeros_like(imported.stepped_m)
    whole = replace(
        imported,
        stepped_m=never_away,
        good=np.ones(len(channel), np.bool_),
        part=channel.boot.astype(np.intp),
    )
    velocity = never_away  # heights above two surfaces are apart where nothing lags
    if quantity == POSITION:
        velocity = velocity_at(moving, quantity, channel.time_ns)
    apart = source_difference(log, whole, quantity, velocity)
    off_m = np.where(covered(silent, channel.time_ns), 0.0, np.nan_to_num(apart.off_m))
    limit_m = max(apart.limit_m, LEAST_M[quantity])
    stretches: list[Stretch] = []
    for run in runs(channel.time_ns, off_m > 0.5 * limit_m, off_m > limit_m):
        farthest_m = float(off_m[run.rows].max())
        reason = f"{channel.name} and {log.name} are {farthest_m:.0f} m apart"
        stretches.append(stretch_of_run(channel.time_ns, run, quantity, reason, farthest_m))
    return stretches
