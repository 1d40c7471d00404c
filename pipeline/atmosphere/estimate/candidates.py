"""What an estimate can stand on: which sensors say enough, with which soundings and stations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport

SMALLEST_CLIMB_M = 300.0
"""Less than this of sampled height says too little of the air with a thermometer [m]."""

SMALLEST_BAROMETRIC_CLIMB_M = 2000.0
"""... and without one (the error stays above 10 % of R below 1 km, whatever is done) [m]."""

BEYOND_M = 500.0
"""A barometer that sampled so much more height than the thermometer is told of beside it [m']."""

MOST_DOUBTED = 5
"""Of more soundings and stations than these they are left out all together, not one by one."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Soundings and stations beside the flight, and the names of those that are left out."""

    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[Sounding | SurfaceReport, ...]:
        return (*self.soundings, *self.surface)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(source.name for source in self.sources)


@dataclass(frozen=True, eq=False)
class Basis:
    """The samples that say enough, what stands beside them, the word for it, and why."""

    word: str
    reason: str
    samples: AirSamples
    beside: Beside
    main: SensorSamples | None = None


def bases(
    samples: AirSamples, soundings: Sequence[Sounding], surface: Sequence[SurfaceReport]
) -> list[Basis]:
    """What an estimate can stand on, the best first, the next if the best gives no air.

    Every choice of the flight's own sensors is tried with all soundings and stations, then without
    each of them, then without all: one bad level of a balloon must not cost what the flight saw.
    """
    choices = _choices(Beside(tuple(soundings), tuple(surface)))
    columns = [_of_the_flight(samples, beside) for beside in choices]
    found = [basis for row in zip(*columns, strict=True) for basis in row]
    alone = replace(samples, temperature=None)
    for beside in choices:
        if beside.names:
            word = "sounding" if beside.soundings else "surface"
            found.append(Basis(word, _told("", beside), alone, beside, samples.pressure))
    return found


def _choices(everything: Beside) -> list[Beside]:
    """All sources, then all but one, then none."""
    found = [everything]
    if 1 < len(everything.names) <= MOST_DOUBTED:
        for source in everything.sources:
            found.append(
                Beside(
                    tuple(s for s in everything.soundings if s is not source),
                    tuple(r for r in everything.surface if r is not source),
                    (source.name,),
                )
            )
    if everything.names:
        found.append(Beside(left_out=everything.names))
    return found


def _of_the_flight(samples: AirSamples, beside: Beside) -> list[Basis]:
    """Thermometer and barometer, the barometer alone, the thermometer alone."""
    temperature, pressure = samples.temperature, samples.pressure
    warm = _if_tall(temperature, SMALLEST_CLIMB_M)
    high = _if_tall(pressure, SMALLEST_BAROMETRIC_CLIMB_M)
    found: list[Basis] = []
    if warm is not None:
        word = "thermometer"
        reason = f"temperatures of {warm.name} over {warm.extent_m:.0f} m of height"
        if high is not None and _reaches_beyond(high, warm):
            word = "both"
            reason += (
                f"; above and below them {high.name} against GNSS height over {high.extent_m:.0f} m"
            )
        found.append(Basis(word, _told(reason, beside), samples, beside, warm))
    if high is not None:
        if warm is not None:
            without = f"without the thermometer {warm.name}"
        elif temperature is not None:
            without = (
                f"the thermometer {temperature.name} spans only {temperature.extent_m:.0f} m of "
                "height"
            )
        else:
            without = "no thermometer outside"
        reason = (
            f"{without}: temperatures from {high.name} against GNSS height over "
            f"{high.extent_m:.0f} m"
        )
        without_it = replace(samples, temperature=None)
        found.append(Basis("barometer", _told(reason, beside), without_it, beside, high))
    if warm is not None and pressure is not None:
        alone = replace(samples, pressure=None)
        reason = f"temperatures of {warm.name} alone, without {pressure.name}"
        found.append(Basis("thermometer", _told(reason, beside), alone, beside, warm))
    return found


def _if_tall(sensor: SensorSamples | None, least_m: float) -> SensorSamples | None:
    """A sensor that spans enough height."""
    return sensor if sensor is not None and sensor.extent_m >= least_m else None


def _told(reason: str, beside: Beside) -> str:
    """The reason, with the sources beside the flight and those that are not there."""
    names, left_out = ", ".join(beside.names), ", ".join(beside.left_out)
    if names:
        reason = f"{reason}; with {names}" if reason else names
    return f"{reason}; without {left_out}" if left_out else reason


def _reaches_beyond(pressure: SensorSamples, temperature: SensorSamples) -> bool:
    """Whether the barometer sampled half a kilometre or more beyond the thermometer."""
    warm, all_of_it = temperature.used()[0], pressure.used()[0]
    beyond = max(all_of_it.max() - warm.max(), warm.min() - all_of_it.min())
    return bool(beyond > BEYOND_M)


def why_none(samples: AirSamples, faults: Sequence[str], kept: str) -> str:
    """Why the background is kept: no estimate could stand, or nothing says enough for one."""
    temperature, pressure = samples.temperature, samples.pressure
    kept += " is kept unchanged"
    if faults:
        return f"no estimate could stand, the first because {faults[0]}: {kept}"
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
