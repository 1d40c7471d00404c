"""Layers of a sounding that no sonde measures: too unstable, or denser upwards than any mirage.

Near the ground both are usual by day. The limits lie beyond what 479 public ascents have (Vienna
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
MOST_UNSTABLE_NEAR_GROUND_K = 12.0
MOST_UNSTABLE_ALOFT_K = 2.0
MOST_RISE_NEAR_GROUND = 0.04  # of n - 1, as a share of it
MOST_RISE_ALOFT = 0.006


@dataclass(frozen=True)
class Layer:
    """The heights of its ends [m above sea level], and how far a quantity falls in it."""

    low_m: float
    high_m: float
    fall: float


def layer_notes(sounding: Sounding, where: str) -> Notes:
    """What is reported of the layers of a sounding; they are kept."""
    h = sounding.h_m
    near_ground = h - h[0] < NEAR_GROUND_M
    # Rises with height in stable air, and stays in dry air that is mixed.
    dry_static_k = sounding.temperature_k + ADIABATIC_K_PER_M * h
    vapour_pa = np.nan_to_num(sounding.vapour_pressure_pa)
    n = refractive_index.refractivity_gyer(sounding.temperature_k, sounding.pressure_pa, vapour_pa)
    log_rarity = -np.log(n)
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
    """The layer from one of the ``bases`` (n,) in which a quantity (n,) falls most; 0 of none.

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
