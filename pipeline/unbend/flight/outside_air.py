"""Readings of the sensors outside at GNSS heights, and the reasons to reject some of them."""

from collections.abc import Mapping, Sequence

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.flight import messages
from unbend.flight.channels import Channel
from unbend.flight.evidence.stretches import HEIGHT, Stretch, in_any_stretch
from unbend.flight.ground_times import NOTHING_SAID, GroundEvidence, times_on_the_ground
from unbend.flight.heights import HeightSystem, heights_at
from unbend.messages import Message, Notes
from unbend.units import Integers, Mask

SOAK_SECONDS = 120.0
"""A thermometer still carries the heat of the ground for so long after take-off [s]. Over a climb
of 1 km, with realistic sensors and no descent, R scatters by 2.0 %; with 60 s by 2.2 %."""

# Pressures up to so far above the lowest one give the level of the pressure profile [m].
LEVEL_M = 30.0
AWAY_SECONDS = 60.0  # an aircraft that is away from the ground for less has not taken off [s]

_SENSORS = (
    ("temperature", "temperature_k"),
    ("pressure", "pressure_pa"),
    ("humidity", "relative_humidity"),
    ("airspeed", "airspeed_m_s"),
)
# Roles of sensors that still measure the air of the runway for a while after take-off.
_SOAKED_ROLES = ("temperature", "humidity")


def outside_air_samples(
    roles: Mapping[str, Channel],
    heights: HeightSystem,
    max_gap_s: float,
    suspect: Sequence[Stretch] = (),
    evidence: GroundEvidence = NOTHING_SAID,
) -> tuple[AirSamples, Notes]:
    """The readings of the outside sensors at their heights above sea level.

    Rejected readings are contained with their reason, but are not used. The first reason that
    applies counts:

    * NO_HEIGHT: the height is unknown.
    * SUSPECT_HEIGHT: the height is suspect (``suspect`` stretches), and no other source replaces
      it.
    * FUSED_HEIGHT: a pressure more than `LEVEL_M` above the lowest one, if no receiver gives the
      height. A height fused with the barometer does not show the air between two pressures.
    * GROUND_SOAK: temperature and humidity on the ground (also by ``evidence``) and in the first
      two minutes after take-off; they are of the air at the runway.
    """
    height = roles.get("height")
    if height is None:
        return AirSamples(), ()
    suspect_heights = [
        stretch for stretch in suspect if stretch.quantity == HEIGHT and not stretch.replaced_by
    ]
    on_ground_ns = times_on_the_ground(height, evidence)
    sensors: dict[str, SensorSamples] = {}
    notes: list[Message] = []
    for role, column in _SENSORS:
        channel = roles.get(role)
        if channel is None or len(channel) == 0:
            continue
        height_m, _ = heights_at(height, channel.time_ns, heights, max_gap_s)
        sensor = SensorSamples(
            channel.time_ns,
            height_m,
            channel[column],
            rejected=reasons_where(np.isnan(height_m), Reason.NO_HEIGHT),
            name=channel.name,
            removed=channel.removed,
        )
        sensor, height_notes = _without_suspect_heights(sensor, suspect_heights)
        notes += height_notes
        if role == "pressure" and _is_fused(height):
            sensor = sensor.reject(_is_above_level(sensor), Reason.FUSED_HEIGHT)
            notes.append(messages.height_is_fused(channel=height.name, level_m=LEVEL_M))
        if role in _SOAKED_ROLES:
            sensor, soak_notes = _without_ground_soak(sensor, on_ground_ns)
            notes += soak_notes
        sensors[role] = sensor
    samples = AirSamples(**sensors, takeoff_ns=_takeoffs(on_ground_ns))
    return samples, tuple(notes)


def _without_suspect_heights(
    sensor: SensorSamples, suspect_heights: Sequence[Stretch]
) -> tuple[SensorSamples, Notes]:
    """Reject the readings of a sensor in stretches of suspect height; a note counts them."""
    sensor = sensor.reject(in_any_stretch(suspect_heights, sensor.time_ns), Reason.SUSPECT_HEIGHT)
    count = sensor.count(Reason.SUSPECT_HEIGHT)
    if count == 0:
        return sensor, ()
    return sensor, (messages.readings_at_suspect_heights(channel=sensor.name, count=count),)


def _without_ground_soak(
    sensor: SensorSamples, on_ground_ns: Integers
) -> tuple[SensorSamples, Notes]:
    """Reject the readings of a sensor on the ground and shortly after take-off; a note counts them.

    ``on_ground_ns`` : increasing times at which the aircraft was on the ground.
    """
    sensor = sensor.reject(_is_soaked(sensor.time_ns, on_ground_ns), Reason.GROUND_SOAK)
    count = sensor.count(Reason.GROUND_SOAK)
    if count == 0:
        return sensor, ()
    note = messages.ground_soak(channel=sensor.name, count=count, seconds=SOAK_SECONDS)
    return sensor, (note,)


def _is_above_level(sensor: SensorSamples) -> Mask:
    """(n,) True for readings of unknown height, or `LEVEL_M` or more above the lowest accepted."""
    lowest_m = np.min(sensor.h_m[sensor.accepted], initial=np.inf)
    return np.asarray(~(sensor.h_m < lowest_m + LEVEL_M))


def _is_fused(height: Channel) -> bool:
    """Whether a height is that of a filter: a channel of a log that does not offer this role.

    It has the role only if no receiver gives a height. A channel without any roles does not count.
    """
    return bool(height.roles) and "height" not in height.roles


def _is_soaked(time_ns: Integers, on_ground_ns: Integers) -> Mask:
    """(n,) True for times less than `SOAK_SECONDS` after a time on the ground.

    ``on_ground_ns`` : increasing.
    """
    if on_ground_ns.size == 0:
        return np.zeros(time_ns.shape, np.bool_)
    last_row = np.searchsorted(on_ground_ns, time_ns, side="right") - 1  # -1: none before
    since_s = (time_ns - on_ground_ns[np.maximum(last_row, 0)]) * 1e-9
    return np.asarray((last_row >= 0) & (since_s < SOAK_SECONDS))


def _takeoffs(on_ground_ns: Integers) -> Integers:
    """The last times on the ground before the aircraft was away for more than a minute.

    The last time of all is among them. ``on_ground_ns`` : increasing.
    """
    if on_ground_ns.size == 0:
        return on_ground_ns
    away_ns = np.diff(on_ground_ns, append=np.iinfo(np.int64).max)
    return on_ground_ns[away_ns > AWAY_SECONDS * 1e9]
