"""The record of a mission's results, for its manifest."""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from unbend.atmosphere.air_samples import SensorUse
from unbend.atmosphere.estimate.candidates import SourceUse
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS
from unbend.atmosphere.estimate.solver import FaultEstimate
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.atmosphere.series.time_windows import TimeWindow
from unbend.config import Mission
from unbend.exit_codes import exit_code_of
from unbend.flight.heights import HeightSystem
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import NO_TIME, Stations
from unbend.ingest import Log
from unbend.messages import Ledger
from unbend.refraction.camera.camera import NO_DISTORTION, Camera
from unbend.refraction.effect import FlightAir
from unbend.refraction.kernels.columns import CABIN_SIGMAS, WINDOW_KIND
from unbend.stages.camera_air import camera_air_records
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.flight_log import FlightLog, Roles
from unbend.stages.statistics import Statistics
from unbend.tables.manifest.results import (
    AirParameter,
    CabinParameter,
    ControlRecord,
    DeflectionRecord,
    EffectRecord,
    FittedSource,
    FlightRecord,
    FlownCamera,
    GroundReference,
    HeightsRecord,
    LogRecord,
    ObservationsRecord,
    OtherSource,
    ProfileRecord,
    ResultsRecord,
    SamplesRecord,
    SensorRecord,
    TimeWindowRecord,
    UndulationRecord,
)
from unbend.tables.refraction_mark import REFRACTION_APPLIED, REFRACTION_KEY, REFRACTION_REMOVED
from unbend.units import ARCSEC, Array

AIR_PARAMETER = (
    "scale_sigma: prior standard deviation of the one parameter s of the leading mode of the air's "
    "covariance. For a value of s, the coordinates are the corrected ones plus s dx_ds_px, s "
    "dy_ds_px, also behind a plane window. variance_share: the part of the variance of these "
    "coordinates by the air (sigma_air) that this mode has. If there are several profiles, s moves "
    "each of them along its own leading mode"
)

IN_VIEW = 0.05  # cosine of the nadir angle of the axis; below it the nadir is in no image


def observation_metadata(mission: Mission) -> dict[str, str]:
    """Metadata of the Parquet table of observations, in addition to units and conventions."""
    removed = mission.refraction.direction == "remove"
    mark = REFRACTION_REMOVED if removed else REFRACTION_APPLIED
    metadata = {
        REFRACTION_KEY.decode(): mark.decode(),
        "unbend.mission": mission.mission.name,
        "unbend.pixel_origin": mission.observations.pixel_origin,
        "unbend.ground_reference": mission.ground.reference,
    }
    if mission.wavelengths_m:
        lights = dict.fromkeys(mission.cameras, mission.atmosphere.wavelength_m)
        metadata["unbend.wavelength_m"] = json.dumps(lights | mission.wavelengths_m)
    return metadata


def results_of_mission(  # noqa: PLR0913
    mission: Mission,
    flight: FlightLog,
    stations: Stations,
    air: FlightAir,
    *,
    statistics: Statistics,
    setup: CorrectionSetup,
    causes: Mapping[str, str],
    control: ControlRecord | None,
    lit_air: ProfileSeries,
    ledger: Ledger,
) -> ResultsRecord:
    """The record of the results for the manifest.

    ``causes`` has the likely cause of each status of rows; those of statuses that no row has are
    left out. ``lit_air`` are the profiles of the setup, each in the light of its cameras. The
    record has no clock time, host name or absolute path: the same inputs give the same bytes.
    """
    flight_record = record_of_flight(stations, setup, statistics)
    causes_in_run = {}
    for status, cause in causes.items():
        if statistics.status.get(status):
            causes_in_run[status] = cause
    return ResultsRecord(
        log=None if flight.log is None else record_of_log(flight.log),
        channels={role: channel.name for role, channel in sorted(flight.roles.items())},
        stations=dict(sorted(Counter(stations.status.tolist()).items())),
        flight=flight_record,
        heights=record_of_heights(mission, flight.heights, flight.roles, stations),
        profile=record_of_profile(air, stations),
        observations=ObservationsRecord(
            rows=statistics.rows,
            parts=statistics.parts,
            status=statistics.status,
            causes=causes_in_run,
        ),
        correction=statistics.correction(),
        sigma_budget=statistics.sigma_budget(setup.camera_number),
        ground_heights=statistics.ground_heights(),
        uncertainty=air_parameter(setup, statistics, len(air.series.timed_profiles)),
        cabin_air=cabin_parameters(setup),
        cabin_sigma_share=statistics.cabin_share.summary(),
        control=control,
        ledger=ledger.records(),
        exit_code=exit_code_of(has_losses=ledger.has_losses),
        air_at_cameras=camera_air_records(
            mission,
            stations,
            lit_air,
            cameras=setup.cameras,
            flown=flight_record.cameras,
            effects=air.effects,
        ),
    )


