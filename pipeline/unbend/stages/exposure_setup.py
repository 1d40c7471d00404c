"""What bends the rays at each exposure: attitude, window, lens, and the air on both sides."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from unbend.atmosphere import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.block.image_rays import UNKNOWN_SIGMAS, Orientations, orientations_of
from unbend.block.oriented_images import SIGMAS_OF_BLOCK
from unbend.config import Mission
from unbend.flight.heights import HeightSystem, ground_offsets
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import LensInAir, is_absurd, principal_change
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.refraction.window import OPTICAL_AXIS, Window
from unbend.stages import messages
from unbend.stages.correction_setup import CorrectionSetup, Ground
from unbend.stages.ground_heights import GivenGround, SlantRangeGround
from unbend.units import HECTOPASCAL, Array, Mask


class Air(NamedTuple):
    """Air at each exposure, (s,): pressure [Pa], temperature [K], vapour pressure [Pa]."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array


def orientations_of_mission(mission: Mission, stations: Stations) -> Orientations:
    """Position and attitude of the stations for intersections.

    Unknown sigmas are the usual ones of an adjusted block, if the orientations come from one, else
    those of a flight.
    """
    if mission.stations.orientation is not None:
        return orientations_of(stations, SIGMAS_OF_BLOCK)
    return orientations_of(stations, UNKNOWN_SIGMAS)


