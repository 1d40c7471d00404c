"""The suspect stretches of a flight, by all evidence of its log."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.autopilot_texts import text_evidence
from unbend.flight.evidence.filter_health import attitude_evidence, filter_evidence
from unbend.flight.evidence.messages import barometer_drifts, spare_barometer_drifts
from unbend.flight.evidence.replacements import (
    BESIDE_S,
    LONGEST_COAST_S,
    LONGEST_REPLACED_S,
    Sources,
    attitude_drifts,
    replacement_for,
    with_replaced,
)
from unbend.flight.evidence.source_differences import (
    Difference,
    height_of_pressure,
    source_difference,
)
from unbend.flight.evidence.sources import (
    WORST_ACCURACY_M,
    SourcePath,
    is_receiver,
    places_of,
    sigma_column,
    source_path,
    velocity_at,
    with_places,
)
from unbend.flight.evidence.stretches import (
    ATTITUDE,
    HEIGHT,
    POSITION,
    SECOND,
    Run,
    Stretch,
    in_any_stretch,
    joined_stretches,
    runs,
    stretch_of_run,
)
from unbend.flight.mount import is_of_gimbal
from unbend.flight.roles import follows_height
from unbend.messages import Message, Notes
from unbend.units import Array

FEWEST_SAMPLES = 10  # a channel with more samples than this is compared

_BETTER_AFTER = 0.5  # a sigma that falls below this share of that before a step: wrong before it
_SHARE_PRESENT = 0.8  # of the usual samples: a channel with more of them goes on
_SILENT_INTERVALS = 5.0  # usual ones of a receiver, after which it has no fix
_SLOWEST_HZ = 1e-3  # of a receiver, so that nothing is divided by 0
_BESIDE_NS = int(BESIDE_S * SECOND)
_LARGE_PART = 0.5  # of the greatest difference: a receiver that changes by less is right


def examine(
    channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> tuple[dict[str, Channel], tuple[Stretch, ...], Notes]:
    """Find the stretches in which a log contradicts its own position, height or attitude.

    Returns the roles, with suspect samples replaced by better sources where possible; the suspect
    stretches, with the names of these sources; and notes on drifting barometers.
    """
    examination = _Examination(channels, roles, dict(roles))
    if any(is_receiver(channel) for channel in channels):
        examination.reported = filter_evidence(channels) + text_evidence(channels)
    # First the attitude: a suspect position prolongs its suspect stretches.
    examination.examine_attitude()
    for quantity in (POSITION, HEIGHT):
        channel = roles.get(quantity)
        if channel is not None and len(with_places(channel, quantity)) > FEWEST_SAMPLES:
            examination.examine_places(quantity, channel)
    suspect = [*examination.suspect, *joined_stretches(examination.suspect_attitude)]
    return examination.result, tuple(sorted(suspect)), tuple(examination.notes)


@dataclass
class _Examination:
    """The evidence against the roles of a log, as collected by the methods.

    ``result`` : the roles, with the samples of better sources. ``reported`` : stretches in which
    the filter or the autopilot reports trouble. ``suspect`` : those of positions and heights.
    """

    channels: Sequence[Channel]
    roles: Mapping[str, Channel]
    result: dict[str, Channel]
    reported: list[Stretch] = field(default_factory=list)
    suspect: list[Stretch] = field(default_factory=list)
    suspect_attitude: list[Stretch] = field(default_factory=list)
    notes: list[Message] = field(default_factory=list)

    @property
    def attitude_of_vehicle(self) -> Channel | None:
        """The channel of the attitude; None where there is none, or it is a gimbal's."""
        attitude = self.roles.get(ATTITUDE)
        if attitude is None or is_of_gimbal(attitude.source.message):
            return None
        return attitude

    def examine_attitude(self) -> None:
        """Set ``suspect_attitude`` by filter, autopilot and other attitudes of the vehicle."""
        attitude = self.attitude_of_vehicle
        if attitude is not None:
            self.suspect_attitude = [s for s in self.reported if s.quantity == ATTITUDE]
            self.suspect_attitude += attitude_evidence(attitude, self.channels)

    def examine_places(self, quantity: str, channel: Channel) -> None:
        """Compare the position or height with other sources, and replace its suspect samples.

        ``channel`` : the one of the role. A drifting barometer is reported. Changes ``result``,
        ``suspect``, ``suspect_attitude`` and ``notes``.
        """
        sources = sources_of(quantity, channel, self.channels, self.roles)
        contradictions = contradictions_of(sources, self._other_than(channel))
        suspect = list(contradictions.suspect)
        if quantity == POSITION and not is_receiver(channel):
            # The reports of an autopilot are on its filter, and no evidence against a receiver.
            suspect += [s for s in self.reported if s.quantity == POSITION]
            self._prolong_suspect_attitude(joined_stretches(suspect))
        elif quantity == HEIGHT and is_receiver(channel):
            # Where the position of a receiver has stepped away, its height is wrong too.
            stepped_away = self._steps_in_position(channel)
            suspect += [replace(s, quantity=HEIGHT, off_m=np.nan) for s in stepped_away]
            sources = _without_stretches(sources, stepped_away)
        for barometer, drifts in contradictions.barometer_drifts.items():
            for drift in joined_stretches(drifts):
                self._report_drift(barometer, drift)
        for stretch in joined_stretches(suspect):
            self.suspect.append(self._replace_if_clear(sources, stretch))

    def _other_than(self, receiver: Channel) -> Channel:
        """A channel, another one if possible, that shows whether the log goes on in a silence."""
        for role in (ATTITUDE, POSITION):
            channel = self.roles.get(role)
            if channel is not None and channel.name != receiver.name:
                return channel
        return receiver

    def _prolong_suspect_attitude(self, suspect_positions: list[Stretch]) -> None:
        """Prolong each suspect attitude to the end of the suspect positions that overlap it.

        The vertical of a filter that was wrong is right again when its position is.
        """
        prolonged: list[Stretch] = []
        for stretch in self.suspect_attitude:
            end_ns = stretch.end_ns
            for position in suspect_positions:
                if stretch.meets(position):
                    end_ns = max(end_ns, position.end_ns)
            prolonged.append(replace(stretch, end_ns=end_ns))
        self.suspect_attitude = prolonged

    def _steps_in_position(self, receiver: Channel) -> list[Stretch]:
        """The stretches in which the position of a receiver has stepped away, and later returns."""
        with_velocity = [receiver, *sorted(self.channels, key=is_receiver)]
        path = source_path(receiver, POSITION, with_velocity)
        return [s for s in steps_and_poor_accuracy(path, POSITION) if np.isfinite(s.off_m)]

    def _report_drift(self, barometer: str, drift: Stretch) -> None:
        """Report a drifting barometer; remove its samples if it has the role of the pressure."""
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

    def _replace_if_clear(self, sources: Sources, stretch: Stretch) -> Stretch:
        """Replace the samples in a suspect stretch if `replacement_for` finds a source.

        Returns the stretch, with the name of that source. If the position of a filter drifted, its
        attitude becomes suspect too.
        """
        replacement = replacement_for(sources, stretch)
        if replacement is None:
            return stretch
        suspect = sources.of_role
        is_position_of_filter = sources.quantity == POSITION and not is_receiver(suspect.channel)
        if is_position_of_filter and self.attitude_of_vehicle is not None:
            self.suspect_attitude += attitude_drifts(suspect, replacement, stretch)
        stretch = replace(stretch, replaced_by=replacement.channel.name)
        channel = self.result[sources.quantity]
        self.result[sources.quantity] = with_replaced(channel, replacement, stretch)
        return stretch


