"""How well air, stations and ground of a mission are known, and the sigmas of the corrections."""

from dataclasses import replace

import numpy as np
import pyarrow as pa

from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.config import Mission
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.uncertainty.budget import StationSigmas, uncertainty_of
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, Uncertainty, window_kind_of
from unbend.stages.cabin_air import cabin_changes
from unbend.stages.correction_setup import CorrectionSetup
from unbend.tables.geodata.object_points import matching_rows
from unbend.tables.observations import Batch
from unbend.units import Integers

TYPICAL_ROWS = 2000
"""The first rows of a table, whose ground is that of the leading mode of the air."""


def with_uncertainties(
    setup: CorrectionSetup, mission: Mission, stations: Stations, air: ProfileSeries, batch: Batch
) -> CorrectionSetup:
    """The setup with what standard deviations and derivatives are computed from, for each profile.

    The leading mode of the air is that of rays to the median height of the points of a ``batch``.
    None for a profile without covariance where neither the mission file nor a window has anything
    to compute. Of several profiles each has its own leading mode and all have one parameter: their
    errors are taken as one, which moves R of all to the same side.
    """
    station = matching_rows(batch.image, pa.array(setup.images, pa.string()))
    heights = setup.ground.heights(batch, station, setup).h_m
    heights = heights[np.isfinite(heights)]
    typical_ground_m = float(np.median(heights)) if heights.size else None
    ground, exposures = mission.ground, setup.exposures
    views = views_of_mission(mission, stations, air)
    cabin = cabin_changes(stations, mission.lenses, air.profiles[0].index)
    attitude = station_sigmas(mission, stations)
    any_sigma = (
        bool(np.isfinite(attitude.tilt_rad[stations.ok]).any())
        or ground.sigma_m is not None
        or ground.sigma_column is not None
        or bool(((views != OPEN) | np.isfinite(cabin).any(axis=1)).any())
    )
    sigmas = replace(attitude, cabin=cabin)
    masks = [(camera, stations.camera == name) for name, camera in setup.cameras.items()]
    uncertainties: list[Uncertainty | None] = []
    for number, timed in enumerate(air.timed_profiles):
        covariance = timed.covariance
        if covariance is None and not any_sigma:
            uncertainties.append(None)
            continue
        in_profile = replace(exposures, usable=exposures.usable & (air.profile_number == number))
        uncertainties.append(uncertainty_of(
            timed.profile, covariance, in_profile, sigmas, masks, window_kinds=views,
            ground_heights_m=setup.ground.limits, typical_ground_m=typical_ground_m,
        ))  # fmt: skip
    scales = [u.mode.sigma for u in uncertainties if u is not None and u.mode is not None]
    common = float(f"{np.sqrt(np.mean(np.square(scales))):.6g}") if scales else np.nan
    scaled = tuple(u and u.with_scale(common) for u in uncertainties)
    return replace(setup, uncertainties=scaled)


def views_of_mission(mission: Mission, stations: Stations, air: ProfileSeries) -> Integers:
    """(s,) the kind of window of each exposure: `OPEN`, `SEALED` or `SCHEDULED`."""
    views = np.full(len(stations), OPEN, np.int64)
    pressure = air.pressure(stations.h_msl_m)
    for name, window in mission.windows.items():
        if window.shape == "plane" and window.cabin is not None:
            rows = stations.camera == name
            scheduled = window.cabin.source == "standard_schedule"
            views[rows] = window_kind_of(pressure[rows], scheduled=scheduled)
            if window.cabin.source == "ambient":
                views[rows] = SCHEDULED
    return views


def station_sigmas(mission: Mission, stations: Stations) -> StationSigmas:
    """Sigmas of the stations, of the attitude the mission file's where they have none; or NaN."""
    tilt, yaw = stations.sigma_tilt_rad.copy(), stations.sigma_yaw_rad.copy()
    axis = np.tile([0.0, 0.0, 1.0], (len(stations), 1))
    for name, mount in mission.mounts.items():
        rows = stations.camera == name
        axis[rows] = mount.camera_from_body[:, 2]
        for sigma, stated in ((tilt, mount.sigma_tilt_rad), (yaw, mount.sigma_yaw_rad)):
            sigma[rows & np.isnan(sigma)] = np.nan if stated is None else stated
    return StationSigmas(tilt, yaw, axis, stations.sigma_height_m)


def report_unknown_sigmas(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> None:
    """Note which standard deviations are missing from the sigma columns, in one entry."""
    missing = []
    if not all(timed.has_covariance for timed in air.timed_profiles):
        missing.append("the air (its profile has no covariance)")
    unknown = stations.ok & np.isnan(station_sigmas(mission, stations).tilt_rad)
    cameras = sorted(set(stations.camera[unknown].tolist()))
    missing += [f"the attitude (mount.{name}.sigma_tilt_deg)" for name in cameras]
    if mission.ground.sigma_m is None and mission.ground.sigma_column is None:
        missing.append("the ground (ground.sigma_m or ground.sigma_column)")
    heights = int((stations.ok & ~np.isfinite(stations.sigma_height_m)).sum())
    if heights:
        missing.append(f"the height of {heights} stations (not in the log; it does not count)")
    of_cabins = {
        "sigma_pressure_hpa": stations.sigma_cabin_pressure_pa,
        "sigma_temperature_k": stations.sigma_cabin_temperature_k,
    }
    for name, window in mission.windows.items():
        rows = (stations.camera == name) & stations.ok & (window.shape == "plane")
        for key, sigma in of_cabins.items():
            if bool(np.isnan(sigma[rows]).any()):
                missing.append(f"the cabin's air (cameras.{name}.window.cabin.{key})")
    if missing:
        listed = ", ".join(missing)
        ledger.note("SIGMA-UNKNOWN", where="observations", count=len(missing), missing=listed)
