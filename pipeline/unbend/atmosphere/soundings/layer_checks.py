"""Warnings about layers of a sounding that no sonde measures, as from a typing error.

Either the air cools too fast with height, or its refractive index grows too much with height. Near
the ground both are usual by day. The limits lie beyond what 479 public ascents have (Vienna
2015, North America, Darwin, dropsondes, convective afternoons): bases within 300 m of the lowest
level reach 10.6 K and 3.4 %, bases above it 1.5 K and 0.5 % but for one ascent, of 3.1 K.
"""

from dataclasses import dataclass

import numpy as np

from unbend.atmosphere import refractive_index
from unbend.atmosphere.hypsometry import ADIABATIC_K_PER_M
from unbend.atmosphere.soundings import messages
from unbend.atmosphere.soundings.levels import Sounding
from unbend.messages import Notes
from unbend.units import Array, Mask

NEAR_GROUND_M = 300.0  # above the lowest level: the layer that the ground heats or cools
MOST_UNSTABLE_NEAR_GROUND_K = 12.0  # cooler at the top than dry air that has risen from the base
MOST_UNSTABLE_ALOFT_K = 2.0
MOST_RISE_NEAR_GROUND = 0.04  # of n - 1 from base to top, as a change of its logarithm
MOST_RISE_ALOFT = 0.006


@dataclass(frozen=True)
class Layer:
    """A layer of air, and how much a quantity decreases in it with height."""

    low_m: float  # height of its base above sea level
    high_m: float  # height of its top above sea level
    fall: float  # value at the base minus value at the top


def layer_notes(sounding: Sounding, where: str) -> Notes:
    """Warnings about the most unstable layer and of that where the refractive index grows most.

    ``where``: the file of the sounding, for the messages. All levels are kept.
    """
    h = sounding.h_m
    near_ground = h - h[0] < NEAR_GROUND_M
    # Rises with height in stable air, stays in mixed dry air, falls in unstable air.
    dry_static_k = sounding.temperature_k + ADIABATIC_K_PER_M * h
    vapour_pa = np.nan_to_num(sounding.vapour_pressure_pa)
    refractivity = refractive_index.refractivity_gyer(
        sounding.temperature_k, sounding.pressure_pa, vapour_pa
    )
    log_rarity = -np.log(refractivity)  # falls where the refractive index grows with height
    notes = []
    for bases, most_k, most_rise in (
        (near_ground, MOST_UNSTABLE_NEAR_GROUND_K, MOST_RISE_NEAR_GROUND),
        (~near_ground, MOST_UNSTABLE_ALOFT_K, MOST_RISE_ALOFT),
    ):
        layer = largest_fall(h, dry_static_k, bases)
        if layer.fall > most_k:
            notes.append(
                messages.sounding_superadiabatic(
                    where=where, excess_k=layer.fall, low_m=layer.low_m, high_m=layer.high_m
                )
            )
        layer = largest_fall(h, log_rarity, bases)
        if layer.fall > most_rise:
            percent = 100.0 * np.expm1(layer.fall)
            notes.append(
                messages.sounding_index_rises(
                    where=where, percent=percent, low_m=layer.low_m, high_m=layer.high_m
                )
            )
    return tuple(notes)


def largest_fall(h: Array, quantity: Array, bases: Mask) -> Layer:
    """The layer in which a ``quantity`` (n,) at the heights ``h`` (n,) falls most.

    Its base is among the levels of the mask ``bases`` (n,), its top any level above. Where the
    quantity falls nowhere, a layer without thickness and with the fall 0.

    >>> h = np.array([0.0, 100.0, 200.0, 300.0])
    >>> largest_fall(h, np.array([5.0, 7.0, 4.0, 9.0]), h < 150.0)
    Layer(low_m=100.0, high_m=200.0, fall=3.0)
    """
    highest_below = np.maximum.accumulate(np.where(bases, quantity, -np.inf))
    fall = highest_below - quantity
    top = int(np.argmax(fall))
    if fall[top] <= 0.0:
        return Layer(float(h[0]), float(h[0]), 0.0)
    from_base = np.where(bases[: top + 1], quantity[: top + 1], -np.inf)
    base = int(np.argmax(from_base))
    return Layer(float(h[base]), float(h[top]), float(fall[top]))
