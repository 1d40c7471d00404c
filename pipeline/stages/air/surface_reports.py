"""Weather reports of a mission: read, and refused where a unit must be mistaken."""

import math

from pipeline.atmosphere.climatology import Climatology
from pipeline.atmosphere.estimate.external_readings import TimeAndPlace
from pipeline.atmosphere.surface_report import (
    SurfaceReport,
    parse_metar,
    station_pressure,
    surface_report,
)
from pipeline.config.atmosphere import SurfaceSection
from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.units import HECTOPASCAL, ZERO_CELSIUS_K

_IMPOSSIBLE_SIGMAS = 4.0
"""Largest departure of a temperature from the climatology; that of real soundings is 2.9."""

_LIKE_FAHRENHEIT, _LIKELY = 2.5, 2.0
"""A temperature more than 2.5 sigma too warm, and within 2 if it is Fahrenheit, is Fahrenheit."""

_LIKE_QNH, _IMPOSSIBLE_LEVEL = 3.0, 5.0
"""A pressure more than 3 sigma too high, and within 2 if it is QNH, is QNH; weather stays in 5."""

_FAR_HOURS = 3.0


def read_report(
    section: SurfaceSection,
    where: str,
    flight_ns: int | None,
    background: Climatology,
    ledger: Ledger,
) -> SurfaceReport:
    """The report of a weather station, from its METAR or from numbers.

    Refuses (``InputError``) values that the climatology of place and season rules out, such as a
    temperature in Fahrenheit or a pressure reduced to sea level.
    """
    if section.metar is not None:
        report = parse_metar(
            section.metar, section.h_msl_m, ledger, flight_ns=flight_ns, where=f"{where}.metar"
        )
    else:
        report = surface_report(
            section.h_msl_m,
            temperature_k=section.temperature_k,
            pressure_pa=section.pressure_pa,
            relative_humidity=section.humidity,
            time_ns=section.time_ns,
            where=where,
        )
        hours = TimeAndPlace(flight_ns).hours_from(report.time_ns)
        if hours > _FAR_HOURS:  # as `parse_metar` warns of a METAR
            what = f"the report is {hours:.1f} hours away from the flight"
            ledger.warning("SURFACE-FAR-IN-TIME", what, where=where)
    _refuse_temperature(report, background, where, is_celsius=section.metar is not None)
    _refuse_level(report, background, where, is_station=section.metar is not None)
    return report


def _refuse_temperature(
    report: SurfaceReport, background: Climatology, where: str, *, is_celsius: bool
) -> None:
    """Refuse a temperature that no season has, or that is usual if it is Fahrenheit (no METAR)."""
    expected = float(background.profile.temperature(report.h_m))
    sigma = float(background.spread.sigma_temperature(report.h_m))
    departure = (report.temperature_k - expected) / sigma
    celsius = report.temperature_k - ZERO_CELSIUS_K
    as_fahrenheit = ((celsius - 32.0) / 1.8 + ZERO_CELSIUS_K - expected) / sigma
    mistaken = departure > _LIKE_FAHRENHEIT and abs(as_fahrenheit) < _LIKELY and not is_celsius
    if not mistaken and not abs(departure) > _IMPOSSIBLE_SIGMAS:
        return
    what = (
        f"{celsius:.1f} C at {report.h_m:.0f} m is {abs(departure):.1f} sigma from the "
        f"{expected - ZERO_CELSIUS_K:.0f} C of the climatology"
    )
    if mistaken:
        what += f"; {celsius:.1f} F would be {(celsius - 32.0) / 1.8:.1f} C"
    remedy = (
        "temperature_c is in Celsius: convert Fahrenheit by (F - 32) / 1.8, Kelvin by "
        "K - 273.15; or the station or the date is another; a METAR is taken as it is"
    )
    raise InputError("SURFACE-CLIMATE", what, where=where, remedy=remedy)


def _refuse_level(
    report: SurfaceReport, background: Climatology, where: str, *, is_station: bool
) -> None:
    """Refuse a pressure that no weather makes, or that is usual if it is reduced to sea level.

    The air column below the station adds 2 % of its log-pressure thickness to the sigma.
    """
    if not math.isfinite(report.pressure_pa):
        return
    expected = float(background.profile.pressure(report.h_m))
    fall = math.log(float(background.profile.pressure(0.0)) / expected)
    sigma = math.hypot(background.spread.pressure_ratio, 0.02 * fall)
    departure = math.log(report.pressure_pa / expected) / sigma
    reduced = station_pressure(report.pressure_pa, report.h_m)
    as_qnh = math.log(reduced / expected) / sigma
    mistaken = departure > _LIKE_QNH and abs(as_qnh) < _LIKELY and not is_station
    if not mistaken and abs(departure) <= _IMPOSSIBLE_LEVEL:
        return
    what = (
        f"{report.pressure_pa / HECTOPASCAL:.1f} hPa at {report.h_m:.0f} m is "
        f"{abs(departure):.1f} sigma from the {expected / HECTOPASCAL:.0f} hPa of the climatology"
    )
    if mistaken:
        what += f"; as QNH it would be {reduced / HECTOPASCAL:.1f} hPa there"
    remedy = (
        "pressure_hpa is what the barometer shows at h_msl_m, not reduced to sea level; "
        "give QNH as a metar, or correct h_msl_m"
    )
    raise InputError("SURFACE-LEVEL", what, where=where, remedy=remedy)