def exposures_of_mission(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> Exposures:
    """The exposures of a mission; the ledger names the effects that are not removed."""
    for name, camera in mission.cameras.items():
        if camera.calibration == "in_flight_uncorrected":
            where = f"cameras.{name}.calibration"
            ledger.add(messages.calibration_in_flight(where=where, name=name))
    report_windows(mission.windows, ledger)
    report_lenses(mission.cameras, mission.lenses, ledger)
    return exposures_of(
        stations,
        air,
        mission.windows,
        mission.lenses,
        ledger,
        radius_m=mission.refraction.radius_m,
    )


def exposures_of(
    stations: Stations,
    profile: Profile | ProfileSeries,
    windows: Mapping[str, Window],
    lenses: Mapping[str, LensInAir],
    ledger: Ledger,
    *,
    radius_m: float | None,
) -> Exposures:
    """Attitude, height, window and lens of each exposure, and the air beside them.

    The air outside is the profile's at the height of the camera, in which the ray starts; the air
    in the cabin is that of the stations (`with_cabin_air`). The lens is in the cabin's air behind a
    window, else in the air outside. Refuses (MissionError LENS-CHANGE) a change of the principal
    distance of more than 1 %.
    """
    rotation = matrices_of(stations.quaternion)
    h = stations.h_msl_m
    n_outside = profile.refractivity(h)
    n_in_cabin = n_outside.copy()
    normal = np.tile(OPTICAL_AXIS, (len(stations), 1))  # where no window bends, of no effect
    change = np.zeros(len(stations))  # of the principal distance [px]
    for name in dict.fromkeys((*windows, *lenses)):
        rows = stations.camera == name
        if not bool(rows.any()):
            continue
        window = windows.get(name)
        lens = lenses.get(name)
        air = air_at_camera(stations, profile, window, lens, rows)
        if window is not None and window.shape == "plane":
            n_in_cabin[rows] = profile.index.refractivity(
                air.temperature_k, air.pressure_pa, air.vapour_pressure_pa
            )
            aircraft = stations.aircraft_quaternion[rows]
            normal[rows] = window_normals(window, rotation[rows], aircraft)
        if lens is not None:
            change[rows] = principal_change(lens, air.pressure_pa, air.temperature_k)
            report_change(
                name,
                lens,
                change_px=change[rows],
                pressure_pa=air.pressure_pa,
                ok=stations.ok[rows],
                ledger=ledger,
            )

    # An exposure above the top of the profile has no air outside (NaN). It stays usable here and
    # gets the status outside_profile later.
    is_below_top = np.isfinite(n_outside)
    air_unknown = is_below_top & (np.isnan(n_in_cabin) | np.isnan(change))
    attitude_known = np.isfinite(rotation).all(axis=(1, 2)) & np.isfinite(normal).all(axis=1)
    return Exposures(
        usable=stations.ok & attitude_known & ~air_unknown,
        rotation=rotation,
        latitude_rad=stations.lat_rad,
        height_m=h,
        refractivity_outside=n_outside,
        refractivity_cabin=n_in_cabin,
        window_normal=normal,
        principal_change_px=np.nan_to_num(change),
        radius_m=radius_m,
    )


def air_at_camera(
    stations: Stations,
    profile: Profile | ProfileSeries,
    window: Window | None,
    lens: LensInAir | None,
    rows: Mask,
) -> Air:
    """The air about the lens of a camera at some exposures (a mask): of its cabin, or outside.

    The air of the cabin is known, and used, only where `with_cabin_air` fills it in: for a camera
    with a lens in air or behind a plane window.
    """
    has_plane_window = window is not None and window.shape == "plane"
    has_cabin = window is not None and window.cabin is not None
    if has_cabin and (lens is not None or has_plane_window):
        return Air(
            stations.cabin_pressure_pa[rows],
            stations.cabin_temperature_k[rows],
            stations.cabin_vapour_pressure_pa[rows],
        )
    h = stations.h_msl_m
    return Air(
        profile.pressure(h)[rows], profile.temperature(h)[rows], profile.vapour_pressure(h)[rows]
    )


def window_normals(window: Window, rotation: Array, aircraft_quaternion: Array) -> Array:
    """(m, 3) normals of a window in the frame of its camera; NaN where an attitude is unknown.

    ``rotation`` (m, 3, 3) turns east-north-up into the camera, ``aircraft_quaternion`` (m, 4) into
    the body of the aircraft, in which the normal is stated unless the camera's frame is named.
    """
    normal = np.array(window.normal)
    if window.frame == "camera":
        return np.broadcast_to(normal, (rotation.shape[0], 3))
    # "nji" transposes the rotation into the body, which turns the normal out of it.
    in_enu = np.einsum("nji,j->ni", matrices_of(aircraft_quaternion), normal)
    return np.asarray(np.einsum("nij,nj->ni", rotation, in_enu))


def report_change(
    name: str, lens: LensInAir, change_px: Array, pressure_pa: Array, ok: Mask, ledger: Ledger
) -> None:
    """Note how much the air in a lens changes its principal distance; refuse an absurd change."""
    where = f"cameras.{name}.principal_distance"
    absurd = is_absurd(lens, change_px) & ok
    if bool(absurd.any()):
        worst = int(np.argmax(np.where(absurd, np.abs(change_px), 0.0)))
        raise messages.lens_change_absurd(
            where=where,
            name=name,
            change=float(change_px[worst]),
            principal_distance_px=lens.principal_distance_px,
            hpa=float(pressure_pa[worst]) / HECTOPASCAL,
        )
    used = change_px[ok & np.isfinite(change_px)]
    if used.size:
        ledger.add(
            messages.lens_in_air(
                where=where,
                count=int(used.size),
                name=name,
                low=float(used.min()),
                high=float(used.max()),
                principal_distance_px=lens.principal_distance_px,
            )
        )


def report_windows(windows: Mapping[str, Window], ledger: Ledger) -> None:
    """Note of each window whether it is spherical, and else how the glass's displacement counts."""
    for name, window in windows.items():
        where = f"cameras.{name}.window"
        if window.shape == "spherical":
            ledger.add(messages.window_spherical(where=where, name=name))
        elif window.in_calibration == "glass":
            ledger.add(messages.window_glass_calibrated(where=where, name=name))
        else:
            ledger.add(messages.window_glass_not_removed(where=where, name=name))


def report_lenses(cameras: Iterable[str], lenses: Mapping[str, LensInAir], ledger: Ledger) -> None:
    """Note the cameras whose principal distance is not corrected for the air in the lens."""
    uncorrected = [name for name in cameras if name not in lenses]
    if uncorrected:
        ledger.add(
            messages.lens_not_removed(
                where="cameras.<name>.principal_distance",
                count=len(uncorrected),
                names=", ".join(uncorrected),
            )
        )


def correction_setup(
    mission: Mission, stations: Stations, air: ProfileSeries, heights: HeightSystem, ledger: Ledger
) -> CorrectionSetup:
    """Exposures, cameras, rays and ground heights of a mission.

    The ground is the given one, or that at which slant ranges end; `with_terrain` and
    `with_intersected_heights` replace it later. ``heights`` relates heights above sea level, above
    the ellipsoid and above the take-off.
    """
    section = mission.ground
    ground: Ground
    if section.from_distance:
        ground = SlantRangeGround(section.sigma_m)
    else:
        offsets = ground_offsets(section.reference_of_values, stations, heights)
        ground = GivenGround(section.constant_m, offsets, section.sigma_m)
    method = mission.refraction.method
    return CorrectionSetup(
        images=stations.image,
        camera_names=stations.camera,
        exposures=exposures_of_mission(mission, stations, air, ledger),
        ground=ground,
        cameras=mission.interior_orientations,
        rays=tuple(rays_by(profile, method) for profile in air.profiles),
        profile_number=air.profile_number,
        direction=mission.refraction.direction,
        uncertainties=(None,) * len(air.profiles),
    )
