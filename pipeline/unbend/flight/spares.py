"""Spare channels, which take over a role where its own channel is silent."""

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

# A channel counts as silent after its end, or between two samples, if that lasts for longer than
# this: a filter coasts no longer without a receiver.
SILENT_AT_END_NS = 2 * NANOSECONDS_PER_SECOND
# The same before its begin: the first fixes of two receivers are as far apart.
SILENT_AT_BEGIN_NS = 10 * NANOSECONDS_PER_SECOND

_ROLES = ("height", "position", "attitude")  # that can have a spare
_COARSE_ATTITUDES = {"AHR2", "AHRS2"}  # messages of a simpler filter: degrees off in turns


def with_spares(
    roles: Mapping[str, Channel],
    channels: Iterable[Channel],
    named: Collection[str],
) -> tuple[dict[str, Channel], Notes]:
    """Fill the silences of the channels of roles with samples of spare channels.

    Several spares may fill one channel, the best rank first; their samples keep their own reported
    accuracy. ``named`` : roles for which the mission file names a channel; these stay unchanged.
    Returns all roles, and a note for each spare in use.
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
                # result[role] has the samples of earlier spares already.
                result[role], spare_notes = _with_spare(result[role], spare, role)
                notes += spare_notes
    return result, tuple(notes)


def _with_spare(
    channel: Channel,
    spare: Channel,
    role: str,
) -> tuple[Channel, Notes]:
    """Add the plausible samples of a spare to the channel of a role where that is silent."""
    if not _rows_of_spare(spare, channel, role).any():
        return channel, ()  # the samples of a spare that is not needed are not checked
    plausible, notes = plausible_samples(spare, role)
    added_rows = _rows_of_spare(plausible, channel, role)
    if not added_rows.any():
        return channel, ()
    seconds = float(np.ptp(plausible.time_ns[added_rows])) / NANOSECONDS_PER_SECOND
    fallback = messages.spare_plays_role(
        role=role,
        channel=channel.name,
        spare=spare.name,
        seconds=seconds,
    )
    return _joined(channel, plausible.rows(added_rows)), (*notes, fallback)


def _is_spare(
    spare: Channel,
    channel: Channel,
    role: str,
) -> bool:
    """Whether ``spare`` can replace ``channel`` in a role, because it is of the same kind.

    * An attitude: neither is a gimbal's, and the spare is not a coarse one.
    * A position or height: both are receivers or both are filters, with heights above the same
      surface.
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
    """(n,) True for the samples of a spare at times at which a channel is silent.

    That is before the first and after the last sample of the channel; of an attitude also between
    samples, where `contradictions.examine` finds another source for positions and heights.
    """
    rows = _rows_beyond(spare, channel)
    if role == "attitude":
        rows |= _rows_in_silences(spare, channel)
    return rows


def _rows_in_silences(spare: Channel, channel: Channel) -> Mask:
    """(n,) True for samples of a spare between two samples of a channel, more than 2 s apart."""
    if len(channel) < 2:
        return np.zeros(len(spare), np.bool_)
    row_after = np.clip(
        np.searchsorted(channel.time_ns, spare.time_ns),
        1,
        len(channel) - 1,
    )
    begin_ns = channel.time_ns[row_after - 1]
    end_ns = channel.time_ns[row_after]
    is_between = (spare.time_ns > begin_ns) & (spare.time_ns < end_ns)
    return np.asarray(is_between & (end_ns - begin_ns > SILENT_AT_END_NS))


def _rows_beyond(spare: Channel, channel: Channel) -> Mask:
    """(n,) True for samples of a spare after the end of a channel, or before its begin.

    An end counts only if the spare goes on for more than 2 s, a begin if it starts more than 10 s
    earlier.
    """
    is_beyond = np.zeros(len(spare), np.bool_)
    if len(spare) == 0:
        return is_beyond
    if spare.time_ns[-1] > channel.time_ns[-1] + SILENT_AT_END_NS:
        is_beyond |= spare.time_ns > channel.time_ns[-1]
    if int(spare.time_ns[0]) < int(channel.time_ns[0]) - SILENT_AT_BEGIN_NS:
        is_beyond |= spare.time_ns < channel.time_ns[0]
    return is_beyond


def _joined(channel: Channel, spare: Channel) -> Channel:
    """A channel with the samples of a spare added, in the order of time.

    Columns that only one of the two has are NaN in the samples of the other.
    """
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
