"""The locally adjusted profile: the climatology, moved to what the flight measured.

Which sensors are believed, whether they say enough, whether the estimate may stand; and in words
why the profile is what it is. The estimate itself is made in `estimate`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.climatology import AUTO, Climatology, climatology, month_of
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate.calibration import calibrated, compare_calibration, tell_unused
from pipeline.atmosphere.estimate.candidates import Basis, bases, why_none
from pipeline.atmosphere.estimate.estimate_checks import (
    MISFIT,
    implausible,
    not_outside,
    worse_than_climatology,
)
from pipeline.atmosphere.estimate.representativeness import TimeAndPlace, says_nothing
from pipeline.atmosphere.estimate.sensor_checks import judge_level, usable_sensors
from pipeline.atmosphere.estimate.sensors import Barometer, Humidities, Temperatures, Thermometer
from pipeline.atmosphere.estimate.solver import Estimate, Fit, Nuisance, estimate
from pipeline.atmosphere.estimate.source_usage import Flown, SourceUse, account
from pipeline.atmosphere.profile import (
    BAROMETRIC,
    MEASURED,
    RELAXED,
    STANDARD,
    Profile,
    stack_layers,
)
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport
from pipeline.geodesy import normal_gravity
from pipeline.ledger import Ledger

Array = NDArray[np.float64]

WIDEST_GAP_M = 400.0
"""Between two measured heights farther apart than this the layers are called relaxed [m']."""

UNCHANGED = 0.95
"""Where sigma of temperature is still this much of the climatology's, nothing was learnt."""

FEWEST_TO_WIDEN = 5
"""The estimator never widens the sigmas of fewer readings: too few to tell."""

LEFT_OUT = "with it no air fits what the flight measured"

UNMEASURED, UNADJUSTED = "climatology", "standard"
"""Bases of a profile that no measurement speaks in."""


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


def build_adjusted_profile(
    samples: AirSamples,
    standard: Profile,
    latitude_rad: float,
    ledger: Ledger,
    *,
    background: Climatology | None = None,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    time_ns: int | None = None,
    longitude_rad: float = math.nan,
) -> Adjustment:
    """The locally adjusted atmosphere profile of a flight, with its covariance.

    Parameters
    ----------
    samples : what the flight measured outside, or a part of it.
    standard : shown beside the profile; its index formula and constants are kept.
    latitude_rad : of the flight, for gravity and climate.
    ledger : receives every fallback, and every sensor that is not believed.
    background : the climatology to relax to; by default the standard, with the spread about it.
    soundings, surface : balloons and stations near the flight; they weigh by age and distance, and
        what is too far in either to say anything is left out.
    time_ns, longitude_rad : of the flight, by which they are near; without samples only this time
        tells the season.

    Where nothing says enough, or the estimate is no air or no better than the background, the
    background is returned with its own sigma, and the reason.

    On nine real soundings (tests/atmosphere/test_estimate_montecarlo.py) the RMS error of R at
    1 / 3 / 6 / 10 km, where US 1976 errs by 20 / 13 / 7 / 7 %: clean sensors in climb and descent
    0.5 / 0.1 / 0.03 / 0.03 %; sensors with bias, lag, transient, drifts and outliers
    0.7 / 0.2 / 0.1 % at 1 / 3 / 6 km, in a climb alone 2.0 / 0.4 / 0.2 %; barometer and GNSS alone
    1.2 / 0.7 % at 3 / 6 km.
    """
    standard = under_gravity(standard, latitude_rad)
    occasion = TimeAndPlace(_middle(samples, time_ns), latitude_rad, longitude_rad)
    month = month_of(occasion.time_ns)
    moisture = climatology(AUTO, latitude_rad=latitude_rad, month=month, index=standard.index)
    if background is None:
        background = _about(standard, moisture, latitude_rad, month)
    given = calibrated(samples, ledger)
    samples = usable_sensors(given, standard, ledger)
    useless = _too_far((*soundings, *surface), occasion, ledger)
    near = [s for s in soundings if s.name not in useless]
    reports = [r for r in surface if r.name not in useless]
    faults: list[str] = []
    doubted = False
    tried: list[Basis] = []

    def sources(basis: Basis | None, fits: Sequence[Fit]) -> tuple[SourceUse, ...]:
        unused = useless | (dict.fromkeys(basis.beside.left_out, LEFT_OUT) if basis else {})
        flown = Flown(given, samples, [b.samples for b in tried], basis.samples if basis else None)
        return account(flown, fits, soundings, surface, unused, background, standard.name)

    humid = moisture if not background.has_humidity else background
    for basis in bases(samples, near, reports):
        if doubted and basis.samples.temperature is not None:
            continue
        tried.append(basis)
        made = estimate(
            basis.samples, background, moisture=humid, soundings=basis.beside.soundings,
            surface=basis.beside.surface, occasion=occasion,
        )  # fmt: skip
        indoors = not_outside(basis.samples, made, background, humid)
        if indoors is not None and basis.main is not None:
            doubted, name = True, basis.main.name
            faults.append(indoors)
            ledger.loss("AIR-THERMOMETER", f"{name} is not used: {indoors}", where=name)
            continue
        fault = implausible(made, background) or worse_than_climatology(made, background, humid)
        if fault is None:
            for name in basis.beside.left_out:
                ledger.loss("AIR-SOURCE-REFUSED", f"{name} is not used: {LEFT_OUT}", where=name)
            found = _adjusted(basis, made, standard, background, ledger)
            return replace(found, sources=sources(basis, made.fits), moisture=humid)
        faults.append(fault)
        ledger.loss(
            "AIR-IMPLAUSIBLE",
            f"the air estimated from {basis.reason} is not used: {fault}",
            where=basis.main.name if basis.main is not None else "",
        )
    same = background.profile.name == standard.name
    kept = f"the {'standard atmosphere' if same else 'climatology'} {background.profile.name}"
    reason = why_none(samples, faults, kept)
    ledger.fallback("AIR-STANDARD", reason)
    tell_unused(set(given.calibration), ledger)
    profile, covariance = _unchanged(background)
    word = UNADJUSTED if same else UNMEASURED
    return Adjustment(
        profile, standard, word, reason, covariance=covariance, sources=sources(None, ())
    )


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard's layers in geopotential height, under the gravity of a latitude."""
    return replace(standard, gravity=normal_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    return Adjustment(standard, standard, UNADJUSTED, reason)


def _middle(samples: AirSamples, otherwise: int | None) -> int | None:
    """When the flight was [Unix ns]: the middle of what it measured."""
    for sensor in (samples.temperature, samples.pressure, samples.humidity):
        if sensor is not None and sensor.middle_ns is not None:
            return sensor.middle_ns
    return otherwise


def _too_far(
    sources: Sequence[Sounding | SurfaceReport], occasion: TimeAndPlace, ledger: Ledger
) -> dict[str, str]:
    """Sources that are too old or too far away to say anything, by name with the reason."""
    found = {}
    for source in sources:
        why = says_nothing(source, occasion)
        if why is not None:
            found[source.name] = why
            ledger.loss("AIR-SOURCE-FAR", f"{source.name} is not used: {why}", where=source.name)
    return found


def _about(
    standard: Profile, moisture: Climatology, latitude_rad: float, month: float
) -> Climatology:
    """A standard as the background, with the spread of a day's air about it."""
    named = climatology(standard.name, latitude_rad=latitude_rad, month=month)
    return replace(named, profile=standard)


def _adjusted(
    basis: Basis, made: Estimate, standard: Profile, background: Climatology, ledger: Ledger
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
    if not made.converged:
        ledger.warning("AIR-UNSETTLED", "the estimate still moved after its last step")
    return Adjustment(
        profile,
        standard,
        basis.word,
        basis.reason,
        basis.main.middle_ns if basis.main is not None else None,
        replace(made.covariance, profile=profile),
        made.nuisances,
        rejected=made.sources.rejected,
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
            "; ".join(f"{n.name} {n.value:.3g} ± {n.sigma:.2g}" for n in learnt),
        )
    compare_calibration(made, samples, ledger)
    for fit in made.fits:
        few = fit.count < FEWEST_TO_WIDEN
        if fit.widened > MISFIT or (few and fit.rms > MISFIT):
            ledger.warning(
                "AIR-MISFIT",
                f"residuals of {fit.name} ({fit.quantity}) are {fit.rms:.1f} times what its errors "
                f"explain: {_dealt_with(fit)}",
                where=fit.name,
                count=fit.count,
            )
    for name, rejected in made.sources.rejected.items():
        if bool(rejected.any()):
            sensor = getattr(samples, name)
            ledger.note(
                "AIR-OUTLIERS",
                f"{int(rejected.sum())} of {int(sensor.accepted.sum())} readings are far from "
                "their neighbours in height and time and are not used",
                where=sensor.name,
                count=int(rejected.sum()),
            )


def _dealt_with(fit: Fit) -> str:
    if fit.widened > MISFIT:
        return f"its sigmas were widened {fit.widened:.0f} times"
    return "the others outvote it"


def _unchanged(background: Climatology) -> tuple[Profile, ProfileCovariance]:
    """The background itself, in layers fine enough to carry its covariance."""
    made, profile = estimate(AirSamples(), background), background.profile
    edge = made.profile.layers.edge
    t_m, _, vapour = profile.state(profile.gravity.height(edge))
    layers = stack_layers(
        edge,
        t_m,
        vapour,
        (STANDARD,) * (edge.size - 1),
        anchor=(0.0, float(profile.pressure(0.0))),
        constant=profile.constant,
    )
    kept = replace(profile, layers=layers)
    return kept, replace(made.covariance, profile=kept)
