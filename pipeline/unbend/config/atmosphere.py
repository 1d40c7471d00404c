"""The sections of a mission file on the air: standard, climatology, other sources, sensors."""

import math
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from unbend.atmosphere import standard_names
from unbend.atmosphere.estimate.sensors import SensorCalibration
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.refractive_index import DEFAULT_CO2_PPM, DEFAULT_WAVELENGTH_M
from unbend.atmosphere.soundings.formats import FORMATS
from unbend.atmosphere.standard import known_names
from unbend.config.dates import StatedTime, nanoseconds_of_time
from unbend.config.section import PathText, Section, SectionError, one_of
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K


class SoundingSection(Section):
    """A balloon sounding near the flight."""

    path: PathText = Field(
        description=(
            "the sounding: IGRA v2, University of Wyoming list or CSV, ARM netCDF, or a CSV with "
            "columns like h_m, pressure_hpa, temperature_c, dew_point_c"
        ),
        examples=["sounding.csv"],
    )
    format: Literal[("auto", *FORMATS)] = Field(  # type: ignore[valid-type]
        "auto",
        description="format of the file; auto: by its content",
        examples=["auto"],
    )
    station_h_msl_m: float | None = Field(
        None,
        ge=-500,
        le=6000,
        description="height of the station above sea level, if the file has no heights",
        examples=[491.0],
        json_schema_extra={"unit": "m"},
    )
    across_coast_or_ridge: bool = Field(
        default=False,
        description=(
            "whether a coast or a ridge is between the sounding and the flight: its distance then "
            "counts twice"
        ),
        examples=[True],
    )


class WeatherModelSection(Section):
    """Fields of a weather model around the flight."""

    path: PathText = Field(
        description=(
            "ERA5 or GFS on pressure levels, or ERA5 on model levels, as netCDF or GRIB (extra "
            "nwp); unbend inspect shows its content"
        ),
        examples=["era5.nc"],
    )
    member: int | None = Field(
        None,
        ge=0,
        description="number of the member, if the file is an ensemble",
        examples=[0],
        json_schema_extra={"unit": "1"},
    )


class SurfaceSection(Section):
    """The air at a weather station: a METAR, or numbers."""

    h_msl_m: float = Field(
        ge=-500,
        le=6000,
        description="height of the station above sea level",
        examples=[432.0],
        json_schema_extra={"unit": "m"},
    )
    metar: str | None = Field(
        None,
        min_length=1,
        description="the report as it was issued",
        examples=["LSZH 141020Z 24008KT CAVOK 18/07 Q1016"],
    )
    temperature_c: float | None = Field(
        None,
        description="air temperature at the station",
        examples=[18.0],
        json_schema_extra={"unit": "degC"},
    )
    pressure_hpa: float | None = Field(
        None,
        gt=0,
        description="pressure at the station, not reduced to sea level",
        examples=[966.2],
        json_schema_extra={"unit": "hPa"},
    )
    relative_humidity: float | None = Field(
        None,
        description="relative humidity at the station, 0 to 1; needs temperature_c",
        examples=[0.5],
        json_schema_extra={"unit": "1"},
    )
    distance_km: float | None = Field(
        None,
        ge=0,
        le=2000,
        description=(
            "distance of the station from the middle of the flight, 100 km if it is not stated; "
            "with the distance the sigmas of the report grow"
        ),
        examples=[12.0],
        json_schema_extra={"unit": "km"},
    )
    across_coast_or_ridge: bool = Field(
        default=False,
        description=(
            "whether a coast or a ridge is between the station and the flight: its distance then "
            "counts twice"
        ),
        examples=[True],
    )
    time_utc: StatedTime | None = Field(
        None,
        description="UTC time of the report, as 2026-05-14T10:20:00Z",
        examples=["2026-05-14T10:20:00Z"],
    )

    @model_validator(mode="after")
    def _check_metar_or_numbers(self) -> Self:
        numbers = (self.temperature_c, self.pressure_hpa, self.relative_humidity, self.time_utc)
        has_numbers = any(value is not None for value in numbers)
        has_metar = self.metar is not None
        if has_metar == has_numbers:
            raise SectionError(
                "give either metar, or temperature_c, pressure_hpa, relative_humidity and time_utc"
            )
        if self.relative_humidity is not None and self.temperature_c is None:
            raise SectionError("relative_humidity needs temperature_c")
        return self

    @property
    def temperature_k(self) -> float:
        """The air temperature [K], NaN where not given."""
        return math.nan if self.temperature_c is None else self.temperature_c + ZERO_CELSIUS_K

    @property
    def pressure_pa(self) -> float:
        """The pressure at the station [Pa], NaN where not given."""
        return math.nan if self.pressure_hpa is None else self.pressure_hpa * HECTOPASCAL

    @property
    def humidity(self) -> float:
        """The relative humidity, 0 to 1, NaN where not given."""
        return math.nan if self.relative_humidity is None else self.relative_humidity

    @property
    def time_ns(self) -> int | None:
        """The time of the report [Unix ns], None where not given; UTC if it has no offset."""
        return None if self.time_utc is None else nanoseconds_of_time(self.time_utc)


