"""What bends the rays at each exposure: attitude, window, lens, and the air on both sides."""

import math
from collections.abc import Mapping

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
from unbend.refraction.camera.camera import LensInAir, is_impossible_change
from unbend.refraction.image import Exposures
from unbend.refraction.lens_air import AnyLens, lens_change
from unbend.refraction.ray import rays_by
from unbend.refraction.window import OPTICAL_AXIS, Window
from unbend.stages import messages
from unbend.stages.camera_air import air_at_camera, report_lenses
from unbend.stages.correction_setup import CorrectionSetup, Ground
from unbend.stages.ground_heights import GivenGround, SlantRangeGround
from unbend.stages.wavelengths import index_of_rows
from unbend.units import DEGREE, HECTOPASCAL, Array, Mask


def orientations_of_mission(mission: Mission, stations: Stations) -> Orientations:
    """Position and attitude of the stations, with sigmas, for the intersection of rays.

    Unknown sigmas get usual values: those of an adjusted block if the mission file states
    orientations, else those of a flight log.
    """
    if mission.stations.orientation is not None:
        return orientations_of(stations, SIGMAS_OF_BLOCK)
    return orientations_of(stations, UNKNOWN_SIGMAS)


def exposures_of_mission(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> Exposures:
    """The exposures of a mission, with notes on windows, lenses and effects that are not removed.

    ``air`` has the profiles in the light of each camera.
    """
    for name, camera in mission.cameras.items():
        if camera.calibration == "in_flight_uncorrected":
            where = f"cameras.{name}.calibration"
            ledger.add(messages.calibration_in_flight(where=where, name=name))
    report_lights(mission.wavelengths_m, mission.atmosphere.wavelength_m, ledger)
    report_windows(mission.windows, ledger)
    report_lenses(mission, stations, air, ledger)
    exposures = exposures_of(
        stations,
        air,
        mission.windows,
        mission.lenses,
        ledger,
        radius_m=mission.refraction.radius_m,
    )
    report_windows_by_mount(mission, stations, exposures, ledger)
    return exposures


def is_aircraft_attitude_by_mount(mission: Mission, camera: str) -> bool:
    """Whether the aircraft's attitude is known only from the attitude of a camera and its mount.

    That is if the stated angles are those of the camera itself, also as the angles of a gimbal
    (``dji``), and the mission file names no channel of the log for the aircraft's attitude.
    """
    if mission.log is not None and mission.log.channels.aircraft_attitude is not None:
        return False
    orientation = mission.stations.orientation
    if orientation is not None:
        return orientation.angles != "roll_pitch_yaw" or orientation.format == "dji"
    exposures = mission.position_events.get(camera)
    return exposures is not None and exposures.states_attitude


def report_windows_by_mount(
    mission: Mission, stations: Stations, exposures: Exposures, ledger: Ledger
) -> None:
    """Warn of windows that are fixed to an aircraft, if nothing states the aircraft's attitude.

    Their direction then follows from the mount, as if the camera was fixed to the aircraft. The
    warning has the shift [px] of all points if the camera is turned one degree in the aircraft.
    """
    air_step = exposures.refractivity_cabin - exposures.refractivity_outside
    for name, window in mission.windows.items():
        rows = (stations.camera == name) & exposures.usable
        if window.frame != "body" or not bool(rows.any()):
            continue
        if not is_aircraft_attitude_by_mount(mission, name):
            continue
        # A plane window deflects a ray along its normal plus an angle t by (n_cc - n) tan t.
        deflection_rad = np.abs(air_step[rows]) * math.tan(DEGREE)
        f_px = mission.interior_orientations[name].fx_px
        ledger.add(
            messages.window_by_mount(
                where=f"cameras.{name}.{window.section}.frame",
                count=int(rows.sum()),
                name=name,
                section=window.section,
                px=f_px * float(np.median(deflection_rad)),
            )
        )


def exposures_of(
    stations: Stations,
    profile: Profile | ProfileSeries,
    windows: Mapping[str, Window],
    lenses: Mapping[str, AnyLens],
    ledger: Ledger,
    *,
    radius_m: float | None,
) -> Exposures:
    """Attitude, height, window and lens of each exposure, and the air outside and in the cabin.

    The air outside is that of the profile at the height of the camera; the air in the cabin is that
    of the stations (`with_cabin_air`). A lens is in the air of the cabin if the camera has one,
    else in the air outside. ``windows`` and ``lenses`` are by camera; ``radius_m`` replaces the
    radius of the ellipsoid, if given. Refuses (MissionError LENS-CHANGE) a change of the principal
    distance by more than 1 %.
    """
    rotation = matrices_of(stations.quaternion)
    h = stations.h_msl_m
    n_outside = profile.refractivity(h)
    n_in_cabin = n_outside.copy()
    normal = np.tile(OPTICAL_AXIS, (len(stations), 1))  # has no effect without a plane window
    principal_change_px = np.zeros(len(stations))
    for name in dict.fromkeys((*windows, *lenses)):
        rows = stations.camera == name
        if not bool(rows.any()):
            continue
        window = windows.get(name)
        lens = lenses.get(name)
        air = air_at_camera(stations, profile, window, lens, rows)
        if window is not None and window.shape == "plane":
            n_in_cabin[rows] = index_of_rows(profile, rows).refractivity(
                air.temperature_k, air.pressure_pa, air.vapour_pressure_pa
            )
            aircraft = stations.aircraft_quaternion[rows]
            normal[rows] = window_normals(window, rotation[rows], aircraft)
        if lens is not None:
            principal_change_px[rows] = lens_change(
                lens, air.pressure_pa, air.temperature_k, index_of_rows(profile, rows)
            )
            report_lens_change(
                name,
                lens,
                change_px=principal_change_px[rows],
                pressure_pa=air.pressure_pa,
                ok=stations.ok[rows],
                ledger=ledger,
            )

    # An exposure above the top of the profile has no air outside (NaN). It stays usable here and
    # gets the status outside_profile later.
    is_below_top = np.isfinite(n_outside)
    air_unknown = is_below_top & (np.isnan(n_in_cabin) | np.isnan(principal_change_px))
    attitude_known = np.isfinite(rotation).all(axis=(1, 2)) & np.isfinite(normal).all(axis=1)
    return Exposures(
        usable=stations.ok & attitude_known & ~air_unknown,
        rotation=rotation,
        latitude_rad=stations.lat_rad,
        height_m=h,
        refractivity_outside=n_outside,
        refractivity_cabin=n_in_cabin,
        window_normal=normal,
        principal_change_px=np.nan_to_num(principal_change_px),
        radius_m=radius_m,
    )


def window_normals(window: Window, rotation: Array, aircraft_quaternion: Array) -> Array:
    """(m, 3) normals of a window in the frame of its camera; NaN where an attitude is unknown.

    The normal is stated in the frame of the camera or of the aircraft's body (``window.frame``).
    ``rotation`` (m, 3, 3) turns vectors from east-north-up into the camera frame,
    ``aircraft_quaternion`` (m, 4) from east-north-up into the body frame.
    """
    normal = np.array(window.normal)
    if window.frame == "camera":
        return np.broadcast_to(normal, (rotation.shape[0], 3))
    # "nji" transposes the rotation, so that it turns the normal from body to east-north-up.
    in_enu = np.einsum("nji,j->ni", matrices_of(aircraft_quaternion), normal)
    return np.asarray(np.einsum("nij,nj->ni", rotation, in_enu))


def report_lens_change(
    name: str, lens: AnyLens, change_px: Array, pressure_pa: Array, ok: Mask, ledger: Ledger
) -> None:
    """Note how much the air in a lens changes its principal distance; refuse an absurd change.

    ``change_px``, ``pressure_pa`` (of the air in the lens) and ``ok`` (m,) are of the exposures of
    the camera ``name``; only those that are ok count.
    """
    where = f"cameras.{name}.principal_distance"
    absurd = np.zeros(ok.shape, dtype=bool)
    if isinstance(lens, LensInAir):
        absurd = is_impossible_change(lens, change_px) & ok
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


def report_lights(wavelengths_m: Mapping[str, float], common_m: float, ledger: Ledger) -> None:
    """Note the cameras with a stated wavelength [m], if any; others have ``common_m`` [m]."""
    if not wavelengths_m:
        return
    lights = [f"{name} at {length_m * 1e6:g} um" for name, length_m in wavelengths_m.items()]
    ledger.add(
        messages.camera_light(
            where="cameras.<name>.wavelength_m",
            count=len(lights),
            lights=", ".join(lights),
            common_um=common_m * 1e6,
        )
    )


def report_windows(windows: Mapping[str, Window], ledger: Ledger) -> None:
    """One note for each window: the air in an opening, or what becomes of the glass.

    The glass displaces rays. That is in the calibration, or it stays in the results.
    """
    for name, window in windows.items():
        where = f"cameras.{name}.{window.section}"
        cabin = window.cabin
        if cabin is not None and window.is_opening:
            ledger.add(
                messages.opening_air(
                    where=where,
                    name=name,
                    warmer=cabin.warmer_k,
                    sigma=cabin.sigma_temperature_k,
                    excess=cabin.excess_pa / HECTOPASCAL,
                )
            )
        elif window.shape == "spherical":
            ledger.add(messages.window_spherical(where=where, name=name))
        elif window.in_calibration == "glass":
            ledger.add(messages.window_glass_calibrated(where=where, name=name))
        else:
            ledger.add(messages.window_glass_not_removed(where=where, name=name))


def correction_setup(
    mission: Mission, stations: Stations, air: ProfileSeries, heights: HeightSystem, ledger: Ledger
) -> CorrectionSetup:
    """Everything that observations are corrected with, still without standard deviations.

    The ground heights are the given ones, or those at which slant ranges end; `with_terrain` and
    `with_intersected_heights` replace them if the mission has such a source. ``heights`` relates
    heights above sea level, above the ellipsoid and above the take-off.
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
