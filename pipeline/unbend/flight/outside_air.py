"""What the flight measured of the air outside, against GNSS height, with its gates."""

from collections.abc import Mapping, Sequence

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.flight.channels import Channel
from unbend.flight.evidence.stretches import HEIGHT, Stretch, covered
from unbend.flight.ground_times import times_on_the_ground
from unbend.flight.heights import HeightSystem, heights_at
from unbend.messages import Notes, note, warning

SOAK_SECONDS = 120.0
"""A thermometer still carries the heat of the ground for so long after take-off [s]. Over a climb
of 1 km, with realistic sensors and no descent, R scatters by 2.0 %; with 60 s by 2.2 %."""

LEVEL_M = 30.0  # above the lowest height of a flight, pressures give their level [m]
AWAY_SECONDS = 60.0  # an aircraft that is away from the ground for less has not taken off [s]


def outside_air_samples(
    roles: Mapping[str, Channel],
    heights: HeightSystem,
    max_gap_s: float,
    suspect: Sequence[Stretch] = (),
) -> tuple[AirSamples, Notes]:
    """The readings of the outside sensors at their heights above sea level.

    Temperature and humidity on the ground and in the first two minutes after take-off are shown
    but not accepted: they are the runway's. Nor are readings where the height is ``suspect`` and
    no other source replaces it, nor pressures but the lowest where no receiver gives the height: a
    height fused with the barometer says nothing on the air between two pressures.
    """
    height = roles.get("height")
    if height is None:
        return AirSamples(), ()
    contradicted = [s for s in suspect if s.quantity == HEIGHT and not s.replaced_by]
    on_ground_ns = times_on_the_ground(height)
    samples: dict[str, SensorSamples] = {}
    notes = []
    for role, column in (
        ("temperature", "temperature_k"),
        ("pressure", "pressure_pa"),
        ("humidity", "relative_humidity"),
        ("airspeed", "airspeed_m_s"),
    ):
        channel = roles.get(role)
        if channel is None or len(channel) == 0:
            continue
        h, _ = heights_at(height, channel.time_ns, heights, max_gap_s)
        known = np.isfinite(h)
        accepted = known & ~covered(contradicted, channel.time_ns)
        if count := int(np.count_nonzero(known & ~accepted)):
            notes.append(warning("AIR-SUSPECT-HEIGHT", where=channel.name, count=count))
        if role == "pressure" and height.roles and "height" not in height.roles:
            accepted &= h < np.min(h[accepted], initial=np.inf) + LEVEL_M
            notes.append(warning("AIR-HEIGHT-FUSED", where=height.name, level=LEVEL_M))
        if role in ("temperature", "humidity") and on_ground_ns.size:
            last = np.searchsorted(on_ground_ns, channel.time_ns, side="right") - 1
            since_s = (channel.time_ns - on_ground_ns[np.maximum(last, 0)]) * 1e-9
            soaked = (last >= 0) & (since_s < SOAK_SECONDS) & accepted
            if count := int(np.count_nonzero(soaked)):
                where, seconds = channel.name, SOAK_SECONDS
                notes.append(note("AIR-GROUND-SOAK", where=where, count=count, seconds=seconds))
            accepted &= ~soaked
        samples[role] = SensorSamples(channel.time_ns, h, channel[column], accepted, channel.name)
    # When the aircraft last stood before it was away for a minute or more.
    away = np.diff(on_ground_ns, append=np.iinfo(np.int64).max) > AWAY_SECONDS * 1e9
    takeoffs_ns = on_ground_ns[away] if on_ground_ns.size else on_ground_ns
    return AirSamples(**samples, takeoff_ns=takeoffs_ns), tuple(notes)
