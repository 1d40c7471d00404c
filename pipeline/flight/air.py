"""What the flight measured of the air outside, against GNSS height, with its gates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.adjust import AirSamples, Samples
from pipeline.flight.channels import Channel
from pipeline.flight.heights import HeightSystem, heights_at
from pipeline.ledger import Ledger

Array = NDArray[np.float64]

TAKE_OFF_RISE_M = 20.0
"""So far above the first fix the aircraft is taken to have left the ground [m]."""

SOAK_SECONDS = 60.0
"""A thermometer still carries the heat of the ground for so long after take-off [s]."""


def air_samples(
    roles: Mapping[str, Channel], heights: HeightSystem, max_gap_s: float, ledger: Ledger
) -> AirSamples:
    """The readings of the outside sensors at their heights above sea level.

    Temperature and humidity on the ground and in the first minute after take-off are shown but
    not accepted: they are the runway's.
    """
    height = roles.get("height")
    if height is None:
        return AirSamples()
    left_ground, landed = _time_in_the_air(height)
    found: dict[str, Samples] = {}
    for role, column in (
        ("temperature", "temperature_k"),
        ("pressure", "pressure_pa"),
        ("humidity", "relative_humidity"),
    ):
        channel = roles.get(role)
        if channel is None or len(channel) == 0:
            continue
        h, _ = heights_at(height, channel.time_ns, heights, max_gap_s)
        accepted = np.isfinite(h)
        if role != "pressure":
            soaked = (channel.time_ns < left_ground) | (channel.time_ns > landed)
            if bool((soaked & accepted).any()):
                ledger.note(
                    "AIR-GROUND-SOAK",
                    f"{int((soaked & accepted).sum())} readings on the ground or within "
                    f"{SOAK_SECONDS:.0f} s of take-off are not used",
                    where=channel.name,
                    count=int((soaked & accepted).sum()),
                )
            accepted &= ~soaked
        found[role] = Samples(channel.time_ns, h, channel[column], accepted, channel.name)
    return AirSamples(**found)


def _time_in_the_air(height: Channel) -> tuple[int, int]:
    """When the thermometer begins and ceases to feel free air [Unix ns].

    A log that begins in the air has no take-off to gate; one that ends there no landing.
    """
    column = "h_msl_m" if np.isfinite(height.columns.get("h_msl_m", [np.nan])).any() else None
    h = height[column] if column else height["h_ellipsoid_m"]
    finite = np.isfinite(h)
    first, last = int(height.time_ns[0]), int(height.time_ns[-1])
    if not bool(finite.any()):
        return first, last
    time_ns, h = height.time_ns[finite], h[finite]
    ground_before, ground_after = float(h[0]), float(h[-1])
    airborne = np.flatnonzero(h > ground_before + TAKE_OFF_RISE_M)
    if airborne.size == 0:
        return first, last
    begins = first
    seconds_on_ground = (time_ns[airborne[0]] - time_ns[0]) * 1e-9
    if seconds_on_ground > 5.0:
        begins = int(time_ns[airborne[0]] + SOAK_SECONDS * 1e9)
    still_up = np.flatnonzero(h > ground_after + TAKE_OFF_RISE_M)
    ends = last
    if still_up.size and (time_ns[-1] - time_ns[still_up[-1]]) * 1e-9 > 5.0:
        ends = int(time_ns[still_up[-1]])
    return begins, ends
