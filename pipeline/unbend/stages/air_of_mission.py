"""The locally adjusted profile of a mission, and how it changes along the flight."""

from dataclasses import dataclass, replace

import numpy as np

from unbend.atmosphere import Profile, standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.estimate.adjusted_profile import (
    Adjustment,
    build_adjusted_profile,
    unadjusted,
    under_gravity,
)
from unbend.atmosphere.estimate.candidates import ExternalSources, no_source_used
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.series.ageing import FlightPath
from unbend.atmosphere.series.profile_series import (
    ProfileSeries,
    TimedProfile,
    add_ageing,
    constant_series,
    interpolate_series,
)
from unbend.atmosphere.series.profiles_by_place import add_model_changes
from unbend.atmosphere.series.time_windows import TimeWindow, estimate_windows
from unbend.config import Mission
from unbend.flight.stations import NO_TIME, Stations, middle_time_ns
from unbend.geodesy import longitudes_near
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir, effects_on_r
from unbend.stages import messages
from unbend.stages.air_sources import (
    AirSources,
    ModelAir,
    constant_ground_m,
    refractive_index_of,
)
from unbend.units import Integers

LEAST_HEIGHT_M = 1.0  # of a camera above ground; lower flights are estimated as a whole


@dataclass(frozen=True)
class CameraHeights:
    """Lowest, median and highest camera height, and height of the ground [m above sea level].

    Without a usable station ``cameras_m`` has one height only, that of the ground.
    """

    cameras_m: list[float]
    ground_m: float


def adjusted_profiles(
    mission: Mission, stations: Stations, samples: AirSamples, sources: AirSources, ledger: Ledger
) -> FlightAir:
    """The locally adjusted profile of the flight, and the profile of each exposure.

    With ``atmosphere.adjust: false`` the profile is the standard atmosphere, unchanged. Parts of a
    long flight are estimated on their own where that lowers the uncertainty; the profile of an
    exposure is interpolated in time between those of the parts. Its uncertainty grows with the age
    of the measurements.
    """
    section = mission.atmosphere
    latitude_rad = stations.mean_latitude_rad
    standard = replace(standard_atmosphere(section.standard), index=refractive_index_of(section))
    if section.adjust:
        adjustment = build_adjusted_profile(
            samples,
            standard,
            latitude_rad,
            ledger,
            settings=SensorSettings(section.board_temperature, sources.calibration),
            background=sources.background,
            soundings=sources.soundings,
            surface=sources.surface,
            time_ns=sources.time_ns,
            longitude_rad=sources.longitude_rad,
            utc_known=sources.utc_known,
            doubt_of_time=sources.doubt_of_time,
        )
    else:
        ledger.add(messages.air_not_adjusted(standard=standard.name))
        adjustment = unadjusted_standard(standard, latitude_rad, samples, sources)
    model = sources.model
    if model is not None and not is_model_used(model, adjustment):
        model = None
    heights = heights_of_mission(mission, stations, sources)
    # With a model, the sigmas grow with distance in `add_model_changes`, not by the path.
    path = sources.path if model is None else None
    return profiles_in_time(adjustment, stations, heights, model, ledger, path=path)


def unadjusted_standard(
    standard: Profile, latitude_rad: float, samples: AirSamples, sources: AirSources
) -> Adjustment:
    """The standard atmosphere with the gravity of a latitude, as a result that used no source.

    Each sample and source is listed as unused, because ``atmosphere.adjust`` is false.
    """
    why = "atmosphere.adjust is false: the standard is kept"
    external = ExternalSources(sources.soundings, sources.surface)
    unused = no_source_used(samples, external, standard.name, why)
    return replace(unadjusted(under_gravity(standard, latitude_rad), why), sources=unused)


def heights_of_mission(mission: Mission, stations: Stations, sources: AirSources) -> CameraHeights:
    """Heights of the cameras and of the ground: the stated constant, else the lowest known height.

    The lowest known height is `AirSources.lowest_h_m`.
    """
    constant_m = constant_ground_m(mission)
    h_g = sources.lowest_h_m if constant_m is None else constant_m
    h_c = stations.h_msl_m[stations.ok]
    if h_c.size == 0:
        return CameraHeights([h_g], h_g)
    return CameraHeights(np.percentile(h_c, [0, 50, 100]).tolist(), h_g)


def is_model_used(model: ModelAir, adjustment: Adjustment) -> bool:
    """Whether the column of a weather model is among the sources that an estimate used."""
    return any(use.source == model.column.name and use.fit for use in adjustment.sources)


