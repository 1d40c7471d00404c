"""Whether the stated reference air of a calibration in flight is that of the ground."""

from collections.abc import Iterator

import numpy as np

from unbend.messages import Message
from unbend.refraction.lens_air import (
    LABORATORY_PRESSURE_PA,
    LABORATORY_TEMPERATURE_K,
    AnyLens,
)
from unbend.stages.camera_air import air_at_camera, largest_corner_shift, lens_change_ppm
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K

LEAST_FALL_PA = 5_000.0
"""From the reference to the air in the lens: 450 m. Weather and low flights make less."""
NEARER_TO_GROUND = 3.0
"""How many times nearer to the air of the ground than to the air in the lens a reference must be to
count as air of the ground: a calibration may be flown lower than the mission, but is hardly flown
below a quarter of its height."""
LABORATORY_WITHIN_PA = 100.0  # of the usual pressure of laboratories
LABORATORY_WITHIN_K = 0.5  # of their usual temperature
SMALLEST_SHIFT_PX = 0.05  # in the corner of an image: less cannot be measured


def lens_references(facts: Facts) -> Iterator[Message]:
    """A finding if the reference of a calibration in flight is the air of the ground.

    Only if that shifts a corner of the image measurably. A warning if the calibration was made on
    corrected images.
    """
    mission = facts.mission
    for name, lens in mission.lenses.items():
        calibration = mission.cameras[name].calibration
        if calibration == "laboratory":
            continue
        window = mission.windows.get(name)
        in_cabin = window is not None and window.cabin is not None and not window.is_opening
        if in_cabin and not is_laboratory(lens):
            continue  # the pressure of a cabin says nothing of the flying height
        change_ppm = lens_change_ppm(name, mission, facts.stations, facts.adjustment.profile)
        corner_px = largest_corner_shift(mission, {name: change_ppm})  # 0 without exposures
        if corner_px < SMALLEST_SHIFT_PX:
            continue
        reference_pa = lens.reference_pressure_pa
        in_lens_pa = pressure_in_lens_pa(name, facts)
        if not is_air_of_ground(reference_pa, in_lens_pa, pressure_of_ground_pa(facts)):
            continue
        make_message = messages.reference_of_ground
        if calibration == "in_flight_corrected":
            make_message = messages.reference_of_ground_in_corrected
        yield make_message(
            where=f"cameras.{name}.principal_distance.reference",
            name=name,
            reference_hpa=reference_pa / HECTOPASCAL,
            reference_c=lens.reference_temperature_k - ZERO_CELSIUS_K,
            in_lens_hpa=in_lens_pa / HECTOPASCAL,
            ppm=abs(change_ppm),
            corner_px=corner_px,
        )


def is_laboratory(lens: AnyLens) -> bool:
    """Whether the reference of a lens is the usual air of a laboratory."""
    off_pa = abs(lens.reference_pressure_pa - LABORATORY_PRESSURE_PA)
    off_k = abs(lens.reference_temperature_k - LABORATORY_TEMPERATURE_K)
    return off_pa <= LABORATORY_WITHIN_PA and off_k <= LABORATORY_WITHIN_K


def is_air_of_ground(reference_pa: float, in_lens_pa: float, ground_pa: float) -> bool:
    """Whether a reference is the air of the ground or of a laboratory, not that of a flight.

    Pressures [Pa]: ``reference_pa`` of the calibration, ``in_lens_pa`` in the lens in the flight of
    the mission, ``ground_pa`` at the ground below it, NaN if unknown. True if the reference is
    three times nearer to the ground or a laboratory than to the air in the lens.

    >>> is_air_of_ground(101_325.0, 70_000.0, 95_000.0), is_air_of_ground(85e3, 70e3, 95e3)
    (True, False)
    """
    pressures_of_ground_pa = np.array([LABORATORY_PRESSURE_PA, ground_pa])
    from_ground_pa = float(np.nanmin(np.abs(reference_pa - pressures_of_ground_pa)))
    fall_pa = reference_pa - in_lens_pa
    return fall_pa > max(LEAST_FALL_PA, NEARER_TO_GROUND * from_ground_pa)


def pressure_in_lens_pa(name: str, facts: Facts) -> float:
    """The median pressure [Pa] in the lens of a camera that has usable exposures."""
    mission = facts.mission
    is_usable = (facts.stations.camera == name) & facts.stations.ok
    profile = facts.adjustment.profile
    window = mission.windows.get(name)
    in_lens = air_at_camera(facts.stations, profile, window, mission.lenses[name], is_usable)
    return float(np.nanmedian(in_lens.pressure_pa))


def pressure_of_ground_pa(facts: Facts) -> float:
    """The pressure [Pa] at the median height of the observed points; NaN if unknown."""
    heights_m = facts.rows.h_g_m[np.isfinite(facts.rows.h_g_m)]
    if not heights_m.size:
        return float("nan")
    return float(facts.adjustment.profile.pressure(np.median(heights_m)))
