"""Surface reports: the air at one height, from a METAR or from numbers in the mission file."""

import math
from dataclasses import dataclass

from unbend.atmosphere import messages
from unbend.atmosphere.metar import (
    EXCERPT,
    MOST_OF_ROUNDING_C,
    Metar,
    decode_metar,
    time_of_metar,
    whole_degrees,
)
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.messages import Ledger
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K

# The ICAO standard atmosphere, with which altimeter settings are defined (ICAO Doc 7488).
_SEA_LEVEL_PA = 101_325.0
_SEA_LEVEL_K = 288.15
_LAPSE_K_PER_M = 0.0065
_EXPONENT = 0.190263

# Smallest and largest values that are accepted.
_QNH_PA = (85_000.0, 110_000.0)
_GROUND_K = (180.0, 333.0)
_STATION_M = (-500.0, 6_000.0)

ROUNDING_OF_NUMBERS_C = 1e-6  # floating point error of the difference of two numbers in tenths
ROUNDING_C = 0.5  # rounding of a dew point in whole degrees, where the temperature is in tenths

# One sigma of a report: half a step of its digits, and the error of a good sensor.
_WHOLE_K = 0.5  # whole degrees
_TENTH_K = 0.3  # tenths of a degree
_QNH_SIGMA_PA = 50.0


@dataclass(frozen=True)
class SurfaceReport:
    """The air at the height ``h_m`` above sea level of a weather station, NaN where not reported.

    ``time_ns`` [Unix ns], None if unknown. ``origin``: ``METAR KOUN`` or ``mission file``. The
    sigmas are of rounding and sensor, not of the distance. ``distance_m``: of the station from the
    flight; ``across``: whether a coast or a ridge is between them.
    """

    h_m: float
    pressure_pa: float
    temperature_k: float
    vapour_pressure_pa: float
    time_ns: int | None = None
    origin: str = ""
    sigma_temperature_k: float = _WHOLE_K
    sigma_pressure_pa: float = _QNH_SIGMA_PA
    distance_m: float = 0.0
    across: bool = False
    is_metar: bool = False

    @property
    def name(self) -> str:
        """Name of the report in messages."""
        return f"surface report {self.origin}".strip()


def station_pressure(altimeter_setting_pa: float, h_m: float) -> float:
    """Pressure at a station from its altimeter setting (QNH) [Pa].

    p = (QNH^a - p0^a L h / T0)^(1/a) with a = 0.190263, the ICAO troposphere (ICAO Doc 7488). This
    inverts how the station computed its QNH. ``h_m`` : elevation [m], -500 to 6000.

    >>> round(station_pressure(101325.0, 1000.0), 0)
    89875.0
    """
    fall = _SEA_LEVEL_PA**_EXPONENT * _LAPSE_K_PER_M * h_m / _SEA_LEVEL_K
    return float((altimeter_setting_pa**_EXPONENT - fall) ** (1.0 / _EXPONENT))


def parse_metar(
    text: str,
    station_h_m: float,
    ledger: Ledger,
    *,
    flight_ns: int | None = None,
    where: str = "METAR",
) -> SurfaceReport:
    """The air of a METAR or SPECI: temperature, dew point and altimeter setting.

    ``station_h_m``: elevation of the station [m above sea level], which a METAR does not have.
    ``flight_ns``: a time of the flight [Unix ns]. A METAR has only the day of the month: the day
    nearest to a date before the report is taken, without one that nearest to the flight; without
    both the report has no time. ``where``: place of the text, for error messages.

    Temperatures are whole degrees, tenths where the remarks have a T group. An altimeter setting
    is rounded down, to whole hPa (ICAO) or 0.01 inch (FAA), so half a step is added. Raises
    ``InputError`` where the report does not parse (see `decode_metar`), its values do not occur
    at the ground, or its dew point is more than a degree above its temperature.

    >>> text = "METAR EDDF 221150Z 24011KT 9999 SCT040 M05/M10 Q1013"
    >>> report = parse_metar(text, 111.0, Ledger())
    >>> report.temperature_k, round(report.pressure_pa)
    (268.15, 100023)
    """
    _check_height(station_h_m, where)
    report = decode_metar(text, where)
    t = report.temperature_c + ZERO_CELSIUS_K
    dew = report.dew_point_c + ZERO_CELSIUS_K
    qnh = report.altimeter_pa
    place = f"{where}: {report.text[:EXCERPT]!r}"
    if not _GROUND_K[0] <= t <= _GROUND_K[1] and math.isfinite(t):
        raise messages.metar_range(where=place, quantity="temperature", number=t, unit="K")
    if not _QNH_PA[0] <= qnh <= _QNH_PA[1] and math.isfinite(qnh):
        raise messages.metar_range(where=place, quantity="altimeter setting", number=qnh, unit="Pa")
    if report.dew_point_c - report.temperature_c > MOST_OF_ROUNDING_C + ROUNDING_OF_NUMBERS_C:
        raise messages.metar_dew_point_impossible(
            where=place,
            dew_c=report.dew_point_c,
            celsius=report.temperature_c,
            exchanged=f"{whole_degrees(report.dew_point_c)}/{whole_degrees(report.temperature_c)}",
        )
    time_ns = time_of_metar(report, flight_ns, where)
    _note_defects(report, where, ledger)
    pressure = station_pressure(qnh, station_h_m) if math.isfinite(qnh) else math.nan
    # Without a temperature a dew point gives no humidity.
    dew = min(dew, t) if math.isfinite(t) else math.nan
    pressure_for_vapour = pressure if math.isfinite(pressure) else _SEA_LEVEL_PA
    return SurfaceReport(
        station_h_m,
        pressure,
        t,
        float(vapour_pressure(1.0, dew, pressure_for_vapour)),
        time_ns,
        f"METAR {report.station}",
        _TENTH_K if report.in_tenths else _WHOLE_K,
        is_metar=True,
    )


