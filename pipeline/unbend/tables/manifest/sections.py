"""What reports say of a mission file, from the copy of it in a manifest.

`unbend.config` describes a mission file and writes that copy. An older version may have written it,
with keys that are no longer known: here are only the keys that somebody reads.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class CabinKeys:
    """What a mission file states of the air in a cabin."""

    pressure: float | str | None
    temperature_c: float | str | None
    sigma_pressure_hpa: float | None
    sigma_temperature_k: float | None


@dataclass(frozen=True)
class WindowKeys:
    """What a mission file says of the window before a camera."""

    shape: str
    in_calibration: str
    cabin: CabinKeys | str | None = None


@dataclass(frozen=True)
class CameraKeys:
    """What a mission file says of a camera, beside its interior orientation."""

    principal_distance: Mapping[str, Any] | None
    window: WindowKeys | None
    opening: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class RefractionKeys:
    """Which way observations are moved, and by which method."""

    direction: str
    method: str


@dataclass(frozen=True)
class StationsKeys:
    """Whether suspect stations are used, and the orientations, if there are any."""

    use_suspect: bool
    orientation: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class MissionKeys:
    """What a mission file says for the first page of the report; older ones say nothing."""

    title: str | None = None
    client: str | None = None
    operator: str | None = None
    remarks: str | None = None
    time_zone: str | None = None
    date: str | None = None


@dataclass(frozen=True)
class AtmosphereKeys:
    """Whether the air is estimated from what measured it; else the standard is kept."""

    adjust: bool = True


@dataclass(frozen=True)
class MissionSections:
    """What reports say of a mission file: parts of the sections that `unbend.config` describes."""

    refraction: RefractionKeys
    cameras: Mapping[str, CameraKeys]
    stations: StationsKeys
    mission: MissionKeys = field(default_factory=MissionKeys)
    atmosphere: AtmosphereKeys = AtmosphereKeys()
