"""Surface reports: the air at one height, from a METAR or from numbers in the mission file."""

import math
import re
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from unbend.atmosphere import messages
from unbend.atmosphere.refractive_index import vapour_pressure
from unbend.messages import Ledger
from unbend.units import HECTOPASCAL, NANOSECONDS_PER_SECOND, ZERO_CELSIUS_K

# The ICAO standard atmosphere, with which altimeter settings are defined (ICAO Doc 7488).
_SEA_LEVEL_PA, _SEA_LEVEL_K, _LAPSE_K_PER_M, _EXPONENT = 101_325.0, 288.15, 0.0065, 0.190263

_INCH_OF_MERCURY_PA = 3386.389
_QNH_PA = (85_000.0, 110_000.0)
_GROUND_K = (180.0, 333.0)
_STATION_M = (-500.0, 6_000.0)
# Half a step of the report's digits, and what an inspected station's sensor may be off.
_TENTHS = re.compile(r"\sT[01]\d{3}[01]\d{3}(?=\s|=|$)")
_WHOLE_K, _TENTH_K = 0.5, 0.3
_QNH_HPA, _QNH_INCHES = re.compile(r"\sQ(\d{4})(?=\s|=|$)"), re.compile(r"\sA(\d{4})(?=\s|=|$)")
_QNH_SIGMA_PA = 50.0
_STAMP = re.compile(r"(?<!\S)\d{6}Z(?!\S)")  # day, hour and minute: one in each report


