"""Channels, instants and attitudes of the tests of this room, and their messages in short."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers import NS_PER_S, channel
from unbend.flight.channels import Source
from unbend.flight.evidence.impossible_samples import plausible_samples
from unbend.flight.roles import assign_roles
from unbend.flight.stations import STATION_OK, empty_stations

EARTH_M = 6_371_000.0

# A flight of a quarter of an hour [s]: 60 s on the ground, up to 2450 m at 5 m/s, level, and down.
FLIGHT_S = np.arange(0.0, 900.0)
FLIGHT_CLIMB_M = np.minimum(FLIGHT_S - 60.0, 860.0 - FLIGHT_S) * 5.0
FLIGHT_HEIGHT_M = 450.0 + np.clip(FLIGHT_CLIMB_M, 0.0, 2000.0)


def instants(*seconds):
    """These seconds [ns].

    >>> instants(0.1, 2)
    array([ 100000000, 2000000000])
    """
    nanoseconds = np.array(seconds, float) * NS_PER_S
    return np.round(nanoseconds).astype(np.int64)


def image_names(*names):
    """(n,) names as stations and events have them."""
    return np.array(names, object)


def usable_stations(time_ns, *names):
    """Stations of these images at these times, without a place."""
    images = image_names(*names)
    stations = empty_stations(
        images,
        images,
        STATION_OK,
    )
    return replace(stations, time_ns=time_ns)


def ranked(
    name,
    seconds,
    rank,
    *roles,
    **columns,
):
    """A channel of this rank, whose sender has the instance in its name.

    >>> ranked("GPS[1]", np.arange(3.0), 20).source
    Source(message='GPS', instance='1', system=None, component=None)
    """
    message, _, instance = name.partition("[")
    source = Source(message, instance.rstrip("]") or None)
    return replace(
        channel(name, seconds, *roles, **columns),
        source=source,
        rank=rank,
    )


def with_columns(logged, **columns):
    """The channel with other or further columns."""
    return replace(logged, columns={**logged.columns, **columns})


def without_columns(logged, *names):
    """The channel without some of its columns."""
    columns = dict(logged.columns)
    for name in names:
        del columns[name]
    return replace(logged, columns=columns)


def texts(name, *lines: tuple[float, str]):
    """What an autopilot says, and at which second."""
    seconds, messages = zip(*lines, strict=True)
    logged = channel(name, np.array(seconds))
    return replace(logged, labels={"text": messages})


def quaternion_columns(attitude):
    """Columns of attitudes, which turn the body into north, east, down."""
    w, x, y, z = attitude.as_quat(scalar_first=True).T
    return {
        "q_w": w,
        "q_x": x,
        "q_y": y,
        "q_z": z,
    }


def turned_channel(
    name,
    seconds,
    axes,
    angles_deg,
    *roles,
):
    """A channel of attitudes by their Euler angles."""
    attitude = Rotation.from_euler(axes, angles_deg, degrees=True)
    columns = quaternion_columns(attitude)
    return channel(name, seconds, *roles, **columns)


def rotation_of(quaternion):
    """The rotation of w, x, y, z."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def standard_pressure_pa(height_m):
    """Pressure of the standard atmosphere below 11 km."""
    return 101_325.0 * (1.0 - 0.0065 * height_m / 288.15) ** 5.25588


def roles_of(channels):
    """The channels that a log itself proposes for the roles."""
    roles, _ = assign_roles(
        tuple(channels),
        {},
        needs_cabin=False,
    )
    return roles


def plausible_roles(channels):
    """The same, without samples that no vehicle and no air can reach."""
    plausible = {}
    for role, logged in roles_of(channels).items():
        plausible[role], _ = plausible_samples(logged, role)
    return plausible


def ends_s(stretch):
    """The seconds at which a suspect stretch begins and ends."""
    begin_s = stretch.begin_ns / NS_PER_S
    return begin_s, stretch.end_ns / NS_PER_S


def counted(notes):
    """Kind, code and count of each message."""
    return [(note.kind, note.code, note.count) for note in notes]


def located(notes):
    """Kind, code and place of each message."""
    return [(note.kind, note.code, note.where) for note in notes]
