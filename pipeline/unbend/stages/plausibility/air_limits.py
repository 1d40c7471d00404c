"""Whether the refraction of the estimated air is within the limits of real air.

The limits are on R in real air over R in the standard atmosphere, between the same heights. They
are half as far again from the median as the outermost of 479 public ascents (Vienna 2015, North
America, Darwin, dropsondes, convective afternoons), from the lowest level upwards: R at 45 degrees
is 0.71 to 1.75 times the standard's over 1 km, 0.76 to 1.35 times over 3 km and 0.86 to 1.18 times
over 8 km. Over less than 500 m the lowest layer decides, and may even turn its sign.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.messages import Message
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts

LOWEST_CLIMB_M = 500.0
CLIMB_M = [LOWEST_CLIMB_M, 1000.0, 2000.0, 4000.0, 8000.0]  # from the ground to the camera
LOWEST_FACTOR = [0.20, 0.55, 0.65, 0.70, 0.80]  # for each of CLIMB_M
HIGHEST_FACTOR = [3.30, 2.30, 1.80, 1.50, 1.32]
SURE_SIGMAS = 2.0  # of the factor, beyond a limit
KEYS_OF_SOURCES = {
    "sounding": "atmosphere.soundings",
    "surface report": "atmosphere.surface",
    "weather model": "atmosphere.model",
}
"""Keys of the mission file by the beginning of the name of a source of the air; not of the log."""


class FactorLimits(NamedTuple):
    """The lowest and the highest R of real air, over that in the standard atmosphere."""

    lowest: float
    highest: float

    def exclude(self, factor: float, sigma: float) -> bool:
        """Whether ``factor`` is outside the limits by more than two of its sigmas.

        A ``sigma`` of NaN (unknown) counts as 0.
        """
        allowed = 0.0
        if math.isfinite(sigma):
            allowed = SURE_SIGMAS * sigma
        is_too_low = factor + allowed < self.lowest
        is_too_high = factor - allowed > self.highest
        return is_too_low or is_too_high


def limits_of_factor(climb_m: float, usual_factor: float = 1.0) -> FactorLimits | None:
    """The limits for rays that climb ``climb_m`` from the ground; None if R may be anything.

    They are interpolated in the logarithm of the climb; None below 500 m. ``usual_factor`` is R in
    the climatology of place and season over R in the standard: where these differ, as in a polar
    winter, the lower limit is that of the lower of the two, the upper limit that of the higher.

    >>> limits_of_factor(1000.0)
    FactorLimits(lowest=0.55, highest=2.3)
    """
    if climb_m < LOWEST_CLIMB_M:
        return None
    octaves = np.log2(CLIMB_M)
    octave = math.log2(climb_m)
    lowest = float(np.interp(octave, octaves, LOWEST_FACTOR))
    highest = float(np.interp(octave, octaves, HIGHEST_FACTOR))
    return FactorLimits(
        lowest=lowest * min(1.0, usual_factor),
        highest=highest * max(1.0, usual_factor),
    )


def air_of_flight(facts: Facts) -> Iterator[Message]:
    """A finding if the estimated air refracts more or less than real air does.

    Judged by the first of ``facts.effects``, R at 45 deg, with its sigma.
    """
    for effect in facts.effects[:1]:
        limits = limits_of_factor(effect.h_c_m - effect.h_g_m, facts.usual_factor)
        if limits is None or not limits.exclude(effect.factor, effect.sigma_factor):
            continue
        fits = fits_of_air(facts)
        keys = [key_of_source(fit) for fit in fits]
        names = [fit.name for fit in fits]
        yield messages.air_implausible(
            where=listed_once(keys),
            nadir_deg=effect.nadir_deg,
            h_c_m=effect.h_c_m,
            h_g_m=effect.h_g_m,
            factor=effect.factor,
            sigma=effect.sigma_factor,
            expected=f"{limits.lowest:.2f} to {limits.highest:.2f}",
            sources=listed_once(names),
        )


def fits_of_air(facts: Facts) -> list[Fit]:
    """The sources that the air was estimated from, the one with most information first.

    If the air is wrong, that source is the likeliest to be wrong.
    """
    fits = [use.fit for use in facts.adjustment.sources if use.fit is not None]
    return sorted(fits, key=lambda fit: -fit.signal_freedom)


def listed_once(texts: list[str]) -> str:
    """Texts in their order, each once, with commas between.

    >>> listed_once(["BARO[0]", "BARO[0]", "IMET[0]"])
    'BARO[0], IMET[0]'
    """
    return ", ".join(dict.fromkeys(texts))


def key_of_source(fit: Fit) -> str:
    """The key of the mission file that names a source of the air: a file, or a log's channel."""
    for kind, key in KEYS_OF_SOURCES.items():
        if fit.name.startswith(kind):
            return key
    return f"log.channels.{fit.quantity}"
