"""What an estimate can use: sensors that span enough height, with which soundings and stations.

And afterwards how each source was used, or why it was not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport

SMALLEST_CLIMB_M = 300.0  # a thermometer needs this much sampled height [m]

BEYOND_M = 500.0
"""A barometer that sampled so much more height than the thermometer is named beside it [m']."""

MOST_LEFT_OUT_ONE_BY_ONE = 5
"""More soundings and stations than these are left out all together, not one by one."""

NO_ESTIMATE = "no estimate with it passed its checks: see the ledger"

INSTRUMENTS = {"temperature": "thermometer", "pressure": "barometer", "humidity": "hygrometer"}


@dataclass(frozen=True, eq=False)
class ExternalSources:
    """Soundings and stations that are used beside the flight, and the names of those left out."""

    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[Sounding | SurfaceReport, ...]:
        return (*self.soundings, *self.surface)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(source.name for source in self.sources)

    def described(self, reason: str) -> str:
        """A reason with the sources that are used and those that are left out."""
        names = ", ".join(self.names)
        left_out = ", ".join(self.left_out)
        if names:
            reason = f"{reason}; with {names}" if reason else names
        return f"{reason}; without {left_out}" if left_out else reason


@dataclass(frozen=True, eq=False)
class Candidate:
    """Samples and external sources for one estimate: the word for it, and why.

    It rests on the ``main`` sensor.
    """

    basis: str
    reason: str
    samples: AirSamples
    external: ExternalSources
    main: SensorSamples | None = None


def candidates(
    samples: AirSamples, soundings: Sequence[Sounding], surface: Sequence[SurfaceReport]
) -> list[Candidate]:
    """What an estimate can use, the best first.

    Every choice of the flight's own sensors with all soundings and stations, then without each of
    them, then without all, as one bad level of a balloon must not cost what the flight saw.
    """
    everything = ExternalSources(tuple(soundings), tuple(surface))
    choices = [everything]
    if 1 < len(everything.names) <= MOST_LEFT_OUT_ONE_BY_ONE:
        choices += [
            ExternalSources(
                tuple(s for s in soundings if s is not source),
                tuple(r for r in surface if r is not source),
                (source.name,),
            )
            for source in everything.sources
        ]
    if everything.names:
        choices.append(ExternalSources(left_out=everything.names))
    columns = (_with_own_sensors(samples, external) for external in choices)
    ordered = list(chain.from_iterable(zip(*columns, strict=True)))
    no_thermometer = replace(samples, temperature=None)
    for external in choices:
        if external.names:
            basis = external.soundings[0].kind if external.soundings else "surface"
            reason = external.described("")
            ordered.append(Candidate(basis, reason, no_thermometer, external, samples.pressure))
    return ordered


def _with_own_sensors(samples: AirSamples, external: ExternalSources) -> list[Candidate]:
    """Thermometer and barometer, the barometer alone, the thermometer alone.

    The barometer alone over any height: the sigma of its estimate says whether it is used.
    """
    temperature = samples.temperature
    pressure = samples.pressure
    warm = _if_tall(temperature, SMALLEST_CLIMB_M)
    high = _if_tall(pressure, 0.0)
    choices: list[Candidate] = []

    def add(basis: str, reason: str, used: AirSamples, main: SensorSamples) -> None:
        choices.append(Candidate(basis, external.described(reason), used, external, main))

    column = "" if high is None else f"{high.name} against GNSS height over {high.extent_m:.0f} m"
    if warm is not None:
        basis = "thermometer"
        reason = f"temperatures of {warm.name} over {warm.extent_m:.0f} m of height"
        if high is not None:
            h_warm, _ = warm.used()
            h_high, _ = high.used()
            if max(h_high.max() - h_warm.max(), h_warm.min() - h_high.min()) > BEYOND_M:
                basis = "both"
                reason = f"{reason}; above and below them {column}"
        add(basis, reason, samples, warm)
    if high is not None:
        why = "no thermometer outside"
        if warm is not None:
            why = f"without the thermometer {warm.name}"
        elif temperature is not None:
            extent = f"{temperature.extent_m:.0f} m of height"
            why = f"the thermometer {temperature.name} spans only {extent}"
        reason = f"{why}: temperatures from {column}"
        add("barometer", reason, replace(samples, temperature=None), high)
    if warm is not None and pressure is not None:
        reason = f"temperatures of {warm.name} alone, without {pressure.name}"
        add("thermometer", reason, replace(samples, pressure=None), warm)
    return choices


def _if_tall(sensor: SensorSamples | None, least_m: float) -> SensorSamples | None:
    """A sensor whose accepted readings span enough height."""
    if sensor is None or not bool(sensor.accepted.any()) or sensor.extent_m < least_m:
        return None
    return sensor


def reason_unadjusted(samples: AirSamples, faults: Sequence[str], kept: str) -> str:
    """Why the background ``kept`` is used: no estimate passed its checks, or none was possible."""
    t = samples.temperature
    if faults:
        why = f"no estimate passed its checks, the first because {faults[0]}"
    elif t is not None:
        least = f"at least {SMALLEST_CLIMB_M:.0f} m are needed"
        spans = f"spans {t.extent_m:.0f} m of height ({least})"
        why = f"the thermometer {t.name} {spans}, and there is no barometer"
    elif samples.pressure is not None:
        why = "the barometer has no reading at a known height"
    else:
        why = "there is no usable thermometer or barometer outside"
    return f"{why}: {kept} is kept unchanged"


@dataclass(frozen=True)
class SourceUse:
    """One source of the air: how it fits and its information content, or why it is not used."""

    source: str
    why_not: str = ""
    fit: Fit | None = None

    def sentence(self) -> str:
        """For a person.

        >>> SourceUse("sounding", "none in the mission file").sentence()
        'sounding: not used, none in the mission file'
        """
        if self.fit is None:
            return f"{self.source}: " + (f"not used, {self.why_not}" if self.why_not else "used")
        fit = self.fit
        inflated = fit.sigma_inflation > 1.05
        inflation = f", sigma inflation factor {fit.sigma_inflation:.1f}" if inflated else ""
        return (
            f"{self.source}: {fit.quantity}, {fit.count} bins or levels that fit to {fit.rms:.1f} "
            f"sigma{inflation}, {fit.signal_freedom:.1f} degrees of freedom for signal"
        )


@dataclass(frozen=True, eq=False)
class UsedSamples:
    """Samples ``given`` by a log, ``usable`` by the sensor checks, ``tried`` and ``used``.

    These are of the estimates that were tried, and of the one that is used; and why a sensor was
    ``refused``, by its quantity.
    """

    given: AirSamples
    usable: AirSamples
    tried: Sequence[AirSamples] = ()
    used: AirSamples | None = None
    refused: Mapping[str, str] = field(default_factory=dict)

    def why_not(self, name: str) -> str | None:
        """Why a sensor is not used, in words; None where it is."""
        given: SensorSamples | None = getattr(self.given, name)
        if given is None:
            return "none outside in the log"
        if not bool(given.accepted.any()):
            return "no reading at a known height passes the checks"
        if name in self.refused:
            return self.refused[name]
        if getattr(self.usable, name) is None:
            return "contradicted by the other sources: see the ledger"
        if self.used is None:
            was_tried = any(getattr(samples, name) is not None for samples in self.tried)
            return NO_ESTIMATE if was_tried else f"{given.extent_m:.0f} m of height are too few"
        left_out = getattr(self.used, name) is None
        return "left out: it spans too little height, or no air fits it" if left_out else None


def source_usage(
    flown: UsedSamples,
    fits: Sequence[Fit],
    *,
    external: ExternalSources,
    unused: Mapping[str, str],
    background: Climatology,
    standard: str,
) -> tuple[SourceUse, ...]:
    """Every source with its fit, or in words why it is not used.

    ``unused`` are the ``external`` ones that were left out, by name, and why.
    """
    uses = [SourceUse(fit.name, fit=fit) for fit in fits]
    for name in INSTRUMENTS:
        why = flown.why_not(name)
        if why is not None:
            uses.append(SourceUse(_instrument(flown.given, name), why))
    for kind, sources in (("sounding", external.soundings), ("surface report", external.surface)):
        if not sources:
            uses.append(SourceUse(kind, "none in the mission file"))
    for name in external.names:
        if name in unused or flown.used is None:
            uses.append(SourceUse(name, unused.get(name, NO_ESTIMATE)))
    name = background.profile.name
    uses.append(SourceUse(f"{name} ({background.origin})" if name != standard else name))
    if name != standard:
        uses.append(SourceUse(standard, "only shown for comparison"))
    return tuple(uses)


def no_source_used(
    given: AirSamples, external: ExternalSources, standard: str, why: str
) -> tuple[SourceUse, ...]:
    """The usage where the mission file asks for a standard: nothing else is used."""
    labels = [_instrument(given, name) for name in INSTRUMENTS if getattr(given, name) is not None]
    return (*(SourceUse(label, why) for label in (*labels, *external.names)), SourceUse(standard))


def _instrument(samples: AirSamples, name: str) -> str:
    """``thermometer IMET[0]``, or the instrument alone where the log has none."""
    sensor = getattr(samples, name)
    return INSTRUMENTS[name] if sensor is None else f"{INSTRUMENTS[name]} {sensor.name}".strip()
