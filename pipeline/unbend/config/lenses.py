"""The sections of a mission file on the air in a lens."""

from pydantic import (
    Field,
)

from unbend.config.section import (
    Section,
)
from unbend.refraction import LensInAir
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
    """How the principal distance follows the air in the lens.

    In pixels: derivatives in millimetres are divided by the pixel pitch in millimetres."""

    reference: LensReference = Field(
        description="{pressure_hpa, temperature_c} of the air in the lens during the calibration",
    )
    dc_dp_px_per_hpa: float = Field(
        ge=-10,
        le=10,
        description="change of the principal distance with the pressure of the air in the lens",
        examples=[0.0084],
        json_schema_extra={"unit": "px/hPa"},
    )
    dc_dt_px_per_k: float = Field(
        ge=-10,
        le=10,
        description="change of the principal distance with the temperature of the lens",
        examples=[0.004],
        json_schema_extra={"unit": "px/K"},
    )

    def build(self, principal_distance_px: float) -> LensInAir:
        """The air in a lens with this principal distance, in Pa and K."""
        return LensInAir(
            principal_distance_px,
            reference_pressure_pa=self.reference.pressure_hpa * HECTOPASCAL,
            reference_temperature_k=self.reference.temperature_c + ZERO_CELSIUS_K,
            px_per_pa=self.dc_dp_px_per_hpa / HECTOPASCAL,
            px_per_k=self.dc_dt_px_per_k,
        )
