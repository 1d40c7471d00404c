"""Which sources of the air were used and what they said, and why others were not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate import Fit
from pipeline.atmosphere.metar import SurfaceReport
from pipeline.atmosphere.samples import AirSamples, Samples
from pipeline.atmosphere.soundings import Sounding

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


def account(
    given: AirSamples,
    believed: AirSamples,
    used: AirSamples | None,
    fits: Sequence[Fit],
    soundings: Sequence[Sounding],
    surface: Sequence[SurfaceReport],
    background: Climatology,
    standard: str,
) -> tuple[SourceUse, ...]:
    """Every source with its fit, or in words why it is not used.

    ``given`` what the flight measured, ``believed`` what of it is not contradicted, ``used`` what
    the estimate stands on, None where no estimate stands.
    """
    uses = [SourceUse(fit.name, fit=fit) for fit in fits]
    for name, word in _INSTRUMENTS:
        sensors = (getattr(samples, name) for samples in (given, believed, used or AirSamples()))
        why = _why_not(*sensors, stands=used is not None)
        sensor = getattr(given, name)
        label = f"{word} {sensor.name}".strip() if sensor is not None else word
        if why is not None:
            uses.append(SourceUse(label, why))
    unused = "no estimate with it can stand: see the ledger"
    for kind, sources in (("sounding", soundings), ("surface report", surface)):
        if not sources:
            uses.append(SourceUse(kind, "none in the mission file"))
        elif used is None:
            uses.append(SourceUse(kind, unused))
    name = background.profile.name
    uses.append(SourceUse(f"{name} ({background.origin})" if name != standard else name))
    if name != standard:
        uses.append(SourceUse(standard, "only shown beside the air"))
    return tuple(uses)


def _why_not(
    given: Samples | None, believed: Samples | None, used: Samples | None, *, stands: bool
) -> str | None:
    if given is None:
        return "none outside in the log"
    if not bool(given.accepted.any()):
        return "no reading at a known height passes the gates"
    if believed is None:
        return "contradicted by the others: see the ledger"
    if not stands:
        return f"{given.extent_m:.0f} m of height say too little"
    return "left out: it spans too little height, or no air fits it" if used is None else None
