"""Barometers in a closed compartment, such as a pressurised cabin, compared with one outside."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.interpolation import interpolate
from unbend.flight.roles import follows_height
from unbend.units import HECTOPASCAL, Array

LOWEST_PRESSURISED_M = 2000.0
"""People need no pressurised cabin up to here, and drones stay below."""

FEWEST_SAMPLES = 10  # with fewer, nothing is decided
MAX_GAP_S = 5.0  # between samples of the barometer outside
TOLERANCE_PA = 20.0 * HECTOPASCAL  # errors of both sensors, and of pressure at the skin
WITHIN_SHARE = 0.99  # of the samples: the others may be damaged
EXCESS_PERCENTILE = 90.0  # at least a tenth of the samples is at heights with a cabin pressure
ROUGHNESS_PERCENTILE = 95.0  # single samples may be rough
LARGEST_ROUGHNESS_PA = 1.0 * HECTOPASCAL  # barometers scatter by less than 0.2 hPa
STUCK_SHARE = 0.5  # a sensor is stuck if so large a share of its samples repeats one value


@dataclass(frozen=True, eq=False)
class Compartment:
    """The pressure in a closed compartment and that outside.

    ``barometer`` is the name of the channel inside; ``inside_pa``, ``outside_pa`` (n,) are
    pressures at the same times [Pa].
    """

    barometer: str
    inside_pa: Array
    outside_pa: Array


def closed_compartments(channels: Iterable[Channel], height: Channel) -> Iterator[Compartment]:
    """The compartments of barometers that do not follow the height, if another barometer does.

    ``height`` : the channel with the heights of the flight. Only flights above 2000 m are
    searched. A barometer that fails does not follow the height either: its pressures must also be
    those of a compartment (`is_of_compartment`).
    """
    if height.height_column is None:
        return
    heights_m = height[height.height_column]
    if not np.any(heights_m >= LOWEST_PRESSURISED_M):
        return
    outside = None
    not_following = []
    for channel in channels:
        if "pressure" not in channel.roles or not channel.fits_role("pressure"):
            continue
        follows = follows_height(channel, height)  # None if that cannot be decided
        if follows is False:
            not_following.append(channel)
        elif follows and outside is None:
            outside = channel
    if outside is None:
        return
    for channel in not_following:
        compartment = compartment_of(channel, outside)
        if is_of_compartment(compartment.inside_pa, compartment.outside_pa):
            yield compartment


def compartment_of(barometer: Channel, outside: Channel) -> Compartment:
    """The pressures inside and outside at those times of ``barometer`` at which both are known."""
    inside_pa = barometer["pressure_pa"]
    outside_pa = interpolate(outside, "pressure_pa", barometer.time_ns, max_gap_s=MAX_GAP_S)
    is_known = np.isfinite(inside_pa) & np.isfinite(outside_pa)
    return Compartment(barometer.name, inside_pa[is_known], outside_pa[is_known])


def is_of_compartment(inside_pa: Array, outside_pa: Array) -> bool:
    """Whether (n,) pressures can be those of a closed compartment, and not of a failing sensor.

    They must be between the pressure outside and that at the ground, be 20 hPa or more above that
    outside in a tenth of the samples, change smoothly, and not be stuck at one value.

    >>> outside = np.linspace(95_000.0, 65_000.0, 50)
    >>> inside = np.linspace(95_000.0, 80_000.0, 50)
    >>> is_of_compartment(inside, outside), is_of_compartment(0.0 * inside + 9e4, outside)
    (True, False)
    """
    if inside_pa.size < FEWEST_SAMPLES:
        return False
    ground_pa = float(np.max(outside_pa))
    is_within = (inside_pa > outside_pa - TOLERANCE_PA) & (inside_pa < ground_pa + TOLERANCE_PA)
    if float(np.mean(is_within)) < WITHIN_SHARE:
        return False
    excess_pa = float(np.percentile(inside_pa - outside_pa, EXCESS_PERCENTILE))
    if excess_pa < TOLERANCE_PA:
        return False
    mean_of_neighbours_pa = (inside_pa[:-2] + inside_pa[2:]) / 2.0
    roughness_pa = np.abs(inside_pa[1:-1] - mean_of_neighbours_pa)
    if float(np.percentile(roughness_pa, ROUGHNESS_PERCENTILE)) > LARGEST_ROUGHNESS_PA:
        return False
    return longest_repetition(inside_pa) < STUCK_SHARE * inside_pa.size


def longest_repetition(values: Array) -> int:
    """The number of rows in the longest run of equal values; ``values`` (n,), n > 0.

    >>> longest_repetition(np.array([1.0, 2.0, 2.0, 2.0, 1.0]))
    3
    """
    changes = np.flatnonzero(np.diff(values)) + 1  # the first row of each further run
    edges = np.concatenate([[0], changes, [values.size]])
    return int(np.max(np.diff(edges)))
