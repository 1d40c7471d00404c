"""What bends the rays at each exposure: attitude, window, lens, and the air on both sides."""

from collections.abc import Iterable, Mapping

import numpy as np

from unbend.atmosphere import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.block.image_rays import UNKNOWN_SIGMAS, Orientations, orientations_of
from unbend.block.oriented_images import SIGMAS_OF_BLOCK
from unbend.config import Mission
from unbend.errors import MissionError
from unbend.flight.heights import HeightSystem, ground_offsets
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import LensInAir, is_absurd, principal_change
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.refraction.window import OPTICAL_AXIS, Window
from unbend.stages.correction_setup import CorrectionSetup, Ground
from unbend.stages.ground_heights import GivenGround, SlantRangeGround
from unbend.units import HECTOPASCAL, Array, Mask, Names


def camera_of_rows(
    mission: Mission, given: Names | None, only: str | None, count: int, path: str
) -> Names:
    """(n,) the camera of each row of a table, by its column or the only one (EVENTS-CAMERA)."""
    named = np.full(count, only or next(iter(mission.cameras)), dtype=object)
    named = named if given is None else given
    for name in sorted(set(named.tolist()) - set(mission.cameras)):
        raise MissionError.of("EVENTS-CAMERA", path, name=name, cameras=", ".join(mission.cameras))
    return named


def orientations_of_mission(mission: Mission, stations: Stations) -> Orientations:
    """The stations held in an intersection, with usual sigmas where theirs are unknown."""
    oriented = mission.stations.orientation is not None
    return orientations_of(stations, SIGMAS_OF_BLOCK if oriented else UNKNOWN_SIGMAS)


def exposures_of_mission(
    mission: Mission, stations: Stations, air: ProfileSeries, ledger: Ledger
) -> Exposures:
    """The exposures of a mission; the ledger names the effects that are not removed."""
    for name, camera in mission.cameras.items():
        if camera.calibration == "in_flight_uncorrected":
            ledger.warning("CALIBRATION-IN-FLIGHT", where=f"cameras.{name}.calibration", name=name)
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

    The air outside is the profile's at the height of the camera, the same that the ray starts in;
    that in the cabin is the stations' (`with_cabin_air`). Behind a window the lens is in the
    cabin's air, else in the air outside. Refuses (MissionError LENS-CHANGE) a change of the
    principal distance of more than 1 %.
    """
    rotation, h = matrices_of(stations.quaternion), stations.h_msl_m
    air_outside = profile.pressure(h), profile.temperature(h), profile.vapour_pressure(h)
    outside = profile.refractivity(h)
    inside, change = outside.copy(), np.zeros(len(stations))
    normal = np.tile(OPTICAL_AXIS, (len(stations), 1))
    for name in dict.fromkeys((*windows, *lenses)):
        rows = stations.camera == name
        if not bool(rows.any()):
            continue
        window, lens = windows.get(name), lenses.get(name)
        plane = window is not None and window.shape == "plane"
        air = air_outside
        if window is not None and window.cabin is not None and (plane or lens is not None):
            air = (
                stations.cabin_pressure_pa, stations.cabin_temperature_k,
                stations.cabin_vapour_pressure_pa,
            )  # fmt: skip
        pressure, temperature, vapour = (values[rows] for values in air)
        if window is not None and plane:
            inside[rows] = profile.index.refractivity(temperature, pressure, vapour)
            aircraft = stations.aircraft_quaternion[rows]
            normal[rows] = _window_normals(window, rotation[rows], aircraft)
        if lens is not None:
            change[rows] = principal_change(lens, pressure, temperature)
            _check_change(lens, change[rows], pressure, stations.ok[rows], name=name, ledger=ledger)
    # Above the top of the profile the air is unknown too; those rows get outside_profile later.
    air_unknown = np.isfinite(outside) & (np.isnan(inside) | np.isnan(change))
    attitude_known = np.isfinite(rotation).all(axis=(1, 2)) & np.isfinite(normal).all(axis=1)
    return Exposures(
        usable=stations.ok & attitude_known & ~air_unknown,
        rotation=rotation,
        latitude_rad=stations.lat_rad,
        height_m=h,
        refractivity_outside=outside,
        refractivity_cabin=inside,
        window_normal=normal,
        principal_change_px=np.nan_to_num(change),
        radius_m=radius_m,
    )


def _window_normals(window: Window, rotation: Array, aircraft_quaternion: Array) -> Array:
    """(m, 3) normals of a window in the frame of its camera at each exposure; NaN stays."""
    normal = np.array(window.normal)
    if window.frame == "camera":
        return np.broadcast_to(normal, (rotation.shape[0], 3))
    in_enu = np.einsum("nji,j->ni", matrices_of(aircraft_quaternion), normal)
    return np.asarray(np.einsum("nij,nj->ni", rotation, in_enu))


def _check_change(
    lens: LensInAir, change: Array, pressure_pa: Array, ok: Mask, *, name: str, ledger: Ledger
) -> None:
    """Say how much the air in a lens changes its principal distance [px]; refuse an absurd one."""
    where = f"cameras.{name}.principal_distance"
    absurd = is_absurd(lens, change) & ok
    if bool(absurd.any()):
        worst = int(np.argmax(np.where(absurd, np.abs(change), 0.0)))
        raise MissionError.of(
            "LENS-CHANGE", where, name=name, change=change[worst], lens=lens,
            hpa=pressure_pa[worst] / HECTOPASCAL,
        )  # fmt: skip
    used = change[ok & np.isfinite(change)]
    if used.size:
        ledger.note(
            "LENS-IN-AIR", where=where, count=int(used.size), name=name, low=used.min(),
            high=used.max(), lens=lens,
        )  # fmt: skip


def report_windows(windows: Mapping[str, Window], ledger: Ledger) -> None:
    """Note which windows bend nothing, and whether the displacement by the glass is removed."""
    for name, window in windows.items():
        where = f"cameras.{name}.window"
        if window.shape == "spherical":
            ledger.note("WINDOW-SPHERICAL", where=where, name=name)
        elif window.in_calibration == "glass":
            ledger.note("WINDOW-GLASS", where=where, name=name)
        else:
            ledger.note("WINDOW-GLASS/report-windows", where=where, name=name)


def report_lenses(cameras: Iterable[str], lenses: Mapping[str, LensInAir], ledger: Ledger) -> None:
    """Note the cameras whose principal distance is not corrected for the air in the lens."""
    uncorrected = [name for name in cameras if name not in lenses]
    if uncorrected:
        where, names = "cameras.<name>.principal_distance", ", ".join(uncorrected)
        ledger.note("LENS-NOT-REMOVED", where=where, count=len(uncorrected), names=names)


def correction_setup(
    mission: Mission, stations: Stations, air: ProfileSeries, heights: HeightSystem, ledger: Ledger
) -> CorrectionSetup:
    """Exposures, cameras, rays and given ground of a mission; ``heights`` are those of its log."""
    section, exposures = mission.ground, exposures_of_mission(mission, stations, air, ledger)
    ground: Ground = SlantRangeGround(section.sigma_m)
    if not section.from_distance:
        offsets = ground_offsets(section.reference_of_values, stations, heights)
        ground = GivenGround(section.constant_m, offsets, section.sigma_m)
    return CorrectionSetup(
        stations.image,
        stations.camera,
        exposures,
        ground,
        mission.interior_orientations,
        tuple(rays_by(profile, mission.refraction.method) for profile in air.profiles),
        air.profile_number,
        mission.refraction.direction,
        (None,) * len(air.profiles),
    )
