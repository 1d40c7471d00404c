"""A role whose channel falls silent while a spare of its kind goes on: the spare plays it then."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import Channel
from unbend.flight.evidence.impossible_samples import plausible_samples
from unbend.flight.evidence.sources import is_receiver
from unbend.flight.mount import is_of_gimbal
from unbend.messages import Message, Notes
from unbend.units import NANOSECONDS_PER_SECOND, Mask

SILENT_AT_END_NS = 2 * NANOSECONDS_PER_SECOND  # a filter coasts no longer without a receiver
SILENT_AT_BEGIN_NS = 10 * NANOSECONDS_PER_SECOND  # receivers have their first fixes as far apart

_ROLES = ("height", "position", "attitude")
_COARSE_ATTITUDES = {"AHR2", "AHRS2"}  # of a simpler filter: degrees off in turns


def with_spares(
    roles: Mapping[str, Channel],
    channels: Iterable[Channel],
    named: Collection[str],
) -> tuple[dict[str, Channel], Notes]:
    """The roles, in which spares go on where the channel of a role is silent (`_rows_of_spare`).

    Several spares may play one after the other, the best rank first. The samples of a spare keep
    what it reports of its own accuracy. Roles that the mission file ``named`` a channel for stay.
    """
    by_rank = sorted(channels, key=lambda channel: (channel.rank, channel.name))
    result = dict(roles)
    notes: list[Message] = []
    for role in _ROLES:
        if role not in roles or role in named or len(roles[role]) == 0:
            continue
        original = roles[role]
        for spare in by_rank:
            if _is_spare(spare, original, role):
                # Continued is what earlier spares have continued already.
                result[role], spare_notes = _with_spare(result[role], spare, role)
                notes += spare_notes
    return result, tuple(notes)


def _with_spare(
    channel: Channel,
    spare: Channel,
    role: str,
) -> tuple[Channel, Notes]:
    """The channel of a role, continued by the samples of a spare where it is silent."""
    if not _rows_of_spare(spare, channel, role).any():
        return channel, ()  # a spare that does not play is not checked, and has no notes
    plausible, notes = plausible_samples(spare, role)
    beyond = _rows_of_spare(plausible, channel, role)
    if not beyond.any():
        return channel, ()
    seconds = float(np.ptp(plausible.time_ns[beyond])) / NANOSECONDS_PER_SECOND
    plays = messages.spare_plays_role(
        role=role,
        channel=channel.name,
        spare=spare.name,
        seconds=seconds,
    )
    return _continued(channel, plausible.rows(beyond)), (*notes, plays)


def _is_spare(
    spare: Channel,
    channel: Channel,
    role: str,
) -> bool:
    """Whether a channel is of the kind of another one that plays a role.

    * An attitude: that of the vehicle is a spare of the vehicle's, unless it is a coarse one.
    * A position or height: a receiver is a spare of a receiver, a filter of a filter; with heights
      above the same surface.
    """
    if spare.name == channel.name or role not in spare.roles or not spare.fits_role(role):
        return False
    if role == "attitude":
        of_gimbal = is_of_gimbal(spare.source.message) or is_of_gimbal(channel.source.message)
        return not of_gimbal and spare.source.message not in _COARSE_ATTITUDES
    same_heights = spare.height_column == channel.height_column
    return same_heights and is_receiver(spare) == is_receiver(channel)


def _rows_of_spare(
    spare: Channel,
    channel: Channel,
    role: str,
) -> Mask:
    """(n,) which samples of a spare play a role that a channel has.

    Those before its first and after its last sample; of an attitude also those in its silences. In
    silences of a position or height `contradictions.examine` finds another source.
    """
    rows = _rows_beyond(spare, channel)
    if role == "attitude":
        rows |= _rows_in_silences(spare, channel)
    return rows


def _rows_in_silences(spare: Channel, channel: Channel) -> Mask:
    """(n,) which samples of a spare lie between two samples of a channel that is silent there."""
    if len(channel) < 2:
        return np.zeros(len(spare), np.bool_)
    after = np.clip(
        np.searchsorted(channel.time_ns, spare.time_ns),
        1,
        len(channel) - 1,
    )
    begin_ns = channel.time_ns[after - 1]
    end_ns = channel.time_ns[after]
    is_between = (spare.time_ns > begin_ns) & (spare.time_ns < end_ns)
    return np.asarray(is_between & (end_ns - begin_ns > SILENT_AT_END_NS))


def _rows_beyond(spare: Channel, channel: Channel) -> Mask:
    """(n,) which samples of a spare lie beyond a channel, if it begins or ends much earlier."""
    beyond = np.zeros(len(spare), np.bool_)
    if len(spare) == 0:
        return beyond
    if spare.time_ns[-1] > channel.time_ns[-1] + SILENT_AT_END_NS:
        beyond |= spare.time_ns > channel.time_ns[-1]
    if int(spare.time_ns[0]) < int(channel.time_ns[0]) - SILENT_AT_BEGIN_NS:
        beyond |= spare.time_ns < channel.time_ns[0]
    return beyond


def _continued(channel: Channel, spare: Channel) -> Channel:
    """A channel together with samples of a spare, in the order of time."""
    time_ns = np.concatenate([channel.time_ns, spare.time_ns])
    order = np.argsort(time_ns, kind="stable")
    columns = {}
    for name in {**channel.columns, **spare.columns}:
        both = np.concatenate([channel.get(name), spare.get(name)])
        columns[name] = both[order]
    boot = np.concatenate([channel.boot, spare.boot])[order]
    return replace(
        channel,
        time_ns=time_ns[order],
        boot=boot,
        columns=columns,
        labels={},
        rejected={},
    )
