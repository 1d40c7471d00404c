"""Channels, instants and attitudes of the tests of this room, and their messages in short."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers import NS_PER_S, channel
from unbend.flight.channels import Channel, Source
from unbend.messages import Message

EARTH_M = 6_371_000.0


def instants(*seconds: float) -> np.ndarray:
    """These seconds [ns].

    >>> instants(0.1, 2)
    array([ 100000000, 2000000000])
    """
    nanoseconds = np.array(seconds, float) * NS_PER_S
    return np.round(nanoseconds).astype(np.int64)


def ranked(name: str, seconds: np.ndarray, rank: int, *roles: str, **columns: object) -> Channel:
    """A channel of this rank, whose sender has the instance in its name.

    >>> ranked("GPS[1]", np.arange(3.0), 20).source
    Source(message='GPS', instance='1', system=None, component=None)
    """
    message, _, instance = name.partition("[")
    source = Source(message, instance.rstrip("]") or None)
    return replace(channel(name, seconds, *roles, **columns), source=source, rank=rank)


def with_columns(logged: Channel, **columns: np.ndarray) -> Channel:
    """The channel with other or further columns."""
    return replace(logged, columns=dict(logged.columns) | columns)


def texts(name: str, *lines: tuple[float, str]) -> Channel:
    """What an autopilot says, and at which second."""
    seconds, said = zip(*lines, strict=True)
    return replace(channel(name, np.array(seconds)), labels={"text": said})


def quaternion_columns(attitude: Rotation) -> dict[str, np.ndarray]:
    """Columns of attitudes, which turn the body into north, east, down."""
    components = attitude.as_quat(scalar_first=True).T
    return dict(zip(("q_w", "q_x", "q_y", "q_z"), components, strict=True))


def rotation_of(quaternion: np.ndarray) -> Rotation:
    """The rotation of w, x, y, z."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def counted(notes: Iterable[Message]) -> list[tuple[str, str, int]]:
    """Kind, code and count of each message."""
    return [(str(note.kind), note.code, note.count) for note in notes]


def located(notes: Iterable[Message]) -> list[tuple[str, str, str]]:
    """Kind, code and place of each message."""
    return [(str(note.kind), note.code, note.where) for note in notes]
