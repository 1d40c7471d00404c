"""How well air, stations and ground of a mission are known, and what that does to corrections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.series.profile_series import ProfileSeries
from pipeline.config import Mission
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures
from pipeline.refraction.ray import DEFAULT_RADIUS_M
from pipeline.refraction.uncertainty.air_sigma import OPEN, view_of
from pipeline.refraction.uncertainty.budget import (
    BlockScale,
    StationSigmas,
    Views,
    block_scale,
    uncertainty_of,
)
from pipeline.refraction.uncertainty.sigmas import Uncertainty
from pipeline.stages.ground import Ground
from pipeline.stages.statistics import Tally
from pipeline.units import DEGREE


def uncertainties_of_mission(
    mission: Mission,
    stations: Stations,
    air: ProfileSeries,
    exposures: Exposures,
    cameras: Mapping[str, Camera],
    ground: Ground,
    views: NDArray[np.int64],
) -> tuple[Uncertainty | None, ...]:
    """What gives the observations of the exposures in each air their standard deviations.

    ``views`` (s,) of `views_of_mission`. None where nothing is known: neither the covariance of
    the air nor a sigma in the mission file.
    """
    mounts = [mission.mount[name] for name in mission.cameras]
    section = mission.ground
    told = (
        any(mount.sigma_tilt_deg is not None for mount in mounts)
        or section.sigma_m is not None
        or section.sigma_column is not None
    )
    sigmas = _station_sigmas(mission, stations)
    own = [(camera, stations.camera == name) for name, camera in cameras.items()]
    found: list[Uncertainty | None] = []
    for number, one in enumerate(air.timed_profiles):
        covariance = one.covariance
        known = told or covariance is not None
        seen = replace(exposures, usable=exposures.usable & (air.profile_number == number))
        found.append(
            uncertainty_of(one.profile, covariance, seen, sigmas, own, ground.limits, views)
            if known
            else None
        )
    return tuple(found)


def views_of_mission(mission: Mission, stations: Stations, air: ProfileSeries) -> NDArray[np.int64]:
    """(s,) through what each exposure looks: `OPEN`, `SEALED` or `SCHEDULED`."""
    views = np.full(len(stations), OPEN, np.int64)
    pressure = air.pressure(stations.h_msl_m)
    for name, camera in mission.cameras.items():
        window = camera.window.build() if camera.window else None
        if window is not None and window.shape == "plane" and window.cabin is not None:
            mine = stations.camera == name
            scheduled = window.cabin.source == "standard_schedule"
            views[mine] = view_of(pressure[mine], scheduled=scheduled)
    return views


def _station_sigmas(mission: Mission, stations: Stations) -> StationSigmas:
    """Sigmas of attitude as the mission file has them, of height as the log has them."""
    count = len(stations)
    tilt, yaw = np.full(count, np.nan), np.full(count, np.nan)
    axis = np.tile([0.0, 0.0, 1.0], (count, 1))
    for name, mount in mission.mount.items():
        if mount.sigma_tilt_deg is None:
            continue
        mine = stations.camera == name
        about_vertical = mount.sigma_yaw_deg
        tilt[mine] = mount.sigma_tilt_deg * DEGREE
        yaw[mine] = (mount.sigma_tilt_deg if about_vertical is None else about_vertical) * DEGREE
        axis[mine] = mount.build().camera_from_body[:, 2]
    return StationSigmas(tilt, yaw, axis, stations.sigma_height_m)


def tell_what_is_unknown(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> None:
    """Say, once, which standard deviations nobody gave."""
    missing = []
    if not all(one.has_covariance for one in air.timed_profiles):
        missing.append("the air (its profile has no covariance)")
    untold = [name for name in mission.cameras if mission.mount[name].sigma_tilt_deg is None]
    missing += [f"the attitude (mount.{name}.sigma_tilt_deg)" for name in untold]
    if mission.ground.sigma_m is None and mission.ground.sigma_column is None:
        missing.append("the ground (ground.sigma_m or ground.sigma_column)")
    heights = int((stations.ok & ~np.isfinite(stations.sigma_height_m)).sum())
    if heights and len(untold) < len(mission.cameras):
        missing.append(f"the height of {heights} stations (not in the log; it does not count)")
    if missing:
        ledger.note(
            "SIGMA-UNKNOWN",
            f"no standard deviations are known of {', '.join(missing)}: what they do to the "
            "corrections is not in the sigma columns",
            where="observations",
            count=len(missing),
        )


def scale_of_block(
    profile: Profile, covariance: ProfileCovariance | None, radius_m: float | None, tally: Tally
) -> BlockScale | None:
    """The scale factor of R that the observations share; None where the air has no covariance."""
    if covariance is None:
        return None
    h_c, h_g, zeta_c, kind, towards, across = tally.sampled()
    views = Views(kind.astype(np.int64), towards, across)
    return block_scale(profile, covariance, h_c, h_g, zeta_c, radius_m or DEFAULT_RADIUS_M, views)