def record_of_log(log: Log) -> LogRecord:
    """What was decoded from a log, and what was damaged or missing in it."""
    return LogRecord(
        format=log.format,
        messages=dict(log.messages),
        bad_bytes=log.bad_bytes,
        lost_messages=log.lost_messages,
        boots=log.boots,
        duration_s=round(log.duration_s, 3),
        time_base=log.time_base,
    )


def record_of_flight(
    stations: Stations, setup: CorrectionSetup, statistics: Statistics
) -> FlightRecord:
    """When and where the exposures are, and what the cameras see."""
    ok = stations.ok
    time_ns = stations.utc_ns[ok & (stations.utc_ns != NO_TIME)]
    rows = statistics.sampled_rows()
    # The extra last height, NaN, is for rows without a station: their station number is -1.
    station_height_m = np.append(np.where(ok, stations.h_msl_m, np.nan), np.nan)
    above_m = station_height_m[rows.station] - rows.h_g_m
    camera_of_row = setup.camera_number[rows.station]
    cameras = {}
    for number, (name, camera) in enumerate(setup.cameras.items()):
        of_camera = above_m[camera_of_row == number]
        cameras[name] = record_of_camera(name, camera, stations, of_camera)
    return FlightRecord(
        begin_utc=utc_second(int(time_ns.min())) if time_ns.size else None,
        end_utc=utc_second(int(time_ns.max())) if time_ns.size else None,
        latitude_deg=lowest_median_highest(np.degrees(stations.lat_rad[ok]), 6),
        longitude_deg=lowest_median_highest(np.degrees(stations.lon_rad[ok]), 6),
        h_msl_m=lowest_median_highest(stations.h_msl_m[ok], 1),
        cameras=cameras,
    )


def lowest_median_highest(values: Array, digits: int) -> list[float] | None:
    """Lowest, median and highest of the known values, rounded; None without any."""
    known_values = values[np.isfinite(values)]
    if not known_values.size:
        return None
    return [
        round(float(part), digits)
        for part in (known_values.min(), np.median(known_values), known_values.max())
    ]


def record_of_camera(name: str, camera: Camera, stations: Stations, above_m: Array) -> FlownCamera:
    """A camera, and the median direction of the nadir at its exposures.

    ``above_m`` are its heights above the points that it sees [m].
    """
    of_camera = stations.camera == name
    down = -matrices_of(stations.quaternion)[:, :, 2]  # (s, 3) the nadir in the camera frame
    nadir = down[stations.ok & of_camera]
    nadir = nadir[np.isfinite(nadir).all(axis=1)]
    x, y, z = np.zeros(3)  # unknown: no angle, and no nadir in the image
    if len(nadir):
        x, y, z = np.median(nadir, axis=0)
    angle_deg = None
    norm = math.hypot(x, y, z)
    if norm > 0.0:
        angle_deg = round(float(np.degrees(np.arccos(z / norm))), 2)
    return FlownCamera(
        exposures=int(of_camera.sum()),
        format_px=[camera.width_px, camera.height_px],
        principal_distance_px=float(f"{camera.fx_px:.10g}"),
        height_above_ground_m=lowest_median_highest(above_m, 1),
        axis_nadir_angle_deg=angle_deg,
        nadir_px=nadir_pixel(camera, x, y, z),
        principal_point_px=[float(f"{camera.cx_px:.10g}"), float(f"{camera.cy_px:.10g}")],
    )


def nadir_pixel(camera: Camera, x: float, y: float, z: float) -> list[float] | None:
    """The pixel of the nadir, which has the direction (x, y, z) in the camera frame.

    None if the nadir is not in front of the camera. Beyond the largest radius at which the
    distortion is known, the pixel is computed without distortion.
    """
    if z <= IN_VIEW:
        return None
    model = camera
    is_distortion_known = np.hypot(x, y) < camera.largest_radius * z
    if not is_distortion_known:
        model = replace(camera, distortion=NO_DISTORTION)
    pixel_x, pixel_y = model.project(np.array([x / z]), np.array([y / z]))[:2]
    return [round(float(pixel_x[0]), 1), round(float(pixel_y[0]), 1)]


