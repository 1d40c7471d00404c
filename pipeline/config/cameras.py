"""The sections of a mission file on a camera: window, air in the lens, and mount."""

from collections.abc import Callable, Collection
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from pipeline.errors import PhysicsError
from pipeline.flight.mount import Mount
from pipeline.refraction import Cabin, LensInAir, Window
from pipeline.refraction.window import UNKNOWN
from pipeline.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
LeverArm = Annotated[
    list[Annotated[float, Field(ge=-100, le=100)]], Field(min_length=3, max_length=3)
]


def one_of(names: Callable[[], Collection[str]]) -> AfterValidator:
    """The check that a value is one of those that are registered when it is read."""

    def check(value: str) -> str:
        if value not in names():
            raise ValueError(f"is none of {', '.join(names())}")
        return value

    return AfterValidator(check)


class Section(BaseModel):
    """A part of the mission file: strict types, no unknown keys, no NaN."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )


Hectopascal = Annotated[float, Field(ge=100, le=1200)]
Celsius = Annotated[float, Field(ge=-60, le=60)]


class CabinAir(Section):
    """The air in the compartment, quantity by quantity."""

    pressure: Literal["log", "ambient"] | Hectopascal | None = None
    pressure_hpa: Hectopascal | None = Field(None, validate_default=True)
    temperature_c: Literal["log"] | Celsius | None = None
    relative_humidity: float | None = Field(None, ge=0, le=1)
    sigma_pressure_hpa: float | None = Field(None, ge=0, le=300)
    sigma_temperature_k: float | None = Field(None, ge=0, le=50)

    @field_validator("pressure_hpa")
    @classmethod
    def _one_pressure(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is None and info.data.get("pressure") is None:
            raise ValueError("is missing: give it, or pressure: log or ambient")
        if value is not None and info.data.get("pressure") is not None:
            raise ValueError("is the same as pressure: give one of them")
        return value

    def build(self) -> Cabin:
        """In SI."""
        given = self.pressure if self.pressure_hpa is None else self.pressure_hpa
        celsius = self.temperature_c
        logged = celsius == "log"

        def si(value: float | None, unit: float = 1.0) -> float:
            return UNKNOWN if value is None else value * unit

        return Cabin(
            given if isinstance(given, str) else "constant",
            UNKNOWN if isinstance(given, str) else si(given, HECTOPASCAL),
            UNKNOWN if isinstance(celsius, str) else si(celsius) + ZERO_CELSIUS_K,
            si(self.relative_humidity),
            si(self.sigma_pressure_hpa, HECTOPASCAL),
            si(self.sigma_temperature_k),
            temperature_logged=logged,
        )


def _checked_window(*given: Any) -> Window:
    """A window, its refusal as pydantic expects it."""
    try:
        return Window(*given)
    except PhysicsError as error:
        raise ValueError(f"{error.what}; {error.remedy}") from None


class WindowSection(Section):
    """The window of a pressurised compartment."""

    shape: Literal["plane", "spherical"] = "plane"
    cabin: Literal["log", "standard_schedule"] | CabinAir | None = Field(
        None, validate_default=True
    )
    frame: Literal["camera", "body"] = "camera"
    normal: Vector = Field(default_factory=lambda: [0.0, 0.0, 1.0])
    in_calibration: Literal["none", "glass"] = "none"

    def build(self) -> Window:
        """The window, with cabin air in SI."""
        x, y, z = self.normal
        cabin = self.cabin.build() if isinstance(self.cabin, CabinAir) else self.cabin
        cabin = Cabin(cabin) if isinstance(cabin, str) else cabin
        return Window(cabin, (x, y, z), self.frame, self.shape, self.in_calibration)

    @field_validator("cabin")
    @classmethod
    def _require_cabin(cls, value: object, info: ValidationInfo) -> object:
        if value is None:
            _checked_window(None, (0.0, 0.0, 1.0), "camera", info.data.get("shape", "plane"))
        return value

    @field_validator("normal")
    @classmethod
    def _unit_normal(cls, value: list[float], info: ValidationInfo) -> list[float]:
        length = float(np.linalg.norm(value))
        unit = [component / length for component in value] if length > 1e-6 else [0.0, 0.0, 0.0]
        _checked_window(None, tuple(unit), info.data.get("frame", "camera"), "spherical")
        return unit

    @model_validator(mode="after")
    def _check_spherical(self) -> Self:
        # By their values: the manifest of a run states the defaults too.
        given = ["frame"] * (self.frame != "camera") + ["normal"] * (self.normal[2] != 1.0)
        if self.shape == "spherical" and given:
            raise ValueError(f"a spherical window has no {' and no '.join(given)}")
        return self


class LensReference(Section):
    """The air in the lens when the camera was calibrated."""

    pressure_hpa: float = Field(ge=100, le=1200)
    temperature_c: float = Field(ge=-60, le=60)


class LensSection(Section):
    """How the principal distance follows the air in the lens.

    In pixels: derivatives in millimetres are divided by the pixel pitch in millimetres."""

    reference: LensReference
    dc_dp_px_per_hpa: float = Field(ge=-10, le=10)
    dc_dt_px_per_k: float = Field(ge=-10, le=10)

    def build(self, principal_distance_px: float) -> LensInAir:
        """In Pa and K."""
        return LensInAir(
            principal_distance_px,
            self.reference.pressure_hpa * HECTOPASCAL,
            self.reference.temperature_c + ZERO_CELSIUS_K,
            self.dc_dp_px_per_hpa / HECTOPASCAL,
            self.dc_dt_px_per_k,
        )


class MountSection(Section):
    """How a camera sits in the aircraft (body frame: x forward, y right, z down).

    With all angles zero it looks straight down, the top of the image towards the nose; yaw, pitch
    and roll then turn it about the body's axes, in that order (intrinsic z-y-x). Composed are the
    attitude of the aircraft, the angles of a gimbal that plays the attitude, and these (boresight):
    v_ned = R(aircraft) R(gimbal) R(mount) v_camera, where a gimbal that is level to the horizon
    takes of the aircraft its yaw alone, and one whose yaw counts from north takes nothing."""

    attitude: str | None = None
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    lever_arm_m: LeverArm = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    sigma_tilt_deg: float | None = Field(None, ge=0, le=45)
    sigma_yaw_deg: float | None = Field(None, ge=0, le=180)

    @model_validator(mode="after")
    def _check_sigmas(self) -> Self:
        if self.sigma_yaw_deg is not None and self.sigma_tilt_deg is None:
            raise ValueError("sigma_yaw_deg needs sigma_tilt_deg beside it")
        return self

    def build(self) -> Mount:
        """In radians."""
        x, y, z = self.lever_arm_m
        tilt = self.sigma_tilt_deg
        yaw = tilt if self.sigma_yaw_deg is None else self.sigma_yaw_deg
        return Mount(
            self.roll_deg * DEGREE,
            self.pitch_deg * DEGREE,
            self.yaw_deg * DEGREE,
            (x, y, z),
            sigma_tilt_rad=None if tilt is None else tilt * DEGREE,
            sigma_yaw_rad=None if yaw is None else yaw * DEGREE,
        )