def _note_defects(report: Metar, where: str, ledger: Ledger) -> None:
    """Add messages on a report to a ledger.

    On groups that were not understood, a dew point above the temperature, and missing quantities.
    """
    if report.complaints:
        groups = "; ".join(report.complaints)
        ledger.add(messages.metar_groups(where=where, count=len(report.complaints), groups=groups))
    if report.dew_point_c > report.temperature_c + (ROUNDING_C if report.in_tenths else 0.0):
        ledger.add(
            messages.metar_dew_point(
                where=where, count=1, dew_c=report.dew_point_c, celsius=report.temperature_c
            )
        )
    quantities = {
        "temperature": report.temperature_c,
        "dew point": report.dew_point_c,
        "altimeter setting": report.altimeter_pa,
    }
    missing = [name for name, value in quantities.items() if math.isnan(value)]
    if missing:
        ledger.add(
            messages.metar_missing(
                where=where,
                count=len(missing),
                quantities=" and no ".join(missing),
                report=report.text[:EXCERPT],
                dew_point_alone="temperature" in missing and "dew point" not in missing,
            )
        )


def surface_report(
    h_m: float,
    *,
    temperature_k: float = math.nan,
    pressure_pa: float = math.nan,
    relative_humidity: float = math.nan,
    time_ns: int | None = None,
    where: str = "atmosphere.surface",
) -> SurfaceReport:
    """A surface report from numbers.

    ``h_m``: height of the instruments [m above sea level], -500 to 6000. ``temperature_k``,
    ``pressure_pa`` at that height, not reduced to the sea; NaN if unknown. ``relative_humidity``: 0
    to 1 over water; needs the temperature. ``where``: place of the numbers, for error messages.

    Raises ``InputError`` where values cannot be those of air at the ground, for example Fahrenheit
    given as Celsius, or the QNH of a station at 650 m given as its pressure. Missions are also
    checked by place and season, see `unbend.stages.air_sources`.

    >>> surface_report(100.0, temperature_k=293.15, relative_humidity=0.5).pressure_pa
    nan
    """
    _check_height(h_m, where)
    if not (math.isfinite(temperature_k) or math.isfinite(pressure_pa)):
        raise messages.surface_empty(where=where)
    if temperature_k < _GROUND_K[0] or temperature_k > _GROUND_K[1]:
        celsius = temperature_k - ZERO_CELSIUS_K
        raise messages.surface_temperature(where=where, kelvin=temperature_k, celsius=celsius)
    usual = station_pressure(_SEA_LEVEL_PA, h_m)
    if math.isfinite(pressure_pa) and abs(pressure_pa / usual - 1.0) > 0.08:
        raise messages.surface_pressure(
            where=where,
            hpa=pressure_pa / HECTOPASCAL,
            height_m=h_m,
            ratio=pressure_pa / usual,
            usual_hpa=usual / HECTOPASCAL,
        )
    if math.isfinite(relative_humidity) and not 0.0 <= relative_humidity <= 1.0:
        raise messages.surface_humidity(where=where, humidity=relative_humidity)
    p = pressure_pa if math.isfinite(pressure_pa) else usual
    e = float(vapour_pressure(relative_humidity, temperature_k, p))
    return SurfaceReport(h_m, pressure_pa, temperature_k, e, time_ns, "mission file")


def _check_height(h_m: float, where: str) -> None:
    """Raise ``InputError`` for a height [m] at which there is no weather station."""
    if not _STATION_M[0] <= h_m <= _STATION_M[1]:
        raise messages.surface_height(where=where, height_m=h_m)