def record_of_heights(
    mission: Mission, heights: HeightSystem, roles: Roles, stations: Stations
) -> HeightsRecord:
    """What heights refer to, the undulation, and the deflection of the vertical.

    ``log`` in the record lists which heights the log has: msl, ellipsoid.
    """
    ground = mission.ground
    points = ground.points
    orientation = mission.stations.orientation
    height = roles.get("height")
    logged_heights = []
    if height is not None:
        for name, column in (("msl", "h_msl_m"), ("ellipsoid", "h_ellipsoid_m")):
            if np.isfinite(height.columns.get(column, np.nan)).any():
                logged_heights.append(name)
    source = None if height is None else height.name
    return HeightsRecord(
        all="above mean sea level",
        log=logged_heights,
        stations=source if orientation is None else orientation.path,
        ground=GroundReference(ground.reference, None if points is None else points.crs),
        take_off_h_msl_m=heights.home_h_msl_m,
        undulation=record_of_undulation(heights, stations),
        deflection=record_of_deflection(heights, stations, applies=orientation is None),
    )


def record_of_undulation(heights: HeightSystem, stations: Stations) -> UndulationRecord:
    """The least and largest undulation at the stations [m]; None if it is unknown."""
    undulation = (stations.h_ellipsoid_m - stations.h_msl_m)[stations.ok]
    undulation = undulation[np.isfinite(undulation)]
    return UndulationRecord(
        source=heights.source,
        min_m=round(float(undulation.min()), 3) if undulation.size else None,
        max_m=round(float(undulation.max()), 3) if undulation.size else None,
    )


def record_of_deflection(
    heights: HeightSystem, stations: Stations, *, applies: bool
) -> DeflectionRecord:
    """The median deflection of the vertical at the stations ["]; None without a geoid.

    ``applies`` is True if the attitudes refer to the vertical, as those of a log do.
    """
    geoid = heights.geoid
    if geoid is None:
        return DeflectionRecord(None, None, None, applies)
    ok = stations.ok
    # (2, s): north and east.
    deflection = np.array(geoid.deflection(stations.lat_rad[ok], stations.lon_rad[ok])) / ARCSEC
    deflection = deflection[:, np.isfinite(deflection).all(axis=0)]
    if not deflection.size:
        return DeflectionRecord(geoid.name, None, None, applies)
    north, east = np.median(deflection, axis=1).tolist()
    return DeflectionRecord(geoid.name, round(north, 2), round(east, 2), applies)


def air_parameter(
    setup: CorrectionSetup, statistics: Statistics, profiles: int
) -> AirParameter | None:
    """The parameter of the leading mode of the air; None if no profile has a covariance.

    ``profiles`` is the number of profiles of the flight; the setup may have more, one for each
    wavelength.
    """
    modes = []
    for uncertainty in setup.uncertainties:
        if uncertainty is not None and uncertainty.mode is not None:
            modes.append(uncertainty.mode)
    if not modes:
        return None
    mode = modes[0]  # all modes have the same sigma, see `with_common_scale`
    if statistics.air_variance > 0.0:
        variance_share = mode.sigma**2 * statistics.by_mode / statistics.air_variance
    else:  # no row has a sigma: take the share in the rays that the mode was computed for
        variance_share = mode.variance_share
    return AirParameter(
        scale_sigma=mode.sigma,
        variance_share=float(f"{variance_share:.4g}"),
        profiles=min(len(modes), profiles),
        meaning=AIR_PARAMETER,
    )


