"""Whether a mission states the windows of an aircraft whose log shows a closed compartment."""

import math
from collections.abc import Iterator

import numpy as np

from unbend.config.stated_nulls import cameras_of_unstated_window
from unbend.flight.compartments import Compartment, closed_compartments
from unbend.messages import Message
from unbend.stages.cabin_air import USUAL_TEMPERATURE_K
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.units import HECTOPASCAL

SMALLEST_SHIFT_PX = 0.02  # by a window, halfway to a corner of the image: less is not measured
AT_CAMERAS = 1.01  # outside over the lowest station's pressure, at most: from 80 m below it upwards


def windows_of_compartments(facts: Facts) -> Iterator[Message]:
    """A finding if the log shows a closed compartment, and cameras have no statement of a window.

    At most one finding, on the first compartment with a window that would shift points measurably.
    Nothing is compared in missions that name the barometer of the cabin: the rule `windows` does.
    """
    mission = facts.mission
    if mission.log is None or mission.log.channels.cabin_pressure is not None:
        return
    cameras = cameras_of_unstated_window(mission)
    if mission.windows or not cameras or facts.height is None:
        return
    outside_channel = mission.log.channels.named().get("pressure")
    for compartment in closed_compartments(facts.channels, facts.height):
        if outside_channel is not None and outside_channel.name == compartment.barometer:
            continue  # the mission file states that this barometer is outside
        finding = window_of_compartment(facts, compartment, cameras)
        if finding is not None:
            yield finding
            return


def window_of_compartment(
    facts: Facts, compartment: Compartment, cameras: tuple[str, ...]
) -> Message | None:
    """The finding that ``cameras`` in a closed compartment need a window.

    None if a window would shift points too little to be measured, or if the compartment has no
    pressure at the height of the cameras.
    """
    profile = facts.adjustment.profile
    heights_m = facts.exposures.height_m[facts.stations.ok]
    heights_m = heights_m[np.isfinite(heights_m)]
    if heights_m.size == 0:
        return None
    height_m = float(np.median(heights_m))
    lowest_station_pa = float(profile.pressure(np.min(heights_m)))
    is_at_cameras = compartment.outside_pa < AT_CAMERAS * lowest_station_pa
    if not is_at_cameras.any():
        return None
    inside_pa = float(np.median(compartment.inside_pa[is_at_cameras]))
    refractivity_inside = float(profile.index.refractivity(USUAL_TEMPERATURE_K, inside_pa, 0.0))
    refractivity_outside = float(profile.refractivity(height_m))
    difference = abs(refractivity_inside - refractivity_outside)
    shift_px = difference * halfway_to_corner_px(facts, cameras)
    if shift_px < SMALLEST_SHIFT_PX:
        return None
    keys = [f"cameras.{name}.window" for name in cameras]
    return messages.window_unstated(
        where=", ".join(keys),
        barometer=compartment.barometer,
        inside_hpa=inside_pa / HECTOPASCAL,
        outside_hpa=float(profile.pressure(height_m)) / HECTOPASCAL,
        shift_px=shift_px,
    )


def halfway_to_corner_px(facts: Facts, cameras: tuple[str, ...]) -> float:
    """Distance from the centre of an image halfway to its corner [px], the largest of ``cameras``.

    It is f tan(theta) of the ray that is imaged there. A window shifts that image point by the
    distance times the difference of the refractive indices inside and outside.
    """
    lengths_px = []
    for name in cameras:
        camera = facts.cameras[name]
        lengths_px.append(math.hypot(camera.width_px, camera.height_px) / 4.0)
    return max(lengths_px)
