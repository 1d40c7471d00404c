"""The vehicles of one log, distinguished by the senders of messages and by their positions."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence.sources import north_east_m, places_of
from unbend.flight.evidence.stretches import ATTITUDE, POSITION
from unbend.flight.interpolation import interpolate

# The largest median distance of two receivers of one vehicle: of their antennas, and their errors.
APART_M = 10.0

_GAP_S = 5.0  # between positions that are compared
_MOST_SAMPLES = 1_000  # that are compared of a track, roughly


@dataclass(frozen=True)
class Vehicles:
    """The vehicles of a log by name; ``names`` is empty if the log has one vehicle, or none.

    If several systems of MAVLink send positions or attitudes, each is a vehicle. So is each
    namespace of topics with positions, if two of these are more than 10 m apart; if they are not,
    the namespaces may be those of the receivers of one vehicle. ``depth``: how many parts of the
    name of a topic are its namespace.
    """

    names: tuple[str, ...] = ()
    depth: int = 1

    @classmethod
    def of(cls, channels: Iterable[Channel]) -> Vehicles:
        """The vehicles among the senders of the channels of a log.

        A system that sends only its attitude, because it has no fix, is a vehicle as well.
        """
        filled = [channel for channel in channels if len(channel)]
        with_positions = [channel for channel in filled if POSITION in channel.roles]
        depth = _namespace_depth(with_positions)
        tracks: dict[str, Channel] = {}
        for channel in sorted(with_positions, key=lambda channel: (channel.rank, channel.name)):
            tracks.setdefault(_sender(channel, depth), channel)
        systems = {
            _sender(channel, depth)
            for channel in filled
            if channel.source.system is not None and {POSITION, ATTITUDE} & set(channel.roles)
        }
        if len(systems) > 1:  # however near they are to each other
            return cls(tuple(sorted(systems)), depth)
        if len(tracks) > 1 and _are_apart(list(tracks.values())):
            return cls(tuple(sorted(tracks)), depth)
        return cls()

    def of_channel(self, channel: Channel) -> str:
        """The name of the vehicle that sent a channel; "" if none did, or there is only one."""
        sender = _sender(channel, self.depth)
        return sender if sender in self.names else ""

    def channels_of(
        self,
        vehicle: str,
        channels: Sequence[Channel],
        also_named: Collection[str] = (),
    ) -> tuple[Channel, ...]:
        """The channels of a vehicle, those of no vehicle, and those named in ``also_named``."""
        return tuple(
            channel
            for channel in channels
            if self.of_channel(channel) in ("", vehicle) or channel.name in also_named
        )


def _sender(channel: Channel, depth: int) -> str:
    """The name of the sender of a channel: a system of MAVLink, or the namespace of its topic.

    ``depth`` : number of parts of the namespace; a topic without more parts than that has "/".
    """
    if channel.source.system is not None:
        return f"system {channel.source.system}"
    parts = _parts_of_name(channel)
    namespace = parts[:depth] if len(parts) > depth else []
    return "/" + "/".join(namespace)


def _parts_of_name(channel: Channel) -> list[str]:
    """The parts of the name of a topic, which slashes separate."""
    return channel.name.strip("/").split("/")


def _namespace_depth(channels: Sequence[Channel]) -> int:
    """How many parts of the names of topics are the namespace: all common ones, and one more."""
    depth = 1
    for same_place in zip(*(_parts_of_name(channel) for channel in channels), strict=False):
        if len(set(same_place)) > 1:
            break
        depth += 1
    return depth


def _are_apart(tracks: Sequence[Channel]) -> bool:
    """Whether any track is more than `APART_M` from the first one, in the median."""
    return any(median_distance_m(tracks[0], other) > APART_M for other in tracks[1:])


def median_distance_m(track: Channel, other: Channel) -> float:
    """The median distance of two tracks [m], at the times of ``other``.

    NaN if they have no time in common.
    """
    is_compared = np.zeros(len(other), np.bool_)
    is_compared[:: max(len(other) // _MOST_SAMPLES, 1)] = True
    compared = other.rows(is_compared)
    gap_s = track.gap_limit_s(_GAP_S)
    columns = [
        interpolate(
            track,
            name,
            compared.time_ns,
            gap_s,
        )
        for name in ("lat_rad", "lon_rad")
    ]
    change = np.stack(columns, axis=1) - places_of(compared, POSITION)  # of lat, lon [rad]
    distance_m = np.linalg.norm(north_east_m(change, compared["lat_rad"]), axis=1)
    is_known = np.isfinite(distance_m)
    return float(np.median(distance_m[is_known])) if is_known.any() else float("nan")
