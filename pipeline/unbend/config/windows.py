"""The sections of a mission file on the window of a camera and the air behind it."""

from functools import cached_property
from typing import Literal, Self

import numpy as np
from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from unbend.config.section import (
    Celsius,
    Hectopascal,
    Section,
    SectionError,
    Vector,
)
from unbend.errors import PhysicsError
from unbend.refraction import Cabin, Window
from unbend.refraction.window import UNKNOWN
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K


class CabinSection(Section):
    """The air in the compartment, quantity by quantity."""

    pressure: Literal["log", "ambient"] | Hectopascal | None = Field(
        None,
        description=(
            "pressure in the compartment: log, as logged; ambient, as outside (not pressurised); "
            "or a constant"
        ),
        examples=["log"],
        json_schema_extra={"unit": "hPa"},
    )
    pressure_hpa: Hectopascal | None = Field(
        None,
        validate_default=True,
        description="constant pressure in the compartment; the same as a number under pressure",
        examples=[800.0],
        json_schema_extra={"unit": "hPa"},
    )
    temperature_c: Literal["log"] | Celsius | None = Field(
        None,
        description=(
            "temperature in the compartment: log, or a constant. By default that of "
            "log.channels.cabin_temperature; without it 21 degC: +- 5 K if the cabin is "
            "pressurised, +- 10 K if it is not"
        ),
        examples=[21.0],
        json_schema_extra={"unit": "degC"},
    )
    relative_humidity: float | None = Field(
        None,
        ge=0,
        le=1,
        description=(
            "relative humidity in the compartment, 0 to 1; by default that of "
            "log.channels.cabin_humidity; without it dry air (ambient: as outside)"
        ),
        examples=[0.3],
        json_schema_extra={"unit": "1"},
    )
    sigma_pressure_hpa: float | None = Field(
        None,
        ge=0,
        le=300,
        description=(
            "standard deviation of the cabin's pressure; by default 3 hPa if it is logged or "
            "ambient"
        ),
        examples=[3.0],
        json_schema_extra={"unit": "hPa"},
    )
    sigma_temperature_k: float | None = Field(
        None,
        ge=0,
        le=50,
        description=(
            "standard deviation of the cabin's temperature; by default 1 K if a thermometer is "
            "logged, 6 K if it is on a circuit board"
        ),
        examples=[1.0],
        json_schema_extra={"unit": "K"},
    )

    # Checked after ``pressure``, whose value is known then, and also where it is not given.
    @field_validator("pressure_hpa")
    @classmethod
    def _one_pressure(cls, value: float | None, info: ValidationInfo) -> float | None:
        other = info.data.get("pressure")
        if value is None and other is None:
            raise SectionError("is missing: give it, or pressure: log or ambient")
        if value is not None and other is not None:
            raise SectionError("is the same as pressure: give one of them")
        return value

    def build(self) -> Cabin:
        """The air in the compartment, in SI units.

        A quantity that is logged or not stated is `UNKNOWN` (NaN), as is an ambient pressure.
        """
        pressure = self.pressure if self.pressure_hpa is None else self.pressure_hpa
        source: Literal["log", "ambient", "constant"] = "constant"
        if isinstance(pressure, str):
            source = pressure
            pressure_pa = UNKNOWN
        else:
            pressure_pa = _number_or_unknown(pressure) * HECTOPASCAL
        if isinstance(self.temperature_c, str):
            temperature_k = UNKNOWN
        else:
            temperature_k = _number_or_unknown(self.temperature_c) + ZERO_CELSIUS_K
        return Cabin(
            source,
            pressure_pa=pressure_pa,
            temperature_k=temperature_k,
            relative_humidity=_number_or_unknown(self.relative_humidity),
            sigma_pressure_pa=_number_or_unknown(self.sigma_pressure_hpa) * HECTOPASCAL,
            sigma_temperature_k=_number_or_unknown(self.sigma_temperature_k),
            temperature_logged=self.temperature_c == "log",
        )


def _number_or_unknown(value: float | None) -> float:
    """The number itself, or `UNKNOWN` (NaN) for None."""
    return UNKNOWN if value is None else value


UNSTATED_SIGMA_SHARE = 0.5
"""Standard deviation of a difference of air, as a share of it, if it is not stated."""

SHORTEST_NORMAL = 1e-6  # a shorter vector has no direction: `Window` refuses it

_KEY_OF_REFUSAL = {"WINDOW-AIR": "cabin", "WINDOW-NORMAL": "normal"}
"""The key that a refusal of `Window` is about."""


def unit_normal(value: list[float]) -> list[float]:
    """A normal scaled to length 1; zeros, which `Window` refuses, for a vector near zero."""
    length = float(np.linalg.norm(value))
    if length <= SHORTEST_NORMAL:
        return [0.0, 0.0, 0.0]
    return [component / length for component in value]


