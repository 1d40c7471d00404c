"""The locally adjusted profile: the standard, moved to what the flight measured.

Temperatures sampled in climb and descent become layers; pressure is anchored to the barometer and
integrated by Eq. 52-53; beyond the sampled heights the profile relaxes to the standard. Where no
thermometer sampled, layer temperatures come from pressure against GNSS height. This is the first
form of the estimator: point values, no covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air import vapour_pressure
from pipeline.atmosphere.belief import believable, judge_anchor
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.hypsometry import (
    COLDEST_K,
    LAYER_M,
    WARMEST_K,
    temperatures_from_pressure,
)
from pipeline.atmosphere.profile import (
    BAROMETRIC,
    MEASURED,
    RELAXED,
    STANDARD,
    Profile,
    stack_layers,
)
from pipeline.atmosphere.samples import BIN_M, AirSamples, Samples, bin_by_height
from pipeline.geodesy import lambert_gravity
from pipeline.ledger import Ledger
from pipeline.units import VAPOUR_DEFICIT

Array = NDArray[np.float64]

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

_NODE_M = 250.0  # spacing of the nodes that carry the relaxation [m']


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it came about.

    ``basis`` is thermometer | both | barometer | standard; ``reason`` says why in words;
    ``time_ns`` is the middle of the samples that were used. ``covariance`` is that of the profile,
    None where it is not known.
    """

    profile: Profile
    standard: Profile
    basis: str
    reason: str
    time_ns: int | None = None
    covariance: ProfileCovariance | None = None


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Temperatures found at geopotential heights; ``virtual`` where they are T_M, from pressure."""

    height: Array
    temperature: Array
    virtual: NDArray[np.bool_]


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
    ledger : receives every fallback, and every sensor that is not believed.

    On seven real soundings (tests/atmosphere/test_soundings.py) the temperature of the climb
    leaves 1.4 / 0.9 / 0.5 % of R at 1 / 3 / 6 km without humidity, 0.5 / 0.3 / 0.1 % with one;
    barometer and GNSS alone 1.7 / 1.0 % at 3 / 6 km; US 1976 18 / 13 / 7 %.
    """
    standard = under_gravity(standard, latitude_rad)
    samples = believable(samples, standard, ledger)
    temperature, pressure = samples.temperature, samples.pressure
    warm = _measured_nodes(temperature, standard)
    barometric = _barometric_nodes(pressure, standard, ledger)
    if warm is not None and barometric is not None and _spans_more(barometric, warm):
        nodes, basis, source = _joined(warm, barometric), "both", temperature
        reason = (
            f"temperatures of {_named(temperature)} over {np.ptp(warm.height):.0f} m of height; "
            f"above and below them from {_named(pressure)} against GNSS height over "
            f"{np.ptp(barometric.height):.0f} m"
        )
    elif warm is not None:
        nodes, basis, source = warm, "thermometer", temperature
        reason = (
            f"temperatures of {_named(temperature)} over {np.ptp(warm.height):.0f} m of height, "
            f"{warm.height.size} layers"
        )
    elif barometric is not None:
        nodes, basis, source = barometric, "barometer", pressure
        without = "no thermometer outside"
        if temperature is not None:
            without = (
                f"the thermometer {temperature.name} spans only {temperature.extent_m:.0f} m of "
                "height"
            )
        reason = (
            f"{without}: temperatures from {_named(pressure)} against GNSS height "
            f"over {np.ptp(barometric.height):.0f} m, in layers of "
            f"{np.diff(barometric.height).mean():.0f} m"
        )
        ledger.fallback("AIR-BAROMETRIC", reason, where=_named(pressure))
    else:
        reason = _why_standard(temperature, pressure, standard.name)
        ledger.fallback("AIR-STANDARD", reason)
        return Adjustment(standard, standard, "standard", reason)
    profile = _profile_through(nodes, samples, standard, ledger)
    time_ns = source.middle_ns if source is not None else None
    return Adjustment(profile, standard, basis, reason, time_ns)


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard's layers in geopotential height, under the gravity of a latitude."""
    return replace(standard, gravity=lambert_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    return Adjustment(standard, standard, "standard", reason)


def _named(samples: Samples | None) -> str:
    return samples.name if samples is not None else ""


def _why_standard(temperature: Samples | None, pressure: Samples | None, name: str) -> str:
    kept = f"the standard atmosphere {name} is kept unchanged"
    if temperature is None and pressure is None:
        return f"no thermometer and no barometer outside that can be used: {kept}"
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


def _measured_nodes(temperature: Samples | None, standard: Profile) -> _Nodes | None:
    """Binned temperatures, where a thermometer sampled enough height."""
    if temperature is None or temperature.extent_m < SMALLEST_CLIMB_M:
        return None
    height, binned = bin_by_height(
        standard.gravity.geopotential_height(temperature.h_m), temperature, BIN_M
    )
    if height.size < 2 or float(np.ptp(height)) < SMALLEST_CLIMB_M - 2.0 * BIN_M:
        return None
    return _Nodes(height, binned, np.zeros(height.size, dtype=bool))


def _barometric_nodes(pressure: Samples | None, standard: Profile, ledger: Ledger) -> _Nodes | None:
    """Virtual temperatures from pressure, where a barometer sampled enough height."""
    if pressure is None or pressure.extent_m < SMALLEST_BAROMETRIC_CLIMB_M:
        return None
    found = temperatures_from_pressure(pressure, standard)
    if found is None:
        ledger.warning(
            "AIR-NO-FIT",
            f"the pressures of {pressure.name} at GNSS heights fit no air of {COLDEST_K:.0f} to "
            f"{WARMEST_K:.0f} K: no temperatures are taken from them",
            where=pressure.name,
        )
        return None
    height, virtual = found
    return _Nodes(height, virtual, np.ones(height.size, dtype=bool))


def _spans_more(barometric: _Nodes, warm: _Nodes) -> bool:
    """Whether the barometer sampled a layer or more beyond the thermometer."""
    above = barometric.height[-1] - warm.height[-1]
    below = warm.height[0] - barometric.height[0]
    return bool(max(above, below) > LAYER_M)


def _joined(warm: _Nodes, barometric: _Nodes) -> _Nodes:
    """Measured temperatures, and barometric ones half a layer and more away from them."""
    clear = (barometric.height < warm.height[0] - 0.5 * LAYER_M) | (
        barometric.height > warm.height[-1] + 0.5 * LAYER_M
    )
    height = np.concatenate([warm.height, barometric.height[clear]])
    order = np.argsort(height)
    return _Nodes(
        height[order],
        np.concatenate([warm.temperature, barometric.temperature[clear]])[order],
        np.concatenate([warm.virtual, barometric.virtual[clear]])[order],
    )


def _profile_through(
    found: _Nodes, samples: AirSamples, standard: Profile, ledger: Ledger
) -> Profile:
    """Layers through the temperatures found; three passes settle humidity against pressure."""
    departure = found.temperature - standard.temperature(standard.gravity.height(found.height))
    nodes, departure = _relaxed(found.height, departure, standard)
    own = np.isin(nodes, found.height)
    virtual = np.zeros(nodes.size, dtype=bool)
    virtual[own] = found.virtual
    source = _sources(nodes, own, virtual, departure)
    temperature = standard.temperature(standard.gravity.height(nodes)) + departure
    relative = _humidity_at(nodes, samples.humidity, standard, ledger)
    vapour = np.zeros(nodes.size)
    profile = standard
    for _ in range(3):
        dryness = 1.0 - VAPOUR_DEFICIT * vapour
        t_m = np.where(virtual, temperature, temperature / dryness)
        profile = _anchored(nodes, t_m, vapour, source, samples.pressure, standard)
        if relative is None:
            break
        kinetic = np.where(virtual, temperature * dryness, temperature)
        vapour = _vapour_fraction(nodes, kinetic, relative, profile, samples.humidity)
    judge_anchor(profile, samples.pressure, ledger)
    return profile


def _relaxed(height: Array, departure: Array, standard: Profile) -> tuple[Array, Array]:
    """Nodes over the whole standard, with a departure that dies away from the found ones."""
    edge = standard.layers.edge
    low, high = height[0], height[-1]
    reach = 8.0 * RELAXATION_M
    below = np.arange(low - _NODE_M, max(edge[0], low - reach), -_NODE_M)
    above = np.arange(high + _NODE_M, min(edge[-1], high + reach), _NODE_M)
    outside = edge[(edge < low) | (edge > high)]
    nodes = np.unique(np.concatenate([outside, height, below, above]))
    # No sliver of a layer beside a breakpoint of the standard.
    keep = np.concatenate([[True], np.diff(nodes) > 1.0]) | np.isin(nodes, height)
    nodes = nodes[keep]
    distance = np.maximum(np.maximum(low - nodes, nodes - high), 0.0)
    fading = np.where(distance < reach, np.exp(-distance / RELAXATION_M), 0.0)
    return nodes, np.interp(nodes, height, departure) * fading


def _sources(
    nodes: Array, own: NDArray[np.bool_], virtual: NDArray[np.bool_], departure: Array
) -> tuple[str, ...]:
    """Where each layer comes from: both its ends found, relaxed, or the standard itself."""
    names = []
    for i in range(nodes.size - 1):
        thickness = nodes[i + 1] - nodes[i]
        from_pressure = bool(virtual[i] or virtual[i + 1])
        widest = 2.0 * LAYER_M if from_pressure else WIDEST_GAP_M
        if own[i] and own[i + 1] and thickness <= widest:
            names.append(BAROMETRIC if from_pressure else MEASURED)
        elif departure[i] != 0.0 or departure[i + 1] != 0.0:
            names.append(RELAXED)
        else:
            names.append(STANDARD)
    return tuple(names)


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


def _humidity_at(
    nodes: Array, humidity: Samples | None, standard: Profile, ledger: Ledger
) -> Array | None:
    """Relative humidity at the nodes, held constant beyond the sampled heights; None if dry."""
    if humidity is not None and bool(humidity.accepted.any()):
        geopotential = standard.gravity.geopotential_height(humidity.h_m)
        height, value = bin_by_height(geopotential, humidity, 2.0 * BIN_M)
        if height.size:
            return np.clip(np.interp(nodes, height, value), 0.0, 1.0)
    few = "too few readings of humidity" if humidity is not None else "no humidity measured"
    ledger.fallback("AIR-DRY", f"{few} outside: the air is taken as dry")
    return None


def _vapour_fraction(
    nodes: Array,
    temperature: Array,
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
