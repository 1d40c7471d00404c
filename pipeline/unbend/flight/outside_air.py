"""What the sensors outside measured, at GNSS heights, with the gates for them."""

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

LEVEL_M = 30.0  # above the lowest height of a flight, pressures give their level [m]
AWAY_SECONDS = 60.0  # an aircraft that is away from the ground for less has not taken off [s]

_SENSORS = (
    ("temperature", "temperature_k"),
    ("pressure", "pressure_pa"),
    ("humidity", "relative_humidity"),
    ("airspeed", "airspeed_m_s"),
)
_SOAKED_ROLES = ("temperature", "humidity")


def outside_air_samples(
    roles: Mapping[str, Channel],
    heights: HeightSystem,
    max_gap_s: float,
    suspect: Sequence[Stretch] = (),
    evidence: GroundEvidence = NOTHING_SAID,
) -> tuple[AirSamples, Notes]:
    """The readings of the outside sensors at their heights above sea level.

    These readings are rejected: they are shown with the reason, and not used. Of several reasons
    the first counts.

    * NO_HEIGHT: all readings where the height is unknown.
    * SUSPECT_HEIGHT: all where the height is ``suspect`` and no other source replaces it.
    * FUSED_HEIGHT: pressures more than `LEVEL_M` above the lowest one, if no receiver gives the
      height. A height fused with the barometer says nothing on the air between two pressures.
    * GROUND_SOAK: temperature and humidity on the ground and in the first two minutes after
      take-off, which are the runway's. ``evidence`` says where the aircraft stands on the ground.
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
    """A sensor whose readings in some stretches are rejected, as their height may be wrong."""
    sensor = sensor.reject(in_any_stretch(suspect_heights, sensor.time_ns), Reason.SUSPECT_HEIGHT)
    count = sensor.count(Reason.SUSPECT_HEIGHT)
    if count == 0:
        return sensor, ()
    return sensor, (messages.readings_at_suspect_heights(channel=sensor.name, count=count),)


def _without_ground_soak(
    sensor: SensorSamples, on_ground_ns: Integers
) -> tuple[SensorSamples, Notes]:
    """A sensor whose readings on the ground and shortly after take-off are rejected."""
    sensor = sensor.reject(_is_soaked(sensor.time_ns, on_ground_ns), Reason.GROUND_SOAK)
    count = sensor.count(Reason.GROUND_SOAK)
    if count == 0:
        return sensor, ()
    note = messages.ground_soak(channel=sensor.name, count=count, seconds=SOAK_SECONDS)
    return sensor, (note,)


def _is_above_level(sensor: SensorSamples) -> Mask:
    """Which readings are far above the lowest one, and say nothing on the level of pressures."""
    lowest_m = np.min(sensor.h_m[sensor.accepted], initial=np.inf)
    return np.asarray(~(sensor.h_m < lowest_m + LEVEL_M))


def _is_fused(height: Channel) -> bool:
    """Whether the height of a log is a filter's, because no receiver gives one."""
    return bool(height.roles) and "height" not in height.roles


def _is_soaked(time_ns: Integers, on_ground_ns: Integers) -> Mask:
    """Which readings were made on the ground or shortly after it."""
    if on_ground_ns.size == 0:
        return np.zeros(time_ns.shape, np.bool_)
    last = np.searchsorted(on_ground_ns, time_ns, side="right") - 1
    since_s = (time_ns - on_ground_ns[np.maximum(last, 0)]) * 1e-9
    return np.asarray((last >= 0) & (since_s < SOAK_SECONDS))


def _takeoffs(on_ground_ns: Integers) -> Integers:
    """The times at which the aircraft last stood before it was away for a minute or more."""
    if on_ground_ns.size == 0:
        return on_ground_ns
    away_ns = np.diff(on_ground_ns, append=np.iinfo(np.int64).max)
    return on_ground_ns[away_ns > AWAY_SECONDS * 1e9]
