"""The sections of a mission file on the air: standard, climatology, other sources, sensors."""

import math
from datetime import UTC, datetime
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from unbend.atmosphere import standard_names
from unbend.atmosphere.estimate.sensors import SensorCalibration
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.standard import known_names
from unbend.config.cameras import PathText, Section, mistake, one_of
from unbend.units import HECTOPASCAL, NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K


class SoundingSection(Section):
    """A balloon sounding near the flight."""

    path: PathText
    format: Literal["auto", "igra", "igra_derived", "wyoming_csv", "wyoming_list", "csv"] = "auto"
    station_h_msl_m: float | None = Field(None, ge=-500, le=6000)
    across_coast_or_ridge: bool = False


class WeatherModelSection(Section):
    """Fields of a weather model around the flight."""

    path: PathText
    member: int | None = Field(None, ge=0)


class SurfaceSection(Section):
    """The air at a weather station: a METAR, or numbers."""

    h_msl_m: float = Field(ge=-500, le=6000)
    metar: str | None = Field(None, min_length=1)
    temperature_c: float | None = None
    pressure_hpa: float | None = Field(None, gt=0)
    relative_humidity: float | None = None
    distance_km: float = Field(0.0, ge=0, le=2000)
    across_coast_or_ridge: bool = False
    time_utc: str | None = None

    @field_validator("time_utc")
    @classmethod
    def _check_time(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                datetime.fromisoformat(value)
            except ValueError:
                raise ValueError("is no time like 2026-05-14T10:20:00Z") from None
        return value

    @model_validator(mode="after")
    def _check_metar_or_numbers(self) -> Self:
        numbers = (self.temperature_c, self.pressure_hpa, self.relative_humidity, self.time_utc)
        given = [value for value in numbers if value is not None]
        if (self.metar is None) != bool(given):
            raise mistake("metar-or-numbers")
        if self.relative_humidity is not None and self.temperature_c is None:
            raise ValueError("relative_humidity needs temperature_c")
        return self

    @property
    def temperature_k(self) -> float:
        """[K], NaN where not given."""
        return math.nan if self.temperature_c is None else self.temperature_c + ZERO_CELSIUS_K

    @property
    def pressure_pa(self) -> float:
        """[Pa], NaN where not given."""
        return math.nan if self.pressure_hpa is None else self.pressure_hpa * HECTOPASCAL

    @property
    def humidity(self) -> float:
        """0 to 1, NaN where not given."""
        return math.nan if self.relative_humidity is None else self.relative_humidity

    @property
    def time_ns(self) -> int | None:
        """[Unix ns]; without an offset the time is UTC."""
        if self.time_utc is None:
            return None
        time = datetime.fromisoformat(self.time_utc)
        time = time.replace(tzinfo=UTC) if time.tzinfo is None else time
        return round(time.timestamp()) * NANOSECONDS_PER_SECOND


class ThermometerSection(Section):
    """Known errors of the thermometer outside: reading minus air."""

    bias_k: float | None = Field(None, ge=-30, le=30)
    sigma_bias_k: float | None = Field(None, ge=0.01, le=30)
    lag_s: float | None = Field(None, ge=0, le=90)
    sigma_lag_s: float | None = Field(None, ge=0.1, le=90)
    transient_k: float | None = Field(None, ge=-30, le=30)
    sigma_transient_k: float | None = Field(None, ge=0.01, le=30)
    recovery: float | None = Field(None, ge=0, le=1.1)
    sigma_recovery: float | None = Field(None, ge=0.005, le=1)
    sigma_drift_k: float | None = Field(None, ge=0.01, le=30)


class BarometerSection(Section):
    """Known errors of the static pressure: reading minus air."""

    offset_hpa: float | None = Field(None, ge=-30, le=30)
    sigma_offset_hpa: float | None = Field(None, ge=0.01, le=30)
    sigma_scale: float | None = Field(None, ge=1e-5, le=0.1)


class HygrometerSection(Section):
    """Known errors of the hygrometer: reading minus air, as relative humidity 0 to 1."""

    bias: float | None = Field(None, ge=-0.5, le=0.5)
    sigma_bias: float | None = Field(None, ge=0.001, le=0.5)


class GnssSection(Section):
    """How well GNSS heights above sea level are known."""

    sigma_height_m: float | None = Field(None, ge=0.01, le=100)


_CALIBRATED = {
    SensorFault.THERMOMETER_BIAS: ("thermometer", "bias_k"),
    SensorFault.THERMOMETER_LAG: ("thermometer", "lag_s"),
    SensorFault.TAKEOFF_TRANSIENT: ("thermometer", "transient_k"),
    SensorFault.RECOVERY_FACTOR: ("thermometer", "recovery"),
    SensorFault.THERMOMETER_DRIFT: ("thermometer", "drift_k"),
    SensorFault.PRESSURE_OFFSET: ("barometer", "offset_hpa"),
    SensorFault.PRESSURE_SCALE: ("barometer", "scale"),
    SensorFault.HYGROMETER_BIAS: ("hygrometer", "bias"),
    SensorFault.GNSS_HEIGHT_OFFSET: ("gnss", "height_m"),
}
"""Section and key of a fault's value, and of its sigma behind ``sigma_``."""


class SensorsSection(Section):
    """Calibrations of the sensors; what is not given has its default sigma."""

    thermometer: ThermometerSection = ThermometerSection()
    barometer: BarometerSection = BarometerSection()
    hygrometer: HygrometerSection = HygrometerSection()
    gnss: GnssSection = GnssSection()

    @property
    def calibration(self) -> dict[SensorFault, SensorCalibration]:
        """By sensor fault, in SI."""
        stated = {}
        for fault, (sensor, key) in _CALIBRATED.items():
            section = getattr(self, sensor)
            unit = HECTOPASCAL if key.endswith("_hpa") else 1.0
            values = getattr(section, key, None), getattr(section, f"sigma_{key}")
            mean, sigma = (None if value is None else unit * value for value in values)
            if mean is not None or sigma is not None:
                path = f"atmosphere.sensors.{sensor}.{key if mean is not None else f'sigma_{key}'}"
                stated[fault] = SensorCalibration(mean, sigma, path=path)
        return stated


class AtmosphereSection(Section):
    """The air."""

    standard: Annotated[str, one_of(standard_names)] = "us1976"
    adjust: bool = True
    climatology: Annotated[str, one_of(known_names)] = "auto"
    soundings: list[SoundingSection] = Field([])
    surface: list[SurfaceSection] = Field([])
    model: WeatherModelSection | None = None
    board_temperature: bool = False
    sensors: SensorsSection = SensorsSection()
    index: Literal["ciddor", "gyer"] = "ciddor"
    wavelength_m: float = Field(0.55e-6, ge=0.3e-6, le=1.7e-6)
    co2_ppm: float = Field(450.0, ge=0, le=2000)
