"""Candidates for the estimate: sets of sensors, soundings and stations that may give the air.

And for the report, how each source was used, or why it was not.
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

BEYOND_M = 500.0  # a barometer that sampled so far beyond the thermometer is named too [m]

MOST_LEFT_OUT_ONE_BY_ONE = 5
"""More soundings and stations than these are left out all together, not one by one."""

NO_ESTIMATE = "no estimate with it passed its checks: see the ledger"

INSTRUMENTS = {"temperature": "thermometer", "pressure": "barometer", "humidity": "hygrometer"}


@dataclass(frozen=True, eq=False)
class ExternalSources:
    """Soundings and stations that are used with the flight, and the names of those left out."""

    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[Sounding | SurfaceReport, ...]:
        """The used soundings, then the used stations."""
        return (*self.soundings, *self.surface)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the used sources."""
        return tuple(source.name for source in self.sources)

    def without(self, left_out: Sounding | SurfaceReport) -> "ExternalSources":
        """The sources but one, which is named as left out."""
        return ExternalSources(
            tuple(sounding for sounding in self.soundings if sounding is not left_out),
            tuple(report for report in self.surface if report is not left_out),
            (left_out.name,),
        )

    def described(self, reason: str) -> str:
        """A reason, maybe empty, followed by the names of used and of left out sources."""
        names = ", ".join(self.names)
        left_out = ", ".join(self.left_out)
        if names:
            reason = f"{reason}; with {names}" if reason else names
        return f"{reason}; without {left_out}" if left_out else reason


@dataclass(frozen=True, eq=False)
class Candidate:
    """Samples and external sources for one estimate.

    ``basis``: what gives the temperatures, as in `Adjustment.basis`. ``reason``: in words, for the
    report. ``main``: the sensor of the flight that the estimate mainly depends on, if any.
    """

    basis: str
    reason: str
    samples: AirSamples
    external: ExternalSources
    main: SensorSamples | None = None


def candidates(
    samples: AirSamples, soundings: Sequence[Sounding], surface: Sequence[SurfaceReport]
) -> list[Candidate]:
    """The candidates for an estimate, the best first.

    Each choice of the flight's own sensors is tried with all soundings and stations, then without
    each of these, then without all of them: one bad level of a balloon must not make the flight's
    measurements useless. Soundings and stations without the flight's thermometer come last.
    """
    everything = ExternalSources(tuple(soundings), tuple(surface))
    external_choices = [everything]
    if 1 < len(everything.names) <= MOST_LEFT_OUT_ONE_BY_ONE:
        for source in everything.sources:
            external_choices.append(everything.without(source))
    if everything.names:
        external_choices.append(ExternalSources(left_out=everything.names))
    # A list for each choice of external sources, all with the same choices of own sensors.
    lists = [_with_own_sensors(samples, external) for external in external_choices]
    ordered = list(chain.from_iterable(zip(*lists, strict=True)))
    no_thermometer = replace(samples, temperature=None)
    for external in external_choices:
        if external.names:
            basis = external.soundings[0].kind if external.soundings else "surface"
            reason = external.described("")
            ordered.append(Candidate(basis, reason, no_thermometer, external, samples.pressure))
    return ordered


def _with_own_sensors(samples: AirSamples, external: ExternalSources) -> list[Candidate]:
    """Candidates with the flight's own sensors and some external sources.

    In this order: thermometer and barometer, the barometer alone, the thermometer alone; those that
    the flight lacks are left out. A thermometer must span enough height. A barometer alone is a
    candidate over any height, because the sigma of its estimate decides whether it is used.
    """
    temperature = samples.temperature
    pressure = samples.pressure
    thermometer = _if_tall(temperature, SMALLEST_CLIMB_M)
    barometer = _if_tall(pressure, 0.0)
    choices: list[Candidate] = []

    def add(basis: str, reason: str, used: AirSamples, main: SensorSamples) -> None:
        choices.append(Candidate(basis, external.described(reason), used, external, main))

    pressures = ""
    if barometer is not None:
        pressures = f"{barometer.name} against GNSS height over {barometer.extent_m:.0f} m"
    if thermometer is not None:
        basis = "thermometer"
        reason = f"temperatures of {thermometer.name} over {thermometer.extent_m:.0f} m of height"
        if barometer is not None and _reaches_beyond(barometer, thermometer):
            basis = "both"
            reason = f"{reason}; above and below them {pressures}"
        add(basis, reason, samples, thermometer)
    if barometer is not None:
        why = "no thermometer outside"
        if thermometer is not None:
            why = f"without the thermometer {thermometer.name}"
        elif temperature is not None:
            extent = f"{temperature.extent_m:.0f} m of height"
            why = f"the thermometer {temperature.name} spans only {extent}"
        reason = f"{why}: temperatures from {pressures}"
        add("barometer", reason, replace(samples, temperature=None), barometer)
    if thermometer is not None and pressure is not None:
        reason = f"temperatures of {thermometer.name} alone, without {pressure.name}"
        add("thermometer", reason, replace(samples, pressure=None), thermometer)
    return choices