def profiles_in_time(
    adjustment: Adjustment,
    stations: Stations,
    heights: CameraHeights,
    model: ModelAir | None,
    ledger: Ledger,
    *,
    path: FlightPath | None = None,
) -> FlightAir:
    """The profile of each exposure for its time, and with a weather ``model`` also for its place.

    Without a model, sigmas grow with the distance between the samples and the exposure, if the
    ``path`` of the flight is given. Exposures without a time, and images without an exposure, get
    the profile of the middle exposure.
    """
    windows = windows_of_flight(adjustment, heights, model, ledger)
    whole_flight = TimedProfile(
        adjustment.time_ns,
        adjustment.profile,
        adjustment.covariance,
        sampled_at=None if model is None else model.place,
    )
    series = constant_series(whole_flight, len(stations))
    middle_ns = middle_time_ns(stations.time_ns)
    if middle_ns is not None:
        is_timed = stations.ok & (stations.time_ns != NO_TIME)
        times_ns = np.where(is_timed, stations.time_ns, middle_ns)
        if windows:
            series = series_between(windows, times_ns, heights)
        if adjustment.samples is not None:
            series = with_ageing(
                series, adjustment.samples, times_ns, heights, path=path, ledger=ledger
            )
        if model is not None:
            is_measured = adjustment.time_ns is not None
            series = with_model_changes(
                series, model, stations, times_ns, heights, is_measured=is_measured, ledger=ledger
            )
        if not windows:  # the reported covariance is that of the middle exposure, with its age
            middle = int(np.argmin(np.abs(times_ns - middle_ns)))
            adjustment = with_covariance_of(adjustment, series, middle)
    effects = effects_on_r(
        adjustment.profile,
        adjustment.standard,
        adjustment.covariance,
        h_c=float(np.median(heights.cameras_m)),
        h_g=heights.ground_m,
    )
    return FlightAir(adjustment, series, windows, effects)


def windows_of_flight(
    adjustment: Adjustment, heights: CameraHeights, model: ModelAir | None, ledger: Ledger
) -> tuple[TimeWindow, ...]:
    """The parts of a flight that are estimated on their own.

    Empty if one estimate is enough, or if no camera is 1 m above the ground.
    """
    is_above_ground = max(heights.cameras_m) > heights.ground_m + LEAST_HEIGHT_M
    if not is_above_ground:
        return ()
    windows = ledger.take(estimate_windows(adjustment, heights.cameras_m, heights.ground_m))
    if model is None:
        return windows
    return tuple(window_of_model(window, model, adjustment) for window in windows)


def series_between(
    windows: tuple[TimeWindow, ...], times_ns: Integers, heights: CameraHeights
) -> ProfileSeries:
    """The profiles at the times (s,) of the exposures, interpolated between parts of a flight."""
    profiles = [window.air for window in windows]
    return interpolate_series(profiles, times_ns, heights.cameras_m, heights.ground_m)


def with_ageing(
    series: ProfileSeries,
    samples: AirSamples,
    times_ns: Integers,
    heights: CameraHeights,
    *,
    path: FlightPath | None,
    ledger: Ledger,
) -> ProfileSeries:
    """The profiles with sigmas that grow with the time between samples and exposures.

    ``times_ns`` (s,) are those of the exposures. With a ``path`` of the flight, sigmas also grow
    with the distance between the places of the samples and of the exposures.
    """
    aged = add_ageing(
        series,
        times_ns,
        samples,
        max(heights.cameras_m),
        heights.ground_m,
        path=path,
    )
    return ledger.take(aged)


def with_model_changes(
    series: ProfileSeries,
    model: ModelAir,
    stations: Stations,
    times_ns: Integers,
    heights: CameraHeights,
    *,
    is_measured: bool,
    ledger: Ledger,
) -> ProfileSeries:
    """The profiles changed as the air of a weather model changes in time and place of exposures.

    ``times_ns`` (s,) are those of the exposures; ``is_measured`` is True if the profiles come from
    measurements with a time.
    """
    latitude_rad = np.where(stations.ok, stations.lat_rad, np.nan)
    longitude_rad = longitudes_near(stations.lon_rad, model.place.longitude_rad)
    return ledger.take(
        add_model_changes(
            series,
            model.field,
            times_ns,
            latitude_rad,
            longitude_rad,
            h_c=heights.cameras_m,
            h_g=heights.ground_m,
            measured=is_measured,
        )
    )


def with_covariance_of(adjustment: Adjustment, series: ProfileSeries, station: int) -> Adjustment:
    """The estimate with the covariance of one station's profile, which reports give for all.

    ``station`` is a row of the stations.
    """
    number = series.profile_number[station]
    covariance = series.timed_profiles[number].covariance
    if covariance is not None:
        covariance = replace(covariance, profile=adjustment.profile)
    return replace(adjustment, covariance=covariance)


def window_of_model(window: TimeWindow, model: ModelAir, adjustment: Adjustment) -> TimeWindow:
    """A part of a flight with the place and time at which its air was sampled.

    The changes of a weather model count from there.
    """
    place = model.place_of(adjustment.samples, window)
    return replace(window, air=replace(window.air, sampled_at=place))
