"""From mission and stations to what the rays of each exposure need to know."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.atmosphere import Profile
from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.atmosphere.series.profile_series import ProfileSeries
from pipeline.config import Mission
from pipeline.errors import MissionError
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures
from pipeline.refraction.lens import LensInAir, is_absurd, principal_change
from pipeline.refraction.window import (
    OPTICAL_AXIS,
    SCHEDULE_CEILING_M,
    SCHEDULE_TEMPERATURE_K,
    Cabin,
    Window,
    scheduled_pressure,
)
from pipeline.units import HECTOPASCAL

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Air:
    """Air at some exposures; (m,) pressure [Pa], temperature [K], vapour pressure [Pa]."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array

    def of(self, mine: Mask) -> _Air:
        """That at some of the exposures."""
        return _Air(self.pressure_pa[mine], self.temperature_k[mine], self.vapour_pressure_pa[mine])


def exposures_of(
    stations: Stations,
    profile: Profile | ProfileSeries,
    windows: Mapping[str, Window],
    lenses: Mapping[str, LensInAir],
    radius_m: float | None,
    ledger: Ledger,
) -> Exposures:
    """Attitude, height, window and lens of each exposure, and the air beside them.

    ``windows`` and ``lenses`` are those of the cameras that have one, by name. The air outside is
    the profile's at the height of the camera, the same that the ray starts in: it holds what was
    measured. Behind a window whose cabin air is known the lens is in that air, else in the air
    outside. Refuses an absurd change of a principal distance (LENS-CHANGE).
    """
    rotation = _matrices(stations.quaternion)
    h = stations.h_msl_m
    outside = profile.refractivity(h)
    inside = outside.copy()
    normal = np.tile(OPTICAL_AXIS, (len(stations), 1))
    change = np.zeros(len(stations))
    air_outside = _Air(profile.pressure(h), profile.temperature(h), profile.vapour_pressure(h))
    for name in dict.fromkeys((*windows, *lenses)):
        mine = stations.camera == name
        if not bool(mine.any()):
            continue
        window, lens = windows.get(name), lenses.get(name)
        plane = window is not None and window.shape == "plane"
        air = air_outside.of(mine)
        if window is not None and window.cabin is not None and (plane or lens is not None):
            air = _air_inside(window.cabin, air, stations, mine, name, ledger)
        if window is not None and plane:
            inside[mine] = profile.index.refractivity(
                air.temperature_k, air.pressure_pa, air.vapour_pressure_pa
            )
            normal[mine] = _normals(window, rotation[mine], stations.aircraft_quaternion[mine])
        if lens is not None:
            change[mine] = _change(lens, air, stations.ok[mine], name, ledger)
    # Beyond the profile all air is unknown, and the correction has a status of its own for that.
    air_unknown = np.isfinite(outside) & (np.isnan(inside) | np.isnan(change))
    return Exposures(
        usable=stations.ok
        & np.isfinite(rotation).all(axis=(1, 2))
        & np.isfinite(normal).all(axis=1)
        & ~air_unknown,
        rotation=rotation,
        latitude_rad=stations.lat_rad,
        height_m=stations.h_msl_m,
        refractivity_outside=outside,
        refractivity_cabin=inside,
        window_normal=normal,
        principal_change_px=np.nan_to_num(change),
        radius_m=radius_m,
    )


def _matrices(quaternion: Array) -> Array:
    """(n, 3, 3) rotations of (n, 4) quaternions w, x, y, z; NaN stays."""
    matrix = np.full((quaternion.shape[0], 3, 3), np.nan)
    known = np.isfinite(quaternion).all(axis=1)
    if bool(known.any()):
        matrix[known] = Rotation.from_quat(quaternion[known][:, [1, 2, 3, 0]]).as_matrix()
    return matrix


def _normals(window: Window, rotation: Array, aircraft_quaternion: Array) -> Array:
    """(m, 3) normals of a window in the frame of its camera at each exposure; NaN stays.

    ``rotation`` (m, 3, 3) takes east-north-up to the camera, ``aircraft_quaternion`` (m, 4) to
    the body. Without a stabilised mount the two turn together.
    """
    own = np.array(window.normal)
    if window.frame == "camera":
        return np.broadcast_to(own, (rotation.shape[0], 3))
    in_enu = np.einsum("nji,j->ni", _matrices(aircraft_quaternion), own)
    return np.asarray(np.einsum("nij,nj->ni", rotation, in_enu))


def _air_inside(
    cabin: Cabin, outside: _Air, stations: Stations, mine: Mask, name: str, ledger: Ledger
) -> _Air:
    """The air in the compartment of the exposures ``mine`` of a camera."""
    if cabin.source == "log":
        return _logged_air(stations, mine, name, ledger)
    n = int(mine.sum())
    if cabin.source == "standard_schedule":
        _tell_of_schedule(stations, mine, name, ledger)
        pressure = scheduled_pressure(outside.pressure_pa)
        return _Air(pressure, np.full(n, SCHEDULE_TEMPERATURE_K), np.zeros(n))
    e = vapour_pressure(cabin.relative_humidity, cabin.temperature_k, cabin.pressure_pa)
    constant = (cabin.pressure_pa, cabin.temperature_k, float(e))
    return _Air(*(np.full(n, value) for value in constant))


