"""From stations to what the rays of each exposure need to know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.atmosphere import Profile
from pipeline.atmosphere.air import vapour_pressure
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.image import Exposures
from pipeline.refraction.window import NO_WINDOW, Cabin

Array = NDArray[np.float64]


def exposures_of(
    stations: Stations,
    profile: Profile,
    cabins: Mapping[str, Cabin],
    radius_m: float | None,
    ledger: Ledger,
) -> Exposures:
    """Attitude, height and the air on both sides of the window of each exposure.

    ``cabins`` has the air behind each camera's window. The air outside is the profile's at the
    height of the camera, the same that the ray starts in.
    """
    rotation = np.full((len(stations), 3, 3), np.nan)
    known = np.isfinite(stations.quaternion).all(axis=1)
    if bool(known.any()):
        turn = Rotation.from_quat(stations.quaternion[known][:, [1, 2, 3, 0]])
        rotation[known] = turn.as_matrix()
    outside = profile.refractivity(stations.h_msl_m)
    inside = outside.copy()
    for name, cabin in cabins.items():
        mine = stations.camera == name
        if cabin != NO_WINDOW and bool(mine.any()):
            inside[mine] = _refractivity_inside(stations, profile, cabin, mine, name, ledger)
    return Exposures(
        stations.ok & known,
        rotation,
        stations.lat_rad,
        stations.h_msl_m,
        outside,
        inside,
        radius_m,
    )


def _refractivity_inside(
    stations: Stations,
    profile: Profile,
    cabin: Cabin,
    mine: NDArray[np.bool_],
    name: str,
    ledger: Ledger,
) -> Array:
    if cabin.pressure_pa is not None and cabin.temperature_k is not None:
        e = vapour_pressure(cabin.relative_humidity, cabin.temperature_k, cabin.pressure_pa)
        constant = profile.index.refractivity(cabin.temperature_k, cabin.pressure_pa, e)
        return np.full(int(mine.sum()), float(constant))
    e = stations.cabin_vapour_pressure_pa[mine]
    dry = ~np.isfinite(e) & stations.ok[mine]
    if bool(dry.any()):
        ledger.fallback(
            "CABIN-DRY",
            f"no humidity in the cabin for {int(dry.sum())} exposures: its air is taken as dry",
            where=f"camera {name}",
            count=int(dry.sum()),
        )
    return profile.index.refractivity(
        stations.cabin_temperature_k[mine],
        stations.cabin_pressure_pa[mine],
        np.where(np.isfinite(e), e, 0.0),
    )


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
