"""The locally adjusted profile: the climatology, moved to what the flight measured.

Which sensors are believed, whether they say enough, whether the estimate may stand; and in words
why the profile is what it is. The estimate itself is made in `estimate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.account import SourceUse, account
from pipeline.atmosphere.belief import believable, judge_level
from pipeline.atmosphere.climatology import AUTO, Climatology, climatology, month_of
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate import Estimate, Fit, Nuisance, estimate
from pipeline.atmosphere.judgement import implausible, worse_than_climatology
from pipeline.atmosphere.measurements import Barometer, Humidities, Temperatures, Thermometer
from pipeline.atmosphere.metar import SurfaceReport
from pipeline.atmosphere.profile import (
    BAROMETRIC,
    MEASURED,
    RELAXED,
    STANDARD,
    Profile,
    stack_layers,
)
from pipeline.atmosphere.samples import AirSamples, Samples
from pipeline.atmosphere.soundings import Sounding
from pipeline.geodesy import lambert_gravity
from pipeline.ledger import Ledger

Array = NDArray[np.float64]

WIDEST_GAP_M = 400.0
"""Between two measured heights farther apart than this the layers are called relaxed [m']."""

SMALLEST_CLIMB_M = 300.0
"""Less than this of sampled height says too little of the air with a thermometer [m]."""

SMALLEST_BAROMETRIC_CLIMB_M = 2000.0
"""... and without one (the error stays above 10 % of R below 1 km, whatever is done) [m]."""

BEYOND_M = 500.0
"""A barometer that sampled so much more height than the thermometer is told of beside it [m']."""

UNCHANGED = 0.95
"""Where sigma of temperature is still this much of the climatology's, nothing was learnt."""

MISFIT = 5.0
"""A source whose sigmas had to be widened more than this disagrees with the others."""

UNMEASURED, UNADJUSTED = "climatology", "standard"
"""Bases of a profile that no measurement speaks in."""

_MIDDLE_OF_THE_YEAR = 4.0  # a month between the seasons, for samples without a date


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it came about.

    ``basis`` is thermometer | both | barometer | sounding | surface | climatology | standard;
    ``reason`` says why in words; ``time_ns`` is the middle of the samples that were used.
    ``covariance`` is that of the profile, None where nobody asked for it; ``nuisances`` what was
    found wrong with the sensors; ``sources`` how each source was used, or why not; ``rejected``
    the outliers among each sensor's samples. ``samples`` and ``moisture`` are what the estimate
    stands on, None where there is none.
    """

    profile: Profile
    standard: Profile
    basis: str
    reason: str
    time_ns: int | None = None
    covariance: ProfileCovariance | None = None
    nuisances: tuple[Nuisance, ...] = ()
    sources: tuple[SourceUse, ...] = ()
    rejected: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    samples: AirSamples | None = None
    moisture: Climatology | None = None

    @property
    def is_measured(self) -> bool:
        """Whether anything was measured that the profile holds."""
        return self.basis not in (UNMEASURED, UNADJUSTED)


@dataclass(frozen=True, eq=False)
class _Basis:
    """What an estimate stands on: the samples that say enough, the word for it, and why."""

    word: str
    reason: str
    samples: AirSamples
    main: Samples | None = None


def build_adjusted_profile(
    samples: AirSamples,
    standard: Profile,
    latitude_rad: float,
    ledger: Ledger,
    *,
    background: Climatology | None = None,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
) -> Adjustment:
    """The locally adjusted atmosphere profile of a flight, with its covariance.

    Parameters
    ----------
    samples : what the flight measured outside, or a part of it.
    standard : shown beside the profile; its index formula and constants are kept.
    latitude_rad : of the flight, for gravity and climate.
    ledger : receives every fallback, and every sensor that is not believed.
    background : the climatology to relax to; by default the standard, with the spread about it.
    soundings, surface : balloons and stations near the flight.

    Where nothing says enough, or the estimate is no air or no better than the background, the
    background is returned with its own sigma, and the reason.

    On nine real soundings (tests/atmosphere/test_estimate_montecarlo.py) the RMS error of R at
    1 / 3 / 6 / 10 km, where US 1976 errs by 20 / 13 / 7 / 7 %: clean sensors in climb and descent
    0.5 / 0.1 / 0.03 / 0.03 %; sensors with bias, lag, transient, drifts and outliers
    0.7 / 0.2 / 0.1 % at 1 / 3 / 6 km, in a climb alone 2.2 / 0.4 / 0.2 %; barometer and GNSS alone
    1.2 / 0.7 % at 3 / 6 km.
    """
    standard = under_gravity(standard, latitude_rad)
    month = _month(samples)
    moisture = climatology(AUTO, latitude_rad=latitude_rad, month=month, index=standard.index)
    if background is None:
        background = _about(standard, moisture, latitude_rad, month)
    given, samples = samples, believable(samples, standard, ledger)

    def sources(used: AirSamples | None, fits: Sequence[Fit]) -> tuple[SourceUse, ...]:
        return account(given, samples, used, fits, soundings, surface, background, standard.name)

    humid = moisture if not background.has_humidity else background
    for basis in _bases(samples, soundings, surface):
        made = estimate(
            basis.samples, background, moisture=humid, soundings=soundings, surface=surface
        )
        fault = implausible(made, background) or worse_than_climatology(made, background, humid)
        if fault is None:
            found = _adjusted(basis, made, standard, background, ledger)
            return replace(found, sources=sources(basis.samples, made.fits), moisture=humid)
        ledger.loss(
            "AIR-IMPLAUSIBLE",
            f"the air estimated from {basis.reason} is not used: {fault}",
            where=basis.main.name if basis.main is not None else "",
        )
    same = background.profile.name == standard.name
    kept = f"the {'standard atmosphere' if same else 'climatology'} {background.profile.name}"
    reason = _why_standard(samples, kept)
    ledger.fallback("AIR-STANDARD", reason)
    profile, covariance = _unchanged(background)
    word = UNADJUSTED if same else UNMEASURED
    return Adjustment(
        profile, standard, word, reason, covariance=covariance, sources=sources(None, ())
    )


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard's layers in geopotential height, under the gravity of a latitude."""
    return replace(standard, gravity=lambert_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    return Adjustment(standard, standard, UNADJUSTED, reason)


def _month(samples: AirSamples) -> float:
    for sensor in (samples.temperature, samples.pressure, samples.humidity):
        if sensor is not None and sensor.middle_ns is not None:
            return month_of(sensor.middle_ns)
    return _MIDDLE_OF_THE_YEAR


def _about(
    standard: Profile, moisture: Climatology, latitude_rad: float, month: float
) -> Climatology:
    """A standard as the background, with the spread of a day's air about it."""
    named = climatology(standard.name, latitude_rad=latitude_rad, month=month)
    return replace(named, profile=standard)


def _bases(
    samples: AirSamples, soundings: Sequence[Sounding], surface: Sequence[SurfaceReport]
) -> list[_Basis]:
    """What an estimate can stand on, the best first, the next if the best gives no air."""
    temperature, pressure = samples.temperature, samples.pressure
    others = [f"sounding {s.station}".strip() for s in soundings]
    others += [f"surface report {r.origin}".strip() for r in surface]
    beside = "; with " + ", ".join(others) if others else ""
    bases = []
    climbs = pressure is not None and pressure.extent_m >= SMALLEST_BAROMETRIC_CLIMB_M
    if temperature is not None and temperature.extent_m >= SMALLEST_CLIMB_M:
        word = "both" if climbs and _reaches_beyond(pressure, temperature) else "thermometer"
        reason = f"temperatures of {temperature.name} over {temperature.extent_m:.0f} m of height"
        if word == "both" and pressure is not None:
            reason += (
                f"; above and below them {pressure.name} against GNSS height over "
                f"{pressure.extent_m:.0f} m"
            )
        bases.append(_Basis(word, reason + beside, samples, temperature))
    if climbs and pressure is not None:
        without = "no thermometer outside"
        if temperature is not None:
            without = (
                f"the thermometer {temperature.name} spans only {temperature.extent_m:.0f} m of "
                "height"
            )
            if bases:
                without = f"without the thermometer {temperature.name}"
        reason = (
            f"{without}: temperatures from {pressure.name} against GNSS height over "
            f"{pressure.extent_m:.0f} m"
        )
        without_it = replace(samples, temperature=None)
        bases.append(_Basis("barometer", reason + beside, without_it, pressure))
    if bases and bases[0].main is temperature and temperature is not None and pressure is not None:
        alone = replace(samples, pressure=None)
        reason = f"temperatures of {temperature.name} alone, without {pressure.name}"
        bases.append(_Basis("thermometer", reason + beside, alone, temperature))
    if others:
        word = "sounding" if soundings else "surface"
        only = ", ".join(others)
        bases.append(_Basis(word, only, replace(samples, temperature=None), pressure))
    return bases


def _reaches_beyond(pressure: Samples | None, temperature: Samples) -> bool:
    """Whether the barometer sampled half a kilometre or more beyond the thermometer."""
    if pressure is None:
        return False
    warm, all_of_it = temperature.used()[0], pressure.used()[0]
    beyond = max(all_of_it.max() - warm.max(), warm.min() - all_of_it.min())
    return bool(beyond > BEYOND_M)


def _why_standard(samples: AirSamples, kept: str) -> str:
    temperature, pressure = samples.temperature, samples.pressure
    kept += " is kept unchanged"
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


def _adjusted(
    basis: _Basis, made: Estimate, standard: Profile, background: Climatology, ledger: Ledger
) -> Adjustment:
    """An estimate that may stand, with its layers named and its remarks in the ledger."""
    layers = replace(made.profile.layers, source=_layer_sources(made))
    profile = replace(made.profile, layers=layers)
    samples = basis.samples
    if basis.word == "barometer":
        ledger.fallback("AIR-BAROMETRIC", basis.reason, where=basis.main.name if basis.main else "")
    if not any(isinstance(source, Humidities) for source in made.sources.sources):
        said = "no humidity measured outside: that of the climatology is taken"
        ledger.fallback("AIR-HUMIDITY-EXPECTED", said)
    judge_level(profile, background, samples.pressure, ledger)
    _tell_of_sensors(made, samples, ledger)
    return Adjustment(
        profile,
        standard,
        basis.word,
        basis.reason,
        basis.main.middle_ns if basis.main is not None else None,
        replace(made.covariance, profile=profile),
        made.nuisances,
        rejected=made.rejected,
        samples=samples,
    )


def _layer_sources(made: Estimate) -> tuple[str, ...]:
    """Where each layer comes from: a thermometer's heights, a barometer's, neighbours, nothing."""
    edge = made.profile.layers.edge
    middle = 0.5 * (edge[1:] + edge[:-1])
    warm = _covered(middle, made, (Thermometer, Temperatures), WIDEST_GAP_M)
    weighed = _covered(middle, made, (Barometer,), 2.0 * WIDEST_GAP_M)
    sigma = made.covariance.sigma_temperature(made.profile.break_heights_m)
    learnt = sigma < UNCHANGED * made.background_sigma_k
    names = np.where(
        warm,
        MEASURED,
        np.where(weighed, BAROMETRIC, np.where(learnt[1:] | learnt[:-1], RELAXED, STANDARD)),
    )
    return tuple(str(name) for name in names)


def _covered(
    middle: Array, made: Estimate, kinds: tuple[type, ...], widest: float
) -> NDArray[np.bool_]:
    """Whether heights lie between two readings of some kinds of source, near enough together."""
    heights = [s.height for s in made.sources.sources if isinstance(s, kinds)]
    if not heights:
        return np.zeros(middle.size, dtype=bool)
    at = np.sort(np.concatenate(heights))
    above = np.searchsorted(at, middle)
    inside = (above > 0) & (above < at.size)
    upper, lower = np.minimum(above, at.size - 1), np.maximum(above - 1, 0)
    return np.asarray(inside & (at[upper] - at[lower] <= widest))


def _tell_of_sensors(made: Estimate, samples: AirSamples, ledger: Ledger) -> None:
    """What was found wrong with the sensors, and which readings were outliers."""
    learnt = [n for n in made.nuisances if n.sigma < 0.7 * n.prior_sigma]
    if learnt:
        ledger.note(
            "AIR-SENSORS",
            "; ".join(f"{n.name} {n.value:.2f} ± {n.sigma:.2f}" for n in learnt),
        )
    for fit in made.fits:
        if fit.widened > MISFIT:
            ledger.warning(
                "AIR-MISFIT",
                f"residuals of {fit.name} are {fit.rms:.1f} times what its errors explain: its "
                f"sigmas were widened {fit.widened:.0f} times",
                where=fit.name,
                count=fit.count,
            )
    for name, rejected in made.rejected.items():
        if bool(rejected.any()):
            sensor = getattr(samples, name)
            ledger.note(
                "AIR-OUTLIERS",
                f"{int(rejected.sum())} of {int(sensor.accepted.sum())} readings are far from "
                "their neighbours in height and time and are not used",
                where=sensor.name,
                count=int(rejected.sum()),
            )


def _unchanged(background: Climatology) -> tuple[Profile, ProfileCovariance]:
    """The background itself, in layers fine enough to carry its covariance."""
    made, profile = estimate(AirSamples(), background), background.profile
    edge = made.profile.layers.edge
    h = profile.gravity.height(edge)
    layers = stack_layers(
        edge,
        profile.virtual_temperature(h),
        profile.vapour_pressure(h) / profile.pressure(h),
        (STANDARD,) * (edge.size - 1),
        anchor=(0.0, float(profile.pressure(0.0))),
        constant=profile.constant,
    )
    kept = replace(profile, layers=layers)
    return kept, replace(made.covariance, profile=kept)