def _logged_air(stations: Stations, mine: Mask, name: str, ledger: Ledger) -> _Air:
    e = stations.cabin_vapour_pressure_pa[mine]
    dry = ~np.isfinite(e) & stations.ok[mine]
    if bool(dry.any()):
        ledger.fallback(
            "CABIN-DRY",
            f"no humidity in the cabin for {int(dry.sum())} exposures: its air is taken as dry",
            where=f"camera {name}",
            count=int(dry.sum()),
        )
    return _Air(
        stations.cabin_pressure_pa[mine],
        stations.cabin_temperature_k[mine],
        np.where(np.isfinite(e), e, 0.0),
    )


def _tell_of_schedule(stations: Stations, mine: Mask, name: str, ledger: Ledger) -> None:
    where = f"cameras.{name}.window.cabin"
    ledger.note(
        "CABIN-SCHEDULE",
        "the cabin's air is Gyer's schedule, dry and not measured: as outside to 3 km pressure "
        "altitude, then 701.2 hPa; 21.1 degC",
        where=where,
    )
    with np.errstate(invalid="ignore"):
        above = int((stations.ok & mine & (stations.h_msl_m > SCHEDULE_CEILING_M)).sum())
    if above:
        ledger.warning(
            "CABIN-SCHEDULE-HIGH",
            f"{above} exposures lie above 10 km, where the schedule of the cabin's pressure ends; "
            "701.2 hPa are taken there too",
            where=where,
            count=above,
        )


def _change(lens: LensInAir, air: _Air, ok: Mask, name: str, ledger: Ledger) -> Array:
    """What the air adds to the principal distance of a camera at its exposures [px]."""
    change = principal_change(lens, air.pressure_pa, air.temperature_k)
    absurd = is_absurd(lens, change) & ok
    used = change[ok & np.isfinite(change)]
    if bool(absurd.any()):
        worst = int(np.argmax(np.where(absurd, np.abs(change), 0.0)))
        raise MissionError(
            "LENS-CHANGE",
            f"the air in the lens would change the principal distance of {name} by "
            f"{change[worst]:.1f} px of {lens.principal_distance_px:.1f} at "
            f"{air.pressure_pa[worst] / HECTOPASCAL:.0f} hPa; more than 1 % is no effect of air",
            where=f"cameras.{name}.principal_distance",
            remedy="check the reference and the units: px per hPa and px per K, millimetres "
            "divided by the pixel pitch",
        )
    if used.size:
        low, high = float(used.min()), float(used.max())
        ledger.note(
            "LENS-IN-AIR",
            f"the air in the lens changes the principal distance of {name} by {low:.3f} to "
            f"{high:.3f} px of {lens.principal_distance_px:.1f}",
            where=f"cameras.{name}.principal_distance",
            count=int(used.size),
        )
    return change


def warn_of_calibration(camera: str, calibration: str, ledger: Ledger) -> None:
    """Say that a calibration made in flight on uncorrected images contains refraction already."""
    if calibration == "in_flight_uncorrected":
        ledger.warning(
            "CALIBRATION-IN-FLIGHT",
            f"camera {camera} was calibrated in flight on uncorrected images: its principal "
            "distance and k1 already contain the nadir refraction of that height, and this "
            "correction counts it twice",
            where=f"cameras.{camera}.calibration",
        )


def tell_of_windows(windows: Mapping[str, Window], ledger: Ledger) -> None:
    """Say which windows bend nothing, and what becomes of the displacement by their glass."""
    for name, window in windows.items():
        where = f"cameras.{name}.window"
        if window.shape == "spherical":
            ledger.note(
                "WINDOW-SPHERICAL",
                f"the window of {name} is a sphere about the projection centre: it bends nothing",
                where=where,
            )
        elif window.in_calibration == "glass":
            ledger.note(
                "WINDOW-GLASS",
                f"the calibration of {name} contains the displacement of rays by the window glass",
                where=where,
            )
        else:
            ledger.note(
                "WINDOW-GLASS",
                f"the displacement of rays by the window glass of {name} is not removed: 7 mm for "
                "20 mm of glass at 45 degrees",
                where=where,
            )


def tell_of_lenses(cameras: Iterable[str], lenses: Mapping[str, LensInAir], ledger: Ledger) -> None:
    """Say of which cameras the change of the principal distance with the air stays in."""
    left = [name for name in cameras if name not in lenses]
    if left:
        ledger.note(
            "LENS-NOT-REMOVED",
            f"what the air in the lens does to the principal distance of {', '.join(left)} is not "
            "removed: 130 to 310 ppm at 6 km (Meier)",
            where="cameras.<name>.principal_distance",
            count=len(left),
        )


def cameras_of_mission(mission: Mission) -> dict[str, Camera]:
    """The interior orientation of each camera, in COLMAP's pixels."""
    origin = mission.observations.pixel_origin
    return {name: camera.build(origin) for name, camera in mission.cameras.items()}


def look_through(
    mission: Mission, stations: Stations, profile: Profile | ProfileSeries, ledger: Ledger
) -> Exposures:
    """What the rays of each exposure need to know: attitude, and the air beside the window."""
    for name, camera in mission.cameras.items():
        warn_of_calibration(name, camera.calibration, ledger)
    cameras = mission.cameras.items()
    windows = {name: camera.window.build() for name, camera in cameras if camera.window}
    lenses = {name: lens for name, camera in cameras if (lens := camera.lens()) is not None}
    tell_of_windows(windows, ledger)
    tell_of_lenses(mission.cameras, lenses, ledger)
    return exposures_of(stations, profile, windows, lenses, mission.refraction.radius_m, ledger)
