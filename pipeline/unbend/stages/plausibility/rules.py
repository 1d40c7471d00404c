"""The rules of plausibility: each yields a finding where the facts of a mission look mistaken.

A finding states what is expected, what there is instead, and the likely mistake.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from unbend.messages import Message
from unbend.refraction.calibration import is_fisheye
from unbend.refraction.camera.camera import Camera
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.air_limits import air_of_flight
from unbend.stages.plausibility.cabin_windows import windows_of_compartments
from unbend.stages.plausibility.causes import causes_of_statuses
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.height_rules import (
    ground_against_takeoff,
    ground_against_terrain,
    heights_of_weather_stations,
    model_against_takeoff,
)
from unbend.stages.plausibility.lens_references import lens_references
from unbend.units import Array

Findings = Iterator[Message]
"""Messages whose ``where`` is the key of the mission file to change."""

NARROWEST_VIEW_DEG = 3.0
WIDEST_VIEW_DEG = 130.0
NARROWEST_FISHEYE_DEG = 60.0
WIDEST_FISHEYE_DEG = 300.0
LARGEST_PIXEL_RATIO = 0.02  # of the sides of a pixel, minus 1
LARGEST_OFF_CENTRE = 0.1  # of a principal point, in sizes of the image
NEAR_MIDDLE = 0.05  # the same, of a principal point that states where the middle is
SMALLEST_DISTORTION = 1e-6  # at the corners of the image, as a share of the radius
LARGEST_DISTORTION = 0.3  # the same, for views under 90 deg
LARGEST_WIDE_DISTORTION = 1.0  # the same, for wider views
LARGEST_TANGENTIAL = 1e-3  # of p1 and p2: a larger one is another coefficient in their place
TANGENTIAL_OVER_RADIAL = 3.0  # p1 or p2 over k3: larger ones are in another order
MOST_OUTSIDE = 0.01  # share of the observations outside the image
FILLED = 0.7  # share of the image that many observations reach
MANY_ROWS = 100  # that fill an image
BEHIND_CENTRE = -0.2  # in sizes of the image: pixels that count from its centre are lower
LARGEST_TILT_DEG = 30.0  # of a camera that is called nadir
SMALLEST_OBLIQUE_DEG = 10.0  # of a camera that is called oblique
ANGLE_STEP_DEG = 15.0  # angles of mounts are often multiples of it
LARGEST_STEP_ERROR = 2e-3  # in steps, of an angle that was rounded in radians
HIGHEST_CAMERA_M = 0.25  # above an antenna, which has the sky above it, or an inertial sensor
LOOKS_DOWN = 0.5  # least cosine of the nadir angle of an axis
LONGEST_LEVER_ARM_M = 10.0
LARGEST_GROUND_SIGMA_M = 50.0
LONGEST_DELAY_S = 1.0
MOST_WINDOW_TILT_DEG = 35.0
LARGEST_NADIR_RAD = 1.4  # nadir angle; beyond it the slant range depends too much on the angle
SMALLEST_RANGE_RATIO = 0.7  # slant range over that of the heights
LARGEST_RANGE_RATIO = 1.4
MOST_FLAGGED = 0.2  # share of the rows, for one cause


def field_of_view(facts: Facts) -> Findings:
    """A finding if a field of view is implausible, or pixels are not square within 2 %.

    Expected are 3 to 130 deg over the diagonal, 60 to 300 deg for fisheyes.
    """
    for name, camera in facts.cameras.items():
        view = facts.view_deg(name)
        key = facts.key_of(name, pixel_key="fx_px", metric_key="focal_mm")
        least = NARROWEST_VIEW_DEG
        most = WIDEST_VIEW_DEG
        if is_fisheye(camera):
            least = NARROWEST_FISHEYE_DEG
            most = WIDEST_FISHEYE_DEG
        if not least <= view <= most:
            yield messages.field_of_view(
                where=key,
                name=name,
                view=view,
                width_px=camera.width_px,
                height_px=camera.height_px,
                fx_px=camera.fx_px,
                least=least,
                most=most,
            )
        if abs(camera.fx_px / camera.fy_px - 1.0) > LARGEST_PIXEL_RATIO:
            yield messages.pixels_not_square(
                where=key, name=name, fx_px=camera.fx_px, fy_px=camera.fy_px
            )


def principal_point(facts: Facts) -> Findings:
    """A finding if a principal point is more than a tenth of the image from its centre.

    It says so if width and height of the image seem exchanged.
    """
    for name, camera in facts.cameras.items():
        off_x = abs(camera.cx_px / camera.width_px - 0.5)
        off_y = abs(camera.cy_px / camera.height_px - 0.5)
        off = max(off_x, off_y)
        if off > LARGEST_OFF_CENTRE and are_sides_exchanged(camera):
            yield messages.sides_exchanged(
                where=facts.key_of(name, pixel_key="width_px", metric_key="format_mm"),
                name=name,
                camera=camera,
            )
        elif off > LARGEST_OFF_CENTRE:
            yield messages.principal_point_off(
                where=facts.key_of(name, pixel_key="cx_px", metric_key="origin"),
                name=name,
                cx_px=camera.cx_px,
                cy_px=camera.cy_px,
                percent=100.0 * off,
            )


def are_sides_exchanged(camera: Camera) -> bool:
    """Whether the principal point is in the middle only if width and height are exchanged."""
    fits_exchanged_x = abs(camera.cx_px / camera.height_px - 0.5) < NEAR_MIDDLE
    fits_exchanged_y = abs(camera.cy_px / camera.width_px - 0.5) < NEAR_MIDDLE
    fits_stated = abs(camera.cx_px / camera.width_px - 0.5) < NEAR_MIDDLE
    return fits_exchanged_x and fits_exchanged_y and not fits_stated


def distortion(facts: Facts) -> Findings:
    """A finding if distortion is too small or too large, or its coefficients in another order.

    Expected at the corners are 1e-6 to 0.3 of their radius (up to 1 in views of 90 deg and more),
    and p1 and p2 up to 0.001, or three times k3. Fisheyes and views over 130 deg are not judged.
    """
    for name, camera in facts.cameras.items():
        coefficients = camera.distortion._asdict()
        view_deg = facts.view_deg(name)
        if not any(coefficients.values()) or view_deg > WIDEST_VIEW_DEG or is_fisheye(camera):
            continue
        share = distortion_at_corners(camera)
        largest = LARGEST_DISTORTION if view_deg < 90.0 else LARGEST_WIDE_DISTORTION
        if share != 0.0 and not SMALLEST_DISTORTION <= share <= largest:
            key = facts.key_of(name, pixel_key="distortion", metric_key="distortion")
            yield messages.distortion_size(where=key, name=name, share=share)
        tangential = max(abs(coefficients.get("p1", 0.0)), abs(coefficients.get("p2", 0.0)))
        over_radial = tangential > TANGENTIAL_OVER_RADIAL * abs(coefficients.get("k3", 0.0))
        if tangential > LARGEST_TANGENTIAL and over_radial:
            key = facts.key_of(name, pixel_key="distortion.k3", metric_key="distortion")
            yield messages.distortion_order(where=key, name=name, most=tangential)


def distortion_at_corners(camera: Camera) -> float:
    """The largest distortion at a corner of the image, as a share of the radius there."""
    u = np.array([0.5, 0.5, -0.5, -0.5]) * camera.width_px / camera.fx_px
    v = np.array([0.5, -0.5, 0.5, -0.5]) * camera.height_px / camera.fy_px
    u_d, v_d = camera.distort(u, v)
    return float(np.max(np.hypot(u_d - u, v_d - v) / np.hypot(u, v)))


def extent_of_observations(facts: Facts) -> Findings:
    """A finding if more than 1 % of the observations are outside the image, or none near its edges.

    The latter is judged from 100 observations on: they should reach 70 % of the image's width or
    height.
    """
    for name, camera in facts.cameras.items():
        rows = (facts.camera == name) & np.isfinite(facts.rows.x_px + facts.rows.y_px)
        x = facts.rows.x_px[rows]
        y = facts.rows.y_px[rows]
        if x.size == 0:
            continue
        width = camera.width_px
        height = camera.height_px
        outside = float(np.mean((x < 0) | (x > width) | (y < 0) | (y > height)))
        if outside > MOST_OUTSIDE:
            expected = "none outside"
            mistake = likely_cause_of_pixels_outside(x, y, width, height)
        else:
            filled = max(x.max() / width, y.max() / height)
            if x.size < MANY_ROWS or filled >= FILLED:
                continue
            expected = "to fill it"
            mistake = "measured in reduced images"
        yield messages.extent_of_observations(
            where=f"cameras.{name}.width_px",
            name=name,
            width_px=width,
            height_px=height,
            x=f"{x.min():.6g} to {x.max():.6g}",
            y=f"{y.min():.6g} to {y.max():.6g}",
            outside=100.0 * outside,
            expected=expected,
            mistake=mistake,
        )


def likely_cause_of_pixels_outside(x: Array, y: Array, width: int, height: int) -> str:
    """What pixels x, y (n,) likely are, in words, if many are outside an image.

    ``width`` and ``height`` are those of the image [px].
    """
    if x.min() < BEHIND_CENTRE * width and y.min() < BEHIND_CENTRE * height:
        return "measured from the centre of the image, not from its upper left corner"
    if x.max() <= height and y.max() <= width:
        return "width and height, or x and y, exchanged"
    return "millimetres, or images of another size"


def direction_of_cameras(facts: Facts) -> Findings:
    """A finding if a camera looks to the horizon or above, or not where its name suggests."""
    for name in facts.cameras:
        axis = facts.axis_deg(name)
        half_view = facts.view_deg(name) / 2.0
        named_nadir = any(word in name.lower() for word in ("nadir", "down", "vertical"))
        expected = ""
        # The horizon is within half the field of view of the axis, or within 10 deg.
        if axis > 90.0 - min(half_view, 10.0):
            expected = "down: likely 0 for a camera that looks down, not -90"
        elif axis > LARGEST_TILT_DEG and named_nadir:
            expected = f"within 30 deg of the nadir by the name of {name}"
        elif axis < SMALLEST_OBLIQUE_DEG and "oblique" in name.lower():
            expected = (
                f"more than 10 deg from the nadir, because of the name of {name}: likely radians, "
                "or exchanged"
            )
        if expected:
            key = facts.mission.attitude_key(name)
            yield messages.camera_direction(where=key, name=name, axis=axis, expected=expected)


def angles_of_mounts(facts: Facts) -> Findings:
    """A finding if an angle of a mount is a multiple of 15 deg when it is read in radians."""
    for name, mount in facts.mission.mount.items():
        for key in ("roll_deg", "pitch_deg", "yaw_deg"):
            value = getattr(mount, key)
            degrees_if_radians = math.degrees(value)
            steps = degrees_if_radians / ANGLE_STEP_DEG
            whole_steps = round(steps)
            # None (0) for a small (boresight) angle, which may have either unit.
            is_multiple = whole_steps != 0 and abs(steps - whole_steps) < LARGEST_STEP_ERROR
            if is_multiple and abs(value) <= math.tau:
                yield messages.angle_in_radians(
                    where=f"mount.{name}.{key}",
                    name=name,
                    angle=key,
                    value=value,
                    deg=degrees_if_radians,
                )


def lever_arms(facts: Facts) -> Findings:
    """A finding if a lever arm is longer than 10 m, or puts a camera above the antenna.

    The latter only for cameras that look down; up to 0.25 m above are allowed.
    """
    for name, mount in facts.mission.mount.items():
        key = f"mount.{name}.lever_arm_m"
        length = math.hypot(*mount.lever_arm_m)
        if length > LONGEST_LEVER_ARM_M:
            yield messages.lever_arm_long(where=key, name=name, length=length)
        up = -mount.lever_arm_m[2]
        looks_down = facts.mission.mounts[name].camera_from_body[2, 2] > LOOKS_DOWN
        if up > HIGHEST_CAMERA_M and looks_down:
            yield messages.lever_arm_above(where=key, name=name, up=up, most=HIGHEST_CAMERA_M)


def sigmas_and_delays(facts: Facts) -> Findings:
    """A finding if the sigma of the ground is over 50 m, or a delay of events over a second."""
    mission = facts.mission
    sigma = mission.ground.sigma_m or 0.0
    if sigma > LARGEST_GROUND_SIGMA_M:
        yield messages.ground_sigma_large(where="ground.sigma_m", sigma=sigma)
    if mission.events is None or mission.events.log is None:
        return
    for name, source in mission.events.log.items():
        if isinstance(source.delay_s, float) and abs(source.delay_s) > LONGEST_DELAY_S:
            key = f"events.log.{name}.delay_s"
            yield messages.delay_large(where=key, name=name, delay=source.delay_s)


def windows(facts: Facts) -> Findings:
    """A finding if the log has a cabin but no camera a window, or if a window is tilted too far.

    Allowed are 35 deg between the normal of the window and the optical axis, if the normal is
    stated in the frame of the camera.
    """
    mission = facts.mission
    channel = None if mission.log is None else mission.log.channels.cabin_pressure
    if channel is not None and not mission.windows:
        first = next(iter(mission.cameras))
        yield messages.window_missing(where=f"cameras.{first}.window")
    for name, window in mission.windows.items():
        if window.frame != "camera":
            continue
        tilt = math.degrees(math.acos(window.normal[2]))
        if tilt > MOST_WINDOW_TILT_DEG:
            where = f"cameras.{name}.{window.section}.frame"
            yield messages.window_leans(where=where, name=name, tilt=tilt)


def slant_ranges(facts: Facts) -> Findings:
    """A finding if measured slant ranges do not fit the heights of camera and ground.

    Their median may be 0.7 to 1.4 times that of straight rays over a flat earth. Rays more than 80
    deg from the nadir do not count.
    """
    straight_m = (facts.camera_height_m - facts.rows.h_g_m) / np.cos(facts.nadir_angle_rad)
    ratio = facts.rows.distance_m / straight_m
    ratio = ratio[np.isfinite(ratio) & (facts.nadir_angle_rad < LARGEST_NADIR_RAD)]
    if not ratio.size:
        return
    median = float(np.median(ratio))
    if not SMALLEST_RANGE_RATIO < median < LARGEST_RANGE_RATIO:
        yield messages.slant_ranges_off(where="observations.columns.distance_m", ratio=median)


def flagged_rows(facts: Facts) -> Findings:
    """A finding for each status that flags more than a fifth of the rows."""
    weight = facts.rows.weight
    for name, cause in causes_of_statuses(facts).items():
        flagged = facts.rows.status == STATUS_NAMES.index(name)
        share = float(np.sum(weight[flagged]) / np.sum(weight))
        if share > MOST_FLAGGED:
            yield messages.many_flagged(
                where="observations",
                percent=100.0 * share,
                name=name,
                most=100.0 * MOST_FLAGGED,
                cause=cause,
            )


def measured_observations(facts: Facts) -> Findings:
    """A finding if refraction is applied to observations of a flight with a log, not removed."""
    mission = facts.mission
    if mission.refraction.direction == "apply" and mission.stations.orientation is None:
        yield messages.refraction_applied_twice(where="refraction.direction")


RULES: tuple[Callable[[Facts], Findings], ...] = (
    ground_against_takeoff,
    ground_against_terrain,
    model_against_takeoff,
    heights_of_weather_stations,
    field_of_view,
    principal_point,
    distortion,
    extent_of_observations,
    direction_of_cameras,
    angles_of_mounts,
    lever_arms,
    sigmas_and_delays,
    windows,
    windows_of_compartments,
    lens_references,
    slant_ranges,
    flagged_rows,
    air_of_flight,
    measured_observations,
)
