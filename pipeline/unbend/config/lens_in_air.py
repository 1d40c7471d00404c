"""The sections of a mission file on the air in a lens."""

from typing import Self

from pydantic import (
    Field,
    model_validator,
)

from unbend.config.section import (
    Section,
    SectionError,
)
from unbend.refraction import LensInAir
from unbend.refraction.lens_air import AnyLens, TypicalLens
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K


class LensReference(Section):
    """The air in the lens when the camera was calibrated."""

    pressure_hpa: float = Field(
        ge=100,
        le=1200,
        description="air pressure during the calibration",
        examples=[1013.25],
        json_schema_extra={"unit": "hPa"},
    )
    temperature_c: float = Field(
        ge=-60,
        le=60,
        description="temperature during the calibration",
        examples=[20.0],
        json_schema_extra={"unit": "degC"},
    )


class LensSection(Section):
    """The air in the lens during the calibration, and how the principal distance follows it.

    With the air of the calibration alone, the change is that of a typical lens. In pixels:
    derivatives in millimetres are divided by the pixel pitch in millimetres."""

    reference: LensReference = Field(
        description="{pressure_hpa, temperature_c} of the air in the lens during the calibration",
    )
    dc_dp_px_per_hpa: float | None = Field(
        None,
        ge=-10,
        le=10,
        description=(
            "change of the principal distance with the pressure of the air in the lens; without it "
            "that of a typical lens, 2.0 +- 0.5 of the change of n"
        ),
        examples=[0.0084],
        json_schema_extra={"unit": "px/hPa"},
    )
    dc_dt_px_per_k: float | None = Field(
        None,
        ge=-10,
        le=10,
        description=(
            "change of the principal distance with the temperature of the lens; without it "
            "that of a typical lens, 2.0 +- 0.5 of the change of n"
        ),
        examples=[0.004],
        json_schema_extra={"unit": "px/K"},
    )

    @model_validator(mode="after")
    def _check_derivatives(self) -> Self:
        if (self.dc_dp_px_per_hpa is None) != (self.dc_dt_px_per_k is None):
            raise SectionError(
                "give both dc_dp_px_per_hpa and dc_dt_px_per_k, or none of them for a typical lens"
            )
        return self

    def build(self, principal_distance_px: float) -> AnyLens:
        """The model of a lens with this principal distance, in Pa and K.

        Without derivatives it is that of a typical lens.
        """
        pressure_pa = self.reference.pressure_hpa * HECTOPASCAL
        temperature_k = self.reference.temperature_c + ZERO_CELSIUS_K
        if self.dc_dp_px_per_hpa is None or self.dc_dt_px_per_k is None:
            return TypicalLens(principal_distance_px, pressure_pa, temperature_k)
        return LensInAir(
            principal_distance_px,
            reference_pressure_pa=pressure_pa,
            reference_temperature_k=temperature_k,
            px_per_pa=self.dc_dp_px_per_hpa / HECTOPASCAL,
            px_per_k=self.dc_dt_px_per_k,
        )
