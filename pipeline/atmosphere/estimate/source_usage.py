"""Which sources of the air were used and what they said, and why others were not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.solver import Fit
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport

NO_ESTIMATE = "no estimate with it could stand: see the ledger"

_INSTRUMENTS = (("temperature", "thermometer"), ("pressure", "barometer"),
                ("humidity", "hygrometer"))  # fmt: skip


@dataclass(frozen=True)
class SourceUse:
    """One source of the air: how it fits and how much it told (see `Fit`), or why it is unused."""

    source: str
    why_not: str = ""
    fit: Fit | None = None

    def row(self) -> dict[str, object]:
        """For the manifest."""
        if self.fit is None:
            return {"source": self.source, "used": not self.why_not, "why_not": self.why_not}
        fit = self.fit
        return {
            "source": self.source,
            "used": True,
            "quantity": fit.quantity,
            "readings": fit.count,
            "rms_sigma": round(fit.rms, 3),
            "widened": round(fit.widened, 3),
            "told": round(fit.told, 3),
        }

    def sentence(self) -> str:
        """For a person.

        >>> SourceUse("sounding", "none in the mission file").sentence()
        'sounding: not used, none in the mission file'
        """
        if self.fit is None:
            return f"{self.source}: " + (f"not used, {self.why_not}" if self.why_not else "used")
        fit = self.fit
        wide = f", its sigmas widened {fit.widened:.1f} times" if fit.widened > 1.05 else ""
        return (
            f"{self.source}: {fit.quantity}, {fit.count} bins or levels that fit to "
            f"{fit.rms:.1f} sigma{wide}, and tell {fit.told:.1f} unknowns"
        )


@dataclass(frozen=True, eq=False)
class Flown:
    """Samples of a flight: what it measured, what of it is not contradicted, what estimates were
    tried with, and what the one that stands is made of, None where none stands."""

    given: AirSamples
    believed: AirSamples
    tried: Sequence[AirSamples] = ()
    used: AirSamples | None = None


def account(
    flown: Flown,
    fits: Sequence[Fit],
    soundings: Sequence[Sounding],
    surface: Sequence[SurfaceReport],
    unused: Mapping[str, str],
    background: Climatology,
    standard: str,
) -> tuple[SourceUse, ...]:
    """Every source with its fit, or in words why it is not used.

    ``unused`` soundings and reports that were left out, by name, and why.
    """
    uses = [SourceUse(fit.name, fit=fit) for fit in fits]
    for name, word in _INSTRUMENTS:
        why = _why_not(name, flown)
        sensor = getattr(flown.given, name)
        label = f"{word} {sensor.name}".strip() if sensor is not None else word
        if why is not None:
            uses.append(SourceUse(label, why))
    for kind, sources in (("sounding", soundings), ("surface report", surface)):
        if not sources:
            uses.append(SourceUse(kind, "none in the mission file"))
        for source in sources:
            if source.name in unused:
                uses.append(SourceUse(source.name, unused[source.name]))
            elif flown.used is None:
                uses.append(SourceUse(source.name, NO_ESTIMATE))
    name = background.profile.name
    uses.append(SourceUse(f"{name} ({background.origin})" if name != standard else name))
    if name != standard:
        uses.append(SourceUse(standard, "only shown beside the air"))
    return tuple(uses)


def all_unused(
    given: AirSamples,
    soundings: Sequence[Sounding],
    surface: Sequence[SurfaceReport],
    standard: str,
    why: str,
) -> tuple[SourceUse, ...]:
    """The account of a standard that the mission file asks for: nothing else is used."""
    sensors = ((word, getattr(given, name)) for name, word in _INSTRUMENTS)
    labels = [f"{word} {sensor.name}".strip() for word, sensor in sensors if sensor is not None]
    labels += [sounding.name for sounding in soundings] + [report.name for report in surface]
    return (*(SourceUse(label, why) for label in labels), SourceUse(standard))


def _why_not(name: str, flown: Flown) -> str | None:
    given: SensorSamples | None = getattr(flown.given, name)
    if given is None:
        return "none outside in the log"
    if not bool(given.accepted.any()):
        return "no reading at a known height passes the gates"
    if getattr(flown.believed, name) is None:
        return "contradicted by the others: see the ledger"
    if flown.used is None:
        was_tried = any(getattr(samples, name) is not None for samples in flown.tried)
        return NO_ESTIMATE if was_tried else f"{given.extent_m:.0f} m of height say too little"
    left_out = getattr(flown.used, name) is None
    return "left out: it spans too little height, or no air fits it" if left_out else None
