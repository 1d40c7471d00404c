"""The air before and in the lens of each camera, and how large its effects are.

Air before the lens that is warmer than outside bends rays as a window does; air in the lens that is
not that of the calibration changes the principal distance.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from unbend.atmosphere import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.config import Mission
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import Effect
from unbend.refraction.lens_air import (
    CHANGE_PER_INDEX,
    SIGMA_PER_INDEX,
    AnyLens,
    TypicalLens,
    lens_change,
)
from unbend.refraction.window import Window
from unbend.stages import messages
from unbend.stages.wavelengths import index_of_rows
from unbend.tables.manifest.results import CameraAirRecord, FlownCamera
from unbend.units import PPM, Array, Mask

COMPARED_AT_DEG = 45.0  # nadir angle of the R with which the effect of 1 K is compared


class Air(NamedTuple):
    """Air at each exposure, (s,): pressure [Pa], temperature [K], vapour pressure [Pa]."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array


def air_at_camera(
    stations: Stations,
    profile: Profile | ProfileSeries,
    window: Window | None,
    lens: AnyLens | None,
    rows: Mask,
) -> Air:
    """The air around the lens of a camera, for the exposures of the mask ``rows`` (s,) only.

    It is the air of the cabin, completed by `with_cabin_air`, if the window has a cabin and either
    is plane or the principal distance is corrected for the air (``lens`` is not None). Otherwise it
    is the air of ``profile`` at the height of the camera.
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


def lens_change_ppm(
    name: str, mission: Mission, stations: Stations, air: Profile | ProfileSeries
) -> float:
    """The median change [ppm] of a camera's principal distance by the air in its lens.

    If the mission file does not state the lens, it is a typical lens that was calibrated in a
    laboratory. NaN without usable exposures. ``air`` is that outside.
    """
    rows = (stations.camera == name) & stations.ok
    if not bool(rows.any()):
        return math.nan
    stated_lens = mission.lenses.get(name)
    # A typical lens of 1 px: the change is divided by the principal distance below.
    lens = stated_lens or TypicalLens(1.0)
    in_lens = air_at_camera(stations, air, mission.windows.get(name), stated_lens, rows)
    change = lens_change(lens, in_lens.pressure_pa, in_lens.temperature_k, index_of_rows(air, rows))
    change = change[np.isfinite(change)] / lens.principal_distance_px
    return float(np.median(change)) / PPM if change.size else math.nan


def report_lenses(
    mission: Mission, stations: Stations, air: Profile | ProfileSeries, ledger: Ledger
) -> None:
    """Note the lenses that are corrected as typical ones, and those that are not corrected.

    For the latter the note has the size of the effect that remains, if it is known.
    """
    for name, lens in mission.lenses.items():
        if isinstance(lens, TypicalLens):
            ledger.add(
                messages.lens_typical(
                    where=f"cameras.{name}.principal_distance",
                    name=name,
                    rate=CHANGE_PER_INDEX,
                    sigma=SIGMA_PER_INDEX,
                )
            )
    uncorrected_ppm = {}
    for name in mission.cameras:
        if name not in mission.lenses:
            uncorrected_ppm[name] = lens_change_ppm(name, mission, stations, air)
    if not uncorrected_ppm:
        return
    where = "cameras.<name>.principal_distance"
    names = ", ".join(uncorrected_ppm)
    known_ppm = [abs(change) for change in uncorrected_ppm.values() if math.isfinite(change)]
    if not known_ppm:
        ledger.add(messages.lens_not_removed(where=where, count=len(uncorrected_ppm), names=names))
        return
    ledger.add(
        messages.lens_left_in(
            where=where,
            count=len(uncorrected_ppm),
            names=names,
            ppm=max(known_ppm),
            sigma_ppm=relative_sigma_of_typical_lens() * max(known_ppm),
            corner_px=largest_corner_shift(mission, uncorrected_ppm),
        )
    )


def largest_corner_shift(mission: Mission, change_ppm: Mapping[str, float]) -> float:
    """The largest shift [px] of an image corner that changes of principal distances cause.

    ``change_ppm`` are the changes by name of the camera; NaN counts as no change. The corner is
    half a diagonal from the middle of the image.
    """
    largest_px = 0.0
    for name, change in change_ppm.items():
        camera = mission.cameras[name].interior_orientation
        half_diagonal_px = 0.5 * math.hypot(camera.width_px, camera.height_px)
        if math.isfinite(change):
            largest_px = max(largest_px, abs(change) * PPM * half_diagonal_px)
    return largest_px


def relative_sigma_of_typical_lens() -> float:
    """The standard deviation of a typical lens's change, divided by the change (0.25)."""
    return SIGMA_PER_INDEX / CHANGE_PER_INDEX


def camera_air_records(
    mission: Mission,
    stations: Stations,
    air: ProfileSeries,
    *,
    cameras: Mapping[str, Camera],
    flown: Mapping[str, FlownCamera],
    effects: tuple[Effect, ...],
) -> dict[str, CameraAirRecord]:
    """The effects of the air before and in the lens of each camera, by its name, for the manifest.

    ``flown`` has the cameras' heights above ground, ``effects`` the refraction R of the flight at
    several nadir angles. A camera without usable exposures has no record.
    """
    records = {}
    for name, camera in cameras.items():
        rows = (stations.camera == name) & stations.ok
        ppm = lens_change_ppm(name, mission, stations, air)
        if not math.isfinite(ppm):
            continue
        height_range_m = flown[name].height_above_ground_m  # lowest, median, highest
        window = mission.windows.get(name)
        lens = mission.lenses.get(name)
        is_measured = lens is not None and not isinstance(lens, TypicalLens)
        height_error_m = None
        if height_range_m is not None:
            height_error_m = round(abs(ppm) * PPM * height_range_m[1], 3)
        records[name] = CameraAirRecord(
            before_lens="outside" if window is None else window.section,
            kelvin_share=kelvin_share(air, stations, rows, effects),
            wavelength_m=index_of_rows(air, rows).light_m,
            lens_removed=lens is not None,
            lens_ppm=round(ppm, 1),
            lens_sigma_ppm=None
            if is_measured
            else round(relative_sigma_of_typical_lens() * abs(ppm), 1),
            lens_height_m=height_error_m,
            lens_edge_px=round(abs(ppm) * PPM * farthest_corner_px(camera), 3),
            calibrated_in_flight=mission.cameras[name].calibration != "laboratory",
        )
    return records


def farthest_corner_px(camera: Camera) -> float:
    """The distance [px] from the principal point of an image to its farthest corner."""
    x = max(camera.cx_px, camera.width_px - camera.cx_px)
    y = max(camera.cy_px, camera.height_px - camera.cy_px)
    return math.hypot(x, y)


def kelvin_share(
    air: ProfileSeries, stations: Stations, rows: Mask, effects: tuple[Effect, ...]
) -> float | None:
    """The deflection by air before the lens that is 1 K warmer, divided by R, both at 45 degrees.

    1 K changes n by (n - 1) / T, which turns a ray by (n - 1) / T tan(45 deg): the median over the
    exposures in the mask ``rows``. None if ``effects`` have no positive R at 45 degrees.
    """
    r_c = [effect.r_c_rad for effect in effects if effect.nadir_deg == COMPARED_AT_DEG]
    if not r_c or not r_c[0] > 0.0:
        return None
    h = stations.h_msl_m
    by_kelvin = (air.refractivity(h) / air.temperature(h))[rows]
    by_kelvin = by_kelvin[np.isfinite(by_kelvin)]
    if not by_kelvin.size:
        return None
    return float(f"{np.median(by_kelvin) / r_c[0]:.3g}")