def _reaches_beyond(barometer: SensorSamples, thermometer: SensorSamples) -> bool:
    """Whether a barometer sampled 500 m more than a thermometer, above or below its heights."""
    of_barometer, _ = barometer.used()
    of_thermometer, _ = thermometer.used()
    above = of_barometer.max() - of_thermometer.max()
    below = of_thermometer.min() - of_barometer.min()
    return bool(max(above, below) > BEYOND_M)


def _if_tall(sensor: SensorSamples | None, least_m: float) -> SensorSamples | None:
    """The sensor, or None if it has no accepted readings, or these span less than ``least_m``."""
    if sensor is None or not bool(sensor.accepted.any()) or sensor.extent_m < least_m:
        return None
    return sensor


def reason_unadjusted(samples: AirSamples, faults: Sequence[str], background: str) -> str:
    """Why the background is used unchanged: no estimate passed its checks, or none was possible.

    ``faults``: why each estimate failed, the first one first. ``background``: its name in words.
    """
    thermometer = samples.temperature
    if faults:
        why = f"no estimate passed its checks, the first because {faults[0]}"
    elif thermometer is not None:
        least = f"at least {SMALLEST_CLIMB_M:.0f} m are needed"
        spans = f"spans {thermometer.extent_m:.0f} m of height ({least})"
        why = f"the thermometer {thermometer.name} {spans}, and there is no barometer"
    elif samples.pressure is not None:
        why = "the barometer has no reading at a known height"
    else:
        why = "there is no usable thermometer or barometer outside"
    return f"{why}: {background} is kept unchanged"


@dataclass(frozen=True)
class SourceUse:
    """How a source of the air is used, or why not.

    With a ``fit`` it is used as measurements; without one and without ``why_not`` as it is, like a
    climatology.
    """

    source: str
    why_not: str = ""
    fit: Fit | None = None

    def sentence(self) -> str:
        """The use of the source in words, for the report.

        >>> SourceUse("sounding", "none in the mission file").sentence()
        'sounding: not used, none in the mission file'
        """
        if self.why_not and self.fit is None:
            return f"{self.source}: not used, {self.why_not}"
        if self.fit is None:
            return f"{self.source}: used"
        fit = self.fit
        is_inflated = fit.sigma_inflation > 1.05
        inflation = f", sigma inflation factor {fit.sigma_inflation:.1f}" if is_inflated else ""
        return (
            f"{self.source}: {fit.quantity}, {fit.count} bins or levels that fit to {fit.rms:.1f} "
            f"sigma{inflation}, {fit.signal_freedom:.1f} degrees of freedom for signal"
        )


@dataclass(frozen=True, eq=False)
class UsedSamples:
    """The samples of a flight at each stage of the estimate.

    ``logged``: of the log. ``usable``: left by the sensor checks. ``tried``: of each estimate that
    was tried. ``used``: of the estimate that passed, None without one. ``refused``: why a sensor is
    not used, by its quantity.
    """

    logged: AirSamples
    usable: AirSamples
    tried: Sequence[AirSamples] = ()
    used: AirSamples | None = None
    refused: Mapping[str, str] = field(default_factory=dict)

    def why_not(self, name: str) -> str | None:
        """Why the sensor of quantity ``name`` is not used, in words; None if it is used."""
        logged: SensorSamples | None = getattr(self.logged, name)
        if logged is None:
            return "none outside in the log"
        if not bool(logged.accepted.any()):
            return "no reading at a known height passes the checks"
        if name in self.refused:
            return self.refused[name]
        if getattr(self.usable, name) is None:
            return "contradicted by the other sources: see the ledger"
        if self.used is None:
            was_tried = any(getattr(samples, name) is not None for samples in self.tried)
            return NO_ESTIMATE if was_tried else f"{logged.extent_m:.0f} m of height are too few"
        if getattr(self.used, name) is None:
            return "left out: it spans too little height, or no air fits it"
        return None


def source_usage(
    flown: UsedSamples,
    fits: Sequence[Fit],
    *,
    external: ExternalSources,
    unused: Mapping[str, str],
    background: Climatology,
    standard: str,
) -> tuple[SourceUse, ...]:
    """The use of every source of the air: fits first, then sources that are not used and why.

    ``fits``: of the estimate that passed, empty without one. ``external``: all soundings and
    stations of the mission file; ``unused``: by name, why one of these was left out. ``standard``:
    name of the standard atmosphere.
    """
    uses = [SourceUse(fit.name, fit=fit) for fit in fits]
    for name in INSTRUMENTS:
        why = flown.why_not(name)
        if why is not None:
            uses.append(SourceUse(_instrument(flown.logged, name), why))
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
    logged: AirSamples, external: ExternalSources, standard: str, why: str
) -> tuple[SourceUse, ...]:
    """The use of all sources where only the standard atmosphere is used, for the reason ``why``."""
    unused = []
    for name in INSTRUMENTS:
        if getattr(logged, name) is not None:
            unused.append(_instrument(logged, name))
    unused += external.names
    return (*(SourceUse(source, why) for source in unused), SourceUse(standard))


def _instrument(samples: AirSamples, name: str) -> str:
    """A label such as ``thermometer IMET[0]``; the word alone where the log has no such sensor.

    ``name``: quantity of the sensor, a key of `INSTRUMENTS`.
    """
    sensor = getattr(samples, name)
    return INSTRUMENTS[name] if sensor is None else f"{INSTRUMENTS[name]} {sensor.name}".strip()