def cabin_parameters(setup: CorrectionSetup) -> dict[str, CabinParameter]:
    """The refractivity in the cabin of each camera behind a plane window, and its sigma.

    Refractivity is averaged over the camera's exposures in the first profile with standard
    deviations; the sigma is the root mean square over them.
    """
    uncertainty = next(filter(None, setup.uncertainties), None)  # the first that is not None
    if uncertainty is None:
        return {}
    cameras = {}
    table = uncertainty.stations
    behind_window = table[:, WINDOW_KIND] >= 0.0  # -1 without a plane window, or in other profiles
    for name in setup.cameras:
        rows = (setup.camera_names == name) & setup.exposures.usable & behind_window
        if not bool(rows.any()):
            continue
        inside = setup.exposures.refractivity_cabin[rows]
        sigmas = table[rows, CABIN_SIGMAS : CABIN_SIGMAS + 2]  # by pressure and by temperature
        sigma = np.sqrt(np.mean(np.sum(sigmas**2, axis=1)))
        cameras[name] = CabinParameter(
            n_cc=float(f"{inside.mean():.6g}"),
            sigma_n_cc=float(f"{sigma:.4g}") if np.isfinite(sigma) else None,
        )
    return cameras


def record_of_profile(air: FlightAir, stations: Stations) -> ProfileRecord:
    """The estimate of the air, its sources, and its difference from the standard atmosphere.

    The difference is that of the temperature at the median height of the stations in use [K].
    """
    adjustment = air.adjustment
    profile = adjustment.profile
    standard = adjustment.standard
    latitude = profile.gravity.latitude_rad
    heights = stations.h_msl_m[stations.ok]
    departure = None
    sigma_departure = None
    if heights.size:
        median_h_m = float(np.median(heights))
        departure = rounded(profile.temperature(median_h_m) - standard.temperature(median_h_m))
        if adjustment.covariance is not None:
            sigma_departure = rounded(adjustment.covariance.sigma_temperature(median_h_m))
    return ProfileRecord(
        basis=adjustment.basis,
        reason=adjustment.reason,
        standard=standard.name,
        layers=dict(sorted(Counter(profile.layers.source).items())),
        latitude_deg=None if latitude is None else round(float(np.degrees(latitude)), 6),
        departure_at_cameras_k=departure,
        sigma_departure_at_cameras_k=sigma_departure,
        effect=[EffectRecord.of(effect) for effect in air.effects],
        sources=[record_of_source(use) for use in adjustment.sources],
        samples=[record_of_samples(use) for use in adjustment.sensor_uses],
        sensors=[record_of_sensor(estimate) for estimate in adjustment.faults],
        profiles=len(air.series.timed_profiles),
        windows=[
            record_of_window(window, utc_known=adjustment.utc_known) for window in air.windows
        ],
    )


def rounded(value: Array) -> float | None:
    """A single number rounded to three decimals; None if it is not finite."""
    number = float(np.squeeze(value))
    return round(number, 3) if math.isfinite(number) else None


def record_of_source(use: SourceUse) -> FittedSource | OtherSource:
    """How a source of the air was used, or why it was not used."""
    fit = use.fit
    if fit is None:
        return OtherSource(use.source, used=not use.why_not, why_not=use.why_not)
    return FittedSource(
        source=use.source,
        used=True,
        quantity=fit.quantity,
        readings=fit.count,
        rms_sigma=round(fit.rms, 3),
        sigma_inflation=round(fit.sigma_inflation, 3),
        degrees_of_freedom_for_signal=round(fit.signal_freedom, 3),
    )


def record_of_samples(use: SensorUse) -> SamplesRecord:
    """How many samples of a sensor were used, and why the others were not."""
    return SamplesRecord(
        sensor=use.sensor,
        quantity=use.quantity,
        samples=use.samples,
        used=use.used,
        rejected={reason.text: count for reason, count in use.rejected.items()},
    )


def record_of_sensor(estimate: FaultEstimate) -> SensorRecord:
    """The estimated error of a sensor, in the unit in which it is reported."""
    fault = estimate.in_units()
    return SensorRecord(
        what=FAULT_TEXTS[fault.fault],
        value=round(fault.value, 4),
        sigma=round(fault.sigma, 4),
        expected_sigma=round(fault.prior_sigma, 4),
    )


def record_of_window(window: TimeWindow, *, utc_known: bool) -> TimeWindowRecord:
    """A part of a flight that was estimated on its own; without UTC its times are None."""
    return TimeWindowRecord(
        start_utc=utc_second(window.start_ns) if utc_known else None,
        end_utc=utc_second(window.end_ns) if utc_known else None,
        change=round(window.change, 5),
        sigma=round(window.sigma, 5),
        why_not=window.why_not,
    )


def utc_second(time_ns: int) -> str:
    """A time [Unix ns] as text in ISO 8601, rounded down to a second."""
    return f"{np.datetime64(time_ns, 'ns').astype('datetime64[s]')}Z"
