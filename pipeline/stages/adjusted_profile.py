"""The sources of the air in a mission, and the air that comes of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.atmosphere import standard_atmosphere
from pipeline.atmosphere.air_samples import AirSamples, SensorCalibration
from pipeline.atmosphere.climatology import Climatology, climatology, month_of
from pipeline.atmosphere.estimate.adjusted_profile import (
    build_adjusted_profile,
    unadjusted,
    under_gravity,
)
from pipeline.atmosphere.estimate.representativeness import TimeAndPlace, note_source_distances
from pipeline.atmosphere.estimate.source_usage import all_unused
from pipeline.atmosphere.refractive_index import IndexModel
from pipeline.atmosphere.series.profile_series import (
    TimedProfile,
    add_ageing,
    constant_series,
    interpolate_series,
)
from pipeline.atmosphere.series.time_windows import estimate_windows
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport
from pipeline.batch.plan import Plan, sounding_role
from pipeline.config import Mission
from pipeline.config.atmosphere import AtmosphereSection
from pipeline.flight.stations import NO_TIME, Stations
from pipeline.ledger import Ledger
from pipeline.refraction.effect import FlightAir, effects_on_r
from pipeline.stages.surface_reports import read_report
from pipeline.tables.soundings import read_sounding
from pipeline.units import ZERO_CELSIUS_K


@dataclass(frozen=True, eq=False)
class AirSources:
    """What a mission knows of the air beside its log."""

    background: Climatology
    soundings: tuple[Sounding, ...] = ()
    surface: tuple[SurfaceReport, ...] = ()
    time_ns: int | None = None
    longitude_rad: float = math.nan
    home_h_msl_m: float | None = None
    calibration: Mapping[str, SensorCalibration] = field(default_factory=dict)

    def lines(self) -> list[tuple[str, str]]:
        """For a person."""
        return [
            *(("sounding", _told_of_sounding(sounding)) for sounding in self.soundings),
            *(("surface", _told_of_report(report)) for report in self.surface),
            ("climatology", f"{self.background.profile.name}, {self.background.origin}"),
            *([("sensors", told_of_calibration(self.calibration))] if self.calibration else []),
        ]


def find_sources(
    plan: Plan,
    stations: Stations,
    samples: AirSamples,
    ledger: Ledger,
    home_h_msl_m: float | None = None,
) -> AirSources:
    """Read the soundings and surface reports of a mission, and choose its climatology.

    ``home_h_msl_m`` is the take-off height, that of the ground where the log sampled no air.
    Refuses what cannot be read, and values that no ground has (``InputError``).
    """
    section = plan.mission.atmosphere
    flight_ns = _time_of(stations)
    latitude = stations.mean_latitude_rad
    known = stations.lon_rad[np.isfinite(stations.lon_rad)]
    longitude = float(np.median(known)) if known.size else math.nan
    low = _lowest(samples, home_h_msl_m)
    background = climatology(
        section.climatology,
        latitude_rad=latitude,
        month=month_of(flight_ns),
        index=_index_of(section),
        ground_h_m=low,
        longitude_rad=longitude if known.size else 0.0,
    )
    soundings = tuple(
        read_sounding(
            plan.input(sounding_role(i)).path,
            ledger,
            format_name=s.format,
            time_ns=flight_ns,
            latitude_rad=latitude,
            station_h_m=np.nan if s.station_h_msl_m is None else s.station_h_msl_m,
        )
        for i, s in enumerate(section.soundings)
    )
    surface = tuple(
        read_report(s, f"atmosphere.surface[{i}]", flight_ns, background, ledger)
        for i, s in enumerate(section.surface)
    )
    note_source_distances(soundings, surface, TimeAndPlace(flight_ns, latitude, longitude), ledger)
    calibration = section.sensors.calibration
    if not section.adjust and (soundings or surface or calibration):
        ledger.warning(
            "AIR-SOURCES-UNUSED",
            f"atmosphere.adjust is false: {len(soundings)} soundings, {len(surface)} surface "
            f"reports and what is known of {len(calibration)} faults of sensors are not used",
            where="atmosphere",
            count=len(soundings) + len(surface) + len(calibration),
        )
    return AirSources(
        background, soundings, surface, flight_ns, longitude, home_h_msl_m, calibration
    )


def _time_of(stations: Stations) -> int | None:
    """The middle exposure [Unix ns]."""
    times = np.sort(stations.time_ns[stations.time_ns != NO_TIME])
    return int(times[times.size // 2]) if times.size else None


def _index_of(section: AtmosphereSection) -> IndexModel:
    return IndexModel(section.index, section.wavelength_m, section.co2_ppm)


def _lowest(samples: AirSamples, home_h_msl_m: float | None) -> float:
    """Lowest height that was sampled [m above sea level], else the take-off's, else the sea's."""
    sensors = [s for s in (samples.pressure, samples.temperature, samples.humidity) if s]
    heights = [s.h_m[np.isfinite(s.h_m)] for s in sensors]
    return min((float(h.min()) for h in heights if h.size), default=home_h_msl_m or 0.0)


def adjust_air(
    mission: Mission, stations: Stations, samples: AirSamples, sources: AirSources, ledger: Ledger
) -> FlightAir:
    """The locally adjusted air of the flight, or the standard where the user wants that."""
    section = mission.atmosphere
    latitude = stations.mean_latitude_rad
    standard = replace(standard_atmosphere(section.standard), index=_index_of(section))
    h_c, h_g = _levels(mission, stations, samples, sources.home_h_msl_m)
    if not section.adjust:
        why = "atmosphere.adjust is false: the standard is kept"
        ledger.note("AIR-NOT-ADJUSTED", why)
        unused = all_unused(samples, sources.soundings, sources.surface, standard.name, why)
        adjustment = replace(unadjusted(under_gravity(standard, latitude), why), sources=unused)
    else:
        adjustment = build_adjusted_profile(
            replace(
                samples,
                board_temperature=section.board_temperature,
                calibration=sources.calibration,
            ),
            standard,
            latitude,
            ledger,
            background=sources.background,
            soundings=sources.soundings,
            surface=sources.surface,
            time_ns=sources.time_ns,
            longitude_rad=sources.longitude_rad,
        )
    whole = TimedProfile(adjustment.time_ns, adjustment.profile, adjustment.covariance)
    windows = estimate_windows(adjustment, h_c, h_g, ledger) if max(h_c) > h_g + 1.0 else ()
    series = constant_series(whole, len(stations))
    middle = _time_of(stations)
    if middle is not None:
        times = np.where(stations.ok, stations.time_ns, middle)
        if windows:
            series = interpolate_series([window.air for window in windows], times, h_c, h_g)
        if adjustment.samples is not None:
            series = add_ageing(series, times, adjustment.samples, max(h_c), h_g, ledger)
        if not windows and len(stations):
            # What is told of the flight is told of its middle exposure.
            number = series.profile_number[int(np.argmin(np.abs(times - middle)))]
            adjustment = replace(adjustment, covariance=series.timed_profiles[number].covariance)
    effects = effects_on_r(
        adjustment.profile, adjustment.standard, adjustment.covariance, float(np.median(h_c)), h_g
    )
    return FlightAir(adjustment, series, windows, effects)


def _levels(
    mission: Mission, stations: Stations, samples: AirSamples, home_h_msl_m: float | None
) -> tuple[list[float], float]:
    """Heights of cameras (low, middle, high) and of the ground [m above sea level]."""
    ground = mission.ground.constant_m if mission.ground.reference == "msl" else None
    h_g = ground if ground is not None else _lowest(samples, home_h_msl_m)
    heights = stations.h_msl_m[stations.ok]
    if heights.size == 0:
        return [h_g], h_g
    return [float(h) for h in np.percentile(heights, [0.0, 50.0, 100.0])], h_g


def told_of_calibration(calibration: Mapping[str, SensorCalibration]) -> str:
    """What is known of the sensors, in words; where only one of mean and sigma is, the other not.

    >>> told_of_calibration({"bias": SensorCalibration(0.01, 0.02)})
    'bias 0.01 ± 0.02'
    """
    told = []
    for name, known in calibration.items():
        mean = "" if known.mean is None else f" {known.mean:g}"
        sigma = "" if known.sigma is None else f" ± {known.sigma:g}"
        told.append(f"{name}{mean}{sigma}")
    return ", ".join(told)


def _told_of_sounding(sounding: Sounding) -> str:
    when = ""
    if sounding.time_ns is not None:
        when = f" of {np.datetime64(sounding.time_ns, 'ns').astype('datetime64[m]')} UTC"
    return (
        f"{sounding.station}{when}: {sounding.h_m.size} levels from {sounding.h_m[0]:.0f} to "
        f"{sounding.h_m[-1]:.0f} m, {sounding.origin}"
    )


def _told_of_report(report: SurfaceReport) -> str:
    parts: list[tuple[float, Callable[[float], str]]] = [
        (report.temperature_k, lambda t: f"{t - ZERO_CELSIUS_K:.1f} C"),
        (report.pressure_pa, lambda p: f"{p / 100.0:.1f} hPa"),
        (report.vapour_pressure_pa, lambda e: f"vapour {e / 100.0:.1f} hPa"),
    ]
    told = ", ".join(say(value) for value, say in parts if np.isfinite(value))
    return f"{report.origin} at {report.h_m:.0f} m: {told}"
