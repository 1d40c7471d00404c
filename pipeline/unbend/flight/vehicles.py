"""The vehicles of one log, kept apart by who sent the messages and by where they were."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence.sources import north_east_m, places_of
from unbend.flight.evidence.stretches import ATTITUDE, POSITION
from unbend.flight.interpolation import interpolate

APART_M = 10.0  # of two receivers of one vehicle, in the median: antennas and their errors

_GAP_S = 5.0  # between positions that are compared
_MOST_SAMPLES = 1_000  # of a track that is compared with another


@dataclass(frozen=True)
class Vehicles:
    """The vehicles of a log by name; ``names`` is empty where the log has one vehicle, or none.

    A system of MAVLink with positions or attitudes is a vehicle of its own. So is the namespace of
    topics, ``depth`` parts of their names, if the positions of two are more than 10 m apart: names
    of topics may as well be those of the receivers of one vehicle.
    """

    names: tuple[str, ...] = ()
    depth: int = 1

    @classmethod
    def of(cls, channels: Iterable[Channel]) -> Vehicles:
        """The vehicles among the senders of positions, and systems that send their attitude.

        A system without a fix is a vehicle as well: its attitude is not that of another one.
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
        if len(systems) > 1:  # whatever is between their positions
            return cls(tuple(sorted(systems)), depth)
        if len(tracks) > 1 and _are_apart(list(tracks.values())):
            return cls(tuple(sorted(tracks)), depth)
        return cls()

    def of_channel(self, channel: Channel) -> str:
        """The vehicle that sent a channel; "" where none did, or there is only one."""
        sender = _sender(channel, self.depth)
        return sender if sender in self.names else ""

    def channels_of(
        self,
        vehicle: str,
        channels: Sequence[Channel],
        kept: Collection[str] = (),
    ) -> tuple[Channel, ...]:
        """The channels of a vehicle, those of no vehicle, and the ``kept`` ones by their names."""
        return tuple(
            channel
            for channel in channels
            if self.of_channel(channel) in ("", vehicle) or channel.name in kept
        )


def _sender(channel: Channel, depth: int) -> str:
    """The sender of a channel: a system of MAVLink, or the namespace of a topic."""
    if channel.source.system is not None:
        return f"system {channel.source.system}"
    parts = _parts(channel)
    return "/" + "/".join(parts[:depth] if len(parts) > depth else [])


def _parts(channel: Channel) -> list[str]:
    """The parts of the name of a topic."""
    return channel.name.strip("/").split("/")


def _namespace_depth(channels: Sequence[Channel]) -> int:
    """How many parts of the names of topics are a namespace: those all share, and one more."""
    depth = 1
    for parts in zip(*(_parts(channel) for channel in channels), strict=False):
        if len(set(parts)) > 1:
            break
        depth += 1
    return depth


def _are_apart(tracks: Sequence[Channel]) -> bool:
    """Whether a track is apart from the first of some tracks."""
    return any(median_distance_m(tracks[0], other) > APART_M for other in tracks[1:])


def median_distance_m(track: Channel, other: Channel) -> float:
    """How far apart two tracks are in the median [m], at the times of the other; NaN if never."""
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
    change = np.stack(columns, axis=1) - places_of(compared, POSITION)
    distance_m = np.linalg.norm(north_east_m(change, compared["lat_rad"]), axis=1)
    is_known = np.isfinite(distance_m)
    return float(np.median(distance_m[is_known])) if is_known.any() else float("nan")
