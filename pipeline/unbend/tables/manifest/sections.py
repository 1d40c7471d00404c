"""The keys of a mission file that reports use, read from the copy of the file in a manifest.

`unbend.config` defines all keys and writes that copy. An older version may have written it, with
keys that no longer exist: these records contain only the keys that are read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class CabinKeys:
    """The air in a cabin: numbers, ``log``, ``ambient``, or None for what is not stated."""

    pressure: float | str | None
    temperature_c: float | str | None
    sigma_pressure_hpa: float | None
    sigma_temperature_k: float | None


@dataclass(frozen=True)
class WindowKeys:
    """The window in front of a camera, and the air behind it."""

    shape: str
    in_calibration: str
    cabin: CabinKeys | str | None = None


@dataclass(frozen=True)
class CameraKeys:
    """A camera's window or opening, and the reference of its principal distance."""

    principal_distance: Mapping[str, Any] | None
    window: WindowKeys | None
    opening: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class RefractionKeys:
    """Whether refraction is removed or applied (``direction``), and by which method."""

    direction: str
    method: str


@dataclass(frozen=True)
class StationsKeys:
    """Whether suspect stations are used, and the table of orientations, None without one."""

    use_suspect: bool
    orientation: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class MissionKeys:
    """Texts for the first page of the report; None in mission files without them."""

    title: str | None = None
    client: str | None = None
    operator: str | None = None
    remarks: str | None = None
    time_zone: str | None = None
    date: str | None = None


@dataclass(frozen=True)
class AtmosphereKeys:
    """Whether the air is estimated from measurements; if not, a standard atmosphere is used."""

    adjust: bool = True


@dataclass(frozen=True)
class MissionSections:
    """The sections of a mission file, with the keys that reports use."""

    refraction: RefractionKeys
    cameras: Mapping[str, CameraKeys]
    stations: StationsKeys
    mission: MissionKeys = field(default_factory=MissionKeys)
    atmosphere: AtmosphereKeys = AtmosphereKeys()