class ThermometerSection(Section):
    """Known errors of the thermometer outside: reading minus air."""

    bias_k: float | None = Field(
        None,
        ge=-30,
        le=30,
        description="known bias, reading minus air; it is subtracted",
        examples=[0.3],
        json_schema_extra={"unit": "K"},
    )
    sigma_bias_k: float | None = Field(
        None,
        ge=0.01,
        le=30,
        description="its standard deviation; by default 3 K",
        examples=[0.1],
        json_schema_extra={"unit": "K"},
    )
    lag_s: float | None = Field(
        None,
        ge=0,
        le=90,
        description="time constant of the thermometer in this airflow; by default 12 s",
        examples=[4.0],
        json_schema_extra={"unit": "s"},
    )
    sigma_lag_s: float | None = Field(
        None,
        ge=0.1,
        le=90,
        description="standard deviation of the lag; by default 10 s, of a lag of 12 s",
        examples=[1.0],
        json_schema_extra={"unit": "s"},
    )
    transient_k: float | None = Field(
        None,
        ge=-30,
        le=30,
        description=(
            "error of the thermometer at take-off from the heat of the ground, reading minus air; "
            "it decays with a time constant of about a minute"
        ),
        examples=[0.0],
        json_schema_extra={"unit": "K"},
    )
    sigma_transient_k: float | None = Field(
        None,
        ge=0.01,
        le=30,
        description="its standard deviation; by default 5 K",
        examples=[0.5],
        json_schema_extra={"unit": "K"},
    )
    recovery: float | None = Field(
        None,
        ge=0,
        le=1.1,
        description="recovery factor: the part of the ram rise that the thermometer shows",
        examples=[0.8],
        json_schema_extra={"unit": "1"},
    )
    sigma_recovery: float | None = Field(
        None,
        ge=0.005,
        le=1,
        description="its standard deviation; by default 0.3, of 0.7",
        examples=[0.05],
        json_schema_extra={"unit": "1"},
    )
    sigma_drift_k: float | None = Field(
        None,
        ge=0.01,
        le=30,
        description=(
            "standard deviation of its drift within a quarter of an hour; by default 0.4 K, and 5 "
            "K on a circuit board"
        ),
        examples=[0.1],
        json_schema_extra={"unit": "K"},
    )


class BarometerSection(Section):
    """Known errors of the static pressure: reading minus air."""

    offset_hpa: float | None = Field(
        None,
        ge=-30,
        le=30,
        description="known offset of the static pressure, reading minus air; it is subtracted",
        examples=[-0.2],
        json_schema_extra={"unit": "hPa"},
    )
    sigma_offset_hpa: float | None = Field(
        None,
        ge=0.01,
        le=30,
        description="its standard deviation; by default 0.5 hPa",
        examples=[0.1],
        json_schema_extra={"unit": "hPa"},
    )
    sigma_scale: float | None = Field(
        None,
        ge=1e-5,
        le=0.1,
        description=(
            "standard deviation of the part of the change with height that the static pressure "
            "does not show; by default 0.001, and 0.03 for one sensor in ten"
        ),
        examples=[0.0005],
        json_schema_extra={"unit": "1"},
    )


class HygrometerSection(Section):
    """Known errors of the hygrometer: reading minus air, as relative humidity 0 to 1."""

    bias: float | None = Field(
        None,
        ge=-0.5,
        le=0.5,
        description=(
            "known bias of the relative humidity (0 to 1), reading minus air; it is subtracted"
        ),
        examples=[0.01],
        json_schema_extra={"unit": "1"},
    )
    sigma_bias: float | None = Field(
        None,
        ge=0.001,
        le=0.5,
        description="its standard deviation; by default 0.03",
        examples=[0.01],
        json_schema_extra={"unit": "1"},
    )


class GnssSection(Section):
    """How well GNSS heights above sea level are known."""

    sigma_height_m: float | None = Field(
        None,
        ge=0.01,
        le=100,
        description=(
            "standard deviation of the offset that all GNSS heights above sea level share; by "
            "default 2.5 m"
        ),
        examples=[0.1],
        json_schema_extra={"unit": "m"},
    )


class CalibrationKey(NamedTuple):
    """Where the mission file states a fault of a sensor, and in which unit."""

    sensor: str  # section under ``atmosphere.sensors``
    key: str  # of the value; the key of its standard deviation is the same with ``sigma_`` before
    si_per_unit: float = 1.0  # of both keys


