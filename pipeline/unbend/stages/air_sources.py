"""Sources of the air in addition to the log: soundings, surface reports, a weather model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere import surface_report
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology, climatology, month_of
from unbend.atmosphere.estimate.external_readings import TimeAndPlace, distance_notes
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS, SensorCalibration
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.ageing import FlightPath
from unbend.atmosphere.series.profile_series import PlaceInTime
from unbend.atmosphere.series.time_windows import TimeWindow
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.soundings.model_column import model_column
from unbend.atmosphere.soundings.model_field import ModelField
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.config import Mission
from unbend.config.atmosphere import AtmosphereSection, SurfaceSection
from unbend.flight.stations import NO_TIME, Stations
from unbend.geodesy import longitudes_near
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.stages.flight_date import (
    doubt_of_date,
    flight_date_ns,
    flight_hour,
    refuse_dated_sources,
)
from unbend.stages.flight_log import FlightLog, GroundTrack
from unbend.stages.neighbour_zone import system_of_stations, zone_findings
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.model_fields import FlightArea
from unbend.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K, Array, Integers, Mask

BIN_M = 100.0  # height of the bins of samples: a climb counts more than a long level run
# Departures from the climatology, in its sigmas.
LIKELY_SIGMAS = 2.0  # a value read as Fahrenheit, or as QNH, is likely within this
FAHRENHEIT_SIGMAS = 2.5  # warmer by more, but likely as Fahrenheit: taken for Fahrenheit
IMPOSSIBLE_SIGMAS = 4.0  # of a temperature: real soundings stay within 2.9
QNH_SIGMAS = 3.0  # higher pressure by more, but likely as QNH: taken for QNH
IMPOSSIBLE_PRESSURE_SIGMAS = 5.0  # weather stays within 5
ALWAYS_NS = 2**62  # -ALWAYS_NS and ALWAYS_NS are before and after all times
UNPLACED_STATION_KM = 100.0  # assumed distance of a weather station, if none is stated


@dataclass(frozen=True, eq=False)
class ModelAir:
    """The part of a weather model that surrounds a flight.

    place : mean place and time at which the flight sampled the air.
    column : the profile of the model there.
    track : positions of the flight as logged; None without any.
    """

    field: ModelField
    column: Sounding
    place: PlaceInTime
    track: GroundTrack | None

    def place_of(self, samples: AirSamples | None, window: TimeWindow) -> PlaceInTime:
        """Where and when the air of a part of the flight was sampled.

        A part without its own estimate (``why_not``) has the air and the place of the whole flight.
        """
        if samples is None or window.why_not:
            return self.place
        return sampled_place(samples, self.track, window.start_ns, window.end_ns) or self.place


def read_model_air(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    stations: Stations,
    samples: AirSamples,
    *,
    middle: TimeAndPlace,
    ledger: Ledger,
) -> ModelAir | None:
    """The weather model of a mission; None if the mission names none.

    ``middle`` is time and place of the middle of the flight. Refuses (`InputError`) a flight
    without a time or place, and stations outside the area of the model.
    """
    model = inputs.weather_model
    if model is None:
        return None
    has_place = math.isfinite(middle.latitude_rad + middle.longitude_rad)
    if middle.time_ns is None or not has_place or bool(stations.from_boot.any()):
        raise messages.flight_without_time(where=model.name)
    place = sampled_place(samples, flight.track)
    if place is None:
        place = PlaceInTime(middle.latitude_rad, middle.longitude_rad, middle.time_ns)
    has_position = stations.ok & np.isfinite(stations.lat_rad + stations.lon_rad)
    area = area_of_flight(stations, has_position, place)
    field = model.read(area, ledger)
    field.refuse_outside(area.latitude_rad, area.longitude_rad)

    ground_m = constant_ground_m(mission)
    if ground_m is None:
        ground_m = flight.heights.home_h_msl_m
    if ground_m is None:
        ground_m = math.nan
    highest_m = float(stations.h_msl_m[has_position].max(initial=0.0))
    column = ledger.take(model_column(field, place, ground_h_m=ground_m, highest_h_m=highest_m))
    ledger.add(
        messages.model_column(
            where=model.name,
            count=column.h_m.size,
            low=float(column.h_m[0]),
            high=float(column.h_m[-1]),
            north=place.latitude_rad / DEGREE,
            east=place.longitude_rad / DEGREE,
            hours=TimeAndPlace(place.time_ns).hours_from(column.time_ns),
        )
    )
    # The column is where the air was sampled: placed there, no distance adds to its errors.
    column = replace(column, latitude_rad=middle.latitude_rad, longitude_rad=middle.longitude_rad)
    return ModelAir(field, column, place, flight.track)


def area_of_flight(stations: Stations, has_position: Mask, place: PlaceInTime) -> FlightArea:
    """Places and times of the stations in a mask, and of the ``place`` where the air was sampled.

    Stations without a time get the time of ``place``.
    """
    times_ns = stations.time_ns[has_position]
    times_ns = np.where(times_ns == NO_TIME, place.time_ns, times_ns)
    longitudes_rad = np.append(stations.lon_rad[has_position], place.longitude_rad)
    return FlightArea(
        np.append(stations.lat_rad[has_position], place.latitude_rad),
        longitudes_near(longitudes_rad, place.longitude_rad),
        np.append(times_ns, place.time_ns),
    )


def sampled_place(
    samples: AirSamples,
    track: GroundTrack | None,
    start_ns: int = -ALWAYS_NS,
    end_ns: int = ALWAYS_NS,
) -> PlaceInTime | None:
    """Mean place and time of the samples of the air between two times [Unix ns].

    The mean of each bin of 100 m of height counts once: a climb counts more than a long level run.
    None if no sample was used between the times, or the flight has no positions.
    """
    if track is None:
        return None
    is_known = np.isfinite(track.latitude_rad + track.longitude_rad)
    accepted = accepted_samples(samples, start_ns, end_ns)
    if accepted is None or not bool(is_known.any()):
        return None
    # Seconds from the beginning of the flight: interpolation would round nanoseconds of Unix time.
    first_ns = int(track.time_ns[0])
    sample_s = (accepted.time_ns - first_ns) * 1e-9
    track_s = (track.time_ns[is_known] - first_ns) * 1e-9
    latitude_rad = track.latitude_rad[is_known]
    longitude_rad = track.longitude_rad[is_known]
    longitude_rad = longitudes_near(longitude_rad, float(longitude_rad[0]))
    _, bin_number = np.unique(np.floor(accepted.h_m / BIN_M), return_inverse=True)
    bin_count = np.bincount(bin_number)

    def mean_of_bins(values: NDArray[np.floating[Any]]) -> float:  # values of the samples
        return float(np.mean(np.bincount(bin_number, values) / bin_count))

    return PlaceInTime(
        latitude_rad=mean_of_bins(np.interp(sample_s, track_s, latitude_rad)),
        longitude_rad=mean_of_bins(np.interp(sample_s, track_s, longitude_rad)),
        time_ns=first_ns + round(mean_of_bins(sample_s) * 1e9),
    )


class AcceptedSamples(NamedTuple):
    """Times [Unix ns] and heights [m above sea level] of the accepted samples of a sensor, (n,)."""

    time_ns: Integers
    h_m: Array


def accepted_samples(samples: AirSamples, start_ns: int, end_ns: int) -> AcceptedSamples | None:
    """Accepted samples of the thermometer between two times; without any, of the barometer."""
    for sensor in (samples.temperature, samples.pressure):
        if sensor is None:
            continue
        is_between = (sensor.time_ns >= start_ns) & (sensor.time_ns < end_ns)
        rows = sensor.accepted & np.isfinite(sensor.h_m) & is_between
        if bool(rows.any()):
            return AcceptedSamples(sensor.time_ns[rows], sensor.h_m[rows])
    return None


def read_report(
    section: SurfaceSection,
    where: str,
    flight_ns: int | None,
    background: Climatology,
    ledger: Ledger,
) -> SurfaceReport:
    """The report of a weather station, from its METAR or from stated values.

    ``where`` is its key, for messages; ``flight_ns`` completes the date of a METAR. Refuses
    (``InputError``) values that the climatology of place and season (``background``) rules out.
    """
    if section.metar is not None:
        report = surface_report.parse_metar(
            section.metar, section.h_msl_m, ledger, flight_ns=flight_ns, where=f"{where}.metar"
        )
    else:
        report = surface_report.surface_report(
            section.h_msl_m,
            temperature_k=section.temperature_k,
            pressure_pa=section.pressure_pa,
            relative_humidity=section.humidity,
            time_ns=section.time_ns,
            where=where,
        )
    of_metar = section.metar is not None
    refuse_impossible_temperature(report, background, where, of_metar=of_metar)
    refuse_impossible_pressure(report, background, where, of_metar=of_metar)
    distance_km = section.distance_km
    if distance_km is None:
        distance_km = UNPLACED_STATION_KM
        ledger.add(messages.surface_unplaced(where=where, km=distance_km))
    distance_m = 1e3 * distance_km
    return replace(report, distance_m=distance_m, across=section.across_coast_or_ridge)


def refuse_impossible_temperature(
    report: SurfaceReport, background: Climatology, where: str, *, of_metar: bool
) -> None:
    """Refuse a temperature far from the climatology, or one that fits only as Fahrenheit.

    ``of_metar`` is True for the temperature of a METAR, which is in Celsius.
    """
    celsius = report.temperature_k - ZERO_CELSIUS_K
    celsius_if_fahrenheit = (celsius - 32.0) / 1.8
    expected_k = float(background.profile.temperature(report.h_m))
    sigma_k = float(background.spread.sigma_temperature(report.h_m))
    departure = (report.temperature_k - expected_k) / sigma_k
    departure_if_fahrenheit = (celsius_if_fahrenheit + ZERO_CELSIUS_K - expected_k) / sigma_k
    is_usual_if_fahrenheit = abs(departure_if_fahrenheit) < LIKELY_SIGMAS
    looks_fahrenheit = departure > FAHRENHEIT_SIGMAS and is_usual_if_fahrenheit and not of_metar
    if looks_fahrenheit or abs(departure) > IMPOSSIBLE_SIGMAS:
        hint = ""
        if looks_fahrenheit:
            hint = f"; {celsius:.1f} F would be {celsius_if_fahrenheit:.1f} C"
        raise messages.surface_temperature_unlikely(
            where=where,
            celsius=celsius,
            height_m=report.h_m,
            sigmas=abs(departure),
            expected_c=expected_k - ZERO_CELSIUS_K,
            rather=hint,
        )


def refuse_impossible_pressure(
    report: SurfaceReport, background: Climatology, where: str, *, of_metar: bool
) -> None:
    """Refuse a pressure far from the climatology, or one that fits only as QNH.

    QNH is pressure reduced to sea level. ``of_metar`` is True for the pressure of a METAR: it is
    QNH, but was already converted to the height of the station.
    """
    if not math.isfinite(report.pressure_pa):
        return
    expected_pa = float(background.profile.pressure(report.h_m))
    sigma = background.sigma_log_pressure(report.h_m)
    departure = math.log(report.pressure_pa / expected_pa) / sigma
    pressure_if_qnh_pa = surface_report.station_pressure(report.pressure_pa, report.h_m)
    departure_if_qnh = math.log(pressure_if_qnh_pa / expected_pa) / sigma
    is_usual_if_qnh = abs(departure_if_qnh) < LIKELY_SIGMAS
    looks_like_qnh = departure > QNH_SIGMAS and is_usual_if_qnh and not of_metar
    if looks_like_qnh or abs(departure) > IMPOSSIBLE_PRESSURE_SIGMAS:
        hint = f"; as QNH it would be {pressure_if_qnh_pa / HECTOPASCAL:.1f} hPa there"
        raise messages.surface_pressure_unlikely(
            where=where,
            hpa=report.pressure_pa / HECTOPASCAL,
            height_m=report.h_m,
            sigmas=abs(departure),
            expected_hpa=expected_pa / HECTOPASCAL,
            rather=hint if looks_like_qnh else "",
        )


@dataclass(frozen=True, eq=False)
class AirSources:
    """Sources of the air in addition to the log.

    time_ns, longitude_rad : the middle of the flight; its time is None where neither the log nor
        the mission file has it.
    utc_known : whether the times of the log are UTC; else they count from a boot.
    doubt_of_time : why the stated date may be wrong, in words; empty if nothing contradicts it.
    lowest_h_m : the lowest height at which the log sampled the air, else that of the take-off,
        else 0 [m above sea level].
    path : positions of the flight as logged; None without any.
    calibration : stated mean and sigma of the errors of sensors.
    """

    background: Climatology
    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    time_ns: int | None = None
    longitude_rad: float = math.nan
    lowest_h_m: float = 0.0
    model: ModelAir | None = None
    path: FlightPath | None = None
    calibration: Mapping[SensorFault, SensorCalibration] = field(default_factory=dict)
    utc_known: bool = True
    doubt_of_time: str = ""

    def lines(self) -> list[tuple[str, str]]:
        """A label and a description of each source, for `unbend check`."""
        lines = [*map(line_of_sounding, self.soundings), *map(line_of_report, self.surface)]
        background = self.background
        lines.append(("climatology", f"{background.profile.name}, {background.origin}"))
        if self.calibration:
            lines.append(("sensors", describe_calibration(self.calibration)))
        return lines


def line_of_sounding(sounding: Sounding) -> tuple[str, str]:
    """The label of a sounding, and its station, time, levels and origin in words."""
    time = ""
    if sounding.time_ns is not None:
        time = f" of {np.datetime64(sounding.time_ns, 'ns').astype('datetime64[m]')} UTC"
    h_m = sounding.h_m
    levels = f"{h_m.size} levels from {h_m[0]:.0f} to {h_m[-1]:.0f} m"
    return sounding.kind, f"{sounding.station}{time}: {levels}, {sounding.origin}"


def line_of_report(report: SurfaceReport) -> tuple[str, str]:
    """The label of a surface report, and its origin, height and known values in words."""
    values = {
        "{:.1f} C": report.temperature_k - ZERO_CELSIUS_K,
        "{:.1f} hPa": report.pressure_pa / HECTOPASCAL,
        "vapour {:.1f} hPa": report.vapour_pressure_pa / HECTOPASCAL,
    }
    texts = [text.format(value) for text, value in values.items() if np.isfinite(value)]
    return "surface", f"{report.origin} at {report.h_m:.0f} m: {', '.join(texts)}"


def describe_calibration(calibration: Mapping[SensorFault, SensorCalibration]) -> str:
    """Known mean and standard deviation of each sensor error, in words.

    >>> describe_calibration({SensorFault.HYGROMETER_BIAS: SensorCalibration(0.01, 0.02)})
    'hygrometer bias 0.01 ± 0.02'
    """
    parts = []
    for fault, calibrated in calibration.items():
        mean = "" if calibrated.mean is None else f" {calibrated.mean:g}"
        sigma = "" if calibrated.sigma is None else f" ± {calibrated.sigma:g}"
        parts.append(f"{FAULT_TEXTS[fault]}{mean}{sigma}")
    return ", ".join(parts)


def read_air_sources(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    stations: Stations,
    samples: AirSamples,
    ledger: Ledger,
) -> AirSources:
    """Read soundings, surface reports and weather model of a mission; choose its climatology."""
    section = mission.atmosphere
    flight_ns = flight_date_ns(mission, stations, ledger)
    latitude = stations.mean_latitude_rad
    longitude = stations.median_longitude_rad
    lowest_h_m = lowest_sample_m(samples, flight.heights.home_h_msl_m)
    background = climatology(
        section.climatology,
        latitude_rad=latitude,
        month=month_of(flight_ns),
        index=refractive_index_of(section),
        ground_h_m=lowest_h_m,
        longitude_rad=0.0 if math.isnan(longitude) else longitude,
        hour=flight_hour(mission, stations, flight_ns),
    )
    soundings = read_soundings(section, inputs, flight_ns, latitude, ledger)
    surface = read_reports(section, flight_ns, background, ledger)
    if flight_ns is None and section.adjust:
        refuse_dated_sources(soundings, section)
    doubt = doubt_of_date(mission, stations, soundings)
    middle = TimeAndPlace(flight_ns, latitude, longitude, doubt)
    key_of_system, crs = system_of_stations(mission, inputs)
    ledger.extend(zone_findings(crs, key_of_system, soundings, middle, ledger))
    model = read_model_air(mission, inputs, flight, stations, samples, middle=middle, ledger=ledger)
    if model is not None:
        soundings.append(model.column)
    ledger.extend(distance_notes(tuple(soundings), surface, middle))
    sources = AirSources(
        background=background,
        soundings=tuple(soundings),
        surface=surface,
        time_ns=flight_ns,
        longitude_rad=longitude,
        lowest_h_m=lowest_h_m,
        model=model,
        path=flight_path(flight.track),
        calibration=section.sensors.calibration,
        utc_known=not bool(stations.from_boot.any()),
        doubt_of_time=doubt,
    )
    if not section.adjust:
        report_unused(sources, ledger)
    return sources


def read_reports(
    section: AtmosphereSection, flight_ns: int | None, background: Climatology, ledger: Ledger
) -> tuple[SurfaceReport, ...]:
    """The reports of weather stations that a mission names."""
    reports = []
    for number, station in enumerate(section.surface):
        where = f"atmosphere.surface[{number}]"
        reports.append(read_report(station, where, flight_ns, background, ledger))
    return tuple(reports)


def read_soundings(
    section: AtmosphereSection,
    inputs: OpenedInputs,
    flight_ns: int | None,
    latitude_rad: float,
    ledger: Ledger,
) -> list[Sounding]:
    """The soundings of a mission; from a file of several launches, the nearest in time."""
    soundings = []
    for read, stated in zip(inputs.soundings, section.soundings, strict=True):
        stated_m = stated.station_h_msl_m
        sounding = read(
            ledger,
            time_ns=flight_ns,
            latitude_rad=latitude_rad,
            station_h_m=math.nan if stated_m is None else stated_m,
        )
        soundings.append(replace(sounding, across=stated.across_coast_or_ridge))
    return soundings


def report_unused(sources: AirSources, ledger: Ledger) -> None:
    """Warn that the named sources are not used, because ``atmosphere.adjust`` is false."""
    if sources.soundings or sources.surface or sources.calibration:
        ledger.add(
            messages.air_sources_unused(
                where="atmosphere",
                soundings=len(sources.soundings),
                surface=len(sources.surface),
                calibrations=len(sources.calibration),
            )
        )


def flight_path(track: GroundTrack | None) -> FlightPath | None:
    """The known positions of a track, with longitudes that do not jump; None without any."""
    if track is None:
        return None
    is_known = np.isfinite(track.latitude_rad + track.longitude_rad)
    if not bool(is_known.any()):
        return None
    longitude_rad = track.longitude_rad[is_known]
    longitude_rad = longitudes_near(longitude_rad, float(longitude_rad[0]))
    return FlightPath(track.time_ns[is_known], track.latitude_rad[is_known], longitude_rad)


def lowest_sample_m(samples: AirSamples, home_h_msl_m: float | None) -> float:
    """The lowest height of the samples of the air [m above sea level].

    Without samples it is ``home_h_msl_m``, the height of the take-off, and 0 if that is None.
    """
    lowest = []
    for sensor in (samples.pressure, samples.temperature, samples.humidity):
        if sensor is None:
            continue
        heights = sensor.h_m[np.isfinite(sensor.h_m)]
        if heights.size:
            lowest.append(float(heights.min()))
    return min(lowest, default=home_h_msl_m or 0.0)


def refractive_index_of(section: AtmosphereSection) -> IndexModel:
    """The formula of the refractive index of air that a mission file states."""
    return IndexModel(section.index, section.wavelength_m, section.co2_ppm)


def constant_ground_m(mission: Mission) -> float | None:
    """The constant height of the ground above sea level [m], None if the mission states none."""
    return mission.ground.constant_m if mission.ground.reference == "msl" else None