def _without_stretches(sources: Sources, stretches: list[Stretch]) -> Sources:
    """Sources in which the role's samples in the stretches no longer count as good."""
    path = sources.of_role
    good = path.good & ~in_any_stretch(stretches, path.channel.time_ns)
    return replace(sources, of_role=replace(path, good=good))


def sources_of(
    quantity: str, channel: Channel, channels: Sequence[Channel], roles: Mapping[str, Channel]
) -> Sources:
    """Compare the source of a quantity with all others: receivers, filters, and barometers.

    ``channel`` : the one of the role of the quantity.
    """
    with_velocity = sorted(channels, key=is_receiver)  # a filter's is smoother than a receiver's
    other_channels = _other_sources(quantity, channel, channels)
    barometers: list[Channel] = []
    pressure = roles.get("pressure")
    if pressure is not None and quantity == HEIGHT:
        barometers = _barometers_outside(pressure, channel, channels)
        for barometer in barometers:
            heights = height_of_pressure(barometer, channel)
            if heights is not None:
                other_channels.append(heights)
    path_of_role = source_path(channel, quantity, [channel, *with_velocity])
    steady_until_ns = _steady_until(channel, path_of_role, quantity)
    differences: list[Difference] = []
    for other in other_channels:
        path = source_path(other, quantity, [other, *with_velocity])
        velocity = velocity_at([channel, *with_velocity], quantity, path.channel.time_ns)
        difference = source_difference(
            channel,
            path,
            quantity,
            velocity,
            steady_until_ns=steady_until_ns,
        )
        differences.append(difference)
    barometer_names = tuple(barometer.name for barometer in barometers)
    return Sources(quantity, path_of_role, tuple(differences), barometer_names)


