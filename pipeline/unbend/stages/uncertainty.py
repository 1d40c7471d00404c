"""How well air, stations and ground of a mission are known, and the sigmas of the corrections."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pyarrow as pa

from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.config import Mission
from unbend.errors import Counted
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.uncertainty.budget import StationSigmas, uncertainty_of
from unbend.refraction.uncertainty.sigmas import (
    FOLLOWING,
    OPEN,
    SCHEDULED,
    Uncertainty,
    window_kind_of,
)
from unbend.stages import messages
from unbend.stages.cabin_air import cabin_changes, with_errors_of_lenses
from unbend.stages.correction_setup import CorrectionSetup
from unbend.tables.geodata.object_points import matching_rows
from unbend.tables.observations import Batch
from unbend.units import Integers

TYPICAL_ROWS = 2000
"""First rows of the observations; the leading mode of the air is computed for their ground."""


def with_uncertainties(
    setup: CorrectionSetup,
    mission: Mission,
    stations: Stations,
    air: ProfileSeries,
    batch: Batch,
    *,
    flight_profile_number: Integers,
) -> CorrectionSetup:
    """The setup with all that the sigmas of the corrections are computed from, for each profile.

    ``air`` has each profile of the flight once for each wavelength of the cameras;
    ``flight_profile_number`` (s,) is each station's profile of the flight, whatever the wavelength.

    The leading mode of the air's errors, which changes the refraction most, is computed from all
    stations of a profile of the flight, also those of cameras with other wavelengths, and for rays
    to the median height of the points of ``batch``. Modes differ between profiles, but have one
    common parameter: the errors of all profiles change the refraction in the same sense. A profile
    without covariance gets None if stations, ground and windows have no sigma either.
    """
    cabin_of_air = cabin_changes(stations, mission.lenses, air)
    cabin_and_lenses = with_errors_of_lenses(
        cabin_of_air, stations, mission.lenses, mission.windows, setup.exposures.changes_px
    )
    sigmas = replace(station_sigmas(mission, stations), cabin=cabin_and_lenses)
    window_kinds = kinds_of_windows(mission, stations, air)
    any_sigma = has_any_sigma(mission, stations, sigmas, window_kinds)
    typical_ground_m = median_ground_m(setup, batch)
    stations_of_cameras = [
        (camera, stations.camera == name) for name, camera in setup.cameras.items()
    ]
    uncertainties: list[Uncertainty | None] = []
    for number, timed in enumerate(air.timed_profiles):
        if timed.covariance is None and not any_sigma:
            uncertainties.append(None)
            continue
        of_this_profile = air.profile_number == number
        in_any_light = np.isin(flight_profile_number, flight_profile_number[of_this_profile])
        usable = setup.exposures.usable & in_any_light
        uncertainties.append(
            uncertainty_of(
                timed.profile,
                timed.covariance,
                replace(setup.exposures, usable=usable),
                sigmas,
                stations_of_cameras,
                window_kinds=window_kinds,
                ground_heights_m=setup.ground.limits,
                typical_ground_m=typical_ground_m,
            )
        )
    return replace(setup, uncertainties=with_common_scale(uncertainties))


def median_ground_m(setup: CorrectionSetup, batch: Batch) -> float | None:
    """The median ground height of a batch above sea level [m]; None where none is known."""
    station = matching_rows(batch.image, pa.array(setup.images, pa.string()))
    heights = setup.ground.heights(batch, station, setup).h_m
    heights = heights[np.isfinite(heights)]
    return float(np.median(heights)) if heights.size else None


def has_any_sigma(
    mission: Mission, stations: Stations, sigmas: StationSigmas, window_kinds: Integers
) -> bool:
    """Whether any standard deviation but that of the air is known.

    That is of attitudes, heights of stations, ground heights, the air in a cabin or, by its window,
    of its pressure.
    """
    for of_stations in (sigmas.tilt_rad, sigmas.height_m):
        if bool(np.isfinite(of_stations[stations.ok]).any()):
            return True
    if mission.ground.sigma_m is not None or mission.ground.sigma_column is not None:
        return True
    has_cabin = sigmas.cabin is not None and bool(np.isfinite(sigmas.cabin).any())
    return has_cabin or bool((window_kinds != OPEN).any())


def with_common_scale(
    uncertainties: Iterable[Uncertainty | None],
) -> tuple[Uncertainty | None, ...]:
    """The uncertainties with one common parameter of their leading modes, and so one sigma.

    The sigma is the root mean square of the sigmas of all modes, to six digits. A profile without
    uncertainty keeps None; an uncertainty without a mode stays as it is.
    """
    of_profiles = tuple(uncertainties)
    sigmas = []
    for uncertainty in of_profiles:
        if uncertainty is not None and uncertainty.mode is not None:
            sigmas.append(uncertainty.mode.sigma)
    common_sigma = np.nan  # not used if no uncertainty has a mode
    if sigmas:
        common_sigma = float(f"{np.sqrt(np.mean(np.square(sigmas))):.6g}")
    scaled: list[Uncertainty | None] = []
    for uncertainty in of_profiles:
        scaled.append(None if uncertainty is None else uncertainty.with_scale(common_sigma))
    return tuple(scaled)


def kinds_of_windows(mission: Mission, stations: Stations, air: ProfileSeries) -> Integers:
    """(s,) the kind of window of each exposure, by the pressure behind it.

    * `OPEN`: no plane window before a cabin.
    * `FOLLOWING`: an opening; its air differs from that outside by stated amounts.
    * `SCHEDULED`: the pressure is that of the air outside: in an unsealed cabin, and with a
      schedule below the height from which the schedule keeps the pressure constant.
    * `SEALED`: any other plane window.
    """
    kinds = np.full(len(stations), OPEN, np.int64)
    pressure = air.pressure(stations.h_msl_m)
    for name, window in mission.windows.items():
        if window.shape == "plane" and window.cabin is not None:
            rows = stations.camera == name
            if window.cabin.source == "ambient":
                kinds[rows] = SCHEDULED
            elif window.is_opening:
                kinds[rows] = FOLLOWING
            else:
                scheduled = window.cabin.source == "standard_schedule"
                kinds[rows] = window_kind_of(pressure[rows], scheduled=scheduled)
    return kinds


def station_sigmas(mission: Mission, stations: Stations) -> StationSigmas:
    """Sigmas of attitude and height of the stations; NaN if unknown.

    A station without sigmas of its attitude gets those that the mission file states for its mount.
    """
    tilt = stations.sigma_tilt_rad.copy()
    yaw = stations.sigma_yaw_rad.copy()
    vertical_axis = np.tile([0.0, 0.0, 1.0], (len(stations), 1))  # of the body, in the camera
    for name, mount in mission.mounts.items():
        rows = stations.camera == name
        vertical_axis[rows] = mount.camera_from_body[:, 2]
        if mount.sigma_tilt_rad is not None:
            tilt[rows & np.isnan(tilt)] = mount.sigma_tilt_rad
        if mount.sigma_yaw_rad is not None:
            yaw[rows & np.isnan(yaw)] = mount.sigma_yaw_rad
    return StationSigmas(tilt, yaw, vertical_axis, stations.sigma_height_m)


def report_unknown_sigmas(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> None:
    """Note which standard deviations are missing from the sigma columns, in one entry."""
    missing = list(missing_sigmas(mission, stations, air))
    if missing:
        ledger.add(
            messages.sigmas_unknown(
                where="observations", count=len(missing), missing=", ".join(missing)
            )
        )


def missing_sigmas(mission: Mission, stations: Stations, air: ProfileSeries) -> Iterator[str]:
    """A text for each unknown standard deviation, with the key that would state it."""
    if not all(timed.has_covariance for timed in air.timed_profiles):
        yield "the air (its profile has no covariance)"
    yield from missing_sigmas_of_attitudes(mission, stations)
    if mission.ground.sigma_m is None and mission.ground.sigma_column is None:
        yield "the ground (ground.sigma_m or ground.sigma_column)"
    without_height_sigma = int((stations.ok & ~np.isfinite(stations.sigma_height_m)).sum())
    if without_height_sigma:
        counted = Counted(without_height_sigma, "station")
        source = "not in the log"
        if mission.stations.orientation is not None:
            source = "stations.orientation.sigma_height_m"
        yield f"the height of {counted} ({source})"
    yield from missing_sigmas_of_cabins(mission, stations)


def missing_sigmas_of_attitudes(mission: Mission, stations: Stations) -> Iterator[str]:
    """One text with the keys for sigmas of tilt and yaw that stations lack; nothing without any.

    Only stations that are ok count. The keys are of the mount of each camera if the attitudes come
    from a log, else of the orientation of the stations.
    """
    sigmas = station_sigmas(mission, stations)
    of_attitude = {
        "sigma_tilt_deg": sigmas.tilt_rad,
        "sigma_yaw_deg": sigmas.yaw_rad,
    }
    keys = []
    for key, sigma in of_attitude.items():
        lacking = stations.ok & np.isnan(sigma)
        if mission.stations.orientation is None:
            cameras = sorted(set(stations.camera[lacking].tolist()))
            keys += [f"mount.{camera}.{key}" for camera in cameras]
        elif bool(lacking.any()):
            keys.append(f"stations.orientation.{key}")
    if keys:
        yield f"the attitude ({', '.join(keys)})"


def missing_sigmas_of_cabins(mission: Mission, stations: Stations) -> Iterator[str]:
    """Text for each sigma that the air in cabins behind plane windows lacks, with its key.

    A sigma is missing if any station of the camera that is ok lacks it.
    """
    of_cabins = {
        "sigma_pressure_hpa": stations.sigma_cabin_pressure_pa,
        "sigma_temperature_k": stations.sigma_cabin_temperature_k,
    }
    for name, window in mission.windows.items():
        if window.shape != "plane":
            continue
        rows = (stations.camera == name) & stations.ok
        for key, sigma in of_cabins.items():
            is_missing = np.isnan(sigma[rows])
            if bool(is_missing.any()):
                yield f"the cabin's air (cameras.{name}.window.cabin.{key})"