class WindowSection(Section):
    """The window of a pressurised compartment."""

    shape: Literal["plane", "spherical"] = Field(
        "plane",
        description=(
            "plane; or spherical: a dome around the projection centre, which does not bend rays"
        ),
        examples=["plane"],
    )
    cabin: Literal["log", "standard_schedule"] | CabinSection | None = Field(
        None,
        description=(
            "air behind the window. log: from the cabin channels of the log; standard_schedule: as "
            "outside up to 3 km, then 701.2 hPa, 21.1 degC (Gyer's Table 7); or {pressure, "
            "temperature_c}"
        ),
        examples=["log"],
    )
    frame: Literal["camera", "body"] = Field(
        "camera",
        description=(
            "frame of the normal: camera (x right, y down, z forward), or body, the aircraft's (x "
            "forward, y right, z down), for a camera that moves behind a fixed window. If the "
            "angles are those of the camera itself, body needs log.channels.aircraft_attitude; "
            "without it the direction follows from mount, as for a camera at rest"
        ),
        examples=["camera"],
    )
    normal: Vector = Field(
        default_factory=lambda: [0.0, 0.0, 1.0],
        description=(
            "direction out of the window; [0, 0, 1] is a window perpendicular to the optical axis "
            "in the camera frame, a window in the belly in the body frame"
        ),
        examples=[[0.0, 0.0, 1.0]],
        json_schema_extra={"unit": "1"},
    )
    in_calibration: Literal["none", "glass"] = Field(
        "none",
        description=(
            "glass: the camera was calibrated through the window. The displacement of rays by the "
            "glass is never modelled"
        ),
        examples=["none"],
    )

    @cached_property
    def window(self) -> Window:
        """The window and the air behind it, in SI units."""
        cabin: Cabin | None = None
        if isinstance(self.cabin, CabinSection):
            cabin = self.cabin.build()
        elif self.cabin is not None:
            cabin = Cabin(self.cabin)
        x, y, z = self.normal
        return Window(
            cabin,
            normal=(x, y, z),
            frame=self.frame,
            shape=self.shape,
            in_calibration=self.in_calibration,
        )

    @field_validator("normal")
    @classmethod
    def _unit_normal(cls, value: list[float]) -> list[float]:
        return unit_normal(value)

    @model_validator(mode="after")
    def _check_window(self) -> Self:
        try:
            window = self.window
        except PhysicsError as error:
            key = _KEY_OF_REFUSAL[error.code]
            raise SectionError(f"{error.what}; {error.remedy}", key=key) from None
        if window.shape == "plane":
            return self
        # Defaults are allowed though they are stated: the mission in a manifest states them all.
        states_frame = window.frame != "camera"
        states_normal = window.normal[2] != 1.0
        if states_frame and states_normal:
            raise SectionError("a spherical window has no frame and no normal")
        if states_frame:
            raise SectionError("a spherical window has no frame")
        if states_normal:
            raise SectionError("a spherical window has no normal")
        return self


class OpeningSection(Section):
    """An opening without glass, such as a hatch: its air differs from the air outside.

    The air in front of the lens bends rays as a plane window does. A lens in the skin of the
    aircraft is the same case. Friction warms the air there, and its pressure differs from the air
    around the aircraft.
    """

    warmer_k: float = Field(
        ge=-30,
        le=60,
        description="temperature of the air in front of the lens minus temperature outside",
        examples=[10.0],
        json_schema_extra={"unit": "K"},
    )
    pressure_excess_hpa: float = Field(
        0.0,
        ge=-100,
        le=100,
        description=(
            "pressure of the air in front of the lens minus pressure outside; negative on a "
            "fuselage"
        ),
        examples=[-3.0],
        json_schema_extra={"unit": "hPa"},
    )
    sigma_warmer_k: float | None = Field(
        None,
        ge=0,
        le=50,
        description="standard deviation of warmer_k; by default half of warmer_k",
        examples=[5.0],
        json_schema_extra={"unit": "K"},
    )
    sigma_pressure_excess_hpa: float | None = Field(
        None,
        ge=0,
        le=100,
        description=(
            "standard deviation of pressure_excess_hpa; by default half of pressure_excess_hpa"
        ),
        examples=[1.0],
        json_schema_extra={"unit": "hPa"},
    )
    frame: Literal["camera", "body"] = Field(
        "camera",
        description=(
            "frame of the normal: camera (x right, y down, z forward), or body, the aircraft's (x "
            "forward, y right, z down), for a camera that moves above a fixed opening (as of "
            "window)"
        ),
        examples=["camera"],
    )
    normal: Vector = Field(
        default_factory=lambda: [0.0, 0.0, 1.0],
        description=(
            "direction out of the opening; [0, 0, 1] is along the optical axis in the camera "
            "frame, an opening in the belly in the body frame"
        ),
        examples=[[0.0, 0.0, 1.0]],
        json_schema_extra={"unit": "1"},
    )

    @cached_property
    def opening(self) -> Window:
        """The opening as a window without glass, in SI units."""
        sigma_k = self.sigma_warmer_k
        if sigma_k is None:
            sigma_k = UNSTATED_SIGMA_SHARE * abs(self.warmer_k)
        sigma_hpa = self.sigma_pressure_excess_hpa
        if sigma_hpa is None:
            sigma_hpa = UNSTATED_SIGMA_SHARE * abs(self.pressure_excess_hpa)
        air = Cabin(
            "opening",
            warmer_k=self.warmer_k,
            excess_pa=self.pressure_excess_hpa * HECTOPASCAL,
            sigma_pressure_pa=sigma_hpa * HECTOPASCAL,
            sigma_temperature_k=sigma_k,
        )
        x, y, z = self.normal
        return Window(air, normal=(x, y, z), frame=self.frame)

    @field_validator("normal")
    @classmethod
    def _unit_normal(cls, value: list[float]) -> list[float]:
        return unit_normal(value)

    @model_validator(mode="after")
    def _check_opening(self) -> Self:
        try:
            self.opening  # noqa: B018
        except PhysicsError as error:
            raise SectionError(f"{error.what}; {error.remedy}", key="normal") from None
        return self
