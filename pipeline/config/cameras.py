"""What a mission file may say of a camera: its calibration, window and mount."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from pipeline.flight.exposures import Mount
from pipeline.refraction import Cabin, Camera
from pipeline.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K

PrincipalDistance = Annotated[float, Field(ge=10, le=1e6)]
Coefficient = Annotated[float, Field(ge=-10, le=10)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
LeverArm = Annotated[
    list[Annotated[float, Field(ge=-100, le=100)]], Field(min_length=3, max_length=3)
]


class Section(BaseModel):
    """A part of the mission file: strict types, no unknown keys, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def offset_px(pixel_origin: str) -> float:
    """COLMAP's pixel minus one counted from ``pixel_origin``."""
    return 0.5 if pixel_origin == "centre" else 0.0


class DistortionSection(Section):
    """Brown-Conrady coefficients as OpenCV defines them."""

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0


class CabinAir(Section):
    """Constant air in the compartment."""

    pressure_hpa: float = Field(ge=100, le=1200)
    temperature_c: float = Field(ge=-60, le=60)
    relative_humidity: float = Field(0.0, ge=0, le=1)


class WindowSection(Section):
    """The window of a pressurised compartment."""

    cabin: Literal["log"] | CabinAir = Field(
        description="log: from the cabin channels of the log; or constant values"
    )
    normal: Vector = Field(
        default_factory=lambda: [0.0, 0.0, 1.0],
        description="direction of the window in the camera frame (x right, y down, z forward)",
    )

    def air(self) -> Cabin:
        """The air inside, in SI, or that it is in the log."""
        if isinstance(self.cabin, str):
            return Cabin(logged=True)
        return Cabin(
            pressure_pa=self.cabin.pressure_hpa * HECTOPASCAL,
            temperature_k=self.cabin.temperature_c + ZERO_CELSIUS_K,
            relative_humidity=self.cabin.relative_humidity,
        )

    @field_validator("normal")
    @classmethod
    def _points_outside(cls, value: list[float]) -> list[float]:
        length = float(np.linalg.norm(value))
        if not length > 0.0 or value[2] <= 0.0:
            raise ValueError("must point out of the compartment: a positive third component")
        return [component / length for component in value]


class CameraSection(Section):
    """Interior orientation of one camera."""

    width_px: int = Field(gt=0, le=1_000_000)
    height_px: int = Field(gt=0, le=1_000_000)
    f_px: PrincipalDistance | None = None
    fx_px: PrincipalDistance | None = None
    fy_px: PrincipalDistance | None = None
    cx_px: float = Field(ge=-1e6, le=1e6)
    cy_px: float = Field(ge=-1e6, le=1e6)
    pixel_origin: Literal["corner", "centre"] | None = Field(
        None, description="of the principal point; by default that of the observations"
    )
    distortion: DistortionSection = DistortionSection()
    calibration: Literal["laboratory", "in_flight_uncorrected", "in_flight_corrected"] = Field(
        description="how it was calibrated. A calibration estimated in flight on uncorrected "
        "images already contains the nadir refraction of that height"
    )
    window: WindowSection | None = None

    @model_validator(mode="after")
    def _one_principal_distance(self) -> CameraSection:
        both = self.fx_px is not None and self.fy_px is not None
        neither = self.fx_px is None and self.fy_px is None
        if (self.f_px is not None) == both or not (both or neither):
            raise ValueError("give f_px, or both fx_px and fy_px")
        return self

    def build(self, pixel_origin: str = "corner") -> Camera:
        """The camera in COLMAP's pixels; ``pixel_origin`` where it names none itself."""
        offset = offset_px(self.pixel_origin or pixel_origin)
        return Camera(
            self.width_px,
            self.height_px,
            self.f_px or self.fx_px or 0.0,
            self.f_px or self.fy_px or 0.0,
            self.cx_px + offset,
            self.cy_px + offset,
            **self.distortion.model_dump(),
        )


class MountSection(Section):
    """How a camera sits in the aircraft (body frame: x forward, y right, z down).

    With all angles zero it looks straight down, the top of the image towards the nose; yaw, pitch
    and roll then turn it about the body's axes, in that order (intrinsic z-y-x)."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    lever_arm_m: LeverArm = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="projection centre minus the point whose position the log gives (horizontally "
        "the filter's, in height the GNSS antenna's), in the body frame",
    )

    def build(self) -> Mount:
        """In radians."""
        x, y, z = self.lever_arm_m
        return Mount(
            self.roll_deg * DEGREE, self.pitch_deg * DEGREE, self.yaw_deg * DEGREE, (x, y, z)
        )
