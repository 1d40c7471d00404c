"""The locally adjusted profile of a mission: its sources, checked, and the estimate from them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from unbend.atmosphere import standard_atmosphere, surface_report
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import Climatology, climatology, month_of
from unbend.atmosphere.estimate import adjusted_profile as estimate
from unbend.atmosphere.estimate.adjusted_profile import Adjustment, build_adjusted_profile
from unbend.atmosphere.estimate.candidates import ExternalSources, no_source_used
from unbend.atmosphere.estimate.external_readings import TimeAndPlace, distance_notes
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS, SensorCalibration, SensorSettings
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series import profile_series
from unbend.atmosphere.series.profile_series import Place, TimedProfile
from unbend.atmosphere.series.profiles_by_place import add_model_changes
from unbend.atmosphere.series.time_windows import TimeWindow, estimate_windows
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.soundings.model_field import ModelField, model_column
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.config import Mission
from unbend.config.atmosphere import AtmosphereSection, SurfaceSection
from unbend.errors import InputError
from unbend.flight.stations import NO_TIME, Stations
from unbend.geodesy import longitudes_near
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir, effects_on_r
from unbend.stages.inputs import FlightLog, Track
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.weather_files import FlightArea
from unbend.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K

Levels = tuple[list[float], float]
"""Low, middle and high camera height, and height of the ground [m above sea level]."""

_BIN_M = 100.0


@dataclass(frozen=True, eq=False)
class ModelAir:
    """A weather model about a flight: its fields, and its column where the flight met its air."""

    field: ModelField
    column: Sounding
    place: Place
    track: Track | None

    def place_of(self, samples: AirSamples | None, window: TimeWindow) -> Place:
        """Where and when a part of the flight met the air that is used in it."""
        if samples is None or window.why_not:
            return self.place
        return sampled_place(samples, self.track, window.start_ns, window.end_ns) or self.place


def read_model_air(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, stations: Stations,
    samples: AirSamples, middle: TimeAndPlace, *, ledger: Ledger,
) -> ModelAir | None:  # fmt: skip
    """The weather model of a mission, None where it names none; ``middle`` is that of the flight.

    Refuses (`InputError`) a flight without a time or place, and stations outside its area.
    """
    model, track = inputs.weather_model, flight.track
    if model is None:
        return None
    if middle.time_ns is None or not math.isfinite(middle.latitude_rad + middle.longitude_rad):
        raise InputError.of("MODEL-TIME/flight", model.name)
    of_middle = middle.latitude_rad, middle.longitude_rad, middle.time_ns
    place = sampled_place(samples, track) or of_middle
    levels = (_constant_ground_m(mission), flight.heights.home_h_msl_m)
    ground_h_m = next((h for h in levels if h is not None), math.nan)
    rows = stations.ok & np.isfinite(stations.lat_rad + stations.lon_rad)
    times = np.where(stations.time_ns[rows] == NO_TIME, place[2], stations.time_ns[rows])
    area = FlightArea(
        np.append(stations.lat_rad[rows], place[0]),
        longitudes_near(np.append(stations.lon_rad[rows], place[1]), place[1]),
        np.append(times, place[2]),
    )
    field = model.read(area, ledger)
    field.refuse_outside(area.latitude_rad, area.longitude_rad)
    highest = float(stations.h_msl_m[rows].max(initial=0.0))
    column = ledger.take(model_column(field, place, ground_h_m=ground_h_m, highest_h_m=highest))
    hours = TimeAndPlace(place[2]).hours_from(column.time_ns)
    ledger.note(
        "MODEL-COLUMN", where=model.name, count=column.h_m.size, low=column.h_m[0], hours=hours,
        high=column.h_m[-1], north=place[0] / DEGREE, east=place[1] / DEGREE,
    )  # fmt: skip
    # It is the air where the flight met it: no distance adds to its errors.
    column = replace(column, latitude_rad=middle.latitude_rad, longitude_rad=middle.longitude_rad)
    return ModelAir(field, column, place, track)


def sampled_place(
    samples: AirSamples, track: Track | None, start_ns: int = -(2**62), end_ns: int = 2**62
) -> Place | None:
    """Latitude, longitude and time where a flight met the air that it measured between two times.

    The mean over heights in bins of 100 m: a climb counts more than a long level run. None: no air.
    """
    if track is None:
        return None
    time_ns, latitude, longitude = track
    known = np.isfinite(latitude + longitude)
    for sensor in (samples.temperature, samples.pressure):
        if sensor is None or not bool(known.any()):
            continue
        inside = (sensor.time_ns >= start_ns) & (sensor.time_ns < end_ns)
        rows = sensor.accepted & np.isfinite(sensor.h_m) & inside
        if not bool(rows.any()):
            continue
        first = int(time_ns[0])
        _, number = np.unique(np.floor(sensor.h_m[rows] / _BIN_M), return_inverse=True)
        seconds = (sensor.time_ns[rows] - first) * 1e-9
        at = (time_ns[known] - first) * 1e-9
        east = longitudes_near(longitude[known], float(longitude[known][0]))
        values = [np.interp(seconds, at, v) for v in (latitude[known], east)]
        count = np.bincount(number)
        means = [float(np.mean(np.bincount(number, v) / count)) for v in (*values, seconds)]
        return means[0], means[1], first + round(means[2] * 1e9)
    return None


_LIKELY = 2.0  # sigma that a value in another unit, or reduced, may be off
_LIKE_FAHRENHEIT, _IMPOSSIBLE_SIGMAS = 2.5, 4.0  # too warm, or off: real soundings stay in 2.9
_LIKE_QNH, _IMPOSSIBLE_LEVEL = 3.0, 5.0  # sigma of pressures; weather stays in 5


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
        report = surface_report.parse_metar(
            section.metar, section.h_msl_m, ledger, flight_ns=flight_ns, where=f"{where}.metar"
        )
    else:
        report = surface_report.surface_report(
            section.h_msl_m, temperature_k=section.temperature_k, pressure_pa=section.pressure_pa,
            relative_humidity=section.humidity, time_ns=section.time_ns, where=where,
        )  # fmt: skip
    refuse_impossible(report, background, where, of_metar=section.metar is not None)
    metres, across = 1e3 * section.distance_km, section.across_coast_or_ridge
    return replace(report, distance_m=metres, across=across)


def refuse_impossible(
    report: SurfaceReport, background: Climatology, where: str, *, of_metar: bool
) -> None:
    """Refuse what no season has, or is usual in Fahrenheit or reduced to sea level (no METAR)."""
    celsius, h_m = report.temperature_k - ZERO_CELSIUS_K, report.h_m
    expected = float(background.profile.temperature(h_m))
    sigma = float(background.spread.sigma_temperature(h_m))
    departure = (report.temperature_k - expected) / sigma
    as_fahrenheit = ((celsius - 32.0) / 1.8 + ZERO_CELSIUS_K - expected) / sigma
    mistaken = departure > _LIKE_FAHRENHEIT and abs(as_fahrenheit) < _LIKELY and not of_metar
    if mistaken or abs(departure) > _IMPOSSIBLE_SIGMAS:
        rather = f"; {celsius:.1f} F would be {(celsius - 32.0) / 1.8:.1f} C" if mistaken else ""
        raise InputError.of(
            "SURFACE-CLIMATE", where, celsius=celsius, height_m=h_m, sigmas=abs(departure),
            expected_c=expected - ZERO_CELSIUS_K, rather=rather,
        )  # fmt: skip
    if not math.isfinite(report.pressure_pa):
        return
    expected = float(background.profile.pressure(h_m))
    sigma = background.sigma_log_pressure(h_m)
    departure = math.log(report.pressure_pa / expected) / sigma
    reduced = surface_report.station_pressure(report.pressure_pa, h_m)
    as_qnh = math.log(reduced / expected) / sigma
    mistaken = departure > _LIKE_QNH and abs(as_qnh) < _LIKELY and not of_metar
    if mistaken or abs(departure) > _IMPOSSIBLE_LEVEL:
        rather = f"; as QNH it would be {reduced / HECTOPASCAL:.1f} hPa there" if mistaken else ""
        raise InputError.of(
            "SURFACE-LEVEL", where, hpa=report.pressure_pa / HECTOPASCAL, height_m=h_m,
            sigmas=abs(departure), expected_hpa=expected / HECTOPASCAL, rather=rather,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class AirSources:
    """What a mission has of the air beside its log.

    ``lowest_h_m`` [m above sea level] is the lowest height at which the log sampled the air, else
    that of the take-off, else 0.
    """

    background: Climatology
    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    time_ns: int | None = None
    longitude_rad: float = math.nan
    lowest_h_m: float = 0.0
    model: ModelAir | None = None
    calibration: Mapping[SensorFault, SensorCalibration] = field(default_factory=dict)

    def lines(self) -> list[tuple[str, str]]:
        """A label and a description of each source, for `unbend check`."""
        lines = []
        for sounding in self.soundings:
            time = ""
            if sounding.time_ns is not None:
                time = f" of {np.datetime64(sounding.time_ns, 'ns').astype('datetime64[m]')} UTC"
            h_m = sounding.h_m
            levels = f"{h_m.size} levels from {h_m[0]:.0f} to {h_m[-1]:.0f} m"
            lines.append((sounding.kind, f"{sounding.station}{time}: {levels}, {sounding.origin}"))
        for report in self.surface:
            values = {
                "{:.1f} C": report.temperature_k - ZERO_CELSIUS_K,
                "{:.1f} hPa": report.pressure_pa / HECTOPASCAL,
                "vapour {:.1f} hPa": report.vapour_pressure_pa / HECTOPASCAL,
            }
            known = ", ".join(text.format(v) for text, v in values.items() if np.isfinite(v))
            lines.append(("surface", f"{report.origin} at {report.h_m:.0f} m: {known}"))
        background = self.background
        lines.append(("climatology", f"{background.profile.name}, {background.origin}"))
        if self.calibration:
            lines.append(("sensors", describe_calibration(self.calibration)))
        return lines


def describe_calibration(calibration: Mapping[SensorFault, SensorCalibration]) -> str:
    """Known mean and standard deviation of each sensor error; one that is not known is left out.

    >>> describe_calibration({SensorFault.HYGROMETER_BIAS: SensorCalibration(0.01, 0.02)})
    'hygrometer bias 0.01 ± 0.02'
    """
    parts = []
    for fault, known in calibration.items():
        mean = "" if known.mean is None else f" {known.mean:g}"
        sigma = "" if known.sigma is None else f" ± {known.sigma:g}"
        parts.append(f"{FAULT_TEXTS[fault]}{mean}{sigma}")
    return ", ".join(parts)


def read_air_sources(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    stations: Stations,
    samples: AirSamples,
    *,
    ledger: Ledger,
) -> AirSources:
    """Read soundings, surface reports and weather model of a mission; choose its climatology."""
    section, home_h_msl_m = mission.atmosphere, flight.heights.home_h_msl_m
    flight_ns = _middle_exposure_ns(stations)
    orientation = mission.stations.orientation
    if flight_ns is None and orientation is not None:
        flight_ns = orientation.date_ns
    latitude = stations.mean_latitude_rad
    known = stations.lon_rad[np.isfinite(stations.lon_rad)]
    longitude = float(np.median(known)) if known.size else math.nan
    sensors = [s for s in (samples.pressure, samples.temperature, samples.humidity) if s]
    heights = [s.h_m[np.isfinite(s.h_m)] for s in sensors]
    lowest = min((float(h.min()) for h in heights if h.size), default=home_h_msl_m or 0.0)
    background = climatology(
        section.climatology,
        latitude_rad=latitude,
        month=month_of(flight_ns),
        index=_index_of(section),
        ground_h_m=lowest,
        longitude_rad=longitude if known.size else 0.0,
    )
    soundings: tuple[Sounding, ...] = ()
    for read, s in zip(inputs.soundings, section.soundings, strict=True):
        sounding = read(
            ledger, time_ns=flight_ns, latitude_rad=latitude,
            station_h_m=np.nan if s.station_h_msl_m is None else s.station_h_msl_m,
        )  # fmt: skip
        soundings += (replace(sounding, across=s.across_coast_or_ridge),)
    surface = tuple(
        read_report(s, f"atmosphere.surface[{i}]", flight_ns, background, ledger)
        for i, s in enumerate(section.surface)
    )
    middle = TimeAndPlace(flight_ns, latitude, longitude)
    model = read_model_air(mission, inputs, flight, stations, samples, middle, ledger=ledger)
    soundings += () if model is None else (model.column,)
    ledger.extend(distance_notes(soundings, surface, middle))
    calibration = section.sensors.calibration
    if not section.adjust and (soundings or surface or calibration):
        ledger.warning(
            "AIR-SOURCES-UNUSED", where="atmosphere", soundings=len(soundings),
            surface=len(surface), calibrations=len(calibration),
            count=len(soundings) + len(surface) + len(calibration),
        )  # fmt: skip
    return AirSources(
        background, soundings, surface, flight_ns, longitude, lowest, model, calibration
    )


def _middle_exposure_ns(stations: Stations) -> int | None:
    times = np.sort(stations.time_ns[stations.time_ns != NO_TIME])
    return int(times[times.size // 2]) if times.size else None


def _index_of(section: AtmosphereSection) -> IndexModel:
    return IndexModel(section.index, section.wavelength_m, section.co2_ppm)


def _constant_ground_m(mission: Mission) -> float | None:
    """The one height of the ground above sea level, where the mission file has it."""
    return mission.ground.constant_m if mission.ground.reference == "msl" else None


def adjusted_profiles(
    mission: Mission, stations: Stations, samples: AirSamples, sources: AirSources, ledger: Ledger
) -> FlightAir:
    """The locally adjusted profile of the flight and how it changes with time.

    With ``atmosphere.adjust: false`` it is the standard atmosphere, unchanged. Parts of a long
    flight are estimated on their own where that lowers the uncertainty; between them, and with
    the age of the measurements, each exposure gets the profile of its time.
    """
    section = mission.atmosphere
    latitude = stations.mean_latitude_rad
    standard = replace(standard_atmosphere(section.standard), index=_index_of(section))
    if not section.adjust:
        why = "atmosphere.adjust is false: the standard is kept"
        ledger.note("AIR-NOT-ADJUSTED", why)
        external = ExternalSources(sources.soundings, sources.surface)
        unused = no_source_used(samples, external, standard.name, why)
        kept = estimate.unadjusted(estimate.under_gravity(standard, latitude), why)
        adjustment = replace(kept, sources=unused)
    else:
        adjustment = build_adjusted_profile(
            samples,
            standard,
            latitude,
            ledger,
            settings=SensorSettings(section.board_temperature, sources.calibration),
            background=sources.background,
            soundings=sources.soundings,
            surface=sources.surface,
            time_ns=sources.time_ns,
            longitude_rad=sources.longitude_rad,
        )
    level = _constant_ground_m(mission)
    h_g = sources.lowest_h_m if level is None else level
    heights = stations.h_msl_m[stations.ok]
    h_c = [float(h) for h in np.percentile(heights, [0, 50, 100])] if heights.size else [h_g]
    model = sources.model
    if not any(model and use.source == model.column.name and use.fit for use in adjustment.sources):
        model = None
    return _profiles_in_time(adjustment, stations, (h_c, h_g), model, ledger)


def _profiles_in_time(
    adjustment: Adjustment, stations: Stations, heights: Levels, model: ModelAir | None,
    ledger: Ledger,
) -> FlightAir:  # fmt: skip
    """Profiles of the exposures, each of its time, and of its place where a ``model`` knows it."""
    h_c, h_g = heights
    whole = TimedProfile(
        adjustment.time_ns, adjustment.profile, adjustment.covariance,
        sampled_at=None if model is None else model.place,
    )  # fmt: skip
    windows: tuple[TimeWindow, ...] = ()
    if max(h_c) > h_g + 1.0:
        windows = ledger.take(estimate_windows(adjustment, h_c, h_g))
    if model is not None:
        windows = tuple(
            replace(w, air=replace(w.air, sampled_at=model.place_of(adjustment.samples, w)))
            for w in windows
        )
    series = profile_series.constant_series(whole, len(stations))
    middle = _middle_exposure_ns(stations)
    if middle is not None:
        timed = stations.ok & (stations.time_ns != NO_TIME)
        times = np.where(timed, stations.time_ns, middle)
        if windows:
            airs = [window.air for window in windows]
            series = profile_series.interpolate_series(airs, times, h_c, h_g)
        if adjustment.samples is not None:
            series = ledger.take(
                profile_series.add_ageing(series, times, adjustment.samples, max(h_c), h_g)
            )
        if model is not None:
            north = np.where(stations.ok, stations.lat_rad, np.nan)
            east = longitudes_near(stations.lon_rad, model.place[1])
            series = ledger.take(add_model_changes(
                series, model.field, times, north, east,
                h_c=h_c, h_g=h_g, measured=adjustment.time_ns is not None,
            ))  # fmt: skip
        if not windows and len(stations):
            # The covariance reported for the flight is that at its middle exposure.
            number = series.profile_number[int(np.argmin(np.abs(times - middle)))]
            covariance = series.timed_profiles[number].covariance
            if covariance is not None:
                covariance = replace(covariance, profile=adjustment.profile)
            adjustment = replace(adjustment, covariance=covariance)
    effects = effects_on_r(
        adjustment.profile, adjustment.standard, adjustment.covariance, float(np.median(h_c)), h_g
    )
    return FlightAir(adjustment, series, windows, effects)
