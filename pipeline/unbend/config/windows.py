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
            "pressure in the compartment: log, as logged; ambient, not pressurised, as outside; or "
            "a constant"
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
            "temperature in the compartment: log, or a constant. Without it the log's, where it "
            "has one, else 21 degC: +- 5 K where the cabin is pressurised, +- 10 K where it is not"
        ),
        examples=[21.0],
        json_schema_extra={"unit": "degC"},
    )
    relative_humidity: float | None = Field(
        None,
        ge=0,
        le=1,
        description=(
            "relative humidity in the compartment, 0 to 1; without it the log's, else dry air "
            "(ambient: as outside)"
        ),
        examples=[0.3],
        json_schema_extra={"unit": "1"},
    )
    sigma_pressure_hpa: float | None = Field(
        None,
        ge=0,
        le=300,
        description=(
            "standard deviation of the cabin's pressure; without it 3 hPa where it is logged or "
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
            "standard deviation of the cabin's temperature; without it 1 K where a thermometer is "
            "logged"
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
        """The air in the compartment, in SI units."""
        pressure = self.pressure if self.pressure_hpa is None else self.pressure_hpa
        source: Literal["log", "ambient", "constant"] = "constant"
        if isinstance(pressure, str):
            source = pressure
            pressure_pa = UNKNOWN
        else:
            pressure_pa = _known(pressure) * HECTOPASCAL
        if isinstance(self.temperature_c, str):
            temperature_k = UNKNOWN
        else:
            temperature_k = _known(self.temperature_c) + ZERO_CELSIUS_K
        return Cabin(
            source,
            pressure_pa=pressure_pa,
            temperature_k=temperature_k,
            relative_humidity=_known(self.relative_humidity),
            sigma_pressure_pa=_known(self.sigma_pressure_hpa) * HECTOPASCAL,
            sigma_temperature_k=_known(self.sigma_temperature_k),
            temperature_logged=self.temperature_c == "log",
        )


def _known(value: float | None) -> float:
    """A number; NaN where the mission file has none."""
    return UNKNOWN if value is None else value


SHORTEST_NORMAL = 1e-6  # a shorter vector has no direction: `Window` refuses it

_KEY_OF_REFUSAL = {"WINDOW-AIR": "cabin", "WINDOW-NORMAL": "normal"}
"""The key that a refusal of `Window` is about."""


class WindowSection(Section):
    """The window of a pressurised compartment."""

    shape: Literal["plane", "spherical"] = Field(
        "plane",
        description="plane; or spherical: a dome about the projection centre, which bends nothing",
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
            "forward, y right, z down), for a camera that moves behind a fixed window"
        ),
        examples=["camera"],
    )
    normal: Vector = Field(
        default_factory=lambda: [0.0, 0.0, 1.0],
        description=(
            "direction out of the window; [0, 0, 1] is square to the optical axis in the camera "
            "frame, a window in the belly in the body frame"
        ),
        examples=[[0.0, 0.0, 1.0]],
        json_schema_extra={"unit": "1"},
    )
    in_calibration: Literal["none", "glass"] = Field(
        "none",
        description=(
            "glass: the camera was calibrated through the window. The glass displaces rays, which "
            "is never modelled"
        ),
        examples=["none"],
    )

    @cached_property
    def window(self) -> Window:
        """The window, with cabin air in SI."""
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
        """The normal of length 1; zeros, which `Window` refuses, for one without a direction."""
        length = float(np.linalg.norm(value))
        if length <= SHORTEST_NORMAL:
            return [0.0, 0.0, 0.0]
        return [component / length for component in value]

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
        if window.frame != "camera" and window.normal[2] != 1.0:
            raise SectionError("a spherical window has no frame and no normal")
        if window.frame != "camera":
            raise SectionError("a spherical window has no frame")
        if window.normal[2] != 1.0:
            raise SectionError("a spherical window has no normal")
        return self