def _other_sources(quantity: str, channel: Channel, channels: Sequence[Channel]) -> list[Channel]:
    """All other channels with positions or heights, receivers first, then by rank."""
    other_channels = [
        other
        for other in channels
        if other.name != channel.name
        and POSITION in other.roles
        and len(with_places(other, quantity)) > FEWEST_SAMPLES
    ]
    return sorted(other_channels, key=lambda other: (not is_receiver(other), other.rank))


def _barometers_outside(
    pressure: Channel, height: Channel, channels: Sequence[Channel]
) -> list[Channel]:
    """The barometer of the role of the pressure, and all others that follow the height."""
    other_barometers = [
        channel
        for channel in channels
        if "pressure" in channel.roles and channel.name != pressure.name
    ]
    return [pressure, *(channel for channel in other_barometers if follows_height(channel, height))]


def _steady_until(channel: Channel, path: SourcePath, quantity: str) -> int | None:
    """The time of the first step of a source without return [Unix ns]; None without such a step.

    None also if its reported sigma is less than half after the step: then it was wrong before.
    """
    if path.lasting_ns.size == 0:
        return None
    step_ns = int(path.lasting_ns[0])
    sigma = channel.columns.get(sigma_column(quantity), np.ones(len(channel)))
    is_later = channel.time_ns > step_ns
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

    ``while_on``: a channel that shows whether the log goes on where a receiver is silent.
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
            # Else the other source is a filter, and its height follows a barometer: only the
            # difference from that barometer is reported.
    return Contradictions(suspect, dict(barometer_drifts))


def _stretch_apart(sources: Sources, difference: Difference, run: Run) -> Stretch:
    """The suspect stretch of a run of rows in which another source is apart from the role's."""
    other = difference.other
    off_m = float(np.nanmax(difference.off_m[run.rows]))
    reason = f"{sources.of_role.channel.name} and {other.channel.name} are {off_m:.0f} m apart"
    if other.stepped_m[run.rows].any():
        reason = f"{other.channel.name} steps at {other.fastest_m_s:.0f} m/s; {reason}"
    return stretch_of_run(
        other.channel.time_ns,
        run,
        sources.quantity,
        reason,
        off_m,
    )


def _contradictions_of_source_itself(sources: Sources, while_on: Channel) -> list[Stretch]:
    """The stretches in which the source of the role contradicts itself, by the kind of source.

    * A receiver: where it steps, reports a poor accuracy or is silent.
    * A filter without receivers: where it steps or reports a poor accuracy.
    * A filter with one receiver: where that steps and does not return, reports a poor accuracy or
      is silent. The filter's own steps do not count: a filter that is led away leaves the path of
      the receiver without a step, and a filter that steps back was wrong before the step.
    * A filter with several receivers: where all of these are silent.
    """
    path = sources.of_role
    quantity = sources.quantity
    if is_receiver(path.channel):
        silent = receiver_silences(path.channel, while_on, quantity)
        return steps_and_poor_accuracy(path, quantity) + silent
    receivers: list[SourcePath] = []
    for difference in sources.differences:
        if is_receiver(difference.other.channel):
            receivers.append(difference.other)
    if not receivers:
        return steps_and_poor_accuracy(path, quantity)
    suspect: list[Stretch] = []
    if len(receivers) == 1:
        of_receiver = steps_and_poor_accuracy(receivers[0], quantity)
        # ``off_m`` is known of steps that return: the difference from the filter shows them.
        suspect = [stretch for stretch in of_receiver if not np.isfinite(stretch.off_m)]
    return suspect + _common_silences(receivers, path.channel, quantity)


def _common_silences(
    receivers: list[SourcePath], while_on: Channel, quantity: str
) -> list[Stretch]:
    """The silences of the first receiver that overlap a silence of each other receiver."""
    common, *other_silences = [
        receiver_silences(path.channel, while_on, quantity) for path in receivers
    ]
    for of_receiver in other_silences:
        common = [silence for silence in common if any(map(silence.meets, of_receiver))]
    return common


def steps_and_poor_accuracy(path: SourcePath, quantity: str) -> list[Stretch]:
    """The stretches in which a source has stepped away, or reports a poor accuracy."""
    time_ns = path.channel.time_ns
    name = path.channel.name
    suspect: list[Stretch] = []
    away_m = np.linalg.norm(path.stepped_m, axis=1)
    is_away = away_m > 0.0
    for run in runs(time_ns, is_away, is_away):
        off_m = float(away_m[run.rows].max())
        reason = f"{name} steps by {off_m:.0f} m at {path.fastest_m_s:.0f} m/s"
        suspect.append(stretch_of_run(time_ns, run, quantity, reason, off_m))
    around_ns = LONGEST_REPLACED_S // 2 * SECOND  # suspect before and after a step without return
    for step_ns in path.lasting_ns.tolist():
        reason = f"{name} steps at {path.fastest_m_s:.0f} m/s and does not return"
        suspect.append(Stretch(step_ns - around_ns, step_ns + around_ns, quantity, reason))
    is_poor = ~path.good & ~is_away
    for run in runs(time_ns, is_poor, is_poor):
        reason = f"{name} reports an accuracy worse than {WORST_ACCURACY_M:g} m"
        suspect.append(stretch_of_run(time_ns, run, quantity, reason))
    return suspect


