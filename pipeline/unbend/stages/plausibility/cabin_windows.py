"""Whether a mission states the windows of an aircraft whose log shows a closed compartment."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from unbend.config.stated_nulls import cameras_of_stated_null, cameras_of_unstated_window
from unbend.flight.compartments import Compartment, closed_compartments
from unbend.messages import Message
from unbend.stages.cabin_air import USUAL_TEMPERATURE_K
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.units import HECTOPASCAL

SMALLEST_SHIFT_PX = 0.02  # by a window, halfway to a corner of the image: less is not measured
NEAR_CAMERAS = 0.05  # difference of pressures outside, as a share: within 400 m of the cameras


def windows_of_compartments(facts: Facts) -> Iterator[Message]:
    """A finding if the log shows a closed compartment, and a camera has no statement of a window.

    A statement is a window, an opening, or ``window: null``. At most one finding, on the first
    compartment with a window that would shift points measurably. If all cameras have a statement, a
    note in its place on those with null. Nothing is compared in missions that name the barometer of
    the cabin: the rule `windows` does.
    """
    mission = facts.mission
    if mission.log is None or mission.log.channels.cabin_pressure is not None:
        return
    message = messages.window_unstated
    cameras = cameras_of_unstated_window(mission)
    if not cameras:
        message = messages.window_stated_null
        cameras = cameras_of_stated_null(mission)
    if not cameras or facts.height is None:
        return
    outside_channel = mission.log.channels.named().get("pressure")
    for compartment in closed_compartments(facts.channels, facts.height):
        if outside_channel is not None and outside_channel.name == compartment.barometer:
            continue  # the mission file states that this barometer is outside
        effect = effect_of_window(facts, compartment, cameras)
        if effect is not None and effect.shift_px >= SMALLEST_SHIFT_PX:
            keys = [f"cameras.{name}.window" for name in cameras]
            yield message(
                where=", ".join(keys),
                barometer=compartment.barometer,
                inside_hpa=effect.inside_pa / HECTOPASCAL,
                outside_hpa=effect.outside_pa / HECTOPASCAL,
                shift_px=effect.shift_px,
            )
            return


class WindowEffect(NamedTuple):
    """Pressures on both sides of a window, and its shift of points halfway to the corner."""

    inside_pa: float
    outside_pa: float
    shift_px: float


def effect_of_window(
    facts: Facts, compartment: Compartment, cameras: tuple[str, ...]
) -> WindowEffect | None:
    """What a window would do at the median height of the cameras, if they are in the compartment.

    None if no usable station has a height, or the compartment has no pressure near that height.
    """
    profile = facts.adjustment.profile
    heights_m = facts.exposures.height_m[facts.stations.ok]
    heights_m = heights_m[np.isfinite(heights_m)]
    if heights_m.size == 0:
        return None
    height_m = float(np.median(heights_m))
    outside_pa = float(profile.pressure(height_m))
    is_at_cameras = np.abs(compartment.outside_pa / outside_pa - 1.0) < NEAR_CAMERAS
    if not is_at_cameras.any():
        return None
    inside_pa = float(np.median(compartment.inside_pa[is_at_cameras]))
    refractivity_inside = float(profile.index.refractivity(USUAL_TEMPERATURE_K, inside_pa, 0.0))
    refractivity_outside = float(profile.refractivity(height_m))
    difference = abs(refractivity_inside - refractivity_outside)
    return WindowEffect(
        inside_pa=inside_pa,
        outside_pa=outside_pa,
        shift_px=difference * halfway_to_corner_px(facts, cameras),
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