CALIBRATION_KEYS = {
    SensorFault.THERMOMETER_BIAS: CalibrationKey("thermometer", "bias_k"),
    SensorFault.THERMOMETER_LAG: CalibrationKey("thermometer", "lag_s"),
    SensorFault.TAKEOFF_TRANSIENT: CalibrationKey("thermometer", "transient_k"),
    SensorFault.RECOVERY_FACTOR: CalibrationKey("thermometer", "recovery"),
    SensorFault.THERMOMETER_DRIFT: CalibrationKey("thermometer", "drift_k"),
    SensorFault.PRESSURE_OFFSET: CalibrationKey("barometer", "offset_hpa", HECTOPASCAL),
    SensorFault.PRESSURE_SCALE: CalibrationKey("barometer", "scale"),
    SensorFault.HYGROMETER_BIAS: CalibrationKey("hygrometer", "bias"),
    SensorFault.GNSS_HEIGHT_OFFSET: CalibrationKey("gnss", "height_m"),
}


class SensorsSection(Section):
    """Calibrations of the sensors; what is not given has its default sigma."""

    thermometer: ThermometerSection = Field(
        ThermometerSection(),
        description="known errors of the thermometer outside",
    )
    barometer: BarometerSection = Field(
        BarometerSection(),
        description="known errors of the static pressure",
    )
    hygrometer: HygrometerSection = Field(
        HygrometerSection(),
        description="known errors of the hygrometer",
    )
    gnss: GnssSection = Field(
        GnssSection(),
        description="how well GNSS heights above sea level are known",
    )

    @property
    def calibration(self) -> dict[SensorFault, SensorCalibration]:
        """The stated calibrations in SI units, by sensor fault; faults without any are left out."""
        calibrations = {}
        for fault, (sensor, key, si_per_unit) in CALIBRATION_KEYS.items():
            section = getattr(self, sensor)
            mean = getattr(section, key, None)  # some faults have only a key of the sigma
            sigma = getattr(section, f"sigma_{key}")
            if mean is None and sigma is None:
                continue
            stated_key = key if mean is not None else f"sigma_{key}"
            calibrations[fault] = SensorCalibration(
                None if mean is None else si_per_unit * mean,
                None if sigma is None else si_per_unit * sigma,
                path=f"atmosphere.sensors.{sensor}.{stated_key}",
            )
        return calibrations


class AtmosphereSection(Section):
    """The air."""

    standard: Annotated[str, one_of(standard_names)] = Field(
        "us1976",
        description=(
            "standard atmosphere that the results show next to the air of the flight: us1976, "
            "us1962, icao, ican, ardc1959, or one of the US Supplements 1966; a wrong name lists "
            "all names"
        ),
        examples=["us1976"],
    )
    adjust: bool = Field(
        default=True,
        description="false: the standard atmosphere is used without a change",
        examples=[True],
    )
    climatology: Annotated[str, one_of(known_names)] = Field(
        "auto",
        description=(
            "expected air where nothing was measured: auto (US Supplements 1966 by latitude and "
            "season), or a name; a wrong name lists all names"
        ),
        examples=["auto"],
    )
    soundings: list[SoundingSection] = Field(
        [],
        description="balloon soundings near the flight; their weight depends on age and distance",
    )
    surface: list[SurfaceSection] = Field(
        [],
        description="reports of weather stations near the flight",
    )
    model: WeatherModelSection | None = Field(
        None,
        description=(
            "fields of a weather model around the flight: its column is a source like a sounding; "
            "in flights longer than 30 km or two hours, the air changes along the flight as in the "
            "model"
        ),
    )
    board_temperature: bool = Field(
        default=False,
        description=(
            "true: the temperature of a circuit board, named under log.channels.temperature, is "
            "used as air temperature plus an unknown, drifting offset of about 10 K"
        ),
        examples=[False],
    )
    sensors: SensorsSection = Field(
        SensorsSection(),
        description=(
            "known errors of the sensors, from their calibration; errors that are not given have "
            "their default sigma"
        ),
    )
    index: Literal["ciddor", "gyer"] = Field(
        "ciddor",
        description="formula of the refractive index: Ciddor 1996, or Gyer's Eq. 13",
        examples=["ciddor"],
    )
    wavelength_m: float = Field(
        DEFAULT_WAVELENGTH_M,
        ge=0.3e-6,
        le=1.7e-6,
        description="wavelength of the light in vacuum, for cameras without their own wavelength",
        examples=[5.5e-07],
        json_schema_extra={"unit": "m"},
    )
    co2_ppm: float = Field(
        DEFAULT_CO2_PPM,
        ge=0,
        le=2000,
        description="carbon dioxide content of the air",
        examples=[450.0],
        json_schema_extra={"unit": "ppm"},
    )