def receiver_silences(receiver: Channel, while_on: Channel, quantity: str) -> list[Stretch]:
    """The stretches in which a receiver has no samples, but the channel ``while_on`` has.

    If both are silent, the log itself has a gap.
    """
    several_intervals_s = _SILENT_INTERVALS / max(receiver.rate_hz, _SLOWEST_HZ)
    limit_ns = max(LONGEST_COAST_S, several_intervals_s) * SECOND
    edges_ns = np.concatenate([while_on.time_ns[:1], receiver.time_ns, while_on.time_ns[-1:]])
    suspect: list[Stretch] = []
    for row in np.flatnonzero(np.diff(edges_ns) > limit_ns):
        begin_ns = int(edges_ns[row])
        end_ns = int(edges_ns[row + 1])
        lasts_s = (end_ns - begin_ns) / SECOND
        first, last = np.searchsorted(while_on.time_ns, [begin_ns, end_ns]).tolist()
        enough_samples = _SHARE_PRESENT * while_on.rate_hz * (end_ns - begin_ns) / SECOND
        goes_on = last - first > enough_samples
        if goes_on:
            reason = f"{receiver.name} has no fix for {lasts_s:.0f} s"
            after_fix_ns = begin_ns + SECOND // 2  # the fix before the silence is not suspect
            suspect.append(Stretch(after_fix_ns, end_ns, quantity, reason))
    return suspect


def receiver_is_right(sources: Sources, difference: Difference, run: Run) -> bool:
    """Whether the height is that of a receiver, and other evidence confirms it in a run.

    In the run it is apart from a barometer, or from a filter that follows one. It is confirmed by

    * its own vertical velocity, if the height minus the integrated velocity `_changes_little`;
    * without a velocity, by another source that does not depend on the barometer.

    A receiver that has stepped, or has fewer than two fixes about the run, is not confirmed.
    """
    receiver = sources.of_role
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
    return _changes_little(unexplained_m, around_ns, difference, run)


def _changes_little(
    unexplained_m: Array, time_ns: TimeArray, difference: Difference, run: Run
) -> bool:
    """Whether (n,) values change by less than half of the greatest difference in a run.

    Two changes count: from 10 s before the run to the time of that difference, and from 10 s before
    the end of the run to 10 s after it. ``time_ns`` (n,) : of ``unexplained_m``.
    """
    other_ns = difference.other.channel.time_ns
    begin_ns = int(other_ns[run.first])
    end_ns = int(other_ns[run.last])
    worst = run.first + int(np.nanargmax(difference.off_m[run.rows]))
    worst_ns = int(other_ns[worst])
    allowed_m = _LARGE_PART * float(difference.off_m[worst])
    until_worst_m = _change(unexplained_m, time_ns, begin_ns - _BESIDE_NS, worst_ns)
    about_end_m = _change(unexplained_m, time_ns, end_ns - _BESIDE_NS, end_ns + _BESIDE_NS)
    return until_worst_m < allowed_m and about_end_m < allowed_m


def _change(values: Array, time_ns: TimeArray, from_ns: int, to_ns: int) -> float:
    """The absolute change of (n,) values from one instant to another."""
    first, last = np.searchsorted(time_ns, [from_ns, to_ns])
    newest = time_ns.size - 1
    return abs(float(values[min(last, newest)] - values[min(first, newest)]))


def _climbed(time_ns: TimeArray, climb_m_s: Array) -> Array:
    """(n,) metres climbed since the first of (n,) times, by the vertical velocity [m/s]."""
    mean_m_s = (climb_m_s[1:] + climb_m_s[:-1]) / 2.0
    return np.append(0.0, np.cumsum(np.diff(time_ns * 1e-9) * mean_m_s))


def _another_source_agrees(
    sources: Sources, departing: Difference, begin_ns: int, end_ns: int
) -> bool:
    """Whether another receiver, or a spare barometer, agrees with the role's source all the time.

    Not asked are the source that departs, the barometer of the pressure, and filters, which use it.
    """
    spare_barometers = sources.barometers[1:]
    for difference in sources.differences:
        channel = difference.other.channel
        if channel.name == departing.other.channel.name:
            continue
        if not is_receiver(channel) and channel.name not in spare_barometers:
            continue
        inside = (channel.time_ns >= begin_ns) & (channel.time_ns <= end_ns)
        if inside.any() and bool((difference.off_m < difference.limit_m)[inside].all()):
            return True
    return False
