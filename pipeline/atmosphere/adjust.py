"""The locally adjusted profile: the standard, moved to what the flight measured.

Temperatures sampled in climb and descent become layers; pressure is anchored to the barometer and
integrated by Eq. 52-53; beyond the sampled heights the profile relaxes to the standard. Without a
thermometer outside, the layer temperatures come from pressure against GNSS height. This is the
first form of the estimator: point values, no covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air import vapour_pressure
from pipeline.atmosphere.hypsometry import temperatures_from_pressure
from pipeline.atmosphere.profile import (
    BAROMETRIC,
    MEASURED,
    RELAXED,
    STANDARD,
    Profile,
    stack_layers,
)
from pipeline.geodesy import lambert_gravity
from pipeline.ledger import Ledger
from pipeline.units import HECTOPASCAL, VAPOUR_DEFICIT

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Array = NDArray[np.float64]

BIN_M = 50.0
"""Thickness of the layers where temperature was measured [m']."""

RELAXATION_M = 2500.0
"""The departure from the standard dies away over this distance from the last sample [m']."""

VAPOUR_SCALE_M = 2000.0
"""Above the last hygrometer reading vapour pressure falls by e over this height [m']."""

WIDEST_GAP_M = 400.0
"""Between two measured heights farther apart than this the layers are called relaxed [m']."""

SMALLEST_CLIMB_M = 300.0
"""Less than this of sampled height says too little of the air with a thermometer [m]."""

SMALLEST_BAROMETRIC_CLIMB_M = 2000.0
"""... and without one (the error stays above 10 % of R below 1 km, whatever is done) [m]."""

_FEWEST_IN_BIN = 3


@dataclass(frozen=True, eq=False)
class Samples:
    """One sensor's readings against height; (n,) arrays.

    ``time_ns`` UTC, ``h_m`` above sea level, ``value`` in SI (K, Pa, or relative humidity 0-1),
    ``accepted`` False for readings a gate has taken out (they are shown, not used); it becomes
    False where height or value is no number.
    """

    time_ns: NDArray[np.int64]
    h_m: Array
    value: Array
    accepted: NDArray[np.bool_]
    name: str = ""

    def __post_init__(self) -> None:
        known = np.isfinite(self.h_m) & np.isfinite(self.value)
        object.__setattr__(self, "accepted", self.accepted & known)

    def used(self) -> tuple[Array, Array]:
        """Heights and values that were accepted."""
        return self.h_m[self.accepted], self.value[self.accepted]

    @property
    def extent_m(self) -> float:
        """Height spanned by the accepted readings [m]."""
        h = self.h_m[self.accepted]
        return float(np.ptp(h)) if h.size else 0.0


@dataclass(frozen=True, eq=False)
class AirSamples:
    """What a flight measured of the air outside; None where there was no sensor."""

    temperature: Samples | None = None
    pressure: Samples | None = None
    humidity: Samples | None = None


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it came about.

    ``basis`` is thermometer | barometer | standard; ``reason`` says why in words; ``bin_h_m`` and
    ``bin_temperature_k`` are the binned temperatures that became layers.
    """

    profile: Profile
    standard: Profile
    basis: str
    reason: str
    time_ns: int | None
    bin_h_m: Array
    bin_temperature_k: Array


def build_adjusted_profile(
    samples: AirSamples,
    standard: Profile,
    latitude_rad: float,
    ledger: Ledger,
) -> Adjustment:
    """The locally adjusted atmosphere profile of a flight (Gyer 1996, Eq. 52-53).

    Parameters
    ----------
    samples : what the flight measured outside.
    standard : the standard atmosphere to relax to; its index formula is kept.
    latitude_rad : of the flight, for gravity.
    ledger : receives every fallback.

    On seven real soundings the temperature of the climb leaves 1.8 / 0.9 / 0.5 % of R at
    1 / 3 / 6 km without humidity, 0.6 / 0.2 / 0.2 % with one; barometer alone 3 % at 3 km.
    """
    gravity = lambert_gravity(latitude_rad)
    standard = Profile(
        standard.layers, gravity, standard.index, standard.name, standard.constant
    )  # the model's layers in geopotential height, under the gravity of the place
    temperature, pressure = samples.temperature, samples.pressure
    time_ns = _middle_time(temperature or pressure)
    if temperature is not None and temperature.extent_m >= SMALLEST_CLIMB_M:
        height, binned = bin_by_height(
            gravity.geopotential_height(temperature.h_m), temperature, BIN_M
        )
        if height.size >= 2:
            profile = _from_temperatures(height, binned, samples, standard, ledger)
            reason = (
                f"temperatures of {temperature.name} over {temperature.extent_m:.0f} m of height, "
                f"{height.size} layers"
            )
            return Adjustment(
                profile, standard, "thermometer", reason, time_ns, gravity.height(height), binned
            )
    if pressure is not None and pressure.extent_m >= SMALLEST_BAROMETRIC_CLIMB_M:
        nodes, virtual = temperatures_from_pressure(
            gravity.geopotential_height(pressure.h_m[pressure.accepted]),
            pressure.value[pressure.accepted],
            standard,
        )
        profile = _from_virtual_nodes(nodes, virtual, samples, standard, ledger)
        reason = (
            f"no thermometer outside: temperatures from {pressure.name} against GNSS height over "
            f"{pressure.extent_m:.0f} m, in layers of {np.diff(nodes).mean():.0f} m"
        )
        ledger.fallback("AIR-BAROMETRIC", reason, where=pressure.name)
        return Adjustment(
            profile, standard, "barometer", reason, time_ns, gravity.height(nodes), virtual
        )
    reason = _why_standard(temperature, pressure, standard.name)
    ledger.fallback("AIR-STANDARD", reason)
    return unadjusted(standard, reason)


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    empty = np.empty(0)
    return Adjustment(standard, standard, "standard", reason, None, empty, empty)


def _why_standard(temperature: Samples | None, pressure: Samples | None, name: str) -> str:
    kept = f"the standard atmosphere {name} is kept unchanged"
    if temperature is None and pressure is None:
        return f"no thermometer and no barometer outside: {kept}"
    spans = []
    if temperature is not None:
        spans.append(
            f"the thermometer {temperature.name} spans {temperature.extent_m:.0f} m of height "
            f"(at least {SMALLEST_CLIMB_M:.0f} m are needed)"
        )
    if pressure is not None:
        spans.append(
            f"the barometer {pressure.name} spans {pressure.extent_m:.0f} m (at least "
            f"{SMALLEST_BAROMETRIC_CLIMB_M:.0f} m are needed without a thermometer)"
        )
    return f"{'; '.join(spans)}: {kept}"


def _middle_time(samples: Samples | None) -> int | None:
    if samples is None or samples.time_ns.size == 0:
        return None
    first, last = int(samples.time_ns[0]), int(samples.time_ns[-1])
    return first + (last - first) // 2


def bin_by_height(geopotential: Array, samples: Samples, width: float) -> tuple[Array, Array]:
    """Medians of the accepted readings in bins of height, climb and descent weighing alike.

    The lag of a sensor has opposite signs in climb and descent, so where a bin holds both, their
    two medians are averaged. Returns the mean heights [m'] and the values of bins with at least
    three readings, from the ground up.
    """
    rising = _is_climbing(samples.time_ns, geopotential)
    use = samples.accepted & np.isfinite(samples.value) & np.isfinite(geopotential)
    height, value, rising = geopotential[use], samples.value[use], rising[use]
    number = np.floor(height / width).astype(np.int64)
    heights, values = [], []
    for i in np.unique(number):
        inside = number == i
        if inside.sum() < _FEWEST_IN_BIN:
            continue
        ways = [inside & rising, inside & ~rising]
        ways = [way for way in ways if way.sum() >= _FEWEST_IN_BIN] or [inside]
        heights.append(float(np.mean([height[way].mean() for way in ways])))
        values.append(float(np.mean([np.median(value[way]) for way in ways])))
    return np.array(heights), np.array(values)


def _is_climbing(time_ns: NDArray[np.int64], height: Array) -> NDArray[np.bool_]:
    """Whether height rises over ten seconds around each sample."""
    if time_ns.size < 2:
        return np.ones(time_ns.shape, dtype=bool)
    seconds = (time_ns - time_ns[0]) * 1e-9
    known = np.isfinite(height)
    if known.sum() < 2:
        return np.ones(time_ns.shape, dtype=bool)
    before = np.interp(seconds - 5.0, seconds[known], height[known])
    after = np.interp(seconds + 5.0, seconds[known], height[known])
    return np.asarray(after >= before)


def _relaxed_nodes(height: Array, departure: Array, standard: Profile) -> tuple[Array, Array]:
    """Nodes over the whole standard, with a departure that dies away from the measured ones."""
    edge = standard.layers.edge
    low, high = height[0], height[-1]
    reach = 8.0 * RELAXATION_M
    below = np.arange(low - 250.0, max(edge[0], low - reach), -250.0)
    above = np.arange(high + 250.0, min(edge[-1], high + reach), 250.0)
    nodes = np.union1d(np.union1d(edge[(edge < low) | (edge > high)], height), below)
    nodes = np.union1d(nodes, above)
    # No sliver of a layer beside a breakpoint of the standard.
    keep = np.concatenate([[True], np.diff(nodes) > 1.0])
    keep |= np.isin(nodes, height)
    nodes = nodes[keep]
    inside = np.interp(nodes, height, departure)
    distance = np.maximum(np.maximum(low - nodes, nodes - high), 0.0)
    fading = np.exp(-distance / RELAXATION_M)
    return nodes, np.where(distance < reach, inside * fading, 0.0)


def _sources(nodes: Array, height: Array, departure: Array, measured: str) -> tuple[str, ...]:
    """Where each layer comes from: both its ends measured, relaxed, or the standard itself."""
    own = np.isin(nodes, height)
    names = []
    for i in range(nodes.size - 1):
        if own[i] and own[i + 1] and nodes[i + 1] - nodes[i] <= WIDEST_GAP_M:
            names.append(measured)
        elif departure[i] != 0.0 or departure[i + 1] != 0.0:
            names.append(RELAXED)
        else:
            names.append(STANDARD)
    return tuple(names)


def _from_temperatures(
    height: Array, binned: Array, samples: AirSamples, standard: Profile, ledger: Ledger
) -> Profile:
    """Layers through measured temperatures; three passes settle humidity against pressure."""
    at_standard = standard.temperature(standard.gravity.height(height))
    nodes, departure = _relaxed_nodes(height, binned - at_standard, standard)
    source = _sources(nodes, height, departure, MEASURED)
    temperature = standard.temperature(standard.gravity.height(nodes)) + departure
    relative = _humidity_at(nodes, samples.humidity, standard, ledger)
    vapour = np.zeros(nodes.size)
    profile = standard
    for _ in range(3):
        virtual = temperature / (1.0 - VAPOUR_DEFICIT * vapour)
        profile = _anchored(nodes, virtual, vapour, source, samples.pressure, standard)
        if relative is None:
            break
        vapour = _vapour_fraction(nodes, temperature, relative, profile, samples.humidity)
    _note_anchor(profile, samples.pressure, ledger)
    return profile


def _from_virtual_nodes(
    nodes: Array, virtual: Array, samples: AirSamples, standard: Profile, ledger: Ledger
) -> Profile:
    """Layers through virtual temperatures that pressure gave; pressure needs no humidity then."""
    at_standard = standard.virtual_temperature(standard.gravity.height(nodes))
    height = nodes
    nodes, departure = _relaxed_nodes(height, virtual - at_standard, standard)
    everywhere = standard.virtual_temperature(standard.gravity.height(nodes)) + departure
    # Layers between barometric nodes are wide on purpose.
    own = np.isin(nodes, height)
    source = tuple(
        BAROMETRIC if own[i] and own[i + 1] else RELAXED if departure[i] else STANDARD
        for i in range(nodes.size - 1)
    )
    relative = _humidity_at(nodes, samples.humidity, standard, ledger)
    vapour = np.zeros(nodes.size)
    profile = _anchored(nodes, everywhere, vapour, source, samples.pressure, standard)
    if relative is not None:
        for _ in range(2):
            temperature = everywhere * (1.0 - VAPOUR_DEFICIT * vapour)
            vapour = _vapour_fraction(nodes, temperature, relative, profile, samples.humidity)
        profile = _anchored(nodes, everywhere, vapour, source, samples.pressure, standard)
    _note_anchor(profile, samples.pressure, ledger)
    return profile


def _anchored(
    nodes: Array,
    virtual: Array,
    vapour: Array,
    source: tuple[str, ...],
    pressure: Samples | None,
    standard: Profile,
) -> Profile:
    """Pressure by Eq. 52-53, at the level that the barometer's readings have in the median."""
    start = (0.0, float(standard.pressure(0.0)))
    layers = stack_layers(nodes, virtual, vapour, source, anchor=start, constant=standard.constant)
    profile = Profile(layers, standard.gravity, standard.index, "adjusted", standard.constant)
    if pressure is None or not bool(pressure.accepted.any()):
        return profile
    return profile.at_level(*pressure.used())


def _note_anchor(profile: Profile, pressure: Samples | None, ledger: Ledger) -> None:
    if pressure is None or not bool(pressure.accepted.any()):
        ledger.fallback(
            "AIR-NO-BAROMETER",
            "no static pressure outside: the profile keeps the standard's pressure at sea level",
        )
        return
    h, measured = pressure.used()
    residual = (measured - profile.pressure(h)) / HECTOPASCAL
    ledger.note(
        "AIR-ANCHOR",
        f"pressure anchored to {pressure.name}: residuals {np.sqrt(np.mean(residual**2)):.2f} hPa "
        f"rms, {np.abs(residual).max():.2f} hPa at most",
        where=pressure.name,
        count=int(measured.size),
    )


def _humidity_at(
    nodes: Array, humidity: Samples | None, standard: Profile, ledger: Ledger
) -> Array | None:
    """Relative humidity at the nodes, held constant beyond the sampled heights; None if dry."""
    if humidity is not None and bool(humidity.accepted.any()):
        geopotential = standard.gravity.geopotential_height(humidity.h_m)
        height, value = bin_by_height(geopotential, humidity, 2.0 * BIN_M)
        if height.size:
            return np.clip(np.interp(nodes, height, value), 0.0, 1.0)
    ledger.fallback("AIR-DRY", "no humidity measured outside: the air is taken as dry")
    return None


def _vapour_fraction(
    nodes: Array,
    temperature: ArrayLike,
    relative: Array,
    profile: Profile,
    humidity: Samples | None,
) -> Array:
    """e/p at the nodes: from the humidity where it was sampled, dying away above."""
    pressure = profile.pressure(profile.gravity.height(nodes))
    e = vapour_pressure(relative, temperature, pressure)
    if humidity is not None:
        top = float(profile.gravity.geopotential_height(humidity.used()[0].max()))
        at_top = np.interp(top, nodes, e)
        e = np.where(nodes > top, at_top * np.exp(-(nodes - top) / VAPOUR_SCALE_M), e)
    return np.asarray(e / pressure)