@dataclass(frozen=True)
class SurfaceReport:
    """The air at the height ``h_m`` above sea level of a weather station, NaN where not reported.

    ``time_ns`` [Unix ns], None if unknown. ``origin``: ``METAR KOUN`` or ``mission file``. The
    sigmas are of rounding and sensor, not of how far away the station is: ``distance_m`` from the
    flight, ``across`` a coast or a ridge.
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
        """For messages."""
        return f"surface report {self.origin}".strip()


def station_pressure(altimeter_setting_pa: float, h_m: float) -> float:
    """Pressure at a station from its altimeter setting (QNH) [Pa].

    p = (QNH^a - p0^a L h / T0)^(1/a) with a = 0.190263, the ICAO troposphere (ICAO Doc 7488): the
    inverse of how the station made its QNH. ``h_m`` : elevation [m], -500 to 6000.

    >>> round(station_pressure(101325.0, 1000.0), 0)
    89875.0
    """
    fall = _SEA_LEVEL_PA**_EXPONENT * _LAPSE_K_PER_M * h_m / _SEA_LEVEL_K
    return float((altimeter_setting_pa**_EXPONENT - fall) ** (1.0 / _EXPONENT))


def parse_metar(
    text: str, station_h_m: float, ledger: Ledger, *, flight_ns: int | None = None,
    where: str = "METAR",
) -> SurfaceReport:  # fmt: skip
    """The air of a METAR or SPECI: temperature, dew point and altimeter setting.

    ``station_h_m``: elevation of the station [m above sea level]; a METAR has none. ``flight_ns``:
    a time of the flight [Unix ns]: a METAR has only the day of the month, and the nearest such day
    is taken; without it the report has no time. ``where`` the text stands, for refusals.

    Temperatures are whole degrees, tenths where the remarks have a T group. An altimeter setting
    is rounded down, to whole hPa (ICAO) or 0.01 inch (FAA), so half a step is added. Raises
    ``InputError`` where the report does not parse or its values do not occur at the ground.

    >>> text = "METAR EDDF 221150Z 24011KT 9999 SCT040 M05/M10 Q1013"
    >>> report = parse_metar(text, 111.0, Ledger())
    >>> report.temperature_k, round(report.pressure_pa)
    (268.15, 100023)
    """
    _refuse_height(station_h_m, where)
    flat = " ".join(text.split()).rstrip("=").strip()
    reports = len(_STAMP.findall(flat))
    if reports > 1:
        raise messages.metar_several(where=where, total=reports)
    report, complaints = _decode(flat, where)
    if complaints:
        groups = "; ".join(complaints)
        ledger.add(messages.metar_groups(where=where, count=len(complaints), groups=groups))
    t, dew = (
        math.nan if value is None else float(value.value("C")) + ZERO_CELSIUS_K
        for value in (report.temp, report.dewpt)
    )
    qnh = math.nan
    if report.press is not None:  # with half of its last digit [Pa]
        half_step = 0.005 * _INCH_OF_MERCURY_PA if _QNH_INCHES.search(flat) else 0.0
        half_step = 0.5 * HECTOPASCAL if _QNH_HPA.search(flat) else half_step
        qnh = float(report.press.value("HPA")) * HECTOPASCAL + half_step
    for number, (low, high), quantity, unit in (
        (t, _GROUND_K, "temperature", "K"),
        (qnh, _QNH_PA, "altimeter setting", "Pa"),
    ):
        if number < low or number > high:
            place = f"{where}: {flat[:80]!r}"
            raise messages.metar_range(where=place, quantity=quantity, number=number, unit=unit)
    time_ns = _nearest_day(flat, flight_ns, where)
    if dew > t:
        celsius, dew_c, dew = t - ZERO_CELSIUS_K, dew - ZERO_CELSIUS_K, t
        ledger.add(messages.metar_dew_point(where=where, count=1, dew_c=dew_c, celsius=celsius))
    quantities = {"temperature": t, "dew point": dew, "altimeter setting": qnh}
    if missing := [name for name, value in quantities.items() if not math.isfinite(value)]:
        dew_point_alone = not math.isfinite(t) and math.isfinite(dew)
        ledger.add(
            messages.metar_missing(
                where=where,
                count=len(missing),
                quantities=" and no ".join(missing),
                report=flat[:80],
                dew_point_alone=dew_point_alone,
            )
        )
    pressure = station_pressure(qnh, station_h_m) if math.isfinite(qnh) else math.nan
    dew = dew if math.isfinite(t) else math.nan
    e = float(vapour_pressure(1.0, dew, pressure if math.isfinite(pressure) else _SEA_LEVEL_PA))
    sigma = _TENTH_K if _TENTHS.search(flat) else _WHOLE_K
    origin = f"METAR {report.station_id}".strip()
    return SurfaceReport(station_h_m, pressure, t, e, time_ns, origin, sigma, is_metar=True)


def _decode(flat: str, where: str) -> tuple[Any, list[str]]:
    """A report as the package ``metar`` reads it, and its complaints of groups it cannot read."""
    from metar import Metar

    with warnings.catch_warnings(record=True) as caught:
        # Not strict, it warns of a group it does not know or cannot decode, and goes on: a strange
        # runway group must not cost the temperature behind it.
        warnings.simplefilter("always")
        try:
            # Month and year only keep it from guessing; January has every day.
            report = Metar.Metar(flat, month=1, year=2000, strict=False)
        except (Metar.ParserError, ValueError, TypeError) as error:
            why = f"the report does not parse: {error}"
            raise messages.metar_parse(where=f"{where}: {flat[:80]!r}", why=why) from None
    complaints = [" ".join(str(warning.message).split()) for warning in caught]
    if report.station_id is None or (report.temp is None and report.press is None):
        why = "no station, or neither temperature nor altimeter setting, is found"
        why = ": ".join([why, "; ".join(complaints)] if complaints else [why])
        raise messages.metar_parse(where=f"{where}: {flat[:80]!r}", why=why)
    return report, complaints


def _nearest_day(flat: str, flight_ns: int | None, where: str) -> int | None:
    """The time of the group DDHHMMZ on the nearest day with that number; refuses what is none."""
    group = re.search(r"\s(\d\d)(\d\d)(\d\d)Z\s", flat + " ")
    if group is None:
        return None
    day, hour, minute = (int(part) for part in group.groups())
    if not (1 <= day <= 31 and hour < 24 and minute < 60):
        why = f"{group[0].strip()} is no day, hour and minute"
        raise messages.metar_parse(where=f"{where}: {flat[:80]!r}", why=why)
    if flight_ns is None:
        return None
    flight = np.datetime64(int(flight_ns), "ns").astype("datetime64[D]")
    days = [flight + np.timedelta64(step, "D") for step in range(-31, 32)]
    same = [d for d in days if int((d - d.astype("datetime64[M]")).astype(np.int64)) + 1 == day]
    at = (hour * 3600 + minute * 60) * NANOSECONDS_PER_SECOND
    times = [int(d.astype("datetime64[ns]").astype(np.int64)) + at for d in same]
    return min(times, key=lambda time: abs(time - flight_ns))


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
    to 1 over water; needs the temperature. ``where`` the numbers stand, for refusals.

    Raises ``InputError`` where values cannot be those of air at the ground, as Fahrenheit taken
    for Celsius, or QNH taken for the station's pressure 650 m up, are not. Missions are also
    checked by place and season, see `unbend.stages.air_sources`.

    >>> surface_report(100.0, temperature_k=293.15, relative_humidity=0.5).pressure_pa
    nan
    """
    _refuse_height(h_m, where)
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


def _refuse_height(h_m: float, where: str) -> None:
    if not _STATION_M[0] <= h_m <= _STATION_M[1]:
        raise messages.surface_height(where=where, height_m=h_m)
